"""`safe-ompl plan --timed`: the path as a trajectory in time."""

from __future__ import annotations

import argparse
from typing import Any

from safe_ompl.apps.cli.console import output_console
from safe_ompl.apps.cli.files import STANDARD_OUTPUT, check_writable, opened
from safe_ompl.apps.cli.pictures import check_picture
from safe_ompl.apps.cli.values import limit
from safe_ompl.common import InputError
from safe_ompl.io import TimedMotion, marked
from safe_ompl.io import strict_json as json_line
from safe_ompl.planning import PlanResult
from safe_ompl.robot import Robot
from safe_ompl.scene import Scenario
from safe_ompl.trajectories import RATE, MotionDanger, RateLimits, Trajectory
from safe_ompl.view import plots


def add_timed_options(parser: Any) -> None:
    """Add --timed, --rate and --trajectory."""
    group = parser.add_argument_group("time", "the motion in time; limits and people are the scenario's")
    group.add_argument("--timed", action="store_true", help="time the path within the limits of the joints")
    group.add_argument(
        "--rate", type=limit, metavar="HZ", help=f"points per second of the trajectory; default: {RATE:g}"
    )
    group.add_argument(
        "--trajectory",
        metavar="FILE",
        help="write it in the shape of JointTrajectory (.json), for controllers and `safe-ompl view`; "
        "implies --timed",
    )
    group.add_argument(
        "--timed-plot",
        metavar="FILE",
        help="draw its speed under the caps that bind, its joints against their limits, and its danger (.png); implies "
        "--timed",
    )


def rate_limits(scenario: Scenario, robot: Robot, options: argparse.Namespace) -> RateLimits | None:
    """Check what the options name, and return the limits of the scenario; None where nothing is timed."""
    check_writable(options.trajectory, "--trajectory")
    check_picture(options.timed_plot, "--timed-plot")
    if not (options.timed or options.trajectory or options.timed_plot):
        if options.rate is not None:
            raise InputError("is for a path in time: give --trajectory FILE, or --timed", "--rate")
        return None
    return RateLimits.of(robot, scenario.motion.velocity, scenario.motion.acceleration, scenario.motion.jerk)


def timed(result: PlanResult, scenario: Scenario, limits: RateLimits) -> Trajectory:
    """Return the path in time, as the scenario has it."""
    return result.timed(
        limits,
        people=scenario.people,
        tool_speed=scenario.motion.tool_speed,
        link_speed=scenario.motion.link_speed,
        max_danger=scenario.motion.max_danger,
    )


def show_timed(
    trajectory: Trajectory, result: PlanResult, scenario: Scenario, options: argparse.Namespace
) -> None:
    """Say how long it takes, what bounds it and how dangerous it is, and write the file that is asked for."""
    danger = None
    if any(obstacle.weight > 0 for obstacle in scenario.scene):
        danger = trajectory.danger(result.danger_field().moving)
    if options.json != STANDARD_OUTPUT and options.trajectory != STANDARD_OUTPUT:
        output_console().print(told(trajectory))
        if danger is not None:
            output_console().print(told_danger(danger))
    if options.timed_plot:
        plots.plot_motion(trajectory, options.timed_plot, danger=danger, title=f"{trajectory.duration:.2f} s")
    if options.trajectory:
        with opened(options.trajectory) as stream:
            print(json_line(_saved(trajectory, result, options.rate or RATE)), file=stream)


def _saved(trajectory: Trajectory, result: PlanResult, rate: float) -> dict[str, Any]:
    """Return the trajectory in the shape of JointTrajectory, with what `safe-ompl view` needs besides."""
    assert result.robot is not None
    assert result.scene is not None
    motion = TimedMotion.of(
        trajectory, result.robot, result.scene, rate=rate, danger=result.danger, name=result.planner
    )
    return marked("trajectory", {**trajectory.as_dict(rate), **motion.to_mapping()})


def told(trajectory: Trajectory) -> str:
    """Return one line: how long it takes, and what bounds its speed for what share of the time."""
    spans = (trajectory.law.times[1:] - trajectory.law.times[:-1]).tolist()
    shares: dict[str, float] = {}
    for name, span in zip(trajectory.binding(), spans, strict=True):
        shares[name or "joint acceleration"] = shares.get(name or "joint acceleration", 0.0) + span
    shown = sorted(shares.items(), key=lambda item: -item[1])
    bounds = ", ".join(f"{name} {100 * span / trajectory.duration:.0f} %" for name, span in shown)
    return f"timed: {trajectory.duration:.3f} s, bounded by {bounds}"


def told_danger(danger: MotionDanger) -> str:
    """Return one line: how dangerous the robot is in motion."""
    return (
        f"danger in motion: mean {danger.mean:.3f}, peak {danger.peak:.3f}, proven to stay below "
        f"{danger.proven_peak:.3f}"
    )
