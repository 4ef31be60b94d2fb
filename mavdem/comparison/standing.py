"""Standings: what a method's outcomes on many windows come to, beside the first method's.

A window's error is that of the whole test part over the constant mean's. The median over windows stands for a flight,
since one forecast that explodes would be all that a mean shows; the worst window is told beside it. Over flights, which
count alike however long they are, it is the geometric mean of these medians.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mavdem.comparison.outcome import Outcome
from mavdem.evaluate import Paired, Skill, Span, paired
from mavdem.windows import Window

Array = NDArray[np.float64]


class AtHorizon(NamedTuple):
    """A method at one horizon.

    Attributes:
        steps: of each forecast.
        relative: the median over windows of its error over the constant mean's.
        relative_per_output: likewise of each output.
        per_output: the median over windows of each output's MSPE in units of its training variance.
        reference: the first method's error over this one's.
    """

    steps: int
    relative: float
    relative_per_output: tuple[float, ...]
    per_output: tuple[float, ...]
    reference: Paired


@dataclass(frozen=True)
class Standing:
    """What a method's outcomes on one flight come to.

    Attributes:
        method: its name.
        windows: how many there are.
        failed: on how many it made no forecast.
        failure: why, the first time; empty where it always made one.
        diverged: on how many the forecast ran beyond all numbers.
        unstable: on how many the model has a mode that grows.
        mspe: (m,) mean over windows, in the squares of the outputs' units.
        mspe_total: their sum, as the paper reports it.
        relative: the median over windows of the error over the constant mean's.
        worst: the largest.
        worse_than_constant: on how many windows it is above 1.
        horizons: by horizon; the last is that of the whole test part.
        seconds: of a processor that learning took, the median.
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
            "horizons": [one._asdict() | {"reference": one.reference._asdict()} for one in self.horizons]
        }


class Loss(NamedTuple):
    """Where the first method's median error over a flight's windows is larger than another's.

    Attributes:
        flight, method: on which flight, and than whose.
        steps: at which horizon.
        ratio: its median over the other's.
        paired: window by window, which need not say the same of the middle one.
    """

    flight: str
    method: str
    steps: int
    ratio: float
    paired: Paired


@dataclass(frozen=True)
class OverFlights:
    """What a method's standings on several flights come to.

    Attributes:
        method: its name.
        flights: how many there are.
        relative: the geometric mean of the flights' medians of the error over the constant mean's.
        horizons: likewise by horizon, as far as all flights have them.
        windows: how many there are on all flights.
        failed, diverged, unstable, worse_than_constant: on how many of them, as in :class:`Standing`.
        mspe_total: the sum over flights of the total MSPE, as in the paper's table.
        reference: the first method's error over this one's, in which each flight is one pair.
    """

    method: str
    flights: int
    relative: float
    horizons: tuple[float, ...]
    windows: int
    failed: int
    diverged: int
    unstable: int
    worse_than_constant: int
    mspe_total: float
    reference: Paired

    def to_dict(self) -> dict[str, Any]:
        """As plain JSON values by name."""
        return asdict(self) | {"reference": self.reference._asdict()}


def standings(
    windows: Sequence[Window],
    methods: Sequence[str],
    outcomes: Sequence[Sequence[Outcome]],
    from_zero: bool,
) -> tuple[Standing, ...]:
    """Each method's standing on one flight, the least error first.

    Args:
        windows: of the flight.
        methods: their names, the reference first.
        outcomes: by window, and in each by method.
        from_zero: judge forecasts that begin with state 0; there are no shorter horizons then.
    """
    spans = [Span(window.flight, window.start, window.stop) for window in windows]
    by_method = list(zip(*outcomes, strict=True))
    reference = _by_horizon(by_method[0], from_zero)
    found = [
        _standing(method, own, from_zero, reference, spans) for method, own in zip(methods, by_method, strict=True)
    ]
    return tuple(sorted(found, key=lambda standing: standing.relative))


def _by_horizon(outcomes: Sequence[Outcome], from_zero: bool) -> list[list[Skill]]:
    """By horizon, and at each by window."""
    rows = [[one.skill_from_zero] if from_zero else list(one.skill) for one in outcomes]
    return [list(column) for column in zip(*rows, strict=True)]


def _standing(
    method: str, outcomes: Sequence[Outcome], from_zero: bool, reference: list[list[Skill]], spans: Sequence[Span]
) -> Standing:
    at_horizons = [
        AtHorizon(
            own[0].steps,
            float(np.median([one.relative for one in own])),
            _medians([one.relative_per_output for one in own]),
            _medians([one.per_output for one in own]),
            paired([one.relative for one in ours], [one.relative for one in own], spans),
        )
        for own, ours in zip(_by_horizon(outcomes, from_zero), reference, strict=True)
    ]
    relative = [(one.skill_from_zero if from_zero else one.skill[-1]).relative for one in outcomes]
    errors = np.array([one.mspe_from_zero if from_zero else one.mspe for one in outcomes])
    return Standing(
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


def _medians(rows: Sequence[Array]) -> tuple[float, ...]:
    return tuple(np.median(rows, axis=0).tolist())


def losses(by_flight: Mapping[str, Sequence[Standing]], reference: str) -> tuple[Loss, ...]:
    """Where the first method errs more than another, the worst first.

    Args:
        by_flight: standings of every method, by flight.
        reference: the first method's name.
    """
    found = []
    for flight, standing_of_all in by_flight.items():
        ours = next(standing for standing in standing_of_all if standing.method == reference)
        found += [
            Loss(flight, standing.method, at.steps, over(our.relative, at.relative), at.reference)
            for standing in standing_of_all
            for our, at in zip(ours.horizons, standing.horizons, strict=True)
            if our.relative > at.relative
        ]
    return tuple(sorted(found, key=lambda loss: -loss.ratio))


def over(ours: float, theirs: float) -> float:
    """How many times as large an error is as another; 1 where both are infinite, or 0."""
    return 1.0 if ours == theirs else float(np.divide(ours, theirs)) if theirs else float("inf")


def over_flights(by_flight: Mapping[str, Sequence[Standing]]) -> tuple[OverFlights, ...]:
    """Each method's standing over all flights, the least error first.

    Args:
        by_flight: standings of every method, by flight.
    """
    by_method: dict[str, list[Standing]] = {}
    for standing_of_all in by_flight.values():
        for standing in standing_of_all:
            by_method.setdefault(standing.method, []).append(standing)
    found = [_over_flights(method, of_flights) for method, of_flights in by_method.items()]
    return tuple(sorted(found, key=lambda one: one.relative))


def _over_flights(method: str, of_flights: Sequence[Standing]) -> OverFlights:
    ratios = [standing.horizons[-1].reference.ratio for standing in of_flights]
    shared = min(len(standing.horizons) for standing in of_flights)
    # The last is the whole test part, on whatever number of horizons before it.
    places = [*range(shared - 1), -1]
    return OverFlights(
        method,
        flights=len(of_flights),
        relative=_geometric([standing.relative for standing in of_flights]),
        horizons=tuple(_geometric([standing.horizons[place].relative for standing in of_flights]) for place in places),
        windows=sum(standing.windows for standing in of_flights),
        failed=sum(standing.failed for standing in of_flights),
        diverged=sum(standing.diverged for standing in of_flights),
        unstable=sum(standing.unstable for standing in of_flights),
        worse_than_constant=sum(standing.worse_than_constant for standing in of_flights),
        mspe_total=float(np.sum([standing.mspe_total for standing in of_flights])),
        reference=paired(ratios, np.ones(len(ratios))),
    )


def _geometric(values: Sequence[float]) -> float:
    with np.errstate(divide="ignore"):
        return float(np.exp(np.mean(np.log(values))))
