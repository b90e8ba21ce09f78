"""The planners by name: planners of this package, their classical counterparts, and planners of OMPL."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from functools import cache
from pkgutil import resolve_name
from time import perf_counter
from typing import Any

import numpy as np
from ompl import base as ob, geometric as og, util as ou

from safe_ompl.common import InputError, UnknownNameError
from safe_ompl.planning.ompl import WorkspaceGoal
from safe_ompl.planning.planners.base import SafePlanner, camel_case

_OURS: dict[str, tuple[str, dict[str, Any]]] = {
    "SafeRRTConnect": ("rrt_connect:SafeRRTConnect", {}),
    "ClassicRRTConnect": ("rrt_connect:SafeRRTConnect", {"alpha": 0.0}),
    "SafePRM": ("prm:SafePRM", {}),
    "ClassicPRM": ("prm:SafePRM", {"alpha": 0.0}),
    "SafeJTRRT": ("jt_rrt:SafeJTRRT", {}),
    "ClassicJTRRT": ("jt_rrt:SafeJTRRT", {"alpha": 0.0, "transpose": True}),
    "BubblePlanner": ("bubble:BubblePlanner", {}),
    "ClassicBubble": ("bubble:BubblePlanner", {"alpha": 0.0}),
}

_AS_PRINTED: dict[str, tuple[str, dict[str, Any]]] = {
    "PaperSafeRRTConnect": ("printed:PaperSafeRRTConnect", {}),
    "PaperRRTConnect": ("printed:PaperSafeRRTConnect", {"alpha": 0.0}),
    "PaperSafePRM": ("printed:PaperSafePRM", {}),
    "PaperPRM": ("printed:PaperSafePRM", {"alpha": 0.0}),
    "PaperSafeJTRRT": ("printed:PaperSafeJTRRT", {"transpose": False}),
    "PaperJTRRT": ("printed:PaperSafeJTRRT", {"alpha": 0.0, "transpose": True}),
    "PaperSafeBubble": ("printed:PaperSafeBubble", {}),
    "PaperBubble": ("printed:PaperSafeBubble", {"alpha": 0.0}),
}

_PYTHON = {**_OURS, **_AS_PRINTED}

# Planners of OMPL's Python wheel that run safely with callbacks in Python.
_OMPL = ("RRTConnect", "RRT", "RRTstar", "InformedRRTstar", "SORRTstar", "BITstar", "KPIECE1", "BKPIECE1", "LBKPIECE1")

_REFUSED = {
    "PRM": "it deadlocks if the objective or the termination condition is written in Python; use SafePRM",
    "PRMstar": "it deadlocks if the objective or the termination condition is written in Python; use SafePRM",
    "FMT": "it computes all costs of its graph before it checks the time: 9 s for a limit of 4 s; use BITstar",
    "BFMT": "it does not check the time if costs are computed in Python: 45 s for a limit of 4 s; use BITstar",
    "AORRTC": "it ignores the objective and ends the process when it is cleared; use BITstar",
}


def planner_names() -> list[str]:
    """Return the names for `make_planner`: this package's planners, the paper's as printed, then OMPL's planners."""
    return [*_OURS, *_AS_PRINTED, *_OMPL]


def is_ours(name: str) -> bool:
    """Return whether `name` is a planner of this package, other than the paper's planners as printed."""
    return name in _OURS


def needs_place(name: str) -> bool:
    """Return whether the planner `name` plans to a `WorkspaceGoal` only."""
    return name in _PYTHON and issubclass(_kind(name).plans_to, WorkspaceGoal)


@cache
def _kind(name: str) -> type[SafePlanner]:
    """Import and return the class of a planner of this package."""
    kind: type[SafePlanner] = resolve_name(f"{__package__}.{_PYTHON[name][0]}")
    return kind


def accepts(planner: Any, goal: Any) -> bool:
    """Return whether a planner can plan to a goal; True for all planners of OMPL, which do not say."""
    return planner.accepts(goal) if isinstance(planner, SafePlanner) else True


def make_planner(name: str, si: Any, parameters: Mapping[str, Any] | None = None) -> Any:
    """Return a new planner for a space information by its name, one of `planner_names()`.

    `parameters` maps names to values: {"alpha": 1} calls `setAlpha(1)`. Raises UnknownNameError if there is no such
    planner or parameter, and InputError if a value is invalid or fixed for this planner (α of classical planners), or
    if a seed is given, because the seed belongs to the run.
    """
    given = dict(parameters or {})
    if name in _PYTHON:
        planner, fixed = _kind(name)(si, name), _PYTHON[name][1]
        _refuse_others(name, given, fixed)
        for key, value in {**fixed, **given}.items():
            planner.setParameter(key, value)
    elif name in _OMPL:
        planner = getattr(og, name)(si)
        _refuse_others(name, given, {})
        for key, value in given.items():
            _set_ompls(planner, key, value)
    elif name in _REFUSED:
        raise _refused(name)
    else:
        raise UnknownNameError("planner", name, planner_names())
    return planner


def check_usable(planner: Any) -> None:
    """Raise InputError for planners of OMPL that hang, crash, or ignore time limits if called from Python."""
    for kind in type(planner).__mro__:
        if kind.__name__ in _REFUSED and kind is getattr(og, kind.__name__, None):
            raise _refused(kind.__name__)


def check_planner(planner: Any, si: Any) -> None:
    """Raise InputError unless `planner` is a name, a function, or a usable planner of the space information."""
    if isinstance(planner, str) or (callable(planner) and not isinstance(planner, type)):
        return
    if isinstance(planner, type) and issubclass(planner, ob.Planner):
        raise InputError(
            f"{planner.__name__} is a class: give a planner, {planner.__name__}(setup.getSpaceInformation())"
        )
    if not isinstance(planner, ob.Planner):
        raise InputError(f"planner must be a name of planner_names(), a function or an ob.Planner, got {planner!r}")
    if planner.getSpaceInformation() is not si:
        raise InputError(
            f"{planner.getName()} is a planner of another setup: make it with this one's getSpaceInformation()"
        )
    check_usable(planner)


@contextmanager
def _quiet() -> Iterator[None]:
    """Silence OMPL's log within the block."""
    handler = ou.getOutputHandler()
    ou.noOutputHandler()
    try:
        yield
    finally:
        if handler is not None:
            ou.useOutputHandler(handler)


def seed_ompl(seed: int) -> None:
    """Seed OMPL's generators. The log is silenced: OMPL warns of a second seed, but later planners do use it."""
    with _quiet():
        # OMPL replaces the seed 0 by the time.
        ou.RNG.setSeed(seed + 1)


def settings_of(planner: Any) -> dict[str, bool | int | float]:
    """Return the parameters of any planner, with the values that its getters return."""
    found = {key: getattr(planner, f"get{name}", None) for key, name in _settable(planner).items()}
    # Some getters of BITstar write warnings.
    with _quiet():
        values = {key: getter() for key, getter in found.items() if getter is not None}
    return {key: value for key, value in values.items() if isinstance(value, (bool, int, float))}


def nodes_of(planner: Any) -> int:
    """Return the number of nodes of a planner's tree or roadmap."""
    if isinstance(planner, SafePlanner):
        return planner.counts.nodes
    # Reading BITstar's graph leaks the graph and the robot, so its samples are counted instead.
    if isinstance(planner, og.BITstar):
        return int(planner.numBatches() * planner.getSamplesPerBatch())
    return int(planner_data(planner).numVertices())


def planner_data(planner: Any) -> Any:
    """Return the graph of any planner as an `ob.PlannerData`, also outside `SafeSetup`.

    OMPL's bindings do not let planners in Python implement `getPlannerData`, so it is empty in a plain
    `og.SimpleSetup`.
    """
    data = ob.PlannerData(planner.getSpaceInformation())
    fill = getattr(planner, "fillPlannerData", None) or planner.getPlannerData
    fill(data)
    return data


def termination(time: Any) -> Any:
    """Return a termination condition for a time limit [s] or another condition; an InputError for other types.

    The condition calls Python, because Python notices Ctrl-C only while it runs.
    """
    if not isinstance(time, ob.PlannerTerminationCondition):
        is_number = isinstance(time, (int, float, np.integer, np.floating)) and not isinstance(time, bool)
        if not (is_number and time >= 0):
            raise InputError(f"time must be a number of seconds or a termination condition, got {time!r}")
        end = perf_counter() + float(time)
        return ob.PlannerTerminationCondition(lambda: perf_counter() >= end)
    return ob.PlannerTerminationCondition(lambda: bool(time()))


def _refused(name: str) -> InputError:
    return InputError(f"OMPL's {name} cannot be used from Python: {_REFUSED[name]}")


def _refuse_others(name: str, given: Mapping[str, Any], fixed: Mapping[str, Any]) -> None:
    """Raise InputError for a seed, and for parameters whose value is fixed."""
    if "seed" in given:
        raise InputError(
            f"parameter 'seed' of {name}: the seed is the run's; give it as such (seed=…, --seed), or call setSeed"
        )
    for key, value in fixed.items():
        if key in given and given[key] != value:
            raise InputError(f"parameter {key!r} of {name} is fixed to {value!r}, got {given[key]!r}")


def _settable(planner: Any) -> dict[str, str]:
    """Return the names of a planner's parameters: {"goal_bias": "GoalBias"} if it has `setGoalBias`."""
    setters = {name[3:] for name in dir(type(planner)) if name.startswith("set") and name[3:4].isupper()}
    others = {"Name", "ProblemDefinition", "Parameter", "Seed"}
    return {re.sub(r"(?<=[a-z])(?=[A-Z])", "_", name).lower(): name for name in sorted(setters - others)}


def _set_ompls(planner: Any, key: str, value: Any) -> None:
    """Set a parameter of a planner of OMPL: {"goal_bias": 0.1} calls `setGoalBias(0.1)`."""
    setter = getattr(planner, f"set{camel_case(key)}", None)
    if setter is None:
        raise UnknownNameError(f"parameter of {planner.getName()}", key, sorted(_settable(planner)))
    try:
        setter(value)
    except TypeError:
        raise InputError(f"parameter {key!r} of {planner.getName()}: {value!r} has the wrong type") from None
