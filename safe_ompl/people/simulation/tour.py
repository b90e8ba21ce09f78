"""Tours: places that a robot visits in whichever order is soonest."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from itertools import combinations

import numpy as np

from safe_ompl.common import FloatArray
from safe_ompl.people.replanning import Replanner
from safe_ompl.trajectories import Trajectory


class Tour:
    """Places that a robot visits in any order, each once in a round: next the one where it is expected to be soonest.

    `ways` has a trajectory from each of the K ≥ 2 places to each other one, by their numbers; it begins at place 0.
    """

    def __init__(self, ways: Mapping[tuple[int, int], Trajectory]) -> None:
        self.ways = ways
        begins = {i: way.curve.at(np.zeros(1)).q[0] for (i, _), way in ways.items()}
        self.places: FloatArray = np.array([begins[k] for k in sorted(begins)])
        self._left: set[int] = set()  # of this round

    @classmethod
    def between(
        cls, places: Sequence[FloatArray], to_and_fro: Callable[[FloatArray, FloatArray], Sequence[Trajectory]]
    ) -> Tour:
        """Return the tour of some places, each (n,); the function returns the ways between two of them."""
        ways: dict[tuple[int, int], Trajectory] = {}
        for i, k in combinations(range(len(places)), 2):
            ways[i, k], ways[k, i] = to_and_fro(places[i], places[k])
        return cls(ways)

    def start(self, replanner: Replanner, q: FloatArray) -> None:
        """Start for one of the places that are left, from the one at `q: (n,)`; detours may lead to another of them."""
        here = int(np.abs(self.places - q).max(axis=1).argmin())
        self._left = self._left - {here} or {*range(len(self.places))} - {here}
        order = sorted(self._left)
        ways = [self.ways[here, k] for k in order]
        first = replanner.soonest(ways)
        replanner.start(ways[first], [self.places[k] for k in order if k != order[first]])
