"""The kinetostatic danger field of a skeleton of moving link segments (Lacevic & Rocco, T-RO 2013).

A moving point source r at the distance ρ from p, with the velocity v, has the field

    k₁/‖ρ‖ + k₂ (γ ‖v‖/‖ρ‖² + ρ·v/‖ρ‖³),    ρ = p − r.

The first term is the static field. The second term grows with the speed in all directions (γ), and the third with the
velocity towards p. Over a link, whose points move with v(t) = v_a + t(v_b − v_a), the integrals have closed forms
(`danger/moving.pyx`). The third term is the rate of the static field, so that γ = 0 is the danger predicted k₂/k₁
seconds ahead. With γ ≥ 1 the field is never less than the static field. The closed forms are exact to 1e-8 for points
within about twenty link lengths.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from safe_ompl.common import FloatArray, configuration, configurations, finite_array
from safe_ompl.danger import moving
from safe_ompl.danger.field import DangerField
from safe_ompl.danger.static import SkeletonTable
from safe_ompl.robot import plain


class KinetostaticField:
    """Kinetostatic danger field at danger points, aggregate_m w_m KDF(p_m; q, q̇) (Lacevic & Rocco, T-RO 2013).

    KDF = k₁ φ + k₂ (φ̇ + γ I): the static field of the links, its rate, and a term that grows with speed in any
    direction; see `safe_ompl.danger.kinetostatic`. At rest it equals the static danger field.

    Parameters
    ----------
    field : DangerField
        The static field: robot, danger points, weights, aggregate, weighting, k₁, k₂ and γ. With γ ≥ 1 motion never
        makes the danger less than at rest. With γ = 0 the danger is predicted k₂/k₁ ahead.

    Examples
    --------
    >>> field = KinetostaticField(DangerField(Robot.from_example("ur5"), [[0.8, 0.0, 0.5]], k2=0.25))
    >>> q = [0.0, -1.2, 1.4, -1.8, -1.57, 0.0]
    >>> bool(field.value(q, [0.0] * 6) < field.value(q, [1.0] * 6))
    True
    """

    def __init__(self, field: DangerField) -> None:
        self.field, self.k2, self.gamma = field, field.k2, field.gamma
        self._by_length = field.weighting == "length"
        self._skeleton = SkeletonTable(field.robot.kinematics.keypoint_table, field.links, self._by_length)

    def __repr__(self) -> str:
        return f"KinetostaticField({self.field!r}, k2={self.k2:g}, gamma={self.gamma:g})"

    @property
    def lead(self) -> float:
        """k₂/k₁ [s]: the time by which the danger is predicted ahead."""
        return self.k2 / self.field.k1

    def value(self, q: ArrayLike, qd: ArrayLike) -> float:
        """Return the danger at `q: (n,)` with joint velocities `qd: (n,)` [rad/s or m/s].

        Raises InputError if an array has the wrong shape or is not finite, as do the other methods.
        """
        n = self.field.robot.n
        rates = finite_array(qd, (n,), "joint velocities")
        return float(self.values(configuration(q, n)[None], rates[None])[0])

    def values(self, Q: ArrayLike, Qd: ArrayLike) -> FloatArray:
        """Return the danger (B,) at `Q: (B, n)` with joint velocities `Qd: (B, n)`."""
        Q, Qd = self._states(Q, Qd)
        field = self.field.frozen()
        if field.aggregate == "max" and len(field.points):
            dangers: FloatArray = self._highest(field, Q, Qd)[0]
            return dangers
        return field.aggregated(self._fields(field, *field.robot.keypoint_motions(Q, Qd)[:2]))

    def gradients(self, Q: ArrayLike, Qd: ArrayLike) -> tuple[FloatArray, FloatArray]:
        """Return the gradients (B, n) of the danger with respect to the configuration and to the joint velocities.

        Danger points are held fixed; see the notes of `DangerField`.
        """
        return self.values_and_gradients(Q, Qd)[1:]

    def values_and_gradients(self, Q: ArrayLike, Qd: ArrayLike) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return the danger (B,) and its gradients (B, n) with respect to configuration and joint velocities."""
        Q, Qd = self._states(Q, Qd)
        field = self.field.frozen()
        points = field.points
        if not len(points):
            return np.zeros(len(Q)), np.zeros(Q.shape), np.zeros(Q.shape)
        if field.aggregate == "max":
            dangers, best, *motions = self._highest(field, Q, Qd)
            groups = field.groups
            chosen, rates = groups.columns.T[best][:, None], groups.point_weights[best][:, None]
        else:
            *motions, _ = field.robot.keypoint_motions(Q, Qd)
            fields = self._fields(field, *motions)
            chosen, rates, dangers = points[None], field.k1 * field.shares(fields), field.aggregated(fields)
        factors = self.lead, self.lead * self.gamma
        places, velocities = map(plain, motions)
        pulls = moving.gradients(
            places, velocities, field.links, plain(chosen), plain(rates), *factors, self._by_length
        )
        coupling = field.robot.coupling
        joints = plain(coupling.values(Q)), plain(coupling.motions(Qd))
        by_q, by_qd = self._skeleton.keys.motion_gradients(*joints, pulls)
        return dangers, coupling.columns(by_q), coupling.columns(by_qd)

    def _highest(self, field: DangerField, Q: FloatArray, Qd: FloatArray) -> tuple[Any, ...]:
        """Return the largest danger (B,), the index of its point, and key point positions and velocities (B, K, 3)."""
        coupling = field.robot.coupling
        field.count(len(Q), len(field.points))
        joints = plain(coupling.values(Q)), plain(coupling.motions(Qd))
        found: tuple[Any, ...] = moving.highest(
            self._skeleton, *joints, field.groups, self.lead, self.lead * self.gamma
        )
        return found

    def _fields(self, field: DangerField, places: FloatArray, velocities: FloatArray) -> FloatArray:
        """Return the field KDF(p_m), (B, M), at all danger points."""
        field.count(len(places), len(field.points))
        state, isotropic = (plain(places), plain(velocities), field.links, plain(field.points)), self.gamma > 0
        static, ahead, around = moving.link_terms(*state, self._by_length, isotropic)
        with np.errstate(invalid="ignore"):
            # On a segment the field is infinite at any velocity.
            levels: FloatArray = field.k1 * static + self.k2 * (ahead + self.gamma * around)
            return levels

    def _states(self, Q: ArrayLike, Qd: ArrayLike) -> tuple[FloatArray, FloatArray]:
        Q = configurations(Q, self.field.robot.n)
        return Q, finite_array(Qd, Q.shape, "joint velocities")
