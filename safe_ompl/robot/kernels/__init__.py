"""Kinematics of a tree of joints: frames, key points, their velocities, gradients pulled back to the joints; steps.

Joint i turns about its axis a_i, or slides along it. With its placement (R⁰_i, t⁰_i) in the frame of its parent

    R_i = R_parent·R⁰_i·exp(q_i [a_i]×),   o_i = o_parent + R_parent·t⁰_i,

and where it slides R_i = R_parent·R⁰_i, and o_i moves by q_i along the axis z_i = R_i·a_i. Parents come before their
children, and have Pinocchio's numbers: 0 is the base, joint i of a table is Pinocchio's joint i + 1.
"""

from __future__ import annotations

from math import cos, pi, sin
from typing import Any

import numpy as np

from safe_ompl.common import BoolArray, FloatArray, caller, compiled, part

__all__ = [
    "JOINT",
    "KEYPOINT",
    "joint_frames",
    "keypoint_motions",
    "keypoints",
    "lay_edge",
    "lay_edges",
    "move_joints",
    "place_joints",
    "place_keypoints",
    "pull",
    "pull_back",
    "way",
    "within",
]

_ROUND = 2 * pi
JOINT = np.dtype(
    [
        ("rotation", np.float64, (3, 3)),  # R⁰
        ("translation", np.float64, (3,)),  # t⁰ [m]
        ("axis", np.float64, (3,)),  # a, a unit vector in the frame of the joint
        ("parent", np.int64),
        ("slides", np.int64),
    ],
    align=True,
)
KEYPOINT = np.dtype([("offset", np.float64, (3,)), ("joint", np.int64)], align=True)  # in its joint's frame


@part
def place_joints(joints: Any, values: FloatArray, rotation: FloatArray, origin: FloatArray, axis: FloatArray) -> None:
    """Write R (m, 3, 3), o (m, 3) and z (m, 3) of the joints at `values: (m,)`.

    With exp(q [a]×) = cos·1 + sin·[a]× + (1 − cos)·aaᵀ. Numbers in place of small arrays take half the time.
    """
    for i in range(len(joints)):
        joint, q = joints[i], values[i]
        parent, t, own = joint.parent - 1, joint.translation, joint.rotation
        a0, a1, a2 = joint.axis[0], joint.axis[1], joint.axis[2]
        c, s = cos(q), sin(q)
        d = 1.0 - c
        for x in range(3):
            f0, f1, f2, at = 1.0 * (x == 0), 1.0 * (x == 1), 1.0 * (x == 2), 0.0
            if parent >= 0:
                frame = rotation[parent]
                f0, f1, f2, at = frame[x, 0], frame[x, 1], frame[x, 2], origin[parent, x]
            r0 = f0 * own[0, 0] + f1 * own[1, 0] + f2 * own[2, 0]
            r1 = f0 * own[0, 1] + f1 * own[1, 1] + f2 * own[2, 1]
            r2 = f0 * own[0, 2] + f1 * own[1, 2] + f2 * own[2, 2]
            along = r0 * a0 + r1 * a1 + r2 * a2
            axis[i, x], origin[i, x] = along, at + f0 * t[0] + f1 * t[1] + f2 * t[2]
            if joint.slides:
                origin[i, x] += along * q
                rotation[i, x, 0], rotation[i, x, 1], rotation[i, x, 2] = r0, r1, r2
            else:
                rotation[i, x, 0] = r0 * (d * a0 * a0 + c) + r1 * (d * a1 * a0 + s * a2) + r2 * (d * a2 * a0 - s * a1)
                rotation[i, x, 1] = r0 * (d * a0 * a1 - s * a2) + r1 * (d * a1 * a1 + c) + r2 * (d * a2 * a1 + s * a0)
                rotation[i, x, 2] = r0 * (d * a0 * a2 + s * a1) + r1 * (d * a1 * a2 - s * a0) + r2 * (d * a2 * a2 + c)


@part
def place_keypoints(keys: Any, rotation: FloatArray, origin: FloatArray, places: FloatArray) -> None:
    """Write where the key points (K, 3) are, o + R·offset."""
    for k in range(len(keys)):
        key = keys[k]
        carrier = key.joint - 1
        for x in range(3):
            if carrier < 0:
                places[k, x] = key.offset[x]
            else:
                frame = rotation[carrier]
                place = origin[carrier, x] + frame[x, 0] * key.offset[0] + frame[x, 1] * key.offset[1]
                places[k, x] = place + frame[x, 2] * key.offset[2]


@part
def pull(
    joints: Any,
    keys: Any,
    frames: tuple[FloatArray, FloatArray, FloatArray],
    places: FloatArray,
    forces: FloatArray,
    out: FloatArray,
) -> None:
    """Write Σ_k J_kᵀ f_k (m,) of forces (K, 3) at the key points; frames are o and z (m, 3), and room (m, 6).

    Joint i feels z_i·F_i if it slides, else z_i·(T_i − o_i × F_i): F and T are force and torque about the origin of the
    world of all that it carries, summed from the tips to the base.
    """
    m, (origin, axis, wrench) = len(joints), frames
    for i in range(m):
        for x in range(6):
            wrench[i, x] = 0.0
    for k in range(len(keys)):
        carrier = keys[k].joint - 1
        if carrier >= 0:
            for x in range(3):
                y, z = (x + 1) % 3, (x + 2) % 3
                wrench[carrier, x] += forces[k, x]
                wrench[carrier, 3 + x] += places[k, y] * forces[k, z] - places[k, z] * forces[k, y]
    for i in range(m - 1, -1, -1):
        force, torque, parent = wrench[i, :3], wrench[i, 3:], joints[i].parent - 1
        out[i] = 0.0
        for x in range(3):
            y, z = (x + 1) % 3, (x + 2) % 3
            moved = force[x] if joints[i].slides else torque[x] - (origin[i, y] * force[z] - origin[i, z] * force[y])
            out[i] += axis[i, x] * moved
        if parent >= 0:
            for x in range(6):
                wrench[parent, x] += wrench[i, x]


@compiled
def joint_frames(joints: Any, values: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return rotations (B, m, 3, 3), origins (B, m, 3) and world axes (B, m, 3) at `values: (B, m)`."""
    B, m = values.shape
    rotation, origin, axis = np.empty((B, m, 3, 3)), np.empty((B, m, 3)), np.empty((B, m, 3))
    for b in range(B):
        place_joints(joints, values[b], rotation[b], origin[b], axis[b])
    return rotation, origin, axis


@compiled
def keypoints(joints: Any, keys: Any, values: FloatArray) -> FloatArray:
    """Return the key points (B, K, 3) at `values: (B, m)`."""
    B, m = values.shape
    places = np.empty((B, len(keys), 3))
    rotation, origin, axis = np.empty((m, 3, 3)), np.empty((m, 3)), np.empty((m, 3))
    for b in range(B):
        place_joints(joints, values[b], rotation, origin, axis)
        place_keypoints(keys, rotation, origin, places[b])
    return places


@compiled
def pull_back(joints: Any, keys: Any, values: FloatArray, forces: FloatArray) -> FloatArray:
    """Return Σ_k J_kᵀ f_k (B, m) of forces (B, K, 3) at the key points at `values: (B, m)`."""
    B, m = values.shape
    out, places = np.empty((B, m)), np.empty((len(keys), 3))
    rotation, origin, axis = np.empty((m, 3, 3)), np.empty((m, 3)), np.empty((m, 3))
    frames = origin, axis, np.empty((m, 6))
    for b in range(B):
        place_joints(joints, values[b], rotation, origin, axis)
        place_keypoints(keys, rotation, origin, places)
        pull(joints, keys, frames, places, forces[b], out[b])
    return out


@compiled
def keypoint_motions(
    joints: Any, keys: Any, values: FloatArray, rates: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return places, velocities and accelerations (B, K, 3) of the key points at steady `rates: (B, m)`.

    With r from the parent's origin to the joint's, ω and α of the parent, and s = z_i q̇_i: a point at r has the
    velocity v + ω × r and the acceleration a + α × r + ω × (ω × r). Joint i adds s to ω and ω × s to α if it turns,
    s to v and 2ω × s to a if it slides.
    """
    B, m = values.shape
    out = np.empty((3, B, len(keys), 3))
    rotation, origin, axis = joint_frames(joints, values)
    spin, twist, speed, push = np.empty((m, 3)), np.empty((m, 3)), np.empty((m, 3)), np.empty((m, 3))
    at_rest, arm, swept = np.zeros(3), np.empty(3), np.empty(3)
    for b in range(B):
        place_keypoints(keys, rotation[b], origin[b], out[0, b])
        for i in range(m):
            parent = joints[i].parent - 1
            above = parent if parent >= 0 else 0
            omega, alpha = (spin[above], twist[above]) if parent >= 0 else (at_rest, at_rest)
            v, a = (speed[above], push[above]) if parent >= 0 else (at_rest, at_rest)
            for x in range(3):
                arm[x] = origin[b, i, x] - (origin[b, above, x] if parent >= 0 else 0.0)
            _carried(v, a, omega, alpha, arm, swept, speed[i], push[i])
            for x in range(3):
                y, z = (x + 1) % 3, (x + 2) % 3
                s_y, s_z = axis[b, i, y] * rates[b, i], axis[b, i, z] * rates[b, i]
                step, bent = axis[b, i, x] * rates[b, i], omega[y] * s_z - omega[z] * s_y
                if joints[i].slides:
                    speed[i, x] += step
                    push[i, x] += 2 * bent
                    spin[i, x], twist[i, x] = omega[x], alpha[x]
                else:
                    spin[i, x], twist[i, x] = omega[x] + step, alpha[x] + bent
        for k in range(len(keys)):
            i = keys[k].joint - 1
            if i < 0:
                out[1:, b, k] = 0.0
                continue
            for x in range(3):
                arm[x] = out[0, b, k, x] - origin[b, i, x]
            _carried(speed[i], push[i], spin[i], twist[i], arm, swept, out[1, b, k], out[2, b, k])
    return out[0], out[1], out[2]


@part
def _carried(
    v: FloatArray,
    a: FloatArray,
    omega: FloatArray,
    alpha: FloatArray,
    arm: FloatArray,
    swept: FloatArray,
    velocity: FloatArray,
    acceleration: FloatArray,
) -> None:
    """Write v + ω × r and a + α × r + ω × (ω × r), `swept` taking ω × r."""
    for x in range(3):
        y, z = (x + 1) % 3, (x + 2) % 3
        swept[x] = omega[y] * arm[z] - omega[z] * arm[y]
        velocity[x] = v[x] + swept[x]
    for x in range(3):
        y, z = (x + 1) % 3, (x + 2) % 3
        bent = omega[y] * swept[z] - omega[z] * swept[y]
        acceleration[x] = a[x] + alpha[y] * arm[z] - alpha[z] * arm[y] + bent


@compiled
def within(values: FloatArray, bounds: FloatArray) -> bool:
    """Return whether all values (n,) lie within their bounds (2, n), lower and upper; NaN never does."""
    return _within(values, bounds)


@part
def _within(values: FloatArray, bounds: FloatArray) -> bool:
    for i in range(values.shape[0]):  # noqa: SIM110  # Numba has no all()
        if not bounds[0, i] <= values[i] <= bounds[1, i]:
            return False
    return True


@compiled
def lay_edge(start: FloatArray, end: FloatArray, coupling: FloatArray, limits: FloatArray, edge: FloatArray) -> bool:
    """Write start and way (2, m) of the model's joints on the straight motion between `start` and `end: (n,)`.

    Nothing is written, and False returned, where an end is not within the `limits: (2, n)`. `coupling: (m, 4)` says of
    each joint of the model which planned one moves it, by what factor, its offset, and whether it goes the short way.
    """
    if not (_within(start, limits) and _within(end, limits)):
        return False
    for j in range(len(coupling)):
        i, factor = int(coupling[j, 0]), coupling[j, 1]
        edge[0, j] = factor * start[i] + coupling[j, 2]
        edge[1, j] = factor * way(start[i], end[i], coupling[j, 3] != 0.0)
    return True


@caller
def lay_edges(
    starts: FloatArray, ends: FloatArray, coupling: FloatArray, limits: FloatArray, edges: FloatArray, laid: BoolArray
) -> None:
    """Do what `lay_edge` does of E motions, `edges: (E, 2, m)`, and write what it returns, `laid: (E,)`."""
    for k in range(len(edges)):
        laid[k] = lay_edge(starts[k], ends[k], coupling, limits, edges[k])


@part
def way(start: float, end: float, wraps: bool) -> float:
    """Return the motion from one value of a joint to another, the short way round if it wraps."""
    delta = end - start
    return delta - _ROUND * np.rint(delta / _ROUND) if wraps else delta


@compiled
def unroll(path: FloatArray, wraps: BoolArray) -> FloatArray:
    """Return a path (N, n) with joints that do not jump where they wrap; the others stay as they are."""
    points, turns = path.copy(), np.zeros(len(wraps))
    for k in range(1, len(path)):
        for i in range(len(wraps)):
            step = way(path[k - 1, i], path[k, i], wraps[i])
            turns[i] += np.rint((step - (path[k, i] - path[k - 1, i])) / _ROUND)
            points[k, i] += _ROUND * turns[i]
    return points


@part
def move_joints(joints: Any, rates: FloatArray, origin: FloatArray, axis: FloatArray, twists: FloatArray) -> None:
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
