"""Reach sets: the sets that a measured body cannot leave within a time, in the form that proofs use.

The reach set of a body is a convex hull of points that grows with the time τ since the measurement:

    hull of points, grown by radius + g₀ + g₁τ,  g₁ ≥ 0.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from safe_ompl.common import FloatArray, IntArray


class ReachViolation(NamedTuple):
    """A body that left its reach set."""

    # Names of the person or object and of the limb; the limb of an object is empty.
    who: str
    limb: str
    # The distance of the limb outside its reach set [m].
    excess: float

    def __str__(self) -> str:
        limb = f" ({self.limb})" if self.limb else ""
        return f"{self.who!r}{limb} moved {1e3 * self.excess:.0f} mm farther than promised"


@dataclass(frozen=True)
class ReachSets:
    """Reach sets of M bodies; a body is a limb of a person, or a part of an object."""

    # For each of the M bodies the names of the person or object and of the limb; the limb of an object is empty.
    names: tuple[tuple[str, str], ...]
    # The points of all bodies, one body after the other (P, 3) [m].
    points: FloatArray
    # The index of the first point of each body, and the number of points (M + 1,).
    first: IntArray
    # The radii of the bodies about their points (M,) [m].
    radii: FloatArray
    # The growth g₀ [m] and its rate g₁ [m/s] of each body (M, 2).
    growth: FloatArray

    @property
    def arrays(self) -> tuple[FloatArray, IntArray, FloatArray, FloatArray]:
        """All arrays, as `safe_ompl.live.replanning.hull_gaps` takes them."""
        return self.points, self.first, self.radii, self.growth

    @classmethod
    def none(cls) -> ReachSets:
        """Return the reach sets of zero bodies."""
        return cls((), np.zeros((0, 3)), np.zeros(1, dtype=np.intp), np.zeros(0), np.zeros((0, 2)))

    @classmethod
    def of(
        cls, names: tuple[tuple[str, str], ...], points: FloatArray, radii: FloatArray, growth: FloatArray
    ) -> ReachSets:
        """Return the sets of M bodies with K points each: points (M, K, 3), radii (M,), growth (M, 2)."""
        first: IntArray = points.shape[1] * np.arange(len(points) + 1)
        return cls(names, np.ascontiguousarray(points.reshape(-1, 3)), first, radii, growth)

    def beside(self, other: ReachSets) -> ReachSets:
        """Return the sets of these bodies, followed by those of `other`."""
        if not self.names:
            return other
        return ReachSets(
            self.names + other.names,
            np.concatenate([self.points, other.points]),
            np.concatenate([self.first[:-1], len(self.points) + other.first]),
            np.concatenate([self.radii, other.radii]),
            np.concatenate([self.growth, other.growth]),
        )

    def grown(self, time: float) -> FloatArray:
        """Return the growth g₀ + g₁τ (M,) [m] of the sets after a time τ [s]."""
        return np.asarray(self.growth[:, 0] + time * self.growth[:, 1])

    def excess(self, ends: Sequence[FloatArray] | FloatArray, time: float) -> FloatArray:
        """Return for each body the largest excess (M,) [m] of its points' motion over the growth of its set.

        A value ≤ 0 means that the body stayed in its set. `ends` are the points of the bodies [m] at a time [s] after
        the measurement of the sets, as many as each set has.
        """
        away = np.linalg.norm(np.concatenate([np.zeros((0, 3)), *ends]) - self.points, axis=1)
        farthest = np.maximum.reduceat(away, self.first[:-1]) if self.names else np.zeros(0)
        return np.asarray(farthest - self.grown(time))
