"""Upper bounds of the kinetostatic danger over cells of a motion (`docs/mathematics.md` §9).

A cell is a piece of a curve q(s), half of it h long on either side of its centre. There no point of a link moves by
more than V with s, nor with more than A along s (‖x′‖ ≤ V, ‖x″‖ ≤ A). With D the distance of p from the link at the
centre no point of the link is nearer to p than R = D − Vh in the cell, so that its field is below U = φD/R. As 1/ρ² and
1/ρ³ are below 1/Rρ and 1/R²ρ there, and as ∇²(1/ρ) has the eigenvalues 2/ρ³ and −1/ρ³,

    |φ″| ≤ B,    |I′| ≤ B,    B = U (2V²/R² + A/R),    for φ′ = ∫ρ·x′/ρ³ and I = ∫‖x′‖/ρ² by s,

    φ ≤ min(U, φ + h|φ′| + h²B/2),    φ′ + γI ≤ φ′ + γI + (1 + γ) h B,    both sides' right at the centre,

and whatever the motion, φ′ + γI ≤ (1 + γ) U V/R. Most danger points of a scene are so far away that the last bound is
enough, or even φ ≤ U ≤ 1/R: they take no closed forms.
"""

from __future__ import annotations

from math import inf, sqrt

import numpy as np

from safe_ompl.common import FloatArray, IntArray, compiled
from safe_ompl.danger.kernels.kinetostatic import link_parts

_ROUNDING = 1e-7  # relative, of closed forms
_ZERO = 1e-30


@compiled
def cell_bounds(
    keypoints: FloatArray,
    velocities: FloatArray,
    start: IntArray,
    end: IntArray,
    points: FloatArray,
    speeds: FloatArray,
    accelerations: FloatArray,
    halves: FloatArray,
    strokes: FloatArray,
    gamma: float,
    by_length: bool,
    rates: FloatArray,
    enough: FloatArray,
) -> FloatArray:
    """Return upper bounds of φ and of φ′ + γI over cells, (2, N, M), summed over links; +inf where p may be reached.

    Parameters
    ----------
    keypoints, velocities : (N, K, 3)
        At the centres; velocities by s.
    start, end : (L,)
        Key points of the links.
    points : (M, 3)
    speeds, accelerations : (N, K)
        V and A of the key points in the cells.
    halves, strokes : (N,)
        h, and how fast links may become longer with s.
    gamma : float
    by_length : bool
        Whether links weigh in proportion to their lengths.
    rates : (N,)
        ṡ and
    enough : (M,)
        where φ + ṡ(φ′ + γI) is below this by a cheaper bound, this bound stands.
    """
    N, M = len(keypoints), len(points)
    out = np.zeros((2, N, M))
    w, D, u, v = np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    for b in range(N):
        h = halves[b]
        for p in range(M):
            for detail in range(3):
                level, push = 0.0, 0.0
                for k in range(len(start)):
                    i, j = start[k], end[k]
                    for x in range(3):
                        w[x] = keypoints[b, j, x] - keypoints[b, i, x]
                        u[x] = points[p, x] - keypoints[b, i, x]
                    squared = w[0] * w[0] + w[1] * w[1] + w[2] * w[2]
                    t = (u[0] * w[0] + u[1] * w[1] + u[2] * w[2]) / max(squared, _ZERO)
                    t = min(1.0, max(0.0, t))
                    away = sqrt((u[0] - t * w[0]) ** 2 + (u[1] - t * w[1]) ** 2 + (u[2] - t * w[2]) ** 2)
                    V, A = max(speeds[b, i], speeds[b, j]), max(accelerations[b, i], accelerations[b, j])
                    near = away - V * h
                    if near <= 0.0:
                        level, push = inf, inf
                        break
                    field, most = 1 / near, 1 / near
                    swift = (1 + gamma) * most * V / near
                    if detail > 0:
                        va, vb = velocities[b, i], velocities[b, j]
                        for x in range(3):
                            D[x] = vb[x] - va[x]
                            v[x] = points[p, x] - keypoints[b, j, x]
                        phi, rate, iso = link_parts(u, v, w, va, vb, D, detail == 2 and gamma > 0)
                        most = min(most, phi * away / near)
                        bend = most * (2 * V * V / (near * near) + A / near)
                        field = min(most, phi + h * abs(rate) + h * h * bend / 2)
                        swift = (1 + gamma) * most * V / near
                        if detail == 2 or gamma == 0:
                            size = abs(rate) + gamma * iso
                            swift = min(swift, rate + gamma * iso + (1 + gamma) * h * bend + _ROUNDING * size)
                    low = high = 1.0
                    if by_length:
                        low, high = max(0.0, sqrt(squared) - strokes[b] * h), sqrt(squared) + strokes[b] * h
                    level += high * field
                    push += swift * (high if swift > 0 else low)
                out[0, b, p] = level * (1 + _ROUNDING)
                out[1, b, p] = push
                if level == inf or (detail == 1 and gamma == 0):
                    break
                if out[0, b, p] + rates[b] * push <= enough[p]:
                    break
    return out
