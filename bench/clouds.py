"""Clouds: what a point cloud costs, in time and memory: python bench/clouds.py [--points 1000 10000 100000].

A table and a wall as a depth camera sees them, with a share of NaN, around a Panda. Prints for each number of points
the CPU seconds to make the cloud, the setup, a short path's proof, clearance, certificate and verification, and the
megabytes that the setup adds to those of the imports. Bars: clearance 0.3 s; at 100 000 points setup 1 s and 300 MB,
certificate and verification 3 s.
"""

from __future__ import annotations

import argparse
import logging
import multiprocessing
from time import process_time

import numpy as np
from _timing import print_table

from safe_ompl import PathReport, Robot, SafeSetup, Scene, certificate, verify
from safe_ompl.apps.benchmark.measures import resident_megabytes
from safe_ompl.common import FloatArray
from safe_ompl.geometry.cloud import PointCloud
from safe_ompl.geometry.obstacle import Obstacle

NOISE, MISSING = 0.002, 0.05  # [m] of a depth camera, and the share of its pixels that see nothing
PATH = [[0.0, -0.5, 0.0, -2.2, 0.0, 1.8, 0.8], [0.4, -0.4, 0.1, -2.0, 0.1, 1.9, 0.6]]


def camera_cloud(count: int) -> FloatArray:
    """Return a table before the robot and a wall behind it, shape (count, 3), some of it NaN."""
    rng = np.random.default_rng(0)
    half = count // 2
    x, y, z = rng.uniform(0.45, 1.3, count), rng.uniform(-0.8, 0.8, count), rng.normal(-0.1, NOISE, count)
    x[half:], z[half:] = rng.normal(1.3, NOISE, count - half), rng.uniform(-0.1, 1.0, count - half)
    points = np.column_stack([x, y, z])
    points[rng.random(count) < MISSING] = np.nan
    return points


def measured(job: tuple[int, float, float]) -> tuple[object, ...]:
    """Return the row of the table for a number of points, a radius and a danger weight."""
    count, radius, weight = job
    logging.disable(logging.WARNING)
    robot, points = Robot.from_example("panda"), camera_cloud(count)
    SafeSetup(robot, Scene(), danger=None)  # what is made once
    before, times = resident_megabytes(), [process_time()]
    scene = Scene((Obstacle("scan", PointCloud(radius, points=points), weight=weight),))
    times.append(process_time())
    setup = SafeSetup(robot, scene) if weight else SafeSetup(robot, scene, danger=None)
    times.append(process_time())
    added = resident_megabytes() - before
    report = PathReport.of(PATH, setup.checker)
    times.append(process_time())
    report.clearance  # noqa: B018
    times.append(process_time())
    content = certificate(PATH, robot, scene, field=setup.field if weight else None)
    times.append(process_time())
    verify(content, robot, scene)
    times.append(process_time())
    return (f"{count} points, {radius:g} m", weight, *np.diff(times).tolist(), added)


def main() -> None:
    """Run the bench."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--points", type=int, nargs="+", default=[1000, 10_000, 100_000])
    parser.add_argument("--radius", type=float, default=0.01)
    options = parser.parse_args()
    jobs = [(count, options.radius, weight) for count in options.points for weight in (0.0, 1.0)]
    with multiprocessing.get_context("spawn").Pool(1, maxtasksperchild=1) as pool:
        rows = [pool.apply(measured, (job,)) for job in jobs]
    steps = [f"{step} [s]" for step in ("cloud", "setup", "proof", "clearance", "certificate", "verify")]
    print_table(("cloud", "weight", *steps, "MB"), rows)


if __name__ == "__main__":
    main()
