"""Upper bounds of the danger of a link between two configurations at which it is known (`docs/mathematics.md` §4).

All bounds speak of a segment whose points move smoothly for a time h, none of them faster than V or with more
acceleration than A, and of its unit-weighted field u = ∫₀¹ dτ/ρ_τ at a point p, ρ_τ the distance of p from the
point τ of the segment.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from safe_ompl.arrays import FloatArray
from safe_ompl.maths.field import segment_bounds


class Ends(NamedTuple):
    """What is known of segments at one end of each interval: fields and distances, (I, L, M)."""

    fields: FloatArray
    distances: FloatArray


def chords(
    first: Ends, last: Ends, duration: FloatArray, speed: FloatArray, acceleration: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return the values at both ends of straight lines that lie above u(t) throughout the intervals.

    Of two bounds the lower one is taken. Seen from the nearer end no point moves farther than δ = Vh/2, so
    u ≤ U = max u·D/(D − δ) over both ends (`segment_bounds`): a level line. And along a curve 1/ρ has the second
    derivative vᵀ∇²(1/ρ)v + ∇(1/ρ)·a ≥ −v²/ρ³ − a/ρ², for ∇²(1/ρ) has the eigenvalues 2/ρ³ and −1/ρ³. As ρ never falls
    below D̲ = (D₁ + D₂ − Vh)/2, u'' ≥ −U(V²/D̲² + A/D̲), and u stays below the chord from u₁ to u₂ raised by

        U (V²/D̲² + A/D̲) h²/8.

    The first bound is linear in h, the second quadratic: near a smooth peak it needs a fifth of the intervals.

    Parameters
    ----------
    first, last : Ends
        Where the intervals begin and end.
    duration : ndarray, shape (I,)
        h.
    speed, acceleration : ndarray, shape (I, L)
        V [m] and A [m].

    Returns
    -------
    two ndarrays, shape (I, L, M)
        +inf where the segment may reach the point.
    """
    h = duration[:, None, None]
    path = speed[..., None] * h
    ceiling = np.maximum(segment_bounds(*first, path / 2), segment_bounds(*last, path / 2))
    nearest = (first.distances + last.distances - path) / 2
    apart = nearest > 0
    room = np.where(apart, nearest, 1.0)
    curvature = np.where(apart, (speed[..., None] / room) ** 2 + acceleration[..., None] / room, np.inf)
    with np.errstate(invalid="ignore"):  # ∞·0 in an interval of no length: taken as unknown
        rise = ceiling * curvature * (h * h / 8)
    straight = np.maximum(first.fields, last.fields) + rise < ceiling
    return (
        np.where(straight, first.fields + rise, ceiling),
        np.where(straight, last.fields + rise, ceiling),
    )
