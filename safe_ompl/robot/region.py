"""Task space regions: bounds on the position and the orientation of the tip."""

from __future__ import annotations

from dataclasses import dataclass
from math import hypot
from typing import Any, TypeAlias

import numpy as np
import pinocchio as pin

from safe_ompl.common import FloatArray, InputError, Section, documents as document, key
from safe_ompl.geometry import Pose
from safe_ompl.robot.ik import TargetPose, error_from
from safe_ompl.robot.parts import read_pose
from safe_ompl.robot.robot import Robot

Bounds: TypeAlias = tuple[float, float]
"""Lower and upper bound; equal for a fixed value."""

_ANGLES = ("roll", "pitch", "yaw")
# Bounds of a coordinate that is not given.
_FIXED_AT_ZERO = (0.0, 0.0)
# Bounds of roll, pitch and yaw that are not given.
_FREE = (-np.pi, np.pi), (-np.pi / 2, np.pi / 2), (-np.pi, np.pi)
# The coordinate descent to the nearest orientation sweeps over the three angles at most this often.
_SWEEPS = 100
# The coordinate descent ends after a sweep that changes no angle by more than this.
_SETTLED = 1e-9  # [rad]


def _bounds(key: str, given: Any) -> Bounds:
    """Read bounds given as [low, high] or as one number."""
    if np.ndim(given) == 0 and not isinstance(given, str):
        value = document.number(key, given)
        return value, value
    low, high = document.numbers(key, given, 2)
    if low > high:
        raise InputError(f"must be [low, high] with low <= high, got [{low:g}, {high:g}]", key)
    return low, high


@dataclass(frozen=True)
class GoalRegion(Section):
    """A task space region: bounds on position and orientation of the tip, in the frame of the region [1].

    Each bound is a pair (low, high), or one number for a fixed value. The position is bounded by x, y and z, or by
    radius and z: a ring, a disc or a tube about the z axis of the frame. A coordinate that is not given is 0. An angle
    that is not given is free. If no angle is given, the orientation is free.

    Parameters
    ----------
    frame : Pose, optional
        Pose of the region's frame in the world; default: identity.
    x, y, z : (float, float) or float, optional
        Bounds of the position in the frame [m].
    radius : (float, float) or float, optional
        Bounds of the distance from the z axis of the frame [m], instead of x and y.
    roll, pitch, yaw : (float, float) or float, optional
        Bounds of the orientation in the frame [rad], about its fixed x, y and z axes, in this order; roll and yaw
        span at most 2π, the pitch is in [−π/2, π/2].

    Raises
    ------
    InputError
        If bounds are not numbers, in the wrong order or out of range; if radius is given together with x or y.

    References
    ----------
    1. D. Berenson, S. Srinivasa, J. Kuffner: Task space regions: a framework for pose-constrained manipulation
       planning. International Journal of Robotics Research, 2011.

    Examples
    --------
    >>> region = GoalRegion(Pose([0.4, -0.3, 0.35]), x=(-0.1, 0.1), y=(-0.2, 0.2))
    >>> region.x
    (-0.1, 0.1)
    """

    frame: Pose = key(read_pose, factory=Pose)
    x: Bounds | None = key(_bounds, default=None)
    y: Bounds | None = key(_bounds, default=None)
    z: Bounds | None = key(_bounds, default=None)
    radius: Bounds | None = key(_bounds, default=None)
    roll: Bounds | None = key(_bounds, default=None)
    pitch: Bounds | None = key(_bounds, default=None)
    yaw: Bounds | None = key(_bounds, default=None)

    def check(self) -> None:
        """Raise InputError if the bounds contradict each other or are out of range."""
        if self.radius is not None:
            if self.x is not None or self.y is not None:
                raise InputError("give either radius, or x and y", "radius")
            if self.radius[0] < 0:
                raise InputError(f"must be lengths >= 0 [m], got {self.radius[0]:g}", "radius")
        for name in ("roll", "yaw"):
            low, high = getattr(self, name) or (0.0, 0.0)
            if high - low > 2 * np.pi + 1e-9:
                raise InputError(f"must span at most 2π [rad], got [{low:g}, {high:g}]", name)
        low, high = self.pitch or (0.0, 0.0)
        if max(-low, high) > np.pi / 2 + 1e-9:
            raise InputError(f"must be in [−π/2, π/2], got [{low:g}, {high:g}]", "pitch")

    @property
    def bounds_orientation(self) -> bool:
        """Whether the region bounds the orientation of the tip."""
        return any(getattr(self, key) is not None for key in _ANGLES)

    def nearest(self, pose: pin.SE3) -> tuple[FloatArray, FloatArray | None]:
        """Project a pose onto the region. Return position (3,) and orientation (3, 3) in the world frame.

        The orientation is None if the region does not bound it, else the one with the smallest rotation angle from the
        pose.
        """
        frame = self.frame.se3
        local = frame.rotation.T @ (pose.translation - frame.translation)
        position: FloatArray = frame.rotation @ self._nearest_position(local) + frame.translation
        if not self.bounds_orientation:
            return position, None
        rotation: FloatArray = frame.rotation @ _nearest_rotation(frame.rotation.T @ pose.rotation, self._angles)
        return position, rotation

    def distance(self, pose: pin.SE3) -> float:
        """Return the distance [m] of a pose from the region, 0 inside; 1 rad counts as `METRES_PER_RADIAN` metres."""
        error = self.error(pose)
        return float(np.sqrt(error @ error))

    def error(self, pose: pin.SE3) -> FloatArray:
        """Return the task space error Δx [m] from a pose to its projection on the region.

        The shape is (3,), or (6,) if the region bounds the orientation; see `TargetPose.error`.
        """
        return error_from(pose, *self.nearest(pose))

    def sample(self, rng: np.random.Generator) -> tuple[FloatArray, FloatArray | None]:
        """Sample a position (3,) and an orientation (3, 3) of the region. A free orientation is None.

        Positions are uniform in the region's volume (or area). Each angle is uniform within its bounds, so rotations
        are not uniform on SO(3).
        """
        frame = self.frame.se3
        if self.radius is None:
            local = rng.uniform(*np.transpose(self._coordinates))
        else:
            radius = np.sqrt(rng.uniform(*np.square(self.radius)))
            angle = rng.uniform(-np.pi, np.pi)
            height = rng.uniform(*self._coordinates[2])
            local = np.array([radius * np.cos(angle), radius * np.sin(angle), height])
        position: FloatArray = frame.rotation @ local + frame.translation
        if not self.bounds_orientation:
            return position, None
        angles = rng.uniform(*np.transpose(self._angles))
        return position, frame.rotation @ pin.rpy.rpyToMatrix(angles)

    @property
    def _coordinates(self) -> tuple[Bounds, Bounds, Bounds]:
        """Bounds of x, y and z [m]."""
        return self.x or _FIXED_AT_ZERO, self.y or _FIXED_AT_ZERO, self.z or _FIXED_AT_ZERO

    @property
    def _angles(self) -> tuple[Bounds, Bounds, Bounds]:
        """Bounds of roll, pitch and yaw [rad]."""
        return self.roll or _FREE[0], self.pitch or _FREE[1], self.yaw or _FREE[2]

    def _nearest_position(self, local: FloatArray) -> FloatArray:
        """Project a position `local: (3,)` onto the region; both positions are in the frame of the region."""
        low, high = np.transpose(self._coordinates)
        if self.radius is None:
            return np.clip(local, low, high)
        length = hypot(local[0], local[1])
        outward = local[:2] / length if length > 0 else np.array([1.0, 0.0])
        return np.array([*np.clip(length, *self.radius) * outward, np.clip(local[2], low[2], high[2])])


class RegionTarget(TargetPose):
    """A task space region as target of inverse kinematics. The error is measured to the nearest pose of the region."""

    def __init__(self, robot: Robot, region: GoalRegion) -> None:
        super().__init__(robot, *region.nearest(region.frame.se3))
        self.region = region

    def error(self, q: FloatArray) -> FloatArray:
        """Return Δx (m,) [m] from the tip at `q: (n,)` to the nearest pose of the region, in world axes."""
        return self.region.error(self.robot.tip_pose(q))

    def nearest_position(self, point: FloatArray) -> FloatArray:
        """Return the position (3,) [m] of the region nearest to a point (3,) [m], both in the world frame."""
        return self.region.nearest(pin.SE3(np.eye(3), point))[0]

    def sample(self, rng: np.random.Generator) -> TargetPose:
        """Sample a target pose of the region."""
        return TargetPose(self.robot, *self.region.sample(rng))


def _nearest_rotation(rotation: FloatArray, bounds: tuple[Bounds, Bounds, Bounds]) -> FloatArray:
    """Return the rotation (3, 3) with roll, pitch and yaw within `bounds` that has the least angle to `rotation`."""
    lower, upper = np.transpose(bounds)
    roll, pitch, yaw = pin.rpy.matrixToRpy(rotation)
    # The two triples of roll, pitch and yaw of this rotation.
    equal_angles = np.array([[roll, pitch, yaw], [roll + np.pi, np.pi - pitch, yaw + np.pi]])
    begins = _brought_within(equal_angles, lower, upper)
    if np.abs(np.sin((begins[0] - equal_angles[0]) / 2)).max() < _SETTLED:
        # The rotation is inside the bounds.
        return rotation
    # Coordinate descent can end in a local minimum at a corner of the bounds. So it starts from all corners, the
    # centre and the clipped angles.
    corners = np.stack(np.meshgrid(*bounds), axis=-1).reshape(-1, 3)
    begins = np.unique(np.vstack([begins, (lower + upper) / 2, corners]), axis=0)
    roll, pitch, yaw = _descended(rotation, begins, lower, upper).T
    found = _rotations_about(2, yaw) @ _rotations_about(1, pitch) @ _rotations_about(0, roll)
    return np.asarray(found[np.einsum("sij,ij->s", found, rotation).argmax()])


def _descended(rotation: FloatArray, angles: FloatArray, lower: FloatArray, upper: FloatArray) -> FloatArray:
    """Minimize the angle to `rotation` by coordinate descent over roll, pitch and yaw, from S start values (S, 3).

    The angle between R and A·R_k(θ)·B is smallest where tr(B Rᵀ A R_k(θ)) = a cos θ + b sin θ + c is largest, that is,
    at θ = atan2(b, a).
    """
    # Indices of the angles that are not fixed.
    (free_axes,) = np.nonzero(lower < upper)
    angles = angles.copy()
    for _ in range(_SWEEPS):
        before = angles.copy()
        for k in free_axes:
            Rx, Ry, Rz = (_rotations_about(axis, angles[:, axis]) for axis in range(3))
            A = (Rz @ Ry, Rz, np.eye(3))[k]
            B = (np.eye(3), Rx, Ry @ Rx)[k]
            BRA = B @ rotation.T @ A
            i, j = (k + 1) % 3, (k + 2) % 3
            best = np.arctan2(BRA[:, i, j] - BRA[:, j, i], BRA[:, i, i] + BRA[:, j, j])
            angles[:, k] = _brought_within(best, lower[k], upper[k])
        if len(free_axes) < 2 or np.abs(angles - before).max() < _SETTLED:
            break
    return angles


def _rotations_about(axis: int, angles: FloatArray) -> FloatArray:
    """Return the rotation matrices (S, 3, 3) by angles (S,) [rad] about the x, y or z axis."""
    i, j = (axis + 1) % 3, (axis + 2) % 3
    rotations = np.zeros((len(angles), 3, 3))
    rotations[:, axis, axis] = 1.0
    rotations[:, i, i] = rotations[:, j, j] = np.cos(angles)
    rotations[:, j, i] = np.sin(angles)
    rotations[:, i, j] = -rotations[:, j, i]
    return rotations


def _brought_within(angles: FloatArray, lower: Any, upper: Any) -> FloatArray:
    """Return the angles in [lower, upper] that are nearest to `angles` modulo 2π [rad]."""
    middle = (lower + upper) / 2
    turned = middle + np.remainder(angles - middle + np.pi, 2 * np.pi) - np.pi
    return np.asarray(np.clip(turned, lower, upper))
