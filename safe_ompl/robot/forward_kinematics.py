"""Forward kinematics: configurations, joint limits, key points and their Jacobians, and the tip pose."""

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

# dtypes are compared with ==, because arrays of compiled modules can have an equal dtype that is another object.
_FLOAT = np.dtype(np.float64)
# Joint values may exceed their limits by this.
_WITHIN = 1e-9  # [rad or m]
# A start outside the joint limits by at most this is clipped to the limits, as in MoveIt.
START_TOLERANCE = 0.05  # [rad or m]
_LARGEST = sys.float_info.max
# Intervals of the motion's parameter are not bisected below this length. Undecided joints then count as leaving.
_SHORTEST = 1e-9


class KinematicTree:
    """Tables of m joints and of K key points at `offsets` [m] in the frames of `carriers`, for compiled code.

    `skeleton` is the table of the key points at the ends of the links (L, 2), with the links between them. Key points
    that always coincide, such as the joint origins of a spherical wrist, are merged there.
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
    """Return `array` as a C-contiguous writable float64 array for compiled code, without a copy if possible."""
    flags = array.flags
    if array.dtype == _FLOAT and flags.c_contiguous and flags.writeable:
        return array  # type: ignore[no-any-return]
    return np.require(array, np.float64, ["C", "W"])


@dataclass(frozen=True, eq=False, repr=False)
class Coupling:
    """The affine map from the n planned joints to the m joints of Pinocchio's model, matrix (m, n)·q + offsets.

    Without mimic joints the map is trivial: m = n, and the methods return their argument.
    """

    matrix: FloatArray
    offsets: FloatArray
    trivial: bool

    @classmethod
    def of(cls, joints: list[str], mimics: Mapping[str, Mimic]) -> Coupling:
        """Return the coupling of the model's `joints`. The joints in `mimics` must follow planned joints directly."""
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
        """Return the displacements (…, m) of the model's joints if the planned joints move by `delta: (…, n)`."""
        return delta if self.trivial else delta @ self.matrix.T

    def reach(self, steps: FloatArray) -> FloatArray:
        """Bound the displacements (…, m) of the model's joints if planned joints move by up to `steps: (…, n)` ≥ 0."""
        return steps if self.trivial else steps @ np.abs(self.matrix).T

    def radii(self, radii: FloatArray) -> FloatArray:
        """Convert motion bounds (…, m) to planned joints (…, n): Σ_j r_j·|Δ_j| ≤ Σ_i (Σ_j r_j·|c_ji|)·|Δ_i|."""
        return radii if self.trivial else radii @ np.abs(self.matrix)

    def columns(self, derivatives: FloatArray) -> FloatArray:
        """Convert derivatives (…, m) by the model's joints to derivatives (…, n) by the planned joints."""
        return derivatives if self.trivial else derivatives @ self.matrix


class ForwardKinematics:
    """Forward kinematics of a robot: joints, key points and tip.

    The n planned joints move the m ≥ n joints of Pinocchio's model; mimic joints make m > n. `joint_prismatic: (m,)`
    marks the prismatic joints, `joint_keypoint_support: (K, m)` the joints that move each key point. The tip is at
    `tip_placement` in the frame of `tip_joint`.
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
        # If this is true, Pinocchio's configurations equal those of the package.
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
        """Return `value`, an array-like or a mapping of all joint names to values, as a configuration (n,).

        Raises InputError, which starts with `name`, if the shape is wrong, a number is not finite, or a joint is
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
        """Return `configuration(q)`, ten times as fast if `q` is a float array (n,)."""
        return self.configuration(q) if isinstance(q, Mapping) else configuration(q, self.n)

    def configurations(self, values: ArrayLike) -> FloatArray:
        """Return `values` as configurations (B, n). Raises InputError for a wrong shape, NaN or infinity."""
        return finite_array(values, (None, self.n), "configurations")

    def way_points(self, values: ArrayLike, name: str = "path") -> FloatArray:
        """Return `values` as way points (N, n) of a path of straight segments in joint space.

        Raises InputError for a wrong shape, NaN or infinity, and as `check_turns`.
        """
        points = finite_array(values, (None, self.n), name)
        self.check_turns(points[:-1], points[1:], name)
        return points

    def check_turns(self, starts: FloatArray, ends: FloatArray, name: str) -> None:
        """Raise InputError if a continuous joint moves by more than π from `starts` to `ends: (B, n)`.

        For such a motion, interpolating the numbers gives another motion than `difference`.
        """
        steps = ends - starts
        if self._wraps and (steps != self.difference(starts, ends)).any():
            k, i = np.unravel_index(np.abs(steps * self.continuous).argmax(), steps.shape)
            raise InputError(
                f"joint {self.joint_names[i]!r} turns by {steps[k, i]:.4g} rad after number {k}, more than half a turn:"
                " add a way point between, or unwrap the angles (np.unwrap)",
                name,
            )

    def pinocchio_configuration(self, q: ArrayLike) -> FloatArray:
        """Return `q: (n,)` as Pinocchio's configuration (nq,): continuous joints as cosine and sine, with mimic joints.

        A float array of the right shape is not checked for NaN.
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
        """Return the displacement from `start` to `end`, both (…, n), as `pin.difference`: continuous joints in ±π."""
        delta: FloatArray = np.subtract(end, start, dtype=np.float64)
        if self._wraps:
            wrapped = delta[..., self.continuous]
            delta[..., self.continuous] = wrapped - 2 * np.pi * np.round(wrapped / (2 * np.pi))
        return delta

    def unrolled(self, path: FloatArray) -> FloatArray:
        """Return the path (N, n) with the jumps of continuous joints at ±π removed, as by `np.unwrap`."""
        return unrolled(plain(path), self.continuous)

    def within_limits(self, q: ArrayLike, tolerance: float = _WITHIN) -> BoolArray:
        """Return for each joint (n,) whether `q: (n,)` is within its limits: continuous joints always, NaN never."""
        values = np.asarray(q, dtype=np.float64)
        inside: BoolArray = (values >= self.lower - tolerance) & (values <= self.upper + tolerance)
        return inside | (self.continuous & np.isfinite(values)) if self._wraps else inside

    def beyond_limits(self, q: FloatArray) -> str | None:
        """Describe the first joint outside its limits at `q: (n,)`, with value and limits; None if there is none."""
        for i in () if self.joint_limits.hold(q) else np.flatnonzero(~self.within_limits(q)):
            value, low, high = told_apart(q[i], self.lower[i], self.upper[i])
            # If a value above 2π is within the limits when read as degrees, it was most likely given in degrees.
            turned = np.radians(q[i])
            likely = abs(q[i]) > 2 * np.pi and self.lower[i] <= turned <= self.upper[i]
            hint = f"; degrees? {q[i]:g}° are {turned:.4g} rad" if likely and not self.prismatic[i] else ""
            return f"joint {self.joint_names[i]!r} = {value} is outside its limits [{low}, {high}]{hint}"
        return None

    def clipped_start(self, q: ArrayLike | Mapping[str, float], name: str = "start") -> FloatArray:
        """Return a start (n,) with values clipped that exceed their limits by at most `START_TOLERANCE`.

        A warning names joint, value and limit: the motion to the limit is neither planned nor proven. Values farther
        outside are not changed. Raises as `configuration`.
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

    def jacobian_transpose_product(self, Q: FloatArray, gradients: FloatArray) -> FloatArray:
        """Return Σ_k J_kᵀ g_k (B, n) for gradients g (B, K, 3) by the key points at `Q: (B, n)`."""
        values, keypoints = plain(self.model_values(Q)), self.kinematics.keypoint_table
        return self.coupling.columns(keypoints.jacobian_transpose_product(values, plain(gradients)))

    def keypoint_motions(self, Q: FloatArray, delta: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return x [m], dx/dt and d²x/dt², each (B, K, 3), of the key points at `Q: (B, n)` for constant dq/dt."""
        values, rates = plain(self.model_values(Q)), plain(self.coupling.motions(delta))
        return self.kinematics.keypoint_table.motions(values, rates)

    def tip_pose(self, q: ArrayLike) -> pin.SE3:
        """Return the pose of the tip frame at `q: (n,)` in the world frame."""
        data = self._scratch.own
        pin.framesForwardKinematics(self._model, data, self.pinocchio_configuration(self._checked(q)))
        return pin.SE3(data.oMf[self.tip_frame])

    def tip_positions(self, Q: FloatArray) -> FloatArray:
        """Return the positions (B, 3) [m] of the tip frame in the world frame at `Q: (B, n)`."""
        place = self.tip_placement.translation
        if not self.tip_joint:
            return np.tile(place, (len(Q), 1))
        rotations, origins, _ = self.joint_frames(Q)
        return np.asarray(origins[:, self.tip_joint - 1] + rotations[:, self.tip_joint - 1] @ place)

    def tip_jacobian(self, q: ArrayLike) -> FloatArray:
        """Return the Jacobian (6, n) of the tip, linear before angular rows, in world-aligned axes."""
        jacobian: FloatArray = pin.computeFrameJacobian(
            self._model,
            self._scratch.own,
            self.pinocchio_configuration(self._checked(q)),
            self.tip_frame,
            pin.ReferenceFrame.LOCAL_WORLD_ALIGNED,
        )
        return self.coupling.columns(jacobian)

    def model_values(self, Q: ArrayLike) -> FloatArray:
        """Return the values (B, m) of the model's joints at `Q: (B, n)`. A float array is not checked for NaN."""
        if type(Q) is not np.ndarray or Q.ndim != 2 or Q.shape[1] != self.n or Q.dtype != _FLOAT:
            Q = self.configurations(Q)
        return self.coupling.values(Q)

    @cached_property
    def joint_limits(self) -> JointLimits:
        """Test of joint limits for configurations and motions."""
        return JointLimits(self)

    def supporting_joints(self, joints: IntArray) -> BoolArray:
        """Return which of the m joints move each of Pinocchio's `joints: (K,)`, as booleans (K, m)."""
        support = np.zeros((len(joints), self._model.nv), dtype=bool)
        for row, joint in enumerate(joints):
            support[row, self._chain.path_to_root(int(joint))] = True
        return support


class JointLimits:
    """Joint limits of a robot, with tests for configurations and polynomial motions."""

    def __init__(self, robot: ForwardKinematics) -> None:
        lower = np.where(robot.continuous, -_LARGEST, robot.lower - _WITHIN)
        upper = np.where(robot.continuous, _LARGEST, robot.upper + _WITHIN)
        coupling = robot.coupling
        mover = np.abs(coupling.matrix).argmax(axis=1)
        factors = np.take_along_axis(coupling.matrix, mover[:, None], axis=1)[:, 0]
        table = np.stack([mover, factors, coupling.offsets, robot.continuous[mover]], axis=1)
        self.table = EdgeTable(table, np.array([lower, upper]))

    def hold(self, q: FloatArray) -> bool:
        """Return whether `q: (n,)` is finite and within the limits."""
        return self.table.hold(q)

    def within(self, lower: FloatArray, upper: FloatArray) -> JointLimits:
        """Return the intersection of these limits with the bounds `lower` and `upper`, each (n,)."""
        narrower = copy(self)
        low, high = self.table.bounds
        narrower.table = EdgeTable(self.table.coupling, np.array([np.maximum(low, lower), np.minimum(high, upper)]))
        return narrower

    def hold_curves(self, curves: FloatArray) -> BoolArray:
        """Return which motions (E,), with coefficients (E, d + 1, n), have all Bézier control points within the limits.

        Such a motion is proven to be within the limits.
        """
        low, high = self.table.bounds
        points = polynomials.bernstein(curves)
        return np.asarray(((low <= points) & (high >= points)).all(axis=(1, 2)))

    def left_by(self, curve: Sequence[FloatArray]) -> tuple[int, float] | None:
        """Return a joint that leaves its limits on the motion q(t) = Σ_k c_k t^k, t in [0, 1], with a t where it may.

        None proves that no joint leaves, since a polynomial is in the convex hull of its Bézier control points. A joint
        within rounding of its limit counts as leaving. The `curve` is c_0 … c_d, each (n,).
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
