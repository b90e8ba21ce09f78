"""Machine code of kernels: where it is kept, whether it is of these sources, and how it is loaded, which takes ms."""

from __future__ import annotations

import logging
import os
import pickle
import re
import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache, partial
from hashlib import blake2b
from pathlib import Path
from typing import Any

import llvmlite
import numba
from llvmlite.binding import parse_bitcode
from numba.core.caching import IndexDataCacheFile
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import CompileResult
from numba.core.runtime import rtsys

_log = logging.getLogger(__name__)
PACKAGE = __name__.partition(".")[0] + "."
ROOT = Path(__file__).parents[__name__.count(".") - 1]
_MACHINE_CODE = ROOT / "machine_code"  # of a wheel that holds it: folders for some Python and Numba each, named so:
PLATFORM = f"{sys.implementation.cache_tag}-numba-{numba.__version__}-llvmlite-{llvmlite.__version__}"
_BEGINNING = 8000  # bytes of a file that hold its imports
_WORDS = b"compiled", b"part", b"caller", b"maker", b"inlined", b"expanded"
_IMPORTED = re.compile(
    rf"^from {PACKAGE}[\w.]+ import (?:\([^)]*?|[^\n(]*)\b(?:{b'|'.join(_WORDS).decode()})\b".encode(), re.MULTILINE
)


def shipped_files(kernel: Any, folder: Path | None = None) -> IndexDataCacheFile:
    """Return the files of a kernel's machine code in a folder: that of the wheel for this Python and Numba if None."""
    name = f"{kernel.py_func.__module__}.{kernel.py_func.__qualname__}"
    return IndexDataCacheFile(str(folder or _MACHINE_CODE / PLATFORM), name, digest(ROOT))


def origin(kernel: Any) -> str:
    """Say in a line where the machine code of kernels comes from, by one of them: the wheel, or this machine."""
    if shipped(kernel):
        return "machine code of the wheel"
    held = ", ".join(sorted(path.name for path in _MACHINE_CODE.glob("*")))
    return f"compiled here: the wheel's are for {held}, or other instructions" if held else "compiled here"


def shipped(kernel: Any) -> dict[Any, Path]:
    """Return by signature the files with a kernel's machine code that the wheel holds and this processor can run.

    It was compiled from the same sources for some instructions, all of which this process may use.
    """
    files = shipped_files(kernel)
    triple, _, features = kernel.targetctx.codegen().magic_tuple()
    return {
        signature: Path(files._data_path(name))
        for (signature, (known, _, needed), _), name in files._load_index().items()
        if known == triple and set(needed.split(",")) <= {"", *features.split(",")}
    }


def load_whole(kernel: Any) -> None:
    """Let a kernel be loaded as a whole or not at all: anew where its files are damaged, and Ctrl-C waits.

    The loader calls Python back from C, where an exception cannot pass: with half a kernel the process crashes. Numba
    itself stays broken where Ctrl-C comes while it prepares for the first one.
    """
    cache = kernel._cache
    load = getattr(cache, "_load_overload", cache.load_overload)

    def loaded(signature: Any, context: Any) -> Any:
        codegen = context.codegen()
        with _ctrl_c_waits():
            codegen.unserialize_library = partial(_LoadedLibrary, codegen)  # Numba's lock of compilation is held
            try:
                rtsys.initialize(context)  # all else that Numba prepares is of use to who compiles
                found = load(signature, context)
                if found is None and (path := shipped(kernel).get(signature)):
                    found = CompileResult._rebuild(context, *pickle.loads(path.read_bytes()))
                return found
            except Exception as error:  # of any kind: what is damaged may say anything
                _log.warning("%s: a kernel that was kept is damaged (%s), and compiled anew", cache.cache_path, error)
                cache.flush()
                return None
            finally:
                del codegen.unserialize_library

    cache.load_overload = loaded


@contextmanager
def _ctrl_c_waits() -> Iterator[None]:
    """Have a Ctrl-C handled after a block; only the main thread is told of it."""
    handler, told = signal.getsignal(signal.SIGINT), list[Any]()
    if not callable(handler) or threading.current_thread() is not threading.main_thread():
        yield
        return
    signal.signal(signal.SIGINT, lambda *arguments: told.append(arguments))
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, handler)
        if told:
            handler(*told[0])


class _LoadedLibrary(JITCodeLibrary):  # type: ignore[misc]
    """A kernel from the disk: its bitcode, of use where another kernel is compiled that calls it, is read only then."""

    def __init__(self, codegen: Any, found: tuple[str, str, tuple[bytes, bytes]]) -> None:
        name, _, (machine_code, self._bitcode) = found
        super().__init__(codegen, name)
        self.enable_object_caching()
        self._set_compiled_object(machine_code)
        self._finalize_final_module()

    def _get_module_for_linking(self) -> Any:
        if self._shared_module is None:
            self._shared_module: Any = parse_bitcode(self._bitcode)
        return self._shared_module

    def get_pointer_to_function(self, name: str) -> int:
        # Numba itself asks whether the bitcode has the name first.
        return int(self._codegen._engine.get_function_address(name))


def kept(kernel: Any) -> dict[Any, Any] | None:
    """Return what is on disk of a kernel by its signatures, or None where nothing can be kept."""
    index = getattr(getattr(getattr(kernel, "_cache", None), "_cache_file", None), "_load_index", None)
    return None if index is None else index() or shipped(kernel)


def sources(package: Path) -> list[Path]:
    """Return the files below a package's folder that may hold kernels: those that import a decorator.

    Their beginnings are read for that, which takes some 10 ms: less than importing a few of them.
    """
    found = []
    for folder, _, names in os.walk(package):
        for name in names:
            if name.endswith(".py"):
                with open(os.path.join(folder, name), "rb", buffering=0) as file:
                    beginning = file.read(_BEGINNING)
                if any(word in beginning for word in _WORDS) and _IMPORTED.search(beginning):
                    found.append(Path(folder, name))
    return sorted(found)


@cache
def digest(package: Path) -> str:
    """Return a digest of the files with kernels, and of what compiles them: of their contents, wherever they are."""
    found = blake2b()
    for path in (*map(Path(__file__).with_name, ("compilation.py", "stack.py")), *sources(package)):
        found.update(str(path.relative_to(package)).encode() + path.read_bytes())
    return found.hexdigest()
