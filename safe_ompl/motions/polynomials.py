"""Polynomials on the unit interval: from Hermite data, B-splines and the Bernstein basis, and proven maxima.

Arrays of coefficients have the shape (K, d + 1, n): pieces, powers or Bernstein polynomials, joints.
"""

from __future__ import annotations

from functools import cache
from math import comb
from typing import NamedTuple

import numpy as np

from safe_ompl.common import FloatArray

EPS = float(np.finfo(np.float64).eps)
_CLOSE = 1e-9  # of the largest coefficient: how near a proven maximum is to a value that is taken


@cache
def _power_from_bernstein(degree: int) -> FloatArray:
    """Return T (d + 1, d + 1) with c = T b: T_ki = (−1)^(k−i) C(d, k) C(k, i), whole numbers."""
    sizes = range(degree + 1)
    return np.array([[(-1.0) ** (k - i) * comb(degree, k) * comb(k, i) for i in sizes] for k in sizes])


@cache
def _bernstein_from_power(degree: int) -> FloatArray:
    """Return M (d + 1, d + 1) with b = M c: M_ik = C(i, k) / C(d, k), all in [0, 1]."""
    sizes = range(degree + 1)
    return np.array([[comb(i, k) / comb(degree, k) for k in sizes] for i in sizes])


def bernstein(coefficients: FloatArray) -> FloatArray:
    """Return the Bernstein coefficients of polynomials; their rounding is at most (d + 3) ε Σ_k |c_k|."""
    found: FloatArray = _bernstein_from_power(coefficients.shape[1] - 1) @ coefficients
    return found


def powers(control_points: FloatArray, error: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the coefficients of polynomials in Bernstein form, and a bound (K, n) of the sum of their errors.

    The entries of T have Σ|T_ki| = 3^d, and a sum of d + 1 products rounds by (d + 2) ε of what it adds up.

    Parameters
    ----------
    control_points : ndarray, shape (K, d + 1, n)
        Bernstein coefficients.
    error : ndarray, shape (K, n)
        How far each may be from what is meant.
    """
    degree = control_points.shape[1] - 1
    coefficients = _power_from_bernstein(degree) @ control_points
    rounding = (degree + 2) * EPS * np.abs(control_points).max(axis=1) + error
    return coefficients, 3.0**degree * rounding


def hermite_control_points(
    spans: FloatArray, positions: FloatArray, velocities: FloatArray | None, accelerations: FloatArray | None
) -> tuple[FloatArray, FloatArray]:
    """Return Bernstein coefficients of Hermite pieces (K, d + 1, n), d = 1, 3 or 5, and a bound (K, n) of their error.

    Parameters
    ----------
    spans : ndarray, shape (K,)
        Durations.
    positions, velocities, accelerations : ndarray, shape (K, 2, n)
        At both ends of each piece; the degree is 1, 3 or 5 by how many are given.
    """
    start, end = positions[:, 0], positions[:, 1]
    if velocities is None:
        return np.stack([start, end], axis=1), np.zeros_like(start)
    degree = 3 if accelerations is None else 5
    out, back = np.moveaxis(velocities * (spans / degree)[:, None, None], 1, 0)
    size = np.abs(positions).max(axis=1) + 2 * np.maximum(np.abs(out), np.abs(back))
    if accelerations is None:
        return np.stack([start, start + out, end - back, end], axis=1), 8 * EPS * size
    bend, turn = np.moveaxis(accelerations * (spans**2 / 20)[:, None, None], 1, 0)
    size += np.maximum(np.abs(bend), np.abs(turn))
    points = [start, start + out, start + 2 * out + bend, end - 2 * back + turn, end - back, end]
    return np.stack(points, axis=1), 8 * EPS * size


def spline_control_points(
    knots: FloatArray, coefficients: FloatArray, degree: int
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return times (K + 1,), Bernstein coefficients (K, d + 1, n) of a B-spline, and a bound (K, n) of their error.

    The i-th Bernstein coefficient on [a, b] is the blossom at d − i times a and i times b. De Boor's scheme with one
    of the arguments on each level finds it; between neighbouring knots all of its steps are convex combinations.

    Parameters
    ----------
    knots : ndarray, shape (N + d + 1,)
        Not decreasing; the spline is defined from knot d to knot N, which differ.
    coefficients : ndarray, shape (N, n)
        Control points.
    degree : int
        Degree d ≥ 0.
    """
    at = np.arange(degree, len(coefficients))
    at = at[knots[at + 1] > knots[at]]
    held = coefficients[at[:, None] + np.arange(-degree, 1)]
    points = np.empty_like(held)
    for i in range(degree + 1):
        row = held
        for level in range(1, degree + 1):
            along = np.arange(level, degree + 1)
            low, high = knots[at[:, None] - degree + along], knots[at[:, None] + along + 1 - level]
            argument = knots[at + 1] if level <= i else knots[at]
            share = ((argument[:, None] - low) / (high - low))[..., None]
            row = (1 - share) * row[:, :-1] + share * row[:, 1:]
        points[:, i] = row[:, 0]
    return np.append(knots[at], knots[at[-1] + 1]), points, 8 * degree * EPS * np.abs(held).max(axis=1)


def restricted(coefficients: FloatArray, first: float, last: float) -> FloatArray:
    """Return the coefficients (d + 1, n) on [first, last] ⊂ [0, 1]; their errors sum to at most 4 (d + 1) ε Σ_k |c_k|.

    c′_k = (last − first)^k Σ_{i ≥ k} C(i, k) first^(i−k) c_i
    """
    sizes = range(len(coefficients))
    width = last - first
    shift = [[width**k * comb(i, k) * first ** (i - k) if i >= k else 0.0 for i in sizes] for k in sizes]
    return np.array(shift) @ coefficients


class Peaks(NamedTuple):
    """Maxima of P polynomials on the unit interval, each (P,).

    Attributes
    ----------
    bound : ndarray
        What no value exceeds.
    taken : ndarray
        A value that is taken; no more than 1e-9 of the largest coefficient below the bound.
    at : ndarray
        Where in [0, 1].
    """

    bound: FloatArray
    taken: FloatArray
    at: FloatArray


def peaks(rows: FloatArray) -> Peaks:
    """Return the maxima of polynomials in Bernstein form `rows: (P, d + 1)`, by subdivision.

    A polynomial is nowhere above its largest Bernstein coefficient; cells whose largest one is not above what is taken
    elsewhere are left out, and the others are halved. The bound comes nearer by four with every halving.
    """
    count, degree = len(rows), rows.shape[1] - 1
    ends = rows[:, [0, -1]]
    taken, at = ends.max(axis=1), ends.argmax(axis=1).astype(np.float64)
    largest = np.abs(rows).max(axis=1)
    near = _CLOSE * largest
    bound = taken.copy()
    owner, cells, left, width = np.arange(count), rows, np.zeros(count), 1.0
    while True:
        most = cells.max(axis=1)
        open_ = most > taken[owner] + near[owner]
        np.maximum.at(bound, owner[~open_], most[~open_])
        owner, cells, left = owner[open_], cells[open_], left[open_]
        if not len(owner):
            break
        width /= 2
        lower, upper = _halves(cells)
        middle = upper[:, 0]
        np.maximum.at(taken, owner, middle)
        best = middle == taken[owner]
        at[owner[best]] = left[best] + width
        owner, left = np.concatenate([owner, owner]), np.concatenate([left, left + width])
        cells = np.concatenate([lower, upper])
    bound = np.maximum(bound, taken) + 16 * (degree + 1) * EPS * largest  # fifteen halvings round
    return Peaks(bound, taken, at)


def _halves(cells: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the Bernstein coefficients of the halves of cells (C, d + 1), by de Casteljau's scheme."""
    lower, upper, row = np.empty_like(cells), np.empty_like(cells), cells
    for k in range(cells.shape[1]):
        lower[:, k], upper[:, -1 - k] = row[:, 0], row[:, -1]
        row = 0.5 * (row[:, :-1] + row[:, 1:])
    return lower, upper
