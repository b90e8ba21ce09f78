"""Build backend: setuptools', with a C compiler from PyPI where the machine has none.

Building needs a C compiler. Where there is none, the package `ziglang` is added to the build requirements, and
`setup.py` compiles with it. So ``pip install`` works from source on slim images, too.
"""

from __future__ import annotations

import os
import shlex
import shutil
import sys
import sysconfig

from setuptools import build_meta as _setuptools
from setuptools.build_meta import *  # noqa: F403

ZIG = f"{shlex.quote(sys.executable)} -m ziglang cc"


def compiler() -> str | None:
    """Return the command of the machine's C compiler, or None.

    Python may have been built with a compiler that this machine does not have, so what ``CC`` or Python's own
    configuration name counts only if it can be found.
    """
    candidates = [os.environ.get("CC"), sysconfig.get_config_var("CC"), "cc", "gcc", "clang"]
    return next((command for command in candidates if command and shutil.which(shlex.split(command)[0])), None)


def _with_compiler(requirements: list[str]) -> list[str]:
    return requirements if compiler() else [*requirements, "ziglang>=0.13"]


def get_requires_for_build_wheel(config_settings: dict[str, object] | None = None) -> list[str]:
    """Return what building a wheel needs beyond `pyproject.toml` (PEP 517)."""
    return _with_compiler(_setuptools.get_requires_for_build_wheel(config_settings))


def get_requires_for_build_editable(config_settings: dict[str, object] | None = None) -> list[str]:
    """Return what an editable install needs beyond `pyproject.toml` (PEP 660)."""
    return _with_compiler(_setuptools.get_requires_for_build_editable(config_settings))
