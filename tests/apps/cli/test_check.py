"""`safe-ompl check` and `tube`: what is proven, what is not and why, repairs in every form, and bad input in a line."""

import json

import numpy as np
import pytest
import yaml

from safe_ompl import Motion, PlanningError, read_motion, retime, save
from safe_ompl.drawing import ViewerContent, plots
from safe_ompl.motions.rates import extremes
from safe_ompl.planning import setup_scenario
from safe_ompl.scene import Scenario, find_scenario

NAMES = ("joint1", "joint2", "joint3")
START, END = np.array([1.25, -0.35, 0.2]), np.array([-1.2, 0.3, -0.25])
MIDDLE = np.array([-0.5, 2.2, -2.4])  # folded: it passes the ball
TOUCHING = MIDDLE + 0.35 * (0.5 * (START + END) - MIDDLE)
PLANAR = find_scenario("planar3").resolve().parent
T = np.array([0.0, 2.0, 4.0])


def scenario(**more):
    """Return the planar arm beside one ball."""
    robot = {key: str(PLANAR / "robots" / f"planar3.{key}") for key in ("urdf", "srdf")}
    ball = {"name": "ball", "sphere": {"radius": 0.1}, "position": [0.85, 0.0, 0.0], "weight": 1}
    start, goal = (dict(zip(NAMES, q.tolist(), strict=True)) for q in (START, END))
    return {
        "name": "own",
        "robot": {**robot, "tip": "tip"},
        "start": start,
        "goal": {"configuration": goal},
        "scene": {"obstacles": [ball]},
        **more,
    }


@pytest.fixture(autouse=True)
def own(tmp_path, monkeypatch):
    """Begin in a folder with a scenario `own.yaml`."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "own.yaml").write_text(yaml.safe_dump(scenario()))


@pytest.fixture(scope="module")
def setup(tmp_path_factory):
    file = tmp_path_factory.mktemp("own") / "own.yaml"
    file.write_text(yaml.safe_dump(scenario()))
    return setup_scenario(Scenario.load(file))


def motion(middle=MIDDLE, degree=3):
    """Return a motion from start to end by way of a configuration, with rates up to those of the degree."""
    points, slope = np.array([START, middle, END]), 0.25 * (END - START)
    rates = np.array([0 * slope, slope, 0 * slope])
    held = (rates, 0 * points)[: degree // 2]
    return Motion.hermite(T, points, *held, names=NAMES)


def table(file, columns):
    np.savetxt(file, np.column_stack([*columns.values()]), delimiter=",", header=",".join(columns), comments="")


def test_a_motion_is_proven_or_what_is_not_is_said(says, tmp_path, setup):
    save(motion(), "free.json")
    free = "check free.json --scenario own.yaml"
    says(f"{free} --widest-tube --json found.json", "proven: joint limits, no collision")
    found = json.loads((tmp_path / "found.json").read_text())
    width = found["widest_tube"]["joint1"]
    assert (found["proven"], found["violations"]) == (True, [])
    says(f"{free} --tube {0.99 * width}")
    says(f"{free} --tube {1.1 * width}", "clearance", status=1)
    save(motion(TOUCHING), "touching.json")
    record = json.loads(says("check touching.json --scenario own.yaml --json -", status=1))
    assert record["claims"] == ["joint limits", "no collision"]
    for violation in record["violations"]:
        q = motion(TOUCHING).at(violation["at"])
        distances = dict(zip(setup.checker.pair_names, setup.checker.pair_distances(q), strict=True))
        assert violation["value"] == pytest.approx(distances[tuple(violation["names"])])
    assert {violation["kind"] for violation in record["violations"]} == {"collision"}


def test_limits_are_the_scenarios_and_the_options(says):
    save(motion(), "free.json")
    fast = Motion.hermite(T / 20, *(motion().derivative(T, k) * 20**k for k in (0, 1)), names=NAMES)
    save(fast, "fast.json")
    says("check free.json --scenario own.yaml --limits")
    says("check fast.json --scenario own.yaml --limits", "velocity", "rad/s", status=1)
    says("check free.json --scenario own.yaml --min-clearance 0.2", "200 mm", status=1)


@pytest.mark.parametrize(("degree", "out"), [(1, "out.json"), (3, "out.csv"), (5, "out.npz"), (3, "out.yaml")])
def test_a_repair_is_written_in_the_form_that_is_asked_for_and_proven_as_it_is_read(says, tmp_path, setup, degree, out):
    save(motion(TOUCHING, degree), "touching.json")
    says(f"check touching.json --scenario own.yaml --repair {out}", notes=["proven; ", " rad and "])
    back = read_motion(tmp_path / out, setup.robot)
    says(f"check {out} --scenario own.yaml")
    np.testing.assert_allclose(back.at(T[[0, -1]]), [START, END], atol=1e-12)
    assert (back.degree, back.times[-1]) == (degree, T[-1])


def test_json_stays_a_message_where_the_file_is_one(says, tmp_path):
    instants = [{"sec": int(t), "nanosec": 0} for t in T]
    ways = zip((START, TOUCHING, END), instants, strict=True)
    points = [{"positions": q.tolist(), "time_from_start": instant} for q, instant in ways]
    (tmp_path / "ros.json").write_text(json.dumps({"joint_names": NAMES, "points": points}))
    says("check ros.json --scenario own.yaml --repair out.json")
    said = json.loads((tmp_path / "out.json").read_text())
    assert list(said) == ["joint_names", "points"]
    assert said["points"][-1] == {**points[-1], "positions": pytest.approx(points[-1]["positions"])}


def test_what_cannot_be_repaired_is_not_written(says, tmp_path):
    inside = np.array([0.0, 0.0, 0.0])  # in the ball
    save(Motion.through([START, inside], names=NAMES), "into.json")
    why = "safe-ompl: nothing is written to out.json: its end cannot be proven, and ends are kept"
    says("check into.json --scenario own.yaml --repair out.json", status=1, notes=[why])
    assert not (tmp_path / "out.json").exists()


def test_a_certificate_claims_what_is_written(says, tmp_path):
    save(motion(TOUCHING), "touching.json")
    command = "check touching.json --scenario own.yaml --certificate proof.json"
    says(command, status=1, notes=["safe-ompl: the motion is not proven: nothing is written to proof.json"])
    assert not (tmp_path / "proof.json").exists()
    says(f"{command} --repair out.json")
    says("verify proof.json", "polynomials in 4.000 s")


def test_bare_samples_are_proven_within_what_may_be_between(says, refuses, tmp_path):
    times = np.linspace(0.0, 4.0, 401)
    Q = motion().at(times)
    table(tmp_path / "samples.csv", {"time": times, **{name: Q[:, k] for k, name in enumerate(NAMES)}})
    command = "check samples.csv --scenario own.yaml --max-velocity"
    says(f"{command} 3")
    says(f"{command} joint1=34,joint2=3,joint3=3", "slack", status=1)
    refuses(f"{command} 0.5", "safe-ompl: samples.csv: samples: column ")


def test_a_page_and_a_plot_show_the_motion_and_what_is_not_proven(says, tmp_path):
    pytest.importorskip("viser")
    pytest.importorskip("matplotlib")
    save(motion(TOUCHING), "touching.json")
    says("check touching.json --scenario own.yaml --html page.html --plot plot.png", status=1)
    assert min((tmp_path / name).stat().st_size for name in ("page.html", "plot.png")) > 10_000
    (tmp_path / "own.yaml").write_text(yaml.safe_dump(scenario(limits={"min_clearance": 0.02})))
    found = setup_scenario(Scenario.load("own.yaml")).check(motion(TOUCHING))
    shown = ViewerContent.of_check(found, "it").motions["it"]
    said = [f"{found.violations[0].kind}: " in shown.remark(time) for time in (0.0, found.violations[0].at, T[-1])]
    assert said == [False, True, False]
    lines = {line.get_label(): line.get_ydata() for line in plots.plot_check(found, None).axes[-1].lines}
    assert lines["to obstacles, required"] == pytest.approx(20.0)
    assert lines["to obstacles"].min() == pytest.approx(1e3 * min(v.value for v in found.violations), abs=1.0)


PEOPLE = {"who": ["ball"], "speed": 1.0, "reaction_time": 0.1}


@pytest.fixture
def beside_people(tmp_path, call):
    """Write a scenario whose ball moves like a person, and a motion that takes 4 s, or 1.6 s."""
    accelerations = {"acceleration": 4.0, "velocity": 3.0}
    (tmp_path / "own.yaml").write_text(yaml.safe_dump(scenario(people=PEOPLE, motion=accelerations)))
    for name, seconds in (("slow", 4.0), ("fast", 1.6)):
        rest = np.zeros((2, 3))
        save(Motion.hermite([0.0, seconds], [START, START + 0.6 * (MIDDLE - START)], rest, names=NAMES), f"{name}.json")


@pytest.mark.usefixtures("beside_people")
def test_stops_beside_the_scenarios_people_are_proven(says, tmp_path):
    says("check slow.json --scenario own.yaml", "velocity, acceleration, no collision, stops beside people")
    says("check fast.json --scenario own.yaml --no-people --json found.json", "not looked at: --no-people")
    assert json.loads((tmp_path / "found.json").read_text())["claims"] == ["joint limits", "no collision"]
    says("check fast.json --scenario own.yaml", "separation", "ball", status=1)
    save(Motion.through([START, START + 0.1], names=NAMES), "path.json")
    says("check path.json --scenario own.yaml", "not looked at: the motion has no times")


@pytest.mark.usefixtures("beside_people")
def test_a_motion_that_is_too_fast_is_repaired_by_time(says, tmp_path, setup):
    notes = "the motion as it was, but ", " times as long as before"
    says("check fast.json --scenario own.yaml --repair out.csv", notes=notes)
    back, given = (read_motion(tmp_path / name, setup.robot) for name in ("out.csv", "fast.json"))
    assert 1.6 < back.times[-1] < 4.0
    shares = np.linspace(0.0, 1.0, 9)
    np.testing.assert_allclose(back.at(shares * back.times[-1]), given.at(shares * 1.6), atol=1e-9)
    says("check out.csv --scenario own.yaml")


@pytest.mark.usefixtures("beside_people")
def test_what_is_not_proven_beside_people_is_refused_in_a_line(refuses, tmp_path):
    slow = "check slow.json --scenario own.yaml"
    refuses(f"{slow} --certificate proof.json", "--certificate: certificates of motions cannot state stops")
    save(Motion.hermite([0.0, 4.0], [START, 0.9 * START], names=NAMES), "line.json")
    refuses("check line.json --scenario own.yaml", "line.json: motion: must end at rest")
    jerk = {"acceleration": 4.0, "velocity": 3.0, "jerk": 100.0}
    (tmp_path / "own.yaml").write_text(yaml.safe_dump(scenario(people=PEOPLE, motion=jerk)))
    refuses(slow, "motion.jerk: stops with a jerk limit")


# ------------------------------------------------------------------------------------------ way points timed anew

WAY = np.array([START, 0.5 * (START + MIDDLE), 0.4 * START + 0.6 * MIDDLE])


@pytest.mark.usefixtures("beside_people")
def test_way_points_are_timed_beside_people_within_limits_and_verified(says, tmp_path, setup):
    """What is written stops in time between its points, too, for which it may take a little longer."""
    command, names, alone = "check way.csv --scenario own.yaml --retime", ",".join(NAMES), set()
    for columns, header, options in (
        (WAY, "", f"--joints {names}"),
        (np.c_[T / 100, WAY], f"time,{names}", ""),
        (WAY, names, ""),
    ):
        np.savetxt("way.csv", columns, delimiter=",", header=header, comments="")
        says(f"{command} {options} --trajectory alone.csv --no-people --force")
        alone.add((tmp_path / "alone.csv").read_text())
    assert len(alone) == 1
    says(f"{command} --trajectory out.csv --certificate proof.json", "timed: ", "separation")
    says("verify proof.json own.yaml", "it stands before anyone of ball")
    says("check out.csv --scenario own.yaml", "velocity, acceleration, no collision, stops beside people")
    motions = [read_motion(tmp_path / name, setup.robot) for name in ("out.csv", "alone.csv")]
    assert motions[0].duration > 1.2 * motions[1].duration
    for found in motions:
        np.testing.assert_allclose(found.knots[[0, -1]], WAY[[0, -1]], atol=1e-9)
        for order, most in ((1, 3.0), (2, 4.0)):
            rates = extremes(found, order)
            assert max(rates.high.max(), -rates.low.min()) <= most * (1 + 1e-9)


BAD_WAYS = [
    ([START, np.zeros(3), MIDDLE], "way point 1 is not proven to be free: link"),
    ([START, [9.0, 0.0, 0.0]], "way point 1: joint 'joint1' = 9 is outside its limits"),
    ([MIDDLE, START, END], "between way points 1 and 2, at 1."),
]


@pytest.mark.parametrize(("way", "said"), BAD_WAYS)
def test_a_bad_way_point_is_named_and_nothing_is_written(says, tmp_path, setup, way, said):
    save(Motion.through(way, names=NAMES), "way.json")
    command = "check way.json --scenario own.yaml --trajectory out.csv --certificate proof.json"
    says(command, status=1, notes=[f"safe-ompl: way.json: {said}"])
    assert {file.name for file in tmp_path.iterdir()} == {"own.yaml", "way.json"}
    with pytest.raises(PlanningError, match=said):
        retime(way, setup.robot, setup.scene)


# ---------------------------------------------------------------------------------------------------- the tube


def log(file, errors, times, shift=0.0):
    Q = motion().at(times)
    columns = {"time": times + shift}
    for k, name in enumerate(NAMES):
        columns |= {f"{name}_commanded": Q[:, k], f"{name}_measured": Q[:, k] + errors[:, k]}
    table(file, columns)


def test_the_tube_is_the_largest_error_times_a_factor_and_check_takes_it(call, says, tmp_path):
    times = np.linspace(0.0, 4.0, 81)
    errors = np.outer(np.sin(np.pi * times / 4), [0.01, 0.002, 0.0])
    log(tmp_path / "log.csv", errors, times)
    logged = np.genfromtxt("log.csv", delimiter=",", names=True)
    np.savez("log.npz", **{name: logged[name] for name in logged.dtype.names})
    answers = {name: call("tube", name, "--factor", "2") for name in ("log.csv", "log.npz")}
    assert answers["log.csv"] == answers["log.npz"]
    status, out, err = answers["log.csv"]
    assert (status, err) == (0, "")
    assert "81 samples" in out
    assert "2.000" in out
    option, entry = out.splitlines()[-2:]
    widths = dict(part.split("=") for part in option.removeprefix("--tube ").split(","))
    assert 0.02 <= float(widths["joint1"]) <= 0.0201
    assert 0.004 <= float(widths["joint2"]) <= 0.00402
    save(motion(), "free.json")
    says(f"check free.json --scenario own.yaml {option}")
    (tmp_path / "own.yaml").write_text(yaml.safe_dump(scenario(**yaml.safe_load(entry))))
    says("check free.json --scenario own.yaml", f"within a tube of ±[{float(widths['joint1']):.3g}, ")
    other = np.outer(np.cos(np.pi * times / 8), [0.003, 0.006, 0.0])
    log(tmp_path / "other.csv", other, times)
    _, out, _ = call("tube", "log.csv", "other.csv")
    rows = [line.split() for line in out.splitlines() if line.startswith("joint")]
    assert [row[-1] for row in rows[1:3]] == ["log.csv", "other.csv"]


def test_two_files_are_compared_at_equal_times(says, tmp_path):
    """A measurement at other instants is no error; one that is late is."""
    fine, coarse = np.linspace(0, 4, 801), np.linspace(0.003, 3.9, 333)
    for name, times, late in (("asked", fine, 0.0), ("same", coarse, 0.0), ("late", coarse, 0.01)):
        Q = motion().at(times - late)
        table(tmp_path / f"{name}.csv", {"time": times, **{joint: Q[:, k] for k, joint in enumerate(NAMES)}})
    largest = {}
    for name in ("same", "late"):
        out = says(f"tube --commanded asked.csv --measured {name}.csv")
        largest[name] = float(next(line for line in out.splitlines() if line.startswith("joint2")).split()[-1])
    fastest = np.abs(motion().derivative(fine)[:, 1]).max()
    assert largest["same"] < 5e-4
    assert 1.5 * 0.01 * fastest <= largest["late"] <= 1.5 * 0.01 * fastest + 5e-4


# --------------------------------------------------------------------------------------------------- bad input


def test_files_of_another_kind_are_refused_and_nothing_is_written(refuses, tmp_path, setup):
    save(setup.scene, "scene.json")
    save(Motion.through([START, MIDDLE], names=NAMES), "path.json")
    how = "--scenario own.yaml --json found.json"
    said = "safe-ompl: scene.json: kind: must hold a motion, but it holds a scene"
    refuses(f"check scene.json {how} --repair out.csv", said)
    refuses(f"check path.json {how} --limits", "safe-ompl: --limits: path.json: has no times")
    assert {file.name for file in tmp_path.iterdir()} == {"own.yaml", "scene.json", "path.json"}


BAD_OPTIONS = [
    (("--repair", "out.npy"), "--repair: 'out.npy' must end in .csv or .tsv or .txt or .npz or .json or .yaml"),
    (("--repair", "a.json", "--json", "a.json"), "--json: 'a.json' is written by --repair already: give another"),
    (("--tube", "wide"), "argument --tube: must be a positive number, not 'wide'"),
    (("--tube", "joint1=0.1"), "--tube: no value for 'joint2', 'joint3'"),
    (("--tube", "elbow=0.1"), "--tube: unknown joint 'elbow'; known: joint1, joint2, joint3"),
    (("--tube", "joint1=0.1,joint1=0.2"), "argument --tube: 'joint1' is given twice"),
    (("--max-velocity", "3"), "--max-velocity: free.json: is only for timed samples without velocities"),
    (("--retime", "--repair", "out.json"), "--repair: is for a motion with its own times: leave out --retime"),
    (("--retime", "--widest-tube"), "--widest-tube: is for a motion with its own times: leave out --retime"),
    (("--rate", "50"), "--rate: needs a timed trajectory: give --trajectory FILE, too"),
]


@pytest.mark.parametrize(("options", "said"), BAD_OPTIONS)
def test_options_that_cannot_be(refuses, tmp_path, options, said):
    save(motion(), "free.json")
    refuses(("check", "free.json", "--scenario", "own.yaml", *options), said)
    assert {file.name for file in tmp_path.iterdir()} == {"free.json", "own.yaml"}


NO_LOGS = [
    ("time,joint1_commanded", ("log.csv",), "log.csv: joint1_measured: missing"),
    ("joint1_commanded,joint1_measured", ("log.csv",), "log.csv: time: missing"),
    ("time,joint1", ("log.csv",), "log.csv: columns: must contain <joint>_commanded and <joint>_measured, got none"),
    ("time,joint1", ("log.json",), "log.json: must be a log, with one of the endings .csv, .tsv, .txt, .npz"),
    ("time,joint1", (), "give logs, or both --commanded and --measured"),
    ("time,joint1", ("--measured", "log.csv"), "give logs, or both --commanded and --measured"),
    ("time,joint1", ("log.csv", "--measured", "log.csv"), "give logs, or both --commanded and --measured"),
    ("time,joint1_commanded,joint1_measured", ("log.csv", "--factor", "0.5"), "factor: must be"),
    ("time,joint1_commanded,joint1_measured", ("log.csv", "--degrees"), "--degrees: needs the robot"),
]


@pytest.mark.parametrize(("header", "arguments", "said"), NO_LOGS)
def test_logs_that_are_none(refuses, tmp_path, header, arguments, said):
    row = ",".join("0" * len(header.split(",")))
    (tmp_path / "log.csv").write_text("\n".join([header, row, row.replace("0", "1"), row.replace("0", "2")]))
    refuses(("tube", *arguments), said)
