"""SAFE_PRM_PLANNER as printed, and with α = 0 its classical counterpart."""

from __future__ import annotations

from typing import Any

import numpy as np

from safe_ompl.common import FloatArray, IntArray
from safe_ompl.planning.planners.base import SafePlanner
from safe_ompl.planning.planners.graphs.roadmap import Roadmap, roadmap_metric
from safe_ompl.planning.planners.graphs.roadmap_search import (
    LocalPlanner,
    Samples,
    SearchGraph,
    joined_branches,
)
from safe_ompl.planning.planners.parameters import Parameter


class PaperSafePRM(SafePlanner):
    """SAFE_PRM_PLANNER as it is printed in [1], §4.2; with α = 0 `PaperPRM`.

    N samples are drawn once; where they do not suffice, the planner gives up with the status TIMEOUT. Where the print
    leaves something open it is read so: the roots wait in Open and are closed once; g is measured in the 1-norm, as h
    is, which would not underestimate it in another; a milestone that is offered twice takes the better offer; two
    graphs that met are connected even where an Open list has become empty.

    References
    ----------
    .. [1] B. Lacevic, P. Rocco: Safety-oriented path planning for articulated robots. Robotica, 2013.
    """

    alpha = Parameter(5.0, "Weight of danger α, as length per danger.")
    neighbors = Parameter(25, "K: how many of the nearest milestones are neighbours.", at_least=1)
    samples = Parameter(50, "N: number of milestones.", at_least=1)

    def clearQuery(self) -> None:
        """Forget start and goal, but keep the samples."""
        self.getPlannerInputStates().restart()
        self._roadmap.forget_ends()

    def _search(self, ptc: Any) -> FloatArray | None:
        """SAFE_PRM_PLANNER."""
        roadmap = self._roadmap
        missing = self.samples + len(roadmap.starts) + len(roadmap.goals) - len(roadmap)
        if missing > 0:
            roadmap.add(Samples(self._bridge).uniform(missing, self._rng))  # RANDOM_SET
        self._take_goals(ptc)
        graph = SearchGraph(len(roadmap), roadmap.starts, from_start=True)
        other = SearchGraph(len(roadmap), roadmap.goals, from_start=False)
        current_goal = roadmap.goals[0]
        while len(graph.g) and not ptc():
            best = int(self._f(graph, current_goal).argmin())
            new = graph.add_closed(best)
            graph.remove_open([best])
            self.counts.nodes += not roadmap.connected[new]
            roadmap.connected[new] = True
            if other.closed[new]:  # CONNECTED
                return roadmap.configurations[joined_branches(graph, other, new)]  # PATH
            neighbors = self._neighbors(graph, new, ptc)
            graph.add_open(neighbors, new, self._lengths_from(new)[neighbors])
            if not len(graph.g):
                break  # EMPTY(Open(1))
            graph, other = other, graph
            current_goal = new
        return None

    def _f(self, graph: SearchGraph, current_goal: int) -> FloatArray:
        """Return f = g + h + α·CDF for the offers in Open(1)."""
        f = graph.g + self._lengths_from(current_goal)[graph.milestones]
        return f + self.alpha * self._roadmap.costs(graph.milestones) if self.alpha else f

    def _neighbors(self, graph: SearchGraph, new: int, ptc: Any) -> IntArray:
        """NEIGHBORS: of Samples ∖ Closed(1) those of the K nearest to `new` that a free edge connects to it."""
        local = LocalPlanner(self._problem, self._roadmap)
        nearest: IntArray = self._roadmap.nearest(new, graph.closed)[: self.neighbors]
        connected = [not ptc() and local.check(*graph.as_driven(new, other)) for other in nearest.tolist()]
        free: IntArray = nearest[np.array(connected, dtype=bool)]
        return free

    def _lengths_from(self, milestone: int) -> FloatArray:
        """Return the distances (N,) in the 1-norm between all milestones and one of them."""
        return self._roadmap.lengths(self._roadmap.configurations[milestone], taxicab=True)

    @property
    def _structure(self) -> Roadmap:
        return self._roadmap

    def _forget(self) -> None:
        metric = roadmap_metric(self.getSpaceInformation(), self._bridge)
        self._roadmap = Roadmap(self._bridge, self._problem.cost, metric)
