"""Stops beside people of a motion that is driven as it is, from any instant on (`docs/mathematics.md` §9).

The parameter σ of such a curve is its time, x = σ̇². If x would be y < 0 at the end of a cell of size h, the stop ends
within it, after 2h√x/(x − y). Where the motion itself accelerates more than the limit x stays as it is, and the stop
accelerates no more than the motion. A stop also ends where the motion is at rest; nothing is asked there.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from safe_ompl.common import FloatArray, IntArray
from safe_ompl.motions.caps import harmless_rates, next_stops
from safe_ompl.motions.cells import BodySpeeds, Cells, divided_edges
from safe_ompl.motions.laws import braking_squares, time_left
from safe_ompl.motions.limits import RATE_TOLERANCE, RateLimits
from safe_ompl.motions.motion import Motion
from safe_ompl.motions.separation import PeopleDistances, SeparationBounds
from safe_ompl.motions.time_law import TimeLaw

_ROUNDS = 6  # of dividing cells
_MOST = 8  # parts of a cell in one round
_ROUGH = 0.01  # share of the time of a stop by which it might be shorter in finer cells
_NEARLY = 0.9  # of the speed that is harmless
_FINEST = 1e-4  # [s] No cell is divided into smaller ones.


@dataclass(frozen=True)
class Stops:
    """How a motion stops from any instant on, and what is left then before people are there; made by `stops_beside`.

    The `cells` of the motion, as fine as it takes, have edges in its own time; stops keep to `accelerations: (n,)`. All
    stops that begin in a cell are over by `left: (N,)` [s] sooner than somebody may be there; negative: not proven. The
    `limb` that is there first would be met in cell `where`. If cells were finer about `loss` more might be left [s].
    """

    cells: Cells
    accelerations: FloatArray
    left: FloatArray
    limb: IntArray
    where: IntArray
    loss: FloatArray
    separation: SeparationBounds
    distances: PeopleDistances

    def __repr__(self) -> str:
        return f"Stops({len(self.cells)} cells, {self.left.min():.3g} s left)"

    def met(self, cell: int) -> tuple[str, tuple[str, str], float]:
        """Return what stops that begin in a cell have least left to: link, person and limb, and how much [m]."""
        k, m = int(self.where[cell]), int(self.limb[cell])
        bounds, distances, people = self.separation, self.distances, self.distances.people
        time = float(bounds.times[k, m])  # infinite of limbs at rest
        since = people.reaction_time + (time - float(self.left[cell]) if np.isfinite(time) else 0.0)
        room = bounds.distances[k, m] - people.clearance - distances.grown(m, since)
        return distances.links[int(bounds.nearest[k, m])], distances.limbs[m], float(room)

    def stop_from(self, time: float) -> TimeLaw:
        """Return the stop that begins at a time [s] of the motion: which time of the motion it is at when."""
        edges = self.cells.edges
        begin = float(np.clip(time, edges[0], edges[-1]))
        j = int(np.clip(np.searchsorted(edges, begin, side="right") - 1, 0, len(self.cells) - 1))
        end = int(next_stops(self.cells)[j])
        squares = braking_squares(j + 1, end, self.cells.sizes, self.cells.boxes, self.accelerations)
        at = edges[j + 1 : j + 1 + len(squares)].copy()
        if squares[-1] < 0.0:
            at[-1] -= np.diff(at[-2:])[0] * squares[-1] / (squares[-1] - squares[-2])
            squares[-1] = 0.0
        return TimeLaw.through(np.append(begin, at), np.append(1.0, squares))


def stops_beside(
    motion: Motion, cells: Cells, bodies: BodySpeeds, limits: RateLimits, distances: PeopleDistances
) -> Stops:
    """Return how a motion, which ends at rest, stops beside people, and what is left; see the module."""
    accelerations = limits.acceleration
    for rounds_left in reversed(range(_ROUNDS + 1)):
        braked, ends = (cells.sizes, cells.boxes, accelerations), next_stops(cells)
        none = np.empty((len(cells), 0))
        spans = time_left(*braked, ends, none, none)[-1]
        speeds, soon = bodies.bounds(motion, cells), float(spans.max())
        found = distances.along(motion, cells, speeds, soon, soon)
        still = np.asarray((cells.slopes <= RATE_TOLERANCE[1]).all(axis=1))
        times = np.where(still[:, None], np.inf, found.times)
        harmless, _ = harmless_rates(motion, cells, speeds, distances)
        left, limb, where, entries, _ = time_left(*braked, ends, times, harmless)
        moved, speed = speeds[where, found.nearest[where, limb]] * cells.sizes[where] / 2, distances.speeds[limb]
        lost = np.divide(moved, speed, out=np.zeros(len(cells)), where=speed > 0)
        loss = np.where(limb < 0, 0.0, lost + cells.sizes + 2 * cells.sizes[where]) + _ROUGH * spans
        slow = harmless[where, limb] > _NEARLY * entries
        loss = np.where(slow & (left < 0), np.maximum(loss, -2 * left), loss)  # finer cells bound speeds better
        parts = _parts(cells, left, where, loss)
        if not rounds_left or (parts == 1).all() or (left + loss < 0).any():  # finer cells would not help everywhere
            return Stops(cells, accelerations, left, limb, where, loss, found, distances)
        cells = motion.between(divided_edges(cells.edges, parts))
    raise AssertionError


def _parts(cells: Cells, left: FloatArray, where: IntArray, loss: FloatArray) -> IntArray:
    """Return into how many parts (N,) to divide cells so that stops might be proven that are not."""
    parts: IntArray = np.ones(len(cells), dtype=np.intp)
    for j in np.flatnonzero((left < 0) & (left + loss > 0)):
        k, wanted = where[j], np.clip(np.ceil(loss[j] / (left[j] + loss[j])), 2, _MOST)
        parts[j : k + 1] = np.maximum(parts[j : k + 1], 2)
        parts[[j, k]] = np.maximum(parts[[j, k]], wanted)
    most = np.maximum(cells.sizes / _FINEST, 1.0).astype(np.intp)
    return np.asarray(np.minimum(parts, most))
