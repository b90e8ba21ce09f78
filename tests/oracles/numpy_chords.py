"""Lines above the field of moving links, in NumPy's passes, as printed in `docs/mathematics.md` §4."""

import numpy as np

from safe_ompl.danger import segment_bounds


def numpy_chords(first, last, h, speed, acceleration):
    """Return both ends of the line of each link at each point, (L, M); speed and acceleration (L, 1)."""
    ceiling = np.maximum(segment_bounds(*first, speed * h / 2), segment_bounds(*last, speed * h / 2))
    nearest = (first.distances + last.distances - speed * h) / 2
    apart = nearest > 0
    room = np.where(apart, nearest, 1.0)
    curvature = np.where(apart, (speed / room) ** 2 + acceleration / room, np.inf)
    with np.errstate(invalid="ignore"):  # ∞·0 in an interval of no length: taken as unknown
        rise = ceiling * curvature * (h * h / 8)
    bent = np.maximum(first.fields, last.fields) + rise < ceiling
    return np.where(bent, first.fields + rise, ceiling), np.where(bent, last.fields + rise, ceiling)
