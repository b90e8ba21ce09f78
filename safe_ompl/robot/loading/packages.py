"""Packages that a URDF names, and the robots of example-robot-data."""

from __future__ import annotations

import os
import xml.etree.ElementTree as ElementTree
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import cache, cached_property
from importlib.metadata import PackageNotFoundError, distribution
from pathlib import Path

from safe_ompl.common import InputError, UnknownNameError

_PACKAGE = "package://"
_MANIFEST = "package.xml"
_GRIPPER_OPEN = 0.04  # [m] per finger of the Panda's hand


class PackageFolders:
    """The packages given, above a URDF, beside those above it, and where ROS looks for packages.

    Folders that are given are packages, hold packages, or hold folders of packages. ROS looks in the folders of the
    environment variables ROS_PACKAGE_PATH (ROS 1) and AMENT_PREFIX_PATH (ROS 2), in the latter below `share`.
    """

    def __init__(self, urdf: Path, given: Sequence[Path]) -> None:
        self._urdf, self._given = urdf, tuple(given)

    def resolve(self, name: str) -> Path | None:
        """Return the file that `package://package/file` names, or None if there is none."""
        package, _, file = name.removeprefix(_PACKAGE).partition("/")
        places = (folder / file for folder in self.named(package))
        return next((place for place in places if place.is_file()), None)

    def named(self, package: str) -> Iterator[Path]:
        """Yield the folders of a package, the nearest first."""
        yield from self._by_name.get(package, ())
        shares = (prefix / "share" for prefix in _variable("AMENT_PREFIX_PATH"))
        for folder in (*_variable("ROS_PACKAGE_PATH"), *shares):  # workspaces name folders of packages as these
            for place in (folder / package, folder):
                if _package_name(place / _MANIFEST) == package:
                    yield place

    @cached_property
    def _by_name(self) -> dict[str, list[Path]]:
        """Folders with a manifest by the packages' names, the nearest first; each once."""
        found: dict[str, list[Path]] = {}
        for folder in dict.fromkeys(self._places()):
            name = _package_name(folder / _MANIFEST) if (folder / _MANIFEST).is_file() else None
            if name is not None:
                found.setdefault(name, []).append(folder)
        return found

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


@dataclass(frozen=True)
class ExampleRobot:
    """Files and settings of one robot of example-robot-data.

    URDF and SRDF are relative to the folder of the robots; no SRDF is given where the shipped one disables no pair. The
    tip is the frame at the end of the arm; `locked` joints are held still [rad or m].
    """

    urdf: str
    srdf: str | None
    tip: str
    locked: dict[str, float] = field(default_factory=dict)


EXAMPLES: dict[str, ExampleRobot] = {
    "panda": ExampleRobot(
        "panda_description/urdf/panda.urdf",
        "panda_description/srdf/panda.srdf",
        "panda_hand_tcp",
        {"panda_finger_joint1": _GRIPPER_OPEN, "panda_finger_joint2": _GRIPPER_OPEN},
    ),
    "ur3": ExampleRobot("ur_description/urdf/ur3_joint_limited_robot.urdf", None, "tool0"),
    "ur5": ExampleRobot(
        "ur_description/urdf/ur5_joint_limited_robot.urdf", "ur_description/srdf/ur5_joint_limited_robot.srdf", "tool0"
    ),
    "ur10": ExampleRobot("ur_description/urdf/ur10_joint_limited_robot.urdf", None, "tool0"),
    "xarm7": ExampleRobot("xarm_description/urdf/xarm7.urdf", "xarm_description/srdf/xarm7.srdf", "link_eef"),
    "kinova": ExampleRobot("kinova_description/robots/kinova.urdf", None, "j2s6s200_end_effector"),
    "z1": ExampleRobot("z1_description/urdf/z1.urdf", None, "gripperStator"),
    "so101": ExampleRobot("so_arm_description/urdf/so101.urdf", None, "gripper_frame_link"),
}


@cache
def robots_folder() -> Path:
    """Return the folder that holds the robots of example-robot-data, or raise InputError if it is not installed.

    The wheel has data only and no Python module, so it is found through the package metadata.
    """
    try:
        package = distribution("example-robot-data")
    except PackageNotFoundError:
        raise InputError("the package example-robot-data is not installed") from None
    for file in package.files or ():
        if file.name == "panda.urdf":
            return Path(str(package.locate_file(file))).resolve().parents[2]
    raise InputError("the package example-robot-data holds no robots")


def find_example(name: str) -> ExampleRobot:
    """Return the entry of the example robot called `name`, or raise UnknownNameError."""
    try:
        return EXAMPLES[name]
    except (KeyError, TypeError):
        raise UnknownNameError("example robot", name, sorted(EXAMPLES)) from None
