"""What compiling the kernels and importing the package cost.

In a process of its own, with an empty cache, all is compiled that `doctor` lets two processes compile; others are said.
Printed are CPU times: of all, and of the kernels and parts that took longest, without what they call, with the number
of signatures that each was compiled for.

Then, with other empty caches, there are a first plan and a second one, and all that `doctor` compiles; both compile in
two processes. Printed are wall times, and the CPU times of either process, with what it imports: the longer one is the
wall time of a machine with two cores and nothing else to do. Bars: 8 s for the first plan beyond the second one, and
15 s for all.

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
from importlib import import_module
from pathlib import Path
from pkgutil import resolve_name
from time import perf_counter, process_time
from typing import Any

import numpy as np
from numba.core import event

from bench._harness import Report

CLAIM = "how long the first plan waits for kernels, and what the import takes"
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
    from safe_ompl.apps.cli.doctor import ALL_JOBS

    for job in ALL_JOBS:
        resolve_name(job)()


def all_together() -> None:
    """Compile all that `doctor` does."""
    from safe_ompl.apps.cli.doctor import compile_all

    compile_all()


def measure(job: str) -> None:
    """Do something and print what it took; the cache is in an environment variable."""
    compilation = Compilation()
    begin = perf_counter()
    globals()[job]()
    wall, times = perf_counter() - begin, os.times()
    both = times.user + times.system, times.children_user + times.children_system
    left = sorted(name for name, kernel in kernels().items() if not kernel.signatures)
    rows = [(name, seconds, compilation.signatures[name]) for name, seconds in compilation.seconds.most_common()]
    print(json.dumps({"rows": rows, "left": left, "wall": wall, "both": both, "busy": busy()}))
    sys.stdout.flush()
    os._exit(0)  # without the farewell of OMPL's bindings


def run(*arguments: str, env: Mapping[str, str]) -> str:
    """Return what Python prints."""
    return subprocess.check_output([sys.executable, *arguments], env=env, text=True, stderr=subprocess.DEVNULL)


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options."""
    parser.add_argument("--rows", type=int, default=12)
    parser.add_argument("--imports", type=int, default=5)


def main(options: argparse.Namespace, report: Report) -> None:
    """Report both."""
    with tempfile.TemporaryDirectory() as folder:
        cached = {**os.environ, "PYTHONDONTWRITEBYTECODE": "", "PYTHONPYCACHEPREFIX": folder}
        foreign = run("-c", IMPORTED, env=cached).split()
        imports = [float(run("-c", IMPORT, *foreign, env=cached)) for _ in range(options.imports + 1)]

        def measured(job: str, kept: str) -> dict[str, Any]:
            env = {**cached, "NUMBA_CACHE_DIR": os.path.join(folder, kept)}
            command = f"from bench.compilation import measure; measure({job!r})"
            return dict(json.loads(run("-c", command, env=env).splitlines()[-1]))

        found = measured("all_alone", "alone")
        first = measured("plan_once", "two")
        second = measured("plan_once", "two")
        everything = measured("all_together", "all")
    total = sum(seconds for _, seconds, _ in found["rows"])
    rows = [(name, 1e3 * seconds, count) for name, seconds, count in found["rows"][: options.rows]]
    report.table(("compiled", "CPU [ms]", "signatures"), rows)
    report.figure("kernels and parts", len(found["rows"]))
    report.figure("all of them [s]", total)
    report.figure("a loop in pure Python [s]", found["busy"])
    report.figure("nothing asked for", ", ".join(found["left"]) or "none")
    jobs = {"a first plan": first, "a second plan": second, "all of doctor's kernels": everything}
    rows = [(words, one["wall"], *one["both"]) for words, one in jobs.items()]
    report.table(("", "wall [s]", "CPU [s]", "of the other process"), rows)
    report.figure("import of SafeSetup beyond others' modules [s]", float(np.median(imports[1:])))
