"""Checks of the configurations, edges and margins that users give to the models."""

from __future__ import annotations

from math import isfinite

import numpy as np
from numpy.typing import ArrayLike

from safe_ompl.common import FloatArray, InputError, finite_array

_FLOAT = np.dtype(np.float64)


def configuration(q: ArrayLike, n: int, name: str = "configuration") -> FloatArray:
    """Return `q` as a float array (n,); one that is such an array already is returned as it is, in half a microsecond.

    Raises
    ------
    InputError
        If it is not numeric, has another shape, or holds NaN or infinity.
    """
    if type(q) is np.ndarray and q.dtype is _FLOAT and q.shape == (n,) and isfinite(q.dot(q)):
        return q
    return finite_array(q, (n,), name)


def configurations(Q: ArrayLike, n: int) -> FloatArray:
    """Return `Q` as a float array (B, n); see `configuration`."""
    is_batch = isinstance(Q, np.ndarray) and Q.dtype is _FLOAT and Q.ndim == 2 and Q.shape[1] == n
    if isinstance(Q, np.ndarray) and is_batch and isfinite(np.vdot(Q, Q)):
        return Q
    return finite_array(Q, (None, n), "configurations")


def edge(start: ArrayLike, end: ArrayLike, n: int) -> FloatArray:
    """Return the ends (2, n) of a motion as a float array; errors as `configuration`."""
    return np.array([configuration(start, n, "start of a motion"), configuration(end, n, "end of a motion")])


def unchecked(q: ArrayLike, n: int, name: str) -> FloatArray:
    """Return `q` as a float array (n,); whether one that is such an array is finite is for the caller to find out."""
    if type(q) is np.ndarray and q.dtype is _FLOAT and q.shape == (n,):
        return q
    return finite_array(q, (n,), name)


def margins_of(margins: ArrayLike, pairs: int) -> FloatArray:
    """Return security margins [m] as a float array (P,): one for each pair, or one number for all.

    Raises
    ------
    InputError
        If they are not numeric, have another shape, are not finite, or negative.
    """
    number = np.ndim(margins) == 0
    checked = finite_array(margins, () if number else (pairs,), "margins")
    if not (checked >= 0).all():
        raise InputError(f"margins must be lengths >= 0 [m], got {checked[checked < 0].tolist()}")
    return np.full(pairs, float(checked)) if number else checked
