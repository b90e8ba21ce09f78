"""Proven lower bounds of the distance between convex hulls of points, and of whole motions among moving ones.

For any unit vector u the distance of two hulls A and B is at least min_A a·u − max_B b·u, whatever u is. Gilbert's
algorithm finds a good one: z is a point of A − B, w the point of A − B that lies farthest back along z; z then goes to
the point of the segment from z to w that is nearest to the origin. Every z bounds the distance from above, every
z·w/‖z‖ from below, so that most questions whether a distance is larger than some length end after one or two steps.
"""

from __future__ import annotations

from math import inf, sqrt
from typing import NamedTuple

import numpy as np

from safe_ompl.common import BoolArray, FloatArray, IntArray, compiled, part

__all__ = ["Borne", "CellFrames", "Hulls", "Sets", "cell_gaps", "chords_ahead", "gaps", "separating_axes"]

_STEPS = 60
_COARSE = 1e-3  # [m] so near to the largest distance come those along separating axes
_CLOSE = 1e-5  # [m] nearer bounds than this are not looked for
_ROUNDING = 1e-9  # [m]


@part
def hull_gap(
    first: FloatArray, second: FloatArray, start: FloatArray, wanted: float, close: float, decide: bool
) -> float:
    """Return a lower bound of the distance between the hulls of two sets of points, at least 0.

    `first: (A, 3)` and `second: (B, 3)` are the points [m], `start: (3,)` one of first − second to begin from; the
    direction of the bound is left in it. It is enough to prove that the distance is as large as `wanted` [m] or, to
    `decide`, to find that it is less; otherwise the bounds must come within `close` [m].
    """
    z0, z1, z2 = start[0], start[1], start[2]
    best = 0.0
    for _ in range(_STEPS):
        squared = z0 * z0 + z1 * z1 + z2 * z2
        length = sqrt(squared)
        if length <= close or (decide and length < wanted) or length - best <= close:
            return best
        least, i = inf, 0
        for k in range(len(first)):
            along = first[k, 0] * z0 + first[k, 1] * z1 + first[k, 2] * z2
            if along < least:
                least, i = along, k
        most, j = -inf, 0
        for k in range(len(second)):
            along = second[k, 0] * z0 + second[k, 1] * z1 + second[k, 2] * z2
            if along > most:
                most, j = along, k
        if least - most > best * length:
            best = (least - most) / length
            start[0], start[1], start[2] = z0 / length, z1 / length, z2 / length
        if best >= wanted:
            return best
        d0 = first[i, 0] - second[j, 0] - z0
        d1 = first[i, 1] - second[j, 1] - z1
        d2 = first[i, 2] - second[j, 2] - z2
        across = d0 * d0 + d1 * d1 + d2 * d2
        if across <= 0.0:
            return best
        step = min(1.0, -(z0 * d0 + z1 * d1 + z2 * d2) / across)
        if step <= 0.0:
            return best
        z0, z1, z2 = z0 + step * d0, z1 + step * d1, z2 + step * d2
    return best


@part
def _ball(points: FloatArray) -> tuple[float, float, float, float]:
    """Return the mean of the points, and how far the farthest of them is from it."""
    m0, m1, m2, far = 0.0, 0.0, 0.0, 0.0
    count = len(points)
    for k in range(count):
        m0, m1, m2 = m0 + points[k, 0] / count, m1 + points[k, 1] / count, m2 + points[k, 2] / count
    for k in range(count):
        far = max(far, (points[k, 0] - m0) ** 2 + (points[k, 1] - m1) ** 2 + (points[k, 2] - m2) ** 2)
    return m0, m1, m2, sqrt(far)


class CellFrames(NamedTuple):
    """N cells of a path: frames of the m joints at their centres, (N, m, 3, 3) and (N, m, 3), and travel (N, G) [m].

    The travel is how far the bodies get away from where they are at the centre of a cell.
    """

    rotations: FloatArray
    origins: FloatArray
    travel: FloatArray


class Hulls(NamedTuple):
    """G bodies: their joints (G,); hulls in the frames of these, vertices (V, 3), first ones (G + 1,), pads (G,).

    Also balls about the means of their vertices: middles (G, 3) and extents (G,).
    """

    carriers: IntArray
    vertices: FloatArray
    first_vertex: IntArray
    pads: FloatArray
    middles: FloatArray
    extents: FloatArray


class Sets(NamedTuple):
    """M bodies that move: points (P, 3) of the sets in which they may be, first ones (M + 1,) and radii (M,).

    Also growth (M, 2), g₀ [m] and g₁ [m/s]; see `people.reach.ReachSets`.
    """

    points: FloatArray
    first_point: IntArray
    radii: FloatArray
    growth: FloatArray


class Borne(NamedTuple):
    """How fast contact is borne: ṡ² of the windows (W,) at most, and the largest (N, G, M) of cell and bodies.

    Where contact is not allowed the last array is empty; it is not borne from bodies beyond its end.
    """

    squares: FloatArray
    most: FloatArray


@compiled
def gaps(
    at: IntArray,
    until: FloatArray,
    borne: Borne,
    cells: CellFrames,
    hulls: Hulls,
    sets: Sets,
    left: float,
    enough: float,
    close: float,
    stop_at_first: bool,
) -> tuple[float, int, int, int]:
    """Return the least that is left between a robot and what moves, over the windows of a motion, and where that is.

    The margin min (distance − growth − travel − left) [m] is a lower bound, negative where nothing is proven; then come
    the window, the body of the robot and the one that moves, −1 if there is nothing. The robot is in the cells
    `at: (W,)` of a path no longer than `until: (W,)` [s]. The distance `left` must be left [m], margins above `enough`
    [m] need not be known. The least is found within `close` [m]; 0: only whether it is negative, and then perhaps to
    `stop_at_first` such one. Two bodies that may touch at the speed of a window need no distance in it.
    """
    squares, most = borne
    rotations, origins, travel = cells
    carriers, vertices, first_vertex, pads, middles, extents = hulls
    points, first_point, radii, growth = sets
    worst, window, body, who = inf, -1, -1, -1
    G, S = len(carriers), len(radii)
    local = np.empty((len(points), 3))
    balls = np.empty((S, 4))
    for s in range(S):
        b0, b1, b2, r = _ball(points[first_point[s] : first_point[s + 1]])
        balls[s, 0], balls[s, 1], balls[s, 2], balls[s, 3] = b0, b1, b2, r
    grown = np.empty(S)
    delta = np.empty(3)
    for w in range(len(at)):
        k = at[w]
        for s in range(S):
            grown[s] = radii[s] + growth[s, 0] + until[w] * growth[s, 1]
        for g in range(G):
            R, o = rotations[k, carriers[g]], origins[k, carriers[g]]
            c0 = o[0] + R[0, 0] * middles[g, 0] + R[0, 1] * middles[g, 1] + R[0, 2] * middles[g, 2]
            c1 = o[1] + R[1, 0] * middles[g, 0] + R[1, 1] * middles[g, 1] + R[1, 2] * middles[g, 2]
            c2 = o[2] + R[2, 0] * middles[g, 0] + R[2, 1] * middles[g, 1] + R[2, 2] * middles[g, 2]
            for s in range(S):
                if len(most) and s < most.shape[2] and squares[w] <= most[k, g, s]:
                    continue
                need = grown[s] + travel[k, g] + left + pads[g]
                far = sqrt((c0 - balls[s, 0]) ** 2 + (c1 - balls[s, 1]) ** 2 + (c2 - balls[s, 2]) ** 2)
                apart = far - balls[s, 3] - extents[g] - need
                if apart < min(worst, enough):
                    a, b = first_point[s], first_point[s + 1]
                    for p in range(a, b):
                        v0, v1, v2 = points[p, 0] - o[0], points[p, 1] - o[1], points[p, 2] - o[2]
                        for x in range(3):
                            local[p, x] = R[0, x] * v0 + R[1, x] * v1 + R[2, x] * v2
                    for x in range(3):
                        delta[x] = middles[g, x] - (
                            R[0, x] * (balls[s, 0] - o[0])
                            + R[1, x] * (balls[s, 1] - o[1])
                            + R[2, x] * (balls[s, 2] - o[2])
                        )
                    decide = close == 0.0
                    wanted = max(need, 0.0) if decide else min(worst, enough) + need
                    hull = vertices[first_vertex[g] : first_vertex[g + 1]]
                    gap = hull_gap(hull, local[a:b], delta, wanted, max(close, _CLOSE), decide)
                    apart = max(apart, gap - need)
                if apart < worst:
                    worst, window, body, who = apart, w, g, s
                    if stop_at_first and worst < 0.0:
                        return worst, window, body, who
    return worst, window, body, who


@compiled
def separating_axes(hulls: Hulls, frames: CellFrames, sets: Sets, far: float) -> tuple[FloatArray, FloatArray]:
    """Return directions (G, S, 3) from sets to bodies, and bounds (G, S) of how far apart they are along these [m].

    The robot is in the middle of the first cell; sets and bodies are without radii, growth and pads. Bounds of more
    than `far` [m] need not be known: they are infinite.
    """
    G, S = len(hulls.carriers), len(sets.radii)
    axes, apart = np.zeros((G, S, 3)), np.full((G, S), inf)
    for g in range(G):
        R, o = frames.rotations[0, hulls.carriers[g]], frames.origins[0, hulls.carriers[g]]
        own = hulls.vertices[hulls.first_vertex[g] : hulls.first_vertex[g + 1]]
        hull = np.empty((len(own), 3))
        for v in range(len(own)):
            for x in range(3):
                hull[v, x] = o[x] + R[x, 0] * own[v, 0] + R[x, 1] * own[v, 1] + R[x, 2] * own[v, 2]
        m0, m1, m2, extent = _ball(hull)
        for s in range(S):
            points = sets.points[sets.first_point[s] : sets.first_point[s + 1]]
            b0, b1, b2, radius = _ball(points)
            axes[g, s] = m0 - b0, m1 - b1, m2 - b2
            if sqrt((axes[g, s] ** 2).sum()) - extent - radius < far:
                apart[g, s] = hull_gap(hull, points, axes[g, s], inf, _COARSE, False)
    return axes, apart


@compiled
def chords_ahead(hulls: Hulls, frames: CellFrames, axes: FloatArray, apart: FloatArray, bends: FloatArray) -> BoolArray:
    """Return which bodies (G, S) are apart from sets and come no nearer to them along `separating_axes`.

    The robot goes from the first cell to the second. A vertex that is start ≥ 0 ahead of the foremost one and then
    end ≥ 0, but for rounding, comes no nearer if √start + √end ≥ √bend, with `bends: (G,)` [m].
    """
    found = np.zeros(apart.shape, dtype=np.bool_)
    heights = np.empty((2, len(hulls.vertices)))
    for g in range(len(apart)):
        hull = hulls.vertices[hulls.first_vertex[g] : hulls.first_vertex[g + 1]]
        for s in range(apart.shape[1]):
            if 0.0 < apart[g, s] < inf:
                least, u = [inf, inf], axes[g, s]
                for k in range(2):
                    R, o = frames.rotations[k, hulls.carriers[g]], frames.origins[k, hulls.carriers[g]]
                    at = o[0] * u[0] + o[1] * u[1] + o[2] * u[2]
                    x = R[0, 0] * u[0] + R[1, 0] * u[1] + R[2, 0] * u[2]
                    y = R[0, 1] * u[0] + R[1, 1] * u[1] + R[2, 1] * u[2]
                    z = R[0, 2] * u[0] + R[1, 2] * u[1] + R[2, 2] * u[2]
                    for v in range(len(hull)):
                        heights[k, v] = at + hull[v, 0] * x + hull[v, 1] * y + hull[v, 2] * z
                        least[k] = min(least[k], heights[k, v])
                recedes, v = least[1] - least[0] + _ROUNDING >= 0.0, 0
                while recedes and v < len(hull):
                    start, end = heights[0, v] - least[0], heights[1, v] - least[0] + _ROUNDING
                    recedes, v = sqrt(start) + sqrt(end) >= sqrt(bends[g]), v + 1
                found[g, s] = recedes
    return found


@compiled
def cell_gaps(
    at: IntArray, borne: Borne, cells: CellFrames, hulls: Hulls, sets: Sets, left: float, far: float, close: float
) -> FloatArray:
    """Return for each of the cells (W,) the least that is left at the instant of the measurement [m]; as `gaps`.

    More than `far` need not be known, and what is less but within `close` [m].
    """
    found = np.empty(len(at))
    now = np.zeros(1)
    for w in range(len(at)):
        one = Borne(borne.squares[w : w + 1], borne.most)
        margin = gaps(at[w : w + 1], now, one, cells, hulls, sets, left + far, 0.0, close, False)[0]
        found[w] = min(margin, 0.0) + far
    return found
