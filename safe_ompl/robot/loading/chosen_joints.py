"""Which joints are planned for, and the posture in which the others are held: from tip, group, locks and states."""

from __future__ import annotations

import logging
from collections.abc import Collection, Mapping
from pathlib import Path

import pinocchio as pin

from safe_ompl.common import InputError, UnknownNameError
from safe_ompl.robot.joint_tables import Mimic
from safe_ompl.robot.loading.reduction import resting_value
from safe_ompl.robot.loading.srdf import SrdfFile
from safe_ompl.robot.skeleton import frame_index

_log = logging.getLogger(__name__)


def joints_and_posture(
    full: pin.Model,
    mimics: Mapping[str, Mimic],
    locked: Mapping[str, float],
    *,
    tip: str | None,
    group: str | None,
    locked_state: str | None,
    srdf: str | None,
    source: str,
) -> dict[str, float]:
    """Return all joints to hold with their values [rad or m], except those that mimic others.

    Held are the joints of `locked`, and those that are not in the group or, without a group, do not move the tip, not
    even through a joint that mimics them. The latter keep the values of the state `locked_state`; or those of
    `locked`, if that leaves no joint free and so can only be meant as a posture; or zero, which a warning says.

    Parameters
    ----------
    full : pin.Model
        All joints.
    mimics : mapping of str to Mimic
        Which of them mimic which, chains resolved.
    locked : mapping of str to float
        Joints to hold.
    tip, group, locked_state : str, optional
        Frame to move; group and state of the SRDF.
    srdf : str, optional
        The SRDF.
    source : str
        The URDF, for messages.

    Raises
    ------
    InputError
        If group, state, or a joint does not exist, or there is a state but no joint to hold.
    """
    names = [name for name in list(full.names)[1:] if name not in mimics]
    for name in locked:
        if not full.existJointName(name):
            raise UnknownNameError("joint to lock", name, list(full.names)[1:], source)
    posture: Mapping[str, float] = {}
    if locked_state is not None:
        posture = _srdf(srdf, "locked_state", source).state(locked_state)
    if tip is None and group is None:
        if locked_state is not None:
            raise InputError(
                "locked_state is the posture of joints that are held: give a tip or a group", source
            )
        return dict(locked)
    moving = _moving(full, mimics, tip, group, srdf, source)
    free = [name for name in names if name in moving]
    if locked_state is None and free and all(name in locked for name in free):
        posture, locked = locked, {}
    moving = _moving(full, _without(mimics, locked), tip, group, srdf, source)
    held = dict(locked)
    idle = [name for name in names if name not in moving and name not in held]
    for name in idle:
        held[name] = posture.get(name, resting_value(full, name))
    unsaid = [name for name in idle if name not in posture]
    purpose = f"not in the group {group!r}" if group is not None else f"not moving {tip!r}"
    _report(full, unsaid, held, moving, f"{Path(source).name}: held, as {purpose}")
    return held


def group_tip(full: pin.Model, srdf: str | None, group: str | None, source: str) -> str | None:
    """Return the tip of a group that is a chain or carries an end effector; None without a group."""
    return None if group is None else _srdf(srdf, "group", source).group_tip(group, full)


def _moving(
    full: pin.Model,
    mimics: Mapping[str, Mimic],
    tip: str | None,
    group: str | None,
    srdf: str | None,
    source: str,
) -> Collection[str]:
    if group is not None:
        return _srdf(srdf, "group", source).group_joints(group, full)
    assert tip is not None
    above = {full.names[j] for j in list(full.supports[full.frames[frame_index(full, tip)].parentJoint])[1:]}
    return above | {mimic.primary for name, mimic in mimics.items() if name in above}


def _without(mimics: Mapping[str, Mimic], locked: Mapping[str, float]) -> dict[str, Mimic]:
    return {name: mimic for name, mimic in mimics.items() if name not in locked}


def _srdf(srdf: str | None, key: str, source: str) -> SrdfFile:
    if srdf is None:
        raise InputError(f"{key} is a name of an SRDF: give the SRDF", source)
    return SrdfFile(srdf)


def _report(
    full: pin.Model, names: list[str], held: Mapping[str, float], moving: Collection[str], text: str
) -> None:
    """Say in a warning which joints are held at zero; of a gripper beyond the joints that move, in a lower voice."""
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
