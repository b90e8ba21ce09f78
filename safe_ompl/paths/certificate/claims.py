"""The claims of a certificate: whether they have a meaning, what they say in words, and what is not claimed.

Without the first a claim could be empty, such as a distance from an obstacle that is not there, or weaken the proof: a
negative distance would let bodies overlap.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from safe_ompl import document
from safe_ompl.errors import InputError, UnknownNameError
from safe_ompl.paths.certificate.danger_claims import check_danger
from safe_ompl.paths.certificate.format import CLAIMS
from safe_ompl.paths.certificate.trajectory_claims import (
    check_trajectory_claim,
    claimed_of_trajectory,
    not_claimed_of_trajectory,
)
from safe_ompl.robot.robot import Robot
from safe_ompl.scene.scene import Scene

_SHORTEST, _LONGEST = 0.1, 10.0  # vectors that say a direction
_UNBOUNDED = 1e300  # [m]


# --------------------------------------------------------------------------------------- whether they have a meaning


def check_claims(content: Mapping[str, Any], robot: Robot, scene: Scene) -> None:
    """Raise InputError, naming key and value, unless the claims of a certificate have a meaning."""
    check_clearance(content["clearance"], robot, scene)
    check_moving_obstacles(content["moving_obstacles"], scene)
    check_tool(content.get("tool"))
    check_trajectory_claim(content.get("trajectory"), robot, scene)
    if content["danger"] is not None:
        with document.within("danger"):
            check_danger(document.mapping("claim", content["danger"]), scene)
    if content["also_sampled"] is not None:
        document.text("also_sampled", content["also_sampled"])


def check_clearance(claim: Any, robot: Robot, scene: Scene) -> None:
    """Raise InputError unless a claim of clearance, or None, has a meaning for robot and scene."""
    if claim is None:
        return
    with document.within("clearance"):
        document.check_keys(document.mapping("claim", claim), ("distance", "obstacles", "exempt"))
        document.number("distance", document.require(claim, "distance"), at_least=0.0)
        obstacles = document.sequence("obstacles", document.require(claim, "obstacles"))
        if not obstacles:
            raise InputError("must name an obstacle at least", "obstacles")
        for name in obstacles:
            _check_known("obstacle", name, scene.names)
        links = sorted({body.name.rsplit("_", 1)[0] for body in robot.shared.collision_model.geometryObjects})
        for pair in document.sequence("exempt", document.require(claim, "exempt")):
            names = document.sequence("exempt", pair)
            if len(names) != 2:
                raise InputError(f"must be pairs of a link and an obstacle, not {pair!r}", "exempt")
            _check_known("link", names[0], links)
            _check_known("obstacle", names[1], obstacles)


def check_moving_obstacles(claim: Any, scene: Scene) -> None:
    """Raise InputError unless a claim about moving obstacles, or None, has a meaning for a scene."""
    if claim is None:
        return
    with document.within("moving_obstacles"):
        document.check_keys(document.mapping("claim", claim), ("speeds", "time"))
        document.number("time", document.require(claim, "time"), at_least=0.0)
        speeds = document.mapping("speeds", document.require(claim, "speeds"))
        if not speeds:
            raise InputError("must name an obstacle at least", "speeds")
        with document.within("speeds"):
            for name, speed in speeds.items():
                _check_known("obstacle", name, scene.names)
                document.number(name, speed, at_least=0.0)


def check_tool(claim: Any) -> None:
    """Raise InputError unless a claim about the tool, or None, has a meaning."""
    if claim is None:
        return
    with document.within("tool"):
        document.check_keys(document.mapping("claim", claim), ("orientation", "position"))
        if not claim:
            raise InputError("must claim an orientation or a position", "orientation")
        if "orientation" in claim:
            _check_orientation(document.mapping("orientation", claim["orientation"]))
        if "position" in claim:
            bounds = document.mapping("position", claim["position"], ("x", "y", "z"))
            if not bounds:
                raise InputError("must have bounds of x, y or z", "position")
            for key, given in bounds.items():
                document.numbers(f"position.{key}", given, 2)


def _check_orientation(claim: Mapping[str, Any]) -> None:
    with document.within("orientation"):
        document.check_keys(claim, ("axis", "direction", "angle"))
        document.number("angle", document.require(claim, "angle"), above=0.0, at_most=np.pi)
        for key in ("axis", "direction"):
            vector = document.numbers(key, document.require(claim, key), 3)
            if not _SHORTEST <= float(np.linalg.norm(vector)) <= _LONGEST:
                raise InputError(f"must be a direction, got {vector!r}", key)


def _check_known(kind: str, name: Any, known: Iterable[str]) -> None:
    if name not in tuple(known):
        raise UnknownNameError(kind, name, known)


# ---------------------------------------------------------------------------------------------- what they say in words


def claimed(content: Mapping[str, Any]) -> tuple[str, ...]:
    """Return what a certificate claims, in words, of which each is complete in itself."""
    danger, clearance, moving = (content[key] for key in ("danger", "clearance", "moving_obstacles"))
    said = ["every motion is free"]
    if danger is not None:
        points = f"points {danger['spacing']:g} m apart" + (" where the scene has them" if moving else "")
        kind = f"{danger['aggregate']}, {danger['weighting']}, k1 {danger['k1']:g}, {points}"
        said.append(f"danger at most {danger['bound']:.3f} ({kind})")
    if clearance is not None:
        exempt = ", ".join(f"{link} from {obstacle}" for link, obstacle in clearance["exempt"])
        said.append(
            f"at least {1e3 * clearance['distance']:.1f} mm from {', '.join(clearance['obstacles'])}"
            + (f", except {exempt}" if exempt else "")
        )
    if moving is not None:
        speeds = ", ".join(f"{name} {speed:g} m/s" for name, speed in moving["speeds"].items())
        said.append(f"the same while obstacles move no faster than {speeds}, for {moving['time']:g} s")
    return (
        *said,
        *_claimed_of_tool(content.get("tool") or {}),
        *claimed_of_trajectory(content.get("trajectory")),
    )


def _claimed_of_tool(claim: Mapping[str, Any]) -> list[str]:
    said = []
    if "orientation" in claim:
        wanted = claim["orientation"]
        axis, direction = (", ".join(f"{x:.4g}" for x in wanted[key]) for key in ("axis", "direction"))
        said.append(
            f"the tool's axis ({axis}) within {np.degrees(wanted['angle']):.4g}° of the direction ({direction})"
        )
    if "position" in claim:
        bounds = (_range(key, *given) for key, given in claim["position"].items())
        said.append(f"the tip at {', '.join(bounds)}")
    return said


def _range(key: str, low: float, high: float) -> str:
    if max(-low, high) < _UNBOUNDED:
        return f"{key} from {low:g} to {high:g} m"
    return f"{key} of at least {low:g} m" if high >= _UNBOUNDED else f"{key} of at most {high:g} m"


def not_claimed(content: Mapping[str, Any]) -> tuple[str, ...]:
    """Return which claims a certificate could make, but does not; of time only where the path is timed."""
    claims = {**{key: content[key] for key in CLAIMS}, "tool": content.get("tool")}
    missing = [key.replace("_", " ") for key, claim in claims.items() if claim is None]
    return (*missing, *not_claimed_of_trajectory(content.get("trajectory")))


def not_covered(content: Mapping[str, Any]) -> tuple[str, ...]:
    """Return what no certificate of this robot and path covers: links without collision shapes, what was sampled."""
    links, sampled = content["robot"]["links_without_collision"], content["also_sampled"]
    said = [f"links without collision geometry: {', '.join(links)}"] if links else []
    return (*said, *([] if sampled is None else [sampled]))
