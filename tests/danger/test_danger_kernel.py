"""The compiled danger and its gradient against Pinocchio's kinematics and NumPy's field, for all kinds of robots."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from oracles import numpy_danger

from safe_ompl import DangerField, InputError
from safe_ompl.common import compiled
from safe_ompl.danger.kernels.field import Skeleton, ceilings, new_block
from safe_ompl.danger.link_field import WEIGHTINGS, Segments, field
from safe_ompl.danger.points import AGGREGATES, Evaluation, grouped

ROBOTS = ("panda", "kinova", "twin_arm", "slider", "gripper")  # continuous, sliding and mimic joints, branches


def some(robot, rng, number):
    return rng.uniform(robot.lower, robot.upper, (number, robot.n))


def agree(danger, Q):
    values, gradients = danger.values_and_gradients(Q)
    expected, slopes = numpy_danger.danger_and_gradient(danger, Q)
    np.testing.assert_allclose(values, expected, rtol=1e-12)
    np.testing.assert_allclose(danger.values(Q), values, rtol=0)
    np.testing.assert_allclose(gradients, slopes, rtol=1e-10, atol=1e-11 * np.abs(slopes).max())


@pytest.mark.parametrize("name", ROBOTS)
@pytest.mark.parametrize("aggregate", AGGREGATES)
@pytest.mark.parametrize("weighting", WEIGHTINGS)
def test_the_same_for_every_robot(robot_named, rng, name, aggregate, weighting):
    robot = robot_named(name)
    points, weights = rng.normal(size=(9, 3)), rng.uniform(0.5, 2.0, 9)
    agree(DangerField(robot, points, weights, aggregate=aggregate, weighting=weighting, k1=0.7), some(robot, rng, 4))


@settings(max_examples=40)
@given(seed=st.integers(0, 10**6), number=st.integers(1, 300), aggregate=st.sampled_from(AGGREGATES))
def test_the_same_for_any_number_of_points(robot_named, seed, number, aggregate):
    rng = np.random.default_rng(seed)
    robot = robot_named("panda")
    agree(DangerField(robot, rng.normal(size=(number, 3)), aggregate=aggregate), some(robot, rng, 2))


def test_the_same_with_points_from_a_callable(robot_named, rng):
    robot = robot_named("ur5")
    agree(
        DangerField(robot, lambda q: [[q[0], 0.5, 0.5], [0.5, q[1], 0.9]], [1.0, 2.0], aggregate="mean"),
        some(robot, rng, 6),
    )


@pytest.mark.parametrize("aggregate", AGGREGATES)
@pytest.mark.parametrize("number", [3, 200])
def test_a_batch_is_one_by_one(robot_named, rng, aggregate, number):
    robot = robot_named("ur5")
    danger = DangerField(robot, rng.normal(size=(number, 3)), aggregate=aggregate)
    Q = some(robot, rng, 7)
    values, gradients = danger.values_and_gradients(Q)
    for q, value, gradient in zip(Q, values, gradients, strict=True):
        assert danger.value(q) == value
        np.testing.assert_array_equal(danger.gradient(q), gradient)


@settings(max_examples=25)
@given(seed=st.integers(0, 10**6), number=st.integers(401, 3000), weighting=st.sampled_from(WEIGHTINGS))
def test_groups_of_many_points_change_nothing(robot_named, seed, number, weighting):
    """Parts of the points, too few to be grouped, against all of them together."""
    rng = np.random.default_rng(seed)
    robot = robot_named("panda")
    points = rng.normal(size=(number, 3)) * rng.choice([0.0, 0.3, 1.0], 3) + [0.5, 0.0, 0.4]
    weights = rng.choice([0.5, 1.0, 3.0], number)
    many = DangerField(robot, points, weights, weighting=weighting)
    Q = some(robot, rng, 3)
    expected = numpy_danger.danger_and_gradient(many, Q)
    values, gradients = many._evaluation.values_and_gradients(Q, many.groups)
    np.testing.assert_allclose(values, expected[0], rtol=1e-12)
    np.testing.assert_array_equal(many.values(Q), values)
    np.testing.assert_array_equal(many.gradients(Q), gradients)
    few = [
        DangerField(robot, points[k : k + 400], weights[k : k + 400], weighting=weighting)
        for k in range(0, number, 400)
    ]
    np.testing.assert_array_equal(values, np.max([field.values(Q) for field in few], axis=0))
    for q, value, gradient in zip(Q, values, gradients, strict=True):
        alone = next(field for field in few if field.value(q) == value)
        np.testing.assert_array_equal(gradient, alone.gradient(q))


@compiled
def bounds_of(places, links, points, by_length, reach):
    out, distances = (np.empty(points.shape[1], np.float32), np.empty((len(places), points.shape[1]), np.float32))
    ceilings(Skeleton(places, links, by_length, new_block(len(places))), points, reach, distances, out)
    return out


@settings(max_examples=100)
@given(
    seed=st.integers(0, 10**6),
    scale=st.sampled_from([1e-3, 1.0, 30.0]),
    away=st.sampled_from([0.0, 10.0, 1000.0]),
    weighting=st.sampled_from(WEIGHTINGS),
)
def test_no_level_exceeds_its_bound_in_single_precision(seed, scale, away, weighting):
    """Points anywhere, and as near to the links, to their ends and to the lines beyond them as rounding can tell."""
    rng = np.random.default_rng(seed)
    places = scale * rng.normal(size=(5, 3)) + away
    places[4] = places[3] + rng.choice([0.0, 1e-9, 1e-4]) * rng.normal(size=3)
    links = np.array([[0, 1], [1, 2], [2, 3], [3, 4]])
    on = [places[a] + t * (places[b] - places[a]) for a, b in links for t in (-0.5, 0.0, 0.3, 0.999, 1.0, 2.0)]
    beside = np.array(on)[:, None] + 10.0 ** rng.uniform(-12, 0, (20, 1)) * rng.normal(size=(20, 3))
    points = np.vstack([scale * rng.normal(size=(50, 3)) + away, on, beside.reshape(-1, 3)])
    exact = field(places[None], Segments(links), points, weighting=weighting)[0]
    reach = max(np.abs(points).max(), np.abs(places).max())
    bounds = bounds_of(places, links, points.T.astype(np.float32), weighting == "length", reach)
    assert (bounds >= exact).all()
    far = exact < 0.2 / scale * (scale if weighting == "length" else 1.0)
    assert away or (bounds[far] <= 1.05 * exact[far] + 1e-6).all()


@pytest.mark.parametrize("aggregate", AGGREGATES)
@pytest.mark.parametrize("name", ["panda", "slider", "gripper"])
def test_the_mean_of_a_motion(robot_named, rng, name, aggregate):
    robot = robot_named(name)
    danger = DangerField(robot, rng.normal([1.5, 0, 0], 1.0, (500, 3)), aggregate=aggregate)
    for start, end in rng.uniform(robot.lower, robot.upper, (5, 2, robot.n)):
        t = np.linspace(0, 1, 2001)[:, None]
        exact = np.trapezoid(danger.values(start + t * (end - start)), t[:, 0])
        assert danger.mean(start, end, 1e-4) == pytest.approx(exact, rel=1e-3)
        assert danger.mean(end, start, 1e-4) == pytest.approx(danger.mean(start, end, 1e-4), rel=1e-12)
    before = danger.counts.field_configurations
    danger.mean(start, start)
    assert danger.counts.field_configurations == before + 3
    assert danger.mean(start, start) == pytest.approx(danger.value(start))


def test_the_mean_of_a_motion_through_a_danger_point_is_infinite(robot_named):
    robot = robot_named("panda")
    q = np.zeros(robot.n)
    danger = DangerField(robot, robot.keypoints(q)[-1:])
    assert danger.mean(q - 0.1, q + 0.1) == np.inf


def test_the_mean_without_danger_points_and_with_those_of_a_callable(robot_named):
    robot = robot_named("panda")
    q = np.zeros(robot.n)
    assert DangerField(robot, []).mean(q, q + 1) == 0.0
    with pytest.raises(InputError, match="depend on the configuration"):
        DangerField(robot, lambda q: [[1.0, 0.0, 0.0]]).mean(q, q + 1)


@settings(max_examples=25)
@given(
    seed=st.integers(0, 10**6),
    number=st.integers(401, 5000),
    aggregate=st.sampled_from(["mean", "softmax"]),
    weighting=st.sampled_from(WEIGHTINGS),
    tolerance=st.sampled_from([1e-4, 1e-2, 0.1]),
)
def test_groups_keep_the_tolerance(robot_named, seed, number, aggregate, weighting, tolerance):
    rng = np.random.default_rng(seed)
    robot = robot_named("panda")
    points = rng.normal(size=(number, 3)) * rng.choice([0.0, 0.1, 1.0], 3) + rng.choice([0.5, 2.0], 3)
    options = {"aggregate": aggregate, "weighting": weighting, "sharpness": rng.choice([0.1, 10.0])}
    weights = rng.choice([0.5, 1.0, 3.0], number)
    grouped = DangerField(robot, points, weights, tolerance=tolerance, **options)
    exact = DangerField(robot, points, weights, tolerance=0.0, **options)
    Q = some(robot, rng, 3)
    values, gradients = grouped.values_and_gradients(Q)
    np.testing.assert_allclose(values, exact.values(Q), rtol=tolerance)
    np.testing.assert_array_equal(grouped.values(Q), values)
    slopes = exact.gradients(Q)
    assert (np.linalg.norm(gradients - slopes, axis=1) < 10 * tolerance * np.linalg.norm(slopes, axis=1)).all()


@pytest.mark.parametrize("aggregate", ["mean", "softmax"])
def test_the_gradient_of_groups_is_that_of_their_value(robot_named, rng, aggregate):
    """Points so far away that all are taken by centres: nothing jumps between neighbouring configurations."""
    robot = robot_named("panda")
    points = rng.normal(size=(3000, 3)) * 0.1 + [4.0, 0.0, 0.0]
    danger = DangerField(robot, points, aggregate=aggregate, sharpness=1.0)
    exact = DangerField(robot, points, aggregate=aggregate, sharpness=1.0, tolerance=0.0)
    assert danger.value(robot.lower / 2) != exact.value(robot.lower / 2)
    for q in some(robot, rng, 3):
        steps = 1e-5 * np.eye(robot.n)
        slope = (danger.values(q + steps) - danger.values(q - steps)) / 2e-5
        np.testing.assert_allclose(danger.gradient(q), slope, rtol=1e-5, atol=1e-8)


def test_groups_far_away_cost_little(panda, rng):
    """The points themselves are not looked at: they may be anything."""
    groups = grouped(rng.normal(size=(3000, 3)) * 0.3 + [4.0, 0.0, 0.0], np.ones(3000))
    evaluation = Evaluation(panda, Segments(panda.segments), False, ("mean", 1.0, 0.01))
    q = some(panda, rng, 1)
    expected = evaluation.values(q, groups)
    groups.columns[0, :, :3000] = np.nan
    np.testing.assert_array_equal(evaluation.values(q, groups), expected)


@pytest.mark.parametrize("aggregate", AGGREGATES)
def test_a_link_through_one_of_many_points_is_infinitely_dangerous(robot_named, rng, aggregate):
    robot = robot_named("panda")
    q = some(robot, rng, 1)
    met = robot.keypoints(q[0])[robot.segments[0, 1]]
    danger = DangerField(robot, np.vstack([rng.normal(size=(1000, 3)), met]), aggregate=aggregate)
    values, gradients = danger.values_and_gradients(q)
    assert values == [np.inf]
    assert np.isfinite(gradients).all()
    assert aggregate == "mean" or not gradients.any()


@pytest.mark.parametrize("tolerance", [0.0, -1.0, np.nan])
def test_the_tolerance_of_a_mean_is_positive(robot_named, tolerance):
    robot = robot_named("panda")
    with pytest.raises(InputError, match="tolerance"):
        DangerField(robot, [[1.0, 0.0, 0.0]]).mean(robot.lower, robot.upper, tolerance)


@pytest.mark.parametrize("tolerance", [-0.01, 0.2, np.nan])
def test_tolerances_out_of_bounds_are_refused(robot_named, tolerance):
    with pytest.raises(InputError, match="tolerance"):
        DangerField(robot_named("panda"), [[1.0, 0.0, 0.0]], tolerance=tolerance)


# ------------------------------------------------------------------------------------------ danger points in groups


@pytest.mark.parametrize("number", [1, 64, 65, 1024, 1025, 5000])
@pytest.mark.parametrize("flat", [1.0, 0.0])
def test_groups_hold_their_points(rng, number, flat):
    points, charges = rng.normal(size=(number, 3)) * [1.0, flat, flat], rng.choice([1.0, 2.0], number)
    groups = grouped(points, charges)
    places, kept, balls = groups.columns[0, :, :number], groups.charges[0], groups.balls
    centres = groups.columns[0, :, number:]
    given = np.column_stack([points, charges])
    np.testing.assert_array_equal(np.sort(np.column_stack([places.T, kept]), axis=0), np.sort(given, axis=0))
    seen = []
    blocks = balls["begin"][0]
    for block in range(blocks):
        held = balls[balls["begin"][block] : balls["end"][block]]
        begin, end = held["begin"][0], held["end"][-1]
        assert balls["number"][block] == held["number"].sum() == end - begin
        for group in range(balls["begin"][block], balls["end"][block]):
            first, last = balls["begin"][group], balls["end"][group]
            seen += range(first, last)
            for ball in (block, group):
                away = np.linalg.norm(places[:, first:last] - centres[:, [ball]], axis=0)
                assert (away <= balls["radius"][ball]).all()
                assert (kept[first:last] <= balls["heaviest"][ball]).all()
                assert (kept[first:last] >= balls["lightest"][ball]).all()
        for ball, (first, last) in ((block, (begin, end)), (balls["begin"][block], (begin, held["end"][0]))):
            np.testing.assert_allclose(
                np.average(places[:, first:last], axis=1, weights=kept[first:last]), centres[:, ball], atol=1e-12
            )
            away = np.square(places[:, first:last] - centres[:, [ball]]).sum(axis=0)
            assert np.average(away, weights=kept[first:last]) == pytest.approx(balls["spread"][ball])
            assert balls["charge"][ball] == pytest.approx(kept[first:last].mean())
    assert seen == list(range(number))


def test_groups_are_compact(rng):
    """A hundred groups of points in a cube are about as wide as a hundredth of the cube."""
    groups = grouped(rng.uniform(size=(6400, 3)), np.ones(6400))
    assert np.median(groups.balls["radius"][groups.balls["begin"][0] :]) < 0.25
