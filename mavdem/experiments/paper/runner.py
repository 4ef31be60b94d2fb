"""Runner of the paper's experiments: trains the paper's methods on windows of flights, in worker processes.

Results that several experiments need are computed once and stored by the runner.
"""

from collections.abc import Callable, Hashable, Iterable, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from typing import TypeVar

import numpy as np

from mavdem import evaluate
from mavdem.arrays import Array
from mavdem.dem import Settings, learn
from mavdem.dem.parallel import parallel_map
from mavdem.experiments.compared_methods import Method
from mavdem.experiments.held_out import Progress
from mavdem.experiments.outcomes import Outcome, run_trial
from mavdem.experiments.paper.flights import (
    TEST_SAMPLES,
    TRAINING_SAMPLES,
    simulated_experiment,
)
from mavdem.experiments.scores import FROM_STATE_ZERO, KNOWN_INPUTS
from mavdem.experiments.window import Window, windows
from mavdem.facts.forecasts import HeldOutForecast, MethodName
from mavdem.flight import Flight

Job = TypeVar("Job")
JobResult = TypeVar("JobResult")
Key = TypeVar("Key", bound=Hashable)

EXPERIMENT_NUMBERS = (1, 2, 3, 4, 5)
"""Numbers of the paper's five flights."""

FIGURE_EXPERIMENT = 2
"""The experiment that the paper's figures of a single flight show."""

RANDOM_PRIOR_COUNT = 40
"""Random priors of the parameters, η^θ, that DEM is trained from on each experiment; a choice."""

PAPER_SETTINGS = Settings.paper()
"""The paper's settings of DEM: generalized coordinates of order p = 2."""

PAPER_SETTINGS_P1 = replace(PAPER_SETTINGS, p=1, d=1, window=2)
"""The paper's settings without generalized coordinates: the first derivative, which the model needs, and no more."""

DEM_P2 = MethodName.PAPER
"""Name of DEM with ``PAPER_SETTINGS``."""

DEM_P1 = MethodName.PAPER_P1
"""Name of DEM with ``PAPER_SETTINGS_P1``."""

PEER_METHODS = ("subspace(2)", "PEM(2)", "EM(2)")
"""The methods that the paper compares DEM with, with two states each, as many as its model has."""

CONSTANT_MEAN = HeldOutForecast.CONSTANT_MEAN
"""Name of the baseline that forecasts the mean of the training data."""

PAPER_METHODS = (DEM_P2, DEM_P1, *PEER_METHODS, CONSTANT_MEAN)
"""Names of the methods that are trained on the windows of every flight."""

RECORDED_METHODS = (MethodName.JOINT, MethodName.PLANT, *PAPER_METHODS)
"""Names of the methods that are trained on the windows of recorded flights: the default of ``mavdem learn`` first."""

METHODS_BY_NAME = {method.name: method for method in evaluate.METHODS}
"""The methods of ``mavdem compare`` by name."""

DATA_START = "the data"
"""Name of a forecast that starts from the state estimated at the end of training."""

ZERO_START = "state 0"
"""Name of a forecast that starts from state 0, as in the authors' code."""

FORECAST_KIND_BY_START = {DATA_START: KNOWN_INPUTS, ZERO_START: FROM_STATE_ZERO}
"""The forecast of an ``Outcome`` by the name of its start."""


def forecast_errors(outcomes: Iterable[Outcome], start: str) -> Array:
    """Returns the MSPE of each outcome's forecast, summed over the outputs.

    Args:
        outcomes: N outcomes of methods on windows.
        start: start of the forecasts, ``DATA_START`` or ``ZERO_START``.

    Returns:
        (N,) errors; infinite where there is no forecast.
    """
    kind = FORECAST_KIND_BY_START[start]
    return np.array([outcome.mspe(kind).sum() for outcome in outcomes])


def median_outcome(outcomes: list[Outcome], start: str) -> Outcome:
    """Selects the outcome with the median error.

    Args:
        outcomes: outcomes of one method from several random priors.
        start: start of the forecasts whose errors are compared, ``DATA_START`` or ``ZERO_START``.

    Returns:
        The outcome; of an even number, the upper one of the two in the middle.
    """
    indices_by_error = np.argsort(forecast_errors(outcomes, start), kind="stable")
    return outcomes[indices_by_error[len(outcomes) // 2]]


def random_prior_methods(settings: Settings, count: int) -> list[Method]:
    """Returns ``count`` methods that train DEM with the same settings, each from another random prior of θ."""
    methods = []
    for seed in range(count):
        train = partial(learn, settings=replace(settings, seed=seed))
        methods.append(Method(f"prior {seed}", train))
    return methods


@dataclass(eq=False)
class Runner:
    """Runs jobs of the experiments on workers, and stores the results that several experiments use.

    The properties that are computed once take minutes: they simulate flights and train models.
    """

    executor: Executor | None = None
    """Executor of the jobs; without one they run in this process."""

    experiment_numbers: Sequence[int] = EXPERIMENT_NUMBERS
    """Numbers of the paper's experiments that are simulated."""

    recorded_flights: Mapping[str, Flight] = field(default_factory=dict)
    """Recorded flights of the AR.Drone by name, which are examined as well as the simulated ones."""

    uses_authors_results: bool = True
    """Whether to use the results of the authors' own code where they are on this machine."""

    prior_count: int = RANDOM_PRIOR_COUNT
    """Random priors that DEM is trained from on each experiment."""

    progress: Progress = lambda share: None
    """Function that is called with the share, 0 to 1, of all jobs so far that have finished."""

    submitted_jobs: int = 0
    """Number of jobs so far."""

    finished_jobs: int = 0
    """Number of jobs so far that have finished."""

    @property
    def figure_experiment(self) -> int:
        """Number of the experiment in figures of a single flight: the paper's, or else the first that is simulated."""
        if FIGURE_EXPERIMENT in self.experiment_numbers:
            return FIGURE_EXPERIMENT
        return self.experiment_numbers[0]

    def map_jobs(
        self, function: Callable[[Job], JobResult], jobs: Iterable[Job]
    ) -> list[JobResult]:
        """Calls a function for each job, on the workers if there are any, and reports the progress.

        Args:
            function: the function; it and the jobs must pickle.
            jobs: its arguments.

        Returns:
            The results in the order of the jobs.
        """
        job_list = list(jobs)
        self.submitted_jobs += len(job_list)
        results_as_they_come: Iterable[JobResult]
        if self.executor is None:
            results_as_they_come = map(function, job_list)
        else:
            results_as_they_come = parallel_map(function, job_list, self.executor)
        results = []
        for result in results_as_they_come:
            results.append(result)
            self.finished_jobs += 1
            self.progress(self.finished_jobs / self.submitted_jobs)
        return results

    def run_trials(
        self, trials: Mapping[Key, Sequence[tuple[Method, Window]]]
    ) -> dict[Key, list[Outcome]]:
        """Trains methods on windows and evaluates their forecasts, all trials in one batch of jobs.

        One batch keeps all workers busy to its end, which a batch for each key would not.

        Args:
            trials: pairs of a method and a window, by key.

        Returns:
            By the same keys, the outcome of each pair.
        """
        all_trials: list[tuple[Method, Window]] = []
        for trials_of_key in trials.values():
            all_trials += trials_of_key
        # The outcomes come in the order of the trials, so that each key takes the next ones.
        outcomes = iter(self.map_jobs(run_trial, all_trials))
        outcomes_by_key = {}
        for key, trials_of_key in trials.items():
            outcomes_by_key[key] = [next(outcomes) for _ in trials_of_key]
        return outcomes_by_key

    @cached_property
    def simulated_windows(self) -> dict[int, tuple[Window, ...]]:
        """All windows of each simulated flight, by number of the experiment, in the order of time."""
        flights = self.map_jobs(simulated_experiment, self.experiment_numbers)
        windows_by_number = {}
        for number, flight in zip(self.experiment_numbers, flights, strict=True):
            windows_by_number[number] = windows(
                f"experiment {number}", flight, TRAINING_SAMPLES, TEST_SAMPLES
            )
        return windows_by_number

    @property
    def experiment_windows(self) -> dict[int, Window]:
        """The first 850 samples of each simulated flight, by number: as much as the paper's experiments have."""
        return {number: windows[0] for number, windows in self.simulated_windows.items()}

    @property
    def figure_window(self) -> Window:
        """The experiment that figures of a single flight show."""
        return self.experiment_windows[self.figure_experiment]

    @cached_property
    def recorded_windows(self) -> tuple[Window, ...]:
        """All windows of the recorded flights, flight by flight; empty without any."""
        flight_windows: list[Window] = []
        for name, flight in self.recorded_flights.items():
            flight_windows += windows(name, flight, TRAINING_SAMPLES, TEST_SAMPLES)
        return tuple(flight_windows)

    @cached_property
    def recorded_outcomes(self) -> dict[str, list[Outcome]]:
        """Outcomes of ``RECORDED_METHODS`` by name, one for each of ``recorded_windows``."""
        trials = {}
        for name in RECORDED_METHODS:
            trials[name] = [(METHODS_BY_NAME[name], window) for window in self.recorded_windows]
        return self.run_trials(trials)

    @cached_property
    def outcomes(self) -> dict[tuple[int, str], list[Outcome]]:
        """Outcomes of ``PAPER_METHODS`` by experiment and name, one for each window of the simulated flight."""
        trials = {}
        for number, flight_windows in self.simulated_windows.items():
            for name in PAPER_METHODS:
                trials[number, name] = [
                    (METHODS_BY_NAME[name], window) for window in flight_windows
                ]
        return self.run_trials(trials)

    @cached_property
    def random_prior_outcomes(self) -> dict[tuple[str, int], list[Outcome]]:
        """Outcomes of DEM by name of the method and number of the experiment, one for each random prior."""
        trials: dict[tuple[str, int], list[tuple[Method, Window]]] = {}
        for name, settings in ((DEM_P2, PAPER_SETTINGS), (DEM_P1, PAPER_SETTINGS_P1)):
            methods = random_prior_methods(settings, self.prior_count)
            for number, window in self.experiment_windows.items():
                trials[name, number] = [(method, window) for method in methods]
        return self.run_trials(trials)
