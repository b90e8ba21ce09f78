"""The command line, run in this process on a planar arm that the tests write themselves."""

from __future__ import annotations

import dataclasses
import json
import logging
import re
import shutil
import threading
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from ompl import util as ou

from safe_ompl import SafeSetup, planner_names
from safe_ompl.apps import main
from safe_ompl.apps.benchmark import BASELINE, Summary, failure
from safe_ompl.apps.cli import compare, output
from safe_ompl.drawing import pictures, render_comparison, render_path
from safe_ompl.scene import find_scenario

RECORD = (
    "scenario robot planner seed status solved setup_time planning_time simplification_time report_time joint_names "
    "path length danger clearance certified validation links_without_collision counts"
)
SAVED = f"format version kind {RECORD} problem"
DANGER = {"mean", "max", "max_bound", "integral", "avoidable", "profile"}
CLEARANCE = {"min", "mean", "length_below_50mm", "link", "obstacle", "at", "obstacles"}

SCENARIO = """\
name: test
robot: {urdf: arm.urdf, srdf: arm.srdf, tip: tip}
start: {joint1: 1.2, joint2: 0.2}
goal:
  configuration: {joint1: -1.2, joint2: -0.2}
scene:
  spacing: 0.05
  obstacles:
    - {name: person, sphere: {radius: 0.1}, position: [0.72, 0.0, 0.0], weight: 1}
    - {name: post, box: {size: [0.1, 0.1, 0.3]}, position: [-0.6, 0.0, 0.0]}
planners: {SafeRRTConnect: {alpha: 1}}
time: 2.0
"""


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """Return a folder, made the current one, with a robot and the scenario file ``test.yaml``."""
    for kind in ("urdf", "srdf"):
        shutil.copy(find_scenario("planar2").resolve().parent / f"robots/planar2.{kind}", tmp_path / f"arm.{kind}")
    (tmp_path / "test.yaml").write_text(SCENARIO)
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture
def run(folder, call):
    """Return a function that runs the command line in the folder, see `call`."""
    return call


@pytest.fixture
def quick_renderer(monkeypatch):
    """Draw coarsely; skip the test if nothing can be drawn."""
    pytest.importorskip("matplotlib")

    def coarse(draw, **quality):
        return lambda *arguments, **options: draw(*arguments, **{**options, **quality})

    monkeypatch.setattr(pictures, "render_path", coarse(render_path, ghosts=0))
    monkeypatch.setattr(compare, "render_comparison", coarse(render_comparison, panel=(60, 50)))


def strict(text):
    """Read JSON that holds no NaN and no Infinity."""

    def refuse(name):
        raise AssertionError(f"{name} is not JSON")

    return json.loads(text, parse_constant=refuse)


def assert_solved_record(record):
    danger, clearance, path = record["danger"], record["clearance"], np.array(record["path"])
    assert (set(danger), set(clearance)) == (DANGER, CLEARANCE)
    assert (record["solved"], record["certified"], record["status"]) == (True, True, "Exact solution")
    assert record["planning_time"] > 0 <= record["simplification_time"]
    assert path.shape[1] == len(record["joint_names"])
    assert record["length"] == pytest.approx(np.linalg.norm(np.diff(path, axis=0), axis=1).sum())
    assert len(danger["profile"]) == 101
    assert 0 < danger["mean"] <= danger["max"] <= danger["max_bound"] <= 1.05 * danger["max"]
    assert 0 <= danger["avoidable"] <= danger["integral"]
    assert 0 < clearance["min"] <= clearance["mean"]
    assert 0 <= clearance["at"] <= 1
    assert 0 <= clearance["length_below_50mm"] <= record["length"] + 1e-9
    assert all(isinstance(number, int) and number >= 0 for number in record["counts"].values())
    assert record["counts"]["bound_queries"] > 0


# ---------------------------------------------------------------------------------------------------- plan


def test_plan_writes_json_to_standard_output_and_nothing_else(run):
    status, out, err = run("plan", "test.yaml", "--json", "-", "--seed", 3)
    record = strict(out)
    assert (status, [line for line in err.splitlines() if "compiling kernels" not in line]) == (0, [])
    assert set(record) == set(SAVED.split())
    assert (record["scenario"], record["robot"], record["seed"]) == ("test", "planar2", 3)
    assert record["planner"] == "SafeRRTConnect"
    assert record["joint_names"] == ["joint1", "joint2"]
    assert record["path"][0] == [1.2, 0.2]
    assert record["path"][-1] == [-1.2, -0.2]
    assert record["clearance"]["obstacle"] in ("person", "post")
    assert_solved_record(record)


@pytest.mark.usefixtures("quick_renderer")
def test_plan_shows_a_table_beside_files(says, folder):
    words = ("test · planar2", "RRTConnect", "Exact solution", "certified: no collision", "danger mean", "clearance ")
    says("plan test.yaml --planner RRTConnect --json result.json --plot path.png", *words)
    assert (folder / "path.png").read_bytes().startswith(b"\x89PNG")
    assert strict((folder / "result.json").read_text())["planner"] == "RRTConnect"


def test_plan_not_solved_is_status_1_and_null(run):
    status, out, _ = run("plan", "test.yaml", "--time", "1e-9", "--json", "-")
    record = strict(out)
    assert status == 1
    assert set(record) == set(SAVED.split())
    assert record["solved"] is False
    assert record["certified"] is False
    assert [record[key] for key in ("path", "length", "danger", "clearance")] == [None] * 4


def test_log_is_shown_on_request_and_left_as_it_was(run, folder):
    (folder / "bare.yaml").write_text(SCENARIO.replace(", srdf: arm.srdf", ""))
    before = (logging.getLogger("safe_ompl").handlers[:], logging.getLogger("safe_ompl").level)
    level = ou.getLogLevel()
    status, _, err = run("plan", "bare.yaml")
    assert status == 0
    assert [line.startswith("safe-ompl: warning: ") for line in err.splitlines()] == [True]
    _, _, err = run("plan", "test.yaml", "-v")
    assert all(line.startswith("safe-ompl: info: ") for line in err.splitlines())
    assert err
    assert (logging.getLogger("safe_ompl").handlers[:], logging.getLogger("safe_ompl").level) == before
    assert ou.getLogLevel() == level


def test_interrupt_is_status_130_and_one_line(run, monkeypatch):
    def interrupted(*arguments, **options):
        raise KeyboardInterrupt

    monkeypatch.setattr(SafeSetup, "plan", interrupted)
    assert run("plan", "test.yaml") == (130, "", "safe-ompl: interrupted\n")


# ------------------------------------------------------------------------------------------------ certificates


def test_without_a_path_there_is_no_certificate(run, folder, monkeypatch):
    unsolved = failure("Timeout", "SafeRRTConnect", 0, ("a",))
    monkeypatch.setattr(SafeSetup, "plan", lambda *arguments, **options: unsolved)
    status, _, err = run("plan", "test.yaml", "--certificate", "proof.json")
    assert (status, err) == (1, "safe-ompl: no path was found: nothing is written to proof.json\n")
    assert not (folder / "proof.json").exists()


# ------------------------------------------------------------------------------------------------- compare


def test_compare_writes_table_and_report(says, folder, monkeypatch):
    monkeypatch.setitem(output.EXTRAS, "plots", ("no_such_module", "pictures"))
    monkeypatch.setenv("COLUMNS", "80")
    arguments = ("--planners", "RRTConnect,SafeRRTConnect", "--runs", 4, "--seed", 7, "--out", "deep/out")
    out = says(("compare", "test.yaml", *arguments), "4/4", "*", notes=["no_such_module", "pip install"])
    table, _, rest = out.partition("Medians")
    assert max(map(len, table.splitlines())) <= 80
    assert BASELINE == "OMPL RRTConnect + OMPL's simplifier"
    assert table.index("OMPL RRTConnect +") < table.index("OMPL's simplifier") < table.index("SafeRRTConnect")
    report = strict((folder / "deep/out/report.json").read_text())
    assert list(report) == ["scenario", "robot", "seed", "summary", "safest", "words", "runs"]
    assert [(run["planner"], run["seed"]) for run in report["runs"]] == [
        (planner, seed) for seed in range(7, 11) for planner in (BASELINE, "RRTConnect", "SafeRRTConnect")
    ]
    for record in report["runs"]:
        assert set(record) == set(f"{RECORD} planned_path".split())
        assert_solved_record(record)
        assert record["planned_path"][0] == record["path"][0]
    for summary in report["summary"]:
        assert summary["solved"] == summary["runs"] == 4
        assert list(summary["danger_mean"]) == ["median", "p15", "p85"]
        assert summary["typical_seed"] in range(7, 11)
    baseline, plain, _ = report["summary"]
    assert baseline["as_planned"]["danger_mean"] == plain["as_planned"]["danger_mean"], "the same planner"
    assert baseline["danger_max"]["median"] > baseline["as_planned"]["danger_max"]["median"]
    assert plain["danger_max"]["median"] < plain["as_planned"]["danger_max"]["median"]
    # The words are those of the medians.
    safest = next(summary for summary in report["summary"] if summary["planner"] == report["safest"])
    below = 100 * (1 - safest["danger_max"]["median"] / baseline["danger_max"]["median"])
    more = 1e3 * (safest["clearance_min"]["median"] - baseline["clearance_min"]["median"])
    words = f"simplified, compared with the baseline: {below:.0f} % less peak danger, {more:.0f} mm more clearance"
    assert f"{report['safest']}, {words}" in report["words"]
    assert report["words"] in " ".join(rest.split())


def test_compare_without_simplification_begins_with_the_planner_of_the_baseline(run, folder):
    arguments = ("--planners", "SafeRRTConnect", "--runs", 2, "--no-simplify")
    assert run("compare", "test.yaml", *arguments)[0] == 0
    report = strict((folder / "compare-test/report.json").read_text())
    assert [summary["planner"] for summary in report["summary"]] == ["RRTConnect", "SafeRRTConnect"]
    assert "SafeRRTConnect, as planned, compared with" in report["words"]
    assert {run["simplification_time"] for run in report["runs"]} == {0.0}


def summary_of(planner, *, time=1.0, mean=5.0, peak=9.0, clearance=20.0, spread=0.0, runs=3):
    """Return a summary with medians [ms, mm], of which each spreads by a share of itself."""
    metrics = {"total_time": 1e-3 * time, "danger_mean": mean, "danger_max": peak, "length": 3.0}
    metrics["clearance_min"] = 1e-3 * clearance
    # From the 15th to the 85th percentile of three values there is 0.7 of the way from the first to the last.
    ways = np.linspace(-0.5, 0.5, runs) * spread / 0.7 if runs > 1 else np.zeros(runs)
    return Summary(planner, 3, runs, {key: value * (1 + ways) for key, value in metrics.items()}, np.empty(0), None)


MARKS = [
    ([{"mean": 4.0}, {"mean": 4.5}], [1]),
    ([{"mean": 4.0, "spread": 0.1}, {"mean": 4.3, "spread": 0.1}], [1, 2]),  # 0.3 is within 0.4, 0.7 is not
    ([{"mean": 4.0, "spread": 0.3}, {"mean": 4.3, "spread": 0.3}], []),  # 1.0 is less than 0.3 of 4
    ([{"mean": 4.0, "spread": 0.1}, {"mean": 4.6, "spread": 0.01}], [1]),  # 0.6 is more than the best one spreads
    ([{"mean": 4.0, "runs": 1}, {"mean": 4.5, "runs": 1}], []),  # how one run spreads is not known
    ([{"mean": 4.99}, {"mean": 5.01}], []),  # less than is seen
    ([{"mean": 4.0}, {"runs": 0}], [1]),
    ([{"mean": 6.0}, {"mean": 7.0}], [0]),  # the baseline may have a mark, too
]


@pytest.mark.parametrize(("others", "starred"), MARKS)
def test_marks_stand_only_where_differences_are_larger_than_the_spread(others, starred):
    rows = [summary_of("baseline"), *(summary_of(f"ours {k}", **values) for k, values in enumerate(others))]
    (mean,) = (column for column in compare._COLUMNS if column.metric == "danger_mean")
    cells = [cell.plain for cell in mean.cells(rows, mark_best=True)]
    assert [k for k, cell in enumerate(cells) if cell.endswith("*")] == starred
    assert not any(cell.endswith("*") for cell in (cell.plain for cell in mean.cells(rows, mark_best=False)))


WORDS = [
    ({"peak": 3.69, "clearance": 65.2, "time": 5.1}, "59 % less peak danger, 45 mm more clearance, 4 ms more"),
    ({"peak": 9.9, "clearance": 11.0, "time": 0.2}, "10 % more peak danger, 9 mm less clearance, 1 ms less"),
    ({}, "the same peak danger, the same clearance, the same"),
    (
        {"peak": 8.1, "spread": 0.5},
        "10 % less peak danger (within the spread over the seeds), the same clearance, the same",
    ),
]


@pytest.mark.parametrize(("ours", "words"), WORDS)
def test_the_last_line_says_in_words_what_the_table_has(ours, words):
    said = compare.in_words(summary_of(BASELINE), summary_of("SafePRM", **ours), "simplified")
    assert said == f"SafePRM, simplified, compared with the baseline: {words} planning time"
    unsolved = summary_of("SafePRM", runs=0)
    assert compare.in_words(summary_of(BASELINE), unsolved, "simplified") == "SafePRM: no path in 3 runs"


def test_the_safest_is_the_first_of_ours_that_none_of_ours_beats_in_mean_and_peak():
    values = {"baseline": (1.0, 1.0), "a": (5.0, 9.0), "b": (4.5, 7.0), "c": (4.0, 7.0), "d": (4.4, 6.99)}
    rows = [summary_of(name, mean=mean, peak=peak) for name, (mean, peak) in values.items()]
    assert compare.safest(rows).planner == "b", "d is better by less than is seen"
    assert compare.safest([rows[0], summary_of("none", runs=0), *rows[1:2]]).planner == "a"
    assert compare.safest([*rows, summary_of("e", mean=4.0, peak=6.0)]).planner == "c"
    assert compare.safest([*rows, summary_of("e", mean=3.9, peak=6.0)]).planner == "e"


@pytest.mark.usefixtures("quick_renderer")
def test_compare_draws_pictures(run, folder):
    assert run("compare", "test.yaml", "--planners", "RRTConnect,SafeRRTConnect", "--runs", 3)[0] == 0
    drawn = {file.name for file in (folder / "compare-test").glob("*.png")}
    assert drawn == {"profiles.png", "paths.png"}


@pytest.mark.usefixtures("folder")
def test_plan_takes_the_best_of_several_starts(says):
    plan = "plan test.yaml --planner RRTConnect --json -"
    best = strict(says(f"{plan} --seed 4 --starts 4 --workers 2"))
    assert best["seed"] in range(5, 8), "the first is not the best, or the test shows nothing"
    assert best["path"] == strict(says(f"{plan} --seed {best['seed']}"))["path"]


# ----------------------------------------------------------------------------------------------------- mbm

FREE: dict[str, Any] = {
    **{"index": 4, "start": [0.2, 1.2], "goals": [[-0.2, -1.2]], "box": [], "cylinder": []},
    "sphere": [{"name": "s", "radius": 0.1, "position": [0.72, 0, 0], "orientation_quat_xyzw": [0, 0, 0, 1]}],
}


@pytest.fixture
def problems(folder):
    """Return a file with two families; its joints are in another order than the robot's."""
    families = {
        "easy": [FREE, {**FREE, "index": 5, "goals": [[-0.2, -3.15]]}],
        "bad": [{**FREE, "start": [0.0, 0.0]}, {**FREE, "goals": [[9.0, 0.0]]}, {"index": 6}],
    }
    (folder / "empty.json").write_text(json.dumps({"robot": "panda", "problems": {"easy": []}}))
    file = folder / "problems.json"
    file.write_text(json.dumps({"robot": "arm", "joints": ["joint2", "joint1"], "problems": families}))
    return file


ARM = ("--robot", "test.yaml")


@pytest.mark.parametrize("workers", [1, 2])
def test_mbm_writes_a_line_for_each_problem_bad_ones_too(run, problems, workers):
    status, out, err = run("mbm", problems, *ARM, "--seed", 2, "--json", "lines.json", "--workers", workers)
    lines = [strict(line) for line in (problems.parent / "lines.json").read_text().splitlines()]
    assert (status, out) == (1, "")
    assert "easy" in err
    assert all(set(line) == set(f"family index {RECORD} widened_limits".split()) for line in lines)
    assert [(line["family"], line["index"]) for line in lines[:2]] == [("easy", 4), ("easy", 5)]
    for line in lines[:2]:
        assert_solved_record(line)
        assert (line["robot"], line["seed"]) == ("planar2", 2)
        assert line["joint_names"] == ["joint1", "joint2"]
        assert line["path"][0] == [1.2, 0.2]
    expected = ("start is in collision", "'link2' touches 's'"), ("goals[0]", "'joint2' = 9", "[-2.6, 2.6]")
    for line, words in zip(lines[2:], (*expected, ("problems.bad[2]", "missing")), strict=True):
        assert not line["solved"]
        assert line["status"].startswith("Invalid input: ")
        assert all(word in line["status"] for word in words)


def test_mbm_ends_on_ctrl_c(run, problems, monkeypatch):
    halfway = dataclasses.replace(failure("Timeout", "SafeRRTConnect", 0, ("a",)), interrupted=True)
    monkeypatch.setattr(SafeSetup, "plan", lambda *arguments, **options: halfway)
    status, out, err = run("mbm", problems, *ARM, "--simplify")
    assert (status, out, err) == (130, "", "safe-ompl: interrupted\n")


def test_mbm_takes_files_that_name_no_joints(run, folder):
    problems = [{**FREE, "start": [1.2, 0.2], "goals": goals} for goals in ([[-1, 0], [-1]], [[-3.15, 0]])]
    (folder / "nameless.json").write_text(json.dumps({"problems": {"easy": problems}}))
    status, out, _ = run("mbm", "nameless.json", *ARM)
    first, second = (strict(line) for line in out.splitlines())
    assert status == 1
    assert "goals[1]" in first["status"]
    assert second["solved"]
    assert second["widened_limits"] == {"joint1": [-3.15, 3.1]}


# ---------------------------------------------------------------------------------------------------- lists


def test_the_list_says_what_is_there_and_what_is_broken(says, folder):
    (folder / "scenarios").mkdir()
    (folder / "scenarios/broken.yaml").write_text("name: [")
    out = " ".join(says("list").split())
    assert all(word in out for word in ("panda_shelf", "broken", "malformed YAML", "ur5", "tool0"))


def test_help_leads_with_what_a_beginner_needs(capsys):
    with pytest.raises(SystemExit):
        main([])
    out = capsys.readouterr().out
    assert re.findall(r"^    (\w+) ", out, re.MULTILINE)[:3] == ["plan", "view", "check"]
    assert "First steps: safe-ompl view panda_shelf" in " ".join(out.split())


# ------------------------------------------------------------------------------------------------- bad input


BAD_OPTIONS = [
    ("plan", "SCENARIO"),
    ("fly", "fly", "plan"),
    ("plan test.yaml --fast", "--fast"),
    ("plan nowhere", "'nowhere'"),
    ("plan test.yaml --planner Fly", "'Fly'", *planner_names()),
    ("plan test.yaml --param alfa=1", "SafeRRTConnect", "'alfa'"),
    ("plan test.yaml --param alpha=-1", "alpha", "-1"),
    ("plan test.yaml --param alpha", "--param", "'alpha'"),
    ("plan test.yaml --param alpha=1 --param alpha=2", "'alpha'"),
    *((f"plan test.yaml --time {time}", "--time", f"'{time}'") for time in ("0", "-1", "nan", "inf")),
    *((f"plan test.yaml --seed {seed}", "--seed", f"'{seed}'") for seed in ("-3", "1.5")),
    ("plan panda_shelf --package-dir .", "--package-dir: is for robots from a URDF; 'panda' brings its own"),
    ("verify problems.json", "problems.json: format: must be 'safe-ompl certificate'"),
    ("compare test.yaml --runs 0", "--runs", "'0'"),
    ("compare test.yaml --planners RRT,RRT", "'RRT'", "twice"),
    ("compare test.yaml --out arm.urdf", "--out", "'arm.urdf'"),
    ("plan test.yaml --json no/x.json", "--json", "'no/x.json'"),
    ("plan test.yaml --plot x.doc", "--plot", "'x.doc'", ".png"),
    ("plan test.yaml --rate 100", "--rate", "--trajectory"),
    ("plan test.yaml --workers 2", "--starts"),
    ("plan test.yaml --min-clearance -1", "--min-clearance", "must be a positive number, not '-1'"),
    ("plan test.yaml --keep-upright 270", "must be an angle in (0, 180] degrees, not '270'"),
    ("plan test.yaml --timed --rate 0", "--rate", "a positive number, not '0'"),
    ("mbm arm.urdf", "arm.urdf", "JSON"),
    ("mbm problems.json", "problems.json: robot", "'arm'", "--robot"),
    ("mbm problems.json --robot r2d2", "'r2d2'"),
    ("mbm problems.json --robot ur5", "joints", "joint2", "elbow"),
    ("mbm empty.json", "empty.json: holds no problem"),
    ("live test.yaml --out drive --place 1,2,nan,0", "--place", "finite", "'1,2,nan,0'"),
    ("live test.yaml --out drive --faster -1", "--faster", "a positive number, not '-1'"),
]


@pytest.mark.parametrize("row", BAD_OPTIONS, ids=lambda row: row[0])
@pytest.mark.usefixtures("problems")
def test_bad_options(refuses, row):
    refuses(*row)


@pytest.mark.parametrize(("options", "shown"), [((), False), (("-v",), True)])
def test_messages_of_ompl_come_with_verbose(run, options, shown):
    handler = ou.OutputHandlerSTD()
    ou.useOutputHandler(handler)
    _, out, err = run("plan", "test.yaml", "--planner", "RRTConnect", *options)
    assert ("RRTConnect: Starting planning" in out + err) is shown


def test_threads_may_log_after_each_other(capsys):
    log = logging.getLogger("safe_ompl.test")
    with output.shown_log(verbose=False) as show:
        log.warning("held back")
        show()
        thread = threading.Thread(target=log.warning, args=("of a thread",), daemon=True)
        thread.start()
        thread.join(10.0)
        assert not thread.is_alive()
    assert capsys.readouterr().err.splitlines() == ["safe-ompl: warning: held back", "safe-ompl: warning: of a thread"]


@pytest.mark.parametrize("command", ["plan", "compare --runs 1 --planners SafeRRTConnect,SafePRM"])
def test_where_nothing_is_dangerous_danger_is_zero(says, folder, monkeypatch, command):
    monkeypatch.setattr("safe_ompl.apps.cli.output.missing_extra", lambda extra: "not now")
    (folder / "harmless.yaml").write_text(SCENARIO.replace(", weight: 1", ""))
    out = says(f"{command} harmless.yaml --simplify 0.1")
    assert " ".join(out.split()).lower().count("no obstacle has a danger weight") == 1


MOVING = "limits: {moving: {speeds: {%s}, time: %s}}"
BAD_SCENARIOS = [
    ("time: 2.0", "tine: 2.0", "tine", "did you mean 'time'"),
    ("joint1: 1.2", "joint1: 7", "start", "'joint1'", "7", "[-3.1, 3.1]"),
    ("1.2, joint2: 0.2", "0, joint2: 0", "start", "collision", "'link2'", "'person'"),
    ("-1.2, joint2: -0.2", "0, joint2: 0", "goal", "collision", "'link2'", "'person'"),
    ("time: 2.0", "danger: {aggregate: sum}", "aggregate", "'sum'", "max"),
    ("SafeRRTConnect: {alpha: 1}", "Fly: {}", "planners", "'Fly'"),
    ("alpha", "alfa", "'alfa'"),
    ("time: 2.0", MOVING % ("persn: 1", 1), "'persn'", "did you mean 'person'"),
    ("time: 2.0", MOVING % ("person: 9", 9), "'person' may move 81000 mm, and come to"),
]


@pytest.mark.parametrize("row", BAD_SCENARIOS, ids=lambda row: row[1])
def test_bad_scenarios(refuses, folder, row):
    old, new, *words = row
    assert old in SCENARIO
    (folder / "bad.yaml").write_text(SCENARIO.replace(old, new))
    refuses(("compare" if "collision" in words else "plan", "bad.yaml"), *words)


def test_a_path_is_free_whatever_moving_obstacles_do(says, folder):
    (folder / "moving.yaml").write_text(SCENARIO + MOVING % ("person: 0.1, post: 0.05", 0.5))
    says("plan moving.yaml --json result.json --certificate proof.json", "moving obstacles")
    result, proof = (strict((folder / f"{name}.json").read_text()) for name in ("result", "proof"))
    claimed = {"speeds": {"person": 0.1, "post": 0.05}, "time": 0.5}
    assert result["moving_obstacles"] == proof["stretches"][0]["moving_obstacles"] == claimed
    says("verify proof.json moving.yaml", "the same while obstacles move no faster than person 0.1 m/s")
    assert result["clearance"]["obstacles"]["person"] >= 0.05


def test_checking_an_output_file_leaves_it_alone(refuses, folder):
    (folder / "old.json").write_text("precious")
    refuses("plan nowhere --json old.json --force", "nowhere")
    refuses("plan nowhere --json new.json", "nowhere")
    assert (folder / "old.json").read_text() == "precious"
    assert not (folder / "new.json").exists()


OUTPUTS = [
    ("plan test.yaml --json old.json", "--json: 'old.json' already exists"),
    ("check old.json --scenario test.yaml --repair old.csv", "--repair: 'old.csv' already exists"),
    ("new arm.urdf -o old.yaml", "--output: 'old.yaml' already exists"),
    ("srdf arm.urdf -o arm.srdf", "--output: 'arm.srdf' already exists"),
    ("compare test.yaml --out old", "--out: the folder 'old' holds report.json already"),
    ("live test.yaml --movers 1 --out old", "'old' holds ticks.jsonl already"),
]


@pytest.mark.parametrize(("line", "words"), OUTPUTS)
@pytest.mark.usefixtures("problems")
def test_nothing_is_overwritten_without_force(refuses, folder, line, words):
    (folder / "old").mkdir()
    names = ("old.json", "old.csv", "old.yaml", "old.html", "old.svg", "old/report.json", "old/ticks.jsonl")
    for name in names:
        (folder / name).write_text("precious")
    refuses(line, words, "or --force")
    assert all((folder / name).read_text() == "precious" for name in names)


def test_force_replaces_files_but_no_input(run, refuses, folder):
    (folder / "old.json").write_text("old")
    assert run("plan", "test.yaml", "--json", "old.json", "--force")[0] == 0
    strict((folder / "old.json").read_text())
    again = "check old.json --scenario test.yaml --repair ./old.json --force"
    refuses(again, "--repair", "is read by this command")
    refuses("new arm.urdf -o arm.urdf --force", "must end in .yaml")


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs a full disk")
def test_a_full_disk_is_named(run):
    status, _, err = run("plan", "test.yaml", "--json", "/dev/full")
    assert (status, err) == (2, "safe-ompl: /dev/full: No space left on device\n")


@pytest.mark.usefixtures("folder")
def test_pictures_without_the_extra_are_refused_with_advice(refuses, monkeypatch):
    monkeypatch.setitem(output.EXTRAS, "plots", ("no_such_module", "pictures"))
    refuses("plan test.yaml --plot x.png", "--plot", "no_such_module", "safe-ompl[plots]")
