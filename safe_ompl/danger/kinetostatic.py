"""The kinetostatic danger of a robot that moves: its field at the danger points, higher the faster it moves."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from safe_ompl.common import FloatArray, IntArray, configuration, configurations, finite_array, number
from safe_ompl.danger import moving_link_field as maths
from safe_ompl.danger.evaluation import PointGroups
from safe_ompl.danger.kernels import kinetostatic_peak as peak_kernel
from safe_ompl.robot import plain
from safe_ompl.robot.kernels import pull_back_motion

if TYPE_CHECKING:
    from safe_ompl.danger.field import DangerField

LEAD = 0.25  # [s] k₂/k₁ of the authors' own code


class KinetostaticField:
    """Kinetostatic danger field at danger points, aggregate_m w_m KDF(p_m; q, q̇) (Lacevic & Rocco, T-RO 2013).

    KDF = k₁ φ + k₂ (φ̇ + γ I): the static field of the links, its rate, and the part that grows with speed whatever its
    direction; see `safe_ompl.danger.moving_link_field`. At rest it is the static danger field.

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
        field = self.field.frozen()
        groups = field.groups
        if groups is None:
            return field.aggregated(self._fields(*self._motions(Q, Qd), field.points_at(Q)))
        return self._highest(Q, Qd, groups)[0]

    def gradients(self, Q: ArrayLike, Qd: ArrayLike) -> tuple[FloatArray, FloatArray]:
        """Return the gradients (B, n) of the danger by the configuration and by the joint velocities.

        Danger points are held where they are; see the notes of `DangerField`.
        """
        return self.values_and_gradients(Q, Qd)[1:]

    def values_and_gradients(self, Q: ArrayLike, Qd: ArrayLike) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return the danger (B,) and its gradients (B, n) by configuration and by joint velocities."""
        Q, Qd = self._states(Q, Qd)
        field = self.field.frozen()
        groups = field.groups
        if groups is not None:
            dangers, best, (places, velocities) = self._highest(Q, Qd, groups)
            chosen, rates = groups.columns[0].T[best][:, None], groups.charges[0][best][:, None]
        else:
            points = field.points_at(Q)
            places, velocities = self._motions(Q, Qd)
            fields = self._fields(places, velocities, points)
            if not fields.size:
                return np.zeros(len(Q)), np.zeros(Q.shape), np.zeros(Q.shape)
            levels = fields if field.weights is None else fields * field.weights
            chosen, rates = field.contributions(levels, points)
            dangers, rates = field.aggregated(fields), field.k1 * rates
        pulls = maths.gradients(
            places,
            velocities,
            field.segments,
            chosen,
            rates,
            (self.lead, self.lead * self.gamma),
            weighting=field.weighting,
        )
        return dangers, *self._pulled_back(Q, Qd, np.array(pulls))

    def _highest(
        self, Q: FloatArray, Qd: FloatArray, groups: PointGroups
    ) -> tuple[FloatArray, IntArray, FloatArray]:
        """Return the largest danger (B,) of all points, of which one, and key points (2, B, K, 3)."""
        field, tree = self.field, self.field.robot.kinematics
        coupling = field.robot.coupling
        field.count(Q, groups.charges.T)
        return peak_kernel.highest(
            tree.joints,
            tree.keypoints,
            field.segments.pairs,
            plain(coupling.values(Q)),
            plain(coupling.motions(Qd)),
            *groups,
            field.weighting == "length",
            self.lead,
            self.lead * self.gamma,
        )

    def _motions(self, Q: FloatArray, Qd: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return places and velocities (B, K, 3) of the key points."""
        places, velocities, _ = self.field.robot.keypoint_motions(Q, Qd)
        return places, velocities

    def _pulled_back(self, Q: FloatArray, Qd: FloatArray, pulls: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return gradients (B, n) by Q and by Qd from those by key points and their velocities (2, B, K, 3)."""
        tree, coupling = self.field.robot.kinematics, self.field.robot.coupling
        values, rates = plain(coupling.values(Q)), plain(coupling.motions(Qd))
        by_q, by_qd = pull_back_motion(tree.joints, tree.keypoints, values, rates, pulls)
        return coupling.columns(by_q), coupling.columns(by_qd)

    def _fields(self, keypoints: FloatArray, velocities: FloatArray, points: FloatArray) -> FloatArray:
        """Return KDF(p_m), (B, M)."""
        field = self.field
        field.count(keypoints, points)
        part = maths.terms(
            keypoints,
            velocities,
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
