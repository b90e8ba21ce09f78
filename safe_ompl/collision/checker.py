"""Collision, margin and distance queries between a robot and a scene."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import partial
from math import ceil, inf, log2
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from safe_ompl.collision.geometry import SceneGeometry
from safe_ompl.collision.pairs import PairSet, PairTable
from safe_ompl.common import Changes, Counts, FloatArray, configuration, configurations, instance
from safe_ompl.robot import Robot
from safe_ompl.scene import Scene

_REACH = 0.1  # [m]


@dataclass(frozen=True)
class Clearance:
    """The smallest distance [m] between the robot and the obstacles at one configuration, with the nearest pair.

    The distance is zero or negative in contact, and infinite without obstacles. `points` (2, 3) [m], if computed, are
    the nearest points of link and obstacle in the world.
    """

    distance: float
    link: str | None
    obstacle: str | None
    points: FloatArray | None = field(default=None, compare=False)


class CollisionChecker:
    """Collision, margin and distance queries of a robot against a scene and against itself.

    The checker tests the robot's self-collision pairs (`robot.collision_model`) and every moving body against every
    obstacle. The fixed base may stand on obstacles. Pairs whose body provably never reaches the obstacle, within the
    limits of prismatic joints, are left out of the collision queries. Queries from several threads are safe, but the
    shared `counts` may then miss some queries.

    Only `move` changes the checker: it sets new poses of `movable` obstacles. Afterwards every query gives the result
    of a new checker for the new scene. Objects derived from the checker (`PairSet`, `MotionProver`, `PairDistances`)
    are updated, too. Queries of other threads during `move` are answered for the new scene.

    Parameters
    ----------
    robot, scene : Robot, Scene
        The robot, and the obstacles.
    counts : Counts, optional
        Counters to share with other models.
    movable : sequence of str
        Names of the obstacles that may move; UnknownNameError if a name is unknown. All pairs of these obstacles are
        kept, at any distance.

    Attributes
    ----------
    changes : Changes
        Lock that detects obstacle moves during queries of other threads.
    revision : int
        Number of moves so far. Results of another revision belong to another scene.
    pairs : PairSet
        The P pairs that may touch.
    links : tuple of str
        The link of each of the robot's bodies.

    Examples
    --------
    >>> robot = Robot.from_example("ur5")
    >>> checker = CollisionChecker(robot, Scene([Obstacle("ball", Sphere(0.1), Pose([0.5, 0.1, 0.5]))]))
    >>> checker.in_collision([0.9, -1.2, 1.4, -1.8, -1.57, 0.0])
    False
    >>> checker.clearance([0.9, -1.2, 1.4, -1.8, -1.57, 0.0]).obstacle
    'ball'
    """

    def __init__(
        self, robot: Robot, scene: Scene, counts: Counts | None = None, *, movable: Sequence[str] = ()
    ) -> None:
        self.robot = instance("robot", robot, Robot)
        self.scene = instance("scene", scene, Scene)
        self.counts = Counts() if counts is None else counts
        self._bodies = SceneGeometry(robot, scene, movable)
        self._table = PairTable(robot, self._bodies)
        self.links = robot.shared.body_links
        self.revision = 0
        self.changes = Changes()
        # Pair sets by their reach [m].
        self._pair_sets: dict[float, PairSet] = {}
        # `RequiredDistances` by their separation. They do not depend on the poses of obstacles.
        self.required_distances: dict[object, Any] = {}
        self.pairs = self.pairs_within(0.0)

    def __reduce__(self) -> tuple[Any, ...]:
        # Pickling rebuilds the checker from robot and scene, so its counts start at zero.
        return partial(CollisionChecker, movable=tuple(self.movable)), (self.robot, self.scene)

    def __repr__(self) -> str:
        obstacles, pairs = len(self.scene.obstacles), len(self.pair_names)
        return f"CollisionChecker({self.robot.name!r}, {obstacles} obstacles, {pairs} pairs)"

    @property
    def pair_names(self) -> tuple[tuple[str, str], ...]:
        """Names of the P pairs that may touch: link and obstacle, or link and link."""
        return self.pairs.names

    def pairs_within(self, reach: float) -> PairSet:
        """Return the pairs that may touch, followed by all pairs that may come nearer than `reach` [m].

        The reach is rounded up to 0.1 m times a power of two and each set is cached. Thus the reach at most doubles
        above 0.1 m, and there are only a few sets.
        """
        level = max(0.0, reach)
        if 0.0 < reach < inf:
            level = _REACH * 2.0 ** max(0, ceil(log2(reach / _REACH)))
        if level not in self._pair_sets:
            with self.changes.read_lock():
                rows = self._table.within(level)
                same = (known for known in list(self._pair_sets.values()) if len(known.bodies) == len(rows))
                found = next(same, None) or PairSet(self._table, rows, self.counts, self.changes)
                self._pair_sets.setdefault(level, found)
        return self._pair_sets[level]

    @property
    def movable(self) -> frozenset[str]:
        """Names of the obstacles that may move."""
        return self._bodies.movable

    def move(self, scene: Scene) -> None:
        """Move obstacles to their poses in another scene, which differs only in the poses of movable obstacles.

        Afterwards verdicts, distances and proofs equal those of a new checker for this scene.

        Raises
        ------
        InputError
            If the scenes differ in anything else, or if a movable obstacle would consist of other parts than before,
            such as a small cloud with another number of points. Then nothing moves.
        """
        with self.changes.write_lock():
            moved = self._bodies.move(scene)
            self.scene = scene
            if not moved:
                return
            self.revision += 1
            self._table.follow()
            for pairs in set(self._pair_sets.values()):
                pairs.follow()

    def in_collision(self, q: ArrayLike) -> bool:
        """Return whether the robot touches an obstacle or itself at `q: (n,)`. Joint limits are not checked.

        Raises InputError if `q` has the wrong shape or is not finite, as do the other queries.
        """
        return self.touches(configuration(q, self.robot.n))

    def touches(self, q: FloatArray) -> bool:
        """Return whether the robot is in collision at a finite float array (n,), which is not validated."""
        return self._touching(q) is not None

    def _touching(self, q: FloatArray) -> int | None:
        self.counts.collision_queries += 1
        return self.pairs.touching(q)

    def colliding_pair(self, q: ArrayLike) -> tuple[str, str] | None:
        """Return the names of a pair in contact at `q: (n,)`, or None."""
        pair = self._touching(configuration(q, self.robot.n))
        return None if pair is None else self.pair_names[pair]

    def distances(self, q: ArrayLike) -> FloatArray:
        """Return the distance [m] of every moving body to every obstacle at `q: (n,)`; see `distance_names`."""
        return np.asarray(self.all_distances(configuration(q, self.robot.n)[None])[0])

    def all_distances(self, Q: ArrayLike) -> FloatArray:
        """Return `distances` (B, P) at a batch of configurations `Q: (B, n)`."""
        return self.pairs_within(inf).distances(configurations(Q, self.robot.n), self._table.with_obstacle)

    def pair_distances(self, q: ArrayLike) -> FloatArray:
        """Return the distance (P,) [m] of the pairs that may touch at `q: (n,)`, including self-collision pairs."""
        every, Q = np.arange(len(self.pairs.bodies)), configuration(q, self.robot.n)[None]
        return np.asarray(self.pairs.distances(Q, every)[0])

    def pair_radii_at(self, q: ArrayLike) -> FloatArray:
        """Return the motion bounds (P, n) of the pairs that may touch, for motions that start at `q: (n,)`.

        They are tighter than the bounds for all configurations, but cost more (`docs/how-it-works.md` §3).
        """
        bodies = np.zeros((len(self._bodies.names), self.robot.n))
        bodies[: len(self.links)] = self.robot.bounds.displacement_radii_at(configuration(q, self.robot.n))
        first, second = self.pairs.bodies.T
        both: FloatArray = bodies[first] + bodies[second]
        return np.minimum(both, self.pairs.radii)

    @property
    def distance_names(self) -> list[tuple[str, str]]:
        """Link and obstacle of each entry of `distances`."""
        return list(self._table.names(self._table.with_obstacle))

    def clearance(self, q: ArrayLike) -> Clearance:
        """Return the smallest distance between robot and obstacles at `q: (n,)`, with the nearest pair and points."""
        distances = self.distances(q)
        if not len(distances):
            return Clearance(float("inf"), None, None)
        nearest = int(distances.argmin())
        (pair,) = self._table.names(self._table.with_obstacle[[nearest]])
        (found,) = self.pairs_within(inf).nearest(configuration(q, self.robot.n), self._table.with_obstacle[[nearest]])
        return Clearance(float(distances[nearest]), *pair, found.points)
