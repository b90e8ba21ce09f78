"""Fingers, told from arms by how the joints branch, so that a hand and not a finger is the end of the arm."""

from __future__ import annotations

import logging

import numpy as np
import pinocchio as pin

from safe_ompl.arrays import FloatArray
from safe_ompl.robot.joints.reduction import farthest_body

_log = logging.getLogger(__name__)

_MOST_JOINTS = 5  # of a finger
_LONGEST = 0.25  # [m], from the first joint of a finger to the farthest frame that it carries
_ALIKE = 2.0  # lengths of two fingers differ by no more than this factor,
_SHORT = 0.05  # [m] shorter ones count as this long


def default_tip(full: pin.Model, model: pin.Model) -> str:
    """Return the body farthest from the base; where that is a finger, the farthest one of the hand that carries it.

    Parameters
    ----------
    full : pin.Model
        All joints of the URDF.
    model : pin.Model
        Those that move.
    """
    farthest = farthest_body(model)
    fingers = finger_links(full)
    if farthest not in fingers:
        return farthest
    joint = next(frame.parentJoint for frame in model.frames if _is_body(frame) and frame.name == farthest)
    below = [frame.name for frame in model.frames if frame.parentJoint in list(model.supports[joint])[1:]]
    hand = farthest_body(model, tuple(name for name in below if name not in fingers))
    if hand is None:
        return farthest
    _log.info("tip: %s, the body before the fingers (%s)", hand, ", ".join(sorted(fingers)))
    return hand


def finger_links(full: pin.Model) -> frozenset[str]:
    """Return the links that two or more similar short chains of joints carry, which branch off a moving link."""
    data = full.createData()
    pin.framesForwardKinematics(full, data, pin.neutral(full))
    found: set[str] = set()
    for palm in range(1, full.njoints):
        branches = [joint for joint in range(1, full.njoints) if full.parents[joint] == palm]
        lengths = {joint: _length(full, data, joint) for joint in branches}
        fingers = {joint for joint in branches if _is_finger(full, joint, lengths[joint])}
        if any(_alike(full, a, b, lengths) for a in fingers for b in fingers if a != b):
            carried = {joint for finger in fingers for joint in full.subtrees[finger]}
            found |= {frame.name for frame in full.frames if _is_body(frame) and frame.parentJoint in carried}
    return frozenset(found)


def _is_body(frame: pin.Frame) -> bool:
    return bool(frame.type == pin.FrameType.BODY)


def _is_finger(full: pin.Model, joint: int, length: float) -> bool:
    subtree = list(full.subtrees[joint])
    return (
        len(subtree) <= _MOST_JOINTS and length <= _LONGEST and all(full.joints[j].nv == 1 for j in subtree)
    )


def _alike(full: pin.Model, a: int, b: int, lengths: dict[int, float]) -> bool:
    longer, shorter = (pick(max(lengths[a], _SHORT), max(lengths[b], _SHORT)) for pick in (max, min))
    return longer <= _ALIKE * shorter and _slides(full, a) == _slides(full, b)


def _slides(full: pin.Model, joint: int) -> bool:
    return "P" in full.joints[joint].shortname()[10:]


def _length(full: pin.Model, data: pin.Data, joint: int) -> float:
    carried = set(full.subtrees[joint])
    ends: FloatArray = np.array(
        [data.oMf[k].translation for k, frame in enumerate(full.frames) if frame.parentJoint in carried]
    )
    return float(np.linalg.norm(ends - data.oMi[joint].translation, axis=1).max(initial=0.0))
