"""Motions: what they must keep to, proofs of them, repair, and time laws with stops before people."""

from typing import TYPE_CHECKING

from safe_ompl.doors import lazily

if TYPE_CHECKING:
    from safe_ompl.motions.blends import blended as blended, first_unproven as first_unproven
    from safe_ompl.motions.caps import (
        LINK_SPEED as LINK_SPEED,
        TOOL_SPEED as TOOL_SPEED,
        MotionCaps as MotionCaps,
        StandstillError as StandstillError,
        bending_cap as bending_cap,
        braking as braking,
        speed_caps as speed_caps,
    )
    from safe_ompl.motions.cells import BodySpeeds as BodySpeeds, Cells as Cells, CurvePoints as CurvePoints
    from safe_ompl.motions.checks import (
        TIME as TIME,
        MotionCheck as MotionCheck,
        check as check,
        check_many as check_many,
        check_with as check_with,
        objection as objection,
        prove_many as prove_many,
        retime as retime,
        way_of as way_of,
        widest_tube as widest_tube,
    )
    from safe_ompl.motions.constraints import (
        ConfigurationCheck as ConfigurationCheck,
        Constraints as Constraints,
        UserCheck as UserCheck,
        claims_of as claims_of,
    )
    from safe_ompl.motions.contact import (
        CLAMPING as CLAMPING,
        CONTACT as CONTACT,
        CONTACT_RULES as CONTACT_RULES,
        SEPARATION as SEPARATION,
        ContactLimits as ContactLimits,
        contact_speed as contact_speed,
    )
    from safe_ompl.motions.danger import MotionDanger as MotionDanger
    from safe_ompl.motions.kernels import Boxes as Boxes, ceilings as ceilings, drive as drive
    from safe_ompl.motions.limits import RATE_TOLERANCE as RATE_TOLERANCE, RateLimits as RateLimits
    from safe_ompl.motions.motion import Motion as Motion
    from safe_ompl.motions.rates import Violation as Violation, rate_violations as rate_violations
    from safe_ompl.motions.repair import Repair as Repair, repair_with as repair_with
    from safe_ompl.motions.separation import PeopleDistances as PeopleDistances
    from safe_ompl.motions.stops import Stops as Stops, stops_beside as stops_beside
    from safe_ompl.motions.time_law import (
        BRAKING as BRAKING,
        SmoothLaw as SmoothLaw,
        SmoothLimits as SmoothLimits,
        velocity_cap as velocity_cap,
    )
    from safe_ompl.motions.timing import (
        CELL_LENGTH as CELL_LENGTH,
        CELLS as CELLS,
        PathTimer as PathTimer,
        time_path as time_path,
        within_tube as within_tube,
    )
    from safe_ompl.motions.trajectory import (
        RATE as RATE,
        SpeedCap as SpeedCap,
        State as State,
        Trajectory as Trajectory,
    )
    from safe_ompl.motions.tube import (
        FACTOR as FACTOR,
        MeasuredTube as MeasuredTube,
        measured_tube as measured_tube,
        tube_of as tube_of,
    )

__getattr__, __dir__, __all__ = lazily(__name__, __file__)
