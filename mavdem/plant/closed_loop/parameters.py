"""Parameters of the closed-loop likelihood of one axis, and their log-normal prior.

The likelihood is maximised over θ, the natural logarithms of all parameters in the order of :class:`LoopParameters`.
Typical values and prior standard deviations stand in ``parameters.toml``.
"""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import NamedTuple

import numpy as np

from mavdem.arrays import Array


class LoopParameters(NamedTuple):
    """Parameters of one axis in its closed loop: plant, controller gain, reference, wind torque and noises."""

    effect: float
    """Control effectiveness: angular acceleration per unit of demand in steady state, rad/s²."""

    damping: float
    """Rate damping, 1/s."""

    lag: float
    """Motor time constant, s."""

    delay: float
    """Dead time from the controller's output to the motors, s."""

    controller: float
    """Gain of the controller relative to the gain by the logged parameters."""

    synchronous_odds: float
    """Power of the reference that comes in steps synchronous with the messages, over the power that does not."""

    step_time_odds: float
    """Time from a synchronous step to the next message, over the rest of the time between two messages."""

    drift_size: float
    """Standard deviation of the slow first-order wind torque, rad/s²."""

    drift_time: float
    """Correlation time of the slow first-order wind torque, s."""

    eddy_size: float
    """Standard deviation of the quick first-order wind torque, rad/s²."""

    eddy_time: float
    """Correlation time of the quick first-order wind torque, s."""

    gust_size: float
    """Standard deviation of the smooth wind torque, which has a Gaussian autocorrelation, rad/s²."""

    gust_time: float
    """Time of the smooth wind torque, whose autocorrelation is exp(−τ² / 4 gust_time²), s."""

    gyro_noise: float
    """Standard deviation of the white gyro noise before the gyro filters, one value a controller cycle, rad/s."""

    filtered_noise: float
    """Standard deviation of white noise that is added after the gyro filters, rad/s."""

    angle_noise: float
    """Standard deviation of white noise of the estimated angle, rad."""

    actuation: float
    """Standard deviation of the output that does not follow the control law, relative to the whole
    output."""

    @classmethod
    def from_logarithms(cls, theta: Array) -> LoopParameters:
        """Returns the parameters whose natural logarithms are θ (k,)."""
        return cls(*np.exp(theta).tolist())


_PRIOR = tomllib.loads(Path(__file__).with_suffix(".toml").read_text("utf-8"))

PARAMETER_NAMES = LoopParameters._fields
"""Names of the k parameters, in the order of θ."""

TYPICAL_VALUES: dict[str, float] = _PRIOR["typical"]
"""Prior median of each parameter, by name."""

PRIOR_MEAN = np.log([TYPICAL_VALUES[name] for name in PARAMETER_NAMES])
"""Prior mean (k,) of θ."""

PRIOR_SD = np.array([_PRIOR["sd"][name] for name in PARAMETER_NAMES])
"""Prior standard deviation (k,) of θ."""

EFFECT = PARAMETER_NAMES.index("effect")
"""Index of the control effectiveness in θ."""

DAMPING = PARAMETER_NAMES.index("damping")
"""Index of the rate damping in θ."""

LAG = PARAMETER_NAMES.index("lag")
"""Index of the motor time constant in θ."""

DELAY = PARAMETER_NAMES.index("delay")
"""Index of the dead time in θ."""

PLANT = (EFFECT, DAMPING, LAG, DELAY)
"""Indices in θ of the four parameters of the plant."""

CONTROLLER = PARAMETER_NAMES.index("controller")
"""Index of the controller's relative gain in θ."""

LOOP_PARAMETERS = CONTROLLER + 1
"""Number of leading entries of θ that shape the closed loop itself: the plant's, and the controller's gain."""

STEP_TIME = PARAMETER_NAMES.index("step_time_odds")
"""Index in θ of the odds of the time from a synchronous step to the next message."""
