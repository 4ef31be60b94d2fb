"""Status light of the estimator, judged by facts (coded findings): its innovations in flight, GPS fixes, compass."""

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np

from mavdem.arrays import Flags
from mavdem.assessment.evidence import Evidence
from mavdem.assessment.gps_jumps import PositionJumps, position_jumps
from mavdem.assessment.impossible_steps import impossible_steps
from mavdem.assessment.innovations import (
    FAILSAFE_SECONDS,
    GLITCH_COLUMN,
    INNOVATIONS,
    Rejection,
    failsafe_innovation_limit,
    finite_ratios,
    innovation_ratios,
    instance_name,
    is_low_passed,
    longest_rejection,
)
from mavdem.assessment.limits import worst_fact
from mavdem.assessment.magnetic_field import field_change
from mavdem.assessment.position_losses import MODES_WITHOUT_POSITION
from mavdem.dataset.flight_states import MANUAL_THROTTLE_MODES, SURFACE_VEHICLES, mode_intervals
from mavdem.dataset.intervals import (
    in_intervals,
    intersection,
    longest_true_duration,
    true_intervals,
)
from mavdem.dataset.position_fix import (
    FIX_3D,
    RECEIVER_MESSAGES,
    UNKNOWN_DILUTION,
    UNKNOWN_SATELLITES,
    has_other_position_source,
    has_position_fix,
    most_satellites,
)
from mavdem.dataset.segments import recorded_spans
from mavdem.dataset.time_series import (
    TimeSeries,
    clean_series,
    float_columns,
    recorded_series,
)
from mavdem.facts import Code, Fact, Level
from mavdem.facts.ending import MotionEvent
from mavdem.facts.estimator import EstimatorLight
from mavdem.facts.events import ReportedEvent
from mavdem.ingest.telemetry import Telemetry
from mavdem.ingest.vocabulary import INSTANCES_MESSAGE, EstimatorRatio
from mavdem.wind_velocity.from_log import ESTIMATOR_FLAG_MESSAGES, estimator_message
from mavdem.witnesses.position import assumed_standstill, position_fix, position_validity
from mavdem.witnesses.sensors import compass_fields, is_compass_used

WATCHED_RATIO = 2.0
"""Innovation ratio that is to be watched however short it is: ArduCopter's ``ekf_check.cpp`` counts it twice."""


MAX_DILUTION = 2.5
"""HDOP above which PX4's filter does not start with GPS: the default of EKF2_REQ_HDOP."""

MIN_SATELLITES = 6
"""Number of satellites below which PX4's filter does not start with GPS: the default of EKF2_REQ_NSATS."""

FIX_TYPE_COLUMN = 0
"""Column of the type of the fix in the samples of a GPS receiver (:func:`_best_receiver`)."""

SATELLITES_COLUMN = 1
"""Column of the number of satellites in these samples."""

MAX_FIELD_CHANGE = 0.3
"""Relative change of the compass's field by motors and currents up to which ArduPilot's documentation accepts it."""

ESTIMATOR_EVENTS: set[Code] = {
    ReportedEvent.ESTIMATOR_DIVERGED,
    ReportedEvent.ESTIMATOR_SWITCHED,
    ReportedEvent.ESTIMATOR_RESET,
    ReportedEvent.GPS_JUMPED,
    ReportedEvent.GPS_LOST,
    ReportedEvent.SENSOR_FAILED,
    MotionEvent.HEIGHT_DIVERGED,
    MotionEvent.HEIGHT_OFFSET,
    MotionEvent.POSITION_LOST,
    MotionEvent.BAROMETER_DRIFTED,
    MotionEvent.HEIGHTS_DISAGREE,
    MotionEvent.ATTITUDE_INVALID,
}
"""Events in flight that concern the estimator: what the autopilot reports, and estimates that the motion refutes."""


def estimator_light(evidence: Evidence) -> Fact:
    """Judges the state estimator in flight by the worst fact about it; unknown if the log has no measurements of it.

    Of equally bad facts the first in this order is the light:

    1. A barometer that drifted or froze. It comes first, since it is why the filter then rejects the height.
    2. The innovations of the filter (measurements minus predictions).
    3. Glitches of GPS, steps of position or height that no multirotor flies, and instances of the filter that are not
       in use.
    4. Poor or missing GPS fixes.
    5. A compass that the motors disturb, and an accelerometer that is wrong at rest.
    6. Events: an attitude that was not a number, a height or position that was lost, and reports of the autopilot.
    7. A position that the filter only assumed, since it had no sensor of it.

    Args:
        evidence: signals, events and measurements of the vehicle.

    Returns:
        A fact whose level is the colour of the light: good, watch, bad or unknown.
    """
    innovation_facts = _innovation_facts_worst_first(evidence)
    unmeasured_fact = Fact(
        EstimatorLight.ESTIMATOR_UNMEASURED,
        airborne=evidence.was_in_air,
        name=_missing_estimator_message(evidence.signals.telemetry),
    )
    missing_fixes = _missing_fixes(evidence)
    if flew_without_fix(evidence):
        # A flight that needs no GPS may be good without a fix. But the other findings state the number of satellites,
        # since the pilot should know that GPS gave no position.
        figures_without_fix = _figures_without_fix(evidence, missing_fixes[0])
        innovation_facts = [fact.replace(**figures_without_fix) for fact in innovation_facts]
        unmeasured_fact = unmeasured_fact.replace(**figures_without_fix)
        missing_fixes = []
    # ``worst_fact`` takes the first of equally bad facts, so the order matters.
    facts = [
        *evidence.warnings_in_flight([MotionEvent.BAROMETER_DRIFTED]),
        *innovation_facts,
        *_glitch_facts(evidence),
        *impossible_steps(evidence),
        *_spare_instances(evidence),
        *_poor_fixes(evidence),
        *missing_fixes,
        *_compass_disturbances(evidence),
        *_wrong_accelerometers(evidence),
        *evidence.warnings_in_flight(ESTIMATOR_EVENTS),
        # A vehicle without a receiver is flown so on purpose, which must not hide a sensor that is wrong.
        *_assumed_standstills(evidence),
    ]
    return worst_fact(facts or [unmeasured_fact])


def _missing_estimator_message(telemetry: Telemetry) -> str | None:
    """Returns the name of the MAVLink message with the estimator's state that was not received: "ESTIMATOR_STATUS".

    Args:
        telemetry: messages of the vehicle.

    Returns:
        The name, which depends on the autopilot. None if such a message was received, or if the log is the autopilot's
        own, which has no MAVLink messages.
    """
    was_received = any(name in telemetry.messages for name in ESTIMATOR_FLAG_MESSAGES)
    is_log_of_autopilot = bool(telemetry.translated_from)
    if was_received or is_log_of_autopilot:
        return None
    return estimator_message(telemetry.autopilot)


def flew_without_fix(evidence: Evidence) -> bool:
    """Returns whether no satellite receiver had a fix in flight, and the flight did not need one."""
    return bool(_missing_fixes(evidence)) and _could_fly_without_fix(evidence)


def _could_fly_without_fix(evidence: Evidence) -> bool:
    """Returns whether something else than GPS, such as optical flow, gave the position, or no flight mode needed it."""
    return _has_other_position_source(evidence) or _needed_no_position(evidence)


def _figures_without_fix(evidence: Evidence, missing_fix: Fact) -> dict[str, Any]:
    """Returns the figures by which other findings state that GPS gave no position, which the flight did not need.

    Args:
        evidence: signals, events and measurements of the vehicle.
        missing_fix: the fact that no receiver had a fix, with the number of ``satellites``, None if it is not known.

    Returns:
        The number of ``satellites``, 0 if it is not known; and ``is_position_unneeded`` if no other source gave the
        position either, since no flight mode needed one.
    """
    figures: dict[str, Any] = {"satellites": missing_fix.figures["satellites"] or 0}
    if not _has_other_position_source(evidence):
        figures["is_position_unneeded"] = True
    return figures


def _innovation_facts_worst_first(evidence: Evidence) -> list[Fact]:
    """Returns a fact for each flight about the innovations of the estimator instance that was in use, the worst first.

    The flight in which the limits were exceeded for the longest time comes first or, if they were not, the flight with
    the largest innovation.

    Args:
        evidence: signals, events and measurements of the vehicle.
    """
    telemetry = evidence.signals.telemetry
    facts = [
        _innovation_fact(telemetry, flight)
        for flight in evidence.in_flight(innovation_ratios(telemetry))
    ]
    return sorted(
        facts,
        key=lambda fact: (fact.figures["duration"], fact.figures["ratio"]),
        reverse=True,
    )


def _innovation_fact(telemetry: Telemetry, flight: TimeSeries) -> Fact:
    """Returns the fact about how large the innovations of the estimator were in one flight.

    The filter is doubted if one innovation exceeds its own ``INNOVATION_LIMIT`` for ``FAILSAFE_SECONDS``, so that it
    rejects measurements for long. It is bad if ArduCopter's failsafe would have acted. The limit of the failsafe may be
    lower, so that it acts before the filter rejects anything.

    Args:
        telemetry: autopilot, parameters and messages of the vehicle.
        flight: samples (N, 5) of the flight, as :func:`innovation_ratios` returns them.

    Returns:
        A fact whose subject is the name of the instance, if the log has several, with these figures:

        - ``name``: the worst innovation.
        - ``ratio``: its largest ratio to the limit.
        - ``duration``: how long it exceeded the limit without a break, s. If only the failsafe doubts the filter, how
          long the failsafe's condition held; then the fact has the ``failsafe_limit`` too.
        - ``total_duration``: how long it exceeded the limit in all, s, if that is more.
        - ``is_unchecked``: the worst innovation is the height of ArduPilot, which its failsafe does not check.
        - ``is_spare``: the instance in use was not logged, so that another one is judged, which is never bad.
        - ``is_filtered``: the ratios are low-passed, so that single samples may have been larger.
    """
    failsafe_limit = failsafe_innovation_limit(telemetry)
    rejection = longest_rejection(flight.time, flight.values[:, : len(INNOVATIONS)], failsafe_limit)
    instances = telemetry.messages.get(INSTANCES_MESSAGE, {})
    # A log without the primary instance has the innovations of another one, which does not fly the vehicle.
    is_spare = bool(instances) and not instances["is_primary"].any()
    is_doubted = rejection.is_rejected_long or rejection.triggers_failsafe
    # None is the usual level of the code.
    level = None
    if rejection.triggers_failsafe and not is_spare:
        level = Level.BAD
    elif rejection.ratio >= WATCHED_RATIO:
        level = Level.WATCH
    # The fact has these figures only where they are true.
    true_figures = {}
    if rejection.name is EstimatorRatio.HEIGHT and telemetry.autopilot != "PX4":
        true_figures["is_unchecked"] = True
    if is_spare:
        true_figures["is_spare"] = True
    if is_low_passed(telemetry, rejection.name):
        true_figures["is_filtered"] = True
    return Fact(
        EstimatorLight.FILTER_DOUBTED if is_doubted else EstimatorLight.FILTER_AGREED,
        level,
        time=rejection.time,
        subject=_instance_in_flight(telemetry, flight) if instances else "",
        name=rejection.name,
        ratio=rejection.ratio,
        **_durations_of_rejection(rejection, failsafe_limit),
        **true_figures,
    )


def _durations_of_rejection(rejection: Rejection, failsafe_limit: float) -> dict[str, float]:
    """Returns for how long the worst innovation of a flight (measurement minus prediction) exceeded its limit.

    The limit is that of the filter's own test, beyond which it rejects the measurement. ArduCopter's failsafe has
    another limit. The time beyond that is returned only if the filter's test gives no reason to doubt the filter, since
    the innovation failed it too briefly, but the failsafe does.

    Args:
        rejection: the worst innovation, and for how long it exceeded both limits.
        failsafe_limit: innovation, as a ratio to the filter's limit, from which on ArduCopter's failsafe counts time.

    Returns:
        The longest time without a break as ``duration``, s. For the failsafe also its ``failsafe_limit``; for the
        filter's test also the sum of all times as ``total_duration``, s, if that is longer.
    """
    is_doubted_by_failsafe_only = rejection.triggers_failsafe and not rejection.is_rejected_long
    if is_doubted_by_failsafe_only:
        return {"duration": rejection.failsafe_duration, "failsafe_limit": failsafe_limit}
    durations = {"duration": rejection.duration}
    # Durations are printed in whole seconds, so that a smaller difference would not show.
    if round(rejection.total_duration) > round(rejection.duration):
        durations["total_duration"] = rejection.total_duration
    return durations


def _instance_in_flight(telemetry: Telemetry, flight: TimeSeries) -> str:
    """Returns the name of the estimator instance whose innovation ratios were logged for most of a flight.

    The controllers use the primary instance, which may change in flight. A log may contain the ratios of spare
    instances only.

    Args:
        telemetry: messages of the vehicle, with the table of all instances.
        flight: samples of the flight; only its boot and times are used.

    Returns:
        The name, such as "core 1"; empty if no instance was logged during the flight.
    """
    columns = telemetry.messages[INSTANCES_MESSAGE]
    is_primary = columns["is_primary"] > 0
    # The logged ratios are of the primary instance. Only a log that never has it has ratios of spare ones.
    has_logged_ratios = is_primary if is_primary.any() else ~is_primary
    is_in_boot = columns["boot"] == flight.boot[0]
    is_in_flight = (columns["time"] >= flight.time[0]) & (columns["time"] <= flight.time[-1])
    numbers_in_flight = columns["instance"][has_logged_ratios & is_in_boot & is_in_flight]
    if not len(numbers_in_flight):
        return ""
    numbers, sample_counts = np.unique(numbers_in_flight, return_counts=True)
    most_frequent_number = int(numbers[sample_counts.argmax()])
    return instance_name(telemetry, most_frequent_number)


def _spare_instances(evidence: Evidence) -> Iterator[Fact]:
    """Yields a fact for each spare instance of the estimator that rejected measurements in flight.

    Spare instances run in parallel to the primary one, whose estimate the controllers use. A spare that fails does not
    affect the flight, but can no longer replace the primary one.

    Args:
        evidence: signals, events and measurements of the vehicle.
    """
    telemetry = evidence.signals.telemetry
    columns = telemetry.messages.get(INSTANCES_MESSAGE, {})
    if not columns or not columns["is_primary"].any():
        return
    failsafe_limit = failsafe_innovation_limit(telemetry)
    ratios = finite_ratios(float_columns(columns, INNOVATIONS))
    for number in np.unique(columns["instance"]).tolist():
        # An instance may be the primary one for some time, and a spare for the rest.
        is_spare = (columns["instance"] == number) & (columns["is_primary"] == 0)
        ratios_as_spare = clean_series(columns, ratios, is_spare)
        for flight in evidence.in_flight(ratios_as_spare):
            rejection = longest_rejection(flight.time, flight.values, failsafe_limit)
            if not rejection.is_rejected_long:
                continue
            yield Fact(
                EstimatorLight.SPARE_DOUBTED,
                time=rejection.time,
                subject=instance_name(telemetry, int(number)),
                name=rejection.name,
                ratio=rejection.ratio,
                duration=rejection.duration,
            )


def _glitch_facts(evidence: Evidence) -> Iterator[Fact]:
    """Yields a warning for each flight in which the autopilot's filter flagged a GPS glitch (it disagrees with GPS).

    If the positions of a GPS receiver jumped meanwhile, the warning says how far. Without a jump the flag must last for
    ``FAILSAFE_SECONDS``, as long as a rejected innovation must for a warning. The flag counts only while a receiver has
    a position fix, since otherwise there is no position to disagree with.

    Args:
        evidence: signals, events and measurements of the vehicle.

    Yields:
        Facts with the time, s since boot, when the flag was set at the largest jump or, without a jump, for the first
        time. ``duration`` is the longest unbroken time of the flag, s. The fact about a jump has its ``distance``, m;
        the other one says whether positions were recorded, in which a jump would show (``is_recorded``).
    """
    telemetry = evidence.signals.telemetry
    jumps = position_jumps(telemetry)
    for flight in evidence.in_flight(innovation_ratios(telemetry)):
        boot = int(flight.boot[0])
        has_fix = has_position_fix(telemetry, boot, flight.time)
        is_flagged = (flight.values[:, GLITCH_COLUMN] > 0) & has_fix
        duration = longest_true_duration(flight.time, is_flagged)
        largest_jump = _largest_flagged_jump(jumps, flight, is_flagged)
        if largest_jump is not None:
            yield Fact(
                EstimatorLight.GPS_GLITCHED,
                time=largest_jump.flag_time,
                duration=duration,
                distance=largest_jump.distance,
            )
        elif duration >= FAILSAFE_SECONDS:
            first_flagged = is_flagged.argmax()
            yield Fact(
                EstimatorLight.GPS_DOUBTED,
                time=flight.time[first_flagged],
                duration=duration,
                is_recorded=jumps.is_recorded,
            )


class _FlaggedJump(NamedTuple):
    """A jump of the GPS position that the filter flagged."""

    flag_time: float
    """When the filter set its flag, s since boot."""
    distance: float
    """How far the position jumped, m."""


def _largest_flagged_jump(
    jumps: PositionJumps, flight: TimeSeries, is_flagged: Flags
) -> _FlaggedJump | None:
    """Finds the largest jump of the GPS position in a flight while the filter flagged GPS.

    Args:
        jumps: all jumps of the position.
        flight: samples (N, 5) of the flight; only its boot and times are used.
        is_flagged: (N,) whether the filter flagged GPS at each sample.

    Returns:
        The jump; None if the position did not jump.
    """
    boot = int(flight.boot[0])
    flight_start, flight_end = flight.time[0], flight.time[-1]
    largest_jump = None
    for start, end in true_intervals(flight.time, is_flagged):
        # The ends are infinite if the flag is set at the first or last sample, so the interval is cut to the flight.
        flagged_start = float(max(start, flight_start))
        flagged_end = float(min(end, flight_end))
        distance = jumps.largest_in(boot, (flagged_start, flagged_end)) or 0.0
        largest_distance = 0.0 if largest_jump is None else largest_jump.distance
        if distance > largest_distance:
            largest_jump = _FlaggedJump(flagged_start, distance)
    return largest_jump


def _poor_fixes(evidence: Evidence) -> Iterator[Fact]:
    """Yields a fact for each flight whose GPS fixes were poor: too few satellites, or too much dilution of precision.

    Medians over the flight are compared with the limits, so that a short loss of satellites is not reported here.
    Samples without a 3D fix are left out. Of several receivers the one with most satellites is judged: autopilots
    switch to it, or weigh it most.

    Args:
        evidence: signals, events and measurements of the vehicle.

    Yields:
        Facts with the median number of satellites and the horizontal dilution of precision (HDOP); None for a value
        that the receiver does not report. If there are several flights, with the start and end of the flight, s since
        boot.
    """
    flights = list(evidence.in_flight(_best_receiver(evidence)))
    for flight in flights:
        has_fix = flight.values[:, FIX_TYPE_COLUMN] >= FIX_3D
        if not has_fix.any():
            continue
        _, satellites, hundredths_of_dilution = np.median(flight.values[has_fix], axis=0).tolist()
        # The message GPS_RAW_INT has the dilution in hundredths, in its field ``eph``.
        dilution = None
        if hundredths_of_dilution < UNKNOWN_DILUTION:
            dilution = hundredths_of_dilution / 100
        # If the number of satellites is not known, it is 255, which is not too few.
        has_few_satellites = satellites < MIN_SATELLITES
        is_diluted = dilution is not None and dilution > MAX_DILUTION
        if not (has_few_satellites or is_diluted):
            continue
        fact = Fact(
            EstimatorLight.FIX_POOR,
            satellites=None if satellites == UNKNOWN_SATELLITES else int(satellites),
            dilution=dilution,
        )
        if len(flights) > 1:
            # Only among several flights do the times say which one is meant.
            fact = fact.replace(time=float(flight.time[0]), end_time=float(flight.time[-1]))
        yield fact


def _missing_fixes(evidence: Evidence) -> list[Fact]:
    """Returns the fact that no satellite receiver had a fix in any flight.

    Vehicles that stay on the ground or below the water are not judged.

    Args:
        evidence: signals, events and measurements of the vehicle.

    Returns:
        One fact with the largest number of satellites in the log, None if it is not known; empty if a receiver had a
        fix, or none was recorded.
    """
    has_fix = evidence.values_in_flight(position_fix(evidence.signals))
    telemetry = evidence.signals.telemetry
    if not len(has_fix) or has_fix.any() or telemetry.vehicle in SURFACE_VEHICLES:
        return []
    return [Fact(EstimatorLight.FIX_MISSING, satellites=most_satellites(telemetry))]


def _assumed_standstills(evidence: Evidence) -> list[Fact]:
    """Returns the fact that the estimator had no sensor of the position at all in flight.

    ArduPilot's estimator then assumes that the vehicle stands still, and reports that ("constant position mode").
    Vehicles that stay on the ground or below the water are not judged.

    Args:
        evidence: signals, events and measurements of the vehicle.

    Returns:
        A list with one fact; empty if the estimator did not report that in all of the flight, or a satellite receiver
        was recorded.
    """
    has_fix = evidence.values_in_flight(position_fix(evidence.signals))
    if len(has_fix) or evidence.signals.telemetry.vehicle in SURFACE_VEHICLES:
        return []
    standstill = evidence.values_in_flight(assumed_standstill(evidence.signals))
    if not len(standstill) or not standstill.all():
        return []
    return [Fact(EstimatorLight.FIX_MISSING, satellites=None, is_standstill_assumed=True)]


def _needed_no_position(evidence: Evidence) -> bool:
    """Returns whether all flights were in modes that need no position, judged at the samples of the GPS receiver."""
    modes_without_position = MANUAL_THROTTLE_MODES | MODES_WITHOUT_POSITION
    for flight in evidence.in_flight(position_fix(evidence.signals)):
        boot = int(flight.boot[0])
        intervals = mode_intervals(evidence.signals, boot, modes_without_position)
        if not in_intervals(flight.time, intervals).all():
            return False
    return True


def _has_other_position_source(evidence: Evidence) -> bool:
    """Returns whether the estimator had a position for most of the time in flight, or a sensor for it is set up."""
    validity = evidence.values_in_flight(position_validity(evidence.signals))
    if len(validity):
        return bool(np.median(validity) > 0)
    return has_other_position_source(evidence.signals.telemetry)


def _best_receiver(evidence: Evidence) -> TimeSeries | None:
    """Returns the samples of the GPS receiver with the most satellites in flight, on average over its 3D fixes.

    Args:
        evidence: signals, events and measurements of the vehicle.

    Returns:
        (N, 3) fix type, number of satellites, and horizontal dilution (HDOP) in hundredths; None if no receiver was
        recorded.
    """
    receivers = []
    for message in RECEIVER_MESSAGES:
        samples = recorded_series(
            evidence.signals.telemetry, message, "fix_type", "satellites_visible", "eph"
        )
        if samples is not None:
            receivers.append(samples)
    # Of receivers with equally many satellites the first one is used.
    return max(
        receivers, key=lambda samples: _mean_satellites_in_flight(evidence, samples), default=None
    )


def _mean_satellites_in_flight(evidence: Evidence, receiver: TimeSeries) -> float:
    """Returns the mean number of satellites over all 3D fixes of a GPS receiver in flight; 0 without any fix.

    Args:
        evidence: signals, events and measurements of the vehicle.
        receiver: samples (N, 3) of the receiver, as :func:`_best_receiver` returns them.
    """
    satellite_counts = list[float]()
    for flight in evidence.in_flight(receiver):
        has_fix = flight.values[:, FIX_TYPE_COLUMN] >= FIX_3D
        satellite_counts += flight.values[has_fix, SATELLITES_COLUMN].tolist()
    return float(np.mean(satellite_counts)) if satellite_counts else 0.0


def _compass_disturbances(evidence: Evidence) -> Iterator[Fact]:
    """Yields a fact if the motors disturb the compass: the magnetic field differs in strength in flight and before it.

    The currents of the motors cause a magnetic field, which a compass that is mounted too near to them measures too.
    The median strength of the field in the first flight is compared with its median on the ground before, if there are
    enough samples. Only the first compass that the parameters do not exclude, and that was recorded in flight, is
    judged.

    Args:
        evidence: signals, events and measurements of the vehicle.

    Yields:
        At most one fact, with the relative ``change`` of the strength, and the compass as subject if there are several.
    """
    fields = compass_fields(evidence.signals)
    for number, field in fields.items():
        # It is None where no parameter says whether the compass is used.
        is_excluded = is_compass_used(evidence.signals.telemetry, number) is False
        is_recorded_in_flight = len(evidence.values_in_flight(field)) > 0
        if is_excluded or not is_recorded_in_flight:
            continue
        change = field_change(evidence, field)
        if change is not None and abs(change) > MAX_FIELD_CHANGE:
            subject = f"compass {number}" if len(fields) > 1 else ""
            yield Fact(EstimatorLight.COMPASS_DISTURBED, subject=subject, change=change)
        # The first such compass is judged, and no other one.
        return


def _wrong_accelerometers(evidence: Evidence) -> Iterator[Fact]:
    """Yields a fact for each accelerometer in use that did not measure gravity at rest, in each boot with a flight.

    The estimator integrates the error of the accelerometer, so that the height may diverge in flight. The accelerometer
    of the estimator's primary instance comes first. Another one is judged if some other instance of the estimator runs
    on it, since the autopilot may switch to that.

    Args:
        evidence: signals, events and measurements of the vehicle.

    Yields:
        Facts with the ``acceleration`` at rest, m/s², whether the accelerometer is a spare one (``is_spare``), and the
        name of its IMU as subject if there are several.
    """
    for sensors_of_boot in evidence.trust:
        if not _has_recorded_flight(evidence, sensors_of_boot.boot):
            continue
        accelerometers = sensors_of_boot.accelerometers
        primary = sensors_of_boot.accelerometer
        # False sorts before True: the primary one comes first, and the others keep their order.
        primary_first = sorted(
            accelerometers, key=lambda accelerometer: accelerometer is not primary
        )
        for accelerometer in primary_first:
            is_primary = accelerometer is primary
            is_in_use = is_primary or accelerometer.is_used
            # If the log does not show gravity at rest, ``is_sound`` is None, which is no fault.
            is_wrong = accelerometer.is_sound is False
            if is_in_use and is_wrong:
                yield Fact(
                    EstimatorLight.ACCELEROMETER_WRONG,
                    subject=accelerometer.name if len(accelerometers) > 1 else "",
                    acceleration=accelerometer.gravity_at_rest,
                    is_spare=not is_primary,
                )


def _has_recorded_flight(evidence: Evidence, boot: int) -> bool:
    """Returns whether some flight of a boot, or a part of it, is in the recorded time.

    Args:
        evidence: signals of the vehicle, and its flights; a flight may begin before the record, and end after it.
        boot: number of the boot; a boot lasts from one start of the autopilot to the next.
    """
    flights = evidence.flights(boot)
    for span in recorded_spans(evidence.signals):
        if span.boot == boot and intersection([(span.start, span.end)], flights):
            return True
    return False
