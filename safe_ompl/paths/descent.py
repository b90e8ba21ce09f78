"""Descent: way points move down the gradient of a path's cost, within constraints, by quasi-Newton steps."""

from __future__ import annotations

from collections import deque
from typing import Protocol

import numpy as np

from safe_ompl.common import BoolArray, FloatArray
from safe_ompl.paths.cost import QuadraticModel
from safe_ompl.paths.kernels import factored, solved
from safe_ompl.robot import Place, Robot, solve_from_seed

_DAMPING = 1e-6  # [m²/rad²] of the projection: keeps it defined where the arm is singular


class FeasibleSet:
    """The set of feasible paths: way points within the joint limits, between ends that are fixed."""

    def __init__(self, robot: Robot) -> None:
        self.robot = robot
        self._lower = np.where(robot.continuous, -np.inf, robot.lower)
        self._upper = np.where(robot.continuous, np.inf, robot.upper)

    def within(self, Q: FloatArray) -> FloatArray:
        """Return the configurations within limits that are nearest to `Q: (…, n)`."""
        return np.minimum(np.maximum(Q, self._lower), self._upper)

    def nearest(self, path: FloatArray) -> FloatArray:
        """Return the path within limits that is nearest to `path: (N, n)`."""
        return self.within(path)

    def holds(self, path: FloatArray) -> bool:
        """Return whether the end of `path: (N, n)` is where it may be; one that is fixed always is."""
        return True

    def tangent(self, path: FloatArray, change: FloatArray) -> FloatArray:
        """Return a change of the path (N, n) that leaves its end where it is."""
        change[-1] = 0.0
        return change


class GoalSet(Protocol):
    """A place of the tip and how near to it is near enough, such as a `WorkspaceGoal`."""

    place: Place
    tolerance: float


class FreeGoal(FeasibleSet):
    """The set of feasible paths whose last way point may be anywhere where the tip is at its place.

    Goals found are a tenth of its tolerance near.
    """

    def __init__(self, goal: GoalSet) -> None:
        super().__init__(goal.place.robot)
        self.place = goal.place
        self._tolerance = goal.tolerance
        self._precision = 0.1 * goal.tolerance

    def nearest(self, path: FloatArray) -> FloatArray:
        """Return the path within limits, its end brought to the place; an end that cannot be stays as it is."""
        allowed = self.within(path)
        end = solve_from_seed(self.place, allowed[-1], self._precision)
        if end is not None:
            allowed[-1] = end
        return allowed

    def holds(self, path: FloatArray) -> bool:
        """Return whether the end of `path: (N, n)` is near enough to the place."""
        return self.place.distance(path[-1]) <= self._tolerance

    def tangent(self, path: FloatArray, change: FloatArray) -> FloatArray:
        """Return a change of the path (N, n) whose last row is in the null space of the tip's Jacobian."""
        jacobian = self.place.jacobian(path[-1])
        square = jacobian @ jacobian.T + _DAMPING * np.eye(len(jacobian))
        change[-1] -= jacobian.T @ np.linalg.solve(square, jacobian @ change[-1])
        return change


LARGEST = 0.4  # [rad] a way point moves no farther in one step
_MEMORY = 6  # pairs of steps and changes of the gradient that are remembered
_SUFFICIENT = 1e-4  # share of the fall that the gradient promises which a step must bring (Armijo)
_GROWTH = 2.0  # a step may be longer than the last one by this factor,
_SHORTEST, _LONGEST = 0.1, 0.5  # and one that fails is shortened to between these shares of it
_TRIALS = 6


class Smooth(Protocol):
    """A function of paths with derivatives, such as `PathCost`."""

    def value_and_gradient(self, path: FloatArray) -> tuple[float, FloatArray]:
        """Return value and gradient (N, n) at a path (N, n)."""

    def model(self, path: FloatArray) -> QuadraticModel:
        """Return the same, and about the Hessian."""


class Constraints(Protocol):
    """Where paths may be: within limits, with their ends where they are to be."""

    def nearest(self, path: FloatArray) -> FloatArray:
        """Return the path (N, n) nearest to a path (N, n) that is allowed."""

    def tangent(self, path: FloatArray, change: FloatArray) -> FloatArray:
        """Return the part of a change (N, n) that `nearest` leaves as it is, to the first order."""


class Descent:
    """Minimises a cost over a path's way points (N, n), by L-BFGS (Nocedal & Wright, alg. 7.4 and 7.5).

    The first Hessian of every step is that of the path: a chain of springs between way points, as in CHOMP (Ratliff
    et al. 2009), whose inverse makes smooth moves cheap and moves of single way points dear; and the Gauss-Newton part
    of what the densities add. Both are blocks on and beside the diagonal, and solved in O(N). A step that does not
    lower the cost is shortened to where a parabola has its minimum.
    """

    def __init__(self, cost: Smooth, path: FloatArray, constraints: Constraints) -> None:
        self._cost = cost
        self._constraints = constraints
        self._pairs: deque[tuple[FloatArray, FloatArray, float]] = deque(maxlen=_MEMORY)
        self.restart(path)

    def restart(self, path: FloatArray, held: BoolArray | None = None) -> None:
        """Go on from another path of as many way points; those that are `held: (N,)` stay where they are."""
        self._moving = np.ones(len(path), dtype=bool) if held is None else ~held
        self._moving[0] = False
        self._pairs.clear()
        self._size = 1.0
        self.resume(path)

    def resume(self, path: FloatArray) -> None:
        """Evaluate the cost anew, at a path near the last one, or after it has changed a little."""
        value, gradient, blocks, beside = self._cost.model(path)
        self.path, self.value, self._gradient = path, value, self._allowed(path, gradient)
        self._hessian = BlockChain(blocks, beside, self._moving)

    def step(self, largest: float = LARGEST) -> bool:
        """Take one step, in which no joint moves farther than `largest`; return False if none lowers the cost."""
        direction = self._direction()
        slope = float(np.vdot(direction, self._gradient))
        if slope < 0:
            size = min(1.0, largest / float(np.abs(direction).max()), _GROWTH * self._size)
            for _ in range(_TRIALS):
                path = self._constraints.nearest(self.path + size * direction)
                value, gradient = self._cost.value_and_gradient(path)
                if value < self.value + _SUFFICIENT * size * slope:
                    gradient = self._allowed(path, gradient)
                    self._remember(path - self.path, gradient - self._gradient)
                    self.path, self.value, self._gradient, self._size = path, value, gradient, size
                    return True
                size *= _shortened(size * slope, value - self.value)
        if not self._pairs:
            return False
        self._pairs.clear()
        return self.step(largest)

    def _allowed(self, path: FloatArray, change: FloatArray) -> FloatArray:
        """Return the part of a change (N, n) of a path (N, n) that way points may make."""
        change = self._constraints.tangent(path, change)
        change[~self._moving] = 0.0
        return change

    def _direction(self) -> FloatArray:
        """Return −H⁻¹∇J with the Hessian H that the remembered steps make of the path's."""
        q, shares = self._gradient.copy(), []
        for step, change, curvature in reversed(self._pairs):
            share = float(np.vdot(step, q)) / curvature
            q -= share * change
            shares.append(share)
        direction = self._hessian.solve(q)
        for (step, change, curvature), share in zip(self._pairs, reversed(shares), strict=True):
            direction += (share - float(np.vdot(change, direction)) / curvature) * step
        return -self._allowed(self.path, direction)

    def _remember(self, step: FloatArray, change: FloatArray) -> None:
        curvature = float(np.vdot(step, change))
        if curvature > 1e-10:
            self._pairs.append((step, change, curvature))


def _shortened(promised: float, change: float) -> float:
    """Return the share of a step that is best by the parabola through the slope before and the cost after it."""
    bend = change - promised
    return min(_LONGEST, max(_SHORTEST, -0.5 * promised / bend)) if bend < np.inf else _SHORTEST


class BlockChain:
    """A positive symmetric matrix of blocks (N, n, n) on the diagonal and (N − 1, n, n) right of them, factored once.

    Block rows and columns that do not move, `moving: (N,)`, count as those of the unit matrix.
    """

    def __init__(self, blocks: FloatArray, beside: FloatArray, moving: BoolArray) -> None:
        blocks = np.where(moving[:, None, None], blocks, np.eye(blocks.shape[1]))
        self._band = factored(blocks, beside * (moving[1:] & moving[:-1])[:, None, None])

    def solve(self, right: FloatArray) -> FloatArray:
        """Return the solution (N, n) for the right-hand side (N, n)."""
        x: FloatArray = solved(self._band, right.ravel())
        return x.reshape(right.shape)
