"""What a certificate claims: each claim is an object that is read strictly, proven, and put into words.

The verifier proves these objects and prints their sentences. Nothing that it says comes from the file itself, so that
nothing can be said that was not proven. A number in a sentence is never rounded to the stronger side.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from decimal import ROUND_CEILING, ROUND_FLOOR, Context, Decimal
from math import degrees, pi
from typing import Any

import numpy as np

from safe_ompl.common import (
    RATE_BOUNDS,
    FloatArray,
    InputError,
    Section,
    UnknownNameError,
    documents as document,
    key,
    shown,
)
from safe_ompl.io import RobotDocument, SceneDocument, schema
from safe_ompl.robot import Robot
from safe_ompl.scene import Scene

_SHORTEST, _LONGEST = 0.1, 10.0  # vectors that say a direction
_UNBOUNDED = 1e300  # [m]
_MOST_POWERS = 16  # of a polynomial
_DIGITS = 6
PROGRAM_FORMAT, PROGRAM_VERSION = "safe-ompl program certificate", 2


def exact(value: float) -> str:
    """Return a number as it is."""
    short = f"{value:g}"
    return short if float(short) == value else repr(float(value))


def at_most(value: float) -> str:
    """Return a number in few digits, and none that is smaller."""
    return _rounded(value, ROUND_CEILING)


def at_least(value: float) -> str:
    """Return a number in few digits, and none that is larger."""
    return _rounded(value, ROUND_FLOOR)


def _rounded(value: float, way: str) -> str:
    near = Context(prec=_DIGITS, rounding=way).create_decimal(Decimal(repr(float(value))))
    return f"{float(near):g}"


@dataclass(frozen=True, kw_only=True)
class ClaimedClearance(Section):
    """The links keep a distance [m] from obstacles."""

    distance: float = key(document.number, at_least=0.0)
    obstacles: tuple[str, ...] = key(document.each, read=document.line, least="obstacle")

    def of(self, obstacle: str) -> float:
        """Return what links keep from an obstacle [m]."""
        return self.distance if obstacle in self.obstacles else 0.0

    @property
    def sentence(self) -> str:
        return f"at least {at_least(1e3 * self.distance)} mm from {', '.join(self.obstacles)}"


@dataclass(frozen=True, kw_only=True)
class ClaimedObstacles(Section):
    """The same holds while obstacles move no faster than their speeds [m/s], for a time [s]."""

    speeds: Mapping[str, float] = key(document.by_name, read=document.number, at_least=0.0, least="obstacle")
    time: float = key(document.number, at_least=0.0)

    def of(self, obstacle: str) -> float:
        """Return how far an obstacle may come [m]."""
        return self.speeds.get(obstacle, 0.0) * self.time

    @property
    def sentence(self) -> str:
        speeds = ", ".join(f"{name} {exact(speed)} m/s" for name, speed in self.speeds.items())
        return f"the same while obstacles move no faster than {speeds}, for {exact(self.time)} s"


def _direction(key: str, value: Any) -> FloatArray:
    vector = document.array(key, value)
    if vector.shape != (3,) or not _SHORTEST <= float(np.linalg.norm(vector)) <= _LONGEST:
        raise InputError(f"must be a direction of three numbers, got {vector.tolist()!r}", key)
    return vector


@dataclass(frozen=True, kw_only=True)
class ClaimedOrientation(Section):
    """An axis of the tip stays within an angle [rad] of a direction in the world."""

    axis: FloatArray = key(_direction)
    direction: FloatArray = key(_direction)
    angle: float = key(document.number, above=0.0, at_most=pi)

    @property
    def sentence(self) -> str:
        axis, direction = (", ".join(f"{x:.9g}" for x in vector) for vector in (self.axis, self.direction))
        return f"the tool's axis ({axis}) within {at_most(degrees(self.angle))}° of the direction ({direction})"


@dataclass(frozen=True, kw_only=True)
class ClaimedTool(Section):
    """Limits of the tool: an orientation, bounds of the tip's position [m] by axis, or both."""

    orientation: ClaimedOrientation | None = key(document.section, default=None, kind=ClaimedOrientation)
    position: Mapping[str, tuple[float, ...]] | None = key(
        document.by_name, default=None, read=document.numbers, count=2, known="xyz", least="axis"
    )

    def check(self) -> None:
        if self.orientation is None and self.position is None:
            raise InputError("must claim an orientation or a position", "orientation")

    @property
    def sentences(self) -> list[str]:
        said = [] if self.orientation is None else [self.orientation.sentence]
        if self.position is not None:
            said.append(f"the tip at {', '.join(_bounds(axis, *of) for axis, of in self.position.items())}")
        return said


def _bounds(axis: str, low: float, high: float) -> str:
    if max(-low, high) < _UNBOUNDED:
        return f"{axis} from {at_least(low)} to {at_most(high)} m"
    return f"{axis} of at least {at_least(low)} m" if high >= _UNBOUNDED else f"{axis} of at most {at_most(high)} m"


@dataclass(frozen=True, kw_only=True)
class ClaimedDanger(Section):
    """The danger of a path has a bound: of which kind it is, and how far the danger points are apart [m]."""

    bound: float = key(document.number, at_least=0.0)
    spacing: float = key(document.number, above=0.0)
    aggregate: str = key(document.one_of, known=("max", "mean", "softmax"))
    weighting: str = key(document.one_of, known=("unit", "length"))
    k1: float = key(document.number, above=0.0)
    sharpness: float = key(document.number, above=0.0)

    def sentence(self, *, moving: bool) -> str:
        where = " where the scene has them" if moving else ""
        return f"danger at most {at_most(self.bound)} ({self._kind('')}{where})"

    def _kind(self, more: str) -> str:
        sharp = f" of sharpness {exact(self.sharpness)}" if self.aggregate == "softmax" else ""
        kind = f"{self.aggregate}{sharp}, {self.weighting}, k1 {exact(self.k1)}{more}"
        return f"{kind}, points {exact(self.spacing)} m apart"


@dataclass(frozen=True, kw_only=True)
class ClaimedMovingDanger(ClaimedDanger):
    """The danger of a motion in time has a bound."""

    k2: float = key(document.number, at_least=0.0)
    gamma: float = key(document.number, at_least=0.0)

    def sentence(self, *, moving: bool = False) -> str:
        more = f", k2 {exact(self.k2)}, gamma {exact(self.gamma)}"
        return f"danger in motion at most {at_most(self.bound)} ({self._kind(more)})"


# ------------------------------------------------------------------------------------------------- motions in time


@dataclass(frozen=True, kw_only=True)
class ClaimedStops(Section):
    """At whatever instant a person begins to run, the robot stands before they are nearer than the clearance [m]."""

    who: tuple[str, ...] = key(document.each, read=document.line, least="obstacle")
    speed: float = key(document.number, at_least=0.0)
    speeds: Mapping[str, float] = key(document.by_name, read=document.number, at_least=0.0)
    reaction_time: float = key(document.number, at_least=0.0)
    clearance: float = key(document.number, at_least=0.0)
    brakes: FloatArray = key(document.array)

    def check_for(self, scene: Scene) -> None:
        """Raise InputError unless the scene has the people, and they have the limbs."""
        with document.within("stops"):
            _check_known("who", "obstacle", self.who, scene.names)
            parts = [part[len(name) + 1 :] for name in self.who for part, _, _ in scene[name].geometries()]
            _check_known("speeds", "limb", self.speeds, filter(None, parts))

    def speed_of(self, limb: str) -> float:
        """Return how fast a limb may move [m/s]."""
        return self.speeds.get(limb, self.speed)

    @property
    def sentence(self) -> str:
        speeds = "".join(f", {limb} {exact(speed)} m/s" for limb, speed in self.speeds.items())
        return (
            f"it stands before anyone of {', '.join(self.who)} who moves no faster than {exact(self.speed)} m/s"
            f"{speeds} comes nearer than {at_least(1e3 * self.clearance)} mm, if it brakes within "
            f"{exact(self.reaction_time)} s"
        )


RATES = {"velocity": "velocities", "acceleration": "accelerations", "jerk": "jerks"}


def _check_rates(claim: Any, robot: Robot) -> None:
    for name in RATES:
        limits = getattr(claim, name)
        least, most = RATE_BOUNDS[name].values()
        if limits is not None and not (
            limits.shape == (robot.n,) and (least <= limits).all() and (limits <= most).all()
        ):
            words = f"must be {robot.n} numbers in [{least:g}, {most:g}], got {shown(limits.tolist())}"
            raise InputError(words, name)


def _rates(claim: Any) -> str:
    limits = {said: getattr(claim, name) for name, said in RATES.items()}
    within = [f"{name} of ({', '.join(map(at_most, of))})" for name, of in limits.items() if of is not None]
    return f"the joints within {', '.join(within)} [rad or m, s]"


@dataclass(frozen=True, kw_only=True)
class Piece(Section):
    """A cubic in joint space: what it and its derivatives are where it begins, and its length."""

    start: FloatArray = key(document.array)
    slope: FloatArray = key(document.array)
    bend: FloatArray = key(document.array)
    swing: FloatArray = key(document.array)
    length: float = key(document.number, above=0.0)


@dataclass(frozen=True, kw_only=True)
class ClaimedTrajectory(Section):
    """The path in time: its curve, its time law or the plan that is averaged over a window, and its limits."""

    pieces: tuple[Piece, ...] = key(document.each, read=document.section, kind=Piece, least="piece")
    corners: tuple[int, ...] = key(document.each, read=document.whole_number, at_least=0)
    edges: FloatArray = key(document.array)
    squares: FloatArray = key(document.array)
    duration: float = key(document.number, above=0.0)
    velocity: FloatArray = key(document.array)
    acceleration: FloatArray = key(document.array)
    stops: ClaimedStops | None = key(document.section, default=None, kind=ClaimedStops)
    window: float | None = key(document.number, default=None, above=0.0)
    jerk: FloatArray | None = key(document.array, default=None)
    tool_speed: float | None = key(document.number, default=None, **RATE_BOUNDS["speed"])
    link_speed: float | None = key(document.number, default=None, **RATE_BOUNDS["speed"])
    danger: ClaimedMovingDanger | None = key(document.section, default=None, kind=ClaimedMovingDanger)

    def check_for(self, robot: Robot, scene: Scene) -> None:
        """Raise InputError unless the claims have a meaning for robot and scene."""
        with document.within("trajectory"):
            _check_rates(self, robot)
            for k, piece in enumerate(self.pieces):
                vectors = piece.start, piece.slope, piece.bend, piece.swing
                if not all(vector.shape == (robot.n,) for vector in vectors):
                    raise InputError(f"must have vectors of {robot.n} numbers", f"pieces[{k}]")
            if self.stops is not None:
                self.stops.check_for(scene)

    @property
    def sentences(self) -> list[str]:
        said = [f"driven in {self.duration:.3f} s, {_rates(self)}"]
        if self.tool_speed is not None:
            said.append(f"the tip is no faster than {at_most(self.tool_speed)} m/s")
        if self.link_speed is not None:
            said.append(f"no point of a link, nor the tip, is faster than {at_most(self.link_speed)} m/s")
        said += [] if self.stops is None else [self.stops.sentence]
        return said if self.danger is None else [*said, self.danger.sentence()]

    @property
    def not_claimed(self) -> list[str]:
        """What could be said of it, and is not."""
        names = {"stops": "stops", "jerk": "jerk", "tool_speed": "tool speed", "link_speed": "link speed"}
        names["danger"] = "danger in motion"
        return [said for name, said in names.items() if getattr(self, name) is None]


@dataclass(frozen=True, kw_only=True)
class ClaimedMotion(Section):
    """Polynomials one after another, q(t) = Σ_k c_k u^k with u from 0 to 1 on each, and what may lie about them."""

    times: FloatArray = key(document.array)
    coefficients: tuple[FloatArray, ...] = key(document.each, read=document.array, ndim=2, least="piece")
    timed: bool = key(document.flag)
    slack: FloatArray | None = key(document.array, default=None, ndim=2)
    rounding: FloatArray | None = key(document.array, default=None, ndim=2)
    velocity: FloatArray | None = key(document.array, default=None)
    acceleration: FloatArray | None = key(document.array, default=None)
    jerk: FloatArray | None = key(document.array, default=None)

    def check_for(self, robot: Robot) -> None:
        """Raise InputError unless it is a motion of the robot, and its claims have a meaning for it."""
        count, n = len(self.coefficients), robot.n
        with document.within("motion"):
            if len(self.times) != count + 1 or not (np.diff(self.times) > 0).all():
                raise InputError(f"must be {count + 1} numbers that increase", "times")
            for k, piece in enumerate(self.coefficients):
                if not (2 <= len(piece) <= _MOST_POWERS and piece.shape[1] == n):
                    words = f"must be 2 to {_MOST_POWERS} rows of {n} numbers, got shape {piece.shape}"
                    raise InputError(words, f"coefficients[{k}]")
            for name in ("slack", "rounding"):
                widths = getattr(self, name)
                if widths is not None and not (widths.shape == (count, n) and (widths >= 0).all()):
                    raise InputError(f"must be {count} rows of {n} numbers >= 0", name)
            _check_rates(self, robot)
            claimed = [getattr(self, name) is not None for name in RATES]
            if claimed != sorted(claimed, reverse=True):
                raise InputError("needs velocities, and a jerk accelerations besides", "acceleration")
            if claimed[0] and not (self.timed and self.slack is None):
                raise InputError("needs a motion in time, without slack", "velocity")

    @property
    def ends(self) -> tuple[FloatArray, FloatArray]:
        """Where it begins and ends (n,)."""
        return self.coefficients[0][0], self.coefficients[-1].sum(axis=0)

    @property
    def sentences(self) -> list[str]:
        count, lasts = len(self.coefficients), float(self.times[-1] - self.times[0])
        kind = "straight edges" if all(len(piece) == 2 for piece in self.coefficients) else "polynomials"
        said = [f"a motion of {count} {kind} in {lasts:.3f} s" if self.timed else f"a path of {count} {kind}"]
        if self.slack is not None:
            least = ", ".join(map(at_least, self.slack.min(axis=0)))
            said[0] += f", and whatever is within ({least}) [rad or m] of them"
        said += [] if self.velocity is None else [_rates(self)]
        return said

    @property
    def not_claimed(self) -> list[str]:
        """What could be said of it, and is not."""
        return [name for name in RATES if self.timed and getattr(self, name) is None]


@dataclass(frozen=True, kw_only=True)
class ClaimedStretch(Section):
    """What is claimed of one motion."""

    motion: ClaimedMotion = key(document.section, kind=ClaimedMotion)
    clearance: ClaimedClearance | None = key(document.section, default=None, kind=ClaimedClearance)
    danger: ClaimedDanger | None = key(document.section, default=None, kind=ClaimedDanger)
    moving_obstacles: ClaimedObstacles | None = key(document.section, default=None, kind=ClaimedObstacles)
    tool: ClaimedTool | None = key(document.section, default=None, kind=ClaimedTool)
    trajectory: ClaimedTrajectory | None = key(document.section, default=None, kind=ClaimedTrajectory)
    margin: float | None = key(document.number, default=None, above=0.0)
    tube: FloatArray | None = key(document.array, default=None)

    def check_for(self, robot: Robot, scene: Scene) -> None:
        """Raise InputError, naming key and value, unless the claims have a meaning for robot and scene."""
        if self.clearance is not None:
            _check_known("clearance.obstacles", "obstacle", self.clearance.obstacles, scene.names)
        if self.moving_obstacles is not None:
            _check_known("moving_obstacles.speeds", "obstacle", self.moving_obstacles.speeds, scene.names)
        touched = {obstacle.name for obstacle in scene if obstacle.touched_by}
        near = {"clearance.obstacles": () if self.clearance is None else self.clearance.obstacles}
        near |= {} if self.margin is None else {"margin": scene.names}
        for place, name in ((place, name) for place, names in near.items() for name in touched & {*names}):
            raise InputError(f"{name!r} may be touched: nothing keeps a distance from it", place)
        self.motion.check_for(robot)
        if self.tube is not None and not (self.tube.shape == (robot.n,) and (self.tube >= 0).all()):
            raise InputError(f"must be {robot.n} numbers >= 0, got {self.tube.tolist()}", "tube")
        if self.trajectory is not None:
            self.trajectory.check_for(robot, scene)
            if self.tube is not None:
                raise InputError("is claimed of paths and polynomials, and not of a trajectory", "tube")
            if self.motion.timed:
                raise InputError("must not be in time where a trajectory is", "motion")

    def required(self, obstacle: str) -> float:
        """Return what moving links must keep from where the scene has an obstacle [m]."""
        clear = 0.0 if self.clearance is None else self.clearance.of(obstacle)
        moves = 0.0 if self.moving_obstacles is None else self.moving_obstacles.of(obstacle)
        return max(clear, self.margin or 0.0) + moves

    def sentences(self, about: str) -> tuple[str, ...]:
        """Return what is claimed, in words, of which each is complete in itself; first what the motions are free of."""
        moving = self.moving_obstacles
        said = [f"every motion is free{about}"]
        said += [] if self.danger is None else [self.danger.sentence(moving=moving is not None)]
        said += [] if self.clearance is None else [self.clearance.sentence]
        if self.margin is not None:
            said.append(f"no moving link nearer than {at_least(1e3 * self.margin)} mm to any obstacle")
        said += [] if moving is None else [moving.sentence]
        said += [] if self.tool is None else self.tool.sentences
        if self.tube is not None:
            said.append(f"the same with joints off by up to ({', '.join(map(at_least, self.tube))}) [rad or m]")
        said += self.motion.sentences
        return (*said, *([] if self.trajectory is None else self.trajectory.sentences))

    @property
    def not_claimed(self) -> tuple[str, ...]:
        """What could be claimed, but is not; of time only where the path is timed."""
        names = ("clearance", "danger", "moving_obstacles", "tool", "tube")
        missing = [name.replace("_", " ") for name in names if getattr(self, name) is None]
        return (*missing, *self.motion.not_claimed, *([] if self.trajectory is None else self.trajectory.not_claimed))


@dataclass(frozen=True, kw_only=True)
class Certificate(ClaimedStretch):
    """All that the certificate of one motion says."""

    format: str = key(document.one_of, known=[schema.FORMAT])
    version: int = key(document.one_of, known=[schema.VERSION])
    # What the file says it was made from. The verifier neither reads nor prints it.
    source: Any = key(document.plain)
    robot: RobotDocument = key(document.section, kind=RobotDocument)
    scene: SceneDocument = key(document.section, kind=SceneDocument)
    joint_names: tuple[str, ...] = key(document.each, read=document.line)
    also_sampled: str | None = key(document.line, default=None)
    digest: str = key(document.sha)

    @classmethod
    def read(cls, content: Any) -> Certificate:
        """Read a certificate from plain data; raise InputError, naming the key, if anything in it has no place."""
        schema.check_form(content)
        found: Certificate = document.section("certificate", content, cls)
        return found


# ------------------------------------------------------------------------------------------------------- programs


@dataclass(frozen=True, kw_only=True)
class ClaimedContact(Section):
    """Links, or objects that are held, may touch an obstacle, or an object that is held, to a depth [m]."""

    links: tuple[str, ...] = key(document.each, read=document.line, least="link")
    object: str = key(document.line)
    depth: float = key(document.number, above=0.0)


@dataclass(frozen=True, kw_only=True)
class StretchClaims(ClaimedStretch):
    """One stretch of a program: what changes hands before it, what may touch on it, its motion, what is claimed."""

    # The step in words. The verifier neither reads nor prints it.
    step: str = key(document.line, default="")
    # The objects that are put down before the stretch.
    detach: tuple[str, ...] = key(document.each, default=(), read=document.line)
    # The objects that are taken before the stretch, with the tip that takes each.
    attach: Mapping[str, str] = key(document.by_name, factory=dict, read=document.line)
    contacts: tuple[ClaimedContact, ...] = key(document.each, default=(), read=document.section, kind=ClaimedContact)


@dataclass(frozen=True, kw_only=True)
class ProgramCertificate(Section):
    """All that the certificate of a program says: the robot and the scene that it begins with, and its stretches."""

    format: str = key(document.one_of, known=[PROGRAM_FORMAT])
    version: int = key(document.one_of, known=[PROGRAM_VERSION])
    source: Any = key(document.plain)
    robot: RobotDocument = key(document.section, kind=RobotDocument)
    scene: SceneDocument = key(document.section, kind=SceneDocument)
    joint_names: tuple[str, ...] = key(document.each, read=document.line)
    stretches: tuple[StretchClaims, ...] = key(
        document.each, read=document.section, kind=StretchClaims, least="stretch"
    )
    digest: str = key(document.sha)

    @classmethod
    def read(cls, content: Any) -> ProgramCertificate:
        """Read a certificate from plain data; raise InputError, naming the key, if anything in it has no place."""
        schema.check_form(content, PROGRAM_FORMAT, PROGRAM_VERSION)
        found: ProgramCertificate = document.section("certificate", content, cls)
        return found


def _check_known(place: str, kind: str, names: Iterable[str], known: Iterable[str]) -> None:
    known = tuple(known)
    for name in names:
        if name not in known:
            raise UnknownNameError(kind, name, known, place)
