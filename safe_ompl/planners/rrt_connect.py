"""SafeRRTConnect: RRT-Connect whose trees grow from safe configurations."""

from __future__ import annotations

from itertools import count, islice
from typing import Any

from safe_ompl.arrays import FloatArray
from safe_ompl.inputs import flag, fraction, number, whole_number
from safe_ompl.planners.parts.growing import Extension, SafeStep
from safe_ompl.planners.parts.margin import AdaptiveMargin
from safe_ompl.planners.parts.selection import SafeSelection
from safe_ompl.planners.parts.short_steps import ShortSteps
from safe_ompl.planners.parts.threshold import AdaptiveThreshold
from safe_ompl.planners.parts.tree import Tree
from safe_ompl.planners.parts.trees import Trees
from safe_ompl.planners.parts.turns import Turns
from safe_ompl.planners.weighing import WeighingPlanner


class SafeRRTConnect(WeighingPlanner):
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
        Largest length of one extension, before it slides [rad]; 0 takes 7.5 % of the space's extent.
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
    threshold_rise : float
        No node is added that is more dangerous than its parent and than a threshold: at first the danger of the
        more dangerous end, which no path can avoid; after every eight refusals it rises by this share. It keeps
        the peak of the danger low. 0 for no threshold.
    short_steps : bool
        Where the step towards a random configuration is trapped, try a shorter one, of 5 to 100 % of the range: it
        leads out of narrow places. While danger is heeded only nodes whose last step was trapped, too, get
        one: elsewhere short steps double the checks, and make for paths that graze obstacles.
    balanced : bool
        Once a tree has more than 64 nodes, the smaller one has eight of nine turns: it is in a narrow place, from
        which the larger one does not help it. Otherwise the trees alternate.
    patience : float
        After so many turns half of them ignore danger, after three times as many nearly all: where danger keeps the
        planner out of a narrow place, it yields, and costs no more than about that many turns. 0: it never does.
    clearance : float
        Motions keep a margin [m] from obstacles, dangerous or not: at first this one, but no more than 80 % of what
        start and goal keep; after every twelve trapped steps it falls to 60 %. It is in force where danger is, and
        needs a `CertifiedMotionValidator`. 0 for none.
    raw_alpha : bool
        Take α as it is, in length per danger, instead of relative.
    iterations : int
        K: how often the trees take turns before the planner gives up, with the status TIMEOUT; 0: until time is up.

    Notes
    -----
    The planner as it is printed in [1] is called `PaperSafeRRTConnect`, and RRT-Connect as printed in [2]
    `PaperRRTConnect`; the argument x_g is read as q_g, and CONNECT is skipped where EXTEND was trapped (there is no
    q_new). What is ours, and what it buys:

    * a share of the choices ignores danger (`nearest_fraction`): no passage stays closed;
    * steps slide and keep to a threshold (`slide`, `threshold_rise`): lower danger;
    * a shorter step is tried (`short_steps`): fewer nodes in narrow places, more checks elsewhere;
    * a tree that lags has most of the turns (`balanced`; all of them in [3], §5.5.3): a narrow place around a start or
      a goal is left sooner;
    * motions keep a margin, as long as they can (`clearance`): what is not dangerous is not grazed, either;
    * danger yields where no path is found (`patience`): no solution is lost for its sake;
    * α is relative (`raw_alpha`): one default for all robots.

    References
    ----------
    .. [1] B. Lacevic, P. Rocco: Safety-oriented path planning for articulated robots. Robotica, 2013, §4.4.
    .. [2] J. Kuffner, S. LaValle: RRT-Connect. ICRA 2000.
    .. [3] S. LaValle: Planning Algorithms. Cambridge University Press, 2006.
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
        threshold_rise: float = 0.05,
        short_steps: bool = True,
        balanced: bool = True,
        raw_alpha: bool = False,
        patience: float = 100,
        clearance: float = 0.05,
        iterations: int = 0,
    ) -> None:
        super().__init__(si, name)
        self._selection = SafeSelection(self._danger)
        self._threshold = AdaptiveThreshold(self._danger)
        self._margin: AdaptiveMargin = AdaptiveMargin(self._task, self._danger)
        self._short_steps = ShortSteps(self._bridge, self._danger)
        self._turns = Turns()
        self._step = SafeStep(
            self._bridge, self._danger, self._slide, self._threshold, self._margin.motion_is_free
        )
        self._forget()
        self.setRange(range)
        self.setAlpha(alpha)
        self.setNearestFraction(nearest_fraction)
        self.setSlide(slide)
        self.setThresholdRise(threshold_rise)
        self.setShortSteps(short_steps)
        self.setBalanced(balanced)
        self.setRawAlpha(raw_alpha)
        self.setPatience(patience)
        self.setClearance(clearance)
        self.setIterations(iterations)

    def setNearestFraction(self, epsilon: float) -> None:
        """Set the share ε in [0, 1] of selections by distance alone."""
        self._selection.nearest_fraction = fraction("nearest_fraction", epsilon)

    def getNearestFraction(self) -> float:
        """Return the share ε of selections by distance alone."""
        return self._selection.nearest_fraction

    def setThresholdRise(self, share: float) -> None:
        """Set by what share the adaptive threshold on danger rises after eight refusals; 0 for no threshold."""
        self._threshold.rise = number("threshold_rise", share, at_least=0)

    def getThresholdRise(self) -> float:
        """Return by what share the adaptive threshold on danger rises."""
        return self._threshold.rise

    def setClearance(self, distance: float) -> None:
        """Set the largest clearance [m] that motions must keep; 0 for none."""
        self._margin.largest = number("clearance", distance, at_least=0)

    def getClearance(self) -> float:
        """Return the largest clearance [m] that motions must keep."""
        return self._margin.largest

    def setShortSteps(self, short_steps: bool) -> None:
        """Set whether a shorter step is tried where a whole one is trapped."""
        self._short_steps.allowed = flag("short_steps", short_steps)

    def getShortSteps(self) -> bool:
        """Return whether a shorter step is tried where a whole one is trapped."""
        return self._short_steps.allowed

    def setBalanced(self, balanced: bool) -> None:
        """Set whether a tree that lags behind a large one has most of the turns."""
        self._turns.balanced = flag("balanced", balanced)

    def getBalanced(self) -> bool:
        """Return whether a tree that lags behind a large one has most of the turns."""
        return self._turns.balanced

    def setRawAlpha(self, raw: bool) -> None:
        """Set whether α is taken as it is, in length per danger."""
        self._danger.is_raw = flag("raw_alpha", raw)

    def getRawAlpha(self) -> bool:
        """Return whether α is taken as it is."""
        return self._danger.is_raw

    def setIterations(self, k: int) -> None:
        """Set the largest number K of iterations; 0: until time is up."""
        self._iterations = whole_number("iterations", k, at_least=0)

    def getIterations(self) -> int:
        """Return the largest number K of iterations; 0: until time is up."""
        return self._iterations

    # ------------------------------------------------------------------------------- the paper's pseudocode

    def _search(self, ptc: Any) -> FloatArray | None:
        """SAFE_RRT-CONNECT."""
        tree, other = self._trees.start, self._trees.goal
        for _ in islice(count(), self._iterations or None):
            if ptc():
                break
            self._take_goals(ptc)
            self._patience.turn(self._rng)
            self._margin.begin(self._trees)
            q_rand = self._task.random_configuration(self._rng)
            old = self._select(tree, q_rand)
            outcome, new = self._extend(tree, old, q_rand)
            if outcome is Extension.TRAPPED and self._short_steps.help(tree, old):
                nearer = self._short_steps.nearer(
                    tree.configurations[old], q_rand, self.getRange(), self._rng
                )
                outcome, new = self._extend(tree, old, nearer)
            if outcome is not Extension.TRAPPED:
                q_new = tree.configurations[new]
                outcome, met = self._connect(other, self._select(other, q_new), q_new, ptc)
                if outcome is Extension.REACHED:
                    return self._trees.path(tree, new, other, met)  # RETURN_PATH
            if not self._turns.again(tree, other):
                tree, other = other, tree  # SWAP
        return None

    def _select(self, tree: Tree, q: FloatArray) -> int:
        """Return argmin of ρ(node, q) + α·CDF(node)."""
        return self._selection.best(tree, q, self._rng)

    def _extend(self, tree: Tree, old: int, target: FloatArray) -> tuple[Extension, int]:
        """EXTEND: one step of at most the range from node `old` towards `target`."""
        return self._step.extend(self._trees, tree, old, target, self.getRange())

    def _connect(self, tree: Tree, node: int, target: FloatArray, ptc: Any) -> tuple[Extension, int]:
        """CONNECT: extend until the target is reached, the tree is trapped, or `ptc` fires."""
        outcome = Extension.ADVANCED
        while outcome is Extension.ADVANCED and not ptc():
            outcome, node = self._extend(tree, node, target)
        return outcome, node

    # ------------------------------------------------------------------------------------------------- the trees

    @property
    def _grown(self) -> Trees:
        return self._trees

    def _forget(self) -> None:
        self._trees = Trees(self._bridge, self._task.cost, self.counts)
        self._threshold.reset()
        self._margin.reset()
        self._patience.reset()
        self._turns.reset()
