"""Sensors: the autopilot's estimates of the motion, with noise and delay, and what rotors and frame add."""

from collections import deque
from itertools import chain, count
from math import cos, exp, pi, radians, sin, sqrt
from operator import add

import numpy as np

from sitl_scenarios.dynamics import Four, State, Three, turned, unit
from sitl_scenarios.scenario import SENSORS, SHAKING, Scenario
from sitl_scenarios.vehicles import airframe

FRAME_DAMPING = 0.02  # damping ratio of a frame: of carbon and glass fibre 0.01 to 0.03


class RotorNoise:
    """What whole rotors and the frame add to the gyro before its filters, in steps of ``step`` s.

    Each rotor shakes once a turn and once a blade, by a force that grows with the square of its speed; the frame
    resonates lightly damped, driven by white noise.
    """

    def __init__(self, scenario: Scenario, step: float) -> None:
        self._spec = spec = scenario.shaking
        self._step = step
        self._hover = airframe(scenario.vehicle).hover_speed
        self._phases = [0.0, 1.0, 2.0, 3.0]
        turn = 2 * pi * spec.frame * step
        keeps = exp(-FRAME_DAMPING * turn)
        self._keeps = 2 * keeps * cos(turn), -keeps * keeps
        # of the autoregression of second order, by its driving noise (G. E. P. Box and others, Time Series Analysis)
        first, second = self._keeps
        difference = (1 - second) ** 2 - first**2
        gain = (1 + second) * difference / (1 - second)
        self._drive = spec.frame_gyro * sqrt(max(gain, 0.0)) if spec.frame else 0.0
        self._frame = [(0.0, 0.0)] * 3
        noise = scenario.random(SHAKING)
        blocks = (noise.standard_normal(3000) * self._drive for _ in count())
        self._noise = chain.from_iterable(block.tolist() for block in blocks)

    def at(self, rotors: Four) -> Three:
        """Returns what the gyro feels beside the rates, rad/s; called once a step, ``rotors`` at rad/s."""
        spec = self._spec
        total = 0.0
        for number, speed in enumerate(rotors if spec.gyro else ()):
            angle = self._phases[number] + speed * self._step
            phase = self._phases[number] = angle % (2 * pi)
            size = spec.gyro * (speed / self._hover) ** 2
            by_turn = spec.balance * sin(phase)
            by_blade = (1 - spec.balance) * sin(spec.blades * phase)
            turning = by_turn + by_blade
            total += size * turning
        if not self._drive:
            return total, total, total
        first, second = self._keeps
        self._frame = [
            (first * now + second * before + next(self._noise), now) for now, before in self._frame
        ]
        return tuple(total + now for now, _ in self._frame)


class Sensing:
    """The way from states to what is known: an exact delay, between cycles, and noise, white from cycle to cycle."""

    def __init__(self, scenario: Scenario) -> None:
        sensors = scenario.sensors
        noise = scenario.random(SENSORS)
        late = sensors.delay / scenario.cycle
        self._whole = int(late)
        self._share = late - self._whole
        self._seen: deque[State] = deque(maxlen=self._whole + 2)
        sds = (sensors.position_sd, sensors.velocity_sd, sensors.attitude_sd / 2, sensors.rate_sd)
        spread = np.repeat(sds, 3)
        blocks = (noise.standard_normal((1000, 12)) * spread for _ in count())
        self._noise = chain.from_iterable(block.tolist() for block in blocks)
        roll, pitch = sensors.misalignment
        self._mounted = radians(roll) / 2, radians(pitch) / 2

    def estimate(self, state: State) -> State:
        """Returns what is known, not of the rotors, in ``state``; one call each cycle."""
        self._seen.extend([state] * (1 if self._seen else self._whole + 2))
        old, new, *_ = self._seen
        kept = 1.0 - self._share
        position, velocity, (a, b, c, d), rates = (
            [kept * now + self._share * before for now, before in zip(*pair, strict=True)]
            for pair in zip(new[:4], old[:4], strict=True)
        )
        noise = next(self._noise)
        mx, my = self._mounted
        tilt = (mx + noise[6], my + noise[7], noise[8])
        attitude = unit(turned((a, b, c, d), tilt))
        return State(
            tuple(map(add, position, noise[:3])),
            tuple(map(add, velocity, noise[3:6])),
            attitude,
            tuple(map(add, rates, noise[9:])),
        )
