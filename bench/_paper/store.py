"""Results of runs as lines of JSON: what was done is kept, and not done again."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from safe_ompl.apps.benchmark.runs import Run
from safe_ompl.common import Counts
from safe_ompl.common.errors import InputError
from safe_ompl.paths.measures import ClearanceReport, DangerReport
from safe_ompl.paths.report import PathReport
from safe_ompl.planning.result import PlanResult
from safe_ompl.scene.scenario import Scenario


class Store:
    """The results on one scenario, in a folder of their own.

    Parameters
    ----------
    folder : path
        Holds ``scenario.yaml`` and ``runs.jsonl``; made if it does not exist.
    scenario : Scenario
        What the runs are of.

    Raises
    ------
    InputError
        If the folder holds runs of another scenario, or of an earlier form of this one.
    """

    def __init__(self, folder: Path, scenario: Scenario) -> None:
        self.folder = folder
        self.file = folder / "runs.jsonl"
        folder.mkdir(parents=True, exist_ok=True)
        kept = folder / "scenario.yaml"
        if kept.is_file() and Scenario.load(kept) != scenario:
            raise InputError(
                f"holds runs of another form of {scenario.name!r}; give another folder", str(folder)
            )
        scenario.save(kept)
        self._drop_incomplete_line()

    def results(self) -> list[PlanResult]:
        """Return all results so far."""
        return [read_result(json.loads(line)) for line in self._lines()]

    def done(self) -> frozenset[Run]:
        """Return the runs that are done."""
        return frozenset(Run(line["planner"], line["seed"]) for line in map(json.loads, self._lines()))

    def add(self, result: PlanResult) -> None:
        """Add a result, at once."""
        with self.file.open("a", encoding="utf-8") as stream:
            stream.write(json.dumps(result.as_dict()) + "\n")

    def _lines(self) -> Iterator[str]:
        if self.file.is_file():
            with self.file.open(encoding="utf-8") as stream:
                yield from stream

    def _drop_incomplete_line(self) -> None:
        """Drop what was being written when an earlier run was stopped."""
        if self.file.is_file():
            text = self.file.read_bytes()
            if not text.endswith(b"\n"):
                self.file.write_bytes(text[: text.rfind(b"\n") + 1])


def read_result(data: Mapping[str, Any]) -> PlanResult:
    """Return the result that `PlanResult.as_dict` wrote down; why an edge was refused is not kept."""
    report = None
    if data["path"] is not None:
        danger = data["danger"] and DangerReport(
            **{**data["danger"], "profile": np.array(data["danger"]["profile"])}
        )
        report = PathReport(data["length"], danger, ClearanceReport(**data["clearance"]), data["certified"])
    return PlanResult(
        data["status"],
        None if data["path"] is None else np.array(data["path"]),
        report,
        data["planner"],
        data["seed"],
        tuple(data["joint_names"]),
        data["planning_time"],
        data["simplification_time"],
        Counts(**data["counts"]),
        setup_time=data.get("setup_time", 0.0),
        validation_time=data.get("report_time", 0.0),
    )
