"""Doors: packages that list the public names of a room, and import a module only when one of its names is asked for."""

from __future__ import annotations

import re
from collections.abc import Callable
from functools import partial
from importlib import import_module
from pathlib import Path
from sys import modules

_IMPORT, _NAME = re.compile(r"from ([\w.]+) import (\([^)]*|[^\n(]*)"), re.compile(r"\w+ as (\w+)")
Door = tuple[Callable[[str], object], Callable[[], list[str]], list[str]]


def lazily(package: str, file: str) -> Door:
    """Return `__getattr__`, `__dir__` (PEP 562) and `__all__` of a package whose names are imported when asked for.

    The names and where they come from are read from the block `if TYPE_CHECKING:` of the package's own source. There
    type checkers, editors and readers see them, too: ``import X as X`` says that X is public (PEP 484). A name that is
    a module of the package stays a module.

    Parameters
    ----------
    package : str
        The package's `__name__`.
    file : str
        The package's `__file__`.
    """
    sources = _sources(Path(file).read_text(encoding="utf-8"))
    return partial(_import, package, sources), partial(_names, package, sources), sorted(sources)


def _sources(text: str) -> dict[str, str]:
    """Return the module of each name that is imported in the block `if TYPE_CHECKING:` of a source text."""
    imports = _IMPORT.findall(text.partition("\nif TYPE_CHECKING:\n")[2])
    return {name: module for module, names in imports for name in _NAME.findall(names)}


def _import(package: str, sources: dict[str, str], name: str) -> object:
    """Import `name` of a package, and keep it there."""
    if name not in sources:
        raise AttributeError(f"module {package!r} has no attribute {name!r}")
    source, inner = sources[name], f"{package}.{name}"
    try:
        found: object = import_module(inner) if source in (package, inner) else getattr(import_module(source), name)
    except ModuleNotFoundError as error:
        if error.name != "ompl":
            raise
        raise ModuleNotFoundError(f"{name} plans with OMPL, which is missing: pip install ompl", name="ompl") from None
    setattr(modules[package], name, found)
    return found


def _names(package: str, sources: dict[str, str]) -> list[str]:
    """Return the names of a package, those not yet imported too."""
    return sorted({*vars(modules[package]), *sources})
