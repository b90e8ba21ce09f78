"""The danger of a path once more, by its definition: to check what certificates claim of it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import pinocchio as pin

from safe_ompl.arrays import FloatArray
from safe_ompl.robot.robot import Robot
from safe_ompl.scene.scene import Scene

_ROUNDING = 1e-6
_SMALLEST = 1e-5  # [m] intervals in which no key point moves farther are not divided any more
_TINY = 1e-12  # [m]


class PlainDanger:
    """The danger of a robot in a scene, link by link: eq. (4) in the form 2/ℓ·atanh(ℓ/S), and how far it can grow.

    Where no end of a link moves more than δ, less than its distance D from a danger point, its field there grows to
    D/(D − δ) times what it was, at most.

    Parameters
    ----------
    robot : Robot
        The robot.
    scene : Scene
        Has the danger points.
    claim : mapping
        `spacing` of the danger points, `aggregate`, `weighting`, `k1` and `sharpness` of the field.

    Attributes
    ----------
    points, weights : ndarray, shape (M, 3) and (M,)
        The danger points, one at least.
    """

    def __init__(self, robot: Robot, scene: Scene, claim: Mapping[str, Any]) -> None:
        self._robot, self._claim = robot, claim
        self._data = robot.shared.model.createData()
        self.points, self.weights, _ = scene.danger_points(claim["spacing"])
        if not len(self.points):
            self.points, self.weights = np.full((1, 3), 1e9), np.ones(1)

    def exceeded(self, start: FloatArray, delta: FloatArray, limit: float) -> tuple[float, float] | None:
        """Return where on an edge, and by how much, a danger is not proven to keep to a limit; else None."""
        return self.exceeded_along(lambda t: start + t * delta, np.abs(delta), limit)

    def exceeded_along(
        self, place: Callable[[float], FloatArray], steps: FloatArray, limit: float
    ) -> tuple[float, float] | None:
        """Return the same of a motion q(t), t from 0 to 1, along which joints move no faster than `steps: (n,)`."""
        waiting = [(0.5, 0.5)]
        while waiting:
            centre, half = waiting.pop()
            value, bound, moved = self._bounded(place(centre), half * steps)
            if bound <= limit * (1 + _ROUNDING):
                continue
            if value > limit * (1 + _ROUNDING) or moved < _SMALLEST:
                return centre, value
            waiting += [(centre + half / 2, half / 2), (centre - half / 2, half / 2)]
        return None

    def _bounded(self, q: FloatArray, steps: FloatArray) -> tuple[float, float, float]:
        """Return the danger at `q`, its bound while the joints move by `steps`, and how far key points move then."""
        robot, points = self._robot, self.points
        keypoints = robot.keypoints(q)
        moved = self._moved(q, keypoints, steps)
        start, end = (keypoints[robot.segments[:, side], None] for side in (0, 1))  # (L, 1, 3)
        link = end - start
        length = _norm(link)  # (L, 1)
        along = np.clip(
            np.einsum("lmi,lni->lm", points - start, link) / np.maximum(length**2, _TINY), 0.0, 1.0
        )
        distance = _norm(points - start - along[..., None] * link)  # (L, M)
        ends = np.maximum(_norm(points - start) + _norm(points - end), _TINY)
        share = np.minimum(length / ends, 1 - 1e-15)
        field = np.where(length > 1e-6, 2 * np.arctanh(share) / np.maximum(length, _TINY), 2 / ends)
        room = distance - moved[robot.segments].max(axis=1)[:, None]
        grown = np.where(room > 0, field * distance / np.where(room > 0, room, 1.0), np.inf)
        if self._claim["weighting"] == "length":
            slides = float(robot.coupling.reach(steps)[robot.joint_prismatic].sum())
            field, grown = field * length, grown * (length + slides)
        return self.aggregated(field.sum(axis=0)), self.aggregated(grown.sum(axis=0)), float(moved.max())

    def _moved(self, q: FloatArray, keypoints: FloatArray, steps: FloatArray) -> FloatArray:
        """Return how far each key point (K,) can move [m] while the joints move by `steps` from `q`."""
        robot = self._robot
        pin.forwardKinematics(robot.shared.model, self._data, robot.pinocchio_configuration(q))
        joints = list(self._data.oMi)[1:]
        axes = np.array(
            [joint.rotation @ axis for joint, axis in zip(joints, robot.shared.chain.axes, strict=True)]
        )
        arms = keypoints[:, None] - np.array([joint.translation for joint in joints])  # (K, n, 3)
        across = arms - (arms * axes).sum(axis=2)[..., None] * axes
        radii = np.where(robot.joint_prismatic, 1.0, _norm(across)) * robot.joint_keypoint_support
        moved: FloatArray = radii @ robot.coupling.reach(steps)
        return moved

    def aggregated(self, fields: FloatArray) -> float:
        """Return the danger where the robot's field at all danger points is `fields: (M,)`, without k₁ and weights."""
        levels = self._claim["k1"] * self.weights * fields
        if self._claim["aggregate"] == "max":
            return float(levels.max())
        if self._claim["aggregate"] == "mean":
            return float(levels.mean())
        top, sharpness = float(levels.max()), float(self._claim["sharpness"])
        if not np.isfinite(top):
            return top
        return top + float(np.log(np.exp(sharpness * (levels - top)).sum())) / sharpness


def _norm(vectors: FloatArray) -> FloatArray:
    norm: FloatArray = np.sqrt(np.einsum("...i,...i->...", vectors, vectors))
    return norm
