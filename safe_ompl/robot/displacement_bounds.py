"""Displacement radii: bounds of how far bodies and key points move when joints do, proven for every configuration.

A set of points that turns about an axis stays inside the cylinder around that axis that encloses it. Going from
a link towards the base, the cylinder about one joint's axis is enclosed by one about the next joint's axis; its
radius is the displacement radius R̄ of the link for that joint: no point of the link moves more than
R̄·|Δ| when the joint turns by Δ, whatever the configuration (the constant radii of certified motions).
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

# Rates are sampled at these points of Halton's sequence. They are the same on any machine, and few enough.
_RATE_SAMPLES = range(1, 101, 4)
_UP = np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True, eq=False, repr=False)
class ReachCylinder:
    """All points within `radius` of an axis through `center`, at most `half_length` along it [m]."""

    center: FloatArray
    axis: FloatArray
    radius: float
    half_length: float

    @classmethod
    def around(cls, hull: Hull, axis: FloatArray) -> ReachCylinder:
        """Return the smallest one about the line through the origin along `axis` that holds `hull`."""
        along = hull.points @ axis
        radial = np.linalg.norm(hull.points - along[:, None] * axis, axis=1)
        low, high = float(along.min()) - hull.radius, float(along.max()) + hull.radius
        return cls((low + high) / 2 * axis, axis, float(radial.max()) + hull.radius, (high - low) / 2)

    def moved(self, placement: pin.SE3) -> ReachCylinder:
        """Return the cylinder in the frame that `placement` maps to."""
        center = placement.rotation @ self.center + placement.translation
        return ReachCylinder(center, placement.rotation @ self.axis, self.radius, self.half_length)

    def enclosed_about(self, axis: FloatArray) -> ReachCylinder:
        """Return a cylinder about the line through the origin along `axis` that holds this one.

        Seen along `axis` an end disc is an ellipse; with w one of its points, ‖c + w‖² ≤ ‖c‖² + 2·max c·w + r².
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
        """Return what the cylinder sweeps when it slides along its axis by `low` … `high` [m]."""
        center = self.center + (low + high) / 2 * self.axis
        return ReachCylinder(center, self.axis, self.radius, self.half_length + (high - low) / 2)

    @property
    def body(self) -> pin.GeometryObject:
        """The cylinder as a body that the world carries."""
        place = pin.SE3(turn_onto(_UP, self.axis), self.center)
        return pin.GeometryObject("", 0, place, coal.Cylinder(self.radius, 2 * self.half_length))


def _tables(cylinders: Sequence[ReachCylinder]) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return centers and unit axes (M, 3), radii and half lengths (M,) [m] of M cylinders."""
    vectors = np.reshape([(c.center, c.axis) for c in cylinders], (-1, 2, 3))
    lengths = np.reshape([(c.radius, c.half_length) for c in cylinders], (-1, 2))
    return vectors[:, 0].copy(), vectors[:, 1].copy(), lengths[:, 0].copy(), lengths[:, 1].copy()


# Joints, counted from 0, and where a body can be in the frame of each.
Regions = list[tuple[int, ReachCylinder]]


@dataclass(frozen=True, eq=False, repr=False)
class JointChain:
    """The n joints of a robot; joint i is Pinocchio's joint i + 1, and parents have Pinocchio's numbers.

    `placements` are the frames at zero in those of the parents, `axes: (n, 3)` in the joints' own frames. Of the limits
    only those of prismatic joints are used.
    """

    parents: list[int]
    placements: list[pin.SE3]
    axes: FloatArray
    prismatic: BoolArray
    lower: FloatArray
    upper: FloatArray

    @classmethod
    def from_model(cls, model: pin.Model, prismatic: BoolArray, lower: FloatArray, upper: FloatArray) -> JointChain:
        """Read the joints of `model`; the rest as above."""
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
        """Return the displacement radii R̄ (n,) of a body in its `regions`."""
        radii = np.zeros(len(self.parents))
        for i, region in regions:
            radii[i] = 1.0 if self.prismatic[i] else region.radius
        return radii

    def reach(self, regions: Regions) -> ReachCylinder:
        """Return a cylinder in the world that a body that moves never leaves, at any configuration within limits."""
        i, region = regions[-1]
        return region.moved(self.placements[i])

    def point_reach(self, joint: int, point: FloatArray, axis: FloatArray = _UP) -> ReachCylinder:
        """Return a cylinder in the world that a point (3,) [m] in the frame of a joint never leaves."""
        if joint == 0:
            return ReachCylinder(point, axis, 0.0, 0.0)
        return self.reach(self.regions(joint, Hull(point[None], 0.0)))

    def axis_distances(self, bodies: ConvexBodies) -> FloatArray:
        """Return how far G bodies that stand still in the world are from each joint's axis [m], at most, (G, n).

        Seen from a link that joint i turns by Δ it is the body that turns, so that no point of it moves more than this
        distance times |Δ|: another bound of how far they approach each other. It is infinite for prismatic joints.
        """
        distances = bodies.table.farthest_from_axes(*self._axis_reaches)
        distances[:, self.prismatic] = np.inf
        return distances

    @cached_property
    def _axis_reaches(self) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Cylinders in the world that hold the n joints' origins, about their axes."""
        joints = zip(self.parents, self.placements, self.axes, strict=True)
        reaches = [self.point_reach(k, place.translation, place.rotation @ axis) for k, place, axis in joints]
        tables = _tables(reaches)
        # An axis that no joint moves extends without end along the axis of its center.
        tables[3][np.array(self.parents) == 0] = np.inf
        return tables

    def regions(self, joint: int, body: Hull) -> Regions:
        """Return for each joint that moves a body, the nearest first, where it can be, in that joint's frame."""
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
    """Displacement radii of a robot's bodies and key points, and how far these can be from anything.

    Radii are known for each of the m joints of Pinocchio's model (`joint_…`), and from these for the n planned ones.
    Where the bodies of a pair are moved by a joint and by one that mimics it, only the former say how they approach.
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
        """For each body that moves, by its index, a cylinder in the world that it never leaves."""
        return {k: self._chain.reach(regions) for k, regions in enumerate(self._regions) if regions}

    @cached_property
    def reach_bodies(self) -> tuple[list[pin.GeometryObject], ConvexBodies]:
        """The cylinders of `body_reaches`, in its order, as bodies."""
        bodies = [cylinder.body for cylinder in self.body_reaches.values()]
        return bodies, ConvexBodies.of(bodies)

    @cached_property
    def body_hulls(self) -> list[Hull]:
        """A hull about each body, in the frame of the joint that carries it."""
        return [bounding_hull(part.geometry).moved(part.placement) for part in self._bodies]

    @cached_property
    def _regions(self) -> list[Regions]:
        joints = (part.parentJoint for part in self._bodies)
        return [self._chain.regions(*carried) for carried in zip(joints, self.body_hulls, strict=True)]

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
        points = ((joint, Hull(offset[None], 0.0)) for joint, offset in self._key_points)
        radii = [self._chain.radii(self._chain.regions(*point)) for point in points]
        return _frozen(np.array(radii))

    def keypoint_reaches(self, points: ArrayLike) -> FloatArray:
        """Return how far (K, M) [m] each key point can ever be from fixed `points: (M, 3)`, at most; proven."""
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
        # These bodies are fixed to the base, and no joint moves them.
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
        """How far (n,) the joints move the arm at most, on an average over configurations [m/rad]."""
        sides = self._robot.upper - self._robot.lower
        spread = [self._robot.lower + sides * halton_point(k, self._robot.n) for k in _RATE_SAMPLES]
        return _frozen(np.mean([self.displacement_radii_at(q).max(axis=0) for q in spread], axis=0))

    @cached_property
    def body_corners(self) -> tuple[IntArray, FloatArray, FloatArray, BoolArray]:
        """Pinocchio's joint of each body (G,), corners in its frame (G, 8, 3), what is added, which joints move it."""
        parts = self._bodies
        hulls = [bounding_hull(part.geometry, coarse=True).moved(part.placement) for part in parts]
        corners = np.array([np.resize(hull.points, (8, 3)) for hull in hulls]).reshape(-1, 8, 3)
        joints = np.array([part.parentJoint for part in parts], dtype=np.intp)
        pads = np.array([hull.radius for hull in hulls])
        return joints, corners, pads, self._robot.supporting_joints(joints)

    @cached_property
    def _key_points(self) -> list[tuple[int, FloatArray]]:
        """Pinocchio's joint that carries each key point, and its place there [m]."""
        skeleton = self._robot.skeleton
        return list(zip(skeleton.joints.tolist(), skeleton.offsets, strict=True))

    @cached_property
    def _bodies(self) -> list[pin.GeometryObject]:
        return list(self._robot.shared.collision_model.geometryObjects)


def _frozen(array: FloatArray) -> FloatArray:
    array.setflags(write=False)
    return array
