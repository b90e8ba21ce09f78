"""The program `safe-ompl`, also as `python -m safe_ompl`."""

from __future__ import annotations

import os
import signal
import sys
from types import FrameType


def main() -> int:
    """Run the program; a Ctrl-C while it is imported ends it at once, and quietly."""
    before = signal.getsignal(signal.SIGINT)
    if before is signal.default_int_handler:
        signal.signal(signal.SIGINT, _leave)
    from safe_ompl.apps import main as run

    if before is signal.default_int_handler:
        signal.signal(signal.SIGINT, before)
    return run()


def _leave(number: int, frame: FrameType | None) -> None:
    os.write(2, b"safe-ompl: interrupted\n")
    os._exit(130)


if __name__ == "__main__":
    sys.exit(main())
