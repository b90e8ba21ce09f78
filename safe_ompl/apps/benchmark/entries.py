"""Entries of the open table: paths and motions of any planner on problem sets, read, checked and judged.

A problem set is a file: MotionBenchMaker problems (JSON), or drives beside recorded people (`bench/drives.py`).
An entry names it by the name and the SHA-256 of that file.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from functools import cached_property
from hashlib import sha256
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np

from safe_ompl.apps.benchmark.judge import ROUNDING, SPACING, Beside, Judge, judged_drive, sample_counts
from safe_ompl.common import FloatArray, InputError, UnknownNameError, shown
from safe_ompl.common import documents as document
from safe_ompl.geometry import Pose
from safe_ompl.io import built_scene, motion_of_document, read_json, schema
from safe_ompl.motions import Motion
from safe_ompl.people import Recording, Tracker, without_glitches
from safe_ompl.robot import Robot
from safe_ompl.scene import MbmFile, Scene

FORMAT, VERSION = "safe-ompl entry", 1
LONGEST = 300  # characters of a text
JUDGED, DRIVES = "safe-ompl judged entry", "safe-ompl drives"
_TOLD = ("planner", "version_of_planner", "machine", "timing")
_ENTRY = ("format", "version", "system", *_TOLD, "failed", "sets")
_SET = ("name", "sha256", "joint_names", "answers")
_ANSWER = ("problem", "seed", "times", "path", "motion", "failed")
_DRIVE = ("name", "recording", "sha256", "clip", "gate", "place", "seconds", "start", "goals")
_SPEEDING = (
    1.05  # times its limit a joint may move, for logs bend between samples; else a drive counts as none
)


@dataclass(frozen=True)
class Problem:
    """A problem: from the start (n,) to any of the goals (G, n) in a scene; or to each in turn beside a person."""

    name: str
    robot: Robot
    scene: Scene
    start: FloatArray
    goals: FloatArray
    beside: Beside | None = None

    @cached_property
    def judge(self) -> Judge:
        """The judge of motions in its scene."""
        return Judge(self.robot, self.scene)


@dataclass(frozen=True)
class ProblemSet:
    """The problems of a file by name, for one robot; `outside` says why some cannot be asked: limits of joints."""

    name: str
    sha256: str
    robot: Robot
    problems: Mapping[str, Problem]
    outside: Mapping[str, str] = field(default_factory=dict)

    @classmethod
    def load(cls, file: str | Path) -> ProblemSet:
        """Read a file of problems; recordings of people are where it says, relative to its folder.

        Raises InputError, which names file, key and value, if it holds neither kind of problems, or is malformed.
        """
        path = Path(file)
        content, outside = read_json(path), dict[str, str]()
        if isinstance(content, Mapping) and content.get("format") == DRIVES:
            with document.within(str(path), ": "):
                robot, problems = _drives(content, path.parent)
        else:
            robot, problems, outside = _mbm(MbmFile.load(path))
        by_name = {problem.name: problem for problem in problems}
        return cls(path.stem, checksum(path), robot, by_name, outside)


def checksum(file: Path) -> str:
    """Return the SHA-256 of a file; raise InputError where it cannot be read."""
    try:
        return sha256(file.read_bytes()).hexdigest()
    except OSError as error:
        raise InputError(f"cannot be read ({error.strerror})", str(file)) from None


def _mbm(file: MbmFile) -> tuple[Robot, list[Problem], dict[str, str]]:
    """Return the robot, with limits that hold goals slightly outside, the problems, and why others are left out."""
    with document.within(str(file.path), ": "):
        robot = Robot.from_example(file.robot)
    found = list(file)
    robot = robot.with_limits(
        {name: held for problem in found for name, held in problem.widened_limits(robot).items()}
    )
    problems, outside = list[Problem](), dict[str, str]()
    for problem in found:
        name, beyond = f"{problem.family} {problem.index}", problem.beyond_limits(robot)
        if beyond is not None:
            outside[name] = beyond
            continue
        ends = problem.start_configuration(robot), problem.goal_configurations(robot)
        problems.append(Problem(name, robot, problem.scene, *ends))
    return robot, problems, outside


def _drives(content: Mapping[str, Any], folder: Path) -> tuple[Robot, list[Problem]]:
    robot = Robot.from_example(document.text("robot", document.require(content, "robot")))
    with document.within("scene"):
        scene = built_scene(document.mapping("scene", document.require(content, "scene")))
    problems = []
    for k, item in enumerate(document.sequence("drives", document.require(content, "drives"))):
        with document.within(f"drives[{k}]"):
            data = document.mapping("drive", item, _DRIVE)
            for key in _DRIVE:
                document.require(data, key)
            file = folder / document.text("recording", data["recording"])
            if checksum(file) != data["sha256"]:
                raise InputError(f"is not that of {file}: {shown(data['sha256'])}", "sha256")
            goals = tuple(
                document.numbers("goals", goal, robot.n) for goal in document.sequence("goals", data["goals"])
            )
            recording = Recording.load(file, document.text("clip", data["clip"]))
            gate = document.number("gate", data["gate"], above=0.0)
            beside = Beside(
                without_glitches(recording, Tracker(recording.skeleton, gate=gate))[0],
                Pose.from_mapping(document.mapping("place", data["place"])),
                document.number("seconds", data["seconds"], above=0.0),
                goals,
            )
            start = np.array(document.numbers("start", data["start"], robot.n))
            name = document.text("name", data["name"])
            problems.append(Problem(name, robot, scene, start, np.array(goals), beside))
    return robot, problems


@dataclass(frozen=True)
class Answer:
    """What a system answered to a problem: a motion, or why there is none; times [s] are as it told them."""

    set: str
    problem: Problem
    seed: int
    times: Mapping[str, float]
    motion: Motion | None
    failed: str = ""

    def judged(self) -> dict[str, Any]:
        """Return what the judge says, as plain data."""
        row: dict[str, Any] = {"set": self.set, "problem": self.problem.name, "seed": self.seed}
        row |= {"times": dict(self.times), "solved": self.motion is not None, "error": self.failed or None}
        if self.motion is None:
            return row
        row |= asdict(self.problem.judge.verdict(self.motion))
        outside = row.pop("outside")
        beside = self.problem.beside
        if beside is not None:
            drive = asdict(judged_drive(self.problem.robot, beside, self.motion))
            places = [row["worst"], *filter(None, [drive.pop("worst")])]
            row |= {**drive, "worst": min(places, key=lambda place: place["distance"])}
            row["touching"] |= drive["contacts_while_moving"] > 0
            if drive["speed"] > _SPEEDING:
                outside = f"a joint moves at {drive['speed']:.3g} of its largest speed"
        return {**row, "solved": not outside, "error": outside or None}


@dataclass(frozen=True)
class Entry:
    """An entry: the system, what it tells of itself, and its answers; or why it did not run."""

    system: str
    told: Mapping[str, str]
    answers: tuple[Answer, ...]
    failed: str = ""
    sha256: str = field(default="", compare=False)

    @classmethod
    def load(cls, file: str | Path, sets: Sequence[ProblemSet]) -> Entry:
        """Read an entry, and check it against the problem sets that it names.

        Raises
        ------
        InputError
            Names file, key and value: what is missing or unknown, a problem set with another checksum, a number that is
            not finite, a wrong number of joints, a start or goal that is not the problem's, an answer given twice.
        """
        content = read_json(file)
        with document.within(str(file), ": "):
            data = document.mapping("entry", content, _ENTRY)
            schema.check_form(data, FORMAT, VERSION)
            told = {key: _words(key, data[key]) for key in _TOLD if key in data}
            failed = _words("failed", data["failed"]) if "failed" in data else ""
            answers: list[Answer] = []
            for k, item in enumerate(document.sequence("sets", document.require(data, "sets"))):
                with document.within(f"sets[{k}]"):
                    new = _answers(document.mapping("set", item, _SET), sets)
                    if new and any(new[0].set == answer.set for answer in answers):
                        raise InputError(f"{new[0].set!r} is there twice", "name")
                    answers += new
            if bool(failed) == bool(answers):
                raise InputError("must hold answers, unless `failed` says why there are none", "sets")
            system = _words("system", document.require(data, "system"))
            return cls(system, told, tuple(answers), failed, checksum(Path(file)))

    def judged(self) -> dict[str, Any]:
        """Return what the judge says of all answers, as plain data: a row for each, and a summary of each set."""
        rows = [answer.judged() for answer in self.answers]
        told = {"system": self.system, "told": dict(self.told), "failed": self.failed, "sha256": self.sha256}
        return {"format": JUDGED, "version": VERSION, **told, "summary": summaries(rows), "rows": rows}


def _words(key: str, value: Any) -> str:
    """Return text as it may stand in a table."""
    text = document.text(key, value)
    if len(text) > LONGEST or not text.isprintable():
        raise InputError(f"must be at most {LONGEST} printable characters, got {shown(text)}", key)
    return text


def _answers(data: Mapping[str, Any], sets: Sequence[ProblemSet]) -> list[Answer]:
    name = document.text("name", document.require(data, "name"))
    known = {one.name: one for one in sets}
    if name not in known:
        raise UnknownNameError("problem set", name, known, "name")
    chosen = known[name]
    if document.require(data, "sha256") != chosen.sha256:
        raise InputError(f"{shown(data['sha256'])} is not that of {name!r}: {chosen.sha256}", "sha256")
    names = data.get("joint_names")
    joints = None if names is None else tuple(document.sequence("joint_names", names))
    found: dict[tuple[str, int], Answer] = {}
    for k, item in enumerate(document.sequence("answers", document.require(data, "answers"))):
        with document.within(f"answers[{k}]"):
            answer = _answer(document.mapping("answer", item, _ANSWER), chosen, joints)
            if (answer.problem.name, answer.seed) in found:
                raise InputError(f"{answer.problem.name!r} with seed {answer.seed} is there twice", "problem")
            found[answer.problem.name, answer.seed] = answer
    return list(found.values())


def _answer(data: Mapping[str, Any], chosen: ProblemSet, joints: tuple[str, ...] | None) -> Answer:
    name, seed = document.text("problem", document.require(data, "problem")), data.get("seed", 0)
    if name in chosen.outside:
        raise InputError(f"{name!r} cannot be asked: {chosen.outside[name]}", "problem")
    if name not in chosen.problems:
        raise InputError(f"{shown(name)} is not in the problem set {chosen.name!r}", "problem")
    if not isinstance(seed, int) or isinstance(seed, bool):
        raise InputError(f"must be a whole number, got {shown(seed)}", "seed")
    times = document.numbers_by_name("times", data.get("times", {}), at_least=0.0)
    given = [key for key in ("path", "motion", "failed") if key in data]
    if len(given) != 1:
        raise InputError(f"must have one of path, motion, failed; got {', '.join(given) or 'none'}", "answer")
    problem = chosen.problems[name]
    if given == ["failed"]:
        return Answer(chosen.name, problem, seed, times, None, _words("failed", data["failed"]))
    with document.within(given[0], ": "):
        return Answer(chosen.name, problem, seed, times, answered(problem, data[given[0]], given[0], joints))


def answered(
    problem: Problem, content: Any, kind: str = "path", joints: tuple[str, ...] | None = None
) -> Motion:
    """Return the motion of a path (way points) or a motion (see `read_motion`), if it answers the problem.

    Raises InputError if it is malformed, does not begin at the start, does not end at a goal, or may be longer than
    400 rad; beside people, if it has no times or is too short.
    """
    motion = Motion.through(content, names=joints) if kind == "path" else motion_of_document(content)
    robot, motion = problem.robot, motion.for_robot(problem.robot)
    sample_counts(motion, SPACING)
    first, last = motion.at(motion.times[[0, -1]])
    if not _is_at(robot, first, problem.start):
        raise InputError(f"{shown(first.round(6).tolist())} is not that of {problem.name!r}", "start")
    if problem.beside is not None:
        if not motion.timed or motion.duration < problem.beside.seconds - 1e-9:
            needed = f"{problem.beside.seconds:g} s at least"
            lasts = f"{motion.duration:g} s" if motion.timed else "no times"
            raise InputError(f"must have times and last {needed}, got {lasts}", "duration")
    elif not any(_is_at(robot, last, goal) for goal in problem.goals):
        raise InputError(f"{shown(last.round(6).tolist())} is not one of {problem.name!r}", "goal")
    return motion


def _is_at(robot: Robot, q: FloatArray, place: FloatArray) -> bool:
    return bool(np.abs(robot.difference(q, place)).max() <= ROUNDING)


def summaries(rows: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """Return what rows of one system show, for each problem set: counts, and medians over what is solved."""
    return [
        {"set": name, **_summary([row for row in rows if row["set"] == name])}
        for name in dict.fromkeys(row["set"] for row in rows)
    ]


COLUMNS = {  # key of a row: heading, unit's factor
    "min_clearance": ("min clearance [mm]", 1e3),
    "mean_clearance": ("mean clearance [mm]", 1e3),
    "near": ("< 50 mm [rad]", 1.0),
    "mean_danger": ("mean danger", 1.0),
    "peak_danger": ("peak danger", 1.0),
    "integral_danger": ("danger integral", 1.0),
    "length": ("length [rad]", 1.0),
}
DRIVEN = {
    "tasks": "tasks",
    "contacts_while_moving": "contacts moving",
    "contacts_at_rest": "contacts at rest",
}


def _summary(rows: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    solved = [row for row in rows if row["solved"]]
    times = [1e3 * sum(row["times"].values()) for row in solved if row["times"]]
    found: dict[str, Any] = {
        "answers": len(rows),
        "solved": len(solved),
        "touching": sum(row["touching"] for row in solved),
        "worst distance [mm]": min((1e3 * row["worst"]["distance"] for row in solved), default=None),
        "time [ms]": median(times) if times else None,
        "time, 90 % [ms]": float(np.percentile(times, 90)) if times else None,
    }
    for key, (heading, factor) in COLUMNS.items():
        values = [factor * row[key] for row in solved if row[key] is not None]
        found[heading] = median(values) if values else None
    if any("tasks" in row for row in solved):
        found |= {heading: sum(row[key] for row in solved) for key, heading in DRIVEN.items()}
        nearest = [1e3 * row["nearest"] for row in solved if row["nearest"] is not None]
        found["nearest moving [mm]"] = min(nearest, default=None)
    return found
