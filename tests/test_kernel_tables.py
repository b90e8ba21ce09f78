"""Compiled classes and functions refuse bad arrays with a clear error, whatever is wrong with them, and never crash.

What is behind a pointer is not checked by Python, so each array that a kernel is given is broken in many ways: its
shape, its type, how it lies in memory, and single numbers in it. Whatever can be made is then used.
"""

import re
from contextlib import suppress
from importlib import import_module
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import safe_ompl
from safe_ompl import Box, DangerField, InputError, Obstacle, PointCloud, Pose, Scene
from safe_ompl.collision import CollisionChecker, MotionProver
from safe_ompl.collision.proofs import ALLOWANCE, Required
from safe_ompl.common import Counts
from safe_ompl.danger import CellMotions, static
from safe_ompl.danger.link_field import Groups
from safe_ompl.drawing.light import Light
from safe_ompl.drawing.rendering import Painted, View
from safe_ompl.geometry.convex import ShapeTable
from safe_ompl.live.replanning.hull_gaps import MarginQuery
from safe_ompl.planning.simplification import costs, descent, edges
from safe_ompl.planning.simplification.cost import DangerDensity, ObstacleCost
from safe_ompl.robot.kinematics import JOINT, JointTable

ROOT = Path(safe_ompl.__file__).parent
SOURCES = {path.stem: path for path in ROOT.rglob("*.pyx") if "lanes" not in path.stem}
MODULES = {
    stem: import_module(".".join(path.relative_to(ROOT.parent).with_suffix("").parts)) for stem, path in SOURCES.items()
}


class GivenCost:
    """What nodes of a tree cost."""

    def values(self, Q):
        return np.zeros(len(Q))

    def value_and_gradient(self, q):
        return 0.0, np.zeros(len(q))


def misshapen(array):
    """Yield arrays of another type or shape than a given one, and others that lie in memory in another way."""
    plain = array if array.dtype.names is None else np.zeros(array.shape)
    yield from (array.tolist(), array.ravel().tolist()[:-1], [], array.astype(object), np.zeros((), array.dtype))
    yield plain.astype({"f": np.float32, "i": np.int32, "u": np.uint32}.get(plain.dtype.kind, np.int8))
    yield plain.astype(np.intp if plain.dtype.kind == "f" else np.float64)
    yield array.astype(array.dtype.newbyteorder())
    yield from (array[..., None], array.ravel(), np.asfortranarray(array))
    for axis, size in enumerate(array.shape):
        for kept in (0, 1, size - 1, size + 1) if size else (0,):
            yield array.take(np.arange(kept) % max(size, 1), axis)
        yield np.repeat(array, 2, axis)[(slice(None),) * axis + (slice(None, None, 2),)]
    read_only = array.copy()
    read_only.flags.writeable = False
    yield read_only


NUMBERS = {
    np.float64: (np.nan, np.inf, -np.inf, -1.0, 0.0, 1e300, 2.0**63),
    np.float32: (np.nan, np.inf, -np.inf, -1.0, 0.0),
    np.intp: (-1, 0, 1, 1000, 2**62, -(2**62)),
    np.int32: (-1, 0, 1, 1000, 2**31 - 1, -(2**31)),
    np.uintp: (0, 1000, 2**62, 2**64 - 1),
}


def with_bad_numbers(array):
    """Yield arrays in which the first number, the last one, or all numbers of a field are bad."""
    for name in array.dtype.names or (None,):
        size, kind = (array.size, array.dtype) if name is None else (array[name].size, array[name].dtype)
        for number in NUMBERS.get(kind.type, ()):
            for place in (0, size - 1, slice(None)) if size else ():
                changed = array.copy()
                (changed if name is None else changed[name]).flat[place] = number
                yield changed


def broken(value):
    """Yield values that are wrong in one way each."""
    if isinstance(value, bool):
        return
    yield from (None, "text")
    if isinstance(value, np.ndarray):
        yield from misshapen(value)
        yield from with_bad_numbers(value)
    elif isinstance(value, int):
        yield from (-1, 0, 1, 100, 2**62, -(2**62), 2**70)
    elif isinstance(value, float):
        yield from (np.nan, np.inf, -np.inf, -1.0, 0.0, 1e300, 1e-300)
    elif isinstance(value, tuple):
        yield from (value[:-1], (*value, value[-1]), ())
        make = getattr(value, "_make", tuple)  # of a named tuple, or any other
        for k, part in enumerate(value):
            yield from (make((*value[:k], other, *value[k + 1 :])) for other in broken(part))


def numbers(*shape, low=0.1, high=1.0):
    return np.random.default_rng(0).uniform(low, high, shape)


def indices(*numbers):
    return np.array(numbers, dtype=np.intp)


# What is called, by its name, with arguments that are right. A method is called of an object of its class, after the
# methods before it. Each object that could be made of broken arguments is used by calling all methods.
CALLS = {
    # safe_ompl.robot
    "kinematics.JointTable": lambda t: [t.joints.array],
    "kinematics.JointTable.frames": lambda t: [t.values],
    "kinematics.KeyPointTable": lambda t: [t.keys.array, t.joints],
    "kinematics.KeyPointTable.places": lambda t: [t.values],
    "kinematics.KeyPointTable.jacobian_transpose_product": lambda t: [t.values, numbers(4, t.keys.K, 3)],
    "kinematics.KeyPointTable.motions": lambda t: [t.values, t.values],
    "kinematics.KeyPointTable.motion_gradients": lambda t: [t.values, t.values, numbers(2, 4, t.keys.K, 3)],
    "kinematics.EdgeTable": lambda t: [t.limits.coupling, t.limits.bounds],
    "kinematics.EdgeTable.hold": lambda t: [t.values[0]],
    "kinematics.EdgeTable.edge": lambda t: [t.values[0], t.values[1]],
    "kinematics.EdgeTable.edges": lambda t: [t.values[:2], t.values[2:]],
    "kinematics.Coordinates": lambda t: [-t.ones, t.ones, np.zeros(6, bool)],
    "kinematics.Coordinates.steer": lambda t: [t.values[0], t.values[1], 0.1],
    "kinematics.Coordinates.descend": lambda t: [numbers(2, 6), t.ones, 0.1],
    "kinematics.damped_pseudoinverse_step": lambda t: [numbers(3, 6), numbers(3), numbers(6), 0.05, 0.05],
    "kinematics.unrolled": lambda t: [t.values, np.ones(6, bool)],
    # safe_ompl.geometry
    "convex.ShapeTable": lambda t: [*t.hulls.__reduce__()[1]],
    "convex.ShapeTable.distance_bounds": lambda t: [0, 2, numbers(3), 1.0, 0.0],
    "convex.ShapeTable.support": lambda t: [0, numbers(3)],
    "convex.ShapeTable.farthest_from_axes": lambda t: [numbers(2, 3), numbers(2, 3), numbers(2), numbers(2)],
    "convex.extreme_vertices": lambda t: [numbers(9, 3), 2],
    "surface_points.box_points": lambda t: [numbers(3), 0.1],
    "surface_points.revolved_points": lambda t: [numbers(4, 2), 0.1],
    "surface_points.capsule_points": lambda t: [numbers(2, 3), 2 * numbers(2, 3), numbers(2), 0.1],
    # safe_ompl.collision
    "proofs.Required": lambda t: [numbers(5)],
    "proofs.DistanceBounds": lambda t: [t.robot, t.bodies, t.pairs.bodies, t.radii, Counts()],
    "proofs.DistanceBounds.of": lambda t: [t.values, indices(0, 1), 0.1],
    "proofs.DistanceBounds.nearer": lambda t: [t.values[0], t.margins, 0.1],
    "proofs.DistanceBounds.near": lambda t: [t.values, t.bounds.some(indices(0, 1)), 0.1],
    "proofs.DistanceBounds.some": lambda t: [indices(0, 1)],
    "proofs.DistanceBounds.prove": lambda t: [t.values[:2], t.required, 0.01],
    "proofs.DistanceBounds.prove_edge": lambda t: [t.values[0], t.values[1], t.limits, t.required, 0.01],
    "proofs.DistanceBounds.prove_many": lambda t: [numbers(3, 2, 6), t.required, 0.01],
    "proofs.bound_reaches": lambda t: [t.hulls, np.zeros((1, 1)), np.ones((1, 1)), 1.0],
    "proofs.distance_gradients": lambda t: [t.joints, t.values, t.carriers[:, None].repeat(2, axis=1), t.near],
    "proofs.hinge_costs": lambda t: [t.joints, t.values, t.carriers, t.near, numbers(2, 2)],
    # safe_ompl.danger
    "static.SkeletonTable": lambda t: [t.keys, t.skeleton.links, True],
    "static.DangerPointTable": lambda t: [numbers(3, 5), numbers(5)],
    "static.DangerPointTable.some": lambda t: [np.ones(5, bool)],
    "static.PointDanger": lambda t: [t.skeleton, t.danger.points, static.MAXIMUM, 1.0],
    "static.PointDanger.values": lambda t: [t.values],
    "static.PointDanger.values_and_gradients": lambda t: [t.values],
    "static.PointDanger.high": lambda t: [t.values, 0.5, 0.1],
    "static.PointDanger.high_levels": lambda t: [t.values[:1], 0.1],
    "static.PointDanger.mean": lambda t: [t.values[:2], 2, 0.01],
    "static.link_fields": lambda t: [t.places, t.skeleton.links, numbers(3, 5), True, False],
    "static.link_distances": lambda t: [t.places, t.skeleton.links, numbers(3, 5)],
    "static.space_gradients": lambda t: [t.places, t.skeleton.links, numbers(3, 5), True],
    "static.chords": lambda t: [numbers(2, 3, 4), numbers(2, 3, 4), 0.1, numbers(3), numbers(3), numbers(3)],
    "static.aggregates": lambda t: [numbers(4, 5), static.MEAN, 1.0],
    "static.shares": lambda t: [numbers(4, 5), static.SOFTMAX, 1.0],
    "moving.link_terms": lambda t: [t.places, t.places, t.skeleton.links, numbers(5, 3), True, True],
    "moving.gradients": lambda t: [*[t.places] * 2, t.skeleton.links, numbers(4, 5, 3), numbers(4, 5), 0.1, 0.1, True],
    "moving.cell_bounds": lambda t: [t.motions, t.skeleton.links, numbers(5, 3), 1.0, True, numbers(5)],
    "moving.highest": lambda t: [t.skeleton, t.values, t.values, t.groups, 0.1, 0.1],
    # safe_ompl.motions
    "bodies.BodyCorners": lambda t: [t.joints, indices(0, 3, 6), numbers(3, 8, 3), numbers(3)],
    "bodies.BodyCorners.speeds": lambda t: [t.values, t.values],
    "bodies.acceleration_bounds": lambda t: [numbers(3, 6), np.ones((3, 6), bool), t.values, t.values],
    "bodies.ClosingGaps": lambda t: [t.joints, t.shapes, *t.limb_pairs, numbers(2, 6), *[numbers(2)] * 2],
    "bodies.ClosingGaps.rates": lambda t: [t.values, numbers(4), t.values, numbers(4, 4)],
    "bodies.LimbArrivals": lambda t: [t.joints, t.shapes, indices(1, 2), t.last, numbers(1), 0.1, 0.1],
    "bodies.LimbArrivals.along": lambda t: [t.values, numbers(4, 2), 1.0, 0.1],
    "laws.stopping_speeds": lambda t: [*[numbers(4)] * 2, *[numbers(4, 2)] * 2, numbers(4), indices(1, 1, 3, 3)],
    "laws.spread": lambda t: [np.arange(5.0), numbers(4), indices(0, 2), numbers(4, 2), 1.0],
    "laws.fastest": lambda t: [numbers(4), t.boxes, numbers(6), numbers(5)],
    "laws.ceilings": lambda t: [numbers(4), numbers(4), numbers(4), indices(2, 4)],
    "laws.drive": lambda t: [np.arange(5.0), numbers(4), numbers(4), numbers(5), 0.5, 0.1, 0.5, 0.1],
    "laws.squared_velocities_of_stop": lambda t: [1, 3, numbers(4), t.boxes, numbers(6)],
    "laws.time_left": lambda t: [numbers(4), t.boxes, numbers(6), indices(1, 1, 3, 3), numbers(4, 2), numbers(4, 2)],
    "laws.derivatives": lambda t: [np.arange(4.0), numbers(3, 5, 6), indices(0, 2), numbers(2)],
    "laws.derivative_ranges": lambda t: [np.arange(4.0), numbers(3, 5, 6), indices(0, 2), np.arange(3.0)],
    # safe_ompl.live
    "hull_gaps.BodyHulls": lambda t: [indices(0, 2), *t.hull_corners, numbers(2), numbers(2, 3), numbers(2)],
    "hull_gaps.BodyHulls.gaps": lambda t: [indices(0, 3), numbers(2), t.motion_sets, t.cells, t.sets, t.query],
    "hull_gaps.BodyHulls.cell_gaps": lambda t: [indices(0, 3), t.motion_sets, t.cells, t.sets, 0.1, 1.0, 0.1],
    "hull_gaps.BodyHulls.separating_axes": lambda t: [t.cells, t.sets, 1.0],
    "hull_gaps.BodyHulls.chords_ahead": lambda t: [t.cells, numbers(2, 2, 3), numbers(2, 2), numbers(2)],
    # safe_ompl.drawing
    "rendering.Shading": lambda t: [t.solid, t.light, t.view],
    "rendering.Shading.picture": lambda t: [np.array([[0, 1, -1, 0]] * 4, dtype=np.int32), numbers(4, 4)],
    "rendering.draw_triangles": lambda t: [4 * numbers(4, 3), t.solid.faces, 0, *t.buffers()],
    "rendering.nearest_triangles": lambda t: [4 * numbers(4, 3), t.solid.faces, 6, 4],
    "rendering.interpolated": lambda t: [numbers(4, 3), t.solid.faces, numbers(4, 2), numbers(3), numbers(2, 3)],
    # safe_ompl.planning
    "growth.Tree": lambda t: [t.bridge, GivenCost()],
    "growth.Tree.add": lambda t: [t.ones],
    "growth.Tree.best": lambda t: [t.ones, 0.1],
    "growth.Tree.gradient": lambda t: [0],
    "growth.Tree.branch": lambda t: [0],
    "growth.branch": lambda t: [indices(-1, 0, 1), 2],
    "costs.DangerTerms": lambda t: [t.danger, 1.0, np.eye(6), t.ones],
    "costs.DangerTerms.edge_costs": lambda t: [t.values, np.ones((4, 4), bool), np.ones(6, bool)],
    "costs.PricedPath": lambda t: [t.values, 6],
    "costs.Densities": lambda t: [t.terms, t.carriers, t.near, numbers(2, 2)],
    "costs.Densities.model": lambda t: [t.values],
    "costs.Densities.retreat_step": lambda t: [t.values[:1], 0.1, 1.0, 0.8, 0.04],
    "costs.Walk": lambda t: [-3 * t.ones, 3 * t.ones],
    "costs.Walk.restart": lambda t: [t.densities, t.densities.model(t.values), np.zeros(4, bool)],
    "costs.Walk.resume": lambda t: [t.densities, t.densities.model(t.values)],
    "costs.Walk.descend": lambda t: [lambda: False, 4, 0.1, 0.0],
    "costs.Walk.direction": lambda t: [],
    "costs.arc_lengths": lambda t: [t.values],
    "costs.at_arc_lengths": lambda t: [t.values, numbers(5)],
    "costs.spread": lambda t: [t.values, 0.1],
    "costs.gauss_points": lambda t: [t.values],
    "costs.divided": lambda t: [t.values, 0.1],
    "costs.refined": lambda t: [t.values, lambda Q: indices(0, 2)],
    "costs.bounded_step": lambda t: [numbers(6), numbers(3, 6), 0.1],
    "costs.factored": lambda t: [np.array([np.eye(3)] * 4), numbers(3, 3, 3), np.ones(4, np.uint8)],
    "edges.EdgeProofs": lambda t: [t.motion],
    "edges.EdgeProofs.accept": lambda t: [t.values[:2].copy()],
    "edges.EdgeProofs.inherit": lambda t: [t.values[1:].copy()],
    "edges.EdgeProofs.refused": lambda t: [t.values],
    "edges.EdgeProofs.chained": lambda t: [t.values, numbers(4, 4), 10.0, np.zeros((4, 4), np.intp)],
    "edges.EdgeProofs.held_back": lambda t: [t.values, t.values[::-1].copy()],
    "edges.retreat": lambda t: [t.ones, t.obstacles, t.field, (-3 * t.ones, 3 * t.ones), lambda: False],
    "edges.shortcut": lambda t: [t.values, *t.search(), 3, 1.0],
    "edges.joined": lambda t: [t.values, *t.search()],
    "edges.cheapest_proven_chain": lambda t: [
        t.values,
        np.ones((4, 4), bool),
        *t.search(),
        np.inf,
        np.zeros((4, 4), np.intp),
    ],
    "descent.ActiveSetCost": lambda t: [t.density, t.obstacles, t.values],
    "descent.ActiveSetCost.look_at": lambda t: [t.values, t.values],
    "descent.ActiveSetCost.of": lambda t: [t.values],
    "descent.ActiveSetCost.anchor": lambda t: [t.values],
    "descent.ActiveSetCost.model": lambda t: [t.values],
    "descent.ProvenDescent": lambda t: [t.values, t.ends, t.cost(), t.terms_of_descent(), t.best(), lambda: False],
    "descent.ProvenDescent.run": lambda t: [],
}


@pytest.fixture(scope="module")
def t(ur5):
    """Return a robot beside a box and a solid of cells, and objects and arrays of it."""
    heap = PointCloud(0.02, points=numbers(60, 3, low=-0.2, high=0.2))
    things = Obstacle("box", Box((0.1, 0.2, 0.3)), Pose((0.6, 0.2, 0.4))), Obstacle("heap", heap, Pose((0.0, 0.6, 0.4)))
    pairs = CollisionChecker(ur5, Scene(things)).pairs
    bounds, kinematics, P = pairs.bounds, ur5.kinematics, len(pairs.names)
    t = SimpleNamespace(robot=ur5, pairs=pairs, bounds=bounds, shapes=bounds.shapes, joints=kinematics.table)
    t.keys, t.limits, t.values, t.ones = kinematics.keypoint_table, ur5.joint_limits.table, numbers(4, 6), np.ones(6)
    t.bodies, t.radii, t.margins = pairs._table.convex_bodies, pairs._joint_radii, np.full(P, 0.1)
    t.required = Required(np.full(P, 0.01) + ALLOWANCE)
    standing, *lists = t.shapes.__reduce__()[1]
    standing = standing.copy()
    standing["joint"] = 0
    t.hulls = ShapeTable(standing, *lists)
    t.skeleton = static.SkeletonTable(t.keys, ur5.segments.astype(np.intp), True)
    t.danger = static.PointDanger(t.skeleton, static.DangerPointTable(numbers(3, 5), numbers(5)), static.MAXIMUM, 1.0)
    t.places = t.keys.places(t.values)
    t.groups = Groups(numbers(3, 7), numbers(5), indices(0, 2, 5), numbers(2), numbers(2))
    t.boxes = tuple(numbers(4, 6) for _ in range(4))
    t.cells = np.tile(np.eye(3), (4, 3, 1, 1)), numbers(4, 3, 3), numbers(4, 2)
    t.sets = numbers(5, 3), indices(0, 2, 5), numbers(2), numbers(2, 2)
    t.solid = Painted(
        numbers(4, 3), numbers(4, 3), indices(0, 1, 2, 1, 2, 3).reshape(2, 3), indices(0, 1), numbers(2, 4)
    )
    t.light = Light(0.0, numbers(2), 0.1, numbers(2, 2), numbers(2, 4), np.zeros((2, 5, 5), np.float32), numbers(5, 5))
    t.view = View(numbers(3), np.eye(3), 0.1, numbers(3))
    t.bridge = SimpleNamespace(n=6, circular=np.zeros(6, bool), rotations=[])
    t.carriers, t.near = indices(3, 0), np.hstack([np.array([[0, 0], [0, 1]]), numbers(2, 8)])
    t.terms = costs.DangerTerms(t.danger, 1.0, np.eye(6), t.ones)
    t.densities = costs.Densities(t.terms, t.carriers, t.near, numbers(2, 2))
    checker = CollisionChecker(ur5, Scene(things))
    t.motion, t.obstacles, t.field = MotionProver(checker), ObstacleCost(checker, 0.1), DangerField(ur5, numbers(5, 3))
    t.density = DangerDensity(t.field, 1.0)
    t.cost = lambda: descent.ActiveSetCost(t.density, t.obstacles, t.values)
    t.search = lambda: (t.cost(), edges.EdgeProofs(t.motion), lambda: False)
    t.ends, t.best = (t.values[:1].copy(), t.values[3:].copy()), lambda: descent.BestPath(t.values, None)
    t.terms_of_descent = lambda: descent.Terms(edges.EdgeProofs(t.motion), (-3 * t.ones, 3 * t.ones), 100.0, 0.1)
    t.motions = CellMotions(t.places, t.places, *[t.places[..., 0].copy()] * 2, *[numbers(4)] * 3)
    t.limb_pairs = indices(1, 5, 2, 6).reshape(2, 2), indices(0, 3, 1, 2).reshape(2, 2)
    t.last, t.hull_corners = indices(len(t.shapes.bodies) - 1), (numbers(7, 3), indices(0, 3, 7))
    t.motion_sets, t.query = (numbers(2), numbers(4, 2, 2)), MarginQuery(0.1, 1.0, 0.0, False)
    t.buffers = lambda: (np.zeros((4, 6), np.float32), np.zeros((4, 6), np.int32))
    return t


# Beside these, NumPy refuses indices, and Python numbers that are too large for C and objects of another kind.
REFUSED = (TypeError, ValueError, IndexError, OverflowError, AttributeError)


def function(t, name):
    """Return a class, a function, or a method of an object after all methods before it in the table were called."""
    stem, owner, *method = name.split(".")
    found = getattr(MODULES[stem], owner)
    if method:
        made = found(*CALLS[f"{stem}.{owner}"](t))
        for other in methods(name):
            if other == name:
                return getattr(made, method[0])
            getattr(made, other.split(".")[-1])(*CALLS[other](t))
    return found


def methods(name):
    """Return the names of the methods of a class."""
    return [other for other in CALLS if other.startswith(".".join(name.split(".")[:2]) + ".")]


@pytest.mark.filterwarnings("ignore::RuntimeWarning")  # overflow and NaN in NumPy
@pytest.mark.parametrize("name", CALLS)
def test_bad_arguments_are_refused(t, name):
    right = CALLS[name](t)
    function(t, name)(*right)
    for k, argument in enumerate(right):
        for value in broken(argument):
            try:
                made = function(t, name)(*right[:k], value, *right[k + 1 :])
            except REFUSED:
                continue
            for other in methods(name) if name.count(".") == 1 else ():
                with suppress(*REFUSED):
                    getattr(made, other.split(".")[-1])(*CALLS[other](t))


def with_number(array, name, number):
    """Return a copy of an array with another first number in a field."""
    array = array.copy()
    array[name][0] = number
    return array


def with_part(parts, k, part):
    return (*parts[:k], part, *parts[k + 1 :])


# What leads out of a table, or does not fit another one: the argument, what it is instead, and what is said.
ELSEWHERE = [
    ("kinematics.JointTable", 0, lambda t: with_number(t.joints.array, "parent", -1), "its parent is -1"),
    ("kinematics.JointTable", 0, lambda t: with_number(t.joints.array, "parent", 2), "must be one of 0 to 0"),
    ("kinematics.JointTable", 0, lambda t: np.zeros((3, 3)), "[Bb]uffer|dtype|format"),
    ("laws.time_left", 3, lambda t: indices(4, 1, 3, 3), r"ends\[0\] must be from 0 to 3, got 4"),
    ("laws.time_left", 3, lambda t: indices(-1, 1, 3, 3), r"ends\[0\] must be from 0 to 3, got -1"),
    ("laws.time_left", 0, lambda t: numbers(3), "sizes must have 4 rows, got 3"),
    ("laws.time_left", 2, lambda t: numbers(5), r"boxes must have shape \(4, 5\), got \(4, 6\)"),
    ("laws.time_left", 1, lambda t: t.boxes[:1], "boxes must be four arrays, got 1"),
    ("laws.time_left", 5, lambda t: numbers(4, 3), "times and harmless must be of the same limbs, got 2 and 3"),
    ("laws.derivatives", 2, lambda t: indices(0, 3), r"pieces\[1\] must be from 0 to 2, got 3"),
    ("laws.derivatives", 0, lambda t: np.arange(5.0), "3 pieces need powers and 4 times, got 5 and 5"),
    ("laws.derivatives", 2, lambda t: indices(0), "pieces must have 2 rows, got 1"),
    ("bodies.LimbArrivals", 2, lambda t: indices(-1), "bodies: must be from 0 to"),
    ("bodies.LimbArrivals", 3, lambda t: indices(10_000), "limbs: must be from 0 to"),
    ("bodies.LimbArrivals", 4, lambda t: numbers(2), "there must be speeds of 1 limbs, got 2"),
    ("bodies.LimbArrivals", 0, lambda t: JointTable(np.zeros(0, JOINT)), "there is no joint"),
    ("hull_gaps.BodyHulls", 0, lambda t: indices(-1, 2), "body 0 is carried by joint -1"),
    ("hull_gaps.BodyHulls", 2, lambda t: indices(0, 3, 8), "must lead from 0 to the number of vertices"),
    ("hull_gaps.BodyHulls", 2, lambda t: indices(0, 0, 7), "list 0 of vertices is empty"),
    ("hull_gaps.BodyHulls", 3, lambda t: numbers(3), r"must have shapes \(2,\), \(2,\) and \(2, 3\)"),
    ("hull_gaps.BodyHulls.gaps", 0, lambda t: indices(0, 4), "those of 5 cells and 3 joints at least"),
    ("hull_gaps.BodyHulls.gaps", 0, lambda t: indices(-1, 3), "there is no cell -1"),
    ("hull_gaps.BodyHulls.gaps", 1, lambda t: numbers(3), "one time for each window"),
    ("hull_gaps.BodyHulls.gaps", 2, lambda t: with_part(t.motion_sets, 0, numbers(3)), "one speed for each window"),
    ("hull_gaps.BodyHulls.gaps", 2, lambda t: with_part(t.motion_sets, 1, numbers(4, 3, 2)), r"shape \(4, 2, …\)"),
    ("hull_gaps.BodyHulls.gaps", 3, lambda t: tuple(part[:, :2].copy() for part in t.cells), "4 cells and 3 joints at"),
    ("hull_gaps.BodyHulls.gaps", 3, lambda t: with_part(t.cells, 2, numbers(4, 1)), r"travel must have shape \(4, 2\)"),
    ("hull_gaps.BodyHulls.gaps", 4, lambda t: with_part(t.sets, 1, indices(1, 2, 5)), "first_point must lead from 0"),
    ("hull_gaps.BodyHulls.gaps", 4, lambda t: with_part(t.sets, 3, numbers(3, 2)), r"shapes \(3,\) and \(2, 2\)"),
]


@pytest.mark.parametrize(("name", "argument", "other", "message"), ELSEWHERE)
def test_what_leads_elsewhere_is_named(t, name, argument, other, message):
    given = with_part(CALLS[name](t), argument, other(t))
    with pytest.raises((InputError, ValueError), match=message):
        function(t, name)(*given)


def test_all_that_is_compiled_is_in_the_table():
    found = {
        f"{stem}.{name}"
        for stem, module in MODULES.items()
        for name in re.findall(r"^(?:cdef class|def) (\w+)", SOURCES[stem].read_text(encoding="utf-8"), re.MULTILINE)
        if not name.startswith("_")
    }
    assert found - {*CALLS} == {"proofs.Workspace", "growth.Growth"}, "they take no arrays"
