"""Ticks of a simulation beside people, as a file of JSON lines.

The first line is a header:

    {"format": "safe-ompl ticks", "version": 2, "tick": 0.05, "joint_names": [...], "robot": {...}, "scene": {...},
     "people": {"operator": {"height": 1.75, "limbs": ["head", ...], "noise": 0.0, "speeds": {"head": 1.6, ...}}},
     "objects": {"cube": 0.5}, "rules": {"clearance": 0.0, "contact": false, "assumed": "..."},
     "made_by": {"safe-ompl": "0.1.0", ...}}

``robot`` and ``scene`` are as in saved results (`safe_ompl.io.problems`); the scene holds what stands still, and moving
objects where they are at first, but no tracked people; ``objects`` are bounds of speeds [m/s]. In a time t a limb goes
no farther than its speed · t, of ``speeds`` [m/s]; ``noise`` bounds the errors of measurements [m]. Every other line is
a tick:

    {"time": 1.25, "q": [...], "qd": [...], "stop": {"times": [1.25, 1.3, ...], "q": [[...], ...], "qd": [[...], ...]},
     "people": {"operator": {"head": [x, y, z], "left_shoulder": [...], ...}},
     "objects": {"cube": {"position": [x, y, z], "quaternion_xyzw": [...]}},
     "state": "moving" | "slowed" | "braking" | "standing" | "retreating" | "done",
     "margin": 0.021, "distance": 0.48, "link": "panda_hand", "who": "operator", "limb": "right_hand",
     "reason": "...", "rule": "contact", "obeyed": true, "path": 3, "task": 2, "reaction": 0.004, "measured": 1.25,
     "ahead": [[q...], ...]}

Lengths are metres, times seconds. A tick describes the instant ``time``. People and objects are where they truly are
then, in the world; the key points are those of `safe_ompl.geometry.person` (18 with the pelvis): ``Person(height,
keypoints)`` at the world's origin draws them. ``q``, ``qd``, ``state``, ``margin``, ``reason``, ``rule``, ``measured``
and ``path`` belong to the command that the robot follows at that instant; ``stop`` is the rest of that command, until
the robot stands, which is what is proven. The command that answers the measurement of ``time`` holds a latency later,
so the next tick shows it. ``margin`` is the smallest margin along the proven motion (null: nobody is there);
``distance`` is the distance between ``link`` and ``limb`` of ``who``, the nearest ones (null: not observed).
``reason`` says why the robot is not as fast as it could be, and ``rule`` which rule about people keeps it from that:
separation, contact, clamping, or null; ``measured`` is the time of the measurement against which its motion is proven.
``path`` counts the paths that were followed, ``task`` how often the goal was reached; ``joints_measured`` is when ``q``
and ``qd`` were measured, if not at ``time``. ``ahead``, in the first tick of
a path, are the way points of that path. ``obeyed`` says whether everybody kept to the reach model until the next tick;
``reaction`` is how long the answer to this measurement took (null: too long). Ticks of a `Shield` have no truth but
what was seen last, no ``obeyed`` and no ``reaction``; ``follows`` and ``delay`` are those of a `ShieldCommand`.
If a controller executes a program, ``step`` is the number of its step, from 1, and ``holds`` names attached objects.
"""

from __future__ import annotations

from collections.abc import Mapping
from importlib.metadata import version
from pathlib import Path
from typing import Any, Protocol

from safe_ompl.common import InputError, documents as document, files
from safe_ompl.io import schema
from safe_ompl.io.problems import carried_scene, packed_robot
from safe_ompl.io.schema import strict_json
from safe_ompl.robot import Robot
from safe_ompl.scene import Scene

FORMAT, VERSION = "safe-ompl ticks", 2
_MAKERS = ("safe-ompl", "numpy", "pin", "coal")


def ticks_header(tick: float, robot: Robot, scene: Scene, moving: Mapping[str, Any]) -> dict[str, Any]:
    """Return the first line of a file: the length of a tick [s], robot, what stands still, and who and what moves."""
    return {
        "format": FORMAT,
        "version": VERSION,
        "tick": tick,
        "joint_names": list(robot.joint_names),
        "robot": packed_robot(robot),
        "scene": carried_scene(scene),
        "made_by": {name: version(name) for name in _MAKERS},
        **moving,
    }


class TickLog(Protocol):
    """What takes ticks one by one, as they come."""

    def write(self, tick: Mapping[str, Any]) -> None:
        """Take a tick."""

    def close(self) -> None:
        """Take no more, and finish what was written."""


class TicksFile:
    """A file of ticks that begins with a header."""

    def __init__(self, file: Path, header: Mapping[str, Any]) -> None:
        self._stream = file.open("w", encoding="utf-8")
        self.write(header)

    def write(self, tick: Mapping[str, Any]) -> None:
        """Write a line."""
        print(strict_json(tick), file=self._stream)

    def close(self) -> None:
        """Close the file."""
        self._stream.close()


def read_ticks(file: str | Path) -> tuple[dict[str, Any], list[dict[str, Any]]]:
    """Return the header and the ticks of a file; an InputError if it is no such file."""
    lines = []
    with document.within(str(file), ": "):
        for number, line in enumerate(files.file_text(Path(file)).splitlines(), 1):
            if line.strip():
                lines.append(files.parse_json(line, number))
    if not lines or not all(isinstance(line, dict) for line in lines):
        raise InputError("must hold a JSON object in every line", str(file))
    check_header(lines[0], file)
    return lines[0], lines[1:]


def check_header(header: Mapping[str, Any], file: str | Path) -> None:
    """Raise InputError, which names the file, unless this is the header of ticks of this version."""
    with document.within(f"{file}: header"):
        schema.check_form(header, FORMAT, VERSION)
