"""Physical parameters of one axis from the posterior of its closed loop, with the errors that the posterior lacks.

The likelihood's covariance takes the model for exact. But commands between messages are unseen, limits of the outputs
are not modelled, and signals do not change evenly between their samples. So the covariance of these errors is added.
"""

from typing import NamedTuple

import numpy as np
from scipy.linalg import block_diag

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
from mavdem.plant.parameters import LAG_AND_DELAY, wind_torque_density
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
LAG_DELAY_DEVIATION = 1 / 24
"""Standard deviation by which the lag is too long and the delay too short, relative to the surplus interval.

The surplus interval is the time between messages beyond a control cycle. Messages hardly separate lag from delay within
it. The deviation triples where limits cut off all of the output, which then jumps unseen.
"""
DELAY_PER_EFFECT = 0.2
"""Error of the delay that comes with an error of the effect, in motor lags per unit of the effect's logarithm.

An effect that is too large comes with a lag that is too long and a delay that is too short: the response to quick
changes, which a flight shows best, then stays the same.
"""


def physical_plant(fit: IdentifiedAxis, inputs_per_demand: Array) -> Physical:
    """Converts the fitted parameters of a loop to physical parameters, without the gyro's filters.

    The fit has one effect, that of the demand; a plant has an effect for each input. So the effect is spread over the
    inputs in proportion to how much a demand moves each of them. The fit is of logarithms: its covariance is propagated
    by the derivatives of the parameters, and the errors of the model are added.

    Args:
        fit: posterior of the logarithms of the parameters.
        inputs_per_demand: change of each of the r inputs per unit of demand (r,).
    """
    values = LoopParameters.from_logarithms(fit.theta)
    # The effects of all inputs, weighted by how much a demand moves them, add up to the identified effect of a demand.
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
    )
    return plant._replace(
        wind_share=_wind_share(plant, values, fit.posterior.spectra),
        covariance=plant.covariance + _model_error_covariance(fit, effect, values),
    )


def _derivatives_by_logarithms(effect: Array, values: LoopParameters) -> Array:
    """Returns the derivatives of effects, damping, lag and delay by the logarithms of these four (r + 3, 4).

    A parameter changes with its own logarithm alone, by its own value. All effects share one logarithm.

    Args:
        effect: effect of each of the r inputs (r,).
        values: parameters of the axis.
    """
    derivatives: Array = block_diag(effect[:, None], [values.damping], [values.lag], [values.delay])
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
        Variance of the wind torque over that of all torque, 0 to 1.
    """
    _, highest = MOTION_BAND_HZ
    frequency = spectra.frequency[spectra.frequency <= highest]
    torque_per_demand = values.effect / (1 + 2j * np.pi * frequency * values.lag)
    output_density = spectra.mean_density[: len(frequency), Quantity.OUTPUT, Quantity.OUTPUT].real
    bandwidth = np.gradient(frequency)
    wind_variance = bandwidth @ wind_torque_density(plant, frequency)
    # The density of the output is two-sided, that of the wind is one-sided.
    motor_variance = 2 * bandwidth @ (np.abs(torque_per_demand) ** 2 * output_density)
    return float(wind_variance / (wind_variance + motor_variance))


class _LogDeviations(NamedTuple):
    """Standard deviations of the model's errors of the natural logarithms of the parameters."""

    effect: float
    """Of the control effectiveness."""
    damping: float
    """Of the rate damping."""
    lag: float
    """Of the motor lag."""
    delay: float
    """Of the delay."""


def _model_deviations(fit: IdentifiedAxis, values: LoopParameters) -> _LogDeviations:
    """Returns how large the model's errors are.

    They grow with the time between messages beyond a control cycle, and with the share of the output that limits cut
    off. Independent errors of one parameter add in squares.

    Args:
        fit: posterior, with that time and that share.
        values: parameters of the axis.
    """
    surplus_interval = fit.posterior.densities.surplus_interval
    cut_share = fit.saturation_loss
    # An error in seconds by which the lag is too long and the delay too short. Divided by the parameter, it is one of
    # the logarithm.
    lag_against_delay = LAG_DELAY_DEVIATION * (1 + 2 * cut_share) * surplus_interval
    effect = np.linalg.norm(
        [
            EFFECT_MODEL_DEVIATION,
            SATURATION_EFFECT_DEVIATION * cut_share,
            UNSEEN_EFFECT_DEVIATION * surplus_interval,
        ]
    )
    return _LogDeviations(
        effect=float(effect),
        damping=DAMPING_MODEL_DEVIATION,
        lag=lag_against_delay / values.lag,
        delay=float(np.hypot(DELAY_MODEL_DEVIATION, lag_against_delay / values.delay)),
    )


def _model_error_covariance(fit: IdentifiedAxis, effect: Array, values: LoopParameters) -> Array:
    """Returns the covariance of effects, damping, lag and delay by errors of the model.

    There are four independent errors, one for each logarithm. A flight shows the response to quick changes best, so
    errors leave that response nearly as it is: an error of the effect or the lag comes with errors of the others that
    compensate for it. Each error therefore has a direction in the space of all parameters.

    Args:
        fit: posterior, with the time between messages beyond a control cycle and the fraction that limits cut off.
        effect: effect of each input (r,).
        values: parameters of the axis.

    Returns:
        Covariance (r + 3, r + 3), in the order effects, damping, lag, delay.
    """
    # Each column is the change of all parameters by an error of 1 of one logarithm, at first of that parameter alone.
    directions = _derivatives_by_logarithms(effect, values)
    effect_column = _LogDeviations._fields.index("effect")
    lag_column = _LogDeviations._fields.index("lag")
    # With more effect by one in its logarithm, the lag is longer by one lag and the delay shorter by a part of it.
    directions[LAG_AND_DELAY, effect_column] = values.lag, -DELAY_PER_EFFECT * values.lag
    # A lag that is longer by itself comes with a delay that is shorter by half as much, and half the relative change of
    # the effect.
    directions[:, lag_column] += np.concatenate([effect, [0.0, 0.0, -values.lag]]) / 2
    variances = np.square(_model_deviations(fit, values))
    return directions * variances @ directions.T
