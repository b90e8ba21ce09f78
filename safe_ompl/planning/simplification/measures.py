"""Paths by arc length: resampling, and the danger and the clearance along a path."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from safe_ompl.collision import Clearance, CollisionChecker
from safe_ompl.common import FloatArray
from safe_ompl.danger import CertifiedDanger, DangerBounds, DangerField
from safe_ompl.planning.simplification.costs import arc_lengths, at_arc_lengths, spread
from safe_ompl.robot import Robot, plain


class Curve:
    """A path by its arc length in joint space; the angles of continuous joints do not jump at ±π."""

    def __init__(self, robot: Robot, path: FloatArray) -> None:
        self._points = robot.unrolled(path)
        self.length = path_length(self._points)

    def spread(self, step: float) -> FloatArray:
        """Return configurations (S, n) at equal steps of at most `step` [rad] from start to goal."""
        return spread(self._points, step)[0]

    def at(self, s: FloatArray) -> FloatArray:
        """Return the configurations (S, n) at arc lengths `s: (S,)`."""
        return at_arc_lengths(self._points, plain(s))


def path_length(path: FloatArray) -> float:
    """Return the length [rad] of a path (N, n) without jumps of continuous joints."""
    return float(arc_lengths(plain(path))[-1])


def with_way_points(path: FloatArray, places: FloatArray, apart: float) -> FloatArray:
    """Return the same path with way points at arc lengths (K,) [rad], unless a way point is nearer than `apart`."""
    arc = arc_lengths(plain(path))
    for place in places:
        if np.abs(arc - place).min() >= apart:
            k = int(np.searchsorted(arc, place))
            share = (place - arc[k - 1]) / (arc[k] - arc[k - 1])
            path = np.insert(path, k, path[k - 1] + share * (path[k] - path[k - 1]), axis=0)
            arc = np.insert(arc, k, place)
    return path


# The distance of `length_below_50mm`.
NEAR = 0.05  # [m]
PROFILE_POINTS = 101
# The percentiles [%] of the runs between which the paper's figures draw a band.
SPREAD_PERCENTILES = (15, 85)
# The largest distance between two samples of a path.
_SAMPLE_DISTANCE = 0.05  # [rad]
# The number of bisections around the sample of least clearance.
_CLEARANCE_BISECTIONS = 12


@dataclass(frozen=True)
class DangerReport:
    """Danger along a path (paper §5: profiles over the path's natural parameter).

    `profile` (101,) is the CDF at equal steps from start to goal, and `max` the largest danger of the samples.
    `max_bound` is a proven upper bound of the danger on the whole path; it is None if the path leaves the limits, and
    infinity if a danger point is touched. `integral` is ∫ CDF(q(s)) ds [field · rad]. `avoidable` is the part of the
    integral above max(min_{t ≤ s} CDF(q(t)), min_{t ≥ s} CDF(q(t))) (`docs/scenarios.md`).
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

    `link` and `obstacle` are the nearest pair, and `at` is the place of the least distance as a fraction of the length.
    On `length_below_50mm` [rad] of the path the robot is nearer than 50 mm. `obstacles` has the least sampled distance
    to each obstacle.
    """

    min: float
    mean: float
    length_below_50mm: float
    link: str | None
    obstacle: str | None
    at: float
    obstacles: dict[str, float] = field(default_factory=dict)


def sampled_places(length: float) -> FloatArray:
    """Return the arc lengths (S,) [rad] at which a path of this length [rad] is sampled."""
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
    """Return the unavoidable danger (S,): the larger of the minima of the danger (S,) before and after each sample."""
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
    # The least clearance may be between the samples, so it is searched beside the sample of least clearance.
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
