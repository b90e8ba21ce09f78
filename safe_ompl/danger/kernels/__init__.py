"""Compiled danger fields."""

from __future__ import annotations

from typing import TYPE_CHECKING

from safe_ompl.doors import lazily

if TYPE_CHECKING:
    from safe_ompl.danger.kernels.danger import PointDanger, dangers
    from safe_ompl.danger.kernels.kinetostatic import CellMotions, cell_bounds

__all__ = ["CellMotions", "PointDanger", "cell_bounds", "dangers"]

__getattr__, __dir__ = lazily(__name__, __file__)
