"""All measurements of the pages, each in a process of its own, and the pages that are made of them.

    python -m bench all --out FOLDER --data FOLDER [--only NAME ...]    measures what FOLDER does not have yet
    python -m bench all --pages [--out FOLDER]                          only writes the pages

docs/measured.md lists what is measured, in lines like `<!-- measure: edges, 12 min, alone: certify --only hard -->`:
name, minutes of an idle core, whether it takes times and so runs alone (soundness is counted by two benches at a time),
and what follows `python -m bench`. There DATA is the folder of `--data`, with `motion_bench_maker_panda.json` and the
recordings in `people`; without it, benches that need them are left out. OUT is the folder of `--out`: its NAME.json
holds what a bench found, its command, the commit, the date, the machine, the versions of packages and the seconds that
it took, and NAME.log what it printed. A file is kept if its command is the same, and the code of the package and of the
benches is. `python -m bench fresh --tests --json FOLDER/environments.json`, which takes long, adds times on fresh
machines.

The files are copied to docs/measured. From there everything up to the next `<!-- end -->` is written, below those lines
and below `<!-- bench: NAME -->` on any page.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import platform
import re
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from time import monotonic
from typing import Any, NamedTuple

import numpy as np

from bench._harness import Report, markdown_table, said
from bench.peers.table import compact, figure

CLAIM = "every number on the pages comes from a file that says which command found it, when, and on what"
ROOT = Path(__file__).parents[1]
KEPT = ROOT / "docs" / "measured"
PACKAGES = ("ompl", "pin", "coal", "numpy", "scipy", "mujoco", "toppra", "ruckig", "pin-pink", "roboplan")
CODE = ("safe_ompl/*.py", "safe_ompl/*.pyx", "safe_ompl/*.pxd", "bench/*.py", "bench/*.json", "setup.py")
# Of each bench the page shows so many tables, and so many of their last rows. The files have all of them.
MOST_TABLES, MOST_ROWS = 2, 3
NOT_MEASURED = "bench/all.py", "bench/pages.py"  # what they write is made of files
MEASURE = re.compile(r"<!-- measure: (\w+), (\d+) min, (alone|two at a time): (.*) -->")
BLOCK = re.compile(r"(<!-- (?:bench|measure): ([\w ]+)(?:,[^>]*)? -->(\n*)).*?<!-- end -->", re.DOTALL)
NOTHING = "Not measured on this code."
RATIO = "CPU time of all ways / of one, all runs together"

Content = dict[str, Any]  # of a file
Found = dict[str, Content]


class Measurement(NamedTuple):
    """A bench with its options, and the name of its file."""

    name: str
    minutes: int
    alone: bool
    command: str

    @property
    def shown(self) -> str:
        """The command as pages show it."""
        return f"python -m bench {self.command}"


def listed() -> dict[str, Measurement]:
    """Return what docs/measured.md lists, by name."""
    lines = MEASURE.findall(KEPT.with_suffix(".md").read_text(encoding="utf-8"))
    return {name: Measurement(name, int(minutes), how == "alone", command) for name, minutes, how, command in lines}


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options."""
    parser.add_argument("--out", type=Path, metavar="FOLDER", help="for files and logs")
    parser.add_argument("--data", type=Path, metavar="FOLDER", help="with problems and recordings")
    parser.add_argument("--only", nargs="+", choices=listed(), default=list(listed()), metavar="NAME")
    parser.add_argument("--pages", action="store_true", help="only write the pages")


def main(options: argparse.Namespace, report: Report) -> int:
    """Measure, and write the pages."""
    failed = []
    if not options.pages:
        if options.out is None:
            print("--out FOLDER is missing", file=sys.stderr)
            return 2
        failed = measure((listed()[name] for name in options.only), options.out.resolve(), options.data)
    KEPT.mkdir(exist_ok=True)
    for file in sorted(options.out.glob("*.json")) if options.out else ():
        shutil.copy(file, KEPT)
    found = read(KEPT)
    for page, text in pages(found).items():
        page.write_text(text, encoding="utf-8")
    if "peers" in found:
        figure(found["peers"]["tables"][0], ROOT / "docs" / "peers.png")
    return int(bool(failed))


# ---------------------------------------------------------------------------------------------------- measuring


def measure(chosen: Iterable[Measurement], out: Path, data: Path | None) -> list[str]:
    """Measure what a folder has not got of this code; return the names of benches that failed."""
    out.mkdir(parents=True, exist_ok=True)
    about, begin, failed, left = circumstances(), monotonic(), list[str](), list[Measurement]()
    for each in chosen:
        file = out / f"{each.name}.json"
        known = json.loads(file.read_text(encoding="utf-8")) if file.is_file() else {}
        if known.get("code") == about["code"] and known["command"] == each.shown and not known["failed"]:
            print(f"{each.name}: kept")
        elif data is None and "DATA" in each.command:
            print(f"{each.name}: left out, needs --data")
        else:
            left.append(each)

    def run(each: Measurement) -> None:
        print(f"{(monotonic() - begin) / 60:.1f} min: {each.name}, about {each.minutes} min", flush=True)
        if run_bench(each, out, data, about):
            failed.append(each.name)
            print(f"{each.name} FAILED: see {out / each.name}.log", flush=True)

    for number, alone in ((2, False), (1, True)):
        with ThreadPoolExecutor(number) as pool:
            # The longest ones come first, so that neither process waits long for the other at the end.
            list(pool.map(run, sorted((x for x in left if x.alone == alone), key=lambda x: -x.minutes)))
    print(f"{(monotonic() - begin) / 60:.1f} min in all")
    return failed


def run_bench(each: Measurement, out: Path, data: Path | None, about: Content) -> bool:
    """Run a bench, and write its file; return whether it failed."""
    command = each.command.replace("DATA", str(data)).replace("OUT", str(out))
    fresh, begin = out / f"{each.name}.new", monotonic()
    fresh.unlink(missing_ok=True)
    with (out / f"{each.name}.log").open("w") as log:
        words = [sys.executable, "-m", "bench", *command.split(), "--json", str(fresh)]
        environment = {**os.environ, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
        status = subprocess.run(words, cwd=ROOT, stdout=log, stderr=log, env=environment, check=False).returncode
    if not fresh.is_file():
        return True
    text = fresh.read_text(encoding="utf-8")
    for place, name in ((out, "OUT"), (data, "DATA"), (ROOT, "."), (Path.home(), "~")):
        text = text.replace(str(place), name)
    found = {**json.loads(text), "command": each.shown, **about, "seconds": round(monotonic() - begin)}
    found["failed"] = status != 0
    fresh.write_text(json.dumps(found, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
    fresh.replace(out / f"{each.name}.json")
    return status != 0


def circumstances() -> Content:
    """Return commit, code, machine and versions."""
    code = hashlib.sha256()
    for name in sorted(set(_git("ls-files", *CODE).split()) - set(NOT_MEASURED)):
        code.update(name.encode() + b"\0" + (ROOT / name).read_bytes())
    cpus = Path("/proc/cpuinfo")
    models = re.findall(r"^model name\s*: (.*)$", cpus.read_text() if cpus.is_file() else "", re.MULTILINE)
    versions = {"python": platform.python_version()}
    for package in PACKAGES:
        try:
            versions[package] = version(package)
        except PackageNotFoundError:
            continue
    machine = f"{models[0] if models else platform.machine()}, {os.cpu_count()} cores"
    commit = _git("rev-parse", "--short", "HEAD")
    return {"commit": commit, "code": code.hexdigest()[:16], "machine": machine, "versions": versions}


def _git(*words: str) -> str:
    return subprocess.run(["git", *words], cwd=ROOT, check=True, capture_output=True, text=True).stdout.strip()


# -------------------------------------------------------------------------------------------------------- pages


def read(folder: Path) -> Found:
    """Return what the files of a folder hold, by name."""
    found = {file.stem: json.loads(file.read_text(encoding="utf-8")) for file in sorted(folder.glob("*.json"))}
    if unknown := set(found) - {*listed(), "environments"}:
        raise ValueError(f"{folder}: docs/measured.md does not list {', '.join(sorted(unknown))}")
    return found


def pages(found: Found) -> dict[Path, str]:
    """Return what the pages ought to be; on other pages than that of measurements, what was not measured stays."""
    texts = {page: page.read_text(encoding="utf-8") for page in (ROOT / "README.md", *ROOT.glob("docs/*.md"))}
    blocks = {name: section(found.get(name), each.shown) for name, each in listed().items()}
    blocks |= {name: make(found) for name, make in OF_ALL.items()}
    blocks |= {name: make(found[source]) for name, (source, make) in BLOCKS.items() if source in found}

    def filled(block: re.Match[str]) -> str:
        text = blocks.get(block[2])
        return block[0] if text is None else f"{block[1]}{text}{block[3]}<!-- end -->"

    return {page: BLOCK.sub(filled, text) for page, text in texts.items()}


def section(content: Content | None, command: str) -> str:
    """Return a command with what it found."""
    if content is None:
        return f"`{command}`\n\n{NOTHING}"
    head = f"`{content['command']}`, {content['seconds']} s{', **failed**' if content['failed'] else ''}"
    figures = "; ".join(f"{name}: {said(value)}" for name, value in content["figures"].items())
    # What was counted is in the table of tested verdicts.
    shown = "" if content.get("counted") else tables(content, MOST_TABLES, MOST_ROWS)
    return "\n\n".join(part for part in (head, figures, shown) if part)


def tables(content: Content, most: int | None = None, last: int = 0) -> str:
    """Return the first tables of a file with their `last` rows (0: all rows); of those with rows on all, only these."""
    parts = []
    for table in content["tables"][:most]:
        rows = [row for row in table["rows"] if str(row[0]).startswith("all")] or table["rows"][-last:]
        parts += [table["title"], markdown_table(table["header"], rows)]
    return "\n\n".join(part for part in parts if part)


def of_all(found: Found) -> str:
    """Return when, where and with what all was measured."""
    told = {
        key: sorted({str(each[key]) for each in found.values() if key in each}) for key in ("date", "commit", "machine")
    }
    versions = {f"{name} {number}" for each in found.values() for name, number in each.get("versions", {}).items()}
    minutes = sum(each.get("seconds", 0) for each in found.values()) / 60
    rows = [*told.items(), ("versions", sorted(versions)), ("minutes of all benches", [f"{minutes:.0f}"])]
    return markdown_table(("", ""), [(key, ", ".join(values)) for key, values in rows])


def soundness(found: Found) -> str:
    """Return the table of tested verdicts."""
    rows = [row for name in listed() for row in found.get(name, {}).get("counted", ())]
    return markdown_table(("verdicts", "number", "false", "undecided"), rows) if rows else NOTHING


def robots(content: Content) -> str:
    """Return a row on robots that came through all commands, and on those that did not."""
    rows = content["tables"][0]["rows"]
    stopped = [row for row in rows if row[4:7] != ["yes"] * 3]
    why = "; ".join(f"`{row[0]}`: {row[-1]}" for row in stopped)
    row = ("example-robot-data", len(rows), len(rows) - len(stopped), why)
    return markdown_table(("source", "robots", "passed", "not passed"), [row])


def on_fresh_machines(command: str, unit: float) -> Callable[[Content], str]:
    """Return what makes the median time of one of README's commands, in a unit [s]."""
    return lambda content: (
        f"{np.median([row[2] for row in content['tables'][0]['rows'] if row[1] == command]) / unit:.0f}"
    )


OF_ALL: dict[str, Callable[[Found], str]] = {"circumstances": of_all, "soundness": soundness}
BLOCKS: dict[str, tuple[str, Callable[[Content], str]]] = {
    "planners": ("peers", lambda content: markdown_table(*compact(content["tables"][0]))),
    "planners in full": ("peers", tables),
    "table of robots": ("robots", robots),
    "time of all ways": ("ways", lambda content: f"{content['figures'][RATIO]:.1f}"),
    "environments": ("environments", lambda content: f"`{content['command']}`\n\n{tables(content)}"),
    "first command": ("environments", on_fresh_machines("first", 1.0)),
    "second command": ("environments", on_fresh_machines("second", 60.0)),
}
