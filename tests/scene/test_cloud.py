"""Point clouds: files, and collision that never misses a ball."""

from __future__ import annotations

import pickle
from pathlib import Path

import coal
import numpy as np
import pinocchio as pin
import pytest

from safe_ompl.errors import InputError
from safe_ompl.scene.obstacle import Obstacle
from safe_ompl.scene.shapes.cloud import PointCloud

POINTS = np.random.default_rng(3).uniform(-0.5, 0.5, (60, 3))
PROBES = [
    coal.Capsule(0.05, 0.2),
    coal.Box(0.1, 0.15, 0.2),
    coal.Cylinder(0.05, 0.2),
    coal.Sphere(0.1),
]


def hull() -> coal.Convex:
    corners = coal.StdVec_Vec3s()
    for corner in np.random.default_rng(4).normal(0, 0.06, (40, 3)):
        corners.append(corner)
    return coal.Convex.convexHull(corners, True, "Qt")


def write_ply(path: Path, points: np.ndarray, form: str) -> Path:
    header = (
        f"ply\nformat {form} 1.0\ncomment end of header follows\nelement vertex {len(points)}\n"
        "property float x\nproperty uchar red\nproperty double y\nproperty float z\n"
        "element face 0\nproperty list uchar int vertex_indices\nend_header\n"
    )
    if form == "ascii":
        body = "".join(f"{x} 255 {y} {z}\n" for x, y, z in points).encode()
    else:
        order = "<" if "little" in form else ">"
        record = np.dtype([("x", order + "f4"), ("red", "u1"), ("y", order + "f8"), ("z", order + "f4")])
        table = np.zeros(len(points), record)
        table["x"], table["y"], table["z"] = points.T
        body = table.tobytes()
    path.write_bytes(header.encode() + body)
    return path


@pytest.mark.parametrize("form", ["ascii", "binary_little_endian", "binary_big_endian"])
def test_reads_ply(tmp_path: Path, form: str) -> None:
    cloud = PointCloud(0.01, write_ply(tmp_path / "cloud.ply", POINTS, form))
    assert cloud.centres == pytest.approx(POINTS, abs=1e-6)


def test_reads_npy_and_needs_the_file_no_more(tmp_path: Path) -> None:
    file = tmp_path / "cloud.npy"
    np.save(file, POINTS.astype(np.float32))
    cloud = PointCloud(0.01, file)
    file.unlink()
    again = pickle.loads(pickle.dumps(cloud))
    assert again == cloud
    assert again.centres == pytest.approx(POINTS, abs=1e-6)


@pytest.mark.parametrize("content", [b"", b"no ply", b"ply\nelement vertex 2\nend_header\n"])
def test_unreadable_ply_is_refused(tmp_path: Path, content: bytes) -> None:
    file = tmp_path / "cloud.ply"
    file.write_bytes(content)
    with pytest.raises(InputError, match="PLY"):
        PointCloud(0.01, file)


def test_truncated_ply_is_refused(tmp_path: Path) -> None:
    file = write_ply(tmp_path / "cloud.ply", POINTS, "binary_little_endian")
    file.write_bytes(file.read_bytes()[:-5])
    with pytest.raises(InputError, match="cannot be read as PLY"):
        PointCloud(0.01, file)


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"points": []}, "points: the point cloud is empty"),
        ({"points": np.zeros((0, 3))}, "points: the point cloud is empty"),
        ({"points": [[0, 0, np.nan]]}, "points[0]: must be a finite number"),
        ({"points": [[0, 0]]}, "points[0]: must be 3 numbers"),
        ({}, "points: give either points or file"),
        ({"file": "missing.ply"}, "file: 'missing.ply' does not exist"),
        ({"file": "cloud.xyz"}, "file: 'cloud.xyz' must end in .ply or .npy"),
        ({"points": [[0, 0, 0]], "radius": 0}, "radius: must be a positive number, got 0"),
    ],
)
def test_unusable_clouds_are_refused(fields: dict, message: str) -> None:
    with pytest.raises(InputError) as caught:
        PointCloud(**{"radius": 0.01, **fields})
    assert message in str(caught.value)


def test_bad_arrays_are_refused(tmp_path: Path) -> None:
    for name, array, message in (
        ("nan", np.array([[0, 0, 0], [0, np.inf, 0]]), "point 1 is not finite"),
        ("flat", np.zeros(3), r"shape \(N, 3\), not \(3,\)"),
        ("empty", np.zeros((0, 3)), "empty"),
        ("text", np.array([["a", "b", "c"]]), "cannot be read as an array of numbers"),
    ):
        np.save(tmp_path / f"{name}.npy", array)
        with pytest.raises(InputError, match=message):
            PointCloud(0.01, tmp_path / f"{name}.npy")


def test_a_small_cloud_is_made_of_balls() -> None:
    names = [name for name, _, _ in Obstacle("rubble", PointCloud(0.01, points=POINTS[:3])).geometries()]
    assert names == ["rubble/0", "rubble/1", "rubble/2"]


@pytest.mark.parametrize("probe", [*PROBES, hull()], ids=lambda probe: type(probe).__name__)
def test_a_large_cloud_contains_its_balls_in_every_query(probe: coal.ShapeBase) -> None:
    """One tree for the cloud against one ball per point: never farther, never free where a ball is hit."""
    radius, margin = 0.02, 0.05
    ((name, tree, placement),) = Obstacle("rubble", PointCloud(radius, points=POINTS)).geometries()
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
            assert -1e-4 <= nearest - distances[0] <= 0.26 * radius + 1e-4
        pin.computeCollisions(model, data, geometry, plain, q, False)
        pin.computeCollisions(model, data, geometry, wide, q, False)
        tree_hit = plain.collisionResults[0].isCollision()
        ball_hit = any(result.isCollision() for result in list(plain.collisionResults)[1:])
        assert tree_hit or not ball_hit
        assert not tree_hit or nearest <= 0.27 * radius
        assert wide.collisionResults[0].isCollision() or nearest > margin - 1e-4
        hits += ball_hit
        assert pin.computeCollisions(model, data, manager, q, True) == tree_hit
    assert 10 < hits < 140


def test_danger_points_are_points_of_the_cloud() -> None:
    points = PointCloud(0.01, points=POINTS).danger_points(0.3)
    assert len(points) < len(POINTS)
    assert all((point == POINTS).all(axis=1).any() for point in points)
    gaps = np.linalg.norm(POINTS[:, None] - points, axis=2)
    assert gaps.min(axis=1).max() <= 0.3
