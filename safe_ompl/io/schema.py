"""What documents of ours have in common: marks, a digest, plain data, and files that travel inside, in base 64."""

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
# The form of all files but certificates and ticks.
OWN_FORMAT, OWN_VERSION = "safe-ompl", 2
KINDS = ("result", "path", "scene", "trajectory", "motion")
# It stands before the names of obstacles, so that none can pass for a link.
OBSTACLE = "obstacle:"
_FILE_NAME = re.compile(r"[A-Za-z0-9_][A-Za-z0-9_.-]{0,99}")
# All files that travel in one document have no more characters.
_MOST_CHARACTERS = 270_000_000
# Unpacked they have no more bytes.
_MOST_BYTES = 500_000_000


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
        older = "; it is of an earlier version: issue the certificate anew" if found == _OLD_FORMAT else ""
        raise InputError(f"must be {form!r}, got {shown(found)}{older}", "format")
    given = content.get("version")
    if given != version or isinstance(given, (bool, float)):
        older = "; issue the certificate anew" if form == FORMAT else ""
        raise InputError(f"{shown(given)} is not known, {version} is{older}", "version")


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


# ------------------------------------------------------------------------------------------ files that travel


def packed(path: Path) -> str:
    """Return the content of a file as it travels, or raise InputError."""
    try:
        return b64encode(zlib.compress(path.read_bytes())).decode("ascii")
    except OSError as error:
        raise InputError(f"cannot be carried in a document ({error.strerror})", str(path)) from None


def carried_files(key: str, value: Any) -> dict[str, str]:
    """Read files by name; no name leads out of a folder."""
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


def carried_objects(items: list[dict[str, Any]]) -> dict[str, str]:
    """Return the files that obstacles or attached objects name, as they travel, and have the items name these."""
    files: dict[str, str] = {}
    for item in items:
        for part, value in item.items():
            if isinstance(value, dict) and "file" in value:
                path = Path(value["file"])
                name = f"{len(files)}{path.suffix}"
                files[name] = packed(path)
                item[part] = {**value, "file": name}
    return files


def check_carried(key: str, items: Any, files: Mapping[str, str]) -> None:
    """Raise InputError unless this is a list of objects, and none names a file that does not travel with it."""
    for k, item in enumerate(document.sequence(key, items)):
        for part, value in document.mapping(f"{key}[{k}]", item).items():
            if isinstance(value, dict) and "file" in value and value["file"] not in files:
                raise InputError(f"the file {value['file']!r} is not carried", f"{key}[{k}].{part}.file")


def unpack(files: Mapping[str, str], folder: Path) -> None:
    """Write files into a folder; names that lead out of it are none, see `carried_files`."""
    room = _MOST_BYTES
    for name, data in files.items():
        try:
            unpacking = zlib.decompressobj()
            content = unpacking.decompress(b64decode(data, validate=True), room + 1)
        except (ValueError, zlib.error) as error:
            raise InputError(f"is not a compressed file in base 64: {error}", name) from None
        room -= len(content)
        if room < 0 or not unpacking.eof:
            raise InputError(f"is cut, or all files are larger than {_MOST_BYTES} bytes", name)
        # Meshes are written without the names of other files, which would be read.
        if name.lower().endswith(".obj"):
            content = re.sub(rb"(?im)^[ \t]*mtllib.*$", b"", re.sub(rb"\\[ \t]*\r?\n", b" ", content))
        (folder / name).write_bytes(content)


# ------------------------------------------------------------------------------------------------ meshes of URDFs


def place_meshes(urdf: Path, given: Sequence[PackageDir]) -> None:
    """Let a carried URDF name its meshes where they are: in folders that are given, or in example-robot-data."""
    try:
        root = parsed(urdf)
    except ElementTree.ParseError:
        # Building the robot reports what is wrong.
        return
    meshes = [mesh for mesh in root.iter("mesh") if mesh.get("filename")]
    for mesh in meshes:
        name = mesh.get("filename", "")
        place = next((place for place in _mesh_places(name, given) if place.is_file()), None)
        # Inside the folder of the URDF, which has no other file.
        inside = "/".join(_steps(name) or (PurePosixPath(name).name,))
        mesh.set("filename", inside if place is None else str(place.resolve()))
    if meshes:
        urdf.write_bytes(ElementTree.tostring(root, encoding="utf-8"))


def _mesh_places(name: str, given: Sequence[PackageDir]) -> Iterator[Path]:
    """Yield where a mesh may be, all of it in folders that are given, or in example-robot-data."""
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
    """Return the folders and the file that a name of a mesh goes through; None where it goes back up."""
    steps = PurePosixPath(re.sub(r"^[a-z]+://", "", name)).parts
    steps = tuple(step for step in steps if step != "/")
    return None if not steps or ".." in steps or "\0" in name else steps


def examples_folder() -> Path | None:
    """Return the folder of the robots of example-robot-data, or None where that is not installed."""
    try:
        return robots_folder()
    except InputError:
        return None
