"""Collision, margin and distance queries between a robot and a scene."""

from __future__ import annotations

import logging
import warnings
from dataclasses import dataclass

import coal
import numpy as np
import pinocchio as pin

from safe_ompl.arrays import BoolArray, FloatArray, IntArray
from safe_ompl.models.convex import sample_configurations
from safe_ompl.models.counts import Counts
from safe_ompl.models.displacement import bounding_hull
from safe_ompl.models.robot import Robot
from safe_ompl.models.scene import Scene

_log = logging.getLogger(__name__)

_MANY_OBSTACLES = 100  # from here on the sweep-and-prune manager beats the naive one
_PROOF_SAMPLES = 100
_PROOF_MARGIN = 0.02  # [m]
DISTANCE_ERROR = 1e-5  # [m]; coal's iterative distances are at most this far off


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
    """

    def __init__(self, robot: Robot, scene: Scene, counts: Counts | None = None) -> None:
        self.robot = robot
        self.scene = scene
        self.counts = Counts() if counts is None else counts
        bodies = robot.collision_model
        geometry, self._names = _with_obstacles(bodies, scene)
        obstacles = range(len(bodies.geometryObjects), len(geometry.geometryObjects))
        moving = {
            k: _reach(robot, body) for k, body in enumerate(bodies.geometryObjects) if body.parentJoint != 0
        }

        self._apart = geometry.copy()
        self._apart.removeAllCollisionPairs()
        for obstacle in obstacles:
            for body, reach in moving.items():
                pair = pin.CollisionPair(body, obstacle)
                self._apart.addCollisionPair(pair)
                if _can_meet(reach, geometry.geometryObjects[obstacle]):
                    geometry.addCollisionPair(pair)
        self._apart_pairs = _indices(self._apart)
        self._distances = _fresh_data(self._apart)
        self._distance_data = robot.model.createData()

        self.geometry = geometry
        pairs = _indices(geometry)
        self.pair_names = tuple((self._names[a], self._names[b]) for a, b in pairs)
        self._pairs: IntArray = np.array(pairs, dtype=np.intp).reshape(-1, 2)
        self.pair_radii: FloatArray = _pair_radii(robot, self._pairs)
        self._pair_distances = _fresh_data(geometry)
        self._pair_results = list(self._pair_distances.distanceResults)
        self._contact = _Queries(robot.model, geometry, len(obstacles))
        self._margin = _Queries(robot.model, geometry, len(obstacles))
        self._margin.set_margins(np.full(len(pairs), _PROOF_MARGIN))
        for queries in (self._contact, self._margin):
            _prove_manager(robot, queries)

    def __repr__(self) -> str:
        obstacles, pairs = len(self.scene.obstacles), len(self.pair_names)
        return f"CollisionChecker({self.robot.name!r}, {obstacles} obstacles, {pairs} pairs)"

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
            self.robot.model,
            self._distance_data,
            self._apart,
            self._distances,
            self.robot.pinocchio_configuration(q),
        )
        return np.array([result.min_distance for result in self._distances.distanceResults])

    def pair_distances(self, q: FloatArray) -> FloatArray:
        """Return the distance (P,) [m] of every checked pair at `q: (n,)`, the robot's own pairs included."""
        self.counts.distance_queries += 1
        pin.computeDistances(
            self.robot.model,
            self._distance_data,
            self.geometry,
            self._pair_distances,
            self.robot.pinocchio_configuration(q),
        )
        return np.array([result.min_distance for result in self._pair_results])

    def pair_radii_at(self, q: FloatArray) -> FloatArray:
        """Return the displacement radii (P, n) of the pairs at `q: (n,)`; tighter than `pair_radii`, and dearer.

        They hold for motions that start at `q` (`math.md` §3).
        """
        bodies = np.zeros((len(self.geometry.geometryObjects), self.robot.n))
        radii = self.robot.displacement_radii_at(q)
        bodies[: len(radii)] = radii
        first, second = self._pairs.T
        both: FloatArray = bodies[first] + bodies[second]
        return np.where(self.pair_radii > 0, both, 0.0)

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

    def _named_contact(self, queries: _Queries, q: FloatArray) -> tuple[str, str] | None:
        results = queries.all_contacts(self.robot.pinocchio_configuration(q))
        touching = np.flatnonzero(results)
        return self.pair_names[int(touching[0])] if len(touching) else None


class _Queries:
    """Boolean queries over the pairs of one geometry model, with their own working memory.

    Pinocchio's broad-phase manager does not keep alive what it looks at; this object does.
    """

    def __init__(self, model: pin.Model, geometry: pin.GeometryModel, obstacles: int) -> None:
        self.model = model
        self.geometry = geometry
        self.kinematics = model.createData()
        self.data = _fresh_data(geometry)
        # Pinocchio takes margins as a matrix over bodies; writing it is ten times faster than request by request.
        bodies = len(geometry.geometryObjects)
        self._margins: FloatArray = np.zeros((bodies, bodies), order="F")
        self._margin_entries: FloatArray = self._margins.reshape(-1, order="F")  # a view
        self._entries = np.array([a + bodies * b for a, b in _indices(geometry)], dtype=np.intp)
        self.set_margins(np.zeros(len(self._entries)))
        kind = (
            pin.BroadPhaseManager_SSaPCollisionManager
            if obstacles > _MANY_OBSTACLES
            else pin.BroadPhaseManager_NaiveCollisionManager
        )
        self.manager = kind(model, geometry, self.data)
        self.use_manager = True

    def set_margins(self, margins: FloatArray) -> None:
        # With a margin of zero coal takes bodies that overlap, now and then by centimetres, for a micrometre
        # apart, and calls them free: what is nearer than it can tell counts as touching.
        self._margin_entries[self._entries] = margins + DISTANCE_ERROR
        self.data.setSecurityMargins(self.geometry, self._margins, True, False)

    def touches(self, q: FloatArray) -> bool:
        if self.use_manager:
            return bool(pin.computeCollisions(self.model, self.kinematics, self.manager, q, True))
        return self.touches_plainly(q)

    def touches_plainly(self, q: FloatArray) -> bool:
        return bool(pin.computeCollisions(self.model, self.kinematics, self.geometry, self.data, q, True))

    def all_contacts(self, q: FloatArray) -> BoolArray:
        pin.computeCollisions(self.model, self.kinematics, self.geometry, self.data, q, False)
        return np.array([result.isCollision() for result in self.data.collisionResults], dtype=bool)


def _fresh_data(geometry: pin.GeometryModel) -> pin.GeometryData:
    """Return working memory in which a query does not start from the result of the one before.

    That would change distances by micrometres, and with them, now and then, what a planner finds with the same seed.
    """
    data = pin.GeometryData(geometry)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # in favour of an option that Pinocchio overrides
        for request in (*data.collisionRequests, *data.distanceRequests):
            request.enable_cached_gjk_guess = False
    return data


def _indices(geometry: pin.GeometryModel) -> list[tuple[int, int]]:
    """Return the two bodies of each pair, the first one with the smaller index."""
    return [(int(pair.first), int(pair.second)) for pair in geometry.collisionPairs]


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
    reach = robot.chain.reach(body.parentJoint, bounding_hull(body.geometry).moved(body.placement))
    rotation = pin.Quaternion.FromTwoVectors(np.array([0.0, 0.0, 1.0]), reach.axis).matrix()
    return coal.CollisionObject(coal.Cylinder(reach.radius, 2 * reach.half_length), rotation, reach.center)


def _can_meet(reach: coal.CollisionObject, obstacle: pin.GeometryObject) -> bool:
    """Return False only if a body with this reach provably never touches the obstacle, whatever the joints do."""
    place = coal.Transform3s(obstacle.placement.rotation, obstacle.placement.translation)
    distance = coal.distance(
        reach.collisionGeometry(),
        reach.getTransform(),
        obstacle.geometry,
        place,
        coal.DistanceRequest(),
        coal.DistanceResult(),
    )
    return bool(distance < DISTANCE_ERROR)


def _pair_radii(robot: Robot, pairs: IntArray) -> FloatArray:
    """Displacement radii (P, n) of the pairs: joints that move both bodies alike do not count."""
    bodies = robot.collision_model.geometryObjects
    fixed = np.zeros(robot.n)

    def moves(k: int) -> FloatArray:
        return robot.displacement_radii[k] if k < len(bodies) else fixed

    radii = np.zeros((len(pairs), robot.n))
    for row, (a, b) in enumerate(pairs):
        only_one = (moves(a) > 0) != (moves(b) > 0)
        radii[row] = (moves(a) + moves(b)) * only_one
    return radii


def _prove_manager(robot: Robot, queries: _Queries) -> None:
    """Hold the broad-phase manager against the plain query; do without it where they differ."""
    for q in sample_configurations(robot.model)[:_PROOF_SAMPLES]:
        if queries.touches(q) != queries.touches_plainly(q):
            _log.warning(
                "%s: broad phase %s disagrees with coal; not used", robot.name, type(queries.manager).__name__
            )
            queries.use_manager = False
            return
