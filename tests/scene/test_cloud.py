"""Point clouds: files, and collision that never misses a ball."""

import pickle
import re
from array import array as number_array
from io import BytesIO
from itertools import product
from types import SimpleNamespace

import coal
import numpy as np
import pinocchio as pin
import plyfile
import pytest

from safe_ompl import Box, CollisionChecker, InputError, Obstacle, PointCloud, Scene
from safe_ompl.common import warn_once
from safe_ompl.geometry.cloud import cell_tree, touched_cells
from safe_ompl.geometry.hulls import triangle_tree

POINTS = np.random.default_rng(3).uniform(-0.5, 0.5, (60, 3))
PROBES = [coal.Capsule(0.05, 0.2), coal.Box(0.1, 0.15, 0.2), coal.Cylinder(0.05, 0.2), coal.Sphere(0.1)]


def hull():
    corners = coal.StdVec_Vec3s()
    for corner in np.random.default_rng(4).normal(0, 0.06, (40, 3)):
        corners.append(corner)
    return coal.Convex.convexHull(corners, True, "Qt")


FIELDS = [("intensity", 0, 7), ("x", 4, 7), ("y", 8, 8), ("z", 20, 7)]  # name, offset, datatype of a PointCloud2


def message(points, order="<", padding=8):
    """Return an organised cloud (2, N/2) as a PointCloud2 message has it, with gaps in points and rows."""
    table = np.zeros((2, len(points) // 2, 32), np.uint8)
    for axis, (at, kind) in enumerate([(4, "f4"), (8, "f8"), (20, "f4")]):
        column = points[:, axis].reshape(2, -1, 1).astype(order + kind)
        table[..., at : at + column.itemsize] = column.view(np.uint8)
    data = b"".join(row.tobytes() + b"\xff" * padding for row in table)
    fields = [{"name": name, "offset": at, "datatype": kind, "count": 1} for name, at, kind in FIELDS]
    sizes = {"height": 2, "width": len(points) // 2, "point_step": 32, "row_step": 16 * len(points) + padding}
    return {**sizes, "fields": fields, "is_bigendian": order == ">", "data": data}


@pytest.mark.parametrize("order", ["<", ">"])
def test_reads_the_data_of_a_ros_message(order):
    points = POINTS.copy()
    points[7] = np.nan
    given = message(points, order)
    as_object = SimpleNamespace(**{**given, "fields": [SimpleNamespace(**field) for field in given["fields"]]})
    as_object.data = number_array("B", given["data"])  # as rclpy has it
    for form in (given, as_object):
        cloud = PointCloud.from_message(form, 0.01, resolution=0.02)
        np.testing.assert_allclose(cloud.centres, np.delete(points, 7, axis=0), atol=1e-7)
        assert (cloud.radius, cloud.resolution) == (0.01, 0.02)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"fields": []}, "no field x and y and z"),
        ({"data": b"123"}, "3 bytes"),
        ({"point_step": 16}, "do not fit"),
        ({"row_step": 40}, "do not fit"),
        (None, "data: the PointCloud2 message lacks it"),
    ],
)
def test_a_message_that_contradicts_itself_is_refused(change, words):
    given = message(POINTS)
    given = {**given, **change} if change else {key: value for key, value in given.items() if key != "data"}
    with pytest.raises(InputError, match=words):
        PointCloud.from_message(given, 0.01)


@pytest.mark.parametrize(("factor", "warns"), [(1000.0, True), (1.0, False)])
def test_a_cloud_in_millimetres_is_told(caplog, factor, warns):
    warn_once.cache_clear()
    PointCloud(0.01, points=factor * POINTS)
    said = [record.message for record in caplog.records if record.levelname == "WARNING"]
    assert len(said) == warns
    assert all("points: half of 60 points" in text and "millimetres" in text for text in said)


def ply(order):
    """Return a file of the points with a colour, of other types than each other; as text where bytes have no order."""
    table = np.zeros(len(POINTS), [("x", "f4"), ("red", "u1"), ("y", "f8"), ("z", "f4")])
    table["x"], table["y"], table["z"] = POINTS.T
    element = plyfile.PlyElement.describe(table, "vertex")
    file = BytesIO()
    plyfile.PlyData([element], text=not order, byte_order=order or "=").write(file)
    return file.getvalue()


@pytest.mark.parametrize("form", ["", "<", ">"])
def test_reads_ply(tmp_path, form):
    (tmp_path / "cloud.ply").write_bytes(ply(form))
    cloud = PointCloud(0.01, tmp_path / "cloud.ply")
    assert cloud.centres == pytest.approx(POINTS, abs=1e-6)


def test_reads_npy_and_needs_the_file_no_more(tmp_path):
    file = tmp_path / "cloud.npy"
    np.save(file, POINTS.astype(np.float32))
    cloud = PointCloud(0.01, file)
    file.unlink()
    cloud.parts()  # coal's trees do not pickle
    again = pickle.loads(pickle.dumps(cloud))
    assert again == cloud
    assert again.parts()[0].geometry.computeVolume() is not None
    assert again.centres == pytest.approx(POINTS, abs=1e-6)


def test_reads_every_legal_ply(tmp_path):
    """Comments with "end_header", properties that are lists, vertices that are not the first element."""
    file = tmp_path / "odd.ply"
    file.write_text(
        "ply\nformat ascii 1.0\ncomment end_header comes later\nobj_info end_header\n"
        "element camera 1\nproperty float fov\n"
        "element vertex 2\nproperty list uchar int near\nproperty float x\nproperty float y\n"
        "property float z\nelement range_grid 1\nproperty list uchar int vertex_indices\nend_header\n"
        "0.5\n2 7 8 1 2 3\n0 nan 5 6\n3 0 1 1\n"
    )
    assert PointCloud(0.01, file).centres.tolist() == [[1, 2, 3]]


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"points": []}, "points: the point cloud is empty"),
        ({"points": [[0, 0, np.nan]]}, "points: the point cloud is empty: none of 1 points is finite"),
        ({"points": [[0, 0]]}, "points: must have shape (any, 3), got (1, 2)"),
        ({}, "points: give either points or file"),
        ({"file": "missing.ply"}, "file: 'missing.ply' does not exist"),
        ({"file": "cloud.xyz"}, "file: 'cloud.xyz' must end in .ply or .npy"),
        ({"points": [[0, 0, 0]], "radius": 1e-9}, "radius: must be a finite number in [0.0001, 10000], got 1e-09"),
        ({"points": [[0, 0, 0]], "resolution": 1e-9}, "resolution: must be a finite number in [0.00125, 10000]"),
        ({"points": [[0, 0, 0]], "resolution": "off"}, "resolution: must be a finite number <= 10000, got 'off'"),
        ({"points": [["0", 0, 0]]}, "points: must be numbers, got [['0', 0, 0]]"),
        ({"file": np.full((2, 3), np.nan)}, "none of 2 points is finite"),
        ({"file": np.array([[0, 0, 0], [0, 2e4, 0]])}, "farther than 10000 m away; are they in metres?"),
        ({"file": np.zeros(3)}, "shape (N, 3), got (3,)"),
        ({"file": np.zeros((0, 3))}, "empty"),
        ({"file": np.array([["a", "b", "c"]])}, "cannot be read as an array of numbers"),
        *(
            ({"file": content}, "cannot be read as PLY")
            for content in (b"", b"no ply", b"ply\nelement vertex 2\nend_header\n", ply("<")[:-5])
        ),
    ],
)
def test_unusable_clouds_are_refused(tmp_path, fields, message):
    """An array, or bytes, is what a file holds."""
    if isinstance(fields.get("file"), np.ndarray):
        np.save(tmp_path / "bad.npy", fields["file"])
        fields = {"file": tmp_path / "bad.npy"}
    elif isinstance(fields.get("file"), bytes):
        (tmp_path / "bad.ply").write_bytes(fields["file"])
        fields = {"file": tmp_path / "bad.ply"}
    with pytest.raises(InputError) as caught:
        PointCloud(**{"radius": 0.01, **fields})
    assert message in str(caught.value)


def test_a_small_cloud_is_made_of_balls():
    names = [name for name, _, _ in Obstacle("rubble", PointCloud(0.01, points=POINTS[:3])).geometries()]
    assert names == ["rubble/0", "rubble/1", "rubble/2"]


@pytest.mark.parametrize("resolution", [None, 0.5, 0.125])
def test_a_robot_wholly_inside_a_ball_of_a_large_cloud_collides(panda, resolution):
    places = np.array([0.0, 0.0, 0.5]) + 1e-3 * np.random.default_rng(0).normal(size=(40, 3))
    cloud = PointCloud(1.0, points=places, resolution=resolution)
    checker = CollisionChecker(panda, Scene((Obstacle("cloud", cloud),)))
    q = np.array([0.0, -0.4, 0.0, -2.0, 0.0, 2.0, 0.785])
    assert checker.in_collision(q)
    assert checker.clearance(q).distance <= 0


def raw_mesh():
    return triangle_tree(*Box((0.1, 0.15, 0.2)).triangles(8))


LARGE = [*product([*PROBES, hull(), raw_mesh()], [None, 0.05]), *((probe, 0.0025) for probe in PROBES[2:])]


@pytest.mark.parametrize(("probe", "resolution"), LARGE, ids=lambda x: x if isinstance(x, float) else type(x).__name__)
def test_a_large_cloud_contains_its_balls_in_every_query(probe, resolution):
    """One geometry for the cloud against one ball per point: never farther, never free where a ball is hit."""
    radius, margin = 0.02, 0.05
    cloud = PointCloud(radius, points=POINTS, resolution=resolution)
    slack = 3**0.5 * cloud.cell_edge
    ((name, tree, placement),) = Obstacle("rubble", cloud).geometries()
    model = pin.Model()
    joint = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "probe")
    geometry = pin.GeometryModel()
    geometry.addGeometryObject(pin.GeometryObject("probe", joint, pin.SE3.Identity(), probe))
    geometry.addGeometryObject(pin.GeometryObject(name, 0, placement, tree))
    for k, point in enumerate(POINTS):
        ball = pin.SE3(np.eye(3), point)
        geometry.addGeometryObject(pin.GeometryObject(f"ball{k}", 0, ball, coal.Sphere(radius)))
    for other in range(1, len(geometry.geometryObjects)):
        geometry.addCollisionPair(pin.CollisionPair(0, other))

    data, plain, wide = model.createData(), pin.GeometryData(geometry), pin.GeometryData(geometry)
    for request in wide.collisionRequests:
        request.security_margin = margin
    manager = pin.BroadPhaseManager_NaiveCollisionManager(model, geometry, plain)
    rng, hits = np.random.default_rng(5), 0
    for _ in range(150):
        q = np.concatenate([rng.uniform(-0.5, 0.5, 3), rng.normal(size=4)])
        q[3:] /= np.linalg.norm(q[3:])
        pin.computeDistances(model, data, geometry, plain, q)
        distances = [result.min_distance for result in plain.distanceResults]
        nearest = min(distances[1:])
        if nearest > 0:
            assert -1e-4 <= nearest - distances[0] <= slack + 1e-4
        pin.computeCollisions(model, data, geometry, plain, q, False)
        pin.computeCollisions(model, data, geometry, wide, q, False)
        tree_hit = plain.collisionResults[0].isCollision()
        ball_hit = any(result.isCollision() for result in list(plain.collisionResults)[1:])
        assert tree_hit or not ball_hit
        assert not tree_hit or nearest <= slack + 1e-4
        assert wide.collisionResults[0].isCollision() or nearest > margin - 1e-4
        hits += ball_hit
        assert pin.computeCollisions(model, data, manager, q, True) == tree_hit
    assert 10 < hits < 140


@pytest.mark.parametrize("resolution", [None, 0.013, 0.1])
def test_the_cells_contain_every_ball_and_no_more_than_is_promised(resolution):
    radius = 0.02
    cloud = PointCloud(radius, points=POINTS + np.array([12.0, -7.0, 3.0]), resolution=resolution)
    edge = cloud.cell_edge
    cells = touched_cells(cloud.centres, radius, edge)
    held = {tuple(cell) for cell in cells}
    directions = np.random.default_rng(1).normal(size=(300, 3))
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    for reach in (radius, 0.7 * radius):
        skin = (cloud.centres[:, None] + reach * directions).reshape(-1, 3)
        assert {tuple(cell) for cell in np.floor(skin / edge).astype(int)} <= held
    corners = (cells[:, None] + np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)])) * edge
    gaps = np.linalg.norm(corners.reshape(-1, 1, 3) - cloud.centres, axis=2).min(axis=1) - radius
    assert gaps.max() <= 3**0.5 * edge + 1e-9


def test_the_tree_holds_every_cell_far_from_the_origin():
    cells = touched_cells(POINTS + np.array([900.0, -900.0, 2.0]), 0.02, 0.01)
    _, tree, placement, _ = cell_tree(cells, 0.01)
    probe, request = coal.Sphere(0.001), coal.CollisionRequest()
    for cell in cells[::37]:
        centre = coal.Transform3s(np.eye(3), (cell + 0.5) * 0.01)
        where = coal.Transform3s(placement.rotation, placement.translation)
        assert coal.collide(tree, where, probe, centre, request, coal.CollisionResult())
    low, high = (np.ravel(side) + placement.translation for side in (tree.aabb_local.min_, tree.aabb_local.max_))
    assert low == pytest.approx(cells.min(axis=0) * 0.01, abs=1e-5)
    assert high == pytest.approx((cells.max(axis=0) + 1) * 0.01, abs=1e-5)


def test_many_points_keep_few_cells(caplog):
    points = np.random.default_rng(0).uniform(0, 1, (100_000, 3)) * np.array([2, 2, 0.001])
    cloud = PointCloud(0.002, points=points)
    with caplog.at_level("INFO"):
        assert cloud.cell_edge == pytest.approx(0.008)
    assert "cloud of 100000 points, radius 0.002 m: collides as cells of 0.008 m" in caplog.text
    assert len(touched_cells(points, 0.002, 0.008)) < 500_000
    assert PointCloud(0.02, points=POINTS).cell_edge == pytest.approx(0.01)


def test_points_that_a_camera_did_not_see_are_left_out(caplog):
    points = POINTS.astype(np.float32)
    points[[3, 7]] = np.nan
    points[9, 1] = np.inf
    with caplog.at_level("INFO"):
        cloud = PointCloud(0.01, points=points)
    assert "points: 3 of 60 points are NaN or infinite and are left out" in caplog.text
    assert len(cloud.centres) == 57
    assert cloud == PointCloud(0.01, points=np.delete(points, [3, 7, 9], axis=0).tolist())


def test_clouds_of_arrays_compare_hash_and_read_back():
    cloud = PointCloud(np.float32(0.01), points=POINTS)
    same, moved = PointCloud(np.float32(0.01), points=POINTS.tolist()), PointCloud(0.01, points=POINTS + 0.1)
    assert cloud == same
    assert hash(cloud) == hash(same)
    assert cloud not in {moved, PointCloud(np.float32(0.01), points=POINTS, resolution=0.002)}
    assert cloud != "cloud"
    scene = Scene((Obstacle("a", PointCloud(0.01, points=POINTS, resolution=0.02)),))
    again = Scene.from_yaml(scene.to_yaml())
    assert again == scene
    assert again.content_hash() == scene.content_hash() != Scene((Obstacle("a", cloud),)).content_hash()
    assert repr(cloud) == "PointCloud(radius=0.01, points=<60 points>)"
    with pytest.raises(ValueError, match="read-only"):
        cloud.centres[0] = 0


def test_danger_points_are_points_of_the_cloud():
    points = PointCloud(0.01, points=POINTS).danger_points(0.3)
    assert len(points) < len(POINTS)
    assert all((point == POINTS).all(axis=1).any() for point in points)
    gaps = np.linalg.norm(POINTS[:, None] - points, axis=2)
    assert gaps.min(axis=1).max() <= 0.3


def test_cells_too_small_for_a_cloud_are_refused_before_they_are_counted():
    corner = np.full((1, 3), 9000.0)
    cloud = PointCloud(1e-4, points=np.concatenate([POINTS, corner, -corner]), resolution=1e-4)
    with pytest.raises(InputError, match=r"resolution: 0.0001 m is too fine for") as refused:
        cloud.parts()
    least = float(re.search("at least ([0-9.]+)", str(refused.value))[1])
    assert PointCloud(1e-4, points=cloud.points, resolution=least).parts()
