"""From a scenario to a setup, and from there to a result."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from safe_ompl import document
from safe_ompl.maths.kernels.compiled import clock
from safe_ompl.robot.robot import Robot
from safe_ompl.scenario.scenario import Scenario, find_scenario
from safe_ompl.setup.duration import Cost
from safe_ompl.setup.result import PlanResult
from safe_ompl.setup.safe_setup import SafeSetup


def plan(
    scenario: Scenario | str | Path,
    planner: str = "SafeRRTConnect",
    time: float | None = None,
    seed: int = 0,
    parameters: Mapping[str, Any] | None = None,
    *,
    simplify: bool | float = False,
    optimise: float | None = None,
    cost: Cost = "danger",
    report: bool = True,
) -> PlanResult:
    """Plan a scenario.

    Parameters
    ----------
    scenario : Scenario, str or path
        The problem, or the name or file of one.
    planner : str
        A name of `planner_names()`.
    time : float, optional
        Time limit [s]; the scenario's own by default.
    seed : int
        Seed.
    parameters : mapping, optional
        Planner parameters that override those of the scenario.
    simplify, optimise, cost, report
        As in `SafeSetup.plan`.

    Returns
    -------
    PlanResult
        True if solved.

    Raises
    ------
    InputError, PlanningError
        As `SafeSetup.plan`; and if the scenario cannot be used.
    """
    begin = clock()
    if not isinstance(scenario, Scenario):
        scenario = Scenario.load(find_scenario(scenario))
    setup = setup_scenario(scenario)
    own = scenario.planners.get(planner, {}) if isinstance(planner, str) else {}
    built = clock() - begin
    result = setup.plan(
        planner,
        time=scenario.time if time is None else time,
        seed=seed,
        parameters={**own, **(parameters or {})},
        simplify=simplify,
        optimise=optimise,
        cost=cost,
        report=report,
    )
    return replace(result, setup_time=built + result.setup_time)


def setup_scenario(scenario: Scenario, robot: Robot | None = None) -> SafeSetup:
    """Return a SafeSetup with the robot, scene, start and goals of a scenario."""
    robot = robot or scenario.build_robot()
    start, goal = scenario.start_configuration(robot), scenario.goal
    goals = scenario.goal_configurations(robot) if goal.configurations else None
    with document.within(str(scenario.file or scenario.name), ": "):
        setup = SafeSetup(robot, scenario.scene, danger=scenario.danger)
        setup.setMotionLimits(scenario.motion, scenario.people)
        if goal.position is not None:
            setup.setWorkspaceGoal(goal.position, goal.rotation, goal.tolerance)
        elif goal.region is not None:
            setup.setGoalRegion(goal.region, goal.tolerance)
        if goals is None:
            setup.setStartConfiguration(start)
        else:
            setup.setConfigurations(start, goals)
        with document.within("limits"):
            if scenario.limits.max_danger:
                setup.setMaxDanger(scenario.limits.max_danger)
            if scenario.limits.min_clearance:
                limits = scenario.limits
                setup.setMinClearance(limits.min_clearance, limits.obstacles, limits.exempt)
            if scenario.limits.tool is not None:
                tool = scenario.limits.tool
                setup.setToolConstraint(tool.axis, tool.direction, tool.angle)
            if scenario.limits.tip is not None:
                setup.setTipBounds(*scenario.limits.tip.corners)
            if scenario.limits.moving is not None:
                with document.within("moving", ": "):
                    setup.setMovingObstacles(scenario.limits.moving.speeds, scenario.limits.moving.time)
    return setup
