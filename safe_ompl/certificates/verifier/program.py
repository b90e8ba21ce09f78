"""Verifies the certificate of a program: each stretch on its own, and that together they are one motion.

Each begins where, and when, the one before ends. Robots differ in what they hold alone. What is held in one stretch and
an obstacle in the next, or the other way round, is the same thing in the same place at that instant. Whatever links may
touch has a core in the scene that they must not touch.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from safe_ompl.certificates.verifier.verify import TIME, Terms, Verified, malformed_refused, verify
from safe_ompl.common import CertificateError, FloatArray, InputError, Section, clock, documents as document, key
from safe_ompl.geometry import Obstacle
from safe_ompl.io import built_robot, built_scene, schema
from safe_ompl.robot import Robot, robot_hash
from safe_ompl.scene import CORE, Scene

PROGRAM_FORMAT, VERSION = "safe-ompl program certificate", 1
_SAME = 1e-6  # [rad, m and s] that stretches, and things that change hands, may be apart
_CORE_ROUNDING = 1e-9  # [m]


@dataclass(frozen=True, kw_only=True)
class _Stretch(Section):
    begin: float = key(document.number, at_least=0.0)
    step: str = key(document.line, default="")
    certificate: Mapping[str, Any] = key(document.mapping)


@dataclass(frozen=True, kw_only=True)
class _Program(Section):
    format: str = key(document.one_of, known=[PROGRAM_FORMAT])
    version: int = key(document.one_of, known=[VERSION])
    robots: tuple[Mapping[str, Any], ...] = key(document.each, read=document.mapping, least="robot")
    scenes: tuple[Mapping[str, Any], ...] = key(document.each, read=document.mapping, least="scene")
    stretches: tuple[_Stretch, ...] = key(document.each, read=document.section, kind=_Stretch, least="stretch")
    digest: str = key(document.sha)


@dataclass(frozen=True)
class _Instant:
    """Where everything is at one end of a stretch, and when: joints, things by name, danger weights of obstacles."""

    time: float
    q: FloatArray
    things: Mapping[str, tuple[Any, pin.SE3]]
    weights: Mapping[str, float]

    @classmethod
    def of(cls, time: float, q: FloatArray, robot: Robot, obstacles: Sequence[Obstacle]) -> _Instant:
        model, data = robot.shared.model, robot.shared.model.createData()
        pin.framesForwardKinematics(model, data, robot.pinocchio_configuration(q))
        things = {item.name: (item.shape, item.pose.se3) for item in obstacles}
        for item in robot.attached:
            if item.name in things:
                raise CertificateError(f"{item.name!r} is held, and an obstacle, too")
            things[item.name] = item.shape, pin.SE3(data.oMf[model.getFrameId(item.link)]) * item.pose.se3
        return cls(time, q, things, {item.name: item.weight for item in obstacles})

    def check_same(self, other: _Instant) -> None:
        """Raise CertificateError unless everything is in the same place at the same time."""
        if abs(self.time - other.time) > _SAME:
            raise CertificateError(f"it begins at {self.time:.6f} s, but the one before ends at {other.time:.6f} s")
        apart = float(np.abs(self.q - other.q).max())
        if apart > _SAME:
            raise CertificateError(f"it begins {apart:.3g} rad or m from where the one before ends")
        for name in {*self.things} ^ {*other.things}:
            raise CertificateError(f"{name!r} is in one of this stretch and the one before, but not in the other")
        for name, (shape, pose) in self.things.items():
            its, there = other.things[name]
            if shape.kind != its.kind or shape.canonical() != its.canonical():
                raise CertificateError(f"{name!r} is another shape than in the stretch before")
            away = pin.log6(pose.inverse() * there).vector
            if not np.abs(away).max() <= _SAME:
                raise CertificateError(f"{name!r} is {1e3 * np.abs(away).max():.3g} mm or mrad from where it was")
        for name in {*self.weights} & {*other.weights}:
            if self.weights[name] != other.weights[name]:
                raise CertificateError(f"{name!r} is not as dangerous as in the stretch before")


def verify_program(
    content: Mapping[str, Any],
    robot: Robot | None = None,
    scene: Scene | None = None,
    *,
    terms: Terms | None = None,
    package_dirs: Sequence[Path] = (),
    time: float = TIME,
    joints_only: bool = False,
) -> Verified:
    """Check the certificate of a program: every stretch as `verify` does, and that they are one motion.

    Parameters
    ----------
    content : mapping
        The certificate.
    robot, scene : Robot, Scene, optional
        What it must begin with; default: what the file carries, and then it says nothing of any other.
    terms, package_dirs, time
        As for `verify`; the time is for all stretches together.
    joints_only : bool
        Look only at how stretches join, not at each on its own.

    Raises
    ------
    CertificateError
        If anything in it does not hold: names the stretch.
    InputError
        As `verify`.
    """
    end = clock() + document.number("time", time, above=0.0, kind="number of seconds")
    with malformed_refused():
        schema.check_form(content, PROGRAM_FORMAT, VERSION)
        program: _Program = document.section("certificate", content, _Program)
        _check_one_robot(program.robots)
        robots = [built_robot(carried, package_dirs=package_dirs) for carried in program.robots]
        scenes = [built_scene(carried) for carried in program.scenes]
        bare = [_without_contact(one) for one in scenes]
        found, last = list[Verified](), None
        for k, stretch in enumerate(program.stretches):
            with _naming(k):
                r, s = (
                    _number(stretch.certificate, name, len(of)) for name, of in (("robot", robots), ("scene", scenes))
                )
                if last is None:
                    _check_begin(stretch.begin, robots[r], Scene(bare[s], scenes[s].spacing), robot, scene)
                whole = {**stretch.certificate, "robot": program.robots[r], "scene": program.scenes[s]}
                if not joints_only:
                    left = max(end - clock(), 1e-3)
                    found.append(verify(whole, robots[r], scenes[s], terms=terms, time=left))
                times, pieces = whole["motion"]["times"], whole["motion"]["coefficients"]
                first = _Instant.of(stretch.begin, np.array(pieces[0][0], dtype=float), robots[r], bare[s])
                if last is not None:
                    first.check_same(last)
                over = stretch.begin + times[-1] - times[0]
                last = _Instant.of(over, np.sum(pieces[-1], axis=0), robots[r], bare[s])
        if program.digest != schema.digest(content):
            raise CertificateError("every claim holds, but the file is not as it was written: its digest differs")
        assert last is not None
        own = tuple(name for name, given in (("robot", robot), ("scene", scene)) if given is None)
        return _together(found, last.time, own, robots, scenes)


def _check_begin(begin: float, first: Robot, among: Scene, robot: Robot | None, scene: Scene | None) -> None:
    """Raise CertificateError unless the first stretch begins at 0, with the robot and the scene that are given."""
    if abs(begin) > _SAME:
        raise CertificateError(f"it begins at {begin:.6f} s, but must at 0")
    if robot is not None and robot_hash(robot) != robot_hash(first):
        raise CertificateError(f"the robot has changed: {robot.name!r} is not the one that it was written for")
    if scene is not None and among.content_hash() != scene.content_hash():
        raise CertificateError("the scene has changed since it was written")


def _together(
    found: list[Verified], duration: float, own: tuple[str, ...], robots: list[Robot], scenes: list[Scene]
) -> Verified:
    """Return what holds of all stretches."""
    about = f", for the {' and the '.join(own)} that the file itself carries" if own else ""
    first = f"every motion of {len(found)} stretches is free{about}"
    joined = f"they are one motion of {duration:.3f} s, in which all that is taken and put down stays in its place"
    touching = [
        f"contact of {' and '.join(item.touch_links)} with {item.name}"
        for robot in robots
        for item in robot.attached
        if item.touch_links
    ]
    common = [claim for claim in (found[0].claims[1:] if found else ()) if all(claim in one.claims for one in found)]
    return Verified(
        edges=sum(one.edges for one in found),
        intervals=sum(one.intervals for one in found),
        distances=sum(one.distances for one in found),
        claims=(first, joined, *common),
        not_claimed=tuple(dict.fromkeys(claim for one in found for claim in one.not_claimed)),
        not_covered=tuple(dict.fromkeys([*(claim for one in found for claim in one.not_covered), *touching])),
        robot=robots[0].name,
        obstacles=tuple(dict.fromkeys(name for scene in scenes for name in scene.names)),
        own=own,
    )


@contextmanager
def _naming(number: int) -> Iterator[None]:
    """Put the number of a stretch before every error."""
    try:
        with document.within(f"stretch {number}", ": "), malformed_refused():
            yield
    except CertificateError as error:
        raise CertificateError(f"stretch {number}: {error}") from None


def _number(said: Mapping[str, Any], name: str, count: int) -> int:
    """Return which robot or scene a stretch has."""
    number = document.whole_number(name, said.get(name), at_least=0)
    if number >= count:
        raise InputError(f"must be a number from 0 to {count - 1}, got {number}", name)
    return number


def _check_one_robot(carried: Sequence[Mapping[str, Any]]) -> None:
    """Raise CertificateError unless robots differ in what they hold alone."""
    for one, other in pairwise(carried):
        mine, its = (
            {name: value for name, value in (robot.get("recipe") or {}).items() if name not in ("attached", "files")}
            for robot in (one, other)
        )
        if mine != its or not mine:
            raise CertificateError("its robots differ in more than what they hold")


def _without_contact(scene: Scene) -> list[Obstacle]:
    """Return the obstacles as they are without contact; CertificateError if contact with one has no depth."""
    cores: set[str] = set()
    for obstacle in scene:
        if not obstacle.touched_by:
            continue
        own = [o for o in scene if o.name.startswith(f"{obstacle.name}, ") and o.name.endswith(CORE)]
        for core in own:
            depth = float(core.name[len(obstacle.name) + 2 : -len(CORE)]) / 1e3
            same = core.shape.kind == obstacle.shape.kind and core.pose == obstacle.pose and not core.touched_by
            wanted = vars(obstacle.shape.core(depth))
            # A relative tolerance would grow with the obstacle: on one of 50 m it hides half a millimetre.
            apart = [np.abs(np.subtract(vars(core.shape)[name], wanted[name])).max() for name in wanted] if same else []
            if not same or max(apart) > _CORE_ROUNDING:
                raise CertificateError(f"{core.name!r} is not what is so deep in {obstacle.name!r}")
        if not own:
            raise CertificateError(f"{' and '.join(obstacle.touched_by)} may touch {obstacle.name!r}, to any depth")
        cores |= {core.name for core in own}
    return [
        Obstacle(obstacle.name, obstacle.shape, obstacle.pose, obstacle.weight, obstacle.color)
        for obstacle in scene
        if obstacle.name not in cores
    ]
