"""The curve of a trajectory: straight lines in joint space, and blends for corners that are proven as the edges are."""

from __future__ import annotations

import logging
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple, Protocol

import numpy as np

from safe_ompl.collision import MotionProver, Verdict
from safe_ompl.common import FloatArray, InputError, IntArray
from safe_ompl.robot import Robot
from safe_ompl.trajectories.kernels import Boxes
from safe_ompl.trajectories.limits import RateLimits

_log = logging.getLogger(__name__)

_WIDER = 1e-12  # relative: boxes hold what rounding makes of the curve
_STRAIGHT = 1e-9  # turns by less than this are driven through as they are
_SMALLER = (1.0, 0.5, 0.25, 0.1, 0.03)  # of the blend that the tolerance allows: what is tried
BENDS = 0.9  # share of the jerk that q‴ṡ³ may take; the rest is left for accelerating along the curve
_SAME = 1e-12  # [rad] way points nearer than this are one


class CurvePoints(NamedTuple):
    """Configurations and their derivatives by arc length, each (S, n): q, q′, q″ and q‴."""

    q: FloatArray
    slope: FloatArray
    bend: FloatArray
    swing: FloatArray


@dataclass(frozen=True)
class Cells:
    """Pieces of a curve, with boxes that hold its derivatives.

    Attributes
    ----------
    edges : ndarray, shape (N + 1,)
        Arc lengths where the N cells begin and end.
    boxes : Boxes
        Boxes of q′ and q″ over whole cells, (N, n) each.
    swings : ndarray, shape (N, n)
        Bounds of |q‴|.
    stops : ndarray of int
        Which edges are corners that cannot be driven through: there the robot stops.
    """

    edges: FloatArray
    boxes: Boxes
    swings: FloatArray
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

    @cached_property
    def slopes(self) -> FloatArray:
        """Bounds (N, n) of |q′|."""
        slopes: FloatArray = np.maximum(np.abs(self.boxes.slope_low), np.abs(self.boxes.slope_high))
        return slopes

    @cached_property
    def bends(self) -> FloatArray:
        """Bounds (N, n) of |q″|."""
        bends: FloatArray = np.maximum(np.abs(self.boxes.bend_low), np.abs(self.boxes.bend_high))
        return bends


class Curve(Protocol):
    """A curve that has cells; its parameter is an arc length, or a time."""

    def at(self, s: FloatArray) -> CurvePoints:
        """Return the places (S, n) at parameters `s: (S,)`."""

    def between(self, edges: FloatArray) -> Cells:
        """Return the cells between parameters `edges: (N + 1,)`, among which are all ends of its pieces."""


def divided_edges(edges: FloatArray, parts: IntArray) -> FloatArray:
    """Return the edges of cells that are divided, each in as many equal parts as `parts: (N,)` says."""
    inside = np.arange(int(parts.sum())) - np.repeat(np.cumsum(parts) - parts, parts)
    starts = np.repeat(edges[:-1], parts) + inside / np.repeat(parts, parts) * np.repeat(np.diff(edges), parts)
    return np.append(starts, edges[-1])


class Piece(NamedTuple):
    """A cubic q(σ) = start + σ·slope + σ²/2·bend + σ³/6·swing; a line if bend and swing vanish.

    Attributes
    ----------
    start, slope, bend, swing : ndarray, shape (n,)
        q, q′, q″ and q‴ where it begins.
    length : float
        Its arc length.
    """

    start: FloatArray
    slope: FloatArray
    bend: FloatArray
    swing: FloatArray
    length: float

    @property
    def straight(self) -> bool:
        """Whether it is a line."""
        return not (self.bend.any() or self.swing.any())

    def places(self, at: FloatArray) -> CurvePoints:
        """Return the places (S,) of the piece at arc lengths from its start."""
        t = at[:, None]
        bend = self.bend + t * self.swing
        slope = self.slope + t * (self.bend + bend) / 2
        q = self.start + t * (self.slope + t * (self.bend / 2 + t * self.swing / 6))
        return CurvePoints(q, slope, bend, np.broadcast_to(self.swing, q.shape))

    def is_free(self, motion: MotionProver) -> bool:
        """Return whether the piece is proven free, and to keep the limits of the motion, as its edges are."""
        if self.straight:
            return motion.is_free(self.start, self.start + self.length * self.slope)
        coefficients = self.start, self.slope, self.bend / 2, self.swing / 6
        scaled = [self.length**k * coefficient for k, coefficient in enumerate(coefficients)]
        return motion.check_curve(scaled).verdict is Verdict.FREE

    def slope_box(self, first: FloatArray, last: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the box (S, n) of q′ between arc lengths first and last (S,); exact but for rounding."""
        turns = np.divide(-self.bend, self.swing, out=np.zeros_like(self.bend), where=self.swing != 0)
        inside = np.clip(turns, first[:, None], last[:, None])  # where q″ vanishes
        places = first[:, None], last[:, None], inside
        return _box(*(self.slope + t * (self.bend + t * self.swing / 2) for t in places))

    def bend_box(self, first: FloatArray, last: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the box (S, n) of q″; as `slope_box`."""
        return _box(*(self.bend + t[:, None] * self.swing for t in (first, last)))


def _box(first: FloatArray, *values: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the box of values (S, n), with what rounding adds."""
    low = high = first
    for value in values:
        low, high = np.minimum(low, value), np.maximum(high, value)
    return low - _WIDER * np.abs(low), high + _WIDER * np.abs(high)


class BlendedCurve:
    """Pieces one after the other.

    Arc lengths are those of the path whose corners the blends round: on a blend, which is shorter, ‖q′‖ ≤ 1.

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
        bent = sum(not piece.straight for piece in self.pieces)
        return f"BlendedCurve({self.length:.3g} rad, {bent} bent pieces, {len(self.stops)} stops)"

    def rest(self, s: float) -> BlendedCurve:
        """Return the curve from an arc length 0 ≤ s < length on."""
        k = int(self.piece_at(np.array([s]))[0])
        first, *others = self.pieces[k:]
        cut = s - float(self.starts[k])
        q, slope, bend, _ = (values[0] for values in first.places(np.array([cut])))
        rest = Piece(q, slope, bend, first.swing, first.length - cut)
        return BlendedCurve([rest, *others], [stop - k for stop in self.stops if stop > k])

    def piece_at(self, s: FloatArray) -> IntArray:
        """Return the piece (S,) at each of the arc lengths `s: (S,)`; the later one where two meet."""
        found: IntArray = np.searchsorted(self.starts, s, side="right") - 1
        return found

    def at(self, s: FloatArray, pieces: IntArray | None = None) -> CurvePoints:
        """Return the places (S, n) at arc lengths `s: (S,)` in any order; where two pieces meet, of those given."""
        which = self.piece_at(s) if pieces is None else pieces
        return self._rows(which).places(s - self.starts[which])

    def _rows(self, which: IntArray) -> Piece:
        """Return pieces (S,) as one, whose attributes are rows (S, n)."""
        start, slope, bend, swing = (part[which] for part in self._parts)
        return Piece(start, slope, bend, swing, self.length)

    @cached_property
    def _parts(self) -> tuple[FloatArray, ...]:
        """The first four attributes of all pieces, each (number of pieces, n)."""
        return tuple(np.array(part) for part in list(zip(*self.pieces, strict=True))[:4])

    def cells(self, step: float, turn: float = 0.1) -> Cells:
        """Return cells no longer than `step`; on blends q′ changes by no more than `turn` in each."""
        if (step, turn) not in self._known:
            _, _, bends, swings = self._parts
            lengths = np.array([piece.length for piece in self.pieces])
            turned = np.linalg.norm(lengths[:, None] * (bends + lengths[:, None] * swings / 2), axis=1)
            numbers = np.maximum(1, np.ceil(np.maximum(lengths / step, turned / turn))).astype(int).tolist()
            rows = zip(lengths.tolist(), numbers, strict=True)
            self._known[step, turn] = self._cells([np.linspace(0.0, end, n + 1) for end, n in rows])
        return self._known[step, turn]

    @cached_property
    def _known(self) -> dict[tuple[float, float], Cells]:
        """Cells that were asked for."""
        return {}

    def between(self, edges: FloatArray) -> Cells:
        """Return the cells between arc lengths `edges: (N + 1,)`, among which are all ends of pieces."""
        ends = np.append(self.starts[1:], self.length)
        # Sums of lengths are rounded: an end of a piece is the edge that is nearest.
        last = np.searchsorted(0.5 * (edges[1:] + edges[:-1]), ends)
        first = np.append(0, last[:-1])
        rows = zip(self.starts, first, last, strict=True)
        return self._cells([edges[a : b + 1] - start for start, a, b in rows])

    def _cells(self, bounds: list[FloatArray]) -> Cells:
        """Return the cells between arc lengths that are given for each piece, from its start."""
        counts = np.array([len(at) - 1 for at in bounds])
        which: IntArray = np.repeat(np.arange(len(bounds)), counts)
        first, last = (np.concatenate([at[side] for at in bounds]) for side in (np.s_[:-1], np.s_[1:]))
        pieces = self._rows(which)
        corners: IntArray = (np.cumsum(counts) - counts)[sorted(self.stops)].astype(np.intp)
        return Cells(
            np.append(0.0, self.starts[which] + last),
            Boxes(*pieces.slope_box(first, last), *pieces.bend_box(first, last)),
            np.abs(pieces.swing),
            corners,
        )


def blended(
    path: FloatArray, robot: Robot, tolerance: float, motion: MotionProver | None, limits: RateLimits | None = None
) -> BlendedCurve:
    """Return the path (N, n) with its corners rounded.

    A blend leaves the edges at a distance l from a corner: over the length 2l its q′ goes from one edge's direction to
    the other's, by Δ. With constant q″ = Δ/2l, a parabola, it is |Δ|l/4 away from the corner at most. Where the jerk is
    limited q″ rises to Δ/2l(1 − ρ), stays, and falls, the first and the last of these within the share ρ of 2l each.
    The largest blend within the tolerance is taken that uses no more than half of either edge and is proven; where none
    is, the robot stops in the corner.

    Parameters
    ----------
    path : ndarray, shape (N, n)
        Way points.
    robot : Robot
        The robot.
    tolerance : float
        How far the curve may be from the path [rad]; 0: it stops in every corner.
    motion : MotionProver, optional
        What proves blends; without it there are none.
    limits : RateLimits, optional
        If they limit the jerk q″ is continuous.

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
    points = path[0] + np.vstack([np.zeros((1, robot.n)), np.cumsum(steps, axis=0)])  # continuous joints unrolled
    lengths = np.linalg.norm(steps, axis=1)
    units = steps / lengths[:, None]
    proof = motion if tolerance else None
    pieces: list[Piece] = []
    stops: list[int] = []
    begun = 0.0  # of the edge, used by the blend before
    for k, (unit, length) in enumerate(zip(units, lengths.tolist(), strict=True)):
        blend, room = list[Piece](), 0.0
        last = k == len(units) - 1
        bends = not last and np.linalg.norm(units[k + 1] - unit) > _STRAIGHT
        if bends and proof is not None:
            longest = min(length, lengths[k + 1]) / 2
            blend, room = _blend(points[k + 1], unit, units[k + 1], longest, tolerance, proof, limits)
        line = length - begun - room
        if line > _SAME * length:
            still = np.zeros(robot.n)
            pieces.append(Piece(points[k] + begun * unit, unit, still, still, line))
        pieces += blend
        if bends and not blend:
            stops.append(len(pieces))
        begun = room
    if stops:
        why = "no blend is proven there" if proof else "nothing proves blends" if tolerance else "tolerance 0"
        _log.info("the robot stops in %d of %d corners: %s", len(stops), len(units) - 1, why)
    return BlendedCurve(pieces, stops)


def _blend(
    corner: FloatArray,
    first: FloatArray,
    second: FloatArray,
    room: float,
    tolerance: float,
    proof: MotionProver,
    limits: RateLimits | None,
) -> tuple[list[Piece], float]:
    """Return a proven blend and how much of the edges it takes."""
    change = second - first
    longest = min(room, 4 * tolerance / float(np.linalg.norm(change)))
    for share in _SMALLER:
        reach = share * longest
        ramp = _ramp(np.abs(change), 2 * reach, limits)
        top = change / (2 * reach * (1 - ramp))
        still = np.zeros_like(change)
        swing = top / (2 * reach * ramp) if ramp else still
        parts = ((still, swing, ramp), (top, still, 1 - 2 * ramp), (top, -swing, ramp))
        blend: list[Piece] = []
        q, slope = corner - reach * first, first
        for bend, swing, part in parts:
            if part > 0:
                piece = Piece(q, slope, bend, swing, 2 * reach * part)
                end = piece.places(np.array([piece.length]))
                q, slope = end.q[0], end.slope[0]
                blend.append(piece)
        if all(piece.is_free(proof) for piece in blend):
            return blend, reach
    return [], 0.0


def _ramp(change: FloatArray, length: float, limits: RateLimits | None) -> float:
    """Return the share of a blend in which q″ rises: a speed that needs all of the acceleration bears the jerk."""
    if limits is None or limits.jerk is None:
        return 0.0
    with np.errstate(divide="ignore"):
        push = float((limits.acceleration / change).min())
        jerk = float((BENDS * limits.jerk / change).min())
    c = push**1.5 / (jerk * length**0.5)
    return float(min(0.5, c * (np.sqrt(c * c + 4) - c) / 2))
