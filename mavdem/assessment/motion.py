"""Events that attitude, height and accelerometers show of a flight that went wrong, whatever the autopilot reports.

The attitude is lost where it is more than 30° from its setpoint for 0.3 s or longer. Ordinary setpoints, tracked as
badly as in a step, stay within that. :func:`mavdem.assessment.attitude_error.attitude_error` defines the error.
"""

from collections.abc import Iterator
from dataclasses import replace
from math import inf
from typing import NamedTuple

import numpy as np

from mavdem.arrays import Array
from mavdem.assessment.attitude_error import AttitudeError, attitude_error
from mavdem.assessment.autopilot_messages import in_time_order
from mavdem.assessment.flights import (
    RECOVERY_SECONDS,
    flights_in_boot,
    height_in_flight,
    max_sink_rate,
    merge_close,
    trusted_climb_rate,
)
from mavdem.assessment.motor_events import LASTING_SECONDS, lasting_runs, motor_events
from mavdem.confidence import Interval
from mavdem.dataset.intervals import Intervals, in_intervals, union
from mavdem.dataset.phases import MAX_GROUND_HEIGHT, MAX_SETPOINT_DELAY, has_risen, series_of_boot
from mavdem.dataset.signals import Signals
from mavdem.dataset.time_series import TimeSeries, recorded_series
from mavdem.facts import Fact, Facts, Level
from mavdem.facts.ending import MotionEvent
from mavdem.ingest.motors import POSSIBLE_MULTIROTORS
from mavdem.vibration.vibration_message import reported_vibration

FAR_ANGLE = np.pi / 4
"""Error of the attitude, rad, that is bad even without a known setpoint. Half of the lean counts as error there, so
that the vehicle lies on its side."""

LOST_ANGLE = np.radians(30.0)
"""Error of the attitude, rad, from which on it may be lost: the threshold of ArduPilot's crash check."""

ONSET_ANGLE = LOST_ANGLE / 3
"""Error of the attitude, rad, at which a loss begins: vehicles in order exceed it for moments only."""

FALL_SPEED = 5.0
"""Speed downward, m/s, of a fall: autopilots descend at 1.5 to 4 m/s by their own decision."""

IMPACT_SPEED_CHANGE = 3.0
"""Decrease of the speed downward, m/s, within ``IMPACT_SECONDS`` that shows an impact; also the least speed before it.

It takes a mean of 10 m/s² upward beside the weight, more than autopilots use to end a descent.
"""

IMPACT_SECONDS = 0.3
"""Duration, s, over which the decrease of the speed in an impact is measured."""

IMPACT_FORCE = 30.0
"""Specific force, m/s², of an impact: three times the weight, which accelerometers do not feel in flight."""

SINK_AGREEMENT = 0.7
"""Share of the integrated speed of a fall by which the height must decrease: otherwise the estimated speed diverged."""

FORCE_MESSAGES = {"HIGHRES_IMU": 1.0, "RAW_IMU": 9.80665e-3}
"""Messages with the specific force, the preferred first, and the factor that converts it to m/s²."""


def motion_events(signals: Signals) -> Facts:
    """Returns the events that the motion shows, in order of boot and time.

    They are losses of attitude, falls, impacts, motors at their limit or off, clipping of the accelerometers, and a log
    that ends in the air. Of vehicles that are no multirotors they are clipping alone: a plane banks and dives on
    purpose.
    """
    if not signals.tilts:
        return ()
    is_multirotor = signals.telemetry.vehicle in POSSIBLE_MULTIROTORS
    events: list[Fact] = []
    for boot in np.unique(signals.tilts[0].boot).tolist():
        if is_multirotor:
            events += _events_of_boot(signals, boot)
        else:
            events += _clipping_events(signals, boot, flights_in_boot(signals, boot))
    return tuple(in_time_order(events))


def _events_of_boot(signals: Signals, boot: int) -> Iterator[Fact]:
    """Yields the events of one boot, in no particular order.

    Losses of attitude and falls are examined flight by flight. They explain limits of motors that come after them,
    which are left out.

    Args:
        signals: signals of the vehicle.
        boot: number of the boot.
    """
    error = attitude_error(signals, boot)
    if error is None:
        return
    flights = flights_in_boot(signals, boot)
    yield from _clipping_events(signals, boot, flights)
    out_of_control: Intervals = []
    # The loss and the fall of the flight under examination; after the loop, those of the last flight.
    loss: Fact | None = None
    fall_events: list[Fact] = []
    for flight in flights:
        attitude_events = _attitude_events(signals, boot, error, flight)
        yield from attitude_events
        # A bad loss is one that was not recovered: it ends the list, and all before it were recovered.
        loss = None
        if attitude_events and attitude_events[-1].is_bad:
            loss = attitude_events[-1]
        fall_events = list(_fall_events(signals, boot, flight, loss))
        yield from fall_events
        for event in (loss, *fall_events):
            if event is not None and event.is_bad:
                out_of_control.append(((event.time or 0.0) + LASTING_SECONDS, flight[1]))
    for event in motor_events(signals, boot, flights):
        # A vehicle that falls or lies on its back drives motors to their limit whatever they are worth.
        is_explained = in_intervals(event.time or 0.0, out_of_control)
        if event.code is not MotionEvent.MOTOR_AT_ITS_STOP or not is_explained:
            yield event
    if flights:
        yield from _end_in_air(signals, boot, flights[-1], error.time[-1], loss, fall_events)


def _end_in_air(
    signals: Signals,
    boot: int,
    flight: Interval,
    end_time: float,
    loss: Fact | None,
    fall_events: list[Fact],
) -> Iterator[Fact]:
    """Yields one event if the log ends while the vehicle was still in the air, for no reason that the log shows.

    Then either the recorder failed, or the vehicle crashed and the crash was not recorded. Nothing is yielded if the
    end is explained otherwise: by a landing, an impact, a loss of attitude at least ``RECOVERY_SECONDS`` earlier (by
    now the vehicle is on the ground), or a restart of the autopilot, after which the log goes on. Nothing is yielded
    either if the last height is unknown or at most ``MAX_GROUND_HEIGHT``, since the vehicle may then stand on the
    ground.

    Args:
        signals: signals of the vehicle.
        boot: number of the boot: the time from one start of the autopilot to the next.
        flight: start and end of the boot's last flight, s since boot; the end is infinite without a recorded landing.
        end_time: time of the last attitude sample of the boot, s since boot.
        loss: the loss of attitude that this flight did not recover from; None without one.
        fall_events: fall and impact of this flight; an impact has the code ``HIT``.
    """
    _, landing = flight
    is_long_lost = loss is not None and end_time - (loss.time or end_time) >= RECOVERY_SECONDS
    has_hit = any(event.code is MotionEvent.HIT for event in fall_events)
    # In an earlier boot the recording ended with the restart of the autopilot, not with a failure in the air.
    is_last_boot = boot == signals.tilts[0].boot[-1]
    if landing != inf or is_long_lost or has_hit or not is_last_boot:
        return
    height = height_in_flight(signals, boot, flight, end_time)
    if height is not None and height > MAX_GROUND_HEIGHT:
        yield Fact(MotionEvent.LOG_ENDED_IN_AIR, time=end_time, height=height, boot=boot)


def _attitude_events(
    signals: Signals, boot: int, error: AttitudeError, flight: Interval
) -> list[Fact]:
    """Returns the losses of attitude in one flight, in time order.

    A flight may have several that were recovered. One that was not is the last of the list: after it the vehicle is
    lost, and what its attitude does then is left out.

    Args:
        signals: of the vehicle.
        boot: number of the boot.
        error: of the attitude in this boot.
        flight: start and end of the flight, s.
    """
    events = []
    for interval in _loss_intervals(error, flight, series_of_boot(signals.climb_rate, boot)):
        event = _AttitudeLoss(signals, boot, flight, error, *interval).event()
        events.append(event)
        if event.is_bad:
            break
    return events


def _loss_intervals(
    error: AttitudeError, flight: Interval, climb_rate: TimeSeries | None
) -> Intervals:
    """Returns the intervals of a flight in which the attitude was lost.

    It is lost while the error exceeds ``LOST_ANGLE``. A vehicle that falls and ends its flight on its side has lost its
    attitude too, whatever the setpoint was.

    Args:
        error: error of the attitude in the boot.
        flight: start and end of the flight, s since boot.
        climb_rate: vertical speed, m/s up; None if it was not recorded.

    Returns:
        Intervals, s since boot, that begin in the flight or at most ``MAX_SETPOINT_DELAY`` after it. Losses that follow
        each other within ``RECOVERY_SECONDS`` are one.
    """
    lost = lasting_runs(error.time, error.magnitude > LOST_ANGLE, MAX_SETPOINT_DELAY)
    fallen = []
    for start, end in lasting_runs(error.time, error.is_toppled, MAX_SETPOINT_DELAY):
        sink_rate = max_sink_rate(climb_rate, start, start + RECOVERY_SECONDS) or 0.0
        if end >= flight[1] and sink_rate > FALL_SPEED:
            fallen.append((start, end))
    # The setpoint is tolerated for ``MAX_SETPOINT_DELAY``, so that a loss shows up to that long after the landing.
    latest_start = flight[1] + MAX_SETPOINT_DELAY
    return [
        (start, end)
        for start, end in merge_close(union(lost, fallen), RECOVERY_SECONDS)
        if flight[0] < start <= latest_start
    ]


class _AttitudeLoss(NamedTuple):
    """One loss of attitude: the vehicle's tilt was far from its setpoint, or it fell and lay on its side.

    It lasts from ``start`` to ``end``. The signals show how it began, and how serious it was.
    """

    signals: Signals
    boot: int
    flight: Interval
    error: AttitudeError
    start: float
    """When the error exceeded ``LOST_ANGLE``, s."""
    end: float
    """When the error was within ``LOST_ANGLE`` again, s; infinite if the record ended before."""

    def event(self) -> Fact:
        """Returns the event that describes this loss of attitude: its kind, times, and figures.

        1. The onset is found: when the error began to grow, earlier than ``start``.
        2. Height and an impact around the onset decide the kind: the vehicle tipped over at take-off, hit the ground or
           an obstacle, or lost its attitude in the air.
        3. If the vehicle recovered, or error, sink rate and duration all stayed small, the kind is "caught" instead.

        Returns:
            A fact with the kind as its code, and the figures ``angle`` (largest error, rad), ``height`` (m above the
            take-off, at the onset) and ``speed`` (largest sink rate, m/s). It lasts from the onset, or from an earlier
            impact, until the end of the loss, s since boot; without an end if the record ended before.
        """
        rows = in_intervals(self.error.time, [(self.start, self.end)])
        # The largest error in rad, and whether it was measured against a setpoint throughout.
        angle = self.error.magnitude[rows].max()
        has_setpoint = bool(self.error.has_setpoint[rows].all())
        # What the vehicle did when it began to leave its setpoint shows the cause better than the loss itself does.
        onset = self._onset()
        height = height_in_flight(self.signals, self.boot, self.flight, onset)
        # The error grows up to ``MAX_SETPOINT_DELAY`` after its cause, so that an impact may lie before the onset.
        impact = impact_time(self.signals, self.boot, onset - MAX_SETPOINT_DELAY, self.start)
        code = self._code(onset, height, impact)
        level = None
        if self._is_harmless(angle, has_setpoint, onset) or self._is_recovered():
            # Without a setpoint the pilot may have wanted to lean so far. Then it is not known how bad this is.
            code = MotionEvent.ATTITUDE_CAUGHT
            level = None if has_setpoint else Level.UNKNOWN
        return Fact(
            code,
            level,
            time=onset if impact is None else min(onset, impact),
            until=None if self.end == inf else self.end,
            angle=angle,
            height=height,
            speed=self._sink_rate(code, onset, height),
            boot=self.boot,
        )

    def _onset(self) -> float:
        """Returns when the attitude began to leave its setpoint, s.

        That is the last sample before the loss with an error below ``ONSET_ANGLE``, but at most ``RECOVERY_SECONDS``
        before it; the loss itself if there is no such sample.
        """
        time = self.error.time
        is_in_order = (time < self.start) & (self.error.magnitude < ONSET_ANGLE)
        times_in_order = time[is_in_order]
        onset = times_in_order[-1] if len(times_in_order) else self.start
        return max(onset, self.start - RECOVERY_SECONDS)

    def _code(self, onset: float, height: float | None, impact: float | None) -> MotionEvent:
        """Returns the kind of a loss that was not recovered.

        A vehicle that never rose tipped over. One that felt an impact, or was near the ground, hit something first. All
        others lost their attitude in the air.

        Args:
            onset: when the attitude began to leave its setpoint, s since boot.
            height: height above the take-off then, m; None if it was not recorded.
            impact: when the accelerometers felt an impact, s since boot; None if they felt none.
        """
        take_off, _ = self.flight
        is_airborne = has_risen(self.signals, self.boot, (take_off, onset))
        # Without a height, a vehicle that has flown for a while has risen.
        if is_airborne is None:
            is_airborne = onset - take_off > RECOVERY_SECONDS
        if not is_airborne:
            return MotionEvent.TIPPED
        if impact is not None or (height is not None and height < MAX_GROUND_HEIGHT):
            return MotionEvent.HIT
        return MotionEvent.ATTITUDE_LOST

    def _is_harmless(self, angle: float, has_setpoint: bool, onset: float) -> bool:
        """Returns whether angle, speed of the fall, and duration all stay below those of a serious loss.

        Serious are twice ``LOST_ANGLE`` (or ``FAR_ANGLE`` for an error that is only estimated), ``FALL_SPEED``, and
        ``RECOVERY_SECONDS``. Each figure is divided by its limit, and the largest ratio decides.

        Args:
            angle: largest error of the attitude, rad.
            has_setpoint: whether the setpoint was known, so that the error is not only estimated by half of the lean.
            onset: when the attitude began to leave its setpoint, s.
        """
        climb_rate = series_of_boot(self.signals.climb_rate, self.boot)
        sink_rate = max_sink_rate(climb_rate, onset, self.end + RECOVERY_SECONDS) or 0.0
        serious_angle = 2 * LOST_ANGLE if has_setpoint else FAR_ANGLE
        duration = min(self.end, self.error.time[-1]) - self.start
        severity = max(sink_rate / FALL_SPEED, angle / serious_angle, duration / RECOVERY_SECONDS)
        return severity < 1

    def _is_recovered(self) -> bool:
        """Returns whether the vehicle flew on for ``RECOVERY_SECONDS`` afterwards.

        The record must go on for so long within the flight. The motors must have worked with more than half of their
        median output of the flight: a vehicle on the ground does not need that. And the vehicle must be off the ground
        at the end of that time, as far as its height is known.
        """
        # Mean command of all motors; a vehicle that lies on the ground has it at idle.
        collective = series_of_boot(self.signals.collective, self.boot)
        recovered_at = self.end + RECOVERY_SECONDS
        if collective is None or min(self.flight[1], collective.time[-1]) < recovered_at:
            return False
        after = collective.values[in_intervals(collective.time, [(self.end, recovered_at)])]
        if not len(after):
            return False
        usual = np.median(collective.values[in_intervals(collective.time, [self.flight])])
        height = height_in_flight(self.signals, self.boot, self.flight, recovered_at)
        return after.mean() > usual / 2 and (height is None or height > MAX_GROUND_HEIGHT)

    def _sink_rate(self, code: MotionEvent, onset: float, height: float | None) -> float | None:
        """Returns the largest speed downward of the loss.

        A vehicle that lost its attitude in the air falls afterwards. One that hit something had its speed before.

        Args:
            code: kind of the loss.
            onset: when the attitude began to leave its setpoint, s since boot.
            height: height above the take-off then, m; None if it was not recorded.

        Returns:
            Speed downward, m/s; None if it is not known.
        """
        if height is not None and height < -MAX_GROUND_HEIGHT:
            # The vertical estimate had diverged before the loss.
            return None
        climb_rate = trusted_climb_rate(self.signals, self.boot, self.flight)
        if code is MotionEvent.HIT:
            return max_sink_rate(climb_rate, onset - MAX_SETPOINT_DELAY, onset + IMPACT_SECONDS)
        return max_sink_rate(climb_rate, onset, self.end + RECOVERY_SECONDS)


def impact_time(signals: Signals, boot: int, start: float, end: float) -> float | None:
    """Returns when the accelerometers felt an impact.

    An impact is a specific force above ``IMPACT_FORCE``, and above all of the ``RECOVERY_SECONDS`` before the search:
    the accelerometers of some vehicles feel as much throughout, from vibration.

    Args:
        signals: signals of the vehicle.
        boot: number of the boot.
        start: beginning of the time to search, s since boot.
        end: its end, s since boot.

    Returns:
        Time of the first impact, s since boot; None if none was felt, or the accelerometers were not recorded.
    """
    message = next((name for name in FORCE_MESSAGES if name in signals.telemetry.messages), "")
    acceleration = series_of_boot(
        recorded_series(signals.telemetry, message, "xacc", "yacc", "zacc"), boot
    )
    if acceleration is None:
        return None
    time = acceleration.time
    force = FORCE_MESSAGES[message] * np.linalg.norm(acceleration.values, axis=1)
    is_before = (time > start - RECOVERY_SECONDS) & (time < start)
    threshold = force[is_before].max(initial=IMPACT_FORCE)
    impacts = time[in_intervals(time, [(start, end)]) & (force > threshold)]
    return impacts[0] if len(impacts) else None


def _fall_events(
    signals: Signals, boot: int, flight: Interval, loss: Fact | None
) -> Iterator[Fact]:
    """Yields the fall of a flight and the impact at its end, if there were any.

    Where to look depends on the loss of attitude. Without one, a fall can only be seen around the end of the flight,
    and the impact by the vertical speed that is lost in it. With one, the fall follows it, and the impact is felt by
    the accelerometers. If the loss itself is an impact, the fall was before it, and there is no second impact.

    Args:
        signals: of the vehicle.
        boot: number of the boot.
        flight: start and end of the flight, s.
        loss: the loss of attitude with which the flight ended; None if there was none.
    """
    climb_rate = series_of_boot(signals.climb_rate, boot)
    if climb_rate is None:
        return
    flight_end = min(flight[1], climb_rate.time[-1])
    start, end = flight_end - RECOVERY_SECONDS, flight_end + RECOVERY_SECONDS
    if loss is not None:
        start = loss.time or start
        if loss.code is MotionEvent.HIT:
            # The fall was before the impact. On the ground nothing falls any more.
            if (loss.figures["height"] or 0.0) < MAX_GROUND_HEIGHT:
                end = start
            start -= RECOVERY_SECONDS
    interval = (max(flight[0], start), end)
    yield from _falls(signals, boot, flight, interval)
    if loss is None:
        yield from _impacts_of_fall(climb_rate, boot, interval)
    elif loss.code is not MotionEvent.HIT:
        impact = impact_time(signals, boot, start, flight_end + RECOVERY_SECONDS)
        if impact is not None:
            yield Fact(MotionEvent.HIT, Level.WATCH, height=None, time=impact, boot=boot)


def _falls(signals: Signals, boot: int, flight: Interval, interval: Interval) -> Iterator[Fact]:
    """Yields that the vehicle fell faster than ``FALL_SPEED``, if its height confirms that.

    An estimate of the vertical speed that diverges looks like a fall. So the height, where it was recorded, must
    decrease by at least the share ``SINK_AGREEMENT`` of the mean speed times the duration of the fall.

    Args:
        signals: of the vehicle.
        boot: number of the boot, whose vertical speed was recorded.
        flight: start and end of the flight, s.
        interval: start and end of the time to examine, s.
    """
    climb_rate = trusted_climb_rate(signals, boot, flight)
    assert climb_rate is not None
    is_falling = in_intervals(climb_rate.time, [interval]) & (climb_rate.values < -FALL_SPEED)
    if not is_falling.any():
        return
    start, end = climb_rate.time[is_falling][[0, -1]].tolist()
    height = series_of_boot(signals.height, boot)
    expected_change = SINK_AGREEMENT * climb_rate.values[is_falling].mean() * (end - start)
    # Both changes are negative: the vehicle must have sunk by at least the expected change.
    is_confirmed = True
    if height is not None:
        height_change = np.diff(np.interp([start, end], height.time, height.values))
        is_confirmed = bool(height_change <= expected_change)
    if is_confirmed:
        speed = max_sink_rate(climb_rate, *interval)
        yield Fact(MotionEvent.FELL, time=start, until=end, speed=speed, boot=boot)


def _impacts_of_fall(climb_rate: TimeSeries, boot: int, interval: Interval) -> Iterator[Fact]:
    """Yields the impact with which a fall ended, by the vertical speed that the vehicle lost, if there was one.

    A candidate is a sample from which on the speed downward decreases by more than ``IMPACT_SPEED_CHANGE`` within
    ``IMPACT_SECONDS``. The impact is at the largest decrease in one step after the first candidate.

    Args:
        climb_rate: vertical speed, m/s up.
        boot: number of the boot.
        interval: start and end of the time to examine, s.
    """
    time = climb_rate.time
    speed_later = np.interp(time + IMPACT_SECONDS, time, climb_rate.values)
    is_braked = speed_later - climb_rate.values > IMPACT_SPEED_CHANGE
    is_sinking = climb_rate.values < -IMPACT_SPEED_CHANGE
    candidates = time[in_intervals(time, [interval]) & is_braked & is_sinking]
    if not len(candidates):
        return
    # The motors may have slowed the fall before the ground stopped it. The ground takes the most speed within one step.
    first = candidates[0]
    speed_steps: Array = np.diff(climb_rate.values, append=climb_rate.values[-1])
    is_impact = in_intervals(time, [(first, first + IMPACT_SECONDS)])
    row = np.argmax(np.where(is_impact, speed_steps, -inf))
    speed = -climb_rate.values[row]
    if speed > IMPACT_SPEED_CHANGE:
        yield Fact(MotionEvent.HIT, height=None, time=time[row], speed=speed, boot=boot)


def _clipping_events(signals: Signals, boot: int, flights: Intervals) -> Iterator[Fact]:
    """Yields when the accelerometers were out of their range in flight ("clipping"), and how often.

    Clips of all IMUs are counted together. Those that follow each other within ``RECOVERY_SECONDS`` are one event.

    Args:
        signals: signals of the vehicle.
        boot: number of the boot.
        flights: start and end of each flight, s since boot.
    """
    vibration = reported_vibration(signals)
    if vibration is None:
        return
    clips_of_log = replace(vibration.levels, values=vibration.clips.sum(axis=1))
    clips = series_of_boot(clips_of_log, boot)
    if clips is None:
        return
    clipping_times = clips.time[(clips.values > 0) & in_intervals(clips.time, flights)].tolist()
    moments = [(time, time) for time in clipping_times]
    for start, end in merge_close(moments, RECOVERY_SECONDS):
        count = int(clips.values[in_intervals(clips.time, [(start, end)])].sum())
        yield Fact(MotionEvent.CLIPPED, time=start, until=end, count=count, boot=boot)
