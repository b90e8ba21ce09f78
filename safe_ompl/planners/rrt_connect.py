"""SafeRRTConnect: RRT-Connect whose trees grow from safe configurations."""

from __future__ import annotations

from collections.abc import Callable
from enum import Enum
from typing import Any

import numpy as np

from safe_ompl.arrays import FloatArray
from safe_ompl.planners.base import SafePlanner, fraction, non_negative
from safe_ompl.planners.tree import Tree


class Extension(Enum):
    """Outcome of EXTEND."""

    TRAPPED = "no new node"
    ADVANCED = "a new node on the way"
    REACHED = "a new node at the target"


class SafeRRTConnect(SafePlanner):
    """Two trees, from start and goal, that grow from safe nodes and greedily connect (SAFE_RRT-CONNECT).

    A random configuration is approached from the node that minimises ρ + α·CDF, a compromise between nearness and
    danger; then the other tree tries to connect to the new node. On its way every new node slides down the gradient
    of the danger, at right angles to the step, as far as the way stays free. With α = 0 it is RRT-Connect.

    Parameters
    ----------
    si : ob.SpaceInformation
        Any space of real vectors and SO(2) parts.
    name : str
        Name in logs and benchmarks.
    range : float
        Largest length of one extension, before it slides [rad]; 0 takes 5.5 % of the space's extent.
    alpha : float
        Weight of danger, relative to the median of ‖∇CDF‖ over valid configurations: at 1, nodes that differ in
        danger as much as a typical step of 1 rad changes it are set 1 rad apart. One default serves all robots.
    nearest_fraction : float
        ε: share of the selections that ignore danger. Any ε > 0 keeps the planner probabilistically complete:
        a node in a dangerous passage would otherwise never be chosen again.
    slide : float
        Largest sideways slide of a new node, as a fraction of the range; 0 gives the paper's straight extension.
        It acts where α > 0 and the objective offers gradients (`DangerObjective` does). Selection alone lowers the
        danger little; this is the null-space motion of the paper's JT-RRT (§4.3) for a step in C-space.

    References
    ----------
    .. [1] B. Lacevic, P. Rocco: Safety-oriented path planning for articulated robots. Robotica, 2013, §4.4.
    .. [2] J. Kuffner, S. LaValle: RRT-Connect. ICRA 2000.
    """

    def __init__(
        self,
        si: Any,
        name: str = "SafeRRTConnect",
        *,
        range: float = 0.0,
        alpha: float = 1.0,
        nearest_fraction: float = 0.3,
        slide: float = 0.8,
    ) -> None:
        super().__init__(si, name)
        self.setRange(range)
        self.setAlpha(alpha)
        self.setNearestFraction(nearest_fraction)
        self.setSlide(slide)
        self._forget()

    def setAlpha(self, alpha: float) -> None:
        """Set the weight of danger α, in the robot's own scale; 0 plans classically."""
        self._alpha = non_negative("alpha", alpha)

    def getAlpha(self) -> float:
        """Return the weight of danger α."""
        return self._alpha

    def setNearestFraction(self, epsilon: float) -> None:
        """Set the share ε in [0, 1] of selections by distance alone."""
        self._nearest_fraction = fraction("nearest_fraction", epsilon)

    def getNearestFraction(self) -> float:
        """Return the share ε of selections by distance alone."""
        return self._nearest_fraction

    def setSlide(self, slide: float) -> None:
        """Set the largest sideways slide of a new node, in [0, 1], as a fraction of the range."""
        self._slide = fraction("slide", slide)

    def getSlide(self) -> float:
        """Return the largest sideways slide of a new node, as a fraction of the range."""
        return self._slide

    # ------------------------------------------------------------------------------- the paper's pseudocode

    def _search(self, ptc: Any) -> FloatArray | None:
        tree, other = self._start_tree, self._goal_tree
        while not ptc():
            self._take_goals(ptc)
            q_rand = self._random_configuration()
            old = self._select(tree, q_rand)
            outcome, new = self._extend(tree, old, q_rand)
            if outcome is not Extension.TRAPPED:
                q_new = tree.configurations[new]
                outcome, met = self._connect(other, self._select(other, q_new), q_new, ptc)
                if outcome is Extension.REACHED:
                    return self._join(tree, new, other, met)
            tree, other = other, tree
        return None

    def _select(self, tree: Tree, q: FloatArray) -> int:
        """Return argmin of ρ(node, q) + α·CDF(node)."""
        ignore_danger = self._rng.random() < self._nearest_fraction
        return tree.best(q, 0.0 if ignore_danger or not self._cost_scale else self._alpha / self._cost_scale)

    def _extend(self, tree: Tree, old: int, target: FloatArray) -> tuple[Extension, int]:
        """EXTEND: one step of at most the range from node `old` towards `target`."""
        q_old = tree.configurations[old]
        delta = self._bridge.difference(q_old, target)
        length, step = float(np.sqrt(delta @ delta)), self.getRange()
        if length <= step:
            if not self._edge_is_free(tree, q_old, target):
                return Extension.TRAPPED, old
            return Extension.REACHED, self._add(tree, target, old)
        straight = q_old + (step / length) * delta
        direction, reach = delta / length, self._slide * min(step, length - step)
        # Where the straight step is free, the slope at its end says best where to slide. Where it is not, one at
        # `old` must do: it costs nothing when the node is tried again.
        if self._edge_is_free(tree, q_old, straight):
            slid = self._slid(lambda: self._cost.value_and_gradient(straight)[1], straight, direction, reach)
            ahead = straight if slid is None or not self._edge_is_free(tree, q_old, slid) else slid
            return Extension.ADVANCED, self._add(tree, ahead, old)
        slid = self._slid(lambda: tree.gradient(old), straight, direction, reach)
        if slid is None or not self._edge_is_free(tree, q_old, slid):
            return Extension.TRAPPED, old
        return Extension.ADVANCED, self._add(tree, slid, old)

    def _slid(
        self, gradient: Callable[[], FloatArray], q: FloatArray, direction: FloatArray, reach: float
    ) -> FloatArray | None:
        """Return `q` moved down the danger's gradient at right angles to `direction`, by at most `reach`.

        The reach shrinks as the target comes near, so that every step comes nearer to it.
        """
        if not (self._alpha and reach and self._cost_scale and self._cost.has_gradients):
            return None
        slope = gradient() / self._cost_scale
        slope -= (slope @ direction) * direction
        steepness = float(np.sqrt(slope @ slope))
        if not 0 < steepness < np.inf:
            return None
        return self._bridge.inside(q - (reach * min(1.0, steepness) / steepness) * slope)

    def _edge_is_free(self, tree: Tree, near: FloatArray, far: FloatArray) -> bool:
        """Check the edge between a node and a new one in the direction in which the path drives it."""
        return self._motion_is_free(near, far) if tree.from_start else self._motion_is_free(far, near)

    def _add(self, tree: Tree, q: FloatArray, parent: int) -> int:
        self.counts.nodes += 1
        return tree.add(q, parent)

    def _connect(self, tree: Tree, node: int, target: FloatArray, ptc: Any) -> tuple[Extension, int]:
        """CONNECT: extend until the target is reached, the tree is trapped, or `ptc` fires."""
        outcome = Extension.ADVANCED
        while outcome is Extension.ADVANCED and not ptc():
            outcome, node = self._extend(tree, node, target)
        return outcome, node

    def _join(self, tree: Tree, node: int, other: Tree, met: int) -> FloatArray:
        """RETURN_PATH: the two branches, from start to goal; the configuration where they meet counts once."""
        if not tree.from_start:
            tree, node, other, met = other, met, tree, node
        return np.concatenate([tree.branch(node), other.branch(met)[-2::-1]])

    # -------------------------------------------------------------------------------------------- the trees

    def _forget(self) -> None:
        self._start_tree = Tree(self._bridge, self._cost, from_start=True)
        self._goal_tree = Tree(self._bridge, self._cost, from_start=False)

    def _add_start(self, q: FloatArray) -> None:
        self._start_tree.add(q)

    def _add_goal(self, q: FloatArray) -> None:
        self._goal_tree.add(q)

    def _has_starts(self) -> bool:
        return len(self._start_tree) > 0

    def _has_goals(self) -> bool:
        return len(self._goal_tree) > 0
