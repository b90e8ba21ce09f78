"""Motions come from the files that others write, and files of other kinds are refused in one line."""

import json
from dataclasses import make_dataclass, replace

import numpy as np
import pytest
import yaml

from safe_ompl import InputError, Motion, PlanResult, RateLimits, Scene, load, read_motion, save, time_path
from safe_ompl.common.errors import warn_once
from safe_ompl.io import WRITABLE, motion_of_document

NAMES = ("hip", "knee")
T = np.array([0.0, 0.5, 2.0])
Q, V, A = np.random.default_rng(0).normal(size=(3, 3, 2))
SMOOTH = Motion.hermite(T, Q, V, A, NAMES)


def same(motion, expected):
    np.testing.assert_allclose(motion.coefficients, expected.coefficients, rtol=0, atol=1e-12)
    np.testing.assert_allclose(motion.times, expected.times, rtol=0, atol=1e-9)
    assert (motion.joint_names, motion.timed) == (expected.joint_names, expected.timed)


def message(*rates, time=float):
    """Return a JointTrajectory through the points, with `time` as its times."""
    keys = ("positions", "velocities", "accelerations")
    columns = zip(T.tolist(), *(rows.tolist() for rows in (Q, *rates)), strict=True)
    points = [{**dict(zip(keys, row, strict=False)), "effort": [], "time_from_start": time(t)} for t, *row in columns]
    return {"header": {"frame_id": "world"}, "joint_names": list(NAMES), "points": points}


@pytest.mark.parametrize("rates", [(), (V,), (V, A)])
@pytest.mark.parametrize(
    "time",
    [
        float,
        lambda t: {"sec": int(t), "nanosec": round(1e9 * (t % 1))},
        lambda t: {"secs": int(t), "nsecs": round(1e9 * (t % 1))},
    ],
)
def test_messages_of_ros_and_moveit(tmp_path, rates, time):
    expected = Motion.hermite(T, Q, *rates, names=NAMES)
    said = message(*rates, time=time)
    (tmp_path / "ros.json").write_text(json.dumps(said))
    (tmp_path / "ros.yaml").write_text(yaml.safe_dump(said) + "---\n")
    moveit = {"joint_trajectory": said, "multi_dof_joint_trajectory": {"joint_names": [], "points": []}}
    (tmp_path / "moveit.yml").write_text(yaml.safe_dump({"trajectory": moveit}))
    for file in ("ros.json", "ros.yaml", "moveit.yml"):
        same(read_motion(tmp_path / file), expected)


REST = {"joint_trajectory": {"joint_names": [], "points": []}, "multi_dof_joint_trajectory": {"points": []}}


def display(*parts, start=None, **more):
    """Return a DisplayTrajectory of robot trajectories, which begins where the first one does, or at `start`."""
    state = {"name": ["lid", *NAMES[::-1]], "position": [0.3, *(Q[0, ::-1] if start is None else start)]}
    trajectory = [REST, *({"joint_trajectory": part} for part in parts)]
    return {"model_id": "arm", "trajectory": trajectory, "trajectory_start": {"joint_state": state, **more}}


def backwards():
    """Return the message back from the last point to the first one."""
    said = message()
    rows = [point["positions"] for point in said["points"]]
    for point, row in zip(said["points"], rows[::-1], strict=True):
        point["positions"] = row
    return said


def test_what_moveit_displays_is_one_motion(tmp_path, caplog):
    file, step = tmp_path / "display.yaml", T[-1] - T[0]
    said = display(message(), backwards(), start=Q[0, ::-1] + [2 * np.pi, 0.009])
    file.write_text(yaml.safe_dump(json.loads(json.dumps(said))) + "---\n")
    there_and_back = Motion.hermite([*(T - T[0]), *(T[1:] - T[0] + step)], [*Q, *Q[-2::-1]], names=NAMES)
    same(read_motion(file), there_and_back)
    warn_once.cache_clear()
    held = display(message(V), attached_collision_objects=[{"object": {"id": "cup"}}])
    same(motion_of_document(held), Motion.hermite(T, Q, V, names=NAMES))
    assert "objects in the gripper (cup): attach them to the robot" in caplog.text


def test_objects_of_messages():
    """Both as rosbags makes them and as rclpy does, which knows its fields by a method."""
    types = {name: make_dataclass(name, fields) for name, fields in MESSAGES.items()}
    times = [types["Duration"](int(t), round(1e9 * (t % 1))) for t in T]
    points = [types["Point"](q, v, np.zeros(0), time) for q, v, time in zip(Q, V, times, strict=True)]
    said = types["Robot"](types["Trajectory"](list(NAMES), points))
    same(motion_of_document(said), Motion.hermite(T, Q, V, names=NAMES))
    fields = staticmethod(lambda: dict.fromkeys(("joint_names", "points")))
    Plain = type("Plain", (), {"get_fields_and_field_types": fields, "joint_names": list(NAMES), "points": points})
    same(motion_of_document(Plain()), Motion.hermite(T, Q, V, names=NAMES))


MESSAGES = {
    "Duration": ("sec", "nanosec"),
    "Point": ("positions", "velocities", "accelerations", "time_from_start"),
    "Trajectory": ("joint_names", "points"),
    "Robot": ("joint_trajectory",),
}


def test_tables_and_arrays(tmp_path):
    kinds = [f"{name}_{kind}" for kind in ("position", "velocity", "acceleration") for name in NAMES]
    for columns, header, expected in (
        ((Q,), NAMES, Motion.through(Q, names=NAMES)),
        ((T, Q), ("time", *NAMES), Motion.hermite(T, Q, names=NAMES)),
        ((Q,), kinds[:2], Motion.through(Q, names=NAMES)),
        ((T, Q, V), ("time", *kinds[:4]), Motion.hermite(T, Q, V, names=NAMES)),
        ((T, Q, V, A), ("time", *kinds), SMOOTH),
        ((A, V, Q, T), (*kinds[4:], *kinds[2:4], *kinds[:2], "time"), SMOOTH),
    ):
        table = np.column_stack(columns)
        lines = [", ".join(header), *(",".join(map(repr, row)) for row in table.tolist()), ""]
        (tmp_path / "table.csv").write_text("\n".join(lines), encoding="utf-8-sig")
        same(read_motion(tmp_path / "table.csv"), expected)
    file = tmp_path / "arrays.npz"
    for expected, held in (
        (SMOOTH, {"times": T, "positions": Q, "velocities": V, "accelerations": A, "joint_names": NAMES}),
        (Motion.through(Q), {"positions": Q}),
    ):
        np.savez(file, **held)
        same(read_motion(file), expected)


def test_our_own_form_is_exact(tmp_path):
    file = tmp_path / "own.json"
    slack = Motion.sampled(T, Q, 100.0, NAMES)
    bent = replace(SMOOTH, coefficients=np.pad(SMOOTH.coefficients, ((0, 0), (0, 2), (0, 0))), slack=np.ones((2, 2)))
    for motion in (SMOOTH, slack, Motion.through(Q), bent):
        save(motion, file)
        for back in (load(file), read_motion(file)):
            for key in ("times", "coefficients", "slack", "rounding", "joint_names", "timed"):
                np.testing.assert_array_equal(getattr(back, key), getattr(motion, key))
    for motion, words in ((bent, "cannot represent this motion"), (Motion.through(Q), "needs the names of the")):
        with pytest.raises(InputError, match=f"m.csv: .*{words}"):
            save(motion, tmp_path / "m.csv")


SAVED = {
    "result": (PlanResult("Exact solution", Q, None, "PRM", 1, NAMES, 0.5), Motion.through(Q, names=NAMES)),
    "path": (Motion.through(Q, names=NAMES),) * 2,
    "lines": (Motion.hermite(T, Q, names=NAMES),) * 2,
    "cubics": (Motion.hermite(T, Q, V, names=NAMES),) * 2,
    "quintics": (SMOOTH, SMOOTH),
}


@pytest.mark.parametrize("ending", [*WRITABLE, ".npy", ".stl", ""])
@pytest.mark.parametrize("thing", [*SAVED, "trajectory", "scene"])
def test_the_ending_says_the_form_of_all_that_is_saved(tmp_path, ur5, thing, ending):
    file, jerk = tmp_path / f"file{ending}", np.full(6, 50.0)
    if thing == "trajectory":
        limits = RateLimits(ur5.joint_names, np.ones(6), np.ones(6), jerk)
        saved = time_path([[0.0] * 6, [0.5] * 6], ur5, limits)
        expected = Motion.of(saved)
    else:
        saved, expected = SAVED.get(thing, (Scene(), None))
    if ending not in WRITABLE or (thing == "scene" and ending != ".json"):
        with pytest.raises(InputError, match=r"file.*: must have one of the endings|must end in .json"):
            save(saved, file)
        assert not file.exists()
        return
    save(saved, file)
    back = load(file)
    if ending == ".json" and thing in ("result", "path", "scene"):
        assert type(back) is type(saved)
    if expected is not None:
        same(read_motion(file), expected)
        same(Motion.of(back), expected)


def written(file, content):
    """Write text, plain data as JSON, a result, or arrays; None writes nothing."""
    if isinstance(content, PlanResult):
        save(content, file)
    elif isinstance(content, str):
        file.write_text(content)
    elif file.suffix == ".npy":
        np.save(file, content)
    elif file.suffix == ".npz" and content is not None:
        np.savez(file, **content)
    elif content is not None:
        file.write_text(json.dumps(content))
    return file


NO_PATH = PlanResult("Timeout", None, None, "PRM", 1, NAMES, 0.5)
WITH_G = [{"positions": [9, 2 * t + 1, 2 * t + 2], "time_from_start": t} for t in (0, 1)]


@pytest.mark.parametrize(
    ("name", "text", "options"),
    [
        ("m.tsv", "time\thip\tknee\n0\t1\t2\n1\t3\t4\n", {}),
        ("m.csv", "time;hip;knee\n0;1;2\n1;3;4\n", {}),
        ("m.txt", "  time hip   knee\n0 1 2\n\n1 3 4\n", {}),
        ("m.csv", "# from a robot, 2024\ntime,hip,knee\n0,1,2\n# then\n1,3,4\n", {}),
        ("m.csv", "0,1,2\n1,3,4\n", {"joints": ("time", "hip", "knee")}),
        ("m.txt", "# 0.1 Hz\n0 1 2\n1 3 4", {"joints": ("time", "hip", "knee")}),
        ("m.csv", "time,hip,gripper,knee\n0,1,open,2\n1,3,shut,4\n", {"ignore": ("gripper",)}),
        ("m.csv", "time,hip_position,g_position,knee_position\n0,1,x,2\n1,3,x,4\n", {"ignore": ("g",)}),
        ("m.npy", [[0, 1, 2], [1, 3, 4]], {"joints": ("time", "hip", "knee")}),
        ("m.npy", [[0, 1, 9, 2], [1, 3, 9, 4]], {"joints": ("time", "hip", "g", "knee"), "ignore": ("g",)}),
        ("m.npz", {"times": [0, 1], "positions": [[1, 2], [3, 4]]}, {"joints": NAMES}),
        ("m.json", {"joint_names": ["g", *NAMES], "points": WITH_G}, {"ignore": ("g",)}),
    ],
)
def test_files_of_others(tmp_path, name, text, options):
    same(
        read_motion(written(tmp_path / name, text), **options),
        Motion.hermite([0.0, 1.0], [[1.0, 2.0], [3.0, 4.0]], names=NAMES),
    )


def test_joints_and_degrees_by_the_robot(tmp_path, twin_arm):
    file, names = tmp_path / "m.npz", twin_arm.joint_names[::-1]
    np.savez(file, positions=np.full((2, twin_arm.n), 90.0) * ~twin_arm.prismatic[::-1], joint_names=names)
    assert np.abs(read_motion(file, twin_arm, degrees=True).knots).max() == pytest.approx(np.pi / 2)
    with pytest.raises(InputError, match=r"m.npz: motion: joint '.*' moves to .* rad, more than two turns"):
        read_motion(file, twin_arm)
    with pytest.raises(InputError, match="degrees: need the robot"):
        read_motion(file, degrees=True)


def changed(point, **keys):
    """Return a message in which one point is changed; None takes a key out."""
    said = message(V)
    held = {**said["points"][point], **keys}
    said["points"][point] = {key: value for key, value in held.items() if value is not None}
    return json.dumps(said)


def shown(content):
    """Return plain data, with arrays in it, as JSON."""
    return json.dumps(content, default=lambda value: value.tolist())


OTHER = json.dumps({"joint_trajectory": message(), "multi_dof_joint_trajectory": {"points": [1]}})


@pytest.mark.parametrize(
    ("name", "content", "error"),
    [
        ("m.stl", "", r"m.stl: must be a motion, with one of the endings .csv, .tsv, .txt, .npz, .npy, .json, "),
        ("m.csv", "", "m.csv: is empty: the first line must name the joints"),
        ("m.csv", "0,1\n2,3\n", "m.csv: the first line: must name the joints, got 0, 1; or .*--joints"),
        ("m.npy", "text", r"m.npy: must be an array of numbers with two dimensions \(N, m\)"),
        ("m.csv", "a,b\n1,2\n3,x\n", "m.csv:3: must be numbers, got 'x'"),
        ("m.csv", "a,b\n1,2\n3\n", "m.csv:3: must have 2 numbers, one for each column, got 1"),
        ("m.csv", "a,b\n1,2\n3,nan\n", r"m.csv: way points: must be finite, got \[.*nan\]"),
        ("m.csv", "time,a\n1,2\n0,3\n", r"m.csv: times: must increase, got 0 after 1 \(times\[1\]\)"),
        ("m.csv", "time,a,a\n0,1,2\n1,2,3\n", "m.csv: names of columns: must differ, got time, a, a"),
        ("m.csv", "time,a_position,a_velocity,b_position\n0,1,2,3\n", "m.csv: b_velocity: missing, but needed"),
        (
            "m.csv",
            "a_position,a_velocity\n0,1\n1,2\n",
            "m.csv: times: are missing, but velocities and accelerations need times",
        ),
        ("m.npz", {"speeds": Q}, "m.npz: speeds: unknown key"),
        ("m.npz", {"positions": Q, "joint_names": [1, 2]}, "m.npz: joint_names: must be a list of text, got int64"),
        ("none.npz", None, r"none.npz: cannot be read \(No such file"),
        ("m.json", NO_PATH, r"m.json: kind: must hold a motion, but no path was found \(Timeout\)"),
        ("m.npz", "text", "m.npz: is not an NPZ archive of arrays of numbers and text"),
        ("m.json", "{", "m.json: line 1: malformed JSON"),
        ("m.json", "[1]", r"m.json: must hold joint_names and points .*got list \[1\]"),
        ("m.json", '{"a": 1}', "m.json: must hold joint_names and points .*got the keys a"),
        ("m.json", '{"format": "urdf"}', "m.json: format: must be 'safe-ompl'"),
        ("m.json", '{"format": "safe-ompl", "version": 2, "kind": "scene"}', "kind: must hold a motion, but it holds"),
        ("m.json", '{"format": "safe-ompl", "version": 1, "kind": "path"}', "m.json: version: 1 is not known, 2 is"),
        ("m.json", '{"format": "safe-ompl", "version": 2, "kind": "dance"}', "unknown kind of file 'dance'"),
        ("m.json", '{"format": "safe-ompl", "version": 2, "kind": "path", "path": []}', "m.json: joint_names: missing"),
        ("m.yaml", "a: [", "m.yaml: line 2: malformed YAML"),
        ("m.yaml", "joint_names: [a]\npoints: []\n", "m.yaml: points: must be at least two, got 0"),
        ("m.json", changed(1, positions=[1.0]), r"m.json: points\[1\].positions: must be 2 numbers, got 1: \[1.0\]"),
        ("m.json", changed(2, time_from_start=None), r"points\[2\].time_from_start: must be given in all points"),
        ("m.json", changed(2, velocity=[1.0, 2.0]), r"points\[2\].velocity: unknown key; did you mean 'velocities'"),
        ("m.json", changed(0, time_from_start={"sec": 1, "nsec": 2}), r"points\[0\].time_from_start.nsec: unknown key"),
        ("m.json", OTHER, "multi_dof_joint_trajectory: must be empty"),
        ("m.yaml", "trajectory: []", "m.yaml: trajectory: must hold points, got none"),
        ("m.yaml", "trajectory: [1]", r"m.yaml: trajectory\[0\]: trajectory: must be a mapping .*got int 1"),
        ("m.json", shown(display(message(), {"points": [1]})), r"trajectory\[2\]: joint_trajectory: must hold joint"),
        ("m.json", shown(display(message(), message())), r"trajectory\[2\]: motion: joint 'hip' jumps by "),
        (
            "m.json",
            shown(display(message(), {**message(), "joint_names": ["hip", "ankle"]})),
            "joint_names: must be hip, knee, as in the motion before, got hip, ankle",
        ),
        (
            "m.json",
            shown(display(message(), start=Q[0] + 1)),
            r"start.joint_state.position: joint 'hip' is at .*, but the trajectory begins at .* at most 0.01",
        ),
        ("m.json", shown(display(message(), start=["a", 1])), r"state.position: must be a finite number, got 'a'"),
        ("m.json", shown(display(message(), start=[1])), r"joint_state.position: must be 3 numbers, got 2"),
        ("m.json", shown({**display(message()), "trajectory_start": [1]}), "trajectory_start.state: must be a mapping"),
        ("m.json", shown(display(message(), joint_state=1)), "trajectory_start.joint_state: must be a mapping"),
    ],
)
def test_bad_files_are_named_in_one_line(tmp_path, name, content, error):
    with pytest.raises(InputError, match=error) as raised:
        read_motion(written(tmp_path / name, content))
    assert "\n" not in str(raised.value)
