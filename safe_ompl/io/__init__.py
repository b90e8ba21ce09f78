"""Results, paths, scenes and robots as files: one versioned JSON form, and the forms of others by their endings."""

from __future__ import annotations

from typing import TYPE_CHECKING

from safe_ompl.doors import lazily

if TYPE_CHECKING:
    from safe_ompl.io import schema
    from safe_ompl.io.files import load, result_to_mapping, save
    from safe_ompl.io.motion_files import WRITABLE, motion_content, motion_of_document, read_log, read_motion
    from safe_ompl.io.motions import ACCELERATION, JointPath, TimedMotion
    from safe_ompl.io.problems import (
        RobotDocument,
        SceneDocument,
        built_robot,
        built_scene,
        carried_robot,
        carried_scene,
        links_without_collision,
    )
    from safe_ompl.io.schema import marked, strict_json
    from safe_ompl.io.ticks import TickLog, TicksFile, check_header, read_ticks, ticks_header

__all__ = [
    "ACCELERATION",
    "WRITABLE",
    "JointPath",
    "RobotDocument",
    "SceneDocument",
    "TickLog",
    "TicksFile",
    "TimedMotion",
    "built_robot",
    "built_scene",
    "carried_robot",
    "carried_scene",
    "check_header",
    "links_without_collision",
    "load",
    "marked",
    "motion_content",
    "motion_of_document",
    "read_log",
    "read_motion",
    "read_ticks",
    "result_to_mapping",
    "save",
    "schema",
    "strict_json",
    "ticks_header",
]

__getattr__, __dir__ = lazily(__name__, __file__)
