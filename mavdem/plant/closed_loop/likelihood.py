"""Posterior of the parameters of one axis in its closed loop, by the Whittle likelihood of its spectra.

The estimated cross-spectral densities I_j in J bands are compared with the model's densities Φ_j(θ). With n_j values in
each band, the log likelihood of complex normal transforms is, up to a constant,

    −Σ_j n_j [ln det Φ_j + tr(Φ_j⁻¹ I_j)]

(Brillinger, Time Series, secs. 4.4 and 5.6; Pintelon and Schoukens, System Identification: A Frequency Domain Approach,
2nd ed.). Its Fisher information for two entries of θ with gradients A_j and B_j is Σ_j n_j tr(Φ_j⁻¹ A_j Φ_j⁻¹ B_j).
"""

from typing import NamedTuple

import numpy as np

from mavdem.arrays import Array, ArrayPair
from mavdem.dem.engine.gauss_newton import QuadraticExpansion
from mavdem.plant.closed_loop.densities import QUANTITIES, DensityModel
from mavdem.plant.closed_loop.parameters import (
    CONTROLLER,
    PARAMETER_NAMES,
    PRIOR_MEAN,
    PRIOR_SD,
)
from mavdem.plant.closed_loop.response import MODELLED_QUANTITIES, KnownController, Quantity
from mavdem.plant.closed_loop.spectra import ComplexArray, CrossSpectra

VALUES_PER_INDEPENDENT_ONE = 6.25
"""Number of values of the spectra that count as one independent value.

The wind differs from window to window, and no flight is linear or stationary. The prior counts in full, so that slow
logs, which leave lag and delay open, keep to it. Chosen on simulated flights.
"""

DISTURBANCE_DEVIATION = 0.3
"""Standard deviation of the true density of wind and noise about the modelled one, relative to it, at each frequency.

No sum of three components is the spectrum of every wind: those of Dryden and of von Kármán alone, with which turbulence
is usually described, fall by powers of 2 and 5/3 of the frequency, and so part by 26 % in an octave. Chosen on flights
of ``first_flight_ardupilot`` whose setpoints end at 5 Hz: 90 % of the 20 intervals of their phase margins hold the
truth, with 0.2 85 %, and without it 75 %. On other vehicles such intervals are still too narrow: with
``UNSTEERED_PHASE_DEVIATION`` they hold it in 74 % of 23 loops (``tools/validation/loops.py --half report --rates 100
--limited --flights 8``).
"""

DISTURBANCE_OCTAVES = 0.5
"""Distance of two frequencies, octaves, over which this deviation hardly changes: a choice."""

MAX_SATURATED_SHARE = 0.95
"""Largest share of saturated output that the prior of the controller's gain allows for, which keeps it finite."""


class WhitenedSpectra(NamedTuple):
    """Estimated spectra whitened by a model: C⁻¹ I C⁻ᴴ, with the Cholesky factor Φ = C Cᴴ of the model's density."""

    log_likelihood: float
    """Log likelihood of the model, up to a constant; minus infinity if its density is not positive definite."""

    whitener: ComplexArray
    """Inverse Cholesky factors C⁻¹ (J, C, C); NaN without a likelihood."""

    spectra: ComplexArray
    """Whitened spectra (J, C, C), identity if the model is right; NaN without a likelihood."""


class AxisPosterior:
    """Log posterior of the loop's log parameters θ, by the Whittle likelihood of spectra in J frequency bands.

    Attributes:
        spectra: estimated spectra of the modelled quantities.
        controller: the controller that flew.
        densities: the model of the spectra.
        saturated_share: share of the output's power while the output was at a limit, up to ``MAX_SATURATED_SHARE``.
        prior_mean: prior mean of θ (k,).
        prior_sd: prior standard deviation of θ (k,).
    """

    def __init__(
        self,
        spectra: CrossSpectra,
        controller: KnownController,
        rounding: float,
        saturated_share: float = 0.0,
    ) -> None:
        """Prepares the model and the prior.

        An output at a limit acts like a controller of less gain (the describing function of saturation: J. J. Bussgang,
        MIT RLE Report 216, 1952). The gain is lower by all of the saturated share where all of the output is cut, and
        by less where other motors make up for it. So the prior of its logarithm is centred half way, and is wider.

        Args:
            spectra: estimated spectra of all four quantities, in the order of ``Quantity``.
            controller: the controller that flew.
            rounding: resolution of the logged output, in the unit of the demand on the axis.
            saturated_share: share of the output's power while the output was at a limit.
        """
        self.spectra = spectra.select(MODELLED_QUANTITIES)
        self.controller = controller
        self.densities = DensityModel(spectra, controller, rounding)
        self.saturated_share = min(saturated_share, MAX_SATURATED_SHARE)
        # The logarithm of the gain lies between 0 and ln(1 − share). Half of that is the middle, and also the added
        # standard deviation.
        half_log_loss = -np.log1p(-self.saturated_share) / 2
        is_controller = np.arange(len(PARAMETER_NAMES)) == CONTROLLER
        self.prior_mean = PRIOR_MEAN - half_log_loss * is_controller
        self.prior_sd = PRIOR_SD + half_log_loss * is_controller
        self._estimate = self.spectra.mean_density
        # Values of all windows, of which only so many count as independent.
        windows = len(spectra.densities)
        self._counts = spectra.effective_samples * windows / VALUES_PER_INDEPENDENT_ONE

    def value(self, theta: Array) -> float:
        """Returns the log posterior density of θ (k,); minus infinity if the model has no likelihood."""
        whitened_density = self._whiten_spectra(self.densities.density(theta))
        return whitened_density.log_likelihood + self._log_prior(theta)

    def expand(self, theta: Array) -> QuadraticExpansion:
        """Expands the log posterior about a point to second order, as Fisher scoring needs it.

        With the estimated density I_j, the model's density Φ_j(θ) and n_j independent values in band j, the Whittle log
        likelihood is −Σ_j n_j [ln det Φ_j + tr(Φ_j⁻¹ I_j)]. If Φ_j has the derivative A_j by one entry of θ and B_j by
        another, the derivative of the log likelihood by the first is Σ_j n_j tr(Φ_j⁻¹ A_j Φ_j⁻¹ (I_j − Φ_j)), and the
        Fisher information on both, which is used as the curvature, is Σ_j n_j tr(Φ_j⁻¹ A_j Φ_j⁻¹ B_j). The normal prior
        adds its own gradient and precision.

        All these traces are scalar products of whitened matrices (:meth:`_whitened_rows`).

        Args:
            theta: the point θ, logarithms of the parameters (k,).

        Returns:
            Value, gradient (k,) and curvature (k, k): the negative second derivative, expected over data by the model.

        See Also:
            :meth:`mavdem.plant.closed_loop.densities.DensityModel.density_and_gradient`: the derivatives A_j.
        """
        # The densities (J, C, C) of C quantities in J bands, and their derivatives (J, k, C, C).
        density, density_derivatives = self.densities.density_and_gradient(theta)
        whitened_density = self._whiten_spectra(density)
        # One row for each entry of θ: the derivatives A_j of all bands, whitened and multiplied by √n_j.
        derivative_rows = self._whitened_rows(density_derivatives, whitened_density.whitener)
        # I_j − Φ_j in the same form: Φ_j is the identity after whitening.
        root_counts = np.sqrt(self._counts)
        residuals = root_counts[:, None, None] * (whitened_density.spectra - np.eye(QUANTITIES))
        residual_row = residuals.reshape(-1).view(float)
        likelihood_gradient = derivative_rows @ residual_row
        information = derivative_rows @ derivative_rows.T
        precision = self.prior_sd**-2.0
        gradient = likelihood_gradient - precision * (theta - self.prior_mean)
        curvature = information + np.diag(precision)
        value = whitened_density.log_likelihood + self._log_prior(theta)
        return QuadraticExpansion(theta, value, gradient, curvature)

    def disturbance_gradient_variance(self, theta: Array) -> Array:
        """Returns the variance of the gradient that comes of a wrong spectrum of wind and noise.

        Where setpoints move the vehicle little, the model explains the motion by wind and noise that the loop
        amplifies. If their density differs from the modelled one by a factor 1 + ε, the likelihood takes the difference
        for one of the loop. With the density D_j of the modelled disturbances in band j, the gradient by an entry of θ
        changes by

            Σ_j ε_j n_j tr(Φ_j⁻¹ A_j Φ_j⁻¹ D_j)

        in the notation of :meth:`expand`. The deviations ε are smooth: two of them have the covariance
        ``DISTURBANCE_DEVIATION``² exp(−d² / 2) at a distance of d times ``DISTURBANCE_OCTAVES``.

        Args:
            theta: logarithms of the parameters (k,).

        Returns:
            The variance (k, k), which does not shrink with the length of the flight as that of the likelihood does.
        """
        density, density_derivatives = self.densities.density_and_gradient(theta)
        whitener = self._whiten_spectra(density).whitener
        derivative_rows = self._whitened_rows(density_derivatives, whitener)
        disturbances = self.densities.density(theta, with_reference=False)
        root_counts = np.sqrt(self._counts)
        whitened_disturbances = whitener @ disturbances @ whitener.mT.conj()
        disturbance_rows = root_counts[:, None, None] * whitened_disturbances
        bands = len(self._counts)
        # Letters of einsum: entry k of θ, band j, and x, the real numbers of the matrices of a band.
        gradient_by_deviation = np.einsum(
            "kjx,jx->kj",
            derivative_rows.reshape(len(theta), bands, -1),
            disturbance_rows.reshape(bands, -1).view(float),
        )
        octaves = np.log2(self.spectra.frequency)
        distance = (octaves[:, None] - octaves) / DISTURBANCE_OCTAVES
        covariance = DISTURBANCE_DEVIATION**2 * np.exp(-(distance**2) / 2)
        return gradient_by_deviation @ covariance @ gradient_by_deviation.T

    def _whitened_rows(self, derivatives: ComplexArray, whitener: ComplexArray) -> Array:
        """Whitens the derivatives of the density, and returns them as one row of real numbers for each entry of θ.

        The likelihood needs sums Σ_j n_j tr(Φ_j⁻¹ A_j Φ_j⁻¹ B_j) over the frequency bands j with n_j values each. With
        Φ = L Lᴴ, one such trace is the scalar product of the whitened matrices L⁻¹ A L⁻ᴴ and L⁻¹ B L⁻ᴴ. They are
        multiplied by √n_j, so that the scalar product of two rows is the whole sum.

        Args:
            derivatives: derivatives of the density in J bands by each of the k entries of θ (J, k, C, C).
            whitener: inverse Cholesky factors L⁻¹ of the density (J, C, C).

        Returns:
            Rows (k, 2 J C²): the entries of all bands side by side, real and imaginary parts as separate values.
        """
        bands, k = derivatives.shape[:2]
        entries = QUANTITIES**2
        # Whitening is a linear map of the C² entries of a matrix: (L⁻¹ A L⁻ᴴ)_ad = Σ_bc (L⁻¹)_ab A_bc (L⁻¹)*_dc. It is
        # computed once for each band as a matrix, with rows bc and columns ad, and multiplies all k derivatives at
        # once. That is faster than two matrix products for each derivative. Letters of einsum: band j, quantities a to
        # d.
        root_counts = np.sqrt(self._counts)
        whitening = np.einsum("j,jab,jdc->jbcad", root_counts, whitener, whitener.conj())
        whitening_matrices = whitening.reshape(bands, entries, entries)
        # This is the product (k, C²) @ (C², C²) in each band.
        whitened_derivatives = derivatives.reshape(bands, k, entries) @ whitening_matrices
        # The bands of each entry of θ are put side by side: (J, k, C²) becomes (k, J C²).
        return whitened_derivatives.swapaxes(0, 1).reshape(k, -1).view(float)

    def reference_share(self, theta: Array) -> float:
        """Returns the fraction of the gyro rate's variance that the reference causes, by the model, 0 to 1.

        Args:
            theta: logarithms of the parameters (k,).
        """
        density, density_without_reference = self._rate_densities(theta)
        # A variance is the integral of a density over the frequencies, which are not evenly spaced.
        bandwidth = np.gradient(self.spectra.frequency)
        return float(1 - (bandwidth @ density_without_reference) / (bandwidth @ density))

    def reference_coherence(self, theta: Array) -> Array:
        """Returns the coherence of the gyro rate with the reference in each band (J,), by the model, 0 to 1.

        It is the fraction of the rate's density there that the reference causes; wind and noise cause the rest.

        Args:
            theta: logarithms of the parameters (k,).
        """
        density, density_without_reference = self._rate_densities(theta)
        return 1 - density_without_reference / density

    def _rate_densities(self, theta: Array) -> ArrayPair:
        """Returns the modelled densities of the gyro rate (J,), with the reference and without it, (rad/s)²/Hz."""
        # Index of the rate's own density in the matrices of all densities.
        of_rate = (..., Quantity.RATE, Quantity.RATE)
        density = self.densities.density(theta)[of_rate].real
        density_without_reference = self.densities.density(theta, with_reference=False)[
            of_rate
        ].real
        return density, density_without_reference

    def _log_prior(self, theta: Array) -> float:
        """Returns the logarithm of the normal prior density of θ (k,), up to a constant."""
        return -0.5 * np.sum(((theta - self.prior_mean) / self.prior_sd) ** 2)

    def _whiten_spectra(self, density: ComplexArray) -> WhitenedSpectra:
        """Whitens the estimated spectra by a model's density, and computes the log likelihood.

        With the Cholesky factor Φ = L Lᴴ, the log determinant is ln det Φ = 2 Σ ln diag L, and the trace tr(Φ⁻¹ I) is
        the trace of the whitened spectra L⁻¹ I L⁻ᴴ.

        Args:
            density: cross-spectral densities Φ of the model (J, C, C).

        Returns:
            Log likelihood, whitening matrices L⁻¹ and whitened spectra. If any density is not positive definite, the
            log likelihood is minus infinity, and the others are NaN.
        """
        try:
            factor = np.linalg.cholesky(density)
        except np.linalg.LinAlgError:
            undefined_density = np.full_like(density, np.nan)
            return WhitenedSpectra(-np.inf, undefined_density, undefined_density)
        whitener = np.linalg.inv(factor).astype(complex)
        spectra = whitener @ self._estimate @ whitener.mT.conj()
        log_diagonal = np.log(factor.diagonal(axis1=1, axis2=2).real)
        deviance = 2 * log_diagonal + spectra.diagonal(axis1=1, axis2=2).real
        return WhitenedSpectra(-float(self._counts @ deviance.sum(axis=1)), whitener, spectra)
