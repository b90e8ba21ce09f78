"""Scenes: reading, writing, danger points, and errors that name the key."""

from __future__ import annotations

import pickle
import shutil
from pathlib import Path

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from safe_ompl.errors import InputError, UnknownNameError
from safe_ompl.scene.obstacle import Obstacle
from safe_ompl.scene.pose import Pose
from safe_ompl.scene.scene import Scene
from safe_ompl.scene.shapes.basic import Box, Capsule, Cylinder, Sphere
from safe_ompl.scene.shapes.cloud import PointCloud
from safe_ompl.scene.shapes.mesh import Mesh
from safe_ompl.scene.shapes.person import Person

SIZE = st.floats(1e-3, 10.0)
PLACE = st.floats(-10.0, 10.0)
POINT = st.tuples(PLACE, PLACE, PLACE)
SHAPES = st.one_of(
    st.builds(Box, st.tuples(SIZE, SIZE, SIZE)),
    st.builds(Sphere, SIZE),
    st.builds(Cylinder, SIZE, SIZE),
    st.builds(Capsule, SIZE, SIZE),
    st.builds(PointCloud, SIZE, points=st.lists(POINT, min_size=1, max_size=4)),
    st.builds(Person, st.floats(0.5, 2.5)),
    st.builds(
        Person,
        keypoints=st.fixed_dictionaries({"right_wrist": POINT, "right_hand": POINT}),
        only=st.just(("right_hand",)),
    ),
)
POSES = st.builds(Pose.from_rpy, POINT, st.tuples(PLACE, PLACE, PLACE))
OBSTACLES = st.builds(
    Obstacle,
    st.text(min_size=1).filter(str.strip),
    SHAPES,
    POSES,
    st.none() | st.floats(0, 100),
    st.none() | st.just("#12aBff"),
)
SCENES = st.builds(Scene, st.lists(OBSTACLES, max_size=4, unique_by=lambda o: o.name), st.floats(1e-3, 1.0))

KITCHEN = """
spacing: 0.2
obstacles:
  - name: table
    box: {size: [1.0, 0.6, 0.05]}
    position: [0.5, 0, 0.4]
    weight: 0.25
  - name: cook
    person: {height: 1.7}
    position: [1.0, 0, 0]
    yaw: 3.14
  - {name: pot, cylinder: {radius: 1e-1, length: 0.2}, color: [0.5, 0.5, 0.5]}
"""


def write_tetrahedron(path: Path, edge: float) -> Path:
    corners = [(0, 0, 0), (edge, 0, 0), (0, edge, 0), (0, 0, edge)]
    lines = [f"v {x} {y} {z}" for x, y, z in corners] + ["f 1 3 2", "f 1 2 4", "f 1 4 3", "f 2 3 4"]
    path.write_text("\n".join(lines) + "\n")
    return path


@pytest.fixture
def kitchen() -> Scene:
    return Scene.from_yaml(KITCHEN)


# ------------------------------------------------------------------------------------------------ documents


@settings(max_examples=80, deadline=None)
@given(SCENES)
@example(Scene((Obstacle("1e3", Sphere(1e-5)), Obstacle("null", Sphere(1)), Obstacle("a\x85b", Sphere(1)))))
def test_yaml_gives_back_exactly_what_was_written(scene: Scene) -> None:
    again = Scene.from_yaml(scene.to_yaml())
    assert again == scene
    assert again.content_hash() == scene.content_hash()


def test_files_are_relative_to_the_document(tmp_path: Path) -> None:
    (tmp_path / "assets").mkdir()
    mesh = write_tetrahedron(tmp_path / "assets" / "part.obj", 0.3)
    np.save(tmp_path / "assets" / "scan.npy", np.eye(3))
    scene = Scene(
        (
            Obstacle("part", Mesh(mesh, (1, 2, 1), convex=False)),
            Obstacle("scan", PointCloud(0.01, tmp_path / "assets" / "scan.npy")),
        )
    )
    scene.save(tmp_path / "scene.yaml")
    assert "file: assets/part.obj" in (tmp_path / "scene.yaml").read_text()
    assert Scene.from_file(tmp_path / "scene.yaml") == scene

    moved = tmp_path / "elsewhere"
    shutil.copytree(tmp_path / "assets", moved / "assets")
    shutil.copy(tmp_path / "scene.yaml", moved)
    copy = Scene.from_file(moved / "scene.yaml")
    assert copy.content_hash() == scene.content_hash()
    write_tetrahedron(moved / "assets" / "part.obj", 0.31)
    assert Scene.from_file(moved / "scene.yaml").content_hash() != scene.content_hash()


def test_reads_what_people_write(kitchen: Scene) -> None:
    assert kitchen.names == ("table", "cook", "pot")
    assert [obstacle.weight for obstacle in kitchen] == [0.25, 1.0, 0.0]
    assert kitchen["pot"].shape == Cylinder(0.1, 0.2)
    assert kitchen["cook"].pose.se3.rotation[0, 0] == pytest.approx(np.cos(3.14))
    assert Scene.from_yaml("") == Scene.from_yaml("obstacles: []") == Scene()


def test_world_keypoints_are_in_the_world() -> None:
    scene = Scene.from_yaml(
        """
        obstacles:
          - name: colleague
            person:
              only: [right_hand]
              world_keypoints: {right_wrist: [0.6, 0, 0.2], right_hand: [0.45, 0, 0.2]}
            position: [1.0, 0.1, -0.8]
            yaw: 2.5
        """
    )
    ((_, _, placement),) = scene["colleague"].geometries()
    assert placement.translation == pytest.approx([0.525, 0, 0.2])


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (
            "obstacles: [{name: a, box: {size: [1, -0.2, 1]}}]",
            "obstacles[0] 'a'.box.size: must be a positive number, got -0.2",
        ),
        (
            "obstacles: [{name: a, sphere: {radius: .nan}}]",
            "'a'.sphere.radius: must be a positive number, got nan",
        ),
        ("obstacles: [{name: a, sphere: {raduis: 1}}]", "sphere.raduis: unknown key; did you mean 'radius'?"),
        ("obstacles: [{name: a, sphere: {}}]", "'a'.sphere.radius: missing, but needed"),
        ("obstacles: [{name: a, sphere: 3}]", "'a'.sphere: must be a mapping of keys to values, got int 3"),
        ("obstacles: [{name: a, shpere: {radius: 1}}]", "'a'.shpere: unknown key; did you mean 'sphere'?"),
        ("obstacles: [{name: a}]", "'a'.shape: give exactly one of box, sphere"),
        ("obstacles: [{name: a, sphere: {radius: 1}, box: {size: [1, 1, 1]}}]", "found box and sphere"),
        ("obstacles: [{sphere: {radius: 1}}]", "obstacles[0].name: missing, but needed"),
        ("obstacles: [{name: 7, sphere: {radius: 1}}]", "obstacles[0] 7.name: must be text"),
        (
            "obstacles: [{name: a, sphere: {radius: 1}, position: [.nan, 0, 0]}]",
            "'a'.position: must be a finite",
        ),
        ("obstacles: [{name: a, sphere: {radius: 1}, position: [0, 0]}]", "'a'.position: must be 3 numbers"),
        (
            "obstacles: [{name: a, sphere: {radius: 1}, quaternion_xyzw: [0, 0, 0, 2]}]",
            "quaternion_xyzw: [0.0, 0.0, 0.0, 2.0] must have length 1, not 2",
        ),
        (
            "obstacles: [{name: a, sphere: {radius: 1}, yaw: 0, rpy: [0, 0, 0]}]",
            "give only one of rpy and yaw",
        ),
        (
            "obstacles: [{name: a, sphere: {radius: 1}, weight: -1}]",
            "'a'.weight: must be a finite number >= 0, got -1",
        ),
        (
            "obstacles: [{name: a, sphere: {radius: 1}, weight: heavy}]",
            "'a'.weight: must be a finite number >= 0, got 'heavy'",
        ),
        ("obstacles: [{name: a, sphere: {radius: 1}, color: red}]", "'a'.color: must be '#rrggbb'"),
        ("obstacles: [{name: a, mesh: {file: no.stl}}]", "'a'.mesh.file: "),
        ("obstacles: [{name: a, pointcloud: {radius: 1, points: []}}]", "the point cloud is empty"),
        (
            "obstacles: [{name: a, person: {height: tall}}]",
            "'a'.person.height: must be a positive number, got 'tall'",
        ),
        (
            "obstacles: [{name: a, person: {world_keypoints: {hat: [0, 0, 0]}}}]",
            "'a'.person.world_keypoints.hat: unknown key",
        ),
        (
            "obstacles: [{name: a, sphere: {radius: 1}}, {name: a, sphere: {radius: 1}}]",
            "obstacles[1].name: 'a' is already obstacles[0]",
        ),
        ("obstacles: {a: 1}", "obstacles: must be a list, got dict"),
        ("obstacles: [7]", "obstacles[0]: must be a mapping of keys to values, got int 7"),
        ("obstacle: []", "obstacle: unknown key; did you mean 'obstacles'? valid keys: spacing, obstacles"),
        ("spacing: 0", "spacing: must be a positive number, got 0"),
        ("[1, 2]", "must be a mapping of keys to values, got list [1, 2]"),
        ("spacing: 1\nobstacles: [}", "line 2: malformed YAML"),
        ("spacing: 1\nspacing: 2", "line 2: malformed YAML: the key 'spacing' is given twice"),
        ("spacing: !!python/object:os.system 1", "malformed YAML: could not determine a constructor"),
    ],
)
def test_errors_name_file_key_and_value(tmp_path: Path, text: str, message: str) -> None:
    file = tmp_path / "scene.yaml"
    file.write_text(text)
    with pytest.raises(InputError) as caught:
        Scene.from_file(file)
    assert str(caught.value).startswith(f"{file}: ")
    assert message in str(caught.value)


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"no\.yaml: cannot be read \(No such file"):
        Scene.from_file(tmp_path / "no.yaml")


def test_nearly_unit_quaternions_become_unit() -> None:
    pose = Pose(quaternion_xyzw=(0, 0, 0.70713, 0.70713))
    assert np.linalg.norm(pose.quaternion_xyzw) == pytest.approx(1.0, abs=1e-15)


# ------------------------------------------------------------------------------------------------ contents


def test_lookup_and_changes(kitchen: Scene) -> None:
    with pytest.raises(UnknownNameError, match="unknown obstacle 'sink'; known: table, cook, pot"):
        kitchen["sink"]
    smaller = kitchen.without("cook")
    assert smaller.names == ("table", "pot")
    assert smaller.with_obstacles(kitchen["cook"]).names == ("table", "pot", "cook")
    with pytest.raises(InputError, match=r"obstacles\[3\].name: 'pot' is already obstacles\[2\]"):
        kitchen.with_obstacles(kitchen["pot"])
    assert repr(kitchen) == "Scene({'table': box, 'cook': person, 'pot': cylinder}, spacing=0.2)"


def test_pickles(kitchen: Scene) -> None:
    again = pickle.loads(pickle.dumps(kitchen))
    assert again == kitchen
    assert again.content_hash() == kitchen.content_hash()


def test_the_hash_tells_contents_apart(kitchen: Scene) -> None:
    table = kitchen["table"]
    heavier = Obstacle(table.name, table.shape, table.pose, weight=0.5)
    other = Scene((heavier, *kitchen.obstacles[1:]), kitchen.spacing)
    hashes = {scene.content_hash() for scene in (kitchen, other, kitchen.without("pot"), Scene())}
    assert len(hashes) == 4
    assert Scene().content_hash() == Scene().content_hash()


def test_danger_points_carry_weight_and_owner(kitchen: Scene) -> None:
    points, weights, owner = kitchen.danger_points()
    assert points.shape == (len(weights), 3)
    assert set(owner) == {0, 1}
    assert (weights == np.where(owner == 0, 0.25, 1.0)).all()
    top = points[owner == 0]
    assert np.abs(top - [0.5, 0, 0.4]).max(axis=0) == pytest.approx([0.5, 0.3, 0.025])
    assert (kitchen.danger_points()[0] == points).all()
    assert len(kitchen.danger_points(0.1)[0]) > len(points)
    with pytest.raises(InputError, match="spacing: must be a positive number, got 0"):
        kitchen.danger_points(0)


@pytest.mark.parametrize("scene", [Scene(), Scene((Obstacle("ball", Sphere(1)),))])
def test_a_scene_without_danger_has_no_points(scene: Scene) -> None:
    points, weights, owner = scene.danger_points()
    assert points.shape == (0, 3)
    assert weights.shape == owner.shape == (0,)


def test_parts_have_names_and_places(kitchen: Scene) -> None:
    ((name, _, placement),) = kitchen["table"].geometries()
    assert name == "table"
    assert placement.translation == pytest.approx([0.5, 0, 0.4])
    names = [name for name, _, _ in kitchen["cook"].geometries()]
    assert "cook/head" in names
    assert len(set(names)) == len(names) > 10


def test_triangles_are_in_the_world(kitchen: Scene) -> None:
    vertices, faces = kitchen["table"].triangles()
    assert vertices.min(axis=0) == pytest.approx([0, -0.3, 0.375])
    assert faces.max() == len(vertices) - 1


# ----------------------------------------------------------------------------------------- MotionBenchMaker


def test_from_mbm_makes_everything_dangerous() -> None:
    place = {"position": [1, 0, 0], "orientation_quat_xyzw": [0, 0, 0, 1]}
    scene = Scene.from_mbm(
        {
            "box": [{"name": "a", "half_extents": [0.1, 0.2, 0.3], **place}],
            "cylinder": [{"name": "a", "radius": 0.1, "length": 0.5, **place}],
            "sphere": [{"radius": 0.1, **place}],
        },
        spacing=0.3,
    )
    assert scene.names == ("a", "a#2", "sphere")
    assert scene["a"].shape == Box((0.2, 0.4, 0.6))
    assert {obstacle.weight for obstacle in scene} == {1.0}
    assert scene.spacing == 0.3


@pytest.mark.parametrize(
    ("problem", "message"),
    [
        ({"box": [{"name": "a"}]}, "box[0].position: missing"),
        (
            {"mesh": [{"name": "a"}]},
            "mesh: obstacles of this kind are not read; known: box, cylinder, sphere",
        ),
        ({"sphere": 3}, "sphere: must be a list"),
        (
            {"sphere": [{"radius": -1, "position": [0, 0, 0], "orientation_quat_xyzw": [0, 0, 0, 1]}]},
            "sphere[0].radius: must be a positive number, got -1",
        ),
    ],
)
def test_malformed_mbm_obstacles_are_refused(problem: dict, message: str) -> None:
    with pytest.raises(InputError) as caught:
        Scene.from_mbm(problem)
    assert message in str(caught.value)
