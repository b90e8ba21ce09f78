"""Variants of a robot: with other limits, on another base, with objects in its gripper."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TypeVar

from safe_ompl.errors import UnknownNameError
from safe_ompl.inputs import number
from safe_ompl.robot.construction.attachment import Attachment, as_pose
from safe_ompl.robot.construction.blueprint import (
    Attached,
    Blueprint,
    OnBase,
    PoseLike,
    RangeByJoint,
    WithAccelerations,
)
from safe_ompl.robot.construction.parts import RobotParts
from safe_ompl.robot.pinocchio_models import PinocchioModels
from safe_ompl.scene.shapes.basic import Shape

_Robot = TypeVar("_Robot", bound="Varied")


class Varied(PinocchioModels):
    """A robot that was built from a blueprint, and makes variants of itself; it never changes.

    Parameters
    ----------
    blueprint : Blueprint
        How to build the robot, in this process or another.
    parts : RobotParts, optional
        What the blueprint builds, where that is known.
    """

    def __init__(self, blueprint: Blueprint, parts: RobotParts | None = None) -> None:
        self.blueprint = blueprint
        super().__init__(blueprint.assemble() if parts is None else parts)
        self.held_joints = dict(self.shared.held)
        self.links_without_collision = self.shared.links_without_collision

    def with_limits(self: _Robot, limits: RangeByJoint) -> _Robot:
        """Return the same robot with other limits [rad or m] for the joints named."""
        return type(self)(self.blueprint.with_limits(limits))

    def with_base(self: _Robot, pose: PoseLike) -> _Robot:
        """Return the same robot with its base, as it is now, moved by `pose` in the world."""
        blueprint = OnBase(self.blueprint, as_pose(pose, "base"))
        return type(self)(blueprint, blueprint.applied(self.shared))

    def with_attached(
        self: _Robot,
        name: str,
        shape: Shape,
        link: str | None = None,
        pose: PoseLike | None = None,
        *,
        touch_links: Sequence[str] = (),
        danger: bool = False,
    ) -> _Robot:
        """Return the same robot with an object in its gripper: checked against the scene and against the robot.

        Parameters
        ----------
        name : str
            Name of the object, for reports.
        shape : Shape
            Box, Sphere, Cylinder, Capsule or Mesh of `safe_ompl.scene.shapes`.
        link : str, optional
            Link or frame that it is fixed to; default: the tip.
        pose : Pose, pin.SE3, mapping or position, optional
            Where it is in the frame of the link; default: at its origin.
        touch_links : sequence of str
            Links that it may touch, such as moving fingers. Those that do not move against `link` it always may.
        danger : bool
            Make the object a link of the skeleton, so that it is dangerous like the arm.

        Raises
        ------
        InputError, UnknownNameError
            If the shape is another, the link does not exist, or its name is taken.
        """
        where = self.tip if link is None else link
        return self.holding(Attachment(name, shape, where, as_pose(pose), tuple(touch_links), danger))

    def holding(self: _Robot, item: Attachment) -> _Robot:
        """Return the same robot with an object in its gripper, as `with_attached` describes it."""
        blueprint = Attached(self.blueprint, item)
        return type(self)(blueprint, blueprint.applied(self.shared))

    def with_accelerations(self: _Robot, limits: Mapping[str, float]) -> _Robot:
        """Return the same robot that knows acceleration limits of its joints; URDFs have none.

        Parameters
        ----------
        limits : mapping of str to float
            By joint [rad/s² or m/s²]; of joints that are not named what was known before stays.

        Raises
        ------
        UnknownNameError
            If it plans with no joint of such a name.
        InputError
            If a limit is not positive.
        """
        for name, limit in limits.items():
            if name not in self.joint_names:
                raise UnknownNameError("joint", name, self.joint_names, "accelerations")
            number(f"acceleration limit of joint {name!r}", limit, above=0.0)
        chosen = {name: float(limit) for name, limit in limits.items()}
        return type(self)(WithAccelerations(self.blueprint, chosen), self.shared)

    @property
    def accelerations(self) -> dict[str, float]:
        """Acceleration limits that are known, by joint [rad/s² or m/s²]; see `with_accelerations`."""
        return self.blueprint.accelerations()

    def without_attached(self: _Robot, name: str) -> _Robot:
        """Return the same robot without the object called `name`; raise UnknownNameError if it holds none."""
        return type(self)(self.blueprint.without(name))

    @property
    def attached(self) -> tuple[Attachment, ...]:
        """The objects that it holds."""
        return self.blueprint.attached()
