"""How a robot is built: from a URDF or from models, on a base, with others, with something in its hand.

A blueprint is plain data that travels between processes; `assemble` builds the parts of the robot from it. Those that
change a robot hold the blueprint of the robot that they change.
"""

from __future__ import annotations

import logging
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pinocchio as pin

from safe_ompl import document
from safe_ompl.arrays import FloatArray
from safe_ompl.errors import InputError, UnknownNameError
from safe_ompl.robot.attachment import Attachment
from safe_ompl.robot.convex import make_convex, sample_configurations, select_self_pairs
from safe_ompl.robot.coupling import Mimic, resolved
from safe_ompl.robot.parts import BASE_JOINTS, RobotParts, combined, independent
from safe_ompl.robot.reduction import (
    apply_mimic_limits,
    check_joints,
    farthest_body,
    joint_limits,
    joints_to_hold,
    override_limits,
    reduce_model,
)
from safe_ompl.robot.urdf import UrdfFile
from safe_ompl.scene.pose import Pose

_log = logging.getLogger(__name__)

Limits = Mapping[str, tuple[float, float]]


class Blueprint(ABC):
    """How to build a robot."""

    @abstractmethod
    def assemble(self) -> RobotParts:
        """Build the parts of the robot."""

    @abstractmethod
    def with_limits(self, limits: Limits) -> Blueprint:
        """Return the blueprint of the same robot with other limits [rad or m] for the joints named."""

    def attached(self) -> tuple[Attachment, ...]:
        """Return the objects that the robot holds, the last one last."""
        return ()

    def without(self, name: str) -> Blueprint:
        """Return the blueprint of the same robot without an object; raise UnknownNameError if it holds none."""
        raise UnknownNameError("attached object", name, ())


@dataclass(frozen=True)
class UrdfBlueprint(Blueprint):
    """A robot from its URDF; see `Robot.from_urdf`."""

    urdf: str
    srdf: str | None
    package_dirs: tuple[str, ...]
    tip: str | None
    locked: Mapping[str, float]
    hulls: bool
    name: str | None
    limits: Limits

    def assemble(self) -> RobotParts:
        """Read the files, lock joints, and build what remains."""
        file = UrdfFile(self.urdf, self.package_dirs)
        full = file.build_model()
        collision_model = file.build_geometry(full, pin.GeometryType.COLLISION)
        mimics = {name: mimic for name, mimic in file.mimics().items() if full.existJointName(name)}

        def read_visual() -> pin.GeometryModel | None:
            try:
                geometry = file.build_geometry(full, pin.GeometryType.VISUAL)
            except InputError as error:
                _log.warning("%s: drawing its collision bodies (%s)", file.path.name, error)
                return None
            return geometry if len(geometry.geometryObjects) else None

        source = _Source(full, collision_model, read_visual, mimics, str(file.path))
        name = self.name or full.name or file.path.stem
        return source.reduced(name, self.tip, self.locked, self.limits, self.hulls, self.srdf)

    def with_limits(self, limits: Limits) -> UrdfBlueprint:
        return replace(self, limits={**self.limits, **limits})


@dataclass(frozen=True)
class ModelsBlueprint(Blueprint):
    """A robot from models of Pinocchio's, which nobody else may change; see `Robot.from_models`."""

    model: pin.Model
    collision_model: pin.GeometryModel
    visual_model: pin.GeometryModel | None
    tip: str | None
    locked: Mapping[str, float]
    hulls: bool
    name: str
    limits: Limits
    mimics: Mapping[str, Mimic]

    def assemble(self) -> RobotParts:
        """Lock joints, and build what remains; pairs that the collision model has are those that are checked."""
        source = _Source(
            self.model.copy(),
            independent(self.collision_model),
            lambda: self.visual_model,
            self.mimics,
            self.name,
        )
        return source.reduced(self.name, self.tip, self.locked, self.limits, self.hulls, None)

    def with_limits(self, limits: Limits) -> ModelsBlueprint:
        return replace(self, limits={**self.limits, **limits})


@dataclass(frozen=True)
class _Source:
    """All joints of a robot and its geometry, before joints are locked."""

    full: pin.Model
    collision_model: pin.GeometryModel
    read_visual: Callable[[], pin.GeometryModel | None]
    mimics: Mapping[str, Mimic]
    source: str

    def reduced(
        self,
        name: str,
        tip: str | None,
        locked: Mapping[str, float],
        limits: Limits,
        hulls: bool,
        srdf: str | None,
    ) -> RobotParts:
        """Return the parts of the robot with its joints locked, bodies convex and self pairs chosen."""
        full, source, mimics = self.full, self.source, resolved(self.mimics, self.source)
        override_limits(full, limits, source)
        if tip is not None and not full.existFrame(tip):
            raise UnknownNameError("tip frame", tip, (frame.name for frame in list(full.frames)[1:]), source)
        held = joints_to_hold(full, mimics, tip, locked, source)
        model, collision_model = reduce_model(full, self.collision_model, held)
        check_joints(model, source)
        if hulls:
            make_convex(collision_model)
        mimics = {joint: mimic for joint, mimic in mimics.items() if model.existJointName(joint)}
        apply_mimic_limits(model, mimics, source)
        joint_limits(model, source)
        _drop_fixed_pairs(collision_model)
        if not len(collision_model.collisionPairs):
            select_self_pairs(model, collision_model, srdf, _samples(model, mimics), name)

        def visual() -> pin.GeometryModel | None:
            drawn = self.read_visual()
            return None if drawn is None else reduce_model(full, drawn, held)[1]

        ends = tuple(full.names)[1:]
        tips = (tip or farthest_body(model),)
        return RobotParts(name, source, model, collision_model, visual, ends, tips, mimics)


def _drop_fixed_pairs(geometry: pin.GeometryModel) -> None:
    """Drop the pairs of bodies that do not move against each other any more, as joints between them are locked."""
    joints = [part.parentJoint for part in geometry.geometryObjects]
    pairs = [pin.CollisionPair(pair.first, pair.second) for pair in geometry.collisionPairs]
    for pair in pairs:
        if joints[pair.first] == joints[pair.second]:
            geometry.removeCollisionPair(pair)


def _samples(model: pin.Model, mimics: Mapping[str, Mimic]) -> FloatArray:
    """Return configurations (S, nq) over the joint ranges at which mimic joints are where they belong."""
    rows = sample_configurations(model)
    for name, mimic in mimics.items():
        joint, first = (model.joints[model.getJointId(n)] for n in (name, mimic.primary))
        values = mimic.multiplier * rows[:, first.idx_q] + mimic.offset
        if joint.nq == 1:
            rows[:, joint.idx_q] = values
        else:
            rows[:, joint.idx_q], rows[:, joint.idx_q + 1] = np.cos(values), np.sin(values)
    return rows


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

    def with_limits(self, limits: Limits) -> Blueprint:
        """Pass the limits on."""
        return replace(self, of=self.of.with_limits(limits))

    def attached(self) -> tuple[Attachment, ...]:
        """Return those of the robot that is changed."""
        return self.of.attached()

    def without(self, name: str) -> Blueprint:
        """Take the object from the robot that is changed."""
        return replace(self, of=self.of.without(name))


@dataclass(frozen=True)
class Placed(_Change):
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

    def with_limits(self, limits: Limits) -> Blueprint:
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

    def attached(self) -> tuple[Attachment, ...]:
        """Return the objects of all robots, under the names that they have here."""
        return tuple(
            replace(item, name=f"{prefix}_{item.name}", link=f"{prefix}_{item.link}")
            for prefix, blueprint in self.robots.items()
            for item in blueprint.attached()
        )

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

    def with_limits(self, limits: Limits) -> Blueprint:
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
