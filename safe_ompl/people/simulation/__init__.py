"""Simulated people, robots and their contacts, to test what is driven beside people."""

from __future__ import annotations

from typing import TYPE_CHECKING

from safe_ompl.doors import lazily

if TYPE_CHECKING:
    from safe_ompl.people.simulation.movers import ALL_KEYPOINTS as ALL_KEYPOINTS
    from safe_ompl.people.simulation.movers import Drifting as Drifting
    from safe_ompl.people.simulation.movers import ObjectMover as ObjectMover
    from safe_ompl.people.simulation.movers import PersonMover as PersonMover
    from safe_ompl.people.simulation.movers import Playback as Playback
    from safe_ompl.people.simulation.movers import Resting as Resting
    from safe_ompl.people.simulation.movers import Solid as Solid
    from safe_ompl.people.simulation.movers import Walker as Walker
    from safe_ompl.people.simulation.movers import World as World
    from safe_ompl.people.simulation.movers import limb_solids as limb_solids
    from safe_ompl.people.simulation.movers import part_solids as part_solids
    from safe_ompl.people.simulation.simulation import Contact as Contact
    from safe_ompl.people.simulation.simulation import ContactMonitor as ContactMonitor
    from safe_ompl.people.simulation.simulation import Faults as Faults
    from safe_ompl.people.simulation.simulation import Nearest as Nearest
    from safe_ompl.people.simulation.simulation import Simulation as Simulation
    from safe_ompl.people.simulation.simulation import Summary as Summary

__all__, __getattr__, __dir__ = lazily(__name__, __file__)
