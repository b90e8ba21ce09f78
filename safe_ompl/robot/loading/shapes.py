"""Which shapes of a robot collide: those of the URDF, visual ones where it has none, and the links left without."""

from __future__ import annotations

import logging
from collections.abc import Iterable
from typing import Literal, get_args

import coal
import pinocchio as pin

from safe_ompl.common import InputError, UnknownNameError, warn_once
from safe_ompl.geometry import convex_hull
from safe_ompl.robot.loading.urdf import UrdfFile

_log = logging.getLogger(__name__)

_THICKNESS = 2e-4  # [m] of the hulls of flat meshes, such as stickers

CollisionSource = Literal["required", "visual", "optional"]
"""What to do about links without collision shapes.

"required": a robot none of whose moving links has one is refused; "visual": the visual shapes of such links collide;
"optional": a robot without any is accepted, and touches nothing.
"""


def check_source(collision: str, source: str) -> None:
    """Raise UnknownNameError if `collision` is none of `CollisionSource`."""
    if collision not in get_args(CollisionSource):
        raise UnknownNameError("choice of collision shapes", collision, get_args(CollisionSource), source)


def build_collision_geometry(urdf: UrdfFile, full: pin.Model, collision: str) -> pin.GeometryModel:
    """Return the collision geometry of all links; with "visual", the visual shapes of links that have no other.

    Raises
    ------
    InputError
        As `UrdfFile.build_geometry` does, or if `collision` is unknown.
    """
    check_source(collision, str(urdf.path))
    geometry = urdf.build_geometry(full, pin.GeometryType.COLLISION)
    bare = urdf.links_with_visuals_only()
    if collision != "visual" or not bare:
        return geometry
    for part in urdf.build_geometry(full, pin.GeometryType.VISUAL).geometryObjects:
        if full.frames[part.parentFrame].name in bare:
            geometry.addGeometryObject(part)
    _log.info("%s: visual shapes collide, too: those of %s", urdf.path.name, ", ".join(sorted(bare)))
    return geometry


def links_with_visuals_alone(
    urdf: UrdfFile, model: pin.Model, geometry: pin.GeometryModel, collision: str
) -> tuple[str, ...]:
    """Return the links, moving or not, that have visual shapes but no collision shapes.

    Parameters
    ----------
    urdf : UrdfFile
        What the links have.
    model, geometry : pin.Model, pin.GeometryModel
        Joints that move and bodies that collide.
    collision : str
        One of `CollisionSource`.

    Raises
    ------
    InputError
        If no moving link has a collision shape, unless that is "optional".
    """
    if collision != "optional" and not any(part.parentJoint for part in geometry.geometryObjects):
        remedy = (
            "its visual shapes are taken with" if collision == "required" else "it has no visual ones either;"
        )
        choice = (
            "collision='visual' (--collision visual)"
            if collision == "required"
            else "to plan without any, give collision='optional' (--collision optional)"
        )
        raise InputError(
            f"no moving link has a collision shape, so that nothing could ever touch: {remedy} {choice}",
            str(urdf.path),
        )
    collides = {model.frames[part.parentFrame].name for part in geometry.geometryObjects}
    bare = urdf.links_with_visuals_only() - collides
    return tuple(
        frame.name for frame in model.frames if frame.type == pin.FrameType.BODY and frame.name in bare
    )


def warn_of_unchecked(robot: str, links: Iterable[str]) -> None:
    """Say in one warning which moving links have no collision shapes, if any."""
    if names := ", ".join(links):
        warn_once(
            _log,
            f"{robot}: nothing is checked for links that have no collision shape: {names} "
            "(collision='visual' takes their visual shapes)",
        )


def make_convex(geometry: pin.GeometryModel) -> None:
    """Replace every mesh of `geometry` by its convex hull, in place; flat ones get a little thickness."""
    for part in geometry.geometryObjects:
        if isinstance(part.geometry, coal.BVHModelBase):
            part.geometry = convex_hull(part.geometry, part.name, _THICKNESS)
