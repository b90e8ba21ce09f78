"""What a view shows: a robot in its scene, paths by planner, danger, people who move."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from textwrap import shorten
from typing import Any, NamedTuple, TypeVar

import numpy as np
import pinocchio as pin

from safe_ompl.certificates import Certificate, RecordedCell
from safe_ompl.collision import CollisionChecker
from safe_ompl.common import FloatArray, InputError, documents as document, finite_array
from safe_ompl.danger import DangerField
from safe_ompl.geometry import STANDING, Obstacle, Person, Pose
from safe_ompl.io import CarriedProblem, MotionRecord, built_robot, built_scene, read_ticks
from safe_ompl.motions import Motion, MotionCheck
from safe_ompl.planning import PlanResult
from safe_ompl.planning.simplification import Curve, PathReport
from safe_ompl.robot import PackageDir, Robot
from safe_ompl.scene import CORE, Scene
from safe_ompl.tasks import ProgramResult, program_robot

CERTIFIED = "certified path"
# The number of samples of a motion of polynomials.
_MOTION_SAMPLES = 200
# The time to play a path without times once.
_PLAYING_TIME = 8.0  # [s]
_CHECK_SAMPLES = 400
# The rate of the samples of a program.
_PROGRAM_RATE = 50.0  # [Hz]
# At most this many letters of a step are shown.
_MOST_LETTERS = 40
RECORDING_ENDING = ".jsonl"


@dataclass(frozen=True)
class ViewerContent:
    """A robot in its scene, and what there is to show of its paths.

    Raises
    ------
    InputError
        If a path or the posture does not fit the robot.
    """

    robot: Robot  # Who moves
    scene: Scene  # What stands around it
    # The way points of each planner [rad or m].
    paths: Mapping[str, FloatArray] = field(default_factory=dict)
    # (n,), where the robot stands if there is no path; default: the middle of its limits
    posture: FloatArray | None = None
    # Options of the danger field, as those of `SafeSetup`; None: without danger
    danger: Mapping[str, Any] | None = field(default_factory=dict)
    # Planner name → motion in time: it is played as it is in time, with its speed and what bounds it. Its
    # knots are the path of that name
    motions: Mapping[str, MotionRecord] = field(default_factory=dict)
    # The people and objects that move during the motion.
    movers: Movers | None = None
    title: str = ""  # Title of the page

    def __post_init__(self) -> None:
        moved = {name: record.motion.knots for name, record in self.motions.items()}
        paths = {name: finite_array(way, (None, self.robot.n), name) for name, way in {**self.paths, **moved}.items()}
        for name, way in paths.items():
            if not len(way):
                raise InputError("must have a configuration at least, got none", f"path of {name}")
        still = np.clip(np.zeros(self.robot.n), self.robot.lower, self.robot.upper)
        posture = still if self.posture is None else finite_array(self.posture, (self.robot.n,), "posture")
        object.__setattr__(self, "paths", paths)
        object.__setattr__(self, "posture", next(iter(paths.values()))[0] if paths else posture)
        object.__setattr__(self, "title", self.title or self.robot.name)

    @classmethod
    def of_certificate(
        cls, content: Mapping[str, Any], title: str = "", package_dirs: Sequence[PackageDir] = ()
    ) -> ViewerContent:
        """Return what a certificate is about; it is shown, not verified.

        A single motion is shown as a path with its danger, several ones, or what takes an object, as they are in time.
        The robot is built from what the certificate carries; `package_dirs` as of `safe_ompl.load`.

        Raises
        ------
        InputError, CertificateError
            If it is no certificate, or robot or scene cannot be built or are not those of the certificate.
        """
        claims = Certificate.read(content)
        robot, scene = built_robot(claims.robot, package_dirs=package_dirs), built_scene(claims.scene)
        held = [{**stretch["motion"], "joint_names": claims.joint_names} for stretch in content["stretches"]]
        motions = [Motion.from_mapping(motion) for motion in held]
        first = claims.stretches[0]
        if len(motions) == 1 and not (first.attach or first.contacts):
            (motion,) = motions
            curved = motion.degree > 1
            path = (
                motion.at(np.linspace(motion.times[0], motion.times[-1], _MOTION_SAMPLES)) if curved else motion.knots
            )
            danger = {} if first.danger is None else first.danger.to_mapping()
            danger = {key: value for key, value in danger.items() if key != "bound"}
            return cls(robot, scene, {CERTIFIED: path}, danger=danger, title=title or f"{robot.name}, proven")
        cell, stages, begin = RecordedCell(robot, scene), [], 0.0
        for k, (stretch, motion) in enumerate(zip(claims.stretches, motions, strict=True)):
            cell.change(stretch, motion.knots[0])
            number = f"stretch {k + 1} of {len(motions)}"
            stages.append(_Stage(number, stretch.step or "motion", begin, motion, *cell.during(stretch.contacts)))
            begin += motion.duration
        return _of_stages(robot.bare, stages, title or robot.name, None)

    @classmethod
    def of_results(
        cls, results: Sequence[PlanResult], title: str = "", posture: FloatArray | None = None
    ) -> ViewerContent:
        """Return the solved ones of some results, by planner; where none is solved, the robot is in a `posture: (n,)`.

        Raises InputError if there is none, one does not know its robot and scene, or they are about different ones.
        """
        for result in results:
            if result.robot is None or result.scene is None:
                raise InputError(f"the result of {result.planner} does not know its robot and scene")
        robot, scene = _common([(r.robot, r.scene) for r in results], "result")
        solved = [(r.planner, f"seed {r.seed}", r.path) for r in results if r.path is not None]
        return cls(robot, scene, _by_name(solved), posture, results[0].danger, title=title)

    @classmethod
    def of_motions(cls, motions: Sequence[MotionRecord], title: str = "") -> ViewerContent:
        """Return motions in time, by planner; errors as of `of_results`."""
        robot, scene = _common([(m.problem.robot, m.problem.scene) for m in motions], "motion")
        named = _by_name([(m.name or "motion", str(k), m) for k, m in enumerate(motions, 1)])
        return cls(robot, scene, danger=motions[0].problem.danger, motions=named, title=title)

    @classmethod
    def of_check(cls, check: MotionCheck, title: str = "") -> ViewerContent:
        """Return a motion that something else made, with the stretches that are not proven."""
        motion = check.motion
        pace = 1.0 if motion.timed else motion.duration / _PLAYING_TIME
        marks = [time for found in check.violations for time in (found.first, found.at, found.last)]
        even = np.linspace(motion.times[0], motion.times[-1], _CHECK_SAMPLES)
        times = np.unique(np.concatenate([motion.times, even, marks]))
        times = times[np.diff(times, prepend=-np.inf) > 1e-9 * motion.duration]
        # What belongs to an instant is seen for this time beside it.
        near = 0.5 * motion.duration / _CHECK_SAMPLES
        lines, names = [], []
        for time in times.tolist():
            here = [found for found in check.violations if found.first - near <= time <= found.last + near]
            names.append("not proven" if here else "proven")
            said = (f"{f.kind}: {' – '.join(f.names)} {f.quantities[0]}".rstrip(" :") for f in here)
            lines.append("; ".join(said) or "proven")
        speeds = np.linalg.norm(motion.derivative(times), axis=1) * pace
        moved = MotionRecord(
            CarriedProblem(check.proof.checker.robot, check.proof.checker.scene, None),
            Motion.through(motion.at(times), (times - times[0]) / pace),
            speeds,
            binding=tuple(names),
            name=title,
            remarks=tuple(lines),
        )
        return cls.of_motions([moved], title=title)

    @classmethod
    def of_program(cls, result: ProgramResult) -> ViewerContent:
        """Return a program as one motion: things move with the tip while it holds them. InputError if there is none."""
        program, scenario = result.scenario.program, result.scenario
        steps = () if program is None else program.steps
        stages = [
            _Stage(f"step {s.step + 1} of {len(steps)}", str(steps[s.step]), s.begin, s.motion, s.robot, s.scene)
            for s in result.stretches
        ]
        return _of_stages(program_robot(scenario).bare, stages, scenario.name, scenario.danger)

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
        return max((record.motion.duration for record in self.motions.values()), default=_PLAYING_TIME)

    @cached_property
    def danger_field(self) -> DangerField | None:
        """The danger of the robot in its scene; None where there is none, or nothing is dangerous."""
        if self.danger is None:
            return None
        found = DangerField.of_options(self.robot, self.scene, self.danger)
        return found if len(found.points) else None

    @cached_property
    def reports(self) -> Mapping[str, PathReport]:
        """The report on each path; none where people or things move meanwhile, as they are in no report."""
        if self.movers is not None:
            return {}
        checker = CollisionChecker(self.robot, self.scene)
        return {name: PathReport.of(path, checker, self.danger_field) for name, path in self.paths.items()}

    @cached_property
    def safest(self) -> str:
        """The name of the path of least mean danger, of equal ones that with most clearance; empty for one path."""

        def cost(name: str) -> tuple[float, float]:
            report = self.reports[name]
            return 0.0 if report.danger is None else report.danger.mean, -report.clearance.min

        return min(self.reports, key=cost) if len(self.reports) > 1 else ""

    def facts(self, name: str) -> list[str]:
        """Return mean and peak danger, least clearance and length of a path in words; empty where none is known."""
        report = self.reports.get(name)
        if report is None:
            return []
        said = [] if report.danger is None else [f"danger: mean {report.danger.mean:.1f}, peak {report.danger.max:.1f}"]
        if report.clearance.obstacle is not None:
            said.append(f"least clearance: {1e3 * report.clearance.min:.0f} mm")
        return [*said, f"length: {report.length:.2f} rad"]

    def along(self, name: str, shares: FloatArray) -> FloatArray:
        """Return the configurations (S, n) at fractions (S,) of the length of a path, or of the playing time."""
        if name in self.motions:
            return self.motions[name].motion.at(shares * self.playing_time)
        if not self.paths:
            return np.tile(np.asarray(self.posture), (len(shares), 1))
        curve = Curve(self.robot, self.paths[name])
        return curve.at(shares * curve.length)


_Shown = TypeVar("_Shown")


def _by_name(shown: Sequence[tuple[str, str, _Shown]]) -> dict[str, _Shown]:
    """Return what is shown by its name; what has the name of another one gets what tells it apart, too."""
    found: dict[str, _Shown] = {}
    for name, apart, thing in shown:
        found[f"{name}, {apart}" if name in found else name] = thing
    return found


def _common(given: Sequence[tuple[Any, Any]], kind: str) -> tuple[Robot, Scene]:
    """Return the robot and the scene that all have in common, or raise InputError."""
    if not given:
        raise InputError(f"no {kind} to show; give at least one")
    robot, scene = given[0]
    for other, around in given:
        if around != scene or other.joint_names != robot.joint_names:
            raise InputError(f"{kind}s must be about the same robot and scene to be shown together")
    return robot, scene


Keypoints = Mapping[str, Sequence[float]]


@dataclass(frozen=True, eq=False)
class Movers:
    """Where people and things are at some instants; between two of them people stay where they were."""

    times: FloatArray  # (T,), instants [s]
    # The height of each person [m].
    heights: Mapping[str, float]
    # For each instant: name → key points in the world [m]; who is not there is not seen
    people: Sequence[Mapping[str, Keypoints]]
    # For each instant, the poses of the scene's obstacles by name.
    places: Sequence[Mapping[str, Pose]]

    @property
    def objects(self) -> frozenset[str]:
        """Names of the obstacles that move."""
        return frozenset(name for places in self.places for name in places)

    def sample(self, time: float) -> int:
        """Return the number of the instant at a time [s], or before it."""
        return int(np.clip(np.searchsorted(self.times, time, side="right") - 1, 0, len(self.times) - 1))

    def places_at(self, time: float) -> dict[str, Pose]:
        """Return where the things that are there are at a time [s]; between two instants they move evenly."""
        sample = self.sample(time)
        after = min(sample + 1, len(self.times) - 1)
        share = np.interp(time, self.times[[sample, after]], [0.0, 1.0]) if after > sample else 0.0
        ahead = self.places[after]
        return {
            name: Pose.of(pin.SE3.Interpolate(pose.se3, ahead.get(name, pose).se3, float(share)))
            for name, pose in self.places[sample].items()
        }

    def people_at(self, time: float) -> list[Obstacle]:
        """Return the people who are there at a time [s], as obstacles."""
        there = self.people[self.sample(time)]
        return [
            Obstacle(name, Person(self.heights[name], points), Pose(), weight=1.0) for name, points in there.items()
        ]

    def obstacles_at(self, time: float, scene: Scene) -> list[Obstacle]:
        """Return all that move, as they are at a time [s]: people, and obstacles of the scene at their places."""
        places = self.places_at(time)
        things = [replace(o, pose=places[o.name]) for o in scene if o.name in places]
        return [*self.people_at(time), *things]


class _Stage(NamedTuple):
    """A part of a program: which one, for which step, when it begins [s], what moves how, and among what."""

    number: str
    step: str
    begin: float
    motion: Motion
    robot: Robot
    scene: Scene

    @property
    def remark(self) -> str:
        """What it is, what is held, and what may touch."""
        held = ", ".join(item.name for item in self.robot.attached)
        told = [f"holding {held}"] if held else []
        told += [f"{' and '.join(o.touched_by)} may touch {o.name}" for o in self.scene if o.touched_by]
        said = f"{self.number}: {shorten(self.step, _MOST_LETTERS, placeholder=' …')}"
        return f"{said}; {', '.join(told)}" if told else said


def _of_stages(robot: Robot, stages: Sequence[_Stage], title: str, danger: Mapping[str, Any] | None) -> ViewerContent:
    """Return a program of a robot that holds nothing: what it is to hold is among the things that move."""
    if not stages:
        raise InputError("there is nothing to show: nothing was planned")
    known = {o.name: o for stage in reversed(stages) for o in stage.scene if not o.name.endswith(CORE)}
    shapes = {item.name: item.shape for stage in stages for item in stage.robot.attached}
    for name in shapes:
        known.setdefault(name, Obstacle(name, shapes[name]))
    model, data = robot.shared.model, robot.shared.model.createData()
    times, rows, speeds, kinds, remarks, places = [], [], [], [], [], []
    for stage in stages:
        motion, last = stage.motion, stage is stages[-1]
        count = int(np.ceil(_PROGRAM_RATE * motion.duration)) + 1
        even = np.linspace(motion.times[0], motion.times[-1], count + last, endpoint=last)
        times.append(stage.begin + even - motion.times[0])
        rows.append(motion.at(even))
        speeds.append(np.linalg.norm(motion.derivative(even), axis=1))
        kinds += [stage.step.partition(" ")[0]] * len(even)
        remarks += [stage.remark] * len(even)
        there = {o.name: o.pose for o in stage.scene if o.name in shapes}
        for q in rows[-1]:
            pin.framesForwardKinematics(model, data, robot.pinocchio_configuration(q))
            held = {
                item.name: Pose.of(data.oMf[model.getFrameId(item.link)] * item.pose.se3)
                for item in stage.robot.attached
            }
            places.append({**there, **held})
    first = {name: obstacle.moved(places[0].get(name, obstacle.pose)) for name, obstacle in known.items()}
    scene = Scene(tuple(first.values()), stages[0].scene.spacing)
    steps = np.concatenate(times) - stages[0].begin
    problem, moved = CarriedProblem(robot, scene, danger), Motion.through(np.vstack(rows), steps)
    shown = MotionRecord(problem, moved, np.concatenate(speeds), {}, tuple(kinds), title, tuple(remarks))
    movers = Movers(steps, {}, [{}] * len(steps), places) if shapes else None
    return ViewerContent(robot, scene, danger=danger, motions={title: shown}, movers=movers, title=title)


Ticks = tuple[Mapping[str, Any], Sequence[Mapping[str, Any]]]
"""Header and ticks."""


def read_recording(
    file: str | Path,
    robot: Robot | None = None,
    package_dirs: Sequence[PackageDir] = (),
    read: Callable[[str | Path], Ticks] = read_ticks,
) -> ViewerContent:
    """Return what a file of ticks shows: robot and people in motion, with the robot's state and its reason.

    The robot is by default built from what the file carries; `read` reads files of another form. Parameters and errors
    as of `safe_ompl.load`.
    """
    header, ticks = read(file)
    with document.within(str(file), ": "):
        if len(ticks) < 2:
            raise InputError(f"must have two ticks at least, got {len(ticks)}")
        if robot is None:
            with document.within("robot", ": "):
                robot = built_robot(document.require(header, "robot"), package_dirs=package_dirs)
        scene = built_scene(document.require(header, "scene"))
        times = np.array([document.require(tick, "time") for tick in ticks], dtype=float)
        rows = finite_array([document.require(tick, "q") for tick in ticks], (None, robot.n), "q")
        record = MotionRecord(
            CarriedProblem(robot, scene, None),
            Motion.through(robot.unrolled(rows), times - times[0]),
            np.linalg.norm([document.require(tick, "qd") for tick in ticks], axis=1),
            binding=tuple(str(document.require(tick, "state")) for tick in ticks),
            name="live",
            remarks=tuple(_remark(tick) for tick in ticks),
        )
        people = document.mapping("people", header.get("people") or {})
        movers = Movers(
            times - times[0],
            {name: float(document.require(person, "height")) for name, person in people.items()},
            [_keypoints(tick.get("people") or {}) for tick in ticks],
            [
                {
                    name: Pose(tuple(place["position"]), tuple(place["quaternion_xyzw"]))
                    for name, place in (tick.get("objects") or {}).items()
                }
                for tick in ticks
            ],
        )
    return ViewerContent(robot, scene, danger=None, motions={record.name: record}, movers=movers, title=Path(file).stem)


def _keypoints(people: Mapping[str, Any]) -> dict[str, Keypoints]:
    """Return the key points from which a `Person` is drawn; others, such as the pelvis, follow from them."""
    return {
        name: {point: place for point, place in points.items() if point in STANDING} for name, points in people.items()
    }


def _remark(tick: Mapping[str, Any]) -> str:
    said = str(tick["state"])
    if tick.get("distance") is not None:
        limb = str(tick.get("limb") or "").replace("_", " ")
        whose = f"{tick.get('who')}'s {limb}" if limb else str(tick.get("who"))
        said += f", {1e3 * tick['distance']:.0f} mm from {tick.get('link')} to {whose}"
    said += f" ({tick['rule']})" if tick.get("rule") else ""
    return f"{said}; {tick['reason']}" if tick.get("reason") else said
