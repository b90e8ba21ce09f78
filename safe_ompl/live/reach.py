"""Reach models: where a body that was measured may be some time later, as sets that proofs can take.

A proof sees whatever moves as a set for each of its bodies: a hull of points that grows with the time τ since the
measurement,

    {points}, grown by radius + g₀ + g₁τ,  g₁ ≥ 0.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from safe_ompl.common import FloatArray, IntArray


class ReachViolation(NamedTuple):
    """A body that moved farther than was promised."""

    # The person or object, and its limb. The limb of an object is empty.
    who: str
    limb: str
    # How far the limb was beyond what its reach allows [m].
    excess: float

    def __str__(self) -> str:
        limb = f" ({self.limb})" if self.limb else ""
        return f"{self.who!r}{limb} moved {1e3 * self.excess:.0f} mm farther than promised"


@dataclass(frozen=True)
class ReachSets:
    """Sets that M bodies do not leave; a body is a limb of a person, or a part of an object."""

    # The person or object and the limb that each of the M bodies is; the limb of an object is empty
    names: tuple[tuple[str, str], ...]
    # The points of all bodies, one body after the other (P, 3) [m].
    points: FloatArray
    # Where the points of each body begin (M + 1,).
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
        """Return no sets, of no bodies."""
        return cls((), np.zeros((0, 3)), np.zeros(1, dtype=np.intp), np.zeros(0), np.zeros((0, 2)))

    @classmethod
    def of(
        cls, names: tuple[tuple[str, str], ...], points: FloatArray, radii: FloatArray, growth: FloatArray
    ) -> ReachSets:
        """Return the sets of M bodies with as many `points: (M, K, 3)` each, growth (M, 2)."""
        first: IntArray = points.shape[1] * np.arange(len(points) + 1)
        return cls(names, np.ascontiguousarray(points.reshape(-1, 3)), first, radii, growth)

    def beside(self, other: ReachSets) -> ReachSets:
        """Return the sets of these bodies and of others."""
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
        """Return the growth (M,) of the sets after a time [s], without the radii [m]."""
        return np.asarray(self.growth[:, 0] + time * self.growth[:, 1])

    def excess(self, ends: Sequence[FloatArray] | FloatArray, time: float) -> FloatArray:
        """Return for each body how far (M,) its points are beyond its set after a time, at most; ≤ 0: it obeyed.

        Its points, as many as it has in its set, are `ends` then [m]; the time [s] is since the sets were measured.
        """
        away = np.linalg.norm(np.concatenate([np.zeros((0, 3)), *ends]) - self.points, axis=1)
        farthest = np.maximum.reduceat(away, self.first[:-1]) if self.names else np.zeros(0)
        return np.asarray(farthest - self.grown(time))
