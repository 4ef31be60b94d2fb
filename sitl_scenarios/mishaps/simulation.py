"""Simulation with instruments: flies a scenario and its mishap until the flight or the recording ends."""

from collections import deque
from typing import Any

from sitl_scenarios.controller import ControlOutput
from sitl_scenarios.dynamics import AirState, State
from sitl_scenarios.flight_simulation import Row, Simulation
from sitl_scenarios.gyro import NO_ROTATION
from sitl_scenarios.mishaps.ground import GroundContact, impact, lands_on_feet, topple
from sitl_scenarios.mishaps.instruments import InstrumentedMotion, Instruments
from sitl_scenarios.mishaps.pilot import MODES, Pilot
from sitl_scenarios.mishaps.sensor_faults import SensorFaults
from sitl_scenarios.mishaps.specs import (
    BarometerStuck,
    BenchRun,
    BrownOut,
    FailsafeDisarm,
    ToppleAtLanding,
    ToppleAtTakeOff,
)
from sitl_scenarios.mishaps.texts import (
    CRASH_CHECK_SECONDS,
    CRITICAL,
    INFO,
    Announcement,
    announcements,
)
from sitl_scenarios.motion import Motion
from sitl_scenarios.plan import IN_AIR, ON_GROUND, TAKING_OFF, Reference
from sitl_scenarios.scenario import Scenario
from sitl_scenarios.vectors import Vector4

TOPPLE_LIFT = 0.8
"""Lift by the weight at which a vehicle tips over at take-off; a choice."""

LYING_SECONDS = 4.0
"""Time for which the record goes on after a crash, from disarming on, s; a choice."""

MAX_LATE_SECONDS = 60.0
"""Longest time for which a flight goes on beyond its duration until the vehicle is down, s; a choice."""

LATE_RECORD_SECONDS = 2.0
"""Time for which the record goes on after the landing of a flight that lands late, s; a choice."""

CLIMB_SECONDS = 5.0
"""Time of the climb, and of the descent, of a flight whose barometer is stuck, s."""

CLIMB_DELAY = 2.0
"""Time from the fault to that climb, s."""

CLIMB_HOLD = 6.0
"""Time between that climb and the descent, s."""


class InstrumentedSimulation(Simulation):
    """A simulation whose vehicle has instruments, and may have a mishap; it records an ``InstrumentedMotion``."""

    motion_type: type[Motion] = InstrumentedMotion

    def __init__(self, scenario: Scenario) -> None:
        """Prepares the flight, its mishap and its instruments."""
        super().__init__(scenario)
        self._is_px4 = scenario.stream.autopilot == "px4"
        self._sensor_faults = SensorFaults(scenario.mishap, self.cycle)
        self._instruments = Instruments(scenario)
        self._pilot = Pilot(scenario.mishap, self._controller, self._airframe, self.cycle)
        self._contact: GroundContact | None = None
        # When the vehicle came to lie, s after arming; None while it does not.
        self._lying_since: float | None = None
        # When the autopilot disarmed last, s after arming; None while it has not.
        self._disarmed_at: float | None = None
        self._is_failsafe = False
        # MAV_LANDED_STATE of the flight plan in this cycle.
        self._planned_state = ON_GROUND
        self._announcements = deque(
            announcements(scenario.mishap, is_px4=self._is_px4, duration=scenario.duration)
        )

    @property
    def finished(self) -> bool:
        """Whether the record is over: when the board loses its power, or some time after the crash or the landing.

        A vehicle that is still armed at the planned end of the flight gets up to ``MAX_LATE_SECONDS`` more to land.
        """
        mishap = self.scenario.mishap
        if isinstance(mishap, BrownOut) and self._flight_time >= mishap.start + mishap.seconds:
            return True
        # A vehicle that crashed lies on the ground.
        if self._lying_since is not None:
            return self._flight_time >= self._lying_since + CRASH_CHECK_SECONDS + LYING_SECONDS
        planned_end = self.scenario.duration
        may_still_land = self._flight_time < planned_end + MAX_LATE_SECONDS
        if self.armed and may_still_land:
            return False
        if self._disarmed_at is not None and self._disarmed_at > planned_end + self.cycle:
            # A vehicle that landed after the planned end is recorded at rest, too.
            return self._flight_time >= self._disarmed_at + LATE_RECORD_SECONDS
        return super().finished

    def set_parameter(self, name: str, value: float) -> bool:
        """Sets a parameter of the flight controller, by which the pilot's modes fly too."""
        is_set = super().set_parameter(name, value)
        self._pilot.controller = self._controller
        return is_set

    def _estimate(self, state: State) -> State:
        """Returns the state as the autopilot estimates it with its faulty sensors."""
        estimate = super()._estimate(state)
        return self._sensor_faults.faulty_estimate(self._flight_time, state, estimate)

    def _reference(self, estimate: State) -> Reference:
        """Returns the setpoints that are flown: the plan's, as pilot, failsafe and mishap change them.

        Args:
            estimate: The estimated state.

        Returns:
            The setpoints.
        """
        reference = self._pilot.reference(self._flight_time, estimate, super()._reference(estimate))
        self._planned_state = reference.landed_state
        mishap = self.scenario.mishap
        if isinstance(mishap, BarometerStuck):
            height = mishap.climb * _trapezoid(self._flight_time - mishap.start - CLIMB_DELAY)
            return reference._replace(height=reference.height + height)
        return reference

    def _update_arming(self) -> None:
        """Arms and disarms the vehicle as planned, and disarms it by a failsafe in the air, or after a crash.

        It also notes when the vehicle was disarmed, and since when it lies on the ground.
        """
        was_armed = self.armed
        super()._update_arming()
        if was_armed and not self.armed:
            self._disarmed_at = self._flight_time
        mishap = self.scenario.mishap
        time = self._flight_time
        if isinstance(mishap, FailsafeDisarm) and time >= mishap.start and not self._is_failsafe:
            self.armed = False
            self._is_failsafe = True
        if self._contact is None or not self._contact.has_settled:
            return
        if self._lying_since is None:
            self._lying_since = time
        if self.armed and time >= self._lying_since + CRASH_CHECK_SECONDS:
            self.armed = False
            # The text of ArduCopter's crash check. PX4 takes the vehicle for landed; so does ArduCopter after a landing
            # with the throttle closed, and sends no text.
            text, severity = "Crash: Disarming: AngErr=87>30, Accel=0.3<3.0", CRITICAL
            if self._is_px4:
                text, severity = "Disarmed by landing", INFO
            if not isinstance(mishap, ToppleAtLanding) or self._is_px4:
                self._announcements.appendleft(Announcement(time, text, severity))

    def _control_output(self, estimate: State, reference: Reference) -> ControlOutput:
        """Returns the output of the pilot or the failsafe, if one of them flies, or else of the plan's autopilot.

        Args:
            estimate: The estimated state.
            reference: Setpoints of this cycle.
        """
        output = None
        if self.armed:
            output = self._pilot.control(self._flight_time, estimate, reference)
        else:
            self._pilot.set_disarmed_stick(self._flight_time)
        if self._has_landed and isinstance(self.scenario.mishap, ToppleAtLanding):
            self._pilot.throttle_stick = 0.0
        if output is not None:
            return output
        return super()._control_output(estimate, reference)

    def _row(
        self,
        air: AirState,
        battery: float,
        estimate: State,
        reference: Reference,
        control: ControlOutput,
    ) -> Row:
        """Returns the row of the motion in this cycle, with measurements of the instruments and the autopilot's text.

        Args:
            air: The air during the cycle.
            battery: Remaining fraction of the voltage of a full battery.
            estimate: The estimated state.
            reference: Setpoints of the cycle.
            control: Output of the controller.

        Returns:
            Values by field.
        """
        row = super()._row(air, battery, estimate, reference, control)
        impact = 0.0 if self._contact is None else self._contact.impact
        row |= self._instruments.row(
            self._flight_time, self._state, battery, self._sensor_faults.readings, impact
        )
        text, severity = "", 0
        if self._announcements and self._flight_time >= self._announcements[0].time:
            _, text, severity = self._announcements.popleft()
        reported_fields: dict[str, Any] = {
            "throttle_stick": self._pilot.throttle_stick,
            "mode": MODES.index(self._pilot.mode),
            "is_failsafe": self._is_failsafe or self._pilot.mode == "land",
            # STATUSTEXT has room for 50 characters.
            "text": text[:50],
            "severity": severity,
        }
        return row | reported_fields

    def _landed_state(self, reference: Reference) -> int:
        """Determines the landed state that the autopilot reports, which a mishap may make wrong.

        For example, a land detector may mistake a motor that runs on the ground for flight.

        Args:
            reference: Setpoints of the flight plan, with its state.

        Returns:
            A value of MAV_LANDED_STATE.
        """
        mishap = self.scenario.mishap
        if isinstance(mishap, BenchRun):
            # The land detector takes a throttle above 0.3 for flight; a choice.
            is_running = self.armed and self._pilot.throttle_stick > 0.3
            return IN_AIR if mishap.reports_flight and is_running else ON_GROUND
        if self._contact is not None:
            return IN_AIR if self.armed and not self._has_landed else ON_GROUND
        return super()._landed_state(reference)

    def _touch_down(self, reference: Reference) -> None:
        """Decides how a vehicle behaves that has reached the ground: it stands, tips over, or crashes.

        It stands if it is slow and upright enough for its legs, and then tips over only if that is the scenario's
        mishap. Otherwise it crashes, and lies still after a while. From then on ``_contact`` moves it.

        Args:
            reference: Setpoints of the flight plan, which distinguish a landing from a bounce.
        """
        stays_upright = lands_on_feet(self._state.velocity, self._state.attitude)
        if stays_upright:
            super()._touch_down(reference)
            if isinstance(self.scenario.mishap, ToppleAtLanding) and self._has_landed:
                self._contact = topple(self._state, self.scenario.mishap.bearing)
            return
        self._contact = impact(self._state)
        self._on_ground = True
        self._state = self._contact.state_on_ground(self._state)

    def _spin_on_ground(self, settled_speeds: Vector4) -> None:
        """Turns the rotors for one cycle on the ground.

        A vehicle that lies on the ground, or is tied down, does not lift off. One that topples at take-off begins to
        tip over when its lift exceeds ``TOPPLE_LIFT``.

        Args:
            settled_speeds: Speeds (n,) that the rotors tend to, rad/s.
        """
        was_on_ground = self._contact is None
        super()._spin_on_ground(settled_speeds)
        mishap = self.scenario.mishap
        if isinstance(mishap, BenchRun):
            self._on_ground = True
            return
        if isinstance(mishap, ToppleAtTakeOff) and was_on_ground:
            lift = self._lift_ratio()
            if lift > TOPPLE_LIFT and self._planned_state == TAKING_OFF:
                self._contact = topple(self._state, mishap.bearing)
        if self._contact is not None:
            self._on_ground = True
            self._contact.advance(self.cycle)
            self._state = self._contact.state_on_ground(self._state)
            measured_rates = self._state.rates
        else:
            measured_rates = NO_ROTATION
        # On the ground the gyro measures the rotation alone: its vibration and its filters are left out.
        self._gyro.raw_rates = measured_rates
        self._gyro.filtered_rates = measured_rates

    def _lift_ratio(self) -> float:
        """Returns the thrust of all rotors, as of sound propellers in still air, by the weight."""
        body = self._airframe
        thrust = sum(body.thrust_at(speed) for speed in self._state.rotors)
        return thrust / (body.rotors * body.thrust_at(body.hover_speed))


def _trapezoid(since: float) -> float:
    """Returns 0 to 1: the share of a climb, hold and descent that began so many seconds before."""
    rising = min(max(since / CLIMB_SECONDS, 0.0), 1.0)
    falling = min(max((since - CLIMB_SECONDS - CLIMB_HOLD) / CLIMB_SECONDS, 0.0), 1.0)
    return rising - falling
