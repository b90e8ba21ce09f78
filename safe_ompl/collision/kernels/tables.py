"""What kernels know of pairs of bodies, and groups of pairs that are left out together."""

from __future__ import annotations

from math import inf
from typing import Any, NamedTuple

import numpy as np

from safe_ompl.common import FloatArray, IntArray, maker, part
from safe_ompl.geometry.kernels import BODY, Records, Shapes
from safe_ompl.robot.kernels import JOINT

GROUP = np.dtype(
    [
        ("begin", np.intp),  # of its pairs: those of one of the robot's bodies
        ("end", np.intp),
        ("centre", np.float64, (3,)),  # in the world, of a ball that holds their obstacles,
        ("radius", np.float64),  # of this radius; +∞: none does, or these are no such pairs
    ],
    align=True,
)


class Pairs(NamedTuple):
    """Pairs of bodies: `bodies` (P, 2), their constant radii R (m, P), and those of each body about the joints, (G, m).

    Where an upper bound of the distance is `certain` (P,) [m] below what is required, a pair is too near: by as much as
    the allowances in that, where both bodies are known exactly, else never, +∞. Of many obstacles few are near: the
    `groups: (K,)` of type `GROUP` that are far away are left out at once. The robot's bodies are the first `own`.
    """

    bodies: IntArray
    radii: FloatArray  # joint by joint, so that processors compute the rates of pairs by lanes
    reaches: FloatArray  # 0 where a joint does not move the body
    certain: FloatArray
    groups: Records
    own: int


class EdgeTables(NamedTuple):
    """What `prove_edge` needs: what `lay_edge` and `prove_curve` do, in this order."""

    joints: Any
    shapes: Shapes
    pairs: Pairs
    coupling: FloatArray
    limits: FloatArray
    required: FloatArray
    floor: float
    edge: FloatArray
    left: FloatArray
    suspects: IntArray

    @classmethod
    def of_nothing(cls) -> EdgeTables:
        """Return what kernels are given where nothing is to be proven."""
        numbers: IntArray = np.zeros((0, 2), np.intp)
        none, edge = np.zeros((0, 0)), np.zeros((2, 0))
        shapes = Shapes(np.zeros(0, BODY), numbers.ravel(), none)
        pairs = Pairs(numbers, none, none, edge[0], np.zeros(0, GROUP), 0)
        return cls(np.zeros(0, JOINT), shapes, pairs, none, edge, edge[0], 1.0, edge, np.zeros((1, 2)), numbers.ravel())


@maker
def most_of(values: FloatArray) -> float:
    """Return the largest of values (P,), in lanes: one after the other would take ten times as long."""
    lanes, count = np.full(8, -inf), len(values)
    for p in range(0, count - 7, 8):
        for k in range(8):
            lanes[k] = values[p + k] if values[p + k] > lanes[k] else lanes[k]
    for p in range(count - count % 8, count):
        lanes[0] = max(lanes[0], values[p])
    return float(lanes.max())


@part
def is_far(group: Records, body: Records, pose: Records, enough: float) -> bool:
    """Return whether the robot's body of a group of pairs is `enough` [m] away from the obstacles of all."""
    if not group.radius < inf:
        return False
    a, b, far = pose.centre, group.centre, enough + body.reach + group.radius
    x, y, z = a[0] - b[0], a[1] - b[1], a[2] - b[2]
    return bool(x * x + y * y + z * z >= far * far)
