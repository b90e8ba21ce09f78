"""What a certificate claims besides freedom: that its clearance and its danger are ones that can be claimed.

Without this a claim could be empty, such as a distance from an obstacle that is not there, or weaken the proof: a
negative distance would let bodies overlap.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

from safe_ompl import document
from safe_ompl.danger.field import DangerField
from safe_ompl.errors import CertificateError, InputError, UnknownNameError
from safe_ompl.robot.robot import Robot
from safe_ompl.scene.scene import Scene

_CHOICES = {"aggregate": ("max", "mean", "softmax"), "weighting": ("unit", "length")}
_POSITIVE = ("spacing", "k1", "sharpness")


def check_claims(content: Mapping[str, Any], robot: Robot, scene: Scene) -> None:
    """Raise InputError, naming key and value, unless the claims of a certificate have a meaning."""
    if content["clearance"] is not None:
        with document.within("clearance"):
            _check_clearance(document.mapping("claim", content["clearance"]), robot, scene)
    if content["danger"] is not None:
        with document.within("danger"):
            _check_danger(document.mapping("claim", content["danger"]))


def check_kind(claim: Mapping[str, Any], field: DangerField, spacing: float) -> None:
    """Raise CertificateError unless a claim of danger is of a field's kind: another k₁ makes any bound small."""
    asked = {"spacing": spacing, **{key: getattr(field, key) for key in ("k1", "sharpness", *_CHOICES)}}
    for key, value in asked.items():
        if claim[key] != value:
            raise CertificateError(f"danger: {key} is {claim[key]!r} in its claim, {value!r} is asked for")


def _check_clearance(claim: Mapping[str, Any], robot: Robot, scene: Scene) -> None:
    document.check_keys(claim, ("distance", "obstacles", "exempt"))
    document.number("distance", document.require(claim, "distance"), at_least=0.0)
    obstacles = document.sequence("obstacles", document.require(claim, "obstacles"))
    if not obstacles:
        raise InputError("must name an obstacle at least", "obstacles")
    for name in obstacles:
        _check_known("obstacle", name, scene.names)
    links = sorted({body.name.rsplit("_", 1)[0] for body in robot.shared.collision_model.geometryObjects})
    for pair in document.sequence("exempt", document.require(claim, "exempt")):
        names = document.sequence("exempt", pair)
        if len(names) != 2:
            raise InputError(f"must be pairs of a link and an obstacle, not {pair!r}", "exempt")
        _check_known("link", names[0], links)
        _check_known("obstacle", names[1], obstacles)


def _check_danger(claim: Mapping[str, Any]) -> None:
    document.check_keys(claim, ("bound", *_POSITIVE, *_CHOICES))
    document.number("bound", document.require(claim, "bound"), at_least=0.0)
    for key in _POSITIVE:
        document.number(key, document.require(claim, key), above=0.0)
    for key, known in _CHOICES.items():
        _check_known(key, document.require(claim, key), known)


def _check_known(kind: str, name: Any, known: Iterable[str]) -> None:
    if name not in tuple(known):
        raise UnknownNameError(kind, name, known)
