"""Physical parameters of one axis (gray-box model), with their uncertainty, and their update from flight to flight."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from mavdem.arrays import Array
from mavdem.confidence import (
    CONFIDENCE_LEVEL,
    SIGNIFICANT_SIGMAS,
    EstimateWithHalfWidth,
    half_width,
)
from mavdem.dem.engine.gauss_newton import FINITE_DIFFERENCE_STEP
from mavdem.dem.engine.linalg import normal_draws
from mavdem.facts import Fact
from mavdem.facts.identifiability import Status
from mavdem.facts.model import ModelName, NoPhysical, ParameterDoubt, Refinement
from mavdem.plant.identifiability import PARAMETERS, OmissionErrors
from mavdem.plant.sampled_plant import WindComponent

EFFECTS = slice(0, -3)
"""Entries of a parameter vector (r + 3,) with the effects of the r motors; damping, lag and delay follow."""

DAMPING = -3
"""Index of the damping in a parameter vector (r + 3,)."""

LAG = -2
"""Index of the motor lag in a parameter vector (r + 3,)."""

DELAY = -1
"""Index of the delay in a parameter vector (r + 3,)."""

DYNAMICS = slice(-3, None)
"""Entries of a parameter vector (r + 3,) with damping, lag and delay, in this order."""

LAG_AND_DELAY = slice(-2, None)
"""Entries of a parameter vector (r + 3,) with lag and delay, in this order."""

ESTIMATE = 0
"""Row of the estimate in all arrays over N plants, and over what follows from them, such as their responses."""

DRAWS = slice(1, None)
"""Rows of such arrays with draws from the posterior, which follow the estimate."""

MIN_DRAWN_SHARE = 0.05
"""Least lag and delay of a posterior sample, relative to the estimate: both are positive."""


class PlantMinimum(NamedTuple):
    """Least damping, lag and delay that a vehicle can have."""

    damping: float
    """Rate damping, 1/s."""

    lag: float
    """Motor time constant, s."""

    delay: float
    """Delay of the motors' commands, s."""


PLANT_MINIMUM = PlantMinimum(damping=0.05, lag=1e-3, delay=0.0)
"""Bounds that keep loops and simulations finite: a choice, far below any multirotor's values."""


class PhysicalInterval(NamedTuple):
    """Half widths of the intervals of physical parameters; NaN where a parameter is not identifiable."""

    effect: Array
    """Half width of each motor's effect (r,), in the unit of the effect."""

    damping: float
    """Half width of the damping, 1/s."""

    lag: float
    """Half width of the lag, s."""

    delay: float
    """Half width of the delay, s."""


class Physical(NamedTuple):
    """Physical parameters of one axis: motors' effects, rate damping, motor lag and delay, with their covariance.

    Attributes:
        effect: (r,) control effectiveness of each motor: angular acceleration in steady state, rad/s² per unit of
            input.
        damping: rate damping, 1/s.
        lag: motor time constant, s.
        delay: delay of the motors' commands, s; it contains the dead time of the telemetry stream.
        covariance: (r + 3, r + 3) of effect, damping, lag and delay, by the likelihood, the range over the assumed
            spectra of the wind torque, and nonlinear effects.
        status: status of "effect", "damping" and "lag", by name.
        reasons: reason why each of these is biased, not identifiable or known from elsewhere; otherwise ``None``.
        bias: likely relative error of the effect, negative if the estimate is too low; 0 unless it is biased.
        wind_share: share of the wind torque in the variance of its sum with the motors' torque, in the band of the
            motion.
        components: components of the wind torque.
        noise: standard deviation of the measured rate's white noise, rad/s.
        refinements: value of each refinement of the model that predicts unseen windows better, by name
            (docs/physical.md).
        windows: number of windows of the flight that were fitted.
        filtered: whether the lag includes the lag of the gyro's filters; the delay always includes their delay.
        refusal: why these are not the parameters of the plant in its closed loop, if these were requested.
        unexplained_output: standard deviation of the output that the logged controller does not explain,
            relative to that of the output; NaN if the plant was identified without its controller.
        steered_frequency: highest frequency at which setpoints cause most of the rate's motion, Hz; NaN likewise.
        model: model that the parameters were estimated with, "gray-box" or "closed loop".
    """

    effect: Array
    damping: float
    lag: float
    delay: float
    covariance: Array
    status: dict[str, Status]
    reasons: dict[str, Fact | None]
    bias: float
    wind_share: float
    components: tuple[WindComponent, ...]
    noise: float
    refinements: dict[Refinement, float]
    windows: int
    filtered: bool = True
    refusal: Fact | None = None
    unexplained_output: float = np.nan
    steered_frequency: float = np.nan
    model: ModelName = ModelName.GRAY_BOX

    def __repr__(self) -> str:
        mean, half = self.mean_effect()
        return f"<Physical: mean effect {mean:.3g} ± {half:.2g} rad/s² per unit of input>"

    @property
    def wind(self) -> float:
        """Standard deviation of the wind torque per moment of inertia, rad/s², about its mean."""
        return float(np.linalg.norm([component.size for component in self.components]))

    def mean_effect(self, level: float = CONFIDENCE_LEVEL) -> EstimateWithHalfWidth:
        """Returns the mean magnitude of the motors' effects, and the half width of its interval.

        The half width contains the common errors of all motors, while errors of single motors average out. So it is
        smaller, relative to the mean, than the half widths of single motors.

        Args:
            level: probability of the interval.

        Returns:
            Mean and half width, rad/s² per unit of the inputs; the half width is NaN if the effect is not identifiable.
        """
        r = len(self.effect)
        # The mean magnitude is a linear function of the effects.
        weights = np.sign(self.effect) / r
        mean = float(weights @ self.effect)
        if not self.identifiable:
            return EstimateWithHalfWidth(mean, half_width=np.nan)
        variance = weights @ self.covariance[:r, :r] @ weights
        return EstimateWithHalfWidth(mean, half_width=float(half_width(variance, level)))

    @property
    def identifiable(self) -> bool:
        """Whether the motors' effect is reported, if only as biased."""
        return self.status["effect"] != Status.NOT_IDENTIFIABLE

    @property
    def caution(self) -> Fact | None:
        """Why the effect is not identifiable; ``None`` if it is."""
        if self.identifiable:
            return None
        return Fact(NoPhysical.EFFECT_NOT_IDENTIFIABLE, reason=self.reasons["effect"])

    def draws(self, number: int, seed: int = 0) -> Array:
        """Draws samples of the parameters from their normal posterior.

        They propagate the uncertainty of the parameters through calculations that are not linear in them. Lag and delay
        are clipped at ``MIN_DRAWN_SHARE`` of their estimates, because a normal distribution also has negative values.

        Args:
            number: number N of samples.
            seed: seed of the random numbers.

        Returns:
            (N + 1, r + 3) samples of the effects of r inputs, damping, lag and delay. The first row is
            the estimate itself, the others are the draws.
        """
        theta = parameter_vector(self)
        samples = normal_draws(theta, self.covariance, number, seed)
        lower_bounds = MIN_DRAWN_SHARE * theta[LAG_AND_DELAY]
        samples[:, LAG_AND_DELAY] = samples[:, LAG_AND_DELAY].clip(lower_bounds)
        return np.vstack([theta, samples])

    def interval(self, level: float = CONFIDENCE_LEVEL) -> PhysicalInterval:
        """Returns the half widths of the symmetric intervals of all parameters about their estimates.

        They follow from the diagonal of the covariance. The delay has the status of the lag, with which it is
        identified.

        Args:
            level: probability with which each interval contains the true value, for example 0.9.

        Returns:
            The half widths, in the units of the parameters; NaN for a parameter that is not identifiable.
        """
        half_widths = half_width(self.covariance.diagonal(), level)
        # A product with NaN is NaN, which hides the half width of a parameter that is not identifiable.
        one_or_nan = {}
        for name in PARAMETERS:
            one_or_nan[name] = np.nan if self.status[name] == Status.NOT_IDENTIFIABLE else 1.0
        return PhysicalInterval(
            effect=one_or_nan["effect"] * half_widths[EFFECTS],
            damping=float(one_or_nan["damping"] * half_widths[DAMPING]),
            lag=float(one_or_nan["lag"] * half_widths[LAG]),
            delay=float(one_or_nan["lag"] * half_widths[DELAY]),
        )

    @property
    def interval_90_percent(self) -> PhysicalInterval:
        """Half widths of the 90 % intervals."""
        return self.interval()


def parameter_vector(physical: Physical) -> Array:
    """Returns effect, damping, lag and delay as one vector (r + 3,)."""
    return np.array([*physical.effect, physical.damping, physical.lag, physical.delay])


def wind_torque_density(physical: Physical, frequency: Array) -> Array:
    """Returns the one-sided spectral density of the modelled wind torque, as the angular acceleration that it causes.

    The angular acceleration is the torque divided by the moment of inertia about the axis.

    Args:
        physical: physical parameters, with the components of the wind torque.
        frequency: (F,) in Hz.

    Returns:
        (F,) density of the angular acceleration, (rad/s²)²/Hz.
    """
    angular_frequency = 2 * np.pi * frequency
    two_sided_densities = []
    for component in physical.components:
        standard_deviation, time_scale = component.size, component.time
        two_sided_densities.append(
            component.colour.density(angular_frequency, standard_deviation, time_scale)
        )
    # A one-sided density has the power of the negative frequencies at the positive ones as well.
    return 2 * np.sum(two_sided_densities, axis=0)


def parameter_gradient(function: Callable[[Array], Array], theta: Array, value: Array) -> Array:
    """Returns the derivatives of a function by each parameter, by forward differences.

    Args:
        function: function of a parameter vector (k,), with values (…) of any shape.
        theta: (k,) parameters at which it is differentiated.
        value: (…) value of the function at ``theta``, which callers have computed before.

    Returns:
        Derivatives (k, …).
    """
    steps = FINITE_DIFFERENCE_STEP * np.maximum(abs(theta), FINITE_DIFFERENCE_STEP)
    derivatives = []
    for index, step in enumerate(steps):
        shift = np.zeros(len(theta))
        shift[index] = step
        derivatives.append((function(theta + shift) - value) / step)
    return np.array(derivatives)


def combined_with_earlier_flight(plant: Physical, prior: Physical) -> Physical:
    """Combines the physical parameters of a flight with the parameters by an earlier flight of the same vehicle.

    Both are normal distributions, and the result is the product of their densities (the update step of a Kalman
    filter). The variance of the effect from the earlier flight is increased by how much it changes between flights. The
    result is ``plant`` alone if the prior is of other inputs or is not identifiable. It is also ``plant`` alone if the
    mean effects differ by more than ``SIGNIFICANT_SIGMAS`` standard deviations, because the vehicle must have changed.
    If this flight does not identify the effect, on which the other parameters depend, the result is the prior.

    Args:
        plant: physical parameters from this flight.
        prior: physical parameters from the earlier flight.

    Returns:
        This flight's parameters with the combined estimates, status and reasons.
    """
    prior_theta = parameter_vector(prior)
    theta = parameter_vector(plant)
    if len(prior_theta) != len(theta) or not prior.identifiable:
        return plant
    # A fuller battery or a lighter load changes the effects of all motors by the same factor.
    common_effect = np.append(prior_theta[EFFECTS], np.zeros(3))
    change = np.outer(common_effect, common_effect) * OmissionErrors.between_flights**2
    prior_covariance = prior.covariance + change

    if plant.identifiable:
        total = prior_covariance + plant.covariance
        # The signed sum over the motors' effects is r times the mean effect.
        signs = np.sign(common_effect)
        difference = signs @ (theta - prior_theta)
        if abs(difference) > SIGNIFICANT_SIGMAS * np.sqrt(signs @ total @ signs):
            return plant
        # Kalman gain K = P₀ (P₀ + P)⁻¹, with the covariances P₀ of the prior and P of this flight.
        gain = np.linalg.solve(total, prior_covariance).T
        combined_theta = prior_theta + gain @ (theta - prior_theta)
        covariance = prior_covariance - gain @ prior_covariance
        status = plant.status
        reasons = plant.reasons
        bias = plant.bias
    else:
        combined_theta = prior_theta
        covariance = prior_covariance
        status = prior.status
        reasons = _reasons_of_earlier_flight(prior)
        bias = prior.bias
    damping, lag, delay = np.maximum(combined_theta[DYNAMICS], PLANT_MINIMUM).tolist()
    return plant._replace(
        effect=combined_theta[EFFECTS],
        damping=damping,
        lag=lag,
        delay=delay,
        covariance=covariance,
        status=status,
        reasons=reasons,
        bias=bias,
    )


def _reasons_of_earlier_flight(prior: Physical) -> dict[str, Fact | None]:
    """Returns the reasons for parameters that were taken from an earlier flight.

    Args:
        prior: physical parameters by the earlier flight.

    Returns:
        By parameter name ("effect", "damping", "lag"): the reason that it is known from an earlier flight; or, if that
        did not identify it, the reason why.
    """
    reasons = dict[str, Fact | None]()
    for name in PARAMETERS:
        if prior.status[name] == Status.NOT_IDENTIFIABLE:
            reasons[name] = prior.reasons[name]
        else:
            reasons[name] = Fact(ParameterDoubt.KNOWN_FROM_EARLIER_FLIGHT)
    return reasons
