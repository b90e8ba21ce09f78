"""The class `RobotSpec`: the data that a robot is built from, for scenario files and other processes."""

from __future__ import annotations

import logging
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path
from typing import Any, TypeAlias, get_args

import pinocchio as pin

from safe_ompl.common import RATE_BOUNDS, InputError, Section, UnknownNameError, documents as document, key, warn_once
from safe_ompl.geometry import Pose
from safe_ompl.robot.collision import (
    CollisionSource,
    build_collision_geometry,
    check_collides,
    drop_fixed_pairs,
    links_of,
    make_convex,
    sample_configurations,
    select_self_pairs,
)
from safe_ompl.robot.joint_limits import JointLimitsFile
from safe_ompl.robot.joints import (
    Mimic,
    apply_mimic_limits,
    check_plannable,
    default_tip,
    joint_limits,
    joints_that_move,
    joints_without_range,
    override_limits,
    reduce_model,
    report_held,
    resolved,
    resting_value,
    with_mimics,
)
from safe_ompl.robot.parts import BASE_JOINTS, Attachment, Models, RobotParts, combined, independent, read_pose
from safe_ompl.robot.srdf import SrdfFile
from safe_ompl.robot.urdf import PackageDir, UrdfFile, read_package_dir, read_path

_log = logging.getLogger(__name__)

Ranges: TypeAlias = tuple[tuple[float, float], tuple[float, float]]

_ENDINGS = {"urdf": (".urdf", ".xml", ".xacro"), "srdf": (".srdf", ".xml", ".xacro")}
_OF_FILES = ("srdf", "package_dirs", "xacro_args")
_OF_ONE_ROBOT = (*_OF_FILES, "locked", "limits", "joint_limits", "group", "free")
# Opening of each finger of the Panda's hand.
_GRIPPER_OPEN = 0.04  # [m]


@dataclass(frozen=True)
class ExampleRobot:
    """Files and settings of one robot of example-robot-data."""

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
    """Return the folder that holds the robots of example-robot-data, or raise InputError if it is not installed."""
    # Wheels install the data in this folder. A search through the 1000 files of the package takes 40 ms.
    for folder in (Path(entry, "cmeel.prefix", "share", "example-robot-data", "robots") for entry in sys.path):
        if folder.is_dir():
            return folder.resolve()
    from importlib.metadata import PackageNotFoundError, distribution

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


def _ranges(name: str, value: Any) -> Ranges:
    """Return the limits of a mobile base in x and y [m], or raise InputError if they are not two intervals."""
    intervals = document.sequence(name, value)
    if len(intervals) != 2:
        raise InputError(f"must be the limits in x and in y, ((x0, x1), (y0, y1)), not {value!r}", name)
    x, y = (document.interval(name, interval) for interval in intervals)
    return x, y


def read_robot(name: str, value: Any) -> RobotSpec:
    """Return `value` if it is a `RobotSpec`, else read it as a mapping of a document."""
    if isinstance(value, RobotSpec):
        return value
    with document.within(name):
        return RobotSpec.from_mapping(value)


def _words(name: str, value: Any) -> dict[str, str] | None:
    """Return YAML values as the text that xacro expects: `true` becomes "true"."""
    if value is None:
        return None
    for argument, word in document.mapping(name, value).items():
        if not isinstance(word, (str, bool, int, float)):
            raise InputError(f"must be a text, a number or true or false, not {word!r}", f"{name}.{argument}")
    return {argument: str(word).lower() if isinstance(word, bool) else str(word) for argument, word in value.items()}


@dataclass(frozen=True)
class RobotSpec(Section):
    """The data that `Robot(spec)` builds a robot from. Its fields are also the options of `Robot.from_urdf`.

    Parameters
    ----------
    example : str, optional
        Name of a robot of example-robot-data; give either this, `urdf` or `robots`.
    urdf : path-like, optional
        The URDF. A URDF with xacro is expanded by the package xacro (`pip install xacro`).
    srdf : path-like, optional
        SRDF whose disabled collision pairs are not checked. Without an SRDF, or if it disables nothing, pairs of
        adjacent links and pairs that are always in contact are not checked, and the log lists these pairs.
    package_dirs : sequence of path-like, NamedPackage or mapping
        Folders that contain the packages of `package://` names. The folders above the URDF are searched as well. A
        mapping {name: folder} gives the folder of one package.
    tip : str, optional
        Frame at the end of the arm. Joints that do not move this frame are held; a warning gives their values.
        Default: the tip of the example, or the body farthest from the base; if this body is a finger, the hand.
    locked : mapping of str to float, optional
        Joints to hold still, with their values [rad or m]. Joints that mimic a locked joint are locked as well.
        None: the joints that the example locks by default.
    free : sequence of str
        Joints that move although they are locked or do not move the tip, such as the fingers of a gripper.
    base : Pose, pin.SE3, mapping or position, optional
        Pose of the base in the world; in a document `position` [m] and `quaternion_xyzw`, `rpy` or `yaw`.
    mobile_base : pair of (float, float), optional
        Limits ((x0, x1), (y0, y1)) [m] of a base that slides in x and y and rotates about z. The three joints base_x,
        base_y and base_yaw are added before the others, with their origin at `base`.
    attached : sequence, optional
        Objects in the gripper: each with shape and pose as an obstacle of a scene, `link`, and optionally `touch_links`
        and `danger`.
    robots : mapping of str to RobotSpec, optional
        Several robots in one cell, by the prefix of their names; `tip` is then the prefix of one of them.
    name : str, optional
        Name for reports; default: the name in the URDF, or "cell" for several robots.
    group : str, optional
        Group of the SRDF whose joints move. The other joints are held at zero, or at their values in `locked`.
    collision : {"required", "visual"}
        Collision geometry of links that have visual shapes only. "visual": the visual shapes. "required": none, with a
        warning and an entry in `links_without_collision`. A robot without a collision shape on any moving link is
        refused.
    accelerations : mapping of str to float, optional
        Acceleration limits by joint [rad/s² or m/s²]. A URDF has none. Those of a scenario's `motion` take precedence.
    xacro_args : mapping of str to str, optional
        Values of xacro's arguments. None refuses xacro, because xacro evaluates Python expressions.
    limits : mapping of str to (float, float), optional
        Joint limits [rad or m] that replace those of the URDF and of `joint_limits`.
    joint_limits : path-like, optional
        MoveIt's `joint_limits.yaml`, which narrows positions and velocities of the URDF, and gives accelerations and
        jerks. If the file is wider than the URDF, the URDF applies, with a warning; MoveIt would use the file.
    models : optional
        Pinocchio models instead of files; see `Robot.from_models`.

    Raises
    ------
    InputError
        If not exactly one of `example`, `urdf` and `robots` is given, or a value has the wrong type.
    """

    example: str | None = key(document.text, default=None)
    urdf: Path | None = key(read_path, default=None)
    srdf: Path | None = key(read_path, default=None)
    package_dirs: tuple[PackageDir, ...] = key(document.list_of, read=read_package_dir, default=())
    tip: str | None = key(document.line, default=None)
    locked: Mapping[str, float] | None = key(document.mapping_of, read=document.number, default=None)
    free: tuple[str, ...] = key(document.list_of, read=document.line, default=())
    base: Pose | None = key(read_pose, default=None)
    mobile_base: Ranges | None = key(_ranges, default=None)
    attached: tuple[Attachment, ...] = key(document.list_of, read=document.section, kind=Attachment, default=())
    robots: Mapping[str, RobotSpec] = key(document.mapping_of, read=read_robot, factory=dict)
    name: str | None = key(document.line, default=None)
    group: str | None = key(document.line, default=None)
    collision: CollisionSource = key(document.one_of, known=get_args(CollisionSource), default="required")
    accelerations: Mapping[str, float] = key(
        document.mapping_of, read=document.number, factory=dict, **RATE_BOUNDS["acceleration"]
    )
    xacro_args: Mapping[str, str] | None = key(_words, factory=dict)
    limits: Mapping[str, tuple[float, float]] = key(document.mapping_of, read=document.numbers, count=2, factory=dict)
    joint_limits: JointLimitsFile | None = key(JointLimitsFile.read, default=None)
    models: Models | None = None

    def check(self) -> None:
        """Raise InputError unless there is exactly one source of the robot and all options fit this source."""
        sources = (self.example, self.urdf, self.robots or None, self.models)
        if sum(source is not None for source in sources) != 1:
            raise InputError("give either example or urdf, one of the two (or robots)", "example")
        if self.robots:
            self._check_robots()
        if self.name is not None and self.example is not None:
            raise InputError("an example robot has its own", "name")
        for name in _OF_FILES:
            if self.example is not None and getattr(self, name):
                raise InputError("an example robot brings its own; give it with urdf only", name)

    def _check_robots(self) -> None:
        if len(self.robots) < 2:
            raise InputError(f"give two robots or more, not {len(self.robots)}", "robots")
        for name in _OF_ONE_ROBOT:
            if getattr(self, name):
                raise InputError("belongs to one of the robots", name)
        for one in sorted(self.robots):
            document.text("prefix", one)
            for other in sorted(self.robots):
                if other.startswith(f"{one}_"):
                    raise InputError(f"the prefixes {one!r} and {other!r} are ambiguous in '{other}_…'")
        if self.tip is not None and self.tip not in self.robots:
            raise UnknownNameError("robot with the tip", self.tip, self.robots, "tip")

    @classmethod
    def from_mapping(cls, data: Any, folder: Path | None = None) -> RobotSpec:
        """Read the name of an example, or a mapping. Its files must exist and are relative to `folder`."""
        if isinstance(data, str):
            return cls(example=data)
        spec = super().from_mapping(document.mapping("robot", data), folder)
        for name, endings in _ENDINGS.items():
            if getattr(spec, name) is not None:
                document.file(name, getattr(spec, name), endings)
        return spec

    def with_package_dirs(self, folders: Sequence[PackageDir]) -> RobotSpec:
        """Return the spec with more package folders for each of its URDFs. The new folders are searched first."""
        if self.example is not None:
            raise InputError(f"is for robots from a URDF; {self.example!r} brings its own files", "package-dir")
        if self.urdf is not None:
            return replace(self, package_dirs=(*folders, *self.package_dirs))
        robots = {k: s if s.example is not None else s.with_package_dirs(folders) for k, s in self.robots.items()}
        return replace(self, robots=robots)

    def by_joint(self, of: Callable[[RobotSpec], Mapping[str, float]]) -> dict[str, float]:
        """Return `of(spec)`, values by joint. In a cell, the values of all robots with their prefixes are added."""
        members = {prefix: robot.by_joint(of) for prefix, robot in self.robots.items()}
        own = {f"{prefix}_{joint}": value for prefix, known in members.items() for joint, value in known.items()}
        return {**own, **of(self)}

    def rates_of_file(self, kind: str) -> dict[str, float]:
        """Return acceleration or jerk limits of `joint_limits` by joint [rad/s² or rad/s³; m for prismatic joints]."""
        return {} if self.joint_limits is None else self.joint_limits.rates(kind)

    def group_state(self, name: str) -> dict[str, float]:
        """Return the joint values of a group state in the SRDF [rad or m], preferably of the robot's group.

        Raises InputError if there is no SRDF, or if several groups have different states of this name;
        UnknownNameError, with the known states, if there is no such state.
        """
        if self.robots:
            return self.by_joint(lambda spec: {} if spec.robots else spec.group_state(name))
        srdf = self.resolved().srdf_file()
        if srdf is None:
            raise InputError(f"{name!r} is the name of a state in an SRDF: give the robot an SRDF, or joint values")
        return srdf.group_state(name, self.group)

    def with_limits(self, limits: Mapping[str, tuple[float, float]]) -> RobotSpec:
        """Return the spec with other limits [rad or m] for the named joints, also of a mobile base and in a cell."""
        rest, robots, ranges = dict(limits), dict(self.robots), self.mobile_base
        if ranges is not None:
            if BASE_JOINTS[2] in rest:
                raise InputError(f"joint {BASE_JOINTS[2]!r} is continuous: it has no limits")
            x, y = (rest.pop(name, old) for name, old in zip(BASE_JOINTS, ranges, strict=False))
            ranges = _ranges("mobile_base", (x, y))
        for prefix, spec in self.robots.items():
            own = {name: rest.pop(name) for name in list(rest) if name.startswith(f"{prefix}_")}
            robots[prefix] = spec.with_limits({name.removeprefix(f"{prefix}_"): own[name] for name in own})
        if self.robots and rest:
            raise UnknownNameError("prefix of the joint with limits", next(iter(rest)), self.robots, self.name)
        return replace(self, mobile_base=ranges, robots=robots, limits={**self.limits, **rest})

    def resolved(self) -> RobotSpec:
        """Return the spec with the example replaced by its files and settings; unchanged without an example."""
        if self.example is None:
            return self
        example, folder = find_example(self.example), robots_folder()
        return replace(
            self,
            example=None,
            urdf=folder / example.urdf,
            srdf=folder / example.srdf if example.srdf else None,
            package_dirs=(folder.parents[1],),
            tip=self.tip or (example.tip if self.group is None else None),
            locked=example.locked if self.locked is None else self.locked,
            name=self.example,
        )

    def urdf_file(self) -> UrdfFile:
        """Read the URDF. The spec must have one."""
        assert self.urdf is not None
        for_srdf = self.srdf is not None and self.srdf.suffix == ".xacro"
        return UrdfFile(self.urdf, self.package_dirs, self.xacro_args, may_be_plain=for_srdf)

    def srdf_file(self) -> SrdfFile | None:
        """Read the SRDF, if there is one."""
        return None if self.srdf is None else SrdfFile(self.srdf, self.package_dirs, self.xacro_args)

    def assemble(self) -> RobotParts:
        """Build the parts of the robot. Raises as `Robot.from_urdf`."""
        if self.robots:
            bare = self.joined({prefix: spec.assemble() for prefix, spec in self.robots.items()})
        elif self.models is not None:
            bare = self._of_models(self.models)
        else:
            bare = self.resolved()._of_urdf()
        if self.mobile_base is not None:
            bare = bare.on_mobile_base(self.mobile_base)
        if self.base is not None:
            bare = bare.placed(self.base.se3)
        for item in self.attached:
            bare = bare.holding(item)
        return bare

    def joined(self, parts: Mapping[str, RobotParts]) -> RobotParts:
        """Combine the parts of the robots in the cell into the parts of one robot."""
        return combined(self.name or "cell", parts, self.tip or next(iter(self.robots)))

    def _of_urdf(self) -> RobotParts:
        file = self.urdf_file()
        source, full = str(file.path), file.build_model()
        collision_model = build_collision_geometry(file, full, self.collision)
        mimics = {name: mimic for name, mimic in file.mimics().items() if full.existJointName(name)}

        def read_visual() -> pin.GeometryModel | None:
            try:
                geometry = file.build_geometry(full, pin.GeometryType.VISUAL)
            except InputError as error:
                warn_once(_log, f"{file.path.name}: drawing its collision bodies ({error})")
                return None
            return geometry if len(geometry.geometryObjects) else None

        name = self.name or full.name or file.path.stem
        parts = self._reduced(name, source, full, collision_model, read_visual, mimics)
        check_collides(parts.collision_model, self.collision, source)
        return parts.lacking(full, links_of(full, collision_model), file.links_with("visual"))

    def _of_models(self, models: Models) -> RobotParts:
        full, name = models.model.copy(), self.name or models.model.name or "robot"
        bodies, drawn = independent(models.collision_model), models.visual_model
        parts = self._reduced(name, name, full, bodies, lambda: drawn, models.mimics)
        check_collides(parts.collision_model, None, name)
        return parts.lacking(models.model, *(links_of(models.model, g) for g in (models.collision_model, drawn)))

    def _reduced(
        self,
        name: str,
        source: str,
        full: pin.Model,
        bodies: pin.GeometryModel,
        read_visual: Callable[[], pin.GeometryModel | None],
        followers: Mapping[str, Mimic],
    ) -> RobotParts:
        """Build the parts of the robot: lock joints, make bodies convex and choose self-collision pairs."""
        mimics = resolved(followers, source)
        if self.joint_limits is not None:
            self.joint_limits.narrow(full, source)
        override_limits(full, self.limits, source)
        if self.tip is not None and not full.existFrame(self.tip):
            raise UnknownNameError("tip frame", self.tip, (frame.name for frame in list(full.frames)[1:]), source)
        held = self._joints_to_hold(full, mimics, source)
        stiff = joints_without_range(full, set(list(full.names)[1:]) - set(mimics) - set(self.limits) - set(held))
        if stiff:
            values = ", ".join(f"{joint} = {value:g}" for joint, value in sorted(stiff.items()))
            warn_once(_log, f"{name}: held, as their limits leave no range (limits= gives others): {values}")
        held = with_mimics(full, mimics, {**held, **stiff}, source)
        model, collision_model = reduce_model(full, bodies, held)
        check_plannable(model, source, stiff)
        make_convex(collision_model)
        mimics = {joint: mimic for joint, mimic in mimics.items() if model.existJointName(joint)}
        apply_mimic_limits(model, mimics, source)
        joint_limits(model, source)
        drop_fixed_pairs(collision_model)
        if not len(collision_model.collisionPairs):
            samples = sample_configurations(model, mimics=mimics)
            select_self_pairs(model, collision_model, self.srdf_file(), samples, name)

        def visual() -> pin.GeometryModel | None:
            drawn = read_visual()
            return None if drawn is None else reduce_model(full, drawn, held)[1]

        tip = self.tip or (self.group and self._groups(source).group_tip(self.group, full))
        tips = (tip or default_tip(full, model),)
        return RobotParts(name, source, model, collision_model, visual, tuple(full.names)[1:], tips, mimics, held)

    def _joints_to_hold(self, full: pin.Model, mimics: Mapping[str, Mimic], source: str) -> dict[str, float]:
        """Return the joints to hold with their values [rad or m], without mimic joints.

        The locked joints are held. So are joints outside the group or, without a group, joints that do not move the
        tip, neither directly nor through a joint that mimics them: at zero, with a warning.
        """
        locked = dict(self.locked or {})
        for name in (*self.free, *(name for name, mimic in mimics.items() if mimic.primary in self.free)):
            locked.pop(name, None)
        if self.group is not None:
            moving = set(self._groups(source).group_joints(self.group, full))
        elif self.tip is not None:
            loose = {name: mimic for name, mimic in mimics.items() if name not in locked}
            moving = joints_that_move(full, self.tip, loose)
        else:
            return locked
        moving |= {*self.free}
        names = [name for name in list(full.names)[1:] if name not in mimics]
        idle = {name: resting_value(full, name) for name in names if name not in moving and name not in locked}
        purpose = f"not in the group {self.group!r}" if self.group is not None else f"not moving {self.tip!r}"
        report_held(full, idle, moving, f"{Path(source).name}: held, as {purpose}")
        return {**locked, **idle}

    def _groups(self, source: str) -> SrdfFile:
        srdf = self.srdf_file()
        if srdf is None:
            raise InputError("group is defined in an SRDF: give the SRDF", source)
        return srdf
