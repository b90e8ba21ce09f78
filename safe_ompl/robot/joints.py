"""The joints of a robot: arm, finger, mimic and held joints, the reduced model, and the skeleton."""

from __future__ import annotations

import logging
import re
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pinocchio as pin

from safe_ompl.common import FloatArray, InputError, IntArray, UnknownNameError, told_apart

_log = logging.getLogger(__name__)

# A finger has at most this many joints.
_MOST_JOINTS = 8
# A finger is at most this long, from its first joint to the farthest frame that it carries.
_LONGEST = 0.25  # [m]
# The lengths of two fingers of a hand differ at most by this factor.
_ALIKE = 2.0
# Shorter fingers count as this long.
_SHORT = 0.05  # [m]
# A chain with fewer independent joints is not an arm on a torso.
_LEAST_ARM = 4

# Words in the names of gripper joints, and of wrist joints that are not gripper joints in spite of such a word.
_FINGER = re.compile(r"finger|gripper|jaw|knuckle|thumb")
_WRIST = re.compile(r"wrist|roll|pitch|yaw")
_PART_OF_FINGER = re.compile(r"finger|jaw|knuckle|thumb")
# Words in the names of links that are never the end of an arm.
_SENSOR = re.compile(r"camera|optical|accelerometer|gyro|lidar|laser|sensor|infra|depth|(^|_)(imu|range|rgb|scan)(_|$)")
# A limit of at least this counts as no limit.
_UNLIMITED = float(np.finfo(np.float32).max)
# This is appended to the name of a link if a joint has the same name.
_LINK = " (link)"


@dataclass(frozen=True)
class Mimic:
    """A joint that follows another one: value = multiplier · primary + offset."""

    primary: str
    multiplier: float
    offset: float


def default_tip(full: pin.Model, model: pin.Model) -> str:
    """Return the body farthest from the base. If this body is a finger, return the farthest body of its hand."""

    def rank(body: pin.Frame) -> tuple[int, float]:
        """Return the number of joints above a body, and its distance [m] from the last joint."""
        return len(model.supports[body.parentJoint]), float(np.linalg.norm(body.placement.translation))

    bodies = [frame for frame in model.frames if frame.type == pin.FrameType.BODY]
    bodies = [body for body in bodies if not _SENSOR.search(body.name.lower())] or bodies
    farthest, carried = max(bodies, key=rank), finger_joints(full)
    fingers = {f.name for f in full.frames if f.type == pin.FrameType.BODY and full.names[f.parentJoint] in carried}
    fingers |= {body.name for body in bodies if _PART_OF_FINGER.search(body.name.lower())}
    below = set(list(model.supports[farthest.parentJoint])[1:])
    hand = [body for body in bodies if body.parentJoint in below and body.name not in fingers]
    if farthest.name not in fingers or not hand:
        return str(farthest.name)
    tip = str(max(hand, key=rank).name)
    _log.info("tip: %s, the body before the fingers (%s)", tip, ", ".join(sorted(fingers)))
    return tip


def finger_joints(full: pin.Model) -> frozenset[str]:
    """Return the finger joints: those of at least two short, similar chains that branch off a moving link."""
    data = full.createData()
    pin.framesForwardKinematics(full, data, pin.neutral(full))

    def length(joint: int) -> float:
        carried = set(full.subtrees[joint])
        ends = [data.oMf[k].translation for k, frame in enumerate(full.frames) if frame.parentJoint in carried]
        return max((float(np.linalg.norm(end - data.oMi[joint].translation)) for end in ends), default=0.0)

    carried: set[int] = set()
    for palm in range(1, full.njoints):
        lengths = {joint: length(joint) for joint in range(1, full.njoints) if full.parents[joint] == palm}
        fingers = {
            joint: (max(lengths[joint], _SHORT), "P" in full.joints[joint].shortname()[10:])  # a prismatic one
            for joint in lengths
            if len(full.subtrees[joint]) <= _MOST_JOINTS
            and lengths[joint] <= _LONGEST
            and all(full.joints[j].nv == 1 for j in full.subtrees[joint])
        }
        if any(
            fingers[a][0] <= fingers[b][0] <= _ALIKE * fingers[a][0] and fingers[a][1] == fingers[b][1]
            for a in fingers
            for b in fingers
            if a != b
        ):
            carried |= {joint for finger in fingers for joint in full.subtrees[finger]}
    names = {joint: full.names[joint].lower() for joint in range(1, full.njoints)}
    named = [joint for joint, name in names.items() if _FINGER.search(name) and not _WRIST.search(name)]
    below = {joint for finger in named for joint in full.subtrees[finger]}
    if len(below) < full.njoints - 1:
        carried |= below
    return frozenset(full.names[joint] for joint in carried)


def arm_joints(full: pin.Model, tip: str, followers: Collection[str] = ()) -> tuple[str, ...]:
    """Return the joints of the arm that ends at the body `tip`, in order from the base.

    The arm begins after the last joint that also carries another branch: another arm, wheels, a head or legs.
    A branch is ignored if it would leave fewer than four joints. Fingers and mimic joints (`followers`) are ignored,
    too. Joints that cannot be planned are not part of an arm.
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
    """Return whether a joint can be planned: it has one degree of freedom, and is continuous or has finite limits."""
    ends = limits_of(full, full.names[joint]) or (0.0, 0.0)
    return full.joints[joint].nv == 1 and all(abs(end) < _UNLIMITED for end in ends)


def limits_of(model: pin.Model, name: str) -> tuple[float, float] | None:
    """Return the limits of a joint [rad or m], or None if it is continuous or has several values."""
    joint = model.joints[model.getJointId(name)]
    if joint.nq != 1:
        return None
    return float(model.lowerPositionLimit[joint.idx_q]), float(model.upperPositionLimit[joint.idx_q])


def joints_that_move(full: pin.Model, tip: str, mimics: Mapping[str, Mimic]) -> set[str]:
    """Return the joints that move the tip, and the joints that these mimic; `mimics` must be `resolved`."""
    frame = full.frames[frame_index(full, tip)]
    above = {full.names[joint] for joint in list(full.supports[frame.parentJoint])[1:]}
    return above | {mimic.primary for name, mimic in mimics.items() if name in above}


def report_held(full: pin.Model, held: Mapping[str, float], moving: Collection[str], text: str) -> None:
    """Warn which joints are held, with their values. Joints beyond the moving ones are logged at the level INFO."""
    for level, beyond in ((logging.WARNING, False), (logging.INFO, True)):
        values = []
        for name, value in held.items():
            above = {full.names[joint] for joint in full.supports[full.getJointId(name)]}
            if above.issuperset(moving) == beyond:
                values.append(f"{name} = {value:g}")
        if values:
            _log.log(level, "%s: %s (locked= takes another posture)", text, ", ".join(values))


def override_limits(full: pin.Model, limits: Mapping[str, tuple[float, float]], source: str) -> None:
    """Replace limits [rad or m] of the named joints, in place. Raises InputError for an unknown or continuous joint."""
    for name, (low, high) in limits.items():
        if not full.existJointName(name):
            raise UnknownNameError("joint with limits", name, list(full.names)[1:], source)
        joint = full.joints[full.getJointId(name)]
        if joint.nq != 1:
            raise InputError(f"joint {name!r} is continuous: it has no limits", source)
        full.lowerPositionLimit[joint.idx_q] = low
        full.upperPositionLimit[joint.idx_q] = high


def resolved(mimics: Mapping[str, Mimic], source: str) -> dict[str, Mimic]:
    """Return `mimics` with chains (a joint that mimics a mimic joint) replaced by direct relations.

    Raises InputError for a cycle; the message starts with `source`.
    """
    found = {}
    for name, mimic in mimics.items():
        seen = [name]
        while mimic.primary in mimics:
            if mimic.primary in seen:
                raise InputError(f"joints mimic each other in a circle: {', '.join(seen)}", source)
            seen.append(mimic.primary)
            above = mimics[mimic.primary]
            mimic = Mimic(
                above.primary, mimic.multiplier * above.multiplier, mimic.multiplier * above.offset + mimic.offset
            )
        found[name] = mimic
    return found


def with_mimics(
    full: pin.Model, mimics: Mapping[str, Mimic], held: Mapping[str, float], source: str
) -> dict[str, float]:
    """Return the values of the `held` joints [rad or m] and of the joints that mimic them. Raises InputError."""
    names = list(full.names)[1:]
    for name, value in held.items():
        if name not in names:
            raise UnknownNameError("joint to lock", name, names, source)
        joint, (low, high) = full.joints[full.getJointId(name)], limits_of(full, name) or (-np.inf, np.inf)
        if joint.nv > 1 and value != 0:
            raise InputError(f"locked joint {name!r}: a {joint.shortname()} can be locked at 0 only", source)
        if not low - 1e-9 <= value <= high + 1e-9:
            shown = told_apart(value, low, high)
            raise InputError(
                f"locked joint {name!r}: {shown[0]} is outside its limits [{shown[1]}, {shown[2]}]", source
            )
    implied = {}
    for name, mimic in mimics.items():
        if name not in names or name in held:
            continue
        if mimic.primary not in names:
            raise UnknownNameError(f"joint that {name!r} mimics", mimic.primary, names, source)
        if mimic.primary in held or mimic.multiplier == 0:
            implied[name] = mimic.multiplier * held.get(mimic.primary, 0.0) + mimic.offset
    if implied:
        values = ", ".join(f"{name} = {value:g}" for name, value in implied.items())
        _log.info("%s: locked, too, as they mimic joints that are held: %s", Path(source).name, values)
    return {**held, **implied}


def joints_without_range(full: pin.Model, names: Iterable[str]) -> dict[str, float]:
    """Return the named joints whose lower and upper limits are equal, with this value [rad or m]."""
    return {name: ends[0] for name in names if (ends := limits_of(full, name)) is not None and ends[0] == ends[1]}


def resting_value(full: pin.Model, name: str) -> float:
    """Return zero, clipped to the limits of the joint [rad or m]."""
    low, high = limits_of(full, name) or (0.0, 0.0)
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
    # Pinocchio 4.1 finds frames by name only, and fails if a joint and a link have the same name.
    distinct = full.copy()
    for frame in distinct.frames:
        frame.name += _LINK if frame.type == pin.FrameType.BODY else ""
    model, reduced = pin.buildReducedModel(distinct, geometry, ids, reference)
    # Pinocchio also makes the frame of a locked joint its own parent.
    above = {frame.name: distinct.frames[frame.parentFrame].name for frame in distinct.frames}
    index = {frame.name: k for k, frame in enumerate(model.frames)}
    for frame in model.frames:
        frame.parentFrame = index[above[frame.name]]
    for frame in model.frames:
        frame.name = frame.name.removesuffix(_LINK)
    return model, reduced


def check_plannable(model: pin.Model, source: str, stiff: Collection[str] = ()) -> None:
    """Raise InputError if no joint is free, or a joint has a type that cannot be planned."""
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
    """Narrow the limits of joints that others mimic, so that the mimic joints stay within their own limits."""
    known = {name: limits_of(model, name) for name in list(model.names)[1:]}
    # Continuous joints have no limits.
    limits = {name: ends for name, ends in known.items() if ends is not None}
    for name, mimic in mimics.items():
        if mimic.primary not in limits:
            raise InputError(f"joint {name!r} mimics {mimic.primary!r}, which is continuous: lock one of them", source)
        if name in limits:
            low, high = sorted((end - mimic.offset) / mimic.multiplier for end in limits[name])
            least, largest = limits[mimic.primary]
            if low > least or high < largest:
                low, high = limits[mimic.primary] = max(low, least), min(high, largest)
                text = "%s: %s keeps to [%g, %g], so that %s keeps to its limits"
                _log.info(text, source, mimic.primary, low, high, name)
    for name, mimic in mimics.items():
        if name in limits:
            low, high = sorted(mimic.multiplier * end + mimic.offset for end in limits[mimic.primary])
            limits[name] = low, high
    override_limits(model, limits, source)


def joint_limits(model: pin.Model, source: str) -> tuple[FloatArray, FloatArray]:
    """Return lower and upper limits (n,) [rad or m], ±π for continuous joints. Raises InputError for an empty range."""
    limits = np.array([limits_of(model, name) or (-np.pi, np.pi) for name in list(model.names)[1:]])
    for name, (low, high) in zip(list(model.names)[1:], limits, strict=True):
        if not (-_UNLIMITED < low < high < _UNLIMITED):
            raise InputError(f"joint {name!r} has the limits [{low}, {high}]: no range to plan in; lock it", source)
    lower, upper = np.ascontiguousarray(limits.T)
    return lower, upper


# Joints nearer to each other than this, as in a spherical wrist, count as coincident.
_ZERO_LENGTH = 1e-6  # [m]


@dataclass(frozen=True, eq=False, repr=False)
class RobotSkeleton:
    """K key points of a robot and the segments between them (paper §3, eq. 2).

    Key points are the origins of `frames: (K,)`, the tip last, at `offsets: (K, 3)` [m] in the frames of Pinocchio's
    `joints: (K,)`. `segments: (L, 2)` has the proximal and the distal key point of each segment, `names: (L,)` the
    frame at its distal end. Segments of zero length, and segments that no joint moves, are left out.
    """

    joints: IntArray
    offsets: FloatArray
    segments: IntArray
    names: tuple[str, ...]
    frames: tuple[int, ...]

    @classmethod
    def from_model(cls, model: pin.Model, joint_names: Sequence[str], tips: Sequence[str]) -> RobotSkeleton:
        """Build the skeleton of `model`, whose locked joints are reduced to frames."""
        first, *others = (frame_index(model, tip) for tip in tips)
        on_chain = {frame for tip in (first, *others) for frame in _way_to_root(model, tip)}
        # These are the frames of joints, free or locked. A link may have the same name.
        named = reversed(list(enumerate(model.frames)))
        of = {frame.name: k for k, frame in named if frame.type != pin.FrameType.BODY}
        frames = [of[name] for name in joint_names if of[name] in on_chain or model.existJointName(name)]
        frames += [*others, first]
        index = {frame: k for k, frame in enumerate(frames)}
        joints = np.array([model.frames[frame].parentJoint for frame in frames], dtype=np.intp)
        offsets = np.array([model.frames[frame].placement.translation for frame in frames], dtype=np.float64)

        stretched = _frame_positions(model, frames)
        segments, names = [], []
        for distal, frame in enumerate(frames):
            above = (index[k] for k in _way_to_root(model, model.frames[frame].parentFrame) if k in index)
            proximal = next(above, None)
            if proximal is None or joints[proximal] == 0:
                continue
            lengths = np.linalg.norm(stretched[:, distal] - stretched[:, proximal], axis=1)
            if lengths.max() > _ZERO_LENGTH:
                segments.append((proximal, distal))
                names.append(model.frames[frame].name)
        pairs = np.array(segments, dtype=np.intp).reshape(-1, 2)
        return cls(joints, offsets, pairs, tuple(names), tuple(frames))

    def nearest(self, model: pin.Model, frame: int) -> int | None:
        """Return the first frame from `frame` (included) to the base that is a key point, or None."""
        return next((above for above in _way_to_root(model, frame) if above in self.frames), None)


def frame_index(model: pin.Model, name: str) -> int:
    """Return the index of the frame called `name`. If a joint and a link have this name, return the link's frame."""
    matches = [k for k, frame in enumerate(model.frames) if frame.name == name]
    bodies = [k for k in matches if model.frames[k].type == pin.FrameType.BODY]
    return (bodies or matches)[0]


def _frame_positions(model: pin.Model, frames: list[int]) -> FloatArray:
    """Return positions (3, K, 3) [m] of frames with all joints at zero, at the lower and at the upper limits.

    Prismatic joints change the lengths of segments between these postures.
    """
    data, positions = model.createData(), []
    for limit in (pin.neutral(model), model.lowerPositionLimit, model.upperPositionLimit):
        q = pin.neutral(model)
        for joint in list(model.joints)[1:]:
            if joint.nq == 1:
                q[joint.idx_q] = limit[joint.idx_q]
        pin.framesForwardKinematics(model, data, q)
        positions.append([data.oMf[frame].translation.copy() for frame in frames])
    return np.array(positions)


def _way_to_root(model: pin.Model, frame: int) -> Iterator[int]:
    """Yield the frames from `frame` to the root, without the root."""
    while frame != 0:
        yield frame
        frame = model.frames[frame].parentFrame
