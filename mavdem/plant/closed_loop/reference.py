"""Spectral density of the rate loop's reference signal, recovered from a logged estimate that is aliased and noisy."""

import numpy as np

from mavdem.arrays import Array, ArrayPair, Flags
from mavdem.plant.closed_loop.response import KnownController, Quantity
from mavdem.plant.closed_loop.spectra import CrossSpectra

MAX_OTHER_CYCLE_SHARE = 0.5
"""Largest share of setpoints that are not of the attitude's controller cycle with which the logged angle is used: most
of its noise then cancels in the reference."""

MIN_REFERENCE_FRACTION = 0.05
"""Least density of the reference, relative to its estimate, however much of that is folded or noise: a choice."""

MAX_ABSOLUTE_LOGARITHM = 50.0
"""Bound of the logarithms of the power law's parameters, which keeps the exponentials finite."""

MAX_LOG_EXPONENT = 2.0
"""Bound of the logarithm of the power law's exponent: densities fall by no more than the 15th power of frequency."""

EDGE_BANDS = 5
"""Number of bands at either end of the estimate whose mean level the search begins with: a choice."""

INITIAL_LOG_EXPONENT = -0.35
"""Logarithm of the power law's exponent to begin with: a density that falls with the power 1.4 of frequency."""

MAX_ITERATIONS = 600
"""Iterations of the simplex search for the power law, at most."""


def with_reference_from_gyro(spectra: CrossSpectra, controller: KnownController) -> CrossSpectra:
    """Computes the reference by the gyro if setpoint and attitude were mostly logged in different controller cycles.

    The reference is the setpoint r plus the angle gain K times the angle φ. At the stamps of the setpoint the angle can
    then only be interpolated. That adds its noise a second time, and an error that looks like a reference at high
    frequencies: a phase margin of 27° was identified as 37°. In spectra the angle follows from the gyro rate y behind
    the gyro filters F, whatever its stamps are, and with hardly any noise: φ = y / (s F).

    Args:
        spectra: cross-spectra of C quantities, the first four in the order of ``Quantity``.
        controller: the controller, with angle gain and gyro filters.

    Returns:
        The spectra, with r + K y / (s F) as the reference; unchanged if setpoint and rate are mostly of one cycle.
    """
    other_cycle_share = spectra.other_cycle_share(
        Quantity.SETPOINT, Quantity.RATE, controller.cycle_time
    )
    if other_cycle_share <= MAX_OTHER_CYCLE_SHARE:
        return spectra
    frequency = spectra.frequency
    angle_per_rate = 1 / (2j * np.pi * frequency * controller.gyro_filter(frequency))
    # The matrices (J, C, C) that map the quantities to the same quantities with another reference.
    quantity_count = len(spectra.stamp_offsets)
    mapping = np.tile(np.eye(quantity_count, dtype=complex), (len(frequency), 1, 1))
    mapping[:, Quantity.REFERENCE] = 0
    mapping[:, Quantity.REFERENCE, Quantity.SETPOINT] = 1
    mapping[:, Quantity.REFERENCE, Quantity.RATE] = controller.angle_gain * angle_per_rate
    return spectra._replace(densities=mapping @ spectra.densities @ mapping.mT.conj())


def denoised_density(density: Array, noise_density: float) -> ArrayPair:
    """Subtracts the noise from an estimated spectral density of the reference.

    Args:
        density: (…) estimate that contains the noise, of any shape.
        noise_density: density of the white noise, in the unit of ``density``.

    Returns:
        The density (…) without the noise, at least ``MIN_REFERENCE_FRACTION`` of the estimate; and the derivative (…)
        of its logarithm by the logarithm of the noise's standard deviation.
    """
    lowest_density = MIN_REFERENCE_FRACTION * density
    density_without_noise = np.maximum(density - noise_density, lowest_density)
    # The noise density is proportional to the square of the standard deviation. At its lowest value the result does not
    # depend on the noise.
    slope = np.where(
        density_without_noise > lowest_density, -2 * noise_density / density_without_noise, 0.0
    )
    return density_without_noise, slope


def unfolded_density(density: Array, frequency: Array, is_base: Flags, in_range: Flags) -> Array:
    """Distributes the aliased density of the reference over each frequency and its aliases.

    Sampling at the message rate adds the densities at all aliases of a frequency to its own. To undo that, a power law
    with a white floor is assumed: it is aliased likewise, and fitted to the estimate by its Whittle likelihood. Above
    half of the message rate the result is the fitted law. Below it, the result is the estimate minus the law at the
    aliases.

    Args:
        density: estimate at J frequencies (J,), including the densities at their aliases.
        frequency: magnitudes of the frequencies and their F aliases (J, F), Hz.
        is_base: flags (F,), true only for the frequency itself.
        in_range: flags (J, F) of the frequencies below half of the controller's rate.

    Returns:
        Unfolded density (J, F), 0 out of range. At the frequencies themselves it is above 0.
    """
    # Importing scipy.optimize takes half a second.
    from scipy.optimize import minimize

    def power_law(logarithms: Array) -> Array:
        """Returns the density size · (1 + (f / corner)²)^(−exponent) + white at all frequencies (J, F).

        Args:
            logarithms: natural logarithms of size, corner (Hz), exponent and white floor (4,). They are clipped, since
                the search may try values whose exponentials overflow.
        """
        upper_limits = [
            MAX_ABSOLUTE_LOGARITHM,
            MAX_ABSOLUTE_LOGARITHM,
            MAX_LOG_EXPONENT,
            MAX_ABSOLUTE_LOGARITHM,
        ]
        clipped_logarithms = logarithms.clip(-MAX_ABSOLUTE_LOGARITHM, upper_limits)
        size, corner, exponent, white = np.exp(clipped_logarithms)
        return size * (1 + (frequency / corner) ** 2) ** -exponent + white

    def negative_log_likelihood(logarithms: Array) -> float:
        """Returns the negative log likelihood of the power law with these logarithms (4,)."""
        # Sampling adds the densities of all aliases.
        aliased_law = np.where(in_range, power_law(logarithms), 0.0).sum(axis=1)
        # Whittle: a periodogram value I of the density S has the negative log likelihood ln S + I / S.
        return (np.log(aliased_law) + density / aliased_law).sum()

    # The search begins with the level of the lowest bands as the size, a corner at 1 Hz, and the level of the highest
    # bands, divided by the number of aliases, as the white floor.
    low_frequency_size = np.log(density[:EDGE_BANDS].mean())
    white_floor = np.log(np.median(density[-EDGE_BANDS:]) / len(is_base))
    start = np.array([low_frequency_size, 0.0, INITIAL_LOG_EXPONENT, white_floor])
    fit = minimize(
        negative_log_likelihood, start, method="Nelder-Mead", options={"maxiter": MAX_ITERATIONS}
    )
    unfolded = np.where(in_range, power_law(fit.x), 0.0)
    density_of_aliases = unfolded[:, ~is_base].sum(axis=1)
    base_density = np.maximum(density - density_of_aliases, MIN_REFERENCE_FRACTION * density)
    unfolded[:, is_base] = base_density[:, None]
    return unfolded
