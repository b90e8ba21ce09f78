"""Calibrated reach on kinds of work that it was not calibrated with, against bounds of speeds.

FOLDER has recordings (.npz), one file for each kind of work. Each kind is held out in turn: the reach is calibrated
with the others, and the table says how often people of this one keep to it: in which share of its recordings all the
time, and in which share of its time, that is of the frames that lie within the sets of all frames up to `--within`
seconds before. *Raw* is the same share if the key points that the gate refuses were true. The row below is of the
speeds that `live` takes, without a gate.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from bench._harness import Report
from bench.live import HANDS
from safe_ompl.common import FloatArray
from safe_ompl.people import GATE, Recording, calibrate, list_clips
from safe_ompl.people.calibration import Windows
from safe_ompl.scene import People

CLAIM = "people keep to a calibrated reach in a share of the time that does not depend on the kind of work"
SHOWN = ("right_hand", "head", "torso")
TIMES = (0.1, 0.3)  # [s]
SPEEDS = "  speeds of 1.6 and 2 m/s, no gate"


def kept(
    recordings: list[Recording],
    lines: Mapping[str, FloatArray],
    speeds: Sequence[float],
    gate: float | None,
    within: float,
) -> FloatArray:
    """Return counts (7,): recordings, those that keep to it; frames, those that do, and raw; key points, refused."""
    counts = np.zeros(7)
    for recording in recordings:
        for glitches in (False, True):
            windows = Windows.of(recording, within, gate, glitches=glitches)
            over = windows.ratios([lines[limb] for limb in windows.limbs], speeds) > 1 + 1e-9
            left = np.zeros(len(over), dtype=bool)
            for k in range(1, over.shape[1] + 1):
                left[k:] |= over[:-k, k - 1]
            if glitches:
                counts[4] += (~left).sum()
            else:
                counts += [1, not over.any(), len(left), (~left).sum(), 0, windows.seen, windows.refused]
    return counts


def row(name: str, units: str, counts: FloatArray, lines: Mapping[str, FloatArray] | None = None) -> tuple[str, ...]:
    """Return a row of the table: shares, and how far some limbs go."""
    all_units, kept_units, frames, time, raw, points, refused = counts
    ratios = (kept_units / all_units, time / frames, raw / frames, refused / max(1, points))
    sizes = ["" if lines is None else _sizes(lines[limb]) for limb in SHOWN]
    return (name, units, *(f"{ratio:.2%}" for ratio in ratios), *sizes)


def _sizes(lines: FloatArray) -> str:
    return "/".join(f"{(lines[-1] @ [1.0, time]).min():.2f}" for time in TIMES)


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options."""
    parser.add_argument("folder", type=Path)
    parser.add_argument("--level", type=float, default=0.9)
    parser.add_argument("--gate", type=float, default=GATE, metavar="V")
    parser.add_argument("--block", type=float, metavar="S", help="units are blocks of so long; default: recordings")
    parser.add_argument("--within", type=float, default=0.3, metavar="S")


def main(options: argparse.Namespace, report: Report) -> None:
    """Report the table."""
    kinds = {
        file.stem: [Recording.load(file, clip) for clip in list_clips(file)]
        for file in sorted(options.folder.glob("*.npz"))
    }
    if len(kinds) < 2:
        raise SystemExit(f"fewer than two .npz files in {options.folder}")
    people, rows, totals = People(speed=1.6, speeds=HANDS), [], np.zeros((2, 7))
    for name, recordings in kinds.items():
        others = [r for other, rs in kinds.items() if other != name for r in rs]
        reach = calibrate(others, options.level, gate=options.gate, block=options.block)
        counts = kept(recordings, reach.lines, reach.speeds, options.gate, options.within)
        speeds = {limb: np.array([[[0.0, people.speed_of(limb)]]]) for limb in reach.limbs}
        plain = kept(recordings, speeds, (), None, options.within)
        rows += [row(name, str(reach.units), counts, reach.lines), row(SPEEDS, "", plain, speeds)]
        totals += [counts, plain]
    rows += [row("all", "", totals[0]), row(SPEEDS, "", totals[1])]
    sizes = (f"{limb} [m]" for limb in SHOWN)
    report.table(("held out", "N", "recordings", "time", "raw", "refused", *sizes), rows, f"level {options.level:g}")
