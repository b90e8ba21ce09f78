"""Distances of hulls against coal's: never larger, and as near as is asked for; and margins of motions."""

import coal
import numpy as np
import pinocchio as pin
import pytest

from safe_ompl import RateLimits, time_path
from safe_ompl.live import ReachSets
from safe_ompl.live.replanning.bounded_path import Around, BoundedPath, RobotBodies, SpeedLimits, StopLaw
from safe_ompl.live.replanning.hull_gaps import BodyHulls, MarginQuery


def hull_gap(first, second, left, close):
    """Return what is left of the distance [m] of the hulls of two sets of points; close = 0: its sign only."""
    one = np.array([0, len(first)]), np.zeros(1), first.mean(axis=0)[None], np.array([np.inf])
    body = BodyHulls(np.array([0]), first, *one)
    moving = second, np.array([0, len(second)]), np.zeros(1), np.zeros((1, 2))
    frames = np.eye(3)[None, None], np.zeros((1, 1, 3)), np.zeros((1, 1))
    query = MarginQuery(left, np.inf, close, False)
    found, *where = body.gaps(np.array([0]), np.zeros(1), (np.zeros(1), np.zeros((0, 0, 0))), frames, moving, query)
    assert where == [0, 0, 0]
    return found


def convex(points):
    vertices = coal.StdVec_Vec3s()
    for point in points:
        vertices.append(point)
    return coal.Convex.convexHull(vertices, False, "")


def test_bounds_are_below_the_distance_and_near_it():
    rng = np.random.default_rng(0)
    request, identity = coal.DistanceRequest(), coal.Transform3s()
    for _ in range(200):
        first = rng.normal(size=(rng.integers(4, 60), 3))
        second = rng.normal(size=(rng.integers(1, 3), 3)) + rng.normal(size=3) * 4
        ends = second if len(second) > 1 else np.repeat(second, 2, axis=0)
        axis = ends[1] - ends[0]
        length = max(np.linalg.norm(axis), 1e-9)
        body = coal.Capsule(1e-9, length) if len(second) > 1 else coal.Sphere(1e-9)
        turn = pin.Quaternion.FromTwoVectors(np.eye(3)[2], axis).matrix() if len(second) > 1 else np.eye(3)
        there = coal.Transform3s(turn, ends.mean(axis=0))
        exact = coal.distance(convex(first), identity, body, there, request, coal.DistanceResult())
        found = hull_gap(first, second, 0.0, 1e-4)
        assert found <= max(exact, 0.0) + 1e-6
        if exact > 0.05:
            assert found >= exact - 0.03  # the hulls are about 4 m wide
            assert hull_gap(first, second, 0.5 * exact, 0.0) >= 0
            assert hull_gap(first, second, 1.1 * exact, 0.0) < 0


@pytest.fixture(scope="module")
def path(panda):
    way = [[-1.0, 0, 0, -2.0, 0, 2.2, 0.785], [1.0, -0.3, 0, -1.8, 0, 2.2, 0.785]]
    trajectory = time_path(way, panda, RateLimits.of(panda, acceleration=10.0))
    return BoundedPath.along(RobotBodies(panda), trajectory.curve, SpeedLimits.of(trajectory))


def sets(at, growth=(0.0, 1.6)):
    points = np.array([[at, np.add(at, [0, 0, 0.3])]], dtype=float)
    return ReachSets.of((("anna", "hand"),), points, np.array([0.05]), np.array([growth], dtype=float))


def margin(path, cell, begin, end, who, clearance=0.0):
    """Return the exact margin in one cell between two times."""
    motion = StopLaw(np.array([cell]), np.zeros(2), np.zeros(2), np.array([begin, end]))
    return path.margin(motion, Around(who, 0.0, clearance), exact=True).margin


def test_margins_fall_with_time_growth_and_clearance(path):
    alone = margin(path, 40, 0.0, 0.0, sets((0.9, 0, 0.4)))
    assert margin(path, 40, 0.1, 0.3, sets((0.9, 0, 0.4))) == pytest.approx(alone - 0.48, abs=2e-4)
    assert margin(path, 40, 0.0, 0.0, sets((0.9, 0, 0.4)), 0.2) == pytest.approx(alone - 0.2, abs=2e-4)


def test_of_several_bodies_the_nearest_counts(path):
    near, far = sets((0.7, 0, 0.4)), sets((1.2, 0, 0.4), (0.1, 2.0))
    for both in (near.beside(far), far.beside(near)):
        np.testing.assert_allclose(np.sort(both.grown(0.1)), [0.16, 0.3])
        assert margin(path, 40, 0.1, 0.1, both) == pytest.approx(margin(path, 40, 0.1, 0.1, near), abs=2e-4)


def test_a_motion_is_proven_or_not_as_its_least_margin_says(path):
    rng = np.random.default_rng(1)
    proven = 0
    for _ in range(100):
        who = sets(rng.uniform([0.2, -1.2, 0.0], [1.2, 1.2, 0.8]))
        motion = path.motion_from(rng.uniform(0.1, 1.0), rng.uniform(0, 1.0), rng.uniform(-1, 1), 0.05)
        left = path.margin(motion, Around(who, 0.02))
        least = path.margin(motion, Around(who, 0.02), exact=True).margin
        if abs(least) > 2e-4:
            assert (left.margin >= 0) == (least >= 0)
        proven += left.margin >= 0
        if left.margin < 0:
            assert left.who == ("anna", "hand")
            assert left.link in path.bodies.links
    assert 10 < proven < 90


def test_no_point_of_a_body_leaves_where_a_cell_says_it_is(path, panda):
    """The travel of a cell bounds the way of every corner from the centre of the cell."""
    rng = np.random.default_rng(2)
    hulls = path.bodies.hulls
    vertices, first = hulls.vertices, hulls.first_vertex
    for k in rng.integers(0, len(path.brakes), 20):
        ends = rng.uniform(path.edges[k], path.edges[k + 1], 3)
        centre = 0.5 * (path.edges[k] + path.edges[k + 1])
        Q = path.curve.places(np.append(ends, centre)).q
        rotations, origins, _ = path.bodies.frames(Q)
        for g, joint in enumerate(hulls.carriers):
            corners = vertices[first[g] : first[g + 1]]
            places = corners @ np.swapaxes(rotations[:, joint], 1, 2) + origins[:, None, joint]
            ways = np.linalg.norm(places[:-1] - places[-1], axis=2)
            assert ways.max() <= path.frames.travel[k, g] + 1e-9
