from .collision import CollisionSource as CollisionSource
from .displacement_bounds import ReachCylinder as ReachCylinder
from .forward_kinematics import START_TOLERANCE as START_TOLERANCE, JointLimits as JointLimits, plain as plain
from .ik import (
    METRES_PER_RADIAN as METRES_PER_RADIAN,
    Frames as Frames,
    StepLimits as StepLimits,
    TargetPose as TargetPose,
    Tip as Tip,
    approach as approach,
    configurations_at as configurations_at,
    inverse_kinematics as inverse_kinematics,
    limited_step as limited_step,
    motion_limits as motion_limits,
    pseudoinverse_step as pseudoinverse_step,
    target_pose as target_pose,
    tip_reach as tip_reach,
    transpose_step as transpose_step,
)
from .joints import (
    Mimic as Mimic,
    arm_joints as arm_joints,
    default_tip as default_tip,
    finger_joints as finger_joints,
    has_range as has_range,
    joints_without_range as joints_without_range,
    resting_value as resting_value,
)
from .kinematics import Coordinates as Coordinates, EdgeTable as EdgeTable, KeyPointTable as KeyPointTable
from .parts import Attachment as Attachment
from .region import GoalRegion as GoalRegion, RegionTarget as RegionTarget
from .robot import Robot as Robot, robot_hash as robot_hash
from .spec import (
    EXAMPLES as EXAMPLES,
    RobotSpec as RobotSpec,
    find_example as find_example,
    read_robot as read_robot,
    robots_folder as robots_folder,
)
from .srdf import SrdfFile as SrdfFile, disabled_links as disabled_links, srdf_text as srdf_text
from .states import (
    OwnState as OwnState,
    ScratchState as ScratchState,
    StateBridge as StateBridge,
    joint_space as joint_space,
)
from .urdf import (
    NamedPackage as NamedPackage,
    PackageDir as PackageDir,
    PackageFolders as PackageFolders,
    UrdfFile as UrdfFile,
    parsed as parsed,
    read_package_dir as read_package_dir,
)
