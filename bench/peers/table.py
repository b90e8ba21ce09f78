"""The table and the figure of a comparison."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

Run = dict[str, Any]


def _milliseconds(*keys: str) -> Callable[[Run], float]:
    return lambda run: 1e3 * sum(run[key] for key in keys)


COLUMNS: dict[str, Callable[[Run], float]] = {
    "building [ms]": _milliseconds("building"),
    "planning [ms]": _milliseconds("planning"),
    "smoothing [ms]": _milliseconds("smoothing"),
    "total [ms]": _milliseconds("building", "planning", "smoothing"),
    "min clearance [mm]": lambda run: 1e3 * run["min_clearance"],
    "mean clearance [mm]": lambda run: 1e3 * run["mean_clearance"],
    "< 50 mm [rad]": lambda run: run["near"],
    "mean danger": lambda run: run["mean_danger"],
    "peak danger": lambda run: run["peak_danger"],
    "danger integral": lambda run: run["integral_danger"],
    "length [rad]": lambda run: run["length"],
}
SPREAD = ("planning [ms]", "total [ms]")  # with their 90th percentiles in brackets


def markdown(runs: dict[str, list[Run]], unavailable: dict[str, str]) -> str:
    """Return the table: medians over what each system solved, 90th percentiles of the times in brackets."""
    lines = [
        "| system | solved | touching | " + " | ".join(COLUMNS) + " |",
        "|---" * (3 + len(COLUMNS)) + "|",
    ]
    for system, answers in runs.items():
        solved = [run for run in answers if run["solved"]]
        cells = [f"{len(solved)}/{len(answers)}", str(sum(run["touching"] for run in solved))]
        for name, value in COLUMNS.items():
            numbers = [value(run) for run in solved]
            cells.append(_cell(numbers, name in SPREAD))
        lines.append(f"| {system} | " + " | ".join(cells) + " |")
    lines += [f"\nNot run: **{system}** ({reason})." for system, reason in unavailable.items()]
    return "\n".join(lines)


def _cell(numbers: list[float], spread: bool) -> str:
    if not numbers:
        return "–"
    text = f"{np.median(numbers):.3g}"
    return f"{text} ({np.percentile(numbers, 90):.3g})" if spread else text


def figure(runs: dict[str, list[Run]], file: Path) -> None:
    """Draw time against mean clearance and against mean danger, one mark a system; open marks had contacts."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt

    fig, axes = plt.subplots(1, 2, figsize=(11, 4.6), constrained_layout=True, sharex=True)
    for axis, key, label, factor in zip(
        axes,
        ("mean_clearance", "mean_danger"),
        ("mean clearance [mm] (more is safer)", "mean danger (less is safer)"),
        (1e3, 1.0),
        strict=True,
    ):
        for system, answers in runs.items():
            solved = [run for run in answers if run["solved"]]
            if not solved:
                continue
            x = np.median([COLUMNS["total [ms]"](run) for run in solved])
            y = factor * np.median([run[key] for run in solved])
            ours = system.startswith("safe_ompl")
            color = "#1b6ca8" if ours else "#8a8a8a"
            touching = any(run["touching"] for run in solved)
            axis.plot(
                x, y, "o" if not ours else "D", ms=8, mec=color, mfc="none" if touching else color, mew=1.6
            )
            axis.annotate(system, (x, y), xytext=(6, 5), textcoords="offset points", fontsize=8, color=color)
        axis.set(xscale="log", xlabel="building + planning + smoothing, median CPU time [ms]", ylabel=label)
        axis.grid(alpha=0.25, which="both")
        axis.margins(x=0.18, y=0.1)
    fig.suptitle("Filled: no path touched anything at 0.005 rad. Open: some did.", fontsize=10)
    fig.savefig(file, dpi=140)
    plt.close(fig)


def columns(run: Run, names: Sequence[str]) -> list[float]:
    """Return some columns of one run."""
    return [COLUMNS[name](run) for name in names]
