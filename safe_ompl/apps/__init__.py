"""Programs: the command line and benchmarks."""

from __future__ import annotations

from typing import TYPE_CHECKING

from safe_ompl.doors import lazily

if TYPE_CHECKING:
    from safe_ompl.apps.cli.program import main

__all__ = ["main"]

__getattr__, __dir__ = lazily(__name__, __file__)
