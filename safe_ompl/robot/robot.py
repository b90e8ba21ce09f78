"""The robot, and how it is built: from a URDF, an example, Pinocchio's models, or several robots."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cached_property
from pathlib import Path
from typing import Any

import pinocchio as pin
from numpy.typing import ArrayLike

from safe_ompl.common import RATE_BOUNDS, InputError, UnknownNameError, number
from safe_ompl.common import documents as document
from safe_ompl.geometry import Shape
from safe_ompl.robot.displacement_bounds import DisplacementBounds
from safe_ompl.robot.forward_kinematics import ForwardKinematics
from safe_ompl.robot.joint_tables import Mimic
from safe_ompl.robot.loading import CollisionSource
from safe_ompl.robot.loading.blueprint import (
    Attached,
    Attachment,
    Blueprint,
    Combined,
    OnBase,
    PoseLike,
    RangeByJoint,
    Ranges,
    WithAccelerations,
    as_pose,
    check_prefixes,
    standing,
)
from safe_ompl.robot.loading.packages import find_example, robots_folder
from safe_ompl.robot.loading.parts import GuardedCopy, RobotParts, independent
from safe_ompl.robot.loading.sources import ModelsBlueprint, UrdfBlueprint, check_models, owned
from safe_ompl.robot.loading.urdf import existing_file


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
    """

    def __init__(self, blueprint: Blueprint, parts: RobotParts | None = None) -> None:
        self.blueprint = blueprint
        super().__init__(blueprint.assemble() if parts is None else parts)
        self.name: str = self.shared.name
        self.held_joints = dict(self.shared.held)
        self.attached = self.shared.attached
        self.accelerations = dict(self.shared.accelerations)
        self.links_without_collision = self.shared.links_without_collision

    @classmethod
    def from_urdf(
        cls,
        urdf: str | Path,
        srdf: str | Path | None = None,
        package_dirs: Sequence[str | Path] = (),
        tip: str | None = None,
        locked: Mapping[str, float] | None = None,
        *,
        hulls: bool = True,
        name: str | None = None,
        limits: RangeByJoint | None = None,
        base: PoseLike | None = None,
        mobile_base: Ranges | None = None,
        collision: CollisionSource = "required",
        group: str | None = None,
        locked_state: str | None = None,
        xacro_args: Mapping[str, str] | None = None,
    ) -> Robot:
        """Build a robot from its URDF.

        Parameters
        ----------
        urdf : path-like
            The URDF. One that holds xacro is expanded by the package xacro (`pip install xacro`).
        srdf : path-like, optional
            SRDF whose disabled collision pairs are not checked. Without one, or with one that disables nothing,
            pairs of adjacent links and pairs that are always in contact are dropped, and the log says which.
        package_dirs : sequence of path-like
            Folders that hold the packages of `package://` names; those above the URDF are searched as well.
        tip : str, optional
            Frame at the end of the arm. Joints that do not move it are held; a warning says at which posture.
            Default: the body farthest from the base; where that is a finger, the hand.
        locked : mapping of str to float, optional
            Joints to hold still, with their values [rad or m]. A joint that mimics a locked one is locked with it.
            If it names all joints that are to move (such as `robot.named("home")`), it is the posture of the others.
        hulls : bool
            Replace meshes by their convex hulls (solid and fast). False keeps the meshes, which are hollow.
        name : str, optional
            Name for reports; the URDF's by default.
        limits : mapping of str to (float, float), optional
            Joint limits that replace the URDF's [rad or m].
        base : Pose, pin.SE3, mapping or position, optional
            Where the robot's base is in the world.
        mobile_base : pair of (float, float), optional
            Limits ((x0, x1), (y0, y1)) [m] of a base that slides in x and y and turns about z: three joints more,
            base_x, base_y and base_yaw, before the others. `base` is then the origin of these.
        collision : {"required", "visual", "optional"}
            What collides of links that have visual shapes only. "visual": those shapes. Otherwise nothing, which
            `links_without_collision` and a warning say; a robot with no collision shape on any moving link is refused
            unless this is "optional".
        group, locked_state : str, optional
            Group of the SRDF whose joints move, the others are held; and state of the SRDF that says at which values
            joints are held, zero by default.
        xacro_args : mapping of str to str, optional
            Values of xacro's arguments.

        Raises
        ------
        InputError
            Missing or malformed file, missing mesh, unknown joint or frame, unsupported joint type.
        """
        srdf_file = None if srdf is None else str(existing_file(srdf, "SRDF"))
        files = str(existing_file(urdf, "URDF")), srdf_file, tuple(map(str, package_dirs))
        held, ranges, words = dict(locked or {}), dict(limits or {}), dict(xacro_args or {})
        blueprint = UrdfBlueprint(*files, tip, held, hulls, name, ranges, collision, group, locked_state, words)
        return cls(standing(blueprint, base, mobile_base))

    @classmethod
    def from_example(
        cls, name: str, *, tip: str | None = None, locked: Mapping[str, float] | None = None, **options: Any
    ) -> Robot:
        """Build a robot of example-robot-data by its key in `safe_ompl.robot.loading.EXAMPLES`: "panda", "ur5".

        Tip and locked joints are by default those of the table of examples; other options are `hulls`, `base`,
        `mobile_base`, `collision`, `group` and `locked_state` of `from_urdf`. Raises UnknownNameError if there is no
        such robot.
        """
        example = find_example(name)
        folder = robots_folder()
        return cls.from_urdf(
            folder / example.urdf,
            folder / example.srdf if example.srdf else None,
            (folder.parents[1],),
            tip or (example.tip if options.get("group") is None else None),
            example.locked if locked is None else locked,
            name=name,
            **options,
        )

    @classmethod
    def from_models(
        cls,
        model: pin.Model,
        collision_model: pin.GeometryModel,
        visual_model: pin.GeometryModel | None = None,
        *,
        tip: str | None = None,
        locked: Mapping[str, float] | None = None,
        hulls: bool = True,
        name: str | None = None,
        limits: RangeByJoint | None = None,
        mimics: Mapping[str, Mimic] | None = None,
        base: PoseLike | None = None,
        mobile_base: Ranges | None = None,
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
        tip, locked, hulls, name, limits, base, mobile_base
            As in `from_urdf`.

        Raises
        ------
        InputError
            If the models are not Pinocchio's, a body's shape is not supported (a plane, say), or as in `from_urdf`.
        """
        check_models(model, collision_model, visual_model)
        own, collision, visual = owned(model, collision_model, visual_model)
        held, ranges, title = dict(locked or {}), dict(limits or {}), name or model.name or "robot"
        blueprint = ModelsBlueprint(own, collision, visual, tip, held, hulls, title, ranges, dict(mimics or {}))
        return cls(standing(blueprint, base, mobile_base))

    @classmethod
    def combined(cls, name: str, robots: Mapping[str, Robot], *, tip: str | None = None) -> Robot:
        """Return several robots in one cell as one robot, each where its base is.

        All bodies of one are checked against all bodies of the others, but for two that never move. Joints, links and
        frames of each get its key as prefix: "left" makes "left_joint1". Goals are about the tip of the robot with the
        key `tip`, by default of the first; the skeleton of the danger has all arms.

        Raises InputError if there are fewer than two, names coincide, or there is no such key.
        """
        for prefix, robot in robots.items():
            document.text("prefix", prefix)
            if not isinstance(robot, Robot):
                raise InputError(f"{prefix}: must be a Robot, not {robot!r}")
        if len(robots) < 2:
            raise InputError(f"give two robots or more, not {len(robots)}")
        check_prefixes(robots)
        if tip is not None and tip not in robots:
            raise UnknownNameError("robot with the tip", tip, robots)
        blueprints = {prefix: robot.blueprint for prefix, robot in robots.items()}
        blueprint = Combined(document.text("name", name), blueprints, tip or next(iter(robots)))
        return cls(blueprint, blueprint.joined({prefix: robot.shared for prefix, robot in robots.items()}))

    def with_limits(self, limits: RangeByJoint) -> Robot:
        """Return the same robot with other limits [rad or m] for the joints named."""
        return type(self)(self.blueprint.with_limits(limits))

    def with_base(self, pose: PoseLike) -> Robot:
        """Return the same robot with its base, as it is now, moved by `pose` in the world."""
        blueprint = OnBase(self.blueprint, as_pose(pose, "base"))
        return type(self)(blueprint, blueprint.applied(self.shared))

    def with_attached(
        self,
        name: str,
        shape: Shape,
        link: str | None = None,
        pose: PoseLike | None = None,
        *,
        touch_links: Sequence[str] = (),
        danger: bool = False,
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

        Raises
        ------
        InputError
            If the shape is another, the link does not exist, or its name is taken.
        """
        where = self.tip if link is None else link
        return self.holding(Attachment(name, shape, where, as_pose(pose), tuple(touch_links), danger))

    def holding(self, item: Attachment) -> Robot:
        """Return the same robot with an object in its gripper, as `with_attached` describes it."""
        blueprint = Attached(self.blueprint, item)
        return type(self)(blueprint, blueprint.applied(self.shared))

    def with_accelerations(self, limits: Mapping[str, float]) -> Robot:
        """Return the same robot that knows acceleration limits of its joints [rad/s² or m/s²]; URDFs have none.

        Of joints that are not named what was known before stays. Raises InputError if a limit is absurd,
        UnknownNameError if it plans with no joint of such a name.
        """
        for name, limit in limits.items():
            if name not in self.joint_names:
                raise UnknownNameError("joint", name, self.joint_names, "accelerations")
            number(f"acceleration limit of joint {name!r}", limit, **RATE_BOUNDS["acceleration"])
        chosen = {name: float(limit) for name, limit in limits.items()}
        blueprint = WithAccelerations(self.blueprint, chosen)
        return type(self)(blueprint, blueprint.applied(self.shared))

    def without_attached(self, name: str) -> Robot:
        """Return the same robot without the object called `name`; raise UnknownNameError if it holds none."""
        known = [item.name for item in self.attached]
        if name not in known:
            raise UnknownNameError("attached object", name, known)
        return type(self)(self.blueprint.without(name))

    @cached_property
    def bounds(self) -> DisplacementBounds:
        """Bounds of how far bodies and key points move when joints do."""
        return DisplacementBounds(self)

    @property
    def model(self) -> pin.Model:
        """A copy of Pinocchio's model of the joints that move, mimic joints included."""
        model: pin.Model = self._model_copy.get()
        return model

    @property
    def collision_model(self) -> pin.GeometryModel:
        """A copy of the bodies of the links, with the pairs of them that are checked against each other."""
        bodies: pin.GeometryModel = self._bodies_copy.get()
        return bodies

    @cached_property
    def visual_model(self) -> pin.GeometryModel:
        """A copy of the visual geometry; of the collision bodies where the visual meshes are missing."""
        return self.shared.read_visual() or independent(self.shared.collision_model)

    @cached_property
    def _model_copy(self) -> GuardedCopy:
        return GuardedCopy(self.shared.model, pin.Model.copy, f"{self.name}: model")

    @cached_property
    def _bodies_copy(self) -> GuardedCopy:
        return GuardedCopy(self.shared.collision_model, independent, f"{self.name}: collision_model")

    def named(self, q: ArrayLike | str) -> dict[str, float]:
        """Return `q: (n,)`, or the state of the SRDF that it names, as a mapping from joint name to value [rad or m].

        A state holds what the SRDF says, for whichever joints: of several groups with that state, those of all. Raises
        InputError if there is no state of that name, or no SRDF; if `q` has the wrong shape or is not finite.
        """
        return self.blueprint.state(q) if isinstance(q, str) else super().named(q)

    def __reduce__(self) -> tuple[Any, ...]:
        return Robot, (self.blueprint,)

    def __repr__(self) -> str:
        held = f", attached={[item.name for item in self.attached]}" if self.attached else ""
        bare = self.links_without_collision
        unchecked = f", links_without_collision={list(bare)}" if bare else ""
        return f"Robot({self.name!r}, joints={list(self.joint_names)}, tip={self.tip!r}{unchecked}{held})"
