"""The curve and the time law that a certificate claims, evaluated by plain means.

Pieces are lines and circular arcs in joint space, q(σ) = start + r sin(σ/r)·forward + r (1 − cos(σ/r))·inward, one
after the other, and ṡ² is linear in each cell between two grid points; or the jerk is constant in phases.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import atan2, cos, hypot, pi, sin, sqrt
from typing import NamedTuple

import numpy as np

from safe_ompl.certificates.claims import Piece, TimedMotion
from safe_ompl.common import CertificateError, FloatArray, IntArray
from safe_ompl.robot import Robot

_SAME = 1e-9  # [rad] places, and directions, that differ by less are the same
_ROUNDING = 1e-9  # relative, of speeds and accelerations
_LONGEST = 1e4  # [rad] of a curve
_HALVINGS = 60


@dataclass(frozen=True)
class PlainPiece:
    """A line or an arc."""

    start: FloatArray
    forward: FloatArray
    inward: FloatArray
    length: float
    curvature: float

    def at(self, sigma: float) -> FloatArray:
        """Return the configuration (n,) at an arc length from its start."""
        if self.curvature == 0:
            return self.start + sigma * self.forward
        angle = sigma * self.curvature
        return self.start + (sin(angle) * self.forward + (1 - cos(angle)) * self.inward) / self.curvature

    def slope(self, sigma: float) -> FloatArray:
        """Return q′ (n,) there."""
        angle = sigma * self.curvature
        return cos(angle) * self.forward + sin(angle) * self.inward

    def steps(self, half: float) -> FloatArray:
        """Return how far each joint (n,) moves at most in half an interval."""
        return half * np.hypot(self.forward, self.inward)

    def box(self) -> tuple[FloatArray, FloatArray]:
        """Return the least and the largest value (n,) of each joint on the piece."""
        values = [self.start, self.at(self.length)]
        low, high = np.minimum(*values), np.maximum(*values)
        if self.curvature > 0:
            for i, (f, n) in enumerate(zip(self.forward.tolist(), self.inward.tolist(), strict=True)):
                turn = atan2(-f, n) % pi  # where q′ vanishes
                while turn < self.length * self.curvature:
                    value = self.at(turn / self.curvature)[i]
                    low[i], high[i] = min(low[i], value), max(high[i], value)
                    turn += pi
        return low, high

    def rates(self, first: float, last: float) -> list[tuple[float, float, float, float]]:
        """Return for each joint the least and the largest q′, and q″, between two arc lengths."""
        found = []
        begin, end = first * self.curvature, last * self.curvature
        for f, n in zip(self.forward.tolist(), self.inward.tolist(), strict=True):
            size, lag = hypot(f, n), atan2(n, f)
            slope = _cosines(begin - lag, end - lag)
            bend = _cosines(begin - lag + pi / 2, end - lag + pi / 2)
            swing = size * self.curvature
            found.append((size * slope[0], size * slope[1], swing * bend[0], swing * bend[1]))
        return found


def _cosines(begin: float, end: float) -> tuple[float, float]:
    """Return the least and the largest cosine of angles between two."""
    ends = cos(begin), cos(end)
    top = (end // (2 * pi)) > (begin // (2 * pi))
    bottom = ((end - pi) // (2 * pi)) > ((begin - pi) // (2 * pi))
    return -1.0 if bottom else min(ends), 1.0 if top else max(ends)


class PlainMotion:
    """A curve and where on it the robot is when, as claimed; checked for being one motion along a path (N, n).

    Attributes
    ----------
    starts : list of float
        Arc lengths where the pieces begin.
    edges, squares : ndarray, shape (C + 1,)
        Grid points, and ṡ² there.
    of : list of int
        The piece of each of the C cells.
    ends : ndarray of int, shape (C,)
        The grid point at which the robot stops in any case, after each cell.

    Raises
    ------
    CertificateError
        If it is none.
    """

    def __init__(self, claim: TimedMotion, robot: Robot, path: FloatArray) -> None:
        self.pieces = [_piece(k, piece) for k, piece in enumerate(claim.pieces)]
        corners = list(claim.corners)
        if any(not 0 < k < len(self.pieces) for k in corners):
            raise CertificateError(f"trajectory: {corners} are not corners between its pieces")
        self._check_joined(corners, robot, path)
        self.starts = [0.0]
        for piece in self.pieces:
            self.starts.append(self.starts[-1] + piece.length)
        self.edges, self.squares = claim.edges, claim.squares
        if len(self.edges) != len(self.squares):
            raise CertificateError("trajectory: it has not one speed for each grid point")
        self.of = self._check_grid()
        self.phases: PlainPhases | None = None
        if claim.phases is not None:
            self._take_phases(PlainPhases(claim.phases, self.starts[-1]))
        stops = {self._grid_point(self.starts[k]) for k in corners} | {0, len(self.edges) - 1}
        for j in sorted(stops):
            if self.squares[j] != 0:
                where = f"{self.edges[j]:.6f} rad"
                raise CertificateError(f"trajectory: it does not stand at {where}, where it must")
        self.ends = np.array([min(j for j in stops if j > cell) for cell in range(len(self.of))])

    @property
    def duration(self) -> float:
        """How long it takes [s]."""
        if self.phases is not None:
            return self.phases.duration
        speeds = np.sqrt(self.squares)
        return float((2 * np.diff(self.edges) / (speeds[1:] + speeds[:-1])).sum())

    @property
    def pushes(self) -> tuple[FloatArray, FloatArray]:
        """The least and the largest s̈ (C,) in each cell."""
        if self.phases is not None:
            return self.phases.of(self.edges)[:2]
        pushes = np.diff(self.squares) / (2 * np.diff(self.edges))
        return pushes, pushes

    def rates_between(self, cell: int, first: float, last: float) -> tuple[float, float]:
        """Return ṡ at two arc lengths of a cell, between which it rises or falls only."""
        if self.phases is not None:
            low, high = (self.phases.rate(s) for s in (first, last))
            return low, high
        begin, end = self.edges[cell], self.edges[cell + 1]
        squares = np.interp([first, last], [begin, end], self.squares[cell : cell + 2])
        return float(np.sqrt(squares[0])), float(np.sqrt(squares[1]))

    def _take_phases(self, phases: PlainPhases) -> None:
        if any(piece.curvature for piece in self.pieces):
            raise CertificateError(
                "trajectory: its jerk is limited, but it has arcs: the acceleration jumps there"
            )
        found = phases.squares(self.edges)
        if np.abs(found - self.squares).max() > _SAME * max(1.0, float(found.max())):
            raise CertificateError("trajectory: its speeds are not those of its phases")
        self.phases = phases

    def _check_joined(self, corners: list[int], robot: Robot, path: FloatArray) -> None:
        first, last = self.pieces[0], self.pieces[-1]
        ends = ("begin", first.start, path[0]), ("end", last.at(last.length), path[-1])
        for name, q, wanted in ends:
            if np.abs(robot.difference(q, wanted)).max() > _SAME:
                raise CertificateError(f"trajectory: the curve does not {name} where the path does")
        for k in range(1, len(self.pieces)):
            before, after = self.pieces[k - 1], self.pieces[k]
            if np.abs(before.at(before.length) - after.start).max() > _SAME:
                raise CertificateError(f"trajectory: piece {k} does not begin where the one before ends")
            turn = np.abs(before.slope(before.length) - after.forward).max()
            if k not in corners and turn > 1e3 * _SAME:
                raise CertificateError(f"trajectory: piece {k} begins in another direction, but is no corner")
        for k, piece in enumerate(self.pieces):
            low, high = piece.box()
            for i in np.flatnonzero(~robot.continuous):
                if low[i] < robot.lower[i] - 1e-9 or high[i] > robot.upper[i] + 1e-9:
                    raise CertificateError(
                        f"trajectory: piece {k} leaves the limits of joint {robot.joint_names[i]!r}"
                    )

    def _check_grid(self) -> list[int]:
        """Return the piece of each cell; cells must be in order, and none in two pieces."""
        edges = self.edges
        if len(edges) < 2 or not (np.diff(edges) > 0).all() or edges[0] != 0:
            raise CertificateError("trajectory: its grid points are not in order")
        if abs(edges[-1] - self.starts[-1]) > _SAME or not (self.squares >= 0).all():
            raise CertificateError("trajectory: its grid points do not cover the curve")
        for k, start in enumerate(self.starts[1:-1], 1):
            if abs(edges[self._grid_point(start)] - start) > _SAME:
                raise CertificateError(f"trajectory: piece {k} does not begin at a grid point")
        if (self.squares[1:] + self.squares[:-1] == 0).any():
            raise CertificateError("trajectory: it stands where it should move")
        middles = (edges[1:] + edges[:-1]) / 2
        return [min(max(int(k) - 1, 0), len(self.pieces) - 1) for k in np.searchsorted(self.starts, middles)]

    def _grid_point(self, s: float) -> int:
        return int(np.abs(self.edges - s).argmin())

    def exceeded(
        self, squares: FloatArray, pushes: FloatArray, velocity: FloatArray, acceleration: FloatArray
    ) -> str | None:
        """Return which joint exceeds its limits (n,) where, if any does.

        In the cells ṡ² is linear between the `squares: (C, 2)` at their ends, and s̈ is `pushes: (C,)`.
        """
        for j, (x, a) in enumerate(zip(squares.tolist(), pushes.tolist(), strict=True)):
            piece, start = self.pieces[self.of[j]], self.starts[self.of[j]]
            rates = piece.rates(self.edges[j] - start, self.edges[j + 1] - start)
            fastest = sqrt(max(x))
            for i, (low, high, bend_low, bend_high) in enumerate(rates):
                if max(-low, high) * fastest > velocity[i] * (1 + _ROUNDING):
                    return f"joint {i} is faster than its limit at {self.edges[j]:.6f} rad"
                corners = [p * a + c * y for p in (low, high) for c in (bend_low, bend_high) for y in x]
                if max(max(corners), -min(corners)) > acceleration[i] * (1 + _ROUNDING):
                    return f"joint {i} accelerates more than its limit at {self.edges[j]:.6f} rad"
        return None

    def jerk_exceeded(self, jerk: FloatArray) -> str | None:
        """Return which joint exceeds its jerk `(n,)` where, if any does; on lines it is q′s⃛."""
        if self.phases is None:
            return "the jerk is not limited"
        for j, change in enumerate(self.phases.of(self.edges)[2].tolist()):
            slopes = np.abs(self.pieces[self.of[j]].forward)
            for i in np.flatnonzero(slopes * change > jerk * (1 + _ROUNDING)):
                return f"joint {i} has more jerk than its limit at {self.edges[j]:.6f} rad"
        return None


def _piece(k: int, piece: Piece) -> PlainPiece:
    start, forward, inward = piece.start, piece.forward, piece.inward
    length, curvature = piece.length, piece.curvature
    unit = abs(float(forward @ forward) - 1) <= _SAME
    if curvature == 0:
        fits = unit and not inward.any()
    else:
        fits = unit and abs(float(inward @ inward) - 1) <= _SAME and abs(float(forward @ inward)) <= _SAME
    if not (fits and 0 < length <= _LONGEST and 0 <= curvature * length <= pi):
        raise CertificateError(f"trajectory: piece {k} is neither a line nor an arc")
    return PlainPiece(start, forward, inward, length, curvature)


class _State(NamedTuple):
    s: float
    rate: float
    push: float

    def after(self, time: float, jerk: float) -> _State:
        """Return the state a time later."""
        return _State(
            self.s + self.rate * time + self.push * time**2 / 2 + jerk * time**3 / 6,
            self.rate + self.push * time + jerk * time**2 / 2,
            self.push + jerk * time,
        )


class PlainPhases:
    """Where on its curve, of a length [rad], the robot is when; from rest to rest in phases (P, 2) of duration and s⃛.

    Raises
    ------
    CertificateError
        If it is no such law; if ṡ both rises and falls in a phase.
    """

    def __init__(self, claim: FloatArray, length: float) -> None:
        state, self._begins, self._claim = _State(0.0, 0.0, 0.0), list[_State](), list[tuple[float, float]]()
        for duration, jerk in claim.tolist():
            if not duration > 0:
                raise CertificateError("trajectory: a phase lasts no time")
            after = state.after(duration, jerk)
            if min(state.push, after.push) < -1e3 * _SAME and max(state.push, after.push) > 1e3 * _SAME:
                raise CertificateError("trajectory: the speed both rises and falls in a phase")
            if after.rate < -_SAME:
                raise CertificateError("trajectory: it moves backwards in a phase")
            self._begins.append(state)
            self._claim.append((duration, jerk))
            state = after
        if abs(state.s - length) > _SAME or abs(state.rate) > _SAME or abs(state.push) > 1e3 * _SAME:
            raise CertificateError("trajectory: its phases do not end at rest where the curve does")
        self.end = state
        self.starts: FloatArray = np.array([begin.s for begin in self._begins])
        self.duration = sum(duration for duration, _ in self._claim)

    def squares(self, edges: FloatArray) -> FloatArray:
        """Return ṡ² (C + 1,) at grid points, all starts of phases among them; by bisection, for s grows with time."""
        for start in self.starts.tolist():
            if np.abs(edges - start).min() > _SAME:
                raise CertificateError(
                    f"trajectory: a phase begins at {start:.6f} rad, which is no grid point"
                )
        found = [self.rate(float(s)) ** 2 for s in edges]
        for j in (0, -1):
            found[j] = 0.0
        return np.array(found)

    def rate(self, s: float) -> float:
        """Return ṡ at an arc length [rad]."""
        near = np.abs(self.starts - s).argmin()
        if abs(self.starts[near] - s) <= 1e-3 * _SAME:
            rate = self._begins[near].rate
            return rate if rate > _SAME else 0.0
        k = max(int(np.searchsorted(self.starts, s, side="right")) - 1, 0)
        duration, jerk = self._claim[k]
        early, late = 0.0, duration
        for _ in range(_HALVINGS):
            middle = (early + late) / 2
            early, late = (middle, late) if self._begins[k].after(middle, jerk).s <= s else (early, middle)
        return max(self._begins[k].after(late, jerk).rate, 0.0)

    def of(self, edges: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return for each cell (C,) the least and the largest s̈ of its phase, and |s⃛|."""
        middles = (edges[1:] + edges[:-1]) / 2
        which: IntArray = np.maximum(np.searchsorted(self.starts, middles, side="right") - 1, 0)
        begin = np.array([state.push for state in self._begins])
        end = np.append(begin[1:], self.end.push)
        jerks = np.abs([jerk for _, jerk in self._claim])
        return np.minimum(begin, end)[which], np.maximum(begin, end)[which], jerks[which]
