"""Proofs of motions in scenes of all kinds: robots, obstacles and edges at random, against plain coal calls."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from safe_ompl import CertifiedDanger, DangerField, Scene, certificate, verify
from safe_ompl.collision import CertifiedMotion, CollisionChecker, Verdict
from safe_ompl.geometry import Box, Capsule, Cylinder, Obstacle, Pose, Sphere

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

    if CertifiedMotion(checker).is_free(start, end):
        assert apart.min() > -ERROR
        assert verify(certificate([start, end], robot, scene), robot, scene).edges == 1
    motion = CertifiedMotion(checker).with_margin(margin)
    found = motion.check(start, end)
    if found.verdict is Verdict.FREE:
        assert apart[:, of_obstacles].min() > margin - ERROR
    elif found.verdict is Verdict.BLOCKED:
        there = plain.distances(start + found.at * robot.difference(start, end))
        assert there[of_obstacles].min() < margin + ERROR or there.min() < ERROR

    points, weights, _ = scene.danger_points()
    if len(points):
        field = DangerField(robot, points, weights)
        bounds = CertifiedDanger(field).of_edge(start, end)
        assert field.values(edge).max() <= bounds.upper * (1 + 1e-9)
