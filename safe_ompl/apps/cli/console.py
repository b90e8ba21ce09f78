"""Consoles, progress bar and log lines of the command line."""

from __future__ import annotations

import io
import logging
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager

from ompl import util as ou
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

_WIDTH = 120  # of tables that go to a file or pipe


def output_console() -> Console:
    """Return where tables go: standard output; what its encoding lacks becomes a question mark."""
    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(errors="replace")
    return Console(highlight=False, width=_width(sys.stdout.isatty()))


def error_console() -> Console:
    """Return where progress and messages go: standard error. Messages are not wrapped."""
    return Console(
        stderr=True, highlight=False, markup=False, soft_wrap=True, width=_width(sys.stderr.isatty())
    )


def _width(is_terminal: bool) -> int | None:
    return None if is_terminal or "COLUMNS" in os.environ else _WIDTH


def progress_bar(console: Console, *, hidden: bool = False) -> Progress:
    """Return a progress bar that shows only on a terminal, and leaves nothing behind."""
    return Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeRemainingColumn(),
        console=console,
        transient=True,
        redirect_stdout=False,
        disable=hidden or not console.is_terminal,
    )


# ---------------------------------------------------------------------------------------------------- logs


class LogLines(logging.Handler):
    """A log handler that shows one line for each record, above a progress bar if there is one.

    Records are held back until `release`: to bad input the answer is one line, not a list of warnings about
    what was read before.

    Parameters
    ----------
    console : Console
        Where to.
    hold : bool
        Whether to hold records back at first.
    """

    def __init__(self, console: Console, hold: bool) -> None:
        super().__init__()
        self._console = console
        self._held: list[str] | None = [] if hold else None

    def emit(self, record: logging.LogRecord) -> None:
        """Show or hold a record."""
        line = f"safe-ompl: {record.levelname.lower()}: {' '.join(record.getMessage().split())}"
        if self._held is None:
            self._console.print(line)
        else:
            self._held.append(line)

    def release(self) -> None:
        """Show what was held back, and from now on everything at once."""
        held, self._held = self._held, None
        for line in held or ():
            self._console.print(line)


@contextmanager
def shown_log(console: Console, verbose: bool) -> Iterator[LogLines]:
    """Show the package's warnings, and what it is doing if `verbose`, while the block runs."""
    logger = logging.getLogger("safe_ompl")
    before, propagates = logger.level, logger.propagate
    handler = LogLines(console, hold=not verbose)
    logger.addHandler(handler)
    logger.setLevel(logging.INFO if verbose else logging.WARNING)
    logger.propagate = False
    try:
        yield handler
    finally:
        logger.removeHandler(handler)
        logger.setLevel(before)
        logger.propagate = propagates


@contextmanager
def ompl_messages(verbose: bool) -> Iterator[None]:
    """Let OMPL report errors only, and what it is doing if `verbose`, while the block runs."""
    level = ou.getLogLevel()
    ou.setLogLevel(ou.LogLevel.LOG_INFO if verbose else ou.LogLevel.LOG_ERROR)
    try:
        yield
    finally:
        ou.setLogLevel(level)
