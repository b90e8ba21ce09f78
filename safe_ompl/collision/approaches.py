"""How near the bodies of a robot can ever come to obstacles that stand: which pairs are worth checking."""

from __future__ import annotations

from collections.abc import Sequence

import coal
import numpy as np
import pinocchio as pin

from safe_ompl.arrays import BoolArray, FloatArray
from safe_ompl.collision.placed_bodies import PlacedPart
from safe_ompl.robot.bodies.reach import ReachCylinder

_ROUNDING = 1e-9  # [m] of what bounds by balls say
_HOLLOW = (coal.BVHModelBase, coal.OcTree)


class Approaches:
    """Says which of M bodies can come nearer to which of K parts of obstacles than some distance.

    Bounds by balls decide most of it; coal decides the rest, once, when it is asked for.

    Parameters
    ----------
    reaches : sequence of ReachCylinder
        A cylinder in the world for each body, that it never leaves.
    parts : sequence of PlacedPart
        The parts of obstacles.
    movable : ndarray of bool, shape (K,)
        Which of them may be anywhere: every body can come to them.
    """

    def __init__(
        self, reaches: Sequence[ReachCylinder], parts: Sequence[PlacedPart], movable: BoolArray
    ) -> None:
        self._reaches = [_as_object(reach) for reach in reaches]
        self._parts = parts
        centres, radii = _balls(parts)
        away = _distances(reaches, centres)
        self._least = np.where(movable[:, None], -np.inf, away - radii[:, None] - _ROUNDING)
        hollow = np.array([isinstance(part.shape, _HOLLOW) for part in parts], dtype=bool)
        far = np.where(hollow, radii, 0.0)  # the centre of any other is in it
        self._most = np.where(movable[:, None], -np.inf, away + far[:, None] + _ROUNDING)

    def nearer_than(self, distance: float) -> BoolArray:
        """Return for each part and each body (K, M) whether the two can come nearer than a distance [m]."""
        for k, m in np.argwhere((self._least < distance) & (self._most >= distance)).tolist():
            self._least[k, m] = self._most[k, m] = _distance(self._reaches[m], self._parts[k])
        nearer: BoolArray = self._least < distance
        return nearer


def _balls(parts: Sequence[PlacedPart]) -> tuple[FloatArray, FloatArray]:
    """Return centres (K, 3) and radii (K,) of balls that hold the parts [m]."""
    hulls = [part.hull for part in parts]
    centres = np.array([hull.points.mean(axis=0) for hull in hulls]).reshape(-1, 3)
    radii = [
        np.linalg.norm(hull.points - centre, axis=1).max() + hull.radius
        for hull, centre in zip(hulls, centres, strict=True)
    ]
    return centres, np.array(radii)


def _distances(reaches: Sequence[ReachCylinder], points: FloatArray) -> FloatArray:
    """Return the distances (K, M) [m] of points (K, 3) from M cylinders; 0 inside."""
    if not reaches:
        return np.zeros((len(points), 0))
    axes = np.array([reach.axis for reach in reaches])
    arms = points[:, None] - np.array([reach.center for reach in reaches])
    along = np.einsum("kmx,mx->km", arms, axes)
    lateral = np.linalg.norm(arms - along[..., None] * axes, axis=2)
    beside = np.maximum(0.0, lateral - [reach.radius for reach in reaches])
    beyond = np.maximum(0.0, np.abs(along) - [reach.half_length for reach in reaches])
    distances: FloatArray = np.hypot(beside, beyond)
    return distances


def _as_object(reach: ReachCylinder) -> coal.CollisionObject:
    rotation = pin.Quaternion.FromTwoVectors(np.array([0.0, 0.0, 1.0]), reach.axis).matrix()
    return coal.CollisionObject(coal.Cylinder(reach.radius, 2 * reach.half_length), rotation, reach.center)


def _distance(reach: coal.CollisionObject, part: PlacedPart) -> float:
    place = coal.Transform3s(part.world.rotation, part.world.translation)
    request, result = coal.DistanceRequest(), coal.DistanceResult()
    shape = reach.collisionGeometry()
    return float(coal.distance(shape, reach.getTransform(), part.shape, place, request, result))
