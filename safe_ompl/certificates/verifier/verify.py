"""Verify certificates independently: recompute distances, motion bounds and dangers by simple methods.

The verifier shares no code with the parts that issue certificates, plan or prove motions: no broad phase, no margins
inside queries, no displacement radii, no field kernels. It only uses the models of robot and scene and their
kinematics.
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

# Default time limit of a verification.
TIME = 600.0  # [s]


@dataclass(frozen=True)
class Verified:
    """The result of a successful verification."""

    # Numbers of pieces of the motion, of their parts that were checked, and of distance queries.
    edges: int
    intervals: int
    distances: int
    # Sentences of the proven claims. The first sentence says so if robot or scene are taken from the file.
    claims: tuple[str, ...]
    # Possible claims that the certificate does not make: "clearance", "danger", "moving obstacles", "tool", "tube"; for
    # a timed motion "velocity", "acceleration" and "jerk"; for a trajectory "stops", "jerk", "tool speed", "link speed"
    # and "danger in motion".
    not_claimed: tuple[str, ...]
    # Parts without any proof: links without collision geometry, and checks that were only sampled.
    not_covered: tuple[str, ...]
    robot: str  # Name of the robot
    obstacles: tuple[str, ...]  # Names of the obstacles
    # "robot" and "scene", if they were taken from the file and not compared with given ones.
    own: tuple[str, ...]

    def __str__(self) -> str:
        """Return the claims, the claims not made, and the parts without proof, one per line."""
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
    """Verify that every claim of a certificate holds, and that its stretches form one motion.

    Parameters
    ----------
    content : mapping
        The certificate.
    robot : Robot, optional
        The robot at the beginning. Default: the robot stored in the certificate. Then the result says nothing about any
        other robot.
    scene : Scene, optional
        The scene at the beginning. Default: the scene stored in the certificate.
    terms : AskedTerms, optional
        Terms that the claims must agree with: danger options, limits of the motion, people; made by `terms_of`. Without
        terms, claims are verified as they are, and their sentences describe them.
    package_dirs : sequence of path-like
        For a robot that is stored in the certificate, as in `built_robot`.
    time : float
        [s] Time limit. A claim that is not verified in time raises a CertificateError that says where.

    Raises
    ------
    CertificateError
        If a claim does not hold. The error says which claim, and where, with the index of the stretch if there are
        several.
    InputError
        If the content is no certificate, its robot cannot be built, or the time is not positive.
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
    """Prefix every error with the index of the stretch, if there are several."""
    place = f"stretch {stretch}" if count > 1 else ""
    try:
        with document.within(place, ": ") if place else nullcontext(), malformed_refused():
            yield
    except CertificateError as error:
        raise CertificateError(f"{place}: {error}" if place else str(error)) from None


class Origin(NamedTuple):
    """The robot and the scene of a certificate, and which of them were taken from the file."""

    robot: Robot
    scene: Scene
    own: tuple[str, ...]

    @property
    def words(self) -> str:
        """Text for robot or scene that are taken from the file; empty if neither is."""
        return f", for the {' and the '.join(self.own)} that the file itself carries" if self.own else ""


def _origin(
    claims: Certificate, robot: Robot | None, scene: Scene | None, package_dirs: Sequence[PackageDir]
) -> Origin:
    """Return robot and scene, by default those stored in the file.

    Raises an error if they differ from the certificate's.
    """
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
    """Prove the claims of a stretch; return the numbers of pieces, parts and distances."""
    claims.check_for(robot, scene)
    # Overflow must be an error, because comparisons with infinity or NaN would satisfy limits falsely.
    with np.errstate(over="raise"):
        separations = Separations(robot, scene, claims, budget)
        found = check_motion(claims, robot, scene, separations, motion)
        if claims.trajectory is not None:
            curve = RecordedMotion(claims.trajectory)
            required = check_trajectory(curve, motion, robot, scene, budget)
            found += check_motion(claims, robot, scene, separations, curve, required)
    return found


def _check_digest(digest: str, content: Mapping[str, Any]) -> None:
    """Raise CertificateError if the digest shows that the file has changed."""
    if digest != schema.digest(content):
        raise CertificateError("every claim holds, but the file is not as it was written: its digest differs")


def _not_covered(robot: Robot, scene: Scene) -> list[str]:
    """Return the parts without proof: links without collision geometry, and contacts that robot and scene allow."""
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


# Numbers that are computed from a robot are equal up to this relative difference.
_EQUAL_LIMITS = 1e-9
_COMPUTED = ("velocity", "acceleration", "jerk")


@dataclass(frozen=True, kw_only=True)
class AskedTerms:
    """Terms that claims must agree with, such as the options of a scenario; None where any value is accepted."""

    # Options of the field and the spacing of the danger points [m]; empty if nothing in the scene is dangerous.
    danger: Mapping[str, Any] | None = None
    # `velocity`, `acceleration` and `jerk` (n,), `tool_speed` and `link_speed`; None where there is no limit.
    motion: Mapping[str, Any] | None = None
    # The limit of the danger in motion.
    max_danger: float | None = None
    # `who`, `speed`, `speeds`, `reaction_time` and `clearance`, as in `ClaimedStops`; empty without people.
    stops: Mapping[str, Any] | None = None
    # The steps of a program, which define the objects that are attached and detached, and the allowed contacts.
    steps: Sequence[Step] | None = None

    def check(self, claims: ClaimedStretch) -> None:
        """Raise CertificateError, naming the difference, unless all claims agree with the terms."""
        timed, motion = claims.trajectory, claims.motion
        self._compare("danger", claims.danger, self.danger)
        if self.motion is not None:
            limits = {name: limit for name, limit in self.motion.items() if getattr(motion, name, None) is not None}
            self._compare("motion", motion if limits else None, limits)
        if timed is None:
            return
        self._compare("danger in motion", timed.danger, self.danger)
        if self.max_danger is not None:
            self._compare("danger in motion", timed.danger, {"bound": self.max_danger})
        if self.motion is not None:
            limits = {name: limit for name, limit in self.motion.items() if getattr(timed, name) is not None}
            self._compare("motion in time", timed, limits)
        self._compare("stops", timed.stops, self.stops)

    @staticmethod
    def _compare(what: str, claim: Any, asked: Mapping[str, Any] | None) -> None:
        if claim is None or asked is None:
            return
        if not asked:
            raise CertificateError(f"{what}: is claimed, but the scenario does not contain it")
        for name, value in asked.items():
            if hasattr(claim, name) and not _agree(
                getattr(claim, name), value, _EQUAL_LIMITS if name in _COMPUTED else 0.0
            ):
                mine, asked_for = (_shown(item) for item in (getattr(claim, name), value))
                raise CertificateError(f"{what}: {name} is {mine} in its claim, {asked_for} is asked for")


def _agree(mine: Any, asked: Any, apart: float) -> bool:
    """Return whether two values are equal, up to a relative difference of numbers."""
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
