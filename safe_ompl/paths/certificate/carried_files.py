"""Files that travel inside a certificate: byte by byte, in base 64, under names without folders."""

from __future__ import annotations

from base64 import b64decode, b64encode
from collections.abc import Mapping
from pathlib import Path, PurePosixPath
from typing import Any

from safe_ompl import document
from safe_ompl.errors import InputError


def encoded(path: Path) -> str:
    """Return the content of a file in base 64.

    Raises
    ------
    InputError
        If it cannot be read.
    """
    try:
        return b64encode(path.read_bytes()).decode("ascii")
    except OSError as error:
        raise InputError(f"cannot be carried in a certificate ({error.strerror})", str(path)) from None


def unpack(files: Mapping[str, Any], folder: Path) -> None:
    """Write files into a folder, and nowhere else.

    Raises
    ------
    InputError
        If a name leads out of the folder, or a content is not in base 64.
    """
    for name, data in files.items():
        if PurePosixPath(name).name != name or "\\" in name:
            raise InputError(f"{name!r} is not the name of a file", "files")
        (folder / name).write_bytes(_decoded(name, data))


def _decoded(name: str, data: Any) -> bytes:
    text = document.text(name, data)
    try:
        return b64decode(text, validate=True)
    except ValueError as error:
        raise InputError(f"not in base 64: {error}", name) from None
