"""Collision, margin and distance queries between a robot and a scene."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from math import ceil, log2

import coal
import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from safe_ompl.arrays import FloatArray
from safe_ompl.collision.arguments import configuration, margins_of
from safe_ompl.collision.pairs import PairSet
from safe_ompl.collision.queries import DISTANCE_ERROR as DISTANCE_ERROR
from safe_ompl.collision.queries import Queries, indices, prove_manager
from safe_ompl.collision.queries import fresh_data as fresh_data
from safe_ompl.counts import Counts
from safe_ompl.robot.bodies.reach import bounding_hull
from safe_ompl.robot.robot import Robot
from safe_ompl.scene.scene import Scene

_REACH = 0.05  # [m]


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
    """Answers whether, how nearly, and with what a robot touches a scene or itself. It never changes.

    Checked are the robot's own pairs (`robot.collision_model`) and every moving body against every obstacle; the
    fixed base may stand on obstacles. A pair whose body provably never reaches the obstacle, within the limits of the
    joints that slide, is left out of the collision queries. One checker serves one thread.

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
    pairs : PairSet
        The P pairs that may touch.
    links : tuple of str
        The link of each of the robot's bodies.
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
        self.links = tuple(self._names[: len(bodies.geometryObjects)])

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
        prove_manager(robot, self._contact, 0.0)
        self._pair_sets: dict[int, PairSet] = {}
        self.pairs = self.pairs_within(0.0)

    def __repr__(self) -> str:
        obstacles, pairs = len(self.scene.obstacles), len(self.pair_names)
        return f"CollisionChecker({self.robot.name!r}, {obstacles} obstacles, {pairs} pairs)"

    # ---------------------------------------------------------------------------------------------------- pairs

    @property
    def pair_names(self) -> tuple[tuple[str, str], ...]:
        """Names of the P pairs that may touch: link and obstacle, or link and link."""
        return self.pairs.names

    @property
    def pair_radii(self) -> FloatArray:
        """Displacement radii (P, n) of the pairs that may touch; see `PairSet.radii`."""
        return self.pairs.radii

    @property
    def geometry(self) -> pin.GeometryModel:
        """Bodies of the robot and parts of the obstacles, with the P pairs that may touch."""
        return self.pairs.geometry

    def pairs_within(self, reach: float) -> PairSet:
        """Return the pairs that may touch and, after them, all that may come nearer than a reach [m].

        Reaches are rounded up to 50 mm and its doublings: no pair more than twice as far comes in, and no more than
        a few sets are ever made. Each is made once.
        """
        level = 0.0 if reach <= 0 else _REACH * 2.0 ** max(0, ceil(log2(reach / _REACH)))
        beyond = [
            pair
            for pair, least in zip(self._apart_pairs, self._never_nearer, strict=True)
            if DISTANCE_ERROR <= least < level + DISTANCE_ERROR
        ]
        if len(beyond) not in self._pair_sets:
            geometry = self._touching.copy()
            for body, obstacle in beyond:
                geometry.addCollisionPair(pin.CollisionPair(body, obstacle))
            self._pair_sets[len(beyond)] = PairSet(
                self.robot, geometry, self._names, self._obstacle_radii, self.counts
            )
        return self._pair_sets[len(beyond)]

    @cached_property
    def _obstacle_radii(self) -> FloatArray:
        """How far each obstacle is from the joints' axes at most; infinite for the robot's own bodies (G, m)."""
        distances = np.full((len(self._touching.geometryObjects), self.robot.joint_radii.shape[1]), np.inf)
        for k, part in list(enumerate(self._touching.geometryObjects))[len(self.links) :]:
            hull = bounding_hull(part.geometry).moved(part.placement)
            distances[k] = self.robot.shared.chain.axis_distances(hull)
        return distances

    # -------------------------------------------------------------------------------------------------- queries

    def in_collision(self, q: ArrayLike) -> bool:
        """Return whether the robot touches an obstacle or itself at `q: (n,)`; limits are not looked at.

        Raises
        ------
        InputError
            If `q` has the wrong shape or is not finite; so do the other queries.
        """
        return self.touches(configuration(q, self.robot.n))

    def touches(self, q: FloatArray) -> bool:
        """Return the same as `in_collision` for a float array (n,) that is known to be finite: nothing is checked."""
        self.counts.collision_queries += 1
        return self._contact.touches(self.robot.pinocchio_configuration(q), self._contact.no_margins)

    def colliding_pair(self, q: ArrayLike) -> tuple[str, str] | None:
        """Return the names of a pair in contact at `q: (n,)`, or None."""
        full = self.robot.pinocchio_configuration(configuration(q, self.robot.n))
        self.counts.collision_queries += 1
        contacts = self._contact.all_contacts(full, self._contact.no_margins)
        return next((self.pair_names[k] for k in np.flatnonzero(contacts).tolist()), None)

    def within_margins(self, q: ArrayLike, margins: ArrayLike) -> bool:
        """Return whether any pair that may touch is nearer than its margin (P,) [m], ≥ 0, at `q: (n,)`.

        Margins may be one number for all. Of pairs that never touch, but come near, `pairs_within` knows.
        """
        pairs = self.pairs
        return pairs.within_margins(configuration(q, self.robot.n), margins_of(margins, len(pairs.names)))

    def pair_within_margins(self, q: ArrayLike, margins: ArrayLike) -> tuple[str, str] | None:
        """Return the names of a pair that is nearer than its margin at `q: (n,)`, or None; see `within_margins`."""
        pairs = self.pairs
        return pairs.pair_within_margins(
            configuration(q, self.robot.n), margins_of(margins, len(pairs.names))
        )

    def distances(self, q: ArrayLike) -> FloatArray:
        """Return the distance [m] of every moving body to every obstacle at `q: (n,)`; see `distance_names`."""
        full = self.robot.pinocchio_configuration(configuration(q, self.robot.n))
        self.counts.distance_queries += 1
        pin.computeDistances(self.robot.shared.model, self._distance_data, self._apart, self._distances, full)
        return np.array([result.min_distance for result in self._distances.distanceResults])

    def pair_distances(self, q: ArrayLike) -> FloatArray:
        """Return the distance (P,) [m] of the pairs that may touch at `q: (n,)`, the robot's own pairs included."""
        full = self.robot.pinocchio_configuration(configuration(q, self.robot.n))
        self.counts.distance_queries += 1
        pin.computeDistances(
            self.robot.shared.model, self._distance_data, self._touching, self._pair_distances, full
        )
        return np.array([result.min_distance for result in self._pair_results])

    def pair_radii_at(self, q: ArrayLike) -> FloatArray:
        """Return the displacement radii (P, n) of the pairs that may touch at `q: (n,)`: tighter, and dearer.

        They hold for motions that start at `q` (`docs/mathematics.md` §3).
        """
        bodies = np.zeros((len(self._touching.geometryObjects), self.robot.n))
        bodies[: len(self.links)] = self.robot.displacement_radii_at(configuration(q, self.robot.n))
        first, second = self.pairs.bodies.T
        both: FloatArray = bodies[first] + bodies[second]
        return np.minimum(both, self.pairs.radii)

    @property
    def distance_names(self) -> list[tuple[str, str]]:
        """Link and obstacle of each entry of `distances`."""
        return [(self._names[a], self._names[b]) for a, b in self._apart_pairs]

    def clearance(self, q: ArrayLike) -> Clearance:
        """Return the smallest distance between robot and obstacles at `q: (n,)`, and between which two."""
        distances = self.distances(q)
        if not len(distances):
            return Clearance(float("inf"), None, None)
        nearest = int(distances.argmin())
        body, obstacle = self._apart_pairs[nearest]
        return Clearance(float(distances[nearest]), self._names[body], self._names[obstacle])


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
