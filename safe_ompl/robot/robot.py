"""The class `Robot`, built from a URDF, an example, Pinocchio models, or several robots."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from hashlib import sha256
from pathlib import Path
from typing import Any

import coal
import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from safe_ompl.common import FloatArray, InputError, UnknownNameError, within
from safe_ompl.geometry import Pose, PoseLike, Shape
from safe_ompl.robot.displacement_bounds import DisplacementBounds
from safe_ompl.robot.forward_kinematics import ForwardKinematics
from safe_ompl.robot.joints import Mimic, frame_index
from safe_ompl.robot.parts import SIZES, Attachment, Models, RobotParts, independent
from safe_ompl.robot.spec import RobotSpec
from safe_ompl.robot.urdf import PackageDir


class Robot(ForwardKinematics):
    """A robot of revolute, prismatic and continuous joints; it does not change after construction.

    Build a robot with `Robot.from_urdf`, `Robot.from_example` or `Robot.from_models`. A configuration is an array
    `q: (n,)` of joint values [rad or m], in the order of `joint_names`; continuous joints have angles that wrap at ±π.

    Attributes
    ----------
    name : str
        Name for reports.
    joint_names : tuple of str
        The n planned joints, without the joints that mimic them.
    lower, upper : ndarray, shape (n,)
        Joint limits [rad or m]; ±π for continuous joints.
    continuous, prismatic : ndarray of bool, shape (n,)
        Which joints are continuous, and which are prismatic.
    tip : str
        The frame at the end of the arm.
    segments : ndarray, shape (L, 2)
        Link segments of the skeleton as pairs of key points; `segment_names` has the frame at the distal end of each.
    coupling : Coupling
        Linear map from the planned joints to the joints of Pinocchio's model.
    shared : RobotParts
        Pinocchio's models without a copy. Code that uses them must not change them.
    held_joints : dict of str to float
        Joints that are held, with their values [rad or m].
    links_without_collision : tuple of str
        Moving links without collision shapes that have visual shapes, mass, or length between links with shapes.
        No proof covers these links.
    attached : tuple of Attachment
        The objects that the robot holds.
    accelerations : dict of str to float
        Known acceleration limits, by joint [rad/s² or m/s²]; see `with_accelerations`.
    jerks : dict of str to float
        Jerk limits of `joint_limits`, by joint [rad/s³ or m/s³].

    Examples
    --------
    >>> robot = Robot.from_example("ur5")
    >>> robot.n, robot.tip
    (6, 'tool0')
    """

    def __init__(self, spec: RobotSpec, parts: RobotParts | None = None) -> None:
        self.spec = spec
        super().__init__(spec.assemble() if parts is None else parts)
        self.name: str = self.shared.name
        self.held_joints = dict(self.shared.held)
        self.attached = self.shared.attached
        given = spec.by_joint(lambda robot: robot.accelerations)
        for joint in given:
            if joint not in self.joint_names and joint not in self.held_joints:
                raise UnknownNameError("joint", joint, self.joint_names, "accelerations")
        in_file = spec.by_joint(lambda robot: robot.rates_of_file("acceleration"))
        self.accelerations = self._planned(in_file | given)
        self.jerks = self._planned(spec.by_joint(lambda robot: robot.rates_of_file("jerk")))
        self.links_without_collision = self.shared.links_without_collision

    @classmethod
    def from_urdf(
        cls,
        urdf: str | Path,
        srdf: str | Path | None = None,
        package_dirs: Sequence[str | PackageDir | Mapping[str, str | Path]] = (),
        tip: str | None = None,
        locked: Mapping[str, float] | None = None,
        **options: Any,
    ) -> Robot:
        """Build a robot from a URDF; the arguments are those of `RobotSpec`.

        Raises InputError for a missing or malformed file, a missing mesh, an unknown joint or frame, or an unsupported
        joint type.
        """
        folders: Any = tuple(package_dirs)
        files = Path(urdf), None if srdf is None else Path(srdf), folders
        return cls(RobotSpec(None, *files, tip, locked, **options))

    @classmethod
    def from_example(cls, name: str, **options: Any) -> Robot:
        """Build a robot of example-robot-data by its key in `safe_ompl.robot.EXAMPLES`: "panda", "ur5".

        Other options are those of `RobotSpec`. Raises UnknownNameError if there is no such robot.
        """
        return cls(RobotSpec(name, **options))

    @classmethod
    def from_models(
        cls,
        model: pin.Model,
        collision_model: pin.GeometryModel,
        visual_model: pin.GeometryModel | None = None,
        *,
        mimics: Mapping[str, Mimic] | None = None,
        **options: Any,
    ) -> Robot:
        """Build a robot from copies of Pinocchio models.

        Parameters
        ----------
        model : pin.Model
            The joints. Mimic joints must be joints of the model.
        collision_model : pin.GeometryModel
            The bodies, named after their links: link_0, link_1, … Only its collision pairs are checked. If it has no
            pairs, they are chosen as for a URDF without an SRDF.
        visual_model : pin.GeometryModel, optional
            Geometry for pictures.
        mimics : mapping of str to Mimic, optional
            Mimic joints by name, with the joints that they follow.
        **options
            `tip`, `locked`, `limits` and other options of `RobotSpec` that do not concern files.

        Raises
        ------
        InputError
            If the models are not Pinocchio's, the shape of a body is not supported (such as a plane), or as in
            `from_urdf`.
        """
        return cls(RobotSpec(models=Models.copied(model, collision_model, visual_model, mimics or {}), **options))

    @classmethod
    def combined(cls, name: str, robots: Mapping[str, Robot], *, tip: str | None = None) -> Robot:
        """Combine several robots in one cell into one robot. Each robot stands at its own base pose.

        Each body of a robot is checked against all bodies of the other robots, except pairs of two fixed bodies. The
        names of joints, links and frames get the key of their robot as prefix: "left" makes "left_joint1". Goals
        concern the tip of the robot with the key `tip`, by default the first robot. The skeleton of the danger contains
        all arms.

        Raises InputError for fewer than two robots, equal names, or an unknown key `tip`.
        """
        for prefix, robot in robots.items():
            if not isinstance(robot, Robot):
                raise InputError(f"{prefix}: must be a Robot, not {robot!r}")
        specs = {prefix: robot.spec for prefix, robot in robots.items()}
        if len(specs) < 2:
            raise InputError(f"give two robots or more, not {len(specs)}")
        spec = RobotSpec(robots=specs, name=name, tip=tip)
        return cls(spec, spec.joined({prefix: robot.shared for prefix, robot in robots.items()}))

    def _planned(self, values: Mapping[str, float]) -> dict[str, float]:
        return {joint: value for joint, value in values.items() if joint in self.joint_names}

    def configuration(self, value: ArrayLike | Mapping[str, float] | str, name: str = "configuration") -> FloatArray:
        """Return `value` as a configuration (n,). A text is the name of a group state in the SRDF.

        Values of a group state for held joints are ignored. Raises as `ForwardKinematics.configuration` and
        `RobotSpec.group_state`.
        """
        if isinstance(value, str):
            with within(name, ": "):
                state = self.spec.group_state(value)
            value = {joint: state[joint] for joint in self.joint_names if joint in state}
        return super().configuration(value, name)

    def with_limits(self, limits: Mapping[str, tuple[float, float]]) -> Robot:
        """Return the robot with other position limits [rad or m] for the named joints."""
        return type(self)(self.spec.with_limits(limits))

    def with_attached(
        self,
        name: str,
        shape: Shape,
        link: str | None = None,
        pose: PoseLike | None = None,
        *,
        touch_links: Sequence[str] = (),
        danger: bool = False,
        touch_depth: float | None = None,
    ) -> Robot:
        """Return the robot with an object in its gripper, which is checked against the scene and the robot.

        Parameters
        ----------
        name : str
            Name of the object, for reports.
        shape : Shape
            Box, Sphere, Cylinder, Capsule or Mesh of `safe_ompl.geometry`.
        link, pose : optional
            The link or frame that the object is fixed to (default: the tip), and the pose of the object in this frame
            (default: identity).
        touch_links : sequence of str
            Links that may touch the object, such as moving fingers. Links that do not move relative to `link` always
            may.
        danger : bool
            Make the object a link of the skeleton, so that it is dangerous like the arm.
        touch_depth : float, optional
            Depth to which `touch_links` may reach into the object [m]; the part of the object deeper than this is
            checked against them. Default: any depth. It needs a box, sphere, cylinder or capsule.

        Raises
        ------
        InputError
            If the shape is not supported, the link does not exist, or the name is taken.
        """
        where = self.tip if link is None else link
        place = Pose() if pose is None else Pose.of(pose)
        return self.holding(Attachment(name, shape, where, place, tuple(touch_links), danger, touch_depth))

    def holding(self, item: Attachment) -> Robot:
        """Return the robot with an attached object. Raises as `with_attached`."""
        found = type(self)(replace(self.spec, attached=(*self.spec.attached, item)), self.shared.holding(item))
        found.bare = self.bare
        return found

    @cached_property
    def bare(self) -> Robot:
        """The robot without attached objects. Its files are read again if it was built with attached objects."""
        return type(self)(replace(self.spec, attached=())) if self.spec.attached else self

    def hand_links(self, link: str) -> tuple[str, ...]:
        """Return the links that joints distal of `link` move, such as the fingers of a hand."""
        model = self.shared.model
        carrier = model.frames[frame_index(model, link)].parentJoint
        beyond = set(model.subtrees[carrier]) - {carrier} if carrier else set()
        bodies = zip(self.shared.body_links, self.shared.collision_model.geometryObjects, strict=True)
        return tuple(dict.fromkeys(name for name, body in bodies if body.parentJoint in beyond))

    def with_accelerations(self, limits: Mapping[str, float]) -> Robot:
        """Return the robot with acceleration limits [rad/s² or m/s²] for the named joints; a URDF has none.

        Other joints keep their limits. Raises InputError if a limit is out of range, UnknownNameError for a joint that
        the robot does not have.
        """
        spec = replace(self.spec, accelerations={**self.spec.accelerations, **limits})
        return type(self)(spec, self.shared)

    def with_locked(self, values: Mapping[str, float], tip: str | None = None) -> Robot:
        """Return the robot with joints locked at values [rad or m]. Documents do not store these locks.

        In a cell, `tip` is the prefix of the robot whose tip is used. Raises UnknownNameError for an unknown joint or
        prefix, InputError for a value outside the limits.
        """
        parts = self.shared.locking(values)
        if tip is not None:
            if tip not in self.spec.robots:
                raise UnknownNameError("robot", tip, self.spec.robots)
            first = next(name for name in parts.tips if name.startswith(f"{tip}_"))
            parts = replace(parts, tips=(first, *(name for name in parts.tips if name != first)))
        return type(self)(self.spec, parts)

    @cached_property
    def bounds(self) -> DisplacementBounds:
        """Motion bounds: how far bodies and key points move at most for a joint motion."""
        return DisplacementBounds(self)

    @cached_property
    def model(self) -> pin.Model:
        """A copy of Pinocchio's model of the moving joints, mimic joints included. Changes do not affect the robot."""
        return self.shared.model.copy()

    # Pinocchio's GeometryData crashes if its model is deleted, so this property always returns the same object.
    @cached_property
    def collision_model(self) -> pin.GeometryModel:
        """A copy of the bodies of the links, with the checked pairs. Changes do not affect the robot."""
        return independent(self.shared.collision_model)

    @cached_property
    def visual_model(self) -> pin.GeometryModel:
        """A copy of the visual geometry, or of the collision bodies if the visual meshes are missing."""
        return self.shared.read_visual() or independent(self.shared.collision_model)

    def __reduce__(self) -> tuple[Any, ...]:
        return Robot, (self.spec,)

    def __repr__(self) -> str:
        held = f", attached={[item.name for item in self.attached]}" if self.attached else ""
        bare = self.links_without_collision
        unchecked = f", links_without_collision={list(bare)}" if bare else ""
        return f"Robot({self.name!r}, joints={list(self.joint_names)}, tip={self.tip!r}{unchecked}{held})"


# Numbers are rounded to nanometres and nanoradians, because their last bits differ between machines.
_DIGITS = 9


def robot_hash(robot: Robot) -> str:
    """Return the SHA-256 of joints, limits, placements, bodies, checked pairs and skeleton, without file names."""
    chain, geometry = robot.shared.chain, robot.shared.collision_model
    content = {
        "joints": list(robot.joint_names),
        "lower": _numbers(robot.lower),
        "upper": _numbers(robot.upper),
        "continuous": robot.continuous.tolist(),
        "prismatic": robot.prismatic.tolist(),
        "parents": chain.parents,
        "placements": [_numbers(placement.homogeneous) for placement in chain.placements],
        "axes": _numbers(chain.axes),
        "tip": robot.tip,
        "segments": robot.segments.tolist(),
        "keypoints": _numbers(robot.keypoints(np.clip(np.zeros(robot.n), robot.lower, robot.upper))),
        "bodies": [
            {
                "name": body.name,
                "joint": int(body.parentJoint),
                "placement": _numbers(body.placement.homogeneous),
                "shape": type(body.geometry).__name__,
                "size": _size(body.geometry),
            }
            for body in geometry.geometryObjects
        ],
        "pairs": sorted((int(pair.first), int(pair.second)) for pair in geometry.collisionPairs),
    }
    if not robot.coupling.trivial:
        content["mimics"] = [_numbers(robot.coupling.matrix), _numbers(robot.coupling.offsets)]
    return sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()


def _size(shape: coal.CollisionGeometry) -> Any:
    if isinstance(shape, coal.ConvexBase):
        return sorted(_numbers(np.asarray(shape.points()).reshape(-1, 3)))
    known = {name: _numbers(getattr(shape, name)) for name in SIZES if hasattr(shape, name)}
    shape.computeLocalAABB()
    return {**known, "box": [_numbers(np.ravel(corner)) for corner in (shape.aabb_local.min_, shape.aabb_local.max_)]}


def _numbers(values: ArrayLike) -> Any:
    # Adding 0.0 turns a negative zero into zero.
    return (np.round(np.asarray(values, dtype=np.float64), _DIGITS) + 0.0).tolist()
