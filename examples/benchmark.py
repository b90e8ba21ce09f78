"""Planners compared on all cores; the log goes to Planner Arena."""

from pathlib import Path
from tempfile import TemporaryDirectory

from ompl import tools as ot

from safe_ompl import Benchmark, Box, Obstacle, Pose, Robot, SafeSetup, Scene

scene = Scene((Obstacle("pillar", Box((0.15, 0.15, 1.0)), Pose((0.45, 0.0, 0.4)), weight=1.0),))
setup = SafeSetup(Robot.from_example("ur5"), scene)
setup.setConfigurations([0.9, -1.2, 1.4, -1.8, -1.57, 0.0], [-0.9, -1.2, 1.4, -1.8, -1.57, 0.0])

request = ot.Request()
request.maxTime, request.runCount, request.displayProgress = 5.0, 4, False
benchmark = Benchmark(setup, "past a pillar")
for planner in ("SafeRRTConnect", "ClassicRRTConnect", "RRTConnect"):
    benchmark.addPlanner(planner)

if __name__ == "__main__":
    benchmark.benchmark(request)  # one process for each core; times are cleanest with workers=1
    for planner in benchmark.getRecordedExperimentData().planners:
        runs = [run for run in planner.runs if run["solved"]]
        danger = sorted(run["danger mean"] for run in runs)[len(runs) // 2]
        print(f"{planner.name}: {len(runs)} of {request.runCount} solved, median danger {danger:.2f}")
    with TemporaryDirectory() as folder:
        log, database = Path(folder) / "pillar.log", Path(folder) / "pillar.db"
        benchmark.saveResultsToFile(log)
        benchmark.saveResultsToDatabase(log, database)  # what plannerarena.org reads
        print(f"{log.name} and {database.name}: {database.stat().st_size // 1024} kB")
