"""Commands `check` (prove and repair a motion of another program) and `tube` (measure tracking errors)."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Mapping
from dataclasses import replace
from decimal import ROUND_CEILING, Context
from functools import partial
from pathlib import Path
from typing import Any

from rich.text import Text

from safe_ompl.apps.cli import arguments, output
from safe_ompl.apps.cli.arguments import option
from safe_ompl.apps.cli.plan import add_timed_options, rate_limits, show_timed, timed
from safe_ompl.apps.cli.verify import certificate_of, source_of
from safe_ompl.certificates import motion_certificate
from safe_ompl.common import FloatArray, InputError, documents as document, files
from safe_ompl.drawing import ViewerContent, plots, save_page
from safe_ompl.io import WRITABLE, EmbeddedProblem, MotionRecord, motion_content, read_log, read_motion
from safe_ompl.motions import (
    FACTOR,
    TIME,
    MeasuredTube,
    Motion,
    MotionCheck,
    RateLimits,
    Repair,
    measured_tube,
    tube_of,
    way_of,
    why_unproven,
    widest_tube,
)
from safe_ompl.planning import PlanResult, SafeSetup, setup_scenario
from safe_ompl.robot import Robot
from safe_ompl.scene import People, Scenario

# Widths are rounded up to three digits.
_ROUND_UP = Context(prec=3, rounding=ROUND_CEILING)


def add_commands(commands: Any) -> None:
    """Add `check` and `tube` to the commands."""
    parser = arguments.add_parser(
        commands,
        "check",
        prepare,
        "prove or repair a motion of another program",
        "Prove that a motion of a controller, an optimiser or another planner is collision free, keeps the scenario's "
        "limits, and can stop in time for the scenario's people. Otherwise print where this is not proven. "
        "Files: tables (.csv, .tsv, .txt), arrays "
        "(.npz, .npy), trajectory_msgs/JointTrajectory and moveit_msgs/RobotTrajectory (.json, .yaml), and files of "
        "safe-ompl. "
        "The exit status is 0 if the motion, or with --repair the written motion, is proven.",
    )
    option(parser, "file FILE", "the motion")
    option(parser, "--scenario SCENARIO", "robot, scene and limits: a name or YAML file", required=True)
    option(parser, "--degrees", "revolute joints of FILE are in degrees")
    words = "names of the columns of FILE, including `time`, if FILE does not name them"
    option(parser, "--joints NAME[,…]", words, arguments.names)
    option(parser, "--ignore NAME[,…]", "joints or columns of FILE to leave out", arguments.names)
    option(
        parser,
        "--max-velocity V|JOINT=V[,…]",
        "largest joint velocity between the samples of a FILE without velocities [rad/s or m/s]",
        arguments.by_joint,
    )
    option(
        parser,
        "--limits",
        "also check the limits of velocity, acceleration and jerk of the scenario, or else of the URDF",
    )
    option(
        parser,
        "--no-people",
        "leave out the scenario's people and prove the motion among still obstacles only. With people, velocities and "
        "accelerations are always checked, because stops depend on them",
    )
    option(
        parser,
        "--tube W|JOINT=W[,…]",
        "prove every motion whose joints stay this near to FILE's [rad or m]; default: limits.tube of the "
        "scenario; see `safe-ompl tube`",
        arguments.by_joint,
    )
    option(
        parser, "--time SECONDS", "time limit; what is not proven by then counts as undecided", arguments.seconds, TIME
    )
    option(
        parser, "--widest-tube", "also find the widest tube that is proven: equal widths, or in proportion to --tube"
    )
    option(
        parser,
        "--repair OUT",
        "change the motion as little as possible, prove it, and write it as "
        "a safe-ompl file (.json; a ROS message if FILE is one), a table (.csv, .tsv, .txt), arrays (.npz), or a "
        "JointTrajectory (.yaml)",
        output.output_file(*WRITABLE),
    )
    words = "write a certificate of the proof, for `safe-ompl verify` (.json)"
    option(parser, "--certificate FILE", words, output.JSON_FILE)
    option(parser, "--json FILE", "write the result as JSON; - is standard output", output.JSON_FILE)
    option(parser, "--plot FILE", "draw joints, limits and distances (.png, …)", output.PICTURE)
    words = (
        "ignore times and velocities; follow straight lines through the way points as fast as limits and people allow"
    )
    add_timed_options(parser, "--retime", words)
    words = "write a page that plays the motion in 3D and needs no network (.html)"
    option(parser, "--html FILE", words, output.PAGE)
    arguments.add_limit_options(parser)
    parser = arguments.add_parser(
        commands,
        "tube",
        prepare_tube,
        "measure the tracking error of a robot",
        "Compute the widths for `check --tube` from logs of commanded and measured positions at equal times: the "
        "largest error of each joint plus a bound of its growth between samples, times a factor.",
    )
    option(
        parser,
        "logs LOG",
        "tables (.csv) or arrays (.npz) with time, <joint>_commanded and <joint>_measured; recordings of ROS 2 "
        "(.mcap, or a bag) with a controller's state, or with a JointTrajectory and a JointState",
        nargs="*",
    )
    for what in ("commanded", "measured"):
        option(parser, f"--{what}-topic NAME", f"topic of the {what} positions in a recording")
    option(
        parser, "--commanded FILE", "instead of logs: commanded motion, in a form that `check` reads; needs --measured"
    )
    option(parser, "--measured FILE", "measured motion; both motions are interpolated at each other's times")
    option(parser, "--factor F", "ratio of the tube to the largest error, >= 1", arguments.limit, FACTOR)
    option(parser, "--degrees", "revolute joints are in degrees; needs --scenario")
    option(
        parser,
        "--scenario SCENARIO",
        "scenario with the robot; whole turns of its continuous joints are not counted as errors",
    )


def prepare(options: argparse.Namespace) -> Callable[[], int]:
    """Read the motion and the scenario, and return a function that runs the command."""
    message = False
    if options.repair is not None:
        message = Path(options.file).suffix.lower() == ".json" and "format" not in files.read_json(options.file)
    scenario = arguments.with_limits(arguments.load_scenario(options.scenario, options.package_dir), options)
    robot = scenario.build_robot()
    given = scenario.limits.tube if options.tube is None else options.tube
    source = f"{scenario.file}: limits.tube" if options.tube is None else "--tube"
    tube = () if given is None else tube_of(given, robot, source)
    setup = _without_ends(replace(scenario, limits=replace(scenario.limits, tube=None)), robot, tube)
    how = {"degrees": options.degrees, "joints": options.joints, "ignore": options.ignore or ()}
    motion = _sampled(read_motion(options.file, robot, **how), options, robot)
    limits = rate_limits(scenario, robot, options)
    if limits is not None:
        why = "is for a motion with its own times: leave out --retime, --trajectory and --timed-plot"
        arguments.refuse(options, ("repair", "max_velocity", "widest_tube"), why)
        beside = replace(scenario, people=None) if options.no_people else scenario
        return partial(_retime, options, beside, setup, motion, limits)
    people, _ = _people(options, scenario, motion)
    if options.limits or people is not None:
        if not motion.rated:
            why = "bare samples have no rates" if motion.timed else "has no times"
            raise InputError(f"{options.file}: {why}", "--limits")
        limits = RateLimits.of(robot, scenario.motion.velocity, scenario.motion.acceleration, scenario.motion.jerk)
    if people is not None and limits is not None:
        _check_people(options, scenario, limits)
    return partial(_check, options, scenario, setup, motion, limits, message)


def _people(options: argparse.Namespace, scenario: Scenario, motion: Motion) -> tuple[People | None, str]:
    """Return the people for whom stopping in time is proven, or None and the reason why they are left out."""
    if scenario.people is None or (motion.rated and not options.no_people):
        return scenario.people, ""
    why = "bare samples have no rates" if motion.timed else "the motion has no times"
    return None, f"not looked at: {'--no-people' if options.no_people else why}"


def _check_people(options: argparse.Namespace, scenario: Scenario, limits: RateLimits) -> None:
    """Raise InputError if stopping in time for people cannot be proven for the motion, or not be certified."""
    if limits.jerk is not None:
        raise InputError(
            "stops with a jerk limit are proven only for trajectories of safe-ompl; remove the jerk limit, or give "
            "--no-people",
            f"{scenario.file}: motion.jerk",
        )
    if options.certificate is not None:
        raise InputError("certificates of motions cannot state stops beside people; give --no-people", "--certificate")


def _sampled(motion: Motion, options: argparse.Namespace, robot: Robot) -> Motion:
    """Return the motion, as bare samples if --max-velocity is given."""
    if options.max_velocity is None:
        return motion
    if not motion.timed or motion.degree > 1:
        raise InputError(f"{options.file}: is only for timed samples without velocities", "--max-velocity")
    bounds = tube_of(options.max_velocity, robot, "--max-velocity")
    with document.within(options.file, ": "):
        return Motion.sampled(motion.times, motion.knots, bounds, robot.joint_names)


def _without_ends(scenario: Scenario, robot: Robot, tube: tuple[float, ...]) -> SafeSetup:
    """Return a setup with the scenario's limits and a tube. The scenario's start and goal are not checked with it."""
    given = setup_scenario(scenario, robot)
    setup = SafeSetup(robot, given.scene, danger=given.danger_options)
    setup.setConstraints(given.getConstraints())
    if tube:
        setup.setTube(tube)
    return setup


def _check(
    options: argparse.Namespace,
    scenario: Scenario,
    setup: SafeSetup,
    motion: Motion,
    limits: RateLimits | None,
    message: bool,
) -> int:
    """Check the motion, print the result and write the requested files."""
    robot, (people, without) = setup.robot, _people(options, scenario, motion)
    with document.within(options.file, ": "):
        found = setup.check(motion, limits, people, options.time)
    tube = found.separation.tube
    record: dict[str, Any] = {"file": options.file, "scenario": scenario.name, "robot": robot.name}
    record |= {"proven": bool(found), "claims": found.claims, "tube": tube or None}
    record["long_turns"] = found.long_turns
    record["violations"] = [vars(violation) for violation in found.violations]
    widest = repair = None
    if options.widest_tube:
        widest = widest_tube(motion, robot, setup.scene, constraints=setup.getConstraints(), proportions=tube or None)
        record["widest_tube"] = dict(zip(robot.joint_names, widest.tolist(), strict=True))
    if options.repair is not None:
        repair = setup.repair(motion, limits, people, time=scenario.time)
        repair_fields = {key: value for key, value in vars(repair).items() if key not in ("motion", "check")}
        record["repair"] = {"proven": bool(repair), **repair_fields}
    if options.json != output.STANDARD_OUTPUT:
        _say(f"{options.file} · {scenario.name} · {robot.name}", found, widest, without)
    written = found
    if repair is not None:
        written = repair.check
        if repair:
            written = _write(repair, options, setup, limits, message)
        output.error_console().print(_described(repair, written, options.repair))
    if options.json:
        output.write_json(options.json, record)
    if options.certificate and not written:
        output.error_console().print(
            f"safe-ompl: the motion is not proven: nothing is written to {options.certificate}"
        )
    elif options.certificate:
        source, spacing = source_of(scenario, options.certificate), scenario.danger.get("spacing")
        output.write_json(options.certificate, motion_certificate(written, spacing=spacing, source=source))
    if options.plot:
        plots.plot_check(found, options.plot, title=Path(options.file).name)
    if options.html:
        save_page(ViewerContent.of_check(found, Path(options.file).name), options.html)
    return 0 if written else 1


def _say(title: str, found: MotionCheck, widest: FloatArray | None, without: str) -> None:
    """Print what is proven and what is not. `without` is the reason why people are left out."""
    lines = [title, f"motion: {found.motion!r}", str(found)]
    if widest is not None:
        each = zip(found.proof.checker.robot.joint_names, widest.tolist(), strict=True)
        beside = " (people aside)" * (found.people is not None)
        lines.append(f"widest tube{beside} [rad or m]: {', '.join(f'{name} ±{width:.3g}' for name, width in each)}")
    output.say("\n".join([*lines, *([f"people: {without}"] if without else [])]))


def _retime(
    options: argparse.Namespace, scenario: Scenario, setup: SafeSetup, motion: Motion, limits: RateLimits
) -> int:
    """If the way points of a motion are proven, compute a new time law, print the result and write the files."""
    robot, name = setup.robot, Path(options.file).name
    with document.within(options.file, ": "):
        found = setup.check(way_of(motion, robot), time=options.time)
    result = trajectory = None
    if found:
        about: dict[str, Any] = {"robot": robot, "scene": setup.scene, "danger": setup.danger_options}
        about |= {"motion": setup.motion_prover}
        result = PlanResult("given", found.motion.knots, None, name, 0, robot.joint_names, 0.0, **about)
        with document.within(options.file, ": "):
            trajectory = timed(result, scenario, limits)
    if options.json:
        record = {"file": options.file, "scenario": scenario.name, "robot": robot.name, "proven": bool(found)}
        record |= {"duration": trajectory and trajectory.duration, "reason": None if found else why_unproven(found)}
        output.write_json(options.json, record)
    if options.json != output.STANDARD_OUTPUT:
        _say(f"{options.file} · {scenario.name} · {robot.name}", found, None, "--no-people" * options.no_people)
    if options.plot:
        plots.plot_check(found, options.plot, title=name)
    if result is None or trajectory is None:
        output.error_console().print(f"safe-ompl: {options.file}: {why_unproven(found)}: the path is not timed")
        return 1
    if options.certificate:
        proof = certificate_of(result, setup, scenario, options.certificate, trajectory)
        output.write_json(options.certificate, proof)
    written = show_timed(trajectory, result, setup, scenario, options)
    if options.html:
        problem = EmbeddedProblem(robot, setup.scene, setup.danger_options)
        moved = MotionRecord.of(trajectory, problem, name=name)
        save_page(ViewerContent.of_motions([moved], title=name), options.html)
    return 0 if written else 1


def _write(
    repair: Repair, options: argparse.Namespace, setup: SafeSetup, limits: RateLimits | None, message: bool
) -> MotionCheck:
    """Write a repaired motion if the motion read back from the file is proven, too. Return the check of the latter."""
    content, read = motion_content(repair.motion, options.repair, message=message)
    if read is not repair.motion:
        with document.within(options.repair, ": "):
            read = _sampled(read.for_robot(setup.robot), options, setup.robot)
    found = repair.check if read is repair.motion else setup.check(read, limits, repair.check.people, options.time)
    if found:
        files.write(options.repair, content)
    return found


def _described(repair: Repair, written: MotionCheck, file: str) -> str:
    if not written:
        why = repair.how
        # The motion was free of collisions. Its rates were too high, or the file rounds its numbers.
        if repair.changed:
            why = f"{why}, {written.violations[0]}"
        return f"safe-ompl: nothing is written to {file}: {why}"
    if repair.how == "unchanged":
        return f"{file}: the motion as it was"
    slower = f"{repair.slower:.3g} times as long as before" if repair.slower > 1 else ""
    if not repair.changed:
        return f"{file}: proven; the motion as it was, but {slower}"
    unit = "s" if repair.motion.timed else ""
    stretches = ", ".join(f"{first:.4g}–{last:.4g}" for first, last in repair.changed)
    return (
        f"{file}: proven; {repair.how}, by {repair.deviation:.3g} rad and {repair.tool_deviation:.3g} mm at the tip "
        f"at most, at {repair.at:.4g} {unit}; changed: {stretches} {unit}".replace("  ", " ").rstrip()
        + f"; {slower}" * bool(slower)
    )


def prepare_tube(options: argparse.Namespace) -> Callable[[], int]:
    """Read the logs and return a function that runs the command."""
    pair = options.commanded, options.measured
    if (None in pair) != (pair == (None, None)) or bool(options.logs) == (None not in pair):
        raise InputError("give logs, or both --commanded and --measured")
    if not options.logs and (options.commanded_topic or options.measured_topic):
        raise InputError("are for recordings: give one", "--commanded-topic and --measured-topic")
    robot = None
    if options.scenario is not None:
        robot = arguments.load_scenario(options.scenario, options.package_dir).build_robot()
    if options.degrees and robot is None:
        raise InputError("needs the robot, to know which joints are revolute: give --scenario", "--degrees")
    found: dict[str, MeasuredTube] = {}
    for log in options.logs or [" and ".join(pair)]:
        motions = _log(log, options) if options.logs else (read_motion(pair[0]), read_motion(pair[1]))
        with document.within(log, ": "):
            continuous = None
            if robot is not None:
                continuous = robot.continuous
                commanded, measured = (motion.for_robot(robot, options.degrees) for motion in motions)
                motions = commanded, measured
            found[log] = measured_tube(*motions, options.factor, continuous)
            first = next(iter(found.values())).joint_names
            if set(found[log].joint_names) != set(first):
                raise InputError(f"must be of the joints {', '.join(first)}", "columns")
    return partial(_tube, found, options.factor)


def _log(log: str, options: argparse.Namespace) -> tuple[Motion, Motion]:
    """Return the commanded and the measured motion of a log in any supported format."""
    topics = options.commanded_topic, options.measured_topic
    if Path(log).suffix.lower() in (".mcap", ".db3") or Path(log).is_dir():  # recordings of ROS 2
        output.need_extra("mcap", log)
        from safe_ompl.live.ros import read_joint_log  # needs the extra

        return read_joint_log(log, *topics)
    if topics != (None, None):
        raise InputError(f"are for recordings, not for {log!r}", "--commanded-topic and --measured-topic")
    return read_log(log)


def _tube(found: Mapping[str, MeasuredTube], factor: float) -> int:
    """Print the widest tube of all logs, by joint, and how to pass it to `check` and to a scenario."""
    samples = sum(tube.samples for tube in found.values())
    table = output.plain_table("joint", "largest error", "between samples", "at\ns", "tube", title=f"{samples} samples")
    if len(found) > 1:
        table.add_column("log")
    widths = {}
    for name in next(iter(found.values())).joint_names:
        places = {log: tube.joint_names.index(name) for log, tube in found.items()}
        log = max(found, key=lambda log: found[log].widths[places[log]])
        tube, k = found[log], places[log]
        widths[name] = float(_ROUND_UP.create_decimal(repr(float(tube.widths[k]))))
        row = [name, f"{tube.errors[k]:.3g}", f"+{tube.between[k]:.2g}", f"{tube.times[k]:.3f}", f"{widths[name]:g}"]
        table.add_row(*row, *([log] if len(found) > 1 else []))
    table.caption = Text(f"tube: {factor:g} × (largest error + what may be between samples) [rad or m]")
    output.console().print(table)
    by_name = ",".join(f"{name}={width:g}" for name, width in widths.items())
    entry = ", ".join(f"{name}: {width:g}" for name, width in widths.items())
    for line in (f"--tube {by_name}", f"limits: {{tube: {{{entry}}}}}"):
        output.say(line)
    return 0
