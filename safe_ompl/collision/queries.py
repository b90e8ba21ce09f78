"""Boolean queries over pairs of bodies: a broad phase, with security margins."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from functools import cache

import coal
import numpy as np
import pinocchio as pin

from safe_ompl.arrays import BoolArray, FloatArray, IntArray
from safe_ompl.collision.near_pairs import NearPairs
from safe_ompl.collision.tree_distances import TreeDistances

DISTANCE_ERROR = 1e-5  # [m]; coal's iterative distances are at most this far off


class Queries:
    """Boolean queries over the pairs of one geometry model, with their own working memory.

    Margins are an argument of every query; they are written to coal's requests where they are not those of the query
    before. Coal is only asked about pairs whose boxes are near each other (`NearPairs`): Pinocchio's managers compare
    obstacles with obstacles, too, and overlook bodies without volume.

    Parameters
    ----------
    model : pin.Model
        The robot.
    geometry : pin.GeometryModel
        The bodies and the P pairs.

    Attributes
    ----------
    touching : int or None
        The pair that the last query found too near.
    """

    def __init__(self, model: pin.Model, geometry: pin.GeometryModel) -> None:
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
        pairs: IntArray = np.array(indices(geometry), dtype=np.intp).reshape(-1, 2)
        self._entries = pairs[:, 0] + bodies * pairs[:, 1]
        self.no_margins: FloatArray = np.zeros(len(self._entries))
        self.no_margins.setflags(write=False)
        self._near = NearPairs(geometry, self.data, pairs)
        self.set_margins(self.no_margins)
        self.touching: int | None = None

    def take_shapes(self, bodies: Sequence[int]) -> None:
        """Look at some bodies anew: their shapes, or the sizes of these, are others now."""
        self._near.take_shapes(bodies)

    def touches(self, q: FloatArray, margins: FloatArray) -> bool:
        """Return whether any pair is nearer than its margin (P,) [m], ≥ 0, at Pinocchio's `q: (nq,)`."""
        if margins is not self._unchanging:
            self.set_margins(margins)
        pin.updateGeometryPlacements(self.model, self.kinematics, self.geometry, self.data, q)
        for pair in self._near.found():
            if pin.computeCollision(self.geometry, self.data, pair):
                self.touching = pair
                return True
        self.touching = None
        return False

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
        self._near.margins[:] = margins + 2 * DISTANCE_ERROR  # coal is as far off
        self.data.setSecurityMargins(self.geometry, self._margins, True, False)


class Distances:
    """Exact distances of the pairs of one geometry model, with their own working memory.

    Those of large point clouds are found faster where the query before was near (`TreeDistances`); this changes them
    by rounding only.

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
        self._trees = TreeDistances(geometry)
        for pair in self._trees.pairs:
            self._data.deactivateCollisionPair(pair)

    def at(self, q: FloatArray) -> FloatArray:
        """Return the distances (P,) [m] at Pinocchio's `q: (nq,)`."""
        pin.computeDistances(self._model, self._kinematics, self._geometry, self._data, q)
        distances = np.array([result.min_distance for result in self._results])
        for pair in self._trees.pairs:
            distances[pair] = self._trees.distance(self._data, pair)
        return distances

    def nearest(self, Q: FloatArray) -> FloatArray:
        """Return the same (B, P) at Pinocchio's `Q: (B, nq)`; infinity for some that are not the least to an obstacle.

        It does not depend on what was asked before.
        """
        self._trees.forget()
        rows = np.empty((len(Q), len(self._results)))
        for row, q in zip(rows, Q, strict=True):
            pin.computeDistances(self._model, self._kinematics, self._geometry, self._data, q)
            row[:] = [result.min_distance for result in self._results]
            for pair, distance in self._trees.nearest(self._data).items():
                row[pair] = distance
        return rows


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
