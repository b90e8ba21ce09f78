"""The robot: kinematics on Pinocchio, its skeleton, and how far its bodies can move."""

from __future__ import annotations

import logging
import threading
from collections.abc import Mapping, Sequence
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.lib.stride_tricks import as_strided

from safe_ompl.arrays import BoolArray, FloatArray, IntArray
from safe_ompl.errors import InputError, UnknownNameError
from safe_ompl.maths.halton import halton_point
from safe_ompl.models.convex import make_convex, sample_configurations, select_self_pairs
from safe_ompl.models.displacement import Hull, JointChain, bounding_hull
from safe_ompl.models.examples import find_example, robots_folder
from safe_ompl.models.skeleton import Skeleton, frame_index
from safe_ompl.models.urdf import UrdfFile, existing_file

_log = logging.getLogger(__name__)

_RATE_SAMPLES = range(1, 101, 4)  # points of Halton's sequence: always the same, and cheap enough
_LINK = " (link)"  # tells a link from a joint of the same name


class Robot:
    """A robot of revolute, prismatic and continuous joints; frozen once built.

    Build one with `Robot.from_urdf` or `Robot.from_example`. A configuration is an array `q: (n,)` of joint values
    [rad or m], in the order of `joint_names`; continuous joints take angles and wrap at ±π.

    Attributes
    ----------
    name : str
        Name for reports.
    joint_names : tuple of str
        The n joints that move.
    lower, upper : ndarray, shape (n,)
        Joint limits [rad or m]; ±π for continuous joints.
    continuous, prismatic : ndarray of bool, shape (n,)
        Which joints wrap, which slide.
    tip : str
        The frame at the end of the arm.
    segments : ndarray, shape (L, 2)
        Link segments of the skeleton as pairs of key points.
    segment_names : tuple of str
        For each segment the frame at its distal end.
    model : pin.Model
        Pinocchio's model of the joints that move.
    collision_model : pin.GeometryModel
        Convex bodies of the links, with the pairs of them that are checked against each other.
    """

    def __init__(
        self,
        urdf: UrdfFile,
        srdf: str | None,
        tip: str | None,
        locked: Mapping[str, float],
        hulls: bool,
        name: str | None,
        limits: Mapping[str, tuple[float, float]],
    ) -> None:
        full = urdf.build_model()
        _override_limits(full, limits, str(urdf.path))
        self.name = name or full.name or urdf.path.stem
        self._recipe: dict[str, Any] = {
            "urdf": str(urdf.path),
            "srdf": srdf,
            "package_dirs": tuple(urdf.package_dirs),
            "tip": tip,
            "locked": dict(locked),
            "hulls": hulls,
            "name": self.name,
            "limits": dict(limits),
        }
        if tip is not None and not full.existFrame(tip):
            raise UnknownNameError(
                "tip frame", tip, (frame.name for frame in list(full.frames)[1:]), str(urdf.path)
            )
        held = _joints_to_hold(full, urdf, tip, locked)
        self._held = held
        geometry = urdf.build_geometry(full, pin.GeometryType.COLLISION)
        self.model, self.collision_model = _reduce(full, geometry, held)
        self._check_joints(str(urdf.path))
        if hulls:
            make_convex(self.collision_model)

        self.joint_names: tuple[str, ...] = tuple(self.model.names)[1:]
        self.n: int = len(self.joint_names)
        self.continuous: BoolArray = np.array([j.nq == 2 for j in list(self.model.joints)[1:]])
        self._wraps = bool(self.continuous.any())
        self.prismatic: BoolArray = np.array(["P" in j.shortname()[10:] for j in list(self.model.joints)[1:]])
        self.lower, self.upper = self._limits(str(urdf.path))
        select_self_pairs(
            self.model, self.collision_model, srdf, sample_configurations(self.model), self.name
        )

        self.tip: str = tip or _farthest_body(self.model)
        self.tip_frame: int = frame_index(self.model, self.tip)
        skeleton = Skeleton.from_model(self.model, list(full.names)[1:], self.tip)
        self.segments: IntArray = skeleton.segments
        self.segment_names = skeleton.names
        self._key_joints, self._key_offsets = skeleton.joints, skeleton.offsets
        self._shifted = np.flatnonzero(np.abs(skeleton.offsets).max(axis=1) > 0)
        self.chain = self._joint_chain()
        self._support = self._supporting_joints(skeleton.joints)
        self._moved_by: FloatArray = self._support.T.astype(np.float64)  # (n, K)
        self._scratch = _Scratch(self.model)
        for array in (self.lower, self.upper, self.segments, self.continuous, self.prismatic):
            array.setflags(write=False)

    # ------------------------------------------------------------------------------------------ construction

    @classmethod
    def from_urdf(
        cls,
        urdf: str | Path,
        srdf: str | Path | None = None,
        package_dirs: Sequence[str | Path] = (),
        tip: str | None = None,
        locked: Mapping[str, float] | None = None,
        *,
        hulls: bool = True,
        name: str | None = None,
        limits: Mapping[str, tuple[float, float]] | None = None,
    ) -> Robot:
        """Build a robot from its URDF.

        Parameters
        ----------
        urdf : path-like
            The URDF.
        srdf : path-like, optional
            SRDF whose disabled collision pairs are not checked. Without one, or with one that disables nothing,
            pairs of adjacent links and pairs that are always in contact are dropped, and the log says which.
        package_dirs : sequence of path-like
            Folders that hold the packages of `package://` names; those above the URDF are searched as well.
        tip : str, optional
            Frame at the end of the arm. Joints that do not move it are locked (the log says so). Default: the body
            farthest from the base.
        locked : mapping of str to float, optional
            Joints to hold still, with their values [rad or m]. A joint that mimics a locked one is locked with it.
        hulls : bool
            Replace meshes by their convex hulls (solid and fast). False keeps the meshes, which are hollow.
        name : str, optional
            Name for reports; the URDF's by default.
        limits : mapping of str to (float, float), optional
            Joint limits that replace the URDF's [rad or m].

        Raises
        ------
        InputError
            Missing or malformed file, missing mesh, unknown joint or frame, unsupported joint type.
        """
        srdf_file = None if srdf is None else str(existing_file(srdf, "SRDF"))
        return cls(
            UrdfFile(urdf, package_dirs), srdf_file, tip, dict(locked or {}), hulls, name, dict(limits or {})
        )

    @classmethod
    def from_example(
        cls,
        name: str,
        *,
        tip: str | None = None,
        locked: Mapping[str, float] | None = None,
        hulls: bool = True,
    ) -> Robot:
        """Build a robot of example-robot-data.

        Parameters
        ----------
        name : str
            A key of `safe_ompl.models.examples.EXAMPLES`: "panda", "ur5", "xarm7", "kinova", …
        tip, locked, hulls
            As in `from_urdf`; by default those of the table of examples.

        Raises
        ------
        UnknownNameError
            If there is no such robot.
        """
        example = find_example(name)
        folder = robots_folder()
        return cls.from_urdf(
            folder / example.urdf,
            folder / example.srdf if example.srdf else None,
            (folder.parents[1],),
            tip or example.tip,
            example.locked if locked is None else locked,
            hulls=hulls,
            name=name,
        )

    def with_limits(self, limits: Mapping[str, tuple[float, float]]) -> Robot:
        """Return the same robot with other limits [rad or m] for the joints named."""
        return _rebuild({**self._recipe, "limits": {**self._recipe["limits"], **limits}})

    def __reduce__(self) -> tuple[Any, ...]:
        return _rebuild, (self._recipe,)

    def __repr__(self) -> str:
        return f"Robot({self.name!r}, joints={list(self.joint_names)}, tip={self.tip!r})"

    # ---------------------------------------------------------------------------------------- configurations

    def pinocchio_configuration(self, q: FloatArray) -> FloatArray:
        """Return `q: (n,)` in Pinocchio's form (nq,): cosine and sine for each continuous joint."""
        if not self._wraps:
            return q
        full = np.empty(self.model.nq)
        full[self._straight] = q[~self.continuous]
        full[self._circular] = np.cos(q[self.continuous])
        full[self._circular + 1] = np.sin(q[self.continuous])
        return full

    def difference(self, start: FloatArray, end: FloatArray) -> FloatArray:
        """Return the motion from `start` to `end` (matching shapes (…, n)); continuous joints go the short way."""
        delta = end - start
        if self._wraps:
            wrapped = delta[..., self.continuous]
            delta[..., self.continuous] = wrapped - 2 * np.pi * np.round(wrapped / (2 * np.pi))
        return delta

    def within_limits(self, q: FloatArray, tolerance: float = 1e-9) -> BoolArray:
        """Return for each joint whether `q: (n,)` respects its limits; continuous joints always do."""
        inside: BoolArray = (q >= self.lower - tolerance) & (q <= self.upper + tolerance)
        return inside | self.continuous

    def named(self, q: FloatArray) -> dict[str, float]:
        """Return `q: (n,)` as a mapping from joint name to value."""
        return dict(zip(self.joint_names, q.tolist(), strict=True))

    # -------------------------------------------------------------------------------------------- kinematics

    def keypoints(self, q: FloatArray) -> FloatArray:
        """Return the key points of the skeleton (K, 3) [m] in the world frame at `q: (n,)`."""
        rotation, translation = self._scratch.forward(self.pinocchio_configuration(q))
        points: FloatArray = translation[self._key_joints]
        at = self._shifted
        points[at] += (rotation[self._key_joints[at]] @ self._key_offsets[at, :, None])[..., 0]
        return points

    def keypoints_batch(self, Q: FloatArray) -> FloatArray:
        """Return the key points (B, K, 3) [m] for a batch of configurations `Q: (B, n)`."""
        return self._keypoints_of(*self._poses(Q))

    def pull_back(self, Q: FloatArray, gradients: FloatArray) -> FloatArray:
        """Map gradients with respect to the key points to gradients with respect to the joints, Σ_k J_kᵀ g_k.

        Parameters
        ----------
        Q : ndarray, shape (B, n)
            Configurations.
        gradients : ndarray, shape (B, K, 3)
            Gradient with respect to each key point.

        Returns
        -------
        ndarray, shape (B, n)
        """
        rotation, translation = self._poses(Q)
        axes, origins = self._axes_of(rotation), translation[:, 1:]
        force = self._moved_by @ gradients
        torque = self._moved_by @ _cross(self._keypoints_of(rotation, translation), gradients)
        turning = torque - _cross(origins, force)
        pulled: FloatArray = np.einsum("bic,bic->bi", axes, np.where(self.prismatic[:, None], force, turning))
        return pulled

    def keypoint_jacobians(self, q: FloatArray) -> FloatArray:
        """Return the Jacobians (K, 3, n) of the key points at `q: (n,)`, in the world frame."""
        axes, origins = (a[0] for a in self._axes(q[None]))
        arms = self.keypoints(q)[:, None, :] - origins
        columns = np.where(self.prismatic[:, None], axes, np.cross(axes, arms))
        return np.swapaxes(columns * self._support[:, :, None], 1, 2)

    def keypoint_motions(self, Q: FloatArray, delta: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return positions, velocities and accelerations of the key points while the joints move at a steady rate.

        Parameters
        ----------
        Q : ndarray, shape (B, n)
            Configurations.
        delta : ndarray, shape (B, n)
            Rate of the joints, such as the Δ of an edge q₁ + tΔ.

        Returns
        -------
        three ndarrays, shape (B, K, 3)
            x [m], dx/dt and d²x/dt² [m, for t without unit].
        """
        data, model, steady = self._scratch.data, self.model, np.zeros(self.n)
        rotation, translation = np.empty((len(Q), model.njoints, 3, 3)), np.empty((len(Q), model.njoints, 3))
        rates = np.empty((2, len(Q), model.njoints, 6))
        for row, (q, rate) in enumerate(zip(Q, delta, strict=True)):
            pin.forwardKinematics(model, data, self.pinocchio_configuration(q), rate, steady)
            rotation[row], translation[row] = self._scratch.poses
            rates[0, row] = [motion.vector for motion in data.v]
            rates[1, row] = [motion.vector for motion in data.a]
        turning = rotation[:, self._key_joints]
        (linear, angular), (push, twist) = (
            (rate[..., :3], rate[..., 3:]) for rate in rates[:, :, self._key_joints]
        )
        velocity = linear + _cross(angular, self._key_offsets)  # in the frames of the joints
        acceleration = push + _cross(twist, self._key_offsets) + _cross(angular, velocity)
        velocity, acceleration = ((turning @ rate[..., None])[..., 0] for rate in (velocity, acceleration))
        return self._keypoints_of(rotation, translation), velocity, acceleration

    def body_points(
        self, Q: FloatArray, rows: IntArray, joints: IntArray, points: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Return where points of bodies are, and what moves them.

        Parameters
        ----------
        Q : ndarray, shape (B, n)
            Configurations.
        rows : ndarray of int, shape (C,)
            The configuration for each point.
        joints : ndarray of int, shape (C,)
            Pinocchio's number of the joint that carries it.
        points : ndarray, shape (C, 3)
            In the frame of that joint [m].

        Returns
        -------
        places : ndarray, shape (C, 3)
            In the world frame [m].
        jacobians : ndarray, shape (C, n, 3)
            Velocity of the point per unit of each joint's rate; the Jacobian, transposed.
        """
        rotation, translation = (poses[rows] for poses in self._poses(Q))
        each = np.arange(len(rows))
        places = translation[each, joints] + (rotation[each, joints] @ points[:, :, None])[..., 0]
        axes = self._axes_of(rotation)
        turning = _cross(axes, places[:, None] - translation[:, 1:])
        columns = np.where(self.prismatic[:, None], axes, turning)
        return places, columns * self._moves_joint[joints][:, :, None]

    def tip_pose(self, q: FloatArray) -> pin.SE3:
        """Return the pose of the tip frame at `q: (n,)` in the world frame."""
        data = self._scratch.data
        pin.framesForwardKinematics(self.model, data, self.pinocchio_configuration(q))
        return pin.SE3(data.oMf[self.tip_frame])

    def tip_jacobian(self, q: FloatArray) -> FloatArray:
        """Return the Jacobian (6, n) of the tip: linear, then angular velocity, in world-aligned axes."""
        jacobian: FloatArray = pin.computeFrameJacobian(
            self.model,
            self._scratch.data,
            self.pinocchio_configuration(q),
            self.tip_frame,
            pin.ReferenceFrame.LOCAL_WORLD_ALIGNED,
        )
        return jacobian

    # ------------------------------------------------------------------------------------------ displacement

    @cached_property
    def displacement_radii(self) -> FloatArray:
        """Proven radii R̄ (G, n): no point of body g moves more than Σ_i R̄_gi·|Δ_i|, at any configuration.

        Rows follow `collision_model.geometryObjects`. See `safe_ompl.models.displacement`.
        """
        radii = [
            self.chain.radii(part.parentJoint, bounding_hull(part.geometry).moved(part.placement))
            for part in self.collision_model.geometryObjects
        ]
        return np.array(radii).reshape(-1, self.n)

    @cached_property
    def keypoint_radii(self) -> FloatArray:
        """Proven radii R̄ (K, n) of the key points of the skeleton; otherwise like `displacement_radii`."""
        keys = zip(self._key_joints, self._key_offsets, strict=True)
        return np.array([self.chain.radii(int(joint), Hull(offset[None], 0.0)) for joint, offset in keys])

    def keypoint_reaches(self, points: FloatArray) -> FloatArray:
        """Return how far (K, M) [m] each key point can ever be from fixed `points: (M, 3)`, at most; proven."""
        reaches = np.empty((len(self._key_joints), len(points)))
        for k, (joint, offset) in enumerate(zip(self._key_joints, self._key_offsets, strict=True)):
            if joint == 0:
                reaches[k] = np.linalg.norm(points - offset, axis=1)
            else:
                region = self.chain.reach(int(joint), Hull(offset[None], 0.0))
                reaches[k] = [region.farthest(Hull(point[None], 0.0)) for point in points]
        return reaches

    @property
    def keypoint_support(self) -> BoolArray:
        """Which joints move each key point, (K, n)."""
        return self._support

    def displacement_radii_at(self, q: FloatArray) -> FloatArray:
        """Return the radii R (G, n) at `q: (n,)`: the distance of body g's farthest point from joint i's axis.

        Tighter than `displacement_radii`, and dearer. Between `q` and q + Δ no point of body g moves more than
        Σ_i R_gi·|Δ_i| (`math.md` §3: the radii at the centre are enough).
        """
        rotation, translation = self._poses(q[None])
        axes, origins = (a[0] for a in self._axes(q[None]))
        joints, corners, pads, support = self._body_corners
        world = np.einsum("gij,gpj->gpi", rotation[0, joints], corners) + translation[0, joints][:, None]
        arms = world[:, None] - origins[:, None]
        along = np.einsum("gipc,ic->gip", arms, axes)
        squared = np.einsum("gipc,gipc->gip", arms, arms) - along**2
        radii = np.sqrt(np.maximum(squared, 0).max(axis=2)) + pads[:, None]
        return np.where(self.prismatic, 1.0, radii) * support

    @cached_property
    def arm_rates(self) -> FloatArray:
        """How far (n,) the joints move the arm at most, on an average over configurations [m/rad]."""
        sides = self.upper - self.lower
        spread = [self.lower + sides * halton_point(k, self.n) for k in _RATE_SAMPLES]
        rates: FloatArray = np.mean([self.displacement_radii_at(q).max(axis=0) for q in spread], axis=0)
        rates.setflags(write=False)
        return rates

    @cached_property
    def visual_model(self) -> pin.GeometryModel:
        """The robot's visual geometry; its collision bodies where the visual meshes are missing."""
        recipe = self._recipe
        urdf = UrdfFile(recipe["urdf"], recipe["package_dirs"])
        full = urdf.build_model()
        try:
            geometry = urdf.build_geometry(full, pin.GeometryType.VISUAL)
        except InputError as error:
            _log.warning("%s: drawing its collision bodies (%s)", self.name, error)
            return self.collision_model
        if not len(geometry.geometryObjects):
            return self.collision_model
        return _reduce(full, geometry, self._held)[1]

    # ---------------------------------------------------------------------------------------------- internals

    def _poses(self, Q: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Rotations (B, J, 3, 3) and origins (B, J, 3) of all joint frames."""
        scratch = self._scratch
        if scratch.batch is not None and np.array_equal(scratch.batch[0], Q):
            return scratch.batch[1:]  # a gradient asks for them three times
        joints = self.model.njoints
        rotation, translation = np.empty((len(Q), joints, 3, 3)), np.empty((len(Q), joints, 3))
        for row, q in enumerate(Q):
            rotation[row], translation[row] = scratch.forward(self.pinocchio_configuration(q))
        rotation.setflags(write=False)
        translation.setflags(write=False)
        scratch.batch = Q.copy(), rotation, translation
        return rotation, translation

    def _axes(self, Q: FloatArray) -> tuple[FloatArray, FloatArray]:
        """World axes (B, n, 3) and origins (B, n, 3) of the joints."""
        rotation, translation = self._poses(Q)
        return self._axes_of(rotation), translation[:, 1:]

    def _axes_of(self, rotation: FloatArray) -> FloatArray:
        axes: FloatArray = (rotation[:, 1:] @ self.chain.axes[:, :, None])[..., 0]
        return axes

    def _keypoints_of(self, rotation: FloatArray, translation: FloatArray) -> FloatArray:
        points: FloatArray = translation[:, self._key_joints]
        at = self._shifted
        points[:, at] += (rotation[:, self._key_joints[at]] @ self._key_offsets[at, :, None])[..., 0]
        return points

    @cached_property
    def _body_corners(self) -> tuple[IntArray, FloatArray, FloatArray, BoolArray]:
        parts = list(self.collision_model.geometryObjects)
        hulls = [bounding_hull(part.geometry, coarse=True).moved(part.placement) for part in parts]
        corners = np.array([np.resize(hull.points, (8, 3)) for hull in hulls]).reshape(-1, 8, 3)
        joints = np.array([part.parentJoint for part in parts], dtype=np.intp)
        return joints, corners, np.array([hull.radius for hull in hulls]), self._supporting_joints(joints)

    @cached_property
    def _moves_joint(self) -> BoolArray:
        """Which of the n joints move each of Pinocchio's joints, (J, n)."""
        support = self._supporting_joints(np.arange(1, self.model.njoints))
        return np.vstack([np.zeros((1, self.n), dtype=bool), support])

    def _supporting_joints(self, joints: IntArray) -> BoolArray:
        """For each of the Pinocchio joints (K,): which of the n joints move it (K, n)."""
        support = np.zeros((len(joints), self.n), dtype=bool)
        for row, joint in enumerate(joints):
            support[row, self.chain.path_to_root(int(joint))] = True
        return support

    def _joint_chain(self) -> JointChain:
        model = self.model
        axes = np.zeros((self.n, 3))
        neutral = pin.neutral(model)
        for i, joint in enumerate(list(model.joints)[1:]):
            joint_data = joint.createData()
            joint.calc(joint_data, neutral)
            subspace = np.asarray(joint_data.S, dtype=np.float64).ravel()
            axes[i] = subspace[:3] if self.prismatic[i] else subspace[3:]
        return JointChain(
            [int(parent) for parent in model.parents][1:],
            [pin.SE3(placement) for placement in model.jointPlacements][1:],
            axes,
            self.prismatic,
            self.lower,
            self.upper,
        )

    def _check_joints(self, source: str) -> None:
        if self.model.njoints < 2:
            raise InputError("no joint is free to move", source)
        for name, joint in zip(list(self.model.names)[1:], list(self.model.joints)[1:], strict=True):
            if joint.nv != 1 or joint.shortname().startswith(("JointModelH", "JointModelMimic")):
                raise InputError(
                    f"joint {name!r} is a {joint.shortname()}; only revolute, prismatic and continuous joints "
                    "can be planned for: lock it",
                    source,
                )

    def _limits(self, source: str) -> tuple[FloatArray, FloatArray]:
        joints = list(self.model.joints)[1:]
        self._straight: IntArray = np.array([j.idx_q for j in joints if j.nq == 1], dtype=np.intp)
        self._circular: IntArray = np.array([j.idx_q for j in joints if j.nq == 2], dtype=np.intp)
        lower, upper = np.full(self.n, -np.pi), np.full(self.n, np.pi)
        lower[~self.continuous] = self.model.lowerPositionLimit[self._straight]
        upper[~self.continuous] = self.model.upperPositionLimit[self._straight]
        for name, low, high in zip(self.joint_names, lower, upper, strict=True):
            if not (np.isfinite(low) and np.isfinite(high) and low < high):
                raise InputError(
                    f"joint {name!r} has the limits [{low}, {high}]: no range to plan in; lock it", source
                )
        return lower, upper


class _Scratch(threading.local):
    """Pinocchio's working memory, one for each thread, with views on the joint poses it holds."""

    def __init__(self, model: pin.Model) -> None:
        self._model = model
        self.data = model.createData()
        # All poses lie in one block of memory: one strided view costs a thirtieth of reading them one by one.
        first, second = (self.data.oMi[joint].rotation for joint in (0, 1))
        stride = second.ctypes.data - first.ctypes.data
        origin = self.data.oMi[0].translation
        self._rotation = as_strided(first, (model.njoints, 3, 3), (stride, *first.strides))
        self._translation = as_strided(origin, (model.njoints, 3), (stride, *origin.strides))
        self.batch: tuple[FloatArray, FloatArray, FloatArray] | None = None  # configurations, and their poses

    def forward(self, q: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return views of the rotations (J, 3, 3) and origins (J, 3) of the joint frames at `q: (nq,)`."""
        pin.forwardKinematics(self._model, self.data, q)
        return self.poses

    @property
    def poses(self) -> tuple[FloatArray, FloatArray]:
        """The views on the poses found last."""
        return self._rotation, self._translation


_NEXT, _AFTER_NEXT = np.array([1, 2, 0]), np.array([2, 0, 1])


def _cross(a: FloatArray, b: FloatArray) -> FloatArray:
    """Return a × b along the last axis; np.cross takes four times as long on small arrays."""
    return a.take(_NEXT, -1) * b.take(_AFTER_NEXT, -1) - a.take(_AFTER_NEXT, -1) * b.take(_NEXT, -1)


def _rebuild(recipe: dict[str, Any]) -> Robot:
    return Robot.from_urdf(**recipe)


def _override_limits(full: pin.Model, limits: Mapping[str, tuple[float, float]], source: str) -> None:
    for name, (low, high) in limits.items():
        if not full.existJointName(name):
            raise UnknownNameError("joint with limits", name, list(full.names)[1:], source)
        joint = full.joints[full.getJointId(name)]
        if joint.nq != 1:
            raise InputError(f"joint {name!r} is continuous: it has no limits", source)
        full.lowerPositionLimit[joint.idx_q] = low
        full.upperPositionLimit[joint.idx_q] = high


def _joints_to_hold(
    full: pin.Model, urdf: UrdfFile, tip: str | None, locked: Mapping[str, float]
) -> dict[str, float]:
    """Return the joints to lock with their values: those asked for, those that do not move the tip, and mimics."""
    source = str(urdf.path)
    names = list(full.names)[1:]
    held: dict[str, float] = {}
    for name, value in locked.items():
        if name not in names:
            raise UnknownNameError("joint to lock", name, names, source)
        held[name] = _joint_value(full, name, value, source)
    followers = {name: mimic for name, mimic in urdf.mimics().items() if name in names and name not in held}
    if tip is not None:
        moving = {full.names[j] for j in full.supports[full.frames[frame_index(full, tip)].parentJoint]}
        for name in names:
            if name not in moving and name not in held and name not in followers:
                held[name] = _resting_value(full, name)
    while followers:
        ready = [name for name, mimic in followers.items() if mimic.primary in held]
        if not ready:
            name, mimic = next(iter(followers.items()))
            raise InputError(
                f"joint {name!r} mimics {mimic.primary!r}, which is free: lock {mimic.primary!r}", source
            )
        for name in ready:
            mimic = followers.pop(name)
            held[name] = mimic.multiplier * held[mimic.primary] + mimic.offset
    implied = ", ".join(f"{name} = {value:g}" for name, value in held.items() if name not in locked)
    if implied:
        _log.info("%s: locked, too, as not moving the tip or mimicking: %s", urdf.path.name, implied)
    return held


def _joint_value(full: pin.Model, name: str, value: float, source: str) -> float:
    try:
        number = float(value)
    except (TypeError, ValueError):
        raise InputError(f"locked joint {name!r}: {value!r} is not a number", source) from None
    joint = full.joints[full.getJointId(name)]
    if not np.isfinite(number):
        raise InputError(f"locked joint {name!r}: {value!r} is not finite", source)
    if joint.nv > 1 and number != 0:
        raise InputError(f"locked joint {name!r}: a {joint.shortname()} can be locked at 0 only", source)
    if joint.nq == 1:
        low, high = (
            float(limit[joint.idx_q]) for limit in (full.lowerPositionLimit, full.upperPositionLimit)
        )
        if not low - 1e-9 <= number <= high + 1e-9:
            raise InputError(
                f"locked joint {name!r}: {number:g} is outside its limits [{low:g}, {high:g}]", source
            )
    return number


def _resting_value(full: pin.Model, name: str) -> float:
    """Zero, or the limit nearest to it."""
    joint = full.joints[full.getJointId(name)]
    if joint.nq != 1:
        return 0.0
    low, high = (float(limit[joint.idx_q]) for limit in (full.lowerPositionLimit, full.upperPositionLimit))
    return float(min(max(0.0, low), high))


def _reduce(
    full: pin.Model, geometry: pin.GeometryModel, held: Mapping[str, float]
) -> tuple[pin.Model, pin.GeometryModel]:
    """Return model and geometry with the joints in `held` fixed at their values."""
    reference = pin.neutral(full)
    for name, value in held.items():
        joint = full.joints[full.getJointId(name)]
        if joint.nv == 1:
            reference[joint.idx_q : joint.idx_q + joint.nq] = (
                value if joint.nq == 1 else (np.cos(value), np.sin(value))
            )
    ids = [full.getJointId(name) for name in held]
    # Pinocchio 4.1 looks frames up by name alone, and refuses where a joint and a link share one.
    distinct = full.copy()
    for frame in distinct.frames:
        frame.name += _LINK if frame.type == pin.FrameType.BODY else ""
    model, reduced = pin.buildReducedModel(distinct, geometry, ids, reference)
    # It also makes the frame of a locked joint its own parent.
    above = {frame.name: distinct.frames[frame.parentFrame].name for frame in distinct.frames}
    index = {frame.name: k for k, frame in enumerate(model.frames)}
    for frame in model.frames:
        frame.parentFrame = index[above[frame.name]]
    for frame in model.frames:
        frame.name = frame.name.removesuffix(_LINK)
    return model, reduced


def _farthest_body(model: pin.Model) -> str:
    """Return the body frame with the most joints above it, among those the one farthest from the last joint."""
    data = model.createData()
    pin.framesForwardKinematics(model, data, pin.neutral(model))

    def rank(frame: pin.Frame) -> tuple[int, float]:
        offset = float(np.linalg.norm(frame.placement.translation))
        return len(model.supports[frame.parentJoint]), offset

    bodies = [frame for frame in model.frames if frame.type == pin.FrameType.BODY]
    return str(max(bodies, key=rank).name)
