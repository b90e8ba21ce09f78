"""SafePRM: lazy bidirectional A* over random milestones that prefers safe ones."""

from __future__ import annotations

from itertools import pairwise, starmap
from math import inf
from typing import Any

import numpy as np

from safe_ompl.common import FloatArray, IntArray
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
    """Two graphs over the same random milestones, grown by A* from start and goal until they meet (SAFE_PRM_PLANNER).

    The milestone that leaves Open next minimises f = g + h + α·CDF: the length of the way to it, the distance to the
    milestone that the other graph added last, and its danger. With α = 0 it is a classical lazy PRM. When the samples
    do not suffice, more are drawn, and the search begins anew on the larger roadmap.

    The roadmap, with all verdicts on milestones and edges, is kept from query to query: `clearQuery` forgets start and
    goal only, `clear` everything. Milestones are drawn uniformly, or by the valid state sampler whose allocator the
    space information was given.

    Parameters
    ----------
    range : float >= 0, default 0.0 [rad]
        What `slide` and penalties are measured in; 0 takes 7.5 % of the space's extent.
    alpha : float >= 0, default 3.0
        Weight of danger α, relative to the median of ‖∇CDF‖ over valid configurations: at 1, as much danger as a
        typical step of 1 rad adds is worth a detour of 1 rad. 0 plans classically.
    neighbors : int >= 1, default 25
        K: how many of the nearest milestones are neighbours.
    samples : int >= 1, default 50
        Number of milestones to begin with.
    slide : float >= 0, <= 1, default 0.8
        Largest sideways motion of the middle of an edge, as a fraction of the range; 0 drives straight edges as in the
        paper. Edges of the path that are longer than twice the range move down the gradient of the danger in their
        middle, where both halves stay free; so do the halves. It acts where α > 0 and the objective offers gradients
        (`DangerObjective` does).
    clearance : float >= 0, default 0.05 [m]
        Margin from all obstacles, dangerous or not. Edges that do not keep it are penalised by four times the range,
        and again if they do not keep 30 % of it. The margin is no more than 80 % of what start and goal keep, falls to
        60 % each time when samples do not suffice, and ends below 20 mm. It acts where α > 0, also where nothing is
        dangerous, and needs a `CertifiedMotionValidator`. 0 for none.

    Notes
    -----
    The planner as it is printed in [1] is `PaperSafePRM`, and with α = 0 `PaperPRM`. What differs here, and why:

    * h and g are lengths, not 1-norms: shorter paths, and one α for arms with more and fewer joints;
    * an edge is checked when its milestone is about to leave Open, not when it enters: the search is the same, step by
      step, but edges to milestones that are never chosen are never checked, so that K may be large, for short paths;
    * a milestone is checked when it first becomes a neighbour, and does not count among the K if invalid: the roadmap
      stays connected in clutter;
    * more samples are drawn where the first do not suffice: what can be solved is solved, whatever N. Most of them lie
      on the way from a milestone of the stuck graph to the uniform random configuration nearest to it, at 5 to 100 % of
      it, log-uniform: the graph grows out of narrow places, as an RRT does. The others are uniform, which makes the
      planner probabilistically complete;
    * the most dangerous three of ten milestones are left out until a search without them has failed: fewer queries and
      a lower peak;
    * the path is contracted like an elastic band where neither the peak of the danger nor its integral rises, and
      its edges descend sideways (`slide`): shorter, and lower danger between milestones;
    * edges near obstacles are penalised (`clearance`): obstacles that are not dangerous are not grazed, either, and no
      way is closed;
    * α is relative to the usual slope of the danger: one default serves all robots.

    The distance h is to one milestone for all of Open, so that the length of the way from there to the other root
    would change nothing. A milestone that was closed is not opened again. Motions are taken to be free both ways or
    neither way. Those of a path are checked in the direction of driving.

    References
    ----------
    .. [1] B. Lacevic, P. Rocco: Safety-oriented path planning for articulated robots. Robotica, 2013, §4.2.
    .. [2] R. Bohlin, L. Kavraki: Path planning using lazy PRM. ICRA 2000.
    .. [3] B. Cohen, M. Phillips, M. Likhachev: Planning single-arm manipulations with n-arm robots (lazy A*).
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

    # The last path along milestones, under which settings it was driven, and how.
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
        """SAFE_PRM_PLANNER on the present samples; None where they do not suffice, or when `ptc` fires."""
        current_goal = self._roadmap.goals[0]
        while (new := self._best_of_open(graph, current_goal, ptc)) is not None:
            # CONNECTED: only q_new can have become common to Closed(1) and Closed(2).
            if other.closed[new]:
                return graph.joined(other, new)  # PATH
            neighbors = self._neighbors(graph, new, ptc)
            graph.add_open(neighbors, new, self._lengths_from(new)[neighbors])
            graph, other = other, graph
            current_goal = new
        return None

    def _best_of_open(self, graph: SearchGraph, current_goal: int, ptc: Any) -> int | None:
        """Move argmin of f from Open(1) to Closed(1): the best whose edge is free and keeps its margin."""
        f = self._f(graph, current_goal)
        tried: list[int] = []
        penalty = _PENALTY * self.getRange()
        best = None
        while best is None and len(tried) < len(f) and not ptc():
            offer = int(f.argmin())
            parent, milestone = int(graph.parents[offer]), int(graph.milestones[offer])
            penalties = int(graph.penalties[offer])
            # After that the edge must only be free, so that no passage is closed.
            keeps = parent != ROOT and penalties < _PENALTIES
            margin = self._margin.in_force * _PENALTY_FALL**penalties if keeps else 0.0
            is_free = parent == ROOT or self._roadmap.is_free(*graph.as_driven(parent, milestone), margin)
            # The edge stays in Open with a penalty.
            if margin and not is_free:
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

    def _f(self, graph: SearchGraph, current_goal: int) -> FloatArray:
        """Return f = g + h + α·CDF, (10) without its diversity term, for the offers in Open(1)."""
        f = graph.g + self._lengths_from(current_goal)[graph.milestones]
        if self._danger.weight:
            f += self._danger.weight * self._roadmap.costs(graph.milestones)
        return f

    def _neighbors(self, graph: SearchGraph, new: int, ptc: Any) -> IntArray:
        """NEIGHBORS: of Samples ∖ Closed(1) the K valid milestones nearest to `new`; edges are checked later."""
        neighbors: list[int] = []
        excluded = graph.closed
        if self._most < inf:
            excluded = excluded | (self._roadmap.costs(np.arange(len(self._roadmap))) > self._most)
            ends = [*self._roadmap.starts, *self._roadmap.goals]
            excluded[ends] = graph.closed[ends]
        for milestone in self._roadmap.nearest(new, excluded).tolist():
            if len(neighbors) == self.neighbors or ptc():
                break
            if self._roadmap.is_valid(milestone):
                neighbors.append(milestone)
        return np.array(neighbors, dtype=np.intp)

    def _usual_danger(self) -> float:
        """Return the danger that most milestones do not exceed; the others are left out at first."""
        if not self._danger.weight:
            return inf
        return float(np.quantile(self._roadmap.costs(np.arange(len(self._roadmap))), _USUAL))

    # ---------------------------------------------------------------------------------------------- samples

    def _random_set(self, count: int, ptc: Any) -> None:
        """RANDOM_SET: add random milestones."""
        if count > 0:
            self._roadmap.add(self._problem.valid_samples(self._rng, count, ptc))

    def _enlarge(self, stuck: SearchGraph, ptc: Any) -> None:
        """Add milestones: some uniform, most of them around the graph that cannot go on."""
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
        """Return configurations (count, n) between a fringe (N, n) and random ones, from the nearest of it on."""
        if len(fringe) > _LARGEST_FRINGE:
            fringe = fringe[self._rng.choice(len(fringe), _LARGEST_FRINGE, replace=False)]
        targets = self._problem.random(self._rng, count)
        deltas = [self._bridge.difference(fringe, target) for target in targets]
        nearest = [int(squares(delta).argmin()) for delta in deltas]
        steps = np.array([delta[k] for delta, k in zip(deltas, nearest, strict=True)])
        fractions = _NEAREST_TO_GRAPH ** self._rng.random((count, 1))
        return self._bridge.wrapped(self._bridge.moved(fringe[nearest], fractions * steps))

    def _driven(self, path: list[int], ptc: Any) -> FloatArray:
        """Return a path (N, n) as it is driven, contracted and bent away from danger; that of the last one is kept."""
        rows = self._roadmap.configurations[path]
        if not self._danger.weight:
            return rows
        key = (*path, self._danger.weight, self.slide, self.getRange(), self._margin.wanted)
        if key != self._last[0]:
            self._last = key, self._growth.settled(rows, self.getRange(), ptc, self._margin.wanted, 1)
        return self._last[1]

    # ------------------------------------------------------------------------------------------- the roadmap

    def _lengths_from(self, milestone: int) -> FloatArray:
        """Return the lengths (N,) of the straight motions between all milestones and one of them."""
        return np.sqrt(squares(self._roadmap.ways_to(milestone)))

    def _forget(self) -> None:
        self._structure = self._roadmap = Roadmap(self._problem)
        self._last = (), np.empty(0)
        self._margin.reset()

    def _restart_roadmap(self, ptc: Any) -> None:
        """Forget all milestones but starts and goals."""
        old = self._roadmap
        self._forget()
        for start in old.starts:
            self._roadmap.add_start(old.configurations[start])
        for goal in old.goals:
            self._roadmap.add_goal(old.configurations[goal])
        self._random_set(self.samples, ptc)
