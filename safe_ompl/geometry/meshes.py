"""Reading mesh files: their units and axes, checks that they are complete, and their triangles.

coal reads meshes with Assimp. coal skips the transformation of the outermost node, and with it the unit and the upward
axis of COLLADA. Assimp silently drops elements that it cannot read or that a truncated file lacks, and crashes on
truncated PLY files. So every file is checked before coal reads it.
"""

from __future__ import annotations

import math
import re
import struct
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple
from xml.parsers import expat

import coal
import numpy as np
import plyfile

from safe_ompl.common import FloatArray, InputError, files, shown
from safe_ompl.geometry.surfaces import Triangles

MESH_ENDINGS = (".stl", ".obj", ".dae", ".ply")
PLY_SURFACES = ("face", "tristrips")
"""Elements of a PLY file that define a surface."""
# Rotations that map the upward axis of a COLLADA file to z.
_AXES = {
    "X_UP": np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]]),
    "Y_UP": np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]]),
    "Z_UP": np.eye(3),
}
# Assimp drops these tags of COLLADA, or reads only some of their triangles.
_UNREAD_TAGS = ("skew", "trifans", "convex_mesh", "spline", "brep", "instance_controller")
# Statements of OBJ for surfaces that Assimp drops: free-form surfaces, and references to other files.
_UNREAD_STATEMENTS = re.compile(rb"^\s*(surf|call|csh|bsp|bzp|cdc|cdp|res)\s", re.MULTILINE)
_STL_HEADER, _STL_TRIANGLE = 84, 50  # bytes


class MeshFrame(NamedTuple):
    """The coordinates of a mesh file: the unit [m] and the upward axis."""

    unit: float = 1.0
    up: str = "Z_UP"


def read_ply(file: Path) -> plyfile.PlyData:
    """Return the content of a PLY file. Raises InputError if it cannot be read or is truncated."""
    try:
        with warnings.catch_warnings():
            # The warnings are about empty elements.
            warnings.simplefilter("ignore", UserWarning)
            return plyfile.PlyData.read(file)
    except (plyfile.PlyParseError, *files.MALFORMED, OSError) as error:
        reason = " ".join(str(error).split()) or type(error).__name__
        raise InputError(f"{file} cannot be read as PLY: {reason}") from None


def check_mesh(file: Path) -> MeshFrame:
    """Return unit and upward axis of a mesh file. Raises InputError if Assimp would not read all of it."""
    check = _CHECKS.get(file.suffix.lower())
    if check is None:
        raise InputError(f"{file} cannot be read as a mesh; convert it to one of {', '.join(MESH_ENDINGS)}")
    return check(file)


def read_mesh(file: Path, scale: FloatArray) -> Triangles:
    """Return vertices (V, 3) [m] with z up, scaled by `scale` (3,), and triangles (F, 3) of a mesh file.

    Raises InputError if the file is not a mesh, or cannot be read completely.
    """
    frame = check_mesh(file)
    plain = frame == MeshFrame()
    try:
        tree = coal.MeshLoader().load(str(file), scale if plain else np.ones(3))
    except (ValueError, RuntimeError) as error:
        if "No meshes remaining" in str(error):
            raise _no_triangles(file) from None
        reason = " ".join(str(error).split("message: ")[-1].partition("Hint:")[0].split())
        raise InputError(f"{file} cannot be read as a mesh: {reason}") from None
    if not tree.num_tris:
        raise _no_triangles(file)
    vertices = np.array(tree.vertices())
    faces = [[tree.tri_indices(k)[i] for i in range(3)] for k in range(tree.num_tris)]
    if not plain:
        vertices = frame.unit * vertices @ _AXES[frame.up].T * scale
    return vertices, np.array(faces, dtype=np.intp).reshape(-1, 3)


def _no_triangles(file: Path) -> InputError:
    return InputError(f"{file} has no triangles; points alone are a pointcloud")


def _check_collada(file: Path) -> MeshFrame:
    return _Collada(file).frame


class _Collada:
    """Parser that checks a COLLADA file in one pass."""

    def __init__(self, file: Path) -> None:
        self._file = file
        self._above: list[str] = []
        # The units as they are written, beginning with the unit of the file.
        self._units: list[str] = []
        self._ups: list[str] = []
        self._text: list[str] = []
        self._named: set[str] = set()
        self._wanted: dict[str, str] = {}
        self._parser = expat.ParserCreate()
        self._parser.StartElementHandler, self._parser.EndElementHandler = self._start, self._end
        self._parser.StartDoctypeDeclHandler = self._refuse_entities
        try:
            with file.open("rb") as content:
                self._parser.ParseFile(content)
        except (expat.ExpatError, OSError) as error:
            raise self._error(f"not well-formed XML ({error})") from None

    @property
    def frame(self) -> MeshFrame:
        """Unit and upward axis; by default metres and y, as in the standard."""
        for found in (self._units, self._ups):
            if any(other != found[0] for other in found):
                raise self._error(f"parts of it have units or axes of their own ({' and '.join(found)}): give them one")
        if missing := sorted(self._wanted.keys() - self._named):
            raise self._error(f"<{self._wanted[missing[0]]}> refers to {shown(missing[0])}, which it does not hold")
        unit, up = (found[0] if found else default for found, default in ((self._units, "1"), (self._ups, "Y_UP")))
        if up not in _AXES:
            raise self._error(f"<up_axis> is {shown(up)}; it must be one of {', '.join(_AXES)}")
        try:
            size = float(unit)
        except ValueError:
            size = math.nan
        if not 0.0 < size < math.inf:
            raise self._error(f"<unit> has meter={shown(unit)}; it must be a positive number")
        return MeshFrame(size, up)

    def _error(self, message: str) -> InputError:
        return InputError(f"{self._file}: {message}")

    def _refuse_entities(self, *_: object) -> None:
        raise self._error("must not declare entities, or a document type")

    def _start(self, tag: str, attributes: dict[str, str]) -> None:
        tag = tag.rpartition(":")[2]
        if tag in _UNREAD_TAGS:
            raise self._error(f"<{tag}> cannot be read; export it as triangles without it")
        if tag == "unit":
            self._units.append(attributes.get("meter", "1"))
        elif tag == "up_axis":
            self._parser.CharacterDataHandler = self._text.append
        elif tag in ("geometry", "node"):
            self._named.add("#" + attributes.get("id", ""))
        elif tag in ("instance_geometry", "instance_node"):
            self._wanted[attributes.get("url", "")] = tag
            if self._above[-1:] != ["node"]:
                raise self._error(f"<{tag}> must be in a <node>")
        self._above.append(tag)

    def _end(self, tag: str) -> None:
        if self._above.pop() == "up_axis":
            self._parser.CharacterDataHandler = None
            self._ups.append("".join(self._text).strip())
            self._text.clear()


def _check_ply(file: Path) -> MeshFrame:
    content = read_ply(file)
    surfaces = [element for element in content.elements if element.name in PLY_SURFACES and element.count]
    if not surfaces:
        raise _no_triangles(file)
    if surfaces[0].name == "tristrips":
        raise InputError(f"{file}: strips of triangles (tristrips) cannot be read; export it as faces")
    count = next((element.count for element in content.elements if element.name == "vertex"), 0)
    for name in ("vertex_indices", "vertex_index"):
        if name in surfaces[0].data.dtype.names:
            corners = np.concatenate([np.ravel(face) for face in surfaces[0].data[name]])
            if not np.all((corners >= 0) & (corners < count)):
                raise InputError(f"{file}: a face has a vertex that there is not, of {count}")
    return MeshFrame()


def _check_stl(file: Path) -> MeshFrame:
    """Check that a text STL is complete. Assimp itself checks the length of binary files."""
    content = file.read_bytes()
    announced = struct.unpack_from("<I", content, _STL_HEADER - 4)[0] if len(content) >= _STL_HEADER else -1
    binary = len(content) == _STL_HEADER + _STL_TRIANGLE * announced
    if not binary and content.lstrip()[:5].lower() == b"solid":
        begun, ended = (len(re.findall(word, content, re.IGNORECASE | re.MULTILINE)) for word in _STL_ENDS)
        if begun != ended:
            raise InputError(f"{file} is cut off: {begun} solids begin in it, and {ended} end")
    return MeshFrame()


_STL_ENDS = (rb"^\s*solid\b", rb"^\s*endsolid\b")


def _check_obj(file: Path) -> MeshFrame:
    if unread := _UNREAD_STATEMENTS.search(file.read_bytes()):
        word = unread.group(1).decode()
        raise InputError(f"{file}: the statement {word!r} cannot be read; export it as triangles in one file")
    return MeshFrame()


_CHECKS: dict[str, Callable[[Path], MeshFrame]] = {
    ".stl": _check_stl,
    ".obj": _check_obj,
    ".dae": _check_collada,
    ".ply": _check_ply,
}
