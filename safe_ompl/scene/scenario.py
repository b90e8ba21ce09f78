"""Scenarios: planning problems in YAML files, with robot, scene, start, goal, limits and parameters."""

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
    """A goal: one of several configurations, a pose of the tip, or a task space region.

    If a goal has configurations as well as a pose or region, a planner takes the form that it supports.
    """

    # The planner may choose any of these configurations.
    configurations: tuple[Configuration, ...] = key(document.list_of, default=(), read=read_configuration)
    # Position of the tip in the world [m].
    position: tuple[float, ...] | None = key(document.numbers, default=None, count=3)
    quaternion_xyzw: tuple[float, ...] | None = key(document.numbers, default=None, count=4)
    # Tolerated distance from the pose or region [m]; default: 0.01 for a pose, 0.001 for a region.
    tolerance: Any = key(document.number, default=None, above=0.0)  # float after `check`
    region: GoalRegion | None = key(document.section, default=None, kind=GoalRegion)  # instead of `position`

    def check(self) -> None:
        """Raise InputError if there is no goal, or several contradict each other."""
        if self.tolerance is None:
            object.__setattr__(self, "tolerance", self._usual_tolerance)
        if self.region is not None and (self.position is not None or self.quaternion_xyzw is not None):
            raise InputError("give only one of position and region", "region")
        if self.quaternion_xyzw is not None:
            if self.position is None:
                raise InputError("missing: a goal needs a position, not an orientation alone", "position")
            object.__setattr__(self, "quaternion_xyzw", Pose(self.position, self.quaternion_xyzw).quaternion_xyzw)
        if not (self.configurations or self.is_place):
            raise InputError("missing: give configuration, configurations, position or region", "configuration")

    @property
    def _usual_tolerance(self) -> float:
        return _TOLERANCE if self.region is None else _REGION_TOLERANCE

    @property
    def is_place(self) -> bool:
        """Whether the goal has a pose or a region of the tip."""
        return self.position is not None or self.region is not None

    @property
    def rotation(self) -> FloatArray | None:
        """Orientation of the tip as a matrix (3, 3), or None if it is free."""
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
        """Return the goal as a mapping for `from_mapping`."""
        data = super().to_mapping(folder)
        if self.tolerance == self._usual_tolerance:
            del data["tolerance"]
        if len(self.configurations) == 1:
            (data["configuration"],) = data.pop("configurations")
        return data

    def configuration_array(self, robot: Robot) -> FloatArray:
        """Return the goal configurations (G, n). Raises InputError if there are none, and as `configuration_for`."""
        if not self.configurations:
            raise InputError("missing: this planner needs a goal configuration", "configuration")
        if len(self.configurations) == 1:
            return configuration_for(robot, "configuration", self.configurations[0])[None]
        named = enumerate(self.configurations)
        return np.array([configuration_for(robot, f"configurations[{k}]", given) for k, given in named])


def configuration_for(robot: Robot, key: str, given: Configuration, *, is_start: bool = False) -> FloatArray:
    """Return a configuration as joint values (n,) in the order of the robot's joints [rad or m].

    Raises InputError, which starts with `key`, if a joint has no value, or a value is outside the joint limits;
    UnknownNameError for a joint that the robot does not have (or that is locked), or an unknown group state.
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
    """Read a mapping of names to finite numbers, flags, text, or lists of numbers."""
    return document.mapping_of(key, {} if value is None else value, _parameter)


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
        Name and description for reports.
    robot, scene : RobotSpec, Scene
        The robot and the obstacles.
    start : sequence of float, mapping of str to float, or str
        Start configuration, in the order of the robot's joints or by joint name [rad or m], or the name of a group
        state in the SRDF.
    goal : Goal, optional
        The goal; needed unless there is a program.
    program : Program, optional
        Steps of work, instead of a goal.
    danger, planners : mapping, optional
        Parameters of the danger field by name, and parameters of planners by the planner's name.
    limits, motion : PathLimits, MotionLimits, optional
        Limits of all paths, and limits of trajectories.
    people : People, optional
        People near the robot, for trajectories.
    time : float, optional
        Time limit of planning [s].
    frames : mapping of str to Pose, optional
        Poses of sensor frames in the world, for ROS messages in these frames.
    file : Path, optional
        File of the scenario, for error messages.

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
    # The goal is None if the scenario has only a program.
    goal: Goal = key(document.section, default=None, kind=Goal)
    program: Program | None = key(document.section, default=None, kind=Program)
    description: str = key(_description, default="")
    danger: Mapping[str, Any] = key(_parameters, factory=dict)
    planners: Mapping[str, Mapping[str, Any]] = key(document.mapping_of, factory=dict, read=_parameters)
    time: float = key(document.number, default=_DEFAULT_TIME, above=0.0)
    limits: PathLimits = key(document.section, factory=PathLimits, kind=PathLimits)
    motion: MotionLimits = key(document.section, factory=MotionLimits, kind=MotionLimits)
    people: People | None = key(document.section, default=None, kind=People)
    frames: Mapping[str, Pose] = key(document.mapping_of, factory=dict, read=document.section, kind=Pose)
    file: Path | None = field(default=None, compare=False)

    def check(self) -> None:
        """Raise InputError if there is neither a goal nor a program."""
        if self.goal is None and self.program is None:
            raise InputError("missing, but needed", "goal")

    @classmethod
    def load(cls, name_or_path: str | Path) -> Scenario:
        """Read a scenario from a YAML file, or by its name in `list_scenarios`.

        File names in the scenario are relative to its file. Raises InputError with file, key and value if the file
        cannot be read or is not valid; UnknownNameError for an unknown name.
        """
        file = Path(name_or_path)
        if file.suffix.lower() in (".urdf", ".xacro"):
            raise InputError(
                f"is a robot, not a scenario: `safe-ompl new {file} -o scenario.yaml` writes one for it", str(file)
            )
        # Without one of these endings, the argument is the name of a scenario.
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
        """Build the robot. An InputError names the scenario file."""
        with document.within(f"{self._source}: robot", ": "):
            return Robot(self.robot)

    def start_configuration(self, robot: Robot) -> FloatArray:
        """Return the start configuration (n,) [rad or m]. Raises as `configuration_for`.

        A start slightly outside the limits is clipped to them, see `Robot.clipped_start`.
        """
        with document.within(self._source, ": "):
            return configuration_for(robot, "start", self.start, is_start=True)

    def goal_configurations(self, robot: Robot) -> FloatArray:
        """Return the goal configurations (G, n) [rad or m]. Raises as `Goal.configuration_array`."""
        with document.within(f"{self._source}: goal"):
            if self.goal is None:
                raise InputError("missing: it has a program, which `plan` and `plan_program` take")
            return self.goal.configuration_array(robot)

    @property
    def _source(self) -> str:
        return str(self.file) if self.file else f"scenario {self.name!r}"


def list_scenarios(*, programs: bool = False) -> dict[str, Path]:
    """Return the scenario files by name. The folders ``scenarios`` are searched in this order: here, package, checkout.

    With `programs`, the folders ``scenarios/programs`` are searched instead. Their scenarios have a program, no goal.
    """
    within = Path("scenarios", "programs") if programs else Path("scenarios")
    folders = (within, _PACKAGE_FOLDER / within, _PACKAGE_FOLDER.parent / within)
    found: dict[str, Path] = {}
    for file in (file for folder in folders for file in sorted(folder.glob("*.yaml"))):
        found.setdefault(file.stem, file)
    return dict(sorted(found.items()))


def find_scenario(name_or_path: str | Path) -> Path:
    """Return the scenario file with this path, else with this name in `list_scenarios`.

    Raises UnknownNameError with the known names if there is none.
    """
    path = Path(name_or_path)
    if path.is_file():
        return path
    known = list_scenarios() | list_scenarios(programs=True)
    if str(name_or_path) not in known:
        raise UnknownNameError("scenario file or name", str(name_or_path), known)
    return known[str(name_or_path)]
