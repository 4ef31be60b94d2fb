"""The runner: flights, worker processes, and results that several items share, each computed once."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import TypeVar

import numpy as np

from mavdem.dem import Settings
from mavdem.dem.parallel import parallel_map
from mavdem.evaluate import comparison
from mavdem.evaluate.comparison import PAPER_SETTINGS_WITHOUT, Comparison, dem, judge_job
from mavdem.evaluate.scores import Outcome
from mavdem.evaluate.windows import Window, windows
from mavdem.flight import Flight
from mavdem.paper.flights import (
    EXPERIMENTS,
    HOP,
    REAL,
    SAMPLE,
    TEST,
    TRAIN,
    recorded_flights,
    simulated_experiment,
)

Job = TypeVar("Job")
JobResult = TypeVar("JobResult")

PAPER = Settings.paper()

WITH, WITHOUT = "DEM paper", "DEM paper p=1"
OURS, OURS_WITHOUT = "DEM", "DEM p=1"

PEERS = ("subspace(2)", "PEM(2)", "EM(2)")  # the paper's, with as many states as its model
OTHERS = ("subspace(4)", "ARX(2)")  # textbook methods that the paper does not compare

NAMES = (WITH, WITHOUT, OURS, OURS_WITHOUT, *PEERS, *OTHERS, "constant mean")
METHODS = tuple(method for method in comparison.METHODS if method.name in NAMES)

STARTS = ("the data", "state 0")  # of a forecast: the end of training, or 0 as in the authors' code


@dataclass(frozen=True)
class Extent:
    """How much to run."""

    experiments: tuple[int, ...] = EXPERIMENTS
    duration: float | None = None  # s of each simulated flight, instead of the scenarios'
    recorded: bool = True  # whether to use recorded flights that are available
    windows: int = 4  # at most, of each autopilot's flight, evenly spread; all of the real AR.Drone
    priors: int = 40  # draws of the random prior η^θ

    @property
    def sample(self) -> int:
        """The experiment in the figures of one flight."""
        return SAMPLE if SAMPLE in self.experiments else self.experiments[0]


class Runner:
    """Runs jobs on workers, or in this process, and keeps the results that several items share."""

    def __init__(
        self,
        extent: Extent,
        executor: Executor | None = None,
        begun: Callable[[int], Callable[[], None]] = lambda jobs: lambda: None,
    ) -> None:
        # Called with a number of new jobs, ``begun`` returns the function to call when one of them is done.
        self.extent = extent
        self._executor, self._begun = executor, begun

    def each(self, work: Callable[[Job], JobResult], jobs: Iterable[Job]) -> list[JobResult]:
        """``work`` of each job, on the workers; both must pickle."""
        todo, results = list(jobs), []
        advance = self._begun(len(todo))
        done = map(work, todo) if self._executor is None else parallel_map(work, todo, self._executor)
        for result in done:
            results.append(result)
            advance()
        return results

    @cached_property
    def flights(self) -> dict[int, Flight]:
        """The simulated flights, by experiment."""
        flown = self.each(partial(simulated_experiment, duration=self.extent.duration), self.extent.experiments)
        return dict(zip(self.extent.experiments, flown, strict=True))

    @cached_property
    def windows(self) -> dict[int, tuple[Window, ...]]:
        """All windows of each simulated flight; the first is the paper's experiment."""
        return {number: windows(f"experiment {number}", one, TRAIN, TEST, HOP) for number, one in self.flights.items()}

    @cached_property
    def experiments(self) -> dict[int, Window]:
        """850 samples of each simulated flight."""
        return {number: cut[0] for number, cut in self.windows.items()}

    @property
    def sample(self) -> Window:
        """The experiment in the figures of one flight."""
        return self.experiments[self.extent.sample]

    @cached_property
    def recorded(self) -> dict[str, tuple[Window, ...]]:
        """Windows of the recorded flights by name; empty where there are none."""
        if not self.extent.recorded:
            return {}
        cut = {name: windows(name, flight, TRAIN, TEST, HOP) for name, flight in recorded_flights()}
        return {name: own if name == REAL else _spread(own, self.extent.windows) for name, own in cut.items() if own}

    @cached_property
    def comparison(self) -> Comparison:
        """All methods on windows of all flights."""
        cut = [window for own in (*self.windows.values(), *self.recorded.values()) for window in own]
        jobs = [(method, window) for window in cut for method in METHODS]
        return Comparison.of(cut, self.each(judge_job, jobs))

    @cached_property
    def draws(self) -> dict[str, dict[int, list[Outcome]]]:
        """DEM with the paper's settings: by method and experiment, one outcome a random prior."""
        kinds = {WITH: PAPER, WITHOUT: PAPER_SETTINGS_WITHOUT}
        places = [(name, number) for name in kinds for number in self.experiments]
        jobs = [
            (dem(name, replace(kinds[name], seed=seed)), self.experiments[number])
            for name, number in places
            for seed in range(self.extent.priors)
        ]
        found = iter(self.each(judge_job, jobs))
        drawn: dict[str, dict[int, list[Outcome]]] = {name: {} for name in kinds}
        for name, number in places:
            drawn[name][number] = [next(found) for _ in range(self.extent.priors)]
        return drawn

    def outcome(self, method: str, number: int) -> Outcome:
        """The outcome of a method on an experiment."""
        compared, window = self.comparison, self.experiments[number]
        place = [(one.flight, one.start) for one in compared.windows].index((window.flight, window.start))
        return compared.outcomes[place][compared.methods.index(method)]


def _spread(cut: tuple[Window, ...], most: int) -> tuple[Window, ...]:
    """At most so many of them, with the first and the last."""
    if len(cut) <= most:
        return cut
    return tuple(cut[place] for place in np.linspace(0, len(cut) - 1, most).round().astype(int))


def total_mspe(outcome: Outcome, start: str) -> float:
    """MSPE summed over outputs, of the forecast that begins from ``start``, one of ``STARTS``."""
    return float((outcome.mspe if start == STARTS[0] else outcome.mspe_from_zero).sum())


def median_draw(outcomes: list[Outcome], start: str) -> Outcome:
    """Of the forecasts from random priors the one with the median error."""
    return sorted(outcomes, key=lambda one: total_mspe(one, start))[len(outcomes) // 2]
