"""Trajectories: paths in time, within limits, no faster than what is proven to stop before people."""

from __future__ import annotations

from typing import TYPE_CHECKING

from safe_ompl.doors import lazily

if TYPE_CHECKING:
    from safe_ompl.trajectories.body_speeds import BodySpeeds as BodySpeeds
    from safe_ompl.trajectories.caps import LINK_SPEED as LINK_SPEED
    from safe_ompl.trajectories.caps import TOOL_SPEED as TOOL_SPEED
    from safe_ompl.trajectories.caps import MotionCaps as MotionCaps
    from safe_ompl.trajectories.caps import StandstillError as StandstillError
    from safe_ompl.trajectories.caps import bending_cap as bending_cap
    from safe_ompl.trajectories.caps import braking as braking
    from safe_ompl.trajectories.caps import speed_caps as speed_caps
    from safe_ompl.trajectories.contact import CLAMPING as CLAMPING
    from safe_ompl.trajectories.contact import CONTACT as CONTACT
    from safe_ompl.trajectories.contact import CONTACT_RULES as CONTACT_RULES
    from safe_ompl.trajectories.contact import SEPARATION as SEPARATION
    from safe_ompl.trajectories.contact import ContactLimits as ContactLimits
    from safe_ompl.trajectories.contact import contact_speed as contact_speed
    from safe_ompl.trajectories.contact import limb_contact_speed as limb_contact_speed
    from safe_ompl.trajectories.contact import robot_mass as robot_mass
    from safe_ompl.trajectories.curve import BlendedCurve as BlendedCurve
    from safe_ompl.trajectories.curve import Cells as Cells
    from safe_ompl.trajectories.curve import CurvePoints as CurvePoints
    from safe_ompl.trajectories.curve import Piece as Piece
    from safe_ompl.trajectories.curve import blended as blended
    from safe_ompl.trajectories.curve import divided_edges as divided_edges
    from safe_ompl.trajectories.danger import MotionDanger as MotionDanger
    from safe_ompl.trajectories.kernels import Boxes as Boxes
    from safe_ompl.trajectories.kernels import ceilings as ceilings
    from safe_ompl.trajectories.kernels import drive as drive
    from safe_ompl.trajectories.limits import RATE_TOLERANCE as RATE_TOLERANCE
    from safe_ompl.trajectories.limits import RateLimits as RateLimits
    from safe_ompl.trajectories.local_changes import duration_of as duration_of
    from safe_ompl.trajectories.local_changes import faster as faster
    from safe_ompl.trajectories.separation import PeopleDistances as PeopleDistances
    from safe_ompl.trajectories.stops import Stops as Stops
    from safe_ompl.trajectories.stops import stops_beside as stops_beside
    from safe_ompl.trajectories.time_law import SmoothLaw as SmoothLaw
    from safe_ompl.trajectories.time_law import velocity_cap as velocity_cap
    from safe_ompl.trajectories.timing import CELL_LENGTH as CELL_LENGTH
    from safe_ompl.trajectories.timing import CELLS as CELLS
    from safe_ompl.trajectories.timing import PathTimer as PathTimer
    from safe_ompl.trajectories.timing import time_path as time_path
    from safe_ompl.trajectories.timing import within_tube as within_tube
    from safe_ompl.trajectories.trajectory import RATE as RATE
    from safe_ompl.trajectories.trajectory import SpeedCap as SpeedCap
    from safe_ompl.trajectories.trajectory import State as State
    from safe_ompl.trajectories.trajectory import Trajectory as Trajectory

__all__, __getattr__, __dir__ = lazily(__name__, __file__)
