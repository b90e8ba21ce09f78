"""The kinetostatic danger of a robot that moves: its field at the danger points, the faster the higher."""

from __future__ import annotations

from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from safe_ompl.arrays import FloatArray
from safe_ompl.collision.arguments import configuration, configurations
from safe_ompl.danger.moving_skeleton import JointMotions, MovingSkeleton
from safe_ompl.inputs import finite_array, number
from safe_ompl.maths import kinetostatic as maths

if TYPE_CHECKING:
    from safe_ompl.danger.field import DangerField

LEAD = 0.25  # [s] k₂/k₁ of the authors' own code


class KinetostaticField:
    """Kinetostatic danger field at danger points, aggregate_m w_m KDF(p_m; q, q̇) (Lacevic & Rocco, T-RO 2013).

    KDF = k₁ φ + k₂ (φ̇ + γ I): the static field of the links, its rate, and the part that grows with speed whatever its
    direction; see `safe_ompl.maths.kinetostatic`. At rest it is the static danger field.

    Parameters
    ----------
    field : DangerField
        The static field: robot, danger points, weights, aggregate, weighting and k₁.
    k2 : float, optional
        k₂ ≥ 0; k₂/k₁ is a time [s]. Default: the field's own.
    gamma : float, optional
        γ ≥ 0; default: the field's own. With γ ≥ 1 motion never makes the danger less than at rest; with 0 it is the
        danger predicted k₂/k₁ ahead.

    Attributes
    ----------
    field, k2, gamma
        As given.

    Raises
    ------
    InputError
        If k₂ or γ is negative or not finite.
    """

    def __init__(self, field: DangerField, k2: float | None = None, gamma: float | None = None) -> None:
        self.field = field
        self.k2 = field.k2 if k2 is None else number("k2", k2, at_least=0.0)
        self.gamma = field.gamma if gamma is None else number("gamma", gamma, at_least=0.0)

    def __repr__(self) -> str:
        return f"KinetostaticField({self.field!r}, k2={self.k2:g}, gamma={self.gamma:g})"

    @property
    def lead(self) -> float:
        """k₂/k₁ [s]: how far ahead the danger is predicted."""
        return self.k2 / self.field.k1

    def value(self, q: ArrayLike, qd: ArrayLike) -> float:
        """Return the danger at `q: (n,)` while the joints move at `qd: (n,)` [rad/s or m/s].

        Raises
        ------
        InputError
            If an array has the wrong shape or is not finite; so do the other methods.
        """
        n = self.field.robot.n
        return float(
            self.values(configuration(q, n)[None], finite_array(qd, (n,), "joint velocities")[None])[0]
        )

    def values(self, Q: ArrayLike, Qd: ArrayLike) -> FloatArray:
        """Return the danger (B,) at `Q: (B, n)` while the joints move at `Qd: (B, n)`."""
        Q, Qd = self._states(Q, Qd)
        field, points = self.field, self.field.points_at(Q)
        skeleton = MovingSkeleton.of(self._joints, Q, Qd)
        if field.aggregate != "max" or not points.shape[-2]:
            return field.aggregated(self._fields(skeleton, points))
        field.count(skeleton.keypoints, points)
        highest = maths.highest(
            skeleton.keypoints,
            skeleton.velocities,
            field.segments,
            points,
            np.ones(points.shape[-2]) if field.weights is None else field.weights,
            self.lead,
            self.lead * self.gamma,
            weighting=field.weighting,
        )
        return field.k1 * highest

    def gradients(self, Q: ArrayLike, Qd: ArrayLike) -> tuple[FloatArray, FloatArray]:
        """Return the gradients (B, n) of the danger by the configuration and by the joint velocities.

        Danger points are held where they are; see the notes of `DangerField`.
        """
        return self.values_and_gradients(Q, Qd)[1:]

    def values_and_gradients(self, Q: ArrayLike, Qd: ArrayLike) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return the danger (B,) and its gradients (B, n) by configuration and by joint velocities."""
        Q, Qd = self._states(Q, Qd)
        field, points = self.field, self.field.points_at(Q)
        skeleton = MovingSkeleton.of(self._joints, Q, Qd)
        fields = self._fields(skeleton, points)
        if not fields.size:
            return np.zeros(len(Q)), np.zeros(Q.shape), np.zeros(Q.shape)
        levels = fields if field.weights is None else fields * field.weights
        chosen, rates = field.contributions(levels, points)
        pulls = maths.gradients(
            skeleton.keypoints,
            skeleton.velocities,
            field.segments,
            chosen,
            field.k1 * rates,
            self.lead,
            self.lead * self.gamma,
            weighting=field.weighting,
        )
        return field.aggregated(fields), *skeleton.pull_back(*pulls)

    def _fields(self, skeleton: MovingSkeleton, points: FloatArray) -> FloatArray:
        """Return KDF(p_m), (B, M)."""
        field = self.field
        field.count(skeleton.keypoints, points)
        part = maths.terms(
            skeleton.keypoints,
            skeleton.velocities,
            field.segments,
            points,
            weighting=field.weighting,
            isotropic=self.gamma > 0,
        )
        with np.errstate(invalid="ignore"):  # on a segment: ∞, whatever the motion
            return field.k1 * part.static + self.k2 * (part.directional + self.gamma * part.isotropic)

    def _states(self, Q: ArrayLike, Qd: ArrayLike) -> tuple[FloatArray, FloatArray]:
        n = self.field.robot.n
        Q = configurations(Q, n)
        return Q, finite_array(Qd, Q.shape, "joint velocities")

    @cached_property
    def _joints(self) -> JointMotions:
        return JointMotions(self.field.robot)
