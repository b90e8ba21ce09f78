"""Room at configurations: bounds that are never too large, computed once, and renewed when obstacles move."""

from __future__ import annotations

import numpy as np
import pytest

from safe_ompl import CollisionChecker, Robot, Scene
from safe_ompl.collision.motion import CertifiedMotion
from safe_ompl.planners.parts.room import Room
from safe_ompl.scene.obstacle import Obstacle
from safe_ompl.scene.pose import Pose
from safe_ompl.scene.shapes.basic import Box

ENOUGH = 0.06  # [m]


@pytest.fixture
def motion():
    scene = Scene((Obstacle("box", Box((0.1, 0.1, 0.4)), Pose((0.45, 0.0, 0.3))),))
    return CertifiedMotion(CollisionChecker(Robot.from_example("ur5"), scene, movable=("box",)))


def free_configurations(motion, count):
    robot, rng = motion.checker.robot, np.random.default_rng(0)
    candidates = (rng.uniform(robot.lower, robot.upper) for _ in range(50 * count))
    free = [q for q in candidates if not motion.checker.in_collision(q)]
    return free[:count]


def test_it_is_the_clearance_or_hardly_less(motion):
    room, near = Room(), 0
    for q in free_configurations(motion, 400):
        clearance = motion.checker.clearance(q).distance
        near += clearance < ENOUGH
        assert room.is_enough(motion, q, min(ENOUGH, 0.9 * clearance))
        assert not room.is_enough(motion, q, clearance + 1e-4)
    assert near > 5


def test_bounds_of_a_configuration_are_computed_once(motion):
    room, q = Room(), free_configurations(motion, 1)[0]
    before = motion.checker.counts.copy()
    for margin in (ENOUGH, 0.03, 0.001):
        room.is_enough(motion, q, margin)
    assert (motion.checker.counts - before).queries == 1


def test_they_follow_obstacles_that_move(motion):
    room, q = Room(), free_configurations(motion, 1)[0]
    assert room.is_enough(motion, q, 0.001)
    tip = motion.checker.robot.tip_pose(q).translation
    motion.checker.move(motion.checker.scene.moved({"box": Pose(tuple(tip.tolist()))}))
    assert not room.is_enough(motion, q, 0.001)
