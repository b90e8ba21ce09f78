"""Drivers of robots: where the joints are to be, cycle by cycle, at the robot's own rate.

What a robot is told are rows of joint values, one a cycle; the last one is held. New rows take the place of the old
ones from a cycle on. They are taken only if that cycle is still to come, and if all that is sent keeps to the limits
that the maker publishes: velocities, accelerations and jerks, by differences, from the rows before to rest after the
last one. If not, the robot does what it was told before, to the end.

* ``franka://HOST``: Franka Research 3 by Franka's own library, `pylibfranka`, at 1 kHz;
* ``ur://HOST``: Universal Robots by `ur_rtde`, at 500 Hz;
* ``franka://dry``, ``ur://dry``: no robot, but its rate and limits.

The loop that talks to a robot has a process of its own: no planning delays it, and if the program ends or breaks the
robot comes to rest as it was told.
"""

from __future__ import annotations

import atexit
import gc
import logging
import multiprocessing
import os
import signal
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from multiprocessing.connection import Connection
from pathlib import Path
from time import sleep
from typing import Any, NamedTuple

import numpy as np

from safe_ompl.common import FloatArray, InputError, SafeOmplError, UnknownNameError
from safe_ompl.trajectories import RateLimits

_log = logging.getLogger(__name__)

DRY = "dry"
_ROUNDING = 1 + 1e-6  # relative: what differences of positions may be above a limit
_KEPT = 0.999  # share of the published limits that motions use: the robot rounds, too
_JERK = 0.1  # share of the published jerk that is used if nothing is said: more shakes the robot
_STILL = 3  # cycles at rest after which differences show no jerk any more
_LONGEST = 300.0  # [s] of what a robot is told at once
_REALTIME = Path("/sys/kernel/realtime")  # of realtime kernels alone; libfranka looks for it, too
_AHEAD, _SPANS = 50, (0.2, 0.4, 0.8, 1.6, 3.2)  # cycles until a stop begins, and how long it takes [s]
_PRIORITY = 50  # of 1 to 99
_NAP = 0.05  # [s] at most between two looks at the robot's clock
_LOOKAHEAD, _GAIN = 0.03, 500.0  # of UR's servoJ: the least delay that it allows [s]; of 100 to 2000


@dataclass(frozen=True)
class RobotRates:
    """What a maker publishes of a robot with n joints.

    `rate` [Hz] of its cycles; the largest `velocity`, `acceleration` and `jerk`, each (n,) [rad/s, …], inf where none
    is published. `ends` (n, 4), where joints must be slower near their ends: the lower and the upper end q_e [rad], and
    o and d of |q̇| ≤ √(2d|q_e − q|) − o towards it.
    """

    rate: float
    velocity: FloatArray
    acceleration: FloatArray
    jerk: FloatArray
    ends: FloatArray | None = None

    def velocities(self, q: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return how fast joints at q (K, n) may move down and up [rad/s]; negative beyond their ends."""
        if self.ends is None:
            return self.velocity, self.velocity
        lower, upper, offset, braking = self.ends.T
        down, up = (np.sqrt(2 * braking * np.maximum(room, 0.0)) - offset for room in (q - lower, upper - q))
        return np.minimum(self.velocity, down), np.minimum(self.velocity, up)

    def breach(self, rows: FloatArray) -> str:
        """Return what is beyond the limits in rows (K, n), one a cycle; empty if nothing is."""
        both = self.velocities(rows[1:]), (self.acceleration,) * 2, (self.jerk,) * 2
        values = rows
        for kind, (down, up) in zip(("velocity", "acceleration", "jerk"), both, strict=True):
            values = np.diff(values, axis=0) * self.rate
            limits = np.where(values < 0, down, up)
            over = np.abs(values) - np.maximum(limits, 1e-6) * _ROUNDING
            if over.max(initial=0.0) > 0:
                k, joint = np.unravel_index(int(over.argmax()), over.shape)
                return f"{kind} {values[k, joint]:.4g} of joint {joint + 1}; {limits[k, joint]:.4g} is allowed there"
        return ""

    def within(self, own: RateLimits, way: FloatArray) -> RateLimits:
        """Return those limits that keep to both these and a robot's `own` on a way through points (K, n), and back."""
        slowest = np.broadcast_to(np.minimum(*self.velocities(way)), way.shape).min(axis=0)
        for name, speed, values in zip(own.joint_names, slowest.tolist(), way.T, strict=True):
            if speed <= 0:
                raise InputError(f"goes from {values.min():.3f} to {values.max():.3f}: too near to its end", name)
        velocity, acceleration, most = _KEPT * slowest, _KEPT * self.acceleration, _KEPT * self.jerk
        jerk = np.minimum(_JERK * self.jerk if own.jerk is None else own.jerk, most)
        return RateLimits(
            own.joint_names,
            np.minimum(own.velocity, velocity),
            np.minimum(own.acceleration, acceleration),
            jerk if np.isfinite(jerk).all() else None,
        )


_FR3_ENDS = [
    [-2.7501, -1.7918, -2.9065, -3.0481, -2.8101, 0.54092, -3.0196],
    [2.7501, 1.7918, 2.9065, -0.1458, 2.8101, 4.5205, 3.0196],
    [0.30, 0.20, 0.20, 0.30, 0.35, 0.35, 0.35],
    [6.0, 2.585, 3.5, 4.0, 17.0, 5.5, 17.0],
]
# The lower ones of Franka's two tables, Panda's and that of Research 3.
FRANKA = RobotRates(
    1000.0,
    np.array([2.175, 2.175, 2.175, 2.175, 2.61, 2.61, 2.61]),
    np.array([10.0, 7.5, 10.0, 10.0, 10.0, 10.0, 10.0]),
    np.array([5000.0, 3750.0, 5000.0, 5000.0, 5000.0, 5000.0, 5000.0]),
    np.transpose(_FR3_ENDS),
)
# The slowest joints of the e-Series and of UR20 and UR30 turn 120°/s; accelerations and jerks are not published.
UR = RobotRates(500.0, np.full(6, 2.094), np.full(6, np.inf), np.full(6, np.inf))
_ROBOTS = {"franka": FRANKA, "ur": UR}


class DriveLog(NamedTuple):
    """What K cycles were that came: their times [s], where the joints (K, n) were told to be, and where they were."""

    times: FloatArray
    commanded: FloatArray
    measured: FloatArray


class Driver:
    """A robot that is driven; times count from the first cycle that it is told where to be.

    This one is no robot. Its joints are where they are told to be, from `start` (n,) on, and time goes by as fast as
    somebody waits for it.
    """

    def __init__(self, rates: RobotRates, start: FloatArray) -> None:
        self.rates, self.start = rates, start
        self._rows, self._first = start[None], 0  # what it was told, and the cycle of the first row
        self._cycle = -1  # the newest that is known
        self._log: list[DriveLog] = []

    def follow(self, time: float, rows: FloatArray) -> str:
        """Tell the joints where to be (K, n) from a time on [s], one row a cycle; return why not, empty if they do."""
        first = int(np.ceil(time * self.rates.rate - 1e-6))  # the first cycle that is not before
        begin = min(self._cycle, first) - _STILL
        joined = np.concatenate([self._told(begin, first), rows])
        why = self.rates.breach(np.concatenate([joined, *[rows[-1:]] * _STILL])) or self._take(begin, first, joined)
        if not why:
            self._rows, self._first = joined, begin
        return why

    def wait(self, time: float) -> FloatArray:
        """Return where the joints (n,) are once it is so late [s]; a SafeOmplError if the robot has a fault."""
        cycles = np.arange(self._cycle + 1, round(time * self.rates.rate) + 1)
        told = self._told(self._cycle + 1, self._cycle + 1 + len(cycles))
        self._log.append(DriveLog(cycles / self.rates.rate, told, told))
        self._cycle += len(cycles)
        return np.asarray(self._told(self._cycle, self._cycle + 1)[0])

    def halt(self, motion: Callable[[FloatArray], FloatArray]) -> None:
        """Stop on the path of a motion, positions (K, n) at times (K,) [s], as soon as the maker's limits allow."""
        self.wait(0.0)
        begin = (self._cycle + _AHEAD) / self.rates.rate
        for span in _SPANS:
            u = np.arange(0.0, 1.0, 1 / (span * self.rates.rate))
            slower = span * (u - u**4 * (2.5 - 3 * u + u * u))  # its rate goes from 1 to 0, smoothly
            if not self.follow(begin, motion(begin + np.append(slower, span / 2))):
                break

    def close(self) -> DriveLog:
        """Let the robot come to rest as it was told, leave it, and return what it did."""
        self.wait((self._first + len(self._rows)) / self.rates.rate)
        return DriveLog(*map(np.concatenate, zip(*self._log, strict=True)))

    def _told(self, first: int, last: int) -> FloatArray:
        """Return the rows of some cycles; the first and the last one are held before and after."""
        return self._rows[np.clip(np.arange(first, last) - self._first, 0, len(self._rows) - 1)]

    def _take(self, begin: int, first: int, rows: FloatArray) -> str:
        """Take rows of the cycles from one on, which are new from another one on; return why they are not taken."""
        return _late(first, self._cycle)


def _late(first: int, cycle: int) -> str:
    """Return whether rows come too late from a first cycle on: what is to be after the newest one is said."""
    return f"{cycle + 2 - first} cycles too late" if 0 <= cycle > first - 2 else ""


# ------------------------------------------------------------------------------------------- robots that are there


class _Franka:
    """Cycles of a Franka robot: a state comes, and is answered by positions."""

    def __init__(self, host: str) -> None:
        import pylibfranka as franka  # needs the extra

        self._franka, config = franka, franka.RealtimeConfig
        self._robot = franka.Robot(host, config.kEnforce if _REALTIME.exists() else config.kIgnore)
        self._control = self._robot.start_joint_position_control(franka.ControllerMode.JointImpedance)
        self.start = np.array(self._control.readOnce()[0].q_d)
        self.write(self.start)

    def read(self) -> tuple[FloatArray, int]:
        """Wait for the next cycle; return the joints, and how many cycles that was."""
        state, period = self._control.readOnce()
        return np.array(state.q), max(1, round(period.to_sec() * FRANKA.rate))

    def write(self, q: FloatArray, *, last: bool = False) -> None:
        """Say where to be at the next cycle."""
        self._told = self._franka.JointPositions(q.tolist())
        self._told.motion_finished = last
        self._control.writeOnce(self._told)

    def close(self) -> None:
        """End the motion, at rest."""
        self._control.readOnce()
        self.write(np.array(self._told.q), last=True)


class _Ur:
    """The same of a robot of Universal Robots; its servo smooths what it is told, and lags by that."""

    def __init__(self, host: str) -> None:
        from rtde_control import RTDEControlInterface  # need the extra
        from rtde_receive import RTDEReceiveInterface

        self._control, self._receive = RTDEControlInterface(host, UR.rate), RTDEReceiveInterface(host, UR.rate)
        self.start = np.array(self._receive.getActualQ())
        self._stamp, self._begun = self._receive.getTimestamp(), self._control.initPeriod()

    def read(self) -> tuple[FloatArray, int]:
        self._control.waitPeriod(self._begun)
        self._begun, before = self._control.initPeriod(), self._stamp
        self._stamp = self._receive.getTimestamp()
        return np.array(self._receive.getActualQ()), max(1, round((self._stamp - before) * UR.rate))

    def write(self, q: FloatArray) -> None:
        if not self._control.servoJ(q.tolist(), 0.0, 0.0, 1 / UR.rate, _LOOKAHEAD, _GAIN):
            raise RuntimeError("servoJ is refused: is the robot in remote control, and not in a protective stop?")

    def close(self) -> None:
        self._control.servoStop()
        self._control.stopScript()


_LINKS: dict[str, Callable[[str], Any]] = {"franka": _Franka, "ur": _Ur}


def _serve(pipe: Connection, kind: str, host: str, memory: Any) -> None:
    """Talk to a robot, and do what the other end of the pipe asks."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the parent
    with suppress(AttributeError, PermissionError):  # before all else on this machine, if that may be
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(_PRIORITY))
    fault, log = "", list[tuple[int, FloatArray, FloatArray]]()
    try:
        link = _LINKS[kind](host)
        pipe.send(link.start)
        gc.disable()
        _go_on(link, pipe, np.frombuffer(memory).reshape(2, -1, len(link.start)), log)
        link.close()
    except Exception as error:
        fault = " ".join(str(error).split()) or type(error).__name__
    with suppress(OSError):
        cycles, told, found = (np.array([each[k] for each in log]) for k in range(3))
        pipe.send((fault, DriveLog(cycles / _ROBOTS[kind].rate, told, found)))


def _go_on(link: Any, pipe: Connection, slots: FloatArray, log: list[tuple[int, FloatArray, FloatArray]]) -> None:
    """Go on from cycle to cycle until the other end of the pipe asks for an end, or is gone, and the robot rests."""
    rows, begin, cycle, driven, ending = link.start[None], 0, -1, False, False
    while not (ending and (not driven or cycle >= begin + len(rows) + _STILL)):
        q, passed = link.read()
        if driven:
            cycle += passed
            log.append((cycle, rows[min(cycle - begin, len(rows) - 1)].copy(), q))
        link.write(rows[min(cycle + 1 - begin, len(rows) - 1)])
        if ending or not pipe.poll():
            continue
        asked = None
        with suppress(EOFError):
            asked = pipe.recv()
        ending = asked is None
        if asked == ():
            pipe.send((cycle, q))
        elif asked is not None:
            slot, since, first, count = asked
            late = _late(first, cycle)
            if not late:
                rows, begin, driven = slots[slot, :count], since, True
            pipe.send(late)


class RobotDriver(Driver):
    """A robot that another process talks to; rows reach that through memory which both share."""

    def __init__(self, kind: str, host: str) -> None:
        self._name, rates, spawned = f"{kind}://{host}", _ROBOTS[kind], multiprocessing.get_context("spawn")
        n = len(rates.velocity)
        memory = spawned.RawArray("d", 2 * n * round(_LONGEST * rates.rate))
        self._slots, self._slot = np.frombuffer(memory).reshape(2, -1, n), 0
        self._pipe, other = spawned.Pipe()
        self._open = False  # whether a question was asked, and not answered
        atexit.register(self._pipe.close)  # before all processes are waited for
        spawned.Process(target=_serve, args=(other, kind, host, memory), name=self._name).start()
        other.close()
        super().__init__(rates, self._received())

    def wait(self, time: float) -> FloatArray:
        self._cycle, q = self._asked(())
        while (left := time - self._cycle / self.rates.rate) > 0:
            sleep(min(left, _NAP))
            self._cycle, q = self._asked(())
        return np.asarray(q)

    def close(self) -> DriveLog:
        if not self._log:
            self._asked(None)
        return self._log[0]

    def _take(self, begin: int, first: int, rows: FloatArray) -> str:
        if len(rows) > self._slots.shape[1]:
            return f"longer than {_LONGEST:g} s"
        slot = 1 - self._slot  # that is not read now
        self._slots[slot, : len(rows)] = rows
        late = str(self._asked((slot, begin, first, len(rows))))
        self._slot = self._slot if late else slot
        return late

    def _asked(self, question: Any) -> Any:
        if self._open and self._pipe.poll(1.0):  # Ctrl-C has left an answer
            self._received()
        self._open = True
        with suppress(OSError):  # the process may have ended: why, it has said
            self._pipe.send(question)
        found = self._received()
        self._open = False
        return found

    def _received(self) -> Any:
        try:
            found = self._pipe.recv()
        except (EOFError, OSError):
            raise SafeOmplError(f"{self._name}: the process that talks to the robot is gone") from None
        if isinstance(found, tuple) and isinstance(found[0], str):
            fault, log = found
            self._log = [log]
            if fault:
                raise SafeOmplError(f"{self._name}: {fault}")
        return found


def open_driver(robot: str, start: FloatArray) -> Driver:
    """Return the driver of a robot, such as ``franka://172.16.0.2``; the joints of a dry one stand at `start` (n,).

    An InputError if there is no such driver, or the robot has another number of joints; a SafeOmplError if it does not
    answer.
    """
    kind, _, host = robot.partition("://")
    if kind not in _ROBOTS or not host:
        raise UnknownNameError("robot", robot, [f"{one}://{where}" for one in _ROBOTS for where in ("HOST", DRY)])
    rates = _ROBOTS[kind]
    if len(start) != len(rates.velocity):
        raise InputError(f"has {len(rates.velocity)} joints, the scenario's robot {len(start)}", robot)
    if host == DRY:
        return Driver(rates, start)
    if kind == "franka" and not _REALTIME.exists():
        _log.warning("no realtime kernel: cycles may be lost, and the robot stops if many are")
    return RobotDriver(kind, host)
