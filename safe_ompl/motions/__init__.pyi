from .blends import blended as blended, first_unproven as first_unproven
from .cells import BodySpeeds as BodySpeeds, Boxes as Boxes, Cells as Cells, CurvePoints as CurvePoints
from .checks import (
    TIME as TIME,
    MotionCheck as MotionCheck,
    check as check,
    check_many as check_many,
    check_with as check_with,
    prove_many as prove_many,
    prover_of as prover_of,
    retime as retime,
    way_of as way_of,
    why_unproven as why_unproven,
    widest_tube as widest_tube,
)
from .constraints import (
    ConfigurationCheck as ConfigurationCheck,
    Constraints as Constraints,
    UserCheck as UserCheck,
    claims_of as claims_of,
)
from .contact import (
    CLAMPING as CLAMPING,
    CONTACT as CONTACT,
    CONTACT_RULES as CONTACT_RULES,
    SEPARATION as SEPARATION,
    ContactLimits as ContactLimits,
    contact_speed as contact_speed,
)
from .danger import MotionDanger as MotionDanger
from .laws import ceilings as ceilings, drive as drive
from .limits import RATE_TOLERANCE as RATE_TOLERANCE, RateLimits as RateLimits
from .motion import Motion as Motion
from .rates import Violation as Violation, rate_violations as rate_violations
from .repair import Repair as Repair, repair_with as repair_with
from .separation import PeopleDistances as PeopleDistances
from .stops import Stops as Stops, stops_beside as stops_beside
from .time_law import (
    BRAKING as BRAKING,
    SmoothLaw as SmoothLaw,
    SmoothLimits as SmoothLimits,
    joint_velocity_limit as joint_velocity_limit,
)
from .timing import (
    CELL_LENGTH as CELL_LENGTH,
    CELLS as CELLS,
    PathTimer as PathTimer,
    time_path as time_path,
    within_tube as within_tube,
)
from .trajectory import RATE as RATE, State as State, Trajectory as Trajectory, VelocityLimit as VelocityLimit
from .tube import FACTOR as FACTOR, MeasuredTube as MeasuredTube, measured_tube as measured_tube, tube_of as tube_of
from .velocity_limits import (
    LINK_SPEED as LINK_SPEED,
    TOOL_SPEED as TOOL_SPEED,
    StandstillError as StandstillError,
    TimingLimits as TimingLimits,
    bending_velocity_limit as bending_velocity_limit,
    body_speed_limits as body_speed_limits,
    braking as braking,
)
