"""Calibrated reach on kinds of work that it was not calibrated with, against bounds of speeds.

Run it from the root of the repository with `python -m bench.reach FOLDER`, FOLDER with recordings (.npz), one file for
each kind of work. Each kind is held out in turn: the reach is calibrated with the others, and the table says how often
people of this one keep to it: in which share of its recordings all the time, and in which share of its time, that is of
the frames that lie within the sets of all frames up to `--within` seconds before. *Raw* is the same share if the key
points that the gate refuses were true. The row below is of the speeds that `bench.live` takes, without a gate.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from bench.live import HANDS
from safe_ompl.common import FloatArray
from safe_ompl.people import CalibratedReach, Calibration, Recording, calibrate, list_clips
from safe_ompl.people.calibration import Windows
from safe_ompl.scene import People

SHOWN = ("right_hand", "head", "torso")
TIMES = (0.1, 0.3)  # [s]


def kept(
    recordings: list[Recording], lines: Mapping[str, FloatArray], gate: float | None, within: float
) -> tuple[float, float, float, float]:
    """Return shares: recordings that keep to growth all the time, time, raw time, and key points refused."""
    units, times, seen, refused = [], {False: [], True: []}, 0, 0
    for recording in recordings:
        for glitches in (False, True):
            windows = Windows.of(recording, within, gate, glitches=glitches)
            over = windows.ratios([lines[limb] for limb in windows.limbs]) > 1 + 1e-9
            left = np.zeros(len(over), dtype=bool)
            for k in range(1, over.shape[1] + 1):
                left[k:] |= over[:-k, k - 1]
            times[glitches] += (~left).tolist()
            if not glitches:
                units.append(not over.any())
                seen, refused = seen + windows.seen, refused + windows.refused
    shares = np.mean(units), np.mean(times[False]), np.mean(times[True]), refused / max(1, seen)
    return tuple(map(float, shares))  # type: ignore[return-value]


def row(
    name: str, reach: CalibratedReach | None, lines: Mapping[str, FloatArray], shares: tuple[float, ...]
) -> None:
    """Print a row."""
    sizes = "  ".join(
        "/".join(f"{(lines[limb] @ [1.0, time]).min():.2f}" for time in TIMES) for limb in SHOWN
    )
    units, time, raw, refused = (100 * share for share in shares)
    count = "" if reach is None else str(reach.units)
    print(
        f"{name:38} {count:>4} {units:9.0f}% {time:7.2f}% {raw:7.2f}% {refused:7.2f}%   {sizes}", flush=True
    )


def main() -> None:
    """Run what the options choose."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folder", type=Path)
    parser.add_argument("--level", type=float, default=0.9)
    parser.add_argument("--gate", type=float, default=Calibration.gate, metavar="V")
    parser.add_argument("--block", type=float, metavar="S")
    parser.add_argument("--within", type=float, default=0.3, metavar="S")
    options = parser.parse_args()
    kinds = {
        file.stem: [Recording.load(file, clip) for clip in list_clips(file)]
        for file in sorted(options.folder.glob("*.npz"))
    }
    if len(kinds) < 2:
        parser.error(f"fewer than two .npz files in {options.folder}")
    how = Calibration(options.level, gate=options.gate, block=options.block)
    people = People(speed=1.6, speeds=HANDS)
    print(
        f"level {how.level:g}, gate {how.gate:g} m/s, units: "
        + ("recordings" if how.block is None else f"blocks of {how.block:g} s")
    )
    sizes = "  ".join(f"{limb} [m]" for limb in SHOWN)
    print(f"{'held out':38} {'N':>4} {'recordings':>10} {'time':>8} {'raw':>8} {'refused':>8}   {sizes}")
    for name, recordings in kinds.items():
        reach = calibrate([r for other, rs in kinds.items() if other != name for r in rs], how)
        row(name, reach, reach.lines, kept(recordings, reach.lines, how.gate, options.within))
        speeds = {limb: np.array([[0.0, people.speed_of(limb)]]) for limb in reach.limbs}
        row(
            "  speeds of 1.6 and 2 m/s, no gate", None, speeds, kept(recordings, speeds, None, options.within)
        )


if __name__ == "__main__":
    main()
