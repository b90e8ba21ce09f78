"""Motions that something else made: piecewise polynomials, their proven rates, and what messages say of them."""

from __future__ import annotations

from typing import TYPE_CHECKING

from safe_ompl.doors import lazily

if TYPE_CHECKING:
    from safe_ompl.motions.motion import Motion
    from safe_ompl.motions.rates import Extremes, RateViolation, extremes, rate_violations

__all__ = ["Extremes", "Motion", "RateViolation", "extremes", "rate_violations"]

__getattr__, __dir__ = lazily(__name__, __file__)
