"""Commands `ros` and `guard`: ROS 2 nodes that move a robot among moving people and objects."""

from __future__ import annotations

import argparse
import re
from collections.abc import Callable
from contextlib import ExitStack, closing
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from safe_ompl.apps.cli import arguments, output
from safe_ompl.apps.cli.arguments import option
from safe_ompl.apps.cli.live import limits_of_still, people_who_move, program_segments, timed_way
from safe_ompl.common import FloatArray, InputError, PlanningError, UnknownNameError
from safe_ompl.geometry import STANDING, Obstacle, Person, PointCloud
from safe_ompl.io import ticks_header
from safe_ompl.live import Surroundings, TrackedBody, Tracker, find_skeleton
from safe_ompl.live.replanning import Replanner, ReplanningOptions, SegmentSequence, Shield, SpeedLimits
from safe_ompl.live.ros import (
    ACTION,
    Cell,
    ControlOptions,
    Execution,
    FramePlaces,
    LiveController,
    in_metres,
    trajectory_action,
)
from safe_ompl.live.simulation import ALL_KEYPOINTS
from safe_ompl.motions import RateLimits
from safe_ompl.planning import setup_scenario
from safe_ompl.robot import Robot
from safe_ompl.scene import Goal, MotionLimits, People, Scenario, Scene
from safe_ompl.tasks import PROGRAM_TIME, plan_program, program_robot

_NOBODY, _SOMEBODY = "none", "somebody"
_REHEARSED = 12  # ticks


def add_commands(commands: Any) -> None:
    """Add `ros` and `guard` to the commands."""
    parser = arguments.add_parser(
        commands,
        "ros",
        prepare,
        "ROS 2 node that moves a robot to goals beside moving people and objects",
        "Subscribe to joint states, people, obstacles, a point cloud and goals, and publish what the robot should do, "
        "in pieces that end in a stop, with diagnostics and markers. "
        "Obstacles of limits.moving may move.",
    )
    parser.set_defaults(controller="")
    option(parser, "--shield", "follow the motions on the topic `proposal` as far as they are proven, instead of goals")
    _add_options(parser)
    parser = arguments.add_parser(
        commands,
        "guard",
        prepare,
        "ROS 2 node in front of a controller: proves trajectories, stops for people, and continues",
        f"Serve the action NAME/{ACTION} (control_msgs/action/FollowJointTrajectory), and publish on "
        "NAME/joint_trajectory what the controller should do, in pieces that end in a stop. People, obstacles and a "
        "point cloud come as for `safe-ompl ros`.",
    )
    parser.set_defaults(shield=False)
    option(parser, "--controller NAME", "a joint_trajectory_controller of ros2_control", required=True)
    _add_options(parser)


def _add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options that both commands have."""
    arguments.add_scenario(parser)
    option(parser, "--people NAME[,…]", f"tracked people, or {_NOBODY}; default: the scenario's", arguments.names)
    option(parser, "--skeleton NAME", "key points of people, such as coco17; default: those of the package")
    option(parser, "--noise M", "largest error of key points [m]", arguments.noise, 0.0)
    option(parser, "--tick S", "time between commands", arguments.seconds, 0.05)
    for name, usual, what in (
        ("latency", 0.05, "time from a tick until its command takes effect, at most a tick [s]"),
        ("clock-error", 0.01, "largest difference between the sensors' clocks and the node's [s]"),
        ("tolerance", 0.05, "largest tracking error of a joint [rad or m]"),
        ("lost-after", 0.5, "a person without a measurement for this time counts as lost [s]"),
        ("cloud-radius", 0.02, "radius of the ball about each point of a cloud [m]"),
    ):
        option(parser, f"--{name} X", what, arguments.limit, usual)
    arguments.add_mcap(parser)
    arguments.add_run_options(parser, usual_time="the scenario's")
    parser.add_argument(
        "--ros-args",
        nargs=argparse.REMAINDER,
        default=[],
        help="arguments for ROS: topic names (-r joint_states:=/arm/joint_states), -p use_sim_time:=true",
    )


def prepare(options: argparse.Namespace) -> Callable[[], int]:
    """Validate the options and return a function that runs the command."""
    output.need_extra("ros")
    output.need_extra("mcap")
    if options.controller:
        trajectory_action()
    scenario = arguments.load_scenario(options.scenario, options.package_dir, goal=bool(options.controller))
    if scenario.program is not None:
        arguments.refuse(options, ("shield", "simplify"), "is only for paths to goals, but the scenario has a program")
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
    """Return a tracker for each person that the options name. People of the scenario have its heights."""
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


def _run(scenario: Scenario, trackers: dict[str, Tracker], control: ControlOptions, options: argparse.Namespace) -> int:
    """Start the node and control the robot until Ctrl-C."""
    from safe_ompl.live.ros import McapLog, RosNode, lookup_of, ros_context  # needs the extras

    around = scenario.scene.without(*(name for name in scenario.scene.names if name in trackers))
    with ExitStack() as stack:
        node = stack.enter_context(ros_context(options.ros_args))
        cell = cell_of(scenario, scenario.build_robot(), trackers, options, control)
        rehearse(options, control)
        clock = node.get_clock()
        controller = LiveController(cell, lambda: 1e-9 * clock.now().nanoseconds, control)
        log = None
        if options.mcap is not None:
            header = ticks_header(options.tick, cell.robot, around, cell.moving)
            log = stack.enter_context(closing(McapLog(options.mcap, header)))
        frames, still = FramePlaces(cell.robot, scenario.frames, lookup_of(node)), around.without(*cell.objects)
        ros = RosNode(node, controller, frames, still, log, guarded=options.controller)
        name = node.get_fully_qualified_name()
        ros.run(lambda: output.error_console().print(f"{name}: ready; Ctrl-C ends it"))
    return 0


def cell_of(
    scenario: Scenario, robot: Robot, trackers: dict[str, Tracker], options: argparse.Namespace, control: ControlOptions
) -> Cell:
    """Return the robot with its surroundings, and how it is planned there."""
    people = people_who_move(scenario)
    moving = {} if scenario.limits.moving is None else dict(scenario.limits.moving.speeds)
    still = scenario.scene.without(*(n for n in scenario.scene.names if n in trackers or n in moving))
    limited = limits_of_still(scenario, still, beside_people=bool(trackers))
    described = Surroundings(scenario.scene, trackers, moving, people).description()
    if scenario.program is not None:
        movable = [scenario.scene[n] for n in scenario.scene.names if n not in still.names]

        def among(scene: Scene) -> Surroundings:
            return Surroundings(scene.with_obstacles(*movable), trackers, moving, people)

        def work(start: FloatArray, goal: FloatArray, cloud: Obstacle | None) -> SegmentSequence:
            return legs_of(limited, robot, start, among, control, options)

        return Cell(program_robot(limited), trackers, moving, work, program=True, moving=described)
    # Building a setup here reports bad input before the node starts.
    setup_scenario(limited, robot)

    def plan(start: FloatArray, goal: Any, cloud: Obstacle | None) -> Replanner | Shield:
        seen, own = () if cloud is None else (cloud,), scenario.motion
        # The controller says whether the joints are near enough to the commands, the first one included.
        start = robot.clipped_start(start)
        aim = Goal(configurations=(tuple((start if isinstance(goal, Execution) else goal).tolist()),))
        asked = replace(limited, scene=still.with_obstacles(*seen), start=tuple(start.tolist()), goal=aim)
        setup = setup_scenario(asked, robot)
        around = Surroundings(scenario.scene.with_obstacles(*seen), trackers, moving, people)
        if options.shield or isinstance(goal, Execution):
            rates = RateLimits.of(robot, own.velocity, own.acceleration, own.jerk)
            limits = SpeedLimits(rates, own.tool_speed, own.link_speed)
            shield = Shield(
                robot, around, options=replace(control.replanning, limits=limits), prover=setup.motion_prover
            )
            if isinstance(goal, Execution):
                goal.drive_with(shield, start, control.tolerance)
            else:
                shield.start(start)
            return shield
        result = setup.plan(arguments.PLANNER, **arguments.run_options(options, scenario, arguments.PLANNER))
        if result.path is None:
            raise PlanningError(result.status)
        replanner = Replanner(robot, around, options=control.replanning, prover=setup.motion_prover)
        replanner.start(timed_way(result.path, robot, setup.motion_prover, scenario))
        return replanner

    return Cell(robot, trackers, moving, plan, options.shield, moving=described)


def legs_of(
    scenario: Scenario,
    arm: Robot,
    start: FloatArray,
    around: Callable[[Scene], Surroundings],
    control: ControlOptions,
    options: argparse.Namespace,
) -> SegmentSequence:
    """Plan the program of a scenario from where all joints are, those of grippers where it has them."""
    here = dict(zip(program_robot(scenario).joint_names, start.tolist(), strict=True))
    asked = replace(scenario, start=tuple(here[name] for name in arm.joint_names))
    for name in here.keys() - set(arm.joint_names):
        if abs(here[name] - arm.held_joints[name]) > control.tolerance:
            raise PlanningError(f"{name!r} is at {here[name]:g}, and the program begins at {arm.held_joints[name]:g}")
    result = plan_program(asked, time=options.time or PROGRAM_TIME, seed=options.seed)
    if not result:
        raise PlanningError(result.why)
    return SegmentSequence(program_segments(result, around, control.replanning))


def rehearse(options: argparse.Namespace, control: ControlOptions) -> None:
    """Simulate a small robot, so that every kernel that a tick calls is loaded before the node starts."""
    shield = options.shield or bool(options.controller)
    usual = argparse.Namespace(time=None, seed=0, simplify=options.simplify, shield=shield)
    found = Scenario.load("planar2")
    motion = MotionLimits(acceleration=5.0, tool_speed=1.0, link_speed=1.0)
    robot, scenario = found.build_robot(), replace(found, motion=motion, people=People(who=(_SOMEBODY,)))
    cell = cell_of(scenario, robot, {_SOMEBODY: Tracker(ALL_KEYPOINTS)}, usual, control)
    start, (goal,) = scenario.start_configuration(robot), scenario.goal_configurations(robot)
    cloud = Obstacle("cloud", PointCloud(0.01, points=np.array([[-0.9, -0.9, 0.0]])))
    body = 1.75 * np.array(list(STANDING.values())) + np.array([0.9, 0.0, -0.75])
    pilot = cell.plan(start, goal, cloud)
    assert not isinstance(pilot, SegmentSequence)
    for k in range(_REHEARSED):
        time = control.replanning.tick * k
        pilot.update({_SOMEBODY: body - [1.5 * time, 0.0, 0.0]}, {}, time)
        if isinstance(pilot, Replanner):
            pilot.think()
        elif k % 2:
            pilot.propose_velocity(np.zeros(robot.n))
        else:
            pilot.propose(np.linspace(start, goal, 100), rate=10.0)
        pilot.command(time)
