"""Collision geometry of a robot: shapes of the URDF, convex hulls, and self-collision pairs."""

from __future__ import annotations

import logging
from collections.abc import Container, Iterable, Mapping
from typing import TYPE_CHECKING, Literal

import coal
import numpy as np
import pinocchio as pin

from safe_ompl.common import FloatArray, InputError, warn_once
from safe_ompl.geometry import DISTANCE_ERROR, convex_hull
from safe_ompl.robot.joints import Mimic
from safe_ompl.robot.urdf import UrdfFile

if TYPE_CHECKING:
    from safe_ompl.robot.srdf import SrdfFile

_log = logging.getLogger(__name__)

# Thickness of the hulls of flat meshes, such as stickers.
_THICKNESS = 2e-4  # [m]
# A smaller mass is rounding, or a dummy mass for a simulator.
_NO_MASS = 1e-6  # [kg]

CollisionSource = Literal["required", "visual"]
"""With "visual", links without collision shapes use their visual shapes; with "required", they do not collide."""


def build_collision_geometry(urdf: UrdfFile, full: pin.Model, collision: str) -> pin.GeometryModel:
    """Return the collision geometry of all links. With "visual", links without collision shapes use visual shapes."""
    geometry = urdf.build_geometry(full, pin.GeometryType.COLLISION)
    bare = urdf.links_with("visual") - urdf.links_with("collision")
    if collision != "visual" or not bare:
        return geometry
    for part in urdf.build_geometry(full, pin.GeometryType.VISUAL).geometryObjects:
        if full.frames[part.parentFrame].name in bare:
            geometry.addGeometryObject(part)
    _log.info("%s: visual shapes collide, too: those of %s", urdf.path.name, ", ".join(sorted(bare)))
    return geometry


def check_collides(geometry: pin.GeometryModel, collision: str | None, source: str) -> None:
    """Raise InputError if no moving link has a collision shape. `collision` is None for robots from models."""
    if not any(part.parentJoint for part in geometry.geometryObjects):
        remedy = ": its visual shapes are taken with collision='visual' (--collision visual)"
        more = {"required": remedy, "visual": ": it has no visual ones either"}.get(collision or "", "")
        raise InputError(f"no moving link has a collision shape, so collisions cannot be checked{more}", source)


def links_of(model: pin.Model, geometry: pin.GeometryModel | None) -> frozenset[str]:
    """Return the links that have shapes in a geometry."""
    parts = () if geometry is None else geometry.geometryObjects
    return frozenset(model.frames[part.parentFrame].name for part in parts)


def links_lacking_shapes(model: pin.Model, collide: frozenset[str], drawn: frozenset[str]) -> tuple[str, ...]:
    """Return the links, moving or not, that have no collision shape but seem to be physical.

    A link is physical if it has a visual shape. A link without any shape is physical if it has mass, or spans some
    length between shapes on joints before and behind it. Links on fixed joints without visual shapes are only frames.
    """
    frames, fixed = list(model.frames), pin.FrameType.FIXED_JOINT
    links = [frame for frame in frames if frame.type == pin.FrameType.BODY]
    # A model built in code may have joints without links.
    linked = {frame.parentFrame for frame in links}
    links += [f for k, f in enumerate(frames) if f.type == pin.FrameType.JOINT and k not in linked]
    shaped = {frame.parentJoint for frame in links if frame.name in collide | drawn}
    masses = [inertia.mass for inertia in model.inertias]
    for frame in frames:
        # Pinocchio adds the mass of links on fixed joints to the mass of their joint. It is subtracted here.
        masses[frame.parentJoint] -= frame.inertia.mass if frame.type == fixed else 0.0

    def spans(joint: int) -> bool:
        ends = shaped & set(model.supports[joint]), shaped & set(model.subtrees[joint])
        apart = any(model.jointPlacements[child].translation.any() for child in model.children[joint])
        return joint not in shaped and all(ends) and apart

    def exists(frame: pin.Frame) -> bool:
        if frame.name in drawn:
            return True
        if frame.parentFrame and frames[frame.parentFrame].type == fixed:
            return False
        return masses[frame.parentJoint] > _NO_MASS or spans(frame.parentJoint)

    return tuple(frame.name for frame in links if frame.name not in collide and exists(frame))


def warn_of_unchecked(robot: str, links: Iterable[str]) -> None:
    """Log one warning with the moving links that have no collision shapes, if there are any."""
    if names := ", ".join(links):
        warn_once(
            _log,
            f"{robot}: nothing is checked for links that have no collision shape: {names} "
            "(collision='visual' takes visual shapes of those that have any)",
        )


def make_convex(geometry: pin.GeometryModel) -> None:
    """Replace each mesh of `geometry` by its convex hull, in place. Flat meshes get a small thickness."""
    for part in geometry.geometryObjects:
        if isinstance(part.geometry, coal.BVHModelBase):
            part.geometry = convex_hull(part.geometry, part.name, _THICKNESS)


_SAMPLES = 1000
# A pair in contact in more than this share of the samples counts as always in contact.
_ALWAYS = 0.95
# Joints without limits are sampled up to this value.
_LARGEST = 1e3  # [rad or m]
# A warning names at most this many pairs.
_NAMED = 6


def select_self_pairs(
    model: pin.Model, geometry: pin.GeometryModel, srdf: SrdfFile | None, samples: FloatArray, robot: str
) -> None:
    """Add the self-collision pairs to `geometry`, and log the pairs that are not checked.

    Pairs that the SRDF disables are dropped; if it disables none, pairs of adjacent links. Of the rest, pairs in
    contact in more than 95 % of the `samples: (S, nq)` are dropped, since no configuration could be free otherwise.
    """
    geometry.addAllCollisionPairs()
    links = [model.frames[part.parentFrame].name for part in geometry.geometryObjects]
    disabled = [p for p in _pairs(geometry) if srdf is not None and srdf.disables(links[p.first], links[p.second])]
    if disabled:
        _drop(geometry, disabled)
        _log.info("%s: %d self-collision pairs disabled by %s", robot, len(disabled), srdf and srdf.path)
    else:
        reason = "no SRDF (`safe-ompl srdf` writes one)" if srdf is None else f"{srdf.path} disables no pair"
        names = _drop(geometry, adjacent_pairs(model, geometry))
        if names:
            warn_once(_log, f"{robot}: {reason}: {len(names)} pairs of adjacent links are not checked")
            _log.info("%s: adjacent links that are not checked: %s", robot, ", ".join(names))
    names = _drop(geometry, always_in_contact(model, geometry, samples))
    if names:
        more = f" and {len(names) - _NAMED} more" if len(names) > _NAMED else ""
        named = ", ".join(names[:_NAMED])
        warn_once(_log, f"{robot}: not checked, as in contact in over {_ALWAYS:.0%} of samples: {named}{more}")


def sample_configurations(
    model: pin.Model, count: int = _SAMPLES, mimics: Mapping[str, Mimic] | None = None
) -> FloatArray:
    """Return deterministic random configurations (`count`, nq) within the joint ranges; mimic joints are consistent."""
    rng = np.random.default_rng(0)
    velocities = rng.uniform(-np.pi, np.pi, (count, model.nv))
    neutral = pin.neutral(model)
    rows = np.array([pin.integrate(model, neutral, v) for v in velocities])
    for joint in list(model.joints)[1:]:
        # The first joint is the fixed base, which reports a coordinate that does not exist.
        if joint.nq == 1:
            ends = model.lowerPositionLimit[joint.idx_q], model.upperPositionLimit[joint.idx_q]
            low, high = np.clip(np.nan_to_num(ends, posinf=np.pi, neginf=-np.pi), -_LARGEST, _LARGEST)
            rows[:, joint.idx_q] = rng.uniform(low, high, count)
    for name, mimic in (mimics or {}).items():
        joint, first = (model.joints[model.getJointId(n)] for n in (name, mimic.primary))
        values = mimic.multiplier * rows[:, first.idx_q] + mimic.offset
        if joint.nq == 1:
            rows[:, joint.idx_q] = values
        else:
            rows[:, joint.idx_q], rows[:, joint.idx_q + 1] = np.cos(values), np.sin(values)
    return rows


def _adjacent(model: pin.Model, geometry: pin.GeometryModel, pair: pin.CollisionPair, carriers: Container[int]) -> bool:
    """Return whether the two links of a pair are separated by a single joint and no third body."""
    a, b = (geometry.geometryObjects[k] for k in (pair.first, pair.second))
    below, above = (a, b) if model.parents[a.parentJoint] == b.parentJoint else (b, a)
    if model.parents[below.parentJoint] != above.parentJoint:
        return False
    frame = model.frames[below.parentFrame].parentFrame
    while frame not in carriers and frame != 0:
        frame = model.frames[frame].parentFrame
    return bool(frame == above.parentFrame)


def adjacent_pairs(model: pin.Model, geometry: pin.GeometryModel) -> list[pin.CollisionPair]:
    """Return the pairs of `geometry` whose links are separated by a single joint."""
    carriers = {part.parentFrame for part in geometry.geometryObjects}
    return [pair for pair in _pairs(geometry) if _adjacent(model, geometry, pair, carriers)]


def always_in_contact(model: pin.Model, geometry: pin.GeometryModel, samples: FloatArray) -> list[pin.CollisionPair]:
    """Return the pairs in contact in more than 95 % of the samples (S, nq)."""
    pairs = _pairs(geometry)
    data, contacts, free = model.createData(), pin.GeometryData(geometry), dict.fromkeys(range(len(pairs)), 0)
    # Without contacts, coal misses one in ten overlaps of cylinders. Without the margin, it misses flush bodies.
    for request in contacts.collisionRequests:
        request.enable_contact, request.security_margin = True, DISTANCE_ERROR
    for q in samples:
        pin.computeCollisions(model, data, geometry, contacts, q, False)
        for k in list(free):
            free[k] += not contacts.collisionResults[k].isCollision()
            if len(samples) - free[k] <= _ALWAYS * len(samples):
                contacts.deactivateCollisionPair(k)
                del free[k]
        if not free:
            break
    return [pairs[k] for k in free]


def drop_fixed_pairs(geometry: pin.GeometryModel) -> None:
    """Drop the pairs of bodies that do not move relative to each other, because the joints between them are locked."""
    joints = [part.parentJoint for part in geometry.geometryObjects]
    _drop(geometry, [pair for pair in _pairs(geometry) if joints[pair.first] == joints[pair.second]])


def _pairs(geometry: pin.GeometryModel) -> list[pin.CollisionPair]:
    """Return copies of the pairs, because elements of Pinocchio's vector change when others are removed."""
    return [pin.CollisionPair(pair.first, pair.second) for pair in geometry.collisionPairs]


def _drop(geometry: pin.GeometryModel, pairs: list[pin.CollisionPair]) -> list[str]:
    """Remove pairs from `geometry` and return their names."""
    names = [
        f"{geometry.geometryObjects[pair.first].name}–{geometry.geometryObjects[pair.second].name}" for pair in pairs
    ]
    for pair in pairs:
        geometry.removeCollisionPair(pair)
    return names
