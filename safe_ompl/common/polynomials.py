"""Polynomials on the unit interval: conversion from Hermite data, B-splines and Bernstein form, and proven maxima.

Arrays of coefficients have the shape (K, d + 1, n) for K pieces, degree d and n joints.
"""

from __future__ import annotations

from functools import cache
from math import comb
from typing import NamedTuple

import numpy as np

from safe_ompl.common.documents import FloatArray

EPS = float(np.finfo(np.float64).eps)
# A proven maximum exceeds a value of the polynomial by at most this share of the largest coefficient.
_CLOSE = 1e-9


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


def values(coefficients: FloatArray, u: FloatArray) -> FloatArray:
    """Evaluate K polynomials, each at its `u: (K, 1)`; returns (K, n)."""
    found = coefficients[:, -1].copy()
    for k in range(coefficients.shape[1] - 2, -1, -1):
        found = found * u + coefficients[:, k]
    return found


def bernstein(coefficients: FloatArray) -> FloatArray:
    """Return the Bernstein coefficients of polynomials, with rounding errors of at most (d + 3) ε Σ_k |c_k|."""
    return _bernstein_from_power(coefficients.shape[1] - 1) @ coefficients


def powers(control_points: FloatArray, error: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Convert Bernstein coefficients (K, d + 1, n) to power coefficients, and bound the sum of their errors (K, n).

    c_0 is b_0, and the others are computed from b_i − b_0, each with an error of at most `error: (K, n)`. The entries
    of T have Σ|T_ki| = 3^d, and a sum of d + 1 products of rounded differences has an error of (d + 3) ε times the sum
    of their absolute values.
    """
    degree = control_points.shape[1] - 1
    steps = control_points - control_points[:, :1]
    coefficients = _power_from_bernstein(degree) @ steps
    coefficients[:, 0] = control_points[:, 0]
    return coefficients, 3.0**degree * ((degree + 3) * EPS * np.abs(steps).max(axis=1) + error)


def hermite(
    spans: FloatArray, positions: FloatArray, velocities: FloatArray | None, accelerations: FloatArray | None
) -> tuple[FloatArray, FloatArray]:
    """Return the coefficients (K, d + 1, n) of Hermite pieces, and a bound (K, n) of the sum of their errors.

    The pieces have the durations `spans: (K,)`. Positions, velocities and accelerations (K, 2, n) are given at both
    ends of each piece. The degree is 1 with positions only, 3 with velocities, and 5 with accelerations, too.
    """
    start, step = positions[:, 0], positions[:, 1] - positions[:, 0]
    size = np.abs(step)
    if velocities is None:
        return np.stack([start, step], axis=1), 3 * (4 * EPS * size + 8 * EPS * size)
    degree = 3 if accelerations is None else 5
    out, back = np.moveaxis(velocities * (spans / degree)[:, None, None], 1, 0)
    size = size + 2 * np.maximum(np.abs(out), np.abs(back))
    points = [np.zeros_like(step), out, step - back, step]
    if accelerations is not None:
        second_start, second_end = np.moveaxis(accelerations * (spans**2 / 20)[:, None, None], 1, 0)
        size += np.maximum(np.abs(second_start), np.abs(second_end))
        points = [points[0], out, 2 * out + second_start, step - 2 * back + second_end, step - back, step]
    coefficients, rounding = powers(np.stack(points, axis=1), 8 * EPS * size)
    coefficients[:, 0] = start
    return coefficients, rounding


def spline(knots: FloatArray, held: FloatArray, degree: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return times (K + 1,) and coefficients (K, d + 1, n) of a B-spline, and a bound (K, n) of their errors' sum.

    The knots (N + d + 1,) do not decrease. The spline has the degree d ≥ 1 and the control points `held: (N, n)`, and
    is defined from knot d to knot N, which must differ. The i-th Bernstein coefficient on [a, b] is the blossom with
    d − i arguments a and i arguments b. De Boor's algorithm with one argument per level computes this blossom. Between
    neighbouring knots, all steps are convex combinations.
    """
    at = np.arange(degree, len(held))
    at = at[knots[at + 1] > knots[at]]
    origin = held[at - degree, None]
    local = held[at[:, None] + np.arange(-degree, 1)] - origin
    points = np.empty_like(local)
    for i in range(degree + 1):
        row = local
        for level in range(1, degree + 1):
            along = np.arange(level, degree + 1)
            low, high = knots[at[:, None] - degree + along], knots[at[:, None] + along + 1 - level]
            argument = knots[at + 1] if level <= i else knots[at]
            share = ((argument[:, None] - low) / (high - low))[..., None]
            row = (1 - share) * row[:, :-1] + share * row[:, 1:]
        points[:, i] = row[:, 0]
    coefficients, rounding = powers(points, 16 * degree * EPS * np.abs(local).max(axis=1))
    coefficients[:, :1] += origin
    rounding += EPS * (np.abs(coefficients[:, 0]) + np.abs(local).max(axis=1) * 8 * degree)
    return np.append(knots[at], knots[at[-1] + 1]), coefficients, rounding


def cubic_spline(
    knots: FloatArray, values: FloatArray, first: FloatArray | None = None, last: FloatArray | None = None
) -> FloatArray:
    """Return the C² cubic spline through `values: (K + 1, n)` as power coefficients (K, 4, n) of s from each knot.

    `first` and `last` (n,) are the derivatives at the ends. An end without a derivative has second derivative zero.
    """
    spans, count = np.diff(knots), len(knots)
    chords = np.diff(values, axis=0) / spans[:, None]
    matrix, right = np.eye(count), np.zeros_like(values)
    inner = np.arange(1, count - 1)
    matrix[inner, inner - 1], matrix[inner, inner + 1] = spans[:-1], spans[1:]
    matrix[inner, inner] = 2 * (spans[:-1] + spans[1:])
    right[inner] = 6 * np.diff(chords, axis=0)
    if first is not None:
        matrix[0, :2] = 2 * spans[0], spans[0]
        right[0] = 6 * (chords[0] - first)
    if last is not None:
        matrix[-1, -2:] = spans[-1], 2 * spans[-1]
        right[-1] = 6 * (last - chords[-1])
    second_derivatives = np.linalg.solve(matrix, right)
    slopes = chords - spans[:, None] * (2 * second_derivatives[:-1] + second_derivatives[1:]) / 6
    if first is not None:
        slopes[0] = first  # exactly
    return np.stack(
        [values[:-1], slopes, second_derivatives[:-1] / 2, np.diff(second_derivatives, axis=0) / (6 * spans[:, None])],
        axis=1,
    )


def restricted(coefficients: FloatArray, first: float | FloatArray, last: float | FloatArray) -> FloatArray:
    """Return the coefficients (…, d + 1, n) on [first, last] ⊂ [0, 1]; their errors sum to ≤ 4 (d + 1) ε Σ_k |c_k|.

    c′_k = (last − first)^k Σ_{i ≥ k} C(i, k) first^(i−k) c_i; `first` and `last` are numbers, or (…).
    """
    begin, width = (np.asarray(x)[..., None, None] for x in (first, np.subtract(last, first)))
    i = np.arange(coefficients.shape[-2])
    k = i[:, None]
    shift = width**k * _binomials(len(i)) * begin ** np.maximum(i - k, 0)
    return np.asarray(shift @ coefficients)


@cache
def _binomials(size: int) -> FloatArray:
    """Return the binomial coefficients C(i, k) as a matrix (size, size) with rows k and columns i."""
    return np.array([[float(comb(i, k)) for i in range(size)] for k in range(size)])


class Peaks(NamedTuple):
    """Maxima of P polynomials on [0, 1], each (P,): an upper `bound`, and a value `taken` at the parameter `at`.

    `taken` is below `bound` by at most 1e-9 of the largest coefficient.
    """

    bound: FloatArray
    taken: FloatArray
    at: FloatArray


def peaks(rows: FloatArray) -> Peaks:
    """Return the maxima of polynomials in Bernstein form `rows: (P, d + 1)`, by subdivision.

    The largest Bernstein coefficient is an upper bound. Cells whose bound is not above a value taken elsewhere are
    dropped, and the others are halved. Each halving reduces the gap of the bound by a factor of four.
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
        lower, upper = halves(cells)
        middle = upper[:, 0]
        np.maximum.at(taken, owner, middle)
        best = middle == taken[owner]
        at[owner[best]] = left[best] + width
        owner, left = np.concatenate([owner, owner]), np.concatenate([left, left + width])
        cells = np.concatenate([lower, upper])
    # The last term bounds the rounding of fifteen halvings.
    bound = np.maximum(bound, taken) + 16 * (degree + 1) * EPS * largest
    return Peaks(bound, taken, at)


def halves(cells: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the Bernstein coefficients (C, d + 1) of both halves of cells, by de Casteljau's algorithm."""
    lower, upper, row = np.empty_like(cells), np.empty_like(cells), cells
    for k in range(cells.shape[1]):
        lower[:, k], upper[:, -1 - k] = row[:, 0], row[:, -1]
        row = 0.5 * (row[:, :-1] + row[:, 1:])
    return lower, upper
