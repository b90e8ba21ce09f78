"""The report on a path: danger, clearance, length, and whether it is proven."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from time import perf_counter
from typing import Any, Protocol

import numpy as np

from safe_ompl.arrays import FloatArray, finite_array
from safe_ompl.collision.checker import Clearance, CollisionChecker
from safe_ompl.collision.motion import CertifiedMotion, MotionVerdict
from safe_ompl.danger.certified import CertifiedDanger, DangerBounds
from safe_ompl.danger.field import DangerField
from safe_ompl.errors import InputError
from safe_ompl.paths.curve import Curve
from safe_ompl.paths.validation import CheckOutcome, Validation, validate
from safe_ompl.paths.validation import first_refused as first_refused

NEAR = 0.05  # [m]; "near" an obstacle in `length_below_50mm`
PROFILE_POINTS = 101
_STEP = 0.05  # [rad] largest distance between two samples of a path
_REFINEMENTS = 12  # bisections around the sample of least clearance


@dataclass(frozen=True)
class DangerReport:
    """Danger along a path (paper §5: profiles over the path's natural parameter).

    Attributes
    ----------
    profile : ndarray, shape (101,)
        CDF at equal steps of the natural parameter, from start to goal.
    mean, max : float
        Over the path; `max` is the largest danger found.
    max_bound : float or None
        Proven: no configuration of the path is more dangerous. Infinity where the path cannot be kept from a danger
        point; None where nothing can be proven, because danger points move or the path leaves the limits.
    integral : float
        ∫ CDF(q(s)) ds [field · rad].
    avoidable : float
        ∫ max(0, CDF(q(s)) − max(CDF(start), CDF(goal))) ds: the part that the end points do not force.
    """

    profile: FloatArray
    mean: float
    max: float
    max_bound: float | None
    integral: float
    avoidable: float


@dataclass(frozen=True)
class ClearanceReport:
    """Distance between robot and obstacles along a path.

    Attributes
    ----------
    min, mean : float
        [m]
    length_below_50mm : float
        Length of path [rad] on which the robot is nearer than 50 mm.
    link, obstacle : str or None
        Between which two the clearance is least.
    at : float
        Where along the path, as a fraction of its length.
    obstacles : dict of str to float
        The least distance [m] to each obstacle and person, at the samples of the path.
    """

    min: float
    mean: float
    length_below_50mm: float
    link: str | None
    obstacle: str | None
    at: float
    obstacles: dict[str, float] = field(default_factory=dict)


class PathReport:
    """Report on one path. What `of` returns computes danger and clearance when they are first looked at.

    The validation is not put off: `certified` and `refused` are known from the beginning. What is computed later
    belongs to the path, the robot, the scene and the field as they were: these do not change.

    Parameters
    ----------
    length : float
        Euclidean length in joint space [rad].
    danger : DangerReport or None
        None where no danger field is given.
    clearance : ClearanceReport
        Distances to obstacles.
    certified : bool
        Whether every edge is proven free, and no check of the user's own refuses it.
    refused : tuple of (int, MotionVerdict), optional
        The first edge that is not proven free, and why; None for a certified path.
    validation : Validation, optional
        In full: what is proven, and what was sampled; default: what `certified` and `refused` say.
    links_without_collision : sequence of str
        Moving links of the robot that have no collision geometry: nothing is known of them.
    """

    def __init__(
        self,
        length: float,
        danger: DangerReport | None,
        clearance: ClearanceReport,
        certified: bool,
        refused: tuple[int, MotionVerdict] | None = None,
        *,
        validation: Validation | None = None,
        links_without_collision: Sequence[str] = (),
    ) -> None:
        self.length = length
        self.validation = validation or Validation(certified, refused)
        self.links_without_collision = tuple(links_without_collision)
        self._parts: _Parts = _Known(danger, clearance)

    @classmethod
    def of(
        cls,
        path: FloatArray,
        checker: CollisionChecker,
        field: DangerField | None = None,
        motion: CertifiedMotion | None = None,
    ) -> PathReport:
        """Validate a path, and return the report on it.

        Parameters
        ----------
        path : array_like, shape (N, n)
            Way points [rad or m]; between them joints move on straight lines.
        checker : CollisionChecker
            Robot and scene.
        field : DangerField, optional
            The danger.
        motion : CertifiedMotion, optional
            The validator; by default one on `checker`.

        Raises
        ------
        InputError
            If the path is empty, has the wrong shape, or is not finite.
        """
        robot = checker.robot
        path = finite_array(path, (None, robot.n), "path")
        if not len(path):
            raise InputError("path must have a configuration at least, got none")
        report = cls.__new__(cls)
        report._parts = _Examination(path, checker, field)
        report.length = report._parts.curve.length
        report.validation = validate(path, motion or CertifiedMotion(checker))
        report.links_without_collision = robot.links_without_collision
        return report

    @property
    def danger(self) -> DangerReport | None:
        """Danger along the path; None where no danger field is given."""
        return self._parts.danger

    @property
    def clearance(self) -> ClearanceReport:
        """Distances to obstacles along the path."""
        return self._parts.clearance

    @property
    def certified(self) -> bool:
        """Whether every edge is proven free, and no check of the user's own refuses it."""
        return self.validation.accepted

    @property
    def refused(self) -> tuple[int, MotionVerdict] | None:
        """The first edge that is not proven free, and why; None for a certified path."""
        return self.validation.refused

    @property
    def checks(self) -> tuple[CheckOutcome, ...]:
        """The user's own checks: who accepted the path, and how closely it was sampled."""
        return self.validation.checks

    @property
    def time(self) -> float:
        """How long it took to compute danger and clearance [s], as far as they were looked at."""
        return self._parts.time

    def __reduce__(self) -> tuple[Any, ...]:
        """Take the numbers along to other processes, not what they come from."""
        known = (self.length, self.danger, self.clearance, self.certified, self.refused)
        return _restored, (*known, self.validation, self.links_without_collision, self.time)

    def __repr__(self) -> str:
        return f"PathReport({self.length:.3g} rad, {self.validation})"

    def as_dict(self) -> dict[str, Any]:
        """Return the report as plain numbers, lists and strings, in the form of the command line's JSON."""
        danger = self.danger and {
            "mean": self.danger.mean,
            "max": self.danger.max,
            "max_bound": self.danger.max_bound,
            "integral": self.danger.integral,
            "avoidable": self.danger.avoidable,
            "profile": self.danger.profile.tolist(),
        }
        return {
            "length": self.length,
            "danger": danger,
            "clearance": dict(vars(self.clearance)),
            "certified": self.certified,
            "validation": self.validation.as_dict(),
            "links_without_collision": list(self.links_without_collision),
        }


def _restored(
    length: float,
    danger: DangerReport | None,
    clearance: ClearanceReport,
    certified: bool,
    refused: tuple[int, MotionVerdict] | None,
    validation: Validation,
    links: tuple[str, ...],
    time: float,
) -> PathReport:
    report = PathReport(
        length, danger, clearance, certified, refused, validation=validation, links_without_collision=links
    )
    report._parts.time = time
    return report


class _Parts(Protocol):
    """Danger and clearance of a path, and how long they took [s]."""

    time: float

    @property
    def danger(self) -> DangerReport | None: ...

    @property
    def clearance(self) -> ClearanceReport: ...


@dataclass
class _Known:
    """What is known already."""

    danger: DangerReport | None
    clearance: ClearanceReport
    time: float = 0.0


class _Examination:
    """What is found out when it is asked for, once."""

    def __init__(self, path: FloatArray, checker: CollisionChecker, field: DangerField | None) -> None:
        self.curve = Curve(checker.robot, path)
        self.time = 0.0
        self._path, self._given_checker, self._given_field = path, checker, field
        self._scene, self._revision = checker.scene, checker.revision
        self._points = None if field is None else (field.points, field.weights, field.revision)

    @property
    def _checker(self) -> CollisionChecker:
        """The checker with obstacles where they were when the path was validated."""
        checker = self._given_checker
        if checker.revision == self._revision:
            return checker
        return CollisionChecker(checker.robot, self._scene, checker.counts)

    @property
    def _field(self) -> DangerField | None:
        """The danger with obstacles where they were then."""
        field = self._given_field
        if field is None or self._points is None or field.revision == self._points[2]:
            return field
        points, weights, _ = self._points
        return field if points is None else field.with_points(points, weights)

    @cached_property
    def _places(self) -> FloatArray:
        """Arc lengths (S,) of the samples [rad]."""
        length = self.curve.length
        return np.linspace(0.0, length, max(PROFILE_POINTS, 1 + int(np.ceil(length / _STEP))))

    @cached_property
    def _samples(self) -> FloatArray:
        return self.curve.at(self._places)

    @cached_property
    def danger(self) -> DangerReport | None:
        field = self._field
        if field is None:
            return None
        begin = perf_counter()
        found = _danger(field, self._path, self._places, self._samples)
        self.time += perf_counter() - begin
        return found

    @cached_property
    def clearance(self) -> ClearanceReport:
        begin = perf_counter()
        found = _clearance(self._checker, self.curve, self._places, self._samples)
        self.time += perf_counter() - begin
        return found


def _danger(field: DangerField, path: FloatArray, s: FloatArray, samples: FloatArray) -> DangerReport:
    values = field.values(samples)
    peak = _proven_peak(field, path)
    integral = float(np.trapezoid(values, s))
    excess = np.maximum(0.0, values - max(values[0], values[-1]))
    return DangerReport(
        profile=np.interp(np.linspace(0.0, s[-1], PROFILE_POINTS), s, values) if s[-1] else values,
        mean=integral / float(s[-1]) if s[-1] else float(values[0]),
        max=max(float(values.max()), peak.lower if peak else 0.0),
        max_bound=None if peak is None else peak.upper,
        integral=integral,
        avoidable=float(np.trapezoid(excess, s)),
    )


def _proven_peak(field: DangerField, path: FloatArray) -> DangerBounds | None:
    if field.points is None or not all(field.robot.within_limits(q).all() for q in path):
        return None
    return CertifiedDanger(field).of_path(path)


def _clearance(
    checker: CollisionChecker, curve: Curve, s: FloatArray, samples: FloatArray
) -> ClearanceReport:
    names = checker.distance_names
    every = np.array([checker.distances(q) for q in samples])
    if not names:
        return ClearanceReport(np.inf, np.inf, 0.0, None, None, 0.0)
    distances = every.min(axis=1)
    nearest = every.argmin(axis=1)
    clearances = [Clearance(float(d), *names[k]) for d, k in zip(distances, nearest, strict=True)]
    least, at = _refined_minimum(checker, curve, s, clearances)
    mean = float(np.trapezoid(distances, s) / s[-1]) if s[-1] else least.distance
    near = float(np.trapezoid((distances < NEAR).astype(float), s))
    obstacles: dict[str, float] = {}
    for (_, obstacle), distance in zip(names, every.min(axis=0).tolist(), strict=True):
        obstacles[obstacle] = min(distance, obstacles.get(obstacle, np.inf))
    if least.obstacle is not None:
        obstacles[least.obstacle] = least.distance
    return ClearanceReport(
        *(least.distance, mean, near, least.link, least.obstacle),
        at / curve.length if curve.length else 0.0,
        obstacles,
    )


def _refined_minimum(
    checker: CollisionChecker, curve: Curve, s: FloatArray, clearances: list[Clearance]
) -> tuple[Clearance, float]:
    """Look between the samples beside the smallest one for a smaller clearance still."""
    k = int(np.argmin([c.distance for c in clearances]))
    best, at, step = clearances[k], float(s[k]), float(s[1] - s[0])
    for _ in range(_REFINEMENTS if best.obstacle and step else 0):
        step /= 2
        for side in (-step, step):
            place = float(np.clip(at + side, 0.0, curve.length))
            candidate = checker.clearance(curve.at(np.array([place]))[0])
            if candidate.distance < best.distance:
                best, at = candidate, place
    return best, at
