"""Compiled danger fields."""

from __future__ import annotations

from typing import TYPE_CHECKING

from safe_ompl.doors import lazily

if TYPE_CHECKING:
    from safe_ompl.danger.kernels.danger import dangers as dangers
    from safe_ompl.danger.kernels.kinetostatic import CellMotions as CellMotions
    from safe_ompl.danger.kernels.kinetostatic import cell_bounds as cell_bounds

__all__, __getattr__, __dir__ = lazily(__name__, __file__)
