"""Each bench runs in miniature, prints what it found and writes it as JSON."""

import json
from dataclasses import replace

import numpy as np
import pytest

from bench import _harness, all as every, fresh, worth
from bench._harness import Report, bench, in_turn, markdown_table, names, run
from bench.all import Measurement
from safe_ompl import plan_program
from safe_ompl.live import find_skeleton
from safe_ompl.scene.constraints import CONTACT_TABLE

# Some benches clone the repository or list its files. An unpacked sdist is no repository.
IN_GIT = pytest.mark.skipif(not (every.ROOT / ".git").exists(), reason="not a checkout of git")

POLE = {"name": "pole", "radius": 0.05, "length": 1.0, "position": [0.5, 0.0, 0.5]}
POLE |= {"orientation_quat_xyzw": [0, 0, 0, 1]}
ENDS = {"start": [1.0, 0.3, 0.0, -1.6, 0.0, 1.9, 0.8], "goals": [[-1.0, 0.3, 0.0, -1.6, 0.0, 1.9, 0.8]]}


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """Return a folder with a problem of MotionBenchMaker, recordings of people who sway, and a URDF."""
    folder = tmp_path_factory.mktemp("bench")
    problem = {"index": 1, "cylinder": [POLE], **ENDS}
    (folder / "problems.json").write_text(json.dumps({"robot": "panda", "problems": {"pole": [problem]}}))
    skeleton, frame = find_skeleton("recording12"), np.zeros((12, 3))
    frame[:, 2] = np.linspace(0.0, 0.7, 12)
    frame[[5, 6, 7], 1], frame[[9, 10, 11], 1] = 0.2, -0.2
    for name in ("one", "two"):
        frames = frame + 0.05 * np.sin(np.arange(20))[:, None, None] * frame
        clips = {"clip_0": frames, "clip_1": frames}
        np.savez(folder / f"{name}.npz", names=np.array(skeleton.points), rate=20.0, **clips)
    arm = every.ROOT / "scenarios" / "robots" / "planar2.urdf"
    (folder / "arm.urdf").write_text(arm.read_text())
    return folder


SMALL = {
    "all": None,  # below
    "certify": "--edges 14 --hard 14 --paths 1 --only verdicts hard danger",
    "fresh": None,  # test_a_fresh_machine_has_what_its_row_says
    "hard": "--problems 0:1 --time 1 --families RRTConnect",
    "live": "{files} --sample 1 --places 1 --seconds 0.5 --policies ours,half-speed,alone",
    "motion": "--edges 2 --rounds 2",
    "motions": "--number 12 --splines 1 --tubes 6 --repairs 1",
    "mutations": "--number 2",
    "pages": "danger free_bubbles",
    "peers": None,  # tests/bench/test_bench_peers.py
    "physics": "--motions 1 --drives 1 --seconds 0.5",
    "planners": "planar2 random {files}/problems.json --problems 0:1 --families RRTConnect --pairs ours crossed",
    "programs": "--programs xarm7_inspection --seeds 1",
    "robots": "{files}/arm.urdf",
    "same": None,  # tests/bench/test_bench_same.py
    "scaling": "--nodes 20 --obstacles 1 2 --cloud 40 --points 1 --joints 2",
    "shield": "{files} --sample 1 --seconds 0.3 --filters shield,none",
    "stops": "--stops 8 --motions 2",
    "timing": "--paths 2 --curves 2",
    "tools": "--lines 4 --seams 1 --corridors 8",
    "ways": "--scenes 0:2 --seeds 1",
    "worth": "--scenes 1 --seconds 0.5",
}


def test_all_benches_are_here():
    assert names() == sorted(SMALL)
    assert all(all(_harness.about(name)) for name in names())


SHRUNK = {  # what has no option
    "motions": {"LENGTHS": (0.05, 0.2), "STEP": 0.002},
    "physics": {"ROBOTS": {"ur5": [4.0] * 6}, "FIRST": 1, "CONTACT_TABLE": {"chest": CONTACT_TABLE["chest"]}},
    "programs": {  # the first two steps; tests/test_physics.py drives all
        "plan_program": lambda one, **more: plan_program(
            replace(one, program=replace(one.program, steps=one.program.steps[:2])), **more
        )
    },
    "stops": {"CASES": bench("stops").CASES[3:5], "FASTER": (1.1,), "STOPS_OF_EACH": 2},
    "timing": {"ROBOTS": ("panda", "ur5")},
    "worth": {"METHODS": ("ours", "RRTConnect", "bound")},
}


@pytest.mark.parametrize("name", [name for name, words in SMALL.items() if words is not None])
def test_a_bench_in_miniature(name, files, tmp_path, monkeypatch):
    for key, value in {**SHRUNK.get(name, {}), **({"OUT": tmp_path} if name == "pages" else {})}.items():
        monkeypatch.setattr(bench(name), key, value)
    if name in ("physics", "programs"):
        pytest.importorskip("mujoco")
    words = SMALL[name].format(files=files).split()
    assert run([name, *words, "--json", str(tmp_path / "found.json")]) == 0
    found = json.loads((tmp_path / "found.json").read_text())
    assert found["command"].startswith(f"python -m bench {name}")
    for table in found["tables"]:
        assert table["rows"]
        assert {len(row) for row in table["rows"]} == {len(table["header"])}


@IN_GIT
def test_a_fresh_machine_has_what_its_row_says(tmp_path, monkeypatch):
    commands = tmp_path / "commands"
    commands.mkdir()
    for name in ("gcc", "x86_64-linux-gnu-gcc-12", "c++", "git", "python3"):
        (commands / name).touch()
    with monkeypatch.context() as patched:
        patched.setenv("PATH", str(commands))
        fresh.link_tools(fresh.Machine("no compiler", compiler=False), tmp_path / "tools")
    assert {file.name for file in (tmp_path / "tools").iterdir()} == {"git", "python", "python3"}
    first, second = fresh.readme_commands()
    assert "compare" in first
    assert "pytest" in second
    seconds, ending = fresh.seconds_of(fresh.Machine("usual"), "echo no disk >&2; exit 3")
    assert seconds < fresh.PATIENCE
    assert ending == "status 3: no disk"


def test_what_is_not_there_is_said(capsys):
    assert run(["no_such_bench"]) == 2
    assert "there are all, certify, " in capsys.readouterr().err
    assert run([]) == 0
    assert [line.split()[0] for line in capsys.readouterr().out.splitlines()] == names()


def test_a_bench_that_fails_says_so(monkeypatch, tmp_path):
    monkeypatch.setattr(bench("same"), "runs", lambda only: iter([("one", {"planned": "a"})]))
    (tmp_path / "before.json").write_text(json.dumps({"one": {"planned": "b"}}))
    assert run(["same", "--against", str(tmp_path / "before.json")]) == 1


def test_calls_take_turns_after_one_to_warm_up():
    said = []
    times = in_turn({"a": lambda: said.append("a"), "b": lambda: said.append("b")}, 1, 2)
    assert said == list("ababab")
    times.rounds.update({"a": [1.0, 2.0, 9.0], "b": [2.0, 2.0, 3.0]})
    assert (times.microseconds("a"), times.ratio("a", "b")) == (2e6, 1.0)


def test_a_file_has_what_was_found(tmp_path, monkeypatch):
    monkeypatch.setattr(_harness, "strftime", lambda _: "2030-01-01")
    report = Report()
    report.figure("n", np.int64(3))
    report.counted("edges", 7, 0, 1)
    report.table(("x", "y"), [("a", np.float64(0.12345))])
    report.write(tmp_path / "found.json", ["name", "--n", "3"])
    assert json.loads((tmp_path / "found.json").read_text()) == {
        **{"command": "python -m bench name --n 3", "date": "2030-01-01", "figures": {"n": 3}},
        **{"counted": [["edges", 7, 0, 1]]},
        "tables": [{"title": "", "header": ["x", "y"], "rows": [["a", 0.12345]]}],
    }
    assert markdown_table(("x", "y"), [("a", 0.12345)]) == "| x | y |\n| --- | --- |\n| a | 0.123 |"


def test_pages_are_what_the_files_say():
    for file, text in every.pages(every.read(every.KEPT)).items():
        assert file.read_text(encoding="utf-8") == text, f"{file.name}: python -m bench all --pages"


def test_every_bench_is_measured_for_the_pages():
    commands = [each.command.replace("DATA", "data").split() for each in every.listed().values()]
    assert {name for name, *_ in commands} == set(names()) - {"all", "fresh", "pages", "same"}
    for name, *words in commands:
        _harness.parser_of(name).parse_args(words)


def test_all_that_the_page_lists_was_measured_with_its_command_without_a_failure():
    found = every.read(every.KEPT)
    made = {name: (found[name]["command"], found[name]["failed"]) for name in every.listed() if name in found}
    assert made == {name: (each.shown, False) for name, each in every.listed().items()}


@IN_GIT
def test_what_was_measured_of_this_code_is_kept(tmp_path, capsys):
    one = Measurement("one", 1, True, "motion --only edges --edges 2 --rounds 1")
    others = [
        one._replace(name="two", command="motion --no-such-option"),
        one._replace(name="three", command="live DATA"),
    ]
    assert every.measure([one, *others], tmp_path, None) == ["two"]
    found = json.loads((tmp_path / "one.json").read_text())
    assert not found["failed"]
    assert found["tables"]
    assert found["versions"]["numpy"] == np.__version__
    assert str(tmp_path) not in json.dumps(found)
    assert "three: left out, needs --data" in capsys.readouterr().out
    assert every.measure([one], tmp_path, None) == []
    assert "one: kept" in capsys.readouterr().out
    (tmp_path / "one.json").write_text(json.dumps({**found, "code": "before"}))
    every.measure([one], tmp_path, None)
    assert "one: kept" not in capsys.readouterr().out
    assert json.loads((tmp_path / "one.json").read_text())["code"] == found["code"]


def test_a_page_shows_counts_and_the_last_rows_of_long_tables():
    found = {"command": "c", "date": "d", "seconds": 3, "failed": False, "figures": {"n": 3}}
    found["counted"] = [["edges", 7, 0, 1]]
    found["tables"] = [{"title": "", "header": ["x", "y"], "rows": [["a", 1], ["all", 2]]}]
    timed = {**found, "counted": []}
    text = every.pages({"edges": found, "motion": timed})[every.KEPT.with_suffix(".md")]
    assert "| edges | 7 | 0 | 1 |" in text
    # Counts are in their own table, so that only the bench without counts shows its rows.
    assert text.count("| all | 2 |") == 1
    assert "| a | 1 |" not in text


def test_the_median_counts_may_not_move_as_infinitely_long():
    ours = np.array([1.0, 2.0, 3.0, np.inf, np.inf, np.nan])
    theirs = np.array([2.0, 2.0, np.inf, 1.0, np.inf, 1.0])
    median, stuck, unsolved, ratio, moving, of_moving = worth.compared(ours, theirs)
    assert (median, stuck, unsolved, moving) == ("2.00", 2, 0, 2)
    assert (ratio, of_moving) == (0.75, 0.75)  # of 0.5, 1, 0 and +inf; of 0.5 and 1


def test_no_motion_is_shorter_than_the_bound():
    problem = next(worth.problems(0))
    bound = worth.duration(problem, "bound", 0, 1.0)
    found = worth.duration(problem, "RRTConnect", 0, 5.0)
    assert 0.5 < bound < found
