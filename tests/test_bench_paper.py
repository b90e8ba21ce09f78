"""The studies of the paper: from runs to tables, claims and the report; and that they go on where they stopped."""

from __future__ import annotations

import json
import sqlite3
import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parents[1] / "bench"))

import paper
from _paper import effort
from _paper import sweep as sweeping
from _paper.claims import CLAIMS, Claim
from _paper.dependence import Point, plot_dependence
from _paper.evidence import Evidence
from _paper.runs import campaigns, study_scenario
from _paper.store import Store, read_result
from _paper.studies import PAIRS, STUDIES, Pair, chosen_pairs
from _paper.tables import effort_table, markdown_table, ratio_table

from safe_ompl.campaign import Run, failure
from safe_ompl.errors import InputError, UnknownNameError
from safe_ompl.models.counts import Counts
from safe_ompl.models.scenario import Scenario, find_scenario
from safe_ompl.paths.report import ClearanceReport, DangerReport, PathReport
from safe_ompl.planners.registry import planner_names
from safe_ompl.setup import PlanResult, plan

PAIR = Pair("RRT-Connect", "SafeRRTConnect", "ClassicRRTConnect")


def result(
    planner: str, seed: int, danger: float, time: float, nodes: int = 10, checks: int = 100
) -> PlanResult:
    """Return a result with a constant danger profile."""
    report = PathReport(
        length=2.0,
        danger=DangerReport(
            profile=np.full(101, danger),
            mean=danger,
            max=danger,
            max_bound=danger,
            integral=2 * danger,
            avoidable=0.0,
        ),
        clearance=ClearanceReport(0.1, 0.2, 0.0, "link", "box", 0.5),
        certified=True,
    )
    counts = Counts(nodes=nodes, collision_queries=checks // 2, margin_queries=checks - checks // 2)
    return PlanResult("Exact solution", np.zeros((2, 6)), report, planner, seed, (), time, counts=counts)


@pytest.fixture
def evidence() -> Evidence:
    """Return a study in which safe paths are half as dangerous, for half the nodes and twice the time."""
    results = [result("ClassicRRTConnect", k, 8.0 + k, 0.01, nodes=20) for k in range(5)]
    results += [result("SafeRRTConnect", k, 4.0 + k / 2, 0.02, nodes=10) for k in range(5)]
    results.append(failure("Timeout", "SafeRRTConnect", 5, ()))
    return Evidence.of(STUDIES[0], PAIRS, results)


# -------------------------------------------------------------------------------------- tables and claims


def test_means_and_ratios(evidence: Evidence) -> None:
    assert [pair.label for pair in evidence.pairs] == ["RRT-Connect"]
    assert evidence.effort("ClassicRRTConnect")[:3] == pytest.approx((0.01, 20, 100))
    assert evidence.effort_ratio(PAIR)[:3] == pytest.approx((2.0, 0.5, 1.0))
    assert evidence.printed_ratio(PAIR)[:3] == pytest.approx((1.1795, 0.6786, 1.0557), abs=1e-4)
    assert evidence.danger_ratio(PAIR) == pytest.approx(0.5)
    low, high = evidence.danger_ratio_band(PAIR)
    assert 4 / 12 < low < 0.5 < high < 6 / 8
    assert evidence.band_width("SafeRRTConnect") == pytest.approx(
        evidence.band_width("ClassicRRTConnect") / 2
    )


def test_tables_show_ours_beside_the_paper(evidence: Evidence) -> None:
    assert "| SafeRRTConnect | 5/6 | 20.0 | 10 | 100 | – | 5.00 |" in effort_table(evidence)
    assert "| RRT-Connect | 2.00 (1.18) | 0.50 (0.68) | 1.00 (1.06) | 0.50 |" in ratio_table(evidence)


def test_tables_have_as_many_columns_in_every_line() -> None:
    lines = markdown_table(("a", "b"), [("1", "2"), ("3", "4")]).splitlines()
    assert {line.count("|") for line in lines} == {3}


def verdict_on(place: str, evidence: Evidence) -> str:
    (claim,) = [claim for claim in CLAIMS if claim.place == place]
    return claim.verdict([evidence])[0]


def test_claims_are_confirmed_or_refuted_by_the_numbers(evidence: Evidence) -> None:
    assert verdict_on("Figs. 7, 11", evidence) == "confirmed"
    assert verdict_on("Figs. 8, 12", evidence) == "confirmed"
    assert verdict_on("Fig. 9", evidence) == "refuted"  # twice the time
    assert verdict_on("Figs. 7, 11; §5.1", evidence) == "not measured"  # no bubbles here
    assert verdict_on("Fig. 13, Table II", evidence) == "not measured"  # of study 2


def test_a_claim_that_holds_here_and_not_there_is_true_in_part(evidence: Evidence) -> None:
    worse = [result("ClassicRRTConnect", 0, 4.0, 0.01), result("SafeRRTConnect", 0, 5.0, 0.01)]
    claim: Claim = CLAIMS[0]
    verdict, findings = claim.verdict([evidence, Evidence.of(STUDIES[1], PAIRS, worse)])
    assert verdict == "in part (1 of 2)"
    assert [finding.number for finding in findings] == ["mean danger × 0.50", "mean danger × 1.25"]


def test_pairs_are_those_that_exist() -> None:
    for pair in chosen_pairs():
        assert set(pair.planners) <= set(planner_names())
    assert chosen_pairs(["ClassicPRM"]) == tuple(pair for pair in PAIRS if pair.label == "PRM")


# -------------------------------------------------------------------------------------------------- results


@pytest.fixture(scope="module")
def scenario() -> Scenario:
    return Scenario.load(find_scenario("planar2"))


def test_results_come_back_as_they_were(scenario: Scenario, tmp_path: Path) -> None:
    results = [plan(scenario, seed=3), failure("Timeout", "SafePRM", 4, ("a",))]
    store = Store(tmp_path, scenario)
    for one in results:
        store.add(one)
    back = Store(tmp_path, scenario).results()
    assert [one.as_dict() for one in back] == [json.loads(json.dumps(one.as_dict())) for one in results]
    assert store.done() == {Run("SafeRRTConnect", 3), Run("SafePRM", 4)}
    assert read_result(results[0].as_dict()).report is not None


def test_a_line_that_was_cut_off_is_done_again(scenario: Scenario, tmp_path: Path) -> None:
    store = Store(tmp_path, scenario)
    store.add(failure("Timeout", "SafePRM", 4, ()))
    with store.file.open("a") as stream:
        stream.write('{"planner": "SafePR')
    assert Store(tmp_path, scenario).done() == {Run("SafePRM", 4)}
    Store(tmp_path, scenario).add(failure("Timeout", "SafePRM", 5, ()))
    assert len(store.results()) == 2


def test_runs_of_another_scenario_are_not_mixed_in(scenario: Scenario, tmp_path: Path) -> None:
    Store(tmp_path, scenario)
    with pytest.raises(InputError, match="another form of 'paper_1'"):
        Store(tmp_path, study_scenario(STUDIES[0]))


def test_deterministic_planners_run_once(scenario: Scenario, tmp_path: Path) -> None:
    pairs = (Pair("Bubbles", "SafePRM", "ClassicPRM", deterministic=True), PAIR)
    store = Store(tmp_path, scenario)
    todo = campaigns(scenario, pairs, 7, store)
    assert [(list(campaign.planners), campaign.runs) for campaign in todo] == [
        (["ClassicPRM", "SafePRM"], 1),
        (["ClassicRRTConnect", "SafeRRTConnect"], 7),
    ]


def test_finer_samples_of_the_edges_are_more_checks(
    scenario: Scenario, monkeypatch: pytest.MonkeyPatch
) -> None:
    nodes, checks = effort.sampled_checks(scenario, effort.MEASURE, 3)
    assert checks > 4 * nodes
    monkeypatch.setattr(effort, "STEP", effort.STEP / 10)
    assert effort.sampled_checks(scenario, effort.MEASURE, 3)[1] > 5 * checks


# ---------------------------------------------------------------------------------------------- end to end


@pytest.fixture
def undrawn(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(paper, "draw_study", lambda *_: None)
    monkeypatch.setattr(paper, "draw_ideas", lambda _: {"field.png": "After Fig. 3"})
    monkeypatch.setattr(paper, "HARDNESS_RUNS", 1)


@pytest.mark.usefixtures("undrawn")
def test_two_runs_of_two_planners(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    command = ["--runs", "2", "--out", str(tmp_path), "--planners", "SafeRRTConnect", "--processes", "1"]
    paper.main(command)
    report = (tmp_path / "report.md").read_text()
    assert report.count("| SafeRRTConnect | 2/2 |") == 2
    assert "study_2/profiles.png" in report
    lines = (tmp_path / "study_1" / "runs.jsonl").read_text().splitlines()
    runs = [(line["planner"], line["seed"]) for line in map(json.loads, lines)]
    assert runs == [(name, k) for k in range(2) for name in PAIR.planners]
    counts = [json.loads(line)["counts"] for line in lines]
    assert [count["field_configurations"] > 0 for count in counts] == 2 * [False, True]
    with sqlite3.connect(tmp_path / "benchmark.db") as database:
        assert database.execute("select count(*) from runs").fetchone() == (8,)

    paper.main([*command[:1], "3", *command[2:]])  # goes on where it stopped
    more = (tmp_path / "study_1" / "runs.jsonl").read_text().splitlines()
    assert more[:4] == lines
    assert len(more) == 6
    assert "report.md" in capsys.readouterr().err


def test_planners_that_do_not_exist_are_named(tmp_path: Path) -> None:
    with pytest.raises(UnknownNameError, match="'SafeRRT'; known: ClassicBubble"):
        paper.main(["--out", str(tmp_path), "--planners", "SafeRRT"])


# --------------------------------------------------------------------------------------------------- sweeps


def test_a_sweep_tries_one_parameter_at_a_time(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    chosen = (
        sweeping.Parameter("slide", (0.0, 0.8), "slide"),
        sweeping.Parameter("goal_bias", (0.5,), "not of this planner"),
        sweeping.Parameter(sweeping.RANGE, (0.5,), "range"),
        sweeping.Parameter("weighting", ("length",), "weighting", of_field=True),
    )
    monkeypatch.setattr(sweeping, "PARAMETERS", chosen)
    monkeypatch.setattr(sweeping, "list_scenarios", lambda: {"planar2": find_scenario("planar2")})
    seen: list[Point] = []
    monkeypatch.setattr(sweeping, "plot_dependence", lambda points, labels, file: seen.extend(points))
    page = sweeping.sweep(tmp_path, (PAIR,), 2, 1)
    tried = [("slide", 0.0), ("slide", 0.8), ("range", 0.5), ("weighting", "length")]
    assert [(p.parameter, p.value) for p in seen] == tried
    assert all(point.solved == 1.0 and 0.2 < point.danger_ratio < 2.0 for point in seen)
    assert "| slide = 0.8 |" in page.read_text()
    folders = {folder.name for folder in (tmp_path / "sweep" / "planar2").iterdir()}
    assert folders == {"ClassicRRTConnect", *(f"SafeRRTConnect_{name}={value}" for name, value in tried)}


def test_the_picture_of_a_sweep(tmp_path: Path) -> None:
    points = [
        Point(name, "SafePRM", "alpha", value, 1.0 - value / 10, 1.0, 0.01)
        for name in ("a", "b")
        for value in (0.0, 1.0, 5.0)
    ]
    figure = plot_dependence(points, {"alpha": "weight"}, tmp_path / "sweep.png")
    assert [line.get_ydata()[-1] for line in figure.axes[0].lines[:2]] == [0.5, 0.5]
    assert (tmp_path / "sweep.png").is_file()
