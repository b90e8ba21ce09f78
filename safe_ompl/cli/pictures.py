"""A check that pictures can be drawn; they need the extra `safe-ompl[plots]`."""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path

from safe_ompl.cli.files import check_writable
from safe_ompl.errors import InputError

EXTRAS = ("matplotlib",)


def how_to_get_pictures() -> str | None:
    """Return what to install before pictures can be drawn, or None."""
    missing = [module for module in EXTRAS if find_spec(module) is None]
    if not missing:
        return None
    return f"{' and '.join(missing)} missing; get pictures with: pip install 'safe-ompl[plots]'"


def check_picture(file: str | None, option: str) -> None:
    """Raise InputError, naming `option`, if a picture cannot be drawn or written."""
    if file is None:
        return
    if Path(file).suffix.lower() != ".png":
        raise InputError(f"{file!r} must end in .png", option)
    advice = how_to_get_pictures()
    if advice:
        raise InputError(advice, option)
    check_writable(file, option)
