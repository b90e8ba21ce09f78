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
from typing import Any, NamedTuple

import numpy as np

from safe_ompl.common import FloatArray, part
from safe_ompl.danger.kernels.field import ZERO, Skeleton, add_pull, potentials

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


class Points(NamedTuple):
    """Danger points: columns (3, M + N), points and the centres of N balls; charges k₁w (M,); balls (N,), or None."""

    columns: FloatArray
    charges: FloatArray
    balls: Any


class Aggregate(NamedTuple):
    """`MAXIMUM`, `MEAN` or `SOFTMAX`; β; and the relative error that the latter two may have over points in balls."""

    kind: int
    sharpness: float
    tolerance: float


class Room(NamedTuple):
    """Room for the work on L links and N balls: fields (L, N), known (3, N), and levels (1, ·) of a group's points."""

    fields: FloatArray
    known: FloatArray
    levels: FloatArray


@part
def _look(skeleton: Skeleton, points: Points, begin: int, end: int, kind: int, room: Room) -> None:
    """Write for each of a run of balls the field Σφ at its centre, and how far that of its points may be from it.

    `known` takes both; of their mean if `kind` is `MEAN`. Its last row is room for the work.
    """
    places, links, columns, balls = skeleton.places, skeleton.links, points.columns, points.balls
    fields, known = room.fields, room.known
    first, away = columns.shape[1] - len(balls), known[2]
    potentials(skeleton, columns, first + begin, first + end, fields)
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
            ux, uy, uz = columns[0, c] - ax, columns[1, c] - ay, columns[2, c] - az
            t = (ux * wx + uy * wy + uz * wz) / squared
            t = t if t > 0.0 else 0.0
            t = t if t < 1.0 else 1.0
            ux, uy, uz = ux - t * wx, uy - t * wy, uz - t * wz
            away[n] = sqrt(ux * ux + uy * uy + uz * uz)
        for g in range(begin, end):
            field, apart = fields[k, g - begin], away[g - begin] - balls[g].radius
            wide = balls[g].spread * away[g - begin] / (apart * apart) if kind == MEAN else balls[g].radius
            known[0, g] += field
            known[1, g] += field * wide / apart if apart > 0.0 else inf


@part
def most_points(balls: Any) -> int:
    """Return how many points the largest group has."""
    most = 0
    for g in range(balls[0].begin, len(balls)):
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
def highest_level(skeleton: Skeleton, points: Points, room: Room, forces: FloatArray, sloped: bool) -> float:
    """Return the largest level of points in balls; exact.

    Its gradient by the key points is added to `forces: (K, 3)` if `sloped`. Of the blocks, and of the groups in a
    block, the one with the highest bound comes first, the others in turn.
    """
    columns, charges, balls = points.columns, points.charges, points.balls
    known, levels = room.known, room.levels
    blocks, best, peak = balls[0].begin, 0, -inf
    _look(skeleton, points, 0, blocks, MAXIMUM, room)
    likely = _bound(balls, 0, blocks, known)
    for turn in range(-1, blocks):
        block = likely if turn < 0 else turn
        if known[0, block] <= peak:
            continue
        first, last = balls[block].begin, balls[block].end
        _look(skeleton, points, first, last, MAXIMUM, room)
        likeliest = _bound(balls, first, last, known)
        for inner in range(first - 1, last):
            group = likeliest if inner < first else inner
            if known[0, group] <= peak:
                continue
            begin, end = balls[group].begin, balls[group].end
            potentials(skeleton, columns, begin, end, levels)
            for k in range(begin, end):
                level = charges[k] * levels[0, k - begin]
                if level > peak:
                    best, peak = k, level
            known[0, group] = -inf
        known[0, block] = -inf
    if sloped:
        add_pull(skeleton, columns, best, charges[best], forces)
    return peak


# ----------------------------------------------------------------------------------------- mean and softmax


@part
def _bracket(balls: Any, begin: int, end: int, aggregate: Aggregate, base: float, known: FloatArray) -> float:
    """Write what a run of balls adds to the sum, and its error, over their fields; return what they add for sure.

    The sum is Σ x for a mean, Σ exp(β (x − base)) for a softmax. Groups that a block has settled add nothing.
    """
    sure, sharpness = 0.0, aggregate.sharpness
    for g in range(begin, end):
        number, field, error = balls[g].number, known[0, g], known[1, g]
        if error == _SETTLED:
            share, off = 0.0, 0.0
        elif aggregate.kind == MEAN:
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
def _allowed(aggregate: Aggregate, base: float, sure: float) -> float:
    """Return the error of the sum that changes the danger by no more than the tolerance; `sure` is below the sum.

    log S ≥ βV̲ for a softmax V ≥ V̲: an error E changes it by −log(1 − E/S)/β at most.
    """
    if aggregate.kind == MEAN:
        return aggregate.tolerance * sure
    sure = max(sure, 1.0)  # the term of the highest level
    return sure * (1.0 - exp(-aggregate.tolerance * (aggregate.sharpness * base + log(sure))))


@part
def total_level(
    skeleton: Skeleton, points: Points, aggregate: Aggregate, base: float, room: Room, forces: FloatArray, sloped: bool
) -> float:
    """Return the mean or the softmax of the levels of points in balls, no more than the tolerance off.

    `base` is the highest level, from which a softmax counts. The gradient, as for `highest_level`, of what is taken by
    its centre is that of the field there.
    """
    columns, charges, balls = points.columns, points.charges, points.balls
    known, levels, kind = room.known, room.levels, aggregate.kind
    blocks, M = balls[0].begin, len(charges)
    centre = columns.shape[1] - len(balls)
    if base == inf:
        return inf
    _look(skeleton, points, 0, blocks, kind, room)
    sure = _bracket(balls, 0, blocks, aggregate, base, known)
    limit = _narrow(known, 0, blocks, _FAR * _allowed(aggregate, base, sure))
    sure = 0.0
    for block in range(blocks):
        begin, end = balls[block].begin, balls[block].end
        if known[1, block] <= limit:
            sure += max(known[0, block] - known[1, block], 0.0)
            for g in range(begin, end):
                known[1, g] = _SETTLED
        else:
            _look(skeleton, points, begin, end, kind, room)
            known[0, block] = known[1, block] = 0.0
    sure += _bracket(balls, blocks, len(balls), aggregate, base, known)
    limit = _narrow(known, blocks, len(balls), (1.0 - _FAR) * _allowed(aggregate, base, sure))
    total = 0.0
    for g in range(len(balls)):
        if g < blocks or known[1, g] <= limit:
            total += known[0, g]
            if sloped and known[0, g] > 0.0:
                weight = balls[g].charge * (balls[g].number if kind == MEAN else known[0, g])
                add_pull(skeleton, columns, centre + g, weight, forces)
            continue
        begin, end = balls[g].begin, balls[g].end
        potentials(skeleton, columns, begin, end, levels)
        for k in range(begin, end):
            level = charges[k] * levels[0, k - begin]
            share = level if kind == MEAN else exp(aggregate.sharpness * (level - base))
            total += share
            if sloped and share > 0.0:
                add_pull(skeleton, columns, k, charges[k] * (1.0 if kind == MEAN else share), forces)
    if sloped:
        for i in range(len(forces)):
            for x in range(3):
                forces[i, x] /= M if kind == MEAN else total
    return total / M if kind == MEAN else base + log(total) / aggregate.sharpness
