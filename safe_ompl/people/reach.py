"""Reach models: where a body that was measured may be some time later, as sets that proofs can take.

A proof sees whatever moves as a `ReachSets`: hulls of points that drift and grow,

    {points + τ·velocities}, grown by radius + g₀ + g₁τ + ½g₂τ²,

with the time τ since the measurement. A body is in *every* one of its sets, so models are intersected by listing the
sets of all of them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Protocol

import numpy as np

from safe_ompl.common import FloatArray, InputError, IntArray, number
from safe_ompl.geometry import STANDING
from safe_ompl.geometry.kernels import Sets
from safe_ompl.scene import People

_LONGER = 1.15  # arms of a person are at most this much longer than those of a mean person of that height


@dataclass(frozen=True)
class ReachSets:
    """Sets that M bodies do not leave; a body is a limb of a person, or an object, whose limb has no name."""

    # The person or object and the limb that each of the M bodies is; the limb of an object is empty
    names: tuple[tuple[str, str], ...]
    owners: IntArray  # (S,), the body that each set is about, in ascending order
    points: FloatArray  # (P, 3), of all sets, one after the other [m], [m/s]
    velocities: FloatArray
    first: IntArray  # (S + 1,), where the points of each set begin
    # (S,), radius of the body about the points [m]; where a set has one point for a body of several, of all of it
    radii: FloatArray
    growth: FloatArray  # (S, 3), g₀ [m], g₁ [m/s], g₂ [m/s²]

    def __len__(self) -> int:
        return len(self.owners)

    @property
    def arrays(self) -> Sets:
        """All arrays, as `safe_ompl.geometry.kernels.gaps` takes them."""
        return Sets(self.owners, self.points, self.velocities, self.first, self.radii, self.growth)

    @classmethod
    def none(cls) -> ReachSets:
        """Return no sets, of no bodies."""
        empty, still = np.zeros((0, 3)), np.zeros(0)
        no: IntArray = np.zeros(0, dtype=np.intp)
        return cls((), no, empty, empty, np.zeros(1, dtype=np.intp), still, empty)

    @classmethod
    def of(
        cls,
        names: tuple[tuple[str, str], ...],
        points: FloatArray,
        radii: FloatArray,
        growth: FloatArray,
        velocities: FloatArray | None = None,
    ) -> ReachSets:
        """Return one set for each of M bodies: hulls of as many `points: (M, K, 3)`, growth (M, 3)."""
        M, K = points.shape[:2]
        flat = np.ascontiguousarray(points.reshape(-1, 3))
        drift = np.zeros_like(flat) if velocities is None else velocities.reshape(-1, 3)
        first: IntArray = K * np.arange(M + 1)
        return cls(names, np.arange(M), flat, np.ascontiguousarray(drift), first, radii, growth)

    def and_also(self, other: ReachSets) -> ReachSets:
        """Return the sets of the same bodies, that are now in those of both."""
        order = np.argsort(np.concatenate([self.owners, other.owners]), kind="stable")
        return self._joined(other, self.names, other.owners, order)

    def beside(self, other: ReachSets) -> ReachSets:
        """Return the sets of these bodies and of others."""
        order = np.arange(len(self) + len(other))
        return self._joined(other, self.names + other.names, other.owners + len(self.names), order)

    def _joined(
        self, other: ReachSets, names: tuple[tuple[str, str], ...], owners: IntArray, order: IntArray
    ) -> ReachSets:
        both = (self, other)
        points, velocities, radii, growth = (
            np.concatenate([getattr(side, name) for side in both])
            for name in ("points", "velocities", "radii", "growth")
        )
        starts = np.concatenate([self.first[:-1], len(self.points) + other.first[:-1]])[order]
        sizes = np.concatenate([np.diff(side.first) for side in both])[order]
        first = np.append(0, np.cumsum(sizes)).astype(np.intp)
        place = np.repeat(starts - first[:-1], sizes) + np.arange(first[-1])
        owners = np.concatenate([self.owners, owners])[order]
        return ReachSets(names, owners, points[place], velocities[place], first, radii[order], growth[order])

    def excess(self, ends: Sequence[FloatArray] | FloatArray, time: float) -> FloatArray:
        """Return for each body how far (M,) its points are beyond its sets after a time, at most; ≤ 0: it obeyed.

        Its points, (K, 3) for each of the M bodies, are `ends` then [m]; the time [s] is since the sets were measured.
        """
        found = np.full(len(self.names), -np.inf)
        for s, owner in enumerate(self.owners.tolist()):
            rows = slice(self.first[s], self.first[s + 1])
            away = np.linalg.norm(ends[owner] - self.points[rows] - time * self.velocities[rows], axis=1)
            g0, g1, g2 = self.growth[s]
            allowed = g0 + time * (g1 + 0.5 * time * g2)
            found[owner] = max(found[owner], float(away.max()) - allowed)
        return found


@dataclass(frozen=True)
class Measured:
    """What is known of the M limbs of a person at one instant."""

    who: str  # The person
    limbs: tuple[str, ...]  # The person's M limbs
    # (M, 2, 3), where the ends of the limbs were when they were last seen [m], and the velocity just before [m/s]
    ends: FloatArray
    velocities: FloatArray
    radii: FloatArray  # (M,), [m]
    ages: FloatArray  # (M,), how long ago the elder of the two ends was seen [s]
    baseline: float  # Time over which velocities were measured [s]; infinite: they were not
    shoulders: FloatArray  # (2, 3), The left and the right one [m]
    shoulder_ages: FloatArray  # (2,), [s]
    height: float  # Of the person [m]
    noise: float = 0.0  # Bound of the errors of measured places [m]

    @property
    def names(self) -> tuple[tuple[str, str], ...]:
        """Person and limb, M times."""
        return tuple((self.who, limb) for limb in self.limbs)


class ReachModel(Protocol):
    """An assumption about how people move; everything that is proven holds *if* it does."""

    def sets(self, person: Measured, people: People) -> ReachSets:
        """Return the sets that the limbs of a person do not leave."""

    def __str__(self) -> str:
        """Return the assumption in a few words."""


@dataclass(frozen=True)
class SpeedReach:
    """No point of a limb is faster than `People.speed_of` it: g(τ) = noise + v·(age + τ)."""

    def __str__(self) -> str:
        return "limbs keep to their speeds"

    def sets(self, person: Measured, people: People) -> ReachSets:
        speeds = np.array([people.speed_of(limb) for limb in person.limbs])
        growth = np.stack([person.noise + speeds * person.ages, speeds, np.zeros_like(speeds)], axis=1)
        return ReachSets.of(person.names, person.ends, person.radii, growth)


@dataclass(frozen=True)
class AccelerationReach:
    """No point of a limb accelerates by more than a bound: p + v̂τ, grown by ½a(age + τ)² + ½aΔ(age + τ).

    v̂ is the mean velocity over the time Δ between the last two measurements, from which the velocity at the last one
    differs by ½aΔ at most; noise of the places counts twice in it. Until there are two, nothing is known.

    Parameters
    ----------
    acceleration : float
        [m/s²]
    """

    acceleration: float = 50.0

    def __post_init__(self) -> None:
        number("acceleration", self.acceleration, above=0.0)

    def __str__(self) -> str:
        return f"limbs accelerate by {self.acceleration:g} m/s² at most"

    def sets(self, person: Measured, people: People) -> ReachSets:
        a, ages, M = self.acceleration, person.ages, len(person.limbs)
        known = np.isfinite(person.baseline)
        drift = 0.5 * a * person.baseline + 2 * person.noise / person.baseline if known else 1e6
        velocities = person.velocities if known else np.zeros_like(person.velocities)
        known_to = person.noise + ages * (drift + 0.5 * a * ages)
        growth = np.stack([known_to, drift + a * ages, np.full(M, a)], axis=1)
        places = person.ends + ages[:, None, None] * velocities
        return ReachSets.of(person.names, places, person.radii, growth, velocities)


@dataclass(frozen=True)
class LimbLengthReach:
    """The length of arms is bounded: each is in a ball about its shoulder, which moves with its own speed.

    It says nothing of other limbs.

    Parameters
    ----------
    longer : float
        How much longer arms may be than those of a mean person of that height.
    """

    longer: float = _LONGER

    def __post_init__(self) -> None:
        if number("longer", self.longer, above=0.0) < 1:
            raise InputError(f"longer must be at least 1, got {self.longer!r}")

    def __str__(self) -> str:
        return "arms are no longer than they are"

    def sets(self, person: Measured, people: People) -> ReachSets:
        M = len(person.limbs)
        middles, growth = person.ends.mean(axis=1, keepdims=True), np.tile([1e6, 0.0, 0.0], (M, 1))
        speed = people.speed_of("shoulders")
        for m, limb in enumerate(person.limbs):
            side, _, part = limb.partition("_")
            if part in _ARM:
                which = ("left", "right").index(side)
                span = self.longer * person.height * _arm(part)
                middles[m] = person.shoulders[which]
                growth[m, :2] = person.noise + span + speed * person.shoulder_ages[which], speed
        return ReachSets.of(person.names, middles, person.radii, growth)


@dataclass(frozen=True)
class IntersectedReach:
    """The intersection of several models: all of them hold."""

    models: tuple[ReachModel, ...]

    def __post_init__(self) -> None:
        if not self.models:
            raise InputError("give one model at least")

    def __str__(self) -> str:
        return "; ".join(map(str, self.models))

    def sets(self, person: Measured, people: People) -> ReachSets:
        first, *others = (model.sets(person, people) for model in self.models)
        for other in others:
            first = first.and_also(other)
        return first


_ARM = ("upper_arm", "forearm", "hand")


def _arm(last: str) -> float:
    """Return the length of an arm from the shoulder to the end of a limb, as a fraction of the height."""
    joints = ("shoulder", "elbow", "wrist", "hand")[: _ARM.index(last) + 2]
    places = [STANDING[f"left_{joint}"] for joint in joints]
    return float(sum(np.linalg.norm(b - a) for a, b in pairwise(places)))
