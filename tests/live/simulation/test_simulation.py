"""The simulation: people, robots and contacts in it, faults that are answered by a stop, and the command `live`."""

import json
from itertools import pairwise

import numpy as np
import pinocchio as pin
import pytest
import yaml

from safe_ompl import InputError, People, Tracker
from safe_ompl.apps import main
from safe_ompl.apps.cli.program import command_line
from safe_ompl.geometry import STANDING
from safe_ompl.io import built_robot, built_scene, read_ticks
from safe_ompl.live import KEYPOINTS, Recording, TrackedBody, find_skeleton
from safe_ompl.live.simulation import ContactMonitor, Drifting, Faults, Playback, Simulation, Walker, limb_solids
from safe_ompl.live.tracking import PersonTrack
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


@pytest.fixture
def simulated(replanner_for, to_and_fro, clips):
    """Return a function that makes a simulation of a recorded person."""

    def make(clip="clip_0", faults=None):
        recording = Recording.load(clips, clip)
        tracker = Tracker(recording.skeleton, noise=0.0 if faults is None else faults.noise)
        replanner = replanner_for("anna", trackers={"anna": tracker})
        return Simulation(replanner, to_and_fro(replanner), {"anna": Playback(recording, tracker)}, faults=faults)

    return make


def test_nobody_who_obeys_is_touched_and_all_that_a_tick_says_is_of_one_instant(simulated):
    one = simulated()
    ticks, monitor, body = list(one.ticks(5.0)), ContactMonitor(one.replanner.robot), TrackedBody()
    for tick in ticks:
        q, points = np.array(tick["q"]), np.array([tick["people"]["anna"][name] for name in KEYPOINTS])
        nearest = monitor.nearest(q, limb_solids("anna", body, points))
        assert nearest.distance == pytest.approx(tick["distance"], abs=1e-12)
        assert (nearest.link, nearest.who) == (tick["link"], tick["who"])
        assert tick["state"] not in ("standing", "done") or not any(tick["qd"])
    assert sum(any(tick["qd"]) for tick in ticks) > 30
    assert {tick["path"] for tick in ticks if "ahead" in tick} == {tick["path"] for tick in ticks}
    summary = one.summary
    assert summary.contacts_while_moving == summary.violations == summary.deadlines_missed == 0
    assert summary.model_obeyed == pytest.approx(1.0)
    assert summary.least_distance > 0
    assert 0 < summary.moving <= 1
    assert summary.as_dict()["reaction"]["median"] > 0


def test_noise_drops_and_late_answers_touch_nobody_and_the_same_world_gives_the_same_ticks(simulated):
    runs = []
    for _ in range(2):
        one = simulated(faults=Faults(noise=0.02, drops=0.2, late=0.2, seed=1))
        runs.append([{key: value for key, value in tick.items() if key != "reaction"} for tick in one.ticks(3.0)])
    assert runs[0] == runs[1]
    assert one.summary.contacts_while_moving == one.summary.violations == 0
    assert one.summary.deadlines_missed > 5
    assert one.summary.model_obeyed == pytest.approx(1.0)


def test_a_person_who_is_faster_than_promised_is_counted(simulated):
    summary = simulated("clip_1").run(2.0)
    assert summary.violations > 10
    assert summary.model_obeyed < 0.5  # in commands from before a violation too
    assert summary.contacts_while_moving == 0


def test_the_monitor_notes_contacts_once_and_whether_the_robot_moved(panda):
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
    for touch in monitor.touches(q, 2.0 * np.eye(7)[0], touching):  # the first joint turns about the axis z
        assert touch.speed == pytest.approx(2.0 * np.hypot(*touch.point[:2]))


# -------------------------------------------------------------------------------------------------------- movers


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


CENTRE = np.array([0.2, -0.1, -0.75])
SLOW_HAND = People(speed=1.6, speeds={"left_hand": 0.4})


def walker(people=SLOW_HAND, **options):
    return Walker(people, CENTRE, np.array([1.0, 0.0]), **options)


@pytest.mark.parametrize(("people", "speed"), [(SLOW_HAND, 1.0), (People(speed=0.3), 1.0), (People(speed=1.6), 4.0)])
def test_no_limb_of_a_walker_is_faster_than_it_may_be_and_who_is_is_seen(people, speed):
    one = walker(people, speed=speed)
    track = PersonTrack("anna", one.tracker, people)
    times = np.cumsum(np.random.default_rng(0).uniform(0.005, 0.12, 200))
    assert any(track.observe(one.at(time), time) for time in times) == (speed > 1)


def test_a_seed_is_one_walk_and_the_past_may_be_asked_for():
    first, same, other = walker(seed=1), walker(seed=1), walker(seed=2)
    late = first.at(25.0)
    np.testing.assert_array_equal(late, same.at(25.0))
    np.testing.assert_array_equal(first.at(24.5), same.at(24.5))
    assert np.abs(late - other.at(25.0)).max() > 0.05
    with pytest.raises(InputError, match="tracker: must have the skeleton ALL_KEYPOINTS"):
        walker(tracker=Tracker(find_skeleton("coco17")))


# ----------------------------------------------------------------------------------------------------- recordings


def test_recordings_are_read_and_played_to_and_fro(clips):
    recording = Recording.load(clips)
    assert recording.duration == pytest.approx(5.95)
    np.testing.assert_allclose(recording.at(0.025), recording.frames[:2].mean(axis=0))
    np.testing.assert_allclose(recording.at(2 * recording.duration - 0.05), recording.frames[1], atol=1e-9)


def test_recordings_that_are_none(clips, tmp_path):
    with pytest.raises(InputError, match=r"swaying.npz: unknown clip 'clip_7'; did you mean 'clip_1'"):
        Recording.load(clips, "clip_7")
    text = tmp_path / "text.npz"
    text.write_text("nothing")
    for file in (text, tmp_path / "missing.npz"):
        with pytest.raises(InputError, match=f"{file.name}: (cannot be read|is not an NPZ archive)"):
            Recording.load(file)
    good = {"names": np.array(RECORDING.points), "rate": 20.0, "clip_0": swaying()}
    nan = swaying()
    nan[3, 2] = np.inf
    for key, value, message in (
        ("rate", -1.0, "rate: must be a positive number"),
        ("rate", None, "rate: missing, but needed"),
        ("names", np.array(["a", "b"]), "names: no skeleton has the 2 key points"),
        ("clip_0", np.zeros((5, 3, 3)), r"clip_0: must have shape \(any, 12, 3\)"),
        ("clip_0", nan, "clip_0: key points must be finite"),
        ("clip_0", np.zeros((0, 12, 3)), "clip_0: has no frames"),
    ):
        np.savez(tmp_path / "bad.npz", **{k: v for k, v in {**good, key: value}.items() if v is not None})
        with pytest.raises(InputError, match=f"bad.npz: {message}"):
            Recording.load(tmp_path / "bad.npz")


# ------------------------------------------------------------------------------------------------------- the command


def live(tmp_path, *words, scenario="panda_shelf"):
    return ["live", scenario, "--out", str(tmp_path / "out"), "--force", *words]


def test_all_places_are_reached_in_whichever_order_is_soonest(tmp_path, capsys):
    source = find_scenario("planar3").resolve()
    data = yaml.safe_load(source.read_text())
    for key in ("urdf", "srdf"):
        data["robot"][key] = str(source.parent / data["robot"][key])
    near = {name: q + 0.1 for name, q in data["start"].items()}
    data["goal"] = {"configurations": [data["goal"]["configuration"], near]}
    file = tmp_path / "places.yaml"
    file.write_text(yaml.safe_dump(data))
    words = ["--movers", "1", "--any-order"]
    assert main(live(tmp_path, *words, "--seconds", "12", scenario=str(file))) == 0
    ticks = [json.loads(line) for line in (tmp_path / "out" / "ticks.jsonl").read_text().splitlines()[1:]]
    places = [list(q.values()) for q in (data["start"], *data["goal"]["configurations"])]
    done = [int(np.abs(np.array(places) - tick["q"]).max(axis=1).argmin()) for tick in ticks if tick["state"] == "done"]
    visited = [place for place, before in pairwise([*done, None]) if place != before]
    assert visited[:2] == [2, 1]  # the nearest one, though it is listed last
    assert main(live(tmp_path, *words, scenario="panda_pick_place")) == 2
    assert "--any-order: is only for a path" in " ".join(capsys.readouterr().err.split())


def test_the_command_plays_a_person_in_the_place_of_the_scenarios(clips, tmp_path, capsys):
    words = ["--people", str(clips), "--clip", "clip_1", "--faster", "2", "--noise", "0.01", "--seconds", "1"]
    assert main(live(tmp_path, *words)) == 0
    said = " ".join(capsys.readouterr().out.split())
    assert "contacts while moving 0" in said
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    assert set(summary["reaction"]) == {"median", "p99"}
    header, ticks = read_ticks(tmp_path / "out" / "ticks.jsonl")
    assert built_robot(header["robot"]).joint_names == tuple(header["joint_names"])
    assert "operator" not in built_scene(header["scene"]).names
    assert len(ticks) == 20
    points = {name: np.array(place) for name, place in ticks[0]["people"]["operator"].items()}
    assert list(points) == list(KEYPOINTS)
    np.testing.assert_allclose(0.5 * (points["left_hip"] + points["right_hip"])[:2], [0.80, 0.05], atol=1e-6)
    assert (points["left_hip"] - points["right_hip"])[1] < 0  # facing the robot
    with pytest.raises(InputError, match=r"header\.format: must be 'safe-ompl ticks', got None"):
        read_ticks(tmp_path / "out" / "summary.json")


@pytest.mark.parametrize(
    ("seconds", "status", "end"), [(60, 0, "all 11 steps done in"), (1, 1, "not finished: at step 1 of 11")]
)
def test_the_command_drives_a_program_and_goes_on_where_it_stopped(tmp_path, capsys, seconds, status, end):
    words = ["--people", "random:1", "--seed", "1", "--seconds", str(seconds)]
    assert main(live(tmp_path, *words, scenario="panda_pick_place")) == status
    said = " ".join(capsys.readouterr().out.split())
    assert "contacts while moving 0" in said
    assert end in said
    header, ticks = read_ticks(tmp_path / "out" / "ticks.jsonl")
    done = [tick["task"] for tick in ticks]
    assert done == sorted(done)
    finger = header["joint_names"].index("panda_finger_joint1")
    for moves, opening in ((0, 0.04), (4, 0.0245)):  # detours and retreats leave the gripper as it is
        held = [tick["q"][finger] for tick in ticks if tick["task"] == moves]
        np.testing.assert_allclose(held, opening, atol=1e-9)
    stood = [tick["time"] for tick in ticks if tick["state"] == "standing" and tick["reason"]]
    assert seconds == 1 or stood[0] < ticks[-1]["time"] - 1
    for before, after in pairwise(ticks):  # also where one replanner takes over from another
        assert np.abs(np.subtract(after["q"], before["q"])).max() < 0.05 * 2.7


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (["--clip", "clip_9"], "unknown clip 'clip_9'"),
        (["--place", "1,2,3"], "--place: must be four finite numbers X,Y,Z,YAW"),
        (["--noise", "-1"], "--noise: must be a finite number >= 0"),
        (["--drops", "2"], "--drops: must be a share in [0, 1]"),
        (["--people", "nowhere.npz"], "there is no file 'nowhere.npz'"),
        (["--people", "random:0"], "random:N with a whole number N of at least 1, not 'random:0'"),
        (["--people", "random", "--clip", "clip_0"], "--clip: is for recordings, not for 'random'"),
        (["--html", "page.txt"], "--html: 'page.txt' must end in .html"),
        (None, "--people: no person and no object moves"),
        (["--movers", "1", "--clip", "clip_0"], "--clip: nobody moves"),
        (["--movers", "1", "--place", "1,0,0,0"], "--place: nobody moves"),
    ],
)
def test_the_command_refuses_in_one_line(clips, tmp_path, capsys, change, message):
    somebody = [] if change is None or "--movers" in change else ["--people", str(clips)]
    assert main(live(tmp_path, *somebody, *(change or ()))) == 2
    error = capsys.readouterr().err
    assert message in error
    assert len(error.strip().splitlines()) == 1


def test_people_and_things_that_move_at_random(tmp_path):
    runs = []
    for _ in range(2):
        assert main(live(tmp_path, "--people", "random:2", "--movers", "3", "--seconds", "2", "--seed", "3")) == 0
        summary = json.loads((tmp_path / "out" / "summary.json").read_text())
        assert summary["contacts_while_moving"] == summary["violations"] == 0
        assert summary["model_obeyed"] == pytest.approx(1.0)
        header, ticks = read_ticks(tmp_path / "out" / "ticks.jsonl")
        runs.append([(tick["q"], tick["people"], tick["objects"]) for tick in ticks])
    assert runs[0] == runs[1]
    assert set(header["people"]) == {"operator", "person"}
    assert header["objects"] == {"thing": 0.5, "thing_2": 0.5, "thing_3": 0.5}
    assert {"thing", "thing_2", "thing_3"} <= set(built_scene(header["scene"]).names)
    wrists = np.array([tick["people"]["person"]["left_wrist"] for tick in ticks])
    assert np.ptp(wrists, axis=0).max() > 0.05


def test_things_alone_with_a_short_tick_can_be_seen(tmp_path):
    pytest.importorskip("viser")
    words = ["--movers", "1", "--tick", "0.01", "--seconds", "0.05", "--html", str(tmp_path / "page.html")]
    assert main(live(tmp_path, *words)) == 0
    header, ticks = read_ticks(tmp_path / "out" / "ticks.jsonl")
    assert len(ticks) == 5
    assert not header["people"]
    assert "operator" in built_scene(header["scene"]).names  # and stands there for ever
    assert "<html" in (tmp_path / "page.html").read_text(encoding="utf-8")[:2000].lower()


def test_a_scenarios_limits_reach_the_replanner(tmp_path, capsys):
    def prepared(limits, *words):
        file = tmp_path / "limited.yaml"
        text = find_scenario("panda_shelf").read_text(encoding="utf-8")
        file.write_text(text + "limits: " + json.dumps(limits) + "\n", encoding="utf-8")
        options = command_line().parse_args(live(tmp_path, *words, scenario=str(file)))
        return options.prepare(options).keywords["world"]([]).replanner

    limits = {"min_clearance": 0.04, "obstacles": ["operator", "table"]}
    limits |= {"moving": {"speeds": {"parcel": 0.1}, "time": 1}}
    replanner = prepared(limits, "--people", "random")
    assert replanner.clearance == 0.04
    kept = replanner.prover.separation.min_clearance
    assert (kept.distance, kept.obstacles) == (0.04, ("table",))
    assert replanner.surroundings.objects["parcel"].speed == 0.1
    assert "parcel" not in replanner.surroundings.still.names
    replanner = prepared({"max_danger": 50.0}, "--people", "random")
    assert [limit.limit for limit in replanner.prover.limits] in ([], [50.0])
    assert [limit.limit for limit in prepared({"max_danger": 50.0}, "--movers", "1").prover.limits] == [50.0]
