"""The simulation: its files, its contact monitor, and faults that are answered by a stop."""

import json
from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

from safe_ompl import InputError, People, Tracker
from safe_ompl.apps import main
from safe_ompl.apps.cli.program import command_line
from safe_ompl.geometry import STANDING
from safe_ompl.io import built_robot, built_scene, read_ticks
from safe_ompl.people import KEYPOINTS, CalibratedReach, Recording, TrackedBody, find_skeleton
from safe_ompl.people.calibration import measured_limbs
from safe_ompl.people.simulation import ContactMonitor, Drifting, Faults, Playback, Simulation, limb_solids
from safe_ompl.scene import find_scenario

RECORDING = find_skeleton("recording12")


def swaying(seconds=6.0, rate=20.0, far=1.1, speed=1.0):
    """Return frames (T, 12, 3) of a person who sways to and fro beside the arm, the hip near the floor of the frame."""
    height, hips = 1.75, STANDING["left_hip"][2]
    ours = {"hip": None, "torso": None, "neck": None, "head": "head"}
    places = []
    for name in RECORDING.points:
        side, _, bone = name.partition("_")
        joint = {"upper_arm": "shoulder", "forearm": "elbow", "hand": "wrist"}.get(bone)
        key = ours.get(name) or (f"{side}_{joint}" if joint else None)
        place = STANDING[key] if key else np.array([0.0, 0.0, hips if name == "hip" else 0.8])
        places.append(height * (place - [0, 0, hips]))
    times = np.arange(round(seconds * rate)) / rate
    shift = np.stack([far + 0.25 * np.sin(speed * times), 0 * times, 0.15 + 0 * times], axis=1)
    return np.array(places)[None] * [-1, -1, 1] + shift[:, None]


@pytest.fixture(scope="session")
def clips(tmp_path_factory):
    """Return a file with two clips: one of a person who keeps to the promised speed, one of a person who does not."""
    file = tmp_path_factory.mktemp("people") / "swaying.npz"
    names = np.array(RECORDING.points)
    np.savez(file, names=names, rate=20.0, clip_0=swaying().astype(np.float16), clip_1=swaying(speed=15.0))
    return file


def simulated(replanner_for, to_and_fro, clips, clip="clip_0", **options):
    recording = Recording.load(clips, clip)
    tracker = Tracker(recording.skeleton, noise=options.get("faults", Faults()).noise)
    replanner = replanner_for("anna", trackers={"anna": tracker})
    return Simulation(replanner, to_and_fro(replanner), {"anna": Playback(recording, tracker)}, **options)


def test_nobody_who_obeys_is_touched_and_tasks_are_done(replanner_for, to_and_fro, clips):
    one = simulated(replanner_for, to_and_fro, clips)
    summary = one.run(6.0)
    assert summary.contacts_while_moving == 0
    assert summary.model_obeyed == pytest.approx(1.0)
    assert summary.least_distance > 0
    assert summary.violations == summary.deadlines_missed == 0
    assert 0 < summary.moving <= 1
    assert one.summary.as_dict()["reaction"]["median"] > 0


def test_the_same_world_gives_the_same_ticks(replanner_for, to_and_fro, clips):
    faults = Faults(noise=0.005, drops=0.1, late=0.1, seed=3)
    runs = []
    for _ in range(2):
        ticks = list(simulated(replanner_for, to_and_fro, clips, faults=faults).ticks(2.0))
        runs.append([{key: value for key, value in tick.items() if key != "reaction"} for tick in ticks])
    assert runs[0] == runs[1]


def test_all_that_a_tick_says_is_of_one_instant(replanner_for, to_and_fro, clips):
    one = simulated(replanner_for, to_and_fro, clips)
    ticks = list(one.ticks(4.0))
    monitor, body = ContactMonitor(one.replanner.robot), one.world.people["anna"].tracker.body
    moved = 0
    for tick in ticks:
        q, points = np.array(tick["q"]), np.array([tick["people"]["anna"][name] for name in KEYPOINTS])
        nearest = monitor.nearest(q, limb_solids("anna", body, points))
        assert nearest.distance == pytest.approx(tick["distance"], abs=1e-12)
        assert (nearest.link, nearest.who) == (tick["link"], tick["who"])
        if tick["state"] in ("standing", "done"):
            assert not any(tick["qd"])
        moved += any(tick["qd"])
    assert moved > 30
    assert {tick["path"] for tick in ticks if "ahead" in tick} == {tick["path"] for tick in ticks}


def test_who_is_faster_than_promised_is_seen_and_answered_by_a_stop(replanner_for, to_and_fro, clips, caplog):
    one = simulated(replanner_for, to_and_fro, clips, "clip_1")
    ticks = list(one.ticks(3.0))
    assert one.summary.violations > 5
    assert one.summary.model_obeyed < 0.9
    assert "farther than promised: stop" in caplog.text
    answered = [tick for tick in ticks if "farther than promised" in tick["reason"]]
    assert answered
    assert {tick["state"] for tick in answered} <= {"braking", "standing"}


def test_noise_drops_and_late_answers_touch_nobody(replanner_for, to_and_fro, clips):
    faults = Faults(noise=0.02, drops=0.2, late=0.2, seed=1)
    one = simulated(replanner_for, to_and_fro, clips, faults=faults)
    summary = one.run(4.0)
    assert summary.contacts_while_moving == 0
    assert summary.deadlines_missed > 5
    assert summary.model_obeyed == pytest.approx(1.0)
    assert summary.violations == 0


def reach_with_a_gate(speed=2.0):
    """Return a reach that says no more than its gate does, of the limbs of the recordings."""
    growth = dict.fromkeys(measured_limbs(RECORDING), (0.5 * speed,))
    return CalibratedReach("recording12", speed, 0.9, 20, (0.5,), growth, ("a",), ("b",))


def test_glitches_that_the_gate_refuses_are_not_where_people_are(replanner_for, to_and_fro, clips, tmp_path):
    recording, reach = Recording.load(clips, "clip_0"), reach_with_a_gate()
    frames = recording.frames.copy()
    frames[20:100:7, 9:] += [-0.9, 0.0, 0.3]  # the right arm is in the robot, each time for a frame
    recording = replace(recording, frames=frames)
    tracker = Tracker(RECORDING, TrackedBody(only=reach.limbs), gate=reach.gate)
    reach.save(tmp_path / "reach.yaml")
    people = People(speed=1.6, reach=tmp_path / "reach.yaml")
    replanner = replanner_for("anna", trackers={"anna": tracker}, people=people)
    one = Simulation(replanner, to_and_fro(replanner), {"anna": Playback(recording, tracker)})
    summary = one.run(4.0)
    assert summary.model_obeyed == pytest.approx(1.0)
    assert summary.model_obeyed_raw < 0.9
    assert 0 < summary.refused < 0.1
    assert summary.contacts_while_moving == summary.contacts_after_violations == summary.violations == 0
    time = 27 / 20
    shown, true = (one.world.keypoints(time, glitches=glitches)["anna"] for glitches in (True, False))
    wrist = KEYPOINTS.index("right_wrist")
    assert np.linalg.norm(shown[wrist] - true[wrist]) == pytest.approx(0.95, abs=0.02)
    with pytest.raises(InputError, match="anna: the reach was calibrated with"):
        replanner_for("anna", people=people)


def test_the_command_takes_a_reach_with_its_gate(clips, tmp_path, capsys):
    reach_with_a_gate().save(tmp_path / "reach.yaml")
    words = ["live", "panda_shelf", "--people", str(clips), "--place", "0.2,0.6,0,0.3", "--seconds", "1"]
    words += ["--out", str(tmp_path / "out"), "--reach"]
    assert main([*words, str(tmp_path / "reach.yaml"), "--clip", "clip_1", "--faster", "2"]) == 0
    assert "% of the key points that the gate refused)" in " ".join(capsys.readouterr().out.split())
    assert json.loads((tmp_path / "out" / "summary.json").read_text())["refused"] > 0
    assert main([*words, str(tmp_path / "none.yaml")]) == 2
    assert "--reach: '" in " ".join(capsys.readouterr().err.split())


def test_the_monitor_notes_contacts_once_and_whether_the_robot_moved(panda, tracker):
    monitor, q = ContactMonitor(panda), np.array([0, -0.4, 0, -2.0, 0, 2.0, 0.785])
    tip = panda.tip_pose(q).translation
    body, points = TrackedBody(only=("right_hand",)), np.zeros((18, 3))
    points[[KEYPOINTS.index("right_wrist"), KEYPOINTS.index("right_hand")]] = tip, tip + np.array([0, 0, 0.1])
    touching, away = limb_solids("anna", body, points), limb_solids("anna", body, points + np.array([2.0, 0, 0]))
    assert monitor.observe(0.0, q, away, moving=True, obeyed=True).distance > 1
    for time, moving in ((0.1, False), (0.2, False), (0.3, True)):
        assert monitor.observe(time, q, touching, moving=moving, obeyed=True).distance <= 0
    monitor.observe(0.4, q, away, moving=True, obeyed=True)
    monitor.observe(0.5, q, touching, moving=False, obeyed=True)
    found = [(c.time, c.moving, c.limb) for c in monitor.contacts]
    assert found == [(0.1, True, "right_hand"), (0.5, False, "right_hand")]


def test_things_that_drift_stay_in_their_room():
    rng, room = np.random.default_rng(0), np.array([[-1.0, -0.5, 0.0], [1.0, 0.5, 2.0]])
    for _ in range(10):
        velocity, start = rng.normal(size=3), pin.SE3(np.eye(3), rng.uniform(*room))
        ball = Drifting(start, velocity, room)
        np.testing.assert_allclose(ball.at(0.0).translation, start.translation)
        places = np.array([ball.at(t).translation for t in np.linspace(0, 20, 2001)])
        assert (places >= room[0]).all()
        assert (places <= room[1]).all()
        assert np.linalg.norm(np.diff(places, axis=0), axis=1).max() <= 0.01 * np.linalg.norm(velocity) * (1 + 1e-9)
    assert Drifting(start).at(7.0) is start


def test_recordings_are_read_and_played_to_and_fro(clips):
    recording = Recording.load(clips)
    assert recording.duration == pytest.approx(5.95)
    np.testing.assert_allclose(recording.at(0.05), recording.frames[1])
    np.testing.assert_allclose(recording.at(0.025), recording.frames[:2].mean(axis=0))
    np.testing.assert_allclose(recording.at(2 * recording.duration - 0.05), recording.frames[1], atol=1e-9)


def test_recordings_that_are_none(clips, tmp_path):
    with pytest.raises(InputError, match=r"swaying.npz: unknown clip 'clip_7'; did you mean 'clip_1'"):
        Recording.load(clips, "clip_7")
    text = tmp_path / "text.npz"
    text.write_text("nothing")
    for file in (text, tmp_path / "missing.npz"):
        with pytest.raises(InputError, match=f"{file.name}: (cannot be read|is no archive)"):
            Recording.load(file)
    good = {"names": np.array(RECORDING.points), "rate": 20.0, "clip_0": swaying()}
    nan = swaying()
    nan[3, 2] = np.inf
    for change, message in (
        ({"rate": -1.0}, "rate: must be a positive number"),
        ({"names": np.array(["a", "b"])}, "names: no skeleton has the 2 key points"),
        ({"clip_0": np.zeros((5, 3, 3))}, r"clip_0: must have shape \(any, 12, 3\)"),
        ({"clip_0": nan}, "clip_0: key points must be finite"),
        ({"clip_0": np.zeros((0, 12, 3))}, "clip_0: has no frames"),
    ):
        np.savez(tmp_path / "bad.npz", **{**good, **change})
        with pytest.raises(InputError, match=f"bad.npz: {message}"):
            Recording.load(tmp_path / "bad.npz")
    np.savez(tmp_path / "bad.npz", names=good["names"], clip_0=good["clip_0"])
    with pytest.raises(InputError, match=r"bad.npz: rate: missing, but needed"):
        Recording.load(tmp_path / "bad.npz")


def test_the_command_writes_ticks_and_a_summary(clips, tmp_path, capsys):
    out = tmp_path / "out"
    words = ["live", "panda_shelf", "--people", str(clips), "--place", "0.2,0.6,0,0.3", "--seconds", "2"]
    assert main([*words, "--out", str(out), "--noise", "0.01"]) == 0
    assert "contacts while moving 0" in " ".join(capsys.readouterr().out.split())
    summary = json.loads((out / "summary.json").read_text())
    keys = "contacts_while_moving contacts_at_rest model_obeyed tasks stops reaction deadlines_missed"
    assert set(keys.split()) <= set(summary)
    assert set(summary["reaction"]) == {"median", "p99"}
    header, ticks = read_ticks(out / "ticks.jsonl")
    assert built_robot(header["robot"]).joint_names == tuple(header["joint_names"])
    assert "operator" not in built_scene(header["scene"]).names
    assert len(ticks) == 40
    assert list(ticks[0]["people"]["operator"]) == list(KEYPOINTS)
    assert ticks[1]["state"] in ("moving", "slowed", "standing")
    with pytest.raises(InputError, match=r"header\.format: must be 'safe-ompl ticks', got None"):
        read_ticks(out / "summary.json")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (["--clip", "clip_9"], "unknown clip 'clip_9'"),
        (["--place", "1,2,3"], "--place: must be four finite numbers X,Y,Z,YAW"),
        (["--noise", "-1"], "--noise: must be a finite number >= 0"),
        (["--drops", "2"], "--drops: must be a share in [0, 1]"),
        (["--seconds", "0"], "positive number of seconds"),
        (["--people", "nowhere.npz"], "there is no file 'nowhere.npz'"),
        (["--people", "random:0"], "random:N with a whole number N of at least 1, not 'random:0'"),
        (["--people", "random", "--clip", "clip_0"], "--clip: is for recordings, not for 'random'"),
        (["--html", "page.txt"], "--html: 'page.txt' must end in .html"),
        (["--movers", "0"], "a whole number of at least 1"),
        (["--mover-speed", "-1"], "a positive number"),
    ],
)
def test_the_command_refuses_in_one_line(clips, tmp_path, capsys, change, message):
    words = ["live", "panda_shelf", "--people", str(clips), "--out", str(tmp_path), *change]
    assert main(words) == 2
    error = capsys.readouterr().err
    assert message in error
    assert len(error.strip().splitlines()) == 1


def test_the_recorded_person_stands_where_the_scenario_has_somebody(clips, tmp_path):
    assert main(["live", "panda_shelf", "--people", str(clips), "--seconds", "0.1", "--out", str(tmp_path)]) == 0
    _, ticks = read_ticks(tmp_path / "ticks.jsonl")
    hips = ticks[0]["people"]["operator"]
    middle = 0.5 * (np.array(hips["left_hip"]) + np.array(hips["right_hip"]))
    np.testing.assert_allclose(middle[:2], [0.80, 0.05], atol=1e-6)
    across = np.array(hips["left_hip"]) - np.array(hips["right_hip"])
    assert across[1] < 0  # facing the robot


def test_people_and_things_that_move_at_random(tmp_path, capsys):
    words = ["live", "panda_shelf", "--people", "random:2", "--movers", "3", "--seconds", "2"]
    runs = []
    for name in ("one", "two"):
        assert main([*words, "--seed", "3", "--out", str(tmp_path / name)]) == 0
        summary = json.loads((tmp_path / name / "summary.json").read_text())
        assert summary["contacts_while_moving"] == summary["violations"] == 0
        assert summary["model_obeyed"] == pytest.approx(1.0)
        header, ticks = read_ticks(tmp_path / name / "ticks.jsonl")
        runs.append([(tick["q"], tick["people"], tick["objects"]) for tick in ticks])
    assert runs[0] == runs[1]
    assert set(header["people"]) == {"operator", "person"}
    assert header["objects"] == {"thing": 0.5, "thing_2": 0.5, "thing_3": 0.5}
    assert {"thing", "thing_2", "thing_3"} <= set(built_scene(header["scene"]).names)
    wrists = np.array([tick["people"]["person"]["left_wrist"] for tick in ticks])
    assert np.ptp(wrists, axis=0).max() > 0.05


def test_it_can_be_seen(tmp_path, capsys):
    words = ["live", "panda_shelf", "--people", "random", "--seconds", "0.3", "--out", str(tmp_path)]
    assert main(words) == 0
    assert f"see it: safe-ompl view {tmp_path}" in "".join(capsys.readouterr().err.split("\n"))
    pytest.importorskip("viser")
    page = tmp_path / "page.html"
    assert main([*words, "--html", str(page), "--force"]) == 0
    assert "<html" in page.read_text(encoding="utf-8")[:2000].lower()


def test_a_tick_may_be_shorter_than_the_usual_latency(tmp_path):
    words = ["live", "panda_shelf", "--movers", "1", "--tick", "0.01", "--seconds", "0.05", "--out"]
    assert main([*words, str(tmp_path)]) == 0
    assert len(read_ticks(tmp_path / "ticks.jsonl")[1]) == 5


def test_things_alone_and_nobody(tmp_path, capsys):
    words = ["live", "panda_shelf", "--out", str(tmp_path), "--seconds", "0.2"]
    assert main([*words, "--movers", "1"]) == 0
    header, _ = read_ticks(tmp_path / "ticks.jsonl")
    assert not header["people"]
    assert "operator" in built_scene(header["scene"]).names  # and stands there for ever
    capsys.readouterr()
    for given, said in (
        ([], "--people: nobody and nothing moves"),
        (["--movers", "1", "--clip", "clip_0"], "--clip: there is nobody"),
        (["--movers", "1", "--place", "1,0,0,0"], "--place: there is nobody"),
    ):
        assert main([*words, *given]) == 2
        assert said in capsys.readouterr().err


def limited(tmp_path, limits):
    """Return a copy of a scenario with limits."""
    file = tmp_path / "limited.yaml"
    text = find_scenario("panda_shelf").read_text(encoding="utf-8")
    file.write_text(text + "limits: " + json.dumps(limits) + "\n", encoding="utf-8")
    return str(file)


def test_a_scenarios_limits_reach_the_replanner(tmp_path):
    limits = {"min_clearance": 0.04, "obstacles": ["operator", "table"]}
    limits |= {"moving": {"speeds": {"parcel": 0.1}, "time": 1}}
    words = ["live", limited(tmp_path, limits), "--out", str(tmp_path / "out")]
    words += ["--people", "random", "--seconds", "1"]
    options = command_line().parse_args(words)
    job = options.prepare(options)
    replanner = job.keywords["replanner"]
    assert replanner.people.clearance == 0.04
    kept = replanner.prover.separation.min_clearance
    assert (kept.distance, kept.obstacles) == (0.04, ("table",))
    assert replanner.surroundings.objects["parcel"].speed == 0.1
    assert "parcel" not in replanner.surroundings.still.names
    assert job() == 0
    assert json.loads((tmp_path / "out" / "summary.json").read_text())["contacts_while_moving"] == 0


def test_limits_of_danger_hold_for_what_stands_still_and_are_said_not_to_for_who_moves(tmp_path, capsys):
    words = [limited(tmp_path, {"max_danger": 50.0}), "--out", str(tmp_path / "out"), "--seconds", "0.1"]
    assert main(["live", *words, "--people", "random"]) == 0
    assert "max_danger counts obstacles that stand still only" in " ".join(capsys.readouterr().err.split())
    options = command_line().parse_args(["live", *words, "--movers", "1", "--force"])
    job = options.prepare(options)
    replanner = job.keywords["replanner"]
    assert [limit.limit for limit in replanner.prover.limits] == [50.0]
