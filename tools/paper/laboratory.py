"""Laboratory: the flights, the workers, and the experiments that several items share, each done once."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import TypeVar

import numpy as np
from bench.flights import recorded_flights
from paper.flights import EXPERIMENTS, SAMPLE, experiment

import mavdem
from mavdem import baselines
from mavdem.comparison import Comparison, Method, Outcome, dem, judge
from mavdem.dem import Settings
from mavdem.dem.many import answer_many
from mavdem.windows import TEST, TRAIN, Window, windows

Job = TypeVar("Job")
Answer = TypeVar("Answer")

HOP = (TRAIN + TEST) // 2

REAL = "ardrone_tudelft"
"""The name of TU Delft's flight, the paper's vehicle in the paper's laboratory."""

PAPER = Settings.paper()
PAPER_WITHOUT = replace(PAPER, p=1, d=1, window=2)
"""Without generalized coordinates: the first derivative, which the model itself needs, and none beyond."""

WITH, WITHOUT = "DEM paper", "DEM paper p=1"
OURS, OURS_WITHOUT = "DEM", "DEM p=1"

PEERS = {
    "subspace(2)": partial(baselines.subspace, order=2),
    "PEM(2)": partial(baselines.pem, order=2),
    "EM(2)": partial(baselines.em, order=2),
}
"""The paper's, of as many states as its model."""

METHODS = (
    dem(WITH, PAPER),
    dem(WITHOUT, PAPER_WITHOUT),
    dem(OURS, Settings()),
    dem(OURS_WITHOUT, replace(Settings(), p=1, d=1)),
    *(Method(name, learn) for name, learn in PEERS.items()),
    Method("subspace(4)", partial(baselines.subspace, order=4)),
    Method("ARX(2)", partial(baselines.arx, order=2)),
    Method("constant mean", baselines.constant_mean),
)


@dataclass(frozen=True)
class Extent:
    """How much is done.

    Attributes:
        experiments: which of the five simulated flights.
        duration: seconds of each, instead of the scenarios'.
        recorded: whether recorded flights are used where they are.
        windows: of each autopilot's flight at most, evenly spread; of the real AR.Drone's all.
        priors: draws of the random prior η^θ.
    """

    experiments: tuple[int, ...] = EXPERIMENTS
    duration: float | None = None
    recorded: bool = True
    windows: int = 4
    priors: int = 40

    @property
    def sample(self) -> int:
        """The experiment that figures of one flight show."""
        return SAMPLE if SAMPLE in self.experiments else self.experiments[0]


class Laboratory:
    """Where the experiments are done.

    Args:
        extent: how much of them.
        executor: does the work; ``None``: this process.
        begun: told how many jobs there are to do; answers what is called as each of them is done.
    """

    def __init__(
        self,
        extent: Extent,
        executor: Executor | None = None,
        begun: Callable[[int], Callable[[], None]] = lambda jobs: lambda: None,
    ) -> None:
        self.extent = extent
        self._executor, self._begun = executor, begun

    def each(self, work: Callable[[Job], Answer], jobs: Iterable[Job]) -> list[Answer]:
        """``work`` of each job, on the workers; both must pickle."""
        todo, answers = list(jobs), []
        advance = self._begun(len(todo))
        done = map(work, todo) if self._executor is None else answer_many(work, todo, self._executor)
        for answer in done:
            answers.append(answer)
            advance()
        return answers

    @cached_property
    def flights(self) -> dict[int, mavdem.Flight]:
        """The simulated flights by the experiment they stand for."""
        flown = self.each(partial(experiment, duration=self.extent.duration), self.extent.experiments)
        return dict(zip(self.extent.experiments, flown, strict=True))

    @cached_property
    def windows(self) -> dict[int, tuple[Window, ...]]:
        """All windows of each simulated flight; the first is what the paper calls the experiment."""
        return {number: windows(f"experiment {number}", one, TRAIN, TEST, HOP) for number, one in self.flights.items()}

    @cached_property
    def experiments(self) -> dict[int, Window]:
        """850 samples of each simulated flight."""
        return {number: cut[0] for number, cut in self.windows.items()}

    @property
    def sample(self) -> Window:
        """The experiment that figures of one flight show."""
        return self.experiments[self.extent.sample]

    @cached_property
    def recorded(self) -> dict[str, tuple[Window, ...]]:
        """Windows of the recorded flights by name, none where these are not."""
        if not self.extent.recorded:
            return {}
        cut = {name: windows(name, flight, TRAIN, TEST, HOP) for name, flight in recorded_flights()}
        return {name: own if name == REAL else _spread(own, self.extent.windows) for name, own in cut.items() if own}

    @cached_property
    def comparison(self) -> Comparison:
        """All methods on windows of all flights."""
        cut = [window for own in (*self.windows.values(), *self.recorded.values()) for window in own]
        jobs = [(method, window) for window in cut for method in METHODS]
        return Comparison.of(cut, self.each(_judge, jobs))

    @cached_property
    def draws(self) -> dict[str, dict[int, list[Outcome]]]:
        """DEM with the paper's settings from several random priors: by method, by experiment, one a prior."""
        kinds = {WITH: PAPER, WITHOUT: PAPER_WITHOUT}
        places = [(name, number) for name in kinds for number in self.experiments]
        jobs = [
            (dem(name, replace(kinds[name], seed=seed)), self.experiments[number])
            for name, number in places
            for seed in range(self.extent.priors)
        ]
        found = iter(self.each(_judge, jobs))
        drawn: dict[str, dict[int, list[Outcome]]] = {name: {} for name in kinds}
        for name, number in places:
            drawn[name][number] = [next(found) for _ in range(self.extent.priors)]
        return drawn

    def outcome(self, method: str, number: int) -> Outcome:
        """What a method made of an experiment."""
        compared, window = self.comparison, self.experiments[number]
        place = [(one.flight, one.start) for one in compared.windows].index((window.flight, window.start))
        return compared.outcomes[place][compared.methods.index(method)]


def _spread(cut: tuple[Window, ...], most: int) -> tuple[Window, ...]:
    """So many of them at most, the first and the last among them."""
    if len(cut) <= most:
        return cut
    return tuple(cut[place] for place in np.linspace(0, len(cut) - 1, most).round().astype(int))


def _judge(job: tuple[Method, Window]) -> Outcome:
    return judge(*job)
