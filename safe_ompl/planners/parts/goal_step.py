"""The joint step towards a goal in the workspace, with the paper's own gains."""

from __future__ import annotations

import numpy as np

from safe_ompl.arrays import FloatArray
from safe_ompl.danger.field import DangerField
from safe_ompl.robot.inverse_kinematics import Place


def printed_step(
    place: Place, q: FloatArray, k1: float, k2: float, field: DangerField | None, *, transpose: bool = False
) -> FloatArray:
    """Return Δq (n,) of EXTEND_TOWARDS_GOAL, k₂ [J†Δx + (I − J†J)Δq₀], with Δq₀ = k₁ Σ_j Σ_i J_ijᵀ CDF(r_j).

    J† is the pseudoinverse, without damping; where the paper prints Jᵀ in its place, its text says J†. The sum goes
    over all danger points and, as in the paper's own runs, the distal ends of all links.

    Parameters
    ----------
    place : Place
        Where the tip is to go.
    q : ndarray, shape (n,)
        q_old [rad or m].
    k1, k2 : float
        Gains.
    field : DangerField or None
        Gives the vectors CDF(r_j), eq. (8); without it there is no posture motion.
    transpose : bool
        Return k₂ JᵀΔx instead, as the classical JT-RRT.
    """
    jacobian, error = place.jacobian(q), place.error(q)
    if transpose:
        step: FloatArray = k2 * (jacobian.T @ error)
        return step
    inverse = np.linalg.pinv(jacobian)
    step = inverse @ error
    if k1 and field is not None:
        posture = k1 * field.push(q)
        if np.isfinite(posture).all():  # on a danger point the field is infinite
            step += posture - inverse @ (jacobian @ posture)
    return k2 * step


def shortened(step: FloatArray, largest: float) -> FloatArray:
    """Return a step (n,), shortened to a norm of `largest` if it is longer [rad or m]."""
    length = float(np.sqrt(step @ step))
    return step * (largest / length) if length > largest else step
