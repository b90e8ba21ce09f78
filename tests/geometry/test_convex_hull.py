"""Hulls of meshes whose own hull coal cannot keep: never smaller than the mesh, and hardly larger."""

import coal
import numpy as np
import pytest

from safe_ompl import InputError, Mesh, Robot
from safe_ompl.geometry import convex_hull


def ring(sides, height=0.0):
    angles = np.linspace(0, 2 * np.pi, sides, endpoint=False)
    return np.column_stack([0.1 * np.cos(angles), 0.1 * np.sin(angles), np.full(sides, height)])


def cylinder(sides, height=0.3):
    return np.vstack([ring(sides), ring(sides, height)])


def cone(sides):
    return np.vstack([ring(sides), [[0.0, 0.0, 0.3]]])


def mesh(vertices):
    tree = coal.BVHModelOBBRSS()
    tree.beginModel(1, len(vertices))
    tree.addVertices(np.ascontiguousarray(vertices))
    tree.addTriangles(np.array([[0, 1, 2]]))
    tree.endModel()
    return tree


CASES = {
    "cylinder": (cylinder(260), 1e-5),
    "many sides": (cylinder(1000), 1e-5),
    "disc": (cylinder(600, 0.002), 1e-4),
    "cone": (cone(300), 5e-4),
    "steep cone": (cone(300) * [1, 1, 30], 5e-3),
    "two tips": (np.vstack([cone(400), [[0.0, 0.0, -0.1]]]), 5e-4),
    "long and thin": (cylinder(300) * [1, 20, 0.05], 2e-3),
    "far away": (np.add(cone(300), [100.0, 3.0, -7.0]), 5e-4),
    "crowded in a corner": (np.vstack([cone(300), 1e-3 * np.eye(3)[np.arange(2000) % 3]]), 5e-4),
}


@pytest.mark.parametrize("name", CASES)
def test_every_vertex_is_inside_and_little_is_added(name):
    vertices, tolerance = CASES[name]
    with pytest.raises(RuntimeError, match="Too many neighbors"):
        mesh(vertices).buildConvexHull(True, "Qt")
    hull = convex_hull(mesh(vertices), name)
    corners = np.array(hull.points())
    triangles = np.array([[hull.polygons(k)[i] for i in range(3)] for k in range(hull.num_polygons)])
    a, b, c = (corners[triangles[:, i]] for i in range(3))
    normals = np.cross(b - a, c - a)
    normals *= np.sign(np.einsum("fc,fc->f", normals, a - corners.mean(axis=0)))[:, None]
    lengths = np.linalg.norm(normals, axis=1)
    heights = (vertices[None] - a[:, None]) @ normals[:, :, None]
    assert (heights[..., 0] <= 1e-15 * max(1.0, np.abs(vertices).max()) + 1e-13 * lengths[:, None]).all()
    directions = np.random.default_rng(1).normal(size=(500, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    growth = (corners @ directions.T).max(axis=0) - (vertices @ directions.T).max(axis=0)
    assert growth.min() >= -1e-12
    assert growth.max() <= tolerance
    assert all(len(set(triangles[(triangles == k).any(axis=1)].ravel())) <= 255 for k in range(len(corners)))


def test_it_is_the_same_each_time():
    first, second = (np.array(convex_hull(mesh(cone(300)), "cone").points()) for _ in range(2))
    np.testing.assert_array_equal(first, second)


def test_a_hull_that_coal_can_keep_is_left_alone():
    hull = convex_hull(mesh(cylinder(100)), "cylinder")
    assert {tuple(point) for point in np.array(hull.points())} == {tuple(point) for point in cylinder(100)}


def test_vertices_must_be_finite():
    vertices = cylinder(20)
    vertices[3, 1] = np.nan
    with pytest.raises(InputError, match="mesh of 'cylinder' has vertices that are not finite"):
        convex_hull(mesh(vertices), "cylinder")


def write_obj(path, sides):
    points = cylinder(sides)
    lines = [f"v {x} {y} {z}" for x, y, z in points]
    for k in range(sides):
        after = (k + 1) % sides
        lines.append(f"f {k + 1} {after + 1} {sides + after + 1} {sides + k + 1}")
    path.write_text("\n".join(lines) + "\n")
    return path


def test_robots_and_obstacles_with_a_round_mesh(tmp_path, edited):
    urdf = edited("twin_arm.urdf", "wedge.obj", "round.obj")
    file = write_obj(tmp_path / "round.obj", 300)
    names = [body.name for body in Robot.from_urdf(urdf).collision_model.geometryObjects]
    assert "left_hand_0" in names
    (part,) = Mesh(file).parts()
    part.geometry.computeLocalAABB()
    assert (np.asarray(part.geometry.aabb_local.max_).ravel() >= [0.1, 0.1 * (1 - 1e-4), 0.3]).all()


FLAT = {
    "square": [[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]],
    "triangle": [[0, 0, 0.3], [1, 0, 0.3], [0, 1, 0.5]],
    "line": [[0, 0, 0], [1, 2, 3], [2, 4, 6]],
    "point": [[0.1, 0.2, 0.3]] * 3,
}


@pytest.mark.parametrize("name", FLAT)
def test_flat_meshes_are_thickened_if_asked_for(name, caplog):
    vertices = np.array(FLAT[name], dtype=np.float64)
    with pytest.raises(InputError, match="is flat"):
        convex_hull(mesh(vertices), name)
    with caplog.at_level("INFO"):
        hull = convex_hull(mesh(vertices), name, thickness=2e-4)
    assert f"mesh of {name} is flat: its hull is 0.2 mm thick" in caplog.text
    corners = np.array(hull.points())
    ball, data = coal.Sphere(1e-5), coal.DistanceResult()
    for point in (*vertices, vertices.mean(axis=0)):
        data.clear()
        place = coal.Transform3s(np.eye(3), point)
        depth = coal.distance(hull, coal.Transform3s(), ball, place, coal.DistanceRequest(), data)
        assert depth < -0.999e-5, "the middle of the ball is not outside"
    assert np.ptp(corners, axis=0).max() < np.ptp(vertices, axis=0).max() + 3e-4


def test_a_mesh_without_vertices_is_refused():
    with pytest.raises(InputError, match="'nothing' has no vertices"):
        convex_hull(coal.BVHModelOBBRSS(), "nothing", thickness=1e-4)
