"""Read MuJoCo models (MJCF) as a robot and a scene (needs the extra `mujoco`)."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from safe_ompl.common import FloatArray, InputError, within
from safe_ompl.geometry import (
    Box,
    Capsule,
    Cylinder,
    Obstacle,
    Shape,
    Sphere,
    Triangles,
    triangle_tree,
    turn_onto,
    written_mesh,
)
from safe_ompl.robot import Mimic, Robot
from safe_ompl.scene import Scene

_PLANE, _SPHERE, _CAPSULE, _CYLINDER, _BOX, _MESH = 0, 2, 3, 5, 6, 7  # kinds of geoms
_FREE, _BALL, _SLIDE, _HINGE = range(4)  # kinds of joints
_JOINTS_EQUAL = 2  # of equality constraints
# A plane becomes a box with edges of this length, whose upper side is the plane.
_GROUND = 100.0  # [m]
_STRAIGHT, _X = np.eye(3), np.array([1.0, 0.0, 0.0])


def world_from_mjcf(
    file: str | Path, *, meshes: str | Path | None = None, **options: Any
) -> tuple[Robot | None, Scene]:
    """Read a MuJoCo model as a robot and a scene.

    Bodies that joints move become the robot, with MuJoCo's joint values. Geoms of all other bodies become obstacles;
    bodies on a free joint are placed at their initial pose. Pairs that MuJoCo excludes from collision (contype and
    conaffinity, excludes, parents and children) are excluded here, too. Meshes become their convex hulls, as in MuJoCo;
    planes become boxes with edges of 100 m.

    Parameters
    ----------
    file : path-like
        MJCF, or a URDF that MuJoCo reads.
    meshes : path-like, optional
        Folder to which meshes of the scene are written (.obj).
    **options
        `tip`, `locked`, `limits` and others of `Robot.from_models`.

    Returns
    -------
    robot : Robot or None
        None if no joint moves a body.
    scene : Scene
        The obstacles.

    Raises
    ------
    InputError
        If the model cannot be represented (ball joints, joints below free joints, ellipsoids, height fields, equality
        constraints other than of joints, links that may touch an obstacle with some geoms only). The message names file
        and key.
    """
    try:
        import mujoco
    except ModuleNotFoundError:
        raise ModuleNotFoundError("mujoco is missing: pip install mujoco", name="mujoco") from None
    with within(str(file), ": "):
        try:
            model = mujoco.MjModel.from_xml_path(str(file))
        except ValueError as error:
            raise InputError(f"MuJoCo does not read it ({' '.join(str(error).split())})") from None
        return _World(model, mujoco).read(None if meshes is None else Path(meshes), options)


class _World:
    """A compiled model. For each body, `free` says if it has a free joint, `moving` if joints of the robot move it."""

    def __init__(self, model: Any, mujoco: Any) -> None:
        self.m, self.mujoco = model, mujoco
        data = mujoco.MjData(model)
        mujoco.mj_kinematics(model, data)
        self.places = [pin.SE3(m.reshape(3, 3), x) for m, x in zip(data.geom_xmat, data.geom_xpos, strict=True)]
        weld, root = model.body_weldid, model.body_rootid
        flying = {int(body) for body, kind in zip(model.jnt_bodyid, model.jnt_type, strict=True) if kind == _FREE}
        self.free = [int(root[b]) in flying for b in range(model.nbody)]
        self.moving = [bool(weld[b]) and not self.free[b] for b in range(model.nbody)]
        for k, (body, kind) in enumerate(zip(model.jnt_bodyid, model.jnt_type, strict=True)):
            if kind == _BALL or (self.free[body] and kind != _FREE):
                what = "a ball joint" if kind == _BALL else "below a free joint"
                raise InputError(f"is {what}, which is not supported", f"joint {self.name('joint', k)!r}")
        if model.nflex:
            raise InputError("flexible bodies are not supported", "flex")
        self.pairs = {
            frozenset(pair) for pair in zip(model.pair_geom1.tolist(), model.pair_geom2.tolist(), strict=True)
        }
        self.excluded = {frozenset((int(s) >> 16, int(s) & 0xFFFF)) for s in model.exclude_signature}
        paired = {geom for pair in self.pairs for geom in pair}
        masks = model.geom_contype | model.geom_conaffinity
        self.geoms = [k for k in range(model.ngeom) if masks[k] or k in paired]

    def name(self, kind: str, k: int) -> str:
        return str(getattr(self.m, kind)(k).name or f"{kind}{k}")

    def read(self, folder: Path | None, options: Mapping[str, Any]) -> tuple[Robot | None, Scene]:
        on_robot = [k for k in self.geoms if self.moving[self.m.geom_bodyid[k]]]
        links: dict[str, list[int]] = {}
        for k in on_robot:
            links.setdefault(self.name("body", self.m.geom_bodyid[k]), []).append(k)
        obstacles = []
        for k in self.geoms:
            if k in on_robot:
                continue
            name, touched = self.name("geom", k), []
            with within(f"geom {name!r}"):
                for link, own in links.items():
                    checked = {self.collide(k, other) for other in own}
                    if len(checked) > 1:
                        raise InputError(f"may touch some geoms of {link!r} and not others: give them one contype")
                    touched += [] if checked == {True} else [link]
                shape, within_geom = self.shape(k)
                if isinstance(shape, tuple):
                    shape = written_mesh(folder, f"geom{k}", *(array.tolist() for array in shape))
                obstacles.append(Obstacle(name, shape, self.places[k] * within_geom, touched_by=touched))
        return self.robot(on_robot, options) if any(self.moving) else None, Scene(obstacles)

    def collide(self, a: int, b: int) -> bool:
        """Return whether MuJoCo checks two geoms for contact."""
        m = self.m
        if frozenset((a, b)) in self.pairs:
            return True
        one, other = int(m.geom_bodyid[a]), int(m.geom_bodyid[b])
        welds = int(m.body_weldid[one]), int(m.body_weldid[other])
        parents = [int(m.body_weldid[m.body_parentid[weld]]) for weld in welds]
        filters = not int(m.opt.disableflags) & int(self.mujoco.mjtDisableBit.mjDSBL_FILTERPARENT)
        family = all(welds) and (welds[0] == parents[1] or welds[1] == parents[0])
        if welds[0] == welds[1] or frozenset((one, other)) in self.excluded or (filters and family):
            return False
        return bool(m.geom_contype[a] & m.geom_conaffinity[b] or m.geom_contype[b] & m.geom_conaffinity[a])

    def shape(self, k: int) -> tuple[Shape | Triangles, pin.SE3]:
        """Return a geom's shape, or vertices and faces of its mesh, and the pose of the shape in the geom's frame."""
        m, here = self.m, pin.SE3.Identity()
        kind, (x, y, z) = int(m.geom_type[k]), (float(size) for size in m.geom_size[k])
        if kind == _BOX:
            return Box([2 * x, 2 * y, 2 * z]), here
        if kind == _SPHERE:
            return Sphere(x), here
        if kind in (_CAPSULE, _CYLINDER):
            return Capsule(x, 2 * y) if kind == _CAPSULE else Cylinder(x, 2 * y), here
        if kind == _PLANE and not self.moving[m.geom_bodyid[k]]:
            return Box([_GROUND] * 3), pin.SE3(_STRAIGHT, np.array([0.0, 0.0, -_GROUND / 2]))
        if kind == _MESH:
            mesh = int(m.geom_dataid[k])
            begin, first = m.mesh_vertadr[mesh], m.mesh_faceadr[mesh]
            vertices = np.array(m.mesh_vert[begin : begin + m.mesh_vertnum[mesh]], dtype=np.float64)
            return (vertices, np.array(m.mesh_face[first : first + m.mesh_facenum[mesh]])), here
        name = self.mujoco.mjtGeom(kind).name.removeprefix("mjGEOM_").lower()
        raise InputError(f"must be a sphere, capsule, cylinder, box, mesh or a plane that stands, got {name}", "type")

    def robot(self, geoms: list[int], options: Mapping[str, Any]) -> Robot:
        m, model, bodies = self.m, pin.Model(), pin.GeometryModel()
        model.name = str(m.names.split(b"\0")[0].decode() or "robot")
        # For each body, its joint and its pose in the joint's frame.
        at = {0: (0, pin.SE3.Identity())}
        frames = {0: 0}
        for body in range(1, m.nbody):
            joint, place = at[int(m.body_parentid[body])]
            place, frame = place * _place(m.body_pos[body], m.body_quat[body]), frames[int(m.body_parentid[body])]
            if self.moving[body]:
                first = int(m.body_jntadr[body])
                for k in range(first, first + int(m.body_jntnum[body])):
                    joint, place = self.joint(model, k, joint, place)
                    frame = model.addJointFrame(joint, frame)
                mass = pin.Inertia(float(m.body_mass[body]), np.array(m.body_ipos[body]), np.zeros((3, 3)))
                model.appendBodyToJoint(joint, mass, place)
                frame = model.addBodyFrame(self.name("body", body), joint, place, frame)
            at[body], frames[body] = (joint, place), frame
        for n, k in enumerate(geoms):
            body = int(m.geom_bodyid[k])
            with within(f"geom {self.name('geom', k)!r}"):
                shape, _ = self.shape(k)
            solid = triangle_tree(*shape) if isinstance(shape, tuple) else shape.parts()[0].geometry
            place = at[body][1] * _place(m.geom_pos[k], m.geom_quat[k])
            name = f"{self.name('body', body)}_{n}"
            bodies.addGeometryObject(pin.GeometryObject(name, at[body][0], frames[body], place, solid))
            for other, earlier in enumerate(geoms[:n]):
                if self.collide(k, earlier):
                    bodies.addCollisionPair(pin.CollisionPair(other, n))
        mimics, fixed = self.equalities()
        given = {**options, "locked": {**fixed, **(options.get("locked") or {})}}
        return Robot.from_models(model, bodies, mimics=mimics, **given)

    def joint(self, model: pin.Model, k: int, parent: int, place: pin.SE3) -> tuple[int, pin.SE3]:
        """Add a joint of a body whose pose in the parent's frame is `place`.

        Returns the index of the joint and the pose of the body in the joint's frame.
        """
        m, axis = self.m, np.array(self.m.jnt_axis[k])
        start = float(m.qpos0[m.jnt_qposadr[k]])
        ends = m.jnt_range[k] if m.jnt_limited[k] else (-np.inf, np.inf)
        low, high, most = (np.array([float(value)]) for value in (*ends, np.inf))
        name = self.name("joint", k)
        if m.jnt_type[k] == _SLIDE:
            at, kind = pin.SE3(_STRAIGHT, -start * axis), pin.JointModelPrismaticUnaligned(axis)
            return model.addJoint(parent, kind, place * at, name, most, most, low, high), pin.SE3.Identity()
        anchor = pin.SE3(turn_onto(_X, axis), np.array(m.jnt_pos[k]))
        at = anchor * pin.SE3(pin.AngleAxis(-start, _X).matrix(), np.zeros(3))
        if m.jnt_limited[k]:
            kind = pin.JointModelRX()
        else:
            kind, low, high = pin.JointModelRUBX(), np.full(2, -1.01), np.full(2, 1.01)
        return model.addJoint(parent, kind, place * at, name, most, most, low, high), anchor.inverse()

    def equalities(self) -> tuple[dict[str, Mimic], dict[str, float]]:
        """Return the joints that mimic other joints, and the joints that are fixed, with their values."""
        m, mimics, fixed = self.m, dict[str, Mimic](), dict[str, float]()
        for k in range(m.neq):
            if not m.eq_active0[k]:
                continue
            offset, multiplier, *higher = m.eq_data[k][:5].tolist()
            if m.eq_type[k] != _JOINTS_EQUAL or any(higher):
                raise InputError("must be a linear one of joints", f"equality {self.name('eq', k)!r}")
            one, other = int(m.eq_obj1id[k]), int(m.eq_obj2id[k])
            value = offset + float(m.qpos0[m.jnt_qposadr[one]])
            if other < 0:
                fixed[self.name("joint", one)] = value
            else:
                value -= multiplier * float(m.qpos0[m.jnt_qposadr[other]])
                mimics[self.name("joint", one)] = Mimic(self.name("joint", other), multiplier, value)
        return mimics, fixed


def _place(position: FloatArray, quaternion_wxyz: FloatArray) -> pin.SE3:
    return pin.SE3(pin.Quaternion(*map(float, quaternion_wxyz)).matrix(), np.array(position, dtype=np.float64))
