"""Colours of a view: levels of danger from pale to dark red, neutral robots, mixed paints."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from safe_ompl.arrays import FloatArray
from safe_ompl.pictures.style import Colour

Bytes = NDArray[np.uint8]

NEUTRAL: Colour = (0.82, 0.83, 0.85)
START_COLOUR: Colour = (0.55, 0.56, 0.58)
_LEVELS = np.array(
    [(1.0, 0.96, 0.80), (0.99, 0.80, 0.42), (0.94, 0.45, 0.24), (0.72, 0.12, 0.16), (0.36, 0.02, 0.13)]
)
_TIGHT, _ROOMY = 0.004, 0.25  # [m]


def of_levels(levels: FloatArray, most: float) -> Bytes:
    """Return colours (M, 3) of levels of danger (M,): pale at 0, darkest at `most` and above."""
    shares = np.clip(levels / most, 0.0, 1.0) if most > 0 else np.zeros(len(levels))
    stops = np.linspace(0.0, 1.0, len(_LEVELS))
    return as_bytes(np.column_stack([np.interp(shares, stops, channel) for channel in _LEVELS.T]))


def of_gaps(gaps: FloatArray) -> Bytes:
    """Return colours (M, 3) of distances (M,) [m]: pale where there is room, darkest where two bodies almost touch."""
    room = np.log(np.maximum(gaps, _TIGHT) / _TIGHT) / np.log(_ROOMY / _TIGHT)
    return of_levels(1.0 - room, 1.0)


def as_bytes(colours: FloatArray | Colour) -> Bytes:
    """Return colours with values from 0 to 1 as whole numbers from 0 to 255."""
    return np.asarray(np.rint(255.0 * np.clip(colours, 0.0, 1.0)), dtype=np.uint8)


def mixed(colour: Colour, other: Colour, share: float) -> Colour:
    """Return a colour with a share of another one in it."""
    red, green, blue = ((1.0 - share) * a + share * b for a, b in zip(colour, other, strict=True))
    return red, green, blue


def rgb(colour: Colour) -> tuple[int, int, int]:
    """Return a colour as three whole numbers from 0 to 255."""
    red, green, blue = (int(value) for value in as_bytes(colour))
    return red, green, blue
