from .movers import (
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
from .simulation import (
    Contact as Contact,
    ContactMonitor as ContactMonitor,
    Faults as Faults,
    NearestLimb as NearestLimb,
    ProgramSimulation as ProgramSimulation,
    Simulation as Simulation,
    SimulationSummary as SimulationSummary,
)
