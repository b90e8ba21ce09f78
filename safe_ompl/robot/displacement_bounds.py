"""Bounds of how far the bodies and key points of a robot move, which proofs of motions rest on; its convex bodies."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import coal
import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from safe_ompl.common import BoolArray, FloatArray, IntArray, finite_array, halton_point
from safe_ompl.geometry.kernels import BODY, Records, Shapes, extreme_vertices
from safe_ompl.robot.forward_kinematics import ForwardKinematics
from safe_ompl.robot.reach import Hull, ReachCylinder, ReachCylinders, Regions, bounding_hull

_RATE_SAMPLES = range(1, 101, 4)  # points of Halton's sequence: always the same, and cheap enough


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
    def body_reaches(self) -> dict[int, ReachCylinder]:
        """For each body that moves, by its index, a cylinder in the world that it never leaves."""
        return {k: self._chain.reach(regions) for k, regions in enumerate(self._regions) if regions}

    @cached_property
    def reach_cylinders(self) -> ReachCylinders:
        """The cylinders of `body_reaches`, in its order, as tables."""
        return ReachCylinders.of(list(self.body_reaches.values()))

    @cached_property
    def _regions(self) -> list[Regions]:
        return [
            self._chain.regions(part.parentJoint, bounding_hull(part.geometry).moved(part.placement))
            for part in self._bodies
        ]

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
        cylinders = ReachCylinders.of([self._chain.point_reach(*point) for point in self._key_points])
        return cylinders.farthest(finite_array(points, (None, 3), "points")).T

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
        return _frozen(np.mean([self.displacement_radii_at(q).max(axis=0) for q in spread], axis=0))

    @cached_property
    def _body_corners(self) -> tuple[IntArray, FloatArray, FloatArray, BoolArray]:
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


_FEW = 12  # vertices that are quicker looked at one by one
_GRIDS = ((100, 4), (1000, 8), (np.inf, 12))  # cells by the number of vertices
_COARSE = 2  # cells in which many vertices are thinned first
_MANY, _MOST = 1000, 20_000  # vertices: from here on thinned first, and from here on only their box

_FARTHEST = 1e6  # [m] from the origin: beyond are shapes without end
_POINT = np.zeros((1, 3))


@dataclass(frozen=True)
class ConvexBodies:
    """Convex bodies that hold the G bodies of a geometry model, in its order; `exact: (G,)` says which are the same.

    `bodies` are of type `BODY` (`safe_ompl.geometry.kernels.convex`), `starts: (C + 1,)` and `vertices: (E, 3)` the
    lists of their vertices; `bounded` says whether all are finite: no plane, no half space.
    """

    bodies: Records
    starts: IntArray
    vertices: FloatArray
    bounded: bool
    exact: BoolArray

    @property
    def shapes(self) -> Shapes:
        """The bodies and the lists, as kernels take them."""
        return Shapes(self.bodies, self.starts, self.vertices)

    @classmethod
    def of(cls, parts: Sequence[pin.GeometryObject]) -> ConvexBodies:
        """Return the bodies of a geometry model."""
        bodies = np.zeros(len(parts), BODY)
        starts, lists, bounded = [np.zeros(1, dtype=np.intp)], [np.zeros((0, 3))], True
        cells = entries = 0
        exact = np.zeros(len(parts), dtype=bool)
        for k, (body, part) in enumerate(zip(bodies, parts, strict=True)):
            summands = _summands(part.geometry)
            bounded &= summands.bounded
            exact[k] = summands.exact
            grid, own_starts, own_vertices = _listed(summands.vertices)
            if summands.bounded:
                _fill(body, part, summands)
            body["grid"], body["first_cell"] = grid, cells
            starts.append(own_starts[1:] + entries)
            lists.append(own_vertices)
            cells, entries = cells + len(own_starts) - 1, entries + len(own_vertices)
        return cls(bodies, np.concatenate(starts), np.concatenate(lists), bounded, exact)

    def joined(self, others: ConvexBodies) -> ConvexBodies:
        """Return these bodies and, after them, others."""
        moved = others.bodies.copy()
        moved["first_cell"] += len(self.starts) - 1
        return ConvexBodies(
            np.concatenate([self.bodies, moved]),
            np.concatenate([self.starts, others.starts[1:] + len(self.vertices)]),
            np.concatenate([self.vertices, others.vertices]),
            self.bounded and others.bounded,
            np.concatenate([self.exact, others.exact]),
        )


@dataclass(frozen=True)
class _Summands:
    """The parts whose Minkowski sum holds a body, or is it, if `exact`: vertices (V, 3), box (3,), disc and ball."""

    vertices: FloatArray
    box: FloatArray
    disc: float = 0.0
    ball: float = 0.0
    exact: bool = True

    @property
    def bounded(self) -> bool:
        return bool(np.isfinite(self.vertices).all() and np.abs(self.vertices).max(initial=0.0) < _FARTHEST)


def _summands(geometry: coal.CollisionGeometry) -> _Summands:
    ball = float(geometry.getSweptSphereRadius()) if isinstance(geometry, coal.ShapeBase) else 0.0
    if isinstance(geometry, coal.Box):
        return _Summands(_POINT, np.array(geometry.halfSide, dtype=np.float64).ravel(), ball=ball)
    if isinstance(geometry, coal.Sphere):
        return _Summands(_POINT, np.zeros(3), ball=geometry.radius + ball)
    if isinstance(geometry, (coal.Capsule, coal.Cylinder)):
        along, radius = np.array([0.0, 0.0, geometry.halfLength]), geometry.radius
        if isinstance(geometry, coal.Capsule):
            return _Summands(_POINT, along, ball=radius + ball)
        return _Summands(_POINT, along, disc=radius, ball=ball)
    with np.errstate(over="ignore"):  # of planes
        hull = bounding_hull(geometry)
    few = len(hull.points) <= _MOST
    if not few:
        hull = bounding_hull(geometry, coarse=True)
    return _Summands(
        hull.points, np.zeros(3), ball=hull.radius + ball, exact=few and isinstance(geometry, coal.ConvexBase)
    )


def _fill(body: Records, part: pin.GeometryObject, summands: _Summands) -> None:
    """Write everything but the lists of vertices."""
    vertices, box, disc, ball = summands.vertices, summands.box, summands.disc, summands.ball
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    centre = (low + high) / 2
    rim = np.hypot(np.hypot(box[0], box[1]) + disc, box[2])  # of box and disc
    body["joint"] = part.parentJoint
    body["rotation"], body["translation"] = part.placement.rotation, part.placement.translation
    body["box"], body["disc"], body["ball"] = box, disc, ball
    body["centre"] = centre
    body["extent"] = (high - low) / 2 + box + (disc, disc, 0.0) + ball
    body["reach"] = np.linalg.norm(vertices - centre, axis=1).max() + rim + ball


def _listed(vertices: FloatArray) -> tuple[int, IntArray, FloatArray]:
    """Return the grid of a body, and its vertices as lists for each cell."""
    if len(vertices) <= _FEW:
        return 0, np.array([0, len(vertices)], dtype=np.intp), vertices
    if len(vertices) > _MANY:
        vertices = vertices[np.unique(extreme_vertices(vertices, _COARSE)[1])]
    grid = next(grid for most, grid in _GRIDS if len(vertices) <= most)
    starts, found = extreme_vertices(vertices, grid)
    return grid, starts, vertices[found]
