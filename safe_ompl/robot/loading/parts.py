"""The parts of a robot: Pinocchio's models of it, placed on a base or joined in one cell."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
import pinocchio as pin

from safe_ompl.common import FloatArray, InputError, IntArray
from safe_ompl.robot.joint_tables import Mimic
from safe_ompl.robot.loading.collision import links_lacking_shapes, warn_of_unchecked
from safe_ompl.robot.loading.reduction import joint_limits
from safe_ompl.robot.reach import JointChain, bounding_box

if TYPE_CHECKING:
    from safe_ompl.robot.loading.blueprint import Attachment

_log = logging.getLogger(__name__)

BASE_JOINTS = ("base_x", "base_y", "base_yaw")
_SLIDES = (pin.JointModelPX, pin.JointModelPY)
_NO_LIMIT = np.full(1, np.inf)


@dataclass(frozen=True)
class RobotParts:
    """Models of the joints that are not locked, and what Pinocchio does not keep. Nobody changes them.

    `name` is for reports, and `source` for errors: the file that the robot comes from, or its name. The `model` has the
    planned joints and those that follow them (`mimics`), the `collision_model` bodies and the pairs of them that are
    checked; `read_visual` returns the visual geometry, or None. `link_ends` are joints, locked ones included, that are
    key points of the skeleton, and `tips` frames at the ends of arms, the robot's tip first. `held` has the joints that
    are held, with their values, and `accelerations` limits that are known, by joint [rad or m, /s²]; `bare_links` are
    links, moving or not, that lack collision shapes; `attached` is what the robot holds, the last one last.
    """

    name: str
    source: str
    model: pin.Model
    collision_model: pin.GeometryModel
    read_visual: Callable[[], pin.GeometryModel | None]
    link_ends: tuple[str, ...]
    tips: tuple[str, ...]
    mimics: Mapping[str, Mimic] = field(default_factory=dict)
    held: Mapping[str, float] = field(default_factory=dict)
    bare_links: tuple[str, ...] = ()
    attached: tuple[Attachment, ...] = ()
    accelerations: Mapping[str, float] = field(default_factory=dict)

    @cached_property
    def links_without_collision(self) -> tuple[str, ...]:
        """Moving links that lack collision shapes, see `links_lacking_shapes`."""
        moving = {frame.name for frame in self.model.frames if frame.parentJoint}
        return tuple(name for name in self.bare_links if name in moving)

    @cached_property
    def body_links(self) -> tuple[str, ...]:
        """The link of each of the G bodies of the collision model."""
        return tuple(body.name.rsplit("_", 1)[0] for body in self.collision_model.geometryObjects)

    @cached_property
    def body_pairs(self) -> IntArray:
        """The pairs (P, 2) of bodies that are checked against each other, by their indices."""
        pairs = [(pair.first, pair.second) for pair in self.collision_model.collisionPairs]
        return np.array(pairs, dtype=np.intp).reshape(-1, 2)

    @cached_property
    def body_boxes(self) -> FloatArray:
        """The boxes (G, 6) about the bodies, as `bounding_box` has them [m]."""
        boxes = [bounding_box(body.geometry) for body in self.collision_model.geometryObjects]
        return np.array(boxes, dtype=np.float64).reshape(-1, 6)

    @cached_property
    def chain(self) -> JointChain:
        """The joints as displacement bounds need them."""
        sliding = np.array(["P" in joint.shortname()[10:] for joint in list(self.model.joints)[1:]])
        return JointChain.from_model(self.model, sliding, *joint_limits(self.model, self.source))

    def lacking(self, full: pin.Model, collide: frozenset[str], drawn: frozenset[str]) -> RobotParts:
        """Return the robot with the names of links that lack shapes, and warn of them; as `links_lacking_shapes`."""
        parts = replace(self, bare_links=links_lacking_shapes(full, collide, drawn))
        warn_of_unchecked(self.name, parts.links_without_collision)
        return parts

    def placed(self, pose: pin.SE3) -> RobotParts:
        """Return the robot with its base at `pose` in the world."""
        return self._on(pin.Model(), 0, pose)

    def on_mobile_base(self, ranges: tuple[tuple[float, float], tuple[float, float]]) -> RobotParts:
        """Return the robot on a base that slides along the world's x and y within ranges [m], and turns about z."""
        taken = sorted(set(BASE_JOINTS) & set(self.model.names))
        if taken:
            raise InputError(f"it has a joint {taken[0]!r} already: is it on a mobile base?", self.source)
        model, parent = pin.Model(), 0
        for name, slide, limits in zip(BASE_JOINTS, _SLIDES, ranges, strict=False):
            low, high = (np.array([limit]) for limit in limits)
            parent = model.addJoint(parent, slide(), pin.SE3.Identity(), name, _NO_LIMIT, _NO_LIMIT, low, high)
            model.addJointFrame(parent)
        yaw = model.addJoint(parent, pin.JointModelRUBZ(), pin.SE3.Identity(), BASE_JOINTS[2])
        model.addJointFrame(yaw)
        standing = self._on(model, yaw, pin.SE3.Identity())
        parts = replace(standing, link_ends=(BASE_JOINTS[2], *self.link_ends))
        before = set(self.links_without_collision)
        warn_of_unchecked(self.name, [name for name in parts.links_without_collision if name not in before])
        return parts

    def _on(self, model: pin.Model, joint: int, pose: pin.SE3) -> RobotParts:
        """Return the robot with its base fixed to a joint of `model`, which it is appended to."""
        graft = Graft.of(model, self.model, joint, pose)
        model.name = self.model.name

        def visual() -> pin.GeometryModel | None:
            drawn = self.read_visual()
            return None if drawn is None else graft.geometry(drawn)

        bodies = graft.geometry(self.collision_model)
        return replace(self, model=model, collision_model=bodies, read_visual=visual)


def combined(name: str, robots: Mapping[str, RobotParts], tip: str) -> RobotParts:
    """Return several robots, by the prefixes that their joints, links and frames get, as one; `tip` is a prefix."""
    model = pin.Model()
    model.name = name
    grafts = {
        prefix: Graft.of(model, parts.model, 0, pin.SE3.Identity(), f"{prefix}_") for prefix, parts in robots.items()
    }
    bodies = _joined([grafts[p].geometry(parts.collision_model) for p, parts in robots.items()])
    _add_pairs_between(bodies, [len(parts.collision_model.geometryObjects) for parts in robots.values()])

    def visual() -> pin.GeometryModel:
        drawn = {prefix: parts.read_visual() or parts.collision_model for prefix, parts in robots.items()}
        return _joined([grafts[prefix].geometry(model) for prefix, model in drawn.items()])

    def prefixed(names: Callable[[RobotParts], tuple[str, ...]], order: list[str]) -> tuple[str, ...]:
        return tuple(f"{prefix}_{name}" for prefix in order for name in names(robots[prefix]))

    def by_joint(values: Callable[[RobotParts], Mapping[str, float]]) -> dict[str, float]:
        return {f"{p}_{joint}": x for p, parts in robots.items() for joint, x in values(parts).items()}

    order = list(robots)
    return RobotParts(
        name,
        name,
        model,
        bodies,
        visual,
        prefixed(lambda parts: parts.link_ends, order),
        prefixed(lambda parts: parts.tips, [tip, *(p for p in order if p != tip)]),
        {
            f"{p}_{joint}": replace(mimic, primary=f"{p}_{mimic.primary}")
            for p, parts in robots.items()
            for joint, mimic in parts.mimics.items()
        },
        by_joint(lambda parts: parts.held),
        prefixed(lambda parts: parts.bare_links, order),
        tuple(
            replace(item, name=f"{p}_{item.name}", link=f"{p}_{item.link}")
            for p, parts in robots.items()
            for item in parts.attached
        ),
        by_joint(lambda parts: parts.accelerations),
    )


def independent(geometry: pin.GeometryModel) -> pin.GeometryModel:
    """Return a copy of `geometry` that shares nothing with it, shapes included."""
    copy = geometry.copy()
    for part in copy.geometryObjects:
        part.geometry = part.geometry.clone()
    return copy


@dataclass(frozen=True)
class Graft:
    """Where the joints and frames of a model are in one that it was appended to.

    Written out, because Pinocchio's appendModel also adds collision pairs and reorders. New numbers are listed by the
    old ones; what was fixed to the world is fixed to joint `joints[0]`, with the old world at `pose` in its frame. The
    prefix is put before every name.
    """

    joints: list[int]
    frames: list[int]
    pose: pin.SE3
    prefix: str

    @classmethod
    def of(cls, target: pin.Model, source: pin.Model, joint: int, pose: pin.SE3, prefix: str = "") -> Graft:
        """Append `source` to a joint of `target`, which is changed."""
        frame = 0 if joint == 0 else int(target.getFrameId(target.names[joint]))
        graft = cls([joint], [frame], pose, prefix)
        for k, moved in list(enumerate(source.joints))[1:]:
            v, q = slice(moved.idx_v, moved.idx_v + moved.nv), slice(moved.idx_q, moved.idx_q + moved.nq)
            above, placement = source.parents[k], graft._placed(source.parents[k], source.jointPlacements[k])
            rates = source.effortLimit[v], source.velocityLimit[v]
            ends = source.lowerPositionLimit[q], source.upperPositionLimit[q]
            name = prefix + source.names[k]
            number = target.addJoint(graft.joints[above], moved, placement, name, *rates, *ends)
            target.inertias[number] = source.inertias[k]
            graft.joints.append(number)
        for frame in list(source.frames)[1:]:
            copy = pin.Frame(frame)
            copy.name = prefix + frame.name
            copy.parentJoint = graft.joints[frame.parentJoint]
            copy.parentFrame = graft.frames[frame.parentFrame]
            copy.placement = graft._placed(frame.parentJoint, frame.placement)
            graft.frames.append(target.addFrame(copy, False))
        return graft

    def geometry(self, source: pin.GeometryModel) -> pin.GeometryModel:
        """Return the geometry of the appended model, and its pairs, as the other model sees it."""
        found = pin.GeometryModel()
        for part in source.geometryObjects:
            copy = pin.GeometryObject(part)
            copy.name = self.prefix + part.name
            copy.parentJoint = self.joints[part.parentJoint]
            copy.parentFrame = self.frames[part.parentFrame] if part.parentFrame < len(self.frames) else 0
            copy.placement = self._placed(part.parentJoint, part.placement)
            found.addGeometryObject(copy)
        for pair in source.collisionPairs:
            found.addCollisionPair(pin.CollisionPair(pair.first, pair.second))
        return found

    def _placed(self, joint: int, placement: pin.SE3) -> pin.SE3:
        return self.pose * placement if joint == 0 else placement


def _joined(models: Iterable[pin.GeometryModel]) -> pin.GeometryModel:
    """Return one geometry model with the bodies of all, and the pairs of each."""
    joined = pin.GeometryModel()
    for model in models:
        first = len(joined.geometryObjects)
        for part in model.geometryObjects:
            joined.addGeometryObject(part)
        for pair in model.collisionPairs:
            joined.addCollisionPair(pin.CollisionPair(first + pair.first, first + pair.second))
    return joined


def _add_pairs_between(bodies: pin.GeometryModel, sizes: list[int]) -> None:
    """Check the bodies of each robot against those of the others, but for two that both stand still."""
    owners = np.repeat(np.arange(len(sizes)), sizes)
    joints = [part.parentJoint for part in bodies.geometryObjects]
    for a in range(len(owners)):
        for b in range(a + 1, len(owners)):
            if owners[a] != owners[b] and (joints[a] or joints[b]):
                bodies.addCollisionPair(pin.CollisionPair(a, b))


class GuardedCopy:
    """A copy of one of Pinocchio's models for users: changes of it do not reach the robot, of which things are proven.

    The copy is kept: working memory made from a model (GeometryData, broad-phase managers) points into it, and
    Pinocchio does not keep it alive. A new copy for each access would crash who makes such memory in one line and
    uses it in the next. `duplicate` returns a copy that shares nothing with its argument; the name is for the log.
    """

    def __init__(self, original: Any, duplicate: Callable[[Any], Any], name: str) -> None:
        self._original, self._duplicate, self._name = original, duplicate, name
        self._copies = [duplicate(original)]

    def get(self) -> Any:
        """Return an unchanged copy; warn if the one before was changed."""
        if self._copies[-1] != self._original:
            _log.warning(
                "%s was changed, which does not change the robot: use with_attached, with_limits or from_models",
                self._name,
            )
            self._copies.append(self._duplicate(self._original))
        return self._copies[-1]
