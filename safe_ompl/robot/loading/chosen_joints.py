"""Which joints are planned for, and the posture in which the others are held: from tip, group, locks and states."""

from __future__ import annotations

import logging
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from pathlib import Path

import pinocchio as pin

from safe_ompl.common import InputError, UnknownNameError
from safe_ompl.robot.joint_tables import Mimic
from safe_ompl.robot.loading.reduction import resting_value
from safe_ompl.robot.loading.srdf import SrdfFile
from safe_ompl.robot.skeleton import frame_index

_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class JointChoice:
    """What a user says of the joints that are planned for, and of the others; see `Robot.from_urdf`.

    Attributes
    ----------
    tip, group : str or None
        Frame to move; group of the SRDF whose joints move.
    locked : mapping of str to float
        Joints to hold [rad or m].
    locked_state : str or None
        State of the SRDF with the values of the other joints that are held.
    srdf : str or None
        File of the SRDF.
    """

    tip: str | None
    locked: Mapping[str, float]
    srdf: str | None = None
    group: str | None = None
    locked_state: str | None = None

    def group_tip(self, full: pin.Model, source: str) -> str | None:
        """Return the tip of the group if it is a chain or carries an end effector; None without a group."""
        return None if self.group is None else self.semantics("group", source).group_tip(self.group, full)

    def semantics(self, key: str, source: str) -> SrdfFile:
        """Return the SRDF, which the argument `key` needs; raise InputError if there is none."""
        if self.srdf is None:
            raise InputError(f"{key} is a name of an SRDF: give the SRDF", source)
        return SrdfFile(self.srdf)


def joints_and_posture(
    full: pin.Model, mimics: Mapping[str, Mimic], choice: JointChoice, source: str
) -> dict[str, float]:
    """Return all joints to hold with their values [rad or m], except those that mimic others.

    Held are the locked joints, and those that are not in the group or, without a group, do not move the tip, not even
    through a joint that mimics them. The latter keep the values of the locked state; or those of the locked joints, if
    these leave no joint free and so can only be meant as a posture; or zero, which a warning says.

    Parameters
    ----------
    full : pin.Model
        All joints.
    mimics : mapping of str to Mimic
        Which of them mimic which, chains resolved.
    choice : JointChoice
        What the user wants.
    source : str
        The URDF, for messages.

    Raises
    ------
    InputError
        If group, state, or a joint does not exist, or there is a state but no joint to hold.
    """
    names = [name for name in list(full.names)[1:] if name not in mimics]
    locked, tip, group, locked_state = choice.locked, choice.tip, choice.group, choice.locked_state
    for name in locked:
        if not full.existJointName(name):
            raise UnknownNameError("joint to lock", name, list(full.names)[1:], source)
    posture: Mapping[str, float] = {}
    if locked_state is not None:
        posture = choice.semantics("locked_state", source).state(locked_state)
    if tip is None and group is None:
        if locked_state is not None:
            raise InputError(
                "locked_state is the posture of joints that are held: give a tip or a group", source
            )
        return dict(locked)
    moving = _moving(full, mimics, choice, source)
    free = [name for name in names if name in moving]
    if locked_state is None and free and all(name in locked for name in free):
        posture, locked = locked, {}
    moving = _moving(full, _without(mimics, locked), choice, source)
    held = dict(locked)
    idle = [name for name in names if name not in moving and name not in held]
    for name in idle:
        held[name] = posture.get(name, resting_value(full, name))
    unsaid = [name for name in idle if name not in posture]
    purpose = f"not in the group {group!r}" if group is not None else f"not moving {tip!r}"
    _report(full, unsaid, held, moving, f"{Path(source).name}: held, as {purpose}")
    return held


def _moving(
    full: pin.Model, mimics: Mapping[str, Mimic], choice: JointChoice, source: str
) -> Collection[str]:
    """Return the joints of the group or, without a group, those that move the tip."""
    if choice.group is not None:
        return choice.semantics("group", source).group_joints(choice.group, full)
    assert choice.tip is not None
    tip = full.frames[frame_index(full, choice.tip)]
    above = {full.names[j] for j in list(full.supports[tip.parentJoint])[1:]}
    return above | {mimic.primary for name, mimic in mimics.items() if name in above}


def _without(mimics: Mapping[str, Mimic], locked: Mapping[str, float]) -> dict[str, Mimic]:
    return {name: mimic for name, mimic in mimics.items() if name not in locked}


def _report(
    full: pin.Model, names: list[str], held: Mapping[str, float], moving: Collection[str], text: str
) -> None:
    """Say in a warning which joints are held at zero; of a gripper beyond the joints that move, at a lower level."""
    beyond = {name for name in names if _beyond(full, name, moving)}
    for level, some in (
        (logging.WARNING, [name for name in names if name not in beyond]),
        (logging.INFO, [name for name in names if name in beyond]),
    ):
        if some:
            values = ", ".join(f"{name} = {held[name]:g}" for name in some)
            _log.log(level, "%s: %s (locked= or locked_state= take another posture)", text, values)


def _beyond(full: pin.Model, name: str, moving: Collection[str]) -> bool:
    """Return whether all that move are below the joint."""
    below = {full.names[j] for j in full.supports[full.getJointId(name)]}
    return below.issuperset(moving)
