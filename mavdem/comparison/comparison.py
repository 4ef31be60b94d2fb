"""Comparison: every method on every window of every flight, the first method beside each of the others."""

from __future__ import annotations

from collections.abc import Generator, Iterable, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from functools import cached_property
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mavdem.comparison.method import Method
from mavdem.comparison.methods import METHODS
from mavdem.comparison.outcome import Outcome, judge
from mavdem.comparison.standing import Loss, OverFlights, Standing, losses, over_flights, standings
from mavdem.dem.many import answer_many
from mavdem.windows import Window

Array = NDArray[np.float64]


def outcomes(
    windows: Iterable[Window], methods: Sequence[Method] = METHODS, executor: Executor | None = None
) -> Generator[Outcome, None, None]:
    """What each method makes of each window, all methods of one window after those of another, as they are there.

    By default on all cores this process may use, in processes that import the running script: call it below ``if
    __name__ == "__main__":``. It is a pure function of window and method, so outcomes may be kept, and only those be
    asked for that are new.

    Args:
        windows: of one or several flights.
        methods: what learns.
        executor: does the work; any ``concurrent.futures.Executor``, which is left running.

    Raises:
        concurrent.futures.BrokenExecutor: a worker died, such as for want of memory.
    """
    return answer_many(_judge, ((method, window) for window, method in product(windows, methods)), executor)


def compare(
    windows: Sequence[Window], methods: Sequence[Method] = METHODS, executor: Executor | None = None
) -> Comparison:
    """Tries all methods on all windows; see :func:`outcomes`, of which this waits for the last.

    Args:
        windows: of one or several flights.
        methods: what learns, the one that the others are compared with first.
        executor: does the work; any ``concurrent.futures.Executor``, which is left running.

    Raises:
        ValueError: as :meth:`Comparison.of`.
        concurrent.futures.BrokenExecutor: a worker died, such as for want of memory.
    """
    return Comparison.of(windows, outcomes(windows, methods, executor))


def _judge(job: tuple[Method, Window]) -> Outcome:
    return judge(*job)


@dataclass(frozen=True, eq=False)
class Comparison:
    """All outcomes, and what they come to.

    Attributes:
        windows: of one or several flights; those of a flight have the same number of samples and channels.
        methods: their names, the one that the others are compared with first.
        outcomes: by window, and in each by method.
    """

    windows: tuple[Window, ...]
    methods: tuple[str, ...]
    outcomes: tuple[tuple[Outcome, ...], ...]

    @classmethod
    def of(cls, windows: Sequence[Window], outcomes: Iterable[Outcome]) -> Comparison:
        """Of outcomes in any order.

        Args:
            windows: at least one.
            outcomes: one for every window and every method that any of them names; methods in order of appearance.

        Raises:
            ValueError: an outcome is missing or of no window, or there is no window.
        """
        found = {(one.flight, one.start, one.method): one for one in outcomes}
        methods = tuple(dict.fromkeys(method for _, _, method in found))
        try:
            table = tuple(
                tuple(found.pop((window.flight, window.start, method)) for method in methods) for window in windows
            )
        except KeyError as missing:
            raise ValueError(f"outcomes must hold every method on every window; {missing} is missing") from None
        if found or not (windows and methods):
            raise ValueError("outcomes must be of the windows, of which there must be one at least")
        return cls(tuple(windows), methods, table)

    @cached_property
    def flights(self) -> tuple[str, ...]:
        """Their names, in order of appearance."""
        return tuple(dict.fromkeys(window.flight for window in self.windows))

    def of_flight(self, flight: str) -> Comparison:
        """The part that is of one flight.

        Args:
            flight: its name.
        """
        own = [place for place, window in enumerate(self.windows) if window.flight == flight]
        return Comparison(
            tuple(self.windows[place] for place in own), self.methods, tuple(self.outcomes[place] for place in own)
        )

    def standings(self, flight: str, from_zero: bool = False) -> tuple[Standing, ...]:
        """Each method's standing on one flight, the least error first.

        Args:
            flight: its name.
            from_zero: judge forecasts that begin with state 0, as the paper's figures do, and not with the state at the
                end of training; there are no shorter horizons then.
        """
        return self._standings[from_zero][flight]

    @cached_property
    def _standings(self) -> dict[bool, dict[str, tuple[Standing, ...]]]:
        parts = [(flight, self.of_flight(flight)) for flight in self.flights]
        return {
            from_zero: {
                flight: standings(part.windows, part.methods, part.outcomes, from_zero) for flight, part in parts
            }
            for from_zero in (False, True)
        }

    def losses(self, from_zero: bool = False) -> tuple[Loss, ...]:
        """Where the first method's median error over a flight's windows is larger than another's: the worst first.

        Args:
            from_zero: as for :meth:`standings`.
        """
        return losses(self._standings[from_zero], self.methods[0])

    def over_flights(self, from_zero: bool = False) -> tuple[OverFlights, ...]:
        """Each method's standing over all flights, which count alike, the least error first.

        Args:
            from_zero: as for :meth:`standings`.
        """
        return over_flights(self._standings[from_zero])

    def to_dict(self, from_zero: bool = False) -> dict[str, Any]:
        """As plain JSON values, by flight and by window; errors that are infinite are the number infinity.

        Args:
            from_zero: as for :meth:`standings`.
        """
        return {
            "reference": self.methods[0],
            "methods": list(self.methods),
            "start": "zero" if from_zero else "data",
            "losses": [loss._asdict() | {"paired": loss.paired._asdict()} for loss in self.losses(from_zero)],
            "over_flights": [one.to_dict() for one in self.over_flights(from_zero)],
            "flights": [self._flight(flight, from_zero) for flight in self.flights],
        }

    def rows(self) -> list[dict[str, Any]]:
        """A row for each window, method and horizon, and one for the whole test part begun from zero."""
        return [
            {
                "flight": window.flight,
                "start": window.start,
                "time": float(window.train.time[0]),
                "method": one.method,
                "begun": begun,
                "steps": skill.steps,
                "relative": skill.relative,
                "total": skill.total,
                **{f"output {i + 1} over variance": value for i, value in enumerate(skill.per_output.tolist())},
                "stable": one.stable,
                "failure": one.failure,
            }
            for window, row in zip(self.windows, self.outcomes, strict=True)
            for one in row
            for begun, skill in [*(("data", skill) for skill in one.skill), ("zero", one.skill_from_zero)]
        ]

    def _flight(self, flight: str, from_zero: bool) -> dict[str, Any]:
        part = self.of_flight(flight)
        first = part.windows[0]
        return {
            "flight": flight,
            "dt": first.train.dt,
            "outputs": list(first.train.output_names),
            "output_units": list(first.train.output_units),
            "training_samples": len(first.train),
            "forecast_samples": len(first.test),
            "standings": [standing.to_dict() for standing in self.standings(flight, from_zero)],
            "windows": [
                {
                    "start": window.start,
                    "time": float(window.train.time[0]),
                    "methods": {one.method: one.to_dict() for one in row},
                }
                for window, row in zip(part.windows, part.outcomes, strict=True)
            ],
        }
