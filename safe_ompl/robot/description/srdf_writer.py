"""Writing an SRDF: links that follow each other, and links that touch in nearly all of many sampled configurations."""

from __future__ import annotations

import logging
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from xml.sax.saxutils import quoteattr

import numpy as np
import pinocchio as pin

from safe_ompl.arrays import FloatArray
from safe_ompl.robot.bodies.self_collision import adjacent_pairs, always_in_contact, sample_configurations
from safe_ompl.robot.description.collision_shapes import build_collision_geometry, make_convex
from safe_ompl.robot.description.urdf import UrdfFile
from safe_ompl.robot.joints.coupling import Mimic

_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class DisabledLinks:
    """Two links that need not be checked against each other, and why: "Adjacent" or "Always"."""

    first: str
    second: str
    reason: str


def disabled_links(urdf: UrdfFile, samples: int, collision: str = "required") -> list[DisabledLinks]:
    """Return the pairs of links that a robot without an SRDF does not check: with all joints free, on convex hulls.

    Links that are merely never seen in contact are not among them: samples prove nothing.

    Parameters
    ----------
    urdf : UrdfFile
        The robot.
    samples : int
        How many configurations to look at.
    collision : str
        What collides; see `Robot.from_urdf`.
    """
    model = urdf.build_model()
    geometry = build_collision_geometry(urdf, model, collision)
    make_convex(geometry)
    geometry.addAllCollisionPairs()
    adjacent = adjacent_pairs(model, geometry)
    together = _links(model, geometry, geometry.collisionPairs)
    for pair in adjacent:
        geometry.removeCollisionPair(pair)
    always = always_in_contact(model, geometry, _samples(model, urdf.mimics(), samples))
    found = [DisabledLinks(a, b, "Adjacent") for a, b in _links(model, geometry, adjacent)]
    for (a, b), count in _links(model, geometry, always).items():
        if count == together[a, b]:
            found.append(DisabledLinks(a, b, "Always"))
        else:
            _log.info("%s, %s: only some of their shapes always touch; an SRDF cannot say which", a, b)
    return found


def srdf_text(robot: str, pairs: Iterable[DisabledLinks], samples: int) -> str:
    """Return an SRDF for the robot of that name; `samples` is said in a comment."""
    lines = [
        '<?xml version="1.0"?>',
        f"<!-- Always: in contact in more than 95 % of {samples} configurations spread over the joint limits. -->",
        f"<robot name={quoteattr(robot)}>",
        *(
            f"  <disable_collisions link1={quoteattr(pair.first)} link2={quoteattr(pair.second)} "
            f"reason={quoteattr(pair.reason)}/>"
            for pair in pairs
        ),
        "</robot>",
    ]
    return "\n".join(lines) + "\n"


def _links(
    model: pin.Model, geometry: pin.GeometryModel, pairs: Iterable[pin.CollisionPair]
) -> dict[tuple[str, str], int]:
    """For each pair of links, how many of the pairs of shapes are theirs."""
    counted: dict[tuple[str, str], int] = {}
    for pair in pairs:
        bodies = (geometry.geometryObjects[k] for k in (pair.first, pair.second))
        first, second = (model.frames[body.parentFrame].name for body in bodies)
        counted[first, second] = counted.get((first, second), 0) + 1
    return counted


def _samples(model: pin.Model, mimics: Mapping[str, Mimic], count: int) -> FloatArray:
    """Return configurations within the limits (a whole turn where there are none), with mimics where they belong."""
    bounded = model.copy()
    for name in ("lowerPositionLimit", "upperPositionLimit"):
        limit = np.nan_to_num(getattr(bounded, name), posinf=np.pi, neginf=-np.pi)
        setattr(bounded, name, np.clip(limit, -1e3, 1e3))
    rows = sample_configurations(bounded, count)
    for name, mimic in mimics.items():
        joints = [model.joints[model.getJointId(joint)] for joint in (name, mimic.primary)]
        if all(joint.nq == 1 for joint in joints):
            own, first = (joint.idx_q for joint in joints)
            rows[:, own] = mimic.multiplier * rows[:, first] + mimic.offset
    return rows
