"""The robot, and how it is built: from a URDF, an example, Pinocchio's models, or several robots."""

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
    """A robot of revolute, prismatic and continuous joints; frozen once built.

    Build one with `Robot.from_urdf`, `Robot.from_example` or `Robot.from_models`. A configuration is an array `q: (n,)`
    of joint values [rad or m], in the order of `joint_names`; continuous joints take angles and wrap at ±π.

    Attributes
    ----------
    name : str
        Name for reports.
    joint_names : tuple of str
        The n joints that are planned for; those that mimic them follow.
    lower, upper : ndarray, shape (n,)
        Joint limits [rad or m]; ±π for continuous joints.
    continuous, prismatic : ndarray of bool, shape (n,)
        Which joints wrap, which slide.
    tip : str
        The frame at the end of the arm.
    segments : ndarray, shape (L, 2)
        Link segments of the skeleton as pairs of key points; `segment_names` has the frame at the distal end of each.
    coupling : Coupling
        How the joints of Pinocchio's model follow the planned ones.
    shared : RobotParts
        Pinocchio's models themselves, not copied: for code that never changes them.
    held_joints : dict of str to float
        Joints that are held, with their values [rad or m].
    links_without_collision : tuple of str
        Moving links that have no collision shapes, but visual ones or mass, or that span some length between links
        with shapes: nothing is proven of them.
    attached : tuple of Attachment
        The objects that it holds.
    accelerations : dict of str to float
        Acceleration limits that are known, by joint [rad/s² or m/s²]; see `with_accelerations`.
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
        """Build a robot from its URDF; all arguments are those of `RobotSpec`.

        Raises InputError for a missing or malformed file, a missing mesh, an unknown joint or frame, and joints of a
        kind that is not supported.
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
        """Build a robot from models of Pinocchio's, which are copied.

        Parameters
        ----------
        model : pin.Model
            Joints, those that mimic others as joints of their own.
        collision_model : pin.GeometryModel
            Bodies; named after their links, link_0, link_1, … Its collision pairs are those that are checked; if it
            has none, they are chosen as for a URDF without an SRDF.
        visual_model : pin.GeometryModel, optional
            What pictures show.
        mimics : mapping of str to Mimic, optional
            Which joints follow which.
        **options
            `tip`, `locked`, `limits` and others of `RobotSpec` that are not about files.

        Raises
        ------
        InputError
            If the models are not Pinocchio's, a body's shape is not supported (a plane, say), or as in `from_urdf`.
        """
        return cls(RobotSpec(models=Models.copied(model, collision_model, visual_model, mimics or {}), **options))

    @classmethod
    def combined(cls, name: str, robots: Mapping[str, Robot], *, tip: str | None = None) -> Robot:
        """Return several robots in one cell as one robot, each where its base is.

        All bodies of one are checked against all bodies of the others, but for two that never move. Joints, links and
        frames of each get its key as prefix: "left" makes "left_joint1". Goals are about the tip of the robot with the
        key `tip`, by default of the first; the skeleton of the danger has all arms.

        Raises InputError if there are fewer than two, names coincide, or there is no such key.
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
        """Return `value` as a configuration (n,), which may also be the name of a state in the SRDF.

        Values that such a state has for joints that are held are not used. Errors as of `ForwardKinematics` and
        `RobotSpec.group_state`.
        """
        if isinstance(value, str):
            with within(name, ": "):
                state = self.spec.group_state(value)
            value = {joint: state[joint] for joint in self.joint_names if joint in state}
        return super().configuration(value, name)

    def with_limits(self, limits: Mapping[str, tuple[float, float]]) -> Robot:
        """Return the same robot with other limits [rad or m] for the joints named."""
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
        """Return the same robot with an object in its gripper: checked against the scene and against the robot.

        Parameters
        ----------
        name : str
            Name of the object, for reports.
        shape : Shape
            Box, Sphere, Cylinder, Capsule or Mesh of `safe_ompl.geometry`.
        link, pose : optional
            Link or frame that it is fixed to, by default the tip; and where it is in its frame, by default at its
            origin.
        touch_links : sequence of str
            Links that it may touch, such as moving fingers. Those that do not move against `link` it always may.
        danger : bool
            Make the object a link of the skeleton, so that it is dangerous like the arm.
        touch_depth : float, optional
            How deep `touch_links` may be in it, at most [m]: what is deeper in the object is checked against them.
            Default: to any depth. It needs a box, sphere, cylinder or capsule.

        Raises
        ------
        InputError
            If the shape is another, the link does not exist, or its name is taken.
        """
        where = self.tip if link is None else link
        place = Pose() if pose is None else Pose.of(pose)
        return self.holding(Attachment(name, shape, where, place, tuple(touch_links), danger, touch_depth))

    def holding(self, item: Attachment) -> Robot:
        """Return the same robot with an object in its gripper; errors as `with_attached`."""
        found = type(self)(replace(self.spec, attached=(*self.spec.attached, item)), self.shared.holding(item))
        found.bare = self.bare
        return found

    @cached_property
    def bare(self) -> Robot:
        """The robot without what is attached to it; its files are read again if it was built with that."""
        return type(self)(replace(self.spec, attached=())) if self.spec.attached else self

    def hand_links(self, link: str) -> tuple[str, ...]:
        """Return the links of the hand that `link` belongs to: those that joints beyond it move, such as fingers."""
        model = self.shared.model
        carrier = model.frames[frame_index(model, link)].parentJoint
        beyond = set(model.subtrees[carrier]) - {carrier} if carrier else set()
        bodies = zip(self.shared.body_links, self.shared.collision_model.geometryObjects, strict=True)
        return tuple(dict.fromkeys(name for name, body in bodies if body.parentJoint in beyond))

    def with_accelerations(self, limits: Mapping[str, float]) -> Robot:
        """Return the same robot that knows acceleration limits of its joints [rad/s² or m/s²]; URDFs have none.

        Of joints that are not named what was known before stays. Raises InputError if a limit is absurd,
        UnknownNameError if it plans with no joint of such a name.
        """
        spec = replace(self.spec, accelerations={**self.spec.accelerations, **limits})
        return type(self)(spec, self.shared)

    def with_locked(self, values: Mapping[str, float], tip: str | None = None) -> Robot:
        """Return the robot with joints locked at values [rad or m], which is not written to documents as such.

        In a cell the tip may be another robot's, named by its prefix. Raises UnknownNameError for an unknown joint or
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
        """Bounds of how far bodies and key points move when joints do."""
        return DisplacementBounds(self)

    @cached_property
    def model(self) -> pin.Model:
        """A copy of Pinocchio's model of the joints that move, mimics included; changes do not reach the robot."""
        return self.shared.model.copy()

    # Pinocchio's GeometryData crashes if its model is gone, so this is always the same one.
    @cached_property
    def collision_model(self) -> pin.GeometryModel:
        """A copy of the bodies of the links, with the pairs that are checked; changes do not reach the robot."""
        return independent(self.shared.collision_model)

    @cached_property
    def visual_model(self) -> pin.GeometryModel:
        """A copy of the visual geometry; of the collision bodies where the visual meshes are missing."""
        return self.shared.read_visual() or independent(self.shared.collision_model)

    def __reduce__(self) -> tuple[Any, ...]:
        return Robot, (self.spec,)

    def __repr__(self) -> str:
        held = f", attached={[item.name for item in self.attached]}" if self.attached else ""
        bare = self.links_without_collision
        unchecked = f", links_without_collision={list(bare)}" if bare else ""
        return f"Robot({self.name!r}, joints={list(self.joint_names)}, tip={self.tip!r}{unchecked}{held})"


# Numbers are rounded to nanometres and nanoradians, so that the last bits, which differ between machines, do not count.
_DIGITS = 9


def robot_hash(robot: Robot) -> str:
    """Return the SHA-256 of joints, limits, placements, bodies, checked pairs and skeleton; file names do not count."""
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
