"""`safe-ompl doctor`: what is installed, and what of it fails; it compiles kernels that the wheel does not hold.

Two processes compile them, so that nobody waits for them later. Kernels are compiled for one kind of arguments,
whatever the robot: a small one beside somebody has nearly all of them.
"""

from __future__ import annotations

import platform
import re
from collections.abc import Callable, Iterator
from contextlib import suppress
from functools import partial
from importlib import import_module
from importlib.metadata import PackageNotFoundError, metadata, requires, version
from pkgutil import resolve_name
from time import perf_counter
from typing import Any

import numpy as np
from rich.markup import escape
from rich.table import Table

from safe_ompl.apps.cli import arguments, output
from safe_ompl.collision import prove_curve
from safe_ompl.common import PlanningError, compile_together, origin
from safe_ompl.danger import CertifiedDanger, DangerField
from safe_ompl.drawing import render_path
from safe_ompl.geometry import Obstacle, Person, Pose
from safe_ompl.live import Surroundings, Tracker, find_skeleton
from safe_ompl.live.replanning import Replanner
from safe_ompl.motions import RateLimits, time_path
from safe_ompl.planning import PLAN_JOBS, SafeSetup, setup_scenario, small_robot
from safe_ompl.planning.simplification import ask_for_retreats
from safe_ompl.scene import People, Scene
from safe_ompl.version import __version__

_SCENARIO, _PLANNER, _TIME = "planar2", "SafeRRTConnect", 600.0  # [s]: a slow machine calls all, too
_TICKS = 8
ALL_JOBS = (  # those that need what a plan needs come after it
    *PLAN_JOBS,
    f"{__name__}:ask_for_bounds",
    f"{__name__}:ask_for_simplification",
    f"{__name__}:ask_for_people",
    f"{__name__}:ask_for_pictures",
)


def examine() -> int:
    """Show versions beside those that fit, and try all that is installed; return 0 if nothing needed lacks or fails."""
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
    output.console().print(escape(f"kernels: {origin(prove_curve)}"), soft_wrap=True)
    compile_all()
    trials: dict[str, Callable[[], Any]] = {f"kernels: {job.rpartition(':')[2]}": resolve_name(job) for job in ALL_JOBS}
    trials["plan"] = _plan
    for extra, (module, _) in output.EXTRAS.items():
        if advice := output.missing_extra(extra):
            output.console().print(escape(f"{extra}: {advice}"))
        else:
            trials[extra] = partial(import_module, module)
    for what, trial in trials.items():
        try:
            trial()
        except Exception as error:  # of any kind: what is installed badly may raise anything
            why = error.__cause__ or error
            said = " ".join(f"{type(why).__name__}: {why}".split())
            output.console().print(escape(f"fails: {what}: {said[:200]}"), soft_wrap=True)
            healthy = False
    return 0 if healthy else 1


def requirements() -> Iterator[tuple[str, str, str]]:
    """Yield the requirements of the installed package: name on PyPI, versions that fit, and the extra, if any."""
    for line in requires("safe-ompl") or ():
        found = re.match(r"""([\w.-]+)(?:\[.*?\])?\s*([^;]*?)\s*(?:;.*extra == ['"](\w+)['"].*)?$""", line)
        if found and found[3] != "ros" and (found[3] is None or found[3] in output.EXTRAS):  # ROS 2 is seldom of PyPI
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


def compile_all() -> None:
    """Compile what is not kept yet, and can be."""
    with suppress(Exception):  # of a job; `examine` does each job again, and says which one fails
        compile_together([prove_curve], ALL_JOBS)


def ask_for_bounds() -> None:
    """Call what bounds of the danger on a path need, and what pushes a robot away."""
    q, field = np.zeros(2), DangerField(small_robot(), [[2.0, 2.0, 2.0]])
    CertifiedDanger(field).of_path([q, q + 1.0])
    field.push(q)


def ask_for_simplification() -> None:
    """Call what planning and simplification need."""
    robot = small_robot()
    setup = SafeSetup(robot, Scene((Obstacle("person", Person(), Pose((1.4, 0.0, -1.0))),)))
    setup.setConfigurations([-1.0, 0.0], [1.0, 0.0])
    setup.plan(_PLANNER, time=_TIME, seed=0, simplify=True)
    ask_for_retreats()


def ask_for_people() -> None:
    """Call what a robot needs to drive beside people."""
    robot, skeleton = small_robot(), find_skeleton("recording12")
    replanner = Replanner(robot, Surroundings(Scene(), {"anna": Tracker(skeleton)}, people=People(speed=1.6)))
    limits = RateLimits.of(robot, acceleration=10.0)
    replanner.start(time_path([[-1.0, 0.0], [1.0, 0.0]], robot, limits, motion=replanner.prover))
    keypoints = np.random.default_rng(0).uniform(-0.3, 0.3, (12, 3))
    for tick in range(_TICKS):  # until the robot retreats
        keypoints_now = keypoints + (1.0 - 0.07 * tick) * np.array([0.9, -0.5, 0.2])
        replanner.update({"anna": keypoints_now}, {}, 0.05 * tick)
        replanner.command(0.05 * tick + 0.02)
        replanner.think()


def ask_for_pictures() -> None:
    """Call what a picture needs."""
    render_path(small_robot(), Scene(), np.zeros((2, 2)), size=(16, 16))
