"""The arm of a robot as its URDF tells it: which joints are the arm's, which links are fingers, where the arm ends."""

from __future__ import annotations

import logging
import re
from collections.abc import Collection, Iterable

import numpy as np
import pinocchio as pin

from safe_ompl.common import FloatArray

_log = logging.getLogger(__name__)

_MOST_JOINTS = 8  # of a finger
_LONGEST = 0.25  # [m], from the first joint of a finger to the farthest frame that it carries
_ALIKE = 2.0  # lengths of two fingers differ by no more than this factor,
_SHORT = 0.05  # [m] shorter ones count as this long
_LEAST_ARM = 4  # joints that move on their own; what is shorter than that is no arm on a torso

# Words in names of joints that open and close a gripper, and of joints that are a wrist all the same.
_FINGER = re.compile(r"finger|gripper|jaw|knuckle|thumb")
_WRIST = re.compile(r"wrist|roll|pitch|yaw")
_PART_OF_FINGER = re.compile(r"finger|jaw|knuckle|thumb")
# Words in names of links that are no end of an arm.
_SENSOR = re.compile(r"camera|optical|accelerometer|gyro|lidar|laser|sensor|infra|depth|(^|_)(imu|range|rgb|scan)(_|$)")


def default_tip(full: pin.Model, model: pin.Model) -> str:
    """Return the body farthest from the base; where that is a finger, the farthest one of the hand that carries it.

    Bodies whose names are those of sensors count only where there are no others. `full` has all joints of the URDF,
    `model` those that move.
    """
    bodies = _bodies(model)
    bodies = [body for body in bodies if not _SENSOR.search(body.name.lower())] or bodies
    farthest = _farthest(model, bodies)
    fingers = finger_links(full) | {body.name for body in bodies if _PART_OF_FINGER.search(body.name.lower())}
    if farthest.name not in fingers:
        return str(farthest.name)
    below = set(list(model.supports[farthest.parentJoint])[1:])
    hand = [body for body in bodies if body.parentJoint in below and body.name not in fingers]
    if not hand:
        return str(farthest.name)
    tip = str(_farthest(model, hand).name)
    _log.info("tip: %s, the body before the fingers (%s)", tip, ", ".join(sorted(fingers)))
    return tip


def finger_links(full: pin.Model) -> frozenset[str]:
    """Return the links of fingers, which `finger_joints` carry."""
    carried = finger_joints(full)
    return frozenset(body.name for body in _bodies(full) if full.names[body.parentJoint] in carried)


def finger_joints(full: pin.Model) -> frozenset[str]:
    """Return the joints of fingers: of two or more similar short chains of joints that branch off a moving link.

    Also what is carried by a joint whose name says that it moves a finger, unless all joints have such names.
    """
    data = full.createData()
    pin.framesForwardKinematics(full, data, pin.neutral(full))
    carried: set[int] = set()
    for palm in range(1, full.njoints):
        branches = [joint for joint in range(1, full.njoints) if full.parents[joint] == palm]
        lengths = {joint: _length(full, data, joint) for joint in branches}
        fingers = {joint for joint in branches if _is_finger(full, joint, lengths[joint])}
        if any(_alike(full, a, b, lengths) for a in fingers for b in fingers if a != b):
            carried |= {joint for finger in fingers for joint in full.subtrees[finger]}
    named = {joint for joint in range(1, full.njoints) if _is_named_finger(full.names[joint])}
    below = {joint for finger in named for joint in full.subtrees[finger]}
    if len(below) < full.njoints - 1:
        carried |= below
    return frozenset(full.names[joint] for joint in carried)


def arm_joints(full: pin.Model, tip: str, followers: Collection[str] = ()) -> tuple[str, ...]:
    """Return the joints of the arm that ends at the body `tip`, the first one first.

    An arm begins where nothing else branches off below it any more: neither another arm nor wheels, a head or legs.
    Branches that leave fewer than four joints (a camera on the wrist) do not count, nor do fingers. Joints that cannot
    be planned for (a floating base, a base that slides without limits) are no part of an arm. `full` has all joints of
    the URDF; `followers` are those that mimic others.
    """
    body = next(frame for frame in full.frames if frame.name == tip)
    chain = list(full.supports[body.parentJoint])[1:]
    names = finger_joints(full).union(followers)
    ignored = {joint for joint in range(1, full.njoints) if full.names[joint] in names}
    first = 0
    for k, joint in enumerate(chain[:-1]):
        others = set(full.subtrees[joint]) - set(chain) - ignored
        moving = [j for j in chain[k + 1 :] if j not in ignored]
        if others and len(moving) >= _LEAST_ARM:
            first = k + 1
    first = max([first, *(k + 1 for k, joint in enumerate(chain) if not has_range(full, joint))])
    return tuple(full.names[joint] for joint in chain[first:])


def has_range(full: pin.Model, joint: int) -> bool:
    """Return whether a joint can be planned for: it has one value, and limits unless it is continuous."""
    kind = full.joints[joint]
    if kind.nv != 1 or kind.nq != 1:
        return bool(kind.nv == 1)
    ends = np.array([full.lowerPositionLimit[kind.idx_q], full.upperPositionLimit[kind.idx_q]])
    return bool(np.isfinite(ends).all() and (np.abs(ends) < np.finfo(np.float32).max).all())


def _farthest(model: pin.Model, bodies: Iterable[pin.Frame]) -> pin.Frame:
    """Return the body with the most joints above it, of those the one farthest from the last joint."""

    def rank(frame: pin.Frame) -> tuple[int, float]:
        offset = float(np.linalg.norm(frame.placement.translation))
        return len(model.supports[frame.parentJoint]), offset

    return max(bodies, key=rank)


def _bodies(model: pin.Model) -> list[pin.Frame]:
    return [frame for frame in model.frames if frame.type == pin.FrameType.BODY]


def _is_named_finger(joint: str) -> bool:
    name = joint.lower()
    return bool(_FINGER.search(name)) and not _WRIST.search(name)


def _is_finger(full: pin.Model, joint: int, length: float) -> bool:
    subtree = list(full.subtrees[joint])
    return len(subtree) <= _MOST_JOINTS and length <= _LONGEST and all(full.joints[j].nv == 1 for j in subtree)


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
