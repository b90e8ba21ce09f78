"""Scenes: reading, writing, danger points, and errors that name the key."""

import re
import shutil
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import example, given, settings, strategies as st

from safe_ompl import Box, Capsule, Cylinder, Mesh, Obstacle, Person, PointCloud, Pose, Scene, Sphere
from safe_ompl.common import InputError, UnknownNameError, warn_once

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


def write_tetrahedron(path, edge):
    corners = [(0, 0, 0), (edge, 0, 0), (0, edge, 0), (0, 0, edge)]
    lines = [f"v {x} {y} {z}" for x, y, z in corners] + ["f 1 3 2", "f 1 2 4", "f 1 4 3", "f 2 3 4"]
    path.write_text("\n".join(lines) + "\n")
    return path


@pytest.fixture
def kitchen():
    return Scene.from_yaml(KITCHEN)


# ------------------------------------------------------------------------------------------------ documents


@settings(max_examples=40)
@given(SCENES)
@example(Scene((Obstacle("1e3", Sphere(1e-5)), Obstacle("null", Sphere(1)), Obstacle("a\x85b", Sphere(1)))))
def test_yaml_gives_back_exactly_what_was_written(scene):
    again = Scene.from_yaml(scene.to_yaml())
    assert again == scene
    assert again.content_hash() == scene.content_hash()


def test_files_are_relative_to_the_document(tmp_path):
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


def test_reads_what_people_write(kitchen):
    assert kitchen.names == ("table", "cook", "pot")
    assert [obstacle.weight for obstacle in kitchen] == [0.25, 1.0, 0.0]
    assert kitchen["pot"].shape == Cylinder(0.1, 0.2)
    assert kitchen["cook"].pose.se3.rotation[0, 0] == pytest.approx(np.cos(3.14))
    assert Scene.from_yaml("") == Scene.from_yaml("obstacles: []") == Scene()


def test_world_keypoints_are_in_the_world():
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
        ("obstacles: [{name: a, sphere: {radius: .nan}}]", "'a'.sphere.radius: must be a finite number in (0, 10000]"),
        ("obstacles: [{name: a, sphere: {raduis: 1}}]", "sphere.raduis: unknown key; did you mean 'radius'?"),
        ("obstacles: [{name: a, sphere: {}}]", "'a'.sphere.radius: missing, but needed"),
        ("obstacles: [{name: a, shpere: {radius: 1}}]", "'a'.shpere: unknown key; did you mean 'sphere'?"),
        ("obstacles: [{name: a}]", "'a'.shape: give exactly one of box, sphere"),
        ("obstacles: [{name: a, sphere: {radius: 1}, box: {size: [1, 1, 1]}}]", "found box and sphere"),
        ("obstacles: [{name: 7, sphere: {radius: 1}}]", "obstacles[0] 7.name: must be text"),
        ("obstacles: [{name: a, sphere: {radius: 1}, position: [.nan, 0, 0]}]", "'a'.position: must be a finite"),
        (
            "obstacles: [{name: a, sphere: {radius: 1}, quaternion_xyzw: [0, 0, 0, 2]}]",
            "quaternion_xyzw: [0.0, 0.0, 0.0, 2.0] must have length 1, not 2",
        ),
        ("obstacles: [{name: a, sphere: {radius: 1}, yaw: 0, rpy: [0, 0, 0]}]", "give only one of rpy and yaw"),
        ("obstacles: [{name: a, sphere: {radius: 1}, weight: heavy}]", "'a'.weight: must be a finite number >= 0, got"),
        ("obstacles: [{name: a, sphere: {radius: 1}, color: red}]", "'a'.color: must be '#rrggbb'"),
        ("obstacles: [{name: a, person: {world_keypoints: {hat: [0, 0, 0]}}}]", "person.world_keypoints.hat: unknown"),
        ("obstacle: []", "obstacle: unknown key; did you mean 'obstacles'? valid keys: obstacles, spacing"),
        ("spacing: 1\nobstacles: [}", "scene.yaml:2: malformed YAML"),
        ("spacing: 1\nspacing: 2", "scene.yaml:2: malformed YAML: the key 'spacing' is given twice"),
        ("spacing: !!python/object:os.system 1", "malformed YAML: could not determine a constructor"),
        *(
            (KITCHEN.replace(old, new, 1), f"scene.yaml:{place}")
            for old, new, place in [
                ("spacing: 0.2", "spacing: -1", "2: spacing: "),
                ("0.05]", "0]", "5: obstacles[0] 'table'.box.size: "),
                ("weight: 0.25", "wieght: 0.25", "7: obstacles[0] 'table'.wieght: "),
                ("1.7}", "170}", "9: obstacles[1] 'cook'.person.height: "),
                ("name: pot", "name: table", "12: obstacles[2].name: 'table' is already"),
                ("yaw: 3.14", "yaw: 3.14\n    yaw: 1", "12: malformed YAML: the key 'yaw' is given twice"),
            ]
        ),
    ],
)
def test_errors_name_file_key_and_value(tmp_path, text, message):
    file = tmp_path / "scene.yaml"
    file.write_text(text)
    with pytest.raises(InputError) as caught:
        Scene.from_file(file)
    assert str(caught.value).startswith(f"{file}:")
    assert message in str(caught.value)


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(InputError, match=r"no\.yaml: cannot be read \(No such file"):
        Scene.from_file(tmp_path / "no.yaml")


def test_nearly_unit_quaternions_become_unit():
    pose = Pose(quaternion_xyzw=(0, 0, 0.70713, 0.70713))
    assert np.linalg.norm(pose.quaternion_xyzw) == pytest.approx(1.0, abs=1e-15)


# ------------------------------------------------------------------------------------------------ contents


def test_lookup_and_changes(kitchen):
    with pytest.raises(UnknownNameError, match="unknown obstacle 'sink'; known: table, cook, pot"):
        kitchen["sink"]
    smaller = kitchen.without("cook")
    assert smaller.names == ("table", "pot")
    assert smaller.with_obstacles(kitchen["cook"]).names == ("table", "pot", "cook")
    with pytest.raises(InputError, match=r"obstacles\[3\].name: 'pot' is already obstacles\[2\]"):
        kitchen.with_obstacles(kitchen["pot"])
    assert repr(kitchen) == "Scene({'table': box, 'cook': person, 'pot': cylinder}, spacing=0.2)"


def test_the_hash_tells_contents_apart(kitchen):
    table = kitchen["table"]
    heavier = Obstacle(table.name, table.shape, table.pose, weight=0.5)
    other = Scene((heavier, *kitchen.obstacles[1:]), kitchen.spacing)
    hashes = {scene.content_hash() for scene in (kitchen, other, kitchen.without("pot"), Scene())}
    assert len(hashes) == 4
    assert Scene().content_hash() == Scene().content_hash()


def test_danger_points_carry_weight_and_owner(kitchen):
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
def test_a_scene_without_danger_has_no_points(scene):
    points, weights, owner = scene.danger_points()
    assert points.shape == (0, 3)
    assert weights.shape == owner.shape == (0,)


def test_parts_have_names_and_places(kitchen):
    ((name, _, placement),) = kitchen["table"].geometries()
    assert name == "table"
    assert placement.translation == pytest.approx([0.5, 0, 0.4])
    names = [name for name, _, _ in kitchen["cook"].geometries()]
    assert "cook/head" in names
    assert len(set(names)) == len(names) > 10


# --------------------------------------------------------------------------------- inputs as people have them


@pytest.mark.parametrize(
    ("build", "message"),
    [
        (lambda: Scene([{}]), "obstacles[0].shape: give exactly one of"),
        (lambda: Scene([Sphere(1)]), "obstacles[0]: must be an Obstacle, or a mapping that describes one, got Sphere"),
        (lambda: Scene(Obstacle("a", Sphere(1))), "obstacles: must be a list of Obstacle, got Obstacle('a',"),
        (lambda: Scene([Obstacle("a", Sphere(1))] * 2), "obstacles[1].name: 'a' is already obstacles[0], the same"),
        (lambda: Obstacle("a", {}), "shape: must be a shape (Box, Sphere, Cylinder, Capsule, Mesh, PointCloud"),
        (lambda: Obstacle("a", Sphere(1), [1, 2]), "pose.position: must be 3 numbers, got 2"),
        (lambda: Obstacle("a", Sphere(1), 7), "pose: must be a Pose, a pin.SE3 or a 4×4 matrix, got 7"),
        (lambda: Obstacle("a", Sphere(1), 2 * np.eye(4)), "pose: must be a rigid transform, got [[2.0"),
        (lambda: Obstacle("a", Sphere(1), np.diag([1, 1, -1, 1])), "pose: must be a rigid transform"),
        (lambda: Pose((0, 1e160, 0)), "position: [0.0, 1e+160, 0.0] is farther than 10000 m away; are they metres?"),
        (lambda: Box((1e12, 1, 1)), "size: must be a finite number in (0, 10000], got 1000000000000.0"),
        (lambda: Box((1, 1)), "size: must be 3 numbers, got 2"),
        (lambda: Box("big"), "size: must be a list, got str 'big'"),
        (lambda: Sphere(True), "radius: must be a finite number in (0, 10000], got True"),
        (lambda: Cylinder(0.1, float("inf")), "length: must be a finite number in (0, 10000], got inf"),
        (lambda: Person(180), "height: must be a finite number in [0.3, 2.8], got 180"),
        (lambda: Person(keypoints={"left_wrst": (0, 0, 1)}), "keypoints.left_wrst: unknown key; did you mean"),
        (lambda: Person(keypoints={"head": (0, 0)}), "keypoints.head: must be 3 numbers"),
        (lambda: Person(keypoints={"left_hand": (2, 0, 1)}), "keypoints.left_hand: the wrist is"),
        (lambda: Person(only=["tail"]), "only[0]: unknown limb 'tail'; known: head, neck"),
        (lambda: PointCloud(0.01, points=[[1e6, 0, 0]]), "points: point [1000000.0, 0.0, 0.0] is farther than"),
    ],
)
def test_mistakes_are_one_clear_line(build, message):
    with pytest.raises(InputError) as caught:
        build()
    assert str(caught.value).startswith(message)


@pytest.mark.parametrize(
    ("key", "value", "words"),
    [
        ("yaw", 180, r"yaw: 180 rad is more than a turn: angles are in radians \(180 degrees are 3.1416\)"),
        ("rpy", [0, -90, 0], r"rpy: -90 rad is more than a turn"),
        ("position", [0.4, 550, 0.2], r"position: 550 m is far away: positions are in metres \(550 mm are 0.55\)"),
        ("yaw", 3.14, None),
        ("rpy", [0, -6.28, 1], None),
        ("position", [40.0, -60.0, 0.0], None),
    ],
)
def test_values_in_other_units_are_told(caplog, key, value, words):
    warn_once.cache_clear()
    data = {"name": "box", "box": {"size": [1, 1, 1]}, key: value}
    Obstacle.from_mapping(data, Path())
    said = [record.getMessage() for record in caplog.records]
    assert len(said) == (words is not None)
    assert all(words and re.match(words, text) for text in said)


def test_poses_of_all_kinds():
    turned = pin.SE3(pin.rpy.rpyToMatrix(0.1, 0.2, 0.3), np.array([1.0, 2.0, 3.0]))
    for place in (turned, turned.homogeneous, turned.homogeneous.tolist(), Pose.of(turned)):
        pose = Obstacle("a", Sphere(1), place).pose
        assert pose.se3.homogeneous == pytest.approx(turned.homogeneous, abs=1e-12)
    assert Pose((1, 2, 3), pin.Quaternion(turned.rotation)) == Pose.of(turned)
    assert Pose(np.array([1, 2, 3], dtype=np.float32)) == Pose([np.int64(1), 2, 3.0])


def test_sizes_of_all_kinds():
    assert Box(np.array([1, 2, 3])) == Box([np.float32(1), np.int64(2), 3])
    assert Sphere(np.array(2)) == Sphere(np.int8(2)) == Sphere(2.0)
    obstacle = Obstacle("a", Sphere(1), weight=np.float32(0.5), color=np.array([0, 1, 0.5]))
    assert (obstacle.weight, obstacle.color) == (0.5, (0.0, 1.0, 0.5))


@pytest.mark.parametrize(
    "value",
    [
        Pose((1, 2, 3)),
        Pose.from_rpy((1, 2, 3), (0, 0, 1)),
        Obstacle("a", Box((1, 2, 3))),
        Obstacle("b", Person(1.8, {"head": (0, 0, 1)}), Pose((1, 0, 0)), 0.5, "#ff0000"),
        Obstacle("c", Capsule(0.1, 1), color=(0.0, 0.5, 1.0)),
    ],
)
def test_a_repr_is_the_constructor(value):
    names = (Pose, Obstacle, Box, Capsule, Person)
    assert eval(repr(value), {kind.__name__: kind for kind in names}) == value


@pytest.mark.parametrize(
    ("scene", "message"),
    [
        (lambda: Scene([Obstacle("a", Box((1, 1, 1)), weight=1)], 1e-4), "6e+08 danger points of 'a'"),
        (lambda: Scene([Obstacle("a", Person())], 1e-6), "danger points of 'a'"),
        (lambda: Scene([Obstacle("a", Sphere(1e4), weight=1)]), "danger points of 'a'"),
        (lambda: Scene([Obstacle("a", Cylinder(1, 1e4), weight=1)], 1e-2), "danger points of 'a'"),
        (
            lambda: Scene([Obstacle(str(k), Box((40, 40, 40)), weight=1) for k in range(2)]),
            "1.9e+06 danger points of 2 obstacles, at most 1e+06 are taken; give at least 0.14 m",
        ),
    ],
)
def test_too_many_danger_points_are_refused_before_they_are_made(scene, message, monkeypatch):
    for kind in (Box, Sphere, Cylinder, Capsule):
        monkeypatch.setattr(kind, "danger_points", lambda *_: pytest.fail("points were made"))
    with pytest.raises(InputError) as caught:
        scene().danger_points()
    assert str(caught.value).startswith("spacing: ")
    assert message in str(caught.value)


def test_there_are_never_more_danger_points_than_estimated(tmp_path):
    mesh = Mesh(write_tetrahedron(tmp_path / "part.obj", 0.3))
    shapes = (Box((0.3, 2, 0.01)), Sphere(0.4), Cylinder(0.5, 0.1), Cylinder(0.01, 3), Capsule(0.2, 0.5), mesh)
    for shape in (*shapes, Person(), PointCloud(0.1, points=np.eye(3))):
        for spacing in (0.03, 0.1, 5.0):
            most = shape.most_danger_points(spacing)
            assert len(shape.danger_points(spacing)) <= most


def test_a_mesh_in_millimetres_is_recognised(tmp_path):
    file = write_tetrahedron(tmp_path / "part.obj", 30_000)
    with pytest.raises(InputError, match=r"scale: .*reaches 30000 m.*needs a scale of \[0.001, 0.001, 0.001\]"):
        Mesh(file)
    assert Mesh(file, (0.001, 0.001, 0.001)).surface[0].max() == pytest.approx(30)


def test_what_may_touch_has_a_core_that_it_must_not_touch():
    table, ball = Obstacle("table", Box([1, 1, 0.1]), weight=1.0), Obstacle("ball", Sphere(0.1))
    scene = Scene([table, ball]).touched([("cube", "table"), ("hand", "table")], 0.002)
    assert scene.names == ("table, 2 mm deep", "table", "ball")
    assert scene["table"].touched_by == ("cube", "hand")
    assert scene["table, 2 mm deep"].shape.size == pytest.approx((0.996, 0.996, 0.096))
    assert (scene["table"].weight, scene["table, 2 mm deep"].weight) == (1.0, 0.0)
    assert Scene.from_yaml(scene.to_yaml()) == scene
    assert scene.content_hash() != Scene([table, ball]).content_hash()


@pytest.mark.parametrize(
    ("obstacle", "depth", "words"),
    [
        (Obstacle("it", Sphere(0.001)), 0.001, "'it'.radius: must be a finite number in"),
        (Obstacle("it", Box([1, 1, 0.001])), 0.001, "'it'.size: must be a finite number in"),
        (Obstacle("it", Person(1.7)), 0.001, "'it'.shape: must be a box, sphere, cylinder or capsule to be touched"),
        (Obstacle("it", Sphere(0.1)), -1, "depth: must be"),
    ],
)
def test_what_has_no_core_cannot_be_touched(obstacle, depth, words):
    with pytest.raises(InputError, match=words):
        Scene([obstacle]).touched([("hand", "it")], depth)
