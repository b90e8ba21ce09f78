"""Checks and facts of the planner that a setup is given, ours or OMPL's."""

from __future__ import annotations

from typing import Any

from ompl import base as ob
from ompl import geometric as og
from ompl import util as ou

from safe_ompl.common import InputError
from safe_ompl.planning.planners import SafePlanner, check_usable


def check_planner(planner: Any, si: Any) -> None:
    """Raise an error if this is neither a name nor a planner on a space information, or one that cannot be used."""
    if isinstance(planner, str):
        return
    if isinstance(planner, type) and issubclass(planner, ob.Planner):
        raise InputError(
            f"{planner.__name__} is a class: give a planner, {planner.__name__}(setup.getSpaceInformation())"
        )
    if not isinstance(planner, ob.Planner):
        raise InputError(f"planner must be a name of planner_names() or an ob.Planner, got {planner!r}")
    if planner.getSpaceInformation() is not si:
        raise InputError(
            f"{planner.getName()} is a planner of another setup: make it with this one's getSpaceInformation()"
        )
    check_usable(planner)


def seed_ompl(seed: int) -> None:
    """Seed OMPL's C++ planners, quietly: it complains of a second seed, though planners built later do follow it."""
    handler = ou.getOutputHandler()
    ou.noOutputHandler()
    ou.RNG.setSeed(seed + 1)  # zero would mean "by the clock"
    if handler is not None:
        ou.useOutputHandler(handler)


def nodes_of(planner: Any) -> int:
    """Return how many nodes a planner kept."""
    if isinstance(planner, SafePlanner):
        return planner.counts.nodes
    if isinstance(
        planner, og.BITstar
    ):  # reading its graph leaks it, and with it the robot: count its samples
        return int(planner.numBatches() * planner.getSamplesPerBatch())
    data = ob.PlannerData(planner.getSpaceInformation())
    planner.getPlannerData(data)
    return int(data.numVertices())


def planner_data(planner: Any) -> Any:
    """Return what a planner has built, as an `ob.PlannerData`: of our planners, of OMPL's, and outside `SafeSetup`.

    OMPL's bindings let no planner in Python answer `getPlannerData`: under a plain `og.SimpleSetup` that stays empty.
    """
    data = ob.PlannerData(planner.getSpaceInformation())
    fill = getattr(planner, "fillPlannerData", None) or planner.getPlannerData
    fill(data)
    return data
