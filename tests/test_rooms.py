"""The structure of the package: doors, floors and no circles; read from all imports, those inside functions too."""

from __future__ import annotations

import ast
from functools import cache
from graphlib import TopologicalSorter
from importlib import import_module
from pathlib import Path
from typing import NamedTuple

import pytest

import safe_ompl

PACKAGE = Path(safe_ompl.__file__).parent
NEEDS = {  # rooms that are nothing without an extra
    "safe_ompl.live.ros": ("mcap", "rosbags")
}
FLOORS = (  # rooms; each imports from those before it only
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


def room_of(module):
    """Return the innermost room of a module; nothing for the package itself."""
    inside = module.removeprefix("safe_ompl.")
    return max((room for room in FLOORS if f"{inside}.".startswith(f"{room}.")), key=len, default="")


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


DOORS = {module: getattr(import_module(module), "__all__", None) for module in sorted(PACKAGES)}


@cache
def all_imports():
    """Return all imports; not where tests are collected, which each process does."""
    return [found for module in FILES for found in imports(module)]


def between_rooms():
    """Return the imports of one room by another."""
    return [
        found
        for found in all_imports()
        if found.importer != "safe_ompl"
        and (found.source, found.name) != ("safe_ompl", "")  # what is public, whatever room it comes from
        and room_of(found.importer) != room_of(found.source)
        and found.source not in EVERYWHERE
    ]


def test_rooms_import_names_of_doors_only():
    """Or a whole door, behind which nothing is imported before one of its names is used."""
    past = [
        found
        for found in between_rooms()
        if found.name not in (DOORS.get(found.source) or ()) and not (not found.name and DOORS.get(found.source))
    ]
    assert not past, "\n".join(map(str, past))


def test_rooms_import_from_lower_floors_only():
    def floor(module):
        return FLOORS.index(room_of(module)) if room_of(module) else len(FLOORS)

    inside = [found for found in between_rooms() if found.importer != "safe_ompl.__main__"]
    upwards = [found for found in inside if floor(found.source) > floor(found.importer)]
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
    tuple(TopologicalSorter(sources).static_order())  # raises CycleError, which names the circle


@pytest.mark.parametrize("door", [door for door, names in DOORS.items() if names])
def test_doors_hold_what_they_list(door):
    for needed in NEEDS.get(door, ()):
        pytest.importorskip(needed)
    module, names = import_module(door), DOORS[door] or ()
    assert sorted(names) == sorted(set(names))
    for name in names:
        found = getattr(module, name)
        # A module of the same name would take the place of what the door hands out once it is imported.
        assert f"{door}.{name}" not in FILES or found is import_module(f"{door}.{name}")
