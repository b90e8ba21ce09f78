"""Programs: the command line and benchmarks; proofs as tests."""

from typing import TYPE_CHECKING

from safe_ompl.doors import lazily

if TYPE_CHECKING:
    from safe_ompl.apps.cli.program import main as main
    from safe_ompl.apps.proven import assert_proven as assert_proven

__getattr__, __dir__, __all__ = lazily(__name__, __file__)
