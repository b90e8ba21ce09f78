"""Compiled danger fields."""

from __future__ import annotations

from typing import TYPE_CHECKING

from safe_ompl.doors import lazily

if TYPE_CHECKING:
    from safe_ompl.danger.kernels.danger import (
        MAXIMUM as MAXIMUM,
        PointDanger as PointDanger,
        dangers as dangers,
        high_levels as high_levels,
    )
    from safe_ompl.danger.kernels.kinetostatic import CellMotions as CellMotions, cell_bounds as cell_bounds

__getattr__, __dir__, __all__ = lazily(__name__, __file__)
