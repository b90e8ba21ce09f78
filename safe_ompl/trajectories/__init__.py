"""Trajectories: paths in time, within limits, no faster than what is proven to stop before people."""

from typing import TYPE_CHECKING

from safe_ompl.doors import lazily

if TYPE_CHECKING:
    from safe_ompl.trajectories.caps import (
        LINK_SPEED as LINK_SPEED,
        TOOL_SPEED as TOOL_SPEED,
        MotionCaps as MotionCaps,
        StandstillError as StandstillError,
        bending_cap as bending_cap,
        braking as braking,
        speed_caps as speed_caps,
    )
    from safe_ompl.trajectories.contact import (
        CLAMPING as CLAMPING,
        CONTACT as CONTACT,
        CONTACT_RULES as CONTACT_RULES,
        SEPARATION as SEPARATION,
        ContactLimits as ContactLimits,
        contact_speed as contact_speed,
    )
    from safe_ompl.trajectories.curve import (
        BlendedCurve as BlendedCurve,
        BodySpeeds as BodySpeeds,
        Cells as Cells,
        CurvePoints as CurvePoints,
        Piece as Piece,
        blended as blended,
        divided_edges as divided_edges,
    )
    from safe_ompl.trajectories.danger import MotionDanger as MotionDanger
    from safe_ompl.trajectories.kernels import Boxes as Boxes, ceilings as ceilings, drive as drive
    from safe_ompl.trajectories.limits import RATE_TOLERANCE as RATE_TOLERANCE, RateLimits as RateLimits
    from safe_ompl.trajectories.separation import PeopleDistances as PeopleDistances
    from safe_ompl.trajectories.stops import Stops as Stops, stops_beside as stops_beside
    from safe_ompl.trajectories.time_law import (
        BRAKING as BRAKING,
        SmoothLaw as SmoothLaw,
        SmoothLimits as SmoothLimits,
        velocity_cap as velocity_cap,
    )
    from safe_ompl.trajectories.timing import (
        CELL_LENGTH as CELL_LENGTH,
        CELLS as CELLS,
        PathTimer as PathTimer,
        time_path as time_path,
        within_tube as within_tube,
    )
    from safe_ompl.trajectories.trajectory import (
        RATE as RATE,
        SpeedCap as SpeedCap,
        State as State,
        Trajectory as Trajectory,
    )

__getattr__, __dir__, __all__ = lazily(__name__, __file__)
