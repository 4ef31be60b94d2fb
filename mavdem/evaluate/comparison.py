"""Every method on every window of every flight, the first method beside each of the others.

The methods that are compared: DEM, other model classes, and forecasts without a model.

Summaries of a method's outcomes over the windows of a flight, and over flights, beside the first method's.

The error ratio of a window is that of the whole test part: its error over that of the constant mean. A flight has the
median over its windows, because a mean would show one diverged forecast only, and the worst window beside it. Over
flights it is the geometric mean of these medians, so that each flight counts once.
"""

from __future__ import annotations

import warnings
from collections.abc import Generator, Iterable, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import asdict, dataclass, replace
from functools import cached_property, partial
from itertools import product
from typing import Any, NamedTuple

import numpy as np

from mavdem import baselines
from mavdem.dem import Settings, learn
from mavdem.dem.parallel import parallel_map
from mavdem.evaluate.paired_test import FEWEST_PAIRS, Paired, Span, paired
from mavdem.evaluate.scores import Method, Outcome, Skill, judge
from mavdem.evaluate.windows import Window


def dem(name: str, settings: Settings, predicts: bool = False) -> Method:
    """DEM with these ``settings`` of the fit, as the method of this ``name``, which ``predicts`` as well."""
    return Method(name, partial(learn, settings=settings), predicts)


PAPER_SETTINGS_WITHOUT = replace(Settings.paper(), p=1, d=1, window=2)
"""The paper's settings without generalized coordinates: the first derivative, which the model needs, and no
higher one."""

DEM = dem("DEM", Settings(), predicts=True)
DEM_WITHOUT = dem("DEM p=1", replace(Settings(), p=1, d=1))
PAPER = dem("DEM paper", Settings.paper())
PAPER_WITHOUT = dem("DEM paper p=1", PAPER_SETTINGS_WITHOUT)

PEERS = (
    *(Method(f"subspace({order})", partial(baselines.subspace, order=order)) for order in (2, 4)),
    *(Method(f"PEM({order})", partial(baselines.pem, order=order)) for order in (2, 4)),
    Method("EM(2)", partial(baselines.em, order=2)),
    *(Method(f"ARX({order})", partial(baselines.arx, order=order)) for order in (1, 2, 4)),
    *(Method(f"joint VAR({order})", partial(baselines.var, order=order), predicts=True) for order in (4, 10)),
)
"""Other methods that learn a model."""

TRIVIAL = (
    Method("constant mean", baselines.constant_mean, predicts=True),
    Method("hold last", baselines.hold, predicts=True),
    Method("zero", baselines.zero),
)

METHODS = (DEM, DEM_WITHOUT, PAPER, PAPER_WITHOUT, *PEERS, *TRIVIAL)
"""The methods of ``mavdem compare``; the first is compared with each of the others. Predictions without the inputs are
compared of those that make them; settings of DEM do not matter to these. p = 1 is what the paper calls
without generalized coordinates (section V.G): the first derivative only, which the model itself needs."""

GENERALIZED_COORDINATES = ((DEM.name, DEM_WITHOUT.name), (PAPER.name, PAPER_WITHOUT.name))
"""Pairs of names: the same method with generalized coordinates, and without."""


COUNTS = ("windows", "failed", "diverged", "unstable", "worse_than_constant")  # numbers of windows, summed over flights


class AtHorizon(NamedTuple):
    """A method at one horizon; medians are over windows.

    Attributes:
        steps: of each forecast.
        relative: median error ratio.
        relative_per_output: likewise of each output.
        per_output: median MSPE of each output over its training variance.
        reference: the first method's error over this one's.
        inside: mean share of samples up to this horizon in the 90 % band; ``None`` without one.
    """

    steps: int
    relative: float
    relative_per_output: tuple[float, ...]
    per_output: tuple[float, ...]
    reference: Paired
    inside: float | None


@dataclass(frozen=True)
class MethodSummary:
    """A method on one flight.

    Attributes:
        method: its name.
        windows: number of windows.
        failed: number of windows without a forecast.
        failure: the reason, of the first one; else empty.
        diverged: number of windows with a forecast that is infinite or NaN.
        unstable: number of windows whose model has a growing mode.
        mspe: (m,) mean over windows, in the squares of the outputs' units.
        mspe_total: their sum, as the paper reports it.
        relative: median error ratio.
        worst: largest error ratio.
        worse_than_constant: number of windows with an error ratio above 1.
        horizons: by horizon; the last is that of the whole test part.
        seconds: processor time of the training, median.
    """

    method: str
    windows: int
    failed: int
    failure: str
    diverged: int
    unstable: int
    mspe: tuple[float, ...]
    mspe_total: float
    relative: float
    worst: float
    worse_than_constant: int
    horizons: tuple[AtHorizon, ...]
    seconds: float

    def to_dict(self) -> dict[str, Any]:
        """As plain JSON values by name."""
        return asdict(self) | {
            "horizons": [one._asdict() | {"reference": one.reference.to_dict()} for one in self.horizons]
        }


class Loss(NamedTuple):
    """A flight and horizon at which the first method's median error is larger than another's.

    Attributes:
        flight, method: the flight, and the other method.
        steps: the horizon.
        ratio: the first method's median over the other's.
        paired: the comparison window by window, whose median may differ from ``ratio``.
    """

    flight: str
    method: str
    steps: int
    ratio: float
    paired: Paired


@dataclass(frozen=True)
class OverFlights:
    """A method over several flights.

    Attributes:
        method: its name.
        flights: number of flights.
        relative: geometric mean of the flights' median error ratios.
        horizons: likewise by horizon, for the horizons that all flights have.
        inside: mean over flights of their shares of samples in the 90 % band, by the same horizons.
        windows: number of windows of all flights.
        failed, diverged, unstable, worse_than_constant: numbers of windows, as in :class:`MethodSummary`.
        mspe_total: sum over flights of the total MSPE, as in the paper's table.
        reference: the first method's error over this one's; each flight is one pair.
    """

    method: str
    flights: int
    relative: float
    horizons: tuple[float, ...]
    inside: tuple[float | None, ...]
    windows: int
    failed: int
    diverged: int
    unstable: int
    worse_than_constant: int
    mspe_total: float
    reference: Paired

    def to_dict(self) -> dict[str, Any]:
        """As plain JSON values by name."""
        return asdict(self) | {"reference": self.reference.to_dict()}


def flight_summaries(
    windows: Sequence[Window], methods: Sequence[str], outcomes: Sequence[Sequence[Outcome]], from_zero: bool
) -> tuple[MethodSummary, ...]:
    """Each method's summary on one flight, the lowest error first; ``methods`` are names, the reference first.

    ``outcomes`` are by window, and in each by method. From state 0 (``from_zero``) there are no shorter horizons.
    """
    spans = [Span(window.flight, window.start, window.stop) for window in windows]
    by_method = list(zip(*outcomes, strict=True))
    reference = _by_horizon(by_method[0], from_zero)
    found = [_summary(method, own, from_zero, reference, spans) for method, own in zip(methods, by_method, strict=True)]
    return tuple(sorted(found, key=lambda summary: summary.relative))


def _by_horizon(outcomes: Sequence[Outcome], from_zero: bool) -> list[list[Skill]]:
    """By horizon, and at each by window."""
    rows = [[one.skill_from_zero] if from_zero else list(one.skill) for one in outcomes]
    return [list(column) for column in zip(*rows, strict=True)]


def _summary(
    method: str, outcomes: Sequence[Outcome], from_zero: bool, reference: list[list[Skill]], spans: Sequence[Span]
) -> MethodSummary:
    at_horizons = [
        AtHorizon(
            own[0].steps,
            float(np.median([one.relative for one in own])),
            tuple(np.median([one.relative_per_output for one in own], axis=0).tolist()),
            tuple(np.median([one.per_output for one in own], axis=0).tolist()),
            paired([one.relative for one in ours], [one.relative for one in own], spans),
            None if from_zero else _mean(inside),
        )
        for own, ours, inside in zip(
            _by_horizon(outcomes, from_zero),
            reference,
            zip(*(one.inside for one in outcomes), strict=True),
            strict=False,
        )
    ]
    relative = [(one.skill_from_zero if from_zero else one.skill[-1]).relative for one in outcomes]
    errors = np.array([one.mspe_from_zero if from_zero else one.mspe for one in outcomes])
    return MethodSummary(
        method,
        windows=len(outcomes),
        failed=sum(bool(one.failure) for one in outcomes),
        failure=next((one.failure for one in outcomes if one.failure), ""),
        diverged=sum(one.diverged for one in outcomes),
        unstable=sum(one.stable is False for one in outcomes),
        mspe=tuple(errors.mean(axis=0).tolist()),
        mspe_total=float(errors.mean(axis=0).sum()),
        relative=float(np.median(relative)),
        worst=max(relative),
        worse_than_constant=sum(value > 1 for value in relative),
        horizons=tuple(at_horizons),
        seconds=float(np.median([one.seconds for one in outcomes])),
    )


def losses(by_flight: Mapping[str, Sequence[MethodSummary]], reference: str) -> tuple[Loss, ...]:
    """Where the first method is worse than another, the largest ratio first."""
    found = []
    for flight, of_all in by_flight.items():
        ours = next(summary for summary in of_all if summary.method == reference)
        found += [
            Loss(flight, summary.method, at.steps, over(our.relative, at.relative), at.reference)
            for summary in of_all
            for our, at in zip(ours.horizons, summary.horizons, strict=True)
            if our.relative > at.relative
        ]
    return tuple(sorted(found, key=lambda loss: -loss.ratio))


def over(ours: float, theirs: float) -> float:
    """The ratio of two errors; 1 if both are infinite, or both 0."""
    return 1.0 if ours == theirs else float(np.divide(ours, theirs)) if theirs else float("inf")


def over_flights(by_flight: Mapping[str, Sequence[MethodSummary]]) -> tuple[OverFlights, ...]:
    """Each method's summary over all flights, the lowest error first."""
    by_method: dict[str, list[MethodSummary]] = {}
    for of_all in by_flight.values():
        for summary in of_all:
            by_method.setdefault(summary.method, []).append(summary)
    found = [_over_flights(method, of_flights) for method, of_flights in by_method.items()]
    return tuple(sorted(found, key=lambda one: one.relative))


def _over_flights(method: str, of_flights: Sequence[MethodSummary]) -> OverFlights:
    ratios = [summary.horizons[-1].reference.ratio for summary in of_flights]
    shared = min(len(summary.horizons) for summary in of_flights)
    # The last is the whole test part, on whatever number of horizons before it.
    places = [*range(shared - 1), -1]
    return OverFlights(
        method,
        flights=len(of_flights),
        relative=_geometric([summary.relative for summary in of_flights]),
        horizons=tuple(_geometric([summary.horizons[place].relative for summary in of_flights]) for place in places),
        inside=tuple(_mean([summary.horizons[place].inside for summary in of_flights]) for place in places),
        **{name: sum(getattr(summary, name) for summary in of_flights) for name in COUNTS},
        mspe_total=float(np.sum([summary.mspe_total for summary in of_flights])),
        reference=paired(ratios, np.ones(len(ratios))),
    )


def _mean(shares: Iterable[float | None]) -> float | None:
    """Of those that there are."""
    known = [share for share in shares if share is not None]
    return float(np.mean(known)) if known else None


def _geometric(values: Sequence[float]) -> float:
    with np.errstate(divide="ignore"):
        return float(np.exp(np.mean(np.log(values))))


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
