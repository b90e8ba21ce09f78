"""Runs, campaigns and benchmarks: who runs when, what OMPL's reader finds, and that no run ends the others."""

import dataclasses
import logging
import multiprocessing
import os
import signal
import sqlite3
from concurrent.futures import Executor, Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool

import numpy as np
import pytest
from ompl import geometric as og, tools as ot

from safe_ompl import Benchmark, SafeRRTConnect, SafeSetup, Scenario, load, save
from safe_ompl.apps.benchmark import (
    BASELINE,
    SAFEST_OF_ROUTES,
    Campaign,
    Run,
    Summary,
    as_planned,
    default_planners,
    failure,
    result_of_crash,
    summarize,
)
from safe_ompl.common import InputError, PlanningError, UnknownNameError, in_order, warn_once
from safe_ompl.planning import setup_scenario
from safe_ompl.planning.planners import is_ours, planner_names

PLANNERS = ("RRTConnect", "SafeRRTConnect")


@pytest.fixture(scope="module")
def scenario():
    return Scenario.load("planar3")


@pytest.fixture(scope="module")
def setup(scenario):
    return setup_scenario(scenario)


@pytest.fixture(scope="module")
def results(scenario, setup):
    return list(Campaign(scenario, PLANNERS, runs=5, seed=10).results(setup))


# ------------------------------------------------------------------------------------------------- campaigns


def test_planners_take_turns_with_the_same_seeds_in_any_process(scenario, setup, results):
    assert [(r.planner, r.seed) for r in results] == [(planner, seed) for seed in range(10, 15) for planner in PLANNERS]
    for result, other in zip(results, Campaign(scenario, PLANNERS, 5, seed=10).results(workers=2), strict=True):
        np.testing.assert_array_equal(result.path, other.path)
        np.testing.assert_array_equal(result.path, setup.plan(result.planner, seed=result.seed).path)


def test_an_executor_does_the_runs_and_what_was_done_before_is_not_repeated(scenario, results, tmp_path):
    for k, result in enumerate(results[:4]):
        save(result, tmp_path / f"{k}.json")
    done = [load(tmp_path / f"{k}.json") for k in range(4)]
    campaign, known = Campaign(scenario, PLANNERS, 5, seed=10), {id(result) for result in done}
    with ProcessPoolExecutor(2, multiprocessing.get_context("spawn")) as pool:
        found = list(campaign.results(workers=pool, done=[*done, failure("Timeout", "RRTConnect", 99, ())]))
    assert [id(result) in known for result in found] == [True] * 4 + [False] * 6
    for result, other in zip(found, results, strict=True):
        assert (result.planner, result.seed) == (other.planner, other.seed)
        np.testing.assert_array_equal(result.path, other.path)


@pytest.mark.parametrize("workers", [1, 2])
def test_the_baseline_is_what_ompls_own_classes_give(scenario, setup, workers):
    (result,) = Campaign(scenario, (BASELINE,), 1, seed=3, simplify=True).results(setup, workers)
    planner, _ = setup.prepare("RRTConnect", 3)
    assert type(planner) is og.RRTConnect
    assert planner.solve(5.0)
    raw, simplified = (og.PathGeometric(setup.getProblemDefinition().getSolutionPath()) for _ in range(2))
    og.PathSimplifier(setup.getSpaceInformation()).simplifyMax(simplified)
    np.testing.assert_array_equal(result.planned_path, setup.bridge.way_points(raw))
    np.testing.assert_array_equal(result.path, setup.bridge.way_points(simplified))
    assert result.report.length < setup.report(raw).length
    assert result.report.danger.mean == setup.report(simplified).danger.mean
    before = as_planned(setup, result)
    assert (before.report.length, before.simplification_time) == (setup.report(raw).length, 0.0)
    assert (result.planner, result.certified, before.certified) == (BASELINE, True, True)


def test_the_safest_way_of_a_comparison_is_that_of_the_setup(scenario, setup):
    (result,) = Campaign(scenario, (SAFEST_OF_ROUTES,), 1, seed=3, simplify=True).results(setup)
    same = setup.plan("SafeRRTConnect", time=scenario.time, seed=3, ways="all")
    np.testing.assert_array_equal(result.path, same.path)
    assert (result.planner, result.ways) == (SAFEST_OF_ROUTES, same.ways)


class Unlucky(Executor):
    """An executor that counts what it is sent, and that fails with an error at the runs of some seeds."""

    def __init__(self, errors):
        self.errors, self.sent = errors, 0

    def submit(self, do, *runs):
        self.sent += 1
        future = Future()
        error = next((self.errors[run.seed] for run in runs if run.seed in self.errors), None)
        if error is None:
            future.set_result(do(*runs))
        else:
            future.set_exception(error)
        return future


DIED = RuntimeError("three workers died")


def test_an_executor_that_loses_a_run_goes_on_and_a_broken_one_ends_the_campaign(scenario):
    executor, found = Unlucky({1: DIED, 3: BrokenProcessPool("no worker is left")}), []
    results = Campaign(scenario, ("RRTConnect",), runs=5).results(workers=executor)
    with pytest.raises(BrokenProcessPool, match="no worker is left"):
        found.extend(results)
    free, lost = "Exact solution", "Error: RuntimeError: three workers died"
    assert [result.status for result in found] == [free, lost, free]


def test_short_runs_are_sent_together_and_those_beside_a_lost_one_once_more():
    runs, executor = [Run("a", seed) for seed in range(200)], Unlucky({40: DIED})
    found = list(in_order(lambda run: failure("Timeout", *run, ()), runs, executor, result_of_crash))
    assert [result.seed for result in found] == list(range(200))
    assert [result.seed for result in found if result.status != "Timeout"] == [40]
    assert executor.sent < 60


@pytest.mark.parametrize("workers", [1, 2])
@pytest.mark.parametrize("error", [PlanningError("edge 3 is not proven free"), RuntimeError("no; not\nthis one")])
def test_what_goes_wrong_in_a_run_is_of_that_run_and_logged_here(scenario, setup, monkeypatch, caplog, workers, error):
    def refuse(self, planner, **options):
        # An error that was raised holds the setup by its traceback, and pytest holds the parameter to the end.
        raise type(error)(str(error))

    monkeypatch.setattr(SafeSetup, "plan", refuse)
    failed = list(Campaign(scenario, PLANNERS, runs=1).results(setup, workers))
    assert [result.status for result in failed] == [f"Error: {error}"] * 2
    said = sorted(record.getMessage() for record in caplog.records)
    assert said == [f"{planner}, seed 0: {error}" for planner in PLANNERS]


@pytest.mark.parametrize("workers", [1, 2])
def test_input_that_is_wrong_for_all_runs_ends_them(scenario, setup, monkeypatch, workers):
    def confused(self, planner, **options):
        raise UnknownNameError("joint", "knee", self.robot.joint_names)

    monkeypatch.setattr(SafeSetup, "plan", confused)
    with pytest.raises(UnknownNameError, match=r"'knee'.*joint1"):
        list(Campaign(scenario, PLANNERS, runs=2).results(setup, workers))


def test_a_run_that_kills_its_process_has_no_path_and_the_others_have():
    def do(run):
        if run.seed == 1:
            os.kill(os.getpid(), signal.SIGKILL)
        return failure("Timeout", *run, ())

    statuses = [result.status for result in in_order(do, [Run("a", seed) for seed in range(4)], 2, result_of_crash)]
    assert statuses == ["Timeout", "Error: the process ended with exit code -9", "Timeout", "Timeout"]


def test_what_is_said_once_is_said_once_though_every_process_has_to_say_it(caplog):
    def do(run):
        warn_once(logging.getLogger("safe_ompl.talk"), "said by every process")
        return failure("Timeout", *run, ())

    assert len(list(in_order(do, [Run("a", seed) for seed in range(4)], 2, result_of_crash))) == 4
    assert [record.getMessage() for record in caplog.records] == ["said by every process"]


BAD_CAMPAIGNS = [
    ((), 1, 1, "at least one"),
    (("RRT", "RRT"), 1, 1, "twice"),
    (PLANNERS, 0, 1, "runs"),
    (("RRTConnect", "Fly"), 1, 1, "'Fly'"),
    (PLANNERS, 1, 0, "workers"),
]


@pytest.mark.parametrize(("planners", "runs", "workers", "said"), BAD_CAMPAIGNS)
def test_bad_campaigns_are_refused_before_any_run(scenario, setup, planners, runs, workers, said):
    with pytest.raises(InputError, match=said):
        Campaign(scenario, planners, runs).results(setup, workers)


def test_default_planners_are_the_baseline_and_all_of_ours_that_fit_the_goal(scenario):
    ours = [name for name in planner_names() if is_ours(name)]
    both = dataclasses.replace(scenario.goal, position=(0.3, 0.0, 0.4))
    assert default_planners(dataclasses.replace(scenario, goal=both)) == (BASELINE, SAFEST_OF_ROUTES, *ours)
    configurations = dataclasses.replace(scenario.goal, position=None)
    fitting = [name for name in ours if "JTRRT" not in name]
    assert default_planners(dataclasses.replace(scenario, goal=configurations)) == (
        BASELINE,
        SAFEST_OF_ROUTES,
        *fitting,
    )


def test_summaries(results):
    summaries = summarize([*results, failure("Timeout", "RRTConnect", 99, results[0].joint_names)])
    assert [(s.planner, s.runs, s.solved) for s in summaries] == [("RRTConnect", 6, 5), ("SafeRRTConnect", 5, 5)]
    mine, summary = [result for result in results if result.planner == "SafeRRTConnect"], summaries[1]
    lengths = [result.report.length for result in mine]
    assert summary.as_dict()["length"] == {
        "median": pytest.approx(np.median(lengths)),
        "p15": pytest.approx(np.percentile(lengths, 15)),
        "p85": pytest.approx(np.percentile(lengths, 85)),
    }
    low, high = np.percentile(lengths, [15, 85])
    assert summary.spread("length") == pytest.approx(high - low)
    assert summary.profiles.shape == (5, 101)
    assert summary.typical is mine[int(np.argsort([result.report.danger.mean for result in mine])[2])]
    assert summary.metrics["queries"].tolist() == [result.counts.queries for result in mine]
    nothing = Summary.of("RRT", [failure("Timeout", "RRT", 0, ("a",))])
    assert (nothing.solved, nothing.typical, nothing.profiles.size) == (0, None, 0)
    assert np.isnan(nothing.percentile("length"))


# ------------------------------------------------------------------------------------------- called like OMPL's


def request(**values):
    return ot.Request(**{"maxTime": 20.0, "runCount": 2, "displayProgress": False, "simplify": False, **values})


def runs_of(benchmark, folder):
    benchmark.saveResultsToDatabase(folder / "b.log", folder / "b.db")
    with sqlite3.connect(folder / "b.db") as connection:
        connection.row_factory = sqlite3.Row
        query = "SELECT p.name AS planner, r.* FROM runs r JOIN plannerConfigs p ON p.id = r.plannerid"
        words = {row["value"]: row["description"] for row in connection.execute("SELECT * FROM enums")}
        return [{**dict(row), "status": words[row["status"]]} for row in connection.execute(query)]


def test_measurements_reach_the_database(setup, tmp_path):
    benchmark = Benchmark(setup, "planar arm")
    benchmark.addPlanner("SafePRM")
    benchmark.addPlannerAllocator(lambda si: SafeRRTConnect(si, "eager", alpha=2.0))
    benchmark.addPlanner(og.RRTConnect(setup.getSpaceInformation()))
    benchmark.addPlanner("RRTConnect")
    benchmark.benchmark(request(simplify=True), seed=3, workers=1)
    runs = runs_of(benchmark, tmp_path)
    names = ["SafePRM", "eager", "RRTConnect", "RRTConnect 2"]
    assert [(run["planner"], run["seed"]) for run in runs] == [(name, seed) for name in names for seed in (3, 4)]
    for run in runs:
        assert (run["solved"], run["status"], run["certified"]) == (1, "Exact solution", 1)
        assert 0 < run["danger_mean"] < run["danger_max"]
        assert 0 < run["danger_integral"] > run["danger_avoidable"]
        assert 0 < run["clearance_min"] < run["clearance_mean"]
        assert run["time"] > 0
        assert run["simplification_time"] > 0
        assert run["bound_queries"] > 0
    first, again = (setup.plan("SafePRM", time=20.0, seed=3, simplify=True) for _ in range(2))
    assert first.report.length == again.report.length == runs[0]["solution_length"]
    runs_of(benchmark, tmp_path)
    with sqlite3.connect(tmp_path / "b.db") as connection:
        rows = list(connection.execute("SELECT name, timelimit, runcount FROM experiments"))
        settings = dict(connection.execute("SELECT name, settings FROM plannerConfigs"))
    assert rows == [("planar_arm", 20.0, 2)] * 2, "a second log adds to the database"
    for planner, lines in {"eager": ["alpha = 2.0", "slide = 0.8"], "RRTConnect": ["intermediate_states = 0"]}.items():
        assert set(lines) < {line.strip(";") for line in settings[planner].splitlines()}


@pytest.mark.parametrize("workers", [1, 2])
def test_an_exception_is_a_crash_of_its_run_only(tmp_path, workers, setup):
    class Doubtful(SafeRRTConnect):
        def _search(self, ptc):
            if self.getSeed() == 1:
                raise RuntimeError("no; not\nthis one")
            return super()._search(ptc)

    benchmark = Benchmark(setup, "doubt")
    benchmark.addPlannerAllocator(Doubtful)
    benchmark.benchmark(request(runCount=3), workers=workers)
    runs = runs_of(benchmark, tmp_path)
    assert [run["status"] for run in runs] == ["Exact solution", "Crash", "Exact solution"]
    assert [run["error"] for run in runs] == [None, "no not this one", None]
    assert runs[1]["danger_mean"] is None


@pytest.mark.parametrize("workers", [1, 2])
def test_ctrl_c_keeps_what_was_done(setup, tmp_path, monkeypatch, workers):
    benchmark, done = Benchmark(setup, "interrupted"), iter(range(100))
    benchmark.addPlanner("SafeRRTConnect")

    def measured(result):
        if next(done) == 4:
            raise KeyboardInterrupt
        return {"status": result.status, "solved": result.solved}

    monkeypatch.setattr("safe_ompl.apps.benchmark.benchmark.run_measures", measured)
    with pytest.raises(KeyboardInterrupt):
        benchmark.benchmark(request(runCount=50), workers=workers)
    assert [run["solved"] for run in runs_of(benchmark, tmp_path)] == [1] * 4
    assert setup.plan("SafeRRTConnect")


def test_bad_benchmarks_are_refused(setup):
    for given in ("planar3", og.SimpleSetup(setup.getSpaceInformation())):
        with pytest.raises(InputError, match="must be a SafeSetup"):
            Benchmark(given)
    benchmark = Benchmark(setup)
    with pytest.raises(InputError, match="planner"):
        benchmark.benchmark(request())
    for wrong in ("Fly", 3):
        with pytest.raises(InputError, match=str(wrong)):
            benchmark.addPlanner(wrong)
    benchmark.addPlanner("RRT")
    with pytest.raises(InputError, match="workers"):
        benchmark.benchmark(request(), workers=0)
    with pytest.raises(InputError, match="runCount"):
        benchmark.benchmark(request(runCount=0))
