"""OnlineWind: the wind's torque of a stream, a stated delay after it acted.

The physical parameters are fitted now and then, by the learner's executor, to the latest minute. In between a steady
filter follows the samples; a fixed-lag smoother adds what the innovations of the samples after it say of the wind at an
earlier one. Its weights are the first of those of the smoother of a whole record.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from concurrent.futures import CancelledError, Executor, Future
from functools import partial
from typing import NamedTuple

import numpy as np
from scipy.signal import lfilter

from mavdem.confidence import half_width
from mavdem.dem.engine.kalman import SteadyFilter
from mavdem.dem.engine.linalg import Array
from mavdem.dem.graybox.estimation import physical
from mavdem.dem.graybox.identifiability import MODEL_ERRORS, NotIdentifiable
from mavdem.dem.graybox.likelihood import Plant, plant
from mavdem.dem.graybox.parameters import Physical, rate_column
from mavdem.dem.graybox.wind import balanced, steady
from mavdem.dem.online.memory import Memory, MemoryBlock, drop_since, record_of
from mavdem.dem.record import Record
from mavdem.facts.model import Refinement

DELAY_SECONDS = 0.25  # of the wind's torque, behind the latest sample
MEMORY_SECONDS = 60.0  # of the latest samples, which the physical parameters are fitted to
FIRST_FIT_SECONDS = 8.0
LONGEST_PAUSE_SECONDS = 20.0
"""Of samples before the first fit; and between fits at most, each otherwise with twice as many samples as the last."""
FILTER_SECONDS = 1.0  # of samples, over which the filter finds the state


class WindFilter(NamedTuple):
    """Physical parameters as filter and fixed-lag smoother."""

    physical: Physical  # what it is made from
    axis: Plant  # with the wind
    steady: SteadyFilter  # of that
    # (lag + 1,) of the innovations of a sample and those after it, in the wind's torque there
    weights: Array
    trim: Array  # (r,) of the inputs
    constant: float  # torque that acts besides the commands, rad/s²
    level: float  # what is added to the torque that the filter finds, rad/s²
    column: int  # of the rate, in the outputs
    # of the torque by true parameters: of the smoother, and of what the model leaves out
    variance: float
    balance: Array  # (r,) slopes of the level by the effect of each input
    covariance: Array  # (r + 3, r + 3) of the effects, damping, lag and delay


def wind_filter(record: Record, prior: Physical | None = None) -> WindFilter:
    """Fitted to a record, with the ``prior`` of :func:`physical`.

    Raises:
        ValueError: no physical parameters can be fitted to it.
        numpy.linalg.LinAlgError: there is no steady filter for them.
    """
    found = physical(record, prior)
    column = rate_column(record)
    dt = record.dt
    if isinstance(found, NotIdentifiable):
        raise ValueError(found.reason)
    jumps = found.refinements.get(Refinement.JUMPS, 0.0)
    axis = plant(found.damping, found.lag, found.components, dt, jumps)
    filtered = axis.filter(found.noise)
    (inputs, outputs) = record.segments[-1]
    trim = record.inputs.mean(axis=0)
    weights = filtered.weights(round(DELAY_SECONDS / dt) + 1, axis.wind)
    constant = steady(outputs[:, column], (inputs - trim) @ found.effect, found.damping, dt)
    level = constant + balanced(found.effect, trim, record.effect_directions)
    variance = axis.wind @ filtered.covariance @ axis.wind - filtered.variance * weights @ weights
    # What is faster than the samples is no wind, but what the commands do between them.
    variance += (
        sum(each.size**2 for each in found.components if each.time < dt)
        + (MODEL_ERRORS.wind * found.wind) ** 2
    )
    balance = [balanced(one, trim, record.effect_directions) for one in np.eye(len(trim))]
    return WindFilter(
        physical=found,
        axis=axis,
        steady=filtered,
        weights=weights,
        trim=trim,
        constant=constant,
        level=level,
        column=column,
        variance=float(variance),
        balance=np.array(balance),
        covariance=found.covariance,
    )


class _Tracked:
    """The state of a filter along the samples of a segment."""

    def __init__(
        self,
        of: WindFilter,
        dt: float,
        inputs: Array,
        outputs: Array,
    ) -> None:
        """From the latest samples of the segment, (T, r) and (T, m), on."""
        self._of, lag = of, len(of.weights)
        self._steps = of.physical.delay / dt
        self._least = round(FILTER_SECONDS / dt) + lag
        commanded = (inputs - of.trim) @ of.physical.effect + of.constant
        rate = outputs[:, of.column]
        first = np.zeros(len(of.steady.gain))
        first[:2] = rate[0], commanded[0]
        states = of.steady.predicted(of.axis.pushes(commanded, self._steps), rate, first)
        self._state, self._number = states[-1], len(states)
        self._commands = deque(commanded.tolist(), maxlen=int(np.ceil(self._steps)) + 5)
        self._innovations = deque((rate - states[:, 0]).tolist(), maxlen=lag)
        self._winds = deque((states @ of.axis.wind).tolist(), maxlen=lag)
        self._keeps = float(np.exp(-dt / of.physical.lag))
        moved = inputs - of.trim
        answered = lfilter([1 - self._keeps], [1, -self._keeps], moved, axis=0)
        self._answer = answered[-1]
        self._slopes = deque(self._slopes_of(answered.T, commanded, states.T).T, maxlen=lag)

    def add(self, inputs: Array, outputs: Array) -> None:
        """Takes the next sample, (r,) and (m,)."""
        of = self._of
        self._commands.append(float((inputs - of.trim) @ of.physical.effect) + of.constant)
        push = of.axis.pushes(np.array(self._commands), self._steps)[-1]
        self._state = of.steady.step(self._state, push, self._innovations[-1])
        self._innovations.append(float(outputs[of.column] - self._state[0]))
        self._winds.append(float(of.axis.wind @ self._state))
        self._answer = self._keeps * self._answer + (1 - self._keeps) * (inputs - of.trim)
        self._slopes.append(self._slopes_of(self._answer, self._commands[-1], self._state))
        self._number += 1

    def _slopes_of(self, answer: Array, commanded: Array | float, states: Array) -> Array:
        """(r + 3, …) slopes of the wind's torque by the effects, damping, lag and delay.

        The ``answer`` (r, …) is what the motors do beside their trim; ``states`` are (n, …). What turns the vehicle
        otherwise, or lifts it, is by motors that differ, whose effects alone are known badly.
        """
        change = (commanded - states[1]) / self._of.physical.lag
        effects = (self._of.balance - answer.T).T
        return np.array([*effects, states[0], change, change])

    @property
    def torque(self) -> tuple[float, float]:
        """The wind's torque a lag before the latest sample, and its half width, rad/s²; NaN at the beginning."""
        if self._number < self._least:
            return np.nan, np.nan
        of = self._of
        innovations = np.array(self._innovations)
        slopes = self._slopes[0]
        # Where the samples after it are worse predicted than usual, so is the torque known worse.
        unusual = max(1.0, float(innovations @ innovations) / len(innovations) / of.steady.variance)
        variance = unusual * of.variance + float(slopes @ of.covariance @ slopes)
        return self._winds[0] + float(of.weights @ innovations) + of.level, float(
            half_width(variance)
        )


class OnlineWind:
    """Fits the physical parameters to the latest blocks of samples now and then, and follows the wind's torque."""

    def __init__(
        self, memory: Memory, executor: Executor | None, prior: Physical | None = None
    ) -> None:
        """Begins without a sample.

        Args:
            memory: of the latest samples, each of which is in it before :meth:`update` is called.
            executor: where the fits run; unless given, inside :meth:`add`.
            prior: the vehicle's physical parameters as of an earlier flight.
        """
        self.filter: WindFilter | None = None  # of the last fit
        self._dt = memory.dt
        self._memory = memory
        self._executor = executor
        self._prior = prior
        self._blocks: deque[MemoryBlock] = deque(
            maxlen=max(1, round(MEMORY_SECONDS / memory.dt / memory.block))
        )
        self._tracked: _Tracked | None = None
        self._pending: Future[WindFilter] | None = None
        self._samples, self._next = 0, round(FIRST_FIT_SECONDS / self._dt)
        # of the torque behind the latest sample, s
        self.delay = round(DELAY_SECONDS / self._dt) * self._dt

    def update(
        self, inputs: Array, outputs: Array, weak_since: float = np.nan
    ) -> tuple[float, float]:
        """Takes a sample, (r,) and (m,); returns the torque and its half width, rad/s², NaN while a motor is weak."""
        if np.isfinite(weak_since):
            self._tracked = None
            self.drop_since(weak_since)
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

    def add(self, block: MemoryBlock, fits: bool = True) -> None:
        """Keeps a block that was just closed; takes what was fitted meanwhile, and ``fits`` again when due."""
        gap = (
            len(self._blocks)
            and block.until - self._blocks[-1].until > (len(block.outputs) + 1) * self._dt
        )
        self._blocks.append(block._replace(begins=block.begins or bool(gap)))
        if self._pending is not None:
            if not self._pending.done():
                return
            pending = self._pending
            self._pending = None
            self._adopt(pending.result)
        if self._samples < self._next or not fits:
            return
        self._next = self._samples + min(self._samples, round(LONGEST_PAUSE_SECONDS / self._dt))
        record = record_of(self._blocks, self._dt, self._memory.effect_directions)
        if self._executor is None:
            self._adopt(partial(wind_filter, record, self._prior))
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

    def _adopt(self, found: Callable[[], WindFilter]) -> None:
        try:
            self.filter = found()
        except (ValueError, RuntimeError, CancelledError):  # LinAlgError is a ValueError
            return
        self._follow()

    def _follow(self) -> None:
        """The filter from the latest samples on."""
        inputs, outputs = self._memory.latest(
            round((FILTER_SECONDS + DELAY_SECONDS) / self._dt) + 1
        )
        self._tracked = None
        if self.filter is not None and self.filter.physical.identifiable and len(outputs):
            self._tracked = _Tracked(self.filter, self._dt, inputs, outputs)
