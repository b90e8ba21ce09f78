"""Forward kinematics of a robot: configurations, key points and their Jacobians, and the tip."""

from __future__ import annotations

import logging
import sys
from collections.abc import Mapping, Sequence
from copy import copy
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from safe_ompl.common import (
    BoolArray,
    FloatArray,
    InputError,
    IntArray,
    PerThread,
    UnknownNameError,
    configuration,
    finite_array,
    polynomials,
    told_apart,
)
from safe_ompl.robot.displacement_bounds import JointChain
from safe_ompl.robot.joints import Mimic, RobotSkeleton, frame_index
from safe_ompl.robot.kinematics import JOINT, KEY_POINT, EdgeTable, JointTable, KeyPointTable, unrolled
from safe_ompl.robot.parts import RobotParts

_log = logging.getLogger(__name__)

# Types are compared with ==, since arrays of kernels have an equal type, not the same object.
_FLOAT = np.dtype(np.float64)
# A value may be outside its limits by this.
_WITHIN = 1e-9  # [rad or m]
# A robot that stands outside its joint limits by at most this begins at the limit. MoveIt clips starts by as much.
START_TOLERANCE = 0.05  # [rad or m]
_LARGEST = sys.float_info.max
# In an interval of a motion that is shorter than this, joints that may leave their limits count as leaving them.
_SHORTEST = 1e-9


class KinematicTree:
    """The m joints of a robot, and K key points at `offsets` [m] in frames of `carriers`, for compiled code.

    `skeleton` are the key points that links (L, 2) have, as a table, and the links between these. Those that are always
    at the same place, as the origins of the joints of a wrist are, are one there.
    """

    def __init__(self, chain: JointChain, carriers: IntArray, offsets: FloatArray, links: IntArray) -> None:
        self.joints = np.zeros(len(chain.parents), JOINT)
        self.joints["rotation"] = [placement.rotation for placement in chain.placements]
        self.joints["translation"] = [placement.translation for placement in chain.placements]
        self.joints["axis"] = chain.axes
        self.joints["parent"] = chain.parents
        self.joints["slides"] = chain.prismatic
        self.keypoints = np.zeros(len(carriers), KEY_POINT)
        self.keypoints["offset"] = offsets
        self.keypoints["joint"] = carriers
        ends, rows = self.keypoints[links.ravel()], dict[bytes, int]()
        for key in ends:
            while key["joint"] and not key["offset"].any() and not self.joints[key["joint"] - 1]["slides"]:
                joint = self.joints[key["joint"] - 1]
                key["offset"], key["joint"] = joint["translation"], joint["parent"]
        order = np.array([rows.setdefault(key.tobytes(), len(rows)) for key in ends], dtype=np.intp)
        self.skeleton = ends[np.unique(order, return_index=True)[1]], order.reshape(links.shape)
        self.table = JointTable(self.joints)
        self.keypoint_table = KeyPointTable(self.keypoints, self.table)
        self.link_end_table = KeyPointTable(self.skeleton[0], self.table)


def plain(array: Any) -> FloatArray:
    """Return `array` as the one kind of array that kernels are compiled for, itself where it is one."""
    flags = array.flags
    if array.dtype == _FLOAT and flags.c_contiguous and flags.writeable:
        return array  # type: ignore[no-any-return]
    return np.require(array, np.float64, ["C", "W"])


@dataclass(frozen=True, eq=False, repr=False)
class Coupling:
    """The affine map from the n planned joints to the m joints of Pinocchio's model, matrix (m, n)·q + offsets.

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


class ForwardKinematics:
    """Joints of a robot and where they bring its key points and its tip.

    The n planned joints move the m ≥ n joints of Pinocchio's model: where a joint mimics another one, m > n.
    `joint_prismatic: (m,)` says which of these slide, `joint_keypoint_support: (K, m)` which move each key point. The
    `tip_joint` carries the tip, at `tip_placement` in its frame.
    """

    def __init__(self, parts: RobotParts) -> None:
        model = parts.model
        self.shared = parts
        self._model = model
        joints = list(model.joints)[1:]
        names = list(model.names)[1:]
        self.coupling = Coupling.of(names, parts.mimics)
        planned = np.array([name not in parts.mimics for name in names], dtype=bool)
        self.joint_names: tuple[str, ...] = tuple(name for name in names if name not in parts.mimics)
        self.n: int = len(self.joint_names)
        self._shape = (self.n,)

        turning = np.array([joint.nq == 2 for joint in joints])
        first: IntArray = np.array([joint.idx_q for joint in joints], dtype=np.intp)
        self._turning, self._straight, self._circular = turning, first[~turning], first[turning]
        # Pinocchio's configurations are those of the package.
        self._plain = self.coupling.trivial and not turning.any()
        self._chain = parts.chain
        self.joint_prismatic: BoolArray = self._chain.prismatic

        self.continuous: BoolArray = turning[planned]
        self._wraps = bool(self.continuous.any())
        self.prismatic: BoolArray = self.joint_prismatic[planned]
        self.lower: FloatArray = self._chain.lower[planned]
        self.upper: FloatArray = self._chain.upper[planned]

        self.tip: str = parts.tips[0]
        self.tip_frame: int = frame_index(model, self.tip)
        frame = model.frames[self.tip_frame]
        self.tip_joint, self.tip_placement = int(frame.parentJoint), pin.SE3(frame.placement)
        skeleton = RobotSkeleton.from_model(model, parts.link_ends, parts.tips)
        self.segments: IntArray = skeleton.segments
        self.segment_names = skeleton.names
        self.skeleton = skeleton
        self.kinematics = KinematicTree(self._chain, skeleton.joints, skeleton.offsets, skeleton.segments)
        self.joint_keypoint_support = self.supporting_joints(skeleton.joints)
        self._scratch = PerThread(model.createData)
        flags = self.continuous, self.prismatic, self.joint_keypoint_support
        for array in (self.lower, self.upper, self.segments, *flags):
            array.setflags(write=False)

    def configuration(self, value: ArrayLike | Mapping[str, float], name: str = "configuration") -> FloatArray:
        """Return `value` as a configuration (n,): an array-like, or a mapping of every joint's name to its value.

        Raises InputError, which starts with the name, if the shape is wrong, a number is not finite, or a joint is
        missing; UnknownNameError for a joint that the robot does not have.
        """
        if isinstance(value, Mapping):
            for joint in value:
                if joint not in self.joint_names:
                    raise UnknownNameError("joint", joint, self.joint_names, name)
            missing = [joint for joint in self.joint_names if joint not in value]
            if missing:
                raise InputError(f"no value for {', '.join(map(repr, missing))}", name)
            value = [value[joint] for joint in self.joint_names]
        return finite_array(value, (self.n,), name)

    def _checked(self, q: ArrayLike | Mapping[str, float]) -> FloatArray:
        """Return `configuration(q)`, at a tenth of the cost where `q` is a configuration already."""
        return self.configuration(q) if isinstance(q, Mapping) else configuration(q, self.n)

    def configurations(self, values: ArrayLike) -> FloatArray:
        """Return `values` as configurations (B, n); raise InputError for a wrong shape or what is not finite."""
        return finite_array(values, (None, self.n), "configurations")

    def way_points(self, values: ArrayLike, name: str = "path") -> FloatArray:
        """Return `values` as way points (N, n) of a path, between which joints move on straight lines.

        Raises InputError for a wrong shape, for what is not finite, and as `check_turns`.
        """
        points = finite_array(values, (None, self.n), name)
        self.check_turns(points[:-1], points[1:], name)
        return points

    def check_turns(self, starts: FloatArray, ends: FloatArray, name: str) -> None:
        """Raise InputError where a continuous joint turns by more than half a turn from `starts` to `ends: (B, n)`.

        There the straight motion that the numbers describe is another one than the motion by `difference`.
        """
        steps = ends - starts
        if self._wraps and (steps != self.difference(starts, ends)).any():
            k, i = np.unravel_index(np.abs(steps * self.continuous).argmax(), steps.shape)
            raise InputError(
                f"joint {self.joint_names[i]!r} turns by {steps[k, i]:.4g} rad after number {k}, more than half a turn:"
                " give a way point between, or angles that do not jump (np.unwrap) where the short way is meant",
                name,
            )

    def pinocchio_configuration(self, q: ArrayLike) -> FloatArray:
        """Return `q: (n,)` in Pinocchio's form (nq,): cosine and sine for each continuous joint, mimic joints too.

        An array of floats of the right shape is not looked at further: NaN passes.
        """
        if type(q) is not np.ndarray or q.shape != self._shape or q.dtype != _FLOAT:
            q = self.configuration(q)
        if self._plain:
            return q
        values = self.coupling.values(q)
        if not len(self._circular):
            return values
        full = np.empty(self._model.nq)
        full[self._straight] = values[~self._turning]
        full[self._circular] = np.cos(values[self._turning])
        full[self._circular + 1] = np.sin(values[self._turning])
        return full

    def difference(self, start: ArrayLike, end: ArrayLike) -> FloatArray:
        """Return the motion from `start` to `end` (matching shapes (…, n)); continuous joints go the short way."""
        delta: FloatArray = np.subtract(end, start, dtype=np.float64)
        if self._wraps:
            wrapped = delta[..., self.continuous]
            delta[..., self.continuous] = wrapped - 2 * np.pi * np.round(wrapped / (2 * np.pi))
        return delta

    def unrolled(self, path: FloatArray) -> FloatArray:
        """Return the path (N, n) with continuous joints that do not jump where they wrap; others stay as they are."""
        return unrolled(plain(path), self.continuous)

    def within_limits(self, q: ArrayLike, tolerance: float = _WITHIN) -> BoolArray:
        """Return for each joint whether `q: (n,)` respects its limits; continuous joints always do, NaN never."""
        values = np.asarray(q, dtype=np.float64)
        inside: BoolArray = (values >= self.lower - tolerance) & (values <= self.upper + tolerance)
        return inside | (self.continuous & np.isfinite(values)) if self._wraps else inside

    def beyond_limits(self, q: FloatArray) -> str | None:
        """Return which joint is outside its limits at `q: (n,)`, with its value and these; None if none is."""
        for i in () if self.joint_limits.hold(q) else np.flatnonzero(~self.within_limits(q)):
            value, low, high = told_apart(q[i], self.lower[i], self.upper[i])
            # A value of more than a turn that fits the limits in degrees was most likely meant in degrees.
            turned = np.radians(q[i])
            likely = abs(q[i]) > 2 * np.pi and self.lower[i] <= turned <= self.upper[i]
            hint = f"; degrees? {q[i]:g}° are {turned:.4g} rad" if likely and not self.prismatic[i] else ""
            return f"joint {self.joint_names[i]!r} = {value} is outside its limits [{low}, {high}]{hint}"
        return None

    def clipped_start(self, q: ArrayLike | Mapping[str, float], name: str = "start") -> FloatArray:
        """Return a start (n,) with values that are outside their limits by at most `START_TOLERANCE` brought to these.

        A warning names joint, value and limit: the motion to the limit is no part of what is planned or proven. Values
        farther outside stay as they are. Errors as `configuration`.
        """
        given = self.configuration(q, name)
        nearest = np.where(self.continuous, given, np.minimum(np.maximum(given, self.lower), self.upper))
        away = np.abs(given - nearest)
        if (away > START_TOLERANCE).any():
            return np.where(away > START_TOLERANCE, given, nearest)
        for i in np.flatnonzero(away > _WITHIN):
            value, limit = told_apart(given[i], nearest[i])
            _log.warning(
                "%s: joint %r = %s is outside its limit %s and clipped to it, as by at most %g; the motion there is "
                "not proven",
                *(name, self.joint_names[i], value, limit, START_TOLERANCE),
            )
        return nearest

    def keypoints(self, q: ArrayLike) -> FloatArray:
        """Return the key points of the skeleton (K, 3) [m] in the world frame at `q: (n,)`."""
        return self.keypoints_batch(self._checked(q)[None])[0]  # type: ignore[no-any-return]

    def keypoints_batch(self, Q: ArrayLike) -> FloatArray:
        """Return the key points (B, K, 3) [m] for a batch of configurations `Q: (B, n)`."""
        return self.kinematics.keypoint_table.places(plain(self.model_values(Q)))

    def joint_frames(self, Q: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return rotations (B, m, 3, 3), origins and axes (B, m, 3) of the joints in the world at `Q: (B, n)`."""
        return self.kinematics.table.frames(plain(self.coupling.values(Q)))

    def pull_back(self, Q: FloatArray, gradients: FloatArray) -> FloatArray:
        """Map gradients (B, K, 3) by the key points at `Q: (B, n)` to gradients (B, n) by the joints, Σ_k J_kᵀ g_k."""
        values, keypoints = plain(self.model_values(Q)), self.kinematics.keypoint_table
        return self.coupling.columns(keypoints.jacobian_transpose_product(values, plain(gradients)))

    def keypoint_motions(self, Q: FloatArray, delta: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return x [m], dx/dt and d²x/dt², (B, K, 3) each, of key points at `Q: (B, n)` at steady rates `delta`."""
        values, rates = plain(self.model_values(Q)), plain(self.coupling.motions(delta))
        return self.kinematics.keypoint_table.motions(values, rates)

    def tip_pose(self, q: ArrayLike) -> pin.SE3:
        """Return the pose of the tip frame at `q: (n,)` in the world frame."""
        data = self._scratch.own
        pin.framesForwardKinematics(self._model, data, self.pinocchio_configuration(self._checked(q)))
        return pin.SE3(data.oMf[self.tip_frame])

    def tip_jacobian(self, q: ArrayLike) -> FloatArray:
        """Return the Jacobian (6, n) of the tip: linear, then angular velocity, in world-aligned axes."""
        jacobian: FloatArray = pin.computeFrameJacobian(
            self._model,
            self._scratch.own,
            self.pinocchio_configuration(self._checked(q)),
            self.tip_frame,
            pin.ReferenceFrame.LOCAL_WORLD_ALIGNED,
        )
        return self.coupling.columns(jacobian)

    def model_values(self, Q: ArrayLike) -> FloatArray:
        """Return the values (B, m) of the model's joints at `Q: (B, n)`; what is an array of floats may hold NaN."""
        if type(Q) is not np.ndarray or Q.ndim != 2 or Q.shape[1] != self.n or Q.dtype != _FLOAT:
            Q = self.configurations(Q)
        return self.coupling.values(Q)

    @cached_property
    def joint_limits(self) -> JointLimits:
        """What says whether configurations are within the limits of the joints."""
        return JointLimits(self)

    def supporting_joints(self, joints: IntArray) -> BoolArray:
        """Return for each of Pinocchio's joints (K,) which of the m joints move it, (K, m)."""
        support = np.zeros((len(joints), self._model.nv), dtype=bool)
        for row, joint in enumerate(joints):
            support[row, self._chain.path_to_root(int(joint))] = True
        return support


class JointLimits:
    """Says whether a configuration is finite and within the joint limits of a robot."""

    def __init__(self, robot: ForwardKinematics) -> None:
        lower = np.where(robot.continuous, -_LARGEST, robot.lower - _WITHIN)
        upper = np.where(robot.continuous, _LARGEST, robot.upper + _WITHIN)
        coupling = robot.coupling
        mover = np.abs(coupling.matrix).argmax(axis=1)
        factors = np.take_along_axis(coupling.matrix, mover[:, None], axis=1)[:, 0]
        table = np.stack([mover, factors, coupling.offsets, robot.continuous[mover]], axis=1)
        self.table = EdgeTable(table, np.array([lower, upper]))

    def hold(self, q: FloatArray) -> bool:
        """Return whether `q: (n,)` is within limits; NaN and infinity never are."""
        return self.table.hold(q)

    def within(self, lower: FloatArray, upper: FloatArray) -> JointLimits:
        """Return the limits that demand of `q: (n,)` to be within other bounds, too."""
        narrower = copy(self)
        low, high = self.table.bounds
        narrower.table = EdgeTable(self.table.coupling, np.array([np.maximum(low, lower), np.minimum(high, upper)]))
        return narrower

    def hold_curves(self, curves: FloatArray) -> BoolArray:
        """Return of which motions (E,) of coefficients (E, d + 1, n) the control points prove that they hold."""
        low, high = self.table.bounds
        points = polynomials.bernstein(curves)
        return np.asarray(((low <= points) & (high >= points)).all(axis=(1, 2)))

    def left_by(self, curve: Sequence[FloatArray]) -> tuple[int, float] | None:
        """Return a joint that leaves its limits on the motion q(t) = Σ_k c_k t^k, t in [0, 1], and a t where it may.

        None is a proof that no joint does: control points of the Bernstein form hold the polynomial. A joint that comes
        within rounding of leaving is taken to leave. The `curve` is c_0 … c_d, each (n,).
        """
        low, high = self.table.bounds[:, :, None]
        waiting = [(0.0, 1.0, polynomials.bernstein(np.array(curve)[None])[0].T)]
        while waiting:
            begin, end, points = waiting.pop()
            outside = ((points < low) | (points > high)).any(axis=1)
            if not outside.any():
                continue
            for t, k in ((begin, 0), (end, -1)):
                beyond = (points[:, [k]] < low) | (points[:, [k]] > high)
                if beyond.any():
                    return int(beyond.argmax()), t
            if end - begin < _SHORTEST:
                return int(outside.argmax()), begin
            left, right = polynomials.halves(points)
            middle = 0.5 * (begin + end)
            waiting += [(middle, end, right), (begin, middle, left)]
        return None
