"""Losses of attitude, as facts (coded findings): roll or pitch was far from its setpoint, and the sensors confirm it.

The attitude is lost if it is more than 30° from its setpoint for 0.3 s or longer. Ordinary setpoints, tracked as
badly as in a step, stay within that. :func:`mavdem.dataset.attitude_error.attitude_error` defines the error. A
setpoint that nothing follows looks the same, so that a second sensor must confirm a loss: gyro, height, or the ground.
"""

from math import inf
from typing import NamedTuple

import numpy as np

from mavdem.assessment.flights import RECOVERY_SECONDS
from mavdem.assessment.motor_events import lasting_runs
from mavdem.dataset.attitude_error import AttitudeError, LargestError, largest_error
from mavdem.dataset.grounded import MAX_GROUND_HEIGHT, MAX_SETPOINT_DELAY
from mavdem.dataset.intervals import (
    Intervals,
    TimeInterval,
    in_intervals,
    merge_close_intervals,
    union,
)
from mavdem.dataset.time_series import series_of_boot
from mavdem.facts import Fact, Facts, Level
from mavdem.facts.ending import MotionEvent
from mavdem.facts.witnesses import SensorFact, Side
from mavdem.witnesses.boot_sensors import BootSensors
from mavdem.witnesses.sensor_facts import checked_event, contradicting_fact, supporting_fact
from mavdem.witnesses.velocity import stopped_at

FAR_ANGLE = np.pi / 4
"""Error of the attitude, rad, that is bad even without a known setpoint. Half of the lean counts as error there, so
that the vehicle lies on its side."""

LOST_ANGLE = np.radians(30.0)
"""Error of the attitude, rad, from which on it may be lost: the threshold of ArduPilot's crash check."""

ONSET_ANGLE = LOST_ANGLE / 3
"""Error of the attitude, rad, at which a loss begins: vehicles in order exceed it for moments only."""

FALL_SPEED = 5.0
"""Speed downward, m/s, of a fall: autopilots descend at 1.5 to 4 m/s by their own decision."""

MAX_LANDING_REPORT_SECONDS = 2.0
"""Seconds between two reports of the landed state in which the vehicle landed at an unknown moment.

Autopilots send them at 1 Hz. With slower ones a vehicle that somebody lifts after the landing would count as lost.
"""

CARRYING_OUTPUT_RATIO = 0.5
"""Mean output of all motors, relative to its median in the flight, that carries the vehicle: on the ground it needs
less."""

ALOFT_HEIGHT = 5.0
"""Height, m, above the take-off from which on a knock alone shows no contact; slopes, bushes and the error of a
barometer are lower."""

MIN_GYRO_FRACTION = 0.3
"""Fraction of the change of attitude that the largest body rates explain, below which the gyro contradicts a loss.

A gyro logged at 10 Hz misses a part of a tumble, but not most of it.
"""


def attitude_losses(
    sensors: BootSensors,
    error: AttitudeError,
    flight_interval: TimeInterval,
    *,
    is_ongoing: bool = False,
) -> list[Fact]:
    """Returns the losses of attitude in one flight, in time order.

    A vehicle may lose its attitude and recover several times. The first loss that it does not recover from ends the
    search, since the attitude of a vehicle that has crashed means nothing. So only the last event of the list can be
    one without recovery.

    Args:
        sensors: sensors of the vehicle in one boot, which lasts from one start of the autopilot to the next.
        error: error of roll and pitch in this boot.
        flight_interval: start and end of the flight, s since boot.
        is_ongoing: whether the flight may continue after the last sample, as in a live session. A loss that lasts
            until then is judged by its error and duration up to then; in a record that ended it is serious.

    Returns:
        An event for each loss. Its code is ``ATTITUDE_CAUGHT`` if the loss was recovered or harmless; the last one may
        have the code ``TIPPED``, ``HIT`` or ``ATTITUDE_LOST`` instead.
    """
    events = []
    latest_end = float(error.time[-1]) if is_ongoing else inf
    for start, loss_end in _loss_intervals(sensors, error, flight_interval):
        end = min(loss_end, latest_end)
        event = _AttitudeLoss(sensors, flight_interval, error, start, end).event()
        events.append(event)
        is_recovered = event.code is MotionEvent.ATTITUDE_CAUGHT
        if not is_recovered:
            break
    return events


def _loss_intervals(
    sensors: BootSensors, error: AttitudeError, flight_interval: TimeInterval
) -> Intervals:
    """Finds the intervals of a flight in which the attitude was lost.

    It is lost while roll or pitch is further from its setpoint than ``LOST_ANGLE``. It is also lost, whatever the
    setpoint, if the vehicle was tilted too far to fly until the flight ended, and fell.

    Args:
        sensors: sensors of the vehicle in one boot, which lasts from one start of the autopilot to the next.
        error: error of the attitude in the boot.
        flight_interval: start and end of the flight, s since boot.

    Returns:
        Intervals, s since boot, that begin in the flight or at most ``MAX_SETPOINT_DELAY`` after the report of its
        landing. Losses that follow each other within ``RECOVERY_SECONDS`` are one.
    """
    flight_start, flight_end = flight_interval
    # A large vehicle takes up to ``MAX_SETPOINT_DELAY`` to follow a new setpoint, so that only longer runs count.
    off_setpoint = lasting_runs(error.time, error.magnitude > LOST_ANGLE, MAX_SETPOINT_DELAY)
    toppled_and_falling = []
    for start, end in lasting_runs(error.time, error.is_toppled, MAX_SETPOINT_DELAY):
        sink_rate = sensors.sink_rate((start, start + RECOVERY_SECONDS))
        is_falling = sink_rate is not None and sink_rate > FALL_SPEED
        if end >= flight_end and is_falling:
            toppled_and_falling.append((start, end))
    # For the same delay, a loss just before the landing may show only after it.
    latest_start = _time_of_landing_report(sensors, flight_end) + MAX_SETPOINT_DELAY
    losses = merge_close_intervals(union(off_setpoint, toppled_and_falling), RECOVERY_SECONDS)
    return [(start, end) for start, end in losses if flight_start < start <= latest_start]


def _time_of_landing_report(sensors: BootSensors, flight_end: float) -> float:
    """Returns the time of the first report of a landed state after the last report in flight, s since boot.

    Landed states often come once a second: the vehicle landed somewhere between the two reports.

    Args:
        sensors: sensors of the vehicle in one boot, which lasts from one start of the autopilot to the next.
        flight_end: end of the flight by the last report in flight, s since boot.

    Returns:
        The time of that report; the end of the flight itself if none follows within ``MAX_LANDING_REPORT_SECONDS``.
    """
    reports = series_of_boot(sensors.signals.landed_state, sensors.boot)
    if reports is None:
        return flight_end
    later_times = reports.time[reports.time > flight_end]
    if not len(later_times) or later_times[0] - flight_end > MAX_LANDING_REPORT_SECONDS:
        return flight_end
    return float(later_times[0])


class _AttitudeLoss(NamedTuple):
    """One loss of attitude: the vehicle's tilt was far from its setpoint, or it fell and lay on its side.

    It lasts from ``start`` to ``end``. The signals show how it began, and how serious it was.
    """

    sensors: BootSensors
    """Sensors of the boot, with the take-off of this flight."""
    flight_interval: TimeInterval
    """Start and end of the flight, s since boot."""
    error: AttitudeError
    """Error of the attitude in this boot."""
    start: float
    """When the error exceeded ``LOST_ANGLE``, s."""
    end: float
    """When the error was within ``LOST_ANGLE`` again, s; infinite if the record ended before."""

    def event(self) -> Fact:
        """Returns the event that describes this loss of attitude: its code, times and figures, and the sensors' facts.

        1. The onset is found, which is when the error began to grow, earlier than ``start``.
        2. Height and a knock around the onset determine the code: the vehicle tipped over at take-off, hit the ground
           or an obstacle, or lost its attitude in the air.
        3. If the vehicle recovered, or error, sink rate and duration all stayed small, the code is "caught" instead.

        Returns:
            A fact with this code, and the figures ``angle`` (largest error, rad; if the setpoint is not known, the
            whole lean, and ``is_lean`` is true), ``height`` (m above the take-off, at the onset), ``height_source``,
            ``speed`` (largest sink rate, m/s) and ``witnesses`` (what sensors show for or against it). If a caught loss
            lasted longer than the flight, ``is_at_landing`` is true. The event begins at the onset, or at an earlier
            knock, and ends with the loss, s since boot; it has no end if the record ended first.
        """
        # The motion at the onset shows the cause better than the motion in the loss itself.
        onset = self._onset_time()
        height = self.sensors.height_at(onset)
        knock = self._knock_at_onset(onset)
        knock_time = None if knock is None else knock.time
        is_caught = self._is_harmless(onset) or self._is_recovered()
        # None is the usual level of the code.
        level = None
        if is_caught:
            code = MotionEvent.ATTITUDE_CAUGHT
            if not self._has_setpoint:
                # The pilot may have intended this lean, so it is not known how bad it is.
                level = Level.UNKNOWN
        else:
            code = self._code_without_recovery(onset, height, knock_time)
        peak_error = self._largest_error()
        event = Fact(
            code,
            level,
            time=onset if knock_time is None else min(onset, knock_time),
            end_time=None if self.end == inf else self.end,
            angle=peak_error.angle,
            height=height,
            height_source=self.sensors.height_source,
            speed=self._sink_rate(code, onset),
            boot=self.sensors.boot,
        )
        if not peak_error.has_setpoint:
            event = event.replace(is_lean=True)
        sensor_facts = self._sensor_facts(onset)
        if not is_caught:
            if knock is not None:
                sensor_facts = (*sensor_facts, knock)
            # The level of a lost flight depends on how many sensors confirm it.
            return checked_event(event, sensor_facts)
        _, flight_end = self.flight_interval
        if self.end > flight_end:
            # The vehicle lay on the ground, not level, until somebody lifted it, so it did not recover in flight.
            event = event.replace(is_at_landing=True)
        return event.replace(witnesses=sensor_facts)

    def _knock_at_onset(self, onset: float) -> Fact | None:
        """Returns the knock that the accelerometer measured when the attitude was lost; None if it measured none.

        The error begins to grow up to ``MAX_SETPOINT_DELAY`` after its cause, so a knock may be before the onset.

        Args:
            onset: time at which the attitude began to leave its setpoint, s since boot.
        """
        knock = self.sensors.knock_fact((onset - MAX_SETPOINT_DELAY, self.start))
        # An accelerometer may also show that there was no knock, which is a fact against a contact.
        if knock is None or knock.figures["side"] != Side.FOR:
            return None
        return knock

    @property
    def _has_setpoint(self) -> bool:
        """Whether the setpoint was known throughout the loss."""
        is_in_interval = in_intervals(self.error.time, [(self.start, self.end)])
        return bool(self.error.has_setpoint[is_in_interval].all())

    def _largest_error(self) -> LargestError:
        """Returns the largest error of the loss; if the setpoint was not recorded, it is the whole lean."""
        peak_error = largest_error(self.error, (self.start, self.end))
        # A loss is found by samples of the attitude, so that there is one.
        assert peak_error is not None
        return peak_error

    def _onset_time(self) -> float:
        """Returns the time at which the attitude began to leave its setpoint, s since boot.

        The search goes back from the start of the loss to the last sample near the setpoint: one with an error below
        ``ONSET_ANGLE``. A vehicle that is being lost may swing through its setpoint, which is no onset. So if the error
        exceeded twice ``ONSET_ANGLE`` within ``MAX_SETPOINT_DELAY`` before that sample, the search goes on before the
        swing. It goes back ``RECOVERY_SECONDS`` at most. Without a sample near the setpoint, the loss has no earlier
        onset.
        """
        time = self.error.time
        magnitude = self.error.magnitude
        earliest_time = self.start - RECOVERY_SECONDS
        onset = self.start
        search_end = onset
        while search_end > earliest_time:
            times_near_setpoint = time[(time < search_end) & (magnitude < ONSET_ANGLE)]
            if not len(times_near_setpoint):
                break
            onset = float(times_near_setpoint[-1])
            is_just_before = (time >= onset - MAX_SETPOINT_DELAY) & (time <= onset)
            times_of_swing = time[is_just_before & (magnitude > 2 * ONSET_ANGLE)]
            if not len(times_of_swing):
                break
            search_end = float(times_of_swing[-1])
        return max(onset, earliest_time)

    def _code_without_recovery(
        self, onset: float, height: float | None, knock_time: float | None
    ) -> MotionEvent:
        """Returns the code of a loss that was not recovered: how the vehicle was lost.

        A vehicle that never rose tipped over on the ground. A vehicle whose accelerometer shows the knock of a contact,
        or that was near the ground, hit something first. All others lost their attitude in the air.

        Args:
            onset: time at which the attitude began to leave its setpoint, s since boot.
            height: height above the take-off at that time, m; None if it was not recorded.
            knock_time: time of a knock that the accelerometer measured, s since boot; None if there was none.

        Returns:
            ``TIPPED``, ``HIT`` or ``ATTITUDE_LOST``.
        """
        if not was_above_ground_before(self.sensors, self.flight_interval, onset):
            return MotionEvent.TIPPED
        has_hit = knock_time is not None and knock_is_contact(self.sensors, knock_time)
        if has_hit or (height is not None and height < MAX_GROUND_HEIGHT):
            return MotionEvent.HIT
        return MotionEvent.ATTITUDE_LOST

    def _is_harmless(self, onset: float) -> bool:
        """Returns whether the loss was slight: short, without a fall, and with a moderate error of the attitude.

        A loss that lasts until the record ends is not harmless.

        Args:
            onset: time when the attitude began to leave its setpoint, s since boot.
        """
        lasts_until_end_of_record = self.end == inf
        if lasts_until_end_of_record:
            return False
        duration = min(self.end, self.error.time[-1]) - self.start
        is_short = duration < RECOVERY_SECONDS
        sink_rates = self.sensors.sink_rates((onset, self.end + RECOVERY_SECONDS))
        # The fastest descent of any sensor, m/s, is used, so that no fall seems harmless.
        fall_speed = max([0.0, *sink_rates.values()])
        is_slow = fall_speed < FALL_SPEED
        # A loss begins at an error of ``LOST_ANGLE``; twice as much is serious. Without a setpoint the error is a
        # guess, half of the lean, which has a limit of its own.
        serious_angle = 2 * LOST_ANGLE if self._has_setpoint else FAR_ANGLE
        is_moderate = self._largest_error().counted_angle < serious_angle
        return bool(is_short and is_slow and is_moderate)

    def _is_recovered(self) -> bool:
        """Returns whether the vehicle flew on for ``RECOVERY_SECONDS`` afterwards.

        Both flight and record must last that long. The mean output of the motors in this time must exceed
        ``CARRYING_OUTPUT_RATIO`` times its median of the flight. And the vehicle must be off the ground at the end of
        the time, if its height is known.
        """
        # Mean command of all motors; a vehicle that lies on the ground has it at idle.
        collective = series_of_boot(self.sensors.signals.collective, self.sensors.boot)
        recovery_end = self.end + RECOVERY_SECONDS
        _, flight_end = self.flight_interval
        if collective is None or min(flight_end, collective.time[-1]) < recovery_end:
            return False
        is_recovery = in_intervals(collective.time, [(self.end, recovery_end)])
        if not is_recovery.any():
            return False
        is_flight = in_intervals(collective.time, [self.flight_interval])
        usual_output = np.median(collective.values[is_flight])
        later_output = collective.values[is_recovery].mean()
        motors_carry_vehicle = bool(later_output > CARRYING_OUTPUT_RATIO * usual_output)
        height = self.sensors.height_at(recovery_end)
        may_be_off_ground = height is None or height > MAX_GROUND_HEIGHT
        return motors_carry_vehicle and may_be_off_ground

    def _sink_rate(self, code: MotionEvent, onset: float) -> float | None:
        """Returns the largest speed downward at the loss that all height sensors confirm.

        A vehicle that lost its attitude in the air falls after the onset, so that its speed is sought from the onset
        on. A vehicle that hit something was fast before the impact. The impact may be up to ``MAX_SETPOINT_DELAY``
        before the onset, and its speed is sought from as long before the impact.

        Args:
            code: how the vehicle was lost.
            onset: time when the attitude began to leave its setpoint, s since boot.

        Returns:
            Speed downward, m/s; None if it is not known.
        """
        if code is MotionEvent.HIT:
            search_interval = (onset - 2 * MAX_SETPOINT_DELAY, onset)
        else:
            search_interval = (onset, self.end + RECOVERY_SECONDS)
        return self.sensors.sink_rate(search_interval)

    def _sensor_facts(self, onset: float) -> Facts:
        """Returns what sensors show for or against the loss, a fact each.

        Args:
            onset: time when the attitude began to leave its setpoint, s since boot.

        Returns:
            That the attitude left its setpoint; whether the gyro measured a rotation; a fast descent by each height
            sensor that shows one; and that the vehicle came to rest afterwards, or else that the log ended soon.
        """
        facts = [
            supporting_fact(SensorFact.ATTITUDE_LEFT_SETPOINT, **self._largest_error()._asdict())
        ]
        rotation = self._rotation_fact(onset)
        if rotation is not None:
            facts.append(rotation)
        record_end = float(self.error.time[-1])
        end = min(self.end, record_end)
        for descent in self.sensors.sink_facts((onset, end + RECOVERY_SECONDS)):
            # A vehicle that did not sink may be lost all the same: one that tips over on the ground does not sink.
            if descent.code is SensorFact.SANK:
                facts.append(descent)
        rest_after_loss = self.sensors.rest_after(onset, end + 2 * RECOVERY_SECONDS)
        remaining_seconds = record_end - onset
        if rest_after_loss is not None:
            facts += [rest_after_loss.rest_fact, *rest_after_loss.pose_facts]
        elif remaining_seconds < RECOVERY_SECONDS:
            log_ended = supporting_fact(
                SensorFact.LOG_ENDED, time=record_end, duration=remaining_seconds
            )
            facts.append(log_ended)
        return tuple(facts)

    def _rotation_fact(self, onset: float) -> Fact | None:
        """Returns whether the gyro confirms that the vehicle itself rotated, as a fact for or against the loss.

        If only the setpoint changed, the angles did not. If the estimated angles changed but the gyro measured no
        rotation, the estimate is wrong. So the larger change of roll or pitch must be at least ``ONSET_ANGLE``, and the
        gyro must have measured at least ``MIN_GYRO_FRACTION`` of it.

        Args:
            onset: time when the attitude began to leave its setpoint, s since boot.

        Returns:
            The fact ``ROTATED``, which supports the loss, or ``DID_NOT_ROTATE`` or ``GYRO_DISAGREED``, which contradict
            it; None if there are too few samples.
        """
        end = min(self.end, self.start + RECOVERY_SECONDS, self.error.time[-1])
        # Largest change of roll or pitch by the estimated angles, and by the integral of the gyro's body rate, rad.
        largest_change = 0.0
        largest_turn = 0.0
        tilts = self.sensors.signals.tilts
        for tilt in tilts:
            is_in_loss = (tilt.boot == self.sensors.boot) & in_intervals(tilt.time, [(onset, end)])
            if np.count_nonzero(is_in_loss) < 2:
                return None
            change = float(np.ptp(np.unwrap(tilt.angle[is_in_loss])))
            turn = float(np.trapezoid(abs(tilt.rate[is_in_loss]), tilt.time[is_in_loss]))
            largest_change = max(largest_change, change)
            largest_turn = max(largest_turn, turn)
        fastest_rotation = self.sensors.fastest_rotation(tilts, (onset, end))
        if largest_change < ONSET_ANGLE:
            return contradicting_fact(
                SensorFact.DID_NOT_ROTATE,
                time=onset,
                end_time=end,
                body_rate=fastest_rotation.body_rate,
            )
        if largest_turn < MIN_GYRO_FRACTION * largest_change:
            return contradicting_fact(
                SensorFact.GYRO_DISAGREED, time=onset, end_time=end, angle=largest_change
            )
        return supporting_fact(
            SensorFact.ROTATED, time=fastest_rotation.time, body_rate=fastest_rotation.body_rate
        )


def knock_is_contact(sensors: BootSensors, time: float) -> bool:
    """Returns whether a knock that the accelerometer measured can be a contact with the ground or an obstacle.

    A propeller that breaks, or a motor that tears loose, knocks too. So at ``ALOFT_HEIGHT`` or higher the vehicle must
    have lost its speed as well, if its velocity is known. Near the ground, or if the height is not known, every
    knock may be a contact.

    Args:
        sensors: sensors of the vehicle in one boot, which lasts from one start of the autopilot to the next.
        time: time of the knock, s since boot.
    """
    height = sensors.height_at(time)
    if height is None or height < ALOFT_HEIGHT:
        return True
    return stopped_at(sensors.signals, sensors.boot, time) is not False


def was_above_ground_before(
    sensors: BootSensors, flight_interval: TimeInterval, time: float
) -> bool:
    """Returns whether the vehicle was more than ``MAX_GROUND_HEIGHT`` above its take-off before some time of a flight.

    If no height was recorded, a vehicle that has flown for ``RECOVERY_SECONDS`` counts as risen.

    Args:
        sensors: sensors of the vehicle in one boot, which lasts from one start of the autopilot to the next.
        flight_interval: start and end of the flight, s since boot.
        time: until when the heights of the flight are looked at, s since boot.
    """
    take_off, _ = flight_interval
    height = sensors.height_above_take_off
    if height is None:
        return time - take_off > RECOVERY_SECONDS
    in_flight = in_intervals(height.time, [(take_off, time)])
    return bool((height.values[in_flight] > MAX_GROUND_HEIGHT).any())
