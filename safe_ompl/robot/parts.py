"""The parts of a robot: Pinocchio models with a base, attached objects, or several robots in one cell."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import combinations
from pathlib import Path
from typing import Any

import coal
import numpy as np
import pinocchio as pin

from safe_ompl.common import (
    FloatArray,
    InputError,
    IntArray,
    PerThread,
    Section,
    UnknownNameError,
    documents as document,
    key,
)
from safe_ompl.geometry import Box, Capsule, Cylinder, Mesh, Obstacle, Pose, Shape, Sphere, bounding_hull
from safe_ompl.robot.collision import drop_fixed_pairs, links_lacking_shapes, warn_of_unchecked
from safe_ompl.robot.displacement_bounds import JointChain
from safe_ompl.robot.joints import Mimic, RobotSkeleton, frame_index, joint_limits, reduce_model, with_mimics

BASE_JOINTS = ("base_x", "base_y", "base_yaw")
_SLIDES = (pin.JointModelPX, pin.JointModelPY)
_NO_LIMIT = np.full(1, np.inf)
# Colour of attached objects.
_COLOR = np.array([0.55, 0.62, 0.7, 1.0])
_SHAPES = (Box, Sphere, Cylinder, Capsule, Mesh)
_KEYS = ("link", "touch_links", "touch_depth", "danger")


def read_pose(name: str, value: Any) -> Pose:
    """Return a pose given in any form that `Pose.of` accepts."""
    return Pose.of(value, name)


def _shape(name: str, value: Any) -> Shape:
    if not isinstance(value, _SHAPES):
        kinds = ", ".join(kind.__name__ for kind in _SHAPES)
        raise InputError(f"must be one of {kinds}, not {value!r}", f"attached {name}")
    return value


@dataclass(frozen=True)
class Attachment(Section):
    """An object that a robot holds, fixed to a link.

    Parameters
    ----------
    touch_links : sequence of str
        Links that may touch the object. Links that do not move relative to `link` always may.
    touch_depth : float, optional
        Depth to which these links may reach into the object [m]; default: any depth.
    """

    name: str = key(document.text)
    shape: Shape = key(_shape)
    link: str = key(document.text)
    pose: Pose = key(read_pose, factory=Pose)
    touch_links: tuple[str, ...] = key(document.list_of, default=(), read=document.text)
    danger: bool = key(document.flag, default=False)
    touch_depth: float | None = key(document.number, default=None, above=0.0)

    @classmethod
    def from_mapping(cls, data: Mapping[str, Any], folder: Path | None = None) -> Attachment:
        """Read an object from the keys of an obstacle (shape and pose), `link` and the other fields."""
        link = document.require(data, "link")
        rest = {name: value for name, value in data.items() if name not in _KEYS}
        body = Obstacle.from_mapping(rest, folder or document.folder_of_document())
        more = {name: data[name] for name in _KEYS[1:] if name in data}
        return cls(body.name, body.shape, link, body.pose, **more)

    def to_mapping(self, folder: Path | None = None) -> dict[str, Any]:
        """Return the object as a mapping for `from_mapping`."""
        data = {"link": self.link, **Obstacle(self.name, self.shape, self.pose, 0.0).to_mapping(folder)}
        if self.touch_links:
            data["touch_links"] = list(self.touch_links)
        if self.touch_depth is not None:
            data["touch_depth"] = self.touch_depth
        return {**data, "danger": True} if self.danger else data


@dataclass(frozen=True, eq=False, repr=False)
class RobotParts:
    """Pinocchio models without the locked joints, with data that Pinocchio does not store. No code changes them."""

    name: str  # for reports
    # The file of the robot, or the robot's name, for error messages.
    source: str
    model: pin.Model
    # The collision geometry, with the pairs that are checked.
    collision_model: pin.GeometryModel
    read_visual: Callable[[], pin.GeometryModel | None]
    # The joints, locked ones included, that are key points of the skeleton.
    link_ends: tuple[str, ...]
    # The frames at the ends of arms. The robot's tip comes first.
    tips: tuple[str, ...]
    mimics: Mapping[str, Mimic] = field(default_factory=dict)
    held: Mapping[str, float] = field(default_factory=dict)
    # The links, moving or not, that lack collision shapes.
    bare_links: tuple[str, ...] = ()
    attached: tuple[Attachment, ...] = ()

    @cached_property
    def links_without_collision(self) -> tuple[str, ...]:
        """Moving links without collision shapes, see `links_lacking_shapes`."""
        moving = {frame.name for frame in self.model.frames if frame.parentJoint}
        return tuple(name for name in self.bare_links if name in moving)

    @cached_property
    def body_links(self) -> tuple[str, ...]:
        """The link of each of the G bodies of the collision model."""
        return tuple(body.name.rsplit("_", 1)[0] for body in self.collision_model.geometryObjects)

    @cached_property
    def body_pairs(self) -> IntArray:
        """The checked pairs of bodies, as indices (P, 2)."""
        pairs = [(pair.first, pair.second) for pair in self.collision_model.collisionPairs]
        return np.array(pairs, dtype=np.intp).reshape(-1, 2)

    @cached_property
    def placing(self) -> PerThread[tuple[pin.Data, pin.GeometryData]]:
        """Memory of each thread to place the bodies in. Whoever places them asks for all poses before others do."""
        return PerThread(lambda: (self.model.createData(), self.collision_model.createData()))

    @cached_property
    def chain(self) -> JointChain:
        """The joints as a chain for motion bounds."""
        sliding = np.array(["P" in joint.shortname()[10:] for joint in list(self.model.joints)[1:]])
        return JointChain.from_model(self.model, sliding, *joint_limits(self.model, self.source))

    def lacking(self, full: pin.Model, collide: frozenset[str], drawn: frozenset[str]) -> RobotParts:
        """Return the robot with the names of `links_lacking_shapes`, and warn of these links."""
        parts = replace(self, bare_links=links_lacking_shapes(full, collide, drawn))
        warn_of_unchecked(self.name, parts.links_without_collision)
        return parts

    def placed(self, pose: pin.SE3) -> RobotParts:
        """Return the robot with its base at `pose` in the world."""
        return self._on(pin.Model(), 0, pose)

    def on_mobile_base(self, ranges: tuple[tuple[float, float], tuple[float, float]]) -> RobotParts:
        """Return the robot on a base that slides along world x and y within ranges [m] and rotates about z."""
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

    def locking(self, values: Mapping[str, float]) -> RobotParts:
        """Return the robot with joints, and the joints that mimic them, locked at values [rad or m]."""
        held = with_mimics(self.model, self.mimics, values, self.source)
        model, bodies = reduce_model(self.model, self.collision_model, held)
        drop_fixed_pairs(bodies)
        visual = self._seen(lambda drawn: reduce_model(self.model, drawn, held)[1])
        mimics = {name: mimic for name, mimic in self.mimics.items() if name not in held}
        parts = replace(self, model=model, collision_model=bodies, read_visual=visual, mimics=mimics)
        return replace(parts, held={**self.held, **held})

    def holding(self, item: Attachment) -> RobotParts:
        """Return the robot with an attached object. Raises as `Robot.with_attached`."""
        links = [frame.name for frame in list(self.model.frames)[1:]]
        for name in (item.link, *item.touch_links):
            if name not in links:
                raise UnknownNameError(f"link for {item.name!r}", name, links, self.name)
        if item.name in (*links, *self.body_links):
            raise InputError(f"a link or frame is called {item.name!r}: give another name", self.name)
        frame = frame_index(self.model, item.link)
        joint, number = self.model.frames[frame].parentJoint, len(self.body_links)
        bodies = _with_object(self.collision_model, item, self.model, frame)
        core = whole = range(number, len(bodies.geometryObjects))
        if item.touch_links and item.touch_depth is not None:
            # The core of the object is added as a body. Links that may touch the object must not touch its core.
            with document.within(f"{item.name!r}, {1e3 * item.touch_depth:g} mm deep", ": "):
                inner = replace(item, shape=item.shape.core(item.touch_depth))
            bodies = _with_object(bodies, inner, self.model, frame)
            core = range(whole.stop, len(bodies.geometryObjects))
        for k, (link, body) in enumerate(zip(self.body_links, self.collision_model.geometryObjects, strict=True)):
            may_touch = link in item.touch_links
            if body.parentJoint != joint and not (may_touch and core is whole):
                for own in core if may_touch else whole:
                    bodies.addCollisionPair(pin.CollisionPair(k, own))
        model, tips = self.model, self.tips
        if item.danger:
            end = pin.SE3(np.eye(3), self._far_end(item, frame))
            model, tips = model.copy(), (*tips, item.name)
            model.addFrame(pin.Frame(item.name, joint, frame, end, pin.FrameType.OP_FRAME), False)
        visual = self._seen(lambda drawn: _with_object(drawn, item, self.model, frame))
        held = (*self.attached, item)
        return replace(self, model=model, collision_model=bodies, read_visual=visual, tips=tips, attached=held)

    def _far_end(self, item: Attachment, frame: int) -> FloatArray:
        """Return the far end of an object in the frame of its joint [m].

        This is its end on the line from the key point below it through the centre of its bounds.
        """
        link = self.model.frames[frame]
        below = RobotSkeleton.from_model(self.model, self.link_ends, self.tips).nearest(self.model, frame)
        if below is None or link.parentJoint == 0:
            raise InputError(f"{item.name!r} has no danger: no joint of the skeleton is below {item.link!r}", self.name)
        start, place = self.model.frames[below].placement.translation, link.placement * item.pose.se3
        hulls = [bounding_hull(part.geometry).moved(place * part.placement) for part in item.shape.parts()]
        points = np.concatenate([hull.points for hull in hulls])
        way = (points.min(axis=0) + points.max(axis=0)) / 2 - start
        length = float(np.linalg.norm(way))
        # If the key point is in the middle of the object, there is no such line, and the farthest point is used.
        if length < 1e-6:
            return np.asarray(points[np.linalg.norm(points - start, axis=1).argmax()])
        way = way / length
        return np.asarray(start + max(float(((hull.points - start) @ way).max()) + hull.radius for hull in hulls) * way)

    def _on(self, model: pin.Model, joint: int, pose: pin.SE3) -> RobotParts:
        """Append the robot to `model`, with its base fixed at `pose` to a joint, and return the result."""
        graft = Graft.of(model, self.model, joint, pose)
        model.name = self.model.name
        bodies, visual = graft.geometry(self.collision_model), self._seen(graft.geometry)
        return replace(self, model=model, collision_model=bodies, read_visual=visual)

    def _seen(self, change: Callable[[pin.GeometryModel], pin.GeometryModel]) -> Callable[[], pin.GeometryModel | None]:
        """Return a function that reads the visual model and applies `change` to it."""

        def read() -> pin.GeometryModel | None:
            drawn = self.read_visual()
            return None if drawn is None else change(drawn)

        return read


def combined(name: str, robots: Mapping[str, RobotParts], tip: str) -> RobotParts:
    """Combine robots, by the prefixes of their joints, links and frames, into one; `tip` is one of the prefixes."""
    model = pin.Model()
    model.name = name
    grafts = [Graft.of(model, parts.model, 0, pin.SE3.Identity(), f"{prefix}_") for prefix, parts in robots.items()]
    bodies = _joined(
        graft.geometry(parts.collision_model) for graft, parts in zip(grafts, robots.values(), strict=True)
    )
    _add_pairs_between(bodies, [len(parts.body_links) for parts in robots.values()])

    def visual() -> pin.GeometryModel:
        drawn = [parts.read_visual() or parts.collision_model for parts in robots.values()]
        return _joined(graft.geometry(geometry) for graft, geometry in zip(grafts, drawn, strict=True))

    found = RobotParts(name, name, model, bodies, visual, (), ())
    for prefix, parts in robots.items():
        mimics = {k: replace(mimic, primary=f"{prefix}_{mimic.primary}") for k, mimic in parts.mimics.items()}
        items = (replace(item, name=f"{prefix}_{item.name}", link=f"{prefix}_{item.link}") for item in parts.attached)
        ends = tuple(f"{prefix}_{end}" for end in parts.tips)
        found = replace(
            found,
            link_ends=(*found.link_ends, *(f"{prefix}_{end}" for end in parts.link_ends)),
            tips=ends + found.tips if prefix == tip else found.tips + ends,
            mimics={**found.mimics, **{f"{prefix}_{k}": mimic for k, mimic in mimics.items()}},
            held={**found.held, **{f"{prefix}_{joint}": value for joint, value in parts.held.items()}},
            bare_links=(*found.bare_links, *(f"{prefix}_{link}" for link in parts.bare_links)),
            attached=(*found.attached, *items),
        )
    return found


def independent(geometry: pin.GeometryModel) -> pin.GeometryModel:
    """Return a deep copy of `geometry`, with copies of its shapes."""
    copy = geometry.copy()
    for part in copy.geometryObjects:
        part.geometry = part.geometry.clone()
    return copy


def _with_object(geometry: pin.GeometryModel, item: Attachment, model: pin.Model, frame: int) -> pin.GeometryModel:
    """Return a copy of `geometry` with the parts of an object added as bodies."""
    copy, link = geometry.copy(), model.frames[frame]
    taken = sum(body.name.rsplit("_", 1)[0] == item.name for body in geometry.geometryObjects)
    for k, part in enumerate(item.shape.parts(), taken):
        place = link.placement * item.pose.se3 * part.placement
        body = pin.GeometryObject(f"{item.name}_{k}", link.parentJoint, frame, place, part.geometry)
        body.meshColor = _COLOR
        copy.addGeometryObject(body)
    return copy


@dataclass(frozen=True, eq=False, repr=False)
class Graft:
    """Map from joints and frames of a model to their indices in the model that it was appended to.

    Pinocchio's `appendModel` is not used, because it also adds collision pairs and reorders joints. Bodies that were
    fixed to the world are now fixed to joint `joints[0]`. The old world is at `pose` in the frame of this joint.
    """

    joints: list[int]
    frames: list[int]
    pose: pin.SE3
    prefix: str

    @classmethod
    def of(cls, target: pin.Model, source: pin.Model, joint: int, pose: pin.SE3, prefix: str = "") -> Graft:
        """Append `source` to a joint of `target`, in place, and return the map."""
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
        """Return the geometry of the appended model, with its pairs, for the combined model."""
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
    """Concatenate geometry models, with the collision pairs of each."""
    joined = pin.GeometryModel()
    for model in models:
        first = len(joined.geometryObjects)
        for part in model.geometryObjects:
            joined.addGeometryObject(part)
        for pair in model.collisionPairs:
            joined.addCollisionPair(pin.CollisionPair(first + pair.first, first + pair.second))
    return joined


def _add_pairs_between(bodies: pin.GeometryModel, sizes: list[int]) -> None:
    """Add the collision pairs between bodies of different robots, except pairs of two fixed bodies."""
    owners = np.repeat(np.arange(len(sizes)), sizes)
    joints = [part.parentJoint for part in bodies.geometryObjects]
    for a, b in combinations(range(len(owners)), 2):
        if owners[a] != owners[b] and (joints[a] or joints[b]):
            bodies.addCollisionPair(pin.CollisionPair(a, b))


_BODIES = (
    *(coal.Box, coal.Sphere, coal.Capsule, coal.Cylinder, coal.Cone, coal.Ellipsoid),
    *(coal.ConvexBase, coal.BVHModelBase),
)
# Names of the size attributes of coal's shapes.
SIZES = ("halfSide", "radius", "halfLength", "radii")


@dataclass(frozen=True)
class Models:
    """Pinocchio models, and the mimic joints by name, that a robot is built from."""

    model: pin.Model
    collision_model: pin.GeometryModel
    visual_model: pin.GeometryModel | None
    mimics: Mapping[str, Mimic]

    @classmethod
    def copied(cls, model: Any, collision_model: Any, visual_model: Any, mimics: Mapping[str, Mimic]) -> Models:
        """Copy the models. Raises InputError for another type, or a shape that is not supported."""
        _check_models(model, collision_model, visual_model)
        drawn = None if visual_model is None else independent(visual_model)
        return cls(model.copy(), independent(collision_model), drawn, dict(mimics))


def _check_models(model: Any, collision: Any, visual: Any) -> None:
    """Raise InputError if an argument is not a Pinocchio model, or the shape of a body is not supported."""
    if not isinstance(model, pin.Model):
        raise InputError(f"model must be a pin.Model, not {type(model).__name__}")
    for geometry in (collision,) if visual is None else (collision, visual):
        if not isinstance(geometry, pin.GeometryModel):
            raise InputError(f"geometry must be a pin.GeometryModel, not {type(geometry).__name__}")
        for part in geometry.geometryObjects:
            if part.parentJoint >= model.njoints:
                raise InputError(f"geometry {part.name!r}: there is no joint {part.parentJoint} in the model")
            if part.parentFrame >= model.nframes or model.frames[part.parentFrame].type != pin.FrameType.BODY:
                raise InputError(f"geometry {part.name!r} is on no link: give it the frame that addBodyFrame returned")
    # Pinocchio crashes for a joint without a frame.
    for joint, name in list(enumerate(model.names))[1:]:
        if not any(f.type == pin.FrameType.JOINT and f.parentJoint == joint for f in model.frames):
            raise InputError(f"joint {name!r} has no frame: call model.addJointFrame({joint})")
    for frame in model.frames:
        if frame.type != pin.FrameType.JOINT and model.frames[frame.parentFrame].parentJoint != frame.parentJoint:
            joint = model.names[frame.parentJoint]
            raise InputError(
                f"frame {frame.name!r} is on another joint than the frame before it: give that of {joint!r}"
            )
    for part in collision.geometryObjects:
        with document.within(f"geometry {part.name!r}", ": "):
            _check_shape(part.geometry)


def _check_shape(shape: Any) -> None:
    """Raise InputError for a shape that is infinite, empty, or not supported by the distances of coal."""
    if not isinstance(shape, _BODIES):
        supported = ", ".join(kind.__name__ for kind in _BODIES)
        raise InputError(f"a {type(shape).__name__} cannot be part of a robot; these can: {supported}")
    if isinstance(shape, (coal.ConvexBase, coal.BVHModelBase)):
        vertices = np.asarray(shape.points() if isinstance(shape, coal.ConvexBase) else shape.vertices())
        if not vertices.size or (isinstance(shape, coal.BVHModelBase) and not shape.num_tris):
            raise InputError("is a mesh without triangles")
        if not np.isfinite(vertices).all():
            raise InputError("has vertices that are not finite")
        return
    sizes = {name: np.ravel(getattr(shape, name)) for name in SIZES if hasattr(shape, name)}
    for name, size in sizes.items():
        if not (np.isfinite(size) & (size > 0)).all():
            raise InputError(f"{name} must be positive lengths [m], got {size.tolist()}")
