"""Command `doctor`: list the installed requirements with their versions, and try planning and the installed extras."""

from __future__ import annotations

import platform
import re
from collections.abc import Callable, Iterator
from functools import partial
from importlib import import_module
from importlib.metadata import PackageNotFoundError, metadata, requires, version
from time import perf_counter
from typing import Any

from rich.markup import escape
from rich.table import Table

from safe_ompl.apps.cli import arguments, output
from safe_ompl.common import PlanningError
from safe_ompl.planning import setup_scenario
from safe_ompl.version import __version__

# The time limit [s] is long, so that a slow machine finds a path, too.
_SCENARIO, _PLANNER, _TIME = "planar2", "SafeRRTConnect", 60.0


def examine() -> int:
    """Print installed and required versions, and try all that is installed.

    Returns 0 if nothing that is needed is missing or fails.
    """
    table = Table(box=None, show_header=False, pad_edge=False)
    table.add_row("safe-ompl", __version__, "")
    python = metadata("safe-ompl")["Requires-Python"] or ""
    table.add_row("Python", platform.python_version(), f"{python}, {platform.system()} {platform.machine()}")
    healthy = True
    for name, bounds, extra in requirements():
        found = installed(name)
        table.add_row(name, found or "missing", escape(f"needs {bounds}" if bounds else ""))
        healthy &= found is not None or bool(extra)
    output.console().print(table)
    trials: dict[str, Callable[[], Any]] = {"plan": _plan}
    for extra, (module, _) in output.EXTRAS.items():
        if advice := output.missing_extra(extra):
            output.console().print(escape(f"{extra}: {advice}"))
        else:
            trials[extra] = partial(import_module, module)
    for what, trial in trials.items():
        try:
            trial()
        # A package that is installed badly may raise any exception.
        except Exception as error:
            why = error.__cause__ or error
            error_text = " ".join(f"{type(why).__name__}: {why}".split())
            output.console().print(escape(f"fails: {what}: {error_text[:200]}"), soft_wrap=True)
            healthy = False
    return 0 if healthy else 1


def requirements() -> Iterator[tuple[str, str, str]]:
    """Yield the requirements of the installed package: name on PyPI, versions that fit, and the extra, if any."""
    for line in requires("safe-ompl") or ():
        found = re.match(r"""([\w.-]+)(?:\[.*?\])?\s*([^;]*?)\s*(?:;.*extra == ['"](\w+)['"].*)?$""", line)
        # ROS 2 is rarely from PyPI, so its versions are not compared.
        if found and found[3] != "ros" and (found[3] is None or found[3] in output.EXTRAS):
            yield found[1], found[2].replace(" ", ""), found[3] or ""


def installed(name: str) -> str | None:
    """Return the version of a package that is installed, or None."""
    try:
        return version(name)
    except PackageNotFoundError:
        return None


def _plan() -> None:
    scenario = arguments.load_scenario(_SCENARIO)
    begin = perf_counter()
    setup = setup_scenario(scenario)
    built = perf_counter()
    result = setup.plan(_PLANNER, time=_TIME, seed=0)
    if result.path is None:
        raise PlanningError(f"{_PLANNER} in {_SCENARIO}: {result.status}")
    output.console().print(
        f"{_PLANNER} in {_SCENARIO}: {len(result.path)} way points, proven; {1e3 * (built - begin):.0f} ms to set up, "
        f"{1e3 * result.planning_time:.1f} ms to plan"
    )
