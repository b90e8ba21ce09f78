"""People as sensors see them: skeletons of key points, tracking, and where a body may soon be."""

from typing import TYPE_CHECKING

from safe_ompl.doors import lazily

if TYPE_CHECKING:
    from safe_ompl.live.reach import ReachSets as ReachSets, ReachViolation as ReachViolation
    from safe_ompl.live.skeletons import (
        HEIGHT as HEIGHT,
        KEYPOINTS as KEYPOINTS,
        PELVIS as PELVIS,
        Recording as Recording,
        Skeleton as Skeleton,
        TrackedBody as TrackedBody,
        facing as facing,
        find_skeleton as find_skeleton,
        list_clips as list_clips,
    )
    from safe_ompl.live.tracking import Surroundings as Surroundings, Tracker as Tracker, who_is_where as who_is_where

__getattr__, __dir__, __all__ = lazily(__name__, __file__)
