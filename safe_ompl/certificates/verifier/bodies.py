"""Simple checks of distances, speeds and tool limits, for the verifier of certificates.

Each pair of bodies is checked by `coal.distance` and a bound of the approach of the two bodies. Let the joints move by
Δ from a configuration, one after the other, the joint nearest to the base first. When joint i moves, the bodies beyond
it do not move relative to each other. Hence no point of a body moves more than its distance from the joint's axis times
|Δ_i|, or than |Δ_i| if the joint is prismatic. The sum over the joints that move exactly one body of a pair bounds the
approach.

At the centre of an interval of the curve the velocity x′ of a point, by arc length, is the sum over the joints, and no
point of a body is faster than its fastest corner. Away from the centre x′ changes at most by ‖x″‖: with joint j nearer
to the base than joint k, ‖∂²x/∂q_j∂q_k‖ is at most R_k if k is revolute, 1 if k is prismatic, and 0 if j is prismatic.
R_k is the length of the chain from joint k to the farthest point.
"""

from __future__ import annotations

from collections.abc import Container, Iterator
from math import atan2, inf, sqrt
from time import perf_counter
from typing import Any, NamedTuple

import coal
import numpy as np
import pinocchio as pin

from safe_ompl.certificates.claims import ClaimedStretch, ClaimedTool
from safe_ompl.certificates.verifier.motion import RecordedLaw, RecordedPiece
from safe_ompl.common import CertificateError, FloatArray
from safe_ompl.io import schema
from safe_ompl.robot import Robot
from safe_ompl.scene import Scene

# Error bound of coal's distances.
GJK = 1e-5  # [m]


class Budget:
    """The time limit [s] of a verification. `where` is the current place, for the error message."""

    def __init__(self, seconds: float) -> None:
        self.where = "its beginning"
        self._seconds, self._end = seconds, perf_counter() + seconds

    def spend(self) -> None:
        """Raise CertificateError if the time is over."""
        if perf_counter() > self._end:
            raise CertificateError(
                f"undecided: all earlier checks passed, but {self._seconds:g} s were over at {self.where}; "
                "give more time (--time)"
            )


ENDLESS = Budget(inf)


class Separations:
    """Distances of pairs of bodies and obstacles by `names`, bounds of their approach, and required distances."""

    def __init__(self, robot: Robot, scene: Scene, claims: ClaimedStretch, budget: Budget = ENDLESS) -> None:
        self._robot, self._data, self.budget = robot, robot.shared.model.createData(), budget
        self._links = list(robot.shared.collision_model.geometryObjects)
        self._points = [corners(link.geometry) for link in self._links]
        self._movers = [joints_below(robot, int(link.parentJoint)) for link in self._links]
        self._obstacles = [
            (f"{schema.OBSTACLE}{name}", obstacle, shape, coal.Transform3s(place.rotation, place.translation))
            for obstacle in scene
            for name, shape, place in obstacle.geometries()
        ]
        self._own = [(int(pair.first), int(pair.second)) for pair in robot.shared.collision_model.collisionPairs]
        self._required = [claims.required(obstacle.name) for _, obstacle, _, _ in self._obstacles]
        moving = [link.name for link in self._links if link.parentJoint != 0]
        self.names = [(self._links[a].name, self._links[b].name) for a, b in self._own]
        self.names += [
            (link, name)
            for name, obstacle, _, _ in self._obstacles
            for link in moving
            if plain_name(link) not in obstacle.touched_by
        ]

    def examined(
        self, q: FloatArray, steps: FloatArray, only: Container[tuple[str, str]]
    ) -> Iterator[tuple[tuple[str, str], float, float, float]]:
        """Yield names, distance at `q`, largest approach in `steps` and required distance of the pairs in `only`."""
        self.budget.spend()
        robot, links = self._robot, self._links
        steps = robot.coupling.reach(steps)
        pin.forwardKinematics(robot.shared.model, self._data, robot.pinocchio_configuration(q))
        places = [self._data.oMi[int(link.parentJoint)] * link.placement for link in links]
        poses = [coal.Transform3s(place.rotation, place.translation) for place in places]
        radii = self._radii(places)
        for a, b in self._own:
            if (links[a].name, links[b].name) not in only:
                continue
            apart = self.distance(links[a].geometry, poses[a], links[b].geometry, poses[b])
            only_a = [i for i in self._movers[a] if i not in self._movers[b]]
            only_b = [i for i in self._movers[b] if i not in self._movers[a]]
            approach = sum(radii[a][i] * steps[i] for i in only_a) + sum(radii[b][i] * steps[i] for i in only_b)
            yield (links[a].name, links[b].name), apart, float(approach), 0.0
        for k, link in enumerate(links):
            if link.parentJoint == 0:
                continue
            approach = float(sum(radii[k][i] * steps[i] for i in self._movers[k]))
            for (name, _, shape, pose), required in zip(self._obstacles, self._required, strict=True):
                if (link.name, name) in only:
                    yield (link.name, name), self.distance(link.geometry, poses[k], shape, pose), approach, required

    @staticmethod
    def distance(shape: Any, pose: Any, other: Any, other_pose: Any) -> float:
        """Return the distance [m] of two shapes at given poses."""
        # A result that is used twice keeps the smaller of both distances or overwrites it, so each query has its own.
        result = coal.DistanceResult()
        return float(coal.distance(shape, pose, other, other_pose, coal.DistanceRequest(), result))

    def _radii(self, places: list[pin.SE3]) -> FloatArray:
        """Return distances of each body's farthest point from the axes of its joints; 1 for prismatic joints."""
        axes, origins = joint_lines(self._robot, self._data)
        radii = np.zeros((len(places), len(axes)))
        for k, ((points, pad), place, by) in enumerate(zip(self._points, places, self._movers, strict=True)):
            radii[k, by] = farthest(points, place, origins[by], axes[by]) + pad
        return np.where(self._robot.joint_prismatic, 1.0, radii)


def farthest(points: FloatArray, place: pin.SE3, origins: FloatArray, axes: FloatArray) -> FloatArray:
    """Return the largest distances of points (V, 3) at a pose from unit axes (J, 3) through origins (J, 3).

    The distance is the largest ‖(p − o) × a‖, computed in the frame of the points.
    """
    (a, b, c), (x, y, z) = (axes @ place.rotation).T, ((origins - place.translation) @ place.rotation).T
    nought = np.zeros_like(a)
    across = np.array([[nought, c, -b], [-c, nought, a], [b, -a, nought]]).reshape(3, -1)
    turned = points @ across  # a × p
    turned -= np.concatenate([b * z - c * y, c * x - a * z, a * y - b * x])
    turned *= turned
    squares: FloatArray = turned.reshape(len(points), 3, len(axes)).sum(axis=1).max(axis=0, initial=0.0)
    return np.sqrt(squares)


def plain_name(name: str) -> str:
    """Return the name of the link or obstacle that a body belongs to."""
    return name.removeprefix(schema.OBSTACLE) if name.startswith(schema.OBSTACLE) else name.rsplit("_", 1)[0]


def joints_below(robot: Robot, joint: int) -> list[int]:
    """Return the joints, counted from 0, from one of Pinocchio's joints (included) to the base."""
    return [above - 1 for above in list(robot.shared.model.supports[joint])[:0:-1]]


def joint_lines(robot: Robot, data: pin.Data) -> tuple[FloatArray, FloatArray]:
    """Return unit axes (m, 3) of the model's joints at the present configuration, and points (m, 3) on the axes."""
    joints = list(data.oMi)[1:]
    axes = [joint.rotation @ axis for joint, axis in zip(joints, robot.shared.chain.axes, strict=True)]
    return np.array(axes), np.array([joint.translation for joint in joints])


def corners(shape: coal.CollisionGeometry) -> tuple[FloatArray, float]:
    """Return points and a radius. The convex hull of the balls around the points contains the shape."""
    if isinstance(shape, coal.Sphere):
        return np.zeros((1, 3)), float(shape.radius)
    if isinstance(shape, coal.Capsule):
        return np.array([[0, 0, -shape.halfLength], [0, 0, shape.halfLength]]), float(shape.radius)
    if isinstance(shape, coal.ConvexBase):
        return np.array(shape.points(), dtype=float).reshape(-1, 3), 0.0
    if isinstance(shape, coal.BVHModelBase):
        return np.array(shape.vertices(), dtype=float).reshape(-1, 3), 0.0
    shape.computeLocalAABB()
    low, high = np.ravel(shape.aabb_local.min_), np.ravel(shape.aabb_local.max_)
    return np.array([[x, y, z] for x in (low[0], high[0]) for y in (low[1], high[1]) for z in (low[2], high[2])]), 0.0


# Tolerance of speed limits.
_SPEED_TOLERANCE = 1e-8  # [m/s]
# Shorter intervals are not divided.
_LEAST_INTERVAL = 1e-7  # [rad]


class _Body(NamedTuple):
    """Points in a joint's frame, the radius of balls around them, and the joints towards the base, outermost first."""

    points: FloatArray
    pad: float
    carrier: int
    movers: list[int]
    # Largest distance of a point of the balls from the origin of the frame [m].
    length: float


class PlainSpeeds:
    """Bounds of the largest speed of the tip, or of all bodies and the tip."""

    def __init__(self, robot: Robot, budget: Budget) -> None:
        self._robot, self._budget = robot, budget
        self._model, self._data = robot.shared.model, robot.shared.model.createData()
        frame = self._model.frames[robot.tip_frame]
        self._tip = self._body(np.array(frame.placement.translation)[None], 0.0, int(frame.parentJoint))
        links = [self._link(link) for link in robot.shared.collision_model.geometryObjects]
        self._all = [body for body in (self._tip, *links) if body.movers]

    def _link(self, link: pin.GeometryObject) -> _Body:
        points, pad = corners(link.geometry)
        place = link.placement
        return self._body(points @ place.rotation.T + place.translation, pad, int(link.parentJoint))

    def _body(self, points: FloatArray, pad: float, carrier: int) -> _Body:
        length = float(np.linalg.norm(points, axis=1).max()) + pad
        return _Body(points, pad, carrier, joints_below(self._robot, carrier), length)

    def exceeded(self, law: RecordedLaw, limit: float, *, tool: bool) -> float | None:
        """Return the arc length [rad] where a speed limit [m/s] of the tip, or of any body, is not proven, or None."""
        bodies = [self._tip] if tool else self._all
        for j, rate in enumerate(law.fastest.tolist()):
            start = law.starts[law.of[j]]
            piece = law.pieces[law.of[j]]
            waiting = [(float(law.edges[j]) - start, float(law.edges[j + 1]) - start)]
            while waiting:
                first, last = waiting.pop()
                middle, half = (first + last) / 2, (last - first) / 2
                exact, bound = self._bounds(piece, middle, half, bodies)
                if bound * rate <= limit + _SPEED_TOLERANCE:
                    continue
                if exact * rate > limit + _SPEED_TOLERANCE or half < _LEAST_INTERVAL:
                    return start + middle
                waiting += [(first, middle), (middle, last)]
        return None

    def _bounds(self, piece: RecordedPiece, middle: float, half: float, bodies: list[_Body]) -> tuple[float, float]:
        """Return the largest ‖x′‖ at the middle of an interval, and a bound over the interval."""
        self._budget.spend()
        robot = self._robot
        q, coupling = piece.at(middle), robot.coupling
        pin.forwardKinematics(self._model, self._data, robot.pinocchio_configuration(q))
        axes, origins = joint_lines(robot, self._data)
        motions, sliding = coupling.motions(piece.at(middle, 1))[:, None] * axes, robot.joint_prismatic[:, None]
        # A point x that a joint carries moves with angular velocity × x + linear velocity.
        angular_velocities = np.where(sliding, 0.0, motions)
        linear_velocities = np.where(sliding, motions, np.cross(origins, motions))
        steps = coupling.reach(piece.most(1))
        slid = np.abs(coupling.values(q)) + half * steps
        most = coupling.reach(piece.most(2))
        exact = [self._speed(body, angular_velocities, linear_velocities) for body in bodies]
        accelerations = [acceleration_bound(robot, body.movers, body.length, steps, most, slid) for body in bodies]
        bounds = (speed + half * acceleration for speed, acceleration in zip(exact, accelerations, strict=True))
        return max(exact, default=0.0), max(bounds, default=0.0)

    def _speed(self, body: _Body, angular_velocities: FloatArray, linear_velocities: FloatArray) -> float:
        place = self._data.oMi[body.carrier]
        angular_velocity, linear_velocity = (
            angular_velocities[body.movers].sum(axis=0),
            linear_velocities[body.movers].sum(axis=0),
        )
        x, y, z = angular_velocity
        # With this matrix, p @ across is the angular velocity × p.
        across = np.array([[0.0, z, -y], [-z, 0.0, x], [y, -x, 0.0]])
        velocity = body.points @ (place.rotation.T @ across) + (place.translation @ across + linear_velocity)
        return sqrt(float((velocity * velocity).sum(axis=1).max())) + body.pad * sqrt(
            float(angular_velocity @ angular_velocity)
        )


def acceleration_bound(
    robot: Robot, movers: list[int], length: float, steps: FloatArray, d2q_ds2: FloatArray, slid: FloatArray
) -> float:
    """Return a bound of ‖x″‖, by arc length, of points moved by the joints `movers`, outermost first.

    The points are within `length` [m] of the origin of the first of these joints. For the model's joints (m,), `steps`
    and `d2q_ds2` bound |q′| and |q″|, and `slid` bounds the extension of prismatic joints [m].
    """
    sliding = robot.joint_prismatic.tolist()
    beneath = float(sum(steps[i] for i in movers if not sliding[i]))
    found = 0.0
    for i in movers:
        radius, own = (1.0, 0.0) if sliding[i] else (length, float(steps[i]))
        beneath -= own
        found += radius * float(steps[i] * (2 * beneath + own) + d2q_ds2[i])
        offset = robot.shared.model.jointPlacements[i + 1].translation
        length += sqrt(float(offset @ offset))
        length += float(slid[i]) if sliding[i] else 0.0
    return found


# Intervals in which the tool moves less are not divided.
_LEAST_TURN = 1e-5  # [rad or m]
# Intervals in which no joint moves more are not divided.
_LEAST_STEP = 1e-7  # [rad or m]
_TOOL_ROUNDING = 1e-7  # [rad or m]


class PlainTool:
    """The claimed limits of angle and position of the tip, with bounds of their change."""

    def __init__(self, robot: Robot, claim: ClaimedTool, budget: Budget = ENDLESS) -> None:
        self._robot, self._claim, self._budget = robot, claim, budget
        self._model, self._data = robot.shared.model, robot.shared.model.createData()
        self._movers = joints_below(robot, int(self._model.frames[robot.tip_frame].parentJoint))

    def exceeded(self, piece: RecordedPiece) -> tuple[float, str] | None:
        """Return the share of a piece at which a limit is not proven, and the name of the limit, or None."""
        steps, tube = piece.steps, piece.width
        waiting = [(0.5, 0.5)]
        while waiting:
            centre, half = waiting.pop()
            for name, excess, change in self._excesses(piece.at(piece.length * centre), half * steps + tube):
                if excess + change <= _TOOL_ROUNDING:
                    continue
                if excess > _TOOL_ROUNDING or change < _LEAST_TURN or half * steps.max() < _LEAST_STEP:
                    return centre, name
                waiting += [(centre + half / 2, half / 2), (centre - half / 2, half / 2)]
                break
        return None

    def _excesses(self, q: FloatArray, steps: FloatArray) -> list[tuple[str, float, float]]:
        """Return name, excess at `q`, and largest change of the excess within `steps`, for each limit."""
        self._budget.spend()
        robot, claim = self._robot, self._claim
        pin.framesForwardKinematics(self._model, self._data, robot.pinocchio_configuration(q))
        tip = self._data.oMf[robot.tip_frame]
        axes, origins = (of[self._movers] for of in joint_lines(robot, self._data))
        reach, slides = robot.coupling.reach(steps)[self._movers], robot.joint_prismatic[self._movers]
        found = []
        if claim.orientation is not None:
            axis, direction = claim.orientation.axis, claim.orientation.direction
            # The axis of the tool moves on cones about the axes of the joints.
            tool = tip.rotation @ axis / sqrt(axis @ axis)
            across, along = np.cross(tool, direction), float(tool @ direction)
            angle = atan2(sqrt(float(across @ across)), along)
            turned = reach @ np.where(slides, 0.0, np.linalg.norm(np.cross(axes, tool), axis=1))
            found.append(("orientation", angle - claim.orientation.angle, float(turned)))
        if claim.position is not None:
            bounds = claim.position.items()
            here = dict(zip("xyz", tip.translation, strict=True))
            outside = max(max(low - here[key], here[key] - high) for key, (low, high) in bounds)
            arms = np.linalg.norm(np.cross(axes, tip.translation - origins), axis=1)
            found.append(("position", float(outside), float(reach @ np.where(slides, 1.0, arms))))
        return found
