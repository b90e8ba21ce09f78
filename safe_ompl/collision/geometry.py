"""The bodies of a robot and, after them, the parts of obstacles, of which some may move."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import coal
import pinocchio as pin

from safe_ompl.common import InputError
from safe_ompl.geometry import Cells, Obstacle, Part
from safe_ompl.robot import Robot
from safe_ompl.scene import Scene


@dataclass(eq=False, repr=False)
class ObstaclePart:
    """One part of an obstacle where it is now: its index among the bodies, its places in the obstacle and the world."""

    index: int
    geometry: coal.CollisionGeometry
    local: pin.SE3
    placement: pin.SE3
    cells: Cells | None
    parentJoint: int = 0


class SceneGeometry:
    """The bodies of a robot and, after them, the parts of the obstacles of a scene, of which some may move.

    `names` has the link or obstacle of each of the G bodies, `parts` those of all obstacles, and `touched_by` the links
    that may touch an obstacle. Obstacles are no part of a model of Pinocchio: that has a table of all pairs of bodies,
    and makes it anew for each body that is added. Raises InputError if the scene has no movable obstacle of a name, or
    the names are no list.
    """

    def __init__(self, robot: Robot, scene: Scene, movable: Sequence[str]) -> None:
        if isinstance(movable, str) or not isinstance(movable, Iterable):
            raise InputError(f"movable must be a list of names of obstacles, got {movable!r}")
        self.movable = frozenset(scene[name].name for name in movable)
        self.names = list(robot.shared.body_links)
        self._of: list[list[ObstaclePart]] = []  # each obstacle
        self.touched_by = {obstacle.name: obstacle.touched_by for obstacle in scene if obstacle.touched_by}
        for obstacle in scene.obstacles:
            pose, parts = obstacle.pose.se3, []
            for part in obstacle.shape.parts():
                parts.append(
                    ObstaclePart(len(self.names), part.geometry, part.placement, pose * part.placement, part.cells)
                )
                self.names.append(obstacle.name)
            self._of.append(parts)
        self.parts = [part for parts in self._of for part in parts]
        self._scene = scene

    def move(self, scene: Scene) -> bool:
        """Take the places of another scene; return whether anything has moved.

        Raises InputError if anything but the place of a movable obstacle differs. Then nothing moves.
        """
        moves = self._moves(scene)
        for k, obstacle, shapes in moves:
            pose = obstacle.pose.se3
            for part, shape in zip(self._of[k], shapes, strict=False):
                part.geometry, part.local, part.cells = shape.geometry, shape.placement, shape.cells
            for part in self._of[k]:
                part.placement = pose * part.local
        self._scene = scene
        return bool(moves)

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
        before = [type(part.geometry).__name__ for part in self._of[k]]
        after = [type(part.geometry).__name__ for part in parts]
        if before != after:
            raise InputError(
                f"{obstacle.name!r} has other parts than before, {len(after)} × {after[0]} in the place of "
                f"{len(before)} × {before[0]}: make a new checker"
            )
        return parts
