"""What a safer path is worth in time: `python bench/safety_worth.py [--scenes N] [--seeds N] [--figure FILE]`.

Beside a person who may move at 1.6 m/s, and is seen 0.1 s late, a robot may only be as fast as it can stop before she
reaches it: a path that keeps away may be driven faster. All paths are timed by the same law with the same caps.
Problems: panda_shelf, ur5_handover, and random scenes with a Panda, a person in front of it and things around. Paths:

safest      SafeRRTConnect, optimised for danger and length for S seconds
fastest     SafeRRTConnect, optimised for duration for S seconds
RRTConnect  OMPL's, with OMPL's simplifier until it ends
BIT*        OMPL's, for the length of the path, for S seconds
bound       no path: what the slowest joint takes alone, with nobody there; no motion is shorter

Seconds of search are those of the process, which a busy machine does not falsify. A path "may not move" if somewhere on
it the person is so near that no speed is proven to stop in time. It counts as taking for ever: a ratio with it below
the line is 0. Medians of ratios are printed over all runs, and over those in which both paths may be driven.

The full run, 30 scenes and 3 seeds at 10 s, takes about (30 + 2)·3·3·10 s = 48 minutes on one core. With `--json FILE`
what is done is kept; `--also FILE …` joins it, and leaves out what it has. So the bench can be run in parts, and go on.
"""

from __future__ import annotations

import argparse
import json
import logging
from collections.abc import Iterator, Sequence
from itertools import product
from pathlib import Path
from time import process_time
from typing import TypeAlias

import numpy as np
from _problems import positions
from _timing import print_table
from _worth_problems import NAMED, WorthProblem, WorthSetups, problems
from ompl import util as ou

from safe_ompl.apps.cli.arguments import names
from safe_ompl.common import compilation as compiled
from safe_ompl.trajectories.local_changes import duration_of
from safe_ompl.trajectories.timing import CELLS

LOOKS = {
    "fastest": ("D", "#00876a", "ours, fastest"),
    "safest": ("o", "#0b62b4", "ours, safest"),
    "RRTConnect": ("s", "#c2611f", "RRTConnect + simplifier"),
    "BIT*": ("^", "#3a444f", "BIT*"),
    "bound": ("_", "#00000080", "no motion is shorter"),
}
METHODS = ("safest", "fastest", "RRTConnect", "BIT*", "bound")
STANDSTILL = "may not move"  # in files, in the place of a duration

Runs: TypeAlias = dict[
    tuple[str, int, str], float
]  # [s] by problem, seed and method; +inf: may not move, NaN: no path


def main(arguments: Sequence[str] | None = None) -> None:
    """Run, and print the table."""
    options = _options(arguments)
    ou.setLogLevel(ou.LogLevel.LOG_ERROR)
    logging.disable(logging.WARNING)
    clock_of_the_process()
    runs: Runs = {}
    for file in options.also:
        runs |= loaded(file)
    own: Runs = {}
    for key, seconds in _missing(list(problems(options.scenes))[options.problems], runs, options):
        own[key] = seconds
        print(*key, shown(seconds), sep=", ", flush=True)
        if options.json is not None:
            options.json.write_text(json.dumps(as_rows(own)), encoding="utf-8")
    complete = compared_runs(runs | own)
    if complete:
        report(complete)
        if options.figure is not None:
            draw(complete, options.figure)


def clock_of_the_process() -> None:
    """Let all limits of time, ours and OMPL's, which ask `compiled.clock`, count the time of this process."""
    compiled.perf_counter = process_time


def _options(arguments: Sequence[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--scenes", type=int, default=30, help="random ones (default: %(default)s)")
    parser.add_argument("--problems", type=positions, default="0:", metavar="A:B", help="of these only")
    parser.add_argument("--methods", type=names, default=METHODS, metavar="A,B,...", help="these only")
    parser.add_argument("--seeds", type=int, default=3, help="runs of each problem (default: %(default)s)")
    parser.add_argument("--seconds", type=float, default=10.0, help="of each search (default: %(default)s)")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write every run as it is done")
    parser.add_argument("--also", nargs="*", default=[], type=Path, metavar="FILE", help="runs to join")
    parser.add_argument("--figure", type=Path, metavar="FILE", help="draw it (.png, .svg)")
    options = parser.parse_args(arguments)
    for method in options.methods:
        if method not in METHODS:
            parser.error(f"unknown method {method!r}: {', '.join(METHODS)}")
    return options


def _missing(
    chosen: Sequence[WorthProblem], done: Runs, options: argparse.Namespace
) -> Iterator[tuple[tuple[str, int, str], float]]:
    """Run what is not done, all problems with one seed before the next, and yield the durations."""
    for seed, problem in product(range(options.seeds), chosen):
        methods = [method for method in options.methods if (problem.name, seed, method) not in done]
        if methods:
            setups = problem.setups()
            for method in methods:
                yield (problem.name, seed, method), duration(setups, method, seed, options.seconds)


def duration(setups: WorthSetups, method: str, seed: int, seconds: float) -> float:
    """Return how long the path of a method takes [s]; +inf where nothing allows motion, NaN where there is no path."""
    safe, plain, _, _ = setups
    match method:
        case "bound":
            return setups.bound
        case "safest":
            result = safe.plan(seed=seed, optimise=seconds, report=False)
        case "fastest":
            result = safe.plan(seed=seed, optimise=seconds, cost="duration", report=False)
        case "RRTConnect":
            result = plain.plan("RRTConnect", seed=seed, time=seconds, simplify=True, report=False)
        case _:
            result = plain.plan("BITstar", seed=seed, time=seconds, report=False)
    return np.nan if result.path is None else duration_of(safe.timer, result.path, CELLS)


def as_rows(runs: Runs) -> list[dict[str, object]]:
    """Return what a file holds: a row for each problem and seed, with the durations of its methods."""
    rows: dict[tuple[str, int], dict[str, float | str | None]] = {}
    for (problem, seed, method), value in runs.items():
        said = None if np.isnan(value) else STANDSTILL if np.isinf(value) else value
        rows.setdefault((problem, seed), {})[method] = said
    return [{"problem": problem, "seed": seed, "durations": row} for (problem, seed), row in rows.items()]


def loaded(file: Path) -> Runs:
    """Return the runs of a file."""
    return {
        (row["problem"], row["seed"], method): np.nan
        if value is None
        else np.inf
        if value == STANDSTILL
        else value
        for row in json.loads(file.read_text(encoding="utf-8"))
        for method, value in row["durations"].items()
    }


def compared_runs(runs: Runs) -> Runs:
    """Return the runs of those problems and seeds that every method had which ran at all; say how many are left out."""
    methods = {method for _, _, method in runs}
    every = {key[:2] for key in runs}
    whole = {pair for pair in every if all((*pair, method) in runs for method in methods)}
    print(
        f"\n{len({problem for problem, _ in whole})} problems, {len(whole)} runs of each method; "
        f"{len(every - whole)} that are not complete are left out"
    )
    return {key: value for key, value in runs.items() if key[:2] in whole}


def report(runs: Runs) -> None:
    """Print the table and the ratios."""
    lines = []
    for method in METHODS:
        own = {key[:2]: value for key, value in runs.items() if key[2] == method}
        every = np.array(list(own.values()))
        if len(every):
            of_named = [
                [value for (problem, _), value in own.items() if problem == scenario] for scenario in NAMED
            ]
            lines.append(
                (
                    method,
                    *(shown(float(np.median(values))) if values else "–" for values in of_named),
                    shown(float(np.nanmedian(every))),
                    f"{np.isinf(every).sum()} of {len(every)}",
                    int(np.isnan(every).sum()),
                )
            )
    print_table(("duration [s], medians", *NAMED, "all runs", STANDSTILL, "unsolved"), lines)
    for method in ("safest", "RRTConnect", "BIT*", "bound"):
        print(compared(*pairs(runs, "fastest", method), f"fastest/{method}"))


def pairs(runs: Runs, first: str, second: str) -> tuple[np.ndarray, np.ndarray]:
    """Return the durations (N,) of two methods, of all problems and seeds that both had."""
    both = [
        (value, runs[problem, seed, second])
        for (problem, seed, method), value in runs.items()
        if method == first and (problem, seed, second) in runs
    ]
    found = np.array(both).reshape(-1, 2)
    return found[:, 0], found[:, 1]


def compared(ours: np.ndarray, theirs: np.ndarray, name: str) -> str:
    """Say how the durations (N,) of two methods compare.

    Of runs in which both found a path the ratio is ours/theirs; 0 where only theirs may not move, +inf where only ours
    may not, and no ratio where neither may.
    """
    stuck = np.isinf(ours), np.isinf(theirs)
    known = ~(np.isnan(ours) | np.isnan(theirs) | (stuck[0] & stuck[1]))
    moving = known & ~(stuck[0] | stuck[1])
    if not known.any():
        return f"{name}: nothing to compare"
    ratios = ours[known] / np.where(np.isinf(ours[known]), 1.0, theirs[known])
    text = f"{name}: median {np.median(ratios):.3f} of {known.sum()} runs, 'may not move' as infinitely long"
    if moving.any():
        own = ours[moving] / theirs[moving]
        text += (
            f"; of the {moving.sum()} in which both may move {np.median(own):.3f}, "
            f"slower by more than 1 % in {(own > 1.01).sum()}, at worst {own.max():.2f}"
        )
    return (
        text
        + f"; may not move: ours {(stuck[0] & ~stuck[1]).sum()}, theirs {(stuck[1] & ~stuck[0]).sum()}, "
        + f"neither {(stuck[0] & stuck[1]).sum()}"
    )


def shown(seconds: float) -> str:
    """Return a duration as text."""
    return "unsolved" if np.isnan(seconds) else STANDSTILL if np.isinf(seconds) else f"{seconds:.2f}"


def draw(runs: Runs, file: Path) -> None:
    """Draw the durations of all problems, medians over seeds, method by method, as a picture."""
    import matplotlib.pyplot as plt

    names = list(dict.fromkeys(problem for problem, _, _ in runs))
    medians = {
        method: np.array([_median(runs, name, method) for name in names])
        for method in METHODS
        if any(key[2] == method for key in runs)
    }
    every = np.array(list(medians.values()))
    finite = every[np.isfinite(every)]
    top = 1.08 * finite.max()
    order = np.argsort(next(medians[method] for method in LOOKS if method in medians), kind="stable")
    places = np.arange(len(names))
    figure, axes = plt.subplots(figsize=(8, 4.2))
    axes.axhspan(top, 1.22 * top, color="#f6e7e4", lw=0)
    axes.text(-1.2, 1.11 * top, "may not\nmove", fontsize=9, color="#8c2f20", ha="right", va="center")
    axes.vlines(places, 0, 1.22 * top, color="0.92", lw=1, zorder=0)
    for k, (method, (mark, colour, label)) in enumerate(LOOKS.items()):
        if method not in medians:
            continue
        values = medians[method][order]
        stuck = np.isinf(values)
        beside = places + (
            0.12 * (k - 1.5) if mark != "_" else 0
        )  # so that marks at the same height are seen
        style = {"ls": "none", "marker": mark, "ms": 8 if mark == "_" else 5.5, "zorder": 5 - k}
        axes.plot(beside[~stuck], values[~stuck], color=colour, label=label, **style)
        axes.plot(
            places[stuck], np.full(stuck.sum(), top * (1.035 + 0.05 * k)), mfc="white", mec=colour, **style
        )
    axes.set_yticks(np.arange(0, top, 1 if top < 12 else 2))
    axes.set_xticks(places, [_short(names[k]) for k in order], rotation=90, fontsize=7)
    axes.set(ylabel="duration beside a person [s]", ylim=(0, 1.22 * top), xlim=(-1, len(names)))
    axes.set_xlabel("problem (numbers: random scenes), by the duration of our fastest path")
    axes.legend(
        ncols=5,
        columnspacing=1.2,
        loc="lower center",
        bbox_to_anchor=(0.5, 1.0),
        frameon=False,
        handletextpad=0.1,
    )
    axes.spines[["top", "right"]].set_visible(False)
    figure.savefig(file, bbox_inches="tight", dpi=160)
    plt.close(figure)


def _median(runs: Runs, problem: str, method: str) -> float:
    """Return the median over the seeds, of which the slower middle one where their number is even."""
    values = [value for key, value in runs.items() if (key[0], key[2]) == (problem, method)]
    return float(np.quantile(values, 0.5, method="higher")) if values else np.nan


def _short(name: str) -> str:
    return name.removeprefix("random ")


if __name__ == "__main__":
    main()
