"""Identification of the plant of one axis in its closed loop, by maximising its posterior from several starts.

Each ascent is Fisher scoring with Levenberg-Marquardt damping. The posterior may have several modes, above all in the
time of synchronous steps; the result is their mixture, each weighted by Laplace's approximation of its evidence.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import scipy

from mavdem.arrays import Array
from mavdem.confidence import SIGNIFICANT_SIGMAS
from mavdem.dem.engine.gauss_newton import (
    MAX_STEPS,
    Damping,
    QuadraticExpansion,
    gauss_newton,
)
from mavdem.dem.engine.linalg import inverse
from mavdem.plant.closed_loop.likelihood import AxisPosterior
from mavdem.plant.closed_loop.parameters import (
    CONTROLLER,
    DELAY,
    EFFECT,
    LAG,
    PLANT,
    PRIOR_SD,
    STEP_TIME,
)


class InitialPlant(NamedTuple):
    """A plant from which an ascent begins."""

    crossover: float
    """Frequency at which the rate loop's gain is 1, Hz, which gives the effect."""

    lag: float
    """Motor time constant, s."""

    delay: float
    """Dead time, s."""


INITIAL_PLANTS = (
    InitialPlant(crossover=1.0, lag=0.05, delay=0.009),
    InitialPlant(crossover=3.0, lag=0.05, delay=0.009),
    InitialPlant(crossover=10.0, lag=0.02, delay=0.005),
)
"""Plants to begin with, typical of slow yaw, of large vehicles, and of small ones."""

INITIAL_STEPS = 8
"""Steps of each ascent before the best of them are chosen."""

CONTINUED_ASCENTS = 2
"""Number of ascents, those with the highest posterior, that continue to convergence."""

LOG_STEP_TIME_ODDS = (-4.0, 0.0, 4.0)
"""Logarithms of ``step_time_odds`` from which each of these ascents continues, if messages do not come every cycle.

The posterior may have a mode with another plant near each of them. With one ascent only, one flight in five of those at
50 Hz in half of ``tools/validation/loops.py`` ended 3 nats below the highest mode.
"""

BETWEEN_LOG_STEP_TIME_ODDS = (-1.5, 1.5)
"""Further values of that logarithm, between the others, from which the best of all these plants is tried again.

A small vehicle at 50 Hz, steered by doublets, has modes at odds of 1.3, 2.3 and 5.0. The ascent from 4 ended far away,
so that the effect of the mode at 1.3 was reported: too large by 59 %.
"""

LIKELIHOOD_VARIANCE_FACTOR = 0.6
"""Factor on the variance that the likelihood's information contributes.

The likelihood counts few values as independent, which keeps slow logs to the prior. The scatter of estimates from
flight to flight is smaller. Chosen on half of the flights of ``tools/validation/loops.py``.
"""

SAME_MODE_NATS = 4.0
"""An ascent ends when it comes to within so many nats of a mode that is already known, by that mode's curvature."""

MIN_STEERED_COHERENCE = 0.6
"""Least coherence of the rate with the reference at which setpoints identify the loop.

It is the usual limit of frequency responses that are identified in flight (M. B. Tischler and R. K. Remple, Aircraft
and Rotorcraft System Identification, 2nd ed., sec. 7.5).
"""

STEERED_BANDS = 5
"""Number of neighbouring bands of which the median coherence counts, a fifth of their frequency wide: a choice."""

MAX_PARAMETER_STEP = 1.5
"""Largest change of any entry of θ in one step: a choice. It is smaller for entries with a narrower prior."""

INITIAL_DAMPING = 1e-2
"""Levenberg-Marquardt damping of the first step, relative to the curvature's diagonal: a choice."""

DAMPING_FACTOR = 5.0
"""Factor by which the damping changes after a step that fails or succeeds: a choice."""

MAX_DAMPING_ATTEMPTS = 16
"""Times that a step is damped more before the ascent gives up: a choice."""


class IdentifiedAxis(NamedTuple):
    """Posterior of the parameters of one axis, as a normal approximation of all its modes."""

    posterior: AxisPosterior
    """The log posterior that was maximised."""

    theta: Array
    """Posterior mean of θ (k,), in the order of ``parameters.PARAMETER_NAMES``."""

    covariance: Array
    """Posterior covariance of θ (k, k)."""

    main_mode: Array
    """θ (k,) at the mode with the largest evidence."""

    @property
    def saturation_loss(self) -> float:
        """Fraction of the commanded output that the motors' limits cut off, as the controller's estimated gain shows.

        Output that is cut off at a limit acts like a lower gain of the controller. So the fraction is 1 minus the ratio
        of the estimated gain to the gain by the logged parameters. It is clipped to the range from 0 to the fraction of
        the time with a motor at its limit.
        """
        # The parameter is the logarithm of that ratio.
        gain_loss = 1 - np.exp(self.theta[CONTROLLER])
        return float(np.clip(gain_loss, 0.0, self.posterior.saturated_share))

    @property
    def controller_consistent(self) -> bool:
        """Whether the controller acts as its logged parameters state; if it does not, the model of it is wrong.

        The entry ``CONTROLLER`` of θ is the logarithm of its estimated gain, relative to that by the logged parameters.
        It should be 0. Saturation may lower it: output that is cut off at a motor's limit acts like a gain that is
        lower, at most by the share of the time with a motor at its limit. In addition, it may deviate to both sides by
        ``SIGNIFICANT_SIGMAS`` prior standard deviations. Both the posterior's mean and its main mode must be in this
        range.
        """
        tolerance = SIGNIFICANT_SIGMAS * PRIOR_SD[CONTROLLER]
        lowest = np.log1p(-self.posterior.saturated_share) - tolerance
        for theta in (self.theta, self.main_mode):
            log_gain = theta[CONTROLLER]
            is_in_range = log_gain >= lowest and log_gain <= tolerance
            if not is_in_range:
                return False
        return True

    @property
    def reference_share(self) -> float:
        """Fraction of the body rate's variance that the reference (the setpoint of the loop) causes, 0 to 1.

        It is computed with two estimates of the loop's parameters, their posterior mean and the main mode of the
        posterior, and the lower fraction counts.
        """
        return min(
            self.posterior.reference_share(self.theta),
            self.posterior.reference_share(self.main_mode),
        )

    @property
    def steered_frequency(self) -> float:
        """Highest frequency at which setpoints cause most of the rate's motion, Hz; 0 if there is none.

        There the coherence of the rate with the reference is at least ``MIN_STEERED_COHERENCE``, in the median of
        ``STEERED_BANDS`` neighbouring bands, since the coherence of a single one scatters. Above that frequency only
        wind and noise show the loop.
        """
        coherence = self.posterior.reference_coherence(self.main_mode)
        is_steered = scipy.ndimage.median_filter(coherence, STEERED_BANDS) >= MIN_STEERED_COHERENCE
        return float(self.posterior.spectra.frequency[is_steered].max(initial=0.0))

    @property
    def crossover(self) -> float:
        """Highest frequency of the spectra at which the gain of the rate loop is at least 1, Hz; 0 if there is none."""
        frequency = self.posterior.spectra.frequency
        rate_response = self.posterior.densities.rate_loop_response(self.theta)
        return float(frequency[np.abs(rate_response) >= 1].max(initial=0.0))


def identify_axis(posterior: AxisPosterior) -> IdentifiedAxis:
    """Identifies the parameters of one axis by the modes of its posterior.

    The posterior may have several modes, so that it is maximised from several starts, by ascents:

    1. A short ascent begins from each of several typical plants. The ``CONTINUED_ASCENTS`` best ones are used further.
    2. The setpoint changes in steps at some time between two logged messages. That time is a parameter,
       ``step_time_odds``, and there may be a mode near each of several values. From each plant, an ascent to
       convergence begins at each of these values.
    3. From the best plant of these, further ascents begin at values in between.

    An ascent ends early if it comes close to a known mode.

    Args:
        posterior: the log posterior of the axis.

    Returns:
        Mean and covariance of the parameters over all modes, and the main mode.

    Raises:
        numpy.linalg.LinAlgError: no ascent ends at a finite posterior.
    """
    first_ascents = []
    for initial in INITIAL_PLANTS:
        start = _initial_parameters(posterior, initial)
        first_ascents.append(_ascend(posterior, start, INITIAL_STEPS))
    # The best come last.
    first_ascents.sort(key=lambda ascent: ascent.value)

    # If every cycle of the controller is logged, no step is between messages: the time has no effect, and one value
    # will do.
    has_unlogged_cycles = posterior.densities.surplus_interval > 0
    log_odds = LOG_STEP_TIME_ODDS if has_unlogged_cycles else (0.0,)
    ascents = list[QuadraticExpansion]()
    for first_ascent in first_ascents[-CONTINUED_ASCENTS:]:
        for log_step_time_odds in log_odds:
            start = _with_step_time(first_ascent.point, log_step_time_odds)
            ascents.append(_ascend(posterior, start, MAX_STEPS, ascents))
    if has_unlogged_cycles:
        # The best plant so far is nearer to the plants of other modes than the typical plants at the start were.
        best_ascent = max(ascents, key=lambda ascent: ascent.value)
        for log_step_time_odds in BETWEEN_LOG_STEP_TIME_ODDS:
            start = _with_step_time(best_ascent.point, log_step_time_odds)
            ascents.append(_ascend(posterior, start, MAX_STEPS, ascents))
    return _mixture_of_modes(posterior, ascents)


def _with_step_time(theta: Array, log_step_time_odds: float) -> Array:
    """Returns the end of an ascent as start of another one, with another time of setpoint steps between two messages.

    The ascent may have ended with motor lag and damping exchanged, which has the same response: that is undone.

    Args:
        theta: θ (k,) at the end of the ascent.
        log_step_time_odds: natural logarithm of ``LoopParameters.step_time_odds``.

    Returns:
        θ (k,) of the start.
    """
    start = with_quicker_pole_as_lag(theta)
    start[STEP_TIME] = log_step_time_odds
    return start


def _initial_parameters(posterior: AxisPosterior, initial: InitialPlant) -> Array:
    """Returns parameters from which an ascent of the posterior can begin.

    Effect, lag and delay are taken from an initial plant, all others have their prior mean. The effect follows from the
    crossover: there the loop gain is 1. With the plant as an integrator, b / jω, and the controller's gain |C_y|, this
    is b |C_y| / ω = 1.

    Args:
        posterior: the log posterior, with the controller.
        initial: crossover, Hz, lag, s, and delay, s, of the plant.

    Returns:
        θ (k,), logarithms of the parameters.
    """
    crossover = np.array([initial.crossover])
    _, demand_per_rate = posterior.controller.transfer(crossover)
    (controller_gain,) = np.abs(demand_per_rate)
    theta = posterior.prior_mean.copy()
    effect = 2 * np.pi * initial.crossover / controller_gain
    theta[[EFFECT, LAG, DELAY]] = np.log([effect, initial.lag, initial.delay])
    return theta


def _mixture_of_modes(
    posterior: AxisPosterior, ascents: Sequence[QuadraticExpansion]
) -> IdentifiedAxis:
    """Combines the modes that ascents have found to one normal approximation of the posterior.

    Ascents that end at different step times found different modes. The posterior is approximated by a mixture of normal
    distributions, one about each mode, weighted by its evidence (Laplace's approximation). The result has the mean and
    covariance of this mixture.

    Args:
        posterior: log posterior of the loop's parameters, with gradient and Fisher information.
        ascents: expansion of the posterior to second order about the end of each ascent.

    Returns:
        Mean and covariance of the mixture, and the mode with the largest weight.

    Raises:
        numpy.linalg.LinAlgError: no ascent has a finite value.
    """
    finite_ascents = [ascent for ascent in ascents if np.isfinite(ascent.value)]
    if not finite_ascents:
        raise np.linalg.LinAlgError("no ascent has a finite value")
    # Ascents that end at the same rounded step time found the same mode, of which the highest is kept: it comes last.
    mode_by_step_time = dict[int, QuadraticExpansion]()
    for ascent in sorted(finite_ascents, key=lambda ascent: ascent.value):
        mode_by_step_time[round(ascent.point[STEP_TIME])] = ascent
    modes = list(mode_by_step_time.values())

    # By Laplace's approximation the log evidence of a mode is its log posterior, less half the log determinant of the
    # curvature, up to a constant.
    log_evidences = []
    for mode in modes:
        _, log_determinant = np.linalg.slogdet(mode.curvature)
        log_evidences.append(mode.value - log_determinant / 2)
    weights = scipy.special.softmax(log_evidences)
    mode_points = np.array([mode.point for mode in modes])
    mean = weights @ mode_points
    # The law of total variance adds the mean covariance within the modes and the covariance of their means.
    covariance_within = sum(
        weight * _sandwich_covariance(posterior, mode)
        for weight, mode in zip(weights, modes, strict=True)
    )
    deviations = mode_points - mean
    covariance_between = deviations.T * weights @ deviations
    main_mode = mode_points[np.argmax(weights)]
    return IdentifiedAxis(posterior, mean, covariance_within + covariance_between, main_mode)


def _sandwich_covariance(posterior: AxisPosterior, mode: QuadraticExpansion) -> Array:
    """Returns the sandwich covariance of θ at a mode, H⁻¹ V H⁻¹ (H. White, Econometrica 50(1), 1982).

    H is the curvature, and V the variance of the gradient. If the likelihood were exact, V would be H, and the
    covariance H⁻¹. It differs in two ways. Estimates scatter less than the likelihood's information predicts, so that
    its share of V is multiplied by :data:`LIKELIHOOD_VARIANCE_FACTOR`. And wind and noise have another spectrum than
    the modelled one, which adds its own variance (:meth:`AxisPosterior.disturbance_gradient_variance`).

    Args:
        posterior: log posterior of the loop's parameters, with gradient and Fisher information.
        mode: the mode θ (k,), with the negative second derivative of the log posterior there (k, k): information of the
            likelihood and precision of the prior.

    Returns:
        The sandwich covariance (k, k).
    """
    inverse_curvature = inverse(mode.curvature)
    prior_precision = np.diag(posterior.prior_sd**-2.0)
    # Without disturbances, V is c (H − P) + P, here sorted by H and P: the factor c multiplies the likelihood's
    # information H − P only.
    gradient_variance = (
        LIKELIHOOD_VARIANCE_FACTOR * mode.curvature
        + (1 - LIKELIHOOD_VARIANCE_FACTOR) * prior_precision
        + posterior.disturbance_gradient_variance(mode.point)
    )
    return inverse_curvature @ gradient_variance @ inverse_curvature


def with_quicker_pole_as_lag(theta: Array) -> Array:
    """Exchanges motor lag and damping if the lag is the slower one of the two, without changing the frequency response.

    The plant b / ((τ s + 1)(s + d)) has the poles 1/τ of the motors and d of the damping. It is the same function of s
    if the poles change places and b becomes b / (τ d), so that an identification may end with either. Motors respond
    faster than damping slows the rotation of a vehicle in air: 1/τ must be the larger pole.

    ``tests/plant/test_closed_loop.py`` checks that it is the same function of s.

    Args:
        theta: θ (k,), logarithms of the parameters.

    Returns:
        A copy of θ (k,) in which 1/τ is the larger pole; with the same values if it is already.
    """
    effect, damping, lag, _ = PLANT
    # ln(τ d) is positive if the poles must be exchanged. The new values are d' = 1/τ = d / (τ d), τ' = 1/d = τ /
    # (τ d) and b' = b / (τ d): ln(τ d) is subtracted from each logarithm.
    log_pole_ratio = max(theta[damping] + theta[lag], 0.0)
    exchanged_theta = theta.copy()
    exchanged_theta[[damping, lag]] -= log_pole_ratio
    exchanged_theta[effect] -= log_pole_ratio
    return exchanged_theta


def _nats_below(mode: QuadraticExpansion, theta: Array) -> float:
    """Returns how much lower the log posterior is at θ (k,) than at a mode, nats, by its quadratic expansion there."""
    difference = theta - mode.point
    return float(difference @ mode.curvature @ difference) / 2


def _ascend(
    posterior: AxisPosterior,
    start: Array,
    max_steps: int,
    known_modes: Sequence[QuadraticExpansion] = (),
) -> QuadraticExpansion:
    """Maximises the posterior by damped Fisher scoring from one start.

    Args:
        posterior: log posterior of the loop's parameters, with gradient and Fisher information.
        start: parameters θ (k,) to begin with.
        max_steps: largest number of steps of Fisher scoring.
        known_modes: modes of earlier ascents, near which this one ends early.

    Returns:
        The expansion of the posterior to second order about the last iterate.
    """

    def is_near_known_mode(iterate: QuadraticExpansion) -> bool:
        """Returns whether an iterate is so near to a known mode that it would only converge to it."""
        return any(_nats_below(mode, iterate.point) < SAME_MODE_NATS for mode in known_modes)

    damping = Damping(
        initial=INITIAL_DAMPING,
        factor=DAMPING_FACTOR,
        max_attempts=MAX_DAMPING_ATTEMPTS,
        limit_step=_limited_step,
    )
    maximisation = gauss_newton(
        posterior, posterior.expand(start), damping, max_steps, is_near_known_mode
    )
    return maximisation.expansions[-1]


def _limited_step(step: Array) -> Array:
    """Shortens a step of the parameters θ, in its direction, so that no entry changes by more than its limit.

    The limit is the prior standard deviation of the entry, at most ``MAX_PARAMETER_STEP``: beyond it, the posterior may
    differ much from its quadratic expansion.

    Args:
        step: (k,) change of the parameters θ.

    Returns:
        The step (k,), as long as it was or shorter.
    """
    max_change = np.minimum(PRIOR_SD, MAX_PARAMETER_STEP)
    return step / max(1.0, np.abs(step / max_change).max())
