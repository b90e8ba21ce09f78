"""Constraints of a scenario: limits of paths and trajectories, and assumptions about people."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from math import inf, pi
from typing import Any, NamedTuple, TypeAlias

from safe_ompl.common import RATE_BOUNDS, InputError, Section, documents as document, key
from safe_ompl.geometry import LIMBS, Person
from safe_ompl.scene.scene import Scene

Configuration: TypeAlias = tuple[float, ...] | Mapping[str, float] | str
"""Joint values [rad or m] in the robot's order or by joint name, or the name of a group state in the SRDF."""
ByJoint: TypeAlias = float | Mapping[str, float] | tuple[float, ...]
_UP = (0.0, 0.0, 1.0)


def read_configuration(key: str, value: Any) -> Configuration:
    """Read a configuration: a list of numbers, a mapping of joint names to numbers, or the name of a group state."""
    if isinstance(value, str):
        return document.line(key, value)
    return (
        document.mapping_of(key, value, document.number) if isinstance(value, Mapping) else document.numbers(key, value)
    )


def _direction(key: str, value: Any) -> tuple[float, ...]:
    numbers = document.numbers(key, value, 3)
    if not any(numbers):
        raise InputError("must be a vector that is not zero", key)
    return numbers


def pairs_of_names(key: str, value: Any) -> tuple[tuple[str, str], ...]:
    """Read a list of pairs, each with the names of a link and an obstacle."""
    pairs = []
    for pair in document.sequence(key, value):
        names = document.sequence(key, pair)
        if len(names) != 2:
            raise InputError(f"must be pairs of a link and an obstacle, not {pair!r}", key)
        pairs.append((document.text(key, names[0]), document.text(key, names[1])))
    return tuple(pairs)


def _by_joint(key: str, value: Any, **bounds: Any) -> ByJoint:
    if isinstance(value, Mapping):
        return document.mapping_of(key, value, document.number, **bounds)
    if isinstance(value, (list, tuple)):
        return document.list_of(key, value, document.number, **bounds)
    return document.number(key, value, **bounds)


@dataclass(frozen=True)
class ToolConstraint(Section):
    """A constraint that keeps an axis of the tool within an angle of a world direction, by default up."""

    angle: float = key(document.number, above=0.0, at_most=pi)  # maximal [rad]
    # The axis in the frame of the tip. Default: the axis that points in the direction at the start.
    axis: tuple[float, ...] | None = key(_direction, default=None)
    direction: tuple[float, ...] = key(_direction, default=_UP)


@dataclass(frozen=True)
class TipBox(Section):
    """Bounds (low, high) of the tip's position in the world [m]. Coordinates that are not given are free."""

    x: tuple[float, ...] | None = key(document.interval, default=None)
    y: tuple[float, ...] | None = key(document.interval, default=None)
    z: tuple[float, ...] | None = key(document.interval, default=None)

    def check(self) -> None:
        if self.x is self.y is self.z is None:
            raise InputError("missing: give bounds of x, y or z", "x")

    @property
    def corners(self) -> tuple[tuple[float, ...], tuple[float, ...]]:
        """The lower and the upper corner (3,) [m], infinite for free coordinates."""
        bounds = [given or (-inf, inf) for given in (self.x, self.y, self.z)]
        return tuple(low for low, _ in bounds), tuple(high for _, high in bounds)


@dataclass(frozen=True)
class MovingObstacles(Section):
    """Obstacles that may move in any direction, each at most at its speed."""

    # Bounds of the speeds [m/s], by obstacle.
    speeds: Mapping[str, float] = key(document.mapping_of, read=document.number, at_least=0.0, item_name="obstacle")
    # Time from the state of the scene to the end of the last motion [s].
    time: float = key(document.number, above=0.0)


@dataclass(frozen=True)
class PathLimits(Section):
    """Hard limits of paths, proven along whole motions."""

    # Limit of the danger of each configuration; 0 means no limit.
    max_danger: float = key(document.number, default=0.0, at_least=0.0)
    # Minimal distance [m] between the robot and `obstacles`, by default those with a danger weight. 0 only excludes
    # contact. Pairs of a link and an obstacle may be `exempt`.
    min_clearance: float = key(document.number, default=0.0, at_least=0.0)
    obstacles: tuple[str, ...] | None = key(document.list_of, default=None, read=document.text)
    exempt: tuple[tuple[str, str], ...] = key(pairs_of_names, default=())
    tool: ToolConstraint | None = key(document.section, default=None, kind=ToolConstraint)
    tip: TipBox | None = key(document.section, default=None, kind=TipBox)
    # Obstacles that may move during the motion. The path is proven free for every such movement.
    moving: MovingObstacles | None = key(document.section, default=None, kind=MovingObstacles)
    # Maximal tracking error of the joints: one value for all, or one value each [rad or m].
    tube: ByJoint | None = key(_by_joint, default=None, at_least=0.0)


@dataclass(frozen=True)
class MotionLimits(Section):
    """Limits of trajectories."""

    # Joint limits [rad/s, rad/s², rad/s³; m for prismatic joints]: one value for all joints, values for some joints by
    # name, or values for all. `RateLimits.of` describes the defaults.
    velocity: ByJoint | None = key(_by_joint, default=None, **RATE_BOUNDS["velocity"])
    acceleration: ByJoint | None = key(_by_joint, default=None, **RATE_BOUNDS["acceleration"])
    jerk: ByJoint | None = key(_by_joint, default=None, **RATE_BOUNDS["jerk"])
    tool_speed: float | None = key(document.number, default=None, **RATE_BOUNDS["speed"])  # tip [m/s]
    # Limit of the speed of every point of every link [m/s].
    link_speed: float | None = key(document.number, default=None, **RATE_BOUNDS["speed"])
    # Limit of the kinetostatic danger, which grows with speed. The `danger` of a scenario has its parameters k2, gamma.
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
    """Contact limits of a body region: force of a transient contact [N], effective mass [kg], stiffness [N/mm].

    A force of 0 forbids contact.
    """

    force: float
    mass: float
    stiffness: float


# These values of ISO/TS 15066:2016, annex A, are quoted from public secondary sources. Such tables differ, so the user
# must check the values. Pressure limits may be stricter than force limits, and clamping halves the force. Using this
# table is not compliance.
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
    """People near a robot, with the assumptions about them that trajectories use.

    Proofs hold *if* no limb moves faster than its speed.

    Parameters
    ----------
    who : sequence of str, optional
        Obstacles that are treated as people; default: all obstacles whose shape is a person.
    speed : float
        Bound on the speed of each limb [m/s].
    speeds : mapping of str to float, optional
        Other bounds for single limbs, such as ``right_hand`` [m/s].
    reaction_time : float
        Time from the measurement of a person until the robot begins to brake [s].
    clearance : float
        Remaining distance when the robot stands still [m]: intrusion distance and uncertainties, C + Z_d + Z_r.
    contact : bool
        Whether the robot may touch people at speeds that keep the contact below the limits of the body region. Only the
        speed of the robot counts, not that of the person. If a limb may be clamped, half of the force is allowed.
    regions : mapping of str to 3 float, optional
        Force [N], mass [kg] and stiffness [N/mm] of body regions, which replace those of `CONTACT_TABLE`.

    Raises
    ------
    InputError
        If a value cannot be used; the message starts with its key.

    Examples
    --------
    >>> People(speed=1.6, reaction_time=0.1, speeds={"right_hand": 2.0}).speed
    1.6
    """

    who: tuple[str, ...] | None = key(document.list_of, default=None, read=document.text, item_name="obstacle")
    speed: float = key(document.number, default=WALKING, at_least=0.0)
    speeds: Mapping[str, float] = key(
        document.mapping_of, read=document.number, factory=dict, known=LIMBS, at_least=0.0
    )
    reaction_time: float = key(document.number, default=0.1, at_least=0.0)
    clearance: float = key(document.number, default=0.0, at_least=0.0)
    contact: bool = key(document.flag, default=False)
    regions: Mapping[str, BodyRegion] = key(document.mapping_of, factory=dict, read=_region, known=CONTACT_TABLE)

    def names(self, scene: Scene) -> tuple[str, ...]:
        """Return the names of the obstacles that are treated as people.

        Raises InputError if `who` is not given and the scene has no person, or if an obstacle does not exist.
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
        """The assumptions about contact, with the source of the values; empty if contact is not allowed."""
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
        """Return the contact limits of a limb. An unknown limb gets the limits of the head."""
        name = limb.removeprefix("left_").removeprefix("right_") if limb in LIMBS else "head"
        name = _OF_LIMB.get(name, name)
        return self.regions.get(name, CONTACT_TABLE[name])
