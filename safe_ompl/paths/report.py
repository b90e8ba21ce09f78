"""The report on a path: danger, clearance, length, and whether it is proven."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from time import perf_counter
from typing import Any, Protocol

from safe_ompl.collision import CertifiedMotion, CollisionChecker, MotionVerdict
from safe_ompl.common import FloatArray, InputError, finite_array
from safe_ompl.danger import DangerField
from safe_ompl.paths.measures import (
    ClearanceReport,
    Curve,
    DangerReport,
    clearance_along,
    danger_along,
    sampled_places,
)
from safe_ompl.paths.validation import CheckOutcome, Validation, validate


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
        known = _Known(self.danger, self.clearance, self.time)
        return _restored, (self.length, known, self.validation, self.links_without_collision)

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


def _restored(length: float, known: _Known, validation: Validation, links: tuple[str, ...]) -> PathReport:
    report = PathReport.__new__(PathReport)
    report.length, report._parts = length, known
    report.validation, report.links_without_collision = validation, links
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
        return sampled_places(self.curve.length)

    @cached_property
    def _samples(self) -> FloatArray:
        return self.curve.at(self._places)

    @cached_property
    def danger(self) -> DangerReport | None:
        field = self._field
        if field is None:
            return None
        begin = perf_counter()
        found = danger_along(self._path, field, self._places, self._samples)
        self.time += perf_counter() - begin
        return found

    @cached_property
    def clearance(self) -> ClearanceReport:
        begin = perf_counter()
        found = clearance_along(self.curve, self._checker, self._places, self._samples)
        self.time += perf_counter() - begin
        return found
