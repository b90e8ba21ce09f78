"""Common parts of the documents of safe-ompl: format keys, digests, plain data, and files embedded in base 64."""

from __future__ import annotations

import json
import math
import re
import xml.etree.ElementTree as ElementTree
import zlib
from base64 import b64decode, b64encode
from collections.abc import Iterator, Mapping, Sequence
from hashlib import sha256
from numbers import Integral, Real
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np

from safe_ompl.common import InputError, UnknownNameError, documents as document, shown
from safe_ompl.robot import PackageDir, PackageFolders, parsed, robots_folder

FORMAT, VERSION = "safe-ompl certificate", 5
_OLD_FORMAT = "safe-ompl program certificate"
# The format of all files except certificates and ticks.
OWN_FORMAT, OWN_VERSION = "safe-ompl", 2
KINDS = ("result", "path", "scene", "trajectory", "motion")
# This prefix of obstacle names prevents an obstacle from having the name of a link.
OBSTACLE = "obstacle:"
_FILE_NAME = re.compile(r"[A-Za-z0-9_][A-Za-z0-9_.-]{0,99}")
# The largest number of characters of all files in one document together.
_MOST_CHARACTERS = 270_000_000
# The largest number of bytes of all files in one document together, after decompression.
_MOST_BYTES = 500_000_000


class NotPlainError(InputError):
    """Raised for a value that JSON cannot represent, or a robot that is not built from files."""


def digest(content: Mapping[str, Any]) -> str:
    """Return the SHA-256 of a certificate without its key `digest`."""
    rest = {key: value for key, value in content.items() if key != "digest"}
    return sha256(json.dumps(rest, sort_keys=True).encode()).hexdigest()


def as_plain(value: Any) -> Any:
    """Convert a value to JSON types: arrays to lists, NumPy numbers to Python's. Raise NotPlainError for others."""
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
    """Raise InputError unless `content` has this format and version; by default those of certificates."""
    found = content.get("format") if isinstance(content, Mapping) else None
    if found != form:
        older = "; it is of an earlier version: issue the certificate anew" if found == _OLD_FORMAT else ""
        raise InputError(f"must be {form!r}, got {shown(found)}{older}", "format")
    given = content.get("version")
    if given != version or isinstance(given, (bool, float)):
        older = "; issue the certificate anew" if form == FORMAT else ""
        raise InputError(f"{shown(given)} is not known, {version} is{older}", "version")


def with_header(kind: str, content: Mapping[str, Any]) -> dict[str, Any]:
    """Return `content` with the keys format, version and kind in front."""
    return {"format": OWN_FORMAT, "version": OWN_VERSION, "kind": kind, **content}


def kind_of(content: Any) -> str:
    """Return the kind of a document, one of `KINDS`. Raise InputError if it has another format or version."""
    check_form(content, OWN_FORMAT, OWN_VERSION)
    kind = document.text("kind", document.require(content, "kind"))
    if kind not in KINDS:
        raise UnknownNameError("kind of file", kind, KINDS)
    return kind


def strict_json(data: Any) -> str:
    """Return data as one line of strict JSON. NaN and infinities become null."""
    return json.dumps(_without_nan(data), allow_nan=False)


def _without_nan(data: Any) -> Any:
    if isinstance(data, float):
        return data if math.isfinite(data) else None
    if isinstance(data, Mapping):
        return {key: _without_nan(value) for key, value in data.items()}
    if isinstance(data, (list, tuple)):
        return [_without_nan(item) for item in data]
    return data


# ------------------------------------------------------------------------------------------ files that travel


def packed(path: Path) -> str:
    """Return the content of a file, compressed by zlib and encoded in base 64. Raise InputError if reading fails."""
    try:
        return b64encode(zlib.compress(path.read_bytes())).decode("ascii")
    except OSError as error:
        raise InputError(f"cannot be embedded in a document ({error.strerror})", str(path)) from None


def embedded_files(key: str, value: Any) -> dict[str, str]:
    """Read a mapping of file names to packed files. Raise InputError for names with folders, or too much data."""
    given = document.mapping(key, value)
    with document.within(key):
        for name in given:
            if not _FILE_NAME.fullmatch(name):
                raise InputError("is not the name of a file", repr(name))
        files = {name: document.text(name, data) for name, data in given.items()}
    total = sum(map(len, files.values()))
    if total > _MOST_CHARACTERS:
        raise InputError(f"have {total} characters, {_MOST_CHARACTERS} is the limit", key)
    return files


def embedded_objects(items: list[dict[str, Any]]) -> dict[str, str]:
    """Return the packed files that obstacles or attached objects name, and replace the names in `items` by their keys.

    `items` is modified in place.
    """
    files: dict[str, str] = {}
    for item in items:
        for part, value in item.items():
            if isinstance(value, dict) and "file" in value:
                path = Path(value["file"])
                name = f"{len(files)}{path.suffix}"
                files[name] = packed(path)
                item[part] = {**value, "file": name}
    return files


def check_embedded(key: str, items: Any, files: Mapping[str, str]) -> None:
    """Raise InputError unless `items` is a list of objects, and `files` contains every file that the objects name."""
    for k, item in enumerate(document.sequence(key, items)):
        for part, value in document.mapping(f"{key}[{k}]", item).items():
            if isinstance(value, dict) and "file" in value and value["file"] not in files:
                raise InputError(f"the file {value['file']!r} is not embedded", f"{key}[{k}].{part}.file")


def unpack(files: Mapping[str, str], folder: Path) -> None:
    """Decompress files into a folder. `embedded_files` has refused names that lead out of the folder.

    Raises InputError if a file is damaged, or all files together are larger than `_MOST_BYTES`.
    """
    room = _MOST_BYTES
    for name, data in files.items():
        try:
            unpacking = zlib.decompressobj()
            content = unpacking.decompress(b64decode(data, validate=True), room + 1)
        except (ValueError, zlib.error) as error:
            raise InputError(f"is not a compressed file in base 64: {error}", name) from None
        room -= len(content)
        if room < 0 or not unpacking.eof:
            raise InputError(f"is cut off, or all files together exceed {_MOST_BYTES} bytes", name)
        # References of .obj meshes to material files are removed, because the mesh loader would read these files.
        if name.lower().endswith(".obj"):
            content = re.sub(rb"(?im)^[ \t]*mtllib.*$", b"", re.sub(rb"\\[ \t]*\r?\n", b" ", content))
        (folder / name).write_bytes(content)


# ------------------------------------------------------------------------------------------------ meshes of URDFs


def place_meshes(urdf: Path, given: Sequence[PackageDir]) -> None:
    """Replace the mesh names in a URDF by the paths of files in the given folders or in example-robot-data."""
    try:
        root = parsed(urdf)
    except ElementTree.ParseError:
        # Building the robot reports what is wrong.
        return
    meshes = [mesh for mesh in root.iter("mesh") if mesh.get("filename")]
    for mesh in meshes:
        name = mesh.get("filename", "")
        place = next((place for place in _mesh_places(name, given) if place.is_file()), None)
        # The name of a mesh that was not found points into the folder of the URDF, which has no meshes.
        inside = "/".join(_steps(name) or (PurePosixPath(name).name,))
        mesh.set("filename", inside if place is None else str(place.resolve()))
    if meshes:
        urdf.write_bytes(ElementTree.tostring(root, encoding="utf-8"))


def _mesh_places(name: str, given: Sequence[PackageDir]) -> Iterator[Path]:
    """Yield possible paths of a mesh, all of them inside the given folders or example-robot-data."""
    steps, examples = _steps(name), examples_folder()
    if steps is None:
        return
    plain_name = name.removeprefix("file://")
    for folder in (entry for entry in given if isinstance(entry, Path)):
        if Path(plain_name).is_absolute() and Path(plain_name).is_relative_to(folder.resolve()):
            yield Path(plain_name)
        yield folder.joinpath(*steps)
    if examples is not None:
        yield examples.parents[1].joinpath(*steps)
    yield from PackageFolders(Path("/"), given).elsewhere(steps)


def _steps(name: str) -> tuple[str, ...] | None:
    """Split the name of a mesh into folders and file. Return None if the name is empty or contains `..`."""
    steps = PurePosixPath(re.sub(r"^[a-z]+://", "", name)).parts
    steps = tuple(step for step in steps if step != "/")
    return None if not steps or ".." in steps or "\0" in name else steps


def examples_folder() -> Path | None:
    """Return the folder of the robots of example-robot-data, or None if example-robot-data is not installed."""
    try:
        return robots_folder()
    except InputError:
        return None
