"""Which pairs of a robot's own bodies are worth checking against each other."""

from __future__ import annotations

import logging
from collections.abc import Container
from hashlib import sha256
from pathlib import Path

import coal
import numpy as np
import pinocchio as pin

from safe_ompl.common import FloatArray, InputError, cache, warn_once

_log = logging.getLogger(__name__)

_SAMPLES = 1000
_ALWAYS = 0.95  # share of the samples in contact from which a pair counts as always in contact
_NAMED = 6  # pairs in a warning; all of them in the log's details
_BATCH = 16  # samples between two looks at which pairs are decided
_KEY_SAMPLES = 5
_METHOD = 1  # goes into the cache's key: to be raised whenever another answer may come out


def select_self_pairs(
    model: pin.Model, geometry: pin.GeometryModel, srdf: str | None, samples: FloatArray, robot: str
) -> None:
    """Add to `geometry` the pairs of the robot's own bodies that are worth checking.

    Pairs that the SRDF disables go. Where it disables none, those of adjacent links go. Of the rest, those in
    contact in more than 95 % of the sampled configurations go: no configuration could be free otherwise. What is
    dropped, and is not disabled by the SRDF, is logged; pairs that merely were never seen in contact stay.

    Parameters
    ----------
    model, geometry : pin.Model, pin.GeometryModel
        Kinematics and bodies.
    srdf : str or None
        File of the SRDF.
    samples : ndarray, shape (S, nq)
        Configurations in Pinocchio's form.
    robot : str
        Name for the log.

    Raises
    ------
    InputError
        If the SRDF is not one.
    """
    geometry.addAllCollisionPairs()
    before = len(geometry.collisionPairs)
    if srdf is not None:
        _disable_pairs(model, geometry, Path(srdf))
    removed = before - len(geometry.collisionPairs)
    if removed:
        _log.info("%s: %d self-collision pairs disabled by %s", robot, removed, srdf)
    else:
        reason = "no SRDF (`safe-ompl srdf` writes one)" if srdf is None else f"{srdf} disables no pair"
        adjacent = adjacent_pairs(model, geometry)
        names = _drop(geometry, adjacent)
        if names:
            warn_once(_log, f"{robot}: {reason}: {len(names)} pairs of adjacent links are not checked")
            _log.info("%s: adjacent links that are not checked: %s", robot, ", ".join(names))
    touching = remembered_contacts(model, geometry, samples)
    names = _drop(geometry, touching)
    if names:
        more = f" and {len(names) - _NAMED} more" if len(names) > _NAMED else ""
        named = ", ".join(names[:_NAMED])
        warn_once(
            _log, f"{robot}: not checked, as in contact in over {_ALWAYS:.0%} of samples: {named}{more}"
        )
        if more:
            _log.info("%s: always in contact: %s", robot, ", ".join(names))


def _disable_pairs(model: pin.Model, geometry: pin.GeometryModel, srdf: Path) -> None:
    try:
        pin.removeCollisionPairsFromXML(model, geometry, srdf.read_text(encoding="utf-8"), False)
    except (ValueError, RuntimeError) as error:
        raise InputError(f"not a valid SRDF ({error})", str(srdf)) from None


def sample_configurations(model: pin.Model, count: int = _SAMPLES) -> FloatArray:
    """Return configurations (`count`, nq) spread over the joint ranges; always the same ones."""
    rng = np.random.default_rng(0)
    velocities = rng.uniform(-np.pi, np.pi, (count, model.nv))
    neutral = pin.neutral(model)
    rows = np.array([pin.integrate(model, neutral, v) for v in velocities])
    for joint in list(model.joints)[1:]:  # the first is the fixed base, which claims a coordinate it has not
        if joint.nq == 1:
            low, high = model.lowerPositionLimit[joint.idx_q], model.upperPositionLimit[joint.idx_q]
            rows[:, joint.idx_q] = rng.uniform(low, high, count)
    return rows


def _adjacent(
    model: pin.Model, geometry: pin.GeometryModel, pair: pin.CollisionPair, carriers: Container[int]
) -> bool:
    """Return whether a single joint, and no third body, is between the two links of a pair."""
    a, b = (geometry.geometryObjects[k] for k in (pair.first, pair.second))
    below, above = (a, b) if model.parents[a.parentJoint] == b.parentJoint else (b, a)
    if model.parents[below.parentJoint] != above.parentJoint:
        return False
    frame = model.frames[below.parentFrame].parentFrame
    while frame not in carriers and frame != 0:
        frame = model.frames[frame].parentFrame
    return bool(frame == above.parentFrame)


def adjacent_pairs(model: pin.Model, geometry: pin.GeometryModel) -> list[pin.CollisionPair]:
    """Return the pairs of `geometry` whose links follow each other, a single joint between them."""
    carriers = {part.parentFrame for part in geometry.geometryObjects}
    return [pair for pair in _pairs(geometry) if _adjacent(model, geometry, pair, carriers)]


def remembered_contacts(
    model: pin.Model, geometry: pin.GeometryModel, samples: FloatArray
) -> list[pin.CollisionPair]:
    """Return what `always_in_contact` does, from the cache on disk if the same was asked for before."""
    pairs = _pairs(geometry)
    if not pairs:
        return []
    key = _key(model, geometry, samples)
    known = cache.read("self-pairs", key)
    if isinstance(known, list) and all(isinstance(k, int) and 0 <= k < len(pairs) for k in known):
        # Distances differ in the eleventh decimal between a process in which these bodies were asked about before they
        # were copied and one in which they were not. They must not depend on what an earlier run has kept.
        pin.computeCollisions(
            model, model.createData(), geometry, pin.GeometryData(geometry), samples[0], False
        )
        return [pairs[k] for k in known]
    found = always_in_contact(model, geometry, samples)
    numbers = {(pair.first, pair.second): k for k, pair in enumerate(pairs)}
    cache.write("self-pairs", key, [numbers[pair.first, pair.second] for pair in found])
    return found


def always_in_contact(
    model: pin.Model, geometry: pin.GeometryModel, samples: FloatArray
) -> list[pin.CollisionPair]:
    """Return the pairs in contact in more than 95 % of the samples (S, nq).

    A pair is looked at until it has been free in 5 % of the samples, which for most is soon.
    """
    pairs = _pairs(geometry)
    data, contacts = model.createData(), pin.GeometryData(geometry)
    undecided, free = np.arange(len(pairs)), np.zeros(len(pairs))
    for start in range(0, len(samples), _BATCH):
        for q in samples[start : start + _BATCH]:
            pin.computeCollisions(model, data, geometry, contacts, q, False)
            results = contacts.collisionResults
            free[undecided] += [not results[k].isCollision() for k in undecided.tolist()]
        decided = len(samples) - free[undecided] <= _ALWAYS * len(samples)
        for k in undecided[decided].tolist():
            contacts.deactivateCollisionPair(k)
        undecided = undecided[~decided]
        if not len(undecided):
            break
    return [pairs[k] for k in undecided]


def _key(model: pin.Model, geometry: pin.GeometryModel, samples: FloatArray) -> str:
    """Return a hash of all that decides which pairs touch: kinematics, bodies, pairs, samples, and library versions."""
    state = sha256(f"{_METHOD} {_ALWAYS} {pin.__version__} {coal.__version__}".encode())
    data = model.createData()
    for q in samples[:_KEY_SAMPLES]:  # joints are known by where they bring their bodies
        pin.forwardKinematics(model, data, q)
        state.update(b"".join(placement.homogeneous.tobytes() for placement in data.oMi))
    for part in geometry.geometryObjects:
        state.update(f"{part.name} {part.parentJoint} ".encode() + part.placement.homogeneous.tobytes())
        state.update(_content(part.geometry))
    state.update(np.array([(pair.first, pair.second) for pair in geometry.collisionPairs]).tobytes())
    state.update(str(samples.shape).encode() + samples.tobytes())
    return state.hexdigest()


def _content(shape: coal.CollisionGeometry) -> bytes:
    """Return the bytes of a shape's kind, sizes and corners."""
    kind = type(shape).__name__.encode()
    if isinstance(shape, coal.ConvexBase):
        return kind + np.asarray(shape.points()).tobytes()
    if isinstance(shape, coal.BVHModelBase):
        triangles = [tuple(shape.tri_indices(k)[i] for i in range(3)) for k in range(shape.num_tris)]
        return kind + np.asarray(shape.vertices()).tobytes() + np.array(triangles).tobytes()
    sizes = (getattr(shape, name, 0.0) for name in ("halfSide", "radius", "halfLength", "radii"))
    return kind + b"".join(np.asarray(size, dtype=np.float64).tobytes() for size in sizes)


def _pairs(geometry: pin.GeometryModel) -> list[pin.CollisionPair]:
    """Return copies of the pairs: an element of Pinocchio's vector changes when others are removed."""
    return [pin.CollisionPair(pair.first, pair.second) for pair in geometry.collisionPairs]


def _drop(geometry: pin.GeometryModel, pairs: list[pin.CollisionPair]) -> list[str]:
    """Remove pairs of `geometry`; return their names."""
    names = [
        f"{geometry.geometryObjects[pair.first].name}–{geometry.geometryObjects[pair.second].name}"
        for pair in pairs
    ]
    for pair in pairs:
        geometry.removeCollisionPair(pair)
    return names
