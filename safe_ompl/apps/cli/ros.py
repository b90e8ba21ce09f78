"""`safe-ompl ros`: a node of ROS 2 that drives a robot to goals beside people and things that move."""

from __future__ import annotations

import argparse
import re
from collections.abc import Callable
from contextlib import ExitStack, closing
from dataclasses import replace
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from safe_ompl.apps.cli.live import (
    add_mcap,
    check_mcap,
    clearance_of_movers,
    limits_of_still,
    timed_way,
)
from safe_ompl.apps.cli.options import (
    add_package_dirs,
    add_parser,
    add_run_options,
    add_scenario,
    limit,
    load_scenario,
    names,
    noise,
    run_options,
    seconds,
)
from safe_ompl.apps.cli.output import error_console, need_extra
from safe_ompl.apps.exchange import Cell, ControlOptions, Frames, LiveController, in_metres
from safe_ompl.common import FloatArray, InputError, PlanningError, UnknownNameError
from safe_ompl.geometry import Obstacle, Person
from safe_ompl.io import ticks_header
from safe_ompl.people import TrackedBody, Tracker, find_skeleton
from safe_ompl.people.replanning import Replanner, ReplanningOptions
from safe_ompl.people.simulation import ALL_KEYPOINTS
from safe_ompl.planning import setup_scenario
from safe_ompl.robot import Robot
from safe_ompl.scene import Goal, People, Scenario, Scene

_PLANNER = "SafeRRTConnect"
_NOBODY = "none"
_WAIT = 10.0  # [s] for the robot's description


def add_commands(commands: Any) -> None:
    """Add `ros` to the commands."""
    parser = add_parser(
        commands,
        "ros",
        prepare,
        "a node of ROS 2 that drives a robot to goals beside people and things that move",
        "Subscribe to joint states, people, obstacles, a point cloud and goals, and publish what the robot should do, "
        "in pieces that end in a stop, with diagnostics and markers. Obstacles of limits.moving move.",
    )
    add_scenario(parser)
    parser.add_argument(
        "--people",
        type=names,
        metavar="NAME[,…]",
        help=f"people that are tracked, or {_NOBODY}; default: those of the scenario",
    )
    parser.add_argument(
        "--skeleton",
        metavar="NAME",
        help="key points of people, such as coco17; default: those of the package",
    )
    parser.add_argument(
        "--noise", type=noise, default=0.0, metavar="M", help="largest error of key points [m]"
    )
    parser.add_argument(
        "--tick", type=seconds, default=0.05, metavar="S", help="time between commands; default: %(default)g"
    )
    for option, usual, what in (
        ("latency", 0.05, "from a tick until its command holds, at most a tick [s]"),
        ("clock-error", 0.01, "by which clocks of sensors may differ from the node's [s]"),
        ("tolerance", 0.05, "how far a joint may be from where it should be [rad or m]"),
        ("lost-after", 0.5, "without a measurement for so long, somebody is lost [s]"),
        ("cloud-radius", 0.02, "of the ball about each point of a cloud [m]"),
    ):
        parser.add_argument(
            f"--{option}", type=limit, default=usual, metavar="X", help=f"{what}; default: %(default)g"
        )
    parser.add_argument(
        "--robot-description",
        metavar="TOPIC",
        help="take the URDF from this topic, such as /robot_description, and all else of the robot from the scenario",
    )
    add_mcap(parser)
    add_run_options(parser, usual_time="the scenario's")
    add_package_dirs(parser)
    parser.add_argument(
        "--ros-args",
        nargs=argparse.REMAINDER,
        default=[],
        help="the rest is for ROS: names of topics (-r joint_states:=/arm/joint_states), -p use_sim_time:=true",
    )


def prepare(options: argparse.Namespace) -> Callable[[], int]:
    """Check what the options name, and return the job."""
    need_extra("ros")
    need_extra("mcap")
    check_mcap(options.mcap)
    scenario = load_scenario(options.scenario, options.package_dir)
    trackers = trackers_of(scenario, options)
    control = ControlOptions(
        ReplanningOptions(tick=options.tick, lost_after=options.lost_after),
        latency=min(options.latency, options.tick),
        clock_error=options.clock_error,
        tolerance=options.tolerance,
        cloud_radius=options.cloud_radius,
    )
    return partial(_run, scenario, trackers, control, options)


def trackers_of(scenario: Scenario, options: argparse.Namespace) -> dict[str, Tracker]:
    """Return how the people that the options name are tracked; those of the scenario are as tall as there."""
    skeleton = ALL_KEYPOINTS if options.skeleton is None else in_metres(find_skeleton(options.skeleton))
    heights = {one.name: one.shape.height for one in scenario.scene if isinstance(one.shape, Person)}
    tracked = tuple(heights) if options.people is None else options.people
    if tracked == (_NOBODY,):
        tracked = ()
    moving = () if scenario.limits.moving is None else scenario.limits.moving.speeds
    for name in (*tracked, *moving):
        if not re.fullmatch(r"[A-Za-z]\w*", name, re.ASCII):
            raise InputError(f"{name!r} must be letters, digits and _: it is part of a topic", "name")
    for name in moving:
        if name not in scenario.scene.names:
            raise UnknownNameError("obstacle", name, scenario.scene.names, "limits.moving.speeds")
    bodies = {name: TrackedBody(heights[name]) if name in heights else TrackedBody() for name in tracked}
    return {name: Tracker(skeleton, body, noise=options.noise) for name, body in bodies.items()}


def _run(
    scenario: Scenario, trackers: dict[str, Tracker], control: ControlOptions, options: argparse.Namespace
) -> int:
    """Start the node, and drive the robot until Ctrl-C."""
    from safe_ompl.apps.exchange import McapLog, NodeSetup, RosNode, ros_context  # needs the extras

    moving = {} if scenario.limits.moving is None else dict(scenario.limits.moving.speeds)
    around = scenario.scene.without(*(name for name in scenario.scene.names if name in trackers))
    with ExitStack() as stack:
        node = stack.enter_context(ros_context(options.ros_args))
        folder = stack.enter_context(TemporaryDirectory(prefix="safe-ompl-"))
        robot = _robot(scenario, node, options, Path(folder) / "robot.urdf")
        cell = cell_of(scenario, robot, trackers, moving, options, control)
        clock = node.get_clock()
        controller = LiveController(cell, lambda: 1e-9 * clock.now().nanoseconds, control)
        log = None
        if options.mcap is not None:
            header = ticks_header(options.tick, robot, around, controller.header())
            log = stack.enter_context(closing(McapLog(options.mcap, header, robot, around)))
        frames = Frames(robot, scenario.frames)
        ros = RosNode(node, controller, NodeSetup(frames, around.without(*moving), log))
        error_console().print(f"{node.get_fully_qualified_name()}: ready; Ctrl-C ends it")
        ros.run()
    return 0


def _robot(scenario: Scenario, node: Any, options: argparse.Namespace, file: Path) -> Robot:
    """Return the scenario's robot, or the one that a topic describes, whose URDF is kept in a file."""
    if options.robot_description is None:
        return scenario.build_robot()
    from safe_ompl.apps.exchange import received_text  # needs the extra

    text = received_text(node, options.robot_description, _WAIT)
    file.write_text(text, encoding="utf-8")
    spec = replace(scenario.robot, example=None, urdf=file, package_dirs=tuple(options.package_dir))
    try:
        return spec.build()
    except InputError as error:
        raise InputError(str(error).replace(str(file), "the URDF"), options.robot_description) from None


def cell_of(
    scenario: Scenario,
    robot: Robot,
    trackers: dict[str, Tracker],
    moving: dict[str, float],
    options: argparse.Namespace,
    control: ControlOptions,
) -> Cell:
    """Return the robot with its surroundings, and how it is planned there."""
    people = replace(scenario.people or People(), who=None, clearance=clearance_of_movers(scenario))
    still = scenario.scene.without(*(n for n in scenario.scene.names if n in trackers or n in moving))
    limited = limits_of_still(scenario, still, beside_people=bool(trackers))
    setup_scenario(limited, robot)  # what cannot be used is said now

    def plan(start: FloatArray, goal: FloatArray, cloud: Obstacle | None) -> Replanner:
        extra = () if cloud is None else (cloud,)
        scene = Scene((*still, *extra), still.spacing)
        asked = replace(
            limited,
            scene=scene,
            start=tuple(start.tolist()),
            goal=Goal(configurations=(tuple(goal.tolist()),)),
        )
        setup = setup_scenario(asked, robot)
        result = setup.plan(_PLANNER, **run_options(options, scenario, _PLANNER))
        if result.path is None:
            raise PlanningError(result.status)
        trajectory = timed_way(result.path, robot, setup.certified_motion, scenario)
        replanner = Replanner(
            robot,
            Scene((*(one for one in scenario.scene if one.name not in trackers), *extra), still.spacing),
            trackers,
            moving,
            people=people,
            options=control.replanning,
            motion=setup.certified_motion,
        )
        replanner.start(trajectory)
        return replanner

    return Cell(robot, trackers, moving, plan)
