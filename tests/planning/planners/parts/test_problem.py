"""The problem as planners see it: what they ask directly is what OMPL would be told; and clearances, asked for once."""

from __future__ import annotations

import numpy as np
import pytest

from safe_ompl import Box, CollisionChecker, MotionProver, Obstacle, Pose, Robot, SafeSetup, Scene
from safe_ompl.planning.planners.parts.clearance import ClearanceCache
from safe_ompl.planning.planners.parts.problem import PlanningProblem

ENOUGH = 0.06  # [m]


def test_motions_are_free_that_the_motion_validator_calls_free():
    robot = Robot.from_example("ur5")
    scene = Scene((Obstacle("box", Box((0.3, 0.3, 0.6)), Pose((0.45, 0.0, 0.3))),))
    si = SafeSetup(robot, scene).getSpaceInformation()
    bounds = si.getStateSpace().getBounds()
    bounds.setHigh(0, 1.0)  # narrower than the robot's own
    si.getStateSpace().setBounds(bounds)
    task, rng = PlanningProblem(si), np.random.default_rng(0)
    bridge, verdicts = task.bridge, []
    for _ in range(100):
        start = rng.uniform(robot.lower, robot.upper)
        end = start + rng.uniform(-0.5, 0.5, robot.n)
        states = [si.allocState(), si.allocState()]
        for q, state in zip((start, end), states, strict=True):
            bridge.write(q, state)
        verdicts.append(task.motion_is_free(start, end))
        assert verdicts[-1] == si.checkMotion(*states)
    assert 10 < sum(verdicts) < 90


# ------------------------------------------------------------------------------------------ clearances


@pytest.fixture
def motion():
    scene = Scene((Obstacle("box", Box((0.1, 0.1, 0.4)), Pose((0.45, 0.0, 0.3))),))
    return MotionProver(CollisionChecker(Robot.from_example("ur5"), scene, movable=("box",)))


def free_configurations(motion, count):
    robot, rng = motion.checker.robot, np.random.default_rng(0)
    candidates = (rng.uniform(robot.lower, robot.upper) for _ in range(50 * count))
    free = [q for q in candidates if not motion.checker.in_collision(q)]
    return free[:count]


def test_it_is_the_clearance_or_hardly_less(motion):
    cache, near = ClearanceCache(), 0
    for q in free_configurations(motion, 400):
        clearance = motion.checker.clearance(q).distance
        near += clearance < ENOUGH
        assert cache.keeps(motion, q, min(ENOUGH, 0.9 * clearance))
        assert not cache.keeps(motion, q, clearance + 1e-4)
    assert near > 5


def test_bounds_of_a_configuration_are_computed_once(motion):
    cache, q = ClearanceCache(), free_configurations(motion, 1)[0]
    before = motion.checker.counts.copy()
    for margin in (ENOUGH, 0.03, 0.001):
        cache.keeps(motion, q, margin)
    assert (motion.checker.counts - before).queries == 1


def test_they_follow_obstacles_that_move(motion):
    cache, q = ClearanceCache(), free_configurations(motion, 1)[0]
    assert cache.keeps(motion, q, 0.001)
    tip = motion.checker.robot.tip_pose(q).translation
    motion.checker.move(motion.checker.scene.moved({"box": Pose(tuple(tip.tolist()))}))
    assert not cache.keeps(motion, q, 0.001)
