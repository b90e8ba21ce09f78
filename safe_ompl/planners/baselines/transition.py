"""EXTEND of the transition-based RRTs: a step that is taken the less readily the steeper the cost rises."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from safe_ompl.arrays import FloatArray
from safe_ompl.planners.parts.growing import Extension
from safe_ompl.planners.parts.task import Task
from safe_ompl.planners.parts.tree import Tree
from safe_ompl.planners.parts.trees import Trees

_COLDEST = 1e-6  # initial temperature [1]
_TEMPERATURE_FACTOR = 2.0  # after an uphill step is accepted, or too many in a row are refused
_PATIENCE = 10  # refusals in a row before it warms up


class TransitionTest:
    """Accepts downhill steps always, and uphill steps with a probability that adapts itself (Jaillet 2010).

    Parameters
    ----------
    rng : numpy.random.Generator
        Random numbers.
    scale : float
        K, the usual cost: the mean of those of start and goal.
    """

    def __init__(self, rng: np.random.Generator, scale: float) -> None:
        self._rng = rng
        self._scale = scale
        self._temperature = _COLDEST
        self._refusals = 0

    def accepts(self, before: float, after: float, length: float) -> bool:
        """Return whether a step of this length [rad], from one cost to another, is taken."""
        if after <= before:
            return True
        slope = (after - before) / length
        if self._rng.random() < np.exp(-slope / (self._scale * self._temperature)):
            self._temperature /= _TEMPERATURE_FACTOR
            self._refusals = 0
            return True
        self._refusals += 1
        if self._refusals > _PATIENCE:
            self._temperature *= _TEMPERATURE_FACTOR
            self._refusals = 0
        return False


class TransitionStep:
    """EXTEND with the transition test.

    Parameters
    ----------
    task : Task
        The problem.
    trees : Trees
        What grows.
    test : TransitionTest
        Which steps up the cost are taken.
    step : float
        Largest length of one step [rad].
    detour : callable, optional
        For a tree and a configuration (n,) that the test refuses: another one to test instead, or None.
    """

    def __init__(
        self,
        task: Task,
        trees: Trees,
        test: TransitionTest,
        step: float,
        detour: Callable[[Tree, FloatArray], FloatArray | None] = lambda tree, q: None,
    ) -> None:
        self._task = task
        self._trees = trees
        self._test = test
        self._step = step
        self._detour = detour

    def extend(self, tree: Tree, old: int, target: FloatArray) -> tuple[Extension, int]:
        """Take one step from node `old` towards `target: (n,)`, if it is free and passes the transition test."""
        bridge, q_old = self._task.bridge, tree.configurations[old]
        delta = bridge.difference(q_old, target)
        length = float(np.sqrt(delta @ delta))
        if length == 0.0:
            return Extension.REACHED, old
        reached, step = length <= self._step, min(length, self._step)
        q_new = target if reached else bridge.wrapped(q_old + (step / length) * delta)
        passed = self._passed(tree, old, q_new)
        if passed is None or not self._task.motion_is_free(*tree.as_driven(q_old, passed[0])):
            return Extension.TRAPPED, old
        outcome = Extension.REACHED if reached and passed[0] is q_new else Extension.ADVANCED
        return outcome, self._trees.add(tree, passed[0], old, passed[1])

    def _passed(self, tree: Tree, old: int, q_new: FloatArray) -> tuple[FloatArray, float] | None:
        """Return the configuration at which the step may end, and its cost; None if it is too dear."""
        if self._task.cost.is_zero:
            return q_new, 0.0
        tested = self._tested(tree, old, q_new)
        if tested is not None:
            return tested
        other = self._detour(tree, q_new)
        return None if other is None else self._tested(tree, old, other)

    def _tested(self, tree: Tree, old: int, q: FloatArray) -> tuple[FloatArray, float] | None:
        length = float(np.linalg.norm(self._task.bridge.difference(tree.configurations[old], q)))
        before, after = float(tree.costs[old]), float(self._task.cost.values(q[None])[0])
        return (q, after) if self._test.accepts(before, after, length) else None


def usual_cost(trees: Trees) -> float:
    """Return K, the mean cost of start and goal, or 1 where that is of no use."""
    ends = np.concatenate([trees.start.costs[:1], trees.goal.costs[:1]])
    usual = float(ends.mean())
    return usual if np.isfinite(usual) and usual > 0 else 1.0
