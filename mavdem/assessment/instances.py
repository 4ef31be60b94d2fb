"""Instances of the batteries, estimators, sensors and outputs, with facts (coded findings) about their state."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from mavdem.arrays import Array
from mavdem.assessment.battery_levels import batteries_worst_first
from mavdem.assessment.evidence import Evidence
from mavdem.assessment.innovations import (
    INNOVATION_LIMIT,
    INNOVATIONS,
    failsafe_innovation_limit,
    innovation_ratios,
    instance_name,
    longest_rejection,
)
from mavdem.assessment.lights.power import (
    POWER_REPORTS,
    batteries_in_flight,
    judge_battery_voltage,
)
from mavdem.assessment.limits import worst_fact
from mavdem.dataset.batteries import battery_name
from mavdem.dataset.flight_states import min_running_command
from mavdem.dataset.intervals import Intervals, in_intervals
from mavdem.dataset.position_fix import (
    RECEIVER_MESSAGES,
    UNKNOWN_SATELLITES,
    is_position_fix,
)
from mavdem.dataset.speed_controllers import SpeedController, speed_controllers
from mavdem.dataset.time_series import (
    TimeSeries,
    clean_series,
    float_columns,
    recorded_series,
    series_of_boot,
)
from mavdem.facts import Fact, Level
from mavdem.facts.ending import MotionEvent
from mavdem.facts.instances import InstanceState
from mavdem.immutable import ImmutableResult
from mavdem.ingest.motors import name_without_place
from mavdem.ingest.telemetry import Telemetry
from mavdem.ingest.vocabulary import INSTANCES_MESSAGE
from mavdem.vibration.vibration_message import reported_clips, reported_vibration
from mavdem.witnesses.accelerometer import SELECTED_IMU, AccelerometerRecord
from mavdem.witnesses.height import MAX_HEIGHT_DIFFERENCE
from mavdem.witnesses.sensors import (
    BAROMETER_PARAMETER,
    BAROMETERS,
    compass_fields,
    is_compass_used,
    primary_barometer,
)

USED_COLUMN = len(INNOVATIONS)
"""Column of the samples of an estimator with 1 while the autopilot used it, after the innovation ratios."""

LARGEST_QUANTILE = 0.95
"""Quantile that is used as the largest difference of two altitudes, without single damaged samples."""

MAX_ERROR_RATE = 1.0
"""Errors per second of a speed controller in flight above which it is to be watched; a choice."""


@dataclass(frozen=True)
class Instance(ImmutableResult):
    """One of the batteries, estimators, sensors or outputs of a vehicle."""

    kind: str
    """What it is: battery, estimator, receiver, barometer, compass, IMU, speed controller or output."""
    name: str
    """Its name with its number as the autopilot counts it: "battery 2", "EKF core 1"."""
    quantity: str
    """What it measures."""
    unit: str
    """Unit of ``low`` and ``high``."""
    low: float
    """Lowest value in flight; in the whole log if there was no flight."""
    high: float
    """Highest value then."""
    state: Fact
    """What is known of it, with its level."""
    used_share: float | None = None
    """Fraction of the samples in flight in which the autopilot used it, 0 to 1; None if the log does not show it."""


def list_instances(evidence: Evidence) -> tuple[Instance, ...]:
    """Returns all batteries, estimators, sensors and outputs that a log has of a vehicle, an instance for each.

    Args:
        evidence: signals of the vehicle and what was measured of them.

    Returns:
        The instances. Batteries come first, the emptiest one at the top.
    """
    return (
        *_battery_instances(evidence),
        *_estimator_instances(evidence),
        *_receiver_instances(evidence),
        *_barometer_instances(evidence),
        *_compass_instances(evidence),
        *_imu_instances(evidence),
        *_speed_controller_instances(evidence),
        *_output_instances(evidence),
    )


def _values_in_flight(evidence: Evidence, series: TimeSeries) -> Array:
    """Selects the samples of a series in flight, while the motors carried the vehicle (:func:`_carried_intervals`).

    Args:
        evidence: signals of the vehicle, with its flights.
        series: (N,) or (N, k) samples of all boots; a boot lasts from one start of the autopilot to the next.

    Returns:
        The n selected samples, (n,) or (n, k), one flight after another; all samples if none is in flight.
    """
    values_of_flights = []
    for flight_series in evidence.in_flight(series):
        # All samples of a flight are of the same boot.
        boot = int(flight_series.boot[0])
        is_carried = in_intervals(flight_series.time, _carried_intervals(evidence, boot))
        if is_carried.any():
            values_of_flights.append(flight_series.values[is_carried])
    if not values_of_flights:
        return series.values
    return np.concatenate(values_of_flights)


def _carried_intervals(evidence: Evidence, boot: int) -> Intervals:
    """Returns the time of each flight of a boot in which the motors carried the vehicle.

    It lasts from the first to the last sample with a mean command above idle. Some autopilots report a vehicle as off
    the ground while its motors still spin up, and as landed only after they have slowed.

    Args:
        evidence: what the log shows of the vehicle.
        boot: number of the boot; a boot lasts from one start of the autopilot to the next.

    Returns:
        Intervals, s since boot. They are the flights themselves if motors are not known, or were never above idle.
    """
    flights = evidence.flights(boot)
    motors = evidence.signals.motors
    if motors is None or evidence.other_vehicle is not None:
        return flights
    collective = motors.collective.of_boot(boot)
    carries_vehicle = collective.values > min_running_command(motors)
    intervals = []
    for flight in flights:
        carrying_times = collective.time[in_intervals(collective.time, [flight]) & carries_vehicle]
        if len(carrying_times):
            intervals.append((float(carrying_times[0]), float(carrying_times[-1])))
    return intervals or flights


def _measured_state(values: Array) -> Fact:
    """Returns the fact about whether an instance of a sensor measured anything: then its value is not constant.

    Args:
        values: (N,) samples.

    Returns:
        A fact with the code CONSTANT or MEASURED.
    """
    is_constant = len(values) > 1 and np.ptp(values) == 0
    return Fact(InstanceState.CONSTANT if is_constant else InstanceState.MEASURED)


def _battery_instances(evidence: Evidence) -> Iterator[Instance]:
    """Yields the batteries with their voltages, V, judged by the same limits as the status light "power".

    The state of a battery is the worst of these facts: its voltage in flight, and the autopilot's warnings about it. If
    there are none, the state only says whether the voltage was measured.

    Args:
        evidence: signals of the vehicle and what was measured of them.
    """
    measured_batteries = batteries_in_flight(evidence)
    warnings = list(evidence.warnings_in_flight(POWER_REPORTS))
    for battery in batteries_worst_first(evidence.signals):
        name = battery_name(battery.number)
        volts = _values_in_flight(evidence, battery.voltage)
        facts = [fact for fact in warnings if fact.subject == name]
        if battery in measured_batteries:
            facts.append(judge_battery_voltage(evidence, battery))
        state = worst_fact(facts) if facts else _measured_state(volts)
        yield Instance(
            kind="battery",
            name=name,
            quantity="voltage",
            unit="V",
            low=volts.min(),
            high=volts.max(),
            state=state,
        )


def _estimator_instances(evidence: Evidence) -> Iterator[Instance]:
    """Yields the instances of the estimator with their innovation ratios, and for how much of the time each was used.

    At each sample the largest ratio of all innovations is used, relative to the limit of the estimator's own test. An
    innovation is a measurement minus its prediction.

    Args:
        evidence: signals, events and measurements of the vehicle.
    """
    for name, samples in _estimator_samples(evidence.signals.telemetry).items():
        if not len(samples.time):
            continue
        values = _values_in_flight(evidence, samples)
        ratios = values[:, : len(INNOVATIONS)]
        used_share = float(values[:, USED_COLUMN].mean())
        largest_ratios = ratios.max(axis=1) / INNOVATION_LIMIT
        yield Instance(
            kind="estimator",
            name=name,
            quantity="innovation over its limit",
            unit="1",
            low=largest_ratios.min(),
            high=largest_ratios.max(),
            state=_estimator_state(evidence, samples, used_share),
            used_share=used_share,
        )


def _estimator_samples(telemetry: Telemetry) -> dict[str, TimeSeries]:
    """Returns the innovation ratios of each instance of the estimator, by its name.

    Args:
        telemetry: messages of the vehicle as columns, and its parameters.

    Returns:
        Samples (N, 5) of each instance: the ratios in the order of ``INNOVATIONS``, and in the last column 1 while the
        autopilot used the instance, otherwise 0.
    """
    columns = telemetry.messages.get(INSTANCES_MESSAGE, {})
    if not columns:
        # A log that does not tell the instances apart has the ratios of the one in use.
        series = innovation_ratios(telemetry)
        if series is None:
            return {}
        ratios = series.values[:, : len(INNOVATIONS)]
        is_always_used = np.ones(len(ratios))
        return {"EKF": replace(series, values=np.column_stack([ratios, is_always_used]))}
    ratios_of_all_instances = np.nan_to_num(float_columns(columns, INNOVATIONS))
    is_used = columns["is_primary"] > 0
    samples_of_all_instances = np.column_stack([ratios_of_all_instances, is_used])
    samples_by_name = {}
    for number in np.unique(columns["instance"]).tolist():
        is_of_instance = columns["instance"] == number
        name = f"EKF {instance_name(telemetry, int(number))}"
        samples_by_name[name] = clean_series(columns, samples_of_all_instances, is_of_instance)
    return samples_by_name


def _estimator_state(evidence: Evidence, samples: TimeSeries, used_share: float) -> Fact:
    """Judges whether an instance of the estimator rejected measurements in flight.

    Args:
        evidence: signals, events and measurements of the vehicle.
        samples: its innovation ratios, as :func:`_estimator_samples` returns them.
        used_share: fraction of the time in which the autopilot used the instance.

    Returns:
        A fact with the code REJECTED or MEASURED. A rejection is bad only if the instance was used in flight.
    """
    failsafe_limit = failsafe_innovation_limit(evidence.signals.telemetry)
    rejections = []
    for flight in evidence.in_flight(samples):
        ratios = flight.values[:, : len(INNOVATIONS)]
        rejections.append(longest_rejection(flight.time, ratios, failsafe_limit))
    if not any(rejection.is_rejected_long for rejection in rejections):
        return Fact(InstanceState.MEASURED)
    triggers_failsafe = any(rejection.triggers_failsafe for rejection in rejections)
    is_bad = triggers_failsafe and used_share > 0
    return Fact(InstanceState.REJECTED, Level.BAD if is_bad else None)


def _receiver_instances(evidence: Evidence) -> Iterator[Instance]:
    """Yields the satellite receivers with their numbers of satellites, and whether they had a position fix.

    A receiver that does not report the number of satellites is listed by its type of fix.

    Args:
        evidence: signals, events and measurements of the vehicle.
    """
    telemetry = evidence.signals.telemetry
    for number, message in enumerate(RECEIVER_MESSAGES, 1):
        satellites = recorded_series(telemetry, message, "satellites_visible", "fix_type")
        if satellites is None:
            continue
        counts, fix_types = _values_in_flight(evidence, satellites).T
        has_fix = is_position_fix(fix_types, counts)
        state = Fact(InstanceState.MEASURED)
        if not has_fix.all():
            state = Fact(InstanceState.WITHOUT_FIX, share=1 - has_fix.mean())
        quantity = "satellites"
        listed_numbers = counts[counts != UNKNOWN_SATELLITES]
        if not len(listed_numbers):
            quantity = "fix type"
            listed_numbers = fix_types
        yield Instance(
            kind="receiver",
            name=f"GPS {number}",
            quantity=quantity,
            unit="1",
            low=listed_numbers.min(),
            high=listed_numbers.max(),
            state=state,
        )


def _barometer_instances(evidence: Evidence) -> Iterator[Instance]:
    """Yields the barometers with their altitude in flight, m, or their pressure, hPa, if the log has no altitude.

    ArduPilot's ``BAROMETER_PARAMETER`` names the one in use; without it, that is not known. The altitude of every other
    barometer is compared with the barometer in use, or with the first one.

    Args:
        evidence: signals, events and measurements of the vehicle.
    """
    telemetry = evidence.signals.telemetry
    number_in_use = telemetry.parameters.get(BAROMETER_PARAMETER)
    reference_number = primary_barometer(telemetry)
    for number, message in enumerate(BAROMETERS):
        quantity, unit = "altitude", "m"
        measured = recorded_series(telemetry, message, "altitude")
        if measured is None:
            quantity, unit = "pressure", "hPa"
            measured = recorded_series(telemetry, message, "press_abs")
        if measured is None:
            continue
        values_in_flight = _values_in_flight(evidence, measured)
        state = _measured_state(values_in_flight)
        if quantity == "altitude" and number != reference_number:
            disagreement = _disagreement_with_barometer(evidence, measured, reference_number)
            if disagreement is not None:
                state = disagreement
        fraction_of_use = None
        if number_in_use is not None:
            fraction_of_use = float(number == number_in_use)
        yield Instance(
            kind="barometer",
            name=f"barometer {number + 1}",
            quantity=quantity,
            unit=unit,
            low=values_in_flight.min(),
            high=values_in_flight.max(),
            state=state,
            used_share=fraction_of_use,
        )


def _disagreement_with_barometer(
    evidence: Evidence, altitude: TimeSeries, reference_number: int
) -> Fact | None:
    """Returns the state of a barometer whose altitude in flight contradicts another barometer; None if they agree.

    Args:
        evidence: signals, events and measurements of the vehicle.
        altitude: (N,) altitude of the barometer, m.
        reference_number: number of the other barometer, from 0.
    """
    reference_message = BAROMETERS[reference_number]
    reference = recorded_series(evidence.signals.telemetry, reference_message, "altitude")
    if reference is None:
        return None
    difference = _largest_difference(evidence, altitude, reference)
    if difference <= MAX_HEIGHT_DIFFERENCE:
        return None
    # Messages are numbered from 0, names of barometers from 1.
    reference_name = f"barometer {reference_number + 1}"
    return Fact(InstanceState.DISAGREES, height=difference, name=reference_name)


def _largest_difference(evidence: Evidence, altitude: TimeSeries, reference: TimeSeries) -> float:
    """Returns the largest difference of two barometers in a flight, without their constant offset.

    The offset is the median difference in the flight. The quantile ``LARGEST_QUANTILE`` is used instead of the maximum,
    which a single damaged sample would decide.

    Args:
        evidence: signals, events and measurements of the vehicle.
        altitude: (N,) altitude of one barometer, m.
        reference: (M,) altitude of another barometer, m, with which it is compared.

    Returns:
        The largest difference of all flights, m; 0 without a flight in which both were recorded.
    """
    largest_difference = 0.0
    for flight in evidence.in_flight(altitude):
        reference_of_boot = series_of_boot(reference, int(flight.boot[0]))
        if reference_of_boot is not None:
            reference_altitude = np.interp(
                flight.time, reference_of_boot.time, reference_of_boot.values
            )
            difference = flight.values - reference_altitude
            deviation = abs(difference - np.median(difference))
            largest_difference = max(
                largest_difference, float(np.quantile(deviation, LARGEST_QUANTILE))
            )
    return largest_difference


def _compass_instances(evidence: Evidence) -> Iterator[Instance]:
    """Yields the compasses with the strength of the magnetic field that they measure, mGauss.

    ArduPilot's parameters COMPASS_USE, COMPASS_USE2 and so on say which ones are used; without them, that is not known.

    Args:
        evidence: signals, events and measurements of the vehicle.
    """
    telemetry = evidence.signals.telemetry
    for number, field in compass_fields(evidence.signals).items():
        strength = np.linalg.norm(_values_in_flight(evidence, field), axis=1)
        is_used = is_compass_used(telemetry, number)
        yield Instance(
            kind="compass",
            name=f"compass {number}",
            quantity="field",
            unit="mGauss",
            low=strength.min(),
            high=strength.max(),
            state=_measured_state(strength),
            used_share=None if is_used is None else float(is_used),
        )


def _imu_instances(evidence: Evidence) -> Iterator[Instance]:
    """Yields the IMUs with their vibration in flight, m/s²: what the autopilot reports for the most shaken axis.

    If the vibration of an IMU is not reported, the magnitude of its specific force, m/s², is used instead. The state of
    an IMU is the first of these that applies: its accelerometer did not measure gravity at rest; it clipped, that is
    the acceleration exceeded its range; or whether it measured anything.

    Args:
        evidence: signals, events and measurements of the vehicle.
    """
    vibrations = _vibrations_by_imu(evidence)
    accelerometers = _accelerometers_by_imu(evidence)
    clipping_facts = _clipping_by_imu(evidence)
    for number in sorted(vibrations.keys() | accelerometers.keys()):
        accelerometer = accelerometers.get(number)
        if number in vibrations:
            quantity = "vibration"
            values_in_flight = vibrations[number]
        else:
            assert accelerometer is not None
            quantity = "specific force"
            values_in_flight = _values_in_flight(evidence, accelerometer.force_size)
        state = clipping_facts.get(number, _measured_state(values_in_flight))
        if accelerometer is not None and accelerometer.record.is_sound is False:
            # A wrong accelerometer that the autopilot does not use is no danger, so its level is unknown.
            level = Level.UNKNOWN if accelerometer.record.is_used is False else None
            gravity = accelerometer.record.gravity_at_rest
            state = Fact(InstanceState.GRAVITY_WRONG, level, acceleration=gravity)
        yield Instance(
            kind="IMU",
            name=f"IMU {number}",
            quantity=quantity,
            unit="m/s²",
            low=values_in_flight.min(),
            high=values_in_flight.max(),
            state=state,
            used_share=None if accelerometer is None else accelerometer.used_share,
        )


class _AccelerometerOfBoot(NamedTuple):
    """The accelerometer of an IMU in one boot."""

    record: AccelerometerRecord
    """What it measured."""

    boot: int
    """Number of the boot."""

    used_share: float | None
    """1 if the autopilot used it, 0 if not; None if the log does not show that."""

    @property
    def force_size(self) -> TimeSeries:
        """Size of the specific force (N,), m/s²."""
        time = self.record.time
        return TimeSeries(time, np.full(len(time), self.boot), self.record.magnitude)


def _accelerometers_by_imu(evidence: Evidence) -> dict[int, _AccelerometerOfBoot]:
    """Returns the accelerometers of a log by the number of their IMU, from 1, each in the last boot that recorded it.

    If a boot has several, the one that the estimator uses has the ``used_share`` 1, and one that parameters switch off
    has 0. For all others it is not known.

    Args:
        evidence: signals of the vehicle and what was measured of them.
    """
    accelerometers = dict[int, _AccelerometerOfBoot]()
    for sensor_trust in evidence.trust:
        has_several = len(sensor_trust.accelerometers) > 1
        for record in sensor_trust.accelerometers:
            used_share = None
            if record is sensor_trust.accelerometer and has_several:
                used_share = 1.0
            elif record.is_used is False:
                used_share = 0.0
            accelerometers[record.number] = _AccelerometerOfBoot(
                record, sensor_trust.boot, used_share
            )
    # The accelerometer that PX4 selects at each time is one of the numbered ones, which are listed.
    accelerometers.pop(SELECTED_IMU, None)
    return accelerometers


def _vibrations_by_imu(evidence: Evidence) -> dict[int, Array]:
    """Returns the vibration of each IMU in flight.

    Args:
        evidence: signals, events and measurements of the vehicle.

    Returns:
        By the number of the IMU, from 1, its largest level of all axes (N,), m/s²; empty if vibration was not reported.
    """
    vibration = reported_vibration(evidence.signals)
    if vibration is None:
        return {}
    levels = _values_in_flight(evidence, vibration.levels)
    levels_of_imus = vibration.largest_of_axes(levels)
    return dict(enumerate(levels_of_imus.T, start=1))


def _clipping_by_imu(evidence: Evidence) -> dict[int, Fact]:
    """Returns which IMUs clipped, that is how often the acceleration exceeded the range of their accelerometers.

    An event says when accelerometers clipped, but not which ones. So the clips of each IMU are counted in these times.

    Args:
        evidence: signals and events of the vehicle. The events in which an accelerometer clipped include the fall after
            a loss.

    Returns:
        For each IMU that clipped, by its number from 1, a fact (a coded finding) with the number of clips as ``count``.
        It lasts from the first event in which this IMU clipped to the last one.
    """
    clips = reported_clips(evidence.signals)
    facts = dict[int, Fact]()
    if clips is None:
        return facts
    for event in evidence.events:
        if event.code is not MotionEvent.CLIPPED or event.end_time is None:
            continue
        event_interval = (event.start_time, event.end_time)
        clips_of_event = clips.of_boot(event.figures["boot"]).within(event_interval)
        # The samples have a row for each time, and a column for each IMU.
        for number, count in enumerate(clips_of_event.values.sum(axis=0), start=1):
            if not count:
                continue
            clipping = Fact(
                InstanceState.CLIPPED, time=event.time, end_time=event.end_time, count=int(count)
            )
            if number in facts:
                clipping = _joined_clipping(facts[number], clipping)
            facts[number] = clipping
    return facts


def _joined_clipping(earlier: Fact, later: Fact) -> Fact:
    """Returns one fact that an IMU clipped in two events, from the start of the first to the end of the second.

    Args:
        earlier: the fact about the first event, with the number of clips as ``count``.
        later: the fact about the second event.
    """
    total_count = earlier.figures["count"] + later.figures["count"]
    return earlier.replace(end_time=later.end_time, count=total_count)


def _speed_controller_instances(evidence: Evidence) -> Iterator[Instance]:
    """Yields the speed controllers with the speed of their motor in flight, 1/min.

    The state of a controller is the first of these that applies: its motor stood still although it was commanded to
    turn; the controller counted errors; or whether it measured anything.

    Args:
        evidence: signals, events and measurements of the vehicle.
    """
    # The event that the motor of a controller stood still, by the name of the controller.
    standstills = {}
    for event in evidence.warnings_in_flight([MotionEvent.MOTOR_STOOD_STILL]):
        standstills[event.figures["name"]] = event
    for controller in speed_controllers(evidence.signals):
        speeds = _values_in_flight(evidence, controller.speed)
        error_count = _errors_in_flight(evidence, controller)
        if controller.name in standstills:
            standstill = standstills[controller.name]
            state = Fact(InstanceState.STOOD_STILL, standstill.level, time=standstill.time)
        elif error_count:
            seconds = sum(np.ptp(flight.time) for flight in evidence.in_flight(controller.speed))
            level = Level.WATCH if error_count > MAX_ERROR_RATE * seconds else None
            state = Fact(InstanceState.COUNTED_ERRORS, level, count=error_count)
        else:
            state = _measured_state(speeds)
        yield Instance(
            kind="speed controller",
            name=_name_with_motor(evidence, controller),
            quantity="speed",
            unit="1/min",
            low=speeds.min(),
            high=speeds.max(),
            state=state,
        )


def _errors_in_flight(evidence: Evidence, controller: SpeedController) -> int:
    """Returns how many errors a speed controller counted in all flights; 0 if it reports none.

    Args:
        evidence: when the vehicle flew.
        controller: the controller, whose counter of errors grows from its start on.
    """
    count = 0.0
    for flight in evidence.in_flight(controller.error_count):
        count += flight.values[-1] - flight.values[0]
    # A controller that starts anew in flight begins to count at 0 again, so that the difference may be negative.
    return max(int(count), 0)


def _name_with_motor(evidence: Evidence, controller: SpeedController) -> str:
    """Returns the name of a speed controller with its motor, such as "ESC 2 (motor 1)".

    Args:
        evidence: signals of the vehicle, with the geometry of its motors.
        controller: the controller. Without the motor that it drives, only its own name is returned.
    """
    motors = evidence.signals.motors
    motor = None if motors is None else controller.motor_index(motors.geometry)
    if motors is None or motor is None:
        return controller.name
    return f"{controller.name}{_motor_in_brackets(evidence, motors.geometry.names[motor])}"


def _output_instances(evidence: Evidence) -> Iterator[Instance]:
    """Yields the outputs of the autopilot that drive motors, each with its range of commands and its motor.

    For a vehicle that is not a multirotor they are the outputs that change, such as outputs to control surfaces. The
    commands are in the unit of the log, such as µs of a pulse; "1" means no unit. The autopilot uses all of these
    outputs all the time, so that their fraction of use is 1.

    Args:
        evidence: signals, events and measurements of the vehicle.
    """
    motors = evidence.signals.motors
    if motors is None:
        return
    outputs = _values_in_flight(evidence, TimeSeries(motors.time, motors.boot, motors.outputs))
    for name, channel, values in zip(
        motors.geometry.names, motors.geometry.channels, outputs.T, strict=True
    ):
        yield Instance(
            kind="output",
            name=f"output {channel}{_motor_in_brackets(evidence, name)}",
            quantity="command",
            unit=motors.scale.unit or "1",
            low=values.min(),
            high=values.max(),
            state=_measured_state(values),
            used_share=1.0,
        )


def _motor_in_brackets(evidence: Evidence, name: str) -> str:
    """Returns which motor an output or ESC drives, as text to follow its name: " (motor 1)", as in "ESC 3 (motor 1)".

    The text is empty for a vehicle that is not a multirotor, such as a plane.

    Args:
        evidence: all that the log shows of the vehicle.
        name: name of the motor with its place, such as "motor 1 (front right)".
    """
    if evidence.other_vehicle is not None:
        return ""
    return f" ({name_without_place(name)})"
