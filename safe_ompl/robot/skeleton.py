"""The line approximation of a robot: key points on its joints, and the link segments between them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from safe_ompl.common import FloatArray, IntArray

_ZERO_LENGTH = 1e-6  # [m]; joints at the same place, as on a spherical wrist


@dataclass(frozen=True)
class Skeleton:
    """Key points of a robot and the segments between them (paper §3, eq. 2).

    Attributes
    ----------
    joints : ndarray, shape (K,)
        For each key point the index of the Pinocchio joint that carries it (0: the fixed base).
    offsets : ndarray, shape (K, 3)
        Its position in the frame of that joint [m].
    segments : ndarray, shape (L, 2)
        Proximal and distal key point of each link segment. Segments of zero length, and those that no joint
        moves, are left out. The last key point is the robot's tip.
    names : tuple of str
        For each segment the frame at its distal end.
    frames : tuple of int
        For each key point the frame that it is the origin of.
    """

    joints: IntArray
    offsets: FloatArray
    segments: IntArray
    names: tuple[str, ...]
    frames: tuple[int, ...]

    @classmethod
    def from_model(cls, model: pin.Model, joint_names: Sequence[str], tips: Sequence[str]) -> Skeleton:
        """Build the skeleton of `model`.

        Parameters
        ----------
        model : pin.Model
            The robot, with locked joints reduced to frames.
        joint_names : sequence of str
            All joints of the robot, locked ones included: they too are ends of links.
        tips : sequence of str
            Frames at the ends of the last links; the first is the robot's tip.
        """
        first, *others = (frame_index(model, tip) for tip in tips)
        on_chain = set().union(*(_frames_above(model, tip) for tip in (first, *others)))
        ends = [(name, _joint_frame(model, name)) for name in joint_names]
        frames = [frame for name, frame in ends if frame in on_chain or model.existJointName(name)]
        frames += [*others, first]
        index = {frame: k for k, frame in enumerate(frames)}
        joints = np.array([model.frames[frame].parentJoint for frame in frames], dtype=np.intp)
        offsets = np.array([model.frames[frame].placement.translation for frame in frames], dtype=np.float64)

        stretched = _frame_positions(model, frames)
        segments, names = [], []
        for distal, frame in enumerate(frames):
            proximal = _nearest_above(model, frame, index)
            if proximal is None or joints[proximal] == 0:
                continue
            lengths = np.linalg.norm(stretched[:, distal] - stretched[:, proximal], axis=1)
            if lengths.max() > _ZERO_LENGTH:
                segments.append((proximal, distal))
                names.append(model.frames[frame].name)
        pairs = np.array(segments, dtype=np.intp).reshape(-1, 2)
        return cls(joints, offsets, pairs, tuple(names), tuple(frames))

    def nearest(self, model: pin.Model, frame: int) -> int | None:
        """Return the frame of the key point nearest to `frame` on the way to the base, itself included, or None."""
        while frame != 0:
            if frame in self.frames:
                return frame
            frame = model.frames[frame].parentFrame
        return None


def frame_index(model: pin.Model, name: str) -> int:
    """Return the index of the frame called `name`; where a joint and a link share the name, the link's."""
    matches = [k for k, frame in enumerate(model.frames) if frame.name == name]
    bodies = [k for k in matches if model.frames[k].type == pin.FrameType.BODY]
    return (bodies or matches)[0]


def _joint_frame(model: pin.Model, name: str) -> int:
    """Return the index of the frame of a joint, free or locked; a link may have the same name."""
    return next(k for k, f in enumerate(model.frames) if f.name == name and f.type != pin.FrameType.BODY)


def _frame_positions(model: pin.Model, frames: list[int]) -> FloatArray:
    """Return positions (3, K, 3) of frames, joints at zero and at either limit: where joints slide, lengths change."""
    data, positions = model.createData(), []
    for limit in (pin.neutral(model), model.lowerPositionLimit, model.upperPositionLimit):
        q = pin.neutral(model)
        for joint in list(model.joints)[1:]:
            if joint.nq == 1:
                q[joint.idx_q] = limit[joint.idx_q]
        pin.framesForwardKinematics(model, data, q)
        positions.append([data.oMf[frame].translation.copy() for frame in frames])
    return np.array(positions)


def _frames_above(model: pin.Model, frame: int) -> set[int]:
    """Return the frames from `frame` to the root."""
    found = set()
    while frame != 0:
        found.add(frame)
        frame = model.frames[frame].parentFrame
    return found


def _nearest_above(model: pin.Model, frame: int, index: dict[int, int]) -> int | None:
    frame = model.frames[frame].parentFrame
    while frame != 0:
        if frame in index:
            return index[frame]
        frame = model.frames[frame].parentFrame
    return None
