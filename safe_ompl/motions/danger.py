"""Danger of a moving robot along a curve.

The module computes bounds over cells, the speed limit that keeps the danger below a limit, and the danger of a timed
motion.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from safe_ompl.common import FloatArray, IntArray
from safe_ompl.danger import CellMotions, KinetostaticField, cell_bounds
from safe_ompl.motions.bodies import acceleration_bounds
from safe_ompl.motions.cells import Cells, divided_edges
from safe_ompl.motions.motion import Motion
from safe_ompl.motions.time_law import TimeLaw
from safe_ompl.robot import plain

# Steps of the bisection for the largest speed. 50 halvings reach double precision.
_BISECTION_STEPS = 50
# For a velocity limit, a cell is divided if its length lowers the limit by more than this share. `_MAX_DIVISIONS` is
# the largest number of rounds of division. Parts are not shorter than `_LEAST_CELL`.
_SPEED_LOSS = 0.02
_MAX_DIVISIONS = 3
_LEAST_CELL = 1e-3  # [rad]
# For a proven peak, cells are divided into `_PARTS` each, in at most `_PEAK_DIVISIONS` rounds. Division ends when the
# bound is at most `_TIGHT_PEAK` times the sampled peak.
_PEAK_DIVISIONS = 8
_TIGHT_PEAK = 1.02
_PARTS = 3


class CellDanger(NamedTuple):
    """Upper bounds of the danger over N cells at M danger points: level + ṡ·increase, (N, M).

    The weights of the danger points are not included.
    """

    field: KinetostaticField
    levels: FloatArray
    increases: FloatArray

    def at(self, rates: FloatArray) -> FloatArray:
        """Return upper bounds (N,) of the danger at path velocities ṡ `rates: (N,)`."""
        # The product 0·∞ occurs where a danger point may be touched. The result NaN is replaced by infinity.
        with np.errstate(invalid="ignore"):
            fields = self.levels + rates[:, None] * self.increases
        return self.field.field.aggregated(np.where(np.isnan(fields), np.inf, fields))

    def allowed(self, limit: float, most: FloatArray) -> FloatArray:
        """Return the largest ṡ (N,) ≤ `most` at which the danger is proven to stay within `limit`.

        The result is −1 where even the danger at rest exceeds the limit. The bound is convex in ṡ: if the limit holds
        at rest and at one speed, the limit holds at all speeds between.
        """
        if self.field.field.aggregate == "max":
            weights = self.field.field.weights
            share = limit if weights is None else limit / weights
            with np.errstate(divide="ignore", invalid="ignore"):
                speeds = np.where(self.increases > 0, (share - self.levels) / self.increases, np.inf)
            found = np.minimum(most, speeds.min(axis=1, initial=np.inf))
        else:
            found, bad = np.where(self.at(most) <= limit, most, 0.0), most
            for _ in range(_BISECTION_STEPS):
                middle = (found + bad) / 2
                holds = self.at(middle) <= limit
                found, bad = np.where(holds, middle, found), np.where(holds, bad, middle)
        return np.where(self.at(np.zeros(len(most))) <= limit, found, -1.0)


def cell_danger(
    moving: KinetostaticField,
    motion: Motion,
    cells: Cells,
    rows: IntArray,
    rates: FloatArray,
    enough: float,
    within: bool = True,
) -> CellDanger:
    """Bound the danger over cells (N,) of a motion for path velocities ṡ ≤ `rates: (N,)`.

    With `within=False` the danger is bounded only at the centres of the cells. If the danger is the maximum over danger
    points, a cheaper, looser bound is used for points that are proven to stay below `enough`.
    """
    halves = cells.sizes[rows] / 2 * within
    field = moving.field
    robot, points = field.robot, field.points
    place = motion.places(cells.centres[rows])
    keypoints, velocities, _ = robot.keypoint_motions(place.q, place.dq_ds)
    dq_ds, d2q_ds2 = (plain(robot.coupling.reach(bound)) for bound in (cells.dq_ds[rows], cells.d2q_ds2[rows]))
    sliding = robot.joint_prismatic
    turned = robot.joint_keypoint_support & ~sliding
    accelerations = acceleration_bounds(plain(robot.bounds.joint_keypoint_radii), turned, dq_ds, d2q_ds2)
    speeds = np.linalg.norm(velocities, axis=2) + halves[:, None] * accelerations
    weights = np.ones(len(points)) if field.weights is None else field.weights
    field.count(len(keypoints), len(points))
    strokes = dq_ds[:, sliding].sum(axis=1)
    moved = CellMotions(
        np.ascontiguousarray(keypoints),
        np.ascontiguousarray(velocities),
        speeds,
        accelerations,
        halves,
        strokes,
        moving.lead * rates,
    )
    enoughs = (enough if field.aggregate == "max" else -np.inf) / (field.k1 * weights)
    by_length = field.weighting == "length"
    level, increase = cell_bounds(moved, field.links, plain(points), moving.gamma, by_length, enoughs)
    return CellDanger(moving, field.k1 * level, moving.k2 * increase)


def danger_velocity_limit(
    motion: Motion, cells: Cells, danger: KinetostaticField, limit: float, most: FloatArray
) -> tuple[Cells, IntArray, FloatArray]:
    """Return the largest path velocities ≤ `most: (N,)` at which the danger of the moving robot stays within `limit`.

    Along a curve the danger is φ + ṡ (φ′ + γI) k₂/k₁, with φ′ = dφ/ds and γ, I, k₁, k₂ of `KinetostaticField`. A cell
    is divided if it limits the velocity and shorter cells would raise the limit noticeably. Returns the divided cells,
    the index of the given cell that contains each, and the largest ṡ in each: −1 where the danger at rest exceeds the
    limit.
    """

    def velocity_limits(rows: IntArray, *, within: bool = True) -> FloatArray:
        at_most = most[parents[rows]]
        return cell_danger(danger, motion, cells, rows, at_most, limit, within).allowed(limit, at_most)

    parents: IntArray = np.arange(len(cells))
    speeds, exact = velocity_limits(parents), most.copy()
    new = np.ones(len(cells), dtype=bool)
    for _ in range(_MAX_DIVISIONS):
        rows = np.flatnonzero(new & (speeds < most[parents]))
        exact[rows] = velocity_limits(rows, within=False)
        loss = 1 - np.maximum(speeds, 0) / np.maximum(exact, 1e-12)
        wanted = np.minimum(np.ceil(loss / _SPEED_LOSS), np.ceil(cells.sizes / _LEAST_CELL))
        parts: IntArray = np.where(exact > 0, np.maximum(wanted, 1), 1).astype(np.intp)
        if (parts == 1).all():
            break
        of = np.repeat(np.arange(len(cells)), parts)
        cells = motion.between(divided_edges(cells.edges, parts))
        parents, speeds, exact, new = parents[of], speeds[of], exact[of], parts[of] > 1
        divided = np.flatnonzero(new)
        speeds[divided] = velocity_limits(divided)
        exact[divided] = most[parents[divided]]
    return cells, parents, speeds


@dataclass(frozen=True)
class MotionDanger:
    """The kinetostatic danger of a timed motion: samples at times (T,) [s], their mean and peak, and a proven bound.

    The unit of the danger is k₁/m, or k₁ if links are weighted by length.
    """

    times: FloatArray
    values: FloatArray
    mean: float
    peak: float
    proven_peak: float


def motion_danger(motion: Motion, law: TimeLaw, field: KinetostaticField) -> MotionDanger:
    """Compute the danger of a robot that follows a motion with a time law."""
    cells = motion.between(law.edges)
    middles = (law.times[1:] + law.times[:-1]) / 2
    times = np.sort(np.concatenate([law.times, middles]))
    cell, s, rate, _ = law.at(times)
    place = motion.places(s, motion.piece_at(cells.centres)[cell])
    values = field.values(place.q, place.dq_ds * rate[:, None])
    peak = float(values.max())
    mean = float(np.trapezoid(values, times) / law.duration) if law.duration else peak
    return MotionDanger(times, values, mean, peak, _proven_peak(motion, cells, law, field, peak))


def _proven_peak(motion: Motion, cells: Cells, law: TimeLaw, danger: KinetostaticField, peak: float) -> float:
    """Return an upper bound of the danger. Cells whose bound is far above the sampled peak are divided."""
    enough = _TIGHT_PEAK * peak
    upper = np.zeros(len(cells))
    rows: IntArray = np.arange(len(cells))
    for _ in range(_PEAK_DIVISIONS):
        slowest, fastest = (rates[rows] for rates in law.rates_between(cells.edges))
        bounds = cell_danger(danger, motion, cells, rows, fastest, enough)
        upper[rows] = np.maximum(bounds.at(fastest), bounds.at(slowest))
        above = upper > enough
        if not above.any():
            break
        parts: IntArray = np.where(above, _PARTS, 1)
        cells = motion.between(divided_edges(cells.edges, parts))
        rows, upper = np.flatnonzero(np.repeat(above, parts)), np.repeat(upper, parts)
    return float(upper.max())
