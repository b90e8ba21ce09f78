"""Types of arrays, and checks of what users give: numbers, flags, text, arrays and configurations.

Every function takes what people have (Python's and NumPy's scalars, lists, arrays), returns it as the plain type that
it stands for, or raises an `InputError` that reads ``<name>: must be <what would be right>, got <what was given>``.
A bool is never taken for a number, and NaN never for a value.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable
from numbers import Integral, Real
from typing import Any, TypeAlias, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from safe_ompl.common.errors import InputError, cut

FloatArray: TypeAlias = NDArray[np.float64]
IntArray: TypeAlias = NDArray[np.intp]
BoolArray: TypeAlias = NDArray[np.bool_]
_Kind = TypeVar("_Kind")

RATE_BOUNDS: dict[str, dict[str, Any]] = {
    "velocity": {"at_least": 1e-4, "at_most": 999.0},
    "acceleration": {"at_least": 1e-4, "at_most": 1e5},
    "jerk": {"at_least": 0.1, "at_most": 1e8},
    "speed": {"at_least": 1e-4, "at_most": 999.0},
}
"""What limits of joints [rad or m, s], and speeds of points [m/s], may be: arguments of `number`.

No arm is faster, so that a larger limit is a mistake; rates may be above the least ones by 1 % (`docs/proofs.md`).
"""
_LISTED = 12  # numbers of an array in a message
_SEEDS = 2**32
_FLOAT = np.dtype(np.float64)  # compared with ==: what kernels return has an equal one


def number(
    name: str,
    value: Any,
    *,
    above: float | None = None,
    at_least: float | None = None,
    at_most: float | None = None,
    kind: str = "number",
) -> float:
    """Return `value` as a finite float within bounds (of the lower ones at most one), or raise InputError.

    For the message: `name` says what the value is, `kind` what sort of number it is ("length", "number of seconds").
    """
    if type(value) is float and above is at_least is at_most is None and math.isfinite(value):
        return value  # as nearly all are; the rest takes five times as long
    plain = _scalar(value)
    if isinstance(plain, Real) and not isinstance(plain, bool):
        try:
            result = float(plain)
        except OverflowError:  # a whole number that no float holds
            result = math.inf
        if (
            math.isfinite(result)
            and (above is None or result > above)
            and (at_least is None or result >= at_least)
            and (at_most is None or result <= at_most)
        ):
            return result
    right = _bounded("finite", kind, above, at_least, at_most)
    raise InputError(f"must be {right}, got {shown(value)}", name)


def whole_number(name: str, value: Any, *, at_least: int | None = None, at_most: int | None = None) -> int:
    """Return `value` as an int within bounds, or raise InputError; a float is refused, even 3.0."""
    plain = _scalar(value)
    if isinstance(plain, Integral) and not isinstance(plain, bool):
        result = int(plain)
        if (at_least is None or result >= at_least) and (at_most is None or result <= at_most):
            return result
    right = _bounded("whole", "number", None, at_least, at_most)
    raise InputError(f"must be {right}, got {shown(value)}", name)


def fraction(name: str, value: Any) -> float:
    """Return `value` as a float in [0, 1], or raise InputError."""
    return number(name, value, at_least=0.0, at_most=1.0)


def seed(value: Any, name: str = "seed") -> int:
    """Return `value` as a seed of OMPL's and NumPy's generators, a whole number in [0, 2³²), or raise InputError."""
    return whole_number(name, value, at_least=0, at_most=_SEEDS - 1)


def flag(name: str, value: Any) -> bool:
    """Return `value` as a bool, or raise InputError; 0 and 1 are numbers."""
    if not isinstance(value, (bool, np.bool_)):
        raise InputError(f"must be true or false, got {shown(value)}", name)
    return bool(value)


def text(name: str, value: Any) -> str:
    """Return `value` as text that is not empty, or raise InputError."""
    if not isinstance(value, str) or not value.strip():
        raise InputError(f"must be text that is not empty, got {shown(value)}", name)
    return str(value)


def instance(name: str, value: Any, kind: type[_Kind]) -> _Kind:
    """Return `value` where it is of a class, or raise InputError, which names the class."""
    if not isinstance(value, kind):
        article = "an" if kind.__name__[0] in "AEIOU" else "a"
        raise InputError(f"must be {article} {kind.__name__}, got {shown(value)}", name)
    return value


def finite_array(value: ArrayLike, shape: tuple[int | None, ...], name: str) -> FloatArray:
    """Return `value` as a new float array of the given shape (None: any length), free of NaN and infinity.

    Raises InputError, whose message starts with `name`, if it is not numeric, has another shape, or holds NaN or
    infinity.
    """
    array = float_array(value, shape, name)
    if not np.isfinite(array).all():
        raise InputError(f"must be finite, got {_not_finite(array)}", name)
    return array


def float_array(value: ArrayLike, shape: tuple[int | None, ...], name: str) -> FloatArray:
    """Return `value` as `finite_array` does, but let NaN and infinity pass: for the data of sensors."""
    try:
        given = np.asarray(value)
        if given.dtype.kind not in "fiu":
            raise TypeError
        array = np.array(given, dtype=np.float64)
    except (OverflowError, TypeError, ValueError):
        raise InputError(f"must be numbers, got {shown(value)}", name) from None
    if array.ndim != len(shape) or any(n is not None and n != m for n, m in zip(shape, array.shape, strict=True)):
        wanted = "(" + ", ".join("any" if n is None else str(n) for n in shape) + ")"
        raise InputError(f"must have shape {wanted}, got {array.shape}", name)
    return array


def configuration(q: ArrayLike, n: int, name: str = "configuration") -> FloatArray:
    """Return `q` as a float array (n,), itself where it is one (half a microsecond); errors as `finite_array`."""
    if type(q) is np.ndarray and q.dtype == _FLOAT and q.shape == (n,) and math.isfinite(q.dot(q)):
        return q
    return finite_array(q, (n,), name)


def configurations(Q: ArrayLike, n: int, name: str = "configurations") -> FloatArray:
    """Return `Q` as a float array (B, n); see `configuration`."""
    is_batch = isinstance(Q, np.ndarray) and Q.dtype == _FLOAT and Q.ndim == 2 and Q.shape[1] == n
    if isinstance(Q, np.ndarray) and is_batch and math.isfinite(np.vdot(Q, Q)):
        return Q
    return finite_array(Q, (None, n), name)


def motion_ends(start: ArrayLike, end: ArrayLike, n: int) -> FloatArray:
    """Return the ends (2, n) of a motion as a float array; errors as `configuration`."""
    return np.array([configuration(start, n, "start of a motion"), configuration(end, n, "end of a motion")])


def shaped_configuration(q: ArrayLike, n: int, name: str) -> FloatArray:
    """Return `q` as a float array (n,); that what is one already is finite is for the caller to check."""
    if type(q) is np.ndarray and q.dtype == _FLOAT and q.shape == (n,):
        return q
    return finite_array(q, (n,), name)


def shown(value: Any) -> str:
    """Return how a value reads in a message: its `repr` on one line, cut where it is long."""
    return cut(repr(value))


def listed(names: Iterable[object]) -> str:
    """Return names with commas between them, cut where they are long."""
    return cut(", ".join(map(str, names)))


def _scalar(value: Any) -> Any:
    """Return an array without dimensions as the number in it."""
    return value.item() if isinstance(value, np.ndarray) and value.ndim == 0 else value


def _bounded(sort: str, kind: str, above: float | None, at_least: float | None, at_most: float | None) -> str:
    """Return what a number must be: "a finite number >= 0", "a positive number", "a whole number in [0, 9]"."""
    if above == 0 and at_most is None:
        return f"a positive {kind}"
    lower = f"> {above:g}" if above is not None else f">= {at_least:g}" if at_least is not None else ""
    if at_most is None:
        return f"a {sort} {kind} {lower}".rstrip()
    if not lower:
        return f"a {sort} {kind} <= {at_most:g}"
    opening, least = ("(", above) if above is not None else ("[", at_least)
    return f"a {sort} {kind} in {opening}{least:g}, {at_most:.10g}]"


def _not_finite(array: FloatArray) -> str:
    if array.size <= _LISTED:
        return str(array.tolist())
    first = tuple(int(k) for k in np.argwhere(~np.isfinite(array))[0])
    return f"{array[first]} at {list(first)}"


def halton_point(index: int, dimension: int) -> FloatArray:
    """Return point number `index` ≥ 1 of Halton's sequence in [0, 1)ⁿ, which fills the cube evenly.

    Its i-th coordinate is the radical inverse of the index in the i-th prime: the digits mirrored at the point.
    """
    primes = (number for number in itertools.count(2) if all(number % divisor for divisor in range(2, number)))
    return np.array([_radical_inverse(index, prime) for prime in itertools.islice(primes, dimension)])


def _radical_inverse(index: int, base: int) -> float:
    inverse, place = 0.0, 1.0
    while index:
        index, digit = divmod(index, base)
        place /= base
        inverse += digit * place
    return inverse


def told_apart(value: float, *others: float) -> tuple[str, ...]:
    """Return numbers for a message, the first with as many digits as tell it from the others."""
    for digits in range(6, 18):
        shown = tuple(f"{number:.{digits}g}" for number in (value, *others))
        if shown[0] not in shown[1:]:
            break
    return shown
