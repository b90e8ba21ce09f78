from .reach import ReachSets as ReachSets, ReachViolation as ReachViolation
from .skeletons import (
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
from .tracking import Surroundings as Surroundings, Tracker as Tracker, who_is_where as who_is_where
