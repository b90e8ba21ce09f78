"""People and objects that move in `safe-ompl live`: recorded or at random."""

from __future__ import annotations

import argparse
import logging
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import pinocchio as pin

from safe_ompl.common import FloatArray, InputError, UnknownNameError
from safe_ompl.geometry import Obstacle, Person, Pose, Sphere
from safe_ompl.people import PELVIS, Recording, TrackedBody, Tracker, facing
from safe_ompl.people.simulation import (
    ALL_KEYPOINTS,
    ContactMonitor,
    Drifting,
    ObjectMover,
    PersonMover,
    Playback,
    Resting,
    Solid,
    Walker,
)
from safe_ompl.robot import Robot
from safe_ompl.scene import People, Scenario, Scene

_log = logging.getLogger(__name__)

RANDOM = "random"
CLIP = "clip_0"
_BALL = 0.05  # [m] radius
_AROUND, _BASE = 1.5, 0.25  # [m] largest and least distance of the balls from the robot's base
_APART = 0.3  # [m] between them and the robot at first
_TRIES = 1000


@dataclass
class Actors:
    """People and objects that move.

    Attributes
    ----------
    scene : Scene
        The scenario's, with the balls that fly about.
    people : dict of str to PersonMover
        By the name of the person that each replaces.
    objects : dict of str to ObjectMover
        By obstacle.
    speeds : dict of str to float
        Bounds of the speeds of the objects [m/s].
    """

    scene: Scene
    people: dict[str, PersonMover] = field(default_factory=dict)
    objects: dict[str, ObjectMover] = field(default_factory=dict)
    speeds: dict[str, float] = field(default_factory=dict)

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
    """Return the people and objects that the options name, and those that may move by the scenario's limits.

    Raises
    ------
    InputError
        If the options do not go together, or nothing moves.
    """
    found = Actors(scenario.scene)
    if options.people is None:
        for option, given in (("--clip", options.clip), ("--place", options.place)):
            if given is not None:
                raise InputError("there is nobody: give --people", option)
        if not options.movers:
            raise InputError("nobody and nothing moves: give a file of recordings or random", "--people")
    elif (count := _random_count(options.people)) is None:
        name, mover = _recorded(scenario, options)
        found.people[name] = mover
    else:
        if options.clip is not None:
            raise InputError(f"is for recordings, not for {options.people!r}", "--clip")
        found.people.update(_walkers(scenario, robot, people, count, options))
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
    if not Path(options.people).is_file():
        raise InputError(
            f"must be a file of recordings, {RANDOM} or {RANDOM}:N, and there is no file {options.people!r}",
            "--people",
        )
    recording = Recording.load(options.people, options.clip or CLIP)
    persons = _persons(scenario)
    body = _body_of(persons)
    if options.place is not None:
        place = options.place
    elif persons:
        place = _instead_of(persons[0].pose, recording, body)
    else:
        raise InputError("the scenario has no person whose place could be taken: say where", "--place")
    tracker = Tracker(recording.skeleton, body, place, options.noise)
    name = persons[0].name if persons else _free_name("person", scenario.scene.names)
    return name, Playback(recording, tracker, options.faster)


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
        body = _body_of(persons[k : k + 1])
        found[name] = Walker(
            people,
            centre,
            start,
            tracker=Tracker(ALL_KEYPOINTS, body, noise=options.noise),
            speed=options.faster,
            seed=options.seed + k,
        )
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
    first: FloatArray = robot.keypoints(q)[0]
    return first


# ---------------------------------------------------------------------------------------------------- limits


def limits_of_still(scenario: Scenario, found: Actors) -> Scenario:
    """Return the scenario with its still obstacles only, and the limits that concern them.

    The clearance from people and objects that move is in `clearance_of_movers`.
    """
    still, limits = found.still, scenario.limits
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
    if scenario.limits.max_danger and found.people:
        _log.warning(
            "limits.max_danger counts obstacles that stand still only; the robot keeps a distance from people who move"
        )
    if scenario.people is not None and scenario.people.contact:
        _log.warning(
            "people.contact is not used beside people who move: the robot stops before they can touch it"
        )
    if scenario.motion.max_danger is not None:
        _log.warning(
            "motion.max_danger is not kept in `live`; the robot keeps distances from all that moves instead"
        )
    return replace(scenario, scene=still, people=None, limits=limits)


def clearance_of_movers(scenario: Scenario) -> float:
    """Return the clearance from all that moves [m]: the larger of the people's and that of the limits."""
    people = scenario.people or People()
    return max(people.clearance, scenario.limits.min_clearance)
