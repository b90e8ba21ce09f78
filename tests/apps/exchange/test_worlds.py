"""Worlds of MoveIt: distances are those of the source's own shapes; what is not read is refused."""

import json
import struct

import coal
import numpy as np
import pinocchio as pin
import pytest
import yaml

from safe_ompl import InputError, Scene, Sphere
from safe_ompl.apps.exchange import scene_from_moveit

PLACES = 1000
EXACT = 1e-6  # [m]
RNG = np.random.default_rng(0)


def turned(x, y, z, w):
    return pin.SE3(pin.Quaternion(w, x, y, z).normalized().matrix(), np.zeros(3))


def at(x, y, z):
    return pin.SE3(np.eye(3), np.array([x, y, z], dtype=float))


def distance(shape, place, probe, there):
    return coal.distance(shape, place, probe, there, coal.DistanceRequest(), coal.DistanceResult())


def assert_same_distances(scene, expected):
    """Compare a scene with shapes at places, as seen by a capsule at random places that are outside."""
    probe = coal.Capsule(0.02, 0.1)
    parts = [(part.geometry, o.pose.se3 * part.placement) for o in scene for part in o.shape.parts()]
    compared = 0
    for _ in range(PLACES):
        there = pin.SE3.Random()
        there.translation = RNG.uniform(-1.5, 1.5, 3)
        own, theirs = (min(distance(*solid, probe, there) for solid in solids) for solids in (parts, expected))
        assert (own > 0) == (theirs > 0) or abs(theirs) < EXACT
        if theirs > 0:
            assert own == pytest.approx(theirs, abs=EXACT)
            compared += 1
    assert compared > PLACES / 3


CUBE = [[x, y, z] for x in (0, 0.3) for y in (0, 0.2) for z in (0, 0.1)]
CUBE_FACES = [[0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1]]  # not all: it is the hull that counts


def shapes(table, wedge):
    """Return the shapes of a table of two parts, and of a wedge that is the hull of a mesh, at their places."""
    parts = (coal.Box(0.4, 0.3, 0.1), at(0, 0, 0.2)), (coal.Cylinder(0.05, 0.5), at(0, 0.4, 0))
    placed = [(shape, table * place) for shape, place in parts]
    return [*placed, (coal.Box(0.3, 0.2, 0.1), wedge * at(0.15, 0.1, 0.05))]


PLANNING_SCENE = """
fixed_frame_transforms:
- header: {frame_id: world}
  child_frame_id: cell
  transform: {translation: {x: 0.5, y: 0, z: 0}, rotation: &turn {x: 0.5, y: 0.5, z: 0.5, w: 0.5}}
robot_state:
  attached_collision_objects:
  - link_name: hand
    touch_links: [finger]
    object: {header: {frame_id: hand}, id: tool, primitives: [{type: 2, dimensions: [0.05]}],
             primitive_poses: [{position: {x: 0, y: 0, z: 0.1}}]}
allowed_collision_matrix:
  entry_names: [hand, table, tool, arm]
  entry_values:
  - enabled: [false, false, false, true]
  - enabled: [false, false, true, true]
  - enabled: [false, true, false, false]
  - enabled: [true, true, false, false]
  default_entry_names: [base]
  default_entry_values: [true]
link_padding: [{link_name: hand, padding: 0.0}]
world:
  collision_objects:
  - header: {frame_id: cell}
    id: table
    pose: {position: {x: 0.1, y: 0.2, z: 0.3}, orientation: *turn}
    primitives: [{type: 1, dimensions: [0.4, 0.3, 0.1]}, {type: 3, dimensions: [0.5, 0.05]}]
    primitive_poses: [{position: {x: 0, y: 0, z: 0.2}},
                      {position: {x: 0, y: 0.4, z: 0}, orientation: {x: 0, y: 0, z: 0, w: 0}}]
    operation: 0
  - header: {frame_id: world}
    id: wedge
    mesh_poses: [{position: {x: -0.8, y: 0, z: 0}, orientation: *turn}]
is_diff: false
"""


def planning_scene():
    message = yaml.safe_load(PLANNING_SCENE)
    vertices = [dict(zip("xyz", corner, strict=True)) for corner in CUBE]
    mesh = {"vertices": vertices, "triangles": [{"vertex_indices": face} for face in CUBE_FACES]}
    message["world"]["collision_objects"][1]["meshes"] = [mesh]
    return message


@pytest.mark.parametrize("form", ["json", "yaml"])
def test_a_planning_scene_is_as_far_away_as_its_shapes(form, tmp_path):
    file, message = tmp_path / f"scene.{form}", planning_scene()
    file.write_text(json.dumps(message) if form == "json" else yaml.safe_dump(message))
    scene, held = scene_from_moveit(file, meshes=tmp_path / "meshes")
    turn = turned(0.5, 0.5, 0.5, 0.5)
    assert_same_distances(scene, shapes(at(0.5, 0, 0) * turn * at(0.1, 0.2, 0.3) * turn, at(-0.8, 0, 0) * turn))
    assert scene.names == ("table/0", "table/1", "wedge")
    assert [o.touched_by for o in scene] == [("arm", "tool"), ("arm", "tool"), ()]
    assert (held[0].name, held[0].link, held[0].touch_links) == ("tool", "hand", ("finger",))
    assert held[0].pose.position == (0, 0, 0.1)


OBJECTS = """cell, exported from RViz
* table
{table}2
box
0.4 0.3 0.1
0 0 0.2
0 0 0 1
0.5 0.25 0 1
cylinder
0.05 0.5
0 0.4 0
0 0 0 1
0 0 0 0
{subframes}* a cone / half
{flat}1
cone
0.2 0.6
0 -0.5 0
0 0.7071067811865476 0 0.7071067811865476
0 0 0 0
{none}* wedge
{flat}1
mesh
8 12
{vertices}
{faces}
-0.8 0 0
0 0 0 1
0 0 0 0
{none}* nothing
{flat}0
{none}.
"""


def objects(new):
    """Return a `.scene` file in the newer format, where objects have poses, or in the older one, without them."""
    vertices, faces = ("\n".join(" ".join(map(str, row)) for row in rows) for rows in (CUBE, CUBE_FACES * 2))
    place = "0.5 0 0\n0.5 0.5 0.5 0.5\n" if new else ""
    parts = {"table": place, "flat": "0 0 0\n0 0 0 1\n" if new else "", "none": "0\n" if new else ""}
    parts["subframes"] = "1\nhandle\n0 0 1\n0 0 0 1\n" if new else ""
    return OBJECTS.format(vertices=vertices, faces=faces, **parts)


@pytest.mark.parametrize("new", [True, False])
def test_what_rviz_exports_is_as_far_away_as_its_shapes(new, tmp_path):
    file = tmp_path / "cell.scene"
    file.write_text(objects(new))
    scene, held = scene_from_moveit(file, meshes=tmp_path / "meshes")
    place = at(0.5, 0, 0) * turned(0.5, 0.5, 0.5, 0.5) if new else pin.SE3.Identity()
    cone = scene["a cone / half"]
    assert_same_distances(scene.without(cone.name), shapes(place, at(-0.8, 0, 0)))
    assert (scene.names, held) == (("table/0", "table/1", cone.name, "wedge"), ())
    assert [o.color for o in scene] == [(0.5, 0.25, 0.0), None, None, None]
    # The mesh of a cone contains the cone, and is wider by 0.5 % of the radius at most.
    own, real = cone.shape.parts()[0].geometry, coal.Cone(0.2, 0.6)
    assert cone.pose.se3.isApprox(at(0, -0.5, 0) * turned(0, 1, 0, 1))
    for _ in range(300):
        ball = pin.SE3.Random()
        ball.translation *= 2
        near, far = (distance(shape, pin.SE3.Identity(), coal.Sphere(0.01), ball) for shape in (own, real))
        assert far - 1.01 * 0.2 * 0.005 - EXACT < near < far + EXACT or far <= 0
    content = {"moveit": "cell.scene", "meshes": "meshes", "obstacles": [{"name": "ball", "sphere": {"radius": 0.1}}]}
    (tmp_path / "scene.yaml").write_text(yaml.safe_dump(content))
    whole = Scene.from_file(tmp_path / "scene.yaml")
    assert whole.without("ball") == scene
    whole.save(tmp_path / "saved.yaml")
    assert Scene.from_file(tmp_path / "saved.yaml") == whole
    with pytest.raises(InputError, match=r"cell.scene:\d+: 'a cone / half': meshes: missing, but needed: the folder"):
        Scene.from_file(file)


SHAPE = "name\n* a\n0 0 0\n0 0 0 1\n1\nbox\n1 1 1\n0 0 0\n0 0 0 1\n0 0 0 0\n0\n.\n"
TETRAHEDRON = "mesh\n4 4\n0 0 0 1 0 0 0 1 0 0 0 1\n0 1 2 0 1 3 0 2 3 1 2 3\n"


NOT_EXPORTED = [
    (SHAPE, "", ".scene:1: ends before the dot that ends it"),
    ("* a", "*", r".scene:2: must be named"),
    ("* a", "a", r".scene:2: must be '\* ID' or '.', got 'a'"),
    (".\n", "", "scene:11: 'a': ends before the dot"),
    (".\n", SHAPE.removeprefix("name\n"), "scene:12: 'a': is there twice"),
    ("0 0 0\n0 0 0 1\n1", "0 0 x\n0 0 0 1\n1", "scene:3: 'a': pose: must be a number, got 'x'"),
    ("0 0 0\n0 0 0 1\n1", "0 0 nan\n0 0 0 1\n1", "scene:3: 'a': pose: must be a finite number, got nan"),
    ("0 0 0\n0 0 0 1\n1", "0 0 0\n0 0 0 0\n1", "scene:4: 'a': quaternion_xyzw"),
    ("\n1\nbox", "\n-1\nbox", "'a': number of shapes: must be a finite number in"),
    ("\n1\nbox", "\n1.5\nbox", "'a': number of shapes: must be a whole number, got 1.5"),
    ("\n1\nbox", "\n999999999\nbox", r"scene:12: 'a': must be|scene:1.: 'a'"),
    ("box", "bax", "scene:6: 'a': unknown kind of shape 'bax'; did you mean 'box'"),
    ("box\n1 1 1", "plane\n0 0 1 0", "'a': unknown kind of shape 'plane'; known: box, sphere, cylinder, cone, mesh"),
    ("box\n1 1 1", "box\n1 1 -1", "scene:7: 'a': z of the box: must be a positive number, got -1"),
    ("box\n1 1 1", "cylinder\n1", "scene:8|scene:9|scene:10"),
    ("box\n1 1 1\n", TETRAHEDRON.replace("4 4", "4 999999999"), "'a': corner of a triangle"),
    ("box\n1 1 1\n", TETRAHEDRON.replace("1 2 3\n", "1 2 4\n"), r"corner of a triangle: must be .* \[0, 3\], got 4"),
    ("box\n1 1 1\n", TETRAHEDRON.replace("4 4", "3 4"), "number of vertices: must be a finite number in .4"),
    ("box\n1 1 1\n", TETRAHEDRON.replace("0 1 0 0 0 1", "0 1 0 1 1 0"), "is flat"),
    ("0 0 0 0\n0\n", "0 0 2 0\n0\n", r"color: must be a finite number in \[0, 1\], got 2"),
    ("0 0 0 0\n0\n", "0 0 0 0\n1\n", "ends before pose|pose: must be"),
]


@pytest.mark.parametrize(("old", "new", "said"), NOT_EXPORTED)
def test_what_rviz_does_not_export_is_refused(old, new, said, tmp_path):
    file = tmp_path / "cell.scene"
    file.write_text(SHAPE)
    assert len(scene_from_moveit(file)[0].obstacles) == 1
    file.write_text(SHAPE.replace(old, new, 1))
    with pytest.raises(InputError, match=said) as error:
        scene_from_moveit(file, meshes=tmp_path)
    assert "\n" not in str(error.value)


def test_a_scene_of_moveit_in_a_scenario_must_be_there(tmp_path):
    file = tmp_path / "scene.yaml"
    for content, said in (
        ({"moveit": "none.scene"}, "scene.yaml:1: moveit: .*none.scene' does not exist"),
        ({"moveit": 3}, "moveit: must be text"),
        ({"moveit": "scene.yaml"}, "moveit: .* must end in .scene"),
        ({"meshes": "folder"}, "meshes: needs the key moveit with a file, which is missing"),
        ({"movit": "x.scene"}, "movit: unknown key; did you mean 'moveit'"),
    ):
        file.write_text(yaml.safe_dump(content))
        with pytest.raises(InputError, match=said):
            Scene.from_file(file)
    (tmp_path / "latin.scene").write_bytes(b"\xff\xfe")
    with pytest.raises(InputError, match=r"latin.scene: is not text in UTF-8"):
        scene_from_moveit(tmp_path / "latin.scene")


MESSAGE = """World world
bool is_diff
================================================================================
MSG: moveit_msgs/World
Object[] collision_objects
================================================================================
MSG: moveit_msgs/Object
string id
Solid[] primitives
Pose[] primitive_poses
byte operation
================================================================================
MSG: moveit_msgs/Solid
uint8 type
float64[] dimensions
================================================================================
MSG: moveit_msgs/Pose
Point position
================================================================================
MSG: moveit_msgs/Point
float64 x
float64 y
float64 z
"""


def test_the_last_scene_of_a_recording_counts(tmp_path):
    pytest.importorskip("rosbags")
    from mcap.writer import Writer
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    kind, store, file = "moveit_msgs/msg/PlanningScene", get_typestore(Stores.EMPTY), tmp_path / "scene.mcap"
    store.register(get_types_from_msg(MESSAGE, kind))
    world, body, solid, pose, point = (
        store.types[f"moveit_msgs/msg/{name}"] for name in ("World", "Object", "Solid", "Pose", "Point")
    )
    with file.open("wb") as stream:
        writer = Writer(stream)
        writer.start()
        schema = writer.register_schema(kind, "ros2msg", MESSAGE.encode())
        channel = writer.register_channel("/planning_scene", "cdr", schema)
        for time, radius in enumerate((0.1, 0.2)):
            ball = body("ball", [solid(2, np.array([radius]))], [pose(point(1.0, 2.0, 3.0))], 0)
            message = store.types[kind](world([ball]), False)
            writer.add_message(channel, time, bytes(store.serialize_cdr(message, kind)), time)
        writer.finish()
    scene, _ = scene_from_moveit(file, topic="/planning_scene")
    assert [(o.name, o.shape, o.pose.position) for o in scene] == [("ball", Sphere(0.2), (1, 2, 3))]


def changed(key, value):
    """Return what changes a message at a place; `objects`, `held` and `padding` are short for theirs."""

    def change(message):
        *path, last = key.split()
        short = {"objects": message["world"]["collision_objects"], "padding": message["link_padding"]}
        short["held"] = message["robot_state"]["attached_collision_objects"]
        for step in path:
            message = short[step] if step in short else message[int(step) if step.isdigit() else step]
        message[int(last) if last.isdigit() else last] = value

    return change


NO_SCENES = [
    (changed("is_diff", True), "is_diff: must be false"),
    (changed("wrld", {}), "wrld: unknown key; did you mean"),
    (changed("world obstacles", []), "world.obstacles: unknown key"),
    (changed("padding 0 padding", 0.01), r"link_padding\[0\].padding: must be 0, got 0.01"),
    (changed("objects 0 header frame_id", "moon"), "'table'.header.frame_id: .*'moon'"),
    (changed("objects 0 primitives 0 type", 5), r"primitives\[0\].type: must be .*got 5"),
    (changed("objects 0 primitives 1 dimensions", [1]), r"dimensions: must be 2 numbers"),
    (changed("objects 0 planes", [{"coef": [0, 0, 1, 0]}]), "planes"),
    (changed("objects 0 operation", 1), r"operation: must be ADD \(0\), got 1"),
    (changed("objects 0 primitive_poses", []), "primitive_poses: must have 2 entries, got 0"),
    (changed("objects 0 mesh", []), "mesh: unknown key"),
    (changed("world octomap", {"octomap": {"data": [1], "binary": False}}), "must be a binary OcTree"),
    (changed("held 0 object header", {"frame_id": "arm"}), "the link 'hand'"),
    (changed("objects 1 id", None), "id: must be"),
    (changed("world octomap", {"octomap": {"data": [1], "binary": True, "id": "ColorOcTree"}}), "got .* 'ColorOcTree'"),
    (changed("allowed_collision_matrix default_entry_names", ["table"]), "default_entry_values: 'table' may touch"),
    (changed("padding 0", {}), "is malformed .KeyError: 'padding'"),
]


@pytest.mark.parametrize(("change", "said"), NO_SCENES)
def test_what_a_planning_scene_cannot_be_is_refused(change, said, tmp_path):
    message, file = planning_scene(), tmp_path / "scene.json"
    change(message)
    file.write_text(json.dumps(message))
    with pytest.raises(InputError, match=said) as error:
        scene_from_moveit(file, meshes=tmp_path)
    assert str(error.value).startswith(str(file))
    assert "\n" not in str(error.value)


def test_meshes_are_written_only_where_one_says(tmp_path):
    file = tmp_path / "scene.json"
    file.write_text(json.dumps(planning_scene()))
    with pytest.raises(InputError, match=r"'wedge'.meshes\[0\].*missing, but needed: the folder"):
        scene_from_moveit(file)


def tree_bytes(occupied, free, depth=16):
    """Return the data of a binary map, by the format's specification, whose leaves are cells."""
    leaves = dict.fromkeys(occupied, 2) | dict.fromkeys(free, 1)

    def node(keys, level):
        bits, below = 0, b""
        for child in range(8):
            own = {k: s for k, s in keys.items() if sum((k[a] + 2**15 >> level & 1) << a for a in range(3)) == child}
            state = 0 if not own else next(iter(own.values())) if level == 0 else 3
            bits |= state << 2 * child
            below += node(own, level - 1) if state == 3 else b""
        return struct.pack("<H", bits) + below

    return node(leaves, depth - 1)


def scene_with_map(folder, data, resolution=0.1):
    """Read a planning scene that holds nothing but a map."""
    bytes_of_ros = [value - 256 * (value > 127) for value in data]
    octomap = {"binary": True, "id": "OcTree", "resolution": resolution, "data": bytes_of_ros}
    (folder / "scene.json").write_text(json.dumps({"world": {"octomap": {"octomap": octomap}}}))
    return scene_from_moveit(folder / "scene.json")[0]


def test_a_map_is_as_far_away_as_its_leaves(tmp_path):
    cells = {tuple(key) for key in RNG.integers(-6, 6, (60, 3)).tolist()} | {(k, 0, 2) for k in range(-6, 6)}
    free = {tuple(key) for key in RNG.integers(-6, 6, (60, 3)).tolist()} - cells
    scene = scene_with_map(tmp_path, tree_bytes(cells, free))
    leaves = [(coal.Box(0.1, 0.1, 0.1), at(*(0.1 * (np.array(key) + 0.5)))) for key in cells]
    assert len(scene.obstacles) < len(leaves)  # neighbours are one
    assert sum(np.prod(box.shape.size) for box in scene) == pytest.approx(0.1**3 * len(leaves))
    assert_same_distances(scene, leaves)


@pytest.mark.parametrize(
    ("data", "said"),
    [(b"\xff", "cut off at byte 0"), (b"\xff\xff", "cut off at byte 2"), (b"\0\0\0", "has 3 bytes, 2 expected")],
)
def test_a_broken_map_is_refused(data, said, tmp_path):
    with pytest.raises(InputError, match=said):
        scene_with_map(tmp_path, data)


def test_a_pruned_leaf_is_a_large_box(tmp_path):
    (box,) = scene_with_map(tmp_path, struct.pack("<H", 2 << 2 * 7), resolution=1e-4)
    assert box.shape.size == pytest.approx([3.2768] * 3)
    assert box.pose.position == pytest.approx([1.6384] * 3)
