"""Collision geometry of a robot: convex hulls of its meshes, and the pairs that are worth checking."""

from __future__ import annotations

import logging
from pathlib import Path

import coal
import numpy as np
import pinocchio as pin

from safe_ompl.arrays import FloatArray
from safe_ompl.errors import InputError

_log = logging.getLogger(__name__)

_SAMPLES = 1000
_ALWAYS = 0.95  # share of the samples in contact from which a pair counts as always in contact


def convex_hull(mesh: coal.BVHModelBase, name: str) -> coal.ConvexBase:
    """Return the convex hull of a triangle mesh.

    Raises
    ------
    InputError
        If the mesh is flat: coal's managers drop such shapes in silence.
    """
    vertices = np.asarray(mesh.vertices(), dtype=np.float64)
    spread = vertices - vertices.mean(axis=0) if len(vertices) else np.zeros((1, 3))
    if len(vertices) < 4 or np.linalg.matrix_rank(spread, tol=1e-9) < 3:
        raise InputError(f"mesh of {name!r} is flat (no volume); collision meshes must be solid")
    mesh.buildConvexHull(True, "Qt")
    return mesh.convex


def make_convex(geometry: pin.GeometryModel) -> None:
    """Replace every mesh of `geometry` by its convex hull, in place."""
    for part in geometry.geometryObjects:
        if isinstance(part.geometry, coal.BVHModelBase):
            part.geometry = convex_hull(part.geometry, part.name)


def select_self_pairs(
    model: pin.Model, geometry: pin.GeometryModel, srdf: str | None, samples: FloatArray, robot: str
) -> None:
    """Add to `geometry` the pairs of the robot's own bodies that are worth checking.

    Pairs that the SRDF disables go. Where it disables none, those of adjacent links go. Of the rest, those in
    contact in more than 95 % of the sampled configurations go: no configuration could be free otherwise. What is
    dropped without an SRDF's word is logged; pairs that merely were never seen in contact stay.

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
        reason = "no SRDF" if srdf is None else f"{srdf} disables no pair"
        adjacent = [pair for pair in _pairs(geometry) if _adjacent(model, geometry, pair)]
        _drop(geometry, adjacent, f"{robot}: {reason}; dropped pairs of adjacent links")
    touching = _always_in_contact(model, geometry, samples)
    _drop(geometry, touching, f"{robot}: dropped pairs in contact in over {_ALWAYS:.0%} of samples")


def _disable_pairs(model: pin.Model, geometry: pin.GeometryModel, srdf: Path) -> None:
    try:
        pin.removeCollisionPairsFromXML(model, geometry, srdf.read_text(encoding="utf-8"), False)
    except (ValueError, RuntimeError) as error:
        raise InputError(f"not a valid SRDF ({error})", str(srdf)) from None


def sample_configurations(model: pin.Model) -> FloatArray:
    """Return configurations (S, nq) spread over the joint ranges; always the same ones."""
    rng = np.random.default_rng(0)
    velocities = rng.uniform(-np.pi, np.pi, (_SAMPLES, model.nv))
    neutral = pin.neutral(model)
    rows = np.array([pin.integrate(model, neutral, v) for v in velocities])
    for joint in list(model.joints)[1:]:  # the first is the fixed base, which claims a coordinate it has not
        if joint.nq == 1:
            low, high = model.lowerPositionLimit[joint.idx_q], model.upperPositionLimit[joint.idx_q]
            rows[:, joint.idx_q] = rng.uniform(low, high, _SAMPLES)
    return rows


def _adjacent(model: pin.Model, geometry: pin.GeometryModel, pair: pin.CollisionPair) -> bool:
    """Return whether a single joint, and no third body, is between the two links of a pair."""
    a, b = (geometry.geometryObjects[k] for k in (pair.first, pair.second))
    below, above = (a, b) if model.parents[a.parentJoint] == b.parentJoint else (b, a)
    if model.parents[below.parentJoint] != above.parentJoint:
        return False
    links = {part.parentFrame for part in geometry.geometryObjects}
    frame = model.frames[below.parentFrame].parentFrame
    while frame not in links and frame != 0:
        frame = model.frames[frame].parentFrame
    return bool(frame == above.parentFrame)


def _always_in_contact(
    model: pin.Model, geometry: pin.GeometryModel, samples: FloatArray
) -> list[pin.CollisionPair]:
    data, contacts = model.createData(), pin.GeometryData(geometry)
    hits = np.zeros(len(geometry.collisionPairs))
    for q in samples:
        pin.computeCollisions(model, data, geometry, contacts, q, False)
        hits += [result.isCollision() for result in contacts.collisionResults]
    return [pair for pair, hit in zip(_pairs(geometry), hits, strict=True) if hit > _ALWAYS * len(samples)]


def _pairs(geometry: pin.GeometryModel) -> list[pin.CollisionPair]:
    """Return copies of the pairs: an element of Pinocchio's vector would change under our hands as others go."""
    return [pin.CollisionPair(pair.first, pair.second) for pair in geometry.collisionPairs]


def _drop(geometry: pin.GeometryModel, pairs: list[pin.CollisionPair], why: str) -> None:
    if not pairs:
        return
    names = [
        f"{geometry.geometryObjects[pair.first].name}–{geometry.geometryObjects[pair.second].name}"
        for pair in pairs
    ]
    for pair in pairs:
        geometry.removeCollisionPair(pair)
    _log.warning("%s: %s", why, ", ".join(names))
