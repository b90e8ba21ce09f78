"""Boolean queries over pairs of bodies: Pinocchio's broad phase, with security margins."""

from __future__ import annotations

import logging
import warnings
from functools import cache
from weakref import WeakKeyDictionary

import coal
import numpy as np
import pinocchio as pin

from safe_ompl.arrays import BoolArray, FloatArray
from safe_ompl.robot.bodies.self_collision import sample_configurations
from safe_ompl.robot.robot import Robot

_log = logging.getLogger(__name__)

_MANY_OBSTACLES = 100  # from here on the sweep-and-prune manager beats the naive one
_PROOF_SAMPLES = 100
_PROOF_MARGIN = 0.02  # [m]
DISTANCE_ERROR = 1e-5  # [m]; coal's iterative distances are at most this far off


class Queries:
    """Boolean queries over the pairs of one geometry model, with their own working memory.

    Pinocchio's broad-phase manager does not keep alive what it looks at; this object does. Margins are an argument of
    every query; they are written to coal's requests where they are not those of the query before.

    The manager is held against the plain query before it is trusted: the one that compares all bodies once for a robot,
    the one for many obstacles in every scene. It overlooks bodies without volume; where there are any, it is not used.

    Parameters
    ----------
    robot : Robot
        The robot.
    geometry : pin.GeometryModel
        The bodies and the P pairs.
    obstacles : int
        How many of the bodies are obstacles.
    margin : float
        [m] at which the manager is held against the plain query.
    """

    def __init__(
        self, robot: Robot, geometry: pin.GeometryModel, obstacles: int, margin: float = _PROOF_MARGIN
    ) -> None:
        model = robot.shared.model
        # The margins that coal has: the array itself, where it cannot have changed since, or what was in it.
        self._unchanging: FloatArray | None = None
        self._written: bytes | None = None
        self.model = model
        self.geometry = geometry
        self.kinematics = model.createData()
        self.data = fresh_data(geometry)
        # Pinocchio takes margins as a matrix over bodies; writing it is ten times faster than request by request.
        bodies = len(geometry.geometryObjects)
        self._margins: FloatArray = np.zeros((bodies, bodies), order="F")
        self._margin_entries: FloatArray = self._margins.reshape(-1, order="F")  # a view
        self._entries = np.array([a + bodies * b for a, b in indices(geometry)], dtype=np.intp)
        self.no_margins: FloatArray = np.zeros(len(self._entries))
        self.no_margins.setflags(write=False)
        self.set_margins(self.no_margins)
        many = obstacles > _MANY_OBSTACLES
        self._kind = (
            pin.BroadPhaseManager_SSaPCollisionManager
            if many
            else pin.BroadPhaseManager_NaiveCollisionManager
        )
        self.manager = self._kind(model, geometry, self.data)
        self.use_manager = True
        self.use_manager = self._all_have_volume() and self._manager_is_right(robot, margin, once=not many)

    def _all_have_volume(self) -> bool:
        flat = [
            body.name for body in self.geometry.geometryObjects if body.geometry.aabb_local.volume() <= 0.0
        ]
        if flat:
            _log.info("broad phase not used, as it overlooks bodies without volume: %s", ", ".join(flat))
        return not flat

    def _manager_is_right(self, robot: Robot, margin: float, *, once: bool) -> bool:
        known = _right_managers.setdefault(robot, {})
        if not once or margin not in known:
            known[margin] = proves_right(robot, self, margin)
        return known[margin]

    def take_new_shapes(self) -> None:
        """Look at the shapes that the geometry has now; where only places or sizes changed there is no need to."""
        self.manager = self._kind(self.model, self.geometry, self.data)

    def touches(self, q: FloatArray, margins: FloatArray) -> bool:
        """Return whether any pair is nearer than its margin (P,) [m], ≥ 0, at Pinocchio's `q: (nq,)`."""
        if margins is not self._unchanging:
            self.set_margins(margins)
        if self.use_manager:
            return bool(pin.computeCollisions(self.model, self.kinematics, self.manager, q, True))
        return self._touches_plainly(q)

    def touches_plainly(self, q: FloatArray, margins: FloatArray) -> bool:
        """Return the same as `touches`, without the broad phase."""
        self.set_margins(margins)
        return self._touches_plainly(q)

    def _touches_plainly(self, q: FloatArray) -> bool:
        return bool(pin.computeCollisions(self.model, self.kinematics, self.geometry, self.data, q, True))

    def all_contacts(self, q: FloatArray, margins: FloatArray) -> BoolArray:
        """Return for each pair (P,) whether it is nearer than its margin (P,) [m] at Pinocchio's `q: (nq,)`."""
        self.set_margins(margins)
        pin.computeCollisions(self.model, self.kinematics, self.geometry, self.data, q, False)
        return np.array([result.isCollision() for result in self.data.collisionResults], dtype=bool)

    def set_margins(self, margins: FloatArray) -> None:
        """Write margins (P,) [m] to coal's requests, unless they are there."""
        # An array that owns its numbers and is read-only is known to be the same when it comes again.
        if margins.base is None and not margins.flags.writeable:
            if margins is not self._unchanging:
                self._write(margins)
                self._unchanging, self._written = margins, None
        elif (content := margins.tobytes()) != self._written:
            self._write(margins)
            self._unchanging, self._written = None, content

    def _write(self, margins: FloatArray) -> None:
        # With a margin of zero coal takes bodies that overlap, now and then by centimetres, for a micrometre
        # apart, and calls them free: what is nearer than it can tell counts as touching.
        self._margin_entries[self._entries] = margins + DISTANCE_ERROR
        self.data.setSecurityMargins(self.geometry, self._margins, True, False)


class Distances:
    """Exact distances of the pairs of one geometry model, with their own working memory.

    Parameters
    ----------
    model : pin.Model
        The robot.
    geometry : pin.GeometryModel
        The bodies and the P pairs.
    """

    def __init__(self, model: pin.Model, geometry: pin.GeometryModel) -> None:
        self._model, self._geometry = model, geometry
        self._kinematics, self._data = model.createData(), fresh_data(geometry)
        self._results = list(self._data.distanceResults)

    def at(self, q: FloatArray) -> FloatArray:
        """Return the distances (P,) [m] at Pinocchio's `q: (nq,)`."""
        pin.computeDistances(self._model, self._kinematics, self._geometry, self._data, q)
        return np.array([result.min_distance for result in self._results])


def fresh_data(geometry: pin.GeometryModel) -> pin.GeometryData:
    """Return working memory in which a query does not start from the result of the one before.

    That would change distances by micrometres, and with them, now and then, what a planner finds with the same seed.
    """
    data, template = pin.GeometryData(geometry), _fresh_pair()
    pairs = len(geometry.collisionPairs)
    data.collisionRequests[:] = [template.collisionRequests[0]] * pairs
    data.distanceRequests[:] = [template.distanceRequests[0]] * pairs
    return data


@cache
def _fresh_pair() -> pin.GeometryData:
    """Return such memory of one pair; Pinocchio's requests are the same for every pair."""
    geometry = pin.GeometryModel()
    for name in "ab":
        geometry.addGeometryObject(pin.GeometryObject(name, 0, pin.SE3.Identity(), coal.Sphere(1.0)))
    geometry.addCollisionPair(pin.CollisionPair(0, 1))
    data = pin.GeometryData(geometry)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # in favour of an option that Pinocchio overrides
        for request in (*data.collisionRequests, *data.distanceRequests):
            request.enable_cached_gjk_guess = False
    return data


def indices(geometry: pin.GeometryModel) -> list[tuple[int, int]]:
    """Return the two bodies of each pair, the first one with the smaller index."""
    return [(int(pair.first), int(pair.second)) for pair in geometry.collisionPairs]


# By robot and margin: whether the manager that compares all bodies agreed with the plain query.
_right_managers: WeakKeyDictionary[Robot, dict[float, bool]] = WeakKeyDictionary()


def proves_right(robot: Robot, queries: Queries, margin: float) -> bool:
    """Hold the broad-phase manager against the plain query, at a margin [m]; return whether they agree."""
    margins = np.full_like(queries.no_margins, margin)
    margins.setflags(write=False)
    for q in sample_configurations(robot.shared.model)[:_PROOF_SAMPLES]:
        if queries.touches(q, margins) != queries.touches_plainly(q, margins):
            _log.warning(
                "%s: broad phase %s disagrees with coal; not used", robot.name, type(queries.manager).__name__
            )
            return False
    return True
