"""A notice that OMPL asks a planner for its data, which a planner in Python cannot answer."""

from __future__ import annotations

import logging
from typing import Any

from ompl import base as ob

from safe_ompl.notices import warn_once

_log = logging.getLogger(__name__)


class UnansweredRequest:
    """`getPlannerData` of a planner in Python: OMPL's own version, which gives nothing, and a warning that says so.

    A method in Python ends the process when OMPL calls it. But OMPL looks first whether there is one, and finds its
    own here: it goes on as if nothing was overridden, and the request has been noticed.
    """

    def __get__(self, planner: Any, owner: type | None = None) -> Any:
        if planner is None:
            return ob.Planner.getPlannerData
        warn_once(
            _log,
            f"{planner.getName()}: getPlannerData stays empty, as OMPL's bindings have no version of it in Python: "
            "safe_ompl.planner_data(planner) and SafeSetup fill it",
        )
        return ob.Planner.getPlannerData.__get__(planner)
