"""OnlineLearner: the same model on a stream, learned again from the latest samples whenever that is due.

``learn`` runs in an executor, whenever its last call is done and two seconds have passed, or more after
many samples. In between every sample is filtered and predicted by the newest model.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import CancelledError, Executor, Future
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from mavdem.arrays import Array
from mavdem.dem.forecast.joint import known_axis_mixer
from mavdem.dem.learned import Learned
from mavdem.dem.learning import MIN_SAMPLES, learn, learn_with_fit
from mavdem.dem.online.ahead import OnlineForecaster
from mavdem.dem.online.memory import SampleMemory, drop_blocks_since
from mavdem.dem.online.tracker import (
    AnomalyMarks,
    ErrorBands,
    Estimate,
    FreeEnergyMonitor,
    Surprise,
)
from mavdem.dem.record import Record
from mavdem.dem.settings import Settings
from mavdem.dem.validation import (
    MAX_STEPS,
    is_number,
    require_finite_and_bounded,
    validated_count,
    validated_directions,
    validated_step,
    validated_table,
)
from mavdem.errors import NotLearnable, fact_from_error
from mavdem.facts import Fact
from mavdem.facts.online import Online

if TYPE_CHECKING:
    from mavdem.plant.online_wind_torque import WeakenedMotors
    from mavdem.plant.parameters import Physical

MEMORY_BLOCK_SECONDS = 0.1  # of samples, which are remembered and forgotten together
LEARNING_SECONDS = 2.0  # of samples, before the first call of ``learn``, and between two
# In the memory, up to which a call takes a tenth of that at most: of more, calls come as many times farther apart
MOST_SAMPLES = 2000
DEFAULT_HORIZONS = (1, 5, 10, 25, 50)  # default steps ahead
ALIKE_COSINE = 0.9  # cosine of the angle between turning combinations that differ by chance
MAX_GAPS = 5  # in a row, after which ``dt`` is wrong rather than samples missing
TOO_FEW_SAMPLES = Fact(Online.TOO_FEW_SAMPLES_YET)
FIRST_RUNS = Fact(Online.FIRST_LEARNING)


def _learn(record: Record, settings: Settings, until: float) -> FreeEnergyMonitor:
    learned, fit = learn_with_fit(record, settings)
    learned.joint  # noqa: B018  here, not where samples come
    return FreeEnergyMonitor.of(learned, fit, until)


class OnlineLearner:
    """Learns from samples as they come, whatever their source.

    Attributes:
        horizons: steps ahead of ``Estimate.ahead``.
        learned, until: the last result of ``learn``, the model in use, and the end of its samples, s; None, NaN before.
        refits, fits_physical: whether model and physical parameters are fitted again: a caller may put that off.
        follows_torque: whether samples are for the wind torque, too: those of a climb after take-off are not.
        obstacle: why there is no model, or no newer one; ``None`` without a reason.
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
        """Begins without a sample.

        Args:
            settings: what decides the fit; ``Settings()`` unless given.
            dt: sampling step, s.
            n_inputs, n_outputs: r and m.
            memory: seconds of samples that the model is fitted to; older ones are dropped.
            horizons: steps ahead to predict, increasing.
            executor: of processes, where ``learn`` runs; unless given, it runs inside an update, which then takes as
                long. With one of threads an update may wait for them.
            effect_directions: (r,) relative effect of each input on the axis, where the mixer geometry is known.
            prior: the vehicle's physical parameters as of an earlier flight, such as ``Learned.physical``.

        Raises:
            ValueError: names the argument that does not fit.
        """
        self._dt = validated_step(dt)
        self._sizes = validated_count(n_inputs, "n_inputs"), validated_count(n_outputs, "n_outputs")
        given = horizons if np.ndim(horizons) else ()
        self.horizons = tuple(validated_count(steps, "horizons", MAX_STEPS) for steps in given)
        if not self.horizons or list(self.horizons) != sorted(set(self.horizons)):
            raise ValueError(f"horizons must be steps, increasing, not {horizons!r}")
        block = max(1, round(MEMORY_BLOCK_SECONDS / dt))
        most = round(memory / dt / block) if is_number(memory) and np.isfinite(memory / dt) else 0
        if most * block < 2 * MIN_SAMPLES:
            raise ValueError(
                f"memory must be at least {2 * MIN_SAMPLES * dt:g} s at this dt, not {memory!r}"
            )
        self.learned: Learned | None = None
        self.obstacle: Fact | None = TOO_FEW_SAMPLES
        self.refits = True
        self.fits_physical = True
        self.follows_torque = True
        self.until = np.nan
        self._settings = Settings() if settings is None else settings
        self._executor = executor
        directions = None
        if effect_directions is not None:
            directions = validated_directions(effect_directions, n_inputs)
        self._memory = SampleMemory(dt, block, most, directions)
        self._samples = 0
        self._first = max(round(LEARNING_SECONDS / dt), 2 * MIN_SAMPLES)
        self._next = self._first
        self._pending: Future[FreeEnergyMonitor] | None = None
        self._tracker: FreeEnergyMonitor | None = None
        self._last: float | None = None
        self._gaps = 0
        self._bands = ErrorBands(len(self.horizons), n_outputs, self._dt)
        combinations = known_axis_mixer(n_inputs, directions)
        self._ahead = OnlineForecaster(self._dt, self.horizons, n_outputs, combinations)
        # The wind torque is estimated by the plant, a room above this one.
        from mavdem.plant.online_wind_torque import OnlineWindTorque

        self._wind = OnlineWindTorque(self._memory, executor, prior)
        self._surprise, self._marks = Surprise(self._dt), AnomalyMarks(self._dt)

    def update(
        self,
        time: float,
        outputs: ArrayLike,
        inputs: ArrayLike,
        weak: WeakenedMotors | None = None,
    ) -> Estimate:
        """Takes the next sample, ``outputs`` (m,) and ``inputs`` (r,) at a ``time`` in s.

        >>> online = mavdem.OnlineLearner(dt=0.01, n_inputs=4, n_outputs=2)
        >>> for time, outputs, inputs in zip(train.time[:50], train.outputs, train.inputs):
        ...     estimate = online.update(time, outputs, inputs)
        >>> estimate.ahead.shape[1]  # outputs some steps ahead
        2

        A time other than one step after the last, also one that goes back, begins a new segment: the model is kept, and
        nothing is predicted or differentiated across the gap. After ``MAX_GAPS`` in a row, ``obstacle`` states that
        samples do not come every ``dt``. While motors are ``weak``, the wind torque is by what they do.

        Returns:
            the estimate as of this sample, by the model before it.

        Raises:
            ValueError: values that are not finite, larger than ``mavdem.learn`` takes, or of another number.

        See Also:
            :func:`mavdem.learn`: from a whole flight.
        """
        time, u, y = self._checked(time, inputs, outputs)
        step = self._dt if self._last is None else time - self._last
        if abs(step - self._dt) > 0.5 * self._dt:
            self._begin_segment()
            self._gaps += 1
        elif self._gaps:
            if self._gaps >= MAX_GAPS:
                self.obstacle = self._missing()
            self._gaps = 0
        closed = self._memory.add(u, y, time)
        self._samples += 1
        torque = self._wind.update(u, weak) if self.follows_torque else (np.nan, np.nan)
        estimate = self._estimate(time, y)._replace(
            wind_torque=torque[0],
            wind_torque_band=torque[1],
            wind_time=time - self._wind.delay,
            physical=None if self._wind.smoother is None else self._wind.smoother.physical,
        )
        self._last = time
        if closed:
            self._bands.update()
            self._surprise.update_quantiles()
            self._remember()
        self._relearn()
        if self._gaps >= MAX_GAPS:
            self.obstacle = Fact(Online.SAMPLES_MISPLACED, interval=step, step=self._dt)
        return estimate

    def forget_since(self, time: float) -> None:
        """Takes back the samples of the latest segments from ``time``, s, on: they were not what they seemed to be.

        The model is learned anew from those before; a running call of ``learn`` is not waited for.
        """
        self._begin_segment()
        if not drop_blocks_since(self._memory.blocks, time):
            return
        self._ahead.begin_with(self._memory.blocks, self._ahead.combinations)
        self._wind.drop_blocks_since(time)
        if self._pending is not None:
            self._pending.cancel()
            self._pending = None
        # Without a sample left there is nothing to learn from: as in the beginning, but the model stays.
        self._next = self._samples + (0 if self._memory.blocks else self._first)

    def learn_now(self, timeout: float | None = None) -> Learned:
        """Returns the result of ``learn`` on the samples in the memory.

        Raises:
            ValueError: they do not support one, or there is no full block of samples yet.
            TimeoutError: the executor took longer than ``timeout``, s.
        """
        if not self._memory.blocks:
            raise NotLearnable(TOO_FEW_SAMPLES)
        record = self._memory.record()
        if self._executor is None:
            return learn(record, self._settings)
        return self._executor.submit(learn, record, self._settings).result(timeout)

    def _checked(
        self, time: float, inputs: ArrayLike, outputs: ArrayLike
    ) -> tuple[float, Array, Array]:
        r, m = self._sizes
        given: list[tuple[str, Any, int]] = [
            ("time", time, 1),
            ("inputs", inputs, r),
            ("outputs", outputs, m),
        ]
        rows = []
        for name, values, size in given:
            rows.append(validated_table([values], name, size)[0])
            require_finite_and_bounded(rows[-1], name)
        now, u, y = rows
        return float(now[0]), u, y

    def _begin_segment(self) -> None:
        if self._memory.end_segment():
            self._remember()
        self._ahead.end_segment()
        self._wind.end_segment()
        self._last = None

    def _estimate(self, time: float, y: Array) -> Estimate:
        tracker = self._tracker
        (expected, ahead) = self._ahead.predict(self._memory)
        expected_band, *ahead_band = self._bands.half_widths
        self._bands.add(y - expected, self._ahead.errors)
        estimate = Estimate(
            time,
            expected,
            expected_band,
            time + self._dt * np.array(self.horizons),
            ahead,
            np.array(ahead_band),
            self._ahead.error_ratio,
        )
        if tracker is None:
            return estimate
        energy = tracker.evaluate(self._memory)
        surprise = self._surprise.add(energy) if np.isfinite(energy) else np.nan
        learned = tracker.learned
        window = learned.settings.window
        return estimate._replace(
            seen=time - (window - 1 - window // 2) * self._dt,
            free_energy=energy,
            surprise=surprise,
            model=learned.model,
            until=tracker.until,
            unusual=self._marks.add(surprise),
        )

    def _remember(self) -> None:
        """Learns what comes next, and the wind's torque, from the block that was just closed."""
        self._ahead.add(self._memory.blocks[-1], self.refits)
        if self.follows_torque:
            self._wind.add(self._memory.blocks[-1], self.fits_physical)

    def _missing(self) -> Fact | None:
        """Why there is no model yet; ``None`` where there is one."""
        if self._tracker is not None:
            return None
        return TOO_FEW_SAMPLES if self._pending is None else FIRST_RUNS

    def _relearn(self) -> None:
        """Adopts what was learned meanwhile; calls ``learn`` again where that is due."""
        if self._pending is not None and self._pending.done():
            pending = self._pending
            self._pending = None  # also where what was learned cannot be adopted
            self._adopt(pending.result)
        if (
            not self.refits
            or self._samples < self._next
            or self._pending is not None
            or not self._memory.blocks
        ):
            return
        record = self._memory.record()
        until = self._memory.blocks[-1].end_time
        pause = LEARNING_SECONDS * max(len(record) / MOST_SAMPLES, 1.0)
        self._next = self._samples + round(pause / self._dt)
        if self._executor is None:
            self._adopt(lambda: _learn(record, self._settings, until))
            return
        try:
            self._pending = self._executor.submit(_learn, record, self._settings, until)
        except RuntimeError as error:  # the executor's processes are gone
            self._put_off(error)
        if self.obstacle == TOO_FEW_SAMPLES:
            self.obstacle = self._missing()

    def _adopt(self, result: Callable[[], FreeEnergyMonitor]) -> None:
        try:
            tracker = result()
        except (ValueError, RuntimeError, CancelledError) as error:
            self._put_off(error)
            return
        self.learned = tracker.learned
        self.until = tracker.until
        self.obstacle = None
        self._surprise = Surprise(self._dt, tracker.past)
        self._tracker = tracker
        before = self._ahead.combinations
        now = tracker.learned.joint.combinations
        if before is None or abs(np.sum(before * now, axis=0)).min() < ALIKE_COSINE:
            self._ahead.begin_with(self._memory.blocks, now)

    def _put_off(self, error: BaseException) -> None:
        """Tries again soon, with half the memory: a vehicle on the ground may have taken off since."""
        self.obstacle = Fact(
            Online.LEARNING_FAILED,
            because=fact_from_error(error) if str(error) else None,
            kept=self._tracker is not None,
        )
        self._next = self._samples + self._first
        if isinstance(error, ValueError) and self._tracker is None:
            for _ in range(len(self._memory.blocks) // 2):
                self._memory.blocks.popleft()
