"""Checks certificates, on its own: one pair at a time by `coal.distance`, with a displacement bound of its own.

Nothing here is shared with what writes certificates, plans or proves motions: no broad phase, no margins inside
queries, no displacement radii, no field kernels. From the models come only robot, scene and their kinematics.

The displacement bound: let the joints move by Δ from a configuration, the one nearest to the base first. When
joint i moves, the bodies beyond it still hang on it as they did before, so that no point of a body moves more than its
distance from the joint's axis, times |Δ_i|; if it slides, more than |Δ_i|. The sum over the joints that move one
body of a pair but not the other bounds how far the two can approach each other.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import coal
import numpy as np
import pinocchio as pin

from safe_ompl.arrays import FloatArray, finite_array
from safe_ompl.danger.field import DangerField
from safe_ompl.errors import CertificateError, InputError
from safe_ompl.paths.certificate.certificate import FORMAT, OBSTACLE, VERSION, digest
from safe_ompl.paths.certificate.claims import check_claims, check_kind
from safe_ompl.paths.certificate.plain_danger import PlainDanger
from safe_ompl.robot.fingerprint import robot_hash
from safe_ompl.robot.robot import Robot
from safe_ompl.scene.scene import Scene

_GJK = 1e-5  # [m] coal's distances are at most this far off
_FARTHEST = 1e4  # [rad] a joint that turns on and on farther than this has no exact angle any more
_GAP = 1e-9  # of an edge: intervals that are nearer to each other leave nothing out
_KEYS = (
    *("format", "version", "source", "robot", "scene", "joint_names", "path", "pairs"),
    *("clearance", "danger", "edges", "digest"),
)


@dataclass(frozen=True)
class Verified:
    """What was checked of a certificate that holds.

    Attributes
    ----------
    edges, intervals, distances : int
        How many of each.
    """

    edges: int
    intervals: int
    distances: int


def verify(
    content: Mapping[str, Any],
    robot: Robot,
    scene: Scene,
    *,
    field: DangerField | None = None,
    spacing: float | None = None,
) -> Verified:
    """Check a certificate against a robot and a scene.

    Parameters
    ----------
    content : mapping
        The certificate.
    robot, scene
        What it must be about.
    field : DangerField, optional
        If it claims a bound of the danger, this must be of the same kind: aggregate, weighting, k1 and sharpness. Only
        these are read. Without a field the claim is checked in the kind that it names itself.
    spacing : float, optional
        With a field: the distance between danger points that a claim must have [m]; default: the scene's own.

    Raises
    ------
    CertificateError
        If anything in it does not hold: names the first edge and interval.
    InputError
        If it is no certificate.
    """
    check_form(content)
    try:
        found = _verified(content, robot, scene)
        if field is not None and content["danger"] is not None:
            check_kind(content["danger"], field, scene.spacing if spacing is None else spacing)
        return found
    except (ArithmeticError, AttributeError, LookupError, TypeError, ValueError) as error:
        if isinstance(error, InputError):
            raise
        raise CertificateError(f"it is malformed: {type(error).__name__}: {error}") from None


def _verified(content: Mapping[str, Any], robot: Robot, scene: Scene) -> Verified:
    _check_origin(content, robot, scene)
    path = finite_array(content["path"], (None, robot.n), "path")
    _check_limits(robot, path)
    check_claims(content, robot, scene)
    ends = path[1:] if len(path) > 1 else path
    if len(content["edges"]) != len(ends):
        raise CertificateError(f"the path has {len(ends)} edges, the certificate {len(content['edges'])}")
    bodies = _Bodies(robot, scene, content["clearance"])
    if sorted(map(tuple, content["pairs"])) != sorted(bodies.names):
        raise CertificateError("its pairs of bodies are not those of robot and scene")
    intervals = 0
    for k, (edge, start, end) in enumerate(zip(content["edges"], path, ends, strict=False)):
        _check_cover(k, edge)
        delta = robot.difference(start, end)
        for j, interval in enumerate(edge):
            _check_interval(f"edge {k}, interval {j}", interval, start, delta, bodies, content["pairs"])
            intervals += 1
    _check_danger(content["danger"], robot, scene, path, ends)
    if content["digest"] != digest(content):
        raise CertificateError(
            "every interval holds, but the file is not as it was written: its digest differs"
        )
    return Verified(len(ends), intervals, intervals * len(bodies.names))


def check_form(content: Any) -> None:
    """Raise InputError unless `content` has the form of a certificate."""
    if not isinstance(content, Mapping) or content.get("format") != FORMAT:
        raise InputError(f"this is not a {FORMAT}")
    if content.get("version") != VERSION:
        raise InputError(f"version {content.get('version')!r} of the format is not known, {VERSION} is")
    missing = [key for key in _KEYS if key not in content]
    if missing:
        raise InputError(f"the certificate has no {missing[0]!r}")


# ------------------------------------------------------------------------------------------- what is it about


def _check_origin(content: Mapping[str, Any], robot: Robot, scene: Scene) -> None:
    if list(content["joint_names"]) != list(robot.joint_names):
        raise CertificateError(
            f"joint order: it has {content['joint_names']}, the robot {list(robot.joint_names)}"
        )
    if content["robot"]["hash"] != robot_hash(robot):
        raise CertificateError(
            f"the robot has changed: {robot.name!r} is not the one that it was written for"
        )
    if content["scene"]["hash"] != scene.content_hash():
        raise CertificateError("the scene has changed since it was written")


def _check_limits(robot: Robot, path: FloatArray) -> None:
    if not len(path):
        raise CertificateError("the path is empty")
    for k, q in enumerate(path):
        for i in range(robot.n):
            if robot.continuous[i] and abs(q[i]) > _FARTHEST:
                raise CertificateError(
                    f"way point {k}: joint {robot.joint_names[i]!r} = {q[i]:g} is more than {_FARTHEST:g} rad"
                )
            if not robot.continuous[i] and not robot.lower[i] - 1e-9 <= q[i] <= robot.upper[i] + 1e-9:
                raise CertificateError(
                    f"way point {k}: joint {robot.joint_names[i]!r} = {q[i]:g} is outside its limits"
                )


def _check_cover(edge: int, intervals: Any) -> None:
    """Raise CertificateError unless the intervals, put in order, leave nothing of [0, 1] out."""
    reached = 0.0
    for interval in sorted(intervals, key=lambda i: float(i["centre"]) - float(i["half_length"])):
        centre, half = float(interval["centre"]), float(interval["half_length"])
        if centre - half > reached + _GAP:
            raise CertificateError(
                f"edge {edge}: no interval covers {reached:.6f} to {centre - half:.6f} of it"
            )
        reached = max(reached, centre + half)
    if reached < 1.0 - _GAP:
        raise CertificateError(f"edge {edge}: no interval covers {reached:.6f} to 1 of it")


def _check_interval(
    name: str,
    interval: Mapping[str, Any],
    start: FloatArray,
    delta: FloatArray,
    bodies: _Bodies,
    pairs: list[list[str]],
) -> None:
    centre, half = float(interval["centre"]), float(interval["half_length"])
    name = f"{name} (centre {centre:.6f}, half-length {half:.6f})"
    if not (0.0 <= centre <= 1.0 and half >= 0.0):
        raise CertificateError(f"{name}: not a part of the edge")
    if len(interval["margins"]) != len(pairs):
        raise CertificateError(f"{name}: {len(interval['margins'])} margins for {len(pairs)} pairs")
    margins = {tuple(pair): float(m) for pair, m in zip(pairs, interval["margins"], strict=True)}
    for pair, distance, approach, required in bodies.examined(start + centre * delta, half * np.abs(delta)):
        if not margins[pair] >= approach + required:
            raise CertificateError(
                f"{name}: the margin of {_between(pair)} is {1e3 * margins[pair]:.3f} mm, "
                f"{1e3 * (approach + required):.3f} mm are needed"
            )
        if not distance - _GJK > margins[pair]:
            raise CertificateError(
                f"{name}: {_between(pair)} are {1e3 * distance:.3f} mm apart, "
                f"{1e3 * margins[pair]:.3f} mm are claimed"
            )


def _between(pair: tuple[str, str]) -> str:
    return f"{_plain(pair[0])!r} and {_plain(pair[1])!r}"


def _plain(name: str) -> str:
    return name.removeprefix(OBSTACLE) if name.startswith(OBSTACLE) else name.rsplit("_", 1)[0]


# ------------------------------------------------------------------------------------------------- distances


class _Bodies:
    """Bodies and obstacles, each where it is; pair by pair."""

    def __init__(self, robot: Robot, scene: Scene, claim: Mapping[str, Any] | None) -> None:
        self._robot, self._data = robot, robot.shared.model.createData()
        self._links = list(robot.shared.collision_model.geometryObjects)
        self._points = [_corners(link.geometry) for link in self._links]
        self._movers = [_joints_below(robot, int(link.parentJoint)) for link in self._links]
        self._obstacles = [
            (f"{OBSTACLE}{name}", obstacle.name, shape, coal.Transform3s(place.rotation, place.translation))
            for obstacle in scene
            for name, shape, place in obstacle.geometries()
        ]
        self._own = [
            (int(pair.first), int(pair.second)) for pair in robot.shared.collision_model.collisionPairs
        ]
        self._axes = robot.shared.chain.axes
        self._request = coal.DistanceRequest()
        self._required = [
            [_required(claim, _plain(link.name), name) for _, name, _, _ in self._obstacles]
            for link in self._links
        ]
        moving = [link.name for link in self._links if link.parentJoint != 0]
        self.names = [(self._links[a].name, self._links[b].name) for a, b in self._own]
        self.names += [(link, name) for name, _, _, _ in self._obstacles for link in moving]

    def examined(
        self, q: FloatArray, steps: FloatArray
    ) -> Iterator[tuple[tuple[str, str], float, float, float]]:
        """For each pair: its names, its distance at `q`, how far it can approach in `steps`, what it must keep."""
        robot, links = self._robot, self._links
        steps = robot.coupling.reach(steps)
        pin.forwardKinematics(robot.shared.model, self._data, robot.pinocchio_configuration(q))
        places = [self._data.oMi[int(link.parentJoint)] * link.placement for link in links]
        poses = [coal.Transform3s(place.rotation, place.translation) for place in places]
        radii = self._radii(places)
        for a, b in self._own:
            apart = self._distance(links[a].geometry, poses[a], links[b].geometry, poses[b])
            only_a = [i for i in self._movers[a] if i not in self._movers[b]]
            only_b = [i for i in self._movers[b] if i not in self._movers[a]]
            approach = sum(radii[a][i] * steps[i] for i in only_a) + sum(
                radii[b][i] * steps[i] for i in only_b
            )
            yield (links[a].name, links[b].name), apart, float(approach), 0.0
        for k, link in enumerate(links):
            if link.parentJoint == 0:
                continue
            approach = float(sum(radii[k][i] * steps[i] for i in self._movers[k]))
            for (name, _, shape, pose), required in zip(self._obstacles, self._required[k], strict=True):
                apart = self._distance(link.geometry, poses[k], shape, pose)
                yield (link.name, name), apart, approach, required

    def _distance(self, shape: Any, pose: Any, other: Any, other_pose: Any) -> float:
        # A result that is used twice keeps the smaller distance of the two, or overwrites it: never share one.
        result = coal.DistanceResult()
        return float(coal.distance(shape, pose, other, other_pose, self._request, result))

    def _radii(self, places: list[pin.SE3]) -> FloatArray:
        """Return how far each body's farthest point is from the axes of the joints that move it; 1 if one slides."""
        joints = list(self._data.oMi)[1:]
        axes = np.array([joint.rotation @ axis for joint, axis in zip(joints, self._axes, strict=True)])
        origins = np.array([joint.translation for joint in joints])
        radii = np.zeros((len(places), len(self._axes)))
        for k, ((points, pad), place, by) in enumerate(zip(self._points, places, self._movers, strict=True)):
            arms = (points @ place.rotation.T + place.translation)[:, None, :] - origins[by]
            across = arms - (arms * axes[by]).sum(axis=2)[:, :, None] * axes[by]
            radii[k, by] = np.sqrt((across * across).sum(axis=2).max(axis=0)) + pad
        return np.where(self._robot.joint_prismatic, 1.0, radii)


def _required(claim: Mapping[str, Any] | None, link: str, obstacle: str) -> float:
    """Return what a link must keep from an obstacle [m] by a claim of clearance."""
    if claim is None or obstacle not in claim["obstacles"] or [link, obstacle] in claim["exempt"]:
        return 0.0
    return float(claim["distance"])


def _joints_below(robot: Robot, joint: int) -> list[int]:
    """Return the joints, counted from 0, between a joint of Pinocchio's and the base, itself included."""
    found = []
    while joint != 0:
        found.append(joint - 1)
        joint = int(robot.shared.model.parents[joint])
    return found


def _corners(shape: coal.CollisionGeometry) -> tuple[FloatArray, float]:
    """Return points, and a radius, such that the balls around the points have the shape in their convex hull."""
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
    return np.array(
        [[x, y, z] for x in (low[0], high[0]) for y in (low[1], high[1]) for z in (low[2], high[2])]
    ), 0.0


# ---------------------------------------------------------------------------------------------------- danger


def _check_danger(
    claim: Mapping[str, Any] | None, robot: Robot, scene: Scene, path: FloatArray, ends: FloatArray
) -> None:
    if claim is None:
        return
    danger = PlainDanger(robot, scene, claim)
    for k, (start, end) in enumerate(zip(path, ends, strict=False)):
        failure = danger.exceeded(start, robot.difference(start, end), float(claim["bound"]))
        if failure is not None:
            raise CertificateError(
                f"edge {k}: danger {failure[1]:.4f} near {failure[0]:.6f} of it, {claim['bound']:.4f} is claimed"
            )
