"""People as sensors see them: skeletons of key points, tracked bodies, and where they may soon be."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from safe_ompl.people.body import PELVIS, TrackedBody, facing
    from safe_ompl.people.reach import (
        AccelerationReach,
        IntersectedReach,
        LimbLengthReach,
        ReachModel,
        ReachSets,
        SpeedReach,
    )
    from safe_ompl.people.recordings import Recording, list_clips
    from safe_ompl.people.skeletons import Skeleton, find_skeleton
    from safe_ompl.people.tracking import Surroundings, Tracker, Violation

_MODULES = {
    "AccelerationReach": "reach",
    "IntersectedReach": "reach",
    "LimbLengthReach": "reach",
    "PELVIS": "body",
    "ReachModel": "reach",
    "ReachSets": "reach",
    "Recording": "recordings",
    "Skeleton": "skeletons",
    "SpeedReach": "reach",
    "Surroundings": "tracking",
    "TrackedBody": "body",
    "Tracker": "tracking",
    "Violation": "tracking",
    "facing": "body",
    "find_skeleton": "skeletons",
    "list_clips": "recordings",
}

__all__ = [
    "PELVIS",
    "AccelerationReach",
    "IntersectedReach",
    "LimbLengthReach",
    "ReachModel",
    "ReachSets",
    "Recording",
    "Skeleton",
    "SpeedReach",
    "Surroundings",
    "TrackedBody",
    "Tracker",
    "Violation",
    "facing",
    "find_skeleton",
    "list_clips",
]


def __getattr__(name: str) -> object:
    """Import a public name when it is first asked for, and keep it."""
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    found: object = getattr(import_module(f"{__name__}.{_MODULES[name]}"), name)
    globals()[name] = found
    return found
