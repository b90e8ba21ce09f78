"""Files that travel inside documents: in base 64, meshes of robots compressed, or found in given folders."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ElementTree
import zlib
from base64 import b64decode, b64encode
from collections.abc import Iterator, Mapping, Sequence
from hashlib import sha256
from pathlib import Path, PurePosixPath
from typing import Any

from safe_ompl.common import InputError
from safe_ompl.common import documents as document
from safe_ompl.io.schema import by_name
from safe_ompl.robot import PackageFolders, parsed, robots_folder

_FILE_NAME = re.compile(r"[A-Za-z0-9_][A-Za-z0-9_.-]{0,99}")
_MOST_BYTES = 200_000_000  # of all files that travel in one document
_PACKAGE = "package://"
_LARGEST = 500_000_000  # bytes of one mesh that is unpacked


def place_meshes(urdf: Path, given: Sequence[Path]) -> None:
    """Let a carried URDF name its meshes where they are: in folders that are given, or in example-robot-data."""
    try:
        root = parsed(urdf)
    except ElementTree.ParseError:
        return  # building the robot reports what is wrong
    meshes = [mesh for mesh in root.iter("mesh") if mesh.get("filename")]
    for mesh in meshes:
        name = mesh.get("filename", "")
        place = next((place for place in _mesh_places(name, given) if place.is_file()), None)
        # Inside the folder of the URDF, which has no other file.
        inside = "/".join(_steps(name) or (PurePosixPath(name).name,))
        mesh.set("filename", inside if place is None else str(place.resolve()))
    if meshes:
        urdf.write_bytes(ElementTree.tostring(root, encoding="utf-8"))


def _mesh_places(name: str, given: Sequence[Path]) -> Iterator[Path]:
    """Yield where a mesh may be, all of it in folders that are given, or in example-robot-data."""
    steps, examples = _steps(name), examples_folder()
    if steps is None:
        return
    plain_name = name.removeprefix("file://")
    for folder in given:
        if Path(plain_name).is_absolute() and Path(plain_name).is_relative_to(folder.resolve()):
            yield Path(plain_name)
        yield folder.joinpath(*steps)
    if examples is not None:
        yield examples.parents[1].joinpath(*steps)
    if name.startswith(_PACKAGE):
        found = PackageFolders(Path("/"), [folder.resolve() for folder in given]).find(_PACKAGE + "/".join(steps))
        if found is not None:
            yield found


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


def packed_files(files: set[Path], room: int | None) -> dict[Path, tuple[str, str]] | None:
    """Return names and contents of files, compressed, in base 64; None if that takes more than so many bytes."""
    packed: dict[Path, tuple[str, str]] = {}
    for path in sorted(files):
        try:
            content = path.read_bytes()
        except OSError as error:
            raise InputError(f"cannot be saved with the robot ({error.strerror})", str(path)) from None
        name = f"{sha256(content).hexdigest()[:32]}{path.suffix.lower()}"
        packed[path] = name, b64encode(zlib.compress(content)).decode("ascii")
        if room is not None and packed_size(packed) > room:
            return None
    return packed


def packed_size(packed: Mapping[Path, tuple[str, str]]) -> int:
    return sum(map(len, dict(packed.values()).values()))


def unpacked_file(name: str, packed: Any) -> bytes:
    with document.within("meshes"):
        try:
            unpacking = zlib.decompressobj()
            content = unpacking.decompress(b64decode(document.text(name, packed), validate=True), _LARGEST)
        except (ValueError, zlib.error) as error:
            raise InputError(f"is not a compressed mesh in base 64: {error}", name) from None
        if not unpacking.eof:
            raise InputError(f"is cut, or larger than {_LARGEST} bytes", name)
    return content


def _file_content(name: str, value: Any) -> str:
    if not _FILE_NAME.fullmatch(name):
        raise InputError("is not the name of a file", repr(name))
    return document.text(name, value)


carried_files = by_name(_file_content)


def encoded(path: Path) -> str:
    """Return the content of a file in base 64, or raise InputError."""
    try:
        return b64encode(path.read_bytes()).decode("ascii")
    except OSError as error:
        raise InputError(f"cannot be carried in a certificate ({error.strerror})", str(path)) from None


def unpack(files: Mapping[str, str], folder: Path) -> None:
    """Write files into a folder; names that lead out of it are none, see `carried_files`."""
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
