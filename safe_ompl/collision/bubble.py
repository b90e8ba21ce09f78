"""A bubble of free configurations around one, from one distance query (Lacevic & Rocco 2013, §4.1)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from safe_ompl.arrays import BoolArray, FloatArray
from safe_ompl.collision.checker import DISTANCE_ERROR, CollisionChecker
from safe_ompl.maths import bubbles

INSIDE = 0.99  # the boundary of a bubble may touch: stay this much inside (`docs/mathematics.md` §2)
_HALF_TURN = 3.1  # [rad] as far as a joint that wraps goes: at π both ways back are the same


@dataclass(frozen=True)
class Bubble:
    """Configurations proven free: all those that lie within the shape around `q`.

    Attributes
    ----------
    q : ndarray, shape (n,)
        The centre.
    weights : ndarray, shape (n,)
        The shape is {x : ‖weights ∘ (x − q)‖ < 1}, see `safe_ompl.maths.bubbles`.
    radii : ndarray, shape (P, n)
        Displacement radii of the pairs at the centre [m/rad].
    distances : ndarray, shape (P,)
        Their distances [m].
    """

    q: FloatArray
    weights: FloatArray
    radii: FloatArray
    distances: FloatArray

    @classmethod
    def around(
        cls, q: FloatArray, checker: CollisionChecker, shape: str, least: float = 0.0
    ) -> Bubble | None:
        """Return the bubble around `q: (n,)`, or None where the clearance is not more than `least` [m].

        Parameters
        ----------
        q : ndarray, shape (n,)
            Configuration.
        checker : CollisionChecker
            Gives distances of all checked pairs, the robot's own included, and their radii at `q`.
        shape : str
            One of `safe_ompl.maths.bubbles.BUBBLE_SHAPES`.
        least : float
            [m]
        """
        distances = checker.pair_distances(q) - DISTANCE_ERROR
        if distances.min(initial=np.inf) <= least:
            return None
        radii, form = checker.pair_radii_at(q), bubbles.BUBBLE_SHAPES[shape]
        own = checker.robot.bounds.displacement_radii_at(q) if form.enclosing else radii
        return cls(q, form.weights(own, distances), radii, distances)

    def vertices(self, lower: FloatArray, upper: FloatArray, circular: BoolArray) -> FloatArray:
        """Return the ends (2n, n) of the shape's axes, within the limits (n,) of joints that do not wrap."""
        reaches = INSIDE * bubbles.extents(self.weights)
        return bubbles.axis_points(
            self.q,
            np.where(circular, np.minimum(reaches, _HALF_TURN), reaches),
            np.where(circular, -np.inf, lower),
            np.where(circular, np.inf, upper),
        )

    def exit(self, motion: FloatArray) -> FloatArray:
        """Return where the way q + `motion: (n,)` leaves what the distances prove free, or its end."""
        return self.q + min(1.0, INSIDE * bubbles.reach_along(motion, self.radii, self.distances)) * motion
