"""Which robots work: the commands that a newcomer types, for every URDF below some folders.

The commands are run as they are printed, each in a process of its own: `safe-ompl new`, and then what that prints
(plan, verify, view --html; the view in the browser is left out). An SRDF of the same name beside the URDF, or the only
one in `../srdf`, is given. Where an error says to type `--collision visual`, that is done, and the table says so.
"""

from __future__ import annotations

import argparse
import json
import re
import shlex
import subprocess
import sys
import tempfile
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

from bench._harness import Report
from safe_ompl.robot import robots_folder

CLAIM = "robots that come through all commands as they are"
STEPS = ("plan", "verify", "view")

Record = dict[str, Any]


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options."""
    parser.add_argument("places", nargs="*", metavar="FOLDER", help="or URDF (default: all of example-robot-data)")
    parser.add_argument("--package-dir", action="append", default=[], metavar="DIR")
    parser.add_argument("--jobs", type=int, default=1, help="robots at a time (default: %(default)s)")
    parser.add_argument("--patience", type=float, default=180.0, help="with a command [s] (default: %(default)s)")


def main(options: argparse.Namespace, report: Report) -> None:
    """Try each robot, and report the table."""
    places = [Path(place).resolve() for place in options.places or [robots_folder()]]
    files = sorted({file for place in places for file in (place.rglob("*.urdf") if place.is_dir() else [place])})
    rows = []
    with ThreadPoolExecutor(options.jobs) as pool:
        for record in pool.map(lambda file: tried(file, options), files):
            rows.append(_row(record))
            print(*rows[-1], sep=" | ", file=sys.stderr, flush=True)
    report.table(("robot", "joints", "group", "tip", *STEPS, "remarks"), rows)
    works = sum(list(row[4 : 4 + len(STEPS)]) == ["yes"] * len(STEPS) for row in rows)
    report.figure("come through all of it", f"{works} of {len(rows)}")


# ------------------------------------------------------------------------------------------------- one robot


def tried(file: Path, options: argparse.Namespace) -> Record:
    """Return what came of the commands of one robot."""
    record: Record = {"robot": _label(file), "remarks": []}
    with tempfile.TemporaryDirectory() as kept:
        folder = Path(kept)
        words = ["new", str(file), "-o", "robot.yaml"]
        for place in options.package_dir:
            words += ["--package-dir", str(Path(place).resolve())]
        srdf = _srdf(file)
        if srdf is not None:
            words += ["--srdf", str(srdf)]
            record["remarks"].append("SRDF")
        status, said = _run(words, folder, options.patience)
        if status and "--collision visual" in said:
            record["remarks"].append("visual shapes collide")
            status, said = _run([*words, "--collision", "visual"], folder, options.patience)
        if status:
            return {**record, "error": _shortened(said, file)}
        found = re.search(r": (\d+) joints(?: of the group '(.*?)')?, tip '(.*?)'", said)
        assert found is not None, said
        record.update(joints=int(found[1]), group=found[2] or "", tip=found[3])
        for command in re.findall(r"^ {4}safe-ompl (.*)$", said, re.MULTILINE):
            step, *rest = shlex.split(command)
            if step == "view" and "--html" not in rest:
                continue
            status, answer = _run([step, *rest], folder, options.patience)
            record[step] = "yes" if status == 0 else _shortened(answer, file)
            if status:
                break
        proofs = [json.loads(proof.read_text()) for proof in folder.glob("*.certificate.json")]
        record["unchecked"] = [link for proof in proofs for link in proof["robot"]["links_without_collision"]]
    return record


def _run(words: list[str], folder: Path, patience: float) -> tuple[int, str]:
    """Return the exit status of a command, and what it said; 124 if it took too long."""
    command = [sys.executable, "-m", "safe_ompl", *words]
    try:
        done = subprocess.run(
            command, cwd=folder, capture_output=True, text=True, timeout=patience, stdin=subprocess.DEVNULL, check=False
        )
    except subprocess.TimeoutExpired:
        return 124, f"not done within {patience:g} s"
    return done.returncode, done.stdout + done.stderr


def _srdf(file: Path) -> Path | None:
    """Return the SRDF that comes with a URDF, if it is plain which."""
    same = [place for place in (file.parent, file.parent.parent / "srdf") if (place / f"{file.stem}.srdf").is_file()]
    if same:
        return same[0] / f"{file.stem}.srdf"
    only = sorted((file.parent.parent / "srdf").glob("*.srdf"))
    return only[0] if len(only) == 1 and len(list(file.parent.glob("*.urdf"))) == 1 else None


def _label(file: Path) -> str:
    """Return the file's name, with its folder where that says more."""
    return file.name if file.stem != "model" else f"{file.parent.name}/{file.name}"


def _shortened(said: str, file: Path) -> str:
    """Return the last error of a command, without the folder of the robot."""
    lines = [line for line in said.splitlines() if line.strip() and "warning:" not in line]
    line = " ".join(lines[-1].split()) if lines else "it said nothing"
    for name in (f"{file}: ", f"{file.parent}/"):
        line = line.replace(name, "")
    return line.removeprefix("safe-ompl: ").replace("|", "\\|")


def _row(record: Record) -> tuple[str, ...]:
    remarks = ", ".join(record["remarks"])
    if "error" in record:
        return (record["robot"], *[""] * (3 + len(STEPS)), record["error"])
    if record.get("unchecked"):
        remarks += ("; " if remarks else "") + f"not checked: {', '.join(record['unchecked'])}"
    cells = (record["robot"], str(record["joints"]), record["group"], record["tip"])
    return (*cells, *(record.get(step, "–") for step in STEPS), remarks)
