"""A setup that has solved one query answers the next one, whichever planner and however it is asked."""

from itertools import pairwise

import numpy as np
import pytest
from ompl import base as ob
from planar import MOTION, OTHER_START, begun, build, solved, state

from safe_ompl import DangerObjective, InputError, Obstacle, Pose, Sphere
from safe_ompl.planning.planners import SafeRRTConnect, needs_place, planner_names
from safe_ompl.planning.simplification import Curve

PLANNERS = [
    name
    for name in planner_names()
    if not needs_place(name) and not name.startswith("Paper") and name not in ("InformedRRTstar", "SORRTstar")
]
SHARES = np.linspace(0, 1, 20)
OTHER_MOTION = np.array([0.5, 0.15, -0.1])


def states(setup, *rows):
    goal = ob.GoalStates(setup.getSpaceInformation())
    for q in rows:
        goal.addState(state(setup, q))
    return goal


# -------------------------------------------------------------------------------------------- another start or goal

ASK = {
    "setConfigurations": lambda setup, start, goal: setup.setConfigurations(start, goal),
    "setStartConfiguration": lambda setup, start, goal: (
        setup.setStartConfiguration(start),
        setup.setGoalState(state(setup, goal)),
    ),
    "setStartState": lambda setup, start, goal: (
        setup.setStartState(state(setup, start)),
        setup.setGoal(states(setup, goal)),
    ),
    "addStartState": lambda setup, start, goal: (
        setup.clearStartStates(),
        setup.addStartState(state(setup, start)),
        setup.setGoalState(state(setup, goal)),
    ),
    "setStartAndGoalStates": lambda setup, start, goal: setup.setStartAndGoalStates(
        state(setup, start), state(setup, goal)
    ),
    "setWorkspaceGoal": lambda setup, start, goal: (
        setup.setStartConfiguration(start),
        setup.setWorkspaceGoal(setup.robot.tip_pose(goal).translation, tolerance=1e-3),
    ),
    "problem definition": lambda setup, start, goal: setup.getProblemDefinition().setStartAndGoalStates(
        state(setup, start), state(setup, goal)
    ),
}


WAYS_OF_ASKING = [
    *((name, "setConfigurations") for name in PLANNERS),
    *(("SafePRM", ask) for ask in ASK),
    *((name, "setWorkspaceGoal") for name in ("SafeJTRRT", "ClassicJTRRT")),
]


@pytest.mark.parametrize(("name", "ask"), WAYS_OF_ASKING)
def test_the_next_query_is_answered(name, ask):
    setup, start = begun(name)
    start = start + OTHER_START
    goal = start + OTHER_MOTION
    ASK[ask](setup, start, goal)
    assert not setup.haveSolutionPath()
    assert not setup.haveExactSolutionPath()
    with pytest.raises(InputError, match="there is no solution"):
        setup.solution()
    path = solved(setup, name)
    np.testing.assert_allclose(path[0], start, atol=1e-9)
    tips = [setup.robot.tip_pose(q).translation for q in (path[-1], goal)]
    np.testing.assert_allclose(*tips, atol=1e-9 if isinstance(setup.getGoal(), (ob.GoalState, ob.GoalStates)) else 1e-3)


def test_in_ompls_words_start_and_goal_are_those_that_are_checked_and_looked_at():
    setup, start = build()
    setup.setWorkspaceGoal(setup.robot.tip_pose(start + MOTION).translation)
    goal = states(setup, start + OTHER_MOTION)
    setup.setStartAndGoalStates(state(setup, start + OTHER_START), state(setup, start))
    np.testing.assert_allclose(setup.query.start, start + OTHER_START, atol=1e-12)
    setup.setGoal(goal)
    result = setup.plan(seed=1)
    np.testing.assert_allclose(result.path[[0, -1]], [start + OTHER_START, start + OTHER_MOTION], atol=1e-12)
    assert setup.getGoal() is goal


def test_a_goal_in_ompls_words_replaces_those_before_it_although_nothing_was_planned():
    setup, start = build()
    tip = setup.robot.tip_pose(start + MOTION).translation
    other = states(setup, start + OTHER_MOTION)
    setup.setGoal(other)
    setup.setWorkspaceGoal(tip)
    assert len(setup.query.goals) == 0
    setup.setGoal(other)
    setup.setConfigurations(start, start + MOTION)
    assert setup.query.tip_goal is None


# ------------------------------------------------------------------------------------- another scene, objective, space

CHANGE = {
    "moveObstacle": lambda setup: setup.moveObstacle("far", Pose((21.0, 0.0, 0.0))),
    "setScene": lambda setup: setup.setScene(setup.scene.without("far")),
    "setMinClearance": lambda setup: setup.setMinClearance(1e-3),
    "setTube": lambda setup: setup.setTube(1e-4),
    "setStateValidityChecker": lambda setup: setup.setStateValidityChecker(lambda state: True),
    "setOptimizationObjective": lambda setup: setup.setOptimizationObjective(
        ob.PathLengthOptimizationObjective(setup.getSpaceInformation())
    ),
    "another danger": lambda setup: setup.setOptimizationObjective(
        DangerObjective(setup.getSpaceInformation(), setup.field)
    ),
    "its problem's objective": lambda setup: setup.getProblemDefinition().setOptimizationObjective(
        ob.PathLengthOptimizationObjective(setup.getSpaceInformation())
    ),
    "bounds": lambda setup: setup.getStateSpace().setBounds(-3.1, 3.1),
}


@pytest.mark.parametrize("change", CHANGE.values(), ids=CHANGE)
@pytest.mark.parametrize("name", ["SafeRRTConnect", "SafePRM", "BubblePlanner", "RRTConnect", "RRTstar", "BITstar"])
def test_another_scene_objective_or_space_forgets_solution_and_trees(name, change):
    setup, start = begun(name)
    change(setup)
    assert not setup.haveSolutionPath()
    before = setup.getPlanner()
    path = solved(setup, name)
    assert setup.getPlanner() is before
    np.testing.assert_array_equal(path[[0, -1]], [start, start + MOTION])


BAR = {
    "addObstacle": lambda setup, q: setup.addObstacle(
        Obstacle("new", Sphere(0.02), Pose(tuple(setup.robot.tip_pose(q).translation)))
    ),
    "setStateValidityChecker": lambda setup, q: setup.setStateValidityChecker(
        lambda state: bool(np.linalg.norm(setup.bridge.read(state) - q) > 0.05)
    ),
}


@pytest.mark.parametrize("bar", BAR)
@pytest.mark.parametrize("aside", [False, True])
@pytest.mark.parametrize("name", ["SafeRRTConnect", "SafePRM", "BubblePlanner", "RRTConnect", "BITstar"])
def test_a_way_that_is_barred_is_not_taken_again_also_by_a_planner_that_was_set_aside(name, aside, bar):
    setup, _ = begun(name)
    planner, path = setup.getPlanner(), setup.solution()
    if aside:
        setup.setPlanner(SafeRRTConnect(setup.getSpaceInformation()))
    way = Curve(setup.robot, path)
    BAR[bar](setup, way.at(np.array([0.5 * way.length]))[0])
    assert not setup.haveSolutionPath()
    assert not setup.is_free(path)
    setup.setPlanner(planner)
    assert setup.is_free(solved(setup, name))


# ------------------------------------------------------------------------------------- objectives that are no number


class NanSomewhere(ob.OptimizationObjective):
    """Length, and NaN of states, motions or both that are nearer to a place than a radius."""

    def __init__(self, si, place, radius, of):
        super().__init__(si)
        self.place, self.radius, self.of = place, radius, of

    def near(self, q):
        return np.linalg.norm(q - self.place) < self.radius

    def stateCost(self, state):
        return ob.Cost(np.nan if "states" in self.of and self.near(np.array(state[0:3])) else 1.0)

    def motionCost(self, start, end):
        a, b = np.array(start[0:3]), np.array(end[0:3])
        nan = "motions" in self.of and any(self.near(a + t * (b - a)) for t in SHARES)
        return ob.Cost(np.nan if nan else float(np.linalg.norm(b - a)))


@pytest.mark.parametrize("name", [*PLANNERS, "InformedRRTstar", "SORRTstar"])
@pytest.mark.parametrize("of", ["states", "motions"])
@pytest.mark.parametrize("radius", [0.1, 50.0])
def test_no_path_leads_through_what_the_objective_calls_nan(name, of, radius):
    setup, start = build()
    objective = NanSomewhere(setup.getSpaceInformation(), start + 0.5 * MOTION, radius, of)
    setup.setOptimizationObjective(objective)
    for simplify in (False, 0.05):
        result = setup.plan(name, time=0.1, seed=1, simplify=simplify)
        assert setup.getOptimizationObjective() is objective
        assert bool(result) == setup.haveExactSolutionPath() == (result.path is not None)
        assert radius == 0.1 or not setup.haveSolutionPath()
        if result and "states" in of:
            assert not any(objective.near(q) for q in result.path)
        if result and "motions" in of:
            assert not any(objective.near(a + t * (b - a)) for a, b in pairwise(result.path) for t in SHARES)
