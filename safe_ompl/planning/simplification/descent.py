"""Descent of way points down the gradient of a path's cost, by quasi-Newton steps, in rounds that are proven."""

from __future__ import annotations

from collections.abc import Callable
from math import sqrt
from typing import NamedTuple

import numpy as np

from safe_ompl.common import BoolArray, FloatArray, caller, compiled
from safe_ompl.planning.simplification.cost import ActiveSetCost, Densities, QuadraticModel, at_nodes, integrated
from safe_ompl.planning.simplification.edges import EdgeProofs
from safe_ompl.planning.simplification.measures import Curve, path_length, with_way_points
from safe_ompl.robot import StepLimits

LARGEST = 0.4  # [rad] a way point moves no farther in one step
_MEMORY = 6  # pairs of steps and changes of the gradient that are remembered
_SUFFICIENT = 1e-4  # share of the fall that the gradient promises which a step must bring (Armijo)
_GROWTH = 2.0  # a step may be longer than the last one by this factor,
_SHORTEST, _LONGEST = 0.1, 0.5  # and one that fails is shortened to between these shares of it
_TRIALS = 6
_AT_ONCE = 4  # steps between two looks at the clock
_IDLE_STEPS = 2  # idle steps that end a round; one alone may have met a kink of the danger


class Walk(NamedTuple):
    """Where a descent is: a path, which way points move (N,), J's gradient, the Hessian's factor, and the memory.

    That is steps (M, N, n), changes of the gradient, and their products (M,). Of the path the danger (2N − 2,) and its
    gradients (2N − 2, m) at the nodes are kept. `state` has J, the size of the last step, how many steps are
    remembered, how many of the last ones were idle, and how often J was evaluated.
    """

    path: FloatArray
    moving: BoolArray
    gradient: FloatArray
    band: FloatArray
    steps: FloatArray
    changes: FloatArray
    products: FloatArray
    danger: FloatArray
    slopes: FloatArray
    state: FloatArray


class Descent:
    """Minimises the cost of a path over its way points (N, n), by L-BFGS (Nocedal & Wright, alg. 7.4 and 7.5).

    The first Hessian of every step is a chain of springs between way points, as in CHOMP (Ratliff et al. 2009), and the
    Gauss-Newton part of the densities: blocks on and beside the diagonal, solved in O(N). A step that does not lower
    the cost is shortened to where a parabola has its minimum.
    """

    def __init__(self, cost: ActiveSetCost, limits: StepLimits, path: FloatArray, model: QuadraticModel) -> None:
        self._cost, self._limits = cost, limits
        self.restart(path, model)

    def restart(self, path: FloatArray, model: QuadraticModel, held: BoolArray | None = None) -> None:
        """Go on from another path of as many way points; those that are `held: (N,)` stay where they are."""
        N, n = path.shape
        self._moving = np.ones(N, dtype=bool) if held is None else ~held
        self._moving[[0, -1]] = False
        self._memory = np.empty((_MEMORY, N, n)), np.empty((_MEMORY, N, n)), np.empty(_MEMORY)
        self._state = np.array([0.0, 1.0, 0.0, 0.0, 0.0])
        self.resume(path, model)

    def resume(self, path: FloatArray, model: QuadraticModel) -> None:
        """Go on from a path near the last one, or with another model of the cost, without what was known of it."""
        self._densities, moving = self._cost.densities(), self._moving
        band = factored(model.blocks, model.beside, moving)
        nodes, m = 2 * len(path) - 2, len(self._densities.terms.shift)
        self._state[0], self._state[3:] = model.value, 0.0
        about_nodes = np.empty(nodes), np.empty((nodes, m))
        gradient = model.gradient * moving[:, None]
        self.walk = Walk(path.copy(), moving, gradient, band, *self._memory, *about_nodes, self._state)

    def run(self, stop: Callable[[], bool], most: int, largest: float, idle: float) -> bool:
        """Take up to so many steps, in which no joint moves farther than `largest`; return whether that is to `stop`.

        It is, too, where no step lowers the cost, or the last ones did by less than a share `idle`.
        """
        settled, before = False, self._state[4]
        for done in range(0, most, _AT_ONCE):
            settled = stop() or descend(
                self._densities, self.walk, *self._limits, min(_AT_ONCE, most - done), largest, idle
            )
            if settled:
                break
        self._cost.count(int(self._state[4] - before) * len(self.walk.danger))
        return settled


@caller
def descend(
    densities: Densities, walk: Walk, lower: FloatArray, upper: FloatArray, most: int, largest: float, idle: float
) -> bool:
    """Take so many steps within the limits (n,), as `Descent.run`; return whether they are not worthwhile."""
    state, nothing, none = walk.state, np.empty(0), np.empty((0, 0))
    no_blocks = np.empty((0, 0, 0))
    for _ in range(most):
        before, lowered = state[0], False
        while not lowered:
            direction, slope, length = directed(walk)
            size = min(1.0, largest / length, _GROWTH * state[1]) if slope < 0.0 else 0.0
            for _ in range(_TRIALS if slope < 0.0 else 0):
                path = np.minimum(np.maximum(walk.path + size * direction, lower), upper)
                found = at_nodes(densities, path, nothing, none)
                value, _, gradient = integrated(path, found, densities, no_blocks, no_blocks)
                state[4] += 1.0
                if value < before + _SUFFICIENT * size * slope:
                    state[0], state[1], lowered = value, size, True
                    accept(walk, path, gradient, found.danger, found.slopes)
                    break
                bend = value - before - size * slope
                share = min(_LONGEST, max(_SHORTEST, -0.5 * size * slope / bend)) if bend < np.inf else _SHORTEST
                size *= share
            if not lowered:
                if state[2] == 0.0:
                    return True
                state[2] = 0.0
        state[3] = state[3] + 1.0 if before - value < idle * before else 0.0
        if state[3] == _IDLE_STEPS:
            return True
    return False


@compiled
def factored(blocks: FloatArray, beside: FloatArray, moving: BoolArray) -> FloatArray:
    """Return the factor's band (N·n, 2n) of a matrix with blocks (N, n, n), and (N − 1, n, n) right of them.

    Row i of a band holds the entries (i, i − w) … (i, i) of the lower triangle, w = 2n − 1. Rows and columns of way
    points that are not `moving: (N,)` are those of the unit matrix.
    """
    count, n = blocks.shape[:2]
    w = 2 * n - 1
    band = np.zeros((count * n, 2 * n))
    for k in range(count):
        for a in range(n):
            row = band[k * n + a]
            if not moving[k]:
                row[w] = 1.0
                continue
            for b in range(a + 1):
                row[w + b - a] = blocks[k, a, b]
            if k > 0 and moving[k - 1]:
                for b in range(n):
                    row[w - n + b - a] = beside[k - 1, b, a]
    for i in range(len(band)):
        for j in range(max(0, i - w), i + 1):
            rest = band[i, j - i + w]
            for k in range(max(0, i - w), j):
                rest -= band[i, k - i + w] * band[j, k - j + w]
            band[i, j - i + w] = sqrt(rest) if i == j else rest / band[j, w]
    return band


@compiled
def directed(walk: Walk) -> tuple[FloatArray, float, float]:
    """Return x = −H⁻¹∇J (N, n) with the Hessian H that the remembered steps make of L Lᵀ; ∇J·x, and the largest |x|."""
    band, w, out = walk.band, walk.band.shape[1] - 1, walk.gradient.copy()
    gradient, x, remembered = walk.gradient.ravel(), out.ravel(), int(walk.state[2])
    shares, kept = np.zeros(_MEMORY), min(remembered, _MEMORY)
    for age in range(kept):
        row = (remembered - 1 - age) % _MEMORY
        step, change, share = walk.steps[row].ravel(), walk.changes[row].ravel(), 0.0
        for i in range(len(x)):
            share += step[i] * x[i]
        shares[row] = share / walk.products[row]
        for i in range(len(x)):
            x[i] -= shares[row] * change[i]
    for i in range(len(x)):
        for j in range(max(0, i - w), i):
            x[i] -= band[i, j - i + w] * x[j]
        x[i] /= band[i, w]
    for i in range(len(x) - 1, -1, -1):
        x[i] /= band[i, w]
        for j in range(max(0, i - w), i):
            x[j] -= band[i, j - i + w] * x[i]
    for age in range(kept - 1, -1, -1):
        row = (remembered - 1 - age) % _MEMORY
        step, change, share = walk.steps[row].ravel(), walk.changes[row].ravel(), 0.0
        for i in range(len(x)):
            share += change[i] * x[i]
        for i in range(len(x)):
            x[i] += (shares[row] - share / walk.products[row]) * step[i]
    slope, largest = 0.0, 0.0
    for i in range(len(x)):
        x[i] = -x[i]
        slope += x[i] * gradient[i]
        largest = max(largest, abs(x[i]))
    return out, slope, largest


@compiled
def accept(walk: Walk, path: FloatArray, gradient: FloatArray, danger: FloatArray, slopes: FloatArray) -> None:
    """Go on to a path with a gradient (N, n), and remember the step; danger and slopes are those at its nodes."""
    row, product = int(walk.state[2]) % _MEMORY, 0.0
    for k in range(len(path)):
        for i in range(path.shape[1]):
            slope = gradient[k, i] if walk.moving[k] else 0.0
            walk.steps[row, k, i] = path[k, i] - walk.path[k, i]
            walk.changes[row, k, i] = slope - walk.gradient[k, i]
            product += walk.steps[row, k, i] * walk.changes[row, k, i]
            walk.path[k, i], walk.gradient[k, i] = path[k, i], slope
    walk.danger[:], walk.slopes[:] = danger, slopes
    walk.products[row] = product
    if product > 1e-10:
        walk.state[2] += 1.0


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
        seen, largest, round_ = self.path, LARGEST, 0
        descent = Descent(self._cost, self._terms.limits, self.path, self.price.model)
        idle = _IDLE * self._terms.precision
        while largest >= _SMALLEST:
            settled = descent.run(self._stop, _ROUNDS[round_], largest, idle)
            walk = descent.walk
            if self._stop() or not walk.state[4]:
                break
            gain, back = self._take(walk.path.copy(), (walk.danger, walk.slopes))
            if not gain or back.any() or gain < self._terms.precision * self.price.total:
                if gain and settled and not back.any():
                    break
                # The witnesses promised more: they hold for smaller steps.
                largest, round_ = _CAUTION * largest, 0
                if not gain:
                    self._cost.anchor(self.path)
                descent.restart(self.path, self.price.model, back if gain else None)
            else:
                largest, round_ = min(LARGEST, largest / _CAUTION), min(round_ + 1, len(_ROUNDS) - 1)
                if float(np.abs(self.path - seen).max()) > _FAR:
                    seen = self.path
                    if not self._look_again():
                        return False
                descent.resume(self.path, self.price.model)
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
