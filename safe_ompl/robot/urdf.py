"""Reading a robot's URDF: the parts that Pinocchio passes over in silence, and errors that name the file."""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from collections.abc import Mapping, Sequence
from pathlib import Path

import pinocchio as pin

from safe_ompl.errors import InputError
from safe_ompl.robot.coupling import Mimic


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
        If the file is missing or is not a URDF, or a package folder does not exist.
    """

    def __init__(self, path: str | Path, package_dirs: Sequence[str | Path] = ()) -> None:
        self.path = existing_file(path, "URDF")
        given = [Path(folder) for folder in package_dirs]
        for folder in given:
            if not folder.is_dir():
                raise InputError(f"package folder {str(folder)!r} does not exist", str(path))
        self.package_dirs = [str(folder.resolve()) for folder in (*given, *self.path.parents)]
        try:
            self._root = ElementTree.parse(self.path).getroot()
        except ElementTree.ParseError as error:
            raise InputError(f"not well-formed XML ({error})", str(path)) from None
        if self._root.tag != "robot":
            raise InputError(f"not a URDF: the outermost tag is <{self._root.tag}>, not <robot>", str(path))

    def build_model(self) -> pin.Model:
        """Return the kinematic model with all its joints free."""
        try:
            return pin.buildModelFromUrdf(str(self.path))
        except (ValueError, RuntimeError) as error:
            raise InputError(f"not a valid URDF ({_first_line(error)})", str(self.path)) from None

    def build_geometry(self, model: pin.Model, kind: pin.GeometryType) -> pin.GeometryModel:
        """Return the collision or visual geometry of `model`.

        Raises
        ------
        InputError
            If a mesh is missing or cannot be read.
        """
        self._check_meshes("collision" if kind == pin.GeometryType.COLLISION else "visual")
        try:
            return pin.buildGeomFromUrdf(model, str(self.path), kind, package_dirs=self.package_dirs)
        except (ValueError, RuntimeError) as error:
            raise InputError(f"cannot read a mesh ({_first_line(error)})", str(self.path)) from None

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
        if mesh.startswith("package://"):
            return [Path(folder) / mesh[len("package://") :] for folder in self.package_dirs]
        return [self.path.parent / mesh.removeprefix("file://")]


def existing_file(path: str | Path, kind: str) -> Path:
    """Return `path`, made absolute, or raise InputError if there is no such file."""
    file = Path(path)
    if not file.is_file():
        raise InputError(f"{kind} file {str(path)!r} does not exist")
    return file.resolve()


def _first_line(error: Exception) -> str:
    return (str(error).strip() or type(error).__name__).splitlines()[0]
