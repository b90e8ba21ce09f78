"""The JSON form that results, paths and scenes share, and the robot, scene and danger that they are about."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from safe_ompl.common import InputError, UnknownNameError
from safe_ompl.common import documents as document

FORMAT, VERSION = "safe-ompl", 1
KINDS = ("result", "path", "scene", "trajectory")


def marked(kind: str, content: Mapping[str, Any]) -> dict[str, Any]:
    """Return content with the marks of the form before it."""
    return {"format": FORMAT, "version": VERSION, "kind": kind, **content}


def strict_json(data: Any) -> str:
    """Return data as one line of strict JSON: what is not finite becomes null."""
    return json.dumps(_without_nan(data), allow_nan=False)


def read_json(file: str | Path) -> Any:
    """Return what a JSON file holds.

    Raises
    ------
    InputError
        If it cannot be read or is not JSON.
    """
    try:
        return json.loads(Path(file).read_text(encoding="utf-8"))
    except (OSError, RecursionError, ValueError) as error:
        raise InputError(f"cannot be read as JSON: {error}", str(file)) from None


def kind_of(content: Any) -> str:
    """Return what kind of thing content of the form holds.

    Raises
    ------
    InputError
        If it has another form, or a version that is not known.
    """
    if not isinstance(content, Mapping) or content.get("format") != FORMAT:
        found = content.get("format") if isinstance(content, Mapping) else type(content).__name__
        raise InputError(f"must be {FORMAT!r}, as `safe_ompl.save` writes, not {found!r}", "format")
    version = content.get("version")
    if version != VERSION or isinstance(version, (bool, float)):
        raise InputError(f"{version!r} is not known, {VERSION} is", "version")
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
