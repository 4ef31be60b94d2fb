"""Simulation of a flight: advances a scenario cycle by cycle of its autopilot, and records every quantity."""

from collections import deque
from collections.abc import Sequence
from itertools import chain
from math import fsum, hypot, sqrt
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from sitl_scenarios.controller import ControlOutput
from sitl_scenarios.damage import Damage, damage_history
from sitl_scenarios.dynamics import AirState, Body, State, disturbance_of_states
from sitl_scenarios.gains import control_parameters
from sitl_scenarios.gyro import NO_ROTATION, gyro_samples
from sitl_scenarios.motion import Arrays, Motion
from sitl_scenarios.parameter_controller import check_parameters, controller_for, gyro_for
from sitl_scenarios.plan import (
    AFTER_SECONDS,
    BOOT_SECONDS,
    LANDING,
    ON_GROUND,
    TAKING_OFF,
    FlightPlan,
    Reference,
)
from sitl_scenarios.rotors import DISARMED_PULSE, IDLE_COMMAND, pulse_width
from sitl_scenarios.scenario import Scenario
from sitl_scenarios.sensors import GyroVibration, StateEstimator
from sitl_scenarios.vectors import Vector3, Vector4
from sitl_scenarios.vehicles import GRAVITY, airframe
from sitl_scenarios.wind import Weather

MAX_BODY_RATE = 200.0
"""Body rate above which a vehicle is out of control, rad/s: no vehicle turns faster."""

Row = dict[str, Any]
"""Values of the fields of ``Motion`` in one cycle, by name, except the fields of the disturbance."""


class DisturbedState(NamedTuple):
    """What determines the disturbance of one cycle, besides the row of ``Motion``."""

    air: AirState
    """The air at the vehicle."""
    damage: Damage
    """Damage that acts on the vehicle."""
    on_ground: bool
    """Whether the ground holds the vehicle: then no disturbance is recorded."""


def tumbles(state: State) -> bool:
    """Returns whether a vehicle is out of control: rates above ``MAX_BODY_RATE``, or not a number."""
    # The comparison is negated, because every comparison with NaN is false.
    return not hypot(*state.rates) < MAX_BODY_RATE


class Simulation:
    """A simulation of a scenario's flights that is advanced by cycles of the autopilot.

    Each of the scenario's flights has five parts: two seconds on the ground, arming, the flight itself, disarming, and
    one second on the ground. All numbers follow from the scenario alone: flown again, they are the same to the bit.

    Attributes:
        scenario: The scenario that is flown.
        cycle: Period of the autopilot's loop and of the rows of ``Motion``, s.
        armed: Whether the motors may turn.
    """

    motion_type: type[Motion] = Motion
    """Record of the rows of a flight."""

    def __init__(self, scenario: Scenario) -> None:
        """Prepares the first flight, with the whole weather; raises ValueError if its duration is too short."""
        self.scenario = scenario
        self.cycle = scenario.cycle
        self._body = Body(scenario.vehicle, self.cycle)
        self._airframe = airframe(scenario.vehicle)
        self._plan = FlightPlan(scenario)
        self._controller = controller_for(scenario)
        self._gyro = gyro_for(self._controller)
        self._vibration = GyroVibration(scenario, self.cycle / gyro_samples(self.cycle))
        self._estimator = StateEstimator(scenario)
        # Durations in cycles: from boot to arming, from arming to the planned disarming, and to the flight's end.
        self._boot_cycles = round(BOOT_SECONDS / self.cycle)
        self._flight_cycles = round(scenario.duration / self.cycle)
        self._end_cycles = self._flight_cycles + round(AFTER_SECONDS / self.cycle)
        cycles = np.arange(-self._boot_cycles, self._end_cycles, dtype=np.float64)
        self._weather = Weather(scenario, self.cycle, self.cycle * cycles)
        # Speeds of rotors that stand still, rad/s.
        self._stopped_rotors: Vector4 = (0.0,) * self._airframe.rotors
        self._state = State(rotors=self._stopped_rotors)
        # Numbers of the current cycle and of that in which the current flight is armed.
        self._current_cycle = 0
        self._arming_cycle: int = self._boot_cycles
        self._remaining_flights = scenario.flights - 1
        # Damage begins at its time after the first arming, whatever the number of flights.
        self._coming_damage = deque(
            (self._boot_cycles + round(time / self.cycle), damage)
            for time, damage in damage_history(scenario)
        )
        self.armed = False
        # Whether arming was commanded, so that the autopilot no longer arms itself.
        self._is_commanded = False
        self._on_ground = True
        # Whether the vehicle touched down at the end of this flight, or fell.
        self._has_landed = False

    @property
    def finished(self) -> bool:
        """Whether the last flight and the second after it are over."""
        return (
            not self._remaining_flights
            and self._current_cycle >= self._arming_cycle + self._end_cycles
        )

    def set_armed(self, armed: bool, force: bool = False) -> bool:
        """Arms or disarms the vehicle by a ground station's command; from then on the autopilot does not arm itself.

        Arming begins a flight of the scenario's duration, even after another one, and the scenario's remaining flights
        are dropped. Arming in the air is refused, and so is disarming there, unless it is forced, which makes the
        vehicle fall.

        Args:
            armed: Whether the vehicle is to be armed.
            force: Whether to disarm in the air, too.

        Returns:
            Whether the vehicle is armed or disarmed as commanded.
        """
        if armed == self.armed:
            return True
        if not self._on_ground and (armed or not force):
            return False
        self._is_commanded = True
        self._remaining_flights = 0
        self.armed = armed
        if armed:
            self._begin_flight(self._current_cycle)
        return True

    def set_parameter(self, name: str, value: float) -> bool:
        """Sets a parameter of the flight controller, also in flight; its integrators begin again.

        Args:
            name: Name of the parameter.
            value: Its new value, in the autopilot's unit.

        Returns:
            Whether it is set: not, where the controller here has no such parameter, or the value is not possible.
        """
        if name not in control_parameters(self.scenario):
            return False
        scenario = self.scenario.with_parameter(name, value)
        try:
            check_parameters(scenario)
        except ValueError:
            return False
        self.scenario = scenario
        self._controller = controller_for(scenario)
        self._gyro = gyro_for(self._controller)
        return True

    def advance(self, cycles: int) -> Motion:
        """Simulates the flight for some further cycles of the autopilot.

        It may be called only while the simulation is not ``finished``.

        Args:
            cycles: Number of cycles; fewer are simulated where the last flight ends before.

        Returns:
            The motion, with one sample for each simulated cycle.

        Raises:
            ValueError: The vehicle tumbles.
        """
        samples = []
        disturbed_states = []
        for _ in range(cycles):
            if self.finished:
                break
            sample, disturbed_state = self._fly_cycle()
            samples.append(sample)
            disturbed_states.append(disturbed_state)
        # The samples become columns: one array for each field of the motion.
        columns = {}
        for name in samples[0]:
            columns[name] = _column_of_field([sample[name] for sample in samples])
        # Forces and moments of the disturbance are computed for all cycles at once, which is faster.
        columns |= self._disturbance_columns(columns, disturbed_states)
        columns["landed_state"] = columns["landed_state"].astype(np.uint8)
        return self.motion_type(**columns)

    def _disturbance_columns(
        self, columns: Arrays, disturbed_states: Sequence[DisturbedState]
    ) -> Arrays:
        """Computes the disturbing force and moment on the vehicle for all rows of the motion at once.

        Args:
            columns: Columns (N, …) of the motion in N cycles: attitude, velocity, rates and rotor speeds are used.
            disturbed_states: Air, damage and contact with the ground in the same cycles.

        Returns:
            ``force``, N, and ``moment``, N m, (N, 3) each; 0 on the ground.
        """
        force = np.zeros((len(disturbed_states), 3))
        moment = np.zeros((len(disturbed_states), 3))
        air = _column_of_field([disturbed.air for disturbed in disturbed_states])
        # ``disturbance_of_states`` takes many states with the same damage, so rows are grouped by their damage.
        flying_rows: dict[Damage, list[int]] = {}
        for row, disturbed in enumerate(disturbed_states):
            if not disturbed.on_ground:
                flying_rows.setdefault(disturbed.damage, []).append(row)
        for damage, rows in flying_rows.items():
            force[rows], moment[rows] = disturbance_of_states(
                self.scenario.vehicle,
                damage,
                columns["attitude"][rows],
                columns["velocity"][rows],
                columns["rates"][rows],
                columns["rotor_speeds"][rows],
                air[rows],
            )
        return {"force": force, "moment": moment}

    def _begin_flight(self, arming_cycle: int) -> None:
        """Begins another flight, which is armed in the cycle of this number."""
        self._arming_cycle = arming_cycle
        self._has_landed = False
        self._controller.reset()

    def _update_arming(self) -> None:
        """Arms or disarms the vehicle if the current cycle is the time for it, and begins the scenario's next flight.

        Time is counted in cycles from the arming of the current flight (``flight_cycle``). It is negative while the
        vehicle waits to be armed, ``_flight_cycles`` at the planned disarming, and ``_end_cycles`` when the time on the
        ground after the flight has passed.
        """
        flight_cycle = self._current_cycle - self._arming_cycle
        is_flight_over = not self.armed and flight_cycle >= self._end_cycles
        if self._remaining_flights and is_flight_over:
            self._remaining_flights -= 1
            # The vehicle waits on the ground as long as after boot before it is armed again.
            self._begin_flight(self._current_cycle + self._boot_cycles)
            flight_cycle = -self._boot_cycles
        # Once a ground station has commanded arming, the autopilot leaves it to the ground station.
        if not self.armed and not self._is_commanded and flight_cycle == 0:
            self.armed = True
        # A vehicle that is late in touching down, such as one in a strong wind, stays armed until it does.
        if self.armed and flight_cycle >= self._flight_cycles and self._on_ground:
            self.armed = False

    def _fly_cycle(self) -> tuple[Row, DisturbedState]:
        """Simulates one cycle of the autopilot: sense, control, record, and move the vehicle to the next cycle.

        Returns:
            The quantities at the cycle's beginning, with the motor outputs that are set for it, by the names and in the
            units of ``Motion``'s fields; and what disturbs the vehicle then.

        Raises:
            ValueError: The vehicle tumbles.
        """
        self._apply_due_damage()
        self._update_arming()
        state = self._state
        flight_cycle = self._current_cycle - self._arming_cycle
        # The weather begins at boot, that is ``_boot_cycles`` before arming.
        air = self._weather.air_at(flight_cycle + self._boot_cycles, state.position)
        battery = self._battery_fraction(flight_cycle)

        # The autopilot measures the state by its sensors: the rates after the gyro's filters, all with noise and
        # delay.
        measured_state = State(
            state.position, state.velocity, state.attitude, self._gyro.filtered_rates
        )
        estimate = self._estimate(measured_state)
        reference = self._reference(estimate)
        control = self._control_output(estimate, reference)
        row = self._row(air, battery, estimate, reference, control)
        disturbed_state = DisturbedState(air, self._body.damage, self._on_ground)

        self._move(control.outputs, battery, air, reference)
        self._current_cycle += 1
        return row, disturbed_state

    @property
    def _flight_time(self) -> float:
        """Time since the current flight was armed, s; negative before."""
        return (self._current_cycle - self._arming_cycle) * self.cycle

    def _estimate(self, state: State) -> State:
        """Returns the state as the autopilot estimates it, given the true one with the rates of the gyro."""
        return self._estimator.estimate(state)

    def _reference(self, _: State) -> Reference:
        """Returns the setpoints of this cycle: the flight plan's, whatever the estimated state."""
        return self._plan.reference_at(self._flight_time)

    def _apply_due_damage(self) -> None:
        """Applies each step of the damage whose time has come; the last one replaces the ones before."""
        while self._coming_damage:
            first_cycle, damage = self._coming_damage[0]
            if self._current_cycle < first_cycle:
                break
            self._coming_damage.popleft()
            self._body.apply_damage(damage)

    def _battery_fraction(self, flight_cycle: int) -> float:
        """Computes the battery's voltage as a fraction of a full battery's.

        It falls evenly from arming to the planned disarming, by the scenario's ``battery_sag``. Every flight begins
        with a full battery.

        Args:
            flight_cycle: Number of cycles since arming.

        Returns:
            The fraction, 0 to 1.
        """
        flown_fraction = min(max(flight_cycle / self._flight_cycles, 0.0), 1.0)
        return 1.0 - self.scenario.vehicle.battery_sag * flown_fraction

    def _row(
        self,
        air: AirState,
        battery: float,
        estimate: State,
        reference: Reference,
        control: ControlOutput,
    ) -> Row:
        """Collects the quantities of the current cycle, before the vehicle moves on.

        Args:
            air: The air at the vehicle.
            battery: Remaining fraction of the voltage of a full battery.
            estimate: State as the autopilot estimates it.
            reference: Setpoints of the flight plan.
            control: Outputs and setpoints of the autopilot.

        Returns:
            Values by the names of ``Motion``'s fields.
        """
        state = self._state
        sticks: Vector3 = NO_ROTATION
        if reference.by_stick and self.armed:
            sticks = reference.attitude_demand
        return {
            "time": self._current_cycle * self.cycle,
            "position": state.position,
            "velocity": state.velocity,
            "attitude": state.attitude,
            "rates": state.rates,
            "known_attitude": estimate.attitude,
            "known_rates": estimate.rates,
            "gyro": self._gyro.raw_rates,
            "known_position": estimate.position,
            "known_velocity": estimate.velocity,
            "outputs": control.outputs,
            "demands": control.demands,
            "attitude_setpoint": control.attitude,
            "rates_setpoint": control.rates,
            "sticks": sticks,
            "rotor_speeds": state.rotors,
            "battery": battery,
            "wind": (air.north, air.east, air.down),
            "armed": self.armed,
            "landed_state": self._landed_state(reference),
        }

    def _landed_state(self, reference: Reference) -> int:
        """Returns the MAV_LANDED_STATE that the autopilot reports.

        It is the state of the flight plan, except that a vehicle on the ground reports so: it may have touched down
        early, or may not be armed. Only a vehicle that is armed and about to climb reports its take-off.

        Args:
            reference: Setpoints of the flight plan, with its state.

        Returns:
            1 on the ground, 2 in the air, 3 taking off, 4 landing.
        """
        is_taking_off = self.armed and reference.landed_state == TAKING_OFF
        if self._on_ground and not is_taking_off:
            return ON_GROUND
        return reference.landed_state

    def _control_output(self, estimate: State, reference: Reference) -> ControlOutput:
        """Computes the autopilot's output in this cycle.

        The motors are stopped while the vehicle is disarmed, and idle while it is armed on the ground, before take-off
        and after landing. Otherwise the flight controller runs.

        Args:
            estimate: State as the autopilot estimates it.
            reference: Setpoints of the flight plan.

        Returns:
            Pulse widths of the motors, µs, and the demands and setpoints that led to them.
        """
        if not self.armed:
            stopped_pulse = DISARMED_PULSE[self.scenario.stream.autopilot]
            return ControlOutput((stopped_pulse,) * self._airframe.rotors, (0.0,) * 4)
        if reference.landed_state == ON_GROUND or self._has_landed:
            idle_pulse = pulse_width(IDLE_COMMAND)
            # No demands of roll, pitch and yaw; the thrust is idle.
            return ControlOutput(
                (idle_pulse,) * self._airframe.rotors, (*NO_ROTATION, IDLE_COMMAND)
            )
        return self._controller.control(estimate, reference, is_flying=not self._on_ground)

    def _move(self, outputs: Vector4, battery: float, air: AirState, reference: Reference) -> None:
        """Moves the vehicle by one cycle of the autopilot: on the ground, in the air, or from the air onto the ground.

        On the ground only the rotors turn. In the air the physics take several steps, during which the motor outputs
        and the air are constant.

        Args:
            outputs: PWM pulse of each motor (n,), µs.
            battery: Remaining fraction of the voltage of a full battery.
            air: Velocity of the air, and moments on the vehicle, during the cycle.
            reference: Setpoints of the flight plan, which distinguish a landing from a bounce.

        Raises:
            ValueError: The vehicle tumbles.
        """
        # A disarmed motor is off, whatever its pulse.
        settled_speeds = self._stopped_rotors
        if self.armed:
            settled_speeds = self._body.settled_speeds(outputs, battery)
        if self._on_ground:
            self._spin_on_ground(settled_speeds)
            return
        state = self._gyro.advance(self._body, self._state, settled_speeds, air, self._vibration)
        if tumbles(state):
            raise ValueError(
                f"the vehicle is out of control {self._current_cycle * self.cycle:.1f} s after boot, "
                f"turning at more than {MAX_BODY_RATE:g} rad/s: it needs less wind, or smaller moments"
            )
        self._state = state
        _, _, down = state.position
        _, _, sink_speed = state.velocity
        if down >= 0.0 and sink_speed > 0.0:
            self._touch_down(reference)

    def _touch_down(self, reference: Reference) -> None:
        """Puts a vehicle that touches the ground at rest there, and ends the flight if it was to land.

        If it was not to land, a gust only pushed the vehicle down, and the flight goes on.

        Args:
            reference: Setpoints of the flight plan, with the state that the autopilot reports, such as landing.
        """
        self._state = _at_rest_on_ground(self._state)
        self._on_ground = True
        self._has_landed = reference.landed_state == LANDING or not self.armed
        # After a mere push to the ground the controller keeps its integrals, so that the thrust rises until the vehicle
        # lifts off again. If they restarted with each contact, they would never overcome a lasting downdraught.
        if self._has_landed:
            self._controller.reset()
        # The filters of a new gyro have no memory of the motion before the contact.
        self._gyro = gyro_for(self._controller)

    def _spin_on_ground(self, settled_speeds: Vector4) -> None:
        """Turns the rotors for one cycle on the ground; the vehicle lifts off when their thrust exceeds its weight.

        Args:
            settled_speeds: Speeds (n,) that the rotors tend to with their lag, rad/s.
        """
        rotors = self._body.rotor_speeds_after_cycle(self._state.rotors, settled_speeds)
        self._state = self._state._replace(rotors=rotors)
        # Damaged propellers give a fraction of their thrust.
        thrust_fractions = self._body.damage.thrust
        lift = fsum(
            fraction * self._airframe.thrust_at(speed)
            for speed, fraction in zip(rotors, thrust_fractions, strict=True)
        )
        self._on_ground = lift <= self._airframe.mass * GRAVITY


def _column_of_field(values: Sequence[Any]) -> NDArray[Any]:
    """Returns the values of one field in N cycles as an array.

    Args:
        values: Numbers, or tuples of n floats, one for each cycle; at least one cycle.

    Returns:
        Array (N,) of numbers, or (N, n) of tuples.
    """
    first_value = values[0]
    if isinstance(first_value, tuple):
        # NumPy reads one series of floats several times as fast as tuples.
        shape = (len(values), len(first_value))
        all_elements = chain.from_iterable(values)
        return np.fromiter(all_elements, np.float64, shape[0] * shape[1]).reshape(shape)
    return np.array(values)


def _at_rest_on_ground(state: State) -> State:
    """Brings a vehicle that touched down to rest: level, with its heading and rotor speeds.

    Args:
        state: State at the contact with the ground.

    Returns:
        The state, at height 0.
    """
    north, east, _ = state.position
    # A quaternion without its x and y is a rotation about the vertical: it keeps the heading of a nearly level vehicle.
    w, _, _, z = state.attitude
    length = sqrt(w * w + z * z) or 1.0
    heading_only = (w / length, 0.0, 0.0, z / length)
    return State((north, east, 0.0), attitude=heading_only, rotors=state.rotors)
