"""Where the output of commands goes: consoles, log lines and files, which are checked before the work begins."""

from __future__ import annotations

import io
import logging
import os
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from importlib.util import find_spec
from pathlib import Path
from typing import Any, TextIO

from ompl import util as ou
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from safe_ompl.common import InputError
from safe_ompl.io import strict_json

STANDARD_OUTPUT = "-"
EXTRAS = {
    "plots": ("matplotlib", "pictures"),
    "viewer": ("viser", "the viewer"),
}  # module, and what it is for
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


# -------------------------------------------------------------------------------------------------- files


def check_writable(file: str | None, option: str) -> None:
    """Raise InputError, naming `option`, if a file cannot be written; it is left as it was."""
    if file is None or file == STANDARD_OUTPUT:
        return
    path = Path(file)
    if path.exists() and not path.is_file() and not path.is_dir():
        return  # a pipe or a device: opening it would be more than a look
    is_new = not path.exists()
    try:
        path.open("ab").close()
    except OSError as error:
        raise InputError(f"cannot write {file!r} ({error.strerror})", option) from None
    if is_new:
        path.unlink()


def missing_extra(extra: str) -> str | None:
    """Return what to install for an extra of the package, or None if it is installed."""
    module, purpose = EXTRAS[extra]
    if find_spec(module) is not None:
        return None
    return f"{module} missing; get {purpose} with: pip install 'safe-ompl[{extra}]'"


def check_drawable(file: str | None, option: str, endings: Sequence[str] = (".png",)) -> None:
    """Raise InputError, naming `option`, if a picture cannot be drawn or written."""
    if file is None:
        return
    if Path(file).suffix.lower() not in endings:
        raise InputError(f"{file!r} must end in {' or '.join(endings)}", option)
    advice = missing_extra("plots")
    if advice:
        raise InputError(advice, option)
    check_writable(file, option)


def make_folder(folder: Path, option: str) -> None:
    """Create a folder, or raise InputError, naming `option`, if that or writing into it is not possible."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"cannot create the folder {str(folder)!r} ({error.strerror})", option) from None
    check_writable(str(folder / "report.json"), option)


@contextmanager
def opened(file: str) -> Iterator[TextIO]:
    """Open a file to write text to; ``-`` is standard output."""
    if file == STANDARD_OUTPUT:
        yield sys.stdout
        sys.stdout.flush()
    else:
        with Path(file).open("w", encoding="utf-8") as stream:
            yield stream


def write_json(file: str, content: Any) -> None:
    """Write one line of strict JSON to a file, or to standard output for ``-``."""
    with opened(file) as stream:
        print(strict_json(content), file=stream)
