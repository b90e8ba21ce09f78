"""All pairs of bodies of a robot and a scene, and sets of pairs that may come near each other."""

from __future__ import annotations

from functools import cached_property, partial
from itertools import chain

import coal
import numpy as np

from safe_ompl.collision.geometry import SceneGeometry
from safe_ompl.collision.proofs import BLOCK, DistanceBounds, bound_reaches, distance_gradients
from safe_ompl.collision.queries import CoalPairs, Nearest
from safe_ompl.common import BoolArray, Changes, Counts, FloatArray, IntArray, PerThread
from safe_ompl.geometry import DISTANCE_ERROR, ConvexBodies
from safe_ompl.robot import Robot, plain

_TINY = 1e-12  # [m]
_REQUEST = coal.DistanceRequest()


class PairTable:
    """All T pairs of bodies: the checked self-collision pairs, then each moving body with each obstacle part.

    The table decides which pairs can come near each other at all. Distance bounds decide most pairs; coal decides each
    of the others once, on demand. Self-collision pairs and pairs of movable obstacles always count as near.

    `bodies: (T, 2)` are indices in the geometry, the smaller one first. `with_obstacle` are the rows of pairs of a link
    and an obstacle. `obstacle_radii: (G, m)` are the largest distances [m] of each of the G bodies from the axes of the
    model's m ≥ n joints, for the present poses of obstacles; infinite for the robot's bodies.
    """

    def __init__(self, robot: Robot, geometry: SceneGeometry) -> None:
        self.robot, self.geometry = robot, geometry
        own, parts, reaches = robot.shared.body_pairs, geometry.parts, robot.bounds.body_reaches
        numbers = range(len(geometry.names) - len(parts), len(geometry.names))
        names, with_parts = geometry.names[numbers.start :], np.empty((len(parts), len(reaches), 2), dtype=np.intp)
        with_parts[..., 0] = list(reaches)
        with_parts[..., 1] = np.reshape(numbers, (-1, 1))
        checked = np.ones(with_parts.shape[:2], dtype=bool)
        for k, name in enumerate(names if geometry.touched_by else ()):
            if allowed := geometry.touched_by.get(name):
                checked[k] = [geometry.names[body] not in allowed for body in reaches]
        self.obstacle_radii = np.full((len(geometry.names), robot.bounds.joint_radii.shape[1]), np.inf)
        self._measure()
        self._checked = _in_blocks(self._obstacles.bodies["translation"], checked)
        self.bodies: IntArray = np.concatenate([own, with_parts.reshape(-1, 2)[self._checked]])
        self.with_obstacle: IntArray = np.arange(len(own), len(self.bodies))
        # Bounds (K, M) of the least distance between each of K parts and the reachable set of each of M moving bodies.
        self._lower = np.full(checked.shape, -np.inf)
        self._upper = np.full(checked.shape, np.inf)
        if geometry.movable:
            self._upper[[name in geometry.movable for name in names]] = -np.inf

    @cached_property
    def _reaches(self) -> ConvexBodies:
        """Cylinders that the moving bodies never leave, and the obstacles, with their present poses."""
        return self.robot.bounds.reach_bodies[1].joined(self._obstacles)

    @cached_property
    def convex_bodies(self) -> ConvexBodies:
        """Convex bodies that contain the G bodies, with the present poses of obstacles."""
        return self.robot.bounds.convex_bodies.joined(self._obstacles)

    def names(self, rows: IntArray) -> tuple[tuple[str, str], ...]:
        """Return the names of pairs: link and obstacle, or link and link."""
        names = self.geometry.names
        return tuple((names[first], names[second]) for first, second in self.bodies[rows].tolist())

    def within(self, reach: float) -> IntArray:
        """Return the rows of the pairs that may touch, then of those that may come nearer than `reach` [m].

        For infinity, all rows are returned in their order.
        """
        if reach == np.inf:
            return np.arange(len(self.bodies))
        touching = self._nearer_than(DISTANCE_ERROR)
        near = self._nearer_than(reach + DISTANCE_ERROR) & ~touching if reach > 0 else touching[:0]
        return np.concatenate([np.flatnonzero(touching), np.flatnonzero(near)])

    def _nearer_than(self, distance: float) -> BoolArray:
        """Return for each pair (T,) whether its bodies can come nearer to each other than a distance [m]."""
        cylinders, parts = self.robot.bounds.reach_bodies[0], self.geometry.parts
        for k, m in bound_reaches(self._reaches.table, self._lower, self._upper, distance).tolist():
            if self._obstacles.exact[k]:
                continue
            bodies = parts[k], cylinders[m]
            placed = ((b.geometry, coal.Transform3s(b.placement.rotation, b.placement.translation)) for b in bodies)
            self._lower[k, m] = self._upper[k, m] = coal.distance(
                *chain.from_iterable(placed), _REQUEST, coal.DistanceResult()
            )
        nearer = np.ones(len(self.bodies), dtype=bool)
        nearer[self.with_obstacle] = (self._lower < distance).ravel()[self._checked]
        return nearer

    def follow(self) -> None:
        """Recompute data that depend on the poses of obstacles, after a move."""
        for name in ("convex_bodies", "_reaches"):
            vars(self).pop(name, None)
        self._measure()

    def _measure(self) -> None:
        """Recompute the convex bodies of obstacles and their distances from the joint axes."""
        self._obstacles = ConvexBodies.of(self.geometry.parts)
        radii = self.robot.shared.chain.axis_distances(self._obstacles)
        self.obstacle_radii[len(self.obstacle_radii) - len(radii) :] = radii


def _in_blocks(centres: FloatArray, checked: BoolArray) -> IntArray:
    """Return the indices of the pairs in `checked: (K, M)`, link by link.

    Among many parts (K, 3), neighbours come together.
    """
    blocks: list[IntArray] = [np.arange(len(centres))]
    while len(blocks[0]) > BLOCK:
        halved: list[IntArray] = []
        for block in blocks:
            widest = int(np.ptp(centres[block], axis=0).argmax())
            half = BLOCK * -(-len(block) // (2 * BLOCK))  # whole blocks
            halved += np.split(block[np.argsort(centres[block, widest], kind="stable")], [half])
        blocks = [block for block in halved if len(block)]
    order = np.arange(checked.size).reshape(checked.shape)[np.concatenate(blocks)].T.ravel()
    return order[checked.ravel()[order]]


class PairSet:
    """The P pairs of bodies of a robot and a scene that may come nearer to each other than some reach.

    `CollisionChecker.pairs_within` makes the set from rows of a table. Only the checker's `move` changes it, and only
    the poses and radii. The methods do not validate input, because `CollisionChecker` and `MotionProver` do: `q` must
    be a finite float array (n,), margins must be (P,).

    Attributes
    ----------
    bodies : ndarray of int, shape (P, 2)
        Indices of the pairs in the geometry, the smaller one first.
    revision : int
        Number of obstacle moves so far.
    radii : ndarray, shape (P, n)
        Motion bounds of each pair for the present poses of obstacles: while the joints move by Δ, the two bodies
        approach each other by at most Σ_i R_pi·|Δ_i| (`docs/how-it-works.md` §3, §4).
    meets_obstacle : ndarray of bool, shape (P,)
        Which pairs are of a link and an obstacle.
    """

    def __init__(self, table: PairTable, rows: IntArray, counts: Counts, changes: Changes) -> None:
        self._table, self._robot, self._counts, self.changes = table, table.robot, counts, changes
        self._rows, self.bodies = rows, table.bodies[rows]
        self.meets_obstacle: BoolArray = rows >= len(table.bodies) - len(table.with_obstacle)
        for array in (self.bodies, self.meets_obstacle):
            array.setflags(write=False)
        self._coal = PerThread(partial(CoalPairs, table.robot, table.geometry, self.bodies))
        self._no_margins: FloatArray = np.zeros(len(rows))
        self._bounds: DistanceBounds | None = None
        self.revision = 0
        self._take_radii()

    @cached_property
    def names(self) -> tuple[tuple[str, str], ...]:
        """Names of the pairs: link and obstacle, or link and link."""
        return self._table.names(self._rows)

    @cached_property
    def carriers(self) -> IntArray:
        """Pinocchio's indices of the joints that carry the bodies of each pair, (P, 2)."""
        return np.asarray(self._table.convex_bodies.bodies["joint"][self.bodies])

    def _take_radii(self) -> None:
        links, obstacles = self._robot.bounds.joint_radii, self._table.obstacle_radii
        self._joint_radii = _pair_radii(links, self.bodies, obstacles)
        self.radii: FloatArray = self._robot.coupling.radii(self._joint_radii)
        self.radii.setflags(write=False)

    def follow(self) -> None:
        """Recompute data that depend on the poses of obstacles, after a move."""
        self._take_radii()
        self._bounds = None
        self.revision += 1

    def __repr__(self) -> str:
        return f"PairSet({self._robot.name!r}, {len(self.bodies)} pairs)"

    @property
    def bounds(self) -> DistanceBounds:
        """Lower bounds of the distances of the pairs, which prove most motions without a query."""
        known = self._bounds
        # A cached property would hold a lock of all instances during the computation.
        if known is None:
            with self.changes.read_lock():
                bodies = self._table.convex_bodies
                known = DistanceBounds(self._robot, bodies, self.bodies, self._joint_radii, self._counts)
                self._bounds = known
        return known

    def margins(self, obstacles: float, links: float = 0.0) -> FloatArray:
        """Return read-only margins (P,) [m]: `obstacles` for pairs with an obstacle, `links` for pairs of two links."""
        margins: FloatArray = np.where(self.meets_obstacle, obstacles, links)
        margins.setflags(write=False)
        return margins

    def approach(self, steps: FloatArray) -> FloatArray:
        """Return by how much (P,) [m] bodies approach at most while joints move by up to `steps: (n,)` ≥ 0.

        Unlike a bound by `radii`, this bound holds for any poses of obstacles.
        """
        links, coupling = self._robot.bounds.joint_radii, self._robot.coupling
        radii = coupling.radii(_pair_radii(links, self.bodies, np.full_like(self._table.obstacle_radii, np.inf)))
        return radii @ steps

    def touching(self, q: FloatArray, margins: FloatArray | None = None) -> int | None:
        """Return a pair that touches, or is nearer than its margin (P,) [m], ≥ 0, at `q: (n,)`, or None.

        Distance bounds decide most pairs and agree with coal. Coal decides the others.
        """
        margins, largest = (self._no_margins, 0.0) if margins is None else (margins, float(margins.max(initial=0.0)))
        done, found = self.changes.done, None
        pairs, surely = self.bounds.nearer(q, margins, largest)
        if len(pairs) > surely:
            own = self._coal.own
            own.place(q)
            asked = pairs[: len(pairs) - surely].tolist()
            found = next((pair for pair in asked if own.are_nearer(pair, margins[pair])), None)
        if found is None and surely:
            found = int(pairs[-1])
        if self.changes.begun == done:
            return found
        with self.changes.read_lock():
            return self.touching(q, margins)

    def within_margins(self, q: FloatArray, margins: FloatArray) -> bool:
        """Return whether any pair is nearer than its margin (P,) [m], ≥ 0, at `q: (n,)`."""
        self._counts.margin_queries += 1
        return self.touching(q, margins) is not None

    def pair_within_margins(self, q: FloatArray, margins: FloatArray) -> tuple[str, str] | None:
        """Return the names of a pair that is nearer than its margin (P,) [m] at `q: (n,)`, or None."""
        self._counts.margin_queries += 1
        pair = self.touching(q, margins)
        return None if pair is None else self.names[pair]

    def measured(self, Q: FloatArray, rows: IntArray, pairs: IntArray) -> FloatArray:
        """Return distances and nearest points (C, 8) of pairs (C,) at rows (C,), in ascending order, of `Q: (B, n)`.

        It is coal that measures, and what is known of each is what `DistanceBounds.near` says after row and pair.
        """
        found, on_first, placed = np.zeros((len(rows), 8)), np.zeros((len(rows), 3)), -1
        if not len(rows):
            return found
        with self.changes.read_lock():
            own = self._coal.own
            for c, (row, pair) in enumerate(zip(rows.tolist(), pairs.tolist(), strict=True)):
                if row != placed:
                    self._counts.distance_queries += 1
                    own.place(Q[row])
                    placed = row
                distance, (on_first[c], on_second), out = own.nearest(pair)
                way = on_first[c] - on_second
                normal = way / max(float(np.sqrt(way @ way)), _TINY) if distance > 0.0 else -out
                found[c, 0], found[c, 4:7], found[c, 7] = distance, normal, normal @ on_second
        found[:, 1:4] = _in_joint_frames(self._robot, Q[rows], self.carriers[pairs, 0], on_first)
        return found

    def near(self, Q: FloatArray, within: float) -> FloatArray:
        """Return which pairs are nearer than a distance [m] at `Q: (B, n)`, as a table like `DistanceBounds.near`.

        Coal measures pairs in contact, whose normal is the shortest way out, and those that are not exact.
        """
        with self.changes.read_lock():
            bounds = self.bounds
            table = bounds.near(Q, bounds.some(np.arange(len(self.bodies))), within)
            rows, pairs = table[:, :2].T.astype(np.intp)
            others = np.flatnonzero(~bounds.exact[pairs] | (table[:, 2] == -np.inf))
            table[others, 2:] = self.measured(Q, rows[others], pairs[others])
        return np.asarray(table[table[:, 2] < within])

    def gradients(self, Q: FloatArray, table: FloatArray) -> FloatArray:
        """Return the gradients (C, n) of the distances in a table (C, 10) that `near` made at `Q: (B, n)`."""
        values, joints = plain(self._robot.coupling.values(Q)), self._robot.kinematics.table
        return self._robot.coupling.columns(distance_gradients(joints, values, self.carriers, table))

    def distances(self, Q: FloatArray, pairs: IntArray) -> FloatArray:
        """Return the distances (B, K) [m] of pairs (K,) at `Q: (B, n)`; ≤ 0 in contact."""
        exact = self.bounds.exact[pairs]
        found = np.full((len(Q), len(pairs)), -np.inf)
        with self.changes.read_lock():
            near = self.bounds.near(Q, self.bounds.some(pairs[exact]), np.inf)
            found[:, exact] = near[:, 2].reshape(len(Q), np.count_nonzero(exact))
            for row, q in zip(found, Q, strict=True):
                left = np.flatnonzero(row == -np.inf)  # including pairs in contact
                if len(left):
                    own = self._coal.own
                    own.place(q)
                    row[left] = [own.nearest(pair).distance for pair in pairs[left].tolist()]
        self._counts.distance_queries += len(Q)
        return found

    def nearest(self, q: FloatArray, pairs: IntArray) -> list[Nearest]:
        """Return coal's distances and nearest points of pairs (K,) at `q: (n,)`."""
        with self.changes.read_lock():
            own = self._coal.own
            own.place(q)
            return [own.nearest(pair) for pair in pairs.tolist()]


def _pair_radii(links: FloatArray, bodies: IntArray, obstacle_radii: FloatArray) -> FloatArray:
    """Return the displacement radii (P, m) of pairs. Joints that move both bodies alike do not count."""
    moves = np.zeros_like(obstacle_radii)
    moves[: len(links)] = links
    first, second = moves[bodies[:, 0]], moves[bodies[:, 1]]
    radii = np.where((first > 0) != (second > 0), first + second, 0.0)
    return np.minimum(radii, obstacle_radii[bodies[:, 1]])


def _in_joint_frames(robot: Robot, Q: FloatArray, joints: IntArray, places: FloatArray) -> FloatArray:
    """Transform points (C, 3) from the world to the frames of joints (C,), by Pinocchio's indices, at `Q: (C, n)`."""
    rotations, origins, _ = robot.joint_frames(Q)
    local = places.copy()
    # Bodies with joint 0 are fixed, so their points stay in the world frame.
    carried = np.flatnonzero(joints)
    at = carried, joints[carried] - 1
    local[carried] = np.einsum("cxy,cx->cy", rotations[at], places[carried] - origins[at])
    return local
