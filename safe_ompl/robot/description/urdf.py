"""Reading a robot's URDF: the parts that Pinocchio passes over in silence, and errors that name the file."""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from collections.abc import Mapping, Sequence
from copy import deepcopy
from functools import cached_property
from pathlib import Path

import pinocchio as pin

from safe_ompl.errors import InputError
from safe_ompl.robot.description import geometry_check
from safe_ompl.robot.description.packages import PackageFolders
from safe_ompl.robot.description.xacro import check_expanded, parsed, unreadable
from safe_ompl.robot.joints.coupling import Mimic

_PACKAGE = "package://"


class UrdfFile:
    """A URDF file with its package folders.

    Parameters
    ----------
    path : path-like
        The URDF.
    package_dirs : sequence of path-like
        Folders that hold the packages of `package://` names. The folders above the URDF are searched too.

    Raises
    ------
    InputError
        If the file is missing or is not a URDF, a package folder does not exist, or a joint has no direction.
    """

    def __init__(self, path: str | Path, package_dirs: Sequence[str | Path] = ()) -> None:
        self.path = existing_file(path, "URDF")
        given = [Path(folder) for folder in package_dirs]
        for folder in given:
            if not folder.is_dir():
                raise InputError(f"package folder {str(folder)!r} does not exist", str(path))
        self.package_dirs = [str(folder.resolve()) for folder in (*given, *self.path.parents)]
        try:
            self._root = parsed(self.path)
        except ElementTree.ParseError as error:
            raise unreadable(self.path, str(path), error) from None
        if self._root.tag != "robot":
            raise InputError(f"not a URDF: the outermost tag is <{self._root.tag}>, not <robot>", str(path))
        check_expanded(self._root, self.path, str(path))
        if self._root.find("link") is None:
            raise InputError("not a valid URDF: it has no link", str(path))
        if not self._root.get("name"):  # the parser refuses a robot without one
            self._root.set("name", self.path.stem)
        geometry_check.check_joints(self._root, str(path))
        self._given = [folder.resolve() for folder in given]
        self._packages = PackageFolders(self.path, self._given)

    def build_model(self) -> pin.Model:
        """Return the kinematic model with all its joints free."""
        try:
            return pin.buildModelFromXML(self._readable_text)
        except (ValueError, RuntimeError) as error:
            raise InputError(f"not a valid URDF ({_first_line(error)})", str(self.path)) from None

    def build_geometry(self, model: pin.Model, kind: pin.GeometryType) -> pin.GeometryModel:
        """Return the collision or visual geometry of `model`.

        Raises
        ------
        InputError
            If a mesh is missing or cannot be read, a shape has an impossible size or is of an unknown kind.
        """
        tag = "collision" if kind == pin.GeometryType.COLLISION else "visual"
        source = str(self.path)
        geometry_check.check_shapes(self._root, tag, source)
        self.mesh_files(tag)
        try:
            geometry = pin.buildGeomFromUrdfString(
                model, self._readable_text, kind, package_dirs=self.package_dirs
            )
        except (ValueError, RuntimeError) as error:
            reason = str(error).partition("message: ")[2].partition("Hint:")[0] or _first_line(error)
            raise InputError(f"cannot read a mesh ({' '.join(reason.split())})", source) from None
        geometry_check.restore_capsules(geometry, self._root, tag)
        geometry_check.check_complete(model, geometry, self._root, tag, source)
        return geometry

    def mesh_files(self, tag: str) -> dict[str, Path]:
        """Return the files of the "collision" or "visual" meshes, by the names that the URDF has for them.

        Raises
        ------
        InputError
            If one is not found.
        """
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

    def renamed(self, meshes: Mapping[str, str]) -> str:
        """Return the text of the URDF with other names for some of its meshes."""
        return _text(self._root, meshes)

    def links_with_visuals_only(self) -> frozenset[str]:
        """Return the links that have visual shapes but no collision shapes."""
        return frozenset(
            link.get("name", "")
            for link in self._root.findall("link")
            if link.find("visual") is not None and link.find("collision") is None
        )

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
            places = [folder / name for folder in (self.path.parent, *self._given)]
        else:
            name = mesh.removeprefix(_PACKAGE)
            places = [Path(folder) / name.lstrip("/") for folder in self.package_dirs]
            if name.startswith("/"):  # no package: below one of the folders, or a path
                places.append(Path(name))
        file = next((place for place in places if place.is_file()), None)
        return self._packages.resolve(mesh) if file is None and mesh.startswith(_PACKAGE) else file

    @cached_property
    def _readable_text(self) -> str:
        """The URDF as the parser can read it: capsules in its terms, and meshes by the paths of their files.

        It is made from what was read at first: whatever is built from it is of one state of the file.
        """
        root = deepcopy(self._root)
        geometry_check.make_readable(root)
        names = {mesh.get("filename", "") for mesh in root.iterfind("link/*/geometry/mesh")}
        files = {name: file for name in names if (file := self._found(name)) is not None}
        return _text(root, {name: str(file) for name, file in files.items()})


def _text(root: ElementTree.Element, meshes: Mapping[str, str]) -> str:
    root = deepcopy(root)
    for mesh in root.iterfind("link/*/geometry/mesh"):
        name = mesh.get("filename", "")
        mesh.set("filename", meshes.get(name, name))
    return ElementTree.tostring(root, encoding="unicode")


def existing_file(path: str | Path, kind: str) -> Path:
    """Return `path`, made absolute, or raise InputError if there is no such file."""
    file = Path(path)
    if not file.is_file():
        raise InputError(f"{kind} file {str(path)!r} does not exist")
    return file.resolve()


def _first_line(error: Exception) -> str:
    return (str(error).strip() or type(error).__name__).splitlines()[0]
