"""The marks of our JSON files, and of certificates with their digest; plain data."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from hashlib import sha256
from numbers import Integral, Real
from typing import Any

import numpy as np

from safe_ompl.common import InputError, UnknownNameError, shown
from safe_ompl.common import documents as document

FORMAT, VERSION = "safe-ompl certificate", 4
OWN_FORMAT, OWN_VERSION = "safe-ompl", 2  # of all other files
KINDS = ("result", "path", "scene", "trajectory", "motion")
OBSTACLE = "obstacle:"  # in front of the names of obstacles, so that none can pass for a link


class NotPlainError(InputError):
    """A value that JSON cannot hold, or a robot that is not built from files."""


def digest(content: Mapping[str, Any]) -> str:
    """Return the SHA-256 of all of a certificate but its digest."""
    rest = {key: value for key, value in content.items() if key != "digest"}
    return sha256(json.dumps(rest, sort_keys=True).encode()).hexdigest()


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


def kind_of(content: Any) -> str:
    """Return what kind of thing content of the form holds; raise InputError if it has another form or version."""
    check_form(content, OWN_FORMAT, OWN_VERSION)
    kind = document.text("kind", document.require(content, "kind"))
    if kind not in KINDS:
        raise UnknownNameError("kind of file", kind, KINDS)
    return kind


def strict_json(data: Any) -> str:
    """Return data as one line of strict JSON: what is not finite becomes null."""
    return json.dumps(_without_nan(data), allow_nan=False)


def _without_nan(data: Any) -> Any:
    if isinstance(data, float):
        return data if math.isfinite(data) else None
    if isinstance(data, Mapping):
        return {key: _without_nan(value) for key, value in data.items()}
    if isinstance(data, (list, tuple)):
        return [_without_nan(item) for item in data]
    return data
