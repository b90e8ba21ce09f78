"""Copies of Pinocchio's models that users get to see: whatever is done to them, the robot stays what was proven."""

from __future__ import annotations

import logging
from collections.abc import Callable
from typing import Any

_log = logging.getLogger(__name__)


class Handout:
    """A copy of one of Pinocchio's models, replaced once somebody has changed it.

    The copy is kept: working memory made from a model (GeometryData, broad-phase managers) points into it, and
    Pinocchio does not keep it alive. A new copy for each access would crash who makes such memory in one line and
    uses it in the next.

    Parameters
    ----------
    original : pin.Model or pin.GeometryModel
        Never changed by anybody.
    duplicate : callable
        Returns a copy that shares nothing with its argument.
    name : str
        What it is, for the log.
    """

    def __init__(self, original: Any, duplicate: Callable[[Any], Any], name: str) -> None:
        self._original, self._duplicate, self._name = original, duplicate, name
        self._copies = [duplicate(original)]

    def get(self) -> Any:
        """Return a copy that nobody has changed yet; say so if somebody has changed the one before."""
        if self._copies[-1] != self._original:
            _log.warning(
                "%s was changed, which does not change the robot: use with_attached, with_limits or from_models",
                self._name,
            )
            self._copies.append(self._duplicate(self._original))
        return self._copies[-1]
