"""`safe-ompl people`: how far people go, calibrated with recordings."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from functools import partial
from typing import Any

from rich.table import Table
from rich.text import Text

from safe_ompl.apps.cli import arguments, output
from safe_ompl.apps.cli.arguments import option
from safe_ompl.people import GATE, CalibratedReach, Recording, calibrate, list_clips


def add_commands(commands: Any) -> None:
    """Add `people` to the commands."""
    summary = "how far people go: reach models from recordings"
    inner = commands.add_parser("people", help=summary, description=f"{summary}.".capitalize()).add_subparsers(
        metavar="COMMAND", required=True
    )
    parser = arguments.add_parser(
        inner,
        "calibrate",
        prepare,
        "write a reach file: how far each limb goes in a time, at a level",
        "Find how far limbs go from where they were seen last, so that all limbs of a share of the recordings keep to "
        "it at all times. This holds for recordings that are exchangeable with those given: the same people at the "
        "same kind of work. On other kinds of work it is measured, not guaranteed.",
    )
    option(parser, "recordings RECORDINGS", "files of recordings (.npz); all clips are used", nargs="+")
    option(parser, "--level SHARE", "share of the units that keep to it", arguments.share, required=True)
    option(parser, "-o, --out FILE", "the reach file (.yaml)", output.output_file(".yaml", ".yml"), required=True)
    arguments.add_force(parser)
    option(parser, "--gate V", "faster key points are glitches [m/s]", arguments.limit, GATE)
    option(parser, "--block S", "units are blocks of so many seconds; default: recordings", arguments.seconds)


def prepare(options: argparse.Namespace) -> Callable[[], int]:
    """Read the recordings, and return the job."""
    recordings = [Recording.load(file, clip) for file in options.recordings for clip in list_clips(file)]
    return partial(_calibrate, recordings, options)


def _calibrate(recordings: list[Recording], options: argparse.Namespace) -> int:
    """Write the reach file, and show what is in it."""
    found = calibrate(recordings, options.level, gate=options.gate, block=options.block)
    found.save(options.out)
    output.console().print(reach_table(found))
    output.error_console().print(f"reach in {options.out}")
    return 0


def reach_table(reach: CalibratedReach) -> Table:
    """Return how far limbs go by the horizons, and what that says."""
    table = output.plain_table("limb", *(f"{h:g} s" for h in reach.horizons), title="how far limbs go [m]")
    for limb in reach.limbs:
        table.add_row(limb, *(f"{reach.grown(limb, h):.3f}" for h in reach.horizons))
    table.caption = Text(
        f"{reach}; a gate of {reach.gate:g} m/s refused {100 * reach.refused:.2g} % of the key points.\n"
        f"This holds for the same people at the same kind of work. On other work it must be measured."
    )
    return table
