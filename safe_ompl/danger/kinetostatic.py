"""The kinetostatic danger field of a skeleton of moving link segments (Lacevic & Rocco, T-RO 2013).

A moving point source r at the distance ρ from p, with the velocity v, has the field

    k₁/‖ρ‖ + k₂ (γ ‖v‖/‖ρ‖² + ρ·v/‖ρ‖³),    ρ = p − r:

its static field, more of it the faster it is (γ), and more of it where it is headed. Over a link, whose points move
with v(t) = v_a + t(v_b − v_a), the integrals are closed (`safe_ompl.danger.kernels.kinetostatic`). The last one is the
rate of the static field, so that γ = 0 is the danger predicted k₂/k₁ seconds ahead; γ ≥ 1 keeps the whole no less than
the static field. They are exact to 1e-8 for points that are no farther than some twenty lengths from a link.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from safe_ompl.common import FloatArray, IntArray, configuration, finite_array, number
from safe_ompl.danger.kernels import kinetostatic as kernel
from safe_ompl.danger.kernels import kinetostatic_peak as peak_kernel
from safe_ompl.danger.kernels.groups import Points
from safe_ompl.danger.link_field import Segments, Weighting, by_length
from safe_ompl.robot import plain
from safe_ompl.robot.kernels import pull_back_motion

if TYPE_CHECKING:
    from safe_ompl.danger.field import DangerField

LEAD = 0.25  # [s] k₂/k₁ of the authors' own code


class Terms(NamedTuple):
    """The parts of the field at points, each (B, M): static ∫1/‖ρ‖, directional ∫ρ·v/‖ρ‖³, isotropic ∫‖v‖/‖ρ‖²."""

    static: FloatArray
    directional: FloatArray
    isotropic: FloatArray


def terms(
    keypoints: FloatArray,
    velocities: FloatArray,
    segments: Segments,
    points: FloatArray,
    *,
    weighting: Weighting = "unit",
    isotropic: bool = True,
) -> Terms:
    """Return the three parts of the kinetostatic field, summed over the links; +inf on a segment.

    Parameters
    ----------
    keypoints, velocities : ndarray, shape (B, K, 3)
        Key points [m] and their velocities [m/s].
    segments : Segments
        The links.
    points : ndarray, shape (M, 3) or (B, M, 3)
        Field points [m].
    weighting : {"unit", "length"}
        As for `safe_ompl.danger.link_field.field`.
    isotropic : bool
        Whether the isotropic part is wanted; it is zero otherwise, and a third of the time is saved.
    """
    state = plain(keypoints), plain(velocities), segments.pairs, _rows(points)
    return Terms(*kernel.link_terms(*state, by_length(weighting), isotropic))


def gradients(
    keypoints: FloatArray,
    velocities: FloatArray,
    segments: Segments,
    points: FloatArray,
    weights: FloatArray,
    factors: tuple[float, float],
    *,
    weighting: Weighting = "unit",
) -> tuple[FloatArray, FloatArray]:
    """Return the gradients of Σ_m w_m (static + a·directional + b·isotropic)_m by the key points and their velocities.

    `weights: (B, M)` are w, `factors` a and b [s]; the points are held fixed, and those on a segment contribute
    nothing. The rest is as for `terms`; returned are two arrays (B, K, 3).
    """
    state = plain(keypoints), plain(velocities), segments.pairs, _rows(points)
    ahead, spread = map(float, factors)
    found = kernel.pulls(*state, plain(weights), ahead, spread, by_length(weighting))
    return found[0], found[1]


def _rows(points: FloatArray) -> FloatArray:
    """Return points (M, 3) or (B, M, 3) as (1 or B, M, 3), in C order."""
    return plain(points if points.ndim == 3 else points[None])


class KinetostaticField:
    """Kinetostatic danger field at danger points, aggregate_m w_m KDF(p_m; q, q̇) (Lacevic & Rocco, T-RO 2013).

    KDF = k₁ φ + k₂ (φ̇ + γ I): the static field of the links, its rate, and the part that grows with speed whatever its
    direction; see `safe_ompl.danger.kinetostatic`. At rest it is the static danger field.

    Parameters
    ----------
    field : DangerField
        The static field: robot, danger points, weights, aggregate, weighting and k₁.
    k2 : float, optional
        k₂ ≥ 0; k₂/k₁ is a time [s]. Default: the field's own.
    gamma : float, optional
        γ ≥ 0; default: the field's own. With γ ≥ 1 motion never makes the danger less than at rest; with 0 it is the
        danger predicted k₂/k₁ ahead.
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

        Raises InputError if an array has the wrong shape or is not finite; so do the other methods.
        """
        n = self.field.robot.n
        rates = finite_array(qd, (n,), "joint velocities")
        return float(self.values(configuration(q, n)[None], rates[None])[0])

    def values(self, Q: ArrayLike, Qd: ArrayLike) -> FloatArray:
        """Return the danger (B,) at `Q: (B, n)` while the joints move at `Qd: (B, n)`."""
        Q, Qd = self._states(Q, Qd)
        field = self.field.frozen()
        if field.groups is None:
            return field.aggregated(self._fields(*self._motions(Q, Qd), field.points_at(Q)))
        return self._highest(Q, Qd, field.groups)[0]

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
        factors = self.lead, self.lead * self.gamma
        pulls = gradients(places, velocities, field.segments, chosen, rates, factors, weighting=field.weighting)
        tree, coupling = field.robot.kinematics, field.robot.coupling
        joints = plain(coupling.values(Q)), plain(coupling.motions(Qd))
        by_q, by_qd = pull_back_motion(tree.joints, tree.keypoints, *joints, np.array(pulls))
        return dangers, coupling.columns(by_q), coupling.columns(by_qd)

    def _highest(self, Q: FloatArray, Qd: FloatArray, groups: Points) -> tuple[FloatArray, IntArray, FloatArray]:
        """Return the largest danger (B,) of all points, of which one, and key points (2, B, K, 3)."""
        field, coupling = self.field, self.field.robot.coupling
        field.count(Q, groups.charges.T)
        joints = plain(coupling.values(Q)), plain(coupling.motions(Qd))
        return peak_kernel.highest(field._evaluation.tables, *joints, groups, self.lead, self.lead * self.gamma)

    def _motions(self, Q: FloatArray, Qd: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return places and velocities (B, K, 3) of the key points."""
        return self.field.robot.keypoint_motions(Q, Qd)[:2]

    def _fields(self, keypoints: FloatArray, velocities: FloatArray, points: FloatArray) -> FloatArray:
        """Return KDF(p_m), (B, M)."""
        field, isotropic = self.field, self.gamma > 0
        field.count(keypoints, points)
        part = terms(keypoints, velocities, field.segments, points, weighting=field.weighting, isotropic=isotropic)
        with np.errstate(invalid="ignore"):  # on a segment: ∞, whatever the motion
            return field.k1 * part.static + self.k2 * (part.directional + self.gamma * part.isotropic)

    def _states(self, Q: ArrayLike, Qd: ArrayLike) -> tuple[FloatArray, FloatArray]:
        Q = self.field._batch(Q)
        return Q, finite_array(Qd, Q.shape, "joint velocities")
