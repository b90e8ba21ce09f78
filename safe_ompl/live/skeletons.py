"""Key points of people: skeletons of trackers, recordings of key points, and the limbs of a body between them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from safe_ompl.common import BoolArray, FloatArray, InputError, IntArray, UnknownNameError, files, float_array, number
from safe_ompl.geometry import LIMBS, STANDING

# The key points of the package's body model: those of `STANDING`, and the middle of the hips.
KEYPOINTS: tuple[str, ...] = (*STANDING, "pelvis")

_Z_UP = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))


@dataclass(frozen=True)
class Skeleton:
    """The key points of one tracker, and their relation to the key points of this package."""

    name: str  # Such as "coco17"
    # The J key points, in the tracker's order.
    points: tuple[str, ...]
    # Maps a key point of `KEYPOINTS` to the tracker's points whose mean it is. The tracker does not see the others.
    sources: Mapping[str, tuple[str, ...]] = field(hash=False)
    # The length of the tracker's unit [m].
    scale: float = 1.0
    # The tracker's axes in a frame with x forward, y left, z up: the rows are x, y, z.
    axes: tuple[tuple[float, ...], ...] = _Z_UP

    def keypoints(self, points: ArrayLike) -> FloatArray:
        """Convert the tracker's points to key points (18, 3) [m], x forward, y left, z up, in the order of `KEYPOINTS`.

        `points: (J, 3)` are in the tracker's unit and axes; NaN: not seen. Raises InputError for another shape, or if a
        key point is infinite or has NaN in some coordinates only.
        """
        given = float_array(points, (len(self.points), 3), f"key points of {self.name}")
        seen = np.isfinite(given).all(axis=1)
        for j in np.flatnonzero(~seen & ~np.isnan(given).all(axis=1)):
            raise InputError(
                f"key point {self.points[j]!r} of {self.name} must be finite, or NaN where it is not seen, "
                f"got {given[j].tolist()}"
            )
        metres = self.scale * given @ np.array(self.axes).T
        found = np.full((len(KEYPOINTS), 3), np.nan)
        for k, rows in self._rows:
            found[k] = metres[rows].mean(axis=1)
        return found

    @cached_property
    def _rows(self) -> list[tuple[IntArray, IntArray]]:
        """For each number S: indices of key points (K,), and of the S tracker's points (K, S) whose mean each is."""
        rows = [
            (k, [self.points.index(source) for source in self.sources[name]])
            for k, name in enumerate(KEYPOINTS)
            if name in self.sources
        ]
        same = [[row for row in rows if len(row[1]) == count] for count in {len(row[1]) for row in rows}]
        return [(np.array([k for k, _ in group]), np.array([of for _, of in group])) for group in same]


def _read(name: str, definition: Mapping[str, Any]) -> Skeleton:
    """Return the skeleton of an entry of `skeletons.yaml`; ``{side}`` stands for left and right."""
    sources = {ours: tuple(theirs) for ours, theirs in definition["sources"].items()}
    for ours, theirs in definition["both_sides"].items():
        sources |= {f"{side}_{ours}": (theirs.format(side=side),) for side in ("left", "right")}
    axes = tuple(map(tuple, definition.get("axes", _Z_UP)))
    return Skeleton(name, tuple(definition["points"].split()), sources, definition.get("scale", 1.0), axes)


with files.reading(Path(__file__).with_suffix(".yaml")) as _known:
    SKELETONS: dict[str, Skeleton] = {name: _read(name, definition) for name, definition in _known["skeletons"].items()}


def find_skeleton(name: str) -> Skeleton:
    """Return the skeleton of this name, or raise UnknownNameError, which lists the known skeletons."""
    try:
        return SKELETONS[name]
    except (KeyError, TypeError):
        raise UnknownNameError("skeleton", name, SKELETONS) from None


def skeleton_of(points: Sequence[str]) -> Skeleton:
    """Return the skeleton with these key points in this order, or raise InputError."""
    for skeleton in SKELETONS.values():
        if skeleton.points == tuple(points):
            return skeleton
    known = ", ".join(f"{s.name} ({len(s.points)})" for s in SKELETONS.values())
    raise InputError(f"no skeleton has the {len(points)} key points {', '.join(points)}; known: {known}")


# ------------------------------------------------------------------------------------------------ the limbs of a body


HEIGHT = 1.75  # [m]
# The share of the way from the shoulders to the pelvis, as in `safe_ompl.geometry.person`.
_CHEST = 0.28
_HEIGHT_RANGE = (0.3, 2.8)  # [m] of people
_OUTWARDS = {"elbow": "shoulder", "wrist": "elbow", "hand": "wrist", "knee": "hip", "ankle": "knee", "toe": "ankle"}
_HANGS_ON = {
    **{f"{side}_{end}": (f"{side}_{begin}",) for side in ("left", "right") for end, begin in _OUTWARDS.items()},
    "left_hip": ("pelvis", "right_hip", "left_shoulder", "right_shoulder"),
    "right_hip": ("pelvis", "left_hip", "right_shoulder", "left_shoulder"),
    "left_shoulder": ("right_shoulder", "left_hip", "head"),
    "right_shoulder": ("left_shoulder", "right_hip", "head"),
    "head": ("left_shoulder", "right_shoulder"),
}
# Of a standing body, as fractions of its height: the middle of the hips, and all key points (18, 3).
PELVIS: FloatArray = (STANDING["left_hip"] + STANDING["right_hip"]) / 2
UPRIGHT: FloatArray = np.array([*STANDING.values(), PELVIS])


@dataclass(frozen=True)
class TrackedBody:
    """A person's body whose limbs are capsules between tracked key points.

    Key points that were never seen are assumed. A hand is assumed anywhere in the ball about its wrist with the length
    of the hand. The other key points are placed relative to the next known key point as in an upright body, rotated to
    the direction in which shoulders or hips face.

    Raises InputError if the height is out of range, or a limb has an unknown name.
    """

    # The height, from 0.3 to 2.8 [m]. Radii and assumed lengths follow from it.
    height: float = HEIGHT
    # The limbs that exist. The default is all of `safe_ompl.geometry.person.LIMBS`.
    only: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        number("height", self.height, at_least=_HEIGHT_RANGE[0], at_most=_HEIGHT_RANGE[1])
        for name in self.only:
            if name not in LIMBS:
                raise UnknownNameError("limb", name, LIMBS, "only")

    @cached_property
    def limbs(self) -> tuple[str, ...]:
        """Names of the M limbs."""
        return tuple(name for name in LIMBS if not self.only or name in self.only)

    def radii(self, ends: FloatArray) -> FloatArray:
        """Return the radii (M,) [m] of limbs with ends (M, 2, 3); a hand of length 0 is a ball that holds any pose."""
        short = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1) == 0
        thin, hands = self._radii
        return np.asarray(thin + np.where(short, hands, 0.0))

    @cached_property
    def _radii(self) -> tuple[FloatArray, FloatArray]:
        """Radii of the limbs (M,), and the increase of the radius for a hand in an unknown direction (M,) [m]."""
        hand = self.height * float(np.linalg.norm(STANDING["left_hand"] - STANDING["left_wrist"]))
        thin = [LIMBS[name][2] * self.height for name in self.limbs]
        return np.array(thin), np.array([hand if name.endswith("hand") else 0.0 for name in self.limbs])

    @cached_property
    def weights(self) -> FloatArray:
        """The ends of the limbs (M, 2, 17) as means of the 17 key points of `STANDING`."""
        return np.array([[_weights(end) for end in LIMBS[name][:2]] for name in self.limbs])

    def ends(self, keypoints: FloatArray) -> FloatArray:
        """Return the ends (M, 2, 3) [m] of the limbs from `keypoints: (18, 3)`; only the pelvis may be unknown."""
        return np.asarray(self.weights @ keypoints[: len(STANDING)])

    def completed(self, keypoints: FloatArray) -> tuple[FloatArray, IntArray]:
        """Return key points (18, 3) with assumed positions in place of NaN, and the source of each key point (18,).

        The source is the index of the known key point from which a position follows. Raises InputError if none of head,
        shoulders, hips and pelvis is known.
        """
        points = keypoints.copy()
        rests: IntArray = np.arange(len(KEYPOINTS))
        known: BoolArray = np.asarray(np.isfinite(points).all(axis=1))
        if known.all():
            return points, rests
        turn = facing(points)
        for name in _order(tuple(known.tolist())):
            k, parent = _INDEX[name], next(_INDEX[on] for on in _HANGS_ON[name] if known[_INDEX[on]])
            points[k] = points[parent]
            if not name.endswith("_hand"):
                points[k] += self.height * turn @ (UPRIGHT[k] - UPRIGHT[parent])
            rests[k], known[k] = rests[parent], True
        return points, rests

    def pelvis(self, keypoints: FloatArray) -> FloatArray:
        """Return the middle (3,) of the hips of completed key points (18, 3) [m]."""
        return np.asarray(0.5 * (keypoints[_INDEX["left_hip"]] + keypoints[_INDEX["right_hip"]]))


_INDEX = {name: k for k, name in enumerate(KEYPOINTS)}


def _weights(end: str) -> FloatArray:
    """Return the weights (17,) of the key points whose mean is a limb's end."""
    if end == "chest":
        return (1 - _CHEST) * _weights("shoulders") + _CHEST * _weights("pelvis")
    weights = np.zeros(len(STANDING))
    pair = {"shoulders": "shoulder", "pelvis": "hip"}.get(end)
    for name in (end,) if pair is None else (f"left_{pair}", f"right_{pair}"):
        weights[_INDEX[name]] = 1.0 if pair is None else 0.5
    return weights


@lru_cache(64)
def _order(known: tuple[bool, ...]) -> list[str]:
    """Return the unknown key points in an order in which each follows a key point that it can be placed from."""
    have = {name for name, k in _INDEX.items() if known[k]}
    missing = [name for name in STANDING if name not in have]
    order: list[str] = []
    while missing:
        ready = [name for name in missing if any(parent in have for parent in _HANGS_ON[name])]
        if not ready:
            raise InputError(
                "the trunk is not known: at least one of head, shoulders, hips and pelvis must have been seen"
            )
        order += ready[:1]
        have.add(ready[0])
        missing.remove(ready[0])
    return order


def facing(points: FloatArray) -> FloatArray:
    """Return the rotation (3, 3) about z from a body that faces x to the body with these shoulders or hips."""
    for pair in ("shoulder", "hip"):
        across = points[_INDEX[f"left_{pair}"]] - points[_INDEX[f"right_{pair}"]]
        length = float(np.hypot(across[0], across[1]))
        if length > 1e-3:  # NaN is not
            c, s = across[1] / length, -across[0] / length
            return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    return np.eye(3)


@dataclass(frozen=True)
class Recording:
    """A recording of the key points of one person."""

    # The names and axes of its key points.
    skeleton: Skeleton
    rate: float  # Frames per second
    # The frames as the sensor gave them (T, J, 3).
    frames: FloatArray
    source: str = ""  # File and clip

    def __repr__(self) -> str:
        return f"Recording({self.source!r}, {self.skeleton.name}, {self.duration:.1f} s)"

    @classmethod
    def load(cls, file: str | Path, clip: str = "clip_0") -> Recording:
        """Read a clip from a file; an InputError names the file and the invalid key, or lists the clips in the file."""
        path = Path(file)
        arrays = files.read_arrays(path)
        for key in ("names", "rate"):
            if key not in arrays:
                raise InputError("missing, but needed", f"{path}: {key}")
        clips = _clips(arrays)
        if clip not in clips:
            raise UnknownNameError("clip", clip, clips, str(path))
        try:
            skeleton = skeleton_of([str(name) for name in arrays["names"].ravel()])
        except InputError as error:
            raise InputError(str(error), f"{path}: names") from None
        rate = number(f"{path}: rate", arrays["rate"].squeeze(), above=0.0)
        frames = float_array(arrays[clip], (None, len(skeleton.points), 3), f"{path}: {clip}")
        if not len(frames):
            raise InputError("has no frames", f"{path}: {clip}")
        if np.isinf(frames).any():
            raise InputError("key points must be finite, or NaN where they are not seen", f"{path}: {clip}")
        return cls(skeleton, rate, frames, f"{path.name}:{clip}")

    @property
    def duration(self) -> float:
        """Duration [s]."""
        return (len(self.frames) - 1) / self.rate

    def at(self, time: float) -> FloatArray:
        """Return the key points (J, 3) at a time [s], linear between frames, played forwards and backwards in turn."""
        last = len(self.frames) - 1
        if last == 0:
            return np.asarray(self.frames[0])
        place = (time * self.rate) % (2 * last)
        place = min(place, 2 * last - place)
        k = min(int(place), last - 1)
        share = place - k
        return np.asarray((1 - share) * self.frames[k] + share * self.frames[k + 1])


def list_clips(file: str | Path) -> tuple[str, ...]:
    """Return the names of the clips in a file; errors as `Recording.load`."""
    return _clips(files.read_arrays(Path(file)))


def _clips(arrays: Iterable[str]) -> tuple[str, ...]:
    found = (key for key in arrays if key.startswith("clip_"))
    return tuple(sorted(found, key=lambda key: (len(key), key)))
