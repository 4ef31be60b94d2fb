"""Following a stream with a learned model: its state, its predictions, and how well each sample agrees with them.

Bands are of the latest errors of the predictions themselves. Surprise standardises F(t) by its recent past, and marks
are where it stays above what is usual for this vehicle in this flight.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from mavdem.arrays import Array, ArrayPair
from mavdem.confidence import CONFIDENCE_LEVEL, INTERVAL_QUANTILES, MIN_SAMPLES_FOR_STATISTICS
from mavdem.dem.engine.free_energy import SampleFreeEnergy
from mavdem.dem.engine.generative import taylor_weights
from mavdem.dem.engine.linalg import ROUNDING_TOLERANCE
from mavdem.dem.engine.model import LinearModel
from mavdem.dem.fitting import Fit
from mavdem.dem.learned import Learned
from mavdem.dem.online.memory import SampleMemory

if TYPE_CHECKING:
    from mavdem.plant.parameters import Physical

BAND_SECONDS = 6.0
"""Of errors: fewer give no steady quantile, and a change of the vehicle widens bands for this long."""
MAX_MEDIANS = 12.0
"""Of a half width, in median errors. Of normal errors it is 2.4, where manoeuvres alternate with hover up to 12; a
failure gives hundreds, by errors that say nothing of the model that follows it."""

SURPRISE_SECONDS = 10.0  # of F(t), by which the next value is standardised; the distance of its lower end is the unit
MAX_QUARTILES = 3.0
"""Of the unit, in distances of the lower quartile from the median. Of normal values it is 2.4; larger ones come of a
failure that lasts, which must not hide the next."""
MIN_PAST = 100  # values of F(t) before a surprise is reported; errors kept, at however long steps

MEAN_SECONDS_BETWEEN_FALSE_MARKS = 300.0
"""Mean time between marks in a flight that goes on as before, manoeuvres included."""
EVIDENCE_SECONDS = 1.0  # s, over which the evidence is averaged
PEAK_SECONDS = 5.0  # s, of which the largest evidence is one peak
PEAKS = round(
    MEAN_SECONDS_BETWEEN_FALSE_MARKS / PEAK_SECONDS
)  # the latest that the limit is computed of
MIN_PEAKS = 3  # of fewer the limit is not computed
# scale of Gumbel's distribution of peaks, which a few that happen to be equal do not show
MIN_SPREAD = 0.09
# of no other mark: as long as the learner's memory holds what came before the change
REFRACTORY_SECONDS = 20.0

USEFUL_RATIO = 0.5  # of squared errors, below which a prediction is worth showing


class Estimate(NamedTuple):
    """Predictions, model and disturbance as of a sample; NaN, or ``None``, where there is none yet.

    H horizons, m outputs; physical units.

    Attributes:
        time: of the sample, s.
        expected: (m,) the sample, predicted from those before it and from its own inputs.
        expected_band: (m,) half width of its 90 % band: the quantile of the latest errors.
        ahead_times: (H,) times of the next two, s: the learner's horizons from here.
        ahead: (H, m) predictions of the samples then, inputs unknown, by the joint model, or the last sample before
            its first fit. From the first sample on, also without a model.
        ahead_band: (H, m) likewise, of the errors of ``ahead``.
        ahead_ratio: (H, m) squared error of ``ahead``, averaged over about 10 s, over that of the better of the last
            sample held and the mean so far; NaN before errors are known.
        seen: time of the next two, s: the centre of the latest embedding window.
        free_energy: F(t) without the prior and entropy terms of θ and λ, which are the same at every sample and change
            only with the model.
        surprise: standardised drop of F(t) below the median of its last 10 s, in units of its 5 % quantile's: above 1
            in about one of 20 samples without a change; tens to thousands of units with a failing motor.
        model: the current one.
        until: time of the last sample the model was learned from, s.
        unusual: whether this sample is marked: surprise stays above what is usual in this flight. Without a change, one
            mark in five minutes is expected; see ``AnomalyMarks``.
        wind_torque: the wind's torque, rad/s², steady part included,
            ``mavdem.plant.online_wind_torque.DELAY_SECONDS`` before this sample; by the physical
            parameters as of the last fit, NaN before the first.
        wind_torque_band: half width of its 90 % band.
        wind_time: the time it is of, s.
        physical: the physical parameters as of the last fit.
    """

    time: float
    expected: Array
    expected_band: Array
    ahead_times: Array
    ahead: Array
    ahead_band: Array
    ahead_ratio: Array
    seen: float = np.nan
    free_energy: float = np.nan
    surprise: float = np.nan
    model: LinearModel | None = None
    until: float = np.nan
    unusual: bool = False
    wind_torque: float = np.nan
    wind_torque_band: float = np.nan
    wind_time: float = np.nan
    physical: Physical | None = None

    @property
    def useful(self) -> int | None:
        """Index of the longest horizon with a mean ``ahead_ratio`` below ``USEFUL_RATIO``; ``None`` without one."""
        places = np.flatnonzero(self.ahead_ratio.mean(axis=-1) < USEFUL_RATIO)
        return int(places[-1]) if len(places) else None


class FreeEnergyMonitor(NamedTuple):
    """How well samples agree with a learned model; made where that is learned."""

    learned: Learned
    until: float  # time of the last sample it was learned from, s
    energy: SampleFreeEnergy
    past: Array  # F(t) less its priors, of the latest training data
    weights: ArrayPair  # that make derivatives of the outputs and inputs of a window

    @classmethod
    def of(cls, learned: Learned, fit: Fit, until: float) -> FreeEnergyMonitor:
        """Returns that of a result and the fit that it was made from."""
        energy = SampleFreeEnergy.from_posterior(fit.ascent.posterior)
        past = learned.free_energy_of_samples[-round(SURPRISE_SECONDS / learned.dt) :]
        settings = learned.settings
        outputs, inputs = (
            taylor_weights(order, learned.dt, settings.window, settings.window // 2)
            for order in (settings.p, settings.d)
        )
        return cls(learned, until, energy, past - energy.parameter_terms, (outputs, inputs))

    def evaluate(self, memory: SampleMemory) -> float:
        """Returns F(t) less its priors at the centre of the latest window; NaN without one."""
        window = self.learned.settings.window
        inputs, outputs = memory.latest_samples(window)
        if len(outputs) < window:
            return np.nan
        scaling = self.learned.scaling
        scaled = scaling.scale_outputs(outputs), scaling.scale_inputs(inputs)
        derivatives = (weights @ each for weights, each in zip(self.weights, scaled, strict=True))
        data = np.concatenate([each.ravel() for each in derivatives])
        states = self.learned.state_map @ data
        return (
            float(self.energy.evaluate(data[None], states[None])[0]) - self.energy.parameter_terms
        )


class ErrorBands:
    """Of predictions at several horizons, of which none had seen the sample, and of each sample by those before it.

    An error counts as long as any other, whatever its size: bands recover as soon as predictions have.
    """

    def __init__(self, horizons: int, outputs: int, dt: float) -> None:
        """Takes the numbers of ``horizons`` and of ``outputs`` m, and the sampling step ``dt``, s."""
        kept = max(round(BAND_SECONDS / dt), MIN_PAST)
        self._errors = np.full((1 + horizons, outputs, kept), np.nan)
        self._next = 0
        self.half_widths = np.full(self._errors.shape[:2], np.nan)
        """(1 + H, m): of the sample itself, and at each horizon; NaN where there are too few errors."""

    def add(self, error: Array, errors: Array) -> None:
        """Takes errors of predicting a sample, (m,) by those before it and (H, m); those not finite are ignored."""
        self._errors[0, :, self._next] = error
        self._errors[1:, :, self._next] = errors
        self._next = (self._next + 1) % self._errors.shape[2]

    def update(self) -> None:
        """Computes the half widths again; done once a block, since it takes all errors."""
        # infinity and NaN last
        sizes = np.sort(abs(self._errors))
        number = np.isfinite(sizes).sum(axis=-1, keepdims=True)
        # The next error is below the k-th of n with probability k/(n + 1).
        places = (
            np.clip(np.ceil(CONFIDENCE_LEVEL * (number + 1)).astype(int), 1, np.maximum(number, 1))
            - 1
        )
        level, median = (
            np.take_along_axis(sizes, place, axis=-1) for place in (places, number // 2)
        )
        half = np.minimum(level, MAX_MEDIANS * median)
        self.half_widths = np.where(number >= MIN_SAMPLES_FOR_STATISTICS, half, np.nan)[:, :, 0]


class Surprise:
    """Standardises F(t) by the median and the low quantile of its past.

    Not by a standard deviation: F(t) has a long lower tail, and one gust would hide the next. Each model has a level of
    F(t) of its own, so that each new one begins with the ``past`` by itself.
    """

    def __init__(self, dt: float, past: Iterable[float] = ()) -> None:
        """Begins with this ``past``, of values every ``dt`` s."""
        self._past = deque(past, max(round(SURPRISE_SECONDS / dt), 2 * MIN_PAST))
        self._median = np.nan
        self._unit = np.nan
        self.update_quantiles()

    def add(self, value: float) -> float:
        """Takes the next value; returns its distance below the median, in units of the low quantile's."""
        self._past.append(value)
        return (self._median - value) / self._unit

    def update_quantiles(self) -> None:
        """Computes the quantiles again; done once a block, since it takes the whole past."""
        if len(self._past) >= MIN_PAST:
            low, quartile, self._median = np.quantile(
                self._past, [INTERVAL_QUANTILES[0], 0.25, 0.5]
            )
            unit = min(self._median - low, MAX_QUARTILES * (self._median - quartile))
            self._unit = max(unit, ROUNDING_TOLERANCE)


class AnomalyMarks:
    """Which samples to mark: where surprise stays above what is usual for this vehicle in this flight.

    The evidence is log(1 + surprise), averaged over ``EVIDENCE_SECONDS``: a short manoeuvre gives less than a change
    that lasts, and a failure more than all. Its largest values in every ``PEAK_SECONDS`` are the vehicle's own. The
    limit is what the next of them exceeds once in ``MEAN_SECONDS_BETWEEN_FALSE_MARKS``: by Gumbel's distribution of
    largest values, whose tail is longer than a normal one, with their median and median deviation. A few peaks give no
    mark.
    """

    def __init__(self, dt: float) -> None:
        """Begins without a past, of samples every ``dt`` s."""
        self._share = min(1.0, dt / EVIDENCE_SECONDS)
        self._block, self._rest = (
            max(1, round(seconds / dt)) for seconds in (PEAK_SECONDS, REFRACTORY_SECONDS)
        )
        self._peaks: deque[float] = deque(maxlen=PEAKS)
        self._evidence = 0.0
        self._peak = 0.0
        self._limit = np.inf
        self._samples = 0
        self._marked = -np.inf

    def add(self, surprise: float) -> bool:
        """Takes a sample's surprise; returns whether to mark it, at most once in ``REFRACTORY_SECONDS``.

        A surprise that is not finite, beside a gap, is ignored.
        """
        if not np.isfinite(surprise):
            return False
        self._samples += 1
        self._evidence += self._share * (np.log1p(max(surprise, 0.0)) - self._evidence)
        self._peak = max(self._peak, self._evidence)
        mark = self._evidence > self._limit and self._samples - self._marked >= self._rest
        if mark:
            self._marked = self._samples
        if self._samples % self._block == 0:
            # A mark counts as the limit, whatever its size: one failure must not hide the next.
            self._peaks.append(min(self._peak, self._limit))
            self._peak = self._evidence
            self._limit = _limit(np.array(self._peaks))
        return bool(mark)


def _limit(peaks: Array) -> float:
    number = len(peaks)
    if number < MIN_PEAKS:
        return np.inf
    middle = np.median(peaks)
    far = np.log(np.log(2)) - np.log(-np.log(1 - PEAK_SECONDS / MEAN_SECONDS_BETWEEN_FALSE_MARKS))
    # Gumbel's median deviation is 0.767
    scale = max(np.median(abs(peaks - middle)) / 0.767, MIN_SPREAD)
    return middle + np.sqrt(1 + 1 / number) * far * scale
