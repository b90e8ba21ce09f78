"""Points and triangles on surfaces: boxes, solids of revolution, triangle meshes, bodies made of capsules."""

from __future__ import annotations

from math import ceil, cos, pi, sin, sqrt

import numpy as np

from safe_ompl.common import FloatArray, IntArray, compiled, maker, part

Triangles = tuple[FloatArray, IntArray]
"""Vertices, shape (V, 3) [m], and for each triangle the indices of its vertices, shape (F, 3)."""


def box_triangles(size: FloatArray) -> Triangles:
    """Return the twelve triangles of a box centred at the origin, seen from outside."""
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
    """Return the surface of a solid of revolution as triangles, seen from outside, with so many corners a ring."""
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
    """Return points on a triangle mesh; every point of the mesh is within `spacing` of one of them.

    Triangles have barycentric grids of half the spacing; what lies closer than the other half is thinned.
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
    """Return how many points `mesh_points` makes before it thins them."""
    steps = _mesh_steps(vertices[faces], spacing)
    return float(((steps + 1) * (steps + 2) / 2).sum())


def _mesh_steps(corners: FloatArray, spacing: float) -> FloatArray:
    """Return into how many steps the edges of each triangle (F, 3, 3) are divided."""
    longest = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1)
    return np.asarray(np.maximum(1.0, np.ceil(longest / (spacing / 2) - 1e-9)))


def thinned(points: FloatArray, distance: float) -> FloatArray:
    """Walk through points in the order of x; return those that are not within `distance` of one kept before."""
    rows = np.unique(points, axis=0)  # in the order of x
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
    """Return several triangle meshes as one."""
    offsets = np.cumsum([0, *(len(vertices) for vertices, _ in pieces[:-1])])
    faces = [faces + offset for (_, faces), offset in zip(pieces, offsets, strict=True)]
    return np.concatenate([vertices for vertices, _ in pieces]), np.concatenate(faces)


def _arc(radius: float, height: float, start: float, stop: float, step: float) -> FloatArray:
    angle = np.linspace(start, stop, _steps(radius * (stop - start), step) + 1)
    return np.column_stack([np.maximum(radius * np.cos(angle), 0.0), height + radius * np.sin(angle)])


def _steps(length: float, step: float) -> int:
    return max(1, ceil(length / step - 1e-9))


# ------------------------------------------------------------------------------------------------ points, compiled


@part
def _turns(length: float, step: float) -> int:
    return max(1, ceil(length / step - 1e-9))


@compiled
def box_points(size: FloatArray, spacing: float) -> FloatArray:
    """Return grid points (M, 3) on the faces of a box of so many metres `size: (3,)` about the origin, edges included.

    The step between neighbours is at most `spacing` along x, y and z [m]. They are in order by x, then y, then z.
    """
    X, Y, Z = _turns(size[0], spacing), _turns(size[1], spacing), _turns(size[2], spacing)
    points, row = np.empty(((X + 1) * (Y + 1) * (Z + 1) - (X - 1) * (Y - 1) * (Z - 1), 3)), 0
    for i in range(X + 1):
        for j in range(Y + 1):
            for k in range(Z + 1):
                if not (0 < i < X and 0 < j < Y and 0 < k < Z):
                    points[row, 0] = i * (size[0] / X) - size[0] / 2 if i < X else size[0] / 2
                    points[row, 1] = j * (size[1] / Y) - size[1] / 2 if j < Y else size[1] / 2
                    points[row, 2] = k * (size[2] / Z) - size[2] / 2 if k < Z else size[2] / 2
                    row += 1
    return points


@compiled
def revolved_points(profile: FloatArray, spacing: float) -> FloatArray:
    """Return points (M, 3) on a solid of revolution about z; every point of its surface is within `spacing` [m] of one.

    The `profile: (K, 2)` has distance from the axis and height of the rings, from the bottom pole to the top pole, at
    most `spacing` apart along the surface [m].
    """
    most, row = 0, 0
    for ring in profile:
        most += _turns(2 * pi * ring[0], spacing)
    points = np.empty((most, 3))
    for ring in profile:
        count = _turns(2 * pi * ring[0], spacing)
        for k in range(count):
            angle = 2 * pi * k / count
            points[row, 0], points[row, 1], points[row, 2] = ring[0] * cos(angle), ring[0] * sin(angle), ring[1]
            row += 1
    return points


@maker
def _capsule_rings(radius: float, length: float, spacing: float) -> FloatArray:
    """Return rings (K, 2) of a capsule about z, of a ball for length 0: distance from the axis, and height."""
    side = _turns(length, spacing) if length > 0.0 else 0
    half = _turns(pi / 2 * radius, spacing) if length > 0.0 else _turns(pi * radius, spacing)
    rings = np.empty((2 * half + side + 1 if length > 0.0 else half + 1, 2))
    for k in range(len(rings)):
        if length > 0.0:  # a quarter of a circle, the side, another quarter
            turn = pi / 2 * (k / half - 1.0 if k < half else max(0, k - half - side) / half)
            height = length * (min(max(k - half, 0), side) / side - 0.5)
        else:
            turn, height = pi * (k / half - 0.5), 0.0
        rings[k, 0] = max(0.0, radius * cos(turn))
        rings[k, 1] = height + radius * sin(turn)
    return rings


@maker
def _frame(axis: FloatArray, length: float) -> FloatArray:
    """Return the rotation (3, 3) that takes z to an axis on the shortest way; of no length: none."""
    frame = np.empty((3, 3))
    for a in range(3):
        for b in range(3):
            frame[a, b] = 1.0 if a == b else 0.0  # np.eye takes four times as long to compile
    if length == 0.0:
        return frame
    x, y, z = axis[0] / length, axis[1] / length, axis[2] / length
    if z < -1.0 + 1e-12:
        frame[1, 1] = frame[2, 2] = -1.0
        return frame
    frame[0, 0], frame[0, 1], frame[0, 2] = 1.0 - x * x / (1.0 + z), -x * y / (1.0 + z), x
    frame[1, 0], frame[1, 1], frame[1, 2] = frame[0, 1], 1.0 - y * y / (1.0 + z), y
    frame[2, 0], frame[2, 1], frame[2, 2] = -x, -y, z
    return frame


@part
def _depth(point: FloatArray, start: FloatArray, axis: FloatArray, squared: float, radius: float) -> float:
    """How deep a point lies inside the capsule about start … start + axis; negative outside [m]."""
    t = 0.0
    if squared > 0.0:
        for x in range(3):
            t += (point[x] - start[x]) * axis[x]
        t = min(1.0, max(0.0, t / squared))
    away = 0.0
    for x in range(3):
        away += (point[x] - start[x] - t * axis[x]) ** 2
    return radius - sqrt(away)


@compiled
def capsule_points(starts: FloatArray, ends: FloatArray, radii: FloatArray, spacing: float) -> FloatArray:
    """Return points (M, 3) [m] on L capsules, those deeper than `spacing` inside another one left out.

    `starts` and `ends` (L, 3) are those of their axes [m], the same for a ball; `radii: (L,)` [m]. Every point of a
    capsule's surface is within `spacing` of one of its points [m].
    """
    axes, squared = np.empty(starts.shape), np.zeros(len(radii))
    most = 0
    for i in range(len(radii)):
        for x in range(3):
            axes[i, x] = ends[i, x] - starts[i, x]
            squared[i] += axes[i, x] * axes[i, x]
        for ring in _capsule_rings(radii[i], sqrt(squared[i]), spacing):
            most += _turns(2 * pi * ring[0], spacing)
    points, kept = np.empty((most, 3)), 0
    for i in range(len(radii)):
        length = sqrt(squared[i])
        frame = _frame(axes[i], length)
        for ring in _capsule_rings(radii[i], length, spacing):
            count = _turns(2 * pi * ring[0], spacing)
            for k in range(count):
                angle = 2 * pi * k / count
                x, y, z = ring[0] * cos(angle), ring[0] * sin(angle), ring[1]
                point = points[kept]  # stays where nothing is deeper than the spacing
                for a in range(3):
                    point[a] = (starts[i, a] + ends[i, a]) / 2 + frame[a, 0] * x + frame[a, 1] * y + frame[a, 2] * z
                inside = False
                for j in range(len(radii)):
                    if j != i and _depth(point, starts[j], axes[j], squared[j], radii[j]) > spacing:
                        inside = True
                        break
                if not inside:
                    kept += 1
    return points[:kept].copy()
