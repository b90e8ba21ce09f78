"""Paths of others, as of OMPL's own SimpleSetup, are proven or repaired."""

import numpy as np
import pytest
from ompl import geometric as og

import safe_ompl
from safe_ompl import Box, Obstacle, Pose, SafeSetup, Scene
from safe_ompl.robot import ScratchState, StateBridge, joint_space

START = np.array([-0.8, 0.3, 0.0, -2.0, 0.0, 2.3, 0.8])
GOAL = START * [-1, 1, 1, 1, 1, 1, 1]


@pytest.fixture(scope="module")
def wall():
    """Return a wall that the straight motion goes through, and a motion over it does not."""
    return Scene([Obstacle("wall", Box((0.5, 0.04, 0.4)), Pose((0.5, 0.0, 0.2)), weight=1.0)])


@pytest.fixture
def setup(panda, wall):
    setup = SafeSetup(panda, wall)
    setup.setConfigurations(START, GOAL)
    return setup


def test_the_path_of_a_plain_simple_setup_is_repaired_in_one_call(panda, wall):
    space = joint_space(panda)
    plain = og.SimpleSetup(space)
    bridge = StateBridge(space)
    plain.setStateValidityChecker(lambda state: True)  # a careless one
    start, goal = ScratchState(bridge), ScratchState(bridge)
    plain.setStartAndGoalStates(start.set(START), goal.set(GOAL))
    plain.setPlanner(og.RRTConnect(plain.getSpaceInformation()))
    assert plain.solve(5.0)
    found = safe_ompl.repair(plain, panda, wall, time=10.0)
    assert found, found
    assert safe_ompl.check(found.path, panda, wall)
    np.testing.assert_allclose(found.path[[0, -1]], [START, GOAL], atol=1e-9)


def test_a_setup_checks_under_its_own_constraints(setup, panda, wall):
    path = setup.plan(time=20.0, simplify=1.0).path
    assert setup.check(path)
    least = setup.report(path).clearance.min
    strict = SafeSetup(panda, wall)
    strict.setMinClearance(least + 0.02)
    found = strict.check(path)
    assert not found
    assert found.violations[0].kind == "clearance"
    assert found.violations[0].limit == pytest.approx(least + 0.02, abs=1e-4)
