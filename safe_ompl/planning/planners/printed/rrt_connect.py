"""SAFE_RRT-CONNECT as printed, and with α = 0 RRT-Connect."""

from __future__ import annotations

from itertools import count, islice
from typing import Any

from safe_ompl.common import FloatArray
from safe_ompl.planning.planners.base import SafePlanner
from safe_ompl.planning.planners.parameters import Parameter
from safe_ompl.planning.planners.parts.extend import Extension, straight_extension
from safe_ompl.planning.planners.parts.tree import Tree


class PaperSafeRRTConnect(SafePlanner):
    """SAFE_RRT-CONNECT as it is printed in [1], §4.4, with EXTEND and CONNECT of [2]; with α = 0 `PaperRRTConnect`.

    The argument x_g is read as q_g, and CONNECT is skipped where EXTEND was trapped, as there is no q_new.

    References
    ----------
    .. [1] B. Lacevic, P. Rocco: Safety-oriented path planning for articulated robots. Robotica, 2013.
    .. [2] J. Kuffner, S. LaValle: RRT-Connect. ICRA 2000.
    """

    alpha = Parameter(1.0, "Weight of danger α, as length per danger.")
    iterations = Parameter(0, "K: how many turns the trees take; 0: until time is up.")

    def _search(self, ptc: Any) -> FloatArray | None:
        """SAFE_RRT-CONNECT."""
        tree, other = self._trees.start, self._trees.goal
        for _ in islice(count(), self.iterations or None):
            if ptc():
                break
            self._take_goals(ptc)
            q_rand = self._problem.random_configuration(self._rng)
            outcome, new = self._extend(tree, tree.best(q_rand, self.alpha), q_rand)
            if outcome is not Extension.TRAPPED:
                q_new = tree.configurations[new]
                outcome, met = self._connect(other, other.best(q_new, self.alpha), q_new, ptc)
                if outcome is Extension.REACHED:
                    return self._trees.path(tree, new, other, met)  # RETURN_PATH
            tree, other = other, tree  # SWAP
        return None

    def _extend(self, tree: Tree, old: int, target: FloatArray) -> tuple[Extension, int]:
        """EXTEND."""
        return straight_extension(self._problem, self._trees, tree, old, target, self.getRange())

    def _connect(self, tree: Tree, node: int, target: FloatArray, ptc: Any) -> tuple[Extension, int]:
        """CONNECT."""
        outcome = Extension.ADVANCED
        while outcome is Extension.ADVANCED and not ptc():
            outcome, node = self._extend(tree, node, target)
        return outcome, node
