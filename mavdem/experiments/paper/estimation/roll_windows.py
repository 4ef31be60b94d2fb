"""Windows of roll flights with a known model, in which observers estimate hidden states or inputs.

The model is the roll axis of the AR.Drone as Bos et al. publish it with their flights, without damping:

    φ̈ = b (v₁ − v₂ − v₃ + v₄)

with the roll φ and the motor commands v. In discrete time, with inputs that are held over a sampling step, it is
x⁺ = Φ x + Γ v + w, where the process noise w is what the model does not explain: wind, damping and motor lag.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.random import default_rng
from scipy.ndimage import gaussian_filter1d

from mavdem.arrays import Array, ArrayPair
from mavdem.dem.engine.model import discretize
from mavdem.experiments.paper.flights import ARDRONE_RATE
from mavdem.flight import Flight

ROLL_EFFECTIVENESS = 0.37483766
"""rad/s² of roll acceleration per unit of a motor command (PWM), from the models in the published flights' files."""

ROLL_MIXER = np.array([1.0, -1.0, -1.0, 1.0])
"""Sign of each motor's effect on the roll acceleration."""

ROLL_SYSTEM_MATRIX = np.array([[0.0, 1.0], [0.0, 0.0]])
"""A of the states roll (rad) and roll rate (rad/s), 1/s."""

FIRST_SAMPLE = 399
"""First sample of a flight that is used, counted from 0, as in the authors' scripts."""

WINDOW_SAMPLES = 240
"""Samples of one window of state estimation, 2 s, as in the authors' scripts."""

WINDOWS_PER_FLIGHT = 5
"""Windows of one flight, as in the authors' scripts, which use the 1,200 samples after the first one."""

TRIM = 10
"""Samples that are left out of the errors at each end of a window, as in the authors' scripts."""

WITH_WIND = "with wind"
WITHOUT_WIND = "without wind"
"""Names of the two groups of recorded flights."""

WITHOUT_WIND_SUFFIX = "WM_0"
"""End of the names of the published flights without blower; those with it end in ``WM_1`` or ``WM_2``.

The files' wind speed does not distinguish them: it reads 1.5 m/s in one flight without blower, 0.25 m/s in one with it.
"""


@dataclass(frozen=True, eq=False)
class RollWindow:
    """A window of one flight: its states, its inputs, and the model that observers use."""

    flight: str
    """Name of the flight."""

    states: Array
    """(T, 2) roll (rad) and roll rate (rad/s), measured or, of a simulated flight, true."""

    outputs: Array
    """(T, 1) measured roll, rad: all that observers of the states see."""

    inputs: Array
    """(T, 4) motor commands less their means, in units of their range in the window."""

    B: Array
    """(2, 4) input matrix for these units."""

    dt: float = 1 / ARDRONE_RATE
    """Sampling step, s."""

    @cached_property
    def transition(self) -> ArrayPair:
        """Φ (2, 2) and Γ (2, 4) of one sampling step, over which the inputs are held."""
        return zero_order_hold_transition(self.B, self.dt)

    @cached_property
    def process_noise(self) -> Array:
        """(T, 2) process noise: the states less what the model predicts from the sample before; 0 at the first sample.

        It is computed from the roll rate, which is hidden from the observers. In this way Bos et al. determine the
        covariance that all of their observers use.
        """
        Phi, Gamma = self.transition
        noise = np.zeros_like(self.states)
        noise[1:] = self.states[1:] - self.states[:-1] @ Phi.T - self.inputs[:-1] @ Gamma.T
        return noise


def input_matrix(acceleration_per_input: Array) -> Array:
    """Returns B (2, r) for the roll acceleration (r,) that one unit of each input makes, rad/s²."""
    return np.vstack([np.zeros_like(acceleration_per_input), acceleration_per_input])


def zero_order_hold_transition(B: Array, dt: float) -> ArrayPair:
    """Discretises the roll axis for inputs that are held over a step of ``dt`` seconds.

    Args:
        B: (2, r) input matrix.
        dt: sampling step, s.

    Returns:
        Φ (2, 2) and Γ (2, r).
    """
    transition = discretize(ROLL_SYSTEM_MATRIX, B, dt)
    return transition.Phi, transition.Gamma0 + transition.Gamma1


def wind_of_flight(flight: str) -> str:
    """Returns whether a published flight was flown with blower, by its name: ``WITH_WIND`` or ``WITHOUT_WIND``."""
    if flight.endswith(WITHOUT_WIND_SUFFIX):
        return WITHOUT_WIND
    return WITH_WIND


def flight_windows(
    flights: Mapping[str, Flight], samples: int = WINDOW_SAMPLES, count: int = WINDOWS_PER_FLIGHT
) -> list[RollWindow]:
    """Cuts recorded flights into windows that follow each other, from ``FIRST_SAMPLE`` on.

    Args:
        flights: flights of the AR.Drone by name, with four motors as inputs, and roll and roll rate as outputs.
        samples: number of samples in a window.
        count: largest number of windows in a flight; a short flight has fewer.

    Returns:
        The windows, flight by flight. One with a signal that is constant or not finite is left out.
    """
    windows = []
    for name, flight in flights.items():
        for number in range(count):
            first_sample = FIRST_SAMPLE + number * samples
            states = np.asarray(flight.outputs[first_sample : first_sample + samples], float)
            motors = np.asarray(flight.inputs[first_sample : first_sample + samples], float)
            if len(states) == samples and is_moving(states) and is_moving(motors):
                # A recorded flight has one measurement of roll, which is also taken for its true state.
                measured_roll = states[:, :1]
                windows.append(roll_window(name, states, measured_roll, motors, float(flight.dt)))
    return windows


def missing_flights_sentence(flights: Mapping[str, Flight]) -> str:
    """Returns the sentence on why a report has no windows of recorded flights: none are given, or none is usable."""
    if flights:
        return f"None of the {len(flights)} recorded flights has a whole window in which it moves."
    return "Recorded flights are left out: --flights names their folder."


def is_moving(signals: Array) -> bool:
    """Returns whether all signals (T, channels) are finite and change: a tracker that has lost the vehicle repeats."""
    spans = np.ptp(signals, axis=0)
    return bool(np.isfinite(spans).all() and (spans > 0).all())


def roll_window(
    flight: str, states: Array, outputs: Array, motors: Array, dt: float = 1 / ARDRONE_RATE
) -> RollWindow:
    """Makes a window whose inputs are the motor commands in units of their range, without their means.

    The input matrix is scaled likewise, so that the model stays the same.

    Args:
        flight: name of the flight.
        states: (T, 2) roll and roll rate, rad and rad/s.
        outputs: (T, 1) measured roll, rad.
        motors: (T, 4) motor commands.
        dt: sampling step, s.

    Returns:
        The window.
    """
    # Range of all commands together, from the lowest to the highest.
    command_range = np.ptp(motors)
    inputs = motors / command_range
    acceleration_per_input = ROLL_EFFECTIVENESS * command_range * ROLL_MIXER
    return RollWindow(
        flight,
        states,
        outputs,
        inputs - inputs.mean(axis=0),
        B=input_matrix(acceleration_per_input),
        dt=dt,
    )


NOISE_SD = np.array([5e-4, 0.06])
"""Standard deviations of the simulated process noise of roll (rad) and roll rate (rad/s) in one sample.

In the published flights with blower they are 5e-4 to 1.5e-3 rad and 0.05 to 0.075 rad/s.
"""

SIMULATED_SMOOTHNESS = {"white noise": 0.0, "s = 0.006 s": 0.006, "s = 0.02 s": 0.02}
"""Width s of the simulated process noise's kernel, seconds, by its name; DEM assumes 0.006 s throughout.

Neighbouring samples of such noise correlate by 0, 0.62 and 0.96; of the flights' noise by 0.4 to 0.6 without blower,
and by 0.7 to 0.9 with it.
"""

MEASUREMENT_VARIANCE = 8.1214e-9
"""rad², variance of the measured roll, a constant of the authors' scripts, which they measured in experiment 25."""

ROLL_STIFFNESS = 60.0
"""1/s², feedback of the roll by the simulated controller: a natural frequency of 1.2 Hz; a choice."""

ROLL_DAMPING = 8.0
"""1/s, feedback of the roll rate by the simulated controller: a damping ratio of 0.5; a choice."""

DITHER_SD = 8.0
"""Standard deviation of each simulated motor's own movements, units of a command, as of the published flights."""

DITHER_SAMPLES = 6
"""Samples over which those movements are smooth; a choice."""

SETTLING_SAMPLES = 240
"""Simulated samples before the window, in which the roll forgets its first value; a choice."""


def simulated_window(seed: int, smoothness: float, samples: int = WINDOW_SAMPLES) -> RollWindow:
    """Simulates a roll axis with a controller, which follows the model exactly except for process noise.

    Observers get the roll with white measurement noise of ``MEASUREMENT_VARIANCE``. The true states are known, unlike
    those of a recorded flight.

    Args:
        seed: seed of all noises.
        smoothness: width of the Gaussian kernel of the process noise, s; 0 for white noise.
        samples: number of samples of the window.

    Returns:
        The window, without the time in which the simulation settles.
    """
    rng = default_rng(seed)
    dt = 1 / ARDRONE_RATE
    total_samples = SETTLING_SAMPLES + samples
    noise = smooth_noise(rng.standard_normal((total_samples, 2)), smoothness / dt) * NOISE_SD
    dither = rng.standard_normal((total_samples, len(ROLL_MIXER)))
    dither = DITHER_SD * smooth_noise(dither, DITHER_SAMPLES)
    acceleration_per_command = ROLL_EFFECTIVENESS * ROLL_MIXER
    Phi, Gamma = zero_order_hold_transition(input_matrix(acceleration_per_command), dt)
    states = np.zeros((total_samples + 1, 2))
    motors = np.zeros((total_samples, len(ROLL_MIXER)))
    for t in range(total_samples):
        acceleration = -ROLL_STIFFNESS * states[t, 0] - ROLL_DAMPING * states[t, 1]
        # The four motors share the acceleration that the controller demands.
        motors[t] = dither[t] + acceleration / (len(ROLL_MIXER) * acceleration_per_command)
        states[t + 1] = Phi @ states[t] + Gamma @ motors[t] + noise[t]
    window = slice(SETTLING_SAMPLES, total_samples)
    measurement_noise = np.sqrt(MEASUREMENT_VARIANCE) * rng.standard_normal((samples, 1))
    return roll_window(
        f"simulated {seed}",
        states[window],
        states[window, :1] + measurement_noise,
        motors[window],
    )


def smooth_noise(white_noise: Array, kernel_samples: float) -> Array:
    """Filters white noise by a Gaussian kernel, and scales it to its former variance.

    The autocorrelation of the result is exp(−τ²/4s²), as of DEM's noise with the smoothness s.

    Args:
        white_noise: (T,) or (T, channels) samples.
        kernel_samples: width s of the kernel in samples; 0 leaves the noise white.

    Returns:
        Filtered noise, in the shape (T,) or (T, channels) of the white noise.
    """
    if kernel_samples == 0:
        return white_noise
    smoothed_noise = gaussian_filter1d(white_noise, kernel_samples, axis=0, mode="wrap")
    # The variance of filtered white noise is the sum of the squared weights of the kernel.
    impulse = np.zeros(len(white_noise))
    impulse[0] = 1.0
    kernel = gaussian_filter1d(impulse, kernel_samples, mode="wrap")
    return smoothed_noise / np.sqrt((kernel**2).sum())
