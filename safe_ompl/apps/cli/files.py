"""Output files of the command line: strict JSON, and the check beforehand that they can be written."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TextIO

from safe_ompl.common import InputError
from safe_ompl.io import strict_json as json_line

__all__ = ["STANDARD_OUTPUT", "check_writable", "json_line", "make_folder", "opened"]

STANDARD_OUTPUT = "-"


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
