"""The curve of a trajectory: straight lines in joint space, and blends for corners that are proven as the edges are.

And bounds of how fast the bodies of a robot are along it, proven for whole cells.
"""

from __future__ import annotations

import logging
from dataclasses import dataclass
from functools import cached_property
from math import sqrt
from typing import Any, NamedTuple, Protocol

import numpy as np

from safe_ompl.collision import MotionProver, Verdict
from safe_ompl.common import BoolArray, FloatArray, InputError, IntArray, compiled
from safe_ompl.motions.kernels import Boxes
from safe_ompl.motions.limits import RateLimits
from safe_ompl.robot import Robot, plain
from safe_ompl.robot.kernels import move_joints, place_joints

_log = logging.getLogger(__name__)

_WIDER = 1e-12  # relative: boxes hold what rounding makes of the curve
_STRAIGHT = 1e-9  # turns by less than this are driven through as they are
_SMALLER = (1.0, 0.5, 0.25, 0.1, 0.03)  # of the blend that the tolerance allows: what is tried
BENDS = 0.9  # share of the jerk that q‴ṡ³ may take; the rest is left for accelerating along the curve
_SAME = 1e-12  # [rad] way points nearer than this are one
_SHORT = 1e-5  # [rad] on lines between blends that are shorter than this rounding would be a steep jump


class CurvePoints(NamedTuple):
    """Configurations and their derivatives by arc length, each (S, n): q, q′, q″ and q‴."""

    q: FloatArray
    slope: FloatArray
    bend: FloatArray
    swing: FloatArray


@dataclass(frozen=True)
class Cells:
    """N cells of a curve: boxes of q′ and q″ over whole cells, bounds (N, n) of |q‴|, and corners, `stops`."""

    edges: FloatArray
    boxes: Boxes
    swings: FloatArray
    stops: IntArray

    def __len__(self) -> int:
        return len(self.edges) - 1

    @property
    def sizes(self) -> FloatArray:
        """Lengths (N,) of the cells."""
        return np.asarray(self.edges[1:] - self.edges[:-1])

    @property
    def centres(self) -> FloatArray:
        """Arc lengths (N,) in the middle of the cells."""
        return np.asarray(0.5 * (self.edges[1:] + self.edges[:-1]))

    @cached_property
    def slopes(self) -> FloatArray:
        """Bounds (N, n) of |q′|."""
        return np.asarray(np.maximum(np.abs(self.boxes.slope_low), np.abs(self.boxes.slope_high)))

    @cached_property
    def bends(self) -> FloatArray:
        """Bounds (N, n) of |q″|."""
        return np.asarray(np.maximum(np.abs(self.boxes.bend_low), np.abs(self.boxes.bend_high)))


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
    """A cubic q(σ) = start + σ·slope + σ²/2·bend + σ³/6·swing, (n,) each, of an arc length; a line without bends."""

    start: FloatArray
    slope: FloatArray
    bend: FloatArray
    swing: FloatArray
    length: float

    @property
    def straight(self) -> bool:
        """Whether it is a line."""
        return not (self.bend.any() or self.swing.any())

    @property
    def powers(self) -> FloatArray:
        """Coefficients (4, n) of the powers of the share of its length, as `MotionProver.check_curve` takes them."""
        t = self.length
        return np.array([self.start, t * self.slope, t * t / 2 * self.bend, t * t * t / 6 * self.swing])

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
        return motion.check_curve(self.powers).verdict is Verdict.FREE

    def slope_box(self, first: FloatArray, last: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the box (S, n) of q′ between arc lengths first and last (S,), with what rounding adds."""
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
    """Pieces one after the other; those of `stops` begin in another direction than the one before ends: corners."""

    def __init__(self, pieces: list[Piece], stops: list[int]) -> None:
        self.pieces, self.stops = tuple(pieces), tuple(stops)
        ends = np.cumsum([piece.length for piece in pieces])
        self.starts: FloatArray = np.concatenate([[0.0], ends[:-1]])
        self.length = float(ends[-1])

    @classmethod
    def of(cls, parameters: FloatArray, coefficients: FloatArray, stops: list[int]) -> BlendedCurve:
        """Return cubics of powers (K, 4, n) of (s − s_k)/(s_{k+1} − s_k), one between each two of the parameters."""
        sizes = np.diff(parameters)
        parts = coefficients * np.array([1.0, 1.0, 2.0, 6.0])[:, None] / sizes[:, None, None] ** np.arange(4)[:, None]
        rows = zip(*(parts[:, k] for k in range(4)), sizes.tolist(), strict=True)
        return cls([Piece(*row) for row in rows], stops)

    def among(self, q: FloatArray, rows: list[int], shift: FloatArray) -> BlendedCurve:
        """Return the curve of more joints (n,): those in `rows` move as here, but for a shift, the others stay at q."""
        pieces = []
        for piece in self.pieces:
            start, slope, bend, swing = (np.zeros_like(q) for _ in range(4))
            start[:] = q
            start[rows], slope[rows], bend[rows], swing[rows] = (
                piece.start + shift,
                piece.slope,
                piece.bend,
                piece.swing,
            )
            pieces.append(Piece(start, slope, bend, swing, piece.length))
        return BlendedCurve(pieces, list(self.stops))

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
        return np.asarray(np.searchsorted(self.starts, s, side="right") - 1)

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
    """Return the path (N, n) with its corners rounded, within a tolerance [rad]; if it is 0 the robot stops in corners.

    Of the blends of `docs/mathematics.md` §9 the largest within the tolerance is taken that uses no more than half of
    either edge and is proven; where none is, or nothing proves it, the robot stops in the corner. An InputError if the
    path does not move.
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
            if _SAME * length < length - begun - longest < _SHORT:
                longest -= min(_SHORT, longest / 2)
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


# ------------------------------------------------------------------------------------ how fast bodies are along it


class _Boxes(NamedTuple):
    """Boxes about G bodies: Pinocchio's number of the joint, corners in its frame (G, 8, 3) and what is added [m]."""

    carriers: IntArray
    corners: FloatArray
    pads: FloatArray


@compiled
def box_speeds(joints: Any, boxes: _Boxes, values: FloatArray, rates: FloatArray) -> FloatArray:
    """Return how fast the points (B, G) of boxes are at most, at `values` and `rates` (B, m) of the joints."""
    B, m = values.shape
    found, twists = np.zeros((B, len(boxes.carriers))), np.empty((m, 6))
    rotation, origin, axis = np.empty((m, 3, 3)), np.empty((m, 3)), np.empty((m, 3))
    for b in range(B):
        place_joints(joints, values[b], rotation, origin, axis)
        move_joints(joints, rates[b], origin, axis, twists)
        for g in range(len(boxes.carriers)):
            joint = boxes.carriers[g] - 1
            if joint < 0:
                continue
            w, R, o = twists[joint], rotation[joint], origin[joint]
            most = 0.0
            for k in range(8):
                p = boxes.corners[g, k]
                x = o[0] + R[0, 0] * p[0] + R[0, 1] * p[1] + R[0, 2] * p[2]
                y = o[1] + R[1, 0] * p[0] + R[1, 1] * p[1] + R[1, 2] * p[2]
                z = o[2] + R[2, 0] * p[0] + R[2, 1] * p[1] + R[2, 2] * p[2]
                u, v = w[3] + w[1] * z - w[2] * y, w[4] + w[2] * x - w[0] * z
                most = max(most, u * u + v * v + (w[5] + w[0] * y - w[1] * x) ** 2)
            turning = sqrt(w[0] * w[0] + w[1] * w[1] + w[2] * w[2])
            found[b, g] = sqrt(most) + boxes.pads[g] * turning
    return found


class BodySpeeds:
    """Bounds of the speed of every point of a body of a robot, per unit of arc length, over the cells of a curve.

    At the centre of a cell it is exact for the corners of the body's bounding box, and convex between them. Away from
    it, it changes no faster than the acceleration allows: with r_j = R̄_j|q′_j|, w_j = |q′_j| where joint j turns and
    W_j the sum of w over the joints beneath, Σ r_j (2W_j + w_j) + Σ R̄_j |q″_j|; see
    `safe_ompl.danger.certified.KeypointRates`.
    """

    def __init__(self, robot: Robot) -> None:
        self._robot = robot
        joints, corners, pads, _ = robot.bounds.body_corners
        carriers = np.append(joints, robot.tip_joint)
        tip = np.tile(robot.tip_placement.translation, (1, 8, 1))
        self._boxes = _Boxes(carriers, np.concatenate([corners, tip]), np.append(pads, 0.0))
        self._radii: FloatArray = np.vstack([robot.bounds.joint_radii, robot.bounds.tip_radii])
        self._turned = robot.supporting_joints(carriers) & ~robot.joint_prismatic

    def bounds(self, curve: Curve, cells: Cells) -> FloatArray:
        """Return the bounds (N, G + 1) [m/rad]: of the G bodies of `collision_model`, and of the tip."""
        place = curve.at(cells.centres)
        half = cells.sizes[:, None] / 2
        values, rates = (plain(self._robot.coupling.values(place.q)), plain(self._robot.coupling.motions(place.slope)))
        found = box_speeds(self._robot.kinematics.joints, self._boxes, values, rates)
        return found + half * self.accelerations(cells)

    def accelerations(self, cells: Cells) -> FloatArray:
        """Return bounds (N, G + 1) of ‖x″‖ of all points of the bodies and of the tip [m/rad²]."""
        steps, bends = (plain(self._robot.coupling.reach(bound)) for bound in (cells.slopes, cells.bends))
        return acceleration_bounds(self._radii, self._turned, steps, bends)


@compiled
def acceleration_bounds(radii: FloatArray, turned: BoolArray, steps: FloatArray, bends: FloatArray) -> FloatArray:
    """Return bounds (N, G) of ‖x″‖ of every point of G bodies along a curve, by arc length; see `BodySpeeds`.

    R̄ of the m joints of the model are `radii: (G, m)`, `turned` says which of them turn each body; `steps` and `bends`,
    (N, m), are bounds of their |q′| and |q″|.
    """
    (N, m), G = steps.shape, len(radii)
    found = np.zeros((N, G))
    for k in range(N):
        for g in range(G):
            below = 0.0
            for j in range(m):
                turn = steps[k, j] if turned[g, j] else 0.0
                found[k, g] += radii[g, j] * (steps[k, j] * (2 * below + turn) + bends[k, j])
                below += turn
    return found
