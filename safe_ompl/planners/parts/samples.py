"""The random samples of a roadmap: uniform ones, and those that lead out of a graph that is stuck."""

from __future__ import annotations

import numpy as np

from safe_ompl.arrays import FloatArray
from safe_ompl.plugins.states import StateBridge

_GROWTH = 0.25  # by this share of itself the sample set grows when it does not suffice …
_LARGEST_GROWTH = 500  # … but by no more milestones at a time, …
_TOWARDS_SHARE = 0.8  # … of which this share grows out of the graph that is stuck, …
_NEAREST_TO_GRAPH = 0.05  # … from this fraction of the way to a random configuration on.
_LARGEST_FRINGE = 1000  # milestones of a stuck graph that it grows out of


class Samples:
    """Draws the milestones of a roadmap.

    Parameters
    ----------
    bridge : StateBridge
        The space.
    """

    def __init__(self, bridge: StateBridge) -> None:
        self._bridge = bridge

    def uniform(self, count: int, rng: np.random.Generator) -> FloatArray:
        """Return uniform random configurations (count, n)."""
        return self._bridge.between_bounds(rng.random((count, self._bridge.n)))

    def more(self, size: int, stuck: FloatArray, rng: np.random.Generator) -> FloatArray:
        """Return configurations (B, n) to enlarge a sample set of `size` that does not suffice.

        Some are uniform; most lie around the configurations `stuck: (N, n)`, which a search cannot go on from.
        """
        count = min(_LARGEST_GROWTH, 1 + int(_GROWTH * size))
        outwards = round(_TOWARDS_SHARE * count) if len(stuck) else 0
        rows = [self._outwards(stuck, outwards, rng)] if outwards else []
        if count > outwards:
            rows.append(self.uniform(count - outwards, rng))
        return np.concatenate(rows)

    def _outwards(self, fringe: FloatArray, count: int, rng: np.random.Generator) -> FloatArray:
        """Return configurations (count, n) between a fringe (N, n) and random ones, from the nearest of it on."""
        if len(fringe) > _LARGEST_FRINGE:
            fringe = fringe[rng.choice(len(fringe), _LARGEST_FRINGE, replace=False)]
        deltas = [self._bridge.difference(fringe, target) for target in self.uniform(count, rng)]
        nearest = [int(np.einsum("ij,ij->i", delta, delta).argmin()) for delta in deltas]
        steps = np.array([delta[k] for delta, k in zip(deltas, nearest, strict=True)])
        fractions = _NEAREST_TO_GRAPH ** rng.random((count, 1))
        return self._bridge.wrapped(fringe[nearest] + fractions * steps)
