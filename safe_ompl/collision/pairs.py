"""Pairs of bodies that may come near each other, reachable pairs of links and obstacles, and margins for each pair."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property

import coal
import numpy as np
import pinocchio as pin

from safe_ompl.collision.bounds import DistanceBounds
from safe_ompl.collision.broad_phase import Queries, indices
from safe_ompl.collision.geometry import PlacedPart
from safe_ompl.common import BoolArray, Changes, Counts, FloatArray, IntArray
from safe_ompl.robot import ReachCylinder, Robot

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


class PairSet:
    """The P pairs of bodies of a robot and a scene that may come nearer to each other than some reach.

    Made by `CollisionChecker.pairs_within`; the checker's `move` alone changes it, and then only places and radii. What
    stands between a user and a proof is checked by `CollisionChecker` and `CertifiedMotion`: here `q` must be a finite
    float array (n,), margins one of (P,).

    Parameters
    ----------
    robot : Robot
        The robot.
    geometry : pin.GeometryModel
        Its bodies and, after them, the parts of the obstacles, with the pairs.
    names : sequence of str
        Link or obstacle of each body.
    obstacle_radii : ndarray, shape (G, m)
        How far each of the G bodies is from the axes of the model's m ≥ n joints at most; infinite for the robot's own.
    counts : Counts
        Counts the queries.
    changes : Changes
        Of the places of obstacles.

    Attributes
    ----------
    geometry : pin.GeometryModel
        As given.
    names : tuple of (str, str)
        Names of the pairs: link and obstacle, or link and link.
    bodies : ndarray of int, shape (P, 2)
        Their indices in the geometry, the smaller one first.
    revision : int
        How often obstacles have moved.
    radii : ndarray, shape (P, n)
        Displacement radii of each pair with obstacles where they are now: while the joints move by Δ, its two bodies
        approach each other by at most Σ_i R_pi·|Δ_i| (`docs/mathematics.md` §3, §4).
    meets_obstacle : ndarray of bool, shape (P,)
        Which pairs are of a link and an obstacle.
    """

    def __init__(
        self,
        robot: Robot,
        geometry: pin.GeometryModel,
        names: Sequence[str],
        obstacle_radii: FloatArray,
        counts: Counts,
        changes: Changes,
    ) -> None:
        pairs, links = indices(geometry), len(robot.bounds.joint_radii)
        self.geometry = geometry
        self.names = tuple((names[a], names[b]) for a, b in pairs)
        self.bodies: IntArray = np.array(pairs, dtype=np.intp).reshape(-1, 2)
        self.meets_obstacle: BoolArray = self.bodies.max(axis=1, initial=-1) >= links
        for array in (self.bodies, self.meets_obstacle):
            array.setflags(write=False)
        self._robot = robot
        self.revision = 0
        self._take_radii(obstacle_radii)
        self._counts = counts
        self.changes = changes
        self._queries = Queries(robot.shared.model, geometry, changes)

    def _take_radii(self, obstacle_radii: FloatArray) -> None:
        self._joint_radii = _pair_radii(self._robot.bounds.joint_radii, self.bodies, obstacle_radii)
        self.radii: FloatArray = self._robot.coupling.radii(self._joint_radii)
        self.radii.setflags(write=False)

    def follow(self, obstacle_radii: FloatArray, measured: Sequence[int]) -> None:
        """Renew what follows from the places of obstacles, which have moved; for `CollisionChecker`.

        Parameters
        ----------
        obstacle_radii : ndarray, shape (G, m)
            As above, for the places that all have now.
        measured : sequence of int
            Bodies whose shapes, or the sizes of these, are others now.
        """
        self._queries.take_shapes(measured)
        self._take_radii(obstacle_radii)
        vars(self).pop("bounds", None)
        self.revision += 1

    def __repr__(self) -> str:
        return f"PairSet({self._robot.name!r}, {len(self.names)} pairs)"

    @cached_property
    def bounds(self) -> DistanceBounds:
        """Lower bounds of the distances of the pairs, which prove most motions without a query."""
        return DistanceBounds(self._robot, self.geometry, self.bodies, self._joint_radii, self._counts)

    def margins(self, obstacles: float, links: float = 0.0) -> FloatArray:
        """Return margins (P,), read-only: one [m] for pairs with an obstacle, one for pairs of two links."""
        margins: FloatArray = np.where(self.meets_obstacle, obstacles, links)
        margins.setflags(write=False)
        return margins

    def within_margins(self, q: FloatArray, margins: FloatArray) -> bool:
        """Return whether any pair is nearer than its margin (P,) [m], ≥ 0, at `q: (n,)`.

        Margins that differ from those of the query before take 2 µs more for 50 to 200 pairs (`bench/motion.py`). That
        they do not is seen at once where they are the same read-only array, and in 0.2 to 0.4 µs otherwise.
        """
        self._counts.margin_queries += 1
        return self._queries.touching(self._robot.pinocchio_configuration(q), margins) is not None

    def pair_within_margins(self, q: FloatArray, margins: FloatArray) -> tuple[str, str] | None:
        """Return the names of a pair that is nearer than its margin (P,) [m] at `q: (n,)`, or None."""
        self._counts.margin_queries += 1
        contacts = self._queries.all_contacts(self._robot.pinocchio_configuration(q), margins)
        return next((self.names[k] for k in np.flatnonzero(contacts).tolist()), None)


def _pair_radii(links: FloatArray, bodies: IntArray, obstacle_radii: FloatArray) -> FloatArray:
    """Return the displacement radii (P, m) of pairs: joints that move both bodies alike do not count."""
    moves = np.zeros_like(obstacle_radii)
    moves[: len(links)] = links
    first, second = moves[bodies[:, 0]], moves[bodies[:, 1]]
    radii = np.where((first > 0) != (second > 0), first + second, 0.0)
    capped: FloatArray = np.minimum(radii, obstacle_radii[bodies[:, 1]])
    return capped
