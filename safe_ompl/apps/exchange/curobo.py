"""Worlds of cuRobo, and the robots of spheres that it checks.

What cannot be represented is refused, in one line that names file, key and value. Meshes are their convex hulls.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import coal
import numpy as np
import pinocchio as pin

from safe_ompl.apps.exchange.moveit import document_of
from safe_ompl.common import InputError, UnknownNameError, documents as document, files
from safe_ompl.geometry import Box, Capsule, Cylinder, Mesh, Obstacle, Pose, Shape, Sphere
from safe_ompl.robot import Robot, UrdfFile
from safe_ompl.scene import Scene

_LOOKS = ("name", "color", "texture", "texture_id", "material")


def scene_from_curobo(file: str | Path) -> Scene:
    """Read a world of cuRobo (YAML): cuboids, spheres, capsules, cylinders and mesh files, which become their hulls.

    Files of meshes are relative to the file. Raises InputError, which names file, key and value, for other kinds (blox,
    voxel, …), meshes given by their points, and scales, which cuRobo reads in two ways.
    """
    with document_of(file) as data:
        document.check_keys(data, _KINDS)
        found = []
        for kind, (keys, shape_of) in _KINDS.items():
            for name, item in document.mapping(kind, data.get(kind) or {}).items():
                with document.within(f"{kind}.{name}"):
                    document.check_keys(document.mapping("value", item), (*keys, "pose", "scale", *_LOOKS))
                    if item.get("scale") not in (None, 1, 1.0, [1, 1, 1]):
                        raise InputError(f"must be [1, 1, 1], got {item['scale']!r}: write the sizes", "scale")
                    place = _curobo_pose(kind, item)
                    shape, within = shape_of({**item, "file_path": Path(file).parent / str(item.get("file_path"))})
                    found.append(Obstacle(name, shape, place * within))
        return Scene(found)


def _curobo_pose(kind: str, item: Mapping[str, Any]) -> pin.SE3:
    if kind == "sphere" and item.get("position") is not None:
        return Pose(document.numbers("position", item["position"], 3)).se3
    x, y, z, *turn = document.numbers("pose", document.require(item, "pose"), 7)
    with document.within("pose"):
        return Pose((x, y, z), (*turn[1:], turn[0])).se3


def _capsule(item: Mapping[str, Any]) -> tuple[Shape, pin.SE3]:
    base, tip = (np.array(document.numbers(key, item.get(key, (0, 0, 0)), 3)) for key in ("base", "tip"))
    length = float(np.linalg.norm(tip - base))
    if not length:
        return Sphere(item["radius"]), pin.SE3(np.eye(3), base)
    turn = pin.Quaternion.FromTwoVectors(np.array([0.0, 0.0, 1.0]), (tip - base) / length)
    return Capsule(item["radius"], length), pin.SE3(turn.matrix(), (base + tip) / 2)


_HERE = pin.SE3.Identity()
_KINDS: dict[str, tuple[tuple[str, ...], Any]] = {
    "cuboid": (("dims",), lambda item: (Box(document.require(item, "dims")), _HERE)),
    "sphere": (("radius", "position"), lambda item: (Sphere(document.require(item, "radius")), _HERE)),
    "capsule": (("radius", "base", "tip"), _capsule),
    "cylinder": (
        ("radius", "height"),
        lambda item: (Cylinder(document.require(item, "radius"), document.require(item, "height")), _HERE),
    ),
    "mesh": (("file_path",), lambda item: (Mesh(item["file_path"]), _HERE)),
}


def robot_from_curobo(file: str | Path, urdf: str | Path, **options: Any) -> Robot:
    """Build the robot of spheres that cuRobo checks (robot YAML, or XRDF), on the joints of a URDF.

    It is another robot than that of the URDF, and is named so: spheres need not contain the links. Radii are grown by
    the collision buffer and by the self-collision buffer where that is above 0: alone or together they are never
    smaller than what cuRobo checks, and the same where there is no self-collision buffer.

    Parameters
    ----------
    file, urdf : path-like
        The robot YAML (its spheres in it, or in a file beside it) or XRDF; and the URDF.
    **options
        `package_dirs`, `tip`, `locked` and others of `Robot.from_models`, instead of what the file says.

    Raises
    ------
    InputError
        If a link, a joint or spheres are missing, or a modifier of an XRDF is not read; names file, key and value.
    """
    source = UrdfFile(Path(urdf), tuple(options.pop("package_dirs", ())), None)
    model = source.build_model()
    with document_of(file) as data:
        read = _xrdf(data, model) if "format" in data else _curobo_robot(data, Path(file).parent)
        spheres, grown, extra, ignored, given = read
        bodies, links = pin.GeometryModel(), []
        for link, balls in spheres.items():
            with document.within(f"spheres.{link}"):
                if not model.existFrame(link, pin.FrameType.BODY):
                    raise UnknownNameError("link", link, [f.name for f in model.frames if f.type == pin.FrameType.BODY])
                index = model.getFrameId(link, pin.FrameType.BODY)
                frame = model.frames[index]
                for k, ball in enumerate(balls):
                    radius = document.number("radius", document.require(ball, "radius"))
                    if radius <= 0:  # cuRobo's way to have none
                        continue
                    radius += grown.get(link, 0.0) + max(0.0, extra.get(link, 0.0))
                    centre = np.array(document.numbers("center", document.require(ball, "center"), 3))
                    place = frame.placement * pin.SE3(np.eye(3), centre)
                    shape = coal.Sphere(document.number("radius", radius, above=0.0))
                    bodies.addGeometryObject(pin.GeometryObject(f"{link}_{k}", frame.parentJoint, index, place, shape))
                    links.append(link)
        for i, a in enumerate(links):
            for j, b in enumerate(links[:i]):
                if a != b and b not in ignored.get(a, ()) and a not in ignored.get(b, ()):
                    bodies.addCollisionPair(pin.CollisionPair(j, i))
        given = {"name": f"{model.name}, cuRobo's spheres", **given, **options}
        mimics = {name: mimic for name, mimic in source.mimics().items() if model.existJointName(name)}
        return Robot.from_models(model, bodies, mimics=mimics, **given)


_Read = tuple[dict[str, list[Any]], dict[str, float], dict[str, float], dict[str, Sequence[str]], dict[str, Any]]


def _curobo_robot(data: Mapping[str, Any], folder: Path) -> _Read:
    kinematics = document.mapping("kinematics", data.get("robot_cfg", data).get("kinematics"))
    spheres = document.require(kinematics, "collision_spheres")
    if isinstance(spheres, str):
        with files.reading(folder / spheres) as other:
            spheres = document.require(other, "collision_spheres")
    spheres = document.by_name("collision_spheres", spheres, document.sequence)
    if (names := kinematics.get("collision_link_names")) is not None:
        spheres = {link: spheres[link] for link in names if link in spheres}
    grown = kinematics.get("collision_sphere_buffer") or 0.0
    if not isinstance(grown, Mapping):
        grown = dict.fromkeys(spheres, document.number("collision_sphere_buffer", grown))
    extra = document.by_name("self_collision_buffer", kinematics.get("self_collision_buffer") or {}, document.number)
    locked = document.by_name("lock_joints", kinematics.get("lock_joints") or {}, document.number)
    given = {"locked": locked, **({"tip": kinematics["ee_link"]} if "ee_link" in kinematics else {})}
    return spheres, dict(grown), extra, kinematics.get("self_collision_ignore") or {}, given


def _xrdf(data: Mapping[str, Any], model: pin.Model) -> _Read:
    root = next(frame.name for frame in model.frames if frame.type == pin.FrameType.BODY)
    for k, modifier in enumerate(data.get("modifiers") or ()):
        if modifier != {"set_base_frame": root}:
            raise InputError(f"is not read; a base frame must be {root!r}, got {modifier!r}", f"modifiers[{k}]")
    collision, own = (document.mapping(key, data.get(key) or {}) for key in ("collision", "self_collision"))
    name = document.require(collision, "geometry")
    if own.get("geometry", name) != name:
        raise InputError(f"must be that of collision, {name!r}, got {own['geometry']!r}", "self_collision.geometry")
    geometry = document.mapping("geometry", document.require(data, "geometry")).get(name)
    spheres = document.by_name("spheres", document.mapping(name, geometry).get("spheres"), document.sequence)
    moving = document.require(document.mapping("cspace", document.require(data, "cspace")), "joint_names")
    resting = data.get("default_joint_positions") or {}
    locked = {name: resting.get(name, 0.0) for name in list(model.names)[1:] if name not in moving}
    given = {"locked": locked, **({"tip": data["tool_frames"][0]} if data.get("tool_frames") else {})}
    grown, extra = (dict(each.get("buffer_distance") or {}) for each in (collision, own))
    return spheres, grown, extra, own.get("ignore") or {}, given
