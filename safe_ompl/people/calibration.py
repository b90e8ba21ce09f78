"""How far people go, calibrated with recordings: reach models that hold for a stated share of them.

A *unit* is a recording, or a block of one. Its score is the largest ratio, over all limbs, frames and times up to the
last horizon, of how far a limb is from where it was seen last and a shape: how far it went in that time in recordings
that are set apart. The reach is the shape times a factor: the ⌈(N + 1)·level⌉-th smallest score of N other units
(split-conformal prediction: Papadopoulos et al., ECML 2002; Lei et al., JASA 2018). If a new unit is exchangeable with
these N, then *all* its limbs keep to the reach at *all* times with a probability of `level` at least. Blocks of one
recording resemble each other, so that blocks of further recordings are exchangeable with them only as far as one may
neglect that; they may be as short as a frame: `level` then is a share of the time. For other people, or for other work,
nothing is guaranteed: what holds there has to be measured. Shapes depend on how fast the fastest limb just was.

Windows are those of the tracker itself, with its gate and the ages of what it does not see; where a limb truly is, is
where `without_glitches` has it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import ceil, floor

import numpy as np
from numpy.typing import ArrayLike

from safe_ompl.common import FloatArray, InputError, fraction, number
from safe_ompl.people.reach import CalibratedReach, concave_lines, stacked
from safe_ompl.people.skeletons import KEYPOINTS, UPRIGHT, Recording, Skeleton, TrackedBody
from safe_ompl.people.tracking import PersonTrack, Tracker, without_glitches
from safe_ompl.scene import People

HORIZONS = (0.05, 0.1, 0.2, 0.3, 0.5)  # [s] at which the shapes have corners
GATE = 4.0  # [m/s]
SPEEDS = (0.05, 0.15, 0.3, 0.6, 1.2)  # [m/s] where states begin, see `CalibratedReach`
_FIT = (0.1, 0.2)  # of the recordings, drawn from their names, give the shapes; the factor comes from the others
_MOST = 0.95  # of the windows in which limbs go no farther than their shape
_LEAST = 0.005  # [m] shapes are no smaller: recordings in which a limb stands still say nothing of its errors
_SAME = 1e-9  # [s] or relative


@dataclass(frozen=True)
class Windows:
    """How far limbs went in a recording of T frames, up to K frames after each of them."""

    limbs: tuple[str, ...]  # The M limbs whose place the key points say; the tracker assumes the others
    moved: FloatArray  # (T, K, M), how far a limb is from where it was seen last [m]; NaN beyond the end
    times: FloatArray  # (T, K, M), how long ago it was seen there [s]
    speeds: FloatArray  # (T,), of the fastest limb, see `PersonTrack.speed` [m/s]
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
        track, seen, speeds = PersonTrack(recording.source, tracker, People()), [], []
        for k, points in enumerate(recording.frames):
            track.observe(points, k / recording.rate)
            seen.append(track.measured())
            speeds.append(track.speed)
        ends = np.array([body.ends(points) for points in truly])
        before, ages = map(np.array, zip(*seen, strict=True))
        K = floor(longest * recording.rate + _SAME)
        moved = np.full((len(ends), K, len(body.limbs)), np.nan)
        for k in range(1, min(K + 1, len(ends))):
            moved[:-k, k - 1] = np.linalg.norm(ends[k:] - before[:-k], axis=3).max(axis=2)
        times = ages[:, None] + np.arange(1, K + 1)[None, :, None] / recording.rate
        return cls(body.limbs, moved, times, np.array(speeds), recording.rate, counted.seen, counted.refused)

    def longest(self, horizons: Sequence[float]) -> FloatArray:
        """Return how far (T, M, H) the limbs went at most within each of the horizons [m]; 0 where nothing was seen."""
        within = [np.where(self.times <= h + _SAME, self.moved, 0.0) for h in horizons]
        return np.stack([np.nanmax(moved, axis=1, initial=0.0) for moved in within], axis=2)

    def ratios(self, lines: Sequence[FloatArray], edges: Sequence[float] = ()) -> FloatArray:
        """Return for every window (T, K) the largest ratio of what a limb moved and its growth; 0 where there is none.

        The growth are for each of the M limbs lines (S, L, 2) in the states that the edges (S − 1,) part [m/s].
        """
        found, states = np.zeros(self.moved.shape[:2]), np.searchsorted(edges, self.speeds, side="right")
        for m, of in enumerate(lines):
            now = of[states]  # (T, L, 2)
            allowed = (now[:, None, :, 0] + now[:, None, :, 1] * self.times[..., m, None]).min(axis=2)
            found = np.fmax(found, self.moved[..., m] / allowed)
        return found


def measured_limbs(skeleton: Skeleton) -> tuple[str, ...]:
    """Return the limbs whose ends follow from what a skeleton sees; the others stand as `TrackedBody` assumes."""
    body = TrackedBody(height=1.0)
    known = np.array([name in skeleton.sources for name in KEYPOINTS])
    points, rests = body.completed(np.where(known[:, None], UPRIGHT, np.nan))
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


def calibrate(
    recordings: Sequence[Recording], level: float, *, gate: float = GATE, block: float | None = None
) -> CalibratedReach:
    """Return the reach that a share `level` of units like those of the recordings keeps to.

    Key points that are faster than the gate [m/s] are not seen. Units are recordings, or blocks of so many seconds:
    what is left of a recording then belongs to its last block.

    Raises InputError if a value is out of its range; if the recordings are fewer than two, of several skeletons, or
    have too few frames; if there are too few units for the level.
    """
    if not 0 < fraction("level", level) < 1:
        raise InputError(f"level must be between 0 and 1, got {level!r}")
    number("gate", gate, above=0.0)
    if block is not None:
        number("block", block, above=0.0)
    if len(recordings) < 2:
        raise InputError(f"needs two recordings at least, got {len(recordings)}", "recordings")
    ordered = sorted(recordings, key=lambda recording: recording.source)
    skeleton = ordered[0].skeleton
    for recording in ordered:
        if recording.skeleton != skeleton:
            names = f"{recording.skeleton.name!r}, that of {ordered[0].source} is {skeleton.name!r}"
            raise InputError(f"the skeleton is {names}", recording.source)
        if HORIZONS[0] < 1 / recording.rate - _SAME:
            least = f"{1 / HORIZONS[0]:g} frames per second"
            raise InputError(f"must have {least} at least, got {recording.rate:g}", recording.source)
    windows = {recording.source: Windows.of(recording, HORIZONS[-1], gate) for recording in ordered}
    sources = [recording.source for recording in ordered]
    drawn = np.random.default_rng(0).permutation(len(ordered))[: _shaping(len(ordered), level, block)]
    fit = sorted(sources[k] for k in drawn)
    rest = [source for source in sources if source not in fit]
    shapes = _shapes([windows[source] for source in fit])
    lines = [stacked([concave_lines(HORIZONS, of) for of in shape.tolist()]) for shape in shapes.values()]
    ratios = ((w.ratios(lines, SPEEDS), w.rate) for w in (windows[source] for source in rest))
    scores = [score for found, rate in ratios for score in _scores(found, rate, block)]
    factor = conformal_quantile(scores, level)
    return CalibratedReach(
        skeleton=skeleton.name,
        gate=gate,
        level=level,
        units=len(scores),
        horizons=HORIZONS,
        speeds=SPEEDS,
        growth={limb: tuple(tuple(of) for of in (factor * shape).tolist()) for limb, shape in shapes.items()},
        shaped_with=tuple(fit),
        calibrated_with=tuple(rest),
        block=block,
        refused=sum(w.refused for w in windows.values()) / max(1, sum(w.seen for w in windows.values())),
    )


def _shaping(recordings: int, level: float, block: float | None) -> int:
    """Return how many recordings give the shapes: a fifth, or as many fewer as the level needs for units."""
    least, most = ceil(_FIT[0] * recordings), ceil(_FIT[1] * recordings)
    needed = 0 if block is not None else ceil(level / (1 - level) * (1 - _SAME))
    return max(least, min(most, recordings - needed))


def _shapes(windows: Sequence[Windows]) -> dict[str, FloatArray]:
    """Return how far (S, H) limbs went in the states in most windows, the same for both sides of the body [m].

    Faster people go no less far.
    """
    limbs = windows[0].limbs
    other = {"left": "right", "right": "left"}
    mirrored = [limbs.index("_".join(other.get(part, part) for part in limb.split("_"))) for limb in limbs]
    went = np.concatenate([w.longest(HORIZONS) for w in windows])
    states = np.searchsorted(SPEEDS, np.concatenate([w.speeds for w in windows]), side="right")
    most = np.full((len(SPEEDS) + 1, *went.shape[1:]), _LEAST)
    for state in np.unique(states):
        both = np.concatenate([went[states == state], went[states == state][:, mirrored]])
        most[state] = np.maximum(np.quantile(both, _MOST, axis=0), _LEAST)
    most = np.maximum.accumulate(most, axis=0)
    return dict(zip(limbs, np.swapaxes(most, 0, 1), strict=True))


def _scores(ratios: FloatArray, rate: float, block: float | None) -> list[float]:
    """Return the scores of the units of a recording, whose windows (T, K) belong to the unit in which they begin."""
    count = 1 if block is None else max(1, floor(len(ratios) / rate / block + _SAME))
    size = len(ratios) if block is None else round(block * rate)
    ends = [k * size for k in range(1, count)]
    return [float(part.max()) for part in np.split(ratios, ends)]
