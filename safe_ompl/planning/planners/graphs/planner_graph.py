"""The graph that a planner has built: for OMPL's `PlannerData`, and as GraphML with the danger of every vertex."""

from __future__ import annotations

import logging
from dataclasses import dataclass
from typing import Any
from xml.etree import ElementTree as Xml

import numpy as np
from ompl import base as ob

from safe_ompl.common import FloatArray, IntArray, warn_once
from safe_ompl.planning.ompl import StateBridge

_log = logging.getLogger(__name__)

_COLUMNS = (
    ("coords", "node", "string"),
    ("danger", "node", "double"),
    ("start", "node", "boolean"),
    ("goal", "node", "boolean"),
    ("weight", "edge", "double"),
)


@dataclass(frozen=True)
class PlannerGraph:
    """The vertices and edges that a planner holds.

    Attributes
    ----------
    configurations : ndarray, shape (N, n)
        The vertices [rad or m].
    costs : ndarray, shape (N,)
        The danger at each of them; zero without objective.
    edges : ndarray of int, shape (E, 2)
        Motions that are free, each from one vertex to another in the direction in which it is driven.
    lengths : ndarray, shape (E,)
        Their lengths [rad or m].
    starts, goals : ndarray of int
        The vertices that are starts, and goals.
    """

    configurations: FloatArray
    costs: FloatArray
    edges: IntArray
    lengths: FloatArray
    starts: IntArray
    goals: IntArray

    def fill(self, data: Any, bridge: StateBridge) -> None:
        """Append the graph to an `ob.PlannerData`, which gets copies of the states; vertices keep their order."""
        starts, goals = set(self.starts.tolist()), set(self.goals.tolist())
        states: list[Any] = []
        numbers = []
        for k, q in enumerate(self.configurations):
            vertex = ob.PlannerDataVertex(_new_state(data, bridge, states))
            bridge.write(q, states[-1])
            add = data.addStartVertex if k in starts else data.addGoalVertex if k in goals else data.addVertex
            numbers.append(add(vertex))
        for start, end in self.edges.tolist():
            data.addEdge(numbers[start], numbers[end])
        data.decoupleFromPlanner()  # it holds pointers to our states until then

    def graphml(self) -> str:
        """Return the graph as GraphML: coordinates, danger and marks of vertices, lengths of edges."""
        root = Xml.Element("graphml", xmlns="http://graphml.graphdrawing.org/xmlns")
        for name, kind, type_ in _COLUMNS:
            attributes = {"attr.name": name, "attr.type": type_}
            Xml.SubElement(root, "key", {"id": name, "for": kind, **attributes})
        graph = Xml.SubElement(root, "graph", id="G", edgedefault="directed")
        starts, goals = set(self.starts.tolist()), set(self.goals.tolist())
        for k, (q, cost) in enumerate(zip(self.configurations.tolist(), self.costs.tolist(), strict=True)):
            node = Xml.SubElement(graph, "node", id=f"n{k}")
            marks = (str(k in marked).lower() for marked in (starts, goals))
            for (name, _, _), text in zip(_COLUMNS, (",".join(map(str, q)), str(cost), *marks), strict=False):
                Xml.SubElement(node, "data", key=name).text = text
        for k, ((start, end), length) in enumerate(
            zip(self.edges.tolist(), self.lengths.tolist(), strict=True)
        ):
            edge = Xml.SubElement(graph, "edge", id=f"e{k}", source=f"n{start}", target=f"n{end}")
            Xml.SubElement(edge, "data", key="weight").text = str(length)
        Xml.indent(root)
        return Xml.tostring(root, encoding="unicode", xml_declaration=True)


def _new_state(data: Any, bridge: StateBridge, states: list[Any]) -> Any:
    """Append to `states`, and return, a state that `data` does not take for one it knows.

    It knows states by their addresses, and does not forget those that were freed when it was cleared.
    """
    while True:
        states.append(bridge.space.allocState())
        if not data.vertexExists(ob.PlannerDataVertex(states[-1])):
            return states[-1]


def two_trees(
    from_start: tuple[FloatArray, IntArray], from_goal: tuple[FloatArray, IntArray]
) -> tuple[FloatArray, IntArray, IntArray, IntArray]:
    """Return vertices, edges in the direction of driving, starts and goals of two trees.

    Parameters
    ----------
    from_start, from_goal : tuple of ndarray, shapes (N, n) and (N,)
        Configurations of each tree, and the index of each one's parent, negative for roots. A configuration of both,
        where they have met, is one vertex.
    """
    (there, parents), (back, followers) = from_start, from_goal
    known = {q.tobytes(): k for k, q in enumerate(there)}
    numbers = np.empty(len(back), dtype=np.intp)
    new: list[int] = []
    for k, q in enumerate(back):
        numbers[k] = known.get(q.tobytes(), len(there) + len(new))
        if numbers[k] >= len(there):
            new.append(k)
    forward, backward = np.flatnonzero(parents >= 0), np.flatnonzero(followers >= 0)
    edges = np.concatenate(
        [
            np.stack([parents[forward], forward], axis=1),
            np.stack([numbers[backward], numbers[followers[backward]]], axis=1),
        ]
    )
    starts, goals = np.flatnonzero(parents < 0), np.unique(numbers[followers < 0])
    return np.concatenate([there, back[new]]), edges, starts, goals


class UnansweredRequest:
    """`getPlannerData` of a planner in Python: OMPL's own version, which gives nothing, and a warning that says so.

    A method in Python would end the process when OMPL calls it. OMPL first looks whether there is one, and finds its
    own here: it goes on as if nothing was overridden, and the user is warned.
    """

    def __get__(self, planner: Any, owner: type | None = None) -> Any:
        if planner is None:
            return ob.Planner.getPlannerData
        warn_once(
            _log,
            f"{planner.getName()}: getPlannerData stays empty, as OMPL's bindings have no version of it in Python: "
            "safe_ompl.planner_data(planner) and SafeSetup fill it",
        )
        return ob.Planner.getPlannerData.__get__(planner)
