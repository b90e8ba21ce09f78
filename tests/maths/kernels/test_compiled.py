"""Kernels are compiled once, for one kind of arguments each, kept on disk, and said so once."""

import os
import subprocess
import sys
from pathlib import Path
from time import perf_counter

import numpy as np
from numba import njit
from numba.core import event

import safe_ompl
from safe_ompl.danger.field import DangerField
from safe_ompl.maths.kernels import compiled, danger, field, joints

PROGRAM = """
import logging, sys
logging.basicConfig(format="%(name)s %(message)s", stream=sys.stdout)
import numpy as np
from safe_ompl.maths.kernels.field import link_distances
from safe_ompl.maths.kernels.danger import aggregates
link_distances(np.zeros((1, 2, 3)), np.array([[0, 1]]), np.ones((1, 3, 1)))
print(aggregates(np.ones((1, 2)), 0, 1.0), link_distances.stats.cache_hits)
"""


def run(cache: Path, **options: str) -> list[str]:
    folder = str(Path(safe_ompl.__file__).parents[1])
    environment = os.environ | {"NUMBA_CACHE_DIR": str(cache), "PYTHONPATH": folder} | options
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM], env=environment, capture_output=True, text=True, check=True
    )
    assert not done.stderr
    return done.stdout.splitlines()


def test_says_once_that_it_compiles_and_keeps_what_it_compiled(tmp_path):
    first, second = run(tmp_path), run(tmp_path)
    assert first[0].startswith("safe_ompl.maths.kernels.compiled compiling kernels")
    assert [first[1:], second] == [["[1.] Counter()"], [second[0]]]
    assert second[0].startswith("[1.] Counter({")


def test_each_kernel_is_compiled_for_one_kind_of_arguments(robot_named, rng):
    """Whatever users give: another kind would be compiled while somebody waits for a path."""
    robot = robot_named("ur5")
    frozen = rng.uniform(-1, 1, (4, robot.n))
    frozen.setflags(write=False)
    batches = (frozen, np.asfortranarray(frozen), frozen[::2], frozen[:1].tolist())
    points = rng.normal(size=(3, 3))
    fields = (
        DangerField(robot, points),
        DangerField(robot, lambda q: points, [1.0, 2.0, 3.0], aggregate="mean"),
    )
    for Q in batches:
        for one in fields:
            one.values_and_gradients(Q)
            one.terms_above(Q, 0.0)
        fields[0].link_fields(robot.keypoints_batch(Q))
        fields[0].field(Q[0], points.T[:, :3])
    used = (danger.dangers, field.fields, field.link_fields, field.link_distances, joints.keypoints)
    assert [len(kernel.signatures) for kernel in used] == [1] * len(used)


def test_compiles_without_keeping_anything_where_nothing_can_be_written(monkeypatch):
    def no_folder(cache=False, **options):
        if cache:
            raise RuntimeError("cannot cache function: no locator available")
        return njit(**options)

    monkeypatch.setattr(compiled, "njit", no_folder)
    assert compiled.compiled(lambda x: 1 / x)(0.0) == np.inf


def test_constants_cause_no_compilation_of_their_own():
    @compiled.part
    def plus(x, n):
        return x + n

    @njit
    def three(n):
        return plus(plus(n, 0), 3)

    assert three(4) == 7
    assert len(plus.signatures) == 1


def test_the_clock_of_time_limits_stands_while_kernels_are_compiled():
    """A first plan after an installation would be over before it began."""

    class Dispatcher:
        __module__ = "safe_ompl.maths.kernels.somewhere"

    compilation = compiled._Compilation()
    compilation._said = True
    made = event.Event("numba:compile", event.EventStatus.START, {"dispatcher": Dispatcher()})
    compilation.on_start(made)
    compilation.on_start(made)  # one that it calls
    compilation.on_end(made)
    assert compilation.seconds == 0.0
    compilation.on_end(made)
    once = compilation.seconds
    assert once > 0.0
    before = perf_counter() - compiled._compilation.seconds
    assert before <= compiled.clock() <= perf_counter() - compiled._compilation.seconds
