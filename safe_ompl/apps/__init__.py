"""Programs: the command line and benchmarks; proofs as tests."""

from __future__ import annotations

from typing import TYPE_CHECKING

from safe_ompl.doors import lazily

if TYPE_CHECKING:
    from safe_ompl.apps.cli.program import main
    from safe_ompl.apps.proven import assert_proven

__all__ = ["assert_proven", "main"]

__getattr__, __dir__ = lazily(__name__, __file__)
