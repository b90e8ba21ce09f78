"""Types of the arrays that the package passes around, and points that fill a cube evenly."""

from __future__ import annotations

from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

FloatArray: TypeAlias = NDArray[np.float64]
IntArray: TypeAlias = NDArray[np.intp]
BoolArray: TypeAlias = NDArray[np.bool_]


def halton_point(index: int, dimension: int) -> FloatArray:
    """Return point number `index` ≥ 1 of Halton's sequence in [0, 1)ⁿ, which fills the cube evenly.

    Its i-th coordinate is the radical inverse of the index in the i-th prime: the digits mirrored at the point.
    """
    return np.array([_radical_inverse(index, prime) for prime in first_primes(dimension)])


def first_primes(count: int) -> list[int]:
    """Return the first `count` primes."""
    primes: list[int] = []
    candidate = 2
    while len(primes) < count:
        if all(candidate % prime for prime in primes):
            primes.append(candidate)
        candidate += 1
    return primes


def _radical_inverse(index: int, base: int) -> float:
    inverse, place = 0.0, 1.0
    while index:
        index, digit = divmod(index, base)
        place /= base
        inverse += digit * place
    return inverse
