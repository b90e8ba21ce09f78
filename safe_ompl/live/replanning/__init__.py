"""Replanning beside people who move: what is driven is proven at every tick."""

from typing import TYPE_CHECKING

from safe_ompl.doors import lazily

if TYPE_CHECKING:
    from safe_ompl.live.replanning.guard import (
        Command as Command,
        Doing as Doing,
        Guard as Guard,
        ReplanningOptions as ReplanningOptions,
        stop_as_dict as stop_as_dict,
    )
    from safe_ompl.live.replanning.guarded_path import PathLimits as PathLimits
    from safe_ompl.live.replanning.replanner import Leg as Leg, Legs as Legs, Replanner as Replanner, Tour as Tour
    from safe_ompl.live.replanning.shield import Shield as Shield, ShieldCommand as ShieldCommand

__getattr__, __dir__, __all__ = lazily(__name__, __file__)
