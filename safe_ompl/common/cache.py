"""A cache on disk for expensive results: small JSON values under a hash of all that they depend on.

They lie in the user's cache folder (`XDG_CACHE_HOME`, `~/Library/Caches` on macOS, `%LOCALAPPDATA%` on Windows). The
environment variable `SAFE_OMPL_CACHE` names another folder, or is `off`. If the folder
cannot be read or written, results are computed anew.
"""

from __future__ import annotations

import json
import logging
import os
import sys
from pathlib import Path
from typing import Any

from safe_ompl.common.files import write as write_file

_log = logging.getLogger(__name__)

VARIABLE = "SAFE_OMPL_CACHE"


def cache_folder() -> Path | None:
    """Return the folder for kept results, which need not exist; None if nothing is to be kept."""
    chosen = os.environ.get(VARIABLE, "")
    if chosen:
        return None if chosen.lower() == "off" else Path(chosen).expanduser()
    try:
        return _users_folder() / "safe-ompl"
    except RuntimeError as error:  # a user without a home
        _log.info("no cache: %s", error)
        return None


def _users_folder() -> Path:
    if sys.platform == "win32":
        local = os.environ.get("LOCALAPPDATA", "")
        return Path(local) if local else Path.home() / "AppData" / "Local"
    given = os.environ.get("XDG_CACHE_HOME", "")
    if Path(given).is_absolute():  # a relative one is to be ignored, says the specification
        return Path(given)
    return Path.home() / ("Library/Caches" if sys.platform == "darwin" else ".cache")


def read(kind: str, key: str) -> Any:
    """Return the value kept under `kind` and `key` (a hash), or None if there is none that can be read."""
    file = _file(kind, key)
    if file is None:
        return None
    try:
        content = json.loads(file.read_text(encoding="utf-8"))
    except FileNotFoundError:
        return None
    except (OSError, RecursionError, ValueError) as error:
        _log.info("cache: %s cannot be read (%s)", file, error)
        return None
    return content.get("value") if isinstance(content, dict) and content.get("key") == key else None


def write(kind: str, key: str, value: Any) -> None:
    """Keep a JSON value under `kind` and `key`; readers and writers at the same time see all of it or nothing."""
    file = _file(kind, key)
    if file is None:
        return
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        write_file(file, json.dumps({"key": key, "value": value}))
    except OSError as error:
        _log.info("cache: %s cannot be written (%s)", file, error)


def _file(kind: str, key: str) -> Path | None:
    folder = cache_folder()
    return None if folder is None else folder / f"{kind}-{key[:32]}.json"
