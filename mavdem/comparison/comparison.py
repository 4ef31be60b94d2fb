"""Every method on every window of every flight, the first method beside each of the others."""

from __future__ import annotations

import warnings
from collections.abc import Generator, Iterable, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from functools import cached_property
from itertools import product
from typing import Any

from mavdem.comparison.methods import METHODS
from mavdem.comparison.outcome import Method, Outcome, judge
from mavdem.comparison.summaries import Loss, MethodSummary, OverFlights, flight_summaries, losses, over_flights
from mavdem.dem.parallel import parallel_map
from mavdem.evaluate.paired_test import FEWEST_PAIRS, Paired, Span, paired
from mavdem.evaluate.windows import Window


def outcomes(
    windows: Iterable[Window], methods: Sequence[Method] = METHODS, executor: Executor | None = None
) -> Generator[Outcome, None, None]:
    """The outcomes of all ``methods`` on each of the ``windows``, one window after the other, as they are ready.

    By default it uses all cores of this process, in processes that import the running script: call it below ``if
    __name__ == "__main__":``. An outcome depends on its window and method only, so that it can be stored.
    Windows may be of several flights; an ``executor`` is any ``concurrent.futures.Executor``, and is left running.

    Raises:
        concurrent.futures.BrokenExecutor: a worker died, for example for lack of memory.
    """
    return parallel_map(judge_job, ((method, window) for window, method in product(windows, methods)), executor)


def compare(
    windows: Sequence[Window], methods: Sequence[Method] = METHODS, executor: Executor | None = None
) -> Comparison:
    """Runs all ``methods`` on all ``windows`` and compares the first with each of the others.

    Arguments are as for :func:`outcomes`, also ``executor``.

    Raises:
        ValueError: as :meth:`Comparison.of`.
        concurrent.futures.BrokenExecutor: a worker died, for example for lack of memory.
    """
    return Comparison.of(windows, outcomes(windows, methods, executor))


def judge_job(job: tuple[Method, Window]) -> Outcome:
    """A method tried on a window; a function of the module, for other processes."""
    return judge(*job)


@dataclass(frozen=True, eq=False)
class Comparison:
    """All outcomes with their summaries.

    Attributes:
        windows: of one or several flights; those of a flight have the same number of samples and channels.
        methods: their names; the first is compared with each of the others.
        outcomes: by window, and in each by method.
    """

    windows: tuple[Window, ...]
    methods: tuple[str, ...]
    outcomes: tuple[tuple[Outcome, ...], ...]

    @classmethod
    def of(cls, windows: Sequence[Window], outcomes: Iterable[Outcome]) -> Comparison:
        """The comparison of ``outcomes`` in any order: one for every method on each of the ``windows``.

        Methods are in order of appearance.

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
        """The part of one ``flight``, by its name."""
        own = [place for place, window in enumerate(self.windows) if window.flight == flight]
        return Comparison(
            tuple(self.windows[place] for place in own), self.methods, tuple(self.outcomes[place] for place in own)
        )

    @cached_property
    def predictions(self) -> Comparison | None:
        """The comparison of predictions without the inputs, of the methods that make them; ``None`` if none does."""
        asked = [place for place, one in enumerate(self.outcomes[0]) if one.predicted is not None]
        if not asked:
            return None
        rows = tuple(tuple(row[place].of_prediction for place in asked) for row in self.outcomes)
        return Comparison(self.windows, tuple(self.methods[place] for place in asked), rows)

    def summaries(self, flight: str, from_zero: bool = False) -> tuple[MethodSummary, ...]:
        """Each method's summary on the ``flight`` of that name, the lowest error first.

        With ``from_zero`` forecasts start from state 0, as the paper's figures do, not from the state at the end of
        training; there are no shorter horizons then.
        """
        return self._summaries[from_zero][flight]

    def standings(self, flight: str, from_zero: bool = False) -> tuple[MethodSummary, ...]:
        """Deprecated name of :meth:`summaries`, with the same ``flight`` and ``from_zero``."""
        warnings.warn("Comparison.standings is now Comparison.summaries", DeprecationWarning, stacklevel=2)
        return self.summaries(flight, from_zero)

    @cached_property
    def _summaries(self) -> dict[bool, dict[str, tuple[MethodSummary, ...]]]:
        parts = [(flight, self.of_flight(flight)) for flight in self.flights]
        return {
            from_zero: {
                flight: flight_summaries(part.windows, part.methods, part.outcomes, from_zero) for flight, part in parts
            }
            for from_zero in (False, True)
        }

    def losses(self, from_zero: bool = False) -> tuple[Loss, ...]:
        """Where the first method's median error on a flight is larger than another's; ``from_zero`` as above."""
        return losses(self._summaries[from_zero], self.methods[0])

    def verdicts(self, from_zero: bool = False) -> dict[str, Paired]:
        """The first method beside each other one over the whole test part, by name; ``from_zero`` as above.

        Pairs are flights where there are enough of them to distinguish anything, and else windows of all flights.
        """
        if len(self.flights) >= FEWEST_PAIRS:
            return {one.method: one.reference for one in self.over_flights(from_zero) if one.method != self.methods[0]}
        spans = [Span(window.flight, window.start, window.stop) for window in self.windows]
        ours, *others = (
            [(one.skill_from_zero if from_zero else one.skill[-1]).relative for one in column]
            for column in zip(*self.outcomes, strict=True)
        )
        return {method: paired(ours, own, spans) for method, own in zip(self.methods[1:], others, strict=True)}

    def over_flights(self, from_zero: bool = False) -> tuple[OverFlights, ...]:
        """Each method's summary over all flights, the lowest error first; ``from_zero`` as above."""
        return over_flights(self._summaries[from_zero])

    def to_dict(self, from_zero: bool = False) -> dict[str, Any]:
        """As plain JSON values, by flight and by window, infinite errors as infinity; ``from_zero`` as above."""
        return {
            "reference": self.methods[0],
            "methods": list(self.methods),
            "start": "zero" if from_zero else "data",
            "verdicts": {method: one.to_dict() for method, one in self.verdicts(from_zero).items()},
            "losses": [loss._asdict() | {"paired": loss.paired.to_dict()} for loss in self.losses(from_zero)],
            "over_flights": [one.to_dict() for one in self.over_flights(from_zero)],
            "flights": [self._flight(flight, from_zero) for flight in self.flights],
            "predictions": None if self.predictions is None else self.predictions.to_dict(),
        }

    def rows(self) -> list[dict[str, Any]]:
        """A row for each window, method and horizon, and one for the whole test part forecast from state 0.

        Then those of predictions without the inputs.
        """
        known = self._rows("known", from_zero=True)
        return known if self.predictions is None else known + self.predictions._rows("unknown", from_zero=False)

    def _rows(self, inputs: str, from_zero: bool) -> list[dict[str, Any]]:
        return [
            {
                "flight": window.flight,
                "start": window.start,
                "time": float(window.train.time[0]),
                "method": one.method,
                "inputs": inputs,
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
            for begun, skill in [
                *(("data", skill) for skill in one.skill),
                *([("zero", one.skill_from_zero)] if from_zero else []),
            ]
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
            "standings": [summary.to_dict() for summary in self.summaries(flight, from_zero)],
            "windows": [
                {
                    "start": window.start,
                    "time": float(window.train.time[0]),
                    "methods": {one.method: one.to_dict() for one in row},
                }
                for window, row in zip(part.windows, part.outcomes, strict=True)
            ],
        }
