"""Collision, margin and distance queries between a robot and a scene."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import coal
import numpy as np
import pinocchio as pin

from safe_ompl.arrays import BoolArray, FloatArray, IntArray
from safe_ompl.collision.min_clearance import MinClearance
from safe_ompl.collision.queries import DISTANCE_ERROR as DISTANCE_ERROR
from safe_ompl.collision.queries import Queries, indices, prove_manager
from safe_ompl.collision.queries import fresh_data as fresh_data
from safe_ompl.counts import Counts
from safe_ompl.robot.displacement import bounding_hull
from safe_ompl.robot.robot import Robot
from safe_ompl.scene.scene import Scene

_PROOF_MARGIN = 0.02  # [m]


@dataclass(frozen=True)
class Clearance:
    """The smallest distance between the robot and the obstacles at one configuration.

    Attributes
    ----------
    distance : float
        [m]; zero or negative in contact, infinity where there is no obstacle.
    link : str or None
        Link that is nearest.
    obstacle : str or None
        Obstacle that is nearest.
    """

    distance: float
    link: str | None
    obstacle: str | None


class CollisionChecker:
    """Answers whether, how nearly, and with what a robot touches a scene or itself.

    Checked are the robot's own pairs (`robot.collision_model`) and every moving body against every obstacle; the
    fixed base may stand on obstacles. A pair whose body provably never reaches the obstacle is left out of the
    collision queries. One checker serves one thread.

    Parameters
    ----------
    robot : Robot
        The robot.
    scene : Scene
        The obstacles.
    counts : Counts, optional
        Counters to share with other models.

    Attributes
    ----------
    geometry : pin.GeometryModel
        Bodies of the robot and parts of the obstacles, with the P pairs of them that are checked.
    pair_names : tuple of (str, str)
        Names of the P checked pairs: link and obstacle, or link and link.
    pair_radii : ndarray, shape (P, n)
        Displacement radii of each pair: while the joints move by Δ, its two bodies approach each other by at most
        Σ_i R_pi·|Δ_i| (`math.md` §3, §4).
    meets_obstacle : ndarray of bool, shape (P,)
        Which pairs are of a link and an obstacle.
    required : ndarray, shape (P,)
        What each pair must keep by `setMinClearance` [m]; 0 where touching is all that is forbidden.
    """

    def __init__(self, robot: Robot, scene: Scene, counts: Counts | None = None) -> None:
        self.robot = robot
        self.scene = scene
        self.counts = Counts() if counts is None else counts
        bodies = robot.shared.collision_model
        geometry, self._names = _with_obstacles(bodies, scene)
        obstacles = range(len(bodies.geometryObjects), len(geometry.geometryObjects))
        moving = {
            k: _reach(robot, body) for k, body in enumerate(bodies.geometryObjects) if body.parentJoint != 0
        }

        self._apart = geometry.copy()
        self._apart.removeAllCollisionPairs()
        self._never_nearer: list[float] = []  # [m] than this do the bodies of each of these pairs come
        for obstacle in obstacles:
            for body, reach in moving.items():
                self._apart.addCollisionPair(pin.CollisionPair(body, obstacle))
                self._never_nearer.append(_least_distance(reach, geometry.geometryObjects[obstacle]))
        self._apart_pairs = indices(self._apart)
        self._distances = fresh_data(self._apart)
        self._distance_data = robot.shared.model.createData()
        self._touching = geometry.copy()  # with the pairs that may touch
        for (body, obstacle), least in zip(self._apart_pairs, self._never_nearer, strict=True):
            if least < DISTANCE_ERROR:
                self._touching.addCollisionPair(pin.CollisionPair(body, obstacle))
        self._pair_distances = fresh_data(self._touching)
        self._pair_results = list(self._pair_distances.distanceResults)
        self._contact = Queries(robot.shared.model, self._touching, len(obstacles))
        prove_manager(robot, self._contact)
        self._links = self._names[: len(bodies.geometryObjects)]
        self._min_clearance: MinClearance | None = None
        self._take_pairs(0.0)

    def _take_pairs(self, clearance: float) -> None:
        """Take the pairs that may touch and, after them, those that may come nearer than a clearance [m]."""
        self._covered = clearance
        geometry = self._touching.copy()
        for (body, obstacle), least in zip(self._apart_pairs, self._never_nearer, strict=True):
            if DISTANCE_ERROR <= least < clearance + DISTANCE_ERROR:
                geometry.addCollisionPair(pin.CollisionPair(body, obstacle))

        self.geometry = geometry
        pairs = indices(geometry)
        self.pair_names = tuple((self._names[a], self._names[b]) for a, b in pairs)
        self._pairs: IntArray = np.array(pairs, dtype=np.intp).reshape(-1, 2)
        self.pair_radii: FloatArray = self._pair_radii()
        self.meets_obstacle: BoolArray = self._pairs.max(axis=1, initial=-1) >= len(self._links)
        self.required: FloatArray = self._required()
        self._margin = Queries(
            self.robot.shared.model, geometry, len(geometry.geometryObjects) - len(self._links)
        )
        self._margin.set_margins(np.full(len(pairs), _PROOF_MARGIN))
        prove_manager(self.robot, self._margin)

    def __repr__(self) -> str:
        obstacles, pairs = len(self.scene.obstacles), len(self.pair_names)
        return f"CollisionChecker({self.robot.name!r}, {obstacles} obstacles, {pairs} pairs)"

    def cover(self, clearance: float) -> None:
        """Take in the pairs that were left out because they never touch, if they may come nearer than this [m]."""
        if clearance > self._covered:
            if any(self._covered <= least - DISTANCE_ERROR < clearance for least in self._never_nearer):
                self._take_pairs(clearance)
            self._covered = clearance

    def setMinClearance(
        self,
        distance: float,
        obstacles: Sequence[str] | None = None,
        exempt: Sequence[tuple[str, str]] = (),
    ) -> None:
        """Require that the robot keeps a distance; `CertifiedMotion` proves it along whole motions.

        Parameters
        ----------
        distance : float
            [m] 0 requires nothing.
        obstacles : sequence of str, optional
            Keep it from these; default: from those with a danger weight, such as people.
        exempt : sequence of (str, str), optional
            Pairs of a link and an obstacle that need not keep it, only not touch.

        Raises
        ------
        InputError
            If the distance is not a finite number ≥ 0, or there is nothing to keep it from.
        UnknownNameError
            If there is no such obstacle or link.
        """
        self.require(MinClearance.of(distance, obstacles, exempt, self.scene, self._links))

    def require(self, wanted: MinClearance | None) -> None:
        """Require what `getMinClearance` has returned; None requires nothing."""
        self._min_clearance = wanted
        self.cover(0.0 if wanted is None else wanted.distance)
        self.required = self._required()

    def getMinClearance(self) -> MinClearance | None:
        """Return what `setMinClearance` requires; None where nothing is required."""
        return self._min_clearance

    def _pair_radii(self) -> FloatArray:
        """Displacement radii (P, n) of the pairs: joints that move both bodies alike do not count."""
        bodies = self.robot.joint_radii
        moves = np.vstack(
            [bodies, np.zeros((len(self.geometry.geometryObjects) - len(bodies), bodies.shape[1]))]
        )
        first, second = moves[self._pairs[:, 0]], moves[self._pairs[:, 1]]
        radii = np.where((first > 0) != (second > 0), first + second, 0.0)
        return self.robot.coupling.radii(np.minimum(radii, self._obstacle_radii[self._pairs[:, 1]]))

    @cached_property
    def _obstacle_radii(self) -> FloatArray:
        """How far each obstacle is from the joints' axes at most; infinite for the robot's own bodies (G, n)."""
        distances = np.full((len(self._touching.geometryObjects), self.robot.joint_radii.shape[1]), np.inf)
        for k, part in list(enumerate(self._touching.geometryObjects))[len(self._links) :]:
            hull = bounding_hull(part.geometry).moved(part.placement)
            distances[k] = self.robot.shared.chain.axis_distances(hull)
        return distances

    def _required(self) -> FloatArray:
        wanted = self._min_clearance
        if wanted is None:
            return np.zeros(len(self.pair_names))
        return np.where(self.meets_obstacle, [wanted.between(*pair) for pair in self.pair_names], 0.0)

    def too_near(self, q: FloatArray) -> bool:
        """Return whether the robot touches something at `q: (n,)`, or comes nearer than `setMinClearance` allows."""
        if self.in_collision(q):
            return True
        if self._min_clearance is None:
            return False
        self.set_margins(self.required)
        return self.within_margins(q)

    def pair_within_margins(self, q: FloatArray) -> tuple[str, str] | None:
        """Return the names of a pair that is nearer than its margin at `q: (n,)`, or None."""
        self.counts.margin_queries += 1
        return self._named_contact(self._margin, q)

    def in_collision(self, q: FloatArray) -> bool:
        """Return whether the robot touches an obstacle or itself at `q: (n,)`; limits are not looked at."""
        self.counts.collision_queries += 1
        return self._contact.touches(self.robot.pinocchio_configuration(q))

    def colliding_pair(self, q: FloatArray) -> tuple[str, str] | None:
        """Return the names of a pair in contact at `q: (n,)`, or None."""
        self.counts.collision_queries += 1
        return self._named_contact(self._contact, q)

    def set_margins(self, margins: FloatArray) -> None:
        """Set the security margin (P,) [m], ≥ 0, of every pair for the next calls of `within_margins`."""
        self._margin.set_margins(margins)

    def within_margins(self, q: FloatArray) -> bool:
        """Return whether any pair is nearer than its margin at `q: (n,)`."""
        self.counts.margin_queries += 1
        return self._margin.touches(self.robot.pinocchio_configuration(q))

    def distances(self, q: FloatArray) -> FloatArray:
        """Return the distance [m] of every moving body to every obstacle at `q: (n,)`; see `distance_names`."""
        self.counts.distance_queries += 1
        pin.computeDistances(
            self.robot.shared.model,
            self._distance_data,
            self._apart,
            self._distances,
            self.robot.pinocchio_configuration(q),
        )
        return np.array([result.min_distance for result in self._distances.distanceResults])

    def pair_distances(self, q: FloatArray) -> FloatArray:
        """Return the distance (T,) [m] of the pairs that may touch at `q: (n,)`, the robot's own pairs included.

        They are the first T of the P pairs; of which the others come into view with a clearance only (`cover`).
        """
        self.counts.distance_queries += 1
        pin.computeDistances(
            self.robot.shared.model,
            self._distance_data,
            self._touching,
            self._pair_distances,
            self.robot.pinocchio_configuration(q),
        )
        return np.array([result.min_distance for result in self._pair_results])

    def pair_radii_at(self, q: FloatArray) -> FloatArray:
        """Return the displacement radii (T, n) of the pairs of `pair_distances` at `q: (n,)`: tighter, and dearer.

        They hold for motions that start at `q` (`math.md` §3).
        """
        bodies = np.zeros((len(self.geometry.geometryObjects), self.robot.n))
        radii = self.robot.displacement_radii_at(q)
        bodies[: len(radii)] = radii
        touching = len(self._pair_results)
        first, second = self._pairs[:touching].T
        both: FloatArray = bodies[first] + bodies[second]
        return np.minimum(both, self.pair_radii[:touching])

    @property
    def distance_names(self) -> list[tuple[str, str]]:
        """Link and obstacle of each entry of `distances`."""
        return [(self._names[a], self._names[b]) for a, b in self._apart_pairs]

    def clearance(self, q: FloatArray) -> Clearance:
        """Return the smallest distance between robot and obstacles at `q: (n,)`, and between which two."""
        distances = self.distances(q)
        if not len(distances):
            return Clearance(float("inf"), None, None)
        nearest = int(distances.argmin())
        body, obstacle = self._apart_pairs[nearest]
        return Clearance(float(distances[nearest]), self._names[body], self._names[obstacle])

    def _named_contact(self, queries: Queries, q: FloatArray) -> tuple[str, str] | None:
        results = queries.all_contacts(self.robot.pinocchio_configuration(q))
        touching = np.flatnonzero(results)
        return self.pair_names[int(touching[0])] if len(touching) else None


def _with_obstacles(bodies: pin.GeometryModel, scene: Scene) -> tuple[pin.GeometryModel, list[str]]:
    """Return a copy of the robot's bodies with the obstacles added, and a name for each of them."""
    geometry = bodies.copy()
    names = [body.name.rsplit("_", 1)[0] for body in bodies.geometryObjects]
    for obstacle in scene.obstacles:
        for name, shape, placement in obstacle.geometries():
            geometry.addGeometryObject(pin.GeometryObject(f"obstacle:{name}", 0, placement, shape))
            names.append(obstacle.name)
    return geometry, names


def _reach(robot: Robot, body: pin.GeometryObject) -> coal.CollisionObject:
    """Return a cylinder in the world that a moving body never leaves."""
    reach = robot.shared.chain.reach(body.parentJoint, bounding_hull(body.geometry).moved(body.placement))
    rotation = pin.Quaternion.FromTwoVectors(np.array([0.0, 0.0, 1.0]), reach.axis).matrix()
    return coal.CollisionObject(coal.Cylinder(reach.radius, 2 * reach.half_length), rotation, reach.center)


def _least_distance(reach: coal.CollisionObject, obstacle: pin.GeometryObject) -> float:
    """Return the distance [m] that a body with this reach keeps from an obstacle at least, whatever the joints do."""
    place = coal.Transform3s(obstacle.placement.rotation, obstacle.placement.translation)
    distance = coal.distance(
        reach.collisionGeometry(),
        reach.getTransform(),
        obstacle.geometry,
        place,
        coal.DistanceRequest(),
        coal.DistanceResult(),
    )
    return float(distance)
