"""The tables and the figure of a comparison."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

Run = dict[str, Any]


NO_PATH = "no path"
WITH_OURS = " + our proof and repair"  # after the name of a system


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
    return ("system", "solved", "contacts", *COLUMNS), rows


def compact(table: dict[str, Any]) -> Table:
    """Return header and rows of a shorter table: the first setting of each system, before and after our repair."""
    rows = {row["system"]: row for row in _named(table)}
    first = {name.split(",")[0]: name for name in reversed(rows) if not name.endswith(WITH_OURS)}
    cells = []
    for name in reversed(first.values()):
        own, after = rows[name], rows.get(f"{name}{WITH_OURS}", {"total [ms]": "–"})
        contacts = f"{own['contacts']} of {own['solved'].split('/')[0]}"
        cells.append((name, contacts, own["total [ms]"], own["mean danger"], after["total [ms]"]))
    return ("planner", "contacts", "time [ms]", "mean danger", "time then [ms]"), cells


def _named(table: dict[str, Any]) -> list[dict[str, Any]]:
    """Return the rows of a table as it is in a file, by their columns' names."""
    return [dict(zip(table["header"], row, strict=True)) for row in table["rows"]]


def remarks(
    runs: dict[str, list[Run]], unavailable: dict[str, str], blocked: Sequence[str], outside: Sequence[str]
) -> list[tuple[object, ...]]:
    """Return rows on problems that were left out, `blocked` or `outside` limits of joints, on errors and on systems."""
    rows = [("left out, start or goal in collision", name) for name in blocked]
    rows += [("left out, start or goal outside limits of joints", name) for name in outside]
    for system, answers in runs.items():
        errors = [run for run in answers if run["error"] not in (None, NO_PATH)]
        if errors:
            rows.append((f"{system}: {len(errors)} errors", f"first: {errors[0]['problem']}: {errors[0]['error']}"))
    return [*rows, *((f"{system}: not run", reason) for system, reason in unavailable.items())]


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
        numbers = ([1e3 * new["proof"] for _, new in both if new["proven"]], [1e3 * new["repair"] for new in good])
        numbers += tuple([new[key] for new in good] for key in ("deviation", "tool_deviation"))
        rows.append((system, *counts, *(_cell(found, True) for found in numbers)))
    header = ("system", "proven where the judge finds nothing", "repaired where it does", "repaired in all")
    header += ("moved", "planned", "contacts afterwards", "proof [ms]", "repair [ms]", "deviation [rad]")
    return (*header, "at the tool [mm]"), rows


def _cell(numbers: list[float], spread: bool) -> str:
    if not numbers:
        return "–"
    text = f"{np.median(numbers):.3g}"
    return f"{text} ({np.percentile(numbers, 90):.3g})" if spread else text


def figure(table: dict[str, Any], file: Path) -> None:
    """Draw the contacts of each system's paths against its time, danger as colour; a line leads to its repaired paths.

    `table` is that of `comparison` as it is in a file. Times are on a logarithmic scale, contacts in percent.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    rows = [row for row in _named(table) if not str(row["solved"]).startswith("0/")]
    names = [row["system"] for row in rows]
    times = [float(str(row["total [ms]"]).split()[0]) for row in rows]
    shares = [100 * row["contacts"] / float(str(row["solved"]).split("/")[0]) for row in rows]
    dangers = [float(row["mean danger"]) for row in rows]
    drawn = Figure(figsize=(8.4, 4.6), dpi=110, layout="constrained")
    axes = drawn.subplots()
    axes.set(
        xscale="log", xlabel="CPU time of a path, median [ms]", ylabel="paths with contacts, found by the judge [%]"
    )
    axes.set(xlim=(min(times) / 1.7, max(times) * 3.5), ylim=(-0.16 * max(*shares, 10.0), 1.12 * max(*shares, 10.0)))
    for name, x, y in zip(names, times, shares, strict=True):
        if f"{name}{WITH_OURS}" in names:
            k = names.index(f"{name}{WITH_OURS}")
            axes.plot((x, times[k]), (y, shares[k]), color="0.7", lw=1.0, zorder=1)
    sizes = [30 if name.endswith(WITH_OURS) else 130 for name in names]
    shades = axes.scatter(times, shares, s=sizes, c=dangers, cmap="YlOrRd", edgecolors="0.25", zorder=2)
    drawn.colorbar(shades, ax=axes, label="mean danger along the paths")
    axes.grid(alpha=0.25)
    axes.spines[["top", "right"]].set_visible(False)
    axes.axhline(0.0, color="0.5", lw=0.8, zorder=0)
    canvas = FigureCanvasAgg(drawn)
    canvas.draw()
    drawn.set_layout_engine("none")  # what is placed now stays there
    taken = [axes.transData.transform(place) for place in zip(times, shares, strict=True)]
    boxes = [(x - 9, y - 9, x + 9, y + 9) for x, y in taken]
    for name, (x, y) in zip(names, taken, strict=True):
        if name.endswith(WITH_OURS):
            continue
        own = name.startswith("safe_ompl")
        text = axes.annotate(name, (x, y), xycoords="figure pixels", fontsize=9, weight="bold" if own else "normal")
        width, height = text.get_window_extent().size
        # On the line of no contacts, names stand above or below it.
        places = [(x + 11, y - height / 2), (x - width - 11, y - height / 2)] if shares[names.index(name)] else []
        places += [(x + dx, y + dy) for dy in (11, -25, 27, -41, 43) for dx in (-8, -width / 2, 8 - width)]
        right = axes.bbox.x1
        boxes_of = ((p, (*p, p[0] + width, p[1] + height)) for p in places)
        free = (p for p, at in boxes_of if at[2] < right and not any(_overlap(at, box) for box in boxes))
        place = next(free, places[-1])
        text.set_position(place)
        boxes.append((*place, place[0] + width, place[1] + height))
    small = "small marks: the same paths, proven or repaired by safe_ompl"
    axes.text(0.99, 0.97, small, transform=axes.transAxes, ha="right", va="top", fontsize=8.5, color="0.3")
    canvas.print_png(file)


Box = tuple[float, float, float, float]


def _overlap(one: Box, other: Box) -> bool:
    """Return whether two rectangles (left, bottom, right, top) overlap."""
    return one[0] < other[2] and other[0] < one[2] and one[1] < other[3] and other[1] < one[3]
