"""README's commands on machines that a newcomer may have: in fresh clones, with fresh environments and a fresh HOME.

    python -m bench fresh --python python3.10 python3.13

Each row clones the last commit into an empty folder and runs README's first command there: with each Python, without a
compiler on the PATH, as an ordinary user, with a HOME that cannot be written, from an sdist, and from a wheel in an
environment without a compiler. `--tests` runs README's second command with each Python and in the sdist, too. The
ordinary user and the HOME need root. Downloads come from pip's index; no cache is used.
"""

from __future__ import annotations

import argparse
import os
import re
import shutil
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter
from typing import Literal

from bench._harness import Report

CLAIM = "README's commands work on a fresh machine, and take so long"
ROOT = Path(__file__).parent.parent
COMPILERS = re.compile(r"(.*-)?(cc|c\+\+|gcc|g\+\+|clang|clang\+\+|c\d\d|cpp|tcc|zig)(-[\d.]+)?")
# User and group of `nobody` on most systems.
NOBODY = 65534
PATIENCE = 1800  # [s] for one command
# The interpreter of the bench may be in a folder that only root can read.
SYSTEM_PYTHON = "/usr/bin/python3"


@dataclass(frozen=True)
class Machine:
    """One row: what differs from a usual machine."""

    name: str
    python: str = sys.executable
    compiler: bool = True
    root: bool = True
    home: bool = True
    source: Literal["clone", "sdist", "wheel"] = "clone"


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options."""
    parser.add_argument("--python", nargs="*", default=[], metavar="PYTHON", help="further interpreters to try")
    parser.add_argument("--tests", action="store_true", help="run README's second command with each interpreter, too")


def main(options: argparse.Namespace, report: Report) -> int:
    """Run the commands and print how long each takes."""
    first, second = readme_commands()
    usual = [Machine(f"Python {version_of(python)}", python) for python in (sys.executable, *options.python)]
    others = [
        Machine("no compiler", compiler=False),
        Machine("ordinary user", SYSTEM_PYTHON, root=False),
        Machine("HOME that cannot be written", SYSTEM_PYTHON, root=False, home=False),
        sdist := Machine("sdist", source="sdist"),
        Machine("wheel, no compiler", compiler=False, source="wheel"),
    ]
    if os.getuid():
        others = [machine for machine in others if machine.root]
        print("the rows of another user are left out, because they need root", file=sys.stderr)
    rows = [[machine.name, "first", *seconds_of(machine, first)] for machine in (*usual, *others)]
    if options.tests:
        rows += [[machine.name, "second", *seconds_of(machine, second)] for machine in (*usual, sdist)]
    report.table(("machine", "README's command", "s", "ends"), rows)
    return int(any(row[-1] != "well" for row in rows))


def readme_commands() -> tuple[str, str]:
    """Return README's command for users, and its command for developers."""
    lines = re.findall(r"^    (python3 -m venv .*)$", (ROOT / "README.md").read_text(encoding="utf-8"), re.MULTILINE)
    first, second = lines
    return first, second


def version_of(python: str) -> str:
    """Return the version of an interpreter."""
    code = "import sys; print('.'.join(map(str, sys.version_info[:3])))"
    return subprocess.run([python, "-c", code], check=True, capture_output=True, text=True).stdout.strip()


def seconds_of(machine: Machine, command: str) -> tuple[float, str]:
    """Run a command on a machine; return its time [s], and "well" or the end of what it printed."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        tools, clone, home = folder / "tools", folder / "clone", folder / "home"
        home.mkdir()
        subprocess.run(["git", "clone", "--quiet", ROOT, clone], check=True)
        link_tools(machine, tools)
        if machine.source != "clone":
            sdist, wheel = built(clone, folder / "build")
            shutil.rmtree(clone)
            if machine.source == "sdist":
                shutil.unpack_archive(sdist, folder / "unpacked", filter="data")
                next((folder / "unpacked").iterdir()).rename(clone)
            else:
                clone.mkdir()
                command = command.replace("-e '.[", f"'{wheel}[")
        if not machine.root:
            folder.chmod(0o755)
            shutil.chown(home, NOBODY, NOBODY)
            for path in (clone, *clone.rglob("*")):
                os.chown(path, NOBODY, NOBODY, follow_symlinks=False)
        if not machine.home:
            os.chown(home, 0, 0)
            home.chmod(0o555)
        network = {name: value for name, value in os.environ.items() if re.match(r"PIP_|SSL_|.*_proxy$", name, re.I)}
        variables = network | {"PATH": str(tools), "HOME": str(home), "LANG": "C.UTF-8", "PIP_NO_CACHE_DIR": "1"}
        user = {} if machine.root else {"user": NOBODY, "group": NOBODY, "extra_groups": ()}
        begin = perf_counter()
        ended = subprocess.run(
            command, shell=True, cwd=clone, env=variables, capture_output=True, text=True, timeout=PATIENCE, **user
        )
        seconds = perf_counter() - begin
    if not ended.returncode:
        return round(seconds, 1), "well"
    lines = (ended.stderr or ended.stdout).strip().splitlines()
    return round(seconds, 1), f"status {ended.returncode}: {lines[-1] if lines else ''}"


def built(clone: Path, folder: Path) -> tuple[Path, Path]:
    """Return the sdist of a clone, and the wheel that is built from it."""
    subprocess.run([sys.executable, "-m", "venv", folder], check=True)
    subprocess.run([folder / "bin" / "pip", "install", "--quiet", "build"], check=True)
    build = [folder / "bin" / "python", "-m", "build", "--outdir", folder, clone]
    subprocess.run(build, check=True, stdout=subprocess.DEVNULL)
    return next(folder.glob("*.tar.gz")), next(folder.glob("*.whl"))


def link_tools(machine: Machine, tools: Path) -> None:
    """Fill a folder with links to what is on the PATH: without compilers where there are none, with one Python."""
    tools.mkdir()
    for part in os.environ["PATH"].split(os.pathsep):
        for file in Path(part).glob("*") if Path(part).is_dir() else ():
            compiles = COMPILERS.fullmatch(file.name) and not machine.compiler
            if not compiles and not file.name.startswith("python") and not (tools / file.name).exists():
                (tools / file.name).symlink_to(file)
    for alias in ("python", "python3"):
        (tools / alias).symlink_to(shutil.which(machine.python) or machine.python)
