"""Reading a URDF: shapes and joints are checked before the parser sees them, and errors name the file.

The parser takes negative radii, zero sizes and zero axes as they come, and where it cannot read one element of a link
it drops all shapes of the link: what it leaves out would be "proven free".
"""

from __future__ import annotations

import math
import os
import re
import xml.etree.ElementTree as ElementTree
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from functools import cached_property
from pathlib import Path

import coal
import pinocchio as pin

from safe_ompl.common import InputError
from safe_ompl.robot.joint_tables import Mimic
from safe_ompl.robot.loading.packages import PackageFolders

_XACRO_TAG = re.compile(r"\{[^}]*xacro[^}]*\}")
_PREFIX = re.compile(r"[\s<]([A-Za-z_][\w.-]*):[A-Za-z_]")
_EXPRESSION = re.compile(r"\$[{(][^})]*[})]")
_SIZES = {  # attributes of each shape, and how many positive numbers they hold
    "box": {"size": 3},
    "sphere": {"radius": 1},
    "cylinder": {"radius": 1, "length": 1},
    "capsule": {"radius": 1, "length": 1},
}
_MESH = "mesh"
_MOVING = ("revolute", "continuous", "prismatic", "planar")
_PACKAGE = "package://"


def parsed(path: Path) -> ElementTree.Element:
    """Return the outermost tag of a URDF, whose name spaces need not be declared: many leave out `drake:`.

    Raises ParseError if it is not XML, or uses xacro's name space, which says that it is not a URDF yet.
    """
    try:
        return ElementTree.parse(path).getroot()
    except ElementTree.ParseError as error:
        text = path.read_text(encoding="utf-8", errors="replace")
        if "unbound prefix" not in str(error) or "<xacro:" in text:
            raise
    unknown = {prefix for prefix in _PREFIX.findall(text) if not f"{prefix}:".startswith(("xml:", "xmlns:"))}
    unknown = {prefix for prefix in unknown if f"xmlns:{prefix}=" not in text}
    declared = " ".join(f'xmlns:{prefix}="{prefix}"' for prefix in sorted(unknown))
    return ElementTree.fromstring(re.sub(r"<robot\b", f"<robot {declared}", text, count=1).encode())


def xacro_evidence(root: ElementTree.Element) -> str | None:
    """Return one of xacro's tags that `root` holds, or an expression in what describes links and joints; or None.

    A declared name space alone says nothing: xacro leaves it in what it writes.
    """
    for element in root.iter():
        if isinstance(element.tag, str) and _XACRO_TAG.match(element.tag):
            return f"<xacro:{element.tag.partition('}')[2]}>"
    for part in (part for part in root if part.tag in ("link", "joint")):
        for text in (text for element in part.iter() for text in element.attrib.values()):
            expression = _EXPRESSION.search(text)
            if expression is not None:
                return expression.group()
    return None


def _expanded(path: Path, packages: PackageFolders, arguments: Mapping[str, str]) -> ElementTree.Element:
    """Return the outermost tag of the URDF that xacro makes of a file; `packages` are those that `$(find …)` names.

    Raises ModuleNotFoundError where the package xacro is not installed, and InputError if xacro fails.
    """
    import xacro
    from xacro import substitution_args

    def find(package: str) -> str:
        folder = next(packages.named(package), None)
        if folder is None:
            raise InputError(f"package {package!r} not found; give the folder above it as a package dir")
        return str(folder)

    finds, substitution_args._eval_find = substitution_args._eval_find, find  # else it needs ROS
    try:
        return ElementTree.fromstring(xacro.process_file(str(path), mappings=dict(arguments)).toxml())
    except Exception as error:  # of any kind: files hold expressions of Python
        raise InputError(f"xacro cannot expand it ({' '.join(str(error).split())})", str(path)) from None
    finally:
        substitution_args._eval_find = finds


def _read(
    path: Path, source: str, packages: PackageFolders, arguments: Mapping[str, str] | None
) -> tuple[ElementTree.Element, bool]:
    """Return the outermost tag of a URDF, and whether xacro has expanded it."""
    try:
        root = parsed(path)
        evidence = xacro_evidence(root)
    except ElementTree.ParseError as error:
        text = path.read_text(encoding="utf-8", errors="replace")
        if "unbound prefix" not in str(error) or "<xacro:" not in text:
            raise InputError(f"not well-formed XML ({error})", source) from None
        evidence = "xacro's tags"
    if evidence is None:
        if arguments:
            raise InputError(f"holds no xacro that could take the arguments {', '.join(arguments)}", source)
        return root, False
    if arguments is not None:
        with suppress(ModuleNotFoundError):
            return _expanded(path, packages, arguments), True
    raise InputError(
        f"a xacro file, not yet a URDF (it holds {evidence}); `pip install xacro`, and it is expanded", source
    )


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
    """Check every "collision" or "visual" shape of the links of a robot.

    Raises InputError, which names link, element and value, if a shape is missing, of an unknown kind, has a size that
    is not positive and finite, or an origin that is not finite.
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
            raise InputError(f"{where}: the {attribute} of its {shape.tag} is {given!r}; it must be > 0", source)


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


def make_readable(root: ElementTree.Element) -> None:
    """Put `root`, in place, in terms that the parser reads, for otherwise it drops all shapes of the link.

    Capsules become cylinders of the same radius and length (see `restore_capsules`); incomplete inertials, which say
    nothing about where a body is, go.
    """
    for shape in root.iterfind("link/*/geometry/capsule"):
        shape.tag = "cylinder"
    for link in root.findall("link"):
        for inertial in link.findall("inertial"):
            if inertial.find("mass") is None or inertial.find("inertia") is None:
                link.remove(inertial)


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


class UrdfFile:
    """A URDF file with its package folders; those above the URDF are searched too for `package://` names.

    A file that holds xacro is expanded with `xacro_args`; None refuses it: xacro evaluates expressions of Python, which
    files that others made should not hold.

    Raises InputError if the file is missing or is not a URDF, a package folder does not exist, or a joint has no
    direction.
    """

    def __init__(
        self, path: str | Path, package_dirs: Sequence[str | Path] = (), xacro_args: Mapping[str, str] | None = None
    ) -> None:
        self.path = existing_file(path, "URDF")
        given = [Path(folder) for folder in package_dirs]
        for folder in given:
            if not folder.is_dir():
                raise InputError(f"package folder {str(folder)!r} does not exist", str(path))
        self.package_dirs = [str(folder.resolve()) for folder in (*given, *self.path.parents)]
        self._given = [folder.resolve() for folder in given]
        self._packages = PackageFolders(self.path, self._given)
        self._root, self._from_xacro = _read(self.path, str(path), self._packages, xacro_args)
        if self._root.tag != "robot":
            raise InputError(f"not a URDF: the outermost tag is <{self._root.tag}>, not <robot>", str(path))
        if self._root.find("link") is None:
            raise InputError("not a valid URDF: it has no link", str(path))
        if not self._root.get("name"):  # the parser refuses a robot without one
            self._root.set("name", self.path.stem)
        check_joints(self._root, str(path))

    def build_model(self) -> pin.Model:
        """Return the kinematic model with all its joints free."""
        try:
            return pin.buildModelFromXML(self._readable_text)
        except (ValueError, RuntimeError) as error:
            raise InputError(f"not a valid URDF ({_first_line(error)})", str(self.path)) from None

    def build_geometry(self, model: pin.Model, kind: pin.GeometryType, *, queried: bool = True) -> pin.GeometryModel:
        """Return the collision or visual geometry of `model`; the trees of meshes that are not `queried` are simple.

        Raises InputError if a mesh is missing or cannot be read, a shape has an impossible size or is of an unknown
        kind.
        """
        tag = "collision" if kind == pin.GeometryType.COLLISION else "visual"
        source = str(self.path)
        check_shapes(self._root, tag, source)
        self.mesh_files(tag)
        loader = coal.MeshLoader(coal.BV_OBBRSS if queried else coal.BV_OBB)  # faster to build
        try:
            geometry = pin.buildGeomFromUrdfString(
                model, self._readable_text, kind, package_dirs=self.package_dirs, mesh_loader=loader
            )
        except (ValueError, RuntimeError) as error:
            reason = str(error).partition("message: ")[2].partition("Hint:")[0] or _first_line(error)
            raise InputError(f"cannot read a mesh ({' '.join(reason.split())})", source) from None
        restore_capsules(geometry, self._root, tag)
        check_complete(model, geometry, self._root, tag, source)
        return geometry

    def mesh_files(self, tag: str) -> dict[str, Path]:
        """Return the files of the "collision" or "visual" meshes by their names in the URDF, or raise InputError."""
        found = {}
        for link in self._root.iterfind("link"):
            for mesh in link.iterfind(f"{tag}/geometry/mesh"):
                name = mesh.get("filename", "")
                file = self._found(name)
                if file is None:
                    raise InputError(
                        f"link {link.get('name')!r}: {tag} mesh {name!r} not found; "
                        "give the folder above its package as a package dir",
                        str(self.path),
                    )
                found[name] = file
        return found

    def source(self, text: str) -> str:
        """Return the text of the URDF: that of its file, or what xacro made of it."""
        return self.renamed({}) if self._from_xacro else text

    def renamed(self, meshes: Mapping[str, str]) -> str:
        """Return the text of the URDF with other names for some of its meshes."""
        return _text(_copied(self._root), lambda name: meshes.get(name, name))

    def links_with(self, tag: str) -> frozenset[str]:
        """Return the links that have "collision" or "visual" shapes."""
        links = self._root.findall("link")
        return frozenset(link.get("name", "") for link in links if link.find(tag) is not None)

    def mimics(self) -> Mapping[str, Mimic]:
        """Return the mimic joints by name."""
        found = {}
        for joint in self._root.iter("joint"):
            tag = joint.find("mimic")
            if tag is not None:
                found[joint.get("name", "")] = Mimic(
                    tag.get("joint", ""), float(tag.get("multiplier", 1.0)), float(tag.get("offset", 0.0))
                )
        return found

    def _found(self, mesh: str) -> Path | None:
        """Return the file of a mesh: in a package, beside the URDF, or below a folder that is given."""
        if not mesh.startswith(_PACKAGE):
            name = mesh.removeprefix("file://")
            places = [os.path.join(folder, name) for folder in (self.path.parent, *self._given)]
        else:
            name = mesh.removeprefix(_PACKAGE)
            places = [os.path.join(folder, name.lstrip("/")) for folder in self.package_dirs]
            if name.startswith("/"):  # no package: below one of the folders, or a path
                places.append(name)
        file = next((Path(place) for place in places if os.path.isfile(place)), None)
        return self._packages.resolve(mesh) if file is None and mesh.startswith(_PACKAGE) else file

    @cached_property
    def _readable_text(self) -> str:
        """The URDF as the parser can read it: capsules in its terms, and meshes by the paths of their files.

        It is made from what was read at first: whatever is built from it is of one state of the file.
        """
        root = _copied(self._root)
        make_readable(root)
        return _text(root, lambda name: str(self._found(name) or name))


def _copied(root: ElementTree.Element) -> ElementTree.Element:
    return ElementTree.fromstring(ElementTree.tostring(root))  # in half the time of deepcopy


def _text(root: ElementTree.Element, place: Callable[[str], str]) -> str:
    """Return the text of a URDF after its meshes got other names."""
    for mesh in root.iterfind("link/*/geometry/mesh"):
        mesh.set("filename", place(mesh.get("filename", "")))
    return ElementTree.tostring(root, encoding="unicode")


def existing_file(path: str | Path, kind: str) -> Path:
    """Return `path`, made absolute, or raise InputError if there is no such file."""
    file = Path(path)
    if not file.is_file():
        raise InputError(f"{kind} file {str(path)!r} does not exist")
    return file.resolve()


def _first_line(error: Exception) -> str:
    return (str(error).strip() or type(error).__name__).splitlines()[0]
