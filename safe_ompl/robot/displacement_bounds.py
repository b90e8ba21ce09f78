"""Bounds of how far the bodies and key points of a robot move: what proofs of motions rest on."""

from __future__ import annotations

from functools import cached_property
from typing import TypeVar

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from safe_ompl.common import BoolArray, FloatArray, IntArray, finite_array, halton_point
from safe_ompl.robot.convex_bodies import ConvexBodies
from safe_ompl.robot.forward_kinematics import ForwardKinematics
from safe_ompl.robot.reach import Hull, ReachCylinder, bounding_hull

_RATE_SAMPLES = range(1, 101, 4)  # points of Halton's sequence: always the same, and cheap enough


class DisplacementBounds:
    """Displacement radii of a robot's bodies and key points, and how far these can be from anything.

    Radii are known for each of the m joints of Pinocchio's model (`joint_…`), and from these for the n planned ones.
    Where the bodies of a pair are moved by a joint and by one that mimics it, only the former say how they approach.

    Parameters
    ----------
    kinematics : ForwardKinematics
        The robot.
    """

    def __init__(self, kinematics: ForwardKinematics) -> None:
        self._robot = kinematics
        self._chain = kinematics.shared.chain

    @cached_property
    def displacement_radii(self) -> FloatArray:
        """Proven radii R̄ (G, n): no point of body g moves more than Σ_i R̄_gi·|Δ_i|, at any configuration.

        Rows follow `collision_model.geometryObjects`. See `safe_ompl.robot.reach`.
        """
        return _frozen(self._robot.coupling.radii(self.joint_radii))

    @cached_property
    def joint_radii(self) -> FloatArray:
        """The radii R̄ (G, m) by the joints of Pinocchio's model."""
        radii = [
            self._chain.radii(part.parentJoint, bounding_hull(part.geometry).moved(part.placement))
            for part in self._bodies
        ]
        return _frozen(np.array(radii).reshape(-1, self._robot.shared.model.nv))

    @cached_property
    def body_reaches(self) -> dict[int, ReachCylinder]:
        """For each body that moves, by its index, a cylinder in the world that it never leaves."""
        return {
            k: self._chain.reach(part.parentJoint, bounding_hull(part.geometry).moved(part.placement))
            for k, part in enumerate(self._bodies)
            if part.parentJoint != 0
        }

    @cached_property
    def convex_bodies(self) -> ConvexBodies:
        """The bodies of `collision_model`, in its order, as convex ones that hold them."""
        return ConvexBodies.of(self._bodies)

    @cached_property
    def keypoint_radii(self) -> FloatArray:
        """Proven radii R̄ (K, n) of the key points of the skeleton; otherwise like `displacement_radii`."""
        return _frozen(self._robot.coupling.radii(self.joint_keypoint_radii))

    @cached_property
    def joint_keypoint_radii(self) -> FloatArray:
        """The radii R̄ (K, m) of the key points by the joints of Pinocchio's model."""
        return _frozen(
            np.array(
                [self._chain.radii(int(joint), Hull(offset[None], 0.0)) for joint, offset in self._key_points]
            )
        )

    def keypoint_reaches(self, points: ArrayLike) -> FloatArray:
        """Return how far (K, M) [m] each key point can ever be from fixed `points: (M, 3)`, at most; proven."""
        points = finite_array(points, (None, 3), "points")
        reaches = np.empty((len(self._key_points), len(points)))
        for k, (joint, offset) in enumerate(
            zip(self._robot.skeleton.joints, self._robot.skeleton.offsets, strict=True)
        ):
            if joint == 0:
                reaches[k] = np.linalg.norm(points - offset, axis=1)
            else:
                region = self._chain.reach(int(joint), Hull(offset[None], 0.0))
                reaches[k] = [region.farthest(Hull(point[None], 0.0)) for point in points]
        return reaches

    def displacement_radii_at(self, q: ArrayLike) -> FloatArray:
        """Return the radii R (G, n) at `q: (n,)`: the distance of body g's farthest point from joint i's axis.

        Tighter than `displacement_radii`, but costlier. Between `q` and q + Δ no point of body g moves more than
        Σ_i R_gi·|Δ_i| (`docs/mathematics.md` §3: the radii at the centre are enough).
        """
        return self._robot.coupling.radii(self.joint_radii_at(self._robot.configuration(q)))

    def joint_radii_at(self, q: FloatArray) -> FloatArray:
        """Return the radii R (G, m) at `q: (n,)` by the joints of Pinocchio's model."""
        rotation, origins, axes = (
            frames[0] for frames in self._robot.kinematics.frames(self._robot.model_values(q[None]))
        )
        joints, corners, pads, support = self._body_corners
        fixed = (joints == 0)[:, None, None]  # to the base: no joint moves them
        carried = np.einsum("gij,gpj->gpi", rotation[joints - 1], corners) + origins[joints - 1][:, None]
        world = np.where(fixed, corners, carried)
        arms = world[:, None] - origins[:, None]
        along = np.einsum("gipc,ic->gip", arms, axes)
        squared = np.einsum("gipc,gipc->gip", arms, arms) - along**2
        radii = np.sqrt(np.maximum(squared, 0).max(axis=2)) + pads[:, None]
        return np.where(self._robot.joint_prismatic, 1.0, radii) * support

    @cached_property
    def arm_rates(self) -> FloatArray:
        """How far (n,) the joints move the arm at most, on an average over configurations [m/rad]."""
        sides = self._robot.upper - self._robot.lower
        spread = [self._robot.lower + sides * halton_point(k, self._robot.n) for k in _RATE_SAMPLES]
        rates: FloatArray = np.mean([self.displacement_radii_at(q).max(axis=0) for q in spread], axis=0)
        rates.setflags(write=False)
        return rates

    @cached_property
    def _body_corners(self) -> tuple[IntArray, FloatArray, FloatArray, BoolArray]:
        parts = self._bodies
        hulls = [bounding_hull(part.geometry, coarse=True).moved(part.placement) for part in parts]
        corners = np.array([np.resize(hull.points, (8, 3)) for hull in hulls]).reshape(-1, 8, 3)
        joints = np.array([part.parentJoint for part in parts], dtype=np.intp)
        return (
            joints,
            corners,
            np.array([hull.radius for hull in hulls]),
            self._robot.supporting_joints(joints),
        )

    @cached_property
    def _key_points(self) -> list[tuple[int, FloatArray]]:
        """Pinocchio's joint that carries each key point, and its place there [m]."""
        skeleton = self._robot.skeleton
        return list(zip(skeleton.joints.tolist(), skeleton.offsets, strict=True))

    @cached_property
    def _bodies(self) -> list[pin.GeometryObject]:
        return list(self._robot.shared.collision_model.geometryObjects)


_Array = TypeVar("_Array", FloatArray, BoolArray)


def _frozen(array: _Array) -> _Array:
    array.setflags(write=False)
    return array
