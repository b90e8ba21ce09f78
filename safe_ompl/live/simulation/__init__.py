"""Simulated people, robots and their contacts, to test what is driven beside people."""

from typing import TYPE_CHECKING

from safe_ompl.doors import lazily

if TYPE_CHECKING:
    from safe_ompl.live.simulation.movers import (
        ALL_KEYPOINTS as ALL_KEYPOINTS,
        Drifting as Drifting,
        PersonMover as PersonMover,
        Playback as Playback,
        Solid as Solid,
        Walker as Walker,
        World as World,
        limb_solids as limb_solids,
        part_solids as part_solids,
    )
    from safe_ompl.live.simulation.simulation import (
        Contact as Contact,
        ContactMonitor as ContactMonitor,
        Faults as Faults,
        NearestLimb as NearestLimb,
        ProgramSimulation as ProgramSimulation,
        Simulation as Simulation,
        SimulationSummary as SimulationSummary,
    )

__getattr__, __dir__, __all__ = lazily(__name__, __file__)
