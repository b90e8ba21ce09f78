"""People who walk about at random beside a robot, with no limb faster than it may be."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from safe_ompl.common import FloatArray, InputError, whole_number
from safe_ompl.geometry import STANDING, Pose
from safe_ompl.people import Skeleton, TrackedBody, Tracker
from safe_ompl.people.simulation.movers import Stepwise
from safe_ompl.scene import People

# A sensor that sees all key points of the body.
ALL_KEYPOINTS = Skeleton("standing", tuple(STANDING), {name: (name,) for name in STANDING})
STEP = 0.02  # [s] between two places
_NEAR, _FAR = 0.55, 1.6  # [m] from the centre
_SECTOR = 1.0  # [rad] to either side of the first place
_ARMS_LOW, _ARMS_HIGH = np.array([0.0, -0.3, 0.0]), np.array([1.7, 0.9, 1.4])  # [rad] raised, outwards, bent
_HANGING: FloatArray = np.array([[0.05, 0.0, 0.1]] * 2)
_TURN, _SWING = 2.0, 3.0  # [rad/s] of the body and of the arms, at most
_ARRIVED = 0.05  # [m]
_LONGEST = 3.0  # [s] for one place; then another one is drawn
_SMALLER = 0.7  # what is tried next where a step is too long
_TRIES = 30


@dataclass(frozen=True)
class _Stance:
    """A stance: place about the centre (distance [m], angle [rad]), direction that is faced, both arms (2, 3) [rad]."""

    place: FloatArray
    yaw: float
    arms: FloatArray

    def towards(self, other: _Stance, share: float) -> _Stance:
        return replace(
            self,
            place=self.place + share * (other.place - self.place),
            yaw=self.yaw + share * (other.yaw - self.yaw),
            arms=self.arms + share * (other.arms - self.arms),
        )


class Walker:
    """A person who walks about at random, turns, and reaches out with both arms.

    No end of a limb is ever faster than `People.speed_of` it, so that `SpeedReach` holds. The person stays in a sector
    of a ring about a centre, and walks through obstacles and the robot.

    Parameters
    ----------
    people : People
        How fast limbs may move.
    centre : ndarray, shape (3,)
        Centre of the ring, at the height of the floor [m].
    start : ndarray, shape (2,)
        Where the person stands at first [m]; the nearest place in the ring is taken.
    tracker : Tracker, optional
        How the person is tracked: size, limbs and errors; the skeleton must be `ALL_KEYPOINTS`, in the world's frame.
    speed : float
        How many times as fast as promised the person moves.
    seed : int
        Seed of the generator that draws where the person goes.

    Raises
    ------
    InputError
        If the tracker has another skeleton or place, or the seed is no whole number ≥ 0.
    """

    def __init__(
        self,
        people: People,
        centre: FloatArray,
        start: FloatArray,
        *,
        tracker: Tracker | None = None,
        speed: float = 1.0,
        seed: int = 0,
    ) -> None:
        self.tracker = Tracker(ALL_KEYPOINTS) if tracker is None else tracker
        if self.tracker.skeleton != ALL_KEYPOINTS or self.tracker.place != Pose():
            raise InputError("must have the skeleton ALL_KEYPOINTS in the world's frame", "tracker")
        self._people, self._centre, self._speed = people, centre, speed
        self._rng = np.random.default_rng(whole_number("seed", seed, at_least=0))
        self._bounds = _keypoint_speeds(self.tracker.body, people)
        away = np.asarray(start, dtype=float) - centre[:2]
        self._home = float(np.arctan2(away[1], away[0]))
        first = np.array([np.clip(np.linalg.norm(away), _NEAR, _FAR), self._home])
        self._stance = _Stance(first, self._home + np.pi, _HANGING.copy())
        self._goal, self._pace, self._left = self._stance, 1.0, 0
        self._steps = Stepwise(self._keypoints(self._stance), self._after, STEP)

    def at(self, time: float) -> FloatArray:
        """Return the key points (17, 3) at a time [s], no earlier than a second before the latest asked for."""
        return self._steps.at(self._speed * time)

    def _keypoints(self, stance: _Stance) -> FloatArray:
        """Return the key points (17, 3) of a stance, in the world [m]."""
        far, angle = stance.place
        c, s = np.cos(stance.yaw), np.sin(stance.yaw)
        turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
        at = self._centre + np.array([far * np.cos(angle), far * np.sin(angle), 0.0])
        points: FloatArray = self.tracker.body.height * _posture(stance.arms) @ turn.T + at
        return points

    def _after(self, before: FloatArray) -> FloatArray:
        """Go a step on, the longest one in which no key point is too fast, and return the key points there."""
        if self._left <= 0 or float(np.linalg.norm(self._way())) < _ARRIVED:
            self._choose()
        self._left -= 1
        wanted = self._wanted()
        share = 1.0
        for _ in range(_TRIES):
            stance = self._stance.towards(wanted, share)
            points = self._keypoints(stance)
            if (np.linalg.norm(points - before, axis=1) <= self._bounds * STEP).all():
                self._stance = stance
                return points
            share *= _SMALLER
        return before.copy()

    def _choose(self) -> None:
        """Draw the next stance, and how fast the person goes there."""
        far = self._rng.uniform(_NEAR, _FAR)
        angle = self._home + self._rng.uniform(-_SECTOR, _SECTOR)
        arms = self._rng.uniform(_ARMS_LOW, _ARMS_HIGH, (2, 3))
        yaw = angle + np.pi + self._rng.uniform(-0.8, 0.8)
        self._goal = _Stance(np.array([far, angle]), yaw, arms)
        self._pace, self._left = self._rng.uniform(0.3, 1.0), round(_LONGEST / STEP)

    def _way(self) -> FloatArray:
        """Return the rest of the way (2,), outwards and about the centre [m]."""
        way: FloatArray = (self._goal.place - self._stance.place) * [1.0, self._stance.place[0]]
        return way

    def _wanted(self) -> _Stance:
        """Return the stance a step later if no limb had a bound of its speed."""
        here, goal = self._stance, self._goal
        far = float(np.linalg.norm(self._way()))
        walked = min(1.0, self._pace * self._people.speed * STEP / max(far, 1e-9))
        turn, swing = _TURN * STEP, self._pace * _SWING * STEP
        return _Stance(
            here.place + walked * (goal.place - here.place),
            here.yaw + float(np.clip(goal.yaw - here.yaw, -turn, turn)),
            here.arms + np.clip(goal.arms - here.arms, -swing, swing),
        )


def _keypoint_speeds(body: TrackedBody, people: People) -> FloatArray:
    """Return how fast each key point (17,) may be: as the slowest of the limbs whose ends depend on it [m/s]."""
    used = (body.weights > 0).any(axis=1)  # (M, 17)
    speeds = np.array([people.speed_of(limb) for limb in body.limbs])
    found: FloatArray = np.where(used, speeds[:, None], np.inf).min(axis=0)
    return found


def _posture(arms: FloatArray) -> FloatArray:
    """Return the key points (17, 3) of a body of height 1 at the origin that faces x, with these arms (2, 3) [rad]."""
    found = {name: np.array(place) for name, place in STANDING.items()}
    for side, sign, (raised, outwards, bent) in (("left", 1.0, arms[0]), ("right", -1.0, arms[1])):
        joints = [f"{side}_{name}" for name in ("shoulder", "elbow", "wrist", "hand")]
        for k, angle in enumerate((raised, raised + bent, raised + bent)):
            length = np.linalg.norm(STANDING[joints[k + 1]] - STANDING[joints[k]])
            across, down = np.sin(angle), -np.cos(angle)
            way = np.array([across * np.cos(outwards), sign * across * np.sin(outwards), down])
            found[joints[k + 1]] = found[joints[k]] + length * way
    return np.array(list(found.values()))
