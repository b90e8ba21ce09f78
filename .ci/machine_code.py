"""Compile all of Numba's kernels to a folder, and run a command with them.

python .ci/machine_code.py FOLDER COMMAND …

A wheel that is built with SAFE_OMPL_MACHINE_CODE=FOLDER holds this machine code: who installs it waits for no
compilation. The code is for this Python, for the Numba that is installed, and for all processors with the instructions
named here. Without the variable kernels are compiled where the wheel is installed.
"""

from __future__ import annotations

import os
import platform
import shutil
import subprocess
import sys
from collections.abc import Iterable, Iterator
from importlib import import_module
from pathlib import Path
from pkgutil import resolve_name
from typing import Any

CPU = {  # name and instructions, as LLVM calls them; elsewhere the instructions that all have
    "x86_64": (  # Intel's since Haswell, AMD's since Excavator
        "x86-64-v3",
        "+avx,+avx2,+bmi,+bmi2,+crc32,+cx16,+f16c,+fma,+lzcnt,+movbe,+popcnt,+sahf,+sse3,+sse4.1,+sse4.2,+ssse3,+xsave",
    )
}


def all_kernels() -> Iterator[Any]:
    """Yield all kernels of the package that are kept: not parts of them."""
    import safe_ompl
    from safe_ompl.common.machine_code import sources

    package = Path(safe_ompl.__file__).parent
    for path in sources(package):
        parts = ("safe_ompl", *path.relative_to(package).with_suffix("").parts)
        module = import_module(".".join(part for part in parts if part != "__init__"))
        for kernel in vars(module).values():
            if hasattr(getattr(kernel, "_cache", None), "_cache_file") and kernel.__module__ == module.__name__:
                yield kernel


def copy_kept(kernels: Iterable[Any], package: Path) -> None:
    """Copy what is kept of kernels to where a package would hold it."""
    from safe_ompl.common.machine_code import PLATFORM, shipped_files

    folder = package / "machine_code" / PLATFORM
    folder.mkdir(parents=True)
    for kernel in kernels:
        kept, copied = kernel._cache._cache_file, shipped_files(kernel, folder)
        if not (index := kept._load_index()):
            sys.exit(f"{kernel.__module__}.{kernel.__name__} has no machine code: no job of the doctor calls it")
        copied._save_index({key: copied._data_name(number) for number, key in enumerate(index)})
        for number, name in enumerate(index.values()):
            shutil.copyfile(kept._data_path(name), copied._data_path(copied._data_name(number)))


def build(root: str, folder: Path) -> dict[str, str]:
    """Compile all kernels of the package in `root` to a folder, for `CPU`; return the environment to use them."""
    name, features = CPU.get(platform.machine(), ("generic", ""))
    variables = {"NUMBA_CPU_NAME": name, "NUMBA_CPU_FEATURES": features, "NUMBA_CACHE_DIR": str(folder / "cache")}
    environment = os.environ | variables
    path = os.pathsep.join([root, *sys.path])
    subprocess.run([sys.executable, __file__, str(folder)], env=environment | {"PYTHONPATH": path}, check=True)
    return environment


if __name__ == "__main__":
    folder, *command = sys.argv[1:]
    if command:
        os.execvpe(command[0], command, build(str(Path(__file__).parents[1]), Path(folder)))
    from safe_ompl.apps.cli.doctor import ALL_JOBS, compile_all

    compile_all()  # in two processes
    for job in ALL_JOBS:
        resolve_name(job)()
    copy_kept(all_kernels(), Path(folder))
