"""SafePRM: lazy bidirectional A* over random milestones that prefers safe ones."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np

from safe_ompl.arrays import FloatArray, IntArray
from safe_ompl.inputs import flag, whole_number
from safe_ompl.planners.graphs.roadmap import Roadmap
from safe_ompl.planners.graphs.roadmap_metric import LinkMetric, RoadmapMetric, SpaceMetric
from safe_ompl.planners.graphs.search_graph import Graph
from safe_ompl.planners.parts.elastic_band import ElasticBand
from safe_ompl.planners.parts.local_planner import LocalPlanner
from safe_ompl.planners.parts.margin import TollMargin
from safe_ompl.planners.parts.samples import Samples
from safe_ompl.planners.parts.tree import ROOT
from safe_ompl.planners.weighing import WeighingPlanner
from safe_ompl.plugins.validity import CollisionFreeValidity

_TOLL = 4  # ranges; what an edge seems longer by that does not keep the margin
_LARGEST_ROADMAP = 50_000  # milestones; then a new one is begun, so that memory stays bounded


class SafePRM(WeighingPlanner):
    """Two graphs over the same random milestones, grown by A* from start and goal until they meet (SAFE_PRM_PLANNER).

    The milestone that leaves Open next minimises f = g + h + α·CDF: the length of the way to it, the distance to the
    milestone that the other graph added last, and its danger. With α = 0 it is a classical lazy PRM. When the samples
    do not suffice, more are drawn, and the search begins anew on the larger roadmap.

    The roadmap, with all verdicts on milestones and edges, is kept from query to query: `clearQuery` forgets start and
    goal only, `clear` everything.

    Parameters
    ----------
    si : ob.SpaceInformation
        Any space of real vectors and SO(2) parts. If its validity checker is a `CollisionFreeValidity`, neighbours
        are chosen by the ends of the robot's links, eq. (11), else by the space's own distance.
    name : str
        Name in logs and benchmarks.
    alpha : float
        Weight of danger, relative to the median of ‖∇CDF‖ over valid configurations: at 1, as much danger as a
        typical step of 1 rad adds is worth a detour of 1 rad. One default serves all robots.
    neighbors : int
        K, how many of the nearest milestones are neighbours.
    samples : int
        Number of milestones to begin with.
    slide : float
        Largest sideways slide of the middle of an edge, as a fraction of the range (`setRange`), in [0, 1]; 0 drives
        straight edges as in the paper. Edges of the path that are longer than twice the range slide down the gradient
        of the danger in their middle, where both halves stay free; so do the halves. It acts where α > 0 and the
        objective offers gradients (`DangerObjective` does).
    patience : float
        After so many searches, each with more samples, danger counts half, after three times as many next to nothing.
        0: it never yields. Here it need not: where milestones are dense danger leads out of narrow places.
    clearance : float
        Edges that do not keep this margin [m] from obstacles, dangerous or not, wait as if they were longer by four
        times the range; if they do not keep 30 % of it either, by twice that. The margin is no more than 80 % of what
        start and goal keep, falls to 60 % each time when samples do not suffice, and ends below 20 mm. It is in force
        where danger and `lazy` are, and needs a `CertifiedMotionValidator`. 0 for none.
    raw_alpha : bool
        Take α as it is, in length per danger, instead of relative.
    taxicab : bool
        Measure g and h in the 1-norm, as the paper does, instead of by length.
    lazy : bool
        Check an edge when its milestone is about to leave Open. False checks it when it enters, as in the paper.
    growing : bool
        Draw more samples where the first do not suffice. False gives up, as the paper does, with the status TIMEOUT.

    Notes
    -----
    The planner as it is printed in [1] is called `PaperSafePRM`, and with α = 0 `PaperPRM`: N `samples` once, K
    `neighbors`, α as it is. Where the print leaves something open it is read so: the roots wait in Open and are
    closed once; g is measured in the norm of h, which would not underestimate it in another; a milestone
    that is offered twice takes the better offer; two graphs that met are connected even where an Open list
    has become empty. What is ours, and what it buys:

    * h and g are lengths (`taxicab`): shorter paths, and one α for arms with more and fewer joints;
    * edges and milestones are checked later (`lazy`): a fraction of the checks, so that K may be large;
    * invalid milestones do not count among the K (`lazy`): the roadmap stays connected in clutter;
    * more samples are drawn (`growing`): what can be solved is solved, whatever N;
    * edges of the path slide (`slide`): lower danger between milestones;
    * edges without room wait (`clearance`): what is not dangerous is not grazed, either, and no way is closed;
    * α is relative (`raw_alpha`): one default for all robots.

    Laziness goes further than in the paper: an edge is checked when its milestone is about to leave Open, not when it
    enters. The search is the same, step by step, since Open yields the best milestone *with a free edge*; but edges
    to milestones that are never wanted are never checked. So K costs little, and a large one makes for short paths.
    A milestone is checked when it first becomes somebody's neighbour, and does not count among the K if invalid.

    The distance h is to one milestone for all of Open, so that the length of the way from there to the other root
    would change nothing. A milestone that was closed is not opened again.

    Most of the samples added later lie on the way from a milestone of the stuck graph to the uniform random
    configuration nearest to it: at 5 to 100 % of the way, log-uniform. So the graph grows out of narrow places, as an
    RRT does. The others are uniform, which makes the planner probabilistically complete.

    Motions are taken to be free both ways or neither way. Those of a path are checked in the direction of driving.

    References
    ----------
    .. [1] B. Lacevic, P. Rocco: Safety-oriented path planning for articulated robots. Robotica, 2013, §4.2.
    .. [2] R. Bohlin, L. Kavraki: Path planning using lazy PRM. ICRA 2000.
    .. [3] B. Cohen, M. Phillips, M. Likhachev: Planning single-arm manipulations with n-arm robots (lazy A*).
       RSS 2014.
    """

    def __init__(
        self,
        si: Any,
        name: str = "SafePRM",
        *,
        alpha: float = 5.0,
        neighbors: int = 25,
        samples: int = 50,
        slide: float = 0.8,
        patience: float = 0,
        clearance: float = 0.05,
        raw_alpha: bool = False,
        taxicab: bool = False,
        lazy: bool = True,
        growing: bool = True,
    ) -> None:
        super().__init__(si, name)
        self._band = ElasticBand(self._task, self._danger, self._slide)
        self._margin: TollMargin = TollMargin(self._task, self._danger)
        self._sampler = Samples(self._bridge)
        self.setAlpha(alpha)
        self.setNeighbors(neighbors)
        self.setSamples(samples)
        self.setSlide(slide)
        self.setPatience(patience)
        self.setClearance(clearance)
        self.setRawAlpha(raw_alpha)
        self.setTaxicab(taxicab)
        self.setLazy(lazy)
        self.setGrowing(growing)
        self._forget()

    def setNeighbors(self, k: int) -> None:
        """Set the number K of milestones that count as neighbours."""
        self._neighbor_count = whole_number("neighbors", k, at_least=1)

    def getNeighbors(self) -> int:
        """Return the number K of milestones that count as neighbours."""
        return self._neighbor_count

    def setSamples(self, count: int) -> None:
        """Set the number of milestones to begin with."""
        self._samples = whole_number("samples", count, at_least=1)

    def getSamples(self) -> int:
        """Return the number of milestones to begin with."""
        return self._samples

    def setRawAlpha(self, raw: bool) -> None:
        """Set whether α is taken as it is, in length per danger."""
        self._danger.is_raw = flag("raw_alpha", raw)

    def getRawAlpha(self) -> bool:
        """Return whether α is taken as it is."""
        return self._danger.is_raw

    def setTaxicab(self, taxicab: bool) -> None:
        """Set whether g and h are measured in the 1-norm."""
        self._taxicab = flag("taxicab", taxicab)

    def getTaxicab(self) -> bool:
        """Return whether g and h are measured in the 1-norm."""
        return self._taxicab

    def setLazy(self, lazy: bool) -> None:
        """Set whether edges are checked when they are about to leave Open."""
        self._lazy = flag("lazy", lazy)

    def getLazy(self) -> bool:
        """Return whether edges are checked when they are about to leave Open."""
        return self._lazy

    def setGrowing(self, growing: bool) -> None:
        """Set whether more samples are drawn where the first do not suffice."""
        self._growing = flag("growing", growing)

    def getGrowing(self) -> bool:
        """Return whether more samples are drawn where the first do not suffice."""
        return self._growing

    def clearQuery(self) -> None:
        """Forget start and goal, but keep the roadmap and all that is known of it."""
        self.getPlannerInputStates().restart()
        self._roadmap.forget_ends()
        self._margin.reset()

    # ------------------------------------------------------------------------------- the paper's pseudocode

    def _search(self, ptc: Any) -> FloatArray | None:
        roots = len(self._roadmap.starts) + len(self._roadmap.goals)
        self._random_set(self._samples + roots - len(self._roadmap))
        while not ptc():
            self._take_goals(ptc)
            self._patience.fade()
            ends = self._roadmap.starts, self._roadmap.goals
            self._margin.begin_between([self._roadmap.configurations[of] for of in ends])
            graph = Graph(len(self._roadmap), self._roadmap.starts, from_start=True)
            other = Graph(len(self._roadmap), self._roadmap.goals, from_start=False)
            path = self._safe_prm_planner(graph, other, ptc)
            if path is not None and self._local.can_be_driven(path):
                self._patience.reset()
                return self._driven(path, ptc)
            if path is None and not self._growing:
                break
            if path is None and not ptc():
                self._margin.yield_some()
                self._enlarge(min(graph, other, key=lambda g: len(g.milestones)))
        return None

    def _safe_prm_planner(self, graph: Graph, other: Graph, ptc: Any) -> list[int] | None:
        """SAFE_PRM_PLANNER on the present samples; None where they do not suffice, or when `ptc` fires."""
        current_goal = self._roadmap.goals[0]
        while (new := self._best_of_open(graph, current_goal, ptc)) is not None:
            # CONNECTED: only q_new can have become common to Closed(1) and Closed(2).
            if other.closed[new]:
                return self._path(graph, other, new)
            neighbors = self._neighbors(graph, new, ptc)
            graph.add_open(neighbors, new, self._lengths_from(new)[neighbors])
            if not (self._lazy or len(graph.g)):
                return None  # EMPTY(Open(1)); what waits unchecked in lazy lists may still be reached
            graph, other = other, graph
            current_goal = new
        return None

    def _best_of_open(self, graph: Graph, current_goal: int, ptc: Any) -> int | None:
        """Move argmin of f from Open(1) to Closed(1): the best that has a free edge, with room, to its parent."""
        f = self._f(graph, current_goal)
        tried: list[int] = []
        toll = _TOLL * self.getRange()
        best = None
        while best is None and len(tried) < len(f) and not ptc():
            offer = int(f.argmin())
            parent, milestone = int(graph.parents[offer]), int(graph.milestones[offer])
            is_settled = parent == ROOT or not self._lazy
            margin = 0.0 if is_settled else self._margin.after(int(graph.tolls[offer]))
            is_free = is_settled or self._edge_is_free(graph, parent, milestone, margin)
            if margin and not is_free:  # it waits, as if it were longer
                graph.charge(offer, toll)
                f[offer] += toll
                continue
            f[offer] = np.inf
            tried.append(offer)
            if is_free:
                best = graph.add_closed(offer)
                self._count(best)
        graph.remove_open(tried)
        return best

    def _f(self, graph: Graph, current_goal: int) -> FloatArray:
        """Return f = g + h + α·CDF, without diversity term (10), for the offers in Open(1)."""
        f = graph.g + self._lengths_from(current_goal)[graph.milestones]
        if self._danger.weight:
            f += self._danger.weight * self._roadmap.costs(graph.milestones)
        return f

    def _neighbors(self, graph: Graph, new: int, ptc: Any) -> IntArray:
        """NEIGHBORS: of Samples ∖ Closed(1) the K valid milestones nearest to `new`; those that are connected to it."""
        if not self._lazy:
            candidates = self._roadmap.nearest(new, graph.closed)[: self._neighbor_count]
            connected = [not ptc() and self._is_connected(graph, new, int(other)) for other in candidates]
            return np.array(candidates[np.array(connected, dtype=bool)], dtype=np.intp)
        neighbors: list[int] = []
        for milestone in self._roadmap.nearest(new, graph.closed).tolist():
            if len(neighbors) == self._neighbor_count or ptc():
                break
            if self._local.is_valid(milestone):
                neighbors.append(milestone)
        return np.array(neighbors, dtype=np.intp)

    def _path(self, graph: Graph, other: Graph, met: int) -> list[int]:
        """PATH: the two branches, from start to goal; the milestone where they meet counts once."""
        if not graph.from_start:
            graph, other = other, graph
        return graph.branch(met) + other.branch(met)[-2::-1]

    # ---------------------------------------------------------------------------------------------- samples

    def _random_set(self, count: int) -> None:
        """RANDOM_SET: add uniform random milestones."""
        if count > 0:
            self._roadmap.add(self._sampler.uniform(count, self._rng))

    def _enlarge(self, stuck: Graph) -> None:
        """Add milestones: some uniform, most of them around the graph that cannot go on."""
        if len(self._roadmap) > _LARGEST_ROADMAP:
            self._begin_anew()
            return
        roadmap = self._roadmap
        roadmap.add(self._sampler.more(len(roadmap), roadmap.configurations[stuck.closed], self._rng))

    # ---------------------------------------------------------------------------------------------- edges

    def _is_connected(self, graph: Graph, parent: int, milestone: int) -> bool:
        """Whether the local planner connects a milestone to its parent, in the direction of driving."""
        return self._local.check(*graph.as_driven(parent, milestone))

    def _edge_is_free(self, graph: Graph, parent: int, milestone: int, margin: float) -> bool:
        """Whether an edge of a graph is free and keeps a margin [m], in the direction in which it would be driven."""
        return self._local.is_free(*graph.as_driven(parent, milestone), margin)

    # --------------------------------------------------------------------------------- the path as it is driven

    def _driven(self, path: list[int], ptc: Any) -> FloatArray:
        """Return the configurations (N, n) of a path, with the way points that keep its long edges from danger."""
        configurations = self._roadmap.configurations
        rows = [configurations[path[0]]]
        for start, end in pairwise(path):
            rows += [*self._detour(start, end, ptc), configurations[end]]
        return np.array(rows)

    def _detour(self, start: int, end: int, ptc: Any) -> list[FloatArray]:
        """Return the way points of an edge, found once."""
        if not self._slide.acts:
            return []
        margin, _ = self._roadmap.margins_of(start, end)
        detours, key = self._roadmap.detours, (start, end, self.getSlide(), self.getRange(), margin)
        if key not in detours:
            configurations = self._roadmap.configurations
            ends = configurations[start], configurations[end]
            detours[key] = self._band.bent(*ends, self.getRange(), ptc, margin)
        return detours[key]

    # ------------------------------------------------------------------------------------------- the roadmap

    def _lengths_from(self, milestone: int) -> FloatArray:
        """Return the lengths (N,) of the straight motions between all milestones and one of them, as f measures."""
        return self._roadmap.lengths(self._roadmap.configurations[milestone], taxicab=self._taxicab)

    def _count(self, milestone: int) -> None:
        self.counts.nodes += not self._roadmap.connected[milestone]
        self._roadmap.connected[milestone] = True

    def _metric(self) -> RoadmapMetric:
        validity = self.getSpaceInformation().getStateValidityChecker()
        if isinstance(validity, CollisionFreeValidity):
            return LinkMetric(validity.checker.robot)
        return SpaceMetric(self._bridge)

    @property
    def _grown(self) -> Roadmap:
        return self._roadmap

    def _forget(self) -> None:
        self._roadmap = Roadmap(self._bridge, self._task.cost, self._metric())
        self._local = LocalPlanner(self._task, self._roadmap)
        self._patience.reset()
        self._margin.reset()

    def _begin_anew(self) -> None:
        """Forget all milestones but starts and goals."""
        old = self._roadmap
        self._forget()
        for start in old.starts:
            self._roadmap.add_start(old.configurations[start])
        for goal in old.goals:
            self._roadmap.add_goal(old.configurations[goal])
        self._random_set(self._samples)
