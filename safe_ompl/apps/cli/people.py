"""`safe-ompl people`: how far people go, calibrated with recordings."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

from rich.table import Table
from rich.text import Text

from safe_ompl.apps.cli.options import add_parser, limit, random_seed, seconds, share
from safe_ompl.apps.cli.output import check_writable, error_console, output_console, plain_table
from safe_ompl.common import InputError
from safe_ompl.people import CalibratedReach, Calibration, Recording, calibrate, list_clips


def add_commands(commands: Any) -> None:
    """Add `people` to the commands."""
    summary = "how far people go: reach models from recordings"
    inner = commands.add_parser(
        "people", help=summary, description=f"{summary}.".capitalize()
    ).add_subparsers(metavar="COMMAND", required=True)
    parser = add_parser(
        inner,
        "calibrate",
        prepare,
        "write a reach file: how far each limb goes in a time, at a level",
        "Find how far limbs go from where they were seen last, so that all limbs of a share of the recordings keep to "
        "it at all times. This holds for recordings that are exchangeable with those given: the same people at the "
        "same kind of work. On other kinds of work it is measured, not guaranteed.",
    )
    parser.add_argument(
        "recordings", nargs="+", metavar="RECORDINGS", help="files of recordings (.npz); all clips are used"
    )
    parser.add_argument(
        "--level", type=share, required=True, metavar="SHARE", help="share of the units that keep to it"
    )
    parser.add_argument("-o", "--out", required=True, metavar="FILE", help="the reach file (.yaml)")
    parser.add_argument(
        "--gate",
        type=limit,
        default=Calibration.gate,
        metavar="V",
        help="key points that are faster are glitches and not seen [m/s]; default: %(default)g",
    )
    parser.add_argument(
        "--horizons",
        type=seconds,
        nargs="+",
        default=Calibration.horizons,
        metavar="S",
        help="times at which the shapes have corners [s]; default: %(default)s",
    )
    parser.add_argument(
        "--fit",
        type=share,
        default=Calibration.fit,
        metavar="SHARE",
        help="share of the recordings that the shapes come from; default: %(default)g",
    )
    parser.add_argument(
        "--seed", type=random_seed, default=0, metavar="N", help="draws those recordings; default: 0"
    )
    parser.add_argument(
        "--block", type=seconds, metavar="S", help="units are blocks of so many seconds; default: recordings"
    )


def prepare(options: argparse.Namespace) -> Callable[[], int]:
    """Read the recordings, and return the job."""
    if Path(options.out).suffix.lower() not in (".yaml", ".yml"):
        raise InputError(f"{options.out!r} must end in .yaml or .yml", "--out")
    check_writable(options.out, "--out")
    keys = ("level", "gate", "fit", "seed", "block")
    how = Calibration(horizons=tuple(options.horizons), **{key: getattr(options, key) for key in keys})
    recordings = [Recording.load(file, clip) for file in options.recordings for clip in list_clips(file)]
    return partial(_calibrate, recordings, how, options.out)


def _calibrate(recordings: list[Recording], how: Calibration, out: str) -> int:
    """Write the reach file, and show what is in it."""
    found = calibrate(recordings, how)
    found.save(out)
    output_console().print(reach_table(found))
    error_console().print(f"reach in {out}")
    return 0


def reach_table(reach: CalibratedReach) -> Table:
    """Return how far limbs go by the horizons, and what that says."""
    table = plain_table("limb", *(f"{h:g} s" for h in reach.horizons), title="how far limbs go [m]")
    for limb in reach.limbs:
        table.add_row(limb, *(f"{reach.grown(limb, h):.3f}" for h in reach.horizons))
    table.caption = Text(
        f"{reach}; a gate of {reach.gate:g} m/s refused {100 * reach.refused:.2g} % of the key points.\n"
        f"This holds for the same people at the same kind of work. On other work it must be measured."
    )
    return table
