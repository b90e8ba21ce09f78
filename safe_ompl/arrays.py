"""Types of the arrays that the package passes around, and the checks at its doors."""

from __future__ import annotations

from typing import TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from safe_ompl.errors import InputError

FloatArray: TypeAlias = NDArray[np.float64]
IntArray: TypeAlias = NDArray[np.intp]
BoolArray: TypeAlias = NDArray[np.bool_]


def finite_array(value: ArrayLike, shape: tuple[int | None, ...], name: str) -> FloatArray:
    """Return `value` as a float array of the given shape, free of NaN and infinity.

    Parameters
    ----------
    value : array_like
        What the user gave.
    shape : tuple
        Expected shape; None stands for any length.
    name : str
        What the value is, for the message.

    Raises
    ------
    InputError
        If it is not numeric, has another shape, or holds NaN or infinity.
    """
    try:
        array = np.array(value, dtype=np.float64)
    except (OverflowError, TypeError, ValueError):
        raise InputError(f"{name} must be numbers, got {value!r}") from None
    if array.ndim != len(shape) or any(
        n is not None and n != m for n, m in zip(shape, array.shape, strict=True)
    ):
        wanted = "(" + ", ".join("any" if n is None else str(n) for n in shape) + ")"
        raise InputError(f"{name} must have shape {wanted}, got {array.shape}")
    if not np.isfinite(array).all():
        raise InputError(f"{name} must be finite, got {array.tolist()}")
    return array


def positive(value: float, name: str, kind: str = "number") -> float:
    """Return `value` as a float, or raise InputError if it is not a finite number > 0, of the kind that `kind` says."""
    if not (isinstance(value, (int, float, np.number)) and 0 < value < np.inf):
        raise InputError(f"{name} must be a positive {kind}, got {value!r}")
    return float(value)
