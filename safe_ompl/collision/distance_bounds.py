"""Proofs of motions by lower bounds of distances, without coal (`safe_ompl.maths.kernels.edge_bounds`)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from safe_ompl.arrays import FloatArray, IntArray
from safe_ompl.collision.queries import DISTANCE_ERROR
from safe_ompl.counts import Counts
from safe_ompl.maths.kernels.edge_bounds import Chain, prove_edge
from safe_ompl.robot.bodies.convex import ConvexBodies
from safe_ompl.robot.robot import Robot

# [m] What is proven is so much farther apart than it must be that coal, which is at most DISTANCE_ERROR off, never calls
# a configuration of the motion nearer than that, and that a certificate of it can be issued. Rounding is far below.
_ALLOWANCE = 2 * DISTANCE_ERROR

_LEAST = 2e-5  # [m] Bodies that move less than this in half of an interval are left to coal.
_NOTHING = np.zeros(0)


@dataclass(frozen=True)
class BoundsProof:
    """What lower bounds of distances prove of an edge.

    Attributes
    ----------
    proven : bool
        Whether the whole edge keeps the distances required.
    at : float or None
        A fraction of the edge where the convex bodies that hold some pair are nearer than required.
    left : ndarray, shape (K, 2)
        Parts of the edge, from one fraction to another, that are not proven.
    """

    proven: bool
    at: float | None
    left: FloatArray

    def covers(self, low: float, high: float) -> bool:
        """Return whether the edge is proven from one fraction to another."""
        return not ((self.left[:, 0] < high) & (self.left[:, 1] > low)).any()


class DistanceBounds:
    """Lower bounds of the distances of pairs of bodies, by the convex bodies that hold them.

    Every bound holds, whatever the configuration. Nothing is kept from one question to the next.

    Parameters
    ----------
    robot : Robot
        The robot.
    geometry : pin.GeometryModel
        Its bodies and, after them, the parts of the obstacles.
    pairs : ndarray of int, shape (P, 2)
        The pairs.
    counts : Counts
        Counts the places at which bounds are looked at.
    """

    def __init__(self, robot: Robot, geometry: pin.GeometryModel, pairs: IntArray, counts: Counts) -> None:
        parts = list(geometry.geometryObjects)
        own = robot.convex_bodies
        self._first_obstacle = len(own.bodies)
        bodies = own.joined(ConvexBodies.of(parts[self._first_obstacle :]))
        self._bodies = bodies.bodies
        self._data = (robot.joint_chain, self._bodies, bodies.starts, bodies.vertices, pairs)
        self._bounded, self._coupling, self._counts = bodies.bounded, robot.coupling, counts

    def place_obstacles(self, geometry: pin.GeometryModel) -> None:
        """Take over where the obstacles of a geometry model with the same bodies are now."""
        for k in range(self._first_obstacle, len(self._bodies)):
            placement = geometry.geometryObjects[k].placement
            self._bodies["rotation"][k] = placement.rotation
            self._bodies["translation"][k] = placement.translation

    def prove(
        self,
        start: FloatArray,
        delta: FloatArray,
        approach: FloatArray,
        required: FloatArray,
        growth: FloatArray | None,
    ) -> BoundsProof | None:
        """Try to prove an edge.

        Parameters
        ----------
        start, delta : ndarray, shape (n,)
            Its start, and the motion to its end.
        approach : ndarray, shape (P,)
            [m] By how much the bodies of each pair approach each other at most, and what they must keep grows.
        required : ndarray, shape (P,)
            [m] What pairs must keep at the start.
        growth : ndarray, shape (P,), optional
            [m] How much more at the end.

        Returns
        -------
        BoundsProof or None
            None where a body has no end.
        """
        if not self._bounded:
            return None
        widest = float(approach.max(initial=0.0))
        proven, at, places, left = prove_edge(
            *self._data,
            self._coupling.values(start),
            self._coupling.motions(delta),
            approach,
            required + _ALLOWANCE,
            _NOTHING if growth is None else growth,
            _LEAST / max(widest, _LEAST),
        )
        self._counts.bound_queries += places
        return BoundsProof(proven, at if at >= 0 else None, left)
