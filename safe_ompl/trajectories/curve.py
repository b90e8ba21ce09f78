"""The curve of a trajectory: straight lines in joint space, with arcs for corners that are proven as the edges are."""

from __future__ import annotations

import logging
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from safe_ompl.collision import CertifiedMotion
from safe_ompl.common import FloatArray, InputError, IntArray
from safe_ompl.danger import DangerLimit
from safe_ompl.robot import Robot

_log = logging.getLogger(__name__)

_WIDER = 1e-12  # relative: boxes hold what rounding makes of the curve
_STRAIGHT = 1e-9  # [rad] turns below this are driven through as they are
_SMALLER = (1.0, 0.5, 0.25, 0.1, 0.03)  # of the arc that the tolerance allows: what is tried
_SAME = 1e-12  # [rad] way points nearer than this are one


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


def blended(path: FloatArray, robot: Robot, tolerance: float, motion: CertifiedMotion | None) -> BlendedCurve:
    """Return the path (N, n) with its corners rounded.

    An arc that leaves the edges at a distance l from a corner where the path turns by α has the radius l/tan(α/2), and
    is l tan(α/4) away from the corner at most. The largest one within the tolerance is taken that uses
    no more than half of either edge and is proven; where none is, the robot stops in the corner.

    Parameters
    ----------
    path : ndarray, shape (N, n)
        Way points.
    robot : Robot
        The robot.
    tolerance : float
        How far the curve may be from the path [rad]; 0: it stops in every corner.
    motion : CertifiedMotion, optional
        What proves arcs; without it there are none.

    Raises
    ------
    InputError
        If the path does not move.
    """
    steps = robot.difference(path[:-1], path[1:])
    moves = np.linalg.norm(steps, axis=1) > _SAME
    if not moves.any():
        raise InputError("the path does not move: give two different way points at least")
    steps = steps[moves]
    points = path[0] + np.vstack(
        [np.zeros((1, robot.n)), np.cumsum(steps, axis=0)]
    )  # continuous joints unrolled
    lengths = np.linalg.norm(steps, axis=1)
    units = steps / lengths[:, None]
    proof = None if motion is None or not tolerance else ArcProof(motion)

    pieces: list[Piece] = []
    stops: list[int] = []
    begun = 0.0  # of the edge, used by the arc before
    for k, (unit, length) in enumerate(zip(units, lengths.tolist(), strict=True)):
        arc, room = None, 0.0
        last = k == len(units) - 1
        if not last:
            arc, room = _arc(
                points[k + 1], unit, units[k + 1], min(length, lengths[k + 1]) / 2, tolerance, proof
            )
        line = length - begun - room
        if line > _SAME * length:
            pieces.append(Piece(points[k] + begun * unit, unit, np.zeros(robot.n), line, 0.0))
        if arc is not None:
            pieces.append(arc)
        elif not last and _turn(unit, units[k + 1]) > _STRAIGHT:
            stops.append(len(pieces))
        begun = room
    if stops:
        why = "no arc is proven there" if proof else "nothing proves arcs" if tolerance else "tolerance 0"
        _log.info("the robot stops in %d of %d corners: %s", len(stops), len(units) - 1, why)
    return BlendedCurve(pieces, stops)


def _turn(first: FloatArray, second: FloatArray) -> float:
    """Return the angle between two unit vectors [rad]."""
    return float(2 * np.arctan2(np.linalg.norm(second - first), np.linalg.norm(second + first)))


def _arc(
    corner: FloatArray,
    first: FloatArray,
    second: FloatArray,
    room: float,
    tolerance: float,
    proof: ArcProof | None,
) -> tuple[Piece | None, float]:
    """Return a proven arc and how much of the edges it takes."""
    turn = _turn(first, second)
    if proof is None or turn <= _STRAIGHT or turn >= np.pi - _STRAIGHT:
        return None, 0.0
    inward = second - np.cos(turn) * first
    inward = inward - (inward @ first) * first
    inward /= np.linalg.norm(inward)
    longest = min(room, tolerance / np.tan(turn / 4))
    for share in _SMALLER:
        l = share * longest  # noqa: E741 - the formula's name
        radius = l / np.tan(turn / 2)
        arc = Piece(corner - l * first, first, inward, radius * turn, 1 / radius)
        if proof.holds(arc):
            return arc, l
    return None, 0.0


class ArcProof:
    """Proves arcs free, and within the limits of danger, as `CertifiedMotion` proves straight motions.

    Parameters
    ----------
    motion : CertifiedMotion
        Robot, scene, floor, and what must be kept.
    """

    def __init__(self, motion: CertifiedMotion) -> None:
        self._checker, self._floor = motion.checker, motion.floor
        self._required = motion.separation.required(motion.checker)
        self._limits = [limit for limit in motion.limits if isinstance(limit, DangerLimit)]
        self._unknown = len(self._limits) < len(motion.limits)
        if self._unknown:
            _log.warning("limits other than those of danger are not proven on arcs: corners stay as they are")

    def holds(self, arc: Piece) -> bool:
        """Return whether the arc is proven, by bisection.

        While the joints move along half an interval, pair p approaches by at most Σ_i R_pi ∫|q′_i|: an interval at
        whose centre every pair keeps more than that, and what it must keep besides, is free.
        """
        if self._unknown:
            return False
        intervals = [(0.0, arc.length)]
        while intervals:
            first, last = intervals.pop()
            middle = (first + last) / 2
            low, high = arc.slope_box(np.array([first]), np.array([last]))
            steps = np.maximum(np.abs(low), np.abs(high))[0] * (last - first) / 2
            q = arc.places(np.array([middle])).q[0]
            approach = self._required.pairs.radii @ steps
            free = not self._required.pairs.within_margins(q, approach + self._required.provable(0.0))
            if free and all(limit.holds_within(q, steps) for limit in self._limits):
                continue
            if 2 * approach.max(initial=0.0) < self._floor or (not free and self._checker.touches(q)):
                return False
            if not all(limit.allows(q) for limit in self._limits):
                return False
            intervals += [(first, middle), (middle, last)]
        return True
