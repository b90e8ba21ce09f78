"""The pairs of a geometry model that are near each other at a configuration, by the boxes about their bodies."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from safe_ompl.arrays import FloatArray, IntArray
from safe_ompl.maths.kernels.near_boxes import near_boxes


class NearPairs:
    """A broad phase over the pairs of one geometry model: no pair of two obstacles is ever looked at.

    Parameters
    ----------
    geometry : pin.GeometryModel
        The G bodies.
    data : pin.GeometryData
        Where the bodies are now. It is kept alive.
    pairs : ndarray of int, shape (P, 2)
        The pairs.

    Attributes
    ----------
    margins : ndarray, shape (P,)
        [m] Zero, until others are written here.
    """

    def __init__(self, geometry: pin.GeometryModel, data: pin.GeometryData, pairs: IntArray) -> None:
        self._geometry, self._data = geometry, data
        self._places = _places(data)
        self._pairs = pairs
        self._near = np.empty(len(pairs), dtype=np.intp)
        self.margins: FloatArray = np.zeros(len(pairs))
        self._boxes: FloatArray = np.empty((len(self._places), 6))
        self.take_shapes()

    def take_shapes(self) -> None:
        """Take the boxes about the shapes that the bodies have now."""
        for row, body in zip(self._boxes, self._geometry.geometryObjects, strict=True):
            body.geometry.computeLocalAABB()
            box = body.geometry.aabb_local
            row[:3], row[3:] = (box.max_ + box.min_) / 2, (box.max_ - box.min_) / 2

    def found(self) -> list[int]:
        """Return the pairs that may be nearer than their margins, where the bodies are now; no other is."""
        number = near_boxes(self._places, self._boxes, self._pairs, self.margins, self._near)
        pairs: list[int] = self._near[:number].tolist()
        return pairs


def _places(data: pin.GeometryData) -> FloatArray:
    """Return the places of all bodies as a view (G, 12): rotation, column by column, and translation."""
    if not len(data.oMg):
        return np.empty((0, 12))
    first = data.oMg[0].rotation
    view: FloatArray = np.lib.stride_tricks.as_strided(first, (len(data.oMg), 12), (12 * 8, 8))
    return view
