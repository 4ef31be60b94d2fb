"""Summaries of a method's outcomes over the windows of a flight, and over flights, beside the first method's.

The error ratio of a window is that of the whole test part: its error over that of the constant mean. A flight has the
median over its windows, because a mean would show one diverged forecast only, and the worst window beside it. Over
flights it is the geometric mean of these medians, so that each flight counts once.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any, NamedTuple

import numpy as np

from mavdem.comparison.outcome import Outcome
from mavdem.evaluate import Paired, Skill, Span, paired
from mavdem.evaluate.windows import Window

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
