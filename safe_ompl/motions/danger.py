"""The danger of a robot that moves along a curve: bounds over whole cells, the cap of the speed, what a motion has."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from safe_ompl.common import FloatArray, IntArray
from safe_ompl.danger import KinetostaticField, cell_bounds
from safe_ompl.motions.bodies import acceleration_bounds
from safe_ompl.motions.cells import Cells, divided_edges
from safe_ompl.motions.motion import Motion
from safe_ompl.motions.time_law import TimeLaw
from safe_ompl.robot import plain

# Bisection for the speed that keeps a limit of the danger.
_CAP_HALVINGS = 50
# A cell of a velocity limit is divided if its length costs more than this share of the speed. Cells are divided at most
# this often, and never into cells shorter than this.
_SPEED_LOSS = 0.02
_CAP_DIVISIONS = 3
_LEAST_CELL = 1e-3  # [rad]
# For a proven peak, cells are divided at most this often, or until the peak is at most this times the sampled one.
_PEAK_DIVISIONS = 8
_TIGHT_PEAK = 1.02
_PARTS = 3


class CellDanger(NamedTuple):
    """Bounds of the danger of a robot in cells: at the danger points at most level + ṡ·increase, (N, M), unweighted."""

    field: KinetostaticField
    levels: FloatArray
    increases: FloatArray

    def at(self, rates: FloatArray) -> FloatArray:
        """Return a bound of the danger (N,) in cells where ṡ is `rates: (N,)`."""
        # The product 0·∞ occurs where a danger point may be touched.
        with np.errstate(invalid="ignore"):
            fields = self.levels + rates[:, None] * self.increases
        return self.field.field.aggregated(np.where(np.isnan(fields), np.inf, fields))

    def allowed(self, limit: float, most: FloatArray) -> FloatArray:
        """Return the largest ṡ (N,) ≤ `most` with which the danger is proven to keep to a limit; −1: not at rest.

        The bound is convex in ṡ: if it keeps to the limit at rest and at some speed, so it does at all between.
        """
        if self.field.field.aggregate == "max":
            weights = self.field.field.weights
            share = limit if weights is None else limit / weights
            with np.errstate(divide="ignore", invalid="ignore"):
                speeds = np.where(self.increases > 0, (share - self.levels) / self.increases, np.inf)
            found = np.minimum(most, speeds.min(axis=1, initial=np.inf))
        else:
            found, bad = np.where(self.at(most) <= limit, most, 0.0), most
            for _ in range(_CAP_HALVINGS):
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
    """Return bounds over cells (N,) of a motion, or not `within` them but in the centres, with ṡ ≤ `rates: (N,)`.

    Where a danger point is proven, by a cheaper and looser bound, to bring no more danger than `enough`, that bound
    will do, if the danger is the maximum over danger points.
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
    state = np.ascontiguousarray(keypoints), np.ascontiguousarray(velocities)
    level, increase = cell_bounds(
        *state,
        speeds,
        accelerations,
        halves,
        strokes,
        field.links,
        plain(points),
        moving.gamma,
        field.weighting == "length",
        moving.lead * rates,
        (enough if field.aggregate == "max" else -np.inf) / (field.k1 * weights),
    )
    return CellDanger(moving, field.k1 * level, moving.k2 * increase)


def danger_cap(
    motion: Motion, cells: Cells, danger: KinetostaticField, limit: float, most: FloatArray
) -> tuple[Cells, IntArray, FloatArray]:
    """Return the speeds with which the danger of the moving robot keeps to a limit, where ṡ ≤ `most: (N,)` in any case.

    Along a curve the danger is φ + ṡ (φ′ + γI) k₂/k₁. Cells are divided where they bound the speed and are so long that
    it makes a difference. Returned are the cells, the given ones in which they are, and the largest ṡ, −1 where the
    danger at rest is above the limit.
    """

    def capped(rows: IntArray, *, within: bool = True) -> FloatArray:
        at_most = most[parents[rows]]
        return cell_danger(danger, motion, cells, rows, at_most, limit, within).allowed(limit, at_most)

    parents: IntArray = np.arange(len(cells))
    speeds, exact = capped(parents), most.copy()
    new = np.ones(len(cells), dtype=bool)
    for _ in range(_CAP_DIVISIONS):
        rows = np.flatnonzero(new & (speeds < most[parents]))
        exact[rows] = capped(rows, within=False)
        loss = 1 - np.maximum(speeds, 0) / np.maximum(exact, 1e-12)
        wanted = np.minimum(np.ceil(loss / _SPEED_LOSS), np.ceil(cells.sizes / _LEAST_CELL))
        parts: IntArray = np.where(exact > 0, np.maximum(wanted, 1), 1).astype(np.intp)
        if (parts == 1).all():
            break
        of = np.repeat(np.arange(len(cells)), parts)
        cells = motion.between(divided_edges(cells.edges, parts))
        parents, speeds, exact, new = parents[of], speeds[of], exact[of], parts[of] > 1
        divided = np.flatnonzero(new)
        speeds[divided] = capped(divided)
        exact[divided] = most[parents[divided]]
    return cells, parents, speeds


@dataclass(frozen=True)
class MotionDanger:
    """The kinetostatic danger [k₁/m, or k₁] at times (T,) [s] of a motion, its mean, its peak, and a bound of that."""

    times: FloatArray
    values: FloatArray
    mean: float
    peak: float
    proven_peak: float


def motion_danger(motion: Motion, law: TimeLaw, field: KinetostaticField) -> MotionDanger:
    """Return the danger of a robot that follows a law along a motion."""
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
    """Divide the cells whose bound is above the sampled peak until none is far above it; return the highest."""
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
