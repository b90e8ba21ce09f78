"""The table and the figure of a comparison."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from bench._harness import markdown_table

Run = dict[str, Any]


NO_PATH = "no path"


def _milliseconds(*keys: str) -> Callable[[Run], float]:
    return lambda run: 1e3 * sum(run["times"][key] for key in keys)


def _judged(key: str, factor: float) -> Callable[[Run], float]:
    return lambda run: factor * run[key]


JUDGED = {  # key of a run: heading, unit's factor
    "min_clearance": ("min clearance [mm]", 1e3),
    "mean_clearance": ("mean clearance [mm]", 1e3),
    "near": ("< 50 mm [rad]", 1.0),
    "mean_danger": ("mean danger", 1.0),
    "peak_danger": ("peak danger", 1.0),
    "integral_danger": ("danger integral", 1.0),
    "length": ("length [rad]", 1.0),
}
COLUMNS: dict[str, Callable[[Run], float]] = {
    "building [ms]": _milliseconds("building"),
    "planning [ms]": _milliseconds("planning"),
    "smoothing [ms]": _milliseconds("smoothing"),
    "total [ms]": _milliseconds("building", "planning", "smoothing"),
    **{heading: _judged(key, factor) for key, (heading, factor) in JUDGED.items()},
}
OURS, OTHERS = "#1b6ca8", "#7a7a7a"
SPREAD = ("planning [ms]", "total [ms]")  # with their 90th percentiles in brackets


Table = tuple[tuple[str, ...], list[tuple[object, ...]]]


def comparison(runs: dict[str, list[Run]]) -> Table:
    """Return header and rows: medians over what each system solved, 90th percentiles of the times in brackets."""
    rows = []
    for system, answers in runs.items():
        solved = [run for run in answers if run["solved"]]
        cells = (f"{len(solved)}/{len(answers)}", sum(run["touching"] for run in solved))
        columns = (_cell([value(run) for run in solved], name in SPREAD) for name, value in COLUMNS.items())
        rows.append((system, *cells, *columns))
    return ("system", "solved", "touching", *COLUMNS), rows


def markdown(
    runs: dict[str, list[Run]], unavailable: dict[str, str], blocked: Sequence[str] = (), outside: Sequence[str] = ()
) -> str:
    """Return the table, and below it the problems left out, `blocked` or `outside` limits of joints, and errors."""
    lines = [markdown_table(*comparison(runs))]
    for what, names in (("in collision", blocked), ("outside limits of joints", outside)):
        if names:
            lines.append(f"\nLeft out, start or goal {what}: {', '.join(names)}.")
    for system, answers in runs.items():
        errors = [run for run in answers if run["error"] not in (None, NO_PATH)]
        if errors:
            first = errors[0]
            lines.append(f"\n{len(errors)} errors: **{system}** (first: {first['problem']}: {first['error']}).")
    lines += [f"\nNot run: **{system}** ({reason})." for system, reason in unavailable.items()]
    return "\n".join(lines)


def repairs(paths: dict[str, tuple[list[Run], list[Run]]]) -> Table:
    """Return header and rows: our proofs and repairs of paths of other systems, before and after them."""
    rows = []
    for system, (before, after) in paths.items():
        both = [(old, new) for old, new in zip(before, after, strict=True) if old["solved"]]
        apart = [new for old, new in both if not old["touching"]]
        touching = [new for old, new in both if old["touching"]]
        tried = [new for _, new in both if not new["proven"]]
        good = [new for new in tried if new["repaired"]]
        counts = (
            f"{sum(bool(new['proven']) for new in apart)}/{len(apart)}",
            f"{sum(bool(new['repaired']) for new in touching)}/{len(touching)}",
            f"{len(good)}/{len(tried)}",
            *(sum(new["how"] == how for new in good) for how in ("moved", "planned")),
            sum(new["touching"] for _, new in both if new["solved"]),
        )
        numbers = ([1e3 * new["proof"] for _, new in both], [1e3 * new["repair"] for new in good])
        numbers += tuple([new[key] for new in good] for key in ("deviation", "tool_deviation"))
        rows.append((system, *counts, *(_cell(found, True) for found in numbers)))
    header = ("system", "proven where the judge finds nothing", "repaired where it does", "repaired in all")
    header += ("moved", "planned", "touching afterwards", "proof [ms]", "repair [ms]", "deviation [rad]")
    return (*header, "at the tool [mm]"), rows


def _cell(numbers: list[float], spread: bool) -> str:
    if not numbers:
        return "–"
    text = f"{np.median(numbers):.3g}"
    return f"{text} ({np.percentile(numbers, 90):.3g})" if spread else text


def figure(runs: dict[str, list[Run]], file: Path) -> None:
    """Draw time against mean clearance and against mean danger, one numbered mark a system; open marks had contacts."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt

    solved = {name: [run for run in answers if run["solved"]] for name, answers in runs.items()}
    shown = {name: answers for name, answers in solved.items() if answers}
    fig, axes = plt.subplots(1, 2, figsize=(14, 4.8), layout="constrained", sharex=True)
    labels = {"mean clearance [mm]": "mean clearance [mm]: more is safer", "mean danger": "mean danger: less is safer"}
    handles = []
    for axis, (key, label) in zip(axes, labels.items(), strict=True):
        handles = []
        for number, (name, answers) in enumerate(shown.items(), 1):
            x, y = (float(np.median([COLUMNS[k](run) for run in answers])) for k in ("total [ms]", key))
            color = OURS if name.startswith("safe_ompl") else OTHERS
            inside = "white" if any(run["touching"] for run in answers) else color
            (mark,) = axis.plot(x, y, "o", ms=15, mec=color, mfc=inside, mew=1.6, ls="none", label=f"{number}  {name}")
            ink = color if inside == "white" else "white"
            axis.annotate(str(number), (x, y), ha="center", va="center", fontsize=9, color=ink)
            handles.append(mark)
        axis.set(xscale="log", xlabel="building + planning + smoothing, median [ms of CPU]", ylabel=label)
        axis.grid(alpha=0.25, which="both")
        axis.margins(0.1)
    title = "Open marks: paths that\ntouched something"
    fig.legend(handles=handles, loc="outside right upper", fontsize=9, title=title, markerscale=0.6, frameon=False)
    fig.savefig(file, dpi=130)
    plt.close(fig)
