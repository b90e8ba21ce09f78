"""Simulations beside people who move: the world, the contact monitor, and what came of it."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from safe_ompl.people.simulation.contact_monitor import Contact, ContactMonitor, Solid, limb_solids
    from safe_ompl.people.simulation.movers import (
        Drifting,
        ObjectMover,
        PersonMover,
        Playback,
        Resting,
        World,
    )
    from safe_ompl.people.simulation.simulation import Faults, Simulation, Summary
    from safe_ompl.people.simulation.walkers import ALL_KEYPOINTS, Walker

_MODULES = {
    "ALL_KEYPOINTS": "walkers",
    "Contact": "contact_monitor",
    "ContactMonitor": "contact_monitor",
    "Drifting": "movers",
    "Faults": "simulation",
    "ObjectMover": "movers",
    "PersonMover": "movers",
    "Playback": "movers",
    "Resting": "movers",
    "Simulation": "simulation",
    "Solid": "contact_monitor",
    "Summary": "simulation",
    "Walker": "walkers",
    "World": "movers",
    "limb_solids": "contact_monitor",
}

__all__ = [
    "ALL_KEYPOINTS",
    "Contact",
    "ContactMonitor",
    "Drifting",
    "Faults",
    "ObjectMover",
    "PersonMover",
    "Playback",
    "Resting",
    "Simulation",
    "Solid",
    "Summary",
    "Walker",
    "World",
    "limb_solids",
]


def __getattr__(name: str) -> object:
    """Import a public name when it is first asked for, and keep it."""
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    found: object = getattr(import_module(f"{__name__}.{_MODULES[name]}"), name)
    globals()[name] = found
    return found
