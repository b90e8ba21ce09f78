"""Proofs of motions in scenes of all kinds: robots, obstacles and edges at random, against plain coal calls."""

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from safe_ompl import CertifiedDanger, DangerField, Obstacle, PointCloud, Scene, certificate, verify
from safe_ompl.collision import CollisionChecker, MotionProver, Separation, Verdict
from safe_ompl.geometry import Box, Capsule, Cylinder, Pose, Sphere

ERROR = 2e-5  # [m] of coal's distances


@st.composite
def obstacles(draw):
    size = st.floats(0.02, 0.4)
    shape = draw(
        st.one_of(
            st.builds(lambda a, b, c: Box((a, b, c)), size, size, size),
            st.builds(Sphere, size),
            st.builds(Cylinder, size, size),
            st.builds(Capsule, size, size),
        )
    )
    place = draw(st.tuples(*[st.floats(-0.9, 0.9)] * 2, st.floats(0.0, 1.2)))
    turn = draw(st.tuples(*[st.floats(-3.0, 3.0)] * 3))
    return shape, Pose.from_rpy(place, turn), draw(st.sampled_from([0.0, 1.0, 2.5]))


scenes = st.lists(obstacles(), min_size=1, max_size=4).map(
    lambda found: Scene(
        tuple(Obstacle(f"{k}", shape, pose, weight) for k, (shape, pose, weight) in enumerate(found)), 0.2
    )
)


@pytest.mark.parametrize("name", ["panda", "kinova", "twin_arm", "slider"])
@settings(max_examples=12)
@given(scene=scenes, seed=st.integers(0, 2**32 - 1), length=st.floats(0.0, 1.2), margin=st.floats(0.0, 0.1))
def test_proofs_in_all_kinds_of_scenes(robot_named, plain_check, name, scene, seed, length, margin):
    robot, rng = robot_named(name), np.random.default_rng(seed)
    checker, plain = CollisionChecker(robot, scene), plain_check(robot, scene)
    start = rng.uniform(robot.lower, robot.upper)
    end = start + length * rng.normal(size=robot.n) / np.sqrt(robot.n)
    end = np.where(robot.continuous, end, np.clip(end, robot.lower, robot.upper))
    edge = start + np.linspace(0, 1, 60)[:, None] * robot.difference(start, end)
    of_obstacles = np.array([other in scene.names for _, other in plain.pairs])
    apart = np.array([plain.distances(q) for q in edge])

    if MotionProver(checker).is_free(start, end):
        assert apart.min() > -ERROR
        assert verify(certificate([start, end], robot, scene), robot, scene).edges == 1
    motion = MotionProver(checker, separation=Separation(margin=margin))
    found = motion.check(start, end)
    if found.verdict is Verdict.FREE:
        assert apart[:, of_obstacles].min() > margin - ERROR
    elif found.verdict is Verdict.BLOCKED:
        there = plain.distances(start + found.at * robot.difference(start, end))
        assert there[of_obstacles].min() < margin + ERROR or there.min() < ERROR

    points, weights, _ = scene.danger_points()
    if len(points):
        field = DangerField(robot, points, weights)
        bounds = CertifiedDanger(field).of_path([start, end])
        assert field.values(edge).max() <= bounds.upper * (1 + 1e-9)


# ------------------------------------------- a checker with a large cloud never misses what balls, one by one, woul


RADIUS = 0.02


@pytest.fixture(scope="module")
def scan():
    """Return a patch of a wall and of a table, as a camera sees them."""
    rng = np.random.default_rng(2)
    wall = np.column_stack([rng.normal(0.55, 0.002, 120), rng.uniform(-0.4, 0.4, 120), rng.uniform(0.2, 0.8, 120)])
    table = np.column_stack([rng.uniform(0.2, 0.8, 120), rng.uniform(-0.4, 0.4, 120), rng.normal(0.1, 0.002, 120)])
    return np.concatenate([wall, table])


def test_a_certificate_beside_a_large_cloud_verifies(panda, scan):
    scene = Scene((Obstacle("scan", PointCloud(RADIUS, points=np.tile(scan, (20, 1)))),))
    path = [[-1.8, -0.9, 0.0, -2.4, 0.0, 1.8, 0.8], [-2.4, -0.7, 0.1, -2.2, 0.1, 1.9, 0.6]]
    assert verify(certificate(path, panda, scene), panda, scene).edges == 1
