"""Retreat: the way from an end of a path that is near obstacles, such as a grasp between two fingers, to free space."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from safe_ompl.arrays import FloatArray
from safe_ompl.danger.field import DangerField
from safe_ompl.paths.simplify.constraints import FeasibleSet
from safe_ompl.paths.simplify.obstacle_cost import ObstacleCost

RETREAT_STEP = 0.02  # [rad]
_LONGEST = 1.0  # [rad]
_LEFT = 0.3  # a retreat is over when this share of the cost of its end is left
_EXCESS = 600.0  # weight of danger: at 1.4 times that of the end it costs what a contact costs
_ONSET = 0.8  # share of the end's danger from which a point counts
_STUCK = 0.1  # share of a step: where the best one is shorter, nothing leads on
_FLAT = 1e-9  # share of the largest curvature, or of the slope per radian: less is as good as none
_NEWTON_STEPS, _PRECISION = 30, 1e-9


def retreat(
    end: FloatArray,
    obstacles: ObstacleCost,
    field: DangerField,
    feasible: FeasibleSet,
    stop: Callable[[], bool],
) -> FloatArray:
    """Return the retreat (K, n) from an end of a path to where obstacles and danger are less; K = 1: there is none.

    The steepest descent of what is near, Σ over pairs of link and obstacle, and of what is dangerous, the field of
    the danger points over that of the most dangerous one at the end: w Σ_m (CDF(p_m)/CDF(end) − 0.8)₊². Sums of hinges
    have no kinks, unlike the danger, which is a maximum; and each step is the best of its length for their Gauss-Newton
    model (Nocedal & Wright, ch. 4). So it goes along the floor of the valley between two fingers' obstacles, where
    gradient steps would go from wall to wall.

    Parameters
    ----------
    end : ndarray, shape (n,)
        Where the path begins or ends.
    obstacles : ObstacleCost
        Says what is near, and that the end needs a way out at all. It is anchored anew.
    field : DangerField
        The danger.
    feasible : FeasibleSet
        The joint limits.
    stop : callable
        When it says so, there is none.

    Returns
    -------
    ndarray, shape (K, n)
        `end` first, steps of 0.02 rad. Not yet proven free.
    """
    reference = field.value(end)
    q, way, enough = end, [end], None
    while len(way) * RETREAT_STEP <= _LONGEST and not stop():
        cost, gradient, bends = _model(q, obstacles, field, reference)
        enough = _LEFT * cost if enough is None else enough
        if cost <= enough:
            return np.array(way)
        q = feasible.within(q + _step(gradient, bends.T @ bends))
        if np.linalg.norm(q - way[-1]) < _STUCK * RETREAT_STEP:
            break
        way.append(q)
    return end[None]


def _model(
    q: FloatArray, obstacles: ObstacleCost, field: DangerField, reference: float
) -> tuple[float, FloatArray, FloatArray]:
    """Return what `q: (n,)` costs, the gradient (n,), and vectors v (C, n): it bends like Σ vvᵀ."""
    Q = q[None]
    obstacles.anchor(Q)
    near, slopes, _, bends = obstacles.expansion(Q)
    if not near[0] or not 0 < reference < np.inf:
        return float(near[0]), slopes[0], bends
    _, danger, rises = field.terms_above(Q, _ONSET * reference)
    excess, rises = danger / reference - _ONSET, rises / reference
    return (
        float(near[0] + _EXCESS * excess @ excess),
        slopes[0] + 2.0 * _EXCESS * excess @ rises,
        np.concatenate([bends, np.sqrt(2.0 * _EXCESS) * rises]),
    )


def _step(gradient: FloatArray, curvature: FloatArray) -> FloatArray:
    """Return the step s (n,), no longer than `RETREAT_STEP`, that minimises g·s + ½ sᵀHs.

    It is −(H + λ1)⁻¹g with the least λ ≥ 0 that makes it short enough, which Newton's method on 1/‖s(λ)‖ finds in a few
    steps (Moré & Sorensen 1983).
    """
    bends, directions = np.linalg.eigh(curvature)
    slopes = directions.T @ gradient
    bends = np.maximum(bends, _FLAT * max(bends[-1], float(np.sqrt(slopes @ slopes))))
    shares, shift = slopes / bends if slopes.any() else slopes, 0.0
    for _ in range(_NEWTON_STEPS):
        length = float(np.sqrt(shares @ shares))
        if length <= (1.0 + _PRECISION) * RETREAT_STEP:
            break
        slower = float(shares @ (shares / (bends + shift)))
        shift += (length / RETREAT_STEP - 1.0) * length**2 / slower
        shares = slopes / (bends + shift)
    step: FloatArray = -directions @ shares
    return step
