"""The motions and time laws of a certificate, evaluated by simple methods.

**Motions.** A piece is a Bézier curve. Its control points, and those of its derivatives, are computed exactly, in
rational numbers; those of its parts by de Casteljau's algorithm. A part, and every derivative, lies in the box of its
control points.

**Time laws.** ṡ² is linear in each cell between two grid points. Alternatively such a law is a plan σ, and s(t) is its
average over the window from t − w to t. At corners the plan waits for w. In a window with σ̇ ≤ m every σ(τ) is within m
w/2 of the average. So while the robot is in cell k, the largest σ̇ = m of the window is reached in a cell within m w/2,
and all σ(τ) are in such cells.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Sequence
from fractions import Fraction
from itertools import pairwise
from math import comb, sqrt
from typing import NamedTuple

import numpy as np

from safe_ompl.certificates.claims import ClaimedMotion, ClaimedTrajectory
from safe_ompl.common import BoolArray, CertificateError, FloatArray
from safe_ompl.robot import Robot

# Tolerances of positions, velocities, accelerations and jerks above their limits, and of jumps of continuous values.
# Certificates are issued with half of the tolerances of derivatives.
ABOVE = (1e-6, 2e-6, 2e-6, 2e-3)  # [rad or m, s]
# Tolerance of the joints between the pieces of a time law's curve, and of the ends of the curve and the path.
_EQUAL_POSITIONS = 1e-9  # [rad]
# Under a time law, smaller jumps of velocities (and of accelerations, if the jerk is limited) are rounding errors.
_EQUAL_RATES = 1e-6  # [rad/s, rad/s²]
# Under a time law, largest jumps of positions, velocities and accelerations per time of a piece.
_MOST_JUMP_RATES = (1e-8, 1e-6, 1e-3)  # [rad, s]
# Tolerances of velocities, accelerations and jerks above their limits, under a time law.
_TIME_LAW_TOLERANCES = (1e-8, 1e-7, 1e-4)  # [rad, s]
# Relative rounding of the reach; for grid points, relative to the shorter neighbouring piece.
_REACH_ROUNDING = 1e-9
_LONGEST_PATH = 1e4  # [rad]
_MOST_HALVINGS = 60


class RecordedPiece(NamedTuple):
    """A polynomial of a parameter from 0 to `length`, by its control points.

    `rows` are the control points of its values, (d + 1, n), and of its derivatives with respect to the parameter.
    `width` bounds the deviation of the joints (n,) from the polynomial.
    """

    name: str
    rows: Sequence[FloatArray]
    length: float = 1.0
    width: FloatArray | float = 0.0

    @property
    def points(self) -> FloatArray:
        """The control points (d + 1, n) of its values."""
        return self.rows[0]

    @property
    def steps(self) -> FloatArray:
        """Bounds (n,) of the speeds of the joints, per share of the piece."""
        return self.length * self.most(1)

    def at(self, s: float, order: int = 0) -> FloatArray:
        """Return the values (n,), or a derivative, at parameter s."""
        row, t = self.rows[order], s / self.length
        while len(row) > 1:
            row = (1 - t) * row[:-1] + t * row[1:]
        return np.asarray(row[0])

    def most(self, order: int) -> FloatArray:
        """Return a bound (n,) of the absolute value of a derivative."""
        return np.asarray(np.abs(self.rows[order]).max(axis=0))

    def between(self, order: int, first: float, last: float) -> tuple[FloatArray, FloatArray]:
        """Return lower and upper bounds (n,) of a derivative between two parameter values."""
        points, end = self.rows[order], min(last / self.length, 1.0)
        if len(points) > 1:
            points = halves(points, end)[0]
            points = halves(points, min(max(first / last, 0.0), 1.0))[1]
        return points.min(axis=0), points.max(axis=0)


class RecordedMotion:
    """The pieces of a motion, and the preceding motion if there is one."""

    def __init__(self, claim: ClaimedMotion, before: RecordedMotion | None = None) -> None:
        self.claim, self.before = claim, before
        self.kind = "trajectory" if isinstance(claim, ClaimedTrajectory) else "motion"
        self.pieces = []
        for k, (coefficients, (begin, end)) in enumerate(
            zip(claim.coefficients, pairwise(claim.times.tolist()), strict=True)
        ):
            span = Fraction(end) - Fraction(begin)
            name = f"piece {k} of the {self.kind}"
            self.pieces.append(RecordedPiece(name, derivatives(coefficients, span), float(span)))
        self.begin = [row[0] for row in self.pieces[0].rows]
        self.end = [row[-1] for row in self.pieces[-1].rows]

    def jumps(self, order: int) -> FloatArray:
        """Return the jumps (K, n) of a derivative at the beginnings of the pieces."""
        ends = [piece.rows[order][-1] for piece in self.pieces[:-1]]
        first = self.begin[order]
        comparable = self.before is not None and (order == 0 or (self.claim.timed and self.before.claim.timed))
        last = self.before.end[order] if self.before is not None and comparable else first
        return np.array(
            [np.abs(piece.rows[order][0] - end) for piece, end in zip(self.pieces, [last, *ends], strict=True)]
        )

    def check_joined(self) -> None:
        """Raise CertificateError unless it continues the preceding motion: at equal velocity, or both at rest."""
        before, claim = self.before, self.claim
        if before is None:
            return
        apart = self.jumps(0)[0].max()
        if apart > ABOVE[0]:
            raise CertificateError(f"it begins {apart:.3g} rad or m from where the one before ends")
        for one, velocity in ((self, self.begin[1]), (before, before.end[1])):
            if before.claim.timed != claim.timed and one.claim.timed and np.abs(velocity).max() > ABOVE[1]:
                raise CertificateError("it meets the one before, of which one is not in time, but does not rest there")
        limited = claim.jerk is not None or before.claim.jerk is not None
        for order, kind, unit in ((1, "velocity", "rad/s or m/s"), (2, "acceleration", "rad/s² or m/s²"))[
            : 1 + limited
        ]:
            jump = self.jumps(order)[0].max()
            if jump > ABOVE[order]:
                raise CertificateError(f"its {kind} begins {jump:.3g} {unit} from that with which the one before ends")


def derivatives(coefficients: FloatArray, span: Fraction) -> list[FloatArray]:
    """Return the control points (d − k + 1, n), at least one, of the k-th time derivative, for k = 0 … 3."""
    degree, powers = len(coefficients) - 1, [list(map(Fraction, row)) for row in coefficients.tolist()]
    rows = [
        [sum(Fraction(comb(i, k), comb(degree, k)) * c[k] for k in range(i + 1)) for c in zip(*powers, strict=True)]
        for i in range(degree + 1)
    ]
    found = []
    for left in range(degree, degree - 4, -1):
        found.append(np.array(rows, dtype=np.float64))
        rows = [[left * (b - a) / span for a, b in zip(*both, strict=True)] for both in pairwise(rows)] or [
            [Fraction(0)] * len(rows[0])
        ]
    return found


def halves(points: FloatArray, share: float = 0.5) -> tuple[FloatArray, FloatArray]:
    """Return the control points of the two parts of a curve, divided at a share, by de Casteljau's algorithm."""
    before, after = [], []
    while len(points):
        before.append(points[0])
        after.append(points[-1])
        points = (1 - share) * points[:-1] + share * points[1:]
    return np.array(before), np.array(after[::-1])


class RecordedLaw:
    """The time law on a curve. Raises CertificateError unless it is one motion between the ends of a path.

    The pieces of the curve begin at parameter values `starts`. At `edges`, (C + 1,), ṡ² is `squares`: of the plan, if
    the `window` [s] is not 0. For each of the C cells, `of` is the piece, `ends` the next grid point at which the robot
    stops, and `fastest` a bound of ṡ.
    """

    def __init__(self, claim: ClaimedTrajectory, curve: RecordedMotion, path: RecordedMotion, robot: Robot) -> None:
        self.pieces: list[RecordedPiece] = curve.pieces
        self.starts: list[float] = claim.times.tolist()
        for k, piece in enumerate(self.pieces):
            if not piece.length <= _LONGEST_PATH:
                raise CertificateError(f"trajectory: piece {k} is no curve")
        corners = list(claim.corners)
        if any(not 0 < k < len(self.pieces) for k in corners):
            raise CertificateError(f"trajectory: {corners} are not corners between its pieces")
        self._check_joined(robot, curve, path)
        self.edges, self.squares = claim.edges, claim.squares
        if len(self.edges) != len(self.squares):
            raise CertificateError("trajectory: must have one speed for each grid point")
        self.window = claim.window or 0.0
        self.of = self._check_grid()
        self._corners = [self._grid_point(self.starts[k]) for k in corners]
        stops = {0, len(self.edges) - 1, *self._corners}
        for j in sorted(stops):
            if self.squares[j] != 0:
                where = f"{self.edges[j]:.6f} rad"
                raise CertificateError(f"trajectory: it does not stand at {where}, where it must")
        self.ends = np.array([min(j for j in stops if j > cell) for cell in range(len(self.of))])
        self._begins = np.array([max(j for j in stops if j <= cell) for cell in range(len(self.of))])
        self._check_smooth(curve, corners)
        self._average = PlainAverage(self.edges, self.squares, self._corners, self.window)
        self.fastest = self.fastest_near(np.sqrt(np.maximum(self.squares[1:], self.squares[:-1])))

    @property
    def duration(self) -> float:
        """Duration [s]."""
        return self._average.duration

    @property
    def path_accelerations(self) -> FloatArray:
        """s̈ (C,) in each cell; of the plan, if there is a window."""
        return np.diff(self.squares) / (2 * np.diff(self.edges))

    def rates_between(self, cell: int, first: float, last: float) -> tuple[float, float]:
        """Return the least and the largest ṡ, or bounds of them, between two arc lengths of a cell."""
        if not self.window:
            begin, end = self.edges[cell], self.edges[cell + 1]
            squares = np.interp([first, last], [begin, end], self.squares[cell : cell + 2])
            return float(np.sqrt(squares.min())), float(np.sqrt(squares.max()))
        times = [self._average.passed(cell, s) for s in (first, last)]
        rates = [self._average.rate(t) for t in times]
        more = max(times[1] - times[0], 0.0) / 2 * float(np.abs(self.path_accelerations).max())
        return max(min(rates) - more, 0.0), max(rates) + more

    def near(self, k: int, speeds: FloatArray) -> BoolArray:
        """Return the cells (C,) where the plan may reach its largest σ̇ of the window while the robot is in cell k.

        `speeds: (C,)` are the values of σ̇ in the cells.
        """
        cells = np.arange(len(self.of))
        if not self.window:
            return np.asarray(cells == k)
        away = np.maximum(self.edges[:-1] - self.edges[k + 1], self.edges[k] - self.edges[1:])
        between = (cells >= self._begins[k]) & (cells < self.ends[k])
        return np.asarray(between & (away <= np.maximum(self.window / 2 * speeds * (1 - _REACH_ROUNDING), 0.0)))

    def fastest_near(self, speeds: FloatArray) -> FloatArray:
        """Return bounds (C,) of ṡ in the cells for a plan with σ̇ ≤ `speeds: (C,)` in the cells."""
        return np.array([speeds[self.near(k, speeds)].max() for k in range(len(self.of))])

    @staticmethod
    def _check_joined(robot: Robot, curve: RecordedMotion, path: RecordedMotion) -> None:
        for name, q, wanted in (("begin", curve.begin[0], path.begin[0]), ("end", curve.end[0], path.end[0])):
            if np.abs(robot.difference(q, wanted)).max() > _EQUAL_POSITIONS:
                raise CertificateError(f"trajectory: the curve does not {name} where the path does")
        for k in np.flatnonzero((curve.jumps(0) > _EQUAL_POSITIONS).any(axis=1)).tolist():
            raise CertificateError(f"trajectory: piece {k} does not begin where the one before ends")

    def _check_grid(self) -> list[int]:
        """Return the piece of each cell. Raises an error if cells are not in order, or a cell is in two pieces."""
        edges = self.edges
        if len(edges) < 2 or not (np.diff(edges) > 0).all() or edges[0] != self.starts[0]:
            raise CertificateError("trajectory: its grid points are not in order")
        if (
            abs(edges[-1] - self.starts[-1]) > 1e3 * _REACH_ROUNDING * self.pieces[-1].length
            or not (self.squares >= 0).all()
        ):
            raise CertificateError("trajectory: its grid points do not cover the curve")
        for k, (before, after) in enumerate(pairwise(self.pieces), 1):
            away = abs(edges[self._grid_point(self.starts[k])] - self.starts[k])
            if away > 1e3 * _REACH_ROUNDING * min(before.length, after.length):
                raise CertificateError(f"trajectory: piece {k} does not begin at a grid point")
        if (self.squares[1:] + self.squares[:-1] == 0).any():
            raise CertificateError("trajectory: the speed is 0 at two neighbouring grid points")
        middles = (edges[1:] + edges[:-1]) / 2
        return [min(max(int(k) - 1, 0), len(self.pieces) - 1) for k in np.searchsorted(self.starts, middles)]

    def _grid_point(self, s: float) -> int:
        return int(np.abs(self.edges - s).argmin())

    def _check_smooth(self, curve: RecordedMotion, corners: list[int]) -> None:
        """Raise CertificateError if velocity or acceleration jumps between pieces.

        A jump J at the beginning of a piece of length h also counts as the rate Jṡ/h, which excludes many small jumps.
        """
        speed = sqrt(float(self.squares.max()))
        orders = range(3 if self.window else 2)
        largest = np.array([curve.jumps(order).max(axis=1) * speed**order for order in orders])
        for k in range(1, len(self.pieces)):
            jumps = largest[: 1 if k in corners else None, k]
            if max(jumps[1:2], default=0.0) > _EQUAL_RATES:
                raise CertificateError(f"trajectory: piece {k} begins in another direction, but is no corner")
            if max(jumps[2:], default=0.0) > _EQUAL_RATES:
                raise CertificateError(f"trajectory: the acceleration jumps where piece {k} begins")
            length = self.pieces[k].length
            if any(jump * speed > most * length for jump, most in zip(jumps, _MOST_JUMP_RATES, strict=False)):
                raise CertificateError(f"trajectory: piece {k} is too short for the jump where it begins")

    def exceeded(self, claim: ClaimedTrajectory, squares: FloatArray, path_accelerations: FloatArray) -> str | None:
        """Return a text with the joint that exceeds a claimed limit, and where, or None.

        In each cell the law, or its plan, is in the convex hull of pairs of ṡ² and s̈: `squares` and
        `path_accelerations`, each (C, K).
        """
        velocity, acceleration, jerk = claim.velocity, claim.acceleration, claim.jerk
        assert velocity is not None
        assert acceleration is not None
        if jerk is not None and not self.window:
            return "the jerk is not limited"
        most = self.fastest_near(np.sqrt(squares.max(axis=1)))
        for k, fastest in enumerate(most.tolist()):
            piece, start = self.pieces[self.of[k]], self.starts[self.of[k]]
            ends = self.edges[k] - start, self.edges[k + 1] - start
            dq_ds, d2q_ds2 = piece.between(1, *ends), list(piece.between(2, *ends))
            # ṡ² may be less than the average of σ̇² of the plan.
            if self.window:
                d2q_ds2.append(np.zeros_like(d2q_ds2[0]))
            near = self.near(k, np.full(len(most), fastest))
            x, path_acceleration = squares[near].reshape(-1, 1), path_accelerations[near].reshape(-1, 1)
            max_dq_ds, max_d2q_ds2 = np.maximum(-dq_ds[0], dq_ds[1]), np.abs(d2q_ds2).max(axis=0)
            accelerations = np.max(
                [np.abs(p * path_acceleration + c * x).max(axis=0) for p in dq_ds for c in d2q_ds2], axis=0
            )
            wrong = [
                ("is faster", max_dq_ds * fastest > velocity + _TIME_LAW_TOLERANCES[0]),
                ("accelerates more", accelerations > acceleration + _TIME_LAW_TOLERANCES[1]),
            ]
            if jerk is not None:
                low, high = min(float(path_acceleration.min()), 0.0), max(float(path_acceleration.max()), 0.0)
                jerks = piece.most(3) * fastest**3 + 3 * max_d2q_ds2 * fastest * max(-low, high)
                jerks = jerks + max_dq_ds * (high - low) / self.window
                wrong.append(("has more jerk", jerks > jerk + _TIME_LAW_TOLERANCES[2]))
            for what, joints in wrong:
                for i in np.flatnonzero(joints):
                    return f"joint {i} {what} than its limit at {self.edges[k]:.6f} rad"
        return None


class PlainAverage:
    """The time law of the average of a plan (C + 1,) over a window [s].

    At the grid points `corners` the plan waits for the window.
    """

    def __init__(self, edges: FloatArray, squares: FloatArray, corners: list[int], window: float) -> None:
        self._edges, self._speeds, self._window = edges.tolist(), np.sqrt(squares).tolist(), window
        self._reaches, self._leaves, self._areas = [0.0], [0.0], [0.0]
        for k in range(len(edges) - 1):
            self._reaches.append(self._leaves[k] + self._span(k))
            self._leaves.append(self._reaches[-1] + (window if k + 1 in corners else 0.0))
            self._areas.append(self._areas[k] + self._plan(k, self._leaves[k + 1])[1])
        self.duration = self._reaches[-1] + window

    def _span(self, k: int) -> float:
        size, both = self._edges[k + 1] - self._edges[k], self._speeds[k] + self._speeds[k + 1]
        return float(2 * size / both)

    def _plan(self, k: int, time: float) -> tuple[float, float]:
        """Return σ and ∫σ in cell k at a time."""
        since = min(time - self._leaves[k], self._span(k))
        begin, acceleration = self._speeds[k], (self._speeds[k + 1] - self._speeds[k]) / self._span(k)
        later = time - self._leaves[k] - since
        area = since * (self._edges[k] + since * (begin / 2 + since * acceleration / 6))
        return self._edges[k] + since * (begin + since * acceleration / 2), area + later * self._edges[k + 1]

    def _at(self, time: float) -> tuple[float, float]:
        """Return σ and ∫σ at a time. The plan rests before its start and after its end."""
        if time <= 0:
            return self._edges[0], self._edges[0] * time
        k = min(bisect_right(self._leaves, time), len(self._edges) - 1) - 1
        place, area = self._plan(k, time)
        return place, self._areas[k] + area

    def rate(self, time: float) -> float:
        """Return ṡ at a time [s]."""
        return (self._at(time)[0] - self._at(time - self._window)[0]) / self._window

    def passed(self, cell: int, s: float) -> float:
        """Return the time at which the robot passes an arc length of a cell [rad], by bisection."""
        early, late = self._reaches[cell], self._reaches[cell + 1] + self._window
        for _ in range(_MOST_HALVINGS):
            middle = (early + late) / 2
            place = (self._at(middle)[1] - self._at(middle - self._window)[1]) / self._window
            early, late = (middle, late) if place <= s else (early, middle)
        return late
