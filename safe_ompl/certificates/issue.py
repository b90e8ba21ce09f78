"""Issue certificates: motions with claims that anyone can verify (`verify`).

A certificate consists of stretches; a single motion is one stretch. Each stretch has a motion of polynomials (a path
has straight pieces), the claims about it, and the objects that are attached or detached before it. The verifier divides
the pieces until the claims are proven. Each certificate is verified before it is returned. The digest shows whether a
file has changed. It is not a signature, because anyone who changes a file can recompute it.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from safe_ompl.certificates.claims import Certificate, ClaimedClearance, ClaimedObstacles, ClaimedStretch, ClaimedTool
from safe_ompl.certificates.verifier.program import RecordedCell
from safe_ompl.certificates.verifier.verify import AskedTerms, verify
from safe_ompl.collision import (
    CollisionChecker,
    MinClearance,
    MotionProver,
    Separation,
    TipBounds,
    ToolOrientation,
    Verdict,
)
from safe_ompl.common import (
    CertificateError,
    FloatArray,
    InputError,
    PlanningError,
    documents as document,
    finite_array,
    key,
    within,
)
from safe_ompl.danger import CertifiedDanger, DangerField, DangerLimit, KinetostaticField
from safe_ompl.io import embedded_robot, embedded_scene, schema
from safe_ompl.motions import Motion, MotionCheck, RateLimits, SmoothLaw, Trajectory
from safe_ompl.robot import Robot
from safe_ompl.scene import People, Scenario, Scene

# A bound of the danger within a tube is increased by this factor until it is proven, at most `_MOST_BOUNDS` times.
_BOUND_FACTOR, _MOST_BOUNDS = 1.1, 50
# Options that define the kind of danger.
_KIND = ("aggregate", "weighting", "k1", "sharpness")
# Further options of the danger of a timed motion.
_IN_MOTION = ("k2", "gamma")
# Relative margin of the claimed danger above the danger found, so that the verifier's simpler bounds can confirm it.
_LEAST_SLACK = 0.03
_OF_STRETCH = ("clearance", "moving_obstacles", "tool", "tube")  # of `Claims`
_OF_CURVE = ("times", "coefficients", "timed")
_OF_MOTION = (*_OF_CURVE, "slack", "rounding")
# Stretches are consecutive if their times differ by at most the rounding of sums of durations.
_SAME_TIME = 1e-6  # [s]
# Objects are at the same pose if they differ by at most the rounding of forward kinematics. The certificate stores the
# poses that the verifier computes.
_SAME_PLACE = 1e-6  # [m and rad]


def _widths(key: str, value: Any) -> FloatArray | None:
    widths = document.array(key, value)
    return widths if widths.any() else None


@dataclass(frozen=True, kw_only=True)
class Claims(document.Section):
    """Claims of a path's certificate, besides that the path is free.

    Parameters
    ----------
    clearance : mapping, optional
        Links keep a `distance` [m] from the `obstacles` named.
    moving_obstacles : mapping, optional
        The path stays free, and keeps its clearance, while obstacles move no faster than their `speeds` (by name
        [m/s]), until a `time` [s] after the instant of the scene: see `Separation`.
    tool : mapping, optional
        Limits of the tool: an `orientation` with `axis` (of the tip), `direction` (in the world) and `angle` [rad], a
        `position` with bounds of `x`, `y` and `z` [m]; either or both.
    tube : array_like, shape (n,), optional
        The claims hold for every motion whose joint values are within these widths of the path [rad or m]. A trajectory
        cannot have a tube.
    spacing : float, optional
        Distance between the danger points [m]. Default: the scene's own.
    max_danger : float, optional
        A bound of the danger to claim, if it can be proven and is lower than the bound that is claimed otherwise.
    also_sampled : str, optional
        A requirement that the path was planned to keep without proof, such as "your checker, sampled at 0.01 rad". The
        verification reports that the requirement is not covered.
    """

    clearance: ClaimedClearance | None = key(document.section, default=None, kind=ClaimedClearance)
    moving_obstacles: ClaimedObstacles | None = key(document.section, default=None, kind=ClaimedObstacles)
    tool: ClaimedTool | None = key(document.section, default=None, kind=ClaimedTool)
    tube: FloatArray | None = key(_widths, default=None)
    spacing: float | None = key(document.number, default=None, above=0.0)
    max_danger: float | None = key(document.number, default=None, above=0.0)
    also_sampled: str | None = key(document.line, default=None)


def certificate(
    path: ArrayLike,
    robot: Robot,
    scene: Scene,
    claims: Claims | Mapping[str, Any] | None = None,
    *,
    field: DangerField | None = None,
    trajectory: Trajectory | None = None,
    source: Mapping[str, Any] | None = None,
) -> dict[str, Any]:
    """Return the certificate of a path, as plain numbers, lists and strings.

    Parameters
    ----------
    path : array_like, shape (N, n)
        Way points [rad or m], joined by straight lines in joint space; see `Robot.way_points`.
    robot, scene : Robot, Scene
        The robot, and the obstacles.
    claims : Claims or mapping, optional
        Claims besides that the path is free: `clearance`, `moving_obstacles`, `tool`, `tube`, `max_danger` and others,
        see `safe_ompl.certificates.Claims`.
    field : DangerField, optional
        Also claim a bound of the path's danger in this field, if there is a finite bound.
    trajectory : Trajectory, optional
        Also claim the timed path: its duration, limits of joint velocities and accelerations, that the curve is free,
        and its stops for people. Its claimed danger in motion is the limit that it was made for or, with a `field`, its
        proven peak.
    source : mapping, optional
        Origin of robot and scene, stored unchanged. Robot and scene are always stored in the certificate.

    Raises
    ------
    InputError
        If the path has the wrong shape or is not finite, a claim has no meaning, or a file of robot or scene is
        missing.
    PlanningError
        If an edge cannot be proven.
    """
    points = robot.way_points(path)
    if not len(points):
        raise InputError("path must have at least one configuration, got none")
    wanted: Claims = document.section("claims", claims, Claims)
    motion = Motion.through(points).for_robot(robot)
    spacing = wanted.spacing or scene.spacing
    claimed = {name: value for name, value in wanted.to_mapping().items() if name in _OF_STRETCH}
    if field is not None:
        proof = None
        if wanted.tube is not None:
            tube = Separation(tube=tuple(finite_array(wanted.tube, (robot.n,), "tube").tolist()))
            proof = MotionProver(CollisionChecker(robot, scene), separation=tube)
        claimed["danger"] = _danger_claim(field, spacing, motion.knots, wanted.max_danger, proof)
    whole = {"also_sampled": wanted.also_sampled}
    found = _issued([_stretch(claimed, motion)], robot, scene, source, **whole)
    if trajectory is None:
        return found
    timed = trajectory_claim(trajectory, scene)
    moving_field = trajectory.danger_field or (None if field is None else KinetostaticField(field))
    if moving_field is not None:
        danger = moving_danger_claim(trajectory, moving_field, spacing, scene)
        timed |= {} if danger is None else {"danger": danger}
    found = signed({**found, "stretches": [{**found["stretches"][0], "trajectory": timed}]})
    Certificate.read(found).stretches[0].check_for(robot, scene)
    return found


def _issued(
    stretches: Sequence[Mapping[str, Any]], robot: Robot, scene: Scene, source: Mapping[str, Any] | None, **more: Any
) -> dict[str, Any]:
    """Return the certificate of stretches. Raises PlanningError unless the verifier proves their claims."""
    content = {
        "format": schema.FORMAT,
        "version": schema.VERSION,
        "source": source or {},
        "robot": embedded_robot(robot),
        "scene": embedded_scene(scene),
        "joint_names": list(robot.joint_names),
        "stretches": stretches,
        **more,
    }
    found = signed(content)
    try:
        verify(found, robot, scene)
    except CertificateError as error:
        what = (
            "the stretches are proven, but cannot be certified as one program"
            if len(stretches) > 1
            else "it cannot be certified by plain means"
        )
        raise PlanningError(f"{what}: {error}") from None
    return found


def _stretch(claims: Mapping[str, Any], motion: Motion) -> dict[str, Any]:
    """Return the claims about a motion, together with the motion."""
    given = motion.to_mapping()
    return {**claims, "motion": {key: given[key] for key in _OF_MOTION if key in given} | claims.get("motion", {})}


def signed(content: Mapping[str, Any]) -> dict[str, Any]:
    """Return a certificate with its digest added."""
    plain: dict[str, Any] = schema.as_plain(content)
    return {**plain, "digest": schema.digest(plain)}


def _keeps(limit: DangerLimit, path: FloatArray, proof: MotionProver | None) -> Iterator[bool]:
    """Yield for each edge whether a danger limit is proven. With a tube, `proof` contains the tube."""
    prover = limit if proof is None else replace(proof, limits=[limit])
    return (prover.check(start, end).verdict is Verdict.FREE for start, end in pairwise(path))


def _danger_claim(
    field: DangerField, spacing: float, path: FloatArray, limit: float | None, proof: MotionProver | None
) -> dict[str, Any] | None:
    bounds = CertifiedDanger(field).of_path(path)
    bound = max(bounds.upper, (1 + _LEAST_SLACK) * bounds.lower)
    if proof is not None and np.isfinite(bound):
        tried = (bound * _BOUND_FACTOR**k for k in range(_MOST_BOUNDS))
        kept = (b for b in tried if all(_keeps(DangerLimit(field, b), path, proof)))
        # The increase of the danger by the tube is unknown, so growing bounds are tried.
        bound = next(kept, np.inf)
    if limit and limit < bound:
        bound = limit if all(_keeps(DangerLimit(field, limit), path, proof)) else bound
    if not np.isfinite(bound):
        return None
    return {"bound": bound, **_kind(field, spacing)}


def _check_points(field: DangerField, spacing: float, scene: Scene) -> None:
    """Raise InputError if the field's danger points differ from the scene's, which the verifier uses."""
    if not np.array_equal(field.points, scene.danger_points(spacing)[0]):
        raise InputError(f"the danger points of the field are not those of the scene, {spacing:g} m apart", "spacing")


def _kind(field: DangerField, spacing: float, *more: str) -> dict[str, Any]:
    return {"spacing": spacing, **{name: getattr(field, name) for name in (*_KIND, *more)}}


def trajectory_claim(trajectory: Trajectory, scene: Scene) -> dict[str, Any]:
    """Return the claim of a trajectory in plain numbers, without its danger (see `moving_danger_claim`)."""
    curve, law, jerk = trajectory.curve, trajectory.law, trajectory.limits.jerk
    more: dict[str, Any] = {"tool_speed": trajectory.tool_speed, "link_speed": trajectory.link_speed}
    if isinstance(law, SmoothLaw) and jerk is not None:
        more |= {"window": law.window, "jerk": jerk.tolist()}
    stops = None
    if trajectory.people is not None and trajectory.brakes is not None:
        stops = {**_people(trajectory.people, scene), "brakes": trajectory.brakes.tolist()}
    return {
        **{key: value for key, value in curve.to_mapping().items() if key in _OF_CURVE},
        "corners": list(curve.corners),
        "edges": law.edges.tolist(),
        "squares": (law.plan_squared_speeds if isinstance(law, SmoothLaw) else law.squared_speeds).tolist(),
        "duration": law.duration,
        "velocity": trajectory.limits.velocity.tolist(),
        "acceleration": trajectory.limits.acceleration.tolist(),
        "stops": stops,
        **{key: value for key, value in more.items() if value is not None},
    }


def _people(people: People, scene: Scene) -> dict[str, Any]:
    """Return the claim about stops for people. Of the limb speeds, only those of existing limbs are included."""
    if people.contact:
        raise InputError(
            "a certificate states that the robot stops, not how it touches: leave it out", "people.contact"
        )
    limbs = {part[len(name) + 1 :] for name in people.names(scene) for part, _, _ in scene[name].geometries()}
    return {
        "who": list(people.names(scene)),
        "speed": people.speed,
        "speeds": {limb: speed for limb, speed in people.speeds.items() if limb in limbs},
        "reaction_time": people.reaction_time,
        "clearance": people.clearance,
    }


def moving_danger_claim(
    trajectory: Trajectory, field: KinetostaticField, spacing: float, scene: Scene
) -> dict[str, Any] | None:
    """Return the claim of the danger in motion: its limit, or proven peak; None if a danger point may be reached."""
    _check_points(field.field, spacing, scene)
    bound = trajectory.max_danger
    if bound is None:
        danger = trajectory.danger(field)
        bound = max(danger.proven_peak, (1 + _LEAST_SLACK) * danger.peak)
    if not np.isfinite(bound):
        return None
    return {"bound": bound, **_kind(field.field, spacing), "k2": field.k2, "gamma": field.gamma}


def motion_certificate(
    check: MotionCheck, *, spacing: float | None = None, source: Mapping[str, Any] | None = None
) -> dict[str, Any]:
    """Return the certificate of a proven motion, as plain numbers, lists and strings.

    Parameters
    ----------
    check : MotionCheck
        The motion and its proven claims, which are all claimed. The certificate is verified at once.
    spacing : float, optional
        Distance between the danger points of the danger limit [m]. Default: the scene's own.
    source : mapping, optional
        Origin of robot and scene, stored unchanged. Robot and scene are always stored in the certificate.

    Raises
    ------
    PlanningError
        If the motion is not proven, or its margins are too small for the verifier's simpler methods.
    InputError
        If a limit of the check cannot be claimed, such as stops for people, or its danger points are not the scene's.
    """
    claims = _claims_of(check, spacing)
    return _issued([_stretch(claims, check.motion)], check.proof.checker.robot, check.proof.checker.scene, source)


def _claims_of(check: MotionCheck, spacing: float | None = None) -> dict[str, Any]:
    """Return the claims about a proven motion; errors as `motion_certificate`."""
    if not check:
        more = f", and {len(check.violations) - 1} more" * (len(check.violations) > 1)
        raise PlanningError(f"the motion is not proven, and has no certificate: {check.violations[0]}{more}")
    if check.people is not None:
        raise InputError("stops of such motions have no claim: check it without people", "people")
    proof, separation = check.proof, check.separation
    scene = proof.checker.scene
    speeds, limits = dict(separation.speeds), check.limits
    return {
        "clearance": clearance_claim(separation.min_clearance, scene),
        "moving_obstacles": {"speeds": speeds, "time": separation.time} if speeds else None,
        **_limits(proof, scene.spacing if spacing is None else spacing),
        "margin": separation.margin or None,
        "tube": separation.tube or None,
        "motion": {} if limits is None else {kind: getattr(limits, kind) for kind in limits.kinds},
    }


def clearance_claim(clear: MinClearance | None, scene: Scene) -> dict[str, Any] | None:
    """Return the claim of a clearance. Obstacles that some links may touch or approach are not claimed."""
    exempt = set() if clear is None else {obstacle for _, obstacle in clear.exempt}
    exempt |= {obstacle.name for obstacle in scene if obstacle.touched_by}
    kept = [] if clear is None else [name for name in clear.obstacles if name not in exempt]
    return {"distance": clear.distance, "obstacles": kept} if clear is not None and kept else None


def _limits(proof: MotionProver, spacing: float) -> dict[str, Any]:
    """Return the claims about danger and tool in plain numbers."""
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
            raise InputError(f"certificates cannot state {name!r}, or a second limit of its kind", "limits")
    return {**found, **({"tool": tool} if tool else {})}


def program_certificate(
    stretches: Iterable[tuple[float, MotionCheck]],
    source: Mapping[str, Any] | None = None,
    steps: Sequence[str] | None = None,
    *,
    begin: tuple[Robot, Scene] | None = None,
) -> dict[str, Any]:
    """Return the verified certificate of a program, as plain numbers, lists and strings.

    Parameters
    ----------
    stretches : iterable of (float, MotionCheck)
        Start time [s] and check of each stretch, as in `ProgramResult.stretches`.
    source : mapping, optional
        Origin of robot and scene, stored unchanged.
    steps : sequence of str, optional
        Description of each stretch, stored unchanged.
    begin : (Robot, Scene), optional
        The robot and the scene at the beginning of the program. Default: those of the first stretch.

    Raises
    ------
    PlanningError
        If a stretch is not proven, or the stretches are not consecutive.
    InputError
        As `motion_certificate`.
    """
    parts = list(stretches)
    if not parts:
        raise InputError("must contain at least one stretch", "stretches")
    first = parts[0][1].proof.checker
    robot, scene = begin or (first.robot, first.scene.untouched()[0])
    cell, claimed, end = RecordedCell(robot, scene), list[dict[str, Any]](), float(parts[0][0])
    for k, (start, check) in enumerate(parts):
        with within(f"stretch {k}", ": "):
            if abs(start - end) > _SAME_TIME and check.motion.timed:
                words = f"stretch {k} begins at {start:.6f} s, but the one before ends at {end:.6f} s"
                raise PlanningError(f"each stretch is proven, but they are not one program: {words}")
            end = start + check.motion.duration
            claims = {**_claims_of(check), **({"step": steps[k]} if steps else {}), **_changes(cell, check)}
            claimed.append(_stretch(claims, check.motion))
            stretch: ClaimedStretch = document.section("claims", schema.as_plain(claimed[-1]), ClaimedStretch)
            cell.change(stretch, check.motion.knots[0])
            _check_same(*cell.during(stretch.contacts), check, k)
    return _issued(claimed, robot, scene, source)


def _changes(cell: RecordedCell, check: MotionCheck) -> dict[str, Any]:
    """Return the objects attached or detached before a stretch, and the contacts allowed during it."""
    robot, (_, touched) = check.proof.checker.robot, check.proof.checker.scene.untouched()
    held = {item.name: item for item in robot.spec.attached}
    contacts = [{"links": links, "object": name, "depth": depth} for name, (links, depth) in touched.items()]
    for name, item in held.items():
        before = cell.held.get(name)
        own = () if before is None or before.link != item.link else before.touch_links
        touching = [link for link in item.touch_links if link not in own]
        if touching and item.touch_depth is not None:
            contacts.append({"links": touching, "object": name, "depth": item.touch_depth})
        elif touching:
            raise InputError(f"{' and '.join(touching)} may touch it to any depth: give it `touch_depth`", name)
    links = {name: item.link for name, item in cell.held.items()}
    taken = {name: item.link for name, item in held.items() if links.get(name) != item.link}
    put = [name for name in links if name not in held or name in taken]
    changes = {"detach": put, "attach": taken, "contacts": contacts}
    return {name: value for name, value in changes.items() if value}


def _check_same(robot: Robot, scene: Scene, check: MotionCheck, number: int) -> None:
    """Raise PlanningError unless a stretch was proven for the robot and the scene of the program at that point."""
    own, its = robot.spec, check.proof.checker.robot.spec
    why = "" if replace(own, attached=()) == replace(its, attached=()) else "its robot is another one"
    mine = {item.name: item for item in (*scene, *own.attached)}
    others = {item.name: item for item in (*check.proof.checker.scene, *its.attached)}
    for name in {*mine} ^ {*others}:
        why = why or f"{name!r} is in the scene of one of this stretch and the one before, but not of the other"
    for name, item in mine.items():
        other = others.get(name, item)
        if item.shape.kind != other.shape.kind or item.shape.canonical() != other.shape.canonical():
            why = why or f"{name!r} is another shape than in the stretch before"
        away = np.abs(pin.log6(item.pose.se3.inverse() * other.pose.se3).vector).max()
        if away > _SAME_PLACE:
            why = why or f"{name!r} is {1e3 * away:.3g} mm or mrad from where it was"
        if getattr(item, "weight", None) != getattr(other, "weight", None):
            why = why or f"{name!r} is not as dangerous as in the stretch before"
    if why:
        raise PlanningError(f"each stretch is proven, but they are not one program: stretch {number}: {why}")


def terms_of(scenario: Scenario, robot: Robot, *, timed: bool = True) -> AskedTerms:
    """Return the terms that claims about a scenario must agree with: its danger options, its limits, its people.

    `robot` is the scenario's robot, or its replacement. With `timed=False` the joint limits are not needed, for claims
    without timed motions.
    """
    scene, motion, people = scenario.scene, scenario.motion, scenario.people
    steps = () if scenario.program is None else scenario.program.steps
    danger: dict[str, Any] = {}
    if any(obstacle.weight > 0 for obstacle in scene):
        options = dict(scenario.danger)
        spacing = options.pop("spacing", scene.spacing)
        danger = _kind(DangerField(robot, [[0.0, 0.0, 0.0]], **options), spacing, *_IN_MOTION)
    if not timed:
        return AskedTerms(danger=danger, steps=steps)
    limits = RateLimits.of(robot, motion.velocity, motion.acceleration, motion.jerk)
    return AskedTerms(
        danger=danger,
        motion={
            **{name: getattr(limits, name) for name in ("velocity", "acceleration", "jerk")},
            **{name: getattr(motion, name) for name in ("tool_speed", "link_speed")},
        },
        max_danger=motion.max_danger,
        stops={} if people is None else _people(people, scene),
        steps=steps,
    )
