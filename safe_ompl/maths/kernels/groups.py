"""The most dangerous of many points, found without looking at all of them; exact.

No point of a group is farther than r from its centre c. Of a link that is D > r away from c

    φ_l(p) ≤ φ_l(c)·D/(D − r),

as in `safe_ompl.maths.field.segment_bounds` with the point moving in place of the link. A group whose bound is below a
level found elsewhere cannot hold the largest one.
"""

from __future__ import annotations

from math import inf, sqrt
from typing import Any

import numpy as np

from safe_ompl.arrays import FloatArray, IntArray
from safe_ompl.maths.kernels.compiled import compiled, part
from safe_ompl.maths.kernels.field import add_pull, potentials
from safe_ompl.maths.kernels.joints import place_joints, place_keypoints, pull
from safe_ompl.maths.kernels.link import ZERO

_SLACK = 1 + 1e-9  # of rounding in the bounds


@part
def _bound(
    places: FloatArray,
    links: IntArray,
    centres: FloatArray,
    radii: FloatArray,
    tops: FloatArray,
    begin: int,
    end: int,
    by_length: bool,
    fields: FloatArray,
    bounds: FloatArray,
) -> None:
    """Write for each of a run of balls a level that none of its points exceeds; `fields` is room for the work."""
    potentials(places, links, centres[:, begin:end], by_length, fields)
    bounds[begin:end] = 0.0
    for k in range(len(links)):
        ax, ay, az = places[links[k, 0], 0], places[links[k, 0], 1], places[links[k, 0], 2]
        wx = places[links[k, 1], 0] - ax
        wy = places[links[k, 1], 1] - ay
        wz = places[links[k, 1], 2] - az
        squared = max(wx * wx + wy * wy + wz * wz, ZERO)
        for g in range(begin, end):
            ux, uy, uz = centres[0, g] - ax, centres[1, g] - ay, centres[2, g] - az
            t = min(max((ux * wx + uy * wy + uz * wz) / squared, 0.0), 1.0)
            ux, uy, uz = ux - t * wx, uy - t * wy, uz - t * wz
            distance = sqrt(ux * ux + uy * uy + uz * uz)
            room = distance - radii[g]
            bounds[g] += fields[k, g - begin] * (distance / room) if room > 0.0 else inf
    for g in range(begin, end):
        bounds[g] *= tops[g] * _SLACK


@part
def _highest(bounds: FloatArray, begin: int, end: int) -> int:
    best = begin
    for g in range(begin, end):
        if bounds[g] > bounds[best]:
            best = g
    return best


@compiled
def peak_dangers(
    joints: Any,
    keys: Any,
    links: IntArray,
    values: FloatArray,
    points: FloatArray,
    charges: FloatArray,
    centres: FloatArray,
    radii: FloatArray,
    tops: FloatArray,
    spans: IntArray,
    blocks: int,
    by_length: bool,
    gradients: FloatArray,
) -> FloatArray:
    """Return the largest level k₁w Σ_l φ_l(p) (B,) at `values: (B, m)`, and write its gradients.

    As `safe_ompl.maths.kernels.danger.dangers` with `MAXIMUM`; points in groups and blocks as in `PointGroups`. Of the
    blocks, and of the groups in a block, the one with the highest bound comes first, the others in turn.
    """
    B, m = values.shape
    out, bounds = np.empty(B), np.empty(len(radii))
    most = 0
    for g in range(len(spans)):
        most = max(most, spans[g, 1] - spans[g, 0])
    fields, levels = np.empty((len(links), len(radii))), np.empty((1, most))
    rotation, origin, axis = np.empty((m, 3, 3)), np.empty((m, 3)), np.empty((m, 3))
    places, forces = np.empty((len(keys), 3)), np.empty((len(keys), 3))
    for b in range(B):
        place_joints(joints, values[b], rotation, origin, axis)
        place_keypoints(keys, rotation, origin, places)
        _bound(places, links, centres, radii, tops, 0, blocks, by_length, fields, bounds)
        best, peak = 0, -inf
        for turn in range(-1, blocks):
            block = _highest(bounds, 0, blocks) if turn < 0 else turn
            if bounds[block] <= peak:
                continue
            first, last = spans[block, 0], spans[block, 1]
            _bound(places, links, centres, radii, tops, first, last, by_length, fields, bounds)
            for inner in range(first - 1, last):
                group = _highest(bounds, first, last) if inner < first else inner
                if bounds[group] <= peak:
                    continue
                begin, end = spans[group, 0], spans[group, 1]
                potentials(places, links, points[:, begin:end], by_length, levels)
                for k in range(begin, end):
                    level = charges[k] * levels[0, k - begin]
                    if level > peak:
                        best, peak = k, level
                bounds[group] = -inf
            bounds[block] = -inf
        out[b] = peak
        if len(gradients):
            forces[:] = 0.0
            add_pull(places, links, points, best, charges[best], by_length, forces)
            pull(joints, keys, origin, axis, places, forces, gradients[b])
    return out
