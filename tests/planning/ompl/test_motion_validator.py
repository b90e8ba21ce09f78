"""The certified check as OMPL's motion validator."""

import numpy as np
import pytest
from ompl import base as ob

from safe_ompl import CertifiedMotionValidator, CollisionChecker, CollisionFreeValidity, Verdict
from safe_ompl.common import Counts
from safe_ompl.planning.ompl import ScratchState, StateBridge, joint_space


class Setting:
    """A space information with certified motions."""

    def __init__(self, robot, scene):
        self.robot = robot
        self.si = ob.SpaceInformation(joint_space(robot))
        self.checker = CollisionChecker(robot, scene)
        self.si.setStateValidityChecker(CollisionFreeValidity(self.si, self.checker))
        self.validator = CertifiedMotionValidator(self.si, self.checker)
        self.si.setMotionValidator(self.validator)
        self.si.setup()
        self.bridge = StateBridge(self.si.getStateSpace())
        self.ends = ScratchState(self.bridge), ScratchState(self.bridge)

    def check(self, start, end):
        return self.si.checkMotion(self.ends[0].set(start), self.ends[1].set(end))


@pytest.fixture(scope="module", params=["ur5", "kinova"])
def setting(request, robot_named, clutter):
    return Setting(robot_named(request.param), clutter)


def test_answers_of_ompl_are_those_of_the_certified_check(setting, rng):
    robot, answers = setting.robot, []
    for start in rng.uniform(robot.lower, robot.upper, (60, robot.n)):
        end = setting.bridge.inside(start + 0.3 * rng.normal(size=robot.n))
        answer = setting.check(start, end)
        assert answer is (setting.validator.motion.check(start, end).verdict is Verdict.FREE)
        answers.append(answer)
    assert set(answers) == {True, False}


def test_a_motion_over_the_half_turn_is_short(kinova, clutter):
    setting = Setting(kinova, clutter)
    start = np.array([3.1, 2.9, 1.3, 3.1, 1.8, -3.1])
    end = np.array([-3.1, 2.9, 1.3, -3.1, 1.8, 3.1])
    assert setting.check(start, end) is True
    assert setting.checker.counts.bound_queries + setting.checker.counts.margin_queries <= 4


def test_motions_that_leave_the_limits_are_refused(setting):
    robot = setting.robot
    inside = (robot.lower + robot.upper) / 2
    for i in np.flatnonzero(~robot.continuous):
        outside = inside.copy()
        outside[i] = robot.upper[i] + 0.1
        setting.checker.counts.reset()
        assert setting.check(inside, outside) is False
        assert setting.check(outside, inside) is False
        assert setting.checker.counts == Counts()


def test_motions_that_are_not_numbers_are_refused(setting):
    inside = (setting.robot.lower + setting.robot.upper) / 2
    broken = inside.copy()
    broken[np.flatnonzero(~setting.robot.continuous)[0]] = np.nan
    assert setting.check(inside, broken) is False
    assert setting.check(broken, inside) is False
