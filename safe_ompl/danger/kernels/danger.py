"""The danger of configurations and its gradient in one loop: kinematics, field, aggregate, pull-back (paper §3).

With levels x_m = k₁ w_m Σ_l φ_l(p_m) the danger is their maximum, their mean, or (1/β) log Σ_m exp(β x_m).
"""

from __future__ import annotations

from math import exp, inf, log
from typing import Any, NamedTuple

import numpy as np

from safe_ompl.common import BoolArray, FloatArray, IntArray, compiled, maker, part
from safe_ompl.danger.kernels.field import Block, Skeleton, add_pull, ceilings, new_block, potential, potentials
from safe_ompl.robot.kernels import JOINT, KEYPOINT, place_joints, place_keypoints, pull

MAXIMUM, MEAN, SOFTMAX = 0, 1, 2


class Points(NamedTuple):
    """Danger points: columns (3, M ≥ 1) [m], charges k₁w (M,), columns in single precision, and the largest number."""

    columns: FloatArray
    charges: FloatArray
    short: Any
    reach: float


class Groups(NamedTuple):
    """M ≥ 1 danger points in G groups: columns (3, M + G), the points and a centre of each group; charges k₁w (M,).

    Where the groups begin, and the last one ends, (G + 1,); radii (G,) [m] about the centres; largest charges (G,).
    """

    columns: FloatArray
    charges: FloatArray
    begins: IntArray
    radii: FloatArray
    heaviest: FloatArray


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


class _Work(NamedTuple):
    """Room for the danger of one configuration: of joints, of key points, and of points."""

    rotation: FloatArray
    origin: FloatArray
    axis: FloatArray
    wrench: FloatArray
    places: FloatArray
    forces: FloatArray
    levels: FloatArray
    share: FloatArray
    short: Any
    far: Any
    bounds: Any
    tops: Any
    alone: FloatArray
    block: Block


@maker
def _room(tables: Tables, points: Points) -> _Work:
    """Return room, with a copy of the short columns: of arrays made here LLVM knows that none is part of another.

    The last column is repeated up to whole chunks: what is left after these would take as long as many of them.
    """
    m, K, M = len(tables.joints), len(tables.keys), len(points.charges)
    chunks = (M + _CHUNK - 1) // _CHUNK
    short = np.empty((3, _CHUNK * chunks), np.float32)
    for x in range(3):
        for k in range(_CHUNK * chunks):
            short[x, k] = points.short[x, min(k, M - 1)]
    return _Work(
        np.empty((m, 3, 3)), np.empty((m, 3)), np.empty((m, 3)), np.empty((m, 6)), np.empty((K, 3)), np.empty((K, 3)),
        np.empty(M), np.empty(M), short, np.empty((K, _CHUNK * chunks), np.float32),
        np.zeros(_CHUNK * chunks, np.float32), np.empty(chunks, np.uint32), np.empty((4, len(tables.links))),
        new_block(K),
    )  # fmt: skip


_CHUNK = 32  # points of which the highest bound is known


@part
def _highest_level(skeleton: Skeleton, points: Points, work: _Work) -> tuple[float, int]:
    """Return the largest level, and where the first of these is; exact.

    Levels are computed where a bound in single precision does not tell that they are lower.
    """
    columns, charges, bounds = points.columns, points.charges, work.bounds
    M = len(charges)
    reach = points.reach
    for k in range(len(skeleton.places)):
        for x in range(3):
            reach = max(reach, abs(skeleton.places[k, x]))
    ceilings(skeleton, work.short, reach, work.far, bounds)
    for k in range(M):
        bounds[k] *= np.float32(charges[k])
    for k in range(M, len(bounds)):
        bounds[k] = np.float32(0.0)
    # As integers numbers that are not negative have the same order, and what is no number is above all others.
    bits, tops = bounds.view(np.uint32), work.tops
    likely = 0
    for c in range(len(tops)):
        chunk, top = bits[_CHUNK * c : _CHUNK * (c + 1)], np.uint32(0)
        for k in range(_CHUNK):
            top = max(top, chunk[k])
        tops[c] = top
        likely = c if tops[c] > tops[likely] else likely
    best = _CHUNK * likely
    while bits[best] != tops[likely]:
        best += 1
    peak = potential(skeleton, columns, best, work.alone) * charges[best]
    enough, highs, likely = np.float32(peak * (1.0 - 1e-7)), tops.view(np.float32), best
    for c in range(len(tops)):
        if not highs[c] < enough:
            for k in range(_CHUNK * c, min(_CHUNK * (c + 1), M)):
                if not bounds[k] < enough and k != likely:
                    level = potential(skeleton, columns, k, work.alone) * charges[k]
                    if level > peak or (level == peak and k < best):
                        best, peak = k, level
    return peak, best


@part
def _whole(skeleton: Skeleton, points: Points, aggregate: Aggregate, sloped: bool, work: _Work) -> float:
    """Return the mean or the softmax of all levels; the gradient by the key points is added to the forces."""
    columns, charges, kind = points.columns, points.charges, aggregate.kind
    levels, share, M = work.levels, work.share, len(points.charges)
    potentials(skeleton, columns, 0, M, levels.reshape(1, M))
    for k in range(M):
        levels[k] *= charges[k]
    if sloped:
        _shares(levels, kind, aggregate.sharpness, share)
        for k in range(M):
            if share[k] != 0.0:
                add_pull(skeleton, columns, k, charges[k] * share[k], work.forces)
    return _aggregate(levels, kind, aggregate.sharpness)


@part
def _danger(
    tables: Tables, values: FloatArray, points: Points, aggregate: Aggregate, gradient: FloatArray, work: _Work
) -> float:
    """Return the danger at `values: (m,)` of the joints, and write its gradient (m or 0,)."""
    kind, sloped = aggregate.kind, len(gradient) > 0
    place_joints(tables.joints, values, work.rotation, work.origin, work.axis)
    place_keypoints(tables.keys, work.rotation, work.origin, work.places)
    skeleton = Skeleton(work.places, tables.links, tables.by_length, work.block)
    columns, charges = points.columns, points.charges
    forces = work.forces
    forces[:] = 0.0
    if kind == MAXIMUM:
        out, best = _highest_level(skeleton, points, work)
        if sloped:
            add_pull(skeleton, columns, best, charges[best], forces)
    else:
        out = _whole(skeleton, points, aggregate, sloped, work)
    if sloped:
        frames = work.origin, work.axis, work.wrench
        pull(tables.joints, tables.keys, frames, work.places, forces, gradient)
    return float(out)


@compiled
def dangers(
    tables: Tables, values: FloatArray, points: Points, aggregate: Aggregate, gradients: FloatArray
) -> FloatArray:
    """Return the danger (B,) at `values: (B, m)` of the joints, and write its gradients (B or 0, m).

    Gradients are not written where there is no room; points on a link have none.
    """
    out = np.empty(len(values))
    _each_danger(tables, values, points, aggregate, gradients, out, _room(tables, points))
    return out


@part
def _each_danger(
    tables: Tables,
    values: FloatArray,
    points: Points,
    aggregate: Aggregate,
    gradients: FloatArray,
    out: FloatArray,
    work: _Work,
) -> None:
    """Write what `dangers` returns: within a part Numba does not count who holds an array, once for each row."""
    for b in range(len(values)):
        gradient = gradients[b] if len(gradients) > 0 else work.share[:0]
        out[b] = _danger(tables, values[b], points, aggregate, gradient, work)


@compiled
def high_levels(tables: Tables, values: FloatArray, points: Points, least: float) -> tuple[FloatArray, FloatArray]:
    """Return the levels (C,) of points at `values: (m,)` that are at least `least`, and their gradients (C, m)."""
    columns, charges, C = points.columns, points.charges, 0
    levels, gradients = np.empty(len(charges)), np.empty((len(charges), len(values)))
    work = _room(tables, points)
    skeleton = Skeleton(work.places, tables.links, tables.by_length, work.block)
    place_joints(tables.joints, values, work.rotation, work.origin, work.axis)
    place_keypoints(tables.keys, work.rotation, work.origin, work.places)
    _highest_level(skeleton, points, work)
    for k in range(len(charges)):
        if not work.bounds[k] < np.float32(least * (1.0 - 1e-7)):
            level = potential(skeleton, columns, k, work.alone) * charges[k]
            if level >= least:
                levels[C], work.forces[:] = level, 0.0
                add_pull(skeleton, columns, k, charges[k], work.forces)
                frames = work.origin, work.axis, work.wrench
                pull(tables.joints, tables.keys, frames, work.places, work.forces, gradients[C])
                C += 1
    return levels[:C].copy(), gradients[:C].copy()


@compiled
def high_points(tables: Tables, values: FloatArray, points: Points, share: float) -> BoolArray:
    """Return which of the points (M,) have a level at any of `values: (B, m)` that is a share of its highest."""
    columns, charges, high = points.columns, points.charges, np.zeros(len(points.charges), np.bool_)
    work = _room(tables, points)
    skeleton = Skeleton(work.places, tables.links, tables.by_length, work.block)
    for b in range(len(values)):
        place_joints(tables.joints, values[b], work.rotation, work.origin, work.axis)
        place_keypoints(tables.keys, work.rotation, work.origin, work.places)
        lowest = share * _highest_level(skeleton, points, work)[0]
        enough = np.float32(lowest * (1.0 - 1e-7))
        for k in range(len(charges)):
            if not (high[k] or work.bounds[k] < enough):
                high[k] = potential(skeleton, columns, k, work.alone) * charges[k] >= lowest
    return high


_HALVINGS = 6  # of a panel at most


@compiled
def mean_danger(
    tables: Tables, ends: FloatArray, points: Points, aggregate: Aggregate, panels: int, tolerance: float
) -> tuple[float, int]:
    """Return the mean danger on the straight way between two `ends: (2, m)` of the joints; from how many evaluations.

    By Simpson's rule. Of a panel, at first one of `panels`, the trapezoidal rule with the same three values differs by
    |f₀ − 2f₁ + f₂|/12 from it. The panel is halved where that is more than the relative tolerance times the mean.
    """
    work, nothing = _room(tables, points), np.empty(0)
    q, first, evaluations = np.empty(ends.shape[1]), np.empty(2 * panels + 1), 2 * panels + 1
    mean = 0.0
    for k in range(evaluations):
        _between(ends, k / (2 * panels), q)
        first[k] = _danger(tables, q, points, aggregate, nothing, work)
        mean += first[k] * (4.0 if k % 2 else 1.0 if k in (0, 2 * panels) else 2.0) / (6 * panels)
    if not mean < inf:
        return mean, evaluations
    total, enough = 0.0, 12.0 * tolerance * mean
    pending = np.empty((_HALVINGS + 1, 5))  # panels: where they begin, how long they are, and three values
    for k in range(panels):
        depth = 0
        _put(pending[0], k / panels, 1.0 / panels, (first[2 * k], first[2 * k + 1], first[2 * k + 2]))
        while depth >= 0:
            begin, length = pending[depth, 0], pending[depth, 1]
            f0, f1, f2 = pending[depth, 2], pending[depth, 3], pending[depth, 4]
            if abs(f0 - 2.0 * f1 + f2) <= enough or length * panels < 1.5 / 2**_HALVINGS:
                total += length * (f0 + 4.0 * f1 + f2) / 6.0
                depth -= 1
                continue
            _between(ends, begin + 0.25 * length, q)
            left = _danger(tables, q, points, aggregate, nothing, work)
            _between(ends, begin + 0.75 * length, q)
            right = _danger(tables, q, points, aggregate, nothing, work)
            evaluations += 2
            _put(pending[depth], begin + 0.5 * length, 0.5 * length, (f1, right, f2))
            depth += 1
            _put(pending[depth], begin, 0.5 * length, (f0, left, f1))
    return total, evaluations


@part
def _put(panel: FloatArray, begin: float, length: float, values: tuple[float, float, float]) -> None:
    panel[0], panel[1] = begin, length
    panel[2], panel[3], panel[4] = values


@part
def _between(ends: FloatArray, t: float, out: FloatArray) -> None:
    for i in range(len(out)):
        out[i] = ends[0, i] + t * (ends[1, i] - ends[0, i])


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


class Ends(NamedTuple):
    """What is known of segments at one end of an interval: fields and distances, (L, M)."""

    fields: FloatArray
    distances: FloatArray


@compiled
def chords(
    first: Ends, last: Ends, h: float, speed: FloatArray, acceleration: FloatArray, lengths: FloatArray
) -> FloatArray:
    """Return the ends (2, M) of straight lines that lie above Σ_l length_l·u_l(t) throughout an interval.

    Segments l whose points move smoothly for a time h, none faster than V (L,) or with more acceleration than A (L,),
    have the unit-weighted fields u = ∫₀¹ dτ/ρ_τ at a point p. They are multiplied by 1, or at least by their lengths
    (L,). Of two bounds of each u the lower one is taken. Seen from the nearer end no point moves farther than δ = Vh/2,
    so u ≤ U = max u·D/(D − δ) over both ends (`segment_bounds`): a level line. And along a curve 1/ρ has the second
    derivative vᵀ∇²(1/ρ)v + ∇(1/ρ)·a ≥ −v²/ρ³ − a/ρ², for ∇²(1/ρ) has the eigenvalues 2/ρ³ and −1/ρ³. As ρ never falls
    below D̲ = (D₁ + D₂ − Vh)/2, u'' ≥ −U(V²/D̲² + A/D̲), and u stays below the chord from u₁ to u₂ raised by

        U (V²/D̲² + A/D̲) h²/8.

    The first bound is linear in h, the second quadratic: near a smooth peak it needs a fifth of the intervals. The
    lines are infinite where a segment may reach the point.
    """
    L, M = first.fields.shape
    out = np.zeros((2, M))
    for k in range(L):
        half, weight = speed[k] * h / 2, lengths[k]
        for m in range(M):
            u1, u2, d1, d2 = (first.fields[k, m], last.fields[k, m], first.distances[k, m], last.distances[k, m])
            left, right = d1 - half, d2 - half
            if left > 0 and right > 0:
                level = max(u1 * (d1 / left), u2 * (d2 / right))
                nearest = (left + right) / 2
                rise = level * ((speed[k] / nearest) ** 2 + acceleration[k] / nearest) * (h * h / 8)
                bent = max(u1, u2) + rise < level
                out[0, m] += weight * (u1 + rise if bent else level)
                out[1, m] += weight * (u2 + rise if bent else level)
            else:
                out[0, m] = out[1, m] = inf
    return out
