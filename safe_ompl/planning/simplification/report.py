"""Validation of a path, and the report on a path: its proof, danger, clearance and length."""

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
    """Result of a user's checker, by its `name`, for a path at samples `resolution` [rad] apart."""

    name: str
    resolution: float
    passed: bool

    def __str__(self) -> str:
        refused = "" if self.passed else " (refuses it)"
        return f"sampled at {self.resolution:g} rad: your checker {self.name}{refused}"


@dataclass(frozen=True)
class Validation:
    """Result of the validation of a path; true if every edge is proven and the user's checker accepts the path.

    `proven` is whether every edge is proven to satisfy all `claims`: "no collision", "min clearance", "max danger",
    "moving obstacles", "tool orientation", "tip position". `refused` is the index of the first edge that is not proven,
    or that the user's checker refuses, with the verdict. `checks` has the results of the user's checkers, which are
    sampled, not proven.
    """

    proven: bool
    refused: tuple[int, MotionVerdict] | None = None
    claims: tuple[str, ...] = ("no collision",)
    checks: tuple[CheckOutcome, ...] = ()

    def __bool__(self) -> bool:
        return self.proven and all(check.passed for check in self.checks)

    def __str__(self) -> str:
        proof = f"certified: {', '.join(self.claims)}" if self.proven else "not proven free"
        summary = "; ".join([proof, *map(str, self.checks)])
        return summary if self.refused is None else f"{summary}; {self.why}"

    @property
    def why(self) -> str:
        """A message with the edge that is refused, the place on it, and the pair of bodies; empty if there is none."""
        if self.refused is None:
            return ""
        edge, verdict = self.refused
        at = "" if verdict.at is None else f" at {verdict.at:.3f} of its length"
        pair = "" if verdict.pair is None else f": {verdict.pair[0]!r} and {verdict.pair[1]!r}"
        return f"edge {edge} is {verdict.verdict.value}{at}{pair}"

    def as_dict(self) -> dict[str, Any]:
        """Return the validation as a dict of plain values."""
        return {
            "proven": self.proven,
            "claims": list(self.claims),
            "checks": [dict(vars(check)) for check in self.checks],
        }


def validate(path: ArrayLike, motion: MotionProver) -> Validation:
    """Prove every edge of a path (N, n), and ask the user's checkers among the limits of the prover.

    Raises InputError if the path is empty; other errors as `Robot.way_points`.
    """
    path = motion.checker.robot.way_points(path)
    if not len(path):
        raise InputError("path must have at least one configuration, got none")
    own = [limit for limit in motion.limits if isinstance(limit, UserCheck)]
    proof = replace(motion, limits=[limit for limit in motion.limits if not isinstance(limit, UserCheck)])
    refused = first_refused(path, proof)
    proven, outcomes = refused is None, []
    for check in own:
        refusal = first_refused(path, check)
        outcomes.append(CheckOutcome(check.name, check.resolution, refusal is None))
        refused = refused or refusal
    return Validation(proven, refused, claims_of(motion), tuple(outcomes))


def first_refused(path: FloatArray, motion: MotionProver | UserCheck) -> tuple[int, MotionVerdict] | None:
    """Return the index of the first edge of a path (N, n) that is not proven free, with the verdict, or None.

    A path of one way point is one edge.
    """
    ends = path[1:] if len(path) > 1 else path
    for k, (start, end) in enumerate(zip(path, ends, strict=False)):
        verdict = motion.check(start, end)
        if verdict.verdict is not Verdict.FREE:
            return k, verdict
    return None


class PathReport:
    """Report on one path; danger and clearance are computed on first use.

    `certified` and `refused` are known from the beginning. Danger and clearance are those of the path, the robot, the
    scene and the field at the time of the validation. `length` is Euclidean, in joint space [rad].
    `links_without_collision` have no collision geometry, so nothing is proven of them. `time` [s] is the duration of
    computing danger and clearance so far.

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
        """Validate a path (N, n) [rad or m] of straight edges, and return its report; errors as `validate`.

        The default of `motion` is a `MotionProver` with the checker.
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
        """Danger along the path; None without a danger field."""
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
        """Whether every edge is proven free, and the user's checker accepts the path."""
        return bool(self.validation)

    @property
    def refused(self) -> tuple[int, MotionVerdict] | None:
        """The index of the first edge that is not proven free, and the verdict; None for a certified path."""
        return self.validation.refused

    def __getstate__(self) -> dict[str, Any]:
        """Return the state for pickling: the computed numbers, without robot, scene and field."""
        numbers = {"danger": self.danger, "clearance": self.clearance}
        return {key: value for key, value in vars(self).items() if not key.startswith("_")} | numbers

    def __repr__(self) -> str:
        return f"PathReport({self.length:.3g} rad, {self.validation})"

    def __str__(self) -> str:
        """Return a summary of three lines: length and danger, clearance, and proof."""
        danger, clearance, unknown = self.danger, self.clearance, self.links_without_collision
        danger_text = "" if danger is None else f", danger mean {danger.mean:.3f}, max {danger.max:.3f}"
        if danger is not None and not danger.max:  # only without danger points
            danger_text = ", danger 0 (no obstacle has a danger weight)"
        near = "clearance: no obstacle"
        if clearance.obstacle is not None:
            near = f"clearance {1e3 * clearance.min:.1f} mm, {clearance.link} from {clearance.obstacle}"
        more = f"; no collision geometry: {', '.join(unknown)}" if unknown else ""
        return f"{self.length:.2f} rad{danger_text}\n{near}\n{self.validation}{more}"

    _repr_html_ = notebook_html

    def as_dict(self) -> dict[str, Any]:
        """Return the report as a dict of plain values, which the command line writes as JSON."""
        danger = None if self.danger is None else {**vars(self.danger), "profile": self.danger.profile.tolist()}
        return {
            "length": self.length,
            "danger": danger,
            "clearance": dict(vars(self.clearance)),
            "certified": self.certified,
            "validation": self.validation.as_dict(),
            "links_without_collision": list(self.links_without_collision),
        }
