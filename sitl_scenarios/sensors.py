"""Sensors: the autopilot's estimates of the motion, with noise and delay, and the vibration that its gyro measures."""

from collections import deque
from collections.abc import Iterator
from math import cos, exp, pi, radians, sin, sqrt
from operator import add

import numpy as np
from numpy.random import Generator

from sitl_scenarios.dynamics import State
from sitl_scenarios.motion import Array
from sitl_scenarios.scenario import SENSORS, SHAKING, Scenario
from sitl_scenarios.vectors import Vector3, Vector4, normalised, rotated
from sitl_scenarios.vehicles import airframe

FRAME_DAMPING = 0.02
"""Damping ratio of the frame's resonance: frames of carbon and glass fibre have 0.01 to 0.03."""

INITIAL_ROTOR_PHASES = (0.0, 1.0, 2.0, 3.0)
"""Angles of the four rotors at boot, rad: different ones, so that their vibrations do not add up in phase."""

VIBRATION_BLOCK = 3000
"""Random numbers of the frame's resonance that are drawn at once; a draw of each would be slow."""

ESTIMATE_BLOCK = 1000
"""Cycles whose estimation noise is drawn at once."""


class GyroVibration:
    """Vibration of rotors and frame that the gyro measures on top of the body rates.

    Each rotor shakes once per revolution, by its imbalance, and once per blade passage. The force grows with the square
    of its speed. The frame resonates with little damping, driven by white noise.
    """

    def __init__(self, scenario: Scenario, step: float) -> None:
        """Takes the scenario's ``shaking`` and random seed, and the sampling period ``step``, s."""
        self._spec = scenario.shaking
        self._step = step
        self._hover_speed = airframe(scenario.vehicle).hover_speed
        self._phases = list(INITIAL_ROTOR_PHASES)
        # The resonance is an autoregression of second order, x(k) = c₁ x(k − 1) + c₂ x(k − 2) + noise.
        angle = 2 * pi * self._spec.frame * step
        decay = exp(-FRAME_DAMPING * angle)
        self._c1 = 2 * decay * cos(angle)
        self._c2 = -decay * decay
        # Variance of its noise by its own variance (G. E. P. Box and others, Time Series Analysis).
        difference = (1 - self._c2) ** 2 - self._c1**2
        variance_ratio = (1 + self._c2) * difference / (1 - self._c2)
        self._noise_sd = 0.0
        if self._spec.frame:
            self._noise_sd = self._spec.frame_gyro * sqrt(max(variance_ratio, 0.0))
        # Last two samples of the resonance about each of the three axes, rad/s.
        self._resonance = [(0.0, 0.0)] * 3
        self._noise = self._noise_samples(scenario.random(SHAKING))

    def _noise_samples(self, random: Generator) -> Iterator[float]:
        """Yields the white noise that drives the resonance, rad/s, without end."""
        while True:
            block = random.standard_normal(VIBRATION_BLOCK) * self._noise_sd
            yield from block.tolist()

    def sample(self, rotor_speeds: Vector4) -> Vector3:
        """Returns the vibration about the three axes, rad/s; called once per step, with rotor speeds in rad/s."""
        rotor_vibration = 0.0
        if self._spec.gyro:
            for rotor, speed in enumerate(rotor_speeds):
                rotor_vibration += self._rotor_sample(rotor, speed)
        if not self._noise_sd:
            return rotor_vibration, rotor_vibration, rotor_vibration
        for axis, (last, second_last) in enumerate(self._resonance):
            current = self._c1 * last + self._c2 * second_last + next(self._noise)
            self._resonance[axis] = (current, last)
        return tuple(rotor_vibration + current for current, _ in self._resonance)

    def _rotor_sample(self, rotor: int, speed: float) -> float:
        """Turns a rotor by one step at a ``speed``, rad/s; returns its vibration about each axis, rad/s."""
        spec = self._spec
        angle = self._phases[rotor] + speed * self._step
        phase = angle % (2 * pi)
        self._phases[rotor] = phase
        amplitude = spec.gyro * (speed / self._hover_speed) ** 2
        imbalance = spec.balance * sin(phase)
        blade_passage = (1 - spec.balance) * sin(spec.blades * phase)
        waveform = imbalance + blade_passage
        return amplitude * waveform


class StateEstimator:
    """The autopilot's estimator: it knows the state with a delay, and with noise that is white from cycle to cycle.

    A delay of a fraction of a cycle is made by linear interpolation between two cycles.
    """

    def __init__(self, scenario: Scenario) -> None:
        """Takes the scenario's ``sensors``, cycle and random seed."""
        sensors = scenario.sensors
        delay_cycles = sensors.delay / scenario.cycle
        self._whole_cycles = int(delay_cycles)
        self._cycle_fraction = delay_cycles - self._whole_cycles
        # The states of the last cycles, oldest first: the delayed state lies between the first two.
        self._states: deque[State] = deque(maxlen=self._whole_cycles + 2)
        # Standard deviations of position, velocity, half of the attitude's angles, and rates, three axes each.
        sds = (sensors.position_sd, sensors.velocity_sd, sensors.attitude_sd / 2, sensors.rate_sd)
        self._noise = self._noise_rows(scenario.random(SENSORS), np.repeat(sds, 3))
        roll, pitch = sensors.misalignment
        self._misalignment_half_angles = radians(roll) / 2, radians(pitch) / 2

    @staticmethod
    def _noise_rows(random: Generator, sds: Array) -> Iterator[list[float]]:
        """Yields the noise of one cycle after another, twelve numbers each, of standard deviations ``sds`` (12,)."""
        while True:
            block = random.standard_normal((ESTIMATE_BLOCK, len(sds))) * sds
            yield from block.tolist()

    def estimate(self, state: State) -> State:
        """Returns the estimate of position, velocity, attitude and rates in this cycle; called once per cycle.

        Args:
            state: True state at the cycle's beginning. The estimate has no rotor speeds and no accelerations.
        """
        if not self._states:
            # Before the first cycle the vehicle was at rest where it is.
            self._states.extend([state] * (self._whole_cycles + 1))
        self._states.append(state)
        older, newer = self._states[0], self._states[1]
        noise = next(self._noise)
        half_roll, half_pitch = self._misalignment_half_angles
        half_angles = (half_roll + noise[6], half_pitch + noise[7], noise[8])
        w, x, y, z = self._interpolated(older.attitude, newer.attitude)
        position = self._interpolated(older.position, newer.position)
        velocity = self._interpolated(older.velocity, newer.velocity)
        rates = self._interpolated(older.rates, newer.rates)
        return State(
            tuple(map(add, position, noise[0:3])),
            tuple(map(add, velocity, noise[3:6])),
            normalised(rotated((w, x, y, z), half_angles)),
            tuple(map(add, rates, noise[9:12])),
        )

    def _interpolated(self, older: tuple[float, ...], newer: tuple[float, ...]) -> list[float]:
        """Returns the values at the delayed time, between those of two neighbouring cycles."""
        older_weight = self._cycle_fraction
        newer_weight = 1.0 - self._cycle_fraction
        return [
            newer_weight * newer_value + older_weight * older_value
            for older_value, newer_value in zip(older, newer, strict=True)
        ]
