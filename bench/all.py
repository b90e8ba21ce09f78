"""All measurements of the pages, each in a process of its own, and the pages that are made of them.

    python -m bench all --out FOLDER --data FOLDER [--only NAME ...]    measures what FOLDER does not have yet
    python -m bench all --pages [--out FOLDER]                          only writes the pages

FOLDER/NAME.json of `--out` holds what a bench found, its command, the commit, the date, the machine, the versions of
packages and the seconds that it took; FOLDER/NAME.log is what it printed. A file stays as it is if its command is the
one below, and the code of the package and of the benches is the same. Soundness is counted by two benches at a time;
what takes times runs alone.

The files are copied to docs/measured. From there docs/measured.md is written, and everything between
`<!-- bench: NAME -->` and `<!-- end -->` in README.md and docs/*.md. Files of `--data` are
`motion_bench_maker_panda.json` and the recordings in `people`; without it, benches that need them are left out.
`python -m bench fresh --tests --json FOLDER/environments.json`, which takes long, adds times on fresh machines.
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
PAGE = KEPT.with_suffix(".md")
FIGURE = ROOT / "docs" / "peers.png"
PACKAGES = ("ompl", "pin", "coal", "numpy", "scipy", "mujoco", "toppra", "ruckig", "pin-pink", "roboplan")
CODE = ("safe_ompl/*.py", "safe_ompl/*.pyx", "safe_ompl/*.pxd", "bench/*.py", "bench/*.json", "setup.py")
NOT_MEASURED = "bench/all.py", "bench/pages.py"  # what they write is made of files
BLOCK = re.compile(r"(<!-- bench: ([\w ]+) -->(\n*)).*?<!-- end -->", re.DOTALL)

Found = dict[str, dict[str, Any]]


class Measurement(NamedTuple):
    """A section of the page.

    Attributes
    ----------
    name : str
        Of its file.
    claim : str
        What the numbers below it are.
    command : str
        After `python -m bench`. DATA is the folder of `--data`, OUT that of `--out`.
    minutes : float
        On one idle core.
    alone : bool
        It takes times, so that nothing else may run.
    """

    name: str
    claim: str
    command: str
    minutes: float
    alone: bool = True


SOUNDNESS = "Soundness", "Verdicts of the [proofs](proofs.md), looked at by code that shares nothing with them."
TIMES = "Times", "Medians of CPU time. What is compared runs in turn in one process."
PLANNERS = "Planners", "How planners work is on [How it works](how-it-works.md)."
PEOPLE = (
    "Beside people",
    "What the columns mean is in the commands' `--help`; how it works is on [Beside people](people.md).",
)
SECTIONS: dict[tuple[str, str], tuple[Measurement, ...]] = {
    SOUNDNESS: (
        Measurement(
            "edges",
            "No random edge that is called free touches anything, and every edge that is called blocked does.",
            "certify --only verdicts --edges 100000",
            11,
            alone=False,
        ),
        Measurement(
            "pieces", "The same of pieces of splines.", "motions --only pieces --number 20000", 14, alone=False
        ),
        Measurement(
            "edges_near",
            "The same of edges that pass within 5 mm of a contact.",
            "certify --only hard --hard 10000",
            7,
            alone=False,
        ),
        Measurement(
            "mutations",
            "No certificate is accepted of which a sentence is false, whoever changed it.",
            "mutations --number 10000",
            10,
            alone=False,
        ),
        Measurement(
            "corridors",
            "A tool that is called within a corridor is, at every sample.",
            "tools --only corridors --corridors 1000",
            5,
            alone=False,
        ),
        Measurement(
            "stops",
            "A robot stands, or is as slow as the limb bears, before a person who runs at it is there.",
            "stops --only stops --stops 14000",
            3,
            alone=False,
        ),
        Measurement(
            "stops_motions",
            "The same of motions that others made.",
            "stops --only motions --motions 1000",
            4,
            alone=False,
        ),
        Measurement(
            "robots",
            "Robots of example-robot-data with which all commands for a new robot work.",
            "robots",
            8,
            alone=False,
        ),
        Measurement("tubes", "Tubes hold.", "motions --only tubes --tubes 600", 2, alone=False),
        Measurement(
            "danger",
            "No danger along a path is above its proven peak, which is little above the largest sample.",
            "certify --only danger --paths 5",
            2,
            alone=False,
        ),
        Measurement(
            "programs",
            "Programs are planned in seconds, and in MuJoCo only what may touch does.",
            "programs --seeds 3",
            4,
            alone=False,
        ),
        Measurement(
            "physics",
            "A robot with a servo's errors stays outside what is proven with a tube.",
            "physics --only motions drives --motions 20 --drives 2",
            4,
            alone=False,
        ),
    ),
    TIMES: (
        Measurement("motion", "The proof of an edge costs a fraction of sampling it.", "motion", 2),
        Measurement(
            "splines", "The proof of a spline of ten pieces takes some milliseconds.", "motions --only time", 2
        ),
        Measurement("field", "What danger and its gradient cost.", "field", 1),
        Measurement("setup", "A new scene takes milliseconds, a person who moves less.", "setup", 1),
        Measurement("scaling", "Time grows slowly with the size of a problem.", "scaling", 3),
        Measurement("timing", "Trajectories keep their limits, and are as fast as those of others.", "timing", 2),
    ),
    PLANNERS: (
        Measurement(
            "studies",
            "Paths of safe planners are less dangerous than those of their classical counterparts.",
            "planners paper_1 paper_2 random --seeds 3 --pairs ours crossed",
            4,
        ),
        Measurement("hard", "Keeping away from danger costs no solutions.", "hard --time 2 --families RRTConnect", 2),
        Measurement("ways", 'How often `ways="all"` finds the safest way round.', "ways --scenes 0:20 --seeds 2", 2),
        Measurement(
            "repair",
            "Disturbed motions that touch something are repaired, and touch nothing afterwards.",
            "motions DATA/motion_bench_maker_panda.json --only repair --problems 0:5",
            2,
        ),
        Measurement(
            "tools",
            "The tool follows lines and seams in less danger than with differential inverse kinematics.",
            "tools --only curves --lines 40 --seams 12",
            3,
        ),
        Measurement(
            "peers",
            "Other planners on the same problems, without and with our proof and repair.",
            "peers DATA/motion_bench_maker_panda.json --out OUT/peers --problems 0:10 --seeds 1",
            8,
        ),
    ),
    PEOPLE: (
        Measurement(
            "live",
            "Nobody is touched while the robot moves as long as people keep to their bounds.",
            "live DATA/people --sample 8 --policies ours,contact,half-speed --jobs 2",
            5,
        ),
        Measurement(
            "shield",
            "The shield lets no proposal touch people while the robot moves.",
            "shield DATA/people --sample 4 --seconds 10",
            4,
        ),
        Measurement("worth", "Beside a person our paths may always be driven.", "worth --scenes 8 --seconds 2", 3),
    ),
}
MEASUREMENTS = {each.name: each for section in SECTIONS.values() for each in section}


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options."""
    parser.add_argument("--out", type=Path, metavar="FOLDER", help="for files and logs")
    parser.add_argument("--data", type=Path, metavar="FOLDER", help="with problems and recordings")
    parser.add_argument("--only", nargs="+", choices=MEASUREMENTS, default=list(MEASUREMENTS), metavar="NAME")
    parser.add_argument("--pages", action="store_true", help="only write the pages")


def main(options: argparse.Namespace, report: Report) -> int:
    """Measure, and write the pages."""
    failed = []
    if not options.pages:
        if options.out is None:
            print("--out FOLDER is missing", file=sys.stderr)
            return 2
        failed = measure([MEASUREMENTS[name] for name in options.only], options.out.resolve(), options.data)
    KEPT.mkdir(exist_ok=True)
    if options.out is not None:
        for file in sorted(options.out.glob("*.json")):
            shutil.copy(file, KEPT)
    found = read(KEPT)
    for file, text in pages(found).items():
        file.write_text(text, encoding="utf-8")
    if "peers" in found:
        figure(found["peers"]["tables"][0], FIGURE)
    return int(bool(failed))


# ---------------------------------------------------------------------------------------------------- measuring


def measure(chosen: Iterable[Measurement], out: Path, data: Path | None) -> list[str]:
    """Measure what a folder has not got of this code; return the names of benches that failed."""
    out.mkdir(parents=True, exist_ok=True)
    about, begin, failed, left = circumstances(), monotonic(), list[str](), list[Measurement]()
    for each in chosen:
        file = out / f"{each.name}.json"
        known = json.loads(file.read_text(encoding="utf-8")) if file.is_file() else {}
        if known.get("code") == about["code"] and known["command"] == shown(each) and not known["failed"]:
            print(f"{each.name}: kept")
        elif data is None and "DATA" in each.command:
            print(f"{each.name}: left out, needs --data")
        else:
            left.append(each)

    def run(each: Measurement) -> None:
        print(f"{(monotonic() - begin) / 60:.1f} min: {each.name}, about {each.minutes:g} min", flush=True)
        if run_bench(each, out, data, about):
            failed.append(each.name)
            print(f"{each.name} FAILED: see {out / each.name}.log", flush=True)

    for number, alone in ((2, False), (1, True)):
        with ThreadPoolExecutor(number) as pool:
            list(pool.map(run, (each for each in left if each.alone == alone)))
    print(f"{(monotonic() - begin) / 60:.1f} min in all")
    return failed


def run_bench(each: Measurement, out: Path, data: Path | None, about: dict[str, Any]) -> bool:
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
    found = {**json.loads(text), "command": shown(each), **about, "seconds": round(monotonic() - begin)}
    fresh.write_text(
        json.dumps({**found, "failed": status != 0}, indent=1, ensure_ascii=False) + "\n", encoding="utf-8"
    )
    fresh.replace(out / f"{each.name}.json")
    return status != 0


def shown(each: Measurement) -> str:
    """Return the command of a measurement as pages show it."""
    return f"python -m bench {each.command}"


def circumstances() -> dict[str, Any]:
    """Return commit, code, machine and versions."""
    commit = _git("rev-parse", "--short", "HEAD")
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
    return {"commit": commit, "code": code.hexdigest()[:16], "machine": machine, "versions": versions}


def _git(*words: str) -> str:
    return subprocess.run(["git", *words], cwd=ROOT, check=True, capture_output=True, text=True).stdout.strip()


# -------------------------------------------------------------------------------------------------------- pages


def read(folder: Path) -> Found:
    """Return what the files of a folder hold, by name."""
    known = [*MEASUREMENTS, "environments"]
    files = {name: folder / f"{name}.json" for name in known}
    if unknown := {file.stem for file in folder.glob("*.json")} - set(known):
        raise ValueError(f"{folder} holds files of no bench in bench/all.py: {', '.join(sorted(unknown))}")
    return {name: json.loads(file.read_text(encoding="utf-8")) for name, file in files.items() if file.is_file()}


def pages(found: Found) -> dict[Path, str]:
    """Return what the pages ought to be; blocks of what was not measured stay as they are."""
    texts = {file: file.read_text(encoding="utf-8") for file in (ROOT / "README.md", *ROOT.glob("docs/*.md"))}
    blocks = {name: make(found[source]) for name, (source, make) in BLOCKS.items() if source in found}
    blocks["soundness"] = soundness(found)

    def filled(block: re.Match[str]) -> str:
        text = blocks.get(block[2])
        return block[0] if text is None else f"{block[1]}{text}{block[3]}<!-- end -->"

    return {**{file: BLOCK.sub(filled, text) for file, text in texts.items()}, PAGE: page(found)}


def page(found: Found) -> str:
    """Return the page of measurements."""
    parts = [INTRODUCTION, _circumstances(found), "## Verdicts that were looked at", soundness(found)]
    for (title, about), section in SECTIONS.items():
        parts += [f"## {title}", about]
        for each in section:
            parts += [f"**{each.claim}**", *_found(found.get(each.name), shown(each))]
    if "environments" in found:
        parts += [
            "## Fresh machines",
            "Seconds until a command ends in an empty environment.",
            *_tables(found["environments"]),
        ]
    return "\n\n".join(part for part in parts if part) + "\n"


INTRODUCTION = """# What was measured

`python -m bench all --out FOLDER --data FOLDER` runs all commands on this page and writes the page. The data are
problems of MotionBenchMaker and recordings of people (`--help` names the files). Times are CPU times of one core unless
a table says otherwise. Of long tables only the last rows are here; the files in `docs/measured` hold all of them.
`python -m bench NAME --help` explains the columns."""


def _circumstances(found: Found) -> str:
    def all_of(key: str) -> str:
        return ", ".join(sorted({str(each[key]) for each in found.values() if key in each})) or "–"

    versions = {f"{name} {number}" for each in found.values() for name, number in each.get("versions", {}).items()}
    rows = [("date", all_of("date")), ("commit", all_of("commit")), ("machine", all_of("machine"))]
    total = sum(each.get("seconds", 0) for each in found.values())
    rows += [("versions", ", ".join(sorted(versions)) or "–"), ("minutes of all benches", f"{total / 60:.0f}")]
    return markdown_table(("", ""), rows)


def _found(content: dict[str, Any] | None, command: str) -> list[str]:
    """Return a command with what it found."""
    if content is None:
        return [f"`{command}`", "Not measured on this code."]
    parts = [f"`{content['command']}`, {content['seconds']} s{', **failed**' if content['failed'] else ''}"]
    parts.append("; ".join(f"{name}: {said(value)}" for name, value in content["figures"].items()))
    return [*parts, *_tables(content)]


def _tables(content: dict[str, Any]) -> list[str]:
    parts = []
    for table in content["tables"]:
        rows = [row for row in table["rows"] if str(row[0]).startswith("all")] or table["rows"]
        parts += [table["title"], markdown_table(table["header"], rows)]
    return parts


def soundness(found: Found) -> str:
    """Return the table of verdicts that were looked at."""
    rows = [row for each in MEASUREMENTS.values() for row in found.get(each.name, {}).get("counted", ())]
    return markdown_table(("looked at", "number", "false", "undecided"), rows) if rows else "Not measured on this code."


Content = dict[str, Any]


def peers(content: Content) -> str:
    """Return the table of planners that README shows."""
    return markdown_table(*compact(content["tables"][0]))


def peers_in_full(content: Content) -> str:
    """Return all tables of planners."""
    return "\n\n".join(_tables(content))


def robots(content: Content) -> str:
    """Return a row on robots that came through all commands, and on those that did not."""
    rows = content["tables"][0]["rows"]
    stopped = [row for row in rows if row[4:7] != ["yes"] * 3]
    said = "; ".join(f"`{row[0]}`: {row[-1]}" for row in stopped)
    row = ("example-robot-data", len(rows), len(rows) - len(stopped), said)
    return markdown_table(("source", "robots", "passed", "not passed"), [row])


def fresh(command: str, unit: float) -> Callable[[Content], str]:
    """Return what makes the median time of one of README's commands on fresh machines, in a unit [s]."""

    def median(content: Content) -> str:
        return f"{np.median([row[2] for row in content['tables'][0]['rows'] if row[1] == command]) / unit:.0f}"

    return median


BLOCKS: dict[str, tuple[str, Callable[[Content], str]]] = {
    "peers": ("peers", peers),
    "peers in full": ("peers", peers_in_full),
    "robots": ("robots", robots),
    "first command": ("environments", fresh("first", 1.0)),
    "second command": ("environments", fresh("second", 60.0)),
}
