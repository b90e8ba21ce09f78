"""Files of meshes: units, axes and nodes are obeyed, and what would not be read is refused."""

import re
import struct
import xml.etree.ElementTree as ElementTree

import numpy as np
import pytest

from safe_ompl import InputError, Mesh, PointCloud, Robot
from safe_ompl.io.problems import built_robot, packed_robot
from safe_ompl.robot import robot_hash

LOW, HIGH = np.array([1.0, 3.0, 7.0]), np.array([2.0, 5.0, 10.0])
CORNERS = np.array([(x, y, z) for x in (1, 2) for y in (3, 5) for z in (7, 10)], dtype=float)
FACES = [(0, 1, 3), (0, 3, 2), (4, 6, 7), (4, 7, 5), (0, 4, 5), (0, 5, 1)]
FACES += [(2, 3, 7), (2, 7, 6), (0, 2, 6), (0, 6, 4), (1, 5, 7), (1, 7, 3)]
CORNERS_OF_SIDES = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
INPUT = '<input semantic="VERTEX" source="#v" offset="0"/>'
TRIANGLES = f'<triangles count="12">{INPUT}<p>{" ".join(map(str, np.ravel(FACES)))}</p></triangles>'
BLOCK = '<instance_geometry url="#block"/>'
NODE = f'<node id="n">{BLOCK}</node>'
HEAD = "<up_axis>Z_UP</up_axis>"


def collada(path, asset=HEAD, nodes=NODE, shape=TRIANGLES, more="", scenes="", scene="s"):
    """Write a block from LOW to HIGH, in the units of the file."""
    accessor = "".join(f'<param name="{axis}" type="float"/>' for axis in "XYZ")
    accessor = f'<technique_common><accessor source="#a" count="8" stride="3">{accessor}</accessor></technique_common>'
    numbers = f'<float_array id="a" count="24">{" ".join(map(str, CORNERS.ravel()))}</float_array>'
    position = '<vertices id="v"><input semantic="POSITION" source="#p"/></vertices>'
    path.write_text(
        f"""<?xml version="1.0"?>
        <COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1"><asset>{asset}</asset>
        <library_geometries><geometry id="block"><mesh><source id="p">{numbers}{accessor}</source>{position}{shape}
        </mesh></geometry></library_geometries>{more}
        <library_visual_scenes><visual_scene id="s">{nodes}</visual_scene>{scenes}</library_visual_scenes>
        <scene><instance_visual_scene url="#{scene}"/></scene></COLLADA>"""
    )
    return path


def written(folder, name, content):
    """Write a file of text, bytes, or what a block of COLLADA has of its own; None writes none."""
    if isinstance(content, dict):
        return collada(folder / name, **content)
    if content is not None:
        (folder / name).write_bytes(content if isinstance(content, bytes) else content.encode())
    return folder / name


def box(vertices):
    return np.array([vertices.min(axis=0), vertices.max(axis=0)])


def node(transform, inside=BLOCK):
    return f'<node id="outer">{transform}{inside}</node>'


OTHER_SCENE = f'<visual_scene id="t">{node("<translate>50 0 0</translate>")}</visual_scene>'
LIBRARY = f'<library_nodes><node id="part"><translate>0 0 5</translate>{BLOCK}</node></library_nodes>'


@pytest.mark.parametrize(
    ("file", "low", "high"),
    {
        "metres": ({}, LOW, HIGH),
        "centimetres": ({"asset": f'<unit name="cm" meter="0.01"/>{HEAD}'}, LOW / 100, HIGH / 100),
        "inches": ({"asset": f'<unit meter="2.54e-2"/>{HEAD}'}, 0.0254 * LOW, 0.0254 * HIGH),
        "a name alone": ({"asset": f'<unit name="centimeter"/>{HEAD}'}, LOW, HIGH),
        "y up": ({"asset": "<up_axis>Y_UP</up_axis>"}, (1, -10, 3), (2, -7, 5)),
        "nothing said is y up": ({"asset": ""}, (1, -10, 3), (2, -7, 5)),
        "x up": ({"asset": "<up_axis>X_UP</up_axis>"}, (-5, -10, 1), (-3, -7, 2)),
        "both": ({"asset": '<unit meter="0.1"/><up_axis> Y_UP </up_axis>'}, (0.1, -1, 0.3), (0.2, -0.7, 0.5)),
        "a matrix": ({"nodes": node("<matrix>2 0 0 0 0 2 0 0 0 0 2 1 0 0 0 1</matrix>")}, (2, 6, 15), (4, 10, 21)),
        "nodes in nodes": (
            {"nodes": node("<scale>2 2 2</scale>", node("<translate>1 0 0</translate><rotate>0 0 1 90</rotate>"))},
            (-8, 2, 14),
            (-4, 4, 20),
        ),
        "two instances": ({"nodes": NODE + node("<translate>9 0 0</translate>")}, LOW, (11, 5, 10)),
        "a library of nodes": (
            {"nodes": node("<translate>1 0 0</translate>", '<instance_node url="#part"/>'), "more": LIBRARY},
            (2, 3, 12),
            (3, 5, 15),
        ),
        "another scene": ({"scenes": OTHER_SCENE, "scene": "t"}, (51, 3, 7), (52, 5, 10)),
        "a scene not shown": ({"scenes": OTHER_SCENE}, LOW, HIGH),
        "strips": ({"shape": f'<tristrips count="1">{INPUT}<p>0 1 2 3 4 5 6 7</p></tristrips>'}, LOW, HIGH),
        "polygons": ({"shape": f'<polygons count="2">{INPUT}<p>0 1 3 2</p><p>4 6 7 5</p></polygons>'}, LOW, HIGH),
    }.values(),
)
def test_a_collada_file_is_where_it_says(tmp_path, file, low, high):
    mesh = Mesh(collada(tmp_path / "block.dae", **file), (1.0, 1.0, 2.0))
    expected = np.array([low, high]) * (1.0, 1.0, 2.0)
    danger = mesh.danger_points(0.05 * np.ptp(expected))
    for points in (mesh.surface[0], mesh.triangles(8)[0], danger, mesh.parts()[0].geometry.points()):
        np.testing.assert_allclose(box(np.array(points)), expected, atol=1e-5)


PLY = "ply\nformat {} 1.0\nelement vertex 8\nproperty double x\nproperty double y\nproperty double z\n"
PLY += "element face 12\nproperty list uchar int vertex_indices\nend_header\n"
ROWS = "".join("{:g} {:g} {:g}\n".format(*corner) for corner in CORNERS)
ROWS += "".join("3 {} {} {}\n".format(*face) for face in FACES)
BINARY_PLY = PLY.format("binary_little_endian").encode() + CORNERS.tobytes()
BINARY_PLY += b"".join(struct.pack("<Biii", 3, *face) for face in FACES)
QUADS = PLY.replace("double", "float").replace("12", "6").format("binary_big_endian").encode()
QUADS += CORNERS.astype(">f4").tobytes()
QUADS += np.array([(4, quad) for quad in CORNERS_OF_SIDES], [("", "u1"), ("", ">i4", 4)]).tobytes()
OBJ = "".join("v {:g} {:g} {:g}\n".format(*corner) for corner in CORNERS)
OBJ += "".join("f {} {} {}\n".format(*(k + 1 for k in face)) for face in FACES)
FACET = "facet normal 0 0 0\nouter loop\n" + 3 * "vertex {:g} {:g} {:g}\n" + "endloop\nendfacet\n"
STL = "solid a\n" + "".join(FACET.format(*CORNERS[list(face)].ravel()) for face in FACES) + "endsolid a\n"


READ = [
    ("a.ply", PLY.format("ascii") + ROWS),
    ("a.ply", BINARY_PLY),
    ("a.ply", QUADS),
    ("a.stl", STL),
    ("a.stl", STL.replace("\n", "\r\n")),
    ("a.stl", STL.replace("solid a", "solid solid") + STL),
    ("a.obj", OBJ),
    ("a.obj", f"o first\n{OBJ}o second\n" + OBJ.partition("f ")[0] + "f -8 -7 -6\n"),
]


@pytest.mark.parametrize(("name", "content"), READ)
def test_other_forms_are_read_as_they_stand(tmp_path, name, content):
    file = written(tmp_path, name, content)
    for convex in (True, False):
        vertices, triangles = Mesh(file, convex=convex).surface
        assert len(triangles) >= 12
        np.testing.assert_allclose(box(vertices), [LOW, HIGH], atol=1e-6)


UNREAD = {"convex_mesh": '<convex_mesh convex_hull_of="#block"/>', "skew": "<skew>45 1 0 0 0 1 0</skew>"}


NOT_READ = [
    *(
        ("a.dae", {"asset": HEAD + unit}, f"<unit> has meter={value}; it must be a positive number")
        for unit, value in [
            ('<unit meter="0,01"/>', "'0,01'"),
            ('<unit meter="-1"/>', "'-1'"),
            ('<unit meter="nan"/>', "'nan'"),
            ('<unit meter="inf"/>', "'inf'"),
        ]
    ),
    ("a.dae", {"asset": "<up_axis>UP</up_axis>"}, "<up_axis> is 'UP'; it must be one of X_UP, Y_UP, Z_UP"),
    (
        "a.dae",
        {"asset": HEAD + '<unit meter="1"/>', "nodes": node('<asset><unit meter="0.1"/></asset>')},
        r"parts of it have units or axes of their own \(1 and 0.1\)",
    ),
    ("a.dae", {"nodes": node(UNREAD["skew"])}, "<skew> cannot be read"),
    (
        "a.dae",
        {"more": f'<library_geometries><geometry id="c">{UNREAD["convex_mesh"]}</geometry></library_geometries>'},
        "<convex_mesh> cannot be read",
    ),
    ("a.dae", {"shape": f'{TRIANGLES}<trifans count="1">{INPUT}<p>0 1 2 3</p></trifans>'}, "<trifans> cannot"),
    ("a.dae", {"nodes": NODE + '<node><instance_controller url="#c"/></node>'}, "<instance_controller> cannot"),
    ("a.dae", {"nodes": NODE + '<node><instance_geometry url="#c"/></node>'}, "refers to '#c', which it does not"),
    ("a.dae", {"nodes": NODE + '<node><instance_node url="b.dae#n"/></node>'}, "refers to 'b.dae#n', which it"),
    ("a.dae", {"nodes": NODE + BLOCK}, "<instance_geometry> must be in a <node>"),
    ("a.dae", {"nodes": ""}, "has no triangles"),
    ("a.dae", "<COLLADA>", "not well-formed XML"),
    ("a.dae", "<!DOCTYPE c [<!ENTITY e 'x'>]><c>&e;</c>", "must not declare entities"),
    ("a.ply", BINARY_PLY[:-20], "cannot be read as PLY: .*early end-of-file"),
    ("a.ply", PLY.format("ascii") + ROWS[:-20], "cannot be read as PLY"),
    ("a.ply", PLY.format("ascii") + ROWS.replace("3 1 7 3\n", "3 1 9 3\n"), "a face has a vertex that there is not"),
    ("a.ply", PLY.format("ascii").replace("face", "tristrips") + ROWS, "tristrips.* cannot be read"),
    ("a.ply", PLY.format("ascii").replace("face 12", "face 0") + ROWS, "no triangles; points alone are a pointcloud"),
    ("a.stl", STL[: len(STL) // 2], "is cut off: 1 solids begin in it, and 0 end"),
    ("a.obj", OBJ + "surf 0 1 0 1 1 2 3 4\n", "the statement 'surf' cannot be read"),
    ("a.obj", OBJ + "  call other.obj\n", "the statement 'call' cannot be read"),
    ("a.obj", OBJ.partition("f ")[0], "no triangles; points alone are a pointcloud"),
    ("a.obj", re.sub(r"(v \S+ \S+) \S+", r"\1 1", OBJ), "is flat: a mesh obstacle needs a volume"),
    ("points.ply", "ply\nformat ascii 1.0\nelement vertex 0\nend_header\n", ""),
    ("missing.stl", None, "does not exist"),
    ("cube.step", "", r"must end in \.stl or \.obj or \.dae"),
    ("broken.stl", "this is no mesh", "cannot be read as a mesh"),
]


@pytest.mark.parametrize(("name", "content", "message"), NOT_READ)
def test_what_would_not_be_read_is_refused(tmp_path, name, content, message):
    """By Assimp these are read in part, in the wrong size or place, or end the process."""
    file = written(tmp_path, name, content)
    with pytest.raises(InputError, match=f"^file: .*{name}.*{message}") as found:
        Mesh(file)
    assert "\n" not in str(found.value)


@pytest.mark.parametrize("element", ["face", "tristrips"])
def test_a_surface_is_no_point_cloud(tmp_path, element):
    """A table of a metre would be the balls about its corners."""
    file = tmp_path / "table.ply"
    file.write_text(PLY.format("ascii").replace("face", element) + ROWS)
    with pytest.raises(InputError, match=rf"^file: .*holds a surface \({element}\).* give it as a mesh"):
        PointCloud(0.01, file)
    file.write_text(PLY.format("ascii").replace("face 12", "face 0") + ROWS)
    assert len(PointCloud(0.01, file).centres) == 8


# ------------------------------------------------------------------------------------------------ meshes of URDFs


def hand(model, name="left_hand_0"):
    """Return where a body of a robot is, in the frame of its link [m]."""
    body = next(body for body in model.geometryObjects if body.name == name)
    shape = body.geometry
    return box(np.array(shape.points() if hasattr(shape, "points") else shape.vertices()))


@pytest.mark.parametrize("up", ["X_UP", "Y_UP", "Z_UP"])
def test_units_of_a_robots_meshes_count_and_its_links_have_the_axes(edited, tmp_path, up, caplog):
    """In collision, in pictures and in files, as in RViz, MoveIt and Gazebo."""
    collada(tmp_path / "hand.dae", f'<unit meter="0.01"/><up_axis>{up}</up_axis>')
    mesh = '<geometry><mesh filename="hand.dae" scale="1 2 3"/></geometry>'
    tree = ElementTree.parse(edited("twin_arm.urdf", "wedge.obj", "hand.dae"))
    link = next(link for link in tree.iter("link") if link.get("name") == "left_hand")
    for tag in ("collision", "visual"):
        for element in link.findall(tag):
            link.remove(element)
        link.append(ElementTree.fromstring(f"<{tag}>{mesh}</{tag}>"))
    tree.write(tmp_path / "twin_arm.urdf")
    robot = Robot.from_urdf(tmp_path / "twin_arm.urdf")
    expected = np.array([LOW, HIGH]) * (0.01, 0.02, 0.03)
    np.testing.assert_allclose(hand(robot.collision_model), expected, atol=1e-7)
    np.testing.assert_allclose(hand(robot.visual_model), expected, atol=1e-7)
    assert robot_hash(built_robot(packed_robot(robot, meshes=True))) == robot_hash(robot)
    said = "twin_arm: 1 collision meshes are in the axes of their links"
    assert caplog.text.count(said) == (up != "Z_UP")


NOT_READ_OF_ROBOTS = [
    ("hand.dae", {"nodes": node(UNREAD["skew"])}, "hand.dae: <skew> cannot be read"),
    ("package://nowhere/a.obj", None, "'package://nowhere/a.obj' not"),
    ("broken.stl", "solid nothing", "broken.stl is cut off"),
    ("hand.ply", BINARY_PLY[:-20], "hand.ply cannot be read as PLY"),
    ("hand.glb", b"glTF", "hand.glb cannot be read as a mesh; convert it to one of .stl, .obj, .dae, .ply"),
]


@pytest.mark.parametrize(("name", "content", "message"), NOT_READ_OF_ROBOTS)
def test_a_robots_mesh_that_would_not_be_read_is_refused(edited, tmp_path, name, content, message):
    written(tmp_path, name, content)
    with pytest.raises(InputError, match=f"twin_arm.urdf: link 'left_hand': collision mesh .*{message}"):
        Robot.from_urdf(edited("twin_arm.urdf", "wedge.obj", name))
