"""Lower bounds of distances by convex hulls: they prove most free motions without asking coal."""

from __future__ import annotations

import coal
import numpy as np
import pinocchio as pin

from safe_ompl.arrays import FloatArray, IntArray
from safe_ompl.maths.kernels.edge_bounds import Chain
from safe_ompl.maths.kernels.support import Bodies, extreme_vertices
from safe_ompl.robot.bodies.reach import JointChain, bounding_hull


def convex_body(geometry):
    box, disc, ball, vertices = np.zeros(3), 0.0, float(geometry.getSweptSphereRadius()) if isinstance(geometry, coal.ShapeBase) else 0.0, np.zeros((1, 3))
    if isinstance(geometry, coal.Box):
        box = np.array(geometry.halfSide, dtype=np.float64).ravel()
    elif isinstance(geometry, coal.Sphere):
        ball += geometry.radius
    elif isinstance(geometry, coal.Capsule):
        box, ball = np.array([0.0, 0.0, geometry.halfLength]), ball + geometry.radius
    elif isinstance(geometry, coal.Cylinder):
        box, disc = np.array([0.0, 0.0, geometry.halfLength]), geometry.radius
    else:
        vertices = bounding_hull(geometry).points
    return vertices, box, disc, ball
GRID = lambda V: 0 if V <= 12 else 4 if V < 100 else 8 if V < 1000 else 12

def make(objects):
    G = len(objects)
    f = dict(joints=np.zeros(G, np.intp), rotations=np.zeros((G,3,3)), translations=np.zeros((G,3)), centres=np.zeros((G,3)), reaches=np.zeros(G), extents=np.zeros((G,3)), boxes=np.zeros((G,3)), discs=np.zeros(G), balls=np.zeros(G), grids=np.zeros(G,np.intp), first_cells=np.zeros(G,np.intp))
    starts=[np.zeros(1,np.intp)]; verts=[]; cells=0; number=0
    for g,o in enumerate(objects):
        v,box,disc,ball = convex_body(o.geometry)
        f['joints'][g]=o.parentJoint; f['rotations'][g]=o.placement.rotation; f['translations'][g]=o.placement.translation
        lo,hi = v.min(0),v.max(0)
        c=(lo+hi)/2; f['centres'][g]=c
        side = box+ball+np.array([disc,disc,0.])
        f['extents'][g]=(hi-lo)/2+side
        if len(v)==1:
            f['reaches'][g]=np.hypot(np.hypot(np.hypot(box[0],box[1])+disc,0),box[2])+ball
        else:
            f['reaches'][g]=np.linalg.norm(v-c,axis=1).max()+np.linalg.norm(box)+disc+ball
        f['boxes'][g]=box; f['discs'][g]=disc; f['balls'][g]=ball
        grid=GRID(len(v)); f['grids'][g]=grid; f['first_cells'][g]=cells
        if grid:
            s,i=extreme_vertices(np.ascontiguousarray(v),grid)
        else:
            s,i=np.array([0,len(v)]),np.arange(len(v))
        starts.append(s[1:]+number); verts.append(v[i]); cells+=len(s)-1; number+=len(i)
    return Bodies(**f, starts=np.concatenate(starts), vertices=np.concatenate(verts))

def chain_of(c: JointChain):
    return Chain(np.array(c.parents,np.intp), np.array([p.rotation for p in c.placements]), np.array([p.translation for p in c.placements]), c.axes, c.prismatic)
