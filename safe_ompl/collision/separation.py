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
    """A distance [m] that links must keep from obstacles. Exempt pairs of link and obstacle must only not touch."""

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
        """Return the requested clearance, or None if the distance [m] is 0.

        Links keep the distance from the given obstacles, by default from those of the scene with a danger weight, such
        as people. Exempt pairs of a link and an obstacle must only not touch. Raises InputError if the distance is not
        a finite number ≥ 0, if there are no obstacles to keep it from, if an obstacle or link is unknown, or if all
        moving links are exempt.
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
                raise InputError(
                    f"{link!r} is exempt from keeping a distance to {obstacle!r}, which has no min clearance"
                )
        if not distance:
            return None
        if not chosen:
            raise InputError("min clearance: no obstacle has a danger weight > 0; name the obstacles")
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
        """Return the clearance as plain numbers, lists and strings."""
        exempt = sorted([link, obstacle] for link, obstacle in self.exempt)
        return {"distance": self.distance, "obstacles": list(self.obstacles), "exempt": exempt}


@dataclass(frozen=True)
class Separation:
    """The separation required between a robot and obstacles. By default they must not touch.

    Attributes
    ----------
    min_clearance : MinClearance or None
        The distance that links must keep from chosen obstacles.
    margin : float
        [m] The distance that every link must keep from every obstacle. The larger of the two distances counts.
    speeds : mapping of str to float
        Bound of the speed [m/s] of each moving obstacle, by name. The other obstacles stand still.
    time : float
        [s] The time after the instant of the scene within which motions may be executed. The distance that obstacles
        may move in this time is added.
    tube : tuple of float
        Largest deviation of each of the n joints [rad or m]; empty: none. Proofs hold for every motion within this
        deviation of the checked motion, and within the limits of prismatic joints.

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
        """Return a copy with another distance from chosen obstacles; arguments and errors as `MinClearance.of`."""
        return replace(self, min_clearance=MinClearance.of(distance, obstacles, exempt, checker))

    def required(self, checker: CollisionChecker) -> RequiredDistances:
        """Return the distances that the pairs of a checker must keep; the checker keeps those asked for last.

        Raises
        ------
        InputError
            If the tube does not have one width per joint of the robot.
        UnknownNameError
            If the separation names an obstacle that the scene does not have.
        """
        found = checker.required_distances.get(self)
        if found is None:
            if len(checker.required_distances) >= _MOST_REQUIRED:
                checker.required_distances.clear()
            found = checker.required_distances[self] = self._required(checker)
        return found

    def _required(self, checker: CollisionChecker) -> RequiredDistances:
        speeds, time = self.speeds, self.time
        kept_from = () if self.min_clearance is None else self.min_clearance.obstacles
        for name in (*speeds, *kept_from):
            # This lookup raises an error if there is no such obstacle.
            checker.scene[name]
        pairs = checker.pairs_within(self.reach + self.tube_displacement(checker))
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
        """The largest distance that an obstacle may move [m]."""
        return max(self.speeds.values(), default=0.0) * self.time

    @property
    def reach(self) -> float:
        """The largest distance [m] that any pair must keep."""
        least = 0.0 if self.min_clearance is None else self.min_clearance.distance
        return max(self.margin, least) + self.travel

    def tube_displacement(self, checker: CollisionChecker) -> float:
        """Return how far [m] any body may deviate because of the tube."""
        if not self.tube:
            return 0.0
        widths = finite_array(self.tube, (checker.robot.n,), "tube")
        return float((checker.robot.bounds.displacement_radii @ widths).max(initial=0.0))


TOUCHING_ONLY: Separation = Separation()
# Queries add the distance error, so with this value they require what distance bounds require.
_SPARE = ALLOWANCE - DISTANCE_ERROR  # [m]
# So many required distances are kept by a checker. A planner and a simplifier ask for three or four again and again.
_MOST_REQUIRED = 8


class RequiredDistances:
    """Distances `least` (P,) [m] that pairs of bodies must keep.

    `allowed_for` adds the allowance of distance bounds, so that coal confirms what bounds prove. `provable` are the
    smallest query margins that prove anything. `any` tells whether any pair must keep more than not touching.
    """

    def __init__(self, pairs: PairSet, least: FloatArray) -> None:
        self.pairs, self.least = pairs, least
        self.allowed_for, self.provable = Required(least + ALLOWANCE), least + _SPARE
        for array in (least, self.provable):
            array.setflags(write=False)
        self.any = bool(least.any())

    def violated(self, q: FloatArray) -> bool:
        """Return whether a pair is nearer than it must be at `q: (n,)`.

        Contact of pairs with distance 0 is not checked.
        """
        return self.any and self.pairs.within_margins(q, self.least)

    def violating_pair(self, q: FloatArray) -> tuple[str, str] | None:
        """Return the names of a pair that is nearer than it must be at `q: (n,)`, or None."""
        return self.pairs.pair_within_margins(q, self.least) if self.any else None
