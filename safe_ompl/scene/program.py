"""Programs: sequences of steps of an arm, with candidate grasps and places."""

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
"""Default depth [m] of the contacts that a step allows."""


@dataclass(frozen=True)
class Step(Section):
    """Base class of the steps of a program. A document writes a step as ``{kind: its other keys}``."""

    kind: ClassVar[str]

    def to_mapping(self, folder: Path | None = None) -> dict[str, Any]:
        """Return the step as a mapping for `read_step`."""
        return {self.kind: super().to_mapping(folder)}

    def __str__(self) -> str:
        shown = {name: value for name, value in super().to_mapping().items() if name not in ("touching", "depth")}
        return " ".join([self.kind, *(f"{name} {_short(value)}" for name, value in shown.items())])


@dataclass(frozen=True, kw_only=True)
class _Contact(Step):
    """A step during which links may touch obstacles."""

    # Pairs that may touch up to `depth` [m]: a link or a held object with an obstacle, or a link with a held object.
    touching: tuple[tuple[str, str], ...] = key(pairs_of_names, default=())
    depth: float = key(document.number, default=CONTACT_DEPTH, above=0.0)


@dataclass(frozen=True)
class _Target(_Contact):
    """A step with a target. Exactly one of the keys in `ways` gives the target."""

    ways: ClassVar[tuple[str, ...]] = ("pose", "grasp", "place")
    # The pose in the world; in a document `position` and `quaternion_xyzw`, `rpy` or `yaw`.
    pose: Pose | None = key(document.section, default=None, kind=Pose)
    # The name of an object. The tip moves to one of its grasps.
    grasp: str | None = key(document.text, default=None)
    # The name of a held object. The object moves to one of its places.
    place: str | None = key(document.text, default=None)
    # Offsets of the target: up in the world, and back along the z axis of the tip [m].
    up: float = key(document.number, default=0.0)
    back: float = key(document.number, default=0.0)
    # In a cell, the prefix of the robot that moves; default: the robot with the tip.
    arm: str | None = key(document.text, default=None)

    @property
    def targets(self) -> dict[str, Any]:
        """The given targets, by key."""
        return {name: value for name in self.ways if (value := getattr(self, name)) is not None}

    def check(self) -> None:
        """Raise InputError unless exactly one target is given."""
        if len(self.targets) != 1:
            found = " and ".join(self.targets) or "none"
            raise InputError(f"give exactly one target; found {found}", self.kind)

    @classmethod
    def from_mapping(cls, data: Mapping[str, Any], folder: Path | None = None) -> _Target:
        """Read the step. The keys of its pose are on the same level as its other keys."""
        rest = {name: value for name, value in data.items() if name not in POSE_KEYS}
        if len(rest) < len(data):
            rest["pose"] = Pose.from_mapping({name: data[name] for name in POSE_KEYS if name in data})
        return super().from_mapping(rest, folder)

    def to_mapping(self, folder: Path | None = None) -> dict[str, Any]:
        """Return the step as a mapping for `read_step`."""
        ((kind, values),) = super().to_mapping(folder).items()
        return {kind: {**values.pop("pose", {}), **values}}


@dataclass(frozen=True)
class Move(_Target):
    """A planned collision-free motion to a pose or region of the tip, or to a configuration of the arm."""

    kind: ClassVar[str] = "move"
    ways = (*_Target.ways, "configuration", "region")
    configuration: Configuration | None = key(read_configuration, default=None)
    region: GoalRegion | None = key(document.section, default=None, kind=GoalRegion)


@dataclass(frozen=True)
class _Corridor(_Contact):
    """A tool motion in a corridor."""

    # Maximal deviations of the tip from the position [m] and the orientation [rad] of the curve.
    within: float = key(document.number, default=0.001, above=0.0)
    angle: float = key(document.number, default=0.01, above=0.0)
    # The tip may rotate freely about this axis of its frame.
    free_axis: str | None = key(document.one_of, default=None, known=("x", "y", "z"))
    # Speed of the tip [m/s]; default: as fast as the joint limits allow.
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
        """The given targets, by key. `up` or `back` alone is a displacement from the current pose."""
        return super().targets or ({"by": (0.0, 0.0, 0.0)} if self.up or self.back else {})


@dataclass(frozen=True)
class Seam(_Corridor):
    """A motion of the tip along a spline from its current pose through poses in the world."""

    kind: ClassVar[str] = "seam"
    poses: tuple[Pose, ...] = key(document.list_of, factory=tuple, read=document.section, kind=Pose, item_name="pose")
    arm: str | None = key(document.text, default=None)


@dataclass(frozen=True)
class Gripper(_Contact):
    """A motion of gripper joints to values [rad or m], by name. All other joints stand still."""

    kind: ClassVar[str] = "gripper"
    joints: Mapping[str, float] = key(document.mapping_of, read=document.number, factory=dict, item_name="joint")


@dataclass(frozen=True)
class Attach(Step):
    """Attach an obstacle of the scene to the tip at its current pose."""

    kind: ClassVar[str] = "attach"
    object: str = key(document.text)
    arm: str | None = key(document.text, default=None)


@dataclass(frozen=True)
class Detach(Step):
    """Detach a held object. It becomes an obstacle at its current pose."""

    kind: ClassVar[str] = "detach"
    object: str = key(document.text)


@dataclass(frozen=True)
class Wait(_Contact):
    """Stand still for a time [s]."""

    kind: ClassVar[str] = "wait"
    time: float = key(document.number, above=0.0)


KINDS: dict[str, type[Step]] = {step.kind: step for step in (Move, Line, Seam, Gripper, Attach, Detach, Wait)}
# Steps with a short form such as ``{attach: cube}``, and the key that its value is for.
_SHORT = {"attach": "object", "detach": "object", "wait": "time"}


def read_step(key: str, value: Any) -> Step:
    """Return `value` if it is a `Step`, else read it as a mapping of a document."""
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


_POSES = partial(document.list_of, read=document.section, kind=Pose, item_name="pose")


@dataclass(frozen=True)
class Program(Section):
    """A sequence of steps, with candidate grasps and places of objects.

    Parameters
    ----------
    steps : sequence of Step
        `Move`, `Line`, `Seam`, `Gripper`, `Attach`, `Detach` and `Wait`.
    grasps : mapping of str to sequence of Pose
        Candidate poses of the tip for grasping, in the frame of the object, by object.
    places : mapping of str to sequence of Pose
        Candidate poses for placing the object, in the world, by object.

    Examples
    --------
    >>> program = Scenario.load("panda_pick_place").program
    >>> len(program.steps)
    11
    """

    steps: tuple[Step, ...] = key(document.list_of, read=read_step, item_name="step")
    grasps: Mapping[str, tuple[Pose, ...]] = key(document.mapping_of, factory=dict, read=_POSES)
    places: Mapping[str, tuple[Pose, ...]] = key(document.mapping_of, factory=dict, read=_POSES)

    @property
    def gripper_joints(self) -> tuple[str, ...]:
        """The joints that `Gripper` steps move."""
        return tuple(dict.fromkeys(name for step in self.steps if isinstance(step, Gripper) for name in step.joints))

    def check(self) -> None:
        """Raise InputError if a step needs grasps or places that the program does not have."""
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
