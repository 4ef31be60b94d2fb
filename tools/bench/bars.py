"""Bars: what forecasts of recorded flights are held to, and how far a method meets it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mavdem.comparison import PEERS, Comparison, Outcome
from mavdem.comparison.standing import over
from mavdem.windows import Window

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]

DOUBTFUL = 0.5
"""Of what the constant mean is expected to err, squared: a forecast that expects more is said to doubt itself."""


class Bar(NamedTuple):
    """One of them.

    Attributes:
        name: what is counted.
        asked: how much of it.
        reached: (horizons,) how much there is.
        shown: as what it is printed.
    """

    name: str
    asked: str
    reached: Array
    shown: str


@dataclass(frozen=True, eq=False)
class Bars:
    """How one method stands on several flights, whose windows have as many horizons.

    Errors are those of the comparison: of the test part in pieces of k steps, over the constant mean's.

    Attributes:
        comparison: of it with other methods.
        method: its name.
        without: the name of the method that is the same but for generalized coordinates, if there is one.
    """

    comparison: Comparison
    method: str
    without: str | None

    @cached_property
    def steps(self) -> tuple[int, ...]:
        """The horizons."""
        return tuple(skill.steps for skill in self._own[0].skill)

    @cached_property
    def peers(self) -> tuple[str, ...]:
        """Names of the other methods that learn a model."""
        return tuple(peer.name for peer in PEERS if peer.name in self.comparison.methods)

    @cached_property
    def over_best_peer(self) -> Array:
        """(flights, horizons): the median error over that of the peer that errs least on that flight, in hindsight."""
        return _over(self._medians(self.method), np.min([self._medians(peer) for peer in self.peers], axis=0))

    @cached_property
    def over_peers(self) -> dict[str, Array]:
        """(flights, horizons) by peer: the median error over that peer's."""
        return {peer: _over(self._medians(self.method), self._medians(peer)) for peer in self.peers}

    @cached_property
    def relative(self) -> Array:
        """(windows, horizons): the error over the constant mean's."""
        return self._relative(self.method)

    @property
    def worse(self) -> Flags:
        """(windows, horizons): whether it is worse than the constant mean."""
        return self.relative > 1

    @cached_property
    def cautioned(self) -> Flags:
        """(windows, horizons): whether the model has a caution, which is of all horizons."""
        return np.array([[bool(one.cautions)] * len(self.steps) for one in self._own])

    @cached_property
    def doubted(self) -> Flags:
        """(windows, horizons): whether the forecast expects more than ``DOUBTFUL`` of its first k samples."""
        return np.array(
            [
                [_expected(window, one, steps) > DOUBTFUL for steps in self.steps]
                for window, one in zip(self.comparison.windows, self._own, strict=True)
            ]
        )

    @cached_property
    def inside(self) -> Array:
        """(windows, H): share of the outputs of each sample in the 90 % band of the one forecast; NaN without one."""
        return np.array([_inside(window, one) for window, one in zip(self.comparison.windows, self._own, strict=True)])

    @cached_property
    def over_without(self) -> tuple[Array, Array]:
        """(flights, horizons) of medians and (windows, horizons): the error over that of :attr:`without`."""
        assert self.without is not None
        return (
            _over(self._medians(self.method), self._medians(self.without)),
            _over(self.relative, self._relative(self.without)),
        )

    def on(self, flight: str) -> Flags:
        """(windows,): which are of a flight."""
        return np.array([window.flight == flight for window in self.comparison.windows])

    def _medians(self, method: str) -> Array:
        """(flights, horizons)."""
        relative = self._relative(method)
        return np.array([np.median(relative[self.on(flight)], axis=0) for flight in self.comparison.flights])

    def _relative(self, method: str) -> Array:
        return np.array([[skill.relative for skill in one.skill] for one in self._of(method)])

    @cached_property
    def _own(self) -> list[Outcome]:
        return self._of(self.method)

    def _of(self, method: str) -> list[Outcome]:
        place = self.comparison.methods.index(method)
        return [row[place] for row in self.comparison.outcomes]

    def to_dict(self) -> dict[str, Any]:
        """The summary as plain JSON values by name, each by horizon."""
        return {"method": self.method, "steps": list(self.steps)} | {
            bar.name: bar.reached.tolist() for bar in self.summary()
        }

    def summary(self) -> list[Bar]:
        """Each bar, and beside it how many good windows are flagged like those that go wrong."""
        worse, flagged = self.worse, self.cautioned | self.doubted
        against, beside = [], []
        if self.peers:
            strongest = np.max([geometric(ratio) for ratio in self.over_peers.values()], axis=0)
            against = [
                Bar(
                    "median over the best peer's of each flight",
                    "<= 1, aim 0.8",
                    geometric(self.over_best_peer),
                    ".3g",
                ),
                Bar("median over the best single peer's", "<= 0.6", strongest, ".3g"),
            ]
        if self.without:
            better = (self.over_without[0] < 1).mean(axis=0)
            beside = [Bar(f"flights on which it beats {self.without}", ">= 90 %", better, ".0%")]
        return [
            *against,
            Bar("windows worse than the constant mean", "<= 10 %", worse.mean(axis=0), ".1%"),
            Bar("of them flagged beforehand", ">= 75 %", _share(flagged, worse), ".0%"),
            Bar("others flagged alike", "", _share(flagged, ~worse), ".0%"),
            Bar("the worst window over the constant mean", "<= 3", self.relative.max(axis=0), ".3g"),
            Bar("samples number k in the 90 % band", "85 - 95 %", share_of_samples(self.inside, self.steps), ".0%"),
            *beside,
        ]


def _over(ours: Array, theirs: Array) -> Array:
    """1 where both are infinite."""
    return np.asarray(np.vectorize(over, otypes=[float])(ours, theirs))


def geometric(ratios: Array) -> Array:
    """(horizons,): the mean over flights."""
    with np.errstate(divide="ignore"):
        return np.asarray(np.exp(np.log(ratios).mean(axis=0)))


def _share(flags: Flags, of: Flags) -> Array:
    """(horizons,) of those windows that have the flag; NaN of none."""
    with np.errstate(invalid="ignore"):
        return np.asarray((flags & of).sum(axis=0) / of.sum(axis=0))


def share_of_samples(inside: Array, steps: Sequence[int]) -> Array:
    """(horizons,): of the samples of those numbers, where there is a band; NaN where there is none at all."""
    known = inside[~np.isnan(inside[:, 0])]
    return np.asarray(known[:, np.array(steps) - 1].mean(axis=0)) if len(known) else np.full(len(steps), np.nan)


def _expected(window: Window, outcome: Outcome, steps: int) -> float:
    """What a forecast expects to err in units of the training variance, as the constant mean is expected to err 1."""
    if outcome.expected is None:
        return 0.0
    return float(np.mean(outcome.expected[:steps] / window.train.outputs.var(axis=0)))


def _inside(window: Window, outcome: Outcome) -> Array:
    """(H,)."""
    measured = window.test.outputs
    if outcome.band is None:
        return np.full(len(measured), np.nan)
    lower, upper = outcome.band
    return np.asarray(((lower <= measured) & (measured <= upper)).mean(axis=1))
