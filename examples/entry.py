"""An entry of the open table: straight lines from start to goal, judged like any planner's paths.

    python examples/entry.py problems.json && safe-ompl judge entry.json --problems problems.json

The file holds MotionBenchMaker problems in VAMP's JSON form. Nothing of safe-ompl is needed to make an entry.
"""

import hashlib
import json
import sys
from pathlib import Path
from time import perf_counter

file = Path(sys.argv[1])
answers = []
for family, problems in json.loads(file.read_text())["problems"].items():
    for problem in problems[:10]:
        begin = perf_counter()
        path = [problem["start"], problem["goals"][0]]  # your planner's way points, or "failed": "why"
        times = {"planning": perf_counter() - begin}
        answers.append({"problem": f"{family} {problem['index']}", "path": path, "times": times})
one_set = {"name": file.stem, "sha256": hashlib.sha256(file.read_bytes()).hexdigest(), "answers": answers}
entry = {"format": "safe-ompl entry", "version": 1, "system": "straight lines", "sets": [one_set]}
Path("entry.json").write_text(json.dumps(entry))
