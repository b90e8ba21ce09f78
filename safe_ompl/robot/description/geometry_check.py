"""Shapes and joints of a URDF, checked element by element before the parser sees them.

The parser takes negative radii, zero sizes and zero axes as they come, and where it cannot read one element of a link
it drops all shapes of the link: what it leaves out would be "proven free".
"""

from __future__ import annotations

import math
import xml.etree.ElementTree as ElementTree

import coal
import pinocchio as pin

from safe_ompl.errors import InputError

_SIZES = {  # attributes of each shape, and how many positive numbers they hold
    "box": {"size": 3},
    "sphere": {"radius": 1},
    "cylinder": {"radius": 1, "length": 1},
    "capsule": {"radius": 1, "length": 1},
}
_MESH = "mesh"
_MOVING = ("revolute", "continuous", "prismatic", "planar")


def check_joints(root: ElementTree.Element, source: str) -> None:
    """Raise InputError if a joint has an axis of length zero, or an axis or origin that is not finite."""
    for joint in root.findall("joint"):
        where = f"joint {joint.get('name')!r}"
        _check_origin(joint, where, source)
        axis = joint.find("axis")
        if axis is None or joint.get("type") not in _MOVING:
            continue
        values = _finite_numbers(axis, "xyz", 3, f"{where}: axis", source, default="1 0 0")
        if not any(values):
            raise InputError(f"{where}: its axis is {axis.get('xyz')!r}; it must have a direction", source)


def check_shapes(root: ElementTree.Element, tag: str, source: str) -> None:
    """Check every collision or visual shape of the links.

    Parameters
    ----------
    root : Element
        The `<robot>`.
    tag : str
        "collision" or "visual".
    source : str
        The URDF, for messages.

    Raises
    ------
    InputError
        If a shape is missing, of an unknown kind, has a size that is not positive and finite, or an origin that is
        not finite; the message names link, element and value.
    """
    for link in root.findall("link"):
        for number, element in enumerate(link.findall(tag)):
            where = f"link {link.get('name')!r}, {tag} {number}"
            _check_origin(element, where, source)
            _check_shape(element, where, source)


def _check_shape(element: ElementTree.Element, where: str, source: str) -> None:
    shapes = element.findall("geometry/*")
    known = (*_SIZES, _MESH)
    if len(shapes) != 1:
        raise InputError(f"{where}: it has {len(shapes)} shapes; give one of {', '.join(known)}", source)
    shape = shapes[0]
    if shape.tag not in known:
        raise InputError(f"{where}: <{shape.tag}> cannot be read; use {', '.join(known)}", source)
    if shape.tag == _MESH:
        scale = _finite_numbers(shape, "scale", 3, f"{where}: mesh", source, default="1 1 1")
        if not all(scale):
            raise InputError(f"{where}: the scale {shape.get('scale')!r} makes the mesh flat", source)
        return
    for attribute, count in _SIZES[shape.tag].items():
        values = _finite_numbers(shape, attribute, count, f"{where}: {shape.tag}", source)
        if min(values) <= 0:
            given = shape.get(attribute)
            raise InputError(
                f"{where}: the {attribute} of its {shape.tag} is {given!r}; it must be > 0", source
            )


def _check_origin(element: ElementTree.Element, where: str, source: str) -> None:
    origin = element.find("origin")
    if origin is not None:
        for attribute in ("xyz", "rpy"):
            _finite_numbers(origin, attribute, 3, f"{where}: origin", source, default="0 0 0")


def _finite_numbers(
    element: ElementTree.Element, attribute: str, count: int, where: str, source: str, default: str = ""
) -> list[float]:
    text = element.get(attribute, default)
    try:
        values = [float(word) for word in text.split()]
    except ValueError:
        values = []
    if len(values) != count or not all(map(math.isfinite, values)):
        needed = f"{count} finite numbers" if count > 1 else "a finite number"
        raise InputError(f"{where}: {attribute}={text!r} must be {needed}", source)
    return values


# ------------------------------------------------------------------------- what the parser stumbles over


def make_readable(root: ElementTree.Element) -> None:
    """Put `root`, in place, in terms that the parser reads, for otherwise it drops all shapes of the link.

    Capsules become cylinders of the same radius and length (see `restore_capsules`); incomplete inertials, which say
    nothing about where a body is, go.
    """
    for shape in root.iterfind("link/*/geometry/capsule"):
        shape.tag = "cylinder"
    for link in root.findall("link"):
        for inertial in _broken_inertials(link):
            link.remove(inertial)


def _broken_inertials(link: ElementTree.Element) -> list[ElementTree.Element]:
    return [
        element
        for element in link.findall("inertial")
        if element.find("mass") is None or element.find("inertia") is None
    ]


def restore_capsules(geometry: pin.GeometryModel, root: ElementTree.Element, tag: str) -> None:
    """Make capsules, in place, of the cylinders that stand for them; `root` is the URDF as it was."""
    parts = {part.name: part for part in geometry.geometryObjects}
    for link in root.findall("link"):
        for number, element in enumerate(link.findall(tag)):
            shape = element.find("geometry/capsule")
            if shape is not None:
                part = parts[f"{link.get('name')}_{number}"]
                part.geometry = coal.Capsule(float(shape.get("radius", "")), float(shape.get("length", "")))


def check_complete(
    model: pin.Model, geometry: pin.GeometryModel, root: ElementTree.Element, tag: str, source: str
) -> None:
    """Raise InputError if the parser has left out a shape of a link, naming the link."""
    built: dict[str, int] = {}
    for part in geometry.geometryObjects:
        link = model.frames[part.parentFrame].name
        built[link] = built.get(link, 0) + 1
    for link in root.findall("link"):
        name, wanted = link.get("name", ""), len(link.findall(tag))
        if built.get(name, 0) != wanted:
            raise InputError(
                f"link {name!r}: {wanted} {tag} shapes are in the file, {built.get(name, 0)} could be read; "
                "the parser drops those of a link of which it cannot read every element",
                source,
            )
