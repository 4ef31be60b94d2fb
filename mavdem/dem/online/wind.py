"""OnlineWind: the wind's torque of a stream, a stated delay after it acted.

The physical parameters are fitted now and then, by the learner's executor, to the latest minute. In between a steady
filter follows the samples; a fixed-lag smoother adds what the innovations of the samples after it say of the wind at an
earlier one. Its weights are the first of those of the smoother of a whole record.
"""

from __future__ import annotations

from collections import deque
from concurrent.futures import CancelledError, Executor, Future
from typing import NamedTuple

import numpy as np

from mavdem.confidence import half_width
from mavdem.dem.engine.kalman import SteadyFilter
from mavdem.dem.engine.linalg import Array
from mavdem.dem.graybox.estimation import physical
from mavdem.dem.graybox.identifiability import MODEL_ERRORS, NotIdentifiable
from mavdem.dem.graybox.likelihood import Plant, jumping, plant
from mavdem.dem.graybox.parameters import Physical, PhysicalPrior, rate_column
from mavdem.dem.graybox.wind import balanced, steady
from mavdem.dem.online.memory import Memory, MemoryBlock, drop_since, record_of
from mavdem.dem.record import Record

DELAY_SECONDS = 0.25  # of the wind's torque, behind the latest sample
MEMORY_SECONDS = 60.0  # of the latest samples, which the physical parameters are fitted to
FIRST_FIT_SECONDS, LONGEST_PAUSE_SECONDS = 8.0, 20.0
"""Of samples before the first fit; and between fits at most, each otherwise with twice as many samples as the last."""
FILTER_SECONDS = 1.0  # of samples, over which the filter finds the state
NUDGE = 1e-3  # standard deviations of the parameters, for slopes by differences
_OF_FILTER, _OF_STEP = ("transition", "gain"), ("input_now", "input_next")


class WindModel(NamedTuple):
    """The plant with the wind, and what its steady filter makes of samples, for one choice of physical parameters."""

    axis: Plant
    steady: SteadyFilter
    weights: Array  # (lag + 1,) of the innovations of a sample and those after it, in the wind's torque there
    effect: Array  # (r,) rad/s² per unit of input
    delay: float  # of commands, in steps
    constant: float  # torque that acts besides the commands, rad/s²
    level: float  # what is added to the torque that the filter finds, rad/s²


class WindFilter(NamedTuple):
    """Physical parameters as filter and fixed-lag smoother.

    Attributes:
        physical: what it is made from.
        models: by the estimate, and with the parameters ``NUDGE`` standard deviations away, along each axis of their
            uncertainty: by how much their torques differ from the estimate's is the error that the parameters leave. So
            the band is as wide as what is commanded makes it.
        trim: (r,) of the inputs.
        column: of the rate, in the outputs.
        variance: of the torque, where the parameters are true: that of the smoother, and of what the model leaves out.
    """

    physical: Physical
    models: tuple[WindModel, ...]
    trim: Array
    column: int
    variance: float


def wind_filter(record: Record, prior: Physical | PhysicalPrior | None = None) -> WindFilter:
    """Fitted to a record, with the ``prior`` of :func:`physical`.

    Raises:
        ValueError: no physical parameters can be fitted to it.
        numpy.linalg.LinAlgError: there is no steady filter for them.
    """
    found, column = physical(record, prior), rate_column(record)
    if isinstance(found, NotIdentifiable):
        raise ValueError(found.reason)
    trim, (inputs, outputs) = record.inputs.mean(axis=0), record.segments[-1]

    def model(theta: Array) -> WindModel:
        effect, (damping, lag, delay) = theta[:-3], theta[-3:].tolist()
        axis = plant(damping, lag, found.components, record.dt, found.refinements.get("jumps", 0.0))
        filtered = axis.filter(found.noise)
        weights = filtered.weights(round(DELAY_SECONDS / record.dt) + 1, axis.wind)
        constant = steady(outputs[:, column], (inputs - trim) @ effect, damping, record.dt)
        level = constant + balanced(effect, trim, record.effect_directions)
        return WindModel(axis, filtered, weights, effect, delay / record.dt, constant, level)

    theta = np.array([*found.effect, found.damping, found.lag, found.delay])
    values, axes = np.linalg.eigh(found.covariance)
    models = tuple(map(model, [theta, *(theta + NUDGE * (np.sqrt(np.maximum(values, 0.0)) * axes).T)]))
    axis, filtered, weights, *_ = models[0]
    # What is faster than the samples is no wind, but what the commands do between them.
    quick = np.concatenate([[0.0, 0.0], *([each.time < record.dt] * len(each.colour.A) for each in found.components)])
    seen = axis.stationary - filtered.covariance
    estimated, mistaken = (
        read @ seen @ read + filtered.variance * np.sum(filtered.weights(len(weights), read) ** 2)
        for read in (axis.wind, quick * axis.wind)
    )
    left = axis.wind @ axis.stationary @ axis.wind - estimated
    return WindFilter(found, models, trim, column, float(left + mistaken + (MODEL_ERRORS.wind * found.wind) ** 2))


class _Tracked:
    """The states of a filter's b models along the samples of a segment."""

    def __init__(self, of: WindFilter, dt: float, inputs: Array, outputs: Array) -> None:
        """From the latest samples of the segment, (T, r) and (T, m), on."""
        self._of, models, lag = of, of.models, len(of.models[0].weights)
        self._least = round(FILTER_SECONDS / dt) + lag
        self._effect, self._weights = np.array([each.effect for each in models]), np.array([m.weights for m in models])
        self._constant, self._level = np.array([(each.constant, each.level) for each in models]).T
        self._transition, self._gain = (np.array([getattr(m.steady, name) for m in models]) for name in _OF_FILTER)
        self._now, self._next = (np.array([getattr(m.axis.step, name)[:, 0] for m in models]) for name in _OF_STEP)
        steps = np.array([each.delay for each in models])
        self._whole = np.floor(steps).astype(np.intp)
        self._share, self._each = steps - self._whole, np.arange(len(models))
        commanded = (inputs - of.trim) @ self._effect.T + self._constant
        rate, states = outputs[:, of.column], []
        for each, torque in zip(models, commanded.T, strict=True):
            first = np.zeros(len(each.steady.gain))
            first[:2] = rate[0], torque[0]
            states.append(each.steady.predicted(each.axis.pushes(torque, each.delay), rate, first))
        path = np.array(states)
        self._state, self._number = path[:, -1], len(rate)
        # (b, …) of the latest samples, the newest last; what is before the first counts for nothing.
        self._commands = _latest(commanded.T, int(self._whole.max()) + 5)
        self._innovations = _latest(rate - path[:, :, 0], lag)
        self._winds = _latest(path @ models[0].axis.wind, lag)

    def add(self, inputs: Array, outputs: Array) -> None:
        """Takes the next sample, (r,) and (m,)."""
        of = self._of
        self._commands = _appended(self._commands, self._effect @ (inputs - of.trim) + self._constant)
        acting = jumping(self._commands[:, :, None], of.models[0].axis.jumps)[:, :, 0]
        now, before, first = (acting[self._each, -1 - later - self._whole] for later in range(3))
        early, late = ((1 - self._share) * b + self._share * a for a, b in ((first, before), (before, now)))
        push = early[:, None] * self._now + late[:, None] * self._next + self._gain * self._innovations[:, -1:]
        self._state = (self._transition @ self._state[:, :, None])[:, :, 0] + push
        self._innovations = _appended(self._innovations, outputs[of.column] - self._state[:, 0])
        self._winds = _appended(self._winds, self._state @ of.models[0].axis.wind)
        self._number += 1

    @property
    def torque(self) -> tuple[float, float]:
        """The wind's torque a lag before the latest sample, and its half width, rad/s²; NaN at the beginning."""
        if self._number < self._least:
            return np.nan, np.nan
        torques = self._winds[:, 0] + np.einsum("bl,bl->b", self._weights, self._innovations) + self._level
        by_parameters = float(np.sum((torques[1:] - torques[0]) ** 2)) / NUDGE**2
        # Where the samples after it are worse predicted than usual, so is the torque known worse.
        unusual = max(1.0, float(np.mean(self._innovations[0] ** 2)) / self._of.models[0].steady.variance)
        return float(torques[0]), float(half_width(unusual * self._of.variance + by_parameters))


def _latest(values: Array, number: int) -> Array:
    """(b, number) the latest of ``values`` (b, T); before the first of them, that one."""
    return np.pad(values, ((0, 0), (number, 0)), mode="edge")[:, -number:]


def _appended(latest: Array, values: Array) -> Array:
    """(b, K) without the oldest, and with the new ``values`` (b,) at the end."""
    return np.concatenate([latest[:, 1:], values[:, None]], axis=1)


class OnlineWind:
    """Fits the physical parameters to the latest blocks of samples now and then, and follows the wind's torque.

    Attributes:
        filter: of the last fit; ``None`` before the first.
    """

    def __init__(
        self, memory: Memory, executor: Executor | None, prior: Physical | PhysicalPrior | None = None
    ) -> None:
        """Begins without a sample.

        Args:
            memory: of the latest samples, each of which is in it before :meth:`update` is called.
            executor: where the fits run; unless given, inside :meth:`add`.
            prior: the vehicle's physical parameters as of an earlier flight; that of other inputs counts for nothing.
        """
        self.filter: WindFilter | None = None
        self._dt, self._memory, self._executor, self._prior = memory.dt, memory, executor, prior
        self._blocks: deque[MemoryBlock] = deque(maxlen=max(1, round(MEMORY_SECONDS / memory.dt / memory.block)))
        self._tracked: _Tracked | None = None
        self._pending: Future[WindFilter] | None = None
        self._samples, self._next = 0, round(FIRST_FIT_SECONDS / self._dt)
        self._paused = self._resumed = False

    @property
    def delay(self) -> float:
        """Of the torque behind the latest sample, s: ``DELAY_SECONDS`` in whole steps."""
        return round(DELAY_SECONDS / self._dt) * self._dt

    def update(self, inputs: Array, outputs: Array, weak_since: float = np.nan) -> tuple[float, float]:
        """Takes the next sample, (r,) and (m,); returns the torque and its half width, rad/s², or NaN.

        Gives and learns nothing of samples from ``weak_since``, s, on, until that is NaN again.
        """
        paused = np.isfinite(weak_since)
        if paused and not self._paused:
            self._tracked = None
            self.drop_since(weak_since)
        self._resumed |= self._paused and not paused
        self._paused = bool(paused)
        if paused:
            return np.nan, np.nan
        self._samples += 1
        if self._tracked is not None:
            self._tracked.add(inputs, outputs)
        else:
            self._follow()
        return (np.nan, np.nan) if self._tracked is None else self._tracked.torque

    def end_segment(self) -> None:
        """A gap follows."""
        self._tracked = None

    def add(self, block: MemoryBlock) -> None:
        """Keeps a block that was just closed; takes what was fitted meanwhile, and begins the next fit when due."""
        if self._paused:
            return
        self._blocks.append(block._replace(begins=block.begins or self._resumed))
        self._resumed = False
        if self._pending is not None:
            if not self._pending.done():
                return
            pending, self._pending = self._pending, None
            self._adopt(pending)
        if self._samples < self._next:
            return
        self._next = self._samples + min(self._samples, round(LONGEST_PAUSE_SECONDS / self._dt))
        record = record_of(self._blocks, self._dt, self._memory.effect_directions)
        if self._executor is None:
            pending = Future()
            try:
                pending.set_result(wind_filter(record, self._prior))
            except (ValueError, np.linalg.LinAlgError) as error:
                pending.set_exception(error)
            self._adopt(pending)
            return
        try:
            self._pending = self._executor.submit(wind_filter, record, self._prior)
        except RuntimeError:
            return  # The executor is gone; the learner says so.

    def drop_since(self, time: float) -> None:
        """Drops the samples from ``time``, s, on: they were not what they seemed to be."""
        if drop_since(self._blocks, time) and self._pending is not None:
            self._pending.cancel()
            self._pending = None

    def _adopt(self, found: Future[WindFilter]) -> None:
        try:
            self.filter = found.result()
        except (ValueError, RuntimeError, CancelledError):  # LinAlgError is a ValueError
            return
        self._follow()

    def _follow(self) -> None:
        """The filter from the latest samples on."""
        inputs, outputs = self._memory.latest(round((FILTER_SECONDS + DELAY_SECONDS) / self._dt) + 1)
        self._tracked = None
        if self.filter is not None and self.filter.physical.identifiable and len(outputs):
            self._tracked = _Tracked(self.filter, self._dt, inputs, outputs)
