"""Tracked objects: solids whose poses are measured, and clouds whose points are."""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin

from safe_ompl.common import FloatArray, InputError, number
from safe_ompl.geometry import Obstacle, PointCloud, Pose, bounding_hull, placed
from safe_ompl.live.reach import ReachSets, ReachViolation, ball_cover

_ROUNDING = 1e-9  # [m]
_MOST_BALLS = 256  # of the reach sets of a cloud


class ObjectTrack:
    """An object that moves: the hulls of its parts, none of whose points is faster than a bound [m/s].

    At the first pose it counts as unseen. Raises InputError if the bound is none.
    """

    def __init__(self, obstacle: Obstacle, speed: float) -> None:
        self.name, self.obstacle = obstacle.name, obstacle
        self.speed = number(f"objects.{obstacle.name}", speed, at_least=0.0)
        self.time, self.seen = -np.inf, -np.inf
        self._hulls = [bounding_hull(part.geometry).moved(part.placement) for part in obstacle.shape.parts()]

    @property
    def pose(self) -> pin.SE3:
        """Where it was seen last."""
        return self.obstacle.pose.se3

    @property
    def age(self) -> float:
        """How long ago it was seen [s]."""
        return self.time - self.seen

    def observe(self, place: Any, time: float) -> ReachViolation | None:
        """Take where it was seen, or None; as `PersonTrack.observe`."""
        if time < self.time:
            raise InputError(f"time must not go backwards: {time:g} s after {self.time:g} s", self.name)
        violation = None
        if place is not None:
            moved = self._moved(place)
            if np.isfinite(self.seen):
                excess = self._way_to(moved) - self.speed * (time - self.seen)
                violation = ReachViolation(self.name, "", excess) if excess > _ROUNDING else None
            self.obstacle, self.seen = moved, time
        self.time = time
        return violation

    def _moved(self, place: Any) -> Obstacle:
        return self.obstacle.moved(Pose.of(place))

    def _way_to(self, moved: Obstacle) -> float:
        """Return how far its points went at least [m]."""
        pairs = zip(self.points_at(moved.pose.se3), self.points_at(self.pose), strict=True)
        return max(float(np.linalg.norm(new - old, axis=1).max()) for new, old in pairs)

    def points_at(self, pose: pin.SE3) -> list[FloatArray]:
        """Return the points (K, 3) of its parts, where it is at a pose [m]."""
        return [placed(pose, hull.points) for hull in self._hulls]

    def sets(self) -> ReachSets:
        """Return where it may be from the time of the last measurement on."""
        found = ReachSets.none()
        growth = np.array([[self.speed * self.age, self.speed]])
        for points, hull in zip(self.points_at(self.pose), self._hulls, strict=True):
            found = found.beside(ReachSets.of(((self.name, ""),), points[None], np.array([hull.radius]), growth))
        return found


class CloudTrack(ObjectTrack):
    """A cloud that moves: each point of its balls is no faster than a bound [m/s]; its points are others each time.

    A point that is new counts as farther than promised if it is so from all that were seen before, beyond the sizes of
    the cells in which they are kept.
    """

    def _moved(self, place: Any) -> Obstacle:
        return self.obstacle.moved(place)

    def _balls(self, obstacle: Obstacle) -> tuple[FloatArray, float]:
        """Return centres (M, 3) in the world and the radius of balls that hold those of the cloud [m]."""
        shape = obstacle.shape
        assert isinstance(shape, PointCloud)
        centres, radius = ball_cover(placed(obstacle.pose.se3, shape.centres), _MOST_BALLS)
        return centres, radius + shape.radius

    def _way_to(self, moved: Obstacle) -> float:
        (new, wide), (old, narrow) = self._balls(moved), self._balls(self.obstacle)
        apart = np.linalg.norm(new[:, None] - old, axis=2).min(axis=1)
        return float(apart.max()) - wide - narrow

    def sets(self) -> ReachSets:
        centres, radius = self._balls(self.obstacle)
        count = len(centres)
        growth = np.tile([self.speed * self.age, self.speed], (count, 1))
        return ReachSets.of(((self.name, ""),) * count, centres[:, None], np.full(count, radius), growth)
