"""Programs: steps of work of an arm, with choices of grasps and places; plain data."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, ClassVar

from safe_ompl.common import InputError, Section, documents as document, key
from safe_ompl.geometry import POSE_KEYS, Pose
from safe_ompl.robot import GoalRegion
from safe_ompl.scene.constraints import Configuration, pairs_of_names, read_configuration

CONTACT_DEPTH = 0.001
"""How deep contacts that a step allows may be, unless it says `depth` [m]."""


@dataclass(frozen=True)
class Step(Section):
    """One step of a program, in a document ``{kind: its other keys}``."""

    kind: ClassVar[str]

    def to_mapping(self, folder: Path | None = None) -> dict[str, Any]:
        """Return what `read_step` reads."""
        return {self.kind: super().to_mapping(folder)}

    def __str__(self) -> str:
        said = {name: value for name, value in super().to_mapping().items() if name not in ("touching", "depth")}
        return " ".join([self.kind, *(f"{name} {_short(value)}" for name, value in said.items())])


@dataclass(frozen=True, kw_only=True)
class _Contact(Step):
    """A step on which links may touch obstacles."""

    # Pairs of a link, or an object that is held, and an obstacle, or of a link and an object that is held, that may
    # touch; no deeper than this [m]
    touching: tuple[tuple[str, str], ...] = key(pairs_of_names, default=())
    depth: float = key(document.number, default=CONTACT_DEPTH, above=0.0)


@dataclass(frozen=True)
class _Target(_Contact):
    """A step to a place of the tip; one of its `ways` says where."""

    ways: ClassVar[tuple[str, ...]] = ("pose", "grasp", "place")
    # In the world; in a document `position` and `quaternion_xyzw`, `rpy` or `yaw`
    pose: Pose | None = key(document.section, default=None, kind=Pose)
    # An object: the tip goes to one of its grasps.
    grasp: str | None = key(document.text, default=None)
    # An attached object: it goes to one of its places.
    place: str | None = key(document.text, default=None)
    # The target is moved up in the world, and back along the z axis of the tip [m].
    up: float = key(document.number, default=0.0)
    back: float = key(document.number, default=0.0)
    # Of several robots in a cell the one that moves, by its prefix; default: the one that has the tip
    arm: str | None = key(document.text, default=None)

    @property
    def targets(self) -> dict[str, Any]:
        """What says where to go, by key."""
        return {name: value for name in self.ways if (value := getattr(self, name)) is not None}

    def check(self) -> None:
        """Raise InputError unless one thing says where to go."""
        if len(self.targets) != 1:
            found = " and ".join(self.targets) or "none"
            raise InputError(f"give exactly one way to say where to go; found {found}", self.kind)

    @classmethod
    def from_mapping(cls, data: Mapping[str, Any], folder: Path | None = None) -> _Target:
        """Read the step; the keys of a pose are its own."""
        rest = {name: value for name, value in data.items() if name not in POSE_KEYS}
        if len(rest) < len(data):
            rest["pose"] = Pose.from_mapping({name: data[name] for name in POSE_KEYS if name in data})
        return super().from_mapping(rest, folder)

    def to_mapping(self, folder: Path | None = None) -> dict[str, Any]:
        """Return what `read_step` reads."""
        ((kind, said),) = super().to_mapping(folder).items()
        return {kind: {**said.pop("pose", {}), **said}}


@dataclass(frozen=True)
class Move(_Target):
    """A planned motion, by whatever way is free: to a place or region of the tip, or a configuration of the arm."""

    kind: ClassVar[str] = "move"
    ways = (*_Target.ways, "configuration", "region")
    configuration: Configuration | None = key(read_configuration, default=None)
    region: GoalRegion | None = key(document.section, default=None, kind=GoalRegion)


@dataclass(frozen=True)
class _Corridor(_Contact):
    """A tool motion in a corridor."""

    # The largest deviations of the tip from the curve [m], and from its orientation [rad].
    within: float = key(document.number, default=0.001, above=0.0)
    angle: float = key(document.number, default=0.01, above=0.0)
    # The tip may turn about this axis of its frame.
    free_axis: str | None = key(document.one_of, default=None, known=("x", "y", "z"))
    # Speed of the tip [m/s]; default: as fast as the joints can.
    speed: float | None = key(document.number, default=None, above=0.0)


@dataclass(frozen=True)
class Line(_Corridor, _Target):
    """A straight motion of the tip, proven to stay in its corridor."""

    kind: ClassVar[str] = "line"
    ways = (*_Target.ways, "by")
    # A displacement in the world instead of a pose [m].
    by: tuple[float, ...] | None = key(document.numbers, default=None, count=3)

    @property
    def targets(self) -> dict[str, Any]:
        """What says where to go, by key; up and back alone do."""
        return super().targets or ({"by": (0.0, 0.0, 0.0)} if self.up or self.back else {})


@dataclass(frozen=True)
class Seam(_Corridor):
    """A motion of the tip along a spline from where it is through poses in the world."""

    kind: ClassVar[str] = "seam"
    poses: tuple[Pose, ...] = key(document.each, factory=tuple, read=document.section, kind=Pose, least="pose")
    arm: str | None = key(document.text, default=None)


@dataclass(frozen=True)
class Gripper(_Contact):
    """Joints of a gripper that move to values [rad or m], by name; all others stand still."""

    kind: ClassVar[str] = "gripper"
    joints: Mapping[str, float] = key(document.by_name, read=document.number, factory=dict, least="joint")


@dataclass(frozen=True)
class Attach(Step):
    """From here on an obstacle of the scene is held by the tip, where it is now."""

    kind: ClassVar[str] = "attach"
    object: str = key(document.text)
    arm: str | None = key(document.text, default=None)


@dataclass(frozen=True)
class Detach(Step):
    """From here on an object that was held is an obstacle, where it is now."""

    kind: ClassVar[str] = "detach"
    object: str = key(document.text)


@dataclass(frozen=True)
class Wait(_Contact):
    """The robot stands still for a time [s]."""

    kind: ClassVar[str] = "wait"
    time: float = key(document.number, above=0.0)


KINDS: dict[str, type[Step]] = {step.kind: step for step in (Move, Line, Seam, Gripper, Attach, Detach, Wait)}
_SHORT = {"attach": "object", "detach": "object", "wait": "time"}  # ``{attach: cube}``


def read_step(key: str, value: Any) -> Step:
    """Return a step, given as one or as a document has it."""
    if isinstance(value, Step):
        return value
    given = document.mapping(key, value, KINDS)
    if len(given) != 1:
        raise InputError(f"must be one step: one of {', '.join(KINDS)}, and what belongs to it", key)
    ((kind, content),) = given.items()
    if kind in _SHORT and not isinstance(content, Mapping):
        content = {_SHORT[kind]: content}
    with document.within(key):
        found: Step = document.section(kind, content, KINDS[kind])
    return found


_POSES = partial(document.each, read=document.section, kind=Pose, least="pose")


@dataclass(frozen=True)
class Program(Section):
    """Steps of work, one after the other, and what may be chosen on the way.

    Parameters
    ----------
    steps : sequence of Step
        `Move`, `Line`, `Seam`, `Gripper`, `Attach`, `Detach` and `Wait`.
    grasps : mapping of str to sequence of Pose
        By object: where the tip may be to grasp it, in the frame of the object.
    places : mapping of str to sequence of Pose
        By object: where it may be put, in the world.

    Examples
    --------
    >>> program = Scenario.load("panda_pick_place").program
    >>> len(program.steps)
    11
    """

    steps: tuple[Step, ...] = key(document.each, read=read_step, least="step")
    grasps: Mapping[str, tuple[Pose, ...]] = key(document.by_name, factory=dict, read=_POSES)
    places: Mapping[str, tuple[Pose, ...]] = key(document.by_name, factory=dict, read=_POSES)

    @property
    def gripper_joints(self) -> tuple[str, ...]:
        """The joints that steps of grippers move."""
        return tuple(dict.fromkeys(name for step in self.steps if isinstance(step, Gripper) for name in step.joints))

    def check(self) -> None:
        """Raise InputError where a step needs grasps or places that are not there."""
        for k, step in enumerate(self.steps):
            for kind, known in (("grasp", self.grasps), ("place", self.places)):
                name = getattr(step, kind, None)
                if name is not None and name not in known:
                    raise InputError(f"there are no {kind}s for {name!r}: give program.{kind}s", f"steps[{k}].{kind}")


def _short(value: Any) -> str:
    if isinstance(value, Mapping):
        return ", ".join(f"{name} {_short(item)}" for name, item in value.items())
    if isinstance(value, (list, tuple)):
        return "(" + ", ".join(map(_short, value)) + ")"
    return f"{value:.3g}" if isinstance(value, float) else str(value)
