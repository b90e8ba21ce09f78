"""Issues the claims of a trajectory in a certificate: the motion in time, its stops, its danger."""

from __future__ import annotations

from typing import Any

import numpy as np

from safe_ompl.danger.kinetostatic import KinetostaticField
from safe_ompl.errors import InputError
from safe_ompl.robot.robot import Robot
from safe_ompl.scene.scene import Scene
from safe_ompl.trajectories.caps import contact_speed, robot_mass
from safe_ompl.trajectories.jerk_law import JerkLaw
from safe_ompl.trajectories.trajectory import Trajectory

_LEAST_SLACK = 0.03  # of the danger that is claimed, so that it can be confirmed by plain means


def trajectory_claim(trajectory: Trajectory, robot: Robot, scene: Scene) -> dict[str, Any]:
    """Return the claim of a trajectory in plain numbers; what is claimed of its danger comes from `danger_claim`."""
    curve, law = trajectory.curve, trajectory.law
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
        "stops": _stops(trajectory, robot, scene),
        **_more(trajectory),
    }


def _stops(trajectory: Trajectory, robot: Robot, scene: Scene) -> dict[str, Any] | None:
    people = trajectory.people
    if people is None or trajectory.brakes is None:
        return None
    found = {
        "who": list(people.names(scene)),
        "speed": people.speed,
        "speeds": dict(people.speeds),
        "reaction_time": people.reaction_time,
        "clearance": people.clearance,
        "brakes": trajectory.brakes.tolist(),
    }
    if people.contact:
        found["contact"] = {
            part: contact_speed(people.region_of(part[len(name) + 1 :]), robot_mass(robot, people))
            for name in people.names(scene)
            for part, _, _ in scene[name].geometries()
        }
    return found


def _more(trajectory: Trajectory) -> dict[str, Any]:
    law, jerk = trajectory.law, trajectory.limits.jerk
    found: dict[str, Any] = {"tool_speed": trajectory.tool_speed, "link_speed": trajectory.link_speed}
    if isinstance(law, JerkLaw) and jerk is not None:
        durations = np.diff(law.starts)
        found |= {"phases": np.column_stack([durations, law.phases[:, 3]]).tolist(), "jerk": jerk.tolist()}
    return {key: value for key, value in found.items() if value is not None}


def moving_danger_claim(
    trajectory: Trajectory, field: KinetostaticField, spacing: float, scene: Scene
) -> dict[str, Any] | None:
    """Return the claim of the danger in motion: the limit that the trajectory was made for, or else its proven peak.

    None where it cannot be kept from a danger point.

    Raises
    ------
    InputError
        If the field's danger points are not those of the scene: none that verifies would look at them.
    """
    still = field.field
    if still.points is None or not np.array_equal(still.points, scene.danger_points(spacing)[0]):
        raise InputError(
            f"the danger points of the field are not those of the scene, {spacing:g} m apart", "spacing"
        )
    bound = trajectory.max_danger
    if bound is None:
        danger = trajectory.danger(field)
        bound = max(danger.proven_peak, (1 + _LEAST_SLACK) * danger.peak)
    if not np.isfinite(bound):
        return None
    return {
        "bound": bound,
        "spacing": spacing,
        "aggregate": still.aggregate,
        "weighting": still.weighting,
        "k1": still.k1,
        "k2": field.k2,
        "gamma": field.gamma,
        "sharpness": still.sharpness,
    }
