"""The studies of the paper: from runs to tables, claims and the report; and that they go on where they stopped."""

from __future__ import annotations

import json
import sqlite3
import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parents[2] / "bench"))

import paper
from _paper import effort, smoothing
from _paper import sweep as sweeping
from _paper.claims import CLAIMS, Claim
from _paper.dependence import Point, plot_dependence
from _paper.evidence import Evidence
from _paper.random_scenes import OMPLS, RandomStudy, random_scenarios, scene_campaigns
from _paper.report import claims_section
from _paper.runs import campaigns, study_scenario
from _paper.smoothed import MEAN, Ratio, Smoothed, answer
from _paper.smoothed_page import plot_smoothing, smoothing_section, smoothing_table
from _paper.smoothing import ShorteningCampaign, Smoothing
from _paper.store import Store, read_result
from _paper.studies import PAIRS, STUDIES, Pair, chosen_pairs, with_crossed
from _paper.tables import effort_table, ratio_table

from safe_ompl import InputError, PathReport, PlanResult, Scenario, UnknownNameError, plan
from safe_ompl.apps.benchmark import Campaign, failure
from safe_ompl.apps.benchmark.runs import Run
from safe_ompl.common import Counts
from safe_ompl.paths import ClearanceReport, DangerReport
from safe_ompl.scene import find_scenario

PAIR = Pair("RRT-Connect", "SafeRRTConnect", "ClassicRRTConnect")


def result(planner, seed, danger, time, nodes=10, checks=100):
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
def evidence():
    """Return a study in which safe paths are half as dangerous, for half the nodes and twice the time."""
    results = [result("ClassicRRTConnect", k, 8.0 + k, 0.01, nodes=20) for k in range(5)]
    results += [result("SafeRRTConnect", k, 4.0 + k / 2, 0.02, nodes=10) for k in range(5)]
    results.append(failure("Timeout", "SafeRRTConnect", 5, ()))
    return Evidence.of(STUDIES[0], PAIRS, results)


# -------------------------------------------------------------------------------------- tables and claims


def test_means_and_ratios(evidence):
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


def test_tables_show_ours_beside_the_paper(evidence):
    assert "| SafeRRTConnect | 5/6 | 20.0 | 10 | 100 | – | 5.00 |" in effort_table(evidence)
    assert "| RRT-Connect ours | 2.00 (1.18) | 0.50 (0.68) | 1.00 (1.06) | 0.50 |" in ratio_table(evidence)


def verdict_on(place, evidence):
    (claim,) = [claim for claim in CLAIMS if claim.place == place]
    return claim.verdict([evidence], as_printed=False)[0]


def test_claims_are_confirmed_or_refuted_by_the_numbers(evidence):
    assert verdict_on("Figs. 7, 11", evidence) == "confirmed"
    assert verdict_on("Figs. 8, 12", evidence) == "confirmed"
    assert verdict_on("Fig. 9", evidence) == "refuted"  # twice the time
    assert verdict_on("Figs. 7, 11; §5.1", evidence) == "not measured"  # no bubbles here
    assert verdict_on("Fig. 13, Table II", evidence) == "not measured"  # of study 2


def test_a_claim_that_holds_here_and_not_there_is_true_in_part(evidence):
    worse = [result("ClassicRRTConnect", 0, 4.0, 0.01), result("SafeRRTConnect", 0, 5.0, 0.01)]
    claim: Claim = CLAIMS[0]
    verdict, findings = claim.verdict([evidence, Evidence.of(STUDIES[1], PAIRS, worse)], as_printed=False)
    assert verdict == "in part (1 of 2)"
    assert [finding.number for finding in findings] == ["mean danger × 0.50", "mean danger × 1.25"]


def test_every_family_is_there_as_printed_and_in_our_form():
    printed, ours = ([pair.label for pair in PAIRS if pair.as_printed is form] for form in (True, False))
    assert printed == ours == ["Bubbles", "PRM", "RRT-Connect", "JT-RRT"]
    assert all(name.startswith("Paper") == pair.as_printed for pair in PAIRS for name in pair.planners)


def test_our_safe_planners_are_also_compared_with_classical_ones_as_printed():
    (crossed,) = (pair for pair in with_crossed(chosen_pairs(["SafePRM", "PaperPRM"])) if pair.against_print)
    assert (crossed.safe, crossed.classic, crossed.title) == ("SafePRM", "PaperPRM", "PRM ours / printed")
    assert with_crossed([PAIR]) == [PAIR]


def test_the_forms_have_verdicts_of_their_own(evidence):
    printed = [result("PaperRRTConnect", k, 4.0, 0.01) for k in range(3)]
    printed += [result("PaperSafeRRTConnect", k, 5.0, 0.01) for k in range(3)]
    results = [*printed, *(one for own in evidence.results.values() for one in own)]
    both = Evidence.of(STUDIES[0], PAIRS, results)
    claim: Claim = CLAIMS[0]
    assert [claim.verdict([both], as_printed=form)[0] for form in (True, False)] == ["refuted", "confirmed"]
    assert "**as printed: refuted; ours: confirmed**" in claims_section([both])


# ------------------------------------------------------------------------------------------------ smoothing


def smoothed(classic, safe, shortened=16.0):
    """Return ten runs with these mean dangers, give or take 1 %, as planned and simplified."""

    def runs(planner, danger):
        return [result(planner, k, danger * (1.0 + 0.01 * (-1) ** k), 0.01) for k in range(10)]

    planned, simplified = (
        [*runs(PAIR.classic, c), *runs(PAIR.safe, s)] for c, s in zip(classic, safe, strict=True)
    )
    results = {
        Smoothing.PLANNED: [*planned, result(PAIR.safe, 10, 99.0, 1.0)],  # has not been smoothed
        Smoothing.SHORTENED: runs(PAIR.classic, shortened),
        Smoothing.SIMPLIFIED: simplified,
    }
    return Smoothed.of(STUDIES[0], PAIRS, results)


def test_the_same_runs_are_compared_before_and_after():
    study = smoothed(classic=(8.0, 5.0), safe=(4.0, 4.0))
    assert study.pairs == (PAIR,)
    assert study.mean(MEAN, PAIR.safe, Smoothing.PLANNED) == pytest.approx(4.0)
    assert study.danger_ratio(PAIR, Smoothing.PLANNED).value == pytest.approx(0.5)
    rows = smoothing_table(study).splitlines()
    assert "| ClassicRRTConnect | 10/10 | 8.00 → 5.00 | 8.00 → 5.00 | 16.0 → 10.0 | 0.00 → 0.00 |" in rows[2]
    assert "| – with OMPL's simplifier | 10/10 | 16.00 |" in rows[3]
    assert (
        "| **RRT-Connect ours, safe / classic** |  | 0.50 → 0.80 | 0.50 → 0.80 | 0.50 → 0.80 | – → – |"
        in rows[5]
    )
    assert len({row.count("|") for row in rows}) == 1


@pytest.mark.parametrize(
    ("classic", "safe", "words"),
    [
        ((8.0, 5.0), (4.0, 4.9), "Yes; the gap closes (4 % of it is left)"),
        ((8.0, 5.0), (4.0, 4.5), "Yes; the gap nearly closes (20 % of it is left)"),
        ((8.0, 8.0), (4.0, 4.0), "Yes; the gap stays as it was (100 % of it is left)"),
        ((8.0, 8.0), (4.0, 1.0), "Yes; the gap widens (175 % of it is left)"),
        ((8.0, 5.0), (4.0, 5.0), "No difference beyond chance; the gap closes (0 % of it is left)"),
        ((8.0, 5.0), (9.0, 6.0), "No: after"),  # there was none
    ],
)
def test_the_answer_follows_from_the_numbers(classic, safe, words):
    assert answer([smoothed(classic, safe)]).startswith(f"**{words}")


def test_the_answer_says_what_is_left():
    words = answer([smoothed((8.0, 5.0), (4.0, 4.5)), smoothed((8.0, 4.0), (5.0, 5.0), shortened=12.0)])
    assert (
        "**In part; the gap narrows" not in words
    )  # it has turned over in one of two: −50 % and 20 % are left
    assert words.startswith("**In part; the gap closes (-23 % of it is left)")
    assert "is 0.90–1.25 × that of their classical counterparts', as planned it is 0.50–0.62 ×.**" in words
    assert "lower in 1 of 2 comparisons, higher in 1." in words
    assert "OMPL's simplifier, as is usual, makes their mean danger 1.50–2.00 × what it was" in words
    assert "danger-aware simplification 0.50–0.62 ×. That is 0.80–1.25 × what safe" in words
    assert "peak 0.90–1.25 (0.50–0.62), integral 0.90–1.25 (0.50–0.62), min clearance 1.00 (1.00)" in words
    assert "Avoidable danger, simplified: 0.00 against 0.00; every run solved." in words


def test_ratios_know_what_chance_can_do():
    rng = np.random.default_rng(0)
    samples = rng.normal([3.0, 4.0], [0.6, 0.8], (400, 50, 2))
    ratios = [Ratio.of(*sample.T) for sample in samples]
    assert 0.92 < np.mean([ratio.low < 0.75 < ratio.high for ratio in ratios]) < 0.98
    assert Ratio.of(np.array([1.0]), np.array([2.0])) == (0.5, 0.0, np.inf)
    assert Ratio.of(np.array([1.0]), np.array([2.0]), exact=True) == (0.5, 0.5, 0.5)


def test_the_answer_is_given_for_each_form():
    section = smoothing_section([smoothed((8.0, 5.0), (4.0, 4.5))])
    printed, ours = section.split("### Ours")
    assert "### Planners as printed\n\nNot measured" in printed
    assert "**Yes; the gap nearly closes" in ours


def test_nothing_is_said_where_nothing_was_solved():
    results = {kind: [failure("Timeout", name, 0, ()) for name in PAIR.planners] for kind in Smoothing}
    assert answer([Smoothed.of(STUDIES[0], PAIRS, results)]).startswith("Not measured")


def test_the_picture_of_smoothing(tmp_path):
    studies = [smoothed((8.0, 5.0), (4.0, 4.5)), smoothed((8.0, 4.0), (5.0, 5.0))]
    figure = plot_smoothing(studies, tmp_path / "smoothing.png")
    assert [axes.get_title("left") for axes in figure.axes] == ["RRT-Connect ours", ""]
    ends = [line.get_ydata()[-1] for line in figure.axes[0].lines]
    assert ends == pytest.approx([8.0, 16.0, 5.0, 4.0, 4.5])
    assert [text.get_text() for text in figure.axes[1].texts] == ["× 0.62", "× 1.25"]
    assert (tmp_path / "smoothing.png").is_file()


# -------------------------------------------------------------------------------------------------- results


@pytest.fixture(scope="module")
def scenario():
    return Scenario.load(find_scenario("planar2"))


def test_results_come_back_as_they_were(scenario, tmp_path):
    results = [plan(scenario, seed=3), failure("Timeout", "SafePRM", 4, ("a",))]
    store = Store(tmp_path, scenario)
    for one in results:
        store.add(one)
    back = Store(tmp_path, scenario).results()
    assert [one.as_dict() for one in back] == [json.loads(json.dumps(one.as_dict())) for one in results]
    assert store.done() == {Run("SafeRRTConnect", 3), Run("SafePRM", 4)}
    assert read_result(results[0].as_dict()).report is not None


def test_a_line_that_was_cut_off_is_done_again(scenario, tmp_path):
    store = Store(tmp_path, scenario)
    store.add(failure("Timeout", "SafePRM", 4, ()))
    with store.file.open("a") as stream:
        stream.write('{"planner": "SafePR')
    assert Store(tmp_path, scenario).done() == {Run("SafePRM", 4)}
    Store(tmp_path, scenario).add(failure("Timeout", "SafePRM", 5, ()))
    assert len(store.results()) == 2


def test_runs_of_another_scenario_are_not_mixed_in(scenario, tmp_path):
    Store(tmp_path, scenario)
    with pytest.raises(InputError, match="another form of 'paper_1'"):
        Store(tmp_path, study_scenario(STUDIES[0]))


def test_deterministic_planners_run_once(scenario, tmp_path):
    pairs = (Pair("Bubbles", "SafePRM", "ClassicPRM", deterministic=True), PAIR)
    store = Store(tmp_path, scenario)
    todo = campaigns(scenario, pairs, 7, store)
    assert [(list(campaign.planners), campaign.runs) for campaign in todo] == [
        (["ClassicPRM", "SafePRM"], 1),
        (["ClassicRRTConnect", "SafeRRTConnect"], 7),
    ]


def test_classical_paths_are_shortened_as_is_usual(scenario, tmp_path):
    (todo,) = campaigns(scenario, (PAIR,), 2, Store(tmp_path, scenario), Smoothing.SHORTENED)
    planned = list(Campaign(scenario, todo.planners, 2).results())
    for before, after, again in zip(planned, todo.results(), todo.results(), strict=True):
        assert (after.planner, after.seed) == (PAIR.classic, before.seed)
        assert before.report is not None
        assert after.report is not None
        assert after.report.length < before.report.length
        assert after.report.certified
        assert after.simplification_time > 0.0
        assert after.counts.queries > before.counts.queries
        assert after.counts.nodes == before.counts.nodes
        assert np.array_equal(again.path, after.path)


class Straight:
    """A simplifier that looks at nothing."""

    def __init__(self, si):
        self.si = si

    def simplifyMax(self, path):
        ends = [self.si.cloneState(path.getState(k)) for k in (0, path.getStateCount() - 1)]
        path.clear()
        for end in ends:
            path.append(end)


def test_shortened_paths_that_are_not_proven_do_not_count(scenario, monkeypatch):
    monkeypatch.setattr(smoothing.og, "PathSimplifier", Straight)
    (found,) = ShorteningCampaign(scenario, [PAIR.classic], 1).results()
    assert not found.solved
    assert found.status.startswith("Error: not proven free: (0, ")


def test_finer_samples_of_the_edges_are_more_checks(scenario, monkeypatch):
    nodes, checks = effort.sampled_checks(scenario, effort.MEASURE, 3)
    assert checks > 4 * nodes
    monkeypatch.setattr(effort, "STEP", effort.STEP / 10)
    assert effort.sampled_checks(scenario, effort.MEASURE, 3)[1] > 5 * checks


# ---------------------------------------------------------------------------------------------- end to end


@pytest.fixture
def undrawn(monkeypatch):
    monkeypatch.setattr(paper, "draw_study", lambda *_: None)
    monkeypatch.setattr(paper, "draw_ideas", lambda _: {"field.png": "After Fig. 3"})
    monkeypatch.setattr(paper, "HARDNESS_RUNS", 1)
    monkeypatch.setattr(paper, "SCENES", 2)


@pytest.mark.usefixtures("undrawn")
def test_two_runs_of_two_planners(tmp_path, capsys):
    command = ["--runs", "2", "--out", str(tmp_path), "--planners", "SafeRRTConnect", "--processes", "1"]
    paper.main(command)
    report = (tmp_path / "report.md").read_text()
    assert report.count("| SafeRRTConnect | 2/2 |") == 3  # in both studies, and the scenes at random
    assert "## Study 3: 2 scenes at random, none left out" in report
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


@pytest.mark.usefixtures("undrawn")
def test_a_run_of_two_planners_with_smoothing(tmp_path, monkeypatch):
    monkeypatch.setattr(paper, "STUDIES", STUDIES[1:])
    paper.main(f"--runs 1 --planners SafeRRTConnect --processes 1 --simplify --out {tmp_path}".split())
    report = (tmp_path / "report.md").read_text()
    assert "**No difference beyond chance; the gap" in report  # one run proves nothing
    assert report.count("| ClassicRRTConnect | 1/1 | ") == 2
    assert report.count("| – with OMPL's simplifier | 1/1 | ") == 1
    assert (tmp_path / "smoothing.png").is_file()
    names = [PAIR.classic, *PAIR.planners]
    for kind, planners in ((Smoothing.SHORTENED, names[:1]), (Smoothing.SIMPLIFIED, names[1:])):
        lines = (tmp_path / f"study_2{kind.suffix}" / "runs.jsonl").read_text().splitlines()
        assert [json.loads(line)["planner"] for line in lines] == planners
        assert all(json.loads(line)["simplification_time"] > 0.0 for line in lines)


def test_planners_that_do_not_exist_are_named(tmp_path):
    with pytest.raises(UnknownNameError, match="'SafeRRT'; known: PaperBubble"):
        paper.main(["--out", str(tmp_path), "--planners", "SafeRRT"])


# --------------------------------------------------------------------------------------------- random scenes


def test_random_scenes_are_the_same_each_time_and_none_is_left_out():
    scenes, again = random_scenarios(4), random_scenarios(4)
    assert scenes == again
    assert [scene.name for scene in scenes] == [f"random_{k}" for k in range(4)]
    assert all(any(obstacle.weight for obstacle in scene.scene.obstacles) for scene in scenes)
    assert len({scene.start for scene in scenes}) == 4


def test_the_random_study_counts_what_is_not_solved(tmp_path):
    scenes = random_scenarios(2)
    stores = [store for store, _ in scene_campaigns(tmp_path, (PAIR,), 2, scenes)]
    for k, store in enumerate(stores):
        for name, danger in ((OMPLS, 8.0), (PAIR.classic, 8.0), (PAIR.safe, 4.0)):
            store.add(
                result(name, 0, danger, 0.01) if k == 0 or name == OMPLS else failure("Timeout", name, 0, ())
            )
    study = RandomStudy.of(stores, (PAIR,))
    assert f"| {OMPLS} | 2/2 | 2/2 | 2/2 |" in study.table()
    assert "| SafeRRTConnect | 1/2 | 1/2 | 1/2 | 10.0 | 10 | 100 | 4.00 |" in study.table()
    assert "| RRT-Connect ours | 1 | 0.50 | 1/1 | 1.00 | 1.00 | 1.00 |" in study.ratios()
    todo = [campaign for _, own in scene_campaigns(tmp_path, (PAIR,), 2, scenes) for campaign in own]
    assert sum(map(len, todo)) == 2 * 3  # of two runs each, one is done


# --------------------------------------------------------------------------------------------------- sweeps


def test_a_sweep_tries_one_parameter_at_a_time(tmp_path, monkeypatch):
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


def test_the_picture_of_a_sweep(tmp_path):
    points = [
        Point(name, "SafePRM", "alpha", value, 1.0 - value / 10, 1.0, 0.01)
        for name in ("a", "b")
        for value in (0.0, 1.0, 5.0)
    ]
    figure = plot_dependence(points, {"alpha": "weight"}, tmp_path / "sweep.png")
    assert [line.get_ydata()[-1] for line in figure.axes[0].lines[:2]] == [0.5, 0.5]
    assert (tmp_path / "sweep.png").is_file()
