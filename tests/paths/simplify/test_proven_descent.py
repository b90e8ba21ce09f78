"""Rounds of the descent: when one ends."""

from types import SimpleNamespace

import numpy as np
import pytest

from safe_ompl.paths.descent import ProvenDescent, _shortened


class Falling:
    """A descent whose cost falls by given shares, step by step."""

    def __init__(self, shares):
        self.value, self.steps, self._shares = 100.0, 0, list(shares)

    def step(self, largest):
        if self.steps == len(self._shares):
            return False
        self.value *= 1.0 - self._shares[self.steps]
        self.steps += 1
        return True


@pytest.mark.parametrize(
    ("shares", "steps", "settled"),
    [
        ([0.1] * 12, 10, False),  # no more than it may take
        ([0.1, 0.0001, 0.1, 0.0001, 0.1], 5, True),  # kinks between steps that gain; then none is found
        ([0.1, 0.0001, 0.0001, 0.1], 3, True),
        ([], 0, True),
    ],
)
def test_a_round_ends_with_two_idle_steps_in_a_row(shares, steps, settled):
    descent = ProvenDescent.__new__(ProvenDescent)
    descent._stop, descent._terms = lambda: False, SimpleNamespace(precision=0.03)
    falling = Falling(shares)
    assert descent._step(falling, 0.4, 10) is settled
    assert falling.steps == steps


def test_a_step_that_fails_is_shortened_to_where_the_parabola_has_its_minimum():
    slope, bend = -3.0, 8.0  # of −3 t + 8 t², whose minimum is at 3/16
    assert _shortened(slope, slope + bend) == pytest.approx(3 / 16)
    assert _shortened(-1.0, 0.0) == 0.5
    for far in (1e6, np.inf, np.nan):
        assert _shortened(-1.0, far) == 0.1
