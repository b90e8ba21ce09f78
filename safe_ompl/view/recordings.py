"""Recordings of `safe-ompl live` as contents: a robot beside people, tick by tick."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from safe_ompl.common import InputError
from safe_ompl.common import documents as document
from safe_ompl.geometry import STANDING, Pose
from safe_ompl.io import TimedMotion, built_scene, read_ticks, unpacked_robot
from safe_ompl.robot import Robot
from safe_ompl.view.content import Keypoints, Movers, ViewerContent

RECORDING_ENDING = ".jsonl"


def read_recording(
    file: str | Path, robot: Robot | None = None, package_dirs: Sequence[Path] = ()
) -> ViewerContent:
    """Return what a file of ticks shows: robot and people in motion, with the robot's state and its reason.

    Parameters
    ----------
    file : path-like
        The file.
    robot : Robot, optional
        The robot, where it is known; default: built from what the file carries.
    package_dirs : sequence of Path, optional
        Folders that hold the packages, or the meshes, that its URDF names and that do not travel.

    Raises
    ------
    InputError, CertificateError
        If it cannot be read or has another form; if robot and scene cannot be built.
    """
    header, ticks = read_ticks(file)
    with document.within(str(file), ": "):
        if len(ticks) < 2:
            raise InputError(f"must have two ticks at least, got {len(ticks)}")
        if robot is None:
            robot = unpacked_robot(document.require(header, "robot"), package_dirs)
        scene = built_scene(document.require(header, "scene"))
        times = np.array([document.require(tick, "time") for tick in ticks], dtype=float)
        motion = TimedMotion(
            robot,
            scene,
            times - times[0],
            np.array([document.require(tick, "q") for tick in ticks], dtype=float),
            np.linalg.norm([document.require(tick, "qd") for tick in ticks], axis=1),
            binding=tuple(str(document.require(tick, "state")) for tick in ticks),
            name="live",
            remarks=tuple(_remark(tick) for tick in ticks),
        )
        people = document.mapping("people", header.get("people") or {})
        movers = Movers(
            times - times[0],
            {name: float(document.require(person, "height")) for name, person in people.items()},
            [_keypoints(tick.get("people") or {}) for tick in ticks],
            [_places(tick.get("objects") or {}) for tick in ticks],
        )
    return ViewerContent(
        robot, scene, danger=None, motions={motion.name: motion}, movers=movers, title=Path(file).stem
    )


def _keypoints(people: Mapping[str, Any]) -> dict[str, Keypoints]:
    """Return the key points from which a `Person` is drawn; others, such as the pelvis, follow from them."""
    return {
        name: {point: place for point, place in points.items() if point in STANDING}
        for name, points in people.items()
    }


def _places(objects: Mapping[str, Any]) -> dict[str, Pose]:
    return {
        name: Pose(tuple(place["position"]), tuple(place["quaternion_xyzw"]))
        for name, place in objects.items()
    }


def _remark(tick: Mapping[str, Any]) -> str:
    said = str(tick["state"])
    if tick.get("distance") is not None:
        limb = str(tick.get("limb") or "").replace("_", " ")
        whose = f"{tick.get('who')}'s {limb}" if limb else str(tick.get("who"))
        said += f", {1e3 * tick['distance']:.0f} mm from {tick.get('link')} to {whose}"
    return f"{said}; {tick['reason']}" if tick.get("reason") else said
