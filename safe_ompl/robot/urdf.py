"""Reading URDF files. Shapes and joints are checked before Pinocchio's parser reads them; errors name the file.

The parser accepts negative radii, zero sizes and zero axes. If it cannot read one element of a link, it silently drops
all shapes of the link, and proofs would not cover these shapes.
"""

from __future__ import annotations

import logging
import math
import os
import re
import xml.etree.ElementTree as ElementTree
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from copy import deepcopy
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple, TypeAlias
from xml.parsers import expat

import coal
import pinocchio as pin

from safe_ompl.common import InputError, UnknownNameError, documents as document, warn_once, within
from safe_ompl.geometry import LONGEST, check_mesh
from safe_ompl.robot.joints import Mimic

_log = logging.getLogger(__name__)

_EXPRESSION = re.compile(r"\$[{(][^})]*[})]")
# The attributes of each shape, with the number of positive values of each.
_SIZES = {"box": {"size": 3}, "sphere": {"radius": 1}, "cylinder": {"radius": 1, "length": 1}}
_MESH = "mesh"
_MOVING = ("revolute", "continuous", "prismatic", "planar")
_KINDS = (*_MOVING, "fixed", "floating")
_LIMITED = ("revolute", "prismatic")
# The attributes of a joint's tags that are numbers.
_JOINT_NUMBERS = {
    "limit": ("lower", "upper", "effort", "velocity"),
    "dynamics": ("damping", "friction"),
    "mimic": ("multiplier", "offset"),
    "calibration": ("rising", "falling"),
    "safety_controller": ("soft_lower_limit", "soft_upper_limit", "k_position", "k_velocity"),
}
_INERTIAL_NUMBERS = {"mass": ("value",), "inertia": ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")}
_PACKAGE = "package://"
_MANIFEST = "package.xml"


class NamedPackage(NamedTuple):
    """A package with an explicit name, independent of the names in its folder and manifest."""

    name: str
    folder: Path

    def to_mapping(self) -> dict[str, str]:
        """Return the package as an entry of `package_dirs` in a document."""
        return {self.name: document.file_name(self.folder)}


PackageDir: TypeAlias = Path | NamedPackage
"""A folder that contains packages, or one package with its name."""


def read_package_dir(key: str, value: Any) -> PackageDir:
    """Read a folder that contains packages, or a mapping of one package name to its folder."""
    if isinstance(value, NamedPackage):
        return value
    if isinstance(value, Mapping):
        if len(value) != 1:
            raise InputError(f"must map the name of one package to its folder, got {len(value)} names", key)
        ((name, value),) = document.mapping(key, value).items()
        return NamedPackage(document.text(key, name), read_path(f"{key}.{name}", value))
    return read_path(key, value)


def read_path(key: str, value: Any) -> Path:
    """Return a path as an absolute path; relative paths are relative to the folder of the document being read."""
    if not isinstance(value, (str, Path)):
        raise InputError(f"must be a file name, got {document.described(value)}", key)
    return (document.folder_of_document() / value).resolve()


class PackageFolders:
    """Finds the files that a URDF names: beside the URDF, in given folders, and in packages.

    Packages given by name are searched first. Other packages are folders with a manifest: in or below the given
    folders; above the URDF, and beside these folders; in the folders of ROS_PACKAGE_PATH; and in `share` of the folders
    of AMENT_PREFIX_PATH.
    """

    def __init__(self, urdf: Path, given: Sequence[str | PackageDir]) -> None:
        self._urdf = urdf
        self._packages = [entry for entry in given if isinstance(entry, NamedPackage)]
        self._given = tuple(Path(entry).resolve() for entry in given if not isinstance(entry, NamedPackage))
        for folder in (*self._given, *(package.folder for package in self._packages)):
            if not folder.is_dir():
                raise InputError(f"package folder {str(folder)!r} does not exist", str(urdf))

    def find(self, mesh: str) -> Path | None:
        """Return the file of a mesh by its name in the URDF, or None if there is none."""
        return next((place for place in self._places_of(mesh) if place.is_file()), None)

    def _places_of(self, mesh: str) -> Iterator[Path]:
        name = re.sub("^(package|file)://", "", mesh)
        if not mesh.startswith(_PACKAGE):
            yield from (folder / name for folder in (self._urdf.parent, *self._given))
            yield from self.elsewhere(Path(name).parts[1:]) if Path(name).is_absolute() else ()
            return
        package, _, file = name.partition("/")
        yield from (known.folder / file for known in self._packages if known.name == package)
        yield from (folder / name.lstrip("/") for folder in (*self._given, *self._urdf.parents))
        if package:
            yield from (folder / file for folder in self.named(package))
        else:
            # The name is an absolute path, or a path relative to one of the folders.
            yield Path(name)

    def elsewhere(self, steps: Sequence[str]) -> Iterator[Path]:
        """Yield candidate locations of a file whose absolute path xacro wrote on another machine for `$(find PKG)`.

        One of the folders of the path, `steps`, may be a package, or may be in one of the given folders.
        """
        for k, step in enumerate(steps[:-1]):
            yield from (folder.joinpath(*steps[k:]) for folder in self._given)
            yield from (folder.joinpath(*steps[k + 1 :]) for folder in self.named(step))

    def named(self, package: str) -> list[Path]:
        """Return the folders of the package with this name, in the order of the search."""
        given = [known.folder for known in self._packages if known.name == package]
        return given + self._by_name.get(package, [])

    @cached_property
    def _by_name(self) -> dict[str, list[Path]]:
        found: dict[str, list[Path]] = {}
        for folder in dict.fromkeys(self._places()):
            with suppress(ElementTree.ParseError, OSError):
                # A folder without a manifest, or with a broken manifest, is skipped.
                name = parsed(folder / _MANIFEST).findtext("name", "").strip()
                found.setdefault(name, []).append(folder)
        return found

    def _places(self) -> Iterator[Path]:
        for folder in self._given:
            yield from _two_levels(folder)
        for above in self._urdf.parents:
            yield above
            yield from _folders_in(above)
        for folder in (*_variable("ROS_PACKAGE_PATH"), *(p / "share" for p in _variable("AMENT_PREFIX_PATH"))):
            yield from _two_levels(folder)


def _variable(name: str) -> list[Path]:
    return [Path(folder) for folder in os.environ.get(name, "").split(os.pathsep) if folder]


def _two_levels(root: Path) -> Iterator[Path]:
    yield root
    for folder in _folders_in(root):
        yield folder
        yield from _folders_in(folder)


def _folders_in(folder: Path) -> list[Path]:
    try:
        with os.scandir(folder) as entries:
            return sorted(Path(entry.path) for entry in entries if entry.is_dir())
    except OSError:
        # A folder without read permission is treated as empty.
        return []


def parsed(path: Path) -> ElementTree.Element:
    """Return the root element of a URDF without resolving name spaces. Raises ParseError if the file is not XML.

    Many URDFs do not declare name spaces such as `drake:`, and ElementTree's own parser refuses these files.
    """
    tree, parser = ElementTree.TreeBuilder(), expat.ParserCreate()
    parser.StartElementHandler, parser.EndElementHandler = tree.start, tree.end
    parser.CharacterDataHandler = tree.data
    try:
        parser.Parse(path.read_bytes(), True)
    except expat.ExpatError as error:
        raise ElementTree.ParseError(str(error)) from None
    return tree.close()


def _xacro_evidence(root: ElementTree.Element, kind: str) -> str | None:
    """Return a xacro tag or expression in a file, or None. In a URDF, expressions count only in links and joints."""
    for element in root.iter():
        if element.tag.startswith("xacro:"):
            return f"<{element.tag}>"
    for part in (part for part in root if kind != "URDF" or part.tag in ("link", "joint")):
        for text in (text for element in part.iter() for text in element.attrib.values()):
            expression = _EXPRESSION.search(text)
            if expression is not None:
                return expression.group()
    return None


def _expanded(path: Path, packages: PackageFolders, arguments: Mapping[str, str]) -> ElementTree.Element:
    """Expand a file with xacro and return the root element; `packages` resolve `$(find …)`."""
    import xacro
    from xacro import substitution_args

    def find(package: str) -> str:
        folder = next(iter(packages.named(package)), None)
        if folder is None:
            raise InputError(f"package {package!r} not found; give the folder above it as a package dir")
        return str(folder)

    # Without this replacement, xacro would need ROS for `$(find …)`.
    finds, substitution_args._eval_find = substitution_args._eval_find, find
    try:
        return ElementTree.fromstring(xacro.process_file(str(path), mappings=dict(arguments)).toxml())
    except Exception as error:
        # Files contain Python expressions, which may raise any exception.
        raise InputError(f"xacro cannot expand it ({_reason(error)})", str(path)) from None
    finally:
        substitution_args._eval_find = finds


def _reason(error: BaseException) -> str:
    """Return the message of a xacro error, without the class name of an error that it wraps."""
    about = getattr(error, "exc", None)
    if about is None:
        return " ".join(str(error).split())
    own = "" if str(error).startswith("<class") else str(error.args[0] or "")
    return " ".join(f"{own} {_reason(about)} {getattr(error, 'suffix', None) or ''}".split())


def read_xml(
    path: Path, source: str, packages: PackageFolders, arguments: Mapping[str, str] | None, kind: str
) -> tuple[ElementTree.Element, bool]:
    """Return the root element of a URDF or SRDF, and whether xacro has expanded it."""
    try:
        root = parsed(path)
    except ElementTree.ParseError as error:
        raise InputError(f"not a valid {kind}: it is not well-formed XML ({error})", source) from None
    evidence, expanded = _xacro_evidence(root, kind), False
    if evidence is not None and arguments is not None:
        with suppress(ModuleNotFoundError):
            root, expanded = _expanded(path, packages, arguments), True
    if evidence is not None and not expanded:
        raise InputError(
            f"a xacro file, not yet a {kind} (it holds {evidence}); with `pip install xacro` it is expanded", source
        )
    if root.tag != "robot":
        raise InputError(f"not a {kind}: the outermost tag is <{root.tag}>, not <robot>", source)
    return root, expanded


def _check_joints(root: ElementTree.Element, source: str) -> None:
    """Raise InputError if a joint has an unknown type, lacks required limits, or has malformed numbers."""
    for joint in root.findall("joint"):
        where, kind = f"joint {joint.get('name')!r}", joint.get("type", "")
        if kind not in _KINDS:
            raise UnknownNameError(f"type of {where}", kind, _KINDS, source)
        _check_origin(joint, where, source)
        axis = joint.find("axis")
        if axis is not None and kind in _MOVING:
            values = _finite_numbers(axis, "xyz", 3, f"{where}: axis", source, default="1 0 0")
            if not any(values):
                raise InputError(f"{where}: its axis is {axis.get('xyz')!r}; it must have a direction", source)
        _check_numbers(joint, _JOINT_NUMBERS, where, source)
        limit = joint.find("limit")
        if limit is None and kind in _LIMITED:
            needed = '<limit lower="…" upper="…" effort="…" velocity="…"/>'
            raise InputError(f"{where}: it has no <limit>, and a {kind} joint needs one: {needed}", source)
        for attribute in ("effort", "velocity"):
            if limit is not None and float(limit.get(attribute, "0")) < 0:
                given = limit.get(attribute)
                raise InputError(f"{where}: limit: {attribute}={given!r} must be a number >= 0", source)


def _apply_soft_limits(root: ElementTree.Element, source: str) -> None:
    """Narrow the joint limits to the soft limits of the safety controllers, as MoveIt does.

    The controllers slow a joint down beyond its soft limits, so plans beyond them are not followed. MoveIt reads
    missing attributes as zero, which leaves no range if both are missing. Here a tag without soft limits, which only
    has gains, does not change the range.
    """
    for joint in root.findall("joint"):
        limit, safety = joint.find("limit"), joint.find("safety_controller")
        if limit is None or safety is None or joint.get("type") not in _LIMITED:
            continue
        soft = [float(safety.get(f"soft_{side}_limit", "0")) for side in ("lower", "upper")]
        hard = [float(limit.get(side, "0")) for side in ("lower", "upper")]
        if soft[0] == soft[1] == 0.0:
            continue
        low, high = max(soft[0], hard[0]), min(soft[1], hard[1])
        if low > high:
            raise InputError(
                f"joint {joint.get('name')!r}: safety_controller: its soft limits [{soft[0]:g}, {soft[1]:g}] must "
                f"overlap its limits [{hard[0]:g}, {hard[1]:g}]",
                source,
            )
        if [low, high] != hard:
            limit.set("lower", repr(low))
            limit.set("upper", repr(high))


def _check_inertials(root: ElementTree.Element, source: str) -> None:
    for link in root.findall("link"):
        for inertial in link.findall("inertial"):
            where = f"link {link.get('name')!r}: inertial"
            _check_origin(inertial, where, source)
            _check_numbers(inertial, _INERTIAL_NUMBERS, where, source)


def _check_numbers(element: ElementTree.Element, numbers: Mapping[str, Sequence[str]], where: str, source: str) -> None:
    """Raise InputError if an attribute of a tag in `element` is not a number, such as "-1,5". Infinity is accepted."""
    for child in element:
        for attribute in numbers.get(child.tag, ()):
            text = child.get(attribute, "0")
            try:
                if not math.isnan(float(text)):
                    continue
            except ValueError:
                pass
            raise InputError(f"{where}: {child.tag}: {attribute}={text!r} must be a number", source)


def _drop_empty_shapes(root: ElementTree.Element, source: str) -> None:
    """Drop shapes of size zero, which some exporters write for links without shapes, and warn once."""
    links = set()
    for link in root.findall("link"):
        for element in (*link.findall("collision"), *link.findall("visual")):
            if any(map(_is_empty, element.findall("geometry/*"))):
                link.remove(element)
                links.add(link.get("name", ""))
    if links:
        warn_once(_log, f"{source}: shapes of size zero are taken for none, those of {', '.join(sorted(links))}")


def _is_empty(shape: ElementTree.Element) -> bool:
    """Return whether all sizes of a shape are given and zero."""
    words = [word for name in _SIZES.get(shape.tag, ()) for word in shape.get(name, "").split()]
    try:
        return bool(words) and not any(map(float, words))
    except ValueError:
        return False


def _check_shape(element: ElementTree.Element, where: str, source: str) -> None:
    """Raise InputError if a shape is missing or unknown, has an impossible size, or an origin that is not finite."""
    _check_origin(element, where, source)
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
        values = _finite_numbers(shape, attribute, count, f"{where}: {shape.tag}", source, most=LONGEST)
        if min(values) <= 0:
            given = shape.get(attribute)
            raise InputError(f"{where}: the {attribute} of its {shape.tag} is {given!r}; it must be > 0", source)


def _check_origin(element: ElementTree.Element, where: str, source: str) -> None:
    origin = element.find("origin")
    if origin is not None:
        for attribute, most in (("xyz", LONGEST), ("rpy", math.inf)):
            _finite_numbers(origin, attribute, 3, f"{where}: origin", source, default="0 0 0", most=most)


def _finite_numbers(
    element: ElementTree.Element,
    attribute: str,
    count: int,
    where: str,
    source: str,
    default: str = "",
    most: float = math.inf,
) -> list[float]:
    text = element.get(attribute, default)
    try:
        values = [float(word) for word in text.split()]
    except ValueError:
        values = []
    if len(values) != count or not all(map(math.isfinite, values)):
        needed = f"{count} finite numbers" if count > 1 else "a finite number"
        raise InputError(f"{where}: {attribute}={text!r} must be {needed}", source)
    if max(map(abs, values)) > most:
        raise InputError(f"{where}: {attribute}={text!r} must be at most {most:g} m", source)
    return values


def _check_complete(
    model: pin.Model, geometry: pin.GeometryModel, root: ElementTree.Element, tag: str, source: str
) -> None:
    """Raise InputError, which names the link, if the parser has dropped a shape of a link."""
    built = [model.frames[part.parentFrame].name for part in geometry.geometryObjects]
    for link in root.findall("link"):
        name, wanted = link.get("name", ""), len(link.findall(tag))
        if built.count(name) != wanted:
            raise InputError(
                f"link {name!r}: {wanted} {tag} shapes are in the file, {built.count(name)} could be read; "
                "the parser drops those of a link of which it cannot read every element",
                source,
            )


class UrdfFile:
    """A URDF file with its package folders. The folders above the URDF are searched, too, for `package://` names.

    A file with xacro is expanded with `xacro_args`. None refuses xacro, because xacro evaluates Python expressions,
    which are a risk in files from others. Raises InputError for a malformed file, and for arguments without xacro in
    the file unless it `may_be_plain` (the arguments may be meant for an SRDF).
    """

    def __init__(
        self,
        path: str | Path,
        package_dirs: Sequence[str | PackageDir] = (),
        xacro_args: Mapping[str, str] | None = None,
        *,
        may_be_plain: bool = False,
    ) -> None:
        self.path = existing_file(path, "URDF")
        self._packages = PackageFolders(self.path, package_dirs)
        self._root, expanded = read_xml(self.path, str(path), self._packages, xacro_args, "URDF")
        if xacro_args and not (expanded or may_be_plain):
            raise InputError(f"holds no xacro that could take the arguments {', '.join(xacro_args)}", str(path))
        if self._root.find("link") is None:
            raise InputError("not a valid URDF: it has no link", str(path))
        # The parser refuses a robot without a name.
        if not self._root.get("name"):
            self._root.set("name", self.path.stem)
        _check_joints(self._root, str(path))
        _check_inertials(self._root, str(path))
        _drop_empty_shapes(self._root, str(path))

    def build_model(self) -> pin.Model:
        """Build the kinematic model with all joints free."""
        try:
            return pin.buildModelFromXML(ElementTree.tostring(self._readable_root(), encoding="unicode"))
        except (ValueError, RuntimeError) as error:
            raise InputError(f"not a valid URDF ({_first_line(error)})", str(self.path)) from None

    def build_geometry(self, model: pin.Model, kind: pin.GeometryType) -> pin.GeometryModel:
        """Build the collision or visual geometry of `model`. Its meshes are not yet convex."""
        tag = "collision" if kind == pin.GeometryType.COLLISION else "visual"
        source = str(self.path)
        for link in self._root.findall("link"):
            for number, element in enumerate(link.findall(tag)):
                _check_shape(element, f"link {link.get('name')!r}, {tag} {number}", source)
        text = self._text_with_meshes(tag)
        # Trees of this type are fast to build.
        loader = coal.MeshLoader(coal.BV_OBB)
        try:
            geometry = pin.buildGeomFromUrdfString(model, text, kind, package_dirs=[], mesh_loader=loader)
        except (ValueError, RuntimeError) as error:
            reason = str(error).partition("message: ")[2].partition("Hint:")[0] or _first_line(error)
            raise InputError(f"cannot read a mesh ({' '.join(reason.split())})", source) from None
        _check_complete(model, geometry, self._root, tag, source)
        return geometry

    def mesh_files(self, tag: str) -> dict[str, Path]:
        """Return the files of the "collision" or "visual" meshes by their names in the URDF, or raise InputError."""
        found = {}
        for link in self._root.iterfind("link"):
            for mesh in link.iterfind(f"{tag}/geometry/mesh"):
                name = mesh.get("filename", "")
                file = self._packages.find(name)
                if file is None:
                    raise InputError(
                        f"link {link.get('name')!r}: {tag} mesh {name!r} not found; "
                        "give the folder above its package as a package dir, or the package by its name",
                        str(self.path),
                    )
                found[name] = file
        return found

    def text(self, meshes: Mapping[str, str] | None = None) -> str:
        """Return the text of the expanded URDF, with the file names of `meshes` replaced."""
        root = deepcopy(self._root)
        for mesh in root.iterfind("link/*/geometry/mesh"):
            name = mesh.get("filename", "")
            if meshes and name in meshes:
                mesh.set("filename", meshes[name])
        return ElementTree.tostring(root, encoding="unicode")

    def links_with(self, tag: str) -> frozenset[str]:
        """Return the links that have "collision" or "visual" shapes."""
        links = self._root.findall("link")
        return frozenset(link.get("name", "") for link in links if link.find(tag) is not None)

    def mimics(self) -> Mapping[str, Mimic]:
        """Return the mimic joints by name."""
        tags = ((joint.get("name", ""), joint.find("mimic")) for joint in self._root.iter("joint"))
        return {
            name: Mimic(tag.get("joint", ""), float(tag.get("multiplier", 1.0)), float(tag.get("offset", 0.0)))
            for name, tag in tags
            if tag is not None
        }

    def _text_with_meshes(self, tag: str) -> str:
        """Return the URDF as text for the parser, with paths of meshes and scales to metres.

        As in RViz, MoveIt and Gazebo, the unit of a mesh file is used, and its upward axis is ignored: the axes of a
        mesh are those of its link. Only then do the collision and visual meshes of TIAGo match.
        """
        root, files = self._readable_root(), self.mesh_files(tag)
        frames, turned = {}, []
        for link in root.findall("link"):
            for mesh in link.iterfind(f"{tag}/geometry/mesh"):
                file = files[mesh.get("filename", "")]
                if file not in frames:
                    with within(f"{self.path}: link {link.get('name')!r}: {tag} mesh", " "):
                        frames[file] = check_mesh(file)
                    turned += [] if frames[file].up == "Z_UP" else [file.name]
                mesh.set("filename", str(file))
                if frames[file].unit != 1.0:
                    scale = (frames[file].unit * float(word) for word in mesh.get("scale", "1 1 1").split())
                    mesh.set("scale", " ".join(map(repr, scale)))
        if turned:
            what = f"{len(turned)} {tag} meshes are in the axes of their links, as in RViz, though their files say "
            message = f"{self._root.get('name')}: {what}that another axis than z is up"
            if tag == "collision":
                warn_once(_log, message)
            _log.info("%s: %s", message, ", ".join(turned))
        return ElementTree.tostring(root, encoding="unicode")

    def _readable_root(self) -> ElementTree.Element:
        """Return a copy of the URDF with soft limits applied, without inertials that make the parser drop shapes."""
        root = deepcopy(self._root)
        _apply_soft_limits(root, str(self.path))
        for link in root.findall("link"):
            for inertial in link.findall("inertial"):
                if inertial.find("mass") is None or inertial.find("inertia") is None:
                    link.remove(inertial)
        return root


def existing_file(path: str | Path, kind: str) -> Path:
    """Return the absolute path of an existing file, or raise InputError."""
    file = Path(path)
    if not file.is_file():
        raise InputError(f"{kind} file {str(path)!r} does not exist")
    return file.resolve()


def _first_line(error: Exception) -> str:
    return (str(error).strip() or type(error).__name__).splitlines()[0]
