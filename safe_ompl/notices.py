"""Warnings that are said once a process: what is true of a robot is true each time that it is loaded."""

from __future__ import annotations

import logging
from functools import cache


@cache
def warn_once(log: logging.Logger, message: str) -> None:
    """Log a warning, unless `log` has said the same before; `warn_once.cache_clear()` forgets what was said."""
    log.warning("%s", message, extra={"once": True})


def pass_on(record: logging.LogRecord) -> None:
    """Log what another process has logged; what is said once was perhaps said by several."""
    log = logging.getLogger(record.name)
    if getattr(record, "once", False):
        warn_once(log, record.getMessage())
    else:
        log.handle(record)
