"""Rotations: logarithms, half turns, and turns between directions, at 0 and π and as near to both as numbers go."""

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import example, given, strategies as st

from safe_ompl.geometry import rotation_vectors, turn_between, turn_onto

NEAR = (0.0, 1e-16, 1e-15, 1e-13, 1e-12, 1e-10, 1e-9, 1e-8, 1e-6, 1e-3)
ANGLES = st.one_of(st.sampled_from([*NEAR, *(np.pi - d for d in NEAR)]), st.floats(0.0, np.pi))


@st.composite
def directions(draw):
    """Draw a unit vector: an axis, a diagonal, almost one of them, or any."""
    part = st.one_of(st.sampled_from([0.0, 1.0, -1.0, 1e-9, -1e-9]), st.floats(-1.0, 1.0))
    vector = np.array([draw(part) for _ in range(3)])
    length = np.linalg.norm(vector)
    return vector / length if length > 1e-3 else np.array([0.0, 0.0, 1.0])


@given(directions(), ANGLES, directions(), ANGLES)
@example(np.array([0.0, 0.0, 1.0]), np.pi, np.array([1.0, 0.0, 0.0]), 0.0)
def test_logarithms_are_those_of_pinocchio(axis, angle, other, more):
    rotation = pin.exp3(angle * axis) @ pin.exp3(more * other)
    (found,) = rotation_vectors(rotation[None])
    expected = pin.log3(rotation)
    half_turn = np.linalg.norm(expected) > np.pi - 1e-9
    assert min(np.linalg.norm(found - expected), np.linalg.norm(found + expected) if half_turn else 9.0) < 3e-10
    assert np.abs(pin.exp3(found) - rotation).max() < 2e-11  # Pinocchio's own error 0.01 rad from π
    assert np.linalg.norm(found) < np.pi + 2e-10


@given(directions(), st.sampled_from(NEAR[:5]))
def test_rounding_does_not_choose_the_direction_of_a_half_turn(axis, short):
    rotations = np.array([pin.exp3((np.pi - short) * axis), pin.exp3((np.pi - short) * axis).T])
    for start in (np.eye(3), pin.exp3(np.array([0.3, -1.2, 2.0])), pin.exp3(np.array([-0.1, 0.7, 1.1]))):
        one, other = (turn_between(start, rotation @ start) for rotation in rotations)
        np.testing.assert_allclose(one, other, atol=1e-9)
        assert one[np.abs(one) > 0.32][0] > 0


@given(directions(), directions(), st.sampled_from((0.0, 1e-9, 1e-7, 1.5e-6, 2e-6, 1e-5, 1e-4, 0.3, 2.0, 3.0)))
def test_turns_onto_directions_are_exact_and_the_shortest(start, across, away):
    sideways = np.cross(start, across)
    if np.linalg.norm(sideways) < 1e-3:
        sideways = np.cross(start, np.eye(3)[np.abs(start).argmin()])
    sideways /= np.linalg.norm(sideways)
    end = -np.cos(away) * start + np.sin(away) * sideways
    turn = turn_onto(start, 3.0 * end)
    np.testing.assert_allclose(turn @ start, end, atol=1e-14)
    np.testing.assert_allclose(turn @ turn.T, np.eye(3), atol=1e-14)
    assert np.linalg.norm(pin.log3(turn)) == pytest.approx(np.pi - away, abs=1e-7)
