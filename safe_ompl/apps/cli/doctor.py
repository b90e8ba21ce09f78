"""`safe-ompl doctor`: versions, what is missing, and whether a tiny plan works."""

from __future__ import annotations

import platform
import re
from collections.abc import Iterator
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, metadata, requires, version
from time import perf_counter
from typing import Any

from rich.markup import escape
from rich.table import Table

from safe_ompl.apps.cli.arguments import load_scenario
from safe_ompl.apps.cli.console import output_console
from safe_ompl.planning import setup_scenario
from safe_ompl.version import __version__

_SCENARIO, _PLANNER, _TIME = "planar2", "SafeRRTConnect", 10.0
_EXTRAS = ("plots", "viewer", "cluster")


@dataclass(frozen=True)
class Requirement:
    """A package that is needed, or wanted by an extra.

    Attributes
    ----------
    name : str
        As on PyPI.
    bounds : str
        Which versions will do, such as ">=2.0,<3".
    extra : str
        Which extra wants it; empty: it is needed.
    """

    name: str
    bounds: str
    extra: str

    @property
    def found(self) -> str | None:
        """The version that is installed, or None."""
        try:
            return version(self.name)
        except PackageNotFoundError:
            return None

    @property
    def fits(self) -> bool:
        """Whether a version is installed that will do."""
        found = self.found
        return found is not None and all(
            _within(found, bound) for bound in filter(None, self.bounds.split(","))
        )


def add_command(commands: Any) -> None:
    """Add `doctor` to the commands."""
    parser = commands.add_parser(
        "doctor",
        help="say versions, what is missing, and try a tiny plan",
        description="Say which versions are installed, which are missing or unfit, and plan once. The exit status "
        "is 1 if something needed is missing or the plan fails.",
    )
    parser.set_defaults(prepare=lambda _: examine)


def examine() -> int:
    """Show what is installed beside what is supported, and plan once; return 0 if all that is needed works."""
    table = Table(box=None, show_header=False, pad_edge=False)
    table.add_row("safe-ompl", __version__, "")
    python = metadata("safe-ompl")["Requires-Python"] or ""
    table.add_row("Python", platform.python_version(), f"{python}, {platform.system()} {platform.machine()}")
    healthy = True
    for requirement in requirements():
        said = requirement.found or "missing"
        wanted = f"needs {requirement.bounds}" if requirement.bounds else ""
        advice = f"pip install 'safe-ompl[{requirement.extra}]'" if requirement.extra else ""
        words = requirement.bounds if requirement.fits else "; ".join(filter(None, [wanted, advice]))
        table.add_row(requirement.name, said, escape(words))
        healthy &= requirement.fits or bool(requirement.extra)
    output_console().print(table)
    return 0 if _plans() and healthy else 1


def requirements() -> Iterator[Requirement]:
    """Yield what the installed package says that it needs, and what its extras want."""
    for line in requires("safe-ompl") or ():
        found = re.match(r"""([\w.-]+)(?:\[.*?\])?\s*([^;]*?)\s*(?:;.*extra == ['"](\w+)['"].*)?$""", line)
        if found and (found[3] or "") in ("", *_EXTRAS):
            yield Requirement(found[1], found[2].replace(" ", ""), found[3] or "")


def _plans() -> bool:
    scenario = load_scenario(_SCENARIO)
    begin = perf_counter()
    setup = setup_scenario(scenario)
    built = perf_counter()
    result = setup.plan(_PLANNER, time=_TIME, seed=0)
    words = f"{len(result.path)} way points, proven" if result.path is not None else result.status
    output_console().print(
        f"{_PLANNER} in {_SCENARIO}: {words}; {1e3 * (built - begin):.0f} ms to set up, "
        f"{1e3 * result.planning_time:.1f} ms to plan"
    )
    return bool(result)


def _within(found: str, bound: str) -> bool:
    """Return whether a version keeps to a bound such as ">=2.0" or "<3"."""
    sign, wanted = re.match(r"([<>=!~]+)(.*)", bound).groups()  # type: ignore[union-attr]
    this, that = _numbers(found), _numbers(wanted)
    length = max(len(this), len(that))
    this, that = (numbers + (0,) * (length - len(numbers)) for numbers in (this, that))
    return {">=": this >= that, "<": this < that, "==": this == that, "!=": this != that}.get(sign, True)


def _numbers(text: str) -> tuple[int, ...]:
    return tuple(int(part) for part in re.findall(r"\d+", text))
