"""The robots of example-robot-data."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cache
from importlib.metadata import PackageNotFoundError, distribution
from pathlib import Path

from safe_ompl.common import InputError, UnknownNameError

_GRIPPER_OPEN = 0.04  # [m] per finger of the Panda's hand


@dataclass(frozen=True)
class ExampleRobot:
    """Files and settings of one robot of example-robot-data.

    URDF and SRDF are relative to the folder of the robots; no SRDF is given where the shipped one disables no pair. The
    tip is the frame at the end of the arm; `locked` joints are held still [rad or m].
    """

    urdf: str
    srdf: str | None
    tip: str
    locked: dict[str, float] = field(default_factory=dict)


EXAMPLES: dict[str, ExampleRobot] = {
    "panda": ExampleRobot(
        "panda_description/urdf/panda.urdf",
        "panda_description/srdf/panda.srdf",
        "panda_hand_tcp",
        {"panda_finger_joint1": _GRIPPER_OPEN, "panda_finger_joint2": _GRIPPER_OPEN},
    ),
    "ur3": ExampleRobot("ur_description/urdf/ur3_joint_limited_robot.urdf", None, "tool0"),
    "ur5": ExampleRobot(
        "ur_description/urdf/ur5_joint_limited_robot.urdf", "ur_description/srdf/ur5_joint_limited_robot.srdf", "tool0"
    ),
    "ur10": ExampleRobot("ur_description/urdf/ur10_joint_limited_robot.urdf", None, "tool0"),
    "xarm7": ExampleRobot("xarm_description/urdf/xarm7.urdf", "xarm_description/srdf/xarm7.srdf", "link_eef"),
    "kinova": ExampleRobot("kinova_description/robots/kinova.urdf", None, "j2s6s200_end_effector"),
    "z1": ExampleRobot("z1_description/urdf/z1.urdf", None, "gripperStator"),
    "so101": ExampleRobot("so_arm_description/urdf/so101.urdf", None, "gripper_frame_link"),
}


@cache
def robots_folder() -> Path:
    """Return the folder that holds the robots of example-robot-data, or raise InputError if it is not installed.

    The wheel has data only and no Python module, so it is found through the package metadata.
    """
    try:
        package = distribution("example-robot-data")
    except PackageNotFoundError:
        raise InputError("the package example-robot-data is not installed") from None
    for file in package.files or ():
        if file.name == "panda.urdf":
            return Path(str(package.locate_file(file))).resolve().parents[2]
    raise InputError("the package example-robot-data holds no robots")


def find_example(name: str) -> ExampleRobot:
    """Return the entry of the example robot called `name`, or raise UnknownNameError."""
    try:
        return EXAMPLES[name]
    except (KeyError, TypeError):
        raise UnknownNameError("example robot", name, sorted(EXAMPLES)) from None
