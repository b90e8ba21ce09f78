"""The limbs of a tracked body: capsules between its key points, and assumptions where there are none."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from safe_ompl.common import BoolArray, FloatArray, InputError, IntArray, UnknownNameError, number
from safe_ompl.geometry import LIMBS, STANDING
from safe_ompl.people.skeletons import KEYPOINTS

HEIGHT = 1.75  # [m]
_CHEST = 0.28  # from the shoulders towards the pelvis, as in `safe_ompl.geometry.person`
_HEIGHTS = (0.3, 2.8)  # [m] of people
_HANGS_ON = {
    **{
        f"{side}_{name}": (f"{side}_{parent}",)
        for side in ("left", "right")
        for name, parent in (("elbow", "shoulder"), ("wrist", "elbow"), ("knee", "hip"), ("ankle", "knee"))
    },
    **{f"{side}_toe": (f"{side}_ankle",) for side in ("left", "right")},
    "left_hip": ("pelvis", "right_hip", "left_shoulder", "right_shoulder"),
    "right_hip": ("pelvis", "left_hip", "right_shoulder", "left_shoulder"),
    "left_shoulder": ("right_shoulder", "left_hip", "head"),
    "right_shoulder": ("left_shoulder", "right_hip", "head"),
    "head": ("left_shoulder", "right_shoulder"),
}
# Of a standing body, as a fraction of its height.
PELVIS: FloatArray = (STANDING["left_hip"] + STANDING["right_hip"]) / 2


@dataclass(frozen=True)
class TrackedBody:
    """A person's body whose limbs are capsules between tracked key points.

    Key points that were never seen are assumed. A hand is somewhere in the ball about its wrist that it can reach. The
    others are where a body that stands upright has them, relative to the next known joint, turned to where shoulders or
    hips face.

    Parameters
    ----------
    height : float
        Body height, from 0.3 to 2.8 [m]; radii and assumed lengths follow from it.
    only : sequence of str
        Limbs that there are; default: all of `safe_ompl.geometry.person.LIMBS`.

    Raises
    ------
    InputError
        If the height is not a person's.
    UnknownNameError
        If there is no limb of such a name.
    """

    height: float = HEIGHT
    only: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        number("height", self.height, at_least=_HEIGHTS[0], at_most=_HEIGHTS[1])
        for name in self.only:
            if name not in LIMBS:
                raise UnknownNameError("limb", name, LIMBS, "only")

    @cached_property
    def limbs(self) -> tuple[str, ...]:
        """Names of the M limbs."""
        return tuple(name for name in LIMBS if not self.only or name in self.only)

    def radii(self, ends: FloatArray) -> FloatArray:
        """Return the radii (M,) of the limbs with these ends (M, 2, 3); a hand without a length is a ball [m]."""
        short = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1) == 0
        radii: FloatArray = self._radii + np.where(short, self._spans, 0.0)
        return radii

    @cached_property
    def _radii(self) -> FloatArray:
        return np.array([LIMBS[name][2] * self.height for name in self.limbs])

    @cached_property
    def _spans(self) -> FloatArray:
        hand = self.height * float(np.linalg.norm(STANDING["left_hand"] - STANDING["left_wrist"]))
        return np.array([hand if name.endswith("hand") else 0.0 for name in self.limbs])

    @cached_property
    def weights(self) -> FloatArray:
        """The ends of the limbs (M, 2, 17) as means of the 17 key points of `STANDING`."""
        return np.array([[_weights(end) for end in LIMBS[name][:2]] for name in self.limbs])

    def ends(self, keypoints: FloatArray) -> FloatArray:
        """Return the ends (M, 2, 3) of the limbs, `keypoints: (18, 3)` all known but the pelvis [m]."""
        ends: FloatArray = self.weights @ keypoints[: len(STANDING)]
        return ends

    def completed(self, keypoints: FloatArray) -> tuple[FloatArray, IntArray]:
        """Return the key points (18, 3) with those that are NaN assumed, and on which one each rests (18,).

        Raises
        ------
        InputError
            If none of head, shoulders, hips and pelvis is known.
        """
        points = keypoints.copy()
        rests: IntArray = np.arange(len(KEYPOINTS))
        known: BoolArray = np.asarray(np.isfinite(points).all(axis=1))
        if known.all():
            return points, rests
        turn = facing(points)
        for name in _order(known):
            k, parent = _INDEX[name], _parent(name, known)
            points[k] = points[parent]
            if not name.endswith("_hand"):
                points[k] += self.height * turn @ (_standing(k) - _standing(parent))
            rests[k], known[k] = rests[parent], True
        return points, rests

    def pelvis(self, keypoints: FloatArray) -> FloatArray:
        """Return the middle (3,) of the hips of completed key points (18, 3) [m]."""
        middle: FloatArray = 0.5 * (keypoints[_INDEX["left_hip"]] + keypoints[_INDEX["right_hip"]])
        return middle


_INDEX = {name: k for k, name in enumerate(KEYPOINTS)}


def _weights(end: str) -> FloatArray:
    """Return how a limb's end is made of the key points."""
    if end == "chest":
        return (1 - _CHEST) * _weights("shoulders") + _CHEST * _weights("pelvis")
    weights = np.zeros(len(STANDING))
    pair = {"shoulders": "shoulder", "pelvis": "hip"}.get(end)
    for name in (end,) if pair is None else (f"left_{pair}", f"right_{pair}"):
        weights[_INDEX[name]] = 1.0 if pair is None else 0.5
    return weights


def _standing(k: int) -> FloatArray:
    return PELVIS if KEYPOINTS[k] == "pelvis" else STANDING[KEYPOINTS[k]]


def _order(known: BoolArray) -> list[str]:
    """Return the key points that are not known, each after one that it can hang on."""
    have = {name for name, k in _INDEX.items() if known[k]}
    missing = [name for name in STANDING if name not in have]
    order: list[str] = []
    while missing:
        ready = [name for name in missing if any(parent in have for parent in _parents(name))]
        if not ready:
            raise InputError(
                "nothing is known of the trunk: at least one of head, shoulders, hips and pelvis must have been seen"
            )
        order += ready[:1]
        have.add(ready[0])
        missing.remove(ready[0])
    return order


def _parents(name: str) -> tuple[str, ...]:
    return (name.replace("hand", "wrist"),) if name.endswith("_hand") else _HANGS_ON[name]


def _parent(name: str, known: BoolArray) -> int:
    return next(_INDEX[parent] for parent in _parents(name) if known[_INDEX[parent]])


def facing(points: FloatArray) -> FloatArray:
    """Return the rotation (3, 3) about z from a body that faces x to one whose shoulders or hips are where they are."""
    for pair in ("shoulder", "hip"):
        across = points[_INDEX[f"left_{pair}"]] - points[_INDEX[f"right_{pair}"]]
        length = float(np.hypot(across[0], across[1]))
        if length > 1e-3:  # NaN is not
            c, s = across[1] / length, -across[0] / length
            return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    return np.eye(3)
