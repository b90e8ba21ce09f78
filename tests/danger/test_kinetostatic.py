"""The kinetostatic field: its parts against quadrature and differences, the danger of robots in motion."""

from itertools import pairwise

import numpy as np
import pytest
from oracles.differences import slopes
from scipy.integrate import quad

from safe_ompl import DangerField, KinetostaticField
from safe_ompl.danger import link_field
from safe_ompl.danger.moving import gradients, link_terms

LINK = np.array([[0, 1]])


def exactly(a, b, va, vb, p, integrand):
    """Integrate over the link where the integrand is smooth."""
    axis, turn = b - a, vb - va
    kinks = [(p - a) @ axis / (axis @ axis), -(va @ turn) / max(turn @ turn, 1e-300)]
    apart = np.linalg.norm(np.cross(p - a, axis)) / (axis @ axis)
    near = [k + f * apart for k in kinks[:1] for f in (-10, -3, -1, 0, 1, 3, 10)] + kinks[1:]
    cuts = sorted({0.0, 1.0, *(k for k in near if 0 < k < 1)})

    def f(t):
        return integrand(p - a - t * axis, va + t * turn)

    return sum(quad(f, x, y, epsabs=0, epsrel=1e-12, limit=200)[0] for x, y in pairwise(cuts))


PARTS = (
    lambda rho, v: 1 / np.linalg.norm(rho),
    lambda rho, v: rho @ v / np.linalg.norm(rho) ** 3,
    lambda rho, v: np.linalg.norm(v) / (rho @ rho),
)


def cases(number):
    """Random links, and those for which the closed form has a limit of its own."""
    rng = np.random.default_rng(3)
    for k in range(number):
        a = rng.normal(size=3)
        b = a + rng.normal(size=3) * 10 ** rng.uniform(-1, 0.3)
        va, vb = rng.normal(size=(2, 3))
        p = rng.normal(size=3) * 10 ** rng.uniform(-0.5, 0.4)
        if k % 8 == 1:  # turns about its start, as a link after a joint does
            va, vb = np.zeros(3), np.cross(rng.normal(size=3), b - a)
        if k % 8 == 2:  # turns about a point of its own, within
            vb = -va * rng.uniform(0.2, 3)
        if k % 8 == 3:  # does not turn
            vb = va
        if k % 8 == 4:  # hardly turns
            vb = va + 10 ** rng.uniform(-8, -3) * vb
        if k % 8 == 5:  # beyond its end, on its line or nearly so
            p = b + (b - a) * 10 ** rng.uniform(-1, 1) + (k % 3) * 1e-6 * va
        if k % 8 == 6:  # along its line
            va, vb = (b - a) * rng.normal(), (b - a) * rng.normal()
        if k % 8 == 7:  # close beside it
            p = a + rng.uniform() * (b - a) + 1e-3 * rng.normal(size=3)
        yield a, b, va, vb, p


@pytest.mark.filterwarnings("ignore::scipy.integrate.IntegrationWarning")
@pytest.mark.parametrize("part", range(3))
def test_parts_are_what_quadrature_says(part):
    for a, b, va, vb, p in cases(160):
        found = link_terms(np.array([[a, b]]), np.array([[va, vb]]), LINK, p[None], False, True)[part][0, 0]
        expected = exactly(a, b, va, vb, p, PARTS[part])
        scale = exactly(a, b, va, vb, p, PARTS[2]) if part == 1 else expected  # φ̇ may cancel
        assert abs(found - expected) <= 1e-8 * abs(scale)


@pytest.mark.parametrize("weighting", link_field.WEIGHTINGS)
def test_static_part_is_the_static_field_of_whole_skeletons(rng, weighting):
    keys, v, points = rng.normal(size=(4, 3, 3)), rng.normal(size=(4, 3, 3)), rng.normal(size=(5, 3))
    chain, by_length = np.array([[0, 1], [1, 2]]), weighting == "length"
    found = link_terms(keys, v, chain, points, by_length, True)
    np.testing.assert_allclose(found[0], link_field.field(keys, chain, points, weighting), rtol=1e-13)
    fewer = link_terms(keys, v, chain, points, by_length, False)
    np.testing.assert_array_equal(fewer[1], found[1])
    assert not fewer[2].any()
    assert np.isinf(link_terms(keys[:1], v[:1], chain, keys[0, 1:2], False, True)[0]).all(), "on a link"


@pytest.mark.parametrize("by_length", [False, True])
def test_gradients_of_the_parts_are_those_of_finite_differences(by_length):
    for a, b, va, vb, p in cases(80):
        if np.linalg.norm(np.cross(p - a, b - a)) < 1e-2 * np.linalg.norm(b - a):
            continue  # too steep for differences
        if min(np.linalg.norm(v) for v in (va, vb, vb - va, np.cross(va, vb - va))) < 1e-2:
            continue  # |v| has a kink on the link
        state = np.array([[a, b], [va, vb]])

        def value(state, p=p):
            found = link_terms(state[:1], state[1:], LINK, p[None], by_length, True)
            return float(2 * (found[0] + 0.3 * found[1] + 0.5 * found[2])[0, 0])

        found = gradients(state[:1], state[1:], LINK, p[None, None], np.full((1, 1), 2.0), 0.3, 0.5, by_length)[:, 0]
        expected = slopes(value, state, 1e-5)
        np.testing.assert_allclose(found, expected, atol=2e-5 * (1 + abs(expected).max()))


def test_gradients_stay_finite_for_links_that_stand_still_or_do_not_turn():
    keys = np.array([[[0.0, 0, 0], [0.3, 0, 0]]])
    for velocity in (np.zeros(3), np.ones(3)):
        v = np.array([[velocity, velocity]])
        point, weight = np.array([[[0.1, 0.5, 0.2]]]), np.ones((1, 1))
        assert np.isfinite(gradients(keys, v, LINK, point, weight, 0.2, 0.2, False)).all()


# ------------------------------------------------------------------------------------------------- of robots

POINTS = [[0.6, 0.4, 0.5], [-0.5, 0.3, 0.2], [0.1, -0.7, 0.9]]


def states(robot, number, seed=0):
    rng = np.random.default_rng(seed)
    low, high = np.maximum(robot.lower, -2.0), np.minimum(robot.upper, 2.0)
    Q = (low + high) / 2 + 0.4 * (high - low) * rng.uniform(-1, 1, (number, robot.n))
    return Q, rng.normal(size=(number, robot.n))


def test_without_the_isotropic_part_it_is_the_danger_ahead(panda):
    field = DangerField(panda, POINTS[:1], k2=1e-5, gamma=0.0)
    moving = KinetostaticField(field)
    Q, Qd = states(panda, 6)
    np.testing.assert_allclose(moving.values(Q, Qd), field.values(Q + 1e-5 * Qd), rtol=1e-8)


def test_with_gamma_of_one_motion_never_makes_it_less_dangerous(panda):
    fields = [DangerField(panda, POINTS, gamma=gamma) for gamma in (1.0, 0.0)]
    Q, Qd = states(panda, 200)
    with_it, without = (KinetostaticField(field).values(Q, Qd) for field in fields)
    assert (with_it >= fields[0].values(Q)).all()
    assert (without < fields[0].values(Q)).any()


@pytest.mark.parametrize(
    ("name", "gamma", "aggregate"),
    [("panda", 1.0, "max"), ("twin_arm", 0.0, "softmax"), ("slider", 1.0, "mean"), ("kinova", 0.0, "max")],
)
def test_gradients_are_those_of_finite_differences(robot_named, name, gamma, aggregate):
    robot = robot_named(name)
    kind = {"aggregate": aggregate, "gamma": gamma, "k2": 0.3}
    moving = KinetostaticField(DangerField(robot, POINTS, [1.0, 2.0, 0.5], **kind))
    Q, Qd = states(robot, 4, seed=2)
    _, by_q, by_qd = moving.values_and_gradients(Q, Qd)
    for k, (q, qd) in enumerate(zip(Q, Qd, strict=True)):
        expected = slopes(lambda state: moving.value(*state), np.array([q, qd]))
        np.testing.assert_allclose([by_q[k], by_qd[k]], expected, atol=1e-5 * (1 + abs(expected).max()))


def test_one_state_no_points_and_what_is_refused(panda):
    moving = KinetostaticField(DangerField(panda, POINTS, k1=2.0, k2=0.5, gamma=0.5))
    Q, Qd = states(panda, 1)
    assert moving.value(Q[0], Qd[0]) == moving.values(Q, Qd)[0]
    assert "k2=0.5, gamma=0.5" in repr(moving)
    assert KinetostaticField(DangerField(panda, POINTS, k1=2.0)).lead == 0.25
    nothing = KinetostaticField(DangerField(panda, []))
    assert not nothing.values(Q, Qd).any()
    assert not np.concatenate(nothing.gradients(Q, Qd)).any()


@pytest.mark.parametrize("number", [1, 80, 1000])
@pytest.mark.parametrize("weighting", ["unit", "length"])
@pytest.mark.parametrize("gamma", [0.0, 1.0])
def test_the_maximum_is_that_of_all_points_though_few_are_evaluated(panda, number, weighting, gamma):
    rng = np.random.default_rng(3)
    points, weights = rng.uniform(-0.9, 0.9, (number, 3)), rng.choice([0.2, 1.0, 3.0], number)
    kind = {"weighting": weighting, "k1": 2.0, "gamma": gamma}
    moving = KinetostaticField(DangerField(panda, points, weights, **kind))
    Q, Qd = states(panda, 12)
    # A mean over one point takes no bounds.
    alone = [
        KinetostaticField(DangerField(panda, p[None], w[None], aggregate="mean", **kind))
        for p, w in zip(points, weights, strict=True)
    ]
    levels = np.array([one.values(Q, Qd) for one in alone])
    values, *slopes = moving.values_and_gradients(Q, Qd)
    np.testing.assert_allclose(values, levels.max(axis=0), rtol=1e-12)
    np.testing.assert_array_equal(moving.values(Q, Qd), values)
    for b, most in enumerate(levels.argmax(axis=0)):
        expected = alone[most].gradients(Q[[b]], Qd[[b]])
        np.testing.assert_allclose([slope[b] for slope in slopes], np.concatenate(expected), rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("weighting", ["unit", "length"])
def test_a_danger_point_on_a_link_or_at_its_end_is_found_among_many(panda, weighting):
    points = np.random.default_rng(3).uniform(-0.9, 0.9, (80, 3))
    Q, Qd = states(panda, 4)
    for q, qd in zip(Q, Qd, strict=True):
        a, b = panda.keypoints(q)[panda.segments[3]]
        for touching in (a, b, (a + b) / 2):
            field = DangerField(panda, np.vstack([points, touching]), weighting=weighting)
            moving = KinetostaticField(field)
            alone = KinetostaticField(DangerField(panda, [touching], weighting=weighting))
            for rates in (0 * qd, qd):
                assert moving.value(q, rates) >= alone.value(q, rates) * (1 - 1e-12)
            assert moving.value(q, 0 * qd) == pytest.approx(field.value(q), rel=1e-9)


@pytest.mark.parametrize("number", [1, 64, 65, 1025, 5000])
@pytest.mark.parametrize("flat", [1.0, 0.0])
def test_groups_hold_their_points(panda, rng, number, flat):
    points, point_weights = rng.normal(size=(number, 3)) * [1.0, flat, flat], rng.choice([1.0, 2.0], number)
    groups = DangerField(panda, points, point_weights).groups
    places, centres = groups.columns.T[:number], groups.columns.T[number:]
    given, held = (np.column_stack(parts) for parts in ((points, point_weights), (places, groups.point_weights)))
    np.testing.assert_array_equal(held[np.lexsort(held.T)], given[np.lexsort(given.T)])
    assert (groups.begins[0], groups.begins[-1]) == (0, number)
    for g, (begin, end) in enumerate(pairwise(groups.begins)):
        assert 0 < end - begin <= 64
        assert (np.linalg.norm(places[begin:end] - centres[g], axis=1) <= groups.radii[g]).all()
        assert (groups.point_weights[begin:end] <= groups.heaviest[g]).all()
