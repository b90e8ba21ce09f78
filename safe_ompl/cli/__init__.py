"""The command line: `safe-ompl`."""

from safe_ompl.cli.main import main

__all__ = ["main"]
