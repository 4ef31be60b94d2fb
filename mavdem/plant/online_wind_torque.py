"""Online estimate of the wind torque in a telemetry stream, a fixed delay behind the latest sample.

The physical parameters are fitted from time to time to the samples of the last minute, in the learner's executor. In
between, the smoother of recorded flights runs over the latest samples whenever a block of them is complete. The
estimates for the samples of that block, each ``DELAY_SECONDS`` old, are then returned with the samples of the next one.

While a motor has lost thrust there is no estimate, as in recorded flights: what the other motors then balance is the
thrust that it lacks, and not wind.
"""

from collections import deque
from collections.abc import Callable
from concurrent.futures import CancelledError, Executor, Future
from contextlib import suppress
from functools import partial
from typing import NamedTuple

import numpy as np

from mavdem.arrays import Array
from mavdem.confidence import (
    CONFIDENCE_LEVEL,
    EstimateWithHalfWidth,
    coverage_factor,
    half_width,
)
from mavdem.dem.engine.kalman import SteadyStateFilter
from mavdem.dem.engine.model import scalar_recursion
from mavdem.dem.online.memory import (
    MemoryBlock,
    SampleMemory,
    drop_blocks_since,
    record_from_blocks,
)
from mavdem.dem.record import Record
from mavdem.facts.model import Refinement
from mavdem.plant.estimation import physical
from mavdem.plant.gusts import MAX_ERROR_SHARE
from mavdem.plant.identifiability import NotIdentifiable, OmissionErrors
from mavdem.plant.parameters import Physical
from mavdem.plant.sampled_plant import SampledPlant, sampled_plant
from mavdem.plant.wind_torque import mean_external_torque, torque_balanced_by_trim
from mavdem.plant.windows import rate_column

DELAY_SECONDS = 0.25
"""Age of the samples whose wind torque is estimated, s: a choice. Smoothing needs samples after them."""

MEMORY_SECONDS = 60.0
"""Length of the latest samples that the physical parameters are fitted to, s: a choice."""

FIRST_FIT_SECONDS = 8.0
"""Length of samples before the first fit, s: a choice, one window of the gray-box fit."""

MAX_FIT_PAUSE_SECONDS = 20.0
"""Longest time between two fits, s: a choice. Until then, each fit waits for twice as many samples as the last."""

FILTER_SECONDS = 1.0
"""Length of samples, beside the delay, over which the filter converges to the state, s: a choice."""

NO_TORQUE = EstimateWithHalfWidth(np.nan, half_width=np.nan)
"""Torque and half width if there is no estimate."""


class WindTorqueSmoother(NamedTuple):
    """Smoother of the wind torque in the latest samples of a stream, for given physical parameters."""

    physical: Physical
    """The physical parameters."""

    plant: SampledPlant
    """The sampled axis with its wind torque, by these parameters."""

    rate_filter: SteadyStateFilter
    """Steady-state Kalman filter of the plant."""

    trim: Array
    """Mean inputs (r,) of the samples that were fitted."""

    constant: float
    """Mean torque per inertia that the motors do not cause, rad/s²."""

    trim_torque_gradient: Array
    """Derivatives (r,) by each input's effect of the torque that the trim balances, in units of the inputs."""

    rate_column: int
    """Column of the rate in the outputs."""

    dt: float
    """Time step, s."""

    def torques(self, inputs: Array, outputs: Array) -> Array:
        """Estimates the wind torque in the latest T samples of one segment, with its 90 % band.

        The wind torque is the torque on the axis that the motors do not explain. A Kalman smoother with the
        model of the axis estimates it from the rate. The squared band is the sum of the squares of these errors:

        - the error of the smoother, enlarged while the errors of the predicted rate are larger than usual;
        - wind torque that changes within a sample, which cannot be distinguished from commands between samples;
        - the error by what the model leaves out;
        - the uncertainty of the physical parameters, through the derivatives of the torque by effects, damping, lag
          and delay. The effect of a motor acts through the lagged response to its command, and through the steady
          torque that its mean command (trim) balances.

        Args:
            inputs: inputs (T, r), in the unit of the record that was fitted.
            outputs: outputs (T, m), with the rate, rad/s, in one column.

        Returns:
            Torque and half width of its band (T, 2), rad/s².
        """
        parameters = self.physical
        # The constant torque acts like a steady command.
        deviation = inputs - self.trim
        commanded_torque = deviation @ parameters.effect + self.constant
        rate = outputs[:, self.rate_column]
        smoothed_torque = self.plant.smooth_wind_torque(
            self.rate_filter, commanded_torque, parameters.delay / self.dt, rate
        )

        latest_samples = slice(-round(DELAY_SECONDS / self.dt), None)
        # State 0 is the rate. Its mean squared error in the latest samples, divided by the variance F that the filter
        # expects, shows whether the model is currently valid. A ratio below 1 may be due to chance, and does not narrow
        # the band.
        errors = (rate - smoothed_torque.states[:, 0])[latest_samples]
        error_ratio = max(1.0, float(np.mean(errors**2)) / self.rate_filter.F)
        unresolved_variance = sum(
            component.size**2 for component in parameters.components if component.time < self.dt
        )
        omission_variance = unresolved_variance + (OmissionErrors.wind * parameters.wind) ** 2
        smoother_variance = self.rate_filter.smoothed_variance(len(rate), self.plant.wind_output)
        variance = error_ratio * (smoother_variance + omission_variance)

        # State 1 is the torque of the motors.
        gradient = self._torque_gradient(
            deviation, rate, commanded_torque, smoothed_torque.states[:, 1]
        )
        variance += ((gradient @ parameters.covariance) * gradient).sum(axis=1)
        # The smoother estimates the wind torque about its mean, since the mean is contained in the commanded torque.
        mean = self.constant + parameters.effect @ self.trim_torque_gradient
        return np.column_stack([smoothed_torque.mean + mean, half_width(variance)])

    def _torque_gradient(
        self, deviation: Array, rate: Array, commanded_torque: Array, motor_torque: Array
    ) -> Array:
        """Returns the derivatives of the estimated wind torque by the physical parameters, approximately.

        The wind torque is what the motors do not explain: dp/dt + damping · p − motor torque, with the body rate p. So
        its derivative by the damping is p, and by the other parameters it is minus the derivative of the motor torque,
        which is the effects times the delayed and lagged inputs.

        Args:
            deviation: inputs less their trim (T, r).
            rate: body rate (T,), rad/s.
            commanded_torque: commanded torque per inertia (T,), rad/s².
            motor_torque: torque of the motors per inertia (T,), rad/s².

        Returns:
            Derivatives (T, r + 3) by effects, damping, lag and delay.
        """
        lag = self.physical.lag
        # The commands after the first-order lag of the motors.
        decay = np.exp(-self.dt / lag)
        lagged_columns = []
        for command in deviation.T:
            lagged_columns.append(scalar_recursion(decay, (1 - decay) * command, start=0.0))
        lagged_inputs = np.column_stack(lagged_columns)
        # The torque of the motors approaches the commanded one at this rate, rad/s³. A lag that is longer by a little
        # reduces their torque by this rate times the difference, and so does a longer delay, approximately.
        torque_change = (commanded_torque - motor_torque) / lag
        # The mean inputs are balanced by a steady wind torque, which changes with the effects as well.
        by_effects = self.trim_torque_gradient - lagged_inputs
        return np.column_stack([by_effects, rate, torque_change, torque_change])


def is_torque_resolved(physical: Physical, half_width_of_band: float) -> bool:
    """Returns whether an online estimate of the wind torque is good enough to be shown, by the same rule as for logs.

    The effectiveness of the motors must be identifiable, and the variance of the estimate's error at most
    ``MAX_ERROR_SHARE`` times the variance of the estimate over time. The latter is the variance of the modelled wind
    torque less the variance of the error, as for any optimal estimate.

    Args:
        physical: control effectiveness, damping, motor time constant and delay of the axis.
        half_width_of_band: half width of the 90 % band of the torque, rad/s².
    """
    error_variance = (half_width_of_band / coverage_factor(CONFIDENCE_LEVEL)) ** 2
    estimate_variance = physical.wind**2 - error_variance
    return physical.identifiable and error_variance <= MAX_ERROR_SHARE * estimate_variance


def fit_wind_torque_smoother(record: Record, prior: Physical | None = None) -> WindTorqueSmoother:
    """Fits the physical parameters to the latest samples, and prepares the smoother of the wind torque with them.

    The physical parameters are the effect of each input on the angular acceleration, the rate damping, and lag and
    delay of the motors. Everything that does not change until the next fit is computed here: the discretised plant, its
    Kalman filter, the mean inputs and the steady torque. This takes the most time, and can run in an executor.

    Args:
        record: the latest samples of the stream.
        prior: physical parameters from an earlier flight; None without one.

    Returns:
        The smoother, for the next samples of the stream.

    Raises:
        ValueError: no physical parameters can be fitted to the record.
        numpy.linalg.LinAlgError: there is no steady-state filter for them.
    """
    fitted_parameters = physical(record, prior)
    if isinstance(fitted_parameters, NotIdentifiable):
        raise ValueError(fitted_parameters.reason)
    column = rate_column(record)
    dt = record.dt
    jump_advance = fitted_parameters.refinements.get(Refinement.JUMPS, 0.0)
    plant = sampled_plant(
        fitted_parameters.damping,
        fitted_parameters.lag,
        fitted_parameters.components,
        dt,
        jump_advance,
    )
    trim = record.inputs.mean(axis=0)
    # The balanced torque is linear in the effects, so unit effects give its derivatives.
    trim_torque_gradient = [
        torque_balanced_by_trim(unit_effect, trim, record.effect_directions)
        for unit_effect in np.eye(len(trim))
    ]
    # The steady torque is that of the last segment, which the next samples of the stream continue.
    inputs, outputs = record.segments[-1]
    commanded_torque = (inputs - trim) @ fitted_parameters.effect
    return WindTorqueSmoother(
        physical=fitted_parameters,
        plant=plant,
        rate_filter=plant.rate_filter(fitted_parameters.noise),
        trim=trim,
        constant=mean_external_torque(
            outputs[:, column], commanded_torque, fitted_parameters.damping, dt
        ),
        trim_torque_gradient=np.array(trim_torque_gradient),
        rate_column=column,
        dt=dt,
    )


class OnlineWindTorque:
    """Follows the wind torque of a stream, and refits the physical parameters to its latest samples from time to time.

    Attributes:
        smoother: the smoother by the last fit; ``None`` before the first.
        delay: time of the estimated torque behind the latest sample, s.
    """

    def __init__(
        self, memory: SampleMemory, executor: Executor | None, prior: Physical | None = None
    ) -> None:
        """Begins without a sample.

        Args:
            memory: memory of the latest samples; each sample is in it before :meth:`update` is called.
            executor: executor of the fits; without one, they run inside :meth:`add`.
            prior: physical parameters of the vehicle by an earlier flight; ``None`` without one.
        """
        self.smoother: WindTorqueSmoother | None = None
        self._dt = memory.dt
        self._delay_samples = round(DELAY_SECONDS / memory.dt)
        self.delay = self._delay_samples * self._dt
        self._memory = memory
        self._executor = executor
        self._prior = prior
        memory_blocks = round(MEMORY_SECONDS / memory.dt / memory.block_size)
        self._blocks: deque[MemoryBlock] = deque(maxlen=max(1, memory_blocks))
        # Torques with half widths that the samples of the next block will return.
        self._upcoming = deque[EstimateWithHalfWidth]()
        # Inputs since the last gap or change of a motor.
        self._smoothed_samples = round(FILTER_SECONDS / memory.dt) + self._delay_samples
        self._inputs: deque[Array] = deque(maxlen=self._smoothed_samples)
        self._weak_since: float | None = None
        self._pending: Future[WindTorqueSmoother] | None = None
        # Number of samples of sound motors so far, and that at which the next fit is due.
        self._sample_count = 0
        self._next_fit = round(FIRST_FIT_SECONDS / self._dt)

    def update(self, inputs: Array, weak_since: float | None = None) -> EstimateWithHalfWidth:
        """Processes the inputs of the stream's next sample, and returns the wind torque ``delay`` seconds before it.

        While a motor is weak there is no estimate, and the samples since its loss of thrust are not used in any fit.

        Args:
            inputs: inputs of the sample (r,).
            weak_since: time since which a motor has lost thrust, s on the stream's clock; ``None`` if all are sound.

        Returns:
            Torque and half width of its 90 % band, rad/s²; NaN without an estimate.
        """
        if self._weak_since != weak_since:
            self.end_segment()
        self._weak_since = weak_since
        if weak_since is not None:
            self.drop_blocks_since(weak_since)
            return NO_TORQUE
        self._sample_count += 1
        self._inputs.append(inputs)
        # The torques for the next samples were estimated together, when the last block was complete.
        if not self._upcoming:
            return NO_TORQUE
        return self._upcoming.popleft()

    def end_segment(self) -> None:
        """Ends a segment, because a gap follows or a motor has changed: later samples are smoothed by themselves."""
        self._upcoming.clear()
        self._inputs.clear()

    def add(self, block: MemoryBlock, may_start_fit: bool = True) -> None:
        """Adds a complete block of samples, and updates the estimates.

        The result of a fit that has ended meanwhile is adopted, another fit is started if it is due, and the wind
        torque of the latest samples is smoothed with the newest fit.

        Args:
            block: the block of samples that the memory has just completed.
            may_start_fit: whether a new fit of the physical parameters may start.
        """
        follows_gap = False
        if self._blocks:
            # If blocks were dropped in between, more time has passed than this block lasts. One step of tolerance is
            # for rounded stamps.
            elapsed_time = block.end_time - self._blocks[-1].end_time
            follows_gap = elapsed_time > (len(block.outputs) + 1) * self._dt
        starts_segment = block.starts_segment or bool(follows_gap)
        self._blocks.append(block._replace(starts_segment=starts_segment))
        # A fit that has ended is adopted before another may start.
        if self._pending is not None and self._pending.done():
            pending = self._pending
            self._pending = None
            self._adopt_fit(pending.result)
        if self._pending is None and may_start_fit and self._sample_count >= self._next_fit:
            self._start_fit()
        self._smooth_latest()

    def drop_blocks_since(self, time: float) -> None:
        """Removes the samples since a time, when the vehicle was not sound or not in flight, so that no fit uses them.

        A fit in another process that may have used them is cancelled.

        Args:
            time: the time, s on the stream's clock.
        """
        has_dropped_blocks = drop_blocks_since(self._blocks, time)
        if has_dropped_blocks and self._pending is not None:
            self._pending.cancel()
            self._pending = None

    def _start_fit(self) -> None:
        """Starts a fit of the physical parameters to all remembered blocks, and schedules the next one.

        With an executor the fit runs in the background: :meth:`add` adopts its result when it has ended. Without one it
        runs in this call, and its result is adopted at once.
        """
        # The number of samples between fits doubles, up to the longest pause: early fits gain most by more samples.
        pause = min(self._sample_count, round(MAX_FIT_PAUSE_SECONDS / self._dt))
        self._next_fit = self._sample_count + pause
        record = record_from_blocks(self._blocks, self._dt, self._memory.effect_directions)
        if self._executor is None:
            self._adopt_fit(partial(fit_wind_torque_smoother, record, self._prior))
            return
        try:
            self._pending = self._executor.submit(fit_wind_torque_smoother, record, self._prior)
        except RuntimeError:
            # The executor has been shut down; the learner reports it.
            return

    def _adopt_fit(self, fit_result: Callable[[], WindTorqueSmoother]) -> None:
        """Adopts the result of a fit, unless it failed, or does not identify the effect although an earlier fit did.

        Args:
            fit_result: function that returns the smoother, or raises the error of the fit.
        """
        # LinAlgError is a ValueError.
        with suppress(ValueError, RuntimeError, CancelledError):
            smoother = fit_result()
            if self.smoother is None or smoother.physical.identifiable:
                self.smoother = smoother

    def _smooth_latest(self) -> None:
        """Estimates the wind torque in the latest samples, and queues the estimates for the next samples of the stream.

        As the smoother is slow, it runs once for each block of samples, and queues as many torques as the next block
        has samples. Each call of :meth:`update` then returns one from the queue. Each returned torque is ``delay``
        seconds old, because the smoother needs samples after a torque to estimate it well.

        Nothing is queued if the control effectiveness is not identifiable, or while the segment is too short.
        """
        self._upcoming.clear()
        smoother = self.smoother
        if smoother is None or not smoother.physical.identifiable:
            return
        _, outputs = self._memory.latest_samples(self._smoothed_samples)
        if min(len(self._inputs), len(outputs)) < self._smoothed_samples:
            return
        torques = smoother.torques(np.array(self._inputs), outputs)
        # The first queued torque is ``delay`` old now. Those after it will be as old when they are returned.
        delayed_torques = torques[-self._delay_samples :]
        for torque, band in delayed_torques[: self._memory.block_size]:
            self._upcoming.append(EstimateWithHalfWidth(float(torque), half_width=float(band)))
