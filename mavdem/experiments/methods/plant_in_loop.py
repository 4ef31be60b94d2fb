"""Closed-loop identification: plant, wind, controller and setpoint as one linear-Gaussian model, with its forecasts."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from mavdem.arrays import Array
from mavdem.dem.engine.gauss_newton import QuadraticExpansion
from mavdem.dem.engine.kalman import KalmanFilter
from mavdem.dem.engine.linalg import inverse, normal_draws, one_thread
from mavdem.dem.forecast.forecasting import ForecasterBase
from mavdem.dem.forecast.joint import MIXER_LAGS, axis_mixer
from mavdem.dem.forecast.var import Forecast, VectorAutoregression
from mavdem.dem.priors import derivative_pairs
from mavdem.dem.record import Record, TrainingData
from mavdem.errors import NotLearnable
from mavdem.facts import Fact
from mavdem.facts.loops import LoopFact
from mavdem.loops.loop_construction import inputs_per_demand, logged_controller, record_axis
from mavdem.loops.margins import RateLoop, plant_response, rate_loop
from mavdem.plant.closed_loop.evidence import LoopData, LoopPosterior, fit_closed_loop
from mavdem.plant.closed_loop.free_energy import (
    MOTORS_CHANNEL,
    LoopFreeEnergy,
    loop_free_energy,
    trim_augmented_filter,
)
from mavdem.plant.closed_loop.state_space import (
    CHANNELS,
    STATES,
    UNKNOWN_DERIVATIVE_CUTOFF,
    UNKNOWN_GYRO_CUTOFF,
    UNKNOWN_TARGET_CUTOFF,
    GenerativeParameters,
    LoopController,
    SampledLoop,
    sampled_loop,
    unknown_controller,
    wind_torque_output,
)

KNOWN_LOG_GAIN_SD = 0.1
"""Prior standard deviation of the logarithm of each gain that the autopilot's parameters state.

Saturation, and a thrust curve that differs from the parameters' one, change the gains by some per cent.
"""

MARGIN_DRAWS = 200
"""Number of draws from the posterior for the intervals of margins: a choice."""

MIN_KNOWN_RATIO = 1e-4
"""Least ratio of the integral gain (1/s), or of the derivative gain (s), to the proportional gain.

The model has the logarithms of these ratios, and a gain of 0 has none.
"""


def closed_loop(train: TrainingData, uses_recorded_gains: bool = True) -> ClosedLoop:
    """Learns the closed loop of one axis from angle, rate and motors.

    Args:
        train: a flight, or segments of one, with an angle and its rate as outputs.
        uses_recorded_gains: whether the controller has the gains of the flight's parameters, where they state them. If
            not, typical gains are the medians of their prior.

    Returns:
        The model at the maximum of its posterior.

    Raises:
        NotLearnable: a channel is constant, or no segment is long enough to estimate the mixer.
        ValueError: the outputs are not an angle and its rate, the motors have more than one combination that turns the
            axis, or no loop is stable.
    """
    record = Record.from_flights(train)
    angle_rate_pairs = derivative_pairs(record)
    if record.outputs.shape[1] != 2 or not angle_rate_pairs:
        raise ValueError("a closed loop needs two outputs, an angle and its rate")
    record.require_varying(known_inputs=True)
    with one_thread():
        mixer = axis_mixer(record)
        if mixer.shape[1] != 1:
            raise ValueError(
                "a closed loop needs one combination of the motors that turns the axis"
            )
        angle_and_rate = list(angle_rate_pairs[0])
        # The combination is signed so that it accelerates the axis in the positive sense of the rate.
        mixer = mixer * sign_of_effect(record, mixer)
        segments = []
        for inputs, outputs in record.segments:
            segments.append(np.hstack([outputs[:, angle_and_rate], inputs @ mixer]))
        data = LoopData.from_samples(segments, record.dt)
        # The controller turns a rate into a motor demand, so the ratio of their sizes is the size of its gain.
        _, rate_sd, motors_sd = data.scale.tolist()
        controller = unknown_controller(motors_sd / rate_sd)
        if uses_recorded_gains:
            with suppress(NotLearnable):
                controller = recorded_controller(record, mixer[:, 0])
        posterior = LoopPosterior(data, controller)
        return ClosedLoop(
            record,
            mixer=mixer,
            angle_and_rate=angle_and_rate,
            posterior=posterior,
            maximum=fit_closed_loop(posterior),
        )


def sign_of_effect(record: Record, mixer: Array) -> float:
    """Returns the sign of the effect that a combination of the motors has on the rate of the axis.

    A vector autoregression is fitted, which predicts outputs and combination from their earlier values. It has a
    coefficient for the effect of the combination on the rate at each lag; the sign is that of the sum of these.

    Args:
        record: the training data: T samples of r inputs and m outputs, in one or several segments.
        mixer: (r, 1) weights of the motors in the combination.

    Returns:
        1 if the combination increases the rate, otherwise −1.
    """
    record_of_mixed_input = replace(record, inputs=record.inputs @ mixer, effect_directions=None)
    coefficients = VectorAutoregression.learn(record_of_mixed_input, MIXER_LAGS).coefficients
    _, rate = derivative_pairs(record)[0]
    # The combination is the last channel of the autoregression.
    effect_on_rate = coefficients[:, rate, -1].sum()
    return -1.0 if effect_on_rate < 0 else 1.0


def recorded_controller(record: Record, mixer_row: Array) -> LoopController:
    """Returns the controller of an axis by the autopilot's parameters, with a combination of the motors as its output.

    The autopilot's own controller has a demand of torque as its output, from which the mixer makes the motor outputs.

    Args:
        record: the training data of the axis, with the autopilot's parameters.
        mixer_row: (r,) weights of the r motors in the combination, such as +1 on one side of the axis and −1 on the
            other.

    Returns:
        The controller with its gains per unit of the combination, as the medians of their prior. The ratios of the
        integral and the derivative gain to the proportional one are at least ``MIN_KNOWN_RATIO``, since the model has
        their logarithms.

    Raises:
        NotLearnable: the parameters, or the mixer, are not known; there is no proportional gain; or the combination
            decreases when the controller demands more torque, so that its sign is wrong.
    """
    axis = record_axis(record)
    controller = logged_controller(record.parameters, axis, record.effect_directions)
    if not controller.p > 0:
        name = controller.parameter_names["p"]
        raise NotLearnable(LoopFact.NO_PROPORTIONAL_GAIN, name=name, value=controller.p)
    # Change of the combination per unit of demand: the factor by which gains of the torque become gains of the
    # combination.
    combination_per_demand = float(mixer_row @ inputs_per_demand(controller, record))
    if not combination_per_demand > 0:
        raise NotLearnable(LoopFact.MIXER_REVERSED)
    return LoopController(
        angle_gain=controller.angle_gain,
        p=controller.p * combination_per_demand,
        integral_ratio=max(controller.i / controller.p, MIN_KNOWN_RATIO),
        derivative_ratio=max(controller.d / controller.p, MIN_KNOWN_RATIO),
        feed_forward=controller.ff * combination_per_demand,
        derivative_of_error=controller.derivative_of_error,
        # ArduPilot adds the derivative of the shaped target angle to the rate setpoint, PX4 does not.
        setpoint_slope_gain=float(controller.is_ardupilot),
        # A cut-off of 0 stands for a filter that is switched off or not known.
        gyro_cutoff=controller.gyro_filter or UNKNOWN_GYRO_CUTOFF,
        derivative_cutoff=controller.derivative_filter or UNKNOWN_DERIVATIVE_CUTOFF,
        target_cutoff=controller.target_filter or UNKNOWN_TARGET_CUTOFF,
        log_gain_sd=KNOWN_LOG_GAIN_SD,
    )


@dataclass(frozen=True, eq=False)
class ClosedLoop(ForecasterBase):
    """A learned closed loop with its forecasts, in physical units; a :class:`mavdem.Forecaster`."""

    record: Record
    """The training data."""

    mixer: Array
    """(r, 1) combination of the motors that turns the axis."""

    angle_and_rate: list[int]
    """Columns of the angle and of its rate in the outputs."""

    posterior: LoopPosterior
    """Log posterior of the parameters."""

    maximum: QuadraticExpansion
    """Its expansion about its maximum."""

    @cached_property
    def free_energy(self) -> LoopFreeEnergy:
        """F̄ by named terms, and F(t)."""
        return loop_free_energy(self.posterior, self.maximum)

    @property
    def spectral_radius(self) -> float:
        """Largest magnitude of the eigenvalues of one sampling step: below 1, as unstable loops have no posterior."""
        return float(abs(np.linalg.eigvals(self._filter.A[:STATES, :STATES])).max())

    @property
    def stable(self) -> bool:
        """Whether no mode grows."""
        return self.spectral_radius < 1

    @property
    def cautions(self) -> tuple[Fact | str, ...]:
        """Limits of the model: none are known."""
        return ()

    def rate_loop(self, draws: int = MARGIN_DRAWS, seed: int = 0) -> RateLoop:
        """Returns the rate loop, cut open, of the learned plant and the autopilot's controller, for stability margins.

        Only the plant is taken from the posterior; the gains of the controller are taken from the autopilot's
        parameters. The posterior has estimates of the gains too, but they are biased: they are fitted to motor outputs
        that are interpolated between messages. Interpolation smooths the fast changes, which lowers the estimate of the
        derivative gain by up to two thirds.

        Args:
            draws: number of draws from the posterior of the plant, for the intervals of the margins. They follow the
                estimate, which is the first row of the responses.
            seed: seed of the draws.

        Returns:
            The frequency response of the open loop, for the estimate and for each draw.

        Raises:
            NotLearnable: the parameters do not state the controller.
        """
        controller = logged_controller(
            self.record.parameters, record_axis(self.record), self.record.effect_directions
        )
        # The effect of the plant is per unit of the motors' combination. Times the combination's change per unit of the
        # controller's demand, it is the effect of a demand.
        combination_per_demand = float(
            self.mixer[:, 0] @ inputs_per_demand(controller, self.record)
        )
        covariance = inverse(self.maximum.curvature)
        theta = self.maximum.point
        thetas = np.vstack([theta, normal_draws(theta, covariance, draws, seed)])
        plants = GenerativeParameters(*np.exp(thetas).T)
        dynamics = np.column_stack([plants.damping, plants.lag, plants.delay])
        effectiveness = plants.effect * combination_per_demand
        return rate_loop(controller, plant_response(controller, effectiveness, dynamics))

    def wind_torque(self) -> Forecast:
        """Returns the wind torque over the last segment, rad/s², given all of its samples: mean and variance (T, 1)."""
        samples = self.posterior.data.segments[-1]
        # The wind torque is c · x, with these weights c of the states of the loop; the trims have the weight 0.
        weights = np.zeros(STATES + CHANNELS)
        weights[:STATES] = wind_torque_output(self.maximum.point, self._loop.state_sd)
        no_forcing = np.zeros((len(samples), len(weights)))
        states, innovations = self._filter.filter(np.zeros(len(weights)), no_forcing, samples)
        smoothed_states = self._filter.smooth(states, innovations)
        # The smoother also returns the state after the last sample, which is left out.
        mean = smoothed_states.means[:-1] @ weights
        # The variance c P cᵀ of each sample t.
        variance = np.einsum("i,tij,j->t", weights, smoothed_states.covariances[:-1], weights)
        return Forecast(mean[:, None], variance[:, None])

    @cached_property
    def _loop(self) -> SampledLoop:
        """The loop at the maximum, sampled at the record's rate."""
        return sampled_loop(self.maximum.point, self.posterior.controller, self.posterior.data.dt)

    @cached_property
    def _filter(self) -> KalmanFilter:
        """The exact filter over the last segment of the training data, with the trims as states."""
        data = self.posterior.data
        return trim_augmented_filter(self._loop, data.trim_covariance, len(data.segments[-1]))

    @property
    def gains_known(self) -> bool:
        """Whether the autopilot's parameters state the gains of the controller."""
        return self.posterior.controller.log_gain_sd <= KNOWN_LOG_GAIN_SD

    def one_step(self) -> Array:
        """Predicts each training sample from the samples before it in its segment, and from its own motors.

        The filter first predicts angle, rate and motors from the samples before. The measured motors differ from that
        prediction. This error is correlated with the errors of angle and rate, whose predictions it corrects.

        Returns:
            Outputs (T, 2), in the order of the record.
        """
        C = self._filter.C
        predictions = []
        for samples in self.posterior.data.segments:
            predicted_outputs = self._predicted_states(samples)[:-1] @ C.T
            innovations = samples - predicted_outputs
            rows = self._filter.gain_rows(len(samples))
            # Covariances (T, 3, 3) of the innovations of each sample.
            covariances = np.linalg.inv(self._filter.innovation_precisions[rows])
            # The slope of the regression of each channel's innovation on the motors' innovation (T, 3).
            motors_variances = covariances[:, [MOTORS_CHANNEL], MOTORS_CHANNEL]
            slopes = covariances[:, :, MOTORS_CHANNEL] / motors_variances
            predictions.append(predicted_outputs + slopes * innovations[:, [MOTORS_CHANNEL]])
        return self._output_forecast(np.concatenate(predictions), np.zeros(CHANNELS)).mean

    def rolling_forecast_unknown_inputs(
        self, steps: int, inputs: Array, outputs: Array
    ) -> Forecast:
        """Forecasts the outputs from the samples before, starting again at every ``steps``-th sample.

        Args:
            steps: number of samples of each forecast.
            inputs: (H, r) inputs after the training data; a forecast uses only the inputs before it.
            outputs: (H, 2) outputs of the same samples; a forecast uses only the outputs before it.

        Returns:
            Means and variances of angle and rate (H, 2).
        """
        steps = min(steps, len(inputs))
        A, C = self._filter.A, self._filter.C
        states = self._start_states(steps, inputs, outputs)
        covariance = self._filter.covariances[-1]
        means = []
        variances = []
        for _ in range(steps):
            means.append(states @ C.T)
            variances.append((C @ covariance @ C.T).diagonal())
            states = states @ A.T
            covariance = A @ covariance @ A.T + self._process_covariance
        return self._joined_forecast(np.stack(means, axis=1), np.array(variances), len(inputs))

    def rolling_forecast_known_inputs(
        self, steps: int, inputs: Array, outputs: Array, smooth: bool = False
    ) -> Forecast:
        """Forecasts the outputs with the motors as measurements, starting again at every ``steps``-th sample.

        Args:
            steps: number of samples of each forecast.
            inputs: (H, r) inputs after the training data; a forecast uses the inputs of its own samples too.
            outputs: (H, 2) outputs of the same samples; a forecast uses only the outputs before it.
            smooth: whether each sample is forecast with the motors at all samples of its forecast, and not only with
                those up to it.

        Returns:
            Means and variances of angle and rate (H, 2).
        """
        steps = min(steps, len(inputs))
        starts = self._start_states(steps, inputs, outputs)
        return self._forecast_from_states(starts, steps, inputs, smooth=smooth)

    def forecast_from_zero_state(self, inputs: Array) -> Array:
        """Returns the outputs (H, 2) with known ``inputs`` (H, r), after all channels were at their means."""
        zero_state = np.zeros((1, STATES + CHANNELS))
        return self._forecast_from_states(zero_state, len(inputs), inputs, smooth=False).mean

    def simulate(self, inputs: ArrayLike) -> Array:
        """Raises ``ValueError`` for any ``inputs``: in a closed loop only the controller commands the motors."""
        raise ValueError("a closed loop has no motors to command: use Learned.simulate")

    def _forecast_from_states(
        self, starts: Array, steps: int, inputs: Array, *, smooth: bool
    ) -> Forecast:
        """Forecasts the outputs by a Kalman filter that measures only the motors, and not the outputs.

        Args:
            starts: (S, n + 3) states at the start of S forecasts.
            steps: number of samples of each forecast.
            inputs: (H, r) motor samples of all forecasts, one after the other.
            smooth: whether a smoother follows, so that each sample is estimated with the later motor samples too.

        Returns:
            Means and variances of angle and rate (H, 2).
        """
        full_filter = self._filter
        motors_output = full_filter.C[MOTORS_CHANNEL:]
        motors_filter = KalmanFilter.design(
            A=full_filter.A,
            C=motors_output,
            Q=self._process_covariance,
            R=self._loop.noise_covariance[MOTORS_CHANNEL:, MOTORS_CHANNEL:],
            S=np.zeros((len(full_filter.A), 1)),
            initial_covariance=full_filter.covariances[-1],
            samples=steps,
        )
        motors = inputs @ self.mixer - self.posterior.data.center[MOTORS_CHANNEL]
        # Row of the motor samples at each step of each forecast, (S, steps). The last forecast may reach beyond the
        # samples; it repeats the last row there, and is cut off later.
        last_row = len(inputs) - 1
        rows = np.minimum(np.arange(len(starts) * steps), last_row).reshape(-1, steps)
        no_forcing = np.zeros((*rows.shape, len(full_filter.A)))
        states, innovations = motors_filter.filter(starts, no_forcing, motors[rows])
        if smooth:
            smoothed_states = motors_filter.smooth(states, innovations)
            estimates = smoothed_states.means[:, :-1]
            covariances = smoothed_states.covariances[:-1]
        else:
            # Each state is corrected by the motors of its own sample: x̂ + P Cᵀ F⁻¹ e.
            P = motors_filter.predicted_covariances(steps)[:-1]
            precisions = motors_filter.innovation_precisions[motors_filter.gain_rows(steps)]
            gains = P @ motors_output.T @ precisions
            # Letters of einsum: forecast s, sample t, state n, channel i. The gains are the same for all forecasts.
            estimates = states[:, :-1] + np.einsum("tni,sti->stn", gains, innovations)
            covariances = P - gains @ motors_output @ P
        C = full_filter.C
        # The variance of each channel c at each sample t, from the covariance of states i and j.
        variances = np.einsum("ci,tij,cj->tc", C, covariances, C)
        return self._joined_forecast(estimates @ C.T, variances, len(inputs))

    @property
    def _process_covariance(self) -> Array:
        """(n + 3, n + 3) covariance of the process noise of one step; the trims have none."""
        covariance = np.zeros_like(self._filter.A)
        covariance[:STATES, :STATES] = self._loop.process_covariance
        return covariance

    def _predicted_states(self, samples: Array) -> Array:
        """Returns the state before each of T centred samples (T, 3), and after the last, (T + 1, n + 3)."""
        zero_state = np.zeros(len(self._filter.A))
        forcing = np.zeros((len(samples), len(zero_state)))
        states, _ = self._filter.filter(zero_state, forcing, samples)
        return states

    def _start_states(self, steps: int, inputs: Array, outputs: Array) -> Array:
        """Estimates the state at which each of several consecutive forecasts starts.

        The Kalman filter runs over the last training segment and on over the test data that follow it. Each forecast
        starts from the filter's prediction of the state at its first sample, given all samples before that one.

        Args:
            steps: number of samples of each forecast. The first starts at the first test sample.
            inputs: (H, r) motors of the test data, which follow the training data.
            outputs: (H, 2) outputs of the same samples.

        Returns:
            Means of the states (S, n + 3), one row for each of the S = ⌈H / steps⌉ forecasts: the n states of the loop,
            then the trims of its 3 channels (angle, rate, and the motors' combination).
        """
        data = self.posterior.data
        test_channels = np.hstack([outputs[:, self.angle_and_rate], inputs @ self.mixer])
        training_samples = data.segments[-1]
        samples = np.concatenate([training_samples, test_channels - data.center])
        # Row i is the state predicted for sample i from those before it. A last row, after all samples, is left out.
        predicted_states = self._predicted_states(samples)[:-1]
        return predicted_states[len(training_samples) :: steps]

    def _joined_forecast(self, means: Array, variances: Array, length: int) -> Forecast:
        """Joins forecasts, one after the other, and cuts off the part of the last one that is beyond the samples.

        Args:
            means: (S, steps, 3) means of the centred channels in S forecasts.
            variances: (steps, 3) variances of the channels.
            length: number H of samples.

        Returns:
            Means and variances of angle and rate (H, 2).
        """
        joined_means = means.reshape(-1, CHANNELS)[:length]
        # Variances depend only on the steps since the start of a forecast, so that all forecasts have the same.
        joined_variances = np.tile(variances, (len(means), 1))[:length]
        return self._output_forecast(joined_means, joined_variances)

    def _output_forecast(self, means: Array, variances: Array) -> Forecast:
        """Converts means and variances of the model's channels to a forecast of the outputs.

        Args:
            means: (…, 3) means of the channels, of which the model's offset was subtracted: angle, rate, and command.
            variances: (…, 3) their variances.

        Returns:
            Means and variances (…, 2) of angle and rate, in the order in which the record has these two outputs.
        """
        # Channels 0 and 1 are angle and rate. ``angle_and_rate`` has the columns of these two in the record's outputs:
        # (0, 1), or (1, 0) if the record has the rate first. Sorting by column restores the order of the outputs.
        order = np.argsort(self.angle_and_rate)
        means_with_offset = means + self.posterior.data.center
        return Forecast(means_with_offset[..., order], variances[..., order])
