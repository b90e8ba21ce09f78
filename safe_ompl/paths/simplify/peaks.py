"""Peaks of the danger beside the ends of a path."""

from __future__ import annotations

import numpy as np

from safe_ompl.arrays import FloatArray
from safe_ompl.danger.field import DangerField
from safe_ompl.paths.curve import Curve

_BESIDE, _CLOSELY = 0.4, 0.02  # [rad] so far from the ends peaks are looked for, at samples so close together
_EXCESS = 0.02  # share by which a peak is above what is forced


def peaks_beside_ends(curve: Curve, field: DangerField, forced: float) -> tuple[FloatArray, FloatArray]:
    """Return where danger peaks beside the ends of a path, above what the ends themselves force.

    Parameters
    ----------
    curve : Curve
        The path.
    field : DangerField
        The danger.
    forced : float
        The danger that no path between the ends avoids.

    Returns
    -------
    places : ndarray, shape (K,)
        Arc length of each peak [rad].
    configurations : ndarray, shape (K, n)
    """
    beside = np.arange(0.0, min(_BESIDE, 0.5 * curve.length), _CLOSELY)
    s = np.concatenate([beside, curve.length - beside[::-1]])
    samples = curve.at(s)
    danger = field.values(samples)
    inner = danger[1:-1]
    peak = (inner > (1.0 + _EXCESS) * forced) & (inner >= danger[:-2]) & (inner >= danger[2:])
    return s[1:-1][peak], samples[1:-1][peak]
