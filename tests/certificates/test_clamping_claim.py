"""Clamping in certificates: how fast gaps close in which a limb fits, against samples, and what is claimed of it."""

import copy
import json
from itertools import pairwise
from types import SimpleNamespace

import numpy as np
import pinocchio as pin
import pytest

from bench._touches import Gaps, thickness
from safe_ompl import (
    Box,
    CertificateError,
    CollisionChecker,
    MotionProver,
    Obstacle,
    People,
    Pose,
    RateLimits,
    Robot,
    Scenario,
    Scene,
    certificate,
    time_path,
    verify,
)
from safe_ompl.apps.benchmark import PlainGeometry
from safe_ompl.certificates.verifier.bodies import Separations, farthest
from safe_ompl.certificates.verifier.clamping import PlainGaps, thicknesses
from safe_ompl.certificates.verifier.motion import PlainPiece
from safe_ompl.io.schema import digest
from safe_ompl.scene import find_scenario

WIDTHS = np.array([0.05, 0.2, np.inf])
CELLS, SAMPLES = 6, 8
REACTION = 0.3  # [s]


@pytest.mark.parametrize("name", ["ur5", "panda", "z1"])
def test_no_gap_closes_faster_than_its_bound(name):
    """Random cubics between obstacles: the bounds of a cell hold for all gaps, wherever the robot is in it."""
    rng = np.random.default_rng(sum(map(ord, name)))
    robot = Robot.from_example(name)
    boxes = rng.uniform(-0.8, 0.8, (4, 3))
    scene = Scene(
        tuple(Obstacle(f"box{k}", Box((0.1, 0.2, 0.3)), Pose(tuple(at))) for k, at in enumerate(boxes))
    )
    gaps, plain, closest = Gaps(robot, scene), PlainGaps(robot, scene, ()), 0.0
    for _ in range(3):
        start, first, second, third = rng.uniform(-1, 1, (4, robot.n))
        piece = PlainPiece(start, first, second, third, 0.6)
        edges = np.linspace(0.0, piece.length, CELLS + 1)
        motion = SimpleNamespace(of=[0] * CELLS, edges=edges, starts=[0.0], pieces=[piece])
        bounds = plain.closing(motion, WIDTHS)[1]
        for j, (low, high) in enumerate(pairwise(edges)):
            for s in np.linspace(low, high, SAMPLES):
                gaps.place(piece.at(s), piece.slope(s))
                found = gaps.closing(WIDTHS)
                assert (found <= bounds[j] * (1 + 1e-9)).all()
                closest = max(closest, float((found / np.maximum(bounds[j], 1e-12)).max()))
    assert closest > 0.3  # the bounds are worth something


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


def test_without_a_partner_there_is_no_gap(tmp_path):
    (tmp_path / "arm.urdf").write_text(
        '<robot name="arm"><link name="base"/><link name="arm"><collision><geometry><sphere radius="0.1"/>'
        '</geometry></collision></link><joint name="turn" type="revolute"><parent link="base"/><child link="arm"/>'
        '<axis xyz="0 0 1"/><limit lower="-1" upper="1" velocity="1" effort="1"/></joint></robot>'
    )
    robot = Robot.from_urdf(tmp_path / "arm.urdf", tip="arm")
    piece = PlainPiece(*(np.array([value]) for value in (0.0, 1.0, 0.0, 0.0)), 0.5)
    motion = SimpleNamespace(of=[0], edges=np.array([0.0, 0.5]), starts=[0.0], pieces=[piece])
    swiftness, gaps = PlainGaps(robot, Scene(()), ()).closing(motion, WIDTHS)
    assert 0.1 <= swiftness < 0.11
    assert (gaps == 0).all()


@pytest.mark.parametrize("name", ["ur5", "panda", "z1"])
def test_balls_about_bodies_are_no_farther_apart_than_these(name):
    robot = Robot.from_example(name)
    scene = Scene((Obstacle("box", Box((0.1, 0.2, 0.3)), Pose((0.5, 0.1, 0.3))),))
    gaps, rng = PlainGaps(robot, scene, ()), np.random.default_rng(0)
    for _ in range(5):
        piece = PlainPiece(rng.uniform(-1, 1, robot.n), *rng.uniform(-1, 1, (3, robot.n)), 0.1)
        gaps._speeds.each(piece, 0.05, 0.05)
        places = [gaps._speeds.place_of(link) for link in gaps._links]
        bodies = [*zip((link.geometry for link in gaps._links), places, strict=True), *gaps._obstacles]
        for (a, b), bound in zip(gaps._pairs.tolist(), gaps._balls_apart(places), strict=True):
            assert Separations.distance(*bodies[a], *bodies[b]) >= bound


@pytest.fixture(scope="module")
def handover():
    """Return a UR5 beside a person whom it may touch, and the certificate of a motion of it."""
    scenario = Scenario.load(find_scenario("ur5_handover"))
    robot, scene = scenario.build_robot(), scenario.scene
    start = np.array(scenario.start)
    path = start + np.array([np.zeros(6), [0.3, 0.05, 0, 0, 0, 0], [0.5, 0.15, 0.1, 0, 0, 0]])
    people = People(contact=True, reaction_time=REACTION)
    limits, prover = RateLimits.of(robot, 2.0, 4.0), MotionProver(CollisionChecker(robot, scene))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("safe_ompl.trajectories.timing.CELLS", 20)
        made = time_path(path, robot, limits, motion=prover, people=people)
    content = json.loads(json.dumps(certificate(path, robot, scene, trajectory=made)))
    return robot, scene, made, content


def changed(content, change):
    """Return a certificate with other speeds of contact, and the digest that belongs to it."""
    found = copy.deepcopy(content)
    contact = found["trajectory"]["stops"]["contact"]
    for part, speeds in contact.items():
        contact[part] = change(*speeds)
    return {**found, "digest": digest(found)}


def test_no_limb_is_clamped_faster_than_is_claimed(handover):
    """An adversary puts every limb that may be there, in a motion or a stop, into every gap in which it fits."""
    robot, scene, made, content = handover
    assert (
        "no gap that may clamp the limb across closes faster than" in verify(content, robot, scene).claims[-1]
    )
    assert "clamping" in [cap.name for cap in made.caps]
    stops = content["trajectory"]["stops"]
    (who,), height = stops["who"], scene[stops["who"][0]].shape.height
    parts = [part for part, (_, clamped) in stops["contact"].items() if clamped > 0]
    widths = np.array([thickness(part[len(who) + 1 :], height) for part in parts])
    assert dict(zip(parts, widths, strict=True)) == pytest.approx(
        {part: width for part, width in thicknesses(scene, who).items() if part in parts}
    )
    slow = np.array([stops["contact"][part][1] for part in parts])
    gaps, plain, met = Gaps(robot, scene.without(who)), PlainGeometry(robot, scene), 0
    for begin in np.linspace(0, 0.999 * made.duration, 40):
        stop = made.stop_from(begin)
        for t in np.linspace(0, stop.duration * (1 - 1e-6), 6):
            q, qd, _ = stop.at(float(t))
            near = dict.fromkeys(parts, np.inf)
            for apart, (_, _, part) in zip(plain.distances(q), plain.pairs, strict=True):
                if part in near:
                    near[part] = min(near[part], apart)
            reach = stops["clearance"] + stops["speed"] * (REACTION + t)
            there = np.array([near[part] <= reach for part in parts])
            gaps.place(q, qd)
            met += int(there.sum())
            assert (gaps.closing(widths)[there] <= slow[there] * (1 + 1e-9)).all()
    assert met > 300


def test_slower_gaps_are_refused_whatever_the_speed_of_contact(handover):
    robot, scene, _, content = handover
    with pytest.raises(CertificateError, match="are needed"):
        verify(changed(content, lambda free, clamped: [9.0, 0.8 * clamped]), robot, scene)


def test_slower_contact_is_refused_whatever_the_gaps(handover):
    robot, scene, _, content = handover
    with pytest.raises(CertificateError, match="are needed"):
        verify(changed(content, lambda free, clamped: [0.1 * free, 9.0]), robot, scene)


def test_a_motion_that_is_faster_only_where_a_limb_may_be_clamped_is_refused(handover):
    """With stops as short, no limit of joints or of contact is broken, but that of the gaps."""
    robot, scene, _, content = handover
    faster = changed(content, lambda free, clamped: [9.0, clamped])
    trajectory, factor = faster["trajectory"], 1.5
    trajectory["squares"] = [factor**2 * x for x in trajectory["squares"]]
    trajectory["duration"] /= factor
    trajectory["acceleration"] = [2 * factor**2 * x for x in trajectory["acceleration"]]
    trajectory["velocity"] = [2 * factor * x for x in trajectory["velocity"]]
    trajectory["stops"]["brakes"] = [factor**2 * x for x in trajectory["stops"]["brakes"]]
    with pytest.raises(CertificateError, match="are needed"):
        verify({**faster, "digest": digest(faster)}, robot, scene)
    for speeds in trajectory["stops"]["contact"].values():
        speeds[1] *= factor
    verify({**faster, "digest": digest(faster)}, robot, scene)
