"""Motions in time, and recordings of a robot beside people, in files and in views."""

import json

import numpy as np
import pytest

from safe_ompl import Box, InputError, Motion, Obstacle, People, Pose, RateLimits, Scene, load
from safe_ompl.apps import main
from safe_ompl.drawing import ViewerContent, read_recording, save_animation
from safe_ompl.drawing.plots import plot_speeds
from safe_ompl.geometry import STANDING
from safe_ompl.io import EmbeddedProblem, MotionRecord, embedded_robot, embedded_scene, strict_json, with_header

TICK = 0.1


@pytest.fixture(scope="module")
def trajectory(ur5, beside_a_worker):
    limits = RateLimits.of(ur5, acceleration=[8.0] * 6)
    return beside_a_worker.timed(limits, people=People(speed=0.4, reaction_time=0.05))


@pytest.fixture(scope="module")
def record(ur5, beside_a_worker, trajectory):
    problem = EmbeddedProblem(ur5, beside_a_worker.scene, None)
    return MotionRecord.of(trajectory, problem, rate=50.0, name="SafeRRTConnect")


@pytest.fixture(scope="module")
def recording(ur5, tmp_path_factory):
    """Write ten ticks: a robot that turns and stops, a person who walks away, a box that is carried."""
    box = Obstacle("box", Box((0.1, 0.1, 0.1)), Pose((0.0, 0.8, 0.0)))
    scene = Scene((box, Obstacle("wall", Box((0.1, 2.0, 1.0)), Pose((-1.5, 0.0, 0.0)))))
    known = {"format": "safe-ompl ticks", "version": 2, "tick": TICK, "joint_names": list(ur5.joint_names)}
    carried = {"robot": embedded_robot(ur5), "scene": embedded_scene(scene)}
    lines = [{**known, **carried, "people": {"anna": {"height": 1.75, "limbs": []}}, "objects": {"box": 0.5}}]
    near = {"distance": 0.3, "link": "wrist", "who": "anna", "limb": "right_hand", "reason": "she is near"}
    for k in range(10):
        anna = {name: (1.75 * np.array(p) + [1.2 + 0.1 * k, 0.0, -0.8]).tolist() for name, p in STANDING.items()}
        box = {"position": [0.0, 0.8, 0.1 * k], "quaternion_xyzw": [0, 0, 0, 1]}
        lines.append(
            {
                "time": 2.0 + TICK * k,
                "q": [0.1 * min(k, 5), -1.2, 1.2, -1.0, -1.57, 0.0],
                "qd": [float(k < 5), 0, 0, 0, 0, 0],
                "people": {} if k == 9 else {"anna": {**anna, "pelvis": [0.0, 0.0, 0.0]}},
                "objects": {"box": box},
                "state": "moving" if k < 5 else "standing",
                **near,
            }
        )
    file = tmp_path_factory.mktemp("ticks") / "ticks.jsonl"
    file.write_text("\n".join(strict_json(line) for line in lines) + "\n", encoding="utf-8")
    return file


def test_a_motion_comes_back_from_its_file(record, trajectory, tmp_path):
    file = tmp_path / "motion.json"
    content = with_header("trajectory", {**trajectory.as_dict(50.0), **record.to_mapping()})
    file.write_text(strict_json(content), encoding="utf-8")
    back = load(file)
    assert isinstance(back, MotionRecord)
    np.testing.assert_array_equal(back.motion.times, record.motion.times)
    np.testing.assert_array_equal(back.motion.knots, record.motion.knots)
    np.testing.assert_array_equal(back.speeds, record.speeds)
    assert back.binding == record.binding
    assert back.bounds.keys() == record.bounds.keys()
    for name, values in record.bounds.items():
        np.testing.assert_array_equal(back.bounds[name], values)
    assert back.problem.scene == record.problem.scene


@pytest.mark.parametrize("wrong", [[], {}, 1.0, ""])
def test_what_binds_is_a_name_or_nothing(record, trajectory, tmp_path, wrong):
    file = tmp_path / "motion.json"
    content = with_header("trajectory", {**trajectory.as_dict(50.0), **record.to_mapping()})
    content["binding"][3] = wrong
    file.write_text(strict_json(content), encoding="utf-8")
    with pytest.raises(InputError, match=r"motion.json: binding\[3\]: must be text"):
        load(file)


def test_no_sample_is_faster_than_its_bounds(record):
    assert "separation" in record.bounds
    for values in record.bounds.values():
        assert (record.speeds <= values * (1 + 1e-9)).all()
    assert record.remark(record.motion.duration / 2).endswith(
        str(record.binding[record.knot(record.motion.duration / 2)] or "")
    )


def test_motions_that_make_no_sense_are_refused(record):
    whole = record.problem, record.motion, record.speeds
    with pytest.raises(InputError, match="binding"):
        MotionRecord(*whole, {}, ("separation",))
    with pytest.raises(InputError, match="bounds by separation"):
        MotionRecord(*whole, {"separation": np.ones(3)}, record.binding)
    with pytest.raises(InputError, match="motion: must be timed, with times from 0 on"):
        MotionRecord(record.problem, Motion.through(record.motion.knots), record.speeds, {}, record.binding)
    with pytest.raises(InputError, match="equal numbers of entries"):
        plot_speeds([0.0, 1.0], [0.0, 1.0], {"cap": [1.0]}, [None, None], None)


def test_a_view_plays_a_motion_as_it_is_in_time(record, trajectory):
    content = ViewerContent.of_motions([record])
    assert content.playing_time == pytest.approx(trajectory.duration)
    shares = np.array([0.0, 0.3, 0.7, 1.0])
    states = trajectory.at(shares * trajectory.duration)
    np.testing.assert_allclose(content.along(record.name, shares), states.q, atol=2e-3)
    with pytest.raises(InputError, match="no motion"):
        ViewerContent.of_motions([])


def test_a_view_says_how_fast_it_is_and_what_bounds_it(record, browser_view):
    view = browser_view(ViewerContent.of_motions([record, record]))
    assert list(view.content.paths) == ["SafeRRTConnect", "SafeRRTConnect, 2"]
    board = view.path_views[0].board
    assert view.path_views[0].label is None, "the board says who it is"
    view.go_to(0.5)
    cursor = np.array(board.cursor.points)
    assert "bounded by" in view.describe()[0]
    view.go_to(1.0)
    assert np.linalg.norm(board.cursor.points - cursor) > 0.1
    assert board.labels[0].text.startswith(f"{record.motion.duration:.2f} s: ")


def test_robot_people_and_things_move_together(recording, browser_view):
    content = read_recording(recording)
    assert content.playing_time == pytest.approx(9 * TICK)
    assert [o.name for o in content.still] == ["wall"]
    assert [o.name for o in content.scene_at_start] == ["box", "wall", "anna"]
    view = browser_view(content)
    figures = view.path_views[0].movers
    head, box = figures.limbs["anna"]["head"][0], figures.things["box"][1][0]
    before, low = np.array(head.position), np.array(box.position)
    view.go_to(0.5)
    np.testing.assert_allclose(head.position - before, [0.4, 0.0, 0.0], atol=1e-6)
    # Things begin where their meshes are, and move evenly between ticks.
    np.testing.assert_allclose([low, box.position], [[0.0, 0.0, 0.0], [0.0, 0.0, 0.45]], atol=1e-6)
    assert view.q[0] == pytest.approx(0.45)
    assert "moving, 300 mm from wrist to anna's right hand" in view.describe()[0]
    view.go_to(1.0)
    assert not head.visible  # the person is not seen any more
    assert "standing" in view.describe()[0]
    assert "she is near" in view.describe()[0]


def test_recordings_that_cannot_be_read_are_refused(recording, tmp_path, capsys):
    file = tmp_path / "ticks.jsonl"
    first, *ticks = recording.read_text(encoding="utf-8").splitlines()
    for lines, said in [
        ([], "a JSON object in every line"),
        (["{"], "line 1: malformed JSON"),
        ([json.dumps({"format": "something"}), *ticks], "header.format: must be 'safe-ompl ticks', got 'something'"),
        ([first, ticks[0]], "at least two ticks"),
        ([first, *ticks[:2], "{}"], "time"),
    ]:
        file.write_text("\n".join(lines), encoding="utf-8")
        with pytest.raises(InputError, match=said):
            read_recording(file)
    assert main(["view", str(file), "--html", str(tmp_path / "x.html")]) == 2
    assert "ticks.jsonl" in capsys.readouterr().err


@pytest.mark.parametrize("ending", [".webp", ".gif"])
def test_an_animation_moves(record, tmp_path, ending, monkeypatch):
    image = pytest.importorskip("PIL.Image")
    monkeypatch.setattr("safe_ompl.drawing.pictures.FEWEST_FRAMES", 3)
    monkeypatch.setattr("safe_ompl.drawing.pictures.RATE", 1.0)
    file = tmp_path / f"animation{ending}"
    save_animation(ViewerContent.of_motions([record]), file)
    moving = image.open(file)
    assert moving.n_frames == 3
    frames = []
    for k in range(moving.n_frames):
        moving.seek(k)
        frames.append(np.asarray(moving.convert("L"), dtype=float))
    assert np.abs(frames[0] - frames[2])[60:].max() > 40
    with pytest.raises(InputError, match=r"\.webp or \.gif"):
        save_animation(ViewerContent.of_motions([record]), tmp_path / "animation.mp4")
