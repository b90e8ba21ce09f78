"""People in the scene, bounds on their speed, and the contact that is allowed; plain data."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

from safe_ompl.common import InputError, Section, key
from safe_ompl.common import documents as document
from safe_ompl.geometry import LIMBS, Person
from safe_ompl.scene.scene import Scene

_OF_LIMB = {
    "neck": "head",
    "torso": "chest",
    "hips": "pelvis",
    "shoulders": "shoulder",
    "flank": "abdomen",
    "shank": "lower_leg",
    "foot": "lower_leg",
}
WALKING = 1.6  # [m/s]


class BodyRegion(NamedTuple):
    """Contact limits of a region of the body: largest force of a transient contact [N], 0: none; effective mass [kg].

    Its stiffness is in N/mm.
    """

    force: float
    mass: float
    stiffness: float


# Values that are quoted publicly of ISO/TS 15066:2016, annex A, from secondary sources: circulating tables differ, and
# the user must check them. Pressure may allow less than force, clamping halves it. Using them is not compliance.
CONTACT_SOURCE = "secondary sources of ISO/TS 15066:2016, to be checked; no compliance"
CONTACT_TABLE: dict[str, BodyRegion] = {
    "head": BodyRegion(0, 4.4, 150),
    "chest": BodyRegion(280, 40, 25),
    "abdomen": BodyRegion(220, 40, 10),
    "pelvis": BodyRegion(360, 40, 25),
    "shoulder": BodyRegion(420, 40, 35),
    "upper_arm": BodyRegion(300, 3, 30),
    "forearm": BodyRegion(320, 2, 40),
    "hand": BodyRegion(280, 0.6, 75),
    "thigh": BodyRegion(440, 75, 50),
    "lower_leg": BodyRegion(260, 75, 60),
}


def _who(key: str, value: Any) -> tuple[str, ...]:
    names = document.each(key, value, document.text)
    if not names:
        raise InputError("name one obstacle at least, or leave it out", key)
    return names


def _region(key: str, value: Any) -> BodyRegion:
    force, mass, stiffness = document.numbers(key, value, 3)
    document.number(f"{key}[0]", force, at_least=0.0)
    document.number(f"{key}[1]", mass, above=0.0)
    document.number(f"{key}[2]", stiffness, above=0.0)
    return BodyRegion(force, mass, stiffness)


@dataclass(frozen=True)
class People(Section):
    """People beside a robot, and the assumptions about them that trajectories rest on.

    What is proven holds *if* no limb moves faster than its speed.

    Parameters
    ----------
    who : sequence of str, optional
        Obstacles that are treated as people; default: those whose shape is a person.
    speed : float
        Bound on the speed of every limb [m/s].
    speeds : mapping of str to float, optional
        Other bounds for single limbs, such as ``right_hand`` [m/s].
    reaction_time : float
        Time from the measurement of a person until the robot begins to brake [s].
    clearance : float
        Distance that must be left when the robot stands still [m]: intrusion distance and uncertainties, C + Z_d + Z_r.
    contact : bool
        Whether the robot may touch people at speeds at which contact stays below the limits of the body region. That is
        its own speed; the person's is not counted. Where a limb may be clamped half of the force counts.
    regions : mapping of str to 3 float, optional
        Regions whose force [N], mass [kg] and stiffness [N/mm] replace those of `CONTACT_TABLE`.
    reach : path, optional
        Reach file (YAML) of `safe-ompl people calibrate`, which says beside people who move how far limbs go.

    Raises
    ------
    InputError
        If a value cannot be used; the message starts with its key.
    """

    who: tuple[str, ...] | None = key(_who, default=None)
    speed: float = key(document.number, default=WALKING, at_least=0.0)
    speeds: Mapping[str, float] = key(document.numbers_by_name, factory=dict, valid=LIMBS, at_least=0.0)
    reaction_time: float = key(document.number, default=0.1, at_least=0.0)
    clearance: float = key(document.number, default=0.0, at_least=0.0)
    contact: bool = key(document.flag, default=False)
    regions: Mapping[str, BodyRegion] = key(document.by_name, factory=dict, read=_region, known=CONTACT_TABLE)
    reach: Path | None = key(document.file, default=None, endings=(".yaml", ".yml"))

    def names(self, scene: Scene) -> tuple[str, ...]:
        """Return the names of the obstacles that are treated as people.

        Raises InputError if the scene has no person, and none is named; or has no obstacle of such a name.
        """
        if self.who is not None:
            return tuple(scene[name].name for name in self.who)
        found = tuple(o.name for o in scene if isinstance(o.shape, Person))
        if not found:
            raise InputError(
                "the scene has no person; name the obstacles that are treated as people, or give no people", "people"
            )
        return found

    @property
    def contact_sentence(self) -> str:
        """What is assumed of contact, with the source of the figures; empty where it is not allowed."""
        if not self.contact:
            return ""
        sources = ["yours"] if self.regions else []
        if len(self.regions) < len(CONTACT_TABLE):
            sources.append(CONTACT_SOURCE)
        own = "speeds of contact are the robot's own, as if it were infinitely heavy, the person's is not counted"
        return f"{own}; figures: {'; '.join(sources)}"

    def speed_of(self, limb: str) -> float:
        """Return the bound on the speed of a limb [m/s]."""
        return self.speeds.get(limb, self.speed)

    def region_of(self, limb: str) -> BodyRegion:
        """Return the contact limits of a limb; those of the head for what is no limb."""
        name = limb.removeprefix("left_").removeprefix("right_") if limb in LIMBS else "head"
        name = _OF_LIMB.get(name, name)
        return self.regions.get(name, CONTACT_TABLE[name])
