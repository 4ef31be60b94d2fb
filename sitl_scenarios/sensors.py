"""Simulated sensors: the autopilot's state estimate with noise and delay, and the vibration that its gyro measures."""

from collections import deque
from collections.abc import Iterator, Sequence
from math import cos, exp, pi, radians, sin, sqrt

import numpy as np
from numpy.random import Generator

from sitl_scenarios.dynamics import State
from sitl_scenarios.motion import Array
from sitl_scenarios.scenario import SENSORS, SHAKING, Scenario
from sitl_scenarios.vectors import Vector3, normalised, rotated
from sitl_scenarios.vehicles import airframe

FRAME_DAMPING = 0.02
"""Damping ratio of the frame's resonance: frames of carbon and glass fibre have 0.01 to 0.03."""

INITIAL_PHASE_STEP = 1.0
"""Angle between a rotor and the next at boot, rad, so that their vibrations do not add up in phase."""

VIBRATION_BLOCK = 3000
"""Random numbers of the frame's resonance that are drawn at once; a draw of each would be slow."""

ESTIMATE_BLOCK = 1000
"""Cycles whose estimation noise is drawn at once."""


class GyroVibration:
    """Vibration of rotors and frame that the gyro measures on top of the body rates.

    Each rotor shakes once per revolution, by its imbalance, and once per blade passage. The force grows with the square
    of its speed. The frame resonates with little damping, driven by white noise. ``is_felt`` says whether there is any
    vibration.
    """

    def __init__(self, scenario: Scenario, step: float) -> None:
        """Designs the resonance of the frame as a second-order autoregression.

        Args:
            scenario: Scenario with the section ``shaking``, the vehicle and the random seed.
            step: Sampling period, s.
        """
        self._spec = scenario.shaking
        self._step = step
        body = airframe(scenario.vehicle)
        self._hover_speed = body.hover_speed
        self._phases = [INITIAL_PHASE_STEP * rotor for rotor in range(body.rotors)]
        # x(k) = c₁ x(k − 1) + c₂ x(k − 2) + noise, whose poles decay(cos ± j sin)(angle) are the frame's.
        angle = 2 * pi * self._spec.frame * step
        decay = exp(-FRAME_DAMPING * angle)
        self._c1 = 2 * decay * cos(angle)
        self._c2 = -decay * decay
        # Ratio of the variance of the noise to the variance of x (G. E. P. Box and others, Time Series Analysis), which
        # gives x the standard deviation of the scenario.
        difference = (1 - self._c2) ** 2 - self._c1**2
        variance_ratio = (1 + self._c2) * difference / (1 - self._c2)
        self._noise_sd = 0.0
        if self._spec.frame:
            self._noise_sd = self._spec.frame_gyro * sqrt(max(variance_ratio, 0.0))
        self.is_felt = bool(self._spec.gyro or self._noise_sd)
        # Last two samples of the resonance about each of the three axes, rad/s.
        self._resonance = [(0.0, 0.0)] * 3
        self._noise = self._noise_samples(scenario.random(SHAKING))

    def _noise_samples(self, random: Generator) -> Iterator[float]:
        """Yields the white noise that drives the resonance, rad/s, without end."""
        while True:
            block = random.standard_normal(VIBRATION_BLOCK) * self._noise_sd
            yield from block.tolist()

    def sample(self, rotor_speeds: Sequence[float]) -> Vector3:
        """Returns the next sample of the vibration; called once per sampling period.

        The rotors shake all axes alike. The frame has a resonance about each axis: a second-order filter (coefficients
        c1 and c2) that is driven by white noise.

        Args:
            rotor_speeds: Speed of each rotor (n,), rad/s.

        Returns:
            Vibration (3,) about the forward, right and down axes, rad/s.
        """
        rotor_vibration = 0.0
        if self._spec.gyro:
            for rotor, speed in enumerate(rotor_speeds):
                rotor_vibration += self._rotor_sample(rotor, speed)
        if not self._noise_sd:
            return rotor_vibration, rotor_vibration, rotor_vibration
        for axis, (last, second_last) in enumerate(self._resonance):
            frame_vibration = self._c1 * last + self._c2 * second_last + next(self._noise)
            self._resonance[axis] = (frame_vibration, last)
        return tuple(rotor_vibration + frame_vibration for frame_vibration, _ in self._resonance)

    def _rotor_sample(self, rotor: int, speed: float) -> float:
        """Turns a rotor by one sampling period, and returns the vibration that it causes.

        Two sines add up: one at the rotor's frequency, by its imbalance, and one at the frequency of blade passage. The
        amplitude is proportional to the square of the speed, as the centrifugal force is.

        Args:
            rotor: Index of the rotor, from 0.
            speed: Speed of the rotor, rad/s.

        Returns:
            Vibration, rad/s, the same about all three axes.
        """
        spec = self._spec
        angle = self._phases[rotor] + speed * self._step
        phase = angle % (2 * pi)
        self._phases[rotor] = phase
        # ``gyro`` is the amplitude in hover, rad/s; ``balance`` is the imbalance's share of it, from 0 to 1.
        amplitude = spec.gyro * (speed / self._hover_speed) ** 2
        imbalance = spec.balance * sin(phase)
        blade_passage = (1 - spec.balance) * sin(spec.blades * phase)
        waveform = imbalance + blade_passage
        return amplitude * waveform


class StateEstimator:
    """The autopilot's state estimator: its estimate is late, and has noise that is white from cycle to cycle.

    A delay of a fraction of a cycle is made by linear interpolation between two cycles.
    """

    def __init__(self, scenario: Scenario) -> None:
        """Takes the scenario's ``sensors``, cycle and random seed."""
        sensors = scenario.sensors
        delay_cycles = sensors.delay / scenario.cycle
        self._whole_cycles = int(delay_cycles)
        self._cycle_fraction = delay_cycles - self._whole_cycles
        # The true states of the last cycles, oldest first: the delayed state lies between the first two.
        self._states: deque[State] = deque(maxlen=self._whole_cycles + 2)
        # Standard deviations of position, velocity, half of the attitude's angles (as quaternions have them), and
        # rates, three axes each: the order of the twelve numbers of noise.
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
        """Returns the autopilot's estimate of the state in this cycle; called once per cycle.

        The estimate is the true state of some time ago, with white noise on position, velocity, attitude and rates. A
        constant misalignment of the sensors tilts its attitude.

        Args:
            state: True state at the cycle's beginning.

        Returns:
            Estimated state, without rotor speeds and accelerations, which an autopilot does not know.
        """
        if not self._states:
            # Before the first cycle the vehicle was at rest where it is.
            self._states.extend([state] * (self._whole_cycles + 1))
        self._states.append(state)
        older, newer = self._states[0], self._states[1]
        # Linear interpolation: the larger the delay, the nearer the delayed time is to the earlier cycle. It is written
        # out, because a function of each vector would take twice as long.
        older_weight = self._cycle_fraction
        newer_weight = 1.0 - older_weight
        old_north, old_east, old_down = older.position
        new_north, new_east, new_down = newer.position
        old_north_speed, old_east_speed, old_down_speed = older.velocity
        new_north_speed, new_east_speed, new_down_speed = newer.velocity
        old_w, old_x, old_y, old_z = older.attitude
        new_w, new_x, new_y, new_z = newer.attitude
        old_p, old_q, old_r = older.rates
        new_p, new_q, new_r = newer.rates
        (
            north_noise, east_noise, down_noise,
            north_speed_noise, east_speed_noise, down_speed_noise,
            roll_noise, pitch_noise, yaw_noise,
            p_noise, q_noise, r_noise,
        ) = next(self._noise)  # fmt: skip
        half_roll, half_pitch = self._misalignment_half_angles
        attitude = (
            newer_weight * new_w + older_weight * old_w,
            newer_weight * new_x + older_weight * old_x,
            newer_weight * new_y + older_weight * old_y,
            newer_weight * new_z + older_weight * old_z,
        )
        half_angles = (half_roll + roll_noise, half_pitch + pitch_noise, yaw_noise)
        return State(
            (
                newer_weight * new_north + older_weight * old_north + north_noise,
                newer_weight * new_east + older_weight * old_east + east_noise,
                newer_weight * new_down + older_weight * old_down + down_noise,
            ),
            (
                newer_weight * new_north_speed + older_weight * old_north_speed + north_speed_noise,
                newer_weight * new_east_speed + older_weight * old_east_speed + east_speed_noise,
                newer_weight * new_down_speed + older_weight * old_down_speed + down_speed_noise,
            ),
            normalised(rotated(attitude, half_angles)),
            (
                newer_weight * new_p + older_weight * old_p + p_noise,
                newer_weight * new_q + older_weight * old_q + q_noise,
                newer_weight * new_r + older_weight * old_r + r_noise,
            ),
        )
