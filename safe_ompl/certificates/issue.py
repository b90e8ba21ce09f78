"""Issues certificates: paths with the proof that they may be driven, which anyone can check (`verify`).

A certificate holds, for each edge, intervals that cover it. At the centre of each interval every pair of bodies is
farther apart than its margin, and the margin is more than the two can approach each other within the interval. The
digest shows that a file has changed; it is no signature, for whoever changes a file can compute it. A motion of
polynomials that is proven (`MotionCheck`) has no intervals: the verifier divides it itself.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from safe_ompl.certificates.claims import Certificate, Clearance, MovingObstacles, Tool
from safe_ompl.certificates.verifier.verify import Terms, verify
from safe_ompl.collision import (
    DISTANCE_ERROR,
    CollisionChecker,
    MotionLimit,
    MotionProver,
    Separation,
    TipBounds,
    ToolLimit,
    ToolOrientation,
    Verdict,
)
from safe_ompl.common import BoolArray, CertificateError, FloatArray, InputError, PlanningError, finite_array
from safe_ompl.danger import CertifiedDanger, DangerField, DangerLimit, KinetostaticField
from safe_ompl.io import carried_robot, carried_scene, schema
from safe_ompl.motions import Motion, MotionCheck
from safe_ompl.robot import Robot
from safe_ompl.scene import People, Scenario, Scene
from safe_ompl.trajectories import RateLimits, SmoothLaw, Trajectory

_FIRST_REACH = 0.2  # [m] bodies move at most this far in half of a first interval
_FLOOR = 1e-6  # [m] intervals in which the bodies move less are not divided any more
_SPARE = 1e-7  # [m] by which margins exceed the approach, for rounding
_OVERLAP = 1e-6  # of intervals
_TINY = 1e-12  # [m]
_WIDER, _TRIALS = 1.1, 50  # bounds of the danger within a tube
_KIND = ("aggregate", "weighting", "k1", "sharpness")  # of a danger
_IN_MOTION = ("k2", "gamma")  # what that of a motion in time has besides
_LEAST_SLACK = 0.03  # of the danger that is claimed, so that it can be confirmed by plain means


def certificate(
    path: ArrayLike,
    robot: Robot,
    scene: Scene,
    *,
    field: DangerField | None = None,
    spacing: float | None = None,
    max_danger: float | None = None,
    clearance: Mapping[str, Any] | None = None,
    moving_obstacles: Mapping[str, Any] | None = None,
    tool: Mapping[str, Any] | None = None,
    trajectory: Trajectory | None = None,
    tube: ArrayLike | None = None,
    also_sampled: str | None = None,
    source: Mapping[str, Any] | None = None,
) -> dict[str, Any]:
    """Return the certificate of a path, as plain numbers, lists and strings.

    Parameters
    ----------
    path : array_like, shape (N, n)
        Way points [rad or m]; between them joints move on straight lines, continuous joints the short way.
    robot : Robot
        The robot.
    scene : Scene
        The obstacles.
    field : DangerField, optional
        Claim a bound of the path's danger, too, where there is one.
    spacing : float, optional
        Distance between the field's danger points [m]; default: the scene's own.
    max_danger : float, optional
        Claim this bound of the danger, if it can be proven and is lower than what is claimed otherwise.
    clearance : mapping, optional
        Claim a clearance, too: `distance` [m], the names of the `obstacles`, and `exempt` pairs of link and obstacle.
    moving_obstacles : mapping, optional
        Claim, too, that the path stays free, and keeps its clearance, whatever obstacles do that move no faster than
        their `speeds` (by name [m/s]), until a `time` [s] after the moment of the scene: see
        `MotionProver.with_moving_obstacles`.
    tool : mapping, optional
        Claim limits of the tool, too: an `orientation` with `axis` (of the tip), `direction` (in the world) and `angle`
        [rad], a `position` with bounds of `x`, `y` and `z` [m]; either or both.
    trajectory : Trajectory, optional
        Claim the path in time, too: duration, limits of joint velocities and accelerations, that the curve is free, its
        stops beside people; of limbs that it may touch neither stops nor speeds. Of its danger in motion the limit that
        it was made for, or else, with a `field`, its proven peak.
    tube : array_like, shape (n,), optional
        Claim all this of every motion, too, whose joints are within these widths of the path [rad or m]; not of a
        trajectory.
    also_sampled : str, optional
        What the path was planned to obey without proof, such as "your checker, sampled at 0.01 rad". The verification
        reports that it is not covered.
    source : mapping, optional
        Where robot and scene come from: kept as it is. They travel inside in any case.

    Raises
    ------
    InputError
        If the path has the wrong shape or is not finite, a claim has no meaning, or a file of robot or scene is gone.
    PlanningError
        If an edge cannot be proven.
    """
    points = finite_array(path, (None, robot.n), "path")
    if not len(points):
        raise InputError("path must have a configuration at least, got none")
    clear = moving = None
    if clearance is not None:
        clear = schema.record(Clearance)("clearance", schema.as_plain(clearance))
        clear.check(robot, scene)
    if moving_obstacles is not None:
        moving = schema.record(MovingObstacles)("moving_obstacles", schema.as_plain(moving_obstacles))
        moving.check(scene)
    pairs = Pairs(robot, scene)
    required = pairs.required(clear, moving)
    apart = scene.spacing if spacing is None else spacing
    widths = np.zeros(robot.n) if tube is None else finite_array(tube, (robot.n,), "tube")
    proof = None
    if widths.any():
        separation = Separation(tube=tuple(widths.tolist()))
        proof = MotionProver(CollisionChecker(robot, scene), separation=separation)
    content = {
        **opening(robot, scene, source),
        "path": points.tolist(),
        "pairs": [list(names) for names in pairs.names],
        "clearance": None if clear is None else schema.as_plain(vars(clear)),
        "danger": None if field is None else _danger_claim(field, apart, points, max_danger, proof),
        "moving_obstacles": None if moving is None else schema.as_plain(vars(moving)),
        "also_sampled": also_sampled,
        "edges": [
            _intervals(pairs, required, k, start, robot.difference(start, end), widths)
            for k, (start, end) in enumerate(schema.edges_of(points))
        ],
    }
    if tool is not None:
        content["tool"] = _tool_claim(tool, robot, points, proof)
    if proof is not None:
        content["tube"] = widths.tolist()
    if trajectory is not None:
        content["trajectory"] = trajectory_claim(trajectory, robot, scene)
        moving_field = trajectory.danger_field or (None if field is None else KinetostaticField(field))
        if moving_field is not None:
            danger = moving_danger_claim(trajectory, moving_field, apart, scene)
            content["trajectory"] |= {} if danger is None else {"danger": danger}
    signed = {**content, "digest": schema.digest(content)}
    Certificate.read(signed).check(robot, scene)
    return signed


class Pairs:
    """All pairs of a moving body and an obstacle's part, and the robot's own pairs; none is left out.

    Attributes
    ----------
    names : list of (str, str)
        Names of the bodies in Pinocchio's geometry, obstacles after "obstacle:".
    radii : ndarray, shape (P, n)
        Displacement radii of the pairs.
    """

    def __init__(self, robot: Robot, scene: Scene) -> None:
        self._robot = robot
        self._geometry = robot.shared.collision_model.copy()
        bodies = list(robot.shared.collision_model.geometryObjects)
        self._owners: list[str | None] = [None] * len(bodies)
        for obstacle in scene:
            for name, shape, placement in obstacle.geometries():
                added = pin.GeometryObject(f"{schema.OBSTACLE}{name}", 0, placement, shape)
                number = self._geometry.addGeometryObject(added)
                self._owners.append(obstacle.name)
                for k, body in enumerate(bodies):
                    if body.parentJoint != 0:
                        self._geometry.addCollisionPair(pin.CollisionPair(k, number))
        self._pairs = [(int(pair.first), int(pair.second)) for pair in self._geometry.collisionPairs]
        objects = self._geometry.geometryObjects
        self.names = [(objects[a].name, objects[b].name) for a, b in self._pairs]
        still = np.zeros((len(objects) - len(bodies), robot.bounds.joint_radii.shape[1]))
        self._moves: FloatArray = np.vstack([robot.bounds.joint_radii, still])
        self._first, self._second = np.array(self._pairs, dtype=np.intp).reshape(-1, 2).T
        self._approaching: BoolArray = (self._moves[self._first] > 0) != (self._moves[self._second] > 0)
        self.radii: FloatArray = self._between(self._moves)
        self._data, self._results = robot.shared.model.createData(), pin.GeometryData(self._geometry)

    def distances(self, q: FloatArray) -> FloatArray:
        """Return the distance (P,) [m] of every pair at `q: (n,)`."""
        full = self._robot.pinocchio_configuration(q)
        pin.computeDistances(self._robot.shared.model, self._data, self._geometry, self._results, full)
        return np.array([result.min_distance for result in self._results.distanceResults])

    def radii_at(self, q: FloatArray) -> FloatArray:
        """Return the displacement radii (P, n) for motions that start at `q: (n,)`; none larger than `radii`."""
        moves = self._moves.copy()
        known = len(self._robot.bounds.joint_radii)
        moves[:known] = np.minimum(moves[:known], self._robot.bounds.joint_radii_at(q))
        return self._between(moves)

    def _between(self, moves: FloatArray) -> FloatArray:
        first, second = moves[self._first], moves[self._second]
        return self._robot.coupling.radii(np.where(self._approaching, first + second, 0.0))

    def required(self, clear: Clearance | None, moving: MovingObstacles | None) -> FloatArray:
        """Return the distance (P,) [m] that each pair must keep: its clearance, and as far as its obstacle moves."""
        distances = np.zeros(len(self._pairs))
        for k, (a, b) in enumerate(self._pairs):
            link, obstacle = self._geometry.geometryObjects[a].name.rsplit("_", 1)[0], self._owners[b]
            if obstacle is not None:
                distances[k] = 0.0 if clear is None else clear.of(link, obstacle)
                distances[k] += 0.0 if moving is None else moving.of(obstacle)
        return distances


def opening(robot: Robot, scene: Scene, source: Mapping[str, Any] | None) -> dict[str, Any]:
    """Return what every certificate begins with: its form, where it comes from, robot and scene."""
    return {
        "format": schema.FORMAT,
        "version": schema.VERSION,
        "source": schema.as_plain(source or {}),
        "robot": carried_robot(robot),
        "scene": carried_scene(scene),
        "joint_names": list(robot.joint_names),
    }


def _intervals(
    pairs: Pairs, required: FloatArray, edge: int, start: FloatArray, delta: FloatArray, tube: FloatArray
) -> list[dict[str, Any]]:
    """Cover an edge from its start to its end: each interval as large as the distances at its centre allow."""
    steps = np.abs(delta)
    widest = float((pairs.radii @ steps).max(initial=0.0))
    least = min(0.5, _FLOOR / max(widest, _FLOOR))
    reached, half, proven = 0.0, min(0.5, _FIRST_REACH / max(widest, _FIRST_REACH)), []
    while reached < 1.0:
        centre = min(reached + half, (reached + 1.0) / 2)
        q = start + centre * delta
        radii = pairs.radii_at(q)
        approach, needed = np.maximum(radii @ steps, _TINY), required + radii @ tube
        room = pairs.distances(q) - needed - _SPARE - 1.2 * DISTANCE_ERROR
        free = float(np.min(room / approach, initial=1.0 - centre + _OVERLAP))
        if free >= centre - reached and free > 0:
            margins = needed + free * approach + _SPARE
            proven.append({"centre": centre, "half_length": free, "margins": margins.tolist()})
            reached, half = centre + free * (1 - _OVERLAP), 1.2 * free
        elif half < least:
            raise PlanningError(f"edge {edge} cannot be certified: too near at {centre:.6f} of its length")
        else:
            half = max(0.9 * free, half / 3)
    return proven


def _keeps(limit: MotionLimit, path: FloatArray, proof: MotionProver | None) -> Iterator[bool]:
    """Yield for each edge whether a limit is proven to be kept; with a tube `proof` has it."""
    prover = limit if proof is None else proof.with_limits([limit])
    return (prover.check(start, end).verdict is Verdict.FREE for start, end in schema.edges_of(path))


def _tool_claim(given: Mapping[str, Any], robot: Robot, path: FloatArray, proof: MotionProver | None) -> dict[str, Any]:
    """Return a claim about the tool in plain numbers, if every edge keeps to it."""
    plain: dict[str, Any] = schema.as_plain(given)
    claim, limits = schema.record(Tool)("tool", plain), list[ToolLimit]()
    if claim.orientation is not None:
        wanted = claim.orientation
        limits.append(ToolOrientation(robot, wanted.axis, wanted.direction, wanted.angle))
    if claim.position is not None:
        bounds = [list(claim.position.get(axis, (-np.inf, np.inf))) for axis in "xyz"]
        limits.append(TipBounds(robot, *np.transpose(bounds)))
    for limit in limits:
        for k, kept in enumerate(_keeps(limit, path, proof)):
            if not kept:
                raise PlanningError(f"edge {k} cannot be certified: its {limit.name} is not proven")
    return plain


def _danger_claim(
    field: DangerField, spacing: float, path: FloatArray, limit: float | None, proof: MotionProver | None
) -> dict[str, Any] | None:
    bounds = CertifiedDanger(field).of_path(path)
    bound = max(bounds.upper, (1 + _LEAST_SLACK) * bounds.lower)
    if proof is not None and np.isfinite(bound):
        tried = (bound * _WIDER**k for k in range(_TRIALS))
        kept = (b for b in tried if all(_keeps(DangerLimit(field, b), path, proof)))
        bound = next(kept, np.inf)  # what the tube adds is not known before
    if limit and limit < bound:
        bound = limit if all(_keeps(DangerLimit(field, limit), path, proof)) else bound
    if not np.isfinite(bound):
        return None
    return {"bound": bound, **_kind(field, spacing)}


def _check_points(field: DangerField, spacing: float, scene: Scene) -> None:
    """Raise InputError if the field's danger points are not those of the scene: no verification would look at them."""
    if not np.array_equal(field.points, scene.danger_points(spacing)[0]):
        raise InputError(f"the danger points of the field are not those of the scene, {spacing:g} m apart", "spacing")


def _kind(field: DangerField, spacing: float, *more: str) -> dict[str, Any]:
    return {"spacing": spacing, **{name: getattr(field, name) for name in (*_KIND, *more)}}


# ------------------------------------------------------------------------------------------------ motions in time


def trajectory_claim(trajectory: Trajectory, robot: Robot, scene: Scene) -> dict[str, Any]:
    """Return the claim of a trajectory in plain numbers; what is claimed of its danger comes from `danger_claim`."""
    curve, law, jerk = trajectory.curve, trajectory.law, trajectory.limits.jerk
    more: dict[str, Any] = {"tool_speed": trajectory.tool_speed, "link_speed": trajectory.link_speed}
    if isinstance(law, SmoothLaw) and jerk is not None:
        more |= {"window": law.window, "jerk": jerk.tolist()}
    stops = None
    if trajectory.people is not None and trajectory.brakes is not None:
        people = _people(trajectory.people, scene)
        stops = {**people, "brakes": trajectory.brakes.tolist()}
    return {
        "pieces": [
            {
                **{key: getattr(piece, key).tolist() for key in ("start", "slope", "bend", "swing")},
                "length": piece.length,
            }
            for piece in curve.pieces
        ],
        "corners": list(curve.stops),
        "edges": law.edges.tolist(),
        "squares": (law.plan_squares if isinstance(law, SmoothLaw) else law.squares).tolist(),
        "duration": law.duration,
        "velocity": trajectory.limits.velocity.tolist(),
        "acceleration": trajectory.limits.acceleration.tolist(),
        "stops": stops,
        **{key: value for key, value in more.items() if value is not None},
    }


def _people(people: People, scene: Scene) -> dict[str, Any]:
    """Return what stops beside people are about; of the speeds of limbs those of limbs that are there."""
    if people.reach is not None:
        raise InputError("a certificate states speeds of people, no calibrated reach: leave it out", "people.reach")
    parts = {part: part[len(name) + 1 :] for name in people.names(scene) for part, _, _ in scene[name].geometries()}
    found: dict[str, Any] = {
        "who": list(people.names(scene)),
        "speed": people.speed,
        "speeds": {limb: speed for limb, speed in people.speeds.items() if limb in parts.values()},
        "reaction_time": people.reaction_time,
        "clearance": people.clearance,
    }
    if people.contact:
        touched = [part for part, limb in parts.items() if people.region_of(limb).force > 0]
        found |= {"contact": touched} if touched else {}
    return found


def moving_danger_claim(
    trajectory: Trajectory, field: KinetostaticField, spacing: float, scene: Scene
) -> dict[str, Any] | None:
    """Return the claim of the danger in motion: the limit that the trajectory was made for, or else its proven peak.

    None where it cannot be kept from a danger point. InputError if the field's danger points are not those of the
    scene.
    """
    _check_points(field.field, spacing, scene)
    bound = trajectory.max_danger
    if bound is None:
        danger = trajectory.danger(field)
        bound = max(danger.proven_peak, (1 + _LEAST_SLACK) * danger.peak)
    if not np.isfinite(bound):
        return None
    return {"bound": bound, **_kind(field.field, spacing), "k2": field.k2, "gamma": field.gamma}


# ------------------------------------------------------------------------------------------ motions of polynomials


def motion_certificate(
    check: MotionCheck, *, spacing: float | None = None, source: Mapping[str, Any] | None = None
) -> dict[str, Any]:
    """Return the certificate of a motion that is proven, as plain numbers, lists and strings.

    Parameters
    ----------
    check : MotionCheck
        The motion, and what is proven of it: all of that is claimed. It is verified at once.
    spacing : float, optional
        Distance between the danger points of its limit of the danger [m]; default: the scene's own.
    source : mapping, optional
        Where robot and scene come from: kept as it is. They travel inside in any case.

    Raises
    ------
    PlanningError
        If the motion is not proven, or too little is left for the verifier's plain means.
    InputError
        If a limit of it has no claim, as stops beside people, or its danger points are not the scene's.
    """
    if not check:
        more = f", and {len(check.violations) - 1} more" * (len(check.violations) > 1)
        raise PlanningError(f"the motion is not proven, and has no certificate: {check.violations[0]}{more}")
    if check.people is not None:
        raise InputError("stops of such motions have no claim: check it without people", "people")
    proof, separation = check.proof, check.separation
    robot, scene = proof.checker.robot, proof.checker.scene
    clear, speeds = separation.min_clearance, dict(separation.speeds)
    content = {
        **opening(robot, scene, source),
        "path": [],
        "pairs": [list(names) for names in Pairs(robot, scene).names],
        "clearance": None if clear is None else clear.as_dict(),
        "danger": None,
        "moving_obstacles": {"speeds": speeds, "time": separation.time} if speeds else None,
        "also_sampled": None,
        "edges": [],
        **_limits(proof, scene.spacing if spacing is None else spacing),
        "motion": _motion(check.motion)
        | ({} if check.limits is None else {kind: getattr(check.limits, kind) for kind in check.limits.kinds}),
    }
    content |= {"margin": separation.margin} if separation.margin else {}
    content |= {"tube": separation.tube} if separation.tube else {}
    plain: dict[str, Any] = schema.as_plain(content)
    signed = {**plain, "digest": schema.digest(plain)}
    try:
        verify(signed, robot, scene)
    except CertificateError as error:
        raise PlanningError(f"the motion is proven, but cannot be certified by plain means: {error}") from None
    return signed


def _motion(motion: Motion) -> dict[str, Any]:
    said = motion.to_mapping()
    return {key: said[key] for key in ("times", "coefficients", "timed", "slack", "rounding") if key in said}


def _limits(proof: MotionProver, spacing: float) -> dict[str, Any]:
    """Return what is claimed of danger and tool in plain numbers."""
    found: dict[str, Any] = {}
    tool: dict[str, Any] = {}
    for limit in proof.limits:
        if isinstance(limit, DangerLimit) and "danger" not in found:
            _check_points(limit.field, spacing, proof.checker.scene)
            found["danger"] = {"bound": limit.limit, **_kind(limit.field, spacing)}
        elif isinstance(limit, ToolOrientation) and "orientation" not in tool:
            tool["orientation"] = limit.as_dict()
        elif isinstance(limit, TipBounds) and "position" not in tool:
            tool["position"] = limit.as_dict()
        else:
            name = getattr(limit, "name", type(limit).__name__)
            raise InputError(f"no certificate has a claim of {name!r}, or of a second one of its kind", "limits")
    return {**found, **({"tool": tool} if tool else {})}


# ------------------------------------------------------------------------------------------- what is asked for


def terms_of(scenario: Scenario, robot: Robot, *, timed: bool = True) -> Terms:
    """Return what claims about a scenario must agree with: its options of the danger, its limits, its people.

    The robot is its own, or one that takes its place. The limits of its joints need not be known if no motion in time
    is claimed.
    """
    scene, motion, people = scenario.scene, scenario.motion, scenario.people
    danger: dict[str, Any] = {}
    if any(obstacle.weight > 0 for obstacle in scene):
        options = dict(scenario.danger)
        spacing = options.pop("spacing", scene.spacing)
        danger = _kind(DangerField(robot, [[0.0, 0.0, 0.0]], **options), spacing, *_IN_MOTION)
    if not timed:
        return Terms(danger=danger)
    limits = RateLimits.of(robot, motion.velocity, motion.acceleration, motion.jerk)
    return Terms(
        danger=danger,
        motion={
            **{name: getattr(limits, name) for name in ("velocity", "acceleration", "jerk")},
            **{name: getattr(motion, name) for name in ("tool_speed", "link_speed")},
        },
        max_danger=motion.max_danger,
        stops={} if people is None else {"contact": None, **_people(people, scene)},
    )


def terms_of_field(field: DangerField, spacing: float) -> Terms:
    """Return what claims of the danger must agree with: a field, and the distance between danger points [m]."""
    return Terms(danger=_kind(field, spacing, *_IN_MOTION))
