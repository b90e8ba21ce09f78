"""MotionBenchMaker files."""

import json
import pickle
from pathlib import Path

import pytest

from safe_ompl import Box, InputError, Robot, UnknownNameError
from safe_ompl.scene import MbmFile

ROBOTS = Path(__file__).resolve().parents[2] / "scenarios" / "robots"
PLACE = {"position": [1.0, 0, 0], "orientation_quat_xyzw": [0, 0, 0, 1]}


def document():
    problem = {
        "start": [0, 0.1],
        "goals": [[1, 0.2], [-1, 0.3]],
        "box": [{"name": "shelf", "half_extents": [0.1, 0.2, 0.3], **PLACE}],
        "cylinder": [{"name": "shelf", "radius": 0.1, "length": 0.2, **PLACE}],
        "sphere": [{"radius": 0.1, **PLACE}],
    }
    return {
        "robot": "planar2",
        "joints": ["joint2", "joint1"],
        "problems": {"easy": [{"index": 4, **problem}, {"index": 7, **problem}], "none": [], "odd": [problem]},
    }


def write(folder, data):
    file = folder / "problems.json"
    file.write_text(data if isinstance(data, str) else json.dumps(data))
    return file


def test_problems_come_in_order(tmp_path):
    file = MbmFile.load(write(tmp_path, document()), spacing=0.3)
    assert file.robot == "planar2"
    assert file.families == {"easy": 2, "none": 0, "odd": 1}
    found = [file.problem(family, k) for family, count in file.families.items() for k in range(count)]
    assert [(problem.family, problem.index) for problem in found] == [("easy", 4), ("easy", 7), ("odd", 0)]
    problem = found[0]
    assert problem.joint_names == ("joint2", "joint1")
    assert problem.goals == ((1.0, 0.2), (-1.0, 0.3))
    assert problem.scene.names == ("shelf", "shelf#2", "sphere")
    assert problem.scene["shelf"].shape == Box((0.2, 0.4, 0.6))
    assert {obstacle.weight for obstacle in problem.scene} == {1.0}
    assert problem.scene.spacing == 0.3
    assert pickle.loads(pickle.dumps(problem)) == problem


def test_joints_are_matched_by_name(tmp_path):
    arm = Robot.from_urdf(ROBOTS / "planar2.urdf", ROBOTS / "planar2.srdf", tip="tip")
    data = document()
    problem = MbmFile.load(write(tmp_path, data)).problem("easy", 0)
    assert problem.start_configuration(arm).tolist() == [0.1, 0]
    assert problem.goal_configurations(arm).tolist() == [[0.2, 1], [0.3, -1]]
    assert problem.widened_limits(arm) == {}
    data["problems"]["easy"][0]["goals"] = [[2.61, 0.2], [-2.62, 3.3]]  # joint2 keeps to ±2.6, joint1 to ±3.1
    assert MbmFile.load(write(tmp_path, data)).problem("easy", 0).widened_limits(arm) == {"joint2": (-2.62, 2.61)}
    del data["joints"]
    problem = MbmFile.load(write(tmp_path, data)).problem("easy", 0)
    assert problem.start_configuration(arm).tolist() == [0, 0.1]
    data["joints"] = ["joint1", "elbow"]
    problem = MbmFile.load(write(tmp_path, data)).problem("easy", 0)
    with pytest.raises(UnknownNameError, match=r"problems\.easy\[0\]\.start: unknown joint 'elbow'"):
        problem.start_configuration(arm)


def changed(**change):
    data = document()
    data["problems"]["easy"][1].update(change)
    return data


FLAT, BARE = {"name": "a", "half_extents": [0, 1, 1], **PLACE}, {"name": "a"}


@pytest.mark.parametrize(
    ("data", "message"),
    [
        ("{", "line 1: malformed JSON"),
        ("{}", "problems: missing, but needed"),
        ({"problems": {"a": 1}}, "problems.a: must be a list"),
        (changed(start=[0]), "problems.easy[1].start: must be 2 numbers, got 1"),
        (changed(goals=[]), "problems.easy[1].goals: must hold at least one goal"),
        (changed(goals=[[0, float("nan")]]), "problems.easy[1].goals[0]: must be a finite number"),
        (changed(index="one"), "problems.easy[1].index: must be a whole number"),
        (changed(box=[FLAT]), "problems.easy[1].box[0].half_extents: must be a positive number, got 0"),
        (changed(box=[BARE]), "problems.easy[1].box[0].position: missing"),
        (changed(octree=[BARE]), "octree: obstacles of this kind are not supported; known: box, cylinder, sphere"),
    ],
)
def test_what_is_malformed_is_named_by_file_and_key(tmp_path, data, message):
    file = write(tmp_path, data)
    with pytest.raises(InputError) as caught:
        MbmFile.load(file).problem("easy", 1)
    assert str(caught.value).startswith(f"{file}: ")
    assert message in str(caught.value)


def test_a_missing_file_is_refused(tmp_path):
    with pytest.raises(InputError, match=r"cannot be read.*such files come from"):
        MbmFile.load(tmp_path / "no.json")
