"""Ctrl-C and exceptions of the user's callbacks end planning at once, arrive unchanged, and leave all intact."""

from __future__ import annotations

import itertools
import json
import signal
import subprocess
import sys
import threading
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import safe_ompl
from safe_ompl import CollisionFreeValidity, DangerObjective, Replanner, Scenario, Simplifier, WorkspaceGoal
from safe_ompl.apps import main
from safe_ompl.apps.benchmark import Campaign
from safe_ompl.planning import setup_scenario
from safe_ompl.planning.planners import SafeRRTConnect, is_ours, make_planner, needs_place, planner_names
from safe_ompl.planning.run import noted_ctrl_c

PLANNERS = [name for name in planner_names() if is_ours(name) or name in ("RRTConnect", "RRTstar", "BITstar")]
PACKAGE = str(Path(safe_ompl.__file__).parent)
PROGRAM = Path(__file__).parent / "programs" / "interrupted.py"


class CtrlC:
    """Presses Ctrl-C at the k-th call of a function of the package, and notes how often the clock was read before.

    Calls of `__del__` do not count, since Python discards what these raise.
    """

    def __init__(self, k, ticks):
        self.left, self.ticks, self.looks = k, ticks, -1

    def __call__(self, frame, event, argument):
        code = frame.f_code
        if event == "call" and code.co_name != "__del__" and code.co_filename.startswith(PACKAGE):
            self.left -= 1
            if self.left == 0:
                sys.setprofile(None)
                self.looks = self.ticks.looks
                signal.raise_signal(signal.SIGINT)


def looks_after_ctrl_c(setup, planner, k, ticks):
    """Plan until Ctrl-C is pressed at the k-th call, and return how often a planner looked at the clock after that."""
    setup.prepare(planner, 0)
    ctrl_c = CtrlC(k, ticks)
    sys.setprofile(ctrl_c)
    try:
        while True:
            setup.clear()
            assert setup.solve(1e6)
            assert ctrl_c.left > 0, "Ctrl-C was lost"
    except KeyboardInterrupt:
        return ticks.looks - ctrl_c.looks
    finally:
        sys.setprofile(None)


@pytest.mark.parametrize("planner", PLANNERS)
def test_ctrl_c_ends_planning_at_once(planner, ticks):
    setup, rng = setup_scenario(Scenario.load("planar3")), np.random.default_rng(7)
    for k in rng.integers(1, 2000, 4):
        assert looks_after_ctrl_c(setup, planner, k, ticks) <= 1
        assert not setup.haveSolutionPath() or setup.report(setup.solution()).certified
        result = setup.plan(planner, time=0.1)
        assert not result or result.report.certified


def test_a_program_that_was_interrupted_ends_quietly():
    program = subprocess.Popen(
        [sys.executable, str(PROGRAM), "BITstar"], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    try:
        assert program.stdout.readline() == "ready\n", program.stderr.read()
        program.send_signal(signal.SIGINT)
        output, errors = program.communicate(timeout=30)
    finally:
        program.kill()
    assert (program.returncode, output, errors) == (0, "interrupted\n", "")


class FirstOfAllError(Exception):
    """What a user's callback raises."""


class Fuse:
    """Raises at the k-th call, once."""

    def __init__(self, k):
        self.left = k

    def burn(self):
        self.left -= 1
        if self.left == 0:
            raise FirstOfAllError("of all")


def broken(kind, fuse, *methods):
    """Return a class whose methods burn a fuse first."""

    def burning(name):
        def method(self, *arguments):
            fuse.burn()
            return getattr(super(made, self), name)(*arguments)

        return method

    made = type("Broken", (kind,), {name: burning(name) for name in methods})
    return made


def put_broken(setup, fuse, what):
    """Give a setup a plug-in that burns a fuse."""
    si = setup.getSpaceInformation()
    if what == "checker":
        setup.setStateValidityChecker(broken(CollisionFreeValidity, fuse, "isValid")(si, setup.checker))
    elif what == "function":
        setup.setStateValidityChecker(lambda state: fuse.burn() is None)
    elif what == "objective":
        kind = broken(DangerObjective, fuse, "stateCost", "motionCost", "values")
        setup.setOptimizationObjective(kind(si, setup.field))
    else:
        kind = broken(WorkspaceGoal, fuse, "sampleGoal", "distanceGoal")
        setup.setGoal(kind(si, setup.robot, [0.465, -0.875, 0.0], seed=0))


@pytest.mark.parametrize("planner", PLANNERS)
def test_an_exception_of_a_callback_arrives_unchanged(planner):
    scenario = Scenario.load("planar3")
    raised = []
    for what in ("checker", "function", "objective", "goal"):
        setup = setup_scenario(scenario)
        if needs_place(planner):
            setup.setWorkspaceGoal(scenario.goal.position)
        fuse = Fuse(10**9)
        put_broken(setup, fuse, what)
        setup.setPlanner(make_planner(planner, setup.getSpaceInformation()))
        setup.setup()
        fuse.left = 3
        try:
            setup.solve(1.0 if planner.startswith(("Safe", "Classic", "Bubble")) else 0.1)
        except FirstOfAllError as error:
            raised.append((what, str(error), setup.haveSolutionPath()))
        else:
            assert fuse.left > 0, f"{what}: the exception was lost"
        fuse.left = 10**9
        setup.solve(0.1)
        assert not setup.haveExactSolutionPath() or setup.report(setup.solution()).certified
    assert raised
    assert {(message, solved) for _, message, solved in raised} == {("of all", False)}


# --------------------------------------------------------------------- while a path that is found is made better


@pytest.fixture
def ctrl_c_while_simplifying(monkeypatch):
    """Press Ctrl-C, once, in the middle of a simplification; return what was said later to who asked about stopping."""
    begin, pressed, said = Simplifier.begin, [], list[bool]()

    def interrupted(self, path, stop, *rest, **options):
        def asked():
            if not pressed:
                pressed.append(True)
                signal.raise_signal(signal.SIGINT)
            said.append(stop())
            return said[-1]

        return begin(self, path, asked, *rest, **options)

    monkeypatch.setattr(Simplifier, "begin", interrupted)
    return said


BETTER = [{"simplify": True}, {"optimise": 60.0}, {"ways": "all"}, {"starts": 9, "simplify": True}]


@pytest.mark.parametrize("options", BETTER, ids=lambda options: "+".join(options))
def test_ctrl_c_leaves_the_best_path_so_far(ctrl_c_while_simplifying, options):
    setup = setup_scenario(Scenario.load("planar3"))
    before = signal.getsignal(signal.SIGINT)
    result = setup.plan(time=20.0, seed=0, **options)
    assert all(ctrl_c_while_simplifying)
    assert len(ctrl_c_while_simplifying) < 5
    assert result.report.certified
    assert result.interrupted
    assert result.as_dict()["interrupted"] is True
    assert signal.getsignal(signal.SIGINT) is before
    assert not setup.plan(time=20.0, seed=0, simplify=0.1).interrupted


def test_ctrl_c_before_there_is_a_path_leaves_nothing():
    class Endless(SafeRRTConnect):
        def _search(self, ptc):
            signal.raise_signal(signal.SIGINT)
            while not ptc():
                pass

    setup = setup_scenario(Scenario.load("planar3"))
    for options in ({}, {"simplify": True}, {"optimise": 60.0}):
        with pytest.raises(KeyboardInterrupt):
            setup.plan(Endless(setup.getSpaceInformation()), time=60.0, **options)


def test_ctrl_c_ends_all_the_runs_of_a_campaign(ctrl_c_while_simplifying):
    campaign = Campaign(Scenario.load("planar3"), ("SafeRRTConnect",), 5, simplify=True)
    with pytest.raises(KeyboardInterrupt):
        list(campaign.results())


@pytest.mark.parametrize("option", [["--simplify"], ["--optimise", "60"]])
def test_the_command_line_says_that_it_was_interrupted(ctrl_c_while_simplifying, capfd, option):
    assert main(["plan", "planar3", *option]) == 0
    out, err = capfd.readouterr()
    assert "certified: no collision" in out
    assert err == "safe-ompl: interrupted: this is the best path so far\n"


def test_in_a_thread_ctrl_c_is_not_looked_for():
    def work():
        with noted_ctrl_c() as noted:
            handlers.append(signal.getsignal(signal.SIGINT))
        assert not noted

    handlers: list[Any] = []
    before = signal.getsignal(signal.SIGINT)
    thread = threading.Thread(target=work)
    thread.start()
    thread.join()
    assert handlers == [before]


def test_live_writes_its_summary_at_ctrl_c(monkeypatch, tmp_path, capfd):
    think, calls = Replanner.think, itertools.count(1)

    def pressed(*arguments, **options):
        if next(calls) == 5:
            signal.raise_signal(signal.SIGINT)
        return think(*arguments, **options)

    monkeypatch.setattr(Replanner, "think", pressed)
    command = ["live", "panda_shelf", "--people", "random:1", "--out", str(tmp_path)]
    assert main(command) == 130
    summary = json.loads((tmp_path / "summary.json").read_text())
    assert summary["seconds"] == pytest.approx(0.2)
    assert summary["model_obeyed"] == 1.0
    assert len((tmp_path / "ticks.jsonl").read_text().splitlines()) == 1 + 4
    assert "0.2 s: 0 tasks" in capfd.readouterr().out


def test_ctrl_c_while_the_program_is_imported_is_no_traceback():
    program = """
import signal, sys
class Pressed:
    def find_spec(self, name, *rest):
        if name == "numpy":
            signal.raise_signal(signal.SIGINT)
sys.meta_path.insert(0, Pressed())
from safe_ompl.__main__ import main
main()
"""
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout, done.stderr) == (130, "", "safe-ompl: interrupted\n")
