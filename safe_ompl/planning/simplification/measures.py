"""Paths by arc length: resampling, and what is measured along one, danger and clearance of obstacles."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from safe_ompl.collision import Clearance, CollisionChecker
from safe_ompl.common import FloatArray, IntArray
from safe_ompl.danger import CertifiedDanger, DangerBounds, DangerField
from safe_ompl.planning.simplification.costs import arc_lengths, at_arc_lengths, spread
from safe_ompl.robot import Robot, plain


class Curve:
    """A path by its arc length in joint space, unrolled, so that nothing jumps where a continuous joint wraps."""

    def __init__(self, robot: Robot, path: FloatArray) -> None:
        self._points = robot.unrolled(path)
        self.length = path_length(self._points)

    def spread(self, step: float) -> FloatArray:
        """Return configurations (S, n) at equal steps, no longer than `step` [rad], from start to goal."""
        return spread(self._points, step)[0]

    def at(self, s: FloatArray) -> FloatArray:
        """Return the configurations (S, n) at arc lengths `s: (S,)`."""
        return at_arc_lengths(self._points, plain(s))


# Segments near obstacles are halved if they are longer than this. Finer segments descend slowly.
_LONGEST_NEAR_SEGMENT = 0.25  # [rad]


def path_length(path: FloatArray) -> float:
    """Return the length [rad] of an unrolled path (N, n)."""
    return float(arc_lengths(plain(path))[-1])


def divided(path: FloatArray, spacing: float) -> FloatArray:
    """Return the same path (N, n) with way points no more than `spacing` apart [rad]."""
    steps = path[1:] - path[:-1]
    counts = np.maximum(1, np.ceil(np.linalg.norm(steps, axis=1) / spacing)).astype(int)
    segment = np.repeat(np.arange(len(steps)), counts)
    place = np.arange(len(segment)) - np.repeat(np.cumsum(counts) - counts, counts)
    inner = path[segment] + (place / counts[segment])[:, None] * steps[segment]
    # Way points of the path stay what they are to the last bit.
    inner[place == 0] = path[:-1]
    return np.vstack([inner, path[-1]])


def refined(path: FloatArray, rows_near: Callable[[FloatArray], IntArray]) -> FloatArray:
    """Return the same unrolled path (N, n) with halved segments near obstacles, the `rows_near(Q)` of `Q: (B, n)`."""
    long = np.flatnonzero(np.linalg.norm(path[1:] - path[:-1], axis=1) > _LONGEST_NEAR_SEGMENT)
    middles = 0.5 * (path[long + 1] + path[long])
    near = np.zeros(len(path) + len(long), dtype=bool)
    near[rows_near(np.concatenate([path, middles]))] = True
    split = near[long] | near[long + 1] | near[len(path) :]
    return np.insert(path, 1 + long[split], middles[split], axis=0)


def with_way_points(path: FloatArray, places: FloatArray, apart: float) -> FloatArray:
    """Return the same path (N, n) with way points at arc lengths (K,), unless others are less than `apart` away."""
    arc = arc_lengths(plain(path))
    for place in places:
        if np.abs(arc - place).min() >= apart:
            k = int(np.searchsorted(arc, place))
            share = (place - arc[k - 1]) / (arc[k] - arc[k - 1])
            path = np.insert(path, k, path[k - 1] + share * (path[k] - path[k - 1]), axis=0)
            arc = np.insert(arc, k, place)
    return path


# A path is near an obstacle below this distance, in `length_below_50mm`.
NEAR = 0.05  # [m]
PROFILE_POINTS = 101
# The largest distance between two samples of a path.
_SAMPLE_DISTANCE = 0.05  # [rad]
# The number of bisections around the sample of least clearance.
_CLEARANCE_BISECTIONS = 12


@dataclass(frozen=True)
class DangerReport:
    """Danger along a path (paper §5: profiles over the path's natural parameter).

    `profile` (101,) is the CDF at equal steps from start to goal, `max` the largest danger found. No configuration is
    more dangerous than `max_bound`, a proven bound; None where the path leaves the limits, infinity on a danger point.
    `integral` is ∫ CDF(q(s)) ds [field · rad], `avoidable` the part of it between two less dangerous places of the
    path, above max(min_{t ≤ s} CDF(q(t)), min_{t ≥ s} CDF(q(t))) (`docs/scenarios.md`).
    """

    profile: FloatArray
    mean: float
    max: float
    max_bound: float | None
    integral: float
    avoidable: float


@dataclass(frozen=True)
class ClearanceReport:
    """Distance between robot and obstacles along a path [m].

    `link` and `obstacle` are those between which it is least, `at` is where, as a fraction of the length. The robot is
    nearer than 50 mm on `length_below_50mm` of path [rad]. `obstacles` has the least distance to each, at samples.
    """

    min: float
    mean: float
    length_below_50mm: float
    link: str | None
    obstacle: str | None
    at: float
    obstacles: dict[str, float] = field(default_factory=dict)


def sampled_places(length: float) -> FloatArray:
    """Return the arc lengths (S,) [rad] at which a path of some length is looked at."""
    return np.linspace(0.0, length, max(PROFILE_POINTS, 1 + int(np.ceil(length / _SAMPLE_DISTANCE))))


def danger_along(path: FloatArray, field: DangerField, s: FloatArray, samples: FloatArray) -> DangerReport:
    """Return the danger along `path: (N, n)`, from its `samples: (S, n)` at the arc lengths `s: (S,)` [rad]."""
    values = field.values(samples)
    peak = _proven_peak(field, path)
    integral = float(np.trapezoid(values, s))
    excess = values - forced_danger(values)
    return DangerReport(
        profile=np.interp(np.linspace(0.0, s[-1], PROFILE_POINTS), s, values) if s[-1] else values,
        mean=integral / float(s[-1]) if s[-1] else float(values[0]),
        max=max(float(values.max()), peak.lower if peak else 0.0),
        max_bound=None if peak is None else peak.upper,
        integral=integral,
        avoidable=float(np.trapezoid(excess, s)),
    )


def forced_danger(values: FloatArray) -> FloatArray:
    """Return what the ends force of the danger (S,) along a path: the larger of its minima so far and from there on."""
    before = np.minimum.accumulate(values)
    after = np.minimum.accumulate(values[::-1])[::-1]
    return np.maximum(before, after)


def _proven_peak(field: DangerField, path: FloatArray) -> DangerBounds | None:
    if not all(field.robot.within_limits(q).all() for q in path):
        return None
    return CertifiedDanger(field).of_path(path)


def clearance_along(curve: Curve, checker: CollisionChecker, s: FloatArray, samples: FloatArray) -> ClearanceReport:
    """Return distances to obstacles along `curve`, from its `samples: (S, n)` at the arc lengths `s: (S,)` [rad]."""
    names = checker.distance_names
    every = checker.all_distances(samples)
    if not names:
        return ClearanceReport(np.inf, np.inf, 0.0, None, None, 0.0)
    distances = every.min(axis=1)
    k = int(distances.argmin())
    least, at = Clearance(float(distances[k]), *names[every[k].argmin()]), float(s[k])
    step = float(s[1] - s[0])
    # The clearance may be less beside the sample with the least clearance.
    for _ in range(_CLEARANCE_BISECTIONS if step else 0):
        step /= 2
        for side in (-step, step):
            place = float(np.clip(at + side, 0.0, curve.length))
            candidate = checker.clearance(curve.at(np.array([place]))[0])
            if candidate.distance < least.distance:
                least, at = candidate, place
    mean = float(np.trapezoid(distances, s) / s[-1]) if s[-1] else least.distance
    near = float(np.trapezoid((distances < NEAR).astype(float), s))
    obstacles: dict[str, float] = {}
    for (_, obstacle), distance in zip(names, every.min(axis=0).tolist(), strict=True):
        obstacles[obstacle] = min(distance, obstacles.get(obstacle, np.inf))
    if least.obstacle is not None:
        obstacles[least.obstacle] = least.distance
    return ClearanceReport(
        *(least.distance, mean, near, least.link, least.obstacle), at / curve.length if curve.length else 0.0, obstacles
    )
