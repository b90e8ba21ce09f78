"""Checks of the values in a document, whose errors name key and value.

Every check raises an `InputError` whose message starts with the key that it is about. Each level of a
document wraps its children in `within`, so that the message grows into the full path on its way up:
``scene.obstacles[2] 'table'.box.size: must be a positive number, got -0.2``.
"""

from __future__ import annotations

import difflib
import os
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from safe_ompl import inputs
from safe_ompl.errors import InputError


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
            close = difflib.get_close_matches(str(name), known, n=1)
            hint = f"did you mean {close[0]!r}? " if close else ""
            raise InputError(f"unknown key; {hint}valid keys: {', '.join(known)}", str(name))


def require(data: Mapping[str, Any], key: str) -> Any:
    """Return ``data[key]``, or raise InputError if there is none."""
    if key not in data:
        raise InputError("missing, but needed", key)
    return data[key]


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
    key: str,
    value: Any,
    *,
    above: float | None = None,
    at_least: float | None = None,
    at_most: float | None = None,
) -> float:
    """Return `value` as a finite float within bounds."""
    return inputs.number(f"{key}:", value, above=above, at_least=at_least, at_most=at_most)


def numbers(
    key: str,
    value: Any,
    count: int | None = None,
    *,
    above: float | None = None,
    at_most: float | None = None,
) -> tuple[float, ...]:
    """Return `value` as `count` finite floats, each larger than `above` and no larger than `at_most` if given."""
    items = sequence(key, value)
    if count is not None and len(items) != count:
        raise InputError(f"must be {count} numbers, got {len(items)}: {inputs.shown(items)}", key)
    return tuple(number(key, item, above=above, at_most=at_most) for item in items)


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
