"""What the proofs are worth: python bench/certify.py [--edges N] [--hard N] [--free N] [--paths N] [--only PART …].

verdicts   Random edges of up to 1.5 rad on every robot and scene. An edge that is called free is looked at every
           0.001 rad, one that is called blocked must be in collision where it says: `contradicted` must be 0. The
           target for undecided ones is 0.5 %.
hard       Edges that pass within 5 mm of a contact, looked at every 0.0002 rad.
bands      Queries of free 1-rad edges, by their clearance, and CPU time against sampling them at 0.01 rad.
ideas      What each way to save queries gains: free edges of 1 rad, queries and time in relation to plain
           subdivision (constant radii, the whole edge first).
danger     Proven peaks of danger of planned and random paths: violations by samples 0.001 rad apart (must be 0), slack
           (target: median 5 % at the default tolerance), field evaluations against those of a profile (target: 2).
verify     Certificates of planned paths: CPU time of `verify` in relation to planning (target: 20).

The full run, --edges 100000 --hard 10000, takes hours. Every part prints its own table, with the totals last.
"""

from __future__ import annotations

import argparse
from collections import Counter
from collections.abc import Callable, Iterator
from math import ceil
from time import process_time

import numpy as np
import pinocchio as pin
from _scenes import bookshelf, scattered
from _timing import print_table
from motion import COARSE, random_edges, sampled_is_free

from safe_ompl.certificates.issue import certificate
from safe_ompl.certificates.verifier.verify import verify
from safe_ompl.collision.checker import CollisionChecker
from safe_ompl.collision.motion import MotionProver, Verdict
from safe_ompl.common import FloatArray
from safe_ompl.danger.certified import CertifiedDanger
from safe_ompl.danger.field import DangerField
from safe_ompl.paths.measures import PROFILE_POINTS, Curve
from safe_ompl.planning.from_scenario import setup_scenario
from safe_ompl.robot.robot import Robot
from safe_ompl.scene.scenario import Scenario, list_scenarios
from safe_ompl.scene.scene import Scene

FINE, FINEST = 0.001, 0.0002  # [rad] between samples
NEAR = 0.005  # [m] how near hard edges pass to a contact
HARD_LENGTH = 0.05, 0.4  # [rad]
BANDS = (0.0, 0.005, 0.02, 0.05, 0.1, np.inf)  # [m]
PLANNERS = ("SafeRRTConnect", "RRTConnect")

Problem = tuple[str, Robot, Scene]
Edge = tuple[FloatArray, FloatArray]


def problems() -> list[Problem]:
    """Return six robots, among them one with continuous joints, in scattered scenes, a bookshelf and all scenarios."""
    names = {name: Robot.from_example(name) for name in ("panda", "ur5", "ur10", "xarm7", "kinova", "z1")}
    found = [
        (f"{name}, scattered {k}", robot, scattered(6, k)) for k, (name, robot) in enumerate(names.items())
    ]
    found.append(("panda, bookshelf", names["panda"], bookshelf()))
    for name, file in list_scenarios().items():
        scenario = Scenario.load(file)
        found.append((name, scenario.build_robot(), scenario.scene))
    return found


# ------------------------------------------------------------------------------------------------------ edges


def hard_edges(checker: CollisionChecker, rng: np.random.Generator) -> Iterator[Edge]:
    """Yield edges that pass a contact at less than `NEAR`: found by halving, then along it."""
    robot = checker.robot
    while True:
        free, touching = rng.uniform(robot.lower, robot.upper, (2, robot.n))
        if checker.in_collision(free) or not checker.in_collision(touching):
            continue
        wanted = rng.uniform(0.0, NEAR)
        while np.linalg.norm(touching - free) > 1e-6 and _distance(checker, free) > wanted:
            middle = (free + touching) / 2
            free, touching = (free, middle) if checker.in_collision(middle) else (middle, touching)
        slope = np.array(
            [_distance(checker, free + h) - _distance(checker, free) for h in 1e-4 * np.eye(robot.n)]
        )
        norm = float(np.linalg.norm(slope))
        along = rng.normal(size=robot.n)
        if norm > 1e-9:
            along -= (along @ slope) / norm**2 * slope
        along *= rng.uniform(*HARD_LENGTH) / max(float(np.linalg.norm(along)), 1e-9)
        start, end = free - rng.uniform(0.2, 0.8) * along, free + along
        if all((robot.within_limits(q)).all() for q in (start, end)):
            yield start, end


def _distance(checker: CollisionChecker, q: FloatArray) -> float:
    return float(checker.pair_distances(q).min(initial=np.inf))


def verdict_row(
    name: str, checker: CollisionChecker, edges: Iterator[Edge], number: int, step: float
) -> tuple[Counter[str], tuple[object, ...]]:
    """Check edges and look at them closely; return what was found, and a row of a table."""
    motion, found = MotionProver(checker), Counter[str]()
    for _ in range(number):
        start, end = next(edges)
        checker.counts.reset()
        verdict = motion.check(start, end)
        found["bounds"] += checker.counts.bound_queries
        found["margin"] += checker.counts.margin_queries
        found["plain"] += checker.counts.collision_queries
        found[verdict.verdict.value] += 1
        if verdict.verdict is Verdict.FREE:
            found["contradicted"] += not sampled_is_free(checker, start, end, step)
        elif verdict.verdict is Verdict.BLOCKED and verdict.at is not None:
            at = start + verdict.at * checker.robot.difference(start, end)
            found["contradicted"] += not checker.in_collision(at)
    found["edges"] = number
    return found, _verdict_cells(name, found)


def _verdict_cells(name: str, found: Counter[str]) -> tuple[object, ...]:
    number = found["edges"]
    shares = (
        f"{found[verdict.value] / number:.2%}"
        for verdict in (Verdict.FREE, Verdict.BLOCKED, Verdict.UNDECIDED)
    )
    return (
        name,
        number,
        found["contradicted"],
        *shares,
        *(found[kind] / number for kind in ("bounds", "margin", "plain")),
    )


def print_verdicts(
    number: int, step: float, make: Callable[[CollisionChecker, np.random.Generator], Iterator[Edge]]
) -> None:
    """Print the table of verdicts on `number` edges, spread over all problems."""
    chosen, rows, total = problems(), [], Counter[str]()
    for k, (name, robot, scene) in enumerate(chosen):
        checker = CollisionChecker(robot, scene)
        edges = make(checker, np.random.default_rng(k))
        found, row = verdict_row(name, checker, edges, ceil(number / len(chosen)), step)
        total += found
        rows.append(row)
    rows.append(_verdict_cells("all", total))
    header = (
        "problem",
        "edges",
        "contradicted",
        "free",
        "blocked",
        "undecided",
        "bound queries",
        "margin queries",
        "plain queries",
    )
    print_table(header, rows)


# ---------------------------------------------------------------------------------------------- bands and ideas


def free_edges(checker: CollisionChecker, number: int, seed: int) -> list[Edge]:
    """Return free edges of 1 rad."""
    motion, edges = (
        MotionProver(checker),
        random_edges(checker.robot, np.random.default_rng(seed), 1.0, 1.0),
    )
    return [edge for edge in (next(edges) for _ in range(200 * number)) if motion.is_free(*edge)][:number]


def print_bands(number: int) -> None:
    """Print queries per free edge by the least clearance of the edge."""
    queries: dict[int, list[tuple[float, ...]]] = {k: [] for k in range(len(BANDS) - 1)}
    for _, robot, scene in problems():
        checker = CollisionChecker(robot, scene)
        motion = MotionProver(checker)
        for start, end in free_edges(checker, number, 3):
            delta = robot.difference(start, end)
            least = min(_distance(checker, start + t * delta) for t in np.linspace(0, 1, 51))
            checker.counts.reset()
            begin = process_time()
            motion.is_free(start, end)
            middle, counts = process_time(), checker.counts.copy()
            sampled_is_free(checker, start, end, COARSE)
            ratio = (middle - begin) / max(process_time() - middle, 1e-6)
            band = int(np.searchsorted(BANDS, max(least, 0.0), "right")) - 1
            queries[min(band, len(BANDS) - 2)].append(
                (counts.bound_queries, counts.margin_queries, counts.collision_queries, ratio)
            )
    rows = [
        (f"{1e3 * BANDS[k]:g} to {1e3 * BANDS[k + 1]:g} mm", len(found), *np.mean(found, axis=0).tolist())
        for k, found in queries.items()
        if found
    ]
    queried = ("bound queries", "margin queries", "plain queries")
    print_table(("clearance", "free edges", *queried, "time / sampling at 0.01 rad"), rows)


class Subdivision:
    """Certified motions with one idea switched on at a time, on the checker's own queries."""

    def __init__(
        self,
        checker: CollisionChecker,
        *,
        capped: bool = False,
        centred: bool = False,
        first_reach: float = np.inf,
        last_pair: bool = False,
    ) -> None:
        self.checker, self.centred, self.first_reach, self.last_pair = (
            checker,
            centred,
            first_reach,
            last_pair,
        )
        bodies = checker.robot.bounds.displacement_radii
        pairs = np.array([(pair.first, pair.second) for pair in checker.geometry.collisionPairs], dtype=int)
        moves = np.vstack(
            [bodies, np.zeros((len(checker.geometry.geometryObjects) - len(bodies), checker.robot.n))]
        )
        first, second = moves[pairs[:, 0]], moves[pairs[:, 1]]
        plain = np.where((first > 0) != (second > 0), first + second, 0.0)
        self.radii = checker.pair_radii if capped else plain
        self.blocker: int | None = None

    def is_free(self, start: FloatArray, end: FloatArray) -> bool:
        checker, delta = self.checker, self.checker.robot.difference(start, end)
        steps = np.abs(delta)
        approach = self.radii @ steps
        widest = float(approach.max(initial=0.0))
        count = max(1, ceil(0.5 * widest / self.first_reach))
        half = 0.5 / count
        centres, unproven = [(2 * k + 1) * half for k in range(count)], []
        while True:
            known_free, unproven = set(unproven), []
            margins = half * approach
            for t in centres:
                q = start + t * delta
                if self.centred:
                    margins = half * np.minimum(checker.pair_radii_at(q), self.radii) @ steps
                if self._within(q, margins):
                    if t not in known_free and checker.in_collision(q):
                        return False
                    unproven.append(t)
            if not unproven:
                return True
            if half * widest < 1e-4:
                return False
            half /= 3
            centres = [t + side for t in unproven for side in (-2 * half, 0.0, 2 * half)]

    def _within(self, q: FloatArray, margins: FloatArray) -> bool:
        """Ask for the pair that failed last before all the others."""
        if not self.last_pair:
            return self.checker.pairs.within_margins(q, margins)
        queries, full = self.checker.pairs._queries, self.checker.robot.pinocchio_configuration(q)
        if self.blocker is not None:
            memory = queries._memory.own
            memory.set_margins(margins)
            pin.updateGeometryPlacements(
                queries.model, memory.kinematics, queries.geometry, memory.data, full
            )
            if pin.computeCollision(queries.geometry, memory.data, self.blocker):
                return True
        found = queries.touching(full, margins)
        self.blocker = self.blocker if found is None else found
        return found is not None


IDEAS: dict[str, dict[str, float | bool]] = {
    "plain": {},
    "obstacles' distances from the axes": {"capped": True},
    "radii at the centre": {"capped": True, "centred": True},
    "first intervals of 0.4 m": {"capped": True, "first_reach": 0.2},
    "first intervals of 0.1 m": {"capped": True, "first_reach": 0.05},
    "0.4 m, and the pair that failed last": {"capped": True, "first_reach": 0.2, "last_pair": True},
    "0.4 m, and radii at the centre": {"capped": True, "centred": True, "first_reach": 0.2},
}


def print_ideas(number: int) -> None:
    """Print what each idea gains on free 1-rad edges."""
    work: dict[str, list[tuple[float, float, float]]] = {idea: [] for idea in IDEAS}
    for _, robot, scene in problems():
        checker = CollisionChecker(robot, scene)
        edges = free_edges(checker, number, 4)
        for idea, options in IDEAS.items():
            motion = Subdivision(checker, **options)  # type: ignore[arg-type]
            best = np.inf
            for _ in range(3):
                checker.counts.reset()
                begin = process_time()
                for edge in edges:
                    motion.is_free(*edge)
                best = min(best, process_time() - begin)
            work[idea].append((checker.counts.margin_queries, checker.counts.collision_queries, best))
    base = np.array(work["plain"])
    rows = [(idea, *np.median(np.array(found) / base, axis=0).tolist()) for idea, found in work.items()]
    print_table(
        ("idea (ratios to plain, medians of the problems)", "margin queries", "plain queries", "time"), rows
    )


# ------------------------------------------------------------------------------------------------------ danger


def random_path(robot: Robot, rng: np.random.Generator, edges: int) -> FloatArray:
    """Return a path through random configurations."""
    start = rng.uniform(robot.lower, robot.upper)
    steps = rng.normal(size=(edges, robot.n)) * rng.uniform(0.1, 1.0, (edges, 1))
    path = start + np.vstack([np.zeros((1, robot.n)), np.cumsum(steps, axis=0)])
    return np.where(robot.continuous, path, np.clip(path, robot.lower, robot.upper))


def print_danger(number: int) -> None:
    """Print how tight and dear proven peaks of danger are."""
    rows = []
    for name, file in list_scenarios().items():
        setup = setup_scenario(Scenario.load(file))
        if setup.field is None:
            continue
        rng = np.random.default_rng(5)
        paths = [setup.plan(PLANNERS[k % 2], seed=k, time=5.0).path for k in range(number)]
        rows.append(
            (f"{name}, planned", *danger_cells(setup.field, [path for path in paths if path is not None]))
        )
        paths = [random_path(setup.robot, rng, int(rng.integers(1, 6))) for _ in range(number)]
        rows.append((f"{name}, random", *danger_cells(setup.field, paths)))
    header = (
        "paths",
        "number",
        "violations",
        "slack median",
        "max",
        "unbounded",
        "evaluations / profile",
        "max",
        "time / profile",
    )
    print_table(header, rows)


def danger_cells(field: DangerField, paths: list[FloatArray]) -> tuple[object, ...]:
    """Return number of paths, violations, slack of those that are bounded, evaluations and time against a profile."""
    danger, slack, asked, times, violations, unbounded = CertifiedDanger(field), [], [], [], 0, 0
    for path in paths:
        curve = Curve(field.robot, path)
        usual = max(PROFILE_POINTS, 1 + ceil(curve.length / 0.05))
        profile = curve.at(np.linspace(0.0, curve.length, usual))
        begin = process_time()
        field.values(profile)
        middle, before = process_time(), field.counts.field_configurations
        bounds = danger.of_path(path)
        times.append((process_time() - middle) / max(middle - begin, 1e-6))
        asked.append((field.counts.field_configurations - before) / usual)
        dense = field.values(curve.at(np.linspace(0.0, curve.length, 2 + int(curve.length / FINE)))).max()
        violations += bool(dense > bounds.upper * (1 + 1e-9))
        if np.isfinite(bounds.upper):
            slack.append(bounds.upper / max(float(dense), bounds.lower) - 1)
        else:
            unbounded += 1
    cells = (f"{np.median(slack):.1%}", f"{max(slack):.1%}")
    return (
        len(paths),
        violations,
        *cells,
        unbounded,
        float(np.median(asked)),
        max(asked),
        float(np.median(times)),
    )


# ------------------------------------------------------------------------------------------------------ verify


def print_verifying(number: int) -> None:
    """Print what it costs to check certificates, in relation to planning."""
    rows = []
    for name, file in list_scenarios().items():
        setup = setup_scenario(Scenario.load(file))
        times, holds = [], 0
        for seed in range(number):
            begin = process_time()
            result = setup.plan("SafeRRTConnect", seed=seed, time=5.0)
            planned = process_time() - begin
            if result.path is None:
                continue
            begin = process_time()
            setup.report(result.path)
            reported = process_time() - begin
            begin = process_time()
            content = certificate(result.path, setup.robot, setup.scene, field=setup.field)
            written = process_time() - begin
            begin = process_time()
            holds += bool(verify(content, setup.robot, setup.scene).intervals)
            checked = process_time() - begin
            search = max(planned - reported, 1e-3)
            times.append((1e3 * search, 1e3 * planned, 1e3 * written, 1e3 * checked))
        ratios = [checked / search for search, _, _, checked in times]
        rows.append(
            (
                name,
                f"{holds}/{len(times)}",
                *np.median(times, axis=0).tolist(),
                float(np.median(ratios)),
                max(ratios),
            )
        )
    header = (
        "scenario",
        "hold",
        "search [ms]",
        "plan and report",
        "write",
        "verify",
        "verify / search",
        "max",
    )
    print_table(header, rows)


PARTS = ("verdicts", "hard", "bands", "ideas", "danger", "verify")


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--edges", type=int, default=5000, help="random edges, over all problems")
    parser.add_argument("--hard", type=int, default=500, help="edges that nearly touch, over all problems")
    parser.add_argument("--free", type=int, default=20, help="free edges per problem, for bands and ideas")
    parser.add_argument("--paths", type=int, default=10, help="paths per scenario, for danger and verify")
    parser.add_argument("--only", nargs="+", choices=PARTS, default=PARTS, help="parts to run")
    options = parser.parse_args()
    parts: dict[str, Callable[[], None]] = {
        "verdicts": lambda: print_verdicts(
            options.edges, FINE, lambda checker, rng: random_edges(checker.robot, rng, 0.1, 1.5)
        ),
        "hard": lambda: print_verdicts(options.hard, FINEST, hard_edges),
        "bands": lambda: print_bands(options.free),
        "ideas": lambda: print_ideas(options.free),
        "danger": lambda: print_danger(options.paths),
        "verify": lambda: print_verifying(options.paths),
    }
    for part in options.only:
        print(f"\n{part}", flush=True)
        parts[part]()


if __name__ == "__main__":
    main()
