"""Reading the vertices of a PLY file."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from safe_ompl.arrays import FloatArray
from safe_ompl.errors import InputError

_TYPES = {
    **dict.fromkeys(("char", "int8"), "i1"),
    **dict.fromkeys(("uchar", "uint8"), "u1"),
    **dict.fromkeys(("short", "int16"), "i2"),
    **dict.fromkeys(("ushort", "uint16"), "u2"),
    **dict.fromkeys(("int", "int32"), "i4"),
    **dict.fromkeys(("uint", "uint32"), "u4"),
    **dict.fromkeys(("float", "float32"), "f4"),
    **dict.fromkeys(("double", "float64"), "f8"),
}
_BYTE_ORDER = {"binary_little_endian": "<", "binary_big_endian": ">", "ascii": ""}
_END = b"end_header"


def read_ply(file: Path) -> FloatArray:
    """Return the vertices of a PLY file, shape (N, 3), in the units of the file.

    Raises
    ------
    InputError
        If it is not a PLY file whose first element is a list of vertices with x, y and z, or it ends early.
    """
    content = file.read_bytes()
    end = content.find(_END)
    if not content.startswith(b"ply") or end < 0:
        raise InputError(f"{file} is not a PLY file", "file")
    start = content.index(b"\n", end) + 1 if b"\n" in content[end:] else len(content)
    try:
        form, count, columns = _header(content[:end].decode("ascii"))
        if form == "ascii":
            rows = content[start:].split(b"\n")[:count]
            values = np.array([row.split()[: len(columns)] for row in rows], dtype=np.float64)
            points = values.reshape(count, len(columns))[:, [list(columns).index(axis) for axis in "xyz"]]
        else:
            record = np.dtype([(name, _BYTE_ORDER[form] + kind) for name, kind in columns.items()])
            table = np.frombuffer(content, dtype=record, count=count, offset=start)
            points = np.column_stack([table[axis] for axis in "xyz"])
    except (ValueError, KeyError, IndexError, UnicodeDecodeError) as error:
        raise InputError(f"{file} cannot be read as PLY: {error}", "file") from None
    return np.ascontiguousarray(points, dtype=np.float64)


def _header(text: str) -> tuple[str, int, dict[str, str]]:
    """Return the format, the number of vertices, and type by name of their properties."""
    form, count, columns = "", -1, {}
    for words in (line.split() for line in text.splitlines()):
        if words[:1] == ["format"]:
            form = words[1]
        elif words[:1] == ["element"]:
            if count >= 0:
                break  # what follows the vertices is not read
            if words[1] != "vertex":
                raise ValueError(f"its first element is {words[1]!r}, not 'vertex'")
            count = int(words[2])
        elif words[:1] == ["property"]:
            columns[words[-1]] = _TYPES[words[1]]
    if form not in _BYTE_ORDER:
        raise ValueError(f"unknown format {form!r}")
    if count < 0 or not set("xyz") <= set(columns):
        raise ValueError("it has no vertices with x, y and z")
    return form, count, columns
