"""The problem sets that the bench writes for strangers: hard problems with ways that solve them, and drives."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[2]))
sys.path.insert(0, str(Path(__file__).parents[2] / "bench"))

from _hard import hard_problems
from hard import export

from bench import drives
from safe_ompl.apps.benchmark import Entry, ProblemSet
from safe_ompl.people import find_skeleton


def test_hard_problems_are_exported_with_ways_that_solve_them(tmp_path):
    problems = list(hard_problems([1, 17]))
    export(problems, tmp_path)
    (file,) = tmp_path.glob("hard_*.json")
    known = ProblemSet.load(file)
    rows = Entry.load(tmp_path / "as_made.json", [known]).judged()["rows"]
    assert [row["problem"] for row in rows] == [f"{p.kind} {p.name.split()[-1]}" for p in problems]
    assert all(row["solved"] and not row["touching"] for row in rows)
    for problem, row in zip(problems, rows, strict=True):
        assert known.problems[row["problem"]].scene.names == problem.scene.names
        assert 0 < row["min_clearance"] < 0.02  # they are narrow


def test_drives_are_exported_with_entries(tmp_path, monkeypatch):
    skeleton = find_skeleton("recording12")
    frame = np.zeros((12, 3))
    frame[:, 2] = np.linspace(0.0, 0.7, 12)
    frame[[5, 6, 7], 1], frame[[9, 10, 11], 1] = 0.2, -0.2
    names = np.array(skeleton.points)
    np.savez(tmp_path / "still.npz", names=names, rate=20.0, clip_0=np.array([frame] * 20))
    out = tmp_path / "out"
    words = [str(tmp_path), "--out", str(out), "--places", "1", "--seconds", "0.5", "--policies", "alone"]
    monkeypatch.setattr(sys, "argv", ["drives", *words])
    drives.main()
    assert json.loads((out / "drives.json").read_text())["drives"][0]["recording"] == "../still.npz"
    (row,) = Entry.load(out / "entries" / "alone.json", [ProblemSet.load(out / "drives.json")]).judged()[
        "rows"
    ]
    assert row["problem"] == "still clip_0 0"
    assert row["solved"], row["error"]
    assert row["length"] > 0.01
