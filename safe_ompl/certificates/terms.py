"""What claims are asked to be about, such as the options of a scenario; they agree, or what differs is named."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from math import isclose
from typing import Any

import numpy as np

from safe_ompl.certificates.claims import Certificate
from safe_ompl.common import CertificateError

_SAME = 1e-9  # relative: numbers that are computed from a robot, and differ by less, agree
_COMPUTED = ("velocity", "acceleration", "jerk", "contact")


@dataclass(frozen=True, kw_only=True)
class Terms:
    """What claims are asked to be about, such as the options of a scenario; None where nothing is asked for.

    Attributes
    ----------
    danger : mapping, optional
        Options of the field: aggregate, weighting, k1, sharpness, k2, gamma and the spacing of the danger points [m].
        An empty one: nothing in the scene is dangerous.
    motion : mapping, optional
        `velocity`, `acceleration` and `jerk` (n,), `tool_speed` and `link_speed`; None where there is no limit.
    max_danger : float, optional
        The limit of the danger in motion.
    stops : mapping, optional
        `who`, `speed`, `speeds`, `reaction_time`, `clearance` and `contact`, as in `Stops`. An empty one: there are no
        people.
    """

    danger: Mapping[str, Any] | None = None
    motion: Mapping[str, Any] | None = None
    max_danger: float | None = None
    stops: Mapping[str, Any] | None = None

    def check(self, claims: Certificate) -> None:
        """Raise CertificateError, naming what differs, unless everything that is claimed agrees."""
        timed, motion = claims.trajectory, claims.motion
        self._compare("danger", claims.danger, self.danger)
        if motion is not None and self.motion is not None:
            said = {
                name: limit for name, limit in self.motion.items() if getattr(motion, name, None) is not None
            }
            self._compare("motion", motion if said else None, said)
        if timed is None:
            return
        self._compare("danger in motion", timed.danger, self.danger)
        if self.max_danger is not None:
            self._compare("danger in motion", timed.danger, {"bound": self.max_danger})
        if self.motion is not None:
            said = {name: limit for name, limit in self.motion.items() if getattr(timed, name) is not None}
            self._compare("motion in time", timed, said)
        self._compare("stops", timed.stops, self.stops)

    @staticmethod
    def _compare(what: str, claim: Any, asked: Mapping[str, Any] | None) -> None:
        if claim is None or asked is None:
            return
        if not asked:
            raise CertificateError(
                f"{what}: it is claimed, but there is nothing in the scenario that it is about"
            )
        for name, value in asked.items():
            if hasattr(claim, name) and not _agree(
                getattr(claim, name), value, _SAME if name in _COMPUTED else 0.0
            ):
                mine, asked_for = (_shown(item) for item in (getattr(claim, name), value))
                raise CertificateError(f"{what}: {name} is {mine} in its claim, {asked_for} is asked for")


def _agree(mine: Any, asked: Any, apart: float) -> bool:
    """Return whether two values are the same, numbers but for a relative difference."""
    mine, asked = _listed(mine), _listed(asked)
    if isinstance(mine, Mapping) and isinstance(asked, Mapping):
        return mine.keys() == asked.keys() and all(_agree(mine[part], asked[part], apart) for part in mine)
    if isinstance(mine, list) and isinstance(asked, list):
        return len(mine) == len(asked) and all(_agree(x, y, apart) for x, y in zip(mine, asked, strict=True))
    if isinstance(mine, float) and isinstance(asked, (int, float)):
        return isclose(mine, asked, rel_tol=apart)
    return bool(mine == asked)


def _listed(value: Any) -> Any:
    return list(value) if isinstance(value, (tuple, np.ndarray)) else value


def _shown(value: Any) -> str:
    return repr([float(x) for x in value] if isinstance(value, np.ndarray) else value)
