"""Bubbles of free configuration space (Lacevic & Rocco 2013, §4.1), each from one distance query.

At a configuration q let every checked pair of bodies p be d_p apart, and approach each other by no more than
Σ_i R_pi·|Δ_i| while the joints move by Δ. Then no motion with Σ_i R_pi·|Δ_i| < d_p for all p ends in contact: this is
the bubble of q. The shapes that the planner chains are simpler subsets of it, all of them written

    B(q) = {x : ‖w ∘ (x − q)‖ < 1},     w ≥ 0,

a diamond with the 1-norm, a box with the ∞-norm. They are convex, so straight motions within one are free.

Where shapes of arrays are given, P counts the pairs, n the joints, N the bubbles. Radii are in m/rad (1 for
prismatic joints), distances in m, weights in 1/rad (or 1/m).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from safe_ompl.collision.broad_phase import DISTANCE_ERROR
from safe_ompl.collision.checker import CollisionChecker
from safe_ompl.common import BoolArray, FloatArray

_TINY = 1e-200
INSIDE = 0.99  # the boundary of a bubble may touch: stay this much inside (`docs/mathematics.md` §2)
_HALF_TURN = 3.1  # [rad] as far as a joint that wraps goes: at π both ways back are the same


def common_diamond(radii: FloatArray, distances: FloatArray) -> FloatArray:
    """Return the weights (n,) of the paper's bubble: Σ r_i·|Δ_i| < d_c = min_p d_p, eq. (9).

    Displacement radii (P, n) at the centre are of pairs or of bodies: r_i is the largest. Distances (P,) at the centre
    are positive.
    """
    weights: FloatArray = radii.max(axis=0, initial=0.0) / distances.min(initial=np.inf)
    return weights


def link_diamond(radii: FloatArray, distances: FloatArray) -> FloatArray:
    """Return the weights (n,) of the largest diamond in the bubble: w_i = max_p R_pi/d_p (`docs/mathematics.md` §3).

    It holds the paper's (9), because max_p R_pi/d_p ≤ max_p R_pi/min_p d_p. Parameters as for `common_diamond`.
    """
    weights: FloatArray = (radii / distances[:, None]).max(axis=0, initial=0.0)
    return weights


def inscribed_cube(radii: FloatArray, distances: FloatArray) -> FloatArray:
    """Return the weights (n,), all equal, of the largest cube in the bubble: |Δ_i| < min_p d_p/Σ_j R_pj."""
    weight = float((radii.sum(axis=1) / distances).max(initial=0.0))
    return np.full(radii.shape[1], weight)


def common_cube(radii: FloatArray, distances: FloatArray) -> FloatArray:
    """Return the weights (n,), all equal, of the largest cube in the paper's bubble (9): |Δ_i| < d_c/Σ_j r_j."""
    return np.full(radii.shape[1], common_diamond(radii, distances).sum())


def extents(weights: FloatArray) -> FloatArray:
    """Return how far (n,) a diamond or box reaches along each axis, 1/w_i; infinite where nothing limits it."""
    return np.divide(1.0, weights, out=np.full_like(weights, np.inf), where=weights > 0)


def axis_points(center: FloatArray, reaches: FloatArray, lower: FloatArray, upper: FloatArray) -> FloatArray:
    """Return the points (2n, n) at ± `reaches: (n,)` from the centre (n,) along each axis, within the limits (n,)."""
    points = np.tile(center, (2, len(center), 1))
    axes = np.arange(len(center))
    points[0, axes, axes] = np.maximum(center - reaches, lower)
    points[1, axes, axes] = np.minimum(center + reaches, upper)
    return points.reshape(-1, len(center))


def reach_along(motion: FloatArray, radii: FloatArray, distances: FloatArray) -> float:
    """Return the largest t for which all motions shorter than t·Δ are in the bubble: min_p d_p / Σ_i R_pi·|Δ_i|.

    This is the whole bubble, not the diamond or cube within it. Δ is `motion: (n,)`, the rest as for `common_diamond`.
    """
    approach = radii @ np.abs(motion)
    reaches = np.divide(distances, approach, out=np.full_like(distances, np.inf), where=approach > 0)
    return float(reaches.min(initial=np.inf))


class Meetings(NamedTuple):
    """How N pairs of bubbles meet.

    The gaps (N,) are the factors by which both bubbles must grow or shrink to touch; they intersect iff it is below 1.
    At x = q₁ + s ∘ (q₂ − q₁), with shares s ∈ [0, 1]ⁿ (N, n), the bubbles so scaled touch. If they intersect x is in
    both, as far from leaving the one as the other.
    """

    gaps: FloatArray
    shares: FloatArray


def diamond_meetings(u: FloatArray, v: FloatArray) -> Meetings:
    """Return how diamonds meet, exactly, also where their weights differ (`docs/mathematics.md` §3).

    `u` and `v` (N, n) are the weights of the first and of the second diamond times |q₂ − q₁|. The gap is
    min_s max(Σ u_i s_i, Σ v_i (1 − s_i)). As s fills up in descending order of v_i/u_i, the first sum rises and the
    second falls as fast as it can; the optimum is where they are equal.
    """
    ratios = np.divide(v, u, out=np.full_like(v, np.inf), where=u > 0)
    order = np.argsort(-ratios, axis=1)
    u, v = np.take_along_axis(u, order, 1), np.take_along_axis(v, order, 1)
    # Sums while coordinate k fills: u before, v from it on. They cross in the last k with before ≤ after.
    before = np.cumsum(u, axis=1) - u
    after = np.cumsum(v[:, ::-1], axis=1)[:, ::-1]
    filled = np.clip((after - before) / np.maximum(u + v, _TINY), 0.0, 1.0)
    gaps = np.maximum((u * filled).sum(axis=1), (v * (1.0 - filled)).sum(axis=1))
    shares = np.empty_like(filled)
    np.put_along_axis(shares, order, filled, 1)
    return Meetings(gaps, shares)


def box_meetings(u: FloatArray, v: FloatArray) -> Meetings:
    """Return how boxes meet; every coordinate by itself: u_i s_i = v_i (1 − s_i). Parameters as above."""
    total = u + v
    shares = np.divide(v, total, out=np.full_like(v, 0.5), where=total > 0)
    return Meetings((u * shares).max(axis=1, initial=0.0), shares)


def diamonds_may_meet(u: FloatArray, v: FloatArray) -> BoolArray:
    """Return False (N,) only where diamonds do not meet: Σ min(u_i, v_i) bounds twice their gap from below."""
    near: BoolArray = np.minimum(u, v).sum(axis=1) < 2.0
    return near


def boxes_may_meet(u: FloatArray, v: FloatArray) -> BoolArray:
    """Return False (N,) only where boxes do not meet: max min(u_i, v_i) bounds twice their gap from below."""
    near: BoolArray = np.minimum(u, v).max(axis=1, initial=0.0) < 2.0
    return near


class BubbleShape(NamedTuple):
    """A kind of bubble.

    Attributes
    ----------
    weights : callable
        From radii (P, n) and distances (P,) to weights (n,).
    enclosing : bool
        Whether the radii are those of the cylinders about the joints' axes that enclose the links, as in (9): how far
        every body can move, whatever it may meet. Otherwise they are those of the pairs, which are no larger.
    may_meet, meetings : callable
        From weighted gaps u, v (N, n) to which of N pairs may meet (N,): cheap, and never wrongly False; and to how.
    """

    weights: Callable[[FloatArray, FloatArray], FloatArray]
    enclosing: bool
    may_meet: Callable[[FloatArray, FloatArray], BoolArray]
    meetings: Callable[[FloatArray, FloatArray], Meetings]


BUBBLE_SHAPES = {
    "paper": BubbleShape(common_diamond, True, diamonds_may_meet, diamond_meetings),
    "paper_cube": BubbleShape(common_cube, True, boxes_may_meet, box_meetings),
    "link": BubbleShape(link_diamond, False, diamonds_may_meet, diamond_meetings),
    "cube": BubbleShape(inscribed_cube, False, boxes_may_meet, box_meetings),
}


@dataclass(frozen=True)
class Bubble:
    """Configurations proven free: {x : ‖weights ∘ (x − q)‖ < 1} around `q: (n,)`, see `safe_ompl.collision.bubbles`.

    The radii (P, n) [m/rad] and the distances (P,) [m] are those of the pairs at the centre.
    """

    q: FloatArray
    weights: FloatArray
    radii: FloatArray
    distances: FloatArray

    @classmethod
    def around(cls, q: FloatArray, checker: CollisionChecker, shape: str, least: float = 0.0) -> Bubble | None:
        """Return the bubble around `q: (n,)`, or None where the clearance is not more than `least` [m].

        The checker gives distances of all checked pairs, the robot's own included, and their radii at `q`; the shape is
        one of `safe_ompl.collision.BUBBLE_SHAPES`.
        """
        distances = checker.pair_distances(q) - DISTANCE_ERROR
        if distances.min(initial=np.inf) <= least:
            return None
        radii, form = checker.pair_radii_at(q), BUBBLE_SHAPES[shape]
        own = checker.robot.bounds.displacement_radii_at(q) if form.enclosing else radii
        return cls(q, form.weights(own, distances), radii, distances)

    def vertices(self, lower: FloatArray, upper: FloatArray, circular: BoolArray) -> FloatArray:
        """Return the ends (2n, n) of the shape's axes, within the limits (n,) of joints that do not wrap."""
        reaches = INSIDE * extents(self.weights)
        return axis_points(
            self.q,
            np.where(circular, np.minimum(reaches, _HALF_TURN), reaches),
            np.where(circular, -np.inf, lower),
            np.where(circular, np.inf, upper),
        )

    def exit(self, motion: FloatArray) -> FloatArray:
        """Return where the way q + `motion: (n,)` leaves what the distances prove free, or its end."""
        return self.q + min(1.0, INSIDE * reach_along(motion, self.radii, self.distances)) * motion
