"""Velocities of joints and key points, and gradients pulled back through them; tables as in `kernels.joints`."""

from __future__ import annotations

from typing import Any

import numpy as np

from safe_ompl.arrays import FloatArray
from safe_ompl.maths.kernels.compiled import compiled, part
from safe_ompl.maths.kernels.joints import place_joints, place_keypoints, pull


@part
def move_joints(
    joints: Any, rates: FloatArray, origin: FloatArray, axis: FloatArray, twists: FloatArray
) -> None:
    """Write angular velocities, and velocities at the origin of the world, (m, 6), at `rates: (m,)`."""
    for i in range(len(joints)):
        parent = joints[i].parent - 1
        for x in range(3):
            y, z = (x + 1) % 3, (x + 2) % 3
            turn = axis[i, x] * rates[i]
            about = (origin[i, y] * axis[i, z] - origin[i, z] * axis[i, y]) * rates[i]
            twists[i, x] = (twists[parent, x] if parent >= 0 else 0.0) + (0.0 if joints[i].slides else turn)
            drift = twists[parent, 3 + x] if parent >= 0 else 0.0
            twists[i, 3 + x] = drift + (turn if joints[i].slides else about)


@part
def move_keypoints(keys: Any, twists: FloatArray, places: FloatArray, velocities: FloatArray) -> None:
    """Write the velocities (K, 3) of the key points at their places (K, 3)."""
    for k in range(len(keys)):
        carrier = keys[k].joint - 1
        for x in range(3):
            y, z = (x + 1) % 3, (x + 2) % 3
            velocities[k, x] = 0.0
            if carrier >= 0:
                twist = twists[carrier]
                velocities[k, x] = twist[3 + x] + twist[y] * places[k, z] - twist[z] * places[k, y]


@compiled
def pull_back(
    joints: Any, keys: Any, values: FloatArray, rates: FloatArray, forces: FloatArray
) -> FloatArray:
    """Return gradients by values and by rates of the joints, (2, B, m), from those by key points and their velocities.

    While joint i turns, what it carries turns: a key point and its velocity relative to the parent of i, and the
    parent's motion is felt at another place. With the axis z, the origin o and the parent's angular velocity Ω

        ∂v_k/∂q_i = z × (v_k − v_parent(x_k)) + Ω × (z × (x_k − o));    Ω × z where the joint slides.

    Parameters
    ----------
    joints, keys, values, rates
        The skeleton's tables, see `safe_ompl.maths.kernels.joints`; values and rates (B, m) of the joints.
    forces : ndarray, shape (2, B, K, 3)
    """
    B, m = values.shape
    out = np.empty((2, B, m))
    places, velocities = np.empty((len(keys), 3)), np.empty((len(keys), 3))
    rotation, origin, axis, twists = np.empty((m, 3, 3)), np.empty((m, 3)), np.empty((m, 3)), np.empty((m, 6))
    arm, swing = np.empty(3), np.empty(3)
    still = np.zeros(6)
    for b in range(B):
        place_joints(joints, values[b], rotation, origin, axis)
        place_keypoints(keys, rotation, origin, places)
        move_joints(joints, rates[b], origin, axis, twists)
        move_keypoints(keys, twists, places, velocities)
        for side in range(2):
            pull(joints, keys, origin, axis, places, forces[side, b], out[side, b])
        for k in range(len(keys)):
            i = keys[k].joint - 1
            while i >= 0:
                parent = joints[i].parent - 1
                twist = twists[parent] if parent >= 0 else still
                for x in range(3):
                    y, z = (x + 1) % 3, (x + 2) % 3
                    arm[x] = (
                        velocities[k, x] - twist[3 + x] - (twist[y] * places[k, z] - twist[z] * places[k, y])
                    )
                    if joints[i].slides:
                        swing[x] = axis[i, x]
                    else:
                        swing[x] = axis[i, y] * (places[k, z] - origin[i, z]) - axis[i, z] * (
                            places[k, y] - origin[i, y]
                        )
                for x in range(3):
                    y, z = (x + 1) % 3, (x + 2) % 3
                    change = twist[y] * swing[z] - twist[z] * swing[y]
                    if not joints[i].slides:
                        change += axis[i, y] * arm[z] - axis[i, z] * arm[y]
                    out[0, b, i] += forces[1, b, k, x] * change
                i = parent
    return out
