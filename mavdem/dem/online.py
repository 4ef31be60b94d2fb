"""OnlineLearner: the same model, learnt in small steps while the samples come.

Each sample is predicted, filtered and judged by F(t) with the model as it stands. With each block of samples the model
climbs a few rounds of D, E and M steps further, over the moments of the latest samples: where these stay the same, it
arrives where :func:`mavdem.learn` does. What settings leave open (embedding window, strength of the prior) is chosen by
whole learnings in between.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import CancelledError, Executor, Future
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.stats import norm

from mavdem.dem.choice import candidates
from mavdem.dem.climber import Climber
from mavdem.dem.learn import FEWEST_SAMPLES, learn
from mavdem.dem.learned import Learned
from mavdem.dem.memory import Memory
from mavdem.dem.model import LinearModel
from mavdem.dem.past_errors import PastErrors, RecentErrors
from mavdem.dem.real import is_number, is_whole, real_numbers
from mavdem.dem.record import LARGEST, SHORTEST_STEP
from mavdem.dem.settings import Settings
from mavdem.dem.tracker import Tracker
from mavdem.dem.unusual import Unusual

Array = NDArray[np.float64]

BLOCK = 0.1
"""Seconds of samples after which the model climbs on."""
FIRST_CHOICE = 2.0
"""Seconds of samples after which what settings leave open is first chosen, and chosen again after a failure; otherwise
whenever there are twice as many, and with a full memory whenever all of it is new."""
HORIZONS = (1, 5, 10, 25, 50)
"""Steps ahead that are predicted unless others are asked for."""
SETTLING = 1.0
"""Seconds of samples over which a new model's filter finds the state."""
GAPS = 5
"""In a row, after which it is the step that is wrong, and not samples that are missing."""
TOO_FEW = "there are not enough samples yet"
FIRST_RUNS = "the first learning is still running"
HALF_WIDTH = float(norm.ppf(0.95))
"""Standard deviations from the middle to the edge of a band of 90 %."""


class Estimate(NamedTuple):
    """What is known as of a sample; NaN, or ``None``, where nothing is known yet.

    H horizons, m outputs, n states, g noise precisions; physical units.

    Attributes:
        time: of the sample, s.
        expected: (m,) the sample, predicted from those before it and from its own inputs.
        expected_band: (m,) half width about it in which 90 % of the samples should lie, by past errors.
        ahead_times: (H,) what the next two are about, s: the learner's horizons from here.
        ahead: (H, m) predictions of the samples then, if the inputs stay as they are.
        ahead_band: (H, m) likewise.
        seen: time to which the next three belong, s: the centre of the latest embedding window.
        free_energy: F(t) less what the priors and entropies of θ and λ make up in it: that is the same at every
            sample, but moves while the model is learnt, and would hide what the samples say.
        surprise: how far F(t) lies below its recent median, in units of how far its lowest twentieth does: 1 is the
            worst of twenty samples, several times that a gust or a failing motor.
        disturbance: (n,) w, what pushes each state beside the model, in its unit per second; of a rate, rad/s².
        free_energy_action: F̄ᵒ of the memory.
        model: as it is now.
        model_sd: DEM's own posterior standard deviations of A, B and C; too small, see ``Learned.model_sd``.
        log_precisions: (g,) λ of the noises.
        until: time of the last sample the model was learnt from, s.
    """

    time: float
    expected: Array
    expected_band: Array
    ahead_times: Array
    ahead: Array
    ahead_band: Array
    seen: float
    free_energy: float
    surprise: float
    disturbance: Array
    free_energy_action: float
    model: LinearModel | None
    model_sd: LinearModel | None
    log_precisions: Array
    until: float

    def __repr__(self) -> str:
        if self.model is None:
            return f"<Estimate: at {self.time:.6g} s, no model yet>"
        expected, band = (np.array2string(values, precision=3) for values in (self.expected, self.expected_band))
        return (
            f"<Estimate: at {self.time:.6g} s, expected {expected} ± {band}, surprise {self.surprise:.3g}, by a model "
            f"learnt until {self.until:.6g} s>"
        )


class OnlineLearner:
    """Learns from samples as they come; knows nothing of where they come from.

    Attributes:
        horizons: steps ahead of ``Estimate.ahead``.
        learned: the last whole learning, with cautions and intervals; ``None`` before, and where nothing was left open.
        obstacle: why the model is not there, or as it was; one sentence without its full stop, empty when all is well.
    """

    def __init__(
        self,
        settings: Settings | None = None,
        dt: float = 0.01,
        n_inputs: int = 4,
        n_outputs: int = 2,
        memory: float = 20.0,
        horizons: tuple[int, ...] = HORIZONS,
        executor: Executor | None = None,
    ) -> None:
        """Begins without a sample.

        Args:
            settings: what decides the fit; ``Settings()`` unless given.
            dt: sampling step, s.
            n_inputs, n_outputs: r and m.
            memory: seconds of samples that the model is learnt from; older ones are forgotten.
            horizons: steps ahead to predict, increasing.
            executor: of processes, where whole learnings run; unless given, an update that comes upon one takes as
                long. With one of threads the model stands still meanwhile, and an update may still wait for them.

        Raises:
            ValueError: names the argument that does not fit.
        """
        if not (settings is None or isinstance(settings, Settings)):
            raise ValueError(f"settings must be a Settings, or None for the default ones, not {settings!r}")
        if not (is_number(dt) and SHORTEST_STEP <= dt <= 1 / SHORTEST_STEP):
            raise ValueError(f"dt must be positive seconds, at least {SHORTEST_STEP:g}, not {dt!r}")
        for name, number in (("n_inputs", n_inputs), ("n_outputs", n_outputs)):
            if not (is_whole(number) and number >= 1):
                raise ValueError(f"{name} must be a whole number of at least 1, not {number!r}")
        steps = isinstance(horizons, tuple | list) and len(horizons) > 0 and all(map(is_whole, horizons))
        if not steps or horizons[0] < 1 or list(horizons) != sorted(set(horizons)):
            raise ValueError(f"horizons must be whole steps of at least 1, increasing, not {horizons!r}")
        block = max(1, round(BLOCK / dt))
        most = round(memory / dt / block) if is_number(memory) and np.isfinite(memory / dt) else 0
        if most * block < 2 * FEWEST_SAMPLES:
            raise ValueError(f"memory must be at least {2 * FEWEST_SAMPLES * dt:g} s at this dt, not {memory!r}")
        self.horizons = tuple(horizons)
        self.learned: Learned | None = None
        self.obstacle = TOO_FEW
        self._settings = Settings() if settings is None else settings
        self._dt, self._sizes, self._executor = float(dt), (n_inputs, n_outputs), executor
        self._memory = Memory(dt, block, most, n_inputs, n_outputs)
        self._most = most * block
        self._samples = 0
        self._next_choice = self._first_choice = max(round(FIRST_CHOICE / dt), 2 * FEWEST_SAMPLES)
        self._pending: Future[Learned] | None = None
        self._climber: Climber | None = None
        self._tracker: Tracker | None = None
        self._last: tuple[float, Array] | None = None
        self._gaps = 0
        self._one_step_errors, self._errors = RecentErrors(self._most), PastErrors(horizons, self._most)
        self._energies = Unusual(self._most)

    def update(self, time: float, outputs: ArrayLike, inputs: ArrayLike) -> Estimate:
        """Takes the next sample.

        A time other than one step after the last, also one that goes back, begins a new segment: what was learnt is
        kept, and nothing is predicted or differentiated across the gap. After ``GAPS`` of them in a row, ``obstacle``
        says that samples do not come every ``dt``.

        Args:
            time: s.
            outputs: (m,).
            inputs: (r,).

        Returns:
            what is known as of this sample, by the model that was learnt before it.

        Raises:
            ValueError: values that are not finite, larger than ``mavdem.learn`` takes, or of another number.
        """
        time, u, y = self._checked(time, inputs, outputs)
        step = self._dt if self._last is None else time - self._last[0]
        if abs(step - self._dt) > 0.5 * self._dt:
            self._begin_segment()
            self._gaps += 1
        elif self._gaps:
            if self._gaps >= GAPS:
                self.obstacle = TOO_FEW if self._tracker is None else ""
            self._gaps = 0
        closed = self._memory.add(u, y, time)
        self._samples += 1
        estimate = self._estimate(time, u, y)
        self._last = time, u
        if closed:
            self._energies.settle()
            self._remember()
        self._choose()
        self._climb()
        if self._gaps >= GAPS:
            coming = f"come every {step:.3g} s" if step > 0 else "do not go on in time"
            self.obstacle = f"samples {coming}, where dt is {self._dt:g} s: each begins a segment of its own"
        return estimate

    def learn_now(self) -> Learned:
        """A whole learning of the samples in the memory, with the settings in use: the model to keep.

        Raises:
            ValueError: they do not support one, or there is no full block of samples yet.
        """
        if not self._memory.blocks:
            raise ValueError(TOO_FEW)
        return learn(self._memory.record(), self._settings if self._climber is None else self._climber.settings)

    def _checked(self, time: float, inputs: ArrayLike, outputs: ArrayLike) -> tuple[float, Array, Array]:
        now, u, y = real_numbers(time, "time"), real_numbers(inputs, "inputs"), real_numbers(outputs, "outputs")
        u, y = np.atleast_1d(u), np.atleast_1d(y)
        for name, numbers, shape in (
            ("time", now, ()),
            ("inputs", u, self._sizes[:1]),
            ("outputs", y, self._sizes[1:]),
        ):
            if numbers.shape != shape or not np.isfinite(numbers).all():
                raise ValueError(f"{name} must be finite and of shape {shape}, not {numbers}")
            if np.abs(numbers).max() > LARGEST:
                raise ValueError(f"{name} must not be larger than {LARGEST:g}")
        return float(now), u, y

    def _begin_segment(self) -> None:
        if self._memory.part():
            self._remember()
        self._errors.part()
        self._last = None

    def _estimate(self, time: float, u: Array, y: Array) -> Estimate:
        tracker, (_, m) = self._tracker, self._sizes
        if tracker is None:
            return self._nothing(time)
        expected = tracker.filter(self._last and self._last[1], u, y)
        ahead = tracker.ahead(u)
        one_step_band = HALF_WIDTH * np.broadcast_to(self._one_step_errors.rms, m)
        band = HALF_WIDTH * self._errors.rms(m)
        self._one_step_errors.add(y - expected)
        self._errors.add(y, ahead)
        energy, disturbance = tracker.judge(self._memory)
        surprise = self._energies.add(energy) if np.isfinite(energy) else np.nan
        delay = (tracker.window - 1 - tracker.window // 2) * self._dt
        now = tracker.now
        return Estimate(
            time=time,
            expected=expected,
            expected_band=one_step_band,
            ahead_times=time + self._dt * np.array(self.horizons),
            ahead=ahead,
            ahead_band=band,
            seen=time - delay,
            free_energy=energy,
            surprise=surprise,
            disturbance=disturbance,
            free_energy_action=now.free_energy_action,
            model=now.model,
            model_sd=now.model_sd,
            log_precisions=now.log_precisions,
            until=now.until,
        )

    def _nothing(self, time: float) -> Estimate:
        (_, m), nan = self._sizes, np.nan
        later = time + self._dt * np.array(self.horizons)
        one, several, none = np.full(m, nan), np.full((len(later), m), nan), np.empty(0)
        return Estimate(time, one, one, later, several, several, nan, nan, nan, none, nan, None, None, none, nan)

    def _remember(self) -> None:
        """Takes the block that was just closed into the moments; begins to climb, unless that still goes on."""
        if self._climber is not None:
            self._climber.moments.add(self._memory.blocks[-1])
            if not self._climber.climbing:
                self._climber.begin()

    def _climb(self) -> None:
        """A step further, where there is one to go."""
        if self._climber is None or not self._climber.climbing:
            return
        try:
            snapshot = self._climber.advance()
        except (ValueError, np.linalg.LinAlgError) as error:
            self.obstacle = f"the model stays as it was: {error}"
            return
        if snapshot is not None:
            self.obstacle = ""
            learned = self.learned
            weight = None if learned is None or learned.trajectory is not None else learned.unseen.weight
            self._tracker = Tracker(snapshot, self._climber, self.horizons, weight)
            self._tracker.find_state(*self._memory.latest(round(SETTLING / self._dt)))

    def _choose(self) -> None:
        if self._pending is not None and self._pending.done():
            pending, self._pending = self._pending, None
            self._adopt(pending.result)
        if self._samples < self._next_choice or self._pending is not None or not self._memory.blocks:
            return
        record = self._memory.record()
        self._next_choice = self._samples + min(len(record), self._most)
        try:
            open_choices = candidates(self._settings, record)
            if len(open_choices) == 1 and self._settings.smoothness != "learn":
                self._take(open_choices[0])
            elif self._executor is None:
                self._adopt(lambda: learn(record, self._settings))
            else:
                self._pending = self._executor.submit(learn, record, self._settings)
                if self.obstacle == TOO_FEW:
                    self.obstacle = FIRST_RUNS
        except (ValueError, RuntimeError) as error:  # RuntimeError: the executor's processes are gone
            self._put_off(error)

    def _adopt(self, result: Callable[[], Learned]) -> None:
        try:
            self.learned = result()
        except (ValueError, RuntimeError, CancelledError) as error:
            self._put_off(error)
            return
        self._take(self.learned.settings)

    def _put_off(self, error: BaseException) -> None:
        """Tries again soon, with less of what was before: a vehicle that stood still may have taken off."""
        self.obstacle = str(error) or "the whole learning was given up"
        self._next_choice = self._samples + self._first_choice
        if isinstance(error, ValueError) and self._climber is None:
            self._memory.forget_half()

    def _take(self, settings: Settings) -> None:
        """Climbs with other complete settings from now on, or on with the same."""
        if self._climber is None or self._climber.settings != settings:
            self._climber = Climber(settings, self._memory, self._dt)
            self._climber.begin()
            self._energies = Unusual(self._most)
