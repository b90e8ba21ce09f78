"""Validation of a path, and the report on it: what is proven, danger, clearance and length."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from time import perf_counter
from typing import Any, TypeVar

import numpy as np
from numpy.typing import ArrayLike

from safe_ompl.collision import CollisionChecker, MotionProver, MotionVerdict, Verdict
from safe_ompl.common import FloatArray, InputError, notebook_html
from safe_ompl.danger import DangerField
from safe_ompl.motions import UserCheck, claims_of
from safe_ompl.planning.simplification.measures import (
    ClearanceReport,
    Curve,
    DangerReport,
    clearance_along,
    danger_along,
    sampled_places,
)

_Measured = TypeVar("_Measured")


@dataclass(frozen=True)
class CheckOutcome:
    """What the user's own checker, by its `name`, says of a path at samples `resolution` [rad] apart."""

    name: str
    resolution: float
    passed: bool

    def __str__(self) -> str:
        refused = "" if self.passed else " (refuses it)"
        return f"sampled at {self.resolution:g} rad: your checker {self.name}{refused}"


@dataclass(frozen=True)
class Validation:
    """What is proven of a path: true if every edge is, and the user's own checker does not refuse it.

    `proven` says whether every edge is free, and within the limits of `claims`: "collision", "min clearance", "max
    danger", "moving obstacles", "tool orientation", "tip position". `refused` is the first edge that is not, or that
    the checker refuses, and why. `checks` is what the checker says, if there is one: nothing can be proven of it.
    """

    proven: bool
    refused: tuple[int, MotionVerdict] | None = None
    claims: tuple[str, ...] = ("collision",)
    checks: tuple[CheckOutcome, ...] = ()

    def __bool__(self) -> bool:
        return self.proven and all(check.passed for check in self.checks)

    def __str__(self) -> str:
        proof = f"certified: {', '.join(self.claims)}" if self.proven else "not proven free"
        said = "; ".join([proof, *map(str, self.checks)])
        return said if self.refused is None else f"{said}; {self.why}"

    @property
    def why(self) -> str:
        """Which edge is refused, where, and for which pair; empty where none is."""
        if self.refused is None:
            return ""
        edge, verdict = self.refused
        at = "" if verdict.at is None else f" at {verdict.at:.3f} of its length"
        pair = "" if verdict.pair is None else f": {verdict.pair[0]!r} and {verdict.pair[1]!r}"
        return f"edge {edge} is {verdict.verdict.value}{at}{pair}"

    def as_dict(self) -> dict[str, Any]:
        """Return it as plain numbers, lists and strings."""
        return {
            "proven": self.proven,
            "claims": list(self.claims),
            "checks": [dict(vars(check)) for check in self.checks],
        }


def validate(path: ArrayLike, motion: MotionProver) -> Validation:
    """Return what can be proven of a path (N, n), and what the user's own checks among the motion's limits say.

    An InputError if the path is empty, or as `Robot.way_points`.
    """
    path = motion.checker.robot.way_points(path)
    if not len(path):
        raise InputError("path must have a configuration at least, got none")
    own = [limit for limit in motion.limits if isinstance(limit, UserCheck)]
    proof = replace(motion, limits=[limit for limit in motion.limits if not isinstance(limit, UserCheck)])
    refused = first_refused(path, proof)
    proven, outcomes = refused is None, []
    for check in own:
        objection = first_refused(path, check)
        outcomes.append(CheckOutcome(check.name, check.resolution, objection is None))
        refused = refused or objection
    return Validation(proven, refused, claims_of(motion), tuple(outcomes))


def first_refused(path: FloatArray, motion: MotionProver | UserCheck) -> tuple[int, MotionVerdict] | None:
    """Return the first edge of a path (N, n) that is not proven free, with the verdict; one way point is an edge."""
    ends = path[1:] if len(path) > 1 else path
    for k, (start, end) in enumerate(zip(path, ends, strict=False)):
        verdict = motion.check(start, end)
        if verdict.verdict is not Verdict.FREE:
            return k, verdict
    return None


class PathReport:
    """Report on one path; danger and clearance are computed when they are first looked at.

    `certified` and `refused` are known from the beginning. What is computed later belongs to the path, the robot, the
    scene and the field as they were. `length` is Euclidean, in joint space [rad]; of `links_without_collision` nothing
    is known, as they have no collision geometry; `time` [s] is how long danger and clearance took so far.

    Examples
    --------
    >>> report = plan("planar2", seed=0, simplify=True).report
    >>> report.certified
    True
    >>> report.danger.max <= report.danger.max_bound
    True
    """

    _measure_danger: Callable[[], DangerReport | None]
    _measure_clearance: Callable[[], ClearanceReport]

    def __init__(self, length: float, danger: DangerReport | None, clearance: ClearanceReport, certified: bool) -> None:
        self.length, self.time = length, 0.0
        self.validation = Validation(certified)
        self.links_without_collision: tuple[str, ...] = ()
        self.danger, self.clearance = danger, clearance

    @classmethod
    def of(
        cls,
        path: ArrayLike,
        checker: CollisionChecker,
        field: DangerField | None = None,
        motion: MotionProver | None = None,
    ) -> PathReport:
        """Validate a path (N, n) [rad or m] of straight motions, and return the report on it; errors as `validate`.

        By default a `MotionProver` with the checker is the validator.
        """
        report = cls.__new__(cls)
        report.validation = validate(path, motion or MotionProver(checker))
        way, scene, revision = np.asarray(path, dtype=float), checker.scene, checker.revision
        curve, frozen = Curve(checker.robot, way), None if field is None else field.frozen()
        places = sampled_places(curve.length)
        samples = curve.at(places)

        def clearance() -> ClearanceReport:
            same = checker.revision == revision
            here = checker if same else CollisionChecker(checker.robot, scene, checker.counts)
            return clearance_along(curve, here, places, samples)

        report._measure_danger = lambda: None if frozen is None else danger_along(way, frozen, places, samples)
        report._measure_clearance = clearance
        report.length, report.time = curve.length, 0.0
        report.links_without_collision = checker.robot.links_without_collision
        return report

    @cached_property
    def danger(self) -> DangerReport | None:
        """Danger along the path; None where no danger field is given."""
        return self._timed(self._measure_danger)

    @cached_property
    def clearance(self) -> ClearanceReport:
        """Distances to obstacles along the path."""
        return self._timed(self._measure_clearance)

    def _timed(self, measure: Callable[[], _Measured]) -> _Measured:
        begin = perf_counter()
        found = measure()
        self.time += perf_counter() - begin
        return found

    @property
    def certified(self) -> bool:
        """Whether every edge is proven free, and no check of the user's own refuses it."""
        return bool(self.validation)

    @property
    def refused(self) -> tuple[int, MotionVerdict] | None:
        """The first edge that is not proven free, and why; None for a certified path."""
        return self.validation.refused

    def __getstate__(self) -> dict[str, Any]:
        """Return what travels to other processes: the numbers, not what they come from."""
        numbers = {"danger": self.danger, "clearance": self.clearance}
        return {key: value for key, value in vars(self).items() if not key.startswith("_")} | numbers

    def __repr__(self) -> str:
        return f"PathReport({self.length:.3g} rad, {self.validation})"

    def __str__(self) -> str:
        """Say in three lines how long and dangerous the path is, how near it passes, and what is proven."""
        danger, clearance, unknown = self.danger, self.clearance, self.links_without_collision
        said = "" if danger is None else f", danger mean {danger.mean:.3f}, max {danger.max:.3f}"
        if danger is not None and not danger.max:  # only without danger points
            said = ", danger 0 (no obstacle has a danger weight)"
        near = "clearance: no obstacle"
        if clearance.obstacle is not None:
            near = f"clearance {1e3 * clearance.min:.1f} mm, {clearance.link} from {clearance.obstacle}"
        more = f"; no collision geometry: {', '.join(unknown)}" if unknown else ""
        return f"{self.length:.2f} rad{said}\n{near}\n{self.validation}{more}"

    _repr_html_ = notebook_html

    def as_dict(self) -> dict[str, Any]:
        """Return the report as plain numbers, lists and strings, in the form of the command line's JSON."""
        danger = None if self.danger is None else {**vars(self.danger), "profile": self.danger.profile.tolist()}
        return {
            "length": self.length,
            "danger": danger,
            "clearance": dict(vars(self.clearance)),
            "certified": self.certified,
            "validation": self.validation.as_dict(),
            "links_without_collision": list(self.links_without_collision),
        }
