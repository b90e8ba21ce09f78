"""Hinges of the distances between links and obstacles, as in CHOMP and TrajOpt: values, gradients, curvature."""

from __future__ import annotations

from math import sqrt
from typing import Any

import numpy as np

from safe_ompl.common import FloatArray, IntArray, compiled
from safe_ompl.robot.kernels import joint_frames


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
        The table (m,), see `safe_ompl.robot.kernels.kinematics`.
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
