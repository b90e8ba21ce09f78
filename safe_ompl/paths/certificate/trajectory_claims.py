"""What a certificate claims of a trajectory: the claim itself, whether it has a meaning, and what it says in words."""

from __future__ import annotations

import logging
from collections.abc import Mapping
from typing import Any

import numpy as np

from safe_ompl import document
from safe_ompl.errors import InputError, UnknownNameError
from safe_ompl.robot.robot import Robot
from safe_ompl.scene.scene import Scene
from safe_ompl.trajectories.jerk_law import JerkLaw
from safe_ompl.trajectories.trajectory import Trajectory

_log = logging.getLogger(__name__)

_KEYS = ("pieces", "corners", "edges", "squares", "duration", "velocity", "acceleration", "stops")
_MORE = ("phases", "jerk", "tool_speed", "link_speed")  # claimed where they are limited
_STOPS = ("who", "speed", "speeds", "reaction_time", "clearance", "brakes")


def trajectory_claim(trajectory: Trajectory, scene: Scene) -> dict[str, Any]:
    """Return the claim of a trajectory in plain numbers.

    Stops that may end in a contact are not claimed, which a warning says: what a body bears is nothing to prove.
    """
    curve, law, people = trajectory.curve, trajectory.law, trajectory.people
    stops = None
    if people is not None and trajectory.brakes is not None:
        if people.contact:
            _log.warning("the certificate claims no stops: the trajectory allows contact")
        else:
            stops = {
                "who": list(people.names(scene)),
                "speed": people.speed,
                "speeds": dict(people.speeds),
                "reaction_time": people.reaction_time,
                "clearance": people.clearance,
                "brakes": trajectory.brakes.tolist(),
            }
    return {
        "pieces": [
            {
                **{key: getattr(piece, key).tolist() for key in ("start", "forward", "inward")},
                "length": piece.length,
                "curvature": piece.curvature,
            }
            for piece in curve.pieces
        ],
        "corners": list(curve.stops),
        "edges": law.edges.tolist(),
        "squares": law.squares.tolist(),
        "duration": law.duration,
        "velocity": trajectory.limits.velocity.tolist(),
        "acceleration": trajectory.limits.acceleration.tolist(),
        "stops": stops,
        **_more(trajectory),
    }


def _more(trajectory: Trajectory) -> dict[str, Any]:
    law, jerk = trajectory.law, trajectory.limits.jerk
    found: dict[str, Any] = {"tool_speed": trajectory.tool_speed, "link_speed": trajectory.link_speed}
    if isinstance(law, JerkLaw) and jerk is not None:
        durations = np.diff(law.starts)
        found |= {"phases": np.column_stack([durations, law.phases[:, 3]]).tolist(), "jerk": jerk.tolist()}
    return {key: value for key, value in found.items() if value is not None}


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
    document.check_keys(claim, _STOPS)
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
    return said


def not_claimed_of_trajectory(claim: Any) -> list[str]:
    """Return what could be said of a trajectory, and is not claimed of it; nothing where there is none."""
    if claim is None:
        return []
    missing = [] if claim["stops"] is not None else ["stops"]
    missing += [
        key.replace("_", " ") for key in ("jerk", "tool_speed", "link_speed") if claim.get(key) is None
    ]
    return [*missing, "danger in motion", "contact"]
