"""State validity as OMPL asks for it: real booleans, limits, NaN, collision, clearance."""

import numpy as np
import pytest
from ompl import base as ob

from safe_ompl import CollisionChecker, CollisionFreeValidity
from safe_ompl.planning.ompl import ScratchState, StateBridge, joint_space


class Setting:
    """A space information with the validity of a robot among obstacles."""

    def __init__(self, robot, scene):
        self.si = ob.SpaceInformation(joint_space(robot))
        self.checker = CollisionChecker(robot, scene)
        self.validity = CollisionFreeValidity(self.si, self.checker)
        self.si.setStateValidityChecker(self.validity)
        self.si.setup()
        self.bridge = StateBridge(self.si.getStateSpace())
        self.scratch = ScratchState(self.bridge)

    def is_valid(self, q):
        return self.si.isValid(self.scratch.set(np.asarray(q, dtype=float)))


@pytest.fixture(scope="module", params=["ur5", "kinova", "twin_arm"])
def setting(request, robot_named, clutter):
    return Setting(robot_named(request.param), clutter)


def test_valid_is_free_of_collision(setting, plain_check, clutter, rng):
    robot = setting.checker.robot
    plain = plain_check(robot, clutter)
    answers = set()
    for q in rng.uniform(robot.lower, robot.upper, (80, robot.n)):
        nearest = plain.nearest(q)
        if abs(nearest) > 3e-5:
            answer = setting.is_valid(q)
            assert answer is (nearest > 0)
            answers.add(answer)
    assert answers == {True, False}


def free_configuration(setting, rng):
    robot = setting.checker.robot
    return next(q for q in rng.uniform(robot.lower, robot.upper, (500, robot.n)) if not setting.checker.in_collision(q))


def test_not_a_number_is_never_valid(setting, rng):
    q = free_configuration(setting, rng)
    assert setting.is_valid(q) is True
    for i in range(len(q)):
        for bad in (np.nan, np.inf, -np.inf):
            state = setting.scratch.set(q)
            reals = [*q[:i], bad, *q[i + 1 :]]  # past the bridge, which would wrap it
            setting.si.getStateSpace().copyFromReals(state, reals)
            assert setting.si.isValid(state) is False


def test_outside_the_limits_is_not_valid(setting, rng):
    robot = setting.checker.robot
    q = free_configuration(setting, rng)
    for i in np.flatnonzero(~robot.continuous):
        for limit, outward in ((robot.lower, -1e-3), (robot.upper, 1e-3)):
            beyond = q.copy()
            beyond[i] = limit[i] + outward
            assert setting.is_valid(beyond) is False


def test_limits_cost_no_collision_query(setting):
    setting.checker.counts.reset()
    robot = setting.checker.robot
    assert setting.is_valid(np.where(robot.continuous, 0.0, robot.upper + 1)) is False
    assert setting.checker.counts.collision_queries == 0


def test_whole_turns_are_the_same_state(kinova, clutter, rng):
    setting = Setting(kinova, clutter)
    turns = 2 * np.pi * kinova.continuous
    for q in rng.uniform(kinova.lower, kinova.upper, (20, 6)):
        assert setting.is_valid(q + turns) is setting.is_valid(q)


def test_clearance_is_the_distance_to_the_obstacles(setting, rng):
    q = free_configuration(setting, rng)
    clearance = setting.validity.clearance(setting.scratch.set(q))
    assert isinstance(clearance, float)
    assert clearance == pytest.approx(setting.checker.clearance(q).distance)
    assert clearance > 0
    through_ompl = setting.si.getStateValidityChecker().clearance(setting.scratch.set(q))
    assert through_ompl == pytest.approx(clearance, abs=1e-12)
