"""Reach models: where a body that was measured may be some time later, as sets that proofs can take.

A proof sees whatever moves as a `ReachSets`: hulls of points that drift and grow,

    {points + τ·velocities}, grown by radius + g(τ),  g(τ) = the least of some g₀ + g₁τ + ½g₂τ²,

with the time τ since the measurement and g₁, g₂ ≥ 0. A body is in *every* one of its sets, so models are intersected by
listing the sets of all of them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from functools import cached_property
from itertools import pairwise
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from safe_ompl.common import FloatArray, InputError, IntArray, files, number, whole_number
from safe_ompl.common import documents as document
from safe_ompl.geometry import LIMBS, STANDING
from safe_ompl.geometry.kernels import Sets
from safe_ompl.people.skeletons import find_skeleton
from safe_ompl.scene import People

_ROUNDING = 1e-12  # [m]
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
    # (S, L, 3), g₀ [m], g₁ [m/s], g₂ [m/s²] of L polynomials, of which the least counts
    growth: FloatArray

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
        return cls((), no, empty, empty, np.zeros(1, dtype=np.intp), still, np.zeros((0, 1, 3)))

    @classmethod
    def of(
        cls,
        names: tuple[tuple[str, str], ...],
        points: FloatArray,
        radii: FloatArray,
        growth: FloatArray,
        velocities: FloatArray | None = None,
    ) -> ReachSets:
        """Return one set for each of M bodies: hulls of as many `points: (M, K, 3)`, growth (M, 3) or (M, L, 3)."""
        M, K = points.shape[:2]
        flat = np.ascontiguousarray(points.reshape(-1, 3))
        drift = np.zeros_like(flat) if velocities is None else velocities.reshape(-1, 3)
        first: IntArray = K * np.arange(M + 1)
        growth = np.ascontiguousarray(growth.reshape(M, -1, 3))
        return cls(names, np.arange(M), flat, np.ascontiguousarray(drift), first, radii, growth)

    def and_also(self, other: ReachSets) -> ReachSets:
        """Return the sets of the same bodies, that are now in those of both."""
        order = np.argsort(np.concatenate([self.owners, other.owners]), kind="stable")
        return self._joined(other, self.names, other.owners, order)

    def beside(self, other: ReachSets) -> ReachSets:
        """Return the sets of these bodies and of others."""
        if not self.names:
            return other
        order = np.arange(len(self) + len(other))
        return self._joined(other, self.names + other.names, other.owners + len(self.names), order)

    def _joined(
        self, other: ReachSets, names: tuple[tuple[str, str], ...], owners: IntArray, order: IntArray
    ) -> ReachSets:
        both = (self, other)
        points, velocities, radii = (
            np.concatenate([getattr(side, name) for side in both])
            for name in ("points", "velocities", "radii")
        )
        most = max(side.growth.shape[1] for side in both)
        padded = (((0, 0), (0, most - side.growth.shape[1]), (0, 0)) for side in both)
        growth = np.concatenate(
            [np.pad(side.growth, pad, "edge") for side, pad in zip(both, padded, strict=True)]
        )
        starts = np.concatenate([self.first[:-1], len(self.points) + other.first[:-1]])[order]
        sizes = np.concatenate([np.diff(side.first) for side in both])[order]
        first = np.append(0, np.cumsum(sizes)).astype(np.intp)
        place = np.repeat(starts - first[:-1], sizes) + np.arange(first[-1])
        owners = np.concatenate([self.owners, owners])[order]
        return ReachSets(names, owners, points[place], velocities[place], first, radii[order], growth[order])

    def grown(self, time: float) -> FloatArray:
        """Return the growth (S,) of the sets after a time [s], without the radii [m]."""
        g0, g1, g2 = np.moveaxis(self.growth, -1, 0)
        return np.asarray((g0 + time * (g1 + 0.5 * time * g2)).min(axis=1))

    def excess(self, ends: Sequence[FloatArray] | FloatArray, time: float) -> FloatArray:
        """Return for each body how far (M,) its points are beyond its sets after a time, at most; ≤ 0: it obeyed.

        Its points, (K, 3) for each of the M bodies, are `ends` then [m]; the time [s] is since the sets were measured.
        """
        mine = [ends[owner] for owner in self.owners.tolist()]
        counts = np.array([len(points) for points in mine], dtype=np.intp)
        begin = np.cumsum(counts) - counts
        within = np.arange(counts.sum()) - np.repeat(begin, counts)
        single = np.repeat(np.diff(self.first) == 1, counts)
        rows = np.repeat(self.first[:-1], counts) + np.where(single, 0, within)
        away = np.concatenate([np.zeros((0, 3)), *mine]) - (self.points + time * self.velocities)[rows]
        farthest = np.maximum.reduceat(np.sqrt((away * away).sum(axis=1)), begin)
        found = np.full(len(self.names), -np.inf)
        np.maximum.at(found, self.owners, farthest - self.grown(time))
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


@dataclass(frozen=True)
class CalibratedReach:
    """How far limbs went in recordings, as `calibrate` found it: balls about where they were seen last.

    The growth of a limb is the least concave function that is at least its lengths at the horizons and 0 at 0, and
    whose slope is at least the mean one up to the last horizon: that is the speed beyond, where nothing was measured.
    No key point that passes the gate is faster than it, so that growth is never larger than gate · time. A limb
    without lengths keeps to `People.speed_of` it, as in `SpeedReach`.

    Parameters
    ----------
    skeleton : str
        Name of the skeleton of the recordings; a tracker must have the same one.
    gate : float
        The gate that was used; a tracker must have the same one [m/s].
    level : float
        Probability that all of a unit that is exchangeable with the calibrated ones keeps to it; see `calibrate`.
    units : int
        Number of units of the calibration.
    horizons : sequence of float
        Times since the limb was seen, ascending [s].
    growth : mapping of str to sequence of float
        By limb how far its ends are from there at the most at each of the horizons, never falling [m].
    shaped_with, calibrated_with : sequence of str
        Recordings that the shapes come from, and those that the factor comes from.
    block : float, optional
        Length of a unit [s]; default: a unit is a recording.
    refused : float
        Share of the key points that the gate refused.

    Raises
    ------
    InputError
        If a value cannot be used; the message starts with its key.
    """

    skeleton: str
    gate: float
    level: float
    units: int
    horizons: tuple[float, ...]
    growth: Mapping[str, tuple[float, ...]] = field(hash=False)
    shaped_with: tuple[str, ...]
    calibrated_with: tuple[str, ...]
    block: float | None = None
    refused: float = 0.0

    def __post_init__(self) -> None:
        with document.within("skeleton", ": "):
            find_skeleton(self.skeleton)
        if not 0 < document.number("level", self.level) < 1:
            raise InputError(f"must be between 0 and 1, got {self.level!r}", "level")
        document.number("gate", self.gate, above=0.0)
        whole_number("units:", self.units, at_least=1)
        document.number("refused", self.refused, at_least=0.0, at_most=1.0)
        if self.block is not None:
            document.number("block", self.block, above=0.0)
        horizons = ascending(
            "horizons", document.numbers("horizons", self.horizons, above=0.0), strictly=True
        )
        given, growth = document.mapping("growth", self.growth, LIMBS), {}
        for limb, lengths in given.items():
            key = f"growth.{limb}"
            growth[limb] = ascending(key, document.numbers(key, lengths, len(horizons), above=0.0))
        if not growth:
            raise InputError("must have one limb at least", "growth")
        values: dict[str, Any] = {"horizons": horizons, "growth": growth}
        for key in ("shaped_with", "calibrated_with"):
            values[key] = tuple(
                document.text(key, name) for name in document.sequence(key, getattr(self, key))
            )
        for key, value in values.items():
            object.__setattr__(self, key, value)

    def __str__(self) -> str:
        unit = "recordings" if self.block is None else f"blocks of {self.block:g} s"
        return f"limbs go no farther than in {100 * self.level:g} % of the {unit} ({self.units} calibrated)"

    @classmethod
    def load(cls, file: str | Path) -> CalibratedReach:
        """Read a reach file (YAML); an InputError names file, line, key and value of what it cannot use."""
        with document.reading(Path(file)) as data:
            document.check_fields(cls, data)
            return cls(**data)

    def save(self, file: str | Path) -> None:
        """Write the file that `load` reads."""
        files.write(file, document.dump_document(asdict(self)))

    @property
    def limbs(self) -> tuple[str, ...]:
        """The limbs that were calibrated."""
        return tuple(self.growth)

    @cached_property
    def lines(self) -> dict[str, FloatArray]:
        """For each limb the lines (L, 2), value at 0 [m] and slope [m/s], of which the least is its growth."""
        gate = [[0.0, self.gate]]
        found = [np.vstack([concave_lines(self.horizons, g), gate]) for g in self.growth.values()]
        most = max(map(len, found))
        padded = [np.pad(of, ((0, most - len(of)), (0, 0)), "edge") for of in found]
        return dict(zip(self.growth, padded, strict=True))

    def grown(self, limb: str, time: float) -> float:
        """Return how far a limb goes at most in a time [s], from where it was seen [m]."""
        return float((self.lines[limb] @ [1.0, time]).min())

    def lines_of(self, limbs: Sequence[str], people: People) -> FloatArray:
        """Return the lines (M, L, 2) of several limbs, those of limbs without lengths from the speeds of people."""
        count, known = len(next(iter(self.lines.values()))), self.lines
        speeds = {limb: [(0.0, people.speed_of(limb))] * count for limb in limbs if limb not in known}
        return np.array([speeds.get(limb, known.get(limb)) for limb in limbs])

    def sets(self, person: Measured, people: People) -> ReachSets:
        lines = self.lines_of(person.limbs, people)
        known = person.noise + lines[..., 0] + lines[..., 1] * person.ages[:, None]
        growth = np.stack([known, lines[..., 1], np.zeros_like(known)], axis=-1)
        return ReachSets.of(person.names, person.ends, person.radii, growth)


def concave_lines(horizons: Sequence[float], lengths: Sequence[float]) -> FloatArray:
    """Return lines (L, 2), values at 0 [m] and slopes [m/s], whose minimum is the growth of `CalibratedReach`."""
    t, g = np.append(0.0, horizons), np.append(0.0, lengths)
    i, j = np.triu_indices(len(t), 1)
    slopes = (g[j] - g[i]) / (t[j] - t[i])
    starts = g[i] - slopes * t[i]
    last = g[-1] / t[-1]
    kept = (starts[:, None] + slopes[:, None] * t >= g - _ROUNDING).all(axis=1) & (slopes > last)
    return np.vstack([np.column_stack([starts, slopes])[kept], [(g - last * t).max(), last]])


def ascending(key: str, values: tuple[float, ...], strictly: bool = False) -> tuple[float, ...]:
    """Return numbers if there are some and none is smaller than the one before, or else raise InputError."""
    if not values:
        raise InputError("must have one number at least", key)
    for before, after in pairwise(values):
        if after < before or (strictly and after == before):
            raise InputError(
                f"must not fall{' or stay' if strictly else ''}, got {after:g} after {before:g}", key
            )
    return values


_ARM = ("upper_arm", "forearm", "hand")


def _arm(last: str) -> float:
    """Return the length of an arm from the shoulder to the end of a limb, as a fraction of the height."""
    joints = ("shoulder", "elbow", "wrist", "hand")[: _ARM.index(last) + 2]
    places = [STANDING[f"left_{joint}"] for joint in joints]
    return float(sum(np.linalg.norm(b - a) for a, b in pairwise(places)))
