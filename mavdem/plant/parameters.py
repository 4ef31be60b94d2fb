"""Physical parameters (gray-box model) of a flight, and the windows of the flight that they are estimated from."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from mavdem.arrays import Array, Indices
from mavdem.confidence import CONFIDENCE_LEVEL, SIGNIFICANT_SIGMAS, Interval, half_width
from mavdem.dem.engine.gauss_newton import FINITE_DIFFERENCE_STEP
from mavdem.dem.engine.linalg import normal_draws
from mavdem.dem.priors import derivative_pairs
from mavdem.dem.record import Record
from mavdem.errors import NotLearnable
from mavdem.facts import Fact
from mavdem.facts.identifiability import Status
from mavdem.facts.model import NoPhysical, ParameterDoubt, Refinement
from mavdem.plant.identifiability import PARAMETERS, OmissionErrors
from mavdem.plant.likelihood import FlightWindows
from mavdem.plant.sampled_plant import Coloured


class WindComponent(NamedTuple):
    """One component of the wind: noise of this ``colour`` with standard deviation ``size``, rad/s², and ``time``, s."""

    colour: Coloured
    size: float
    time: float


class PhysicalInterval(NamedTuple):
    """Half widths; NaN where a parameter is not identifiable."""

    effect: Array  # (r,)
    damping: float
    lag: float
    delay: float


class Physical(NamedTuple):
    """Physical parameters of one axis.

    Attributes:
        effect: (r,) of each motor on the angular acceleration in steady state, rad/s² per unit of input.
        damping: of the rate by itself, 1/s.
        lag: time constant of the motors, s.
        delay: of their commands, s; dead time of the stream is in it.
        covariance: (r + 3, r + 3) of effect, damping, lag and delay: of the estimate, its spread from window to window,
            over the wind's possible spectra, and nonlinear effects.
        status: by "effect", "damping" and "lag".
        reasons: likewise, why it is so; ``None`` where nothing is to be said.
        bias: likely relative error of the effect, negative where it comes out low; 0 unless it is biased.
        wind_share: of the wind's variance in the sum with that of the motors' torque, in the band of the motion.
        components: of the wind.
        noise: standard deviation of the measured rate's white noise, rad/s.
        refinements: parameters that predict unseen windows better, by name (docs/physical.md).
        windows: how many of the flight it is fitted to.
        filtered: whether the lag too has the gyro's filters in it; the delay always has.
        refusal: why they are not those of the plant in its loop, where that was asked for.
    """

    effect: Array
    damping: float
    lag: float
    delay: float
    covariance: Array
    status: dict[str, Status]
    reasons: dict[str, Fact | None]
    bias: float
    wind_share: float
    components: tuple[WindComponent, ...]
    noise: float
    refinements: dict[Refinement, float]
    windows: int
    filtered: bool = True
    refusal: Fact | None = None

    def __repr__(self) -> str:
        mean, half = self.mean_effect()
        return f"<Physical: mean effect {mean:.3g} ± {half:.2g} rad/s² per unit of input>"

    @property
    def wind(self) -> float:
        """Standard deviation of the angular acceleration that is not by the motors, rad/s², without its constant."""
        return float(np.linalg.norm([component.size for component in self.components]))

    def mean_effect(self, level: float = CONFIDENCE_LEVEL) -> Interval:
        """Returns the mean magnitude of the motors' effect, and its half width, NaN where it is not identifiable.

        The interval of probability ``level`` is narrower than the motors' own: they move together.
        """
        share = np.sign(self.effect) / len(self.effect)
        mean = float(share @ self.effect)
        r = len(self.effect)
        half = float(half_width(share @ self.covariance[:r, :r] @ share, level))
        return mean, half if self.identifiable else np.nan

    @property
    def identifiable(self) -> bool:
        """Whether the motors' effect is reported, be it with a bias."""
        return self.status["effect"] != Status.NOT_IDENTIFIABLE

    @property
    def caution(self) -> Fact | None:
        """Why the effect is not identifiable; ``None`` where it is."""
        if self.identifiable:
            return None
        return Fact(NoPhysical.EFFECT_NOT_IDENTIFIABLE, because=self.reasons["effect"])

    def draws(self, number: int, seed: int = 0) -> Array:
        """Returns (number + 1, r + 3) effect, damping, lag and delay: the estimate, then draws by ``seed``."""
        theta = parameter_vector(self)
        drawn = normal_draws(theta, self.covariance, number, seed)
        drawn[:, -2:] = drawn[:, -2:].clip(0.05 * theta[-2:])  # a lag and a delay are positive
        return np.vstack([theta, drawn])

    def interval(self, level: float = CONFIDENCE_LEVEL) -> PhysicalInterval:
        """Returns half widths of intervals of probability ``level``."""
        half = half_width(self.covariance.diagonal(), level)
        effect, damping, lag = (
            np.where(self.status[name] == Status.NOT_IDENTIFIABLE, np.nan, part)
            for name, part in zip(PARAMETERS, (half[:-3], half[-3], half[-2]), strict=True)
        )
        delay = np.nan if self.status["lag"] == Status.NOT_IDENTIFIABLE else half[-1]
        return PhysicalInterval(effect, float(damping), float(lag), float(delay))

    @property
    def interval_90_percent(self) -> PhysicalInterval:
        """The half widths of 90 % intervals."""
        return self.interval()


def parameter_vector(physical: Physical) -> Array:
    """Returns (r + 3,) effect, damping, lag and delay."""
    return np.array([*physical.effect, physical.damping, physical.lag, physical.delay])


def wind_torque_density(physical: Physical, frequency: Array) -> Array:
    """Returns (F,) the spectral density of the wind's components at Hz (F,), one-sided, (rad/s²)²/Hz."""
    turn = 2 * np.pi * frequency
    densities = [colour.density(turn, size, time) for colour, size, time in physical.components]
    return 2 * np.sum(densities, axis=0)


def slopes_of(function: Callable[[Array], Array], theta: Array, value: Array) -> Array:
    """Returns (k, …) the slopes of a ``function`` at θ (k,), where its ``value`` is known, by differences."""
    nudges = FINITE_DIFFERENCE_STEP * np.maximum(abs(theta), FINITE_DIFFERENCE_STEP)
    return np.array([(function(theta + nudge) - value) / nudge.sum() for nudge in np.diag(nudges)])


PLANT_MINIMUM = 0.05, 1e-3, 0.0  # damping, 1/s, lag and delay, s, of a vehicle


def updated(plant: Physical, prior: Physical) -> Physical:
    """Returns what a flight and, as :func:`physical` says, the ``prior`` of an earlier one tell of the vehicle.

    Beyond ``SIGNIFICANT_SIGMAS`` between the two, the vehicle is not as it was.
    A flight that does not identify the effect, on which the others depend, says nothing of any of them.
    """
    theta = parameter_vector(prior)
    now = parameter_vector(plant)
    if len(theta) != len(now) or not prior.identifiable:
        return plant
    alike = np.append(theta[:-3], np.zeros(3))
    covariance = prior.covariance + np.outer(alike, alike) * OmissionErrors.between_flights**2
    earlier = Fact(ParameterDoubt.KNOWN_FROM_EARLIER_FLIGHT)
    reasons = {
        name: prior.reasons[name] if prior.status[name] == Status.NOT_IDENTIFIABLE else earlier
        for name in PARAMETERS
    }
    judged = prior._replace(reasons=reasons)
    if plant.identifiable:
        both = covariance + plant.covariance
        share = np.sign(alike)
        judged = plant
        if abs(share @ (now - theta)) > SIGNIFICANT_SIGMAS * np.sqrt(share @ both @ share):
            return plant
        gain = np.linalg.solve(both, covariance).T
        theta = theta + gain @ (now - theta)
        covariance = covariance - gain @ covariance
    damping, lag, delay = np.maximum(theta[-3:], PLANT_MINIMUM).tolist()
    return plant._replace(
        effect=theta[:-3],
        damping=damping,
        lag=lag,
        delay=delay,
        covariance=covariance,
        status=judged.status,
        reasons=judged.reasons,
        bias=judged.bias,
    )


WINDOW_SECONDS = (
    7.0  # of a window; up to half as long again, so that little of a flight is left over
)
MIN_SAMPLES = 200  # of a window at the least
PAST = 4  # samples that tell what is new in the next
FEWEST_RATE = 39.0
"""Hz: of fewer samples, a lag and damping of tens of milliseconds are no more than a guess. A grid of 40 Hz may have a
little less."""
FASTEST_RATE = 199.0  # Hz: of twice that or more, every so many samples are taken


def windows_of(record: Record) -> FlightWindows:
    """Cuts a record into windows of one length, with one trim and one unit of inputs; ``NotLearnable`` says why not."""
    if 1 / record.dt < FEWEST_RATE:
        raise NotLearnable(NoPhysical.SAMPLED_TOO_SLOWLY, rate=1 / record.dt)
    rate = rate_column(record)
    samples = _window_samples(record)
    inputs = record.inputs[samples]
    inputs = inputs - inputs.mean(axis=(0, 1))
    unit = np.sqrt(np.mean(inputs**2))
    if not unit:
        raise NotLearnable(NoPhysical.MOTORS_STILL)
    dt = (samples[0, 1] - samples[0, 0]) * record.dt
    inputs = inputs / unit
    turning = record.outputs[samples, rate]
    return FlightWindows.of(inputs, turning, answers(inputs, turning), dt, unit)


def answers(inputs: Array, rate: Array) -> Array:
    """Returns what in ``inputs`` (W, N, r) answers what is new in the ``rate`` (W, N) at the same sample, (W, N, r).

    New is what a linear regression on the samples before does not predict.
    """
    both = np.concatenate([rate[:, :, None], inputs], axis=2)
    count = rate.shape[1]
    past = np.concatenate([both[:, lag : count - PAST + lag] for lag in range(PAST)], axis=2)
    now, past = (part.reshape(-1, part.shape[2]) for part in (both[:, PAST:], past))
    new = now - past @ np.linalg.lstsq(past, now)[0]
    response = np.zeros_like(inputs)
    gains = new[:, 0] @ new[:, 1:] / (new[:, 0] @ new[:, 0])
    response[:, PAST:] = (new[:, :1] * gains).reshape(len(rate), -1, inputs.shape[2])
    return response


def rate_column(record: Record) -> int:
    """Returns which output is the rate: the derivative of another, or the only one; ``NotLearnable`` where none is."""
    if record.outputs.shape[1] == 1:
        return 0
    pairs = derivative_pairs(record)
    if not pairs:
        raise NotLearnable(NoPhysical.NO_RATE)
    return pairs[0][1]


def _window_samples(record: Record) -> Indices:
    """(W, N) samples of each window."""
    step = max(1, int(1 / record.dt / FASTEST_RATE))
    shortest = step * MIN_SAMPLES
    if record.longest_segment < shortest:
        raise NotLearnable(
            NoPhysical.TOO_FEW_SAMPLES_WITHOUT_GAPS,
            least_samples=shortest,
            samples=record.longest_segment,
        )
    # Up to half as long again, or down to what there is, so that as little as possible is left over.
    usual = min(round(WINDOW_SECONDS / record.dt), record.longest_segment)
    longest = min(int(1.5 * usual), record.longest_segment)
    lengths = range(usual, longest + 1, max(1, usual // 50))
    length = max(
        lengths, key=lambda length: sum(whole // length for whole in record.lengths) * length
    )
    segments = zip(record.segment_starts, record.lengths, strict=True)
    begins = np.concatenate(
        [start + length * np.arange(whole // length) for start, whole in segments]
    )
    return np.asarray(begins[:, None] + np.arange(0, length - step + 1, step), int)
