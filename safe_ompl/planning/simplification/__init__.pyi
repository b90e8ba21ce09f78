from .cost import PathCost as PathCost
from .hybrids import hybrid as hybrid
from .measures import (
    PROFILE_POINTS as PROFILE_POINTS,
    SPREAD_PERCENTILES as SPREAD_PERCENTILES,
    ClearanceReport as ClearanceReport,
    Curve as Curve,
    DangerReport as DangerReport,
    forced_danger as forced_danger,
)
from .report import PathReport as PathReport, Validation as Validation, validate as validate
from .simplifier import Simplifier as Simplifier, Stop as Stop, timed as timed
