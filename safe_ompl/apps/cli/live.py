"""`safe-ompl live`: a robot beside people and things that move, in simulated time."""

from __future__ import annotations

import argparse
import logging
from collections.abc import Callable
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
from safe_ompl.common import FloatArray, InputError, UnknownNameError
from safe_ompl.geometry import Obstacle, Person, Pose, Sphere
from safe_ompl.io import TickLog, TicksFile, ticks_header
from safe_ompl.people import PELVIS, CalibratedReach, Recording, TrackedBody, Tracker, facing
from safe_ompl.people.replanning import Replanner, ReplanningOptions
from safe_ompl.people.simulation import (
    ALL_KEYPOINTS,
    ContactMonitor,
    Drifting,
    Faults,
    ObjectMover,
    PersonMover,
    Playback,
    Resting,
    Simulation,
    Solid,
    Summary,
    Walker,
)
from safe_ompl.planning import SafeSetup, setup_scenario
from safe_ompl.robot import Robot
from safe_ompl.scene import People, Scenario, Scene
from safe_ompl.trajectories import RateLimits, Trajectory, time_path
from safe_ompl.view import read_recording, save_page

_PLANNER = "SafeRRTConnect"


def add_commands(commands: Any) -> None:
    """Add `live` to the commands."""
    parser = arguments.add_parser(
        commands,
        "live",
        prepare,
        "drive a robot beside people and things that move, in simulated time",
        "Plan from start to goal and back, and drive there again and again beside a recorded person, or "
        "beside people and things that move at random. Every motion is proven at every tick, including its stop. A "
        "monitor looks for contacts.",
    )
    arguments.add_scenario(parser)
    option(
        parser,
        "--people FILE|random[:N]",
        "a file of recorded key points (.npz; .mcap or a bag of ROS 2), or the number of people who walk at random",
    )
    option(parser, "--clip NAME", f"recording in the file; default: {CLIP}, or the only person of a bag")
    option(parser, "--topic NAME", "topic of the people in a bag; default: the only one")
    option(parser, "--skeleton NAME", "skeleton of key points in a bag that have no names, such as coco17")
    option(
        parser,
        "--place X,Y,Z,YAW",
        "where the origin of the recording, or the first person who walks, is in the world [m, rad]; default: "
        "where the first person of the scenario stands",
        _place,
    )
    add_reach(parser)
    option(parser, "--movers N", "number of balls of 0.1 m that fly around the robot", arguments.count, 0)
    option(parser, "--mover-speed V", "largest speed of these balls [m/s]", arguments.limit, 0.5)
    option(parser, "--seconds S", "simulated time", arguments.seconds, 60.0)
    option(parser, "--out DIR", "folder for ticks.jsonl and summary.json", required=True)
    option(parser, "--html FILE", "also write a page that plays the simulation offline (.html)", output.PAGE)
    add_mcap(parser)
    option(parser, "--tick S", "time between commands", arguments.seconds, 0.05)
    arguments.add_run_options(parser, usual_time="the scenario's")
    arguments.add_package_dirs(parser)
    group = parser.add_argument_group("faults")
    option(group, "--noise M", "largest error of key points, known to the tracker [m]", arguments.noise, 0.0)
    option(group, "--drops SHARE", "share of the frames that are lost", arguments.share, 0.0)
    option(group, "--late SHARE", "share of the ticks without an answer", arguments.share, 0.0)
    option(group, "--faster FACTOR", "times the speeds recorded, or relied on", arguments.limit, 1.0)


def add_reach(parser: argparse.ArgumentParser) -> None:
    """Add how far people go."""
    option(
        parser,
        "--reach FILE",
        "how far people go, see `safe-ompl people calibrate` (YAML); default: the reach of the scenario's people, "
        "or their speeds",
    )


def reach_of(people: People | None, options: argparse.Namespace) -> CalibratedReach | None:
    """Return the calibrated reach that the options name, or else the scenario's people; None: there is none."""
    file = options.reach or (None if people is None else people.reach)
    return None if file is None else CalibratedReach.load(file)


def add_mcap(parser: argparse.ArgumentParser) -> None:
    """Add the log that Foxglove opens."""
    option(parser, "--mcap FILE", "also write a log that Foxglove opens (.mcap)", output.LOG)
    arguments.add_force(parser)


def prepare(options: argparse.Namespace) -> Callable[[], int]:
    """Check what the options name, and return the job."""
    scenario = arguments.load_scenario(options.scenario, options.package_dir)
    latency = min(Faults.latency, options.tick)
    faults = Faults(options.noise, options.drops, options.late, options.seed, latency)
    robot = scenario.build_robot()
    people = people_who_move(scenario)
    reach, found = reach_of(people, options), choose_actors(scenario, robot, people, options)
    if reach is not None:
        for mover in found.people.values():
            mover.tracker = replace(mover.tracker, gate=reach.gate)
    setup = setup_scenario(limits_of_still(scenario, found.still, beside_people=bool(found.people)), robot)
    output.make_folder(Path(options.out), "--out", ("ticks.jsonl", "summary.json"), force=options.force)
    replanner = Replanner(
        robot,
        found.scene,
        found.trackers,
        found.speeds,
        people=people,
        options=ReplanningOptions(reach, tick=options.tick),
        prover=setup.motion_prover,
    )
    return partial(_drive, scenario, setup, replanner=replanner, actors=found, faults=faults, options=options)


def _drive(
    scenario: Scenario,
    setup: SafeSetup,
    replanner: Replanner,
    actors: Actors,
    faults: Faults,
    options: argparse.Namespace,
) -> int:
    """Plan, simulate, and write ticks and summary."""
    folder = Path(options.out)
    result = setup.plan(_PLANNER, **arguments.run_options(options, scenario, _PLANNER))
    if result.path is None:
        output.error_console().print(f"safe-ompl: {_PLANNER} found no path: {result.status}")
        return 1
    ways = [timed_way(way, replanner.robot, replanner.prover, scenario) for way in (result.path, result.path[::-1])]
    simulation = Simulation(replanner, ways, actors.people, actors.objects, faults=faults)
    around = replanner.surroundings.scene
    header = ticks_header(replanner.tick, replanner.robot, around, replanner.surroundings.description())
    with ExitStack() as stack:
        logs: list[TickLog] = [stack.enter_context(closing(TicksFile(folder / "ticks.jsonl", header)))]
        if options.mcap is not None:
            from safe_ompl.apps.exchange import McapLog  # needs the extra

            logs.append(stack.enter_context(closing(McapLog(options.mcap, header, replanner.robot, around))))
        bar = stack.enter_context(output.progress_bar(output.error_console()))
        ticks = stack.enter_context(closing(simulation.ticks(options.seconds)))
        number = round(options.seconds / options.tick)

        def write(tick: dict[str, Any]) -> None:
            for log in logs:
                log.write(tick)

        status = output.each_until_ctrl_c(bar.track(ticks, total=number, description="live"), write)
    summary = simulation.summary
    output.write_json(str(folder / "summary.json"), summary.as_dict())
    output.console().print(describe(summary))
    output.error_console().print(f"ticks and summary in {folder}")
    if options.mcap is not None:
        output.error_console().print(f"log in {options.mcap}")
    if options.html is None:
        output.error_console().print(f"see it: safe-ompl view {folder / 'ticks.jsonl'}")
    else:
        save_page(read_recording(folder / "ticks.jsonl", setup.robot), options.html)
        output.error_console().print(f"view in {options.html}")
    return status


def timed_way(way: FloatArray, robot: Robot, motion: MotionProver, scenario: Scenario) -> Trajectory:
    """Return the trajectory along way points under the scenario's limits."""
    limits = scenario.motion
    return time_path(
        way,
        robot,
        RateLimits.of(robot, limits.velocity, limits.acceleration),
        motion=motion,
        tool_speed=limits.tool_speed,
        link_speed=limits.link_speed,
    )


def describe(summary: Summary) -> str:
    """Return the summary of a simulation in one line."""
    median, late = (1e3 * t for t in summary.reaction)
    fast = f" (the robot at {summary.contact_speed:.2f} m/s at most)" if summary.contacts_while_moving else ""
    gated = ""
    if summary.refused:
        raw, refused = 100 * summary.model_obeyed_raw, 100 * summary.refused
        gated = f" ({raw:.1f} % with the {refused:.2g} % of the key points that the gate refused)"
    return (
        f"{summary.seconds:g} s: {summary.tasks} tasks, {summary.stops} stops; contacts while moving "
        f"{summary.contacts_while_moving}{fast}, after violations {summary.contacts_after_violations}, at rest "
        f"{summary.contacts_at_rest}, in retreats {summary.contacts_retreating}; "
        f"model obeyed {100 * summary.model_obeyed:.1f} % of the time{gated}; reaction "
        f"{median:.1f} ms (99 %: {late:.1f}); deadlines missed {summary.deadlines_missed}"
    )


def _place(text: str) -> Pose:
    parts = text.split(",")
    try:
        x, y, z, yaw = (arguments.finite(part) for part in parts)
    except (ValueError, argparse.ArgumentTypeError):
        raise argparse.ArgumentTypeError(f"must be four finite numbers X,Y,Z,YAW, not {text!r}") from None
    return Pose((x, y, z), (0.0, 0.0, float(np.sin(yaw / 2)), float(np.cos(yaw / 2))))


_log = logging.getLogger(__name__)

RANDOM = "random"
CLIP = "clip_0"
_BALL = 0.05  # [m] radius
_AROUND, _BASE = 1.5, 0.25  # [m] largest and least distance of the balls from the robot's base
_APART = 0.3  # [m] between them and the robot at first
_TRIES = 1000


@dataclass
class Actors:
    """People and objects that move."""

    scene: Scene  # The scenario's, with the balls that fly about
    # By the name of the person that each replaces
    people: dict[str, PersonMover] = field(default_factory=dict)
    objects: dict[str, ObjectMover] = field(default_factory=dict)  # By obstacle
    speeds: dict[str, float] = field(default_factory=dict)  # Bounds of the speeds of the objects [m/s]

    @property
    def trackers(self) -> dict[str, Tracker]:
        """How the people are tracked."""
        return {name: mover.tracker for name, mover in self.people.items()}

    @property
    def still(self) -> Scene:
        """The obstacles that never move."""
        gone = {*self.people, *self.objects}
        return self.scene.without(*(name for name in self.scene.names if name in gone))


def choose_actors(scenario: Scenario, robot: Robot, people: People, options: argparse.Namespace) -> Actors:
    """Return the people and objects that the options name, and those that may move by the scenario's limits."""
    found = Actors(scenario.scene)
    if options.people is None:
        arguments.refuse(options, ("clip", "place", "topic", "skeleton"), "there is nobody: give --people")
        if not options.movers:
            raise InputError("nobody and nothing moves: give a file of recordings or random", "--people")
    elif (number := _random_count(options.people)) is None:
        name, mover = _recorded(scenario, options)
        found.people[name] = mover
    else:
        why = f"is for recordings, not for {options.people!r}"
        arguments.refuse(options, ("clip", "topic", "skeleton"), why)
        found.people.update(_walkers(scenario, robot, people, number, options))
    if scenario.limits.moving is not None:
        for name, speed in scenario.limits.moving.speeds.items():
            if name not in scenario.scene.names:
                raise UnknownNameError("obstacle", name, scenario.scene.names, "limits.moving.speeds")
            if name not in found.people:
                found.objects[name] = Resting(scenario.scene[name].pose.se3)
                found.speeds[name] = speed
    _add_balls(found, robot, scenario.start_configuration(robot), options)
    return found


def _random_count(text: str) -> int | None:
    """Return how many people `random` or `random:N` asks for; None: it is a file."""
    word, colon, number = text.partition(":")
    if word != RANDOM:
        return None
    if not colon:
        return 1
    if not number.isdecimal() or int(number) < 1:
        raise InputError(f"must be {RANDOM}:N with a whole number N of at least 1, not {text!r}", "--people")
    return int(number)


def _persons(scenario: Scenario) -> list[Obstacle]:
    return [obstacle for obstacle in scenario.scene if isinstance(obstacle.shape, Person)]


def _body_of(persons: list[Obstacle]) -> TrackedBody:
    """Return a body as tall as the first of some persons."""
    shape = persons[0].shape if persons else Person()
    assert isinstance(shape, Person)
    return TrackedBody(shape.height)


def _free_name(word: str, taken: tuple[str, ...]) -> str:
    k = 1
    while (name := word if k == 1 else f"{word}_{k}") in taken:
        k += 1
    return name


# ---------------------------------------------------------------------------------------------------- people


def _recorded(scenario: Scenario, options: argparse.Namespace) -> tuple[str, Playback]:
    """Return the person who plays the recording."""
    if not arguments.is_bag(options.people) and not Path(options.people).is_file():
        raise InputError(
            f"must be a file of recordings, {RANDOM} or {RANDOM}:N, and there is no file {options.people!r}", "--people"
        )
    recording = _recording(options)
    persons = _persons(scenario)
    body, name = _body_of(persons), _free_name("person", scenario.scene.names)
    if options.place is not None:
        place = options.place
    elif persons:
        place = _instead_of(persons[0].pose, recording, body)
    else:
        raise InputError("the scenario has no person whose place could be taken: say where", "--place")
    tracker = Tracker(recording.skeleton, body, place, options.noise)
    return (persons[0].name if persons else name), Playback(recording, tracker, options.faster)


def _recording(options: argparse.Namespace) -> Recording:
    """Return the recording that the options name."""
    if arguments.is_bag(options.people):
        output.need_extra("mcap", "--people")
        from safe_ompl.apps.exchange import PeopleSource, read_people  # needs the extra

        return read_people(options.people, PeopleSource(options.topic, options.clip, options.skeleton))
    arguments.refuse(options, ("topic", "skeleton"), f"is for bags, not for {options.people!r}")
    return Recording.load(options.people, options.clip or CLIP)


def _instead_of(pose: Pose, recording: Recording, body: TrackedBody) -> Pose:
    """Return the pose of a recording that puts its first frame where a person stands, facing the same way."""
    points, _ = body.completed(recording.skeleton.keypoints(recording.frames[0]))
    turn = pose.se3.rotation @ facing(points).T
    hips = pose.se3.act(body.height * PELVIS)
    return Pose.of(pin.SE3(turn, hips - turn @ body.pelvis(points)))


def _walkers(
    scenario: Scenario, robot: Robot, people: People, count: int, options: argparse.Namespace
) -> dict[str, Walker]:
    """Return people who walk: the first ones replace those of the scenario, the others start at random places."""
    persons = _persons(scenario)
    poses = [options.place] if options.place is not None else [person.pose for person in persons]
    if not poses:
        raise InputError("the scenario has no person whose place could be taken: say where", "--place")
    rng = np.random.default_rng(options.seed)
    base = _base(robot, scenario.start_configuration(robot))
    centre = np.array([base[0], base[1], poses[0].position[2]])
    found: dict[str, Walker] = {}
    for k in range(count):
        angle = rng.uniform(-np.pi, np.pi)
        start = centre[:2] + np.array([np.cos(angle), np.sin(angle)])
        if k < len(poses):
            start = np.array(poses[k].position[:2])
        taken = (*scenario.scene.names, *found)
        name = persons[k].name if k < len(persons) else _free_name("person", taken)
        tracker = Tracker(ALL_KEYPOINTS, _body_of(persons[k : k + 1]), noise=options.noise)
        seed = options.seed + k
        found[name] = Walker(people, centre, start, tracker=tracker, speed=options.faster, seed=seed)
    return found


# ---------------------------------------------------------------------------------------------------- things


def _add_balls(found: Actors, robot: Robot, start: FloatArray, options: argparse.Namespace) -> None:
    """Add balls that fly around the robot and start away from it."""
    rng, base = np.random.default_rng([options.seed, 1]), _base(robot, start)
    monitor = ContactMonitor(robot)
    for _ in range(options.movers):
        for _ in range(_TRIES):
            place = base + rng.uniform(-_AROUND, _AROUND, 3)
            far = np.linalg.norm(place - base)
            ball = Sphere(_BALL).parts()[0].geometry
            solid = Solid("", "", ball, pin.SE3(np.eye(3), place))
            if _BASE < far < _AROUND and monitor.nearest(start, [solid]).distance > _APART:
                break
        else:
            raise InputError(f"there is no room for {options.movers} balls around the robot", "--movers")
        way = rng.normal(size=3)
        speed = options.mover_speed * rng.uniform(0.2, 1.0)
        velocity = options.faster * speed * way / np.linalg.norm(way)
        name = _free_name("thing", found.scene.names)
        found.scene = Scene((*found.scene, Obstacle(name, Sphere(_BALL), Pose(tuple(place)))))
        found.objects[name] = Drifting(place, velocity, base, _AROUND, (base, _BASE))
        found.speeds[name] = options.mover_speed


def _base(robot: Robot, q: FloatArray) -> FloatArray:
    """Return where the skeleton of the robot begins (3,) [m]."""
    return np.asarray(robot.keypoints(q)[0])


# ---------------------------------------------------------------------------------------------------- limits


def limits_of_still(scenario: Scenario, still: Scene, *, beside_people: bool) -> Scenario:
    """Return the scenario with its still obstacles only, and limits that concern them; see `people_who_move`."""
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
        _log.warning(
            "limits.max_danger counts obstacles that stand still only; the robot keeps a distance from people who move"
        )
    if scenario.people is not None and scenario.people.contact:
        _log.warning("contact is allowed: %s", scenario.people.contact_sentence)
    if scenario.motion.max_danger is not None:
        _log.warning("motion.max_danger is not kept in `live`; the robot keeps distances from all that moves instead")
    return replace(scenario, scene=still, people=None, limits=limits)


def people_who_move(scenario: Scenario) -> People:
    """Return the scenario's people, whoever is tracked; the larger clearance of theirs and the limits' is kept."""
    people = scenario.people or People()
    return replace(people, who=None, clearance=max(people.clearance, scenario.limits.min_clearance))
