"""The forms of JSON files, that of certificates with its digest, and strict readers of plain data.

A document is read into frozen dataclasses. Each field of such a class names its reader, so that the class is the
schema: a key that is no field is refused, a field without a default must be there, and every value has its type and
its range.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import MISSING, field, fields
from hashlib import sha256
from itertools import pairwise
from numbers import Integral, Real
from typing import Any, TypeVar

import numpy as np

from safe_ompl.common import FloatArray, InputError, UnknownNameError, shown
from safe_ompl.common import documents as document

FORMAT, VERSION = "safe-ompl certificate", 2
OWN_FORMAT, OWN_VERSION = "safe-ompl", 1  # of all other files
KINDS = ("result", "path", "scene", "trajectory", "motion")
OBSTACLE = "obstacle:"  # in front of the names of obstacles, so that none can pass for a link
_LONGEST_TEXT = 1000  # characters of a name or of a remark

Reader = Callable[[str, Any], Any]
T = TypeVar("T")


class NotPlainError(InputError):
    """A value that JSON cannot hold, or a robot that is not built from files."""


def digest(content: Mapping[str, Any]) -> str:
    """Return the SHA-256 of all of a certificate but its digest."""
    rest = {key: value for key, value in content.items() if key != "digest"}
    return sha256(json.dumps(rest, sort_keys=True).encode()).hexdigest()


def edges_of(path: FloatArray) -> Iterator[tuple[FloatArray, FloatArray]]:
    """Return the edges of a path (N, n); a path of one configuration is an edge to itself."""
    return pairwise(path) if len(path) > 1 else iter([(path[0], path[0])])


def as_plain(value: Any) -> Any:
    """Return a value as JSON has it, with lists and Python's numbers, or raise NotPlainError."""
    if isinstance(value, Mapping):
        return {str(part): as_plain(item) for part, item in value.items()}
    if isinstance(value, (list, tuple, np.ndarray)):
        return [as_plain(item) for item in value]
    if value is None or isinstance(value, (str, bool)):
        return value
    if isinstance(value, Real):
        return int(value) if isinstance(value, Integral) else float(value)
    raise NotPlainError(f"{shown(value)} is not plain data")


def check_form(content: Any, form: str = FORMAT, version: int = VERSION) -> None:
    """Raise InputError unless `content` says that it has a form, by default that of certificates, of a version."""
    found = content.get("format") if isinstance(content, Mapping) else None
    if found != form:
        raise InputError(f"must be {form!r}, got {shown(found)}", "format")
    given = content.get("version")
    if given != version or isinstance(given, (bool, float)):
        raise InputError(f"{shown(given)} is not known, {version} is", "version")


def marked(kind: str, content: Mapping[str, Any]) -> dict[str, Any]:
    """Return content with the marks of the form before it."""
    return {"format": OWN_FORMAT, "version": OWN_VERSION, "kind": kind, **content}


def strict_json(data: Any) -> str:
    """Return data as one line of strict JSON: what is not finite becomes null."""
    return json.dumps(_without_nan(data), allow_nan=False)


def kind_of(content: Any) -> str:
    """Return what kind of thing content of the form holds; raise InputError if it has another form or version."""
    check_form(content, OWN_FORMAT, OWN_VERSION)
    kind = document.text("kind", document.require(content, "kind"))
    if kind not in KINDS:
        raise UnknownNameError("kind of file", kind, KINDS)
    return kind


def _without_nan(data: Any) -> Any:
    if isinstance(data, float):
        return data if math.isfinite(data) else None
    if isinstance(data, Mapping):
        return {key: _without_nan(value) for key, value in data.items()}
    if isinstance(data, (list, tuple)):
        return [_without_nan(item) for item in data]
    return data


def key(reader: Reader, *, optional: bool = False) -> Any:
    """Return a field of a dataclass that is read with `reader`; None where it is optional and missing."""
    if optional:
        return field(default=None, metadata={"reader": or_none(reader)})
    return field(metadata={"reader": reader})


def record(kind: type[T]) -> Callable[[str, Any], T]:
    """Return the reader of a dataclass whose fields are of `key`."""
    known = {item.name: item for item in fields(kind)}  # type: ignore[arg-type]

    def read(name: str, value: Any) -> T:
        data = _mapping(name, value, known)
        with document.within(name):
            found = {}
            for part, item in known.items():
                if part in data or item.default is MISSING:
                    found[part] = item.metadata["reader"](part, document.require(data, part))
            return kind(**found)

    return read


def _mapping(name: str, value: Any, known: Iterable[str] | None) -> dict[str, Any]:
    for part in value if isinstance(value, Mapping) else ():
        if not (isinstance(part, str) and part.isprintable()):
            raise InputError(f"the key {shown(part)} is not text that can be printed", name)
    return document.mapping(name, value, known)


def or_none(reader: Reader) -> Reader:
    """Return a reader that lets None pass."""
    return lambda name, value: None if value is None else reader(name, value)


def number(*, above: float | None = None, at_least: float | None = None, at_most: float | None = None) -> Reader:
    """Return a reader of a finite number; only Python's own are plain data."""

    def read(name: str, value: Any) -> float:
        if not isinstance(value, (int, float)):
            raise InputError(f"must be a finite number, got {shown(value)}", name)
        return document.number(name, value, above=above, at_least=at_least, at_most=at_most)

    return read


def whole(name: str, value: Any) -> int:
    """Read a whole number >= 0."""
    if type(value) is not int or value < 0:
        raise InputError(f"must be a whole number >= 0, got {shown(value)}", name)
    return value


def text(name: str, value: Any) -> str:
    """Read one line of text that can be printed: no control characters that would change what a terminal shows."""
    if not isinstance(value, str) or not value.strip() or not value.isprintable() or len(value) > _LONGEST_TEXT:
        raise InputError(f"must be text of one line that can be printed, got {shown(value)}", name)
    return value


def one_of(*known: Any) -> Reader:
    """Return a reader of one of some values."""

    def read(name: str, value: Any) -> Any:
        if not any(value == item and type(value) is type(item) for item in known):
            raise UnknownNameError(name, value, map(str, known))
        return value

    return read


def some(reader: Reader, *, least: int = 0, count: int | None = None, of: str = "entry") -> Reader:
    """Return a reader of a list, as a tuple: of `count` entries, or of `least` at least."""

    def read(name: str, value: Any) -> tuple[Any, ...]:
        if type(value) is not list:
            raise InputError(f"must be a list, got {document.kind_of(value)}", name)
        if count is not None and len(value) != count:
            raise InputError(f"must have {count} entries, got {len(value)}", name)
        if len(value) < least:
            raise InputError(f"must name one {of} at least", name)
        return tuple(reader(f"{name}[{k}]", item) for k, item in enumerate(value))

    return read


def by_name(reader: Reader, *, least: int = 0, of: str = "entry", known: Iterable[str] | None = None) -> Reader:
    """Return a reader of a mapping from names, of `known` ones if given, to values of one kind."""

    def read(name: str, value: Any) -> dict[str, Any]:
        data = _mapping(name, value, known)
        if len(data) < least:
            raise InputError(f"must name one {of} at least", name)
        with document.within(name):
            return {text("a name", part): reader(part, item) for part, item in data.items()}

    return read


def array(*shape: int | None) -> Reader:
    """Return a reader of an array of finite numbers, of one or two dimensions; None stands for any length."""

    def read(name: str, value: Any) -> FloatArray:
        rows = [value] if len(shape) == 1 else value
        if type(value) is not list or not all(type(row) is list for row in rows):
            raise InputError(f"must be {'lists' if len(shape) > 1 else 'a list'} of numbers", name)
        if len({len(row) for row in rows}) > 1:
            raise InputError("must have rows of one length", name)
        if not all(isinstance(item, (int, float)) and _finite(item) for row in rows for item in row):
            raise InputError("must be numbers, all of them finite", name)
        found: FloatArray = np.array(value, dtype=np.float64)
        if len(shape) == 2 and not value:
            found = found.reshape(0, shape[1] or 0)
        if any(n is not None and n != m for n, m in zip(shape, found.shape, strict=True)):
            wanted = ", ".join("any" if n is None else str(n) for n in shape)
            raise InputError(f"must have shape ({wanted}), got {found.shape}", name)
        found.setflags(write=False)
        return found

    return read


def _finite(value: float) -> bool:
    try:
        return math.isfinite(value) and not isinstance(value, bool)
    except OverflowError:  # an int that no float holds
        return False


def sha(name: str, value: Any) -> str:
    """Read a SHA-256 in hexadecimal digits."""
    if not isinstance(value, str) or len(value) != 64 or not set(value) <= set("0123456789abcdef"):
        raise InputError(f"must be a SHA-256, got {shown(value)}", name)
    return value


def plain(name: str, value: Any, depth: int = 20) -> Any:
    """Read plain data of any kind, whose text can be printed; its user checks it further."""
    if depth == 0:
        raise InputError("is nested too deeply", name)
    if isinstance(value, Mapping):
        with document.within(name):
            items = _mapping("keys", value, None).items()
            return {part: plain(part, item, depth - 1) for part, item in items}
    if isinstance(value, (list, tuple)):
        return [plain(f"{name}[{k}]", item, depth - 1) for k, item in enumerate(value)]
    if value is None or isinstance(value, bool) or (isinstance(value, str) and value.isprintable()):
        return value
    if isinstance(value, (int, float)) and _finite(value):
        return value
    raise InputError(f"must be plain data, got {document.kind_of(value)}", name)
