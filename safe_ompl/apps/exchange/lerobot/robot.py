"""LeRobot's side of `PolicyGuard`: a robot that wraps another one, and a processor step that shows it whole chunks."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pkgutil import resolve_name
from typing import Any, ClassVar

from safe_ompl.apps.exchange.policy import PolicyGuard, PolicyOptions
from safe_ompl.common import InputError
from safe_ompl.scene import Scenario

try:
    import draccus
    from lerobot.processor import ProcessorStep, ProcessorStepRegistry
    from lerobot.robots import Robot, RobotConfig, make_robot_from_config
except ModuleNotFoundError as error:
    raise ModuleNotFoundError(f"needs LeRobot ({error}): pip install lerobot", name=error.name) from None

_log = logging.getLogger(__name__)


@RobotConfig.register_subclass("safe_ompl")
@dataclass(kw_only=True)
class SafeOmplRobotConfig(PolicyOptions, RobotConfig):  # type: ignore[misc]  # of a package without types
    """A robot that guards another one."""

    robot: dict[str, Any]  # The other one, as its own options say: {type: so101_follower, port: /dev/ttyACM0}
    scenario: str  # The name or file of a scenario: the robot's URDF, what is around it, limits
    # What finds people in camera images: module:function, which gets the observation, and returns key points (J, 3) in
    # the world [m] by name. Default: the observation has them as people.NAME.
    people: str = ""


class SafeOmplRobot(Robot):  # type: ignore[misc]
    """A robot behind a shield: sends what is proven of each action to the robot that it wraps.

    It has the observations, actions, cameras and the name of that, so that data sets and policies stay as they are.
    """

    config_class, name = SafeOmplRobotConfig, "safe_ompl"
    connected: ClassVar[SafeOmplRobot | None] = None  # whom `SafeOmplChunks` tells
    guard: PolicyGuard

    def __init__(self, config: SafeOmplRobotConfig) -> None:
        super().__init__(config)
        self.inner = make_robot_from_config(draccus.decode(RobotConfig, config.robot))
        self.config, self.name, self.robot_type = config, self.inner.name, self.inner.robot_type
        self.cameras = getattr(self.inner, "cameras", {})
        # A simulation has a clock of its own [s].
        self.clock: Callable[[], float] = getattr(self.inner, "clock", time.monotonic)
        self._find, self._observed = None, -float("inf")
        if config.people:
            try:
                self._find = resolve_name(config.people)
            except (ImportError, AttributeError, ValueError) as error:
                raise InputError(f"{config.people!r} is no module:function ({error})", "people") from None

    # All but what is below is of the robot that it wraps.
    observation_features = property(lambda self: self.inner.observation_features)
    action_features = property(lambda self: self.inner.action_features)
    is_connected = property(lambda self: self.inner.is_connected)
    is_calibrated = property(lambda self: self.inner.is_calibrated)

    def calibrate(self) -> None:
        """Calibrate the robot that it wraps."""
        self.inner.calibrate()

    def configure(self) -> None:
        """Configure the robot that it wraps."""
        self.inner.configure()

    def connect(self, calibrate: bool = True) -> None:
        """Make the guard, which takes up to a minute the first time, and connect to the robot."""
        scenario = Scenario.load(self.config.scenario)
        self.guard = PolicyGuard(scenario, tuple(self.action_features), self.config, self.clock)
        self.inner.connect(calibrate)
        type(self).connected = self

    def get_observation(self) -> dict[str, Any]:
        """Return what the robot observes; the guard sees it, too."""
        self._observed = begin = self.clock()
        found = dict(self.inner.get_observation())
        people = {} if self._find is None else self._find(found)
        self.guard.see({**found, **{f"people.{name}": points for name, points in people.items()}}, begin)
        return found

    def send_action(self, action: Mapping[str, Any]) -> dict[str, Any]:
        """Send what is proven of an action, and return what was sent."""
        if self.clock() - self._observed > self.guard.period:  # who brings it back at the end does not look
            self.get_observation()
        before = self.guard.reason
        guarded = self.guard.guarded(action)
        if self.guard.reason != before:
            _log.info("%s", self.guard.reason or "as proposed")
        return dict(self.inner.send_action(guarded))

    def disconnect(self) -> None:
        """Disconnect from the robot."""
        if type(self).connected is self:
            type(self).connected = None
        self.inner.disconnect()


@ProcessorStepRegistry.register("safe_ompl_chunks")
class SafeOmplChunks(ProcessorStep):  # type: ignore[misc]
    """Shows each chunk (1, K, m) of a policy's postprocessor to the guard of the connected robot, and leaves it as is.

    The robot then knows what comes after an action. It belongs after the step that makes the robot's units of actions.
    """

    def __call__(self, transition: Any) -> Any:
        """Return the transition as it is."""
        action, robot = transition.get("action"), SafeOmplRobot.connected
        if robot is not None and getattr(action, "ndim", 0) == 3:
            robot.guard.foresee(action[0].detach().cpu().numpy())
        return transition

    def transform_features(self, features: Any) -> Any:
        """Return the features as they are."""
        return features
