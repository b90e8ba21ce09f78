"""Plans again and again with the planner that is named, until Ctrl-C; then plans once more."""

import sys

from ompl import util as ou

from safe_ompl import Scenario
from safe_ompl.planning import setup_scenario


def main(name):
    ou.setLogLevel(ou.LogLevel.LOG_NONE)
    setup = setup_scenario(Scenario.load("planar3"))
    setup.plan(name, time=0.3)
    try:
        print("ready", flush=True)
        while True:
            setup.clear()
            setup.solve(60.0)
    except KeyboardInterrupt:
        print("interrupted")
    result = setup.plan(name, time=0.5, seed=1)
    assert not result or result.report.certified


main(sys.argv[1])
