"""Entries of the open table: what the judge says of known paths, what is refused, and the page of all entries."""

from __future__ import annotations

import json
import re

import numpy as np
import pytest

from safe_ompl import CollisionChecker, Motion, Pose, Robot, Scene
from safe_ompl.apps.benchmark import Entry, Judge, ProblemSet, checksum
from safe_ompl.apps.benchmark.judge import SPACING, samples
from safe_ompl.apps.cli.program import main
from safe_ompl.geometry import STANDING
from safe_ompl.io import marked
from safe_ompl.io.problems import carried_scene
from safe_ompl.people import PELVIS, find_skeleton

POLE = {"name": "pole", "radius": 0.05, "length": 1.0, "position": [0.5, 0.0, 0.5]}
POLE["orientation_quat_xyzw"] = [0, 0, 0, 1]
LEFT, RIGHT = [1.0, 0.3, 0.0, -1.6, 0.0, 1.9, 0.8], [-1.0, 0.3, 0.0, -1.6, 0.0, 1.9, 0.8]
AROUND = [LEFT, [1.0, -1.2, 0.0, -2.6, 0.0, 1.9, 0.8], [-1.0, -1.2, 0.0, -2.6, 0.0, 1.9, 0.8], RIGHT]
SCENE = Scene.from_mbm({"cylinder": [POLE]})


@pytest.fixture(scope="module")
def robot():
    return Robot.from_example("panda")


@pytest.fixture
def problems(tmp_path):
    file = tmp_path / "pole.json"
    items = [{"index": k, "start": LEFT, "goals": [RIGHT], "cylinder": [POLE]} for k in (1, 2)]
    file.write_text(json.dumps({"robot": "panda", "problems": {"pole": items}}))
    return file


def entry_of(problems, *answers, system="lines", **more):
    one = {"name": problems.stem, "sha256": checksum(problems), "answers": list(answers)}
    return {"format": "safe-ompl entry", "version": 1, "system": system, "sets": [one], **more}


def answer(path=AROUND, problem="pole 1", **more):
    return {"problem": problem, "path": path, **more}


def test_the_judge_measures_what_the_package_measures(robot):
    checker, judge = CollisionChecker(robot, SCENE), Judge(robot, SCENE)
    rng = np.random.default_rng(0)
    for q in rng.uniform(robot.lower, robot.upper, (20, 7)):
        verdict = judge.verdict(Motion.through([q, q]))
        assert verdict.touching == checker.in_collision(q) == judge.plain.touches(q)
        if not verdict.touching:
            assert verdict.min_clearance == pytest.approx(checker.clearance(q).distance, abs=1e-5)


def test_the_judge_knows_contact_clearance_and_length(robot):
    judge = Judge(robot, SCENE)
    verdict = judge.verdict(Motion.through([LEFT, RIGHT]))
    assert verdict.touching
    assert verdict.length == pytest.approx(2.0)
    assert verdict.worst.other == "pole"
    assert (
        verdict.worst.distance < -0.04
    )  # the forearm passes through the middle of the pole, whose radius is 50 mm
    free = judge.verdict(Motion.through(AROUND))
    assert not free.touching
    clearances = [
        CollisionChecker(robot, SCENE).clearance(q).distance for q in samples(Motion.through(AROUND), 0.005)
    ]
    assert free.min_clearance == pytest.approx(min(clearances), abs=1e-3)
    assert free.mean_clearance == pytest.approx(np.mean(clearances), rel=0.01)


def test_samples_that_are_left_out_touch_nothing(robot):
    # Graze the pole: the first contact must be the one that all samples show.
    judge, checker = Judge(robot, SCENE), CollisionChecker(robot, SCENE)
    rng = np.random.default_rng(1)
    found = 0
    for _ in range(6):
        start = np.array(LEFT) + rng.uniform(-0.2, 0.2, 7)
        motion = Motion.through([start, start - [rng.uniform(0.5, 1.2), 0, 0, 0, 0, 0, 0]])
        every = any(checker.in_collision(q) for q in samples(motion, 0.002))
        found += every
        assert judge.verdict(motion).touching or not every
    assert 0 < found < 6


def test_a_curve_that_comes_back_is_sampled_densely(robot):
    # One piece from a configuration back to itself: q + 4 u (1 − u) d, whose ends show no motion.
    far = np.zeros(7)
    far[0] = -2.0
    motion = Motion([0.0, 1.0], np.array([[LEFT, 4 * far, -4 * far]]))
    rows = samples(motion, SPACING)
    assert np.linalg.norm(np.diff(rows, axis=0), axis=1).max() <= SPACING
    assert np.abs(np.diff(rows, axis=0)).sum() == pytest.approx(4.0, rel=1e-3)
    assert Judge(robot, SCENE).verdict(motion).touching


def test_an_entry_is_judged_with_a_page_and_pictures(problems, tmp_path, capsys):
    folder = tmp_path / "entries"
    folder.mkdir()
    free = entry_of(problems, answer(times={"planning": 0.25}), system="around <b>", planner="by hand")
    touches = entry_of(
        problems, answer([LEFT, RIGHT]), {"problem": "pole 2", "failed": "no path in 5 s"}, system="straight"
    )
    absent = {"format": "safe-ompl entry", "version": 1, "system": "absent", "sets": [], "failed": "no wheel"}
    for name, entry in {"around": free, "straight": touches, "absent": absent}.items():
        (folder / f"{name}.json").write_text(json.dumps(entry))
    out = tmp_path / "judged"
    words = ["judge", str(folder), "--problems", str(problems), "--out", str(out)]
    assert main(words) == 1
    shown = capsys.readouterr().out
    assert "absent: no wheel" in shown
    result = json.loads((out / "straight.judged.json").read_text())
    assert [row["solved"] for row in result["rows"]] == [True, False]
    assert result["rows"][1]["error"] == "no path in 5 s"
    assert result["summary"][0]["touching"] == 1
    page = (out / "index.html").read_text()
    assert "around &lt;b&gt;" in page
    assert "<b>absent</b>: no wheel" in page
    assert len(re.findall(r"<img [^>]*src=\"data:image/webp;base64,", page)) == 2
    assert 'data-value="250.0"' in page
    assert "mm inside pole" in page
    assert (
        main(["judge", str(folder / "around.json"), *words[2:], "--force"]) == 0
    )  # the others stay on the page
    assert "straight" in (out / "index.html").read_text()


BAD = {
    "another format": (lambda e: e.update(format="x"), "format: must be 'safe-ompl entry', got 'x'"),
    "an unknown key": (lambda e: e.update(sytem="x"), "sytem: unknown key; did you mean 'system'?"),
    "a set twice": (lambda e: e["sets"].append(e["sets"][0]), "sets[1].name: 'pole' is there twice"),
    "a name with escapes": (lambda e: e.update(system="a\x1b[2J"), "system: must be at most 300 printable characters"),
    "no answers": (lambda e: e["sets"].clear(), "sets: must hold answers, unless `failed`"),
    "an unknown set": (lambda e: e["sets"][0].update(name="x"), "sets[0].name: unknown problem set 'x'; known: pole"),
    "another checksum": (lambda e: e["sets"][0].update(sha256="00"), "sets[0].sha256: '00' is not that of 'pole'"),
}  # fmt: skip
BAD_ANSWERS = {
    "an unknown problem": (answer(problem="pole 7"), "problem: 'pole 7' is not in the problem set 'pole'"),
    "NaN": (answer([LEFT, [float("nan")] * 7, RIGHT]), "path: way points"),
    "too few joints": (answer([LEFT[:6], RIGHT[:6]]), "path: "),
    "one way point": (answer([LEFT]), "path: goal: "),
    "ragged rows": (answer([LEFT, RIGHT[:5]]), "path: way points"),
    "another start": (answer(AROUND[1:]), "path: start: [1.0, -1.2"),
    "another goal": (answer(AROUND[:-1]), "path: goal: "),
    "an endless path": (answer([LEFT, RIGHT] * 400), "path: length: may be longer than 400 rad"),
    "degrees": (answer(np.degrees([LEFT, RIGHT]).tolist()), "these are degrees"),
    "a negative time": (answer(times={"planning": -1}), "times.planning: "),
    "path and failure": (answer(failed="no"), "answer: must have one of path, motion, failed; got path, failed"),
    "a seed of text": (answer(seed="1"), "seed: must be a whole number, got '1'"),
    "text for a path": (answer("x"), "path: way points"),
    "no motion": ({"problem": "pole 1", "motion": {}}, "motion: must hold joint_names and points"),
}  # fmt: skip


@pytest.mark.parametrize("case", [*BAD, *BAD_ANSWERS])
def test_bad_entries_are_refused_in_one_line(case, problems, tmp_path, capsys):
    if case in BAD:
        change, message = BAD[case]
        entry = entry_of(problems, answer())
        change(entry)
    else:
        bad, message = BAD_ANSWERS[case]
        entry, message = entry_of(problems, answer(problem="pole 2"), bad), f"sets[0].answers[1].{message}"
        message = message if case not in ("degrees",) else "these are degrees"
    file = tmp_path / "bad.json"
    file.write_text(json.dumps(entry))
    assert main(["judge", str(file), "--problems", str(problems), "--out", str(tmp_path / "out")]) == 2
    said = capsys.readouterr().err.strip()
    assert said.startswith(f"safe-ompl: {file}: ")
    assert message in said
    assert "\n" not in said


def test_a_folder_with_something_else_in_it_is_refused(problems, tmp_path, capsys):
    file, out = tmp_path / "entry.json", tmp_path / "out"
    file.write_text(json.dumps(entry_of(problems, answer())))
    out.mkdir()
    (out / "old.judged.json").write_text("{}")
    assert main(["judge", str(file), "--problems", str(problems), "--out", str(out)]) == 2
    assert "old.judged.json: format: must be 'safe-ompl judged entry'" in capsys.readouterr().err


def test_problem_sets_of_one_name_are_refused(problems, tmp_path, capsys):
    assert main(["judge", "x.json", "--problems", str(problems), str(problems), "--out", str(tmp_path)]) == 2
    assert f"{problems}: another problem set has this name" in capsys.readouterr().err


def test_an_answer_that_is_given_twice_is_refused(problems, tmp_path):
    file = tmp_path / "twice.json"
    file.write_text(json.dumps(entry_of(problems, answer(), answer())))
    with pytest.raises(ValueError, match=r"answers\[1\].problem: 'pole 1' with seed 0 is there twice"):
        Entry.load(file, [ProblemSet.load(problems)])


def test_a_path_outside_the_limits_counts_as_none(problems, tmp_path):
    middle = [0.0, 0.3, 0.0, 0.5, 0.0, 1.9, 0.8]  # the fourth joint must be below −0.07
    file = tmp_path / "far.json"
    file.write_text(json.dumps(entry_of(problems, answer([LEFT, middle, RIGHT]))))
    (row,) = Entry.load(file, [ProblemSet.load(problems)]).judged()["rows"]
    assert not row["solved"]
    assert "joint 'panda_joint4' is 0.57 outside its limits" in row["error"]


PERSON = (0.75, 0.0, 0.15)  # [m] where the hip of the person is


@pytest.fixture
def drives(robot, tmp_path):
    """Write a file of one drive: two seconds beside a person who stands still in front of the arm."""
    skeleton = find_skeleton("recording12")
    standing = {"hip": PELVIS, "torso": [0, 0, 0.65], "neck": [0, 0, 0.82], "head": STANDING["head"]}
    bones = {"collar": "shoulder", "upper_arm": "shoulder", "forearm": "elbow", "hand": "wrist"}
    standing |= {f"{s}_{b}": STANDING[f"{s}_{j}"] for s in ("left", "right") for b, j in bones.items()}
    frame = 1.75 * np.array([standing[name] for name in skeleton.points]) - [0, 0, 1.75 * PELVIS[2]]
    np.savez(
        tmp_path / "still.npz", names=np.array(skeleton.points), rate=20.0, clip_0=np.array([frame] * 10)
    )
    drive = {"name": "still", "recording": "still.npz", "sha256": checksum(tmp_path / "still.npz")}
    drive |= {"clip": "clip_0", "gate": 6.0, "place": Pose(PERSON, (0, 0, 1, 0)).to_mapping()}
    drive |= {"seconds": 2.0, "start": LEFT, "goals": [AROUND[1], LEFT]}
    content = {
        "format": "safe-ompl drives",
        "robot": "panda",
        "scene": carried_scene(Scene()),
        "drives": [drive],
    }
    file = tmp_path / "drives.json"
    file.write_text(json.dumps(content))
    return file


@pytest.mark.parametrize(
    ("goes", "times", "contacts", "tasks"),
    [
        ([LEFT, AROUND[1], LEFT], [0.0, 1.0, 2.0], 0, 2),
        ([LEFT, RIGHT, RIGHT], [0.0, 1.0, 2.0], 3, 0),  # with three limbs, one after the other
    ],
)
def test_drives_are_judged_beside_people(goes, times, contacts, tasks, drives, robot, tmp_path):
    motion = Motion.through(goes, times, names=robot.joint_names)
    answers = {"problem": "still", "motion": marked("motion", motion.to_mapping())}
    file = tmp_path / "driven.json"
    file.write_text(json.dumps(entry_of(drives, answers)))
    entry = Entry.load(file, [ProblemSet.load(drives)])
    (row,) = entry.judged()["rows"]
    assert row["solved"], row["error"]
    assert (row["contacts_while_moving"], row["contacts_at_rest"], row["tasks"]) == (contacts, 0, tasks)
    assert row["touching"] == bool(contacts)
    assert (row["nearest"] <= 0) == bool(contacts)
    if contacts:
        assert row["worst"]["other"].startswith("person ")
        assert 0.2 < row["contact_speed"] < 3.0  # the first joint turns by 2 rad/s, the hand is 0.6 m from it
        out = tmp_path / "judged"
        assert main(["judge", str(file), "--problems", str(drives), "--out", str(out)]) == 1
        assert (out / "driven.webp").stat().st_size > 2000


@pytest.mark.parametrize(
    ("goes", "times", "error"),
    [([LEFT, LEFT], None, "must have times"), ([LEFT, LEFT], [0.0, 1.0], "last 2 s at least, got 1 s")],
)
def test_drives_need_times_and_last(goes, times, error, drives, robot, tmp_path):
    motion = Motion.through(goes, times, names=robot.joint_names)
    file = tmp_path / "short.json"
    answers = {"problem": "still", "motion": marked("motion", motion.to_mapping())}
    file.write_text(json.dumps(entry_of(drives, answers)))
    with pytest.raises(ValueError, match=error):
        Entry.load(file, [ProblemSet.load(drives)])


def test_a_drive_that_no_motor_follows_counts_as_none(drives, robot, tmp_path):
    motion = Motion.through([LEFT, AROUND[1], AROUND[1]], [0.0, 0.3, 2.0], names=robot.joint_names)
    file = tmp_path / "fast.json"
    answers = {"problem": "still", "motion": marked("motion", motion.to_mapping())}
    file.write_text(json.dumps(entry_of(drives, answers)))
    (row,) = Entry.load(file, [ProblemSet.load(drives)]).judged()["rows"]
    assert not row["solved"]
    assert "of its largest speed" in row["error"]


def test_another_recording_is_refused(drives, tmp_path):
    with (tmp_path / "still.npz").open("ab") as stream:
        stream.write(b"x")
    with pytest.raises(ValueError, match=r"drives\[0\].sha256: is not that of"):
        ProblemSet.load(drives)
