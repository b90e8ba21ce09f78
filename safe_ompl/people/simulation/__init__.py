"""Simulated people, robots and their contacts, to test what is driven beside people."""

from __future__ import annotations

from typing import TYPE_CHECKING

from safe_ompl.doors import lazily

if TYPE_CHECKING:
    from safe_ompl.people.simulation.movers import (
        ALL_KEYPOINTS,
        Drifting,
        PersonMover,
        Playback,
        Solid,
        Walker,
        World,
        limb_solids,
        part_solids,
    )
    from safe_ompl.people.simulation.program import Leg, ProgramSimulation
    from safe_ompl.people.simulation.simulation import Contact, ContactMonitor, Faults, Nearest, Simulation, Summary

__all__ = [
    "ALL_KEYPOINTS",
    "Contact",
    "ContactMonitor",
    "Drifting",
    "Faults",
    "Leg",
    "Nearest",
    "PersonMover",
    "Playback",
    "ProgramSimulation",
    "Simulation",
    "Solid",
    "Summary",
    "Walker",
    "World",
    "limb_solids",
    "part_solids",
]

__getattr__, __dir__ = lazily(__name__, __file__)
