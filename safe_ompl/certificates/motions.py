"""Issues certificates of motions of polynomials that are proven (`MotionCheck`): the verifier divides them itself."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from safe_ompl.certificates.issue import _KIND, Pairs, opening
from safe_ompl.certificates.verifier.verify import verify
from safe_ompl.collision import MotionProver, TipBounds, ToolOrientation
from safe_ompl.common import CertificateError, InputError, PlanningError
from safe_ompl.danger import DangerLimit
from safe_ompl.io import schema
from safe_ompl.motions import Motion, MotionCheck


def motion_certificate(
    check: MotionCheck, *, spacing: float | None = None, source: Mapping[str, Any] | None = None
) -> dict[str, Any]:
    """Return the certificate of a motion that is proven, as plain numbers, lists and strings.

    Parameters
    ----------
    check : MotionCheck
        The motion, and what is proven of it: all of that is claimed. It is verified at once.
    spacing : float, optional
        Distance between the danger points of its limit of the danger [m]; default: the scene's own.
    source : mapping, optional
        Where robot and scene come from: kept as it is. They travel inside in any case.

    Raises
    ------
    PlanningError
        If the motion is not proven, or too little is left for the verifier's plain means.
    InputError
        If a limit of it has no claim, as stops beside people, or its danger points are not the scene's.
    """
    if not check:
        more = f", and {len(check.violations) - 1} more" * (len(check.violations) > 1)
        raise PlanningError(f"the motion is not proven, and has no certificate: {check.violations[0]}{more}")
    if check.people is not None:
        raise InputError("stops of such motions have no claim: check it without people", "people")
    proof, separation = check.proof, check.separation
    robot, scene = proof.checker.robot, proof.checker.scene
    clear, speeds = separation.min_clearance, dict(separation.speeds)
    content = {
        **opening(robot, scene, source),
        "path": [],
        "pairs": [list(names) for names in Pairs(robot, scene).names],
        "clearance": None if clear is None else clear.as_dict(),
        "danger": None,
        "moving_obstacles": {"speeds": speeds, "time": separation.time} if speeds else None,
        "also_sampled": None,
        "edges": [],
        **_limits(proof, scene.spacing if spacing is None else spacing),
        "motion": _motion(check.motion)
        | ({} if check.limits is None else {kind: getattr(check.limits, kind) for kind in check.limits.kinds})
        | ({"speeds": dict(check.speeds)} if check.speeds else {}),
    }
    content |= {"margin": separation.margin} if separation.margin else {}
    content |= {"tube": separation.tube} if separation.tube else {}
    plain: dict[str, Any] = schema.as_plain(content)
    signed = {**plain, "digest": schema.digest(plain)}
    try:
        verify(signed, robot, scene)
    except CertificateError as error:
        raise PlanningError(
            f"the motion is proven, but cannot be certified by plain means: {error}"
        ) from None
    return signed


def _motion(motion: Motion) -> dict[str, Any]:
    said = motion.to_mapping()
    return {key: said[key] for key in ("times", "coefficients", "timed", "slack", "rounding") if key in said}


def _limits(proof: MotionProver, spacing: float) -> dict[str, Any]:
    """Return what is claimed of danger and tool in plain numbers."""
    found: dict[str, Any] = {}
    tool: dict[str, Any] = {}
    for limit in proof.limits:
        if isinstance(limit, DangerLimit) and "danger" not in found:
            field, points = limit.field, proof.checker.scene.danger_points(spacing)[0]
            if field.points is None or not np.array_equal(field.points, points):
                raise InputError(
                    f"the danger points of the field are not those of the scene, {spacing:g} m apart",
                    "spacing",
                )
            kind = {name: getattr(field, name) for name in _KIND}
            found["danger"] = {"bound": limit.limit, "spacing": spacing, **kind}
        elif isinstance(limit, ToolOrientation) and "orientation" not in tool:
            tool["orientation"] = limit.as_dict()
        elif isinstance(limit, TipBounds) and "position" not in tool:
            tool["position"] = limit.as_dict()
        else:
            name = getattr(limit, "name", type(limit).__name__)
            raise InputError(
                f"no certificate has a claim of {name!r}, or of a second one of its kind", "limits"
            )
    return {**found, **({"tool": tool} if tool else {})}
