"""What is called free is free everywhere, and what is called blocked has a witness: against plain coal calls.

Robots, obstacles, edges and what must be kept are drawn at random.
"""

import numpy as np
import pytest
from edges import random_edge
from hypothesis import given, settings, strategies as st

from safe_ompl import DangerField, Obstacle, PointCloud, Scene, certificate, verify
from safe_ompl.collision import CollisionChecker, MotionProver, Separation, Verdict
from safe_ompl.geometry import Box, Capsule, Cylinder, Pose, Sphere

ROBOTS = ["panda", "kinova", "twin_arm", "slider", "gripper", "parallel", "placed", "loaded", "mobile", "cell"]
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

# What must be kept of a distance [m], and how near each obstacle may come for that: all, the first, or the first, which
# moves for 0.5 s.
KEPT = {
    "nothing": lambda checker, distance: (Separation(), {}),
    "a margin": lambda checker, distance: (Separation(margin=distance), dict.fromkeys(checker.scene.names, distance)),
    "a clearance": lambda checker, away: (Separation().with_min_clearance(checker, away, ["0"]), {"0": away}),
    "clear of what moves": lambda checker, away: (Separation(speeds={"0": 2 * away}, time=0.5), {"0": away}),
}


@pytest.mark.parametrize("name", ROBOTS)
@settings(max_examples=10)
@given(
    scene=scenes,
    seed=st.integers(0, 2**32 - 1),
    length=st.floats(0.0, 1.5),
    kind=st.sampled_from(list(KEPT)),
    distance=st.floats(0.001, 0.2),
)
def test_no_verdict_is_refuted_by_plain_coal(robot_named, plain_check, name, scene, seed, length, kind, distance):
    robot = robot_named(name)
    checker, plain = CollisionChecker(robot, scene), plain_check(robot, scene)
    separation, required = KEPT[kind](checker, distance)
    least = np.array([required.get(other, 0.0) for _, other in plain.pairs])
    start, end = random_edge(robot, seed, length)
    edge = start + np.linspace(0, 1, 30)[:, None] * robot.difference(start, end)
    motion = MotionProver(checker, separation=separation)
    found = motion.check(start, end)
    assert motion.is_free(start, end) == (found.verdict is Verdict.FREE)
    if found.verdict is Verdict.FREE:
        assert min((plain.distances(q) - least).min() for q in edge) > -ERROR
        if kind == "nothing":
            points, weights, _ = scene.danger_points()
            field = DangerField(robot, points, weights) if len(points) else None
            assert verify(certificate([start, end], robot, scene, field=field), robot, scene).edges == 1
    else:
        there = start + found.at * robot.difference(start, end)
        spare = plain.distances(there) - least
        if found.verdict is Verdict.BLOCKED:
            named = [left for pair, left in zip(plain.pairs, spare, strict=True) if pair == found.pair]
            assert min(named) < ERROR
            assert checker.in_collision(there) or motion.required.violated(there)
        else:
            assert spare.min() < 2 * motion.floor + ERROR


def test_a_certificate_beside_a_large_cloud_verifies(panda):
    """A patch of a wall and of a table, as a camera sees them."""
    rng = np.random.default_rng(2)
    wall = np.column_stack([rng.normal(0.55, 0.002, 120), rng.uniform(-0.4, 0.4, 120), rng.uniform(0.2, 0.8, 120)])
    table = np.column_stack([rng.uniform(0.2, 0.8, 120), rng.uniform(-0.4, 0.4, 120), rng.normal(0.1, 0.002, 120)])
    points = np.tile(np.concatenate([wall, table]), (20, 1))
    scene = Scene((Obstacle("scan", PointCloud(0.02, points=points)),))
    path = [[-1.8, -0.9, 0.0, -2.4, 0.0, 1.8, 0.8], [-2.4, -0.7, 0.1, -2.2, 0.1, 1.9, 0.6]]
    assert verify(certificate(path, panda, scene), panda, scene).edges == 1
