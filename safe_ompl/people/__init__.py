"""People as sensors see them: skeletons of key points, tracking, and where a body may soon be."""

from __future__ import annotations

from typing import TYPE_CHECKING

from safe_ompl.doors import lazily

if TYPE_CHECKING:
    from safe_ompl.people.calibration import GATE, calibrate
    from safe_ompl.people.reach import CalibratedReach, ReachSets, limb_lines
    from safe_ompl.people.skeletons import (
        HEIGHT,
        KEYPOINTS,
        PELVIS,
        Recording,
        Skeleton,
        TrackedBody,
        facing,
        find_skeleton,
        list_clips,
    )
    from safe_ompl.people.tracking import (
        ReachViolation,
        Surroundings,
        Tracker,
        who_is_where,
        who_moves,
        without_glitches,
    )

__all__ = [
    "GATE",
    "HEIGHT",
    "KEYPOINTS",
    "PELVIS",
    "CalibratedReach",
    "ReachSets",
    "ReachViolation",
    "Recording",
    "Skeleton",
    "Surroundings",
    "TrackedBody",
    "Tracker",
    "calibrate",
    "facing",
    "find_skeleton",
    "limb_lines",
    "list_clips",
    "who_is_where",
    "who_moves",
    "without_glitches",
]

__getattr__, __dir__ = lazily(__name__, __file__)
