"""Gyro: what an autopilot's filters leave of the body rates, stepped as fast as the physics.

Low-pass and notch are those of ``LowPassFilter2p`` and ``NotchFilter`` of ArduPilot and PX4: analog filters on the
warped frequencies of the bilinear transform, tan(π f / rate).
"""

from math import pi, tan
from operator import add

import numpy as np
from numpy.typing import ArrayLike
from scipy.signal import bilinear, butter, sosfreqz

from mavdem.loops.controllers import Controller
from mavdem.loops.filters import MAX_NOTCH_FREQUENCY_RATIO
from mavdem.loops.margins import Complex
from sitl_scenarios.dynamics import AirState, Body, Four, State, Three
from sitl_scenarios.motion import Array
from sitl_scenarios.sensors import RotorNoise

NO_ROTATION = (0.0, 0.0, 0.0)  # rad/s


class Gyro:
    """The gyro of a vehicle with a ``controller``, or without filters; ``rates``: rad/s, behind the filters."""

    def __init__(self, controller: Controller | None, step: float) -> None:
        self.rates: Three = NO_ROTATION
        self.felt: Three = NO_ROTATION  # before the filters
        sections: list[ArrayLike] = [[1.0, 0.0, 0.0, 1.0, 0.0, 0.0]]  # passes all
        if controller and 0 < controller.gyro_filter * step < MAX_NOTCH_FREQUENCY_RATIO:
            sections += butter(2, controller.gyro_filter, fs=1 / step, output="sos").tolist()
        for notch in controller.notches if controller else ():
            if notch.frequency * step < MAX_NOTCH_FREQUENCY_RATIO:
                k = tan(pi * notch.frequency * step)
                damping = k * notch.bandwidth / notch.frequency
                kept = damping * 10 ** (-notch.attenuation / 20)
                above = [1, kept, k * k]
                below = [1, damping, k * k]
                section = bilinear(above, below, 0.5)
                sections.append(np.hstack(section))
        self._sections = np.array(sections)
        self._filters = self._sections[1:].tolist()
        self._pasts = [[[0.0, 0.0] for _ in self._filters] for _ in NO_ROTATION]
        self._step = step

    def response(self, frequency: Array) -> Complex:
        """Returns (F,) rates behind the filters by the true ones, at ``frequency`` (F,), Hz."""
        responses = sosfreqz(self._sections, frequency, fs=1 / self._step)
        return responses[1]

    def fly(
        self,
        body: Body,
        state: State,
        targets: Four,
        air: AirState,
        steps: int,
        noise: RotorNoise | None = None,
    ) -> State:
        """Returns the state after some steps of the ``body`` (``Body.moved``), whose rates it senses with ``noise``."""
        for _ in range(steps):
            state = body.moved(state, targets, air)
            shaken = noise.at(state.rotors) if noise else NO_ROTATION
            self.felt = self.rates = tuple(map(add, state.rates, shaken))
            if self._filters:
                self.rates = tuple(map(self._filtered, self._pasts, self.felt))
        return state

    def _filtered(self, pasts: list[list[float]], rate: float) -> float:
        # A call of scipy's takes longer than a cycle of the physics.
        for (b0, b1, b2, _, a1, a2), past in zip(self._filters, pasts, strict=True):
            after = b0 * rate + past[0]
            past[:] = b1 * rate - a1 * after + past[1], b2 * rate - a2 * after
            rate = after
        return rate
