"""Which robots work: python bench/robots.py FOLDER … [--markdown] [--pairs N] [--time SECONDS] [--package-dir DIR …].

Every URDF below the folders is loaded twice (the second time with what the first has left in the cache), each in a
process of its own, so that one that crashes or hangs is a line of the table and not its end (a dash: no time to ask).
The joints that move the default tip are planned for; the others are held. Beside the arm stands a box; between random
free configurations every planner is run, and each path gets a certificate, which is verified. Robots with visual
shapes only are taken with these. Prints the table; `--out` writes FILE.md and FILE.json, too.
"""

from __future__ import annotations

import argparse
import json
import logging
import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np

from safe_ompl.arrays import FloatArray
from safe_ompl.collision.checker import CollisionChecker
from safe_ompl.errors import CertificateError, InputError, PlanningError, SafeOmplError
from safe_ompl.paths.certificate.issue import certificate
from safe_ompl.paths.certificate.verify import verify
from safe_ompl.robot.bodies.cache import VARIABLE
from safe_ompl.robot.description.urdf import UrdfFile
from safe_ompl.robot.joints.arm import default_tip
from safe_ompl.robot.robot import Robot
from safe_ompl.scene.obstacle import Obstacle
from safe_ompl.scene.pose import Pose
from safe_ompl.scene.scene import Scene
from safe_ompl.scene.shapes.basic import Box
from safe_ompl.setup.safe_setup import SafeSetup

PLANNERS = ("SafeRRTConnect", "SafePRM", "BubblePlanner", "RRTConnect")
TRIES = 2000  # for a free configuration

Record = dict[str, Any]


def main() -> None:
    """Ask each robot in a process of its own, and write the table."""
    options = _options()
    if options.one:
        for record in examine(options.one, options):
            print(json.dumps(record), flush=True)
        return
    files = sorted({file for place in options.places for file in _urdfs(Path(place).resolve())})
    with tempfile.TemporaryDirectory() as kept, ThreadPoolExecutor(options.jobs) as pool:
        records = []
        for record in pool.map(lambda file: _in_a_process(file, kept, options.patience), files):
            records.append(record)
            print(_row(record), file=sys.stderr, flush=True)
    if options.out:
        Path(f"{options.out}.json").write_text(json.dumps(records, indent=1) + "\n", encoding="utf-8")
        Path(f"{options.out}.md").write_text("\n".join(_table(records)) + "\n", encoding="utf-8")
    if options.markdown:
        print("\n".join(_table(records)))


def _urdfs(place: Path) -> Iterator[Path]:
    yield from place.rglob("*.urdf") if place.is_dir() else [place]


def _options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("places", nargs="*", metavar="FOLDER", help="or URDF")
    parser.add_argument("--markdown", action="store_true", help="print the table, as docs/robots.md has it")
    parser.add_argument("--out", metavar="FILE", help="without ending")
    parser.add_argument("--pairs", type=int, default=2, help="of start and goal (default: %(default)s)")
    parser.add_argument("--time", type=float, default=2.0, help="of each planner [s] (default: %(default)s)")
    parser.add_argument("--package-dir", action="append", default=[], metavar="DIR")
    parser.add_argument("--jobs", type=int, default=1, help="robots at a time (default: %(default)s)")
    parser.add_argument(
        "--patience", type=float, default=180.0, help="with a robot [s] (default: %(default)s)"
    )
    parser.add_argument("--one", type=Path, help=argparse.SUPPRESS)
    return parser.parse_args()


def _in_a_process(file: Path, kept: str, patience: float) -> Record:
    """Return the last that the process says of a robot; how it ended, if that was not well."""
    command = [sys.executable, __file__, "--one", str(file), *sys.argv[1:]]
    process = subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env={**os.environ, VARIABLE: kept}
    )
    try:
        out, errors = process.communicate(timeout=patience)
        ending = (
            {} if process.returncode == 0 else {"error": (errors.strip() or "it crashed").splitlines()[-1]}
        )
    except subprocess.TimeoutExpired:
        process.kill()
        out, _ = process.communicate()
        ending = {"cut": True} if out.strip() else {"error": f"not loaded within {patience:g} s"}
    records = [json.loads(line) for line in out.splitlines() if line.startswith("{")]
    return {"robot": _label(file), **(records[-1] if records else {}), **ending}


def _label(file: Path) -> str:
    """Return the file's name, with its folder where that says more."""
    return file.name if file.stem != "model" else f"{file.parent.name}/{file.name}"


# ------------------------------------------------------------------------------------------------- one robot


def examine(file: Path, options: argparse.Namespace) -> Iterator[Record]:
    """Yield what there is to say about a robot, more each time: once it is loaded, and after each planner."""
    logging.getLogger("safe_ompl").setLevel(logging.ERROR)
    record: Record = {"robot": _label(file)}
    folders = [Path(place).resolve() for place in (*options.package_dir, *options.places)]
    folders = [folder for folder in folders if folder.is_dir()]
    try:
        robot, record["collision"], record["first"] = _load(file, folders)
    except SafeOmplError as error:
        line = " ".join(str(error).split())
        yield {**record, "error": line.replace(f"{file.resolve()}: ", "").replace(f"{file.parent}/", "")}
        return
    record["second"] = _load(file, folders)[2]
    record.update(joints=robot.n, tip=robot.tip, unchecked=list(robot.links_without_collision))
    record.update(pairs=0, solved={}, paths=0, verified=0)
    yield record
    scene = _box_beside(robot)
    free = list(_free_configurations(robot, scene, 2 * options.pairs))
    pairs = list(zip(free[::2], free[1::2], strict=False))
    record["pairs"] = len(pairs)
    for planner in PLANNERS:
        paths = [
            path for pair in pairs if (path := _plan(robot, scene, planner, *pair, options.time)) is not None
        ]
        record["verified"] += sum(_verifies(path, robot, scene) for path in paths)
        record["solved"][planner] = len(paths)
        record["paths"] += len(paths)
        yield record


def _load(file: Path, folders: list[Path]) -> tuple[Robot, str, float]:
    """Return the robot, what collides, and the time it took [s]."""
    model = UrdfFile(file).build_model()
    tip = default_tip(model, model)
    for collision in ("required", "visual"):
        start = perf_counter()
        try:
            robot = Robot.from_urdf(file, package_dirs=folders, tip=tip, collision=collision)
            return robot, collision, perf_counter() - start
        except InputError as error:
            if "collision='visual'" not in str(error):
                raise
    raise AssertionError("visual shapes ask for no visual shapes")


def _box_beside(robot: Robot) -> Scene:
    """Return a box at two thirds of the arm's reach, to its side."""
    points = robot.keypoints((robot.lower + robot.upper) / 2)
    reach = float(np.linalg.norm(np.diff(points[robot.segments], axis=1)[:, 0], axis=1).sum())
    center = points[robot.segments[:1, 0]].sum(axis=0) + 0.66 * reach * np.array([0.5, 0.8, 0.3])
    size = max(0.1 * reach, 0.01)
    return Scene((Obstacle("box", Box((size, size, 2 * size)), Pose(tuple(center.tolist())), weight=1.0),))


def _free_configurations(robot: Robot, scene: Scene, count: int) -> Iterator[FloatArray]:
    rng, checker = np.random.default_rng(0), CollisionChecker(robot, scene)
    for _ in range(TRIES):
        q = rng.uniform(robot.lower, robot.upper)
        if not checker.in_collision(q):
            yield q
            count -= 1
            if not count:
                return


def _plan(
    robot: Robot, scene: Scene, planner: str, start: FloatArray, goal: FloatArray, time: float
) -> FloatArray | None:
    setup = SafeSetup(robot, scene, danger={} if len(robot.segments) else None)  # None: it has no links
    setup.setConfigurations(start, goal)
    result = setup.plan(planner, time=time, seed=0)
    return result.path if result else None


def _verifies(path: FloatArray, robot: Robot, scene: Scene) -> bool:
    try:
        verify(certificate(path, robot, scene), robot, scene)
    except (CertificateError, PlanningError):
        return False
    return True


# ----------------------------------------------------------------------------------------------------- table


def _table(records: list[Record]) -> list[str]:
    """Return the lines of a table in Markdown, with a summary above it."""
    loaded = [record for record in records if "error" not in record]
    paths, verified = (sum(record[key] for record in loaded) for key in ("paths", "verified"))
    return [
        f"{len(loaded)} of {len(records)} URDFs load; {verified} certificates of {paths} paths verify.",
        "",
        f"| robot | load [s] first, again | joints | tip | links not checked | {' | '.join(PLANNERS)} | verified |",
        "|---|---|---|---|---|" + "---|" * (len(PLANNERS) + 1),
        *map(_row, records),
    ]


def _solved(record: Record, planner: str) -> str:
    """Return how many problems a planner solved; a dash where there was no time to ask it."""
    return f"{record['solved'][planner]}/{record['pairs']}" if planner in record["solved"] else "–"


def _row(record: Record) -> str:
    if "error" in record:
        return f"| {record['robot']} | {record['error']} |" + " |" * (len(PLANNERS) + 4)
    visual = " (visual shapes collide)" if record["collision"] == "visual" else ""
    cells = [
        record["robot"] + visual,
        f"{record['first']:.2f}, {record['second']:.2f}",
        record["joints"],
        record["tip"],
        ", ".join(record["unchecked"]),
        *(_solved(record, planner) for planner in PLANNERS),
        f"{record['verified']}/{record['paths']}",
    ]
    return f"| {' | '.join(map(str, cells))} |"


if __name__ == "__main__":
    main()
