"""The joints of a robot that move: limits, which are held and at which values, and the model that remains."""

from __future__ import annotations

import logging
from collections.abc import Collection, Iterable, Mapping
from pathlib import Path

import numpy as np
import pinocchio as pin

from safe_ompl.common import FloatArray, InputError, UnknownNameError
from safe_ompl.robot.joint_tables import Mimic, frame_index

_log = logging.getLogger(__name__)


def joints_that_move(full: pin.Model, tip: str, mimics: Mapping[str, Mimic]) -> set[str]:
    """Return the joints that move the tip, and those that such a joint mimics; chains of `mimics` are resolved."""
    frame = full.frames[frame_index(full, tip)]
    above = {full.names[joint] for joint in list(full.supports[frame.parentJoint])[1:]}
    return above | {mimic.primary for name, mimic in mimics.items() if name in above}


def report_held(full: pin.Model, held: Mapping[str, float], moving: Collection[str], text: str) -> None:
    """Say in a warning which joints are held at zero; of a gripper beyond the joints that move, at a lower level."""
    names = list(held)
    supports = {name: full.supports[full.getJointId(name)] for name in names}
    # All that move are below these.
    beyond = {name for name in names if {full.names[j] for j in supports[name]}.issuperset(moving)}
    for level, some in (
        (logging.WARNING, [name for name in names if name not in beyond]),
        (logging.INFO, [name for name in names if name in beyond]),
    ):
        if some:
            values = ", ".join(f"{name} = {held[name]:g}" for name in some)
            _log.log(level, "%s: %s (locked= or locked_state= take another posture)", text, values)


_LINK = " (link)"  # tells a link from a joint of the same name


def override_limits(full: pin.Model, limits: Mapping[str, tuple[float, float]], source: str) -> None:
    """Replace limits [rad or m] of the joints named; raise InputError if there is no such joint, or none has limits."""
    for name, (low, high) in limits.items():
        if not full.existJointName(name):
            raise UnknownNameError("joint with limits", name, list(full.names)[1:], source)
        joint = full.joints[full.getJointId(name)]
        if joint.nq != 1:
            raise InputError(f"joint {name!r} is continuous: it has no limits", source)
        full.lowerPositionLimit[joint.idx_q] = low
        full.upperPositionLimit[joint.idx_q] = high


def with_mimics(
    full: pin.Model, mimics: Mapping[str, Mimic], held: Mapping[str, float], source: str
) -> dict[str, float]:
    """Return the joints to lock with their values, checked: those `held` [rad or m], and those that mimic them.

    Chains of `mimics` are resolved. Raises InputError if a joint to hold does not exist, its value cannot be, or a
    joint mimics one that does not exist.
    """
    names = list(full.names)[1:]
    locked: dict[str, float] = {}
    for name, value in held.items():
        if name not in names:
            raise UnknownNameError("joint to lock", name, names, source)
        _check_value(full, name, value, source)
        locked[name] = value
    for name, mimic in mimics.items():
        if name not in names or name in held:
            continue
        if mimic.primary not in names:
            raise UnknownNameError(f"joint that {name!r} mimics", mimic.primary, names, source)
        if mimic.primary in held or mimic.multiplier == 0:
            locked[name] = mimic.multiplier * locked.get(mimic.primary, 0.0) + mimic.offset
    implied = ", ".join(f"{name} = {value:g}" for name, value in locked.items() if name not in held)
    if implied:
        _log.info("%s: locked, too, as they mimic joints that are held: %s", Path(source).name, implied)
    return locked


def joints_without_range(full: pin.Model, names: Iterable[str]) -> dict[str, float]:
    """Return those of the joints whose limits are one value, which they can only be held at [rad or m]."""
    joints = {name: full.joints[full.getJointId(name)] for name in names}
    ranges = {name: _range(full, joint) for name, joint in joints.items() if joint.nq == 1}
    return {name: low for name, (low, high) in ranges.items() if low == high}


def _check_value(full: pin.Model, name: str, value: float, source: str) -> None:
    joint = full.joints[full.getJointId(name)]
    if joint.nv > 1 and value != 0:
        raise InputError(f"locked joint {name!r}: a {joint.shortname()} can be locked at 0 only", source)
    if joint.nq == 1:
        low, high = _range(full, joint)
        if not low - 1e-9 <= value <= high + 1e-9:
            raise InputError(f"locked joint {name!r}: {value:g} is outside its limits [{low:g}, {high:g}]", source)


def _range(model: pin.Model, joint: pin.JointModel) -> tuple[float, float]:
    """Return the limits of a joint with one coordinate [rad or m]."""
    return float(model.lowerPositionLimit[joint.idx_q]), float(model.upperPositionLimit[joint.idx_q])


def resting_value(full: pin.Model, name: str) -> float:
    """Return zero, or the limit nearest to it."""
    joint = full.joints[full.getJointId(name)]
    if joint.nq != 1:
        return 0.0
    low, high = _range(full, joint)
    return min(max(0.0, low), high)


def reduce_model(
    full: pin.Model, geometry: pin.GeometryModel, held: Mapping[str, float]
) -> tuple[pin.Model, pin.GeometryModel]:
    """Return model and geometry with the joints in `held` fixed at their values."""
    reference = pin.neutral(full)
    for name, value in held.items():
        joint = full.joints[full.getJointId(name)]
        if joint.nv == 1:
            reference[joint.idx_q : joint.idx_q + joint.nq] = value if joint.nq == 1 else (np.cos(value), np.sin(value))
    ids = [full.getJointId(name) for name in held]
    # Pinocchio 4.1 looks frames up by name alone, and refuses where a joint and a link share one.
    distinct = full.copy()
    for frame in distinct.frames:
        frame.name += _LINK if frame.type == pin.FrameType.BODY else ""
    model, reduced = pin.buildReducedModel(distinct, geometry, ids, reference)
    # It also makes the frame of a locked joint its own parent.
    above = {frame.name: distinct.frames[frame.parentFrame].name for frame in distinct.frames}
    index = {frame.name: k for k, frame in enumerate(model.frames)}
    for frame in model.frames:
        frame.parentFrame = index[above[frame.name]]
    for frame in model.frames:
        frame.name = frame.name.removesuffix(_LINK)
    return model, reduced


def check_plannable(model: pin.Model, source: str, stiff: Collection[str] = ()) -> None:
    """Raise InputError if no joint is free, or one of a kind that cannot be planned for.

    The joints in `stiff` are held as their limits are one value.
    """
    if model.njoints < 2:
        why = f": the limits of {', '.join(sorted(stiff))} leave no range; limits= gives others" if stiff else ""
        raise InputError(f"no joint is free to move{why}", source)
    for name, joint in zip(list(model.names)[1:], list(model.joints)[1:], strict=True):
        if joint.nv != 1 or joint.shortname().startswith(("JointModelH", "JointModelMimic")):
            raise InputError(
                f"joint {name!r} is a {joint.shortname()}; only revolute, prismatic and continuous joints "
                "can be planned for: lock it",
                source,
            )


def apply_mimic_limits(model: pin.Model, mimics: Mapping[str, Mimic], source: str) -> None:
    """Narrow the limits of joints that others mimic, so that these keep to theirs, which become what is left of them.

    Raises InputError if a continuous joint is mimicked: its mimic joint would have no place at ±π.
    """
    lower, upper = model.lowerPositionLimit.copy(), model.upperPositionLimit.copy()
    single = {name: _coordinate(model, name) for name in mimics}
    for name, mimic in mimics.items():
        first, own = _coordinate(model, mimic.primary), single[name]
        if first is None:
            raise InputError(f"joint {name!r} mimics {mimic.primary!r}, which is continuous: lock one of them", source)
        if own is None:
            continue  # it is continuous
        low, high = sorted((float(end) - mimic.offset) / mimic.multiplier for end in (lower[own], upper[own]))
        if low > lower[first] or high < upper[first]:
            lower[first], upper[first] = max(low, lower[first]), min(high, upper[first])
            _log.info(
                "%s: %s keeps to [%g, %g], so that %s keeps to its limits",
                *(source, mimic.primary, lower[first], upper[first], name),
            )
    for name, mimic in mimics.items():
        first, own = _coordinate(model, mimic.primary), single[name]
        if own is not None:
            ends = (mimic.multiplier * float(end) + mimic.offset for end in (lower[first], upper[first]))
            lower[own], upper[own] = sorted(ends)
    model.lowerPositionLimit, model.upperPositionLimit = lower, upper


def _coordinate(model: pin.Model, name: str) -> int | None:
    """Return where the value of a joint is in Pinocchio's configuration; None for continuous joints."""
    joint = model.joints[model.getJointId(name)]
    return int(joint.idx_q) if joint.nq == 1 else None


def joint_limits(model: pin.Model, source: str) -> tuple[FloatArray, FloatArray]:
    """Return lower and upper limits (n,) [rad or m], ±π where joints are continuous; InputError if one has no range."""
    joints = list(model.joints)[1:]
    limits = np.array([_range(model, joint) if joint.nq == 1 else (-np.pi, np.pi) for joint in joints])
    for name, (low, high) in zip(list(model.names)[1:], limits, strict=True):
        if not (np.isfinite(low) and np.isfinite(high) and low < high):
            raise InputError(f"joint {name!r} has the limits [{low}, {high}]: no range to plan in; lock it", source)
    lower, upper = np.ascontiguousarray(limits.T)
    return lower, upper
