"""Runs of planners: one run, and many in an order."""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from safe_ompl.common import InputError, ctrl_c_as_such, whole_number
from safe_ompl.planning import PlanResult, SafeSetup

_log = logging.getLogger(__name__)


class Run(NamedTuple):
    """One run of a comparison: the name of the planner, and the seed."""

    planner: str
    seed: int


def rounds(planners: Sequence[str], number: int, seed: int = 0) -> list[Run]:
    """Return the runs of a comparison in their order: the planners take turns, once with each seed.

    Raises InputError for no planner, one named twice, or a number of runs below 1.
    """
    if not planners:
        raise InputError("at least one planner is needed")
    for name in planners:
        if list(planners).count(name) > 1:
            raise InputError(f"planner {name!r} is named twice")
    number = whole_number("runs", number, at_least=1)
    return [Run(planner, seed + k) for k in range(number) for planner in planners]


def run_planner(
    setup: SafeSetup,
    run: Run,
    *,
    planner: Any = None,
    time: float,
    parameters: Mapping[str, Any] | None = None,
    simplify: bool | float = False,
) -> PlanResult:
    """Do one run, of the planner by its name or as it is given; what goes wrong in it is a result without a path.

    It does not know of other runs, and its result can be sent to other processes: anything may spread runs out. Only an
    InputError, which all runs would raise, and Ctrl-C arrive here.
    """
    try:
        options: dict[str, Any] = {"parameters": parameters, "simplify": simplify}
        with ctrl_c_as_such():
            result = setup.plan(run.planner if planner is None else planner, time=time, seed=run.seed, **options)
    except InputError:
        raise
    except Exception as error:
        return lost(run, str(error), setup.robot.joint_names)
    if result.interrupted:  # Ctrl-C is for all the runs
        raise KeyboardInterrupt
    return result


def failure(status: str, planner: str, seed: int, joint_names: tuple[str, ...]) -> PlanResult:
    """Return the result of a run without a path."""
    return PlanResult(status, None, None, planner, seed, joint_names, planning_time=0.0)


def lost(run: Run, words: str, joint_names: tuple[str, ...] = ()) -> PlanResult:
    """Return the result of a run that went wrong, and log why."""
    _log.warning("%s, seed %d: %s", run.planner, run.seed, words)
    return failure(f"Error: {words}", run.planner, run.seed, joint_names)
