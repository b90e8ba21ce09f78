"""Hulls of meshes whose own hull coal cannot keep: never smaller than the mesh, and hardly larger."""

import coal
import numpy as np
import pytest
from oracles.coal_distances import coal_distance

from safe_ompl import InputError, Mesh, Robot
from safe_ompl.geometry import convex_hull, hull_planes
from safe_ompl.geometry.hulls import triangle_tree


def ring(sides, height=0.0):
    angles = np.linspace(0, 2 * np.pi, sides, endpoint=False)
    return np.column_stack([0.1 * np.cos(angles), 0.1 * np.sin(angles), np.full(sides, height)])


def cylinder(sides, height=0.3):
    return np.vstack([ring(sides), ring(sides, height)])


def cone(sides):
    return np.vstack([ring(sides), [[0.0, 0.0, 0.3]]])


def mesh(vertices):
    return triangle_tree(np.asarray(vertices), np.array([[0, 1, 2]]))


CASES = {
    "cylinder": (cylinder(260), 1e-5),
    "many sides": (cylinder(500), 1e-5),
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
    np.testing.assert_array_equal(corners, convex_hull(mesh(vertices), name).points(), "the same each time")
    normals, heights = hull_planes(hull)
    assert (vertices @ normals.T - heights).max() <= 1e-13 * max(1.0, np.abs(vertices).max())
    directions = np.random.default_rng(1).normal(size=(500, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    growth = (corners @ directions.T).max(axis=0) - (vertices @ directions.T).max(axis=0)
    assert growth.min() >= -1e-12
    assert growth.max() <= tolerance


def test_a_hull_that_coal_can_keep_is_left_alone():
    hull = convex_hull(mesh(cylinder(100)), "cylinder")
    assert {tuple(point) for point in np.array(hull.points())} == {tuple(point) for point in cylinder(100)}


@pytest.mark.parametrize(
    ("vertices", "message"),
    [(np.full((4, 3), np.nan), "'it' has vertices that are not finite"), (np.zeros((0, 3)), "'it' has no vertices")],
)
def test_meshes_without_a_hull_are_refused(vertices, message):
    tree = coal.BVHModelOBBRSS()
    tree.beginModel(0, len(vertices))
    if len(vertices):
        tree.addVertices(vertices)
    with pytest.raises(InputError, match=message):
        convex_hull(tree, "it", thickness=1e-4)


def test_robots_and_obstacles_with_a_round_mesh(tmp_path, edited):
    lines = [f"v {x} {y} {z}" for x, y, z in cylinder(300)]
    lines += [f"f {k + 1} {(k + 1) % 300 + 1} {301 + (k + 1) % 300} {301 + k}" for k in range(300)]
    (tmp_path / "round.obj").write_text("\n".join(lines))
    urdf = edited("twin_arm.urdf", "wedge.obj", "round.obj")
    assert "left_hand_0" in [body.name for body in Robot.from_urdf(urdf).collision_model.geometryObjects]
    (part,) = Mesh(tmp_path / "round.obj").parts()
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
    for point in (*vertices, vertices.mean(axis=0)):
        depth = coal_distance(coal.Sphere(1e-5), point, hull)
        assert depth < -0.999e-5, "the middle of the ball is not outside"
    assert np.ptp(corners, axis=0).max() < np.ptp(vertices, axis=0).max() + 3e-4
