"""The cost of a path with two Gauss points on each of its segments: value, gradient and about the Hessian.

Of a segment Δ of length ℓ = ‖Δ‖ with nodes at the shares t_j of its way it is ℓ·mean_j f_j. With way points x_k it has
the gradients mean f·Δ/ℓ + ℓ·mean_j t_j ∇f_j at its end and −mean f·Δ/ℓ + ℓ·mean_j (1 − t_j) ∇f_j at its start.
"""

from __future__ import annotations

from math import sqrt
from typing import Any

import numpy as np

from safe_ompl.arrays import FloatArray, IntArray
from safe_ompl.maths.kernels.compiled import compiled
from safe_ompl.maths.kernels.joints import joint_frames

_TINY = 1e-12  # [rad]
_OFFSET = 0.5 / sqrt(3.0)
FIRST, SECOND = 0.5 - _OFFSET, 0.5 + _OFFSET  # t_j: exact to the third order


@compiled
def nodes(path: FloatArray) -> FloatArray:
    """Return the Gauss points (2N − 2, n) of the segments of a path (N, n)."""
    out = np.empty((2 * len(path) - 2, path.shape[1]))
    for k in range(len(path) - 1):
        for i in range(path.shape[1]):
            delta = path[k + 1, i] - path[k, i]
            out[2 * k, i] = path[k, i] + FIRST * delta
            out[2 * k + 1, i] = path[k, i] + SECOND * delta
    return out


@compiled
def integrated(path: FloatArray, values: FloatArray, slopes: FloatArray) -> tuple[float, FloatArray]:
    """Return the cost of a path (N, n), and its gradient (N, n), from f (2N − 2,) and ∇f (2N − 2, n) at the nodes."""
    total, gradient = 0.0, np.zeros(path.shape)
    for k in range(len(path) - 1):
        squared = 0.0
        for i in range(path.shape[1]):
            squared += (path[k + 1, i] - path[k, i]) ** 2
        length, mean = sqrt(squared), 0.5 * (values[2 * k] + values[2 * k + 1])
        total += length * mean
        for i in range(path.shape[1]):
            stretch = mean / max(length, _TINY) * (path[k + 1, i] - path[k, i])
            before, after = 0.5 * length * slopes[2 * k, i], 0.5 * length * slopes[2 * k + 1, i]
            gradient[k, i] += SECOND * before + FIRST * after - stretch
            gradient[k + 1, i] += FIRST * before + SECOND * after + stretch
    return total, gradient


@compiled
def add_bends(
    path: FloatArray, rows: IntArray, bends: FloatArray, blocks: FloatArray, beside: FloatArray
) -> None:
    """Add to the Hessian of a path (N, n) what bends at its nodes, rows (C,), like Σ vvᵀ with v: (C, n).

    Its blocks (N, n, n) are on the diagonal, and (N − 1, n, n) right of them.
    """
    for c in range(len(rows)):
        k, t = rows[c] // 2, SECOND if rows[c] % 2 else FIRST
        squared = 0.0
        for i in range(path.shape[1]):
            squared += (path[k + 1, i] - path[k, i]) ** 2
        share = 0.5 * sqrt(squared)
        for a in range(path.shape[1]):
            for b in range(path.shape[1]):
                square = share * bends[c, a] * bends[c, b]
                blocks[k, a, b] += (1.0 - t) ** 2 * square
                blocks[k + 1, a, b] += t**2 * square
                beside[k, a, b] += t * (1.0 - t) * square


@compiled
def hinge_costs(
    joints: Any,
    values: FloatArray,
    rows: IntArray,
    carriers: IntArray,
    points: FloatArray,
    normals: FloatArray,
    offsets: FloatArray,
    hinges: FloatArray,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return Σ_c Σ_h w_h (1 − d_c/D_h)₊² (B,), its gradients (B, m), and vectors v (C, m): it bends like Σ vvᵀ.

    d_c = x·n_c − b_c of C points of bodies, carried by joints with Pinocchio's numbers, at `values[rows[c]]`.

    Parameters
    ----------
    joints
        The table (m,), see `safe_ompl.maths.kernels.joints`.
    values : ndarray, shape (B, m)
        Values of the joints.
    rows, carriers : ndarray of int, shape (C,)
    points, normals : ndarray, shape (C, 3)
        In the frame of the joint, and in the world.
    offsets : ndarray, shape (C,)
        b.
    hinges : ndarray, shape (H, 2)
        D > 0 and w.
    """
    costs, gradients = np.zeros(len(values)), np.zeros(values.shape)
    bends, place = np.zeros((len(rows), len(joints))), np.empty(3)
    rotation, origin, axis = joint_frames(joints, values)
    for c in range(len(rows)):
        b, i, p, normal = rows[c], carriers[c] - 1, points[c], normals[c]
        distance = -offsets[c]
        for x in range(3):
            place[x] = p[x]
            if i >= 0:
                frame = rotation[b, i]
                place[x] = origin[b, i, x] + frame[x, 0] * p[0] + frame[x, 1] * p[1] + frame[x, 2] * p[2]
            distance += place[x] * normal[x]
        rate, bend = 0.0, 0.0
        for h in range(len(hinges)):
            reach, weight = hinges[h, 0], hinges[h, 1]
            lack = 1.0 - distance / reach
            if lack > 0.0:
                costs[b] += weight * lack * lack
                rate -= 2.0 * weight / reach * lack
                bend += 2.0 * weight / (reach * reach)
        while i >= 0 and bend > 0.0:
            slope = 0.0
            for x in range(3):
                y, z = (x + 1) % 3, (x + 2) % 3
                turning = axis[b, i, y] * (place[z] - origin[b, i, z]) - axis[b, i, z] * (
                    place[y] - origin[b, i, y]
                )
                slope += normal[x] * (axis[b, i, x] if joints[i].slides else turning)
            gradients[b, i] += rate * slope
            bends[c, i] = sqrt(bend) * slope
            i = joints[i].parent - 1
    return costs, gradients, bends
