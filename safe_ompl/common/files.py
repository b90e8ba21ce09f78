"""Files that are written as a whole: readers see what was there before, or all that is new, never a part of it."""

from __future__ import annotations

import csv
import io
import os
import shutil
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from secrets import token_hex
from typing import Any


@contextmanager
def replacing(file: str | Path, *, binary: bool = False) -> Iterator[Any]:
    """Yield a stream; when the block ends without an error, what it wrote is the file.

    It is written to a temporary file in the same folder, which takes the file's place by a rename and keeps its
    permissions. Pipes and devices are written directly. An OSError names the file, that of a full disk, too.
    """
    path = Path(file)
    text: dict[str, Any] = {} if binary else {"encoding": "utf-8", "newline": ""}
    draft = None
    try:
        if path.exists() and not path.is_file():
            with path.open("wb" if binary else "w", **text) as stream:
                yield stream
            return
        place = path.resolve()  # what a link points to is replaced, not the link
        draft = place.with_name(f".{token_hex(6)}{place.suffix}")
        with draft.open("xb" if binary else "x", **text) as stream:
            if place.exists():
                shutil.copymode(place, draft)
            yield stream
        os.replace(draft, place)
    except OSError as error:
        if error.filename not in (None, str(draft), str(file)):
            raise
        raise OSError(error.errno, error.strerror or str(error), str(file)) from error
    finally:
        if draft is not None:
            draft.unlink(missing_ok=True)


def write(file: str | Path, content: str | bytes) -> None:
    """Write text or bytes to a file, see `replacing`."""
    with replacing(file, binary=isinstance(content, bytes)) as stream:
        stream.write(content)


def table(header: Sequence[str], rows: Iterable[Sequence[object]], delimiter: str = ",") -> str:
    """Return a line of names, and rows below it, as text; numbers are read back exactly."""
    stream = io.StringIO()
    writer = csv.writer(stream, delimiter=delimiter, lineterminator="\n")
    writer.writerow(header)
    writer.writerows(rows)
    return stream.getvalue()
