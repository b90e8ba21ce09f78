"""A planner that has solved one query answers the next one, however this is asked, and keeps what still holds."""

import numpy as np
import pytest
from ompl import base as ob
from planar import MOTION, OTHER_START, state

from safe_ompl import WorkspaceGoal, make_planner, planner_names
from safe_ompl.planning import setup_scenario
from safe_ompl.planning.planners import is_ours, needs_place
from safe_ompl.robot import ScratchState

OURS = [name for name in planner_names() if is_ours(name)]
PRINTED = [name for name in planner_names() if name.startswith("Paper")]
SLOW = {"PaperSafeJTRRT": {"null_space_gain": 0.0}}
OTHER_GOAL = np.array([0.1, -0.05, 0.05])


class Query:
    """A start and a goal in the space of a setup, for planners to places, too."""

    def __init__(self, setup, planner, start, goal):
        self.setup, self.planner, self.start, self.goal = setup, planner, start, goal
        self.si = setup.getSpaceInformation()

    def state(self, q):
        return state(self.setup, q)

    def goal_object(self):
        if needs_place(self.planner):
            return WorkspaceGoal(self.si, self.setup.robot, self.setup.robot.tip_pose(self.goal).translation, seed=0)
        states = ob.GoalStates(self.si)
        states.addState(self.state(self.goal))
        return states

    def problem(self):
        problem = ob.ProblemDefinition(self.si)
        problem.setOptimizationObjective(self.setup.getOptimizationObjective())
        problem.addStartState(self.state(self.start))
        problem.setGoal(self.goal_object())
        return problem

    def assert_answered_by(self, problem):
        path = problem.getSolutionPath()
        first, last = (self.setup.bridge.read(path.getState(k)) for k in (0, path.getStateCount() - 1))
        np.testing.assert_allclose(first, self.start, atol=1e-12)
        assert problem.getGoal().isSatisfied(ScratchState(self.setup.bridge).set(last))
        if not needs_place(self.planner):
            np.testing.assert_allclose(last, self.goal, atol=1e-12)
        assert path.check()


def another_problem(planner, problem, query):
    planner.setProblemDefinition(query.problem())


def another_problem_that_starts_at_the_old_start(planner, problem, query):
    query.start = query.start - OTHER_START
    planner.setProblemDefinition(query.problem())


def another_start_and_goal(planner, problem, query):
    problem.clearStartStates()
    problem.addStartState(query.state(query.start))
    problem.setGoal(query.goal_object())


def another_start(planner, problem, query):
    query.goal = query.goal - OTHER_GOAL - OTHER_START
    problem.clearStartStates()
    problem.addStartState(query.state(query.start))


def another_goal(planner, problem, query):
    query.start = query.start - OTHER_START
    problem.setGoal(query.goal_object())


def other_states_in_the_same_goal(planner, problem, query):
    query.start = query.start - OTHER_START
    problem.getGoal().clear()
    problem.getGoal().addState(query.state(query.goal))


def way_back(planner, problem, query):
    query.start, query.goal = query.start - OTHER_START + MOTION, query.start - OTHER_START
    another_start_and_goal(planner, problem, query)


CHANGES = [
    another_problem,
    another_problem_that_starts_at_the_old_start,
    another_start_and_goal,
    another_start,
    another_goal,
    other_states_in_the_same_goal,
    way_back,
]


def rows(configurations):
    return {q.tobytes() for q in configurations}


def begun(planar3, scenario, name):
    """Return a planner that has solved a query, the query's problem, and the next query."""
    start = scenario.start_configuration(planar3.robot)
    query = Query(planar3, name, start, start + MOTION)
    planner, problem = make_planner(name, query.si, SLOW.get(name)), query.problem()
    planner.setSeed(0)
    planner.setProblemDefinition(problem)
    planner.setup()
    assert planner.solve(10.0).getStatus() == ob.PlannerStatus.EXACT_SOLUTION
    query.assert_answered_by(problem)
    return planner, problem, Query(planar3, name, start + OTHER_START, start + OTHER_START + MOTION + OTHER_GOAL)


@pytest.mark.parametrize(
    ("change", "clears"), [*((change, False) for change in CHANGES), (another_start_and_goal, True)]
)
@pytest.mark.parametrize("name", [*OURS, *PRINTED])
def test_the_next_query_is_answered(planar3, scenario, name, change, clears):
    if needs_place(name) and change is other_states_in_the_same_goal:
        pytest.skip("a place is not changed")
    planner, problem, query = begun(planar3, scenario, name)
    problem.clearSolutionPaths()
    change(planner, problem, query)
    if clears:
        planner.clearQuery()
    assert planner.solve(10.0).getStatus() == ob.PlannerStatus.EXACT_SOLUTION
    query.assert_answered_by(planner.getProblemDefinition())


@pytest.mark.parametrize("name", [*OURS, *PRINTED])
def test_what_was_built_is_kept_where_a_start_or_a_goal_is_added_and_a_roadmap_for_any_query(planar3, scenario, name):
    planner, problem, query = begun(planar3, scenario, name)
    before = rows(planner.plannerGraph().configurations)
    problem.addStartState(query.state(query.start))
    if not needs_place(name):
        problem.getGoal().addState(query.state(query.goal))
    assert planner.solve(10.0)
    graph = planner.plannerGraph()
    assert before <= rows(graph.configurations)
    assert len(graph.starts) == 2
    if "PRM" not in name:
        return
    before = rows(planner._roadmap.configurations)
    planner.setProblemDefinition(query.problem())
    assert planner.solve(10.0)
    assert before <= rows(planner._roadmap.configurations)
    graph = planner.plannerGraph()
    np.testing.assert_allclose(
        graph.configurations[[*graph.starts, *graph.goals]], [query.start, query.goal], atol=1e-12
    )


@pytest.mark.parametrize("name", [*OURS, *PRINTED])
def test_bounds_that_are_set_after_the_planner_was_made(scenario, name):
    """As in OMPL's demos, where a space is given its bounds at any time before planning."""
    setup = setup_scenario(scenario)
    space, robot = setup.getStateSpace(), setup.robot
    start = scenario.start_configuration(robot)
    query, paths = Query(setup, name, start, start + MOTION), []
    for first in (0.01, 1.0):
        space.setBounds(-first * np.pi, first * np.pi)
        planner, problem = make_planner(name, query.si, SLOW.get(name)), query.problem()
        planner.setSeed(0)
        planner.setProblemDefinition(problem)
        space.setBounds(-np.pi, np.pi)
        planner.setup()
        assert planner.solve(10.0).getStatus() == ob.PlannerStatus.EXACT_SOLUTION
        query.assert_answered_by(problem)
        paths.append([setup.bridge.read(state) for state in problem.getSolutionPath().getStates()])
    np.testing.assert_array_equal(*paths)


@pytest.mark.parametrize("name", [name for name in [*OURS, *PRINTED] if not needs_place(name)])
def test_many_invalid_goals_before_a_valid_one(planar3, scenario, name):
    start = scenario.start_configuration(planar3.robot)
    query = Query(planar3, name, start, start + MOTION)
    planner, problem = make_planner(name, query.si), query.problem()
    goals = ob.GoalStates(query.si)
    for q in [start + 10.0] * 150 + [query.goal]:
        goals.addState(query.state(q))
    problem.setGoal(goals)
    planner.setProblemDefinition(problem)
    assert planner.solve(10.0).getStatus() == ob.PlannerStatus.EXACT_SOLUTION
    query.assert_answered_by(problem)


def test_trees_of_another_checker_are_dropped(planar3, scenario):
    planner, _, _ = begun(planar3, scenario, "SafeRRTConnect")
    before = rows(planner.plannerGraph().configurations)
    si, own = planar3.getSpaceInformation(), planar3.validity
    try:
        si.setStateValidityChecker(type(own)(si, own.checker))
        assert planner.solve(10.0)
    finally:
        si.setStateValidityChecker(own)
    after = rows(planner.plannerGraph().configurations)
    assert len(before & after) == 2 < len(before), "start and goal"
