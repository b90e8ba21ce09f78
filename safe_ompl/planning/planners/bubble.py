"""BubblePlanner: bidirectional search that chains bubbles of free configuration space."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import count, islice
from typing import Any

import numpy as np

from safe_ompl.collision import BUBBLE_SHAPES, Bubble, CollisionChecker
from safe_ompl.common import FloatArray, halton_point
from safe_ompl.planning.planners.base import SafePlanner
from safe_ompl.planning.planners.parameters import Parameter
from safe_ompl.planning.planners.parts.clearance import WORTHWHILE, AdaptiveMargin
from safe_ompl.planning.planners.parts.extend import ElasticBand, TangentialDescent
from safe_ompl.planning.planners.parts.problem import DangerDecay, DangerWeight
from safe_ompl.planning.planners.parts.tree import ROOT, TwoTrees
from safe_ompl.planning.planners.parts.volume_tree import (
    JointMetric,
    VolumeTree,
    bubble_validity,
    intersect,
    volume_trees,
)

_PATH_SHARE = 0.1  # weight of g: greedy, as in weighted A*
_PENALTY = 0.5  # [m] added to the cost-to-go of a point whose clearance is below the margin
_LEAST_GAIN = 2e-3  # [m] a turn ends where the tree comes less near to its goal in a step than this, …
_GAIN_SHARE = 0.2  # … or than this share of its best step


class BubblePlanner(SafePlanner):
    """Two volume trees of bubbles, from start and goal, grown by A* until they intersect (BUBBLE_PLANNER).

    One distance query at a configuration gives a whole bubble of free configurations around it. Its end points
    wait in Open; the next one to be closed minimises f = g + h + α·CDF − β·diversity, eq. (10). No edge needs a
    check: it lies within a bubble. The planner is deterministic.

    Notes
    -----
    The bubbles take in the robot's own pairs, and the radii at their centres (`docs/mathematics.md` §3).

    The planner as it is printed in [1] is `PaperSafeBubble`, and with α = 0 `PaperBubble`. What differs here, and why:

    * bubbles of links, clipped by how far an obstacle is from the joint's axis (`shape`): fewer of them;
    * f is in metres, joints by how far they move the arm, danger by its usual slope and on a logarithmic scale: one set
      of parameters serves all robots and scenes;
    * a bubble also has an end point where the way to the current goal leaves it, and a tree goes on while it comes
      nearer to that goal, then towards a next place of Halton's sequence: far fewer bubbles;
    * the path is contracted like an elastic band [3] where that is as safe, and descends sideways (`slide`): shorter
      and less dangerous;
    * a share of the turns ignores danger (`nearest_fraction`), and danger loses weight (`danger_decay`): no passage
      stays closed;
    * points near obstacles are penalised (`clearance`): obstacles that are not dangerous are not grazed, either, and no
      way is closed;
    * points below a clearance are left out (`least_clearance`): no bubbles creep along a surface.

    References
    ----------
    .. [1] B. Lacevic, P. Rocco: Safety-oriented path planning for articulated robots. Robotica, 2013, §4.1.
    .. [2] B. Lacevic, P. Rocco: Sampling-based safe path planning for robotic manipulators. ETFA 2010.
    .. [3] S. Quinlan: Real-time modification of collision-free paths. PhD thesis, Stanford 1994.
    """

    alpha = Parameter(
        1.0,
        """Weight of danger α, relative to the median of ‖∇CDF‖ over valid configurations. With α = 0 the search is the
        classical one.""",
        kept_in="_danger.alpha",
    )
    beta = Parameter(
        0.0,
        """β: weight of the diversity, how far a point is from all closed configurations of its tree. Here it seldom
        pays; the paper's form needs it.""",
    )
    nearest_fraction = Parameter(
        1 / 3,
        "ε: share of the turns that ignore danger, so that no passage stays closed because it is dangerous.",
        at_most=1,
    )
    danger_decay = Parameter(
        500.0,
        """Number of turns after which danger counts half; after three times as many it counts next to nothing, so
        that it cannot keep the planner out of a narrow place. 0 for no decay.""",
        kept_in="_decay.half_life",
    )
    shape = Parameter(
        "link",
        """The diamond of all links' own distances ("link"), or the largest cube in the bubble of all links ("cube");
        the paper's diamond (9), or the largest cube in that. The first holds the third and is 4 times as large on a
        6-DOF arm; with cubes the search is complete [2].""",
        choices=tuple(BUBBLE_SHAPES),
    )
    slide = Parameter(
        0.8,
        """Largest sideways motion of the middle of a motion of the path, as a fraction of the range; it acts where α
        > 0.""",
        at_most=1,
        kept_in="_descent.share",
    )
    max_open = Parameter(
        0,
        """Largest number of points that wait in each Open list; when it is exceeded the better half stays. 0 for no
        limit.""",
    )
    least_clearance = Parameter(
        1e-3, "Points as near to contact as this are not closed: their bubbles lead nowhere.", unit="m"
    )
    clearance = Parameter(
        0.05,
        """Margin from all obstacles, dangerous or not. Points nearer than this wait with a penalty of 0.5 m on their
        cost-to-go, and the contracted path keeps it. It is no more than 80 % of what start and goal keep; for points it
        falls to 60 % after every twelve of them, and ends below 20 mm. It is in force while danger has weight, and
        needs a `CertifiedMotionValidator`. 0 for none.""",
        unit="m",
        kept_in="_margin.largest",
    )
    iterations = Parameter(
        0,
        """k_max: how many turns the trees take before the planner gives up, with the status TIMEOUT; 0: until time is
        up.""",
    )

    def _make_parts(self) -> None:
        self._validity = bubble_validity(self.getSpaceInformation(), self.getName())
        self._danger = DangerWeight(self._problem)
        self._decay = DangerDecay(self._danger)
        self._descent = TangentialDescent(self._bridge, self._danger)
        self._margin = AdaptiveMargin(self._problem, self._danger, WORTHWHILE)
        self._band = ElasticBand(self._problem, self._danger, self._descent)

    @property
    def _checker(self) -> CollisionChecker:
        """Robot and scene, as they are now."""
        checker: CollisionChecker = self._validity.checker
        return checker

    # ------------------------------------------------------------------------------- the paper's pseudocode

    def _search(self, ptc: Any) -> FloatArray | None:
        """BUBBLE_PLANNER."""
        tree, other = self._volumes.start, self._volumes.goal
        for _ in islice(count(), self.iterations or None):
            if ptc() or not (len(tree.open) or len(other.open)):
                break
            self._take_goals(ptc)
            self._decay.fade()
            if self._margin.is_unknown:
                self._margin.begin_between([tree.nodes()[0] for tree in (self._volumes.start, self._volumes.goal)])
            for current_goal in self._headings(other):
                path = self._expand(tree, other, current_goal, ptc)
                if path is not None:
                    self._decay.reset()
                    return self._band.settled(path, self.getRange(), ptc, self._margin.allowed)
            tree, other = other, tree  # SWAP
            self._turns += 1
        return None

    def _expand(self, tree: VolumeTree, other: VolumeTree, goal: FloatArray, ptc: Any) -> FloatArray | None:
        """Close the most promising point of Open(1), again and again as long as the tree comes nearer to the goal."""
        progress = _Progress()
        while len(tree.open) and not ptc():
            x = tree.take(int(self._f(tree, goal).argmin()))
            bubble = Bubble.around(x.q, self._checker, self.shape, 0.0 if x.parent == ROOT else self.least_clearance)
            if bubble is None:
                return None
            if not x.penalty and x.parent != ROOT and self._is_narrow(bubble):
                tree.put_back(x, _PENALTY)
                self._margin.refuse()
                continue
            new = tree.close(x, bubble.weights)
            self.counts.nodes += 1
            path = intersect(self._problem, self.shape, tree, new, other)
            if path is not None:
                return path
            points = self._bubble_endpoints(bubble, goal)
            if not len(points):  # so near to contact that its vertices are its centre
                return None
            tree.add(points, new, self._danger_term(points))
            self._bound_open(tree, goal)
            before, after = (self._metric.lengths(rows, goal).min() for rows in (x.q, points))
            if not progress.goes_on(float(before), float(after)):
                return None
        return None

    def _f(self, tree: VolumeTree, goal: FloatArray) -> FloatArray:
        """Return f = g + h + α·CDF − β·diversity, eq. (10), for the points in Open."""
        rows = tree.open
        f = self._metric.lengths(rows["q"], goal)
        f += _PATH_SHARE * rows["path_length"]
        if self.alpha and not self._ignores_danger:
            f += self.alpha * self._danger.scale * rows["cost"] + rows["penalty"]
        if self.beta:
            f -= self.beta * rows["diversity"]
        return f

    def _bubble_endpoints(self, bubble: Bubble, goal: FloatArray) -> FloatArray:
        """BUBBLE_ENDPOINTS: the vertices (K, n), and the point where the way to the goal leaves the bubble."""
        points = bubble.vertices(self._bridge.lower, self._bridge.upper, self._bridge.circular)
        points = np.vstack([points, bubble.exit(self._bridge.difference(bubble.q, goal))])
        points = self._bridge.inside(points)
        return points[self._metric.separations(bubble.q, points) > 1e-9]

    # ------------------------------------------------------------------------------------------ the searching

    def _headings(self, other: VolumeTree) -> Iterator[FloatArray]:
        """Yield what a tree heads for in its turn: the configuration that the other tree closed last, and a place.

        The places of Halton's sequence lead the trees out of dead ends, as an RRT's random configurations do.
        """
        yield other.latest
        self._places += 1
        yield self._bridge.between_bounds(halton_point(self._places, self._bridge.n))

    @property
    def _ignores_danger(self) -> bool:
        """Whether this turn, of start and goal tree one after the other, is one of those that ignore danger."""
        turn = self._turns // 2
        return int((turn + 1) * self.nearest_fraction) > int(turn * self.nearest_fraction)

    def _is_narrow(self, bubble: Bubble) -> bool:
        """Whether obstacles are nearer to the centre of a bubble than the margin."""
        margin = self._margin.in_force
        obstacles = self._checker.pairs.meets_obstacle
        return margin > 0 and bool((bubble.distances < margin)[obstacles].any())

    def _bound_open(self, tree: VolumeTree, goal: FloatArray) -> None:
        if self.max_open and len(tree.open) > self.max_open:
            half = max(1, self.max_open // 2)
            tree.open.keep(np.argpartition(self._f(tree, goal), half)[:half])

    def _danger_term(self, points: FloatArray) -> FloatArray:
        """Return the danger (K,) of points in metres, as f takes it."""
        cost = self._problem.cost
        if not self.alpha or cost.is_zero:
            return np.zeros(len(points))
        return self._danger.in_metres(cost.values(points), self._checker.robot.bounds.arm_rates)

    # -------------------------------------------------------------------------------------------- the trees

    @property
    def _structure(self) -> TwoTrees[VolumeTree]:
        return self._volumes

    def _prepare(self) -> None:
        self._danger.prepare()

    def _forget(self) -> None:
        self._metric = JointMetric(self._bridge, self._checker.robot.bounds.arm_rates, taxicab=False)
        self._volumes = volume_trees(self._bridge, self._metric, diverse=self.beta > 0)
        self._turns = self._places = 0
        self._decay.reset()
        self._margin.reset()


class _Progress:
    """Judges whether a tree that heads for a goal still comes nearer to it."""

    def __init__(self) -> None:
        self._left: float | None = None
        self._best = 0.0

    def goes_on(self, before: float, after: float) -> bool:
        """Take the distances from the goal before and after a step; return whether the gain was large enough."""
        gain = (before if self._left is None else self._left) - after
        is_enough = gain >= max(_LEAST_GAIN, _GAIN_SHARE * self._best)
        self._left, self._best = after, max(self._best, gain)
        return is_enough
