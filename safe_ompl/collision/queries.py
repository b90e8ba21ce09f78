"""Queries of coal over pairs of bodies: which are nearer than their margins, and exact distances."""

from __future__ import annotations

import warnings
from functools import cache, partial
from math import sqrt
from typing import Any, TypeAlias

import coal
import numpy as np
import pinocchio as pin
from numpy.lib.stride_tricks import as_strided

from safe_ompl.collision.kernels.distances import near_boxes
from safe_ompl.common import Changes, FloatArray, IntArray, PerThread

_PROBE = pin.SE3(pin.rpy.rpyToMatrix(0.3, 0.5, 0.7), np.array([1.0, 2.0, 3.0]))
DISTANCE_ERROR = 1e-5  # [m]; coal's iterative distances are at most this far off
_SPARE = 1e-5  # [m] more than coal's distances are off by
_POINT = coal.Sphere(1e-9)
_REQUEST = coal.DistanceRequest()

_Placed: TypeAlias = tuple[coal.CollisionGeometry, pin.SE3]


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
    """Boolean queries over the P pairs of one geometry model; any thread may ask.

    Margins are an argument of every query; that of a pair is written to coal's request before coal is asked, unless it
    is there. Coal is only asked about pairs whose boxes are near each other: Pinocchio's managers compare obstacles
    with obstacles, too, and overlook bodies without volume. The `boxes: (G, 6)` are those of `SceneGeometry`, not
    copied; `changes` those of the places of the bodies.
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
        pin.updateGeometryPlacements(self.model, own.kinematics, self.geometry, own.data, q)
        for pair in own.near(margins):
            # With a margin of zero coal takes bodies that overlap, now and then by centimetres, for a micrometre
            # apart, and calls them free: what is nearer than it can tell counts as touching.
            if margins[pair] != own.written[pair]:
                own.data.collisionRequests[pair].security_margin = float(margins[pair]) + DISTANCE_ERROR
                own.written[pair] = margins[pair]
            if pin.computeCollision(self.geometry, own.data, pair):
                found = pair
                break
        if changes.begun == done:
            return found
        with changes.none():
            return self.touching(q, margins)


class _Memory:
    """Working memory of queries: where bodies are, and what is near."""

    def __init__(self, model: pin.Model, geometry: pin.GeometryModel, pairs: IntArray, boxes: FloatArray) -> None:
        self.kinematics = model.createData()
        self.data = fresh_data(geometry, distances=False)
        self._places, self._boxes = _places(self.data), boxes
        self._pairs = np.array(pairs)  # which can be written to, as kernels want it
        self._near = np.empty(len(pairs), dtype=np.intp)
        self._margins: FloatArray | None = None  # of the query before
        self.written: FloatArray = np.full(len(pairs), np.nan)  # margins that coal has

    def near(self, margins: FloatArray) -> list[int]:
        """Return the pairs whose boxes are nearer than their margins, where the bodies are now; no other pair is."""
        # An array that owns its numbers and is read-only is known to be the same when it comes again.
        if margins is not self._margins or margins.base is not None or margins.flags.writeable:
            self._margins = margins
            self._box_margins: FloatArray = margins + 2 * DISTANCE_ERROR  # coal is as far off
        number = near_boxes(self._places, self._boxes, self._pairs, self._box_margins, self._near)
        pairs: list[int] = self._near[:number].tolist() if number else []
        return pairs


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

    def points(self, pair: int) -> FloatArray:
        """Return the nearest points of both bodies of a pair where this thread asked last, (2, 3) [m]."""
        memory = self._memory.own
        if pair in memory.trees:
            return np.array(memory.trees.witness(pair))
        result = memory.results[pair]
        return np.array([result.getNearestPoint1(), result.getNearestPoint2()])

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


class TreeDistances:
    """Exact distances of those pairs of a geometry model of which one body is a `coal.OcTree`.

    Coal skips branches of a tree whose axis-aligned box is farther away than the best leaf so far. A long oblique link
    has a large box, and nearly every leaf is measured. Here both bodies are turned to a frame with one axis along the
    shortest connection of the query before, and coal begins with the distance of that connection's end on the tree as
    it is now, an upper bound. The leaves that are skipped are farther than that, so that the result is the same up to
    rounding. If the bound does not hold, because the tree is another one, coal finds nothing below it; then it is
    asked once more without it.
    """

    def __init__(self, geometry: pin.GeometryModel) -> None:
        self._geometry = geometry
        objects = geometry.geometryObjects
        # Where the tree is in its pair, 0 or 1, of the pairs that have one.
        self._tree: dict[int, int] = {}
        for k, pair in enumerate(geometry.collisionPairs):
            for side, body in enumerate((pair.first, pair.second)):
                if objects[body].geometry.getNodeType() == coal.NODE_TYPE.GEOM_OCTREE:
                    self._tree[k] = side
        for k, side in self._tree.items():
            pair = geometry.collisionPairs[k]
            objects[pair.second if side == 0 else pair.first].geometry.computeLocalAABB()
        # By pair: a lower bound of the distance [m], and where the body was then.
        self._floors: dict[int, tuple[float, pin.SE3]] = {}
        # By pair: the nearest point of the tree, in its frame, (3,) [m].
        self._last: dict[int, FloatArray] = {}
        self._witnesses: dict[int, tuple[FloatArray, FloatArray]] = {}

    @property
    def pairs(self) -> list[int]:
        """Indices of the pairs with a tree."""
        return list(self._tree)

    def __contains__(self, pair: int) -> bool:
        return pair in self._tree

    def witness(self, pair: int) -> tuple[FloatArray, FloatArray]:
        """Return the nearest points of both bodies at the last query, each (3,) [m]."""
        return self._witnesses[pair]

    def forget(self) -> None:
        """Forget earlier queries, so that later results do not depend on them, not even by rounding."""
        self._last.clear()
        self._floors.clear()

    def nearest(self, data: pin.GeometryData) -> dict[int, float]:
        """Return the distance [m] of the pairs, infinite for bodies that are not the nearest one to their tree.

        A body whose points have moved less than it was farther away than the nearest one is now is not measured. This
        holds while trees stay what and where they are: else `forget` first.
        """
        found = dict.fromkeys(self._tree, np.inf)
        lowest: dict[int, float] = {}
        for low, pair in sorted((self._lower(data, pair), pair) for pair in self._tree):
            bodies = self._geometry.collisionPairs[pair]
            tree = (bodies.first, bodies.second)[self._tree[pair]]
            best = lowest.get(tree, np.inf)
            if low < max(best, 0.0):
                found[pair] = self.distance(data, pair, best if best > 0 else np.inf)
                lowest[tree] = min(best, found[pair])
        return found

    def _lower(self, data: pin.GeometryData, pair: int) -> float:
        """Return a lower bound of the distance [m] of a pair, by how far the body has moved since the last query."""
        floor, before = self._floors.get(pair, (-np.inf, None))
        if before is None:
            return floor
        bodies = self._geometry.collisionPairs[pair]
        body = (bodies.second, bodies.first)[self._tree[pair]]
        shape, now = self._geometry.geometryObjects[body].geometry, data.oMg[body]
        shift = now.act(shape.aabb_center) - before.act(shape.aabb_center)
        turn = (now.rotation - before.rotation).ravel()
        low = floor - _SPARE - sqrt(shift @ shift) - shape.aabb_radius * sqrt(turn @ turn)
        return float(low) if low > -np.inf else -np.inf

    def distance(self, data: pin.GeometryData, pair: int, below: float = np.inf) -> float:
        """Return the distance [m] of a pair with a tree, with the bodies where `data` has them.

        Infinity where it is not less than `below` [m], > 0.
        """
        bodies, side = self._geometry.collisionPairs[pair], self._tree[pair]
        ends = (bodies.first, bodies.second)
        tree, other = ((self._geometry.geometryObjects[k].geometry, data.oMg[k]) for k in (ends[side], ends[1 - side]))
        frame, bound = self._hint(other, tree[1], pair)
        seed = min(bound, below)
        result = _measured(tree, other, frame, seed)
        if seed < below and not result.min_distance < seed:
            result = _measured(tree, other, frame, below)
        if result.min_distance <= _SPARE:  # the depth of a contact depends on the frame
            frame = pin.SE3.Identity()
            result = _measured(tree, other, frame, np.inf)
        self._floors[pair] = float(min(result.min_distance, below)), pin.SE3(other[1])
        if not result.min_distance < below:
            return np.inf
        # In whichever order coal is given the two, the point of the tree comes first.
        points = frame.act(result.getNearestPoint1()), frame.act(result.getNearestPoint2())
        self._last[pair] = tree[1].actInv(points[0])
        self._witnesses[pair] = points if side == 0 else points[::-1]
        return float(result.min_distance)

    def _hint(self, other: _Placed, tree: pin.SE3, pair: int) -> tuple[pin.SE3, float]:
        """Return a frame along the shortest connection as far as known, and an upper bound of the distance [m]."""
        point = self._last.get(pair)
        if point is None:
            shape, body = other
            return pin.SE3(_along(body.act(shape.aabb_center) - tree.translation), body.translation), np.inf
        there = tree.act(point)
        result = _measured(other, (_POINT, pin.SE3(np.eye(3), there)), pin.SE3.Identity(), np.inf)
        if not _SPARE < result.min_distance < np.inf:  # in contact any leaf will do
            return pin.SE3.Identity(), np.inf
        away = there - result.getNearestPoint1()
        return pin.SE3(_along(away), there), result.min_distance + _SPARE


def _measured(first: _Placed, second: _Placed, frame: pin.SE3, seed: float) -> coal.DistanceResult:
    """Return coal's answer in a frame, which looks only for what is nearer than `seed` [m]."""
    result = coal.DistanceResult()
    if seed < np.inf:
        result.min_distance = seed
    placed: list[Any] = []
    for shape, place in (first, second):
        here = frame.actInv(place)
        placed += [shape, coal.Transform3s(here.rotation, here.translation)]
    coal.distance(*placed, _REQUEST, result)
    return result


def _along(direction: FloatArray) -> FloatArray:
    """Return a rotation (3, 3) whose first column has a direction (3,)."""
    length = float(np.linalg.norm(direction))
    x = direction / length if length else np.array([1.0, 0.0, 0.0])
    y = _cross(x, np.eye(3)[int(np.abs(x).argmin())])
    y /= np.linalg.norm(y)
    return np.column_stack([x, y, _cross(x, y)])


def _cross(a: FloatArray, b: FloatArray) -> FloatArray:
    return np.array([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])


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
