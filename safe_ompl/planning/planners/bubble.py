"""BubblePlanner: bidirectional search along bubbles of free configuration space, and its volume trees."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise, takewhile
from typing import Any, NamedTuple

import numpy as np

from safe_ompl.collision import INSIDE, Bubble, bubbles
from safe_ompl.common import FloatArray, InputError, IntArray, halton_point
from safe_ompl.planning.ompl import CollisionFreeValidity
from safe_ompl.planning.planners.base import Parameter, SafePlanner
from safe_ompl.planning.planners.growth import ROOT, Growth, branch
from safe_ompl.planning.planners.problem import WORTHWHILE, DangerDecay, DangerWeight, Margin, PlanningProblem
from safe_ompl.planning.planners.tree import TwoTrees
from safe_ompl.robot import StateBridge

# Points nearer to contact than this are not closed, because their bubbles lead nowhere.
_LEAST_CLEARANCE = 1e-3  # [m]
# The weight of g. The search is greedy, as in weighted A*.
_PATH_SHARE = 0.1
# This is added to the cost-to-go of a point whose clearance is below the margin.
_PENALTY = 0.5  # [m]
# The path is contracted in this many rounds, because its detours around danger are long.
_CONTRACTION_ROUNDS = 4
# A turn ends if a step brings the tree less near to its goal than this.
_LEAST_GAIN = 2e-3  # [m]
# A turn also ends if a step gains less than this share of the best step.
_GAIN_SHARE = 0.2


class BubblePlanner(SafePlanner):
    """Two volume trees of bubbles, from start and goal, grown by A* until they intersect (BUBBLE_PLANNER).

    One distance query at a configuration gives a bubble of free configurations around the configuration. The end points
    of the bubble are added to the list Open. The point of Open with the least f = g + h + α·CDF, eq. (10) without the
    diversity, is expanded next. Edges need no check, because they lie within a bubble. The planner is deterministic.

    Parameters
    ----------
    range : float >= 0, default 0.0 [rad]
        Unit of `slide`; 0 takes 7.5 % of the space's extent.
    alpha : float >= 0, default 0.8
        Weight of danger α, relative to the median of ‖∇CDF‖ over valid configurations. With α = 0 the search is the
        classical one.
    nearest_fraction : float >= 0, <= 1, default 1 / 3
        ε: share of the iterations that ignore danger, so that dangerous passages are searched, too.
    danger_decay : float >= 0, default 500.0
        Number of iterations after which danger counts half. After three times as many it hardly counts, so that it
        cannot keep the planner out of a narrow passage. 0 for no decay.
    slide : float >= 0, <= 1, default 0.8
        Largest sideways motion of the middle of an edge, as a fraction of the range; 0 gives straight edges as in the
        paper. If an edge of the path is longer than twice the range, its middle moves down the gradient of the danger,
        unless one of the halves would not be free. The same holds for the halves. Used only if α > 0 and the objective
        has gradients (as `DangerObjective`).
    clearance : float >= 0, default 0.05 [m]
        Margin from all obstacles, dangerous or not. Points nearer than the margin get a penalty of 0.5 m on their
        cost-to-go, and the contracted path keeps the margin. The margin is at most 80 % of the clearance of start and
        goal. For points it falls to 60 % after every twelve penalised points, or every 48 if nothing is dangerous, and
        ends below 20 mm. It is used only if α > 0, in iterations that do not ignore danger, and needs a
        `CertifiedMotionValidator`. 0 for none.

    Notes
    -----
    The bubbles include self-collision pairs, and use the motion bounds at their centres (`docs/how-it-works.md` §3).

    `PaperSafeBubble` is the planner as printed in [1], with α = 0 `PaperBubble`. This planner differs as follows:

    * Each link has a bubble, limited by the distance of the obstacle from the joint's axis. Fewer bubbles are needed.
    * f is in metres: joint motions are weighted by how far they move the arm, the danger by its typical slope and on a
      logarithmic scale. One set of parameters serves all robots and scenes.
    * A bubble also has an end point where the straight motion to the current goal leaves the bubble. A tree grows while
      it comes nearer to that goal, then towards the next point of a Halton sequence. Far fewer bubbles are needed.
    * The path is contracted like an elastic band [3] as long as neither peak nor integral of the danger rises, and
      moves sideways (`slide`). The path is shorter and less dangerous.
    * A share of the iterations ignores danger (`nearest_fraction`), and danger loses weight (`danger_decay`). No
      passage stays closed.
    * Points near obstacles are penalised (`clearance`). The path also keeps away from obstacles that are not dangerous.
    * Points with a clearance below 1 mm are left out, because their bubbles are too small to make progress.

    References
    ----------
    1. B. Lacevic, P. Rocco: Safety-oriented path planning for articulated robots. Robotica, 2013, §4.1.
    2. B. Lacevic, P. Rocco: Sampling-based safe path planning for robotic manipulators. ETFA 2010.
    3. S. Quinlan: Real-time modification of collision-free paths. PhD thesis, Stanford 1994.

    Examples
    --------
    >>> setup = setup_scenario("planar2")
    >>> setup.setPlanner(BubblePlanner(setup.getSpaceInformation()))
    >>> bool(setup.solve(5.0))
    True
    """

    alpha = Parameter(0.8)
    setAlpha, getAlpha = alpha.methods()
    nearest_fraction = Parameter(1 / 3, at_most=1)
    setNearestFraction, getNearestFraction = nearest_fraction.methods()
    danger_decay = Parameter(500.0)
    setDangerDecay, getDangerDecay = danger_decay.methods()
    slide = Parameter(0.8, at_most=1)
    setSlide, getSlide = slide.methods()
    clearance = Parameter(0.05)
    setClearance, getClearance = clearance.methods()

    def _make_parts(self) -> None:
        self._danger = DangerWeight(self._problem)
        self._margin = Margin(self._problem, self._danger, WORTHWHILE)
        self._decay = DangerDecay(self._danger, self._margin)
        self._growth = Growth(self._problem, self._danger, self._margin)

    def _apply_parameters(self) -> None:
        self._danger.alpha = self.alpha
        self._decay.half_life = self.danger_decay
        self._growth.slide = self.slide
        self._margin.largest = self.clearance

    # ------------------------------------------------------------------------------- the paper's pseudocode

    def _search(self, ptc: Any) -> FloatArray | None:
        """BUBBLE_PLANNER."""
        tree, other = self._volumes.start, self._volumes.goal
        while not ptc() and (len(tree.open) or len(other.open)):
            self._take_goals(ptc)
            self._decay.fade()
            if self._margin.is_unknown:
                self._margin.begin_between([tree.nodes()[0] for tree in (self._volumes.start, self._volumes.goal)])
            for current_goal in self._headings(other):
                path = self._expand(tree, other, current_goal, ptc)
                if path is not None:
                    self._decay.reset()
                    rounds = _CONTRACTION_ROUNDS if self.alpha else 1
                    return self._growth.settled(path, self.getRange(), ptc, self._margin.allowed, rounds)
            tree, other = other, tree  # SWAP
            self._turns += 1
        return None

    def _expand(self, tree: VolumeTree, other: VolumeTree, goal: FloatArray, ptc: Any) -> FloatArray | None:
        """Expand the point of Open(1) with the least f, repeatedly, while the tree comes nearer to the goal."""
        left, best = None, 0.0
        while len(tree.open) and not ptc():
            x = tree.take(int(self._f(tree, goal).argmin()))
            bubble = Bubble.around(x.q, self._validity.checker, 0.0 if x.parent == ROOT else _LEAST_CLEARANCE)
            if bubble is None:
                return None
            margin, obstacles = self._margin.in_force, self._validity.checker.pairs.meets_obstacle
            narrow = margin > 0 and (bubble.distances < margin)[obstacles].any()
            if narrow and not x.penalty and x.parent != ROOT:
                tree.open.extend(1, **x._replace(penalty=_PENALTY)._asdict())  # and back
                self._margin.refuse()
                continue
            new = tree.close(x, bubble.weights)
            self.counts.nodes += 1
            path = intersect(self._problem, tree, new, other)
            if path is not None:
                return path
            points = self._bubble_endpoints(bubble, goal)
            # Its clearance is so small that all vertices equal the centre.
            if not len(points):
                return None
            tree.add(points, new, self._danger_term(points))
            before, after = (float(self._metric.lengths(rows, goal).min()) for rows in (x.q, points))
            gain = (before if left is None else left) - after
            if gain < max(_LEAST_GAIN, _GAIN_SHARE * best):
                return None
            left, best = after, max(best, gain)
        return None

    def _f(self, tree: VolumeTree, goal: FloatArray) -> FloatArray:
        """Return f = g + h + α·CDF, eq. (10) without the diversity, for the points in Open."""
        rows = tree.open
        f = self._metric.lengths(rows["q"], goal)
        f += _PATH_SHARE * rows["path_length"]
        if self.alpha and not self._ignores_danger:
            f += self.alpha * self._danger.scale * rows["cost"] + rows["penalty"]
        return f

    def _bubble_endpoints(self, bubble: Bubble, goal: FloatArray) -> FloatArray:
        """BUBBLE_ENDPOINTS: the vertices (K, n), and the point where the motion to the goal leaves the bubble."""
        points = bubble.vertices(self._bridge.lower, self._bridge.upper, self._bridge.circular)
        points = np.vstack([points, bubble.exit(self._bridge.difference(bubble.q, goal))])
        points = self._bridge.inside(points)
        return points[self._metric.separations(bubble.q, points) > 1e-9]

    # ------------------------------------------------------------------------------------------ the searching

    def _headings(self, other: VolumeTree) -> Iterator[FloatArray]:
        """Yield the goals of a tree in an iteration: the last bubble of the other tree, and a Halton point.

        The Halton point leads out of dead ends.
        """
        yield other.latest
        self._places += 1
        yield self._bridge.between_bounds(halton_point(self._places, self._bridge.n))

    @property
    def _ignores_danger(self) -> bool:
        """Whether this iteration ignores danger; start tree and goal tree take turns."""
        turn = self._turns // 2
        return int((turn + 1) * self.nearest_fraction) > int(turn * self.nearest_fraction)

    def _danger_term(self, points: FloatArray) -> FloatArray:
        """Return the danger (K,) of points as lengths [m], scaled by its typical slope and logarithmic."""
        cost = self._problem.cost
        if not (self.alpha and cost.usual_value > 0 and self._danger.slope > 0):
            return np.zeros(len(points))
        rates = self._validity.checker.robot.bounds.arm_rates
        metres = float(np.sqrt(np.mean(rates**2))) / self._danger.slope
        return metres * cost.usual_value * np.log1p(cost.values(points) / cost.usual_value)

    # -------------------------------------------------------------------------------------------- the trees

    def _approach(self) -> FloatArray:
        return free_part(self._problem, super()._approach())

    def _forget(self) -> None:
        self._validity = bubble_validity(self.getSpaceInformation(), self.getName())
        self._metric = JointMetric(self._bridge, self._validity.checker.robot.bounds.arm_rates, taxicab=False)
        self._structure = self._volumes = volume_trees(self._bridge, self._metric, diverse=False)
        self._turns = self._places = 0
        self._decay.reset()
        self._margin.reset()


class Rows:
    """A growing table. Each column has a dtype and a shape of its entries."""

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
        """Append `number` rows. A value is given for each row, or once for all rows."""
        end = self._size + number
        for name, column in self._columns.items():
            if end > len(column):
                self._columns[name] = column = np.resize(column, (2 * end, *column.shape[1:]))
            column[self._size : end] = values[name]
        self._size = end

    def remove(self, row: int) -> None:
        """Remove a row; the last row takes its index."""
        self._size -= 1
        for column in self._columns.values():
            column[row] = column[self._size]

    def keep(self, rows: IntArray) -> None:
        """Keep only these rows."""
        for column in self._columns.values():
            column[: len(rows)] = column[rows]
        self._size = len(rows)


class JointMetric:
    """Distances in f, eq. (10), with a weight per coordinate, `rates: (n,)`; 1-norm for g and h if `taxicab`."""

    def __init__(self, bridge: StateBridge, rates: FloatArray, *, taxicab: bool) -> None:
        self._bridge, self._rates, self._taxicab = bridge, rates, taxicab

    def lengths(self, start: FloatArray, end: FloatArray) -> FloatArray:
        """Return the lengths (…) of motions between `start` and `end: (…, n)`, for g and h."""
        if not self._taxicab:
            return self.separations(start, end)
        return np.abs(self._bridge.difference(start, end)) @ self._rates

    def separations(self, start: FloatArray, end: FloatArray) -> FloatArray:
        """Return the distances (…) between `start` and `end: (…, n)` in the 2-norm, for the diversity."""
        steps = self._bridge.difference(start, end) * self._rates
        return np.asarray(np.sqrt(np.einsum("...i,...i->...", steps, steps)))


class EndPoint(NamedTuple):
    """An entry of Open. `parent` is the index of the closed bubble; `path_length` is g, the path length from the root.

    `diversity` is the distance from the nearest closed configuration, `penalty` the penalty of points near obstacles.
    """

    q: FloatArray
    parent: int
    path_length: float
    cost: float
    diversity: float
    penalty: float


class VolumeTree:
    """The lists Closed (bubbles) and Open (end points) of one search direction; `diverse`: compute the diversity."""

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
        """Add a start or goal configuration (n,) to Open."""
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
        diversity: Any = 0.0
        # The diversity is min_z ‖x − z‖ over the closed configurations z.
        if self._diverse:
            diversity = [self._metric.separations(self.closed["center"], x).min() for x in points]
        self.open.extend(
            len(points),
            q=points,
            parent=parent,
            path_length=length + self._metric.lengths(center, points),
            cost=costs,
            diversity=diversity,
            penalty=0.0,
        )

    def branch(self, node: int) -> list[int]:
        """Return the closed bubbles from the root to `node`."""
        return branch(self.closed["parent"], node)

    def nodes(self) -> tuple[FloatArray, IntArray]:
        """Return the closed configurations and the roots in Open (N, n), and the indices (N,) of their parents."""
        roots = self.open["q"][self.open["parent"] == ROOT]
        parents = np.concatenate([self.closed["parent"], np.full(len(roots), ROOT)])
        return np.vstack([self.closed["center"], roots]), parents

    def cut(self, node: int) -> None:
        """Remove a bubble and its descendants from the search."""
        alive, parents = self.closed["alive"], self.closed["parent"]
        alive[node] = False
        for later in range(node + 1, len(self.closed)):
            alive[later] &= parents[later] == ROOT or bool(alive[parents[later]])
        owners = self.open["parent"]
        self.open.keep(np.flatnonzero((owners == ROOT) | alive[owners]))


def volume_trees(bridge: StateBridge, metric: JointMetric, *, diverse: bool) -> TwoTrees[VolumeTree]:
    """Return empty volume trees of both directions."""
    return TwoTrees(*(VolumeTree(bridge, metric, from_start=side, diverse=diverse) for side in (True, False)))


def intersect(problem: PlanningProblem, tree: VolumeTree, new: int, other: VolumeTree) -> FloatArray | None:
    """INTERSECT and PATH: return the path (N, n) through a new bubble and the other tree's bubble of largest overlap.

    The motion validator may have more constraints than the bubbles. If it refuses an edge, the branch behind the edge
    is removed from its tree, and None is returned.
    """
    if not len(other.closed):
        return None
    q, weights = tree.closed["center"][new], tree.closed["weights"][new]
    delta = problem.bridge.difference(q, other.closed["center"])
    reach = np.abs(delta)
    u, v = weights * reach, other.closed["weights"] * reach
    near = np.flatnonzero(other.closed["alive"] & bubbles.diamonds_may_meet(u, v))
    gaps, shares = bubbles.diamond_meetings(u[near], v[near])
    if gaps.min(initial=np.inf) >= INSIDE:
        return None
    best = int(gaps.argmin())
    met = int(near[best])
    meeting = q + shares[best] * delta[met]
    first, there, second, back = (tree, new, other, met) if tree.from_start else (other, met, tree, new)
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


def free_part(problem: PlanningProblem, path: FloatArray) -> FloatArray:
    """Return the part of a path (N, n) before the first edge that the motion validator refuses."""
    path = problem.bridge.wrapped(path)
    free = takewhile(lambda ends: problem.motion_is_free(*ends), pairwise(path))
    return np.vstack([path[:1], *(end for _, end in free)])


def bubble_validity(si: Any, name: str) -> CollisionFreeValidity:
    """Return the state validity checker. Raises InputError if it is no `CollisionFreeValidity` with distances."""
    validity = si.getStateValidityChecker()
    if not isinstance(validity, CollisionFreeValidity):
        raise InputError(
            f"{name} needs a CollisionFreeValidity as state validity checker, for the distances that bubbles "
            f"come from; got {type(validity).__name__}"
        )
    return validity
