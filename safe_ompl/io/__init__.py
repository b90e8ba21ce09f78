"""Results, paths, scenes and robots as files: one versioned JSON form, and the forms of others by their endings."""

from typing import TYPE_CHECKING

from safe_ompl.doors import lazily

if TYPE_CHECKING:
    from safe_ompl.io import schema as schema
    from safe_ompl.io.files import load as load, result_to_mapping as result_to_mapping, save as save
    from safe_ompl.io.motion_files import (
        WRITABLE as WRITABLE,
        motion_content as motion_content,
        motion_of_document as motion_of_document,
        read_log as read_log,
        read_motion as read_motion,
    )
    from safe_ompl.io.motions import ACCELERATION as ACCELERATION, JointPath as JointPath, TimedMotion as TimedMotion
    from safe_ompl.io.problems import (
        RobotDocument as RobotDocument,
        SceneDocument as SceneDocument,
        built_robot as built_robot,
        built_scene as built_scene,
        carried_robot as carried_robot,
        carried_scene as carried_scene,
    )
    from safe_ompl.io.schema import marked as marked, strict_json as strict_json
    from safe_ompl.io.ticks import (
        TickLog as TickLog,
        TicksFile as TicksFile,
        check_header as check_header,
        read_ticks as read_ticks,
        ticks_header as ticks_header,
    )

__getattr__, __dir__, __all__ = lazily(__name__, __file__)
