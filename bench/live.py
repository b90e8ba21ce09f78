"""A Panda beside recorded people: the replanner against stop-and-go on the same path, and against an empty cell.

FOLDER has recordings (.npz, see `safe_ompl.live.Recording`). Every clip is placed beside the arm at so many places
drawn from a seed, and played while the arm goes to and fro as in `scenarios/panda_shelf.yaml`. A contact monitor looks
for contacts. Stop-and-go drives at full, half and a quarter of the speed: a slower robot stops sooner.

All clips at 20 places with all policies are about 13 hours of simulated time; one idle core simulates 6 s in a
second (`--jobs` for more cores; `--sample N` for N of all clips and places, drawn evenly).
"""

from __future__ import annotations

import argparse
import logging
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from itertools import permutations
from multiprocessing import get_context
from pathlib import Path
from time import process_time
from typing import Any

import numpy as np

from bench._harness import Report
from bench._scenes import ACCELERATIONS
from bench._touches import TouchJudge
from safe_ompl import People, Pose, RateLimits, Replanner, Robot, Scenario, Surroundings, Tracker, Trajectory, time_path
from safe_ompl.collision import MotionProver
from safe_ompl.danger import DangerField
from safe_ompl.live import Recording, TrackedBody, facing, list_clips
from safe_ompl.live.replanning import Action, Command, ReplanningOptions, Route
from safe_ompl.live.replanning.bounded_path import Around, BoundedPath, MotionMargin, StopLaw
from safe_ompl.live.simulation import Faults, Playback, Simulation
from safe_ompl.motions.contact import CONTACT_RULES

CLAIM = "no contact while moving as long as people keep to the promise, at many times the tasks of stop-and-go"
HANDS = {f"{side}_{limb}": 2.0 for side in ("left", "right") for limb in ("forearm", "hand")}  # [m/s]
TICK = 0.05  # [s]
OURS = ("ours", "in-order", "any-order", "contact", "staying")
_NEAR, _FAR = 0.7, 1.3  # [m] from the base to the hip
_ARMS_REACH = 0.85  # [m] from the base to the hip of people within arm's reach, who face it
_HIP = 0.15  # [m] above the base
_SHARES = ("model_obeyed", "moving")
_CONTACTS = ("while_moving", "after_violations", "at_rest", "retreating")
_LATENCY = 0.4  # of a tick, from a measurement to the command that answers it
_BESIDE = 0.4  # [m] who is nearer than that is beside the robot

_BETWEEN = ([0.7, -0.6, 0, -2.2, 0, 3.0, 0.785], [-0.7, -0.6, 0, -2.4, 0, 2.6, 0.785])  # start and goal

Situation = tuple[Path, str, int]  # file, clip and place
Ways = dict[tuple[int, int], Trajectory]


# -------------------------------------------------------------------------------------------------- rivals


class StopAndGo(Replanner):
    """Stops when anybody is nearer than one distance, and resumes at full speed when nobody is.

    The distance is the least that is safe wherever on the path the robot is: S = v (Δ + T) + r, with the time Δ from
    one measurement to the next command, the longest stop T of the path at its speed, and the farthest way r that any of
    its bodies covers in both. A slower robot needs less of it: `share` is its speed, as a share of what its joints can.
    """

    share = 1.0

    def start(self, trajectory: Trajectory) -> None:
        """Take a trajectory, at the share of its speed."""
        super().start(trajectory)
        assert self._path is not None
        self._path = replace(self._path, squared_limits=self._path.squared_limits * self.share**2)

    def _next(self, path: BoundedPath, s: float, speed: float, time: float) -> Command | None:
        if not self.surroundings.known:
            return None
        if speed == 0 and s >= path.length - 1e-6:
            return super()._next(path, s, speed, time)
        cell = np.array([min(int(np.searchsorted(path.edges, s, side="right")) - 1, len(path.brakes) - 1)])
        here = StopLaw(cell, np.array([s, s]), np.zeros(2), np.zeros(2))
        distance = self.clearance + self._distance(path, time)
        near = path.margin(here, Around(self.surroundings.sets, 0.0, distance), exact=True)
        trouble = self.surroundings.trouble(time, self.options.lost_after)
        share = 1.0 if near.margin >= 0 and trouble is None else -1.0
        if share < 0 and speed == 0:
            return None
        motion = path.motion_from(s, speed * speed, share, self.tick)
        action = Action.MOVING if share > 0 else Action.BRAKING
        return Command(time, self.surroundings.time, path, motion, action, near, trouble or "")

    def _distance(self, path: BoundedPath, time: float) -> float:
        full = np.sqrt(path.squared_limits)
        stop = float((full / path.brakes).max())
        delay = time - self.surroundings.time + self.tick
        body = float((2 * path.frames.travel.max(axis=1) / np.diff(path.edges) * full).max())  # [m/s]
        fastest = float(self.surroundings.sets.growth[:, 1].max())
        return fastest * (delay + stop) + body * (delay + stop / 2)


class HalfSpeed(StopAndGo):
    """The same at half of the speed."""

    share = 0.5


class QuarterSpeed(StopAndGo):
    """The same at a quarter of the speed."""

    share = 0.25


class Careless(Replanner):
    """Drives as if it were alone."""

    def _next(self, path: BoundedPath, s: float, speed: float, time: float) -> Command | None:
        if speed == 0 and s >= path.length - 1e-6:
            return super()._next(path, s, speed, time)
        motion = path.motion_from(s, speed * speed, 1.0, self.tick)
        return Command(time, self.surroundings.time, path, motion, Action.MOVING, MotionMargin(np.inf))


POLICIES: dict[str, Any] = {
    "ours": Replanner,
    "in-order": Replanner,  # between four places, in their order
    "any-order": Replanner,  # in any order
    "contact": Replanner,  # where contact is allowed
    "staying": Replanner,  # without retreats
    "stop-and-go": StopAndGo,
    "half-speed": HalfSpeed,
    "quarter-speed": QuarterSpeed,
    "alone": Careless,
}


# --------------------------------------------------------------------------------------------- simulations


def situations(folder: Path, places: int, sample: int) -> list[Situation]:
    """Return all clips at all places, or so many of them (0: all), drawn evenly."""
    found = [
        (file, clip, place)
        for file in sorted(folder.glob("*.npz"))
        for clip in list_clips(file)
        for place in range(places)
    ]
    if not found:
        raise SystemExit(f"no recordings (.npz) in {folder}")
    if 0 < sample < len(found):
        chosen = np.random.default_rng(0).choice(len(found), sample, replace=False)
        found = [found[k] for k in sorted(chosen.tolist())]
    return found


def to_and_fro(scenario: Scenario, robot: Robot, limits: RateLimits, prover: MotionProver) -> list[Trajectory]:
    """Return the ways of `panda_shelf` there and back, in time."""
    start, goal = scenario.start_configuration(robot), scenario.goal_configurations(robot)[0]
    path = [start, *_BETWEEN, goal]
    return [time_path(way, robot, limits, motion=prover) for way in (path, path[::-1])]


def between_places(scenario: Scenario, robot: Robot, limits: RateLimits, prover: MotionProver) -> Ways:
    """Return the ways between each two of four places, those along `to_and_fro`, by their numbers."""
    path = [scenario.start_configuration(robot), *_BETWEEN, scenario.goal_configurations(robot)[0]]
    pairs = permutations(range(len(path)), 2)
    slices = {(i, j): path[i : j + 1] if i < j else path[j : i + 1][::-1] for i, j in pairs}
    return {pair: time_path(way, robot, limits, motion=prover) for pair, way in slices.items()}


def places(recording: Recording, count: int, seed: int, *, near: bool = False) -> list[Pose]:
    """Return places of a recording at which the hip of its first frame is beside the arm, not behind it.

    People who are `near` face it, within arm's reach.
    """
    rng = np.random.default_rng(seed)
    points, _ = TrackedBody().completed(recording.skeleton.keypoints(recording.frames[0]))
    ahead, hip = facing(points)[:, 0], recording.skeleton.keypoints(recording.frames[0])[-1]
    found = []
    for _ in range(count):
        angle, far, yaw = rng.uniform(-1.2, 1.2), rng.uniform(_NEAR, _FAR), rng.uniform(-np.pi, np.pi)
        if near:
            far, yaw = _ARMS_REACH, np.pi + angle - np.arctan2(ahead[1], ahead[0])
        c, s = np.cos(yaw), np.sin(yaw)
        turned = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1.0]]) @ hip
        at = np.array([far * np.cos(angle), far * np.sin(angle), _HIP]) - turned
        found.append(Pose(tuple(at), (0.0, 0.0, float(np.sin(yaw / 2)), float(np.cos(yaw / 2)))))
    return found


def simulation(
    file: Path, clip: str, place: int, policy: str, *, count: int = 20, near: bool = False, tick: float = TICK
) -> Simulation:
    """Return the simulation of one clip at one place.

    People are measured, and commands given, at every tick [s]; a command holds two fifths of a tick after its
    measurement.
    """
    scenario = Scenario.load("panda_shelf")
    robot = scenario.build_robot()
    recording = Recording.load(file, clip)
    pose = places(recording, count, seed=sum(map(ord, file.stem + clip)), near=near)[place]
    tracker = Tracker(recording.skeleton, TrackedBody(), pose)
    people = People(speed=1.6, speeds=HANDS, contact=policy == "contact")
    replanner = POLICIES[policy](
        robot,
        Surroundings(scenario.scene, {"operator": tracker}, people=people),
        options=ReplanningOptions(tick, detours=policy in OURS, retreats=policy in OURS[:-1]),
    )
    limits = RateLimits.of(robot, acceleration=ACCELERATIONS["panda"])
    ways: list[Trajectory] | Route = []
    if "any" in policy or policy == "in-order":
        between = between_places(scenario, robot, limits, replanner.prover)
        ways = [between[k, (k + 1) % 4] for k in range(4)] if policy == "in-order" else Route(between)
    else:
        ways = to_and_fro(scenario, robot, limits, replanner.prover)
    operator, faults = Playback(recording, tracker), Faults(latency=_LATENCY * tick)
    one = Simulation(replanner, ways, {"operator": operator}, faults=faults)
    one.monitor = TouchJudge(robot, replanner.surroundings.still, people, tracker.body.height)
    return one


def run(job: tuple[Path, str, int, str, float, int, bool, float]) -> dict[str, Any]:
    """Run one simulation, and return its summary."""
    file, clip, place, policy, seconds, *how = job
    logging.disable(logging.WARNING)
    begin = process_time()
    options = dict(zip(("count", "near", "tick"), how, strict=True))
    one = simulation(file, clip, place, policy, **options)
    duration = max(seconds or one.world.people["operator"].recording.duration, one.replanner.tick)  # type: ignore[attr-defined]
    ticks = list(one.ticks(duration))
    beside = [tick["state"] for tick in ticks if (tick["distance"] or 0.0) < _BESIDE]
    judge = one.monitor
    assert isinstance(judge, TouchJudge)
    return {
        "policy": policy,
        "file": file.stem,
        "clip": clip,
        "place": place,
        **one.summary.as_dict(),
        "beside": len(beside) * one.replanner.tick,
        "standing": sum(state == "standing" for state in beside) * one.replanner.tick,
        "rules": [sum(tick["rule"] == rule for tick in ticks) for rule in CONTACT_RULES],
        "judged": (judge.too_fast, judge.clamped, judge.fastest, judge.closing, judge.relative),
        "danger": danger_of(ticks, one.replanner.robot),
        "cpu": process_time() - begin,
    }


def danger_of(ticks: list[dict[str, Any]], robot: Robot) -> float:
    """Return the mean danger of the robot at the key points of people where they truly were [1/m]."""
    people = [np.array([p for points in tick["people"].values() for p in points.values()]) for tick in ticks]
    rows = zip(ticks, people, strict=True)
    return float(np.mean([DangerField(robot, points).value(tick["q"]) for tick, points in rows if len(points)]))


def show(report: Report, rows: list[dict[str, Any]]) -> None:
    """Report a table of the policies, and one of contacts as the judge sees them."""
    table, contacts, per_hour = [], [], {}
    for policy in dict.fromkeys(row["policy"] for row in rows):
        mine = [row for row in rows if row["policy"] == policy]
        seconds = [row["seconds"] for row in mine]
        total = {key: sum(r[key] for r in mine) for key in ("tasks", "stops", "beside", "standing")}
        per_hour[policy] = 3600 * total["tasks"] / sum(seconds)
        counts = [sum(row[f"contacts_{key}"] for row in mine) for key in _CONTACTS]
        shares = [np.average([row[key] for row in mine], weights=seconds) for key in _SHARES]
        reaction = [1e3 * float(np.median([row["reaction"][key] for row in mine])) for key in ("median", "p99")]
        danger = float(np.average([row["danger"] for row in mine], weights=seconds))
        cells = (round(per_hour[policy]), total["stops"], *counts, *(f"{share:.2%}" for share in shares), danger)
        table.append((policy, *cells, *reaction))
        too_fast, clamped, *worst = zip(*(row["judged"] for row in mine), strict=True)
        bound = dict(zip(CONTACT_RULES, np.sum([row["rules"] for row in mine], axis=0).tolist(), strict=True))
        standing = f"{total['standing'] / max(total['beside'], 1e-9):.0%}"
        most = (float(max(each)) for each in worst)
        said = ", ".join(f"{rule} {number}" for rule, number in bound.items())
        contacts.append((policy, round(total["beside"]), standing, sum(too_fast), sum(clamped), *most, said))
    header = ("", "tasks/h", "stops", "contacts moving", "after violation", "at rest", "retreating", "obeyed")
    report.table((*header, "moving", "danger", "reaction 50 % [ms]", "99 %"), table)
    header = ("", "beside a person [s]", "standing", "too fast for the limb", "clamped above it")
    header += ("speed, at most", "gap, at most", "relative [m/s]", "ticks bound by")
    report.table(header, contacts)
    best = max((rate for policy, rate in per_hour.items() if "-" in policy), default=0.0)
    if "ours" in per_hour and best:
        report.figure("tasks per hour, ours / the best stop-and-go", per_hour["ours"] / best)
    if "ours" in per_hour and per_hour.get("alone"):
        report.figure("time lost against an empty cell", 1 - per_hour["ours"] / per_hour["alone"])


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options."""
    add = parser.add_argument
    add("folder", type=Path)
    add("--places", type=int, default=20, metavar="N")
    add("--seconds", type=float, default=0.0, metavar="S", help="of each; default: the clip's")
    add("--sample", type=int, default=0, metavar="N", help="of all clips and places, drawn evenly")
    add("--near", action="store_true", help="people within arm's reach, who face the robot")
    add("--tick", type=float, default=TICK, metavar="S", help="between measurements, and between commands")
    add("--policies", default=",".join(POLICIES))
    add("--jobs", type=int, default=1, metavar="N", help="processes")


def main(options: argparse.Namespace, report: Report) -> int:
    """Run what the options choose."""
    chosen = situations(options.folder, options.places, options.sample)
    how = (options.seconds, options.places, options.near, options.tick)
    jobs = [(*situation, policy, *how) for situation in chosen for policy in options.policies.split(",")]
    if options.jobs == 1:
        rows = [run(job) for job in jobs]
    else:
        with ProcessPoolExecutor(options.jobs, mp_context=get_context("spawn")) as pool:
            rows = list(pool.map(run, jobs))
    show(report, rows)
    wrong = [row for row in rows if row["policy"] == "ours" and row["contacts_while_moving"]]
    for row in wrong:
        print("CONTACT", row)
    return int(bool(wrong))
