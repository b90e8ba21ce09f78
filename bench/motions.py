"""What proofs of others' motions are worth: random splines against samples, tubes, repairs, and times.

pieces     Random pieces of splines (cubic and quintic Hermite, B-splines of degree 2 to 5) of six robots among things
           at random places, every tenth one shifted until its clearance is 0.1 to 1 mm. One that is called free is
           looked at every 0.0002 rad with plain coal calls, one that is called blocked must touch where it says:
           `contradicted` must be 0. Targets for undecided ones: 0.1 %, and 5 % of the near ones.
time       Clamped cubic splines of ten pieces along planned paths: 7 joints at a shelf, 14 joints among things. Targets
           for the medians: 3 and 10 ms.
tubes      Motions that are proven within random tubes: those of the tube that seem to come nearest, and random ones,
           looked at with plain coal calls; and the widest tube that is proven, against one at which a motion touches.
repair     Planned paths and splines through them, disturbed; and those of MotionBenchMaker's problems in FILE.
"""

from __future__ import annotations

import argparse
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from time import process_time
from typing import NamedTuple

import numpy as np
from scipy.interpolate import BPoly, BSpline, CubicHermiteSpline, CubicSpline

from bench._harness import Report, positions
from bench._plain import TOLERANCE, PlainGeometry
from bench._planning import mbm_problems
from bench._scenes import free_configuration, scattered, two_arms
from safe_ompl import CollisionChecker, Motion, MotionProver, Robot, SafeSetup, Scenario, Scene, Verdict, widest_tube
from safe_ompl.collision import Separation
from safe_ompl.common import FloatArray, polynomials
from safe_ompl.motions import check_with, repair_with
from safe_ompl.motions.pieces import PieceProofs
from safe_ompl.planning import setup_scenario
from safe_ompl.planning.safe_setup import connecting

CLAIM = "splines that are called free are free, tubes hold, and what touches is repaired"
STEP = 0.0002  # [rad] between samples
NEAR = 1e-4, 1e-3  # [m] clearance of near pieces
LENGTHS, NEAR_LENGTHS = (0.05, 1.5), (0.05, 0.4)  # [rad]

Curve = Callable[[FloatArray], FloatArray]  # from times in [0, 1] to configurations


class Piece(NamedTuple):
    """A piece as our own motion, and as SciPy has it."""

    kind: str
    motion: Motion
    curve: Curve


def touched(plain: PlainGeometry, Q: FloatArray) -> bool:
    """Return whether anything touches at any of the configurations along a curve `Q: (S, n)`."""
    return plain.least(Q, 1e-7)[0] <= 0.0


# ----------------------------------------------------------------------------------------------------- pieces


def problems() -> list[tuple[str, Robot, Scene]]:
    """Return six robots, each among things at random places."""
    robots = {name: Robot.from_example(name) for name in ("panda", "ur5", "kinova", "xarm7")}
    robots["ur5 on wheels"] = Robot.from_example("ur5", mobile_base=((-1.0, 1.0), (-1.0, 1.0)))
    robots["baxter, two arms"] = two_arms()
    return [(name, robot, scattered(6, k)) for k, (name, robot) in enumerate(robots.items())]


def random_piece(
    robot: Robot, rng: np.random.Generator, room: FloatArray | float = 0.0, lengths: tuple[float, float] = LENGTHS
) -> Piece:
    """Return a piece whose control points are within the limits, and so when it is shifted by `room: (n,)`."""
    n, span = robot.n, float(rng.uniform(0.1, 2.0))
    while True:
        kind, length = str(rng.choice(["cubic", "quintic", "B-spline"])), rng.uniform(*lengths)
        if kind == "B-spline":
            degree = int(rng.integers(2, 6))
            knots = np.cumsum(rng.uniform(0.2, 1.0, 2 * degree + 2))
            shifts = [_direction(rng, n) * length / np.sqrt(degree) for _ in range(degree)]
            points = np.vstack([np.zeros(n), np.cumsum(shifts, axis=0)])
            offsets = points
        else:
            ends, times = np.array([np.zeros(n), _direction(rng, n) * length]), np.array([0.0, span])
            rates = np.array([_direction(rng, n) for _ in range(4)]) * length * rng.uniform(0, 2, (4, 1))
            rates = rates / span ** np.array([[1], [1], [2], [2]])
            given = rates[:2], (rates[2:] if kind == "quintic" else None)
            offsets = polynomials.bernstein(Motion.hermite(times, ends, *given).coefficients)[0]
        offsets = np.vstack([offsets, offsets + room])
        low, high = robot.lower - offsets.min(axis=0), robot.upper - offsets.max(axis=0)
        if (high > low).all():
            break
    q = rng.uniform(low, high)
    if kind == "B-spline":
        spline = BSpline(knots, q + points, degree)
        return Piece(kind, Motion.of(spline), _of(spline, knots[degree], knots[degree + 1]))
    motion = Motion.hermite(times, q + ends, *given)
    if kind == "cubic":
        return Piece(kind, motion, _of(CubicHermiteSpline(times, q + ends, given[0]), 0.0, span))
    data = np.stack([q + ends, rates[:2], rates[2:]], axis=1)
    return Piece(kind, motion, _of(BPoly.from_derivatives(times, data), 0.0, span))


def _direction(rng: np.random.Generator, n: int) -> FloatArray:
    found = rng.normal(size=n)
    return np.array(found / np.linalg.norm(found))


def _of(curve: Curve, first: float, last: float) -> Curve:
    return lambda u: curve(np.clip(first + u * (last - first), first, last))


def samples(curve: Curve) -> FloatArray:
    """Return configurations along a curve, no farther than `STEP` apart."""
    count = 200
    while True:
        Q = curve(np.linspace(0.0, 1.0, count + 1))
        longest = float(np.linalg.norm(np.diff(Q, axis=0), axis=1).max())
        if longest <= STEP:
            return Q
        count = int(np.ceil(1.02 * count * longest / STEP))


def near_piece(robot: Robot, plain: PlainGeometry, rng: np.random.Generator) -> tuple[Piece, float]:
    """Return a piece that is shifted from where it is free towards where it is not, and its clearance [m]."""
    while True:
        shift = _direction(rng, robot.n) * rng.uniform(0.1, 1.0)
        piece, low, high = random_piece(robot, rng, shift, NEAR_LENGTHS), 0.0, 1.0
        Q = samples(piece.curve)
        coarse = Q[::10]
        if any(map(plain.touches, coarse[[0, -1]])) or touched(plain, coarse):
            continue
        if not any(map(plain.touches, coarse[::20] + shift)):
            continue
        for _ in range(30):
            middle = 0.5 * (low + high)
            clearance = plain.least(coarse + middle * shift, NEAR[1])[0]
            if NEAR[0] <= clearance < NEAR[1]:
                clearance = plain.least(Q + middle * shift, NEAR[1])[0]
                if NEAR[0] <= clearance:
                    return _shifted(piece, middle * shift), clearance
            low, high = (middle, high) if clearance > NEAR[0] else (low, middle)


def _shifted(piece: Piece, shift: FloatArray) -> Piece:
    motion = piece.motion
    coefficients = motion.coefficients.copy()
    coefficients[:, 0] += shift
    rounding = 0.0 if motion.rounding is None else motion.rounding
    rounding = rounding + 4e-16 * np.abs(coefficients).sum(axis=1)
    moved = Motion(motion.times, coefficients, rounding=rounding)
    return Piece(piece.kind, moved, lambda u: piece.curve(u) + shift)


def pieces(options: argparse.Namespace, report: Report) -> int:
    """Report verdicts on random pieces."""
    chosen = [
        (name, MotionProver(CollisionChecker(robot, scene)), PlainGeometry(robot, scene))
        for name, robot, scene in problems()
    ]
    for _, proof, _ in chosen:  # kernels are compiled before the first piece
        PieceProofs(random_piece(proof.checker.robot, np.random.default_rng(0)).motion, proof)[0].verdict()
    found: dict[str, Counter[str]] = {}
    for k in range(options.number):
        name, proof, plain = chosen[k % len(chosen)]
        rng = np.random.default_rng((options.seed, k))
        if k // len(chosen) % 10:
            piece, kind = random_piece(proof.checker.robot, rng), name
        else:
            (piece, _), kind = near_piece(proof.checker.robot, plain, rng), f"{name}, near"
        counts = found.setdefault(kind, Counter())
        before, begin = replace(proof.checker.counts), process_time()
        verdict = PieceProofs(piece.motion, proof)[0].verdict()
        counts["time"] += int(1e9 * (process_time() - begin))
        work = proof.checker.counts - before
        counts["bounds"] += work.bound_queries
        counts["coal"] += work.margin_queries + work.collision_queries
        counts["pieces"] += 1
        counts[verdict.verdict.value] += 1
        if verdict.verdict is Verdict.FREE:
            wrong = touched(plain, samples(piece.curve))
        else:
            wrong = verdict.verdict is Verdict.BLOCKED and not _touches(piece, verdict.at, plain)
        counts["contradicted"] += wrong
        if wrong or verdict.verdict is Verdict.UNDECIDED:
            print(f"piece {k} (seed {options.seed}): {kind}, {piece.kind}: {verdict}", flush=True)
    near = [counts for kind, counts in found.items() if kind.endswith("near")]
    others = [counts for kind, counts in found.items() if not kind.endswith("near")]
    found["all"], found["all, near"] = (sum(part, Counter()) for part in (others, near))
    header = ("robot", "pieces", "contradicted", "free", "blocked", "undecided")
    rows = [_piece_row(kind, counts) for kind, counts in found.items() if counts["pieces"]]
    report.table((*header, "bound queries", "coal queries", "time [ms]"), rows)
    total = found["all"] + found["all, near"]
    what = "random pieces of splines, every tenth within 1 mm of contact, sampled every 0.0002 rad"
    report.counted(what, total["pieces"], total["contradicted"], total[Verdict.UNDECIDED.value])
    return int(total["contradicted"] > 0)


def _touches(piece: Piece, at: float | None, plain: PlainGeometry) -> bool:
    return at is not None and plain.distances(piece.curve(np.array([at]))[0]).min() < TOLERANCE


def _piece_row(kind: str, counts: Counter[str]) -> tuple[object, ...]:
    number = counts["pieces"]
    shares = (f"{counts[verdict.value] / number:.3%}" for verdict in Verdict)
    each = (counts["bounds"] / number, counts["coal"] / number, 1e-6 * counts["time"] / number)
    return (kind, number, counts["contradicted"], *shares, *each)


# ------------------------------------------------------------------------------------------------------- time


def planned_paths(setup: SafeSetup, number: int) -> list[FloatArray]:
    """Return simplified paths of a setup."""
    results = (setup.plan("SafeRRTConnect", seed=seed, time=10.0, simplify=True) for seed in range(number))
    return [result.path for result in results if result.path is not None]


def shelf_problem() -> tuple[SafeSetup, list[FloatArray]]:
    """Return the Panda's shelf, and paths."""
    setup = setup_scenario(Scenario.load("panda_shelf"))
    return setup, planned_paths(setup, 8)


def two_arm_problem() -> tuple[SafeSetup, list[FloatArray]]:
    """Return two arms among things, and paths from one random configuration to another."""
    robot, scene, rng = two_arms(), scattered(6, 5), np.random.default_rng(0)
    setup, checker, paths = SafeSetup(robot, scene), CollisionChecker(robot, scene), []
    while len(paths) < 8:
        setup.setConfigurations(free_configuration(checker, rng), free_configuration(checker, rng))
        paths += planned_paths(setup, 1)
    return setup, paths


def disturbed(robot: Robot, path: FloatArray, noise: float, rng: np.random.Generator, pieces: int = 10) -> FloatArray:
    """Return way points (pieces + 1, n) at even steps of a path, with noise [rad] but for the ends."""
    steps = robot.difference(path[:-1], path[1:])
    path = path[0] + np.vstack([np.zeros(robot.n), np.cumsum(steps, axis=0)])
    travelled = np.append(0.0, np.cumsum(np.linalg.norm(steps, axis=1)))
    at = np.linspace(0.0, travelled[-1], pieces + 1)
    points = np.stack([np.interp(at, travelled, path[:, i]) for i in range(robot.n)], axis=1)
    points[1:-1] += rng.normal(scale=noise, size=points[1:-1].shape)
    return np.where(robot.continuous, points, np.clip(points, robot.lower + 0.02, robot.upper - 0.02))


def splines(robot: Robot, paths: list[FloatArray], noise: float, seed: int) -> Iterator[Motion]:
    """Yield clamped cubic splines of ten pieces along paths, with noise."""
    rng = np.random.default_rng(seed)
    while True:
        points = disturbed(robot, paths[int(rng.integers(len(paths)))], noise, rng)
        yield Motion.of(CubicSpline(np.arange(len(points)), points, bc_type="clamped"))


def times(options: argparse.Namespace, report: Report) -> int:
    """Report what it takes to check splines of ten pieces."""
    rows, wrong = [], 0
    for name, (setup, paths) in (("7 joints, shelf", shelf_problem()), ("14 joints", two_arm_problem())):
        proof = MotionProver(CollisionChecker(setup.robot, setup.scene))
        plain = PlainGeometry(setup.robot, setup.scene)
        for noise in (0.0, 0.05):
            made = splines(setup.robot, paths, noise, 1)
            found: dict[bool, list[tuple[float, ...]]] = {True: [], False: []}
            contradicted = 0
            for motion in (next(made) for _ in range(options.splines)):
                pieces = PieceProofs(motion, proof)  # what proves it within its rounding
                before, begin = replace(proof.checker.counts), process_time()
                proven = all(pieces[k].proven() for k in range(len(pieces)))
                milliseconds = 1e3 * (process_time() - begin)
                work = proof.checker.counts - before
                queries = work.margin_queries + work.collision_queries
                begin = process_time()
                check_with(motion, proof)
                whole = 1e3 * (process_time() - begin)
                found[proven].append((milliseconds, work.bound_queries, queries, whole))
                if proven:
                    Q = samples(lambda u, m=motion: m.at(m.times[0] + u * m.duration))
                    contradicted += touched(plain, Q)
            for proven, cells in found.items():
                if cells:
                    middle = np.median(cells, axis=0).tolist()
                    high = float(np.percentile(cells, 90, axis=0)[0])
                    said = "proven" if proven else "not proven"
                    rows.append((f"{name}, noise {noise:g}, {said}", len(cells), middle[0], high, *middle[1:]))
            rows.append((f"{name}, noise {noise:g}: contradicted", contradicted, *[""] * 5))
            wrong += contradicted
    header = ("splines", "number", "proofs [ms]", "90 %", "bound queries", "coal queries", "checked() [ms]")
    report.table(header, rows)
    return int(wrong > 0)


# ------------------------------------------------------------------------------------------------------ tubes


def worst_within(proof: MotionProver, Q: FloatArray, tube: FloatArray, rng: np.random.Generator) -> FloatArray:
    """Return corners (S, n) of the tube about `Q: (S, n)` where near pairs come nearer, to the first order."""
    checker, sizes = proof.checker, 1e-6 * np.eye(Q.shape[1])
    corners = np.empty_like(Q)
    for k, q in enumerate(Q):
        apart = checker.pair_distances(q)
        pair = int(rng.choice(np.argsort(apart)[:3]))
        slope = [checker.pair_distances(q + h)[pair] - apart[pair] for h in sizes]
        corners[k] = q - tube * np.where(np.array(slope) > 0, 1.0, -1.0)
    return corners


def tubes(options: argparse.Namespace, report: Report) -> int:
    """Report contacts of motions in proven tubes, and how near the widest tubes come to a contact."""
    rows = []
    share = -(-options.tubes // 6)
    for number, (name, robot, scene) in enumerate(problems()):
        rng = np.random.default_rng((options.seed, number))
        checker, plain = CollisionChecker(robot, scene), PlainGeometry(robot, scene)
        contacts, proven, times, ratios, looked = 0, 0, [], [], 0
        while proven < share:
            motion = random_piece(robot, rng).motion.for_robot(robot)
            tube = rng.uniform(0.0, 10.0 ** rng.uniform(-3.5, -1.3), robot.n)
            separation = Separation(tube=tuple(tube.tolist()))
            proof = MotionProver(checker, separation=separation)
            if not PieceProofs(motion, proof)[0].proven():
                continue
            proven += 1
            t = np.linspace(motion.times[0], motion.times[-1], 9)
            Q = motion.at(t)
            corners = np.vstack([worst_within(proof, Q, tube, rng), Q + tube * rng.choice([-1.0, 1.0], Q.shape)])
            contacts += sum(plain.distances(q).min() <= 0.0 for q in corners)
            t = np.linspace(motion.times[0], motion.times[-1], 400)
            waves = rng.uniform(0.5, 20.0, (2, robot.n)), rng.uniform(0, 2 * np.pi, robot.n)
            wander = np.sin(np.linspace(0, 1, 400)[:, None] * waves[0][0] * 6 + waves[1])
            contacts += touched(plain, motion.at(t) + tube * wander)
            looked += len(corners) + 1
            if proven % 10 == 0:
                begin = process_time()
                width = float(widest_tube(motion, robot, scene).max())
                times.append(1e3 * (process_time() - begin))
                touching = _touching_width(proof, plain, motion, width, rng) if width > 0 else np.inf
                if np.isfinite(touching):
                    ratios.append(width / touching)
        widest = (float(np.median(found)) if found else np.nan for found in (times, ratios))
        cells = (next(widest), max(times, default=np.nan), next(widest))
        cells += (min(ratios, default=np.nan), max(ratios, default=np.nan))
        rows.append((name, proven, looked, contacts, *cells))
        print(f"{name}: {contacts} contacts in {proven} tubes", flush=True)
    header = ("robot", "tubes", "looked at", "contacts", "widest_tube [ms]", "max")
    report.table((*header, "widest proven / touching", "min", "max"), rows)
    contacts, looked = (sum(row[k] for row in rows) for k in (3, 2))
    report.counted(f"configurations and motions in {sum(row[1] for row in rows)} proven tubes", looked, contacts)
    return int(contacts > 0)


def _touching_width(
    proof: MotionProver, plain: PlainGeometry, motion: Motion, width: float, rng: np.random.Generator
) -> float:
    """Return a width of the tube [rad] in which a motion touches something, found by corners; inf if there is none."""
    Q = motion.at(np.linspace(motion.times[0], motion.times[-1], 33))
    best = np.inf
    for share in (1.0, 1.25, 1.6, 2.0, 3.0, 5.0, 8.0):
        corners = worst_within(proof, Q, np.full(motion.n, share * width), rng)
        for q, corner in zip(Q, corners, strict=True):
            if plain.distances(corner).min() <= 0.0:
                low, high = 0.0, min(share * width, best)
                way = (corner - q) / (share * width)
                if plain.distances(q + high * way).min() > 0.0:
                    continue
                while high - low > 1e-3 * high:
                    middle = 0.5 * (low + high)
                    low, high = (low, middle) if plain.distances(q + middle * way).min() <= 0 else (middle, high)
                best = high
        if np.isfinite(best):
            break
    return best


# ------------------------------------------------------------------------------------------------------ repair


def disturbances(robot: Robot, path: FloatArray, rng: np.random.Generator) -> Iterator[tuple[str, Motion]]:
    """Yield motions along a path, some of which touch something: lines and splines, with noise and without."""
    for noise in (0.05, 0.2, 0.4):
        points = disturbed(robot, path, noise, rng)
        yield f"lines, noise {noise:g}", Motion.through(points)
        times = np.arange(len(points), dtype=np.float64)
        yield f"spline, noise {noise:g}", Motion.of(CubicSpline(times, points, bc_type="clamped"))
    points = disturbed(robot, path, 0.0, rng)
    times = np.arange(len(points), dtype=np.float64)
    yield "spline through the path", Motion.of(CubicSpline(times, points, bc_type="clamped"))


def repairs(options: argparse.Namespace, report: Report) -> None:
    """Report what becomes of disturbed paths."""
    rows = repair_rows("shelf", [shelf_problem()], 8 if options.repairs is None else options.repairs)
    if options.file:
        setups = (problem.setup for problem in mbm_problems(options.file, options.problems))
        rows += repair_rows("MBM", ((setup, planned_paths(setup, 1)) for setup in setups), 1)
    header = ("motions", "touch", "repaired", "moved", "touch after", "time [ms]", "90 %")
    report.table((*header, "deviation [rad]", "90 %", "[mm]", "90 %"), rows)


def repair_rows(name: str, known: object, rounds: int) -> list[tuple[object, ...]]:
    """Return rows of the table of repairs."""
    found: dict[str, list[tuple[float, ...]]] = {}
    rng = np.random.default_rng(3)
    for setup, paths in known:  # type: ignore[attr-defined]
        proof = MotionProver(CollisionChecker(setup.robot, setup.scene))
        plain = PlainGeometry(setup.robot, setup.scene)
        for path in paths[:rounds]:
            for kind, motion in disturbances(setup.robot, path, rng):
                if check_with(motion, proof):
                    continue
                begin = process_time()
                connect = connecting(partial(SafeSetup, setup.robot, setup.scene), 3.0)
                repair = repair_with(motion, proof, connect=connect)
                milliseconds = 1e3 * (process_time() - begin)
                after = repair.motion
                t = np.linspace(after.times[0], after.times[-1], 20_000)
                touches = bool(repair) and touched(plain, after.at(t))
                cells = (bool(repair), repair.how == "moved", touches, milliseconds)
                found.setdefault(kind, []).append((*cells, repair.deviation, repair.tool_deviation))
                if not repair:
                    print(f"{name}, {kind}: {repair.how}", flush=True)
    rows = []
    for kind, cells in [*found.items(), ("all", [cell for part in found.values() for cell in part])]:
        held = np.array(cells)
        good = held[held[:, 0] > 0]
        numbers = [float(x) for k in (3, 4, 5) for x in np.percentile(good[:, k], [50, 90])]
        counts = (len(held), int(held[:, 0].sum()), int(held[:, 1].sum()), int(held[:, 2].sum()))
        rows.append((f"{name}, {kind}", *counts, *numbers))
    return rows


PARTS = {"pieces": pieces, "time": times, "tubes": tubes, "repair": repairs}


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options."""
    parser.add_argument("file", nargs="?", help="of MotionBenchMaker, for repair")
    parser.add_argument("--number", type=int, default=6000, help="pieces (default: %(default)s)")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--splines", type=int, default=100, help="that are timed (default: %(default)s)")
    parser.add_argument("--tubes", type=int, default=1000, help="(default: %(default)s)")
    parser.add_argument("--problems", type=positions, default="0:10", metavar="A:B", help="of each family of FILE")
    parser.add_argument("--repairs", type=int, help="paths at the shelf (default: 8)")
