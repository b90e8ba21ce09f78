"""Descent of way points down the gradient of a path's cost, by quasi-Newton steps, in rounds that are proven."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from safe_ompl.common import BoolArray, FloatArray
from safe_ompl.paths.cost import ActiveSetCost, PathCost, QuadraticModel, factored, solved
from safe_ompl.paths.edges import EdgeProofs, Within
from safe_ompl.paths.measures import Curve, path_length, with_way_points

LARGEST = 0.4  # [rad] a way point moves no farther in one step
_MEMORY = 6  # pairs of steps and changes of the gradient that are remembered
_SUFFICIENT = 1e-4  # share of the fall that the gradient promises which a step must bring (Armijo)
_GROWTH = 2.0  # a step may be longer than the last one by this factor,
_SHORTEST, _LONGEST = 0.1, 0.5  # and one that fails is shortened to between these shares of it
_TRIALS = 6


class Descent:
    """Minimises a cost over a path's way points (N, n), by L-BFGS (Nocedal & Wright, alg. 7.4 and 7.5).

    The first Hessian of every step is a chain of springs between way points, as in CHOMP (Ratliff et al. 2009), and the
    Gauss-Newton part of the densities: blocks on and beside the diagonal, solved in O(N). A step that does not lower
    the cost is shortened to where a parabola has its minimum.
    """

    def __init__(
        self, cost: PathCost | ActiveSetCost, path: FloatArray, within: Within, model: QuadraticModel | None = None
    ) -> None:
        self._cost, self._within = cost, within
        self._pairs: deque[tuple[FloatArray, FloatArray, float]] = deque(maxlen=_MEMORY)
        self.restart(path, model=model)

    def restart(self, path: FloatArray, held: BoolArray | None = None, model: QuadraticModel | None = None) -> None:
        """Go on from another path of as many way points; those that are `held: (N,)` stay where they are."""
        self._moving = np.ones(len(path), dtype=bool) if held is None else ~held
        self._moving[0] = False
        self._pairs.clear()
        self._size = 1.0
        self.resume(path, model)

    def resume(self, path: FloatArray, model: QuadraticModel | None = None) -> None:
        """Evaluate the cost anew, at a path near the last one, or after it has changed a little, or take its model."""
        model = model or self._cost.model(path)
        self.path, self.value, self._gradient = path, model.value, self._allowed(model.gradient.copy())
        moving = self._moving  # rows and columns of the others are those of the unit matrix
        blocks = np.where(moving[:, None, None], model.blocks, np.eye(path.shape[1]))
        self._hessian = factored(blocks, model.beside * (moving[1:] & moving[:-1])[:, None, None])

    def step(self, largest: float = LARGEST) -> bool:
        """Take one step, in which no joint moves farther than `largest`; return False if none lowers the cost."""
        direction = self._direction()
        slope = float(np.vdot(direction, self._gradient))
        if slope < 0:
            size = min(1.0, largest / float(np.abs(direction).max()), _GROWTH * self._size)
            for _ in range(_TRIALS):
                path = self._within(self.path + size * direction)
                value, gradient = self._cost.value_and_gradient(path)
                if value < self.value + _SUFFICIENT * size * slope:
                    gradient = self._allowed(gradient)
                    self._remember(path - self.path, gradient - self._gradient)
                    self.path, self.value, self._gradient, self._size = path, value, gradient, size
                    return True
                size *= _shortened(size * slope, value - self.value)
        if not self._pairs:
            return False
        self._pairs.clear()
        return self.step(largest)

    def _allowed(self, change: FloatArray) -> FloatArray:
        """Return the part of a change (N, n) of the path that way points may make."""
        change[-1] = 0.0
        change[~self._moving] = 0.0
        return change

    def _direction(self) -> FloatArray:
        """Return −H⁻¹∇J with the Hessian H that the remembered steps make of the path's."""
        q, shares = self._gradient.copy(), []
        for step, change, curvature in reversed(self._pairs):
            share = float(np.vdot(step, q)) / curvature
            q -= share * change
            shares.append(share)
        direction = solved(self._hessian, q.ravel()).reshape(q.shape)
        for (step, change, curvature), share in zip(self._pairs, reversed(shares), strict=True):
            direction += (share - float(np.vdot(change, direction)) / curvature) * step
        return -self._allowed(direction)

    def _remember(self, step: FloatArray, change: FloatArray) -> None:
        curvature = float(np.vdot(step, change))
        if curvature > 1e-10:
            self._pairs.append((step, change, curvature))


def _shortened(promised: float, change: float) -> float:
    """Return the share of a step that is best by the parabola through the slope before and the cost after it."""
    bend = change - promised
    return min(_LONGEST, max(_SHORTEST, -0.5 * promised / bend)) if bend < np.inf else _SHORTEST


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
_IDLE_STEPS = 2  # idle steps that end a round; one alone may have met a kink of the danger
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
    within: Within
    longest: float
    precision: float


class Price(NamedTuple):
    """What a path costs: `cost`, its J, and `total`, with the obstacle cost of the part that moves; perhaps a model."""

    cost: float
    total: float
    model: QuadraticModel | None


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
        seen, largest, round_ = self.path, LARGEST, 0
        descent = Descent(self._cost, self.path, self._terms.within, self.price.model)
        while largest >= _SMALLEST:
            settled = self._step(descent, largest, _ROUNDS[round_])
            if self._stop():
                break
            if descent.path is self.path:
                break
            gain, back = self._take(descent.path)
            if not gain:
                largest, round_ = _CAUTION * largest, 0
                self._cost.anchor(self.path)
                descent.restart(self.path, model=self.price.model)
            elif back.any():
                largest, round_ = _CAUTION * largest, 0
                descent.restart(self.path, back, self.price.model)
            elif gain < self._terms.precision * self.price.total:
                if settled:
                    break
                # The witnesses promised more: they hold for smaller steps.
                largest, round_ = _CAUTION * largest, 0
                descent.restart(self.path, model=self.price.model)
            else:
                largest, round_ = min(LARGEST, largest / _CAUTION), min(round_ + 1, len(_ROUNDS) - 1)
                if float(np.abs(self.path - seen).max()) > _FAR:
                    seen = self.path
                    if not self._look_again():
                        return False
                descent.resume(self.path, self.price.model)
        return True

    def _step(self, descent: Descent, largest: float, most: int) -> bool:
        """Take so many steps at most, as long as they are worthwhile; return whether they are no longer."""
        idle = 0
        for _ in range(most):
            before = descent.value
            if self._stop() or not descent.step(largest):
                return True
            idle = idle + 1 if before - descent.value < _IDLE * self._terms.precision * before else 0
            if idle == _IDLE_STEPS:
                return True
        return False

    def _take(self, path: FloatArray) -> tuple[float, BoolArray]:
        """Go on from what is proven of a path (N, n), if cheaper; return the gain, and which points stay (N,)."""
        back = np.zeros(len(path), dtype=bool)
        price = self._price_if_better(path)  # a price costs less than a proof
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

    def _price_if_better(self, path: FloatArray) -> Price | None:
        """Return the price of a path, unless it is not lower, or the path is too long."""
        if np.array_equal(path, self.path) or path_length(self._whole(path)) > self._terms.longest:
            return None
        cost = self._cost.of(self._whole(path))
        if not cost < self.price.total or (self.leads and not cost <= self._best.ceiling):
            return None  # whatever the obstacle cost adds
        price = self._priced(path, cost)
        return price if price.total < self.price.total else None

    def _priced(self, path: FloatArray, cost: float | None = None) -> Price:
        """Return the price of a path between the retreats, whose J may be known; the cost is anchored at it then."""
        cost = self._cost.of(self._whole(path)) if cost is None else cost
        near, model = self._cost.anchored(path)
        return Price(cost, cost + near, model)

    def _look_again(self) -> bool:
        """Take the danger points that matter now; return whether the path is still no dearer than the given one."""
        whole = self._whole(self.path)
        if self._cost.look_at(whole):
            cost = self._cost.of(whole)
            self.price = Price(cost, cost + self.price.total - self.price.cost, None)
        cost = self.price.cost
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
