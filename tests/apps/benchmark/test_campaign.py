"""Campaigns: who runs when, with which seed, and what the summary says."""

import dataclasses

import numpy as np
import pytest

from safe_ompl import InputError, Obstacle, PlanningError, Pose, Scenario, Scene, Sphere, UnknownNameError
from safe_ompl.apps.benchmark import Campaign, Summary, check_named_planner, default_planners, failure, summarize
from safe_ompl.apps.benchmark.campaign import BAND
from safe_ompl.apps.benchmark.runs import Run
from safe_ompl.planning import SafeSetup, setup_scenario
from safe_ompl.planning.planners import is_ours, planner_names
from safe_ompl.robot import RobotSpec
from safe_ompl.scene.scenario import Goal

PLANNERS = ("RRTConnect", "SafeRRTConnect")


@pytest.fixture(scope="module")
def scenario():
    """Return a UR5 that reaches around a ball."""
    ball = Obstacle("ball", Sphere(0.15), Pose((0.55, 0.0, 0.4)), weight=1.0)
    return Scenario(
        name="ball",
        robot=RobotSpec("ur5"),
        scene=Scene((ball,)),
        start=(1.0, -1.0, 1.2, -1.6, -1.57, 0.0),
        goal=Goal(((-1.0, -1.0, 1.2, -1.6, -1.57, 0.0),)),
        time=5.0,
    )


@pytest.fixture(scope="module")
def setup(scenario):
    return setup_scenario(scenario)


@pytest.fixture(scope="module")
def results(scenario, setup):
    return list(Campaign(scenario, PLANNERS, runs=5, seed=10).results(setup))


def test_planners_take_turns_with_the_same_seeds(results):
    runs = [Run(result.planner, result.seed) for result in results]
    assert runs == [Run(planner, seed) for seed in range(10, 15) for planner in PLANNERS]
    assert all(results)


def test_processes_do_not_change_the_paths(scenario, results):
    campaign = Campaign(scenario, PLANNERS, runs=5, seed=10)
    parallel = list(campaign.results(processes=2))
    assert [(r.planner, r.seed) for r in parallel] == [(r.planner, r.seed) for r in results]
    for one, other in zip(parallel, results, strict=True):
        np.testing.assert_array_equal(one.path, other.path)


@pytest.mark.parametrize("processes", [1, 2])
def test_runs_that_are_done_are_left_out(scenario, setup, processes):
    done = {Run("RRTConnect", 0), Run("SafeRRTConnect", 1), Run("RRTConnect", 2)}
    campaign = Campaign(scenario, PLANNERS, runs=3, done=done)
    runs = [(result.planner, result.seed) for result in campaign.results(setup, processes)]
    assert runs == [("SafeRRTConnect", 0), ("RRTConnect", 1), ("SafeRRTConnect", 2)]
    assert len(campaign) == 3


@pytest.mark.parametrize("processes", [1, 2])
def test_an_exception_of_a_run_arrives_unchanged(scenario, setup, monkeypatch, processes):
    def confused(self, run, setup):
        raise UnknownNameError("joint", "knee", setup.robot.joint_names)

    monkeypatch.setattr(Campaign, "result", confused)
    with pytest.raises(UnknownNameError, match=r"'knee'.*elbow_joint"):
        list(Campaign(scenario, PLANNERS, runs=2).results(setup, processes))


@pytest.mark.parametrize("processes", [1, 2])
def test_what_is_logged_in_a_process_is_logged_here(scenario, setup, monkeypatch, caplog, processes):
    def refuse(self, planner, **options):
        raise PlanningError(f"{planner}: edge 3 is not proven free")

    monkeypatch.setattr(SafeSetup, "plan", refuse)
    failed = list(Campaign(scenario, PLANNERS, runs=1).results(setup, processes))
    assert [result.status for result in failed] == [
        f"Error: {planner}: edge 3 is not proven free" for planner in PLANNERS
    ]
    assert sorted(record.getMessage() for record in caplog.records) == [
        f"{planner}, seed 0: {planner}: edge 3 is not proven free" for planner in PLANNERS
    ]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"planners": ()}, "at least one"),
        ({"planners": ("RRT", "RRT")}, "twice"),
        ({"planners": PLANNERS, "runs": 0}, "runs"),
        ({"planners": PLANNERS, "runs": 1.5}, "runs"),
    ],
)
def test_bad_campaigns_are_refused(scenario, arguments, message):
    with pytest.raises(InputError, match=message):
        Campaign(scenario, **arguments)


def test_bad_planners_and_processes_are_refused_before_any_run(scenario, setup):
    with pytest.raises(UnknownNameError, match="'Fly'"):
        Campaign(scenario, ("RRTConnect", "Fly")).results(setup)
    with pytest.raises(InputError, match="processes"):
        Campaign(scenario, PLANNERS).results(setup, processes=0)
    wrong = dataclasses.replace(scenario, planners={"SafeRRTConnect": {"alfa": 1.0}})
    with pytest.raises(UnknownNameError, match=r"ball: planners: .*'alfa'"):
        check_named_planner(wrong, "SafeRRTConnect", setup)


def test_default_planners_are_rrt_connect_and_all_of_ours_that_fit_the_goal(scenario):
    ours = [name for name in planner_names() if is_ours(name)]
    both = dataclasses.replace(scenario.goal, position=(0.3, 0.0, 0.4))
    assert default_planners(dataclasses.replace(scenario, goal=both)) == ("RRTConnect", *ours)
    configurations = dataclasses.replace(scenario.goal, position=None)
    fitting = [name for name in ours if "JTRRT" not in name]
    assert default_planners(dataclasses.replace(scenario, goal=configurations)) == ("RRTConnect", *fitting)


def test_summaries(results):
    summaries = summarize([*results, failure("Timeout", "RRTConnect", 99, results[0].joint_names)])
    assert [(s.planner, s.runs, s.solved) for s in summaries] == [("RRTConnect", 6, 5), ("SafeRRTConnect", 5, 5)]
    mine = [result for result in results if result.planner == "SafeRRTConnect"]
    summary = summaries[1]
    lengths = [result.report.length for result in mine if result.report]
    dangers = [result.report.danger.mean for result in mine if result.report and result.report.danger]
    assert summary.median("length") == pytest.approx(np.median(lengths))
    assert summary.percentile("length", 85) == pytest.approx(np.percentile(lengths, 85))
    assert summary.profiles.shape == (5, 101)
    assert summary.typical is mine[int(np.argsort(dangers)[2])]
    for result, queries in zip(mine, summary.metrics["queries"], strict=True):
        assert queries == result.counts.queries


def test_summary_as_plain_data(results):
    data = summarize(results)[0].as_dict()
    assert list(data)[:4] == ["planner", "runs", "solved", "typical_seed"]
    metrics = [data[key] for key in list(data)[4:]]
    assert all(list(metric) == ["median", "p15", "p85"] for metric in metrics)
    assert all(metric["p15"] <= metric["median"] <= metric["p85"] for metric in metrics)
    assert BAND == (15, 85)


def test_summary_of_nothing_solved():
    summary = Summary.of("RRT", [failure("Timeout", "RRT", 0, ("a",))])
    assert (summary.solved, summary.typical) == (0, None)
    assert np.isnan(summary.median("length"))
    assert summary.profiles.size == 0
