"""The pairs of a geometry model that are near each other at a configuration, by the boxes about their bodies."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
import pinocchio as pin
from numpy.lib.stride_tricks import as_strided

from safe_ompl.arrays import FloatArray, IntArray
from safe_ompl.maths.kernels.near_boxes import near_boxes

_PROBE = pin.SE3(pin.rpy.rpyToMatrix(0.3, 0.5, 0.7), np.array([1.0, 2.0, 3.0]))


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
        self.take_shapes(range(len(self._boxes)))

    def take_shapes(self, bodies: Iterable[int]) -> None:
        """Take the boxes about the shapes that some bodies have now."""
        for index in bodies:
            row, shape = self._boxes[index], self._geometry.geometryObjects[index].geometry
            shape.computeLocalAABB()
            box = shape.aabb_local
            row[:3], row[3:] = (box.max_ + box.min_) / 2, (box.max_ - box.min_) / 2

    def found(self) -> list[int]:
        """Return the pairs that may be nearer than their margins, where the bodies are now; no other is."""
        number = near_boxes(self._places, self._boxes, self._pairs, self.margins, self._near)
        if not number:
            return []
        pairs: list[int] = self._near[:number].tolist()
        return pairs


def _places(data: pin.GeometryData) -> FloatArray:
    """Return the places of all bodies as a view (G, 12): rotation, column by column, and translation.

    Raises
    ------
    RuntimeError
        If Pinocchio keeps them in memory otherwise than the view takes for granted.
    """
    number = len(data.oMg)
    if not number:
        return np.empty((0, 12))
    view: FloatArray = as_strided(data.oMg[0].rotation, (number, 12), (12 * 8, 8))
    kept = data.oMg[number - 1].copy()
    data.oMg[number - 1] = _PROBE
    as_read = view[-1].copy()
    data.oMg[number - 1] = kept
    if not np.array_equal(as_read, [*_PROBE.rotation.T.ravel(), *_PROBE.translation]):
        raise RuntimeError("this version of Pinocchio keeps the places of bodies in another layout")
    return view
