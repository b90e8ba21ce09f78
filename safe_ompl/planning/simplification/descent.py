"""Descent of way points down the gradient of a path's cost, by quasi-Newton steps, in rounds that are proven."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from safe_ompl.common import BoolArray, FloatArray
from safe_ompl.planning.simplification.cost import ActiveSetCost
from safe_ompl.planning.simplification.costs import QuadraticModel, Walk
from safe_ompl.planning.simplification.edges import EdgeProofs
from safe_ompl.planning.simplification.measures import Curve, path_length, with_way_points
from safe_ompl.robot import StepLimits

LARGEST = 0.4  # [rad] a way point moves no farther in one step

Better = Callable[[FloatArray, float], None]


class BestPath:
    """The path that was taken last: none is taken whose J is above that of the given path, as far as J is known.

    When other danger points turn out to matter J is `confirmed` anew, and a path that is dearer is taken back.
    """

    def __init__(self, path: FloatArray, on_better: Better | None) -> None:
        self.path = path
        self.ceiling = np.inf
        self._confirmed = path
        self._on_better = on_better

    @property
    def is_confirmed(self) -> bool:
        """Whether J of the path is known for the danger points that matter near it."""
        return self.path is self._confirmed

    def take(self, path: FloatArray, cost: float) -> bool:
        """Take a proven path (N, n), if its J is not too high; return whether it is taken."""
        if not cost <= self.ceiling:
            return False
        self.path = path
        if self._on_better is not None:
            self._on_better(path, cost)
        return True

    def confirm(self, cost: float) -> bool:
        """Say what J of the path is, as is known now; if that is too high, take it back and return False."""
        if cost > self.ceiling:
            self.path = self._confirmed
            return False
        self._confirmed = self.path
        return True


_ROUNDS = (4, 10, 16)  # steps between two proofs: more, as long as the proofs succeed
_IDLE = 0.05  # of what a round must save: a step that saves less is idle
_CAUTION = 0.5  # a round that fails is tried again with this share of the step
_SMALLEST = 0.01  # [rad] steps are not worth taking
_FAR = 1.0  # [rad] when way points have moved so far, other danger points may matter
_APART = 0.01  # [rad] of path between way points, at least
_RESOLUTIONS = 2  # how often peaks are looked for
_BESIDE, _CLOSELY = 0.4, 0.02  # [rad] so far from the ends, at samples so close together
_EXCESS = 0.02  # share by which a peak is above what the ends force


class Terms(NamedTuple):
    """Requirements of a path; `precision` is the share of the cost that a round must save, or it is the last one."""

    proofs: EdgeProofs
    limits: StepLimits
    longest: float
    precision: float


class Price(NamedTuple):
    """What a path costs: `cost`, its J, and `total`, with the obstacle cost of the part that moves; a model of that."""

    cost: float
    total: float
    model: QuadraticModel


class ProvenDescent:
    """Descent of a path (N, n) between two `retreats` that stay; `leads` says whether the best path is one of these."""

    def __init__(
        self,
        path: FloatArray,
        retreats: tuple[FloatArray, FloatArray],
        cost: ActiveSetCost,
        terms: Terms,
        best: BestPath,
        stop: Callable[[], bool],
    ) -> None:
        self._retreats, self._cost, self._terms, self._best, self._stop = retreats, cost, terms, best, stop
        self.path, self.price = path, self._priced(path)
        self.leads = False

    def run(self) -> None:
        """Descend until the cost falls no more, or it is time to stop."""
        for _ in range(1 + _RESOLUTIONS):
            if not (self._converge() and self._look_again()):
                break
            if self._stop() or not self._resolve_peaks():
                break
        if self.leads and not self._best.is_confirmed:
            self._look_again()

    def _converge(self) -> bool:
        """Descend until a round gains little; return False if the path turns out to be too dear."""
        cost, seen, largest, round_ = self._cost, self.path, LARGEST, 0
        walk = Walk(*self._terms.limits)
        walk.restart(cost.densities(), self.path, self.price.model)
        idle = _IDLE * self._terms.precision
        while largest >= _SMALLEST:
            settled = walk.descend(self._stop, _ROUNDS[round_], largest, idle)
            cost.count(walk.evaluations * len(walk.danger))
            if self._stop() or not walk.evaluations:
                break
            gain, back = self._take(walk.path.copy(), (walk.danger, walk.slopes))
            if not gain or back.any() or gain < self._terms.precision * self.price.total:
                if gain and settled and not back.any():
                    break
                # The witnesses promised more: they hold for smaller steps.
                largest, round_ = _CAUTION * largest, 0
                if not gain:
                    cost.anchor(self.path)
                walk.restart(cost.densities(), self.path, self.price.model, back if gain else None)
            else:
                largest, round_ = min(LARGEST, largest / _CAUTION), min(round_ + 1, len(_ROUNDS) - 1)
                if float(np.abs(self.path - seen).max()) > _FAR:
                    seen = self.path
                    if not self._look_again():
                        return False
                walk.resume(cost.densities(), self.path, self.price.model)
        return True

    def _take(self, path: FloatArray, known: tuple[FloatArray, FloatArray]) -> tuple[float, BoolArray]:
        """Go on from what is proven of a path (N, n), with `known` danger, if cheaper; return gain, and what stays."""
        back = np.zeros(len(path), dtype=bool)
        price = self._price_if_better(path, known)  # a price costs less than a proof
        if price is not None:
            wanted = path
            path, back = self._terms.proofs.held_back(wanted, self.path)
            if path is not wanted:
                price = self._price_if_better(path)
        if price is None:
            return 0.0, back
        gain = self.price.total - price.total
        self.path, self.price = path, price
        self.leads = self._best.take(self._whole(path), price.cost) or self.leads
        return gain, back

    def _price_if_better(self, path: FloatArray, known: tuple[FloatArray, FloatArray] | None = None) -> Price | None:
        """Return the price of a path, unless it is not lower, or the path is too long."""
        whole = self._whole(path)
        if np.array_equal(path, self.path) or path_length(whole) > self._terms.longest:
            return None
        cost = self._cost.of(whole)  # more samples than the descent has: it may have got a peak between two of them
        if not cost < self.price.total or (self.leads and not cost <= self._best.ceiling):
            return None  # whatever the obstacle cost adds
        price = self._priced(path, cost, known)
        return price if price.total < self.price.total else None

    def _priced(
        self, path: FloatArray, cost: float | None = None, known: tuple[FloatArray, FloatArray] | None = None
    ) -> Price:
        """Return the price of a path between the retreats, whose J may be known; the cost is anchored at it then."""
        cost = self._cost.of(self._whole(path)) if cost is None else cost
        self._cost.anchor(path)
        model = self._cost.model(path, known)
        return Price(cost, cost + model.near, model)

    def _look_again(self) -> bool:
        """Take the danger points that matter now; return whether the path is still no dearer than the given one."""
        whole = self._whole(self.path)
        if not self._cost.look_at(whole):
            return not self.leads or self._best.confirm(self.price.cost)
        cost, model = self._cost.of(whole), self._cost.model(self.path)
        self.price = Price(cost, cost + model.near, model)
        return not self.leads or self._best.confirm(cost)

    def _resolve_peaks(self) -> bool:
        """Put way points where danger peaks beside the ends, which no node of the cost sees; return whether it does."""
        field = self._cost.everywhere.field
        forced = float(field.values(self._best.path[[0, -1]]).max())
        curve = Curve(field.robot, self.path)
        beside = np.arange(0.0, min(_BESIDE, 0.5 * curve.length), _CLOSELY)
        s = np.concatenate([beside, curve.length - beside[::-1]])
        samples = curve.at(s)
        danger = field.values(samples)
        inner = danger[1:-1]
        peak = (inner > (1.0 + _EXCESS) * forced) & (inner >= danger[:-2]) & (inner >= danger[2:])
        path = with_way_points(self.path, s[1:-1][peak], _APART)
        if len(path) == len(self.path):
            return False
        self._terms.proofs.inherit(path)
        self._cost.look_at(self._whole(path), samples[1:-1][peak])
        self.path, self.price = path, self._priced(path)
        return True

    def _whole(self, path: FloatArray) -> FloatArray:
        """Return `path` with the retreats on both sides."""
        start, goal = self._retreats
        return np.concatenate([start[:-1], path, goal[1:]])
