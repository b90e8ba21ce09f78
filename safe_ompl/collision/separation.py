"""Separation: distances that a robot must keep from obstacles, at rest or moving."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import Any

import numpy as np

from safe_ompl.collision.checker import CollisionChecker
from safe_ompl.collision.pairs import PairSet
from safe_ompl.collision.proofs import ALLOWANCE, Required
from safe_ompl.common import FloatArray, InputError, UnknownNameError, finite_array, number, shown
from safe_ompl.geometry import DISTANCE_ERROR


@dataclass(frozen=True)
class MinClearance:
    """A distance [m] that links must keep from obstacles; exempt pairs of link and obstacle only must not touch."""

    distance: float
    obstacles: tuple[str, ...]
    exempt: frozenset[tuple[str, str]]

    @classmethod
    def of(
        cls,
        distance: float,
        obstacles: Sequence[str] | None,
        exempt: Sequence[tuple[str, str]],
        checker: CollisionChecker,
    ) -> MinClearance | None:
        """Return what is asked for; None where the distance [m] is 0.

        It is kept from these obstacles, by default from those of the scene with a danger weight, such as people. Pairs
        of a link and an obstacle that are exempt must only not touch. Raises InputError if the distance is not a finite
        number ≥ 0, there is nothing to keep it from, no such obstacle or link, or no moving link is left to keep it.
        """
        scene, bodies = checker.scene, checker.robot.shared.collision_model.geometryObjects
        distance = number("min clearance", distance, at_least=0.0, kind="length [m]")
        if isinstance(obstacles, str) or not (obstacles is None or isinstance(obstacles, Sequence)):
            raise InputError(f"obstacles must be a list of names, got {obstacles!r}")
        names = [o.name for o in scene if o.weight > 0] if obstacles is None else obstacles
        chosen = tuple(scene[name].name for name in names)
        for pair in exempt:
            if isinstance(pair, str) or not isinstance(pair, Sequence) or len(pair) != 2:
                raise InputError(f"exempt must be pairs of a link and an obstacle, not {pair!r}")
            link, obstacle = pair
            if link not in checker.links:
                raise UnknownNameError("link", link, sorted(set(checker.links)))
            if scene[obstacle].name not in chosen:
                raise InputError(f"{link!r} is exempt from keeping a distance to {obstacle!r}, which is not asked for")
        if not distance:
            return None
        if not chosen:
            raise InputError("min clearance: no obstacle has a danger weight > 0; name those to keep it from")
        free = frozenset((link, obstacle) for link, obstacle in exempt)
        moving = {link for link, body in zip(checker.links, bodies, strict=False) if body.parentJoint != 0}
        for obstacle in chosen:
            if free and all((link, obstacle) in free for link in moving):
                why = f"must leave a moving link that keeps away from {obstacle!r}, got {shown(exempt)}"
                raise InputError(f"exempt {why}")
        return cls(distance, chosen, free)

    def between(self, link: str, obstacle: str) -> float:
        """Return the distance [m] that a link must keep from an obstacle, or 0."""
        return self.distance if obstacle in self.obstacles and (link, obstacle) not in self.exempt else 0.0

    def as_dict(self) -> dict[str, Any]:
        """Return it as plain numbers, lists and strings."""
        exempt = sorted([link, obstacle] for link, obstacle in self.exempt)
        return {"distance": self.distance, "obstacles": list(self.obstacles), "exempt": exempt}


@dataclass(frozen=True)
class Separation:
    """The separation required between a robot and obstacles; by default they must not touch.

    Attributes
    ----------
    min_clearance : MinClearance or None
        The distance that links must keep from chosen obstacles.
    margin : float
        [m] What every link must keep from every obstacle. The larger of the two counts.
    speeds : mapping of str to float
        Bound of the speed [m/s] of the obstacles that move, by name. The others stand still.
    time : float
        [s] How long after the moment of the scene motions may be driven. What obstacles may move until then is added.
    tube : tuple of float
        How far each of the n joints may be from where it should be [rad or m]; empty: nowhere else. What is proven
        holds for every motion within this of the one that is checked, and within the limits of joints that slide.

    Raises
    ------
    InputError
        If the margin, a speed, the time or a width of the tube is negative or not finite.
    """

    min_clearance: MinClearance | None = None
    margin: float = 0.0
    speeds: Mapping[str, float] = field(default_factory=dict, hash=False)
    time: float = 0.0
    tube: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        margin = number("margin", self.margin, at_least=0.0, kind="length [m]")
        object.__setattr__(self, "margin", margin)
        object.__setattr__(self, "speeds", MappingProxyType(dict(self.speeds)))
        for name, speed in self.speeds.items():
            number(f"speed of {name!r}", speed, at_least=0.0, kind="number [m/s]")
        number("time", self.time, at_least=0.0, kind="number of seconds")
        widths = finite_array(self.tube, (None,), "tube")
        if (widths < 0).any():
            raise InputError(f"tube must be widths >= 0 [rad or m], got {widths.tolist()}")
        object.__setattr__(self, "tube", tuple(widths.tolist()) if widths.any() else ())

    def __reduce__(self) -> tuple[Any, ...]:
        return Separation, (self.min_clearance, self.margin, dict(self.speeds), self.time, self.tube)

    def with_min_clearance(
        self,
        checker: CollisionChecker,
        distance: float,
        obstacles: Sequence[str] | None = None,
        exempt: Sequence[tuple[str, str]] = (),
    ) -> Separation:
        """Return the same with another distance from chosen obstacles; arguments and errors of `MinClearance.of`."""
        return replace(self, min_clearance=MinClearance.of(distance, obstacles, exempt, checker))

    def required(self, checker: CollisionChecker) -> RequiredDistances:
        """Return the distances that the pairs of a checker must keep.

        Raises
        ------
        InputError
            If the tube is not of the robot's joints.
        UnknownNameError
            If its scene has no obstacle of a name.
        """
        speeds, time = self.speeds, self.time
        kept_from = () if self.min_clearance is None else self.min_clearance.obstacles
        for name in (*speeds, *kept_from):
            # This raises an error if there is no such obstacle.
            checker.scene[name]
        pairs = checker.pairs_within(self.reach + self.swing(checker))
        wanted, kept = self.min_clearance, pairs.margins(self.margin)
        if wanted is not None:
            between = np.array([wanted.between(*pair) for pair in pairs.names], dtype=np.float64)
            kept = np.maximum(kept, between * pairs.meets_obstacle)
        if self.tube:
            kept = kept + pairs.approach(np.array(self.tube))
        if speeds:
            rates = np.array([speeds.get(obstacle, 0.0) for _, obstacle in pairs.names], dtype=np.float64)
            kept = kept + time * rates * pairs.meets_obstacle
        return RequiredDistances(pairs, kept)

    @property
    def travel(self) -> float:
        """How far an obstacle may move [m]."""
        return max(self.speeds.values(), default=0.0) * self.time

    @property
    def reach(self) -> float:
        """The largest distance [m] that any pair must keep."""
        least = 0.0 if self.min_clearance is None else self.min_clearance.distance
        return max(self.margin, least) + self.travel

    def swing(self, checker: CollisionChecker) -> float:
        """Return how far [m] any body may be from where it should be, because joints are elsewhere in the tube."""
        if not self.tube:
            return 0.0
        widths = finite_array(self.tube, (checker.robot.n,), "tube")
        return float((checker.robot.bounds.displacement_radii @ widths).max(initial=0.0))


TOUCHING_ONLY: Separation = Separation()
# Queries add the distance error, so that they require what distance bounds require.
_SPARE = ALLOWANCE - DISTANCE_ERROR  # [m]


class RequiredDistances:
    """Distances (P,) [m] that pairs of bodies must keep: `least`.

    `allowed_for` has besides what distance bounds keep, so that coal agrees; `provable` are the least margins of
    queries that prove anything; `any` says whether any pair must keep more than not touching.
    """

    def __init__(self, pairs: PairSet, least: FloatArray) -> None:
        self.pairs, self.least = pairs, least
        self.allowed_for, self.provable = Required(least + ALLOWANCE), least + _SPARE
        for array in (least, self.provable):
            array.setflags(write=False)
        self.any = bool(least.any())

    def violated(self, q: FloatArray) -> bool:
        """Return whether a pair is nearer than it must be at `q: (n,)`; pairs that need only not touch do not count."""
        return self.any and self.pairs.within_margins(q, self.least)

    def violating_pair(self, q: FloatArray) -> tuple[str, str] | None:
        """Return the names of a pair that is nearer than it must be at `q: (n,)`, or None."""
        return self.pairs.pair_within_margins(q, self.least) if self.any else None
