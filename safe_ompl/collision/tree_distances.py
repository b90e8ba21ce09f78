"""Distances of bodies from the cells of a point cloud."""

from __future__ import annotations

from math import sqrt
from typing import Any, TypeAlias

import coal
import numpy as np
import pinocchio as pin

from safe_ompl.common import FloatArray

_SPARE = 1e-5  # [m] more than coal's distances are off by
_POINT = coal.Sphere(1e-9)
_REQUEST = coal.DistanceRequest()

_Placed: TypeAlias = tuple[coal.CollisionGeometry, pin.SE3]


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
