"""What coal says of pairs of bodies: which are nearer than their margins, distances, points that are nearest."""

from __future__ import annotations

import warnings
from functools import cache
from math import inf, sqrt
from typing import NamedTuple, TypeAlias

import coal
import numpy as np
import pinocchio as pin

from safe_ompl.collision.geometry import SceneGeometry
from safe_ompl.common import FloatArray, IntArray
from safe_ompl.robot import Robot

DISTANCE_ERROR = 1e-5  # [m]; coal's iterative distances are at most this far off
_SPARE = 1e-5  # [m] more than coal's distances are off by
_POINT = coal.Sphere(1e-9)
_DISTANCE = coal.DistanceRequest()
_WORLD = pin.SE3.Identity()


class Nearest(NamedTuple):
    """The distance [m] of two bodies, in the world their nearest points (2, 3) [m], and the normal (3,) to the second.

    In contact the distance is ≤ 0, and the normal the shortest way out.
    """

    distance: float
    points: FloatArray
    normal: FloatArray


_Placed: TypeAlias = tuple[coal.CollisionGeometry, pin.SE3]


class CoalPairs:
    """Answers of coal for pairs (P, 2) of bodies, with the robot where it was placed last and obstacles as they are.

    One thread's; nothing else may change meanwhile.

    Distances from a `coal.OcTree` are found faster where the query before was near; this changes them by rounding only.
    Coal skips branches of a tree whose axis-aligned box is farther away than the best leaf so far. A long oblique link
    has a large box, and nearly every leaf is measured. Here both bodies are turned to a frame with one axis along the
    shortest connection of the query before, and coal begins with the distance of that connection's end on the tree as
    it is now, an upper bound. The leaves that are skipped are farther than that, so that the result is the same up to
    rounding. If the bound does not hold, because the tree is another one, coal finds nothing below it; then it is
    asked once more without it.
    """

    def __init__(self, robot: Robot, geometry: SceneGeometry, pairs: IntArray) -> None:
        self._robot, self._geometry, self._pairs = robot, geometry, pairs
        self._model, self._bodies = robot.shared.model, robot.shared.collision_model
        self._kinematics, self._data = self._model.createData(), self._bodies.createData()
        self._solids = list(self._bodies.geometryObjects)
        self._collision, self._result = coal.CollisionRequest(), coal.CollisionResult()
        # Where the tree is in its pair, 0 or 1, of the pairs that have one.
        self._tree: dict[int, int] = {}
        parts = len(self._solids) + np.flatnonzero([isinstance(part.geometry, coal.OcTree) for part in geometry.parts])
        for pair in np.flatnonzero(np.isin(pairs, parts).any(axis=1)).tolist():
            self._tree[pair] = side = int(np.isin(pairs[pair, 1], parts))
            self.placed(pairs[pair, 1 - side])[0].computeLocalAABB()
        # By pair: a lower bound of the distance [m], and where the body was then.
        self._floors: dict[int, tuple[float, pin.SE3]] = {}
        # By pair: the nearest point of the tree, in its frame, (3,) [m].
        self._last: dict[int, FloatArray] = {}

    def place(self, q: FloatArray) -> None:
        """Move the robot to `q: (n,)`."""
        full = self._robot.pinocchio_configuration(q)
        pin.updateGeometryPlacements(self._model, self._kinematics, self._bodies, self._data, full)

    def placed(self, body: int) -> _Placed:
        """Return a body, and where it is in the world."""
        own = len(self._solids)
        if body < own:
            return self._solids[body].geometry, self._data.oMg[int(body)]
        part = self._geometry.parts[body - own]
        return part.geometry, part.placement

    def are_nearer(self, pair: int, margin: float) -> bool:
        """Return whether a pair is nearer than a margin [m], ≥ 0.

        With a margin of zero coal takes bodies that overlap, now and then by centimetres, for a micrometre apart, and
        calls them free: what is nearer than it can tell counts as touching.
        """
        self._collision.security_margin = margin + DISTANCE_ERROR
        self._result.clear()
        first, second = map(self.placed, self._pairs[pair])
        return bool(coal.collide(*_posed(*first), *_posed(*second), self._collision, self._result))

    def nearest(self, pair: int, below: float = inf) -> Nearest:
        """Return how near each other the bodies of a pair are.

        Of a pair with a tree all are infinite where the distance is not less than `below` [m], > 0.
        """
        if pair not in self._tree:
            first, second = map(self.placed, self._pairs[pair])
            return _nearest(_measured(first, second, _WORLD, inf), _WORLD)
        side = self._tree[pair]
        tree, other = self.placed(self._pairs[pair, side]), self.placed(self._pairs[pair, 1 - side])
        frame, bound = self._hint(other, tree[1], pair)
        seed = min(bound, below)
        result = _measured(tree, other, frame, seed)
        if seed < below and not result.min_distance < seed:
            result = _measured(tree, other, frame, below)
        if result.min_distance <= _SPARE:  # the depth of a contact depends on the frame
            frame = _WORLD
            result = _measured(tree, other, frame, inf)
        self._floors[pair] = float(min(result.min_distance, below)), pin.SE3(other[1])
        if not result.min_distance < below:
            return Nearest(inf, np.full((2, 3), inf), np.full(3, inf))
        # In whichever order coal is given the two, the tree comes first.
        found = _nearest(result, frame)
        self._last[pair] = tree[1].actInv(found.points[0])
        return found if side == 0 else Nearest(found.distance, found.points[::-1], -found.normal)

    def forget(self) -> None:
        """Forget earlier queries, so that later results do not depend on them, not even by rounding."""
        self._last.clear()
        self._floors.clear()

    def distances(self, pairs: list[int]) -> list[float]:
        """Return the distances [m] of pairs (K,), infinite for bodies that are not the nearest one to their tree.

        A body whose points have moved less than it was farther away than the nearest one is now is not measured. This
        holds while trees stay what and where they are: else `forget` first.
        """
        found, lowest = dict.fromkeys(pairs, inf), dict[int, float]()
        for low, pair in sorted((self._lower(pair), pair) for pair in pairs):
            tree = int(self._pairs[pair, self._tree[pair]]) if pair in self._tree else -1 - pair
            best = lowest.get(tree, inf)
            if low < max(best, 0.0):
                found[pair] = self.nearest(pair, best if best > 0 else inf).distance
                lowest[tree] = min(best, found[pair])
        return list(found.values())

    def _lower(self, pair: int) -> float:
        """Return a lower bound of the distance [m] of a pair, by how far the body has moved since the last query."""
        floor, before = self._floors.get(pair, (-inf, None))
        if before is None:
            return floor
        shape, now = self.placed(self._pairs[pair, 1 - self._tree[pair]])
        shift = now.act(shape.aabb_center) - before.act(shape.aabb_center)
        turn = (now.rotation - before.rotation).ravel()
        low = floor - _SPARE - sqrt(shift @ shift) - shape.aabb_radius * sqrt(turn @ turn)
        return float(low) if low > -inf else -inf

    def _hint(self, other: _Placed, tree: pin.SE3, pair: int) -> tuple[pin.SE3, float]:
        """Return a frame along the shortest connection as far as known, and an upper bound of the distance [m]."""
        point = self._last.get(pair)
        if point is None:
            shape, body = other
            return pin.SE3(_along(body.act(shape.aabb_center) - tree.translation), body.translation), inf
        there = tree.act(point)
        result = _measured(other, (_POINT, pin.SE3(np.eye(3), there)), _WORLD, inf)
        if not _SPARE < result.min_distance < inf:  # in contact any leaf will do
            return _WORLD, inf
        away = there - result.getNearestPoint1()
        return pin.SE3(_along(away), there), result.min_distance + _SPARE


def _measured(first: _Placed, second: _Placed, frame: pin.SE3, seed: float) -> coal.DistanceResult:
    """Return coal's answer in a frame, which looks only for what is nearer than `seed` [m]."""
    result = coal.DistanceResult()
    if seed < inf:
        result.min_distance = seed
    (shape, place), (other, there) = first, second
    coal.distance(*_posed(shape, frame.actInv(place)), *_posed(other, frame.actInv(there)), _DISTANCE, result)
    return result


def _nearest(result: coal.DistanceResult, frame: pin.SE3) -> Nearest:
    points = np.array([frame.act(result.getNearestPoint1()), frame.act(result.getNearestPoint2())])
    return Nearest(float(result.min_distance), points, frame.rotation @ result.normal)


def _posed(shape: coal.CollisionGeometry, place: pin.SE3) -> tuple[coal.CollisionGeometry, coal.Transform3s]:
    return shape, coal.Transform3s(place.rotation, place.translation)


def _along(direction: FloatArray) -> FloatArray:
    """Return a rotation (3, 3) whose first column has a direction (3,)."""
    length = float(np.linalg.norm(direction))
    x = direction / length if length else np.array([1.0, 0.0, 0.0])
    y = _cross(x, np.eye(3)[int(np.abs(x).argmin())])
    y /= np.linalg.norm(y)
    return np.column_stack([x, y, _cross(x, y)])


def _cross(a: FloatArray, b: FloatArray) -> FloatArray:
    return np.array([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])


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
