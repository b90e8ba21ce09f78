"""Motions that something else made, as piecewise polynomials: checks of freedom and rates, tubes, repair."""

from typing import TYPE_CHECKING

from safe_ompl.doors import lazily

if TYPE_CHECKING:
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
    from safe_ompl.motions.motion import Motion as Motion
    from safe_ompl.motions.rates import Violation as Violation, rate_violations as rate_violations
    from safe_ompl.motions.repair import Repair as Repair, repair_with as repair_with
    from safe_ompl.motions.tube import (
        FACTOR as FACTOR,
        MeasuredTube as MeasuredTube,
        measured_tube as measured_tube,
        tube_of as tube_of,
    )

__getattr__, __dir__, __all__ = lazily(__name__, __file__)
