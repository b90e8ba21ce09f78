"""Robot, obstacles and people as `visualization_msgs/MarkerArray`, and where frames are (`tf2_msgs/TFMessage`)."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from typing import Any

import numpy as np
import pinocchio as pin

from safe_ompl.apps.exchange.messages import DELETE_ALL, SPHERE, Message, colour, header, pose, vector
from safe_ompl.apps.exchange.received import WORLD
from safe_ompl.geometry import STANDING, Obstacle, Person, Pose, Triangles
from safe_ompl.view import RobotBody

_ROBOT, _STILL, _DANGEROUS = (0.75, 0.78, 0.82), (0.8, 0.68, 0.53), (0.85, 0.45, 0.3)
_LIMB = (0.83, 0.43, 0.29)
_AROUND = 24  # corners of round shapes
_CYLINDER, _TRIANGLES = 3, 11  # types of markers


def body_frame(name: str) -> str:
    """Return the frame of a part of the robot's body."""
    return f"robot/{name}"


def obstacle_frame(name: str) -> str:
    """Return the frame of an obstacle that moves."""
    return f"obstacle/{name}"


def robot_markers(time: int, body: RobotBody, names: Sequence[str]) -> Message:
    """Return the parts of a robot's body from a time [ns] on, each in its own frame."""
    parts = zip(names, body.links, strict=False)
    meshes = {name: [_mesh((part.vertices, part.faces), _ROBOT)] for name, part in parts}
    return _markers(time, meshes, {name: body_frame(name) for name in names})


def obstacle_markers(time: int, obstacles: Iterable[Obstacle], moving: Collection[str]) -> Message:
    """Return obstacles from a time [ns] on; those that are named in `moving` in frames of their own."""
    found, frames = {}, {}
    for obstacle in obstacles:
        usual = _DANGEROUS if obstacle.weight > 0 else _STILL
        place = obstacle.pose
        if obstacle.name in moving:
            frames[obstacle.name], place = obstacle_frame(obstacle.name), Pose()
        found[obstacle.name] = [_mesh(obstacle.shape.triangles(_AROUND), obstacle.color or usual, place)]
    return _markers(time, found, frames)


def limb_markers(
    time: int, people: Mapping[str, Mapping[str, Any]], bodies: Mapping[str, Mapping[str, Any]]
) -> Message:
    """Return the limbs of people at a time [ns], as cylinders with round ends, in the place of those before.

    `people` are key points in the world by name; `bodies` their heights and limbs, as the header of ticks has them.
    """
    found: dict[str, list[Message]] = {}
    for name, points in people.items():
        known = {point: place for point, place in points.items() if point in STANDING}
        person = Person(bodies[name]["height"], known, tuple(bodies[name].get("limbs") or ()))
        solids = found[name] = []
        for limb in person.limbs():
            wide, look = 2 * limb.radius, {"color": colour(_LIMB)}
            for end in sorted({tuple(limb.start.tolist()), tuple(limb.end.tolist())}):
                solids.append({"type": SPHERE, "pose": pose(end), "scale": vector([wide] * 3), **look})
            if limb.length > 0:
                size = vector([wide, wide, limb.length])
                solids.append({"type": _CYLINDER, "pose": _pose(limb.placement), "scale": size, **look})
    return _markers(time, found, {})


def transforms(time: int, places: Mapping[str, pin.SE3]) -> Message:
    """Return where frames are in the world at a time [ns], as a `tf2_msgs/TFMessage`."""
    found = []
    for name, place in places.items():
        at = _pose(place)
        where = {"translation": at["position"], "rotation": at["orientation"]}
        found.append({"header": header(time, WORLD), "child_frame_id": name, "transform": where})
    return {"transforms": found}


def _markers(time: int, found: Mapping[str, Sequence[Message]], frames: Mapping[str, str]) -> Message:
    """Return solids by name, in the place of all before; `frames` where they are not in the world's."""
    markers: list[Message] = [{"header": header(time, WORLD), "action": DELETE_ALL}]
    for name, solids in found.items():
        about = {"header": header(time, frames.get(name, WORLD)), "ns": name, "frame_locked": True}
        markers += [{**about, "id": k, **solid} for k, solid in enumerate(solids)]
    return {"markers": markers}


def _mesh(triangles: Triangles, look: Any, place: Pose | None = None) -> Message:
    vertices, faces = triangles
    place = Pose() if place is None else place
    return {
        "type": _TRIANGLES,
        "pose": pose(place.position, place.quaternion_xyzw),
        "scale": vector([1.0] * 3),
        "color": colour(look),
        "points": [vector(point) for point in np.round(vertices, 6)[np.asarray(faces).reshape(-1)]],
    }


def _pose(place: pin.SE3) -> Message:
    return pose(place.translation, pin.Quaternion(place.rotation).coeffs())
