"""Checks of the values in documents; errors name key and value.

Every check raises an `InputError` whose message starts with the key that it is about. Each level of a
document wraps its children in `within`, so that the message grows into the full path on its way up:
``scene.obstacles[2] 'table'.box.size: must be a positive number, got -0.2``.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import MISSING, Field, dataclass, fields
from pathlib import Path
from typing import Any, TypeVar

from safe_ompl.common import inputs
from safe_ompl.common.errors import InputError, cut, did_you_mean

_Section = TypeVar("_Section")
_Kind = TypeVar("_Kind", bound="Section")


@contextmanager
def within(place: str, separator: str = ".") -> Iterator[None]:
    """Put `place` before the key of every InputError raised inside the block."""
    try:
        yield
    except InputError as error:
        error.args = (f"{place}{separator}{error}",)
        raise


def mapping(key: str, value: Any, valid: Iterable[str] | None = None) -> dict[str, Any]:
    """Return `value` as a mapping with text keys, all of them among `valid` if given."""
    if not isinstance(value, Mapping):
        raise InputError(f"must be a mapping of keys to values, got {kind_of(value)}", key)
    for name in value:
        if not isinstance(name, str):
            raise InputError(f"the key {name!r} must be text", key)
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


def check_fields(cls: Any, data: Mapping[str, Any]) -> None:
    """Raise InputError unless the keys of `data` are fields of a dataclass, those without a default among them."""
    check_keys(data, [field.name for field in fields(cls)])
    for field in fields(cls):
        if _default(field) is MISSING:
            require(data, field.name)


def changed_fields(value: Any) -> dict[str, Any]:
    """Return the fields of a dataclass that differ from their defaults."""
    given = ((field, getattr(value, field.name)) for field in fields(value))
    return {field.name: found for field, found in given if found != _default(field)}


def _default(field: Field[Any]) -> Any:
    return field.default if field.default_factory is MISSING else field.default_factory()


@dataclass(frozen=True)
class Section:
    """A section of a document, whose keys are the fields of a dataclass; raises InputError that starts with the key."""

    @classmethod
    def from_mapping(cls: type[_Kind], data: Mapping[str, Any]) -> _Kind:
        """Read the section from a document."""
        check_fields(cls, data)
        return cls(**data)

    def to_mapping(self) -> dict[str, Any]:
        """Return what `from_mapping` reads: what is not the default."""
        return {key: _plain(value) for key, value in changed_fields(self).items()}


def _plain(value: Any) -> Any:
    if hasattr(value, "to_mapping"):
        return value.to_mapping()
    if isinstance(value, Mapping):
        return {key: _plain(item) for key, item in value.items()}
    return [_plain(item) for item in value] if isinstance(value, tuple) else value


def text(key: str, value: Any) -> str:
    """Return `value` as text that is not empty."""
    return inputs.text(f"{key}:", value)


def flag(key: str, value: Any) -> bool:
    """Return `value` as a bool."""
    return inputs.flag(f"{key}:", value)


def file(key: str, value: Any, endings: tuple[str, ...]) -> Path:
    """Return `value` as the absolute path of a file that exists and ends in one of `endings`."""
    if not isinstance(value, (str, os.PathLike)):
        raise InputError(f"must be a file name, got {inputs.shown(value)}", key)
    path = Path(value).resolve()
    if path.suffix.lower() not in endings:
        raise InputError(f"{str(value)!r} must end in {' or '.join(endings)}", key)
    if not path.is_file():
        raise InputError(f"{str(value)!r} does not exist", key)
    return path


def file_name(path: Path, folder: Path | None) -> str:
    """Return how a document in `folder` names `path`: relative to it, or in full if there is none."""
    return str(path) if folder is None else Path(os.path.relpath(path, folder.resolve())).as_posix()


def number(
    key: str, value: Any, *, above: float | None = None, at_least: float | None = None, at_most: float | None = None
) -> float:
    """Return `value` as a finite float within bounds."""
    return inputs.number(f"{key}:", value, above=above, at_least=at_least, at_most=at_most)


def numbers(
    key: str, value: Any, count: int | None = None, *, above: float | None = None, at_most: float | None = None
) -> tuple[float, ...]:
    """Return `value` as `count` finite floats, each larger than `above` and no larger than `at_most` if given."""
    items = sequence(key, value)
    if count is not None and len(items) != count:
        raise InputError(f"must be {count} numbers, got {len(items)}: {inputs.shown(items)}", key)
    return tuple(number(key, item, above=above, at_most=at_most) for item in items)


def interval(key: str, value: Any) -> tuple[float, float]:
    """Return `value` as two finite floats, the second one larger than the first."""
    low, high = numbers(key, value, 2)
    if not low < high:
        raise InputError(f"must be the least and the largest value, got [{low:g}, {high:g}]", key)
    return low, high


def numbers_by_name(
    key: str,
    value: Any,
    valid: Iterable[str] | None = None,
    *,
    above: float | None = None,
    at_least: float | None = None,
    at_most: float | None = None,
) -> dict[str, float]:
    """Return `value` as a mapping of names, among `valid` if given, to finite floats within bounds."""
    bounds = {"above": above, "at_least": at_least, "at_most": at_most}
    given = mapping(key, value, valid)
    with within(key):
        return {name: number(name, item, **bounds) for name, item in given.items()}


def section(key: str, value: Any, read: Callable[[dict[str, Any]], _Section]) -> _Section:
    """Return what `read` makes of a mapping; nothing is an empty one."""
    given = mapping(key, {} if value is None else value)
    with within(key):
        return read(given)


def sequence(key: str, value: Any) -> list[Any]:
    """Return `value` as a list; arrays are welcome, text is not."""
    if hasattr(value, "tolist"):
        value = value.tolist()
    if not isinstance(value, (list, tuple)):
        raise InputError(f"must be a list, got {kind_of(value)}", key)
    return list(value)


def kind_of(value: Any) -> str:
    """Return what `value` is, for messages: its type and how it is written."""
    return "nothing" if value is None else f"{type(value).__name__} {inputs.shown(value)}"
