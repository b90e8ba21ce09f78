"""Where robots come from besides URDFs of one's own: example-robot-data, and models of Pinocchio's."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cache
from importlib.metadata import PackageNotFoundError, distribution
from pathlib import Path
from typing import Any

import coal
import numpy as np
import pinocchio as pin

from safe_ompl.common import InputError, UnknownNameError, within
from safe_ompl.robot.joints import Mimic
from safe_ompl.robot.parts import independent

_GRIPPER_OPEN = 0.04  # [m] per finger of the Panda's hand


@dataclass(frozen=True)
class ExampleRobot:
    """Files and settings of one robot of example-robot-data."""

    urdf: str
    srdf: str | None
    tip: str
    locked: dict[str, float] = field(default_factory=dict)


EXAMPLES: dict[str, ExampleRobot] = {
    "panda": ExampleRobot(
        "panda_description/urdf/panda.urdf",
        "panda_description/srdf/panda.srdf",
        "panda_hand_tcp",
        {"panda_finger_joint1": _GRIPPER_OPEN, "panda_finger_joint2": _GRIPPER_OPEN},
    ),
    "ur3": ExampleRobot("ur_description/urdf/ur3_joint_limited_robot.urdf", None, "tool0"),
    "ur5": ExampleRobot(
        "ur_description/urdf/ur5_joint_limited_robot.urdf", "ur_description/srdf/ur5_joint_limited_robot.srdf", "tool0"
    ),
    "ur10": ExampleRobot("ur_description/urdf/ur10_joint_limited_robot.urdf", None, "tool0"),
    "xarm7": ExampleRobot("xarm_description/urdf/xarm7.urdf", "xarm_description/srdf/xarm7.srdf", "link_eef"),
    "kinova": ExampleRobot("kinova_description/robots/kinova.urdf", None, "j2s6s200_end_effector"),
    "z1": ExampleRobot("z1_description/urdf/z1.urdf", None, "gripperStator"),
    "so101": ExampleRobot("so_arm_description/urdf/so101.urdf", None, "gripper_frame_link"),
}


@cache
def robots_folder() -> Path:
    """Return the folder that holds the robots of example-robot-data, or raise InputError if it is not installed."""
    try:
        package = distribution("example-robot-data")
    except PackageNotFoundError:
        raise InputError("the package example-robot-data is not installed") from None
    for file in package.files or ():
        if file.name == "panda.urdf":
            return Path(str(package.locate_file(file))).resolve().parents[2]
    raise InputError("the package example-robot-data holds no robots")


def find_example(name: str) -> ExampleRobot:
    """Return the entry of the example robot called `name`, or raise UnknownNameError."""
    try:
        return EXAMPLES[name]
    except (KeyError, TypeError):
        raise UnknownNameError("example robot", name, sorted(EXAMPLES)) from None


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
