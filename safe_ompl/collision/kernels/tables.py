"""What kernels know of pairs of bodies, and groups of pairs that are left out together."""

from __future__ import annotations

from math import inf
from typing import Any, NamedTuple

import numpy as np

from safe_ompl.common import BoolArray, FloatArray, IntArray, inlined
from safe_ompl.geometry.kernels import BODY, NODE, POSE, Records, Shapes, from_box
from safe_ompl.robot.kernels import JOINT

GROUP = np.dtype(
    [
        ("begin", np.intp),  # of its pairs: those of one of the robot's bodies
        ("end", np.intp),
        ("body", np.intp),  # that one
        ("centre", np.float64, (3,)),  # in the world, of a ball that holds their obstacles,
        ("radius", np.float64),  # of this radius; +∞: none does, or these are no such pairs
        ("lane", np.intp),  # where the balls about these obstacles begin
        ("on", np.intp),  # how many groups from here on are a run: of one body, and far away if the next ball is;
        ("back", np.intp),  # how many there are back to the first of a run, this one the last; elsewhere both are 1
        ("around", np.float64, (3,)),
        ("wide", np.float64),
    ],
    align=True,
)


class Pairs(NamedTuple):
    """Pairs of bodies: `bodies` (P, 2), their constant radii R (m, P), and those of each body about the joints, (m, G).

    Where an upper bound of the distance is `certain` (P,) [m] below what is required, a pair is too near: by as much as
    the allowances in that, where both bodies are known exactly, else never, +∞. Of many obstacles few are near: pairs
    come in `groups: (K,)` of type `GROUP`, each of one body of the robot's, and groups that are far away are left out
    at once. The robot's bodies are the first `own`. Of the balls about the obstacles of groups there are centres and
    radii, `balls: (4, ·)`, each group's rounded up to whole `LANES`.
    """

    bodies: Any  # unsigned: for others Numba asks each time whether they count from the end
    radii: FloatArray  # joint by joint, so that processors compute the rates of pairs by lanes
    reaches: FloatArray  # 0 where a joint does not move the body
    certain: FloatArray
    groups: Records
    own: int
    balls: FloatArray


class Required(NamedTuple):
    """Distances (P,) [m] that pairs must keep, and the largest of them, (1,): a kernel may write both."""

    distances: FloatArray
    most: FloatArray

    @classmethod
    def of(cls, distances: FloatArray) -> Required:
        """Return these distances (P,) [m]."""
        return cls(distances, np.array([distances.max(initial=-inf)]))


class EdgeTables(NamedTuple):
    """What `prove_edge` needs: what `lay_edge` and `prove_curve` do, in this order."""

    joints: Any
    shapes: Shapes
    pairs: Pairs
    coupling: FloatArray
    limits: FloatArray
    required: Required
    floor: float
    edge: FloatArray
    left: FloatArray
    suspects: IntArray
    poses: Records

    @classmethod
    def of_nothing(cls) -> EdgeTables:
        """Return what kernels are given where nothing is to be proven."""
        numbers: IntArray = np.zeros((0, 2), np.intp)
        none, edge = np.zeros((0, 0)), np.zeros((2, 0))
        shapes = Shapes(np.zeros(0, BODY), numbers.ravel(), none, np.zeros(0, NODE))
        pairs = Pairs(numbers.astype(np.uintp), none, none, edge[0], np.zeros(0, GROUP), 0, none)
        left, suspects, poses = np.zeros((1, 2)), numbers.ravel(), np.zeros(0, POSE)
        return cls(
            np.zeros(0, JOINT), shapes, pairs, none, edge, Required.of(edge[0]), 1.0, edge, left, suspects, poses
        )


LANES = 8  # balls that are looked at together
_FEW = 2 * LANES  # pairs of a group


@inlined
def is_far(centre: FloatArray, radius: float, body: Records, pose: Records, enough: float) -> bool:
    """Return whether a ball is at least `enough` [m] away from that about a body."""
    at, apart = pose.centre, enough + body.reach + radius
    x, y, z = at[0] - centre[0], at[1] - centre[1], at[2] - centre[2]
    return bool(x * x + y * y + z * z >= apart * apart)


@inlined
def near_in_group(
    group: Records, balls: FloatArray, body: Records, pose: Records, enough: float, hits: BoolArray, near: IntArray
) -> int:
    """Write those pairs of a group whose balls may be less than `enough` [m] apart; return how many they are.

    The body and its pose are that of the robot in all of them, and `hits: (LANES,)` is working memory. Where the group
    is none of obstacles all pairs are written.
    """
    count = group.end - group.begin
    if not group.radius < inf:
        for k in range(count):
            near[k] = group.begin + k
        return int(count)
    if is_far(group.centre, group.radius, body, pose, enough):
        return 0
    if count > _FEW:  # many small obstacles are within the ball about a long body, and few near it
        (u, v, w), far = from_box(body, pose, group.centre), enough + group.radius
        if u * u + v * v + w * w >= far * far:
            return 0
    x, y, z, far = pose.centre[0], pose.centre[1], pose.centre[2], enough + body.reach
    number: Any = np.uintp(0)
    for first in range(0, count, LANES):
        for k in range(LANES):
            lane = np.uintp(group.lane + first + k)
            a, b, c = x - balls[0, lane], y - balls[1, lane], z - balls[2, lane]
            reach = far + balls[3, lane]
            hits[k] = not a * a + b * b + c * c >= reach * reach
        for k in range(min(LANES, count - first)):
            near[number] = group.begin + first + k
            number += np.uintp(hits[k])
    return int(np.intp(number))
