from . import schema as schema
from .files import load as load, result_to_mapping as result_to_mapping, save as save
from .motion_files import (
    WRITABLE as WRITABLE,
    motion_content as motion_content,
    motion_of_document as motion_of_document,
    plain_message as plain_message,
    read_log as read_log,
    read_motion as read_motion,
)
from .motions import ACCELERATION as ACCELERATION, MotionRecord as MotionRecord
from .problems import (
    EmbeddedProblem as EmbeddedProblem,
    RobotDocument as RobotDocument,
    SceneDocument as SceneDocument,
    built_robot as built_robot,
    built_scene as built_scene,
    embedded_robot as embedded_robot,
    embedded_scene as embedded_scene,
)
from .schema import strict_json as strict_json, with_header as with_header
from .ticks import (
    TickLog as TickLog,
    TicksFile as TicksFile,
    check_header as check_header,
    read_ticks as read_ticks,
    ticks_header as ticks_header,
)
