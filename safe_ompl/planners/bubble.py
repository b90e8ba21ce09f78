"""BubblePlanner: bidirectional search that chains bubbles of free configuration space."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import count, islice, pairwise
from typing import Any

import numpy as np

from safe_ompl.arrays import FloatArray
from safe_ompl.collision.bubble import INSIDE, Bubble
from safe_ompl.collision.checker import CollisionChecker
from safe_ompl.errors import InputError, UnknownNameError
from safe_ompl.inputs import flag, fraction, number, whole_number
from safe_ompl.maths.bubbles import BUBBLE_SHAPES
from safe_ompl.maths.halton import halton_point
from safe_ompl.planners.graphs.volume_tree import JointMetric, VolumeTree, VolumeTrees
from safe_ompl.planners.parts.elastic_band import ElasticBand
from safe_ompl.planners.parts.margin import WORTHWHILE, AdaptiveMargin
from safe_ompl.planners.parts.progress import Progress
from safe_ompl.planners.parts.tree import ROOT
from safe_ompl.planners.weighing import WeighingPlanner
from safe_ompl.plugins.validity import CollisionFreeValidity

_PATH_SHARE = 0.1  # weight of g where f is normalised: greedy, as in weighted A*
_TOLL = 0.5  # [m] what a point without room seems farther from the goal by


class BubblePlanner(WeighingPlanner):
    """Two volume trees of bubbles, from start and goal, grown by A* until they intersect (BUBBLE_PLANNER).

    One distance query at a configuration gives a whole bubble of free configurations around it. Its end points
    wait in Open; the next one to be closed minimises f = g + h + α·CDF − β·diversity, eq. (10). No edge needs a
    check: it lies within a bubble. The planner is deterministic.

    Parameters
    ----------
    si : ob.SpaceInformation
        Its validity checker must be a `CollisionFreeValidity`: bubbles come from distances.
    name : str
        Name in logs and benchmarks.
    alpha : float
        Weight of danger; with `normalized`, relative to the median of ‖∇CDF‖ over valid configurations.
        With α = 0 the search is the classical one.
    beta : float
        β, weight of the diversity: how far a point is from all closed configurations of its tree. Where the
        search is `guided` it does not pay; the paper's form needs it.
    nearest_fraction : float
        ε: share of the turns that ignore danger, so that no passage stays closed because it is dangerous.
    patience : float
        After so many turns danger counts half, after three times as many next to nothing: where it keeps the planner
        out of a narrow place, it yields. 0: it never does.
    shape : {"link", "cube", "paper", "paper_cube"}
        The diamond of all links' own distances, or the largest cube in the bubble of all links; the paper's diamond
        (9), or the largest cube in that. The first holds the third and is 4 times as large on a 6-DOF arm; with
        cubes the search is complete [2].
    slide : float
        Largest sideways slide of the middle of a motion, as a fraction of the range (`guided`, α > 0).
    normalized : bool
        Measure the terms of f in metres, so that one set of parameters serves all robots and scenes: joints by
        how far they move the arm, danger by its usual slope and on a logarithmic scale. False is the paper's
        f: joint angles in the 1-norm, danger as it is.
    guided : bool
        Add an end point where the way to the current goal leaves the bubble; expand one tree as long as it comes
        nearer to that goal, then towards a next place of Halton's sequence; contract the path found like an
        elastic band [3] where that is as safe. False is the paper's pseudocode.
    max_open : int
        Largest number of points that wait in each Open list; when it is reached the better half stays.
        0 for no limit.
    least_clearance : float
        Points as near to contact as this are not closed [m]: their bubbles lead nowhere.
    clearance : float
        Points that are nearer to obstacles, dangerous or not, than this margin [m] wait as if they were 0.5 m farther
        from the goal, and what contracts and slides keeps it. It is no more than 80 % of what start and goal keep; for
        points it falls to 60 % after every twelve of them, and ends below 20 mm. It is in force where danger is, and
        needs a `CertifiedMotionValidator`. 0 for none.
    iterations : int
        k_max: how many turns the trees take before the planner gives up, with the status TIMEOUT; 0: until time is up.

    Notes
    -----
    The bubbles take in the robot's own pairs, and the radii at their centres (`docs/mathematics.md` §3).

    The planner as it is printed in [1] is called `PaperSafeBubble`, and with α = 0 `PaperBubble`: bubbles (9), f of
    (10) with angles in the 1-norm for g and h. Where the print leaves something open it is read so: C is Closed(1);
    the roots wait in Open and are closed once; d_c counts the robot's own pairs, too, or a bubble would not be free;
    vertices lie 0.99 of the way to the boundary, and within the joint limits; of several bubbles that intersect the
    new one, the path takes the one that it overlaps most. What is ours, and what it buys:

    * bubbles of links, clipped by how far an obstacle is from the joint's axis (`shape`): fewer of them;
    * f in metres and on a logarithmic scale (`normalized`): one set of parameters for all robots and scenes;
    * a tree goes on while it comes nearer, and heads for other places, too (`guided`): far fewer bubbles;
    * the path is contracted and slides (`guided`, `slide`): shorter and less dangerous;
    * a share of the turns ignores danger (`nearest_fraction`), and danger fades (`patience`): no passage stays closed;
    * points without room wait (`clearance`): what is not dangerous is not grazed, either, and no way is closed;
    * bubbles below a clearance are left out (`least_clearance`): none is spent on creeping along a surface.

    References
    ----------
    .. [1] B. Lacevic, P. Rocco: Safety-oriented path planning for articulated robots. Robotica, 2013, §4.1.
    .. [2] B. Lacevic, P. Rocco: Sampling-based safe path planning for robotic manipulators. ETFA 2010.
    .. [3] S. Quinlan: Real-time modification of collision-free paths. PhD thesis, Stanford 1994.
    """

    def __init__(
        self,
        si: Any,
        name: str = "BubblePlanner",
        *,
        alpha: float = 1.0,
        beta: float = 0.0,
        nearest_fraction: float = 1 / 3,
        patience: float = 500,
        shape: str = "link",
        slide: float = 0.8,
        normalized: bool = True,
        guided: bool = True,
        max_open: int = 0,
        least_clearance: float = 1e-3,
        clearance: float = 0.05,
        iterations: int = 0,
    ) -> None:
        super().__init__(si, name)
        validity = si.getStateValidityChecker()
        if not isinstance(validity, CollisionFreeValidity):
            raise InputError(
                f"{name} needs a CollisionFreeValidity as state validity checker, for the distances that bubbles "
                f"come from; got {type(validity).__name__}"
            )
        self._validity = validity
        self._margin: AdaptiveMargin = AdaptiveMargin(self._task, self._danger, WORTHWHILE)
        self._band = ElasticBand(self._task, self._danger, self._slide)
        self.setAlpha(alpha)
        self.setBeta(beta)
        self.setNearestFraction(nearest_fraction)
        self.setPatience(patience)
        self.setShape(shape)
        self.setSlide(slide)
        self.setNormalized(normalized)
        self.setGuided(guided)
        self.setMaxOpen(max_open)
        self.setLeastClearance(least_clearance)
        self.setClearance(clearance)
        self.setIterations(iterations)
        self._forget()

    @property
    def _checker(self) -> CollisionChecker:
        """Robot and scene, as they are now."""
        checker: CollisionChecker = self._validity.checker
        return checker

    def setBeta(self, beta: float) -> None:
        """Set the weight β of the diversity."""
        self._beta = number("beta", beta, at_least=0)

    def getBeta(self) -> float:
        """Return the weight β of the diversity."""
        return self._beta

    def setNearestFraction(self, epsilon: float) -> None:
        """Set the share ε in [0, 1] of turns that ignore danger."""
        self._nearest_fraction = fraction("nearest_fraction", epsilon)

    def getNearestFraction(self) -> float:
        """Return the share ε of turns that ignore danger."""
        return self._nearest_fraction

    def setShape(self, shape: str) -> None:
        """Set the shape of the bubbles: "link", "cube", "paper" or "paper_cube"."""
        if shape not in BUBBLE_SHAPES:
            raise UnknownNameError("shape", shape, BUBBLE_SHAPES)
        self._shape = shape

    def getShape(self) -> str:
        """Return the shape of the bubbles."""
        return self._shape

    def setNormalized(self, normalized: bool) -> None:
        """Set whether the terms of f are normalised."""
        self._normalized = flag("normalized", normalized)

    def getNormalized(self) -> bool:
        """Return whether the terms of f are normalised."""
        return self._normalized

    def setGuided(self, guided: bool) -> None:
        """Set whether the search is guided."""
        self._guided = flag("guided", guided)

    def getGuided(self) -> bool:
        """Return whether the search is guided."""
        return self._guided

    def setMaxOpen(self, count: int) -> None:
        """Set the largest number of points in each Open list; 0 for no limit."""
        self._max_open = whole_number("max_open", count, at_least=0)

    def getMaxOpen(self) -> int:
        """Return the largest number of points in each Open list; 0 for no limit."""
        return self._max_open

    def setLeastClearance(self, clearance: float) -> None:
        """Set the clearance [m] above which points are closed."""
        self._least_clearance = number("least_clearance", clearance, at_least=0)

    def getLeastClearance(self) -> float:
        """Return the clearance [m] above which points are closed."""
        return self._least_clearance

    def setIterations(self, k: int) -> None:
        """Set the largest number k_max of turns; 0: until time is up."""
        self._iterations = whole_number("iterations", k, at_least=0)

    def getIterations(self) -> int:
        """Return the largest number k_max of turns; 0: until time is up."""
        return self._iterations

    # ------------------------------------------------------------------------------- the paper's pseudocode

    def _search(self, ptc: Any) -> FloatArray | None:
        """BUBBLE_PLANNER."""
        tree, other = self._trees.start, self._trees.goal
        for _ in islice(count(), self._iterations or None):
            if ptc() or not (len(tree.open) or len(other.open)):
                break
            self._take_goals(ptc)
            self._patience.fade()
            if self._margin.is_unknown:
                self._margin.begin_between(
                    [tree.bubbles()[0] for tree in (self._trees.start, self._trees.goal)]
                )
            for current_goal in self._headings(other):
                path = self._expand(tree, other, current_goal, ptc)
                if path is not None:
                    self._patience.reset()
                    return (
                        self._band.settled(path, self.getRange(), ptc, self._margin.allowed)
                        if self._guided
                        else path
                    )
            tree, other = other, tree  # SWAP
            self._turns += 1
        return None

    def _expand(self, tree: VolumeTree, other: VolumeTree, goal: FloatArray, ptc: Any) -> FloatArray | None:
        """Close the most promising point of Open(1): once, or guided as long as the tree comes nearer to the goal."""
        progress = Progress()
        while len(tree.open) and not ptc():
            x = tree.take(int(self._f(tree, goal).argmin()))
            bubble = Bubble.around(
                x.q, self._checker, self._shape, 0.0 if x.parent == ROOT else self._least_clearance
            )
            if bubble is None:
                return None
            if not x.toll and x.parent != ROOT and self._is_narrow(bubble):  # it waits
                tree.put_back(x, _TOLL)
                self._margin.refuse()
                continue
            new = tree.close(x, bubble.weights)
            self.counts.nodes += 1
            path = self._intersect(tree, new, other)
            if path is not None:
                return path
            points = self._bubble_endpoints(bubble, goal)
            if not len(points):  # so near to contact that its vertices are its centre
                return None
            tree.add(points, new, self._danger_term(points))
            self._bound_open(tree, goal)
            before, after = (self._metric.lengths(rows, goal).min() for rows in (x.q, points))
            if not (self._guided and progress.goes_on(float(before), float(after))):
                return None
        return None

    def _f(self, tree: VolumeTree, goal: FloatArray) -> FloatArray:
        """Return f = g + h + α·CDF − β·diversity, eq. (10), for the points in Open."""
        rows = tree.open
        f = self._metric.lengths(rows["q"], goal)
        f += (_PATH_SHARE if self._normalized else 1.0) * rows["path_length"]
        if self.getAlpha() and not self._careless:
            f += self.getAlpha() * self._danger.heed * rows["cost"] + rows["toll"]
        if self._beta:
            f -= self._beta * rows["diversity"]
        return f

    def _intersect(self, tree: VolumeTree, new: int, other: VolumeTree) -> FloatArray | None:
        """INTERSECT: the path through the new bubble and the bubble of the other tree that it overlaps most."""
        if not len(other.closed):
            return None
        q, weights = tree.closed["center"][new], tree.closed["weights"][new]
        delta = self._bridge.difference(q, other.closed["center"])
        reach = np.abs(delta)
        u, v = weights * reach, other.closed["weights"] * reach
        shape = BUBBLE_SHAPES[self._shape]
        near = np.flatnonzero(other.closed["alive"] & shape.may_meet(u, v))
        gaps, shares = shape.meetings(u[near], v[near])
        if gaps.min(initial=np.inf) >= INSIDE:
            return None
        best = int(gaps.argmin())
        met = int(near[best])
        return self._path(tree, new, other, met, q + shares[best] * delta[met])

    def _path(
        self, tree: VolumeTree, new: int, other: VolumeTree, met: int, meeting: FloatArray
    ) -> FloatArray | None:
        """PATH: the two branches, from start to goal, joined at a point of both bubbles.

        The problem's own motion validator may know more than bubbles do. What it refuses is cut off.
        """
        if not tree.from_start:
            tree, new, other, met = other, met, tree, new
        there, back = tree.branch(new), other.branch(met)[::-1]
        path = np.vstack([tree.closed["center"][there], meeting, other.closed["center"][back]])
        for k, (start, end) in enumerate(pairwise(self._bridge.wrapped(path))):
            if not self._task.motion_is_free(start, end):
                if k < len(there):
                    tree.cut(there[min(k + 1, len(there) - 1)])
                else:
                    other.cut(back[max(k - len(there) - 1, 0)])
                return None
        return self._bridge.wrapped(path)

    def _bubble_endpoints(self, bubble: Bubble, goal: FloatArray) -> FloatArray:
        """BUBBLE_ENDPOINTS: the vertices (K, n), and guided the point where the way to the goal leaves the bubble."""
        points = bubble.vertices(self._bridge.lower, self._bridge.upper, self._bridge.circular)
        if self._guided:
            points = np.vstack([points, bubble.exit(self._bridge.difference(bubble.q, goal))])
        points = self._bridge.inside(points)
        return points[self._metric.separations(bubble.q, points) > 1e-9]

    # ------------------------------------------------------------------------------------------ the searching

    def _headings(self, other: VolumeTree) -> Iterator[FloatArray]:
        """Yield what a tree heads for in its turn: the configuration that the other tree closed last; guided, a place.

        The places of Halton's sequence lead the trees out of dead ends, as an RRT's random configurations do.
        """
        yield other.latest
        if self._guided:
            self._places += 1
            yield self._bridge.between_bounds(halton_point(self._places, self._bridge.n))

    @property
    def _careless(self) -> bool:
        """Whether this turn, of start and goal tree one after the other, is one of those that ignore danger."""
        turn = self._turns // 2
        return int((turn + 1) * self._nearest_fraction) > int(turn * self._nearest_fraction)

    def _is_narrow(self, bubble: Bubble) -> bool:
        """Whether obstacles are nearer to the centre of a bubble than the margin."""
        margin = self._margin.in_force
        obstacles = self._checker.pairs.meets_obstacle
        return margin > 0 and bool((bubble.distances < margin)[obstacles].any())

    def _bound_open(self, tree: VolumeTree, goal: FloatArray) -> None:
        if self._max_open and len(tree.open) > self._max_open:
            half = max(1, self._max_open // 2)
            tree.open.keep(np.argpartition(self._f(tree, goal), half)[:half])

    def _danger_term(self, points: FloatArray) -> FloatArray:
        """Return the danger (K,) as f takes it: in metres where f is normalised."""
        cost = self._task.cost
        if not self.getAlpha() or cost.is_zero:
            return np.zeros(len(points))
        costs = cost.values(points)
        if not self._normalized:
            return costs
        return self._danger.in_metres(costs, self._checker.robot.bounds.arm_rates)

    # -------------------------------------------------------------------------------------------- the trees

    @property
    def _grown(self) -> VolumeTrees:
        return self._trees

    def _forget(self) -> None:
        rates = self._checker.robot.bounds.arm_rates if self._normalized else np.ones(self._bridge.n)
        self._metric = JointMetric(self._bridge, rates, taxicab=not self._normalized)
        self._trees = VolumeTrees(self._bridge, self._metric, diverse=self._beta > 0)
        self._turns = self._places = 0
        self._patience.reset()
        self._margin.reset()
