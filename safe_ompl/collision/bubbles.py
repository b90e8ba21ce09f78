"""Bubbles of free configuration space (Lacevic & Rocco 2013, §4.1), each from one distance query.

At a configuration q let every checked pair of bodies p be d_p apart, and approach each other by no more than
Σ_i R_pi·|Δ_i| while the joints move by Δ. Then no motion with Σ_i R_pi·|Δ_i| < d_p for all p ends in contact: this is
the bubble of q. The planners chain diamonds within it,

    B(q) = {x : Σ_i w_i·|x_i − q_i| < 1},     w ≥ 0.

They are convex, so straight motions within one are free.

Where shapes of arrays are given, P counts the pairs, n the joints, N the bubbles. Radii are in m/rad (1 for
prismatic joints), distances in m, weights in 1/rad (or 1/m).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from safe_ompl.collision.checker import CollisionChecker
from safe_ompl.common import BoolArray, FloatArray
from safe_ompl.geometry import DISTANCE_ERROR

_TINY = 1e-200
# Contact is possible on the boundary of a bubble, so motions stay within this share of the bubble
# (`planning/planners/printed.py`).
INSIDE = 0.99
# A joint that wraps goes no farther in a bubble. At π both directions back would be as long.
_HALF_TURN = 3.1  # [rad]


def common_diamond(radii: FloatArray, distances: FloatArray) -> FloatArray:
    """Return the weights (n,) of the paper's bubble: Σ r_i·|Δ_i| < d_c = min_p d_p, eq. (9).

    Displacement radii (P, n) at the centre are of pairs or of bodies: r_i is the largest. Distances (P,) at the centre
    are positive.
    """
    return np.asarray(radii.max(axis=0, initial=0.0) / distances.min(initial=np.inf))


def link_diamond(radii: FloatArray, distances: FloatArray) -> FloatArray:
    """Return the weights (n,) of the largest diamond in the bubble: w_i = max_p R_pi/d_p (`docs/how-it-works.md` §3).

    It holds the paper's (9), because max_p R_pi/d_p ≤ max_p R_pi/min_p d_p. Parameters as for `common_diamond`.
    """
    return np.asarray((radii / distances[:, None]).max(axis=0, initial=0.0))


def extents(weights: FloatArray) -> FloatArray:
    """Return how far (n,) a diamond reaches along each axis, 1/w_i; infinite where nothing limits it."""
    return np.divide(1.0, weights, out=np.full_like(weights, np.inf), where=weights > 0)


def reach_along(motion: FloatArray, radii: FloatArray, distances: FloatArray) -> float:
    """Return the largest t for which all motions shorter than t·Δ are in the bubble: min_p d_p / Σ_i R_pi·|Δ_i|.

    This is the whole bubble, not the diamond within it. Δ is `motion: (n,)`, the rest as for `common_diamond`.
    """
    approach = radii @ np.abs(motion)
    reaches = np.divide(distances, approach, out=np.full_like(distances, np.inf), where=approach > 0)
    return float(reaches.min(initial=np.inf))


def diamond_meetings(u: FloatArray, v: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return how N pairs of diamonds meet: gaps (N,) and shares (N, n) in [0, 1] (`docs/how-it-works.md` §3).

    `u` and `v` (N, n) are the weights of the first and of the second diamond times |q₂ − q₁|. The gap is the factor by
    which both must grow or shrink to touch, min_s max(Σ u_i s_i, Σ v_i (1 − s_i)): they intersect iff it is below 1.
    They then touch at q₁ + s ∘ (q₂ − q₁), which is in both, as far from leaving the one as the other. As s fills up in
    descending order of v_i/u_i, the first sum rises and the second falls as fast as it can; the optimum is where they
    are equal.
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
    return gaps, shares


def diamonds_may_meet(u: FloatArray, v: FloatArray) -> BoolArray:
    """Return False (N,) only where diamonds do not meet: Σ min(u_i, v_i) bounds twice their gap from below."""
    return np.asarray(np.minimum(u, v).sum(axis=1) < 2.0)


@dataclass(frozen=True)
class Bubble:
    """Configurations proven free: {x : Σ weights·|x − q| < 1} around `q: (n,)`.

    The radii (P, n) [m/rad] and the distances (P,) [m] are those of the pairs at the centre.
    """

    q: FloatArray
    weights: FloatArray
    radii: FloatArray
    distances: FloatArray

    @classmethod
    def around(
        cls, q: FloatArray, checker: CollisionChecker, least: float = 0.0, *, printed: bool = False
    ) -> Bubble | None:
        """Return the bubble around `q: (n,)`, or None where the clearance is not more than `least` [m].

        As it is printed, (9), its radii are those of the cylinders about the joints' axes that enclose the links: how
        far every body can move, whatever it may meet. Otherwise they are those of the pairs, which are no larger.
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
        """Return the ends (2n, n) of the diamond's axes, within the limits (n,) of joints that do not wrap."""
        reaches = INSIDE * extents(self.weights)
        reaches = np.where(circular, np.minimum(reaches, _HALF_TURN), reaches)
        points = np.tile(self.q, (2, len(self.q), 1))
        axes = np.arange(len(self.q))
        points[0, axes, axes] = np.maximum(self.q - reaches, np.where(circular, -np.inf, lower))
        points[1, axes, axes] = np.minimum(self.q + reaches, np.where(circular, np.inf, upper))
        return points.reshape(-1, len(self.q))

    def exit(self, motion: FloatArray) -> FloatArray:
        """Return where the way q + `motion: (n,)` leaves what the distances prove free, or its end."""
        return self.q + min(1.0, INSIDE * reach_along(motion, self.radii, self.distances)) * motion
