"""The curve of a trajectory: straight lines in joint space, with circular arcs for corners, by arc length."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from safe_ompl.common import FloatArray, IntArray

_WIDER = 1e-12  # relative: boxes hold what rounding makes of the curve


class CurvePoints(NamedTuple):
    """Configurations and their derivatives by arc length, each (S, n): q, q′ and q″."""

    q: FloatArray
    slope: FloatArray
    bend: FloatArray


@dataclass(frozen=True)
class Cells:
    """Pieces of a curve, with boxes that hold its derivatives.

    Attributes
    ----------
    edges : ndarray, shape (N + 1,)
        Arc lengths where the N cells begin and end.
    slope_low, slope_high, bend_low, bend_high : ndarray, shape (N, n)
        Boxes of q′ and q″ over whole cells.
    stops : ndarray of int
        Which edges are corners that cannot be driven through: there the robot stops.
    """

    edges: FloatArray
    slope_low: FloatArray
    slope_high: FloatArray
    bend_low: FloatArray
    bend_high: FloatArray
    stops: IntArray

    def __len__(self) -> int:
        return len(self.edges) - 1

    @property
    def sizes(self) -> FloatArray:
        """Lengths (N,) of the cells."""
        sizes: FloatArray = self.edges[1:] - self.edges[:-1]
        return sizes

    @property
    def centres(self) -> FloatArray:
        """Arc lengths (N,) in the middle of the cells."""
        centres: FloatArray = 0.5 * (self.edges[1:] + self.edges[:-1])
        return centres

    @property
    def slopes(self) -> FloatArray:
        """Bounds (N, n) of |q′|."""
        slopes: FloatArray = np.maximum(np.abs(self.slope_low), np.abs(self.slope_high))
        return slopes

    @property
    def bends(self) -> FloatArray:
        """Bounds (N, n) of |q″|."""
        bends: FloatArray = np.maximum(np.abs(self.bend_low), np.abs(self.bend_high))
        return bends


class Piece(NamedTuple):
    """A line, or an arc: q(σ) = start + r sin(σ/r)·forward + r (1 − cos(σ/r))·inward, with curvature 1/r.

    Attributes
    ----------
    start, forward, inward : ndarray, shape (n,)
        A configuration and two orthogonal unit vectors; the second one is zero for a line.
    length : float
        Its arc length.
    curvature : float
        0 for a line.
    """

    start: FloatArray
    forward: FloatArray
    inward: FloatArray
    length: float
    curvature: float

    def places(self, at: FloatArray) -> CurvePoints:
        """Return the places (S,) of the piece at arc lengths from its start."""
        if not self.curvature:
            still = np.zeros((len(at), len(self.start)))
            return CurvePoints(self.start + at[:, None] * self.forward, still + self.forward, still)
        angle = (at * self.curvature)[:, None]
        sin, cos = np.sin(angle), np.cos(angle)
        return CurvePoints(
            self.start + (sin * self.forward + (1 - cos) * self.inward) / self.curvature,
            cos * self.forward + sin * self.inward,
            self.curvature * (cos * self.inward - sin * self.forward),
        )

    def slope_box(self, first: FloatArray, last: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the box (S, n) of q′ between arc lengths first and last (S,); exact but for rounding."""
        return self._box(first, last, 0.0, 1.0)

    def bend_box(self, first: FloatArray, last: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the box (S, n) of q″; as `slope_box`."""
        return self._box(first, last, np.pi / 2, self.curvature)

    def _box(
        self, first: FloatArray, last: FloatArray, phase: float, scale: float
    ) -> tuple[FloatArray, FloatArray]:
        """Bound A cos(φ + phase − ψ), φ from first to last: the values at both ends, and ±A where it peaks between."""
        amplitude = scale * np.hypot(self.forward, self.inward)
        lag = phase - np.arctan2(self.inward, self.forward)
        begin, end = (side[:, None] * self.curvature + lag for side in (first, last))
        ends = amplitude * np.cos(begin), amplitude * np.cos(end)
        low, high = np.minimum(*ends), np.maximum(*ends)
        turn = 2 * np.pi
        high = np.where(np.floor(end / turn) > np.floor(begin / turn), amplitude, high)
        low = np.where(np.floor((end - np.pi) / turn) > np.floor((begin - np.pi) / turn), -amplitude, low)
        return low - _WIDER * amplitude, high + _WIDER * amplitude


class BlendedCurve:
    """Pieces one after the other.

    Parameters
    ----------
    pieces : sequence of Piece
        Each begins where the one before ends.
    stops : sequence of int
        Pieces that begin in another direction than the one before ends: corners.

    Attributes
    ----------
    pieces, stops
        As given, as tuples.
    starts : ndarray, shape (number of pieces,)
        Arc lengths where they begin.
    length : float
        [rad]
    """

    def __init__(self, pieces: list[Piece], stops: list[int]) -> None:
        self.pieces, self.stops = tuple(pieces), tuple(stops)
        ends = np.cumsum([piece.length for piece in pieces])
        self.starts: FloatArray = np.concatenate([[0.0], ends[:-1]])
        self.length = float(ends[-1])

    def __repr__(self) -> str:
        arcs = sum(piece.curvature > 0 for piece in self.pieces)
        return f"BlendedCurve({self.length:.3g} rad, {arcs} blends, {len(self.stops)} stops)"

    def rest(self, s: float) -> BlendedCurve:
        """Return the curve from an arc length 0 ≤ s < length on."""
        k = int(self.piece_at(np.array([s]))[0])
        first, *others = self.pieces[k:]
        cut = s - float(self.starts[k])
        place = first.places(np.array([cut]))
        inward = place.bend[0] / first.curvature if first.curvature else first.inward
        rest = Piece(place.q[0], place.slope[0], inward, first.length - cut, first.curvature)
        return BlendedCurve([rest, *others], [stop - k for stop in self.stops if stop > k])

    def piece_at(self, s: FloatArray) -> IntArray:
        """Return the piece (S,) at each of the arc lengths `s: (S,)`; the later one where two meet."""
        found: IntArray = np.searchsorted(self.starts, s, side="right") - 1
        return found

    def at(self, s: FloatArray, pieces: IntArray | None = None) -> CurvePoints:
        """Return the places (S, n) at arc lengths `s: (S,)` in any order; where two pieces meet, of those given."""
        which = self.piece_at(s) if pieces is None else pieces
        found = CurvePoints(*(np.empty((len(s), len(self.pieces[0].start))) for _ in range(3)))
        for k in np.unique(which):
            rows = which == k
            places = self.pieces[k].places(s[rows] - self.starts[k])
            for whole, part in zip(found, places, strict=True):
                whole[rows] = part
        return found

    def cells(self, step: float, turn: float = 0.1) -> Cells:
        """Return cells no longer than `step`; on arcs the direction changes by no more than `turn` [rad] in each."""
        bounds = []
        for piece in self.pieces:
            number = max(1, int(np.ceil(piece.length * max(1 / step, piece.curvature / turn))))
            bounds.append(np.linspace(0.0, piece.length, number + 1))
        return self._cells(bounds)

    def between(self, edges: FloatArray) -> Cells:
        """Return the cells between arc lengths `edges: (N + 1,)`, among which are all ends of pieces."""
        ends = np.append(self.starts[1:], self.length)
        last = np.searchsorted(edges, ends, side="right") - 1
        first = np.append(0, last[:-1])
        rows = zip(self.starts, first, last, strict=True)
        return self._cells([edges[a : b + 1] - start for start, a, b in rows])

    def divided(self, cells: Cells, parts: IntArray) -> Cells:
        """Return the cells, each in as many equal parts as `parts: (N,)` says."""
        bounds = []
        of = self.piece_at(cells.centres)
        for k, piece in enumerate(self.pieces):
            here = np.flatnonzero(of == k)
            starts, ends = cells.edges[here] - self.starts[k], cells.edges[here + 1] - self.starts[k]
            rows = [
                np.linspace(a, b, n, endpoint=False)
                for a, b, n in zip(starts, ends, parts[here].tolist(), strict=True)
            ]
            bounds.append(np.concatenate([*rows, [piece.length]]))
            bounds[-1][0] = 0.0
        return self._cells(bounds)

    def _cells(self, bounds: list[FloatArray]) -> Cells:
        """Return the cells between arc lengths that are given for each piece, from its start."""
        edges: list[FloatArray] = [np.zeros(1)]
        slopes: list[tuple[FloatArray, FloatArray]] = []
        bends: list[tuple[FloatArray, FloatArray]] = []
        stops, count = [], 0
        for k, (piece, at) in enumerate(zip(self.pieces, bounds, strict=True)):
            stops += [count] if k in self.stops else []
            edges.append(self.starts[k] + at[1:])
            slopes.append(piece.slope_box(at[:-1], at[1:]))
            bends.append(piece.bend_box(at[:-1], at[1:]))
            count += len(at) - 1
        slope_low, slope_high = (np.concatenate(side) for side in zip(*slopes, strict=True))
        bend_low, bend_high = (np.concatenate(side) for side in zip(*bends, strict=True))
        corners: IntArray = np.array(stops, dtype=np.intp)
        return Cells(np.concatenate(edges), slope_low, slope_high, bend_low, bend_high, corners)
