"""Robots from models of Pinocchio's: what of them is refused, and copies of the others that are complete."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import coal
import numpy as np
import pinocchio as pin

from safe_ompl.common import InputError, within
from safe_ompl.robot.joint_tables import Mimic
from safe_ompl.robot.loading.parts import independent

_SHAPES = (
    *(coal.Box, coal.Sphere, coal.Capsule, coal.Cylinder, coal.Cone, coal.Ellipsoid),
    *(coal.ConvexBase, coal.BVHModelBase),
)
_SIZES = ("halfSide", "radius", "halfLength", "radii")


@dataclass(frozen=True)
class Models:
    """Models of Pinocchio's that a robot is built from, its own, and which joints of them follow which."""

    model: pin.Model
    collision_model: pin.GeometryModel
    visual_model: pin.GeometryModel | None
    mimics: Mapping[str, Mimic]

    @classmethod
    def copied(cls, model: Any, collision_model: Any, visual_model: Any, mimics: Mapping[str, Mimic]) -> Models:
        """Return copies; raise InputError if a model is none of Pinocchio's, or a shape is not supported."""
        _check_models(model, collision_model, visual_model)
        bodies, drawn = (
            None if geometry is None else independent(geometry) for geometry in (collision_model, visual_model)
        )
        return cls(model.copy(), bodies, drawn, dict(mimics))


def _check_models(model: Any, collision: Any, visual: Any) -> None:
    """Raise InputError for anything but models of Pinocchio's, and for bodies whose shapes are not supported."""
    if not isinstance(model, pin.Model):
        raise InputError(f"model must be a pin.Model, not {type(model).__name__}")
    for geometry in (collision, visual):
        if geometry is not None and not isinstance(geometry, pin.GeometryModel):
            raise InputError(f"geometry must be a pin.GeometryModel, not {type(geometry).__name__}")
        for part in () if geometry is None else geometry.geometryObjects:
            if part.parentJoint >= model.njoints:
                raise InputError(f"geometry {part.name!r}: there is no joint {part.parentJoint} in the model")
            if part.parentFrame >= model.nframes or model.frames[part.parentFrame].type != pin.FrameType.BODY:
                raise InputError(f"geometry {part.name!r} is on no link: give it the frame that addBodyFrame returned")
    for joint, name in list(enumerate(model.names))[1:]:  # Pinocchio crashes without
        if not any(f.type == pin.FrameType.JOINT and f.parentJoint == joint for f in model.frames):
            raise InputError(f"joint {name!r} has no frame: call model.addJointFrame({joint})")
    for frame in model.frames:
        if frame.type != pin.FrameType.JOINT and model.frames[frame.parentFrame].parentJoint != frame.parentJoint:
            joint = model.names[frame.parentJoint]
            raise InputError(
                f"frame {frame.name!r} is on another joint than the frame before it: give that of {joint!r}"
            )
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
