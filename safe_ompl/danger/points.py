"""Danger points: the places in the workspace that must not come to harm, and how much each of them counts."""

from __future__ import annotations

from collections.abc import Callable, Sized
from typing import TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from safe_ompl.arrays import FloatArray, IntArray, finite_array
from safe_ompl.errors import InputError
from safe_ompl.maths.field import columns

PointSource: TypeAlias = Callable[[FloatArray], ArrayLike]


class DangerPoints:
    """Danger points that are fixed, or given by a callable for every configuration, with their weights.

    Parameters
    ----------
    source : array_like, shape (M, 3), or callable
        The points [m], or what maps a configuration (n,) to them, always equally many.
    weights : array_like, shape (M,), optional
        w > 0; 1 by default.
    k1 : float
        k₁ of the field, by which the charges are scaled.

    Attributes
    ----------
    source : ndarray, shape (M, 3), read-only, or callable
    weights : ndarray, shape (M,), read-only, or None

    Raises
    ------
    InputError
        If points or weights have the wrong shape, are not finite, or weights are not positive.
    """

    def __init__(self, source: ArrayLike | PointSource, weights: ArrayLike | None, k1: float) -> None:
        self.source: FloatArray | PointSource = source if callable(source) else _checked_points(source)
        number = None if self.fixed is None else len(self.fixed)
        self.weights: FloatArray | None = None if weights is None else _checked_weights(weights, number)
        self._k1 = k1
        self._columns = None if self.fixed is None else columns(self.fixed)
        self._charges = self._charged(number)

    @property
    def fixed(self) -> FloatArray | None:
        """The points (M, 3) [m]; None where a callable gives them."""
        return self.source if isinstance(self.source, np.ndarray) else None

    def at(self, Q: FloatArray) -> FloatArray:
        """Return the points, (M, 3) or, where they depend on the configuration, (B, M, 3), at `Q: (B, n)`.

        Raises
        ------
        InputError
            If the callable gives other numbers of points, or points that are none.
        """
        if isinstance(self.source, np.ndarray):
            return self.source
        found = [_checked_points(self.source(q)) for q in Q]
        numbers = {len(points) for points in found}
        if self.weights is not None:
            numbers.add(len(self.weights))
        if len(numbers) > 1:
            raise InputError(f"the number of danger points must not change, got {sorted(numbers)}")
        return np.reshape(found, (len(Q), *(numbers or {1}), 3))

    def prepared(self, Q: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return points (1 or B, 3, M) and charges k₁w (1, M), as kernels read them, at `Q: (B, n)`."""
        if self._columns is not None and self._charges is not None:
            return self._columns, self._charges
        turned = columns(self.at(Q))
        charges = self._charges if self._charges is not None else self._charged(turned.shape[2])
        assert charges is not None
        return turned, charges

    def chosen(self, points: FloatArray, rows: IntArray, terms: IntArray) -> tuple[FloatArray, FloatArray]:
        """Return points (C, 1, 3) and weights (C, 1): for each of `rows: (C,)` the one of `terms: (C,)`."""
        places = points[terms] if points.ndim == 2 else points[rows, terms]
        weights = np.ones(len(terms)) if self.weights is None else self.weights[terms]
        return places[:, None], weights[:, None]

    def _charged(self, number: int | None) -> FloatArray | None:
        """Return the charges (1, M); None where nobody knows how many there are."""
        if self.weights is not None:
            return (self._k1 * self.weights)[None]
        return None if number is None else np.full((1, number), self._k1)


def _checked_points(points: ArrayLike) -> FloatArray:
    """Return danger points (M, 3); read-only."""
    if isinstance(points, Sized) and not len(points):
        points = np.zeros((0, 3))
    checked = finite_array(points, (None, 3), "danger points")
    checked.setflags(write=False)
    return checked


def _checked_weights(weights: ArrayLike, number: int | None) -> FloatArray:
    checked = finite_array(weights, (number,), "danger weights")
    if not (checked > 0).all():
        raise InputError(
            f"danger weights must be positive, got {checked[checked <= 0].tolist()}; leave out the others"
        )
    checked.setflags(write=False)
    return checked
