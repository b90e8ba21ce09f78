"""Conversion between OMPL states and NumPy arrays, for spaces of joint values."""

from __future__ import annotations

import atexit
import ctypes
import sys
import threading
from collections import defaultdict
from collections.abc import Iterator
from functools import partial
from itertools import chain, groupby
from typing import Any

import numpy as np
from ompl import base as ob

from safe_ompl.common import BoolArray, FloatArray, InputError, IntArray, PerThread, PlanningError
from safe_ompl.robot.robot import Robot

_new_capsule = ctypes.pythonapi.PyCapsule_New
_new_capsule.restype = ctypes.py_object
_new_capsule.argtypes = [ctypes.c_void_p, ctypes.c_char_p, ctypes.c_void_p]


def joint_space(robot: Robot) -> Any:
    """Return the OMPL state space of a robot's joints in their order, with an SO(2) for each continuous joint."""
    if not robot.continuous.any():
        return _real_vector(robot.lower, robot.upper)
    space = ob.CompoundStateSpace()
    for turn, run in groupby(range(robot.n), key=robot.continuous.item):
        rows = list(run)
        parts = [ob.SO2StateSpace() for _ in rows] if turn else [_real_vector(robot.lower[rows], robot.upper[rows])]
        for part in parts:
            space.addSubspace(part, 1.0)
    return space


def _real_vector(lower: FloatArray, upper: FloatArray) -> Any:
    space = ob.RealVectorStateSpace(len(lower))
    bounds = ob.RealVectorBounds(len(lower))
    for i, (low, high) in enumerate(zip(lower.tolist(), upper.tolist(), strict=True)):
        bounds.setLow(i, low)
        bounds.setHigh(i, high)
    space.setBounds(bounds)
    return space


# Kinds of coordinates: bounded numbers, angles that wrap, and the four components of unit quaternions.
_LINE, _ANGLE, _QUATERNION = "line", "angle", "quaternion"
_IDENTITY = np.array([0.0, 0.0, 0.0, 1.0])
# Tolerance of the norm of a unit quaternion. OMPL allows 1e-9.
_UNIT = 1e-14

# Kinds of spaces for which reading and writing through a buffer was tested successfully.
_WORKING = set[tuple[Any, ...]]()
# Unused states for reuse, by the structure of their space. OMPL's bindings never free the coordinates of a state, so
# that each new state would leak memory.
_UNUSED = defaultdict[tuple[Any, ...], list[Any]](list)
# Without this, the bindings would report these states as leaked.
atexit.register(_UNUSED.clear)


class StateBridge:
    """Converts configurations between OMPL states and arrays `q: (n,)`. Raises InputError for an unsupported space.

    Supported are real vectors, SO(2), whose angles wrap at ±π, SO(3), whose states are unit quaternions x, y, z, w, and
    compounds of these, such as SE(3). `circular: (n,)` marks the coordinates that wrap. `rotations: (r,)` are the
    indices of the first components of quaternions. `lower` and `upper: (n,)` are the bounds. OMPL's `satisfiesBounds`
    accepts finite coordinates within `held: (2, n)`. `extent` is the length of the diagonal of the bounds, in which a
    rotation counts as one side of length π.

    Motions are those of OMPL's spaces: straight lines, the shorter direction for coordinates that wrap, and the
    shortest arc of the unit sphere for rotations. The difference of two quaternions is a tangent vector (4,) at the
    first, with the length of the arc, which is OMPL's distance in SO(3).
    """

    def __init__(self, space: Any) -> None:
        self.space = space
        self._given = kinds, lower, upper = _coordinates_of(space)
        self.circular: BoolArray = np.array(kinds) == _ANGLE
        self.rotations: IntArray = np.flatnonzero(np.array(kinds) == _QUATERNION)[::4]
        self._turning = [slice(first, first + 4) for first in self.rotations.tolist()]
        self.lower: FloatArray = np.array(lower, dtype=float)
        self.upper: FloatArray = np.array(upper, dtype=float)
        self.n: int = len(lower)
        self._sides: FloatArray = self.upper - self.lower
        self._bounded: BoolArray = np.array(kinds) == _LINE
        free = np.where(self._bounded, sys.float_info.epsilon, sys.float_info.max)
        self.held: FloatArray = np.array([self.lower - free, self.upper + free])
        lengths = [*self._sides[np.array(kinds) != _QUATERNION], *(np.pi for _ in self._turning)]
        self.extent = float(np.linalg.norm(lengths))
        self._wraps = bool(self.circular.any()) or len(self.rotations) > 0
        # OMPL serializes such a state as its coordinates in a row. Reading and writing through one buffer is ten times
        # as fast as through Python lists. The bindings do not guarantee this format, so it is tested.
        if space.getSerializationLength() != 8 * self.n:
            raise InputError(f"state space {space.getName()!r} is not made of real vectors, SO(2) and SO(3) alone")
        self._memory = PerThread(partial(_buffer, self.n))
        kind = type(space), *kinds
        if kind not in _WORKING and not self._buffer_works():
            raise PlanningError("this version of OMPL's bindings does not read and write states through a buffer")
        _WORKING.add(kind)

    @property
    def is_current(self) -> bool:
        """Whether the space still has the same bounds as at the construction of this bridge."""
        return self.coordinates() == self._given

    def coordinates(self) -> tuple[list[str], list[float], list[float]]:
        """Return the kinds of the coordinates of the space, and its current lower and upper bounds."""
        return _coordinates_of(self.space)

    def read(self, state: Any) -> FloatArray:
        """Return the configuration (n,) of a state as a new array."""
        return self.view(state).copy()

    def view(self, state: Any) -> FloatArray:
        """Return the configuration (n,) of a state in a buffer that the next call of this thread overwrites."""
        buffer, capsule = self._memory.own
        self.space.serialize(capsule, state)
        return buffer

    def write(self, q: FloatArray, state: Any) -> None:
        """Copy the configuration `q: (n,)` into a state."""
        buffer, capsule = self._memory.own
        buffer[:] = self.wrapped(q) if self._wraps else q
        self.space.deserialize(state, capsule)

    def _buffer_works(self) -> bool:
        """Return whether values written through the buffer equal OMPL's own coordinates, and are read back."""
        state, values = self.space.allocState(), np.linspace(-1.0, 1.0, self.n)
        buffer, capsule = self._memory.own
        try:
            buffer[:] = values
            self.space.deserialize(state, capsule)
            buffer[:] = np.nan
            self.space.serialize(capsule, state)
        except (TypeError, RuntimeError):
            return False
        return np.array_equal(buffer, values) and values.tolist() == list(_coordinates(self.space, state))

    def wrapped(self, q: FloatArray) -> FloatArray:
        """Return `q: (…, n)` with the coordinates that wrap in [−π, π), and with unit quaternions."""
        if not self._wraps:
            return q
        wrapped = np.where(self.circular, (q + np.pi) % (2 * np.pi) - np.pi, q)
        for part in self._turning:
            norm = np.linalg.norm(wrapped[..., part], axis=-1, keepdims=True)
            # Unit quaternions are not changed by a single bit. A zero quaternion becomes the identity.
            unit = np.where(norm > 0.0, wrapped[..., part] / np.where(norm > 0.0, norm, 1.0), _IDENTITY)
            wrapped[..., part] = np.where(np.abs(norm - 1.0) < _UNIT, wrapped[..., part], unit)
        return wrapped

    def way_points(self, path: Any) -> FloatArray:
        """Return the way points (N, n) of a `PathGeometric`, between which the space interpolates straight lines.

        Coordinates that wrap are unwrapped: no step is longer than half a turn. Raises InputError if the states of the
        path have another type than those of the space.
        """
        states = [path.getState(i) for i in range(path.getStateCount())]
        # The state returns to those that are unused only if it outlives its last use here.
        one = OwnState(self)
        kinds, own = set(map(type, states)), type(one.state)
        if kinds - {own}:
            names = " and ".join(sorted(kind.__name__ for kind in kinds))
            raise InputError(
                f"its states are {names}, those of the space are {own.__name__}: give the space that it was planned in",
                "PathGeometric",
            )
        points = np.empty((len(states), self.n))
        for point, state in zip(points, states, strict=True):
            point[:] = self.view(state)
        if self._wraps:
            turns = np.round(np.diff(points, axis=0) / (2 * np.pi))
            points[1:] -= np.where(self.circular, 2 * np.pi * np.cumsum(turns, axis=0), 0.0)
        return points

    def inside(self, q: FloatArray) -> FloatArray:
        """Return `q: (…, n)` clipped to the bounds; coordinates that wrap are wrapped."""
        # This is three times as fast as np.clip.
        clipped: FloatArray = np.minimum(np.maximum(q, self.lower), self.upper)
        return np.where(self._bounded, clipped, self.wrapped(q)) if self._wraps else clipped

    def between_bounds(self, shares: FloatArray) -> FloatArray:
        """Map `shares: (…, n)` in [0, 1] linearly to configurations between the lower and the upper bounds.

        A quaternion is computed from three of its four shares, so that uniform shares give uniform rotations
        (Shoemake 1992).
        """
        q = self.lower + self._sides * shares
        for part in self._turning:
            share, first, second, _ = np.moveaxis(shares[..., part], -1, 0)
            near, far = np.sqrt(1.0 - share), np.sqrt(share)
            first, second = 2 * np.pi * first, 2 * np.pi * second
            numbers = near * np.sin(first), near * np.cos(first), far * np.sin(second), far * np.cos(second)
            q[..., part] = np.stack(numbers, axis=-1)
        return q

    def difference(self, start: FloatArray, end: FloatArray) -> FloatArray:
        """Return the displacement from `start` to `end`, both (…, n), in the shorter direction if coordinates wrap."""
        delta = end - start
        if self._wraps:
            delta = np.where(self.circular, delta - 2 * np.pi * np.round(delta / (2 * np.pi)), delta)
        for part in self._turning:
            delta[..., part] = _arc(start[..., part], end[..., part])
        return delta

    def moved(self, q: FloatArray, motion: FloatArray) -> FloatArray:
        """Return the ends of motions (…, n), such as multiples of a `difference`, from `q: (…, n)`, not wrapped."""
        end = q + motion
        for part in self._turning:
            length = np.linalg.norm(motion[..., part], axis=-1, keepdims=True)
            # np.sinc(x) is sin(πx)/(πx), and 1 at 0.
            end[..., part] = np.cos(length) * q[..., part] + np.sinc(length / np.pi) * motion[..., part]
        return end


def _arc(start: FloatArray, end: FloatArray) -> FloatArray:
    """Return the tangent vectors (…, 4) of the shortest arcs between unit quaternions (…, 4), as long as the arcs."""
    cosine = (start * end).sum(axis=-1, keepdims=True)
    # A quaternion and its negative are the same rotation.
    across = np.where(cosine < 0.0, -end, end) - np.abs(cosine) * start
    sine = np.linalg.norm(across, axis=-1, keepdims=True)
    scale = np.arctan2(sine, np.abs(cosine)) / np.where(sine > 0.0, sine, 1.0)
    return np.asarray(across * np.where(sine > 0.0, scale, 1.0))


def _buffer(n: int) -> tuple[FloatArray, Any]:
    """Return a buffer (n,), and the capsule through which OMPL's bindings read and write this buffer."""
    buffer: FloatArray = np.zeros(n)
    return buffer, _new_capsule(buffer.ctypes.data, b"nb_handle", None)


def _coordinates(space: Any, state: Any) -> Iterator[float]:
    """Yield the coordinates of a state through OMPL's own accessors. This is slow, and used to test the buffer."""
    # States of SE2StateSpace have named coordinates instead of parts.
    if isinstance(space, ob.SE2StateSpace):
        yield from (state.getX(), state.getY(), state.getYaw())
    elif isinstance(space, ob.SE3StateSpace):
        yield from (state.getX(), state.getY(), state.getZ())
        yield from _coordinates(space.getSubspace(1), state.rotation())
    elif isinstance(space, ob.SO3StateSpace):
        yield from (state.x, state.y, state.z, state.w)
    elif isinstance(space, ob.CompoundStateSpace):
        for k in range(space.getSubspaceCount()):
            yield from _coordinates(space.getSubspace(k), state[k])
    elif isinstance(space, ob.SO2StateSpace):
        yield state.value
    else:
        yield from state[0 : space.getDimension()]


class OwnState:
    """A state of a space. The state is reused when no other reference to it is left."""

    # Ctrl-C may end the constructor before there is a state, and `__del__` is called all the same.
    state: Any = None

    def __init__(self, bridge: StateBridge) -> None:
        unused = self._unused = _UNUSED[_structure(bridge.space)]
        try:
            self.state = unused.pop()
        except IndexError:
            self.state = bridge.space.allocState()

    def __del__(self) -> None:
        # One of the two references is the argument of getrefcount.
        if sys.getrefcount(self.state) == 2:
            self._unused.append(self.state)


class ScratchState(threading.local):
    """One state of a space for each thread."""

    def __init__(self, bridge: StateBridge) -> None:
        self._bridge, self._own = bridge, OwnState(bridge)

    @property
    def state(self) -> Any:
        """The state of this thread."""
        return self._own.state

    def set(self, q: FloatArray) -> Any:
        """Write `q: (n,)` and return the state, which is valid until the next call in this thread."""
        self._bridge.write(q, self.state)
        return self.state


# Motions in these spaces are curves of vehicles, and distances are not those of the coordinates.
_CURVED = tuple(
    getattr(ob, name)
    for name in (
        *("DubinsStateSpace", "ReedsSheppStateSpace", "TrochoidStateSpace"),
        *("OwenStateSpace", "VanaStateSpace", "VanaOwenStateSpace"),
    )
    if hasattr(ob, name)
)


def _named(space: Any) -> str:
    """Return name and type of a space for messages; the bindings cannot return the names of constrained spaces."""
    try:
        return f"{space.getName()!r} ({type(space).__name__})"
    except TypeError:
        return type(space).__name__


def _structure(space: Any) -> tuple[Any, ...]:
    """Return a key that differs between spaces whose states have different memory layouts."""
    if isinstance(space, ob.CompoundStateSpace):
        return type(space), *(_structure(space.getSubspace(i)) for i in range(space.getSubspaceCount()))
    return type(space), space.getDimension()


def _coordinates_of(space: Any) -> tuple[list[str], list[float], list[float]]:
    """Return the kinds of the coordinates of a space, and their lower and upper bounds."""
    if isinstance(space, _CURVED):
        raise InputError(
            f"state space {_named(space)}: its motions are curves; only spaces of straight motions can be planned in "
            "(real vectors, SO(2), SO(3) and compounds of these, such as SE2StateSpace)"
        )
    if isinstance(space, ob.SO2StateSpace):
        return [_ANGLE], [-np.pi], [np.pi]
    if isinstance(space, ob.SO3StateSpace):
        return 4 * [_QUATERNION], 4 * [-1.0], 4 * [1.0]
    if isinstance(space, ob.RealVectorStateSpace):
        bounds = space.getBounds()
        return [_LINE] * space.getDimension(), list(bounds.low), list(bounds.high)
    if isinstance(space, ob.CompoundStateSpace):
        parts = [_coordinates_of(space.getSubspace(i)) for i in range(space.getSubspaceCount())]
        kinds, lower, upper = (list(chain.from_iterable(each)) for each in zip(*parts, strict=True))
        return kinds, lower, upper
    raise InputError(
        f"state space {_named(space)}: only real vectors, SO(2), SO(3) and compounds of these can be planned in"
    )
