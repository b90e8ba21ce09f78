"""The parts of the kinetostatic field against quadrature and finite differences."""

from itertools import pairwise

import numpy as np
import pytest
from oracles.numpy_bracket import isotropic_bracket
from scipy.integrate import quad

from safe_ompl.danger import link_field as static_field
from safe_ompl.danger.kinetostatic import gradients, terms
from safe_ompl.danger.link_field import Segments

LINK = Segments([[0, 1]])


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
        found = terms(np.array([[a, b]]), np.array([[va, vb]]), LINK, p[None])[part][0, 0]
        expected = exactly(a, b, va, vb, p, PARTS[part])
        scale = exactly(a, b, va, vb, p, PARTS[2]) if part == 1 else expected  # φ̇ may cancel
        assert abs(found - expected) <= 1e-8 * abs(scale)


def test_static_part_is_the_static_field_of_whole_skeletons_with_both_weightings():
    rng = np.random.default_rng(1)
    keys, v, points = rng.normal(size=(4, 3, 3)), rng.normal(size=(4, 3, 3)), rng.normal(size=(5, 3))
    chain = Segments([[0, 1], [1, 2]])
    for weighting in ("unit", "length"):
        found = terms(keys, v, chain, points, weighting=weighting)
        np.testing.assert_allclose(
            found.static, static_field.field(keys, chain, points, weighting=weighting), rtol=1e-13
        )
        both = terms(keys, v, chain, np.broadcast_to(points, (4, 5, 3)), weighting=weighting, isotropic=False)
        np.testing.assert_array_equal(both.directional, found.directional)
        assert not both.isotropic.any()


def test_a_point_on_the_link_is_infinitely_in_danger():
    found = terms(np.array([[[0, 0, 0], [1.0, 0, 0]]]), np.ones((1, 2, 3)), LINK, np.array([[0.5, 0, 0]]))
    assert np.isinf(found.static).all()


def test_gradients_are_those_of_finite_differences():
    step = 1e-5
    for weighting in ("unit", "length"):
        for a, b, va, vb, p in cases(80):
            if np.linalg.norm(np.cross(p - a, b - a)) < 1e-2 * np.linalg.norm(b - a):
                continue  # too steep for differences
            if np.linalg.norm(vb - va) < 1e-2 or min(np.linalg.norm(v) for v in (va, vb)) < 1e-2:
                continue
            if np.linalg.norm(np.cross(va, vb - va)) < 1e-2:
                continue  # |v| has a kink on the link
            state = np.array([[a, b], [va, vb]])

            def value(state, p=p, weighting=weighting):
                found = terms(state[:1], state[1:], LINK, p[None], weighting=weighting)
                return float(2 * (found[0] + 0.3 * found[1] + 0.5 * found[2])[0, 0])

            by_place, by_velocity = gradients(
                state[:1], state[1:], LINK, p[None], np.full((1, 1), 2.0), (0.3, 0.5), weighting=weighting
            )
            found = np.array([by_place[0], by_velocity[0]])
            expected = np.empty_like(state)
            for at in np.ndindex(state.shape):
                aside = state.copy()
                aside[at] += step
                back = state.copy()
                back[at] -= step
                expected[at] = (value(aside) - value(back)) / (2 * step)
            np.testing.assert_allclose(found, expected, atol=2e-5 * (1 + abs(expected).max()))


def test_gradients_stay_finite_for_links_that_stand_still_or_do_not_turn():
    keys = np.array([[[0.0, 0, 0], [0.3, 0, 0]]])
    for velocity in (np.zeros(3), np.ones(3)):
        v = np.array([[velocity, velocity]])
        parts = gradients(keys, v, LINK, np.array([[0.1, 0.5, 0.2]]), np.ones((1, 1)), (0.2, 0.2))
        assert np.isfinite(parts).all()


def test_the_bracket_holds_the_isotropic_part():
    ratios = []
    for a, b, va, vb, p in cases(160):
        state = np.array([[a, b]]), np.array([[va, vb]])
        value = terms(*state, LINK, p[None]).isotropic[0, 0]
        lower, upper = isotropic_bracket(*state, LINK, p[None])
        assert lower[0, 0, 0] <= value * (1 + 1e-8)
        assert upper[0, 0, 0] >= value * (1 - 1e-8)
        ratios.append(upper[0, 0, 0] / value)
    assert np.median(ratios) < 1.1
