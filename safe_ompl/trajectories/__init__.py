"""Trajectories: paths in time, within limits, no faster than what is proven to stop before people."""

from __future__ import annotations

from typing import TYPE_CHECKING

from safe_ompl.doors import lazily

if TYPE_CHECKING:
    from safe_ompl.trajectories.caps import (
        LINK_SPEED,
        TOOL_SPEED,
        MotionCaps,
        StandstillError,
        bending_cap,
        braking,
        speed_caps,
    )
    from safe_ompl.trajectories.contact import (
        CLAMPING,
        CONTACT,
        CONTACT_RULES,
        SEPARATION,
        ContactLimits,
        contact_speed,
    )
    from safe_ompl.trajectories.curve import BlendedCurve, BodySpeeds, Cells, CurvePoints, Piece, blended, divided_edges
    from safe_ompl.trajectories.danger import MotionDanger
    from safe_ompl.trajectories.kernels import Boxes, ceilings, drive
    from safe_ompl.trajectories.limits import RATE_TOLERANCE, RateLimits
    from safe_ompl.trajectories.separation import PeopleDistances
    from safe_ompl.trajectories.stops import Stops, stops_beside
    from safe_ompl.trajectories.time_law import SmoothLaw, velocity_cap
    from safe_ompl.trajectories.timing import CELL_LENGTH, CELLS, PathTimer, time_path, within_tube
    from safe_ompl.trajectories.trajectory import RATE, SpeedCap, State, Trajectory

__all__ = [
    "CELLS",
    "CELL_LENGTH",
    "CLAMPING",
    "CONTACT",
    "CONTACT_RULES",
    "LINK_SPEED",
    "RATE",
    "RATE_TOLERANCE",
    "SEPARATION",
    "TOOL_SPEED",
    "BlendedCurve",
    "BodySpeeds",
    "Boxes",
    "Cells",
    "ContactLimits",
    "CurvePoints",
    "MotionCaps",
    "MotionDanger",
    "PathTimer",
    "PeopleDistances",
    "Piece",
    "RateLimits",
    "SmoothLaw",
    "SpeedCap",
    "StandstillError",
    "State",
    "Stops",
    "Trajectory",
    "bending_cap",
    "blended",
    "braking",
    "ceilings",
    "contact_speed",
    "divided_edges",
    "drive",
    "speed_caps",
    "stops_beside",
    "time_path",
    "velocity_cap",
    "within_tube",
]

__getattr__, __dir__ = lazily(__name__, __file__)
