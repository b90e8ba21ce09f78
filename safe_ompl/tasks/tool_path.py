"""Tool paths: lines, arcs, polylines with blends, and splines through poses."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, TypeAlias

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from safe_ompl.common import FloatArray, InputError, finite_array, number, polynomials, shown
from safe_ompl.geometry import Pose, turn_between
from safe_ompl.robot import METRES_PER_RADIAN, Frames

# The least length of a segment; a rotation counts METRES_PER_RADIAN per radian.
_LEAST_SEGMENT = 1e-6  # [m]
# A jump of the tip's direction (a unit vector) by more than this is a corner.
_CORNER_JUMP = 1e-6
# Three points are on a line if the sine of their angle is smaller than this.
_COLLINEAR = 1e-6


@dataclass(frozen=True)
class Arc:
    """A line or a circular arc, along which the tool translates and rotates about one axis at constant rates.

    `centre` is None for a line. For an arc, the point `start` rotates about `centre` by `angle` [rad] about `normal`.
    """

    start: FloatArray
    # The vector from the start to the end of a line (3,) [m].
    displacement: FloatArray
    # Orientation of the tool at the start (3, 3).
    rotation: FloatArray
    # The rotation vector from start to end, in world axes (3,).
    turn: FloatArray
    centre: FloatArray | None = None
    normal: FloatArray | None = None  # (3,) of unit length
    angle: float = 0.0

    @property
    def length(self) -> float:
        """Length of the tip's path [m], or METRES_PER_RADIAN times the angle of its rotation if this is larger."""
        along = np.linalg.norm(self.displacement)
        if self.centre is not None:
            along = self.angle * np.linalg.norm(self.start - self.centre)
        return float(max(along, METRES_PER_RADIAN * np.linalg.norm(self.turn)))

    @property
    def knots(self) -> FloatArray:
        """The first and the last value of the parameter (2,) [m]."""
        return np.array([0.0, self.length])

    def at(self, s: FloatArray) -> Frames:
        """Return the frames at parameters (S,)."""
        share = s / self.length
        rotations = rotated(share[:, None] * self.turn) @ self.rotation
        spins = np.broadcast_to(self.turn / self.length, (len(s), 3))
        if self.centre is None or self.normal is None:
            velocities = np.broadcast_to(self.displacement / self.length, (len(s), 3))
            return Frames(self.start + share[:, None] * self.displacement, rotations, velocities, spins)
        arms = rotated((share * self.angle)[:, None] * self.normal) @ (self.start - self.centre)
        return Frames(self.centre + arms, rotations, self.angle / self.length * np.cross(self.normal, arms), spins)

    def second_derivative_bounds(self, first: FloatArray, last: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the curvature of the circle, and zero."""
        curvature = 0.0
        if self.centre is not None:
            curvature = (self.angle / self.length) ** 2 * float(np.linalg.norm(self.start - self.centre))
        return np.full(len(first), curvature), np.zeros(len(first))


@dataclass(frozen=True)
class PoseSpline:
    """A cubic spline through poses: one spline of the positions, and one of quaternions, which is then normalised.

    Let Q be the spline of quaternions and r = ‖Q‖. Then ‖ω‖ ≤ 2‖Q′‖/r and ‖ω′‖ ≤ 2(‖Q″‖/r + 2(‖Q′‖/r)²).
    """

    # Parameters of the poses (K + 1,) [m], the first one 0.
    knots: FloatArray
    # Coefficients of the powers of s minus the knot before (K, 4, 7).
    pieces: FloatArray

    @classmethod
    def through(cls, poses: Sequence[pin.SE3]) -> PoseSpline:
        """Return the spline through at least two poses; its parameters are the cumulative `pose_distance`."""
        turns = np.array([pin.Quaternion(pose.rotation).coeffs() for pose in poses])
        for k, (one, other) in enumerate(pairwise(poses)):
            # Each rotation has two quaternions. The shortest rotation from the previous pose decides which one is used.
            turn = pin.Quaternion(pin.exp3_quat(turn_between(one.rotation, other.rotation)))
            turns[k + 1] *= np.sign(turns[k + 1] @ (turn * pin.Quaternion(turns[k])).coeffs())
        steps = [pose_distance(one, other) for one, other in pairwise(poses)]
        knots = np.concatenate([[0.0], np.cumsum(steps)])
        values = np.hstack([[pose.translation for pose in poses], turns])
        return cls(knots, polynomials.cubic_spline(knots, values))

    @property
    def length(self) -> float:
        """The last value of the parameter [m]."""
        return float(self.knots[-1])

    def _derivatives(self, s: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        k = np.clip(np.searchsorted(self.knots, s, side="right") - 1, 0, len(self.pieces) - 1)
        u, (a, b, c, d) = (s - self.knots[k])[:, None], np.moveaxis(self.pieces[k], 1, 0)
        return a + u * (b + u * (c + u * d)), b + u * (2 * c + 3 * u * d), 2 * c + 6 * u * d

    def at(self, s: FloatArray) -> Frames:
        """Return the frames at parameters (S,)."""
        value, rate, _ = self._derivatives(s)
        size = np.linalg.norm(value[:, 3:], axis=1, keepdims=True)
        turn, change = value[:, 3:] / size, rate[:, 3:] / size
        x, y, z, w = turn.T
        rows = [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)]
        rows += [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)]
        rows += [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)]
        rotations = np.moveaxis(np.array(rows), 0, 1).reshape(-1, 3, 3)
        # ω is the vector part of 2 q′ q*: the part of q′ along q has none.
        vector, scalar = change[:, :3], change[:, 3:]
        spins = 2 * (w[:, None] * vector - scalar * turn[:, :3] - np.cross(vector, turn[:, :3]))
        return Frames(value[:, :3], rotations, rate[:, :3], spins)

    def second_derivative_bounds(self, first: FloatArray, last: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return bounds of ‖c″‖ and ‖dω/ds‖ (I,), from the second derivatives, which are linear between knots."""
        # The ends are moved slightly inwards. At a knot this selects the piece inside the interval.
        inside = (last - first) * 1e-9
        ends = [self._derivatives(s) for s in (first + inside, last - inside)]
        curvature = np.maximum(*(np.linalg.norm(second[:, :3], axis=1) for _, _, second in ends))
        turn_curvature = np.maximum(*(np.linalg.norm(second[:, 3:], axis=1) for _, _, second in ends))
        rate = np.maximum(*(np.linalg.norm(first_[:, 3:], axis=1) for _, first_, _ in ends)) + turn_curvature * (
            last - first
        )
        size = np.minimum(*(np.linalg.norm(value[:, 3:], axis=1) for value, _, _ in ends)) - rate * (last - first)
        with np.errstate(divide="ignore"):
            angular_acceleration = np.where(size > 0, 2 * (turn_curvature / size + 2 * (rate / size) ** 2), np.inf)
        return curvature * (1 + 1e-6), angular_acceleration * (1 + 1e-6)


Segment: TypeAlias = Arc | PoseSpline
"""A segment of a tool path, s [m] from 0 to `length`; it is infinitely differentiable between its `knots`."""


@dataclass(frozen=True)
class ToolPath:
    """A curve of tip poses in the world frame; its parameter s is the arc length of the tip's path [m].

    Where the tip only rotates, a radian counts METRES_PER_RADIAN. Along splines s is approximately the arc length. The
    tool stops at corners between segments.

    Examples
    --------
    >>> down = [0.0, 1.0, 0.0, 0.0]
    >>> path = ToolPath.line(Pose([0.4, -0.2, 0.4], down), Pose([0.4, 0.2, 0.4], down))
    >>> round(path.length, 3)
    0.4
    """

    segments: tuple[Segment, ...]

    def __post_init__(self) -> None:
        if not self.segments:
            raise InputError("needs at least one segment", "path")
        for k, segment in enumerate(self.segments):
            if not segment.length > _LEAST_SEGMENT:
                raise InputError(f"segment {k} has no length: two poses are the same", "path")

    def __repr__(self) -> str:
        return f"ToolPath({len(self.segments)} segments, {self.length:.4g} m)"

    @property
    def length(self) -> float:
        """The last value of s [m]."""
        return float(sum(segment.length for segment in self.segments))

    @property
    def begins(self) -> FloatArray:
        """Parameters at which segments begin, and the end of the last one (N + 1,) [m]."""
        return np.concatenate([[0.0], np.cumsum([segment.length for segment in self.segments])])

    @property
    def knots(self) -> FloatArray:
        """Parameters [m] between which the curve is smooth, including both ends."""
        begins = self.begins[:-1]
        found = [begin + segment.knots for begin, segment in zip(begins, self.segments, strict=True)]
        return np.unique(np.concatenate(found))

    @property
    def corners(self) -> FloatArray:
        """Parameters (C,) [m] at which the direction of the tip jumps between segments, so that the tip stops."""
        pairs = zip(self.begins[1:-1], self.segments[:-1], self.segments[1:], strict=True)
        return np.array([at for at, one, other in pairs if _turns_sharply(one, other)])

    def at(self, s: ArrayLike) -> Frames:
        """Return the frames at parameters (S,) [m]; at a corner those of the later segment."""
        s = np.asarray(s, dtype=np.float64)
        begins = self.begins
        which = np.clip(np.searchsorted(begins, s, side="right") - 1, 0, len(self.segments) - 1)
        out = Frames(np.empty((len(s), 3)), np.empty((len(s), 3, 3)), np.empty((len(s), 3)), np.empty((len(s), 3)))
        for k in np.unique(which):
            chosen = which == k
            local = np.clip(s[chosen] - begins[k], 0.0, self.segments[k].length)
            for whole, part in zip(out, self.segments[k].at(local), strict=True):
                whole[chosen] = part
        return out

    def second_derivative_bounds(self, first: FloatArray, last: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return bounds of ‖c″‖ [1/m] and ‖dω/ds‖ [rad/m²] on intervals (I,) that have no knot inside."""
        begins, curvature, angular_acceleration = self.begins, np.empty(len(first)), np.empty(len(first))
        which = np.clip(np.searchsorted(begins, (first + last) / 2) - 1, 0, len(self.segments) - 1)
        for k in np.unique(which):
            chosen = which == k
            curvature[chosen], angular_acceleration[chosen] = self.segments[k].second_derivative_bounds(
                first[chosen] - begins[k], last[chosen] - begins[k]
            )
        return curvature, angular_acceleration

    @classmethod
    def line(cls, start: Any, end: Any) -> ToolPath:
        """Return the straight line between two poses, with the shortest rotation at a constant rate.

        For a rotation by half a turn the axis is the one whose first component above 0.1 is positive, in the world
        frame. Poses are Pose, pin.SE3, matrices (4, 4), or objects with `as_matrix`, such as SciPy's RigidTransform.
        """
        return cls.polyline([start, end])

    @classmethod
    def polyline(cls, poses: Sequence[Any], blend: float = 0.0) -> ToolPath:
        """Return straight lines through poses; arcs that begin `blend` [m] before the corners replace them."""
        given, cut = _poses(poses, 2), number("blend", blend, at_least=0.0)
        segments = [_line(one, other) for one, other in pairwise(given)]
        return cls(tuple(_blended(segments, cut) if cut else segments))

    @classmethod
    def arc(cls, start: Any, via: Any, end: Any) -> ToolPath:
        """Return the circular arc from a pose to another pose through a point (3,) or the position of a pose.

        Raises InputError if the three points are on a line.
        """
        first, last = _poses([start, end])
        through = finite_array(via, (3,), "via") if np.shape(via) == (3,) else _poses([via])[0].translation
        return cls((_circle(first, through, last),))

    @classmethod
    def spline(cls, poses: Sequence[Any]) -> ToolPath:
        """Return a cubic spline through poses (see `PoseSpline`)."""
        return cls((PoseSpline.through(_poses(poses, 2)),))

    @classmethod
    def of(cls, thing: Any) -> ToolPath:
        """Convert a ToolPath, poses (two: a line, more: a spline), or SciPy's RigidTransformSpline to a ToolPath.

        Of SciPy's spline 33 poses of each piece are taken.
        """
        if isinstance(thing, ToolPath):
            return thing
        if hasattr(thing, "times") and callable(thing):  # SciPy's RotationSpline of poses
            times = np.asarray(thing.times, dtype=np.float64)
            fine = np.unique(np.concatenate([np.linspace(a, b, 33) for a, b in pairwise(times)]))
            thing = thing(fine)
        given = _poses(thing)
        return cls.polyline(given) if len(given) == 2 else cls.spline(given)


def _turns_sharply(one: Segment, other: Segment) -> bool:
    before, after = one.at(np.array([one.length])), other.at(np.zeros(1))
    jump = float(np.linalg.norm(after.velocities - before.velocities))
    if not before.velocities.any() and not after.velocities.any():
        jump = METRES_PER_RADIAN * float(np.linalg.norm(after.spins - before.spins))
    return jump > _CORNER_JUMP


def pose_distance(one: pin.SE3, other: pin.SE3) -> float:
    """Return the distance √(‖p‖² + c²‖ω‖²) [m] of two poses.

    p is the difference of positions [m], ω the rotation vector [rad] between them, and c METRES_PER_RADIAN.
    """
    turn = turn_between(one.rotation, other.rotation)
    return float(
        np.hypot(np.linalg.norm(other.translation - one.translation), METRES_PER_RADIAN * np.linalg.norm(turn))
    )


def rotated(vectors: FloatArray) -> FloatArray:
    """Return the rotation matrices (S, 3, 3) of rotation vectors (S, 3), by Rodrigues' formula."""
    angle = np.linalg.norm(vectors, axis=1)[:, None, None]
    cross = np.zeros((len(vectors), 3, 3))
    for x in range(3):
        y, z = (x + 1) % 3, (x + 2) % 3
        cross[:, z, y], cross[:, y, z] = vectors[:, x], -vectors[:, x]
    matrices: FloatArray = (
        np.eye(3) + np.sinc(angle / np.pi) * cross + 0.5 * np.sinc(angle / (2 * np.pi)) ** 2 * cross @ cross
    )
    return matrices


def _poses(given: Any, least: int = 1) -> list[pin.SE3]:
    if hasattr(given, "as_matrix"):
        given = given.as_matrix()
    if not isinstance(given, (Sequence, np.ndarray)) or len(given) < least:
        raise InputError(f"must be a sequence of {least} poses or more, got {shown(given)}", "path")
    return [_pose(f"path[{k}]", pose) for k, pose in enumerate(given)]


def _pose(key: str, pose: Any) -> pin.SE3:
    if isinstance(pose, pin.SE3):
        return pose
    if isinstance(pose, Pose):
        return pose.se3
    matrix = finite_array(pose.as_matrix() if hasattr(pose, "as_matrix") else pose, (4, 4), key)
    rotation = matrix[:3, :3]
    if np.abs(rotation @ rotation.T - np.eye(3)).max() > 1e-6 or np.linalg.det(rotation) < 0:
        raise InputError(f"must be a pose: its rotation is not orthonormal, got {shown(rotation.tolist())}", key)
    return pin.SE3(rotation, matrix[:3, 3])


def _line(one: pin.SE3, other: pin.SE3) -> Arc:
    turn = turn_between(one.rotation, other.rotation)
    return Arc(one.translation.copy(), other.translation - one.translation, one.rotation.copy(), turn)


def _circle(first: pin.SE3, via: FloatArray, last: pin.SE3) -> Arc:
    a, b = via - first.translation, last.translation - first.translation
    normal = np.cross(a, b)
    size = float(np.linalg.norm(normal))
    if size <= _COLLINEAR * np.linalg.norm(a) * np.linalg.norm(b):
        raise InputError("the three points of an arc must not be on a line", "path")
    to_centre = (a @ a) * np.cross(b, normal) + (b @ b) * np.cross(normal, a)
    centre = first.translation + to_centre / (2 * size**2)
    normal, arm, end = normal / size, first.translation - centre, last.translation - centre
    angle = float(np.arctan2(normal @ np.cross(arm, end), arm @ end)) % (2 * np.pi)
    turn = turn_between(first.rotation, last.rotation)
    return Arc(first.translation.copy(), np.zeros(3), first.rotation.copy(), turn, centre, normal, angle)


def _blended(lines: Sequence[Arc], cut: float) -> Iterator[Segment]:
    """Yield lines joined by arcs of circles that begin `cut` [m] before corners, or at the middle of short lines."""
    begin = 0.0
    for k, line in enumerate(lines):
        # The length that an arc takes from this line and from the next one [m].
        corner = 0.0  # [m]
        if k + 1 < len(lines):
            back, ahead = line.displacement / line.length, lines[k + 1].displacement / lines[k + 1].length
            if np.linalg.norm(np.cross(back, ahead)) > _COLLINEAR:
                corner = min(cut, 0.5 * line.length, 0.5 * lines[k + 1].length)
        end = line.length - corner
        first, last = (_frame(line, s) for s in (begin, end))
        if end - begin > _LEAST_SEGMENT:
            yield _line(first, last)
        if corner:
            entry, exit_ = last, _frame(lines[k + 1], corner)
            tip, middle = lines[k + 1].start, (entry.translation + exit_.translation) / 2
            half = np.linalg.norm(exit_.translation - entry.translation) / 2
            # The middle of the arc that touches both lines lies between the corner and the middle of the chord.
            out, depth = middle - tip, np.linalg.norm(middle - tip)
            radius = half * np.hypot(half, depth) / depth
            via = tip + out / depth * (np.hypot(radius, corner) - radius)
            yield _circle(entry, via, exit_)
        begin = corner


def _frame(line: Arc, s: float) -> pin.SE3:
    frames = line.at(np.array([s]))
    return pin.SE3(frames.rotations[0], frames.positions[0])
