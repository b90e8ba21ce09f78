"""A Panda beside recorded people and unknown boxes that depth cameras see: against skeletons and stop-and-go.

FOLDER has recordings as for `live`. `safe_ompl.view.DepthRenderer` renders the cell (robot, obstacles, the person's
capsules, boxes) for three cameras at 30 Hz, with the errors of a Kinect, of joints and of the poses of cameras. Nothing
of the person or of the boxes is known to the robot but these images.
"""

from __future__ import annotations

import argparse
import logging
from itertools import pairwise
from pathlib import Path
from time import process_time
from typing import Any

import numpy as np
import pinocchio as pin

from bench._harness import Report
from bench._scenes import ACCELERATIONS
from bench.live import HANDS, StopAndGo, places, situations, to_and_fro
from safe_ompl import Box, Obstacle, People, RateLimits, Replanner, Scenario, Surroundings, Tracker
from safe_ompl.common import FloatArray
from safe_ompl.people import DepthCamera, DepthFrame, OccupancyGrid, OccupancyOptions, Recording, TrackedBody, looking
from safe_ompl.people.replanning import ReplanningOptions
from safe_ompl.people.simulation import Drifting, Faults, Playback, SightedSimulation, Simulation, World, part_solids
from safe_ompl.view import DepthRenderer

CLAIM = "nobody whom depth cameras see is touched while the robot moves, without anybody being recognised"
TICK = 1 / 30  # [s]
SPEED = 2.0  # [m/s] of all that cameras see
_LATENCY = 0.4  # of a tick
_FLOOR = -0.76  # [m]
_PLACES = 20
_BOXES = 3
_CLOUD = 100_000  # points
_SIZE = (640, 480)
_FOCAL, _BLOCK = 337.0, 4  # [px]
# Where cameras are, and where they look [m].
_LOOKS = {
    "above": ((0.2, -0.15, 2.8), (0.2, 0.0, 0.0)),
    "table": ((0.8, -1.8, 0.3), (0.1, 0.0, 0.1)),
    "shelf": ((-1.2, 1.0, 2.2), (0.3, 0.1, 0.2)),
}


# -------------------------------------------------------------------------------------------------- cameras


def cameras(width: int) -> dict[str, DepthCamera]:
    """Return the cameras, as the robot knows them, with images that are so many pixels wide."""
    share = width / _SIZE[0]
    size, middle = (width, round(share * _SIZE[1])), ((width - 1) / 2, (share * _SIZE[1] - 1) / 2)
    focal, block = (share * _FOCAL, share * _FOCAL), max(round(share * _BLOCK), 1)
    return {
        name: DepthCamera(*size, focal, middle, looking(*look), block=block, rate=1 / TICK)
        for name, look in _LOOKS.items()
    }


# -------------------------------------------------------------------------------------------------- drives

POLICIES: dict[str, Any] = {
    "depth": Replanner,
    "sharpened": Replanner,  # people are tracked besides
    "skeletons": Replanner,
    "stop-and-go": StopAndGo,
}


def boxes(seed: int) -> dict[str, Drifting]:
    """Return boxes that fly through the cell at up to the speed."""
    rng, found = np.random.default_rng(seed), {}
    room = np.array([[-0.7, -1.2, -0.5], [1.5, 0.55, 1.3]])
    for k in range(_BOXES):
        way = rng.normal(size=3)
        velocity = way / np.linalg.norm(way) * rng.uniform(0.2, SPEED)
        turn = pin.exp3(rng.uniform(-1, 1, 3))
        found[f"box{k}"] = Drifting(pin.SE3(turn, rng.uniform([0.9, -1.2, 0.0], [1.5, 0.5, 1.2])), velocity, room)
    return found


def drive(
    job: tuple[Path, str, int] | int, policy: str, seconds: float, unseen: str, width: int = _SIZE[0]
) -> dict[str, Any]:
    """Drive once beside a recorded person, or beside boxes of a seed, and return what happened."""
    scenario = Scenario.load("panda_shelf")
    robot = scenario.build_robot()
    still = scenario.scene.without("operator")
    shapes = [Obstacle(f"box{k}", Box((0.12, 0.2, 0.16))) for k in range(_BOXES)]
    eyes, options = (
        cameras(width),
        OccupancyOptions(speed=SPEED, unseen=unseen, clear=2.0),
    )  # somebody looked before it began
    if isinstance(job, int):
        people, things, scene, seed = {}, boxes(job), still.with_obstacles(*shapes), job
    else:
        file, clip, place = job
        recording = Recording.load(file, clip)
        seed = sum(map(ord, file.stem + clip))
        tracker = Tracker(recording.skeleton, TrackedBody(), places(recording, _PLACES, seed)[place])
        people, things, scene = {"operator": Playback(recording, tracker)}, {}, still
    trackers, speeds = {name: one.tracker for name, one in people.items()}, dict.fromkeys(things, SPEED)
    sighted, sharper = policy == "skeletons", policy == "sharpened"
    rules = People(speed=1.6, speeds=HANDS) if sighted or sharper else People(speed=SPEED)
    around = shadow = Surroundings(scene, trackers, speeds, rules)
    if not sighted:
        known = trackers if sharper else {}
        around = Surroundings(still, known, people=rules, depth=OccupancyGrid(robot, still, eyes, options))
    replanning = ReplanningOptions(TICK, detours=policy != "stop-and-go", retreats=policy != "stop-and-go")
    pilot = POLICIES[policy](robot, around, options=replanning)
    limits = RateLimits.of(robot, acceleration=ACCELERATIONS["panda"])
    ways = to_and_fro(scenario, robot, limits, pilot.prover)
    faults = Faults(latency=_LATENCY * TICK)
    if sighted:
        one = Simulation(pilot, ways, people, things, faults=faults)
    else:
        look = DepthRenderer(robot, still, eyes, _FLOOR, seed).see
        one = SightedSimulation(pilot, ways, World(people, things, shadow), look, faults=faults)
    one.clock = process_time  # type: ignore[method-assign]
    ticks = list(one.ticks(seconds))
    false = sum(
        before["state"] in ("moving", "slowed") and tick["state"] in ("braking", "standing") and tick["distance"] > 0.8
        for before, tick in pairwise(ticks)
    )
    found = {"policy": policy, "job": str(job), **one.summary.as_dict(), "false": false, "took": one.reactions}
    found["standing"] = sum(tick["state"] == "standing" for tick in ticks) * TICK
    return found


def ingest(ticks: int) -> list[tuple[Any, ...]]:
    """Return how long one, two and three images, and clouds of `_CLOUD` points, take to ingest [ms]: 50 and 99 %."""
    scenario, eyes, rng = Scenario.load("panda_shelf"), cameras(_SIZE[0]), np.random.default_rng(0)
    robot, still = scenario.build_robot(), scenario.scene.without("operator")
    start, goal = scenario.start_configuration(robot), scenario.goal_configurations(robot)[0]
    look = DepthRenderer(robot, still, eyes, _FLOOR)
    box, shape, frames, rows = boxes(0)["box0"], Box((0.12, 0.2, 0.16)), [], []
    for k in range(ticks):
        now, q = k * TICK, start + k / ticks * (goal - start)
        seen = look.see(q, part_solids("box", shape, box.at(now)), eyes)
        frames.append((now, q, seen, {name: cloud(depths, eyes[name], rng) for name, depths in seen.items()}))
    for kind in ("image", "cloud"):
        for count in range(1 + len(eyes)):
            names, took = list(eyes)[:count] or list(eyes), []  # all of them first, to compile
            options = OccupancyOptions(speed=SPEED, clear=2.0)
            grid = OccupancyGrid(robot, still, {name: eyes[name] for name in names}, options)
            for now, q, images, clouds in frames:
                begin = process_time()
                for name in names:
                    grid.observe(name, DepthFrame((images if kind == "image" else clouds)[name], now, q), now)
                grid.sets(now)
                took.append(process_time() - begin)
            half, most = 1e3 * np.percentile(took[1:], (50, 99))
            if count:
                rows.append((f"{kind}s of {count}", float(half), float(most), 1e3 * took[0]))
    return rows


def cloud(depths: FloatArray, eye: DepthCamera, rng: np.random.Generator) -> FloatArray:
    """Return `_CLOUD` points (N, 3) of an image (H, W), in any order [m]."""
    v, u = np.nonzero(np.isfinite(depths))
    some = rng.permutation(len(v))[:_CLOUD]
    z = depths[v[some], u[some]].astype(float)
    (fx, fy), (cx, cy) = eye.focal, eye.middle
    return np.column_stack([(u[some] - cx) / fx * z, (v[some] - cy) / fy * z, z])


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options."""
    add = parser.add_argument
    add("folder", type=Path, nargs="?", help="with recordings; without: boxes only")
    add("--drives", type=int, default=100, metavar="N")
    add("--seconds", type=float, default=6.0, metavar="S", help="of each")
    add("--boxes", action="store_true", help="unknown boxes that fly, and nobody")
    add("--width", type=int, default=_SIZE[0], metavar="PIXELS", help="of images; their blocks see the same")
    add("--unseen", default="occupied", choices=("occupied", "free"))
    add("--policies", default=",".join(POLICIES))
    add("--ingest", type=int, default=100, metavar="N", help="instants at which images and clouds are timed")


def main(options: argparse.Namespace, report: Report) -> int:
    """Run what the options choose."""
    logging.disable(logging.WARNING)
    jobs: list[Any] = list(range(options.drives))
    if not options.boxes:
        jobs = situations(options.folder, _PLACES, options.drives)
    rows = []
    for policy in options.policies.split(","):
        rows += [drive(job, policy, options.seconds, options.unseen, options.width) for job in jobs]
    table = []
    for policy in options.policies.split(","):
        mine = [row for row in rows if row["policy"] == policy]
        if not mine:
            continue
        hours = sum(row["seconds"] for row in mine) / 3600
        total = {key: sum(row[key] for row in mine) for key in ("tasks", "stops", "false", "violations", "standing")}
        counts = [
            sum(row[f"contacts_{key}"] for row in mine) for key in ("while_moving", "after_violations", "at_rest")
        ]
        took = 1e3 * np.percentile(np.concatenate([row["took"] for row in mine]), (50, 99))
        obeyed = f"{np.mean([row['model_obeyed'] for row in mine]):.2%}"
        rates = [round(total[key] / hours) for key in ("tasks", "stops", "false")]
        table.append((policy, *rates, *counts, obeyed, total["violations"], *(float(t) for t in took)))
    header = ("", "tasks/h", "stops/h", "false stops/h", "contacts moving", "after violation", "at rest", "obeyed")
    report.table((*header, "surprises", "ingest + command 50 % [ms]", "99 %"), table)
    header = (f"ingest of {_SIZE[0]} x {_SIZE[1]} pixels, {_CLOUD} points", "50 % [ms]", "99 %", "the first")
    report.table(header, ingest(options.ingest))
    wrong = [row for row in rows if row["policy"] in ("depth", "sharpened") and row["contacts_while_moving"]]
    for row in wrong:
        print("CONTACT", {key: value for key, value in row.items() if key != "took"})
    return int(bool(wrong))
