"""The race: the cost J of the best path against time, on 20 queries among obstacles.

    python bench/race.py [--planners A,B] [--queries 0:20] [--time 40] [--longer 120] [--plot FILE] [--json FILE]
                         [--with FILE]

J = ∫ (1 + λ·CDF) ds, λ = 5/median danger over valid configurations: the cost that every rival is given. The queries
are fixed: robot, scene, and the first pair of random configurations with 20 mm of clearance whose straight motion is
blocked. Racing are

* Safe: `SafeSetup.plan(optimise=…)`, SafeRRTConnect, simplification, restarts, refinement;
* Restart: OMPL's RRTConnect and OMPL's simplifier, started anew until the time is up, the best path kept;
* every other name: that planner with the cost as its objective. OMPL's optimising planners go on until the time is
  up; others, such as BiTRRT, are started anew, and OMPL's simplifier has their paths.

Robot, scene and median danger are there before the clock starts. Paths are noted with the time at which they were
found; what they cost is computed afterwards. "best known" is the best J that anything found for the query (--longer
gives ours more time for that); the tables at the end show medians over queries of J divided by it, and for each query
when ours was below what OMPL's optimising planners had in the end. All of it takes hours: --with adds runs of other
planners from files of --json, and --planners "" runs none.
"""

from __future__ import annotations

import argparse
import json
import logging
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache
from itertools import count
from pathlib import Path
from time import perf_counter

import numpy as np
from _problems import positions
from _scenes import scattered
from ompl import geometric as og
from ompl import util as ou

from safe_ompl import DangerObjective, Robot, SafeSetup, Scene
from safe_ompl.common import FloatArray
from safe_ompl.paths.cost import PathCost
from safe_ompl.planning.planners.registry import make_planner
from safe_ompl.view.plots.page import GREY, Page
from safe_ompl.view.style import planner_styles

OURS, RESTART = "Safe", "Restart"
PLANNERS = (OURS, RESTART, "BITstar", "RRTstar", "InformedRRTstar", "TRRT", "BiTRRT", "GradienTRRT")
_LABELS = {
    OURS: "safe-ompl",
    RESTART: "RRTConnect + OMPL's\nsimplifier, restarted",
    "BITstar": "BIT*",
    "RRTstar": "RRT*",
    "InformedRRTstar": "Informed RRT*",
    "TRRT": "T-RRT",
    "BiTRRT": "bidirectional T-RRT",
    "GradienTRRT": "GradienT-RRT",
}
OPTIMISING = ("BITstar", "RRTstar", "InformedRRTstar", "SORRTstar")
INSTANTS = (0.05, 0.1, 0.3, 1.0, 10.0, 40.0)
OBSTACLES, CLEARANCE = 6, 0.02
_WORST = 2.5  # ratio of the costs up to which the figure goes
_FIRST = 0.01  # [s] where it begins
_COLOURS = ("#c8452b", "#b87a00", "#00876a", "#7d2f91", "#596675", "#d38f8f", "#9a8f00")
_GRID = 200  # instants at which ours is compared with the restarting rival
_LOOK = 0.02  # [s] an optimising planner runs between two looks at its best path
QUERIES = tuple((robot, seed) for seed in range(7) for robot in ("ur5", "panda", "xarm7"))[:20]


@dataclass(frozen=True)
class Query:
    """A problem of the race."""

    robot: str
    seed: int

    def __str__(self) -> str:
        return f"{self.robot} {self.seed}"

    def setup(self) -> SafeSetup:
        """Return the problem, simplified by the cost of the race."""
        robot = named_robot(self.robot)
        scene = Scene(
            tuple(replace(obstacle, weight=1.0) for obstacle in scattered(OBSTACLES, self.seed).obstacles)
        )
        setup = SafeSetup(robot, scene)
        setup.setSimplification(exponent=1.0, clearance=0.0)
        setup.setConfigurations(*self._ends(setup))
        return setup

    def _ends(self, setup: SafeSetup) -> tuple[FloatArray, FloatArray]:
        rng = np.random.default_rng(self.seed)
        lower, upper = np.maximum(setup.robot.lower, -2.8), np.minimum(setup.robot.upper, 2.8)
        motion, checker = setup.simplifier.motion, setup.checker
        while True:
            start, goal = rng.uniform(lower, upper, (2, setup.robot.n))
            if not (checker.in_collision(start) or checker.in_collision(goal)):
                clear = min(checker.clearance(q).distance for q in (start, goal)) > CLEARANCE
                if clear and not motion.is_free(start, goal):
                    return start, goal


class RaceCost:
    """1 + λ·CDF in the place of a danger field: as an objective, its integral is J."""

    def __init__(self, cost: PathCost) -> None:
        self._density = cost.densities[0]
        least = self._density.field.minimum / self._density.reference
        self.minimum = 1.0 + self._density.weight * least**self._density.exponent
        self.revision = self._density.field.revision  # nothing moves here

    def value(self, q: FloatArray) -> float:
        """Return the density at `q: (n,)`."""
        return float(self.values(q[None])[0])

    def values(self, Q: FloatArray) -> FloatArray:
        """Return the density (B,) at `Q: (B, n)`."""
        return 1.0 + self._density.values(Q)

    def values_and_gradients(self, Q: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the density (B,) and its gradients (B, n) at `Q: (B, n)`."""
        values, gradients = self._density.values_and_gradients(Q)
        return 1.0 + values, gradients


@cache
def named_robot(name: str) -> Robot:
    """Return an example robot."""
    return Robot.from_example(name)


# ------------------------------------------------------------------------------------------------ the runners

Found = list[tuple[float, float]]  # when, and J
Runs = dict[str, dict[str, Found]]  # of planners, of queries


def run(name: str, query: Query, seconds: float, seed: int) -> Found:
    """Return when a planner found what on a query, best paths only."""
    setup = query.setup()
    if name == OURS:
        result = setup.plan(optimise=seconds, seed=seed)
        return [(improvement.time, improvement.cost) for improvement in result.improvements]
    setup.getSpaceInformation().setup()
    ou.RNG.setSeed(seed + 1)
    setup.setOptimizationObjective(
        DangerObjective(setup.getSpaceInformation(), RaceCost(setup.simplifier.cost))
    )
    begin = perf_counter()
    paths = _optimised if name in OPTIMISING else _restarted
    noted = [(perf_counter() - begin, path) for path in paths(setup, name, begin + seconds)]
    return _falling((when, setup.simplifier.cost.of(path)) for when, path in noted)


def _optimised(setup: SafeSetup, name: str, end: float) -> Iterator[FloatArray]:
    """Yield the best path of one run, each time that it has become another."""
    setup.setPlanner(make_planner(name, setup.getSpaceInformation()))
    last = None
    while (left := end - perf_counter()) > 0:
        setup.solve(min(_LOOK, left))
        if setup.haveExactSolutionPath():
            path = setup.solution()
            if last is None or not np.array_equal(path, last):
                last = path
                yield path


def _restarted(setup: SafeSetup, name: str, end: float) -> Iterator[FloatArray]:
    """Yield the paths of one run after another."""
    planner = "RRTConnect" if name == RESTART else name
    for start in count():
        if (left := end - perf_counter()) <= 0:
            return
        setup.clear()
        made = make_planner(planner, setup.getSpaceInformation())
        if hasattr(made, "setSeed"):
            made.setSeed(start)
        setup.setPlanner(made)
        setup.solve(left)
        if setup.haveExactSolutionPath():
            yield setup.solution()
            og.SimpleSetup.simplifySolution(setup)
            yield setup.solution()


def _falling(found: Iterator[tuple[float, float]]) -> Found:
    kept: Found = []
    for when, cost in found:
        if not kept or cost < kept[-1][1]:
            kept.append((when, cost))
    return kept


def cost_at(found: Found, instant: float) -> float:
    """Return the best J up to an instant [s], infinite where there was no path."""
    return min((cost for when, cost in found if when <= instant), default=np.inf)


# ------------------------------------------------------------------------------------------------- the table


def main() -> None:
    """Run the race."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--planners", default=",".join(PLANNERS), help="default: %(default)s")
    parser.add_argument("--queries", type=positions, default="0:20", metavar="A:B", help="which of the 20")
    parser.add_argument("--time", type=float, default=40.0, metavar="S", help="of each run (default: 40)")
    parser.add_argument(
        "--longer", type=float, metavar="S", help="time for ours alone, towards the best J known"
    )
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--json", type=Path, metavar="FILE", help="write what was found when")
    parser.add_argument(
        "--with",
        type=Path,
        nargs="+",
        default=[],
        metavar="FILE",
        dest="others",
        help="runs of other planners",
    )
    parser.add_argument("--plot", type=Path, metavar="FILE", help="draw it (.png)")
    options = parser.parse_args()
    ou.setLogLevel(ou.LogLevel.LOG_NONE)
    logging.disable(logging.WARNING)

    planners = [planner for planner in options.planners.split(",") if planner]
    queries = [Query(*query) for query in QUERIES[options.queries]]
    found, known = earlier_runs(options.others)
    found = {planner: {} for planner in planners} | {p: of for p, of in found.items() if p not in planners}
    best: dict[str, float] = {}
    instants = [instant for instant in INSTANTS if instant <= options.time]
    print(f"{'query':10s}{'planner':>18s}" + "".join(f"{f'{t:g} s':>9s}" for t in instants))
    for query in queries:
        name = str(query)
        for planner, of in found.items():
            if planner in planners:
                of[name] = run(planner, query, options.time, options.seed)
            row = "".join(f"{cost_at(of.get(name, []), instant):9.2f}" for instant in instants)
            print(f"{name:10s}{planner:>18s}{row}", flush=True)
        costs = [of[name][-1][1] for of in found.values() if of.get(name)]
        if name in known:
            costs.append(known[name])
        if options.longer:
            costs.append(run(OURS, query, options.longer, options.seed + 1)[-1][1])
        best[name] = min(costs)
        print(f"{name:10s}{'best known':>18s}{best[name]:9.2f}", flush=True)
    show_ratios(found, best, instants)
    if OURS in found:
        show_lead(found, best, options.time)
    if options.json:
        options.json.write_text(json.dumps({"found": found, "best": best}))
    if options.plot:
        draw(found, best, options.time, options.plot)


def earlier_runs(files: Sequence[Path]) -> tuple[Runs, dict[str, float]]:
    """Return what planners found in earlier races, and the best J known; of the same run the last file counts."""
    found: Runs = {}
    best: dict[str, float] = {}
    for file in files:
        told = json.loads(file.read_text())
        for planner, of in told["found"].items():
            found[planner] = found.get(planner, {}) | of
        for query, cost in told["best"].items():
            best[query] = min(cost, best.get(query, np.inf))
    return found, best


def ratios(of: dict[str, Found], best: dict[str, float], times: Sequence[float]) -> FloatArray:
    """Return J over the best J known (Q, T), of the queries at times; infinite where there was no path."""
    return np.array([[cost_at(of.get(query, []), t) / cost for t in times] for query, cost in best.items()])


def show_ratios(found: Runs, best: dict[str, float], instants: Sequence[float]) -> None:
    """Print the medians over the queries of J over the best J known."""
    print("\nmedian over queries of J / best J known; inf: no path on half of them")
    for planner, of in found.items():
        medians = np.median(ratios(of, best, instants), axis=0)
        print(f"{planner:>28s}" + "".join(f"{median:9.3f}" for median in medians))


def show_lead(found: Runs, best: dict[str, float], seconds: float) -> None:
    """Print for each query when ours was below the best J of OMPL's optimising planners, and where the rest ended."""
    rivals = [planner for planner in found if planner in OPTIMISING]
    others = [planner for planner in found if planner not in (*OPTIMISING, OURS)]
    print("\nwhen ours is below the last J of OMPL's optimising planners, and of the others")
    for query in best:
        line = f"{query:10s}"
        for label, group in (("optimising", rivals), ("others", others)):
            last = min((cost_at(found[p].get(query, []), np.inf) for p in group), default=np.inf)
            when = next((when for when, cost in found[OURS][query] if cost <= last), np.inf)
            line += f"  {label} {last:8.2f}, ours after {1e3 * when:7.0f} ms"
        print(line)
    if RESTART in found:
        grid = np.geomspace(INSTANTS[0], seconds, _GRID)
        ours, theirs = (ratios(found[planner], best, grid) for planner in (OURS, RESTART))
        ahead = (theirs < ours).mean()
        median_ahead = (np.median(theirs, axis=0) < np.median(ours, axis=0)).mean()
        print(
            f"{RESTART} below ours from {INSTANTS[0]:g} s on: {ahead:.1%} of times and queries, "
            f"{median_ahead:.1%} of times in the median"
        )


def draw(found: Runs, best: dict[str, float], seconds: float, file: Path) -> None:
    """Draw the median over the queries of J over the best J known, against time."""
    times = np.geomspace(_FIRST, seconds, 400)
    ours, rivals = planner_styles(["SafeRRTConnect"])["SafeRRTConnect"].colour, iter(_COLOURS)
    with Page(file, 9.0, 4.4) as page:
        axes = page.figure.subplots()
        for planner, of in sorted(found.items(), key=lambda item: item[0] != OURS):
            median = np.median(ratios(of, best, times), axis=0)
            known = np.isfinite(median)
            axes.plot(
                times[known],
                median[known],
                label=_LABELS.get(planner, planner),
                color=ours if planner == OURS else next(rivals, GREY),
                linewidth=3.0 if planner == OURS else 1.5,
            )
        axes.set(
            xscale="log",
            xlim=(_FIRST, seconds),
            ylim=(0.9, _WORST),
            xlabel="time, planning included [s]",
            ylabel="cost of the best path / best known",
        )
        axes.xaxis.set_major_formatter("{x:g}")
        lines = sorted(axes.get_lines(), key=lambda line: -line.get_ydata()[-1])
        axes.legend(handles=lines, loc="center left", bbox_to_anchor=(1.0, 0.5))


if __name__ == "__main__":
    main()
