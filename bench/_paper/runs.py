"""The campaigns of a study, without the runs that are already done."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

from _paper.smoothing import ShorteningCampaign, Smoothing
from _paper.store import Store
from _paper.studies import Pair, Study
from safe_ompl.apps.benchmark.campaign import Campaign
from safe_ompl.scene.scenario import Scenario, find_scenario

TIME = 10.0  # [s] for each run


def study_scenario(study: Study) -> Scenario:
    """Return the scenario of a study, with the time limit of the studies."""
    return replace(Scenario.load(find_scenario(study.scenario)), time=TIME)


def campaigns(
    scenario: Scenario,
    pairs: Sequence[Pair],
    runs: int,
    store: Store,
    smoothing: Smoothing = Smoothing.PLANNED,
) -> list[Campaign]:
    """Return what is left to do: `runs` runs of each planner, but one of each deterministic one."""
    done = store.done()
    kind = ShorteningCampaign if smoothing is Smoothing.SHORTENED else Campaign
    found = []
    for deterministic, number in ((True, 1), (False, runs)):
        alike = [pair for pair in pairs if pair.deterministic == deterministic]
        planners = [name for pair in alike for name in smoothing.planners(pair)]
        if planners:
            simplify = smoothing is Smoothing.SIMPLIFIED
            found.append(kind(scenario, planners, number, simplify=simplify, done=done))
    return [campaign for campaign in found if len(campaign)]


def do_runs(store: Store, todo: Sequence[Campaign], processes: int, advance: Callable[[], object]) -> None:
    """Do campaigns, and keep each result as it comes.

    Parameters
    ----------
    store : Store
        Where to.
    todo : sequence of Campaign
        What to do.
    processes : int
        How many runs go on at the same time.
    advance : callable
        Called after each run.
    """
    for campaign in todo:
        for result in campaign.results(processes=processes):
            store.add(result)
            advance()


def study_folder(folder: Path, study: Study, smoothing: Smoothing = Smoothing.PLANNED) -> Path:
    """Return the folder of a study within the output folder."""
    return folder / f"study_{study.number}{smoothing.suffix}"


def open_store(folder: Path, study: Study, smoothing: Smoothing = Smoothing.PLANNED) -> Store:
    """Return the store of a study within the output folder."""
    return Store(study_folder(folder, study, smoothing), study_scenario(study))
