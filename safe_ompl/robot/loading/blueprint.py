"""Blueprints of robots: plain data that build them, and changes of them (a base, an object in the gripper, a cell).

A blueprint is plain data that travels between processes; `assemble` builds the parts of the robot from it.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, TypeAlias

import pinocchio as pin

from safe_ompl.common import InputError, UnknownNameError
from safe_ompl.common import documents as document
from safe_ompl.geometry import Pose
from safe_ompl.robot.loading.attachment import Attachment, as_pose
from safe_ompl.robot.loading.parts import BASE_JOINTS, RobotParts, combined

RangeByJoint: TypeAlias = Mapping[str, tuple[float, float]]
PoseLike: TypeAlias = Pose | pin.SE3 | Mapping[str, Any] | Sequence[float]
Ranges: TypeAlias = Sequence[Sequence[float]]


class Blueprint(ABC):
    """How to build a robot."""

    @abstractmethod
    def assemble(self) -> RobotParts:
        """Build the parts of the robot."""

    @abstractmethod
    def with_limits(self, limits: RangeByJoint) -> Blueprint:
        """Return the blueprint of the same robot with other limits [rad or m] for the joints named."""

    def state(self, name: str) -> dict[str, float]:
        """Return a named state of the robot's SRDF by joint [rad or m]; raise InputError if there is none."""
        raise InputError(f"no state {name!r}: states come with an SRDF")

    def attached(self) -> tuple[Attachment, ...]:
        """Return the objects that the robot holds, the last one last."""
        return ()

    def accelerations(self) -> dict[str, float]:
        """Return the acceleration limits that are known, by joint [rad/s² or m/s²]."""
        return {}

    def without(self, name: str) -> Blueprint:
        """Return the blueprint of the same robot without an object; raise UnknownNameError if it holds none."""
        raise UnknownNameError("attached object", name, ())


@dataclass(frozen=True)
class _Change(Blueprint):
    """A robot that is another one, changed."""

    of: Blueprint

    def assemble(self) -> RobotParts:
        """Build the robot that is changed, and change it."""
        return self.applied(self.of.assemble())

    @abstractmethod
    def applied(self, parts: RobotParts) -> RobotParts:
        """Return `parts`, changed."""

    def with_limits(self, limits: RangeByJoint) -> Blueprint:
        """Pass the limits on."""
        return replace(self, of=self.of.with_limits(limits))

    def state(self, name: str) -> dict[str, float]:
        """Return that of the robot that is changed."""
        return self.of.state(name)

    def attached(self) -> tuple[Attachment, ...]:
        """Return those of the robot that is changed."""
        return self.of.attached()

    def accelerations(self) -> dict[str, float]:
        """Return those of the robot that is changed."""
        return self.of.accelerations()

    def without(self, name: str) -> Blueprint:
        """Take the object from the robot that is changed."""
        return replace(self, of=self.of.without(name))


@dataclass(frozen=True)
class OnBase(_Change):
    """A robot whose base is at `pose` in the world."""

    pose: Pose

    def applied(self, parts: RobotParts) -> RobotParts:
        """Place it."""
        return parts.placed(self.pose.se3)


@dataclass(frozen=True)
class OnMobileBase(_Change):
    """A robot on a base that slides in x and y within `ranges` [m], and turns."""

    ranges: tuple[tuple[float, float], tuple[float, float]]

    def applied(self, parts: RobotParts) -> RobotParts:
        """Put it on the base."""
        return parts.on_mobile_base(self.ranges)

    def with_limits(self, limits: RangeByJoint) -> Blueprint:
        """Keep those of the base, pass the others on."""
        if BASE_JOINTS[2] in limits:
            raise InputError(f"joint {BASE_JOINTS[2]!r} is continuous: it has no limits")
        x, y = (limits.get(name, old) for name, old in zip(BASE_JOINTS, self.ranges, strict=False))
        rest = {name: limit for name, limit in limits.items() if name not in BASE_JOINTS}
        return OnMobileBase(self.of.with_limits(rest) if rest else self.of, mobile_ranges((x, y)))


@dataclass(frozen=True)
class Attached(_Change):
    """A robot that holds an object."""

    attachment: Attachment

    def applied(self, parts: RobotParts) -> RobotParts:
        """Put the object in its gripper."""
        return self.attachment.fixed_to(parts)

    def attached(self) -> tuple[Attachment, ...]:
        """Return this object after those before."""
        return (*self.of.attached(), self.attachment)

    def without(self, name: str) -> Blueprint:
        """Leave this object out, or one before it."""
        if name == self.attachment.name:
            return self.of
        known = [item.name for item in self.attached()]
        if name not in known:
            raise UnknownNameError("attached object", name, known)
        return super().without(name)


@dataclass(frozen=True)
class WithAccelerations(_Change):
    """A robot whose acceleration limits are known, by joint [rad/s² or m/s²]."""

    limits: Mapping[str, float]

    def applied(self, parts: RobotParts) -> RobotParts:
        """Change nothing: no model of Pinocchio's holds accelerations."""
        return parts

    def accelerations(self) -> dict[str, float]:
        """Return these, and the others that were known before."""
        return {**self.of.accelerations(), **self.limits}


@dataclass(frozen=True)
class Combined(Blueprint):
    """Several robots in one cell as one robot; see `Robot.combined`."""

    name: str
    robots: Mapping[str, Blueprint]
    tip: str

    def assemble(self) -> RobotParts:
        """Build all of them."""
        return self.joined({prefix: blueprint.assemble() for prefix, blueprint in self.robots.items()})

    def joined(self, parts: Mapping[str, RobotParts]) -> RobotParts:
        """Return the parts of the robots as those of one."""
        return combined(self.name, parts, self.tip)

    def state(self, name: str) -> dict[str, float]:
        """Return the states of that name of all robots that have one, under the names that joints have here."""
        found, refused = dict[str, float](), None
        for prefix, blueprint in self.robots.items():
            try:
                found |= {f"{prefix}_{joint}": value for joint, value in blueprint.state(name).items()}
            except InputError as error:
                refused = error
        if refused is not None and not found:
            raise refused
        return found

    def attached(self) -> tuple[Attachment, ...]:
        """Return the objects of all robots, under the names that they have here."""
        return tuple(
            replace(item, name=f"{prefix}_{item.name}", link=f"{prefix}_{item.link}")
            for prefix, blueprint in self.robots.items()
            for item in blueprint.attached()
        )

    def accelerations(self) -> dict[str, float]:
        """Return those of all robots, under the names that joints have here."""
        return {
            f"{prefix}_{joint}": limit
            for prefix, blueprint in self.robots.items()
            for joint, limit in blueprint.accelerations().items()
        }

    def without(self, name: str) -> Blueprint:
        """Take the object from the robot with the prefix of its name."""
        known = [item.name for item in self.attached()]
        if name not in known:
            raise UnknownNameError("attached object", name, known)
        robots = dict(self.robots)
        for prefix, blueprint in self.robots.items():
            if name.removeprefix(f"{prefix}_") in [item.name for item in blueprint.attached()]:
                robots[prefix] = blueprint.without(name.removeprefix(f"{prefix}_"))
        return replace(self, robots=robots)

    def with_limits(self, limits: RangeByJoint) -> Blueprint:
        """Give each robot the limits of the joints with its prefix."""
        robots, rest = dict(self.robots), dict(limits)
        for prefix, blueprint in self.robots.items():
            own = {name: rest.pop(name) for name in list(rest) if name.startswith(f"{prefix}_")}
            if own:
                robots[prefix] = blueprint.with_limits(
                    {name.removeprefix(f"{prefix}_"): limit for name, limit in own.items()}
                )
        if rest:
            raise UnknownNameError(
                "prefix of the joint with limits", next(iter(rest)), self.robots, self.name
            )
        return replace(self, robots=robots)


def mobile_ranges(value: Any) -> tuple[tuple[float, float], tuple[float, float]]:
    """Return the limits of a mobile base in x and y [m], checked.

    Raises
    ------
    InputError
        If they are not two intervals.
    """
    intervals = document.sequence("mobile_base", value)
    if len(intervals) != 2:
        raise InputError(
            f"must be the limits in x and in y, ((x0, x1), (y0, y1)), not {value!r}", "mobile_base"
        )
    found = []
    for interval in intervals:
        low, high = document.numbers("mobile_base", interval, 2)
        if not low < high:
            raise InputError(f"[{low:g}, {high:g}] is no interval [m]", "mobile_base")
        found.append((low, high))
    return found[0], found[1]


def check_prefixes(prefixes: Iterable[str]) -> None:
    """Raise InputError if a name that begins with one prefix may belong to another."""
    known = sorted(prefixes)
    for one in known:
        for other in known:
            if other.startswith(f"{one}_"):
                raise InputError(f"the prefixes {one!r} and {other!r} cannot be told apart in '{other}_…'")


def standing(blueprint: Blueprint, base: PoseLike | None, mobile_base: Ranges | None) -> Blueprint:
    """Return the blueprint of a robot on its base."""
    if mobile_base is not None:
        blueprint = OnMobileBase(blueprint, mobile_ranges(mobile_base))
    return blueprint if base is None else OnBase(blueprint, as_pose(base, "base"))
