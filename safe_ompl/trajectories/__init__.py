"""Trajectories: paths in time, within limits, no faster than what is proven to stop before people."""

from __future__ import annotations

from typing import TYPE_CHECKING

from safe_ompl.doors import lazily

if TYPE_CHECKING:
    from safe_ompl.trajectories.body_speeds import BodySpeeds
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
        limb_contact_speed,
        robot_mass,
    )
    from safe_ompl.trajectories.curve import BlendedCurve, BlendProof, Cells, Piece, blended
    from safe_ompl.trajectories.danger import MotionDanger
    from safe_ompl.trajectories.kernels import ceilings, drive
    from safe_ompl.trajectories.limits import RateLimits
    from safe_ompl.trajectories.local_changes import duration_of, faster
    from safe_ompl.trajectories.time_law import SmoothLaw, velocity_cap
    from safe_ompl.trajectories.timing import CELLS, PathTimer, time_path
    from safe_ompl.trajectories.trajectory import RATE, SpeedCap, State, Trajectory

__all__ = [
    "CELLS",
    "CLAMPING",
    "CONTACT",
    "CONTACT_RULES",
    "LINK_SPEED",
    "RATE",
    "SEPARATION",
    "TOOL_SPEED",
    "BlendProof",
    "BlendedCurve",
    "BodySpeeds",
    "Cells",
    "ContactLimits",
    "MotionCaps",
    "MotionDanger",
    "PathTimer",
    "Piece",
    "RateLimits",
    "SmoothLaw",
    "SpeedCap",
    "StandstillError",
    "State",
    "Trajectory",
    "bending_cap",
    "blended",
    "braking",
    "ceilings",
    "contact_speed",
    "drive",
    "duration_of",
    "faster",
    "limb_contact_speed",
    "robot_mass",
    "speed_caps",
    "time_path",
    "velocity_cap",
]

__getattr__, __dir__ = lazily(__name__, __file__)
