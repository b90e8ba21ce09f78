"""Reach models: where a body that was measured may be some time later, as sets that proofs can take.

A proof sees whatever moves as a set for each of its bodies: a hull of points that grows with the time τ since the
measurement,

    {points}, grown by radius + g(τ),  g(τ) = the least of some lines g₀ + g₁τ,  g₁ ≥ 0.
"""

from __future__ import annotations

from bisect import bisect
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from itertools import pairwise
from math import inf
from pathlib import Path
from typing import NamedTuple

import numpy as np

from safe_ompl.common import FloatArray, InputError, IntArray, Section, documents as document, files, key
from safe_ompl.geometry import LIMBS
from safe_ompl.people.kernels import Sets
from safe_ompl.people.skeletons import find_skeleton
from safe_ompl.scene import People

_ROUNDING = 1e-12  # [m]
_FINEST = 0.01  # [m] edge of the smallest cells


class ReachViolation(NamedTuple):
    """A body that moved farther than was promised."""

    who: str  # The person or object, and its limb; the limb of an object is empty
    limb: str
    excess: float  # How far it was beyond what its reach allows [m]

    def __str__(self) -> str:
        limb = f" ({self.limb})" if self.limb else ""
        return f"{self.who!r}{limb} moved {1e3 * self.excess:.0f} mm farther than promised"


@dataclass(frozen=True)
class ReachSets:
    """Sets that M bodies do not leave; a body is a limb of a person, or a part of an object."""

    # The person or object and the limb that each of the M bodies is; the limb of an object is empty
    names: tuple[tuple[str, str], ...]
    points: FloatArray  # (P, 3), of all bodies, one after the other [m]
    first: IntArray  # (M + 1,), where the points of each body begin
    radii: FloatArray  # (M,), of the bodies about their points [m]
    growth: FloatArray  # (M, L, 2), g₀ [m] and g₁ [m/s] of L lines, of which the least counts

    @property
    def arrays(self) -> Sets:
        """All arrays, as `safe_ompl.people.kernels.gaps` takes them."""
        return Sets(self.points, self.first, self.radii, self.growth)

    @classmethod
    def none(cls) -> ReachSets:
        """Return no sets, of no bodies."""
        return cls((), np.zeros((0, 3)), np.zeros(1, dtype=np.intp), np.zeros(0), np.zeros((0, 1, 2)))

    @classmethod
    def of(
        cls, names: tuple[tuple[str, str], ...], points: FloatArray, radii: FloatArray, growth: FloatArray
    ) -> ReachSets:
        """Return the sets of M bodies with as many `points: (M, K, 3)` each, growth (M, L, 2)."""
        first: IntArray = points.shape[1] * np.arange(len(points) + 1)
        return cls(names, np.ascontiguousarray(points.reshape(-1, 3)), first, radii, growth)

    def beside(self, other: ReachSets) -> ReachSets:
        """Return the sets of these bodies and of others."""
        if not self.names:
            return other
        both = (self, other)
        most = max(side.growth.shape[1] for side in both)
        growth = [np.pad(s.growth, ((0, 0), (0, most - s.growth.shape[1]), (0, 0)), "edge") for s in both]
        return ReachSets(
            self.names + other.names,
            np.concatenate([self.points, other.points]),
            np.concatenate([self.first[:-1], len(self.points) + other.first]),
            np.concatenate([self.radii, other.radii]),
            np.concatenate(growth),
        )

    def grown(self, time: float) -> FloatArray:
        """Return the growth (M,) of the sets after a time [s], without the radii [m]."""
        return np.asarray((self.growth[..., 0] + time * self.growth[..., 1]).min(axis=1))

    def excess(self, ends: Sequence[FloatArray] | FloatArray, time: float) -> FloatArray:
        """Return for each body how far (M,) its points are beyond its set after a time, at most; ≤ 0: it obeyed.

        Its points, as many as it has in its set, are `ends` then [m]; the time [s] is since the sets were measured.
        """
        away = np.linalg.norm(np.concatenate([np.zeros((0, 3)), *ends]) - self.points, axis=1)
        farthest = np.maximum.reduceat(away, self.first[:-1]) if self.names else np.zeros(0)
        return np.asarray(farthest - self.grown(time))


def ball_cover(points: FloatArray, most: int) -> tuple[FloatArray, float]:
    """Return at most so many balls, centres (M, 3) and one radius [m], that hold points (N, 3): cells of a grid."""
    edge, cells = _FINEST, np.floor(points / _FINEST).astype(np.int64)
    while True:
        low, extent = cells.min(axis=0), np.ptp(cells, axis=0) + 1
        flat = np.unique(np.ravel_multi_index(tuple((cells - low).T), tuple(extent)))
        cells = np.column_stack(np.unravel_index(flat, tuple(extent))) + low
        if len(cells) <= most:
            return (cells + 0.5) * edge, float(np.sqrt(0.75) * edge)
        edge, cells = 2 * edge, cells // 2


def limb_lines(limbs: Sequence[str], people: People, reach: CalibratedReach | None = None) -> FloatArray:
    """Return the lines (S, M, L, 2) of M limbs in S states: of a reach those that it has, of others their speeds."""
    known = {} if reach is None else reach.lines
    shape = next(iter(known.values()), np.zeros((1, 1, 2))).shape
    speeds = {limb: np.broadcast_to([0.0, people.speed_of(limb)], shape) for limb in limbs}
    return np.stack([{**speeds, **known}[limb] for limb in limbs], axis=1)


_STATES = partial(document.each, read=partial(document.numbers, above=0.0))


@dataclass(frozen=True)
class CalibratedReach(Section):
    """How far limbs went in recordings, as `calibrate` found it: balls about where they were seen last.

    They depend on the *state* of a person: how fast the fastest of the calibrated limbs was over the last 0.1 s. Who
    stands still does not go as far in the next tenths of a second as who moves already.

    The growth of a limb is the least concave function that is at least its lengths at the horizons and 0 at 0, and
    whose slope is at least the mean one up to the last horizon: that is the speed beyond, where nothing was measured.
    No key point that passes the gate is faster than it, so that growth is never larger than gate · time. A limb
    without lengths keeps to `People.speed_of` it.

    Raises InputError if a value cannot be used; the message starts with its key.
    """

    skeleton: str = key(document.text)  # Of the recordings; a tracker must have the same one
    gate: float = key(document.number, above=0.0)  # That was used; a tracker must have the same one [m/s]
    # Probability that all of a unit that is exchangeable with the calibrated ones keeps to it; see `calibrate`
    level: float = key(document.number)
    units: int = key(document.whole_number, at_least=1)  # Of the calibration
    horizons: tuple[float, ...] = key(document.numbers, above=0.0)  # Times since the limb was seen, ascending [s]
    # Where states begin beyond the first, ascending: speeds of the fastest limb [m/s]; where it is not known, it is
    # the last state
    speeds: tuple[float, ...] = key(document.numbers, above=0.0)
    # By limb and state how far its ends are from there at the most at each of the horizons, never falling [m]
    growth: Mapping[str, tuple[tuple[float, ...], ...]] = key(document.by_name, read=_STATES, known=LIMBS, least="limb")
    # Recordings that the shapes come from, and those that the factor comes from
    shaped_with: tuple[str, ...] = key(document.each, read=document.text)
    calibrated_with: tuple[str, ...] = key(document.each, read=document.text)
    block: float | None = key(document.number, default=None, above=0.0)  # Of a unit [s]; None: it is a recording
    refused: float = key(
        document.number, default=0.0, at_least=0.0, at_most=1.0
    )  # Share of the key points, by the gate

    def check(self) -> None:
        """Raise InputError unless the values fit together."""
        with document.within("skeleton", ": "):
            find_skeleton(self.skeleton)
        if not 0 < self.level < 1:
            raise InputError(f"must be between 0 and 1, got {self.level!r}", "level")
        _ascending("horizons", self.horizons, strictly=True)
        _ascending("speeds", (0.0, *self.speeds), strictly=True)
        for limb, states in self.growth.items():
            if len(states) != len(self.speeds) + 1:
                raise InputError(f"must have {len(self.speeds) + 1} states, got {len(states)}", f"growth.{limb}")
            for k, lengths in enumerate(states):
                place = f"growth.{limb}[{k}]"
                if len(lengths) != len(self.horizons):
                    raise InputError(f"must be {len(self.horizons)} numbers, got {len(lengths)}", place)
                _ascending(place, lengths)

    def __str__(self) -> str:
        unit = "recordings" if self.block is None else f"blocks of {self.block:g} s"
        return f"limbs go no farther than in {100 * self.level:g} % of the {unit} ({self.units} calibrated)"

    @classmethod
    def load(cls, file: str | Path) -> CalibratedReach:
        """Read a reach file (YAML); an InputError names file, line, key and value of what it cannot use."""
        with files.reading(Path(file)) as data:
            return cls.from_mapping(data)

    def save(self, file: str | Path) -> None:
        """Write the file that `load` reads."""
        files.write(file, files.dump_document(self.to_mapping()))

    @property
    def limbs(self) -> tuple[str, ...]:
        """The limbs that were calibrated."""
        return tuple(self.growth)

    @cached_property
    def lines(self) -> dict[str, FloatArray]:
        """For each limb the lines (S, L, 2) in S states, value at 0 [m] and slope [m/s], of which the least counts."""
        gate = [[0.0, self.gate]]
        found = {
            limb: [np.vstack([concave_lines(self.horizons, lengths), gate]) for lengths in states]
            for limb, states in self.growth.items()
        }
        most = max(len(lines) for states in found.values() for lines in states)
        return {limb: stacked(states, most) for limb, states in found.items()}

    def state(self, speed: float) -> int:
        """Return the state of who is so fast [m/s]."""
        return bisect(self.speeds, speed)

    def grown(self, limb: str, time: float, speed: float = inf) -> float:
        """Return how far a limb goes at most in a time [s], from where it was seen, of who is so fast [m]."""
        return float((self.lines[limb][self.state(speed)] @ [1.0, time]).min())


def stacked(lines: Sequence[FloatArray], most: int = 0) -> FloatArray:
    """Return S times some lines (K, 2) as (S, L, 2), with L of `most` at least: the last ones repeat."""
    most = max([most, *map(len, lines)])
    return np.stack([np.pad(of, ((0, most - len(of)), (0, 0)), "edge") for of in lines])


def concave_lines(horizons: Sequence[float], lengths: Sequence[float]) -> FloatArray:
    """Return lines (L, 2), values at 0 [m] and slopes [m/s], whose minimum is the growth of `CalibratedReach`."""
    t, g = np.append(0.0, horizons), np.append(0.0, lengths)
    i, j = np.triu_indices(len(t), 1)
    slopes = (g[j] - g[i]) / (t[j] - t[i])
    starts = g[i] - slopes * t[i]
    last = g[-1] / t[-1]
    kept = (starts[:, None] + slopes[:, None] * t >= g - _ROUNDING).all(axis=1) & (slopes > last)
    return np.vstack([np.column_stack([starts, slopes])[kept], [(g - last * t).max(), last]])


def _ascending(key: str, values: tuple[float, ...], strictly: bool = False) -> None:
    """Raise InputError unless there are numbers, and none is smaller than the one before."""
    if not values:
        raise InputError("must have one number at least", key)
    for before, after in pairwise(values):
        if after < before or (strictly and after == before):
            raise InputError(f"must not fall{' or stay' if strictly else ''}, got {after:g} after {before:g}", key)
