"""How far people go, calibrated with recordings: reach models that hold for a stated share of them.

A *unit* is a recording, or a block of one. Its score is the largest ratio, over all limbs, frames and times up to the
last horizon, of how far a limb is from where it was seen last and a shape: how far it went in that time in recordings
that are set apart. The reach is the shape times a factor: the ⌈(N + 1)·level⌉-th smallest score of N other units
(split-conformal prediction: Papadopoulos et al., ECML 2002; Lei et al., JASA 2018). If a new unit is exchangeable with
these N, then *all* its limbs keep to the reach at *all* times with a probability of `level` at least. Blocks of one
recording resemble each other, so that blocks of further recordings are exchangeable with them only as far as one may
neglect that. For other people, or for other work, nothing is guaranteed: what holds there has to be measured.

Windows are those of the tracker itself, with its gate and the ages of what it does not see; where a limb truly is, is
where `without_glitches` has it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import ceil, floor

import numpy as np
from numpy.typing import ArrayLike

from safe_ompl.common import FloatArray, InputError, fraction, number, whole_number
from safe_ompl.common import documents as document
from safe_ompl.geometry import STANDING
from safe_ompl.people.reach import CalibratedReach, ascending, concave_lines
from safe_ompl.people.skeletons import KEYPOINTS, Recording, Skeleton, TrackedBody
from safe_ompl.people.tracking import PersonTrack, Tracker, without_glitches
from safe_ompl.scene import People

HORIZONS = (0.05, 0.1, 0.2, 0.3, 0.5)  # [s]
GATE = 4.0  # [m/s]
_LEAST = 0.005  # [m] shapes are no smaller: recordings in which a limb stands still say nothing of its errors
_SAME = 1e-9  # [s] or relative


@dataclass(frozen=True)
class Windows:
    """How far limbs went in a recording of T frames, up to K frames after each of them."""

    limbs: tuple[str, ...]  # The M limbs whose place the key points say; the tracker assumes the others
    moved: FloatArray  # (T, K, M), how far a limb is from where it was seen last [m]; NaN beyond the end
    times: FloatArray  # (T, K, M), how long ago it was seen there [s]
    rate: float  # Frames per second
    seen: int  # Numbers of key points that were shown to the gate, and that it refused
    refused: int

    @classmethod
    def of(cls, recording: Recording, longest: float, gate: float | None, *, glitches: bool = False) -> Windows:
        """Return the windows up to a time [s] of a tracker with a gate [m/s]; with glitches if these are true."""
        body = TrackedBody(only=measured_limbs(recording.skeleton))
        tracker = Tracker(recording.skeleton, body, gate=gate)
        true, counted = without_glitches(recording, tracker)
        frames = recording.frames if glitches else true.frames
        truly = np.array([body.completed(true.skeleton.keypoints(points))[0] for points in frames])
        track, seen = PersonTrack(recording.source, tracker, People()), []
        for k, points in enumerate(recording.frames):
            track.observe(points, k / recording.rate)
            seen.append(track.measured())
        ends = np.array([body.ends(points) for points in truly])
        before, ages = map(np.array, zip(*seen, strict=True))
        K = floor(longest * recording.rate + _SAME)
        moved = np.full((len(ends), K, len(body.limbs)), np.nan)
        for k in range(1, min(K + 1, len(ends))):
            moved[:-k, k - 1] = np.linalg.norm(ends[k:] - before[:-k], axis=3).max(axis=2)
        times = ages[:, None] + np.arange(1, K + 1)[None, :, None] / recording.rate
        return cls(body.limbs, moved, times, recording.rate, counted.seen, counted.refused)

    def longest(self, horizons: Sequence[float]) -> FloatArray:
        """Return how far (M, H) the limbs went at most within each of the horizons [m]."""
        within = [np.where(self.times <= h + _SAME, self.moved, 0.0) for h in horizons]
        return np.stack([np.nanmax(moved, axis=(0, 1), initial=0.0) for moved in within], axis=1)

    def ratios(self, lines: Sequence[FloatArray]) -> FloatArray:
        """Return for every window (T, K) the largest ratio of what a limb moved and its growth, M times (L, 2) lines.

        0 where there is none.
        """
        found = np.zeros(self.moved.shape[:2])
        for m, of in enumerate(lines):
            allowed = np.min([start + slope * self.times[..., m] for start, slope in of], axis=0)
            found = np.fmax(found, self.moved[..., m] / allowed)
        return found


def measured_limbs(skeleton: Skeleton) -> tuple[str, ...]:
    """Return the limbs whose ends follow from what a skeleton sees; the others stand as `TrackedBody` assumes."""
    body = TrackedBody(height=1.0)
    standing = np.array([STANDING[name] for name in KEYPOINTS[:-1]] + [np.zeros(3)])
    standing[-1] = body.pelvis(standing)
    known = np.array([name in skeleton.sources for name in KEYPOINTS])
    points, rests = body.completed(np.where(known[:, None], standing, np.nan))
    assumed = np.linalg.norm(body.ends(points - points[rests]), axis=2).max(axis=1)
    return tuple(limb for limb, away in zip(body.limbs, assumed, strict=True) if away < _SAME)


def conformal_quantile(scores: ArrayLike, level: float) -> float:
    """Return the ⌈(N + 1)·level⌉-th smallest of N scores; raise InputError if that is more than N."""
    ordered = np.sort(np.asarray(scores, dtype=np.float64))
    N = len(ordered)
    rank = ceil((N + 1) * level * (1 - _SAME))
    if rank > N:
        highest = floor(1e4 * N / (N + 1)) / 1e4
        raise InputError(
            f"{level:g} needs more than the {N} units that there are: they allow {highest:g} at most", "level"
        )
    return float(ordered[rank - 1])


@dataclass(frozen=True)
class Calibration:
    """How reach is calibrated; raises InputError if a value is out of its range."""

    level: float  # Share of the units that are to keep to it
    gate: float = GATE  # Key points that are faster are not seen [m/s]
    horizons: tuple[float, ...] = HORIZONS  # Times at which the shapes have corners [s]
    # Share of the recordings, rounded up, that the shapes come from; the factor comes from the others. The seed draws
    # them from all, which are ordered by name.
    fit: float = 0.1
    seed: int = 0
    # Length of units [s]: recordings are cut, and what is left of one belongs to its last block; default: a recording
    block: float | None = None

    def __post_init__(self) -> None:
        for name in ("level", "fit"):
            if not 0 < fraction(name, getattr(self, name)) < 1:
                raise InputError(f"{name} must be between 0 and 1, got {getattr(self, name)!r}")
        number("gate", self.gate, above=0.0)
        ascending("horizons", document.numbers("horizons", self.horizons, above=0.0), strictly=True)
        whole_number("seed", self.seed, at_least=0)
        if self.block is not None:
            number("block", self.block, above=0.0)


def calibrate(recordings: Sequence[Recording], options: Calibration) -> CalibratedReach:
    """Return the reach that a share `options.level` of units like those of the recordings keeps to.

    Raises InputError if the recordings are fewer than two, or of several skeletons; if the first horizon is shorter
    than a frame; if there are too few units for the level.
    """
    if len(recordings) < 2:
        raise InputError(f"needs two recordings at least, got {len(recordings)}", "recordings")
    ordered = sorted(recordings, key=lambda recording: recording.source)
    skeleton, horizons = ordered[0].skeleton, options.horizons
    for recording in ordered:
        if recording.skeleton != skeleton:
            names = f"{recording.skeleton.name!r}, that of {ordered[0].source} is {skeleton.name!r}"
            raise InputError(f"the skeleton is {names}", recording.source)
        if horizons[0] < 1 / recording.rate - _SAME:
            frame = f"a frame of {recording.source} ({1 / recording.rate:g} s)"
            raise InputError(f"the first one must not be shorter than {frame}, got {horizons[0]:g}", "horizons")
    windows = [Windows.of(recording, horizons[-1], options.gate) for recording in ordered]
    chosen = np.random.default_rng(options.seed).permutation(len(ordered))[: ceil(options.fit * len(ordered))]
    fit = [k in chosen for k in range(len(ordered))]
    shapes = _shapes([w for w, used in zip(windows, fit, strict=True) if used], horizons)
    lines = [concave_lines(horizons, shape.tolist()) for shape in shapes.values()]
    scores = [
        score
        for w, used in zip(windows, fit, strict=True)
        if not used
        for score in _scores(w.ratios(lines), w.rate, options.block)
    ]
    factor = conformal_quantile(scores, options.level)
    return CalibratedReach(
        skeleton.name,
        options.gate,
        options.level,
        len(scores),
        horizons,
        {limb: tuple((factor * shape).tolist()) for limb, shape in shapes.items()},
        tuple(r.source for r, used in zip(ordered, fit, strict=True) if used),
        tuple(r.source for r, used in zip(ordered, fit, strict=True) if not used),
        options.block,
        sum(w.refused for w in windows) / max(1, sum(w.seen for w in windows)),
    )


def _shapes(windows: Sequence[Windows], horizons: Sequence[float]) -> dict[str, FloatArray]:
    """Return how far (H,) limbs went at most, the same for both sides of the body [m]."""
    limbs = windows[0].limbs
    most = np.maximum(np.max([w.longest(horizons) for w in windows], axis=0), _LEAST)
    other = {"left": "right", "right": "left"}
    mirrored = [limbs.index("_".join(other.get(part, part) for part in limb.split("_"))) for limb in limbs]
    return dict(zip(limbs, np.maximum(most, most[mirrored]), strict=True))


def _scores(ratios: FloatArray, rate: float, block: float | None) -> list[float]:
    """Return the scores of the units of a recording, whose windows (T, K) belong to the unit in which they begin."""
    count = 1 if block is None else max(1, floor(len(ratios) / rate / block + _SAME))
    size = len(ratios) if block is None else round(block * rate)
    ends = [k * size for k in range(1, count)]
    return [float(part.max()) for part in np.split(ratios, ends)]
