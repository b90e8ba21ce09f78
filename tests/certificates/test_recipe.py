"""Recipes: robots on bases, with objects in the gripper, and in cells, are built again from plain data."""

import json
import re
import shutil

import numpy as np
import pytest
from signing import signed

from safe_ompl import CertificateError, CollisionChecker, InputError, Scene, certificate, verify
from safe_ompl.geometry import Box, Mesh, Obstacle, Pose
from safe_ompl.io import built_robot, carried_robot
from safe_ompl.robot import Robot, robot_hash

TURNED = Pose((0.1, -0.2, 1 / 3), (0.0, 0.0, 0.6, 0.8))
KINDS = ["example", "on a base", "on a mobile base", "with a box", "with a mesh", "in a cell", "all at once"]
KINDS += ["numbers of NumPy"]


@pytest.fixture(scope="module")
def files(tmp_path_factory, data_folder):
    """Return a folder whose files are to be deleted before anything is verified."""
    folder = tmp_path_factory.mktemp("files")
    shutil.copy(data_folder / "wedge.obj", folder / "wedge.obj")
    text = (data_folder / "twin_arm.urdf").read_text()
    (folder / "twin_arm.urdf").write_text(re.sub("<mesh[^>]*/>", '<box size="0.1 0.1 0.1"/>', text))
    return folder


@pytest.fixture(scope="module")
def robots(files, ur5):
    arm = files / "twin_arm.urdf"
    held = Robot.from_urdf(arm, tip="left_hand", locked={"right_slide": 0.2})
    box, mesh = Box((0.05, 0.05, 0.3)), Mesh(files / "wedge.obj", (0.1, 0.1, 0.1))
    mobile = Robot.from_urdf(arm, mobile_base=((-1, 1), (-2, 0.5)), base=TURNED, tip="right_hand")
    return {
        "example": ur5,
        "on a base": ur5.with_base(TURNED),
        "on a mobile base": mobile.with_limits({"base_x": (-0.5, 0.5), "lift": (0.0, 0.1)}),
        "with a box": ur5.with_attached("rod", box, "tool0", TURNED, danger=True),
        "with a mesh": held.with_attached("part", mesh, touch_links=["left_arm"]),
        "in a cell": Robot.combined("cell", {"a": ur5, "b": held.with_base((2.0, 0.0, 0.0))}, tip="b"),
        "all at once": Robot.combined(
            "cell",
            {
                "a": mobile.with_attached("part", mesh),
                "b": ur5.with_base((5, 0, 0)).with_attached("rod", box, pose=(0, 0, 0.2)),
            },
        ).with_base(TURNED),
        "numbers of NumPy": Robot.from_urdf(
            arm, locked={"lift": np.float32(0.1)}, limits={"left_elbow": np.array([-1, 1]).astype(int).tolist()}
        ),
    }


@pytest.fixture(scope="module")
def carried(robots, files):
    """Return what is carried of each robot, after its files have gone."""
    found = {name: json.loads(json.dumps(carried_robot(robot))) for name, robot in robots.items()}
    shutil.rmtree(files)
    return found


@pytest.mark.parametrize("kind", KINDS)
def test_a_robot_is_built_again_from_plain_data(robots, carried, files, kind):
    again = built_robot(carried[kind])
    assert robot_hash(again) == robot_hash(robots[kind]) == carried[kind]["hash"]
    assert [item.name for item in again.attached] == [item.name for item in robots[kind].attached]
    assert again.name == robots[kind].name
    assert str(files) not in json.dumps(carried[kind])


def test_a_certificate_verifies_with_nothing_given(robots, carried, monkeypatch):
    robot = robots["all at once"]
    far = Scene((Obstacle("far", Box((1, 1, 1)), Pose((0, 0, 99))),))
    checker, rng = CollisionChecker(robot, far), np.random.default_rng(0)
    q = next(q for _ in range(100) if not checker.in_collision(q := rng.uniform(robot.lower, robot.upper)))
    monkeypatch.setattr("safe_ompl.certificates.issue.carried_robot", lambda robot: carried["all at once"])
    content = json.loads(json.dumps(certificate([q], robot, far)))
    assert verify(content).own == ("robot", "scene")
    del content["robot"]["recipe"]["robots"]["b"]["attached"]
    with pytest.raises(CertificateError, match="robot"):
        verify(signed(content))


@pytest.mark.parametrize(
    ("kind", "change"),
    [
        ("on a base", lambda recipe: recipe["base"]["position"].__setitem__(0, 0.1001)),
        ("on a mobile base", lambda recipe: recipe["mobile_base"][0].__setitem__(1, 0.51)),
        ("with a box", lambda recipe: recipe["attached"][0]["box"]["size"].__setitem__(2, 0.29)),
        ("with a box", lambda recipe: recipe["attached"][0]["position"].__setitem__(2, 0.3)),
        ("with a box", lambda recipe: recipe["attached"][0].pop("danger")),
        ("with a mesh", lambda recipe: recipe["attached"][0].pop("touch_links")),
        ("with a mesh", lambda recipe: recipe["locked"].__setitem__("right_slide", 0.19)),
        ("in a cell", lambda recipe: recipe.__setitem__("tip", "a")),
        ("in a cell", lambda recipe: recipe["robots"]["b"]["base"]["position"].__setitem__(0, 2.01)),
    ],
)
def test_the_hash_covers_the_whole_recipe(carried, kind, change):
    other = json.loads(json.dumps(carried[kind]))
    change(other["recipe"])
    assert robot_hash(built_robot(other)) != other["hash"]


@pytest.mark.parametrize(
    ("kind", "change", "message"),
    [
        ("on a base", {"base": {"position": [0, 0]}}, r"recipe\.base\.position: must be 3 numbers"),
        ("on a base", {"urdf": None}, r"recipe\.urdf: missing: give either urdf or robots"),
        ("on a base", {"of": 4}, r"recipe\.of: unknown key"),
        ("on a mobile base", {"base": 3}, r"recipe\.base"),
        ("with a mesh", {"files": {}}, r"recipe\.attached\[0\]\.mesh\.file: the file '0.obj' is not carried"),
        ("with a mesh", {"files": {"../a": ""}}, r"recipe\.files\.'\.\./a': is not the name of a file"),
        ("in a cell", {"tip": "c"}, "unknown robot with the tip 'c'; known: a, b"),
        ("in a cell", {"robots": {"a": {}, "b": {}}}, r"recipe\.robots\.a\.urdf: missing"),
    ],
)
def test_what_is_no_recipe(carried, kind, change, message):
    content = {**carried[kind], "recipe": {**carried[kind]["recipe"], **change}}
    with pytest.raises(InputError, match=message):
        built_robot(content)


def test_one_urdf_is_not_taken_for_several_robots(carried, data_folder):
    with pytest.raises(InputError, match="urdf: there are several robots"):
        built_robot(carried["in a cell"], urdf=data_folder / "twin_arm.urdf")


def test_models_of_pinocchio_are_no_plain_data(ur5):
    robot = Robot.from_models(ur5.model, ur5.collision_model, tip="tool0").with_base(TURNED)
    assert carried_robot(robot)["recipe"] is None
