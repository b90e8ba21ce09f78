"""Reading points: PLY, NPY and PCD files, and the data of ROS PointCloud2 messages."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from math import prod
from pathlib import Path
from typing import Any

import numpy as np
import plyfile

from safe_ompl.common import FloatArray, InputError

POINT_FILES = (".ply", ".npy", ".pcd")

# Of PCD: kind and size [bytes] of a number; of PointCloud2: its `datatype`.
_PCD_TYPES = {"F": "f", "I": "i", "U": "u"}
_MESSAGE_TYPES = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 8: "f8"}


def read_points(file: Path) -> FloatArray:
    """Return the points of a PLY, NPY or PCD file, shape (N, 3), in the units of the file; some may be NaN.

    Of PCD (versions 0.5 to 0.7 of https://pointclouds.org/documentation/tutorials/pcd_file_format.html) the fields x, y
    and z are read, as ascii, binary or binary_compressed; its viewpoint is not applied, as in PCL. Raises InputError if
    a PLY or PCD file is malformed or has no x, y and z, or an NPY file no array of numbers (N, 3).
    """
    return {".ply": _read_ply, ".npy": _read_npy, ".pcd": _read_pcd}[file.suffix.lower()](file)


def message_points(message: Any) -> FloatArray:
    """Return the points of a ROS `sensor_msgs/PointCloud2` message, shape (N, 3), in its frame [m]; some may be NaN.

    The message is anything with `height`, `width`, `fields` (each with `name`, `offset` and `datatype`),
    `is_bigendian`, `point_step`, `row_step` and `data`, as attributes or as keys. Raises InputError if one of these or
    one of the fields x, y and z is missing, or the data are shorter than they say.
    """
    names = ("height", "width", "fields", "is_bigendian", "point_step", "row_step", "data")
    height, width, fields, big, step, row_step, data = (_part(message, name) for name in names)
    offsets, order = {}, ">" if big else "<"
    for field in fields:
        kind = _MESSAGE_TYPES.get(_part(field, "datatype"))
        if _part(field, "name") in ("x", "y", "z") and kind is not None:
            offsets[_part(field, "name")] = int(_part(field, "offset")), np.dtype(order + kind)
    missing = [axis for axis in "xyz" if axis not in offsets]
    if missing:
        raise InputError(f"the message has no field {' and '.join(missing)}", "fields")
    raw = np.frombuffer(bytes(data), dtype=np.uint8)
    ends = [offset + kind.itemsize for offset, kind in offsets.values()]
    if min(offset for offset, _ in offsets.values()) < 0 or max(ends) > step or row_step < width * step:
        raise InputError(f"fields of {max(ends)} bytes and {width} points a row do not fit", "point_step")
    if len(raw) < height * row_step:
        raise InputError(f"has {len(raw)} bytes, but {height} rows of {row_step} are announced", "data")
    rows = raw[: height * row_step].reshape(height, row_step)[:, : width * step]
    points = rows.reshape(height * width, step)
    columns = [
        np.ascontiguousarray(points[:, offset : offset + kind.itemsize]).view(kind).ravel()
        for offset, kind in (offsets[axis] for axis in "xyz")
    ]
    return np.column_stack([column.astype(np.float64) for column in columns])


def _part(whole: Any, name: str) -> Any:
    try:
        return whole[name] if isinstance(whole, Mapping) else getattr(whole, name)
    except (KeyError, AttributeError):
        raise InputError("the PointCloud2 message lacks it", name) from None


def _read_ply(file: Path) -> FloatArray:
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)  # of elements that are empty
            vertices = plyfile.PlyData.read(file)["vertex"]
        columns = [np.asarray(vertices[axis], dtype=np.float64) for axis in "xyz"]
    except (plyfile.PlyParseError, KeyError, ValueError, TypeError, IndexError, OSError) as error:
        reason = " ".join(str(error).split()) or type(error).__name__
        raise InputError(f"{file} cannot be read as PLY with vertices x, y and z: {reason}", "file") from None
    return np.column_stack(columns)


def _read_npy(file: Path) -> FloatArray:
    try:
        given = np.load(file, allow_pickle=False)
        if given.dtype.kind not in "fiu":
            raise TypeError(f"it holds {given.dtype}")
        points = given.astype(np.float64)
    except (OSError, ValueError, TypeError, AttributeError, EOFError) as error:
        raise InputError(f"{file} cannot be read as an array of numbers: {error}", "file") from None
    if points.ndim != 2 or points.shape[1] != 3:
        raise InputError(f"{file} must hold an array of shape (N, 3), got {points.shape}", "file")
    return np.ascontiguousarray(points)


def _read_pcd(file: Path) -> FloatArray:
    try:
        header, body = _pcd_header(file.read_bytes())
        counts = [int(count) for count in header.get("COUNT", ["1"] * len(header["FIELDS"]))]
        kinds = [
            np.dtype(f"<{_PCD_TYPES[kind]}{size}") for kind, size in zip(header["TYPE"], header["SIZE"], strict=True)
        ]
        sizes = ("POINTS",) if "POINTS" in header else ("WIDTH", "HEIGHT")
        number = prod(int(header[size][0]) for size in sizes)
        return _pcd_points(header, body, list(zip(header["FIELDS"], kinds, counts, strict=True)), number)
    except (KeyError, ValueError, TypeError, IndexError, OSError) as error:
        reason = f"no {error}" if isinstance(error, KeyError) else str(error) or type(error).__name__
        raise InputError(f"{file} cannot be read as PCD with fields x, y and z: {reason}", "file") from None


def _pcd_header(content: bytes) -> tuple[dict[str, list[str]], bytes]:
    """Return the words of each line of a header by the first one, and what follows it."""
    header: dict[str, list[str]] = {}
    place = 0
    while "DATA" not in header:
        end = content.index(b"\n", place)
        words = content[place:end].decode("ascii", errors="replace").split("#")[0].split()
        if words:
            header[words[0]] = words[1:]
        place = end + 1
    return header, content[place:]


def _pcd_points(
    header: dict[str, list[str]], body: bytes, fields: list[tuple[str, np.dtype[Any], int]], number: int
) -> FloatArray:
    """Return the points of a PCD file: of `fields` (name, type, count), `number` times in its `body`."""
    names = [name for name, _, _ in fields]
    wanted = [names.index(axis) for axis in "xyz"]
    starts = np.cumsum([0, *(count for _, _, count in fields)])
    form = header["DATA"][0]
    if form == "ascii":
        table = np.array([line.split() for line in body.decode("ascii").splitlines() if line.strip()][:number])
        table = table.reshape(number, int(starts[-1]))
        return np.column_stack([table[:, starts[k]].astype(np.float64) for k in wanted])
    sizes = np.array([kind.itemsize * count for _, kind, count in fields])
    if form == "binary_compressed":  # field after field
        packed, whole = np.frombuffer(body[:8], dtype="<u4").tolist()
        body = _lzf_decompressed(body[8 : 8 + packed], whole)
        places, steps = number * np.concatenate([[0], np.cumsum(sizes)]), sizes
    elif form == "binary":  # point after point
        places, steps = np.concatenate([[0], np.cumsum(sizes)]), np.full(len(sizes), sizes.sum())
    else:
        raise ValueError(f"unknown DATA {form}")
    if number < 0 or len(body) < number * int(sizes.sum()):
        raise ValueError(f"{number} points are announced, the data are too short for them")
    columns = [
        np.ndarray((number,), fields[k][1], body, offset=int(places[k]), strides=(int(steps[k]),)) for k in wanted
    ]
    return np.column_stack([column.astype(np.float64) for column in columns])


def _lzf_decompressed(packed: bytes, whole: int) -> bytes:
    """Return what LZF (http://oldhome.schmorp.de/marc/liblzf.html) packed into a number of bytes.

    A control byte below 32 announces literal bytes; others a copy of bytes that are there already, which may overlap
    what is being written.
    """
    found, place = bytearray(), 0
    while place < len(packed):
        control = packed[place]
        place += 1
        if control < 32:
            found += packed[place : place + control + 1]
            place += control + 1
            continue
        length = control >> 5
        if length == 7:
            length += packed[place]
            place += 1
        start = len(found) - ((control & 31) << 8) - packed[place] - 1
        place += 1
        if start < 0:
            raise ValueError("the compressed data point before their beginning")
        length += 2
        repeated = bytes(found[start : start + length])
        found += (repeated * (length // len(repeated) + 1))[:length]
    if len(found) != whole:
        raise ValueError(f"{whole} bytes are announced, {len(found)} are there")
    return bytes(found)
