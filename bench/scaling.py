"""How time grows with size: nodes, obstacles, points of a cloud, danger points, joints.

One table for each kind of size, by options like --nodes 1000 100000. Times are CPU times per item [µs], medians of some
rounds; the last row is the exponent p of time ~ sizeᵖ, fitted to all rows. Nodes: `node` is what a planner does for
one, the choice of the node to grow from (by distance, and by distance and danger), a step, the proof of its edge, and
its danger. Points lie on the surfaces of boxes about the arm.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from bench._harness import Report
from bench._scenes import scattered, tiled
from safe_ompl import (
    CollisionChecker,
    DangerField,
    DangerObjective,
    MotionProver,
    Obstacle,
    PointCloud,
    Robot,
    SafeSetup,
    Scene,
)
from safe_ompl.common import FloatArray
from safe_ompl.danger.field import AGGREGATES
from safe_ompl.planning.ompl import StateCost
from safe_ompl.planning.planners.growth import Tree
from safe_ompl.robot import StateBridge

CLAIM = "time grows slowly with obstacles, danger points and nodes"
ROUNDS, ITEMS = 5, 80  # configurations in all
SIZES = {
    "nodes": (100, 1000, 10_000, 100_000),
    "obstacles": (10, 100, 1000, 10_000),
    "cloud": (1000, 1_000_000),
    "points": (1, 10, 100, 1000, 10_000, 100_000),
    "joints": (2, 4, 7, 10, 14),
}
Row = dict[str, float]

LINK = """<link name="link{k}"><collision><origin xyz="0 0 {middle}"/><geometry><box size="0.04 0.04 {length}"/>
</geometry></collision></link>"""
JOINT = """<joint name="joint{k}" type="revolute"><parent link="link{k}"/><child link="link{next}"/>
<origin xyz="0 0 {length}"/><axis xyz="{axis}"/><limit lower="-2.5" upper="2.5" effort="1" velocity="1"/></joint>"""


def snake(joints: int) -> Robot:
    """Return an arm 1 m long of so many joints that turn about x and y by turns."""
    length = 1.0 / (joints + 1)
    parts = [LINK.format(k=k, length=0.8 * length, middle=0.5 * length) for k in range(joints + 1)]
    parts += [JOINT.format(k=k, next=k + 1, length=length, axis="0 1 0" if k % 2 else "1 0 0") for k in range(joints)]
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "snake.urdf"
        file.write_text(f'<robot name="snake">{"".join(parts)}</robot>', encoding="utf-8")
        return Robot.from_urdf(file)


def surfaces(number: int) -> FloatArray:
    """Return points (number, 3) on six boxes about an arm."""
    rng = np.random.default_rng(0)
    centers = rng.uniform([0.3, -0.6, 0.0], [0.8, 0.6, 0.9], (6, 3))
    points = rng.uniform(-0.2, 0.2, (number, 3))
    points[np.arange(number), rng.integers(3, size=number)] = rng.choice([-0.2, 0.2], number)
    return points + centers[rng.integers(6, size=number)]


def timed(call: Callable[[FloatArray], object], Q: FloatArray) -> float:
    """Return the CPU time [µs] of a call, the median over rounds, each with its share of configurations `Q: (B, n)`."""
    call(Q[0])
    taken = []
    for share in np.array_split(Q, ROUNDS):
        begin = time.process_time()
        for q in share:
            call(q)
        taken.append((time.process_time() - begin) / len(share))
    return 1e6 * float(np.median(taken))


def some(robot: Robot, number: int = ITEMS) -> FloatArray:
    """Return random configurations (number, n)."""
    return np.random.default_rng(0).uniform(robot.lower, robot.upper, (number, robot.n))


def nodes(size: int) -> Row:
    """Return times at a tree of so many nodes."""
    setup = SafeSetup(Robot.from_example("panda"), scattered(6))
    robot, motion = setup.robot, MotionProver(setup.checker)
    field = DangerField(robot, surfaces(10))
    bridge = StateBridge(setup.getStateSpace())
    cost = StateCost(DangerObjective(setup.getSpaceInformation(), field), bridge)
    tree, alpha = Tree(bridge, cost), 0.1
    tree.add((robot.lower + robot.upper) / 2)
    targets, others = np.split(some(robot, size + 2 * ITEMS), [size - 1])

    def step(q: FloatArray, alpha: float) -> tuple[FloatArray, int]:
        near = tree.best(q, alpha)
        delta = q - tree.configurations[near]
        return tree.configurations[near] + delta * min(1.0, 0.2 / np.linalg.norm(delta)), near

    def grow(q: FloatArray) -> None:
        new, near = step(q, alpha)
        motion.is_free(tree.configurations[near], new)
        tree.add(new, near)

    for q in targets[:-ITEMS]:
        tree.add(*step(q, 0.0))
    whole = timed(grow, targets[-ITEMS:])
    return {
        "nearest": timed(lambda q: tree.best(q, 0.0), others),
        "nearest and safest": timed(lambda q: tree.best(q, alpha), others),
        "node": whole,
    }


def obstacles(size: int) -> Row:
    """Return times among so many tiles of a wall and a table, of making the checker and a plan around it, too."""
    return _among(tiled(size), size)


def cloud(size: int) -> Row:
    """Return the same with so many points on that wall and that table instead."""
    rng, wall, table = np.random.default_rng(0), [[0.44, -0.5, 0.05], [0.46, 0.5, 0.45]], [[0.5, -0.5], [1.0, 0.5]]
    places = rng.uniform(*wall, (size, 3))
    places[::2, :2], places[::2, 2] = rng.uniform(*table, (len(places[::2]), 2)), 0.0
    return _among(Scene([Obstacle("cloud", PointCloud(0.01, points=places))]), size)


def _among(scene: Scene, size: int) -> Row:
    robot = Robot.from_example("panda")
    begin = time.process_time()
    checker = CollisionChecker(robot, scene)
    making = 1e6 * (time.process_time() - begin)
    Q, setup, plans = some(robot, 20), SafeSetup(robot, scene), []
    ends = np.array([0.0, -0.2, 0.0, -2.0, 0.0, 1.9, 0.8]) + np.outer([-1.2, 1.2], np.eye(7)[0])
    setup.setConfigurations(ends[0], [ends[1]])
    for seed in range(ROUNDS + 1):  # the first one also makes tables, and compiles
        setup.prepare("SafeRRTConnect", seed)
        begin = time.process_time()
        setup.solve(60.0)
        plans.append(1e6 * (time.process_time() - begin))
        if not setup.haveExactSolutionPath():
            raise RuntimeError(f"no plan among {size} obstacles with seed {seed}")
    return {
        "collision query": timed(checker.in_collision, Q),
        "all distances": timed(checker.distances, Q[:5]),
        "making the checker": making,
        "a plan": float(np.median(plans[1:])),
    }


def points(size: int) -> Row:
    """Return times of the danger at so many points, by each aggregate, and the first call, which groups them."""
    robot, places = Robot.from_example("panda"), surfaces(size)
    Q, row = some(robot), Row()
    for aggregate in AGGREGATES:
        field = DangerField(robot, places, aggregate=aggregate)
        begin = time.process_time()
        field.value(Q[0])
        first = 1e6 * (time.process_time() - begin)
        row[aggregate] = timed(field.value, Q)
        row[f"{aggregate}, gradient"] = timed(lambda q, field=field: field.values_and_gradients(q[None]), Q)
    return row | {"first call": first}


def joints(size: int) -> Row:
    """Return times for an arm of so many joints."""
    robot = snake(size)
    field, checker = DangerField(robot, surfaces(10)), CollisionChecker(robot, scattered(6))
    Q = some(robot)
    return {
        "key points": timed(robot.keypoints, Q),
        "danger": timed(field.value, Q),
        "with gradient": timed(lambda q: field.values_and_gradients(q[None]), Q),
        "collision query": timed(checker.in_collision, Q),
    }


STUDIES: dict[str, Callable[[int], Row]] = {
    "nodes": nodes,
    "obstacles": obstacles,
    "cloud": cloud,
    "points": points,
    "joints": joints,
}


def exponent(sizes: list[int], times: list[float]) -> float:
    """Return p of the least-squares fit of time ~ sizeᵖ."""
    return float(np.polyfit(np.log(sizes), np.log(times), 1)[0])


def table(rows: dict[int, Row]) -> list[tuple[object, ...]]:
    """Return the rows of one kind of size, and their exponents."""
    names = list(next(iter(rows.values())))
    found: list[tuple[object, ...]] = [(size, *row.values()) for size, row in rows.items()]
    if len(rows) > 1:
        fits = (exponent(list(rows), [row[name] for row in rows.values()]) for name in names)
        found.append(("exponent", *fits))
    return found


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options."""
    for kind, sizes in SIZES.items():
        said = f"default: {' '.join(map(str, sizes))}"
        parser.add_argument(f"--{kind}", type=int, nargs="*", metavar="N", help=said)


def main(options: argparse.Namespace, report: Report) -> None:
    """Report a table for each kind of size."""
    chosen = {kind: getattr(options, kind) for kind in SIZES}
    if all(sizes is None for sizes in chosen.values()):
        chosen = {kind: list(sizes) for kind, sizes in SIZES.items()}
    for kind, sizes in chosen.items():
        if sizes:
            rows = {size: STUDIES[kind](size) for size in sorted(sizes)}
            names = next(iter(rows.values()))
            report.table((kind, *(f"{name} [µs]" for name in names)), table(rows), kind)
