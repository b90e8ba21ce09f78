"""Robots on Pinocchio: loading, kinematics, inverse kinematics, and how far bodies can move."""

from __future__ import annotations

from typing import TYPE_CHECKING

from safe_ompl.doors import lazily

if TYPE_CHECKING:
    from safe_ompl.robot.collision import CollisionSource
    from safe_ompl.robot.displacement_bounds import ReachCylinder
    from safe_ompl.robot.forward_kinematics import JointLimits, plain
    from safe_ompl.robot.ik import (
        METRES_PER_RADIAN,
        Place,
        StepLimits,
        approach,
        inverse_kinematics,
        limited_step,
        motion_limits,
        place_of,
        pseudoinverse_step,
        tip_reach,
        transpose_step,
    )
    from safe_ompl.robot.joints import (
        Mimic,
        arm_joints,
        default_tip,
        finger_joints,
        has_range,
        joints_without_range,
        resting_value,
    )
    from safe_ompl.robot.parts import Attachment
    from safe_ompl.robot.region import GoalRegion, RegionPlace
    from safe_ompl.robot.robot import Robot, robot_hash
    from safe_ompl.robot.spec import EXAMPLES, RobotSpec, find_example, robots_folder
    from safe_ompl.robot.srdf import SrdfFile, disabled_links, srdf_text
    from safe_ompl.robot.urdf import PackageFolders, UrdfFile, parsed

__all__ = [
    "EXAMPLES",
    "METRES_PER_RADIAN",
    "Attachment",
    "CollisionSource",
    "GoalRegion",
    "JointLimits",
    "Mimic",
    "PackageFolders",
    "Place",
    "ReachCylinder",
    "RegionPlace",
    "Robot",
    "RobotSpec",
    "SrdfFile",
    "StepLimits",
    "UrdfFile",
    "approach",
    "arm_joints",
    "default_tip",
    "disabled_links",
    "find_example",
    "finger_joints",
    "has_range",
    "inverse_kinematics",
    "joints_without_range",
    "limited_step",
    "motion_limits",
    "parsed",
    "place_of",
    "plain",
    "pseudoinverse_step",
    "resting_value",
    "robot_hash",
    "robots_folder",
    "srdf_text",
    "tip_reach",
    "transpose_step",
]

__getattr__, __dir__ = lazily(__name__, __file__)
