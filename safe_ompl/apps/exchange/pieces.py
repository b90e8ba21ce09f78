"""Prove that the convex pieces from another program, such as CoACD, contain the surface of a concave mesh."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from safe_ompl.common import FloatArray, InputError, finite_array, number
from safe_ompl.geometry import Mesh, hull_planes, written_mesh

_CUBE = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], dtype=np.float64)
# The smallest triangles that are checked have edges of this many margins.
_LEAST_TRIANGLE = 0.1
# A point must be inside by this much.
_INSIDE_MARGIN = 1e-9  # [m]
_CHUNK = 20_000  # triangles at a time
# No more triangles than this are kept for checking.
_MOST_TRIANGLES = 2_000_000


def proven_pieces(
    file: str | Path,
    pieces: Iterable[ArrayLike],
    folder: str | Path,
    *,
    scale: ArrayLike = (1.0, 1.0, 1.0),
    margin: float = 0.002,
) -> list[Mesh]:
    """Grow convex pieces by a margin, prove that they contain the surface of a mesh, and write them to a folder.

    Each returned mesh can be the shape of an obstacle, or a collision mesh of a URDF. The proof divides every triangle
    of the mesh until the three corners of each part lie in one piece; the piece is convex, so it contains the part. A
    body that is inside the mesh but outside all pieces does not collide.

    Parameters
    ----------
    file : path-like
        The mesh, as of `Mesh`.
    pieces : iterable of array_like of shape (V, 3)
        Corners of the pieces, in the units of the file.
    folder : path-like
        Where ``NAME_0.obj``, … are written, in metres.
    scale : sequence of 3 float, optional
        Factors that turn the file's units into metres.
    margin : float, optional
        The distance by which each piece is grown along each axis [m]. Pieces of CoACD only touch each other and do not
        contain the whole mesh.

    Raises
    ------
    InputError
        If a piece has no volume, or the pieces do not contain the mesh. The message names a point that is not covered.
    """
    source = Mesh(file, scale, convex=False)
    grown = number("margin", margin, above=0.0) * _CUBE
    factors, place = np.array(source.scale), Path(folder)
    meshes = []
    for k, piece in enumerate(pieces):
        corners = finite_array(piece, (None, 3), f"pieces[{k}]") * factors
        points = (corners[:, None] + grown).reshape(-1, 3).tolist()
        # The hull is computed from all corners, so any faces will do.
        faces = [(i, i + 1, i + 2) for i in range(len(points) - 2)]
        meshes.append(written_mesh(place, f"{source.file.stem}_{k}", points, faces))
    vertices, triangles = source.surface
    missed = _uncovered(vertices[triangles], meshes, _LEAST_TRIANGLE * margin)
    if missed is not None:
        x, y, z = missed
        words = f"not in the pieces at ({x:.4f}, {y:.4f}, {z:.4f}) m: take a larger margin, finer pieces, or the hull"
        raise InputError(words, source.file.name)
    return meshes


def _uncovered(triangles: FloatArray, meshes: list[Mesh], finest: float) -> FloatArray | None:
    """Return the centre (3,) [m] of a part of the triangles (T, 3, 3) that is not proven to be in the hulls, or None.

    `finest` is the edge length [m] at which the division stops.
    """
    # The hulls are those of the files as they are read again, because these hulls will collide.
    planes = [hull_planes(mesh.parts()[0].geometry) for mesh in meshes]
    while len(triangles):
        left = [_outside(part, planes) for part in np.array_split(triangles, 1 + len(triangles) // _CHUNK)]
        triangles = np.concatenate(left)
        edges = np.linalg.norm(triangles - np.roll(triangles, 1, axis=1), axis=2).max(axis=1)
        small = np.flatnonzero(edges < finest)
        if len(small) or 4 * len(triangles) > _MOST_TRIANGLES:
            return np.asarray(triangles[small[0] if len(small) else edges.argmin()].mean(axis=0))
        # The middle of each edge, from each corner to the next.
        middles = (triangles + np.roll(triangles, -1, axis=1)) / 2
        at_corners = np.stack([triangles, middles, np.roll(middles, 1, axis=1)], axis=2)  # (T, 3, 3, 3)
        triangles = np.concatenate([at_corners.reshape(-1, 3, 3), middles])
    return None


def _outside(triangles: FloatArray, planes: list[tuple[FloatArray, FloatArray]]) -> FloatArray:
    """Return the triangles (T, 3, 3) that no convex body contains. `planes` holds normals and offsets of each body."""
    for normals, offsets in planes:
        inside = (triangles.reshape(-1, 3) @ normals.T <= offsets - _INSIDE_MARGIN).all(axis=1)
        triangles = triangles[~inside.reshape(-1, 3).all(axis=1)]
    return triangles
