"""Minimum clearance: a distance that links must keep from chosen obstacles."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from safe_ompl.errors import InputError, UnknownNameError
from safe_ompl.scene.scene import Scene


@dataclass(frozen=True)
class MinClearance:
    """A distance that links must keep from obstacles.

    Attributes
    ----------
    distance : float
        [m]
    obstacles : tuple of str
        From which.
    exempt : frozenset of (str, str)
        Pairs of a link and an obstacle that need not keep it, only not touch.
    """

    distance: float
    obstacles: tuple[str, ...]
    exempt: frozenset[tuple[str, str]]

    @classmethod
    def of(
        cls,
        distance: float,
        obstacles: Sequence[str] | None,
        exempt: Sequence[tuple[str, str]],
        scene: Scene,
        links: Sequence[str],
    ) -> MinClearance | None:
        """Return what is asked for; None where the distance is 0.

        Parameters
        ----------
        distance : float
            [m] 0 requires nothing.
        obstacles : sequence of str or None
            Keep it from these; None: from those with a danger weight, such as people.
        exempt : sequence of (str, str)
            Pairs of a link and an obstacle that need not keep it, only not touch.
        scene : Scene
            The obstacles.
        links : sequence of str
            The links that have bodies.

        Raises
        ------
        InputError
            If the distance is not a finite number ≥ 0, or there is nothing to keep it from.
        UnknownNameError
            If there is no such obstacle or link.
        """
        if not (isinstance(distance, (int, float, np.number)) and np.isfinite(distance) and distance >= 0):
            raise InputError(f"min clearance must be a length >= 0 [m], got {distance!r}")
        if isinstance(obstacles, str) or not (obstacles is None or isinstance(obstacles, Sequence)):
            raise InputError(f"obstacles must be a list of names, got {obstacles!r}")
        names = [o.name for o in scene if o.weight > 0] if obstacles is None else obstacles
        chosen = tuple(scene[name].name for name in names)
        for pair in exempt:
            if isinstance(pair, str) or not isinstance(pair, Sequence) or len(pair) != 2:
                raise InputError(f"exempt must be pairs of a link and an obstacle, not {pair!r}")
            link, obstacle = pair
            if link not in links:
                raise UnknownNameError("link", link, sorted(set(links)))
            if scene[obstacle].name not in chosen:
                raise InputError(
                    f"{link!r} is exempt from keeping a distance to {obstacle!r}, which is not asked for"
                )
        if not distance:
            return None
        if not chosen:
            raise InputError("min clearance: no obstacle has a danger weight > 0; name those to keep it from")
        return cls(float(distance), chosen, frozenset((link, obstacle) for link, obstacle in exempt))

    def between(self, link: str, obstacle: str) -> float:
        """Return the distance [m] that a link must keep from an obstacle, or 0."""
        return self.distance if obstacle in self.obstacles and (link, obstacle) not in self.exempt else 0.0

    def as_dict(self) -> dict[str, Any]:
        """Return it as plain numbers, lists and strings."""
        exempt = sorted([link, obstacle] for link, obstacle in self.exempt)
        return {"distance": self.distance, "obstacles": list(self.obstacles), "exempt": exempt}
