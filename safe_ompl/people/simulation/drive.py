"""What a log of ticks says in numbers: separation, speeds, stops and broken assumptions (`safe-ompl report`)."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import groupby, pairwise
from typing import Any, NamedTuple

import numpy as np

from safe_ompl.common import FloatArray, InputError, documents as document
from safe_ompl.geometry import Pose
from safe_ompl.io import built_robot, built_scene
from safe_ompl.people import TrackedBody
from safe_ompl.people.replanning import Doing
from safe_ompl.people.simulation.movers import Solid, limb_solids, part_solids
from safe_ompl.people.simulation.simulation import ContactMonitor, Nearest
from safe_ompl.robot import Robot
from safe_ompl.scene import Scene

_STILL = 1e-9  # [rad/s] slower than this is at rest
_STEP = 1e-4  # [s] of the difference that gives speeds of key points
_ROUNDING = 1e-6  # [m] by which a limb may be outside of what it was to keep to
_HALTED = (Doing.BRAKING.value, Doing.STANDING.value)
_FIGURE = re.compile(r"-?\d+(\.\d+)?(?= (mm|s)\b)")
# Upper ends of the regions that speeds are told by: distances to the nearest person or object [m].
REGIONS = (0.25, 0.5, 1.0, 2.0, np.inf)


class Halt(NamedTuple):
    """A time in which the robot braked or stood [s], and why."""

    begin: float
    end: float
    rule: str | None
    why: str


class Broken(NamedTuple):
    """A time in which somebody did not keep to what was assumed of them [s], and what was seen."""

    begin: float
    end: float
    what: str


@dataclass
class DriveReport:
    """The figures of a log; arrays hold a value for each of its T ticks."""

    times: FloatArray  # [s]
    states: list[str]  # What the robot does, see `Doing`
    distance: FloatArray  # To the nearest person or object [m]; inf: nobody was seen
    # What had to be left to them, by the formula of protective separation distances: how far the limb may come until
    # the robot stands, how far the link goes until then (from the samples of the stop), and the clearance [m]. NaN: the
    # robot stands, or nobody is there, or the log does not say what was assumed.
    protective: FloatArray
    margin: FloatArray  # Least margin along the proven motion [m]; it is not negative while the robot moves
    speed: FloatArray  # Of the fastest key point of the robot [m/s]
    halts: list[Halt] = field(default_factory=list)
    broken: list[Broken] = field(default_factory=list)
    missed: list[float] = field(default_factory=list)  # Times without an answer [s]
    reactions: FloatArray = field(default_factory=lambda: np.zeros(0))  # [s]
    assumed: str = ""  # Of people
    made_by: dict[str, str] = field(default_factory=dict)  # Versions, and hashes of robot and scene

    @classmethod
    def of(
        cls, header: Mapping[str, Any], ticks: Sequence[Mapping[str, Any]], robot: Robot | None = None
    ) -> DriveReport:
        """Return the report of a log with this header; the robot is by default what the header carries.

        Raises InputError if the log has no tick, or what it holds cannot be used.
        """
        if not ticks:
            raise InputError("holds no tick")
        scene = built_scene(document.require(header, "scene"))
        if robot is None:
            robot = built_robot(document.require(header, "robot"))
        times = np.array([document.number("time", document.require(tick, "time")) for tick in ticks])
        nearest = _nearest(header, ticks, robot, scene)
        hashes = {f"{what} (hash)": str(header[what].get("hash", "")) for what in ("robot", "scene")}
        return cls(
            times=times,
            states=[str(document.require(tick, "state")) for tick in ticks],
            distance=np.array([found.distance for found in nearest]),
            protective=np.array([_protective(header, t, n, robot) for t, n in zip(ticks, nearest, strict=True)]),
            margin=np.array([np.nan if tick.get("margin") is None else tick["margin"] for tick in ticks]),
            speed=np.array([_speed(robot, np.array(tick["q"]), np.array(tick["qd"])) for tick in ticks]),
            halts=_halts(ticks, float(header["tick"])),
            broken=_broken(header, ticks, float(header["tick"])),
            missed=[float(tick["time"]) for tick in ticks if tick.get("reaction", 0.0) is None],
            reactions=np.array([tick["reaction"] for tick in ticks if tick.get("reaction") is not None]),
            assumed=str((header.get("rules") or {}).get("assumed", "the log does not say")),
            made_by={**(header.get("made_by") or {}), **hashes},
        )

    @property
    def moving(self) -> Any:
        """Whether the robot moves (T,)."""
        return self.speed > _STILL

    @property
    def shares(self) -> dict[str, float]:
        """Share of the ticks in each state, by its name."""
        return {state: count / len(self.states) for state, count in Counter(self.states).most_common()}

    def regions(self) -> list[dict[str, float]]:
        """Return by distance to the nearest one: share of the ticks, and speeds there, 95 % of them and the largest."""
        found, least = [], -np.inf
        for most in REGIONS:
            inside = (self.distance >= least) & ((self.distance < most) | (most == np.inf))
            speeds = self.speed[inside]
            share = {"nearer_than": most, "share": len(speeds) / len(self.speed)}
            if len(speeds):
                share |= {"speed_95": float(np.quantile(speeds, 0.95)), "speed_max": float(speeds.max())}
            found.append(share)
            least = most
        return found

    def causes(self) -> list[tuple[str, int, float]]:
        """Return why the robot braked or stood, without figures: how often, and how long in all [s]."""
        found: dict[str, list[float]] = {}
        for halt in self.halts:
            why = _FIGURE.sub("…", halt.why) or "nothing was to be done"
            found.setdefault(why, []).append(halt.end - halt.begin)
        return sorted(((why, len(took), sum(took)) for why, took in found.items()), key=lambda row: -row[2])

    def as_dict(self) -> dict[str, Any]:
        """Return all of it as plain data."""
        moving, least = self.moving, {}
        if moving.any():
            least = {"distance": self.distance[moving].min(), "margin": np.nanmin([np.inf, *self.margin[moving]])}
        return {
            "seconds": float(self.times[-1] - self.times[0]),
            "ticks": len(self.times),
            "shares": self.shares,
            "least_while_moving": {name: _finite(value) for name, value in least.items()},
            "largest_speed": float(self.speed.max()),
            "regions": [{name: _finite(value) for name, value in region.items()} for region in self.regions()],
            "causes": [dict(zip(("why", "times", "seconds"), row, strict=True)) for row in self.causes()],
            "halts": [halt._asdict() for halt in self.halts],
            "assumed": self.assumed,
            "broken": [broken._asdict() for broken in self.broken],
            "deadlines_missed": self.missed,
            "reaction": None
            if not len(self.reactions)
            else {"median": float(np.median(self.reactions)), "p99": float(np.quantile(self.reactions, 0.99))},
            "made_by": self.made_by,
            "over_time": {
                name: [_finite(value) for value in getattr(self, name)]
                for name in ("times", "distance", "protective", "margin", "speed")
            },
        }


def _finite(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


def _nearest(
    header: Mapping[str, Any], ticks: Sequence[Mapping[str, Any]], robot: Robot, scene: Scene
) -> list[Nearest]:
    """Return who was nearest in each tick: as the log has it, or else measured where all were seen last."""
    bodies = {
        name: TrackedBody(float(one["height"]), tuple(one["limbs"]))
        for name, one in (header.get("people") or {}).items()
    }
    monitor, found = ContactMonitor(robot), []
    for tick in ticks:
        if tick.get("distance") is not None:
            found.append(Nearest(*(tick[name] for name in Nearest._fields)))
            continue
        solids: list[Solid] = []
        for name, points in (tick.get("people") or {}).items():
            solids += limb_solids(name, bodies[name], _keypoints(points))
        for name, place in (tick.get("objects") or {}).items():
            pose = Pose(tuple(place["position"]), tuple(place["quaternion_xyzw"]))
            solids += part_solids(name, scene[name].shape, pose.se3)
        found.append(monitor.nearest(np.array(tick["q"]), solids))
    return found


def _keypoints(points: Mapping[str, Any]) -> FloatArray:
    """Return the key points (18, 3) of a person in a tick; null in the log, what is not known, becomes NaN."""
    return np.array(list(points.values()), dtype=float)


def _growth(header: Mapping[str, Any], who: str | None, limb: str | None, time: float) -> float:
    """Return how far a limb, or an object, may come within a time [s]; NaN where the log does not say."""
    if who in (header.get("objects") or {}):
        return float(header["objects"][who]) * time
    person = (header.get("people") or {}).get(who, {})
    return float(person.get("noise", 0.0) + person.get("speeds", {}).get(limb, np.nan) * time)


def _protective(header: Mapping[str, Any], tick: Mapping[str, Any], nearest: Nearest, robot: Robot) -> float:
    """Return what the nearest link and limb of a tick must keep, see `DriveReport`."""
    if nearest.link is None or not np.abs(tick["qd"]).max() > _STILL:
        return np.nan
    of_link = [k for k, link in enumerate(robot.shared.body_links) if link == nearest.link]
    way = np.abs(np.diff(np.array(tick["stop"]["q"]), axis=0)).sum(axis=0)
    goes = float((robot.bounds.displacement_radii[of_link] @ way).max())
    until = tick["stop"]["times"][-1] - tick["measured"]
    clearance = float((header.get("rules") or {}).get("clearance", np.nan))
    return _growth(header, nearest.who, nearest.limb, until) + goes + clearance


def _speed(robot: Robot, q: FloatArray, qd: FloatArray) -> float:
    """Return how fast the fastest key point of the robot is [m/s]."""
    apart = robot.keypoints(q + _STEP * qd) - robot.keypoints(q - _STEP * qd)
    return float(np.linalg.norm(apart, axis=1).max() / (2 * _STEP))


def _halts(ticks: Sequence[Mapping[str, Any]], step: float) -> list[Halt]:
    """Return when the robot braked or stood, with the first reason of each time."""
    found = []
    for halted, rows in groupby(ticks, key=lambda tick: tick["state"] in _HALTED):
        if halted:
            of = list(rows)
            said = next((tick for tick in of if tick.get("reason")), of[0])
            found.append(Halt(of[0]["time"], of[-1]["time"] + step, said.get("rule"), str(said.get("reason") or "")))
    return found


def _broken(header: Mapping[str, Any], ticks: Sequence[Mapping[str, Any]], step: float) -> list[Broken]:
    """Return when somebody went farther between two ticks than was assumed, or the log's own truth says so."""
    limbs = [*(_went_too_far(header, *pair) for pair in pairwise(ticks)), []]
    told = zip(ticks, limbs, strict=True)
    found = []
    for kept, rows in groupby(told, key=lambda row: not row[1] and row[0].get("obeyed") is not False):
        if not kept:
            of = list(rows)
            named = dict.fromkeys(limb for _, went in of for limb in went)
            what = ", ".join(named) or "somebody, for less than a tick"
            found.append(Broken(of[0][0]["time"], of[-1][0]["time"] + step, what))
    return found


def _went_too_far(header: Mapping[str, Any], before: Mapping[str, Any], after: Mapping[str, Any]) -> list[str]:
    """Return the limbs that went farther between two ticks than they may."""
    found, since = [], after["time"] - before["time"]
    for name, person in (header.get("people") or {}).items():
        places = [(tick.get("people") or {}).get(name) for tick in (before, after)]
        if None in places or "speeds" not in person:
            continue
        body = TrackedBody(float(person["height"]), tuple(person["limbs"]))
        first, then = (body.ends(_keypoints(points)) for points in places if points is not None)
        went = np.linalg.norm(then - first, axis=-1).max(axis=1)
        for limb, far in zip(body.limbs, went.tolist(), strict=True):
            if far > _growth(header, name, limb, since) + person.get("noise", 0.0) + _ROUNDING:
                found.append(f"{name!r} ({limb})")
    return found
