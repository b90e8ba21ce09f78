"""The danger field of a robot at any points of its workspace (paper §3, eq. 5–8)."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from safe_ompl.common import (
    Counts,
    FloatArray,
    InputError,
    configuration,
    configurations,
    finite_array,
    positive,
)
from safe_ompl.danger import link_field as maths
from safe_ompl.danger.link_field import Segments, Weighting, check_weighting
from safe_ompl.robot import Robot


class RobotField:
    """The field of a robot's link segments, CDF(p; q) = Σ_l k₁ ∫ dt/‖p − r_t‖.

    Parameters
    ----------
    robot : Robot
        Gives the key points and segments of the skeleton.
    weighting : {"unit", "length"}
        Every link weighs the same (eq. 4), or in proportion to its length (eq. 1).
    k1 : float
        k₁ > 0 of the elementary field (6).
    counts : Counts, optional
        Where evaluations are counted.

    Raises
    ------
    InputError
        If the robot has no links; if `weighting` is unknown; if `k1` is not positive.
    """

    def __init__(
        self, robot: Robot, weighting: Weighting = "unit", k1: float = 1.0, counts: Counts | None = None
    ) -> None:
        check_weighting(weighting)
        if not len(robot.segments):
            raise InputError(
                f"{robot.name!r} has no link of any length for a danger; give a tip beyond its joints"
            )
        self.robot = robot
        self.weighting = weighting
        self.k1 = positive(k1, "k1")
        self.counts = Counts() if counts is None else counts
        self._segments = Segments(robot.segments, _constant_lengths(robot))

    @property
    def segments(self) -> Segments:
        """The link segments; their lengths are None where a prismatic joint may change them."""
        return self._segments

    def field(self, q: ArrayLike, points: ArrayLike) -> FloatArray:
        """Return the field CDF(p), (M,), of the robot at `q: (n,)` at any `points: (M, 3)` [m], unweighted.

        Raises
        ------
        InputError
            If `q` or `points` has the wrong shape or is not finite; so do the other methods of this kind.
        """
        values: FloatArray = self._field(*self._scene(q, points))[0]
        return values

    def workspace_gradient(self, q: ArrayLike, points: ArrayLike) -> FloatArray:
        """Return the gradient ∇_p CDF(p), (M, 3), of the field at `points: (M, 3)` [m]; zero on a segment."""
        return self._workspace_gradient(*self._scene(q, points))

    def vector(self, q: ArrayLike, points: ArrayLike) -> FloatArray:
        """Return the vector field (8), (M, 3), at `points: (M, 3)` [m]: CDF(p) long, towards the robot."""
        return self._vector(*self._scene(q, points))

    def count(self, keypoints: FloatArray, points: FloatArray) -> None:
        """Count an evaluation of the points at every configuration."""
        self._count(len(keypoints), points.shape[-2])

    def _count(self, configurations: int, points: int) -> None:
        self.counts.field_configurations += configurations
        self.counts.field_points += configurations * points

    def _single(self, q: ArrayLike) -> FloatArray:
        return configuration(q, self.robot.n)[None]

    def _batch(self, Q: ArrayLike) -> FloatArray:
        return configurations(Q, self.robot.n)

    def _scene(self, q: ArrayLike, points: ArrayLike) -> tuple[FloatArray, FloatArray]:
        """Return key points (1, K, 3) and field points (M, 3), and count them."""
        keypoints = self.robot.keypoints_batch(self._single(q))
        checked = finite_array(points, (None, 3), "points")
        self.count(keypoints, checked)
        return keypoints, checked

    def _field(self, keypoints: FloatArray, points: FloatArray) -> FloatArray:
        return maths.field(keypoints, self._segments, points, weighting=self.weighting, k1=self.k1)

    def _workspace_gradient(self, keypoints: FloatArray, points: FloatArray) -> FloatArray:
        weighting, k1 = self.weighting, self.k1
        gradient = maths.workspace_gradient(keypoints, self._segments, points, weighting=weighting, k1=k1)
        return gradient.reshape(-1, 3)

    def _vector(self, keypoints: FloatArray, points: FloatArray) -> FloatArray:
        return maths.vector_field(
            self._field(keypoints, points)[0], self._workspace_gradient(keypoints, points)
        )


def _constant_lengths(robot: Robot) -> FloatArray | None:
    """Return the lengths (L,) [m] of the segments, or None where a prismatic joint may change them."""
    if robot.joint_prismatic.any():
        return None
    start, end = robot.keypoints(np.zeros(robot.n))[robot.segments.T]
    lengths: FloatArray = np.linalg.norm(end - start, axis=-1)
    return lengths
