"""Model of the cross-spectral densities of rate, output and setpoint in a closed loop, aliased by slow logging.

All sources of the loop (see :mod:`~mavdem.plant.closed_loop.response`) are Gaussian and stationary: the reference,
white noise before and after the gyro filters and of the angle, a share of the output's own density for what the output
does besides the control law, and wind torque of three spectra. The larger that share, the more the output counts as a
known input. Because the loop is closed in the model, noise that the loop feeds back is not attributed to wind.

Sampled at the message rate f_s, a quantity has at each frequency f the sum of all that folds onto it from f + k f_s
(Brillinger, Time Series, sec. 7.6):

    Φ(f) = Σ_k Σ_source  φ_source(f_k) · q_source(f_k) q_source(f_k)ᴴ ∘ D_k + Φ_log,     f_k = f + k f_s,

with the closed-loop responses q of the three modelled quantities, the phases D_k by which their stamps differ, and the
error Φ_log of logging and rounding.

Part of the reference comes in steps at the cycles of an outer loop, synchronous with the messages. Its aliases then
have a fixed phase, given by the time from a step to the next message, and add coherently instead of in power.
"""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from mavdem.arrays import Array
from mavdem.plant.closed_loop.parameters import (
    CONTROLLER,
    DAMPING,
    DELAY,
    EFFECT,
    LAG,
    LOOP_PARAMETERS,
    PARAMETER_NAMES,
    STEP_TIME,
    LoopParameters,
)
from mavdem.plant.closed_loop.reference import (
    MAX_OTHER_CYCLE_SHARE,
    denoised_density,
    unfolded_density,
)
from mavdem.plant.closed_loop.response import (
    MODELLED_QUANTITIES,
    ClosedLoopResponse,
    ControllerResponses,
    KnownController,
    Quantity,
    Source,
    closed_loop_response,
)
from mavdem.plant.closed_loop.spectra import ComplexArray, CrossSpectra
from mavdem.plant.sampled_plant import FIRST_ORDER

QUANTITIES = len(MODELLED_QUANTITIES)
"""Number C of quantities whose joint density is modelled."""

UNMODELLED_TORQUE_FRACTION = 0.02
"""Fraction of the motors' torque that no linear plant explains: a floor under the wind torque.

Without it, one of 19 simulated flights had a gain margin that was 10 dB wrong; with it, 0.4 dB.
"""

LOGGING_ERROR_FRACTION = 0.01
"""Standard deviation by which a logged setpoint differs from the controller's, relative to the setpoint: a choice."""

OUTPUT_ERROR_FRACTION = LOGGING_ERROR_FRACTION / 2
"""Standard deviation by which a logged output differs from the controller's, relative to the output: a choice."""

MIN_GYRO_NOISE_DENSITY = 1e-9
"""Two-sided noise density of the best gyros, (rad/s)²/Hz.

Gyros of simulators have less, and a model without this floor would be too certain of itself.
"""

MAX_MODELLED_FREQUENCY = 1000.0
"""Highest frequency that is modelled, Hz. Gyro filters leave nothing beyond, and each alias takes time."""


@dataclass(frozen=True)
class DensityComponent:
    """One component of a source's spectral density, with its dependence on the parameters."""

    source: Source
    """The source that the component belongs to."""

    density: Array
    """Two-sided density (J, F), in the source's unit² per Hz."""

    log_slopes: dict[str, float | Array] = field(default_factory=dict)
    """Derivative of the density's logarithm by the logarithm of each parameter it depends on, by parameter name."""


@dataclass(frozen=True)
class SynchronousSteps:
    """Steps of the reference that are synchronous with the messages, and the responses to them."""

    density: Array
    """Two-sided density (J, 1, 1) of the steps as they are sampled, (rad/s)²/Hz."""

    log_slopes: dict[str, float | Array]
    """Derivative of the density's logarithm by the logarithm of each parameter it depends on, by parameter name."""

    alias_shares: ComplexArray
    """Complex share of each alias in the sampled steps (J, F), with sum 1 over the aliases."""

    response: ComplexArray
    """Sampled response of each modelled quantity to the sampled steps (J, C)."""

    @property
    def quantity_density(self) -> ComplexArray:
        """Cross-spectral density (J, C, C) that the steps cause in the modelled quantities."""
        return self.density * _outer(self.response, self.response)


class DensityModel:
    """Cross-spectral densities of C logged quantities at J frequencies, with F aliases each, by log parameters θ.

    J are the frequencies of the spectra, F the aliases that sampling folds onto each, C the modelled quantities (rate,
    output, setpoint), S the sources (reference, gyro noise, actuation, wind), k the parameters.
    """

    def __init__(self, spectra: CrossSpectra, controller: KnownController, rounding: float) -> None:
        """Computes all that does not depend on θ.

        Args:
            spectra: estimated spectra of all four quantities, in the order of ``Quantity``.
            controller: the controller that flew.
            rounding: resolution of the logged output, in the unit of the demand on the axis.
        """
        self._angle_gain = controller.angle_gain
        self._cycle_time = controller.cycle_time
        self._message_rate = spectra.message_rate
        self.surplus_interval = max(1 / spectra.message_rate - controller.cycle_time, 0.0)
        """Time between two messages beyond one cycle of the controller, s; 0 if every cycle is logged."""

        self._set_frequencies(spectra)
        self._set_controller(controller)
        # Power densities (J, 4) of the four quantities, the diagonals of their cross-spectral densities.
        power_densities = spectra.mean_density.diagonal(axis1=1, axis2=2).real
        self._logging_error = self._logging_error_density(power_densities, rounding)
        self._set_output_and_reference(spectra.frequency, power_densities)
        # Stamps (C, N) of N messages of each modelled quantity, s, relative to the stamps of the first quantity.
        stamp_offsets = np.array(spectra.stamp_offsets[:QUANTITIES])
        self._set_alias_phases(stamp_offsets)
        other_cycle_share = spectra.other_cycle_share(
            Quantity.SETPOINT, Quantity.RATE, controller.cycle_time
        )
        if other_cycle_share > MAX_OTHER_CYCLE_SHARE:
            # The reference was computed by the gyro, which cancels the noise of no setpoint.
            noises_per_setpoint = 1.0
        else:
            # In other cycles than the setpoint the interpolated angle adds its noise to that of the setpoint.
            noises_per_setpoint = 2 * other_cycle_share
        self._reference_noise_gain = noises_per_setpoint * controller.angle_gain**2
        """Variance of the noise in the logged reference, per variance of the noise of the angle, 1/s².

        The setpoint contains K times the noise of the angle. The reference, the setpoint plus K times the angle, does
        not if both are logged in the same controller cycle, since their noise cancels.
        """

    def _set_frequencies(self, spectra: CrossSpectra) -> None:
        """Sets the frequencies f + k f_s that sampling at the message rate f_s maps (aliases) to the spectra's.

        All k, including negative ones, are used for which |f + k f_s| is below half of the controller's rate (or
        ``MAX_MODELLED_FREQUENCY``, if that is lower). Frequencies and flags have the shape (J, F): a row for each
        frequency f of the spectra, a column for each k.

        Args:
            spectra: estimated spectra at J frequencies f, Hz.
        """
        nyquist = 0.5 / self._cycle_time
        highest = min(nyquist, MAX_MODELLED_FREQUENCY)
        count = np.ceil(highest / self._message_rate)
        self._alias_numbers = np.arange(-count, count + 1)
        frequency = spectra.frequency[:, None] + self._alias_numbers * self._message_rate
        self._in_range = np.abs(frequency) < highest
        # Frequencies out of range are replaced by 1 Hz, which avoids division by 0. The densities there are set to 0.
        self._frequency = np.where(self._in_range, frequency, 1.0)
        self._s = 2j * np.pi * self._frequency
        self._angular_frequency = np.abs(self._s)

    def _set_controller(self, controller: KnownController) -> None:
        """Sets the quantities that depend only on the controller, at J frequencies with F aliases each (J, F).

        They are the controller's frequency responses to the reference and to the gyro, the response of the gyro's
        filters, the density of white noise of variance 1 with one value per controller cycle, and the transform of a
        unit step at one of the cycles.

        Args:
            controller: frequency responses, attitude gain and cycle time of the controller that flew.
        """
        to_reference, to_gyro = controller.transfer(self._frequency)
        self._controller = ControllerResponses(to_reference, to_gyro)
        self._gyro_filter = controller.gyro_filter(self._frequency)
        # White noise of variance 1, one value a cycle, has the density of one cycle time.
        self._white_density = np.where(self._in_range, self._cycle_time, 0.0)
        # A unit step at one of the controller's cycles has the z-transform 1 / (1 − 1/z).
        self._step_transform = self._in_range / (1 - np.exp(-self._s * self._cycle_time))

    def _logging_error_density(self, power_densities: Array, rounding: float) -> Array:
        """Returns the density of the errors that logging adds to the quantities, in which they are independent.

        The errors are a fraction of the setpoint and of the output, the rounding of the output, and for the rate the
        noise of a good gyro.

        Args:
            power_densities: estimated power densities (J, 4) of all quantities, in the order of ``Quantity``.
            rounding: resolution of the logged output, in the unit of the demand.

        Returns:
            Diagonal cross-spectral densities (J, C, C).
        """
        errors = LOGGING_ERROR_FRACTION**2 * power_densities[:, :QUANTITIES]
        errors[:, Quantity.RATE] = MIN_GYRO_NOISE_DENSITY
        # Rounding to a resolution q makes an error of variance q²/12, which is white at the message rate.
        rounding_density = rounding**2 / 12 / self._message_rate
        errors[:, Quantity.OUTPUT] = (
            OUTPUT_ERROR_FRACTION**2 * power_densities[:, Quantity.OUTPUT] + rounding_density
        )
        return errors[..., None] * np.eye(QUANTITIES)

    def _set_output_and_reference(self, frequency: Array, power_densities: Array) -> None:
        """Sets the densities of output and reference, which are estimated from the log instead of being modelled.

        The density of the output scales the noise that is proportional to it. The reference is made by the pilot, who
        is not modelled. The log is slow, so that higher frequencies alias onto those of the estimates: the estimated
        density of the reference is the sum over all of them, and is divided among them again.

        Args:
            frequency: frequencies (J,) of the estimates, Hz.
            power_densities: estimated power densities (J, 4) of all quantities, in the order of ``Quantity``.
        """
        # (J, F): each frequency of the estimates with the F frequencies that alias onto it, itself included. These may
        # be negative, but densities of real signals depend on their magnitude alone.
        alias_frequency = np.abs(self._frequency)
        output_density = np.interp(alias_frequency, frequency, power_densities[:, Quantity.OUTPUT])
        # Aliases beyond the range of the model, where ``_in_range`` is 0, are left out of all sums.
        self._output_density = output_density * self._in_range

        sum_over_aliases = power_densities[:, Quantity.REFERENCE]
        # (J, 1, 1), like the cross-spectral densities (J, C, C).
        self._aliased_reference_density = sum_over_aliases[:, None, None]
        # Alias number 0 is the frequency itself.
        is_not_aliased = self._alias_numbers == 0
        reference_density = unfolded_density(
            sum_over_aliases, alias_frequency, is_not_aliased, self._in_range
        )
        # Other densities are divided by this one, so that it is 1 and not 0 beyond the range.
        self._reference_density = np.where(self._in_range, reference_density, 1.0)

    def _set_alias_phases(self, stamp_offsets: Array) -> None:
        """Sets the phase by which aliases of two quantities differ, because their messages have different time stamps.

        If a quantity is sampled t seconds later than another, its content at f + k f_s gets a phase that is larger by
        2π k f_s t than the phase of the content at f. As t varies, the phase factor exp(2πj k f_s t) between two
        quantities is the mean over all messages. If t varies much, the magnitude of the mean is small, and the alias
        adds little to the coherence.

        Args:
            stamp_offsets: stamps (C, N) of N messages of each quantity, s, relative to the stamps of the first one.
        """
        self._alias_laplace_variables = 2j * np.pi * self._message_rate * self._alias_numbers
        # The factors exp(s_k t) of each alias, quantity and message (F, C, N), with s_k = 2πj k f_s.
        phases = np.exp(self._alias_laplace_variables[:, None, None] * stamp_offsets)
        # The matrix product sums over the messages: (F, C, C), a phase for each pair of quantities.
        message_count = stamp_offsets.shape[1]
        mean_phases = phases @ phases.mT.conj() / message_count
        # (C, C, 1, F): the pairs of quantities come first, and all J frequencies have the same phases.
        self._alias_phases = mean_phases.transpose(1, 2, 0)[:, :, None]

    def density(self, theta: Array, with_reference: bool = True) -> ComplexArray:
        """Returns the modelled cross-spectral density of the C logged quantities at J frequencies.

        It is the sum of three densities. Each of the independent sources (reference, gyro noise, actuation, wind
        torque) adds its density times the products of the closed loop's responses to it, summed over all aliases of a
        frequency. Steps of the reference that are synchronous with the messages are added with the phases of their
        aliases instead. The errors of the log add the third density.

        Args:
            theta: logarithms of the parameters (k,).
            with_reference: whether the reference moves; without it, noise and wind torque remain.

        Returns:
            The modelled cross-spectral density (J, C, C).
        """
        parameters = LoopParameters.from_logarithms(theta)
        loop = self._closed_loop(parameters)
        components = self._source_components(parameters, loop, with_reference=with_reference)
        source_densities = _source_densities(components)
        steps = self._synchronous_steps(parameters, loop, with_reference=with_reference)
        density = self._logging_error + steps.quantity_density
        for source_density, response in zip(source_densities, loop.from_source, strict=True):
            # One weight, the source's density: the axis of the weights, of length 1, is removed from the result.
            sums = self._sums_over_aliases(source_density[None], response, response.conj())
            density += sums[:, 0]
        return density

    def density_and_gradient(self, theta: Array) -> tuple[ComplexArray, ComplexArray]:
        """Returns the modelled cross-spectral density, and its derivatives by the logarithm of each parameter.

        Parameters act in three ways. The loop's parameters change the responses to every source. The time of the
        synchronous steps changes their phases. All others change only the density of a source. The derivative of that
        density is the density times a logarithmic slope, d ln density / dθ, and is multiplied by the same responses.

        ``tests/plant/test_closed_loop.py`` compares the derivatives with finite differences.

        Args:
            theta: logarithms of the parameters (k,).

        Returns:
            Density (J, C, C), as :meth:`density` returns it, and derivatives (J, k, C, C).
        """
        parameters = LoopParameters.from_logarithms(theta)
        loop = self._closed_loop(parameters)
        components = self._source_components(parameters, loop)
        source_densities = _source_densities(components)
        steps = self._synchronous_steps(parameters, loop)
        steps_density = steps.quantity_density
        density = self._logging_error + steps_density

        derivatives = np.zeros(
            (len(density), len(PARAMETER_NAMES), QUANTITIES, QUANTITIES), complex
        )
        derivatives[:, :LOOP_PARAMETERS] = self._loop_gradient(
            parameters, loop, source_densities, steps
        )
        derivatives[:, STEP_TIME] = self._step_time_gradient(parameters, loop, steps)
        for name, slope in steps.log_slopes.items():
            derivatives[:, PARAMETER_NAMES.index(name)] += slope * steps_density

        for source in Source:
            # The source's density and its derivatives are multiplied by the same responses and summed over the aliases,
            # all in one product. The first is the density, the others are its derivatives by ``parameter_indices``.
            parameter_indices = list[int]()
            densities = [source_densities[source]]
            for component in components:
                if component.source != source:
                    continue
                for name, slope in component.log_slopes.items():
                    parameter_indices.append(PARAMETER_NAMES.index(name))
                    densities.append(component.density * slope)
            response = loop.from_source[source]
            sums = self._sums_over_aliases(np.array(densities), response, response.conj())
            density += sums[:, 0]
            # They are added one by one, since a parameter of two components of this source occurs twice.
            for number, parameter in enumerate(parameter_indices, start=1):
                derivatives[:, parameter] += sums[:, number]
        return density, derivatives

    def rate_loop_response(self, theta: Array) -> ComplexArray:
        """Returns the open-loop response of the rate loop, A C_y F, at the J frequencies themselves (J,).

        Args:
            theta: logarithms of the parameters (k,).
        """
        parameters = LoopParameters.from_logarithms(theta)
        loop = self._closed_loop(parameters)
        output_from_rate = parameters.controller * self._controller.from_rate * self._gyro_filter
        # Alias number 0 is the frequency itself.
        (base,) = np.flatnonzero(self._alias_numbers == 0)
        response: ComplexArray = (loop.rate_from_output * output_from_rate)[:, base]
        return response

    def _closed_loop(self, parameters: LoopParameters) -> ClosedLoopResponse:
        """Computes the frequency responses of the closed loop at all J frequencies and F aliases of each.

        Args:
            parameters: effect, damping, lag and delay of the plant, and the sizes of wind and noise.

        Returns:
            The responses of the loop's signals.
        """
        return closed_loop_response(
            parameters, self._controller, self._gyro_filter, self._angle_gain, self._s
        )

    def _source_components(
        self, parameters: LoopParameters, loop: ClosedLoopResponse, *, with_reference: bool = True
    ) -> list[DensityComponent]:
        """Returns the components of the densities of all sources except the synchronous steps.

        They are: the reference without its synchronous steps; noise of the angle, which acts like a reference; gyro
        noise before and after the filters; actuation noise, a share of the density of the output, since the output does
        not exactly follow the control law; and wind torque, which consists of a floor in proportion to the
        motors' torque, slow drift, quick eddies, and smooth gusts.

        Args:
            parameters: the parameters of the loop.
            loop: its frequency responses, of which the motor lag is used.
            with_reference: whether the reference varies; if not, its density is 0.

        Returns:
            The components, each with its source and the logarithmic slopes of its density.
        """
        # A density that is proportional to the n-th power of a parameter has the logarithmic slope n. The slope of the
        # asynchronous share 1 − p by the logarithm of the odds is −p.
        synchronous = _share_from_odds(parameters.synchronous_odds)
        asynchronous = (1 - synchronous) if with_reference else 0.0
        reference, noise_slope = denoised_density(
            self._reference_density, self._reference_noise(parameters) * self._cycle_time
        )
        angle_noise = (self._angle_gain * parameters.angle_noise) ** 2 * self._white_density
        gyro_noise = (parameters.gyro_noise * np.abs(self._gyro_filter)) ** 2 * self._white_density
        filtered_noise = parameters.filtered_noise**2 * self._white_density
        actuation = parameters.actuation**2 * self._output_density
        lag_power = np.abs(loop.motor_lag) ** 2
        # The torque of the motors is effect · output, through their lag.
        torque_fraction = UNMODELLED_TORQUE_FRACTION * parameters.effect
        unmodelled_torque = torque_fraction**2 * lag_power * self._output_density
        return [
            DensityComponent(
                Source.REFERENCE,
                reference * self._in_range * asynchronous,
                {"synchronous_odds": -synchronous, "angle_noise": noise_slope},
            ),
            DensityComponent(Source.REFERENCE, angle_noise, {"angle_noise": 2.0}),
            DensityComponent(Source.GYRO_NOISE, gyro_noise, {"gyro_noise": 2.0}),
            DensityComponent(Source.GYRO_NOISE, filtered_noise, {"filtered_noise": 2.0}),
            DensityComponent(Source.ACTUATION, actuation, {"actuation": 2.0}),
            DensityComponent(
                Source.WIND, unmodelled_torque, {"effect": 2.0, "lag": 2 * (lag_power - 1)}
            ),
            self._first_order_wind("drift", sd=parameters.drift_size, time=parameters.drift_time),
            self._first_order_wind("eddy", sd=parameters.eddy_size, time=parameters.eddy_time),
            self._smooth_wind(sd=parameters.gust_size, time=parameters.gust_time),
        ]

    def _first_order_wind(self, name: str, *, sd: float, time: float) -> DensityComponent:
        """Computes the spectral density of a first-order component of the wind torque, and its derivatives.

        With the standard deviation σ and the correlation time T, its autocorrelation is σ² exp(−|τ|/T), and its density
        φ = 2 σ² T / (1 + (ω T)²). So d ln φ / d ln σ = 2, and d ln φ / d ln T = (1 − (ω T)²) / (1 + (ω T)²).

        Args:
            name: name of the component, "drift" or "eddy"; its parameters are the name with ``_size`` and ``_time``.
            sd: standard deviation σ, rad/s².
            time: correlation time T, s.

        Returns:
            The density with these two derivatives.
        """
        squared_ratio = (self._angular_frequency * time) ** 2
        density = FIRST_ORDER.density(self._angular_frequency, sd, time) * self._in_range
        time_slope = (1 - squared_ratio) / (1 + squared_ratio)
        return DensityComponent(
            Source.WIND, density, {f"{name}_size": 2.0, f"{name}_time": time_slope}
        )

    def _smooth_wind(self, *, sd: float, time: float) -> DensityComponent:
        """Computes the spectral density of the smooth component of the wind torque, and its derivatives.

        With the standard deviation σ and the time scale T, its autocorrelation is σ² exp(−τ²/(4 T²)), and its density
        φ = 2 √π σ² T exp(−(ω T)²). So d ln φ / d ln σ = 2, and d ln φ / d ln T = 1 − 2 (ω T)².

        Args:
            sd: standard deviation σ, rad/s².
            time: time scale T, s.

        Returns:
            The density with these two derivatives.
        """
        squared_ratio = (self._angular_frequency * time) ** 2
        density = 2 * np.sqrt(np.pi) * sd**2 * time * self._in_range * np.exp(-squared_ratio)
        return DensityComponent(
            Source.WIND, density, {"gust_size": 2.0, "gust_time": 1 - 2 * squared_ratio}
        )

    def _synchronous_steps(
        self, parameters: LoopParameters, loop: ClosedLoopResponse, *, with_reference: bool = True
    ) -> SynchronousSteps:
        """Returns the density of the synchronous steps of the reference, and the responses of the loop to them.

        If an outer loop sets a new reference just as often as messages are sent, each step of the reference comes at
        the same time before a message: the steps are synchronous with the messages. A share p of the power of the
        logged reference, without its noise, is that of such steps. It is a parameter of the loop, as the odds
        p / (1 − p).

        Args:
            parameters: the parameters of the loop, with the odds of p and the noise of the angle, from which the
                reference is computed.
            loop: frequency responses of the loop, of which those to the reference are used.
            with_reference: whether the reference moves; without it, the steps' density is 0.

        Returns:
            The density of the steps, its derivatives, the share of each alias, and the responses to the steps.
        """
        reference_density, noise_slope = denoised_density(
            self._aliased_reference_density, self._reference_noise(parameters) / self._message_rate
        )
        synchronous_share = _share_from_odds(parameters.synchronous_odds)
        step_density = synchronous_share * reference_density
        if not with_reference:
            step_density = np.zeros_like(reference_density)
        alias_shares = self._shares_of_aliases_in_steps(parameters)
        return SynchronousSteps(
            density=step_density,
            # The share p = odds / (1 + odds) has the derivative d ln p / d ln odds = 1 − p.
            log_slopes={"synchronous_odds": 1 - synchronous_share, "angle_noise": noise_slope},
            alias_shares=alias_shares,
            response=self._sampled_step_response(alias_shares, loop.from_source[Source.REFERENCE]),
        )

    def _shares_of_aliases_in_steps(self, parameters: LoopParameters) -> ComplexArray:
        """Returns the complex shares (J, F) of the F aliases in synchronous steps as they are sampled; their sum is 1.

        Sampling at the rate f_s of the messages maps the spectrum of the steps at all aliases f + k f_s to the
        frequency f. All steps come at the same time before a message, which gives each alias a fixed phase. So the
        aliases are added as complex amplitudes. Those of all other sources have random phases, and add in power.

        Args:
            parameters: the parameters of the loop, with the odds p / (1 − p) of the share p of ``surplus_interval``
                that is the time from a step to the next message.
        """
        # A step comes in a cycle of the controller. The first cycle after a message is the surplus interval (the time
        # between two messages, less one cycle) ahead of the next message, which is the longest step time, s.
        step_time = _share_from_odds(parameters.step_time_odds) * self.surplus_interval
        # The transform of a step, times exp(2πj k f_s · step time), the phase of alias k.
        amplitudes = self._step_transform * np.exp(self._alias_laplace_variables * step_time)
        return amplitudes / amplitudes.sum(axis=-1, keepdims=True)

    def _reference_noise(self, parameters: LoopParameters) -> float:
        """Returns the variance of the noise in the logged reference that comes from the estimated angle, (rad/s)².

        Args:
            parameters: parameters of the loop, with the noise of the angle.
        """
        return self._reference_noise_gain * parameters.angle_noise**2

    def _sampled_step_response(
        self, alias_shares: ComplexArray, response: ComplexArray
    ) -> ComplexArray:
        """Returns the sampled response (J, C) for one set of alias shares (J, F).

        Args:
            alias_shares: complex amplitude of each alias, relative to the sampled steps (J, F).
            response: response of each quantity to the reference (C, J, F).
        """
        return self._sampled_step_responses(alias_shares[None], response)[:, 0]

    def _sampled_step_responses(
        self, alias_shares: ComplexArray, response: ComplexArray
    ) -> ComplexArray:
        """Returns how the sampled quantities respond to steps of the reference that are synchronous with the messages.

        Such steps come at the same time before every message. So all aliases that fold onto a frequency have fixed
        phases, and their responses add as complex amplitudes, not in power as those to other sources.

        Args:
            alias_shares: n sets of complex amplitudes of each alias, relative to the sampled steps (n, J, F).
            response: response of each quantity to the reference (C, J, F).

        Returns:
            Responses of the C sampled quantities for each set of amplitudes, at each frequency (J, n, C).
        """
        # The amplitudes hold for the times at which the setpoint is sampled. Each quantity is sampled a fixed time
        # before or after it, which turns the phases of its aliases (C, 1, F).
        phases_relative_to_setpoint = self._alias_phases[:, Quantity.SETPOINT]
        response_when_sampled = response * phases_relative_to_setpoint
        shares_by_frequency = alias_shares.swapaxes(0, 1)
        response_by_frequency = response_when_sampled.transpose(1, 2, 0)
        # At each of the J frequencies, the product (n, F) @ (F, C) sums over the aliases.
        return shares_by_frequency @ response_by_frequency

    def _sums_over_aliases(
        self, weights: NDArray[np.inexact], response: ComplexArray, conjugate_response: ComplexArray
    ) -> ComplexArray:
        """Returns Σ weight · r_a r̄_b D_ab over all aliases, for each pair of quantities a and b.

        With the density of a source as weight, its response as r and the conjugate response as r̄, this is the
        cross-spectral density that the source adds to the sampled quantities, since its aliases add in power. The phase
        D_ab of each alias is there because a and b are sampled at different times (:meth:`_set_alias_phases`).

        Args:
            weights: n densities or other weights of each alias (n, J, F).
            response: response r of each quantity (C, J, F).
            conjugate_response: conjugate response r̄ of each quantity (C, J, F).

        Returns:
            Sums (J, n, C, C).
        """
        # The products of each pair of quantities (C, C, J, F).
        products = response[:, None] * conjugate_response * self._alias_phases
        # They are arranged as matrices (F, C²), one for each of the J frequencies.
        frequencies_and_aliases = products.shape[2:]
        products_by_frequency = products.reshape(QUANTITIES**2, *frequencies_and_aliases).transpose(
            1, 2, 0
        )
        # At each frequency, the product (n, F) @ (F, C²) sums over the aliases.
        sums = weights.swapaxes(0, 1) @ products_by_frequency
        frequency_count, weight_count, _ = sums.shape
        return sums.reshape(frequency_count, weight_count, QUANTITIES, QUANTITIES)

    def _loop_gradient(
        self,
        parameters: LoopParameters,
        loop: ClosedLoopResponse,
        source_densities: Array,
        steps: SynchronousSteps,
    ) -> ComplexArray:
        """Returns the derivatives of the density by the plant's parameters and the controller's gain.

        Let X be the body rate that a source causes, Q the quantities per body rate, S the sensitivity, and A the path
        from the controller's output to the body rate. A relative change dA/A changes the quantities by Q S X dA/A. For
        wind torque, which enters after the motors, it is Q (S − 1) X dA/A. A relative change of the plant alone
        changes them by Q S X for every source. A relative change of the controller acts like dA/A, with S − 1 for
        actuation, and also changes the output directly. With the response q of the quantities to a source, the
        derivative of q qᴴ is dq qᴴ plus its adjoint.

        ``tests/plant/test_closed_loop.py`` compares the derivatives with finite differences.

        Args:
            parameters: the parameters of the loop.
            loop: its frequency responses; S = ``sensitivity``, Q = ``from_rate`` and X = ``rate_from_source`` times the
                spectrum of the source.
            source_densities: density of each source (S, J, F).
            steps: the synchronous steps at these parameters.

        Returns:
            Derivatives (J, 5, C, C) by the logarithms of effect, damping, lag, delay and controller gain, in the order
            of θ.
        """
        # Relative changes of the path from output to rate by the logarithm of each parameter. For the effect, and for
        # the gain of the controller, the path changes as much as the parameter, relatively: the slope is 1.
        damping_slope = -parameters.damping * loop.plant
        lag_slope = -parameters.lag * self._s * loop.motor_lag
        delay_slope = -parameters.delay * self._s
        unit_slope = np.ones_like(delay_slope)

        conjugate = loop.from_source.conj()
        # Letters of einsum: source s, quantity c, frequency j and alias f. Sums over s are over all sources.
        rate_spectra = source_densities * loop.rate_from_source
        all_sources = loop.sensitivity * np.einsum("sjf,scjf->cjf", rate_spectra, conjugate)
        wind = rate_spectra[Source.WIND] * conjugate[Source.WIND]
        actuation = rate_spectra[Source.ACTUATION] * conjugate[Source.ACTUATION]
        spectra_by_actuation_path = all_sources - wind

        # One half of each derivative, dq qᴴ. The other half is its adjoint, which is added at the end.
        half_gradient = np.empty(
            (len(unit_slope), LOOP_PARAMETERS, QUANTITIES, QUANTITIES), complex
        )
        path_slopes = np.array([unit_slope, lag_slope, delay_slope])
        half_gradient[:, [EFFECT, LAG, DELAY]] = self._sums_over_aliases(
            path_slopes, loop.from_rate, spectra_by_actuation_path
        )
        half_gradient[:, [DAMPING]] = self._sums_over_aliases(
            damping_slope[None], loop.from_rate, all_sources
        )
        half_gradient[:, [CONTROLLER]] = self._sums_over_aliases(
            unit_slope[None], loop.from_rate, spectra_by_actuation_path - actuation
        )
        # The output without actuation noise is proportional to the controller's gain.
        # Actuation noise is added to the output with a response of 1, which is subtracted here.
        control_law = loop.from_source[:, Quantity.OUTPUT].copy()
        control_law[Source.ACTUATION] -= 1
        direct_change = np.einsum("sjf,scjf->cjf", source_densities * control_law, conjugate)
        sampled_change = (direct_change * self._alias_phases[Quantity.OUTPUT]).sum(axis=-1).T
        half_gradient[:, CONTROLLER, Quantity.OUTPUT] += sampled_change

        # The same for the synchronous steps, in the order of θ: effect, damping, lag, delay, controller.
        slopes = np.array([unit_slope, damping_slope, lag_slope, delay_slope, unit_slope])
        rate_by_steps = (
            loop.sensitivity * loop.rate_from_source[Source.REFERENCE] * steps.alias_shares
        )
        step_slopes = self._sampled_step_responses(slopes * rate_by_steps, loop.from_rate)
        step_slopes[:, CONTROLLER, Quantity.OUTPUT] += steps.response[:, Quantity.OUTPUT]
        response_conjugate = steps.response[:, None, None].conj()
        half_gradient += steps.density[..., None] * step_slopes[..., None] * response_conjugate
        return _plus_adjoint(half_gradient)

    def _step_time_gradient(
        self, parameters: LoopParameters, loop: ClosedLoopResponse, steps: SynchronousSteps
    ) -> ComplexArray:
        """Returns the derivative of the modelled density by the time at which synchronous steps come before a message.

        Steps of the reference that are synchronous with the messages come at a fixed time t before the next message.
        With the longest such time T, the surplus interval (the message interval less one controller cycle), the model
        has t = p T. Its parameter ``step_time_odds`` is p / (1 − p), and the derivative is by the logarithm θ of that:

            dp/dθ = p (1 − p),    dt/dθ = T p (1 − p)

        Sampling maps frequency f + k f_s of the steps to f, for each alias k. The amplitude of the alias is
        a_k = c_k exp(s_k t), with a constant c_k and s_k = 2πj k f_s. Its share w_k of the sampled steps changes by

            w_k = a_k / Σ_i a_i,    dw_k/dθ = w_k (s_k − Σ_i w_i s_i) dt/dθ

        The response q of the quantities to the sampled steps is linear in the shares. With the density S of the steps,
        they contribute S q qᴴ to the modelled density, which changes by S (dq qᴴ + q dqᴴ).

        Args:
            parameters: the parameters of the loop.
            loop: its frequency responses, of which the responses to the reference are used.
            steps: the synchronous steps at these parameters.

        Returns:
            Derivative (J, C, C) of the cross-spectral density of C quantities at J frequencies.
        """
        p = _share_from_odds(parameters.step_time_odds)
        step_time_slope = self.surplus_interval * p * (1 - p)
        # Derivatives of ln a_k (F,), and their mean over the aliases weighted by the shares (J, 1).
        log_amplitude_slopes = self._alias_laplace_variables * step_time_slope
        mean_slope = (steps.alias_shares * log_amplitude_slopes).sum(axis=-1, keepdims=True)
        alias_share_slopes = steps.alias_shares * (log_amplitude_slopes - mean_slope)
        response_slope = self._sampled_step_response(
            alias_share_slopes, loop.from_source[Source.REFERENCE]
        )
        return _plus_adjoint(steps.density * _outer(response_slope, steps.response))


def _share_from_odds(odds: float) -> float:
    """Returns the share p, 0 to 1, whose odds are p / (1 − p)."""
    return odds / (1 + odds)


def _source_densities(components: list[DensityComponent]) -> Array:
    """Returns the density of each source, the sum of its components.

    Args:
        components: components of all sources, each with a density (J, F).

    Returns:
        (S, J, F) densities.
    """
    densities = np.zeros((len(Source), *components[0].density.shape))
    for component in components:
        densities[component.source] += component.density
    return densities


def _outer(left: ComplexArray, right: ComplexArray) -> ComplexArray:
    """Returns the outer products left · rightᴴ (J, C, C) of vectors (J, C)."""
    return left[:, :, None] * right[:, None].conj()


def _plus_adjoint(matrices: ComplexArray) -> ComplexArray:
    """Returns matrices (…, C, C) plus their conjugate transposes."""
    return matrices + matrices.mT.conj()
