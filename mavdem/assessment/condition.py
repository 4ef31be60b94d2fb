"""Condition of a vehicle by figures that need no fast stream: motor balance, lean, vibration, battery, oscillation."""

from dataclasses import dataclass, field

import numpy as np

from mavdem.arrays import Array
from mavdem.assessment.battery_levels import batteries_worst_first
from mavdem.assessment.flights import segments_of_boots, settled_flight, total_duration
from mavdem.assessment.flown_flights import MAX_FLIGHT_SECONDS
from mavdem.assessment.mean_interval import MeanFigure, finite_or_none, mean_figure, mean_interval
from mavdem.containers import Numbers
from mavdem.dataset import flight_states
from mavdem.dataset.axes import AXES, TILT_AXES
from mavdem.dataset.batteries import Battery
from mavdem.dataset.motor_outputs import MotorOutputs
from mavdem.dataset.segments import Segments, in_segments, recorded_spans
from mavdem.dataset.signals import Signals
from mavdem.dataset.time_series import AVERAGING_SECONDS, recorded_series
from mavdem.errors import NotLearnable
from mavdem.immutable import ImmutableResult
from mavdem.ingest.motors import POSSIBLE_MULTIROTORS
from mavdem.loops.limit_cycles import Oscillation, detect_limit_cycle
from mavdem.loops.oscillation_frequency import with_unaliased_frequency
from mavdem.motors.hover import HoverFigures, hover_of
from mavdem.vibration.vibration_message import reported_vibration

GYRO_MESSAGE = "GYRO_AFTER"
"""Message with the gyro after its filters, which may be faster than the attitude."""
GYRO_FIELDS = {"roll": "x", "pitch": "y", "yaw": "z"}
"""Fields of that message, by axis."""


@dataclass(frozen=True)
class VibrationFigures:
    """Vibration in settled flight, as the autopilot measures it.

    Levels of ArduPilot and PX4 are not comparable, since they measure them in different ways.
    """

    level: Numbers
    """Mean level of the first IMU, m/s²: along x, y and z for ArduPilot, one number for PX4."""
    clips: int
    """How often the accelerometer that clipped most was out of its range."""
    imu_levels: Numbers
    """Mean level of each IMU along the axis that vibrates most, m/s²."""


@dataclass(frozen=True)
class BatteryFigures:
    """Voltage and current of one battery over some time."""

    number: int
    """Number of the battery, from 1."""
    voltage_start: float
    """Median of the first ``AVERAGING_SECONDS``, V."""
    voltage_end: float
    """Median of the last ``AVERAGING_SECONDS``, V."""
    voltage_mean: float
    """Mean of all samples, V."""
    voltage_min: float
    """Lowest sample, V."""
    current_mean: float | None = None
    """Mean of all samples, A; None if the current was not measured."""
    current_max: float | None = None
    """Largest sample, A; None if the current was not measured."""


@dataclass(frozen=True)
class Condition(ImmutableResult):
    """Means, spreads and limits of a vehicle in a log, which hold for any rate from 1 Hz.

    Figures are of settled flight unless they say otherwise, and None or empty if they were not recorded.
    """

    duration: float
    """Duration of the log over all boots, s."""
    armed: float | None = None
    """Time with armed motors, s."""
    settled: float = 0.0
    """Time of settled flight, s."""
    hover: HoverFigures | None = None
    """Outputs of each motor."""
    share_interval: tuple[float | None, ...] = ()
    """Half widths of the 90 % intervals of the motors' ``hover.trim_share``, within this flight, not between flights;
    None for a flight that is too short."""
    command: dict[str, MeanFigure] = field(default_factory=dict)
    """For each axis whose mixer is known, the combination of the motors that turns it, as a fraction of their range:
    positive to the right, nose up, nose to the right. It balances a shifted load, steady wind or a weak motor."""
    lean: dict[str, MeanFigure] = field(default_factory=dict)
    """Roll and pitch, rad."""
    tilt_mean: float | None = None
    """Mean angle of the body's vertical axis from the vertical, rad."""
    tilt_sd: float | None = None
    """Standard deviation of that angle, rad."""
    tilt_max: float | None = None
    """Largest such angle, rad."""
    vibration: VibrationFigures | None = None
    """Vibration and clipping, as the autopilot measures them."""
    batteries: tuple[BatteryFigures, ...] = ()
    """Of each battery, the emptiest first; of the whole record, if there was no settled flight."""
    oscillation: Oscillation | None = None
    """A limit cycle in settled flight or, if there is none, in all flight; None also if it was not searched for."""

    @property
    def battery(self) -> BatteryFigures | None:
        """The emptiest battery; None if none was measured."""
        return self.batteries[0] if self.batteries else None

    @property
    def collective(self) -> float | None:
        """Mean output of all motors in settled flight, as a fraction of their range."""
        if self.hover is None:
            return None
        return float(np.mean(self.hover.trim_of_range))


def measure_condition(signals: Signals, *, with_oscillation: bool = True) -> Condition:
    """Measures the condition of a vehicle: motors, lean, vibration, battery and oscillation, mostly in settled flight.

    Args:
        signals: signals of the vehicle. They may have been prepared for a model whose inputs are not the motors'
            outputs but, for example, torque setpoints; the figures of the motors are always made of the outputs.
        with_oscillation: whether the flight is searched for a limit cycle, which takes most of the time.

    Returns:
        The condition. Figures of quantities that were not recorded are None or empty.
    """
    if signals.inputs != "motors":
        signals = signals.for_axis("roll", "motors")
    recorded_segments = recorded_spans(signals)
    settled_segments = settled_flight(signals)

    # Outputs of the motors in the hover, and what follows from them.
    try:
        hover = hover_of(signals)
    except NotLearnable:
        hover = None
    share_intervals: tuple[float | None, ...] = ()
    commands: dict[str, MeanFigure] = {}
    if hover is not None:
        assert signals.motors is not None
        share_intervals = _trim_intervals(signals.motors, settled_segments)
        commands = _mean_commands(signals.motors, settled_segments)

    tilt = _tilt_in_settled_flight(signals, settled_segments)
    return Condition(
        duration=total_duration(recorded_segments),
        armed=_armed_seconds(signals),
        settled=total_duration(settled_segments),
        hover=hover,
        share_interval=share_intervals,
        command=commands,
        lean=_mean_lean(signals, settled_segments),
        tilt_mean=tilt.mean() if len(tilt) else None,
        tilt_sd=tilt.std() if len(tilt) else None,
        tilt_max=tilt.max() if len(tilt) else None,
        vibration=_vibration_figures(signals, settled_segments),
        batteries=_figures_of_batteries(signals, settled_segments or recorded_segments),
        oscillation=_find_oscillation(signals, settled_segments) if with_oscillation else None,
    )


def _armed_seconds(signals: Signals) -> float | None:
    """Returns for how long the motors were armed in all boots of a log, s.

    It is None if the log does not show it, and if the clock jumped meanwhile (``MAX_FLIGHT_SECONDS``).
    """
    if signals.armed is None:
        return None
    armed_segments = segments_of_boots(signals, flight_states.armed_intervals)
    if any(segment.duration > MAX_FLIGHT_SECONDS for segment in armed_segments):
        return None
    return total_duration(armed_segments)


def _find_oscillation(signals: Signals, settled_segments: Segments) -> Oscillation | None:
    """Looks for a limit cycle of the vehicle's motors and tilt, first in settled flight and then in all flight.

    All flight is searched too because a vehicle may swing so much that its flight does not count as settled. If the
    attitude is logged too slowly to show the frequency, the gyro may show it (:func:`with_unaliased_frequency`).

    Args:
        signals: logged time series of the vehicle, such as attitude, setpoints and motor outputs.
        settled_segments: segments of settled flight: armed, off the ground, without climbs.

    Returns:
        The limit cycle, in settled flight if there is one; None if the vehicle does not oscillate, or is not a
        multirotor.
    """
    if signals.telemetry.vehicle not in POSSIBLE_MULTIROTORS:
        # The outputs of other vehicles drive control surfaces, wheels or a rudder too.
        return None
    # A log without yaw has the attitudes of the first axes only.
    attitudes = dict(zip(AXES, signals.attitudes, strict=False))
    oscillation = detect_limit_cycle(signals.motors, attitudes, settled_segments)
    if oscillation is None:
        airborne_segments = segments_of_boots(signals, flight_states.airborne_intervals)
        oscillation = detect_limit_cycle(signals.motors, attitudes, airborne_segments)
    if oscillation is None:
        return None
    cycles = []
    for cycle in (oscillation, *oscillation.other_axes):
        gyro = recorded_series(signals.telemetry, GYRO_MESSAGE, GYRO_FIELDS[cycle.axis])
        cycles.append(with_unaliased_frequency(cycle, attitudes[cycle.axis], gyro))
    strongest, *others = cycles
    return strongest._replace(other_axes=tuple(others))


def _trim_intervals(motors: MotorOutputs, settled_segments: Segments) -> tuple[float | None, ...]:
    """Returns the uncertainty of the trim of each motor: its mean output relative to the mean of all motors.

    With the output u_i of motor i, and the mean m of the outputs of all motors at the same time, the trim is the ratio
    of means E[u_i]/E[m]; it is 1 for a motor that does as much as the others. To first order (delta method) the error
    of this ratio is the mean of (u_i − m E[u_i]/E[m])/E[m], whose interval follows from its samples.

    Args:
        motors: outputs of k motors.
        settled_segments: segments of settled flight: armed, off the ground, without climbs.

    Returns:
        Half width of the 90 % interval for each motor (k,); None if the flight is too short for one.
    """
    outputs = _range_fractions(motors, settled_segments)
    duration = total_duration(settled_segments)
    # The mean m of all motors at each time (N, 1), and E[m].
    outputs_of_mean_motor = outputs.mean(axis=1, keepdims=True)
    mean_output = outputs_of_mean_motor.mean()
    trims = outputs.mean(axis=0) / mean_output
    half_widths = []
    # The motors are processed one by one to save memory: in hours of flight, one such array is as large as the log.
    for motor, trim in enumerate(trims):
        output = outputs[:, motor, np.newaxis]
        errors = (output - outputs_of_mean_motor * trim) / mean_output
        half_widths += mean_interval(errors, duration).tolist()
    return tuple(map(finite_or_none, half_widths))


def _mean_commands(motors: MotorOutputs, settled_segments: Segments) -> dict[str, MeanFigure]:
    """Returns the mean command about each axis in settled flight, with its interval.

    A command about an axis is the combination of the motors' outputs that turns the vehicle about it: the outputs times
    the row of the mixer. In steady flight its mean is not 0 if a load is off centre, a motor is weak, or wind pushes.

    Args:
        motors: outputs of k motors, with the geometry of the frame.
        settled_segments: segments of settled flight: armed, off the ground, without climbs.

    Returns:
        Figures by axis, as fractions of the motors' range; axes whose row of the mixer is not known are left out.
    """
    outputs = _range_fractions(motors, settled_segments)
    commands = {}
    for axis in AXES:
        mixer_row = motors.geometry.mixer_row(axis)
        if mixer_row is not None:
            commands[axis] = mean_figure(outputs @ mixer_row, total_duration(settled_segments))
    return commands


def _range_fractions(motors: MotorOutputs, segments: Segments) -> Array:
    """Returns the outputs (N, k) of k motors in some segments, as fractions of their range, 0 to 1."""
    return motors.scale.fraction(motors.outputs[in_segments(motors, *segments, slack=0)])


def _roll_and_pitch(signals: Signals, segments: Segments) -> list[Array]:
    """Returns roll and pitch in some segments, (N,) rad each; nothing if one of them was not recorded there."""
    angles = [tilt.angle[in_segments(tilt, *segments, slack=0)] for tilt in signals.tilts]
    if len(angles) < len(TILT_AXES) or not all(map(len, angles)):
        return []
    return angles


def _mean_lean(signals: Signals, settled_segments: Segments) -> dict[str, MeanFigure]:
    """Returns the means of roll and pitch in settled flight, rad, by axis; empty if they were not recorded there."""
    angles = _roll_and_pitch(signals, settled_segments)
    duration = total_duration(settled_segments)
    return {
        axis: mean_figure(angle, duration) for axis, angle in zip(TILT_AXES, angles, strict=False)
    }


def _tilt_in_settled_flight(signals: Signals, settled_segments: Segments) -> Array:
    """Returns the tilt in settled flight: the angle between the vehicle's vertical axis and the vertical.

    It follows from cos(tilt) = cos(roll) cos(pitch).

    Args:
        signals: logged time series of the vehicle, such as attitude, setpoints and motor outputs.
        settled_segments: segments of settled flight: armed, off the ground, without climbs.

    Returns:
        Tilt at each sample of settled flight (N,), rad; empty if roll or pitch is not known.
    """
    angles = _roll_and_pitch(signals, settled_segments)
    if not angles:
        return np.zeros(0)
    # Both angles come in the same messages: they differ in length only if a damaged value was left out.
    sample_count = min(map(len, angles))
    roll, pitch = (angle[:sample_count] for angle in angles)
    return np.arccos(np.clip(np.cos(roll) * np.cos(pitch), -1, 1))


def _vibration_figures(signals: Signals, settled_segments: Segments) -> VibrationFigures | None:
    """Returns the vibration of the vehicle in settled flight, as the autopilot measures and reports it.

    An IMU clips when the vehicle shakes it so much that the acceleration is beyond its range.

    Args:
        signals: logged time series of the vehicle, such as attitude, setpoints and motor outputs.
        settled_segments: segments of settled flight: armed, off the ground, without climbs.

    Returns:
        Mean level along each axis of the first IMU, m/s², number of clips of the IMU that clipped most, and the level
        of each IMU along its worst axis. None if vibration was not recorded in settled flight.
    """
    vibration = reported_vibration(signals)
    if vibration is None:
        return None
    is_settled = in_segments(vibration.levels, *settled_segments, slack=0)
    if not is_settled.any():
        return None
    # Columns are the axes of the first IMU, then the axes of the others.
    mean_levels = vibration.levels.values[is_settled].mean(axis=0)
    levels_of_first_imu = mean_levels[: len(vibration.axes)]
    return VibrationFigures(
        tuple(levels_of_first_imu),
        vibration.most_clips(is_settled),
        imu_levels=tuple(vibration.largest_of_axes(mean_levels)),
    )


def _figures_of_batteries(signals: Signals, segments: Segments) -> tuple[BatteryFigures, ...]:
    """Returns voltage and current of each battery in some segments, the emptiest battery first.

    Args:
        signals: logged time series of the vehicle, such as attitude, setpoints and motor outputs.
        segments: segments of the flight that are evaluated.

    Returns:
        Figures of each battery that was recorded in the segments.
    """
    figures = []
    for battery in batteries_worst_first(signals):
        battery_figures = _battery_figures(battery, segments)
        if battery_figures is not None:
            figures.append(battery_figures)
    return tuple(figures)


def _battery_figures(battery: Battery, segments: Segments) -> BatteryFigures | None:
    """Returns voltage and current of a battery in some segments.

    Voltages at start and end are medians over ``AVERAGING_SECONDS``, since the load, and with it the voltage, varies.

    Args:
        battery: voltage, current and charge of the battery over time.
        segments: segments of the flight that are evaluated; the first and the last may be in different boots.

    Returns:
        Voltages in V and currents in A. The currents are None if no current was measured. The result is None if the
        voltage was not recorded in these segments.
    """
    is_in_segment = in_segments(battery.voltage, *segments, slack=0)
    if not is_in_segment.any():
        return None
    time = battery.voltage.time[is_in_segment]
    boot = battery.voltage.boot[is_in_segment]
    voltage = battery.voltage.values[is_in_segment]
    is_at_start = (boot == boot[0]) & (time <= time[0] + AVERAGING_SECONDS)
    is_at_end = (boot == boot[-1]) & (time >= time[-1] - AVERAGING_SECONDS)
    current = _measured_current(battery, segments)
    return BatteryFigures(
        number=battery.number,
        voltage_start=np.median(voltage[is_at_start]),
        voltage_end=np.median(voltage[is_at_end]),
        voltage_mean=voltage.mean(),
        voltage_min=voltage.min(),
        current_mean=None if current is None else current.mean(),
        current_max=None if current is None else current.max(),
    )


def _measured_current(battery: Battery, segments: Segments) -> Array | None:
    """Returns the current of a battery in some segments, A; None if it was not measured there.

    Args:
        battery: voltage, current and charge of the battery over time.
        segments: segments of the flight that are evaluated.
    """
    if battery.current is None:
        return None
    current = battery.current.values[in_segments(battery.current, *segments, slack=0)]
    # A negative current means "not measured". A current of 0 in flight means a sensor that is missing or not
    # calibrated.
    is_measured = len(current) > 0 and current.min() > 0
    return current if is_measured else None
