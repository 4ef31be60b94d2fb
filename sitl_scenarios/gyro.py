"""Gyro: what an autopilot's filters leave of the body rates, stepped as fast as the physics.

Low-pass and notch are those of ``LowPassFilter2p`` and ``NotchFilter`` of ArduPilot and PX4: analog filters on the
warped frequencies of the bilinear transform, tan(π f / rate).
"""

from __future__ import annotations

from collections.abc import Sequence
from math import pi, sqrt, tan

import numpy as np
from numpy.typing import NDArray

from mavdem.condition.loop.controllers import Controller
from mavdem.condition.loop.filters import HIGHEST
from sitl_scenarios.dynamics import Three


class _Section:
    """A second-order filter of one rate, by its polynomials' coefficients in the delay; resting at zero."""

    def __init__(
        self, above: tuple[float, float, float], below: tuple[float, float, float]
    ) -> None:
        self._above = [one / below[0] for one in above]
        self._below = [one / below[0] for one in below]
        self._first = self._second = 0.0

    def filtered(self, given: float) -> float:
        """The next output (transposed direct form II)."""
        b0, b1, b2 = self._above
        _, a1, a2 = self._below
        out = b0 * given + self._first
        self._first = b1 * given - a1 * out + self._second
        self._second = b2 * given - a2 * out
        return out

    def response(self, late: NDArray[np.complex128]) -> NDArray[np.complex128]:
        """Of sines that a step delays by ``late`` (N,)."""
        above, below = (
            np.polynomial.polynomial.polyval(late, one) for one in (self._above, self._below)
        )
        return np.asarray(above / below)


def _sections(controller: Controller, step: float) -> list[_Section]:
    """The filters of one axis, in steps of ``step`` s."""
    sections = []
    if 0 < controller.gyro_filter * step < HIGHEST:
        k = tan(pi * controller.gyro_filter * step)
        sections.append(_Section((k * k, 2 * k * k, k * k), _polynomial(k, sqrt(2))))
    for notch in controller.notches:
        if notch.frequency * step < HIGHEST:
            k = tan(pi * notch.frequency * step)
            damping = notch.bandwidth / notch.frequency
            kept = damping * 10 ** (-notch.attenuation / 20)
            sections.append(_Section(_polynomial(k, kept), _polynomial(k, damping)))
    return sections


def _polynomial(k: float, damping: float) -> tuple[float, float, float]:
    """Of the delay, for s² + ``damping`` s + 1 at a warped frequency of ``k``."""
    return k * k + damping * k + 1, 2 * k * k - 2, k * k - damping * k + 1


class Gyro:
    """A vehicle's gyro; its filters are of ``controllers`` (3,), or none. ``rates``: rad/s, behind them."""

    def __init__(self, controllers: Sequence[Controller], step: float) -> None:
        self._axes = [_sections(one, step) for one in controllers] or [[], [], []]
        self._step = step
        self.rates: Three = (0.0, 0.0, 0.0)

    def sense(self, rates: Three) -> None:
        """Filters the true ``rates``, rad/s; called once a step."""
        felt = []
        for rate, sections in zip(rates, self._axes, strict=True):
            for section in sections:
                rate = section.filtered(rate)
            felt.append(rate)
        self.rates = tuple(felt)

    def response(self, axis: int, s: NDArray[np.complex128]) -> NDArray[np.complex128]:
        """(N,) of the rate about an axis, at ``s`` (N,), 1/s."""
        late = np.exp(-s * self._step)
        passed = np.ones(len(s), np.complex128)
        for section in self._axes[axis]:
            passed *= section.response(late)
        return passed
