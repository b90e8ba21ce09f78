"""The kernels in Cython give the same bits as those in Numba, whose places they are to take."""

from importlib import import_module

import numpy as np
import pytest

import safe_ompl
from safe_ompl import Scenario
from safe_ompl.collision import ALLOWANCE, Required
from safe_ompl.danger.kernels import danger as numba_danger
from safe_ompl.drawing import rasteriser
from safe_ompl.geometry import surfaces as numba_surfaces
from safe_ompl.geometry.kernels import extreme_vertices
from safe_ompl.planning import setup_scenario
from safe_ompl.planning.simplification import cost as numba_cost, descent, edges, measures
from safe_ompl.robot import kernels as numba_robot, motion_limits


@pytest.fixture(scope="module")
def built():
    """Return a function from a module's name to the module."""
    return lambda name: import_module(f"safe_ompl.{name}")


@pytest.fixture(scope="module", params=["panda_shelf", "ur5_handover", "paper_2"])
def setup(request):
    return setup_scenario(Scenario.load(request.param))


def same(first, second):
    """Assert that arrays or tuples of arrays are equal bit for bit, but that NaN is like NaN."""
    if not isinstance(first, tuple):
        first, second = (first,), (second,)
    for one, other in zip(first, second, strict=True):
        np.testing.assert_array_equal(np.asarray(one), np.asarray(other))


def skeleton_of(built, tables):
    kinematics, static = built("robot.kinematics"), built("danger.static")
    keys = kinematics.KeyPointTable(tables.keys, kinematics.JointTable(tables.joints))
    return static.SkeletonTable(keys, tables.links, tables.by_length)


def test_kinematics(built, setup, rng):
    kinematics, tree = built("robot.kinematics"), setup.robot.kinematics
    joints, keys = tree.joints, tree.keypoints
    table = kinematics.JointTable(joints)
    points = kinematics.KeyPointTable(keys, table)
    Q, rates = rng.uniform(-3, 3, (2, 40, len(joints)))
    forces = rng.normal(size=(2, 40, len(keys), 3))
    same(numba_robot.joint_frames(joints, Q), table.frames(Q))
    same(numba_robot.keypoints(joints, keys, Q), points.places(Q))
    same(numba_robot.pull_back(joints, keys, Q, forces[0]), points.jacobian_transpose_product(Q, forces[0]))
    same(numba_robot.keypoint_motions(joints, keys, Q, rates), points.motions(Q, rates))


@pytest.mark.parametrize(("parent", "message"), [(-1, "its parent is -1"), (2, "must be one of 0 to 0")])
def test_tables_refuse_what_leads_elsewhere(built, ur5, parent, message):
    kinematics = built("robot.kinematics")
    joints = ur5.kinematics.joints.copy()
    joints["parent"][0] = parent
    with pytest.raises(safe_ompl.InputError, match=message):
        kinematics.JointTable(joints)
    with pytest.raises(ValueError, match=r"[Bb]uffer|dtype|format"):
        kinematics.JointTable(np.zeros((3, 3)))


def test_proofs(built, setup, rng):
    proofs, kinematics = built("collision.proofs"), built("robot.kinematics")
    robot, pairs = setup.robot, setup.checker.pairs
    known, bodies = pairs.bounds, pairs._table.convex_bodies
    bounds = proofs.DistanceBounds(robot, bodies, pairs.bodies, pairs._joint_radii, setup.counts)
    distances = np.full(len(pairs.bodies), ALLOWANCE)
    required, wanted = Required.of(distances.copy()), proofs.Required(distances)
    limits = robot.joint_limits
    table = kinematics.EdgeTable(*limits.tables)
    counts = setup.counts
    for _ in range(400):
        start = rng.uniform(robot.lower, robot.upper)
        end = start + rng.choice([0.1, 0.5, 1.0]) * rng.normal(size=robot.n)
        counts.reset()
        first, places = known.prove_edge((start, end), limits, required, 1e-3), counts.bound_queries
        counts.reset()
        assert bounds.prove_edge(start, end, table, wanted, 1e-3) == first
        assert counts.bound_queries == places
        curve = start, *rng.normal(size=(3, robot.n)) * [[0.5], [0.3], [0.2]]
        assert bounds.prove(curve, wanted, 1e-3) == known.prove(curve, required, 1e-3)
    Q, rows = rng.uniform(robot.lower, robot.upper, (50, robot.n)), np.arange(len(pairs.bodies))
    same(known.of(Q, rows, 0.2), bounds.of(Q, rows, 0.2))
    first, second = known.near(Q, known.some(rows), 0.2), bounds.near(Q, bounds.some(rows), 0.2)
    same(first[:, :3], second[:, :3])
    apart = known.exact[first[:, 1].astype(int)] & (first[:, 2] > -np.inf)
    assert apart.sum() > 10
    same(first[apart], second[apart])
    margins = pairs.margins(0.05)
    for q in Q:
        same(known.nearer(q, margins, 0.05), bounds.nearer(q, margins, 0.05))


@pytest.mark.parametrize("by_length", [False, True])
def test_static_danger(built, setup, rng, by_length):
    static, lanes = built("danger.static"), {built("danger.lanes"), built("danger.lanes_v3")}
    assert static.lanes_module in {module.__name__ for module in lanes}
    prepared = setup.field.frozen().for_kernels()
    tables = prepared.tables._replace(by_length=by_length)
    skeleton = skeleton_of(built, tables)
    points = static.DangerPointTable(prepared.points.columns, prepared.points.charges)
    for kind in (static.MAXIMUM, static.MEAN, static.SOFTMAX):
        aggregate, danger = numba_danger.Aggregate(kind, 3.0), static.PointDanger(skeleton, points, kind, 3.0)
        for B in (1, 16, 37):
            Q = rng.uniform(-2, 2, (B, len(tables.joints)))
            gradients = np.zeros_like(Q)
            values = numba_danger.dangers(tables, Q, prepared.points, aggregate, gradients)
            same(values, danger.values(Q))
            same((values, gradients), danger.values_and_gradients(Q))
    danger, ends = static.PointDanger(skeleton, points, static.MAXIMUM, 1.0), rng.uniform(-2, 2, (1, Q.shape[1]))
    same(numba_danger.high_levels(tables, ends, prepared.points, 0.5), danger.high_levels(ends, 0.5))


def test_costs_and_descents_of_paths(built, setup):
    costs, static = built("planning.simplification.costs"), built("danger.static")
    robot, simplifier = setup.robot, setup.simplifier
    path = np.array(setup.plan("SafeRRTConnect", seed=1).path)
    cost = numba_cost.ActiveSetCost(simplifier.danger, simplifier.obstacle_cost.afresh(0.03), path)
    known = cost.terms

    def danger_of(prepared):
        points = static.DangerPointTable(prepared.points.columns, prepared.points.charges)
        return static.PointDanger(skeleton_of(built, prepared.tables), points, *prepared.aggregate)

    terms = costs.DangerTerms(danger_of(known.danger), known.weight, known.matrix, known.shift)
    assert terms.path_cost(path, 0.05) == numba_cost.path_cost(known, path, 0.05)
    wanted = np.ones((len(path), len(path)), dtype=bool)
    edge_costs, samples = numba_cost.edge_costs(known, path, wanted, robot.continuous)
    same((edge_costs, samples), terms.edge_costs(path, wanted, robot.continuous))
    same(numba_cost.chained(edge_costs), costs.chained(edge_costs))
    divided = measures.divided(path, 0.5)
    cost.anchor(divided)
    near = cost.densities()
    densities = costs.Densities(terms, near.carriers, near.near, near.hinges)
    model, other = cost.model(divided), densities.model(divided)
    same(tuple(model), tuple(other))
    limits = motion_limits(robot)
    walked = descent.Descent(cost, limits, divided, model)
    walk = costs.Walk(walked._moving)
    walk.resume(densities, divided, other)
    settled = walked.run(lambda: False, 8, 0.4, 0.003)
    assert settled == (walk.descend(*limits, 4, 0.4, 0.003) or walk.descend(*limits, 4, 0.4, 0.003))
    same(walked.walk.path, walk.path)
    assert walked.walk.state[4] == walk.evaluations
    q = path[:1].copy()
    close, around = simplifier.obstacle_cost.near(q), numba_cost.DangerDensity(setup.field, 1.0).terms()
    hinges = simplifier.obstacle_cost.hinges
    first = edges._retreated(numba_cost.Densities(around, close.carriers, close.table, hinges), q, 0.0)
    beside = costs.DangerTerms(danger_of(around.danger), around.weight, around.matrix, around.shift)
    second = costs.Densities(beside, close.carriers, close.table, hinges)
    same(first, second.retreat_step(q, 0.0, 600.0, 0.8, 0.04))


def test_points_and_pictures(built, rng):
    convex, points, rendering = built("geometry.convex"), built("geometry.surface_points"), built("drawing.rendering")
    cloud = rng.normal(size=(60, 3))
    same(extreme_vertices(cloud, 4), convex.extreme_vertices(cloud, 4))
    size, profile = np.array([0.3, 0.2, 0.5]), numba_surfaces.sphere_profile(0.2, 0.03)
    same(numba_surfaces.box_points(size, 0.07), points.box_points(size, 0.07))
    same(numba_surfaces.revolved_points(profile, 0.03), points.revolved_points(profile, 0.03))
    starts, ends = rng.normal(size=(2, 5, 3))
    ends[0] = starts[0]
    radii = rng.uniform(0.1, 0.4, 5)
    same(numba_surfaces.capsule_points(starts, ends, radii, 0.1), points.capsule_points(starts, ends, radii, 0.1))
    corners = rng.uniform(-20, 120, (60, 3))
    corners[::7] = np.nan
    faces = rng.integers(0, 60, (80, 3))
    nearness, owner = np.full((90, 100), -np.inf, np.float32), np.full((90, 100), -1, np.int32)
    rendering.draw_triangles(corners, faces, 0, nearness, owner)
    same(rasteriser.nearest_triangles(corners, faces, 100, 90), (nearness, owner))
