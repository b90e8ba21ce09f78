"""Values on the command line, and how they are read: what argparse calls types."""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable
from typing import Any, TypeVar

_Number = TypeVar("_Number", int, float)

_BOOLEANS = {"true": True, "yes": True, "on": True, "false": False, "no": False, "off": False}


def seconds(text: str) -> float:
    """Read a time limit [s]."""
    return _number(float, text, lambda value: 0 < value < math.inf, "a positive number of seconds")


def count(text: str) -> int:
    """Read how many."""
    return _number(int, text, lambda value: value >= 1, "a whole number of at least 1")


def random_seed(text: str) -> int:
    """Read a seed."""
    return _number(int, text, lambda value: 0 <= value < 2**32, "a whole number in [0, 2**32)")


def limit(text: str) -> float:
    """Read a limit."""
    return _number(float, text, lambda value: 0 < value < math.inf, "a positive number")


def finite(text: str) -> float:
    """Read a finite number."""
    return _number(float, text, math.isfinite, "a finite number")


def noise(text: str) -> float:
    """Read how large errors are, 0 for none."""
    return _number(float, text, lambda value: 0 <= value < math.inf, "a finite number >= 0")


def share(text: str) -> float:
    """Read a share."""
    return _number(float, text, lambda value: 0 <= value <= 1, "a share in [0, 1]")


def port(text: str) -> int:
    """Read the port of a server."""
    return _number(int, text, lambda value: 1 <= value < 2**16, "a port in [1, 65535]")


def degrees(text: str) -> float:
    """Read an angle in degrees; return it in radians."""
    return math.radians(_number(float, text, lambda value: 0 < value <= 180, "an angle in (0, 180] degrees"))


def names(text: str) -> tuple[str, ...]:
    """Read names with commas between them."""
    found = tuple(name.strip() for name in text.split(","))
    if not all(found):
        raise argparse.ArgumentTypeError(f"must be names with commas between them, not {text!r}")
    return found


def positions(text: str) -> slice:
    """Read a range of positions like Python's: ``0:50``, ``:50``, ``50:``; or one position."""
    first, colon, last = text.partition(":")
    try:
        start = int(first) if first else 0
        stop = (int(last) if last else None) if colon else start + 1
    except ValueError:
        start, stop = -1, None
    if not text or start < 0 or (stop is not None and stop <= start):
        raise argparse.ArgumentTypeError(f"must be a range such as 0:50, or a position, not {text!r}")
    return slice(start, stop)


def parameter(text: str) -> tuple[str, Any]:
    """Read ``name=value`` with a number, true, yes, on, false, no, off, or else text."""
    name, value = _assignment(text, "name=value")
    for kind in (int, float):
        try:
            return name, kind(value)
        except ValueError:
            pass
    return name, _BOOLEANS.get(value.lower(), value)


def joint_value(text: str) -> tuple[str, float]:
    """Read ``joint=value`` [rad or m]."""
    name, value = _assignment(text, "joint=value")
    return name, _number(float, value, math.isfinite, f"a finite number for joint {name!r}")


def speeds(text: str) -> dict[str, float]:
    """Read ``name=speed`` [m/s], several with commas between them."""
    found: dict[str, float] = {}
    for part in text.split(","):
        name, value = _assignment(part, "NAME=SPEED[,NAME=SPEED…]")
        if name in found:
            raise argparse.ArgumentTypeError(f"{name!r} is given twice")
        found[name] = _number(
            float, value, lambda speed: 0 <= speed < math.inf, f"a speed >= 0 [m/s] for {name!r}"
        )
    return found


def _assignment(text: str, form: str) -> tuple[str, str]:
    name, equals, value = (part.strip() for part in text.partition("="))
    if not (name and equals and value):
        raise argparse.ArgumentTypeError(f"must have the form {form}, not {text!r}")
    return name, value


def _number(kind: Callable[[str], _Number], text: str, fits: Callable[[_Number], bool], what: str) -> _Number:
    try:
        value = kind(text)
        if fits(value):
            return value
    except ValueError:
        pass
    raise argparse.ArgumentTypeError(f"must be {what}, not {text!r}")
