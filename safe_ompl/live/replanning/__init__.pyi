from .guard import (
    Command as Command,
    Doing as Doing,
    Guard as Guard,
    ReplanningOptions as ReplanningOptions,
    stop_as_dict as stop_as_dict,
)
from .guarded_path import PathLimits as PathLimits
from .replanner import Leg as Leg, Legs as Legs, Replanner as Replanner, Tour as Tour
from .shield import Shield as Shield, ShieldCommand as ShieldCommand
