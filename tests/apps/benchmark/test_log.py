"""Benchmark logs: what OMPL's own reader finds in them."""

import sqlite3

import pytest

from safe_ompl import InputError, Scenario
from safe_ompl.apps.benchmark import failure
from safe_ompl.apps.benchmark.log import Experiment, PlannerRuns, save_database
from safe_ompl.apps.benchmark.measures import run_measures
from safe_ompl.planning import setup_scenario
from safe_ompl.scene import find_scenario


def rows(database, table):
    with sqlite3.connect(database) as connection:
        connection.row_factory = sqlite3.Row
        return [dict(row) for row in connection.execute(f"SELECT * FROM {table}")]


def write_log(results, file, settings=None, **about):
    """Write the results of runs of any planners, in any order."""
    planners = {}
    for result in results:
        own = (settings or {}).get(result.planner, {})
        planner = planners.setdefault(result.planner, PlannerRuns(result.planner, own))
        planner.runs.append(run_measures(result))
    most = max((len(planner.runs) for planner in planners.values()), default=0)
    seed = min((result.seed for result in results), default=0)
    Experiment(planners=list(planners.values()), run_count=most, seed=seed, **about).save(file)


@pytest.fixture(scope="module")
def results():
    setup = setup_scenario(Scenario.load(find_scenario("planar3")))
    found = [setup.plan(name, seed=seed) for seed in (3, 4) for name in ("SafePRM", "RRTConnect")]
    names = setup.robot.joint_names
    return [*found, failure("Error: odd; very\nodd", "SafePRM", 5, names), failure("Timeout", "RRT", 3, names)]


def test_results_reach_the_database(results, tmp_path):
    log, database = tmp_path / "runs.log", tmp_path / "runs.db"
    write_log(
        results,
        log,
        name="three planners",
        setup="A planar arm\nof three links",
        time_limit=5.0,
        settings={"SafePRM": {"alpha": 5.0}},
        parameters={"obstacles": 3, "arm": "planar, 3 joints"},
    )
    save_database([log], database)
    (experiment,) = rows(database, "experiments")
    assert (experiment["name"], experiment["timelimit"]) == ("three_planners", 5.0)
    assert (experiment["runcount"], experiment["seed"]) == (3, "3")
    assert experiment["setup"] == "A planar arm\nof three links\n"
    assert (experiment["obstacles"], experiment["arm"]) == (3, "planar 3 joints")
    planners = rows(database, "plannerConfigs")
    assert [planner["name"] for planner in planners] == ["SafePRM", "RRTConnect", "RRT"]
    assert planners[0]["settings"].split() == ["alpha", "=", "5.0", ";"]
    runs = rows(database, "runs")
    ordered = sorted(results, key=lambda result: ["SafePRM", "RRTConnect", "RRT"].index(result.planner))
    assert [run["seed"] for run in runs] == [result.seed for result in ordered]
    for run, result in zip(runs, ordered, strict=True):
        assert run["solved"] == result.solved
        assert run["time"] == result.planning_time
        assert run["graph_states"] == result.counts.nodes
        assert run["margin_queries"] == result.counts.margin_queries
        assert run["bound_queries"] == result.counts.bound_queries
        if result.report is None:
            assert run["solution_length"] is run["danger_mean"] is None
        else:
            assert run["solution_length"] == result.report.length
            assert run["solution_segments"] == len(result.path) - 1
            assert run["danger_integral"] == result.report.danger.integral
            assert run["danger_avoidable"] == result.report.danger.avoidable
            assert run["clearance_min"] == result.report.clearance.min
            assert run["certified"] == 1
    words = {row["value"]: row["description"] for row in rows(database, "enums")}
    assert [words[run["status"]] for run in runs] == [
        *("Exact solution", "Exact solution", "Crash"),
        *("Exact solution", "Exact solution"),
        "Timeout",
    ]


def test_progress_reaches_the_database(tmp_path):
    samples = [(0.1, 3.0), (0.2, 2.5), (0.2, 2.25)]
    planner = PlannerRuns("Fast", {}, [{"time": 0.3}, {"time": 0.1}], ("best cost",), [samples, [(0.05, 1.0)]])
    Experiment("curves", [planner], run_count=2).save(tmp_path / "runs.log")
    save_database([tmp_path / "runs.log"], tmp_path / "runs.db")
    found = [(row["runid"], row["time"], row["best_cost"]) for row in rows(tmp_path / "runs.db", "progress")]
    assert found == [(1, 0.1, 3.0), (1, 0.2, 2.25), (2, 0.05, 1.0)], "of two at one time the later counts"


def test_a_second_log_adds_to_the_database(results, tmp_path):
    for name in ("a", "b"):
        write_log(results, tmp_path / name, name=name)
    save_database([tmp_path / "a"], tmp_path / "runs.db")
    save_database([tmp_path / "b"], tmp_path / "runs.db")
    assert [row["name"] for row in rows(tmp_path / "runs.db", "experiments")] == ["a", "b"]
    assert len(rows(tmp_path / "runs.db", "runs")) == 2 * len(results)


def test_no_runs(tmp_path):
    write_log([], tmp_path / "runs.log", name="")
    save_database([tmp_path / "runs.log"], tmp_path / "runs.db")
    assert [row["name"] for row in rows(tmp_path / "runs.db", "experiments")] == ["NO_NAME"]
    assert rows(tmp_path / "runs.db", "runs") == []


@pytest.mark.parametrize("name", ["best-cost", "3rd", "two  blanks", ""])
def test_names_that_cannot_be_columns_are_refused(name):
    with pytest.raises(InputError, match="words"):
        Experiment("e", [PlannerRuns("p", runs=[{name: 1.0}])]).text()
