"""What compiling the kernels and importing the package cost: python bench/compilation.py [--rows N] [--imports N].

In a process of its own, with an empty cache, a plan, its simplification, danger of all kinds, a motion in time, live
driving and some calls without a purpose ask for all kernels; those that nothing asked for are named. Printed are
CPU times: of all, and of the kernels and parts that took longest, without what they call, with the number of signatures
that each was compiled for.

Then, with another empty cache, there is a first plan, which compiles in two processes; then two processes, started at
the same time, ask for all that is left; then there is a second plan. Printed are wall times, and the CPU time of the
busier process: the wall time of a machine with two cores and nothing else to do. Bars: 8 s for the first plan beyond
the second one, and 15 s for all.

The import is that of `SafeSetup` after all that it imports of others, the median of N fresh processes. Bar: 0.1 s.

All are compared with a loop of five million additions in pure Python, which tells how busy the machine is.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
from collections import Counter
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from importlib import import_module
from pathlib import Path
from time import perf_counter, process_time
from typing import Any

import numpy as np
from _timing import print_table
from numba.core import event

IMPORTED = """import sys
from safe_ompl import SafeSetup
print(*[name for name in sys.modules if name.partition(".")[0] not in ("safe_ompl", "__main__")])"""
IMPORT = """import sys
from contextlib import suppress
from importlib import import_module
from time import process_time
for name in sys.argv[1:]:
    with suppress(ImportError):  # some make aliases when they are imported
        import_module(name)
begin = process_time()
from safe_ompl import SafeSetup
print(process_time() - begin)"""
START, GOAL = [-1.2, 0, 0, -2.0, 0, 2.2, 0.785], [1.2, 0, 0, -2.0, 0, 2.2, 0.785]


class Compilation(event.Listener):  # type: ignore[misc]
    """Counts what Numba compiles, and for how long: of each function without those that it calls."""

    def __init__(self) -> None:
        self.seconds, self.signatures = Counter[str](), Counter[str]()
        self._open: list[list[float]] = []
        event.register("numba:compile", self)

    def on_start(self, event: Any) -> None:
        """Take note that something is compiled."""
        self._open.append([process_time(), 0.0])

    def on_end(self, event: Any) -> None:
        """Take note of how long that took."""
        begin, inner = self._open.pop()
        taken = process_time() - begin
        function = event.data["dispatcher"]
        room = "kernels" if function.__module__.startswith("safe_ompl") else "numba"
        name = f"{room} {function.__module__.rsplit('.', 1)[-1]}.{function.__name__}"
        self.seconds[name] += taken - inner
        self.signatures[name] += 1
        if self._open:
            self._open[-1][1] += taken


def plan_once() -> None:
    """Plan as a newcomer does."""
    from safe_ompl import plan

    plan("panda_shelf", time=60.0)


def plan_and_simplify() -> None:
    """Ask for what a plan needs, danger of all kinds, and a motion in time."""
    from safe_ompl import (
        Box,
        CertifiedDanger,
        DangerField,
        Obstacle,
        Person,
        Pose,
        RateLimits,
        Robot,
        SafeSetup,
        Scene,
    )
    from safe_ompl.planning.planners.parts.tree import NearestNode

    robot = Robot.from_example("panda")
    person = Obstacle("person", Person(), Pose((0.95, 0.3, -0.85)))
    setup = SafeSetup(robot, Scene((person, Obstacle("box", Box((0.2, 0.2, 0.2)), Pose((0.6, -0.5, 0.2))))))
    setup.setConfigurations(START, GOAL)
    result = setup.plan("SafeRRTConnect", seed=0, simplify=True)
    result.timed(RateLimits.of(robot, acceleration=10.0), max_danger=1e3)
    CertifiedDanger(setup.field).of_path([START, GOAL])
    rng = np.random.default_rng(0)
    for number in (10, 1000):
        for aggregate in ("max", "mean", "softmax"):
            field = DangerField(robot, rng.uniform(1.0, 2.0, (number, 3)), aggregate=aggregate)
            values = field.values_and_gradients([START])[0]
            field.contributions(field.aggregated(values[:, None])[:, None], rng.uniform(size=(1, 3)))
            field.push(START)
            field.moving.value(START, GOAL)
            field.moving.values_and_gradients([START], [GOAL])
    nodes, rows = NearestNode(np.zeros(7, bool)), rng.uniform(size=(500, 7))
    nodes.find(rows, rows[3], 0.1, rows[:, 0].copy())
    nodes.find(rows[:10], rows[3])


def drive() -> None:
    """Ask for what live driving needs."""
    from safe_ompl import Box, Obstacle, People, Pose, RateLimits, Replanner, Robot, Scene, Tracker, time_path
    from safe_ompl.people.skeletons import TrackedBody, find_skeleton

    robot, skeleton = Robot.from_example("panda"), find_skeleton("recording12")
    scene = Scene((Obstacle("table", Box((1.6, 1.6, 0.04)), Pose((0.0, 0.0, -0.1))),))
    replanner = Replanner(robot, scene, {"anna": Tracker(skeleton, TrackedBody())}, people=People(speed=1.6))
    replanner.start(
        time_path([START, GOAL], robot, RateLimits.of(robot, acceleration=10.0), motion=replanner.prover)
    )
    keypoints = np.random.default_rng(0).uniform(-0.3, 0.3, (12, 3)) + np.array([1.5, 0.0, 0.2])
    for tick in range(2):
        replanner.update({"anna": keypoints}, {}, 0.05 * tick)
        replanner.command(0.05 * tick + 0.02)
        replanner.think()


def call_the_rest() -> None:
    """Call kernels whose rooms would have to be furnished first."""
    from safe_ompl.danger.kernels import field
    from safe_ompl.trajectories import kernels as stopping
    from safe_ompl.view.pictures import rasteriser

    ones = np.ones((2, 2))
    stopping.stopping_speeds(np.ones(2), np.ones(2), ones, ones, np.ones(2), np.array([1, 1]))
    rasteriser.nearest_triangles(np.eye(3), np.array([[0, 1, 2]]), 4, 4)
    rasteriser.light_at(np.eye(3), np.eye(3), np.eye(2), np.eye(4)[:2], np.ones((2, 4, 4), np.float32), 0.0)
    links, places = np.array([[0, 1]]), np.arange(6.0).reshape(1, 2, 3)
    field.pulls(places, links, np.ones((1, 3, 2)), ones[:1].copy(), False)


def kernels() -> dict[str, Any]:
    """Return all kernels and parts by their names."""
    import safe_ompl
    from safe_ompl.common.compilation import sources

    package = Path(safe_ompl.__file__).parent
    found = {}
    for path in sources(package):
        module = ".".join(path.relative_to(package.parent).with_suffix("").parts)
        for name, value in vars(import_module(module)).items():
            if hasattr(value, "py_func") and value.__module__ == module:
                found[f"{module}.{name}"] = value
    return found


def busy() -> float:
    """Return the CPU time of a loop in pure Python [s]."""
    begin, total = process_time(), 0
    for k in range(5_000_000):
        total += k
    return process_time() - begin


def all_alone() -> None:
    """Ask for all kernels in one process."""
    os.cpu_count = lambda: 1
    plan_and_simplify()
    drive()
    call_the_rest()


def all_but_plans() -> None:
    """Ask for those that neither a plan nor its simplification needs."""
    drive()
    call_the_rest()


def measure(job: str) -> None:
    """Do something and print what it took; the cache is in an environment variable."""
    compilation = Compilation()
    begin = perf_counter()
    globals()[job]()
    wall, times = perf_counter() - begin, os.times()
    busier = max(times.user + times.system, times.children_user + times.children_system)
    left = sorted(name for name, kernel in kernels().items() if not kernel.signatures)
    rows = [
        (name, seconds, compilation.signatures[name]) for name, seconds in compilation.seconds.most_common()
    ]
    print(json.dumps({"rows": rows, "left": left, "wall": wall, "busier": busier, "busy": busy()}))
    sys.stdout.flush()
    os._exit(0)  # without the farewell of OMPL's bindings


def run(*arguments: str, env: Mapping[str, str]) -> str:
    """Return what Python prints."""
    return subprocess.check_output(
        [sys.executable, *arguments], env=env, text=True, stderr=subprocess.DEVNULL
    )


def main() -> None:
    """Print both."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--rows", type=int, default=12)
    parser.add_argument("--imports", type=int, default=5)
    parser.add_argument("--measure", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.measure:
        measure(options.measure)
    with tempfile.TemporaryDirectory() as folder:
        cached = {**os.environ, "PYTHONDONTWRITEBYTECODE": "", "PYTHONPYCACHEPREFIX": folder}
        foreign = run("-c", IMPORTED, env=cached).split()
        imports = [float(run("-c", IMPORT, *foreign, env=cached)) for _ in range(options.imports + 1)]

        def measured(job: str, kept: str) -> dict[str, Any]:
            env = {**cached, "NUMBA_CACHE_DIR": os.path.join(folder, kept)}
            return dict(json.loads(run(__file__, "--measure", job, env=env).splitlines()[-1]))

        found = measured("all_alone", "alone")
        first = measured("plan_once", "two")
        with ThreadPoolExecutor() as pool:
            rest = list(pool.map(measured, ("plan_and_simplify", "all_but_plans"), ("two", "two")))
        second = measured("plan_once", "two")
    total = sum(seconds for _, seconds, _ in found["rows"])
    print_table(
        ("compiled", "CPU [ms]", "signatures"),
        [(name, 1e3 * seconds, count) for name, seconds, count in found["rows"][: options.rows]],
    )
    print(
        f"\nall {len(found['rows'])}: {total:.1f} s, or {total / found['busy']:.0f} loops of {found['busy']:.2f} s"
    )
    if found["left"]:
        print(f"nothing asked for {', '.join(found['left'])}")
    for clock, words in (("wall", "wall"), ("busier", "CPU of the busier process")):
        beyond, then = first[clock] - second[clock], max(one[clock] for one in rest)
        print(
            f"{words}: {beyond:.1f} s for a first plan beyond a second one of {second[clock]:.1f} s, "
            f"{first[clock] + then:.1f} s for all kernels"
        )
    own = float(np.median(imports[1:]))
    print(
        f"from safe_ompl import SafeSetup: {own:.3f} s beyond others' modules, or {own / found['busy']:.2f} loops"
    )


if __name__ == "__main__":
    main()
