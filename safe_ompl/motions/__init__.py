"""Motions that something else made, as piecewise polynomials: checks of freedom and rates, tubes, repair."""

from __future__ import annotations

from typing import TYPE_CHECKING

from safe_ompl.doors import lazily

if TYPE_CHECKING:
    from safe_ompl.motions.checks import MotionCheck as MotionCheck
    from safe_ompl.motions.checks import check as check
    from safe_ompl.motions.checks import check_with as check_with
    from safe_ompl.motions.checks import widest_tube as widest_tube
    from safe_ompl.motions.motion import Motion as Motion
    from safe_ompl.motions.rates import Extremes as Extremes
    from safe_ompl.motions.rates import Violation as Violation
    from safe_ompl.motions.rates import extremes as extremes
    from safe_ompl.motions.rates import rate_violations as rate_violations
    from safe_ompl.motions.repair import Repair as Repair
    from safe_ompl.motions.repair import repair_with as repair_with
    from safe_ompl.motions.tube import FACTOR as FACTOR
    from safe_ompl.motions.tube import MeasuredTube as MeasuredTube
    from safe_ompl.motions.tube import measured_tube as measured_tube
    from safe_ompl.motions.tube import tube_of as tube_of

__all__, __getattr__, __dir__ = lazily(__name__, __file__)
