"""The online learner: it learns the same model as ``learn`` from a stream, and predicts every sample meanwhile.

``learn`` runs in an executor on the samples in the memory. It runs again when enough new samples have come to
change its result, or after an unusual sample. Between the calls every sample is predicted, and compared with the newest
model.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import BrokenExecutor, CancelledError, Executor, Future, wait
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from mavdem.arrays import Array
from mavdem.dem.forecast.joint import known_axis_mixer
from mavdem.dem.learned import Learned
from mavdem.dem.learning import MIN_SAMPLES, learn
from mavdem.dem.online.anomaly_marks import AnomalyMarks
from mavdem.dem.online.error_bands import ErrorBands
from mavdem.dem.online.estimate import Estimate, SurpriseMark
from mavdem.dem.online.forecaster import OnlineForecaster
from mavdem.dem.online.free_energy_monitor import FreeEnergyMonitor, Surprise
from mavdem.dem.online.learner_arguments import (
    DEFAULT_HORIZONS,
    checked_row,
    is_same_mixer,
    validated_horizons,
)
from mavdem.dem.online.memory import SampleMemory, drop_blocks_since
from mavdem.dem.online.surprise_cause import (
    CAUSE_SECONDS,
    REFERENCE_SECONDS,
    cause_of_surprise,
)
from mavdem.dem.record import Record
from mavdem.dem.settings import Settings
from mavdem.dem.validation import (
    MAX_ABS_VALUE,
    is_number,
    validated_count,
    validated_directions,
    validated_step,
)
from mavdem.errors import NotLearnable, fact_from_error
from mavdem.facts import Fact
from mavdem.facts.online import OnlineFact, SurpriseCause

if TYPE_CHECKING:
    from mavdem.plant.parameters import Physical

MEMORY_BLOCK_SECONDS = 0.1
"""Length of the blocks in which samples are remembered and forgotten, s; a choice."""

LEARNING_SECONDS = 2.0
"""Length of the samples before the first call of ``learn``, and least time between two calls in flight, s; a choice.

After a landing the last samples before it are learned from at once.
"""

NEW_SAMPLE_FRACTION = 1.0
"""Samples since the last call of ``learn``, as a fraction of those it had, with which it is called again; a choice.

Samples double from call to call, until the memory is full and each call has new samples only. Half as many new samples
would cost nearly twice the processor time. Predictions do not depend on it: they come from a separate forecaster,
which learns from every block.
"""

FULL_RATE_SAMPLES = 2000
"""Most samples in the memory with which ``learn`` may be called every ``LEARNING_SECONDS``.

A call with as many takes up to a tenth of that time. With more samples, the calls are as many times farther apart, also
after an unusual sample.
"""

MAX_STEP_DEVIATION = 0.5
"""Deviation of a step from ``dt``, in units of ``dt``, beyond which there is a gap."""

MAX_GAPS = 5
"""Gaps from sample to sample in a row, from which on ``dt`` is assumed to be wrong, instead of missing samples."""

TOO_FEW_SAMPLES = Fact(OnlineFact.TOO_FEW_SAMPLES_YET)
"""Reason of no model: there are fewer samples than a fit needs."""

FIRST_FIT_RUNNING = Fact(OnlineFact.FIRST_LEARNING)
"""Reason of no model: the first fit is still being computed."""


class _Sample(NamedTuple):
    """One checked sample of the stream."""

    time: float
    """Time of the sample, s."""

    inputs: Array
    """(r,) motor outputs."""

    outputs: Array
    """(m,) measured motion."""


def _learn_and_monitor(record: Record, settings: Settings, end_time: float) -> FreeEnergyMonitor:
    """Learns a model of a record, and prepares everything that the learner needs of it; runs in the executor.

    Args:
        record: The samples in the memory.
        settings: Order, embedding, noise, priors and iterations of the fit.
        end_time: Time of the last sample of the record, s.

    Returns:
        The monitor, which contains the model. If the executor uses other processes, the monitor is pickled.

    Raises:
        ValueError: The samples do not support a model.
    """
    learned = learn(record, settings)
    # The joint model is computed at its first access. That is here, so that samples do not wait for it later.
    learned.joint  # noqa: B018
    return FreeEnergyMonitor.from_model(learned, end_time)


class OnlineLearner:
    """Learns a model from samples as they arrive, from any source, and returns estimates for each of them.

    Attributes:
        horizons: Steps ahead of ``Estimate.ahead``.
        learned: The model in use, the result of the last call of ``learn``; None before.
        training_end_time: Time of the last sample that it was learned from, s; NaN before.
        refits: Whether the model is fitted again when that is due; a caller under load may put that off.
        fits_physical: Whether the physical parameters are fitted again as well.
        follows_torque: Whether samples are used for the wind torque, too: not in a climb after take-off.
        no_model_reason: Why there is no model, or why the latest samples give no newer one; None if nothing is wrong.
    """

    def __init__(
        self,
        settings: Settings | None = None,
        dt: float = 0.01,
        n_inputs: int = 4,
        n_outputs: int = 2,
        memory: float = 20.0,
        horizons: tuple[int, ...] = DEFAULT_HORIZONS,
        executor: Executor | None = None,
        effect_directions: ArrayLike | None = None,
        prior: Physical | None = None,
    ) -> None:
        """Begins without samples.

        Args:
            settings: Settings of the fit; None for ``Settings()``.
            dt: Sampling step, s.
            n_inputs: Number of inputs, r.
            n_outputs: Number of outputs, m.
            memory: Length of the samples that the model is fitted to, s; older ones are dropped.
            horizons: Steps ahead to predict, increasing.
            executor: Executor of processes where ``learn`` runs. Unless given, it runs inside an update, which then
                takes as long. With an executor of threads an update may wait for them.
            effect_directions: (r,) relative effect of each input on the axis, if the mixer geometry is known.
            prior: Physical parameters of the vehicle as of an earlier flight, such as ``Learned.physical``.

        Raises:
            ValueError: An argument does not fit; the message names it.
        """
        self._dt = validated_step(dt)
        self._n_inputs = validated_count(n_inputs, "n_inputs")
        self._n_outputs = validated_count(n_outputs, "n_outputs")
        self.horizons = validated_horizons(horizons)
        block_size = max(1, round(MEMORY_BLOCK_SECONDS / dt))
        # A memory that is no finite number of blocks is refused like one that is too short.
        max_blocks = 0
        if is_number(memory) and np.isfinite(memory / dt):
            max_blocks = round(memory / dt / block_size)
        # The first fit waits for at least as many samples.
        if max_blocks * block_size < 2 * MIN_SAMPLES:
            raise ValueError(
                f"memory must be at least {2 * MIN_SAMPLES * dt:g} s at this dt, not {memory!r}"
            )
        directions = None
        if effect_directions is not None:
            directions = validated_directions(effect_directions, n_inputs)

        self.learned: Learned | None = None
        self.training_end_time = np.nan
        self.no_model_reason: Fact | None = TOO_FEW_SAMPLES
        self.refits = True
        self.fits_physical = True
        self.follows_torque = True
        self._settings = Settings() if settings is None else settings
        self._executor = executor

        # Time of the last sample, s, unless a segment begins; number of gaps in a row; number of samples so far.
        self._last_time: float | None = None
        self._gaps_in_a_row = 0
        self._sample_count = 0
        # Number of samples before the first fit and after a failed one; number from which on the next fit is due.
        self._samples_before_fit = max(round(LEARNING_SECONDS / dt), 2 * MIN_SAMPLES)
        self._next_fit_sample = self._samples_before_fit
        # Number of samples from which on an unusual sample may call for a fit: the least pause after the last one.
        self._pause_end_sample = 0
        # The fit that the executor computes; the result of the last one.
        self._pending_fit: Future[FreeEnergyMonitor] | None = None
        self._monitor: FreeEnergyMonitor | None = None

        self._memory = SampleMemory(dt, block_size, max_blocks, directions)
        self._error_bands = ErrorBands(self.horizons, n_outputs, self._dt)
        axis_mixer = known_axis_mixer(n_inputs, directions)
        self._forecaster = OnlineForecaster(self._dt, self.horizons, n_outputs, axis_mixer)
        self._surprise = Surprise(self._dt)
        self._anomaly_marks = AnomalyMarks(self._dt)
        self._latest_mark: SurpriseMark | None = None
        # The wind torque is estimated by the plant, a package above this one.
        from mavdem.plant.online_wind_torque import OnlineWindTorque

        self._wind_torque = OnlineWindTorque(self._memory, executor, prior)

    def update(
        self,
        time: float,
        outputs: ArrayLike,
        inputs: ArrayLike,
        weak_since: float | None = None,
    ) -> Estimate:
        """Adds the next sample and returns the estimates at this sample.

        If the step from the last sample differs from ``dt``, or is negative, a new segment begins. The model is kept,
        but nothing is predicted or differentiated across the gap. After ``MAX_GAPS`` gaps in a row, the attribute
        ``no_model_reason`` states that samples do not come every ``dt``.

        >>> online = mavdem.OnlineLearner(dt=0.01, n_inputs=4, n_outputs=2)
        >>> for time, outputs, inputs in zip(train.time[:50], train.outputs, train.inputs):
        ...     estimate = online.update(time, outputs, inputs)
        >>> estimate.ahead.shape[1]  # outputs some steps ahead
        2

        Args:
            time: Time of the sample, s.
            outputs: Measured motion, (m,): angle (rad) and rate (rad/s).
            inputs: Motor outputs, (r,), in the unit of the stream.
            weak_since: Time at which a motor lost thrust, s; None if no motor has. Since that time no wind torque is
                estimated, because the torque that the other motors balance is then not only the wind's.

        Returns:
            The estimates, by the model that was learned before this sample.

        Raises:
            ValueError: A value is not finite, a value is larger than ``mavdem.learn`` accepts, or there are more or
                fewer values.

        See Also:
            :func:`mavdem.learn`: learns a model from a whole flight.
        """
        # First the sample is checked and added to the memory. A gap before it ends the segment.
        sample = self._checked_sample(time, inputs, outputs)
        step = self._dt if self._last_time is None else sample.time - self._last_time
        self._count_gaps(step)
        has_completed_block = self._memory.add(sample.inputs, sample.outputs, sample.time)
        self._sample_count += 1
        # Then the estimates are computed, by what was learned before this sample.
        wind_torque, wind_torque_band = np.nan, np.nan
        if self.follows_torque:
            wind_torque, wind_torque_band = self._wind_torque.update(sample.inputs, weak_since)
        smoother = self._wind_torque.smoother
        estimate = self._estimate(sample)._replace(
            wind_torque=wind_torque,
            wind_torque_band=wind_torque_band,
            wind_time=sample.time - self._wind_torque.delay,
            physical=None if smoother is None else smoother.physical,
        )
        self._last_time = sample.time
        # Last, quantiles and forecasts are updated, once for each block, and the model is learned again if that is due.
        if has_completed_block:
            self._error_bands.update()
            self._surprise.update_quantiles()
            self._learn_from_last_block()
        self.adopt_finished_fit()
        self._start_fit_when_due()
        if self._gaps_in_a_row >= MAX_GAPS:
            self.no_model_reason = Fact(OnlineFact.SAMPLES_MISPLACED, interval=step, step=self._dt)
        return estimate

    def forget_since(self, time: float) -> None:
        """Discards the samples since a time, because the vehicle turned out to have been on the ground since then.

        The forecasts are learned again from the samples before that time. A running call of ``learn`` is cancelled, and
        another begins, since the samples before may be the last ones of the flight (:meth:`adopt_finished_fit`).

        Args:
            time: Time on the clock of the latest segments, s.
        """
        # There is a gap between the samples before and after the discarded ones.
        self._begin_segment()
        if drop_blocks_since(self._memory.blocks, time):
            self._forecaster.relearn(self._memory.blocks, self._forecaster.axis_mixer)
            self._wind_torque.drop_blocks_since(time)
            # A running fit uses the discarded samples.
            if self._pending_fit is not None:
                self._pending_fit.cancel()
                self._pending_fit = None
        if not self._memory.blocks:
            # There are no samples to learn from, as at the beginning. The current model is kept.
            self._next_fit_sample = self._sample_count + self._samples_before_fit
            return
        # The model may not have been learned from the latest of the remaining samples, and no more may follow.
        self._next_fit_sample = self._sample_count
        self._start_fit_when_due()

    def adopt_finished_fit(self, timeout: float = 0.0) -> None:
        """Adopts the result of the executor's fit if it has ended, even if no more samples come.

        Args:
            timeout: Longest time to wait for the end of the fit, s.
        """
        if self._pending_fit is None:
            return
        if timeout:
            wait([self._pending_fit], timeout)
        if not self._pending_fit.done():
            return
        finished_fit = self._pending_fit
        # Also if its result cannot be adopted, the fit is not pending any more.
        self._pending_fit = None
        self._adopt_fit_result(finished_fit.result)

    def learn_now(self, timeout: float | None = None) -> Learned:
        """Learns a model from the samples in the memory at once, and returns it; the model in use is not changed.

        Args:
            timeout: Longest time to wait for the executor, s; None for no limit.

        Returns:
            The result of ``learn``.

        Raises:
            ValueError: The samples do not support a model, or there is no block of samples yet.
            TimeoutError: The executor took longer than ``timeout``.
        """
        if not self._memory.blocks:
            raise NotLearnable(TOO_FEW_SAMPLES)
        record = self._memory.record()
        if self._executor is None:
            return learn(record, self._settings)
        return self._executor.submit(learn, record, self._settings).result(timeout)

    def _checked_sample(self, time: float, inputs: ArrayLike, outputs: ArrayLike) -> _Sample:
        """Checks a sample before it is added to the memory.

        Args:
            time: Time of the sample, s.
            inputs: Motor outputs, (r,).
            outputs: Measured motion, (m,).

        Returns:
            The sample, with inputs and outputs as arrays.

        Raises:
            ValueError: There are more or fewer values, or one is not finite or too large; the message names it.
        """
        if not (isinstance(time, float) and abs(time) < MAX_ABS_VALUE):
            time = float(checked_row(time, "time", 1)[0])
        return _Sample(
            time=time,
            inputs=checked_row(inputs, "inputs", self._n_inputs),
            outputs=checked_row(outputs, "outputs", self._n_outputs),
        )

    def _count_gaps(self, step: float) -> None:
        """Updates the count of consecutive gaps, and begins a new segment at a gap.

        There is a gap before a sample if the step from the last one differs from ``dt`` by more than
        ``MAX_STEP_DEVIATION`` times ``dt``. A step without a gap sets the count to 0. While the count is ``MAX_GAPS``
        or more, :meth:`update` reports as ``no_model_reason`` that the samples do not come every ``dt``. This function
        withdraws that reason at the first step without a gap.

        Args:
            step: Time from the last sample to this one, s; negative if the clock was set back.
        """
        if abs(step - self._dt) > MAX_STEP_DEVIATION * self._dt:
            self._begin_segment()
            self._gaps_in_a_row += 1
            return
        if self._gaps_in_a_row >= MAX_GAPS:
            # Samples come every ``dt`` again, so this reason is withdrawn. There may be another reason for no model.
            self.no_model_reason = self._reason_before_first_model()
        self._gaps_in_a_row = 0

    def _begin_segment(self) -> None:
        """Ends the segment of the samples so far; the next sample begins another.

        Nothing is predicted or differentiated across the boundary. The samples that do not fill a block yet become a
        shorter block, from which the forecasts learn as well.
        """
        has_completed_block = self._memory.end_segment()
        if has_completed_block:
            self._learn_from_last_block()
        self._forecaster.end_segment()
        self._wind_torque.end_segment()
        self._last_time = None

    def _learn_from_last_block(self) -> None:
        """Updates the forecasts and the wind torque with the block that was just completed.

        The forecaster and the estimator of the wind torque are given every block. They fit their parameters when that
        is due, unless the caller postpones it by ``refits`` or ``fits_physical``.
        """
        block = self._memory.blocks[-1]
        self._forecaster.add_block(block, may_fit=self.refits)
        if self.follows_torque:
            self._wind_torque.add(block, self.fits_physical)

    def _estimate(self, sample: _Sample) -> Estimate:
        """Returns the estimates at the latest sample, except of the wind torque.

        Args:
            sample: The latest sample, which has already been added to the memory.

        Returns:
            The predictions with their bands and, if there is a model, the free energy of the samples under that model.
        """
        expected_outputs, ahead = self._forecaster.predict(self._memory)
        # The bands are computed from the errors before this sample. Its own errors are added for later bands.
        half_widths = self._error_bands.half_widths
        errors = self._forecaster.errors
        self._error_bands.add(sample.outputs - expected_outputs, errors.latest)
        estimate = Estimate(
            time=sample.time,
            expected=expected_outputs,
            expected_band=half_widths[0],
            ahead_times=sample.time + self._dt * np.array(self.horizons),
            ahead=ahead,
            ahead_band=half_widths[1:],
            ahead_ratio=errors.ratio,
        )
        monitor = self._monitor
        if monitor is None:
            return estimate
        terms = monitor.terms(self._memory)
        free_energy = np.nan
        surprise = np.nan
        if terms is not None:
            free_energy = float(terms.sum())
            surprise = self._surprise.add(free_energy)
        is_marked = self._anomaly_marks.add(surprise)
        if is_marked:
            cause = self._cause_of_latest_surprise(monitor.learned)
            self._latest_mark = SurpriseMark(sample.time, cause)
            self._schedule_fit_after_mark()
        # The free energy belongs to the sample at the centre of the embedding window, which ends with this sample.
        window = monitor.learned.settings.window
        samples_since_center = window - 1 - window // 2
        return estimate._replace(
            window_center=sample.time - samples_since_center * self._dt,
            free_energy=free_energy,
            free_energy_terms=terms,
            free_energy_action=monitor.free_energy_action,
            surprise=surprise,
            model=monitor.learned.model,
            training_end_time=monitor.end_time,
            unusual=is_marked,
            latest_mark=self._latest_mark,
        )

    def _schedule_fit_after_mark(self) -> None:
        """Advances the next fit, since a mark of surprise shows that the vehicle may have changed.

        The model is learned again when enough samples have been recorded since the mark, and the pause after the last
        fit is over.
        """
        after_mark = self._sample_count + round(LEARNING_SECONDS / self._dt)
        earliest_sample = max(after_mark, self._pause_end_sample)
        self._next_fit_sample = min(self._next_fit_sample, earliest_sample)

    def _cause_of_latest_surprise(self, learned: Learned) -> SurpriseCause | None:
        """Returns why the latest samples agree so badly with the model: a wrong model, or a disturbance.

        Args:
            learned: The model whose free energy dropped.

        Returns:
            The cause; None if it cannot be decided, or if the effect of the motors on the axis is not known.
        """
        directions = self._memory.effect_directions
        if directions is None:
            return None
        sample_count = round((CAUSE_SECONDS + REFERENCE_SECONDS) / self._dt)
        inputs, outputs = self._memory.latest_samples(sample_count)
        command = inputs @ directions
        return cause_of_surprise(command, outputs, self._dt, learned.settings)

    def _reason_before_first_model(self) -> Fact | None:
        """Returns why no fit has given a model yet; None if there is a model."""
        if self._monitor is not None:
            return None
        return TOO_FEW_SAMPLES if self._pending_fit is None else FIRST_FIT_RUNNING

    def _start_fit_when_due(self) -> None:
        """Starts a fit of the model to the samples in the memory, when it is due and no other is running.

        With an executor the fit is computed by it, and its result is adopted at a later sample. Without one, this
        function computes the fit and adopts its result, so that it returns only then.
        """
        is_due = self.refits and self._sample_count >= self._next_fit_sample
        if not is_due or self._pending_fit is not None or not self._memory.blocks:
            return
        record = self._memory.record()
        end_time = self._memory.blocks[-1].end_time
        self._schedule_next_fit(len(record))
        if self._executor is None:
            self._adopt_fit_result(lambda: _learn_and_monitor(record, self._settings, end_time))
            return
        try:
            self._pending_fit = self._executor.submit(
                _learn_and_monitor, record, self._settings, end_time
            )
        except RuntimeError as error:
            # The executor has been shut down, or its processes have ended.
            self._retry_later(error)
        if self.no_model_reason == TOO_FEW_SAMPLES:
            self.no_model_reason = self._reason_before_first_model()

    def _schedule_next_fit(self, fitted_samples: int) -> None:
        """Sets the numbers of the samples at which the pause after a fit ends, and at which the next fit is due.

        A fit to many samples takes long. So the pause is ``LEARNING_SECONDS`` or, of more than ``FULL_RATE_SAMPLES``,
        longer in proportion to their number. After the pause a fit may start early, for instance after a surprise.
        Otherwise it starts when the new samples are ``NEW_SAMPLE_FRACTION`` of the fitted ones: fewer would change the
        model little.

        Args:
            fitted_samples: number of samples of the fit that begins now.
        """
        pause_factor = max(fitted_samples / FULL_RATE_SAMPLES, 1.0)
        pause_samples = round(LEARNING_SECONDS / self._dt * pause_factor)
        new_samples = round(NEW_SAMPLE_FRACTION * fitted_samples)
        self._pause_end_sample = self._sample_count + pause_samples
        self._next_fit_sample = self._sample_count + max(pause_samples, new_samples)

    def _adopt_fit_result(self, result: Callable[[], FreeEnergyMonitor]) -> None:
        """Adopts the model of a finished fit; if the fit failed, keeps the old one and sets ``no_model_reason``.

        Surprise compares the free energy F(t) of a sample with its past values. These differ from model to model, so
        the past values become F(t) of the new model's training samples.

        Args:
            result: Function that returns the monitor with the fitted model, or raises the error of the fit.
        """
        try:
            monitor = result()
        except (ValueError, RuntimeError, CancelledError) as error:
            self._retry_later(error)
            return
        self.learned = monitor.learned
        self.training_end_time = monitor.end_time
        self.no_model_reason = None
        self._surprise = Surprise(self._dt, monitor.past_values)
        self._monitor = monitor
        # The forecaster uses the axis mixer of the fitted joint model. If it had another or none, it learns anew from
        # the samples in memory.
        mixer = self._forecaster.axis_mixer
        fitted_mixer = monitor.learned.joint.mixer
        if mixer is None or not is_same_mixer(mixer, fitted_mixer):
            self._forecaster.relearn(self._memory.blocks, fitted_mixer)

    def _retry_later(self, error: BaseException) -> None:
        """States why a fit failed, and schedules the next one after as many samples as before the first fit.

        If no model could be learned from the samples so far, the older half of the memory is dropped, since the vehicle
        may have stood on the ground and taken off later. After a failure of the executor nothing is dropped.

        Args:
            error: The error of the fit or of the executor.
        """
        reason = None
        if isinstance(error, BrokenExecutor):
            reason = Fact(OnlineFact.PROCESS_KILLED)
        elif str(error):
            reason = fact_from_error(error)
        self.no_model_reason = Fact(
            OnlineFact.LEARNING_FAILED, reason=reason, kept=self._monitor is not None
        )
        self._next_fit_sample = self._sample_count + self._samples_before_fit
        # A ValueError means that no model can be learned from the samples.
        if isinstance(error, ValueError) and self._monitor is None:
            for _ in range(len(self._memory.blocks) // 2):
                self._memory.blocks.popleft()
