"""The scene as plain data that travels whole: its document, and its mesh and point files byte by byte."""

from __future__ import annotations

import re
from base64 import b64decode, b64encode
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from safe_ompl.common import CertificateError, InputError
from safe_ompl.common import documents as document
from safe_ompl.io.schema import by_name, key, plain, record, sha
from safe_ompl.scene import Scene

_FILE_NAME = re.compile(r"[A-Za-z0-9_][A-Za-z0-9_.-]{0,99}")
_MOST_BYTES = 200_000_000  # of all files that travel in one document


def _file_content(name: str, value: Any) -> str:
    if not _FILE_NAME.fullmatch(name):
        raise InputError("is not the name of a file", repr(name))
    return document.text(name, value)


carried_files = by_name(_file_content)


@dataclass(frozen=True, kw_only=True)
class SceneDocument:
    """A scene as it travels: `hash` of what it holds, its document, its files in base 64 by name."""

    hash: str = key(sha)
    content: Mapping[str, Any] = key(lambda name, value: plain(name, document.mapping(name, value)))
    files: Mapping[str, str] = key(carried_files)


def carried_scene(scene: Scene) -> dict[str, Any]:
    """Return the scene as plain data: its document, its files in base 64, its hash.

    Raises
    ------
    InputError
        If a file of the scene is gone, or has changed since it was read.
    """
    content = scene.to_mapping(None)
    files: dict[str, str] = {}
    for obstacle in content["obstacles"]:
        for part, value in obstacle.items():
            if isinstance(value, dict) and "file" in value:
                path = Path(value["file"])
                name = f"{len(files)}{path.suffix}"
                files[name] = encoded(path)
                obstacle[part] = {**value, "file": name}
    carried = {"hash": scene.content_hash(), "content": content, "files": files}
    try:
        if files:
            built_scene(carried)
    except CertificateError:
        raise InputError(
            "a mesh or point file of the scene has changed since it was read: read the scene anew"
        ) from None
    return carried


def built_scene(carried: Mapping[str, Any] | SceneDocument) -> Scene:
    """Return the scene that a document carries.

    Raises
    ------
    InputError
        If it is not one.
    CertificateError
        If it is not the scene of its hash.
    """
    if not isinstance(carried, SceneDocument):
        carried = record(SceneDocument)("carried", carried)
    for part, value in _file_names(carried.content):
        if value not in carried.files:
            raise InputError(f"the file {value!r} is not carried", part)
    with TemporaryDirectory(prefix="safe-ompl-") as folder:
        unpack(carried.files, Path(folder))
        try:
            scene = Scene.from_mapping(carried.content, Path(folder))
        except InputError as error:
            raise InputError(str(error).replace(f"{folder}/", "")) from None
        except MemoryError:
            raise InputError("a file asks for more memory than there is", "files") from None
    if scene.content_hash() != carried.hash:
        raise CertificateError("the scene that it carries is not the one that it was written for")
    return scene


def _file_names(content: Mapping[str, Any]) -> Iterator[tuple[str, Any]]:
    for k, item in enumerate(document.sequence("obstacles", content.get("obstacles", ()))):
        for part, value in document.mapping(f"obstacles[{k}]", item).items():
            if isinstance(value, dict) and "file" in value:
                yield f"obstacles[{k}].{part}.file", value["file"]


# ------------------------------------------------------------------------------------------------------- files


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


def unpack(files: Mapping[str, str], folder: Path) -> None:
    """Write files into a folder; names that lead out of it are none, see `carried_files`.

    Raises
    ------
    InputError
        If there is too much, or a content is not in base 64.
    """
    total = 3 * sum(map(len, files.values())) // 4
    if total > _MOST_BYTES:
        raise InputError(f"have {total} bytes, {_MOST_BYTES} are the most", "files")
    for name, data in files.items():
        try:
            content = b64decode(data, validate=True)
        except ValueError as error:
            raise InputError(f"not in base 64: {error}", name) from None
        (folder / name).write_bytes(_self_contained(content) if name.lower().endswith(".obj") else content)


def _self_contained(obj: bytes) -> bytes:
    """Return an OBJ file without the names of other files, which would be read."""
    return re.sub(rb"(?im)^[ \t]*mtllib.*$", b"", re.sub(rb"\\[ \t]*\r?\n", b" ", obj))
