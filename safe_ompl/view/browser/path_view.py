"""One path in a view: robot, scene and all that is drawn over them, in a place of its own."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pinocchio as pin

from safe_ompl.common import FloatArray
from safe_ompl.geometry import Person
from safe_ompl.io import ACCELERATION, TimedMotion
from safe_ompl.robot import Robot
from safe_ompl.scene import Scene
from safe_ompl.view.browser.layers import ClearanceLines, DangerPoints, FieldSlice, SpeedBoard, wxyz
from safe_ompl.view.content import Keypoints, Movers, Nearest, Proof, ViewerContent
from safe_ompl.view.pictures.scene import DrawnScene
from safe_ompl.view.pictures.surface import (
    ColouredSurface,
    RobotBody,
    Surface,
    limb_surfaces,
    obstacle_surfaces,
    tube,
)
from safe_ompl.view.style import (
    NEUTRAL,
    START_COLOUR,
    Bytes,
    Colour,
    as_bytes,
    cap_colours,
    gap_colours,
    mixed,
    rgb,
)

_DETAIL = 0.002  # [m]; what is smaller is not sent to the browser


class RobotModel:
    """The surfaces of a robot's links, made once for all figures of it; of its skeleton where it has no bodies."""

    def __init__(self, robot: Robot) -> None:
        self.robot = robot
        self._body = RobotBody(robot)
        self.surfaces = [link.simplified(_DETAIL) for link in self._body.links]
        if not self.surfaces:
            lengths = [float(np.linalg.norm(b - a)) for a, b in self._bone_ends(np.zeros(robot.n))]
            ends = [np.array([(0.0, 0.0, 0.0), (0.0, 0.0, length)]) for length in lengths]
            self.surfaces = [Surface.from_triangles(*tube(pair, 0.02 * sum(lengths))) for pair in ends]

    def poses(self, q: FloatArray) -> list[tuple[FloatArray, FloatArray]]:
        """Return quaternion (w, x, y, z) and position of each surface at `q: (n,)`."""
        if self._body.links:
            return [(wxyz(place.rotation), place.translation) for place in self._body.placements(q)]
        up = np.array([0.0, 0.0, 1.0])
        turns = [(pin.Quaternion.FromTwoVectors(up, b - a).matrix(), a) for a, b in self._bone_ends(q)]
        return [(wxyz(turn), place) for turn, place in turns]

    def _bone_ends(self, q: FloatArray) -> FloatArray:
        return np.asarray(self.robot.keypoints_batch(q[None])[0][self.robot.segments])


class RobotFigure:
    """A robot in a view, which can be posed; translucent with an opacity below 1."""

    def __init__(
        self, view: Any, name: str, model: RobotModel, colour: Colour, opacity: float | None = None
    ) -> None:
        self._model = model
        self.root = view.add_frame(name, show_axes=False)
        self._links = [
            view.add_mesh_simple(
                f"{name}/{k}",
                surface.vertices,
                surface.faces,
                color=rgb(colour),
                opacity=opacity,
                cast_shadow=opacity is None,
                receive_shadow=opacity is None,
            )
            for k, surface in enumerate(model.surfaces)
        ]
        self._posed: list[tuple[FloatArray, FloatArray]] = []

    def show(self, visible: bool) -> None:
        """Show or hide the robot."""
        self.root.visible = visible

    def pose(self, q: FloatArray) -> None:
        """Bring the robot to `q: (n,)`; links that stay where they are send nothing."""
        poses = self._model.poses(q)
        for k, (link, (turn, place)) in enumerate(zip(self._links, poses, strict=True)):
            if self._posed and np.allclose(turn, self._posed[k][0]) and np.allclose(place, self._posed[k][1]):
                continue
            link.wxyz, link.position = turn, place
        self._posed = poses


def add_scenery(view: Any, name: str, scene: Scene) -> Any:
    """Add the obstacles of a scene, people in skin and clothes, dangerous things in red; return their common node."""
    marked = any(o.weight == 0 or isinstance(o.shape, Person) for o in scene)
    root = view.add_frame(name, show_axes=False)
    for obstacle in scene:
        _add_meshes(view, f"{name}/{node_name(obstacle.name)}/", obstacle_surfaces(obstacle, marked))
    return root


def _add_meshes(view: Any, name: str, things: Sequence[ColouredSurface]) -> list[Any]:
    """Add surfaces, each as a node whose name ends in its number, and return their nodes."""
    return [
        view.add_mesh_simple(
            f"{name}{k}",
            thing.surface.vertices,
            thing.surface.faces,
            color=rgb(thing.colour),
            side="double",
        )
        for k, thing in enumerate(things)
    ]


def node_name(name: str) -> str:
    """Return a name without the slashes that divide the tree of nodes."""
    return name.replace("/", "_")


class MoverFigures:
    """People and things that move. Limbs keep the length that they have where they are first seen."""

    def __init__(self, view: Any, name: str, movers: Movers, scene: Scene) -> None:
        self._view, self._name, self._movers = view, name, movers
        self.limbs: dict[str, dict[str, list[Any]]] = {}
        self.things = {
            obstacle.name: (obstacle.pose, self._meshes(obstacle.name, obstacle_surfaces(obstacle)))
            for obstacle in scene
            if obstacle.name in movers.objects
        }
        for people in movers.people:
            for person in people:
                if person not in self.limbs:
                    self.limbs[person] = self._figure(person, people[person])
        self.at(0.0)

    def at(self, time: float) -> None:
        """Show where all are at a time [s]."""
        sample = self._movers.sample(time)
        people, places = self._movers.people[sample], self._movers.places[sample]
        for name, limbs in self.limbs.items():
            there = people.get(name)
            if there is not None:
                for limb in Person(self._movers.heights[name], there).limbs():
                    _place(limbs[limb.name], limb.placement)
            for mesh in (mesh for meshes in limbs.values() for mesh in meshes):
                if mesh.visible != (there is not None):
                    mesh.visible = there is not None
        for name, (first, meshes) in self.things.items():
            if name in places:
                _place(meshes, places[name].se3 * first.se3.inverse())

    def _figure(self, person: str, points: Keypoints) -> dict[str, list[Any]]:
        limbs = Person(self._movers.heights[person], points).limbs()
        return {limb.name: self._meshes(f"{person}/{limb.name}", limb_surfaces(limb)) for limb in limbs}

    def _meshes(self, name: str, pieces: Sequence[ColouredSurface]) -> list[Any]:
        return _add_meshes(self._view, f"{self._name}/{node_name(name)}_", pieces)


def _place(meshes: Sequence[Any], placement: pin.SE3) -> None:
    for mesh in meshes:
        mesh.wxyz, mesh.position = wxyz(placement.rotation), placement.translation


SAMPLES = 121
_EVENLY = np.linspace(0.0, 1.0, SAMPLES)
_GOAL_OPACITY, _START_OPACITY = 0.22, 0.16
_TINT = 0.62  # share of the planner's colour in its robot
_AROUND = 0.15  # [m] that a slice reaches beyond the robot's motion and the danger points


class PathView:
    """A path, or with an empty name a standing robot, with its scene; `samples: (SAMPLES, n)` are equally far apart."""

    def __init__(
        self,
        view: Any,
        number: int,
        content: ViewerContent,
        name: str,
        model: RobotModel,
        colour: Colour | None,
    ) -> None:
        self.name, self._view, self._content = name, view, content
        self.node = f"/booth_{number}"
        self.samples = content.along(name, _EVENLY)
        self.motion = content.motions.get(name)
        self.board: SpeedBoard | None = None
        self.movers: MoverFigures | None = None
        if content.movers is not None:
            self.movers = MoverFigures(view, f"{self.node}/movers", content.movers, content.scene)
        self.root = view.add_frame(self.node, show_axes=False)
        self.scenery = add_scenery(view, f"{self.node}/scene", content.still)
        paint = NEUTRAL if colour is None else mixed(NEUTRAL, colour, _TINT)
        self._robot = RobotFigure(view, f"{self.node}/robot", model, paint)
        self.ghosts = [] if colour is None else self._ghosts(model, colour)
        self._add_danger()
        people = [obstacle for obstacle in content.scene if obstacle.weight > 0]
        things = [obstacle for obstacle in content.scene if obstacle.weight == 0]
        nearest = [Nearest(content.robot, group) for group in (people, things)]
        self.lines = ClearanceLines(view, f"{self.node}/clearance", nearest)
        tips = np.asarray(content.robot.keypoints_batch(self.samples)[:, -1])
        self.label: Any = None
        if colour is not None:
            if self.motion is None:
                segments = np.stack([tips[:-1], tips[1:]], axis=1)
                view.add_line_segments(f"{self.node}/trace", segments, rgb(colour), thickness=0.008)
            else:
                add_timed_trace(view, f"{self.node}/trace", self.motion)
            above = self._above()
            self.label = view.add_label(f"{self.node}/name", name, position=above, anchor="bottom-center")
        self.proof: Any = None
        if content.proof is not None:
            dense = content.along(name, np.linspace(0.0, 1.0, 10 * SAMPLES))
            self.proof = add_proof(view, f"{self.node}/proof", content.robot, dense, content.proof)

    def at(self, share: float) -> FloatArray:
        """Return the configuration (n,) at a fraction of the path's length."""
        return np.asarray(self._content.along(self.name, np.array([share]))[0])

    def pose(self, q: FloatArray) -> None:
        """Show the robot at `q: (n,)`, and what depends on it."""
        self._robot.pose(q)
        self.lines.pose(q)
        for layer in (self.points, self.slice):
            if layer is not None:
                layer.pose(q)

    def at_time(self, time: float) -> None:
        """Show what belongs to a time [s] of a motion: how fast the robot is, and where people and things are."""
        if self.board is not None:
            self.board.at(time)
        if self.movers is not None:
            self.movers.at(time)

    def describe(self, q: FloatArray, share: float | None) -> str:
        """Return what there is to say of `q: (n,)` in words, as Markdown."""
        lines = [f"**{self.name or self._content.robot.name}**"]
        field = self._content.danger_field
        if field is not None:
            lines.append(f"danger {field.value(q):.3f}")
        lines += [
            f"{1e3 * found.distance:.0f} mm: {found.link} – {found.obstacle}" for found in self.lines.found(q)
        ]
        if self.motion is not None and share is not None:
            lines.append(self.motion.remark(share * self._content.playing_time))
        if self._content.proof is not None and share is not None:
            lines.append(f"proven: {self._content.proof.at(share)}")
        return "  \n".join(lines)

    def add_board(self, centre: FloatArray, width: float, facing: FloatArray) -> None:
        """Add a board with the speed against time, if the motion has times, see `SpeedBoard`."""
        if self.motion is not None:
            self.board = SpeedBoard(self._view, f"{self.node}/speed", self.motion, centre, width, facing)
            if self.label is not None and self.board.has_title:
                self.label.remove()  # the board says it
                self.label = None

    def add_floor(self, drawn: DrawnScene) -> None:
        """Add the floor of a drawn, and a pedestal where the robot would hang in the air."""
        for thing in drawn.pedestal:
            surface = thing.surface
            self._view.add_mesh_simple(
                f"{self.node}/scene/pedestal", surface.vertices, surface.faces, color=rgb(thing.colour)
            )
        height, size = drawn.floor, drawn.size
        width = 3.0 * size
        self._view.add_grid(
            f"{self.node}/scene/floor",
            width,
            width,
            position=(0.0, 0.0, height - 0.002),
            cell_color=(225, 227, 230),
            section_color=(205, 208, 212),
            cell_size=0.1,
            section_size=0.5,
            fade_distance=4.0 * size,
            fade_from="origin",
            shadow_opacity=0.25,
            plane_color=(250, 250, 250),
            plane_opacity=1.0,
        )

    def _ghosts(self, model: RobotModel, colour: Colour) -> list[RobotFigure]:
        start = RobotFigure(self._view, f"{self.node}/start", model, START_COLOUR, _START_OPACITY)
        goal = RobotFigure(self._view, f"{self.node}/goal", model, colour, _GOAL_OPACITY)
        start.pose(self.samples[0])
        goal.pose(self.samples[-1])
        return [start, goal]

    def _add_danger(self) -> None:
        field = self._content.danger_field
        self.points: DangerPoints | None = None
        self.slice: FieldSlice | None = None
        if field is None or field.points is None:
            return
        names = list(self._content.paths) or [""]
        most = max(float(field.values(self._content.along(name, _EVENLY)).max()) for name in names)
        self.points = DangerPoints(self._view, f"{self.node}/danger", field, most)
        keypoints = self._content.robot.keypoints_batch(self.samples).reshape(-1, 3)
        around = np.vstack([keypoints, field.points])
        low, high = around.min(axis=0) - _AROUND, around.max(axis=0) + _AROUND
        self.slice = FieldSlice(self._view, f"{self.node}/field", field, low, high, most)
        self.slice.show(False)

    def _above(self) -> FloatArray:
        points = self._content.robot.keypoints_batch(self.samples).reshape(-1, 3)
        middle: FloatArray = 0.5 * (points.min(axis=0) + points.max(axis=0))
        middle[2] = points[:, 2].max() + 0.25
        return middle


def add_timed_trace(view: Any, name: str, motion: TimedMotion) -> Any:
    """Add the way of the tip, each piece in the colour of what bounds the speed there."""
    points = np.asarray(motion.robot.keypoints_batch(motion.configurations)[:, -1])
    paints = cap_colours([*motion.bounds, *filter(None, motion.binding)])
    paint = as_bytes(np.array([paints[bound or ACCELERATION] for bound in motion.binding[:-1]]))
    return _add_stripes(view, name, points, paint, 0.014)


def add_proof(view: Any, name: str, robot: Robot, samples: FloatArray, proof: Proof) -> Any:
    """Add the way of the tip along `samples: (S, n)`, in stripes of the intervals, warm where bodies are near."""
    points = np.asarray(robot.keypoints_batch(samples)[:, -1])
    middles = (np.arange(len(samples) - 1) + 0.5) / max(1, len(samples) - 1)
    numbers = np.clip(np.searchsorted(proof.stops, middles, side="right") - 1, 0, len(proof.intervals) - 1)
    gaps = np.array([interval.distance for interval in proof.intervals])[numbers]
    paint = gap_colours(gaps)
    paint = np.where((numbers % 2 == 0)[:, None], paint, (0.72 * paint).astype(np.uint8))
    return _add_stripes(view, name, points, paint, 0.02)


def _add_stripes(view: Any, name: str, points: FloatArray, paint: Bytes, thickness: float) -> Any:
    """Add a line through `points: (P, 3)` [m], whose pieces have the colours `paint: (P - 1, 3)`."""
    segments = np.stack([points[:-1], points[1:]], axis=1)
    return view.add_line_segments(name, segments, np.repeat(paint[:, None], 2, axis=1), thickness=thickness)
