"""Construction of a rate and attitude loop from an identified plant, its posterior, and the autopilot's parameters."""

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.random import default_rng

from mavdem.arrays import Array
from mavdem.dem import Learned
from mavdem.dem.engine.linalg import normal_draws
from mavdem.dem.record import Record
from mavdem.errors import NotLearnable
from mavdem.facts import Fact
from mavdem.facts.loops import ControllerFact, LoopFact
from mavdem.ingest.telemetry import Parameters
from mavdem.loops.autopilot_parameters import MOTOR_COUNT
from mavdem.loops.axis_loops import DECIBELS_PER_DECADE, Loop, parameters_changed_in_flight
from mavdem.loops.controllers import Controller, controller_from_parameters
from mavdem.loops.filters import gyro_delay
from mavdem.loops.measured_response import measured_rate_response
from mavdem.plant import Physical
from mavdem.plant.closed_loop.spectra import LOWEST_FREQUENCY
from mavdem.plant.likelihood import DELAY_PRIOR
from mavdem.plant.parameters import (
    DELAY,
    DRAWS,
    DYNAMICS,
    EFFECTS,
    ESTIMATE,
    LAG,
    LAG_AND_DELAY,
    PLANT_MINIMUM,
    parameter_vector,
)

POSTERIOR_DRAWS = 400
"""Number of draws from the posterior of the plant: a choice."""
DRAWS_SEED = 31
"""Seed of these draws, so that the same flight has the same margins."""
DELAY_SEED = 32
"""Seed of the draws of a delay that the flight leaves open."""
SAMPLING_DELAY_DEVIATION = 0.25
"""Standard deviation of a delay, in time steps of the stream: events between two samples have no exact time."""
MAX_CROSSOVER_FRACTION = 0.15
"""Highest crossover, as a fraction of the log's rate, up to which delay and time constant are known well enough.

At this fraction a period of the crossover has seven samples. A choice.
"""
LOG_RATE_STEP = 50.0
"""Step in which a rate to record at is advised, Hz: what autopilots offer is not finer."""
BUTTERWORTH_AT_HALF_CUTOFF = np.polyval([1.0, np.sqrt(2.0), 1.0], 0.5j)
"""Denominator s² + √2 s + 1 of a second-order Butterworth filter at half of its cut-off frequency, s = 0.5 j.

The delay of the filter is √2 / ω_c, so that the imaginary part √2 / 2 is half of the cut-off times the delay.
"""


def loop_from_learned(learned: Learned, controller: Controller | None = None) -> Loop:
    """Builds the rate and attitude loop with the plant of a learned model.

    Args:
        learned: a model with an identifiable plant.
        controller: controller of the axis; None for the one that the log's parameters describe.

    Returns:
        The loop, with its margins.

    Raises:
        NotLearnable: the plant is not identifiable, or the controller is not known.
    """
    return loop_from_plant(learned.require_physical(), learned.record, controller)


def loop_from_plant(plant: Physical, record: Record, controller: Controller | None = None) -> Loop:
    """Builds the rate and attitude loop of an identified plant, with cautions about its margins.

    If the log has setpoints, the measured response of the rate is compared with the loop's. It is not compared if
    gains changed in flight, since the measured response is then a mean over several loops.

    Args:
        plant: plant that was identified from the record.
        record: the flight.
        controller: controller of the axis; ``None`` for the controller by the record's parameters.

    Returns:
        The loop of the estimate and of draws from its posterior.

    Raises:
        NotLearnable: the plant is doubtful, the controller is not known or has no proportional gain, the signs of mixer
            and plant contradict each other, or the loop is too fast for the record.
    """
    if plant.caution is not None:
        raise NotLearnable(LoopFact.NO_MARGINS, reason=plant.caution)
    axis = record_axis(record)
    if controller is None:
        controller = logged_controller(record.parameters, axis, record.effect_directions)
    if not controller.p > 0:
        name = controller.parameter_names["p"]
        raise NotLearnable(LoopFact.NO_PROPORTIONAL_GAIN, name=name, value=controller.p)
    draws = _plant_draws(plant, gyro_delay(controller), record.dt)
    mixer_gains = inputs_per_demand(controller, record)
    effectiveness = draws.effect @ mixer_gains
    # Negated, the comparison also refuses NaN.
    if not effectiveness[ESTIMATE] > 0:
        raise NotLearnable(LoopFact.MIXER_REVERSED)
    loop = Loop(axis, plant, record, controller, effectiveness, draws.dynamics)
    _require_recorded_crossover(loop)
    cautions = _loop_cautions(loop)
    rate = loop.rate
    measured = None
    earlier_values = parameters_changed_in_flight(record, controller)
    if earlier_values:
        changes = [(name, value, record.parameters[name]) for name, value in earlier_values.items()]
        cautions.append(Fact(LoopFact.PARAMETERS_CHANGED, changes=changes))
    else:
        # A plant without the gyro's filters was identified in closed loop, together with the gain of the controller.
        measured = measured_rate_response(
            record,
            controller,
            mixer_gains,
            rate.frequency,
            rate.closed_loop_of_estimate,
            is_controller_identified=not plant.filtered,
            limited_share=at_limit_share(record, controller),
        )
    return replace(loop, cautions=(*cautions, *controller.cautions), measured=measured)


def _require_recorded_crossover(loop: Loop) -> None:
    """Raises an error if the record does not contain the frequencies at which the rate loop crosses over.

    A record contains frequencies up to its Nyquist frequency, half of the sampling rate.

    Args:
        loop: rate and attitude loop of the estimated plant and of draws.

    Raises:
        NotLearnable: there are three cases:

            - The crossover is below the lowest frequency of the spectra, where position control and drag also move the
              vehicle, which the model of one axis leaves out.
            - The crossover is above half of the Nyquist frequency, and the lag of the plant contains that of the gyro's
              filters. The loop of ArduCopter's simulator, with a margin of 19° at a crossover of 20 Hz, was identified
              with 44° from messages at 50 Hz.
            - The interval of the crossover reaches the Nyquist frequency, so that the phase margin may be at a
              frequency that the record does not contain. A simulated loop with 30° at 18 Hz was identified with 51°,
              39 to 57°, at 12 Hz from messages at 25 Hz.
    """
    rate = loop.rate
    if rate.crossover < LOWEST_FREQUENCY:
        raise NotLearnable(
            LoopFact.CROSSOVER_UNSEEN,
            crossover=rate.crossover,
            rate=None,
            frequency=LOWEST_FREQUENCY,
        )
    nyquist_frequency = 0.5 / loop.record.dt
    has_filter_lag = loop.plant.filtered
    if has_filter_lag and rate.crossover > nyquist_frequency / 2:
        raise _crossover_too_fast(loop, nyquist_frequency / 2)
    _, highest_crossover = rate.crossover_interval
    if not has_filter_lag and highest_crossover >= nyquist_frequency:
        raise _crossover_too_fast(loop, nyquist_frequency)


def _loop_cautions(loop: Loop) -> list[Fact]:
    """Returns cautions about the margins of a loop; empty if there are none.

    - The control effectiveness of the plant is biased.
    - The gain margin is at a frequency above the Nyquist frequency of the record, where the loop is an extrapolation by
      the model.
    - The crossover is near the rate of the record, so that delay and time constant are not known well.
    - The crossover is above all frequencies that the setpoints steer, where only wind and noise show the loop.

    Args:
        loop: rate and attitude loop of the estimated plant and of draws.
    """
    plant, record, rate = loop.plant, loop.record, loop.rate
    cautions = []
    if plant.bias:
        cautions.append(Fact(LoopFact.EFFECT_BIASED, reason=plant.reasons["effect"]))
    nyquist_frequency = 0.5 / record.dt
    if not plant.filtered and np.isfinite(rate.gain_margin):
        # With a gain margin of GM dB, L crosses the negative real axis at −10^(−GM / 20). The frequency of the crossing
        # is the one at which L is nearest to that point.
        point_on_axis = -(10 ** (-rate.gain_margin / DECIBELS_PER_DECADE))
        crossing_index = np.argmin(np.abs(rate.response[ESTIMATE] - point_on_axis))
        crossing_frequency = float(rate.frequency[crossing_index])
        if crossing_frequency >= nyquist_frequency:
            cautions.append(
                Fact(
                    LoopFact.GAIN_MARGIN_EXTRAPOLATED,
                    rate=nyquist_frequency,
                    # By the sampling theorem the log must be twice as fast as the frequency.
                    least_rate=_advised_log_rate(2 * crossing_frequency),
                )
            )
    if rate.crossover * record.dt > MAX_CROSSOVER_FRACTION:
        cautions.append(
            Fact(
                LoopFact.CROSSOVER_FAST,
                crossover=rate.crossover,
                rate=1 / record.dt,
                least_rate=_advised_log_rate(rate.crossover / MAX_CROSSOVER_FRACTION),
            )
        )
    # The frequency is NaN, and the comparison false, for a plant that was identified without its controller.
    if plant.steered_frequency < rate.crossover:
        cautions.append(
            Fact(
                LoopFact.STEERING_SLOW,
                frequency=plant.steered_frequency,
                crossover=rate.crossover,
            )
        )
    return cautions


def _advised_log_rate(least_rate: float) -> float:
    """Returns the rate to record at, Hz: the next multiple of ``LOG_RATE_STEP`` from the least rate (Hz) on."""
    return float(LOG_RATE_STEP * np.ceil(least_rate / LOG_RATE_STEP))


def _crossover_too_fast(loop: Loop, highest_frequency: float) -> NotLearnable:
    """Returns the error that a record is too slow for its rate loop: it does not show the crossover frequency.

    The crossover, at which the gain of the open loop is 1, has an interval of uncertainty. The record does not show it
    if the upper end of the interval is above the highest frequency in the record.

    Args:
        loop: rate and attitude loop of the axis, with the crossover, Hz, and its interval.
        highest_frequency: highest frequency that the record shows, Hz.

    Returns:
        The error, to be raised by the caller. It states the upper end only if the estimate itself is shown, since
        otherwise the estimate is reason enough.
    """
    crossover = loop.rate.crossover
    _, upper_end = loop.rate.crossover_interval
    is_estimate_shown = crossover < highest_frequency
    rate = 1 / loop.record.dt
    # A record that shows the upper end is enough, but for a caution about a crossover that is fast for it.
    least_rate = crossover / MAX_CROSSOVER_FRACTION
    if is_estimate_shown:
        least_rate = max(least_rate, rate * upper_end / highest_frequency)
    return NotLearnable(
        LoopFact.CROSSOVER_UNSEEN,
        crossover=crossover,
        high=upper_end if is_estimate_shown else None,
        rate=rate,
        frequency=highest_frequency,
        least_rate=_advised_log_rate(least_rate),
    )


def record_axis(record: Record) -> str:
    """Returns the axis of a record, by the name of its last output, the rate; "roll" where outputs have no names."""
    if not record.output_names:
        return "roll"
    return record.output_names[-1].removesuffix(" rate")


def logged_controller(parameters: Parameters, axis: str, motor_weights: Array | None) -> Controller:
    """Returns the model of the autopilot's controller of one axis, with the gains and filters in a log's parameters.

    Args:
        parameters: parameters of the autopilot, by name.
        axis: "roll", "pitch" or "yaw".
        motor_weights: weights of the r inputs in the torque about the axis (r,); None if they are not known.

    Returns:
        The controller.

    Raises:
        NotLearnable: there are no parameters, or they do not describe a known controller.
    """
    if not parameters:
        raise NotLearnable(LoopFact.CONTROLLER_UNKNOWN)
    weights = () if motor_weights is None else motor_weights.tolist()
    return controller_from_parameters(parameters, axis, weights)


def at_limit_share(record: Record, controller: Controller) -> float:
    """Returns the fraction of a flight in which at least one motor was at a limit of its range.

    Args:
        record: the flight, whose inputs are the outputs of the motors.
        controller: controller of the axis, with the limits of the outputs.

    Returns:
        The fraction, 0 to 1; 0 if the range of the outputs is not known.
    """
    is_range_known = len(record.input_range) == 2
    if not is_range_known:
        return 0.0
    lowest, highest = record.input_range
    range_fractions = (record.inputs - lowest) / (highest - lowest)
    # A flag for each sample.
    is_any_motor_at_limit = controller.outputs_at_limit(range_fractions)
    return float(is_any_motor_at_limit.mean())


def inputs_per_demand(controller: Controller, record: Record) -> Array:
    """Returns the linearised mixer of one axis: how much each input of the plant changes per unit of demand.

    For a motor, this is its element of the mixer divided by the slope of the thrust curve at the motor's mean output.
    If the only input of the plant is the demand itself, from -1 to 1, it is 1.

    Args:
        controller: controller of the axis, with its mixer and thrust curve.
        record: the flight, with r inputs.

    Returns:
        Changes (r,), in the record's unit of the inputs.

    Raises:
        NotLearnable: the inputs are neither the demand nor a quadrotor's motors.
    """
    trim = record.inputs.mean(axis=0)
    if len(trim) == 1 and record.input_range == (-1.0, 1.0):
        return np.ones(1)
    if len(trim) != MOTOR_COUNT or len(record.input_range) != 2:
        raise NotLearnable(ControllerFact.MIXER_UNKNOWN, autopilot=None, motors=len(trim))
    lowest, highest = record.input_range
    trim_fractions = ((trim - lowest) / (highest - lowest)).tolist()
    # Change of each output, as a fraction of its range, per unit of demand.
    outputs_per_demand = np.array(controller.outputs_per_demand(trim_fractions))
    return (highest - lowest) * outputs_per_demand


class _PlantDraws(NamedTuple):
    """N plants without the gyro's filters: the estimate in row ``ESTIMATE``, then draws from its posterior."""

    effect: Array
    """Angular acceleration per input (N, r), rad/s² per unit of the input."""
    dynamics: Array
    """Damping, 1/s, motor lag, s, and delay, s (N, 3), each at least ``PLANT_MINIMUM``."""


def _plant_draws(plant: Physical, filter_delay: float, dt: float) -> _PlantDraws:
    """Draws plants from the posterior of an identified plant, without the gyro's filters.

    The model of the loop has the gyro's filters by the autopilot's parameters. The identified plant contains them too,
    as a part of its delay, or of its lag and delay. This part is removed, so that the filters are included only once.

    Args:
        plant: identified plant. Its delay contains the gyro filters' delay; if it is ``filtered``, its lag and delay
            contain them together.
        filter_delay: delay of the gyro's filters at low frequencies, s.
        dt: time step of the record, s.

    Returns:
        Effects of the inputs, and damping, lag and delay, of the estimate and of each drawn plant.
    """
    if plant.filtered:
        draws = _draws_without_filters(plant, filter_delay, dt)
    else:
        draws = plant.draws(POSTERIOR_DRAWS, seed=DRAWS_SEED)
        draws[:, DELAY] -= filter_delay
    if plant.bias < 0:
        # Wind makes the effect too low, never too high: about the estimate, most true effects were above the draws. The
        # estimate itself stays as it is reported. An effect that is too high, since a gyro's filter was taken for motor
        # lag, is corrected with that lag (``_draws_without_filters``).
        draws[DRAWS, EFFECTS] /= 1 + plant.bias
    return _PlantDraws(draws[:, EFFECTS], np.maximum(draws[:, DYNAMICS], PLANT_MINIMUM))


def _draws_without_filters(plant: Physical, filter_delay: float, dt: float) -> Array:
    """Draws plants without the gyro's filters from a plant whose lag and delay contain the filters'.

    1. The filters are removed. If their delay at low frequencies is less than half of the sum of lag and delay, it is
       subtracted from the sum. Otherwise that is too inaccurate. Then the remaining lag and delay are chosen so that
       in series with a Butterworth filter of this delay they have the gain and phase of the identified lag at half of
       the filter's cut-off.
    2. The remaining sum is divided into lag and delay. The flight determines the sum better than either. So the delay
       is drawn from its posterior, with the delay of common autopilots as prior, and the lag is the difference.

    Args:
        plant: the identified plant with its covariance.
        filter_delay: delay of the gyro's filters at low frequencies, s.
        dt: time step of the record, s.

    Returns:
        Effects, damping, lag and delay (N, r + 3). Row ``ESTIMATE`` is the estimate, the others are draws.
    """
    estimate = parameter_vector(plant)
    covariance = plant.covariance.copy()
    typical_delay, delay_deviation = DELAY_PRIOR
    delay_variance = covariance[DELAY, DELAY] + (SAMPLING_DELAY_DEVIATION * dt) ** 2
    if covariance[DELAY, DELAY] > delay_deviation**2:
        # The flight determines the delay less accurately than its prior, so it is drawn from the prior alone, below.
        covariance[DELAY] = 0.0
        covariance[:, DELAY] = 0.0
    draws = np.vstack(
        [estimate, normal_draws(estimate, covariance, POSTERIOR_DRAWS, seed=DRAWS_SEED)]
    )
    lag_and_delay = draws[:, LAG_AND_DELAY].sum(axis=1)
    remaining_lag_and_delay = np.maximum(lag_and_delay - filter_delay, 0.0)
    if filter_delay > lag_and_delay[ESTIMATE] / 2:
        # The angular frequency of half of the cut-off of a Butterworth filter with this delay, rad/s. There, the phase
        # of the remaining lag and delay is the identified lag's phase minus the filter's. The effect is
        # multiplied by the ratio of the attenuations, so that the gain does not change.
        half_cutoff = BUTTERWORTH_AT_HALF_CUTOFF.imag / filter_delay
        lag_phase = np.arctan(half_cutoff * draws[:, LAG])
        remaining_phase = lag_phase - np.angle(BUTTERWORTH_AT_HALF_CUTOFF)
        remaining_lag_and_delay = np.maximum(remaining_phase / half_cutoff + draws[:, DELAY], 0.0)
        lag_attenuation = np.hypot(1.0, half_cutoff * draws[:, LAG])
        draws[:, EFFECTS] *= (abs(BUTTERWORTH_AT_HALF_CUTOFF) / lag_attenuation)[:, None]
    # The posterior of the delay is the mean of prior and flight, weighted by precision. The estimate is its mean.
    prior_weight = delay_variance / (delay_variance + delay_deviation**2)
    normals = np.append(0.0, default_rng(DELAY_SEED).standard_normal(POSTERIOR_DRAWS))
    errors = delay_deviation * np.sqrt(prior_weight) * normals
    flight_delay = max(plant.delay - filter_delay, 0.0)
    delay = (1 - prior_weight) * flight_delay + prior_weight * typical_delay + errors
    delay = np.clip(delay, 0.0, remaining_lag_and_delay / 2)
    draws[:, LAG_AND_DELAY] = np.column_stack([remaining_lag_and_delay - delay, delay])
    return draws
