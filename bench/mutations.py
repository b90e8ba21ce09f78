"""Certificates in hostile hands: mutated ones are refused, or say nothing false.

Each certificate of eight small problems is mutated with its structure in mind: keys and entries are added, dropped,
renamed, swapped, scaled, put in another order, at every depth; shapes, joints and limits of the URDF that it carries,
obstacles and mesh files of its scene. The fingerprints of robot and scene are forged in half of these, the digest in
nearly all, and some are issued anew for the robot and the scene that came out, as whoever forges well would. All are
verified twice:

given    against the user's own robot, scene, people, danger and limits: what is accepted must be true of these.
carried  with nothing given: what is accepted must be true of the robot and the scene that the file carries, and the
         first sentence must say that they are the file's own.

`false` counts what is accepted although a sentence is not true, or cannot be read, by a judge that samples
(`_judge.py`); `crashed` what ends in any error but a refusal in one line. Both must be 0.
Mutation k of a seed is always the same one.
"""

from __future__ import annotations

import argparse
import copy
import json
import random
import re
import zlib
from base64 import b64decode, b64encode
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np
import pinocchio as pin

from bench._harness import Report
from bench._judge import Judge, carried
from safe_ompl import (
    Box,
    CollisionChecker,
    Cylinder,
    DangerField,
    DangerLimit,
    Mesh,
    Motion,
    MotionProver,
    Obstacle,
    PathTimer,
    People,
    Pose,
    RateLimits,
    Robot,
    SafeOmplError,
    Scenario,
    Scene,
    Sphere,
    TipBounds,
    ToolOrientation,
    certificate,
    verify,
)
from safe_ompl.certificates import motion_certificate, program_certificate, terms_of
from safe_ompl.certificates.verifier.verify import AskedTerms, Verified
from safe_ompl.collision import Separation
from safe_ompl.io.problems import built_robot
from safe_ompl.io.schema import digest
from safe_ompl.motions import check_with
from safe_ompl.robot import Attachment, RobotSpec, robot_hash
from safe_ompl.scene import Attach, Detach, Goal, MotionLimits, Move, Program

CLAIM = "no certificate is accepted of which a sentence is false, whoever changed it"
ROOT = Path(__file__).parents[1]
ARM = ROOT / "scenarios" / "robots"
PATH = np.array([[0.9, -2.2], [0.3, -2.0], [-0.3, -2.0]])
TUBE = (0.01, 0.02)
RATES = {"velocity": 1.0, "acceleration": 4.0, "jerk": 100.0}
POLYNOMIALS = Motion.hermite([0.0, 1.2, 2.5], PATH, [[0.0, 0.0], [-0.5, 0.05], [0.0, 0.0]], np.zeros((3, 2)))
TICKS = np.linspace(0.0, 2.5, 51)
SAMPLED = Motion.sampled(TICKS, POLYNOMIALS.at(TICKS), 1.0)
MOST_DANGER = 7.0
CELLS = 12  # of a motion: what is claimed is the same with many, and takes longer
SCENE = Scene(
    (
        Obstacle("person", Cylinder(0.16, 0.2), Pose((0.8, 0.05, 0.0)), weight=1.0),
        Obstacle("machine", Box((0.16, 0.16, 0.2)), Pose((0.0, 0.72, 0.0))),
        Obstacle("bin", Sphere(0.08), Pose((-0.1, -0.7, 0.0)), weight=0.5),
    ),
    spacing=0.25,
)
ROD = Attachment("rod", Box((0.1, 0.02, 0.02)), "tip", Pose((0.05, 0.0, 0.0)))
# A rod on a pedestal, before the tip of the arm at `PATH[1]`: it is taken, and put where the arm is at `PATH[2]`.
PEDESTAL = Obstacle("pedestal", Cylinder(0.012, 0.05), Pose((0.409, -0.378, -0.0345)))
DEPTH = 0.001
STEPS = (
    Move(configuration=tuple(PATH[1].tolist())),
    Attach(object="rod"),
    Move(configuration=tuple(PATH[2].tolist()), touching=(("rod", "pedestal"),), depth=DEPTH),
    Detach(object="rod"),
    Move(configuration=tuple(PATH[1].tolist())),
)
PEOPLE = People(who=("person",), speed=0.3, reaction_time=0.05)


@dataclass(frozen=True)
class Case:
    """A certificate, and what its user means by it."""

    name: str
    content: dict[str, Any]
    robot: Robot
    scene: Scene
    terms: AskedTerms
    reissue: Callable[[Robot, Scene], dict[str, Any]]

    def judge(self) -> Judge:
        """Return the judge of what is said of the user's own robot and scene."""
        motion, danger = self.terms.motion or {}, dict(self.terms.danger or {})
        asked: dict[str, Any] = {key: motion.get(key) for key in ("velocity", "acceleration", "jerk")}
        steps = [step for step in self.terms.steps or () if isinstance(step, Move)]
        contacts = {pair: step.depth for step in steps for pair in step.touching}
        asked |= {"danger": danger, "people": dict(self.terms.stops or {}), "contacts": contacts}
        return Judge(self.robot, self.scene, asked)


@cache
def cases() -> tuple[Case, ...]:
    """Return a path with all claims but those of time, a robot that holds a rod, a motion beside a person, others.

    The others are the path with a tube, polynomials with all that is claimed of them, bare samples, a program that
    moves a rod, and its second stretch alone.
    """
    spec = RobotSpec(urdf=ARM / "planar2.urdf", srdf=ARM / "planar2.srdf", tip="tip")
    held = replace(spec, base=Pose((0.0, 0.0, 0.4)), attached=(ROD,), locked={})
    mesh = Obstacle("wedge", Mesh(ROOT / "tests" / "data" / "wedge.obj", (0.1, 0.1, 0.1)), Pose((0.9, 0.0, 0.4)))
    plain = {"tool_speed": 1.5, "link_speed": 1.5, "velocity": 1.0, "acceleration": 4.0}
    return (
        _case("path", spec, SCENE, None, None),
        _case("holds a rod", held, SCENE.without("person").with_obstacles(mesh), None, None),
        _case("in time", spec, SCENE, MotionLimits(**plain, jerk=100.0), PEOPLE),
        _case("path with a tube", spec, SCENE, None, None, tube=TUBE),
        _case("polynomials", spec, SCENE, MotionLimits(**RATES), None, POLYNOMIALS, TUBE),
        _case("bare samples", spec, SCENE, MotionLimits(**RATES), None, SAMPLED),
        _program_case("program", spec, slice(0, 5)),
        _program_case("takes a rod", spec, slice(1, 3)),
    )


def _program_case(name: str, spec: RobotSpec, chosen: slice) -> Case:
    """Return a certificate of some of the steps, in a scene with the rod and its pedestal."""
    steps = STEPS[chosen]
    start = PATH[1] if isinstance(steps[0], Attach) else PATH[0]
    bare = Robot(spec)
    rod = Obstacle("rod", ROD.shape, Pose.of(bare.tip_pose(PATH[1]) * pin.SE3(np.eye(3), np.array([0.1, 0.0, 0.0]))))
    scene = SCENE.with_obstacles(PEDESTAL, rod)
    limits = MotionLimits(**RATES)
    scenario = Scenario(name, spec, scene, tuple(start.tolist()), None, motion=limits, program=Program(steps))

    def issue(robot: Robot, scene: Scene) -> dict[str, Any]:
        begin, parts, q, time = (robot, scene), [], start, 0.0
        for step in steps:
            if isinstance(step, Attach):
                held = robot.tip_pose(q).inverse() * scene["rod"].pose.se3
                robot = robot.with_attached("rod", scene["rod"].shape, "tip", Pose.of(held))
                scene = scene.without("rod")
            elif isinstance(step, Detach):
                (item,) = robot.attached
                scene = scene.with_obstacles(begin[1]["rod"].moved(Pose.of(robot.tip_pose(q) * item.pose.se3)))
                robot = begin[0]
            elif isinstance(step, Move):
                ends = [q, np.array(step.configuration)]
                still = np.zeros((2, 2))
                around = scene.touched(step.touching, step.depth) if step.touching else scene
                checker = CollisionChecker(robot, around)
                wanted = Separation().with_min_clearance(checker, 0.005, ["bin", "machine"])
                danger = DangerLimit(DangerField.of_scene(robot, around), MOST_DANGER)
                proof = MotionProver(checker, separation=wanted, limits=[danger])
                rates = RateLimits.of(robot, *RATES.values())
                motion = Motion.hermite([0.0, 1.5], ends, still, still)
                parts.append((time, check_with(motion, proof, rates)))
                q, time = ends[1], time + motion.duration
        content = program_certificate(parts, begin=begin)
        return json.loads(json.dumps(content))  # type: ignore[no-any-return]

    robot = scenario.build_robot()
    return Case(name, issue(robot, scene), robot, scene, terms_of(scenario, robot), issue)


def _case(
    name: str,
    spec: RobotSpec,
    scene: Scene,
    motion: MotionLimits | None,
    people: People | None,
    curve: Motion | None = None,
    tube: tuple[float, ...] = (),
) -> Case:
    goal = Goal(configurations=(tuple(PATH[-1].tolist()),))
    scenario = Scenario(
        name, spec, scene, tuple(PATH[0].tolist()), goal, motion=motion or MotionLimits(), people=people
    )
    robot = scenario.build_robot()

    def issue(robot: Robot, scene: Scene) -> dict[str, Any]:
        field, claims = DangerField.of_scene(robot, scene), {"also_sampled": "your checker, sampled at 0.01 rad"}
        trajectory = None
        if motion is not None and curve is not None:
            limits = RateLimits.of(robot, motion.velocity, motion.acceleration, motion.jerk)
            checker = CollisionChecker(robot, scene)
            moving = Separation(margin=0.005, speeds={"bin": 0.01}, time=0.2, tube=tube)
            wanted = moving.with_min_clearance(checker, 0.02, ["bin", "machine"])
            upright = ToolOrientation(robot, [0, 0, 1], [0, 0, 1], 0.1)
            box = TipBounds(robot, [-np.inf, -0.9, -0.1], [np.inf, 0.9, 0.6])
            proof = MotionProver(checker, separation=wanted, limits=[upright, box, DangerLimit(field, MOST_DANGER)])
            return json.loads(  # type: ignore[no-any-return]
                json.dumps(motion_certificate(check_with(curve, proof, limits)))
            )
        if motion is None:
            claims["clearance"] = {"distance": 0.02, "obstacles": ["bin", "machine"]}
            claims["moving_obstacles"] = {"speeds": {"machine": 0.05, "bin": 0.01}, "time": 0.2}
            orientation = {"axis": [0, 0, 1], "direction": [0, 0, 1], "angle": 0.1}
            claims["tool"] = {"orientation": orientation, "position": {"y": [-0.9, 0.9], "z": [-0.1, 0.6]}}
            claims["tube"] = tube or None
        else:
            proof = MotionProver(CollisionChecker(robot, scene))
            limits = RateLimits.of(robot, motion.velocity, motion.acceleration, motion.jerk)
            timer = PathTimer(
                robot, limits, motion=proof, people=people, tool_speed=motion.tool_speed, link_speed=motion.link_speed
            )
            trajectory = timer.time(PATH, cells=CELLS)
        content = certificate(PATH, robot, scene, claims, field=field, trajectory=trajectory)
        return json.loads(json.dumps(content))  # type: ignore[no-any-return]

    terms = terms_of(scenario, robot, timed=motion is not None)
    return Case(name, issue(robot, scene), robot, scene, terms, issue)


# ----------------------------------------------------------------------------------------------- the mutations

WORDS = ("person", "machine", "bin", "rod", "pedestal", "link1", "link2", "base", "tip", "head")
WORDS += ("max", "mean", "softmax", "length", "x", "", "0.1")
ODD: tuple[Any, ...] = (None, True, False, "", "0.1", -1, 0, 1, 2.5, 1e-9, -1e-9, 1e308, 10**400)
ODD += (float("nan"), float("inf"), [], {}, [[]], {"": 0})
NUMBER = re.compile(r"-?\d+\.?\d*(?:e-?\d+)?")


def places(value: Any, at: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """Yield the way to every value of a document."""
    yield at
    if isinstance(value, dict):
        for key in value:
            yield from places(value[key], (*at, key))
    elif isinstance(value, list):
        for k, item in enumerate(value):
            yield from places(item, (*at, k))


def chosen(rng: random.Random, content: Any) -> tuple[Any, ...]:
    """Return a place: of each key as likely as of every other one, however long the lists are."""
    by_key: dict[str, list[tuple[Any, ...]]] = {}
    for at in places(content):
        by_key.setdefault("/".join(key for key in at if isinstance(key, str)), []).append(at)
    carried_keys = [key for key in by_key if key.startswith(("robot/", "scene/"))]
    keys = carried_keys if carried_keys and rng.random() < 0.35 else list(by_key)
    return rng.choice(by_key[rng.choice(keys)])


def replaced(content: Any, at: tuple[Any, ...], change: Callable[[Any], Any]) -> Any:
    """Return a copy of a document with `change` of what is at a place there."""
    if not at:
        return change(content)
    changed = copy.copy(content)
    changed[at[0]] = replaced(content[at[0]], at[1:], change)
    return changed


def value_at(content: Any, at: tuple[Any, ...]) -> Any:
    """Return what is at a place."""
    for key in at:
        content = content[key]
    return content


def mutated(rng: random.Random, value: Any, content: Any) -> Any:
    """Return something else instead of a value, most often of its kind."""
    other = value_at(content, chosen(rng, content))
    choices: list[Callable[[], Any]] = [lambda: rng.choice(ODD), lambda: copy.deepcopy(other)]
    if isinstance(value, (int, float)) and not isinstance(value, bool):
        choices = [*choices, *5 * [lambda: scaled(rng, value)]]
    elif isinstance(value, str):
        kind = _xml if "<robot" in value else _word
        choices = [*choices, *(9 if kind is _xml else 3) * [lambda: kind(rng, value)]]
    elif isinstance(value, list) and value:
        choices += 4 * [lambda: _list(rng, value)]
    elif isinstance(value, dict) and value:
        choices += 4 * [lambda: _mapping(rng, value, other)]
    return rng.choice(choices)()


def scaled(rng: random.Random, value: float) -> float:
    """Return a number that is a little or much different."""
    if not abs(value) < 1e300:  # from an earlier mutation
        return 1.0
    return rng.choice(
        [
            value + rng.choice([-1, 1]) * 10 ** rng.uniform(-12, 2),
            value * rng.choice([-1, 0.01, 0.5, 0.9, 0.99, 1.01, 1.1, 2, 100]),
            rng.choice([0, 1, -1, round(value)]),
        ]
    )


def _word(rng: random.Random, value: str) -> str:
    if len(value) > 200 and re.fullmatch(r"[A-Za-z0-9+/=]+", value):  # a file: other numbers in it
        text = zlib.decompress(b64decode(value)).decode("latin1")
        return b64encode(zlib.compress(_rescaled(rng, text, NUMBER).encode("latin1"))).decode()
    return rng.choice(
        [rng.choice(WORDS), value[:-1], value + "x", value.upper(), f"../{value}", f"{value}\n", f"/{value}"]
    )


def _rescaled(rng: random.Random, text: str, pattern: re.Pattern[str]) -> str:
    found = list(pattern.finditer(text))
    if not found:
        return text
    match = rng.choice(found)
    return f"{text[: match.start()]}{scaled(rng, float(match.group())):.9g}{text[match.end() :]}"


def _xml(rng: random.Random, text: str) -> str:
    """Change a URDF or SRDF: shapes, places, limits; tags that are dropped, doubled, renamed, or lead elsewhere."""
    numbers = re.compile(r'(?<=[" ])-?\d+\.?\d*(?:e-?\d+)?(?=[" ])')
    tags = list(
        re.finditer(
            r"<(collision|visual|limit|origin|axis|disable_collisions|joint|link)\b[^>]*?(/>|>.*?</\1>)", text, re.S
        )
    )
    sizes = list(re.finditer(r'(radius|length|size|lower|upper)="([^"]*)"', text))
    kind = rng.choice(["number", "number", "size", "size", "drop", "double", "name", "mesh", "entity", "cut"])
    if kind == "number":
        return _rescaled(rng, text, numbers)
    if kind == "size" and sizes:
        match = rng.choice(sizes)
        return text[: match.start(2)] + _rescaled(rng, match.group(2), NUMBER) + text[match.end(2) :]
    if kind in ("drop", "double") and tags:
        match = rng.choice(tags)
        return text[: match.start()] + (2 * match.group() if kind == "double" else "") + text[match.end() :]
    if kind == "name":
        return text.replace(rng.choice(["link1", "joint1", "tip", "base"]), rng.choice(WORDS))
    if kind == "mesh":
        name = rng.choice(["/etc/hostname", "file:///etc/hostname", "package://etc/hostname", "../../etc/hostname"])
        return re.sub(r"<cylinder [^>]*/>", f'<mesh filename="{name}"/>', text, count=1)
    if kind == "entity":
        return f'<!DOCTYPE robot [<!ENTITY a "0.01">]>{text}'
    return text[: rng.randrange(len(text))]


def _list(rng: random.Random, value: list[Any]) -> list[Any]:
    j, k = (rng.randrange(len(value)) for _ in range(2))
    swapped = list(value)
    swapped[j], swapped[k] = swapped[k], swapped[j]
    numbers = all(isinstance(item, (int, float)) for item in value)
    factor = rng.choice([0.5, 0.99, 1.01, 2])
    return rng.choice(
        [
            value[:k] + value[k + 1 :],
            [*value, copy.deepcopy(value[k])],
            rng.sample(value, len(value)),
            swapped,
            value[::-1],
            [factor * item for item in value] if numbers else value[:k],
        ]
    )


def _mapping(rng: random.Random, value: dict[str, Any], other: Any) -> dict[str, Any]:
    key, second = (rng.choice(sorted(value)) for _ in range(2))
    rest = {name: item for name, item in value.items() if name != key}
    return rng.choice(
        [
            rest,
            {**value, rng.choice(WORDS): copy.deepcopy(other)},
            {**rest, rng.choice([*WORDS, f"{key}s", second]): value[key]},
            {**value, key: value[second], second: value[key]},
            {**value, key: None},
            dict(reversed(value.items())),
        ]
    )


def mutation(case: Case, seed: int, k: int) -> Any:
    """Return the k-th mutation of a certificate; the same one for the same seed."""
    rng = random.Random(f"{seed}/{k}")
    content = case.content
    for _ in range(rng.choice([1, 1, 1, 2, 3])):
        at = chosen(rng, content)
        value = value_at(content, at)
        content = replaced(content, at, lambda value=value: mutated(rng, value, case.content))
    if isinstance(content, dict):
        if rng.random() < 0.5:
            content = _forged(case, content, rng.random() < 0.6)
        if rng.random() < 0.95:
            with suppress(TypeError, ValueError, OverflowError):
                content = {**content, "digest": digest(content)}
    return content


def issued_anew(case: Case, document: dict[str, Any], robot: Robot, scene: Scene) -> dict[str, Any]:
    """Return the certificate of the same path for another robot, which travels as a document, in another scene."""
    with mock.patch("safe_ompl.certificates.issue.embedded_robot", return_value=document):
        return case.reissue(robot, scene)


def _forged(case: Case, content: dict[str, Any], anew: bool) -> dict[str, Any]:
    """Return a certificate with the fingerprints of what it carries now, or one that is issued anew for that."""
    if content.get("robot") == case.content["robot"] and content.get("scene") == case.content["scene"]:
        return content
    try:
        robot = built_robot(content["robot"])
        scene = carried(content)[1]
        marks = {"hash": robot_hash(robot), "links_without_collision": sorted(robot.links_without_collision)}
        if anew:
            return issued_anew(case, {**content["robot"], **marks}, robot, scene)
        scene_marks = {**content["scene"], "hash": scene.content_hash()}
        return {**content, "robot": {**content["robot"], **marks}, "scene": scene_marks}
    except Exception:  # whatever cannot be built, or has no proof, stays as it is
        return content


# ------------------------------------------------------------------------------------------------- what is said


def outcome(check: Callable[[], Verified], true: Callable[[Verified], bool]) -> str:
    """Return "refused", "true", "false" or "crashed"."""
    try:
        found = check()
    except SafeOmplError as error:
        return "crashed" if "\n" in str(error) or not str(error) else "refused"
    except Exception:
        return "crashed"
    return "true" if true(found) else "false"


def judged(case: Case, content: Any) -> dict[str, str]:
    """Return what comes of a certificate, given all and given nothing."""

    def of_carried(found: Verified) -> bool:
        return Judge(*carried(content)).true(found.claims, content, ("robot", "scene"))

    return {
        "given": outcome(
            lambda: verify(content, case.robot, case.scene, terms=case.terms),
            lambda found: case.judge().true(found.claims, content, ()),
        ),
        "carried": outcome(lambda: verify(content), of_carried),
    }


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options."""
    parser.add_argument("--number", type=int, default=10_000)
    parser.add_argument("--seed", type=int, default=0)


def main(options: argparse.Namespace, report: Report) -> int:
    """Mutate, verify, judge, and report."""
    found: Counter[tuple[str, str, str]] = Counter()
    for case in cases():
        assert judged(case, case.content) == {"given": "true", "carried": "true"}, case.name
    for k in range(options.number):
        case = cases()[k % len(cases())]
        for mode, result in judged(case, mutation(case, options.seed, k)).items():
            found[case.name, mode, result] += 1
            if result in ("false", "crashed"):
                print(k, case.name, mode, result, flush=True)
    kinds, modes = ("refused", "true", "false", "crashed"), ("given", "carried")
    names = [case.name for case in cases()]
    rows = [(name, mode, *(found[name, mode, kind] for kind in kinds)) for name in names for mode in modes]
    for mode in modes:
        rows.append(("all", mode, *(sum(found[name, mode, kind] for name in names) for kind in kinds)))
    report.table(("certificate", "verified", *kinds), rows)
    wrong = sum(number for (_, _, kind), number in found.items() if kind in ("false", "crashed"))
    report.counted("mutated certificates, each verified in two ways", found.total() // 2, wrong)
    return int(wrong > 0)
