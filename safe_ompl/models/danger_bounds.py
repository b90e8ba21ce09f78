"""Certified danger: proven bounds of the peak danger of an edge and of a path, from few evaluations.

Samples give a lower bound of the peak, and `maths.bounds` an upper one for everything between two samples. The
interval with the highest bound is halved until both agree within a tolerance.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from heapq import heappop, heappush
from itertools import count
from math import inf, isfinite

import numpy as np
from numpy.typing import ArrayLike

from safe_ompl.arrays import FloatArray, finite_array
from safe_ompl.errors import InputError
from safe_ompl.maths.bounds import Ends, chords
from safe_ompl.models.danger import DangerField
from safe_ompl.models.keypoint_rates import KeypointRates
from safe_ompl.models.motion import Verdict
from safe_ompl.models.robot import Robot

_BATCH = 16  # intervals halved at once: many share the cost of a call, few are halved for nothing
_BLOCK = 1 << 18  # numbers in one array of a batch
_ROUNDING = 1e-8  # of the arithmetic, relative


@dataclass(frozen=True)
class DangerBounds:
    """What is proven of the peak danger of a motion: lower ≤ peak ≤ upper.

    Attributes
    ----------
    lower : float
        The largest danger found.
    upper : float
        No configuration of the motion is more dangerous; +inf where it cannot be kept from a danger point.
    edge : int
        The edge where `lower` was found,
    at : float
        and at which fraction of it.
    """

    lower: float
    upper: float
    edge: int
    at: float


@dataclass(frozen=True)
class DangerVerdict:
    """Whether a motion keeps to a limit of danger.

    Attributes
    ----------
    verdict : Verdict
        FREE: proven for every configuration of it. BLOCKED: exceeded at `at`. UNDECIDED: near `at` the danger is
        too near to the limit to tell.
    at : float or None
        Fraction of the edge.
    danger : float
        The danger there; for a motion that is free, the largest one found.
    """

    verdict: Verdict
    at: float | None
    danger: float


class CertifiedDanger:
    """Proves how dangerous straight joint motions are.

    Parameters
    ----------
    field : DangerField
        The danger; its danger points must be fixed.
    tolerance : float
        Bounds are narrowed until upper ≤ (1 + tolerance)·lower.
    floor : float
        [m] An interval in which the robot moves less than this is not divided any more.

    Raises
    ------
    InputError
        If the danger points come from a callable; if tolerance or floor is not positive.

    Notes
    -----
    Speed and acceleration of the key points at the ends of an interval are computed exactly, and the proven bounds of
    `KeypointRates` say how far they can grow between. From that `maths.bounds.chords` bounds the field of every link at
    every danger point. Aggregates are monotone and convex in the fields, so that they inherit the bounds.
    """

    def __init__(self, field: DangerField, tolerance: float = 0.05, floor: float = 1e-4) -> None:
        if field.points is None:
            raise InputError(
                "danger cannot be certified where the danger points depend on the configuration "
                "(a callable gives them); give the points themselves"
            )
        self.field = field
        self.tolerance = _positive(tolerance, "tolerance")
        self.floor = _positive(floor, "floor")
        lengths = field.segments.lengths
        self._lengths = None if lengths is None else lengths.ravel()

    def __repr__(self) -> str:
        return f"CertifiedDanger({self.field!r}, tolerance={self.tolerance:g}, floor={self.floor:g})"

    def of_edge(self, start: ArrayLike, end: ArrayLike) -> DangerBounds:
        """Return bounds of the peak danger of the straight motion between two configurations (n,)."""
        return self.of_path(np.array([start, end], dtype=np.float64))

    def of_path(self, path: ArrayLike) -> DangerBounds:
        """Return bounds of the peak danger of a path (N, n) of straight motions.

        Raises
        ------
        InputError
            If the path is empty, not finite, or leaves the limits of a prismatic joint (their strokes bound
            the radii).
        """
        search = _Search(self, path)
        search.narrow(lambda lower: (1 + self.tolerance) * lower)
        best = search.best
        return DangerBounds(best.danger, search.upper, best.edge, best.t)

    def check(self, start: ArrayLike, end: ArrayLike, limit: float) -> DangerVerdict:
        """Return whether the danger of the straight motion between two configurations (n,) is ≤ `limit`.

        Raises
        ------
        InputError
            As `of_path`; also if the limit is not positive.
        """
        limit = _positive(limit, "danger limit")
        search = _Search(self, np.array([start, end], dtype=np.float64))
        search.narrow(lambda lower: inf if lower > limit else limit, give_up=True)
        best = search.best
        if best.danger > limit:
            return DangerVerdict(Verdict.BLOCKED, best.t, best.danger)
        if search.upper > limit:
            return DangerVerdict(Verdict.UNDECIDED, search.undecided_at, best.danger)
        return DangerVerdict(Verdict.FREE, None, best.danger)


@dataclass(frozen=True)
class _Sample:
    """One configuration q_e + tΔ of an edge, and what is known there."""

    edge: int
    t: float
    danger: float
    ends: Ends  # (L, M) each
    lengths: FloatArray  # (L,)
    speed: FloatArray  # (K,)
    acceleration: FloatArray  # (K,)


@dataclass(frozen=True)
class _Interval:
    first: _Sample
    last: _Sample
    upper: float
    path: float  # [m] bound of how far the robot moves in it

    @property
    def middle(self) -> float:
        return (self.first.t + self.last.t) / 2


class _Search:
    """Best-first search for the peak over the intervals of a path."""

    def __init__(self, bounds: CertifiedDanger, path: ArrayLike) -> None:
        robot = bounds.field.robot
        points = finite_array(path, (None, robot.n), "path")
        if not len(points):
            raise InputError("path must have a configuration at least, got none")
        _check_strokes(robot, points)
        self._bounds, self._field = bounds, bounds.field
        ends = points[1:] if len(points) > 1 else points
        self._starts = points[: len(ends)]
        self._deltas = robot.difference(self._starts, ends)
        self._rates = KeypointRates.of(robot, self._deltas)
        self._stroke_rates = np.abs(self._deltas)[:, robot.prismatic].sum(axis=1)
        self._heap: list[tuple[float, int, _Interval]] = []
        self._undecided: list[_Interval] = []
        self._order = count()
        samples = self._sampled([(k, t) for k in range(len(ends)) for t in (0.0, 1.0)])
        self.best = max(samples, key=lambda sample: sample.danger)
        self._push(zip(samples[::2], samples[1::2], strict=True))

    @property
    def upper(self) -> float:
        """Proven upper bound of the peak."""
        bounds = [interval.upper for interval in self._undecided]
        bounds += [-self._heap[0][0]] if self._heap else []
        return max(max(bounds) * (1 + _ROUNDING), self.best.danger)

    @property
    def undecided_at(self) -> float | None:
        """Fraction of the edge in the middle of the first interval that was given up."""
        return min((interval.middle for interval in self._undecided), default=None)

    def narrow(self, ceiling: Callable[[float], float], *, give_up: bool = False) -> None:
        """Halve intervals until no bound is above `ceiling(lower)`, or all those (to give up: one) are too small."""
        while not (give_up and self._undecided):
            chosen = list(self._above(ceiling(self.best.danger) / (1 + _ROUNDING)))
            if not chosen:
                return
            middles = self._sampled([(interval.first.edge, interval.middle) for interval in chosen])
            self.best = max(self.best, *middles, key=lambda sample: sample.danger)
            halves = []
            for interval, middle in zip(chosen, middles, strict=True):
                halves += [(interval.first, middle), (middle, interval.last)]
            self._push(halves)

    def _above(self, ceiling: float) -> Iterable[_Interval]:
        """Take the most dangerous intervals out of the heap, as many as make a batch."""
        number = 0
        while number < _BATCH and self._heap and -self._heap[0][0] > ceiling:
            interval = heappop(self._heap)[2]
            if interval.path < self._bounds.floor:
                self._undecided.append(interval)
            else:
                number += 1
                yield interval

    def _sampled(self, places: list[tuple[int, float]]) -> list[_Sample]:
        edges, t = np.array([edge for edge, _ in places]), np.array([t for _, t in places])
        deltas = self._deltas[edges]
        points, velocities, accelerations = self._field.robot.keypoint_motions(
            self._starts[edges] + t[:, None] * deltas, deltas
        )
        speeds, pushes = np.linalg.norm(velocities, axis=2), np.linalg.norm(accelerations, axis=2)
        fields, distances = self._field.link_fields(points)
        lengths = self._link_lengths(points)
        dangers = self._field.aggregated((lengths[..., None] * fields).sum(axis=1))
        return [
            _Sample(edge, at, float(danger), Ends(u, d), length, v, a)
            for (edge, at), danger, u, d, length, v, a in zip(
                places, dangers, fields, distances, lengths, speeds, pushes, strict=True
            )
        ]

    def _link_lengths(self, points: FloatArray) -> FloatArray:
        """Return what each link's unit field is multiplied by, (B, L): 1, or its length [m]."""
        pairs = self._field.robot.segments
        if self._field.weighting == "unit":
            return np.ones((len(points), len(pairs)))
        if self._bounds._lengths is not None:
            return np.broadcast_to(self._bounds._lengths, (len(points), len(pairs)))
        lengths: FloatArray = np.linalg.norm(points[:, pairs[:, 1]] - points[:, pairs[:, 0]], axis=2)
        return lengths

    def _push(self, pairs: Iterable[tuple[_Sample, _Sample]]) -> None:
        """Bound the danger between pairs of samples, and put the intervals into the heap."""
        pairs = list(pairs)
        size = max(1, _BLOCK // pairs[0][0].ends.fields.size)
        for begin in range(0, len(pairs), size):
            part = pairs[begin : begin + size]
            for (first, last), upper, path in zip(part, *self._bounded(part), strict=True):
                interval = _Interval(first, last, float(upper), float(path))
                heappush(self._heap, (-interval.upper, next(self._order), interval))

    def _bounded(self, pairs: list[tuple[_Sample, _Sample]]) -> tuple[FloatArray, FloatArray]:
        """Return for each interval the upper bound of its danger, and how far the robot moves in it [m]."""
        firsts, lasts = ([pair[side] for pair in pairs] for side in (0, 1))
        edges = np.array([sample.edge for sample in firsts])
        h = np.array([last.t - first.t for first, last in pairs])
        speed, acceleration = self._rates.between(
            edges, h, *(np.array([[s.speed, s.acceleration] for s in side]) for side in (firsts, lasts))
        )
        links = self._field.robot.segments
        low, high = chords(
            _stacked(firsts),
            _stacked(lasts),
            h,
            speed[:, links].max(axis=2),
            acceleration[:, links].max(axis=2),
        )
        lengths = np.array([(a.lengths + b.lengths) / 2 for a, b in pairs])
        if self._field.weighting == "length" and self._bounds._lengths is None:
            lengths += (self._stroke_rates[edges] * h / 2)[:, None]
        # Aggregates are convex and grow with each level: above two ends of a line they are above all of it.
        upper = np.maximum(
            *(self._field.aggregated((lengths[..., None] * side).sum(axis=1)) for side in (low, high))
        )
        return upper, speed.max(axis=1) * h


def _stacked(samples: list[_Sample]) -> Ends:
    fields, distances = zip(*(sample.ends for sample in samples), strict=True)
    return Ends(np.array(fields), np.array(distances))


def _check_strokes(robot: Robot, path: FloatArray) -> None:
    for q in path:
        for i in np.flatnonzero(~robot.within_limits(q) & robot.prismatic):
            raise InputError(
                f"joint {robot.joint_names[i]!r} = {q[i]:g} is outside its limits "
                f"[{robot.lower[i]:g}, {robot.upper[i]:g}]: nothing is proven of it there"
            )


def _positive(value: float, name: str) -> float:
    if not (isinstance(value, (int, float, np.number)) and isfinite(value) and value > 0):
        raise InputError(f"{name} must be a positive number, got {value!r}")
    return float(value)
