"""What a policy sends to motors: units, what is passed through, waiting, people; a robot that does what it is told."""

from dataclasses import replace
from importlib.util import find_spec

import numpy as np
import pytest

from safe_ompl import CollisionChecker, InputError, SafeOmplError
from safe_ompl.apps.exchange import PolicyGuard, PolicyOptions
from safe_ompl.geometry import STANDING, Obstacle, Person, Pose
from safe_ompl.people.simulation import ALL_KEYPOINTS, ContactMonitor, limb_solids
from safe_ompl.scene import MotionLimits, People, Scenario, Scene

KEYS = ("joint1.pos", "joint2.pos", "joint3.pos", "gripper.pos")
BODY = 1.75 * np.array(list(STANDING.values()))
FAST = MotionLimits(velocity=3.0, acceleration=50.0)


def planar3(*obstacles, **changes):
    """Return the planar arm among other obstacles."""
    scenario = Scenario.load("planar3")
    return replace(scenario, scene=Scene(obstacles or tuple(scenario.scene)), motion=FAST, **changes)


def beside_anna():
    """Return the planar arm, and a person of 1.6 m/s who is tracked."""
    return planar3(Obstacle("anna", Person(1.75), Pose((4.0, 0.0, -0.75))), people=People(speed=1.6))


def within(tube, scenario):
    """Return a scenario whose joints may be off by a tube [rad], or none."""
    return replace(scenario, limits=replace(scenario.limits, tube=tube))


class Bench:
    """A guard and a robot that is where it was told to be, and sags, in simulated time; motors give degrees."""

    def __init__(self, scenario, start, sag=0.0, **options):
        self.time, self.sag = 0.0, sag
        self.guard = PolicyGuard(scenario, KEYS, PolicyOptions(latency=0.0, **options), lambda: self.time)
        self.q, self.people, self.sent = np.array(start), {}, []
        self.checker = CollisionChecker(self.guard.cell.robot, self.guard.cell.robot and scenario.scene)

    def send(self, q, gripper=0.0):
        """Let the policy look and say where to go (n,) [rad]; return what was sent, in radians."""
        self.guard.see({**self.numbers(self.q), "gripper.pos": 0.0, **self.people})
        sent = self.guard.guarded({**self.numbers(q), "gripper.pos": gripper})
        told = np.radians([sent[key] for key in KEYS[:3]])
        self.q, self.time = told - self.sag, self.time + self.guard.period
        self.sent.append((told, sent["gripper.pos"]))
        return told

    @staticmethod
    def numbers(q):
        return dict(zip(KEYS[:3], np.degrees(q).tolist(), strict=True))


FREE = np.array([2.0, -0.5, 0.3])


def wave(k):
    """Return the targets (n,) of a policy that moves smoothly from `FREE`."""
    return FREE + 0.3 * (1 - np.cos(0.05 * k)) * np.array([1.0, -1.0, 0.5])


def test_what_is_free_is_sent_as_it_is():
    one = Bench(planar3(), FREE)
    for _ in range(3):
        one.send(FREE)
    for k in range(120):
        assert one.send(wave(k), gripper=k) == pytest.approx(wave(k), abs=2e-3)
        assert one.sent[-1][1] == k


def test_sag_is_learnt_and_what_is_sent_stays_the_target():
    one = Bench(planar3(), FREE, sag=0.03)
    for k in range(200):
        target = wave(max(0, k - 100))
        assert one.send(target) == pytest.approx(target, abs=0.01 + 0.03 * (k < 4))
    command = one.guard.controller.command
    assert command.at(one.time).q == pytest.approx(one.q, abs=4e-3)  # what is proven is where the robot is


def test_units():
    """Signs, scales and offsets, and motors that have other names than joints."""
    options = {"joints": {"pan": "joint1"}, "degrees": {"pan": -0.5}, "offsets": {"joint2": 90.0}}
    guard = PolicyGuard(planar3(), ("pan.pos", "joint2.pos", "joint3.pos"), PolicyOptions(**options))
    q = guard.motors.of({"pan.pos": 40.0, "joint2.pos": 10.0, "joint3.pos": -3.0})
    assert q == pytest.approx(np.radians([-20.0, 100.0, -3.0]))
    assert guard.motors.numbers(q) == pytest.approx({"pan.pos": 40.0, "joint2.pos": 10.0, "joint3.pos": -3.0})


@pytest.mark.parametrize(
    ("keys", "options", "said"),
    [
        (KEYS[:2], {}, "no motor moves 'joint3'"),
        (KEYS, {"offsets": {"elbow": 3.0}}, "offsets: .*elbow.*joint1"),
        (KEYS, {"degrees": {"joint2": 0.0}}, "degrees.joint2: must not be 0"),
        (KEYS, {"degrees": {"joint2": np.nan}}, "degrees.joint2"),
        (KEYS, {"fps": 0.0}, "fps"),
        (KEYS, {"tolerance": -1.0}, "tolerance"),
        (KEYS, {"skeleton": "octopus"}, "octopus"),
    ],
)
def test_what_cannot_be_used_is_said(keys, options, said):
    with pytest.raises(SafeOmplError, match=said):
        PolicyGuard(planar3(), keys, PolicyOptions(**options))


def test_a_missing_motor_is_named():
    one = Bench(planar3(), FREE)
    with pytest.raises(InputError, match=r"joint2\.pos"):
        one.guard.see({"joint1.pos": 0.0, "joint3.pos": 0.0})
    with pytest.raises(InputError, match="observed"):
        one.guard.guarded(one.numbers(FREE))


def test_a_policy_that_goes_into_a_machine_stops_before_it():
    """All that was sent is free, and the reason names what is in the way."""
    scenario = planar3()
    one = Bench(scenario, scenario.start_configuration(scenario.build_robot()))
    begin, reasons = one.q.copy(), set()
    for k in range(90):
        one.send(begin - np.array([0.02 * k, 0.0, 0.0]))
        reasons.add(one.guard.reason)
        assert not one.checker.in_collision(one.q)
    assert any("machine" in reason for reason in reasons)
    assert one.q[0] > begin[0] - 1.5  # not where the policy went


def test_a_jump_is_approached_at_half_of_the_speed():
    one, there = Bench(planar3(), FREE), FREE + np.array([0.0, 0.8, 0.0])
    for _ in range(5):
        one.send(FREE)
    for _ in range(5):
        one.send(there)
    assert 0.05 < one.q[1] - FREE[1] < 0.5 * 3.0 * 5 / 30 + 0.01
    for _ in range(60):
        one.send(there)
    assert one.q == pytest.approx(there, abs=2e-3)


class Anna(Bench):
    """The same beside a person who walks towards where the arm is going, or away."""

    def __init__(self):
        super().__init__(beside_anna(), FREE)
        self.distance, self.walks = 2.0, 0.0
        for _ in range(3):
            self.send(FREE)

    def send(self, q, gripper=0.0):
        self.distance = np.clip(self.distance + self.walks * self.guard.period, 0.8, 2.6)
        place = [self.distance * np.cos(2.2), self.distance * np.sin(2.2), -0.75]
        self.people = {"people.anna": BODY + np.array(place)}
        return super().send(q, gripper)


def test_targets_wait_with_the_gripper_and_the_path_is_kept():
    """Somebody bars the way: the robot stops, and then goes where it was told to, in order, and closes there."""
    one, reasons = Anna(), set()
    one.walks = -1.5
    for k in range(62):
        one.send(wave(k), gripper=float(k))
        reasons.add(one.guard.reason)
    assert any("anna" in reason for reason in reasons)
    assert one.sent[-1][1] < 45.0
    one.walks = 1.5
    for _ in range(120):
        one.send(wave(62), gripper=62.0)
    path = np.array([wave(k) for k in np.linspace(0.0, 62.0, 2000)])
    assert max(np.abs(path - q).max(axis=1).min() for q, _ in one.sent) < 0.01
    grips = [gripper for _, gripper in one.sent]
    assert grips == sorted(grips)
    for q, gripper in one.sent:
        assert np.abs(q - wave(gripper)).max() < 0.06  # the arm and what the gripper does belong together
    assert one.q == pytest.approx(wave(62), abs=2e-3)


def test_a_policy_that_looks_again_is_followed_at_once():
    one = Anna()
    one.walks = -1.5
    for k in range(50):
        one.send(wave(k))
    waited = len(one.guard._waiting)
    one.send(one.q)
    assert waited > 5
    assert len(one.guard._waiting) <= 1


def test_people_who_are_not_seen_keep_the_robot_where_it_is():
    one = Bench(beside_anna(), FREE)
    for k in range(20):
        one.send(wave(k))
    assert one.q == pytest.approx(FREE, abs=1e-6)


def test_a_chunk_that_is_known_is_driven_as_it_is():
    """A bend that is too sharp for what does not know it."""
    one = Bench(planar3(), FREE)
    chunk = np.array([wave(k) for k in range(60)])
    one.guard.foresee(np.degrees(np.column_stack([chunk, np.zeros(60)])))
    one.send(FREE)
    for q in chunk:
        assert one.send(q) == pytest.approx(q, abs=2e-3)
    with pytest.raises(InputError, match="chunk"):
        one.guard.foresee(np.zeros((5, 3)))


def test_a_robot_that_is_held_is_stopped():
    one, reasons = Bench(planar3(), FREE), set()
    for k in range(60):
        one.send(wave(k))
        reasons.add(one.guard.reason)
        one.q = FREE
    assert any("from where it should be" in reason for reason in reasons)
    assert np.abs(one.sent[-1][0] - FREE).max() < np.radians(2 * 6.0) + 0.05


# ------------------------------------------------------------------------------------------------------ weak servos


class Weak(Bench):
    """An arm whose servos are springs: it lags, swings beyond where it should stop, and hangs lower the farther out."""

    def __init__(self, scenario, start, stiffness=20.0, **options):
        super().__init__(scenario, start, **options)
        self.stiffness, self.qd, self.touches = stiffness, np.zeros(3), 0
        self.still = CollisionChecker(self.guard.cell.robot, scenario.scene.without(*self.guard.cell.trackers))
        self.monitor = ContactMonitor(self.guard.cell.robot)

    def send(self, q, gripper=0.0):
        before, self.told = self.q, super().send(q, gripper)
        self.q, step = before, self.guard.period / 20
        for k in range(20):
            sag = 0.03 * np.array([np.cos(self.q[0]), 0.0, 0.0])
            pull = self.stiffness**2 * (self.told - sag - self.q) - 2.0 * self.stiffness * self.qd
            self.qd = self.qd + step * pull
            self.q = self.q + step * self.qd
            moves = np.abs(self.qd).max() > 0.05
            touched = self.still.in_collision(self.q) if k % 5 == 0 else False
            solids = self.solids(self.time - self.guard.period + k * step)
            self.touches += moves and (touched or bool(solids and self.monitor.nearest(self.q, solids).distance <= 0))
        return self.told

    def solids(self, time):
        return []


@pytest.mark.parametrize(("tube", "touches"), [(None, True), (0.05, False)])
def test_weak_servos_touch_nothing_that_stands_still_from_within_their_tube(tube, touches):
    scenario = within(tube, planar3())
    one = Weak(scenario, scenario.start_configuration(scenario.build_robot()))
    begin, reasons = one.q.copy(), set()
    for k in range(60):
        one.send(begin - np.array([0.045 * k, 0.0, 0.0]))
        reasons.add(one.guard.reason)
    assert bool(one.touches) == touches
    assert any("machine" in reason for reason in reasons)


class Runner(Weak):
    """The same beside somebody who runs to the arm, as fast as people may."""

    def __init__(self, **options):
        self.angle, self.since = 2.2, np.inf
        super().__init__(within(options.pop("tube", None), beside_anna()), FREE, **options)

    def body(self, time):
        far = 2.6 - 1.6 * max(0.0, time - self.since)
        return BODY + far * np.array([np.cos(self.angle), np.sin(self.angle), 0.0]) + [0.0, 0.0, -0.75]

    def solids(self, time):
        tracker = self.guard.cell.trackers["anna"]
        return limb_solids("anna", tracker.body, tracker.body.completed(ALL_KEYPOINTS.keypoints(self.body(time)))[0])

    def send(self, q, gripper=0.0):
        self.people = {"people.anna": self.body(self.time)}
        return super().send(q, gripper)


@pytest.mark.parametrize(("servo", "touches"), [({}, True), ({"tube": 0.07, "lag": 0.2}, False)])
def test_weak_servos_have_stopped_when_somebody_is_there(servo, touches):
    touched, error, nearest = 0, 0.0, np.inf
    for since in (0.7, 0.9):
        one = Runner(**servo)
        one.since = since
        for k in range(65):
            one.send(FREE + 0.8 * np.sin(0.12 * k) * np.array([1.0, -0.5, 0.5]))
            error = max(error, one.guard.controller.errors()[0].max())
            nearest = min(nearest, one.monitor.nearest(one.q, one.solids(one.time)).distance)
        touched += one.touches
    assert nearest < 0.03  # who runs on comes to the arm, which stands
    assert bool(touched) == touches
    assert (error < 0.07) != touches


def test_a_joint_that_leaves_its_tube_is_named_and_the_robot_goes_on_once_it_stands():
    one = Bench(within(0.05, planar3()), FREE)
    for k in range(20):
        one.send(wave(k))
    one.q = one.q + np.array([0.0, 0.06, 0.0])  # somebody pushes it
    one.send(wave(20))
    assert one.guard.reason == "'joint2' is 0.060 from where it should be, and 0.05 is allowed"
    told = [one.send(wave(k)) for k in range(21, 60)]
    assert one.guard.reason == ""
    assert np.abs(np.diff(told, axis=0)).max() < 3.0 / 30 + 1e-6  # it goes back without a jump
    assert told[-1] == pytest.approx(wave(59), abs=5e-3)


def test_a_lag_is_no_error_and_no_sag():
    """What is behind by no more than the lag is where it should be; nothing of it is learnt as sag."""
    one, late = Bench(within(0.02, planar3()), FREE, lag=0.08), [FREE, FREE]
    for k in range(100):
        late.append(one.send(wave(k)))
        one.q = late[-3]  # two periods later
    assert np.abs(one.guard._sag).max() < 2e-3
    assert not any("should be" in reason for reason in [one.guard.reason])


@pytest.mark.skipif(find_spec("lerobot") is not None, reason="it is there")
def test_without_lerobot_one_line_says_so():
    with pytest.raises(ModuleNotFoundError, match=r"needs LeRobot \(.*\): pip install lerobot"):
        import safe_ompl.apps.exchange.lerobot.robot  # noqa: F401


def test_a_robot_of_lerobot_is_wrapped(tmp_path, monkeypatch):
    """LeRobot makes the robot by its name; it looks like the one that it wraps, and guards it."""
    pytest.importorskip("lerobot")
    import torch
    from lerobot.processor import PolicyProcessorPipeline
    from lerobot.robots import Robot, RobotConfig, make_robot_from_config

    from safe_ompl.apps.exchange.lerobot import SafeOmplChunks, SafeOmplRobot, SafeOmplRobotConfig

    class InnerConfig(RobotConfig):
        pass

    class Inner(Robot):
        config_class, name = InnerConfig, "inner"
        action_features = observation_features = dict.fromkeys(KEYS, float)
        is_connected, is_calibrated, time = False, True, 0.0

        def connect(self, calibrate=True):
            self.is_connected, self.at = True, {**Bench.numbers(FREE), "gripper.pos": 0.0}

        def disconnect(self):
            self.is_connected = False

        def calibrate(self): ...

        def configure(self): ...

        def clock(self):
            return self.time

        def get_observation(self):
            return dict(self.at)

        def send_action(self, action):
            self.at, self.time = dict(action), self.time + 1 / 30
            return action

    for name, kind in (("calibration_dir", tmp_path), ("id", "me")):
        monkeypatch.setattr(InnerConfig, name, kind, raising=False)
    RobotConfig.register_subclass("inner_of_a_test")(InnerConfig)
    InnerConfig.__module__ = Inner.__module__ = "inner_of_a_test"
    module = type(np)("inner_of_a_test")
    module.Inner, module.InnerConfig = Inner, InnerConfig
    monkeypatch.setitem(__import__("sys").modules, "inner_of_a_test", module)
    scenario = {"robot": {"type": "inner_of_a_test"}, "scenario": "planar3", "calibration_dir": tmp_path}
    robot = make_robot_from_config(SafeOmplRobotConfig(**scenario))
    assert isinstance(robot, SafeOmplRobot)
    assert (robot.name, robot.action_features) == ("inner", Inner.action_features)
    robot.connect()
    assert SafeOmplRobot.connected is robot
    chunk = np.column_stack([np.degrees([wave(0.2 * k) for k in range(30)]), np.full(30, 7.0)])
    step = PolicyProcessorPipeline([SafeOmplChunks()], to_transition=lambda x: {"action": x}, to_output=lambda x: x)
    assert step(torch.tensor(chunk[None]))["action"].shape == (1, 30, 4)
    assert len(robot.guard._chunk) == 30
    for row in chunk:  # whoever does not look is looked for
        sent = robot.send_action(dict(zip(KEYS, row.tolist(), strict=True)))
    assert sent == pytest.approx(dict(zip(KEYS, chunk[-1].tolist(), strict=True)), abs=0.2)
    robot.disconnect()
    assert SafeOmplRobot.connected is None
