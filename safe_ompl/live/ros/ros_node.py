"""A thin ROS 2 node around `LiveController`: it decodes messages, and publishes commands, diagnostics and markers.

With a `TrajectoryGuard` the node serves the action `control_msgs/action/FollowJointTrajectory` in front of a
controller of ros2_control.

ROS (rclpy, and the packages of the messages) is imported when a node is started. Messages are passed as bytes, which
`messages` encodes and decodes, so that an invalid message causes an error for this message only.
"""

from __future__ import annotations

import signal
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import partial
from importlib import import_module
from threading import Event
from time import perf_counter
from typing import Any

import numpy as np
import pinocchio as pin

from safe_ompl.common import InputError
from safe_ompl.geometry import Pose
from safe_ompl.io import TickLog
from safe_ompl.live.ros import messages
from safe_ompl.live.ros.controller import LiveController
from safe_ompl.live.ros.execution import ACTION, Execution, GoalError, Outcome, TrajectoryGuard
from safe_ompl.scene import Scene

NODE = "safe_ompl"
CLOUD, POSE = "sensor_msgs/msg/PointCloud2", "geometry_msgs/msg/PoseStamped"
# The same warning is repeated after this time at the earliest.
_AGAIN = 5.0  # [s]
# The interval of the search for other nodes that command the same robot.
_CHECK = 1.0  # [s]
# The interval of the check whether the node is to end.
_LOOK = 0.1  # [s]
# The most units of work for the search of detours between two ticks.
_UNITS = 60
# The share of the time between two ticks that this search may take.
_DETOUR_TIME_SHARE = 0.3


@contextmanager
def ros_context(arguments: Sequence[str]) -> Iterator[Any]:
    """Start ROS with the arguments after ``--ros-args``, yield a node, and end it; raises InputError without ROS."""
    try:
        rclpy = import_module("rclpy")
        signals = import_module("rclpy.signals")
    except ImportError as error:
        raise InputError(f"needs ROS 2 ({error}): source yours, or pip install 'safe-ompl[ros]'") from None
    try:
        rclpy.init(args=["--ros-args", *arguments], signal_handler_options=signals.SignalHandlerOptions.NO)
    except Exception as error:  # of rclpy's own kinds
        raise InputError(" ".join(str(error).split()), "--ros-args") from None
    try:
        yield rclpy.create_node(NODE)
    finally:
        rclpy.try_shutdown()


def message_class(kind: str) -> Any:
    """Return rclpy's class of a type, such as `messages.JOINT_STATE`; raise InputError if it is not installed."""
    package, _, name = kind.split("/")
    try:
        return getattr(import_module(f"{package}.msg"), name)
    except (ImportError, AttributeError):
        raise InputError(f"{kind} is missing: install ros-{package.replace('_', '-')}") from None


def _quality(*, reliable: bool = True, latched: bool = False) -> Any:
    """Return a QoS profile: keep the last message; latched: late subscribers get them, too."""
    qos = import_module("rclpy.qos")
    return qos.QoSProfile(
        depth=1,
        reliability=qos.ReliabilityPolicy.RELIABLE if reliable else qos.ReliabilityPolicy.BEST_EFFORT,
        durability=qos.DurabilityPolicy.TRANSIENT_LOCAL if latched else qos.DurabilityPolicy.VOLATILE,
    )


def lookup_of(node: Any) -> Callable[[str, str, Any], pin.SE3 | None] | None:
    """Return the function by which `FramePlaces` looks up other frames with tf2; None without tf2."""
    try:
        tf2 = import_module("tf2_ros")
    except ImportError:
        return None
    buffer = tf2.Buffer(node=node)
    listener = tf2.TransformListener(buffer, node)

    def lookup(target: str, frame: str, header: Any) -> pin.SE3 | None:
        # The listener fills the buffer as long as it is referenced.
        assert listener is not None
        time = import_module("rclpy.time").Time(seconds=header.stamp.sec, nanoseconds=header.stamp.nanosec)
        if not buffer.can_transform(target, frame, time):
            return None
        found = buffer.lookup_transform(target, frame, time).transform
        place, turn = found.translation, found.rotation
        return Pose((place.x, place.y, place.z), (turn.x, turn.y, turn.z, turn.w)).se3

    return lookup


class RosNode:
    """Connects a controller, whose clock is the node's, with topics; `run` calls it until it is interrupted.

    `frames` has the poses of sensor frames, `scene` the obstacles to draw, and `log` takes the ticks. With a `guarded`
    controller of ros2_control the node serves an action, and trajectories take the place of goals.
    """

    def __init__(
        self,
        node: Any,
        controller: LiveController,
        frames: messages.FramePlaces,
        scene: Scene,
        log: TickLog | None = None,
        *,
        guarded: str = "",
    ) -> None:
        self._node, self._controller, self._frames, self._log = node, controller, frames, log
        self._robot = controller.cell.robot
        self._warned_at: dict[str, float] = {}
        self._units = 10.0
        self._shown: Scene | None = None
        self._pilot: LiveController | TrajectoryGuard = controller
        self._server: TrajectoryServer | None = None
        self._topic = f"{guarded}/joint_trajectory" if guarded else "command"
        if guarded:
            self._pilot = TrajectoryGuard(controller, lambda: node.get_clock().now().nanoseconds / messages.SECOND)
            self._server = TrajectoryServer(node, self._pilot, f"{guarded}/{ACTION}")
        self._commands = self._publisher(messages.JOINT_TRAJECTORY, self._topic)
        self._diagnostics = self._publisher(messages.DIAGNOSTICS, "/diagnostics")
        self._tracked = self._publisher(messages.MARKERS, "tracked")
        self._still = self._publisher(messages.MARKERS, "scene", latched=True)
        self._subscribe_to_all()
        clock = import_module("rclpy.clock")
        # Ticks continue if ROS time stands still.
        steady = clock.Clock(clock_type=clock.ClockType.STEADY_TIME)
        node.create_timer(controller.options.replanning.tick, self._tick, clock=steady)
        node.create_timer(_CHECK, self._look_for_others, clock=steady)
        self._show(scene)

    def run(self, ready: Callable[[], None]) -> None:
        """Call `ready`, and control the robot until Ctrl-C or SIGTERM; call it in the main thread only."""
        executor = import_module("rclpy.executors").SingleThreadedExecutor()
        executor.add_node(self._node)
        stopped = Event()
        # Signals only set an event, because an exception could be raised and lost inside compiled code or a callback.
        before = {number: signal.signal(number, lambda *_: stopped.set()) for number in (signal.SIGINT, signal.SIGTERM)}
        try:
            ready()
            while not stopped.is_set():
                executor.spin_once(timeout_sec=_LOOK)
        finally:
            for number, handler in before.items():
                signal.signal(number, handler)
            executor.shutdown()
            self._controller.close()

    # -------------------------------------------------------------------------------------------------- messages

    def _publisher(self, kind: str, topic: str, *, latched: bool = False) -> Callable[[Mapping[str, Any]], None]:
        """Return a function that publishes mappings as messages of a type."""
        publisher = self._node.create_publisher(message_class(kind), topic, _quality(latched=latched))
        return lambda content: publisher.publish(messages.encoded(kind, content))

    def _subscribe(self, kind: str, topic: str, take: Callable[[Any], object], *, reliable: bool = False) -> None:
        """Pass the messages of a topic to `take`; errors of a message are logged, and the node continues."""

        def received(data: bytes) -> None:
            try:
                take(messages.decoded(kind, data))
            # No message may end the node.
            except Exception as error:
                self._complain(f"{topic}: {' '.join(str(error).split()) or type(error).__name__}")

        # Of sensor messages only the newest one counts.
        quality = _quality(reliable=reliable)
        self._node.create_subscription(message_class(kind), topic, received, quality, raw=True)

    def _complain(self, what: str) -> None:
        """Log a warning, the same one at most once in five seconds."""
        now = self._node.get_clock().now().nanoseconds / messages.SECOND
        if abs(now - self._warned_at.get(what, -np.inf)) > _AGAIN:
            self._warned_at = {
                what: now,
                **{warning: time for warning, time in self._warned_at.items() if abs(now - time) <= _AGAIN},
            }
            self._node.get_logger().warning(what)

    def _subscribe_to_all(self) -> None:
        """Subscribe to the topics of sensors and users, and pass their messages to the controller."""
        controller, cell, frames = self._controller, self._controller.cell, self._frames

        def joints(message: Any) -> None:
            controller.receive_joints(
                messages.stamp_of(message.header), message.name, message.position, message.velocity
            )

        def people(message: Any) -> None:
            if not cell.trackers:
                raise InputError("nobody is tracked: give --people", "people")
            skeleton = next(iter(cell.trackers.values())).skeleton
            controller.receive_people(*messages.people_of_markers(message, skeleton, frames))

        def thing(name: str, message: Any) -> None:
            time, pose = messages.pose_of(message, frames)
            controller.receive_object(time, name, pose)

        self._subscribe(messages.JOINT_STATE, "joint_states", joints)
        self._subscribe(messages.MARKERS, "people", people)
        for name in cell.objects:
            self._subscribe(POSE, f"obstacles/{name}", partial(thing, name))
        # A cloud would contain points of the carried object.
        if cell.program:
            self._subscribe(messages.BOOL, "run", lambda message: controller.run(message.data), reliable=True)
            return
        radius = controller.options.cloud_radius
        self._subscribe(
            CLOUD, "cloud", lambda cloud: controller.receive_cloud(*messages.cloud_of(cloud, radius, frames))
        )
        if cell.shielded:
            proposal = messages.JOINT_TRAJECTORY, "proposal"
            self._subscribe(*proposal, lambda message: controller.propose(*messages.proposal_of(message, self._robot)))
        elif self._server is None:
            go_to = controller.go_to
            self._subscribe(messages.JOINT_STATE, "goal", lambda goal: go_to(goal.name, goal.position), reliable=True)

    # ----------------------------------------------------------------------------------------------------- ticks

    def _tick(self) -> None:
        tick = self._pilot.tick()
        if self._server is not None:
            self._server.tell(tick["time"])
        time = messages.nanoseconds(tick["time"])
        if self._controller.segments is not None:
            self._show(self._controller.segments.current.scene)
        if self._controller.driving:
            self._command()
        self._diagnostics(messages.diagnostics(time, self._robot.name, tick))
        if tick["people"]:
            self._tracked(messages.people_markers(time, tick["people"]))
        if self._log is not None and np.isfinite([tick["q"], tick["qd"]]).all():
            self._log.write(tick)
        begin = perf_counter()
        self._controller.think(int(self._units))
        allowed = _DETOUR_TIME_SHARE * self._controller.options.replanning.tick
        faster = min(2.0, allowed / max(perf_counter() - begin, 1e-4))
        self._units = float(np.clip(self._units * faster, 1.0, _UNITS))

    def _show(self, scene: Scene) -> None:
        """Publish the obstacles, if they are others than before."""
        if self._shown is None or self._shown.obstacles != scene.obstacles:
            self._shown = scene
            self._still(messages.obstacle_markers(0, scene))

    def _command(self) -> None:
        """Publish the rest of the command until the robot stands."""
        times, states = self._controller.stop()
        kinds = {"positions": "q", "velocities": "qd", "accelerations": "qdd"}
        rows = {key: [getattr(state, kind) for state in states] for key, kind in kinds.items()}
        self._commands(messages.joint_trajectory(self._robot.joint_names, times, **rows))

    def _look_for_others(self) -> None:
        """Keep the robot still while another node commands it, too."""
        topic = self._node.resolve_topic_name(self._topic)
        count = self._node.count_publishers(topic)
        self._controller.blocked = f"{count} nodes publish {topic}" if count > 1 else ""


def trajectory_action() -> Any:
    """Return the class of the action; raise InputError where there is none."""
    try:
        return import_module("control_msgs.action").FollowJointTrajectory
    except ImportError as error:
        what = f"needs control_msgs of ROS 2 ({error}): source yours, with ros-DISTRO-control-msgs"
        raise InputError(what) from None


class TrajectoryServer:
    """Serves the action under a name: goals go to the guard, what it reports becomes their result."""

    def __init__(self, node: Any, guard: TrajectoryGuard, name: str) -> None:
        self._node, self._guard, self._kind = node, guard, trajectory_action()
        # The handle of the action's goal that is executed.
        self._handle: Any = None
        action = import_module("rclpy.action")
        self._future = import_module("rclpy.task").Future
        self.server = action.ActionServer(
            node,
            self._kind,
            name,
            self._execute,
            cancel_callback=lambda handle: self._cancel(handle, action.CancelResponse),
        )

    async def _execute(self, handle: Any) -> Any:
        """Let the guard drive a goal, and return its result; ticks go on meanwhile."""
        robot, options = self._guard.controller.cell.robot, self._guard.controller.options
        finished = self._future()
        try:
            execution = Execution.of(handle.request, robot, options.tolerance)
            execution.report = finished.set_result
            self._handle = handle
            self._guard.take(execution)
            outcome = await finished
        except GoalError as error:
            outcome = Outcome(error.code, str(error))
        if self._handle is handle:
            self._handle = None
        if outcome.cancelled and handle.is_cancel_requested:
            handle.canceled()
        elif outcome.code == 0:
            handle.succeed()
        else:
            self._node.get_logger().warning(f"aborted: {outcome.reason}")
            handle.abort()
        return self._kind.Result(error_code=int(outcome.code), error_string=outcome.reason)

    def _cancel(self, handle: Any, response: Any) -> Any:
        if handle is self._handle or (self._handle and handle.goal_id == self._handle.goal_id):
            self._guard.cancel()
        return response.ACCEPT

    def tell(self, time: float) -> None:
        """Publish where the robot should be and where it is, at a time [s]."""
        place, joints = self._guard.progress(), self._guard.controller.joints
        if self._handle is None or not self._handle.is_active or place is None or joints is None:
            return
        robot = self._guard.controller.cell.robot
        feedback = self._kind.Feedback(joint_names=list(robot.joint_names))
        _set(feedback.header.stamp, time)
        after, q, qd = place
        rows = ((q, qd), (joints.q, joints.qd), (robot.difference(joints.q, q), qd - joints.qd))
        parts = (feedback.desired, feedback.actual, feedback.error)
        for part, (positions, velocities) in zip(parts, rows, strict=True):
            part.positions, part.velocities = positions.tolist(), np.nan_to_num(velocities).tolist()
            _set(part.time_from_start, max(after, 0.0))
        self._handle.publish_feedback(feedback)


def _set(message: Any, time: float) -> None:
    """Let a Time or Duration be a number of seconds."""
    for field, value in messages.stamp(messages.nanoseconds(time)).items():
        setattr(message, field, value)
