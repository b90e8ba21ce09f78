"""Certified danger: proven bounds of the peak danger of an edge and of a path, from few evaluations."""

from __future__ import annotations

from dataclasses import dataclass
from math import inf

from numpy.typing import ArrayLike

from safe_ompl.collision import MotionVerdict, Verdict
from safe_ompl.common import FloatArray, motion_ends, positive
from safe_ompl.danger.field import DangerField
from safe_ompl.danger.link_field import segment_bounds
from safe_ompl.danger.search import PeakSearch

_WITNESS = ("danger", "its limit")


@dataclass(frozen=True)
class DangerBounds:
    """What is proven of the peak danger of a motion: lower ≤ peak ≤ upper.

    The largest danger found, `lower`, is on the edge `edge`, at the fraction `at` of it. No configuration of the motion
    is more dangerous than `upper`, +inf where it cannot be kept from a danger point.
    """

    lower: float
    upper: float
    edge: int
    at: float


class CertifiedDanger:
    """Proves how dangerous straight joint motions are.

    Parameters
    ----------
    field : DangerField
        The danger.
    tolerance : float
        Bounds are narrowed until upper ≤ (1 + tolerance)·lower.
    floor : float
        [m] An interval in which the robot moves less than this is not divided any more.

    Raises
    ------
    InputError
        If tolerance or floor is not positive.

    Notes
    -----
    Samples give a lower bound of the peak. Between two of them speed and acceleration of the key points are known at
    the ends, and `KeypointRates` bounds how far they can grow; from that `danger.kernels.danger.chords` bounds the
    field of every link at every danger point from above. Aggregates are monotone and convex in the fields, so that they
    inherit the bounds. The interval with the highest bound is halved until both agree within the tolerance.
    """

    def __init__(self, field: DangerField, tolerance: float = 0.05, floor: float = 1e-4) -> None:
        self.field = field
        self.tolerance = positive(tolerance, "tolerance")
        self.floor = positive(floor, "floor")

    def __repr__(self) -> str:
        return f"CertifiedDanger({self.field!r}, tolerance={self.tolerance:g}, floor={self.floor:g})"

    def of_path(self, path: ArrayLike) -> DangerBounds:
        """Return bounds of the peak danger of a path (N, n) of straight motions.

        Raises
        ------
        InputError
            If it is empty, not finite, or leaves the limits of a prismatic joint (their strokes bound the radii).
        """
        search = PeakSearch(self.field, path, self.floor, lambda lower: (1 + self.tolerance) * lower)
        search.narrow()
        best = search.best
        return DangerBounds(best.danger, search.upper, best.edge, best.t)


class DangerLimit:
    """A danger that no configuration may exceed; proven along whole motions, as a limit of `MotionProver`.

    Parameters
    ----------
    field : DangerField
        The danger.
    limit : float
        The largest danger that is allowed, > 0.
    floor : float
        [m] A motion that is nearer to the limit than about what the danger changes over this stays undecided.
    """

    name = "danger"

    def __init__(self, field: DangerField, limit: float, floor: float = 1e-4) -> None:
        self.limit = positive(limit, "max danger")
        self.field = field
        self._floor = positive(floor, "floor")

    def __repr__(self) -> str:
        return f"DangerLimit({self.field!r}, {self.limit:g})"

    def danger(self, q: ArrayLike) -> float:
        """Return the danger at `q: (n,)`."""
        return self.field.value(q)

    def allows(self, q: ArrayLike) -> bool:
        """Return whether the danger at `q: (n,)` is within the limit."""
        return self.danger(q) <= self.limit

    def holds_within(self, q: FloatArray, steps: FloatArray) -> bool:
        """Return whether no configuration is more dangerous, proven, whose joints are within `steps: (n,)` of `q`."""
        field, robot = self.field.frozen(), self.field.robot
        if field.factors is None:
            return False
        fields, distances = field.link_fields(robot.keypoints(q)[None])
        moved = (robot.bounds.keypoint_radii @ steps)[field.links].max(axis=1)
        grown = segment_bounds(fields, distances, moved[:, None]) * field.factors[:, None]
        return bool(field.aggregated(grown.sum(axis=1))[0] <= self.limit)

    def allows_motion(self, start: ArrayLike, end: ArrayLike) -> bool:
        """Return whether the danger is proven to keep to the limit on the straight motion between two (n,)."""
        return self.check(start, end).verdict is Verdict.FREE

    def check(self, start: ArrayLike, end: ArrayLike) -> MotionVerdict:
        """Check the straight motion between two configurations (n,); errors as `CertifiedDanger.of_path`.

        Returns
        -------
        MotionVerdict
            FREE: no configuration is more dangerous, proven. BLOCKED: the one at `at` is. UNDECIDED: near `at` the
            danger is too near to the limit to tell. The `pair` is "danger" and "its limit".
        """
        ends, ceiling = motion_ends(start, end, self.field.robot.n), self.limit
        search = PeakSearch(self.field, ends, self._floor, lambda low: inf if low > ceiling else ceiling)
        search.narrow(give_up=True)
        if search.best.danger > self.limit:
            return MotionVerdict(Verdict.BLOCKED, search.best.t, _WITNESS)
        if search.upper > self.limit:
            return MotionVerdict(Verdict.UNDECIDED, search.undecided_at, _WITNESS)
        return MotionVerdict(Verdict.FREE)
