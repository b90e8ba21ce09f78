"""Lower bounds of the distances of many pairs of convex bodies at many configurations."""

from __future__ import annotations

from math import inf, sqrt
from typing import Any

import numpy as np

from safe_ompl.arrays import FloatArray, IntArray
from safe_ompl.maths.kernels.compiled import compiled
from safe_ompl.maths.kernels.convex import POSE, Records, begin_axis, distance_bounds, from_box, place_bodies
from safe_ompl.maths.kernels.joints import place_joints


@compiled
def pair_bounds(
    joints: Any,
    bodies: Records,
    starts: IntArray,
    vertices: FloatArray,
    pairs: IntArray,
    values: FloatArray,
    enough: float,
    bounds: FloatArray,
) -> None:
    """Write lower bounds of the distances of pairs at configurations; no bound is better than it need be.

    The bound of the balls about both bodies comes first, then that of the box about one and the ball about the other,
    then that along an axis (`convex`), which is kept for the next configuration.

    Parameters
    ----------
    joints : (m,)
        The joints (`safe_ompl.maths.kernels.joints`).
    bodies, starts, vertices : (G,), (C + 1,), (E, 3)
        The bodies (`BODY`), and the lists of their vertices.
    pairs : (K, 2)
        The pairs.
    values : (B, m)
        Values of the joints.
    enough : float
        [m] A bound as good as this is not improved any more.
    bounds : (B, K)
        Where they are written [m].
    """
    m = values.shape[1]
    poses, simplex = np.empty(len(bodies), POSE), np.empty((4, 3))
    axes, known = np.empty((len(pairs), 3)), np.zeros(len(pairs), np.bool_)
    rotations, origins, joint_axes = np.empty((m, 3, 3)), np.empty((m, 3)), np.empty((m, 3))
    for row in range(len(values)):
        place_joints(joints, values[row], rotations, origins, joint_axes)
        if row == 0:
            place_bodies(bodies, poses, rotations, origins, False)
        place_bodies(bodies, poses, rotations, origins, True)
        for p in range(len(pairs)):
            A, B = pairs[p, 0], pairs[p, 1]
            a, b = poses[A].centre, poses[B].centre
            x, y, z = a[0] - b[0], a[1] - b[1], a[2] - b[2]
            lower = sqrt(x * x + y * y + z * z) - bodies[A].reach - bodies[B].reach
            if lower < enough:
                u, v, w = from_box(bodies[B], poses[B], a)
                lower = max(lower, sqrt(u * u + v * v + w * w) - bodies[A].reach)
                if lower < enough:
                    if not known[p]:
                        begin_axis(axes[p], u, v, w, x, y, z)
                        known[p] = True
                    found, _ = distance_bounds(
                        bodies[A],
                        poses[A],
                        bodies[B],
                        poses[B],
                        starts,
                        vertices,
                        axes[p],
                        simplex,
                        enough,
                        enough,
                    )
                    lower = max(lower, found)
            bounds[row, p] = lower if lower == lower else -inf
