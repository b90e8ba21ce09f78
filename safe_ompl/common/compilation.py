"""Decorators of the kernels, which are compiled once per installation and kept on disk; a warning announces it.

A wheel may hold the machine code of all kernels: `.ci/machine_code.py` builds it. What it does not hold for this
Python, Numba and processor is compiled. Numba keeps that beside the source, or in the user's cache folder where that
cannot be written to, or where `NUMBA_CACHE_DIR` says; files are replaced as a whole, so that processes may share them.
Where no folder can be written to, every process compiles for itself.

A kernel is its formula as a loop. Kernels check nothing. They take C-contiguous, writable arrays of the types that
their docstrings name: for any other sort of array Numba would compile them once more.
"""

from __future__ import annotations

import gc
import logging
import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from functools import cached_property, lru_cache, partial, update_wrapper
from pathlib import Path
from pkgutil import resolve_name
from subprocess import DEVNULL, PIPE, Popen, TimeoutExpired
from time import perf_counter
from types import FrameType
from typing import Any, TypeVar

from numba import njit
from numba.core import event, serialize
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import CompilerBase, DefaultPassBuilder
from numba.core.compiler_machinery import register_pass
from numba.core.typed_passes import NativeLowering
from numba.core.types.misc import unliteral

from safe_ompl.common.errors import warn_once
from safe_ompl.common.machine_code import PACKAGE, ROOT, digest, kept, load_whole

_log = logging.getLogger(__name__)
_Function = TypeVar("_Function", bound=Callable[..., Any])
# Of parts, too: Numba compiles its own functions, such as np.empty, once for each set of options.
_OPTIONS = {"nogil": True, "error_model": "numpy", "no_cfunc_wrapper": True, "_nrt": True}
_NOT_KEPT = "each time, as no folder to keep them in can be written to; name one with NUMBA_CACHE_DIR"
_PATIENCE = 60.0  # [s] with a process that compiles, once all else is compiled
_ENDS_WITH_US = """
import os, threading
threading.Thread(target=lambda: (os.read(0, 1), os._exit(1)), daemon=True).start()
"""  # its input ends when this process does, however that ends


def compiled(function: _Function) -> _Function:
    """Return a kernel: `function` compiled on its first call; free of the GIL, and x/0 is ±∞ as in NumPy."""
    return _lazily(_kernel, function, _OPTIONS)


def caller(function: _Function) -> _Function:
    """Return a kernel that does little but call other kernels, which are not optimised once more: half of the time."""
    return _lazily(_kernel, function, _OPTIONS | {"pipeline_class": _CallerCompiler})


class _Lazy:
    """A kernel, or a part of some, that Numba knows from when it is first asked for: many a program needs few."""

    def __init__(self, make: Callable[..., Any], function: Any, options: dict[str, Any]) -> None:
        update_wrapper(self, function)
        self._make = partial(make, function, options)

    @cached_property
    def _dispatcher(self) -> Any:
        return self._make()

    def __call__(self, *arguments: Any) -> Any:
        return self._dispatcher(*arguments)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._dispatcher, name)


def _lazily(make: Callable[..., Any], function: _Function, options: dict[str, Any]) -> _Function:
    return _Lazy(make, function, options)  # type: ignore[return-value]


def _kernel(function: Any, options: dict[str, Any]) -> Any:
    kernel: Any = njit(**options)(function)
    try:
        kernel.enable_caching()
    except RuntimeError as error:  # Numba finds no folder that can be written to
        _log.info("%s", error)
        _compilation.kept = _NOT_KEPT
    else:  # Numba looks at the kernel's own file only, although what other kernels do is compiled into it
        files = kernel._cache._cache_file
        files._source_stamp = files._source_stamp, digest(ROOT)
    load_whole(kernel)
    return _without_literals(kernel)


def part(function: _Function) -> _Function:
    """Return a part of kernels: `function`, compiled into the kernels that call it; Python cannot call it.

    It makes no arrays, as a `maker` does, and calls no part that returns new ones: within it Numba does not count who
    holds which array. Counting takes as long as all else that small parts do.
    """
    return _lazily(_part, function, {"_nrt": False})


def inlined(function: _Function) -> _Function:
    """Return a part that is put into the loop that calls it, for LLVM would pass arrays one number after the other."""
    return _lazily(_part, function, {"_nrt": False, "forceinline": True})


def maker(function: _Function) -> _Function:
    """Return a part of kernels that makes arrays."""
    return _lazily(_part, function, {})


def expanded(function: _Function) -> _Function:
    """Return a part that Numba copies into the kernel that calls it: its arrays on the stack last as long as that."""
    return _lazily(_part, function, {"inline": "always"})


def _part(function: Any, options: dict[str, bool]) -> Any:
    return _without_literals(njit(pipeline_class=_PartCompiler, **(_OPTIONS | options))(function))


class _PartLibrary(JITCodeLibrary):  # type: ignore[misc]
    """What LLVM is to know of a part: no machine code, and not optimised before it is within a kernel."""

    def _optimize_final_module(self) -> None:
        pass

    def _finalize_final_module(self) -> None:
        self._finalized = True


@register_pass(mutates_CFG=True, analysis_only=False)
class _PartLowering(NativeLowering):  # type: ignore[misc]
    """Lowers a part to a library from which nothing can be called."""

    _name = "part_lowering"

    def run_pass(self, state: Any) -> bool:
        state.library = _PartLibrary(state.targetctx.codegen(), state.func_id.func_qualname)
        state.flags.no_compile = state.flags.no_cpython_wrapper = True
        super().run_pass(state)
        identity: Any = [].append  # Numba knows a function by what Python would call: some built-in, unlike all others
        state.targetctx.insert_user_function(identity, state.cr.fndesc, [state.library])
        state.cr = state.cr._replace(cfunc=identity)
        return True


class _CallerLibrary(JITCodeLibrary):  # type: ignore[misc]
    """What LLVM is to know of a kernel that calls others: they are optimised already."""

    def _optimize_final_module(self) -> None:
        passes, builder = self._codegen._module_pass_manager(opt=0, loop_vectorize=False, slp_vectorize=False)
        passes.run(self._final_module, builder)


@register_pass(mutates_CFG=True, analysis_only=False)
class _CallerLowering(NativeLowering):  # type: ignore[misc]
    """Lowers a kernel to a library that keeps what others in it are."""

    _name = "caller_lowering"

    def run_pass(self, state: Any) -> bool:
        state.library = _CallerLibrary(state.targetctx.codegen(), state.func_id.func_qualname)
        state.library.enable_object_caching()
        return bool(super().run_pass(state))


class _PartCompiler(CompilerBase):  # type: ignore[misc]
    """Numba's own passes with another lowering for the last but one."""

    lowering = _PartLowering

    def define_pipelines(self) -> list[Any]:
        passes = DefaultPassBuilder.define_nopython_pipeline(self.state)
        passes.passes = [(self.lowering if p is NativeLowering else p, words) for p, words in passes.passes]
        passes.finalize()
        return [passes]


class _CallerCompiler(_PartCompiler):
    """The same for kernels that call others."""

    lowering = _CallerLowering


def _without_literals(kernel: Any) -> Any:
    """Return a kernel that other kernels call with the types of constants, and not with their values.

    Numba would compile it once for calls with a variable, and anew for a 0, a 1 or a True in its place.
    """
    template = kernel.get_call_template
    kernel.get_call_template = lambda args, kws: template(tuple(map(unliteral, args)), kws)
    return kernel


def clock() -> float:
    """Return the time [s] of a clock that stops while kernels are compiled: time limits should not count that."""
    return perf_counter() - _compilation.seconds


def compile_together(kernels: Sequence[Any], jobs: Sequence[str]) -> None:
    """Do jobs, so that what they call is compiled by this process and another one, and both are busy until the end.

    Jobs are at most 256 functions without arguments that call kernels, "module:name": long ones first, and no two that
    call the same kernels. Each process takes the next one that neither has begun. Nothing happens where all of
    `kernels`, which the jobs call, are on disk already, or nothing can be kept, or within a job. Whatever becomes of
    the other process, only time is lost: what it has not kept is compiled where it is called.
    """
    found = [kept(kernel) for kernel in kernels]
    python = Path(sys.executable or "").name.startswith("python")  # and not a program that Python is part of
    if _compilation.shared or None in found or all(found) or os.cpu_count() == 1 or not python:
        return
    queue, end = os.pipe()
    os.write(end, bytes(range(len(jobs))))
    os.close(end)
    found_alike = {"PYTHONPATH": os.pathsep.join(map(os.path.abspath, sys.path)), "PYTHONSAFEPATH": "1"}
    program = f"{_ENDS_WITH_US}\nfrom {__name__} import do_jobs\ndo_jobs({queue}, {list(jobs)})"
    try:
        process = Popen(
            [sys.executable, "-c", program],
            stdin=PIPE,
            stdout=DEVNULL,
            stderr=DEVNULL,
            env=os.environ | found_alike,
            pass_fds=[queue],
        )
    except OSError as error:
        os.close(queue)
        _log.info("no second process compiles: %s", error)
        return
    with process:
        try:
            do_jobs(queue, jobs)
            begin = perf_counter()
            process.wait(_PATIENCE)
            _compilation.seconds += perf_counter() - begin
        except TimeoutExpired:
            _log.info("a process that compiles kernels takes too long")
        finally:
            process.kill()
            os.close(queue)


@contextmanager
def ctrl_c_as_such() -> Iterator[None]:
    """Raise KeyboardInterrupt where Numba makes a SystemError of a Ctrl-C that comes while it looks a kernel up."""
    try:
        yield
    except SystemError as error:
        if isinstance(error.__cause__, KeyboardInterrupt):
            raise KeyboardInterrupt from error
        raise


@contextmanager
def until_ctrl_c() -> Iterator[None]:
    """End a block at Ctrl-C without an exception: what it has found so far stands."""
    with suppress(KeyboardInterrupt), ctrl_c_as_such():
        yield


def do_jobs(queue: int, jobs: Sequence[str]) -> None:
    """Do the jobs whose numbers come from a pipe, a byte each, until there are none."""
    collects, _compilation.shared = gc.isenabled(), True
    gc.disable()  # else it goes through all that the compiler holds after each kernel
    try:
        while number := os.read(queue, 1):
            resolve_name(jobs[number[0]])()
    finally:
        _compilation.shared = False
        if collects:
            gc.enable()


class _Compilation(event.Listener):  # type: ignore[misc]
    """Announces compilation once, sums the time that it takes, and preserves a Ctrl-C that arrives meanwhile.

    What comes from the disk causes no such event. Kernels that others call are compiled within these. Meanwhile there
    is no collection of garbage: it would go through the millions of objects of a compiler again and again.

    The compiler calls Python back from C, where an exception cannot pass: ctypes prints it and goes on. A Ctrl-C while
    machine code is written is raised there, and lost. It is noted here, and raised again where a kernel begins or ends.
    """

    def __init__(self) -> None:
        self.seconds, self._depth, self._begin = 0.0, 0, 0.0
        self.shared = False  # among processes that do jobs
        self.kept = "once, they are kept"
        self._collects = False
        self._raised: BaseException | None = None
        self._handler: Any = None

    def on_start(self, event: Any) -> None:
        if not event.data["dispatcher"].__module__.startswith(PACKAGE):
            return
        warn_once(_log, f"compiling kernels for this machine, which takes 10 s to a minute: {self.kept}")
        if not self._depth:
            self._begin = perf_counter()
            self._collects = gc.isenabled()
            gc.disable()
            self._listen()
        self._depth += 1
        self._raise_again()

    def on_end(self, event: Any) -> None:
        if not event.data["dispatcher"].__module__.startswith(PACKAGE):
            return
        self._depth -= 1
        if not self._depth:
            self.seconds += perf_counter() - self._begin
            if self._collects:
                gc.enable()
            if self._handler is not None:
                signal.signal(signal.SIGINT, self._handler)
                self._handler = None
        self._raise_again()

    def _listen(self) -> None:
        """Note from here on whether there is a Ctrl-C; only the main thread is told."""
        self._raised = None
        handler = signal.getsignal(signal.SIGINT)
        if callable(handler) and threading.current_thread() is threading.main_thread():
            self._handler = handler
            signal.signal(signal.SIGINT, self._note)

    def _note(self, number: int, frame: FrameType | None) -> None:
        try:
            self._handler(number, frame)
        except BaseException as error:
            self._raised = error
            raise

    def _raise_again(self) -> None:
        error, self._raised = self._raised, None
        if error is not None:
            raise error


# A kernel that returns arrays looks their class up by this function. Where Python is called a Ctrl-C may be raised, and
# Numba ends with a SystemError then. In C, as a memory of functools, nothing can be raised.
serialize._numba_unpickle = lru_cache(None)(serialize._numba_unpickle)
_compilation = _Compilation()
event.register("numba:compile", _compilation)
