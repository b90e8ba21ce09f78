"""Command `live`: simulate a robot among moving people and objects."""

from __future__ import annotations

import argparse
import logging
from collections.abc import Callable, Sequence
from contextlib import ExitStack, closing
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from safe_ompl.apps.cli import arguments, output
from safe_ompl.apps.cli.arguments import option
from safe_ompl.collision import MotionProver
from safe_ompl.common import FloatArray, InputError, SafeOmplError, UnknownNameError
from safe_ompl.drawing import read_recording, save_page
from safe_ompl.geometry import Obstacle, Person, Pose, Sphere
from safe_ompl.io import TickLog, TicksFile
from safe_ompl.live import HEIGHT, PELVIS, Recording, Surroundings, TrackedBody, Tracker, facing
from safe_ompl.live.replanning import Replanner, ReplanningOptions, Route, Segment
from safe_ompl.live.simulation import (
    ALL_KEYPOINTS,
    ContactMonitor,
    Drifting,
    Faults,
    PersonMover,
    Playback,
    ProgramSimulation,
    Simulation,
    Walker,
    part_solids,
)
from safe_ompl.motions import PathTimer, RateLimits, Trajectory, time_path
from safe_ompl.planning import SafeSetup, setup_scenario
from safe_ompl.robot import Robot
from safe_ompl.scene import Move, People, Scenario, Scene
from safe_ompl.tasks import PROGRAM_TIME, ProgramResult, plan_program, program_robot

_log = logging.getLogger(__name__)
RANDOM = "random"
_NO_PLACE = "the scenario has no person whose place could be taken: say where"
CLIP = "clip_0"
_BALL = 0.05  # [m] radius
# The largest and the least initial distance of the balls from the robot's base [m].
_FARTHEST_BALL, _NEAREST_BALL = 1.5, 0.25  # [m]
# The initial distance between balls and robot.
_BALL_DISTANCE = 0.3  # [m]
_MOST_BALL_TRIES = 1000


def add_commands(commands: Any) -> None:
    """Add `live` to the commands."""
    parser = arguments.add_parser(
        commands,
        "live",
        prepare,
        "simulate a robot beside moving people and objects",
        "Plan a path from start to goal and back. The simulated robot follows it repeatedly beside a recorded person, "
        "or beside people and objects that move at random. Every motion, including its stop, is proven at every tick. "
        "A monitor checks for contacts.",
    )
    arguments.add_scenario(parser)
    words = "a file of recorded key points (.npz), or the number of people who walk at random"
    option(parser, "--people FILE|random[:N]", words)
    option(parser, "--clip NAME", f"recording in the file; default: {CLIP}")
    option(
        parser,
        "--place X,Y,Z,YAW",
        "pose of the recording's origin, or of the first walking person, in the world [m, rad]; default: "
        "the pose of the scenario's first person",
        _place,
    )
    option(parser, "--movers N", "number of balls of 0.1 m that fly around the robot", arguments.count, 0)
    option(parser, "--mover-speed V", "largest speed of these balls [m/s]", arguments.limit, 0.5)
    option(parser, "--seconds S", "simulated time", arguments.seconds, 60.0)
    option(parser, "--out DIR", "folder for ticks.jsonl and summary.json", required=True)
    option(parser, "--html FILE", "also write a page that plays the simulation offline (.html)", output.PAGE)
    arguments.add_mcap(parser)
    option(parser, "--tick S", "time between commands", arguments.seconds, 0.05)
    words = "visit the goal's configurations and the start in the fastest order"
    option(parser, "--any-order", words)
    arguments.add_run_options(parser, usual_time="the scenario's")
    group = parser.add_argument_group("faults")
    option(group, "--noise M", "largest error of key points, known to the tracker [m]", arguments.noise, 0.0)
    option(group, "--drops SHARE", "share of the frames that are lost", arguments.share, 0.0)
    option(group, "--late SHARE", "share of the ticks without an answer", arguments.share, 0.0)
    option(
        group,
        "--faster FACTOR",
        "people and objects move this many times as fast as recorded, or as promised",
        arguments.limit,
        1.0,
    )


def prepare(options: argparse.Namespace) -> Callable[[], int]:
    """Validate the options and return a function that runs the command."""
    scenario = arguments.load_scenario(options.scenario, options.package_dir)
    faults = Faults(options.noise, options.drops, options.late, options.seed, min(Faults.latency, options.tick))
    robot = scenario.build_robot()
    people = people_who_move(scenario)
    found = choose_actors(scenario, robot, people, options)
    still = limits_of_still(scenario, found.still, beside_people=bool(found.people))
    output.make_folder(Path(options.out), ("ticks.jsonl", "summary.json"), force=options.force)
    trackers = {name: mover.tracker for name, mover in found.people.items()}
    if scenario.program is not None:
        arguments.refuse(
            options, ("simplify", "any_order"), "is only for a path to a goal, but the scenario has a program"
        )
        program_robot(still)
        return partial(_drive_program, still, people, actors=found, faults=faults, options=options)
    setup = setup_scenario(still, robot)

    def world(ways: Sequence[Trajectory] | Route) -> Simulation:
        around = Surroundings(found.scene, trackers, found.speeds, people)
        replanner = Replanner(robot, around, options=ReplanningOptions(options.tick), prover=setup.motion_prover)
        return Simulation(replanner, ways, found.people, found.objects, faults=faults)

    # Building a simulation here reports bad input before the planning starts.
    world([])
    return partial(_drive, scenario, setup, world=world, options=options)


def _drive(
    scenario: Scenario,
    setup: SafeSetup,
    world: Callable[[Sequence[Trajectory] | Route], Simulation],
    options: argparse.Namespace,
) -> int:
    """Plan from start to goal and back, or between all places in any order, and execute the paths repeatedly."""
    if options.any_order:
        return _simulate(world(_route(scenario, setup, options)), options)
    robot, prover = setup.robot, setup.motion_prover
    result = setup.plan(arguments.PLANNER, **arguments.run_options(options, scenario, arguments.PLANNER))
    if result.path is None:
        output.error_console().print(f"safe-ompl: {arguments.PLANNER} found no path: {result.status}")
        return 1
    ways = [timed_way(way, robot, prover, scenario) for way in (result.path, result.path[::-1])]
    return _simulate(world(ways), options)


def _route(scenario: Scenario, setup: SafeSetup, options: argparse.Namespace) -> Route:
    """Plan paths between all pairs of the start and the configurations of the goal."""

    def to_and_fro(start: FloatArray, goal: FloatArray) -> list[Trajectory]:
        setup.setConfigurations(start, goal)
        result = setup.plan(arguments.PLANNER, **arguments.run_options(options, scenario, arguments.PLANNER))
        if result.path is None:
            raise SafeOmplError(f"{arguments.PLANNER} found no path to {goal.round(3).tolist()}: {result.status}")
        return [timed_way(way, robot, setup.motion_prover, scenario) for way in (result.path, result.path[::-1])]

    robot = setup.robot
    return Route.between([scenario.start_configuration(robot), *scenario.goal_configurations(robot)], to_and_fro)


def _drive_program(
    scenario: Scenario, people: People, actors: Actors, faults: Faults, options: argparse.Namespace
) -> int:
    """Plan the program of a scenario among the static obstacles, and execute it once."""
    result = plan_program(scenario, time=options.time or PROGRAM_TIME, seed=options.seed)
    if not result:
        output.error_console().print(f"safe-ompl: no motion: {result.why}")
        return 1
    assert scenario.program is not None
    trackers = {name: mover.tracker for name, mover in actors.people.items()}
    movable = [one for one in actors.scene if one.name not in actors.still.names]

    def around(scene: Scene) -> Surroundings:
        return Surroundings(scene.with_obstacles(*movable), trackers, actors.speeds, people)

    segments = program_segments(result, around, ReplanningOptions(options.tick))
    simulation = ProgramSimulation(segments, actors.people, actors.objects, faults=faults)
    status = _simulate(simulation, options)
    steps = len(scenario.program.steps)
    if not simulation.segments.finished:
        output.console().print(f"not finished: at step {simulation.segments.current.step + 1} of {steps}")
        return status or 1
    output.console().print(f"all {steps} steps done in {simulation.summary.seconds:.2f} s")
    return status


def program_segments(
    result: ProgramResult, around: Callable[[Scene], Surroundings], options: ReplanningOptions
) -> list[Segment]:
    """Return the segments of a planned program. `around` adds people and moving objects to a scene."""
    program, own = result.scenario.program, result.scenario.motion
    assert program is not None
    segments: list[Segment] = []
    for stretch in result.stretches:
        robot, scene, step = stretch.robot, stretch.scene, stretch.step
        if stretch.curve is not None and stretch.check.limits is not None:
            # Only moves may leave their path. Other steps must stay on their curve.
            may_leave = isinstance(program.steps[step], Move)
            ways = replace(options, detours=may_leave, retreats=may_leave, joints=stretch.joints)
            replanner = Replanner(robot, around(scene), options=ways, prover=stretch.check.proof)
            timer = PathTimer(robot, stretch.check.limits, tool_speed=own.tool_speed, link_speed=own.link_speed)
            segments.append(Segment(replanner, timer.along(stretch.curve), robot, scene, step))
        elif segments:
            segments.append(Segment(segments[-1].replanner, None, robot, scene, step, stretch.motion.duration))
    return segments


def _simulate(simulation: Simulation, options: argparse.Namespace) -> int:
    """Run the simulation, and write the ticks and the summary."""
    folder, robot = Path(options.out), simulation.replanner.robot
    header = simulation.log_header()
    with ExitStack() as stack:
        logs: list[TickLog] = [stack.enter_context(closing(TicksFile(folder / "ticks.jsonl", header)))]
        if options.mcap is not None:
            from safe_ompl.live.ros import McapLog  # needs the extra

            logs.append(stack.enter_context(closing(McapLog(options.mcap, header))))
        bar = stack.enter_context(output.progress_bar(output.error_console()))
        ticks = stack.enter_context(closing(simulation.ticks(options.seconds)))

        def write(tick: dict[str, Any]) -> None:
            for log in logs:
                log.write(tick)

        status = output.each_until_ctrl_c(
            bar.track(ticks, total=round(options.seconds / options.tick), description="live"), write
        )
    summary = simulation.summary
    output.write_json(str(folder / "summary.json"), summary.as_dict())
    output.console().print(str(summary))
    output.error_console().print(f"ticks and summary in {folder}")
    if options.mcap is not None:
        output.error_console().print(f"log in {options.mcap}")
    seen = f"see it: safe-ompl view {folder / 'ticks.jsonl'}"
    if options.html is not None:
        save_page(read_recording(folder / "ticks.jsonl", robot), options.html)
        seen = f"view in {options.html}"
    output.error_console().print(seen)
    return status


def timed_way(way: FloatArray, robot: Robot, motion: MotionProver, scenario: Scenario) -> Trajectory:
    """Return the trajectory along way points under the scenario's limits."""
    own = scenario.motion
    rates = RateLimits.of(robot, own.velocity, own.acceleration, own.jerk)
    return time_path(way, robot, rates, motion=motion, tool_speed=own.tool_speed, link_speed=own.link_speed)


def _place(text: str) -> Pose:
    try:
        x, y, z, yaw = map(arguments.finite, text.split(","))
    except (ValueError, argparse.ArgumentTypeError):
        raise argparse.ArgumentTypeError(f"must be four finite numbers X,Y,Z,YAW, not {text!r}") from None
    return Pose((x, y, z), (0.0, 0.0, float(np.sin(yaw / 2)), float(np.cos(yaw / 2))))


# ------------------------------------------------------------------------------------------------ people and things


@dataclass
class Actors:
    """People and objects that move."""

    # The scenario's scene with the flying balls.
    scene: Scene
    # By the name of the person that each replaces.
    people: dict[str, PersonMover] = field(default_factory=dict)
    objects: dict[str, Drifting] = field(default_factory=dict)  # By obstacle
    # Bounds of the speeds of the objects [m/s].
    speeds: dict[str, float] = field(default_factory=dict)

    @property
    def still(self) -> Scene:
        """The obstacles that never move."""
        gone = {*self.people, *self.objects}
        return self.scene.without(*(name for name in self.scene.names if name in gone))


def choose_actors(scenario: Scenario, robot: Robot, people: People, options: argparse.Namespace) -> Actors:
    """Return the people and objects that the options name, and the obstacles that move by the scenario's limits."""
    found = Actors(scenario.scene)
    base = np.asarray(robot.keypoints(scenario.start_configuration(robot))[0])
    if options.people is None:
        arguments.refuse(options, ("clip", "place"), "nobody moves: give --people")
        if not options.movers:
            raise InputError("no person and no object moves: give a file of recordings or random", "--people")
    elif options.people.partition(":")[0] == RANDOM:
        arguments.refuse(options, ("clip",), f"is for recordings, not for {options.people!r}")
        found.people.update(_walkers(scenario, base, people, options))
    else:
        found.people.update(_recorded(scenario, options))
    if scenario.limits.moving is not None:
        for name, speed in scenario.limits.moving.speeds.items():
            if name not in scenario.scene.names:
                raise UnknownNameError("obstacle", name, scenario.scene.names, "limits.moving.speeds")
            if name not in found.people:
                found.objects[name] = Drifting(scenario.scene[name].pose.se3)
                found.speeds[name] = speed
    _add_balls(found, robot, scenario.start_configuration(robot), base, options)
    return found


def _persons(scenario: Scenario) -> list[tuple[str, Pose, float]]:
    """Return names, places and heights of the people of a scenario."""
    return [(one.name, one.pose, one.shape.height) for one in scenario.scene if isinstance(one.shape, Person)]


def _free_name(word: str, taken: tuple[str, ...]) -> str:
    k = 1
    while (name := word if k == 1 else f"{word}_{k}") in taken:
        k += 1
    return name


def _recorded(scenario: Scenario, options: argparse.Namespace) -> dict[str, PersonMover]:
    """Return the person who plays the recording, at the pose of the scenario's first person if there is one."""
    if not Path(options.people).is_file():
        raise InputError(
            f"must be a file of recordings, {RANDOM} or {RANDOM}:N, and there is no file {options.people!r}", "--people"
        )
    recording = Recording.load(options.people, options.clip or CLIP)
    recording = replace(recording, rate=options.faster * recording.rate)
    name, stands, height = next(iter(_persons(scenario)), (_free_name("person", scenario.scene.names), None, HEIGHT))
    body, place = TrackedBody(height), options.place
    if place is None and stands is None:
        raise InputError(_NO_PLACE, "--place")
    if place is None:
        place = _instead_of(stands, recording, body)
    return {name: Playback(recording, Tracker(recording.skeleton, body, place, options.noise))}


def _instead_of(pose: Any, recording: Recording, body: TrackedBody) -> Pose:
    """Return the pose of a recording at which its first frame has a person's position and orientation."""
    points, _ = body.completed(recording.skeleton.keypoints(recording.frames[0]))
    turn = pose.se3.rotation @ facing(points).T
    hips = pose.se3.act(body.height * PELVIS)
    return Pose.of(pin.SE3(turn, hips - turn @ body.pelvis(points)))


def _walkers(
    scenario: Scenario, base: FloatArray, people: People, options: argparse.Namespace
) -> dict[str, PersonMover]:
    """Return people who walk: the first ones replace those of the scenario, the others start at random places."""
    _, colon, number = options.people.partition(":")
    if colon and (not number.isdecimal() or int(number) < 1):
        raise InputError(f"must be {RANDOM}:N with a whole number N of at least 1, not {options.people!r}", "--people")
    persons = _persons(scenario)
    places = [options.place] if options.place is not None else [place for _, place, _ in persons]
    if not places:
        raise InputError(_NO_PLACE, "--place")
    rng = np.random.default_rng(options.seed)
    centre = np.array([base[0], base[1], places[0].position[2]])
    found: dict[str, PersonMover] = {}
    for k in range(int(number or 1)):
        angle = rng.uniform(-np.pi, np.pi)
        start = centre[:2] + np.array([np.cos(angle), np.sin(angle)])
        if k < len(places):
            start = np.array(places[k].position[:2])
        name, height = _free_name("person", (*scenario.scene.names, *found)), HEIGHT
        if k < len(persons):
            name, _, height = persons[k]
        tracker = Tracker(ALL_KEYPOINTS, TrackedBody(height), noise=options.noise)
        found[name] = Walker(people, centre, start, tracker=tracker, speed=options.faster, seed=options.seed + k)
    return found


def _add_balls(found: Actors, robot: Robot, start: FloatArray, base: FloatArray, options: argparse.Namespace) -> None:
    """Add balls that fly around the robot and start away from it."""
    rng, monitor = np.random.default_rng([options.seed, 1]), ContactMonitor(robot)
    for _ in range(options.movers):
        for _ in range(_MOST_BALL_TRIES):
            place = base + rng.uniform(-_FARTHEST_BALL, _FARTHEST_BALL, 3)
            far = np.linalg.norm(place - base)
            solids = part_solids("", Sphere(_BALL), pin.SE3(np.eye(3), place))
            if _NEAREST_BALL < far < _FARTHEST_BALL and monitor.nearest(start, solids).distance > _BALL_DISTANCE:
                break
        else:
            raise InputError(f"there is no room for {options.movers} balls around the robot", "--movers")
        way = rng.normal(size=3)
        speed = options.mover_speed * rng.uniform(0.2, 1.0)
        velocity = options.faster * speed * way / np.linalg.norm(way)
        name = _free_name("thing", found.scene.names)
        found.scene = Scene((*found.scene, Obstacle(name, Sphere(_BALL), Pose(tuple(place)))))
        room = np.array([base - _FARTHEST_BALL, base + _FARTHEST_BALL])
        found.objects[name] = Drifting(pin.SE3(np.eye(3), place), velocity, room)
        found.speeds[name] = options.mover_speed


def people_who_move(scenario: Scenario) -> People:
    """Return the scenario's people, whoever is tracked, with the larger clearance of theirs and the limits' own."""
    people = scenario.people or People()
    return replace(people, who=None, clearance=max(people.clearance, scenario.limits.min_clearance))


def limits_of_still(scenario: Scenario, still: Scene, *, beside_people: bool) -> Scenario:
    """Return the scenario with its still obstacles only, and limits that concern them."""
    limits = scenario.limits
    dangerous = [obstacle.name for obstacle in still if obstacle.weight > 0]
    kept_from = dangerous
    if limits.obstacles is not None:
        kept_from = [name for name in limits.obstacles if name in still.names]
        gone = set(limits.obstacles) - set(scenario.scene.names)
        if gone:
            raise UnknownNameError("obstacle", min(gone), scenario.scene.names, "limits.obstacles")
    limits = replace(
        limits,
        max_danger=limits.max_danger if dangerous else 0.0,
        min_clearance=limits.min_clearance if kept_from else 0.0,
        obstacles=tuple(kept_from) if kept_from else None,
        exempt=tuple(pair for pair in limits.exempt if pair[1] in kept_from),
        moving=None,
    )
    if scenario.limits.max_danger and beside_people:
        _log.warning("limits.max_danger applies to still obstacles only; the robot keeps a distance from moving people")
    if scenario.people is not None and scenario.people.contact:
        _log.warning("contact is allowed: %s", scenario.people.contact_sentence)
    if scenario.motion.max_danger is not None:
        _log.warning(
            "motion.max_danger is not applied in `live`; the robot keeps a distance from everything that moves"
        )
    return replace(scenario, scene=still, people=None, limits=limits)
