"""The program `safe-ompl`, also as `python -m safe_ompl`."""

from __future__ import annotations

import gc
import os
import signal
import sys
from types import FrameType


def main() -> int:
    """Run the program; a Ctrl-C while it is imported ends it at once, and quietly."""
    before = signal.getsignal(signal.SIGINT)
    if before is signal.default_int_handler:
        signal.signal(signal.SIGINT, _leave)
    # What is imported lives as long as the program: to look for garbage among it takes 50 ms of a start.
    gc.disable()
    from safe_ompl.apps import main as run

    gc.freeze()
    gc.enable()
    if before is signal.default_int_handler:
        signal.signal(signal.SIGINT, before)
    try:
        return run()
    finally:
        gc.unfreeze()


def _leave(number: int, frame: FrameType | None) -> None:
    os.write(2, b"safe-ompl: interrupted\n")
    os._exit(130)


if __name__ == "__main__":
    sys.exit(main())
