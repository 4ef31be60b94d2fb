"""OnlineWindTorque: the wind's torque of a stream, a stated delay after it acted.

The physical parameters are fitted now and then, by the learner's executor, to the latest minute. In between the
smoother of a recorded flight runs over the latest samples whenever a block of them is closed, and the samples of the
next block bring what it says of those a delay before them.
"""

from collections import deque
from collections.abc import Callable
from concurrent.futures import CancelledError, Executor, Future
from contextlib import suppress
from functools import partial
from typing import NamedTuple

import numpy as np

from mavdem.arrays import Array
from mavdem.confidence import Interval, half_width
from mavdem.dem.engine.kalman import SteadyStateFilter
from mavdem.dem.online.memory import (
    MemoryBlock,
    SampleMemory,
    drop_blocks_since,
    record_from_blocks,
)
from mavdem.dem.record import Record
from mavdem.facts.model import Refinement
from mavdem.plant.estimation import physical
from mavdem.plant.identifiability import NotIdentifiable, OmissionErrors
from mavdem.plant.parameters import Physical, rate_column
from mavdem.plant.sampled_plant import Plant, plant
from mavdem.plant.wind_torque import balanced, steady

DELAY_SECONDS = 0.25  # of the wind's torque, behind the latest sample
MEMORY_SECONDS = 60.0  # of the latest samples, which the physical parameters are fitted to
FIRST_FIT_SECONDS = 8.0
LONGEST_PAUSE_SECONDS = 20.0
"""Of samples before the first fit; and between fits at most, each otherwise with twice as many samples as the last."""
FILTER_SECONDS = 1.0  # of samples, over which the filter finds the state


class WeakenedMotors(NamedTuple):
    """Commands by which sound motors would do what weak ones do, since a time, s; with half widths of 90 %."""

    since: float
    inputs: Array  # (r,)
    band: Array  # (r,)


class WindFilter(NamedTuple):
    """Physical parameters, and what smooths the latest samples by them."""

    physical: Physical  # what it is made from
    axis: Plant  # with the wind
    steady: SteadyStateFilter  # of that
    trim: Array  # (r,) of the inputs
    constant: float  # torque that acts besides the commands, rad/s²
    balance: Array  # (r,) torque that each input's trim balances, by its effect
    column: int  # of the rate, in the outputs
    dt: float  # step, s

    def torques(self, inputs: Array, outputs: Array) -> Array:
        """Returns (T, 2) the wind's torque and the half width of its band, rad/s², of the latest samples of a segment.

        Where samples are worse predicted than usual, so is the torque known worse. What is faster than the samples is
        no wind, but what the commands do between them. Of the slopes by the motors' effects those of the answer to
        each command are taken; what turns the vehicle otherwise, or lifts it, is by motors that differ.
        """
        from scipy.signal import lfilter  # it takes half a second to import

        plant = self.physical
        moved = inputs - self.trim
        commanded = moved @ plant.effect + self.constant
        rate = outputs[:, self.column]
        smoothed = self.axis.smoothed(self.steady, commanded, plant.delay / self.dt, rate)
        errors = (rate - smoothed.states[:, 0])[-round(DELAY_SECONDS / self.dt) :]
        unusual = max(1.0, float(np.mean(errors**2)) / self.steady.F)
        between = sum(each.size**2 for each in plant.components if each.time < self.dt)
        left_out = between + (OmissionErrors.wind * plant.wind) ** 2
        keeps = np.exp(-self.dt / plant.lag)
        answered = lfilter([1 - keeps], [1, -keeps], moved, axis=0)
        change = (commanded - smoothed.states[:, 1]) / plant.lag
        slopes = np.column_stack([self.balance - answered, rate, change, change])
        variance = unusual * (smoothed.variance + left_out)
        variance += ((slopes @ plant.covariance) * slopes).sum(axis=1)
        level = self.constant + plant.effect @ self.balance
        return np.column_stack([smoothed.mean + level, half_width(variance)])


def wind_filter(record: Record, prior: Physical | None = None) -> WindFilter:
    """Returns the filter fitted to a record, with the ``prior`` of :func:`physical`.

    Raises:
        ValueError: no physical parameters can be fitted to it.
        numpy.linalg.LinAlgError: there is no steady filter for them.
    """
    fitted = physical(record, prior)
    if isinstance(fitted, NotIdentifiable):
        raise ValueError(fitted.reason)
    column = rate_column(record)
    dt = record.dt
    jumps = fitted.refinements.get(Refinement.JUMPS, 0.0)
    axis = plant(fitted.damping, fitted.lag, fitted.components, dt, jumps)
    inputs, outputs = record.segments[-1]
    trim = record.inputs.mean(axis=0)
    balance = [balanced(unit, trim, record.effect_directions) for unit in np.eye(len(trim))]
    return WindFilter(
        physical=fitted,
        axis=axis,
        steady=axis.filter(fitted.noise),
        trim=trim,
        constant=steady(outputs[:, column], (inputs - trim) @ fitted.effect, fitted.damping, dt),
        balance=np.array(balance),
        column=column,
        dt=dt,
    )


NOTHING = np.nan, np.nan


class OnlineWindTorque:
    """Fits the physical parameters to the latest blocks of samples now and then, and follows the wind's torque."""

    def __init__(
        self, memory: SampleMemory, executor: Executor | None, prior: Physical | None = None
    ) -> None:
        """Begins without a sample.

        Args:
            memory: of the latest samples, each of which is in it before :meth:`update` is called.
            executor: where the fits run; unless given, inside :meth:`add`.
            prior: the vehicle's physical parameters as of an earlier flight.
        """
        self.filter: WindFilter | None = None  # of the last fit
        self._dt = memory.dt
        self._lag = round(DELAY_SECONDS / memory.dt)
        self._memory = memory
        self._executor = executor
        self._prior = prior
        self._blocks: deque[MemoryBlock] = deque(
            maxlen=max(1, round(MEMORY_SECONDS / memory.dt / memory.block_size))
        )
        self._coming = deque[Interval]()  # of the samples of the next block
        # of sound motors, since the last gap or change of a motor
        self._inputs: deque[Array] = deque(maxlen=round(FILTER_SECONDS / memory.dt) + self._lag)
        self._weak: WeakenedMotors | None = None
        self._pending: Future[WindFilter] | None = None
        self._samples = 0
        self._next = round(FIRST_FIT_SECONDS / self._dt)
        # of the torque behind the latest sample, s
        self.delay = self._lag * self._dt

    def update(self, inputs: Array, weak: WeakenedMotors | None = None) -> Interval:
        """Takes a sample's inputs (r,); returns the torque and its half width, rad/s², or NaN.

        Nothing is fitted to samples of ``weak`` motors.
        """
        before = self._weak
        if (before and before.since) != (weak and weak.since):
            self.end_segment()
        self._weak = weak
        if weak is None:
            self._samples += 1
        else:
            self.drop_blocks_since(weak.since)
        self._inputs.append(inputs if weak is None else weak.inputs)
        return self._coming.popleft() if self._coming else NOTHING

    def end_segment(self) -> None:
        """Ends a segment, as a gap follows, or a motor has changed."""
        self._coming.clear()
        self._inputs.clear()

    def add(self, block: MemoryBlock, fits: bool = True) -> None:
        """Keeps a block that was just closed; takes what was fitted meanwhile, and ``fits`` again when due."""
        gap = (
            len(self._blocks)
            and block.end_time - self._blocks[-1].end_time > (len(block.outputs) + 1) * self._dt
        )
        self._blocks.append(block._replace(starts_segment=block.starts_segment or bool(gap)))
        if self._pending is not None and self._pending.done():
            pending = self._pending
            self._pending = None
            self._adopt(pending.result)
        if self._pending is None and fits and self._samples >= self._next:
            self._fit()
        self._follow()

    def drop_blocks_since(self, time: float) -> None:
        """Drops the samples from ``time``, s, on: they were not what they seemed to be."""
        if drop_blocks_since(self._blocks, time) and self._pending is not None:
            self._pending.cancel()
            self._pending = None

    def _fit(self) -> None:
        self._next = self._samples + min(self._samples, round(LONGEST_PAUSE_SECONDS / self._dt))
        record = record_from_blocks(self._blocks, self._dt, self._memory.effect_directions)
        if self._executor is None:
            self._adopt(partial(wind_filter, record, self._prior))
            return
        try:
            self._pending = self._executor.submit(wind_filter, record, self._prior)
        except RuntimeError:
            return  # The executor is gone; the learner says so.

    def _adopt(self, made: Callable[[], WindFilter]) -> None:
        """Takes a new filter; what was identified before is kept where the new samples identify nothing."""
        with suppress(ValueError, RuntimeError, CancelledError):  # LinAlgError is a ValueError
            new = made()
            if self.filter is None or new.physical.identifiable:
                self.filter = new

    def _follow(self) -> None:
        """What the samples of the next block bring."""
        self._coming.clear()
        number = self._inputs.maxlen or 0
        _, outputs = self._memory.latest_samples(number)
        if self.filter is None or not self.filter.physical.identifiable:
            return
        if min(len(self._inputs), len(outputs)) < number:
            return
        torques = self.filter.torques(np.array(self._inputs), outputs)[-self._lag :][
            : self._memory.block_size
        ]
        if self._weak is not None:
            unsure = np.linalg.norm(self.filter.physical.effect * self._weak.band)
            torques[:, 1] = np.hypot(torques[:, 1], unsure)
        self._coming.extend((float(torque), float(band)) for torque, band in torques)
