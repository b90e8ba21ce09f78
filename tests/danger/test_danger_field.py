"""Danger of configurations: aggregates, gradients, means of motions, fields that move, counters, bad input."""

import math
import pickle

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from oracles.differences import slopes
from oracles.pinocchio_points import keypoint_jacobians

from safe_ompl import CertifiedDanger, DangerField, DangerLimit, InputError, KinetostaticField, Scene
from safe_ompl.common import Counts
from safe_ompl.danger.field import AGGREGATES
from safe_ompl.danger.link_field import WEIGHTINGS, field, vectors
from safe_ompl.danger.static import DangerPointTable, PointDanger
from safe_ompl.geometry import STANDING, Box, Obstacle, Person, Pose

ROBOTS = ("panda", "kinova", "twin_arm", "slider", "gripper")  # continuous, sliding and mimic joints, branches
POINTS = np.random.default_rng(2).normal(size=(9, 3)) * [0.5, 0.5, 0.1] + [0.4, 0.3, 0.15]
Q0 = np.array([0, 0, 0, -1.5, 0, 1.5, 0])
WEIGHTS = np.random.default_rng(3).uniform(0.5, 2, 9)


def some(robot, rng, number):
    return rng.uniform(robot.lower, robot.upper, (number, robot.n))


def levels(danger, q):
    weights = np.ones(len(danger.points)) if danger.weights is None else danger.weights
    keypoints = danger.robot.keypoints(q)[None]
    return danger.k1 * weights * field(keypoints, danger.links, danger.points, danger.weighting)[0]


def aggregated(x, aggregate, sharpness):
    if aggregate == "softmax":
        return x.max() + math.log(np.exp(sharpness * (x - x.max())).sum()) / sharpness
    return x.max() if aggregate == "max" else x.mean()


# ---------------------------------------------------------------------------------------- values and gradients


@pytest.mark.parametrize("name", ROBOTS)
@pytest.mark.parametrize("aggregate", AGGREGATES)
@pytest.mark.parametrize("weighting", WEIGHTINGS)
def test_values_and_gradients_of_every_robot(robot_named, rng, name, aggregate, weighting):
    robot = robot_named(name)
    kind = {"aggregate": aggregate, "weighting": weighting, "k1": 0.7, "sharpness": 3.0}
    danger = DangerField(robot, rng.normal(size=(9, 3)), rng.uniform(0.5, 2.0, 9), **kind)
    Q = some(robot, rng, 4)
    values, gradients = danger.values_and_gradients(Q)
    np.testing.assert_array_equal(danger.values(Q), values)
    for q, value, gradient in zip(Q, values, gradients, strict=True):
        assert value == pytest.approx(aggregated(levels(danger, q), aggregate, 3.0), rel=1e-12)
        assert danger.value(q) == value
        np.testing.assert_allclose(danger.gradient(q), gradient, rtol=1e-12, atol=1e-12)
        expected = slopes(danger.value, q)
        np.testing.assert_allclose(gradient, expected, rtol=1e-5, atol=1e-6 * (1 + np.abs(expected).max()))


@settings(max_examples=40)
@given(st.integers(0, 10**6), st.integers(1, 6000), st.sampled_from(AGGREGATES), st.sampled_from(WEIGHTINGS))
def test_values_of_any_number_of_points(robot_named, seed, number, aggregate, weighting):
    rng = np.random.default_rng(seed)
    points = rng.normal(size=(number, 3)) * rng.choice([0.0, 0.3, 1.0], 3) + [0.5, 0.0, 0.4]
    kind = {"aggregate": aggregate, "weighting": weighting}
    danger = DangerField(robot_named("panda"), points, rng.choice([0.5, 1.0, 3.0], number), **kind)
    for q in some(danger.robot, rng, 2):
        expected = levels(danger, q)
        assert danger.value(q) == pytest.approx(aggregated(expected, aggregate, 10.0), rel=1e-12)
        if aggregate == "max":
            alone = danger.with_points(points[[expected.argmax()]], danger.weights[[expected.argmax()]])
            np.testing.assert_allclose(danger.gradient(q), alone.gradient(q), rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("aggregate", AGGREGATES)
def test_arrays_of_any_kind_are_taken(panda, rng, aggregate):
    danger = DangerField(panda, POINTS.T.copy().T, WEIGHTS[::-1], aggregate=aggregate, k1=2.0)
    frozen = some(panda, rng, 4)
    frozen.setflags(write=False)
    motion = KinetostaticField(danger)
    for Q in (frozen, np.asfortranarray(frozen), frozen[::2], frozen.tolist()):
        expected = [danger.value(q) for q in Q]
        np.testing.assert_array_equal(danger.values_and_gradients(Q)[0], expected)
        np.testing.assert_array_equal(danger.high_points(Q, 0.5), danger.high_points(np.array(Q), 0.5))
        np.testing.assert_allclose(motion.values_and_gradients(Q, 0 * np.array(Q))[0], expected, rtol=1e-12)
        assert danger.link_fields(panda.keypoints_batch(np.array(Q)))[0].shape == (len(Q), len(danger.links), 9)


@pytest.mark.parametrize("aggregate", AGGREGATES)
def test_infinite_at_contact(panda, rng, aggregate):
    Q = some(panda, rng, 4)
    keys = panda.keypoints(Q[0])
    danger = DangerField(panda, [*rng.normal(size=(1000, 3)), keys[panda.segments[0, 1]]], aggregate=aggregate)
    values, gradients = danger.values_and_gradients(Q[:1])
    assert values == [np.inf]
    assert np.isfinite(gradients).all()
    assert aggregate == "mean" or not gradients.any()
    near = DangerField(panda, [*POINTS, keys[-1] + [0, 0, 1e-6]], aggregate=aggregate, sharpness=1e4)
    assert np.isfinite(near.values_and_gradients(Q)[1]).all()
    assert aggregate != "softmax" or near.value(Q[0]) == pytest.approx(levels(near, Q[0]).max(), rel=1e-9)


def test_a_danger_below_single_precision_is_that_of_its_own_points(panda, rng):
    """Bounds are zero there, as are those of the places that fill up a row of points: what lies there is not read."""
    Q, small = some(panda, rng, 5), 1e-60
    known = DangerField(panda, POINTS).point_danger()
    columns, point_weights = np.zeros(64), np.full(64, 1e9)
    columns[:27], point_weights[:9] = known.points.columns.ravel(), small
    faint = DangerPointTable(columns[:27].reshape(3, 9), point_weights[:9])
    found = PointDanger(known.skeleton, faint, known.kind, known.sharpness).values(Q)
    np.testing.assert_allclose(found, small * known.values(Q), rtol=1e-12, atol=0.0)


@pytest.mark.parametrize("weights", [None, WEIGHTS])
def test_high_levels_are_the_fields_of_single_points(panda, rng, weights):
    danger, Q = DangerField(panda, POINTS, weights), some(panda, rng, 6)
    level, every = float(np.median(danger.values(Q))), danger.point_danger()
    single = [danger.with_points(POINTS[[m]], None if weights is None else weights[[m]]) for m in range(9)]
    for q in Q:
        values, gradients = every.high_levels(q[None], level)
        expected = [(one.value(q), one.gradient(q)) for one in single if one.value(q) >= level]
        assert len(expected) == len(values)
        for value, gradient, (known, slope) in zip(values, gradients, expected, strict=True):
            assert value == pytest.approx(known, rel=1e-12)
            np.testing.assert_allclose(gradient, slope, rtol=1e-10, atol=1e-12)
    high, every = danger.high_points(Q, 0.5), np.array([one.values(Q) for one in single])
    np.testing.assert_array_equal(high, (every >= 0.5 * every.max(axis=0)).any(axis=1))
    np.testing.assert_array_equal(danger.point_danger(high).values(Q), danger.values(Q))
    assert DangerField(panda, POINTS, weights, aggregate="mean").high_points(Q, 0.5).all()


def test_the_push_is_the_sum_over_all_points_and_the_ends_of_all_links(ur5):
    """Σ_m Σ_l J_lᵀ w_m CDF(p_m) with the Jacobians themselves (paper, §4.3)."""
    q = np.array([0.3, -1.0, 1.2, 0.1, 0.4, -0.2])
    danger = DangerField(ur5, POINTS, WEIGHTS)
    found, jacobians = vectors(ur5.keypoints(q)[None], danger.links, POINTS)[0], keypoint_jacobians(ur5, q)
    expected = sum(jacobians[end].T @ (WEIGHTS @ found) for _, end in ur5.segments)
    np.testing.assert_allclose(danger.push(q), expected, rtol=1e-10, atol=1e-9)


# ------------------------------------------------------------------------------------------ means of motions


@pytest.mark.parametrize("aggregate", AGGREGATES)
@pytest.mark.parametrize("name", ["panda", "slider", "gripper"])
def test_the_mean_of_a_motion(robot_named, rng, name, aggregate):
    robot = robot_named(name)
    danger = DangerField(robot, rng.normal([1.5, 0, 0], 1.0, (100, 3)), aggregate=aggregate)
    for start, end in rng.uniform(robot.lower, robot.upper, (5, 2, robot.n)):
        t = np.linspace(0, 1, 2001)[:, None]
        exact = np.trapezoid(danger.values(start + t * (end - start)), t[:, 0])
        assert danger.mean(start, end, 1e-4) == pytest.approx(exact, rel=1e-3)
        assert danger.mean(end, start, 1e-4) == pytest.approx(danger.mean(start, end, 1e-4), rel=1e-12)
    before = danger.counts.field_configurations
    assert danger.mean(start, start) == pytest.approx(danger.value(start))
    assert danger.counts.field_configurations == before + 4


def test_the_mean_of_a_motion_through_a_danger_point_is_infinite(panda):
    q = np.zeros(panda.n)
    danger = DangerField(panda, panda.keypoints(q)[-1:])
    assert danger.mean(q - 0.1, q + 0.1) == np.inf


# ------------------------------------------------------------------------------------------------ moving obstacles

SCENE = Scene(
    (
        Obstacle("table", Box((1.2, 0.8, 0.05)), Pose((0.4, 0.0, -0.2))),
        Obstacle("box", Box((0.1, 0.2, 0.3)), Pose((0.5, 0.3, 0.4)), weight=0.5),
        Obstacle("colleague", Person(), Pose((0.9, 0.2, -0.8))),
    )
)


@pytest.mark.parametrize(("aggregate", "spacing"), [("max", None), ("softmax", 0.2)])
def test_after_any_moves_the_danger_is_that_of_a_field_made_anew(panda, rng, aggregate, spacing):
    scene = SCENE
    danger = DangerField.of_scene(panda, scene, spacing, aggregate=aggregate)
    proof, changes = CertifiedDanger(danger), 0
    for k in range(12):
        place = np.array([*rng.uniform(-1.5, 1.5, 2), -0.8])
        body = {name: 1.75 * point + place + rng.normal(0.0, 0.03, 3) for name, point in STANDING.items()}
        places = {"colleague": body, "box": Pose(tuple(rng.uniform(-1, 1, 3))), "table": Pose((0, 0, -k / 9))}
        names = rng.choice(list(places), rng.integers(1, 3), replace=False)
        scene = scene.moved({str(name): places[str(name)] for name in names})
        scene = scene.without("box") if k == 9 else scene
        before, kept = danger.minimum, danger.frozen()
        danger.move(scene)
        assert kept.minimum == before
        anew = DangerField.of_scene(panda, scene, spacing, aggregate=aggregate)
        Q = some(panda, rng, 5)
        np.testing.assert_array_equal(danger.values(Q), anew.values(Q))
        np.testing.assert_array_equal(danger.gradients(Q), anew.gradients(Q))
        assert danger.minimum == anew.minimum
        changes += danger.minimum != before
        assert proof.of_path(Q[:2]) == CertifiedDanger(anew).of_path(Q[:2])
        if k == 9:
            break
    assert changes > 3


def test_the_revision_counts_moves_of_what_is_dangerous(panda):
    danger = DangerField.of_scene(panda, SCENE)
    danger.move(SCENE.moved({"table": Pose()}))
    assert danger.revision == 0, "a table that is not dangerous moves no danger point"
    danger.move(SCENE.moved({"box": Pose()}))
    assert danger.revision == 1


# --------------------------------------------------------------------------------------------- house keeping


def test_counts_configurations_and_points(panda, rng):
    counts, Q = Counts(), some(panda, rng, 6)
    danger = DangerField(panda, POINTS, counts=counts)
    danger.value(Q[0])
    danger.values(Q)
    danger.gradient(Q[0])
    danger.values_and_gradients(Q)
    assert (counts.field_configurations, counts.field_points) == (14, 14 * 9)
    danger.field(Q[0], POINTS[:4])
    assert (counts.field_configurations, counts.field_points) == (15, 14 * 9 + 4)


def test_survives_pickling_and_changes_of_what_it_was_given(panda, rng):
    points, weights, Q = POINTS.copy(), WEIGHTS.copy(), some(panda, rng, 3)
    danger = DangerField(panda, points, weights, aggregate="softmax", weighting="length", sharpness=4.0)
    before = danger.values(Q)
    points += 1
    weights *= 2
    again = pickle.loads(pickle.dumps(danger))
    for one in (danger, again):
        np.testing.assert_array_equal(one.values(Q), before)
        np.testing.assert_array_equal(one.points, POINTS)
        np.testing.assert_array_equal(one.weights, WEIGHTS)
    assert repr(again) == repr(danger)
    with pytest.raises(ValueError, match="read-only"):
        danger.points[0] = 0
    assert DangerField(panda, POINTS).weights is None


@pytest.mark.parametrize("points", [[], np.empty((0, 3))])
@pytest.mark.parametrize("aggregate", AGGREGATES)
@pytest.mark.parametrize("weighting", WEIGHTINGS)
def test_without_danger_points_danger_is_zero(panda, rng, points, aggregate, weighting):
    danger, Q = DangerField(panda, points, aggregate=aggregate, weighting=weighting), some(panda, rng, 3)
    values, gradients = danger.values_and_gradients(Q)
    np.testing.assert_array_equal(values, np.zeros(len(Q)))
    np.testing.assert_array_equal(gradients, np.zeros(Q.shape))
    assert danger.value(Q[0]) == danger.minimum == danger.mean(Q[0], Q[1]) == 0.0
    assert not len(danger.high_points(Q, 0.5))
    some_points = DangerField(panda, POINTS, aggregate=aggregate)
    assert [part.shape for part in some_points.values_and_gradients(np.empty((0, 7)))] == [(0,), (0, 7)]


ASKED_OF_NONE = [
    (lambda make: make(points=[[0, 0, np.nan]]), "danger points: must be finite"),
    (lambda make: make(points=[[0, 0]]), r"danger points: must have shape \(any, 3\), got \(1, 2\)"),
    (lambda make: make(points="here"), "danger points: must be numbers"),
    (lambda make: make(weights=[1.0]), r"danger weights: must have shape \(9\), got \(1,\)"),
    (lambda make: make(weights=[0.0] + [-1.0] * 8), r"danger weights must be positive, got \[0.0, -1.0"),
    (lambda make: make(weights=[np.nan] * 9), "danger weights: must be finite"),
    (lambda make: make(aggregate="sum"), "unknown aggregate 'sum'; known: max, mean, softmax"),
    (lambda make: make(weighting="mass"), "unknown weighting 'mass'; known: unit, length"),
    (lambda make: make(k1=0.0), "k1: must be a positive number, got 0.0"),
    (lambda make: make(sharpness=-1.0), "sharpness: must be a positive number, got -1.0"),
    (lambda make: make(k2=-1), "k2: must be a finite number >= 0"),
    (lambda make: make(gamma=np.nan), "gamma: must be a finite number >= 0"),
    (lambda make: make().values(np.zeros(7)), r"configurations: must have shape \(any, 7\), got \(7,\)"),
    (lambda make: make().gradients([[np.inf] + [0.0] * 6]), "configurations: must be finite, got"),
    (lambda make: make().field(np.zeros(7), [0.0, 0.0, 0.0]), r"points: must have shape \(any, 3\)"),
    *((lambda make, x=x: make().mean(Q0, Q0, x), "tolerance") for x in (0.0, -1.0, np.nan)),
    (lambda make: make().move(SCENE), r"DangerField\.of_scene"),
    (lambda make: KinetostaticField(make()).value(Q0, Q0 * np.nan), "joint velocities: must be finite"),
    *(
        (lambda make, x=x: DangerLimit(make(), x), "max danger: must be a positive number, got")
        for x in (0.0, -0.1, np.nan, np.inf, "5")
    ),
    (lambda make: CertifiedDanger(make()).of_path(np.empty((0, 7))), "at least one configuration"),
    (lambda make: CertifiedDanger(make()).of_path([Q0, Q0 * np.nan]), "path: must be finite"),
    (lambda make: CertifiedDanger(make()).of_path([[0.0, 0.0]]), "path: must have shape"),
]


@pytest.mark.parametrize(("ask", "message"), ASKED_OF_NONE)
def test_refuses(panda, ask, message):
    with pytest.raises(InputError, match=message):
        ask(lambda **options: DangerField(**{"robot": panda, "points": POINTS} | options))


def test_refuses_a_robot_without_links(crank):
    with pytest.raises(InputError, match="'crank' has no link with a length"):
        DangerField(crank, [[1.0, 0.0, 0.0]])
