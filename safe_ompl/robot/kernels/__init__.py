"""Compiled kinematics."""

from __future__ import annotations

from typing import TYPE_CHECKING

from safe_ompl.doors import lazily

if TYPE_CHECKING:
    from safe_ompl.robot.kernels.kinematics import descend as descend
    from safe_ompl.robot.kernels.kinematics import joint_frames as joint_frames
    from safe_ompl.robot.kernels.kinematics import lay_edge as lay_edge
    from safe_ompl.robot.kernels.kinematics import move_joints as move_joints
    from safe_ompl.robot.kernels.kinematics import move_keypoints as move_keypoints
    from safe_ompl.robot.kernels.kinematics import place_joints as place_joints
    from safe_ompl.robot.kernels.kinematics import place_keypoints as place_keypoints
    from safe_ompl.robot.kernels.kinematics import pull as pull
    from safe_ompl.robot.kernels.kinematics import pull_back_motion as pull_back_motion
    from safe_ompl.robot.kernels.kinematics import steer as steer
    from safe_ompl.robot.kernels.kinematics import way as way
    from safe_ompl.robot.kernels.kinematics import within as within

__all__, __getattr__, __dir__ = lazily(__name__, __file__)
