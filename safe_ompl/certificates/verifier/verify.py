"""Verifies certificates, on its own: distances, displacement bounds and dangers are computed once more by plain means.

Nothing here is shared with what issues certificates, plans or proves motions: no broad phase, no margins inside
queries, no displacement radii, no field kernels. From the models come only robot, scene and their kinematics.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass
from math import isclose
from typing import Any, NamedTuple

import numpy as np

from safe_ompl.certificates.claims import Certificate, ClaimedStretch, at_most, malformed_refused
from safe_ompl.certificates.verifier.bodies import Budget, Separations
from safe_ompl.certificates.verifier.motion import RecordedMotion
from safe_ompl.certificates.verifier.polynomials import check_motion
from safe_ompl.certificates.verifier.program import AllowedChanges, RecordedCell
from safe_ompl.certificates.verifier.trajectory import check_trajectory
from safe_ompl.common import CertificateError, InputError, IntArray, documents as document, notebook_html, number
from safe_ompl.io import built_robot, built_scene, schema
from safe_ompl.robot import PackageDir, Robot, robot_hash
from safe_ompl.scene import Scene, Step

# Verification may take so long by default.
TIME = 600.0  # [s]


@dataclass(frozen=True)
class Verified:
    """What was checked of a certificate that holds."""

    # Pieces of the motion, the parts of these that were looked at, and distances of bodies
    edges: int
    intervals: int
    distances: int
    # What holds, in words; the first sentence says so if robot or scene are the file's own
    claims: tuple[str, ...]
    # What a certificate can claim, but this one does not: of "clearance", "danger", "moving obstacles", "tool",
    # "tube", of a motion in time "velocity", "acceleration" and "jerk", and, where it claims a trajectory, its "stops",
    # "jerk", "tool speed", "link speed" and "danger in motion"
    not_claimed: tuple[str, ...]
    # Of what nothing is proven: links without collision geometry, checks that were only sampled
    not_covered: tuple[str, ...]
    robot: str  # Name of the robot
    obstacles: tuple[str, ...]  # Names of the obstacles
    # Which of "robot" and "scene" were taken from the file, and compared with nothing
    own: tuple[str, ...]

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
    terms: AskedTerms | None = None,
    package_dirs: Sequence[PackageDir] = (),
    time: float = TIME,
) -> Verified:
    """Check a certificate: that what it claims holds of every motion in it, and that several are one motion.

    Parameters
    ----------
    content : mapping
        The certificate.
    robot : Robot, optional
        The robot that it must begin with; default: built from what the certificate carries, and then the certificate
        says nothing of any other robot.
    scene : Scene, optional
        The scene that it must begin with; default: the one that it carries.
    terms : AskedTerms, optional
        What its claims must agree with: options of the danger, limits of the motion, people; `terms_of` makes them.
        Without any, claims are checked as they are; their sentences say what they are.
    package_dirs : sequence of path-like
        For a robot that is carried, as in `built_robot`.
    time : float
        [s] What is not verified by then stays undecided, which is a CertificateError that says where.

    Raises
    ------
    CertificateError
        If anything in it does not hold: says what, and where, with the number of the stretch where there are several.
    InputError
        If it is no certificate, its robot cannot be built, or the time is not positive.
    """
    budget = Budget(number("time", time, above=0.0, kind="number of seconds"))
    with malformed_refused():
        claims = Certificate.read(content)
        about = _origin(claims, robot, scene, package_dirs)
        cell, last, counts = RecordedCell(about.robot, about.scene), None, np.zeros(3, dtype=int)
        steps = None if terms is None else terms.steps
        allowed = None if steps is None else AllowedChanges(steps, about.robot)
        for k, stretch in enumerate(claims.stretches):
            with _naming(k, len(claims.stretches)):
                with document.within("motion"):
                    stretch.motion.check_for(about.robot, about.scene)
                last = RecordedMotion(stretch.motion, last)
                last.check_joined()
                cell.change(stretch, last.begin[0])
                if allowed is not None:
                    allowed.check(stretch, cell.held, last.begin[0])
                if terms is not None:
                    terms.check(stretch)
                counts += _proven(stretch, *cell.during(stretch.contacts), last, budget)
        _check_digest(claims.digest, content)
        edges, intervals, distances = counts.tolist()
        sampled = () if claims.also_sampled is None else (claims.also_sampled,)
        return Verified(
            edges,
            intervals,
            distances,
            claims=claims.sentences(about.words),
            not_claimed=claims.not_claimed,
            not_covered=(*_not_covered(about.robot, about.scene), *sampled),
            robot=about.robot.name,
            obstacles=about.scene.names,
            own=about.own,
        )


@contextmanager
def _naming(stretch: int, count: int) -> Iterator[None]:
    """Put the number of a stretch, if there are several, before every error."""
    place = f"stretch {stretch}" if count > 1 else ""
    try:
        with document.within(place, ": ") if place else nullcontext(), malformed_refused():
            yield
    except CertificateError as error:
        raise CertificateError(f"{place}: {error}" if place else str(error)) from None


class Origin(NamedTuple):
    """The robot and the scene that a certificate is about, and which of them the file itself carries."""

    robot: Robot
    scene: Scene
    own: tuple[str, ...]

    @property
    def words(self) -> str:
        """Say so where they are the file's own."""
        return f", for the {' and the '.join(self.own)} that the file itself carries" if self.own else ""


def _origin(
    claims: Certificate, robot: Robot | None, scene: Scene | None, package_dirs: Sequence[PackageDir]
) -> Origin:
    """Return robot and scene, those that the file carries where none are given; what it says of them must agree."""
    with document.within("scene"):
        carried = built_scene(claims.scene)
    own = tuple(name for name, given in (("robot", robot), ("scene", scene)) if given is None)
    if robot is None:
        with document.within("robot"):
            robot = built_robot(claims.robot, package_dirs=package_dirs)
            if robot.name != claims.robot.name:
                words = f"is {claims.robot.name!r}, but what it carries is {robot.name!r}"
                raise InputError(words, "name")
    scene = carried if scene is None else scene
    _check_origin(claims, robot, scene)
    return Origin(robot, scene, own)


def _proven(claims: ClaimedStretch, robot: Robot, scene: Scene, motion: RecordedMotion, budget: Budget) -> IntArray:
    """Return the number of pieces, parts and distances that the proof of all that is claimed of a stretch took."""
    claims.check_for(robot, scene)
    # Numbers that are too large to be compared would satisfy no limit and violate none.
    with np.errstate(over="raise"):
        separations = Separations(robot, scene, claims, budget)
        found = check_motion(claims, robot, scene, separations, motion)
        if claims.trajectory is not None:
            curve = RecordedMotion(claims.trajectory)
            required = check_trajectory(curve, motion, robot, scene, budget)
            found += check_motion(claims, robot, scene, separations, curve, required)
    return found


def _check_digest(said: str, content: Mapping[str, Any]) -> None:
    """Raise CertificateError unless a file is as it was written."""
    if said != schema.digest(content):
        raise CertificateError("every claim holds, but the file is not as it was written: its digest differs")


def _not_covered(robot: Robot, scene: Scene) -> list[str]:
    """Return of what nothing is proven: links without collision geometry, contacts that robot and scene allow."""
    lacking = sorted(robot.links_without_collision)
    held = [(item.touch_links, item.name, item.touch_depth) for item in robot.attached if item.touch_links]
    touched = [(obstacle.touched_by, obstacle.name, None) for obstacle in scene if obstacle.touched_by]
    return [
        *([f"links without collision geometry: {', '.join(lacking)}"] if lacking else []),
        *(
            f"contact of {' and '.join(links)} with {name}"
            + ("" if depth is None else f" no deeper than {at_most(1e3 * depth)} mm")
            for links, name, depth in (*held, *touched)
        ),
        *(
            f"contact of {item.name}, which {item.link} holds from the beginning, with what does not move against it"
            for item in robot.attached
        ),
    ]


def _check_origin(claims: Certificate, robot: Robot, scene: Scene) -> None:
    if claims.joint_names != tuple(robot.joint_names):
        raise CertificateError(f"joint order: it has {list(claims.joint_names)}, the robot {list(robot.joint_names)}")
    if claims.robot.hash != robot_hash(robot):
        raise CertificateError(f"the robot has changed: {robot.name!r} is not the one that it was written for")
    lacking = sorted(robot.links_without_collision)
    if list(claims.robot.links_without_collision) != lacking:
        raise CertificateError(
            f"links without collision geometry: it names {list(claims.robot.links_without_collision)}, "
            f"the robot has {lacking}"
        )
    if claims.scene.hash != scene.content_hash():
        raise CertificateError("the scene has changed since it was written")


# Numbers that are computed from a robot agree if their relative difference is smaller.
_EQUAL_LIMITS = 1e-9
_COMPUTED = ("velocity", "acceleration", "jerk")


@dataclass(frozen=True, kw_only=True)
class AskedTerms:
    """What claims are asked to be about, such as the options of a scenario; None where nothing is asked for."""

    # Options of the field and the spacing of the danger points [m]; empty where nothing in the scene is dangerous
    danger: Mapping[str, Any] | None = None
    # `velocity`, `acceleration` and `jerk` (n,), `tool_speed` and `link_speed`; None where there is no limit
    motion: Mapping[str, Any] | None = None
    # The limit of the danger in motion
    max_danger: float | None = None
    # `who`, `speed`, `speeds`, `reaction_time` and `clearance`, as in `ClaimedStops`; empty where there are no people
    stops: Mapping[str, Any] | None = None
    # The steps of a program, which say what may change hands, and which contacts are allowed
    steps: Sequence[Step] | None = None

    def check(self, claims: ClaimedStretch) -> None:
        """Raise CertificateError, naming what differs, unless everything that is claimed agrees."""
        timed, motion = claims.trajectory, claims.motion
        self._compare("danger", claims.danger, self.danger)
        if self.motion is not None:
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
            if hasattr(claim, name) and not _agree(
                getattr(claim, name), value, _EQUAL_LIMITS if name in _COMPUTED else 0.0
            ):
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
