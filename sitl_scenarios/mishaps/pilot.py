"""Pilot and failsafe of a simulated mishap: flight mode, throttle stick and motor outputs that differ from the plan.

A pilot flies in a mode without control of the position; the attitude is held level meanwhile.
"""

from dataclasses import dataclass
from math import pi, radians, sin, sqrt

from sitl_scenarios.controller import ControlOutput, FlightController
from sitl_scenarios.dynamics import State
from sitl_scenarios.gyro import NO_ROTATION
from sitl_scenarios.mishaps.specs import (
    BenchRun,
    Dive,
    FailsafeDisarm,
    Flip,
    GpsLoss,
    Mishap,
    ThrottleCut,
    ToppleAtLanding,
)
from sitl_scenarios.plan import LANDING, Reference
from sitl_scenarios.rotors import IDLE_COMMAND, pulse_width
from sitl_scenarios.vectors import euler_angles
from sitl_scenarios.vehicles import GRAVITY, Airframe

MODES = ("plan", "stabilize", "flip", "land")
"""Flight modes: the flight plan's, and the modes in which pilot or failsafe fly."""

PILOT_SECONDS = 4.0
"""Time for which a pilot flies by hand before closing the throttle, s; a choice."""

MIDDLE_STICK = 0.5
"""Throttle stick in modes that hold the height, 0 to 1."""

LOST_STICK = -0.05
"""Throttle stick that a receiver reports without a link, 0 to 1: 950 µs, below ArduPilot's FS_THR_VALUE of 975."""

RADIO_SECONDS = 1.5
"""Time from the loss of the radio to the failsafe, s: ArduPilot's FS_THR_ENABLE acts after 0.5 to 1.5 s."""

DIVE_THRUST = 0.12
"""Thrust by the weight while the throttle is closed and the attitude still controlled; a choice."""

CATCH_THRUST = 1.7
"""Thrust by the weight with which a pilot ends a fall; a choice."""

CAUGHT_SPEED = 0.5
"""Speed downwards, m/s, at which a fall counts as ended."""

FLIP_RATE = radians(400)
"""Rate of a flip, rad/s: FLIP_ROTATION_RATE of ArduCopter's mode_flip.cpp."""

FLIP_CLIMB_SECONDS = 0.4
"""Time of climb before a flip, s; a choice."""

FLIP_CLIMB_THRUST = 1.6
"""Thrust by the weight in that climb; a choice."""

FLIP_THRUST = 0.35
"""Thrust by the weight until the vehicle is on its back; a choice."""

FLIP_BRAKING_THRUST = 0.9
"""Thrust by the weight after that: without thrust a mixer has no room to end the rotation; a choice."""

FLIP_BRAKING = 12.0
"""Angular acceleration with which the rotation ends, rad/s²: what the largest frame has at that thrust."""

FLIP_END = radians(345)
"""Roll, rad, from which on the attitude is controlled again."""

BLIND_DESCENT = 0.8
"""Speed downwards of a landing without a position, m/s: between both autopilots' defaults."""

BENCH_RUN_SECONDS = 12.0
"""Time of one run of the motors on a bench, from idle to idle, s; a choice."""

BENCH_STICK_TILT = radians(12)
"""Roll and pitch that the pilot commands on a bench, rad; a choice."""

BENCH_ROLL_PERIOD, BENCH_PITCH_PERIOD = 3.1, 4.3
"""Periods of the roll and the pitch stick on a bench, s: without a common multiple in a run; choices."""

DESCENT_STICK = 0.8
"""Throttle stick of a slow descent by hand, as a fraction of that in hover; a choice."""


@dataclass
class Pilot:
    """Pilot or failsafe that takes over from the flight plan in a mishap, with mode, throttle and control by cycle."""

    mishap: Mishap | None
    """What goes wrong; None: the plan is flown."""
    controller: FlightController
    """The autopilot's controller."""
    body: Airframe
    """The vehicle, whose weight sets the thrusts."""
    cycle: float
    """Period of the autopilot's loop, s."""
    mode: str = "plan"
    """Flight mode in this cycle, one of ``MODES``."""
    throttle_stick: float = MIDDLE_STICK
    """Throttle stick in this cycle, 0 to 1."""
    rolled: float = 0.0
    """How far a flip has rolled, rad."""
    has_ended_manoeuvre: bool = False
    """Whether a dive or a flip is over, so that the plan is flown again."""
    blind_height: float | None = None
    """Height setpoint in a landing without a position, m."""

    @property
    def hover_stick(self) -> float:
        """Throttle stick with which a vehicle hovers in a mode that does not hold its height."""
        return self.body.command_for(self.body.hover_speed) / self.body.full_command

    def reference(self, time: float, estimate: State, planned: Reference) -> Reference:
        """Returns the setpoints that are flown: the plan's, except in a landing without a position.

        It is called first in each cycle, and sets ``mode`` and ``throttle_stick`` to suit these setpoints;
        :meth:`control` may then change them.

        Args:
            time: Seconds after arming.
            estimate: State as the autopilot estimates it.
            planned: Setpoints of the flight plan.

        Returns:
            The setpoints.
        """
        self.throttle_stick = MIDDLE_STICK
        mishap = self.mishap
        lands_without_position = (
            isinstance(mishap, GpsLoss) and time >= mishap.start + mishap.failsafe
        )
        if lands_without_position:
            self.mode = "land"
            return self._landing_without_position(estimate)
        self.mode = "plan"
        return planned

    def _landing_without_position(self, estimate: State) -> Reference:
        """Returns the setpoints of a level vehicle that descends steadily, without control of its position.

        Args:
            estimate: State as the autopilot estimates it. The descent begins at its height in the first cycle.
        """
        north, east, down = estimate.position
        north_speed, east_speed, _ = estimate.velocity
        if self.blind_height is None:
            self.blind_height = -down
        self.blind_height -= BLIND_DESCENT * self.cycle
        # With the estimated position and speed as setpoints there is no error, so that the vehicle stays level.
        return Reference(
            LANDING,
            height=self.blind_height,
            climb_rate=-BLIND_DESCENT,
            north=north,
            east=east,
            velocity=(north_speed, east_speed),
        )

    def control(self, time: float, estimate: State, reference: Reference) -> ControlOutput | None:
        """Returns the output of the pilot or the failsafe, if one of them flies, and sets mode and throttle stick.

        Args:
            time: Seconds after arming.
            estimate: State as the autopilot estimates it.
            reference: Setpoints of this cycle, as :meth:`reference` returned them.

        Returns:
            The output; None if the plan is flown.
        """
        match self.mishap:
            case ThrottleCut(start=start) if time >= start - PILOT_SECONDS:
                return self._cut_throttle(start, time)
            case Dive(start=start) if (
                start - PILOT_SECONDS <= time and not self.has_ended_manoeuvre
            ):
                return self._dive(self.mishap, time, estimate)
            case Flip(start=start) if time >= start and not self.has_ended_manoeuvre:
                return self._flip(time - start, estimate)
            case BenchRun() if time >= 0:
                return self._run_on_bench(self.mishap, time, estimate)
            case FailsafeDisarm(start=start, cause="radio") if time >= start - RADIO_SECONDS:
                self.throttle_stick = LOST_STICK
            case ToppleAtLanding():
                self.mode = "stabilize"
                self.throttle_stick = self.hover_stick
                if reference.landed_state == LANDING:
                    self.throttle_stick = DESCENT_STICK * self.hover_stick
        return None

    def set_disarmed_stick(self, time: float) -> None:
        """Leaves the throttle as it is while the vehicle is disarmed: closed by hand, or lost with the radio."""
        match self.mishap:
            case FailsafeDisarm(start=start, cause="radio") if time >= start - RADIO_SECONDS:
                self.throttle_stick = LOST_STICK
            case ThrottleCut() | ToppleAtLanding() | BenchRun():
                self.throttle_stick = 0.0

    def idle(self) -> ControlOutput:
        """Returns the output of motors that idle, without control of the attitude."""
        idle_pulse = pulse_width(IDLE_COMMAND)
        return ControlOutput((idle_pulse,) * self.body.rotors, (*NO_ROTATION, IDLE_COMMAND))

    def _level(self, estimate: State, thrust: float) -> ControlOutput:
        """Computes the output that holds the vehicle level, with its present heading, at a given thrust.

        Args:
            estimate: State as the autopilot estimates it.
            thrust: Thrust of all rotors, as a multiple of the weight.

        Returns:
            Pulse widths of the motors, µs, and the demands and setpoints that led to them.
        """
        _, _, yaw = euler_angles(estimate.attitude)
        return self.controller.attitude_control(
            estimate,
            (0.0, 0.0, yaw),
            NO_ROTATION,
            thrust * self.body.mass * GRAVITY,
            is_flying=True,
        )

    def _cut_throttle(self, start: float, time: float) -> ControlOutput | None:
        """Flies by hand until the pilot closes the throttle in the air; then the motors idle, and the vehicle falls.

        Args:
            start: Time when the throttle is closed, s after arming.
            time: Seconds after arming.

        Returns:
            The output of idling motors; None before, while the plan's controller still flies.
        """
        self.mode = "stabilize"
        self.throttle_stick = self.hover_stick
        if time < start:
            return None
        self.throttle_stick = 0.0
        return self.idle()

    def _dive(self, dive: Dive, time: float, estimate: State) -> ControlOutput | None:
        """Flies by hand: closes the throttle for the time of the dive, and then opens it until the fall has ended.

        Args:
            dive: The mishap, with its start and duration.
            time: Time since the beginning of the flight, s.
            estimate: Position, velocity, attitude and rates as the autopilot estimates them.

        Returns:
            Output of the pilot; None before the dive, when the flight plan sets the motors.
        """
        # The log has this mode from the beginning, as of a pilot who flew there by hand.
        self.mode = "stabilize"
        if time < dive.start:
            self.throttle_stick = self.hover_stick
            return None
        if time < dive.start + dive.seconds:
            self.throttle_stick = 0.0
            # The motors keep some thrust, by which the attitude stays controlled.
            return self._level(estimate, DIVE_THRUST)
        self.throttle_stick = 1.0
        # The velocity is north, east and down.
        _, _, sink_speed = estimate.velocity
        if sink_speed < CAUGHT_SPEED:
            self.has_ended_manoeuvre = True
        return self._level(estimate, CATCH_THRUST)

    def _flip(self, flip_time: float, estimate: State) -> ControlOutput | None:
        """Flies a flip, ArduPilot's mode: climbs for a moment, and then rolls to the right by a whole turn.

        The vehicle rolls at ``FLIP_RATE``. In the second half of the turn it brakes, so that the rotation ends with the
        turn.

        Args:
            flip_time: Time since the beginning of the flip, s.
            estimate: Position, velocity, attitude and rates as the autopilot estimates them.

        Returns:
            Output of the flip; None when it is complete, and the attitude is controlled again.
        """
        self.mode = "flip"
        if flip_time < FLIP_CLIMB_SECONDS:
            return self._level(estimate, FLIP_CLIMB_THRUST)
        roll_rate, _, _ = estimate.rates
        self.rolled += roll_rate * self.cycle
        if self.rolled >= FLIP_END:
            self.has_ended_manoeuvre = True
            return None
        is_braking = self.rolled > pi
        relative_thrust = FLIP_BRAKING_THRUST if is_braking else FLIP_THRUST
        # The largest rate from which the braking ends the rotation after a whole turn.
        remaining_angle = 2 * pi - self.rolled
        rate_setpoint = min(FLIP_RATE, sqrt(2 * FLIP_BRAKING * remaining_angle))
        thrust = relative_thrust * self.body.mass * GRAVITY
        angles = euler_angles(estimate.attitude)
        return self.controller.rate_control(
            estimate, angles, (rate_setpoint, 0.0, 0.0), thrust, is_flying=True
        )

    def _run_on_bench(self, bench: BenchRun, time: float, estimate: State) -> ControlOutput:
        """Raises the throttle from idle and lowers it again, and moves the sticks of roll and pitch meanwhile.

        The vehicle is tied down, so the controller responds to setpoints that the attitude cannot follow.

        Args:
            bench: The bench run, with its highest throttle.
            time: Time since the beginning of the flight, s.
            estimate: Position, velocity, attitude and rates as the autopilot estimates them.

        Returns:
            Output of the pilot at the stick positions of this time.
        """
        self.mode = "stabilize"
        phase = time % BENCH_RUN_SECONDS / BENCH_RUN_SECONDS
        self.throttle_stick = max(bench.throttle * sin(pi * phase) ** 2, 0.0)
        if self.throttle_stick <= IDLE_COMMAND:
            return self.idle()
        stick_thrust = self.body.rotors * self.body.thrust_at(
            self.body.rotor_speed(self.throttle_stick * self.body.full_command)
        )
        _, _, yaw = euler_angles(estimate.attitude)
        roll = BENCH_STICK_TILT * sin(2 * pi * time / BENCH_ROLL_PERIOD)
        pitch = BENCH_STICK_TILT * sin(2 * pi * time / BENCH_PITCH_PERIOD)
        return self.controller.attitude_control(
            estimate, (roll, pitch, yaw), NO_ROTATION, stick_thrust, is_flying=True
        )
