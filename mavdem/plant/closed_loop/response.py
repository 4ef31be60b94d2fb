"""Frequency responses of one axis in its closed loop, from each disturbance to each logged quantity.

With s = jω, the axis is modelled as this loop. Its controller C runs once a cycle:

    p   = G (b M e^(−sθ) u + w)     body rate p of the plant G = 1 / (s + d), with effect b, wind torque w,
                                    motor lag M = 1 / (τ s + 1) and dead time θ
    y   = F p + n                   gyro rate after the gyro filters F, with noise n
    r   = r₀ − K (p / s)            rate setpoint: reference r₀ and angle feedback with gain K
    u   = C_r r − C_y y + a         output (demand) of the controller, with actuation noise a

With A = G b M e^(−sθ), the rate that an output causes, the loop gain is L = A (C_y F + C_r K / s), and the sensitivity
S = 1 / (1 + L). Notation as in Ljung, System Identification, 2nd ed., sec. 13.4.
"""

from collections.abc import Callable
from dataclasses import dataclass
from enum import IntEnum
from typing import NamedTuple

import numpy as np

from mavdem.arrays import Array
from mavdem.plant.closed_loop.parameters import LoopParameters
from mavdem.plant.closed_loop.spectra import ComplexArray


class Quantity(IntEnum):
    """The C quantities of the spectra, by index.

    Only the first three enter the likelihood. Of the reference, the density alone is used.
    """

    RATE = 0
    """Gyro rate y, rad/s."""

    OUTPUT = 1
    """Output u of the controller, as a demand."""

    SETPOINT = 2
    """Rate setpoint r, rad/s."""

    REFERENCE = 3
    """Reference r₀ = r + K φ: the rate setpoint without its angle feedback, rad/s."""


MODELLED_QUANTITIES = (Quantity.RATE, Quantity.OUTPUT, Quantity.SETPOINT)
"""The quantities whose joint density the model gives."""


class Source(IntEnum):
    """The S independent sources that excite the loop, by index."""

    REFERENCE = 0
    """Reference r₀, with the noise of the angle."""

    GYRO_NOISE = 1
    """Noise n of the gyro rate."""

    ACTUATION = 2
    """Actuation noise a: changes of the output that do not follow the control law, by limits or the mixer's other
    axes."""

    WIND = 3
    """Wind torque w per moment of inertia, rad/s²."""


class ControllerResponses(NamedTuple):
    """C_r and C_y of a controller at some frequencies, as demand per rad/s; both have the shape of the frequencies."""

    from_setpoint: ComplexArray
    """C_r: response of the demand to the rate setpoint."""

    from_rate: ComplexArray
    """C_y: response of the demand to the gyro rate, with its sign reversed."""


class KnownController(NamedTuple):
    """The known controller and gyro filters of one axis, as functions of frequency in Hz (of any shape)."""

    transfer: Callable[[Array], tuple[ComplexArray, ComplexArray]]
    """Returns C_r and C_y: the demand per rate setpoint, and per gyro rate with its sign reversed."""

    gyro_filter: Callable[[Array], ComplexArray]
    """Returns F: gyro rate per body rate."""

    angle_gain: float
    """K: rate setpoint per error of the angle, 1/s."""

    cycle_time: float
    """Time between two runs of the controller, s."""


@dataclass(frozen=True)
class ClosedLoopResponse:
    """Frequency responses of one closed rate loop.

    J are the frequencies of the spectra, F the aliases that fold onto each, C the modelled quantities, S the sources.
    """

    plant: ComplexArray
    """G: body rate per angular acceleration (J, F), s."""

    motor_lag: ComplexArray
    """M: torque per commanded torque (J, F)."""

    rate_from_output: ComplexArray
    """A: body rate per output, with the loop opened at the motors (J, F), rad/s."""

    sensitivity: ComplexArray
    """S = 1 / (1 + L), what the loop leaves of a disturbance (J, F)."""

    from_rate: ComplexArray
    """Each quantity per body rate, with the loop opened at the motors (C, J, F)."""

    rate_from_source: ComplexArray
    """Body rate per source, in closed loop (S, J, F)."""

    from_source: ComplexArray
    """Each quantity per source, in closed loop (S, C, J, F)."""


def closed_loop_response(
    parameters: LoopParameters,
    controller: ControllerResponses,
    gyro_filter: ComplexArray,
    angle_gain: float,
    s: ComplexArray,
) -> ClosedLoopResponse:
    """Computes the frequency responses of the closed rate loop of one axis, from each source to each quantity.

    The notation of the module is used: body rate p, gyro rate y, rate setpoint r, output u. Sources act on the body
    rate through the closed loop, with the sensitivity 1 / (1 + L), and some also act on a quantity directly.

    Args:
        parameters: parameters of the loop; the plant's and the controller's gain are used.
        controller: responses C_r and C_y of the controller with the logged gains, (J, F) each.
        gyro_filter: response F of the gyro filters (J, F).
        angle_gain: gain K of the angle feedback, 1/s.
        s: jω at J frequencies and F aliases of each (J, F), rad/s.

    Returns:
        The responses of the plant, of the loop, and from each source.
    """
    C_r = parameters.controller * controller.from_setpoint
    C_y = parameters.controller * controller.from_rate
    plant = 1 / (s + parameters.damping)
    motor_lag = 1 / (parameters.lag * s + 1)
    rate_from_output = parameters.effect * motor_lag * np.exp(-s * parameters.delay) * plant

    # With the loop opened at the motors: y = F p, r = −K p / s, u = C_r r − C_y y.
    setpoint_from_rate = -angle_gain / s
    output_from_rate = C_r * setpoint_from_rate - C_y * gyro_filter
    from_rate = np.array([gyro_filter, output_from_rate, setpoint_from_rate])

    # The loop gain L is the negative product of rate per output and output per rate. Sources are in the order of
    # ``Source``.
    sensitivity = 1 / (1 - rate_from_output * output_from_rate)
    rate_from_source = sensitivity * np.array(
        [rate_from_output * C_r, -rate_from_output * C_y, rate_from_output, plant]
    )

    # A source acts through the body rate, and some act on a quantity directly as well.
    from_source = rate_from_source[:, None] * from_rate
    from_source[Source.REFERENCE, Quantity.SETPOINT] += 1.0
    from_source[Source.REFERENCE, Quantity.OUTPUT] += C_r
    from_source[Source.GYRO_NOISE, Quantity.RATE] += 1.0
    from_source[Source.GYRO_NOISE, Quantity.OUTPUT] -= C_y
    from_source[Source.ACTUATION, Quantity.OUTPUT] += 1.0
    return ClosedLoopResponse(
        plant,
        motor_lag,
        rate_from_output,
        sensitivity,
        from_rate,
        rate_from_source,
        from_source,
    )
