"""The danger of configurations and its gradient in one loop: kinematics, field, aggregate, pull-back (paper §3).

With levels x_m = k₁ w_m Σ_l φ_l(p_m) the danger is their maximum, their mean, or (1/β) log Σ_m exp(β x_m).
"""

from __future__ import annotations

from math import exp, inf, log
from typing import Any, NamedTuple

import numpy as np

from safe_ompl.common import FloatArray, IntArray, caller, compiled, expanded, inlined, part, stack_array
from safe_ompl.danger.kernels.field import Skeleton, link_fields, new_block, potentials
from safe_ompl.danger.kernels.lanes import (
    LANES,
    Frames,
    Sights,
    ceilings,
    new_frames,
    new_pulls,
    new_sights,
    place_lanes,
    pull_back_lanes,
    see,
    write_fields,
    write_pulls,
)
from safe_ompl.robot.kernels import JOINT, KEYPOINT, keypoints

MAXIMUM, MEAN, SOFTMAX = 0, 1, 2


class Points(NamedTuple):
    """Danger points: columns (3, M ≥ 1) [m], charges k₁w (M,), columns in single precision, and the largest number."""

    columns: FloatArray
    charges: FloatArray
    short: Any
    reach: float


class Aggregate(NamedTuple):
    """`MAXIMUM`, `MEAN` or `SOFTMAX`, and β of the latter."""

    kind: int
    sharpness: float


class Tables(NamedTuple):
    """A robot's tables of joints (m,) and key points (K,) (`robot.kernels.kinematics`), links (L, 2), and weighting."""

    joints: Any
    keys: Any
    links: IntArray
    by_length: bool


class PointDanger(NamedTuple):
    """Danger as `dangers` computes it."""

    tables: Tables
    points: Points
    aggregate: Aggregate

    @classmethod
    def of_nothing(cls) -> PointDanger:
        """Return what kernels are given where they compute no danger."""
        tables = Tables(np.zeros(0, JOINT), np.zeros(0, KEYPOINT), np.zeros((0, 2), np.intp), False)
        points = Points(np.zeros((3, 0)), np.zeros(0), np.zeros((3, 0), np.float32), 0.0)
        return cls(tables, points, Aggregate(MAXIMUM, 0.0))


@part
def _aggregate(levels: FloatArray, kind: int, sharpness: float) -> float:
    """Return the danger of `levels: (M ≥ 1,)`."""
    if kind == MEAN:
        total = 0.0
        for level in levels:
            total += level
        return total / len(levels)
    peak = levels[_highest(levels)]
    if kind == MAXIMUM:
        return float(peak)
    total = 0.0
    for level in levels:
        total += 1.0 if level == peak else exp(sharpness * (level - peak))
    return float(peak + log(total) / sharpness)


@part
def _highest(levels: FloatArray) -> int:
    """Return where the largest of `levels: (M ≥ 1,)` is, or the first that is no number."""
    best = 0
    for m in range(len(levels)):
        if levels[m] != levels[m]:
            return m
        if levels[m] > levels[best]:
            best = m
    return best


@part
def _shares(levels: FloatArray, kind: int, sharpness: float, out: FloatArray) -> None:
    """Write the derivatives (M,) of the danger by the levels."""
    if kind == MEAN:
        out[:] = 1.0 / len(levels)
        return
    best = _highest(levels)
    if kind == MAXIMUM:
        out[:] = 0.0
        out[best] = 1.0
        return
    peak, total = levels[best], 0.0
    for m in range(len(levels)):
        out[m] = 1.0 if levels[m] == peak else exp(sharpness * (levels[m] - peak))
        total += out[m]
    for m in range(len(levels)):
        out[m] /= total


class _Peaks(NamedTuple):
    """Room for the highest levels at configurations side by side.

    Points and distances from key points in single precision, upper bounds of levels (W, ·), and the highest of each
    chunk of these; of each configuration the best point so far, its level, and what level counts, (W,).
    """

    short: Any
    distances: Any
    bounds: Any
    tops: Any
    best: IntArray
    peak: FloatArray
    least: FloatArray


_CHUNK = 8  # points of which the highest bound is known


@expanded
def _new_peaks(keypoints: int, points: Points, rows: int) -> _Peaks:
    """Return room for so many configurations, and the points.

    The last column is repeated up to whole chunks: what is left after these would take as long as many of them.
    """
    M = len(points.charges)
    padded = (M + _CHUNK - 1) // _CHUNK * _CHUNK
    short = np.empty((3, padded), np.float32)
    for x in range(3):
        for k in range(M):
            short[x, k] = points.short[x, k]
        for k in range(M, padded):
            short[x, k] = short[x, M - 1]
    rows = min(LANES, rows)
    return _Peaks(
        short, np.empty((keypoints, padded), np.float32), np.empty((rows, padded), np.float32),
        np.empty((rows, padded // _CHUNK), np.uint32), stack_array((LANES,)).view(np.intp), stack_array((LANES,)),
        stack_array((LANES,)),
    )  # fmt: skip


@inlined
def _bound(tables: Tables, frames: Frames, points: Points, lane: int, peaks: _Peaks) -> None:
    """Write upper bounds of all levels at the configuration in a lane; the point with the highest one is best."""
    bounds, M = peaks.bounds[lane], len(points.charges)
    ceilings(frames, lane, tables.links, tables.by_length, peaks.short, points.reach, peaks.distances, bounds)
    for k in range(M):
        bounds[k] *= np.float32(points.charges[k])
    for k in range(M, len(bounds)):
        bounds[k] = np.float32(0.0)
    # As integers numbers that are not negative have the same order, and what is no number is above all others.
    bits, tops, likely = bounds.view(np.uint32), peaks.tops[lane], 0
    for c in range(len(tops)):
        chunk, top = bits[_CHUNK * c : _CHUNK * (c + 1)], np.uint32(0)
        for k in range(_CHUNK):
            top = max(top, chunk[k])
        tops[c] = top
        likely = c if top > tops[likely] else likely
    best = _CHUNK * likely
    while bits[best] != tops[likely]:
        best += 1
    peaks.best[lane], peaks.peak[lane], peaks.least[lane] = best, -inf, -inf


@inlined
def _candidates(
    M: int, count: int, lane: int, chunk: int, high: FloatArray, peaks: _Peaks, sights: Sights
) -> tuple[int, int, int]:
    """Write which of M points, from a chunk in a lane on, may have a level that counts; say how many, and where next.

    The best points, and those that are high, (M or 0,), are known already.
    """
    number, chunks = 0, peaks.tops.shape[1]
    while lane < count:
        bounds, best, enough = peaks.bounds[lane], peaks.best[lane], np.float32(peaks.least[lane] * (1.0 - 1e-7))
        tops = peaks.tops[lane].view(np.float32)
        while chunk < chunks:
            if not tops[chunk] < enough:
                if number > LANES - _CHUNK:
                    return number, lane, chunk
                for k in range(_CHUNK * chunk, min(_CHUNK * (chunk + 1), M)):
                    if not (bounds[k] < enough or k == best or (k < len(high) and high[k] > 0.0)):
                        sights.seen_from[number], sights.which[number] = lane, k
                        number += 1
            chunk += 1
        lane, chunk = lane + 1, 0
    return number, lane, chunk


@compiled
def highest(
    tables: Tables, values: FloatArray, points: Points, gradients: FloatArray, share: float, least: float,
    high: FloatArray,
) -> FloatArray:  # fmt: skip
    """Return the highest level (B,) at `values: (B, m)`; exact. Write its gradients (B or 0, m) where there is room.

    Levels are computed where a bound in single precision does not tell that they are lower. Where there is room the
    levels of points are written that are a share of the highest one at some configuration, and `least`: (M or 0,).
    """
    B, m, K, L = len(values), len(tables.joints), len(tables.keys), len(tables.links)
    frames, sights, pulls, some = new_frames(m, K, L), new_sights(K, L), new_pulls(m, K), stack_array((LANES,))
    peaks, out, block, places = _new_peaks(K, points, B), np.empty(B), new_block(K), stack_array((K, 3))
    columns, nobody, M = points.columns, high[:0], len(points.charges)
    for first in range(0, B, LANES):
        count, at, chunk, counting = min(LANES, B - first), 0, 0, False
        filled = place_lanes(tables.joints, tables.keys, tables.links, values[first : first + count], frames)
        for lane in range(count):
            _bound(tables, frames, points, lane, peaks)
            sights.seen_from[lane], sights.which[lane] = lane, peaks.best[lane]
        number = count
        while number > 0:
            lanes = see(frames, columns, number, sights)
            if not write_fields(tables.links, tables.by_length, lanes, sights):
                for b in range(number):
                    for k in range(K):
                        for x in range(3):
                            places[k, x] = sights.places[k, x, b]
                    skeleton, point = Skeleton(places, tables.links, tables.by_length, block), sights.which[b]
                    potentials(skeleton, columns, point, point + 1, sights.field[b : b + 1].reshape(1, 1))
            for b in range(number):
                lane, point = sights.seen_from[b], sights.which[b]
                level, peak = sights.field[b] * points.charges[point], peaks.peak[lane]
                if counting:
                    high[point] = max(high[point], level) if level >= peaks.least[lane] else high[point]
                elif level > peak or (level == peak and point < peaks.best[lane]) or peak == -inf:
                    peaks.peak[lane], peaks.best[lane], peaks.least[lane] = level, point, level
            number, at, chunk = _candidates(M, count, at, chunk, high if counting else nobody, peaks, sights)
            if number == 0 and not counting and len(high) > 0:
                counting, at, chunk = True, 0, 0
                for lane in range(count):
                    peaks.least[lane] = max(share * peaks.peak[lane], least)
                    if peaks.peak[lane] >= peaks.least[lane]:
                        high[peaks.best[lane]] = max(high[peaks.best[lane]], peaks.peak[lane])
                number, at, chunk = _candidates(M, count, at, chunk, high, peaks, sights)
        for lane in range(filled):
            out[first + min(lane, count - 1)] = peaks.peak[min(lane, count - 1)]
            sights.seen_from[lane], sights.which[lane] = lane, peaks.best[min(lane, count - 1)]
            some[lane] = points.charges[sights.which[lane]]
        if len(gradients) > 0:
            see(frames, columns, filled, sights)
            write_pulls(tables.links, tables.by_length, some, filled, sights, pulls)
            pull_back_lanes(tables.joints, tables.keys, filled, frames, pulls.forces, pulls)
            for lane in range(count):
                for i in range(m):
                    gradients[first + lane, i] = pulls.gradient[i, lane]
    return out


@compiled
def slopes(
    tables: Tables, values: FloatArray, points: Points, chosen: IntArray, weights: FloatArray, gradients: FloatArray
) -> None:
    """Write the gradients (B, m) of weighted sums of the fields at chosen points at `values: (B, m)`.

    Points and their weights are (B, J). Points on a link have no gradient.
    """
    (B, J), K, L, m = chosen.shape, len(tables.keys), len(tables.links), len(tables.joints)
    frames, sights, pulls = new_frames(m, K, L), new_sights(K, L), new_pulls(m, K)
    some, forces = stack_array((LANES,)), stack_array((K, 3, LANES))
    for first in range(0, B, LANES):
        count = min(LANES, B - first)
        lanes = place_lanes(tables.joints, tables.keys, tables.links, values[first : first + count], frames)
        forces[:] = 0.0
        for begin in range(0, count * J, LANES):
            number = min(LANES, count * J - begin)
            for b in range(number):
                lane, j = (begin + b) // J, (begin + b) % J
                sights.seen_from[b], sights.which[b], some[b] = lane, chosen[first + lane, j], weights[first + lane, j]
            seen = see(frames, points.columns, number, sights)
            for b in range(number, seen):
                some[b] = 0.0
            write_pulls(tables.links, tables.by_length, some, seen, sights, pulls)
            for k in range(K):
                for x in range(3):
                    for b in range(number):
                        forces[k, x, sights.seen_from[b]] += pulls.forces[k, x, b]
        pull_back_lanes(tables.joints, tables.keys, lanes, frames, forces, pulls)
        for b in range(count):
            for i in range(m):
                gradients[first + b, i] = pulls.gradient[i, b]


@caller
def dangers(
    tables: Tables, values: FloatArray, points: Points, aggregate: Aggregate, gradients: FloatArray
) -> FloatArray:
    """Return the danger (B,) at `values: (B, m)` of the joints, and write its gradients (B or 0, m).

    Gradients are not written where there is no room; points on a link have none.
    """
    B, M, charges = len(values), len(points.charges), points.charges
    if aggregate.kind == MAXIMUM:
        return highest(tables, values, points, gradients, 0.0, 0.0, charges[:0])
    places = keypoints(tables.joints, tables.keys, values)
    levels = link_fields(places, tables.links, points.columns, tables.by_length, True).reshape(B, M)
    for b in range(B):
        for k in range(M):
            levels[b, k] *= charges[k]
    if len(gradients) > 0:
        chosen, weights = np.empty((B, M), np.intp), all_shares(levels, aggregate.kind, aggregate.sharpness)
        for b in range(B):
            for k in range(M):
                chosen[b, k], weights[b, k] = k, weights[b, k] * charges[k]
        slopes(tables, values, points, chosen, weights, gradients)
    return aggregates(levels, aggregate.kind, aggregate.sharpness)


@caller
def high_levels(tables: Tables, values: FloatArray, points: Points, least: float) -> tuple[FloatArray, FloatArray]:
    """Return the levels (C,) of points at `values: (1, m)` that are at least `least`, and their gradients (C, m)."""
    high, C = np.zeros(len(points.charges)), 0
    highest(tables, values, points, values[:0], 0.0, least, high)
    for k in range(len(high)):
        C += high[k] > 0.0
    levels, chosen, weights = np.empty(C), np.empty((C, 1), np.intp), np.empty((C, 1))
    alike, gradients = np.empty((C, values.shape[1])), np.empty((C, values.shape[1]))
    C = 0
    for k in range(len(high)):
        if high[k] > 0.0:
            levels[C], chosen[C, 0], weights[C, 0], alike[C] = high[k], k, points.charges[k], values[0]
            C += 1
    slopes(tables, alike, points, chosen, weights, gradients)
    return levels, gradients


@compiled
def aggregates(levels: FloatArray, kind: int, sharpness: float) -> FloatArray:
    """Return the danger (B,) of levels (B, M ≥ 1)."""
    out = np.empty(len(levels))
    for b in range(len(levels)):
        out[b] = _aggregate(levels[b], kind, sharpness)
    return out


@compiled
def all_shares(levels: FloatArray, kind: int, sharpness: float) -> FloatArray:
    """Return the derivatives (B, M) of the danger by levels (B, M ≥ 1)."""
    out = np.empty(levels.shape)
    for b in range(len(levels)):
        _shares(levels[b], kind, sharpness, out[b])
    return out
