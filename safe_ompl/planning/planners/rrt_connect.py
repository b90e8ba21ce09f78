"""SafeRRTConnect: RRT-Connect whose trees grow from safe configurations."""

from __future__ import annotations

from itertools import count, islice
from math import sqrt
from typing import Any

from safe_ompl.common import FloatArray
from safe_ompl.planning.planners.base import Parameter, SafePlanner
from safe_ompl.planning.planners.extend import Extension, SafeStep, TangentialDescent
from safe_ompl.planning.planners.problem import AdaptiveThreshold, DangerDecay, DangerWeight, Margin
from safe_ompl.planning.planners.tree import Tree

_SHORTEST = 0.05  # of a whole step
_LARGE = 64  # nodes; easy problems are solved before a tree has more
_IN_A_ROW = 8  # turns of a tree that lags before the other has one


class SafeRRTConnect(SafePlanner):
    """Two trees, from start and goal, that grow from safe nodes and greedily connect (SAFE_RRT-CONNECT).

    A random configuration is approached from the node that minimises ρ + α·CDF, a compromise between nearness and
    danger; then the other tree tries to connect to the new node. On its way every new node moves down the gradient
    of the danger, at right angles to the step, as far as the way stays free. With α = 0 it is RRT-Connect.

    Notes
    -----
    The planner as it is printed in [1] is `PaperSafeRRTConnect`, and RRT-Connect as printed in [2] `PaperRRTConnect`.
    What differs here, and why:

    * a share of the choices ignores danger (`nearest_fraction`): no passage stays closed;
    * steps descend sideways and keep to a threshold (`slide`, `threshold_rise`): lower danger;
    * a shorter step is tried where a whole one is trapped: fewer nodes in narrow places;
    * once a tree has more than 64 nodes, the smaller one has eight of nine turns (all of them in [3], §5.5.3): a
      narrow place around a start or a goal is left sooner;
    * motions keep a margin, as long as they can (`clearance`): obstacles that are not dangerous are not grazed, either;
    * danger loses weight where no path is found (`danger_decay`): it costs no solution;
    * α is relative to the usual slope of the danger: one default serves all robots.

    References
    ----------
    .. [1] B. Lacevic, P. Rocco: Safety-oriented path planning for articulated robots. Robotica, 2013, §4.4.
    .. [2] J. Kuffner, S. LaValle: RRT-Connect. ICRA 2000.
    .. [3] S. LaValle: Planning Algorithms. Cambridge University Press, 2006.
    """

    alpha = Parameter(
        1.0,
        """Weight of danger α, relative to the median of ‖∇CDF‖ over valid configurations: at 1, nodes that differ in
        danger as much as a typical step of 1 rad changes it are set 1 rad apart. 0 plans classically.""",
        kept_in="_danger.alpha",
    )
    nearest_fraction = Parameter(
        0.3,
        """ε: share of the choices of a node by distance alone. Any ε > 0 keeps the planner probabilistically complete:
        a node in a dangerous passage would otherwise never be chosen again.""",
        at_most=1,
    )
    slide = Parameter(
        0.8,
        """Largest sideways motion of a new node down the gradient of the danger, as a fraction of the range; 0 gives
        the paper's straight extension. It acts where α > 0 and the objective offers gradients (`DangerObjective`
        does).""",
        at_most=1,
        kept_in="_descent.share",
    )
    threshold_rise = Parameter(
        0.05,
        """No node is added that is more dangerous than its parent and than a threshold. This is at first the danger of
        the more dangerous end, which no path can avoid; after every eight refusals it rises by this share. It keeps the
        peak of the danger low. 0 for no threshold.""",
        kept_in="_threshold.rise",
    )
    danger_decay = Parameter(
        100.0,
        """Number of turns after which half of the turns ignore danger; after three times as many nearly all do. So
        danger that keeps the planner out of a narrow place costs no more than about that many turns. 0 for no
        decay.""",
        kept_in="_decay.half_life",
    )
    clearance = Parameter(
        0.05,
        """Largest margin that motions keep from all obstacles, dangerous or not. It is no more than 80 % of what start
        and goal keep, and falls to 60 % after every twelve trapped steps. It is in force while danger has weight, and
        needs a `CertifiedMotionValidator`. 0 for none.""",
        unit="m",
        kept_in="_margin.largest",
    )
    iterations = Parameter(
        0, "K: how many turns the trees take before the planner gives up, with the status TIMEOUT; 0: until time is up."
    )

    _in_a_row: int  # turns of one tree

    def _make_parts(self) -> None:
        self._danger = DangerWeight(self._problem)
        self._decay = DangerDecay(self._danger)
        self._descent = TangentialDescent(self._bridge, self._danger)
        self._threshold = AdaptiveThreshold(self._danger)
        self._margin = Margin(self._problem, self._danger)
        self._step = SafeStep(self._problem, self._danger, self._descent, self._threshold, self._margin)

    def _search(self, ptc: Any) -> FloatArray | None:
        """SAFE_RRT-CONNECT."""
        tree, other = self._trees.start, self._trees.goal
        for _ in islice(count(), self.iterations or None):
            if ptc():
                break
            self._take_goals(ptc)
            self._decay.turn(self._rng)
            self._margin.begin(self._trees)
            q_rand = self._problem.random(self._rng)
            old = self._select(tree, q_rand)
            outcome, new = self._extend(tree, old, q_rand)
            if outcome is Extension.TRAPPED and self._is_narrow(tree, old):
                outcome, new = self._extend(tree, old, self._nearer(tree.configurations[old], q_rand))
            if outcome is not Extension.TRAPPED:
                q_new = tree.configurations[new]
                outcome, met = self._connect(other, self._select(other, q_new), q_new, ptc)
                if outcome is Extension.REACHED:
                    return self._trees.path(tree, new, other, met)  # RETURN_PATH
            if not self._grows_again(tree, other):
                tree, other = other, tree  # SWAP
        return None

    def _select(self, tree: Tree, q: FloatArray) -> int:
        """Return argmin of ρ(node, q) + α·CDF(node)."""
        return tree.best(q, self._danger.drawn_weight(self.nearest_fraction, self._rng))

    def _extend(self, tree: Tree, old: int, target: FloatArray) -> tuple[Extension, int]:
        """EXTEND: one step of at most the range from node `old` towards `target`."""
        return self._step.extend(self._trees, tree, old, target, self.getRange())

    def _connect(self, tree: Tree, node: int, target: FloatArray, ptc: Any) -> tuple[Extension, int]:
        """CONNECT: extend until the target is reached, the tree is trapped, or `ptc` fires."""
        outcome = Extension.ADVANCED
        while outcome is Extension.ADVANCED and not ptc():
            outcome, node = self._extend(tree, node, target)
        return outcome, node

    def _is_narrow(self, tree: Tree, node: int) -> bool:
        """Note that a step from a node was trapped; return whether a shorter one is to be tried now.

        Short steps lead out of narrow places; elsewhere they would double the checks and make for paths that graze
        obstacles. So while danger has weight only nodes whose last step was trapped, too, get one.
        """
        was_trapped = node in tree.trapped
        tree.trapped.add(node)
        return was_trapped or not self._danger.weight

    def _nearer(self, q: FloatArray, target: FloatArray) -> FloatArray:
        """Return a configuration (n,) on the way to a target, log-uniformly nearer than a whole step."""
        delta = self._bridge.difference(q, target)
        length = sqrt(delta @ delta)
        step = _SHORTEST ** self._rng.random() * min(length, self.getRange())
        return self._bridge.inside(q + (step / length) * delta) if length else q

    def _grows_again(self, tree: Tree, other: Tree) -> bool:
        """Return whether the tree that had this turn has the next one, too: it may be in a narrow place.

        The larger tree keeps some of the turns: the smaller one may be enclosed, and more nodes let in more goals.
        """
        lags = len(other) > max(_LARGE, len(tree))
        again = lags and self._in_a_row < _IN_A_ROW
        self._in_a_row = self._in_a_row + 1 if again else 1
        return again

    def _prepare(self) -> None:
        self._danger.prepare()

    def _forget(self) -> None:
        super()._forget()
        self._threshold.reset()
        self._margin.reset()
        self._decay.reset()
        self._in_a_row = 1
