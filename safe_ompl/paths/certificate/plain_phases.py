"""A time law of constant jerk in each of its phases, as a certificate claims it, evaluated by plain means."""

from __future__ import annotations

from collections.abc import Sequence
from math import isfinite
from typing import Any, NamedTuple

import numpy as np

from safe_ompl.arrays import FloatArray, IntArray
from safe_ompl.errors import CertificateError

_SAME = 1e-9  # [rad], [rad/s] and, a thousand times this, [rad/s²]
_HALVINGS = 60


class _State(NamedTuple):
    s: float
    rate: float
    push: float

    def after(self, time: float, jerk: float) -> _State:
        """Return the state a time later."""
        return _State(
            self.s + self.rate * time + self.push * time**2 / 2 + jerk * time**3 / 6,
            self.rate + self.push * time + jerk * time**2 / 2,
            self.push + jerk * time,
        )


class PlainPhases:
    """Where on its curve the robot is when; from rest to rest.

    Parameters
    ----------
    claim : sequence of [float, float]
        Duration [s] and s⃛ [rad/s³] of each phase.
    length : float
        Of the curve [rad].

    Raises
    ------
    CertificateError
        If it is no such law; if ṡ both rises and falls in a phase.
    """

    def __init__(self, claim: Sequence[Any], length: float) -> None:
        state, self._begins, self._claim = _State(0.0, 0.0, 0.0), list[_State](), list[tuple[float, float]]()
        for duration, jerk in ((float(d), float(j)) for d, j in claim):
            if not (isfinite(jerk) and 0 < duration < np.inf):
                raise CertificateError("trajectory: a phase lasts no time, or has no jerk that is a number")
            after = state.after(duration, jerk)
            if min(state.push, after.push) < -1e3 * _SAME and max(state.push, after.push) > 1e3 * _SAME:
                raise CertificateError("trajectory: the speed both rises and falls in a phase")
            if after.rate < -_SAME:
                raise CertificateError("trajectory: it moves backwards in a phase")
            self._begins.append(state)
            self._claim.append((duration, jerk))
            state = after
        if abs(state.s - length) > _SAME or abs(state.rate) > _SAME or abs(state.push) > 1e3 * _SAME:
            raise CertificateError("trajectory: its phases do not end at rest where the curve does")
        self.end = state
        self.starts: FloatArray = np.array([begin.s for begin in self._begins])
        self.duration = sum(duration for duration, _ in self._claim)

    def squares(self, edges: FloatArray) -> FloatArray:
        """Return ṡ² (C + 1,) at grid points, all starts of phases among them; by bisection, for s grows with time."""
        for start in self.starts.tolist():
            if np.abs(edges - start).min() > _SAME:
                raise CertificateError(
                    f"trajectory: a phase begins at {start:.6f} rad, which is no grid point"
                )
        found = [self.rate(float(s)) ** 2 for s in edges]
        for j in (0, -1):
            found[j] = 0.0
        return np.array(found)

    def rate(self, s: float) -> float:
        """Return ṡ at an arc length [rad]."""
        near = np.abs(self.starts - s).argmin()
        if abs(self.starts[near] - s) <= 1e-3 * _SAME:
            rate = self._begins[near].rate
            return rate if rate > _SAME else 0.0
        k = max(int(np.searchsorted(self.starts, s, side="right")) - 1, 0)
        duration, jerk = self._claim[k]
        early, late = 0.0, duration
        for _ in range(_HALVINGS):
            middle = (early + late) / 2
            early, late = (middle, late) if self._begins[k].after(middle, jerk).s <= s else (early, middle)
        return max(self._begins[k].after(late, jerk).rate, 0.0)

    def of(self, edges: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return for each cell (C,) the least and the largest s̈ of its phase, and |s⃛|."""
        middles = (edges[1:] + edges[:-1]) / 2
        which: IntArray = np.maximum(np.searchsorted(self.starts, middles, side="right") - 1, 0)
        begin = np.array([state.push for state in self._begins])
        end = np.append(begin[1:], self.end.push)
        jerks = np.abs([jerk for _, jerk in self._claim])
        return np.minimum(begin, end)[which], np.maximum(begin, end)[which], jerks[which]
