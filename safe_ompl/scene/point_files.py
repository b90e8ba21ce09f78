"""Reading points from PLY and NPY files."""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np
import plyfile

from safe_ompl.arrays import FloatArray
from safe_ompl.errors import InputError


def read_points(file: Path) -> FloatArray:
    """Return the points of a PLY or NPY file, shape (N, 3), in the units of the file; some may be NaN.

    Raises
    ------
    InputError
        If a PLY file is malformed or has no vertices with x, y and z, or an NPY file no array of numbers (N, 3).
    """
    return _read_ply(file) if file.suffix.lower() == ".ply" else _read_npy(file)


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
