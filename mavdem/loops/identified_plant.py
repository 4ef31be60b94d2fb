"""Physical parameters of one axis from the posterior of its closed loop, with the errors that the posterior lacks.

The likelihood's covariance takes the model for exact. But commands between messages are unseen, limits of the outputs
are not modelled, and signals do not change evenly between their samples. So the covariance of these errors is added.
"""

from typing import NamedTuple

import numpy as np
import scipy

from mavdem.arrays import Array
from mavdem.facts.identifiability import Status
from mavdem.facts.model import ModelName
from mavdem.plant import Physical
from mavdem.plant.closed_loop.identification import IdentifiedAxis
from mavdem.plant.closed_loop.parameters import PLANT, LoopParameters
from mavdem.plant.closed_loop.response import Quantity
from mavdem.plant.closed_loop.spectra import CrossSpectra
from mavdem.plant.estimation import MOTION_BAND_HZ
from mavdem.plant.identifiability import PARAMETERS
from mavdem.plant.parameters import wind_torque_density
from mavdem.plant.sampled_plant import FIRST_ORDER, GAUSSIAN_KERNEL, WindComponent

EFFECT_MODEL_DEVIATION = 0.02
"""Standard deviation of the model's error of the effect's natural logarithm, however fast the messages.

Chosen on half of the flights of ``tools/validation/loops.py``, as are the other deviations here.
"""
DAMPING_MODEL_DEVIATION = 0.1
"""The same for the damping."""
DELAY_MODEL_DEVIATION = 0.03
"""The same for the delay. The lag has no such error: an error of the effect comes with one of the lag."""
SATURATION_EFFECT_DEVIATION = 0.1
"""The same for the effect, where limits cut off all of the output: rotors spin up faster than they slow down."""
UNSEEN_EFFECT_DEVIATION = 1.5
"""The same for the effect, per second between messages beyond a control cycle: commands between messages are unseen."""
UNEXPLAINED_GAIN_DEVIATION = 0.2
"""The same for the gain of the torque's response at all frequencies, times ``LoopParameters.actuation``.

Output that the logged controller does not explain counts as noise that is independent of all signals. But mixers that
leave out what the motors cannot do, and limits, depend on them, and may add to the gain or take from it. Chosen on half
of 24 simulated flights with strong doublets and high hover at 50 to 200 Hz. Of the other half, 14 of 17 intervals
(90 %) of the crossover held the truth, without it 6 of 19. ``tools/validation/loops.py --strong`` prints what other
values do (docs/evidence/loops.md). Of 55 loops of other flights at 100 Hz, 32 intervals hold the truth without it, 49
with half of it, 52 with it.
"""
LAG_DELAY_DEVIATION = 1 / 24
"""Standard deviation by which the lag is too long and the delay too short, relative to the surplus interval.

The surplus interval is the time between messages beyond a control cycle. Messages hardly separate lag from delay within
it. The deviation triples where limits cut off all of the output, which then jumps unseen.
"""
UNSTEERED_PHASE_DEVIATION = np.radians(3.0)
"""Standard deviation of the phase at the crossover where setpoints end below it, rad.

Only wind and noise show the loop there, and torque of the motors' distortion is taken for wind that the loop amplifies:
motors that slow down more slowly than they speed up make torque up to twice the setpoints' frequency, where it ends. It
was up to five times as strong as the modelled wind. Chosen on 16 flights of the choosing half of
``tools/validation/loops.py --limited`` at 100 Hz: of the phase margins at crossovers above the setpoints' frequencies
16 of 18 intervals (90 %) hold the truth, without it 15, and with 4° 17, but then 5 loops more are refused. Of fresh
flights they are still too narrow (docs/evidence/loops.md).
"""
DELAY_PER_EFFECT = 0.2
"""Error of the delay that comes with an error of the effect, in motor lags per unit of the effect's logarithm.

At high frequencies ω the response of the torque is nearly effect / (lag jω). So an effect that is too large comes with
a lag that is too long by the same ratio, which leaves that gain as it is. The longer lag turns the phase −atan(ω lag)
back by ω lag / (1 + (ω lag)²) per unit of its logarithm. A delay that is shorter by lag / (1 + (ω lag)²) turns it forth
by the same amount, which is 0.2 lags for ω = 2 / lag. Chosen as the deviations above.
"""
LAG_COMPENSATION = 0.5
"""Errors that come with an error of the lag alone, relative to it: of the effect (relative) and of the delay (in lags).

At ω = 1 / lag the flight then shows no difference. There the gain 1 / |1 + jω lag| falls by (ω lag)² / (1 + (ω lag)²)
= 1/2 per unit of the lag's logarithm, which half as much more effect makes up for. The phase turns back by ω lag / (1 +
(ω lag)²) = 1/2, which a delay shorter by half as much as the lag is longer makes up for.
"""


def physical_plant(fit: IdentifiedAxis, inputs_per_demand: Array) -> Physical:
    """Converts the parameters of one axis, as identified in its closed loop, to a plant with motors as inputs.

    The identification has one control effectiveness b, per unit of the controller's demand. The plant has one for each
    input, which are the r motors or the demand itself. With g the change of the inputs per demand, they are
    b g / (g·g): proportional to g, and such that a demand has the effect b.

    The identified parameters are logarithms. So their covariance is propagated by the derivatives of the parameters.
    The covariance of the errors of the model is added, since the likelihood does not contain them.

    Args:
        fit: posterior of the logarithms of the parameters.
        inputs_per_demand: change g of each of the r inputs per unit of demand (r,).

    Returns:
        Effects, damping, lag and delay with their covariance, the wind components, and the noise. The lag and delay are
        caused by motors and messages; they do not contain the delay of the gyro's filters, which is known.
    """
    values = LoopParameters.from_logarithms(fit.theta)
    effect = values.effect * inputs_per_demand / (inputs_per_demand @ inputs_per_demand)
    derivatives = _derivatives_by_logarithms(effect, values)
    log_covariance = fit.covariance[np.ix_(PLANT, PLANT)]
    plant = Physical(
        effect=effect,
        damping=values.damping,
        lag=values.lag,
        delay=values.delay,
        covariance=derivatives @ log_covariance @ derivatives.T,
        status=dict.fromkeys(PARAMETERS, Status.REPORTED),
        reasons=dict.fromkeys(PARAMETERS),
        bias=0.0,
        wind_share=np.nan,
        components=(
            WindComponent(FIRST_ORDER, values.drift_size, values.drift_time),
            WindComponent(FIRST_ORDER, values.eddy_size, values.eddy_time),
            WindComponent(GAUSSIAN_KERNEL, values.gust_size, values.gust_time),
        ),
        noise=np.hypot(values.gyro_noise, values.filtered_noise),
        refinements={},
        windows=len(fit.posterior.spectra.densities),
        filtered=False,
        model=ModelName.CLOSED_LOOP,
        unexplained_output=values.actuation,
        steered_frequency=fit.steered_frequency,
    )
    return plant._replace(
        wind_share=_wind_share(plant, values, fit.posterior.spectra),
        covariance=plant.covariance + _model_error_covariance(fit, effect, values),
    )


def _derivatives_by_logarithms(effect: Array, values: LoopParameters) -> Array:
    """Returns the derivatives of effects, damping, lag and delay by the logarithms of effect, damping, lag and delay.

    The derivative of a parameter by its own logarithm is its value, and by the other logarithms 0. All effects share
    the logarithm of their common scale.

    Args:
        effect: effect of each of the r inputs (r,).
        values: parameters of the axis: effect of a demand, damping, lag and delay.

    Returns:
        The derivatives (r + 3, 4).
    """
    derivatives: Array = scipy.linalg.block_diag(
        effect[:, None], [values.damping], [values.lag], [values.delay]
    )
    return derivatives


def _wind_share(plant: Physical, values: LoopParameters, spectra: CrossSpectra) -> float:
    """Returns the share of the wind in the variance of all torque, in the band of the vehicle's motion.

    The rest is the torque of the motors, with the density |effect / (1 + jω lag)|² S_u for an output u of density S_u.
    Integrals are sums over the bands of the spectra, up to the highest frequency of ``MOTION_BAND_HZ``.

    Args:
        plant: the plant, with the components of the wind torque.
        values: parameters of the loop, with the effect of a demand, rad/s², and the motors' lag, s.
        spectra: cross-spectra of the loop, with the density of the output.

    Returns:
        Variance of the wind torque over the variance of all torque, 0 to 1.
    """
    _, highest_frequency = MOTION_BAND_HZ
    is_in_band = spectra.frequency <= highest_frequency
    frequency = spectra.frequency[is_in_band]
    band_widths = np.gradient(frequency)
    wind_variance = band_widths @ wind_torque_density(plant, frequency)

    torque_per_output = values.effect / (1 + 2j * np.pi * frequency * values.lag)
    output_density = spectra.mean_density[is_in_band, Quantity.OUTPUT, Quantity.OUTPUT].real
    motor_torque_density = np.abs(torque_per_output) ** 2 * output_density
    # The density of the output is two-sided, the wind's is one-sided.
    motor_variance = 2 * band_widths @ motor_torque_density
    return float(wind_variance / (wind_variance + motor_variance))


class _LogErrors(NamedTuple):
    """Standard deviations of five independent errors by the model's simplifications, of natural logarithms."""

    effect: float
    """Error of the control effectiveness."""
    damping: float
    """Error of the rate damping."""
    lag: float
    """Error of the motor lag."""
    delay: float
    """Error of the delay."""
    gain: float
    """Error of the gain of the torque's response at all frequencies: of the effect, with lag and delay as they are."""


def _log_errors(fit: IdentifiedAxis, values: LoopParameters) -> _LogErrors:
    """Computes the standard deviations of the errors that the model's own simplifications cause.

    Three simplifications cause them. The model does not see what happens between two messages: errors increase with the
    surplus interval, the time between messages beyond one control cycle. It does not model the limits of the outputs:
    errors increase with the share of the output that limits cut off. And it takes output that the logged controller
    does not explain for noise: errors increase with that output. Where several of them cause an error of one parameter,
    their squares are added.

    Args:
        fit: posterior of the axis, with the surplus interval and the share that limits cut off.
        values: parameters of the axis, with the output that the controller does not explain (``actuation``).

    Returns:
        The standard deviations of the logarithms, without a unit.
    """
    surplus_interval = fit.posterior.densities.surplus_interval
    cut_off_share = fit.saturation_loss
    effect_error = np.linalg.norm(
        [
            EFFECT_MODEL_DEVIATION,
            SATURATION_EFFECT_DEVIATION * cut_off_share,
            UNSEEN_EFFECT_DEVIATION * surplus_interval,
        ]
    )
    # Within the surplus interval, messages hardly separate lag from delay: the lag may be too long, and the delay too
    # short, by the same time, s. It triples where limits cut off all of the output (``LAG_DELAY_DEVIATION``).
    confused_time = LAG_DELAY_DEVIATION * (1 + 2 * cut_off_share) * surplus_interval
    delay_errors = [
        DELAY_MODEL_DEVIATION,
        confused_time / values.delay,
        _unsteered_delay_error(fit) / values.delay,
    ]
    # An error of a time, divided by the time, is the error of its logarithm.
    return _LogErrors(
        effect=float(effect_error),
        damping=DAMPING_MODEL_DEVIATION,
        lag=confused_time / values.lag,
        delay=float(np.linalg.norm(delay_errors)),
        gain=UNEXPLAINED_GAIN_DEVIATION * values.actuation,
    )


def _unsteered_delay_error(fit: IdentifiedAxis) -> float:
    """Returns the standard deviation of the delay that comes of setpoints that end below the crossover, s.

    It turns the phase at the crossover by ``UNSTEERED_PHASE_DEVIATION``. It is 0 if setpoints reach the crossover.

    Args:
        fit: posterior of the axis.
    """
    if fit.steered_frequency >= fit.crossover:
        return 0.0
    return UNSTEERED_PHASE_DEVIATION / (2 * np.pi * fit.crossover)


def _model_error_covariance(fit: IdentifiedAxis, effect: Array, values: LoopParameters) -> Array:
    """Returns the covariance of the errors that simplifications of the model cause in a plant's parameters.

    Five independent errors are assumed (:class:`_LogErrors`). Each has a vector of changes of all parameters that come
    with it, and adds the outer product of this vector, times the variance of the error, to the covariance.

    The changes come together because the data determine best the response of the torque at high frequencies,
    effect · e^(−jω delay) / (1 + jω lag), which the fit matches even if the model is wrong. A wrong effect or lag
    therefore comes with wrong values of other parameters, which compensate it in this response
    (:data:`DELAY_PER_EFFECT`, :data:`LAG_COMPENSATION`). Errors of damping, delay and gain change one parameter only.

    Args:
        fit: posterior of the axis. The variances depend on its time between messages beyond a control cycle, and on the
            share of the output that limits cut off.
        effect: effect of each input (r,).
        values: parameters of the axis: effect of a demand, damping, lag and delay.

    Returns:
        Covariance (r + 3, r + 3), in the order effects, damping, lag, delay.
    """
    unchanged_effect = np.zeros_like(effect)
    lag, delay = values.lag, values.delay
    # Changes of effects, damping, lag and delay, by an error of 1 of the natural logarithm. An effect that is too large
    # comes with a lag that is too long by the same ratio, and with too short a delay. A lag that is too long comes with
    # effects that are too large, and with too short a delay.
    by_effect = [*effect, 0.0, lag, -DELAY_PER_EFFECT * lag]
    by_damping = [*unchanged_effect, values.damping, 0.0, 0.0]
    by_lag = [*(LAG_COMPENSATION * effect), 0.0, lag, -LAG_COMPENSATION * lag]
    by_delay = [*unchanged_effect, 0.0, 0.0, delay]
    by_gain = [*effect, 0.0, 0.0, 0.0]
    # J (r + 3, 5) has a column for each error, in the order of the fields of ``_LogErrors``. With the diagonal matrix V
    # of the errors' variances the covariance is J V Jᵀ.
    changes_by_error = np.column_stack([by_effect, by_damping, by_lag, by_delay, by_gain])
    variances = np.square(_log_errors(fit, values))
    return changes_by_error * variances @ changes_by_error.T
