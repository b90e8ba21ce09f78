"""Checks of what users give, in Python and in documents: numbers, text, arrays, lists, mappings; and sections.

Every check takes what people have (Python's and NumPy's scalars, lists, arrays), returns it as the plain type that it
stands for, or raises an `InputError` that reads ``<key>: must be <what would be right>, got <what was given>``. A bool
is never taken for a number, and NaN never for a value.

A `Section` of a document is a dataclass that names each key once, with the check of its value and its default (`key`).
From that follow the checks where Python makes one, reading from a mapping, and writing. Each level of a document wraps
its children in `within`, so that the message grows into the full path on its way up:
``scene.obstacles[2] 'table'.box.size: must be a positive number, got -0.2``. `files.reading` adds file and line.
"""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import MISSING, Field, dataclass, field, fields
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
"""What limits of joints [rad or m, s], and speeds of points [m/s], may be: arguments of `number`.

No arm is faster, so that a larger limit is a mistake; rates may be above the least ones by 1 % (`docs/proofs.md`).
"""

# A message shows at most this many numbers of an array.
_LISTED = 12
_SEEDS = 2**32
# Types are compared with ==, since arrays of kernels have an equal type, not the same object.
_FLOAT = np.dtype(np.float64)
# The longest name or remark, in characters.
_LONGEST_LINE = 1000
_DEEPEST = 20  # levels of `plain` data
_folder: ContextVar[Path | None] = ContextVar("folder", default=None)


class within:  # noqa: N801 (a context manager, in a third of the time of one that is a generator)
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
        # Nearly all values end here. The general way takes five times as long.
        return value
    plain = _scalar(value)
    if isinstance(plain, Real) and not isinstance(plain, bool):
        try:
            result = float(plain)
        except OverflowError:
            # The whole number is too large for a float.
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


def line(key: str, value: Any) -> str:
    """Return one line of text that can be printed: no control characters that would change what a terminal shows."""
    if not isinstance(value, str) or not value.strip() or not value.isprintable() or len(value) > _LONGEST_LINE:
        raise InputError(f"must be text of one line that can be printed, got {shown(value)}", key)
    return value


def one_of(key: str, value: Any, known: Iterable[Any]) -> Any:
    """Return `value`, which is one of some values."""
    known = tuple(known)
    if not any(value == item and type(value) is type(item) for item in known):
        raise UnknownNameError(key, value, map(str, known))
    return value


def sha(key: str, value: Any) -> str:
    """Return a SHA-256 in hexadecimal digits."""
    if not isinstance(value, str) or len(value) != 64 or not set(value) <= set("0123456789abcdef"):
        raise InputError(f"must be a SHA-256, got {shown(value)}", key)
    return value


# -------------------------------------------------------------------------------------------- arrays and configurations


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


def array(key: str, value: Any, *, ndim: int = 1) -> FloatArray:
    """Return lists of finite numbers as an array that cannot be written to, of any lengths in one or two dimensions."""
    if isinstance(value, np.ndarray):
        value = value.tolist()
    rows = [value] if ndim == 1 else value
    if not isinstance(value, (list, tuple)) or not all(isinstance(row, (list, tuple)) for row in rows):
        raise InputError(f"must be {'lists' if ndim > 1 else 'a list'} of numbers", key)
    if len({len(row) for row in rows}) > 1:
        raise InputError("must have rows of one length", key)
    if not all(_is_finite(item) for row in rows for item in row):
        raise InputError("must be numbers, all of them finite", key)
    found = np.array(value, dtype=np.float64).reshape((0, 0) if ndim == 2 and not value else (len(value), -1)[:ndim])
    found.setflags(write=False)
    return found


# ---------------------------------------------------------------------------------------------------------------- lists


def sequence(key: str, value: Any) -> list[Any]:
    """Return `value` as a list; arrays are welcome, text is not."""
    if hasattr(value, "tolist"):
        value = value.tolist()
    if not isinstance(value, (list, tuple)):
        raise InputError(f"must be a list, got {described(value)}", key)
    return list(value)


def each(
    key: str, value: Any, read: Callable[..., Any], *, count: int | None = None, least: str = "", **options: Any
) -> tuple[Any, ...]:
    """Return `value` as a tuple of what is read: of `count` entries; one `least` there is, if that is named."""
    items = sequence(key, value)
    if count is not None and len(items) != count:
        raise InputError(f"must have {count} entries, got {len(items)}", key)
    if least and not items:
        raise InputError(f"must name one {least} at least", key)
    return tuple(read(f"{key}[{k}]", item, **options) for k, item in enumerate(items))


def numbers(key: str, value: Any, count: int | None = None, **bounds: Any) -> tuple[float, ...]:
    """Return `value` as `count` finite floats, each within bounds of `number`."""
    items = sequence(key, value)
    if count is not None and len(items) != count:
        raise InputError(f"must be {count} numbers, got {len(items)}: {shown(items)}", key)
    return tuple(number(key, item, **bounds) for item in items)


def interval(key: str, value: Any) -> tuple[float, float]:
    """Return `value` as two finite floats, the second one larger than the first."""
    low, high = numbers(key, value, 2)
    if not low < high:
        raise InputError(f"must be the least and the largest value, got [{low:g}, {high:g}]", key)
    return low, high


# ------------------------------------------------------------------------------------------------------------- mappings


def mapping(key: str, value: Any, valid: Iterable[str] | None = None) -> dict[str, Any]:
    """Return `value` as a mapping with text keys, all of them among `valid` if given."""
    if not isinstance(value, Mapping):
        raise InputError(f"must be a mapping of keys to values, got {described(value)}", key)
    for name in value:
        if not (isinstance(name, str) and name.isprintable()):
            raise InputError(f"the key {shown(name)} must be text that can be printed", key)
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
    """Return ``data[key]``, or raise InputError if there is none."""
    if key not in data:
        raise InputError("missing, but needed", key)
    return data[key]


def section(key: str, value: Any, kind: Any) -> Any:
    """Return `value` as a class with `from_mapping`: itself, or what that reads; nothing is an empty mapping."""
    if isinstance(value, kind):
        return value
    given = mapping(key, {} if value is None else value)
    with within(key):
        return kind.from_mapping(given)


def by_name(
    key: str, value: Any, read: Callable[..., Any], known: Iterable[str] | None = None, least: str = "", **options: Any
) -> dict[str, Any]:
    """Return `value` as a mapping of names, among `known` if given, to what is read: one `least`, if that is said."""
    given = mapping(key, value, known)
    if least and not given:
        raise InputError(f"must name one {least} at least", key)
    with within(key):
        return {line("a name", name): read(name, item, **options) for name, item in given.items()}


def plain(key: str, value: Any, depth: int = _DEEPEST) -> Any:
    """Return plain data of any kind, whose text can be printed; its user checks it further."""
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
    raise InputError(f"must be plain data, got {described(value)}", key)


# ------------------------------------------------------------------------------------------ files that a document names


@contextmanager
def _in_folder(folder: Path | None) -> Iterator[None]:
    """Have files that are read or written inside the block named relative to a folder, if there is one."""
    token = _folder.set(_folder.get() if folder is None else folder.resolve())
    try:
        yield
    finally:
        _folder.reset(token)


def folder_of_document() -> Path:
    """Return the folder that names of files in the document that is read are relative to."""
    return _folder.get() or Path()


def file(key: str, value: Any, endings: tuple[str, ...]) -> Path:
    """Return `value` as the absolute path of a file that exists and ends in one of `endings`."""
    if not isinstance(value, (str, os.PathLike)):
        raise InputError(f"must be a file name, got {shown(value)}", key)
    path = folder_of_document() / value
    if path.suffix.lower() not in endings:
        raise InputError(f"{str(path)!r} must end in {' or '.join(endings)}", key)
    if not path.is_file():
        raise InputError(f"{str(path)!r} does not exist", key)
    return path.resolve()


def file_name(path: Path, folder: Path | None = None) -> str:
    """Return how a document in a folder, by default the one being written, names `path`; in full if there is none."""
    folder = folder or _folder.get()
    return str(path) if folder is None else Path(os.path.relpath(path, folder.resolve())).as_posix()


# ------------------------------------------------------------------------------------------------------------- sections


def key(read: Callable[..., Any], /, *, default: Any = MISSING, factory: Any = MISSING, **options: Any) -> Any:
    """Return the field of a `Section` that ``read(key, value, **options)`` checks; without a default it is needed."""
    return field(default=default, default_factory=factory, metadata={"read": read, "options": options})


@dataclass(frozen=True)
class Section:
    """A section of a document, whose keys are the fields made by `key`; raises InputError that starts with the key."""

    def __post_init__(self) -> None:
        for item in keys_of(type(self)):
            value = getattr(self, item.name)
            if value is not item.default:
                read = item.metadata["read"](item.name, value, **item.metadata["options"])
                object.__setattr__(self, item.name, read)
        self.check()

    def check(self) -> None:
        """Raise InputError unless the values fit together."""

    @classmethod
    def from_mapping(cls: type[_Section], data: Mapping[str, Any], folder: Path | None = None) -> _Section:
        """Read the section from a document; files in it are relative to `folder`."""
        known = keys_of(cls)
        check_keys(data, [item.name for item in known])
        for item in known:
            if _default(item) is MISSING:
                require(data, item.name)
        with _in_folder(folder):
            return cls(**data)

    def to_mapping(self, folder: Path | None = None) -> dict[str, Any]:
        """Return what `from_mapping` reads: what is not the default."""
        with _in_folder(folder):
            given = ((item.name, getattr(self, item.name), _default(item)) for item in keys_of(type(self)))
            return {
                name: _written(value)
                for name, value, usual in given
                if value is not usual and (isinstance(value, np.ndarray) or value != usual)
            }


def keys_of(cls: type[Any]) -> list[Field[Any]]:
    """Return the fields of a class that are made by `key`."""
    return [item for item in fields(cls) if "read" in item.metadata]


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
    """Return what `value` is, for messages: its type and how it is written."""
    return "nothing" if value is None else f"{type(value).__name__} {shown(value)}"


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


def _is_finite(value: Any) -> bool:
    try:
        return isinstance(value, (int, float)) and not isinstance(value, bool) and math.isfinite(value)
    except OverflowError:
        # The integer is too large for a float.
        return False
