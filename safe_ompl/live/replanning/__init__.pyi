from .bounded_path import SpeedLimits as SpeedLimits
from .commands import (
    Action as Action,
    Command as Command,
    ReplanningOptions as ReplanningOptions,
    stop_as_dict as stop_as_dict,
)
from .replanner import Replanner as Replanner, Route as Route, Segment as Segment, SegmentSequence as SegmentSequence
from .shield import Shield as Shield, ShieldCommand as ShieldCommand
