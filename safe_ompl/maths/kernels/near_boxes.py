"""Pairs of boxes that may be near each other: a broad phase (separating axes: Gottschalk, Lin & Manocha 1996).

Two boxes are apart if their shadows on some axis are. Looked at are the axes of the world, and of both boxes.
"""

from __future__ import annotations

import numpy as np

from safe_ompl.arrays import FloatArray, IntArray
from safe_ompl.maths.kernels.compiled import compiled


@compiled
def near_boxes(
    places: FloatArray, boxes: FloatArray, pairs: IntArray, margins: FloatArray, near: IntArray
) -> int:
    """Write which pairs may be no farther apart than their margins, and return how many these are.

    Parameters
    ----------
    places : ndarray, shape (G, 12)
        Rotation of each box, column by column, and where its frame is [m].
    boxes : ndarray, shape (G, 6)
        Its centre and half its sides in that frame [m]. One with sides that are infinite, or no numbers, is near all.
    pairs : ndarray of int, shape (P, 2)
    margins : ndarray, shape (P,)
        [m]
    near : ndarray of int, shape (P,)
        Takes the indices of these pairs, in order.
    """
    G, number = len(boxes), 0
    centres, halves, gap = np.empty((G, 3)), np.empty((G, 3)), np.empty(3)
    for g in range(G):
        for x in range(3):
            centre, half = places[g, 9 + x], 0.0
            for axis in range(3):
                centre += places[g, 3 * axis + x] * boxes[g, axis]
                half += abs(places[g, 3 * axis + x]) * boxes[g, 3 + axis]
            centres[g, x], halves[g, x] = centre, half
    for p in range(len(pairs)):
        a, b, margin, apart = pairs[p, 0], pairs[p, 1], margins[p], False
        for x in range(3):
            gap[x] = centres[b, x] - centres[a, x]
            if abs(gap[x]) > halves[a, x] + halves[b, x] + margin:
                apart = True
                break
        for turn in range(0 if apart else 6):
            axis = turn % 3
            own, other = (a, b) if turn < 3 else (b, a)
            nx, ny, nz = places[own, 3 * axis], places[own, 3 * axis + 1], places[own, 3 * axis + 2]
            shadows = boxes[own, 3 + axis] + margin
            for k in range(3):
                along = (
                    nx * places[other, 3 * k] + ny * places[other, 3 * k + 1] + nz * places[other, 3 * k + 2]
                )
                shadows += abs(along) * boxes[other, 3 + k]
            if abs(nx * gap[0] + ny * gap[1] + nz * gap[2]) > shadows:
                apart = True
                break
        if not apart:
            near[number] = p
            number += 1
    return number
