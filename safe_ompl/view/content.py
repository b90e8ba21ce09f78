"""What a view shows: a robot in its scene, paths by planner, danger, the proof of a path, people who move."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from safe_ompl.common import FloatArray, InputError, finite_array
from safe_ompl.danger import DangerField
from safe_ompl.geometry import Obstacle, Person, Pose
from safe_ompl.io import TimedMotion, built_robot, built_scene
from safe_ompl.motions import Motion
from safe_ompl.paths import Curve
from safe_ompl.planning import PlanResult, wiring
from safe_ompl.robot import Robot
from safe_ompl.scene import Scene
from safe_ompl.view.annotations import Proof

CERTIFIED = "certified path"
_SAMPLES = 200  # of a motion of polynomials
_PLAYING_TIME = 8.0  # [s] to play a path once that has no times


@dataclass(frozen=True)
class ViewerContent:
    """A robot in its scene, and what there is to show of its paths.

    Parameters
    ----------
    robot : Robot
        Who moves.
    scene : Scene
        What stands around it.
    paths : mapping of str to (N, n) array, optional
        Planner name → way points [rad or m].
    posture : (n,) array, optional
        Where the robot stands if there is no path; default: the middle of its limits.
    danger : mapping or None
        Options of the danger field, as those of `SafeSetup`; None: without danger.
    proof : Proof, optional
        The intervals that prove a path of the same name.
    motions : mapping of str to TimedMotion, optional
        Planner name → motion in time: it is played as it is in time, with its speed and what bounds it. Its
        configurations are the path of that name.
    movers : Movers, optional
        People and things that move meanwhile.
    title : str, optional
        Title of the page.

    Raises
    ------
    InputError
        If a path or the posture does not fit the robot.
    """

    robot: Robot
    scene: Scene
    paths: Mapping[str, FloatArray] = field(default_factory=dict)
    posture: FloatArray | None = None
    danger: Mapping[str, Any] | None = field(default_factory=dict)
    proof: Proof | None = None
    motions: Mapping[str, TimedMotion] = field(default_factory=dict)
    movers: Movers | None = None
    title: str = ""

    def __post_init__(self) -> None:
        moved = {name: motion.configurations for name, motion in self.motions.items()}
        paths = {
            name: finite_array(way, (None, self.robot.n), name)
            for name, way in {**self.paths, **moved}.items()
        }
        for name, way in paths.items():
            if not len(way):
                raise InputError("must have a configuration at least, got none", f"path of {name}")
        still = np.clip(np.zeros(self.robot.n), self.robot.lower, self.robot.upper)
        posture = still if self.posture is None else finite_array(self.posture, (self.robot.n,), "posture")
        object.__setattr__(self, "paths", paths)
        object.__setattr__(self, "posture", next(iter(paths.values()))[0] if paths else posture)
        object.__setattr__(self, "title", self.title or self.robot.name)

    @classmethod
    def of_certificate(cls, content: Mapping[str, Any], robot: Robot | None = None) -> ViewerContent:
        """Return what a certificate is about, with its proof; it is shown, not verified.

        Parameters
        ----------
        content : mapping
            The certificate.
        robot : Robot, optional
            Its robot; default: built from what the certificate carries.

        Raises
        ------
        InputError, CertificateError
            If robot or scene cannot be built, or are not those of the certificate.
        """
        robot = built_robot(content["robot"]) if robot is None else robot
        scene = built_scene(content["scene"])
        path = np.array(content["path"], dtype=float)
        claim = content["danger"] or {}
        danger = {key: value for key, value in claim.items() if key != "bound"}
        if content.get("motion") is not None:  # its proof has no intervals
            motion = Motion.from_mapping(content["motion"])
            path = motion.at(np.linspace(motion.times[0], motion.times[-1], _SAMPLES))
        proof = None if content.get("motion") else Proof.of_certificate(content, robot, scene)
        return cls(robot, scene, {CERTIFIED: path}, danger=danger, proof=proof, title=f"{robot.name}, proven")

    @classmethod
    def of_results(
        cls, results: Sequence[PlanResult], title: str = "", posture: FloatArray | None = None
    ) -> ViewerContent:
        """Return the solved ones of some results, by planner; the same planner again gets its seed.

        Where none is solved, the robot stands in a `posture: (n,)`.

        Raises
        ------
        InputError
            If there is no result, one does not know its robot and scene, or they are about different ones.
        """
        if not results:
            raise InputError("no result to show; give at least one")
        paths: dict[str, FloatArray] = {}
        for result in results:
            if result.robot is None or result.scene is None:
                raise InputError(f"the result of {result.planner} does not know its robot and scene")
            if result.scene != results[0].scene or result.joint_names != results[0].joint_names:
                raise InputError("results must be about the same robot and scene to be shown together")
            if result.path is not None:
                seen = result.planner in paths
                paths[f"{result.planner}, seed {result.seed}" if seen else result.planner] = result.path
        first = results[0]
        assert first.robot is not None
        assert first.scene is not None
        return cls(first.robot, first.scene, paths, posture, first.danger, title=title)

    @classmethod
    def of_motions(cls, motions: Sequence[TimedMotion], title: str = "") -> ViewerContent:
        """Return motions in time, by planner; the same planner again gets a number.

        Raises
        ------
        InputError
            If there is none, or they are about different robots or scenes.
        """
        if not motions:
            raise InputError("no motion to show; give at least one")
        first = motions[0]
        named: dict[str, TimedMotion] = {}
        for motion in motions:
            if motion.scene != first.scene or motion.robot.joint_names != first.robot.joint_names:
                raise InputError("motions must be about the same robot and scene to be shown together")
            name = motion.name or "motion"
            named[f"{name}, {len(named) + 1}" if name in named else name] = motion
        return cls(first.robot, first.scene, danger=first.danger, motions=named, title=title)

    @cached_property
    def still(self) -> Scene:
        """The scene without what moves."""
        moving = () if self.movers is None else self.movers.objects
        return replace(self.scene, obstacles=tuple(o for o in self.scene if o.name not in moving))

    @cached_property
    def scene_at_start(self) -> Scene:
        """The scene, and where people are at first: what decides from where to look."""
        people = () if self.movers is None else self.movers.people_at(0.0)
        return replace(self.scene, obstacles=(*self.scene, *people))

    @property
    def playing_time(self) -> float:
        """How long it plays [s]: as long as the longest motion in time, else some seconds."""
        return max((motion.duration for motion in self.motions.values()), default=_PLAYING_TIME)

    @cached_property
    def danger_field(self) -> DangerField | None:
        """The danger of the robot in its scene; None where there is none, or nothing is dangerous."""
        if self.danger is None:
            return None
        found = wiring.danger_field(self.robot, self.scene, self.danger)
        return found if found.points is not None and len(found.points) else None

    def along(self, name: str, shares: FloatArray) -> FloatArray:
        """Return the configurations (S, n) at fractions (S,) of the length of a path, or of the playing time."""
        if name in self.motions:
            return self.motions[name].at(shares * self.playing_time)
        if not self.paths:
            return np.repeat(self._start[None], len(shares), axis=0)
        curve = Curve(self.robot, self.paths[name])
        return curve.at(shares * curve.length)

    @property
    def _start(self) -> FloatArray:
        assert self.posture is not None
        return self.posture


Keypoints = Mapping[str, Sequence[float]]


@dataclass(frozen=True, eq=False)
class Movers:
    """Where people and things are at some instants; between two of them they stay where they were.

    Parameters
    ----------
    times : (T,) array
        Instants [s].
    heights : mapping of str to float
        Name of a person → height [m].
    people : sequence of mapping
        For each instant: name → key points in the world [m]; who is not there is not seen.
    places : sequence of mapping
        For each instant: name of an obstacle of the scene → its pose.
    """

    times: FloatArray
    heights: Mapping[str, float]
    people: Sequence[Mapping[str, Keypoints]]
    places: Sequence[Mapping[str, Pose]]

    @property
    def objects(self) -> frozenset[str]:
        """Names of the obstacles that move."""
        return frozenset(name for places in self.places for name in places)

    def sample(self, time: float) -> int:
        """Return the number of the instant at a time [s], or before it."""
        return int(np.clip(np.searchsorted(self.times, time, side="right") - 1, 0, len(self.times) - 1))

    def people_at(self, time: float) -> list[Obstacle]:
        """Return the people who are there at a time [s], as obstacles."""
        there = self.people[self.sample(time)]
        return [
            Obstacle(name, Person(self.heights[name], points), Pose(), weight=1.0)
            for name, points in there.items()
        ]

    def obstacles_at(self, time: float, scene: Scene) -> list[Obstacle]:
        """Return all that move, as they are at a time [s]: people, and obstacles of the scene at their places."""
        places = self.places[self.sample(time)]
        things = [replace(o, pose=places[o.name]) for o in scene if o.name in places]
        return [*self.people_at(time), *things]
