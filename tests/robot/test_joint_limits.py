"""The quick look at joint limits says what the robot's own one does."""

import numpy as np
import pytest

from safe_ompl.robot import JointLimits


@pytest.mark.parametrize("name", ["ur5", "kinova", "twin_arm"])
def test_as_the_robot_says(robot_named, rng, name):
    robot = robot_named(name)
    limits = JointLimits(robot)
    answers = set()
    for q in rng.uniform(1.2 * robot.lower - 0.01, 1.2 * robot.upper + 0.01, (200, robot.n)):
        answers.add(limits.hold(q))
        assert limits.hold(q) is bool(robot.within_limits(q).all())
    assert answers == {True, False}


def test_what_is_not_finite_is_outside(kinova):
    for bad in (np.nan, np.inf, -np.inf):
        for joint in range(kinova.n):
            q = np.zeros(kinova.n)
            q = np.clip(q, kinova.lower, kinova.upper)
            q[joint] = bad
            assert JointLimits(kinova).hold(q) is False
