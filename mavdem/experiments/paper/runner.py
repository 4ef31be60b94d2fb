"""What an experiment is made of: the paper's claim, the flights it runs on, and the checks that decide it.

The rules of checks are fixed before the numbers are known. Methods run on the windows of five simulated flights, in
place of the paper's, and of recorded ones, in worker processes; what several experiments share is computed once.
"""

import os
from collections.abc import Callable, Hashable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, field, replace
from enum import StrEnum
from functools import cached_property, partial
from itertools import chain
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple, TypeVar

import numpy as np
from scipy.io import loadmat

from mavdem import evaluate
from mavdem.arrays import Array
from mavdem.containers import JsonValues, Names
from mavdem.dataset import read_flight
from mavdem.dem import Settings, learn
from mavdem.dem.parallel import parallel_map
from mavdem.errors import NotLearnable
from mavdem.experiments.comparison import Method, Outcome, run_trial
from mavdem.experiments.held_out import Progress
from mavdem.experiments.scores import FROM_ZERO, KNOWN, REFERENCE_RATE
from mavdem.experiments.window import Window, part_samples, windows
from mavdem.facts.forecasts import HeldOutForecast, MethodName
from mavdem.files import PathName
from mavdem.flight import Flight
from mavdem.ingest import read_log
from mavdem.ingest.telemetry import interpolated
from mavdem.ingest.tlog import write_tlog
from mavdem.ingest.vocabulary import IN_AIR
from mavdem.report.blocks import Block
from mavdem.report.figures.style import Picture
from sitl_scenarios.files import load
from sitl_scenarios.mavlink.transmitter import recorded
from sitl_scenarios.motion import Motion, estimated_angles
from sitl_scenarios.scenario import Scenario
from sitl_scenarios.simulation import fly

EXPERIMENTS = (1, 2, 3, 4, 5)
SHOWN_EXPERIMENT = 2  # the experiment that the paper's figures of one flight show

SHARED = Path(os.environ.get("MAVDEM_SHARED_DATA", "shared/data"))
"""The folder of the recorded flights, which are no part of the product: unless named, one in the working directory."""

TRAIN, TEST = part_samples(
    1 / REFERENCE_RATE
)  # samples of a window, as in the paper, at every rate
REAL = "the real AR.Drone"
"""TU Delft's recorded flight: the paper's vehicle in the paper's laboratory."""
ARDRONE = SHARED / "ardrone_tudelft" / "expData10_29_25.mat"
# left out at the start of the hover, while the motion of the take-off decays
SKIPPED_HOVER_SECONDS = 3.0


def simulated_experiment(number: int) -> Flight:
    """Returns the simulated flight in place of experiment 1 to 5 of the paper, as its log holds it."""
    return logged(load(f"paper_{number}"), f"paper_{number}")


def logged(scenario: Scenario, name: str = "flight") -> Flight:
    """Returns a simulated flight: flown, written as a telemetry log of this name and read again."""
    motion = fly(scenario)
    with TemporaryDirectory() as folder:
        log = Path(folder) / f"{name}.tlog"
        write_log(log, scenario, motion)
        return read_flight(log)


def write_log(path: PathName, scenario: Scenario, motion: Motion) -> None:
    """Writes a telemetry log of a simulated flight."""
    with open(path, "wb") as file:
        write_tlog(file, recorded(scenario, motion))


def hover(scenario: Scenario, motion: Motion) -> Flight:
    """Returns the settled hover of a simulated flight as its autopilot estimates it, without a MAVLink link in between.

    Inputs are the motors. Outputs are y (m), ẏ (m/s), φ (rad) and φ̇ (rad/s). The rate is the scenario's.
    """
    airborne = motion.time[motion.landed_state == IN_AIR]
    rate = scenario.stream.rate
    time = (
        np.arange(round((airborne[0] + SKIPPED_HOVER_SECONDS) * rate), int(airborne[-1] * rate))
        / rate
    )
    columns = (
        motion.known_position[:, 1],
        motion.known_velocity[:, 1],
        estimated_angles(motion)[:, 0],
        motion.known_rates[:, 0],
    )
    outputs = interpolated(time, motion.time, np.column_stack(columns))
    motors = interpolated(time, motion.time, motion.outputs)
    return Flight(time, motors, outputs, dt=1 / rate)


def recorded_flights() -> Iterator[tuple[str, Flight]]:
    """Yields each recorded flight that a roll model can be trained on, by name; one for each vehicle of a log."""
    for path in sorted(SHARED.glob("sitl_*/*.tlog")):
        vehicles = read_log(path).vehicles
        for vehicle in vehicles:
            name = f"{vehicle.system}:{vehicle.component}"
            try:
                flight = read_flight(path, vehicle=name)
            except NotLearnable:
                continue
            yield path.stem if len(vehicles) == 1 else f"{path.stem} {name}", flight
    if ARDRONE.exists():
        yield ARDRONE.parent.name, ardrone(ARDRONE)


def ardrone(path: Path) -> Flight:
    """Returns TU Delft's AR.Drone 2.0 in wind.

    It has roll from motion capture, roll rate from the IMU and four PWM, at 120 Hz.
    """
    data = loadmat(path, squeeze_me=True, struct_as_record=False)["expData"].origData
    rate = 120
    # It is airborne from 21.7 s on, and never lands in the recording.
    time = np.arange(2600, len(data.otTime)) / rate
    time = time[time <= min(data.otTime[-1], data.imuTime[-1], data.navTime[-1])]
    roll = np.interp(time, data.otTime, data.otOrient[2])
    roll_rate = np.interp(time, data.imuTime, data.imuVAng[0])
    motors = [np.interp(time, data.navTime, motor) for motor in data.navMotor]
    return Flight(time, np.stack(motors, axis=1), np.stack([roll, roll_rate], axis=1), dt=1 / rate)


Job = TypeVar("Job")
JobResult = TypeVar("JobResult")
Key = TypeVar("Key", bound=Hashable)


class ClaimStatus(StrEnum):
    """How much of a claim is reproduced."""

    REPRODUCED = "reproduced"
    PARTLY = "partly"
    NOT = "not reproduced"
    UNTRIED = "not tried"


class Check(NamedTuple):
    """One condition for a claim; ``rule`` and ``finding`` (the result with its numbers) are clauses."""

    rule: str
    holds: bool
    finding: str


def findings(checks: Sequence[Check]) -> str:
    """Returns the findings of the checks that fail, then of those that hold."""
    parts = (
        [check.finding for check in checks if not check.holds],
        [check.finding for check in checks if check.holds],
    )
    return "; but ".join("; ".join(part) for part in parts if part)


def percent(share: float) -> str:
    """Returns a share as ``90 %``, three digits at most."""
    return f"{100 * share:.3g} %"


def plain(errors: dict[str, Array]) -> dict[str, list[float]]:
    """Returns errors by name as plain JSON values."""
    return {name: values.tolist() for name, values in errors.items()}


@dataclass(frozen=True)
class ExperimentResult:
    """What running an experiment gave."""

    # these decide the status; without any, ``remarks`` has the reason
    checks: tuple[Check, ...] = ()
    numbers: JsonValues = field(default_factory=dict)  # plain JSON values by name
    tables: tuple[Block, ...] = ()  # with the sentences above them
    pictures: tuple[Picture, ...] = ()
    remarks: Names = ()  # sentences


PAPER = Settings.paper()
PAPER_P1 = replace(PAPER, p=1, d=1, window=2)
"""The paper's settings without generalized coordinates: the first derivative, which the model needs, and no more."""

WITH = MethodName.PAPER
WITHOUT = MethodName.PAPER_P1
PEERS = ("subspace(2)", "PEM(2)", "EM(2)")  # the paper's, with as many states as its model
MEAN = HeldOutForecast.CONSTANT_MEAN

METHODS = [method for method in evaluate.METHODS if method.name in (WITH, WITHOUT, *PEERS, MEAN)]

DATA = "the data"
ZERO = "state 0"
STARTS = {DATA: KNOWN, ZERO: FROM_ZERO}
"""The question of a forecast from the end of training, and from state 0 as in the authors' code."""


def errors_of(trials: Iterable[Outcome], start: str) -> Array:
    """Returns (trials,) the MSPE of forecasts from ``start``, summed over outputs; infinite without a forecast."""
    return np.array([trial.mspe(STARTS[start]).sum() for trial in trials])


def median_draw(trials: list[Outcome], start: str) -> Outcome:
    """Returns that of the trials from random priors whose error is the median."""
    return trials[np.argsort(errors_of(trials, start), kind="stable")[len(trials) // 2]]


@dataclass(eq=False)
class Runner:
    """Runs jobs on workers, or in this process, and keeps the results that several experiments share.

    ``numbers`` are of simulated flights; ``uses_recorded`` whether to use the real flight, and the authors' results,
    if on this machine; ``draws_of_prior`` of η^θ. ``progress`` is called with the share of all jobs so far that are
    done.
    """

    executor: Executor | None = None
    numbers: Sequence[int] = EXPERIMENTS
    uses_recorded: bool = True
    draws_of_prior: int = 40
    progress: Progress = lambda share: None
    begun: int = 0  # jobs, of which so many are ``done``
    done: int = 0

    @property
    def shown(self) -> int:
        """The experiment in the figures of one flight."""
        return SHOWN_EXPERIMENT if SHOWN_EXPERIMENT in self.numbers else self.numbers[0]

    def each(self, work: Callable[[Job], JobResult], jobs: Iterable[Job]) -> list[JobResult]:
        """Returns ``work`` of each job, done on the workers; both must pickle."""
        todo = list(jobs)
        results = []
        self.begun += len(todo)
        for result in (
            map(work, todo) if self.executor is None else parallel_map(work, todo, self.executor)
        ):
            results.append(result)
            self.done += 1
            self.progress(self.done / self.begun)
        return results

    def try_all(
        self, jobs: Mapping[Key, Iterable[tuple[Method, Window]]]
    ) -> dict[Key, list[Outcome]]:
        """Returns the trials of the jobs of each key."""
        todo = {key: list(own) for key, own in jobs.items()}
        done = iter(self.each(run_trial, chain.from_iterable(todo.values())))
        return {key: [next(done) for _ in own] for key, own in todo.items()}

    @cached_property
    def windows(self) -> dict[int, tuple[Window, ...]]:
        """All windows of each simulated flight; the first, of 850 samples, is the paper's experiment."""
        flown = self.each(simulated_experiment, self.numbers)
        cut = zip(self.numbers, flown, strict=True)
        return {
            number: windows(f"experiment {number}", flight, TRAIN, TEST) for number, flight in cut
        }

    @property
    def experiments(self) -> dict[int, Window]:
        """850 samples of each simulated flight."""
        return {number: cut[0] for number, cut in self.windows.items()}

    @property
    def sample(self) -> Window:
        """The experiment in the figures of one flight."""
        return self.experiments[self.shown]

    @cached_property
    def recorded(self) -> tuple[Window, ...]:
        """All windows of the real flight; none where there is none."""
        if not (self.uses_recorded and ARDRONE.exists()):
            return ()
        return windows(REAL, ardrone(ARDRONE), TRAIN, TEST)

    @cached_property
    def trials(self) -> dict[tuple[str, str], list[Outcome]]:
        """All methods on windows of all flights: by flight and method, a trial a window."""
        flights = [cut for cut in (*self.windows.values(), self.recorded) if cut]
        return self.try_all(
            {
                (cut[0].flight, method.name): [(method, window) for window in cut]
                for cut in flights
                for method in METHODS
            }
        )

    @cached_property
    def draws(self) -> dict[tuple[str, int], list[Outcome]]:
        """DEM with the paper's settings: by method and experiment, a trial a random prior."""
        methods = {WITH: self.priors(PAPER), WITHOUT: self.priors(PAPER_P1)}
        return self.try_all(
            {
                (name, number): [(fit, window) for fit in fits]
                for name, fits in methods.items()
                for number, window in self.experiments.items()
            }
        )

    def priors(self, settings: Settings) -> list[Method]:
        """Returns DEM with these settings from each random prior."""
        seeds = range(self.draws_of_prior)
        return [
            Method(f"prior {seed}", partial(learn, settings=replace(settings, seed=seed)))
            for seed in seeds
        ]
