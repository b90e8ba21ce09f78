"""A few of the random programs of bench/torture.py; and no bench, example or program leaves with leaked instances."""

import subprocess
import sys
from pathlib import Path

import pytest

BENCH = Path(__file__).parents[2] / "bench"


def output_of(*command):
    run = subprocess.run([sys.executable, *command], capture_output=True, text=True, timeout=120)
    assert (run.returncode, run.stderr) == (0, ""), f"after {run.stdout[-300:]}"
    return run.stdout


@pytest.mark.parametrize("number", range(3))
def test_a_random_program_survives(number):
    steps = output_of(str(BENCH / "torture.py"), "--program", str(number)).splitlines()
    assert len([step for step in steps if not step.startswith(" ")]) == 25


def test_memory_is_given_back():
    lines = output_of(str(BENCH / "memory.py"), "--solves", "100").splitlines()
    counts = dict(reversed(part.split()) for part in lines[-2].split(", "))
    assert sum(map(int, counts.values())) == 100
    assert int(counts["solved"]) > 10
    assert int(counts["failed"]) > 10
    assert int(counts["broken"]) > 0
