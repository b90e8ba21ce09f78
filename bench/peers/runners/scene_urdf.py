"""Robot and obstacles as one URDF and one SRDF, for the systems that read nothing else."""

from __future__ import annotations

from itertools import combinations
from math import asin, atan2
from typing import Any
from xml.etree import ElementTree as ET


def scene_urdf(robot: dict[str, Any], problem: dict[str, Any]) -> str:
    """Return the URDF of a robot with the obstacles as links that are fixed to its base."""
    root = ET.parse(robot["urdf"]).getroot()
    for item in problem["obstacles"]:
        add_link(root, item, robot["base"])
    return ET.tostring(root, encoding="unicode")


def add_link(root: ET.Element, item: dict[str, Any], parent: str) -> None:
    """Add an obstacle as a link that is fixed to a parent."""
    link = ET.SubElement(root, "link", name=item["name"])
    geometry = ET.SubElement(ET.SubElement(link, "collision"), "geometry")
    size = item["size"]
    if item["kind"] == "box":
        ET.SubElement(geometry, "box", size=_row(size))
    elif item["kind"] == "cylinder":
        ET.SubElement(geometry, "cylinder", radius=repr(size[0]), length=repr(size[1]))
    else:
        ET.SubElement(geometry, "sphere", radius=repr(size[0]))
    joint = ET.SubElement(root, "joint", name=f"{item['name']}_joint", type="fixed")
    ET.SubElement(joint, "parent", link=parent)
    ET.SubElement(joint, "child", link=item["name"])
    ET.SubElement(joint, "origin", xyz=_row(item["position"]), rpy=_row(_rpy(item["rotation"])))


def scene_srdf(robot: dict[str, Any], problem: dict[str, Any]) -> str:
    """Return the SRDF: obstacles stand among each other, and the fixed base may stand on them."""
    root = ET.parse(robot["srdf"]).getroot()
    names = [item["name"] for item in problem["obstacles"]]
    for one, other in [*combinations(names, 2), *((robot["base"], name) for name in names)]:
        ET.SubElement(root, "disable_collisions", link1=one, link2=other, reason="Never")
    return ET.tostring(root, encoding="unicode")


def _row(values: list[float]) -> str:
    return " ".join(map(repr, values))


def _rpy(R: list[list[float]]) -> list[float]:
    return [atan2(R[2][1], R[2][2]), asin(max(-1.0, min(1.0, -R[2][0]))), atan2(R[1][0], R[0][0])]
