"""Flight plan of a scenario: setpoints of position, attitude and yaw rate over time, from arming to disarming.

A flight is: spin up, climb, hover with the scenario's excitation, descend, touch down slowly, and wait for disarming.
"""

from math import cos, fsum, hypot, pi, radians, sin, sqrt
from typing import NamedTuple

import numpy as np
from scipy.fft import ifft

from sitl_scenarios.motion import Array, Pair
from sitl_scenarios.scenario import (
    AXES,
    STICKS,
    Chirp,
    Course,
    Doublets,
    Move,
    Multisine,
    Scenario,
    Steps,
    Sticks,
)
from sitl_scenarios.turbulence import gaussian_noise
from sitl_scenarios.vectors import Vector3

ON_GROUND, IN_AIR, TAKING_OFF, LANDING = 1, 2, 3, 4
"""Values of MAV_LANDED_STATE."""

BOOT_SECONDS = 2.0
"""Time from the autopilot's boot until it arms itself, s; a choice."""

SPIN_UP_SECONDS = 1.0
"""Time from arming to take-off, s; a choice."""

SETTLE_SECONDS = 2.0
"""Time of hover before the excitation begins and after it ends, s; a choice."""

AFTER_SECONDS = 1.0
"""Time from the planned touch-down to disarming, and time simulated after disarming, s; a choice."""

MIN_EXCITATION_SECONDS = 1.0
"""Shortest excitation of a flight, s; a choice."""

MIN_CLIMB_SECONDS = 3.0
"""Shortest climb, s; a choice."""

MIN_DESCENT_SECONDS = 3.0
"""Shortest descent to the height of the final one, s; a choice."""

MAX_MEAN_CLIMB_SPEED = 1.5
"""Largest mean speed of climb and descent, m/s: high flights take longer than the shortest times."""

LANDING_SPEED = 0.6
"""Speed of the final descent, m/s: between ArduCopter's LAND_SPEED of 0.5 and PX4's MPC_LAND_SPEED of 0.7."""

FINAL_DESCENT_HEIGHT = 1.0
"""Height at which the final descent begins, m; a choice.

Autopilots begin it at 5 or 10 m (MPC_LAND_ALT2, LAND_ALT_LOW), as high as simulated flights hover. In 1 m the errors
of the faster descent before it have time to settle.
"""

FINAL_DESCENT_FRACTION = 0.5
"""Largest height of the final descent as a fraction of the height of the hover, for low flights; a choice."""

FULL_STICK = (radians(35), radians(35), radians(150))
"""Demands of roll and pitch, rad, and yaw rate, rad/s, at a stick's end.

They are PX4's defaults of MPC_MAN_TILT_MAX and MPC_MAN_Y_MAX.
"""

MOVE_ACCELERATION = 2.5
"""Acceleration at the beginning of a move and deceleration at its end, m/s²; a choice."""


class Reference(NamedTuple):
    """Setpoints at one instant of the flight."""

    landed_state: int
    """MAV_LANDED_STATE: 1 on the ground, 2 in the air, 3 taking off, 4 landing."""
    height: float
    """Height above the ground, m."""
    climb_rate: float
    """Rate of change of the height, m/s."""
    north: float = 0.0
    """Position north of the take-off, m."""
    east: float = 0.0
    """Position east of the take-off, m."""
    velocity: Pair = (0.0, 0.0)
    """Velocity of that position, north and east, m/s."""
    attitude_demand: Vector3 = (0.0, 0.0, 0.0)
    """Excitation: roll and pitch, rad, added to those that position control sets, and yaw rate, rad/s."""
    by_stick: bool = False
    """Whether the excitation comes from a pilot's sticks."""


class FlightTimes(NamedTuple):
    """Durations and times of a flight, s."""

    climb: float
    """Duration of the climb."""
    descent: float
    """Duration of the descent to the height of the final one."""
    hover: float
    """Time after arming at which the hover begins."""
    landing: float
    """Time after arming at which the descent begins."""


def flight_times(scenario: Scenario) -> FlightTimes:
    """Plans when a scenario's flight climbs, hovers and descends.

    Climb and descent take as long as the height needs at a moderate speed, and the final descent as long as it needs at
    ``LANDING_SPEED``; the hover gets the rest of the duration. It must be long enough for the excitation (a whole
    course, if there is one), with some time of quiet hover on both sides of it.

    Args:
        scenario: Scenario with duration, height and excitation of the flight.

    Returns:
        Durations of climb and descent, and the times after arming at which hover and descent begin, s.

    Raises:
        ValueError: The duration leaves no time for the excitation.
    """
    climb_seconds = max(MIN_CLIMB_SECONDS, scenario.height / MAX_MEAN_CLIMB_SPEED)
    final_height = final_descent_height(scenario.height)
    descent_height = scenario.height - final_height
    # In a low flight the speed rises evenly to ``LANDING_SPEED``: a longer descent would climb at first.
    max_even_seconds = 2 * descent_height / LANDING_SPEED
    descent_seconds = max(
        min(MIN_DESCENT_SECONDS, max_even_seconds), descent_height / MAX_MEAN_CLIMB_SPEED
    )
    seconds_to_touch_down = descent_seconds + final_height / LANDING_SPEED

    moves = scenario.excitation.moves if isinstance(scenario.excitation, Course) else ()
    timings = [move_timing(move) for move in moves]
    course_seconds = fsum(timing.move_seconds + timing.hover_seconds for timing in timings)
    excitation_seconds = max(course_seconds, MIN_EXCITATION_SECONDS)
    hover_seconds = excitation_seconds + 2 * SETTLE_SECONDS
    min_duration = (
        SPIN_UP_SECONDS + climb_seconds + hover_seconds + seconds_to_touch_down + AFTER_SECONDS
    )
    if scenario.duration < min_duration:
        purpose = f"a height of {scenario.height:g} m"
        if moves:
            purpose += " and the course"
        raise ValueError(
            f"duration must be at least {min_duration:g} s for {purpose}, not {scenario.duration:g}"
        )
    return FlightTimes(
        climb=climb_seconds,
        descent=descent_seconds,
        hover=SPIN_UP_SECONDS + climb_seconds,
        landing=scenario.duration - AFTER_SECONDS - seconds_to_touch_down,
    )


def final_descent_height(hover_height: float) -> float:
    """Returns the height above the ground at which the slow final descent begins, m, for a hover at a height in m."""
    return min(FINAL_DESCENT_HEIGHT, FINAL_DESCENT_FRACTION * hover_height)


def total_seconds(scenario: Scenario) -> float:
    """Returns the time from boot to the end of the last flight, s, with that on the ground before and after each."""
    return scenario.flights * (BOOT_SECONDS + scenario.duration + AFTER_SECONDS)


class CourseSetpoints(NamedTuple):
    """Setpoints of a course in one cycle."""

    north: float
    """Position north of where the course begins, m."""
    east: float
    """Position east of where the course begins, m."""
    up: float
    """Height above the hover, m."""
    north_speed: float
    """Speed to the north, m/s."""
    east_speed: float
    """Speed to the east, m/s."""
    climb_rate: float
    """Speed upwards, m/s."""
    yaw_rate: float
    """Rate of the heading, rad/s."""


class FlightPlan:
    """Setpoints of a scenario's flight as a function of the time since arming."""

    def __init__(self, scenario: Scenario) -> None:
        """Plans the flight.

        Multisines, sticks and courses are no simple functions of time: their setpoints are computed for every cycle
        beforehand. The other excitations are evaluated cycle by cycle.

        Args:
            scenario: Scenario with duration, height, excitation, cycle of the autopilot and random seed.

        Raises:
            ValueError: The duration leaves no time for the excitation.
        """
        self._times = flight_times(scenario)
        self._height = scenario.height
        self._excitation = scenario.excitation
        self._cycle = scenario.cycle
        demands = np.zeros((1, 3))
        if isinstance(scenario.excitation, Multisine):
            demands = _multisine_demands(scenario.excitation, self._cycle)
        elif isinstance(scenario.excitation, Sticks):
            hover_cycles = round((self._times.landing - self._times.hover) / self._cycle)
            demands = _stick_demands(scenario, scenario.excitation, hover_cycles)
        elif isinstance(scenario.excitation, Course):
            lap = _course_lap(scenario.excitation, self._cycle)
            excitation_seconds = self._times.landing - self._times.hover - 2 * SETTLE_SECONDS
            # There are as many whole laps as the time allows; the tolerance keeps rounding from losing one.
            laps = int(excitation_seconds / (len(lap) * self._cycle) + 1e-9)
            self._course = lap * laps
        self._demands: list[Vector3] = [tuple(row) for row in demands.tolist()]

    def reference_at(self, time: float) -> Reference:
        """Computes the setpoints at one instant of the flight: on the ground, in the climb, the hover or the descent.

        Height and climb rate follow a minimum-jerk movement, so that climb and descent begin and end gently.

        Args:
            time: Time after arming, s; negative before it.

        Returns:
            The setpoints, with the phase of the flight.
        """
        times = self._times
        if time < SPIN_UP_SECONDS:
            return Reference(ON_GROUND, 0.0, 0.0)
        if time < times.hover:
            fraction, rate = _smooth_transition((time - SPIN_UP_SECONDS) / times.climb)
            climb_rate = self._height * rate / times.climb
            return Reference(TAKING_OFF, self._height * fraction, climb_rate)
        if time < times.landing:
            hover = Reference(IN_AIR, self._height, 0.0)
            excitation_start = times.hover + SETTLE_SECONDS
            excitation_end = times.landing - SETTLE_SECONDS
            if excitation_start <= time < excitation_end:
                return self._with_excitation(hover, time - times.hover - SETTLE_SECONDS)
            return hover
        height, climb_rate = self._descent_at(time - times.landing)
        return Reference(LANDING, height, climb_rate)

    def _descent_at(self, time: float) -> Pair:
        """Returns the setpoints of the descent: a smooth one, then a final one at ``LANDING_SPEED`` until touch-down.

        The setpoint of the final descent goes on below the ground, so that the vehicle surely touches it.

        Args:
            time: Time since the descent began, s.

        Returns:
            Height above the ground, m, and climb rate, m/s.
        """
        smooth_seconds = self._times.descent
        final_height = final_descent_height(self._height)
        if time >= smooth_seconds:
            final_seconds = time - smooth_seconds
            return final_height - LANDING_SPEED * final_seconds, -LANDING_SPEED
        smooth_height = self._height - final_height
        # Rate at the end of the smooth descent: descended fraction of its height per passed fraction of its duration.
        final_rate = LANDING_SPEED * smooth_seconds / smooth_height
        fraction, rate = _smooth_transition(time / smooth_seconds, final_rate)
        return self._height - smooth_height * fraction, -smooth_height * rate / smooth_seconds

    def _with_excitation(self, hover: Reference, time: float) -> Reference:
        """Adds the scenario's excitation to the setpoints of the hover.

        Args:
            hover: Setpoints of the hover without excitation.
            time: Time since the excitation began, s.

        Returns:
            The setpoints with excitation.
        """
        match self._excitation:
            case Doublets():
                return hover._replace(attitude_demand=_doublet_demand(self._excitation, time))
            case Chirp():
                return hover._replace(attitude_demand=_chirp_demand(self._excitation, time))
            case Multisine() | Sticks():
                # A multisine repeats after its period.
                row = round(time / self._cycle) % len(self._demands)
                return hover._replace(
                    attitude_demand=self._demands[row],
                    by_stick=isinstance(self._excitation, Sticks),
                )
            case Steps(distance=distance, period=period):
                # Every other period is spent where the steps began. The nose points north: right is east.
                is_back = time // period % 2 == 1
                return hover._replace(east=0.0 if is_back else distance)
            case Course():
                # After the last lap the vehicle stays where the course ended.
                row = min(round(time / self._cycle), len(self._course) - 1)
                setpoints = self._course[row]
                return Reference(
                    IN_AIR,
                    height=self._height + setpoints.up,
                    climb_rate=setpoints.climb_rate,
                    north=setpoints.north,
                    east=setpoints.east,
                    velocity=(setpoints.north_speed, setpoints.east_speed),
                    attitude_demand=(0.0, 0.0, setpoints.yaw_rate),
                )
            case None:
                return hover


class MoveTiming(NamedTuple):
    """Speed and durations of one move of a course."""

    max_speed: float
    """Largest speed along the leg, m/s."""
    leg_seconds: float
    """Duration of the leg, s; 0 for a move that only turns."""
    move_seconds: float
    """Duration of the leg and the turn, which begin together, s."""
    hover_seconds: float
    """Duration of the hover after them, s."""


def move_timing(move: Move) -> MoveTiming:
    """Computes the speed and durations of a move: a straight leg, a turn at the same time, and then a hover.

    The speed v along the leg is a trapezoid over time: it rises at the acceleration a, stays, and falls at the same
    rate. The leg then takes length/v + v/a. On a short leg the speed is a triangle, whose peak is √(a · length).

    Args:
        move: Displacement (m), speed (m/s), turn (degrees), rate of the turn (degrees/s) and hover (s).

    Returns:
        Largest speed, m/s, and the durations of the leg, of leg and turn together, and of the hover, s.
    """
    length = hypot(move.north, move.east, move.up)
    max_speed = min(move.speed, sqrt(MOVE_ACCELERATION * length))
    leg_seconds = 0.0
    if length:
        leg_seconds = length / max_speed + max_speed / MOVE_ACCELERATION
    turn_seconds = abs(move.turn) / move.rate
    return MoveTiming(max_speed, leg_seconds, max(leg_seconds, turn_seconds), move.hover)


def _course_lap(course: Course, cycle: float) -> list[CourseSetpoints]:
    """Returns the setpoints of one lap of a course: its moves one after another, each from where the last one ended.

    Args:
        course: Moves of the course.
        cycle: Period of the autopilot's loop, s.

    Returns:
        Setpoints in each cycle of the lap.
    """
    start = np.zeros(3)
    lap: list[CourseSetpoints] = []
    for move in course.moves:
        lap += map(CourseSetpoints._make, _move_setpoints(move, start, cycle).tolist())
        start = start + np.array([move.north, move.east, move.up])
    return lap


def _move_setpoints(move: Move, start: Array, cycle: float) -> Array:
    """Returns the setpoints of one move and the hover after it.

    Args:
        move: Distances north, east and up, the turn, and the hover after it.
        start: Position at its beginning, north, east and up, m; (3,).
        cycle: Period of the autopilot's loop, s.

    Returns:
        (n, 7) fields of ``CourseSetpoints`` in each of n cycles: position, m, velocity, m/s, and yaw rate, rad/s.
    """
    displacement = np.array([move.north, move.east, move.up])
    timing = move_timing(move)
    cycles = round((timing.move_seconds + timing.hover_seconds) / cycle)
    time = cycle * np.arange(cycles)
    length = hypot(*displacement)
    # The speed rises evenly, stays, and falls evenly. Rise and fall each take ``ramp_seconds``. How long each phase has
    # lasted at a time:
    ramp_seconds = timing.max_speed / MOVE_ACCELERATION
    seconds_of_rise = np.minimum(time, ramp_seconds)
    seconds_of_fall = np.clip(time - timing.leg_seconds + ramp_seconds, 0.0, ramp_seconds)
    seconds_after_rise = np.clip(time - ramp_seconds, 0.0, timing.leg_seconds - ramp_seconds)
    # The distance is the integral of the speed: as if it stayed after the rise, less what the fall takes from it.
    distance = (
        MOVE_ACCELERATION / 2 * (seconds_of_rise**2 - seconds_of_fall**2)
        + timing.max_speed * seconds_after_rise
    )
    speed = MOVE_ACCELERATION * (seconds_of_rise - seconds_of_fall)
    direction = displacement / (length or 1.0)
    positions = start + np.outer(distance, direction)
    velocities = np.outer(speed, direction)
    is_turning = time < abs(move.turn) / move.rate
    turn_sign = 1 if move.turn > 0 else -1
    yaw_rates = radians(move.rate) * is_turning * turn_sign
    return np.column_stack([positions, velocities, yaw_rates])


def _doublet_demand(doublets: Doublets, time: float) -> Vector3:
    """Returns the demands of a series of doublets, each a pulse to one side and one to the other at once after it.

    Args:
        doublets: Axis, amplitude, width of a pulse and period.
        time: Time since the series began, s.

    Returns:
        Demands of roll and pitch, rad, and yaw rate, rad/s.
    """
    phase = time % doublets.period
    sign = 0.0
    if phase < doublets.width:
        sign = 1.0
    elif phase < 2 * doublets.width:
        sign = -1.0
    axis = doublets.axis
    if axis == "all":
        # The axes take turns from period to period.
        axis = AXES[int(time // doublets.period) % len(AXES)]
    return _demand_about(axis, radians(doublets.amplitude) * sign)


def _chirp_demand(chirp: Chirp, time: float) -> Vector3:
    """Returns the demands of a linear chirp, a sine whose frequency rises evenly during each period.

    Args:
        chirp: Axis, amplitude, lowest and highest frequency, and period.
        time: Time since the first period began, s.

    Returns:
        Demands of roll and pitch, rad, and yaw rate, rad/s.
    """
    phase_time = time % chirp.period
    # The phase is the integral of the frequency: time times the mean frequency since the period began, which is
    # half-way from the lowest to the current one.
    frequency_rise = (chirp.highest - chirp.lowest) * phase_time / chirp.period / 2
    cycles = (chirp.lowest + frequency_rise) * phase_time
    angle = radians(chirp.amplitude) * sin(2 * pi * cycles)
    return _demand_about(chirp.axis, angle)


def _demand_about(axis: str, value: float) -> Vector3:
    """Returns demands of roll, pitch and yaw rate that are a ``value`` about one axis, and 0 about the others."""
    return tuple(value if axis == name else 0.0 for name in AXES)


def _stick_demands(scenario: Scenario, sticks: Sticks, samples: int) -> Array:
    """Returns a pilot's demands of roll and pitch, rad, and yaw rate, rad/s: coloured noise that a stick's end limits.

    Args:
        scenario: Scenario with the random seed and the cycle.
        sticks: Axes, standard deviation and kernel width of the demands.
        samples: Number of cycles.

    Returns:
        (samples, 3) demands; they are zero on an axis without excitation.
    """
    demands = np.zeros((samples, 3))
    for number, (name, full_stick) in enumerate(zip(AXES, FULL_STICK, strict=True)):
        if sticks.axis in (name, "all"):
            random = scenario.random(STICKS, number)
            unit_noise = gaussian_noise(sticks.s, scenario.cycle, samples, random)
            angles = radians(sticks.sd) * unit_noise
            demands[:, number] = np.clip(angles, -full_stick, full_stick)
    return demands


def _multisine_demands(multisine: Multisine, cycle: float) -> Array:
    """Returns one period of a multisine excitation of roll and pitch, rad, and yaw rate, rad/s.

    Sines of equal power at the harmonics of the period, with the phases that keep the peak low: −πk(k − 1)/N for the
    k-th of N (M. Schroeder, "Synthesis of low-peak-factor signals", IEEE Trans. Information Theory, 1970). On all axes
    each has every third harmonic, so that the demands are orthogonal (E. Morelli, "Multiple input design for real-time
    parameter estimation in the frequency domain", IFAC Symposium on System Identification, 2003).

    Args:
        multisine: Axes, standard deviation, frequency range and period.
        cycle: Sampling period, s.

    Returns:
        (N, 3) demands for each cycle of one period.
    """
    # Frequencies as numbers of cycles per period, one at least.
    lowest_harmonic = max(1, round(multisine.lowest * multisine.period))
    highest_harmonic = round(multisine.highest * multisine.period)
    all_axes = multisine.axis == "all"
    # Each of the axes gets one harmonic at least.
    least_count = len(AXES) if all_axes else 1
    highest_harmonic = max(highest_harmonic, lowest_harmonic + least_count - 1)
    harmonics = range(lowest_harmonic, highest_harmonic + 1)
    samples = round(multisine.period / cycle)
    demands = np.zeros((samples, 3))
    for number, name in enumerate(AXES):
        if multisine.axis in (name, "all"):
            axis_harmonics = harmonics[number :: len(AXES)] if all_axes else harmonics
            unit_sum = _schroeder_multisine(axis_harmonics, samples)
            # N sines of amplitude a have the standard deviation a √(N/2). In the unit sum a is 1/samples.
            amplitude = radians(multisine.sd) * sqrt(2 / len(axis_harmonics)) * samples
            demands[:, number] = amplitude * unit_sum
    return demands


def _schroeder_multisine(harmonics: range, samples: int) -> Array:
    """Returns one period of a sum of cosines with Schroeder's phases, whose peak is low for its power.

    The sum is the real part of an inverse Fourier transform with one line of size 1 for each harmonic.

    Args:
        harmonics: Frequencies of the cosines, in cycles per period.
        samples: Number of samples of the period.

    Returns:
        (samples,) sum; each cosine has the amplitude 1/samples.
    """
    count = len(harmonics)
    # Phases −πk(k + 1)/N, counted from k = 0. The product is reduced to one turn in integers, without rounding.
    phases = [-pi * (k * (k + 1) % (2 * count)) / count for k in range(count)]
    lines = [complex(cos(phase), sin(phase)) for phase in phases]
    spectrum = np.zeros(samples, dtype=np.complex128)
    # Harmonics above half the sampling rate are aliased, as samples of their sines would be.
    aliased_harmonics = np.array(harmonics) % samples
    np.add.at(spectrum, aliased_harmonics, lines)
    return ifft(spectrum).real


def _smooth_transition(time_fraction: float, final_rate: float = 0.0) -> Pair:
    """Returns the travelled fraction of a minimum-jerk movement, and its rate (T. Flash and N. Hogan, 1985).

    Speed and acceleration are zero at the beginning, and the acceleration at the end.

    Args:
        time_fraction: Passed fraction of the movement's duration, 0 to 1.
        final_rate: Rate at the end.

    Returns:
        Travelled fraction, 0 to 1, and its derivative with respect to ``time_fraction``.
    """
    s = time_fraction
    # The sum of two polynomials of fifth order: one ends at a fraction of 1 with a rate of 0, the other at a fraction
    # of 0 with ``final_rate``.
    travelled_fraction = s**3 * (10 - 15 * s + 6 * s**2) - final_rate * s**3 * (1 - s) * (4 - 3 * s)
    rate = 30 * s**2 * (1 - s) ** 2 - final_rate * s**2 * (12 - 28 * s + 15 * s**2)
    return travelled_fraction, rate
