"""Motions that something else made: piecewise polynomials, their proven rates, and what messages say of them."""

from __future__ import annotations

from typing import TYPE_CHECKING

from safe_ompl.doors import lazily

if TYPE_CHECKING:
    from safe_ompl.motions.motion import Motion

__all__ = ["Motion"]

__getattr__, __dir__ = lazily(__name__, __file__)
