"""Skeletons of body trackers: which key points they give, in which units and axes, and where these are on our body."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike

from safe_ompl.common import FloatArray, InputError, UnknownNameError, float_array
from safe_ompl.geometry import STANDING

KEYPOINTS: tuple[str, ...] = (*STANDING, "pelvis")  # of the body of the package, and the middle of its hips

_Z_UP = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
_Y_UP = ((0.0, 0.0, 1.0), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0))  # x to the left, y up, z forward
_CAMERA = ((0.0, 0.0, 1.0), (-1.0, 0.0, 0.0), (0.0, -1.0, 0.0))  # x to the right, y down, z forward


@dataclass(frozen=True)
class Skeleton:
    """A skeleton of key points as one tracker gives it.

    Attributes
    ----------
    name : str
        Such as "coco17".
    points : tuple of str
        Names of its J key points, in the tracker's order.
    sources : mapping of str to tuple of str
        For key points of our body the tracker's points whose mean they are; the others the tracker does not see.
    scale : float
        Length of its unit [m].
    axes : 3 × 3 float
        Its axes in a frame with x forward, y to the left and z up: the rows are x, y, z.
    placed : bool
        Whether it says where in the room people are; if not, they are given about their own hip.
    """

    name: str
    points: tuple[str, ...]
    sources: Mapping[str, tuple[str, ...]] = field(hash=False)
    scale: float = 1.0
    axes: tuple[tuple[float, ...], ...] = _Z_UP
    placed: bool = True

    def __repr__(self) -> str:
        return f"Skeleton({self.name!r}, {len(self.points)} points, {self.scale:g} m)"

    @property
    def unseen(self) -> tuple[str, ...]:
        """Key points of our body that it does not know."""
        return tuple(name for name in STANDING if name not in self.sources)

    def keypoints(self, points: ArrayLike) -> FloatArray:
        """Return the key points of our body (18, 3) [m], x forward, y left, z up, in the order of `KEYPOINTS`.

        Parameters
        ----------
        points : array_like, shape (J, 3)
            What the tracker gave, in its units and axes. NaN: not seen.

        Raises
        ------
        InputError
            If the shape is another, or a key point is infinite or NaN in part.
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
        index = {name: j for j, name in enumerate(self.points)}
        for k, name in enumerate(KEYPOINTS):
            if name in self.sources:
                found[k] = metres[[index[source] for source in self.sources[name]]].mean(axis=0)
        return found


def _both(**parts: str) -> dict[str, tuple[str, ...]]:
    """Return sources for left and right; ``{side}`` stands for either."""
    return {
        f"{side}_{ours}": (theirs.format(side=side),)
        for ours, theirs in parts.items()
        for side in ("left", "right")
    }


_COCO = (
    "nose", "left_eye", "right_eye", "left_ear", "right_ear", "left_shoulder", "right_shoulder", "left_elbow",
    "right_elbow", "left_wrist", "right_wrist", "left_hip", "right_hip", "left_knee", "right_knee", "left_ankle",
    "right_ankle",
)  # fmt: skip
_BODY_25 = (
    "nose", "neck", "right_shoulder", "right_elbow", "right_wrist", "left_shoulder", "left_elbow", "left_wrist",
    "mid_hip", "right_hip", "right_knee", "right_ankle", "left_hip", "left_knee", "left_ankle", "right_eye",
    "left_eye", "right_ear", "left_ear", "left_big_toe", "left_small_toe", "left_heel", "right_big_toe",
    "right_small_toe", "right_heel",
)  # fmt: skip
_MEDIAPIPE = (
    "nose", "left_eye_inner", "left_eye", "left_eye_outer", "right_eye_inner", "right_eye", "right_eye_outer",
    "left_ear", "right_ear", "mouth_left", "mouth_right", "left_shoulder", "right_shoulder", "left_elbow",
    "right_elbow", "left_wrist", "right_wrist", "left_pinky", "right_pinky", "left_index", "right_index",
    "left_thumb", "right_thumb", "left_hip", "right_hip", "left_knee", "right_knee", "left_ankle", "right_ankle",
    "left_heel", "right_heel", "left_foot_index", "right_foot_index",
)  # fmt: skip
_KINECT = (
    "pelvis", "spine_navel", "spine_chest", "neck", "left_clavicle", "left_shoulder", "left_elbow", "left_wrist",
    "left_hand", "left_handtip", "left_thumb", "right_clavicle", "right_shoulder", "right_elbow", "right_wrist",
    "right_hand", "right_handtip", "right_thumb", "left_hip", "left_knee", "left_ankle", "left_foot", "right_hip",
    "right_knee", "right_ankle", "right_foot", "head", "nose", "left_eye", "left_ear", "right_eye", "right_ear",
)  # fmt: skip
_SMPL = (
    "pelvis", "left_hip", "right_hip", "spine1", "left_knee", "right_knee", "spine2", "left_ankle", "right_ankle",
    "spine3", "left_foot", "right_foot", "neck", "left_collar", "right_collar", "head", "left_shoulder",
    "right_shoulder", "left_elbow", "right_elbow", "left_wrist", "right_wrist", "left_hand", "right_hand",
)  # fmt: skip
_RECORDING = (
    "hip", "torso", "neck", "head", "left_collar", "left_upper_arm", "left_forearm", "left_hand", "right_collar",
    "right_upper_arm", "right_forearm", "right_hand",
)  # fmt: skip

_LIMBS = _both(shoulder="{side}_shoulder", elbow="{side}_elbow", wrist="{side}_wrist")
_LEGS = _both(hip="{side}_hip", knee="{side}_knee", ankle="{side}_ankle")

# Indices and names after the documentation of COCO, OpenPose, MediaPipe, Azure Kinect's body tracking and SMPL. A head
# is where the ears are, if there are any: the nose is in front of it.
SKELETONS: dict[str, Skeleton] = {
    skeleton.name: skeleton
    for skeleton in (
        Skeleton("coco17", _COCO, {"head": ("left_ear", "right_ear"), **_LIMBS, **_LEGS}),
        Skeleton(
            "body25",
            _BODY_25,
            {"head": ("left_ear", "right_ear"), **_LIMBS, **_LEGS, **_both(toe="{side}_big_toe")},
        ),
        Skeleton(
            "mediapipe33",
            _MEDIAPIPE,
            {
                "head": ("left_ear", "right_ear"),
                **_LIMBS,
                **_both(hand="{side}_index"),
                **_LEGS,
                **_both(toe="{side}_foot_index"),
            },
            axes=_CAMERA,
            placed=False,
        ),
        Skeleton(
            "azure_kinect32",
            _KINECT,
            {
                "head": ("left_ear", "right_ear"),
                **_LIMBS,
                **_both(hand="{side}_handtip"),
                **_LEGS,
                **_both(toe="{side}_foot"),
            },
            scale=1e-3,
            axes=_CAMERA,
        ),
        Skeleton(
            "smpl24",
            _SMPL,
            {
                "head": ("head",),
                **_LIMBS,
                **_both(hand="{side}_hand"),
                **_LEGS,
                **_both(toe="{side}_foot"),
            },
            axes=_Y_UP,
        ),
        Skeleton(  # bones, each named after where it begins: the upper arm at the shoulder, the hand at the wrist
            "recording12",
            _RECORDING,
            {
                "head": ("head",),
                **_both(shoulder="{side}_upper_arm", elbow="{side}_forearm", wrist="{side}_hand"),
                "pelvis": ("hip",),
            },
        ),
    )
}


def find_skeleton(name: str) -> Skeleton:
    """Return the skeleton of this name, or raise UnknownNameError that lists those that there are."""
    try:
        return SKELETONS[name]
    except (KeyError, TypeError):
        raise UnknownNameError("skeleton", name, SKELETONS) from None


def skeleton_of(points: Sequence[str]) -> Skeleton:
    """Return the skeleton with these key points in this order.

    Raises
    ------
    InputError
        If there is none.
    """
    for skeleton in SKELETONS.values():
        if skeleton.points == tuple(points):
            return skeleton
    known = ", ".join(f"{s.name} ({len(s.points)})" for s in SKELETONS.values())
    raise InputError(f"no skeleton has the {len(points)} key points {', '.join(points)}; known: {known}")
