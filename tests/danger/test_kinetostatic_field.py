"""The kinetostatic danger of robots: at rest, ahead in time, and its gradients."""

import numpy as np
import pytest

from safe_ompl import DangerField, InputError, KinetostaticField

POINTS = [[0.6, 0.4, 0.5], [-0.5, 0.3, 0.2], [0.1, -0.7, 0.9]]


def states(robot, number, seed=0):
    rng = np.random.default_rng(seed)
    spread = np.minimum(robot.upper, 2.0) - np.maximum(robot.lower, -2.0)
    middle = (np.minimum(robot.upper, 2.0) + np.maximum(robot.lower, -2.0)) / 2
    return middle + 0.4 * spread * rng.uniform(-1, 1, (number, robot.n)), rng.normal(size=(number, robot.n))


@pytest.mark.parametrize("aggregate", ["max", "mean", "softmax"])
def test_at_rest_it_is_the_static_danger(panda, aggregate):
    field = DangerField(panda, POINTS, [1.0, 2.0, 0.5], aggregate=aggregate, k1=2.0)
    Q, _ = states(panda, 6)
    found = KinetostaticField(field).values(Q, np.zeros_like(Q))
    np.testing.assert_allclose(found, field.values(Q), rtol=1e-12)


def test_without_the_isotropic_part_it_is_the_danger_ahead(panda):
    field = DangerField(panda, POINTS[:1])
    moving = KinetostaticField(field, k2=1e-5, gamma=0.0)
    Q, Qd = states(panda, 6)
    np.testing.assert_allclose(moving.values(Q, Qd), field.values(Q + 1e-5 * Qd), rtol=1e-8)


def test_with_gamma_of_one_motion_never_makes_it_less_dangerous(panda):
    field = DangerField(panda, POINTS)
    Q, Qd = states(panda, 200)
    assert (KinetostaticField(field, gamma=1.0).values(Q, Qd) >= field.values(Q)).all()
    assert (KinetostaticField(field, gamma=0.0).values(Q, Qd) < field.values(Q)).any()


@pytest.mark.parametrize(
    ("name", "gamma", "aggregate"),
    [("panda", 1.0, "max"), ("twin_arm", 0.0, "softmax"), ("slider", 1.0, "softmax"), ("kinova", 0.0, "max")],
)
def test_gradients_are_those_of_finite_differences(robot_named, name, gamma, aggregate):
    robot = robot_named(name)
    moving = KinetostaticField(DangerField(robot, POINTS, [1.0, 2.0, 0.5], aggregate=aggregate), gamma=gamma, k2=0.3)
    Q, Qd = states(robot, 4, seed=2)
    _, by_q, by_qd = moving.values_and_gradients(Q, Qd)
    step = 1e-6
    for i in range(robot.n):
        e = np.eye(robot.n)[i] * step
        slope = (moving.values(Q + e, Qd) - moving.values(Q - e, Qd)) / (2 * step)
        np.testing.assert_allclose(by_q[:, i], slope, atol=1e-5 * (1 + abs(by_q).max()))
        slope = (moving.values(Q, Qd + e) - moving.values(Q, Qd - e)) / (2 * step)
        np.testing.assert_allclose(by_qd[:, i], slope, atol=1e-5 * (1 + abs(by_qd).max()))


def test_points_that_follow_the_configuration_and_none_at_all(panda):
    Q, Qd = states(panda, 3)
    fixed = KinetostaticField(DangerField(panda, POINTS))
    called = KinetostaticField(DangerField(panda, lambda q: POINTS))
    np.testing.assert_allclose(called.values(Q, Qd), fixed.values(Q, Qd))
    nothing = KinetostaticField(DangerField(panda, []))
    assert not nothing.values(Q, Qd).any()
    assert not np.concatenate(nothing.gradients(Q, Qd)).any()


def test_one_state_and_what_is_refused(panda):
    moving = KinetostaticField(DangerField(panda, POINTS), k2=0.5)
    Q, Qd = states(panda, 1)
    assert moving.value(Q[0], Qd[0]) == moving.values(Q, Qd)[0]
    assert "k2=0.5, gamma=1" in repr(moving)
    with pytest.raises(InputError, match="joint velocities must be finite"):
        moving.value(Q[0], np.full(panda.n, np.nan))
    with pytest.raises(InputError, match="k2 must be a finite number >= 0"):
        KinetostaticField(moving.field, k2=-1)
    with pytest.raises(InputError, match="gamma must be a finite number >= 0"):
        KinetostaticField(moving.field, gamma=np.nan)


def test_a_field_knows_the_one_of_the_robot_in_motion(panda):
    field = DangerField(panda, POINTS, k1=2.0, k2=0.3, gamma=0.5)
    Q, Qd = states(panda, 2)
    np.testing.assert_allclose(field.moving.values(Q, Qd), KinetostaticField(field, 0.3, 0.5).values(Q, Qd))
    assert DangerField(panda, POINTS, k1=2.0).moving.lead == 0.25
    with pytest.raises(InputError, match="gamma must be a finite number >= 0"):
        DangerField(panda, POINTS, gamma=-1)


@pytest.mark.parametrize("weighting", ["unit", "length"])
@pytest.mark.parametrize("gamma", [0.0, 1.0])
def test_the_maximum_is_that_of_all_points_though_few_are_evaluated(panda, weighting, gamma):
    rng = np.random.default_rng(3)
    points, weights = rng.uniform(-0.9, 0.9, (80, 3)), rng.uniform(0.2, 3.0, 80)
    kind = {"weighting": weighting, "k1": 2.0, "gamma": gamma}
    field = DangerField(panda, points, weights, **kind)
    Q, Qd = states(panda, 12)
    pairs = zip(points, weights, strict=True)  # a mean over one point takes no bounds
    alone = [DangerField(panda, p[None], w[None], aggregate="mean", **kind).moving for p, w in pairs]
    expected = np.max([one.values(Q, Qd) for one in alone], axis=0)
    np.testing.assert_allclose(field.moving.values(Q, Qd), expected, rtol=1e-12)


@pytest.mark.parametrize("weighting", ["unit", "length"])
def test_a_danger_point_on_a_link_or_at_its_end_is_found_among_many(panda, weighting):
    points = np.random.default_rng(3).uniform(-0.9, 0.9, (80, 3))
    Q, Qd = states(panda, 4)
    for q, qd in zip(Q, Qd, strict=True):
        keys = panda.keypoints(q)
        a, b = keys[panda.segments[3]]
        for touching in (a, b, (a + b) / 2):
            field = DangerField(panda, np.vstack([points, touching]), weighting=weighting)
            alone = DangerField(panda, [touching], weighting=weighting).moving
            for rates in (0 * qd, qd):
                assert field.moving.value(q, rates) >= alone.value(q, rates) * (1 - 1e-12)
            assert field.moving.value(q, 0 * qd) == pytest.approx(field.value(q), rel=1e-9)


def test_gradients_of_the_most_dangerous_of_many_points_are_those_of_that_point_alone(panda):
    rng = np.random.default_rng(4)
    points, weights = rng.uniform(-0.9, 0.9, (80, 3)), rng.uniform(0.2, 3.0, 80)
    moving = DangerField(panda, points, weights, k1=2.0).moving
    Q, Qd = states(panda, 8)
    for q, qd, value, *slopes in zip(Q, Qd, *moving.values_and_gradients(Q, Qd), strict=True):
        pairs = zip(points, weights, strict=True)
        alone = [DangerField(panda, p[None], w[None], k1=2.0).moving for p, w in pairs]
        most = max(alone, key=lambda one: one.value(q, qd))
        assert value == pytest.approx(most.value(q, qd), rel=1e-12)
        np.testing.assert_allclose(slopes, np.concatenate(most.gradients(q[None], qd[None])), rtol=1e-9, atol=1e-9)
