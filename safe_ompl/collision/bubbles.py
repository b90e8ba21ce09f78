"""Bubbles of free configuration space (Lacevic & Rocco 2013, §4.1), each from one distance query.

Let d_p be the distance of each checked pair of bodies p at a configuration q. While the joints move by Δ, the bodies
approach each other by at most Σ_i R_pi·|Δ_i|. Then no motion with Σ_i R_pi·|Δ_i| < d_p for all p ends in contact. These
motions are the bubble of q. The planners chain diamonds within bubbles,

    B(q) = {x : Σ_i w_i·|x_i − q_i| < 1},     w ≥ 0.

Diamonds are convex, so straight motions within a diamond are free.

In shapes of arrays, P is the number of pairs, n of joints, N of bubbles. Radii are in m/rad (1 for prismatic joints),
distances in m, weights in 1/rad (or 1/m).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from safe_ompl.collision.checker import CollisionChecker
from safe_ompl.common import BoolArray, FloatArray
from safe_ompl.geometry import DISTANCE_ERROR

_TINY = 1e-200
# On the boundary of a bubble contact is possible, so motions stay within this share of the bubble
# (`planning/planners/printed.py`).
INSIDE = 0.99
# Largest motion of a continuous joint in a bubble. At π, both directions back would have the same length.
_HALF_TURN = 3.1  # [rad]


def common_diamond(radii: FloatArray, distances: FloatArray) -> FloatArray:
    """Return the weights (n,) of the paper's bubble: Σ r_i·|Δ_i| < d_c = min_p d_p, eq. (9).

    `radii` (P, n) are the displacement radii of pairs or of bodies at the centre, of which r_i is the largest. The
    distances (P,) at the centre are positive.
    """
    return np.asarray(radii.max(axis=0, initial=0.0) / distances.min(initial=np.inf))


def link_diamond(radii: FloatArray, distances: FloatArray) -> FloatArray:
    """Return the weights (n,) of the largest diamond in the bubble: w_i = max_p R_pi/d_p (`docs/how-it-works.md` §3).

    The diamond contains the paper's bubble (9), because max_p R_pi/d_p ≤ max_p R_pi/min_p d_p. Parameters as for
    `common_diamond`.
    """
    return np.asarray((radii / distances[:, None]).max(axis=0, initial=0.0))


def extents(weights: FloatArray) -> FloatArray:
    """Return the half-axes (n,) of a diamond, 1/w_i; infinite where w_i is zero."""
    return np.divide(1.0, weights, out=np.full_like(weights, np.inf), where=weights > 0)


def reach_along(motion: FloatArray, radii: FloatArray, distances: FloatArray) -> float:
    """Return the largest t for which all motions shorter than t·Δ are in the bubble: min_p d_p / Σ_i R_pi·|Δ_i|.

    The bound is for the whole bubble, not for the diamond within it. Δ is `motion: (n,)`; the other parameters are as
    for `common_diamond`.
    """
    approach = radii @ np.abs(motion)
    reaches = np.divide(distances, approach, out=np.full_like(distances, np.inf), where=approach > 0)
    return float(reaches.min(initial=np.inf))


def diamond_meetings(u: FloatArray, v: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return where N pairs of diamonds meet: gaps (N,) and shares (N, n) in [0, 1] (`docs/how-it-works.md` §3).

    `u` and `v` (N, n) are the weights of the first and of the second diamond times |q₂ − q₁|. The gap is the factor by
    which both diamonds must be scaled to touch, min_s max(Σ u_i s_i, Σ v_i (1 − s_i)): they intersect iff the gap is
    below 1. They then touch at q₁ + s ∘ (q₂ − q₁), which has the same scaled distance from the boundary of each. If s
    is filled in descending order of v_i/u_i, the first sum rises and the second falls as fast as possible; the optimum
    is where they are equal.
    """
    ratios = np.divide(v, u, out=np.full_like(v, np.inf), where=u > 0)
    order = np.argsort(-ratios, axis=1)
    u, v = np.take_along_axis(u, order, 1), np.take_along_axis(v, order, 1)
    # The two sums while coordinate k is filled: u before k, and v from k on. They cross in the last k with before ≤
    # after.
    before = np.cumsum(u, axis=1) - u
    after = np.cumsum(v[:, ::-1], axis=1)[:, ::-1]
    filled = np.clip((after - before) / np.maximum(u + v, _TINY), 0.0, 1.0)
    gaps = np.maximum((u * filled).sum(axis=1), (v * (1.0 - filled)).sum(axis=1))
    shares = np.empty_like(filled)
    np.put_along_axis(shares, order, filled, 1)
    return gaps, shares


def diamonds_may_meet(u: FloatArray, v: FloatArray) -> BoolArray:
    """Return False (N,) only where diamonds do not meet. Σ min(u_i, v_i) is a lower bound of twice the gap."""
    return np.asarray(np.minimum(u, v).sum(axis=1) < 2.0)


@dataclass(frozen=True)
class Bubble:
    """Configurations proven free: {x : Σ weights·|x − q| < 1} around `q: (n,)`.

    The radii (P, n) [m/rad] and the distances (P,) [m] of the pairs are those at the centre.
    """

    q: FloatArray
    weights: FloatArray
    radii: FloatArray
    distances: FloatArray

    @classmethod
    def around(
        cls, q: FloatArray, checker: CollisionChecker, least: float = 0.0, *, printed: bool = False
    ) -> Bubble | None:
        """Return the bubble around `q: (n,)`, or None if the clearance is at most `least` [m].

        With `printed`, the bubble is that of the paper, (9): its radii come from cylinders about the joint axes that
        enclose the links, and bound the motion of every body. Otherwise the radii are those of the pairs, which are no
        larger.
        """
        distances = checker.pair_distances(q) - DISTANCE_ERROR
        if distances.min(initial=np.inf) <= least:
            return None
        radii = checker.pair_radii_at(q)
        if printed:
            weights = common_diamond(checker.robot.bounds.displacement_radii_at(q), distances)
        else:
            weights = link_diamond(radii, distances)
        return cls(q, weights, radii, distances)

    def vertices(self, lower: FloatArray, upper: FloatArray, circular: BoolArray) -> FloatArray:
        """Return the ends (2n, n) of the diamond's axes, clipped to the limits (n,) of non-continuous joints."""
        reaches = INSIDE * extents(self.weights)
        reaches = np.where(circular, np.minimum(reaches, _HALF_TURN), reaches)
        points = np.tile(self.q, (2, len(self.q), 1))
        axes = np.arange(len(self.q))
        points[0, axes, axes] = np.maximum(self.q - reaches, np.where(circular, -np.inf, lower))
        points[1, axes, axes] = np.minimum(self.q + reaches, np.where(circular, np.inf, upper))
        return points.reshape(-1, len(self.q))

    def exit(self, motion: FloatArray) -> FloatArray:
        """Return the point where the line q + `motion: (n,)` leaves the region proven free, or its end."""
        return self.q + min(1.0, INSIDE * reach_along(motion, self.radii, self.distances)) * motion
