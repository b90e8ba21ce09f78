"""The content of a view: a robot in its scene, paths by planner, danger, and moving people and objects."""

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
from safe_ompl.io import EmbeddedProblem, MotionRecord, built_robot, built_scene, read_ticks
from safe_ompl.motions import Motion, MotionCheck
from safe_ompl.planning import PlanResult
from safe_ompl.planning.simplification import Curve, PathReport
from safe_ompl.robot import PackageDir, Robot
from safe_ompl.scene import CORE, Scene
from safe_ompl.tasks import ProgramResult, program_robot

CERTIFIED = "certified path"
# The number of samples of a piecewise polynomial motion.
_MOTION_SAMPLES = 200
# The time in which a path without times is played.
_PLAYING_TIME = 8.0  # [s]
_CHECK_SAMPLES = 400
# The rate of the samples of a program.
_PROGRAM_RATE = 50.0  # [Hz]
# At most this many letters of a step are shown.
_MOST_LETTERS = 40
RECORDING_ENDING = ".jsonl"


def safety_facts(report: PathReport) -> list[str]:
    """Describe mean and peak danger, and the least clearance, of a path; nothing that the scene does not have."""
    facts = [] if report.danger is None else [f"danger: mean {report.danger.mean:.1f}, peak {report.danger.max:.1f}"]
    if report.clearance.obstacle is not None:
        facts.append(f"least clearance: {1e3 * report.clearance.min:.0f} mm")
    return facts


@dataclass(frozen=True)
class ViewerContent:
    """The content of a view: a robot, its scene, its paths, and moving people and objects.

    Raises
    ------
    InputError
        If a path or the posture does not fit the robot.
    """

    robot: Robot
    scene: Scene
    # The way points of each planner [rad or m].
    paths: Mapping[str, FloatArray] = field(default_factory=dict)
    # The configuration (n,) of the robot if there is no path. The default is the middle of the joint limits.
    posture: FloatArray | None = None
    # The options of the danger field, as for `SafeSetup`. None means that no danger is shown.
    danger: Mapping[str, Any] | None = field(default_factory=dict)
    # Timed motions by planner. They are played in real time, with the speed and the active limit. The knots of a motion
    # are the path of the same name.
    motions: Mapping[str, MotionRecord] = field(default_factory=dict)
    # The people and objects that move during the motion.
    movers: Movers | None = None
    title: str = ""  # page title

    def __post_init__(self) -> None:
        moved = {name: record.motion.knots for name, record in self.motions.items()}
        paths = {name: finite_array(way, (None, self.robot.n), name) for name, way in {**self.paths, **moved}.items()}
        for name, way in paths.items():
            if not len(way):
                raise InputError("must have at least one configuration, got none", f"path of {name}")
        still = np.clip(np.zeros(self.robot.n), self.robot.lower, self.robot.upper)
        posture = still if self.posture is None else finite_array(self.posture, (self.robot.n,), "posture")
        object.__setattr__(self, "paths", paths)
        object.__setattr__(self, "posture", next(iter(paths.values()))[0] if paths else posture)
        object.__setattr__(self, "title", self.title or self.robot.name)

    @classmethod
    def of_certificate(
        cls, content: Mapping[str, Any], title: str = "", package_dirs: Sequence[PackageDir] = ()
    ) -> ViewerContent:
        """Return the robot, scene and motions of a certificate. The certificate is not verified.

        A single motion is shown as a path with its danger. Several motions, or a motion that takes an object, are shown
        over time. The robot is built from the recipe in the certificate; `package_dirs` as for `safe_ompl.load`.

        Raises
        ------
        InputError, CertificateError
            If `content` is not a certificate, or robot or scene cannot be built or differ from those certified.
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
        """Show the paths of all solved results, by planner. If none is solved, show the robot in a `posture: (n,)`.

        Raises InputError if there is no result, a result lacks its robot or scene, or robots or scenes differ.
        """
        for result in results:
            if result.robot is None or result.scene is None:
                raise InputError(f"the result of {result.planner} has no robot and scene")
        robot, scene = _common([(r.robot, r.scene) for r in results], "result")
        solved = [(r.planner, f"seed {r.seed}", r.path) for r in results if r.path is not None]
        return cls(robot, scene, _by_name(solved), posture, results[0].danger, title=title)

    @classmethod
    def of_motions(cls, motions: Sequence[MotionRecord], title: str = "") -> ViewerContent:
        """Show timed motions, by planner. Errors are those of `of_results`."""
        robot, scene = _common([(m.problem.robot, m.problem.scene) for m in motions], "motion")
        named = _by_name([(m.name or "motion", str(k), m) for k, m in enumerate(motions, 1)])
        return cls(robot, scene, danger=motions[0].problem.danger, motions=named, title=title)

    @classmethod
    def of_check(cls, check: MotionCheck, title: str = "") -> ViewerContent:
        """Show a checked motion and its violations."""
        motion = check.motion
        pace = 1.0 if motion.timed else motion.duration / _PLAYING_TIME
        marks = [time for found in check.violations for time in (found.first, found.at, found.last)]
        even = np.linspace(motion.times[0], motion.times[-1], _CHECK_SAMPLES)
        times = np.unique(np.concatenate([motion.times, even, marks]))
        times = times[np.diff(times, prepend=-np.inf) > 1e-9 * motion.duration]
        # A violation is shown from this time before it until this time after it, so that short ones are visible.
        near = 0.5 * motion.duration / _CHECK_SAMPLES
        lines, names = [], []
        for time in times.tolist():
            here = [found for found in check.violations if found.first - near <= time <= found.last + near]
            names.append("not proven" if here else "proven")
            descriptions = (f"{f.kind}: {' – '.join(f.names)} {f.quantities[0]}".rstrip(" :") for f in here)
            lines.append("; ".join(descriptions) or "proven")
        speeds = np.linalg.norm(motion.derivative(times), axis=1) * pace
        moved = MotionRecord(
            EmbeddedProblem(check.proof.checker.robot, check.proof.checker.scene, None),
            Motion.through(motion.at(times), (times - times[0]) / pace),
            speeds,
            binding=tuple(names),
            name=title,
            remarks=tuple(lines),
        )
        return cls.of_motions([moved], title=title)

    @classmethod
    def of_program(cls, result: ProgramResult) -> ViewerContent:
        """Show a program as one motion. Held objects move with the tip. Raises InputError if nothing was planned."""
        program, scenario = result.scenario.program, result.scenario
        steps = () if program is None else program.steps
        stages = [
            _Stage(f"step {s.step + 1} of {len(steps)}", str(steps[s.step]), s.begin, s.motion, s.robot, s.scene)
            for s in result.stretches
        ]
        return _of_stages(program_robot(scenario).bare, stages, scenario.name, scenario.danger)

    @cached_property
    def still(self) -> Scene:
        """The scene without moving obstacles."""
        moving = () if self.movers is None else self.movers.objects
        return replace(self.scene, obstacles=tuple(o for o in self.scene if o.name not in moving))

    @cached_property
    def scene_at_start(self) -> Scene:
        """The scene with the people at their first positions. The camera is chosen for this scene."""
        people = () if self.movers is None else self.movers.people_at(0.0)
        return replace(self.scene, obstacles=(*self.scene, *people))

    @property
    def playing_time(self) -> float:
        """The playing time [s]: the duration of the longest timed motion, or 8 s without timed motions."""
        return max((record.motion.duration for record in self.motions.values()), default=_PLAYING_TIME)

    @cached_property
    def danger_field(self) -> DangerField | None:
        """The danger field; None if no danger is shown or no obstacle is dangerous."""
        if self.danger is None:
            return None
        found = DangerField.of_options(self.robot, self.scene, self.danger)
        return found if len(found.points) else None

    @cached_property
    def reports(self) -> Mapping[str, PathReport]:
        """The report on each path. It is empty if people or objects move, because reports assume a static scene."""
        if self.movers is not None:
            return {}
        checker = CollisionChecker(self.robot, self.scene)
        return {name: PathReport.of(path, checker, self.danger_field) for name, path in self.paths.items()}

    @cached_property
    def safest(self) -> str:
        """The path with the least mean danger, then with the largest clearance; empty if there is only one path."""

        def cost(name: str) -> tuple[float, float]:
            report = self.reports[name]
            return 0.0 if report.danger is None else report.danger.mean, -report.clearance.min

        return min(self.reports, key=cost) if len(self.reports) > 1 else ""

    def facts(self, name: str) -> list[str]:
        """Describe mean and peak danger, least clearance and length of a path; empty if the path has no report."""
        report = self.reports.get(name)
        if report is None:
            return []
        return [*safety_facts(report), f"length: {report.length:.2f} rad"]

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
    """Map names to the given things. If a name is taken, the second text of the triple is appended to the name."""
    found: dict[str, _Shown] = {}
    for name, apart, thing in shown:
        found[f"{name}, {apart}" if name in found else name] = thing
    return found


def _common(given: Sequence[tuple[Any, Any]], kind: str) -> tuple[Robot, Scene]:
    """Return the common robot and scene. Raise InputError if nothing is given or robots or scenes differ."""
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
    """Positions of people and objects at T instants. Between two instants people stay at the earlier position."""

    # The instants (T,) [s].
    times: FloatArray
    # The height of each person [m].
    heights: Mapping[str, float]
    # For each instant, the key points of each person in the world [m]. A person who is missing is not drawn.
    people: Sequence[Mapping[str, Keypoints]]
    # For each instant, the poses of the scene's obstacles by name.
    places: Sequence[Mapping[str, Pose]]

    @property
    def objects(self) -> frozenset[str]:
        """The names of the moving obstacles."""
        return frozenset(name for places in self.places for name in places)

    def sample(self, time: float) -> int:
        """Return the index of the last instant at or before a time [s]."""
        return int(np.clip(np.searchsorted(self.times, time, side="right") - 1, 0, len(self.times) - 1))

    def places_at(self, time: float) -> dict[str, Pose]:
        """Return the poses of the objects at a time [s], interpolated between instants."""
        sample = self.sample(time)
        after = min(sample + 1, len(self.times) - 1)
        share = np.interp(time, self.times[[sample, after]], [0.0, 1.0]) if after > sample else 0.0
        ahead = self.places[after]
        return {
            name: Pose.of(pin.SE3.Interpolate(pose.se3, ahead.get(name, pose).se3, float(share)))
            for name, pose in self.places[sample].items()
        }

    def people_at(self, time: float) -> list[Obstacle]:
        """Return the people who are present at a time [s], as obstacles."""
        there = self.people[self.sample(time)]
        return [
            Obstacle(name, Person(self.heights[name], points), Pose(), weight=1.0) for name, points in there.items()
        ]

    def obstacles_at(self, time: float, scene: Scene) -> list[Obstacle]:
        """Return the people and the moving obstacles of the scene, at their poses at a time [s]."""
        places = self.places_at(time)
        things = [replace(o, pose=places[o.name]) for o in scene if o.name in places]
        return [*self.people_at(time), *things]


class _Stage(NamedTuple):
    """A segment of a program: number, step, begin [s], motion, robot and scene."""

    number: str
    step: str
    begin: float
    motion: Motion
    robot: Robot
    scene: Scene

    @property
    def remark(self) -> str:
        """The step, the held objects, and the contacts that are allowed."""
        held = ", ".join(item.name for item in self.robot.attached)
        details = [f"holding {held}"] if held else []
        details += [f"{' and '.join(o.touched_by)} may touch {o.name}" for o in self.scene if o.touched_by]
        step_text = f"{self.number}: {shorten(self.step, _MOST_LETTERS, placeholder=' …')}"
        return f"{step_text}; {', '.join(details)}" if details else step_text


def _of_stages(robot: Robot, stages: Sequence[_Stage], title: str, danger: Mapping[str, Any] | None) -> ViewerContent:
    """Combine the segments of a program. The robot is drawn without held objects, which are moving objects instead."""
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
    problem, moved = EmbeddedProblem(robot, scene, danger), Motion.through(np.vstack(rows), steps)
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
    """Read a file of ticks and return the motions of robot and people, with the robot's state and its reason.

    By default the robot is built from the recipe in the file. `read` reads the header and the ticks. Other parameters
    and errors are those of `safe_ompl.load`.
    """
    header, ticks = read(file)
    with document.within(str(file), ": "):
        if len(ticks) < 2:
            raise InputError(f"must have at least two ticks, got {len(ticks)}")
        if robot is None:
            with document.within("robot", ": "):
                robot = built_robot(document.require(header, "robot"), package_dirs=package_dirs)
        scene = built_scene(document.require(header, "scene"))
        times = np.array([document.require(tick, "time") for tick in ticks], dtype=float)
        rows = finite_array([document.require(tick, "q") for tick in ticks], (None, robot.n), "q")
        record = MotionRecord(
            EmbeddedProblem(robot, scene, None),
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
    """Keep only the key points that define a `Person`. Others, such as the pelvis, are computed from them."""
    return {
        name: {point: place for point, place in points.items() if point in STANDING} for name, points in people.items()
    }


def _remark(tick: Mapping[str, Any]) -> str:
    text = str(tick["state"])
    if tick.get("distance") is not None:
        limb = str(tick.get("limb") or "").replace("_", " ")
        whose = f"{tick.get('who')}'s {limb}" if limb else str(tick.get("who"))
        text += f", {1e3 * tick['distance']:.0f} mm from {tick.get('link')} to {whose}"
    text += f" ({tick['rule']})" if tick.get("rule") else ""
    return f"{text}; {tick['reason']}" if tick.get("reason") else text
