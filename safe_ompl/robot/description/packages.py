"""Search for the packages that a URDF names: by the name in their `package.xml`, whatever their folder is called."""

from __future__ import annotations

import os
import xml.etree.ElementTree as ElementTree
from collections.abc import Iterable, Iterator, Sequence
from functools import cached_property
from pathlib import Path

_PACKAGE = "package://"
_MANIFEST = "package.xml"


class PackageFolders:
    """The packages given, above a URDF, beside those above it, and where ROS looks for packages.

    ROS looks in the folders of the environment variables ROS_PACKAGE_PATH (ROS 1) and AMENT_PREFIX_PATH (ROS 2), in
    the latter below `share`.

    Parameters
    ----------
    urdf : Path
        The URDF.
    given : sequence of Path
        Folders that are packages, hold packages, or hold folders of packages.
    """

    def __init__(self, urdf: Path, given: Sequence[Path]) -> None:
        self._urdf, self._given = urdf, tuple(given)

    def resolve(self, name: str) -> Path | None:
        """Return the file that `package://package/file` names, or None if there is none."""
        package, _, file = name.removeprefix(_PACKAGE).partition("/")
        for folder in self._by_name.get(package, ()):
            if (folder / file).is_file():
                return folder / file
        for folder in _ros_folders():  # a workspace names the folders of packages as these
            for place in (folder / package, folder):
                if _package_name(place / _MANIFEST) == package and (place / file).is_file():
                    return place / file
        return None

    @cached_property
    def _by_name(self) -> dict[str, list[Path]]:
        found: dict[str, list[Path]] = {}
        for folder in self._candidates():
            name = _package_name(folder / _MANIFEST)
            if name is not None:
                found.setdefault(name, []).append(folder)
        return found

    def _candidates(self) -> Iterator[Path]:
        """Folders with a manifest, the nearest first; each once."""
        seen: set[Path] = set()
        for folder in self._places():
            if folder not in seen and (folder / _MANIFEST).is_file():
                seen.add(folder)
                yield folder

    def _places(self) -> Iterator[Path]:
        for given in self._given:
            yield given
            below = list(_folders_in([given]))
            yield from below
            yield from _folders_in(below)
        for above in self._urdf.parents:
            yield above
            yield from _folders_in([above])
        for folder in _variable("ROS_PACKAGE_PATH"):
            yield from _folders_in([folder, *_folders_in([folder])])


def _ros_folders() -> list[Path]:
    prefixes = _variable("AMENT_PREFIX_PATH")
    return [*_variable("ROS_PACKAGE_PATH"), *(prefix / "share" for prefix in prefixes)]


def _variable(name: str) -> list[Path]:
    return [Path(folder) for folder in os.environ.get(name, "").split(os.pathsep) if folder]


def _folders_in(folders: Iterable[Path]) -> Iterator[Path]:
    for folder in folders:
        try:
            with os.scandir(folder) as entries:
                yield from sorted(Path(entry.path) for entry in entries if entry.is_dir())
        except OSError:  # not ours to read: packages of a robot are not there
            continue


def _package_name(manifest: Path) -> str | None:
    try:
        name = ElementTree.parse(manifest).getroot().findtext("name")
    except (ElementTree.ParseError, OSError):
        return None
    return name.strip() if name else None
