"""`safe-ompl judge`: entries of the open table, judged by plain samples; a page that shows all of them."""

from __future__ import annotations

import argparse
from base64 import b64encode
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from html import escape
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from rich.markup import escape as escape_markup
from rich.table import Table

from safe_ompl.apps.benchmark import JUDGED, VERSION, Entry, PlainGeometry, ProblemSet
from safe_ompl.apps.cli import arguments, output
from safe_ompl.apps.cli.arguments import option
from safe_ompl.common import InputError, files
from safe_ompl.common import documents as document
from safe_ompl.io import read_json, schema
from safe_ompl.view import render_contact

_ENDING = ".judged.json"
_PAGE = "index.html"


def add_commands(commands: Any) -> None:
    """Add `judge` to the commands."""
    parser = arguments.add_parser(
        commands,
        "judge",
        prepare,
        "judge entries of the open table: paths and motions of any planner",
        "Judge what other systems answered to the problems of files: contacts at samples 0.0002 rad apart, clearance, "
        "danger, lengths, and times as they are told. Nothing is proven or repaired here. The folder holds a JSON file "
        "and a picture of the worst place for each entry that was ever judged into it, and a page of all of them that "
        "needs no server. The exit status is 0 if every answer is solved without contact.",
    )
    option(parser, "entries ENTRY", "entries (JSON), or folders of them", nargs="+")
    option(
        parser,
        "--problems FILE",
        "files of the problems: MotionBenchMaker's (JSON form), or drives beside recorded people",
        nargs="+",
        required=True,
    )
    option(parser, "--out DIR", "", Path, Path("judged"))
    arguments.add_force(parser)


def prepare(options: argparse.Namespace) -> Callable[[], int]:
    """Read problems and entries, and return the job."""
    sets: dict[str, ProblemSet] = {}
    for file in options.problems:
        if Path(file).stem in sets:
            raise InputError("another problem set has this name: rename one", str(file))
        sets[Path(file).stem] = ProblemSet.load(file)
    given = [file for name in options.entries for file in _files(Path(name))]
    entries: dict[str, Entry] = {}
    for entry in given:
        if entry.stem in entries:
            raise InputError("another entry has this name: rename one", str(entry))
        entries[entry.stem] = Entry.load(entry, list(sets.values()))
    output.make_folder(options.out, "--out", [f"{name}{_ENDING}" for name in entries], force=options.force)
    return partial(_judge, entries, options.out)


def _files(path: Path) -> list[Path]:
    found = sorted(path.glob("*.json")) if path.is_dir() else [path]
    if not found:
        raise InputError("holds no entries (*.json)", str(path))
    return found


def _judge(entries: Mapping[str, Entry], folder: Path) -> int:
    """Judge entries, show a table of them, and write results, pictures and page."""
    console, advice, results = output.error_console(), output.missing_extra("plots"), []
    with output.progress_bar(console) as progress:
        for name, entry in progress.track(entries.items(), description="judging"):
            results.append(judge_into(entry, name, folder, drawn=not advice))
    for table in judged_tables(results):
        output.console().print(table)
    for result in results:
        if result["failed"]:
            output.console().print(f"{result['system']}: {result['failed']}", markup=False)
    if advice:
        console.print(f"safe-ompl: no pictures: {advice}")
    console.print(f"results and the page of all entries: {write_page(folder)}")
    rows = [row for result in results for row in result["rows"]]
    return 0 if rows and all(row["solved"] and not row["touching"] for row in rows) else 1


def judge_into(entry: Entry, name: str, folder: Path, *, drawn: bool = True) -> dict[str, Any]:
    """Judge an entry, write NAME.judged.json and, if it is drawn, NAME.webp to a folder, and return the result."""
    result = entry.judged()
    picture = folder / f"{name}.webp"
    picture.unlink(missing_ok=True)
    reached = [
        (row, answer) for row, answer in zip(result["rows"], entry.answers, strict=True) if "worst" in row
    ]
    if reached:
        row, answer = min(reached, key=lambda pair: pair[0]["worst"]["distance"])
        result["worst"] = {"problem": row["problem"], "seed": row["seed"], **row["worst"]}
        if drawn:
            files.write(picture, _drawn(answer.problem, row["worst"]))
    output.write_json(str(folder / f"{name}{_ENDING}"), result)
    return result


def _drawn(problem: Any, worst: Mapping[str, Any]) -> bytes:
    """Return a picture (WebP) of the configuration at which a robot is deepest in something, or nearest to it."""
    from PIL import Image

    q, scene = np.array(worst["q"]), problem.scene
    if worst["time"] is not None:
        scene = scene.with_obstacles(*problem.beside.obstacles(worst["time"]))
    plain = PlainGeometry(problem.robot, scene)
    point = plain.touching_point(int(plain.distances(q).argmin()))
    stream = BytesIO()
    image = render_contact(problem.robot, scene, q, (worst["link"], worst["other"]), point)
    Image.fromarray(image).save(stream, "webp", quality=85)
    return stream.getvalue()


# ------------------------------------------------------------------------------------------------ tables


def _columns(rows: Sequence[Mapping[str, Any]]) -> list[str]:
    """Return the columns of a table: what any of its rows has, of which some entry knows the value."""
    keys = dict.fromkeys(key for row in rows for key in row)
    return [
        key
        for key in keys
        if key not in ("set", "system", "name") and any(r.get(key) is not None for r in rows)
    ]


def _by_set(results: Sequence[Mapping[str, Any]]) -> dict[str, list[dict[str, Any]]]:
    found: dict[str, list[dict[str, Any]]] = {}
    for result in results:
        for line in result["summary"]:
            words = {"system": result["system"], "name": result.get("name", "")}
            found.setdefault(line["set"], []).append({**words, **line})
    return found


def judged_tables(results: Sequence[Mapping[str, Any]]) -> list[Table]:
    """Return a table for each problem set, with a row for each entry."""
    tables = []
    for name, rows in _by_set(results).items():
        columns = _columns(rows)
        table = output.plain_table("system", title=name, gap=1)
        table.caption = "Medians over what is solved; touching: paths that touch something, at 0.0002 rad."
        for column in columns:
            table.add_column(column.replace(" ", "\n"), justify="right", vertical="bottom")
        for row in rows:
            table.add_row(escape_markup(row["system"]), *(_written(row.get(column)) for column in columns))
        tables.append(table)
    return tables


def _written(value: float | None) -> str:
    if value is None:
        return "–"
    return str(value) if isinstance(value, int) else f"{value:.3g}" if abs(value) < 1000 else f"{value:.0f}"


# -------------------------------------------------------------------------------------------------- page

_HEAD = """<!DOCTYPE html><html lang="en"><head><meta charset="utf-8"><title>Judged entries</title>
<meta name="viewport" content="width=device-width"><style>
body {font: 15px/1.45 system-ui, sans-serif; color: #222; max-width: 1280px; margin: 2em auto; padding: 0 1em}
h1 {font-size: 1.5em} h2 {font-size: 1.15em; margin-top: 1.8em} p {max-width: 50em} a {color: #0b62b4}
.wide {overflow-x: auto} table {border-collapse: collapse; font-variant-numeric: tabular-nums}
th, td {padding: .35em .5em; text-align: right; border-bottom: 1px solid #ddd; vertical-align: bottom}
th {cursor: pointer; font-weight: 600; font-size: .86em; user-select: none} th:hover {background: #eef4fa}
th:first-child, td:first-child {text-align: left; min-width: 13em} th[data-way="1"]::after {content: " ▲"}
th[data-way="-1"]::after {content: " ▼"} td.bad {color: #b3261e; font-weight: 600}
.all {display: grid; grid-template-columns: repeat(auto-fill, minmax(520px, 1fr)); gap: 1.6em}
figure {margin: 0} figure img {width: 100%; border: 1px solid #ddd} figcaption {font-size: .9em} .told {color: #666}
</style></head><body><h1>Judged entries</h1>
<p>Paths and motions of many systems, judged by plain samples: contacts at 0.0002 rad, distances and the danger field
at 0.01 rad, all by Pinocchio and coal; medians over what is solved. Times are as each entry tells them, on its own
machine. A click on a column sorts by it.</p>
"""
_TAIL = """<script>
document.querySelectorAll("th").forEach(head => head.onclick = () => {
  const way = head.dataset.way == 1 ? -1 : 1, body = head.closest("table").tBodies[0];
  const value = row => { const text = row.cells[head.cellIndex].dataset.value, number = parseFloat(text);
    return isNaN(number) ? text : number; };
  const order = (a, b) => a === "" || b === "" ? (a === "") - (b === "") : way * (a > b ? 1 : a < b ? -1 : 0);
  head.parentNode.querySelectorAll("th").forEach(other => delete other.dataset.way);
  head.dataset.way = way;
  body.append(...[...body.rows].sort((a, b) => order(value(a), value(b))));
});
</script></body></html>
"""


def write_page(folder: Path) -> Path:
    """Write a page of all entries that were judged into a folder, and return it; its pictures are inside."""
    judged = sorted(folder.glob(f"*{_ENDING}"))
    results = []
    for file in judged:
        content = read_json(file)
        with document.within(str(file), ": "):
            schema.check_form(content, JUDGED, VERSION)
        results.append({**content, "name": file.name.removesuffix(_ENDING)})
    parts = [_HEAD]
    for name, rows in _by_set(results).items():
        columns = _columns(rows)
        heads = "".join(f"<th>{escape(column)}</th>" for column in ("system", *columns))
        parts.append(f"<h2>{escape(name)}</h2><div class=wide><table><thead><tr>{heads}</tr></thead><tbody>")
        for row in rows:
            link = f'<a href="#{escape(row["name"])}">{escape(row["system"])}</a>'
            cells = [f'<td data-value=" {escape(row["system"])}">{link}</td>']
            cells += [_cell(column, row.get(column)) for column in columns]
            parts.append(f"<tr>{''.join(cells)}</tr>")
        parts.append("</tbody></table></div>")
    failed = [result for result in results if result["failed"]]
    if failed:
        lines = (
            f"<li><b>{escape(result['system'])}</b>: {escape(result['failed'])}</li>" for result in failed
        )
        parts.append(f"<h2>Not run</h2><ul>{''.join(lines)}</ul>")
    parts.append("<h2>The worst contact of each, or the nearest miss</h2>")
    parts.append("<p>Right: from near, without the walls before it.</p><div class=all>")
    parts += [_figure(result, folder) for result in results if not result["failed"]]
    page = folder / _PAGE
    files.write(page, "\n".join([*parts, "</div>", _TAIL]))
    return page


def _cell(column: str, value: float | None) -> str:
    bad = value and (column == "touching" or column.startswith("contacts moving"))
    return f'<td data-value="{"" if value is None else value}"{" class=bad" if bad else ""}>{_written(value)}</td>'


def _figure(result: Mapping[str, Any], folder: Path) -> str:
    """Return the picture of an entry's worst place with a caption, and what the entry tells of itself."""
    picture, worst = folder / f"{result['name']}.webp", result.get("worst")
    words = "no path to judge"
    if worst:
        distance = 1e3 * worst["distance"]
        how = f"{-distance:.3g} mm inside" if distance <= 0 else f"{distance:.3g} mm from"
        words = f"{worst['link']} {how} {worst['other']}; {worst['problem']}, seed {worst['seed']}"
        words += "" if worst["time"] is None else f", at {worst['time']:.2f} s"
    image = ""
    if picture.exists():
        image = f'<img alt="{escape(words)}" src="data:image/webp;base64,{b64encode(picture.read_bytes()).decode()}">'
    told = "; ".join(f"{key.replace('_', ' ')}: {text}" for key, text in result["told"].items())
    return (
        f'<figure id="{escape(result["name"])}">{image}<figcaption><b>{escape(result["system"])}</b>: {escape(words)}'
        f"<div class=told>{escape(told)}</div></figcaption></figure>"
    )
