"""Robot, obstacles and people as scene entities and transforms of Foxglove (JSON), after its published schemas."""

from __future__ import annotations

import json
from collections.abc import Collection, Iterable, Mapping, Sequence
from typing import Any

import numpy as np
import pinocchio as pin

from safe_ompl.apps.exchange.messages import colour, header, pose, stamp, vector
from safe_ompl.geometry import STANDING, Obstacle, Person, Pose, Triangles
from safe_ompl.view import RobotBody

SCENE_UPDATE, FRAME_TRANSFORMS = "foxglove.SceneUpdate", "foxglove.FrameTransforms"
WORLD = "world"
_ROBOT, _STILL, _DANGEROUS, _LIMB = (
    (0.75, 0.78, 0.82),
    (0.8, 0.68, 0.53),
    (0.85, 0.45, 0.3),
    (0.83, 0.43, 0.29),
)
_AROUND = 24  # corners of round shapes
_MARKERS, _DELETE_ALL = {"spheres": 2, "cylinders": 3, "triangles": 11}, 3
_KINDS = ("arrows", "cubes", "spheres", "cylinders", "lines", "triangles", "texts", "models")

Message = dict[str, Any]


def body_frame(name: str) -> str:
    """Return the frame of a part of the robot's body."""
    return f"robot/{name}"


def obstacle_frame(name: str) -> str:
    """Return the frame of an obstacle that moves."""
    return f"obstacle/{name}"


def robot_update(time: int, body: RobotBody, names: Sequence[str]) -> Message:
    """Return the parts of a robot's body from a time [ns] on, each in its own frame."""
    parts = zip(names, body.links, strict=True)
    return _update(
        time,
        {name: {"triangles": [_mesh((part.vertices, part.faces), _ROBOT)]} for name, part in parts},
        {name: body_frame(name) for name in names},
    )


def obstacles_update(time: int, obstacles: Iterable[Obstacle], moving: Collection[str]) -> Message:
    """Return obstacles from a time [ns] on; those that are named in `moving` in frames of their own."""
    found, frames = {}, {}
    for obstacle in obstacles:
        usual = _DANGEROUS if obstacle.weight > 0 else _STILL
        place = Pose() if obstacle.name in moving else obstacle.pose
        mesh = _mesh(obstacle.shape.triangles(_AROUND), obstacle.color or usual, place)
        found[obstacle.name] = {"triangles": [mesh]}
        if obstacle.name in moving:
            frames[obstacle.name] = obstacle_frame(obstacle.name)
    return _update(time, found, frames)


def limbs_update(
    time: int, people: Mapping[str, Mapping[str, Any]], bodies: Mapping[str, Mapping[str, Any]]
) -> Message:
    """Return the limbs of people at a time [ns], as cylinders with round ends, in the place of those before.

    `people` are key points in the world by name; `bodies` their heights and limbs, as the header of ticks has them.
    """
    found = {}
    for name, points in people.items():
        known = {point: place for point, place in points.items() if point in STANDING}
        person = Person(bodies[name]["height"], known, tuple(bodies[name].get("limbs") or ()))
        spheres, cylinders = [], []
        for limb in person.limbs():
            wide, look = 2 * limb.radius, {"color": colour(_LIMB)}
            ends = {tuple(limb.start.tolist()), tuple(limb.end.tolist())}
            spheres += [{"pose": pose(end), "size": vector([wide] * 3), **look} for end in sorted(ends)]
            if limb.length > 0:
                size = {"size": vector([wide, wide, limb.length]), "bottom_scale": 1.0, "top_scale": 1.0}
                cylinders.append({"pose": _pose(limb.placement), **size, **look})
        found[name] = {"spheres": spheres, "cylinders": cylinders}
    everybody = {"timestamp": stamp_of(time), "type": 1, "id": ""}
    return {**_update(time, found, {}), "deletions": [everybody]}


def transforms(time: int, places: Mapping[str, pin.SE3]) -> Message:
    """Return where frames are in the world at a time [ns]."""
    found = []
    for name, place in places.items():
        at = _pose(place)
        ends = {"parent_frame_id": WORLD, "child_frame_id": name}
        where = {"translation": at["position"], "rotation": at["orientation"]}
        found.append({"timestamp": stamp_of(time), **ends, **where})
    return {"transforms": found}


def markers(time: int, update: Mapping[str, Any]) -> Message:
    """Return the entities of an update as a `visualization_msgs/MarkerArray` for RViz, after one that deletes all."""
    found: list[Message] = [{"header": header(time, WORLD), "action": _DELETE_ALL}]
    for entity in update["entities"]:
        solids = [(kind, solid) for kind in ("spheres", "cylinders", "triangles") for solid in entity[kind]]
        for k, (kind, solid) in enumerate(solids):
            marker = {"header": header(time, entity["frame_id"]), "ns": entity["id"], "id": k}
            marker |= {"type": _MARKERS[kind], "pose": solid["pose"], "color": solid["color"]}
            if kind == "triangles":
                points = [solid["points"][corner] for corner in solid["indices"]]
                found.append({**marker, "scale": vector([1.0] * 3), "points": points})
            else:
                found.append({**marker, "scale": solid["size"]})
    return {"markers": found}


def stamp_of(time: int) -> Message:
    """Return a time [ns] as Foxglove's JSON has it."""
    found = stamp(time)
    return {"sec": found["sec"], "nsec": found["nanosec"]}


def _update(time: int, found: Mapping[str, Message], frames: Mapping[str, str]) -> Message:
    """Return an update with entities by name, each with its primitives by kind; `frames` if not the world's."""
    none: Message = {kind: [] for kind in _KINDS}
    entities = [
        {
            "timestamp": stamp_of(time),
            "frame_id": frames.get(name, WORLD),
            "id": name,
            "lifetime": stamp_of(0),
            "frame_locked": True,
            "metadata": [],
            **none,
            **primitives,
        }
        for name, primitives in found.items()
    ]
    return {"deletions": [], "entities": entities}


def _mesh(triangles: Triangles, look: Any, place: Pose | None = None) -> Message:
    vertices, faces = triangles
    place = Pose() if place is None else place
    return {
        "pose": pose(place.position, place.quaternion_xyzw),
        "points": [vector(point) for point in np.round(vertices, 6)],
        "color": colour(look),
        "colors": [],
        "indices": np.asarray(faces).reshape(-1).tolist(),
    }


def _pose(place: pin.SE3) -> Message:
    return pose(place.translation, pin.Quaternion(place.rotation).coeffs())


# ------------------------------------------------------------------------------------------------------ schemas


def _object(title: str, **properties: Any) -> Message:
    return {
        "title": title,
        "type": "object",
        "properties": properties,
        "required": list(properties),
    }


def _list(items: Message) -> Message:
    return {"type": "array", "items": items}


def _numbers(title: str, keys: str) -> Message:
    return _object(f"foxglove.{title}", **dict.fromkeys(keys, _NUMBER))


_NUMBER, _TEXT, _WHOLE = {"type": "number"}, {"type": "string"}, {"type": "integer", "minimum": 0}
_VECTOR, _TURN, _COLOUR = (
    _numbers("Vector3", "xyz"),
    _numbers("Quaternion", "xyzw"),
    _numbers("Color", "rgba"),
)
_POINT, _PLACE = _numbers("Point3", "xyz"), _object("foxglove.Pose", position=_VECTOR, orientation=_TURN)
_TIME, _SPAN = (_object(title, sec=_WHOLE, nsec=_WHOLE) for title in ("time", "duration"))
_SOLID = {"pose": _PLACE, "size": _VECTOR}
_ENTITY = _object(
    "foxglove.SceneEntity",
    timestamp=_TIME,
    frame_id=_TEXT,
    id=_TEXT,
    lifetime=_SPAN,
    frame_locked={"type": "boolean"},
    metadata=_list(_object("foxglove.KeyValuePair", key=_TEXT, value=_TEXT)),
    **{kind: {"type": "array"} for kind in _KINDS},
)
_ENTITY["properties"] |= {
    "spheres": _list(_object("foxglove.SpherePrimitive", **_SOLID, color=_COLOUR)),
    "cylinders": _list(
        _object(
            "foxglove.CylinderPrimitive", **_SOLID, bottom_scale=_NUMBER, top_scale=_NUMBER, color=_COLOUR
        )
    ),
    "triangles": _list(
        _object(
            "foxglove.TriangleListPrimitive",
            pose=_PLACE,
            points=_list(_POINT),
            color=_COLOUR,
            colors=_list(_COLOUR),
            indices=_list(_WHOLE),
        )
    ),
}
SCHEMAS: dict[str, str] = {
    SCENE_UPDATE: json.dumps(
        _object(
            SCENE_UPDATE,
            deletions=_list(_object("foxglove.SceneEntityDeletion", timestamp=_TIME, type=_WHOLE, id=_TEXT)),
            entities=_list(_ENTITY),
        )
    ),
    FRAME_TRANSFORMS: json.dumps(
        _object(
            FRAME_TRANSFORMS,
            transforms=_list(
                _object(
                    "foxglove.FrameTransform",
                    timestamp=_TIME,
                    parent_frame_id=_TEXT,
                    child_frame_id=_TEXT,
                    translation=_VECTOR,
                    rotation=_TURN,
                )
            ),
        )
    ),
}
"""Name of a type of Foxglove → its schema (JSON schema), as far as it is used here."""
