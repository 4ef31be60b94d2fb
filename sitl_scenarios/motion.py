"""Motion: states, inputs and disturbances of a simulated flight, row by row; and whether it held its place."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from mavdem.facts import Fact, Level
from mavdem.facts.scenarios import Scenarios
from mavdem.ingest.vocabulary import IN_AIR
from sitl_scenarios.dynamics import IDLE_COMMAND, pulse
from sitl_scenarios.scenario import Course, Scenario, Steps

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Motion:
    """Rows of a simulated flight, one each cycle of the autopilot.

    North-east-down (NED) with the origin where the vehicle stands at first; body axes forward, right, down (FRD).
    """

    time: Array  # (N,) seconds since the autopilot's boot
    position: Array  # with velocity: (N, 3) NED, m and m/s
    velocity: Array
    attitude: Array  # (N, 4) unit quaternions (w, x, y, z) from body to NED
    rates: Array  # (N, 3) body rates p, q, r, rad/s
    # The autopilot's estimates of them, with noise and delay; shapes and units likewise.
    known_attitude: Array
    known_rates: Array
    gyro: Array  # (N, 3) body rates before the gyro's filters, with what shakes it, rad/s
    known_position: Array
    known_velocity: Array
    # (N, 4) motor commands as the autopilot puts them out, PWM in µs, quantised as it does
    outputs: Array
    # (N, 4) what it asked the mixer for: roll, pitch, yaw (−1 to 1) and thrust (0 to 1)
    demands: Array
    # Setpoints of the autopilot's loops, zero on the ground: (N, 3) roll, pitch and yaw, rad; body rates, rad/s.
    attitude_setpoint: Array
    rates_setpoint: Array
    # (N, 3) what a pilot's sticks ask for: roll, pitch (rad) and yaw rate (rad/s); zero without a pilot
    sticks: Array
    rotor_speeds: Array  # (N, 4) rad/s
    # (N,) share of the voltage of a charged battery, and of the rotors' speed with it, that is left
    battery: Array
    wind: Array  # (N, 3) NED, m/s, at the vehicle, where the air moves *to*
    # force (N, 3) NED, N, and moment (N, 3) body, N m, of the wind and whatever else disturbs; without rotors'
    # thrust and torque in still air, and without gravity. The air's drag and damping of roll and pitch are in them.
    # Zero on the ground.
    force: Array
    moment: Array
    armed: NDArray[np.bool_]  # (N,) bool
    # (N,) MAV_LANDED_STATE: 1 on the ground, 2 in the air, 3 taking off, 4 landing
    landed_state: NDArray[np.uint8]

    def __len__(self) -> int:
        return len(self.time)


def joined(pieces: Sequence[Motion]) -> Motion:
    """Returns one motion, of pieces that follow each other."""
    columns = ([getattr(piece, field.name) for piece in pieces] for field in fields(Motion))
    return Motion(*map(np.concatenate, columns))


# m from where it is asked to be: more than any gust of the scenarios here pushes a vehicle
MAX_OFFSET_METRES = 5.0


class Holding:
    """Follows a flight, block of rows after block of rows.

    ``farthest``: m from its place in hover. ``at_limit``: share of the rows in the air at which a motor could not do
    more, or not less.
    """

    def __init__(self, scenario: Scenario) -> None:
        # On its way from one end of a sideways step or a leg to the other it is where it should be.
        places = [(0.0, 0.0, 0.0)]
        if isinstance(scenario.excitation, Steps):
            places.append((0.0, scenario.excitation.distance, 0.0))
        elif isinstance(scenario.excitation, Course):
            moves = [(one.north, one.east, -one.up) for one in scenario.excitation.moves]
            places += np.cumsum(moves, axis=0).tolist()
        hover = np.array([0.0, 0.0, scenario.height])
        self._box = np.array([np.min(places, axis=0), np.max(places, axis=0)]) - hover
        self._stop = pulse(scenario.vehicle.stop)
        self._rows = self._limited = 0
        self.farthest = self.at_limit = 0.0

    def add(self, motion: Motion) -> None:
        """The next rows."""
        flying = motion.armed & (motion.landed_state >= IN_AIR)
        limited = (motion.outputs >= self._stop) | (motion.outputs <= pulse(IDLE_COMMAND))
        self._rows += int(np.count_nonzero(flying))
        self._limited += int(np.count_nonzero(limited[flying].any(axis=1)))
        self.at_limit = self._limited / max(self._rows, 1)
        hovering = motion.position[motion.armed & (motion.landed_state == IN_AIR)]
        off = np.linalg.norm(hovering - np.clip(hovering, *self._box), axis=1)
        self.farthest = max(self.farthest, float(off.max(initial=0.0)))

    def cautions(self) -> list[Fact]:
        """What was wrong with the flight."""
        found = list[Fact]()
        if self.farthest > MAX_OFFSET_METRES:
            found.append(Fact(Scenarios.PLACE_NOT_HELD, Level.WATCH, distance=self.farthest))
        if self.at_limit > 0.1:
            found.append(Fact(Scenarios.MOTORS_AT_LIMITS, Level.WATCH, share=self.at_limit))
        return found
