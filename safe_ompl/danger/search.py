"""Best-first search for the most dangerous configuration of a path, with a proven bound of what it may miss.

All bounds speak of a segment whose points move smoothly for a time h, none of them faster than V or with more
acceleration than A, and of its unit-weighted field u = ∫₀¹ dτ/ρ_τ at a point p, ρ_τ the distance of p from the
point τ of the segment.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from heapq import heappop, heappush
from itertools import count
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from safe_ompl.common import FloatArray, InputError, IntArray, finite_array
from safe_ompl.danger.field import DangerField
from safe_ompl.danger.kernels import danger as kernel
from safe_ompl.danger.motion_rates import KeypointRates
from safe_ompl.robot import Robot

_BATCH = 16  # intervals halved at once: many share the cost of a call, few are halved for nothing
_ROUNDING = 1e-8  # of the arithmetic, relative


class Ends(NamedTuple):
    """What is known of segments at one end of an interval: fields and distances, (L, M)."""

    fields: FloatArray
    distances: FloatArray


def chords(
    first: Ends,
    last: Ends,
    duration: float,
    speed: FloatArray,
    acceleration: FloatArray,
    lengths: FloatArray,
) -> FloatArray:
    """Return the ends of straight lines that lie above Σ_l length_l·u_l(t) throughout an interval.

    Of two bounds of each u the lower one is taken. Seen from the nearer end no point moves farther than δ = Vh/2, so
    u ≤ U = max u·D/(D − δ) over both ends (`segment_bounds`): a level line. And along a curve 1/ρ has the second
    derivative vᵀ∇²(1/ρ)v + ∇(1/ρ)·a ≥ −v²/ρ³ − a/ρ², for ∇²(1/ρ) has the eigenvalues 2/ρ³ and −1/ρ³. As ρ never falls
    below D̲ = (D₁ + D₂ − Vh)/2, u'' ≥ −U(V²/D̲² + A/D̲), and u stays below the chord from u₁ to u₂ raised by

        U (V²/D̲² + A/D̲) h²/8.

    The first bound is linear in h, the second quadratic: near a smooth peak it needs a fifth of the intervals.

    Parameters
    ----------
    first, last : Ends
        Where the interval begins and ends; arrays as `segment_fields` and `segment_distances` return them.
    duration : float
        h.
    speed, acceleration : ndarray, shape (L,)
        V [m] and A [m].
    lengths : ndarray, shape (L,)
        What the field of each segment is multiplied by: 1, or at least its length [m] throughout the interval.

    Returns
    -------
    ndarray, shape (2, M)
        The lines at the beginning and at the end; +inf where a segment may reach the point.
    """
    moves = np.ascontiguousarray(speed), np.ascontiguousarray(acceleration)
    return kernel.chords(*first, *last, duration, *moves, lengths)


@dataclass(frozen=True)
class Sample:
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
    first: Sample
    last: Sample
    upper: float
    path: float  # [m] bound of how far the robot moves in it

    @property
    def middle(self) -> float:
        return (self.first.t + self.last.t) / 2


class PeakSearch:
    """Halves the intervals of a path that may be the most dangerous ones.

    Parameters
    ----------
    field : DangerField
        The danger; its danger points must be fixed.
    path : array_like, shape (N, n)
        Way points.
    floor : float
        [m] Intervals in which the robot moves less are not halved any more.
    ceiling : callable
        Maps the largest danger found to the bound that is good enough. It must not fall as more is found.

    Attributes
    ----------
    best : Sample
        The most dangerous configuration found.
    """

    best: Sample

    def __init__(
        self, field: DangerField, path: ArrayLike, floor: float, ceiling: Callable[[float], float]
    ) -> None:
        robot = field.robot
        points = finite_array(path, (None, robot.n), "path")
        if not len(points):
            raise InputError("path must have a configuration at least, got none")
        _check_strokes(robot, points)
        field = field.frozen()  # what is proven is of the same danger points from the beginning to the end
        self._field, self._floor, self._ceiling = field, floor, ceiling
        lengths = field.segments.lengths
        self._lengths = lengths
        points = points if len(points) > 1 else points[[0, 0]]
        self._starts, ends = points[:-1], points[1:]
        self._deltas = robot.difference(self._starts, ends)
        self._rates = KeypointRates.of(robot, self._deltas)
        self._stroke_rates = np.abs(robot.coupling.motions(self._deltas))[:, robot.joint_prismatic].sum(
            axis=1
        )
        self._heap: list[tuple[float, int, _Interval]] = []
        self._undecided: list[_Interval] = []
        self._settled = 0.0  # highest bound of the intervals that need no more halving; they are not kept
        self._order = count()
        for first in range(0, len(ends), _BATCH):
            edges = self._whole_edges(first, min(first + _BATCH, len(ends)))
            self.best = max(([self.best] if first else []) + [s for pair in edges for s in pair], key=_danger)
            self._push(edges)

    @property
    def upper(self) -> float:
        """Proven upper bound of the peak."""
        bounds = [interval.upper for interval in self._undecided]
        bounds += [-self._heap[0][0]] if self._heap else []
        return max(max([*bounds, self._settled]) * (1 + _ROUNDING), self.best.danger)

    @property
    def undecided_at(self) -> float | None:
        """Fraction of the edge in the middle of the first interval that was given up."""
        return min((interval.middle for interval in self._undecided), default=None)

    def narrow(self, *, give_up: bool = False) -> None:
        """Halve intervals until all bounds are good enough, or all those (to give up: one) are too small."""
        while not (give_up and self._undecided):
            chosen = list(self._above())
            if not chosen:
                return
            middles = self._sampled([(interval.first.edge, interval.middle) for interval in chosen])
            self.best = max(self.best, *middles, key=_danger)
            halves = []
            for interval, middle in zip(chosen, middles, strict=True):
                halves += [(interval.first, middle), (middle, interval.last)]
            self._push(halves)

    @property
    def _enough(self) -> float:
        """The bound that is good enough for an interval."""
        return self._ceiling(self.best.danger) / (1 + _ROUNDING)

    def _above(self) -> Iterable[_Interval]:
        """Take the most dangerous intervals out of the heap, as many as make a batch."""
        number, enough = 0, self._enough
        while number < _BATCH and self._heap and -self._heap[0][0] > enough:
            interval = heappop(self._heap)[2]
            if interval.path < self._floor:
                self._undecided.append(interval)
            else:
                number += 1
                yield interval

    def _sampled(self, places: list[tuple[int, float]]) -> list[Sample]:
        points, speeds, pushes = self._motions(places)
        return self._samples(places, speeds, pushes, *self._evaluated(points))

    def _whole_edges(self, first: int, last: int) -> list[tuple[Sample, Sample]]:
        """Return start and end of some edges; a way point between two of them is evaluated once."""
        starts, ends = ([(k, t) for k in range(first, last)] for t in (0.0, 1.0))
        points, speeds, pushes = self._motions(starts + ends)
        number = len(starts)
        evaluated = self._evaluated(np.concatenate([points[:number], points[-1:]]))
        at_starts, at_ends = ([values[part] for values in evaluated] for part in (slice(-1), slice(1, None)))
        first_samples = self._samples(starts, speeds[:number], pushes[:number], *at_starts)
        last_samples = self._samples(ends, speeds[number:], pushes[number:], *at_ends)
        return list(zip(first_samples, last_samples, strict=True))

    def _motions(self, places: list[tuple[int, float]]) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return positions (B, K, 3), speeds and accelerations (B, K) of the key points at places of edges."""
        edges, t = np.array([edge for edge, _ in places]), np.array([t for _, t in places])
        deltas = self._deltas[edges]
        points, velocities, accelerations = self._field.robot.keypoint_motions(
            self._starts[edges] + t[:, None] * deltas, deltas
        )
        return points, _norm(velocities), _norm(accelerations)

    def _evaluated(self, points: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Return dangers (B,), fields and distances (B, L, M), and lengths (B, L) for key points (B, K, 3)."""
        fields, distances = self._field.link_fields(points)
        lengths = self._link_lengths(points)
        return self._field.aggregated((lengths[..., None] * fields).sum(axis=1)), fields, distances, lengths

    def _samples(
        self, places: list[tuple[int, float]], speeds: FloatArray, pushes: FloatArray, *evaluated: FloatArray
    ) -> list[Sample]:
        return [
            Sample(edge, t, float(danger), Ends(u, d), length, v, a)
            for (edge, t), v, a, danger, u, d, length in zip(places, speeds, pushes, *evaluated, strict=True)
        ]

    def _link_lengths(self, points: FloatArray) -> FloatArray:
        """Return what each link's unit field is multiplied by, (B, L): 1, or its length [m]."""
        pairs = self._field.robot.segments
        if self._field.weighting == "unit":
            return np.ones((len(points), len(pairs)))
        if self._lengths is not None:
            return np.broadcast_to(self._lengths, (len(points), len(pairs)))
        lengths: FloatArray = np.linalg.norm(points[:, pairs[:, 1]] - points[:, pairs[:, 0]], axis=2)
        return lengths

    def _push(self, pairs: Sequence[tuple[Sample, Sample]]) -> None:
        """Bound the danger between pairs of samples, and put the intervals that are not settled by it into the heap."""
        for (first, last), upper, path in zip(pairs, *self._bounded(pairs), strict=True):
            if upper <= self._enough:
                self._settled = max(self._settled, upper)
            else:
                interval = _Interval(first, last, upper, path)
                heappush(self._heap, (-interval.upper, next(self._order), interval))

    def _bounded(self, pairs: Sequence[tuple[Sample, Sample]]) -> tuple[list[float], list[float]]:
        """Return for each interval the upper bound of its danger, and how far the robot moves in it [m]."""
        edges = np.array([first.edge for first, _ in pairs])
        h = np.array([last.t - first.t for first, last in pairs])
        known = (np.array([[pair[side].speed, pair[side].acceleration] for pair in pairs]) for side in (0, 1))
        speed, acceleration = self._rates.between(edges, h, *known)
        links = self._field.robot.segments
        bounds = speed[:, links].max(axis=2), acceleration[:, links].max(axis=2)
        uppers = [
            self._upper(*pair, *motion)
            for pair, *motion in zip(pairs, h.tolist(), *bounds, self._longest(pairs, edges, h), strict=True)
        ]
        return uppers, (speed.max(axis=1) * h).tolist()

    def _upper(
        self,
        first: Sample,
        last: Sample,
        h: float,
        speed: FloatArray,
        acceleration: FloatArray,
        lengths: FloatArray,
    ) -> float:
        """Return an upper bound of the danger between two samples.

        Aggregates are convex and grow with each level: above two ends of a line they are above all of it.
        """
        lines = chords(first.ends, last.ends, h, speed, acceleration, lengths)
        return float(self._field.aggregated(lines).max())

    def _longest(self, pairs: Sequence[tuple[Sample, Sample]], edges: IntArray, h: FloatArray) -> FloatArray:
        """Return the most that each link's unit field is multiplied by in each interval, (I, L)."""
        lengths = np.array([(first.lengths + last.lengths) / 2 for first, last in pairs])
        if self._field.weighting == "length" and self._lengths is None:
            lengths += (self._stroke_rates[edges] * h / 2)[:, None]
        return lengths


def _norm(vectors: FloatArray) -> FloatArray:
    norm: FloatArray = np.sqrt(np.einsum("bkc,bkc->bk", vectors, vectors))
    return norm


def _danger(sample: Sample) -> float:
    return sample.danger


def _check_strokes(robot: Robot, path: FloatArray) -> None:
    strokes = (
        robot.coupling.radii(robot.joint_prismatic.astype(np.float64)) > 0
    )  # they slide, or make another slide
    for q in path:
        for i in np.flatnonzero(~robot.within_limits(q) & strokes):
            raise InputError(
                f"joint {robot.joint_names[i]!r} = {q[i]:g} is outside its limits "
                f"[{robot.lower[i]:g}, {robot.upper[i]:g}]: nothing is proven of it there"
            )
