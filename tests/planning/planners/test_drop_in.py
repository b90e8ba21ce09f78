"""Our planners on OMPL's own kinds of problems: any space of straight motions, checker, validator, objective, goal."""

from __future__ import annotations

import logging
from itertools import pairwise
from math import cos, hypot, sin

import numpy as np
import pytest
from ompl import base as ob
from ompl import geometric as og

from safe_ompl import SafePRM, SafeRRTConnect, SafeSetup, Scenario
from safe_ompl.planning import setup_scenario
from safe_ompl.scene import find_scenario

PLANNERS = [SafeRRTConnect, SafePRM]


def bounds(n, low, high):
    box = ob.RealVectorBounds(n)
    box.setLow(low)
    box.setHigh(high)
    return box


def state_at(space, values):
    state = space.allocState()
    space.copyFromReals(state, values)
    return state


class StateCosts(ob.OptimizationObjective):
    """A cost of states, and of motions the mean of their ends times the length."""

    def __init__(self, si, cost):
        super().__init__(si)
        self._space, self._cost = si.getStateSpace(), cost
        self.asked = 0

    def stateCost(self, state):
        self.asked += 1
        return ob.Cost(self._cost(state))

    def motionCost(self, start, end):
        ends = self._cost(start) + self._cost(end)
        return ob.Cost(ends / 2 * self._space.distance(start, end))


def solved(setup, planner, seconds=10.0):
    planner.setSeed(1)
    setup.setPlanner(planner)
    assert setup.solve(seconds).getStatus() == ob.PlannerStatus.EXACT_SOLUTION
    path = setup.getSolutionPath()
    assert path.check()
    return path


# ------------------------------------------------------------------------- a point in the plane (OptimalPlanning)


def disc_clearance(state):
    """Distance from the disc in the middle of the unit square, as in OMPL's demo."""
    return hypot(state[0] - 0.5, state[1] - 0.5) - 0.25


def point_setup():
    space = ob.RealVectorStateSpace(2)
    space.setBounds(bounds(2, 0.0, 1.0))
    setup = og.SimpleSetup(space)
    setup.setStateValidityChecker(lambda state: bool(disc_clearance(state) > 0.0))
    space.setup()
    setup.setStartAndGoalStates(state_at(space, [0.0, 0.2]), state_at(space, [1.0, 0.8]))
    return setup


def least_clearance(path):
    rows = np.array([path.getState(i)[0:2] for i in range(path.getStateCount())])
    along = np.vstack([a + t * (b - a) for a, b in pairwise(rows) for t in np.linspace(0, 1, 20)[:, None]])
    return float(np.mean(np.hypot(*(along - 0.5).T) - 0.25))


@pytest.mark.parametrize("kind", PLANNERS)
def test_a_point_that_keeps_clear_of_a_disc(kind):
    clear = []
    for danger in (False, True):
        found = []
        for seed in range(15):
            setup = point_setup()
            objective = StateCosts(setup.getSpaceInformation(), lambda state: 1 / max(disc_clearance(state), 1e-3))
            if danger:
                setup.setOptimizationObjective(objective)
            planner = kind(setup.getSpaceInformation(), alpha=5.0)
            planner.setSeed(seed)
            setup.setPlanner(planner)
            assert setup.solve(10.0)
            assert setup.getSolutionPath().check()
            found.append(least_clearance(setup.getSolutionPath()))
            assert bool(objective.asked) is danger
        clear.append(np.mean(found))
    assert clear[1] > clear[0] + 0.02


# -------------------------------------------------------------------------------------- a planar chain (KinematicChain)

LINKS = 6


def joints_of_chain(state, n):
    angles = np.cumsum(state[0:n])
    return np.vstack([[0.0, 0.0], np.cumsum(np.stack([np.cos(angles), np.sin(angles)], axis=1), axis=0) / n])


def chain_is_free(points):
    """Whether the chain crosses neither itself nor the walls of a horn, as in OMPL's demo."""
    walls = [((0.35, 0.12), (1.0, 0.4)), ((0.35, -0.12), (1.0, -0.4))]
    links = list(pairwise(points.tolist()))
    for k, link in enumerate(links):
        if any(crosses(link, wall) for wall in walls) or any(crosses(link, other) for other in links[k + 2 :]):
            return False
    return True


def crosses(one, other):
    def side(p, q, r):
        return (q[0] - p[0]) * (r[1] - p[1]) - (q[1] - p[1]) * (r[0] - p[0])

    return (side(*one, other[0]) > 0) != (side(*one, other[1]) > 0) and (side(*other, one[0]) > 0) != (
        side(*other, one[1]) > 0
    )


@pytest.mark.parametrize("kind", PLANNERS)
def test_a_planar_chain(kind):
    space = ob.CompoundStateSpace()
    for _ in range(LINKS):
        space.addSubspace(ob.SO2StateSpace(), 1.0)
    setup = og.SimpleSetup(space)
    angles = [0.0] * LINKS

    def points(state):
        angles[:] = [state[k].value for k in range(LINKS)]
        return joints_of_chain(angles, LINKS)

    setup.setStateValidityChecker(lambda state: chain_is_free(points(state)))
    space.setup()
    start, goal = [0.0] * LINKS, [2.2] + [0.1] * (LINKS - 1)
    setup.setStartAndGoalStates(state_at(space, start), state_at(space, goal))
    setup.setOptimizationObjective(
        StateCosts(setup.getSpaceInformation(), lambda state: 1 / (0.1 + abs(points(state)[-1, 0] - 1.0)))
    )
    path = solved(setup, kind(setup.getSpaceInformation()))
    first, last = (points(path.getState(k)) for k in (0, path.getStateCount() - 1))
    np.testing.assert_allclose(first, joints_of_chain(start, LINKS), atol=1e-9)
    np.testing.assert_allclose(last, joints_of_chain(goal, LINKS), atol=1e-9)


# -------------------------------------------------------------------- a rigid body in the plane (RigidBodyPlanning)


def corners(state):
    """Return points on a bar of 0.8 by 0.1, which fits through the gap in one direction only."""
    c, s = cos(state.getYaw()), sin(state.getYaw())
    return [
        (state.getX() + c * x - s * y, state.getY() + s * x + c * y)
        for x in np.linspace(-0.4, 0.4, 9)
        for y in (-0.05, 0.05)
    ]


def body_is_free(state):
    return all(abs(x) > 0.05 or abs(y) < 0.25 for x, y in corners(state))


def body_setup():
    space = ob.SE2StateSpace()
    space.setBounds(bounds(2, -2.0, 2.0))
    setup = og.SimpleSetup(space)
    setup.setStateValidityChecker(body_is_free)
    setup.getSpaceInformation().setStateValidityCheckingResolution(0.002)
    space.setup()
    return setup


@pytest.mark.parametrize("kind", PLANNERS)
def test_a_rigid_body_turns_to_pass_a_gap(kind):
    setup = body_setup()
    space = setup.getStateSpace()
    setup.setStartAndGoalStates(state_at(space, [-1.0, 0.0, 1.57]), state_at(space, [1.0, 0.5, 1.57]))
    setup.setOptimizationObjective(StateCosts(setup.getSpaceInformation(), lambda state: abs(state.getY())))
    path = solved(setup, kind(setup.getSpaceInformation()), 30.0)
    assert path.getState(0).getX() == pytest.approx(-1.0)
    assert path.getState(path.getStateCount() - 1).getY() == pytest.approx(0.5)


# ------------------------------------------------------------------------- without objective, and with own validator


@pytest.mark.parametrize("kind", PLANNERS)
def test_without_an_objective_it_says_so(kind, caplog):
    setup = point_setup()
    with caplog.at_level(logging.INFO):
        solved(setup, kind(setup.getSpaceInformation()))
    assert "no danger objective; planning is classical" in caplog.text


@pytest.mark.parametrize("kind", PLANNERS)
def test_the_users_motion_validator_is_asked(kind):
    class NeverDown(ob.MotionValidator):
        asked = 0

        def checkMotion(self, start, end):
            NeverDown.asked += 1
            return bool(end[1] >= start[1] - 1e-9)

    setup = point_setup()
    setup.getSpaceInformation().setMotionValidator(NeverDown(setup.getSpaceInformation()))
    path = solved(setup, kind(setup.getSpaceInformation()))
    heights = [path.getState(i)[1] for i in range(path.getStateCount())]
    assert np.diff(heights).min() >= -1e-9
    assert NeverDown.asked


# ------------------------------------------------------------------------------------------------- starts and goals


class Anywhere(ob.GoalSampleableRegion):
    """The right edge of the square, point after point."""

    def __init__(self, si):
        super().__init__(si)
        self.setThreshold(1e-6)
        self._rng = np.random.default_rng(0)

    def distanceGoal(self, state):
        return 1.0 - state[0]

    def maxSampleCount(self):
        return 1000

    def couldSample(self):
        return True

    def sampleGoal(self, state):
        state[0:2] = [1.0, float(self._rng.random())]


@pytest.mark.parametrize("kind", PLANNERS)
@pytest.mark.parametrize("goal", ["state", "states", "region"])
def test_goals_and_several_starts(kind, goal):
    setup = point_setup()
    space, si = setup.getStateSpace(), setup.getSpaceInformation()
    setup.clearStartStates()
    starts = [[0.1, 0.1], [0.1, 0.9], [0.5, 0.5]]  # the last is in the disc
    for start in starts:
        setup.addStartState(state_at(space, start))
    if goal == "state":
        setup.setGoalState(state_at(space, [1.0, 0.5]))
    elif goal == "states":
        several = ob.GoalStates(si)
        for place in ([0.5, 0.6], [1.0, 0.2], [1.0, 0.7]):  # the first is in the disc
            several.addState(state_at(space, place))
        setup.setGoal(several)
    else:
        setup.setGoal(Anywhere(si))
    path = solved(setup, kind(si))
    ends = [path.getState(k)[0:2] for k in (0, path.getStateCount() - 1)]
    assert ends[0] in starts[:2]
    assert ends[1][0] == 1.0


@pytest.mark.parametrize("planner", ["SafeRRTConnect", "SafePRM", "BubblePlanner"])
@pytest.mark.parametrize("goal", ["place", "configurations"])
def test_a_robots_goals(planner, goal):
    scenario = Scenario.load(find_scenario("planar3"))
    setup: SafeSetup = setup_scenario(scenario)
    start, end = scenario.start_configuration(setup.robot), scenario.goal_configurations(setup.robot)[0]
    if goal == "place":
        setup = SafeSetup(setup.robot, scenario.scene)
        setup.setStartConfiguration(start)
        setup.setWorkspaceGoal(scenario.goal.position)
    else:
        goals = [end, end + np.array([0.05, 0.0, 0.0]), start + np.array([0.1, 0.0, 0.0])]
        setup.setConfigurations(start, goals)
    result = setup.plan(planner, time=10.0, seed=2)
    assert result.report.certified
    tip = setup.robot.tip_pose(result.path[-1]).translation
    if goal == "place":
        assert np.linalg.norm(tip - scenario.goal.position) <= scenario.goal.tolerance
    else:
        assert any(np.array_equal(result.path[-1], q) for q in goals)
