"""Forward kinematics of a tree of joints at many configurations."""

from __future__ import annotations

from math import cos, sin

import numpy as np
from numba import njit

from safe_ompl.arrays import BoolArray, FloatArray, IntArray


@njit(cache=True)
def joint_frames(
    parents: IntArray,
    rotations: FloatArray,
    translations: FloatArray,
    axes: FloatArray,
    prismatic: BoolArray,
    values: FloatArray,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return rotations (B, m, 3, 3), origins (B, m, 3) and world axes (B, m, 3) of the m joint frames.

    R_i = R_parent·R⁰_i·exp(q_i [a_i]×) and o_i = o_parent + R_parent·t⁰_i where joint i turns about its axis a_i; where
    it slides R_i = R_parent·R⁰_i, and o_i moves by q_i along the axis. Parents are Pinocchio's numbers of joints, 0 is
    the base.
    """
    B, m = values.shape
    rotation, origin, world = np.empty((B, m, 3, 3)), np.empty((B, m, 3)), np.empty((B, m, 3))
    turn, base = np.empty((3, 3)), np.eye(3)
    for b in range(B):
        for i in range(m):
            above = parents[i] - 1
            frame = rotation[b, above] if above >= 0 else base
            for x in range(3):
                at = origin[b, above, x] if above >= 0 else 0.0
                for y in range(3):
                    at += frame[x, y] * translations[i, y]
                origin[b, i, x] = at
            a, q = axes[i], values[b, i]
            c, s = (1.0, 0.0) if prismatic[i] else (cos(q), sin(q))
            for x in range(3):
                for y in range(3):
                    turn[x, y] = (1 - c) * a[x] * a[y] + (c if x == y else 0.0)
            turn[0, 1] -= s * a[2]
            turn[1, 0] += s * a[2]
            turn[0, 2] += s * a[1]
            turn[2, 0] -= s * a[1]
            turn[1, 2] -= s * a[0]
            turn[2, 1] += s * a[0]
            for x in range(3):
                along = 0.0
                for y in range(3):
                    entry = 0.0
                    for k in range(3):
                        still = 0.0
                        for z in range(3):
                            still += frame[x, z] * rotations[i, z, k]
                        entry += still * turn[k, y]
                    rotation[b, i, x, y] = entry
                    along += entry * a[y]
                world[b, i, x] = along
                if prismatic[i]:
                    origin[b, i, x] += along * q
    return rotation, origin, world
