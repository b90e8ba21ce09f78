"""Numbers in sentences: never rounded to the stronger side."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from decimal import ROUND_CEILING, ROUND_FLOOR, Context, Decimal

_DIGITS = 6


def exact(value: float) -> str:
    """Return a number as it is."""
    short = f"{value:g}"
    return short if float(short) == value else repr(float(value))


def listed(said: Callable[[float], str], values: Iterable[float]) -> str:
    return ", ".join(map(said, values))


def at_most(value: float) -> str:
    """Return a number in few digits, and none that is smaller."""
    return _rounded(value, ROUND_CEILING)


def at_least(value: float) -> str:
    """Return a number in few digits, and none that is larger."""
    return _rounded(value, ROUND_FLOOR)


def _rounded(value: float, way: str) -> str:
    near = Context(prec=_DIGITS, rounding=way).create_decimal(Decimal(repr(float(value))))
    return f"{float(near):g}"
