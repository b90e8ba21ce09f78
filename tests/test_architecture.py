"""The architecture: packages import public names of lower layers only, without cycles; imports in functions count."""

from __future__ import annotations

import ast
import re
from functools import cache
from graphlib import TopologicalSorter
from importlib import import_module
from pathlib import Path
from typing import NamedTuple

import pytest

import safe_ompl

PACKAGE = Path(safe_ompl.__file__).parent
# These packages cannot be imported without an extra.
NEEDS = {"safe_ompl.live.ros": ("mcap", "rosbags")}
# Each package imports only from the packages before it.
LAYERS = (
    "common",
    "geometry",
    "robot",
    "scene",
    "collision",
    "danger",
    "motions",
    "planning.ompl",
    "planning.simplification",
    "planning.planners",
    "planning",
    "tasks",
    "io",
    "certificates",
    "live",
    "live.replanning",
    "live.simulation",
    "live.ros",
    "apps.benchmark",
    "drawing",
    "apps.exchange",
    "apps",
)
EVERYWHERE = ("safe_ompl.version",)


class Import(NamedTuple):
    """One name that a module imports from the package."""

    importer: str
    line: int
    source: str
    name: str
    for_types_only: bool

    def __str__(self):
        return f"{self.importer}:{self.line} imports {self.source}.{self.name}"


def module_of(path):
    """Return the dotted name of a file of the package."""
    parts = path.relative_to(PACKAGE.parent).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


FILES = {module_of(path): path for path in sorted(PACKAGE.rglob("*.py"))}
PACKAGES = {module for module, path in FILES.items() if path.name == "__init__.py"}


def package_of(module):
    """Return the innermost listed package of a module; an empty string for `safe_ompl` itself."""
    inside = module.removeprefix("safe_ompl.")
    return max((name for name in LAYERS if f"{inside}.".startswith(f"{name}.")), key=len, default="")


def imports(module):
    """Yield what a module imports from the package; a package lists its public names in a stub."""
    stub = FILES[module].with_suffix(".pyi")
    tree = ast.parse((stub if stub.exists() else FILES[module]).read_text(encoding="utf-8"))
    blocks = [node for node in ast.walk(tree) if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.dump(node.test)]
    for_types = {inner for block in blocks for inner in ast.walk(block)}
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and (node.level or f"{node.module}.".startswith("safe_ompl.")):
            source = ".".join(filter(None, (module if node.level else "", node.module)))
            for alias in node.names:
                yield Import(module, node.lineno, source, alias.name, node in for_types)
        elif isinstance(node, ast.Import):
            for alias in node.names:
                if f"{alias.name}.".startswith("safe_ompl."):
                    yield Import(module, node.lineno, alias.name, "", node in for_types)


PUBLIC_NAMES = {module: getattr(import_module(module), "__all__", None) for module in sorted(PACKAGES)}


@cache
def all_imports():
    """Return all imports. This is a function because every worker collects the tests, and collecting must be quick."""
    return [found for module in FILES for found in imports(module)]


def between_packages():
    """Return the imports of one listed package by another."""
    return [
        found
        for found in all_imports()
        if found.importer != "safe_ompl"
        and (found.source, found.name) != ("safe_ompl", "")
        and package_of(found.importer) != package_of(found.source)
        and found.source not in EVERYWHERE
    ]


def test_packages_import_public_names_only():
    """Importing a whole package is allowed, too: it imports its modules when one of its names is used."""
    private = [
        found
        for found in between_packages()
        if found.name not in (PUBLIC_NAMES.get(found.source) or ())
        and not (not found.name and PUBLIC_NAMES.get(found.source))
    ]
    assert not private, "\n".join(map(str, private))


def test_packages_import_from_lower_layers_only():
    def layer(module):
        return LAYERS.index(package_of(module)) if package_of(module) else len(LAYERS)

    inside = [found for found in between_packages() if found.importer != "safe_ompl.__main__"]
    upwards = [found for found in inside if layer(found.source) > layer(found.importer)]
    assert not upwards, "\n".join(map(str, upwards))


def test_no_module_needs_itself_to_be_imported():
    sources: dict[str, set[str]] = {}
    homes = {(found.importer, found.name): found.source for found in all_imports()}
    for found in all_imports():
        if found.for_types_only or found.importer in PACKAGES:
            continue
        inner = f"{found.source}.{found.name}"
        target = inner if inner in FILES else found.source
        if target in PACKAGES:
            target = homes.get((target, found.name), target)
        sources.setdefault(found.importer, set()).add(target)
    tuple(TopologicalSorter(sources).static_order())  # raises CycleError


def test_a_class_name_has_one_meaning():
    homes: dict[str, set[str]] = {}
    for path in sorted(PACKAGE.rglob("*.py*")):
        if path.suffix in (".py", ".pyx"):
            for name in re.findall(r"(?m)^\s*(?:cdef )?class (\w+)", path.read_text(encoding="utf-8")):
                homes.setdefault(name, set()).add(str(path.relative_to(PACKAGE)))
    twice = {name: sorted(files) for name, files in homes.items() if len(files) > 1}
    assert not twice


@pytest.mark.parametrize("package", [package for package, names in PUBLIC_NAMES.items() if names])
def test_public_names_exist(package):
    for needed in NEEDS.get(package, ()):
        pytest.importorskip(needed)
    module, names = import_module(package), PUBLIC_NAMES[package] or ()
    assert sorted(names) == sorted(set(names))
    for name in names:
        found = getattr(module, name)
        # A module of the same name would replace the public name once the module is imported.
        assert f"{package}.{name}" not in FILES or found is import_module(f"{package}.{name}")
