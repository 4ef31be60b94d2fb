"""Expected time of a comparison: by typical times before it starts, then by what each method has taken so far.

Methods differ by a factor of a hundred, and the prediction-error method (PEM) takes several times as long in one window
as in another. So neither the number of trials nor the first window says how long the rest will take. A trial is one
method in one window.
"""

from collections.abc import Sequence
from statistics import mean, median

from mavdem.experiments.compared_methods import Method
from mavdem.experiments.outcomes import Outcome
from mavdem.experiments.window import Window, part_samples

SAMPLES_OF_TYPICAL_WINDOW = sum(part_samples(dt=0.01))
"""Samples of a window of the default length at 100 Hz, for which the typical times of methods are known."""


class RunTimeEstimate:
    """Expected time of all trials of a comparison, methods times windows, on several processes.

    The expected time of a method in a window is the mean of those that are measured and, as one more window, of the
    method's typical time on this machine. So a first window that takes unusually long does not stand for all. The
    typical time is taken as proportional to the samples of a window.
    """

    def __init__(self, methods: Sequence[Method], windows: Sequence[Window], workers: int) -> None:
        """Takes the typical time of each method in a window of this length, before any time is measured.

        Args:
            methods: methods to compare.
            windows: windows to compare, at least one.
            workers: number of processes that share the work.
        """
        self._window_count = len(windows)
        self._workers = workers
        mean_samples = mean(window.stop - window.start for window in windows)
        relative_length = mean_samples / SAMPLES_OF_TYPICAL_WINDOW
        self._typical_seconds = {
            method.name: relative_length * method.window_seconds for method in methods
        }
        self._measured_seconds = {method.name: list[float]() for method in methods}

    def add(self, outcome: Outcome) -> None:
        """Counts the outcome of one method in one window.

        Args:
            outcome: the outcome, with the time that it took.
        """
        self._measured_seconds[outcome.method].append(outcome.elapsed_seconds)

    def seconds_left(self, elapsed_seconds: float) -> float:
        """Returns the expected time until the end, s; at least 0. Before the start it may be wrong by a factor of two.

        It is the expected time of all trials minus the time that has passed. The time of the trials without a result
        would be too long: results come in the order of the trials, and other processes have done more by then.

        Args:
            elapsed_seconds: time since the start of the trials, s.
        """
        done_seconds = sum(sum(measured) for measured in self._measured_seconds.values())
        all_seconds = done_seconds + sum(self._remaining_seconds().values())
        return max(all_seconds / self._workers - elapsed_seconds, 0.0)

    def slow_method(self) -> str | None:
        """Returns the method that takes more than half of the remaining time; None without such a method."""
        remaining = self._remaining_seconds()
        slowest = max(remaining, key=lambda method: remaining[method])
        return slowest if remaining[slowest] > sum(remaining.values()) / 2 else None

    def _remaining_seconds(self) -> dict[str, float]:
        """Returns the expected time of the trials without a result, s, by name of the method."""
        pace = self._pace()
        remaining = {}
        for method, measured in self._measured_seconds.items():
            typical_seconds = pace * self._typical_seconds[method]
            mean_seconds = (typical_seconds + sum(measured)) / (1 + len(measured))
            remaining[method] = (self._window_count - len(measured)) * mean_seconds
        return remaining

    def _pace(self) -> float:
        """Returns the median over trials of the measured time over the typical time; 1 before the first result.

        It is above 1 where the machine is slow or has other work. The median leaves a single slow trial aside.
        """
        ratios = []
        for method, measured in self._measured_seconds.items():
            for seconds in measured:
                ratios.append(seconds / self._typical_seconds[method])
        return median(ratios) if ratios else 1.0
