#!/usr/bin/env python
"""Processor time of a review (``mavdem LOG``) by stage, such as reading the log; prints a table.

Usage: tools/bench/review_profile.py LOG [--before CHECKOUT]

A stage has the processor time of its functions without the time of other stages within them. The functions are wrapped
in a process of their own, so that the same stages can be measured in another checkout; a function that is missing there
counts to the stage that calls its code.
"""

import functools
import importlib
import json
import os
import subprocess
import sys
import time
from collections import defaultdict
from collections.abc import Callable, Iterator
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

import click

IMPORTS = "importing the modules"
REST = "the rest"
STAGES = {
    "reading the log": ["cli.sources:read_sources"],
    "wind in m/s": ["wind_velocity.from_log:wind_evidence"],
    "motors, events, ending": [
        "assessment.axis.analysis:_analysis_without_model",
        "assessment.reported:reported_events",
        "assessment.motion:motion_events",
        "assessment.ending:find_ending",
    ],
    "model, held-out windows": ["assessment.axis.training:train_and_test"],
    "physical parameters of the axes": ["assessment.axis.figures:physical_parameters"],
    "wind torque": ["plant.wind_torque:estimate_wind_torque"],
    "loops, lights": ["assessment.axis.loops:loops_of_axes", "assessment.judgement:judge"],
    "measured responses": ["assessment.axis.responses:measure_responses"],
    "advice on gains": ["assessment.axis.tuning:tune_loops", "assessment.axis.tuning:tuned"],
    "trial of the gains": ["assessment.axis.twin:try_gains"],
    "page": ["report.pages.flight_page:review_page"],
    "document": ["documents.review:review_document", "cli.output:json_text"],
    "flight.rrd, flight.mcap": [
        "results:write_dashboard",
        "export.mcap_channels:write_channels",
    ],
}
"""Functions of each stage, as module of mavdem and name."""

MEASURED_LOG = "MAVDEM_MEASURED_LOG"
"""Environment variable with the log that a process is to measure; it is set by this program for itself."""

RESULT_FILE = "MAVDEM_MEASURED_RESULT"
"""Environment variable with the JSON file to which that process writes its result."""


class StageClock:
    """Adds up the processor time of stages; while one calls a function of another one, only the inner one counts."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = defaultdict(float)
        """Processor time by stage, s."""
        self._running_stages = [REST]
        """Stages that have begun and not ended, the innermost last."""
        self._last_count = time.process_time()
        """Processor time up to which all time is counted, s."""

    def measured(self, stage: str, function: Callable[..., Any]) -> Callable[..., Any]:
        """Wraps a function so that the processor time of its calls is added to a stage.

        Args:
            stage: name of the stage.
            function: the function to measure.

        Returns:
            A function with the same arguments and results.
        """

        @functools.wraps(function)
        def measured_function(*arguments: Any, **keywords: Any) -> Any:
            """Calls ``function``, and counts the time of the call to ``stage``."""
            # The time until now belongs to the stage that calls the function.
            self._count_to_innermost_stage()
            self._running_stages.append(stage)
            try:
                return function(*arguments, **keywords)
            finally:
                self._count_to_innermost_stage()
                self._running_stages.pop()

        return measured_function

    def _count_to_innermost_stage(self) -> None:
        """Adds the processor time since the last count to the innermost stage that runs."""
        now = time.process_time()
        innermost_stage = self._running_stages[-1]
        self.seconds[innermost_stage] += now - self._last_count
        self._last_count = now

    def stop(self) -> None:
        """Counts the time that is not counted yet; call it at the end of the measurement."""
        self._count_to_innermost_stage()


class StageFunction(NamedTuple):
    """A function of mavdem whose time counts to a stage of the review."""

    stage: str
    name: str
    """Name of the function in its module."""
    function: Callable[..., Any]


def functions_of_stages() -> Iterator[StageFunction]:
    """Imports the modules of all stages, and yields their functions, without those that this version does not have."""
    for stage, paths in STAGES.items():
        for path in paths:
            module_name, function_name = path.split(":")
            try:
                module = importlib.import_module(f"mavdem.{module_name}")
            except ModuleNotFoundError:
                continue
            if hasattr(module, function_name):
                yield StageFunction(stage, function_name, getattr(module, function_name))


def measure(log: str) -> dict[str, float]:
    """Reviews a log in this process, and returns the processor seconds of each stage.

    The functions of the stages are replaced by measured ones in all modules that have imported them. A function or
    module that this version of mavdem does not have is left out.

    Args:
        log: path of the log.

    Returns:
        Processor time by name of the stage, s; imports are the first.
    """
    from mavdem.cli.commands import main

    functions = list(functions_of_stages())
    import_seconds = time.process_time()
    clock = StageClock()
    for stage, function_name, function in functions:
        measured_function = clock.measured(stage, function)
        # Modules that have imported the function have a name of their own for it.
        for name, importing_module in list(sys.modules.items()):
            if not name.startswith("mavdem"):
                continue
            if getattr(importing_module, function_name, None) is function:
                setattr(importing_module, function_name, measured_function)
    with TemporaryDirectory() as folder:
        main(["review", log, "--out", folder])
    clock.stop()
    return {IMPORTS: import_seconds, **clock.seconds}


def stage_seconds(log: Path, checkout: Path) -> dict[str, float]:
    """Returns the processor seconds of each stage of a review, measured in a process of its own.

    The process runs this file again, which finds the environment variable ``MEASURED_LOG`` and measures instead of
    printing a table. A new process is needed because one process can import only one version of mavdem.

    Args:
        log: the log to review.
        checkout: the checkout of the repository whose code is measured.

    Returns:
        Processor time, s, by the name of the stage.

    Raises:
        subprocess.CalledProcessError: the review failed.
    """
    with TemporaryDirectory() as folder:
        result = Path(folder) / "stages.json"
        environment = {
            "PYTHONPATH": str(checkout),
            MEASURED_LOG: str(log),
            RESULT_FILE: str(result),
        }
        subprocess.run(
            [sys.executable, str(Path(__file__).resolve())],
            cwd=checkout,
            env=os.environ | environment,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            check=True,
        )
        seconds: dict[str, float] = json.loads(result.read_text("utf-8"))
        return seconds


@click.command(help=__doc__)
@click.argument("log", type=click.Path(exists=True, dir_okay=False, path_type=Path))
@click.option(
    "--before",
    type=click.Path(exists=True, file_okay=False, path_type=Path),
    help="An earlier checkout to compare with.",
)
def main(log: Path, before: Path | None) -> None:
    """Reviews a log, and prints the processor seconds of each stage and its share of the whole.

    Args:
        log: the log to review.
        before: another checkout of the repository, whose seconds are printed beside this one's.
    """
    checkouts = {"now": Path(__file__).resolve().parents[2]}
    if before is not None:
        checkouts = {"before": before.resolve(), **checkouts}
    seconds_by_checkout = {}
    for name, checkout in checkouts.items():
        # The first run compiles modules and templates.
        stage_seconds(log.resolve(), checkout)
        seconds_by_checkout[name] = stage_seconds(log.resolve(), checkout)
    # Each checkout has two columns, seconds and share.
    titles = [f"{name}, s|share" for name in checkouts]
    print("|stage|" + "|".join(titles) + "|")
    print("|---|" + "---:|---:|" * len(checkouts))
    for stage in (IMPORTS, *STAGES, REST):
        cells = []
        for seconds_by_stage in seconds_by_checkout.values():
            seconds = seconds_by_stage.get(stage, 0.0)
            share = seconds / sum(seconds_by_stage.values())
            cells.append(f"{seconds:.2f}|{100 * share:.0f} %")
        print(f"|{stage}|" + "|".join(cells) + "|")
    totals = [f"{sum(seconds.values()):.2f}|" for seconds in seconds_by_checkout.values()]
    print("|all|" + "|".join(totals) + "|")


if __name__ == "__main__":
    if MEASURED_LOG in os.environ:
        stages = measure(os.environ[MEASURED_LOG])
        Path(os.environ[RESULT_FILE]).write_text(json.dumps(stages), "utf-8")
    else:
        main()
