"""Validation of user input, from Python calls and from YAML or JSON documents.

Each function accepts Python and NumPy values. Functions for single values, lists and mappings return plain Python
types; functions for arrays return NumPy arrays. An invalid value raises an `InputError` of the form
``<key>: must be <what would be right>, got <what was given>``. A bool is not accepted as a number. `float_array`
accepts NaN and infinity, and `configuration_unchecked` does not look for them in arrays; all other functions refuse
them.

A `Section` of a document is a dataclass. Each field is declared with the function `key`, which takes the check of the
value and the default. Construction, `from_mapping` and `to_mapping` use these. Each level reads its children inside
`within`, which puts the key of the level before the key in the error message:
``scene.obstacles[2] 'table'.box.size: must be a positive number, got -0.2``. `files.reading` adds file and line.
"""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import MISSING, Field, dataclass, field, fields
from functools import cache
from numbers import Integral, Real
from pathlib import Path
from typing import Any, TypeAlias, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from safe_ompl.common.errors import InputError, UnknownNameError, cut, did_you_mean, shown

FloatArray: TypeAlias = NDArray[np.float64]
IntArray: TypeAlias = NDArray[np.intp]
BoolArray: TypeAlias = NDArray[np.bool_]
_Kind = TypeVar("_Kind")
_Section = TypeVar("_Section", bound="Section")

RATE_BOUNDS: dict[str, dict[str, Any]] = {
    "velocity": {"at_least": 1e-4, "at_most": 999.0},
    "acceleration": {"at_least": 1e-4, "at_most": 1e5},
    "jerk": {"at_least": 0.1, "at_most": 1e8},
    "speed": {"at_least": 1e-4, "at_most": 999.0},
}
"""Allowed ranges of joint limits (in rad or m, and s) and of point speeds [m/s], as keyword arguments of `number`.

No robot arm exceeds the upper bounds. The tolerance of `safe_ompl.check` is 1 % of the lower bounds (`docs/proofs.md`).
"""

# A message shows at most this many numbers of an array.
_LISTED = 12
_SEEDS = 2**32
# dtypes are compared with ==, because arrays of compiled modules can have an equal dtype that is another object.
_FLOAT = np.dtype(np.float64)
# Names and remarks have at most this many characters.
_LONGEST_LINE = 1000
# Limit of the nesting of `plain` data.
_DEEPEST = 20
_folder: ContextVar[Path | None] = ContextVar("folder", default=None)


# This is a class, because a generator-based context manager takes three times as long.
class within:  # noqa: N801 (a context manager)
    """Put `place` before the key of every InputError raised inside the block."""

    def __init__(self, place: str, separator: str = ".") -> None:
        self._before = place, separator

    def __enter__(self) -> None:
        pass

    def __exit__(self, kind: Any, error: BaseException | None, trace: Any) -> None:
        if isinstance(error, InputError):
            error.args = ("".join((*self._before, str(error))),)


# -------------------------------------------------------------------------------------------------------- single values


def number(
    key: str,
    value: Any,
    *,
    above: float | None = None,
    at_least: float | None = None,
    at_most: float | None = None,
    kind: str = "number",
) -> float:
    """Return `value` as a finite float within the bounds, or raise InputError. Give at most one lower bound.

    The message begins with `key` and uses the noun `kind` for the value ("length", "number of seconds").
    """
    if type(value) is float and above is at_least is at_most is None and math.isfinite(value):
        # Most values are plain floats without bounds. The general code takes five times as long.
        return value
    plain = _scalar(value)
    if isinstance(plain, Real) and not isinstance(plain, bool):
        try:
            result = float(plain)
        except OverflowError:
            # The integer is too large for a float.
            result = math.inf
        if (
            math.isfinite(result)
            and (above is None or result > above)
            and (at_least is None or result >= at_least)
            and (at_most is None or result <= at_most)
        ):
            return result
    right = _bounded("finite", kind, above, at_least, at_most)
    raise InputError(f"must be {right}, got {shown(value)}", key)


def whole_number(key: str, value: Any, *, at_least: int | None = None, at_most: int | None = None) -> int:
    """Return `value` as an int within bounds, or raise InputError; a float is refused, even 3.0."""
    plain = _scalar(value)
    if isinstance(plain, Integral) and not isinstance(plain, bool):
        result = int(plain)
        if (at_least is None or result >= at_least) and (at_most is None or result <= at_most):
            return result
    right = _bounded("whole", "number", None, at_least, at_most)
    raise InputError(f"must be {right}, got {shown(value)}", key)


def fraction(key: str, value: Any) -> float:
    """Return `value` as a float in [0, 1], or raise InputError."""
    return number(key, value, at_least=0.0, at_most=1.0)


def seed(value: Any, key: str = "seed") -> int:
    """Return `value` as a random seed for OMPL and NumPy, an int in [0, 2³²), or raise InputError."""
    return whole_number(key, value, at_least=0, at_most=_SEEDS - 1)


def flag(key: str, value: Any) -> bool:
    """Return `value` as a bool, or raise InputError; 0 and 1 are refused."""
    if not isinstance(value, (bool, np.bool_)):
        raise InputError(f"must be true or false, got {shown(value)}", key)
    return bool(value)


def text(key: str, value: Any) -> str:
    """Return `value` as non-empty text, or raise InputError."""
    if not isinstance(value, str) or not value.strip():
        raise InputError(f"must be text that is not empty, got {shown(value)}", key)
    return str(value)


def instance(key: str, value: Any, kind: type[_Kind]) -> _Kind:
    """Return `value` if it is an instance of `kind`, else raise InputError with the name of the class."""
    if not isinstance(value, kind):
        article = "an" if kind.__name__[0] in "AEIOU" else "a"
        raise InputError(f"must be {article} {kind.__name__}, got {shown(value)}", key)
    return value


def line(key: str, value: Any) -> str:
    """Return `value` as one line of text, or raise InputError; control characters would garble a terminal."""
    if not isinstance(value, str) or not value.strip() or not value.isprintable() or len(value) > _LONGEST_LINE:
        raise InputError(f"must be text on one line without control characters, got {shown(value)}", key)
    return value


def one_of(key: str, value: Any, known: Iterable[Any]) -> Any:
    """Return `value` if `known` has an equal value of the same type, else raise UnknownNameError."""
    known = tuple(known)
    if not any(value == item and type(value) is type(item) for item in known):
        raise UnknownNameError(key, value, map(str, known))
    return value


def sha(key: str, value: Any) -> str:
    """Return `value` as a SHA-256 of 64 lowercase hexadecimal digits, or raise InputError."""
    if not isinstance(value, str) or len(value) != 64 or not set(value) <= set("0123456789abcdef"):
        raise InputError(f"must be a SHA-256 digest of 64 hexadecimal digits, got {shown(value)}", key)
    return value


# -------------------------------------------------------------------------------------------- arrays and configurations


def finite_array(value: ArrayLike, shape: tuple[int | None, ...], name: str) -> FloatArray:
    """Return `value` as a new float array of the given shape (None: any length) without NaN and infinity.

    Raises InputError, whose message starts with `name`, if `value` is not numeric, has another shape, or contains NaN
    or infinity.
    """
    array = float_array(value, shape, name)
    if not np.isfinite(array).all():
        raise InputError(f"must be finite, got {_not_finite(array)}", name)
    return array


def float_array(value: ArrayLike, shape: tuple[int | None, ...], name: str) -> FloatArray:
    """Return `value` as `finite_array` does, but allow NaN and infinity, since sensor data contain them."""
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
    """Return `q` as a finite float array (n,). Raises as `finite_array`.

    A finite float array of this shape is returned without a copy; the call then takes 0.5 µs.
    """
    if type(q) is np.ndarray and q.dtype == _FLOAT and q.shape == (n,) and math.isfinite(q.dot(q)):
        return q
    return finite_array(q, (n,), name)


def configurations(Q: ArrayLike, n: int, name: str = "configurations") -> FloatArray:
    """Return a batch of B configurations as a finite float array (B, n).

    A finite float array of this shape is not copied, as in `configuration`.
    """
    is_batch = isinstance(Q, np.ndarray) and Q.dtype == _FLOAT and Q.ndim == 2 and Q.shape[1] == n
    if isinstance(Q, np.ndarray) and is_batch and math.isfinite(np.vdot(Q, Q)):
        return Q
    return finite_array(Q, (None, n), name)


def motion_ends(start: ArrayLike, end: ArrayLike, n: int) -> FloatArray:
    """Return start and end of a motion as a new float array (2, n). Raises as `configuration`."""
    return np.array([configuration(start, n, "start of a motion"), configuration(end, n, "end of a motion")])


def configuration_unchecked(q: ArrayLike, n: int, name: str) -> FloatArray:
    """Return `q` as `configuration` does, but do not check a float array of this shape for NaN and infinity.

    The caller makes this check later.
    """
    if type(q) is np.ndarray and q.dtype == _FLOAT and q.shape == (n,):
        return q
    return finite_array(q, (n,), name)


def array(key: str, value: Any, *, ndim: int = 1) -> FloatArray:
    """Return nested lists of finite numbers as a read-only array with `ndim` (1 or 2) dimensions and any shape."""
    if isinstance(value, np.ndarray):
        value = value.tolist()
    rows = [value] if ndim == 1 else value
    if not isinstance(value, (list, tuple)) or not all(isinstance(row, (list, tuple)) for row in rows):
        raise InputError(f"must be {'lists' if ndim > 1 else 'a list'} of numbers", key)
    if len({len(row) for row in rows}) > 1:
        raise InputError("must have rows of equal length", key)
    if not all(_is_finite(item) for row in rows for item in row):
        raise InputError("must be numbers, all of them finite", key)
    # NumPy cannot infer the second dimension of an empty list, so the shape (0, 0) is given.
    found = np.array(value, dtype=np.float64).reshape((0, 0) if ndim == 2 and not value else (len(value), -1)[:ndim])
    found.setflags(write=False)
    return found


# ---------------------------------------------------------------------------------------------------------------- lists


def sequence(key: str, value: Any) -> list[Any]:
    """Return `value` as a list; arrays are accepted, text is refused."""
    if hasattr(value, "tolist"):
        value = value.tolist()
    if not isinstance(value, (list, tuple)):
        raise InputError(f"must be a list, got {described(value)}", key)
    return list(value)


def list_of(
    key: str, value: Any, read: Callable[..., Any], *, count: int | None = None, item_name: str = "", **options: Any
) -> tuple[Any, ...]:
    """Read each entry of a list with `read` and return the results as a tuple.

    The list must have `count` entries if given. If `item_name` (a noun for the message) is given, an empty
    list is refused. Raises InputError.
    """
    items = sequence(key, value)
    if count is not None and len(items) != count:
        raise InputError(f"must have {count} entries, got {len(items)}", key)
    if item_name and not items:
        raise InputError(f"must contain at least one {item_name}", key)
    return tuple(read(f"{key}[{k}]", item, **options) for k, item in enumerate(items))


def numbers(key: str, value: Any, count: int | None = None, **bounds: Any) -> tuple[float, ...]:
    """Return `value` as `count` finite floats (None: any number), each within the `bounds` of `number`."""
    items = sequence(key, value)
    if count is not None and len(items) != count:
        raise InputError(f"must be {count} numbers, got {len(items)}: {shown(items)}", key)
    return tuple(number(key, item, **bounds) for item in items)


def interval(key: str, value: Any) -> tuple[float, float]:
    """Return `value` as two finite floats (low, high) with low < high, or raise InputError."""
    low, high = numbers(key, value, 2)
    if not low < high:
        raise InputError(f"must be [low, high] with low < high, got [{low:g}, {high:g}]", key)
    return low, high


# ------------------------------------------------------------------------------------------------------------- mappings


def mapping(key: str, value: Any, valid: Iterable[str] | None = None) -> dict[str, Any]:
    """Return `value` as a dict with printable text keys, or raise InputError.

    If `valid` is given, other keys are refused.
    """
    if not isinstance(value, Mapping):
        raise InputError(f"must be a mapping of keys to values, got {described(value)}", key)
    for name in value:
        if not (isinstance(name, str) and name.isprintable()):
            raise InputError(f"the key {shown(name)} must be printable text", key)
    if valid is not None:
        with within(key):
            check_keys(value, valid)
    return dict(value)


def check_keys(data: Mapping[str, Any], valid: Iterable[str]) -> None:
    """Raise InputError for the first key of `data` that is not among `valid`."""
    known = list(valid)
    for name in data:
        if name not in known:
            hint = did_you_mean(name, known)
            raise InputError(f"unknown key; {hint}valid keys: {', '.join(known)}", cut(str(name)))


def require(data: Mapping[str, Any], key: str) -> Any:
    """Return ``data[key]``, or raise InputError if the key is missing."""
    if key not in data:
        raise InputError("missing, but needed", key)
    return data[key]


def section(key: str, value: Any, kind: Any) -> Any:
    """Return `value` unchanged if it is an instance of `kind`, else read it by `kind.from_mapping`.

    None is read as an empty mapping.
    """
    if isinstance(value, kind):
        return value
    given = mapping(key, {} if value is None else value)
    with within(key):
        return kind.from_mapping(given)


def mapping_of(
    key: str,
    value: Any,
    read: Callable[..., Any],
    known: Iterable[str] | None = None,
    item_name: str = "",
    **options: Any,
) -> dict[str, Any]:
    """Read each value of a mapping with `read` and return the results by name.

    If given, `known` lists the allowed names. If `item_name` (a noun for the message) is given, an empty
    mapping is refused. Raises InputError.
    """
    given = mapping(key, value, known)
    if item_name and not given:
        raise InputError(f"must contain at least one {item_name}", key)
    with within(key):
        return {line("a name", name): read(name, item, **options) for name, item in given.items()}


def plain(key: str, value: Any, depth: int = _DEEPEST) -> Any:
    """Return a copy of mappings, lists, finite numbers, bools, None and printable text, or raise InputError."""
    if depth == 0:
        raise InputError("is nested too deeply", key)
    if isinstance(value, Mapping):
        with within(key):
            return {name: plain(name, item, depth - 1) for name, item in mapping("keys", value).items()}
    if isinstance(value, (list, tuple)):
        return [plain(f"{key}[{k}]", item, depth - 1) for k, item in enumerate(value)]
    if value is None or isinstance(value, bool) or _is_finite(value):
        return value
    if isinstance(value, str) and value.isprintable():
        return value
    raise InputError(f"must be a number, text, true, false, null, a list or a mapping, got {described(value)}", key)


# ------------------------------------------------------------------------------------------ files that a document names


@contextmanager
def _in_folder(folder: Path | None) -> Iterator[None]:
    """Inside the block, take file names in documents as relative to `folder`; None changes nothing."""
    token = _folder.set(_folder.get() if folder is None else folder.resolve())
    try:
        yield
    finally:
        _folder.reset(token)


def folder_of_document() -> Path:
    """Return the folder of the document being read. File names in the document are relative to this folder."""
    return _folder.get() or Path()


def file(key: str, value: Any, endings: tuple[str, ...]) -> Path:
    """Return `value` as the absolute path of an existing file with one of the `endings`, or raise InputError."""
    if not isinstance(value, (str, os.PathLike)):
        raise InputError(f"must be a file name, got {shown(value)}", key)
    path = folder_of_document() / value
    if path.suffix.lower() not in endings:
        raise InputError(f"{str(path)!r} must end in {' or '.join(endings)}", key)
    if not path.is_file():
        raise InputError(f"{str(path)!r} does not exist", key)
    return path.resolve()


def file_name(path: Path, folder: Path | None = None) -> str:
    """Return `path` as a document writes it: relative to `folder`, or unchanged if there is no folder.

    The default folder is the folder of the document being written.
    """
    folder = folder or _folder.get()
    return str(path) if folder is None else Path(os.path.relpath(path, folder.resolve())).as_posix()


# ------------------------------------------------------------------------------------------------------------- sections


def key(read: Callable[..., Any], /, *, default: Any = MISSING, factory: Any = MISSING, **options: Any) -> Any:
    """Declare a field of a `Section`. ``read(key, value, **options)`` checks its value.

    A field without `default` and `factory` is required.
    """
    return field(default=default, default_factory=factory, metadata={"read": read, "options": options})


@dataclass(frozen=True)
class Section:
    """A section of a document, whose keys are the fields made by `key`; an InputError begins with the key."""

    def __post_init__(self) -> None:
        for item in keys_of(type(self)):
            value = getattr(self, item.name)
            # Defaults are valid and may have another type, such as None, so they are not checked.
            if value is not item.default:
                read = item.metadata["read"](item.name, value, **item.metadata["options"])
                object.__setattr__(self, item.name, read)
        self.check()

    def check(self) -> None:
        """Raise InputError if the values contradict each other."""

    @classmethod
    def from_mapping(cls: type[_Section], data: Mapping[str, Any], folder: Path | None = None) -> _Section:
        """Read the section from a mapping; file names are relative to `folder`. Raises InputError for a wrong key."""
        known = keys_of(cls)
        check_keys(data, [item.name for item in known])
        for item in known:
            if _default(item) is MISSING:
                require(data, item.name)
        with _in_folder(folder):
            return cls(**data)

    def to_mapping(self, folder: Path | None = None) -> dict[str, Any]:
        """Return the section as a mapping for `from_mapping`. Keys with default values are left out."""
        with _in_folder(folder):
            given = ((item.name, getattr(self, item.name), _default(item)) for item in keys_of(type(self)))
            return {
                name: _written(value)
                for name, value, usual in given
                if value is not usual and (isinstance(value, np.ndarray) or value != usual)
            }


def keys_of(cls: type[Any]) -> tuple[Field[Any], ...]:
    """Return the fields of a class that are made by `key`."""
    # Arguments of cached functions must be hashable, but mypy thinks that a class is not.
    hashable: Any = cls
    return _keys_of(hashable)


@cache
def _keys_of(cls: Any) -> tuple[Field[Any], ...]:
    return tuple(item for item in fields(cls) if "read" in item.metadata)


def _default(item: Field[Any]) -> Any:
    return item.default if item.default_factory is MISSING else item.default_factory()


def _written(value: Any) -> Any:
    if hasattr(value, "to_mapping"):
        return value.to_mapping()
    if isinstance(value, Path):
        return file_name(value)
    if isinstance(value, Mapping):
        return {name: _written(item) for name, item in value.items()}
    if isinstance(value, np.ndarray):
        return value.tolist()
    return [_written(item) for item in value] if isinstance(value, tuple) else value


# ------------------------------------------------------------------------------------------------------------- messages


def described(value: Any) -> str:
    """Describe `value` for an error message by its type and its text."""
    return "nothing" if value is None else f"{type(value).__name__} {shown(value)}"


def _scalar(value: Any) -> Any:
    """Unwrap a 0-dimensional array to a Python scalar; return other values unchanged."""
    return value.item() if isinstance(value, np.ndarray) and value.ndim == 0 else value


def _bounded(adjective: str, noun: str, above: float | None, at_least: float | None, at_most: float | None) -> str:
    """Describe the allowed numbers: "a finite number >= 0", "a positive number", "a whole number in [0, 9]"."""
    if above == 0 and at_most is None:
        return f"a positive {noun}"
    lower = f"> {above:g}" if above is not None else f">= {at_least:g}" if at_least is not None else ""
    if at_most is None:
        return f"a {adjective} {noun} {lower}".rstrip()
    if not lower:
        return f"a {adjective} {noun} <= {at_most:g}"
    opening, bound = ("(", above) if above is not None else ("[", at_least)
    return f"a {adjective} {noun} in {opening}{bound:g}, {at_most:.10g}]"


def _not_finite(array: FloatArray) -> str:
    if array.size <= _LISTED:
        return str(array.tolist())
    first = tuple(int(k) for k in np.argwhere(~np.isfinite(array))[0])
    return f"{array[first]} at {list(first)}"


def _is_finite(value: Any) -> bool:
    try:
        return isinstance(value, (int, float)) and not isinstance(value, bool) and math.isfinite(value)
    except OverflowError:
        # The integer is too large for a float.
        return False
