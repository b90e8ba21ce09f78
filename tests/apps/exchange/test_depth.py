"""Depth images of ROS 2 reach the occupancy grid, with the joints of their time."""

from dataclasses import replace

import numpy as np
import pytest

from safe_ompl import InputError, Pose, Scene
from safe_ompl.apps.exchange import Cell, ControlOptions, DepthEyes, Frames, LiveController, messages
from safe_ompl.apps.exchange.messages import camera_of, depths_of
from safe_ompl.people import OccupancyGrid


def depth_message(kind, depths, frame="camera", time=1.0, **more):
    head = messages.header(messages.nanoseconds(time), frame)
    size = {"height": depths.shape[0], "width": depths.shape[1]}
    if kind == messages.IMAGE:
        encoding = {"u": "16UC1", "f": "32FC1"}[depths.dtype.kind]
        step = depths.shape[1] * depths.dtype.itemsize
        size |= {"encoding": encoding, "step": step, "data": np.frombuffer(depths.tobytes(), np.uint8)}
    content = {"header": head, **size, **more}
    return messages.decoded(kind, messages.encoded(kind, content))


def test_images_of_ros_reach_the_grid_with_the_joints_of_their_time(panda):
    q0, now = np.array([0, -0.5, 0, -2.0, 0, 1.8, 0.7]), [1.0]
    depths = np.full((24, 32), 3000, np.uint16)
    frames = Frames(panda, {"camera": Pose((2.4, 0.0, 0.6), (-0.5, -0.5, 0.5, 0.5))})
    info = depth_message(messages.CAMERA_INFO, depths, k=[22.0, 0, 15.5, 0, 22.0, 11.5, 0, 0, 1])
    shown = []

    def make(cameras):
        grid = OccupancyGrid(panda, Scene(()), cameras)
        observe = grid.observe
        grid.observe = lambda name, frame, now: (shown.append((name, frame)), observe(name, frame, now))[1]
        return grid

    eyes = DepthEyes(["front"], make)
    cell = Cell(panda, {}, {}, lambda *_: None, eyes=eyes)
    controller = LiveController(cell, lambda: now[0], ControlOptions())
    image = depths_of(depth_message(messages.IMAGE, depths), frames)
    with pytest.raises(InputError, match=r"comes before the camera_info of all of \['front'\]"):
        controller.see_depth("front", *image)
    controller.tick()
    assert eyes.fault(1.0, 0.5) == "no camera_info of 'front' yet"
    eyes.introduce("front", camera_of(info))
    assert eyes.fault(1.0, 0.5) == "'front' shows nothing yet"
    with pytest.raises(InputError, match="comes without joint states of its time"):
        controller.see_depth("front", *image)
    for time, share in ((0.98, -1.0), (1.01, 0.5)):
        controller.see_joints(time, panda.joint_names, q0 + 0.1 * share)
    controller.see_depth("front", *image)
    ((name, frame),) = shown
    assert name == "front"
    assert frame.time == pytest.approx(1.0 - ControlOptions().clock_error)
    np.testing.assert_allclose(frame.q, q0, atol=1e-12)
    np.testing.assert_array_equal(frame.depths, depths)
    assert eyes.grid.known
    with pytest.raises(InputError, match="'front' is another camera than before"):
        eyes.introduce("front", replace(camera_of(info), middle=(15.0, 11.0)))
    now[0] = 0.5  # the clock goes back: all that was seen is forgotten
    controller.tick()
    assert not eyes.grid.known
    controller.close()


def test_images_of_ros_that_cannot_be_used_are_one_line(panda):
    depths, frames = np.full((24, 32), 2.0, np.float32), Frames(panda, {"camera": Pose()})
    time, read, pose = depths_of(depth_message(messages.IMAGE, depths), frames)
    assert (time, pose) == (1.0, Pose())
    np.testing.assert_array_equal(read, depths)
    for more, message in (
        ({"encoding": "rgb8"}, "encoding: must be one of 16UC1, mono16, 32FC1, got 'rgb8'"),
        ({"height": 25}, "data: has 3072 bytes, but 25 rows of 32 pixels are announced"),
        ({"frame": "nowhere"}, "unknown frame 'nowhere'"),
        ({"time": 0.0}, "stamp: is missing"),
    ):
        with pytest.raises(InputError, match=message):
            depths_of(depth_message(messages.IMAGE, depths, **more), frames)
    with pytest.raises(InputError, match="k: has no focal lengths"):
        camera_of(depth_message(messages.CAMERA_INFO, depths))
