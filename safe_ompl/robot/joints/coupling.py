"""Mimic joints: how the joints of Pinocchio's model follow those that are planned for."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from safe_ompl.arrays import FloatArray
from safe_ompl.errors import InputError


@dataclass(frozen=True)
class Mimic:
    """A joint that follows another one: value = multiplier · primary + offset."""

    primary: str
    multiplier: float
    offset: float


@dataclass(frozen=True)
class Coupling:
    """The affine map from the n planned joints to the m joints of Pinocchio's model, matrix·q + offsets.

    A planned joint has a row of the identity, a mimic joint its multiplier in the column of its primary. What is
    known for each of the m joints (radii, Jacobians) becomes what is known for the n planned ones. Where nothing
    mimics, m = n and every array is returned as it came.

    Attributes
    ----------
    matrix : ndarray, shape (m, n)
        Rates of the model's joints per rate of the planned ones.
    offsets : ndarray, shape (m,)
        Values of the model's joints at q = 0 [rad or m].
    trivial : bool
        Whether nothing mimics.
    """

    matrix: FloatArray
    offsets: FloatArray
    trivial: bool

    @classmethod
    def of(cls, joints: list[str], mimics: Mapping[str, Mimic]) -> Coupling:
        """Return the coupling of the model's `joints`, of which those in `mimics` follow planned ones directly."""
        planned = [name for name in joints if name not in mimics]
        matrix, offsets = np.zeros((len(joints), len(planned))), np.zeros(len(joints))
        for row, name in enumerate(joints):
            mimic = mimics.get(name, Mimic(name, 1.0, 0.0))
            matrix[row, planned.index(mimic.primary)] = mimic.multiplier
            offsets[row] = mimic.offset
        for array in (matrix, offsets):
            array.setflags(write=False)
        return cls(matrix, offsets, not mimics)

    def values(self, q: FloatArray) -> FloatArray:
        """Return the values (…, m) of the model's joints at `q: (…, n)`."""
        return q if self.trivial else q @ self.matrix.T + self.offsets

    def motions(self, delta: FloatArray) -> FloatArray:
        """Return the motions (…, m) of the model's joints while the planned ones move by `delta: (…, n)`."""
        return delta if self.trivial else delta @ self.matrix.T

    def reach(self, steps: FloatArray) -> FloatArray:
        """Return how far (…, m) the model's joints move while the planned ones move by up to `steps: (…, n)` ≥ 0."""
        return steps if self.trivial else steps @ np.abs(self.matrix).T

    def radii(self, radii: FloatArray) -> FloatArray:
        """Return the radii (…, n) that bound what `radii: (…, m)` bound: Σ_j r_j·|Δ_j| ≤ Σ_i (Σ_j r_j·|c_ji|)·|Δ_i|."""
        return radii if self.trivial else radii @ np.abs(self.matrix)

    def columns(self, derivatives: FloatArray) -> FloatArray:
        """Return derivatives (…, n) by the planned joints from those (…, m) by the model's joints."""
        return derivatives if self.trivial else derivatives @ self.matrix


def resolved(mimics: Mapping[str, Mimic], source: str) -> dict[str, Mimic]:
    """Return `mimics` with chains (a joint that mimics a mimic joint) followed to the first joint of each.

    Raises
    ------
    InputError
        If joints mimic each other in a circle.
    """
    found = {}
    for name, mimic in mimics.items():
        seen = [name]
        while mimic.primary in mimics:
            if mimic.primary in seen:
                raise InputError(f"joints mimic each other in a circle: {', '.join(seen)}", source)
            seen.append(mimic.primary)
            above = mimics[mimic.primary]
            mimic = Mimic(
                above.primary,
                mimic.multiplier * above.multiplier,
                mimic.multiplier * above.offset + mimic.offset,
            )
        found[name] = mimic
    return found
