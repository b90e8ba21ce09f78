"""The bodies of a robot, followed by the parts of the obstacles of a scene, some of which may move."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from safe_ompl.common import InputError
from safe_ompl.geometry import Obstacle, Part
from safe_ompl.robot import Robot
from safe_ompl.scene import Scene


class SceneGeometry:
    """The bodies of a robot, followed by the parts of the obstacles of a scene, some of which may move.

    `names` are the link or obstacle of each of the G bodies, `parts` the parts of all obstacles at their present poses
    in the world, and `touched_by` the links that may touch an obstacle. Obstacles are not part of a Pinocchio model,
    because it rebuilds a table of all pairs of bodies for each added body. Raises InputError if `movable` is not a
    list, or names an obstacle that the scene does not have.
    """

    def __init__(self, robot: Robot, scene: Scene, movable: Sequence[str]) -> None:
        if isinstance(movable, str) or not isinstance(movable, Iterable):
            raise InputError(f"movable must be a list of names of obstacles, got {movable!r}")
        self.movable = frozenset(scene[name].name for name in movable)
        self.touched_by = {obstacle.name: obstacle.touched_by for obstacle in scene if obstacle.touched_by}
        self.names, self.parts = list(robot.shared.body_links), list[Part]()
        # The parts of each obstacle, in the obstacle's frame.
        self._own: list[list[Part]] = []
        self._first: list[int] = []  # of these in `parts`
        for obstacle in scene.obstacles:
            own = obstacle.shape.parts()
            self._own.append(own)
            self._first.append(len(self.parts))
            self.names += [obstacle.name] * len(own)
            self.parts += _placed(own, obstacle)
        self._scene = scene

    def move(self, scene: Scene) -> bool:
        """Use the poses of another scene; return whether any obstacle has moved.

        Raises InputError if anything but the pose of a movable obstacle differs. Then nothing moves.
        """
        moves = self._moves(scene)
        for k, obstacle, shapes in moves:
            self._own[k] = own = shapes or self._own[k]
            self.parts[self._first[k] : self._first[k] + len(own)] = _placed(own, obstacle)
        self._scene = scene
        return bool(moves)

    def _moves(self, scene: Scene) -> list[tuple[int, Obstacle, list[Part]]]:
        """Return the obstacles that have moved, with their new parts if the shape has changed, else an empty list."""
        if scene.names != self._scene.names:
            raise InputError(f"must have the same obstacles, {list(self._scene.names)}, got {list(scene.names)}")
        moves: list[tuple[int, Obstacle, list[Part]]] = []
        for k, (before, after) in enumerate(zip(self._scene, scene, strict=True)):
            if after is before or after == before:
                continue
            if after.name not in self.movable:
                raise InputError(f"{after.name!r} is not movable; those are: {sorted(self.movable)}")
            if not before.same_but_for_place(after):
                raise InputError(f"{after.name!r} may only be moved, but not changed: {before!r} to {after!r}")
            moves.append((k, after, [] if after.shape == before.shape else self._remeasured_parts(k, after)))
        return moves

    def _remeasured_parts(self, k: int, obstacle: Obstacle) -> list[Part]:
        parts = obstacle.shape.parts()
        before = [type(part.geometry).__name__ for part in self._own[k]]
        after = [type(part.geometry).__name__ for part in parts]
        if before != after:
            raise InputError(
                f"{obstacle.name!r} has other parts than before, {len(after)} × {after[0]} in the place of "
                f"{len(before)} × {before[0]}: make a new checker"
            )
        return parts


def _placed(own: list[Part], obstacle: Obstacle) -> list[Part]:
    """Return the parts of an obstacle with their poses in the world."""
    pose = obstacle.pose.se3
    return [part._replace(placement=pose * part.placement) for part in own]
