"""Blueprints of robots from a URDF, or from models of Pinocchio's."""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import coal
import numpy as np
import pinocchio as pin

from safe_ompl.common import InputError, UnknownNameError, warn_once, within
from safe_ompl.robot.arm import default_tip
from safe_ompl.robot.joint_tables import Mimic, resolved
from safe_ompl.robot.loading.blueprint import Blueprint, RangeByJoint
from safe_ompl.robot.loading.collision import (
    build_collision_geometry,
    check_collides,
    drop_fixed_pairs,
    links_of,
    make_convex,
    sample_configurations,
    select_self_pairs,
)
from safe_ompl.robot.loading.parts import RobotParts, independent
from safe_ompl.robot.loading.reduction import (
    JointChoice,
    apply_mimic_limits,
    check_plannable,
    joint_limits,
    joints_and_posture,
    joints_without_range,
    override_limits,
    reduce_model,
    with_mimics,
)
from safe_ompl.robot.loading.srdf import SrdfFile
from safe_ompl.robot.loading.urdf import UrdfFile

_log = logging.getLogger(__name__)

_SHAPES = (
    *(coal.Box, coal.Sphere, coal.Capsule, coal.Cylinder, coal.Cone, coal.Ellipsoid),
    *(coal.ConvexBase, coal.BVHModelBase),
)
_SIZES = ("halfSide", "radius", "halfLength", "radii")


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
    limits: RangeByJoint
    collision: str = "required"
    group: str | None = None
    locked_state: str | None = None
    xacro_args: Mapping[str, str] | None = None

    def file(self) -> UrdfFile:
        """Read the URDF."""
        return UrdfFile(self.urdf, self.package_dirs, self.xacro_args)

    def assemble(self) -> RobotParts:
        """Read the files, lock joints, and build what remains."""
        file = self.file()
        full = file.build_model()
        collision_model = build_collision_geometry(file, full, self.collision, hulls=self.hulls)
        mimics = {name: mimic for name, mimic in file.mimics().items() if full.existJointName(name)}

        def read_visual() -> pin.GeometryModel | None:
            try:
                geometry = file.build_geometry(full, pin.GeometryType.VISUAL, queried=False)
            except InputError as error:
                warn_once(_log, f"{file.path.name}: drawing its collision bodies ({error})")
                return None
            return geometry if len(geometry.geometryObjects) else None

        source = _Source(full, collision_model, read_visual, mimics, str(file.path))
        name = self.name or full.name or file.path.stem
        choice = JointChoice(self.tip, self.locked, self.srdf, self.group, self.locked_state)
        parts = source.reduced(name, choice, self.limits, self.hulls)
        check_collides(parts.collision_model, self.collision, str(file.path))
        return parts.lacking(full, links_of(full, collision_model), file.links_with("visual"))

    def with_limits(self, limits: RangeByJoint) -> UrdfBlueprint:
        return replace(self, limits={**self.limits, **limits})

    def state(self, name: str) -> dict[str, float]:
        return super().state(name) if self.srdf is None else SrdfFile(self.srdf).state(name)


@dataclass(frozen=True)
class ModelsBlueprint(Blueprint):
    """A robot from models of Pinocchio's, which are its own; see `Robot.from_models`."""

    model: pin.Model
    collision_model: pin.GeometryModel
    visual_model: pin.GeometryModel | None
    tip: str | None
    locked: Mapping[str, float]
    hulls: bool
    name: str
    limits: RangeByJoint
    mimics: Mapping[str, Mimic]

    def assemble(self) -> RobotParts:
        """Lock joints, and build what remains; pairs that the collision model has are those that are checked."""
        models = self.model.copy(), independent(self.collision_model)
        source = _Source(*models, lambda: self.visual_model, self.mimics, self.name)
        parts = source.reduced(self.name, JointChoice(self.tip, self.locked), self.limits, self.hulls)
        shapes = [links_of(self.model, geometry) for geometry in (self.collision_model, self.visual_model)]
        return parts.lacking(self.model, *shapes)

    def with_limits(self, limits: RangeByJoint) -> ModelsBlueprint:
        return replace(self, limits={**self.limits, **limits})


@dataclass(frozen=True)
class _Source:
    """All joints of a robot and its geometry, before joints are locked."""

    full: pin.Model
    collision_model: pin.GeometryModel
    read_visual: Callable[[], pin.GeometryModel | None]
    mimics: Mapping[str, Mimic]
    source: str

    def reduced(self, name: str, choice: JointChoice, limits: RangeByJoint, hulls: bool) -> RobotParts:
        """Return the parts of the robot with its joints locked, bodies convex and self pairs chosen."""
        full, source, mimics, tip = self.full, self.source, resolved(self.mimics, self.source), choice.tip
        override_limits(full, limits, source)
        if tip is not None and not full.existFrame(tip):
            raise UnknownNameError("tip frame", tip, (frame.name for frame in list(full.frames)[1:]), source)
        held = joints_and_posture(full, mimics, choice, source)
        stiff = joints_without_range(full, set(list(full.names)[1:]) - set(mimics) - set(limits) - set(held))
        if stiff:
            values = ", ".join(f"{joint} = {value:g}" for joint, value in sorted(stiff.items()))
            warn_once(_log, f"{name}: held, as their limits leave no range (limits= gives others): {values}")
        held = with_mimics(full, mimics, {**held, **stiff}, source)
        model, collision_model = reduce_model(full, self.collision_model, held)
        check_plannable(model, source, stiff)
        if hulls:
            make_convex(collision_model)
        mimics = {joint: mimic for joint, mimic in mimics.items() if model.existJointName(joint)}
        apply_mimic_limits(model, mimics, source)
        joint_limits(model, source)
        drop_fixed_pairs(collision_model)
        if not len(collision_model.collisionPairs):
            samples = sample_configurations(model, mimics=mimics)
            select_self_pairs(model, collision_model, choice.srdf, samples, name)

        def visual() -> pin.GeometryModel | None:
            drawn = self.read_visual()
            return None if drawn is None else reduce_model(full, drawn, held)[1]

        ends = tuple(full.names)[1:]
        tips = (tip or choice.group_tip(full, source) or default_tip(full, model),)
        return RobotParts(name, source, model, collision_model, visual, ends, tips, mimics, held)


def check_models(model: Any, collision: Any, visual: Any) -> None:
    """Raise InputError for anything but models of Pinocchio's, and for bodies whose shapes are not supported."""
    if not isinstance(model, pin.Model):
        raise InputError(f"model must be a pin.Model, not {type(model).__name__}")
    for geometry in (collision, visual):
        if geometry is not None and not isinstance(geometry, pin.GeometryModel):
            raise InputError(f"geometry must be a pin.GeometryModel, not {type(geometry).__name__}")
        for part in () if geometry is None else geometry.geometryObjects:
            if part.parentJoint >= model.njoints:
                raise InputError(f"geometry {part.name!r}: there is no joint {part.parentJoint} in the model")
    for part in collision.geometryObjects:
        with within(f"geometry {part.name!r}", ": "):
            _check_shape(part.geometry)


def _check_shape(shape: Any) -> None:
    """Raise InputError for a shape without end, one without size, and one whose distances coal cannot tell."""
    if not isinstance(shape, _SHAPES):
        supported = ", ".join(kind.__name__ for kind in _SHAPES)
        raise InputError(f"a {type(shape).__name__} cannot be part of a robot; these can: {supported}")
    if isinstance(shape, (coal.ConvexBase, coal.BVHModelBase)):
        vertices = np.asarray(shape.points() if isinstance(shape, coal.ConvexBase) else shape.vertices())
        if not vertices.size or (isinstance(shape, coal.BVHModelBase) and not shape.num_tris):
            raise InputError("is a mesh without triangles")
        if not np.isfinite(vertices).all():
            raise InputError("has vertices that are not finite")
        return
    sizes = {name: np.ravel(getattr(shape, name)) for name in _SIZES if hasattr(shape, name)}
    for name, size in sizes.items():
        if not (np.isfinite(size) & (size > 0)).all():
            raise InputError(f"{name} must be positive lengths [m], got {size.tolist()}")


def owned(model: pin.Model, *geometries: pin.GeometryModel | None) -> tuple[Any, ...]:
    """Return copies of models with the frames that a URDF's have: for each joint, and for each link with a body.

    Pinocchio's shortest constructor of a geometry object leaves out the frame that it is on. It then crashes when
    joints are locked, and refuses frames that are not on the joint of the frame before them.
    """
    model, given = model.copy(), model.nframes
    for joint in range(1, model.njoints):
        if not any(f.type == pin.FrameType.JOINT and f.parentJoint == joint for f in model.frames):
            model.addJointFrame(joint)
    # Frames must come after those that they are on.
    order = [0, *range(given, model.nframes), *range(1, given)]
    number = {old: new for new, old in enumerate(order)}
    for new, frame in enumerate([pin.Frame(model.frames[old]) for old in order]):
        frame.parentFrame = number[frame.parentFrame]
        model.frames[new] = frame
    for frame in model.frames:
        joint, above = frame.parentJoint, model.frames[frame.parentFrame]
        if frame.type != pin.FrameType.JOINT and above.parentJoint != joint:
            frame.parentFrame = _joint_frame(model, joint)
    copies = [None if geometry is None else independent(geometry) for geometry in geometries]
    for copy in copies:
        for part in () if copy is None else copy.geometryObjects:
            part.parentFrame = on = number.get(part.parentFrame, model.nframes)
            if on == model.nframes or model.frames[on].type != pin.FrameType.BODY:
                part.parentFrame = _link_frame(model, part)
    return model, *copies


def _link_frame(model: pin.Model, part: pin.GeometryObject) -> int:
    """Return the frame of the link that a body is of; it is made where the model has none."""
    link, joint = part.name.rsplit("_", 1)[0], part.parentJoint
    links = {f.name: k for k, f in enumerate(model.frames) if f.type == pin.FrameType.BODY}
    own = [k for k in links.values() if model.frames[k].parentJoint == joint]
    if own:
        return links[link] if links.get(link) in own else own[0]
    if link in links:
        raise InputError(f"geometry {part.name!r}: link {link!r} is on another joint than the body")
    return int(model.addBodyFrame(link, joint, pin.SE3.Identity(), _joint_frame(model, joint)))


def _joint_frame(model: pin.Model, joint: int) -> int:
    return 0 if joint == 0 else int(model.getFrameId(model.names[joint], pin.FrameType.JOINT))
