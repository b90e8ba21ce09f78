"""Planning problems in a file: robot, scene, start, goal, limits, and the parameters of danger and planners."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from safe_ompl.common import FloatArray, InputError, Section, UnknownNameError, documents as document, files, key
from safe_ompl.geometry import Pose
from safe_ompl.robot import GoalRegion, Robot, RobotSpec, read_robot
from safe_ompl.scene.constraints import Configuration, MotionLimits, PathLimits, People, read_configuration
from safe_ompl.scene.program import Program
from safe_ompl.scene.scene import Scene

_TOLERANCE, _REGION_TOLERANCE = 0.01, 0.001  # [m]
_TURNS = ("quaternion_xyzw", "rpy")


@dataclass(frozen=True)
class Goal(Section):
    """Where the robot is to go: to one of several configurations, or with its tip to a place.

    Both may be given; a planner takes the one that it can use.
    """

    configurations: tuple[Configuration, ...] = key(document.each, default=(), read=read_configuration)  # any will do
    # Position of the tip in the world [m].
    position: tuple[float, ...] | None = key(document.numbers, default=None, count=3)
    quaternion_xyzw: tuple[float, ...] | None = key(document.numbers, default=None, count=4)
    # How near to the place or region is near enough [m]; default: 0.01 for a place, 0.001 for a region
    tolerance: Any = key(document.number, default=None, above=0.0)  # becomes a float
    region: GoalRegion | None = key(document.section, default=None, kind=GoalRegion)  # instead of a position

    def check(self) -> None:
        """Raise InputError unless they say where to go, in one way."""
        if self.tolerance is None:
            object.__setattr__(self, "tolerance", self._usual_tolerance)
        if self.region is not None and (self.position is not None or self.quaternion_xyzw is not None):
            raise InputError("give only one of position and region", "region")
        if self.quaternion_xyzw is not None:
            if self.position is None:
                raise InputError("missing: an orientation alone is no goal", "position")
            object.__setattr__(self, "quaternion_xyzw", Pose(self.position, self.quaternion_xyzw).quaternion_xyzw)
        if not (self.configurations or self.is_place):
            raise InputError("missing: give configuration, configurations, position or region", "configuration")

    @property
    def _usual_tolerance(self) -> float:
        return _TOLERANCE if self.region is None else _REGION_TOLERANCE

    @property
    def is_place(self) -> bool:
        """Whether it says where the tip is to be."""
        return self.position is not None or self.region is not None

    @property
    def rotation(self) -> FloatArray | None:
        """Orientation of the tip as a matrix (3, 3), or None where any will do."""
        if self.position is None or self.quaternion_xyzw is None:
            return None
        return np.asarray(Pose(self.position, self.quaternion_xyzw).se3.rotation)

    @classmethod
    def from_mapping(cls, data: Mapping[str, Any], folder: Path | None = None) -> Goal:
        """Read ``configuration`` or ``configurations``, and ``position`` with orientation or ``region``."""
        document.check_keys(data, ("configuration", "configurations", "position", *_TURNS, "tolerance", "region"))
        read = {name: value for name, value in data.items() if name not in ("configuration", *_TURNS)}
        if "configuration" in data:
            if "configurations" in data:
                raise InputError("give only one of configuration and configurations", "configurations")
            read["configurations"] = [read_configuration("configuration", data["configuration"])]
        if any(name in data for name in _TURNS):
            read["quaternion_xyzw"] = Pose.from_mapping(data).quaternion_xyzw
        return super().from_mapping(read, folder)

    def to_mapping(self, folder: Path | None = None) -> dict[str, Any]:
        """Return what `from_mapping` reads."""
        data = super().to_mapping(folder)
        if self.tolerance == self._usual_tolerance:
            del data["tolerance"]
        if len(self.configurations) == 1:
            (data["configuration"],) = data.pop("configurations")
        return data

    def configuration_array(self, robot: Robot) -> FloatArray:
        """Return the goal configurations as an array (G, n); errors as `configuration_for`, also if there is none."""
        if not self.configurations:
            raise InputError("missing: this planner needs a goal configuration", "configuration")
        if len(self.configurations) == 1:
            return configuration_for(robot, "configuration", self.configurations[0])[None]
        named = enumerate(self.configurations)
        return np.array([configuration_for(robot, f"configurations[{k}]", given) for k, given in named])


def configuration_for(robot: Robot, key: str, given: Configuration, *, is_start: bool = False) -> FloatArray:
    """Return a configuration as joint values (n,) in the order of the robot's joints [rad or m].

    The `key` is what it is called, for errors: InputError, if it has not one value for every joint, or a value is
    outside the joint's limits; UnknownNameError, if it names a joint that the robot does not have (or that is locked),
    or a state that its SRDF does not have.
    """
    if not isinstance(given, (Mapping, str)) and len(given) != robot.n:
        names = ", ".join(robot.joint_names)
        raise InputError(f"has {len(given)} values, but the robot has {robot.n} joints to move: {names}", key)
    q = robot.clipped_start(given, key) if is_start else robot.configuration(given, key)
    beyond = robot.beyond_limits(q)
    if beyond is not None:
        raise InputError(beyond, key)
    return q


_DEFAULT_TIME = 5.0  # [s]
_PACKAGE_FOLDER = Path(__file__).resolve().parents[1]


def _parameters(key: str, value: Any) -> dict[str, Any]:
    """Return a mapping of names to finite numbers, flags, text, or lists of numbers."""
    return document.by_name(key, {} if value is None else value, _parameter)


def _parameter(key: str, value: Any) -> Any:
    if isinstance(value, (bool, str)):
        return value
    if isinstance(value, (list, tuple)):
        return document.numbers(key, value)
    number = document.number(key, value)
    return value if isinstance(value, int) else number


def _description(key: str, value: Any) -> str:
    if not isinstance(value, str):
        raise InputError(f"must be text, not {value!r}", key)
    return value


@dataclass(frozen=True)
class Scenario(Section):
    """A planning problem.

    Parameters
    ----------
    name, description : str
        Name for reports, and what happens here.
    robot, scene : RobotSpec, Scene
        Which robot, and the obstacles.
    start : sequence of float, mapping of str to float, or str
        Start configuration, in the order of the robot's joints or by joint name [rad or m]; or the name of a state in
        its SRDF.
    goal : Goal, optional
        Where to go; needed unless there is a program.
    program : Program, optional
        Steps of work instead.
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

    Examples
    --------
    >>> scenario = Scenario.load("panda_shelf")
    >>> scenario.scene.names[:3]
    ('operator', 'floor', 'stand')
    """

    name: str = key(document.text)
    robot: RobotSpec = key(read_robot)
    scene: Scene = key(document.section, kind=Scene)
    start: Configuration = key(read_configuration)
    # None if there is a program only.
    goal: Goal = key(document.section, default=None, kind=Goal)
    program: Program | None = key(document.section, default=None, kind=Program)
    description: str = key(_description, default="")
    danger: Mapping[str, Any] = key(_parameters, factory=dict)
    planners: Mapping[str, Mapping[str, Any]] = key(document.by_name, factory=dict, read=_parameters)
    time: float = key(document.number, default=_DEFAULT_TIME, above=0.0)
    limits: PathLimits = key(document.section, factory=PathLimits, kind=PathLimits)
    motion: MotionLimits = key(document.section, factory=MotionLimits, kind=MotionLimits)
    people: People | None = key(document.section, default=None, kind=People)
    frames: Mapping[str, Pose] = key(document.by_name, factory=dict, read=document.section, kind=Pose)
    file: Path | None = field(default=None, compare=False)

    def check(self) -> None:
        """Raise InputError if there is nothing to do."""
        if self.goal is None and self.program is None:
            raise InputError("missing, but needed", "goal")

    @classmethod
    def load(cls, name_or_path: str | Path) -> Scenario:
        """Read a scenario from a YAML file, or the one of a name, see `list_scenarios`.

        The files that it names are relative to it. Raises InputError, which names file, key and value, if it cannot be
        read or is not valid; UnknownNameError if there is none of that name.
        """
        file = Path(name_or_path)
        if file.suffix.lower() in (".urdf", ".xacro"):
            raise InputError(
                f"is a robot, not a scenario: `safe-ompl new {file} -o scenario.yaml` writes one for it", str(file)
            )
        # Without such an ending it is the name of a scenario.
        if file.suffix.lower() not in (".yaml", ".yml"):
            file = find_scenario(name_or_path)
        with files.reading(file) as data:
            data = {"name": file.stem, "scene": None, **data}
            data |= {name: data[name] or {} for name in ("planners", "people", "frames") if name in data}
            scenario = replace(cls.from_mapping(data, file.parent), file=file)
            if scenario.people is not None:
                with document.within("people"):
                    scenario.people.names(scenario.scene)
            return scenario

    def save(self, path: str | Path) -> None:
        """Write the scenario to a YAML file that `load` reads back exactly."""
        files.write(path, files.dump_document(self.to_mapping(Path(path).parent)))

    def build_robot(self) -> Robot:
        """Return the robot; an InputError names the scenario file."""
        with document.within(f"{self._source}: robot", ": "):
            return Robot(self.robot)

    def start_configuration(self, robot: Robot) -> FloatArray:
        """Return the start as joint values (n,) [rad or m]; errors as `configuration_for`.

        A start that is slightly outside the limits begins at these, as `Robot.clipped_start` says.
        """
        with document.within(self._source, ": "):
            return configuration_for(robot, "start", self.start, is_start=True)

    def goal_configurations(self, robot: Robot) -> FloatArray:
        """Return the goal configurations (G, n) [rad or m]; errors as `Goal.configuration_array`."""
        with document.within(f"{self._source}: goal"):
            if self.goal is None:
                raise InputError("missing: it has a program, which `plan` and `plan_program` take")
            return self.goal.configuration_array(robot)

    @property
    def _source(self) -> str:
        return str(self.file) if self.file else f"scenario {self.name!r}"


def list_scenarios(*, programs: bool = False) -> dict[str, Path]:
    """Return the scenario files by name: in ``scenarios`` here, then in the package, then in its checkout.

    With `programs` those in ``scenarios/programs`` instead, which have no goal, but steps of work.
    """
    within = Path("scenarios", "programs") if programs else Path("scenarios")
    folders = (within, _PACKAGE_FOLDER / within, _PACKAGE_FOLDER.parent / within)
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
    known = list_scenarios() | list_scenarios(programs=True)
    if str(name_or_path) not in known:
        raise UnknownNameError("scenario file or name", str(name_or_path), known)
    return known[str(name_or_path)]
