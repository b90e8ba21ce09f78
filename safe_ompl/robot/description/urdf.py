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
        geometry_check.check_joints(self._root, str(path))
        self._packages = PackageFolders(self.path, given)

    def build_model(self) -> pin.Model:
        """Return the kinematic model with all its joints free."""
        text = self._readable_text
        try:
            return pin.buildModelFromUrdf(str(self.path)) if text is None else pin.buildModelFromXML(text)
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
        self._check_meshes(tag)
        text = self._readable_text
        try:
            if text is None:
                geometry = pin.buildGeomFromUrdf(model, source, kind, package_dirs=self.package_dirs)
            else:
                geometry = pin.buildGeomFromUrdfString(model, text, kind, package_dirs=self.package_dirs)
        except (ValueError, RuntimeError) as error:
            raise InputError(f"cannot read a mesh ({_first_line(error)})", source) from None
        geometry_check.restore_capsules(geometry, self._root, tag)
        geometry_check.check_complete(model, geometry, self._root, tag, source)
        return geometry

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

    def _check_meshes(self, tag: str) -> None:
        for link in self._root.iter("link"):
            for mesh in (mesh for part in link.iter(tag) for mesh in part.iter("mesh")):
                name = mesh.get("filename", "")
                if not any(place.is_file() for place in self._places(name)):
                    raise InputError(
                        f"link {link.get('name')!r}: {tag} mesh {name!r} not found; "
                        "give the folder above its package as a package dir",
                        str(self.path),
                    )

    def _places(self, mesh: str) -> list[Path]:
        if mesh.startswith(_PACKAGE):
            name = mesh[len(_PACKAGE) :]
            beside = [Path(folder) / name.lstrip("/") for folder in self.package_dirs]
            if name.startswith("/"):  # no package: a path, or below one of the folders
                found = [place for place in (*beside, Path(name)) if place.is_file()]
                return found[:1] or beside
            named = self._packages.resolve(mesh) if not any(place.is_file() for place in beside) else None
            return beside if named is None else [named]
        return [self.path.parent / mesh.removeprefix("file://")]

    @cached_property
    def _readable_text(self) -> str | None:
        """Return the URDF as the parser can read it: capsules and packages of other names put in its terms.

        None if the file itself is readable.
        """
        meshes = [mesh.get("filename", "") for mesh in self._root.iterfind("link/*/geometry/mesh")]
        moved = {mesh: places[0] for mesh in set(meshes) if len(places := self._places(mesh)) == 1}
        moved = {mesh: place for mesh, place in moved.items() if mesh.startswith(_PACKAGE)}
        if not moved and geometry_check.is_readable(self._root):
            return None
        root = deepcopy(self._root)
        geometry_check.make_readable(root)
        for mesh in root.iterfind("link/*/geometry/mesh"):
            name = mesh.get("filename", "")
            mesh.set("filename", str(moved.get(name, name)))
        return ElementTree.tostring(root, encoding="unicode")


def existing_file(path: str | Path, kind: str) -> Path:
    """Return `path`, made absolute, or raise InputError if there is no such file."""
    file = Path(path)
    if not file.is_file():
        raise InputError(f"{kind} file {str(path)!r} does not exist")
    return file.resolve()


def _first_line(error: Exception) -> str:
    return (str(error).strip() or type(error).__name__).splitlines()[0]
