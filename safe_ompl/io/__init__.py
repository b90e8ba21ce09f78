"""Results, paths, scenes and robots as files: one versioned JSON form, and CSV."""

from __future__ import annotations

from typing import TYPE_CHECKING

from safe_ompl.doors import lazily

if TYPE_CHECKING:
    from safe_ompl.io import schema as schema
    from safe_ompl.io.files import load as load
    from safe_ompl.io.files import marked as marked
    from safe_ompl.io.files import read_json as read_json
    from safe_ompl.io.files import result_to_mapping as result_to_mapping
    from safe_ompl.io.files import save as save
    from safe_ompl.io.files import strict_json as strict_json
    from safe_ompl.io.motion_files import WRITABLE as WRITABLE
    from safe_ompl.io.motion_files import motion_of_document as motion_of_document
    from safe_ompl.io.motion_files import motion_text as motion_text
    from safe_ompl.io.motion_files import read_log as read_log
    from safe_ompl.io.motion_files import read_motion as read_motion
    from safe_ompl.io.motions import ACCELERATION as ACCELERATION
    from safe_ompl.io.motions import JointPath as JointPath
    from safe_ompl.io.motions import TimedMotion as TimedMotion
    from safe_ompl.io.problems import SceneDocument as SceneDocument
    from safe_ompl.io.problems import built_scene as built_scene
    from safe_ompl.io.problems import carried_scene as carried_scene
    from safe_ompl.io.problems import unpacked_robot as unpacked_robot
    from safe_ompl.io.robot_document import RobotDocument as RobotDocument
    from safe_ompl.io.robot_document import built_robot as built_robot
    from safe_ompl.io.robot_document import carried_robot as carried_robot
    from safe_ompl.io.robot_document import links_without_collision as links_without_collision
    from safe_ompl.io.ticks import TickLog as TickLog
    from safe_ompl.io.ticks import TicksFile as TicksFile
    from safe_ompl.io.ticks import check_header as check_header
    from safe_ompl.io.ticks import read_ticks as read_ticks
    from safe_ompl.io.ticks import ticks_header as ticks_header

__all__, __getattr__, __dir__ = lazily(__name__, __file__)
