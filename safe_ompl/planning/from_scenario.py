"""From a scenario or a problem to a setup, from a scenario to a result, from a motion to a repair."""

from __future__ import annotations

import logging
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from numpy.typing import ArrayLike

import safe_ompl.motions as motions
import safe_ompl.trajectories as trajectories
from safe_ompl.common import clock
from safe_ompl.common import documents as document
from safe_ompl.danger import KinetostaticField
from safe_ompl.planning.result import PlanResult
from safe_ompl.planning.safe_setup import SafeSetup
from safe_ompl.robot import Robot
from safe_ompl.scene import MbmProblem, People, Scenario, Scene, find_scenario

_log = logging.getLogger(__name__)


def plan(
    scenario: Scenario | str | Path,
    planner: str = "SafeRRTConnect",
    time: float | None = None,
    seed: int = 0,
    parameters: Mapping[str, Any] | None = None,
    *,
    simplify: bool | float = False,
    optimise: float | None = None,
) -> PlanResult:
    """Plan a scenario: the problem itself, or the name or file of one; all else as in `SafeSetup.plan`.

    The time limit [s] is by default the scenario's own, and `parameters` override those of the scenario. Errors as
    `SafeSetup.plan`; an InputError, too, if the scenario cannot be used.
    """
    begin = clock()
    if not isinstance(scenario, Scenario):
        scenario = Scenario.load(find_scenario(scenario))
    setup = setup_scenario(scenario)
    own = scenario.planners.get(planner, {})
    built = clock() - begin
    result = setup.plan(
        planner,
        time=scenario.time if time is None else time,
        seed=seed,
        parameters={**own, **(parameters or {})},
        simplify=simplify,
        optimise=optimise,
    )
    return replace(result, setup_time=built + result.setup_time)


def setup_scenario(scenario: Scenario, robot: Robot | None = None) -> SafeSetup:
    """Return a SafeSetup with the robot, scene, start and goals of a scenario."""
    robot = robot or scenario.build_robot()
    start, goal = scenario.start_configuration(robot), scenario.goal
    goals = scenario.goal_configurations(robot) if goal.configurations else None
    with document.within(str(scenario.file or scenario.name), ": "):
        setup = SafeSetup(robot, scenario.scene, danger=scenario.danger)
        if goal.position is not None:
            setup.setWorkspaceGoal(goal.position, goal.rotation, goal.tolerance)
        elif goal.region is not None:
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


def path_timer(scenario: Scenario, setup: SafeSetup) -> trajectories.PathTimer:
    """Return what times paths of a setup within the limits, and beside the people, of its scenario."""
    limits, field = scenario.motion, setup.field
    danger = None if limits.max_danger is None or field is None else KinetostaticField(field)
    rates = trajectories.RateLimits.of(setup.robot, limits.velocity, limits.acceleration, limits.jerk)
    caps = {key: getattr(limits, key) for key in ("tool_speed", "link_speed", "max_danger")}
    motion, people = setup.motion_prover, scenario.people
    return trajectories.PathTimer(setup.robot, rates, motion=motion, people=people, danger=danger, **caps)


def setup_problem(problem: MbmProblem, robot: Robot) -> SafeSetup:
    """Return a SafeSetup with the scene, start and goals of a problem.

    Limits of joints are widened, with a warning, where a goal is slightly outside; see `MbmProblem.widened_limits`. An
    InputError if the joints are not those of the robot, or start or goals are outside the limits or in collision.
    """
    limits = problem.widened_limits(robot)
    if limits:
        listed = ", ".join(f"{joint} to [{low:g}, {high:g}]" for joint, (low, high) in limits.items())
        _log.warning("%s %d: a goal is outside the limits: widened %s", problem.family, problem.index, listed)
        robot = robot.with_limits(limits)
    setup = SafeSetup(robot, problem.scene)
    setup.setConfigurations(problem.start_configuration(robot), problem.goal_configurations(robot))
    return setup


def repair(
    motion: Any,
    robot: Robot,
    scene: Scene,
    *,
    tube: ArrayLike | Mapping[str, float] | None = None,
    limits: trajectories.RateLimits | None = None,
    people: People | None = None,
    time: float = 2.0,
) -> motions.Repair:
    """Return a motion that something else made with as little changed as a proof needs.

    The motion is what `Motion.of` takes, such as way points (N, n), a SciPy spline, or a plain `og.SimpleSetup` that is
    solved; other arguments and errors as `check`, under other constraints it is `SafeSetup.repair`. The time [s] is
    for planning ways round, where moving pieces aside does not succeed.

    Returns
    -------
    Repair
        True if it is proven. `motion` has the ends, the degree, the times and the smoothness of the one given; `path`
        the way points where it is straight between them; `how`, `deviation` and `changed` say what was done. Where
        rates exceed `limits`, or stops are too late for `people`, it takes `slower` times as long.
    """
    setup = SafeSetup(robot, scene)
    if tube is not None:
        setup.setTube(tube)
    return setup.repair(motion, limits, people, time=time)
