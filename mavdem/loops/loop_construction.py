"""From a flight: the loops of the identified plant, with its posterior, and of the controller of the parameters."""

from dataclasses import replace

import numpy as np
from numpy.random import default_rng

from mavdem.arrays import Array
from mavdem.dem import Learned
from mavdem.dem.engine.linalg import normal_draws
from mavdem.dem.record import Record
from mavdem.errors import NotLearnable
from mavdem.facts import Fact
from mavdem.facts.loops import Controllers, Loops
from mavdem.ingest.telemetry import Parameters
from mavdem.loops.autopilot_parameters import MOTOR_COUNT
from mavdem.loops.axis_loops import Loop, parameters_changed_in_flight
from mavdem.loops.controllers import Controller, controller_from_parameters
from mavdem.loops.filters import gyro_delay
from mavdem.loops.measured_response import measured_rate_response
from mavdem.plant import Physical
from mavdem.plant.likelihood import DELAY_PRIOR
from mavdem.plant.parameters import PLANT_MINIMUM, parameter_vector

POSTERIOR_DRAWS = 400  # of the plant's posterior
# of a step of the stream: standard deviation of a delay by the times between its samples
SPLIT = 0.25
AT_HALF = np.polyval([1.0, np.sqrt(2.0), 1.0], 0.5j)
"""What a second-order Butterworth filter divides by at half of its cut-off; its delay goes with the imaginary part."""


def loop_from_learned(learned: Learned, controller: Controller | None = None) -> Loop:
    """Returns the loops of what was ``learned``; the ``controller`` is that of the log's parameters unless given.

    Raises ``NotLearnable``: the plant is not identifiable, or the controller is not known.
    """
    return loop_from_plant(learned.require_physical(), learned.record, controller)


def loop_from_plant(plant: Physical, record: Record, controller: Controller | None = None) -> Loop:
    """Returns the loops of a ``plant`` identified from the ``record``, as :func:`loop_from_learned`."""
    if plant.caution is not None:
        raise NotLearnable(Loops.NO_MARGINS, because=plant.caution)
    axis = axis_of(record)
    weights = record.effect_directions
    controller = controller or known_controller(record.parameters, axis, weights)
    if not controller.p > 0:
        name = controller.parameter_names["p"]
        raise NotLearnable(Loops.NO_PROPORTIONAL_GAIN, name=name, value=controller.p)
    filters = gyro_delay(controller)
    if plant.filtered:
        drawn = _drawn(plant, filters, record.dt)
    else:
        drawn = plant.draws(POSTERIOR_DRAWS, seed=31)
        drawn[:, -1] -= filters
    per_demand = demand_directions(controller, record)
    gains = drawn[:, :-3] @ per_demand
    if not gains[0] > 0:
        raise NotLearnable(Loops.MIXER_REVERSED)
    draws = np.maximum(drawn[:, -3:], PLANT_MINIMUM)
    loop = Loop(axis, plant, record, controller, gains, draws)
    rate = loop.rate
    cautions = list[Fact]()
    if plant.bias:
        because = plant.reasons["effect"]
        cautions.append(Fact(Loops.EFFECT_BIASED, because=because))
    nearest = np.argmin(np.abs(rate.response[0] + 10 ** (-rate.gain_margin / 20)))
    seen = 0.5 / record.dt
    # ArduCopter's simulator, with 19° at 20 Hz, had 44° by 50 Hz
    if plant.filtered and rate.crossover > seen / 2:
        raise NotLearnable(Loops.CROSSOVER_UNSEEN, crossover=rate.crossover, rate=1 / record.dt)
    if not plant.filtered and np.isfinite(rate.gain_margin) and rate.frequency[nearest] >= seen:
        cautions.append(Fact(Loops.GAIN_MARGIN_EXTRAPOLATED, rate=seen))
    measured = None
    if earlier := parameters_changed_in_flight(record, controller):
        changes = [(name, old, record.parameters[name]) for name, old in earlier.items()]
        cautions.append(Fact(Loops.PARAMETERS_CHANGED, changes=changes))
    else:
        measured = measured_rate_response(
            record, controller, per_demand, rate.frequency, rate.closed[0]
        )
    return replace(loop, cautions=(*cautions, *controller.cautions), measured=measured)


def axis_of(record: Record) -> str:
    """Returns the axis of a record."""
    return record.output_names[-1].removesuffix(" rate") if record.output_names else "roll"


def known_controller(parameters: Parameters, axis: str, weights: Array | None) -> Controller:
    """Returns the controller of a record's ``parameters``; raises ``NotLearnable``: they do not say it.

    ``weights`` (r,) are those of the inputs in the torque about the ``axis``, where they are known.
    """
    if not parameters:
        raise NotLearnable(Loops.CONTROLLER_UNKNOWN)
    return controller_from_parameters(parameters, axis, () if weights is None else weights.tolist())


def _drawn(plant: Physical, filters: float, dt: float) -> Array:
    """(N, r + 3) effect, damping, lag and delay without the gyro's filters: the estimate, and draws.

    The plant's lag and delay hold that of the ``filters``, s. Where it is most of them, both are alike in size and
    phase at half of the cut-off of one that is as late, else in their delay at low frequencies. The sum of lag and
    delay is better determined than either: a delay is taken for that of common autopilots as far as the flight leaves
    it open, and the lag is what is left.
    """
    theta = parameter_vector(plant)
    covariance = plant.covariance.copy()
    usual, sd = DELAY_PRIOR
    variance = covariance[-1, -1] + (SPLIT * dt) ** 2
    if covariance[-1, -1] > sd**2:
        covariance[-1] = 0.0
        covariance[:, -1] = 0.0
    drawn = np.vstack([theta, normal_draws(theta, covariance, POSTERIOR_DRAWS, seed=31)])
    late = drawn[:, -2:].sum(axis=1)
    whole = np.maximum(late - filters, 0.0)
    if filters > late[0] / 2:
        half = AT_HALF.imag / filters
        lags = np.arctan(half * drawn[:, -2]) - np.angle(AT_HALF)
        whole = np.maximum(lags / half + drawn[:, -1], 0.0)
        drawn[:, :-3] *= abs(AT_HALF) / np.hypot(1.0, half * drawn[:, -2])[:, None]
    unknown = variance / (variance + sd**2)
    errors = (
        sd * np.sqrt(unknown) * np.append(0.0, default_rng(32).standard_normal(POSTERIOR_DRAWS))
    )
    delay = (1 - unknown) * max(plant.delay - filters, 0.0) + unknown * usual + errors
    delay = np.clip(delay, 0.0, whole / 2)
    drawn[:, -2:] = np.column_stack([whole - delay, delay])
    return drawn


def demand_directions(controller: Controller, record: Record) -> Array:
    """Returns (r,) of the inputs, in their unit, by a demand of 1 about the trim; a demand itself is one."""
    trim = record.inputs.mean(axis=0)
    if len(trim) == 1 and record.input_range == (-1.0, 1.0):
        return np.ones(1)
    if len(trim) != MOTOR_COUNT or len(record.input_range) != 2:
        raise NotLearnable(Controllers.MIXER_UNKNOWN, autopilot=None, motors=len(trim))
    low, high = record.input_range
    return (high - low) * np.array(
        controller.outputs_per_demand(((trim - low) / (high - low)).tolist())
    )
