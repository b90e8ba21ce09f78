"""Results, paths and scenes come back from their files as they were."""

import json
import shutil
from dataclasses import replace

import numpy as np
import pytest

from safe_ompl import Box, InputError, Obstacle, PlanResult, Pose, SafeSetup, Scene, load, save
from safe_ompl.robot import Robot, robot_hash


@pytest.fixture(scope="module")
def result(data_folder):
    robot = Robot.from_urdf(data_folder / "gripper_arm.urdf")
    setup = SafeSetup(robot, Scene((Obstacle("ball", Box((0.1, 0.1, 0.1)), Pose((3.0, 0.0, 0.0)), weight=2.0),)))
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


# ------------------------------------------------------------------------------------------ robots with meshes


@pytest.fixture(params=["package://arm/wedge.obj", "wedge.obj", "in a cell"])
def meshed(request, data_folder, tmp_path):
    """Return the result of a robot with meshes, whose files are in `tmp_path / "here"`."""
    folder = tmp_path / "here" / "arm"
    folder.mkdir(parents=True)
    shutil.copy(data_folder / "wedge.obj", folder / "wedge.obj")
    name = "package://arm/wedge.obj" if request.param == "in a cell" else request.param
    text = (data_folder / "twin_arm.urdf").read_text().replace("wedge.obj", name)
    shape = '<visual><geometry><mesh filename="wedge.obj" scale="0.2 0.2 0.2"/></geometry></visual>'
    (folder / "arm.urdf").write_text(text.replace('<link name="right_hand">', f'<link name="right_hand">{shape}'))
    robot = Robot.from_urdf(folder / "arm.urdf", tip="left_hand")
    if request.param == "in a cell":
        post = Robot.from_urdf(data_folder / "gripper_arm.urdf", base=(0.0, 5.0, 0.0))
        robot = Robot.combined("cell", {"mine": robot.with_attached("rod", Box((0.1, 0.1, 0.1))), "other": post})
    scene = Scene((Obstacle("ball", Box((0.1, 0.1, 0.1)), Pose((3.0, 0.0, 0.0))),))
    return PlanResult("Timeout", None, None, "PRM", 1, robot.joint_names, 0.5, robot=robot, scene=scene)


def test_meshes_travel_with_the_robot(meshed, tmp_path):
    """Once each, in the file; they are drawn, too, when the originals are gone."""
    save(meshed, tmp_path / "result.json")
    drawn = len(meshed.robot.visual_model.geometryObjects)
    carried = json.loads((tmp_path / "result.json").read_text())["problem"]["robot"]
    assert len(carried["meshes"]) == 1
    shutil.rmtree(tmp_path / "here")
    back = load(tmp_path / "result.json").robot
    assert robot_hash(back) == robot_hash(meshed.robot)
    assert len(back.visual_model.geometryObjects) == drawn
    meshes = [body for body in back.visual_model.geometryObjects if body.meshPath]
    assert meshes, "not the collision bodies in their place"


def test_a_robot_without_its_visual_meshes_is_saved(meshed, tmp_path, caplog):
    """Many packages of robots come without them; planning and proofs need the collision meshes only."""
    (urdf,) = (tmp_path / "here").rglob("arm.urdf")
    gone = 'mesh filename="nowhere.stl" scale="0.2 0.2 0.2"'
    urdf.write_text(urdf.read_text().replace('mesh filename="wedge.obj" scale="0.2 0.2 0.2"', gone))
    save(replace(meshed, robot=Robot(meshed.robot.spec)), tmp_path / "result.json")
    assert "nowhere.stl" in caplog.text
    shutil.rmtree(tmp_path / "here")
    back = load(tmp_path / "result.json").robot
    assert robot_hash(back) == robot_hash(meshed.robot)
    assert len(back.visual_model.geometryObjects) == len(back.collision_model.geometryObjects)


def test_meshes_that_do_not_travel_are_looked_for(meshed, tmp_path, monkeypatch, caplog):
    monkeypatch.setattr("safe_ompl.io.problems.SMALL", 100)
    save(meshed, tmp_path / "result.json")
    assert "collision meshes are too large to be saved with it: --package-dir" in caplog.text
    (tmp_path / "here").rename(tmp_path / "there")
    with pytest.raises(InputError, match=r"result.json: problem.robot: .*'(package://)?(arm/)?wedge.obj' not found"):
        load(tmp_path / "result.json")
    named = "package" in (tmp_path / "result.json").read_text()
    folder = tmp_path / "there" if named else tmp_path / "there" / "arm"  # below which a relative name is looked for
    back = load(tmp_path / "result.json", package_dirs=[folder])
    assert robot_hash(back.robot) == robot_hash(meshed.robot)
    (tmp_path / "there").rename(tmp_path / "here")
    save(meshed, tmp_path / "large.json", meshes=True)
    assert len(json.loads((tmp_path / "large.json").read_text())["problem"]["robot"]["meshes"]) == 1
    monkeypatch.undo()  # else they are too large
    save(meshed, tmp_path / "bare.json", meshes=False)
    assert "meshes" not in json.loads((tmp_path / "bare.json").read_text())["problem"]["robot"]


def test_other_things_are_not_saved(tmp_path):
    with pytest.raises(InputError, match="PlanResult, a ProgramResult, a Scene, a Motion or a Trajectory, not int"):
        save(3, tmp_path / "x.json")
