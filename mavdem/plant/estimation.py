"""Estimation of an axis' motor effectiveness, damping, motor lag and delay from a whole flight (gray-box model).

Effect, damping, lag and delay are the same in all windows; trim, and the level of wind torque and noise, are each
window's own. Method and limits: docs/physical.md.
"""

from math import hypot
from typing import NamedTuple

import numpy as np
from numpy.linalg import LinAlgError

from mavdem.arrays import Array, Flags
from mavdem.confidence import SIGNIFICANT_SIGMAS, STRONG_EVIDENCE_NATS
from mavdem.dem.engine.linalg import ROUNDING_TOLERANCE, inverse, one_thread
from mavdem.dem.forecast.joint import axis_mixer
from mavdem.dem.record import MIN_MOTORS, Record, TrainingData
from mavdem.errors import NotLearnable
from mavdem.facts import Fact
from mavdem.facts.identifiability import Status
from mavdem.facts.model import NoPhysical, Refinement
from mavdem.immutable import freeze
from mavdem.plant.closed_loop.spectra import ComplexArray
from mavdem.plant.fitting import (
    WIND_SPECTRA,
    GrayBoxFit,
    best_start,
    fit_gray_box,
    initial_model,
)
from mavdem.plant.identifiability import (
    PARAMETERS,
    QUICK_FREQUENCY,
    IdentifiabilityMeasures,
    NotIdentifiable,
    OmissionErrors,
    identifiability,
)
from mavdem.plant.likelihood import DELAY_PRIOR, GrayBoxModel
from mavdem.plant.parameters import (
    DAMPING,
    DELAY,
    EFFECTS,
    LAG,
    Physical,
    combined_with_earlier_flight,
    parameter_gradient,
)
from mavdem.plant.sampled_plant import WindComponent
from mavdem.plant.windows import (
    REFINEMENT_CHANNEL,
    REFINEMENTS,
    FlightWindows,
    cut_windows,
)
from mavdem.unit_errors import suspected_unit_error

MAX_SELECTION_WINDOWS = 10
"""Number of windows, spread over the flight, by which the wind torque's spectrum and the refinements are chosen."""

MOTION_BAND_HZ = (0.4, 6.0)
"""Band of the rotation of a multirotor about roll, Hz: from its attitude control to its rate control."""


class _SelectedModel(NamedTuple):
    """The model that is most probable on some of the windows, and how much the spectrum matters."""

    fit: GrayBoxFit
    """Fit of the model with the largest evidence."""

    spectrum_range: Array
    """Range of the logarithms of mean effect, damping and lag over the spectra of the wind torque (3,)."""


def physical(train: TrainingData, prior: Physical | None = None) -> Physical | NotIdentifiable:
    """Estimates control effectiveness, damping, motor time constant and delay of one axis.

    >>> str(mavdem.plant.physical(mavdem.read_flight("flight.tlog")[:2000]).status["effect"])
    'biased'

    Args:
        train: a ``Flight``, or segments of one. Its rate, in rad/s, is the output that is the derivative of another, or
            the only output.
        prior: physical parameters by an earlier flight of the vehicle. A parameter that this flight does not identify
            is then taken from the earlier flight, with a variance for changes between flights. A prior of other inputs,
            or one that the flight contradicts, is ignored.

    Returns:
        The parameters, each with its status; or the reason why there are none: wrong units, no output is the rate of
        another, too few samples, no motor moves, or no likelihood.
    """
    record = Record.from_flights(train)
    unit_error = suspected_unit_error(record.outputs, record.dt)
    if unit_error:
        return NotIdentifiable(unit_error)
    try:
        # Matrices as small as these are fastest with one thread. Overflow needs no warning, since the fit rejects steps
        # to values that are not finite.
        with one_thread(), np.errstate(all="ignore"):
            windows = cut_windows(record)
            return _estimate_parameters(windows, _mixer_directions(record), prior)
    except NotLearnable as error:
        return NotIdentifiable(error.fact)
    except ValueError:
        # NumPy's LinAlgError, a ValueError: the likelihood is not finite, or its curvature is singular.
        return NotIdentifiable(Fact(NoPhysical.NO_LIKELIHOOD))


def _mixer_directions(record: Record) -> Array | None:
    """Returns the relative strength with which each motor turns the vehicle about the axis.

    The record has it if the vehicle's mixer is known. Otherwise the mixer is estimated by the joint model of motors and
    motion (:func:`axis_mixer`). That estimate is only used if it is the pattern of an X or plus frame, in which each
    motor has either no effect or one of the common magnitude: such a pattern does not arise by chance.

    Args:
        record: inputs and outputs of the flight.

    Returns:
        Relative effects (r,) of the r inputs, with sign; None if the mixer is neither known nor recognised.
    """
    if record.effect_directions is not None or record.inputs.shape[1] < MIN_MOTORS:
        return record.effect_directions
    directions = axis_mixer(record)[:, 0]
    magnitudes = abs(directions[directions != 0])
    if np.ptp(magnitudes) < ROUNDING_TOLERANCE:
        return directions
    return None


def _estimate_parameters(
    windows: FlightWindows, directions: Array | None, prior: Physical | None
) -> Physical:
    """Estimates the physical parameters from windows of a flight.

    The form of the model is chosen on at most ``MAX_SELECTION_WINDOWS`` of them, to save time. The chosen model is then
    fitted to all windows, and the result combined with the parameters of an earlier flight.

    Args:
        windows: Fourier transforms of inputs and body rate in windows of the flight.
        directions: relative effect of each input (r,), or ``None``.
        prior: physical parameters by an earlier flight, or ``None``.

    Returns:
        The parameters, each with its status: reported, biased or not identifiable.

    Raises:
        ValueError: no model has a finite likelihood.
    """
    selected_model = _select_model(windows, directions)
    fit = selected_model.fit
    if len(windows.rate) > MAX_SELECTION_WINDOWS:
        fit = fit_gray_box(fit.model, windows, fit.theta)
    plant = _physical_parameters(fit, selected_model.spectrum_range, windows)
    if prior is None:
        return plant
    return combined_with_earlier_flight(plant, prior)


def _select_model(windows: FlightWindows, directions: Array | None) -> _SelectedModel:
    """Selects the form of the gray-box model with the largest evidence, on some of the windows.

    The form is the spectrum of the wind torque, one of ``WIND_SPECTRA``, and any of the ``REFINEMENTS``.
    Refinements are tried one after the other. One is kept if its parameter has a possible value and the evidence
    increases. To save time, one is fitted only if the slope of the posterior predicts a gain of at least
    ``STRONG_EVIDENCE_NATS``.

    Args:
        windows: all windows of the flight; at most ``MAX_SELECTION_WINDOWS`` of them, evenly spread, are used.
        directions: relative effect of each input (r,), or ``None`` if it is not known.

    Returns:
        The best fit, and the range of the logarithms of mean effect, damping and lag between the spectra, as a measure
        of the error by a wrong spectrum.

    Raises:
        ValueError: no spectrum has a finite likelihood.
    """
    count = len(windows.rate)
    selection = np.linspace(0, count - 1, min(count, MAX_SELECTION_WINDOWS)).round().astype(int)
    selected_windows = windows.select(selection)
    model, prior_start = initial_model(selected_windows, directions)
    start_theta = best_start(model, prior_start, selected_windows)
    fits = _fits_of_spectra(model, start_theta, selected_windows)
    logarithms = [_log_estimates(_plant_values(fit.model, fit.theta, windows.dt)) for fit in fits]
    best_fit = max(fits, key=lambda fit: fit.evidence)
    return _SelectedModel(
        fit=_refined_fit(best_fit, selected_windows),
        spectrum_range=np.ptp(logarithms, axis=0),
    )


def _fits_of_spectra(
    model: GrayBoxModel, start_theta: Array, windows: FlightWindows
) -> list[GrayBoxFit]:
    """Fits the gray-box model with each of ``WIND_SPECTRA`` as the spectrum of the wind torque.

    Each fit begins with the result of the last one.

    Args:
        model: form of the model, of which only the spectrum is replaced.
        start_theta: parameters θ with which the first fit begins.
        windows: Fourier transforms of inputs and body rate in the windows to fit.

    Returns:
        The fits, without those of spectra for which the likelihood is not finite.
    """
    fits = []
    for wind in WIND_SPECTRA:
        candidate = model._replace(wind=wind)
        # Noise is the last entry of θ, after the wind torque. So the entries of a component that this spectrum adds
        # come just before it, and begin at the prior.
        initial_theta, _ = candidate.prior
        initial_theta[: len(start_theta) - 1] = start_theta[:-1]
        initial_theta[-1] = start_theta[-1]
        try:
            fit = fit_gray_box(candidate, windows, initial_theta)
        except LinAlgError:
            continue
        fits.append(fit)
        start_theta = fit.theta
    return fits


def _refined_fit(fit: GrayBoxFit, windows: FlightWindows) -> GrayBoxFit:
    """Adds to a fit those of the ``REFINEMENTS`` that increase the evidence, each with one more parameter.

    Args:
        fit: fit of the model without refinements.
        windows: the fitted windows.

    Returns:
        The fit with the refinements that are kept (:func:`_select_model`); the same fit if none is.
    """
    best_fit = fit
    for name in REFINEMENTS:
        candidate = best_fit.model._replace(refinements=(*best_fit.model.refinements, name))
        # The parameter of the refinement is the last one, and has no effect at 0.
        initial_theta = np.append(best_fit.theta, 0.0)
        try:
            candidate_fit = fit_gray_box(candidate, windows, initial_theta, STRONG_EVIDENCE_NATS)
        except LinAlgError:
            continue
        if _is_possible(candidate_fit) and candidate_fit.evidence > best_fit.evidence:
            best_fit = candidate_fit
    return best_fit


def _is_possible(fit: GrayBoxFit) -> bool:
    """Returns whether the refinements of a fit are possible: no jump comes late; the fit bounds how early one comes."""
    return fit.refinements.get(Refinement.JUMPS, 0.0) >= 0


def _plant_values(model: GrayBoxModel, theta: Array, dt: float) -> Array:
    """Converts the parameters of the fit, which are mostly logarithms, to physical parameters.

    Args:
        model: the gray-box model, with the indices of the entries of θ.
        theta: parameters θ of the fit (k,).
        dt: time step of the samples, s, which is a lower bound of the lag.

    Returns:
        Effect of each input (rad/s² per standard deviation of the inputs), damping (1/s), lag (s) and delay (s), as one
        vector (r + 3,).
    """
    effect = model.effect(theta)
    damping = model.damping(theta)
    lag = model.lag(theta, dt)
    return np.array([*effect, damping, lag, theta[model.delay_index]])


def _log_estimates(values: Array) -> Array:
    """Returns the logarithms (3,) of mean effect, damping and lag, for effects, damping, lag and delay (r + 3,)."""
    return np.log([abs(values[EFFECTS]).mean(), values[DAMPING], values[LAG]])


def _slopes_of_log_estimates(values: Array) -> Array:
    """Returns the derivatives that convert errors of the parameters to relative errors of the three judged estimates.

    These are the mean effect, the damping and the lag, as logarithms (:func:`_log_estimates`).

    Args:
        values: effects, damping, lag and delay (r + 3,).

    Returns:
        Derivatives (3, r + 3) of the logarithms of mean effect, damping and lag by effects, damping, lag and delay.
    """
    effect = values[EFFECTS]
    # Rows of the result.
    log_mean_effect, log_damping, log_lag = range(3)
    slopes = np.zeros((3, len(values)))
    slopes[log_mean_effect, EFFECTS] = np.sign(effect) / abs(effect).sum()
    slopes[log_damping, DAMPING] = 1 / values[DAMPING]
    slopes[log_lag, LAG] = 1 / values[LAG]
    return slopes


def _physical_parameters(
    fit: GrayBoxFit, spectrum_range: Array, windows: FlightWindows
) -> Physical:
    """Returns the physical parameters of a fit, in units of the flight, with their uncertainty and identifiability.

    Args:
        fit: the fit of the gray-box model to all windows.
        spectrum_range: range of the logarithms of mean effect, damping and lag over the assumed spectra (3,).
        windows: Fourier transforms of inputs and body rate in windows of the flight.

    Returns:
        The parameters, with read-only arrays.
    """
    model = fit.model
    theta = fit.theta
    r = model.motors

    def values_at(theta: Array) -> Array:
        """Returns effects, damping, lag and delay (r + 3,) at θ."""
        return _plant_values(model, theta, windows.dt)

    values = values_at(theta)
    effect = values[:r]
    damping, lag, delay = values[r:].tolist()
    jacobian = parameter_gradient(values_at, theta, values).T
    covariance = jacobian @ inverse(fit.curvature) @ jacobian.T

    logarithm_slopes = _slopes_of_log_estimates(values)
    likelihood_sd = np.sqrt(np.diag(logarithm_slopes @ covariance @ logarithm_slopes.T))
    measures = _identifiability_measures(fit, windows, likelihood_sd, spectrum_range, damping)
    status, reasons = identifiability(measures)
    bias = 0.0
    if status["effect"] == Status.BIASED:
        bias = OmissionErrors.wind_bias
        if measures.lag_unresolved:
            bias = OmissionErrors.lag_bias
    effect_unknown = status["effect"] == Status.NOT_IDENTIFIABLE
    covariance = with_omission_errors(
        covariance,
        values,
        logarithm_slopes[0, :r],
        spectrum_range,
        bias,
        effect_unknown=effect_unknown,
        measures=measures,
    )

    # So far the unit of the inputs is their common standard deviation, and the effects are converted from it. Damping,
    # lag and delay keep their units.
    scale = np.append(np.full(r, 1 / windows.unit), np.ones(3))
    level = np.sqrt(np.mean(fit.levels**2))
    sizes = level * model.wind_sizes(theta)
    estimate = Physical(
        effect=effect / windows.unit,
        damping=damping,
        lag=lag,
        delay=max(delay, 0.0),
        covariance=covariance * np.outer(scale, scale),
        status=status,
        reasons=reasons,
        bias=bias,
        wind_share=measures.wind_share,
        components=tuple(
            map(WindComponent, model.wind, sizes.tolist(), model.wind_times(theta).tolist())
        ),
        noise=level * float(model.noise(theta)),
        refinements=fit.refinements,
        windows=len(windows.rate),
    )
    return freeze(estimate)


def _identifiability_measures(
    fit: GrayBoxFit,
    windows: FlightWindows,
    likelihood_sd: Array,
    spectrum_range: Array,
    damping: float,
) -> IdentifiabilityMeasures:
    """Collects the measures of a fit that decide whether effect, damping and lag are identifiable.

    They are the standard deviations of the three, how much they change with the assumed spectrum of the wind, and
    properties of the flight that bias them: the share of wind in the torque, of commands that the samples miss, and so
    on.

    Args:
        fit: the fit of the gray-box model.
        windows: Fourier transforms of inputs and body rate in windows of the flight.
        likelihood_sd: relative standard deviations of mean effect, damping and lag (3,), by the likelihood alone. It
            takes the spectrum of the wind for exact, so that they are multiplied by a factor.
        spectrum_range: range of the logarithms of the same three estimates over several spectra of the wind that were
            assumed in turn (3,).
        damping: estimated damping, 1/s.

    Returns:
        The measures. The relative standard deviation of the damping contains the error by the curvature of the thrust
        curve.
    """
    corrected_sd = OmissionErrors.likelihood_factor * likelihood_sd
    relative_sd = dict(zip(PARAMETERS, corrected_sd.tolist(), strict=True))
    # θ begins with the common effect of all motors; each motor's deviation from it follows.
    deviations = fit.theta[1 : fit.model.motors + 1]
    powers = _torque_powers(fit, windows)
    measures = IdentifiabilityMeasures(
        wind_share=powers.wind_share,
        alias_share=_alias_share(fit, windows),
        sd=relative_sd,
        spectrum_range=dict(zip(PARAMETERS, spectrum_range.tolist(), strict=True)),
        lag=np.exp(fit.theta[fit.model.lag_index]),
        dt=windows.dt,
        unpredicted_share=windows.unpredicted_share,
        quick_share=powers.quick_share,
        slow_wind_share=powers.slow_wind_share,
        thrust_curve=fit.refinements.get(Refinement.THRUST_CURVE, 0.0),
        motor_deviation=float(abs(deviations).max()),
        motor_deviation_sd=fit.model.deviation_sd,
    )
    damping_sd = hypot(relative_sd["damping"], measures.thrust_curve_damping_error / damping)
    return measures._replace(sd=relative_sd | {"damping": damping_sd})


def with_omission_errors(
    covariance: Array,
    values: Array,
    mean_effect_weights: Array,
    spectrum_range: Array,
    bias: float,
    *,
    effect_unknown: bool,
    measures: IdentifiabilityMeasures,
) -> Array:
    """Adds to a covariance the errors by what the model leaves out (``OmissionErrors``).

    Args:
        covariance: covariance of effects, damping, lag and delay (r + 3, r + 3) that follows from the likelihood.
        values: effects, damping, lag and delay (r + 3,).
        mean_effect_weights: relative change of the mean effect by each effect (r,).
        spectrum_range: range of the logarithms of mean effect, damping and lag over the assumed spectra (3,).
        bias: probable relative bias of the effect.
        effect_unknown: whether the effect is not identifiable.
        measures: measures of the fit's identifiability.

    Returns:
        The covariance with these errors (r + 3, r + 3).
    """
    errors = OmissionErrors
    r = len(values) - 3
    effect = values[:r]
    damping, lag, _ = values[r:].tolist()

    # The error is larger than that by the likelihood. The factor applies to the error that all motors have in common,
    # since it is due to the spectrum of the wind torque. The differences between the motors' errors are not changed.
    common_part = np.eye(r + 3)
    common_part[:r, :r] = np.outer(effect, mean_effect_weights)
    covariance = covariance + (
        (errors.likelihood_factor**2 - 1) * common_part @ covariance @ common_part.T
    )

    # The plant is fitted with three assumed spectra of the wind. The standard deviation of the error by a wrong
    # spectrum follows from the range of the three results: the expected range of three normal values is 3/√π standard
    # deviations (L. H. C. Tippett, Biometrika 17, 1925).
    effect_variance, damping_spectrum_variance, lag_spectrum_variance = (
        np.pi * np.square(spectrum_range / 3)
    ).tolist()
    # Relative variance of the error that the effects of all motors have in common.
    common_variance = effect_variance + errors.effect**2 + bias**2
    common_variance += (errors.unpredicted_effect * measures.unpredicted_share) ** 2
    common_variance += (errors.thrust_curve * measures.thrust_curve) ** 2
    if effect_unknown:
        common_variance += errors.unidentified_effect**2
    covariance[:r, :r] += np.outer(effect, effect) * common_variance

    damping_error = errors.damping
    if measures.lag_unresolved:
        damping_error = errors.unresolved_lag_damping
    damping_variance = damping_spectrum_variance * damping**2 + damping_error**2
    damping_variance += measures.thrust_curve_damping_error**2
    lag_variance = lag_spectrum_variance + errors.lag**2
    lag_variance += (errors.unpredicted_lag * measures.unpredicted_share) ** 2
    lag_variance *= lag**2
    separate_variances = [
        *(effect * errors.motor) ** 2,
        damping_variance,
        lag_variance,
        errors.delay**2,
    ]
    covariance = covariance + np.diag(separate_variances)
    # A lag that is too long comes with a delay that is too short, but no further from its prior than is credible. The
    # flight determines their sum better than either: the covariance leaves the variance of the sum as it is.
    exchanged_variance = min(lag_variance, (SIGNIFICANT_SIGMAS * DELAY_PRIOR.sd) ** 2)
    covariance[DELAY, DELAY] += exchanged_variance
    covariance[LAG, DELAY] -= exchanged_variance / 2
    covariance[DELAY, LAG] -= exchanged_variance / 2
    return covariance


class _TorquePowers(NamedTuple):
    """Mean power of the torques that caused a rate, by frequency, up to a factor that is the same for all."""

    frequency: Array
    """The F frequencies, Hz (F,)."""
    wind: Array
    """Power of all torque that the motors did not cause, measurement noise included (F,)."""
    motors: Array
    """Power of the motors' torque (F,)."""

    @property
    def wind_share(self) -> float:
        """Variance of the wind torque over the sum of the variances of wind torque and motors' torque, 0 to 1.

        The inputs are correlated with the wind torque, because the autopilot counters it. So the larger this share, the
        more a wrong model of the wind biases the effect of the motors.
        """
        is_in_band = self._is_in_band
        wind_power = self.wind[is_in_band].sum()
        return float(wind_power / (wind_power + self.motors[is_in_band].sum()))

    @property
    def slow_wind_share(self) -> float:
        """An upper bound of :attr:`wind_share`: as if the wind were in the band nowhere weaker than it is below it.

        At frequencies of the band at which the fitted power of the wind is less than its mean power below the band, it
        is replaced by that mean. The total power, by which the sum is divided, stays as it was fitted, so that the
        value may exceed 1.
        """
        is_in_band = self._is_in_band
        wind_power = self.wind[is_in_band]
        total_power = wind_power.sum() + self.motors[is_in_band].sum()
        lowest_frequency_of_band = MOTION_BAND_HZ[0]
        is_below_band = self.frequency < lowest_frequency_of_band
        if is_below_band.any():
            mean_power_below_band = self.wind[is_below_band].mean()
            wind_power = np.maximum(wind_power, mean_power_below_band)
        return float(wind_power.sum() / total_power)

    @property
    def quick_share(self) -> float:
        """Share of the motors' torque in the band that is above ``QUICK_FREQUENCY``, 0 to 1."""
        is_in_band = self._is_in_band
        is_quick = is_in_band & (self.frequency > QUICK_FREQUENCY)
        return float(self.motors[is_quick].sum() / self.motors[is_in_band].sum())

    @property
    def _is_in_band(self) -> Flags:
        """Flags of the frequencies in ``MOTION_BAND_HZ`` (F,)."""
        low, high = MOTION_BAND_HZ
        return (low <= self.frequency) & (self.frequency <= high)


def _torque_powers(fit: GrayBoxFit, windows: FlightWindows) -> _TorquePowers:
    """Returns the powers of the torques that moved the vehicle, by the fitted model.

    The rate that the motors cause follows from the inputs by the model; the rest counts as caused by wind. Both are
    converted to torque per inertia, which is |jω + damping| times the rate. Each window is weighted by the inverse
    square of its level, as in the fit.

    Args:
        fit: the fit of the gray-box model.
        windows: the windows that were fitted.
    """
    # Tapering in the frequency domain (``_hann_tapered``) combines neighbouring frequencies, so that the first and the
    # last one are left out.
    omega = windows.omega[1:-1]
    torque_per_rate = np.hypot(omega, fit.model.damping(fit.theta))

    def power(rate: ComplexArray) -> Array:
        """Returns the mean power (F,) of the torque that causes a rate, whose transform has W windows."""
        squared_torque = abs(torque_per_rate * _hann_tapered(rate)) ** 2
        return np.asarray(np.mean(squared_torque / fit.levels[:, None] ** 2, axis=0))

    rate_by_motors = fit.model.rate_by_motors(fit.theta[None], windows)[0]
    return _TorquePowers(
        frequency=omega / (2 * np.pi),
        wind=power(windows.rate - rate_by_motors),
        motors=power(rate_by_motors),
    )


def _alias_share(fit: GrayBoxFit, windows: FlightWindows) -> float:
    """Computes which fraction of the commanded torque's variance lies above half of the Nyquist frequency.

    If it is large, the command probably also varies above the Nyquist frequency, which the samples cannot show.

    Args:
        fit: the fit, whose effects convert the r inputs to torque.
        windows: W windows of the flight, with F frequencies up to the Nyquist frequency.

    Returns:
        The fraction, 0 to 1.
    """
    # The transform of each input is the sum of its first two channels: the signal that is interpolated between samples,
    # and the signal that is held from a sample on. The other channels are additions by refinements of the model.
    inputs = windows.inputs[:REFINEMENT_CHANNEL].sum(axis=0)
    # The torque (W, F) is the sum over the r inputs (r, W, F), each times its effect.
    commanded_torque = np.tensordot(fit.model.effect(fit.theta), inputs, axes=1)
    power = abs(_hann_tapered(commanded_torque)) ** 2
    half_nyquist = power.shape[1] // 2
    return power[:, half_nyquist:].sum() / power.sum()


def _hann_tapered(transform: ComplexArray) -> ComplexArray:
    """Returns twice the transform (W, F − 2) of Hann-tapered windows, from their transform (W, F) without a taper.

    The Hann taper is (1 − cos) / 2 of the time in the window, and the cosine moves a transform by one frequency up and
    down. So tapering in time is the weighting (−½, 1, −½) over neighbouring frequencies, apart from the factor 2.
    """
    return transform[:, 1:-1] - (transform[:, :-2] + transform[:, 2:]) / 2
