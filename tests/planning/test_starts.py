"""Several starts: the best of their paths by the setup's objective, whatever the number of workers."""

import os
import signal

import numpy as np
import pytest
from ompl import base as ob

from safe_ompl import PlanningError, SafeRRTConnect, Scenario
from safe_ompl.common import in_order
from safe_ompl.planning import setup_scenario

FIRST, STARTS = 2**32 - 3, 6  # seeds go on at 0


@pytest.fixture(scope="module")
def setup():
    return setup_scenario(Scenario.load("planar3"))


@pytest.fixture(scope="module")
def alone(setup):
    """Return the results of the starts, each alone, with their costs."""
    found = []
    for k in range(STARTS):
        result = setup.plan("RRTConnect", seed=(FIRST + k) % 2**32)
        found.append((setup.getSolutionPath().cost(setup.getOptimizationObjective()).value(), result))
    assert len({cost for cost, _ in found}) > 2
    return found


@pytest.mark.parametrize("workers", [1, 2, 4])
def test_the_best_start_is_returned_as_if_it_had_been_alone(setup, alone, workers):
    result = setup.plan("RRTConnect", seed=FIRST, starts=STARTS, workers=workers)
    cost, best = min(alone, key=lambda found: found[0])
    assert result.seed == best.seed
    np.testing.assert_array_equal(result.path, best.path)
    assert (result.counts, result.status) == (best.counts, best.status)
    assert result.certified
    assert result.robot is setup.robot
    np.testing.assert_array_equal(setup.solution(), best.path)
    assert setup.getSolutionPath().cost(setup.getOptimizationObjective()).value() == cost
    assert setup.haveExactSolutionPath()
    assert not result.interrupted


def test_the_objective_of_the_setup_decides_and_among_equals_the_first_seed(setup, alone, monkeypatch):
    si, before = setup.getSpaceInformation(), setup.getOptimizationObjective()
    lengths = [result.report.length for _, result in alone]
    assert np.argmin(lengths) != np.argmin([cost for cost, _ in alone])
    try:
        setup.setOptimizationObjective(ob.PathLengthOptimizationObjective(si))
        result = setup.plan("RRTConnect", seed=FIRST, starts=STARTS, workers=2)
        assert result.seed == alone[int(np.argmin(lengths))][1].seed
    finally:
        setup.setOptimizationObjective(before)
    monkeypatch.setattr(type(before), "motionCost", lambda self, start, end: ob.Cost(0.0))
    assert setup.plan("RRTConnect", seed=FIRST, starts=STARTS, workers=2).seed == FIRST


@pytest.mark.parametrize(
    "options", [*({"starts": 3, "workers": workers, "simplify": True} for workers in (1, 2)), {"ways": "all"}]
)
def test_starts_without_a_path_are_skipped_and_without_any_there_is_none(setup, options):
    class Fickle(SafeRRTConnect):
        fails_below = 2

        def _search(self, ptc):
            return None if self.getSeed() < self.fails_below else super()._search(ptc)

    planner = Fickle(setup.getSpaceInformation())
    result = setup.plan(planner, seed=0, time=60.0, **options)
    assert (result.certified, result.status) == (True, "Exact solution")
    if "starts" in options:
        assert result.seed == 2
        np.testing.assert_array_equal(result.path, setup.plan(planner, seed=2, simplify=True, time=60.0).path)
    planner.fails_below = 100
    nothing = setup.plan(planner, seed=0, time=60.0, **options)
    assert (nothing.path, nothing.seed, nothing.ways, nothing.status) == (None, 0, (), "Timeout")
    assert not setup.haveSolutionPath()


@pytest.mark.parametrize("workers", [1, 2])
@pytest.mark.parametrize("done", [0, 1])
def test_ctrl_c_leaves_the_best_so_far(setup, monkeypatch, workers, done):
    def pressed(*arguments):
        for k, result in enumerate(in_order(*arguments)):
            if k == done:
                signal.raise_signal(signal.SIGINT)
            yield result

    monkeypatch.setattr("safe_ompl.common.in_order", pressed)
    if done == 0:
        with pytest.raises(KeyboardInterrupt):
            setup.plan(seed=1, starts=9, workers=workers)
        return
    result = setup.plan(seed=1, starts=9, workers=workers)
    assert (result.interrupted, result.certified, result.seed) == (True, True, 1)


def test_what_goes_wrong_in_a_start_is_said(setup, monkeypatch):
    monkeypatch.setattr(SafeRRTConnect, "_search", lambda self, ptc: os.kill(os.getpid(), signal.SIGKILL))
    with pytest.raises(PlanningError, match=r"seed 7 .*exit code -9"):
        setup.plan(seed=7, starts=2, workers=2)
