"""The planners by name: ours, their classical counterparts, and OMPL's."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from typing import Any

from ompl import geometric as og

from safe_ompl.errors import InputError, UnknownNameError
from safe_ompl.planners.base import SafePlanner
from safe_ompl.planners.baselines.hrrt import HRRT
from safe_ompl.planners.baselines.trrt import TRRT, BiTRRT, GradienTRRT
from safe_ompl.planners.bubble import BubblePlanner
from safe_ompl.planners.jt_rrt import SafeJTRRT
from safe_ompl.planners.prm import SafePRM
from safe_ompl.planners.rrt_connect import SafeRRTConnect
from safe_ompl.plugins.goals import WorkspaceGoal

_OURS: dict[str, tuple[type[SafePlanner], dict[str, Any]]] = {
    "SafeRRTConnect": (SafeRRTConnect, {}),
    "ClassicRRTConnect": (SafeRRTConnect, {"alpha": 0.0}),
    "SafePRM": (SafePRM, {}),
    "ClassicPRM": (SafePRM, {"alpha": 0.0}),
    "SafeJTRRT": (SafeJTRRT, {}),
    "ClassicJTRRT": (SafeJTRRT, {"alpha": 0.0, "transpose": True}),
    "BubblePlanner": (BubblePlanner, {}),
    "ClassicBubble": (BubblePlanner, {"alpha": 0.0}),
}

# The planners as the papers print them; α, the numbers that the papers leave open, and the range are free.
_RRT_CONNECT_AS_PRINTED = {
    "nearest_fraction": 0.0,
    "slide": 0.0,
    "threshold_rise": 0.0,
    "patience": 0.0,
    "clearance": 0.0,
    "short_steps": False,
    "balanced": False,
    "raw_alpha": True,
}
_PRM_AS_PRINTED = {
    "slide": 0.0,
    "patience": 0.0,
    "raw_alpha": True,
    "taxicab": True,
    "lazy": False,
    "clearance": 0.0,
    "growing": False,
}
_JT_RRT_AS_PRINTED = {
    "nearest_fraction": 0.0,
    "slide": 0.0,
    "threshold_rise": 0.0,
    "patience": 0.0,
    "raw_alpha": True,
    "raw_gains": True,
    "random_starts": 0.0,
    "strict_threshold": True,
    "clearance": 0.0,
}
_BUBBLES_AS_PRINTED = {
    "nearest_fraction": 0.0,
    "patience": 0.0,
    "slide": 0.0,
    "normalized": False,
    "guided": False,
    "max_open": 0,
    "least_clearance": 0.0,
    "clearance": 0.0,
    "shape": ("paper", "paper_cube"),  # (9), or where it is asked for the cube within it
}
_AS_PRINTED: dict[str, tuple[type[SafePlanner], dict[str, Any]]] = {
    "PaperSafeRRTConnect": (SafeRRTConnect, _RRT_CONNECT_AS_PRINTED),
    "PaperRRTConnect": (SafeRRTConnect, {**_RRT_CONNECT_AS_PRINTED, "alpha": 0.0}),
    "PaperSafePRM": (SafePRM, _PRM_AS_PRINTED),
    "PaperPRM": (SafePRM, {**_PRM_AS_PRINTED, "alpha": 0.0}),
    "PaperSafeJTRRT": (SafeJTRRT, {**_JT_RRT_AS_PRINTED, "transpose": False}),
    "PaperJTRRT": (SafeJTRRT, {**_JT_RRT_AS_PRINTED, "alpha": 0.0, "transpose": True}),
    "PaperSafeBubble": (BubblePlanner, _BUBBLES_AS_PRINTED),
    "PaperBubble": (BubblePlanner, {**_BUBBLES_AS_PRINTED, "alpha": 0.0}),
}

# Danger-aware planners of others that OMPL's wheel lacks, to compare with.
_BASELINES = {"TRRT": TRRT, "BiTRRT": BiTRRT, "GradienTRRT": GradienTRRT, "HRRT": HRRT}

# Bound in OMPL's Python wheel, and safe to run with callbacks in Python.
_OMPL = (
    "RRTConnect",
    "RRT",
    "RRTstar",
    "InformedRRTstar",
    "SORRTstar",
    "BITstar",
    "KPIECE1",
    "BKPIECE1",
    "LBKPIECE1",
)

_REFUSED = {
    "PRM": "it waits for itself for ever where objective or checker are Python's; take SafePRM",
    "PRMstar": "it waits for itself for ever where objective or checker are Python's; take SafePRM",
    "FMT": "it prices all motions of its graph before it looks at the clock: 9 s for a limit of 4 s; take BITstar",
    "BFMT": "it does not look at the clock where costs are Python's: 45 s for a limit of 4 s; take BITstar",
    "AORRTC": "it ignores the objective and ends the process when it is cleared; take BITstar",
}


def planner_names() -> list[str]:
    """Return the names that `make_planner` knows: ours first, then those as printed, the baselines, and OMPL's."""
    return [*_OURS, *_AS_PRINTED, *_BASELINES, *_OMPL]


def is_ours(name: str) -> bool:
    """Return whether the planner called `name` is one of this package, in the form that is meant for use."""
    return name in _OURS


def needs_place(name: str) -> bool:
    """Return whether the planner called `name` plans to a `WorkspaceGoal` only."""
    known = {**_OURS, **_AS_PRINTED}
    return name in known and issubclass(known[name][0].plans_to, WorkspaceGoal)


def accepts(planner: Any, goal: Any) -> bool:
    """Return whether a planner can plan to a goal; of OMPL's planners it is taken for granted."""
    return planner.accepts(goal) if isinstance(planner, SafePlanner) else True


def make_planner(name: str, si: Any, parameters: Mapping[str, Any] | None = None) -> Any:
    """Return a planner.

    Parameters
    ----------
    name : str
        One of `planner_names()`.
    si : ob.SpaceInformation
        What it plans in.
    parameters : mapping, optional
        Parameters by the names of their setters: {"alpha": 1} calls `setAlpha(1)`.

    Raises
    ------
    UnknownNameError
        If there is no such planner or parameter.
    InputError
        If a value is refused, if it is fixed for this planner (α of the classical ones), or for a seed: that is
        the run's.
    """
    if name in _OURS or name in _AS_PRINTED:
        kind, fixed = {**_OURS, **_AS_PRINTED}[name]
        planner = kind(si, name)
    elif name in _BASELINES:
        fixed, planner = {}, _BASELINES[name](si, name)
    elif name in _OMPL:
        fixed, planner = {}, getattr(og, name)(si)
    elif name in _REFUSED:
        raise _refused(name)
    else:
        raise UnknownNameError("planner", name, planner_names())
    given = dict(parameters or {})
    _refuse_others(name, given, fixed)
    for key, value in {**{key: _choices(value)[0] for key, value in fixed.items()}, **given}.items():
        _setter(planner, key)(value)
    return planner


def check_usable(planner: Any) -> None:
    """Raise InputError if this is one of OMPL's planners that hang, crash, or take no notice of time limits here."""
    for kind in type(planner).__mro__:
        if kind.__name__ in _REFUSED and kind is getattr(og, kind.__name__, None):
            raise _refused(kind.__name__)


def _refused(name: str) -> InputError:
    return InputError(f"OMPL's {name} cannot be used from Python: {_REFUSED[name]}")


def _refuse_others(name: str, given: Mapping[str, Any], fixed: Mapping[str, Any]) -> None:
    """Raise an InputError for parameters that would be set without effect."""
    if "seed" in given:
        raise InputError(
            f"parameter 'seed' of {name}: the seed is the run's; give it as such (seed=…, --seed), or call setSeed"
        )
    for key, value in fixed.items():
        if key in given and given[key] not in _choices(value):
            words = " or ".join(map(repr, _choices(value)))
            raise InputError(f"parameter {key!r} of {name} is fixed to {words}, got {given[key]!r}")


def _choices(value: Any) -> tuple[Any, ...]:
    """Return the values that a fixed parameter may have, the usual one first."""
    return value if isinstance(value, tuple) else (value,)


def _setter(planner: Any, key: str) -> Callable[[Any], None]:
    name = "set" + "".join(word.capitalize() for word in key.split("_"))
    setter = getattr(planner, name, None)
    if setter is None:
        setters = {n[3:] for n in dir(type(planner)) if n.startswith("set") and n[3:4].isupper()}
        known = sorted(_snake_case(name) for name in setters - {"Name", "ProblemDefinition", "Seed"})
        raise UnknownNameError(f"parameter of {planner.getName()}", key, known)

    def call(value: Any) -> None:
        try:
            setter(value)
        except TypeError:
            raise InputError(
                f"parameter {key!r} of {planner.getName()}: {value!r} has the wrong type"
            ) from None

    return call


def _snake_case(name: str) -> str:
    """GoalBias → goal_bias."""
    return re.sub(r"(?<=[a-z])(?=[A-Z])", "_", name).lower()
