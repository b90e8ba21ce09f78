"""The decorator of the kernels: compiled once per installation, kept on disk, and said so on the console.

Numba keeps what it has compiled beside the source, or in the user's cache folder where that cannot be written to, or
where `NUMBA_CACHE_DIR` says; files are replaced as a whole, so that processes may share them. Where no folder can be
written to, every process compiles for itself.
"""

from __future__ import annotations

import gc
import logging
from collections.abc import Callable
from pathlib import Path
from time import perf_counter
from typing import Any, TypeVar

from numba import njit
from numba.core import event
from numba.core.types.misc import unliteral

_log = logging.getLogger(__name__)
_Function = TypeVar("_Function", bound=Callable[..., Any])


def compiled(function: _Function) -> _Function:
    """Return a kernel: `function` compiled on its first call; free of the GIL, and x/0 is ±∞ as in NumPy."""
    options = {"nogil": True, "error_model": "numpy", "no_cfunc_wrapper": True}
    try:
        kernel: Any = njit(cache=True, **options)(function)
    except RuntimeError as error:  # Numba finds no folder that can be written to
        _log.info("%s", error)
        kernel = njit(**options)(function)
    else:
        _depend_on_all_kernels(kernel)
    fast: _Function = _without_literals(kernel)
    return fast


def part(function: _Function) -> _Function:
    """Return a part of kernels: `function`, compiled into the kernels that call it, for which Python cannot call it."""
    inner: Any = njit(error_model="numpy", no_cpython_wrapper=True, no_cfunc_wrapper=True)(function)
    fast: _Function = _without_literals(inner)
    return fast


def _without_literals(kernel: Any) -> Any:
    """Return a kernel that other kernels call with the types of constants, and not with their values.

    Numba would compile it once for calls with a variable, and anew for a 0, a 1 or a True in its place.
    """
    template = kernel.get_call_template
    kernel.get_call_template = lambda args, kws: template(tuple(map(unliteral, args)), kws)
    return kernel


def clock() -> float:
    """Return the time [s] of a clock that stands while kernels are compiled: no time limit should count that."""
    return perf_counter() - _compilation.seconds


def _depend_on_all_kernels(kernel: Any) -> None:
    """Let what is kept of a kernel be out of date once any file of this folder changes, and not its own alone.

    Numba looks at the file of the kernel only, although what other kernels do is compiled into it.
    """
    files: Any = getattr(getattr(kernel, "_cache", None), "_cache_file", None)
    if hasattr(files, "_source_stamp"):
        files._source_stamp = _SOURCES


def _sources() -> tuple[tuple[str, float, int], ...]:
    """Return names, times and sizes of the files of this folder."""
    files = ((path.name, path.stat()) for path in sorted(Path(__file__).parent.glob("*.py")))
    return tuple((name, stat.st_mtime, stat.st_size) for name, stat in files)


class _Compilation(event.Listener):  # type: ignore[misc]
    """Says once in a process that kernels are being compiled, and adds up for how long.

    What comes from the disk causes no such event. Kernels that others call are compiled within these. Meanwhile there
    is no collection of garbage: it would go through the millions of objects of a compiler again and again.
    """

    def __init__(self) -> None:
        self.seconds, self._depth, self._begin, self._said = 0.0, 0, 0.0, False
        self._collects = False

    def on_start(self, event: Any) -> None:
        if not event.data["dispatcher"].__module__.startswith(__package__):
            return
        if not self._said:
            self._said = True
            _log.warning("compiling kernels for this machine, which takes some seconds: once, they are kept")
        if not self._depth:
            self._begin = perf_counter()
            self._collects = gc.isenabled()
            gc.disable()
        self._depth += 1

    def on_end(self, event: Any) -> None:
        if not event.data["dispatcher"].__module__.startswith(__package__):
            return
        self._depth -= 1
        if not self._depth:
            self.seconds += perf_counter() - self._begin
            if self._collects:
                gc.enable()


_SOURCES = _sources()
_compilation = _Compilation()
event.register("numba:compile", _compilation)
