"""Robots on Pinocchio: loading, kinematics, inverse kinematics, and how far bodies can move."""

from typing import TYPE_CHECKING

from safe_ompl.doors import lazily

if TYPE_CHECKING:
    from safe_ompl.robot.collision import CollisionSource as CollisionSource
    from safe_ompl.robot.displacement_bounds import ReachCylinder as ReachCylinder
    from safe_ompl.robot.forward_kinematics import JointLimits as JointLimits, plain as plain
    from safe_ompl.robot.ik import (
        METRES_PER_RADIAN as METRES_PER_RADIAN,
        Place as Place,
        StepLimits as StepLimits,
        approach as approach,
        inverse_kinematics as inverse_kinematics,
        limited_step as limited_step,
        motion_limits as motion_limits,
        place_of as place_of,
        pseudoinverse_step as pseudoinverse_step,
        tip_reach as tip_reach,
        transpose_step as transpose_step,
    )
    from safe_ompl.robot.joints import (
        Mimic as Mimic,
        arm_joints as arm_joints,
        default_tip as default_tip,
        finger_joints as finger_joints,
        has_range as has_range,
        joints_without_range as joints_without_range,
        resting_value as resting_value,
    )
    from safe_ompl.robot.parts import Attachment as Attachment
    from safe_ompl.robot.region import GoalRegion as GoalRegion, RegionPlace as RegionPlace
    from safe_ompl.robot.robot import Robot as Robot, robot_hash as robot_hash
    from safe_ompl.robot.spec import (
        EXAMPLES as EXAMPLES,
        RobotSpec as RobotSpec,
        find_example as find_example,
        read_robot as read_robot,
        robots_folder as robots_folder,
    )
    from safe_ompl.robot.srdf import SrdfFile as SrdfFile, disabled_links as disabled_links, srdf_text as srdf_text
    from safe_ompl.robot.states import (
        ScratchState as ScratchState,
        StateBridge as StateBridge,
        joint_space as joint_space,
    )
    from safe_ompl.robot.urdf import PackageFolders as PackageFolders, UrdfFile as UrdfFile, parsed as parsed

__getattr__, __dir__, __all__ = lazily(__name__, __file__)
