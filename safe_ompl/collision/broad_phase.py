"""Boolean queries over pairs of bodies with security margins; a broad phase over boxes finds the pairs."""

from __future__ import annotations

import warnings
from functools import cache, partial

import coal
import numpy as np
import pinocchio as pin
from numpy.lib.stride_tricks import as_strided

from safe_ompl.collision.kernels.distances import near_boxes
from safe_ompl.collision.tree_distances import TreeDistances
from safe_ompl.common import Changes, FloatArray, IntArray, PerThread

_PROBE = pin.SE3(pin.rpy.rpyToMatrix(0.3, 0.5, 0.7), np.array([1.0, 2.0, 3.0]))
DISTANCE_ERROR = 1e-5  # [m]; coal's iterative distances are at most this far off


class BroadPhase:
    """Finds those of P pairs of a geometry model whose bounding boxes are nearer than `margins: (P,)` [m], 0 at first.

    Pairs of two obstacles are never tested. The bodies are where `data`, which is kept alive, has them, and within the
    `boxes: (G, 6)` of `SceneGeometry`, which is not copied.
    """

    def __init__(self, data: pin.GeometryData, pairs: IntArray, boxes: FloatArray) -> None:
        self._data, self._boxes = data, boxes
        self._places = _places(data)
        self._pairs = np.array(pairs)  # which can be written to, as kernels want it
        self._near = np.empty(len(pairs), dtype=np.intp)
        self.margins: FloatArray = np.zeros(len(pairs))

    def found(self) -> list[int]:
        """Return the pairs that may be nearer than their margins, where the bodies are now; no other is."""
        number = near_boxes(self._places, self._boxes, self._pairs, self.margins, self._near)
        pairs: list[int] = self._near[:number].tolist() if number else []
        return pairs


def _places(data: pin.GeometryData) -> FloatArray:
    """Return the places of all bodies as a view (G, 12): rotation, column by column, and translation."""
    number = len(data.oMg)
    if not number:
        return np.empty((0, 12))
    view: FloatArray = as_strided(data.oMg[0].rotation, (number, 12), (12 * 8, 8))
    kept = data.oMg[number - 1].copy()
    data.oMg[number - 1] = _PROBE
    as_read = view[-1].copy()
    data.oMg[number - 1] = kept
    if not np.array_equal(as_read, [*_PROBE.rotation.T.ravel(), *_PROBE.translation]):
        raise RuntimeError("this version of Pinocchio keeps the places of bodies in another layout")
    return view


class Queries:
    """Boolean queries over the P pairs of one geometry model, boxes as `BroadPhase` has; any thread may ask.

    Margins are an argument of every query; they are written to coal's requests where they are not those of the query
    before. Coal is only asked about pairs whose boxes are near each other (`BroadPhase`): Pinocchio's managers compare
    obstacles with obstacles, too, and overlook bodies without volume. `changes` are those of the places of the bodies.
    """

    def __init__(
        self, model: pin.Model, geometry: pin.GeometryModel, pairs: IntArray, boxes: FloatArray, changes: Changes
    ) -> None:
        self.model = model
        self.geometry = geometry
        self._changes = changes
        self.no_margins: FloatArray = np.zeros(len(pairs))
        self.no_margins.setflags(write=False)

        def remembered() -> _Memory:
            with changes.none():
                return _Memory(model, geometry, pairs, boxes)

        self._memory = PerThread(remembered)

    def touching(self, q: FloatArray, margins: FloatArray) -> int | None:
        """Return the first pair that is nearer than its margin (P,) [m], ≥ 0, at Pinocchio's `q: (nq,)`, or None."""
        own, changes = self._memory.own, self._changes
        done, found = changes.done, None
        if margins is not own.unchanging:
            own.set_margins(margins)
        pin.updateGeometryPlacements(self.model, own.kinematics, self.geometry, own.data, q)
        for pair in own.broad_phase.found():
            if pin.computeCollision(self.geometry, own.data, pair):
                found = pair
                break
        if changes.begun == done:
            return found
        with changes.none():
            return self.touching(q, margins)


class _Memory:
    """Working memory of queries: where bodies are, the margins that coal has, and what is near."""

    def __init__(self, model: pin.Model, geometry: pin.GeometryModel, pairs: IntArray, boxes: FloatArray) -> None:
        # The margins that coal has: the array itself, where it cannot have changed since, or what was in it.
        self.unchanging: FloatArray | None = None
        self._written: bytes | None = None
        self.kinematics = model.createData()
        self.data = fresh_data(geometry, distances=False)
        self._geometry = geometry
        # Pinocchio takes margins as a matrix over bodies; writing it is ten times faster than request by request.
        bodies = len(geometry.geometryObjects)
        self._margins: FloatArray = np.zeros((bodies, bodies), order="F")
        self._margin_entries: FloatArray = self._margins.reshape(-1, order="F")  # a view
        self._entries = pairs[:, 0] + bodies * pairs[:, 1]
        self.broad_phase = BroadPhase(self.data, pairs, boxes)
        self._write(np.zeros(len(pairs)))

    def set_margins(self, margins: FloatArray) -> None:
        """Write margins (P,) [m] to coal's requests, unless they are there."""
        # An array that owns its numbers and is read-only is known to be the same when it comes again.
        if margins.base is None and not margins.flags.writeable:
            if margins is not self.unchanging:
                self._write(margins)
                self.unchanging, self._written = margins, None
        elif (content := margins.tobytes()) != self._written:
            self._write(margins)
            self.unchanging, self._written = None, content

    def _write(self, margins: FloatArray) -> None:
        # With a margin of zero coal takes bodies that overlap, now and then by centimetres, for a micrometre
        # apart, and calls them free: what is nearer than it can tell counts as touching.
        self._margin_entries[self._entries] = margins + DISTANCE_ERROR
        self.broad_phase.margins[:] = margins + 2 * DISTANCE_ERROR  # coal is as far off
        self.data.setSecurityMargins(self._geometry, self._margins, True, False)


class Distances:
    """Exact distances of the P pairs of one geometry model; any thread may ask. Parameters as of `Queries`.

    Those of large point clouds are found faster where the query before was near (`TreeDistances`); this changes them
    by rounding only.
    """

    def __init__(self, model: pin.Model, geometry: pin.GeometryModel, changes: Changes) -> None:
        self._model, self._geometry, self._changes = model, geometry, changes
        self._memory = PerThread(partial(_DistanceMemory, model, geometry))

    def at(self, q: FloatArray) -> FloatArray:
        """Return the distances (P,) [m] at Pinocchio's `q: (nq,)`."""
        memory = self._memory.own
        with self._changes.none():
            distances = self._measured(memory, q)
            for pair in memory.trees.pairs:
                distances[pair] = memory.trees.distance(memory.data, pair)
        return distances

    def nearest(self, Q: FloatArray) -> FloatArray:
        """Return the same (B, P) at Pinocchio's `Q: (B, nq)`; infinity for some that are not the least to an obstacle.

        It does not depend on what was asked before.
        """
        memory = self._memory.own
        rows = np.empty((len(Q), len(memory.results)))
        with self._changes.none():
            memory.trees.forget()
            for row, q in zip(rows, Q, strict=True):
                row[:] = self._measured(memory, q)
                for pair, distance in memory.trees.nearest(memory.data).items():
                    row[pair] = distance
        return rows

    def _measured(self, memory: _DistanceMemory, q: FloatArray) -> FloatArray:
        """Return the distances (P,) [m] as Pinocchio finds them, without those of trees."""
        pin.computeDistances(self._model, memory.kinematics, self._geometry, memory.data, q)
        return np.array([result.min_distance for result in memory.results])


class _DistanceMemory:
    """Where one thread measures distances."""

    def __init__(self, model: pin.Model, geometry: pin.GeometryModel) -> None:
        self.kinematics, self.data = model.createData(), fresh_data(geometry)
        self.results = list(self.data.distanceResults)
        self.trees = TreeDistances(geometry)
        for pair in self.trees.pairs:
            self.data.deactivateCollisionPair(pair)


def fresh_data(geometry: pin.GeometryModel, *, distances: bool = True) -> pin.GeometryData:
    """Return working memory in which a query does not start from the result of the one before.

    That would change distances by micrometres, and with them, now and then, what a planner finds with the same seed.
    Where no `distances` will be asked for, only collisions are prepared.
    """
    data, template = pin.GeometryData(geometry), _fresh_pair()
    pairs = len(geometry.collisionPairs)
    data.collisionRequests[:] = [template.collisionRequests[0]] * pairs
    if distances:
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
