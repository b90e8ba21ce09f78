"""Command `plan`: plan one path for a scenario, optionally with a time law, or all steps of the scenario's program."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np

# Importing certificates, drawing, motions and tasks takes a third of the start-up time. These packages load their
# modules on first attribute access, so they are imported here as packages and not by name.
import safe_ompl.certificates as certificates
import safe_ompl.drawing as drawing
import safe_ompl.io as io
import safe_ompl.motions as motions
import safe_ompl.tasks as tasks
from safe_ompl.apps.cli import arguments, output
from safe_ompl.apps.cli.arguments import option
from safe_ompl.apps.cli.verify import certificate_of, source_of
from safe_ompl.common import InputError, files
from safe_ompl.danger import KinetostaticField
from safe_ompl.planning import PlanResult, SafeSetup, check_named_planner, setup_scenario
from safe_ompl.planning.planners import make_planner
from safe_ompl.robot import Robot
from safe_ompl.scene import Scenario

# If a robot that follows the exported points cannot stop before a person can reach it, the points are written with a
# longer duration. These factors of the first duration are tried in this order.
_SLOWDOWNS = (1.0, 1.005, 1.02, 1.05, 1.15)


def add_commands(commands: Any) -> None:
    """Add `plan` to the commands."""
    parser = arguments.add_parser(commands, "plan", prepare, "plan one path and report on it")
    arguments.add_scenario(parser)
    arguments.add_planner_options(parser, usual_time="the scenario's")
    option(parser, "--optimise SECONDS", "search for this long, and return the best path found", arguments.seconds)
    words = "plan K times, with seeds N, N + 1, … (--seed N), and return the best path; the time limit is for each plan"
    option(parser, "--starts K", words, arguments.count)
    arguments.add_workers(parser, "starts")
    words = (
        "all: search several routes past people and obstacles, return the safest, simplified, and print its cost and "
        "that of the second best"
    )
    option(parser, "--ways WAYS", words, _ways)
    words = "write the result as JSON, for `safe-ompl view`; -: print it, and no table"
    option(parser, "--json FILE", words, output.JSON_FILE)
    option(parser, "--plot FILE", "draw the path, its danger and its clearance (.png, …)", output.PICTURE)
    words = "write the path with its proof, for `safe-ompl verify` (.json)"
    option(parser, "--certificate FILE", words, output.JSON_FILE)
    add_timed_options(parser)
    arguments.add_limit_options(parser)


def prepare(options: argparse.Namespace) -> Callable[[], int]:
    """Validate the options and return a function that runs the command."""
    begin = perf_counter()
    scenario = arguments.with_limits(arguments.load_scenario(options.scenario, options.package_dir), options)
    if options.workers and not options.starts:
        raise InputError("workers plan the starts in parallel: give --starts K, too", "--workers")
    if scenario.program is not None:
        return _prepare_program(options, scenario)
    robot = scenario.build_robot()
    setup = setup_scenario(scenario, robot)
    check_named_planner(scenario, options.planner, setup)
    parameters = arguments.run_options(options, scenario, options.planner)["parameters"]
    # This planner is made only to check its parameters.
    make_planner(options.planner, setup.getSpaceInformation(), parameters)
    limits = rate_limits(scenario, robot, options)
    return partial(_plan, scenario, setup, options, perf_counter() - begin, limits)


def _ways(text: str) -> int | str:
    if text not in ("1", "all"):
        raise argparse.ArgumentTypeError(f"must be 1 or all, not {text!r}")
    return 1 if text == "1" else text


def _plan(
    scenario: Scenario,
    setup: SafeSetup,
    options: argparse.Namespace,
    setup_time: float,
    limits: motions.RateLimits | None,
) -> int:
    """Plan, print the result and write the requested files. `setup_time` [s] was spent on building the problem."""
    chosen = arguments.run_options(options, scenario, options.planner)
    chosen |= {"optimise": options.optimise, "starts": options.starts or 1, "workers": options.workers or 1}
    result = setup.plan(options.planner, **chosen, ways=options.ways or 1)
    result = replace(result, setup_time=setup_time + result.setup_time)
    if result.interrupted:
        output.error_console().print("safe-ompl: interrupted: this is the best path so far")
    # The file has the format that `safe_ompl.save` writes, plus the names of the scenario and the robot.
    if options.json:
        names = {"scenario": scenario.name, "robot": setup.robot.name}
        output.write_json(options.json, {**io.with_header("result", names), **io.result_to_mapping(result)})
    if options.json != output.STANDARD_OUTPUT:
        output.say(f"{scenario.name} · {setup.robot.name}\n{result}")
    trajectory = None
    if limits is not None and result.path is not None:
        trajectory = timed(result, scenario, limits)
    if options.certificate and result.path is None:
        output.error_console().print(f"safe-ompl: no path was found: nothing is written to {options.certificate}")
    elif options.certificate:
        proof = certificate_of(result, setup, scenario, options.certificate, trajectory)
        output.write_json(options.certificate, proof)
    if options.plot and result.path is not None:
        drawing.draw_plan(setup, result, options.plot)
    if trajectory is not None and not show_timed(trajectory, result, setup, scenario, options):
        return 1
    return 0 if result else 1


def record(scenario: str, robot: Robot, result: PlanResult) -> dict[str, Any]:
    """Return a result as the JSON object that the commands `compare` and `mbm` write."""
    return {"scenario": scenario, "robot": robot.name, **result.as_dict()}


def add_timed_options(
    parser: Any, switch: str = "--timed", words: str = "time the path within the limits of the joints"
) -> None:
    """Add the options for a timed trajectory: `switch`, --rate, --trajectory and --timed-plot."""
    group = parser.add_argument_group("time", "the motion in time, with limits and people of the scenario")
    option(group, switch, words, dest="timed")
    option(
        group,
        "--rate HZ",
        f"minimum number of trajectory points per second; default: {motions.RATE:g}",
        arguments.limit,
    )
    option(
        group,
        "--trajectory FILE",
        "write the motion in the form of a JointTrajectory (.json), for controllers and `safe-ompl view`; as a table "
        f"(.csv, .tsv, .txt), arrays (.npz) or YAML for controllers; implies {switch}",
        output.output_file(*io.WRITABLE, output.STANDARD_OUTPUT),
    )
    option(
        group,
        "--timed-plot FILE",
        f"plot path speed, joints and danger over time, with their limits (.png, …); implies {switch}",
        output.PICTURE,
    )


def rate_limits(scenario: Scenario, robot: Robot, options: argparse.Namespace) -> motions.RateLimits | None:
    """Validate the options of a trajectory and return the scenario's joint limits.

    Returns None if no option asks for a trajectory.
    """
    if not (options.timed or options.trajectory or options.timed_plot):
        if options.rate is not None:
            raise InputError("needs a timed trajectory: give --trajectory FILE, too", "--rate")
        return None
    return motions.RateLimits.of(robot, scenario.motion.velocity, scenario.motion.acceleration, scenario.motion.jerk)


def timed(result: PlanResult, scenario: Scenario, limits: motions.RateLimits) -> motions.Trajectory:
    """Compute the time law of the path within the joint limits and the limits for the people of the scenario."""
    return result.timed(
        limits,
        people=scenario.people,
        tool_speed=scenario.motion.tool_speed,
        link_speed=scenario.motion.link_speed,
        max_danger=scenario.motion.max_danger,
    )


def show_timed(
    trajectory: motions.Trajectory,
    result: PlanResult,
    setup: SafeSetup,
    scenario: Scenario,
    options: argparse.Namespace,
) -> bool:
    """Print the duration, the active speed limits and the danger of a trajectory; write the requested files.

    The exported points are checked with the interpolation that a controller uses between them. If this check fails, the
    trajectory is not written, and the function returns False.
    """
    danger = None
    if any(obstacle.weight > 0 for obstacle in scenario.scene):
        danger = trajectory.danger(KinetostaticField(result.danger_field()))
    if options.json != output.STANDARD_OUTPUT and options.trajectory != output.STANDARD_OUTPUT:
        output.console().print(describe_timing(trajectory))
        if danger is not None:
            output.console().print(
                f"danger in motion: mean {danger.mean:.3f}, peak {danger.peak:.3f}, proven to stay below "
                f"{danger.proven_peak:.3f}"
            )
    if options.timed_plot:
        drawing.plots.plot_motion(trajectory, options.timed_plot, danger=danger, title=f"{trajectory.duration:.2f} s")
    if options.trajectory:
        assert result.robot is not None
        assert result.scene is not None
        rate, problem = options.rate or motions.RATE, io.EmbeddedProblem(result.robot, result.scene, result.danger)
        motion_record = io.MotionRecord.of(trajectory, problem, rate=rate, name=result.planner)
        # The document is a JointTrajectory with additional keys that `safe-ompl view` needs.
        content = io.with_header("trajectory", {**trajectory.as_dict(rate), **motion_record.to_mapping()})
        # With jerk limits, stopping in time is only proven for the trajectory itself, so the check of the exported
        # points leaves people out.
        people = scenario.people if trajectory.limits.jerk is None else None
        # The trajectory uses all of the allowed stopping time. Between exported points the controller interpolates, and
        # a stop from there may take longer. The exported points are therefore slowed down until the check succeeds.
        for factor in _SLOWDOWNS:
            slower = content if factor == 1 else _slower(content, factor)
            motion_in_file, content_not_json = _written(slower, options.trajectory)
            found = setup.check(motion_in_file, trajectory.limits, people)
            if {violation.kind for violation in found.violations} != {"separation"}:
                break
        if not found:
            output.error_console().print(
                f"safe-ompl: nothing is written to {options.trajectory}: between the points of the trajectory the "
                f"check fails: {found.violations[0]}; try another --rate"
            )
            return False
        if factor > 1:
            reason = "so that the robot can stop in time also between the points"
            output.error_console().print(f"{options.trajectory}: the motion takes {factor:g} times as long, {reason}")
        if content_not_json is None:
            output.write_json(options.trajectory, slower)
        else:
            files.write(options.trajectory, content_not_json)
    return True


def _written(content: Mapping[str, Any], file: str) -> tuple[motions.Motion, str | bytes | None]:
    """Return the motion that a reader gets back from the file, and the file's content if it is not JSON (else None)."""
    motion = io.motion_of_document(content)
    if Path(file).suffix.lower() in ("", ".json"):
        return motion, None
    content_not_json, motion_in_file = io.motion_content(motion, file)
    return motion_in_file, content_not_json


def _slower(content: Mapping[str, Any], factor: float) -> dict[str, Any]:
    """Scale the time of a trajectory document by `factor` (> 1: slower)."""
    # `orders` maps each key to the power of `factor` by which its values are divided. Other values, such as the
    # positions, stay.
    orders = {"time_from_start": -1, "velocities": 1, "accelerations": 2}
    points = [
        {key: (np.array(value) / factor ** orders.get(key, 0)).tolist() for key, value in point.items()}
        for point in content["points"]
    ]
    speeds = [speed / factor for speed in content["speeds"]]
    return {**content, "points": points, "duration": factor * content["duration"], "speeds": speeds}


def describe_timing(trajectory: motions.Trajectory) -> str:
    """Return one line with the duration, and the share of the duration in which each limit is active."""
    spans = (trajectory.law.times[1:] - trajectory.law.times[:-1]).tolist()
    shares: dict[str, float] = {}
    # `binding` returns None where the joint acceleration is the limit.
    for name, span in zip(trajectory.binding(), spans, strict=True):
        shares[name or "joint acceleration"] = shares.get(name or "joint acceleration", 0.0) + span
    shown = sorted(shares.items(), key=lambda item: -item[1])
    bounds = ", ".join(f"{name} {100 * span / trajectory.duration:.0f} %" for name, span in shown)
    return f"timed: {trajectory.duration:.3f} s, bounded by {bounds}"


_NOT_FOR_PROGRAMS = ("param", "simplify", "optimise", "starts", "workers", "ways", "timed", "rate", "timed_plot")


def _prepare_program(options: argparse.Namespace, scenario: Scenario) -> Callable[[], int]:
    """Validate the options and return a function that plans one proven motion through all steps of the program."""
    why = "is only for a path to a goal; the motion of a program is always timed and proven"
    arguments.refuse(options, _NOT_FOR_PROGRAMS, why)
    if options.planner != arguments.PLANNER:
        raise InputError(why, "--planner")
    tasks.program_robot(scenario)
    return partial(_plan_program, options, scenario)


def _plan_program(options: argparse.Namespace, scenario: Scenario) -> int:
    result = tasks.plan_program(scenario, time=options.time or tasks.PROGRAM_TIME, seed=options.seed)
    content = result.as_dict()
    if options.json:
        output.write_json(options.json, io.with_header("motion", content))
    if options.json != output.STANDARD_OUTPUT:
        output.say(f"{scenario.name}\n{result}")
    if not result:
        return 1
    if options.trajectory:
        files.write(options.trajectory, io.motion_content(result.motion, options.trajectory)[0])
    if options.certificate:
        # During a stretch of the motion, robot and scene do not change.
        stretches = ((stretch.begin, stretch.check) for stretch in result.stretches)
        names = [content["steps"][stretch.step] for stretch in result.stretches]
        start_state = tasks.program_robot(scenario), scenario.scene
        proof = certificates.program_certificate(
            stretches, source_of(scenario, options.certificate), names, begin=start_state
        )
        output.write_json(options.certificate, proof)
    if options.plot:
        drawing.draw_program(result, options.plot)
    return 0
