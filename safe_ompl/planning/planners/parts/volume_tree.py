"""Volume trees: the bubbles that a search has closed, and the end points that wait in its Open list."""

from __future__ import annotations

from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np

from safe_ompl.collision import BUBBLE_SHAPES, INSIDE
from safe_ompl.common import FloatArray, InputError, IntArray
from safe_ompl.planning.ompl import CollisionFreeValidity, StateBridge
from safe_ompl.planning.planners.parts.problem import PlanningProblem
from safe_ompl.planning.planners.parts.tree import ROOT, TwoTrees, branch


class Rows:
    """Columns of numbers and vectors that grow together, row by row; each has a type, and a shape of its entries."""

    def __init__(self, **columns: tuple[type, tuple[int, ...]]) -> None:
        self._columns: dict[str, Any] = {
            name: np.empty((64, *shape), dtype=kind) for name, (kind, shape) in columns.items()
        }
        self._size = 0

    def __len__(self) -> int:
        return self._size

    def __getitem__(self, name: str) -> Any:
        """Return the column `name`, a view."""
        return self._columns[name][: self._size]

    def extend(self, number: int, **values: Any) -> None:
        """Append `number` rows; a value is one for all of them, or one for each."""
        end = self._size + number
        for name, column in self._columns.items():
            if end > len(column):
                self._columns[name] = column = np.resize(column, (2 * end, *column.shape[1:]))
            column[self._size : end] = values[name]
        self._size = end

    def remove(self, row: int) -> None:
        """Remove a row; the last one takes its place."""
        self._size -= 1
        for column in self._columns.values():
            column[row] = column[self._size]

    def keep(self, rows: IntArray) -> None:
        """Remove all rows but these."""
        for column in self._columns.values():
            column[: len(rows)] = column[rows]
        self._size = len(rows)


class JointMetric:
    """The distances in the heuristic f, eq. (10): `rates: (n,)` are the lengths of a unit of each coordinate.

    g and h are measured in the 1-norm if `taxicab`, as in the paper; else in the 2-norm.
    """

    def __init__(self, bridge: StateBridge, rates: FloatArray, *, taxicab: bool) -> None:
        self._bridge, self._rates, self._taxicab = bridge, rates, taxicab

    def lengths(self, start: FloatArray, end: FloatArray) -> FloatArray:
        """Return the lengths (…) of motions between `start` and `end: (…, n)`, for g and h."""
        if not self._taxicab:
            return self.separations(start, end)
        lengths: FloatArray = np.abs(self._bridge.difference(start, end)) @ self._rates
        return lengths

    def separations(self, start: FloatArray, end: FloatArray) -> FloatArray:
        """Return the distances (…) between `start` and `end: (…, n)` in the 2-norm, for the diversity."""
        steps = self._bridge.difference(start, end) * self._rates
        separations: FloatArray = np.sqrt(np.einsum("...i,...i->...", steps, steps))
        return separations


class EndPoint(NamedTuple):
    """An entry of an Open list: `parent` is the closed bubble that it is in, `path_length` is g, from the root.

    `diversity` is its distance from the nearest closed configuration, `penalty` is added as it is near to obstacles.
    """

    q: FloatArray
    parent: int
    path_length: float
    cost: float
    diversity: float
    penalty: float


class VolumeTree:
    """The lists Closed (bubbles) and Open (end points) of one search direction.

    If `diverse`, every end point knows how far it is from the nearest closed configuration.
    """

    def __init__(self, bridge: StateBridge, metric: JointMetric, *, from_start: bool, diverse: bool) -> None:
        self.from_start, self._metric, self._diverse = from_start, metric, diverse
        vector, number = (float, (bridge.n,)), (float, ())
        self.closed = Rows(center=vector, weights=vector, parent=(np.intp, ()), path_length=number, alive=(bool, ()))
        self.open = Rows(
            q=vector, parent=(np.intp, ()), path_length=number, cost=number, diversity=number, penalty=number
        )

    def __len__(self) -> int:
        return len(self.closed) + len(self.open)

    def add_root(self, q: FloatArray) -> None:
        """Open a start or goal configuration (n,)."""
        self.open.extend(1, q=q, parent=ROOT, path_length=0.0, cost=0.0, diversity=0.0, penalty=0.0)

    @property
    def latest(self) -> FloatArray:
        """The configuration (n,) closed last, or the first root."""
        latest: FloatArray = self.closed["center"][-1] if len(self.closed) else self.open["q"][0]
        return latest.copy()

    def take(self, row: int) -> EndPoint:
        """Remove an end point from Open and return it."""
        rows = self.open
        numbers = (float(rows[name][row]) for name in ("path_length", "cost", "diversity", "penalty"))
        point = EndPoint(rows["q"][row].copy(), int(rows["parent"][row]), *numbers)
        rows.remove(row)
        return point

    def put_back(self, point: EndPoint, penalty: float) -> None:
        """Return an end point to Open, with a penalty that is added to its cost-to-go."""
        self.open.extend(1, **point._replace(penalty=penalty)._asdict())

    def close(self, point: EndPoint, weights: FloatArray) -> int:
        """Add the bubble of an end point to Closed and return its index."""
        self.closed.extend(
            1, center=point.q, weights=weights, parent=point.parent, path_length=point.path_length, alive=True
        )
        if self._diverse and len(self.open):
            diversity = self.open["diversity"]
            np.minimum(diversity, self._metric.separations(self.open["q"], point.q), out=diversity)
        return len(self.closed) - 1

    def add(self, points: FloatArray, parent: int, costs: FloatArray) -> None:
        """Add end points (K, n) of a closed bubble, with their costs (K,), to Open."""
        center, length = self.closed["center"][parent], self.closed["path_length"][parent]
        self.open.extend(
            len(points),
            q=points,
            parent=parent,
            path_length=length + self._metric.lengths(center, points),
            cost=costs,
            diversity=self._diversity(points) if self._diverse else 0.0,
            penalty=0.0,
        )

    def branch(self, node: int) -> list[int]:
        """Return the closed bubbles from the root to `node`."""
        return branch(self.closed["parent"], node)

    def nodes(self) -> tuple[FloatArray, IntArray]:
        """Return the closed configurations (N, n) and roots not yet closed, with the index of each one's parent."""
        roots = self.open["q"][self.open["parent"] == ROOT]
        parents = np.concatenate([self.closed["parent"], np.full(len(roots), ROOT)])
        return np.vstack([self.closed["center"], roots]), parents

    def cut(self, node: int) -> None:
        """Take a bubble out of the search, and all that has grown from it."""
        alive, parents = self.closed["alive"], self.closed["parent"]
        alive[node] = False
        for later in range(node + 1, len(self.closed)):
            alive[later] &= parents[later] == ROOT or bool(alive[parents[later]])
        owners = self.open["parent"]
        self.open.keep(np.flatnonzero((owners == ROOT) | alive[owners]))

    def _diversity(self, points: FloatArray) -> FloatArray:
        """Return min_z ‖x − z‖ over the closed configurations z for each point x, (K,)."""
        return np.array([self._metric.separations(self.closed["center"], x).min() for x in points])


def volume_trees(bridge: StateBridge, metric: JointMetric, *, diverse: bool) -> TwoTrees[VolumeTree]:
    """Return the volume trees of both directions, still empty."""
    return TwoTrees(*(VolumeTree(bridge, metric, from_start=side, diverse=diverse) for side in (True, False)))


def intersect(problem: PlanningProblem, shape: str, tree: VolumeTree, new: int, other: VolumeTree) -> FloatArray | None:
    """INTERSECT: return the path (N, n) through a new bubble and the one of the other tree that it overlaps most.

    The motion validator may know more than bubbles do: what it refuses is cut off the trees.
    """
    if not len(other.closed):
        return None
    q, weights = tree.closed["center"][new], tree.closed["weights"][new]
    delta = problem.bridge.difference(q, other.closed["center"])
    reach = np.abs(delta)
    u, v = weights * reach, other.closed["weights"] * reach
    form = BUBBLE_SHAPES[shape]
    near = np.flatnonzero(other.closed["alive"] & form.may_meet(u, v))
    gaps, shares = form.meetings(u[near], v[near])
    if gaps.min(initial=np.inf) >= INSIDE:
        return None
    best = int(gaps.argmin())
    met = int(near[best])
    meeting = q + shares[best] * delta[met]
    if tree.from_start:
        return _path(problem, tree, new, meeting, other, met)
    return _path(problem, other, met, meeting, tree, new)


def _path(
    problem: PlanningProblem, first: VolumeTree, there: int, meeting: FloatArray, second: VolumeTree, back: int
) -> FloatArray | None:
    """PATH: the two branches, from start to goal, joined at a point of both bubbles; None if a motion is refused."""
    out, home = first.branch(there), second.branch(back)[::-1]
    path = np.vstack([first.closed["center"][out], meeting, second.closed["center"][home]])
    for k, (start, end) in enumerate(pairwise(problem.bridge.wrapped(path))):
        if not problem.motion_is_free(start, end):
            if k < len(out):
                first.cut(out[min(k + 1, len(out) - 1)])
            else:
                second.cut(home[max(k - len(out) - 1, 0)])
            return None
    return problem.bridge.wrapped(path)


def bubble_validity(si: Any, name: str) -> CollisionFreeValidity:
    """Return the state validity checker, which gives the distances of bubbles; raise InputError if it does not."""
    validity = si.getStateValidityChecker()
    if not isinstance(validity, CollisionFreeValidity):
        raise InputError(
            f"{name} needs a CollisionFreeValidity as state validity checker, for the distances that bubbles "
            f"come from; got {type(validity).__name__}"
        )
    return validity
