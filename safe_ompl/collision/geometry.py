"""One geometry model with the bodies of a robot and the parts of obstacles, and how obstacles move in it."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import coal
import numpy as np
import pinocchio as pin

from safe_ompl.common import FloatArray, InputError, IntArray
from safe_ompl.geometry import Hull, Obstacle, Part, bounding_box, bounding_hull
from safe_ompl.robot import Robot
from safe_ompl.scene import Scene

_KEPT = (coal.Capsule, coal.Sphere)  # stay the same objects when they are measured anew


@dataclass
class ObstaclePart:
    """One part of an obstacle where it is now: a body of the geometry model, its places in obstacle and world."""

    index: int
    shape: coal.CollisionGeometry
    local: pin.SE3
    world: pin.SE3

    def __post_init__(self) -> None:
        self._hull = bounding_hull(self.shape)

    @property
    def hull(self) -> Hull:
        """Points and a radius that enclose it, in the world."""
        return self._hull.moved(self.world)

    def measure_anew(self, shape: coal.CollisionGeometry, local: pin.SE3) -> None:
        """Take another shape of the same kind.

        A capsule takes the other's length, so that all that refer to it see the change; anything else is replaced.
        """
        self.local = local
        if not isinstance(self.shape, _KEPT):
            self.shape = shape
        elif isinstance(self.shape, coal.Capsule):
            self.shape.halfLength = shape.halfLength
            self.shape.computeLocalAABB()
        self._hull = bounding_hull(self.shape)

    def write(self, geometry: pin.GeometryModel) -> None:
        """Write the placement and the shape of the part into a geometry model."""
        entry = geometry.geometryObjects[self.index]
        entry.placement = self.world
        if not isinstance(self.shape, _KEPT):
            entry.geometry = self.shape


class SceneGeometry:
    """The bodies of a robot and, after them, the parts of the obstacles of a scene, of which some may move.

    `names` has the link or obstacle of each of the G bodies, `touched_by` the links that may touch an obstacle, and
    `boxes: (G, 6)` the boxes about the shapes that they have now, as `bounding_box` returns them [m]. Raises InputError
    if the scene has no movable obstacle of a name, or the names are no list.
    """

    def __init__(self, robot: Robot, scene: Scene, movable: Sequence[str]) -> None:
        if isinstance(movable, str) or not isinstance(movable, Iterable):
            raise InputError(f"movable must be a list of names of obstacles, got {movable!r}")
        self.movable = frozenset(scene[name].name for name in movable)
        self.names = list(robot.shared.body_links)
        self._own_pairs = robot.shared.body_pairs
        self._bodies = robot.shared.collision_model.copy()
        self._parts: list[list[ObstaclePart]] = []  # of each obstacle
        self.touched_by = {obstacle.name: obstacle.touched_by for obstacle in scene if obstacle.touched_by}
        for obstacle in scene.obstacles:
            parts = []
            pose = obstacle.pose.se3
            for part in obstacle.shape.parts():
                world = pose * part.placement
                entry = pin.GeometryObject(f"obstacle:{obstacle.part_name(part)}", 0, world, part.geometry)
                index = self._bodies.addGeometryObject(entry)
                parts.append(ObstaclePart(int(index), part.geometry, part.placement, world))
                self.names.append(obstacle.name)
            self._parts.append(parts)
        boxes = [bounding_box(part.shape) for part in self.parts]
        self.boxes: FloatArray = np.concatenate([robot.shared.body_boxes, np.reshape(boxes, (-1, 6))])
        self._models = [self._bodies]
        self._scene = scene

    def with_pairs(self, pairs: IntArray) -> pin.GeometryModel:
        """Return a model of all bodies with `pairs: (P, 2)` of them; obstacles move in it as they do here."""
        model, own = self._bodies.copy(), len(self._own_pairs)
        if not np.array_equal(pairs[:own], self._own_pairs):
            model.removeAllCollisionPairs()
            own = 0
        for first, second in pairs[own:].tolist():
            model.addCollisionPair(pin.CollisionPair(first, second))
        self._models.append(model)
        return model

    @property
    def obstacle_bodies(self) -> list[pin.GeometryObject]:
        """The bodies of the parts of all obstacles."""
        return list(self._bodies.geometryObjects)[len(self._bodies.geometryObjects) - len(self.parts) :]

    @property
    def parts(self) -> list[ObstaclePart]:
        """The parts of all obstacles."""
        return [part for parts in self._parts for part in parts]

    def move(self, scene: Scene) -> list[ObstaclePart]:
        """Take the places of another scene; return what has moved.

        Raises InputError if anything but the place of a movable obstacle differs. Then nothing moves.
        """
        moves = self._moves(scene)
        moved = list[ObstaclePart]()
        for k, obstacle, shapes in moves:
            pose = obstacle.pose.se3
            for part, shape in zip(self._parts[k], shapes, strict=False):
                part.measure_anew(shape.geometry, shape.placement)
                self.boxes[part.index] = bounding_box(part.shape)
            for part in self._parts[k]:
                part.world = pose * part.local
                moved.append(part)
        for model in self._models:
            for part in moved:
                part.write(model)
        self._scene = scene
        return moved

    def _moves(self, scene: Scene) -> list[tuple[int, Obstacle, list[Part]]]:
        """Return which obstacles are elsewhere, and their parts where these were measured anew, else none."""
        if scene.names != self._scene.names:
            raise InputError(f"must have the same obstacles, {list(self._scene.names)}, got {list(scene.names)}")
        moves: list[tuple[int, Obstacle, list[Part]]] = []
        for k, (before, after) in enumerate(zip(self._scene, scene, strict=True)):
            if after is before or after == before:
                continue
            if after.name not in self.movable:
                raise InputError(f"{after.name!r} is not movable; those are: {sorted(self.movable)}")
            if not before.same_but_for_place(after):
                raise InputError(f"{after.name!r} may move, but not become another: {before!r} to {after!r}")
            moves.append((k, after, [] if after.shape == before.shape else self._measured_anew(k, after)))
        return moves

    def _measured_anew(self, k: int, obstacle: Obstacle) -> list[Part]:
        parts = obstacle.shape.parts()
        before = [type(part.shape).__name__ for part in self._parts[k]]
        after = [type(part.geometry).__name__ for part in parts]
        if before != after:
            raise InputError(
                f"{obstacle.name!r} has other parts than before, {len(after)} × {after[0]} in the place of "
                f"{len(before)} × {before[0]}: make a new checker"
            )
        return parts
