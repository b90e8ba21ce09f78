"""Measures of a run: danger, clearance, proof and work, by the names that logs, tables and summaries share."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from safe_ompl.common import Counts
from safe_ompl.paths import PathReport
from safe_ompl.planning import PlanResult

Value = float | int | bool | str | None

_DANGERS = ("mean", "max", "integral", "avoidable")


def safety_measures(report: PathReport) -> dict[str, Value]:
    """Return proof, clearance [m] and danger of a path; lengths in rad."""
    found: dict[str, Value] = {
        "certified": report.certified,
        "clearance min": report.clearance.min,
        "clearance mean": report.clearance.mean,
        "length below 50mm": report.clearance.length_below_50mm,
    }
    if report.danger is not None:
        found |= {f"danger {key}": getattr(report.danger, key) for key in _DANGERS}
    return found


def work_measures(counts: Counts) -> dict[str, Value]:
    """Return the numbers of queries and field evaluations."""
    return {key.replace("_", " "): value for key, value in counts.as_dict().items() if key != "nodes"}


def run_measures(result: PlanResult) -> dict[str, Value]:
    """Return all measures of a run: OMPL's own by its names, then danger, clearance, proof and counts."""
    report, path = result.report, result.path
    found: dict[str, Value] = {
        "time": result.planning_time,
        "simplification time": result.simplification_time,
        "solved": result.solved,
        "status": result.status,
        "seed": result.seed,
        "graph states": result.counts.nodes,
    }
    if path is not None and report is not None:
        found |= {
            "correct solution": report.certified,
            "solution length": report.length,
            "solution segments": len(path) - 1,
            "solution clearance": report.clearance.mean,
            **safety_measures(report),
        }
    return found | work_measures(result.counts)


# The measures that are summarised over runs, by the keys of reports; several are added up.
SUMMARISED: Mapping[str, tuple[str, ...]] = {
    "planning_time": ("time",),
    "simplification_time": ("simplification time",),
    "length": ("solution length",),
    "danger_mean": ("danger mean",),
    "danger_max": ("danger max",),
    "danger_avoidable": ("danger avoidable",),
    "clearance_min": ("clearance min",),
    "clearance_mean": ("clearance mean",),
    "length_below_50mm": ("length below 50mm",),
    "queries": ("collision queries", "margin queries", "bound queries"),
    "field_configurations": ("field configurations",),
}


def summarised_measures(result: PlanResult) -> dict[str, float]:
    """Return the measures of `SUMMARISED` of a solved run by their keys; NaN where danger is not known."""
    measures: Mapping[str, Any] = run_measures(result)
    return {
        key: sum(float(measures.get(name, math.nan)) for name in names) for key, names in SUMMARISED.items()
    }
