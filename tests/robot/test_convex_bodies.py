"""Convex bodies for compiled code: bounds of their distances against coal."""

from functools import cache
from itertools import combinations_with_replacement

import coal
import numpy as np
import pinocchio as pin
import pytest
from oracles.coal_distances import coal_distance

from safe_ompl import PointCloud
from safe_ompl.geometry import ConvexBodies, convex_hull, triangle_tree

ERROR = 1e-5  # [m] of coal's distances


def polytope(rng, number):
    vertices = rng.normal(size=(number, 3)) * rng.uniform(0.05, 0.3, 3) + rng.uniform(-0.2, 0.2, 3)
    return convex_hull(triangle_tree(vertices, np.array([[0, 1, 2]])), "polytope")


@cache
def large_polytope(seed):
    return polytope(np.random.default_rng(seed), 3000)


SOLIDS = {
    "box": lambda rng: coal.Box(*rng.uniform(0.02, 0.6, 3)),
    "sphere": lambda rng: coal.Sphere(rng.uniform(0.02, 0.3)),
    "capsule": lambda rng: coal.Capsule(rng.uniform(0.02, 0.2), rng.uniform(0.05, 0.8)),
    "cylinder": lambda rng: coal.Cylinder(rng.uniform(0.02, 0.2), rng.uniform(0.05, 0.8)),
    "tetrahedron": lambda rng: polytope(rng, 4),
    "polytope": lambda rng: polytope(rng, 80),
    "large polytope": lambda rng: large_polytope(rng.integers(3)),
}
OTHERS = {
    "cone": lambda rng: coal.Cone(rng.uniform(0.02, 0.2), rng.uniform(0.05, 0.8)),
    "ellipsoid": lambda rng: coal.Ellipsoid(*rng.uniform(0.05, 0.3, 3)),
    "swept box": lambda rng: swept(coal.Box(*rng.uniform(0.02, 0.6, 3)), rng.uniform(0.01, 0.1)),
    "swept polytope": lambda rng: swept(polytope(rng, 30), rng.uniform(0.01, 0.1)),
    "mesh": lambda rng: triangle_tree(rng.uniform(-0.2, 0.2, (60, 3)), np.arange(60).reshape(20, 3)),
    "cloud": lambda rng: PointCloud(0.02, points=rng.uniform(-0.2, 0.2, (60, 3))).parts()[0].geometry,
}


def swept(shape, radius):
    shape.setSweptSphereRadius(radius)
    return shape


def bounds(first, second, axis=None, enough=np.inf, least=-np.inf):
    """Return the bounds of the distance of two geometry objects in the world."""
    model = ConvexBodies.of([first]).joined(ConvexBodies.of([second]))
    if axis is None:
        a, b = (body["translation"] + body["rotation"] @ body["centre"] for body in model.bodies)
        axis = a - b
    return model.table.distance_bounds(0, 1, axis, enough, least)


def placed(shape, rng, reach):
    turn = pin.Quaternion(*(v := rng.normal(size=4)) / np.linalg.norm(v)).matrix()
    return pin.GeometryObject("body", 0, pin.SE3(turn, rng.uniform(-reach, reach, 3)), shape)


def coals(first, second):
    return coal_distance(first.geometry, first.placement, second.geometry, second.placement)


@pytest.mark.parametrize(("name", "other"), list(combinations_with_replacement(SOLIDS, 2)))
def test_tight_bounds_of_what_is_represented_exactly(rng, name, other):
    apart = 0
    for _ in range(15):
        first, second = placed(SOLIDS[name](rng), rng, 0.6), placed(SOLIDS[other](rng), rng, 0.6)
        lower, upper = bounds(first, second)
        distance = coals(first, second)
        assert lower <= distance + ERROR
        if distance > 1e-3:
            assert upper >= distance - ERROR
            assert lower >= 0.89 * distance
            apart += 1
        if distance < -1e-3:
            assert lower < 0
            assert upper <= 0
    assert apart >= 2


@pytest.mark.parametrize("other", ["box", "polytope"])
@pytest.mark.parametrize("name", OTHERS)
def test_what_is_enclosed_is_not_farther_than_it_is(rng, name, other):
    for _ in range(12):
        first, second = placed(OTHERS[name](rng), rng, 0.6), placed(SOLIDS[other](rng), rng, 0.6)
        assert bounds(first, second)[0] <= coals(first, second) + ERROR


@pytest.mark.parametrize("name", [*SOLIDS, *OTHERS])
def test_the_ball_and_the_box_about_a_body_hold_it(rng, name):
    part = placed((SOLIDS | OTHERS)[name](rng), rng, 0.0)
    model = ConvexBodies.of([part])
    body, table = model.bodies[0], model.table
    centre = body["translation"] + body["rotation"] @ body["centre"]
    for direction in rng.normal(size=(200, 3)):
        direction /= np.linalg.norm(direction)
        point = table.support(0, direction) + body["ball"] * direction
        assert np.linalg.norm(point - centre) <= body["reach"] + 1e-12
        assert (np.abs(body["rotation"].T @ (point - centre)) <= body["extent"] + 1e-12).all()


def test_what_has_no_end_is_known():
    plane = pin.GeometryObject("plane", 0, pin.SE3.Identity(), coal.Halfspace(np.array([0.0, 0.0, 1.0]), 0.0))
    ball = pin.GeometryObject("ball", 0, pin.SE3.Identity(), coal.Sphere(0.1))
    assert not ConvexBodies.of([ball, plane]).bounded
    assert ConvexBodies.of([ball]).bounded
    assert ConvexBodies.of([]).bounded
