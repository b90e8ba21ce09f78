"""Results of planners as a benchmark log of OMPL's."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from os import PathLike
from typing import Any

from safe_ompl.apps.benchmark.log import Experiment, PlannerRuns
from safe_ompl.apps.benchmark.measures import Value, run_measures
from safe_ompl.planning import PlanResult


def write_log(
    results: Iterable[PlanResult],
    file: str | PathLike[str],
    *,
    settings: Mapping[str, Mapping[str, Value]] | None = None,
    **about: Any,
) -> None:
    """Write the results of runs of any planners, in any order, as a benchmark log.

    Parameters
    ----------
    settings : mapping of str to mapping, optional
        Parameters of the planners, by the planner's name.
    **about
        Attributes of the `Experiment`, such as its name and `time_limit` [s].
    """
    by_planner: dict[str, PlannerRuns] = {}
    seeds = []
    for result in results:
        own = (settings or {}).get(result.planner, {})
        planner = by_planner.setdefault(result.planner, PlannerRuns(result.planner, own))
        planner.runs.append(run_measures(result))
        seeds.append(result.seed)
    planners = list(by_planner.values())
    Experiment(
        about.pop("name", "safe_ompl"),
        planners,
        run_count=max((len(planner.runs) for planner in planners), default=0),
        seed=min(seeds, default=0),
        duration=sum(float(run["time"] or 0) for planner in planners for run in planner.runs),
        **about,
    ).save(file)
