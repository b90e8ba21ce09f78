"""SafePRM: lazy bidirectional A* over random milestones that prefers safe milestones."""

from __future__ import annotations

from itertools import pairwise, starmap
from math import ceil, inf
from typing import Any

import numpy as np

from safe_ompl.common import BoolArray, FloatArray, IntArray
from safe_ompl.planning.planners.base import Parameter, SafePlanner
from safe_ompl.planning.planners.growth import ROOT, Growth
from safe_ompl.planning.planners.problem import WORTHWHILE, DangerWeight, Margin
from safe_ompl.planning.planners.roadmap import Roadmap, SearchGraph, squares

# This many ranges are added to the length of an edge that does not keep the margin.
_PENALTY = 4
# After this many penalties an edge is taken whatever margin it keeps.
_PENALTIES = 2
# The share of the margin that remains after each penalty.
_PENALTY_FALL = 0.3
# So many times K milestones are offered before they are checked, because some of them are invalid.
_OFFERED = 1.5
# The share of the milestones, those with the least danger, that is searched first.
_USUAL = 0.7
# A sample set that does not suffice grows by this share of itself.
_GROWTH = 0.25
# It grows by at most this many milestones at a time.
_LARGEST_GROWTH = 500
# This share of the new milestones grows out of the graph that is stuck.
_TOWARDS_SHARE = 0.8
# These milestones begin at this fraction of the way to a random configuration.
_NEAREST_TO_GRAPH = 0.05
# The number of milestones of a stuck graph from which samples are drawn.
_LARGEST_FRINGE = 1000
# At most this many goals are sampled each time the milestones do not suffice.
_GOAL_SAMPLES = 100
# A roadmap with more milestones is replaced by a new one, so that memory stays bounded.
_LARGEST_ROADMAP = 50_000


class SafePRM(SafePlanner):
    """Lazy PRM whose two graphs grow by A* from start and goal over the same milestones (SAFE_PRM_PLANNER).

    The next milestone from Open minimises f = g + h + α·CDF: the length of the path to it, the distance to the
    milestone that the other graph added last, and its danger. With α = 0 it is a classical lazy PRM. If the samples do
    not suffice, more are drawn, and the search begins again on the larger roadmap.

    The roadmap, with all verdicts on milestones and edges, is kept between queries: `clearQuery` clears start and goal
    only, `clear` everything. Milestones are drawn uniformly, or by the space information's valid state sampler if it
    has an allocator.

    Parameters
    ----------
    range : float >= 0, default 0.0 [rad]
        Unit of `slide` and penalties; 0 means 7.5 % of the space's extent.
    alpha : float >= 0, default 3.0
        Weight of danger α, relative to the median of ‖∇CDF‖ over valid configurations. At 1, a typical change of the
        danger over a step of 1 rad weighs as much as a detour of 1 rad. 0 plans classically.
    neighbors : int >= 1, default 25
        K: number of nearest milestones that are neighbours.
    samples : int >= 1, default 50
        Number of milestones at the beginning.
    slide : float >= 0, <= 1, default 0.8
        Largest sideways motion of the middle of an edge, as a fraction of the range; 0 keeps straight edges as in the
        paper. The middle of an edge longer than twice the range is moved down the gradient of the danger if both halves
        stay free; then the same is done for the halves. It acts if α > 0 and the objective has gradients, as
        `DangerObjective` has.
    clearance : float >= 0, default 0.05 [m]
        Margin from all obstacles, dangerous or not. Edges that do not keep it are penalised by four times the range,
        and again if they do not keep 30 % of it. The margin is limited to 80 % of the clearance of start and goal. It
        falls to 60 % each time that samples do not suffice, and is 0 below 20 mm. It acts if α > 0, even if nothing is
        dangerous, and needs a `CertifiedMotionValidator`. 0 for no margin.

    Notes
    -----
    `PaperSafePRM` is the planner as printed in [1], and `PaperPRM` the same with α = 0. The differences of this
    planner, with reasons:

    * h and g are lengths, not 1-norms, for shorter paths, and one α for arms with any number of joints.
    * An edge is checked when its milestone is about to leave Open, not when it enters. The search is the same, but
      edges to milestones that are never chosen are never checked. So K may be large, for short paths.
    * Invalid milestones do not count among the K neighbours, so that the roadmap stays connected in clutter. With
      α = 0, or if nothing is dangerous, a milestone is checked when it first becomes a neighbour. With danger, 1.5 K
      milestones are offered, each is checked when it is about to leave Open, and the next nearest takes the place of an
      invalid one: most are never checked.
    * If the samples do not suffice, more are drawn, so that N does not limit what is solved. Most new samples lie
      between a milestone of the stuck graph and a uniform random configuration to which it is the nearest, at 5 to
      100 % of the distance, log-uniform: the graph grows out of narrow passages, as an RRT does. The others are
      uniform, which makes the planner probabilistically complete.
    * The most dangerous 30 % of the milestones are left out until a search without them has failed, for fewer queries
      and a lower peak of the danger.
    * The path is contracted like an elastic band where neither the peak of the danger nor its integral rises, and its
      edges are moved sideways (`slide`). The path is shorter, and the danger between milestones lower.
    * Edges near obstacles are penalised (`clearance`), so that paths do not graze harmless obstacles either, and no
      passage is closed.
    * α is relative to the typical slope of the danger, so that one default fits all robots.

    The distance h refers to one milestone for all of Open, so adding the length from this milestone to the other root
    would change nothing. A closed milestone is not opened again. The search assumes that a motion is free in both
    directions or in neither. The edges of a path are checked in the direction of motion.

    References
    ----------
    1. B. Lacevic, P. Rocco: Safety-oriented path planning for articulated robots. Robotica, 2013, §4.2.
    2. R. Bohlin, L. Kavraki: Path planning using lazy PRM. ICRA 2000.
    3. B. Cohen, M. Phillips, M. Likhachev: Planning single-arm manipulations with n-arm robots (lazy A*).
       RSS 2014.

    Examples
    --------
    >>> setup = setup_scenario("planar2")
    >>> setup.setPlanner(SafePRM(setup.getSpaceInformation()))
    >>> bool(setup.solve(5.0))
    True
    """

    alpha = Parameter(3.0)
    setAlpha, getAlpha = alpha.methods()
    neighbors = Parameter(25, at_least=1)
    setNeighbors, getNeighbors = neighbors.methods()
    samples = Parameter(50, at_least=1)
    setSamples, getSamples = samples.methods()
    slide = Parameter(0.8, at_most=1)
    setSlide, getSlide = slide.methods()
    clearance = Parameter(0.05)
    setClearance, getClearance = clearance.methods()

    # The milestones and settings of the last path, and the path (N, n) that was returned for them.
    _last: tuple[tuple[float, ...], FloatArray]

    def _make_parts(self) -> None:
        self._danger = DangerWeight(self._problem)
        self._margin = Margin(self._problem, self._danger, WORTHWHILE)
        self._growth = Growth(self._problem, self._danger, self._margin)

    def _apply_parameters(self) -> None:
        self._danger.alpha = self.alpha
        self._growth.slide = self.slide
        self._margin.largest = self.clearance

    def _forget_ends(self) -> None:
        self._roadmap.forget_ends()
        self._margin.reset()

    # ------------------------------------------------------------------------------- the paper's pseudocode

    def _search(self, ptc: Any) -> FloatArray | None:
        roots = len(self._roadmap.starts) + len(self._roadmap.goals)
        self._random_set(self.samples + roots - len(self._roadmap), ptc)
        self._most = self._usual_danger()
        while not ptc():
            self._take_goals(ptc, _GOAL_SAMPLES)
            ends = self._roadmap.starts, self._roadmap.goals
            self._margin.begin_between([self._roadmap.configurations[of] for of in ends])
            graph = SearchGraph(len(self._roadmap), self._roadmap.starts, from_start=True)
            other = SearchGraph(len(self._roadmap), self._roadmap.goals, from_start=False)
            path = self._safe_prm_planner(graph, other, ptc)
            if path is not None and all(starmap(self._roadmap.check, pairwise(path))):
                return self._driven(path, ptc)
            if path is None and not ptc():
                if self._most < inf:
                    self._most = inf
                    continue
                self._margin.lower()
                self._enlarge(min(graph, other, key=lambda g: len(g.milestones)), ptc)
        return None

    def _safe_prm_planner(self, graph: SearchGraph, other: SearchGraph, ptc: Any) -> list[int] | None:
        """SAFE_PRM_PLANNER on the present samples; None if they do not suffice, or if `ptc` ends the search."""
        current_goal = self._roadmap.goals[0]
        self._left_out = self._unusual()
        while (new := self._best_of_open(graph, current_goal, ptc)) is not None:
            # CONNECTED: only q_new can have become common to Closed(1) and Closed(2).
            if other.closed[new]:
                return graph.joined(other, new)  # PATH
            self._offer(graph, new, self._neighbors(graph, new, ptc))
            graph, other = other, graph
            current_goal = new
        return None

    def _best_of_open(self, graph: SearchGraph, current_goal: int, ptc: Any) -> int | None:
        """Move the argmin of f from Open(1) to Closed(1), among milestones whose edge is free and keeps the margin."""
        f = self._f(graph, current_goal)
        tried: list[int] = []
        penalty = _PENALTY * self.getRange()
        wanted, checks_late = self._margin.in_force, bool(self._danger.weight)
        best = None
        while best is None and len(tried) < len(f) and not ptc():
            offer = int(f.argmin())
            parent, milestone = int(graph.parents[offer]), int(graph.milestones[offer])
            if checks_late and not self._roadmap.is_valid(milestone):
                # The next neighbour of the parent takes the place of the invalid one.
                further = graph.next_neighbors(parent, self._roadmap.invalid, 1)
                self._offer(graph, parent, further)
                f[offer] = np.inf
                f = np.concatenate([f, self._f(graph, current_goal, len(further))])
                tried.append(offer)
                continue
            penalties = int(graph.penalties[offer])
            # After the last penalty the edge must only be free, so that no passage is closed.
            keeps = parent != ROOT and penalties < _PENALTIES
            margin = wanted * _PENALTY_FALL**penalties if keeps else 0.0
            is_free = parent == ROOT or self._roadmap.is_free(*graph.as_driven(parent, milestone), margin)
            # The edge stays in Open with a penalty, unless it is known to be blocked.
            if margin and not is_free and not self._roadmap.is_blocked(parent, milestone):
                graph.g[offer] += penalty
                graph.penalties[offer] += 1
                f[offer] += penalty
                continue
            f[offer] = np.inf
            tried.append(offer)
            if is_free:
                best = graph.add_closed(offer)
                self.counts.nodes += not self._roadmap.connected[best]
                self._roadmap.connected[best] = True
        graph.remove_open(tried)
        return best

    def _f(self, graph: SearchGraph, current_goal: int, last: int | None = None) -> FloatArray:
        """Return f = g + h + α·CDF, (10) without its diversity term, for the `last` offers in Open(1), or for all."""
        some = slice(None if last is None else len(graph.g) - last, None)
        milestones = graph.milestones[some]
        f = graph.g[some] + self._lengths(milestones, current_goal)
        if self._danger.weight:
            f += self._danger.weight * self._roadmap.costs(milestones)
        return f

    def _neighbors(self, graph: SearchGraph, new: int, ptc: Any) -> IntArray:
        """NEIGHBORS: of Samples ∖ Closed(1) the K milestones nearest to `new`; edges are checked later.

        The classical form checks the milestones now. With danger, a milestone is checked when it is about to leave
        Open: most milestones never do, and those with little danger are seldom invalid.
        """
        nearest = self._roadmap.nearest(new, graph.closed | self._left_out)
        if self._danger.weight:
            graph.nearest[new] = iter(nearest.tolist())
            return graph.next_neighbors(new, self._roadmap.invalid, ceil(_OFFERED * self.neighbors))
        neighbors: list[int] = []
        for milestone in nearest.tolist():
            if len(neighbors) == self.neighbors or ptc():
                break
            if self._roadmap.is_valid(milestone):
                neighbors.append(milestone)
        return np.array(neighbors, dtype=np.intp)

    def _offer(self, graph: SearchGraph, parent: int, neighbors: IntArray) -> None:
        """ADD (Open): offer the edges from a milestone in Closed to its `neighbors: (K,)`."""
        graph.add_open(neighbors, parent, self._lengths(neighbors, parent))

    def _usual_danger(self) -> float:
        """Return the danger that 70 % of the milestones do not exceed; the others are left out at first."""
        if not self._danger.weight:
            return inf
        costs = self._roadmap.costs(np.arange(len(self._roadmap)))
        last = int(_USUAL * (len(costs) - 1))
        return float(np.partition(costs, last)[last])

    def _unusual(self) -> BoolArray:
        """Return the mask (N,) of the milestones that are left out; starts and goals are not."""
        if self._most == inf:
            return np.zeros(len(self._roadmap), dtype=bool)
        unusual = self._roadmap.costs(np.arange(len(self._roadmap))) > self._most
        unusual[[*self._roadmap.starts, *self._roadmap.goals]] = False
        return unusual

    # ---------------------------------------------------------------------------------------------- samples

    def _random_set(self, count: int, ptc: Any) -> None:
        """RANDOM_SET: add random milestones."""
        if count > 0:
            self._roadmap.add(self._problem.valid_samples(self._rng, count, ptc))

    def _enlarge(self, stuck: SearchGraph, ptc: Any) -> None:
        """Add milestones: some uniform, most of them around the graph that is stuck."""
        roadmap = self._roadmap
        if len(roadmap) > _LARGEST_ROADMAP:
            self._restart_roadmap(ptc)
            return
        fringe = roadmap.configurations[stuck.closed]
        count = min(_LARGEST_GROWTH, 1 + int(_GROWTH * len(roadmap)))
        outwards = round(_TOWARDS_SHARE * count) if len(fringe) else 0
        rows = [self._outwards(fringe, outwards)] if outwards else []
        if count > outwards:
            rows.append(self._problem.valid_samples(self._rng, count - outwards, ptc))
        roadmap.add(np.concatenate(rows))

    def _outwards(self, fringe: FloatArray, count: int) -> FloatArray:
        """Return configurations (count, n) between random ones and the nearest configurations of a fringe (N, n)."""
        if len(fringe) > _LARGEST_FRINGE:
            fringe = fringe[self._rng.choice(len(fringe), _LARGEST_FRINGE, replace=False)]
        targets = self._problem.random(self._rng, count)
        deltas = [self._bridge.difference(fringe, target) for target in targets]
        nearest = [int(squares(delta).argmin()) for delta in deltas]
        steps = np.array([delta[k] for delta, k in zip(deltas, nearest, strict=True)])
        fractions = _NEAREST_TO_GRAPH ** self._rng.random((count, 1))
        return self._bridge.wrapped(self._bridge.moved(fringe[nearest], fractions * steps))

    def _driven(self, path: list[int], ptc: Any) -> FloatArray:
        """Return the path (N, n) along milestones, contracted and moved away from danger; the last result is kept."""
        rows = self._roadmap.configurations[path]
        if not self._danger.weight:
            return rows
        key = (*path, self._danger.weight, self.slide, self.getRange(), self._margin.wanted)
        if key != self._last[0]:
            self._last = key, self._growth.settled(rows, self.getRange(), ptc, self._margin.wanted, 1)
        return self._last[1]

    # ------------------------------------------------------------------------------------------- the roadmap

    def _lengths(self, milestones: IntArray, end: int) -> FloatArray:
        """Return the lengths (M,) of the straight motions from `milestones: (M,)` to one of them."""
        return np.sqrt(squares(self._roadmap.ways_to(end, milestones)))

    def _forget(self) -> None:
        self._structure = self._roadmap = Roadmap(self._problem)
        self._last = (), np.empty(0)
        self._margin.reset()

    def _restart_roadmap(self, ptc: Any) -> None:
        """Clear all milestones except starts and goals, and draw new ones."""
        old = self._roadmap
        self._forget()
        for start in old.starts:
            self._roadmap.add_start(old.configurations[start])
        for goal in old.goals:
            self._roadmap.add_goal(old.configurations[goal])
        self._random_set(self.samples, ptc)
