"""Distances from point clouds, against coal's own."""

import numpy as np
import pytest
from oracles.pinocchio_points import body_points

from safe_ompl import Box, CollisionChecker, Obstacle, PointCloud, Pose, Scene
from safe_ompl.collision import PairDistances
from safe_ompl.geometry import Voxels

TURNED = Pose((0.1, -0.05, 0.02), (0.0, 0.0, np.sin(0.2), np.cos(0.2)))


def column(count, x=0.5):
    rng = np.random.default_rng(0)
    angles, heights = rng.uniform(0, 2 * np.pi, count), rng.uniform(0, 0.9, count)
    return np.column_stack([x + 0.08 * np.cos(angles), 0.08 * np.sin(angles), heights])


def scene_of(points, pose=TURNED):
    wall = Obstacle("wall", Box((0.1, 2.0, 1.0)), Pose((-0.7, 0.0, 0.5)))
    return Scene((Obstacle("scan", PointCloud(0.01, points=points), pose, weight=1.0), wall))


@pytest.fixture(scope="module")
def checker(ur5):
    return CollisionChecker(ur5, scene_of(column(300)), movable=("scan",))


@pytest.fixture
def path(ur5):
    """Return a motion past the cloud, at a distance, and into it."""
    base = [[0.9, -1.2, 1.4, -1.8, -1.57, 0.0], [0.5, -0.9, 1.2, -1.8, -1.57, 0.0], [0.0, -0.6, 0.9, -1, -1, 0]]
    return np.concatenate([np.linspace(base[k], base[k + 1], 8) for k in range(2)])


@pytest.fixture(scope="module")
def plain_distances(plain_check):
    """Return a function to what coal says of every pair in the world frame, with nothing known before."""

    def distances(checker, q):
        plain = plain_check(checker.robot, checker.scene)
        found = dict(zip(plain.pairs, plain.distances(q), strict=True))
        return np.array([found[pair] for pair in checker.distance_names])

    return distances


def test_distances_are_those_of_coal(checker, path, plain_distances):
    expected = np.array([plain_distances(checker, q) for q in path])
    found = np.array([checker.distances(q) for q in path])
    apart = expected > 0
    assert (~apart).any(), "the path leads into the cloud"
    np.testing.assert_allclose(found[apart], expected[apart], rtol=0, atol=2e-6)
    assert (found[~apart] <= 0).all()


def test_clouds_all_around_are_decided_without_coal(ur5, path, plain_distances, rng):
    points = rng.uniform(-1.0, 1.0, (400, 3))
    points = points[np.linalg.norm(points, axis=1) > 0.75]
    scene = scene_of(points, Pose()).with_obstacles(Obstacle("column", PointCloud(0.01, points=column(200, 0.7))))
    checker, Q = CollisionChecker(ur5, scene), np.concatenate([path, rng.uniform(-1.5, 1.5, (60, 6))])
    expected = np.array([plain_distances(checker, q) for q in Q])
    apart, found = expected > 0, checker.all_distances(Q)
    np.testing.assert_allclose(found[apart], expected[apart], rtol=0, atol=2e-6)
    assert (found[~apart] <= 0).all()
    bounds, margins = checker.pairs.bounds, np.zeros(len(checker.pairs.bodies))
    decided = [bounds.nearer(q, margins, 0.0) for q in Q]
    assert sum(len(pairs) > surely for pairs, surely in decided) == 0
    assert [surely for _, surely in decided] == [checker.in_collision(q) for q in Q]


def test_cells_of_a_tree_hold_those_that_follow(rng):
    cells = Voxels(np.unique(rng.integers(-9, 14, (300, 3)), axis=0), 0.02)
    nodes, sides = cells.tree, cells.half_sides
    leaves = nodes[nodes["level"] == 0]
    np.testing.assert_allclose(np.unique(leaves["centre"], axis=0), np.unique((cells.numbers + 0.5) * 0.02, axis=0))
    assert len(leaves) == len(cells.numbers)
    assert nodes[0]["size"] == len(nodes)
    after = np.arange(len(nodes)) + nodes["size"].astype(int)
    for k, node in enumerate(nodes):
        inner = nodes[k + 1 : after[k]]
        assert (inner["level"] < node["level"]).all()
        off = np.abs(inner["centre"] - node["centre"]) + sides[inner["level"], None]
        assert (off <= sides[node["level"]] + 1e-5).all()
        outer = nodes[:k][after[:k] > k]
        assert [other["level"] for other in outer] == list(range(nodes[0]["level"], node["level"], -1))


def test_a_cloud_that_is_measured_anew_is_another_one(checker, path, plain_distances):
    for points in (column(300), column(310, 0.9), column(300, 1.4)):
        checker.move(scene_of(points))
        for q in path[:3]:
            np.testing.assert_allclose(checker.distances(q), plain_distances(checker, q), rtol=0, atol=2e-6)


@pytest.mark.parametrize("side", [1, -1])
def test_nearest_points_are_given_of_the_link_first(checker, path, side):
    checker.move(scene_of(column(300)))
    distances, pairs = PairDistances(checker, 0.5), checker.pairs_within(0.5)
    names = [pairs.names[k][1] for k in np.flatnonzero(pairs.meets_obstacle)]
    seen, Q = 0, path[::side]
    found = distances.near(Q, 0.5)
    distance_of, points, normals, offsets = (
        found.table[:, 2],
        *np.split(found.table[:, 3:9], 2, axis=1),
        found.table[:, 9],
    )
    places, _ = body_points(checker.robot, Q, found.rows, distances.joints[found.pairs], points)
    for pair, distance, on_link, normal, offset in zip(found.pairs, distance_of, places, normals, offsets, strict=True):
        if distance > 0:
            assert on_link @ normal - offset == pytest.approx(distance, abs=1e-6)
        if names[pair] == "scan" and distance > 0.05:
            local = TURNED.se3.actInv(on_link - distance * normal)
            assert np.hypot(local[0] - 0.5, local[1]) < 0.08 + 0.01 + 0.01, "on the column, not on the link"
            seen += 1
    assert seen > 5


def test_what_was_asked_before_does_not_change_an_answer(checker, path):
    checker.move(scene_of(column(300)))
    fresh, used = PairDistances(checker, 0.5), PairDistances(checker, 0.5)
    used.near(path[::-1] + 0.05, 0.5)
    found, expected = used.near(path, 0.5).table, fresh.near(path, 0.5).table
    np.testing.assert_array_equal(found[:, :3], expected[:, :3])
    np.testing.assert_array_equal(found[found[:, 2] > 0], expected[found[:, 2] > 0])
