"""Claims of motions of polynomials, and of tubes: what is proven verifies, what is accepted holds, nothing is faked."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from scipy import interpolate
from signing import claimed, replaced, tampered, travelled

from safe_ompl import (
    CertificateError,
    Constraints,
    DangerField,
    DangerLimit,
    InputError,
    Obstacle,
    PathTimer,
    PlanningError,
    RateLimits,
)
from safe_ompl.certificates import certificate, motion_certificate, verify
from safe_ompl.certificates.claims import ClaimedMotion
from safe_ompl.certificates.verifier.bodies import Separations
from safe_ompl.certificates.verifier.motion import RecordedMotion
from safe_ompl.certificates.verifier.polynomials import check_motion
from safe_ompl.certificates.verifier.verify import AskedTerms
from safe_ompl.collision import Separation, ToolOrientation
from safe_ompl.danger import CertifiedDanger
from safe_ompl.drawing import ViewerContent
from safe_ompl.motions import Motion, check, check_with

TIMES = np.array([0.0, 0.8, 1.5, 2.4])
POINTS = np.array([[0, -1.5, 0.5, 0, 0, 0], [0.25, -1.4, 0.6, 0.1, 0, 0], [0.4, -1.6, 0.4, 0.1, 0.2, 0]])
POINTS = np.vstack([POINTS, [0.6, -1.5, 0.5, 0.1, 0, 0.1]])
TUBE = (0.004, 0.004, 0.006, 0.01, 0.02, 0.02)
FINE = np.linspace(0.0, 2.4, 121)
claim = partial(replaced, "stretches", 0)


def spline():
    return interpolate.CubicSpline(TIMES, POINTS, bc_type="clamped")


def motions():
    rates = [np.zeros(6), *np.gradient(POINTS, TIMES, axis=0)[1:-1], np.zeros(6)]
    return {
        "SciPy's cubic spline": spline(),
        "quintic Hermite": Motion.hermite(TIMES, POINTS, rates, np.zeros((4, 6))),
        "B-spline of degree 5": interpolate.make_interp_spline(FINE[::12], spline()(FINE[::12]), k=5),
        "path": Motion.through(POINTS),
        "Bézier of degree 9": interpolate.BPoly(np.repeat(POINTS, [2, 3, 3, 2], axis=0)[:, None], [0.0, 2.4]),
        "bare samples": Motion.sampled(FINE, spline()(FINE), 0.5),
    }


@pytest.fixture(scope="module")
def fast(ur5):
    return RateLimits.of(ur5, 1.5, 8.0)


@pytest.fixture(scope="module")
def written(ur5, clutter, fast):
    """Return the certificate of a spline with a tube, a clearance, an upright tool, and limits of its rates."""
    setting = Separation(tube=TUBE, margin=0.01)
    limit = ToolOrientation(ur5, ur5.tip_pose(POINTS[0]).rotation[2], [0, 0, 1], 1.2)
    wanted = Constraints(separation=setting, tool=(limit,))
    found = check(spline(), ur5, clutter, constraints=wanted, limits=fast)
    return travelled(motion_certificate(found))


@pytest.mark.parametrize("tube", [None, TUBE])
@pytest.mark.parametrize("kind", motions())
def test_what_is_proven_verifies(ur5, clutter, kind, tube):
    found = check(motions()[kind], ur5, clutter, tube=tube)
    assert found, found
    content = travelled(motion_certificate(found))
    said = verify(content, ur5, clutter)
    assert said.edges == found.motion.pieces <= said.intervals < said.distances
    assert ("tube" in said.not_claimed) == (tube is None)
    assert any("polynomials" in sentence or "edges" in sentence for sentence in said.claims)
    assert any("joints off by up to (0.004, " in sentence for sentence in said.claims) == (tube is not None)


def test_what_takes_too_long_is_undecided_and_says_where(ur5, clutter, written):
    with pytest.raises(CertificateError, match=r"^undecided: .* at danger and tool of piece 0 of the motion"):
        verify(written, ur5, clutter, time=1e-9)
    free = motion_certificate(check(spline(), ur5, clutter))
    with pytest.raises(CertificateError, match=r"^undecided: .* at 0\.000000 of piece 0 of the motion"):
        verify(free, ur5, clutter, time=1e-9)


def test_all_that_is_proven_is_claimed_and_said(ur5, clutter, written, fast):
    said = verify(written, ur5, clutter)
    assert said.claims[1] == "no moving link nearer than 10 mm to any obstacle"
    assert said.claims[2].startswith("the tool's axis (")
    assert said.claims[3] == "the same with joints off by up to (0.004, 0.004, 0.006, 0.01, 0.02, 0.02) [rad or m]"
    assert said.claims[4] == "a motion of 3 polynomials in 2.400 s"
    assert said.claims[5].startswith("the joints within velocities of (1.5, 1.5, ")
    assert said.not_claimed == ("clearance", "danger", "moving obstacles", "jerk")
    assert verify(written, ur5, clutter, terms=AskedTerms(motion={"velocity": fast.velocity, "jerk": None}))
    with pytest.raises(CertificateError, match="motion: velocity is"):
        verify(written, ur5, clutter, terms=AskedTerms(motion={"velocity": 1.1 * fast.velocity}))


@pytest.mark.parametrize("tube", [None, TUBE])
def test_a_limit_of_the_danger(ur5, clutter, tube):
    scene = weighed(clutter)
    field = DangerField.of_scene(ur5, scene)
    peak = CertifiedDanger(field).of_path(spline()(FINE)).upper
    wanted = Constraints(danger=DangerLimit(field, 1.2 * peak))
    content = travelled(motion_certificate(check(spline(), ur5, scene, constraints=wanted, tube=tube)))
    assert verify(content, ur5, scene).claims[1].startswith("danger at most")
    with pytest.raises(CertificateError, match=r"piece . of the motion: danger .* near"):
        verify(tampered(content, lambda c: claimed(c)["danger"].update(bound=0.99 * peak)), ur5, scene)
    with pytest.raises(InputError, match="danger points of the field are not those of the scene"):
        motion_certificate(check(spline(), ur5, scene, constraints=wanted), spacing=0.07)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (claim("motion", "coefficients", 1, 0, 0, by=lambda x: x + 2e-6), "piece 1 does not begin where"),
        (claim("motion", "coefficients", 2, 3, 4, by=lambda x: x + 0.5), "velocity jumps|above its limit"),
        (claim("motion", "coefficients", by=lambda all: all[1:]), "times: must be 3 numbers"),
        (claim("motion", "times", by=lambda t: [0.2 * x for x in t]), "velocity of joint .* above its limit"),
        (claim("motion", "times", 2, by=lambda t: t - 0.3), "the velocity jumps where piece"),
        (claim("motion", "velocity", 0, by=lambda x: 0.2 * x), "velocity of joint 'shoulder_pan_joint' above"),
        (claim("motion", "acceleration", 2, by=lambda x: 0.1 * x), "acceleration of joint 'elbow_joint' above"),
        (claim("motion", by=lambda motion: {**motion, "jerk": [0.1] * 6}), "jerk of joint .* above its limit"),
        (claim("tube", by=lambda tube: [10 * x for x in tube]), "mm apart near .* of piece .* are needed"),
        (claim("margin", by=lambda x: 30 * x), "mm apart near .* of piece"),
        (claim("tool", "orientation", "angle", by=lambda x: 0.05 * x), "motion: the orientation of the tool"),
        (claim("tube", by=lambda tube: tube[1:]), "tube: must be 6 numbers >= 0"),
        (claim("path", by=()), "path: unknown key"),
    ],
)
def test_what_is_tampered_with_is_refused(ur5, clutter, written, change, words):
    with pytest.raises((CertificateError, InputError), match=words):
        verify(tampered(written, change), ur5, clutter)


def test_within_a_tube_the_tool_turns_more_than_on_its_motion(ur5, clutter, written):
    heights = [ur5.tip_pose(q).rotation[2] @ ur5.tip_pose(POINTS[0]).rotation[2] for q in spline()(FINE)]
    angle = 1.01 * np.arccos(min(heights))
    with pytest.raises(CertificateError, match="motion: the orientation of the tool"):
        verify(tampered(written, claim("tool", "orientation", "angle", by=float(angle))), ur5, clutter)
    without = tampered(written, claim("tube", by=None))
    assert verify(tampered(without, claim("tool", "orientation", "angle", by=float(angle))), ur5, clutter)


def test_slack_counts_and_its_digest_is_looked_at(ur5, clutter):
    found = check(Motion.sampled(FINE, spline()(FINE), 0.5), ur5, clutter)
    content = travelled(motion_certificate(found))
    assert "whatever is within (0.0" in verify(content).claims[1]
    smaller = tampered(content, claim("motion", "slack", 3, by=lambda row: [0.0] * 6))
    with pytest.raises(CertificateError, match="digest differs"):
        verify({**smaller, "digest": content["digest"]})
    with pytest.raises(CertificateError, match=r"of piece 3 of the motion, .* are needed"):
        verify(tampered(content, claim("motion", "slack", 3, by=lambda row: [20 * x for x in row])))
    with pytest.raises(InputError, match=r"motion\.velocity: needs a timed motion without slack"):
        verify(tampered(content, claim("motion", by=lambda motion: {**motion, "velocity": [9.0] * 6})))


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"coefficients": []}, r"motion\.coefficients: must contain at least one piece"),
        ({"coefficients": [[[0] * 6], [[0] * 6], [[0] * 6]]}, r"coefficients\[0\]: must be 2 to 16 rows of 6"),
        ({"times": [0, 1, 1, 2]}, r"motion\.times: must be 4 numbers that increase"),
        ({"timed": 1}, "timed: must be true or false"),
        ({"timed": False}, r"motion\.velocity: needs a timed motion"),
        ({"slack": [[-1] * 6] * 3}, r"motion\.slack: must be 3 rows of 6 numbers >= 0"),
        ({"rounding": [[0] * 6]}, r"motion\.rounding: must be 3 rows"),
        ({"velocity": None}, r"motion\.acceleration: needs velocities"),
        ({"jerk": [0] * 6}, r"motion\.jerk: must be 6 numbers in \[0\.1, 1e\+08\]"),
        ({"velocity": [3e6] * 6}, r"motion\.velocity: must be 6 numbers in"),
        ({"acceleration": [1e308] * 6}, r"motion\.acceleration: must be 6 numbers in"),
        ({"extra": 1}, "unknown key"),
    ],
)
def test_claims_without_meaning_are_refused(written, change, words):
    with pytest.raises(InputError, match=words):
        verify(tampered(written, lambda content: claimed(content)["motion"].update(change)))


# What is exceeded, limits of velocities, accelerations and jerks, and the motion
FALSE = {
    "a staircase of positions": ("velocity", (1e-3, 1e-2), lambda: stairs(0)),
    "the same, slow enough": ("acceleration", (20.0, 1.0), lambda: stairs(0)),
    "a staircase of velocities": ("acceleration", (1.0, 1e-2), lambda: stairs(1)),
    "a staircase of accelerations": ("jerk", (1.0, 1.0, 1.0), lambda: stairs(2)),
    "a corner at a high limit": ("velocity jump", (999.0, 1e-2), lambda: corner(9e-4)),
    "a corner that is called rounding": ("velocity jump", (1.0, 1e-2), lambda: corner(0.4, 0.2)),
    "a bang-bang profile": ("acceleration jump", (1.0, 1e5, 0.5), lambda: bang(0.04)),
}


def stairs(order, count=50, span=1e-7, step=0.99e-6):
    """Return pieces on which a derivative of an order is constant, and steps in between."""
    levels = np.cumsum(np.full((count, 1), step) * [1.0, 0, 0, 0, 0, 0], axis=0)
    held = [span**order * levels / max(order, 1)]
    for k in range(order, 0, -1):  # what is below has no jumps
        gone = sum(held) * (2 if k == 2 else 1)
        held.insert(0, np.cumsum(gone, axis=0) - gone)
    held[0] = held[0] + POINTS[0]
    return Motion(np.arange(count + 1) * span, np.stack([*held, 0 * levels], axis=1))


def corner(turn, rounding=0.0):
    turned = [[0.0] * 6, [0.0] * 6, [turn, 0, 0, 0, 0, 0]]
    made = Motion.through(POINTS[0] + turned, [0.0, 1.0, 2.0])
    return Motion(made.times, made.coefficients, rounding=np.full((2, 6), rounding))


def bang(push):
    q, v = POINTS[0] + push * np.outer([0.0, 0.125, 0.25], np.eye(6)[0]), push * np.outer([0.0, 0.5, 0.0], np.eye(6)[0])
    return Motion.hermite([0.0, 0.5, 1.0], q, v)


@pytest.mark.parametrize("kind", FALSE)
def test_rates_that_are_false_are_neither_proven_nor_certified(ur5, clutter, kind):
    """Jumps count as motion, no tolerance grows with a limit, and a forged check has no certificate."""
    wrong, given, made = FALSE[kind]
    limits = RateLimits(ur5.joint_names, *(np.full(6, limit) for limit in given))
    found = check(made(), ur5, clutter, limits=limits)
    assert wrong in {violation.kind for violation in found.violations}
    found = found._replace(violations=())
    with pytest.raises(PlanningError, match=r"by plain means: motion: .*(above its limit|jumps)"):
        motion_certificate(found)


def test_what_is_not_proven_has_no_certificate(ur5, clutter, fast):
    bad = check(Motion.through([POINTS[0], POINTS[0] + [0.5, 1.2, 0, 0, 0, 0]]), ur5, clutter)
    with pytest.raises(PlanningError, match="the motion is not proven, and has no certificate: collision at"):
        motion_certificate(bad)

    class Own:
        name = "mine"
        allows = holds_within = staticmethod(lambda *_: True)

    found = check(spline(), ur5, clutter)
    with pytest.raises(InputError, match="limits: certificates cannot state 'mine'"):
        motion_certificate(check_with(spline(), replace(found.proof, limits=[Own()])))
    bare = check(Motion.sampled(FINE, spline()(FINE), 0.5), ur5, clutter, limits=fast)
    assert "velocity" not in bare.claims
    assert "velocity" not in claimed(motion_certificate(bare))["motion"]


def test_it_can_be_shown(written):
    shown = ViewerContent.of_certificate(written)
    (path,) = shown.paths.values()
    assert np.allclose(path[[0, -1]], POINTS[[0, -1]])


# ------------------------------------------------------------------------------------- tubes of straight paths


def weighed(scene):
    beam = scene["beam"]
    return scene.without("beam").with_obstacles(Obstacle("beam", beam.shape, beam.pose, weight=1.5))


def test_the_danger_within_a_tube_of_a_path_has_a_larger_bound(ur5, clutter):
    scene = weighed(clutter)
    field = DangerField.of_scene(ur5, scene)
    content = travelled(certificate(POINTS, ur5, scene, {"tube": TUBE}, field=field))
    said = verify(content, ur5, scene).claims
    assert said[-2] == "the same with joints off by up to (0.004, 0.004, 0.006, 0.01, 0.02, 0.02) [rad or m]"
    assert said[-1] == "a path of 3 straight edges"
    peak = CertifiedDanger(field).of_path(POINTS).upper
    for change in (
        claim("tube", by=lambda tube: [2.0 * x for x in tube]),
        claim("danger", "bound", by=lambda _: 1.001 * peak),
    ):
        with pytest.raises(CertificateError, match=r"piece . of the motion: danger .* is claimed"):
            verify(tampered(content, change), ur5, scene)
    content = tampered(content, lambda c: (claimed(c)["danger"].update(bound=1.001 * peak), claimed(c).pop("tube")))
    assert verify(content, ur5, scene)


def test_a_tube_that_is_too_wide_or_of_a_trajectory_is_refused(ur5, clutter):
    with pytest.raises(PlanningError, match=r"mm apart near .* of piece 0"):
        certificate(POINTS, ur5, clutter, {"tube": np.full(6, 0.5)})
    trajectory = PathTimer(ur5, RateLimits.of(ur5, 1.0, 4.0)).time(POINTS, cells=12)
    with pytest.raises(InputError, match="tube: is claimed of paths and polynomials, and not of a trajectory"):
        certificate(POINTS, ur5, clutter, {"tube": TUBE}, trajectory=trajectory)


# ------------------------------------------------------------------------------------- what is accepted holds


def random_curve(robot, rng, degree):
    room = 0.02 * (robot.upper - robot.lower)
    start = rng.uniform(robot.lower + room, robot.upper - room)
    points = start + rng.uniform(0.1, 0.8) * rng.normal(size=(degree + 1, robot.n))
    return np.clip(points, robot.lower + room, robot.upper - room)


class OfTube:
    """Claims of nothing but that a motion is free within a tube."""

    danger = tool = None

    def __init__(self, motion, tube):
        self.motion, self.tube = motion, tube

    def required(self, obstacle):
        return 0.0


@pytest.mark.parametrize("name", ["ur5", "panda", "slider", "twin_arm"])
def test_what_the_verifier_accepts_touches_nothing_and_what_is_proven_it_accepts(
    robot_named, clutter, plain_check, rng, name
):
    robot, accepted, refused = robot_named(name), 0, 0
    plain = plain_check(robot, clutter)
    for _ in range(24):
        motion = Motion.of(interpolate.BPoly(random_curve(robot, rng, int(rng.integers(1, 8)))[:, None], [0.0, 1.0]))
        tube = rng.choice([0.0, 0.005, 0.03]) * rng.uniform(0, 1, robot.n)
        said = motion.to_mapping()
        keys = ("times", "coefficients", "timed", "rounding")
        claim = ClaimedMotion.from_mapping({key: said[key] for key in keys if key in said})
        claims = OfTube(claim, tube)
        try:
            check_motion(claims, robot, clutter, Separations(robot, clutter, claims), RecordedMotion(claim))
        except CertificateError:
            refused += 1
            assert not check(motion, robot, clutter, tube=tube)
            continue
        accepted += 1
        for t in np.linspace(0.0, 1.0, 150):
            assert plain.nearest(motion.at(t) + rng.choice([-1.0, 1.0], robot.n) * tube) > 0.0
    assert accepted > 0
    assert refused > 0
