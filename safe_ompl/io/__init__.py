"""Results, paths, scenes and robots as files: one versioned JSON form, and CSV."""

from __future__ import annotations

from typing import TYPE_CHECKING

from safe_ompl.doors import lazily

if TYPE_CHECKING:
    from safe_ompl.io.files import load, marked, read_json, result_to_mapping, save, strict_json
    from safe_ompl.io.motion_files import read_motion
    from safe_ompl.io.motions import ACCELERATION, JointPath, TimedMotion
    from safe_ompl.io.problems import unpacked_robot
    from safe_ompl.io.robot_document import RobotDocument, built_robot, carried_robot, links_without_collision
    from safe_ompl.io.scene_document import SceneDocument, built_scene, carried_scene
    from safe_ompl.io.schema import (
        FORMAT,
        OBSTACLE,
        VERSION,
        array,
        as_plain,
        by_name,
        check_form,
        digest,
        edges_of,
        key,
        number,
        one_of,
        or_none,
        parse,
        plain,
        record,
        sha,
        some,
        text,
        whole,
    )
    from safe_ompl.io.ticks import read_ticks, ticks_header, write_ticks

__all__ = [
    "ACCELERATION",
    "FORMAT",
    "OBSTACLE",
    "VERSION",
    "JointPath",
    "RobotDocument",
    "SceneDocument",
    "TimedMotion",
    "array",
    "as_plain",
    "built_robot",
    "built_scene",
    "by_name",
    "carried_robot",
    "carried_scene",
    "check_form",
    "digest",
    "edges_of",
    "key",
    "links_without_collision",
    "load",
    "marked",
    "number",
    "one_of",
    "or_none",
    "parse",
    "plain",
    "read_json",
    "read_motion",
    "read_ticks",
    "record",
    "result_to_mapping",
    "save",
    "sha",
    "some",
    "strict_json",
    "text",
    "ticks_header",
    "unpacked_robot",
    "whole",
    "write_ticks",
]

__getattr__, __dir__ = lazily(__name__, __file__)
