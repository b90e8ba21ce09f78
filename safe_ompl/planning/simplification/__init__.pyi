from .cost import PathCost as PathCost
from .hybrids import hybrid as hybrid
from .measures import (
    BAND as BAND,
    PROFILE_POINTS as PROFILE_POINTS,
    ClearanceReport as ClearanceReport,
    Curve as Curve,
    DangerReport as DangerReport,
    forced_danger as forced_danger,
)
from .report import PathReport as PathReport, Validation as Validation, validate as validate
from .simplifier import Simplifier as Simplifier, Stop as Stop, timed as timed
