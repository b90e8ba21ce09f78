"""A path in the viewer: robot and scene, with danger points, distances, speed and labels."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from typing import Any

import numpy as np
import pinocchio as pin

from safe_ompl.collision import Clearance, CollisionChecker
from safe_ompl.common import FloatArray, SafeOmplError
from safe_ompl.danger import DangerField
from safe_ompl.drawing.content import Movers, ViewerContent
from safe_ompl.drawing.drawn_scene import DrawnScene
from safe_ompl.drawing.plots import AXES, SIZE, plot_speeds
from safe_ompl.drawing.style import NEUTRAL, START_COLOUR, Colour, as_bytes, cap_colours, level_colours, mixed, rgb
from safe_ompl.drawing.surfaces import ColouredSurface, RobotBody, limb_surfaces, obstacle_surfaces, scene_surfaces
from safe_ompl.geometry import Person
from safe_ompl.io import ACCELERATION, MotionRecord
from safe_ompl.robot import Robot
from safe_ompl.scene import Scene

# At most this many danger points are shown, evenly chosen.
_MOST_POINTS = 4000
_PEOPLE, _THINGS = (0.80, 0.10, 0.12), (0.10, 0.35, 0.75)


class ColouredDangerPoints:
    """The danger points, coloured by their danger w·CDF(p) up to `most`. The most dangerous point has a label."""

    def __init__(self, view: Any, name: str, field: DangerField, most: float) -> None:
        self._field, self._most = field, most
        count = min(len(field.points), _MOST_POINTS)
        self._shown = np.unique(np.linspace(0, len(field.points) - 1, count).astype(int))
        points = np.array(field.points)[self._shown]
        colours = level_colours(np.zeros(len(points)), most)
        self._cloud = view.add_point_cloud(name, points, colours, point_size=0.014, point_shape="circle")
        self._label = view.add_label(f"{name}/most", "", anchor="bottom-left", font_screen_scale=0.9)

    def pose(self, q: FloatArray) -> None:
        """Show the danger at `q: (n,)`."""
        levels = self._field.field(q, self._field.points)
        if self._field.weights is not None:
            levels = levels * self._field.weights
        most = int(levels.argmax())
        self._cloud.colors = level_colours(levels[self._shown], self._most)
        self._label.text = f"danger {levels[most]:.2f}"
        self._label.position = np.array(self._field.points)[most]


class ClearanceLines:
    """Lines from the robot to the nearest dangerous obstacle, such as a person, and to the nearest other obstacle."""

    def __init__(self, view: Any, name: str, robot: Robot, scene: Scene) -> None:
        self._checkers = [
            CollisionChecker(robot, Scene([o for o in scene if (o.weight > 0) is dangerous]))
            for dangerous in (True, False)
        ]
        self._lines, self._labels = [], []
        for k, colour in enumerate((_PEOPLE, _THINGS)):
            nothing = np.zeros((1, 2, 3))
            self._lines.append(view.add_line_segments(f"{name}/{k}", nothing, rgb(colour), thickness=0.01))
            place = {"anchor": "center-left", "font_screen_scale": 0.8}
            self._labels.append(view.add_label(f"{name}/{k}/length", "", **place))

    def found(self, q: FloatArray) -> list[Clearance]:
        """Return the clearances at `q: (n,)` from dangerous and from other obstacles, if there are any."""
        every = (checker.clearance(q) for checker in self._checkers)
        return [clearance for clearance in every if clearance.obstacle is not None]

    def pose(self, q: FloatArray) -> None:
        """Show the smallest distances at `q: (n,)`."""
        for checker, line, label in zip(self._checkers, self._lines, self._labels, strict=True):
            found = checker.clearance(q)
            line.visible = label.visible = found.points is not None
            if found.points is not None:
                line.points = found.points[None].astype(np.float32)
                label.text = f"{1e3 * found.distance:.0f} mm to {found.obstacle}"
                label.position = found.points.mean(axis=0)


def wxyz(rotation: FloatArray) -> FloatArray:
    """Return the quaternion (w, x, y, z) of a rotation matrix (3, 3)."""
    return np.roll(pin.Quaternion(rotation).coeffs(), 1)


BOARD_SHAPE = SIZE[1] / SIZE[0]
"""Height over width."""
_DPI = 140
# Lines of words above the board, and the height of a line in heights of the board.
_LINES, _LINE_HEIGHT = 2, 0.15
# The cursor is in front of the board by this.
_BEFORE = 0.004  # [m]
_CURSOR = (30, 30, 30)

_log = logging.getLogger(__name__)


class SpeedBoard:
    """The speed of a motion against time, as a picture in the scene, `width` [m] wide, that faces a direction.

    Without Matplotlib only a line of text with the speed is shown, without a title.
    """

    def __init__(
        self, view: Any, name: str, record: MotionRecord, centre: FloatArray, width: float, facing: FloatArray
    ) -> None:
        self._record = record
        normal = facing / np.linalg.norm(facing)
        up = np.array([0.0, 0.0, 1.0])
        self._right, self._up = np.cross(up, normal), up
        self._size = np.array([width, width * BOARD_SHAPE])
        self._corner = centre - 0.5 * (self._size[0] * self._right + self._size[1] * up) + _BEFORE * normal
        image = _picture(record)
        self.has_title = image is not None
        if image is not None:
            # In viser the y axis of an image goes down.
            turn = np.column_stack([self._right, -up, -normal])
            look = {"format": "png", "cast_shadow": False, "receive_shadow": False}
            view.add_image(name, image, *self._size.tolist(), **look, wxyz=wxyz(turn), position=centre)
        cursor = np.zeros((1, 2, 3))
        self.cursor = view.add_line_segments(f"{name}_cursor", cursor, _CURSOR, thickness=0.006 * width)
        self.labels = [
            view.add_label(f"{name}_told_{k}", "", anchor="bottom-center", font_screen_scale=0.9) for k in range(_LINES)
        ]
        self.at(0.0)

    def at(self, time: float) -> None:
        """Show the speed at a time [s]."""
        left, bottom, width, height = AXES
        share = left + width * min(time / self._record.motion.duration, 1.0)
        ends = np.array([self._place(share, bottom), self._place(share, bottom + height)])
        self.cursor.points = ends[None].astype(np.float32)
        lines = self._record.remark(time).split("; ", _LINES - 1)
        for k, label in enumerate(self.labels):
            label.text = lines[k] if k < len(lines) else ""
            label.visible = k < len(lines)
            label.position = self._place(0.5, 1.04 + _LINE_HEIGHT * (len(lines) - 1 - k))

    def _place(self, across: float, above: float) -> FloatArray:
        right, up = across * self._size[0] * self._right, above * self._size[1] * self._up
        return np.asarray(self._corner + right + up)


def _picture(record: MotionRecord) -> Any:
    try:
        known = record.motion.times, record.speeds, record.bounds, record.binding
        figure = plot_speeds(*known, None, title=record.name, dpi=_DPI)
    except SafeOmplError as missing:
        _log.warning("no board with the speed: %s", missing)
        return None
    return np.asarray(figure.canvas.buffer_rgba())[..., :3]


# Details smaller than this are not sent to the browser.
_DETAIL = 0.002  # [m]


class RobotFigure:
    """A robot in the viewer at a configuration; translucent if the opacity is below 1."""

    def __init__(self, view: Any, name: str, body: RobotBody, colour: Colour, opacity: float | None = None) -> None:
        self._body = body
        shadows = {"cast_shadow": opacity is None, "receive_shadow": opacity is None}
        look = {"color": rgb(colour), "opacity": opacity, **shadows}
        view.add_frame(name, show_axes=False)
        self._links = [
            view.add_mesh_simple(f"{name}/{k}", link.vertices, link.faces, **look)
            for k, link in enumerate(surface.simplified(_DETAIL) for surface in body.links)
        ]
        self._posed: list[pin.SE3] = []

    def pose(self, q: FloatArray) -> None:
        """Move the robot to `q: (n,)`. Only links whose pose changes send data."""
        places = self._body.placements(q)
        for k, (link, place) in enumerate(zip(self._links, places, strict=True)):
            if not self._posed or not place.isApprox(self._posed[k], 1e-8):
                _place([link], place)
        self._posed = places


def _add_meshes(view: Any, name: str, things: Sequence[ColouredSurface]) -> list[Any]:
    """Add surfaces, each as a node whose name ends in its number, and return their nodes."""
    return [
        view.add_mesh_simple(
            f"{name}{k}", thing.surface.vertices, thing.surface.faces, color=rgb(thing.colour), side="double"
        )
        for k, thing in enumerate(things)
    ]


def node_name(name: str) -> str:
    """Return a name without the slashes that divide the tree of nodes."""
    return name.replace("/", "_")


class MoverFigures:
    """Moving people and objects. Limbs keep the lengths of their first positions."""

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
                    limbs = Person(movers.heights[person], people[person]).limbs()
                    self.limbs[person] = {
                        limb.name: self._meshes(f"{person}/{limb.name}", limb_surfaces(limb)) for limb in limbs
                    }
        self.at(0.0)

    def at(self, time: float) -> None:
        """Show the positions of all at a time [s]."""
        sample = self._movers.sample(time)
        people, places = self._movers.people[sample], self._movers.places_at(time)
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

    def _meshes(self, name: str, pieces: Sequence[ColouredSurface]) -> list[Any]:
        return _add_meshes(self._view, f"{self._name}/{node_name(name)}_", pieces)


def _place(meshes: Sequence[Any], placement: pin.SE3) -> None:
    for mesh in meshes:
        mesh.wxyz, mesh.position = wxyz(placement.rotation), placement.translation


SAMPLES = 121
_EVENLY = np.linspace(0.0, 1.0, SAMPLES)
_GOAL_OPACITY, _START_OPACITY = 0.22, 0.16
# The share of the planner's colour in its robot.
_TINT = 0.62


class PathView:
    """A path with its scene, or a standing robot if the name is empty. `samples: (SAMPLES, n)` are equally spaced."""

    def __init__(
        self, view: Any, number: int, content: ViewerContent, name: str, body: RobotBody, colour: Colour | None
    ) -> None:
        self.name, self._view, self._content = name, view, content
        self.node = node = f"/path_{number + 1}"
        self.samples = content.along(name, _EVENLY)
        self.record = content.motions.get(name)
        self.board: SpeedBoard | None = None
        self.movers: MoverFigures | None = None
        if content.movers is not None:
            self.movers = MoverFigures(view, f"{node}/movers", content.movers, content.scene)
        self.root = view.add_frame(node, show_axes=False)
        view.add_frame(f"{node}/scene", show_axes=False)
        for obstacle, surfaces in scene_surfaces(content.still)[0].items():
            _add_meshes(view, f"{node}/scene/{node_name(obstacle)}/", surfaces)
        paint = NEUTRAL if colour is None else mixed(NEUTRAL, colour, _TINT)
        self._robot = RobotFigure(view, f"{node}/robot", body, paint)
        self.lines = ClearanceLines(view, f"{node}/clearance", content.robot, content.still)
        self._layers: list[RobotFigure | ClearanceLines | ColouredDangerPoints] = [self._robot, self.lines]
        if (field := content.danger_field) is not None:
            ways = [self.samples, *(content.along(other, _EVENLY) for other in content.paths)]
            most = float(field.values(np.vstack(ways)).max())
            self._layers.append(ColouredDangerPoints(view, f"{node}/danger", field, most))
        self.label: Any = None
        if colour is not None:
            self._add_way(body, colour)

    def at(self, share: float) -> FloatArray:
        """Return the configuration (n,) at a fraction of the path's length."""
        return np.asarray(self._content.along(self.name, np.array([share]))[0])

    def pose(self, q: FloatArray) -> None:
        """Show the robot, its danger and its distances at `q: (n,)`."""
        for layer in self._layers:
            layer.pose(q)

    def at_time(self, time: float) -> None:
        """Show the speed of the robot, and the positions of people and objects, at a time [s] of a motion."""
        for layer in (self.board, self.movers):
            if layer is not None:
                layer.at(time)

    def describe(self, q: FloatArray, share: float | None) -> str:
        """Describe `q: (n,)` as Markdown."""
        lines = [f"**{self.name or self._content.robot.name}**", *self._content.facts(self.name)]
        field = self._content.danger_field
        if field is not None:
            lines.append(f"danger here: {field.value(q):.2f}")
        lines += [f"{1e3 * found.distance:.0f} mm: {found.link} – {found.obstacle}" for found in self.lines.found(q)]
        if self.record is not None and share is not None:
            lines.append(self.record.remark(share * self._content.playing_time))
        return "  \n".join(lines)

    def add_board(self, centre: FloatArray, width: float, facing: FloatArray) -> None:
        """Add a board with the speed against time, if the motion has times, see `SpeedBoard`."""
        if self.record is not None:
            self.board = SpeedBoard(self._view, f"{self.node}/speed", self.record, centre, width, facing)
            if self.label is not None and self.board.has_title:
                self.label.remove()  # the board says it
                self.label = None

    def add_floor(self, drawn: DrawnScene) -> None:
        """Add the floor of a drawn scene, and a pedestal if the robot stands above the floor."""
        _add_meshes(self._view, f"{self.node}/scene/pedestal", drawn.pedestal)
        self._view.add_grid(
            f"{self.node}/scene/floor",
            3.0 * drawn.size,
            3.0 * drawn.size,
            position=(0.0, 0.0, drawn.floor - 0.002),
            cell_color=(225, 227, 230),
            section_color=(205, 208, 212),
            cell_size=0.1,
            section_size=0.5,
            fade_distance=4.0 * drawn.size,
            fade_from="origin",
            shadow_opacity=0.25,
            plane_color=(250, 250, 250),
            plane_opacity=1.0,
        )

    def _add_way(self, body: RobotBody, colour: Colour) -> None:
        """Add start, goal, tip path and name of a path."""
        for name, shown, opacity, q in (
            ("start", START_COLOUR, _START_OPACITY, self.samples[0]),
            ("goal", colour, _GOAL_OPACITY, self.samples[-1]),
        ):
            RobotFigure(self._view, f"{self.node}/{name}", body, shown, opacity).pose(q)
        robot, record, thick = self._content.robot, self.record, 0.008
        paint: Any = rgb(colour)
        keypoints = robot.keypoints_batch(self.samples)
        tips = keypoints[:, -1]
        # Each piece has the colour of the limit that is active there.
        if record is not None:
            tips, thick = robot.keypoints_batch(record.motion.knots)[:, -1], 0.014
            paints = cap_colours([*record.bounds, *filter(None, record.binding)])
            pieces = as_bytes(np.array([paints[bound or ACCELERATION] for bound in record.binding[:-1]]))
            paint = np.repeat(pieces[:, None], 2, axis=1)
        segments = np.stack([tips[:-1], tips[1:]], axis=1)
        self._view.add_line_segments(f"{self.node}/trace", segments, paint, thickness=thick)
        low, high = keypoints.min(axis=(0, 1)), keypoints.max(axis=(0, 1))
        above = np.append(0.5 * (low + high)[:2], high[2] + 0.25)
        place = {"position": above, "anchor": "bottom-center"}
        self.label = self._view.add_label(f"{self.node}/name", self.name, **place)
