"""The first plan after an installation: what it calls is compiled in two processes, and all of it."""

import os
import subprocess
import sys
from pathlib import Path

import safe_ompl

PROGRAM = """
from numba.core import event
from safe_ompl.common import clock
from safe_ompl.planning import first_plan

class Compiled(event.Listener):
    names = []
    def on_start(self, event):
        self.names.append(event.data["dispatcher"].__name__)
    def on_end(self, event):
        pass

event.register("numba:compile", Compiled())
first_plan.compile_kernels()
here, Compiled.names[:] = set(Compiled.names), []
from safe_ompl import plan
assert plan("panda_shelf", time=60.0)
print("dangers" in here, "prove_curve" in here, *sorted(set(Compiled.names)), sep=",")
"""


def test_two_processes_compile_what_a_plan_calls(tmp_path):
    environment = os.environ | {
        "NUMBA_CACHE_DIR": str(tmp_path),
        "PYTHONPATH": str(Path(safe_ompl.__file__).parents[1]),
    }

    def compiled():
        command = [sys.executable, "-c", PROGRAM]
        answer = subprocess.run(command, env=environment, capture_output=True, text=True, check=True).stdout
        return answer.splitlines()[-1].split(",")

    danger, proofs, *later = compiled()
    assert sorted([danger, proofs]) == ["False", "True"], "either process compiles one of them"
    assert set(later) <= {"scan", "_distance", "take_step", "impl"}, "small ones are left for the plan"
    assert compiled() == ["False", "False"]
