"""What there is to say about a path: danger, clearance, length, and whether it is proven."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from safe_ompl.arrays import FloatArray, finite_array
from safe_ompl.collision.checker import Clearance, CollisionChecker
from safe_ompl.collision.motion import CertifiedMotion, MotionVerdict, Verdict
from safe_ompl.danger.certified import CertifiedDanger, DangerBounds
from safe_ompl.danger.field import DangerField
from safe_ompl.errors import InputError
from safe_ompl.paths.curve import Curve

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
    """

    min: float
    mean: float
    length_below_50mm: float
    link: str | None
    obstacle: str | None
    at: float


@dataclass(frozen=True)
class PathReport:
    """Report on one path.

    Attributes
    ----------
    length : float
        Euclidean length in joint space [rad].
    danger : DangerReport or None
        None where no danger field is given.
    clearance : ClearanceReport
        Distances to obstacles.
    certified : bool
        Whether every edge is proven free.
    refused : tuple of (int, MotionVerdict), optional
        The first edge that is not proven free, and why; None for a certified path.
    """

    length: float
    danger: DangerReport | None
    clearance: ClearanceReport
    certified: bool
    refused: tuple[int, MotionVerdict] | None = None

    @classmethod
    def of(
        cls,
        path: FloatArray,
        checker: CollisionChecker,
        field: DangerField | None = None,
        motion: CertifiedMotion | None = None,
    ) -> PathReport:
        """Examine a path.

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
        curve = Curve(robot, path)
        s = np.linspace(0.0, curve.length, max(PROFILE_POINTS, 1 + int(np.ceil(curve.length / _STEP))))
        samples = curve.at(s)
        refused = first_refused(path, motion or CertifiedMotion(checker))
        return cls(
            length=curve.length,
            danger=None if field is None else _danger(field, path, s, samples),
            clearance=_clearance(checker, curve, s, samples),
            certified=refused is None,
            refused=refused,
        )

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
        }


def first_refused(path: FloatArray, motion: CertifiedMotion) -> tuple[int, MotionVerdict] | None:
    """Return the index of the first edge of `path: (N, n)` that is not proven free, with the verdict; else None.

    A path of a single configuration is checked as an edge to itself.
    """
    ends = path[1:] if len(path) > 1 else path
    for k, (start, end) in enumerate(zip(path, ends, strict=False)):
        verdict = motion.check(start, end)
        if verdict.verdict is not Verdict.FREE:
            return k, verdict
    return None


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
    clearances = [checker.clearance(q) for q in samples]
    distances = np.array([c.distance for c in clearances])
    least, at = _refined_minimum(checker, curve, s, clearances)
    mean = float(np.trapezoid(distances, s) / s[-1]) if s[-1] and least.obstacle else least.distance
    near = float(np.trapezoid((distances < NEAR).astype(float), s))
    return ClearanceReport(
        least.distance, mean, near, least.link, least.obstacle, at / curve.length if curve.length else 0.0
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
