"""Recordings of people: clips of key points in an ``.npz`` file.

Its arrays are ``names``, the key points of a known skeleton in order; ``rate`` [Hz]; and ``clip_0``, ``clip_1``, …,
each (T, J, 3), in the units and axes of that skeleton. NaN: not seen.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from zipfile import BadZipFile

import numpy as np

from safe_ompl.common import FloatArray, InputError, UnknownNameError, float_array, number
from safe_ompl.people.skeletons import Skeleton, skeleton_of


@dataclass(frozen=True)
class Recording:
    """One clip of a person.

    Attributes
    ----------
    skeleton : Skeleton
        What its key points are.
    rate : float
        Frames per second.
    frames : ndarray, shape (T, J, 3)
        As the sensor gave them.
    source : str
        File and clip.
    """

    skeleton: Skeleton
    rate: float
    frames: FloatArray
    source: str = ""

    def __repr__(self) -> str:
        return f"Recording({self.source!r}, {self.skeleton.name}, {self.duration:.1f} s)"

    @classmethod
    def load(cls, file: str | Path, clip: str = "clip_0") -> Recording:
        """Read a clip.

        Raises
        ------
        InputError
            If the file cannot be read, lacks a key or holds something else; names file and key.
        UnknownNameError
            If there is no such clip; lists those that there are.
        """
        path = Path(file)
        arrays = _arrays(path)
        for key in ("names", "rate"):
            if key not in arrays:
                raise InputError("missing, but needed", f"{path}: {key}")
        clips = sorted((key for key in arrays if key.startswith("clip_")), key=lambda key: (len(key), key))
        if clip not in clips:
            raise UnknownNameError("clip", clip, clips, str(path))
        try:
            skeleton = skeleton_of([str(name) for name in arrays["names"].ravel()])
        except InputError as error:
            raise InputError(str(error), f"{path}: names") from None
        rate = number(f"{path}: rate:", arrays["rate"].squeeze(), above=0.0)
        frames = float_array(arrays[clip], (None, len(skeleton.points), 3), f"{path}: {clip}:")
        if not len(frames):
            raise InputError("has no frames", f"{path}: {clip}")
        if np.isinf(frames).any():
            raise InputError("key points must be finite, or NaN where they are not seen", f"{path}: {clip}")
        return cls(skeleton, rate, frames, f"{path.name}:{clip}")

    @property
    def duration(self) -> float:
        """How long it plays [s]."""
        return (len(self.frames) - 1) / self.rate

    def at(self, time: float) -> FloatArray:
        """Return the key points (J, 3) at a time [s], linear between frames; it plays back and forth for ever."""
        last = len(self.frames) - 1
        if last == 0:
            only: FloatArray = self.frames[0]
            return only
        place = (time * self.rate) % (2 * last)
        place = min(place, 2 * last - place)
        k = min(int(place), last - 1)
        share = place - k
        points: FloatArray = (1 - share) * self.frames[k] + share * self.frames[k + 1]
        return points


def list_clips(file: str | Path) -> tuple[str, ...]:
    """Return the names of the clips in a file; errors as `Recording.load`."""
    keys = (key for key in _arrays(Path(file)) if key.startswith("clip_"))
    return tuple(sorted(keys, key=lambda key: (len(key), key)))


def _arrays(path: Path) -> dict[str, np.ndarray]:
    try:
        with np.load(path, allow_pickle=False) as data:
            return {key: data[key] for key in data.files}
    except (OSError, BadZipFile, ValueError, EOFError, AttributeError) as error:
        reason = getattr(error, "strerror", None) or "it is no .npz file of plain arrays"
        raise InputError(f"cannot be read ({reason})", str(path)) from None
