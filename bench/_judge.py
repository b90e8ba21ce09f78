"""A judge of certificates that knows nothing of what issues and verifies them: it reads sentences, and asks samples.

Robots come from their URDFs by `Robot.from_urdf`, scenes from their documents, distances from `pin.computeDistances`,
the motion in time from its pieces and its time law, integrated here. A sentence that it cannot read counts as false.
"""

from __future__ import annotations

import re
import zlib
from base64 import b64decode
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise, product
from math import inf, sqrt
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, TypeAlias

import numpy as np
import pinocchio as pin

from bench._plain import PlainGeometry
from safe_ompl import DangerField, KinetostaticField, Obstacle, Pose, Robot, Scene
from safe_ompl.common import FloatArray
from safe_ompl.robot import Attachment

SAMPLES = 12  # of an edge
INSTANTS, BEGINS, STOPS = 150, 10, 25  # of a motion, of stops, and of one stop
ROUNDING = 1e-5
N = r"(-?[\d.]+(?:e[+-]?\d+)?|inf)"
SENTENCES = {
    "free": r"every motion (?:of (\d+) stretches )?is free(, for the (?:robot|scene|robot and the scene) that the file "
    r"itself carries)?",
    "joined": rf"they are one (motion|path)(?: of {N} s, (without jumps of velocity))?"
    r"(?:, \d+ stretches of which are not in time)?",
    "nothing else": r"nothing else touches, but what is held and the links that do not move against its tip",
    "danger": rf"danger at most {N} \((max|mean|softmax)(?: of sharpness {N})?, (unit|length), k1 {N}, "
    rf"points {N} m apart(?: where the scene has them)?\)",
    "clearance": rf"at least {N} mm from (.*)",
    "moving": rf"the same while obstacles move no faster than (.*), for {N} s",
    "axis": rf"the tool's axis \((.*)\) within {N}° of the direction \((.*)\)",
    "tip": r"the tip at (.*)",
    "timed": rf"driven in {N} s, the joints within velocities of \((.*?)\), accelerations of \((.*?)\)"
    r"(?:, jerks of \((.*)\))? \[rad or m, s\]",
    "tool speed": rf"the tip is no faster than {N} m/s",
    "link speed": rf"no point of a link, nor the tip, is faster than {N} m/s",
    "stops": rf"it stands before anyone of (.*) who moves no faster than {N} m/s((?:, \S+ {N} m/s)*) "
    rf"comes nearer than {N} mm, if it brakes within {N} s",
    "moving danger": rf"danger in motion at most {N} \((max|mean|softmax)(?: of sharpness {N})?, (unit|length), "
    rf"k1 {N}, k2 {N}, gamma {N}, points {N} m apart\)",
    "margin": rf"no moving link nearer than {N} mm to any obstacle",
    "tube": r"the same with joints off by up to \((.*)\) \[rad or m\]",
    "motion": rf"a (?:motion|path) of (\d+) (?:polynomials|straight edges)(?: in {N} s)?"
    r"(?:, and whatever is within \((.*)\) \[rad or m\] of them)?",
    "rates": r"the joints within velocities of \((.*?)\)(?:, accelerations of \((.*?)\))?(?:, jerks of \((.*?)\))? "
    r"\[rad or m, s\]",
}


HOLDS = re.compile(r"(\S+) holds (\S+), where it took it(?:, in stretch(?:es)? (.*))?")
TOUCHES = re.compile(rf"(.*) may touch (\S+), no deeper than {N} mm(?:, in stretch(?:es)? (.*))?")


def numbers(text: str) -> FloatArray:
    """Return the numbers of a list in a sentence."""
    return np.array([float(x) for x in text.split(",")])


def speeds(text: str) -> dict[str, float]:
    """Return the speeds of a list "name 0.1 m/s, other 0.2 m/s"."""
    return {name: float(speed) for name, speed in re.findall(rf"(?:, )?(\S+) {N} m/s", text)}


def read(claims: tuple[str, ...]) -> dict[str, tuple[Any, ...]] | None:
    """Return what sentences say, by their kind; None if one cannot be read, or is there twice."""
    found: dict[str, tuple[Any, ...]] = {}
    for sentence in claims:
        matches = {kind: re.fullmatch(pattern, sentence) for kind, pattern in SENTENCES.items()}
        kinds = [kind for kind, match in matches.items() if match]
        if len(kinds) != 1 or kinds[0] in found:
            return None
        match = matches[kinds[0]]
        assert match is not None
        found[kinds[0]] = match.groups()
    return found


def numbered(text: str | None) -> list[int]:
    """Return the numbers of a list of stretches such as "2 to 4, 6"; 0 where none are named."""
    runs = [part.split(" to ") for part in (text or "0").split(", ")]
    return [k for run in runs for k in range(int(run[0]), int(run[-1]) + 1)]


Pairs: TypeAlias = dict[tuple[str, str], float]


def handled(claims: tuple[str, ...]) -> tuple[tuple[str, ...], dict[int, dict[str, str]], dict[int, Pairs]]:
    """Return sentences of other kinds, which tip holds what on which stretch, and which pair may touch how deep [m]."""
    rest, holds, touches = list[str](), defaultdict[int, dict[str, str]](dict), defaultdict[int, Pairs](dict)
    for sentence in claims:
        if match := HOLDS.fullmatch(sentence):
            for k in numbered(match[3]):
                holds[k][match[2]] = match[1]
        elif match := TOUCHES.fullmatch(sentence):
            for k in numbered(match[4]):
                touches[k] |= dict.fromkeys(product(match[1].split(" and "), [match[2]]), float(match[3]) / 1e3)
        else:
            rest.append(sentence)
    return tuple(rest), holds, touches


# ------------------------------------------------------------------------------------------ what a file carries


def carried_robot(recipe: Mapping[str, Any], folder: Path) -> Robot:
    """Build the robot of a recipe with the methods of `Robot`."""
    own = ("urdf", "srdf", "base", "attached", "files")
    options = {key: value for key, value in recipe.items() if key not in own and value is not None}
    for key in ("urdf", "srdf"):
        if recipe.get(key) is not None:
            (folder / f"judged.{key}").write_text(recipe[key]["text"])
    srdf = None if recipe.get("srdf") is None else folder / "judged.srdf"
    robot = Robot.from_urdf(folder / "judged.urdf", srdf, **options)
    if recipe.get("base") is not None:
        robot = Robot(replace(robot.spec, base=recipe["base"]))
    for item in recipe.get("attached", ()):
        held = Attachment.from_mapping(item, folder)
        options = {"touch_links": held.touch_links, "touch_depth": held.touch_depth, "danger": held.danger}
        robot = robot.with_attached(held.name, held.shape, held.link, held.pose, **options)
    return robot


def carried(content: Mapping[str, Any]) -> tuple[Robot, Scene]:
    """Build the robot and the scene that a certificate carries."""
    with TemporaryDirectory() as name:
        for file, data in content["scene"].get("files", {}).items():
            (Path(name) / file).write_bytes(zlib.decompress(b64decode(data)))
        scene = Scene.from_mapping(content["scene"]["content"], Path(name))
        return carried_robot(content["robot"]["recipe"], Path(name)), scene


# -------------------------------------------------------------------------------------------------- the motion


class Motion:
    """The motion in time that a certificate holds: a law, or the average of one over a window, on polynomials."""

    def __init__(self, claim: Mapping[str, Any]) -> None:
        self.starts = np.array(claim["times"], dtype=float)
        self.pieces = [
            [np.polynomial.Polynomial(column, [begin, end], [0.0, 1.0]) for column in np.transpose(piece).astype(float)]
            for (begin, end), piece in zip(pairwise(self.starts.tolist()), claim["coefficients"], strict=True)
        ]
        self.edges = np.array(claim["edges"], dtype=float)
        self.window = float(claim.get("window") or 0.0)
        corners = [self.starts[k] for k in claim["corners"]] if self.window else []
        spans, t = [], 0.0  # when it begins, duration, s, v, a
        for (s, end), (x, y) in zip(pairwise(claim["edges"]), pairwise(claim["squares"]), strict=True):
            spans.append((t, 2 * (end - s) / (sqrt(x) + sqrt(y)), s, sqrt(x), (y - x) / (2 * (end - s))))
            t += spans[-1][1]
            if any(abs(end - corner) < 1e-9 for corner in corners):
                spans.append((t, self.window, end, 0.0, 0.0))
                t += self.window
        self.spans = spans
        self.duration = t + self.window

    def law(self, t: float, spans: list[Any] | None = None) -> tuple[float, float, float, float]:
        """Return s and its derivatives at a time."""
        spans = self.spans if spans is None else spans
        if not self.window:
            return *self._plan(t, spans)[1:], 0.0
        now, before = self._plan(t, spans), self._plan(t - self.window, spans)
        s, v, a, j = ((x - y) / self.window for x, y in zip(now, before, strict=True))
        return s, v, a, j

    def _plan(self, t: float, spans: list[Any]) -> tuple[float, float, float, float]:
        """Return the integral of s of the plan, s and its derivatives; it stands before and after."""
        begins = [span[0] for span in spans]
        k = max(int(np.searchsorted(begins, t, side="right")) - 1, 0)
        area = sum(T * (s + T * (v / 2 + T * a / 6)) for _, T, s, v, a in spans[:k])
        begin, whole, s, v, a = spans[k]
        x = min(max(t - begin, 0.0), whole)
        area += x * (s + x * (v / 2 + x * a / 6)) + (t - begin - x) * (s + x * (v + x * a / 2))
        moves = 0 <= t - begin < whole
        return area, s + x * (v + x * a / 2), (v + x * a) * moves, a * moves

    def place(self, s: float) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Return q, q′, q″ and q‴ at an arc length."""
        k = min(max(int(np.searchsorted(self.starts, s, side="right")) - 1, 0), len(self.pieces) - 1)
        q, p, b, c = (np.array([joint.deriv(order)(s) for joint in self.pieces[k]]) for order in range(4))
        return q, p, b, c

    def stop(self, begin: float, brakes: list[float]) -> list[tuple[float, float, float, float]]:
        """Return time, s, ṡ and s̈ of a stop that begins at a time, at its start and often until it stands."""
        _, s, v, _ = self._plan(begin, self.spans)
        t, weakest = 0.0, inf
        spans = [(at - begin, min(T, begin - at), *rest) for at, T, *rest in self.spans if at <= begin]
        k = min(max(int(np.searchsorted(self.edges, s, side="right")) - 1, 0), len(brakes) - 1)
        while v > 1e-9 and k < len(brakes):
            weakest = min(weakest, brakes[k])
            room = max(float(self.edges[k + 1]) - s, 0.0)
            after = max(v * v - 2 * weakest * room, 0.0)
            spans.append((t, (v - sqrt(after)) / weakest, s, v, -weakest))
            s, v, t, k = float(self.edges[k + 1]), sqrt(after), t + spans[-1][1], k + 1
        if v > 1e-6:
            return [(inf, s, v, -weakest)]  # it has not stopped where the motion ends
        whole = t + self.window * (1 - 1e-9)
        return [(x, *self.law(x, spans)[:3]) for x in np.linspace(0.0, whole, STOPS, endpoint=False)]


def samples(claim: Mapping[str, Any], order: int) -> FloatArray:
    """Return samples of a derivative of the polynomials that a certificate holds, times SAMPLES per piece."""
    u, rows = np.linspace(0, 1, SAMPLES), []
    for (start, end), piece in zip(pairwise(claim["times"]), claim["coefficients"], strict=True):
        held = [np.polynomial.Polynomial(column) for column in np.transpose(piece).astype(float)]
        held = [polynomial.deriv(order) if order else polynomial for polynomial in held]
        rows += (np.transpose([polynomial(u) for polynomial in held]) / float(end - start) ** order).tolist()
    return np.array(rows)


# --------------------------------------------------------------------------------------------------- the judge


@dataclass
class Judge:
    """Whether sentences about a path are true of a robot in a scene.

    Attributes
    ----------
    robot, scene
        What they are about.
    terms
        What a user asks for: speeds and so on of people, options of the danger, limits of joints, and, under
        `contacts`, which pairs may touch how deep [m]; none where what the sentences say is enough.
    touching
        Which pairs may touch, and how deep [m].
    """

    robot: Robot
    scene: Scene
    terms: Mapping[str, Any] = field(default_factory=dict)
    touching: Pairs = field(default_factory=dict)

    def __post_init__(self) -> None:
        plain = PlainGeometry(self.robot, self.scene)
        self.model, self.data = plain.model, plain.data
        self.pairs, self.distances = plain.pairs, plain.distances

    def true(self, claims: tuple[str, ...], content: Mapping[str, Any], own: tuple[str, ...]) -> bool:
        """Return whether what is said of the path of a certificate is true, and about what it should be."""
        rest, holds, touches = handled(claims)
        said, stretches = read(rest), content["stretches"]
        if said is None or "free" not in said:
            return False
        about = f", for the {' and the '.join(own)} that the file itself carries" if own else None
        if said["free"] != (None if len(stretches) == 1 else str(len(stretches)), about):
            return False
        if ("motion" in said) != (len(stretches) == 1) or ("joined" in said) == ("motion" in said):
            return False
        if any(touches.values()) != ("nothing else" in said):
            return False
        asked = self.terms.get("contacts")
        pairs = [item for of in touches.values() for item in of.items()]
        if asked is not None and any(depth > asked.get(pair, 0.0) * (1 + ROUNDING) for pair, depth in pairs):
            return False
        if "joined" in said and not self._joined(said["joined"], stretches):
            return False
        for k, (robot, scene, held) in enumerate(self._stages(stretches)):
            if held != holds[k]:
                return False
            if not replace(self, robot=robot, scene=scene, touching=touches[k]).holds(said, stretches[k]):
                return False
        return True

    def _stages(self, stretches: Sequence[Mapping[str, Any]]) -> Iterator[tuple[Robot, Scene, dict[str, str]]]:
        """Yield robot and scene of each stretch, and which tip holds what it took: it stays where it was taken."""
        robot, scene, taken = self.robot, self.scene, dict[str, str]()
        items = {item.name: item for item in robot.spec.attached}
        for stretch in stretches:
            if stretch.get("attach") or stretch.get("detach"):
                bare = self.robot.bare
                model, data = bare.shared.model, bare.shared.model.createData()
                q = np.array(stretch["motion"]["coefficients"][0][0], dtype=float)
                pin.framesForwardKinematics(model, data, bare.pinocchio_configuration(q))
                for name in stretch.get("detach") or ():
                    item = items.pop(name)
                    taken.pop(name, None)
                    known = self.scene[name] if name in self.scene.names else Obstacle(name, item.shape)
                    place = data.oMf[model.getFrameId(item.link)] * item.pose.se3
                    scene = scene.with_obstacles(known.moved(Pose.of(place)))
                for name, link in (stretch.get("attach") or {}).items():
                    place = data.oMf[model.getFrameId(link)].inverse() * scene[name].pose.se3
                    items[name] = Attachment(name, scene[name].shape, link, Pose.of(place))
                    taken[name], scene = link, scene.without(name)
                robot = bare
                for item in items.values():
                    robot = robot.holding(item)
            yield robot, scene, dict(taken)

    @staticmethod
    def _joined(said: tuple[Any, ...], stretches: Sequence[Mapping[str, Any]]) -> bool:
        """Return whether stretches begin where those before end, at their velocities, and take as long as is said."""
        _, duration, smooth = said
        claims = [stretch["motion"] for stretch in stretches]
        for before, after in pairwise(claims):
            if np.abs(samples(before, 0)[-1] - samples(after, 0)[0]).max() > 1e-5:
                return False
            if smooth and np.abs(samples(before, 1)[-1] - samples(after, 1)[0]).max() > 1e-5:
                return False
        lasts = sum(claim["times"][-1] - claim["times"][0] for claim in claims)
        return duration is None or (all(claim["timed"] for claim in claims) and abs(float(duration) - lasts) <= 6e-4)

    def holds(self, said: Mapping[str, tuple[Any, ...]], stretch: Mapping[str, Any]) -> bool:
        """Return whether what is said holds of one stretch."""
        if not self._polynomials(said, stretch["motion"]):
            return False
        if not stretch.get("trajectory"):
            return "timed" not in said
        motion, q = Motion(stretch["trajectory"]), samples(stretch["motion"], 0)
        whole = np.linspace(0, motion.duration, INSTANTS)
        curve = np.array([motion.place(motion.law(x)[0])[0] for x in whole])
        gaps = (self.robot.difference(curve[k], q[k]) for k in (0, -1))
        if max(float(np.abs(gap).max()) for gap in gaps) > ROUNDING:
            return False
        within = self.robot.continuous | ((curve > self.robot.lower - 1e-8) & (curve < self.robot.upper + 1e-8))
        if not within.all() or not self._still(said, curve):
            return False
        return "timed" not in said or self._timed(said, motion, stretch["trajectory"])

    def _off(
        self, said: Mapping[str, tuple[Any, ...]], dense: FloatArray, slack: FloatArray | float = 0.0
    ) -> FloatArray:
        """Return samples (M, n), and with a tube or slack others besides, in the corners of what is allowed there."""
        widths = slack + (numbers(said["tube"][0]) if "tube" in said else 0.0)
        if not np.any(widths):
            return dense
        signs = np.random.default_rng(0).choice([-1.0, 1.0], (3, *dense.shape))
        return np.concatenate([dense, *(dense + signs * widths)])

    def _polynomials(self, said: Mapping[str, tuple[Any, ...]], claim: Mapping[str, Any]) -> bool:
        count, duration, within = said.get("motion", (None, None, None))
        times = np.array(claim["times"], dtype=float)
        q, asked = samples(claim, 0), self.terms
        if count is not None and int(count) != len(times) - 1:
            return False
        if duration is not None and abs(float(duration) - (times[-1] - times[0])) > 6e-4:
            return False
        gaps = np.abs(q[SAMPLES::SAMPLES] - q[SAMPLES - 1 : -1 : SAMPLES])
        slack = np.zeros(self.robot.n) if within is None else numbers(within)
        low, high = self.robot.lower - 1e-8 + slack, self.robot.upper + 1e-8 - slack
        if not (self.robot.continuous | ((q > low) & (q < high))).all() or gaps.max(initial=0.0) > 1e-5:
            return False
        for order, text in enumerate(said.get("rates", ()), 1):
            limits, kind = (None if text is None else numbers(text), ("velocity", "acceleration", "jerk")[order - 1])
            if limits is None:
                continue
            wanted = asked.get(kind)
            if wanted is not None and (limits > np.array(wanted) * (1 + ROUNDING)).any():
                return False
            if not claim["timed"] or (np.abs(samples(claim, order)) > limits * (1 + ROUNDING)).any():
                return False
        dense = self._off(said, q, slack)
        return self._still(said, dense)

    def _still(self, said: Mapping[str, tuple[Any, ...]], dense: FloatArray) -> bool:
        least = np.zeros(len(self.pairs))
        if "margin" in said:
            least[[bool(obstacle) for _, obstacle, _ in self.pairs]] = float(said["margin"][0]) / 1e3
        if "clearance" in said:
            distance, names = said["clearance"]
            for k, (_, obstacle, _) in enumerate(self.pairs):
                if obstacle in names.split(", "):
                    least[k] = max(float(distance) / 1e3, least[k])
        if "moving" in said:
            moving, time = speeds(said["moving"][0]), float(said["moving"][1])
            least += [moving.get(obstacle, 0.0) * time for _, obstacle, _ in self.pairs]
        for k, (link, obstacle, other) in enumerate(self.pairs):
            other = obstacle or other
            depths = [self.touching[pair] for pair in ((link, other), (other, link)) if pair in self.touching]
            # A body that stays out of all that is deeper in a box may be so far in it at a corner.
            least[k] -= sqrt(3) * max(depths, default=0.0) * (1 + ROUNDING)
        if not all((self.distances(q) > least - 1e-9).all() for q in dense):
            return False
        for q in dense if {"axis", "tip"} & set(said) else ():
            pose = self.robot.tip_pose(q)
            if "axis" in said:
                axis, direction = (numbers(said["axis"][k]) for k in (0, 2))
                cosine = (pose.rotation @ axis) @ direction / np.linalg.norm(axis) / np.linalg.norm(direction)
                if np.degrees(np.arccos(np.clip(cosine, -1, 1))) > float(said["axis"][1]) + 1e-4:
                    return False
            for axis_name, low, high in re.findall(rf"([xyz]) from {N} to {N} m", said.get("tip", ("",))[0]):
                if not float(low) - 1e-6 <= pose.translation["xyz".index(axis_name)] <= float(high) + 1e-6:
                    return False
        if "danger" in said:
            bound, aggregate, sharpness, weighting, k1, spacing = said["danger"]
            kind = {"aggregate": aggregate, "weighting": weighting, "k1": float(k1), "spacing": float(spacing)}
            danger = self._field(kind, sharpness)
            return danger is not None and danger.values(dense).max() <= float(bound) * (1 + ROUNDING)
        return True

    def _field(self, kind: dict[str, Any], sharpness: str | None) -> DangerField | None:
        """Return the field of a kind; None if that is not what is asked for."""
        kind |= {} if sharpness is None else {"sharpness": float(sharpness)}
        asked = self.terms.get("danger", {})
        if any(asked.get(key, value) != value for key, value in kind.items()):
            return None
        points, weights, _ = self.scene.danger_points(kind.pop("spacing"))
        return DangerField(self.robot, points, weights, **kind)

    # ----------------------------------------------------------------------------------------------- in time

    def _timed(self, said: Mapping[str, tuple[Any, ...]], motion: Motion, claim: Mapping[str, Any]) -> bool:
        duration, *limits = said["timed"]
        velocity, acceleration, jerk = (None if text is None else numbers(text) for text in limits)
        for key, limit in (("velocity", velocity), ("acceleration", acceleration), ("jerk", jerk)):
            asked = self.terms.get(key)
            if asked is not None and limit is not None and (limit > np.array(asked) * (1 + ROUNDING)).any():
                return False
        if abs(float(duration) - motion.duration) > 6e-4 or velocity is None or acceleration is None:
            return False
        states = []
        for t in np.linspace(0, motion.duration, INSTANTS):
            s, v, a, j = motion.law(t)
            _, slope, bend, swing = motion.place(s)
            states.append((*self._state(motion, s, v, a), swing * v**3 + 3 * bend * v * a + slope * j))
        q, qd, qdd, qddd = (np.array(column) for column in zip(*states, strict=True))
        if (np.abs(qd) > velocity * (1 + ROUNDING) + 1e-9).any():
            return False
        if (np.abs(qdd) > acceleration * (1 + ROUNDING) + 1e-9).any():
            return False
        if jerk is not None and (np.abs(qddd) > jerk * (1 + ROUNDING) + 1e-9).any():
            return False
        fastest = [self._speeds(*state) for state in zip(q, qd, strict=True)]
        for kind, k in (("tool speed", 0), ("link speed", 1)):
            if kind in said and max(speed[k] for speed in fastest) > float(said[kind][0]) * (1 + ROUNDING):
                return False
        if "moving danger" in said:
            bound, aggregate, sharpness, weighting, k1, k2, gamma, spacing = said["moving danger"]
            kind = {"aggregate": aggregate, "weighting": weighting, "k1": float(k1), "k2": float(k2)}
            danger = self._field({**kind, "gamma": float(gamma), "spacing": float(spacing)}, sharpness)
            if danger is None or KinetostaticField(danger).values(q, qd).max() > float(bound) * (1 + ROUNDING):
                return False
        return "stops" not in said or self._stops(said["stops"], motion, claim, acceleration)

    @staticmethod
    def _state(motion: Motion, s: float, v: float, a: float) -> tuple[FloatArray, FloatArray, FloatArray]:
        q, slope, bend, _ = motion.place(s)
        return q, slope * v, slope * a + bend * v * v

    def _speeds(self, q: FloatArray, qd: FloatArray) -> tuple[float, float]:
        """Return the speeds of the tip and of the fastest point that is looked at [m/s]."""
        rates = self.robot.coupling.motions(qd)
        pin.forwardKinematics(self.model, self.data, self.robot.pinocchio_configuration(q), rates)
        frame = pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
        tip = float(np.linalg.norm(pin.getFrameVelocity(self.model, self.data, self.robot.tip_frame, frame).linear))
        fastest = tip
        for body in self.robot.shared.collision_model.geometryObjects:
            motion, centre = self.data.v[body.parentJoint], body.placement.translation
            body.geometry.computeLocalAABB()
            tops = (np.array([0, 0, z]) for z in (body.geometry.aabb_local.min_[2], body.geometry.aabb_local.max_[2]))
            for point in (centre, *(body.placement.act(top) for top in tops)):  # on its axis: all are of the body
                fastest = max(fastest, float(np.linalg.norm(np.cross(motion.angular, point) + motion.linear)))
        return tip, fastest

    def _stops(self, said: tuple[Any, ...], motion: Motion, claim: Mapping[str, Any], acceleration: FloatArray) -> bool:
        who, speed, limbs, _, clearance, reaction = said
        asked, names = self.terms.get("people", {}), who.split(", ")
        mine = {"who": names, "speed": float(speed), "speeds": speeds(limbs), "reaction_time": float(reaction)}
        if any(key in asked and asked[key] != value for key, value in mine.items()):
            return False
        if asked and float(clearance) / 1e3 < asked["clearance"] * (1 - ROUNDING):
            return False
        for begin in np.linspace(0, motion.duration * (1 - 1e-9), BEGINS):
            for t, s, v, a in motion.stop(float(begin), claim["stops"]["brakes"]):
                q, qd, qdd = self._state(motion, s, v, a)
                if t == inf or (np.abs(qdd) > acceleration * (1 + ROUNDING) + 1e-9).any():
                    return False
                for (_, obstacle, part), distance in zip(self.pairs, self.distances(q), strict=True):
                    limb = mine["speeds"].get(part[len(obstacle) + 1 :], mine["speed"])
                    near = distance - limb * (mine["reaction_time"] + t) - float(clearance) / 1e3
                    if obstacle in names and near < -1e-6 and qd.any():
                        return False
        return True
