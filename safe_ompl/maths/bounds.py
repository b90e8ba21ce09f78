"""Upper bounds of the danger of a link between two configurations at which it is known (`docs/mathematics.md` §4).

All bounds speak of a segment whose points move smoothly for a time h, none of them faster than V or with more
acceleration than A, and of its unit-weighted field u = ∫₀¹ dτ/ρ_τ at a point p, ρ_τ the distance of p from the
point τ of the segment.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from safe_ompl.arrays import FloatArray
from safe_ompl.maths.kernels import chords as kernel


class Ends(NamedTuple):
    """What is known of segments at one end of an interval: fields and distances, (L, M)."""

    fields: FloatArray
    distances: FloatArray


def chords(
    first: Ends,
    last: Ends,
    duration: float,
    speed: FloatArray,
    acceleration: FloatArray,
    lengths: FloatArray,
) -> FloatArray:
    """Return the ends of straight lines that lie above Σ_l length_l·u_l(t) throughout an interval.

    Of two bounds of each u the lower one is taken. Seen from the nearer end no point moves farther than δ = Vh/2, so
    u ≤ U = max u·D/(D − δ) over both ends (`segment_bounds`): a level line. And along a curve 1/ρ has the second
    derivative vᵀ∇²(1/ρ)v + ∇(1/ρ)·a ≥ −v²/ρ³ − a/ρ², for ∇²(1/ρ) has the eigenvalues 2/ρ³ and −1/ρ³. As ρ never falls
    below D̲ = (D₁ + D₂ − Vh)/2, u'' ≥ −U(V²/D̲² + A/D̲), and u stays below the chord from u₁ to u₂ raised by

        U (V²/D̲² + A/D̲) h²/8.

    The first bound is linear in h, the second quadratic: near a smooth peak it needs a fifth of the intervals.

    Parameters
    ----------
    first, last : Ends
        Where the interval begins and ends; arrays as `segment_fields` and `segment_distances` return them.
    duration : float
        h.
    speed, acceleration : ndarray, shape (L,)
        V [m] and A [m].
    lengths : ndarray, shape (L,)
        What the field of each segment is multiplied by: 1, or at least its length [m] throughout the interval.

    Returns
    -------
    ndarray, shape (2, M)
        The lines at the beginning and at the end; +inf where a segment may reach the point.
    """
    moves = np.ascontiguousarray(speed), np.ascontiguousarray(acceleration)
    return kernel.chords(*first, *last, duration, *moves, lengths)
