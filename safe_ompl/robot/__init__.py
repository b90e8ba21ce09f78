"""Robots on Pinocchio: loading, kinematics, inverse kinematics, and how far bodies can move."""

from __future__ import annotations

from typing import TYPE_CHECKING

from safe_ompl.doors import lazily

if TYPE_CHECKING:
    from safe_ompl.robot.arm import arm_joints as arm_joints
    from safe_ompl.robot.arm import default_tip as default_tip
    from safe_ompl.robot.arm import finger_joints as finger_joints
    from safe_ompl.robot.arm import has_range as has_range
    from safe_ompl.robot.displacement_bounds import ConvexBodies as ConvexBodies
    from safe_ompl.robot.fingerprint import robot_hash as robot_hash
    from safe_ompl.robot.forward_kinematics import JointLimits as JointLimits
    from safe_ompl.robot.ik import METRES_PER_RADIAN as METRES_PER_RADIAN
    from safe_ompl.robot.ik import Place as Place
    from safe_ompl.robot.ik import StepLimits as StepLimits
    from safe_ompl.robot.ik import approach as approach
    from safe_ompl.robot.ik import inverse_kinematics as inverse_kinematics
    from safe_ompl.robot.ik import limited_step as limited_step
    from safe_ompl.robot.ik import motion_limits as motion_limits
    from safe_ompl.robot.ik import place_of as place_of
    from safe_ompl.robot.ik import pseudoinverse_step as pseudoinverse_step
    from safe_ompl.robot.ik import solve_from_seed as solve_from_seed
    from safe_ompl.robot.ik import tip_reach as tip_reach
    from safe_ompl.robot.ik import transpose_step as transpose_step
    from safe_ompl.robot.joint_tables import Mimic as Mimic
    from safe_ompl.robot.joint_tables import frame_index as frame_index
    from safe_ompl.robot.joint_tables import plain as plain
    from safe_ompl.robot.reach import Hull as Hull
    from safe_ompl.robot.reach import ReachCylinder as ReachCylinder
    from safe_ompl.robot.reach import bounding_hull as bounding_hull
    from safe_ompl.robot.region import GoalRegion as GoalRegion
    from safe_ompl.robot.region import RegionPlace as RegionPlace
    from safe_ompl.robot.robot import Robot as Robot
    from safe_ompl.robot.spec import RobotSpec as RobotSpec

__all__, __getattr__, __dir__ = lazily(__name__, __file__)
