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
    """The smallest distance [m] between the robot and the obstacles at one configuration; between which two.

    It is zero or negative in contact, and infinite where there is no obstacle. `points` are the nearest ones, of link
    and obstacle, in the world (2, 3) [m], where they were asked for.
    """

    distance: float
    link: str | None
    obstacle: str | None
    points: FloatArray | None = field(default=None, compare=False)


class CollisionChecker:
    """Collision, margin and distance queries of a robot against a scene and against itself.

    Checked are the robot's own pairs (`robot.collision_model`) and every moving body against every obstacle; the
    fixed base may stand on obstacles. A pair whose body provably never reaches the obstacle, within the limits of the
    joints that slide, is left out of the collision queries. Any number of threads may ask at the same time; they share
    the `counts`, which may then lose some.

    Only `move` changes it: obstacles that are `movable` are elsewhere then, and every answer is that of a checker made
    anew for the new scene. What was derived from it follows (`PairSet`, `MotionProver`, `PairDistances`). What another
    thread asks meanwhile is answered for the new scene.

    Parameters
    ----------
    robot, scene : Robot, Scene
        The robot, and the obstacles.
    counts : Counts, optional
        Counters to share with other models.
    movable : sequence of str
        Names of the obstacles that may move, else UnknownNameError. All their pairs are kept, wherever they are.

    Attributes
    ----------
    changes : Changes
        What notices that obstacles move while another thread asks.
    revision : int
        How often obstacles have moved. What was computed at another revision is of another scene.
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
        # The sets of pairs by their reach.
        self._pair_sets: dict[float, PairSet] = {}
        self.pairs = self.pairs_within(0.0)

    def __reduce__(self) -> tuple[Any, ...]:
        # A copy is made anew, and its counts begin at zero.
        return partial(CollisionChecker, movable=tuple(self.movable)), (self.robot, self.scene)

    def __repr__(self) -> str:
        obstacles, pairs = len(self.scene.obstacles), len(self.pair_names)
        return f"CollisionChecker({self.robot.name!r}, {obstacles} obstacles, {pairs} pairs)"

    @property
    def pair_names(self) -> tuple[tuple[str, str], ...]:
        """Names of the P pairs that may touch: link and obstacle, or link and link."""
        return self.pairs.names

    def pairs_within(self, reach: float) -> PairSet:
        """Return the pairs that may touch and, after them, all that may come nearer than a reach [m].

        Reaches are rounded up to 50 mm and its doublings: no pair more than twice as far comes in, and no more than
        a few sets are ever made. Each is made once.
        """
        level = max(0.0, reach)
        if 0.0 < reach < inf:
            level = _REACH * 2.0 ** max(0, ceil(log2(reach / _REACH)))
        if level not in self._pair_sets:
            with self.changes.none():
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
        """Take the places of another scene, in which nothing but the places of movable obstacles differs.

        Verdicts, distances and proofs are those of a checker made anew for that scene, from here on.

        Raises
        ------
        InputError
            If anything else differs, or a movable obstacle would have other parts than before, such as a small cloud
            with another number of points. Then nothing moves.
        """
        with self.changes.one():
            moved = self._bodies.move(scene)
            self.scene = scene
            if not moved:
                return
            self.revision += 1
            self._table.follow()
            for pairs in set(self._pair_sets.values()):
                pairs.follow()

    def in_collision(self, q: ArrayLike) -> bool:
        """Return whether the robot touches an obstacle or itself at `q: (n,)`; limits are not looked at.

        Raises InputError if `q` has the wrong shape or is not finite; so do the other queries.
        """
        return self.touches(configuration(q, self.robot.n))

    def touches(self, q: FloatArray) -> bool:
        """Return the same as `in_collision` for a float array (n,) that is known to be finite: nothing is checked."""
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
        """Return `distances` (B, P) at `Q: (B, n)`."""
        return self.pairs_within(inf).distances(configurations(Q, self.robot.n), self._table.with_obstacle)

    def pair_distances(self, q: ArrayLike) -> FloatArray:
        """Return the distance (P,) [m] of the pairs that may touch at `q: (n,)`, the robot's own pairs included."""
        every, Q = np.arange(len(self.pairs.bodies)), configuration(q, self.robot.n)[None]
        return np.asarray(self.pairs.distances(Q, every)[0])

    def pair_radii_at(self, q: ArrayLike) -> FloatArray:
        """Return the displacement radii (P, n) of the pairs that may touch at `q: (n,)`: tighter, but costlier.

        They hold for motions that start at `q` (`docs/how-it-works.md` §3).
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
        """Return the smallest distance between robot and obstacles at `q: (n,)`, between which two, and where."""
        distances = self.distances(q)
        if not len(distances):
            return Clearance(float("inf"), None, None)
        nearest = int(distances.argmin())
        (pair,) = self._table.names(self._table.with_obstacle[[nearest]])
        (found,) = self.pairs_within(inf).nearest(configuration(q, self.robot.n), self._table.with_obstacle[[nearest]])
        return Clearance(float(distances[nearest]), *pair, found.points)
