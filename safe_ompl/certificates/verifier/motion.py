"""The curve and the time law that a certificate claims, evaluated by plain means.

Pieces are cubics in joint space, one after the other, and ṡ² is linear in each cell between two grid points; or such a
law is a plan σ, and s(t) is its average over the window from t − w to t. In corners the plan waits for w.

No σ(τ) of a window in which σ̇ ≤ m is farther than m w/2 from its average. So while the robot is in cell k, the largest
σ̇ = m of the window is reached in a cell that is no farther away than m w/2, and all σ(τ) are in such cells.
"""

from __future__ import annotations

from bisect import bisect_right
from dataclasses import dataclass
from itertools import pairwise
from math import sqrt

import numpy as np

from safe_ompl.certificates.claims import ClaimedTrajectory
from safe_ompl.common import BoolArray, CertificateError, FloatArray
from safe_ompl.robot import Robot

_SAME = 1e-9  # [rad] places that differ by less are the same
_SMOOTH = 1e-6  # [rad/s, rad/s²] jumps of velocities, and of accelerations where the jerk is limited, that are none
_STEEP = (1e-8, 1e-6, 1e-3)  # [rad, s] jumps of places, velocities and accelerations as rates, at most
_ABOVE = (1e-8, 1e-7, 1e-4)  # [rad, s] what velocities, accelerations and jerks may be above their limits
_ROUNDING = 1e-9  # relative, of reach and, for grid points, of the shorter piece beside
_LONGEST = 1e4  # [rad] of a curve
_HALVINGS = 60


@dataclass(frozen=True)
class PlainPiece:
    """A cubic: q, q′, q″ and q‴ where it begins, and its length."""

    start: FloatArray
    first: FloatArray
    second: FloatArray
    third: FloatArray
    length: float

    def at(self, sigma: float) -> FloatArray:
        """Return the configuration (n,) at an arc length from its start."""
        return self.start + sigma * self.first + sigma**2 / 2 * self.second + sigma**3 / 6 * self.third

    def slope(self, sigma: float) -> FloatArray:
        """Return q′ (n,) there."""
        return self.first + sigma * self.second + sigma**2 / 2 * self.third

    def bend(self, sigma: float) -> FloatArray:
        """Return q″ (n,) there."""
        return self.second + sigma * self.third

    @property
    def steps(self) -> FloatArray:
        """The largest |q′| (n,) on the piece."""
        low, high = self.slopes(0.0, self.length)
        return np.maximum(-low, high)

    @property
    def bends(self) -> FloatArray:
        """The largest |q″| (n,) on the piece."""
        return np.maximum(np.abs(self.second), np.abs(self.bend(self.length)))

    def slopes(self, first: float, last: float) -> tuple[FloatArray, FloatArray]:
        """Return the least and the largest q′ (n,) between two arc lengths."""
        values = [self.slope(first), self.slope(last)]
        for i in np.flatnonzero(self.third):
            turn = -self.second[i] / self.third[i]
            if first < turn < last:
                values.append(np.where(np.arange(len(self.third)) == i, self.slope(turn), values[0]))
        return np.min(values, axis=0), np.max(values, axis=0)


class PlainMotion:
    """A curve and where on it the robot is when; a CertificateError unless it is one motion between two ends.

    Its pieces begin at arc lengths `starts`. At `edges`, (C + 1,), ṡ² is `squares`; of the plan, if there is a `window`
    [s], which is else 0. Of each of the C cells `of` is the piece, `ends` the grid point at which the robot stops in
    any case, `fastest` a bound of ṡ.
    """

    def __init__(self, claim: ClaimedTrajectory, robot: Robot, ends: tuple[FloatArray, FloatArray]) -> None:
        self.pieces = [PlainPiece(p.start, p.slope, p.bend, p.swing, p.length) for p in claim.pieces]
        for k, piece in enumerate(self.pieces):
            if not piece.length <= _LONGEST:
                raise CertificateError(f"trajectory: piece {k} is no curve")
        corners = list(claim.corners)
        if any(not 0 < k < len(self.pieces) for k in corners):
            raise CertificateError(f"trajectory: {corners} are not corners between its pieces")
        self._check_joined(robot, ends)
        self.starts = [0.0]
        for piece in self.pieces:
            self.starts.append(self.starts[-1] + piece.length)
        self.edges, self.squares = claim.edges, claim.squares
        if len(self.edges) != len(self.squares):
            raise CertificateError("trajectory: it has not one speed for each grid point")
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
        self._check_smooth(corners)
        self._average = PlainAverage(self.edges, self.squares, self._corners, self.window)
        self.fastest = self.fastest_near(np.sqrt(np.maximum(self.squares[1:], self.squares[:-1])))

    @property
    def duration(self) -> float:
        """How long it takes [s]."""
        return self._average.duration

    @property
    def pushes(self) -> FloatArray:
        """s̈ (C,) in each cell; of the plan, if there is a window."""
        return np.diff(self.squares) / (2 * np.diff(self.edges))

    def rates_between(self, cell: int, first: float, last: float) -> tuple[float, float]:
        """Return the least and the largest ṡ between two arc lengths of a cell, or bounds of them."""
        if not self.window:
            begin, end = self.edges[cell], self.edges[cell + 1]
            squares = np.interp([first, last], [begin, end], self.squares[cell : cell + 2])
            return float(np.sqrt(squares.min())), float(np.sqrt(squares.max()))
        times = [self._average.passed(cell, s) for s in (first, last)]
        rates = [self._average.rate(t) for t in times]
        more = max(times[1] - times[0], 0.0) / 2 * float(np.abs(self.pushes).max())
        return max(min(rates) - more, 0.0), max(rates) + more

    def near(self, k: int, speeds: FloatArray) -> BoolArray:
        """Return in which cells (C,) the plan, if its σ̇ is `speeds: (C,)` there, may be while the robot is in cell k.

        All those in which it is no slower than elsewhere in the window.
        """
        cells = np.arange(len(self.of))
        if not self.window:
            return np.asarray(cells == k)
        away = np.maximum(self.edges[:-1] - self.edges[k + 1], self.edges[k] - self.edges[1:])
        between = (cells >= self._begins[k]) & (cells < self.ends[k])
        return np.asarray(between & (away <= np.maximum(self.window / 2 * speeds * (1 - _ROUNDING), 0.0)))

    def fastest_near(self, speeds: FloatArray) -> FloatArray:
        """Return bounds (C,) of ṡ in the cells for a plan whose σ̇ is at most `speeds: (C,)` in them."""
        return np.array([speeds[self.near(k, speeds)].max() for k in range(len(self.of))])

    def _check_joined(self, robot: Robot, ends: tuple[FloatArray, FloatArray]) -> None:
        last = self.pieces[-1]
        own = self.pieces[0].start, last.at(last.length)
        for name, q, wanted in zip(("begin", "end"), own, ends, strict=True):
            if np.abs(robot.difference(q, wanted)).max() > _SAME:
                raise CertificateError(f"trajectory: the curve does not {name} where the path does")
        for k, (before, after) in enumerate(pairwise(self.pieces), 1):
            if np.abs(before.at(before.length) - after.start).max() > _SAME:
                raise CertificateError(f"trajectory: piece {k} does not begin where the one before ends")

    def _check_grid(self) -> list[int]:
        """Return the piece of each cell; cells must be in order, and none in two pieces."""
        edges = self.edges
        if len(edges) < 2 or not (np.diff(edges) > 0).all() or edges[0] != 0:
            raise CertificateError("trajectory: its grid points are not in order")
        if abs(edges[-1] - self.starts[-1]) > 1e3 * _ROUNDING * self.pieces[-1].length or not (self.squares >= 0).all():
            raise CertificateError("trajectory: its grid points do not cover the curve")
        for k, (before, after) in enumerate(pairwise(self.pieces), 1):
            away = abs(edges[self._grid_point(self.starts[k])] - self.starts[k])
            if away > 1e3 * _ROUNDING * min(before.length, after.length):
                raise CertificateError(f"trajectory: piece {k} does not begin at a grid point")
        if (self.squares[1:] + self.squares[:-1] == 0).any():
            raise CertificateError("trajectory: it stands where it should move")
        middles = (edges[1:] + edges[:-1]) / 2
        return [min(max(int(k) - 1, 0), len(self.pieces) - 1) for k in np.searchsorted(self.starts, middles)]

    def _grid_point(self, s: float) -> int:
        return int(np.abs(self.edges - s).argmin())

    def _check_smooth(self, corners: list[int]) -> None:
        """Refuse pieces that begin with another velocity, or acceleration, than those before end with.

        A jump J where a piece of length h begins counts as the rate Jṡ/h, too, so that many make no staircase.
        """
        speed = sqrt(float(self.squares.max()))
        for k, (before, after) in enumerate(pairwise(self.pieces), 1):
            end = before.length
            jumps = [np.abs(before.at(end) - after.start).max()]
            if k not in corners:
                jumps += [np.abs(before.slope(end) - after.first).max() * speed]
                jumps += [np.abs(before.bend(end) - after.second).max() * speed**2] * bool(self.window)
            if max(jumps[1:2], default=0.0) > _SMOOTH:
                raise CertificateError(f"trajectory: piece {k} begins in another direction, but is no corner")
            if max(jumps[2:], default=0.0) > _SMOOTH:
                raise CertificateError(f"trajectory: the acceleration jumps where piece {k} begins")
            if any(jump * speed > most * after.length for jump, most in zip(jumps, _STEEP, strict=False)):
                raise CertificateError(f"trajectory: piece {k} is too short for the jump where it begins")

    def exceeded(
        self,
        squares: FloatArray,
        pushes: FloatArray,
        velocity: FloatArray,
        acceleration: FloatArray,
        jerk: FloatArray | None,
    ) -> str | None:
        """Return which joint exceeds its limits (n,) where, if any does.

        In each cell the law, or its plan, is in the convex hull of pairs of ṡ² and s̈, `squares, pushes: (C, K)`.
        """
        if jerk is not None and not self.window:
            return "the jerk is not limited"
        most = self.fastest_near(np.sqrt(squares.max(axis=1)))
        for k, fastest in enumerate(most.tolist()):
            piece, start = self.pieces[self.of[k]], self.starts[self.of[k]]
            ends = self.edges[k] - start, self.edges[k + 1] - start
            slopes = piece.slopes(*ends)
            bends = [piece.bend(end) for end in ends]
            if self.window:  # ṡ² may be less than the average of those of the plan
                bends.append(np.zeros_like(bends[0]))
            near = self.near(k, np.full(len(most), fastest))
            x, push = squares[near].reshape(-1, 1), pushes[near].reshape(-1, 1)
            slope, bend = np.maximum(-slopes[0], slopes[1]), np.abs(bends).max(axis=0)
            felt = np.max([np.abs(p * push + c * x).max(axis=0) for p in slopes for c in bends], axis=0)
            wrong = [
                ("is faster", slope * fastest > velocity + _ABOVE[0]),
                ("accelerates more", felt > acceleration + _ABOVE[1]),
            ]
            if jerk is not None:
                low, high = min(float(push.min()), 0.0), max(float(push.max()), 0.0)
                jerks = np.abs(piece.third) * fastest**3 + 3 * bend * fastest * max(-low, high)
                jerks = jerks + slope * (high - low) / self.window
                wrong.append(("has more jerk", jerks > jerk + _ABOVE[2]))
            for what, joints in wrong:
                for i in np.flatnonzero(joints):
                    return f"joint {i} {what} than its limit at {self.edges[k]:.6f} rad"
        return None


class PlainAverage:
    """When the robot is where, if it is at the average of a plan (C + 1,) over a window [s].

    In the grid points `corners` the plan waits for as long.
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
        begin, push = self._speeds[k], (self._speeds[k + 1] - self._speeds[k]) / self._span(k)
        later = time - self._leaves[k] - since
        area = since * (self._edges[k] + since * (begin / 2 + since * push / 6))
        return self._edges[k] + since * (begin + since * push / 2), area + later * self._edges[k + 1]

    def _at(self, time: float) -> tuple[float, float]:
        """Return σ and ∫σ at a time; it is at rest before and after."""
        if time <= 0:
            return self._edges[0], self._edges[0] * time
        k = min(bisect_right(self._leaves, time), len(self._edges) - 1) - 1
        place, area = self._plan(k, time)
        return place, self._areas[k] + area

    def rate(self, time: float) -> float:
        """Return ṡ at a time [s]."""
        return (self._at(time)[0] - self._at(time - self._window)[0]) / self._window

    def passed(self, cell: int, s: float) -> float:
        """Return when the robot is at an arc length of a cell [rad]; by bisection, for s grows with time."""
        early, late = self._reaches[cell], self._reaches[cell + 1] + self._window
        for _ in range(_HALVINGS):
            middle = (early + late) / 2
            place = (self._at(middle)[1] - self._at(middle - self._window)[1]) / self._window
            early, late = (middle, late) if place <= s else (early, middle)
        return late
