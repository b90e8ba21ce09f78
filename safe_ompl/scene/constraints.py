"""What every path of a scenario must keep to: limits, motion, and the people who may come near it; plain data."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from math import inf, pi
from typing import Any, NamedTuple, TypeAlias

from safe_ompl.common import RATE_BOUNDS, InputError, Section, documents as document, key
from safe_ompl.geometry import LIMBS, Person
from safe_ompl.scene.scene import Scene

Configuration: TypeAlias = tuple[float, ...] | Mapping[str, float] | str
"""Joint values in the robot's order, or by the names of the joints [rad or m]; or the name of a state in its SRDF."""
ByJoint: TypeAlias = float | Mapping[str, float] | tuple[float, ...]
_UP = (0.0, 0.0, 1.0)


def read_configuration(key: str, value: Any) -> Configuration:
    """Return finite numbers from a list, or from a mapping of joint names to values; or the name of a state."""
    if isinstance(value, str):
        return document.line(key, value)
    return document.by_name(key, value, document.number) if isinstance(value, Mapping) else document.numbers(key, value)


def _direction(key: str, value: Any) -> tuple[float, ...]:
    numbers = document.numbers(key, value, 3)
    if not any(numbers):
        raise InputError("must be a vector that is not zero", key)
    return numbers


def pairs_of_names(key: str, value: Any) -> tuple[tuple[str, str], ...]:
    """Return pairs of a link and an obstacle, by name."""
    pairs = []
    for pair in document.sequence(key, value):
        names = document.sequence(key, pair)
        if len(names) != 2:
            raise InputError(f"must be pairs of a link and an obstacle, not {pair!r}", key)
        pairs.append((document.text(key, names[0]), document.text(key, names[1])))
    return tuple(pairs)


def _by_joint(key: str, value: Any, **bounds: Any) -> ByJoint:
    if isinstance(value, Mapping):
        return document.by_name(key, value, document.number, **bounds)
    if isinstance(value, (list, tuple)):
        return document.each(key, value, document.number, **bounds)
    return document.number(key, value, **bounds)


@dataclass(frozen=True)
class ToolConstraint(Section):
    """An axis of the tool that stays within an angle of a direction in the world, by default up."""

    angle: float = key(document.number, above=0.0, at_most=pi)  # The largest [rad]
    # In the frame of the tip; default: the one that points in the direction at the start
    axis: tuple[float, ...] | None = key(_direction, default=None)
    direction: tuple[float, ...] = key(_direction, default=_UP)


@dataclass(frozen=True)
class TipBox(Section):
    """Bounds of the tip's position in the world, least and largest coordinate [m]; what is not given is not bounded."""

    x: tuple[float, ...] | None = key(document.interval, default=None)
    y: tuple[float, ...] | None = key(document.interval, default=None)
    z: tuple[float, ...] | None = key(document.interval, default=None)

    def check(self) -> None:
        if self.x is self.y is self.z is None:
            raise InputError("missing: give bounds of x, y or z", "x")

    @property
    def corners(self) -> tuple[tuple[float, ...], tuple[float, ...]]:
        """The lower and the upper corner [m], infinite where there is no bound."""
        bounds = [given or (-inf, inf) for given in (self.x, self.y, self.z)]
        return tuple(low for low, _ in bounds), tuple(high for _, high in bounds)


@dataclass(frozen=True)
class MovingObstacles(Section):
    """Obstacles that may move in any direction, each no faster than its speed."""

    speeds: Mapping[str, float] = key(
        document.by_name, read=document.number, at_least=0.0, least="obstacle"
    )  # Bounds [m/s]
    # From the moment of the scene to the end of the last motion [s].
    time: float = key(document.number, above=0.0)


@dataclass(frozen=True)
class PathLimits(Section):
    """Hard limits of paths, proven along whole motions."""

    # The largest danger of any configuration; 0 does not limit the danger.
    max_danger: float = key(document.number, default=0.0, at_least=0.0)
    # The distance that the robot keeps from `obstacles` [m], by default from those with a danger weight. 0 excludes
    # contact only. Pairs of a link and an obstacle may be `exempt`.
    min_clearance: float = key(document.number, default=0.0, at_least=0.0)
    obstacles: tuple[str, ...] | None = key(document.each, default=None, read=document.text)
    exempt: tuple[tuple[str, str], ...] = key(pairs_of_names, default=())
    tool: ToolConstraint | None = key(document.section, default=None, kind=ToolConstraint)
    tip: TipBox | None = key(document.section, default=None, kind=TipBox)
    # Obstacles that may move during the motion. The path is proven free for every such movement.
    moving: MovingObstacles | None = key(document.section, default=None, kind=MovingObstacles)
    # The largest tracking error of each joint: one for all joints, or one each [rad or m].
    tube: ByJoint | None = key(_by_joint, default=None, at_least=0.0)


@dataclass(frozen=True)
class MotionLimits(Section):
    """Limits of trajectories."""

    # Of the joints: one for all, those of some, or all [rad/s, rad/s², rad/s³; m where they slide]; defaults as in
    # `RateLimits.of`
    velocity: ByJoint | None = key(_by_joint, default=None, **RATE_BOUNDS["velocity"])
    acceleration: ByJoint | None = key(_by_joint, default=None, **RATE_BOUNDS["acceleration"])
    jerk: ByJoint | None = key(_by_joint, default=None, **RATE_BOUNDS["jerk"])
    tool_speed: float | None = key(document.number, default=None, **RATE_BOUNDS["speed"])  # Of the tip [m/s]
    # The largest speed of any point of any link [m/s].
    link_speed: float | None = key(document.number, default=None, **RATE_BOUNDS["speed"])
    # Of the kinetostatic danger, that grows with speed: k2 and gamma are options of the scenario's danger
    max_danger: float | None = key(document.number, default=None, above=0.0)


_OF_LIMB = {
    "neck": "head",
    "torso": "chest",
    "hips": "pelvis",
    "shoulders": "shoulder",
    "flank": "abdomen",
    "shank": "lower_leg",
    "foot": "lower_leg",
}
WALKING = 1.6  # [m/s]


class BodyRegion(NamedTuple):
    """Contact limits of a region of the body: largest force of a transient contact [N], 0: none; effective mass [kg].

    Its stiffness is in N/mm.
    """

    force: float
    mass: float
    stiffness: float


# Values that are quoted publicly of ISO/TS 15066:2016, annex A, from secondary sources: circulating tables differ, and
# the user must check them. Pressure may allow less than force, clamping halves it. Using them is not compliance.
CONTACT_SOURCE = "secondary sources of ISO/TS 15066:2016, to be checked; no compliance"
CONTACT_TABLE: dict[str, BodyRegion] = {
    "head": BodyRegion(0, 4.4, 150),
    "chest": BodyRegion(280, 40, 25),
    "abdomen": BodyRegion(220, 40, 10),
    "pelvis": BodyRegion(360, 40, 25),
    "shoulder": BodyRegion(420, 40, 35),
    "upper_arm": BodyRegion(300, 3, 30),
    "forearm": BodyRegion(320, 2, 40),
    "hand": BodyRegion(280, 0.6, 75),
    "thigh": BodyRegion(440, 75, 50),
    "lower_leg": BodyRegion(260, 75, 60),
}


def _region(key: str, value: Any) -> BodyRegion:
    force, mass, stiffness = document.numbers(key, value, 3)
    document.number(f"{key}[0]", force, at_least=0.0)
    document.number(f"{key}[1]", mass, above=0.0)
    document.number(f"{key}[2]", stiffness, above=0.0)
    return BodyRegion(force, mass, stiffness)


@dataclass(frozen=True)
class People(Section):
    """People beside a robot, and the assumptions about them that trajectories rest on.

    What is proven holds *if* no limb moves faster than its speed.

    Parameters
    ----------
    who : sequence of str, optional
        Obstacles that are treated as people; default: those whose shape is a person.
    speed : float
        Bound on the speed of every limb [m/s].
    speeds : mapping of str to float, optional
        Other bounds for single limbs, such as ``right_hand`` [m/s].
    reaction_time : float
        Time from the measurement of a person until the robot begins to brake [s].
    clearance : float
        Distance that must be left when the robot stands still [m]: intrusion distance and uncertainties, C + Z_d + Z_r.
    contact : bool
        Whether the robot may touch people at speeds at which contact stays below the limits of the body region. That is
        its own speed; the person's is not counted. Where a limb may be clamped half of the force counts.
    regions : mapping of str to 3 float, optional
        Regions whose force [N], mass [kg] and stiffness [N/mm] replace those of `CONTACT_TABLE`.

    Raises
    ------
    InputError
        If a value cannot be used; the message starts with its key.

    Examples
    --------
    >>> People(speed=1.6, reaction_time=0.1, speeds={"right_hand": 2.0}).speed
    1.6
    """

    who: tuple[str, ...] | None = key(document.each, default=None, read=document.text, least="obstacle")
    speed: float = key(document.number, default=WALKING, at_least=0.0)
    speeds: Mapping[str, float] = key(document.by_name, read=document.number, factory=dict, known=LIMBS, at_least=0.0)
    reaction_time: float = key(document.number, default=0.1, at_least=0.0)
    clearance: float = key(document.number, default=0.0, at_least=0.0)
    contact: bool = key(document.flag, default=False)
    regions: Mapping[str, BodyRegion] = key(document.by_name, factory=dict, read=_region, known=CONTACT_TABLE)

    def names(self, scene: Scene) -> tuple[str, ...]:
        """Return the names of the obstacles that are treated as people.

        Raises InputError if the scene has no person, and none is named; or has no obstacle of such a name.
        """
        if self.who is not None:
            return tuple(scene[name].name for name in self.who)
        found = tuple(o.name for o in scene if isinstance(o.shape, Person))
        if not found:
            raise InputError(
                "the scene has no person; name the obstacles that are treated as people, or give no people", "people"
            )
        return found

    @property
    def contact_sentence(self) -> str:
        """What is assumed of contact, with the source of the figures; empty where it is not allowed."""
        if not self.contact:
            return ""
        sources = ["yours"] if self.regions else []
        if len(self.regions) < len(CONTACT_TABLE):
            sources.append(CONTACT_SOURCE)
        own = "speeds of contact are the robot's own, as if it were infinitely heavy, the person's is not counted"
        return f"{own}; figures: {'; '.join(sources)}"

    def speed_of(self, limb: str) -> float:
        """Return the bound on the speed of a limb [m/s]."""
        return self.speeds.get(limb, self.speed)

    def region_of(self, limb: str) -> BodyRegion:
        """Return the contact limits of a limb; those of the head for what is no limb."""
        name = limb.removeprefix("left_").removeprefix("right_") if limb in LIMBS else "head"
        name = _OF_LIMB.get(name, name)
        return self.regions.get(name, CONTACT_TABLE[name])
