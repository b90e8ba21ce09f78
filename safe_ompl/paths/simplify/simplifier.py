"""What simplifies the paths of one robot in one scene."""

from __future__ import annotations

from contextlib import suppress
from copy import copy

import numpy as np
from numpy.typing import ArrayLike

from safe_ompl.arrays import FloatArray, finite_array
from safe_ompl.collision.checker import CollisionChecker
from safe_ompl.collision.motion import CertifiedMotion
from safe_ompl.danger.field import DangerField
from safe_ompl.errors import InputError
from safe_ompl.paths.curve import Curve
from safe_ompl.paths.simplify.cost import STEP, WEIGHT, DangerDensity, PathCost, number, reference_danger
from safe_ompl.paths.simplify.freedom import GoalSet
from safe_ompl.paths.simplify.nearness import NearnessDensity
from safe_ompl.paths.simplify.simplification import Better, Settings, Simplification, Stop, unrolled

CLEARANCE = 0.05  # [m]
EXPONENT = 2.0
LENGTH_FACTOR = 1.25
SPACING = 0.4  # [rad] between way points

_CONVERGED = 2e-3  # a round that lowers the cost by less than this share is the last


class Simplifier:
    """Lowers J = ∫ (1 + λ·CDF(q)ᵖ) ds of paths of one robot in one scene, and a cost of nearness with it.

    First departures: ends that are near obstacles are left by the steepest way out, unless `clearance` is 0; a goal
    that is free is not. Then shortcuts: the cheapest chain
    of straight motions between the path's way points. Then descent along the exact gradient of the cost, all way points
    between the departures at once; after a few steps what has become of the path must be proven,
    way points beside an edge that is not go back to where they were, and only what is proven and cheaper counts.

    Parameters
    ----------
    checker, field, motion, clearance, length_factor, spacing
        As in `simplify_danger`.
    weight : float
        λ·reference(CDF)ᵖ, with the median danger over valid configurations as reference: where the danger is that,
        a radian of path costs `weight` radians besides its own length.
    exponent : float
        p ≥ 1. Larger ones punish peaks more.

    Raises
    ------
    InputError
        If an option is out of range.
    """

    def __init__(
        self,
        checker: CollisionChecker,
        field: DangerField,
        motion: CertifiedMotion | None = None,
        *,
        weight: float = WEIGHT,
        exponent: float = EXPONENT,
        clearance: float = CLEARANCE,
        length_factor: float = LENGTH_FACTOR,
        spacing: float = SPACING,
    ) -> None:
        self.robot = checker.robot
        self.checker = checker
        self.motion = motion or CertifiedMotion(checker)
        self.length_factor = number("length_factor", length_factor, least=1.0)
        self.spacing = number("spacing", spacing, above=0.0)
        self.precision = _CONVERGED
        self.nearness = (
            NearnessDensity(checker, clearance) if number("clearance", clearance, least=0.0) else None
        )
        self.danger = DangerDensity(field, reference_danger(field, checker), weight, exponent)
        self.cost = PathCost(self.robot, [self.danger])

    def proving_by(self, motion: CertifiedMotion) -> Simplifier:
        """Return the same simplifier whose edges another certified motion proves."""
        other = copy(self)
        other.motion = motion
        return other

    def refined(self, times: int) -> Simplifier:
        """Return a simplifier that goes on where this one ends: the spacing halved so many times, smaller gains."""
        finer = copy(self)
        finer.spacing = self.spacing / 2**times
        finer.precision = self.precision / 2**times
        return finer

    def danger_along(self, path: FloatArray) -> tuple[float, float, float]:
        """Return length [rad], mean and largest danger of a path (N, n)."""
        curve = Curve(self.robot, path)
        s = np.linspace(0.0, curve.length, 2 + int(curve.length / STEP))
        danger = self.danger.field.values(curve.at(s))
        mean = float(np.trapezoid(danger, s)) / curve.length if curve.length else float(danger[0])
        return curve.length, mean, float(danger.max())

    def begin(
        self,
        path: ArrayLike,
        stop: Stop,
        on_better: Better | None = None,
        goal: GoalSet | None = None,
        *,
        proven: bool = False,
    ) -> Simplification:
        """Return what makes a path better; see `simplify_danger`. That `path` is proven already saves its proof."""
        checked = finite_array(path, (None, self.robot.n), "path")
        if len(checked) < 2:
            raise InputError(f"path must have two configurations at least, got {len(checked)}")
        settings = Settings(
            self.motion, self.danger, self.nearness, self.spacing, self.precision, self.length_factor
        )
        return Simplification(settings, unrolled(self.robot, checked), stop, on_better, goal, proven=proven)

    def simplify(
        self,
        path: ArrayLike,
        stop: Stop,
        on_better: Better | None = None,
        goal: GoalSet | None = None,
        *,
        proven: bool = False,
    ) -> FloatArray:
        """Return a better path, as `begin`; when Ctrl-C ends it, the best path so far stands."""
        run = self.begin(path, stop, on_better, goal, proven=proven)
        with suppress(KeyboardInterrupt):
            run.improve()
        return run.best
