"""How hard the scenes are by the paper's own measure, checks of sampled edges; and what danger costs, in checks."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from _timing import in_turn
from ompl import geometric as og

from safe_ompl.collision.checker import CollisionChecker
from safe_ompl.common import FloatArray
from safe_ompl.planning.from_scenario import setup_scenario
from safe_ompl.planning.ompl.states import StateBridge, joint_space
from safe_ompl.planning.ompl.validity import CollisionFreeValidity
from safe_ompl.planning.planners.base import SafePlanner
from safe_ompl.planning.planners.registry import make_planner
from safe_ompl.scene.scenario import Scenario

MEASURE = "PaperRRTConnect"  # the planner that a scene's hardness is measured by
STEP = 0.05  # [rad] between two samples of an edge; the paper does not say


class Hardness(NamedTuple):
    """Nodes and checks of a planner that samples its edges; danger without and with its gradient, in checks."""

    nodes: float
    checks: float
    value: float
    gradient: float

    @classmethod
    def of(cls, scenario: Scenario, runs: int) -> Hardness:
        """Measure a scenario; nodes and checks are means over so many runs."""
        return cls(*sampled_checks(scenario, MEASURE, runs), *field_cost(scenario))


def sampled_checks(scenario: Scenario, planner: str, runs: int) -> tuple[float, float]:
    """Return the nodes and the collision checks that a planner needs on average if it samples its edges.

    Certified motions ask fewer and other questions; this is for comparison with the paper's tables only.

    Parameters
    ----------
    scenario : Scenario
        The problem, with a goal configuration.
    planner : str
        Name of a planner of this package that plans to configurations.
    runs : int
        Seeds to average over.
    """
    robot = scenario.build_robot()
    setup = og.SimpleSetup(joint_space(robot))
    checker, si = CollisionChecker(robot, scenario.scene), setup.getSpaceInformation()
    setup.setStateValidityChecker(CollisionFreeValidity(si, checker))
    si.setStateValidityCheckingResolution(
        STEP / si.getStateSpace().getMaximumExtent()
    )  # OMPL samples by default
    setup.setStartAndGoalStates(
        _state(si, scenario.start_configuration(robot)), _state(si, scenario.goal_configurations(robot)[0])
    )
    nodes, checks = [], []
    for seed in range(runs):
        one: SafePlanner = make_planner(planner, si, scenario.planners.get(planner))
        one.setSeed(seed)
        setup.clear()
        setup.setPlanner(one)
        setup.setup()
        checker.counts.reset()
        setup.solve(scenario.time)
        nodes.append(one.counts.nodes)
        checks.append(checker.counts.collision_queries)
    return float(np.mean(nodes)), float(np.mean(checks))


def field_cost(scenario: Scenario, samples: int = 100, rounds: int = 5) -> tuple[float, float]:
    """Return what the danger of a configuration costs, and what danger and gradient cost, in collision checks."""
    setup = setup_scenario(scenario)
    assert setup.field is not None
    robot, checker, field = setup.robot, setup.checker, setup.field
    configurations = np.random.default_rng(0).uniform(robot.lower, robot.upper, (samples, robot.n))
    times = in_turn(
        {
            "check": lambda: [checker.in_collision(q) for q in configurations],
            "value": lambda: [field.value(q) for q in configurations],
            "gradient": lambda: [field.values_and_gradients(q[None]) for q in configurations],
        },
        samples,
        rounds,
    )
    return times.ratio("value", "check"), times.ratio("gradient", "check")


def _state(si: Any, q: FloatArray) -> Any:
    state = si.getStateSpace().allocState()
    StateBridge(si.getStateSpace()).write(q, state)
    return state
