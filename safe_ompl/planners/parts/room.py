"""How much room a robot has at configurations that are asked about again and again."""

from __future__ import annotations

from math import inf, isfinite

import numpy as np

from safe_ompl.arrays import FloatArray
from safe_ompl.collision.motion import CertifiedMotion
from safe_ompl.collision.pairs import PairSet


class Room:
    """Lower bounds of what a robot keeps from obstacles, computed once for each configuration.

    The first margin that is asked for should be the largest: bounds are no better than they need be for it.
    """

    def __init__(self) -> None:
        # Pairs, their revision, and how good bounds are [m].
        self._source: tuple[PairSet, int, float] | None = None
        self._bounds: dict[bytes, float] = {}

    def is_enough(self, motion: CertifiedMotion, q: FloatArray, margin: float) -> bool:
        """Return whether the robot is proven to keep a margin [m] from obstacles at `q: (n,)`."""
        bound = self._bound(motion.checker.pairs, q, margin)
        return bound >= margin if isfinite(bound) else motion.is_free(q, q, margin)

    def _bound(self, pairs: PairSet, q: FloatArray, enough: float) -> float:
        known = self._source
        if known is None or known[:2] != (pairs, pairs.revision) or known[2] < enough:
            self._source, self._bounds = (pairs, pairs.revision, enough), {}
        key = q.tobytes()
        if key not in self._bounds:
            bounds = pairs.bounds.of(q[None], np.flatnonzero(pairs.meets_obstacle), enough)
            self._bounds[key] = float(bounds.min(initial=inf))
        return self._bounds[key]
