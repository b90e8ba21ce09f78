"""A Panda beside recorded people: the replanner against stop-and-go on the same path, and against an empty cell.

Run it from the root of the repository with `python -m bench.live FOLDER`, FOLDER with recordings (.npz, see
`safe_ompl.people.Recording`). Every clip is placed beside the arm at so many places drawn from a seed, and played
while the arm goes to and fro as in `scenarios/panda_shelf.yaml`. A contact monitor looks for contacts. Stop-and-go
drives at full, half and a quarter of the speed: a slower robot stops sooner. `--memory MINUTES` measures memory
instead.

All clips at 20 places with all policies are about 13 hours of simulated time; one idle core simulates 6 s in a
second (`--jobs` for more cores; `--sample N` for N of all clips and places, drawn evenly).
"""

from __future__ import annotations

import argparse
import gc
import logging
import resource
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from multiprocessing import get_context
from pathlib import Path
from time import process_time
from typing import Any

import numpy as np

from bench._live_rivals import Careless, HalfSpeed, QuarterSpeed, StopAndGo
from bench._touches import TouchJudge
from safe_ompl import People, Pose, RateLimits, Scenario, time_path
from safe_ompl.people import CalibratedReach
from safe_ompl.people.replanning import Replanner, ReplanningOptions
from safe_ompl.people.simulation.movers import Playback
from safe_ompl.people.simulation.simulation import Faults, Simulation
from safe_ompl.people.skeletons import Recording, TrackedBody, facing, list_clips
from safe_ompl.people.tracking import Tracker
from safe_ompl.scene.scenario import find_scenario
from safe_ompl.trajectories.contact import CONTACT_RULES

PANDA_ACCELERATIONS = [15, 7.5, 10, 12.5, 15, 20, 20]  # [rad/s²]
HANDS = {f"{side}_{limb}": 2.0 for side in ("left", "right") for limb in ("forearm", "hand")}  # [m/s]
POLICIES: dict[str, Any] = {
    "ours": Replanner,
    "contact": Replanner,  # where contact is allowed
    "staying": Replanner,  # without retreats
    "stop-and-go": StopAndGo,
    "half-speed": HalfSpeed,
    "quarter-speed": QuarterSpeed,
    "alone": Careless,
}
TICK = 0.05  # [s]
OURS = ("ours", "contact", "staying")
_NEAR, _FAR = 0.7, 1.3  # [m] from the base to the hip
_HIP = 0.15  # [m] above the base
_ARMS_REACH = 0.85  # [m] from the base to the hip of people within arm's reach, who face it
_CONTACTS = ("while_moving", "after_violations", "at_rest", "retreating")
_LATENCY = 0.4  # of a tick, from a measurement to the command that answers it
_BESIDE = 0.4  # [m] who is nearer than that is beside the robot


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
    file: Path,
    clip: str,
    place: int,
    policy: str,
    *,
    monitored: bool = True,
    count: int = 20,
    reach: CalibratedReach | None = None,
    near: bool = False,
    gate: float | None = None,
    tick: float = TICK,
) -> Simulation:
    """Return the simulation of one clip at one place; with a reach of the limbs that were calibrated.

    Key points that are faster than the gate [m/s] are glitches; a reach has a gate of its own. People are measured, and
    commands given, at every tick [s], and a command holds two fifths of a tick after its measurement.
    """
    scenario = Scenario.load(find_scenario("panda_shelf"))
    robot = scenario.build_robot()
    recording = Recording.load(file, clip)
    pose = places(recording, count, seed=sum(map(ord, file.stem + clip)), near=near)[place]
    tracker = Tracker(recording.skeleton, TrackedBody(), pose, gate=gate)
    if reach is not None:
        tracker = replace(tracker, body=TrackedBody(only=reach.limbs), gate=reach.gate)
    people = People(speed=1.6, speeds=HANDS, contact=policy == "contact")
    replanner = POLICIES[policy](
        robot,
        scenario.scene,
        {"operator": tracker},
        people=people,
        options=ReplanningOptions(reach, tick, detours=policy in OURS, retreats=policy in OURS[:2]),
    )
    limits = RateLimits.of(robot, acceleration=PANDA_ACCELERATIONS)
    start, goal = scenario.start_configuration(robot), scenario.goal_configurations(robot)[0]
    path = [start, [0.7, -0.6, 0, -2.2, 0, 3.0, 0.785], [-0.7, -0.6, 0, -2.4, 0, 2.6, 0.785], goal]
    ways = [time_path(way, robot, limits, motion=replanner.prover) for way in (path, path[::-1])]
    operator, faults = Playback(recording, tracker), Faults(latency=_LATENCY * tick)
    one = Simulation(replanner, ways, {"operator": operator}, faults=faults, monitored=monitored)
    if monitored:
        one.monitor = TouchJudge(robot, replanner.surroundings.still, people, tracker.body.height)
    return one


def run(
    job: tuple[Path, str, int, str, float, int, CalibratedReach | None, bool, float | None, float],
) -> dict[str, Any]:
    """Run one simulation, and return its summary."""
    file, clip, place, policy, seconds, *how = job
    logging.disable(logging.WARNING)
    begin = process_time()
    options = dict(zip(("count", "reach", "near", "gate", "tick"), how, strict=True))
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
        "cpu": process_time() - begin,
    }


def print_table(rows: list[dict[str, Any]]) -> None:
    """Print a table."""
    hours = {policy: sum(r["seconds"] for r in rows if r["policy"] == policy) / 3600 for policy in POLICIES}
    per_hour = {
        policy: sum(r["tasks"] for r in rows if r["policy"] == policy) / hours[policy]
        for policy in POLICIES
        if hours[policy]
    }
    print(
        f"{'':13} {'tasks/h':>8} {'stops':>6} {'contacts moving':>16} {'after violation':>16} {'at rest':>8} "
        f"{'retreating':>11} {'obeyed':>8} {'raw':>8} {'refused':>8} {'moving':>8} {'reaction 50/99 %':>18}"
    )
    for policy in per_hour:
        mine = [r for r in rows if r["policy"] == policy]
        total = {key: sum(r[key] for r in mine) for key in ("stops", *(f"contacts_{k}" for k in _CONTACTS))}
        shares = [
            np.average([r[key] for r in mine], weights=[r["seconds"] for r in mine])
            for key in ("model_obeyed", "model_obeyed_raw", "refused", "moving")
        ]
        reaction = [
            np.median([r["reaction"]["median"] for r in mine]),
            np.median([r["reaction"]["p99"] for r in mine]),
        ]
        print(
            f"{policy:13} {per_hour[policy]:8.0f} {total['stops']:6} {total['contacts_while_moving']:16} "
            f"{total['contacts_after_violations']:16} {total['contacts_at_rest']:8} "
            f"{total['contacts_retreating']:11} "
            + "".join(f"{100 * share:7.2f}% " for share in shares)
            + f"{1e3 * reaction[0]:8.1f} / {1e3 * reaction[1]:4.1f} ms"
        )
    for policy in OURS:
        mine = [r for r in rows if r["policy"] == policy]
        if mine:
            print_contacts(policy, mine)
    best = max((per_hour[policy] for policy in list(POLICIES)[3:6] if policy in per_hour), default=0.0)
    if "ours" in per_hour and best:
        print(f"ours / the best stop-and-go: {per_hour['ours'] / best:.2f} × the tasks per hour")
    if "ours" in per_hour and "alone" in per_hour:
        print(f"time lost against an empty cell: {100 * (1 - per_hour['ours'] / per_hour['alone']):.0f} %")


def print_contacts(policy: str, rows: list[dict[str, Any]]) -> None:
    """Print what the judge found of contacts, and how long the robot stood beside people."""
    beside, standing = (sum(r[key] for r in rows) for key in ("beside", "standing"))
    too_fast, clamped, *worst = zip(*(r["judged"] for r in rows), strict=True)
    fastest, closing, relative = map(max, worst)
    bound = ", ".join(
        f"{rule} {n}"
        for rule, n in zip(CONTACT_RULES, np.sum([r["rules"] for r in rows], axis=0), strict=True)
    )
    print(
        f"{policy}: {beside:.0f} s beside a person, {100 * standing / max(beside, 1e-9):.0f} % of them standing; ticks "
        f"bound by {bound}\n  contacts while moving: above what the limb bears {sum(too_fast)}, clamped above it "
        f"{sum(clamped)}; the robot's speed at most {fastest:.2f} of it, a gap's {closing:.2f}; relative to the limb "
        f"{relative:.2f} m/s at most"
    )


def memory(file: Path, clip: str, minutes: float) -> None:
    """Print how memory grows over so many minutes of simulation, after the first one."""
    one = simulation(file, clip, 0, "ours", monitored=False)
    per_minute = round(60 / one.replanner.tick)
    first = 0.0
    for k, _ in enumerate(one.ticks(60 * minutes)):
        if k == per_minute:
            first = _resident()
    print(f"memory after {minutes:g} minutes, against one: {_resident() - first:+.1f} MB")


def _resident() -> float:
    """Return the memory of this process [MB]."""
    gc.collect()
    statm = Path("/proc/self/statm")
    if statm.exists():
        return int(statm.read_text().split()[1]) * resource.getpagesize() / 1e6
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3  # the most that it ever was


def main() -> None:
    """Run what the options choose."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folder", type=Path)
    parser.add_argument("--clips", type=int, default=0, metavar="N", help="of each file; default: all")
    parser.add_argument("--places", type=int, default=20, metavar="N")
    parser.add_argument(
        "--seconds", type=float, default=0.0, metavar="S", help="of each; default: the clip's"
    )
    parser.add_argument(
        "--sample",
        type=int,
        default=0,
        metavar="N",
        help="only so many of all clips and places, drawn evenly",
    )
    parser.add_argument("--reach", metavar="FILE", help="calibrated reach, with its gate; default: speeds")
    parser.add_argument(
        "--near", action="store_true", help="people within arm's reach, who face the robot, at every place"
    )
    parser.add_argument("--gate", type=float, metavar="V", help="key points above V m/s are glitches")
    parser.add_argument(
        "--tick", type=float, default=TICK, metavar="S", help="between measurements, and between commands"
    )
    parser.add_argument("--seed", type=int, default=0, metavar="N", help="of the sample")
    parser.add_argument("--policies", default=",".join(POLICIES))
    parser.add_argument("--jobs", type=int, default=1, metavar="N", help="processes")
    parser.add_argument("--memory", type=float, default=0.0, metavar="MINUTES", help="measure memory instead")
    options = parser.parse_args()
    files = sorted(options.folder.glob("*.npz"))
    if not files:
        parser.error(f"no .npz files in {options.folder}")
    if options.gate is not None and options.reach is not None:
        parser.error("--gate: a reach has a gate of its own")
    logging.disable(logging.WARNING)
    reach = None if options.reach is None else CalibratedReach.load(options.reach)
    if options.memory:
        memory(files[0], "clip_0", options.memory)
        return
    situations = [
        (file, clip, place)
        for file in files
        for clip in (list_clips(file)[: options.clips] if options.clips else list_clips(file))
        for place in range(options.places)
    ]
    if 0 < options.sample < len(situations):
        chosen = np.random.default_rng(options.seed).choice(len(situations), options.sample, replace=False)
        situations = [situations[k] for k in sorted(chosen.tolist())]
    jobs = [
        (*situation, policy, options.seconds, options.places, reach, options.near, options.gate, options.tick)
        for situation in situations
        for policy in options.policies.split(",")
    ]
    if options.jobs == 1:
        rows = [run(job) for job in jobs]
    else:
        with ProcessPoolExecutor(options.jobs, mp_context=get_context("spawn")) as pool:
            rows = list(pool.map(run, jobs))
    print_table(rows)
    for row in rows:
        if row["policy"] == "ours" and row["contacts_while_moving"]:
            print("CONTACT", row)


if __name__ == "__main__":
    main()
