"""The scale of motor outputs: pulse widths, 0..1, a simulator's 0..1000 or DShot, told apart by their values."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class Scale:
    """How motor outputs are expressed in a stream.

    Attributes:
        name: "PWM", "normalised", "0-1000", "DShot" or "unknown".
        unit: "µs" for pulse widths, otherwise empty.
        low, high: outputs at no and at full throttle.
        step: quantisation step: the least difference between two values seen.
    """

    name: str
    unit: str
    low: float
    high: float
    step: float

    def fraction(self, outputs: NDArray[np.float64]) -> NDArray[np.float64]:
        """Outputs as a share of the range, 0 at ``low`` and 1 at ``high``; below 0 when disarmed on some autopilots."""
        return (outputs - self.low) / (self.high - self.low)


def recognise(outputs: NDArray[np.float64], parameters: Mapping[str, float]) -> Scale:
    """The scale of motor outputs of any shape, as sent, disarmed stretches included; non-finite values are ignored.

    Pulse widths never fall below 750 µs except to 0 for "off"; PX4's DShot runs to 1999 and idles far below that, and
    its simulators send 150..1000. ArduPilot's MOT_PWM_MIN and MOT_PWM_MAX say the range of pulse widths, 0 for not set.
    """
    values = np.unique(outputs[np.isfinite(outputs)])
    running = values[values > 0]
    if not len(running):
        return Scale("unknown", "", 0.0, 1.0, 0.0)
    step = float(np.diff(values).min()) if len(values) > 1 else 0.0
    least, most = float(running[0]), float(running[-1])
    if most <= 1.05:
        return Scale("normalised", "", 0.0, 1.0, step)
    if least >= 750 and 1000 < most <= 2300:
        low, high = parameters.get("MOT_PWM_MIN", 0.0), parameters.get("MOT_PWM_MAX", 0.0)
        low, high = (low, high) if 0 < low < high else (1000.0, 2000.0)
        return Scale("PWM", "µs", float(low), float(high), step)
    if 10 < most <= 1000:
        return Scale("0-1000", "", 0.0, 1000.0, step)
    if most <= 2047:
        return Scale("DShot", "", 0.0, 2000.0, step)
    return Scale("unknown", "", 0.0, most, step)
