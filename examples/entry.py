"""An entry of the open table: straight lines from start to goal, judged like any planner's paths.

    python examples/entry.py problems.json && safe-ompl judge entry.json --problems problems.json

The file holds MotionBenchMaker problems in VAMP's JSON form; without one a problem is made. An entry needs no
safe-ompl.
"""

import hashlib
import json
import sys
from pathlib import Path
from time import perf_counter

file = Path(sys.argv[1] if len(sys.argv) > 1 else "problems.json")
if len(sys.argv) == 1:
    left, right = [1.0, 0.3, 0, -1.6, 0, 1.9, 0.8], [-1.0, 0.3, 0, -1.6, 0, 1.9, 0.8]
    ball = {"radius": 0.1, "position": [0.5, 0, 0.5], "orientation_quat_xyzw": [0, 0, 0, 1]}
    problem = {"index": 1, "start": left, "goals": [right], "sphere": [ball]}
    file.write_text(json.dumps({"robot": "panda", "problems": {"ball": [problem]}}))

answers = []
for family, problems in json.loads(file.read_text())["problems"].items():
    for problem in problems[:10]:
        begin = perf_counter()
        path = [
            problem["start"],
            problem["goals"][0],
        ]  # your planner's way points; if it has none: "failed": "why"
        times = {"planning": perf_counter() - begin}
        answers.append({"problem": f"{family} {problem['index']}", "path": path, "times": times})

one_set = {"name": file.stem, "sha256": hashlib.sha256(file.read_bytes()).hexdigest(), "answers": answers}
entry = {"format": "safe-ompl entry", "version": 1, "system": "straight lines", "sets": [one_set]}
Path("entry.json").write_text(json.dumps(entry))
print(f"{len(answers)} answers: safe-ompl judge entry.json --problems {file}")
