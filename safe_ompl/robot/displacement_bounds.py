"""Motion bounds of bodies and key points, proven for all configurations.

A set of points that rotates about an axis stays inside a cylinder around this axis. From a link towards the base, the
cylinder around the axis of one joint is enclosed by a cylinder around the axis of the next joint. The radius of this
cylinder is the displacement radius R̄ of the link for the joint: no point of the link moves more than R̄·|Δ| when the
joint moves by Δ, at any configuration.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import coal
import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from safe_ompl.common import BoolArray, FloatArray, IntArray, finite_array, halton_point
from safe_ompl.geometry import ConvexBodies, Hull, bounding_hull, turn_onto

if TYPE_CHECKING:
    from safe_ompl.robot.forward_kinematics import ForwardKinematics

# Indices of the points of Halton's sequence at which rates are sampled. They are deterministic.
_RATE_SAMPLES = range(1, 101, 4)
_UP = np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True, eq=False, repr=False)
class ReachCylinder:
    """A cylinder: all points within `radius` of the axis through `center`, and within `half_length` along it [m]."""

    center: FloatArray
    axis: FloatArray
    radius: float
    half_length: float

    @classmethod
    def around(cls, hull: Hull, axis: FloatArray) -> ReachCylinder:
        """Return the smallest cylinder around the line through the origin along `axis` that contains `hull`."""
        along = hull.points @ axis
        radial = np.linalg.norm(hull.points - along[:, None] * axis, axis=1)
        low, high = float(along.min()) - hull.radius, float(along.max()) + hull.radius
        return cls((low + high) / 2 * axis, axis, float(radial.max()) + hull.radius, (high - low) / 2)

    def moved(self, placement: pin.SE3) -> ReachCylinder:
        """Return the cylinder transformed by `placement`."""
        center = placement.rotation @ self.center + placement.translation
        return ReachCylinder(center, placement.rotation @ self.axis, self.radius, self.half_length)

    def enclosed_about(self, axis: FloatArray) -> ReachCylinder:
        """Return a cylinder around the line through the origin along `axis` that contains this cylinder.

        Projected along `axis`, an end disc is an ellipse about c. For w from c to a point of the ellipse,
        ‖c + w‖² ≤ ‖c‖² + 2·max c·w + r².
        """
        slope = min(max(float(self.axis @ axis), -1.0), 1.0)
        radius, reach = 0.0, self.half_length * abs(slope) + self.radius * math.sqrt(1 - slope**2)
        for end in (-self.half_length, self.half_length):
            c = self.center + end * self.axis
            c = c - (c @ axis) * axis
            away = c - (c @ self.axis) * self.axis
            lateral = math.sqrt(away @ away)
            radius = max(radius, math.sqrt(c @ c + 2 * self.radius * lateral + self.radius**2))
        return ReachCylinder((self.center @ axis) * axis, axis, radius, float(reach))

    def stretched(self, low: float, high: float) -> ReachCylinder:
        """Return the swept cylinder when it slides along its axis by `low` to `high` [m]."""
        center = self.center + (low + high) / 2 * self.axis
        return ReachCylinder(center, self.axis, self.radius, self.half_length + (high - low) / 2)

    @property
    def body(self) -> pin.GeometryObject:
        """The cylinder as a body fixed to the world."""
        place = pin.SE3(turn_onto(_UP, self.axis), self.center)
        return pin.GeometryObject("", 0, place, coal.Cylinder(self.radius, 2 * self.half_length))


def _tables(cylinders: Sequence[ReachCylinder]) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return centers and unit axes (M, 3), radii and half lengths (M,) [m] of M cylinders."""
    vectors = np.reshape([(c.center, c.axis) for c in cylinders], (-1, 2, 3))
    lengths = np.reshape([(c.radius, c.half_length) for c in cylinders], (-1, 2))
    return vectors[:, 0].copy(), vectors[:, 1].copy(), lengths[:, 0].copy(), lengths[:, 1].copy()


# Pairs of a joint (0-based) and a cylinder in its frame that contains a body at all configurations.
Regions = list[tuple[int, ReachCylinder]]


@dataclass(frozen=True, eq=False, repr=False)
class JointChain:
    """The n joints of a robot. Joint i is Pinocchio's joint i + 1; `parents` are Pinocchio's numbers.

    `placements` are the joint frames at zero in the frames of their parents, `axes: (n, 3)` unit vectors in the joint
    frames. Only the limits of prismatic joints are used.
    """

    parents: list[int]
    placements: list[pin.SE3]
    axes: FloatArray
    prismatic: BoolArray
    lower: FloatArray
    upper: FloatArray

    @classmethod
    def from_model(cls, model: pin.Model, prismatic: BoolArray, lower: FloatArray, upper: FloatArray) -> JointChain:
        """Build the chain from the joints of `model`; the other arguments are as in the class."""
        axes = np.zeros((len(prismatic), 3))
        neutral = pin.neutral(model)
        for i, joint in enumerate(list(model.joints)[1:]):
            joint_data = joint.createData()
            joint.calc(joint_data, neutral)
            subspace = np.asarray(joint_data.S, dtype=np.float64).ravel()
            axes[i] = subspace[:3] if prismatic[i] else subspace[3:]
        parents = [int(parent) for parent in model.parents][1:]
        placements = [pin.SE3(placement) for placement in model.jointPlacements][1:]
        return cls(parents, placements, axes, prismatic, lower, upper)

    def path_to_root(self, joint: int) -> list[int]:
        """Return the joints (0-based) that move Pinocchio's joint `joint`, the nearest first."""
        path = []
        while joint != 0:
            path.append(joint - 1)
            joint = self.parents[joint - 1]
        return path

    def radii(self, regions: Regions) -> FloatArray:
        """Return the displacement radii R̄ (n,) of a body with these `regions`."""
        radii = np.zeros(len(self.parents))
        for i, region in regions:
            radii[i] = 1.0 if self.prismatic[i] else region.radius
        return radii

    def reach(self, regions: Regions) -> ReachCylinder:
        """Return a cylinder in the world that contains a moving body at all configurations within the limits."""
        i, region = regions[-1]
        return region.moved(self.placements[i])

    def point_reach(self, joint: int, point: FloatArray, axis: FloatArray = _UP) -> ReachCylinder:
        """Return a cylinder in the world that always contains a point (3,) [m] given in the frame of a joint."""
        if joint == 0:
            return ReachCylinder(point, axis, 0.0, 0.0)
        return self.reach(self.regions(joint, Hull(point[None], 0.0)))

    def axis_distances(self, bodies: ConvexBodies) -> FloatArray:
        """Return upper bounds (G, n) on the distance of G fixed bodies from each joint's axis [m].

        In the frame of a link that joint i rotates by Δ, the fixed body rotates, and none of its points moves more than
        this distance times |Δ|. This is a second motion bound for the pair. It is infinite for prismatic joints.
        """
        distances = bodies.table.farthest_from_axes(*self._axis_reaches)
        distances[:, self.prismatic] = np.inf
        return distances

    @cached_property
    def _axis_reaches(self) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Cylinders in the world that always contain the origins of the n joints, around the joint axes."""
        joints = zip(self.parents, self.placements, self.axes, strict=True)
        reaches = [self.point_reach(k, place.translation, place.rotation @ axis) for k, place, axis in joints]
        tables = _tables(reaches)
        # The axis of a joint on the base does not move, so its cylinder is the whole line.
        tables[3][np.array(self.parents) == 0] = np.inf
        return tables

    def regions(self, joint: int, body: Hull) -> Regions:
        """Return the joints that move a body, the nearest first, each with the body's cylinder in the joint frame."""
        regions: Regions = []
        for i in self.path_to_root(joint):
            axis = self.axes[i]
            if regions:
                inner, region = regions[-1]
                region = region.moved(self.placements[inner]).enclosed_about(axis)
            else:
                region = ReachCylinder.around(body, axis)
            if self.prismatic[i]:
                region = region.stretched(float(self.lower[i]), float(self.upper[i]))
            regions.append((i, region))
        return regions


class DisplacementBounds:
    """Motion bounds of a robot's bodies and key points, and cylinders that they never leave.

    Radii are computed for the m joints of Pinocchio's model (`joint_…`), and from these for the n planned joints. If a
    joint and its mimic joint move the two bodies of a pair, only the former bound how the bodies approach.
    """

    def __init__(self, kinematics: ForwardKinematics) -> None:
        self._robot = kinematics
        self._chain = kinematics.shared.chain

    @cached_property
    def displacement_radii(self) -> FloatArray:
        """Proven radii R̄ (G, n): no point of body g moves more than Σ_i R̄_gi·|Δ_i|, at any configuration."""
        return _frozen(self._robot.coupling.radii(self.joint_radii))

    @cached_property
    def joint_radii(self) -> FloatArray:
        """The radii R̄ (G, m) by the joints of Pinocchio's model."""
        radii = [self._chain.radii(regions) for regions in self._regions]
        return _frozen(np.array(radii).reshape(-1, self._robot.shared.model.nv))

    @cached_property
    def tip_radii(self) -> FloatArray:
        """The radii R̄ (m,) of the tip by the joints of Pinocchio's model."""
        tip = Hull(self._robot.tip_placement.translation[None], 0.0)
        return _frozen(self._chain.radii(self._chain.regions(self._robot.tip_joint, tip)))

    @cached_property
    def body_reaches(self) -> dict[int, ReachCylinder]:
        """By index of each moving body, a cylinder in the world that it never leaves."""
        return {k: self._chain.reach(regions) for k, regions in enumerate(self._regions) if regions}

    @cached_property
    def reach_bodies(self) -> tuple[list[pin.GeometryObject], ConvexBodies]:
        """The cylinders of `body_reaches` as bodies, in the same order."""
        bodies = [cylinder.body for cylinder in self.body_reaches.values()]
        return bodies, ConvexBodies.of(bodies)

    @cached_property
    def body_hulls(self) -> list[Hull]:
        """A bounding hull of each body, in the frame of its joint."""
        return [bounding_hull(part.geometry).moved(part.placement) for part in self._bodies]

    @cached_property
    def _regions(self) -> list[Regions]:
        joints = (part.parentJoint for part in self._bodies)
        return [self._chain.regions(*carried) for carried in zip(joints, self.body_hulls, strict=True)]

    @cached_property
    def convex_bodies(self) -> ConvexBodies:
        """Convex bodies that contain the bodies of `collision_model`, in the same order."""
        return ConvexBodies.of(self._bodies)

    @cached_property
    def keypoint_radii(self) -> FloatArray:
        """Proven radii R̄ (K, n) of the key points of the skeleton; otherwise like `displacement_radii`."""
        return _frozen(self._robot.coupling.radii(self.joint_keypoint_radii))

    @cached_property
    def joint_keypoint_radii(self) -> FloatArray:
        """The radii R̄ (K, m) of the key points by the joints of Pinocchio's model."""
        points = ((joint, Hull(offset[None], 0.0)) for joint, offset in self._key_points)
        radii = [self._chain.radii(self._chain.regions(*point)) for point in points]
        return _frozen(np.array(radii))

    def keypoint_reaches(self, points: ArrayLike) -> FloatArray:
        """Return proven upper bounds (K, M) [m] on the distances of key points from fixed `points: (M, 3)` [m]."""
        centers, axes, radii, half_lengths = _tables([self._chain.point_reach(*point) for point in self._key_points])
        arms = finite_array(points, (None, 3), "points")[:, None] - centers
        along = np.einsum("kmx,mx->km", arms, axes)
        lateral = np.linalg.norm(arms - along[..., None] * axes, axis=2)
        return np.asarray(np.hypot(lateral + radii, np.abs(along) + half_lengths).T)

    def displacement_radii_at(self, q: ArrayLike) -> FloatArray:
        """Return the radii R (G, n) at `q: (n,)`: the distance of body g's farthest point from joint i's axis.

        Between `q` and q + Δ no point of body g moves more than Σ_i R_gi·|Δ_i| (`docs/how-it-works.md` §3).
        """
        rotation, origins, axes = (f[0] for f in self._robot.joint_frames(self._robot.configuration(q)[None]))
        joints, corners, pads, support = self.body_corners
        # No joint moves these bodies.
        fixed = (joints == 0)[:, None, None]
        carried = np.einsum("gij,gpj->gpi", rotation[joints - 1], corners) + origins[joints - 1][:, None]
        world = np.where(fixed, corners, carried)
        arms = world[:, None] - origins[:, None]
        along = np.einsum("gipc,ic->gip", arms, axes)
        squared = np.einsum("gipc,gipc->gip", arms, arms) - along**2
        radii = np.sqrt(np.maximum(squared, 0).max(axis=2)) + pads[:, None]
        return self._robot.coupling.radii(np.where(self._robot.joint_prismatic, 1.0, radii) * support)

    @cached_property
    def arm_rates(self) -> FloatArray:
        """Maximal motion (n,) of the arm per joint motion, averaged over configurations [m/rad]."""
        sides = self._robot.upper - self._robot.lower
        spread = [self._robot.lower + sides * halton_point(k, self._robot.n) for k in _RATE_SAMPLES]
        return _frozen(np.mean([self.displacement_radii_at(q).max(axis=0) for q in spread], axis=0))

    @cached_property
    def body_corners(self) -> tuple[IntArray, FloatArray, FloatArray, BoolArray]:
        """Joints of the bodies (G,), corners (G, 8, 3) in their frames, radii (G,) around these, supporting joints."""
        parts = self._bodies
        hulls = [bounding_hull(part.geometry, coarse=True).moved(part.placement) for part in parts]
        corners = np.array([np.resize(hull.points, (8, 3)) for hull in hulls]).reshape(-1, 8, 3)
        joints = np.array([part.parentJoint for part in parts], dtype=np.intp)
        pads = np.array([hull.radius for hull in hulls])
        return joints, corners, pads, self._robot.supporting_joints(joints)

    @cached_property
    def _key_points(self) -> list[tuple[int, FloatArray]]:
        """Pinocchio's joint that carries each key point, and its offset (3,) in the joint's frame [m]."""
        skeleton = self._robot.skeleton
        return list(zip(skeleton.joints.tolist(), skeleton.offsets, strict=True))

    @cached_property
    def _bodies(self) -> list[pin.GeometryObject]:
        return list(self._robot.shared.collision_model.geometryObjects)


def _frozen(array: FloatArray) -> FloatArray:
    array.setflags(write=False)
    return array
