"""Drives beside recorded people as problems for anybody, and as entries of the open table.

Run it from the root of the repository with `python -m bench.drives RECORDINGS --out FOLDER`, RECORDINGS with
recordings (.npz). The problems (`drives.json`) are those of `bench.live`: a Panda that goes to and fro, and a person at
places drawn from a seed. They name the recordings, relative to the folder, and their SHA-256. An entry is written for
each policy; `safe-ompl judge FOLDER/entries --problems FOLDER/drives.json` judges them. The judge's person is the
recorded one without the glitches of the sensor, which the policies see.
"""

from __future__ import annotations

import argparse
import json
import logging
from pathlib import Path
from typing import Any

from bench.live import POLICIES, simulation
from safe_ompl import Motion
from safe_ompl.apps.benchmark import checksum
from safe_ompl.common.documents import file_name
from safe_ompl.io import marked
from safe_ompl.io.problems import carried_scene
from safe_ompl.people import list_clips

GLITCH = 6.0  # [m/s] no key point of these people is so fast


def main() -> None:
    """Write problems and entries."""
    options = _options()
    logging.disable(logging.WARNING)
    out = options.out
    (out / "entries").mkdir(parents=True, exist_ok=True)
    situations = [
        (file, clip, place)
        for file in sorted(options.recordings.glob("*.npz"))
        for clip in list_clips(file)[: options.clips]
        for place in range(options.places)
    ]
    if not situations:
        raise SystemExit(f"no recordings (.npz) in {options.recordings}")
    drives = []
    for file, clip, place in situations:
        one = simulation(file, clip, place, "alone", monitored=False, count=options.places)
        there, back = (trajectory.curve.at([0.0]).q[0].tolist() for trajectory in one.trajectories)
        drive = {"name": f"{file.stem} {clip} {place}", "recording": file_name(file.resolve(), out)}
        drive |= {"sha256": checksum(file), "clip": clip, "gate": GLITCH, "seconds": options.seconds}
        drive |= {"place": one.world.people["operator"].tracker.place.to_mapping()}
        drives.append({**drive, "start": there, "goals": [back, there]})
    problems, scene = out / "drives.json", carried_scene(one.replanner.surroundings.still)
    content = {"format": "safe-ompl drives", "robot": "panda", "scene": scene, "drives": drives}
    problems.write_text(json.dumps(content), encoding="utf-8")
    for policy in options.policies.split(","):
        answers = []
        for (file, clip, place), drive in zip(situations, drives, strict=True):
            one = simulation(file, clip, place, policy, monitored=False, count=options.places)
            answers.append({"problem": drive["name"], "motion": _driven(one, options.seconds)})
        sets = [{"name": problems.stem, "sha256": checksum(problems), "answers": answers}]
        entry = {"format": "safe-ompl entry", "version": 1, "system": policy, "sets": sets}
        (out / "entries" / f"{policy}.json").write_text(json.dumps(entry), encoding="utf-8")


def _driven(one: Any, seconds: float) -> dict[str, Any]:
    """Return the motion of a simulation through the states of its ticks, in the form of `safe_ompl.save`."""
    ticks = list(one.ticks(seconds + 2 * one.replanner.tick))
    times, q, qd = ([tick[key] for tick in ticks] for key in ("time", "q", "qd"))
    motion = Motion.hermite(times, q, qd, names=one.replanner.robot.joint_names)
    return marked("motion", motion.to_mapping())


def _options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("recordings", type=Path)
    parser.add_argument("--out", type=Path, required=True, metavar="FOLDER")
    parser.add_argument("--clips", type=int, default=1, metavar="N", help="of each file (default: 1)")
    parser.add_argument("--places", type=int, default=2, metavar="N", help="of each clip (default: 2)")
    parser.add_argument("--seconds", type=float, default=10.0, metavar="S", help="of each (default: 10)")
    parser.add_argument("--policies", default=",".join(POLICIES), metavar="A,B,...")
    return parser.parse_args()


if __name__ == "__main__":
    main()
