"""The harness of the benches: what all of them warm up, pair, repeat, print and write down with.

A bench is a module with a docstring, whose first line `python -m bench` lists; the `CLAIM` that it backs, or the
decision that a maintainer takes by it; `add_options(parser)`, which may be missing; and either `main(options, report)`,
which returns 1 where something failed, or `PARTS`, functions of the same arguments that `--only` chooses from.
"""

from __future__ import annotations

import argparse
import ast
import importlib
import json
import logging
import re
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from time import process_time, strftime
from types import ModuleType
from typing import Any

import numpy as np
from ompl import util as ou

FOLDER = Path(__file__).parent


# ------------------------------------------------------------------------------------------------------ running


def names() -> list[str]:
    """Return the names of all benches."""
    found = [*FOLDER.glob("[a-z]*.py"), *(file.parent for file in FOLDER.glob("[a-z]*/__init__.py"))]
    return sorted(file.stem for file in found)


def bench(name: str) -> ModuleType:
    """Import a bench."""
    return importlib.import_module(f"bench.{name}")


def about(name: str) -> tuple[str, str]:
    """Return the first line of a bench's docstring and its claim, without importing what it needs."""
    file = FOLDER / f"{name}.py"
    tree = ast.parse((file if file.is_file() else FOLDER / name / "__init__.py").read_text(encoding="utf-8"))
    values = (node for node in tree.body if isinstance(node, ast.Assign))
    claims = (node.value for node in values if getattr(node.targets[0], "id", "") == "CLAIM")
    return (ast.get_docstring(tree) or "").splitlines()[0], ast.literal_eval(next(claims))


def parser_of(name: str) -> argparse.ArgumentParser:
    """Return the parser of a bench's options."""
    module = bench(name)
    parser = argparse.ArgumentParser(
        prog=f"python -m bench {name}",
        description=f"{module.__doc__}\nWhat it backs: {module.CLAIM}.",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the outcome there, too")
    parser.add_argument("--markdown", action="store_true", help="print tables in Markdown")
    if hasattr(module, "PARTS"):
        chosen = list(module.PARTS)
        parser.add_argument("--only", nargs="+", choices=chosen, default=chosen, metavar="PART")
    getattr(module, "add_options", lambda _: None)(parser)
    return parser


def run(arguments: Sequence[str]) -> int:
    """Run `python -m bench` with these arguments: list the benches, or run one; return the exit status."""
    if not arguments or arguments[0] in ("-h", "--help"):
        for name in names():
            print(f"{name:14s}{about(name)[0]}")
        return 0
    name, *rest = arguments
    if name not in names():
        print(f"no bench {name!r}; there are {', '.join(names())}", file=sys.stderr)
        return 2
    options = parser_of(name).parse_args(rest)
    report = Report(options.markdown)
    logging.disable(logging.WARNING)
    ou.setLogLevel(ou.LogLevel.LOG_NONE)
    module, failed = bench(name), 0
    if hasattr(module, "PARTS"):
        for part in options.only:
            print(f"\n{part}", flush=True)
            failed |= int(module.PARTS[part](options, report) or 0)
    else:
        failed = int(module.main(options, report) or 0)
    if options.json:
        report.write(options.json, arguments)
    return failed


def positions(text: str) -> slice:
    """Read a range of positions like Python's: ``0:50``, ``:50``, ``50:``."""
    first, last = text.split(":")
    return slice(int(first) if first else 0, int(last) if last else None)


# ----------------------------------------------------------------------------------------------------- printing


class Report:
    """What a bench found: it is printed at once, and kept for `--json`.

    Attributes
    ----------
    tables : list of dict
        Title, header and rows of each table.
    figures : dict
        Single numbers by name.
    counts : list of list
        Verdicts that were looked at: what they are, how many, how many are false, how many were left open.
    """

    def __init__(self, markdown: bool = False) -> None:
        self._markdown = markdown
        self.tables: list[dict[str, Any]] = []
        self.figures: dict[str, Any] = {}
        self.counts: list[list[Any]] = []

    def table(self, header: Sequence[str], rows: Sequence[Sequence[object]], title: str = "") -> None:
        """Print rows under a header, numbers to the right."""
        self.tables.append({"title": title, "header": list(header), "rows": [list(row) for row in rows]})
        if self._markdown:
            print(f"\n{title}\n\n{markdown_table(header, rows)}", flush=True)
            return
        cells = [[said(cell) for cell in row] for row in (header, *rows)]
        widths = [max(len(row[k]) for row in cells) for k in range(len(header))]
        if title:
            print(f"\n{title}")
        for row in cells:
            padded = [
                cell.rjust(w) if k else cell.ljust(w) for k, (cell, w) in enumerate(zip(row, widths, strict=True))
            ]
            print("  ".join(padded).rstrip(), flush=True)

    def figure(self, name: str, value: object) -> None:
        """Print one number with its name."""
        self.figures[name] = value
        print(f"{name}: {said(value)}", flush=True)

    def counted(self, what: str, number: int, false: int, undecided: int | str = "–") -> None:
        """Print how many verdicts were looked at, how many of them are false, and how many were left open."""
        self.counts.append([what, number, false, undecided])
        print(f"{what}: {number}, false: {false}, undecided: {undecided}")

    def write(self, file: Path, command: Sequence[str]) -> None:
        """Write all of it with the command and the date."""
        found = {"command": " ".join(["python -m bench", *command]), "date": strftime("%Y-%m-%d")}
        found |= {"figures": self.figures, "counted": self.counts, "tables": self.tables}
        text = json.dumps(found, indent=1, ensure_ascii=False, default=_plain)
        file.write_text(text + "\n", encoding="utf-8")


def said(cell: object) -> str:
    """Return a cell of a table as text, with large numbers in full."""
    text = f"{cell:.3g}" if isinstance(cell, (float, np.floating)) else str(cell)
    return re.sub(r"\d[\d.]*e\+\d+", lambda number: f"{float(number[0]):.0f}", text)


def markdown_table(header: Sequence[str], rows: Sequence[Sequence[object]]) -> str:
    """Return a table in Markdown."""
    lines = [header, ["---"] * len(header), *rows]
    return "\n".join("| " + " | ".join(map(said, line)) + " |" for line in lines)


def _plain(value: Any) -> Any:
    return value.tolist() if isinstance(value, (np.ndarray, np.generic)) else str(value)


# ------------------------------------------------------------------------------------------------------- timing


class Times:
    """CPU times of several calls, one for each round in which all of them ran.

    Attributes
    ----------
    rounds : dict of str to list of float
        Seconds per item of each round.
    """

    def __init__(self, rounds: Mapping[str, list[float]]) -> None:
        self.rounds = dict(rounds)

    def microseconds(self, name: str) -> float:
        """Return the median time per item [µs]."""
        return 1e6 * float(np.median(self.rounds[name]))

    def ratio(self, name: str, reference: str) -> float:
        """Return the median, over the rounds, of the time of `name` divided by that of `reference`."""
        return float(np.median(np.array(self.rounds[name]) / np.array(self.rounds[reference])))


def in_turn(calls: Mapping[str, Callable[[], object]], items: int, rounds: int) -> Times:
    """Run every call once to warm up, and then once in each of `rounds` rounds; time per item of `items`.

    They take turns in one process, so that a busy machine slows all alike.
    """
    taken: dict[str, list[float]] = {name: [] for name in calls}
    for call in calls.values():
        call()
    for _ in range(rounds):
        for name, call in calls.items():
            begin = process_time()
            call()
            taken[name].append((process_time() - begin) / items)
    return Times(taken)
