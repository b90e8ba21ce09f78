"""Claims of the danger in a certificate, at rest or in motion: whether they have a meaning, and of which kind."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from safe_ompl import document
from safe_ompl.errors import CertificateError, InputError, UnknownNameError
from safe_ompl.scene.scene import Scene
from safe_ompl.scene.shapes.cloud import PointCloud

if TYPE_CHECKING:
    from safe_ompl.danger.field import DangerField

_CHOICES = {"aggregate": ("max", "mean", "softmax"), "weighting": ("unit", "length")}
_POSITIVE = ("spacing", "k1", "sharpness")
_MOVING = ("k2", "gamma")
_MOST_POINTS = 1e6  # danger points: more of them would not fit into the memory


def check_danger(claim: Mapping[str, Any], scene: Scene, *, moving: bool = False) -> None:
    """Raise InputError unless a claim of danger, at rest or in motion, has a meaning for a scene."""
    more = _MOVING if moving else ()
    document.check_keys(claim, ("bound", *_POSITIVE, *_CHOICES, *more))
    for key in ("bound", *more):
        document.number(key, document.require(claim, key), at_least=0.0)
    for key in _POSITIVE:
        document.number(key, document.require(claim, key), above=0.0)
    for key, known in _CHOICES.items():
        if document.require(claim, key) not in known:
            raise UnknownNameError(key, claim[key], known)
    points = _surface(scene) / float(claim["spacing"]) / float(claim["spacing"])
    if not points < _MOST_POINTS:
        raise InputError(f"{claim['spacing']!r} m asks for about {points:.0e} danger points", "spacing")


def _surface(scene: Scene) -> float:
    """Return about the surface [m²] on which danger points lie; that of a cloud has no more points than the cloud."""
    area = 0.0
    for obstacle in scene:
        if obstacle.weight > 0 and not isinstance(obstacle.shape, PointCloud):
            for _, shape, _ in obstacle.geometries():
                shape.computeLocalAABB()
                a, b, c = np.ravel(shape.aabb_local.max_ - shape.aabb_local.min_)
                area += 2.0 * float(a * b + b * c + c * a)
    return area


def check_kind(claim: Mapping[str, Any], field: DangerField, spacing: float, *, moving: bool = False) -> None:
    """Raise CertificateError unless a claim of danger is of a field's kind: another k₁ makes any bound small."""
    keys = ("k1", "sharpness", *_CHOICES, *(_MOVING if moving else ()))
    asked = {"spacing": spacing, **{key: getattr(field, key) for key in keys}}
    for key, value in asked.items():
        if claim[key] != value:
            name = "danger in motion" if moving else "danger"
            raise CertificateError(f"{name}: {key} is {claim[key]!r} in its claim, {value!r} is asked for")
