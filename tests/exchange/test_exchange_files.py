"""Results, paths and scenes come back from their files as they were."""

from __future__ import annotations

import json

import numpy as np
import pytest

from safe_ompl import Box, InputError, JointPath, Obstacle, Pose, Robot, SafeSetup, Scene, load, save
from safe_ompl.robot.fingerprint import robot_hash


@pytest.fixture(scope="module")
def result(data_folder):
    robot = Robot.from_urdf(data_folder / "gripper_arm.urdf")
    setup = SafeSetup(
        robot, Scene((Obstacle("ball", Box((0.1, 0.1, 0.1)), Pose((3.0, 0.0, 0.0)), weight=2.0),))
    )
    middle = 0.5 * (robot.lower + robot.upper)
    setup.setConfigurations(middle, middle + 0.1 * (robot.upper - robot.lower))
    found = setup.plan("SafeRRTConnect", time=10.0, seed=3)
    assert found
    return found


def test_a_result_comes_back_whole(result, tmp_path):
    save(result, tmp_path / "result.json")
    back = load(tmp_path / "result.json")
    np.testing.assert_array_equal(back.path, result.path)
    assert back.as_dict() == result.as_dict()
    assert back.scene == result.scene
    assert robot_hash(back.robot) == robot_hash(result.robot)
    assert back.danger == result.danger


def test_a_result_without_a_path_comes_back(result, tmp_path):
    nothing = type(result)("Timeout", None, None, "PRM", 1, result.joint_names, 0.5)
    save(nothing, tmp_path / "nothing.json")
    back = load(tmp_path / "nothing.json")
    assert not back
    assert back.as_dict() == nothing.as_dict()
    assert back.robot is None


def test_a_scene_comes_back_with_its_mesh(data_folder, tmp_path):
    scene = Scene.from_mapping({"obstacles": [{"name": "w", "mesh": {"file": "wedge.obj"}}]}, data_folder)
    save(scene, tmp_path / "scene.json")
    assert load(tmp_path / "scene.json").content_hash() == scene.content_hash()


def test_a_path_comes_back_exactly(tmp_path):
    path = JointPath(("hip", "knee"), [[0.1, 1 / 3], [np.pi, -2e-17]])
    save(path, tmp_path / "path.json")
    path.to_csv(tmp_path / "path.csv")
    assert load(tmp_path / "path.json") == path
    assert JointPath.from_csv(tmp_path / "path.csv") == path
    assert (tmp_path / "path.csv").read_text().splitlines()[0] == "hip,knee"


def test_a_joint_trajectory_has_the_shape_of_ros(result):
    message = JointPath.of(result).to_joint_trajectory()
    assert message["joint_names"] == list(result.joint_names)
    assert [point["positions"] for point in message["points"]] == result.path.tolist()
    json.dumps(message)


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ("{", "cannot be read as JSON"),
        ("[]", "format: must be 'safe-ompl'"),
        ('{"format": "safe-ompl", "version": 2, "kind": "path"}', "version: 2 is not known"),
        ('{"format": "safe-ompl", "version": 1, "kind": "dance"}', "unknown kind of file 'dance'"),
        ('{"format": "safe-ompl", "version": 1, "kind": "path", "path": []}', "joint_names"),
        (
            '{"format": "safe-ompl", "version": 1, "kind": "path", "joint_names": ["a"], "path": [[1, 2]]}',
            "path",
        ),
    ],
)
def test_what_is_no_such_file_is_refused_by_name(content, words, tmp_path):
    file = tmp_path / "x.json"
    file.write_text(content)
    with pytest.raises(InputError, match=words) as refused:
        load(file)
    assert str(file) in str(refused.value)


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ("", "is empty"),
        ("a,b\n1\n", r"x\.csv:2: must have 2 numbers"),
        ("a\nx\n", r"x\.csv:2: must be numbers"),
    ],
)
def test_what_is_no_csv_path_is_refused_by_line(content, words, tmp_path):
    (tmp_path / "x.csv").write_text(content)
    with pytest.raises(InputError, match=words):
        JointPath.from_csv(tmp_path / "x.csv")


def test_other_things_are_not_saved(tmp_path):
    with pytest.raises(InputError, match="PlanResult, a JointPath or a Scene, not int"):
        save(3, tmp_path / "x.json")
