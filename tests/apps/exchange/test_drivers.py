"""Drivers: what reaches a robot cycle by cycle; the libraries of the makers have stand-ins of the same interface."""

from time import monotonic, sleep

import numpy as np
import pytest

from safe_ompl import InputError, RateLimits, SafeOmplError
from safe_ompl.apps.cli.program import main
from safe_ompl.apps.exchange import open_driver
from safe_ompl.apps.exchange.drivers import FRANKA, UR

HOME = np.array([0.0, -0.5, 0.0, -1.6, 0.0, 1.6, 0.8])
STAND_IN = """
import pickle, time
from types import SimpleNamespace as Some

class JointPositions:
    def __init__(self, q):
        self.q, self.motion_finished = q, False

class Robot:
    lost = {lost}  # periods of 1 ms, by number of the cycle
    def __init__(self, host, config):
        if host == "nobody":
            raise RuntimeError("libfranka: Connection timeout")
        self.came, self.cycle = [], 0
    def start_joint_position_control(self, mode):
        return self
    def readOnce(self):
        time.sleep(0.0003)
        self.cycle += 1
        if self.cycle == {fault}:
            raise RuntimeError("motion aborted by reflex! [cartesian_reflex]")
        q = self.came[-1] if self.came else {home}
        return Some(q=[x + {error} for x in q], q_d=q), Some(to_sec=lambda: 1e-3 * self.lost.get(self.cycle, 1))
    def writeOnce(self, told):
        self.came.append(told.q)
        if told.motion_finished:
            pickle.dump(self.came, open({file!r}, "wb"))

RealtimeConfig = Some(kEnforce=0, kIgnore=1)
ControllerMode = Some(JointImpedance=0)
"""
UR_STAND_IN = """
import pickle, time
came, cycles = [], 0

class RTDEControlInterface:
    def __init__(self, host, rate):
        assert rate == 500.0
    def initPeriod(self):
        return cycles
    def waitPeriod(self, begun):
        global cycles
        time.sleep(0.002)
        cycles = begun + 1  # counted, so that no load of this machine loses one
    def servoJ(self, q, speed, acceleration, time, lookahead, gain):
        came.append(q)
        return len(q) == 6 and (speed, acceleration, time, lookahead, gain) == (0.0, 0.0, 0.002, 0.03, 500.0)
    def servoStop(self):
        pickle.dump(came, open({file!r}, "wb"))
    def stopScript(self):
        assert came

class RTDEReceiveInterface:
    def __init__(self, host, rate):
        pass
    def getActualQ(self):
        return came[-1] if came else [0.1] * 6
    def getTimestamp(self):
        return 0.002 * cycles
"""


def rows_to(start, change, seconds=1.0, rate=1000.0):
    """Return rows (K, n), one a cycle, of a motion at rest at both ends."""
    u = np.linspace(0.0, 1.0, round(seconds * rate) + 1)[:, None]
    return start + u**3 * (10 - 15 * u + 6 * u * u) * change


@pytest.fixture
def stand_in(tmp_path, monkeypatch):
    """Put a stand-in of `pylibfranka` first on the path; return the file of what came to the robot."""

    def make(lost=None, fault=0, error=0.0):
        file = str(tmp_path / "came.pickle")
        values = {"lost": lost or {}, "fault": fault, "error": error, "home": HOME.tolist(), "file": file}
        text = STAND_IN
        for key, value in values.items():
            text = text.replace("{" + key + ("!r}" if key == "file" else "}"), repr(value))
        (tmp_path / "pylibfranka.py").write_text(text)
        monkeypatch.syspath_prepend(str(tmp_path))
        return file

    return make


def test_what_is_beyond_the_limits_of_the_maker_is_not_driven():
    driver, first = open_driver("franka://dry", HOME), np.eye(7)[0]
    pushes = np.repeat([0.0, 6.0, -6.0], 10)[:, None]  # [rad/s²], which jump
    for rows, what in (
        (rows_to(HOME, 2.0 * first), "velocity 3.75 of joint 1; 2.175 is allowed"),
        (rows_to(HOME, 0.5 * first, 0.5), "acceleration -11.55 of joint 1; 10 is allowed"),
        (HOME + 1e-6 * np.cumsum(np.cumsum(pushes, axis=0), axis=0) * first, "jerk -1.2e+04 of joint 1; 5000"),
    ):
        assert what in driver.follow(0.0, rows)
    assert driver.follow(0.0, rows_to(HOME, 0.5 * first)) == ""


def test_joints_near_their_ends_must_be_slow():
    own = RateLimits(tuple("abcdefg"), np.full(7, 2.0), np.full(7, 5.0))
    fourth = np.eye(7)[3]
    far, near = HOME + 0.5 * fourth, HOME + 1.35 * fourth
    assert FRANKA.within(own, np.array([HOME, far])).velocity[3] == 2.0
    slow = FRANKA.within(own, np.array([HOME, near]))
    assert slow.velocity[3] == pytest.approx(0.999 * (np.sqrt(8.0 * (1.6 - 1.35 - 0.1458)) - 0.3))
    assert slow.jerk is not None
    assert UR.within(RateLimits(tuple("abcdef"), np.full(6, 3.0), np.full(6, 5.0)), np.zeros((2, 6))).jerk is None
    rows = rows_to(near - 0.8 * fourth, 0.8 * fourth, seconds=1.0)
    assert FRANKA.breach(rows).startswith("velocity")
    assert not FRANKA.breach(rows[::-1])  # away from the end it may be fast
    with pytest.raises(InputError, match=r"d: goes from -1\.600 to -0\.100"):
        FRANKA.within(own, np.array([HOME, HOME + 1.5 * fourth]))


def test_new_rows_join_the_old_ones_or_are_refused():
    driver = open_driver("franka://dry", HOME)
    way = rows_to(HOME, 0.5 * np.eye(7)[0])
    assert driver.follow(0.0, way) == ""
    q = driver.wait(0.3)
    np.testing.assert_array_equal(q, way[300])
    assert "cycles too late" in driver.follow(0.25, way[250:])
    assert "velocity" in driver.follow(0.32, way[400:])  # a jump
    slower = rows_to(HOME, 0.5 * np.eye(7)[0], seconds=1.0)[320:]
    assert driver.follow(0.32, slower) == ""
    log = driver.close()
    assert (np.diff(log.times) > 0).all()
    np.testing.assert_array_equal(log.commanded[:1001], way)
    assert not FRANKA.breach(log.commanded)


def test_a_robot_is_told_every_row_and_ends_at_rest(stand_in):
    file = stand_in(error=0.001)
    driver = open_driver("franka://127.0.0.1", np.zeros(7))
    np.testing.assert_array_equal(driver.start, HOME)
    sleep(0.05)  # it holds
    way = rows_to(HOME, np.linspace(-0.5, 0.5, 7))
    assert driver.follow(0.0, way) == ""
    np.testing.assert_allclose(driver.wait(0.2), HOME + 0.001, atol=0.2)
    assert "too late" in driver.follow(0.1, way[100:])
    driver._pipe.send(())  # an answer that Ctrl-C leaves there
    driver._open = True
    log = driver.close()
    np.testing.assert_array_equal(log.commanded[:1001], way)
    np.testing.assert_allclose(log.measured - log.commanded, 0.001, atol=1e-12)
    came = np.array(np.load(file, allow_pickle=True))
    assert not FRANKA.breach(came)
    np.testing.assert_array_equal(came[-1], way[-1])
    first = next(k for k, q in enumerate(came) if (q != HOME).any())
    np.testing.assert_array_equal(came[first : first + 1000], way[1:])


@pytest.mark.parametrize("robot", ["franka://dry", "franka://127.0.0.1"])
def test_a_robot_stops_on_its_path(stand_in, robot):
    stand_in()
    driver = open_driver(robot, HOME)
    way = rows_to(HOME, 0.8 * np.ones(7), seconds=2.0)
    assert driver.follow(0.0, way) == ""
    driver.wait(0.8)
    driver.halt(lambda t: HOME + 0.8 * ((t / 2) ** 3 * (10 - 15 * (t / 2) + 6 * (t / 2) ** 2))[:, None])
    told = driver.close().commanded
    assert not FRANKA.breach(told)
    np.testing.assert_allclose(
        told - told[:, :1], (HOME - HOME[0]) * np.ones_like(told), atol=1e-9
    )  # still on the line
    assert 0.3 < told[-1, 0] - HOME[0] < 0.7


def test_lost_cycles_do_not_make_the_robot_late(stand_in):
    stand_in(lost=dict.fromkeys(range(100, 1000, 50), 2))
    driver = open_driver("franka://127.0.0.1", np.zeros(7))
    way = rows_to(HOME, 0.3 * np.ones(7))
    assert driver.follow(0.0, way) == ""
    log = driver.close()
    cycles = np.round(1e3 * log.times).astype(int)
    assert (np.diff(cycles) == 2).any()
    np.testing.assert_array_equal(log.commanded, way[np.minimum(cycles, 1000)])


def test_a_fault_of_the_robot_is_said_and_its_log_kept(stand_in):
    stand_in(fault=400)
    driver = open_driver("franka://127.0.0.1", np.zeros(7))
    assert driver.follow(0.0, rows_to(HOME, 0.3 * np.ones(7), seconds=5.0)) == ""
    with pytest.raises(SafeOmplError, match=r"franka://127\.0\.0\.1: motion aborted by reflex"):
        driver.wait(5.0)
    assert 0 < len(driver.close().times) < 400


def test_who_does_not_answer_is_named_in_one_line(stand_in):
    stand_in()
    with pytest.raises(SafeOmplError, match="franka://nobody: libfranka: Connection timeout"):
        open_driver("franka://nobody", np.zeros(7))


def test_a_robot_comes_to_rest_if_the_program_is_gone(stand_in, tmp_path):
    file = stand_in()
    driver = open_driver("franka://127.0.0.1", np.zeros(7))
    way = rows_to(HOME, 0.3 * np.ones(7))
    assert driver.follow(0.0, way) == ""
    driver.wait(0.1)
    driver._pipe.close()  # as where the program breaks
    begin = monotonic()
    while not (tmp_path / "came.pickle").exists() and monotonic() < begin + 10:
        sleep(0.05)
    sleep(0.1)
    np.testing.assert_array_equal(np.load(file, allow_pickle=True)[-1], way[-1])


def test_universal_robots_by_a_stand_in(tmp_path, monkeypatch):
    file = str(tmp_path / "came.pickle")
    for name in ("rtde_control", "rtde_receive"):
        (tmp_path / f"{name}.py").write_text("from both import *\n")
    (tmp_path / "both.py").write_text(UR_STAND_IN.replace("{file!r}", repr(file)))
    monkeypatch.syspath_prepend(str(tmp_path))
    driver = open_driver("ur://192.168.0.10", np.zeros(6))
    way = rows_to(np.full(6, 0.1), 0.4, rate=500.0)
    assert driver.follow(0.0, way) == ""
    log = driver.close()
    cycles = np.round(500 * log.times).astype(int)
    np.testing.assert_array_equal(log.commanded, way[np.minimum(cycles, 500)])
    assert not UR.breach(np.array(np.load(file, allow_pickle=True)))


@pytest.mark.parametrize(
    ("robot", "what"),
    [
        ("franka://", "known: franka://HOST, franka://dry, ur://HOST, ur://dry"),
        ("kuka://dry", "unknown robot 'kuka://dry'"),
        ("ur://dry", "ur://dry: has 6 joints, the scenario's robot 7"),
    ],
)
def test_a_robot_that_cannot_be_is_refused(robot, what):
    with pytest.raises(InputError) as error:
        open_driver(robot, HOME)
    assert what in str(error.value)


def test_drive_measures_the_tube_and_proves_the_motion_again(stand_in, tmp_path, capsys):
    log = tmp_path / "log.csv"
    assert main(["drive", "panda_shelf", "--robot", "franka://dry", "--log", str(log)]) == 0
    said = capsys.readouterr().out
    assert " 0 lost" in said
    assert "proven within a tube" in said or "proven: joint limits" in said
    assert main(["tube", str(log)]) == 0
    assert "panda_joint7=0" in capsys.readouterr().out
