"""The danger of configurations and its gradients, as the compiled kernel computes them."""

from __future__ import annotations

from typing import Any, Literal, TypeAlias

import numpy as np

from safe_ompl.arrays import FloatArray
from safe_ompl.danger.point_groups import PointGroups
from safe_ompl.maths.kernels import danger as kernel
from safe_ompl.maths.kernels import field as field_kernel
from safe_ompl.maths.kernels.groups import BALL, MAXIMUM, MEAN, SOFTMAX
from safe_ompl.maths.segments import Segments
from safe_ompl.robot.joints.kinematic_tree import plain
from safe_ompl.robot.robot import Robot

Aggregate: TypeAlias = Literal["max", "mean", "softmax"]
AGGREGATES: tuple[Aggregate, ...] = ("max", "mean", "softmax")
_KINDS = {"max": MAXIMUM, "mean": MEAN, "softmax": SOFTMAX}
_NO_BALLS: Any = np.empty(0, BALL)


class Evaluation:
    """Danger of a robot at points that are given as kernels read them; nothing is checked.

    Points are (1 or B, 3, M), their charges k₁w (1, M).

    Parameters
    ----------
    robot, segments
        The robot, and the link segments of its skeleton.
    by_length : bool
        Whether links weigh in proportion to their lengths.
    aggregate : {"max", "mean", "softmax"}
    sharpness : float
        β of the softmax.
    tolerance : float
        Relative error that a mean or a softmax over groups of points may have.
    """

    def __init__(
        self,
        robot: Robot,
        segments: Segments,
        *,
        by_length: bool,
        aggregate: Aggregate,
        sharpness: float,
        tolerance: float,
    ) -> None:
        tree = robot.kinematics
        self._robot = robot
        self._skeleton = tree.joints, tree.keypoints, segments.pairs
        self._by_length = by_length
        self._kind = _KINDS[aggregate]
        self._sharpness, self._tolerance = sharpness, tolerance
        self._no_gradients = np.empty((0, len(tree.joints)))

    def values(self, Q: FloatArray, points: FloatArray, charges: FloatArray) -> FloatArray:
        """Return the danger (B,) at `Q: (B, n)`."""
        return self._danger(self._joint_values(Q), points, charges, _NO_BALLS, self._no_gradients)

    def values_and_gradients(
        self, Q: FloatArray, points: FloatArray, charges: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Return the danger (B,) and its gradients (B, n) at `Q: (B, n)`."""
        return self._sloped(Q, points, charges, _NO_BALLS)

    def grouped_values(self, Q: FloatArray, groups: PointGroups) -> FloatArray:
        """Return `values` at points in groups, without looking at all of them."""
        return self._danger(self._joint_values(Q), *groups, self._no_gradients)

    def grouped_values_and_gradients(
        self, Q: FloatArray, groups: PointGroups
    ) -> tuple[FloatArray, FloatArray]:
        """Return `values_and_gradients` at points in groups, without looking at all of them."""
        return self._sloped(Q, *groups)

    def levels(self, Q: FloatArray, points: FloatArray, charges: FloatArray) -> FloatArray:
        """Return k₁w CDF(p) of each point, (B, M), at `Q: (B, n)`."""
        keypoints = self._robot.keypoints_batch(Q)
        return charges * field_kernel.fields(keypoints, self._skeleton[2], points, self._by_length)

    def aggregated(self, levels: FloatArray) -> FloatArray:
        """Return the danger (B,) of levels (B, M); zero where there are none."""
        if not levels.shape[1]:
            return np.zeros(len(levels))
        return kernel.aggregates(plain(levels), self._kind, self._sharpness)

    def shares(self, levels: FloatArray) -> FloatArray:
        """Return the derivatives (B, M) of the danger by levels (B, M)."""
        return kernel.all_shares(levels, self._kind, self._sharpness)

    def _joint_values(self, Q: FloatArray) -> FloatArray:
        return plain(self._robot.coupling.values(Q))

    def _sloped(
        self, Q: FloatArray, points: FloatArray, charges: FloatArray, balls: Any
    ) -> tuple[FloatArray, FloatArray]:
        values = self._joint_values(Q)
        gradients = np.empty(values.shape)
        dangers = self._danger(values, points, charges, balls, gradients)
        return dangers, self._robot.coupling.columns(gradients)

    def _danger(
        self,
        values: FloatArray,
        points: FloatArray,
        charges: FloatArray,
        balls: Any,
        gradients: FloatArray,
    ) -> FloatArray:
        """Return the danger (B,) at `values: (B, m)` of the joints, and write its gradients (B or 0, m)."""
        joints, keys, links = self._skeleton
        found: FloatArray = kernel.dangers(
            joints,
            keys,
            links,
            values,
            points,
            charges,
            balls,
            self._by_length,
            self._kind,
            self._sharpness,
            self._tolerance,
            gradients,
        )
        return found
