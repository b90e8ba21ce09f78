"""Measurements of a controller: people, objects, joints and clouds, each with its time."""

from __future__ import annotations

from collections.abc import Collection
from typing import Any, NamedTuple

import numpy as np

from safe_ompl.collision import robot_points
from safe_ompl.common import FloatArray, InputError
from safe_ompl.geometry import Obstacle, PointCloud
from safe_ompl.live import Surroundings
from safe_ompl.robot import Robot

_CLOUD = "cloud"
# Cloud points that are nearer than this to a tracked limb belong to the person.
_NEAR_PEOPLE = 0.15  # [m]
# Points that are farther than this many radii from all points of the earlier cloud are new.
_NEW_POINT_RADII = 3.0
# Up to this many new points count as noise.
_MOST_NOISE_POINTS = 10


class Sightings:
    """The newest measurement of each person and object.

    The replanner takes all measurements as of one time T, the time of the oldest of the newest measurements. For a
    person measured later, at s > T, the reach set that begins at T contains the set that begins at s, because it has
    had more time to grow. A person or object that was not seen for `lost_after` [s] does not count for T; the replanner
    stops for them. Clocks of sensors may differ by `clock_error` [s], so this time is subtracted from all stamps.
    """

    def __init__(self, names: Collection[str], lost_after: float, clock_error: float) -> None:
        self._names, self._lost_after, self._error = tuple(names), lost_after, clock_error
        self._newest: dict[str, tuple[float, Any]] = {}
        self._fed = -np.inf

    def add(self, name: str, stamp: float, now: float, value: Any) -> None:
        """Take a measurement if it is newer than the last one; raise InputError if its stamp [s] is in the future."""
        time = stamp - self._error
        if time > now:
            raise InputError(f"{name!r} was measured {stamp - now:.3f} s in the future: the clocks differ", "stamp")
        if name not in self._newest or time > self._newest[name][0]:
            self._newest[name] = time, value

    def restart(self) -> None:
        """Pass all measurements again, for a new replanner."""
        self._fed = -np.inf

    def due(self, now: float) -> tuple[float, dict[str, Any]] | None:
        """Return the time T [s] and the measurements for the replanner; None if nothing is new since the last call."""
        if not self._names:
            return now, {}
        fresh = [time for time, _ in self._newest.values() if time > now - self._lost_after]
        if not fresh or min(fresh) <= self._fed:
            return None
        self._fed = min(fresh)
        return self._fed, {name: value for name, (time, value) in self._newest.items() if time >= self._fed}


class Joints(NamedTuple):
    """Measured joint positions and velocities (n,)."""

    time: float  # [s]
    q: FloatArray
    qd: FloatArray


class CloudView(NamedTuple):
    """Points of the newest cloud in the world, without points on the robot or on a tracked person."""

    points: FloatArray  # (M, 3) [m]
    # The radius of the ball about each point [m].
    radius: float

    @classmethod
    def seen(
        cls, points: FloatArray, radius: float, robot: Robot, q: FloatArray, around: Surroundings | None
    ) -> CloudView:
        """Return the view of points (M, 3) [m] measured while the robot was at `q: (n,)`; NaN points are dropped."""
        kept = points[np.isfinite(points).all(axis=1)]
        kept = kept[~robot_points(kept, robot, q, radius)]
        for person in () if around is None else around.people.values():
            if person.keypoints is None or not len(kept):
                continue
            ends = person.tracker.body.ends(person.keypoints)
            for (start, end), width in zip(ends, person.tracker.body.radii(ends), strict=True):
                kept = kept[_from_segment(kept, start, end) > width + _NEAR_PEOPLE]
        return cls(kept, radius)

    def obstacle(self) -> Obstacle | None:
        """Return the points as an obstacle; None if there are none."""
        return Obstacle(_CLOUD, PointCloud(self.radius, points=self.points)) if len(self.points) else None

    def news(self, before: CloudView | None) -> int:
        """Return the number of points far from all points of the cloud `before`; 0 if so few may be noise."""
        edge = _NEW_POINT_RADII * self.radius
        old = np.zeros((0, 3)) if before is None else before.points
        known = {tuple(cell) for cell in np.floor(old / edge).astype(int).tolist()}
        cells = np.floor(self.points / edge).astype(int)
        steps = [(x, y, z) for x in (-1, 0, 1) for y in (-1, 0, 1) for z in (-1, 0, 1)]
        new = sum(not any((x + i, y + j, z + k) in known for i, j, k in steps) for x, y, z in cells.tolist())
        return new if new > _MOST_NOISE_POINTS else 0


def _from_segment(points: FloatArray, start: FloatArray, end: FloatArray) -> FloatArray:
    """Return the distances (M,) of points from a segment [m]."""
    way = end - start
    share = np.clip((points - start) @ way / max(float(way @ way), 1e-12), 0.0, 1.0)
    return np.asarray(np.linalg.norm(points - start - share[:, None] * way, axis=1))
