"""The likelihood of a closed loop whose controller is known, of its spectra in bands.

Whittle's (Brillinger, Time Series, sec. 5.6), of the spectra of rate, output and setpoint by the model's densities.
"""

import numpy as np

from mavdem.arrays import Array
from mavdem.dem.engine.gauss_newton import QuadraticExpansion
from mavdem.plant.closed_loop.densities import (
    ASKED,
    OUTPUT,
    RATE,
    SETPOINT,
    Densities,
    KnownController,
)
from mavdem.plant.closed_loop.parameters import CONTROLLER, MEAN, NAMES, SD
from mavdem.plant.closed_loop.spectra import Complex, CrossSpectra

DEPENDENT = 6.25
"""Values of the spectra that count as one: winds differ from window to window, and no flight is linear or stationary.
What is known beforehand counts whole, so that slow logs, which leave lag and delay open, keep to it."""


class AxisPosterior:
    """The log joint of one axis's spectra and parameters in the order of ``NAMES``, up to a constant.

    It is an ``Objective`` of Fisher's scoring.
    """

    def __init__(
        self,
        spectra: CrossSpectra,
        controller: KnownController,
        rounding: float,
        limited: float = 0.0,
    ) -> None:
        """Takes the spectra of all four quantities; ``rounding`` is the output's step, as a demand.

        ``limited`` is the share of the output's power while it is at a limit. What the controller asks beyond does not
        come: it acts as one of less gain, by all of that share where all of the output is cut (J. J. Bussgang, MIT RLE
        Report 216, 1952), by less where other motors make up for it.
        """
        self.spectra = spectra.of((RATE, OUTPUT, SETPOINT))
        self.known = controller
        self.limited = min(limited, 0.95)
        less = -np.log1p(-self.limited) / 2
        of_controller = np.arange(len(NAMES)) == CONTROLLER
        self.mean = MEAN - less * of_controller
        self.sd = SD + less * of_controller
        self.densities = Densities(spectra, controller, rounding)
        self.seen = self.spectra.mean
        self.weights = spectra.counts * len(spectra.densities) / DEPENDENT

    def value(self, at: Array) -> float:
        """Returns the value at parameters (k,); minus infinity where there is none."""
        return self._whitened(self.densities.at(at))[0] + self._log_prior(at)

    def expand(self, at: Array) -> QuadraticExpansion:
        """Returns the value to second order, with Fisher's information for the curvature."""
        model, slopes = self.densities.with_slopes(at)
        value, whitener, seen = self._whitened(model)
        # of two slopes A and B the information is tr(S⁻¹ A S⁻¹ B), in white spectra tr(A B)
        shares = np.sqrt(self.weights)
        white = np.einsum("j,jab,jdc->jbcad", shares, whitener, whitener.conj())
        parts = ASKED**2
        whitened = slopes.reshape(-1, len(at), parts) @ white.reshape(-1, parts, parts)
        flat = whitened.swapaxes(0, 1).reshape(len(at), -1).view(float)
        unlike = shares[:, None, None] * (seen - np.eye(ASKED))
        precision = self.sd**-2.0
        slope = flat @ unlike.reshape(-1).view(float) - precision * (at - self.mean)
        curvature = flat @ flat.T + np.diag(precision)
        return QuadraticExpansion(at, value + self._log_prior(at), slope, curvature)

    def _log_prior(self, at: Array) -> float:
        return -0.5 * np.sum(((at - self.mean) / self.sd) ** 2)

    def _whitened(self, model: Complex) -> tuple[float, Complex, Complex]:
        """The log likelihood of a model (J, C, C), what makes it white, and what that makes of the spectra."""
        try:
            factor = np.linalg.cholesky(model)
        except np.linalg.LinAlgError:
            unknown = np.full_like(model, np.nan)
            return -np.inf, unknown, unknown
        whitener = np.linalg.inv(factor).astype(complex)
        seen = whitener @ self.seen @ whitener.mT.conj()
        size = 2 * np.log(np.einsum("jaa->ja", factor).real) + np.einsum("jaa->ja", seen).real
        return -float(self.weights @ size.sum(axis=1)), whitener, seen

    def steered_share(self, theta: Array) -> float:
        """Returns the share of the rate's variance that follows what was asked, by parameters θ."""
        whole, unasked = (
            self.densities.at(theta, is_asked)[:, RATE, RATE].real for is_asked in (True, False)
        )
        width = np.gradient(self.spectra.frequency)
        return 1 - float(width @ unasked) / float(width @ whole)
