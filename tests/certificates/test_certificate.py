"""Certificates: what is proven verifies, in a fresh process too, and whatever was tampered with is refused by name."""

import copy
import subprocess
import sys
from fractions import Fraction
from functools import cache
from itertools import pairwise

import numpy as np
import pinocchio as pin
import pytest
from edges import kept_within_limits
from signing import claimed, signed, travelled

from safe_ompl import CollisionChecker, DangerField, MotionProver, Obstacle, Scene, certificate, verify
from safe_ompl.certificates.claims import ClaimedDanger
from safe_ompl.certificates.verifier.bodies import ENDLESS, farthest
from safe_ompl.certificates.verifier.danger import PlainDanger
from safe_ompl.certificates.verifier.motion import RecordedPiece, derivatives
from safe_ompl.certificates.verifier.verify import AskedTerms
from safe_ompl.common import CertificateError, InputError, PlanningError


@cache
def motion_of(robot, scene):
    return MotionProver(CollisionChecker(robot, scene))


def free_path(robot, scene, seed, edges=1):
    """Return a path of free edges of up to 1 rad, or None."""
    rng = np.random.default_rng(seed)
    motion, path = motion_of(robot, scene), [rng.uniform(robot.lower, robot.upper)]
    for _ in range(60):
        end = path[-1] + rng.uniform(0, 1) * rng.normal(size=robot.n) / np.sqrt(robot.n)
        end = kept_within_limits(robot, end)
        if motion.is_free(path[-1], end):
            path.append(end)
        if len(path) > edges:
            return np.array(path)
    return None


@pytest.fixture(scope="module")
def path(ur5, clutter):
    """Three edges of a UR5 that pass near something: they are divided often."""
    path = free_path(ur5, clutter, 113, 3)
    assert verify(certificate(path, ur5, clutter)).intervals >= 30
    return path


@pytest.fixture(scope="module")
def written(path, ur5, clutter):
    return travelled(certificate(path, ur5, clutter))


@pytest.fixture
def tampered(written):
    """Return a copy to tamper with."""
    return copy.deepcopy(written)


# ------------------------------------------------------------------------------------------------- what holds


def test_a_path_over_the_half_turn(kinova):
    rest = [2.9, 1.3, 3.0, 1.8, -3.0]
    over = np.array([[3.0, *rest], [-3.0, *rest]])
    with pytest.raises(InputError, match="more than half a turn"):
        certificate(over, kinova, Scene())
    content = certificate(np.unwrap(over, axis=0), kinova, Scene())
    assert verify(content, kinova, Scene()).edges == 1
    assert claimed(content)["motion"]["coefficients"][0][1][0] == pytest.approx(2 * np.pi - 6), "the short way"
    leap = [[3.0, *rest], [1e17, *rest], [1.0, *rest]]  # so far that turns are lost
    with pytest.raises(InputError, match=r"joint .* (jumps|turns) by"):
        certificate(leap, kinova, Scene())


def test_a_path_of_one_configuration(ur5, clutter, path):
    assert verify(certificate(path[:1], ur5, clutter), ur5, clutter).edges == 1


# ----------------------------------------------------------------------------------------------- what does not


def refused(content, robot, scene, match):
    with pytest.raises(CertificateError, match=match):
        verify(content, robot, scene)


def touching(robot, plain):
    """Return a configuration at which something touches."""
    drawn = np.random.default_rng(0).uniform(robot.lower, robot.upper, (100, robot.n))
    return next(q for q in drawn if plain.nearest(q) <= 0)


def swapped(content):
    names = content["joint_names"]
    names[0], names[1] = names[1], names[0]


def slopes(content, piece):
    return claimed(content)["motion"]["coefficients"][piece][1]


@pytest.mark.parametrize(
    ("change", "match"),
    [
        (swapped, "joint order: "),
        (lambda c: slopes(c, 1).__setitem__(0, 0.5 + slopes(c, 1)[0]), "piece 2 does not begin where the one before"),
        (lambda c: slopes(c, 2).__setitem__(3, 7.0), "piece 2 .* leaves the limits of joint 'wrist_1_joint'"),
        (lambda c: slopes(c, 2).__setitem__(3, 1e-7 + slopes(c, 2)[3]), None),
        (lambda c: slopes(c, 2).__setitem__(3, 10**400), r"coefficients\[2\]\[1\]\[3\]: must be|must be numbers"),
        (lambda c: c.update(version=4), "version: 4 is not known, 5 is; issue the certificate anew"),
        (
            lambda c: c.update(format="safe-ompl program certificate"),
            "got 'safe-ompl program certificate'; it is of an earlier version: issue the certificate anew",
        ),
        (lambda c: claimed(c).pop("motion"), r"stretches\[0\]\.motion: missing, but needed"),
        (lambda c: c["stretches"].clear(), "stretches: must contain at least one stretch"),
        (lambda c: c.clear(), "format: must be 'safe-ompl certificate', got None"),
    ],
)
def test_what_was_changed_is_refused_by_name(tampered, ur5, clutter, change, match):
    change(tampered)
    if match is None:
        assert verify(signed(tampered), ur5, clutter), "it holds as well"
        tampered["digest"], match = "0" * 64, "its digest differs"
    else:
        tampered = signed(tampered)
    with pytest.raises((CertificateError, InputError), match=match):
        verify(tampered, ur5, clutter)


def test_a_path_that_is_not_free_gets_none(ur5, clutter, plain_check):
    q = touching(ur5, plain_check(ur5, clutter))
    with pytest.raises(PlanningError, match=r"cannot be certified by plain means: .* mm apart near .* of piece 0"):
        certificate([q, q + 0.1], ur5, clutter)


BALL = {"distance": 0.1, "obstacles": ["ball"]}
MOVING = {"speeds": {"ball": 0.01}, "time": 0.1}
UP = {"axis": [0, 0, 1], "direction": [0, 0, 1], "angle": 1.0}
DANGER = {"bound": 9.0, "spacing": 0.1, "aggregate": "softmax", "weighting": "unit", "k1": 1.0, "sharpness": 10.0}
MALFORMED = [
    ({"clearance": {**BALL, "distance": "0.1"}}, r"clearance\.distance: must be a finite number >= 0, got '0\.1'"),
    ({"clearance": {**BALL, "obstacles": ["ghost"]}}, "unknown obstacle 'ghost'"),
    ({"clearance": {**BALL, "obstacles": "ball"}}, r"clearance\.obstacles: must be a list"),
    ({"clearance": {**BALL, "obstacles": []}}, r"clearance\.obstacles: must contain at least one obstacle"),
    ({"clearance": {**BALL, "exempt": []}}, r"clearance\.exempt: unknown key"),
    ({"moving_obstacles": {**MOVING, "time": -1.0}}, r"moving_obstacles\.time: must be a finite number >= 0, got -1"),
    ({"moving_obstacles": {**MOVING, "speeds": {}}}, r"moving_obstacles\.speeds: must contain at least one obstacle"),
    ({"moving_obstacles": {**MOVING, "speeds": {"ball": -1}}}, r"moving_obstacles\.speeds\.ball: "),
    ({"moving_obstacles": {**MOVING, "speeds": {"ghost": 1.0}}}, "unknown obstacle 'ghost'"),
    ({"moving_obstacles": {**MOVING, "speeds": ["ball"]}}, r"moving_obstacles\.speeds: must be a mapping"),
    *(
        ({"danger": {**DANGER, key: value}}, rf"danger.*{message}")
        for key, value, message in [
            ("bound", float("nan"), "must be a finite number"),
            ("bound", "9.0", "must be a (finite|positive) number"),
            ("k1", -1.0, "must be a positive number"),
            ("sharpness", 0, "must be a positive number"),
            ("aggregate", "least", "unknown aggregate 'least'"),
            ("extra", 1, "unknown key"),
        ]
    ),
    ({"tool": {}}, r"tool\.orientation: must claim"),
    ({"tool": {"position": {}}}, r"tool\.position: must contain at least one axis"),
    ({"tool": {"position": {"x": [0, None]}}}, r"tool\.position\.x: must be a finite number"),
    ({"tool": {"orientation": {**UP, "angle": 0}}}, r"tool\.orientation\.angle: must be a finite number in \(0"),
    ({"tool": {"orientation": {**UP, "axis": [0, 0, 0]}}}, r"orientation\.axis: must be a direction"),
]


@pytest.mark.parametrize(("claim", "message"), MALFORMED)
def test_claims_without_a_meaning_are_neither_verified_nor_issued(tampered, ur5, clutter, path, claim, message):
    claimed(tampered).update(claim)
    with pytest.raises(InputError, match=message):
        verify(signed(tampered), ur5, clutter)
    if "danger" not in claim:  # of which a field says all
        with pytest.raises(InputError, match=message):
            certificate(path, ur5, clutter, claim)


# ----------------------------------------------------------------------------------------------------- danger


def dangerous(scene, name="ball"):
    ball = scene[name]
    return scene.without(name).with_obstacles(Obstacle(name, ball.shape, ball.pose, weight=1.5))


@pytest.mark.parametrize(
    ("name", "aggregate", "weighting"),
    [("ur5", "max", "unit"), ("ur5", "softmax", "length"), ("slider", "mean", "length"), ("slider", "max", "unit")],
)
def test_a_claim_of_danger(robot_named, clutter, name, aggregate, weighting):
    robot, scene = robot_named(name), dangerous(clutter)
    path = next(p for seed in range(80) if (p := free_path(robot, scene, seed, 2)) is not None)
    points, weights, _ = scene.danger_points(0.1)
    field = DangerField(robot, points, weights, aggregate=aggregate, weighting=weighting, k1=2.0, sharpness=3.0)
    content = certificate(path, robot, scene, {"spacing": 0.1}, field=field)
    assert verify(content, robot, scene).edges == 2
    plain = PlainDanger(robot, scene, ClaimedDanger.from_mapping(claimed(content)["danger"]), ENDLESS)
    still = RecordedPiece("still", derivatives(np.array([path[0], 0 * path[0]]), Fraction(1)))
    assert plain.exceeded(still, field.value(path[0]) * (1 + 1e-5)) is None
    assert plain.exceeded(still, field.value(path[0]) * (1 - 1e-5)) is not None
    t = np.linspace(0, 1, 500)[:, None]
    dense = field.values(np.concatenate([a + t * robot.difference(a, b) for a, b in pairwise(path)]))
    assert dense.max() <= claimed(content)["danger"]["bound"] <= 1.06 * dense.max()
    limit = 1.001 * dense.max()
    limited = certificate(path, robot, scene, {"spacing": 0.1, "max_danger": limit}, field=field)
    assert claimed(limited)["danger"]["bound"] == limit
    assert verify(limited, robot, scene).edges == 2
    above = certificate(path, robot, scene, {"spacing": 0.1, "max_danger": 0.9 * limit}, field=field)
    assert claimed(above)["danger"] == claimed(content)["danger"]
    claimed(content)["danger"]["bound"] = 0.99 * dense.max()
    refused(signed(content), robot, scene, r"piece \d of the motion: danger .* is claimed")


@pytest.mark.parametrize(
    ("options", "spacing"),
    [
        ({"k1": 1e-3}, 0.1),
        ({"aggregate": "mean"}, 0.1),
        ({"weighting": "length"}, 0.1),
        ({"sharpness": 50.0}, 0.1),
        ({}, 0.2),
    ],
)
def test_a_danger_of_another_kind_is_no_claim_of_this_one(ur5, clutter, path, options, spacing):
    scene, usual = dangerous(clutter), {"aggregate": "softmax", "k1": 2.0}
    points, weights, _ = scene.danger_points(spacing)
    own = DangerField(ur5, points, weights, **{**usual, **options})
    content = certificate(path, ur5, scene, {"spacing": spacing}, field=own)
    assert verify(content, ur5, scene).edges == 3, "it says itself of what kind it is"
    key = next(iter(options), "spacing")
    asked = {"spacing": 0.1, "weighting": "unit", "sharpness": 10.0, **usual}
    with pytest.raises(CertificateError, match=rf"danger: {key} is .* in its claim, .* is asked for"):
        verify(content, ur5, scene, terms=AskedTerms(danger=asked))
    assert verify(content, ur5, scene, terms=AskedTerms(danger={**asked, **options, "spacing": spacing})).edges == 3


# ------------------------------------------- what verifies certificates runs no code of what plans, proves motions,


PROVERS = ("collision", "danger", "motions", "planning", "tasks", "live", "certificates.issue")
LOADED = "import sys, {module}; print(*(name for name in sys.modules if name.startswith('safe_ompl.')))"


def provers_loaded_by(module):
    """Return the modules of provers that importing a module loads, in a new process."""
    command = [sys.executable, "-c", LOADED.format(module=module)]
    loaded = subprocess.run(command, check=True, capture_output=True, text=True, timeout=120).stdout.split()
    assert module in loaded
    packages = tuple(f"safe_ompl.{package}." for package in PROVERS)
    return [name for name in loaded if f"{name}.".startswith(packages)]


def test_the_verifier_loads_no_prover():
    assert not provers_loaded_by("safe_ompl.certificates.verifier.verify")


def test_the_farthest_point_is_as_far_from_an_axis_as_by_hand():
    rng = np.random.default_rng(0)
    points, origins, axes = rng.normal(size=(40, 3)), rng.normal(size=(4, 3)), rng.normal(size=(4, 3))
    axes /= np.linalg.norm(axes, axis=1)[:, None]
    place = pin.SE3(pin.exp3(rng.normal(size=3)), rng.normal(size=3))
    found = [
        max(np.linalg.norm(np.cross(place.act(point) - origin, axis)) for point in points)
        for origin, axis in zip(origins, axes, strict=True)
    ]
    np.testing.assert_allclose(farthest(points, place, origins, axes), found, rtol=1e-12)
