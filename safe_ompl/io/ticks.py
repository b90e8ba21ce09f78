"""Write and read the ticks of a simulation with people, as a file of JSON lines.

The first line is a header:

    {"format": "safe-ompl ticks", "version": 2, "tick": 0.05, "joint_names": [...], "robot": {...}, "scene": {...},
     "people": {"operator": {"height": 1.75, "limbs": ["head", ...], "noise": 0.0, "speeds": {"head": 1.6, ...}}},
     "objects": {"cube": 0.5}, "rules": {"clearance": 0.0, "contact": false, "assumed": "..."},
     "made_by": {"safe-ompl": "0.1.0", ...}}

``robot`` and ``scene`` are as in saved results (`safe_ompl.io.problems`). The scene holds the static obstacles, and the
moving objects at their first positions, but no tracked people. ``objects`` are speed limits of moving objects [m/s].
``speeds`` are speed limits of limbs [m/s]: in a time t a limb moves at most speed · t. ``noise`` bounds the measurement
error [m]. Every other line is a tick:

    {"time": 1.25, "q": [...], "qd": [...], "stop": {"times": [1.25, 1.3, ...], "q": [[...], ...], "qd": [[...], ...]},
     "people": {"operator": {"head": [x, y, z], "left_shoulder": [...], ...}},
     "objects": {"cube": {"position": [x, y, z], "quaternion_xyzw": [...]}},
     "state": "moving" | "slowed" | "braking" | "standing" | "retreating" | "done",
     "margin": 0.021, "distance": 0.48, "link": "panda_hand", "who": "operator", "limb": "right_hand",
     "reason": "...", "rule": "contact", "obeyed": true, "path": 3, "task": 2, "reaction": 0.004, "measured": 1.25,
     "ahead": [[q...], ...]}

Lengths are in metres, times in seconds. A tick describes the instant ``time``.

``people`` and ``objects`` are the true positions at this instant in the world frame. The key points are those of
`safe_ompl.geometry.person` (18 with the pelvis); ``Person(height, keypoints)`` at the world's origin draws them.

``q``, ``qd``, ``state``, ``margin``, ``reason``, ``rule``, ``measured`` and ``path`` belong to the command that the
robot follows at this instant. ``stop`` is the rest of this command until the robot stands still; the rest is proven.
The command computed from the measurement at ``time`` takes effect one latency later, so the next tick shows it.
``margin`` is the smallest margin along the proven motion (null: no person is present). ``distance`` is the distance
between ``link`` and ``limb`` of ``who``, the nearest pair (null: not observed). ``reason`` says why the robot is slower
than possible, and ``rule`` is the rule about people that limits the speed: separation, contact, clamping, or null.
``measured`` is the time of the measurement that the proof of the motion uses. ``path`` counts the paths followed, and
``task`` counts how often the goal was reached. ``joints_measured`` is the time at which ``q`` and ``qd`` were measured,
if it differs from ``time``. ``ahead``, in the first tick of a path, holds the way points of the path.

``obeyed`` says whether all people kept to the reach model until the next tick. ``reaction`` is the time that the
computation of the command took (null: too long). In ticks of a `Shield`, people and objects are the last measured ones,
and ``obeyed`` and ``reaction`` are missing; ``follows`` and ``delay`` are those of a `ShieldCommand`. If a controller
executes a program, ``step`` is the number of the step, from 1, and ``holds`` names the attached objects.
"""

from __future__ import annotations

from collections.abc import Mapping
from importlib.metadata import version
from pathlib import Path
from typing import Any, Protocol

from safe_ompl.common import InputError, documents as document, files
from safe_ompl.io import schema
from safe_ompl.io.problems import embedded_scene, packed_robot
from safe_ompl.io.schema import strict_json
from safe_ompl.robot import Robot
from safe_ompl.scene import Scene

FORMAT, VERSION = "safe-ompl ticks", 2
_MAKERS = ("safe-ompl", "numpy", "pin", "coal")


def ticks_header(tick: float, robot: Robot, scene: Scene, moving: Mapping[str, Any]) -> dict[str, Any]:
    """Return the header of a file: tick length [s], robot, static scene, and in `moving` the people and objects."""
    return {
        "format": FORMAT,
        "version": VERSION,
        "tick": tick,
        "joint_names": list(robot.joint_names),
        "robot": packed_robot(robot),
        "scene": embedded_scene(scene),
        "made_by": {name: version(name) for name in _MAKERS},
        **moving,
    }


class TickLog(Protocol):
    """Interface of a log that ticks are written to, one by one."""

    def write(self, tick: Mapping[str, Any]) -> None:
        """Write a tick."""

    def close(self) -> None:
        """Finish the log."""


class TicksFile:
    """A log that writes a header and ticks to a file of JSON lines."""

    def __init__(self, file: Path, header: Mapping[str, Any]) -> None:
        self._stream = file.open("w", encoding="utf-8")
        self.write(header)

    def write(self, tick: Mapping[str, Any]) -> None:
        """Write a tick as one line of JSON."""
        print(strict_json(tick), file=self._stream)

    def close(self) -> None:
        """Close the file."""
        self._stream.close()


def read_ticks(file: str | Path) -> tuple[dict[str, Any], list[dict[str, Any]]]:
    """Read the header and the ticks of a file. Raise InputError if a line is not a JSON object."""
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
    """Raise InputError, which names the file, unless the header has the format and version of ticks."""
    with document.within(f"{file}: header"):
        schema.check_form(header, FORMAT, VERSION)
