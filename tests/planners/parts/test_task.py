"""The problem as planners see it: what they ask directly is what OMPL would be told."""

from __future__ import annotations

import numpy as np

from safe_ompl import Robot, SafeSetup, Scene
from safe_ompl.planners.parts.task import Task
from safe_ompl.scene.obstacle import Obstacle
from safe_ompl.scene.pose import Pose
from safe_ompl.scene.shapes.basic import Box


def test_motions_are_free_that_the_motion_validator_calls_free():
    robot = Robot.from_example("ur5")
    scene = Scene((Obstacle("box", Box((0.3, 0.3, 0.6)), Pose((0.45, 0.0, 0.3))),))
    si = SafeSetup(robot, scene).getSpaceInformation()
    bounds = si.getStateSpace().getBounds()
    bounds.setHigh(0, 1.0)  # narrower than the robot's own
    si.getStateSpace().setBounds(bounds)
    task, rng = Task(si), np.random.default_rng(0)
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
