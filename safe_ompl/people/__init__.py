"""People as sensors see them: skeletons of key points, tracking, and where a body may soon be."""

from __future__ import annotations

from typing import TYPE_CHECKING

from safe_ompl.doors import lazily

if TYPE_CHECKING:
    from safe_ompl.people.calibration import Calibration as Calibration
    from safe_ompl.people.calibration import calibrate as calibrate
    from safe_ompl.people.reach import AccelerationReach as AccelerationReach
    from safe_ompl.people.reach import CalibratedReach as CalibratedReach
    from safe_ompl.people.reach import IntersectedReach as IntersectedReach
    from safe_ompl.people.reach import LimbLengthReach as LimbLengthReach
    from safe_ompl.people.reach import ReachModel as ReachModel
    from safe_ompl.people.reach import ReachSets as ReachSets
    from safe_ompl.people.reach import SpeedReach as SpeedReach
    from safe_ompl.people.skeletons import KEYPOINTS as KEYPOINTS
    from safe_ompl.people.skeletons import PELVIS as PELVIS
    from safe_ompl.people.skeletons import Recording as Recording
    from safe_ompl.people.skeletons import Skeleton as Skeleton
    from safe_ompl.people.skeletons import TrackedBody as TrackedBody
    from safe_ompl.people.skeletons import facing as facing
    from safe_ompl.people.skeletons import find_skeleton as find_skeleton
    from safe_ompl.people.skeletons import list_clips as list_clips
    from safe_ompl.people.skeletons import skeleton_of as skeleton_of
    from safe_ompl.people.tracking import ReachViolation as ReachViolation
    from safe_ompl.people.tracking import Surroundings as Surroundings
    from safe_ompl.people.tracking import Tracker as Tracker
    from safe_ompl.people.tracking import who_is_where as who_is_where
    from safe_ompl.people.tracking import who_moves as who_moves
    from safe_ompl.people.tracking import without_glitches as without_glitches

__all__, __getattr__, __dir__ = lazily(__name__, __file__)
