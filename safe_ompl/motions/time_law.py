"""Time laws: the arc length of a trajectory at each time, with or without a limit of the jerk.

Without a limit of the jerk, ṡ² is linear in every cell of the curve. With a limit, such a law, the *plan* σ, is
averaged over a window w: s(t) = 1/w ∫ σ from t − w to t (Biagiotti & Melchiorri 2012). Where the robot must stop, the
plan waits for w. Then ṡ and s̈ are averages, too, and s⃛ = (σ̈(t) − σ̈(t − w))/w. If m is the largest σ̇ in a window,
all its positions are within mw/2 of s(t): |σ(t) − s(t)| = 1/w |∫ σ(t) − σ(τ) dτ| ≤ mw/2. With the distance d_jk between
two cells, a plan with

    σ̇ ≤ min_k max(c_k, 2 d_jk/w)    in each cell j

has ṡ ≤ c_k in each cell k: if m > c_k, then σ̇ = m would be reached in a cell with d_jk < mw/2, where the plan does not
allow m. So the whole window is within c_kw/2 of the cell. If in all cells within this distance

* |pσ̈ + cσ̇²| ≤ a for p and c in the ranges of q′ and q″ of cell k, with 0 added to the range of q″, then |q̈| ≤ a: q̈
  is the mean of pσ̈ + c′σ̇² over the window for one c′ between 0 and q″, because ṡ² is at most the mean of σ̇²;
* −B_k ≤ σ̈ ≤ A_k with |q‴|c³ + 3|q″|c·max(A, B) + |q′|(A + B)/w ≤ j, then |q⃛| ≤ j.

c, A and B are chosen for each w, and w so that the motion takes the least time. Without people A = B; beside people B
is larger, for stops. The average of a stop of the plan, with its past, is a stop of the robot that keeps all limits
from any s̈, and ends w later: s(t) ≥ σ(t − w).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from safe_ompl.common import FloatArray, IntArray
from safe_ompl.motions.blends import CURVE_JERK_SHARE
from safe_ompl.motions.cells import Boxes, Cells
from safe_ompl.motions.laws import fastest, spread
from safe_ompl.motions.limits import RateLimits
from safe_ompl.robot import plain

_SPEED_HALVINGS = 36
# Windows are tried in decreasing length, by this factor and at most this often. `_FIRST_WINDOW` is the length of the
# first one, relative to the time in which the jerk limit builds up the full acceleration.
_WINDOW_FACTOR, _MOST_WINDOWS = 0.75, 40
_FIRST_WINDOW = 8.0
# Rounding errors do not affect averages over windows of at least this length.
_LEAST_WINDOW = 1e-4  # [s]
# Share of the jerk for q‴ṡ³ beside people. It is less than `CURVE_JERK_SHARE`, because stops need the jerk.
_CURVE_JERK_SHARE_BESIDE_PEOPLE = 0.1
# Share of the range of σ̈ that is reserved for stops beside people.
BRAKING = 2 / 3
# Factors that tighten limits and widen the reach to cover rounding errors.
_TIGHTER, _WIDER = 1 - 1e-9, 1 + 1e-9


@dataclass(frozen=True)
class TimeLaw:
    """Arc length over time, with constant s̈ in every cell of a motion.

    At the grid points (N + 1,): `edges`, arc lengths; `squared_speeds`, x = ṡ² [rad²/s²]; `times` [s].
    """

    edges: FloatArray
    squared_speeds: FloatArray
    times: FloatArray

    @classmethod
    def through(cls, edges: FloatArray, squared_speeds: FloatArray) -> TimeLaw:
        """Return the law with given ṡ² at the grid points. A cell of length h takes the time 2h/(ṡ_start + ṡ_end)."""
        return cls(edges, squared_speeds, np.concatenate([[0.0], np.cumsum(_spans(edges, squared_speeds))]))

    @property
    def duration(self) -> float:
        """Duration [s]."""
        return float(self.times[-1])

    @property
    def knots(self) -> FloatArray:
        """Times [s] at which s̈ jumps, or s⃛ if it is limited, in any order."""
        return self.times

    @property
    def accelerations(self) -> FloatArray:
        """s̈ (N,) in the cells [rad/s²]."""
        sizes = np.diff(self.edges)
        return np.divide(np.diff(self.squared_speeds), 2 * sizes, out=np.zeros(len(sizes)), where=sizes > 0)

    def rates_between(self, edges: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the least and the largest ṡ (C,) between arc lengths `edges: (C + 1,)`, with all grid points."""
        ends = np.sqrt(np.interp(edges, self.edges, self.squared_speeds))
        return np.minimum(ends[:-1], ends[1:]), np.maximum(ends[:-1], ends[1:])

    def at(self, t: FloatArray) -> tuple[IntArray, FloatArray, FloatArray, FloatArray]:
        """Return cell, s, ṡ and s̈ (T,) at times `t: (T,)` [s]. The law rests before the start and after the end."""
        cell: IntArray = np.clip(np.searchsorted(self.times, t, side="right") - 1, 0, len(self.edges) - 2)
        since = np.clip(t, 0.0, self.duration) - self.times[cell]
        acceleration, begin = self.accelerations[cell], np.sqrt(self.squared_speeds[cell])
        rate = begin + acceleration * since
        s = self.edges[cell] + since * (begin + rate) / 2
        outside = (t < 0) | (t > self.duration)
        return (
            cell,
            np.clip(s, self.edges[cell], self.edges[cell + 1]),
            np.where(outside, 0.0, np.maximum(rate, 0.0)),
            np.where(outside, 0.0, acceleration),
        )

    def planned(self, time: float) -> tuple[int, float, float]:
        """Return cell, s and ṡ at a time [s]."""
        cell, s, rate, _ = (x[0] for x in self.at(np.array([time])))
        return int(cell), float(s), float(rate)

    def stopped(self, time: float, edges: FloatArray, squared_speeds: FloatArray) -> TimeLaw:
        """Return the law from a time [s] on that continues with given ṡ² at grid points."""
        return TimeLaw.through(edges, squared_speeds)


def _spans(edges: FloatArray, squared_speeds: FloatArray) -> FloatArray:
    """Return the durations (N,) of the cells."""
    speeds = np.sqrt(squared_speeds)
    sizes, both = np.diff(edges), speeds[:-1] + speeds[1:]
    return np.asarray(np.divide(2 * sizes, both, out=np.zeros(len(sizes)), where=sizes > 0))


def joint_velocity_limit(cells: Cells, limits: RateLimits) -> FloatArray:
    """Return the largest ṡ (N,) of each cell within the joint velocity limits: min_i limit_i/max|q′_i|."""
    dq_ds = cells.dq_ds
    with np.errstate(divide="ignore"):
        return np.asarray(np.where(dq_ds > 0, limits.velocity / dq_ds, np.inf).min(axis=1))


def fastest_law(
    cells: Cells, acceleration: FloatArray, velocity_limit: FloatArray, path_acceleration: FloatArray | None = None
) -> FloatArray:
    """Return ṡ² (N+1,) of the fastest law within joint accelerations (n,) and a `velocity_limit: (N,)` of ṡ.

    The velocity limit must not exceed that of the joints. If `path_acceleration: (N,)` is given, it limits |s̈| in each
    cell.
    """
    boxes = cells.boxes
    if path_acceleration is not None:
        # The bound of s̈ is treated as one more joint with q′ = 1/path_acceleration and the limit 1.
        more = 1 / path_acceleration[:, None]
        boxes = Boxes(*(np.column_stack([box, k * more]) for box, k in zip(boxes, (1, 1, 0, 0), strict=True)))
        acceleration = np.append(acceleration, 1.0) * _TIGHTER
    within = velocity_limit * velocity_limit
    most = np.minimum(np.append(within, 0.0), np.concatenate([[0.0], within]))
    most[cells.stops] = 0.0
    return np.asarray(fastest(cells.sizes, Boxes(*map(plain, boxes)), acceleration, most))


# ------------------------------------------------------------------------------------------ with a limit of the jerk


@dataclass(frozen=True)
class SmoothLaw(TimeLaw):
    """The average of a plan over a window w [s]; see the module. `squared_speeds` and `times` are those of the average.

    Values of the plan at the grid points (N + 1,): `plan_squared_speeds`, σ̇²; `arrivals` and `leaves`, the times at
    which the plan reaches and leaves them [s].
    """

    window: float
    plan_squared_speeds: FloatArray
    arrivals: FloatArray
    leaves: FloatArray

    @classmethod
    def averaged(cls, edges: FloatArray, squared_speeds: FloatArray, stops: IntArray, window: float) -> SmoothLaw:
        """Return the average of the plan with given σ̇² at the grid points.

        The plan waits at the grid points `stops`.
        """
        waits = np.zeros(len(edges))
        waits[stops] = window
        leaves = np.concatenate([[0.0], np.cumsum(_spans(edges, squared_speeds) + waits[1:])])
        return cls._of(edges, window, squared_speeds, leaves - waits, leaves)

    @classmethod
    def _of(
        cls, edges: FloatArray, window: float, squared_speeds: FloatArray, arrivals: FloatArray, leaves: FloatArray
    ) -> SmoothLaw:
        times = np.append(leaves[:-1], arrivals[-1] + window)
        law = cls(edges, np.zeros(len(edges)), times, window, squared_speeds, arrivals, leaves)
        passed = law._passed(edges)
        times = np.where((leaves > arrivals) | (edges == edges[0]) | (edges == edges[-1]), times, passed)
        return replace(law, times=times, squared_speeds=law.at(times)[2] ** 2)

    @property
    def duration(self) -> float:
        """Duration [s]."""
        return float(self.arrivals[-1] + self.window)

    @property
    def knots(self) -> FloatArray:
        """Times [s] at which s⃛ jumps, because a cell of the plan enters or leaves the window, in any order."""
        ends = np.append(self.leaves, self.arrivals)
        return np.append(ends, ends + self.window)

    def rates_between(self, edges: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return bounds of ṡ as `TimeLaw`. They are not exact."""
        times = np.maximum.accumulate(self._passed(edges))
        ends, more = self.at(times)[2], np.diff(times) / 2 * np.abs(self._accelerations).max()
        low = np.minimum(ends[:-1], ends[1:]) - more
        return np.maximum(low, 0.0), np.maximum(ends[:-1], ends[1:]) + more

    def at(self, t: FloatArray) -> tuple[IntArray, FloatArray, FloatArray, FloatArray]:
        """Return cell, s, ṡ and s̈ (T,) at times `t: (T,)` [s]. The law rests before the start and after the end."""
        now, before = self._plan(t), self._plan(t - self.window)
        place, rate, acceleration = ((a - b) / self.window for a, b in zip(now[:3], before[:3], strict=True))
        last: IntArray = np.searchsorted(self.leaves, t, side="right") - 1
        first: IntArray = np.searchsorted(self.arrivals, t - self.window, side="right") - 1
        cell = np.searchsorted(self.edges, place, side="right") - 1
        cell = np.clip(np.clip(cell, first, np.maximum(last, first)), 0, len(self.edges) - 2)
        s = np.clip(place, self.edges[cell], self.edges[cell + 1])
        outside = (t < 0) | (t > self.duration)
        return cell, s, np.where(outside, 0.0, np.maximum(rate, 0.0)), np.where(outside, 0.0, acceleration)

    def jerks(self, t: FloatArray) -> FloatArray:
        """Return s⃛ (T,) at times `t: (T,)` [s]."""
        jerks = (self._plan(t)[3] - self._plan(t - self.window)[3]) / self.window
        return np.where((t < 0) | (t > self.duration), 0.0, jerks)

    def planned(self, time: float) -> tuple[int, float, float]:
        """Return the cell of the plan at a time [s], σ and σ̇."""
        _, place, rate, _ = (float(x[0]) for x in self._plan(np.array([time])))
        return int(self._cell(np.array([time]))[0]), place, rate

    def stopped(self, time: float, edges: FloatArray, squared_speeds: FloatArray) -> SmoothLaw:
        """Return the law from a time [s] on whose plan continues with given σ̇²; as `TimeLaw`."""
        first, last = self._cell(np.array([time - self.window, time]))
        past = np.s_[first : last + 1]
        if self.arrivals[last + 1] <= time:  # the robot stands still
            past, edges, squared_speeds = np.s_[first : last + 2], edges[:0], squared_speeds[:0]
        after = np.concatenate([[0.0], np.cumsum(_spans(edges, squared_speeds))])[: len(edges)]
        return SmoothLaw._of(
            np.concatenate([self.edges[past], edges]),
            self.window,
            np.concatenate([self.plan_squared_speeds[past], squared_speeds]),
            np.concatenate([self.arrivals[past] - time, after]),
            np.concatenate([self.leaves[past] - time, after]),
        )

    def _cell(self, t: FloatArray) -> IntArray:
        """Return the cell (T,) of the plan; while the plan waits, the previous cell."""
        return np.asarray(np.clip(np.searchsorted(self.leaves, t, side="right") - 1, 0, len(self.edges) - 2))

    def _plan(self, t: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Return ∫σ, σ, σ̇ and σ̈ (T,) of the plan at given times."""
        cell = self._cell(t)
        begin, acceleration = np.sqrt(self.plan_squared_speeds[cell]), self._accelerations[cell]
        since, end = t - self.leaves[cell], self.arrivals[cell + 1] - self.leaves[cell]
        inside = np.clip(since, 0.0, end)
        place = self.edges[cell] + inside * (begin + inside * acceleration / 2)
        area = self._areas[cell] + inside * (self.edges[cell] + inside * (begin / 2 + inside * acceleration / 6))
        area += np.minimum(since, 0.0) * self.edges[cell] + np.maximum(since - end, 0.0) * self.edges[cell + 1]
        moves = (t >= self.leaves[cell]) & (t < self.arrivals[cell + 1])
        return area, place, np.where(moves, begin + inside * acceleration, 0.0), np.where(moves, acceleration, 0.0)

    @cached_property
    def _accelerations(self) -> FloatArray:
        return TimeLaw(self.edges, self.plan_squared_speeds, self.arrivals).accelerations

    @cached_property
    def _areas(self) -> FloatArray:
        """∫σ (N + 1,) until the plan leaves each grid point."""
        spans, waits = self.arrivals[1:] - self.leaves[:-1], (self.leaves - self.arrivals)[1:]
        begin = np.sqrt(self.plan_squared_speeds[:-1])
        cells = spans * (self.edges[:-1] + spans * (begin / 2 + spans * self._accelerations / 6))
        return np.concatenate([[0.0], np.cumsum(cells + waits * self.edges[1:])])

    def _passed(self, s: FloatArray) -> FloatArray:
        """Return the times at which arc lengths (S,) are passed, by bisection, because s increases with time."""
        cell = np.clip(np.searchsorted(self.edges, s, side="right") - 1, 0, len(self.edges) - 2)
        early, late = self.arrivals[cell], self.arrivals[cell + 1] + self.window
        for _ in range(_SPEED_HALVINGS):
            middle = (early + late) / 2
            area = (self._plan(middle)[0] - self._plan(middle - self.window)[0]) / self.window
            early, late = np.where(area <= s, middle, early), np.where(area <= s, late, middle)
        return early


@dataclass(frozen=True)
class SmoothLimits:
    """Limits of plans whose average over a window [s] keeps the joint limits, in every cell; see the module.

    The ranges of q′ and q″ of `cells` include those of all cells within reach, and 0 for q″. `velocity_limit` (c)
    limits ṡ, `accelerations` (A) limits |σ̈|, and `brakes` (B) limits the deceleration of a stop.
    """

    window: float
    cells: Cells
    velocity_limit: FloatArray
    accelerations: FloatArray
    brakes: FloatArray

    @classmethod
    def of(
        cls,
        cells: Cells,
        limits: RateLimits,
        velocity_limit: FloatArray,
        window: float,
        *,
        stops: bool = False,
        share: float | None = None,
    ) -> SmoothLimits:
        """Return the limits in cells in which ṡ ≤ `velocity_limit: (N,)`.

        `stops`: whether the robot may stop at any time. q‴ṡ³ may take a `share` of the jerk limit.
        """
        assert limits.jerk is not None
        usual, braking = (_CURVE_JERK_SHARE_BESIDE_PEOPLE, BRAKING) if stops else (CURVE_JERK_SHARE, 0.5)
        share = usual if share is None else share
        d2q_ds2 = cells.d2q_ds2
        with np.errstate(divide="ignore"):
            velocity_limit = np.minimum(velocity_limit, np.cbrt((share * limits.jerk / cells.d3q_ds3).min(axis=1)))
            velocity_limit = np.minimum(velocity_limit, np.sqrt((limits.acceleration / d2q_ds2).min(axis=1)))
            left = limits.jerk * np.where(cells.d3q_ds3 > 0, 1 - share, 1.0)
            span = (left / (cells.dq_ds / window + 3 * d2q_ds2 * (braking * velocity_limit)[:, None])).min(axis=1)
        span = np.minimum(span, np.linalg.norm(limits.acceleration) / braking)[:, None]  # of σ̈
        dq_ds_low, dq_ds_high, d2q_ds2_low, d2q_ds2_high = cells.boxes
        low, high = np.minimum(d2q_ds2_low, 0.0), np.maximum(d2q_ds2_high, 0.0)
        values = np.column_stack([dq_ds_low, -dq_ds_high, low, -high, span])
        near = spread(cells.edges, _WIDER * window / 2 * velocity_limit, cells.stops, values, np.inf)
        parts = zip((1, -1, 1, -1), np.split(near[:, :-1], 4, axis=1), strict=True)
        wide = replace(cells, boxes=Boxes(*(sign * part for sign, part in parts)))
        return cls(window, wide, velocity_limit, (1 - braking) * near[:, -1], braking * near[:, -1])

    def cone(self, velocity_limit: FloatArray) -> FloatArray:
        """Return limits (N, …) of σ̇ in each cell that imply ṡ ≤ `velocity_limit: (N, …)`."""
        width, cells = self.window / 2, self.cells
        # Cells farther away have no effect.
        reach = np.full(len(cells), width * velocity_limit.max() * (1 + 1e-9))
        found = spread(cells.edges, reach, cells.stops, velocity_limit.reshape(len(cells), -1), width)
        return found.reshape(velocity_limit.shape)

    def plan(self, limits: RateLimits, velocity_limit: FloatArray) -> FloatArray:
        """Return σ̇² (N + 1,) of the fastest plan, with the additional limit ṡ ≤ `velocity_limit: (N,)`."""
        velocity_limit = self.cone(np.minimum(velocity_limit, self.velocity_limit))
        return fastest_law(self.cells, limits.acceleration, velocity_limit, self.accelerations)

    def law(self, limits: RateLimits, velocity_limit: FloatArray) -> SmoothLaw:
        """Return the average of the fastest plan."""
        return SmoothLaw.averaged(self.cells.edges, self.plan(limits, velocity_limit), self.cells.stops, self.window)


def best_window(cells: Cells, limits: RateLimits, velocity_limit: FloatArray, times: FloatArray | None = None) -> float:
    """Return the window [s] with which a law takes about the least time. With `times`, the law is beside people."""
    assert limits.jerk is not None
    stops = times is not None
    with np.errstate(divide="ignore"):
        accelerations = (limits.acceleration / cells.dq_ds).min(axis=1)
    accelerations = np.minimum(accelerations, np.linalg.norm(limits.acceleration))
    window = max(_FIRST_WINDOW * float((cells.dq_ds * accelerations[:, None] / limits.jerk).max()), _LEAST_WINDOW)
    best, least, worse = window, np.inf, 0
    for _ in range(_MOST_WINDOWS):
        smooth = SmoothLimits.of(cells, limits, velocity_limit, window, stops=stops)
        speeds, duration = velocity_limit, np.inf
        if times is not None:
            left = np.maximum(times.min(axis=1) - window, 0.0)
            speeds = np.minimum(velocity_limit, np.minimum(smooth.brakes, accelerations) * left)
        if speeds.min() > 0:
            spans = _spans(cells.edges, smooth.plan(limits, speeds))
            duration = float(spans.sum()) + window * (len(cells.stops) + 1)
        if duration < least:
            best, least, worse = window, duration, 0
        elif least < np.inf:
            worse += 1
        window *= _WINDOW_FACTOR
        if worse == 3 or window < _LEAST_WINDOW:
            break
    return best
