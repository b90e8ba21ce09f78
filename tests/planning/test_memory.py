"""Memory in use does not grow from plan to plan, nor with checks and time laws."""

import ctypes
import gc

import pytest

from safe_ompl import RateLimits, Scenario, check, time_path
from safe_ompl.planning import setup_scenario

ROUND = 60
# Less than the coordinates of one state, or any Python object, per call.
MOST = 24 * ROUND  # bytes


class MallocInfo(ctypes.Structure):
    """What `mallinfo2` of the GNU C library returns."""

    _names = "arena chunks fast_chunks maps mapped peak fast_bytes allocated free top"
    _fields_ = [(name, ctypes.c_size_t) for name in _names.split()]


libc = ctypes.CDLL(None)


def bytes_in_use():
    """Return how many bytes of the heap are allocated, by C and C++ as well as by Python."""
    gc.collect()
    info = libc.mallinfo2()
    return info.mapped + info.allocated


@pytest.mark.skipif(not hasattr(libc, "mallinfo2"), reason="needs the GNU C library")
@pytest.mark.parametrize("task", ["SafeRRTConnect", "RRTConnect", "check", "time_path"])
def test_memory_does_not_grow(task, monkeypatch):
    monkeypatch.setattr(libc.mallinfo2, "restype", MallocInfo)
    setup = setup_scenario(Scenario.load("planar3"))
    path, limits = setup.plan("SafeRRTConnect", seed=0).path, RateLimits.of(setup.robot, acceleration=5.0)
    actions = {
        "check": lambda seed: check(path, setup.robot, setup.scene),
        "time_path": lambda seed: time_path(path, setup.robot, limits),
    }
    action = actions.get(task, lambda seed: setup.plan(task, seed=seed))
    growth = []
    for first in range(0, 4 * ROUND, ROUND):
        before = bytes_in_use()
        for seed in range(first, first + ROUND):
            action(seed)
        growth.append(bytes_in_use() - before)
    # What is kept once, such as a longer buffer, is in one round only.
    assert min(growth) <= MOST, growth
