"""The danger of many points in groups of neighbours, without looking at all of them.

The points of a group lie in a ball of radius r about c, the mean of the points weighted by their charges, and σ² is the
mean of ‖p − c‖². Of a link that is D > r away from c, as 1/ρ has a second derivative of at most 2/ρ³,

    |φ_l(p) − φ_l(c)| ≤ φ_l(c)·r/(D − r),    |mean φ_l(p) − φ_l(c)| ≤ φ_l(c)·σ²D/(D − r)³.

The first bound tells which groups cannot hold the largest level, and brackets their terms exp(β x) of a softmax; the
second one brackets their share of a mean: what is linear in p − c has the mean 0. Groups with a narrow bracket are
taken at once, by their centre, as long as all their errors together stay within the tolerance; of the others every
point is looked at. Groups are in turn held by blocks, which are treated alike before.
"""

from __future__ import annotations

from math import exp, inf, log, sqrt
from typing import Any

import numpy as np

from safe_ompl.common import FloatArray, IntArray, part
from safe_ompl.danger.kernels.field import ZERO, add_pull, potentials

MAXIMUM, MEAN, SOFTMAX = 0, 1, 2
BALL = np.dtype(
    [
        ("radius", np.float64),  # r [m]
        ("spread", np.float64),  # σ² [m²]
        ("lightest", np.float64),  # k₁w of its points: the least,
        ("heaviest", np.float64),  # the largest,
        ("charge", np.float64),  # and the mean
        ("number", np.int64),  # of its points
        ("begin", np.int64),  # its first group among the balls, or its first point
        ("end", np.int64),
    ],
    align=True,
)  # the H blocks come first, then the groups: the first group is ball H

_SLACK = 1 + 1e-9  # of rounding in the bounds
_SETTLED = -1.0  # in the place of an error: of groups whose block is taken
_FAR = 0.1  # part of the tolerance that blocks may use up


@part
def _look(
    places: FloatArray,
    links: IntArray,
    points: FloatArray,
    balls: Any,
    begin: int,
    end: int,
    by_length: bool,
    kind: int,
    fields: FloatArray,
    known: FloatArray,
) -> None:
    """Write for each of a run of balls the field Σφ at its centre, and how far that of its points may be from it.

    `known: (3, balls)` takes both; of their mean if `kind` is `MEAN`. Its last row, and `fields: (L, ·)`, are room for
    the work.
    """
    first, away = points.shape[1] - len(balls), known[2]
    potentials(places, links, points, first + begin, first + end, by_length, fields)
    for g in range(begin, end):
        known[0, g] = known[1, g] = 0.0
    for k in range(len(links)):
        ax, ay, az = places[links[k, 0], 0], places[links[k, 0], 1], places[links[k, 0], 2]
        wx = places[links[k, 1], 0] - ax
        wy = places[links[k, 1], 1] - ay
        wz = places[links[k, 1], 2] - az
        squared = max(wx * wx + wy * wy + wz * wz, ZERO)
        for n in range(end - begin):  # two loops: processors run this one by lanes
            c = first + begin + n
            ux, uy, uz = points[0, c] - ax, points[1, c] - ay, points[2, c] - az
            t = (ux * wx + uy * wy + uz * wz) / squared
            t = t if t > 0.0 else 0.0
            t = t if t < 1.0 else 1.0
            ux, uy, uz = ux - t * wx, uy - t * wy, uz - t * wz
            away[n] = sqrt(ux * ux + uy * uy + uz * uz)
        for g in range(begin, end):
            field, room = fields[k, g - begin], away[g - begin] - balls[g].radius
            wide = balls[g].spread * away[g - begin] / (room * room) if kind == MEAN else balls[g].radius
            known[0, g] += field
            known[1, g] += field * wide / room if room > 0.0 else inf


@part
def most_points(balls: Any) -> int:
    """Return how many points the largest group has; 0 without groups."""
    most = 0
    for g in range(balls[0].begin if len(balls) > 0 else 0, len(balls)):
        most = max(most, balls[g].number)
    return most


# -------------------------------------------------------------------------------------------------- maximum


@part
def _bound(balls: Any, begin: int, end: int, known: FloatArray) -> int:
    """Write levels over the fields of a run of balls that none of their points exceeds; return the highest's ball."""
    best = begin
    for g in range(begin, end):
        known[0, g] = balls[g].heaviest * (known[0, g] + known[1, g]) * _SLACK
        if known[0, g] > known[0, best]:
            best = g
    return best


@part
def highest_level(
    places: FloatArray,
    links: IntArray,
    points: FloatArray,
    charges: FloatArray,
    balls: Any,
    by_length: bool,
    fields: FloatArray,
    known: FloatArray,
    levels: FloatArray,
    forces: FloatArray,
    sloped: bool,
) -> float:
    """Return the largest level of `points: (3, M + balls)`; exact.

    Its gradient by the key points is added to `forces: (K, 3)` if `sloped`. Of the blocks, and of the groups in a
    block, the one with the highest bound comes first, the others in turn. Room for the work: `fields: (L, balls)`,
    `known: (3, balls)`, and `levels: (1, ·)` for the points of a group.
    """
    blocks, best, peak = balls[0].begin, 0, -inf
    _look(places, links, points, balls, 0, blocks, by_length, MAXIMUM, fields, known)
    likely = _bound(balls, 0, blocks, known)
    for turn in range(-1, blocks):
        block = likely if turn < 0 else turn
        if known[0, block] <= peak:
            continue
        first, last = balls[block].begin, balls[block].end
        _look(places, links, points, balls, first, last, by_length, MAXIMUM, fields, known)
        likeliest = _bound(balls, first, last, known)
        for inner in range(first - 1, last):
            group = likeliest if inner < first else inner
            if known[0, group] <= peak:
                continue
            begin, end = balls[group].begin, balls[group].end
            potentials(places, links, points, begin, end, by_length, levels)
            for k in range(begin, end):
                level = charges[k] * levels[0, k - begin]
                if level > peak:
                    best, peak = k, level
            known[0, group] = -inf
        known[0, block] = -inf
    if sloped:
        add_pull(places, links, points, best, charges[best], by_length, forces)
    return peak


# ----------------------------------------------------------------------------------------- mean and softmax


@part
def _bracket(
    balls: Any, begin: int, end: int, kind: int, sharpness: float, base: float, known: FloatArray
) -> float:
    """Write what a run of balls adds to the sum, and its error, over their fields; return what they add for sure.

    The sum is Σ x for a mean, Σ exp(β (x − base)) for a softmax. Groups that a block has settled add nothing.
    """
    sure = 0.0
    for g in range(begin, end):
        number, field, error = balls[g].number, known[0, g], known[1, g]
        if error == _SETTLED:
            share, off = 0.0, 0.0
        elif kind == MEAN:
            share, off = number * balls[g].charge * field, number * balls[g].charge * error * _SLACK
        else:
            share = number * exp(sharpness * (balls[g].charge * field - base))
            high = number * exp(sharpness * (balls[g].heaviest * (field + error) * _SLACK - base))
            low = number * exp(sharpness * (balls[g].lightest * max(field - error, 0.0) / _SLACK - base))
            off = max(high - share, share - low)
        known[0, g], known[1, g] = share, off if off >= 0.0 else inf
        if off < share:
            sure += share - off
    return sure


@part
def _narrow(known: FloatArray, begin: int, end: int, allowed: float) -> float:
    """Return the largest of some errors with which all that are no larger than it add up to no more than allowed."""
    limit = allowed
    for _ in range(40):
        total = 0.0
        for g in range(begin, end):
            total += known[1, g] if known[1, g] <= limit else 0.0
        if total <= allowed:
            return limit
        limit *= 0.7
    return 0.0


@part
def _allowed(kind: int, sharpness: float, tolerance: float, base: float, sure: float) -> float:
    """Return the error of the sum that changes the danger by no more than the tolerance; `sure` is below the sum.

    log S ≥ βV̲ for a softmax V ≥ V̲: an error E changes it by −log(1 − E/S)/β at most.
    """
    if kind == MEAN:
        return tolerance * sure
    sure = max(sure, 1.0)  # the term of the highest level
    return sure * (1.0 - exp(-tolerance * (sharpness * base + log(sure))))


@part
def total_level(
    places: FloatArray,
    links: IntArray,
    points: FloatArray,
    charges: FloatArray,
    balls: Any,
    by_length: bool,
    kind: int,
    sharpness: float,
    tolerance: float,
    base: float,
    fields: FloatArray,
    known: FloatArray,
    levels: FloatArray,
    forces: FloatArray,
    sloped: bool,
) -> float:
    """Return the mean or the softmax of the levels, no more than the tolerance off.

    `base` is the highest level, from which a softmax counts. The rest is as for `highest_level`. The gradient of what
    is taken by its centre is that of the field there.
    """
    blocks, M = balls[0].begin, len(charges)
    centre = points.shape[1] - len(balls)
    if base == inf:
        return inf
    _look(places, links, points, balls, 0, blocks, by_length, kind, fields, known)
    sure = _bracket(balls, 0, blocks, kind, sharpness, base, known)
    limit = _narrow(known, 0, blocks, _FAR * _allowed(kind, sharpness, tolerance, base, sure))
    sure = 0.0
    for block in range(blocks):
        begin, end = balls[block].begin, balls[block].end
        if known[1, block] <= limit:
            sure += max(known[0, block] - known[1, block], 0.0)
            for g in range(begin, end):
                known[1, g] = _SETTLED
        else:
            _look(places, links, points, balls, begin, end, by_length, kind, fields, known)
            known[0, block] = known[1, block] = 0.0
    sure += _bracket(balls, blocks, len(balls), kind, sharpness, base, known)
    limit = _narrow(
        known, blocks, len(balls), (1.0 - _FAR) * _allowed(kind, sharpness, tolerance, base, sure)
    )
    total = 0.0
    for g in range(len(balls)):
        if g < blocks or known[1, g] <= limit:
            total += known[0, g]
            if sloped and known[0, g] > 0.0:
                weight = balls[g].charge * (balls[g].number if kind == MEAN else known[0, g])
                add_pull(places, links, points, centre + g, weight, by_length, forces)
            continue
        begin, end = balls[g].begin, balls[g].end
        potentials(places, links, points, begin, end, by_length, levels)
        for k in range(begin, end):
            level = charges[k] * levels[0, k - begin]
            share = level if kind == MEAN else exp(sharpness * (level - base))
            total += share
            if sloped and share > 0.0:
                weight = charges[k] * (1.0 if kind == MEAN else share)
                add_pull(places, links, points, k, weight, by_length, forces)
    if sloped:
        for i in range(len(forces)):
            for x in range(3):
                forces[i, x] /= M if kind == MEAN else total
    return total / M if kind == MEAN else base + log(total) / sharpness
