"""Time laws: where on its curve a trajectory is at what time, with or without a limit of the jerk.

With a limit of the jerk the speed is made of ramps of constant jerk, one above the other, below all caps.
On a straight line in joint space q̈ = q′s̈ and the jerk is q′s⃛, with q′ constant: limits of the joints are limits V, A
and J of ṡ, s̈ and s⃛. A ramp leads from one speed to another, at rest in s̈ at both ends: jerk J, none, −J, or without
the middle where A is not reached. It takes, and covers, with Δ the difference of the speeds,

    T = 2√(Δ/J)  or  Δ/A + A/J,        d = T (v₀ + v₁)/2.

From rest to rest the robot goes up by a ramp, on at constant speed, and down; where it goes on at constant speed, and
caps allow more, it goes up and down again, on top. The place where a ramp reaches a speed has a closed form: so it is
known which cells it leaves before it is faster than their caps.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from safe_ompl.common import FloatArray, IntArray
from safe_ompl.trajectories.curve import Cells
from safe_ompl.trajectories.kernels import fastest
from safe_ompl.trajectories.limits import RateLimits

_HALVINGS = 40
_GAIN = 1.05  # ramps that gain less speed than this, relative, are left out


@dataclass(frozen=True)
class TimeLaw:
    """Arc length by time: constant s̈ in every cell of a curve.

    Attributes
    ----------
    edges : ndarray, shape (N + 1,)
        Arc lengths of the grid points.
    squares : ndarray, shape (N + 1,)
        x = ṡ² there [rad²/s²].
    times : ndarray, shape (N + 1,)
        When they are passed [s].
    """

    edges: FloatArray
    squares: FloatArray
    times: FloatArray

    @classmethod
    def through(cls, edges: FloatArray, squares: FloatArray) -> TimeLaw:
        """Return the law with these ṡ² at the grid points; a cell takes 2h/(ṡ_start + ṡ_end)."""
        speeds = np.sqrt(squares)
        sizes, both = np.diff(edges), speeds[:-1] + speeds[1:]
        steps = np.divide(2 * sizes, both, out=np.zeros(len(sizes)), where=sizes > 0)
        return cls(edges, squares, np.concatenate([[0.0], np.cumsum(steps)]))

    @property
    def duration(self) -> float:
        """How long it takes [s]."""
        return float(self.times[-1])

    def squares_at(self, s: FloatArray) -> FloatArray:
        """Return ṡ² (S,) at arc lengths `s: (S,)` of the curve."""
        squares: FloatArray = np.interp(s, self.edges, self.squares)
        return squares

    def at(self, t: FloatArray) -> tuple[IntArray, FloatArray, FloatArray, FloatArray]:
        """Return cell, s, ṡ and s̈ (T,) at times `t: (T,)` [s]; at rest before the start and after the end."""
        cell: IntArray = np.clip(np.searchsorted(self.times, t, side="right") - 1, 0, len(self.edges) - 2)
        sizes = np.diff(self.edges)
        pushes = np.divide(np.diff(self.squares), 2 * sizes, out=np.zeros(len(sizes)), where=sizes > 0)
        speeds = np.sqrt(self.squares)
        since = np.clip(t, 0.0, self.duration) - self.times[cell]
        rate = speeds[cell] + pushes[cell] * since
        s = self.edges[cell] + since * (speeds[cell] + rate) / 2
        outside = (t < 0) | (t > self.duration)
        return (
            cell,
            np.clip(s, self.edges[cell], self.edges[cell + 1]),
            np.where(outside, 0.0, np.maximum(rate, 0.0)),
            np.where(outside, 0.0, pushes[cell]),
        )


def velocity_cap(cells: Cells, limits: RateLimits) -> FloatArray:
    """Return the largest ṡ (N,) of each cell that keeps the joints' velocities: min_i limit_i/max|q′_i|."""
    slopes = cells.slopes
    with np.errstate(divide="ignore"):
        cap: FloatArray = np.where(slopes > 0, limits.velocity / slopes, np.inf).min(axis=1)
    return cap


def fastest_law(cells: Cells, limits: RateLimits, cap: FloatArray, speed: float = 0.0) -> FloatArray:
    """Return ṡ² (N+1,) of the fastest law within joint limits and a cap of ṡ.

    Parameters
    ----------
    cells : Cells
        The curve.
    limits : RateLimits
        Of the joints.
    cap : ndarray, shape (N,)
        Largest ṡ in each cell.
    speed : float
        ṡ where it begins. If nothing in time slows it down from there, it begins with the largest ṡ that is possible.
    """
    within = np.minimum(cap, velocity_cap(cells, limits)) ** 2
    most = np.minimum(np.append(within, 0.0), np.concatenate([[0.0], within]))
    most[0] = min(within[0], speed * speed)
    most[cells.stops] = 0.0
    found: FloatArray = fastest(
        cells.sizes,
        cells.slope_low,
        cells.slope_high,
        cells.bend_low,
        cells.bend_high,
        limits.acceleration,
        most,
    )
    return found


# ------------------------------------------------------------------------------------------ with a limit of the jerk


class Part(NamedTuple):
    """A time of constant s⃛: how long [s], s⃛ [rad/s³], and ṡ [rad/s] at its end where s̈ vanishes there; else None."""

    duration: float
    jerk: float
    end: float | None = None


class Ramp(NamedTuple):
    """A change of the speed ṡ from `low` ≥ 0 up to `high`, at rest in s̈ at both ends.

    Attributes
    ----------
    low, high : float
        [rad/s]
    acceleration, jerk : float
        Largest s̈ and s⃛ [rad/s², rad/s³], > 0.
    """

    low: float
    high: float
    acceleration: float
    jerk: float

    @property
    def bend(self) -> float:
        """How long the jerk lasts, at either end [s]."""
        gain = self.high - self.low
        return float(min(np.sqrt(gain / self.jerk), self.acceleration / self.jerk))

    @property
    def straight(self) -> float:
        """How long s̈ is constant between [s]."""
        return max(0.0, (self.high - self.low) / self.acceleration - self.acceleration / self.jerk)

    @property
    def distance(self) -> float:
        """What it covers [rad]."""
        return (self.low + self.high) / 2 * (2 * self.bend + self.straight)

    def reach(self, speeds: FloatArray) -> FloatArray:
        """Return how far from its start it reaches speeds `low` ≤ (S,) ≤ `high` [rad]."""
        gain, whole, bend = speeds - self.low, self.high - self.low, self.bend
        top = self.jerk * bend
        bent = top * bend / 2  # gained while the jerk lasts
        early = np.sqrt(2 * np.clip(gain, 0.0, bent) / self.jerk)
        late = np.sqrt(2 * np.clip(whole - gain, 0.0, bent) / self.jerk)
        between = np.clip((gain - bent) / top, 0.0, self.straight) if top > 0 else np.zeros(len(speeds))
        first = self.low * early + self.jerk * early**3 / 6
        middle = (self.low + bent) * between + top * between**2 / 2
        last = self.high * late - self.jerk * late**3 / 6
        found: FloatArray = np.where(gain <= whole - bent, first + middle, self.distance - last)
        return found

    def parts(self, up: bool) -> list[Part]:
        """Return its phases: up, or down the same way."""
        sign, end = (self.jerk, self.high) if up else (-self.jerk, self.low)
        return [Part(self.bend, sign), Part(self.straight, 0.0), Part(self.bend, -sign, end)]


@dataclass(frozen=True)
class JerkLaw(TimeLaw):
    """Arc length by time: constant s⃛ in every phase. ṡ rises, falls or stays in each of its cells.

    Attributes
    ----------
    starts : ndarray, shape (P + 1,)
        When the phases begin, and the end [s].
    phases : ndarray, shape (P, 4)
        s, ṡ, s̈ and s⃛ there.
    """

    starts: FloatArray
    phases: FloatArray

    @classmethod
    def of(cls, edges: FloatArray, starts: FloatArray, phases: FloatArray) -> JerkLaw:
        """Return the law of phases, on the grid points `edges` and where phases begin."""
        edges = np.unique(np.concatenate([edges, phases[:, 0]]))
        law = cls(edges, np.zeros(0), np.zeros(0), starts, phases)
        times, squares = law._passed(edges)
        return cls(edges, squares, times, starts, phases)

    def squares_at(self, s: FloatArray) -> FloatArray:
        """Return ṡ² (S,) at arc lengths; as `TimeLaw`."""
        return self._passed(s)[1]

    def at(self, t: FloatArray) -> tuple[IntArray, FloatArray, FloatArray, FloatArray]:
        """Return cell, s, ṡ and s̈ (T,) at times `t: (T,)` [s]; at rest before the start and after the end."""
        phase = self._phase(t)
        since = np.clip(t, 0.0, self.duration) - self.starts[phase]
        s, rate, push = _after(self.phases[phase], since)
        begins = self.phases[:, 0]
        ends = np.append(begins[1:], self.edges[-1])
        first = np.searchsorted(self.edges, begins)
        last = np.maximum(np.searchsorted(self.edges, ends) - 1, first)
        cell = np.clip(np.searchsorted(self.edges, s, side="right") - 1, first[phase], last[phase])
        outside = (t < 0) | (t > self.duration)
        return (
            cell,
            np.clip(s, self.edges[cell], self.edges[cell + 1]),
            np.where(outside, 0.0, np.maximum(rate, 0.0)),
            np.where(outside, 0.0, push),
        )

    def jerks(self, t: FloatArray) -> FloatArray:
        """Return s⃛ (T,) at times `t: (T,)` [s]."""
        found: FloatArray = np.where((t < 0) | (t > self.duration), 0.0, self.phases[self._phase(t), 3])
        return found

    def _phase(self, t: FloatArray) -> IntArray:
        found: IntArray = np.clip(np.searchsorted(self.starts, t, side="right") - 1, 0, len(self.phases) - 1)
        return found

    def _passed(self, s: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return when arc lengths are passed, and ṡ² there, by bisection: s grows with time."""
        begins = self.phases[:, 0]
        phase = np.clip(np.searchsorted(begins, s, side="right") - 1, 0, len(begins) - 1)
        rows = self.phases[phase]
        early, late = np.zeros(len(s)), np.diff(self.starts)[phase]
        exact = s == rows[:, 0]
        for _ in range(60):
            middle = (early + late) / 2
            before = _after(rows, middle)[0] <= s
            early, late = np.where(before, middle, early), np.where(before, late, middle)
        since = np.where(exact, 0.0, early)
        rate = np.maximum(_after(rows, since)[1], 0.0)
        times, squares = self.starts[phase] + since, rate * rate
        end = s >= self.edges[-1]
        return np.where(end, self.starts[-1], times), np.where(end, 0.0, squares)


def _after(phases: FloatArray, since: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return s, ṡ and s̈ a time after phases (S, 4) began."""
    s, rate, push, jerk = phases.T
    return (
        s + since * (rate + since * (push / 2 + since * jerk / 6)),
        rate + since * (push + since * jerk / 2),
        push + since * jerk,
    )


def jerk_limited_law(cells: Cells, limits: RateLimits, cap: FloatArray) -> JerkLaw:
    """Return a law from rest to rest within limits of the joints, jerk included, and a cap of ṡ in each cell.

    The robot stops where the curve has corners. It is not the fastest such law: between ramps s̈ vanishes.

    Parameters
    ----------
    cells : Cells
        A curve of straight lines.
    limits : RateLimits
        Of the joints; its jerk is not None.
    cap : ndarray, shape (N,)
        Largest ṡ in each cell, > 0; no larger than the velocities of the joints allow.
    """
    assert limits.jerk is not None
    assert not cells.bends.any()
    ends = [0, *cells.stops.tolist(), len(cells)]
    starts, phases, begun = [0.0], list[FloatArray](), 0.0
    for first, last in pairwise(ends):
        slopes = cells.slopes[first:last].max(axis=0)
        moving = slopes > 0
        acceleration, jerk = (
            float((limit[moving] / slopes[moving]).min()) for limit in (limits.acceleration, limits.jerk)
        )
        edges = cells.edges[first : last + 1]
        terrace = _Terrace(edges, cap[first:last], acceleration, jerk)
        state = np.array([edges[0], 0.0, 0.0, 0.0])
        for part in terrace.parts(0.0, float(edges[0]), float(edges[-1])):
            if part.duration <= 0:
                continue
            state[3] = part.jerk
            phases.append(state.copy())
            begun += part.duration
            starts.append(begun)
            state[:3] = [float(x[0]) for x in _after(state[None], np.array([part.duration]))]
            if part.end is not None:  # but for rounding it is so
                state[1], state[2] = part.end, 0.0
    return JerkLaw.of(cells.edges, np.array(starts), np.array(phases))


class _Terrace(NamedTuple):
    """A straight line: `edges: (N + 1,)`, `caps: (N,)` of ṡ in its cells, and the limits of s̈ and s⃛."""

    edges: FloatArray
    caps: FloatArray
    acceleration: float
    jerk: float

    def parts(self, base: float, first: float, last: float) -> list[Part]:
        """Return the phases from arc length first to last, with the speed `base` at both."""
        found: list[Part] = []
        at = first
        for begin, end in self._free(base, first, last):
            high = self._highest(base, begin, end)
            if high <= base * _GAIN or high <= 0:
                continue
            if begin > at:
                found.append(Part((begin - at) / base, 0.0, base))
            ramp = Ramp(base, high, self.acceleration, self.jerk)
            length = ramp.distance
            found += ramp.parts(up=True)
            found += self.parts(high, begin + length, end - length)
            found += ramp.parts(up=False)
            at = end
        if last > at and base > 0:
            found.append(Part((last - at) / base, 0.0, base))
        return found

    def _free(self, base: float, first: float, last: float) -> list[tuple[float, float]]:
        """Return where caps allow more than `base`."""
        more = (self.caps > base * _GAIN) & (self.edges[1:] > first) & (self.edges[:-1] < last)
        changes = np.flatnonzero(np.diff(np.concatenate([[False], more, [False]])))
        spans = zip(self.edges[changes[::2]], self.edges[changes[1::2]], strict=True)
        return [(max(float(a), first), min(float(b), last)) for a, b in spans]

    def _highest(self, base: float, begin: float, end: float) -> float:
        """Return the highest speed to which the robot can go up from `base` and back between two arc lengths."""
        rows = slice(
            int(np.searchsorted(self.edges, begin, side="right")) - 1,
            int(np.searchsorted(self.edges, end, side="left")),
        )
        caps = self.caps[rows]
        left, right = self.edges[:-1][rows], self.edges[1:][rows]

        def fits(high: float) -> bool:
            ramp = Ramp(base, high, self.acceleration, self.jerk)
            if 2 * ramp.distance > end - begin:
                return False
            low = caps < high
            reach = ramp.reach(caps[low])
            return bool(((right[low] - begin <= reach) | (end - left[low] <= reach)).all())

        good, bad = base, float(caps.max())
        if fits(bad):
            return bad
        if base > 0 and not fits(base * _GAIN):
            return base
        for _ in range(_HALVINGS):
            middle = (good + bad) / 2
            good, bad = (middle, bad) if fits(middle) else (good, middle)
        return good
