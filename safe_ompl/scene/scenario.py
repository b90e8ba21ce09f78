"""Planning problems in a file: robot, scene, start, goal, limits, and the parameters of danger and planners."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

from safe_ompl.common import FloatArray, InputError, UnknownNameError, files, formats
from safe_ompl.common import documents as document
from safe_ompl.geometry import Pose
from safe_ompl.robot import GoalRegion, Robot, RobotSpec
from safe_ompl.scene.constraints import MotionLimits, PathLimits
from safe_ompl.scene.people import People
from safe_ompl.scene.scene import Scene

Configuration: TypeAlias = tuple[float, ...] | Mapping[str, float]
"""Joint values in the robot's order, or by the names of the joints [rad or m]."""

_TOLERANCE, _REGION_TOLERANCE = 0.01, 0.001  # [m]
_TURNS = ("quaternion_xyzw", "rpy")


@dataclass(frozen=True)
class Goal:
    """Where the robot is to go: to one of several configurations, or with its tip to a place.

    Both may be given; a planner takes the one that it can use.

    Parameters
    ----------
    configurations : sequence of Configuration, optional
        Goal configurations, any of which will do.
    position : sequence of 3 float, optional
        Where the tip of the robot is to be, in the world frame [m].
    quaternion_xyzw : sequence of 4 float, optional
        Orientation of the tip, which makes the place a pose.
    tolerance : float, optional
        How near to the place or region is near enough [m]; default: 0.01 for a place, 0.001 for a region.
    region : GoalRegion, optional
        Where the tip may be, instead of a position.

    Raises
    ------
    InputError
        If there is no configuration, position or region, both of the latter, or a value cannot be used.
    """

    configurations: tuple[Configuration, ...] = ()
    position: tuple[float, ...] | None = None
    quaternion_xyzw: tuple[float, ...] | None = None
    tolerance: Any = None  # becomes a float
    region: GoalRegion | None = None

    def __post_init__(self) -> None:
        given = document.sequence("configurations", self.configurations)
        read = tuple(read_configuration(key, item) for key, item in _numbered("configurations", given))
        object.__setattr__(self, "configurations", read)
        usual = _TOLERANCE if self.region is None else _REGION_TOLERANCE
        wanted = usual if self.tolerance is None else document.number("tolerance", self.tolerance, above=0.0)
        object.__setattr__(self, "tolerance", wanted)
        if self.region is not None and (self.position is not None or self.quaternion_xyzw is not None):
            raise InputError("give only one of position and region", "region")
        if self.position is not None:
            pose = Pose(self.position, self.quaternion_xyzw or (0.0, 0.0, 0.0, 1.0))
            object.__setattr__(self, "position", pose.position)
            object.__setattr__(self, "quaternion_xyzw", self.quaternion_xyzw and pose.quaternion_xyzw)
        elif self.quaternion_xyzw is not None:
            raise InputError("missing: an orientation alone is no goal", "position")
        elif not self.configurations and self.region is None:
            raise InputError("missing: give configuration, configurations, position or region", "configuration")

    @property
    def is_place(self) -> bool:
        """Whether it says where the tip is to be."""
        return self.position is not None or self.region is not None

    @property
    def rotation(self) -> FloatArray | None:
        """Orientation of the tip as a matrix (3, 3), or None where any will do."""
        if self.position is None or self.quaternion_xyzw is None:
            return None
        rotation: FloatArray = Pose(self.position, self.quaternion_xyzw).se3.rotation
        return rotation

    @classmethod
    def from_mapping(cls, data: Mapping[str, Any]) -> Goal:
        """Read ``configuration`` or ``configurations``, and ``position`` with orientation or ``region``."""
        document.check_keys(data, ("configuration", "configurations", "position", *_TURNS, "tolerance", "region"))
        if "configuration" in data and "configurations" in data:
            raise InputError("give only one of configuration and configurations", "configurations")
        if "configuration" in data:
            configurations = [read_configuration("configuration", data["configuration"])]
        else:
            configurations = document.sequence("configurations", data.get("configurations", ()))
        turn = None
        if any(key in data for key in _TURNS):
            turn = Pose.from_mapping(data).quaternion_xyzw
        region = None
        if "region" in data:
            region = document.section("region", data["region"], GoalRegion.from_mapping)
        return cls(tuple(configurations), data.get("position"), turn, data.get("tolerance"), region)

    def to_mapping(self) -> dict[str, Any]:
        """Return what `from_mapping` reads."""
        data: dict[str, Any] = {}
        if len(self.configurations) == 1:
            data["configuration"] = self.configurations[0]
        elif self.configurations:
            data["configurations"] = self.configurations
        for key in ("position", "quaternion_xyzw"):
            if getattr(self, key) is not None:
                data[key] = getattr(self, key)
        if self.region is not None:
            data["region"] = self.region.to_mapping()
        if self.tolerance != (_TOLERANCE if self.region is None else _REGION_TOLERANCE):
            data["tolerance"] = self.tolerance
        return data

    def configuration_array(self, robot: Robot) -> FloatArray:
        """Return the goal configurations as an array (G, n); errors as `configuration_for`, also if there is none."""
        if not self.configurations:
            raise InputError("missing: this planner needs a goal configuration", "configuration")
        if len(self.configurations) == 1:
            return configuration_for(robot, "configuration", self.configurations[0])[None]
        named = _numbered("configurations", self.configurations)
        return np.array([configuration_for(robot, key, given) for key, given in named])


def read_configuration(key: str, value: Any) -> Configuration:
    """Return a configuration of finite numbers from a list, or from a mapping of joint names to values."""
    if isinstance(value, Mapping):
        with document.within(key):
            return {str(joint): document.number(str(joint), given) for joint, given in value.items()}
    return document.numbers(key, value)


def configuration_for(robot: Robot, key: str, given: Configuration) -> FloatArray:
    """Return a configuration as joint values (n,) in the order of the robot's joints [rad or m].

    The `key` is what it is called, for errors: InputError, if it has not one value for every joint, or a value is
    outside the joint's limits; UnknownNameError, if it names a joint that the robot does not have (or that is locked).
    """
    if not isinstance(given, Mapping) and len(given) != robot.n:
        names = ", ".join(robot.joint_names)
        raise InputError(f"has {len(given)} values, but the robot has {robot.n} joints to move: {names}", key)
    q = robot.configuration(given, key)
    beyond = robot.beyond_limits(q)
    if beyond is not None:
        raise InputError(beyond, key)
    return q


def _numbered(key: str, items: Any) -> Iterator[tuple[str, Any]]:
    return ((f"{key}[{k}]", item) for k, item in enumerate(items))


_TIME = 5.0  # [s]
_PACKAGE = Path(__file__).resolve().parents[1]


@dataclass(frozen=True)
class Scenario:
    """A planning problem.

    Parameters
    ----------
    name, description : str
        Name for reports, and what happens here.
    robot, scene : RobotSpec, Scene
        Which robot, and the obstacles.
    start : sequence of float, or mapping of str to float
        Start configuration, in the order of the robot's joints or by joint name [rad or m].
    goal : Goal
        Where to go.
    danger, planners : mapping, optional
        Parameters of the danger field by name, and those of planners by the planner's name.
    limits, motion : PathLimits, MotionLimits, optional
        What every path must keep to, and how fast the robot may move, for trajectories.
    people : People, optional
        Who may come near it, for trajectories.
    time : float, optional
        Time limit [s].
    frames : mapping of str to Pose, optional
        Where frames of sensors are in the world, for messages of ROS that are in them.
    file : Path, optional
        Where the scenario came from, for errors.

    Raises
    ------
    InputError
        If a value cannot be used; the message starts with its key.
    """

    name: str
    robot: RobotSpec
    scene: Scene
    start: Configuration
    goal: Goal
    description: str = ""
    danger: Mapping[str, Any] = field(default_factory=dict)
    planners: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    time: float = _TIME
    limits: PathLimits = field(default_factory=PathLimits)
    motion: MotionLimits = field(default_factory=MotionLimits)
    people: People | None = None
    frames: Mapping[str, Pose] = field(default_factory=dict)
    file: Path | None = field(default=None, compare=False)

    def __post_init__(self) -> None:
        planners = document.mapping("planners", self.planners)
        with document.within("planners"):
            parameters = {name: _parameters(name, given) for name, given in planners.items()}
        values = {
            "name": document.text("name", self.name),
            "start": read_configuration("start", self.start),
            "danger": _parameters("danger", self.danger),
            "planners": parameters,
            "time": document.number("time", self.time, above=0.0),
        }
        for key, value in values.items():
            object.__setattr__(self, key, value)
        if not isinstance(self.description, str):
            raise InputError(f"must be text, not {self.description!r}", "description")

    @classmethod
    def load(cls, path: str | Path) -> Scenario:
        """Read a scenario from a YAML file; the files that it names are relative to it.

        Raises InputError, which names file, key and value, if it cannot be read or is not valid.
        """
        file = Path(path)
        if file.suffix.lower() in (".urdf", ".xacro"):
            raise InputError(
                f"is a robot, not a scenario: `safe-ompl new {file} -o scenario.yaml` writes one for it", str(file)
            )
        with formats.reading(file) as data:
            return cls._from_mapping(data, file)

    @classmethod
    def _from_mapping(cls, data: Mapping[str, Any], file: Path) -> Scenario:
        document.check_keys(data, [field.name for field in fields(cls) if field.name != "file"])
        robot = document.require(data, "robot")
        robot = robot if isinstance(robot, str) else document.mapping("robot", robot)
        with document.within("robot"):
            spec = RobotSpec.from_mapping(robot, file.parent)
        goal = document.section("goal", document.mapping("goal", document.require(data, "goal")), Goal.from_mapping)
        scene = document.section("scene", data.get("scene"), lambda d: Scene.from_mapping(d, file.parent))
        people = None
        if "people" in data:
            people = document.section("people", data["people"], lambda d: People.from_mapping(d, file.parent))
            with document.within("people"):
                people.names(scene)
        return cls(
            name=data.get("name", file.stem),
            robot=spec,
            scene=scene,
            start=document.require(data, "start"),
            goal=goal,
            description=data.get("description", ""),
            danger=data.get("danger") or {},
            planners=data.get("planners") or {},
            limits=document.section("limits", data.get("limits"), PathLimits.from_mapping),
            motion=document.section("motion", data.get("motion"), MotionLimits.from_mapping),
            people=people,
            time=data.get("time", _TIME),
            frames=document.section("frames", data.get("frames"), _frames),
            file=file,
        )

    def save(self, path: str | Path) -> None:
        """Write the scenario to a YAML file that `load` reads back exactly."""
        folder = Path(path).parent
        data = {
            "name": self.name,
            "description": self.description,
            "robot": self.robot.to_mapping(folder),
            "scene": self.scene.to_mapping(folder),
            "start": self.start,
            "goal": self.goal.to_mapping(),
            "danger": self.danger,
            "planners": self.planners,
            "limits": self.limits.to_mapping() or None,
            "motion": self.motion.to_mapping() or None,
            "people": None if self.people is None else self.people.to_mapping(folder),
            "time": self.time,
            "frames": {name: pose.to_mapping() for name, pose in self.frames.items()} or None,
        }
        given = {key: value for key, value in data.items() if value is not None}
        files.write(path, formats.dump_document(given))

    def build_robot(self) -> Robot:
        """Return the robot; an InputError names the scenario file."""
        with document.within(f"{self._source}: robot", ": "):
            return Robot(self.robot)

    def start_configuration(self, robot: Robot) -> FloatArray:
        """Return the start as joint values (n,) [rad or m]; errors as `configuration_for`."""
        with document.within(self._source, ": "):
            return configuration_for(robot, "start", self.start)

    def goal_configurations(self, robot: Robot) -> FloatArray:
        """Return the goal configurations (G, n) [rad or m]; errors as `Goal.configuration_array`."""
        with document.within(f"{self._source}: goal"):
            return self.goal.configuration_array(robot)

    @property
    def _source(self) -> str:
        return str(self.file) if self.file else f"scenario {self.name!r}"


def _frames(data: Mapping[str, Any]) -> dict[str, Pose]:
    return {
        name: document.section(name, document.mapping(name, place), Pose.from_mapping) for name, place in data.items()
    }


def list_scenarios() -> dict[str, Path]:
    """Return the scenario files by name: in ``scenarios`` here, then in the package, then in its checkout."""
    folders = (Path("scenarios"), _PACKAGE / "scenarios", _PACKAGE.parent / "scenarios")
    found: dict[str, Path] = {}
    for file in (file for folder in folders for file in sorted(folder.glob("*.yaml"))):
        found.setdefault(file.stem, file)
    return dict(sorted(found.items()))


def find_scenario(name_or_path: str | Path) -> Path:
    """Return the scenario file of this path or, failing that, of this name; see `list_scenarios`.

    Raises UnknownNameError, which lists those that exist, if there is none.
    """
    path = Path(name_or_path)
    if path.is_file():
        return path
    known = list_scenarios()
    if str(name_or_path) not in known:
        raise UnknownNameError("scenario file or name", str(name_or_path), known)
    return known[str(name_or_path)]


def _parameters(key: str, value: Any) -> dict[str, Any]:
    """Return a mapping of names to finite numbers, flags, text, or lists of numbers."""
    given = document.mapping(key, {} if value is None else value)
    with document.within(key):
        return {name: _parameter(name, item) for name, item in given.items()}


def _parameter(key: str, value: Any) -> Any:
    if isinstance(value, (bool, str)):
        return value
    if isinstance(value, (list, tuple)):
        return document.numbers(key, value)
    number = document.number(key, value)
    return value if isinstance(value, int) else number
