"""Benchmarks: what OMPL's reader finds in their logs, and that nothing which goes wrong in a run ends them."""

from __future__ import annotations

import logging
import os
import signal
import sqlite3
import threading

import numpy as np
import pytest
from ompl import base as ob
from ompl import geometric as og
from ompl import tools as ot
from ompl import util as ou

from safe_ompl import Benchmark, InputError, SafeRRTConnect, Scenario
from safe_ompl.apps.benchmark.measures import planner_settings
from safe_ompl.apps.benchmark.runs import in_processes
from safe_ompl.common import warn_once
from safe_ompl.planning import setup_scenario
from safe_ompl.scene import find_scenario


def request(**values):
    usual = {"maxTime": 20.0, "runCount": 2, "displayProgress": False, "saveConsoleOutput": False}
    return ot.Request(**{**usual, "simplify": False, **values})


def runs_of(benchmark, folder):
    benchmark.saveResultsToDatabase(folder / "b.log", folder / "b.db")
    with sqlite3.connect(folder / "b.db") as connection:
        connection.row_factory = sqlite3.Row
        query = "SELECT p.name AS planner, p.settings, r.* FROM runs r JOIN plannerConfigs p ON p.id = r.plannerid"
        return [dict(row) for row in connection.execute(query)]


def build():
    return setup_scenario(Scenario.load(find_scenario("planar3")))


@pytest.fixture
def setup():
    return build()


def test_measurements_reach_the_database(setup, tmp_path):
    benchmark = Benchmark(setup, "planar arm")
    benchmark.addPlanner("SafePRM")
    benchmark.addPlannerAllocator(lambda si: SafeRRTConnect(si, "eager", alpha=2.0))
    benchmark.addPlanner(og.RRTConnect(setup.getSpaceInformation()))
    benchmark.addExperimentParameter("obstacles", "INTEGER", "4")
    benchmark.benchmark(request(simplify=True), processes=1)
    runs = runs_of(benchmark, tmp_path)
    assert [run["planner"] for run in runs] == 2 * ["SafePRM"] + 2 * ["eager"] + 2 * ["RRTConnect"]
    assert "alpha = 2.0" in runs[2]["settings"]
    assert "range = " in runs[4]["settings"]
    for run in runs:
        assert (run["solved"], run["status"], run["certified"], run["correct_solution"]) == (1, 6, 1, 1)
        assert run["graph_states"] > run["graph_motions"] - run["graph_states"] > -2
        assert 0 < run["danger_mean"] < run["danger_max"]
        assert 0 < run["danger_integral"] > run["danger_avoidable"]
        assert 0 < run["clearance_min"] < run["clearance_mean"]
        assert run["bound_queries"] > 0
        assert run["time"] > 0
        assert run["memory"] >= 0
        assert run["simplified_solution_length"] > 0
    assert [run["seed"] for run in runs] == [0, 1] * 3
    assert benchmark.getExperimentParameters() == {"obstacles": "4"}


def test_a_run_is_what_plan_does_with_the_same_seed_in_any_process(setup, tmp_path):
    plans = [setup.plan("SafePRM", seed=seed) for seed in (5, 6, 7)]
    for processes in (1, 2):
        benchmark = Benchmark(setup, "p")
        benchmark.addPlanner("SafePRM")
        benchmark.benchmark(request(runCount=3), seed=5, processes=processes)
        (planner,) = benchmark.getRecordedExperimentData().planners
        for run, plan in zip(planner.runs, plans, strict=True):
            assert run["danger integral"] == plan.report.danger.integral
            assert run["bound queries"] == plan.counts.bound_queries


def test_goals_in_the_workspace_start_anew_in_every_run(tmp_path):
    setup, place = build(), [0.465, -0.875, 0.0]
    setup.setWorkspaceGoal(place)
    plans = [setup.plan("SafeJTRRT", seed=seed) for seed in (5, 6)]
    benchmark = Benchmark(setup, "place")
    benchmark.addPlanner("SafeJTRRT")
    benchmark.benchmark(request(), seed=5, processes=2)
    for run, plan in zip(runs_of(benchmark, tmp_path), plans, strict=True):
        assert run["danger_integral"] == plan.report.danger.integral


def test_progress_of_planners_that_improve_their_path(setup, tmp_path):
    benchmark = Benchmark(setup, "anytime")
    benchmark.addPlanner("RRTstar")
    benchmark.benchmark(request(runCount=1, timeBetweenUpdates=0.02, maxTime=0.6), processes=1)
    runs_of(benchmark, tmp_path)
    with sqlite3.connect(tmp_path / "b.db") as connection:
        rows = connection.execute("SELECT best_cost, iterations FROM progress ORDER BY time").fetchall()
    assert len(rows) > 1  # on an idle machine 30
    costs, iterations = np.array(rows).T
    assert (np.diff(costs) <= 0).all()
    assert (np.diff(iterations) > 0).all()


@pytest.mark.parametrize("processes", [1, 2])
def test_an_exception_is_a_crash_of_its_run_only(tmp_path, processes, setup):
    class Doubtful(SafeRRTConnect):
        def _search(self, ptc):
            if self.getSeed() == 1:
                raise RuntimeError("no; not\nthis one")
            return super()._search(ptc)

    benchmark = Benchmark(setup, "doubt")
    benchmark.addPlannerAllocator(Doubtful)
    benchmark.benchmark(request(runCount=3), processes=processes)
    runs = runs_of(benchmark, tmp_path)
    assert [run["status"] for run in runs] == [6, 7, 6]
    assert [run["error"] for run in runs] == [None, "RuntimeError: no not this one", None]


def test_a_run_that_kills_its_process_is_a_crash_of_its_run_only(setup, tmp_path):
    class Deadly(SafeRRTConnect):
        def _search(self, ptc):
            if self.getSeed() == 1:
                os.kill(os.getpid(), signal.SIGKILL)
            return super()._search(ptc)

    benchmark = Benchmark(setup, "deadly")
    benchmark.addPlannerAllocator(Deadly)
    benchmark.benchmark(request(runCount=4), processes=2)
    runs = runs_of(benchmark, tmp_path)
    assert [run["status"] for run in runs] == [6, 7, 6, 6]
    assert runs[1]["error"] == "the process ended with exit code -9"


def test_a_run_whose_process_was_lost_is_done_again(setup, tmp_path):
    class Unlucky(SafeRRTConnect):
        def _search(self, ptc):
            mark = tmp_path / "lost"
            if self.getSeed() == 1 and not mark.exists():
                mark.touch()
                os.kill(os.getpid(), signal.SIGKILL)
            return super()._search(ptc)

    benchmark = Benchmark(setup, "unlucky")
    benchmark.addPlannerAllocator(Unlucky)
    benchmark.benchmark(request(runCount=4), processes=2)
    assert (tmp_path / "lost").exists()
    assert [run["status"] for run in runs_of(benchmark, tmp_path)] == [6, 6, 6, 6]


@pytest.mark.parametrize("processes", [1, 2])
def test_ctrl_c_keeps_what_was_done(setup, tmp_path, processes):
    handler = ou.getOutputHandler()
    benchmark = Benchmark(setup, "interrupted")
    benchmark.addPlanner("SafeRRTConnect")
    benchmark.addPlanner("RRTstar")
    over = threading.Event()

    def press():
        while benchmark.getStatus().activeRun < 4 and not over.wait(0.02):
            pass
        if not over.is_set():
            os.kill(os.getpid(), signal.SIGINT)

    pressing = threading.Thread(target=press)
    pressing.start()
    try:
        with pytest.raises(KeyboardInterrupt):
            benchmark.benchmark(request(runCount=1000, maxTime=0.5), processes=processes)
    finally:
        over.set()
        pressing.join()
    assert ou.getOutputHandler() is handler
    assert not benchmark.getStatus().running
    runs = runs_of(benchmark, tmp_path)
    assert 2 <= len(runs) < 30
    assert setup.plan("SafeRRTConnect")


def test_events(setup, tmp_path):
    seen: list[str] = []

    def after(planner, run):
        seen.append("after")
        run["effort REAL"] = "2.5"
        run["doubled length"] = 2 * run["solution length"]

    benchmark = Benchmark(setup, "events")
    benchmark.addPlanner("SafePRM")
    benchmark.setPlannerSwitchEvent(lambda planner: seen.append(planner.getName()))
    benchmark.setPreRunEvent(lambda planner: seen.append("before"))
    benchmark.setPostRunEvent(after)
    benchmark.benchmark(request(runCount=1))
    assert seen == ["SafePRM", "before", "after"]
    (run,) = runs_of(benchmark, tmp_path)
    assert run["effort"] == 2.5
    assert run["doubled_length"] == 2 * run["solution_length"]


def test_console_output_goes_to_a_file(setup, tmp_path, monkeypatch, capfd):
    monkeypatch.chdir(tmp_path)
    benchmark = Benchmark(setup, "talk")
    benchmark.addPlanner("RRTConnect")
    benchmark.benchmark(request(runCount=1, saveConsoleOutput=True), processes=1)
    (file,) = tmp_path.glob("talk_*.console")
    assert "RRTConnect" in file.read_text(encoding="utf-8")
    assert capfd.readouterr().out == ""
    assert benchmark.saveResultsToFile()
    assert len(list(tmp_path.glob("talk_*.log"))) == 1


def test_any_simple_setup(tmp_path):
    space = ob.RealVectorStateSpace(2)
    bounds = ob.RealVectorBounds(2)
    bounds.setLow(-1)
    bounds.setHigh(1)
    space.setBounds(bounds)
    setup = og.SimpleSetup(space)
    setup.setStateValidityChecker(lambda state: bool(abs(state[0]) > 0.2 or state[1] > 0.5))
    start, goal = space.allocState(), space.allocState()
    start[0:2], goal[0:2] = [-0.8, 0.0], [0.8, 0.0]
    setup.setStartAndGoalStates(start, goal)
    benchmark = Benchmark(setup, "point")
    benchmark.addPlanner("SafeRRTConnect")
    benchmark.addPlanner("RRT")
    benchmark.benchmark(request(simplify=True), processes=2)
    runs = runs_of(benchmark, tmp_path)
    assert [run["solved"] for run in runs] == [1, 1, 1, 1]
    assert all(1.6 < run["simplified_solution_length"] < 5 for run in runs)


def test_settings_come_back_as_parameters(setup):
    planner = SafeRRTConnect(setup.getSpaceInformation(), alpha=3.0, slide=0.25)
    assert planner_settings(planner).items() >= {"alpha": 3.0, "slide": 0.25, "nearest_fraction": 0.3}.items()


def test_bad_benchmarks_are_refused(setup):
    with pytest.raises(InputError, match="setup"):
        Benchmark("planar3")
    benchmark = Benchmark(setup)
    with pytest.raises(InputError, match="planner"):
        benchmark.benchmark(request())
    with pytest.raises(InputError, match="'Fly'"):
        benchmark.addPlanner("Fly")
    with pytest.raises(InputError, match="planner"):
        benchmark.addPlanner(3)
    benchmark.addPlanner("RRT")
    with pytest.raises(InputError, match="processes"):
        benchmark.benchmark(request(), processes=0)
    with pytest.raises(InputError, match="runCount"):
        benchmark.benchmark(request(runCount=0))


class Talkative:
    """A job each of whose processes has the same to say."""

    def run(self, task):
        warn_once(logging.getLogger("safe_ompl.talk"), "said by every process")
        logging.getLogger("safe_ompl.talk").warning("task %d", task)
        return task

    def crash(self, task, words):
        return None


def test_what_is_said_once_is_said_once_though_every_process_has_to_say_it(caplog):
    done = dict(in_processes(Talkative(), list(range(4)), 2))
    assert sorted(done) == sorted(done.values()) == list(range(4))
    said = [record.getMessage() for record in caplog.records]
    assert said.count("said by every process") == 1
    assert {f"task {k}" for k in range(4)} <= set(said)
