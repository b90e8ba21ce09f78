"""`safe-ompl report`: separation, speeds and stops of a drive beside people, from its log."""

from __future__ import annotations

import argparse
import io
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial
from html import escape
from pathlib import Path
from typing import Any

import numpy as np

from safe_ompl.apps.cli import arguments, output
from safe_ompl.apps.cli.arguments import option
from safe_ompl.apps.cli.view import TICK_READERS
from safe_ompl.common import InputError, documents as document
from safe_ompl.people.simulation import DriveReport
from safe_ompl.view import plots

TICKS = "ticks.jsonl"
_SHOWN = 30  # rows of a table on the page; the JSON has all
_NO_CLAIM = (
    "These are figures of a log, no claim of conformity with a standard. Their words are those of ISO 10218-2:2025, "
    "which has absorbed ISO/TS 15066. The protective distance is how far the nearest limb may come until the robot "
    "stands, by what was assumed, how far the nearest link goes until then, and the clearance. What was proven is the "
    "margin: it heeds where the robot goes, so it may be positive where the distance is less than the protective one."
)
_STYLE = (
    "body{font:16px/1.5 system-ui,sans-serif;max-width:60rem;margin:2rem auto;padding:0 1rem;color:#222}"
    "table{border-collapse:collapse;margin:1rem 0}td,th{padding:.2rem 1rem .2rem 0;text-align:left;vertical-align:top}"
    "th{border-bottom:1px solid #999}svg{max-width:100%;height:auto}h2{margin-top:2rem}"
)


def add_commands(commands: object) -> None:
    """Add `report` to the commands."""
    parser = arguments.add_parser(
        commands,
        "report",
        prepare,
        "what a log of a drive beside people says: separation, speeds, stops",
        "Tell from the log of `live` or `ros` how near people and things were and what distance had to be kept, how "
        "fast the robot was at which distance, when it stopped and why, and which assumptions were broken.",
    )
    option(parser, "log LOG", f"ticks (.jsonl), a log (.mcap), or a folder with {TICKS}")
    option(parser, "--json FILE", "write all figures, over time too", output.JSON_FILE)
    option(parser, "--html FILE", "write a page with a picture (.html)", output.output_file(".html", extra="plots"))


def prepare(options: argparse.Namespace) -> Callable[[], int]:
    """Read the log, and return the job."""
    file = Path(options.log)
    if file.is_dir():
        file /= TICKS
    read = TICK_READERS.get(file.suffix.lower())
    if read is None:
        raise InputError(f"{str(file)!r} must end in {' or '.join(TICK_READERS)}", "LOG")
    header, ticks = read(file)
    with document.within(str(file), ": "):
        report = DriveReport.of(header, ticks)
    return partial(_tell, report, file.name, options)


def _tell(report: DriveReport, name: str, options: argparse.Namespace) -> int:
    found = report.as_dict()
    if options.json:
        output.write_json(options.json, {"log": name, **found})
    if options.html:
        output.write_text(options.html, page(report, name, found))
    if options.json == output.STANDARD_OUTPUT:
        return 0
    output.say("\n".join(_lines(found)))
    for title, columns, rows in tables(report):
        table = output.plain_table(*columns, title=title)
        for row in rows[:_SHOWN]:
            table.add_row(*row)
        if rows:
            output.console().print(table)
    return 0


def _lines(found: Mapping[str, Any]) -> list[str]:
    """Return the summary of a drive from the figures of its report."""
    least, reaction = found["least_while_moving"], found["reaction"]
    shares = ", ".join(f"{state} {100 * share:.1f} %" for state, share in found["shares"].items())
    lines = [f"{found['seconds']:.2f} s, {found['ticks']} ticks: {shares}"]
    if least.get("distance") is not None:
        proven = "" if least["margin"] is None else f", the least proven margin {1e3 * least['margin']:.0f} mm"
        lines.append(f"while it moved: the least distance {1e3 * least['distance']:.0f} mm{proven}")
    missed = len(found["deadlines_missed"])
    lines.append(f"largest speed of a key point {found['largest_speed']:.2f} m/s; deadlines missed {missed}")
    if reaction is not None:
        lines.append(f"reaction {1e3 * reaction['median']:.1f} ms (99 %: {1e3 * reaction['p99']:.1f})")
    lines.append(f"assumed of people: {found['assumed']}; broken {len(found['broken'])} times")
    return lines


Rows = list[tuple[str, ...]]


def tables(report: DriveReport) -> list[tuple[str, tuple[str, ...], Rows]]:
    """Return titles, columns and rows of the tables of a report."""
    regions: Rows = []
    for region in report.regions():
        fast = tuple(f"{region[key]:.2f}" if key in region else "" for key in ("speed_95", "speed_max"))
        most = region["nearer_than"]
        name = "farther" if most == np.inf else f"< {most:g} m"
        regions.append((name, f"{100 * region['share']:.1f} %", *fast))
    halts: Rows = [(f"{h.begin:.2f}", f"{h.end - h.begin:.2f}", h.rule or "", h.why) for h in report.halts]
    broken: Rows = [(f"{b.begin:.2f}", f"{b.end - b.begin:.2f}", b.what) for b in report.broken]
    causes: Rows = [(f"{seconds:.2f}", str(times), why) for why, times, seconds in report.causes()]
    return [
        ("Speeds by distance to the nearest one", ("distance", "of the time", "95 %, m/s", "largest, m/s"), regions),
        ("Why it braked or stood", ("in all, s", "times", "why"), causes),
        ("When it braked or stood", ("at, s", "for, s", "rule", "why"), halts),
        ("Broken assumptions", ("at, s", "for, s", "who"), broken),
        ("Deadlines missed", ("at, s",), [(f"{time:.2f}",) for time in report.missed]),
    ]


def page(report: DriveReport, name: str, found: Mapping[str, Any]) -> str:
    """Return a page (HTML) with summary, picture and tables, which needs nothing else; `found` are its figures."""
    picture = io.StringIO()
    plots.plot_drive(report, None).savefig(picture, format="svg")
    svg = picture.getvalue()
    parts = [
        f"<h1>{escape(name)}</h1>",
        *(f"<p>{escape(line)}</p>" for line in _lines(found)),
        svg[svg.index("<svg") :],
    ]
    for title, columns, rows in tables(report):
        more = f"<p>{len(rows) - _SHOWN} more are in the JSON.</p>" if len(rows) > _SHOWN else ""
        parts.append(f"<h2>{title}</h2>{_table(columns, rows[:_SHOWN]) + more if rows else '<p>none</p>'}")
    parts += ["<h2>Made by</h2>", _table(("what", "version or hash"), list(report.made_by.items()))]
    parts.append(f"<p>{_NO_CLAIM}</p>")
    head = f'<meta charset="utf-8"><title>{escape(name)}</title><style>{_STYLE}</style>'
    return f"<!doctype html><html lang=en><head>{head}</head><body>{''.join(parts)}</body></html>\n"


def _table(columns: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    head = "".join(f"<th>{escape(column)}</th>" for column in columns)
    lines = ("".join(f"<td>{escape(cell)}</td>" for cell in row) for row in rows)
    return f"<table><tr>{head}</tr>{''.join(f'<tr>{line}</tr>' for line in lines)}</table>"
