"""An arm among cubes that fly about: the random scenario of DRGBT by its rules, in simulated time.

Run it from the root of the repository with `python -m bench.drgbt`. Cubes of 10 mm, with speeds uniform in 0 to
1.6 m/s, fly in a ball of 1.5 m about (0, 0, 0.267), are reflected at its surface and keep off the base; a ground box;
start and goal lie at least so far apart in the metric of the skeleton's points (the sum of their ways) as `--apart`
says, with 50 mm of clearance; the cubes are at first 0.3 m from the robot. Iterations of 50 ms, 10 s a run, joints
180°/s and 20 rad/s². The arm is an xArm7 whose third joint is held: example-robot-data has no xArm6.

Three planners, each with the cubes' places at every iteration: our replanner, which knows that none is faster than
1.6 m/s (`--bound own`: than it is); RRT-Connect from scratch in every iteration, whose first 50 ms are driven; and
RRT-Connect only when the rest of the path touches a cube where it is now. The rivals need not speed up or brake, and
may spend `--checks` collision checks an iteration. A run succeeds if the goal is reached without a contact while the
robot moves. All 15 counts with 100 runs each take about two hours on one core. With `--log FILE.jsonl` every run is
kept as a line of that file, and the command goes on where it was stopped.
"""

from __future__ import annotations

import argparse
import json
import logging
from copy import deepcopy
from dataclasses import dataclass
from itertools import pairwise, product
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
from ompl import util as ou

from safe_ompl import Box, CollisionChecker, Obstacle, Pose, RateLimits, Robot, SafeSetup, Scene, time_path
from safe_ompl.common import FloatArray
from safe_ompl.people.replanning import Replanner, ReplanningOptions
from safe_ompl.people.simulation import ContactMonitor, Solid
from safe_ompl.people.simulation.movers import Drifting
from safe_ompl.people.simulation.simulation import Faults, Simulation

COUNTS = (0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 20, 30, 40, 50)
CENTRE, RADIUS, BASE = np.array([0.0, 0.0, 0.267]), 1.5, 0.25
FASTEST, CUBE = 1.6, 0.01
TICK, SECONDS = 0.05, 10.0
_FINE = 0.005  # [s] between looks for contacts
_CHECKED = 0.05  # [rad] between the checks of rivals
_RANGE = 1.0  # [rad] of RRT-Connect


@dataclass
class Run:
    """One problem: ends, the path that all start from, and the cubes."""

    start: FloatArray
    goal: FloatArray
    path: FloatArray
    cubes: dict[str, Drifting]
    speeds: dict[str, float]


def arm() -> Robot:
    """Return the robot."""
    return Robot.from_example("xarm7", locked={"joint3": 0.0})


def scene(cubes: dict[str, Drifting]) -> Scene:
    """Return the ground, and the cubes as they are at first."""
    ground = Obstacle("ground", Box((3.0, 3.0, 0.1)), Pose((0.0, 0.0, -0.06)))
    small = [
        Obstacle(name, Box((CUBE,) * 3), Pose(tuple(cube.at(0.0).translation)))
        for name, cube in cubes.items()
    ]
    return Scene((ground, *small))


def problem(robot: Robot, count: int, seed: int, apart: float) -> Run:
    """Return the problem of a seed; the same ends for every number of cubes."""
    rng = np.random.default_rng(seed)
    setup = SafeSetup(robot, scene({}))
    while True:
        ends = rng.uniform(np.maximum(robot.lower, -np.pi), np.minimum(robot.upper, np.pi), (2, robot.n))
        ways = np.linalg.norm(np.subtract(*(robot.keypoints(q) for q in ends)), axis=1).sum()
        if ways < apart or any(setup.checker.in_collision(q) for q in ends):
            continue
        if any(setup.checker.clearance(q).distance < 0.05 for q in ends):
            continue
        setup.clear()
        setup.setConfigurations(*ends)
        result = setup.plan("ClassicRRTConnect", time=2.0, seed=seed, simplify=0.2, report=False)
        if result.path is not None:
            break
    monitor = ContactMonitor(robot)
    cubes: dict[str, Drifting] = {}
    speeds = {}
    while len(cubes) < count:
        place = CENTRE + RADIUS * rng.uniform(-1, 1, 3)
        if not BASE < np.linalg.norm(place - CENTRE) < RADIUS:
            continue
        name, at = f"cube_{len(cubes)}", pin.SE3(np.eye(3), place)
        if monitor.nearest(ends[0], [Solid(name, "", _cube(), at)]).distance < 0.3:
            continue
        way, speed = rng.normal(size=3), rng.uniform(0, FASTEST)
        cubes[name] = Drifting(place, speed * way / np.linalg.norm(way), CENTRE, RADIUS, (CENTRE, BASE))
        speeds[name] = speed
    return Run(ends[0], ends[1], result.path, cubes, speeds)


def _cube() -> Any:
    return Box((CUBE,) * 3).parts()[0].geometry


def outcome(run: Run, time: float, q: FloatArray, monitor: ContactMonitor) -> dict[str, Any]:
    """Return what came of a run."""
    gone = float(np.linalg.norm(run.goal - q) / np.linalg.norm(run.goal - run.start))
    moving = sum(contact.moving for contact in monitor.contacts)
    return {
        "success": gone < 1e-6 and not moving,
        "progress": max(0.0, 1.0 - gone),
        "time": time,
        "moving": moving,
        "rest": len(monitor.contacts) - moving,
    }


def ours(robot: Robot, run: Run, bound: str) -> dict[str, Any]:
    """Drive with the replanner."""
    speeds = run.speeds if bound == "own" else dict.fromkeys(run.cubes, FASTEST)
    replanner = Replanner(robot, scene(run.cubes), {}, speeds, options=ReplanningOptions(tick=TICK))
    limits = RateLimits.of(robot, velocity=np.pi, acceleration=20.0)
    way = time_path(run.path, robot, limits, motion=replanner.prover, tolerance=0.2)
    simulation = Simulation(replanner, [way], {}, run.cubes, faults=Faults(latency=0.0))
    time, q = 0.0, run.start
    for tick in simulation.ticks(SECONDS):
        time, q = tick["time"], np.array(tick["q"])
        if tick["state"] == "done":
            break
    assert simulation.monitor is not None
    found = outcome(run, time, q, simulation.monitor)
    reaction = simulation.reactions
    return {**found, "detours": simulation.summary.detours, "reaction": float(np.percentile(reaction, 99))}


class Rival:
    """RRT-Connect on the cubes where they are now.

    Parameters
    ----------
    robot : Robot
        The arm.
    run : Run
        The problem.
    checks : int
        Collision checks in an iteration.
    always : bool
        Whether it plans in every iteration, or only when its path is barred.
    """

    def __init__(self, robot: Robot, run: Run, checks: int, always: bool) -> None:
        self._robot, self._run, self._checks, self._always = robot, run, checks, always
        self._scene = scene(run.cubes)
        self._checker = CollisionChecker(robot, self._scene, movable=tuple(run.cubes))
        self._rng = np.random.default_rng(0)
        self._path: list[FloatArray] = list(run.path)
        self._left = 0

    def drive(self) -> dict[str, Any]:
        """Drive until the goal, or for 10 s."""
        monitor, q, time = ContactMonitor(self._robot), self._run.start, 0.0
        while time < SECONDS - 1e-9 and np.abs(q - self._run.goal).max() > 1e-9:
            places = {name: cube.at(time) for name, cube in self._run.cubes.items()}
            if places:
                self._checker.move(self._scene.moved(places))
            self._left = self._checks
            way = [q, *self._path[1:]]
            if self._always or not self._free(way):
                way = self._plan(q) or []
            q = self._step(monitor, time, q, way)
            time += TICK
        return outcome(self._run, time, q, monitor)

    def _step(self, monitor: ContactMonitor, time: float, q: FloatArray, way: list[FloatArray]) -> FloatArray:
        """Drive along a way for an iteration at full speed; look for contacts."""
        points = list(way)
        for k in range(round(TICK / _FINE)):
            left, before = _FINE * np.pi, q
            while len(points) > 1 and left > 0:
                step = points[1] - q
                size = float(np.abs(step).max())
                if size <= left:
                    q, left = points[1], left - size
                    points.pop(0)
                else:
                    q, left = q + step * left / size, 0.0
            now = time + (k + 1) * _FINE
            solids = [Solid(name, "", _cube(), cube.at(now)) for name, cube in self._run.cubes.items()]
            monitor.observe(now, q, solids, moving=bool(np.abs(q - before).max() > 0), obeyed=True)
        self._path = [q, *points[1:]] if len(points) > 1 else [q, *self._path[1:]]
        return q

    def _free(self, way: list[FloatArray]) -> bool:
        return all(self._edge_free(a, b) for a, b in pairwise(way))

    def _edge_free(self, a: FloatArray, b: FloatArray) -> bool:
        count = max(1, int(np.ceil(np.linalg.norm(b - a) / _CHECKED)))
        for k in range(1, count + 1):
            self._left -= 1
            if self._left < 0 or self._checker.touches(a + (b - a) * k / count):
                return False
        return True

    def _plan(self, q: FloatArray) -> list[FloatArray] | None:
        """RRT-Connect from q to the goal, with shortcuts; None if the checks do not do."""
        if self._edge_free(q, self._run.goal):
            return [q, self._run.goal]
        trees: list[tuple[list[FloatArray], list[int]]] = [([q], [-1]), ([self._run.goal], [-1])]
        active = 0
        while self._left > 0:
            target = self._rng.uniform(self._robot.lower, self._robot.upper)
            new = self._extend(trees[active], target)
            if new is not None:
                other = trees[1 - active]
                while (met := self._extend(other, new)) is not None:
                    if np.array_equal(met, new):
                        there, back = (_branch(tree) for tree in trees)
                        return self._shortened([*there[::-1], *back[1:]])
            active = 1 - active
        return None

    def _extend(self, tree: tuple[list[FloatArray], list[int]], target: FloatArray) -> FloatArray | None:
        nodes, parents = tree
        near = int(np.linalg.norm(np.array(nodes) - target, axis=1).argmin())
        step = target - nodes[near]
        size = float(np.linalg.norm(step))
        new = target if size <= _RANGE else nodes[near] + step * _RANGE / size
        if size == 0 or not self._edge_free(nodes[near], new):
            return None
        nodes.append(new)
        parents.append(near)
        return new

    def _shortened(self, way: list[FloatArray]) -> list[FloatArray]:
        k = 0
        while k < len(way) - 2:
            if self._edge_free(way[k], way[k + 2]):
                del way[k + 1]
            else:
                k += 1
        return way


def _branch(tree: tuple[list[FloatArray], list[int]]) -> list[FloatArray]:
    """Return the nodes from the newest to the root."""
    nodes, parents = tree
    k, found = len(nodes) - 1, []
    while k >= 0:
        found.append(nodes[k])
        k = parents[k]
    return found


def main() -> None:
    """Run what the options choose; print a table, and draw it."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--runs", type=int, default=100)
    parser.add_argument("--counts", type=lambda text: [int(n) for n in text.split(",")], default=list(COUNTS))
    parser.add_argument("--checks", type=int, default=3000)
    parser.add_argument("--apart", type=float, default=5.0, metavar="M")
    parser.add_argument("--bound", choices=("common", "own"), default="common")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--log", type=Path, metavar="FILE.jsonl")
    parser.add_argument("--figure", type=Path, metavar="FILE.png")
    options = parser.parse_args()
    logging.disable(logging.WARNING)
    ou.setLogLevel(ou.LogLevel.LOG_ERROR)
    rows = run_all(options)
    print(f"{'cubes':>5}{'runs':>6}  " + "  ".join(f"{name:^38}" for name in rows))
    columns = f"{'success':>8}{'progress':>9}{'time':>7}{'moving':>7}{'rest':>6} "
    print(f"{'':11}  " + "  ".join(columns for _ in rows))
    for k, count in enumerate(options.counts):
        found = [runs[k] for runs in rows.values()]
        if found[-1]:
            print(f"{count:5}{len(found[-1]):6}  " + "  ".join(map(_told, found)))
    if options.figure:
        draw(options.counts, rows, options.figure)


def run_all(options: argparse.Namespace) -> dict[str, list[list[dict[str, Any]]]]:
    """Return the outcomes of each planner for each count; Ctrl-C ends it early."""
    robot = arm()
    kept: dict[str, dict[str, Any]] = {}
    if options.log and options.log.exists():
        lines = map(json.loads, options.log.read_text().splitlines())
        kept = {json.dumps(line["run"]): line["outcome"] for line in lines}
    rows: dict[str, list[list[dict[str, Any]]]] = {
        name: [[] for _ in options.counts] for name in ("ours", "from scratch", "on demand")
    }
    try:
        for k, (i, count) in product(range(options.runs), enumerate(options.counts)):
            seed, run = options.seed + k, None
            for name, runs in rows.items():
                own = options.bound if name == "ours" else options.checks
                key = [name, count, seed, options.apart, own]
                found = kept.get(json.dumps(key))
                if found is None:
                    run = run or problem(robot, count, seed, options.apart)
                    fresh = deepcopy(run)  # cubes remember where they were
                    if name == "ours":
                        found = ours(robot, fresh, options.bound)
                    else:
                        found = Rival(robot, fresh, options.checks, name == "from scratch").drive()
                    if options.log:
                        with options.log.open("a") as file:
                            file.write(json.dumps({"run": key, "outcome": found}) + "\n")
                runs[i].append(found)
    except KeyboardInterrupt:
        shortest = min(len(runs) for per_count in rows.values() for runs in per_count)
        print(f"stopped after {shortest} runs of each count")
    return rows


def _told(runs: list[dict[str, Any]]) -> str:
    mean = {key: np.mean([float(run[key]) for run in runs]) for key in ("success", "progress")}
    times = [run["time"] for run in runs if run["success"]]
    touched = [sum(run[key] for run in runs) for key in ("moving", "rest")]
    time = np.mean(times) if times else np.nan
    return (
        f"{100 * mean['success']:7.0f}%{100 * mean['progress']:8.0f}%{time:7.2f}{touched[0]:7}{touched[1]:6} "
    )


def draw(counts: list[int], rows: dict[str, list[list[dict[str, Any]]]], file: Path) -> None:
    """Draw success and contacts while moving over the number of cubes."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(8, 3.2), layout="constrained")
    for axes, key, label, top in zip(
        figure.subplots(1, 2),
        ("success", "moving"),
        ("share of runs that succeed", "contacts while moving, per run"),
        (1.05, None),
        strict=True,
    ):
        for (name, per_count), mark in zip(rows.items(), ("o-", "s--", "^:"), strict=True):
            means = [np.mean([float(run[key]) for run in runs]) for runs in per_count]
            axes.plot(counts, means, mark, label=name, alpha=0.8)
        axes.set(xlabel="cubes", title=label)
        axes.set_ylim(0.0, top)
        axes.grid(alpha=0.3)
    figure.axes[0].legend()
    figure.savefig(file, dpi=150)


if __name__ == "__main__":
    main()
