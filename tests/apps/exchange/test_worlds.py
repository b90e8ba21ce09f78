"""Worlds of MoveIt, cuRobo and OctoMap: distances are those of the source's own shapes; what is not read is refused."""

import json
import struct

import coal
import numpy as np
import pinocchio as pin
import pytest
import yaml

from safe_ompl import CollisionChecker, InputError, Robot, Sphere
from safe_ompl.apps.exchange import robot_from_curobo, scene_from_curobo, scene_from_moveit, scene_from_octomap
from safe_ompl.robot import find_example, robots_folder

PLACES = 1000
EXACT = 1e-6  # [m]
RNG = np.random.default_rng(0)


def turned(x, y, z, w):
    return pin.SE3(pin.Quaternion(w, x, y, z).normalized().matrix(), np.zeros(3))


def distance(shape, place, probe, at):
    result = coal.DistanceResult()
    places = (coal.Transform3s(each.rotation, each.translation) for each in (place, at))
    one, other = places
    return coal.distance(shape, one, probe, other, coal.DistanceRequest(), result)


def assert_same_distances(scene, expected):
    """Compare a scene with shapes at places, as seen by a capsule at random places that are outside."""
    probe = coal.Capsule(0.02, 0.1)
    parts = [(part.geometry, o.pose.se3 * part.placement) for o in scene for part in o.shape.parts()]
    compared = 0
    for _ in range(PLACES):
        at = pin.SE3.Random()
        at.translation = RNG.uniform(-1.5, 1.5, 3)
        own, theirs = (min(distance(*solid, probe, at) for solid in solids) for solids in (parts, expected))
        assert (own > 0) == (theirs > 0) or abs(theirs) < EXACT
        if theirs > 0:
            assert own == pytest.approx(theirs, abs=EXACT)
            compared += 1
    assert compared > PLACES / 3


CUBE = [[x, y, z] for x in (0, 0.3) for y in (0, 0.2) for z in (0, 0.1)]
CUBE_FACES = [[0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1]]  # not all: it is the hull that counts


def xyz(values):
    return dict(zip("xyzw", values, strict=False))


def planning_scene():
    turn = xyz([0.5, 0.5, 0.5, 0.5])
    head = {"frame_id": "world"}
    table = {
        "header": {"frame_id": "cell"},
        "id": "table",
        "pose": {"position": xyz([0.1, 0.2, 0.3]), "orientation": turn},
        "primitives": [{"type": 1, "dimensions": [0.4, 0.3, 0.1]}, {"type": 3, "dimensions": [0.5, 0.05]}],
        "primitive_poses": [
            {"position": xyz([0, 0, 0.2])},
            {"position": xyz([0, 0.4, 0]), "orientation": xyz([0] * 4)},
        ],
        "operation": 0,
    }
    wedge = {
        "header": head,
        "id": "wedge",
        "meshes": [
            {"vertices": [xyz(v) for v in CUBE], "triangles": [{"vertex_indices": face} for face in CUBE_FACES]}
        ],
        "mesh_poses": [{"position": xyz([-0.8, 0, 0]), "orientation": turn}],
    }
    held = {"header": {"frame_id": "hand"}, "id": "tool", "primitives": [{"type": 2, "dimensions": [0.05]}],
            "primitive_poses": [{"position": xyz([0, 0, 0.1])}]}  # fmt: skip
    names = ["hand", "table", "tool", "arm"]
    allowed = {("hand", "arm"), ("arm", "table"), ("table", "tool")}
    return {
        "fixed_frame_transforms": [
            {"header": head, "child_frame_id": "cell", "transform": {"translation": xyz([0.5, 0, 0]), "rotation": turn}}
        ],
        "robot_state": {
            "attached_collision_objects": [{"link_name": "hand", "object": held, "touch_links": ["finger"]}]
        },
        "allowed_collision_matrix": {
            "entry_names": names,
            "entry_values": [{"enabled": [(a, b) in allowed or (b, a) in allowed for b in names]} for a in names],
        },
        "link_padding": [{"link_name": "hand", "padding": 0.0}],
        "world": {"collision_objects": [table, wedge]},
        "is_diff": False,
    }


@pytest.mark.parametrize("form", ["json", "yaml"])
def test_a_planning_scene_is_as_far_away_as_its_shapes(form, tmp_path):
    file, message = tmp_path / f"scene.{form}", planning_scene()
    file.write_text(json.dumps(message) if form == "json" else yaml.safe_dump(message))
    scene, held = scene_from_moveit(file, meshes=tmp_path / "meshes")
    shift = [
        pin.SE3(np.eye(3), np.array(t)) for t in ([0.5, 0, 0], [0.1, 0.2, 0.3], [0, 0, 0.2], [0, 0.4, 0], [-0.8, 0, 0])
    ]
    turn = turned(0.5, 0.5, 0.5, 0.5)
    table = shift[0] * turn * shift[1] * turn
    middle = pin.SE3(np.eye(3), np.array([0.15, 0.1, 0.05]))
    expected = [
        (coal.Box(0.4, 0.3, 0.1), table * shift[2]),
        (coal.Cylinder(0.05, 0.5), table * shift[3]),
        (coal.Box(0.3, 0.2, 0.1), shift[4] * turn * middle),
    ]
    assert_same_distances(scene, expected)
    assert scene.names == ("table/0", "table/1", "wedge")
    assert [o.touched_by for o in scene] == [("arm", "tool"), ("arm", "tool"), ()]
    assert (held[0].name, held[0].link, held[0].touch_links) == ("tool", "hand", ("finger",))
    assert held[0].pose.position == (0, 0, 0.1)


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


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (changed("is_diff", True), "is_diff: must be false"),
        (changed("wrld", {}), "wrld: unknown key; did you mean"),
        (changed("world obstacles", []), "world.obstacles: unknown key"),
        (changed("padding 0 padding", 0.01), r"link_padding\[0\].padding: must be 0, got 0.01"),
        (changed("objects 0 header frame_id", "moon"), "'table'.header.frame_id: .*'moon'"),
        (changed("objects 0 primitives 0 type", 4), r"primitives\[0\].type: must be .*got 4"),
        (changed("objects 0 primitives 1 dimensions", [1]), r"dimensions: must be 2 numbers"),
        (changed("objects 0 planes", [{"coef": [0, 0, 1, 0]}]), "planes"),
        (changed("objects 0 operation", 1), r"operation: must be ADD \(0\), got 1"),
        (changed("objects 0 primitive_poses", []), "primitive_poses: must have 2 entries, got 0"),
        (changed("objects 0 mesh", []), "mesh: unknown key"),
        (changed("world octomap", {"octomap": {"data": [1], "binary": False}}), "must be a binary OcTree"),
        (changed("held 0 object header", {"frame_id": "arm"}), "the link 'hand'"),
        (changed("objects 1 id", None), "id: must be"),
        (changed("padding 0", {}), "is malformed .KeyError: 'padding'"),
    ],
)  # fmt: skip
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
    with pytest.raises(InputError, match=r"'wedge'.meshes\[0\].*meshes="):
        scene_from_moveit(file)


WORLD = """
cuboid: {table: {dims: [0.4, 0.3, 0.1], pose: [0.5, 0.1, 0.2, 0.5, 0.5, -0.5, 0.5], color: [1, 0, 0, 1]}}
sphere: {ball: {radius: 0.1, position: [-0.5, 0, 0]}, other: {radius: 0.2, pose: [0, 0, 0.9, 1, 0, 0, 0]}}
capsule: {rod: {radius: 0.05, base: [0, 0, 0.1], tip: [0, 0.2, 0.5], pose: [0, 0.6, 0, 0.5, 0.5, 0.5, 0.5]}}
cylinder: {can: {radius: 0.1, height: 0.3, pose: [0, -0.6, 0, 0.5, 0.5, 0.5, 0.5]}}
"""


def test_a_world_of_curobo_is_as_far_away_as_its_shapes(tmp_path):
    file = tmp_path / "world.yml"
    file.write_text(WORLD)

    def at(x, y, z):
        return pin.SE3(np.eye(3), np.array([x, y, z]))

    rod = at(0, 0.6, 0) * turned(0.5, 0.5, 0.5, 0.5)
    along = pin.Quaternion.FromTwoVectors(np.array([0, 0, 1.0]), np.array([0, 0.2, 0.4])).matrix()
    expected = [
        (coal.Box(0.4, 0.3, 0.1), at(0.5, 0.1, 0.2) * turned(0.5, -0.5, 0.5, 0.5)),
        (coal.Sphere(0.1), at(-0.5, 0, 0)),
        (coal.Sphere(0.2), at(0, 0, 0.9)),
        (coal.Capsule(0.05, np.hypot(0.2, 0.4)), rod * pin.SE3(along, np.array([0, 0.1, 0.3]))),
        (coal.Cylinder(0.1, 0.3), at(0, -0.6, 0) * turned(0.5, 0.5, 0.5, 0.5)),
    ]
    assert_same_distances(scene_from_curobo(file), expected)


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("sphere:", "blox:", r"world.yml:\d: blox: unknown key"),
        ("dims: [0.4, 0.3, 0.1]", "dims: [0.4, 0.3]", "world.yml:2: cuboid.table.*size: must be 3 numbers"),
        ("radius: 0.1,", "scale: [1, 1, 2], radius: 0.1,", "ball.scale: must be"),
        ("pose: [0, 0, 0.9, 1, 0, 0, 0]", "pose: [0, 0, 0.9, 1, 1, 0, 0]", "other.pose.quaternion_xyzw: .*length 1"),
        ("capsule: {rod", "mesh: {rod", "rod.radius: unknown key"),
    ],
)
def test_what_a_world_of_curobo_cannot_be_is_refused(old, new, said, tmp_path):
    (tmp_path / "world.yml").write_text(WORLD.replace(old, new, 1))
    with pytest.raises(InputError, match=said):
        scene_from_curobo(tmp_path / "world.yml")


LINKS = ("shoulder_link", "upper_arm_link", "forearm_link", "wrist_1_link", "wrist_3_link")
BALLS = {
    link: [{"center": [0.01 * k, 0, 0.1], "radius": 0.05}, {"center": [0, 0, 0], "radius": 0.04}]
    for k, link in enumerate(LINKS)
}


def robots_of_spheres(folder, extra):
    """Write a robot as cuRobo's YAML and as XRDF."""
    ignore = {"shoulder_link": ["upper_arm_link"], "upper_arm_link": ["forearm_link"], "wrist_1_link": ["wrist_3_link"]}
    robot = {"collision_spheres": BALLS, "collision_sphere_buffer": 0.004, "self_collision_buffer": extra,
             "self_collision_ignore": ignore, "ee_link": "tool0", "lock_joints": {"wrist_3_joint": 0.3}}  # fmt: skip
    moving = ["shoulder_pan_joint", "shoulder_lift_joint", "elbow_joint", "wrist_1_joint", "wrist_2_joint"]
    xrdf = {"format": "xrdf", "format_version": 1.0, "cspace": {"joint_names": moving}, "tool_frames": ["tool0"],
            "default_joint_positions": {"wrist_3_joint": 0.3}, "geometry": {"balls": {"spheres": BALLS}},
            "collision": {"geometry": "balls", "buffer_distance": dict.fromkeys(LINKS, 0.004)},
            "self_collision": {"geometry": "balls", "ignore": ignore, "buffer_distance": extra}}  # fmt: skip
    (folder / "robot.yml").write_text(yaml.safe_dump({"robot_cfg": {"kinematics": robot}}))
    (folder / "robot.xrdf").write_text(yaml.safe_dump(xrdf))
    return ignore


@pytest.mark.parametrize("form", ["yml", "xrdf"])
@pytest.mark.parametrize("extra", [{}, {"forearm_link": 0.02, "wrist_1_link": -0.01}])
def test_a_robot_of_spheres_is_as_far_away_as_its_spheres(form, extra, tmp_path):
    ignore = robots_of_spheres(tmp_path, extra)
    (tmp_path / "world.yml").write_text(WORLD)
    scene = scene_from_curobo(tmp_path / "world.yml").without("rod", "can", "other", "table")
    urdf = robots_folder() / find_example("ur5").urdf
    robot = robot_from_curobo(tmp_path / f"robot.{form}", urdf, package_dirs=[robots_folder().parent])
    assert robot.name.endswith("cuRobo's spheres")
    checker = CollisionChecker(robot, scene)
    with_ball = np.array(["ball" in pair for pair in checker.pair_names])
    reaching = {link for link, other in checker.pair_names if other == "ball"}  # of other links there is no question
    joints = Robot.from_example("ur5", locked={"wrist_3_joint": 0.3})  # another reading of the same joints
    model, data = joints.shared.model, joints.shared.model.createData()
    frames = {link: model.getFrameId(link) for link in LINKS}
    for q in RNG.uniform(joints.lower, joints.upper, (PLACES, joints.n)):
        pin.framesForwardKinematics(model, data, q)
        balls = [
            (link, data.oMf[frames[link]].act(np.array(ball["center"])), ball["radius"] + 0.004, extra.get(link, 0.0))
            for link in LINKS
            for ball in BALLS[link]
        ]
        own = checker.pair_distances(q)
        to_ball = min(
            np.linalg.norm(p - [-0.5, 0, 0]) - 0.1 - r - max(e, 0) for link, p, r, e in balls if link in reaching
        )
        selves = [
            np.linalg.norm(p - s) - r - t - max(e, 0) - max(f, 0)
            for i, (a, p, r, e) in enumerate(balls)
            for b, s, t, f in balls[:i]
            if a != b and a not in ignore.get(b, ()) and b not in ignore.get(a, ())
        ]
        assert own[with_ball].min() == pytest.approx(to_ball, abs=EXACT)
        assert own[~with_ball].min() == pytest.approx(min(selves), abs=EXACT)


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


def write_map(file, data, resolution=0.1):
    head = f"# Octomap OcTree binary file\n# a comment\nid OcTree\nsize 1\nres {resolution}\ndata\n"
    file.write_bytes(head.encode() + data)


def test_a_map_is_as_far_away_as_its_leaves(tmp_path):
    cells = {tuple(key) for key in RNG.integers(-6, 6, (60, 3)).tolist()} | {(k, 0, 2) for k in range(-6, 6)}
    free = {tuple(key) for key in RNG.integers(-6, 6, (60, 3)).tolist()} - cells
    data = tree_bytes(cells, free)
    write_map(tmp_path / "map.bt", data)
    scene = scene_from_octomap(tmp_path / "map.bt")
    leaves = [(coal.Box(0.1, 0.1, 0.1), pin.SE3(np.eye(3), 0.1 * (np.array(key) + 0.5))) for key in cells]
    assert len(scene.obstacles) < len(leaves)  # neighbours are one
    assert_same_distances(scene, leaves)
    message = {"world": {"octomap": {"octomap": {"binary": True, "id": "OcTree", "resolution": 0.1,
               "data": [value - 256 * (value > 127) for value in data]}}}}  # fmt: skip
    (tmp_path / "scene.json").write_text(json.dumps(message))
    assert scene_from_moveit(tmp_path / "scene.json")[0] == scene


@pytest.mark.parametrize(
    ("data", "said"),
    [(b"\xff", "cut off at byte 0"), (b"\xff\xff", "cut off at byte 2"), (b"\0\0\0", "has 3 bytes, 2 expected")],
)
def test_a_broken_map_is_refused(data, said, tmp_path):
    write_map(tmp_path / "map.bt", data)
    with pytest.raises(InputError, match=said):
        scene_from_octomap(tmp_path / "map.bt")


def test_a_pruned_leaf_is_a_large_box(tmp_path):
    write_map(tmp_path / "map.bt", struct.pack("<H", 2 << 2 * 7), resolution=1e-4)
    (box,) = scene_from_octomap(tmp_path / "map.bt")
    assert box.shape.size == pytest.approx([3.2768] * 3)
    assert box.pose.position == pytest.approx([1.6384] * 3)
