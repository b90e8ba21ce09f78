"""Points and triangles on surfaces of boxes, solids of revolution, triangle meshes and bodies of capsules."""

from __future__ import annotations

from math import ceil

import numpy as np

from safe_ompl.common import FloatArray, IntArray
from safe_ompl.geometry.surface_points import (
    box_points as box_points,
    capsule_points as capsule_points,
    revolved_points as revolved_points,
)

Triangles = tuple[FloatArray, IntArray]
"""Vertices (V, 3) [m], and the vertex indices of each triangle (F, 3)."""


def box_triangles(size: FloatArray) -> Triangles:
    """Return the twelve triangles of a box centred at the origin, anticlockwise as seen from outside."""
    corners = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)]) * size
    quads = np.array([[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]])
    return corners, np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])


def sphere_profile(radius: float, step: float) -> FloatArray:
    """Return the half circle whose revolution about z is a sphere; see `revolved_points`."""
    return _arc(radius, 0.0, -np.pi / 2, np.pi / 2, step)


def cylinder_profile(radius: float, length: float, step: float) -> FloatArray:
    """Return the polyline whose revolution about z is a cylinder with flat ends; see `revolved_points`."""
    across, up = _steps(radius, step), _steps(length, step)
    bottom = [(k / across * radius, -length / 2) for k in range(across)]
    side = [(radius, k / up * length - length / 2) for k in range(up)]
    top = [(radius - k / across * radius, length / 2) for k in range(across)]
    return np.array([*bottom, *side, *top, (0.0, length / 2)])


def capsule_profile(radius: float, length: float, arc_step: float, line_step: float) -> FloatArray:
    """Return the polyline whose revolution about z is a capsule; see `revolved_points`."""
    bottom = _arc(radius, -length / 2, -np.pi / 2, 0.0, arc_step)
    top = _arc(radius, length / 2, 0.0, np.pi / 2, arc_step)
    side = np.linspace(bottom[-1], top[0], _steps(length, line_step) + 1)[1:-1]
    return np.concatenate([bottom, side, top])


def revolved_triangles(profile: FloatArray, segments: int) -> Triangles:
    """Return the triangles of a solid of revolution with `segments` corners per ring, anticlockwise from outside."""
    angle = 2 * np.pi * np.arange(segments) / segments
    ring = np.column_stack([np.cos(angle), np.sin(angle)])
    rings = [np.column_stack([r * ring, np.full(segments, z)]) for r, z in profile[1:-1]]
    poles = np.array([[0.0, 0.0, profile[0, 1]], [0.0, 0.0, profile[-1, 1]]])
    vertices = np.concatenate([*rings, poles])

    here = np.arange(segments)
    after = np.roll(here, -1)
    faces = []
    for k in range(len(rings) - 1):
        low, high = k * segments, (k + 1) * segments
        faces.append(np.column_stack([low + here, low + after, high + after]))
        faces.append(np.column_stack([low + here, high + after, high + here]))
    bottom, top, last = len(vertices) - 2, len(vertices) - 1, (len(rings) - 1) * segments
    faces.append(np.column_stack([np.full(segments, bottom), after, here]))
    faces.append(np.column_stack([np.full(segments, top), last + here, last + after]))
    return vertices, np.concatenate(faces)


def mesh_points(vertices: FloatArray, faces: IntArray, spacing: float) -> FloatArray:
    """Return points (M, 3) on a triangle mesh. Each point of the mesh is within `spacing` [m] of one of them.

    Each triangle gets a barycentric grid of half the spacing. Then points closer than half the spacing are thinned.
    """
    grids = []
    corners = vertices[faces]
    steps = _mesh_steps(corners, spacing).astype(int)
    for count in np.unique(steps):
        i, j = np.array([(i, j) for i in range(count + 1) for j in range(count + 1 - i)]).T
        weights = np.column_stack([i, j, count - i - j]) / count
        grids.append((weights @ corners[steps == count]).reshape(-1, 3))
    return thinned(np.concatenate(grids), spacing / 2)


def most_mesh_points(vertices: FloatArray, faces: IntArray, spacing: float) -> float:
    """Return the number of points of `mesh_points` before thinning."""
    steps = _mesh_steps(vertices[faces], spacing)
    return float(((steps + 1) * (steps + 2) / 2).sum())


def _mesh_steps(corners: FloatArray, spacing: float) -> FloatArray:
    """Return the numbers of steps (F,) into which the edges of each triangle (F, 3, 3) are divided."""
    longest = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1)
    return np.asarray(np.maximum(1.0, np.ceil(longest / (spacing / 2) - 1e-9)))


def thinned(points: FloatArray, distance: float) -> FloatArray:
    """Thin points (N, 3) in the order of x: keep each point that is farther than `distance` from all kept points."""
    # np.unique sorts the points by x.
    rows = np.unique(points, axis=0)
    ends = np.searchsorted(rows[:, 0], rows[:, 0] + distance * (1 + 1e-9), side="right")
    left = np.ones(len(rows), dtype=bool)
    kept: list[int] = []
    first = 0
    while first < len(rows):
        kept.append(first)
        near = slice(first, int(ends[first]))
        left[near] &= np.sum((rows[near] - rows[first]) ** 2, axis=1) > distance**2
        rest = left[first:]
        first += int(rest.argmax()) if rest.any() else len(rest)
    return rows[kept].reshape(-1, 3)


def joined(pieces: list[Triangles]) -> Triangles:
    """Concatenate triangle meshes."""
    offsets = np.cumsum([0, *(len(vertices) for vertices, _ in pieces[:-1])])
    faces = [faces + offset for (_, faces), offset in zip(pieces, offsets, strict=True)]
    return np.concatenate([vertices for vertices, _ in pieces]), np.concatenate(faces)


def _arc(radius: float, height: float, start: float, stop: float, step: float) -> FloatArray:
    angle = np.linspace(start, stop, _steps(radius * (stop - start), step) + 1)
    return np.column_stack([np.maximum(radius * np.cos(angle), 0.0), height + radius * np.sin(angle)])


def _steps(length: float, step: float) -> int:
    return max(1, ceil(length / step - 1e-9))
