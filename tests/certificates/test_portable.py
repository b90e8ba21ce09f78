"""Certificates carry robot and scene: they verify where neither is given, and no other one passes for theirs."""

import copy
import json
import re
import shutil
import zlib
from base64 import b64encode
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from signing import replaced, signed, travelled

from safe_ompl import CertificateError, InputError, Scenario, Scene
from safe_ompl.certificates import certificate, terms_of, verify
from safe_ompl.geometry import Box, Capsule, Cylinder, Mesh, Obstacle, Person, PointCloud, Pose, Sphere
from safe_ompl.io import built_robot, built_scene, embedded_robot, embedded_scene
from safe_ompl.io.schema import unpack
from safe_ompl.robot import Robot, robot_hash

ROBOTS = Path(__file__).parents[2] / "scenarios" / "robots"


NO_NAME = r"is not the name of a file|control characters|printable text"


def packed(content):
    return b64encode(zlib.compress(content)).decode()


@pytest.fixture
def files(tmp_path, data_folder):
    """Return a folder with a mesh and a point cloud."""
    shutil.copy(data_folder / "wedge.obj", tmp_path / "wedge.obj")
    np.save(tmp_path / "points.npy", np.random.default_rng(0).uniform(2.0, 3.0, (200, 3)))
    return tmp_path


@pytest.fixture
def everything(files):
    """Return a scene with an obstacle of each kind, all out of reach."""
    far = Pose((3.0, 0.0, 0.0), (0.6, 0.0, 0.0, 0.8))
    return Scene(
        (
            Obstacle("box", Box((0.1, 0.2, 0.3)), far, weight=0.5, color="#102030"),
            Obstacle("ball", Sphere(0.1), far),
            Obstacle("post", Cylinder(0.1, 0.3), far),
            Obstacle("beam", Capsule(0.1, 0.3), far),
            Obstacle("person", Person(1.8, {"right_wrist": (0.2, -0.3, 1.3)}), far),
            Obstacle("few", PointCloud(0.01, points=((0.1, 1 / 3, 0.3), (2, 3, 4.5))), far),
            Obstacle("cloud", PointCloud(0.01, files / "points.npy"), weight=1.0),
            Obstacle("hull", Mesh(files / "wedge.obj", (0.5, 0.5, 0.5)), far),
            Obstacle("shell", Mesh(files / "wedge.obj", convex=False), far),
        ),
        spacing=0.2,
    )


def test_a_scene_of_all_kinds_travels_without_its_files(everything, files):
    carried = travelled(embedded_scene(everything))
    shutil.rmtree(files)
    arrived = built_scene(carried)
    assert arrived.content_hash() == everything.content_hash()
    assert arrived.names == everything.names
    assert str(files) not in json.dumps(carried)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"files": {}}, r"obstacles\[6\].pointcloud.file: the file '0.npy' is not embedded"),
        ({"files": {"0.npy": "?", "1.obj": "AA==", "2.obj": "AA=="}}, "0.npy: is not a compressed file in base 64"),
        ({"files": {"0.npy": 3}}, "0.npy: must be text"),
        ({"files": {"../0.npy": "AA=="}}, NO_NAME),
        *(({"files": {name: "AA=="}}, NO_NAME) for name in ("..", "", ".hidden", "a/b", "a\\b", "a\0", 101 * "a")),
        ({"content": 3}, "content: must be a mapping"),
        ({"content": {"obstacles": 3}}, "obstacles: must be a list"),
        ({"extra": 3}, "unknown key"),
    ],
)
def test_scenes_that_cannot_be_read(everything, tmp_path, change, message):
    carried = {**travelled(embedded_scene(everything)), **change}
    with pytest.raises(InputError, match=message):
        built_scene(carried)
    assert not (tmp_path.parent / "0.npy").exists()


def test_another_scene_or_file_does_not_pass_for_the_one_of_the_hash(everything, files):
    carried = travelled(embedded_scene(everything))
    assert sorted(carried["files"]) == ["0.npy", "1.obj", "2.obj"]
    wedge = (files / "wedge.obj").read_bytes().replace(b"1", b"2")
    for change in (
        replaced("content", "obstacles", 1, "sphere", "radius", by=0.05),
        replaced("files", "2.obj", by=packed(wedge)),
    ):
        other = travelled(carried)
        change(other)
        with pytest.raises(CertificateError, match="scene that it carries is not the one"):
            built_scene(other)


def test_a_file_that_has_changed_or_gone_is_not_carried(everything, files):
    np.save(files / "points.npy", np.ones((3, 3)))
    with pytest.raises(InputError, match="has changed since it was read"):
        embedded_scene(everything)
    (files / "points.npy").unlink()
    with pytest.raises(InputError, match=r"points.npy: cannot be embedded in a document \(No such file"):
        embedded_scene(everything)


# ------------------------------------------------------------------------------------------------------ robot

TURNED = Pose((0.1, -0.2, 1 / 3), (0.0, 0.0, 0.6, 0.8))
KINDS = ["example", "on a base", "on a mobile base", "with a box", "with a mesh", "in a cell", "all at once"]
KINDS += ["numbers of NumPy"]


@pytest.fixture(scope="module")
def robot_files(tmp_path_factory, data_folder):
    """Return a folder whose files are to be deleted before anything is verified."""
    folder = tmp_path_factory.mktemp("files")
    shutil.copy(data_folder / "wedge.obj", folder / "wedge.obj")
    text = (data_folder / "twin_arm.urdf").read_text()
    (folder / "twin_arm.urdf").write_text(re.sub("<mesh[^>]*/>", '<box size="0.1 0.1 0.1"/>', text))
    return folder


@pytest.fixture(scope="module")
def robots(robot_files, ur5):
    arm = robot_files / "twin_arm.urdf"
    held = Robot.from_urdf(arm, tip="left_hand", locked={"right_slide": 0.2})
    box, mesh = Box((0.05, 0.05, 0.3)), Mesh(robot_files / "wedge.obj", (0.1, 0.1, 0.1))
    mobile = Robot.from_urdf(arm, mobile_base=((-1, 1), (-2, 0.5)), base=TURNED, tip="right_hand")
    far = Robot.from_example("ur5", base=(5, 0, 0)).with_attached("rod", box, pose=(0, 0, 0.2))
    all_at_once = Robot.combined("cell", {"a": mobile.with_attached("part", mesh), "b": far})
    return {
        "example": ur5,
        "on a base": Robot.from_example("ur5", base=TURNED),
        "on a mobile base": mobile.with_limits({"base_x": (-0.5, 0.5), "lift": (0.0, 0.1)}),
        "with a box": ur5.with_attached("rod", box, "tool0", TURNED, danger=True),
        "with a mesh": held.with_attached("part", mesh, touch_links=["left_arm"]),
        "in a cell": Robot.combined("cell", {"a": ur5, "b": Robot(replace(held.spec, base=(2.0, 0.0, 0.0)))}, tip="b"),
        "all at once": Robot(replace(all_at_once.spec, base=TURNED)),
        "numbers of NumPy": Robot.from_urdf(
            arm, locked={"lift": np.float32(0.1)}, limits={"left_elbow": np.array([-1, 1]).astype(int).tolist()}
        ),
    }


@pytest.fixture(scope="module")
def carried(robots, robot_files):
    """Return what is carried of each robot, after its files have gone."""
    found = {name: travelled(embedded_robot(robot)) for name, robot in robots.items()}
    shutil.rmtree(robot_files)
    return found


@pytest.mark.parametrize("kind", KINDS)
def test_a_robot_is_built_again_from_plain_data(robots, carried, robot_files, kind):
    again = built_robot(carried[kind])
    assert robot_hash(again) == robot_hash(robots[kind]) == carried[kind]["hash"]
    assert [item.name for item in again.attached] == [item.name for item in robots[kind].attached]
    assert again.name == robots[kind].name
    assert str(robot_files) not in json.dumps(carried[kind])


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
    other = travelled(carried[kind])
    change(other["recipe"])
    assert robot_hash(built_robot(other)) != other["hash"]


def text_of(change):
    """Return a change of the text of an embedded URDF."""
    return replaced("recipe", "urdf", "text", by=change)


NOT_BUILT = [
    (
        "on a base",
        lambda c: c["recipe"].update(base={"position": [0, 0]}),
        r"recipe\.base\.position: must be 3 numbers",
    ),
    ("on a base", lambda c: c["recipe"].update(urdf=None), r"recipe\.urdf: missing: give either urdf or robots"),
    ("on a base", lambda c: c["recipe"].update(of=4), r"recipe\.of: unknown key"),
    ("on a mobile base", lambda c: c["recipe"].update(base=3), r"recipe\.base"),
    ("with a mesh", lambda c: c["recipe"].update(files={}), r"mesh\.file: the file '0.obj' is not embedded"),
    ("with a mesh", lambda c: c["recipe"].update(files={"../a": ""}), r"files\.'\.\./a': is not the name of a file"),
    ("in a cell", lambda c: c["recipe"].update(tip="c"), "unknown robot with the tip 'c'; known: a, b"),
    ("in a cell", lambda c: c["recipe"].update(robots={"a": {}, "b": {}}), r"recipe\.robots\.a\.urdf: missing"),
    ("example", lambda c: c.update(recipe=None), "does not contain its robot 'ur5'"),
    ("example", lambda c: c.update(recipe=3), "recipe: must be a mapping"),
    ("example", lambda c: c.update(recipe={}), "recipe.urdf: missing: give either urdf or robots"),
    ("example", lambda c: c["recipe"].update(urdf={"example_robot_data": "../../../etc/passwd"}), "is not in example-"),
    ("example", lambda c: c["recipe"].update(urdf={}), "urdf.text: must be text, or a file of example-robot-data"),
    ("example", lambda c: c.update(recipe={"urdf": {"text": ""}}), "recipe.urdf.text: must be text"),
    ("example", lambda c: c.update(recipe={"urdf": {"text": "<robot/>"}, "wheels": 4}), "wheels: unknown key"),
    ("example", lambda c: c.update(extra=3), "unknown key"),
    ("with a mesh", text_of(lambda text: '<!DOCTYPE robot [<!ENTITY a "b">]>' + text), "text: .*declare entities"),
    ("with a mesh", text_of(lambda text: 1000 * "<a>" + text), "text: .*tags in tags, more than 100 deep"),
    ("with a mesh", text_of(lambda text: text + 20_000_000 * " "), "text: .*characters, 20000000 is the limit"),
]


@pytest.mark.parametrize(("kind", "change", "message"), NOT_BUILT)
def test_robots_that_cannot_be_built(carried, kind, change, message):
    content = travelled(carried[kind])
    change(content)
    with pytest.raises(InputError, match=message):
        built_robot(content)


def test_models_of_pinocchio_are_no_plain_data(ur5):
    robot = Robot.from_models(ur5.model, ur5.collision_model, tip="tool0", base=TURNED)
    assert embedded_robot(robot)["recipe"] is None


# ------------------------------------------------------------------------------------------------ certificates


PATH = np.array([[0.0, -1.5, 0.5, 0, 0, 0], [0.3, -1.5, 0.5, 0, 0, 0]])


@pytest.fixture(scope="module")
def written(ur5, clutter):
    return travelled(certificate(PATH, ur5, clutter))


def test_it_verifies_with_nothing_given(written, ur5, clutter):
    given, own = verify(written, ur5, clutter), verify(written)
    assert given.own == given.not_covered == ()
    assert given.not_claimed == ("clearance", "danger", "moving obstacles", "tool", "tube")
    assert given.claims == ("every motion is free", "a path of 1 straight edges")
    assert own.claims[0] == "every motion is free, for the robot and the scene that the file itself carries"
    assert replace(own, own=(), claims=given.claims) == given
    assert verify(written, ur5).claims[0].endswith(", for the scene that the file itself carries")


def test_what_was_sampled_is_not_covered(written, ur5, clutter):
    said = "your checker, sampled at 0.01 rad"
    content = travelled(certificate(PATH, ur5, clutter, {"also_sampled": said}))
    assert verify(content, ur5, clutter).not_covered == (said,)
    for bad in (3, "a\nproof.json: all is well"):
        with pytest.raises(InputError, match="also_sampled: must be text"):
            verify(signed({**content, "also_sampled": bad}), ur5, clutter)


def test_links_without_collision_geometry_are_named(written, ur5, clutter, monkeypatch):
    monkeypatch.setattr(ur5, "links_without_collision", ("wrist_2", "forearm"), raising=False)
    with pytest.raises(CertificateError, match=r"without collision geometry: it names \[\], the robot has \['forearm"):
        verify(written, ur5, clutter)
    content = travelled(certificate(PATH, ur5, clutter))
    assert verify(content, ur5, clutter).not_covered == ("links without collision geometry: forearm, wrist_2",)
    content["robot"]["links_without_collision"].pop()
    with pytest.raises(CertificateError, match="without collision geometry"):
        verify(signed(content), ur5, clutter)


# ---------------------------------------------------------------------------------------------- hostile documents


def arm_with_mesh(name):
    """Return what is carried of an arm with a mesh of this name in the place of a shape."""
    text = (ROBOTS / "planar2.urdf").read_text()
    carried = travelled(embedded_robot(Robot.from_urdf(ROBOTS / "planar2.urdf")))
    shape = re.search("<collision>.*?(<geometry>.*?)</geometry>", text, re.DOTALL).group(1)
    carried["recipe"]["urdf"]["text"] = text.replace(shape, f'<geometry><mesh filename="{name}"/>')
    return carried


@pytest.mark.parametrize(
    "name", ["{}/wedge.obj", "file://{}/wedge.obj", "package:/{}/wedge.obj", "../../..{}/wedge.obj"]
)
def test_a_carried_urdf_reads_no_mesh_that_it_names_where_it_likes(files, name):
    carried = arm_with_mesh(name.format(files))
    with pytest.raises(InputError, match=r"cannot be built from what the document contains; .*wedge\.obj' not found"):
        built_robot(carried)
    if name.startswith(("{}", "file")):
        assert built_robot(carried, package_dirs=[files]) is not None, "the user names the folder"


def test_a_carried_urdf_reads_no_other_file(files, monkeypatch):
    (files / "inner").mkdir()
    monkeypatch.chdir(files)
    for name in ("wedge.obj", "package://wedge.obj", "package://inner/../wedge.obj"):
        with pytest.raises(InputError, match=r"^(?!.*cannot be built from what is).*not found"):
            built_robot(arm_with_mesh(name), package_dirs=[files / "inner"])


def test_files_that_grow_when_they_are_unpacked(tmp_path, monkeypatch):
    monkeypatch.setattr("safe_ompl.io.schema._MOST_BYTES", 1000)
    unpack({"a.obj": packed(bytes(500)), "b.obj": packed(bytes(500))}, tmp_path)
    for data, words in (("!", "is not a compressed file in base 64"), ("eJw=", "is cut")):
        with pytest.raises(InputError, match=rf"a\.obj: {words}"):
            unpack({"a.obj": data}, tmp_path)
    with pytest.raises(InputError, match=r"b\.obj: is cut off, or all files together exceed 1000 bytes"):
        unpack({"a.obj": packed(bytes(500)), "b.obj": packed(bytes(501))}, tmp_path)


def test_a_carried_mesh_names_no_other_file(everything, files, tmp_path):
    named = tmp_path / "named"
    named.mkdir()
    carried = travelled(embedded_scene(everything))
    wedge = (files / "wedge.obj").read_bytes()
    for line in (b"mtllib /etc/hostname\n", b"  MTLLIB a\n", b"mtl\\\nlib /etc/hostname\n"):
        unpack({"a.obj": packed(line + wedge)}, named)
        assert b"hostname" not in re.sub(rb"mtl +lib.*", b"", (named / "a.obj").read_bytes())
    carried["files"]["1.obj"] = packed(b"mtllib /etc/hostname\n" + wedge)
    assert built_scene(carried).content_hash() == everything.content_hash()


def test_a_certificate_that_was_written_once_verifies():
    content = json.loads((Path(__file__).parents[1] / "data" / "certificate_of_planar3.json").read_text())
    scenario = Scenario.load(ROBOTS.parent / "planar3.yaml")
    robot = scenario.build_robot()
    assert verify(content).own == ("robot", "scene")
    found = verify(content, robot, scenario.scene, terms=terms_of(scenario, robot, timed=False))
    assert found.claims[1].startswith("danger at most 7.81222 (max, unit, k1 1")


@pytest.mark.parametrize("name", ["ball\nit is free", "\x1b[2Kball"])
def test_names_that_would_write_lines_of_their_own(written, name):
    content = copy.deepcopy(written)
    content["scene"]["content"]["obstacles"][2]["name"] = name
    content["scene"]["hash"] = Scene.from_mapping(content["scene"]["content"]).content_hash()
    with pytest.raises(InputError, match=r"^certificate\.scene\.content.*must be a number, text") as refused:
        verify(signed(content))
    assert "\n" not in str(refused.value)


def test_a_robot_is_called_what_its_document_says(data_folder):
    robot = Robot.from_urdf(ROBOTS / "planar2.urdf")
    content = travelled(certificate(np.zeros((1, 2)), robot, Scene()))
    recipe = content["robot"]["recipe"]
    recipe["urdf"]["text"] = recipe["urdf"]["text"].replace('name="planar2"', 'name="a&#10;b"')
    with pytest.raises(InputError, match=r"robot\.name: is 'planar2', but what it carries is 'a\\nb'"):
        verify(signed(content))
