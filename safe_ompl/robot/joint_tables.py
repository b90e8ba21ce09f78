"""The joints of a robot as compiled kinematics read them, its skeleton of key points, and joints that mimic others."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pinocchio as pin

from safe_ompl.common import FloatArray, InputError, IntArray
from safe_ompl.robot import kernels as kernel
from safe_ompl.robot.reach import JointChain

_FLOAT = np.dtype(np.float64)  # compared with ==: what kernels return has an equal one


class KinematicTree:
    """Forward kinematics of the m joints of a robot and of K key points that they carry.

    Joints and key points are tables for kernels, see `safe_ompl.robot.kernels`; nobody writes to them.
    Key points are at `offsets: (K, 3)` [m] in the frames of their `carriers: (K,)`, Pinocchio's numbers of joints: 0 is
    the base, joint i has the number i + 1.
    """

    def __init__(self, chain: JointChain, carriers: IntArray, offsets: FloatArray) -> None:
        self.joints = np.zeros(len(chain.parents), kernel.JOINT)
        self.joints["rotation"] = [placement.rotation for placement in chain.placements]
        self.joints["translation"] = [placement.translation for placement in chain.placements]
        self.joints["axis"] = chain.axes
        self.joints["parent"] = chain.parents
        self.joints["slides"] = chain.prismatic
        self.keypoints = np.zeros(len(carriers), kernel.KEYPOINT)
        self.keypoints["offset"] = offsets
        self.keypoints["joint"] = carriers

    def frames(self, values: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return rotations (B, m, 3, 3), origins and axes (B, m, 3) of the joints in the world at `values: (B, m)`."""
        return kernel.joint_frames(self.joints, plain(values))


def plain(array: Any) -> FloatArray:
    """Return `array` as the one kind of array that kernels are compiled for, itself where it is one."""
    flags = array.flags
    if array.dtype == _FLOAT and flags.c_contiguous and flags.writeable:
        return array  # type: ignore[no-any-return]
    return np.require(array, np.float64, ["C", "W"])


@dataclass(frozen=True)
class Mimic:
    """A joint that follows another one: value = multiplier · primary + offset."""

    primary: str
    multiplier: float
    offset: float


@dataclass(frozen=True)
class Coupling:
    """The affine map from the n planned joints to the m joints of Pinocchio's model, matrix·q + offsets.

    A planned joint has a row of the identity in the matrix (m, n), a mimic joint its multiplier in the column of its
    primary. What is known for each of the m joints (radii, Jacobians) becomes what is known for the n planned ones.
    Where nothing mimics it is trivial: m = n and every array is returned as it came.
    """

    matrix: FloatArray
    offsets: FloatArray
    trivial: bool

    @classmethod
    def of(cls, joints: list[str], mimics: Mapping[str, Mimic]) -> Coupling:
        """Return the coupling of the model's `joints`, of which those in `mimics` follow planned ones directly."""
        planned = [name for name in joints if name not in mimics]
        matrix, offsets = np.zeros((len(joints), len(planned))), np.zeros(len(joints))
        for row, name in enumerate(joints):
            mimic = mimics.get(name, Mimic(name, 1.0, 0.0))
            matrix[row, planned.index(mimic.primary)] = mimic.multiplier
            offsets[row] = mimic.offset
        for array in (matrix, offsets):
            array.setflags(write=False)
        return cls(matrix, offsets, not mimics)

    def values(self, q: FloatArray) -> FloatArray:
        """Return the values (…, m) of the model's joints at `q: (…, n)`."""
        return q if self.trivial else q @ self.matrix.T + self.offsets

    def motions(self, delta: FloatArray) -> FloatArray:
        """Return the motions (…, m) of the model's joints while the planned ones move by `delta: (…, n)`."""
        return delta if self.trivial else delta @ self.matrix.T

    def reach(self, steps: FloatArray) -> FloatArray:
        """Return how far (…, m) the model's joints move while the planned ones move by up to `steps: (…, n)` ≥ 0."""
        return steps if self.trivial else steps @ np.abs(self.matrix).T

    def radii(self, radii: FloatArray) -> FloatArray:
        """Return the radii (…, n) that bound what `radii: (…, m)` bound: Σ_j r_j·|Δ_j| ≤ Σ_i (Σ_j r_j·|c_ji|)·|Δ_i|."""
        return radii if self.trivial else radii @ np.abs(self.matrix)

    def columns(self, derivatives: FloatArray) -> FloatArray:
        """Return derivatives (…, n) by the planned joints from those (…, m) by the model's joints."""
        return derivatives if self.trivial else derivatives @ self.matrix


def resolved(mimics: Mapping[str, Mimic], source: str) -> dict[str, Mimic]:
    """Return `mimics` with chains (a joint that mimics a mimic joint) followed to the first joint of each."""
    found = {}
    for name, mimic in mimics.items():
        seen = [name]
        while mimic.primary in mimics:
            if mimic.primary in seen:
                raise InputError(f"joints mimic each other in a circle: {', '.join(seen)}", source)
            seen.append(mimic.primary)
            above = mimics[mimic.primary]
            mimic = Mimic(
                above.primary, mimic.multiplier * above.multiplier, mimic.multiplier * above.offset + mimic.offset
            )
        found[name] = mimic
    return found


_ZERO_LENGTH = 1e-6  # [m]; joints at the same place, as on a spherical wrist


@dataclass(frozen=True)
class Skeleton:
    """K key points of a robot and the segments between them (paper §3, eq. 2).

    Each key point is carried by one of Pinocchio's `joints: (K,)`, 0 the fixed base, with its position in the frame of
    that joint in `offsets: (K, 3)` [m], and is the origin of one of `frames: (K,)`; the last one is the robot's tip. Of
    each link segment `segments: (L, 2)` has the proximal and the distal key point, and `names: (L,)` the frame at its
    distal end; those of zero length, and those that no joint moves, are left out.
    """

    joints: IntArray
    offsets: FloatArray
    segments: IntArray
    names: tuple[str, ...]
    frames: tuple[int, ...]

    @classmethod
    def from_model(cls, model: pin.Model, joint_names: Sequence[str], tips: Sequence[str]) -> Skeleton:
        """Build the skeleton of `model`, whose locked joints are reduced to frames."""
        first, *others = (frame_index(model, tip) for tip in tips)
        on_chain = {frame for tip in (first, *others) for frame in _way_to_root(model, tip)}
        ends = [(name, _joint_frame(model, name)) for name in joint_names]
        frames = [frame for name, frame in ends if frame in on_chain or model.existJointName(name)]
        frames += [*others, first]
        index = {frame: k for k, frame in enumerate(frames)}
        joints = np.array([model.frames[frame].parentJoint for frame in frames], dtype=np.intp)
        offsets = np.array([model.frames[frame].placement.translation for frame in frames], dtype=np.float64)

        stretched = _frame_positions(model, frames)
        segments, names = [], []
        for distal, frame in enumerate(frames):
            above = (index[k] for k in _way_to_root(model, model.frames[frame].parentFrame) if k in index)
            proximal = next(above, None)
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
        return next((above for above in _way_to_root(model, frame) if above in self.frames), None)


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


def _way_to_root(model: pin.Model, frame: int) -> Iterator[int]:
    """Yield the frames from `frame` to the root, which is left out."""
    while frame != 0:
        yield frame
        frame = model.frames[frame].parentFrame
