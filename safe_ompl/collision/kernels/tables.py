"""What kernels know of pairs of bodies, and groups of pairs that are left out together."""

from __future__ import annotations

from math import inf, sqrt
from typing import Any, NamedTuple

import numpy as np

from safe_ompl.common import BoolArray, FloatArray, IntArray, compiled, inlined, part
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
BLOCK = 64  # parts of obstacles that are near each other
_FEW = 2 * LANES  # pairs of a group
_RUN = 8  # groups that are near each other
_ROUNDING = 1e-9  # [m] of distances between balls


@compiled
def grouped(pairs: Any, own: int, bodies: Records, poses: Records) -> tuple[Records, FloatArray]:
    """Return groups of pairs (P, 2) as they follow each other, and the balls about their obstacles, as `Pairs`."""
    P, count, lanes = len(pairs), 0, 0
    groups, meets = np.zeros(P, GROUP), np.zeros(P, np.bool_)
    centres, radii, middles, widths = np.zeros((P, 3)), np.zeros(P), np.zeros((P, 3)), np.full(P, inf)
    for k in range(P):
        body = np.intp(pairs[k, 1])
        centres[k], radii[k], meets[k] = poses[body].centre, bodies[body].reach, body >= own
    end = 0
    while end < P:
        begin, group = end, groups[count]
        while end < min(P, begin + BLOCK) and meets[end] == meets[begin]:
            if meets[end] and pairs[end, 0] != pairs[begin, 0]:
                break
            end += 1
        group.begin, group.end, group.body, group.lane = begin, end, pairs[begin, 0], lanes
        if meets[begin]:
            widths[count] = _write_ball(centres[begin:end], radii[begin:end], middles[count])
        group.centre[:], group.radius = middles[count], widths[count]
        count, lanes = count + 1, lanes + (end - begin + LANES - 1) // LANES * LANES
    balls, end = np.zeros((4, lanes)), 0
    for g in range(count):
        for k in range(groups[g].begin, groups[g].end):
            lane = groups[g].lane + k - groups[g].begin
            balls[:3, lane], balls[3, lane] = centres[k], radii[k]
    while end < count:
        begin, body = end, groups[end].body
        while end < min(count, begin + _RUN) and groups[end].body == body:
            if (widths[end] < inf) != (widths[begin] < inf):
                break
            groups[end].on = groups[end].back = 1
            end += 1
        wide = _write_ball(middles[begin:end], widths[begin:end], groups[begin].around)
        for g in range(begin, end):
            groups[g].around[:], groups[g].wide = groups[begin].around, wide
        groups[begin].on = groups[end - 1].back = end - begin
    return groups[:count].copy(), balls


@part
def _write_ball(centres: FloatArray, radii: FloatArray, middle: FloatArray) -> float:
    """Write the centre (3,) of a ball that holds other balls (K,); return its radius."""
    widest = 0.0
    for x in range(3):
        middle[x] = 0.0
        for k in range(len(centres)):
            middle[x] += centres[k, x] / len(centres)
    for k in range(len(centres)):
        x, y, z = centres[k, 0] - middle[0], centres[k, 1] - middle[1], centres[k, 2] - middle[2]
        widest = max(widest, sqrt(x * x + y * y + z * z) + radii[k])
    return widest + _ROUNDING


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
