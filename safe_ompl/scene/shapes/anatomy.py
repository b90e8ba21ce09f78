"""The human body: where its key points are, and which limbs lie between them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from safe_ompl.arrays import FloatArray
from safe_ompl.errors import InputError

# Key points of a standing body, arms down, as fractions of its height: x forward, y to the left, z up, the
# origin on the floor between the feet. After the segment lengths of Drillis and Contini (1966).
_MIDDLE = {"head": (0.01, 0.0, 0.935)}
_LEFT = {
    "shoulder": (0.0, 0.110, 0.812),
    "elbow": (-0.01, 0.132, 0.628),
    "wrist": (0.02, 0.136, 0.482),
    "hand": (0.036, 0.136, 0.400),
    "hip": (0.0, 0.055, 0.525),
    "knee": (0.01, 0.058, 0.285),
    "ankle": (0.0, 0.060, 0.045),
    "toe": (0.095, 0.070, 0.022),
}
_SIDES = {"left": 1.0, "right": -1.0}
STANDING: dict[str, FloatArray] = {
    **{name: np.array(point) for name, point in _MIDDLE.items()},
    **{
        f"{side}_{name}": np.array([x, y * sign, z])
        for side, sign in _SIDES.items()
        for name, (x, y, z) in _LEFT.items()
    },
}
_PARENT = {
    "elbow": "shoulder",
    "wrist": "elbow",
    "hand": "wrist",
    "knee": "hip",
    "ankle": "knee",
    "toe": "ankle",
}

# Capsules: from one key point to another, with a radius as a fraction of the height.
_TRUNK_LIMBS = {
    "head": ("head", "head", 0.062),
    "neck": ("shoulders", "head", 0.036),
    "shoulders": ("left_shoulder", "right_shoulder", 0.042),
    "torso": ("chest", "pelvis", 0.074),
    "hips": ("left_hip", "right_hip", 0.066),
}
_SIDE_LIMBS = {
    "flank": ("shoulder", "hip", 0.052),
    "upper_arm": ("shoulder", "elbow", 0.028),
    "forearm": ("elbow", "wrist", 0.024),
    "hand": ("wrist", "hand", 0.024),
    "thigh": ("hip", "knee", 0.045),
    "shank": ("knee", "ankle", 0.032),
    "foot": ("ankle", "toe", 0.022),
}
LIMBS: dict[str, tuple[str, str, float]] = {
    **_TRUNK_LIMBS,
    **{
        f"{side}_{name}": (f"{side}_{start}", f"{side}_{end}", radius)
        for side in _SIDES
        for name, (start, end, radius) in _SIDE_LIMBS.items()
    },
}


@dataclass(frozen=True)
class Body:
    """A body of which some key points are given and the others follow.

    The frame of the body has its origin on the floor between the feet, x forward, y to the left, z up. A key
    point that is not given moves along with the one that it hangs on. Given the hand or the wrist, the elbow
    bends downwards so that the lengths of upper arm and forearm stay.

    Parameters
    ----------
    height : float
        Body height [m]; all lengths follow from it.
    given : mapping of str to 3 float
        Key points that are known [m]: names as in `STANDING`.
    """

    height: float
    given: Mapping[str, Sequence[float]]

    def point(self, name: str) -> FloatArray:
        """Return a key point (3,) [m] in the frame of the body.

        Besides the names above there are ``shoulders`` and ``pelvis``, midway between left and right, and
        ``chest``, on the line between them.
        """
        if name in self.given:
            return np.array(self.given[name])
        if name == "shoulders":
            return (self.point("left_shoulder") + self.point("right_shoulder")) / 2
        if name == "pelvis":
            return (self.point("left_hip") + self.point("right_hip")) / 2
        if name == "chest":
            return 0.72 * self.point("shoulders") + 0.28 * self.point("pelvis")
        side, _, joint = name.partition("_")
        if joint == "elbow" and {f"{side}_wrist", f"{side}_hand"} & set(self.given):
            return self._bent_elbow(side)
        if joint == "wrist" and f"{side}_hand" in self.given:
            return self._wrist_before_hand(side)
        if joint == "hand":
            return self._hand_beyond_wrist(side)
        if joint not in _PARENT:
            return self.height * STANDING[name]
        parent = f"{side}_{_PARENT[joint]}"
        return self.point(parent) + self.height * (STANDING[name] - STANDING[parent])

    def _segment(self, side: str, start: str, end: str) -> float:
        return self.height * float(np.linalg.norm(STANDING[f"{side}_{end}"] - STANDING[f"{side}_{start}"]))

    def _bent_elbow(self, side: str) -> FloatArray:
        """Elbow of a two-segment arm from shoulder to wrist that hangs as low as it can."""
        upper, fore = self._segment(side, "shoulder", "elbow"), self._segment(side, "elbow", "wrist")
        shoulder, wrist = self.point(f"{side}_shoulder"), self.point(f"{side}_wrist")
        reach = float(np.linalg.norm(wrist - shoulder))
        if not abs(upper - fore) < reach <= upper + fore:
            raise InputError(
                f"the wrist is {reach:.3g} m from the shoulder, but the arm spans {abs(upper - fore):.3g} to "
                f"{upper + fore:.3g} m: move the person, or give {side}_elbow too",
                f"{side}_wrist" if f"{side}_wrist" in self.given else f"{side}_hand",
            )
        forward = (wrist - shoulder) / reach
        down = _perpendicular(np.array([0.0, 0.0, -1.0]), forward)
        along = (reach**2 + upper**2 - fore**2) / (2 * reach)
        bent: FloatArray = shoulder + along * forward + np.sqrt(max(upper**2 - along**2, 0.0)) * down
        return bent

    def _wrist_before_hand(self, side: str) -> FloatArray:
        hand = np.array(self.given[f"{side}_hand"])
        towards = self.point(f"{side}_shoulder") - hand
        distance = max(float(np.linalg.norm(towards)), 1e-9)
        wrist: FloatArray = hand + self._segment(side, "wrist", "hand") * towards / distance
        return wrist

    def _hand_beyond_wrist(self, side: str) -> FloatArray:
        elbow, wrist = self.point(f"{side}_elbow"), self.point(f"{side}_wrist")
        distance = max(float(np.linalg.norm(wrist - elbow)), 1e-9)
        hand: FloatArray = wrist + self._segment(side, "wrist", "hand") * (wrist - elbow) / distance
        return hand


def _perpendicular(vector: FloatArray, axis: FloatArray) -> FloatArray:
    """Return the unit vector nearest to `vector` among those at right angles to the unit vector `axis`."""
    for candidate in (vector, np.array([-1.0, 0.0, 0.0])):
        rest = candidate - (candidate @ axis) * axis
        if np.linalg.norm(rest) > 1e-6:
            break
    unit: FloatArray = rest / np.linalg.norm(rest)
    return unit
