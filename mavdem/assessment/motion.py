"""Motion: what attitude, height and motors show of a flight that went wrong, whatever the autopilot reports.

An attitude is lost where it leaves its setpoint by more than 30° for 0.3 s or longer: what is asked for in an ordinary
flight, tracked as badly as in a step, stays within that. What was asked counts for a second, so that a step is no loss;
where setpoints are not recorded, half of the lean is taken for asked, and all of it where rates only were asked for.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from math import inf

import numpy as np
from scipy.ndimage import maximum_filter1d, minimum_filter1d

from mavdem.arrays import Array, Flags
from mavdem.assessment.autopilot_messages import in_order
from mavdem.assessment.condition import vibration_of
from mavdem.confidence import Interval
from mavdem.dataset.intervals import Intervals, in_intervals, true_intervals, union
from mavdem.dataset.phases import (
    MAX_GROUND_HEIGHT,
    MAX_SETPOINT_DELAY,
    MAX_TILT,
    airborne_intervals,
    has_risen,
    height_above_take_off,
    min_airborne_collective,
    series_of_boot,
)
from mavdem.dataset.quality import STOP_MARGIN, samples_at_limits
from mavdem.dataset.signals import Signals
from mavdem.dataset.steady_flight import attitude_tracking
from mavdem.dataset.time_series import TimeSeries, recorded_series
from mavdem.facts import Fact, Facts, Level
from mavdem.facts.ending import MotionEvent
from mavdem.ingest.motors import POSSIBLE_MULTIROTORS
from mavdem.ingest.telemetry import rate_without_gaps
from mavdem.ingest.vocabulary import wrapped_angle
from mavdem.loops.margins import Complex

FAR_ANGLE = np.pi / 4  # rad from the setpoint: a vehicle is on its side, by half of the lean
LOST_ANGLE = np.radians(30.0)
LOST_SECONDS = 0.3
"""A loss of attitude, and a motor at its stop, last so long: one sample of a stream at 4 Hz is none."""
ONSET_ANGLE = LOST_ANGLE / 3
"""The error from which on the attitude was leaving: vehicles in order stay within it but for moments."""
CAUGHT_SECONDS = 5.0
"""Of flight after a loss of attitude, with which it was caught; events of a kind that follow sooner are one."""
FALL_SPEED = 5.0  # m/s down: autopilots descend by themselves at 1.5 to 4
HIT_SPEED = 3.0
"""m/s by which a fall is braked within ``LOST_SECONDS`` by the ground only: it takes three times the weight."""
HIT_FORCE = 30.0
"""m/s², three times the weight: what accelerometers feel when the vehicle hits something, and not in flight."""
FORCES = {"HIGHRES_IMU": 1.0, "RAW_IMU": 9.80665e-3}
"""Messages with the acceleration that is felt, the preferred first, and the factor that makes it m/s²."""


@dataclass(frozen=True, eq=False)
class AttitudeError:
    """How far roll and pitch are from all that was asked in the last second, at ``time`` (N,) s of one boot.

    ``lean`` (N,) of the body's vertical, forward and, imaginary, to the right, and its ``size`` (N,), rad; ``lies``
    (N,): whether it leans by more than ``MAX_TILT``; ``asked`` (N,): whether the setpoint is known.
    """

    time: Array
    lean: Complex
    size: Array
    lies: Flags
    asked: Flags


def motion_events(signals: Signals) -> Facts:
    """Returns what the motion shows, in order of boot and time; nothing of vehicles that are no multirotors."""
    if signals.telemetry.vehicle not in POSSIBLE_MULTIROTORS or not signals.tilts:
        return ()
    boots = np.unique(signals.tilts[0].boot).tolist()
    return tuple(in_order(event for boot in boots for event in _events(signals, boot)))


def _events(signals: Signals, boot: int) -> Iterator[Fact]:
    error = attitude_error(signals, boot)
    if error is None:
        return
    flights = flights_of(signals, boot)
    yield from _clipped(signals, boot, flights)
    out_of_control: Intervals = []
    for flight in flights:
        lost = None
        for span in _losses(error, flight, series_of_boot(signals.climb_rate, boot)):
            loss = _loss(signals, boot, error, flight, span)
            yield loss
            if loss.is_bad:
                lost = loss
                break
        fall = [*_fall(signals, boot, flight, lost)]
        yield from fall
        for event in filter(None, (lost, *fall)):
            if event.is_bad:
                out_of_control.append(((event.time or 0.0) + LOST_SECONDS, flight[1]))
    for event in _of_motors(signals, boot, flights):
        # What lies on its back, or falls, drives motors to their stop whatever it weighs.
        is_explained = in_intervals(event.time or 0.0, out_of_control)
        if event.code is not MotionEvent.MOTOR_AT_ITS_STOP or not is_explained:
            yield event
    last = error.time[-1]
    if (
        flights
        and flights[-1][1] == inf
        and last - (lost and lost.time or last) < CAUGHT_SECONDS
        and all(event.code is not MotionEvent.HIT for event in fall)
    ):
        height = height_above(signals, boot, flights[-1], last)
        is_last = boot == signals.tilts[0].boot[-1]  # after a restart the log goes on
        if is_last and height is not None and height > MAX_GROUND_HEIGHT:
            code = MotionEvent.LOG_ENDED_IN_AIR
            yield Fact(code, time=last, height=height, boot=boot)


def flights_of(signals: Signals, boot: int) -> Intervals:
    """Returns the intervals of ``boot`` off the ground; what was mistaken for a landing in the air splits none."""
    return merged(airborne_intervals(signals, boot), CAUGHT_SECONDS)


def merged(intervals: Intervals, gap: float) -> Intervals:
    """Returns the intervals, those that follow each other within a ``gap``, s, as one."""
    joined: Intervals = []
    for start, end in intervals:
        begins = joined.pop()[0] if joined and start - joined[-1][1] < gap else start
        joined.append((begins, end))
    return joined


def height_above(signals: Signals, boot: int, flight: Interval, time: float) -> float | None:
    """Returns the height above where the ``flight`` began, m, at ``time``, s; None where it was not recorded.

    Where it began before the log, it is the height above the autopilot's home.
    """
    height = height_above_take_off(signals, boot, flight)
    if flight[0] == -inf:
        height = series_of_boot(signals.height, boot)
    return None if height is None else np.interp(time, height.time, height.values)


def attitude_error(signals: Signals, boot: int) -> AttitudeError | None:
    """Returns the error of the attitude in ``boot``; None where there is no attitude."""
    flight = attitude_tracking(signals, boot)
    if flight is None or len(flight.time) < 2:
        return None
    time = flight.time
    window = max(1, round(MAX_SETPOINT_DELAY * rate_without_gaps(np.diff(time))))
    past = (window - 1) // 2  # so that the window ends with its sample
    unknown = np.isnan(flight.asked)
    asked = np.where(unknown, 0.0, flight.asked)
    least = minimum_filter1d(asked, window, axis=0, origin=past)
    most = maximum_filter1d(asked, window, axis=0, origin=past)
    angles = flight.angles[:, :2]
    unasked = np.where(flight.by_rate, 0.0, angles / 2)
    apart = np.where(unknown, unasked, angles - np.clip(angles, least, most))
    roll, pitch = wrapped_angle(apart).T
    lean = 1j * roll * np.cos(angles[:, 1]) - pitch
    lies = np.cos(angles).prod(axis=1) < np.cos(MAX_TILT)
    return AttitudeError(time, lean, abs(lean), lies, ~unknown[:, 1])


def _losses(error: AttitudeError, flight: Interval, climb: TimeSeries | None) -> Intervals:
    """Where the attitude was lost in a flight, or as it ended.

    What falls, and ends the flight on its side, has lost it, whatever was asked.
    """
    lost = _lasting(error.time, error.size > LOST_ANGLE, MAX_SETPOINT_DELAY)
    fallen = [
        event
        for event in _lasting(error.time, error.lies, MAX_SETPOINT_DELAY)
        if event[1] >= flight[1]
        and (_fastest(climb, event[0], event[0] + CAUGHT_SECONDS) or 0.0) > FALL_SPEED
    ]
    latest = flight[1] + MAX_SETPOINT_DELAY
    return [
        span
        for span in merged(union(lost, fallen), CAUGHT_SECONDS)
        if flight[0] < span[0] <= latest
    ]


def _lasting(time: Array, true: Flags, gap: float) -> Intervals:
    """Runs, as one where they follow each other within a ``gap``, s, that hold one of ``LOST_SECONDS``."""
    runs = true_intervals(time, true)
    after = np.append(time, time[-1])
    long = [
        start
        for start, end in runs
        if end > start and after[np.searchsorted(time, end, "right")] - start >= LOST_SECONDS
    ]
    return [
        (start, end)
        for start, end in merged(runs, gap)
        if np.searchsorted(long, start) < np.searchsorted(long, end)
    ]


def _loss(
    signals: Signals, boot: int, error: AttitudeError, flight: Interval, lost: Interval
) -> Fact:
    """A loss of the attitude, from when it began to leave."""
    start, end = lost
    time = error.time
    settled = time[(time < start) & (error.size < ONSET_ANGLE)]
    onset = max(settled[-1] if len(settled) else start, start - CAUGHT_SECONDS)
    here = in_intervals(time, [lost])
    angle = error.size[here].max()
    height = height_above(signals, boot, flight, onset)
    speed = _fastest(series_of_boot(signals.climb_rate, boot), onset, end + CAUGHT_SECONDS) or 0.0
    hit = _hit(signals, boot, onset - MAX_SETPOINT_DELAY, start)
    code = MotionEvent.ATTITUDE_LOST
    level = None
    up = has_risen(signals, boot, (flight[0], onset))
    if not (onset - flight[0] > CAUGHT_SECONDS if up is None else up):
        code = MotionEvent.TIPPED
    elif hit is not None or (height is not None and height < MAX_GROUND_HEIGHT):
        code = MotionEvent.HIT
    asked = error.asked[here].all()
    most = 2 * LOST_ANGLE if asked else FAR_ANGLE
    lasts = min(end, time[-1]) - start
    harm = max(speed / FALL_SPEED, angle / most, lasts / CAUGHT_SECONDS)
    if harm < 1 or _is_caught(signals, boot, flight, end):
        code = MotionEvent.ATTITUDE_CAUGHT
        level = None if asked else Level.UNKNOWN
    trusted = _trusted(signals, boot, flight)
    if height is not None and height < -MAX_GROUND_HEIGHT:
        trusted = None  # it had run away before
    # what the ground threw over had its speed before
    span = (onset, end + CAUGHT_SECONDS)
    if code is MotionEvent.HIT:
        span = (onset - MAX_SETPOINT_DELAY, onset + LOST_SECONDS)
    return Fact(
        code,
        level,
        time=onset if hit is None else min(onset, hit),
        until=_seen(end),
        angle=angle,
        height=height,
        speed=_fastest(trusted, *span),
        boot=boot,
    )


def _trusted(signals: Signals, boot: int, flight: Interval) -> TimeSeries | None:
    """The vertical speed, m/s up, but not of when the height was below that of the take-off: it may have run away."""
    climb = series_of_boot(signals.climb_rate, boot)
    height = height_above_take_off(signals, boot, flight)
    if climb is None or height is None:
        return climb
    above = np.interp(climb.time, height.time, height.values) > -MAX_GROUND_HEIGHT
    return climb.at(above)


def _fastest(climb: TimeSeries | None, since: float, until: float) -> float | None:
    """How fast it sank at most, m/s; None where that is not known."""
    here = () if climb is None else climb.values[in_intervals(climb.time, [(since, until)])]
    return -min(here) if len(here) else None


def _seen(end: float) -> float | None:
    return None if end == inf else end


def _is_caught(signals: Signals, boot: int, flight: Interval, end: float) -> bool:
    """Whether the vehicle flew on after a loss, off the ground as far as its height is known."""
    collective = series_of_boot(signals.collective, boot)
    if collective is None or min(flight[1], collective.time[-1]) < end + CAUGHT_SECONDS:
        return False
    after = collective.values[in_intervals(collective.time, [(end, end + CAUGHT_SECONDS)])]
    if not len(after):
        return False
    usual = np.median(collective.values[in_intervals(collective.time, [flight])])
    height = height_above(signals, boot, flight, end + CAUGHT_SECONDS)
    return after.mean() > usual / 2 and (height is None or height > MAX_GROUND_HEIGHT)


def _hit(signals: Signals, boot: int, since: float, until: float) -> float | None:
    """When the accelerometers felt that the vehicle hit something, from ``since`` to ``until``, s, if they did."""
    message = next((name for name in FORCES if name in signals.telemetry.messages), "")
    force = series_of_boot(
        recorded_series(signals.telemetry, message, "xacc", "yacc", "zacc"), boot
    )
    if force is None:
        return None
    felt = FORCES[message] * np.linalg.norm(force.values, axis=1)
    before = (force.time > since - CAUGHT_SECONDS) & (force.time < since)
    usual = felt[before].max(initial=HIT_FORCE)
    hits = force.time[in_intervals(force.time, [(since, until)]) & (felt > usual)]
    return hits[0] if len(hits) else None


def _fall(signals: Signals, boot: int, flight: Interval, lost: Fact | None) -> Iterator[Fact]:
    """The fall after control was ``lost``, or with which a flight ended, and when it hit the ground."""
    climb = series_of_boot(signals.climb_rate, boot)
    if climb is None:
        return
    time = climb.time
    end = min(flight[1], time[-1])
    since, until = end - CAUGHT_SECONDS, end + CAUGHT_SECONDS
    if lost is not None:
        since = lost.time or since
        if lost.code is MotionEvent.HIT:
            if (lost.figures["height"] or 0.0) < MAX_GROUND_HEIGHT:  # on the ground nothing falls
                until = since
            since -= CAUGHT_SECONDS
    span = (max(flight[0], since), until)
    trusted = _trusted(signals, boot, flight)
    assert trusted is not None
    falls = in_intervals(trusted.time, [span]) & (trusted.values < -FALL_SPEED)
    if falls.any():
        height = series_of_boot(signals.height, boot)
        begun, ended = ends = trusted.time[falls][[0, -1]].tolist()
        sank = 0.7 * trusted.values[falls].mean() * (ended - begun)
        # A speed that ran away is not seen in the height.
        if height is None or np.diff(np.interp(ends, height.time, height.values)) <= sank:
            speed = _fastest(trusted, *span)
            yield Fact(MotionEvent.FELL, time=begun, until=ended, speed=speed, boot=boot)
    if lost is not None:
        hit = _hit(signals, boot, since, end + CAUGHT_SECONDS)
        if hit is not None and lost.code is not MotionEvent.HIT:
            yield Fact(MotionEvent.HIT, Level.WATCH, height=None, time=hit, boot=boot)
        return
    braked = np.interp(time + LOST_SECONDS, time, climb.values) - climb.values > HIT_SPEED
    rises = np.diff(climb.values, append=climb.values[-1])
    for at in time[in_intervals(time, [span]) & braked & (climb.values < -HIT_SPEED)][:1]:
        # before the ground does, the vehicle may brake
        last = np.argmax(np.where(in_intervals(time, [(at, at + LOST_SECONDS)]), rises, -inf))
        speed = -climb.values[last]
        if speed > HIT_SPEED:
            yield Fact(MotionEvent.HIT, height=None, time=time[last], speed=speed, boot=boot)


def _of_motors(signals: Signals, boot: int, flights: Intervals) -> Iterator[Fact]:
    """Motors that were lastingly at their upper stop, or off while the others flew the vehicle."""
    motors = signals.motors
    if motors is None or boot not in motors.boot:
        return
    commands = motors.shares(boot)
    time = commands.time
    shares = commands.values
    at_stop, _ = samples_at_limits(shares, motors.scale)
    lowest = 0.0 if signals.telemetry.autopilot == "ARDUPILOTMEGA" else -STOP_MARGIN
    off = (shares <= lowest) | ((motors.outputs[motors.boot == boot] == 0) & (motors.scale.low > 0))
    others = (shares.sum(axis=1, keepdims=True) - shares) / max(shares.shape[1] - 1, 1)
    least = min_airborne_collective(signals.telemetry.parameters)
    off &= (others > least) & (shares.max(axis=0) > least)  # what never ran is no motor
    flown = in_intervals(time, flights)
    # A mixer may stop one for a moment.
    for code, held, shortest in (
        (MotionEvent.MOTOR_AT_ITS_STOP, at_stop, 0.0),
        (MotionEvent.MOTOR_OFF, off, MAX_SETPOINT_DELAY),
    ):
        for name, true in zip(motors.layout.names, held.T, strict=True):
            for start, end in _lasting(time, true & flown, CAUGHT_SECONDS):
                if min(end, time[-1]) - start <= shortest:
                    continue
                yield Fact(
                    code,
                    time=start,
                    until=_seen(end),
                    subject=name,
                    share=true[in_intervals(time, [(start, end)])].mean(),
                    boot=boot,
                )


def _clipped(signals: Signals, boot: int, flights: Intervals) -> Iterator[Fact]:
    """Where accelerometers were out of their range in flight, and how often."""
    measured = vibration_of(signals)
    if measured is None:
        return
    clips = replace(measured.levels, values=measured.clips.sum(axis=1))
    counted = series_of_boot(clips, boot)
    if counted is None:
        return
    clipped = (counted.values > 0) & in_intervals(counted.time, flights)
    for start, end in merged([(at, at) for at in counted.time[clipped].tolist()], CAUGHT_SECONDS):
        count = int(counted.values[in_intervals(counted.time, [(start, end)])].sum())
        yield Fact(MotionEvent.CLIPPED, time=start, until=end, count=count, boot=boot)
