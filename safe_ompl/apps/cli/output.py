"""Output of the commands: consoles, log lines, tables, and files, which are checked before a command runs."""

from __future__ import annotations

import argparse
import io
import logging
import os
import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager, nullcontext, suppress
from errno import EISDIR
from importlib.util import find_spec
from logging.handlers import MemoryHandler
from pathlib import Path
from tempfile import TemporaryFile
from typing import IO, TYPE_CHECKING, Any, TypeVar

from ompl import util as ou

from safe_ompl.common import InputError, files
from safe_ompl.drawing import PLOT_ENDINGS
from safe_ompl.io import strict_json

# Importing Rich takes 30 ms, so Rich is only imported by the functions that need it.
if TYPE_CHECKING:
    from rich.console import Console
    from rich.progress import Progress
    from rich.table import Table

Item = TypeVar("Item")

INTERRUPTED = 130  # exit status
STANDARD_OUTPUT = "-"
# Module, and what it is for.
EXTRAS = {
    "plots": ("matplotlib", "pictures"),
    "viewer": ("viser", "the viewer"),
    "mcap": ("mcap", "logs and recordings"),
    "ros": ("rclpy", "the node of ROS 2"),
    "mujoco": ("mujoco", "the examples of MuJoCo"),
    "xacro": ("xacro", "robots in .xacro files"),
}
# The width of tables that go to a file or a pipe.
_WIDTH = 160
# The number of log records that are held back, and a level above all levels, so that no record is shown early.
_HELD, _NEVER = 10_000, logging.CRITICAL + 1


def console() -> Console:
    """Return the console for tables, on standard output. Characters that its encoding lacks become question marks."""
    from rich.console import Console

    _replace_unknown_characters()
    return Console(highlight=False, width=_width(sys.stdout.isatty()))


def say(text: str) -> None:
    """Print text unchanged to standard output. Characters that its encoding lacks become question marks."""
    _replace_unknown_characters()
    print(text, flush=True)


def _replace_unknown_characters() -> None:
    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(errors="replace")


def error_console() -> Console:
    """Return the console for progress and messages, on standard error. Messages are not wrapped."""
    from rich.console import Console

    return Console(stderr=True, highlight=False, markup=False, soft_wrap=True, width=_width(sys.stderr.isatty()))


def _width(is_terminal: bool) -> int | None:
    return None if is_terminal or "COLUMNS" in os.environ else _WIDTH


def progress_bar(console: Console, *, hidden: bool = False) -> Progress:
    """Return a progress bar that is only shown on a terminal, and removed at the end."""
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    columns = TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn()
    hidden = hidden or not console.is_terminal
    return Progress(*columns, console=console, transient=True, redirect_stdout=False, disable=hidden)


# ---------------------------------------------------------------------------------------------------- logs


class _LogLines(logging.Handler):
    """A log handler that shows one line for each record."""

    def emit(self, record: logging.LogRecord) -> None:
        """Show a record."""
        error_console().print(f"safe-ompl: {record.levelname.lower()}: {' '.join(record.getMessage().split())}")


@contextmanager
def shown_log(verbose: bool) -> Iterator[Callable[[], None]]:
    """Show the package's warnings while the block runs, and with `verbose` its progress messages, too.

    Without `verbose` the warnings are held back until the yielded function is called, so that bad input leads to one
    error line without a list of warnings.
    """

    def show() -> None:
        handler.capacity = 0
        handler.flush()

    logger = logging.getLogger("safe_ompl")
    before, propagates = logger.level, logger.propagate
    handler = MemoryHandler(0 if verbose else _HELD, _NEVER, _LogLines(), flushOnClose=False)
    logger.addHandler(handler)
    logger.setLevel(logging.INFO if verbose else logging.WARNING)
    logger.propagate = False
    try:
        yield show
    finally:
        logger.removeHandler(handler)
        logger.setLevel(before)
        logger.propagate = propagates


@contextmanager
def ompl_messages(verbose: bool) -> Iterator[None]:
    """Let OMPL report only errors while the block runs, and with `verbose` its progress messages, too."""
    level = ou.getLogLevel()
    ou.setLogLevel(ou.LogLevel.LOG_INFO if verbose else ou.LogLevel.LOG_ERROR)
    try:
        yield
    finally:
        ou.setLogLevel(level)


# -------------------------------------------------------------------------------------------------- files


class OutputFile(str):
    """A file that a command writes, as its option names it: `output_file` reads one, `check_outputs` checks all."""

    endings: tuple[str, ...]
    # The package's extra that provides the writer.
    extra: str | None


def output_file(*endings: str, extra: str | None = None) -> Callable[[str], OutputFile]:
    """Return a function that reads the name of an output file. With `STANDARD_OUTPUT` in `endings`, "-" is allowed."""

    def read(text: str) -> OutputFile:
        file = OutputFile(text)
        file.endings, file.extra = endings, extra
        return file

    return read


def each_until_ctrl_c(items: Iterable[Item], do: Callable[[Item], object]) -> int:
    """Call `do` with each item until the items end or the user presses Ctrl-C; return the exit status.

    Raises KeyboardInterrupt if Ctrl-C was pressed before the first item was done.
    """
    done = False
    with suppress(KeyboardInterrupt):
        for item in items:
            do(item)
            done = True
        return 0
    if not done:
        raise KeyboardInterrupt
    error_console().print("safe-ompl: interrupted: the results are incomplete")
    return INTERRUPTED


JSON_FILE = output_file(".json", STANDARD_OUTPUT)
PICTURE = output_file(*PLOT_ENDINGS, extra="plots")
PAGE = output_file(".html", extra="viewer")
LOG = output_file(".mcap", extra="mcap")


def check_outputs(options: argparse.Namespace) -> None:
    """Check all output files that the options name, before the command runs. No file is changed.

    Raises InputError, which names the option, if a file has an unknown extension, cannot be written, is an input of the
    same command, is written by another option, or exists and --force is missing; or if an extra is not installed.
    """
    outputs = {key: value for key, value in vars(options).items() if isinstance(value, OutputFile)}
    others = [value for key, value in vars(options).items() if key not in outputs]
    listed = [item for value in others for item in (value if isinstance(value, (list, tuple)) else [value])]
    inputs = [item for item in listed if isinstance(item, (str, Path))]
    written: dict[Path, str] = {}
    for key, file in outputs.items():
        option, path = f"--{key.replace('_', '-')}", Path(file)
        if file == STANDARD_OUTPUT and STANDARD_OUTPUT in file.endings:
            continue
        is_pipe = path.exists() and not path.is_file() and not path.is_dir()
        if not is_pipe and path.suffix.lower() not in file.endings:
            endings = (ending for ending in file.endings if ending != STANDARD_OUTPUT)
            raise InputError(f"{str(file)!r} must end in {' or '.join(endings)}", option)
        if file.extra is not None:
            need_extra(file.extra, option)
        if not is_pipe:
            _check_place(path, option, inputs, force=options.force)
        place = path.resolve()
        if place in written:
            raise InputError(f"{str(file)!r} is written by {written[place]} already: give another file", option)
        written[place] = option


def _check_place(path: Path, option: str, inputs: Sequence[str | Path], *, force: bool) -> None:
    """Raise InputError if a file cannot be written, is an input, or exists and `force` is False."""
    file = str(path)
    if any(_same_file(given, path) for given in inputs):
        raise InputError(f"{file!r} is read by this command: give another file", option)
    try:
        if path.is_dir():
            raise IsADirectoryError(EISDIR, os.strerror(EISDIR))
        with TemporaryFile(dir=path.parent):
            pass
    except OSError as error:
        raise InputError(f"cannot write {file!r} ({error.strerror})", option) from None
    if path.exists() and not force:
        raise InputError(f"{file!r} already exists: give another file, or --force", option)


def missing_extra(extra: str) -> str | None:
    """Return the message that an extra of the package is not installed, or None if it is installed."""
    module, purpose = EXTRAS[extra]
    if find_spec(module) is not None:
        return None
    return f"{module} missing; get {purpose} with: pip install 'safe-ompl[{extra}]'"


def need_extra(extra: str, key: str | None = None) -> None:
    """Raise InputError, which says what to install, unless an extra of the package is installed."""
    advice = missing_extra(extra)
    if advice:
        raise InputError(advice, key)


def _same_file(given: str | Path, path: Path) -> bool:
    # `given` may be no file at all.
    with suppress(OSError, ValueError):
        return os.path.samefile(given, path)
    return False


def make_folder(folder: Path, names: Iterable[str], *, force: bool) -> None:
    """Create the folder of --out. Raise InputError if that fails, or files exist in it and `force` is False."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with TemporaryFile(dir=folder):
            pass
    except OSError as error:
        raise InputError(f"cannot write into the folder {str(folder)!r} ({error.strerror})", "--out") from None
    for name in names:
        if (folder / name).exists() and not force:
            words = f"the folder {str(folder)!r} holds {name} already: give another folder, or --force"
            raise InputError(words, "--out")


def opened(file: str) -> AbstractContextManager[IO[str]]:
    """Open a file for writing line by line; ``-`` is standard output. Written lines are kept after an interruption."""
    return nullcontext(sys.stdout) if file == STANDARD_OUTPUT else Path(file).open("w", encoding="utf-8")


def write_json(file: str, content: Any) -> None:
    """Write one line of strict JSON to a file, or to standard output for ``-``."""
    write_text(file, f"{strict_json(content)}\n")


def write_text(file: str, text: str) -> None:
    """Write text to a file, or to standard output for ``-``."""
    if file == STANDARD_OUTPUT:
        sys.stdout.write(text)
        sys.stdout.flush()
    else:
        files.write(file, text)


def plain_table(*columns: str, title: str | None = None, gap: int = 2) -> Table:
    """Return a table with text columns and no frame, and `gap` spaces between columns."""
    from rich import box
    from rich.table import Table

    table = Table(
        title=title,
        title_justify="left",
        title_style="bold",
        caption_justify="left",
        box=box.SIMPLE_HEAD,
        show_edge=False,
        pad_edge=False,
        padding=(0, gap - 1, 0, 0),
    )
    for column in columns:
        table.add_column(column, overflow="fold")
    return table
