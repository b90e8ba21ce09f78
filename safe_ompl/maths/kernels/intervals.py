"""Whether numbers lie within bounds."""

from __future__ import annotations

from numba import njit

from safe_ompl.arrays import FloatArray


@njit(cache=True)
def within(values: FloatArray, bounds: FloatArray) -> bool:
    """Return whether all values (n,) lie within their bounds (2, n), lower and upper; NaN never does."""
    for i in range(values.shape[0]):  # noqa: SIM110  # Numba has no all()
        if not bounds[0, i] <= values[i] <= bounds[1, i]:
            return False
    return True
