"""Certified danger: proven bounds of the peak danger of edges and paths, from few evaluations."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from heapq import heappop, heappush
from itertools import count
from math import inf

import numpy as np
from numpy.typing import ArrayLike

from safe_ompl.collision import MotionVerdict, Verdict
from safe_ompl.common import FloatArray, InputError, IntArray, motion_ends, number, told_apart
from safe_ompl.danger.field import DangerField
from safe_ompl.danger.link_field import segment_bounds
from safe_ompl.danger.static import chords
from safe_ompl.robot import Robot

# Number of intervals that are halved at once. A larger batch shares the cost of a call, a smaller one halves fewer
# intervals needlessly.
_BATCH = 16
_ROUNDING = 1e-8  # relative
# Relative tolerance of the bounds of a peak.
_TOLERANCE = 0.05
# Intervals in which the robot moves less than this are not halved.
_FLOOR = 1e-4  # [m]
_WITNESS = ("danger", "its limit")


@dataclass(frozen=True)
class DangerBounds:
    """Proven bounds of the peak danger of a motion: lower ≤ peak ≤ upper.

    The largest danger found, `lower`, occurs on the edge `edge` at its fraction `at`. No configuration of the motion is
    more dangerous than `upper`, which is +inf if contact with a danger point cannot be excluded.
    """

    lower: float
    upper: float
    edge: int
    at: float


class CertifiedDanger:
    """Proves bounds of the peak danger of straight joint motions until upper ≤ 1.05·lower.

    Samples give a lower bound of the peak. For the motion between two samples, speed and acceleration of the key points
    are known at both ends, and `KeypointRates` bounds their growth. From these, `danger.static.chords` bounds the field
    of every link at every danger point from above. Aggregates are monotone and convex in the fields, so the bounds
    carry over to the danger. The interval with the highest bound is halved until both bounds agree within the
    tolerance, or the robot moves less than 0.1 mm in the interval.

    Examples
    --------
    >>> field = DangerField(Robot.from_example("ur5"), [[0.8, 0.0, 0.5]])
    >>> path = [[0.9, -1.2, 1.4, -1.8, -1.57, 0.0], [-0.9, -1.2, 1.4, -1.8, -1.57, 0.0]]
    >>> bounds = CertifiedDanger(field).of_path(path)
    >>> f"the peak is between {bounds.lower:.1f} and {bounds.upper:.1f}"
    'the peak is between 17.6 and 18.3'
    """

    def __init__(self, field: DangerField) -> None:
        self.field = field

    def __repr__(self) -> str:
        return f"CertifiedDanger({self.field!r})"

    def of_path(self, path: ArrayLike) -> DangerBounds:
        """Return bounds of the peak danger of a path (N, n) of straight motions.

        Raises InputError if the path is empty, not finite, or leaves the limits of a prismatic joint, within which the
        motion bounds hold.
        """
        search = PeakSearch(self.field, path, lambda lower: (1 + _TOLERANCE) * lower)
        search.narrow()
        best = search.best
        return DangerBounds(best.danger, search.upper, best.edge, best.t)


class DangerLimit:
    """A limit > 0 of the danger that can be proven along whole motions, as a limit of `MotionProver`.

    A motion stays undecided if its peak danger is closer to the limit than about the change of the danger over 0.1 mm.

    Examples
    --------
    >>> limit = DangerLimit(DangerField(Robot.from_example("ur5"), [[0.8, 0.0, 0.5]]), 12.0)
    >>> limit.allows([0.9, -1.2, 1.4, -1.8, -1.57, 0.0])
    True
    """

    name = "danger"

    def __init__(self, field: DangerField, limit: float) -> None:
        self.limit = number("max danger", limit, above=0.0)
        self.field = field

    def __repr__(self) -> str:
        return f"DangerLimit({self.field!r}, {self.limit:g})"

    def danger(self, q: ArrayLike) -> float:
        """Return the danger at `q: (n,)`."""
        return self.field.value(q)

    def allows(self, q: ArrayLike) -> bool:
        """Return whether the danger at `q: (n,)` is within the limit."""
        return self.danger(q) <= self.limit

    def holds_within(self, q: FloatArray, steps: FloatArray) -> bool:
        """Return whether the limit is proven for all configurations whose joints are within `steps: (n,)` of `q`."""
        field, robot = self.field.frozen(), self.field.robot
        if field.factors is None:
            return False
        fields, distances = field.link_fields(robot.keypoints(q)[None])
        moved = (robot.bounds.keypoint_radii @ steps)[field.links].max(axis=1)
        grown = segment_bounds(fields, distances, moved[:, None]) * field.factors[:, None]
        return bool(field.aggregated(grown.sum(axis=1))[0] <= self.limit)

    def check(self, start: ArrayLike, end: ArrayLike) -> MotionVerdict:
        """Check the straight motion between two configurations (n,); errors as `CertifiedDanger.of_path`.

        UNDECIDED means that near `at` the danger is too close to the limit for a proof. The `pair` is "danger" and "its
        limit".
        """
        ends, ceiling = motion_ends(start, end, self.field.robot.n), self.limit
        search = PeakSearch(self.field, ends, lambda low: inf if low > ceiling else ceiling)
        search.narrow(give_up=True)
        if search.best.danger > self.limit:
            return MotionVerdict(Verdict.BLOCKED, search.best.t, _WITNESS)
        if search.upper > self.limit:
            return MotionVerdict(Verdict.UNDECIDED, search.undecided_at, _WITNESS)
        return MotionVerdict(Verdict.FREE)


@dataclass(frozen=True, eq=False, repr=False)
class KeypointRates:
    """Proven bounds (E, K) [m] of speed, acceleration and jerk of the key points over whole edges q₁ + tΔ, t ∈ [0, 1].

    A derivative of key point k with respect to joints i ≤ j, counted from the base, is at most R̄_kj, the proven
    radius, if joint i is revolute, and zero if joint i is prismatic. The same holds for derivatives with respect to
    more joints.
    """

    speed: FloatArray
    acceleration: FloatArray
    jerk: FloatArray

    @classmethod
    def of(cls, robot: Robot, deltas: FloatArray) -> KeypointRates:
        """Compute the bounds for edges with `deltas: (E, n)`.

        With r_j = R̄_kj|Δ_j|, w_j = |Δ_j| for revolute joints, else 0, and W_j the sum of w over the joints between
        base and j, the bounds are Σ r_j, Σ r_j (2W_j + w_j), Σ r_j (3W_j² + 3W_j w_j + w_j²).
        """
        steps = np.abs(robot.coupling.motions(deltas))[:, None, :]
        moved = steps * robot.bounds.joint_keypoint_radii
        turn = np.where(robot.joint_keypoint_support & ~robot.joint_prismatic, steps, 0.0)
        # Pinocchio numbers joints from the base on.
        below = np.cumsum(turn, axis=2) - turn
        return cls(
            moved.sum(axis=2),
            (moved * (2 * below + turn)).sum(axis=2),
            (moved * (3 * below * (below + turn) + turn * turn)).sum(axis=2),
        )

    def between(
        self, edges: IntArray, h: FloatArray, first: FloatArray, last: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Return bounds (I, K) of speed and acceleration between two configurations of an edge, for I intervals.

        `h: (I,)` is the length of each interval as a fraction of its edge. `first` and `last` (I, 2, K) are the exact
        speed and acceleration at its ends.
        """
        middle = (first + last) / 2
        speed, acceleration = middle[:, 0], middle[:, 1]
        step = h[:, None] / 2
        acceleration = np.minimum(self.acceleration[edges], acceleration + step * self.jerk[edges])
        return np.minimum(self.speed[edges], speed + step * acceleration), acceleration


@dataclass(frozen=True, eq=False, repr=False)
class Sample:
    """One configuration q_e + tΔ of an edge, with the danger, fields and speeds there."""

    edge: int
    t: float
    danger: float
    # The fields of the links, and their distances [m] from the danger points, (2, L, M).
    fields: FloatArray
    lengths: FloatArray  # (L,)
    speed: FloatArray  # (K,)
    acceleration: FloatArray  # (K,)


@dataclass(frozen=True, eq=False, repr=False)
class _Interval:
    first: Sample
    last: Sample
    upper: float
    # A bound of the motion of the robot in the interval.
    path: float  # [m]

    @property
    def middle(self) -> float:
        return (self.first.t + self.last.t) / 2


class PeakSearch:
    """Halves the intervals of a path that may contain the peak. `best` is the most dangerous sample so far.

    The path has way points (N, n). Intervals in which the robot moves less than the floor are not halved. The ceiling
    maps the largest danger found to a sufficient bound. It must not decrease as the danger increases.
    """

    best: Sample

    def __init__(self, field: DangerField, path: ArrayLike, ceiling: Callable[[float], float]) -> None:
        robot = field.robot
        points = robot.way_points(path)
        if not len(points):
            raise InputError("path must have at least one configuration, got none")
        _check_strokes(robot, points)
        # All steps of the proof must use the same danger points.
        field = field.frozen()
        self._field, self._ceiling = field, ceiling
        points = points if len(points) > 1 else points[[0, 0]]
        self._starts, ends = points[:-1], points[1:]
        self._deltas = robot.difference(self._starts, ends)
        self._rates = KeypointRates.of(robot, self._deltas)
        strokes = np.abs(robot.coupling.motions(self._deltas))[:, robot.joint_prismatic]
        self._stroke_rates = strokes.sum(axis=1)
        self._heap: list[tuple[float, int, _Interval]] = []
        self._undecided: list[_Interval] = []
        # The highest bound of the intervals that need no more halving. These intervals are not kept.
        self._settled = 0.0
        self._order = count()
        for first in range(0, len(ends), _BATCH):
            edges = self._whole_edges(first, min(first + _BATCH, len(ends)))
            self.best = max(
                ([self.best] if first else []) + [s for pair in edges for s in pair], key=lambda sample: sample.danger
            )
            self._push(edges)

    @property
    def upper(self) -> float:
        """Proven upper bound of the peak."""
        bounds = [interval.upper for interval in self._undecided]
        bounds += [-self._heap[0][0]] if self._heap else []
        return max(max([*bounds, self._settled]) * (1 + _ROUNDING), self.best.danger)

    @property
    def undecided_at(self) -> float | None:
        """Fraction of the edge at the middle of the first interval that stays undecided."""
        return min((interval.middle for interval in self._undecided), default=None)

    def narrow(self, *, give_up: bool = False) -> None:
        """Halve intervals until all bounds suffice or the remaining intervals are too small.

        With `give_up` the search ends at the first interval that is too small.
        """
        while not (give_up and self._undecided):
            chosen = list(self._above())
            if not chosen:
                return
            places = [(interval.first.edge, interval.middle) for interval in chosen]
            points, *motions = self._motions(places)
            middles = self._samples(places, *motions, *self._evaluated(points))
            self.best = max(self.best, *middles, key=lambda sample: sample.danger)
            halves = []
            for interval, middle in zip(chosen, middles, strict=True):
                halves += [(interval.first, middle), (middle, interval.last)]
            self._push(halves)

    @property
    def _enough(self) -> float:
        """The bound that suffices for an interval."""
        return self._ceiling(self.best.danger) / (1 + _ROUNDING)

    def _above(self) -> Iterable[_Interval]:
        """Pop the intervals with the highest bounds from the heap, up to one batch."""
        number, enough = 0, self._enough
        while number < _BATCH and self._heap and -self._heap[0][0] > enough:
            interval = heappop(self._heap)[2]
            if interval.path < _FLOOR:
                self._undecided.append(interval)
            else:
                number += 1
                yield interval

    def _whole_edges(self, first: int, last: int) -> list[tuple[Sample, Sample]]:
        """Return samples at the start and end of some edges. A way point between two edges is evaluated once."""
        starts, ends = ([(k, t) for k in range(first, last)] for t in (0.0, 1.0))
        points, speeds, accelerations = self._motions(starts + ends)
        number = len(starts)
        evaluated = self._evaluated(np.concatenate([points[:number], points[-1:]]))
        at_starts, at_ends = ([values[part] for values in evaluated] for part in (slice(-1), slice(1, None)))
        first_samples = self._samples(starts, speeds[:number], accelerations[:number], *at_starts)
        last_samples = self._samples(ends, speeds[number:], accelerations[number:], *at_ends)
        return list(zip(first_samples, last_samples, strict=True))

    def _motions(self, places: list[tuple[int, float]]) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return positions (B, K, 3), speeds and accelerations (B, K) of the key points at (edge, fraction) pairs."""
        edges, t = np.array([edge for edge, _ in places]), np.array([t for _, t in places])
        deltas = self._deltas[edges]
        points, velocities, accelerations = self._field.robot.keypoint_motions(
            self._starts[edges] + t[:, None] * deltas, deltas
        )
        return points, _norm(velocities), _norm(accelerations)

    def _evaluated(self, points: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return dangers (B,), fields and distances (B, 2, L, M), and lengths (B, L) for key points (B, K, 3)."""
        fields, distances = self._field.link_fields(points)
        pairs, factors = self._field.links, self._field.factors
        # The factors of the links' unit fields.
        if factors is None:
            lengths: FloatArray = np.linalg.norm(points[:, pairs[:, 1]] - points[:, pairs[:, 0]], axis=2)
        else:
            lengths = np.broadcast_to(factors, (len(points), len(pairs)))
        dangers = self._field.aggregated((lengths[..., None] * fields).sum(axis=1))
        return dangers, np.stack([fields, distances], axis=1), lengths

    def _samples(self, places: list[tuple[int, float]], *found: FloatArray) -> list[Sample]:
        """Return samples from speeds, accelerations, and the values that `_evaluated` returns (`found`)."""
        return [
            Sample(edge, t, float(danger), fields, length, v, a)
            for (edge, t), v, a, danger, fields, length in zip(places, *found, strict=True)
        ]

    def _push(self, pairs: Sequence[tuple[Sample, Sample]]) -> None:
        """Bound the danger between pairs of samples and queue the intervals whose bounds are too high."""
        for (first, last), upper, path in zip(pairs, *self._bounded(pairs), strict=True):
            if upper <= self._enough:
                self._settled = max(self._settled, upper)
            else:
                interval = _Interval(first, last, upper, path)
                heappush(self._heap, (-interval.upper, next(self._order), interval))

    def _bounded(self, pairs: Sequence[tuple[Sample, Sample]]) -> tuple[list[float], list[float]]:
        """Return for each interval the upper bound of the danger, and a bound of the robot's motion [m]."""
        edges = np.array([first.edge for first, _ in pairs])
        h = np.array([last.t - first.t for first, last in pairs])
        known = (np.array([[pair[side].speed, pair[side].acceleration] for pair in pairs]) for side in (0, 1))
        speed, acceleration = self._rates.between(edges, h, *known)
        links = self._field.robot.segments
        bounds = speed.take(links, axis=1).max(axis=2), acceleration.take(links, axis=1).max(axis=2)
        motions = zip(pairs, h.tolist(), *bounds, self._longest(pairs, edges, h), strict=True)
        lines = (chords(first.fields, last.fields, *motion) for (first, last), *motion in motions)
        # Aggregates are convex and monotone, so the larger value at the two ends of a line bounds the whole line.
        uppers = [float(self._field.aggregated(ends).max()) for ends in lines]
        return uppers, (speed.max(axis=1) * h).tolist()

    def _longest(self, pairs: Sequence[tuple[Sample, Sample]], edges: IntArray, h: FloatArray) -> FloatArray:
        """Return the largest factor of each link's unit field in each interval, (I, L)."""
        lengths = np.array([(first.lengths + last.lengths) / 2 for first, last in pairs])
        if self._field.factors is None:
            lengths += (self._stroke_rates[edges] * h / 2)[:, None]
        return lengths


def _norm(vectors: FloatArray) -> FloatArray:
    norm: FloatArray = np.sqrt(np.einsum("bkc,bkc->bk", vectors, vectors))
    return norm


def _check_strokes(robot: Robot, path: FloatArray) -> None:
    # Prismatic joints, and joints that move a prismatic joint through a coupling.
    strokes = robot.coupling.radii(robot.joint_prismatic.astype(np.float64)) > 0
    for q in path:
        for i in np.flatnonzero(~robot.within_limits(q) & strokes):
            value, low, high = told_apart(q[i], robot.lower[i], robot.upper[i])
            which = robot.joint_names[i]
            raise InputError(
                f"joint {which!r} = {value} is outside its limits [{low}, {high}]: nothing can be proven there"
            )
