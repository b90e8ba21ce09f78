"""Compiled kinematics."""

from __future__ import annotations

from typing import TYPE_CHECKING

from safe_ompl.doors import lazily

if TYPE_CHECKING:
    from safe_ompl.robot.kernels.kinematics import (
        descend,
        joint_frames,
        lay_edge,
        move_joints,
        move_keypoints,
        place_joints,
        place_keypoints,
        pull,
        pull_back_motion,
        steer,
        way,
        within,
    )

__all__ = [
    "descend",
    "joint_frames",
    "lay_edge",
    "move_joints",
    "move_keypoints",
    "place_joints",
    "place_keypoints",
    "pull",
    "pull_back_motion",
    "steer",
    "way",
    "within",
]

__getattr__, __dir__ = lazily(__name__, __file__)
