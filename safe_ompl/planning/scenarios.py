"""Make a `SafeSetup`, or a `PlanResult`, from a scenario or a problem of MotionBenchMaker."""

from __future__ import annotations

import logging
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from time import perf_counter
from typing import Any

import safe_ompl.scene as scenes
from safe_ompl.common import documents as document
from safe_ompl.planning.planners import PathFunction, make_planner
from safe_ompl.planning.result import PlanResult
from safe_ompl.planning.safe_setup import SafeSetup
from safe_ompl.robot import Robot

_log = logging.getLogger(__name__)


def plan(
    scenario: scenes.Scenario | str | Path,
    planner: str | PathFunction = "SafeRRTConnect",
    time: float | None = None,
    seed: int = 0,
    parameters: Mapping[str, Any] | None = None,
    **options: Any,
) -> PlanResult:
    """Plan a path for a scenario, given as a Scenario or by its name or file; see `SafeSetup.plan`.

    The default time limit [s] is that of the scenario. `parameters` override the planner's parameters in the scenario.
    `options` are `simplify`, `optimise`, `starts`, `workers` and `ways`. Errors as `SafeSetup.plan`; also an InputError
    if the scenario is invalid.
    """
    begin = perf_counter()
    scenario = _loaded(scenario)
    setup = setup_scenario(scenario)
    own = scenario.planners.get(planner, {}) if isinstance(planner, str) else {}
    built = perf_counter() - begin
    result = setup.plan(
        planner,
        time=scenario.time if time is None else time,
        seed=seed,
        parameters={**own, **(parameters or {})},
        **options,
    )
    return replace(result, setup_time=built + result.setup_time)


def _loaded(scenario: scenes.Scenario | str | Path) -> scenes.Scenario:
    return scenario if isinstance(scenario, scenes.Scenario) else scenes.Scenario.load(scenario)


def setup_scenario(scenario: scenes.Scenario | str | Path, robot: Robot | None = None) -> SafeSetup:
    """Return a `SafeSetup` with the robot, scene, start, goals and limits of a scenario.

    Parameters
    ----------
    scenario : Scenario, str or Path
        The scenario, or its name or file.
    robot : Robot, optional
        The scenario's robot, if it is already built. Default: build it.

    Raises
    ------
    InputError
        If the scenario is invalid; the message names file, key and value.
    """
    scenario = _loaded(scenario)
    robot = robot or scenario.build_robot()
    # The goal is None if the scenario has a program, whose steps have goals of their own.
    start, goal = scenario.start_configuration(robot), scenario.goal
    goals = scenario.goal_configurations(robot) if goal is not None and goal.configurations else None
    with document.within(str(scenario.file or scenario.name), ": "):
        setup = SafeSetup(robot, scenario.scene, danger=scenario.danger)
        if goal is not None and goal.position is not None:
            setup.setWorkspaceGoal(goal.position, goal.rotation, goal.tolerance)
        elif goal is not None and goal.region is not None:
            setup.setGoalRegion(goal.region, goal.tolerance)
        if goals is None:
            setup.setStartConfiguration(start)
        else:
            setup.setConfigurations(start, goals)
        with document.within("limits"):
            limits = scenario.limits
            if limits.max_danger:
                setup.setMaxDanger(limits.max_danger)
            if limits.min_clearance:
                setup.setMinClearance(limits.min_clearance, limits.obstacles, limits.exempt)
            if limits.tool is not None:
                setup.setToolConstraint(limits.tool.axis, limits.tool.direction, limits.tool.angle)
            if limits.tip is not None:
                setup.setTipBounds(*limits.tip.corners)
            if limits.moving is not None:
                with document.within("moving", ": "):
                    setup.setMovingObstacles(limits.moving.speeds, limits.moving.time)
            if limits.tube is not None:
                setup.setTube(limits.tube)
    return setup


def setup_problem(problem: scenes.MbmProblem, robot: Robot) -> SafeSetup:
    """Return a `SafeSetup` with the scene, start and goals of a problem of MotionBenchMaker.

    If a goal is slightly outside the joint limits, they are widened, with a warning; see `MbmProblem.widened_limits`.
    Raises InputError if the joints are not those of the robot, or if start or goals are outside the limits or in
    collision.
    """
    limits = problem.widened_limits(robot)
    if limits:
        listed = ", ".join(f"{joint} to [{low:g}, {high:g}]" for joint, (low, high) in limits.items())
        _log.warning("%s %d: a goal is outside the limits: widened %s", problem.family, problem.index, listed)
        robot = robot.with_limits(limits)
    setup = SafeSetup(robot, problem.scene)
    setup.setConfigurations(problem.start_configuration(robot), problem.goal_configurations(robot))
    return setup


def check_named_planner(scenario: scenes.Scenario, planner: str, setup: SafeSetup) -> None:
    """Raise InputError if the planner, or a parameter that the scenario sets for it, does not exist."""
    source = f"{scenario.file or scenario.name}: planners" if planner in scenario.planners else "planner"
    with document.within(source, ": "):
        make_planner(planner, setup.getSpaceInformation(), scenario.planners.get(planner))
