"""The file of a live simulation: JSON lines, one for each tick, for pictures and for who wants to know what happened.

The first line is a header:

    {"format": "safe-ompl ticks", "version": 1, "tick": 0.05, "joint_names": [...], "robot": {...}, "scene": {...},
     "people": {"operator": {"height": 1.75, "limbs": ["head", ...]}}, "objects": {"cube": 0.5}}

``robot`` and ``scene`` are as in saved results (`exchange.problems`: `unpacked_robot`; `paths.certificate.portable`:
`built_scene`); the scene holds what stands still, and moving objects where they are at first, but no tracked people;
``objects`` are bounds of speeds [m/s]. Every other line is a tick:

    {"time": 1.25, "q": [...], "qd": [...],
     "people": {"operator": {"head": [x, y, z], "left_shoulder": [...], ...}},
     "objects": {"cube": {"position": [x, y, z], "quaternion_xyzw": [...]}},
     "state": "moving" | "slowed" | "braking" | "standing" | "done",
     "margin": 0.021, "distance": 0.48, "link": "panda_hand", "who": "operator", "limb": "right_hand",
     "reason": "...", "obeyed": true, "path": 3, "task": 2, "reaction": 0.004, "measured": 1.25,
     "ahead": [[q...], ...]}

Lengths are metres, times seconds. People and objects are where they truly are, in the world, key points those of
`safe_ompl.scene.shapes.anatomy` (18 with the pelvis): ``Person(height, keypoints)`` at the world's origin draws them.
``margin`` is what is left at least along the motion that is proven (null: nobody is there); ``distance`` the distance
now between ``link`` and ``limb`` of ``who``, the nearest ones (null: not looked at). ``reason`` says why the robot is
not as fast as it could be. ``path`` counts the ways that were taken, ``task`` the times that the goal was reached.
``ahead``, where a new way was taken, are way points of that way.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from safe_ompl.errors import InputError
from safe_ompl.exchange.form import strict_json

FORMAT, VERSION = "safe-ompl ticks", 1


def header(**content: Any) -> dict[str, Any]:
    """Return the first line."""
    return {"format": FORMAT, "version": VERSION, **content}


def write_ticks(file: Path, lines: Iterator[dict[str, Any]]) -> None:
    """Write lines as they come."""
    with file.open("w", encoding="utf-8") as stream:
        for line in lines:
            print(strict_json(line), file=stream)


def read_ticks(file: str | Path) -> tuple[dict[str, Any], list[dict[str, Any]]]:
    """Return the header and the ticks of a file.

    Raises
    ------
    InputError
        If it cannot be read, or is no such file.
    """
    try:
        lines = [
            json.loads(line) for line in Path(file).read_text(encoding="utf-8").splitlines() if line.strip()
        ]
    except (OSError, ValueError) as error:
        raise InputError(f"cannot be read as JSON lines: {error}", str(file)) from None
    if not lines or not all(isinstance(line, dict) for line in lines):
        raise InputError("must hold a JSON object in every line", str(file))
    first = lines[0]
    if first.get("format") != FORMAT:
        raise InputError(f"must begin with a header of {FORMAT!r}", str(file))
    if first.get("version") != VERSION:
        raise InputError(f"version {first.get('version')!r} is not known, {VERSION} is", str(file))
    return first, lines[1:]
