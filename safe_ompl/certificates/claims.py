"""Claims of a certificate: each claim is an object that is read strictly, proven, and described by a sentence.

The verifier proves these objects and prints their sentences. The sentences contain no text of the file, so the verifier
cannot print a statement that was not proven. Numbers in sentences are never rounded to the stronger side.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from decimal import ROUND_CEILING, ROUND_FLOOR, Context, Decimal
from math import degrees, pi
from typing import Any

import numpy as np

from safe_ompl.common import (
    RATE_BOUNDS,
    CertificateError,
    FloatArray,
    InputError,
    Section,
    UnknownNameError,
    documents as document,
    files,
    key,
    shown,
)
from safe_ompl.io import RobotDocument, SceneDocument, schema
from safe_ompl.robot import Robot
from safe_ompl.scene import Scene

# Range of the length of direction vectors.
_LEAST_DIRECTION, _MOST_DIRECTION = 0.1, 10.0
_UNBOUNDED = 1e300  # [m]
_MOST_POWERS = 16  # of a polynomial
_DIGITS = 6


@contextmanager
def malformed_refused() -> Iterator[None]:
    """Turn every other error of a malformed certificate into CertificateError."""
    try:
        yield
    except files.MALFORMED as error:
        if isinstance(error, InputError):
            raise
        raise CertificateError(f"it is malformed: {type(error).__name__}: {error}") from None


def exact(value: float) -> str:
    """Return a number as text without rounding."""
    short = f"{value:g}"
    return short if float(short) == value else repr(float(value))


def at_most(value: float) -> str:
    """Return a number as text in few digits, rounded up."""
    return _rounded(value, ROUND_CEILING)


def at_least(value: float) -> str:
    """Return a number as text in few digits, rounded down."""
    return _rounded(value, ROUND_FLOOR)


def _rounded(value: float, way: str) -> str:
    near = Context(prec=_DIGITS, rounding=way).create_decimal(Decimal(repr(float(value))))
    return f"{float(near):g}"


@dataclass(frozen=True, kw_only=True)
class ClaimedClearance(Section):
    """Claim that links keep a distance [m] from obstacles."""

    distance: float = key(document.number, at_least=0.0)
    obstacles: tuple[str, ...] = key(document.list_of, read=document.line, item_name="obstacle")

    def of(self, obstacle: str) -> float:
        """Return the distance that links keep from an obstacle [m]."""
        return self.distance if obstacle in self.obstacles else 0.0

    @property
    def sentence(self) -> str:
        return f"at least {at_least(1e3 * self.distance)} mm from {', '.join(self.obstacles)}"


@dataclass(frozen=True, kw_only=True)
class ClaimedObstacles(Section):
    """Claim that the other claims hold for a time [s] while obstacles move no faster than their speeds [m/s]."""

    speeds: Mapping[str, float] = key(document.mapping_of, read=document.number, at_least=0.0, item_name="obstacle")
    time: float = key(document.number, at_least=0.0)

    def of(self, obstacle: str) -> float:
        """Return the largest distance that an obstacle may move [m]."""
        return self.speeds.get(obstacle, 0.0) * self.time

    @property
    def sentence(self) -> str:
        speeds = ", ".join(f"{name} {exact(speed)} m/s" for name, speed in self.speeds.items())
        return f"the same while obstacles move no faster than {speeds}, for {exact(self.time)} s"


def _direction(key: str, value: Any) -> FloatArray:
    vector = document.array(key, value)
    if vector.shape != (3,) or not _LEAST_DIRECTION <= float(np.linalg.norm(vector)) <= _MOST_DIRECTION:
        raise InputError(f"must be a direction of three numbers, got {vector.tolist()!r}", key)
    return vector


@dataclass(frozen=True, kw_only=True)
class ClaimedOrientation(Section):
    """Claim that an axis of the tip stays within an angle [rad] of a direction in the world."""

    axis: FloatArray = key(_direction)
    direction: FloatArray = key(_direction)
    angle: float = key(document.number, above=0.0, at_most=pi)

    @property
    def sentence(self) -> str:
        axis, direction = (", ".join(f"{x:.9g}" for x in vector) for vector in (self.axis, self.direction))
        return f"the tool's axis ({axis}) within {at_most(degrees(self.angle))}° of the direction ({direction})"


@dataclass(frozen=True, kw_only=True)
class ClaimedTool(Section):
    """Claim of limits of the tool: an orientation, bounds of the tip's position [m] by axis, or both."""

    orientation: ClaimedOrientation | None = key(document.section, default=None, kind=ClaimedOrientation)
    position: Mapping[str, tuple[float, ...]] | None = key(
        document.mapping_of, default=None, read=document.numbers, count=2, known="xyz", item_name="axis"
    )

    def check(self) -> None:
        if self.orientation is None and self.position is None:
            raise InputError("must claim an orientation or a position", "orientation")

    @property
    def sentences(self) -> list[str]:
        sentences = [] if self.orientation is None else [self.orientation.sentence]
        if self.position is not None:
            sentences.append(f"the tip at {', '.join(_bounds(axis, *of) for axis, of in self.position.items())}")
        return sentences


def _bounds(axis: str, low: float, high: float) -> str:
    if max(-low, high) < _UNBOUNDED:
        return f"{axis} from {at_least(low)} to {at_most(high)} m"
    return f"{axis} of at least {at_least(low)} m" if high >= _UNBOUNDED else f"{axis} of at most {at_most(high)} m"


@dataclass(frozen=True, kw_only=True)
class ClaimedDanger(Section):
    """Claim of a bound of the danger of a path, with the kind of danger and the spacing of danger points [m]."""

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
    """Claim of a bound of the danger of a timed motion."""

    k2: float = key(document.number, at_least=0.0)
    gamma: float = key(document.number, at_least=0.0)

    def sentence(self, *, moving: bool = False) -> str:
        more = f", k2 {exact(self.k2)}, gamma {exact(self.gamma)}"
        return f"danger in motion at most {at_most(self.bound)} ({self._kind(more)})"


# ------------------------------------------------------------------------------------------------- motions in time


@dataclass(frozen=True, kw_only=True)
class ClaimedStops(Section):
    """Claim that the robot always stops before people who begin to move come nearer than the clearance [m]."""

    who: tuple[str, ...] = key(document.list_of, read=document.line, item_name="obstacle")
    speed: float = key(document.number, at_least=0.0)
    speeds: Mapping[str, float] = key(document.mapping_of, read=document.number, at_least=0.0)
    reaction_time: float = key(document.number, at_least=0.0)
    clearance: float = key(document.number, at_least=0.0)
    brakes: FloatArray = key(document.array)

    def check_for(self, scene: Scene) -> None:
        """Raise InputError unless the scene has the people, and the people have the limbs."""
        with document.within("stops"):
            _check_known("who", "obstacle", self.who, scene.names)
            parts = [part[len(name) + 1 :] for name in self.who for part, _, _ in scene[name].geometries()]
            _check_known("speeds", "limb", self.speeds, filter(None, parts))

    def speed_of(self, limb: str) -> float:
        """Return the largest speed of a limb [m/s]."""
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
    limits = {word: getattr(claim, name) for name, word in RATES.items()}
    within = [f"{name} of ({', '.join(map(at_most, of))})" for name, of in limits.items() if of is not None]
    return f"the joints within {', '.join(within)} [rad or m, s]"


@dataclass(frozen=True, kw_only=True)
class ClaimedMotion(Section):
    """Consecutive polynomials q = Σ_k c_k u^k with u from 0 to 1, and the deviations from them.

    `times` are seconds of a timed motion, or the parameter of a path. `slack` and `rounding` bound the deviations.
    """

    times: FloatArray = key(document.array)
    coefficients: tuple[FloatArray, ...] = key(document.list_of, read=document.array, ndim=2, item_name="piece")
    timed: bool = key(document.flag)
    slack: FloatArray | None = key(document.array, default=None, ndim=2)
    rounding: FloatArray | None = key(document.array, default=None, ndim=2)
    velocity: FloatArray | None = key(document.array, default=None)
    acceleration: FloatArray | None = key(document.array, default=None)
    jerk: FloatArray | None = key(document.array, default=None)

    @property
    def rated(self) -> bool:
        """Whether the velocities are known at every instant."""
        return self.timed and self.slack is None

    def check_for(self, robot: Robot, scene: Scene) -> None:
        """Raise InputError unless the motion fits the robot, and its claims have a meaning for robot and scene."""
        count, n = len(self.coefficients), robot.n
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
        if claimed[0] and not self.rated:
            raise InputError("needs a timed motion without slack", "velocity")

    @property
    def lasts(self) -> float | None:
        """Duration [s]; None for a path."""
        return float(self.times[-1] - self.times[0]) if self.timed else None

    @property
    def sentences(self) -> list[str]:
        count = len(self.coefficients)
        kind = "straight edges" if all(len(piece) == 2 for piece in self.coefficients) else "polynomials"
        sentences = [
            f"a path of {count} {kind}" if self.lasts is None else f"a motion of {count} {kind} in {self.lasts:.3f} s"
        ]
        if self.slack is not None:
            least = ", ".join(map(at_least, self.slack.min(axis=0)))
            sentences[0] += f", and whatever is within ({least}) [rad or m] of them"
        sentences += [] if self.velocity is None else [_rates(self)]
        return sentences

    @property
    def not_claimed(self) -> list[str]:
        """Names of possible claims that are not made."""
        return [name for name in RATES if self.timed and getattr(self, name) is None]


@dataclass(frozen=True, kw_only=True)
class ClaimedTrajectory(ClaimedMotion):
    """A curve over its parameter s, and its time law.

    At the values `edges` of s, ṡ² is `squares`: of the law, or of the plan that is averaged over a `window` [s]. At
    `corners`, the indices of pieces that begin there, the robot stops.
    """

    corners: tuple[int, ...] = key(document.list_of, read=document.whole_number, at_least=0)
    edges: FloatArray = key(document.array)
    squares: FloatArray = key(document.array)
    duration: float = key(document.number, above=0.0)
    window: float | None = key(document.number, default=None, above=0.0)
    tool_speed: float | None = key(document.number, default=None, **RATE_BOUNDS["speed"])
    link_speed: float | None = key(document.number, default=None, **RATE_BOUNDS["speed"])
    stops: ClaimedStops | None = key(document.section, default=None, kind=ClaimedStops)
    danger: ClaimedMovingDanger | None = key(document.section, default=None, kind=ClaimedMovingDanger)

    @property
    def rated(self) -> bool:
        """Whether the velocities are known at every instant, which is always true because of the time law."""
        return True

    def check_for(self, robot: Robot, scene: Scene) -> None:
        """Raise InputError unless the motion fits the robot, and its claims have a meaning for robot and scene."""
        super().check_for(robot, scene)
        if self.timed:
            raise InputError("must be false: times are those of the time law", "timed")
        for name in ("slack", "rounding"):
            if getattr(self, name) is not None:
                raise InputError("must be left out if there is a time law", name)
        for name in ("velocity", "acceleration"):
            if getattr(self, name) is None:
                raise InputError("missing", name)
        if self.stops is not None:
            self.stops.check_for(scene)

    @property
    def lasts(self) -> float:
        """Duration [s]."""
        return self.duration

    @property
    def sentences(self) -> list[str]:
        sentences = [f"driven in {self.duration:.3f} s, {_rates(self)}"]
        if self.tool_speed is not None:
            sentences.append(f"the tip is no faster than {at_most(self.tool_speed)} m/s")
        if self.link_speed is not None:
            sentences.append(f"no point of a link, nor the tip, is faster than {at_most(self.link_speed)} m/s")
        sentences += [] if self.stops is None else [self.stops.sentence]
        return sentences if self.danger is None else [*sentences, self.danger.sentence()]

    @property
    def not_claimed(self) -> list[str]:
        """Names of possible claims that are not made."""
        names = {"stops": "stops", "jerk": "jerk", "tool_speed": "tool speed", "link_speed": "link speed"}
        names["danger"] = "danger in motion"
        return [word for name, word in names.items() if getattr(self, name) is None]


# ------------------------------------------------------------------------------------------------------- stretches


@dataclass(frozen=True, kw_only=True)
class ClaimedContact(Section):
    """Claim that links, or held objects, may touch an obstacle or a held object to a depth [m]."""

    links: tuple[str, ...] = key(document.list_of, read=document.line, item_name="link")
    object: str = key(document.line)
    depth: float = key(document.number, above=0.0)


@dataclass(frozen=True, kw_only=True)
class ClaimedStretch(Section):
    """One motion with its claims, the objects attached or detached before it, and the contacts allowed during it."""

    motion: ClaimedMotion = key(document.section, kind=ClaimedMotion)
    # Description of the stretch. The verifier neither reads nor prints it.
    step: str = key(document.line, default="")
    # Names of the objects that are detached before the stretch.
    detach: tuple[str, ...] = key(document.list_of, default=(), read=document.line)
    # Objects that are attached before the stretch, with the tip that takes each.
    attach: Mapping[str, str] = key(document.mapping_of, factory=dict, read=document.line)
    contacts: tuple[ClaimedContact, ...] = key(document.list_of, default=(), read=document.section, kind=ClaimedContact)
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
        with document.within("motion"):
            self.motion.check_for(robot, scene)
        if self.tube is not None and not (self.tube.shape == (robot.n,) and (self.tube >= 0).all()):
            raise InputError(f"must be {robot.n} numbers >= 0, got {self.tube.tolist()}", "tube")
        if self.trajectory is not None:
            with document.within("trajectory"):
                self.trajectory.check_for(robot, scene)
            if self.tube is not None:
                raise InputError("is claimed of paths and polynomials, and not of a trajectory", "tube")
            if self.motion.timed:
                raise InputError("must not be timed if a trajectory is given", "motion")

    def required(self, obstacle: str) -> float:
        """Return the distance that moving links must keep from the pose of an obstacle in the scene [m]."""
        clear = 0.0 if self.clearance is None else self.clearance.of(obstacle)
        moves = 0.0 if self.moving_obstacles is None else self.moving_obstacles.of(obstacle)
        return max(clear, self.margin or 0.0) + moves

    @property
    def lasts(self) -> float | None:
        """Duration [s]; None for a path."""
        return (self.trajectory or self.motion).lasts

    @property
    def sentences(self) -> list[str]:
        """Sentences of the claims besides that the motion is free. Each sentence is complete in itself."""
        moving = self.moving_obstacles
        sentences = [] if self.danger is None else [self.danger.sentence(moving=moving is not None)]
        sentences += [] if self.clearance is None else [self.clearance.sentence]
        if self.margin is not None:
            sentences.append(f"no moving link nearer than {at_least(1e3 * self.margin)} mm to any obstacle")
        sentences += [] if moving is None else [moving.sentence]
        sentences += [] if self.tool is None else self.tool.sentences
        if self.tube is not None:
            sentences.append(f"the same with joints off by up to ({', '.join(map(at_least, self.tube))}) [rad or m]")
        return [*sentences, *self.motion.sentences, *([] if self.trajectory is None else self.trajectory.sentences)]

    @property
    def not_claimed(self) -> list[str]:
        """Names of possible claims that are not made. Those about time are included only for timed motions."""
        names = ("clearance", "danger", "moving_obstacles", "tool", "tube")
        missing = [name.replace("_", " ") for name in names if getattr(self, name) is None]
        return [*missing, *self.motion.not_claimed, *([] if self.trajectory is None else self.trajectory.not_claimed)]


@dataclass(frozen=True, kw_only=True)
class Certificate(Section):
    """The content of a certificate: the robot and the scene at its beginning, and one stretch or more."""

    format: str = key(document.one_of, known=[schema.FORMAT])
    version: int = key(document.one_of, known=[schema.VERSION])
    # Origin of robot and scene, according to the file. The verifier neither reads nor prints it.
    source: Any = key(document.plain)
    robot: RobotDocument = key(document.section, kind=RobotDocument)
    scene: SceneDocument = key(document.section, kind=SceneDocument)
    joint_names: tuple[str, ...] = key(document.list_of, read=document.line)
    stretches: tuple[ClaimedStretch, ...] = key(
        document.list_of, read=document.section, kind=ClaimedStretch, item_name="stretch"
    )
    also_sampled: str | None = key(document.line, default=None)
    digest: str = key(document.sha)

    @classmethod
    def read(cls, content: Any) -> Certificate:
        """Read a certificate from plain data.

        Raises InputError, naming the key, if it has an unknown key or value; CertificateError if it is malformed.
        """
        schema.check_form(content)
        with malformed_refused():
            found: Certificate = document.section("certificate", content, cls)
        return found

    @property
    def rated(self) -> bool:
        """Whether limits of joint velocities are claimed."""
        return any((one.trajectory or one.motion).velocity is not None for one in self.stretches)

    def sentences(self, about: str) -> tuple[str, ...]:
        """Return the sentences of the claims. Of several stretches, only claims that hold for all are included.

        `about` is added to the first sentence, which says that the motions are free.
        """
        first, *others = (stretch.sentences for stretch in self.stretches)
        if not others:
            return (f"every motion is free{about}", *self._handling, *first)
        spans = [stretch.lasts for stretch in self.stretches if stretch.lasts is not None]
        whole = len(spans) == len(self.stretches)
        joined = "they are one motion" if spans else "they are one path"
        if whole:
            joined += f" of {sum(spans):.3f} s, without jumps of velocity"
        elif spans:
            joined += f", {len(self.stretches) - len(spans)} stretches of which are not in time"
        # Durations and numbers of pieces belong to single stretches.
        own = {one.sentences[0] for stretch in self.stretches for one in (stretch.motion, stretch.trajectory) if one}
        common = (claim for claim in first if claim not in own and all(claim in one for one in others))
        return (f"every motion of {len(self.stretches)} stretches is free{about}", joined, *self._handling, *common)

    @property
    def _handling(self) -> list[str]:
        """Sentences about held objects and allowed contacts, with the indices of their stretches."""
        holds: dict[tuple[str, str], list[int]] = {}
        touch: dict[tuple[tuple[str, ...], str, float], list[int]] = {}
        held: dict[str, str] = {}
        for k, stretch in enumerate(self.stretches):
            held = {name: link for name, link in held.items() if name not in stretch.detach} | dict(stretch.attach)
            for name, link in held.items():
                holds.setdefault((name, link), []).append(k)
            for contact in stretch.contacts:
                touch.setdefault((contact.links, contact.object, contact.depth), []).append(k)
        sentences = [f"{link} holds {name}, where it took it{self._on(k)}" for (name, link), k in holds.items()]
        for (links, name, depth), numbers in touch.items():
            deep = f"no deeper than {at_most(1e3 * depth)} mm"
            sentences.append(f"{' and '.join(links)} may touch {name}, {deep}{self._on(numbers)}")
        if touch:
            sentences.append("nothing else touches, but what is held and the links that do not move against its tip")
        return sentences

    def _on(self, numbers: Sequence[int]) -> str:
        """Return a text that lists ascending indices of stretches, with ranges for consecutive ones."""
        if len(self.stretches) == 1:
            return ""
        runs: list[list[int]] = []
        for k in numbers:
            if runs and runs[-1][-1] == k - 1:
                runs[-1].append(k)
            else:
                runs.append([k])
        named = (str(run[0]) if len(run) == 1 else f"{run[0]} to {run[-1]}" for run in runs)
        return f", in {'stretch' if len(numbers) == 1 else 'stretches'} {', '.join(named)}"

    @property
    def not_claimed(self) -> tuple[str, ...]:
        """Names of possible claims that at least one stretch does not make."""
        several = len(self.stretches) > 1
        missing = [[*one.not_claimed, *(RATES if several and one.lasts is None else ())] for one in self.stretches]
        return tuple(dict.fromkeys(name for names in missing for name in names))


def _check_known(place: str, kind: str, names: Iterable[str], known: Iterable[str]) -> None:
    known = tuple(known)
    for name in names:
        if name not in known:
            raise UnknownNameError(kind, name, known, place)
