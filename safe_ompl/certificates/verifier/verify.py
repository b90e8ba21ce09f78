"""Verifies certificates, on its own: distances, displacement bounds and dangers are computed once more by plain means.

Nothing here is shared with what issues certificates, plans or proves motions: no broad phase, no margins inside
queries, no displacement radii, no field kernels. From the models come only robot, scene and their kinematics.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import isclose
from pathlib import Path
from typing import Any

import numpy as np

from safe_ompl.certificates.claims import Certificate, Interval
from safe_ompl.certificates.verifier.bodies import GJK, Budget, Separations, Stretch, plain_name
from safe_ompl.certificates.verifier.danger import check_danger_and_tool
from safe_ompl.certificates.verifier.polynomials import check_polynomials
from safe_ompl.certificates.verifier.trajectory import check_trajectory
from safe_ompl.common import CertificateError, FloatArray, InputError, formats, notebook_html, positive
from safe_ompl.common import documents as document
from safe_ompl.io import built_robot, built_scene, links_without_collision, schema
from safe_ompl.robot import Robot, robot_hash
from safe_ompl.scene import Scene

_FARTHEST = 1e4  # [rad] a joint that turns on and on farther than this has no exact angle any more
TIME = 600.0  # [s] that verification may take by default
_GAP = 1e-9  # of an edge: intervals that are nearer to each other leave nothing out


@dataclass(frozen=True)
class Verified:
    """What was checked of a certificate that holds."""

    # How many of each; of a motion of polynomials its pieces, and the parts of these that were looked at
    edges: int
    intervals: int
    distances: int
    # What holds, in words; the first sentence says so if robot or scene are the file's own
    claims: tuple[str, ...]
    # What a certificate can claim, but this one does not: of "clearance", "danger", "moving obstacles", "tool"
    # and, where it claims a trajectory, its "stops", "jerk", "tool speed", "link speed" and "danger in motion";
    # where it claims polynomials, "tube", and of those in time "velocity", "acceleration" and "jerk"
    not_claimed: tuple[str, ...]
    # Of what nothing is proven: links without collision geometry, checks that were only sampled
    not_covered: tuple[str, ...]
    robot: str  # Name of the robot
    obstacles: tuple[str, ...]  # Names of the obstacles
    own: tuple[str, ...]  # Which of "robot" and "scene" were taken from the file, and compared with nothing

    def __str__(self) -> str:
        """Say what holds, what is not claimed, and of what nothing is proven, in a line each."""
        lacks = {"not claimed": self.not_claimed, "not covered": self.not_covered}
        return "\n".join([*self.claims, *(f"{key}: {', '.join(of)}" for key, of in lacks.items() if of)])

    _repr_html_ = notebook_html


def verify(
    content: Mapping[str, Any],
    robot: Robot | None = None,
    scene: Scene | None = None,
    *,
    terms: Terms | None = None,
    urdf: Path | None = None,
    package_dirs: Sequence[Path] = (),
    time: float = TIME,
) -> Verified:
    """Check a certificate: that intervals cover the path, and that what it claims holds in each of them.

    Parameters
    ----------
    content : mapping
        The certificate.
    robot : Robot, optional
        The robot that it must be about; default: built from what the certificate carries, and then the certificate says
        nothing of any other robot.
    scene : Scene, optional
        The scene that it must be about; default: the one that it carries.
    terms : Terms, optional
        What its claims must agree with: options of the danger, limits of the motion, people. `terms_of` and
        `terms_of_field` make them. Without any, claims are checked as they are; their sentences say what they are.
    urdf, package_dirs
        For a robot that is carried, as in `built_robot`.
    time : float
        [s] What is not verified by then stays undecided, which is a CertificateError that says where.

    Raises
    ------
    CertificateError
        If anything in it does not hold: names the first edge and interval.
    InputError
        If it is no certificate, its robot cannot be built, or the time is not positive.
    """
    budget = Budget(positive(time, "time", "number of seconds"))
    try:
        claims = Certificate.read(content)
        with document.within("scene"):
            carried = built_scene(claims.scene)
        own = tuple(name for name, given in (("robot", robot), ("scene", scene)) if given is None)
        if robot is None:
            with document.within("robot"):
                robot = built_robot(claims.robot, urdf=urdf, package_dirs=package_dirs)
                if robot.name != claims.robot.name:
                    words = f"is {claims.robot.name!r}, but what it carries is {robot.name!r}"
                    raise InputError(words, "name")
        scene = carried if scene is None else scene
        _check_origin(claims, robot, scene)
        if terms is not None:
            terms.check(claims)
        with np.errstate(over="raise"):  # what is too large to be compared holds nowhere
            found = _verified(claims, robot, scene, own, budget)
        if claims.digest != schema.digest(content):
            raise CertificateError("every interval holds, but the file is not as it was written: its digest differs")
        return found
    except formats.MALFORMED as error:
        if isinstance(error, InputError):
            raise
        raise CertificateError(f"it is malformed: {type(error).__name__}: {error}") from None


def _verified(claims: Certificate, robot: Robot, scene: Scene, own: tuple[str, ...], budget: Budget) -> Verified:
    path = claims.path
    if claims.motion is None:
        _check_limits(robot, path)
    claims.check_for(robot, scene)
    ends = path[1:] if len(path) > 1 else path
    if len(claims.edges) != len(ends):
        raise CertificateError(f"the path has {len(ends)} edges, the certificate {len(claims.edges)}")
    separations = Separations(robot, scene, claims, budget)
    if sorted(claims.pairs) != sorted(separations.names):
        raise CertificateError("its pairs of bodies are not those of robot and scene")
    intervals, distances = 0, 0
    for k, (edge, start, end) in enumerate(zip(claims.edges, path, ends, strict=False)):
        _check_cover(k, edge)
        budget.where = f"edge {k}"
        delta = robot.difference(start, end)
        for j, interval in enumerate(edge):
            _check_interval(f"edge {k}, interval {j}", interval, start, delta, separations, claims)
            intervals, distances = intervals + 1, distances + len(separations.names)
    if claims.motion is None:
        edges = (
            _stretch(f"edge {k}", start, robot.difference(start, end), claims.tube)
            for k, (start, end) in enumerate(zip(path, ends, strict=False))
        )
        check_danger_and_tool(claims, robot, scene, edges, budget)
        check_trajectory(claims, robot, scene, separations)
    else:
        intervals, distances = check_polynomials(claims, claims.motion, robot, scene, separations)
    lacking = links_without_collision(robot)
    about = f", for the {' and the '.join(own)} that the file itself carries" if own else ""
    not_covered = [f"links without collision geometry: {', '.join(lacking)}"] if lacking else []
    not_covered += [] if claims.also_sampled is None else [claims.also_sampled]
    return Verified(
        edges=len(ends) if claims.motion is None else len(claims.motion.coefficients),
        intervals=intervals,
        distances=distances,
        claims=claims.sentences(about),
        not_claimed=claims.not_claimed,
        not_covered=tuple(not_covered),
        robot=robot.name,
        obstacles=scene.names,
        own=own,
    )


def _stretch(name: str, start: FloatArray, delta: FloatArray, tube: FloatArray | None) -> Stretch:
    return Stretch(name, lambda t: start + t * delta, np.abs(delta), 0.0 if tube is None else tube)


def _check_origin(claims: Certificate, robot: Robot, scene: Scene) -> None:
    if claims.joint_names != tuple(robot.joint_names):
        raise CertificateError(f"joint order: it has {list(claims.joint_names)}, the robot {list(robot.joint_names)}")
    if claims.robot.hash != robot_hash(robot):
        raise CertificateError(f"the robot has changed: {robot.name!r} is not the one that it was written for")
    lacking = links_without_collision(robot)
    if list(claims.robot.links_without_collision) != lacking:
        raise CertificateError(
            f"links without collision geometry: it names {list(claims.robot.links_without_collision)}, "
            f"the robot has {lacking}"
        )
    if claims.scene.hash != scene.content_hash():
        raise CertificateError("the scene has changed since it was written")


def _check_limits(robot: Robot, path: FloatArray) -> None:
    if not len(path):
        raise CertificateError("the path is empty")
    if path.shape[1] != robot.n:
        raise CertificateError(f"the path has {path.shape[1]} joints, the robot {robot.n}")
    for k, q in enumerate(path):
        for i in range(robot.n):
            place = f"way point {k}: joint {robot.joint_names[i]!r} = {q[i]:g}"
            if robot.continuous[i] and abs(q[i]) > _FARTHEST:
                raise CertificateError(f"{place} is more than {_FARTHEST:g} rad")
            if not robot.continuous[i] and not robot.lower[i] - 1e-9 <= q[i] <= robot.upper[i] + 1e-9:
                raise CertificateError(f"{place} is outside its limits")


def _check_cover(edge: int, intervals: tuple[Interval, ...]) -> None:
    """Raise CertificateError unless the intervals, put in order, leave nothing of [0, 1] out."""
    reached = 0.0
    for interval in sorted(intervals, key=lambda i: i.centre - i.half_length):
        first = interval.centre - interval.half_length
        if first > reached + _GAP:
            raise CertificateError(f"edge {edge}: no interval covers {reached:.6f} to {first:.6f} of it")
        reached = max(reached, interval.centre + interval.half_length)
    if reached < 1.0 - _GAP:
        raise CertificateError(f"edge {edge}: no interval covers {reached:.6f} to 1 of it")


def _check_interval(
    name: str, interval: Interval, start: FloatArray, delta: FloatArray, separations: Separations, claims: Certificate
) -> None:
    pairs, tube = claims.pairs, 0.0 if claims.tube is None else claims.tube
    centre, half = interval.centre, interval.half_length
    name = f"{name} (centre {centre:.6f}, half-length {half:.6f})"
    if len(interval.margins) != len(pairs):
        raise CertificateError(f"{name}: {len(interval.margins)} margins for {len(pairs)} pairs")
    margins = dict(zip(pairs, interval.margins.tolist(), strict=True))
    for pair, distance, approach, required in separations.examined(start + centre * delta, half * np.abs(delta) + tube):
        if not margins[pair] >= approach + required:
            raise CertificateError(
                f"{name}: the margin of {_between(pair)} is {1e3 * margins[pair]:.3f} mm, "
                f"{1e3 * (approach + required):.3f} mm are needed"
            )
        if not distance - GJK > margins[pair]:
            raise CertificateError(
                f"{name}: {_between(pair)} are {1e3 * distance:.3f} mm apart, {1e3 * margins[pair]:.3f} mm are claimed"
            )


def _between(pair: tuple[str, str]) -> str:
    return f"{plain_name(pair[0])!r} and {plain_name(pair[1])!r}"


_SAME = 1e-9  # relative: numbers that are computed from a robot, and differ by less, agree
_COMPUTED = ("velocity", "acceleration", "jerk")


@dataclass(frozen=True, kw_only=True)
class Terms:
    """What claims are asked to be about, such as the options of a scenario; None where nothing is asked for."""

    # Options of the field and the spacing of the danger points [m]; empty where nothing in the scene is dangerous
    danger: Mapping[str, Any] | None = None
    # `velocity`, `acceleration` and `jerk` (n,), `tool_speed` and `link_speed`; None where there is no limit
    motion: Mapping[str, Any] | None = None
    max_danger: float | None = None  # The limit of the danger in motion
    # `who`, `speed`, `speeds`, `reaction_time` and `clearance`, as in `Stops`; empty where there are no people
    stops: Mapping[str, Any] | None = None

    def check(self, claims: Certificate) -> None:
        """Raise CertificateError, naming what differs, unless everything that is claimed agrees."""
        timed, motion = claims.trajectory, claims.motion
        self._compare("danger", claims.danger, self.danger)
        if motion is not None and self.motion is not None:
            said = {name: limit for name, limit in self.motion.items() if getattr(motion, name, None) is not None}
            self._compare("motion", motion if said else None, said)
        if timed is None:
            return
        self._compare("danger in motion", timed.danger, self.danger)
        if self.max_danger is not None:
            self._compare("danger in motion", timed.danger, {"bound": self.max_danger})
        if self.motion is not None:
            said = {name: limit for name, limit in self.motion.items() if getattr(timed, name) is not None}
            self._compare("motion in time", timed, said)
        self._compare("stops", timed.stops, self.stops)

    @staticmethod
    def _compare(what: str, claim: Any, asked: Mapping[str, Any] | None) -> None:
        if claim is None or asked is None:
            return
        if not asked:
            raise CertificateError(f"{what}: it is claimed, but there is nothing in the scenario that it is about")
        for name, value in asked.items():
            if hasattr(claim, name) and not _agree(getattr(claim, name), value, _SAME if name in _COMPUTED else 0.0):
                mine, asked_for = (_shown(item) for item in (getattr(claim, name), value))
                raise CertificateError(f"{what}: {name} is {mine} in its claim, {asked_for} is asked for")


def _agree(mine: Any, asked: Any, apart: float) -> bool:
    """Return whether two values are the same, numbers but for a relative difference."""
    mine, asked = _listed(mine), _listed(asked)
    if isinstance(mine, Mapping) and isinstance(asked, Mapping):
        return mine.keys() == asked.keys() and all(_agree(mine[part], asked[part], apart) for part in mine)
    if isinstance(mine, list) and isinstance(asked, list):
        return len(mine) == len(asked) and all(_agree(x, y, apart) for x, y in zip(mine, asked, strict=True))
    if isinstance(mine, float) and isinstance(asked, (int, float)):
        return isclose(mine, asked, rel_tol=apart)
    return bool(mine == asked)


def _listed(value: Any) -> Any:
    return list(value) if isinstance(value, (tuple, np.ndarray)) else value


def _shown(value: Any) -> str:
    return repr([float(x) for x in value] if isinstance(value, np.ndarray) else value)
