"""The plant in its loop as one linear stochastic differential equation, sampled exactly at the rate of a record.

One axis with its wind, its controller and its setpoint is linear and Gaussian. With the angle φ, the body rate p, the
motors' torque q and the wind torque w per moment of inertia (rad/s²), and the combination u of the motors that turns
the axis:

    dφ/dt = p        dp/dt = −d p + q + w        dq/dt = (b u(t − θ) − q) / τ
    y     = F (p + n)                            gyro rate after a second-order low-pass F, with gyro noise n
    r     = K (s − φ) + f ds/dt                  rate setpoint of the angle's setpoint s, with feed-forward f of 0 or 1
    u     = P e + I ∫ e dt + D de/dt + c r + a   controller of the error e = r − y, with what else moves the motors, a

The controller runs once a cycle; here it is continuous, and the dead time θ (a Padé approximation of second order)
contains the half cycle by which it is late. The setpoint s is a Matérn process with two states, and the wind torque is
the sum of three coloured noises, as in :mod:`~mavdem.plant.closed_loop.parameters`. Angle, gyro rate and u are measured
with white noise. Their means, the trims, are unknown.
"""

from __future__ import annotations

from enum import IntEnum
from typing import NamedTuple

import numpy as np
import scipy

from mavdem.arrays import Array, ArrayPair
from mavdem.dem.engine.kalman import MAX_DOUBLINGS, STEADY_CHANGE
from mavdem.plant.closed_loop.parameters import TYPICAL_VALUES
from mavdem.plant.likelihood import Prior
from mavdem.plant.sampled_plant import FIRST_ORDER, GAUSSIAN_KERNEL, process_covariance

TYPICAL_CROSSOVER = 3.0
"""Frequency at which the rate loop of a common multirotor has the gain 1, Hz: the prior median of the effect."""

GYRO_CYCLE = 0.0025
"""Time for which one value of the gyro noise lasts, s: ArduPilot's default loop period."""

ACTUATION_TIME = 0.01
"""Correlation time of motor commands that do not follow the control law, s: a choice."""

CHANNELS = 3
"""Number of measured channels: angle, gyro rate and the motors' combination."""


class State(IntEnum):
    """Index of each state of the closed loop; the wind torque's smooth component takes the last ones."""

    ANGLE = 0
    """Angle φ, rad."""
    RATE = 1
    """Body rate p, rad/s."""
    TORQUE = 2
    """The motors' torque q per moment of inertia, rad/s²."""
    DELAY = 3
    """The motors' combination u after two lags, as the Padé approximation of the dead time has it."""
    DELAY_SLOPE = 4
    """Its derivative."""
    GYRO = 5
    """Gyro rate y after its filter, rad/s."""
    GYRO_SLOPE = 6
    """Its derivative."""
    INTEGRAL = 7
    """Integral of the rate's error, rad."""
    DERIVATIVE = 8
    """Low-pass of the quantity whose derivative the controller uses, rad/s."""
    TARGET = 9
    """Rate setpoint after its filter, rad/s."""
    SETPOINT = 10
    """Setpoint s of the angle, rad."""
    SETPOINT_SLOPE = 11
    """Its derivative, rad/s."""
    ACTUATION = 12
    """Part of the motor commands that does not follow the control law, relative to its standard deviation."""
    DRIFT = 13
    """Slow first-order wind torque, relative to its standard deviation."""
    EDDY = 14
    """Quick first-order wind torque, relative to its standard deviation."""
    GUST = 15
    """First state of the smooth wind torque, relative to its standard deviation."""


STATES = State.GUST + len(GAUSSIAN_KERNEL.A)
"""Number n of states."""

GUST_STATES = slice(State.GUST, STATES)
"""Indices of the states of the smooth wind torque."""


class LoopController(NamedTuple):
    """The controller of one axis as far as it is known: prior medians of its gains and cut-offs, and its form."""

    angle_gain: float
    """Rate setpoint per error of the angle, 1/s."""

    p: float
    """Proportional gain: motors' combination per rad/s of the rate's error."""

    integral_ratio: float
    """Integral over proportional gain, 1/s."""

    derivative_ratio: float
    """Derivative over proportional gain, s."""

    feed_forward: float
    """Motors' combination per rad/s of the rate setpoint."""

    derivative_of_error: bool
    """Whether the error is differentiated, as in ArduPilot, or the rate alone, as in PX4."""

    setpoint_slope_gain: float
    """f: 1 if the setpoint's derivative is added to the rate setpoint, as in ArduPilot; else 0."""

    gyro_cutoff: float
    """Cut-off of the gyro's low-pass, Hz."""

    derivative_cutoff: float
    """Cut-off of the derivative's low-pass, Hz."""

    target_cutoff: float
    """Cut-off of the rate setpoint's low-pass, Hz."""

    log_gain_sd: float
    """Prior standard deviation of the logarithm of each gain and cut-off."""


UNKNOWN_GYRO_CUTOFF = 40.0
"""Cut-off of the gyro's low-pass if the controller is not known, Hz: twice ArduPilot's default, PX4's own."""

UNKNOWN_DERIVATIVE_CUTOFF = 20.0
"""Cut-off of the derivative's low-pass if the controller is not known, Hz: ArduPilot's default."""

UNKNOWN_TARGET_CUTOFF = 50.0
"""Cut-off of the rate setpoint's low-pass if the controller is not known, Hz: a choice."""


def unknown_controller(proportional_gain: float) -> LoopController:
    """Returns a controller with typical gains of autopilots, as prior medians if the real gains are not known.

    Args:
        proportional_gain: prior median of the proportional gain, such as the standard deviation of the motors'
            combination over the standard deviation of the rate: motor command per rad/s.

    Returns:
        The controller, with the standard deviation 1 of the logarithm of its gains.
    """
    # Gains near the defaults of PX4 and ArduPilot: an angle gain of 6.5 and 4.5 1/s, an I of 1.3 and 1 times P (1/s),
    # and a D of 0.02 and 0.027 times P (s).
    return LoopController(
        angle_gain=5.0,
        p=proportional_gain,
        integral_ratio=1.0,
        derivative_ratio=0.02,
        feed_forward=0.0,
        derivative_of_error=False,
        setpoint_slope_gain=0.0,
        gyro_cutoff=UNKNOWN_GYRO_CUTOFF,
        derivative_cutoff=UNKNOWN_DERIVATIVE_CUTOFF,
        target_cutoff=UNKNOWN_TARGET_CUTOFF,
        log_gain_sd=1.0,
    )


class GenerativeParameters(NamedTuple):
    """Parameters θ and hyperparameters λ of the closed loop; the model's vector has their natural logarithms.

    A field is a number, or an array with one value for each of several models side by side.
    """

    effect: Array
    """b: angular acceleration per unit of the motors' combination in steady state, rad/s²."""
    damping: Array
    """d: rate damping, 1/s."""
    lag: Array
    """τ: motor time constant, s."""
    delay: Array
    """θ: dead time from the controller to the motors, s."""
    angle_gain: Array
    """K, 1/s."""
    p: Array
    """P: motors' combination per rad/s."""
    integral_ratio: Array
    """I / P, 1/s."""
    derivative_ratio: Array
    """D / P, s."""
    gyro_cutoff: Array
    """Cut-off of the gyro's low-pass, Hz."""
    derivative_cutoff: Array
    """Cut-off of the derivative's low-pass, Hz."""
    target_cutoff: Array
    """Cut-off of the rate setpoint's low-pass, Hz."""
    setpoint_size: Array
    """Standard deviation of the angle's setpoint, rad."""
    setpoint_time: Array
    """Correlation time of the angle's setpoint, s."""
    drift_size: Array
    """Standard deviation of the slow first-order wind torque, rad/s²."""
    drift_time: Array
    """Its correlation time, s."""
    eddy_size: Array
    """Standard deviation of the quick first-order wind torque, rad/s²."""
    eddy_time: Array
    """Its correlation time, s."""
    gust_size: Array
    """Standard deviation of the smooth wind torque, rad/s²."""
    gust_time: Array
    """Its time, s."""
    gyro_noise: Array
    """Standard deviation of the gyro noise before the filter, one value a ``GYRO_CYCLE``, rad/s."""
    actuation: Array
    """Standard deviation of the motor commands that do not follow the control law, in the unit of their combination."""
    angle_noise: Array
    """Standard deviation of the measured angle's white noise, rad."""
    filtered_noise: Array
    """Standard deviation of the measured gyro rate's white noise after the filter, rad/s."""
    output_noise: Array
    """Standard deviation of the white noise of the motors' measured combination."""


NAMES = GenerativeParameters._fields
"""Names of the k parameters and hyperparameters, in the order of the vector."""

PARAMETERS = NAMES.index("setpoint_size")
"""Number of parameters θ, of plant and controller; the hyperparameters λ, sizes and times of noises, follow."""


class LoopPrior(NamedTuple):
    """Independent normal prior of the logarithms of all parameters."""

    mean: Array
    """(k,) prior means."""

    sd: Array
    """(k,) prior standard deviations."""


def loop_prior(controller: LoopController, output_size: float) -> LoopPrior:
    """Returns the prior of the logarithms of all parameters, in the order of :data:`NAMES`.

    A known controller has a narrow prior about its gains, an unknown one a wide prior; nothing else differs. Typical
    values of plant, wind and noises are in ``parameters.toml``. The standard deviations are choices: 1 allows a
    factor of 2.7 either way, and 2 a factor of 7.4.

    Args:
        controller: prior medians of the gains, and their spread.
        output_size: standard deviation of the motors' combination in the record, which scales its noises.

    Returns:
        Mean and standard deviation of each logarithm (k,): both are natural logarithms.
    """
    # At the crossover the gain of the loop is 1. The plant is nearly an integrator there, effect / ω.
    median_effect = 2 * np.pi * TYPICAL_CROSSOVER / controller.p
    gain_sd = controller.log_gain_sd
    typical = {name: np.log(value) for name, value in TYPICAL_VALUES.items()}
    priors = {
        "effect": Prior(np.log(median_effect), 2.0),
        "damping": Prior(typical["damping"], 1.5),
        "lag": Prior(typical["lag"], 1.0),
        "delay": Prior(typical["delay"], 1.0),
        "angle_gain": Prior(np.log(controller.angle_gain), gain_sd),
        "p": Prior(np.log(controller.p), gain_sd),
        "integral_ratio": Prior(np.log(controller.integral_ratio), gain_sd),
        "derivative_ratio": Prior(np.log(controller.derivative_ratio), gain_sd),
        "gyro_cutoff": Prior(np.log(controller.gyro_cutoff), gain_sd),
        "derivative_cutoff": Prior(np.log(controller.derivative_cutoff), gain_sd),
        "target_cutoff": Prior(np.log(controller.target_cutoff), gain_sd),
        # Setpoints of 0.05 rad that change within 0.5 s; noises of the output of 10 % and 2 % of its size.
        "setpoint_size": Prior(np.log(0.05), 2.0),
        "setpoint_time": Prior(np.log(0.5), 1.0),
        "gyro_noise": Prior(typical["gyro_noise"], 2.0),
        "actuation": Prior(np.log(0.1 * output_size), 2.0),
        "angle_noise": Prior(typical["angle_noise"], 2.0),
        "filtered_noise": Prior(typical["filtered_noise"], 2.0),
        "output_noise": Prior(np.log(0.02 * output_size), 2.0),
    }
    for component in ("drift", "eddy", "gust"):
        priors[f"{component}_size"] = Prior(typical[f"{component}_size"], 2.0)
        priors[f"{component}_time"] = Prior(typical[f"{component}_time"], 1.0)
    mean, sd = np.array([priors[name] for name in NAMES]).T
    return LoopPrior(mean, sd)


class SampledLoop(NamedTuple):
    """The closed loop sampled at the record's rate: x⁺ = Φ x + w, z = C x + v; leading axes are several models.

    Its states x are scaled: each is divided by its stationary standard deviation, so that all have variance 1 and
    matrices of very different entries do not round badly.
    """

    transition: Array
    """(…, n, n) transition matrix Φ of one sampling step."""

    output: Array
    """(…, 3, n) output matrix C: angle, gyro rate and the motors' combination."""

    process_covariance: Array
    """(…, n, n) covariance Q of the process noise of one step."""

    noise_variance: Array
    """(…, 3) variances of the measurement noises."""

    stationary_covariance: Array
    """(…, n, n) covariance of the states before anything is measured."""

    state_sd: Array
    """(…, n) stationary standard deviation of each state in physical units, by which the states are divided."""

    @property
    def noise_covariance(self) -> Array:
        """(…, 3, 3) covariance R of the measurement noises."""
        return self.noise_variance[..., None] * np.eye(CHANNELS)


class ContinuousLoop(NamedTuple):
    """The closed loop in continuous time: dx/dt = A x + Σ_i g_i ω_i, with independent white noises ω_i."""

    A: Array
    """(…, n, n) system matrix, 1/s."""

    noise_gains: Array
    """(…, n, sources) gains g of the white noises, in the order of ``WhiteNoise``."""

    output: Array
    """(…, 3, n) output matrix."""


class WhiteNoise(IntEnum):
    """Index of each white noise that drives the loop."""

    SETPOINT = 0
    GYRO = 1
    ACTUATION = 2
    DRIFT = 3
    EDDY = 4
    GUST = 5


SOURCES = len(WhiteNoise)
"""Number of white noises."""


def continuous_loop(parameters: GenerativeParameters, controller: LoopController) -> ContinuousLoop:
    """Builds the matrices of the closed loop's differential equation dx/dt = A x + noises, and of its outputs.

    Plant, controller and filters each enter the rows of their own states in A.

    Args:
        parameters: parameters of the loop, each a number or an array (…) for several loops at once.
        controller: controller, of which the form and the feed-forwards are used; its gains are among the parameters.

    Returns:
        Matrices (…, n, n) of the states, (…, n, sources) of the noises and (…, channels, n) of the outputs.
    """
    shape = np.shape(parameters.effect)
    A = np.zeros((*shape, STATES, STATES))
    noise_gains = np.zeros((*shape, STATES, SOURCES))
    signals = _controller_signals(parameters, controller)
    _add_plant(A, parameters, signals.motors)
    _add_filters(A, parameters, signals)
    _add_noises(A, noise_gains, parameters)

    # The channels of a record are the angle, the gyro's rate, and the command to the motors.
    output = np.zeros((*shape, CHANNELS, STATES))
    output[..., 0, State.ANGLE] = 1.0
    output[..., 1, State.GYRO] = 1.0
    output[..., 2, :] = signals.motors
    return ContinuousLoop(A, noise_gains, output)


class _ControllerSignals(NamedTuple):
    """Signals inside the controller as linear functions of the states: each a row of n weights."""

    rate_setpoint: Array
    """(…, n) rate setpoint before its filter, rad/s."""

    error: Array
    """(n,) error of the rate, rad/s."""

    derivative: Array
    """(…, n) low-passed derivative that the D term uses, rad/s²."""

    motors: Array
    """(…, n) motors' combination u."""


def _controller_signals(
    parameters: GenerativeParameters, controller: LoopController
) -> _ControllerSignals:
    """Returns the signals of the attitude and rate controller as weights of the states.

    Args:
        parameters: parameters of the loop, each a number or an array (…).
        controller: controller, of which the form and the feed-forwards are used.

    Returns:
        Weights (…, n) of the rate setpoint, its error, the derivative and the motor command.
    """
    # Row i of the unit matrix is the weight of state i alone.
    unit = np.eye(STATES)
    rate_setpoint = (
        parameters.angle_gain[..., None] * (unit[State.SETPOINT] - unit[State.ANGLE])
        + controller.setpoint_slope_gain * unit[State.SETPOINT_SLOPE]
    )
    error = unit[State.TARGET] - unit[State.GYRO]
    differentiated_signal = -unit[State.GYRO]
    if controller.derivative_of_error:
        differentiated_signal = error
    derivative_bandwidth = 2 * np.pi * parameters.derivative_cutoff
    derivative = derivative_bandwidth[..., None] * (differentiated_signal - unit[State.DERIVATIVE])
    # The terms P, I and D, divided by the proportional gain.
    pid_terms = (
        error
        + parameters.integral_ratio[..., None] * unit[State.INTEGRAL]
        + parameters.derivative_ratio[..., None] * derivative
    )
    motors = (
        parameters.p[..., None] * pid_terms
        + controller.feed_forward * unit[State.TARGET]
        + parameters.actuation[..., None] * unit[State.ACTUATION]
    )
    return _ControllerSignals(rate_setpoint, error, derivative, motors)


def _add_plant(A: Array, parameters: GenerativeParameters, motors: Array) -> None:
    """Writes the differential equations of angle, rate, motor torque and dead time into the system matrix.

    Args:
        A: system matrix (…, n, n) of dx/dt = A x; row i has the weights of all states in the derivative of state i.
        parameters: parameters of the loop, each a number or an array (…).
        motors: (…, n) weights of the states in the command to the motors.
    """
    unit = np.eye(STATES)
    A[..., State.ANGLE, State.RATE] = 1.0
    A[..., State.RATE, :] = _wind_torque_weights(parameters)
    A[..., State.RATE, State.RATE] = -parameters.damping
    A[..., State.RATE, State.TORQUE] = 1.0
    # The dead time e^(−θs) of the command u is approximated by Padé's 1 − θs / (1 + θs/2 + θ²s²/12). The state DELAY is
    # the filtered command q = u / (1 + θs/2 + θ²s²/12), so that q″ = 12/θ² (u − q) − 6/θ q′, and the delayed command is
    # u − θ q′.
    delay = parameters.delay[..., None]
    delayed_motors = motors - delay * unit[State.DELAY_SLOPE]
    A[..., State.TORQUE, :] = (
        parameters.effect[..., None] * delayed_motors - unit[State.TORQUE]
    ) / parameters.lag[..., None]
    A[..., State.DELAY, State.DELAY_SLOPE] = 1.0
    A[..., State.DELAY_SLOPE, :] = (
        12 / delay**2 * (motors - unit[State.DELAY]) - 6 / delay * unit[State.DELAY_SLOPE]
    )


def _wind_torque_weights(parameters: GenerativeParameters) -> Array:
    """Returns the weights (…, n) of the states in the wind torque, rad/s².

    The torque is the sum of its components. A first-order component is one state of variance 1 times its standard
    deviation. The smooth component has several states; the output matrix C of its noise model combines them to a noise
    of variance 1.

    Args:
        parameters: parameters of the loop, each a number or an array (…).

    Returns:
        Weights (…, n).
    """
    weights = np.zeros((*np.shape(parameters.effect), STATES))
    weights[..., State.DRIFT] = parameters.drift_size
    weights[..., State.EDDY] = parameters.eddy_size
    weights[..., GUST_STATES] = parameters.gust_size[..., None] * GAUSSIAN_KERNEL.C
    return weights


def _add_filters(A: Array, parameters: GenerativeParameters, signals: _ControllerSignals) -> None:
    """Writes the differential equations of the controller's states into the system matrix.

    These are the low-pass filters of gyro, derivative and rate setpoint, and the integral. The state TARGET is the rate
    setpoint after its low-pass, which the rate controller follows.

    Args:
        A: system matrix (…, n, n) of dx/dt = A x; row i has the weights of all states in the derivative of state i.
        parameters: parameters of the loop, each a number or an array (…).
        signals: signals of the controller, which are the inputs of the filters.
    """
    unit = np.eye(STATES)
    # The gyro's low-pass is a Butterworth filter of second order; the others are of first order.
    gyro_bandwidth = 2 * np.pi * parameters.gyro_cutoff
    A[..., State.GYRO, State.GYRO_SLOPE] = 1.0
    A[..., State.GYRO_SLOPE, State.RATE] = gyro_bandwidth**2
    A[..., State.GYRO_SLOPE, State.GYRO] = -(gyro_bandwidth**2)
    A[..., State.GYRO_SLOPE, State.GYRO_SLOPE] = -np.sqrt(2) * gyro_bandwidth
    A[..., State.INTEGRAL, :] = signals.error
    A[..., State.DERIVATIVE, :] = signals.derivative
    target_bandwidth = 2 * np.pi * parameters.target_cutoff
    A[..., State.TARGET, :] = target_bandwidth[..., None] * (
        signals.rate_setpoint - unit[State.TARGET]
    )


def _add_noises(A: Array, noise_gains: Array, parameters: GenerativeParameters) -> None:
    """Writes the differential equations of setpoint, actuation and wind, and the gains of all white noises.

    Setpoint, actuation and wind are each modelled as white noise that a filter of first or higher order colours: the
    states of the filter are states of the loop, and have the signal's correlation time. The gyro noise is white and
    enters before its low-pass.

    Args:
        A: system matrix (…, n, n) of dx/dt = A x; row i has the weights of all states in the derivative of state i.
        noise_gains: gains (…, n, sources) of the white noises, which are written.
        parameters: parameters of the loop, each a number or an array (…).
    """
    shape = np.shape(parameters.effect)
    # The setpoint is a Matérn process of smoothness 3/2, which has a double pole at −κ.
    kappa = 1 / parameters.setpoint_time
    A[..., State.SETPOINT, State.SETPOINT_SLOPE] = 1.0
    A[..., State.SETPOINT_SLOPE, State.SETPOINT] = -(kappa**2)
    A[..., State.SETPOINT_SLOPE, State.SETPOINT_SLOPE] = -2 * kappa
    noise_gains[..., State.SETPOINT_SLOPE, WhiteNoise.SETPOINT] = (
        2 * kappa**1.5 * parameters.setpoint_size
    )
    gyro_bandwidth = 2 * np.pi * parameters.gyro_cutoff
    noise_gains[..., State.GYRO_SLOPE, WhiteNoise.GYRO] = (
        gyro_bandwidth**2 * parameters.gyro_noise * np.sqrt(GYRO_CYCLE)
    )

    # First-order noises of variance 1.
    first_order_noises = (
        (State.ACTUATION, WhiteNoise.ACTUATION, np.full(shape, ACTUATION_TIME)),
        (State.DRIFT, WhiteNoise.DRIFT, parameters.drift_time),
        (State.EDDY, WhiteNoise.EDDY, parameters.eddy_time),
    )
    for state, source, time in first_order_noises:
        A[..., state, state] = FIRST_ORDER.A[0, 0] / time
        noise_gains[..., state, source] = np.sqrt(FIRST_ORDER.Q[0, 0] / time)
    # The smooth wind torque (gusts). Time in its noise model is in units of the gust time, and the intensity of its
    # white noise is diagonal, with one entry.
    gust_time = parameters.gust_time[..., None, None]
    A[..., GUST_STATES, GUST_STATES] = GAUSSIAN_KERNEL.A / gust_time
    gust_gains = np.sqrt(GAUSSIAN_KERNEL.Q.diagonal() / gust_time[..., 0])
    noise_gains[..., GUST_STATES, WhiteNoise.GUST] = gust_gains


def wind_torque_output(theta: Array, state_sd: Array) -> Array:
    """Returns the output row of the wind torque: its product with the scaled states is the torque, rad/s².

    Scaled states are x / state_sd, which all have the stationary variance 1. The Kalman filter of the sampled loop
    works with these, since states of very different sizes cause rounding errors.

    Args:
        theta: (k,) logarithms of the parameters.
        state_sd: (n,) stationary standard deviations of the states, :attr:`SampledLoop.state_sd`.

    Returns:
        (n,) output row.
    """
    parameters = GenerativeParameters(*np.exp(theta))
    return _wind_torque_weights(parameters) * state_sd


def sampled_loop(theta: Array, controller: LoopController, dt: float) -> SampledLoop:
    """Samples the closed loop exactly: the discrete model has the same distribution at the samples.

    Args:
        theta: (…, k) logarithms of the parameters; leading dimensions are several loops.
        controller: form and feed-forwards of the rate and attitude controller; its gains are in ``theta``.
        dt: sampling step, s.

    Returns:
        The discrete model, with every state divided by its stationary standard deviation.

    Raises:
        numpy.linalg.LinAlgError: a loop is unstable, so it has no stationary distribution.
    """
    parameters = GenerativeParameters(*np.moveaxis(np.exp(theta), -1, 0))
    loop = continuous_loop(parameters, controller)
    step = _step_of_loop(loop, dt)
    state_sd = np.sqrt(np.diagonal(step.stationary_covariance, axis1=-2, axis2=-1))
    row_sd = state_sd[..., None]
    column_sd = state_sd[..., None, :]
    noise_sd = np.stack(
        [parameters.angle_noise, parameters.filtered_noise, parameters.output_noise], axis=-1
    )
    return SampledLoop(
        transition=step.transition * column_sd / row_sd,
        output=loop.output * column_sd,
        process_covariance=step.process_covariance / row_sd / column_sd,
        noise_variance=noise_sd**2,
        stationary_covariance=step.stationary_covariance / row_sd / column_sd,
        state_sd=state_sd,
    )


def setpoint_process_covariance(
    theta: Array, controller: LoopController, dt: float, state_sd: Array
) -> ArrayPair:
    """Returns the process noise covariance, and the stationary covariance, that the setpoint alone causes.

    The white noises are independent, so that the rest is caused by wind, gyro noise and actuation.

    Args:
        theta: (k,) logarithms of the parameters.
        controller: form and feed-forwards of the rate and attitude controller; its gains are in ``theta``.
        dt: sampling step, s.
        state_sd: (n,) stationary standard deviations of the states, by which they are divided as in
            :class:`SampledLoop`.

    Returns:
        Covariances (n, n), of the scaled states: of the process noise of one step, and of the states before anything is
        measured.
    """
    loop = continuous_loop(GenerativeParameters(*np.exp(theta)), controller)
    # A slice instead of an index keeps the dimension of the white noises.
    only_setpoint = slice(WhiteNoise.SETPOINT, WhiteNoise.SETPOINT + 1)
    setpoint_loop = loop._replace(noise_gains=loop.noise_gains[:, only_setpoint])
    step = _step_of_loop(setpoint_loop, dt)
    scale = np.outer(state_sd, state_sd)
    return step.process_covariance / scale, step.stationary_covariance / scale


class _StepOfLoop(NamedTuple):
    """The closed loop over one sampling step, its states in physical units."""

    transition: Array
    """(…, n, n) transition matrix."""

    process_covariance: Array
    """(…, n, n) covariance of the process noise."""

    stationary_covariance: Array
    """(…, n, n) covariance of the states after infinitely many steps."""


def _step_of_loop(loop: ContinuousLoop, dt: float) -> _StepOfLoop:
    """Discretises the closed loop over one sampling step, and computes its stationary covariance.

    Both are computed by doubling a short step h: Φ(2h) = Φ(h)², Q(2h) = Q(h) + Φ(h) Q(h) Φ(h)ᵀ, with the transition
    matrix Φ and the covariance Q of the process noise. The stationary covariance is Q after so many doublings that its
    variances have stopped growing (``STEADY_CHANGE``), at most ``MAX_DOUBLINGS``.

    Only positive semidefinite matrices are added, so that rounding cannot give a covariance negative eigenvalues,
    however much faster one state is than another.

    Args:
        loop: the loop in continuous time.
        dt: sampling step, s.

    Returns:
        Transition matrix and process covariance of a step, and stationary covariance, (…, n, n) each.

    Raises:
        numpy.linalg.LinAlgError: a loop is unstable.
    """
    if not np.isfinite(loop.A).all() or np.linalg.eigvals(loop.A).real.max() >= 0:
        raise np.linalg.LinAlgError("the closed loop is unstable")
    # The step is halved until it is so short that no state changes by much more than itself.
    largest_change = abs(loop.A).sum(axis=-1).max() * dt
    doublings = max(0, int(np.ceil(np.log2(largest_change))))
    first_step = dt / 2**doublings
    transition = scipy.linalg.expm(loop.A * first_step)
    intensity = loop.noise_gains @ loop.noise_gains.mT
    covariance = process_covariance(loop.A, intensity, first_step)
    for _ in range(doublings):
        covariance = _two_step_noise_covariance(transition, covariance)
        transition = transition @ transition

    # The time is doubled on from a whole step, until the covariance is the stationary one.
    long_covariance = covariance
    long_transition = transition
    for _ in range(MAX_DOUBLINGS):
        doubled_covariance = _two_step_noise_covariance(long_transition, long_covariance)
        variances = np.diagonal(long_covariance, axis1=-2, axis2=-1)
        increases = np.diagonal(doubled_covariance, axis1=-2, axis2=-1) - variances
        long_covariance = doubled_covariance
        long_transition = long_transition @ long_transition
        if (increases <= STEADY_CHANGE * variances).all():
            break
    return _StepOfLoop(transition, covariance, stationary_covariance=long_covariance)


def _two_step_noise_covariance(transition: Array, covariance: Array) -> Array:
    """Returns the covariance of the process noise over two steps, Q(2h) = Q + Φ Q Φᵀ.

    Rounding makes it slightly asymmetric, so it is averaged with its transpose.

    Args:
        transition: (…, n, n) transition matrix Φ of one step.
        covariance: (…, n, n) covariance Q of the process noise of one step.

    Returns:
        (…, n, n) covariance of two steps.
    """
    two_step_covariance = covariance + transition @ covariance @ transition.mT
    return np.asarray((two_step_covariance + two_step_covariance.mT) / 2)
