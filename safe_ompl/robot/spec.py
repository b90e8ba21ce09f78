"""Specifications of robots: plain data, for scenario files and for other processes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Any

from safe_ompl.common import RATE_BOUNDS, InputError, UnknownNameError
from safe_ompl.common import documents as document
from safe_ompl.geometry import Pose
from safe_ompl.robot.loading.blueprint import Attachment, as_pose, attachments, mobile_ranges
from safe_ompl.robot.loading.collision import CollisionSource, check_source
from safe_ompl.robot.robot import Robot


@dataclass(frozen=True)
class RobotSpec:
    """How to build a robot; see `Robot.from_example` and `Robot.from_urdf` for what is not said here.

    Parameters
    ----------
    example : str, optional
        Name of a robot of example-robot-data; give this, `urdf` or `robots`.
    urdf, srdf, package_dirs, tip, hulls, group, locked_state, collision, xacro_args : optional
        As for `Robot.from_urdf`.
    locked : mapping of str to float, optional
        Joints that are held still [rad or m]. None: those that the example locks by default.
    base, mobile_base : optional
        Where the base is in the world: `position` [m], and `quaternion_xyzw`, `rpy` or `yaw`; and limits [m] of one
        that slides in x and y, and turns.
    attached : sequence, optional
        Objects in the gripper: each a shape and a pose as an obstacle of a scene has them, and `link`; `touch_links`
        and `danger` if wanted.
    robots : mapping of str to RobotSpec, optional
        Several robots in one cell, by the prefix of their names; `tip` is the prefix of one of them then.
    name : str, optional
        Name for reports; of several robots "cell" by default.
    accelerations : mapping of str to float, optional
        Acceleration limits by joint [rad/s² or m/s²]: URDFs have none. Those of a scenario's `motion` come first.

    Raises
    ------
    InputError
        If not exactly one of `example`, `urdf` and `robots` is given, a file is missing, or a value has the wrong type.
    """

    example: str | None = None
    urdf: Path | None = None
    srdf: Path | None = None
    package_dirs: tuple[Path, ...] = field(default=())
    tip: str | None = None
    locked: Mapping[str, float] | None = None
    hulls: bool = True
    base: Pose | None = None
    mobile_base: tuple[tuple[float, float], tuple[float, float]] | None = None
    attached: tuple[Attachment, ...] = field(default=())
    robots: Mapping[str, RobotSpec] = field(default_factory=dict)
    name: str | None = None
    group: str | None = None
    locked_state: str | None = None
    collision: CollisionSource = "required"
    accelerations: Mapping[str, float] = field(default_factory=dict)
    xacro_args: Mapping[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if sum((self.example is not None, self.urdf is not None, bool(self.robots))) != 1:
            raise InputError("give either example or urdf, one of the two (or robots)", "example")
        if self.robots:
            self._check_robots()
        if self.name is not None and self.example is not None:
            raise InputError("an example robot has its own", "name")
        for key in ("srdf", "package_dirs", "xacro_args"):
            if self.example is not None and getattr(self, key):
                raise InputError("an example robot brings its own; give it with urdf only", key)
        for key in ("example", "tip", "name", "group", "locked_state"):
            if getattr(self, key) is not None:
                document.text(key, getattr(self, key))
        document.flag("hulls", self.hulls)
        check_source(self.collision, "collision")
        folders = document.sequence("package_dirs", self.package_dirs)
        values = {
            "urdf": self.urdf and document.file("urdf", self.urdf, (".urdf", ".xml", ".xacro")),
            "srdf": self.srdf and document.file("srdf", self.srdf, (".srdf", ".xml")),
            "package_dirs": tuple(Path(folder).resolve() for folder in folders),
            "locked": None if self.locked is None else document.numbers_by_name("locked", self.locked),
            "base": None if self.base is None else as_pose(self.base, "base"),
            "mobile_base": None if self.mobile_base is None else mobile_ranges(self.mobile_base),
            "attached": tuple(self.attached),
            "accelerations": document.numbers_by_name(
                "accelerations", self.accelerations, **RATE_BOUNDS["acceleration"]
            ),
            "xacro_args": {
                key: _word(key, word) for key, word in document.mapping("xacro_args", self.xacro_args).items()
            },
        }
        for key, value in values.items():
            object.__setattr__(self, key, value)

    def _check_robots(self) -> None:
        for key in ("srdf", "package_dirs", "xacro_args", "locked", "base", "mobile_base"):
            if getattr(self, key):
                raise InputError("belongs to one of the robots", key)
        if self.tip is not None and self.tip not in self.robots:
            raise UnknownNameError("robot with the tip", self.tip, self.robots, "tip")

    @classmethod
    def from_mapping(cls, data: Any, folder: Path) -> RobotSpec:
        """Read the name of an example, or a mapping whose files are relative to `folder`."""
        if isinstance(data, str):
            return cls(example=data)
        read = document.mapping("robot", data)
        document.check_keys(read, [field.name for field in fields(cls)])
        for key in ("urdf", "srdf"):
            if key in read:
                read[key] = folder / document.text(key, read[key])
        if "package_dirs" in read:
            names = document.sequence("package_dirs", read["package_dirs"])
            read["package_dirs"] = tuple(folder / document.text("package_dirs", name) for name in names)
        if "attached" in read:
            read["attached"] = attachments(read["attached"], folder)
        if "robots" in read:
            robots = document.mapping("robots", read["robots"])
            read["robots"] = {}
            for prefix, robot in robots.items():
                with document.within(f"robots.{prefix}"):
                    read["robots"][prefix] = cls.from_mapping(robot, folder)
        return cls(**read)

    def to_mapping(self, folder: Path | None) -> dict[str, Any]:
        """Return what `from_mapping` reads, with files named relative to `folder`."""
        set_fields = document.changed_fields(self)
        for key in ("urdf", "srdf"):
            if key in set_fields:
                set_fields[key] = document.file_name(set_fields[key], folder)
        if self.package_dirs:
            set_fields["package_dirs"] = [document.file_name(path, folder) for path in self.package_dirs]
        if self.base is not None:
            set_fields["base"] = self.base.to_mapping()
        if self.attached:
            set_fields["attached"] = [item.to_mapping(folder) for item in self.attached]
        if self.robots:
            set_fields["robots"] = {prefix: spec.to_mapping(folder) for prefix, spec in self.robots.items()}
        return set_fields

    @property
    def reads_urdf(self) -> bool:
        """Whether the robot, or one of its robots, is read from a URDF that is given."""
        return self.urdf is not None or any(spec.reads_urdf for spec in self.robots.values())

    def with_package_dirs(self, folders: Sequence[Path]) -> RobotSpec:
        """Return the spec with more folders that hold packages, searched first, for each URDF that it names.

        Raises InputError if it names none: the robots of example-robot-data bring their own.
        """
        if not self.reads_urdf:
            raise InputError(f"is for robots from a URDF; {self.example!r} brings its own files", "package-dir")
        if self.urdf is not None:
            return replace(self, package_dirs=(*folders, *self.package_dirs))
        robots = {k: s.with_package_dirs(folders) if s.reads_urdf else s for k, s in self.robots.items()}
        return replace(self, robots=robots)

    def build(self) -> Robot:
        """Return the robot; raise InputError as `Robot.from_example`, `Robot.from_urdf` and the others do."""
        robot = self._empty_handed()
        for item in self.attached:
            robot = robot.holding(item)
        return robot.with_accelerations(self.accelerations) if self.accelerations else robot

    def _empty_handed(self) -> Robot:
        if self.robots:
            parts = {prefix: spec.build() for prefix, spec in self.robots.items()}
            return Robot.combined(self.name or "cell", parts, tip=self.tip)
        keys = ("base", "mobile_base", "hulls", "group", "locked_state", "collision")
        chosen: dict[str, Any] = {key: getattr(self, key) for key in keys}
        if self.example is not None:
            return Robot.from_example(self.example, tip=self.tip, locked=self.locked, **chosen)
        assert self.urdf is not None
        files = self.urdf, self.srdf, self.package_dirs
        return Robot.from_urdf(*files, self.tip, self.locked, name=self.name, xacro_args=self.xacro_args, **chosen)


def _word(key: str, value: Any) -> str:
    """Return a value of YAML as xacro reads it: `true` is the word "true"."""
    if not isinstance(value, (str, bool, int, float)):
        raise InputError(f"must be a text, a number or true or false, not {value!r}", f"xacro_args.{key}")
    return str(value).lower() if isinstance(value, bool) else str(value)
