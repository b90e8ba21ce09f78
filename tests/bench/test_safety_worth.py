"""What the bench of safety's worth keeps in files, and what it says of paths that may not move."""

import json
import sys
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[2] / "bench"))

import safety_worth
from safety_worth import as_rows, compared, loaded, pairs

from safe_ompl import PathTimer

RUNS = {
    ("panda_shelf", 0, "fastest"): 2.0,
    ("panda_shelf", 0, "RRTConnect"): np.inf,
    ("random 0", 0, "fastest"): 3.0,
    ("random 0", 0, "RRTConnect"): 4.0,
    ("random 1", 0, "fastest"): np.nan,
    ("random 1", 0, "RRTConnect"): 1.0,
}


def test_files_hold_what_may_not_move_and_what_is_unsolved(tmp_path):
    file = tmp_path / "runs.json"
    file.write_text(json.dumps(as_rows(RUNS), allow_nan=False), encoding="utf-8")
    assert json.loads(file.read_text())[0]["durations"] == {"fastest": 2.0, "RRTConnect": "may not move"}
    np.testing.assert_equal(loaded(file), RUNS)


def test_the_median_counts_may_not_move_as_infinitely_long():
    ours = np.array([1.0, 2.0, 3.0, np.inf, np.inf, np.nan])
    theirs = np.array([2.0, 2.0, np.inf, 1.0, np.inf, 1.0])
    said = compared(ours, theirs, "ours/theirs")
    assert "median 0.750 of 4 runs" in said  # 0.5, 1, 0 and +inf
    assert "of the 2 in which both may move 0.750, slower by more than 1 % in 0, at worst 1.00" in said
    assert said.endswith("may not move: ours 1, theirs 1, neither 1")
    assert compared(ours[4:5], theirs[4:5], "one") == "one: nothing to compare"


def test_only_problems_that_both_methods_had_are_compared():
    ours, theirs = pairs({**RUNS, ("random 2", 0, "fastest"): 1.0}, "fastest", "RRTConnect")
    np.testing.assert_equal(ours, [2.0, 3.0, np.nan])
    np.testing.assert_equal(theirs, [np.inf, 4.0, 1.0])


def test_it_goes_on_where_it_stopped_and_draws(tmp_path, capsys, monkeypatch):
    class Problem(safety_worth.WorthProblem):
        def setups(self):
            return None

    done = tmp_path / "done.json"
    done.write_text(json.dumps(as_rows(RUNS)), encoding="utf-8")
    ran = []
    monkeypatch.setattr(safety_worth, "problems", lambda _: [Problem("panda_shelf"), Problem("random 0")])
    monkeypatch.setattr(safety_worth, "duration", lambda *given: (ran.append(given[1:3]), float(len(ran)))[1])
    monkeypatch.setattr(safety_worth, "clock_of_the_process", lambda: None)
    new, picture = tmp_path / "new.json", tmp_path / "figure.png"
    safety_worth.main([*("--seeds", "1", "--also", str(done), "--json", str(new), "--figure", str(picture))])
    assert ran == 2 * [("safest", 0), ("BIT*", 0), ("bound", 0)]
    assert set(loaded(new).values()) == {1.0, 2.0, 3.0, 4.0, 5.0, 6.0}
    assert picture.stat().st_size > 1000
    said = capsys.readouterr().out
    assert "2 problems, 2 runs of each method; 1 that are not complete are left out" in said


def test_no_motion_is_shorter_than_the_bound():
    setups = safety_worth.WorthProblem("panda_shelf").setups()
    straight = np.array([setups.start, setups.goals[0]])
    alone = PathTimer(setups.safe.robot, setups.safe.timer.limits)
    assert 0.5 < setups.bound / alone.time(straight).duration <= 1.0
