"""The robot: its configurations, its kinematics on Pinocchio, its skeleton, and how far its bodies can move."""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from safe_ompl.arrays import BoolArray, FloatArray, IntArray
from safe_ompl.errors import InputError, UnknownNameError
from safe_ompl.maths.halton import halton_point
from safe_ompl.robot.chosen_joints import group_tip, joints_and_posture
from safe_ompl.robot.collision_shapes import (
    CollisionSource,
    build_collision_geometry,
    links_without_collision,
)
from safe_ompl.robot.convex import make_convex
from safe_ompl.robot.displacement import Hull, JointChain, bounding_hull
from safe_ompl.robot.examples import find_example, robots_folder
from safe_ompl.robot.fingers import default_tip
from safe_ompl.robot.joint_frames import JointFrames
from safe_ompl.robot.reduction import (
    check_joints,
    joint_limits,
    joints_to_hold,
    override_limits,
    reduce_model,
)
from safe_ompl.robot.self_collision import sample_configurations, select_self_pairs
from safe_ompl.robot.skeleton import Skeleton, frame_index
from safe_ompl.robot.srdf import SrdfFile
from safe_ompl.robot.urdf import UrdfFile, existing_file

_log = logging.getLogger(__name__)

_RATE_SAMPLES = range(1, 101, 4)  # points of Halton's sequence: always the same, and cheap enough


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
    links_without_collision : tuple of str
        Moving links that have visual shapes but no collision shapes: nothing is checked for them.
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
        collision: str = "required",
        group: str | None = None,
        locked_state: str | None = None,
    ) -> None:
        full = urdf.build_model()
        override_limits(full, limits, str(urdf.path))
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
            "collision": collision,
            "group": group,
            "locked_state": locked_state,
        }
        if tip is not None and not full.existFrame(tip):
            raise UnknownNameError(
                "tip frame", tip, (frame.name for frame in list(full.frames)[1:]), str(urdf.path)
            )
        locked = joints_and_posture(
            full,
            urdf.mimics(),
            locked,
            tip=tip,
            group=group,
            locked_state=locked_state,
            srdf=srdf,
            source=str(urdf.path),
        )
        held = joints_to_hold(full, urdf, None if group else tip, locked)
        self._held = held
        geometry = build_collision_geometry(urdf, full, collision)
        self.model, self.collision_model = reduce_model(full, geometry, held)
        check_joints(self.model, str(urdf.path))
        self.links_without_collision: tuple[str, ...] = links_without_collision(
            urdf, self.model, self.collision_model, collision, self.name
        )
        if hulls:
            make_convex(self.collision_model)

        self.joint_names: tuple[str, ...] = tuple(self.model.names)[1:]
        self.n: int = len(self.joint_names)
        self.continuous: BoolArray = np.array([j.nq == 2 for j in list(self.model.joints)[1:]])
        self._wraps = bool(self.continuous.any())
        first: IntArray = np.array([j.idx_q for j in list(self.model.joints)[1:]], dtype=np.intp)
        self._straight, self._circular = first[~self.continuous], first[self.continuous]
        self.prismatic: BoolArray = np.array(["P" in j.shortname()[10:] for j in list(self.model.joints)[1:]])
        self.lower, self.upper = joint_limits(self.model, str(urdf.path))
        select_self_pairs(
            self.model, self.collision_model, srdf, sample_configurations(self.model), self.name
        )

        self.tip: str = tip or group_tip(srdf, group, str(urdf.path)) or default_tip(full, self.model)
        self.tip_frame: int = frame_index(self.model, self.tip)
        skeleton = Skeleton.from_model(self.model, list(full.names)[1:], self.tip)
        self.segments: IntArray = skeleton.segments
        self.segment_names = skeleton.names
        self._key_joints, self._key_offsets = skeleton.joints, skeleton.offsets
        self._shifted = np.flatnonzero(np.abs(skeleton.offsets).max(axis=1) > 0)
        self.chain = JointChain.from_model(self.model, self.prismatic, self.lower, self.upper)
        self._support = self._supporting_joints(skeleton.joints)
        self._moved_by: FloatArray = self._support.T.astype(np.float64)  # (n, K)
        self._scratch = JointFrames(self.model)
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
        collision: CollisionSource = "required",
        group: str | None = None,
        locked_state: str | None = None,
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
            Frame at the end of the arm. Joints that do not move it are held; a warning says at which posture.
            Default: the body farthest from the base; where that is a finger, the hand.
        locked : mapping of str to float, optional
            Joints to hold still, with their values [rad or m]. A joint that mimics a locked one is locked with it.
            If it names all joints that are to move (such as `robot.named("home")`), it is the posture of the others.
        hulls : bool
            Replace meshes by their convex hulls (solid and fast). False keeps the meshes, which are hollow.
        name : str, optional
            Name for reports; the URDF's by default.
        limits : mapping of str to (float, float), optional
            Joint limits that replace the URDF's [rad or m].
        collision : {"required", "visual", "optional"}
            What collides of links that have visual shapes only. "visual": those shapes. Otherwise nothing, which
            `links_without_collision` and a warning say; a robot with no collision shape on any moving link is refused
            unless this is "optional".
        group : str, optional
            Group of the SRDF whose joints move; the others are held as those are that do not move the tip.
        locked_state : str, optional
            State of the SRDF that says at which values joints are held that are not in the group or do not move the
            tip; zero by default.

        Raises
        ------
        InputError
            Missing or malformed file, missing mesh, unknown joint or frame, unsupported joint type.
        """
        srdf_file = None if srdf is None else str(existing_file(srdf, "SRDF"))
        return cls(
            UrdfFile(urdf, package_dirs),
            srdf_file,
            tip,
            dict(locked or {}),
            hulls,
            name,
            dict(limits or {}),
            collision,
            group,
            locked_state,
        )

    @classmethod
    def from_example(
        cls,
        name: str,
        *,
        tip: str | None = None,
        locked: Mapping[str, float] | None = None,
        hulls: bool = True,
        collision: CollisionSource = "required",
        group: str | None = None,
        locked_state: str | None = None,
    ) -> Robot:
        """Build a robot of example-robot-data.

        Parameters
        ----------
        name : str
            A key of `safe_ompl.robot.examples.EXAMPLES`: "panda", "ur5", "xarm7", "kinova", …
        tip, locked, hulls, collision, group, locked_state
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
            tip or (example.tip if group is None else None),
            example.locked if locked is None else locked,
            hulls=hulls,
            name=name,
            collision=collision,
            group=group,
            locked_state=locked_state,
        )

    def with_limits(self, limits: Mapping[str, tuple[float, float]]) -> Robot:
        """Return the same robot with other limits [rad or m] for the joints named."""
        return _rebuild({**self._recipe, "limits": {**self._recipe["limits"], **limits}})

    def __reduce__(self) -> tuple[Any, ...]:
        return _rebuild, (self._recipe,)

    def __repr__(self) -> str:
        bare = self.links_without_collision
        unchecked = f", links_without_collision={list(bare)}" if bare else ""
        return f"Robot({self.name!r}, joints={list(self.joint_names)}, tip={self.tip!r}{unchecked})"

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

    def named(self, q: FloatArray | str) -> dict[str, float]:
        """Return `q: (n,)`, or the state of the SRDF that it names, as a mapping from joint name to value [rad or m].

        A state holds what the SRDF says, for whichever joints: of several groups with that state, those of all.

        Raises
        ------
        InputError
            If there is no state of that name, or no SRDF.
        """
        if isinstance(q, str):
            if self._recipe["srdf"] is None:
                raise InputError(f"no state {q!r}: states come with an SRDF", self.name)
            return SrdfFile(self._recipe["srdf"]).state(q)
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

        Rows follow `collision_model.geometryObjects`. See `safe_ompl.robot.displacement`.
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
        return reduce_model(full, geometry, self._held)[1]

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


_NEXT, _AFTER_NEXT = np.array([1, 2, 0]), np.array([2, 0, 1])


def _cross(a: FloatArray, b: FloatArray) -> FloatArray:
    """Return a × b along the last axis; np.cross takes four times as long on small arrays."""
    return a.take(_NEXT, -1) * b.take(_AFTER_NEXT, -1) - a.take(_AFTER_NEXT, -1) * b.take(_NEXT, -1)


def _rebuild(recipe: dict[str, Any]) -> Robot:
    return Robot.from_urdf(**recipe)
