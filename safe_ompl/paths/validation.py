"""Validation of a path: what is proven of it, and the outcome of the user's own checks."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from safe_ompl.collision import CertifiedMotion, MotionVerdict, ToolLimit, Verdict
from safe_ompl.common import FloatArray
from safe_ompl.danger import DangerLimit
from safe_ompl.planning.ompl import UserCheck


@dataclass(frozen=True)
class CheckOutcome:
    """What a check of the user's own says of a path.

    Attributes
    ----------
    name : str
        Name of the state validity checker or motion validator.
    resolution : float or None
        [rad] It was asked at samples so far apart, which proves nothing in between; None: about whole motions.
    passed : bool
        Whether it accepts the path.
    """

    name: str
    resolution: float | None
    passed: bool

    def __str__(self) -> str:
        how = "asked" if self.resolution is None else f"sampled at {self.resolution:g} rad"
        kind = "motion validator" if self.resolution is None else "checker"
        return f"{how}: your {kind} {self.name}" + ("" if self.passed else " (refuses it)")


@dataclass(frozen=True)
class Validation:
    """Outcome of the validation of a path.

    Attributes
    ----------
    proven : bool
        Whether every edge is proven: free of collision, and within the limits of `claims`.
    refused : tuple of (int, MotionVerdict), optional
        The first edge that is not proven, or that a check of the user's own refuses, and why; None: there is none.
    claims : tuple of str
        What the proof is of: "collision", "min clearance", "max danger", "moving obstacles", "tool orientation",
        "tip position".
    checks : tuple of CheckOutcome
        The user's own checks, of which nothing can be proven.
    """

    proven: bool
    refused: tuple[int, MotionVerdict] | None = None
    claims: tuple[str, ...] = ("collision",)
    checks: tuple[CheckOutcome, ...] = ()

    @property
    def accepted(self) -> bool:
        """Whether the path is proven, and accepted by all checks of the user's own."""
        return self.proven and all(check.passed for check in self.checks)

    def __bool__(self) -> bool:
        return self.accepted

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


def validate(path: FloatArray, motion: CertifiedMotion) -> Validation:
    """Return what can be proven of a path (N, n), and what the user's own checks among the motion's limits say."""
    own = [limit for limit in motion.limits if isinstance(limit, UserCheck)]
    proof = motion.with_limits([limit for limit in motion.limits if not isinstance(limit, UserCheck)])
    refused = first_refused(path, proof)
    proven, outcomes = refused is None, []
    for check in own:
        objection = first_refused(path, check)
        outcomes.append(CheckOutcome(check.name, check.resolution, objection is None))
        refused = refused or objection
    return Validation(proven, refused, claims_of(motion), tuple(outcomes))


def claims_of(motion: CertifiedMotion) -> tuple[str, ...]:
    """Return what a proof by this validator is of."""
    claims = ["collision"]
    separation = motion.separation
    if separation.margin or separation.min_clearance is not None:
        claims.append("min clearance")
    if any(isinstance(limit, DangerLimit) for limit in motion.limits):
        claims.append("max danger")
    if separation.speeds:
        claims.append("moving obstacles")
    claims += [limit.name for limit in motion.limits if isinstance(limit, ToolLimit)]
    return tuple(claims)


def first_refused(path: FloatArray, motion: CertifiedMotion | UserCheck) -> tuple[int, MotionVerdict] | None:
    """Return the index of the first edge of `path: (N, n)` that is not proven free, with the verdict; else None.

    A path of a single configuration is checked as an edge to itself.
    """
    ends = path[1:] if len(path) > 1 else path
    for k, (start, end) in enumerate(zip(path, ends, strict=False)):
        verdict = motion.check(start, end)
        if verdict.verdict is not Verdict.FREE:
            return k, verdict
    return None
