"""Simulation of a vehicle with instruments, and of the mishap in a scenario: what goes wrong, such as a motor stop."""

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
from sitl_scenarios.vectors import Vector3, Vector4

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

FLIGHT_THROTTLE = 0.3
"""Throttle stick above which a land detector takes a vehicle on a bench for flying, 0 to 1; a choice."""

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
        """Whether the recording is over; the first of these rules that applies decides.

        1. If the mishap is a brown-out, it is over when the autopilot has lost its power.
        2. A crashed vehicle is recorded until it has been disarmed, and for ``LYING_SECONDS`` more.
        3. A vehicle that is still armed is recorded up to ``MAX_LATE_SECONDS`` beyond the planned end of the flight.
        4. A vehicle that landed after the planned end is recorded at rest for ``LATE_RECORD_SECONDS``.
        5. Any other recording ends as planned.
        """
        # Times are seconds since the beginning of the flight.
        time = self._flight_time
        planned_end = self.scenario.duration
        mishap = self.scenario.mishap
        # Rule 1.
        if isinstance(mishap, BrownOut) and time >= mishap.start + mishap.seconds:
            return True
        # Rule 2. The autopilot takes ``CRASH_CHECK_SECONDS`` to recognise the crash, and then disarms.
        if self._lying_since is not None:
            disarming_time = self._lying_since + CRASH_CHECK_SECONDS
            return time >= disarming_time + LYING_SECONDS
        # Rule 3.
        if self.armed and time < planned_end + MAX_LATE_SECONDS:
            return False
        # Rule 4. A vehicle that lands as planned is disarmed in the cycle of the planned end.
        if self._disarmed_at is not None and self._disarmed_at > planned_end + self.cycle:
            return time >= self._disarmed_at + LATE_RECORD_SECONDS
        # Rule 5.
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
        """Returns the setpoints that are flown: the flight plan's, as pilot, failsafe and mishap change them.

        If the mishap is a stuck barometer, whose reading no longer changes, the vehicle then climbs and descends once.
        So the log shows that the barometer does not follow the height.

        Args:
            estimate: Position, velocity, attitude and rates as the autopilot estimates them.

        Returns:
            The setpoints of this cycle, with the height in m. Their ``landed_state`` is stored for the recording.
        """
        planned_reference = super()._reference(estimate)
        reference = self._pilot.reference(self._flight_time, estimate, planned_reference)
        self._planned_state = reference.landed_state
        mishap = self.scenario.mishap
        if not isinstance(mishap, BarometerStuck):
            return reference
        seconds_of_climb = self._flight_time - (mishap.start + CLIMB_DELAY)
        added_height = mishap.climb * _climb_fraction(seconds_of_climb)
        return reference._replace(height=reference.height + added_height)

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
            if self._is_px4:
                # PX4 takes the vehicle for landed.
                announcement = Announcement(time, "Disarmed by landing", INFO)
                self._announcements.appendleft(announcement)
            elif not isinstance(mishap, ToppleAtLanding):
                # ArduCopter's crash check. After a landing with the throttle closed it does not act, and sends no text.
                text = "Crash: Disarming: AngErr=87>30, Accel=0.3<3.0"
                self._announcements.appendleft(Announcement(time, text, CRITICAL))

    def _control_output(self, estimate: State, reference: Reference) -> ControlOutput:
        """Returns the motors' output in this cycle: the pilot's, a failsafe's, or the one of the autopilot.

        It also sets the pilot's throttle stick, which is recorded.

        Args:
            estimate: Position, velocity, attitude and rates as the autopilot estimates them.
            reference: Setpoints of this cycle.

        Returns:
            Pulse widths of the motors, µs, and the demands and setpoints that led to them.
        """
        pilot_output = None
        if self.armed:
            # None unless a pilot or a failsafe flies in this cycle.
            pilot_output = self._pilot.control(self._flight_time, estimate, reference)
        else:
            self._pilot.set_disarmed_stick(self._flight_time)
        if self._has_landed and isinstance(self.scenario.mishap, ToppleAtLanding):
            # The pilot of such a flight has closed the throttle at the touch-down, before the vehicle tips over.
            self._pilot.throttle_stick = 0.0
        if pilot_output is not None:
            return pilot_output
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
            air: Velocity of the air, and moments on the vehicle, during the cycle.
            battery: Remaining fraction of the voltage of a full battery.
            estimate: Position, velocity, attitude and rates as the autopilot estimates them.
            reference: Setpoints of the cycle.
            control: Output of the controller.

        Returns:
            Values by field.
        """
        row = super()._row(air, battery, estimate, reference, control)
        impact = 0.0 if self._contact is None else self._contact.impact
        row |= self._instruments.row(
            self._flight_time, self._state, battery, self._sensor_faults.sensor_errors, impact
        )
        announcement = self._next_announcement()
        reported_fields: dict[str, Any] = {
            "throttle_stick": self._pilot.throttle_stick,
            "mode": MODES.index(self._pilot.mode),
            "is_failsafe": self._is_failsafe or self._pilot.mode == "land",
            # STATUSTEXT has room for 50 characters.
            "text": announcement.text[:50],
            "severity": announcement.severity,
        }
        return row | reported_fields

    def _next_announcement(self) -> Announcement:
        """Returns the text that the autopilot sends in this cycle, and removes it from those to be sent.

        One text is sent per cycle. If none is due, it is empty.
        """
        if self._announcements and self._flight_time >= self._announcements[0].time:
            return self._announcements.popleft()
        return Announcement(self._flight_time, text="", severity=0)

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
            is_throttle_raised = self.armed and self._pilot.throttle_stick > FLIGHT_THROTTLE
            return IN_AIR if mishap.reports_flight and is_throttle_raised else ON_GROUND
        if self._contact is not None:
            # The land detector does not notice a crash: the vehicle counts as flying until it is disarmed.
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
        """Moves a vehicle on the ground by one cycle: its rotors turn, and it may tip over or lift off.

        A vehicle that lies on the ground, or is tied to a bench, does not lift off. One that topples at take-off begins
        to tip over when its lift exceeds ``TOPPLE_LIFT``.

        Args:
            settled_speeds: Speeds (n,) that the rotors tend to with their lag, rad/s.
        """
        # This turns the rotors, and lets the vehicle lift off where their thrust exceeds its weight.
        super()._spin_on_ground(settled_speeds)
        mishap = self.scenario.mishap
        if isinstance(mishap, BenchRun):
            # The vehicle is tied down.
            self._on_ground = True
            return
        stands_upright = self._contact is None
        if isinstance(mishap, ToppleAtTakeOff) and stands_upright:
            is_taking_off = self._planned_state == TAKING_OFF
            if is_taking_off and self._lift_ratio() > TOPPLE_LIFT:
                self._contact = topple(self._state, mishap.bearing)
        measured_rates: Vector3 = NO_ROTATION
        if self._contact is not None:
            # The vehicle tips over or lies: the contact with the ground moves it.
            self._on_ground = True
            self._contact.advance(self.cycle)
            self._state = self._contact.state_on_ground(self._state)
            measured_rates = self._state.rates
        # On the ground the gyro measures the rotation alone: its vibration and its filters are left out.
        self._gyro.raw_rates = measured_rates
        self._gyro.filtered_rates = measured_rates

    def _lift_ratio(self) -> float:
        """Returns the thrust of all rotors, as of sound propellers in still air, by the weight."""
        body = self._airframe
        thrust = sum(body.thrust_at(speed) for speed in self._state.rotors)
        return thrust / (body.rotors * body.thrust_at(body.hover_speed))


def _climb_fraction(seconds: float) -> float:
    """Returns the fraction of a climb that a vehicle has reached which climbs, holds the height and descends again.

    Args:
        seconds: Time since the beginning of the climb, s.

    Returns:
        The fraction, 0 to 1, a trapezoid over time.
    """
    climbed = min(max(seconds / CLIMB_SECONDS, 0.0), 1.0)
    descent_start = CLIMB_SECONDS + CLIMB_HOLD
    descended = min(max((seconds - descent_start) / CLIMB_SECONDS, 0.0), 1.0)
    return climbed - descended
