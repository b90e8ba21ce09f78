"""Claims of a trajectory in a certificate: whether they have a meaning, and what they say in words."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from safe_ompl import document
from safe_ompl.errors import InputError, UnknownNameError
from safe_ompl.paths.certificate.danger_claims import check_danger
from safe_ompl.robot.robot import Robot
from safe_ompl.scene.scene import Scene

_KEYS = ("pieces", "corners", "edges", "squares", "duration", "velocity", "acceleration", "stops")
_MORE = ("phases", "jerk", "tool_speed", "link_speed", "danger")  # claimed where they are limited
_STOPS = ("who", "speed", "speeds", "reaction_time", "clearance", "brakes")
_CONTACT = "contact"  # of stops, where it is allowed


def check_trajectory_claim(claim: Any, robot: Robot, scene: Scene) -> None:
    """Raise InputError unless a claim of a trajectory, or None, has a meaning for robot and scene."""
    if claim is None:
        return
    with document.within("trajectory"):
        document.check_keys(document.mapping("claim", claim), (*_KEYS, *_MORE))
        for key in _KEYS:
            if key != "stops":
                document.require(claim, key)
        document.number("duration", claim["duration"], above=0.0)
        for key in ("velocity", "acceleration"):
            limits = document.numbers(key, claim[key], robot.n)
            for k, limit in enumerate(limits):
                document.number(f"{key}[{k}]", limit, above=0.0)
        _check_more(claim, robot)
        if claim.get("danger") is not None:
            with document.within("danger"):
                check_danger(document.mapping("claim", claim["danger"]), scene, moving=True)
        if claim["stops"] is not None:
            with document.within("stops"):
                _check_stops(document.mapping("claim", claim["stops"]), scene)


def _check_more(claim: Mapping[str, Any], robot: Robot) -> None:
    for key in ("tool_speed", "link_speed"):
        if claim.get(key) is not None:
            document.number(key, claim[key], above=0.0)
    if claim.get("phases") is not None:
        for k, phase in enumerate(document.sequence("phases", claim["phases"])):
            document.numbers(f"phases[{k}]", phase, 2)
    if claim.get("jerk") is not None:
        for k, limit in enumerate(document.numbers("jerk", claim["jerk"], robot.n)):
            document.number(f"jerk[{k}]", limit, above=0.0)


def _check_stops(claim: Any, scene: Scene) -> None:
    document.check_keys(claim, (*_STOPS, _CONTACT))
    for key in ("speed", "reaction_time", "clearance"):
        document.number(key, document.require(claim, key), at_least=0.0)
    who = document.sequence("who", document.require(claim, "who"))
    if not who:
        raise InputError("must name an obstacle at least", "who")
    for name in who:
        if name not in scene.names:
            raise UnknownNameError("obstacle", name, scene.names)
    for limb, speed in document.mapping("speeds", document.require(claim, "speeds")).items():
        document.number(f"speeds.{limb}", speed, at_least=0.0)
    parts = [part for name in who for part, _, _ in scene[name].geometries()]
    for part, speed in document.mapping(_CONTACT, claim.get(_CONTACT, {})).items():
        if part not in parts:
            raise UnknownNameError("limb", part, parts)
        document.number(f"{_CONTACT}.{part}", speed, at_least=0.0)


def claimed_of_trajectory(claim: Any) -> list[str]:
    """Return in words what is claimed of a trajectory."""
    if claim is None:
        return []
    kinds = "velocities, accelerations and jerks" if claim.get("jerk") else "velocities and accelerations"
    said = [f"driven in {claim['duration']:.3f} s, within {kinds} of its joints"]
    for key, who in (("tool_speed", "the tip"), ("link_speed", "no point of a link, nor the tip,")):
        if claim.get(key) is not None:
            said.append(f"{who} is {'no ' if key == 'tool_speed' else ''}faster than {claim[key]:g} m/s")
    stops = claim["stops"]
    if stops is not None:
        speeds = ", ".join(f", {limb} {speed:g} m/s" for limb, speed in stops["speeds"].items())
        said.append(
            f"it stands before anyone of {', '.join(stops['who'])} who moves no faster than {stops['speed']:g} m/s"
            f"{speeds} comes nearer than {1e3 * stops['clearance']:g} mm, if it brakes within "
            f"{stops['reaction_time']:g} s"
        )
        if stops.get(_CONTACT):
            slow = ", ".join(f"{part} {speed:.3g} m/s" for part, speed in stops[_CONTACT].items())
            said[-1] += f", or no point of it is faster then than {slow}"
    danger = claim.get("danger")
    if danger is not None:
        said.append(
            f"danger in motion at most {danger['bound']:.3f} ({danger['aggregate']}, {danger['weighting']}, "
            f"k1 {danger['k1']:g}, k2 {danger['k2']:g}, gamma {danger['gamma']:g}, "
            f"points {danger['spacing']:g} m apart)"
        )
    return said


def not_claimed_of_trajectory(claim: Any) -> list[str]:
    """Return what could be said of a trajectory, and is not claimed of it; nothing where there is none."""
    if claim is None:
        return []
    missing = [] if claim["stops"] is not None else ["stops"]
    missing += [
        key.replace("_", " ") for key in ("jerk", "tool_speed", "link_speed") if claim.get(key) is None
    ]
    return missing if claim.get("danger") is not None else [*missing, "danger in motion"]
