"""Robots on Pinocchio: loading, kinematics, inverse kinematics, and how far bodies can move."""

from __future__ import annotations

from typing import TYPE_CHECKING

from safe_ompl.doors import lazily

if TYPE_CHECKING:
    from safe_ompl.robot.arm import arm_joints, default_tip, finger_joints, has_range
    from safe_ompl.robot.displacement_bounds import ConvexBodies
    from safe_ompl.robot.fingerprint import robot_hash
    from safe_ompl.robot.forward_kinematics import JointLimits
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
        solve_from_seed,
        tip_reach,
        transpose_step,
    )
    from safe_ompl.robot.joint_tables import Mimic, frame_index, plain
    from safe_ompl.robot.reach import Hull, ReachCylinder, bounding_hull
    from safe_ompl.robot.region import GoalRegion, RegionPlace
    from safe_ompl.robot.robot import Robot
    from safe_ompl.robot.spec import RobotSpec

__all__ = [
    "METRES_PER_RADIAN",
    "ConvexBodies",
    "GoalRegion",
    "Hull",
    "JointLimits",
    "Mimic",
    "Place",
    "ReachCylinder",
    "RegionPlace",
    "Robot",
    "RobotSpec",
    "StepLimits",
    "approach",
    "arm_joints",
    "bounding_hull",
    "default_tip",
    "finger_joints",
    "frame_index",
    "has_range",
    "inverse_kinematics",
    "limited_step",
    "motion_limits",
    "place_of",
    "plain",
    "pseudoinverse_step",
    "robot_hash",
    "solve_from_seed",
    "tip_reach",
    "transpose_step",
]

__getattr__, __dir__ = lazily(__name__, __file__)
