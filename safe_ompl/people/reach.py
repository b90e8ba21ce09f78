"""Reach models: where a body that was measured may be some time later, as sets that proofs can take.

A proof sees whatever moves as a set for each of its bodies: a hull of points that grows with the time τ since the
measurement,

    {points}, grown by radius + g(τ),  g(τ) = the least of some lines g₀ + g₁τ,  g₁ ≥ 0.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from pathlib import Path

import numpy as np

from safe_ompl.common import FloatArray, InputError, IntArray, Section, documents as document, files, key
from safe_ompl.geometry import LIMBS
from safe_ompl.people.kernels import Sets
from safe_ompl.people.skeletons import find_skeleton
from safe_ompl.scene import People

_ROUNDING = 1e-12  # [m]
_FINEST = 0.01  # [m] edge of the smallest cells


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
    """Return the lines (M, L, 2) of M limbs: of a calibrated reach those that it has, of others their speeds."""
    known = {} if reach is None else reach.lines
    count = len(next(iter(known.values()), [0]))
    speeds = {limb: [(0.0, people.speed_of(limb))] * count for limb in limbs if limb not in known}
    return np.array([speeds.get(limb, known.get(limb)) for limb in limbs], dtype=float)


@dataclass(frozen=True)
class CalibratedReach(Section):
    """How far limbs went in recordings, as `calibrate` found it: balls about where they were seen last.

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
    # By limb how far its ends are from there at the most at each of the horizons, never falling [m]
    growth: Mapping[str, tuple[float, ...]] = key(
        document.by_name, read=document.numbers, known=LIMBS, least="limb", above=0.0
    )
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
        for limb, lengths in self.growth.items():
            if len(lengths) != len(self.horizons):
                raise InputError(f"must be {len(self.horizons)} numbers, got {len(lengths)}", f"growth.{limb}")
            _ascending(f"growth.{limb}", lengths)

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
        """For each limb the lines (L, 2), value at 0 [m] and slope [m/s], of which the least is its growth."""
        gate = [[0.0, self.gate]]
        found = [np.vstack([concave_lines(self.horizons, g), gate]) for g in self.growth.values()]
        most = max(map(len, found))
        padded = [np.pad(of, ((0, most - len(of)), (0, 0)), "edge") for of in found]
        return dict(zip(self.growth, padded, strict=True))

    def grown(self, limb: str, time: float) -> float:
        """Return how far a limb goes at most in a time [s], from where it was seen [m]."""
        return float((self.lines[limb] @ [1.0, time]).min())


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
