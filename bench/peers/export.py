"""Robot and problems in a form that every system reads: a URDF and an SRDF with plain files, and one JSON a problem."""

from __future__ import annotations

import json
from itertools import combinations
from pathlib import Path
from typing import Any, NamedTuple
from xml.etree import ElementTree as ET

import coal
import numpy as np

from bench._plain import Judge
from safe_ompl import InputError, Robot
from safe_ompl.robot.spec import EXAMPLES, robots_folder
from safe_ompl.scene.mbm import MbmFile, MbmProblem


class Problem(NamedTuple):
    """A problem as systems are asked, and its judge; nobody can solve it if it is blocked: it touches at its ends."""

    robot: Robot
    question: dict[str, Any]
    judge: Judge
    blocked: bool

    @property
    def name(self) -> str:
        """Its family and number."""
        return str(self.question["name"])


def export(file: MbmFile, positions: slice, folder: Path) -> tuple[Path, list[Problem], list[str]]:
    """Write the robot of a MotionBenchMaker file to a folder; return its description and the chosen problems.

    Those with a joint outside its limits at the start or a goal are named apart.

    Meshes are written as their convex hulls and fingers are fixed, so that all systems check the same bodies; the
    SRDF leaves just those pairs of links that are checked here; limits hold the ends of all problems.
    """
    chosen = [file.problem(name, k) for name, count in file.families.items() for k in range(count)[positions]]
    robot = Robot.from_example(file.robot)
    limits = {name: bounds for problem in chosen for name, bounds in problem.widened_limits(robot).items()}
    robot = robot.with_limits(limits)
    description = _write_robot(robot, EXAMPLES[file.robot].locked, folder)
    (folder / "robot.json").write_text(json.dumps(description, indent=1))
    outside = [_name(problem) for problem in chosen if not _within_limits(problem, robot)]
    problems = [_problem(problem, robot) for problem in chosen if _name(problem) not in outside]
    return folder / "robot.json", problems, outside


def _within_limits(problem: MbmProblem, robot: Robot) -> bool:
    try:
        problem.start_configuration(robot), problem.goal_configurations(robot)
    except InputError:
        return False
    return True


def _name(problem: MbmProblem) -> str:
    return f"{problem.family} {problem.index}"


def _problem(problem: MbmProblem, robot: Robot) -> Problem:
    obstacles = []
    for obstacle in problem.scene.obstacles:
        for name, shape, placement in obstacle.geometries():
            kind, size = _size(shape)
            item = {"name": name, "kind": kind, "size": size}
            item |= {"position": placement.translation.tolist(), "rotation": placement.rotation.tolist()}
            obstacles.append(item)
    start, goal = problem.start_configuration(robot), problem.goal_configurations(robot)[0]
    question = {"name": _name(problem), "start": start.tolist(), "goal": goal.tolist(), "obstacles": obstacles}
    judge = Judge(robot, problem.scene)
    return Problem(robot, question, judge, any(judge.plain.touches(q) for q in (start, goal)))


def _size(shape: Any) -> tuple[str, list[float]]:
    if isinstance(shape, coal.Box):
        return "box", (2 * shape.halfSide).tolist()
    if isinstance(shape, coal.Cylinder):
        return "cylinder", [shape.radius, 2 * shape.halfLength]
    if isinstance(shape, coal.Sphere):
        return "sphere", [shape.radius]
    raise TypeError(f"systems do not read obstacles of the shape {type(shape).__name__}")


def _write_robot(robot: Robot, locked: dict[str, float], folder: Path) -> dict[str, Any]:
    source = robots_folder() / EXAMPLES[robot.name].urdf
    tree = ET.parse(source)
    root = tree.getroot()
    for element in root:
        if element.tag in ("transmission", "gazebo"):
            root.remove(element)
    links = {link.get("name"): link for link in root.iter("link")}
    _write_hulls(robot, links, folder)
    for joint in root.iter("joint"):
        name = joint.get("name")
        if name in locked:
            _fix(joint, locked[name])
        elif name in robot.joint_names:
            k = robot.joint_names.index(name)
            limit = joint.find("limit")
            limit.set("lower", repr(float(robot.lower[k])))
            limit.set("upper", repr(float(robot.upper[k])))
    for link in links.values():
        for visual in link.findall("visual"):
            link.remove(visual)
    tree.write(folder / "robot.urdf")
    _write_srdf(robot, links, folder)
    model = robot.model
    moving = {model.frames[body.parentFrame].name for body in robot.collision_model.geometryObjects if body.parentJoint}
    return {
        "name": robot.name,
        "urdf": str(folder / "robot.urdf"),
        "srdf": str(folder / "robot.srdf"),
        "joints": list(robot.joint_names),
        "lower": robot.lower.tolist(),
        "upper": robot.upper.tolist(),
        "base": root.find("joint/parent").get("link"),
        "tip": EXAMPLES[robot.name].tip,
        "moving_links": sorted(moving),
    }


def _write_hulls(robot: Robot, links: dict[str | None, ET.Element], folder: Path) -> None:
    """Replace every mesh of the links by its convex hull, in a file of its own."""
    hulls = [body for body in robot.collision_model.geometryObjects if isinstance(body.geometry, coal.ConvexBase)]
    for body in hulls:
        link = links[robot.model.frames[body.parentFrame].name]
        mesh = next(m for m in link.iter("mesh") if Path(m.get("filename", "")).name == Path(body.meshPath).name)
        file = folder / f"{body.name}.stl"
        _write_stl(file, body.geometry)
        for element in link.findall("collision"):
            found = element.find("geometry/mesh")
            if found is mesh or (found is not None and found.get("filename") == mesh.get("filename")):
                found.set("filename", str(file))
                found.attrib.pop("scale", None)


def _write_stl(file: Path, hull: coal.ConvexBase) -> None:
    points = np.array([hull.point(k) for k in range(hull.num_points)])
    triangles = np.array([[hull.polygons(k)[i] for i in range(3)] for k in range(hull.num_polygons)])
    corners = points[triangles]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    outwards = ((corners.mean(axis=1) - points.mean(axis=0)) * normals).sum(axis=1) > 0
    corners[~outwards] = corners[~outwards][:, ::-1]
    record = np.zeros(len(corners), dtype=[("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
    record["corners"] = corners
    with file.open("wb") as stream:
        stream.write(bytes(80) + np.uint32(len(corners)).tobytes() + record.tobytes())


def _fix(joint: ET.Element, value: float) -> None:
    """Make a joint that slides a fixed one, held at a value [m]."""
    axis = np.array([float(x) for x in joint.find("axis").get("xyz").split()])
    origin = joint.find("origin")
    if origin is None:
        origin = ET.SubElement(joint, "origin", xyz="0 0 0", rpy="0 0 0")
    place = np.array([float(x) for x in origin.get("xyz", "0 0 0").split()])
    if origin.get("rpy", "0 0 0").split() not in (["0", "0", "0"], ["0.0", "0.0", "0.0"]):
        from pinocchio.rpy import rpyToMatrix

        axis = rpyToMatrix(*(float(x) for x in origin.get("rpy").split())) @ axis
    origin.set("xyz", " ".join(repr(float(x)) for x in place + value * axis))
    joint.set("type", "fixed")
    for tag in ("axis", "limit", "mimic", "dynamics", "safety_controller"):
        for element in joint.findall(tag):
            joint.remove(element)


def _write_srdf(robot: Robot, links: dict[str | None, ET.Element], folder: Path) -> None:
    model = robot.collision_model
    bodies = model.geometryObjects

    def link(k: int) -> str:
        return str(robot.model.frames[bodies[k].parentFrame].name)

    checked = {frozenset((link(pair.first), link(pair.second))) for pair in model.collisionPairs}
    root = ET.Element("robot", name=robot.name)
    group = ET.SubElement(root, "group", name="arm")
    for name in robot.joint_names:
        ET.SubElement(group, "joint", name=name)
    for one, other in combinations(sorted(str(name) for name in links), 2):
        if frozenset((one, other)) not in checked:
            ET.SubElement(root, "disable_collisions", link1=one, link2=other, reason="Never")
    ET.ElementTree(root).write(folder / "robot.srdf")
