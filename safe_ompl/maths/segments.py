"""The link segments of a skeleton, and how they weigh in its danger field."""

from __future__ import annotations

from typing import Literal, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from safe_ompl.arrays import FloatArray, IntArray, finite_array
from safe_ompl.errors import InputError, UnknownNameError

Weighting: TypeAlias = Literal["unit", "length"]
WEIGHTINGS: tuple[Weighting, ...] = ("unit", "length")


class Segments:
    """Link segments as pairs of key points.

    Parameters
    ----------
    pairs : array_like of int, shape (L, 2)
        Key points at the two ends of each segment; together they form a tree, or several.
    lengths : array_like, shape (L,), optional
        The lengths of the segments [m] where they are the same at every configuration, as on a robot without
        prismatic joints.

    Attributes
    ----------
    pairs : ndarray, shape (L, 2)
    lengths : ndarray, shape (L,), or None

    Raises
    ------
    InputError
        If the pairs are not an (L ≥ 1, 2) array of integers ≥ 0, or are more than their key points; if the
        lengths are not L numbers ≥ 0.
    """

    __slots__ = ("lengths", "pairs")

    def __init__(self, pairs: ArrayLike, lengths: ArrayLike | None = None) -> None:
        self.pairs = _checked_pairs(pairs)
        ends = len(np.unique(self.pairs))
        if len(self.pairs) > ends:
            raise InputError(f"{len(self.pairs)} segments between {ends} key points do not form a tree")
        self.lengths = None if lengths is None else _checked_lengths(lengths, len(self.pairs))

    def __len__(self) -> int:
        return len(self.pairs)

    def __repr__(self) -> str:
        lengths = "" if self.lengths is None else f", lengths={self.lengths.tolist()}"
        return f"Segments({self.pairs.tolist()}{lengths})"


def check_weighting(weighting: str) -> None:
    """Raise `UnknownNameError` unless `weighting` is "unit" or "length"."""
    if weighting not in WEIGHTINGS:
        raise UnknownNameError("weighting", weighting, WEIGHTINGS)


def _checked_pairs(pairs: ArrayLike) -> IntArray:
    array = np.array(pairs, order="C")
    if array.ndim != 2 or array.shape[1] != 2 or not array.size or array.dtype.kind != "i" or array.min() < 0:
        raise InputError(f"segments must be pairs of key point indices, shape (L ≥ 1, 2), got {pairs!r}")
    return array.astype(np.intp)


def _checked_lengths(lengths: ArrayLike, number: int) -> FloatArray:
    checked = finite_array(lengths, (number,), "lengths of segments")
    if checked.min() < 0:
        raise InputError(f"lengths of segments must not be negative, got {checked.tolist()}")
    return checked
