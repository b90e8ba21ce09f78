"""Distances of pairs, their nearest points and gradients: against coal's own, against finite differences."""

from collections import defaultdict
from itertools import pairwise

import coal
import numpy as np
import pinocchio as pin
import pytest
from oracles.pinocchio_points import body_points

from safe_ompl import Box, CollisionChecker, Obstacle, PointCloud, Pose, Scene, Sphere
from safe_ompl.collision import PairDistances
from safe_ompl.geometry import ConvexBodies, Voxels

WITHIN = 0.15  # [m]
TURNED = Pose((0.1, -0.05, 0.02), (0.0, 0.0, np.sin(0.2), np.cos(0.2)))


def column(count, x=0.5):
    rng = np.random.default_rng(0)
    angles, heights = rng.uniform(0, 2 * np.pi, count), rng.uniform(0, 0.9, count)
    return np.column_stack([x + 0.08 * np.cos(angles), 0.08 * np.sin(angles), heights])


def scene_of(points, pose=TURNED):
    wall = Obstacle("wall", Box((0.1, 2.0, 1.0)), Pose((-0.7, 0.0, 0.5)))
    return Scene((Obstacle("scan", PointCloud(0.01, points=points), pose, weight=1.0), wall))


def along(*corners):
    """Return configurations that follow each other by small steps."""
    return np.concatenate([np.linspace(a, b, 10) for a, b in pairwise(corners)])


@pytest.fixture(scope="module")
def past_a_column(ur5):
    """Return a UR5 beside a column of points, and a motion past the column, at a distance, and into it."""
    ends = [[0.9, -1.2, 1.4, -1.8, -1.57, 0.0], [0.5, -0.9, 1.2, -1.8, -1.57, 0.0], [0.0, -0.6, 0.9, -1, -1, 0]]
    return CollisionChecker(ur5, scene_of(column(300)), movable=("scan",)), along(*ends)


@pytest.fixture(scope="module", params=["shapes", "points in rows", "a column of points"])
def case(request, panda, past_a_column):
    """Return a checker and a motion: past a shelf and a ball, past rows of points, or into a column."""
    if request.param == "a column of points":
        return past_a_column
    shelf = Obstacle("shelf", Box((0.5, 0.8, 0.02)), Pose((0.55, 0.0, 0.45)))
    steps = np.array([[0.0, 0.0], [0.1, 0.3], [0.3, 0.3], [0.3, 0.0]])
    rows = PointCloud(0.01, points=np.c_[np.repeat(steps, 40, axis=0), np.tile(np.linspace(0, 0.4, 40), 4)])
    obstacles = {
        "shapes": (shelf, Obstacle("ball", Sphere(0.1), Pose((0.3, 0.4, 0.7)))),
        "points in rows": (Obstacle("scan", rows, Pose((0.4, -0.2, 0.3))),),
    }[request.param]
    middle = np.array([0.0, 0.5, 0.0, -1.9, 0.0, 2.4, 0.8])
    ends = middle + np.random.default_rng(0).uniform(-0.4, 0.4, (4, 7))
    return CollisionChecker(panda, Scene(obstacles)), along(*ends)


@pytest.fixture(scope="module")
def by_coal(plain_check):
    """Return a function to what coal says of named pairs in the world frame, with nothing known before."""

    def distances(checker, names, q):
        plain, found = plain_check(checker.robot, checker.scene), defaultdict(list)  # a link has several bodies
        for name, distance in zip(plain.pairs, plain.distances(q), strict=True):
            found[name].append(distance)
        return np.array([found[name].pop(0) for name in names])

    return distances


def names_of(checker, reach):
    """Return the pairs of links and obstacles that come within a reach."""
    pairs = checker.pairs_within(reach)
    return [pairs.names[k] for k in np.flatnonzero(pairs.meets_obstacle)]


def test_what_is_near_is_what_coal_calls_near(case, by_coal):
    checker, path = case
    distances = PairDistances(checker, WITHIN)
    found, everything = distances.near(path, WITHIN), distances.near(path, np.inf)
    assert len(everything.rows) == len(path) * len(distances)
    expected = np.array([by_coal(checker, names_of(checker, WITHIN), q) for q in path]).ravel()
    apart = expected > 1e-3
    np.testing.assert_allclose(everything.table[:, 2][apart], expected[apart], rtol=0, atol=2e-5)
    assert (everything.table[:, 2][~apart] < 1.1e-3).all()
    near = everything.table[:, 2] < WITHIN
    assert 0 < near.sum() < len(near)
    np.testing.assert_array_equal(found.rows, everything.rows[near])
    np.testing.assert_array_equal(found.pairs, everything.pairs[near])
    np.testing.assert_allclose(found.table[:, 2], everything.table[:, 2][near], rtol=1e-5)


def test_answers_do_not_depend_on_what_was_asked_before(case, rng):
    checker, path = case
    before, fresh = PairDistances(checker, WITHIN), PairDistances(checker, WITHIN)
    for shift in (0.3, 0.02):
        before.near(path[::-1] + shift, WITHIN)
    found, expected = before.near(path, WITHIN).table, fresh.near(path, WITHIN).table
    np.testing.assert_array_equal(found[:, :3], expected[:, :3])
    np.testing.assert_array_equal(found[found[:, 2] > 0], expected[found[:, 2] > 0])
    other, each = CollisionChecker(checker.robot, checker.scene), [checker.distances(q) for q in path]
    for k in rng.permutation(len(path)):
        other.colliding_pair(path[k])
        np.testing.assert_allclose(other.distances(path[k]), each[k], rtol=0, atol=1e-12)


def test_the_least_distance_below_what_is_asked(case):
    checker, path = case
    distances = PairDistances(checker, 0.5)
    true = np.array([checker.clearance(q).distance for q in path])
    for part in (slice(0, 1), slice(0, 12), slice(12, None)):
        if true[part].min() > 0:
            assert distances.least(path[part], 0.4) == pytest.approx(min(0.4, true[part].min()), abs=2e-5)


def test_gradients_of_the_distances_of_near_pairs(case, rng):
    checker, path = case
    pairs = checker.pairs
    table = pairs.near(path, 0.3)
    rows, of = table[:, :2].T.astype(int)
    ways = 1e-5 * rng.normal(size=path[rows].shape)
    changes = np.einsum("kn,kn->k", pairs.gradients(path, table), ways)
    ends = [
        pairs.distances(np.stack([q, q + way]), of[[k]])
        for k, (q, way) in enumerate(zip(path[rows], ways, strict=True))
    ]
    apart = table[:, 2] > 1e-3
    # At edges that are parallel to faces other points may be nearest after a step.
    assert (np.abs(changes - np.diff(ends, axis=1).ravel())[apart] < 1e-6).mean() > 0.95
    assert np.abs(changes[apart]).max() > 1e-5


def test_bodies_that_are_not_convex_are_measured_by_coal():
    hollow = coal.BVHModelOBBRSS()
    hollow.beginModel(1, 3)
    hollow.addTriangle(np.array([0.0, 0.0, 0.0]), np.array([0.2, 0.0, 0.0]), np.array([0.0, 0.2, 0.0]))
    hollow.endModel()
    shapes = hollow, coal.Box(0.1, 0.2, 0.3), coal.Halfspace(np.array([0.0, 0.0, 1.0]), 0.0)
    parts = [pin.GeometryObject("part", 0, pin.SE3.Identity(), shape) for shape in shapes]
    np.testing.assert_array_equal(ConvexBodies.of(parts).exact, [False, True, False])


# ---------------------------------------------------------------------------------------------------- point clouds


def test_clouds_all_around_are_decided_without_coal(past_a_column, by_coal, rng):
    robot, points = past_a_column[0].robot, rng.uniform(-1.0, 1.0, (400, 3))
    points = points[np.linalg.norm(points, axis=1) > 0.75]
    scene = scene_of(points, Pose()).with_obstacles(Obstacle("column", PointCloud(0.01, points=column(200, 0.7))))
    checker, Q = CollisionChecker(robot, scene), np.concatenate([past_a_column[1], rng.uniform(-1.5, 1.5, (20, 6))])
    expected = np.array([by_coal(checker, checker.distance_names, q) for q in Q])
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


def test_a_cloud_that_is_measured_anew_is_another_one(past_a_column, by_coal):
    checker, path = past_a_column
    for points in (column(300), column(310, 0.9), column(300, 1.4), column(300)):
        checker.move(scene_of(points))
        for q in path[:3]:
            expected = by_coal(checker, checker.distance_names, q)
            np.testing.assert_allclose(checker.distances(q), expected, rtol=0, atol=2e-6)


# ----------------------------------------------------------------------------------------------- nearest points


def distances_of(witnesses, Q):
    """Return distances (C,) and their gradients (C, n) by the nearest points, and these on the links (C, 3)."""
    points, normals, offsets = *np.split(witnesses.table[:, 3:9], 2, axis=1), witnesses.table[:, 9]
    joints = witnesses.carriers[witnesses.pairs]
    places, jacobians = body_points(witnesses.robot, Q, witnesses.rows, joints, points)
    gradients = np.einsum("cin,ci->cn", jacobians, normals)
    return np.einsum("ci,ci->c", places, normals) - offsets, gradients, places


def test_nearest_points_are_given_of_the_link_first(past_a_column):
    checker, path = past_a_column
    checker.move(scene_of(column(300)))
    found, names = PairDistances(checker, 0.5).near(path, 0.5), names_of(checker, 0.5)
    distances, _, places = distances_of(found, path)
    apart = found.table[:, 2] > 0
    np.testing.assert_allclose(distances[apart], found.table[apart, 2], rtol=0, atol=1e-6)
    of_scan = np.array([names[k][1] == "scan" for k in found.pairs]) & (found.table[:, 2] > 0.05)
    assert of_scan.sum() > 5
    for on_link, distance, normal in zip(
        places[of_scan], found.table[of_scan, 2], found.table[of_scan, 6:9], strict=True
    ):
        local = TURNED.se3.actInv(on_link - distance * normal)
        assert np.hypot(local[0] - 0.5, local[1]) < 0.08 + 0.01 + 0.01, "on the column, not on the link"


@pytest.fixture(scope="module")
def near(panda, clutter):
    """Return free configurations that are near something, and the nearest points there."""
    checker = CollisionChecker(panda, clutter)
    rng = np.random.default_rng(3)
    found = []
    while len(found) < 6:
        q = rng.uniform(panda.lower, panda.upper)
        if not checker.in_collision(q) and 0.01 < checker.clearance(q).distance < WITHIN - 0.01:
            found.append(q)
    return np.array(found), PairDistances(checker, WITHIN).near(np.array(found), WITHIN)


def test_hinge_costs_are_those_of_the_distances(near):
    Q, witnesses = near
    distances, slopes, _ = distances_of(witnesses, Q)
    costs, gradients, bends = witnesses.hinge_costs(Q, np.array([[WITHIN, 2.0], [0.5 * WITHIN, 30.0]]))
    lacks = np.maximum(0.0, 1 - distances[:, None] / [WITHIN, 0.5 * WITHIN])
    assert (lacks[:, 1] > 0).any()
    assert (lacks[:, 1] == 0).any()
    terms = lacks**2 @ [2.0, 30.0]
    rates = -2 * lacks / [WITHIN, 0.5 * WITHIN] @ [2.0, 30.0]
    second = 2 * (lacks > 0) / np.square([WITHIN, 0.5 * WITHIN]) @ [2.0, 30.0]
    for row in range(len(Q)):
        of_row = witnesses.rows == row
        assert costs[row] == pytest.approx(terms[of_row].sum(), rel=1e-9)
        np.testing.assert_allclose(gradients[row], rates[of_row] @ slopes[of_row], atol=1e-8)
    np.testing.assert_allclose(bends, np.sqrt(second)[:, None] * slopes, atol=1e-8)
