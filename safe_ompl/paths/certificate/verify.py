"""Verifies certificates, on its own: distances, displacement bounds and dangers are computed once more by plain means.

Nothing here is shared with what issues certificates, plans or proves motions: no broad phase, no margins inside
queries, no displacement radii, no field kernels. From the models come only robot, scene and their kinematics.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from safe_ompl import document
from safe_ompl.arrays import FloatArray, finite_array
from safe_ompl.errors import CertificateError, InputError
from safe_ompl.paths.certificate.claims import check_claims, claimed, not_claimed, not_covered
from safe_ompl.paths.certificate.danger_claims import check_kind
from safe_ompl.paths.certificate.format import check_form, digest
from safe_ompl.paths.certificate.plain_danger import PlainDanger
from safe_ompl.paths.certificate.plain_distances import Separations, plain_name
from safe_ompl.paths.certificate.plain_tool import PlainTool
from safe_ompl.paths.certificate.plain_trajectory import check_trajectory
from safe_ompl.paths.certificate.portable import built_robot, built_scene, links_without_collision
from safe_ompl.robot.fingerprint import robot_hash
from safe_ompl.robot.robot import Robot
from safe_ompl.scene.scene import Scene

if TYPE_CHECKING:
    from safe_ompl.danger.field import DangerField

_GJK = 1e-5  # [m] coal's distances are at most this far off
_FARTHEST = 1e4  # [rad] a joint that turns on and on farther than this has no exact angle any more
_GAP = 1e-9  # of an edge: intervals that are nearer to each other leave nothing out
_INTERVAL = ("centre", "half_length", "margins")


@dataclass(frozen=True)
class Verified:
    """What was checked of a certificate that holds.

    Attributes
    ----------
    edges, intervals, distances : int
        How many of each.
    claims : tuple of str
        What holds, in words.
    not_claimed : tuple of str
        What a certificate can claim, but this one does not: of "clearance", "danger", "moving obstacles", "tool"
        and, where it claims a trajectory, its "stops", "jerk", "tool speed", "link speed" and "danger in motion".
    not_covered : tuple of str
        Of what nothing is proven: links without collision geometry, checks that were only sampled.
    """

    edges: int
    intervals: int
    distances: int
    claims: tuple[str, ...]
    not_claimed: tuple[str, ...]
    not_covered: tuple[str, ...]


def verify(
    content: Mapping[str, Any],
    robot: Robot | None = None,
    scene: Scene | None = None,
    *,
    field: DangerField | None = None,
    spacing: float | None = None,
) -> Verified:
    """Check a certificate: that intervals cover the path, and that what it claims holds in each of them.

    Parameters
    ----------
    content : mapping
        The certificate.
    robot : Robot, optional
        The robot that it must be about; default: built from what the certificate carries.
    scene : Scene, optional
        The scene that it must be about; default: the one that it carries.
    field : DangerField, optional
        If it claims a bound of the danger, this must be of the same kind: aggregate, weighting, k1 and sharpness; of
        the danger in motion k2 and gamma, too. Only these are read. Without a field the claim is checked in the kind
        that it names itself.
    spacing : float, optional
        With a field: the distance between danger points that a claim must have [m]; default: the scene's own.

    Raises
    ------
    CertificateError
        If anything in it does not hold: names the first edge and interval.
    InputError
        If it is no certificate, or its robot cannot be built.
    """
    check_form(content)
    try:
        with document.within("scene"):
            carried = built_scene(document.mapping("carried", content["scene"]))
        with document.within("robot"):
            if robot is None:
                robot = built_robot(document.mapping("carried", content["robot"]))
        scene = carried if scene is None else scene
        found = _verified(content, robot, scene)
        if field is not None:
            apart = scene.spacing if spacing is None else spacing
            if content["danger"] is not None:
                check_kind(content["danger"], field, apart)
            if (content.get("trajectory") or {}).get("danger") is not None:
                check_kind(content["trajectory"]["danger"], field, apart, moving=True)
        return found
    except (ArithmeticError, AttributeError, LookupError, TypeError, ValueError) as error:
        if isinstance(error, InputError):
            raise
        raise CertificateError(f"it is malformed: {type(error).__name__}: {error}") from None


def _verified(content: Mapping[str, Any], robot: Robot, scene: Scene) -> Verified:
    _check_origin(content, robot, scene)
    path = _numbers("path", content["path"], (None, robot.n))
    _check_limits(robot, path)
    check_claims(content, robot, scene)
    ends = path[1:] if len(path) > 1 else path
    if len(content["edges"]) != len(ends):
        raise CertificateError(f"the path has {len(ends)} edges, the certificate {len(content['edges'])}")
    separations = Separations(robot, scene, content)
    if sorted(map(tuple, content["pairs"])) != sorted(separations.names):
        raise CertificateError("its pairs of bodies are not those of robot and scene")
    intervals = 0
    for k, (edge, start, end) in enumerate(zip(content["edges"], path, ends, strict=False)):
        _check_cover(k, edge)
        delta = robot.difference(start, end)
        for j, interval in enumerate(edge):
            _check_interval(f"edge {k}, interval {j}", interval, start, delta, separations, content["pairs"])
            intervals += 1
    _check_danger(content["danger"], robot, scene, path, ends)
    _check_tool(content.get("tool"), robot, path, ends)
    check_trajectory(content, robot, scene, path, separations)
    if content["digest"] != digest(content):
        raise CertificateError(
            "every interval holds, but the file is not as it was written: its digest differs"
        )
    return Verified(
        edges=len(ends),
        intervals=intervals,
        distances=intervals * len(separations.names),
        claims=claimed(content),
        not_claimed=not_claimed(content),
        not_covered=not_covered(content),
    )


def _numbers(name: str, value: Any, shape: tuple[int | None, ...]) -> FloatArray:
    """Return plain numbers as an array; text that reads like a number is none."""
    array = finite_array(value, shape, name)
    if not all(
        type(number) in (int, float) for row in value for number in (row if len(shape) > 1 else [row])
    ):
        raise CertificateError(f"it is malformed: {name} must be plain numbers")
    return array


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
    lacking = links_without_collision(robot)
    if content["robot"]["links_without_collision"] != lacking:
        raise CertificateError(
            f"links without collision geometry: it names {content['robot']['links_without_collision']}, "
            f"the robot has {lacking}"
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
    separations: Separations,
    pairs: list[list[str]],
) -> None:
    if sorted(interval) != sorted(_INTERVAL):
        raise CertificateError(f"it is malformed: {name} has {sorted(interval)}, not {sorted(_INTERVAL)}")
    centre, half = _numbers("centre and half_length", [interval[key] for key in _INTERVAL[:2]], (2,))
    name = f"{name} (centre {centre:.6f}, half-length {half:.6f})"
    if not (0.0 <= centre <= 1.0 and half >= 0.0):
        raise CertificateError(f"{name}: not a part of the edge")
    if len(interval["margins"]) != len(pairs):
        raise CertificateError(f"{name}: {len(interval['margins'])} margins for {len(pairs)} pairs")
    known = _numbers("margins", interval["margins"], (len(pairs),)).tolist()
    margins = {tuple(pair): margin for pair, margin in zip(pairs, known, strict=True)}
    for pair, distance, approach, required in separations.examined(
        start + centre * delta, half * np.abs(delta)
    ):
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
    return f"{plain_name(pair[0])!r} and {plain_name(pair[1])!r}"


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


# ------------------------------------------------------------------------------------------------------ tool


def _check_tool(claim: Mapping[str, Any] | None, robot: Robot, path: FloatArray, ends: FloatArray) -> None:
    if claim is None:
        return
    tool = PlainTool(robot, claim)
    for k, (start, end) in enumerate(zip(path, ends, strict=False)):
        failure = tool.exceeded(start, robot.difference(start, end))
        if failure is not None:
            raise CertificateError(
                f"edge {k}: the {failure[1]} of the tool is not as claimed near {failure[0]:.6f} of it"
            )
