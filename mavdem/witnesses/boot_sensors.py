"""What the sensors of one boot show in an interval, as facts for or against an event, such as knocks for a crash.

A knock is a short peak of the measured acceleration, as an impact causes it. An event is bad only if enough facts
support it (:mod:`mavdem.witnesses.sensor_facts`). Some methods return the measured figure instead of a fact.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property
from math import inf, isinf
from typing import NamedTuple

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from mavdem.arrays import Array, Flags
from mavdem.dataset.attitude import Attitude
from mavdem.dataset.grounded import MAX_GROUND_HEIGHT
from mavdem.dataset.intervals import TimeInterval, intersection
from mavdem.dataset.signals import Signals
from mavdem.dataset.time_series import TimeSeries, series_of_boot
from mavdem.dataset.vehicle_cache import cached_per_vehicle
from mavdem.facts import Fact
from mavdem.facts.witnesses import HeightSource, SensorFact
from mavdem.physical_constants import GRAVITY
from mavdem.witnesses.accelerometer import (
    REST_SECONDS,
    AccelerometerRecord,
    accelerometer_in_use,
    is_powered,
    still_windows,
)
from mavdem.witnesses.height import (
    MAX_CLIMB_DIFFERENCE,
    MEAN_SECONDS,
    SLOPE_SECONDS,
    HeightComparison,
    ReliableHeight,
    reliable_height,
    reliable_height_at,
)
from mavdem.witnesses.sensor_facts import (
    ACCELEROMETER,
    ATTITUDE,
    contradicting_fact,
    supporting_fact,
)
from mavdem.witnesses.trust import SensorTrust, sensor_trust

FAST_RATE = np.radians(200.0)
"""Body rate, rad/s, of a vehicle that tumbles: few autopilots ask for as much."""

MIN_SINK_RATE = 2.0
"""Speed downward, m/s, that no ordinary landing has: autopilots land at 0.3 to 0.7 m/s, pilots at up to 1.5."""

SIDE_ANGLE = np.radians(40.0)
"""Angle from upright, rad, from which on a vehicle lies on its side; slopes and bent legs make less.

A limit of 20° finds two real landings wrongly, one of 65° misses a crash.
"""

CLOSED_STICK = 0.08
"""Travel of the throttle stick up to which it is closed: twice the dead zone of ArduPilot's THR_DZ and RC3_DZ."""

OPEN_STICK = 0.15
"""Travel of the throttle stick above which it is clearly open, so that a closed stick afterwards is a movement."""

OPEN_BEFORE_SECONDS = 1.0
"""Seconds before an interval in which the stick may have been open for its closing to count within the interval."""

CONTRADICTION_MARGIN = 0.5
"""Seconds after a moment within which a contradiction of barometer and estimate concerns it: both are averages."""

MAX_SINK_RATE_AT_REST = 0.5
"""Speed downward, m/s, that an estimate may have before the take-off.

With a larger error a landing at 1.5 m/s, which pilots do, would exceed ``MIN_SINK_RATE``.
"""

SECONDS_BEFORE_TAKE_OFF = 2.0
"""Seconds before the take-off in which that speed is taken, while the vehicle still rests; a choice."""

MAX_FALL_SPEED = 60.0
"""Speed downward, m/s, that no multirotor exceeds: twice the speed of a compact one that falls (0.6 kg and 0.01 m²)."""

FALL_HEIGHT_MARGIN = 5.0
"""Height, m, by which a fall may be longer than the heights of the flight show: their own error, and a slope."""

MIN_REST_SECONDS = 1.0
"""Seconds of rest that show that the vehicle lies on the ground."""


class Descent(NamedTuple):
    """The fastest descent in an interval, by one height sensor."""

    speed: float
    """Speed downward, m/s."""
    time: float
    """When it was so fast, s since boot."""
    source: HeightSource
    """The sensor, ``BAROMETER`` or ``ESTIMATE``."""


class Rotation(NamedTuple):
    """The fastest rotation in an interval; its fields are the figures of the fact ``ROTATED``."""

    time: float
    """When the vehicle rotated so fast, s since boot."""
    body_rate: float
    """Size of the body rate about one axis, rad/s."""


@dataclass(frozen=True)
class Rest:
    """When, and at which angle from upright, a vehicle came to rest."""

    time: float
    """When the rest began, s since boot."""
    angle: float | None
    """Angle between the body's vertical axis and upright, rad; None if nothing shows it."""
    source: str = ACCELEROMETER
    """What shows the angle: ``ACCELEROMETER`` or ``ATTITUDE``."""

    @property
    def is_on_side(self) -> bool:
        """Whether the vehicle lies on its side or back."""
        return self.angle is not None and self.angle > SIDE_ANGLE

    @property
    def rest_fact(self) -> Fact:
        """The fact that the vehicle rested, which a crash always has."""
        return supporting_fact(SensorFact.RESTED, time=self.time)

    @property
    def pose_facts(self) -> tuple[Fact, ...]:
        """Evidence for or against a crash, by the angle at which the vehicle rested: on its side, or upright.

        At most one fact (coded finding); empty if the angle is unknown.
        """
        if self.angle is None:
            return ()
        figures = {"time": self.time, "angle": self.angle, "source": self.source}
        if self.is_on_side:
            return (supporting_fact(SensorFact.LAY_ON_ITS_SIDE, **figures),)
        return (contradicting_fact(SensorFact.STOOD_UPRIGHT, **figures),)


@dataclass(frozen=True, eq=False)
class BootSensors:
    """The sensors of one boot: what they show in an interval, for or against an event; all times are s since boot."""

    signals: Signals
    """Signals of the vehicle."""
    boot: int
    """Number of the boot."""
    take_off: float = -inf
    """Start of the flight, s since boot, above which heights count; minus infinity if it was before the log."""

    @cached_property
    def trust(self) -> SensorTrust:
        """What can be trusted in this boot."""
        return sensor_trust(self.signals, self.boot)

    @property
    def height(self) -> HeightComparison:
        """Barometer and estimated climb."""
        return self.trust.height

    @property
    def stick(self) -> TimeSeries | None:
        """The pilot's throttle stick (N,), from 0 (closed) to 1 (open); None if it was not recorded."""
        return self.trust.stick

    @cached_property
    def record_end(self) -> float:
        """Time of the last attitude of the boot, s."""
        angle = series_of_boot(self.signals.tilts[0].angle_series, self.boot)
        assert angle is not None
        return float(angle.time[-1])

    @cached_property
    def reliable_height(self) -> ReliableHeight | None:
        """Height above the take-off by a source that can be trusted; None without any."""
        return reliable_height(self.signals, self.boot, self.take_off)

    @property
    def height_above_take_off(self) -> TimeSeries | None:
        """Height (N,) above the take-off, m, by a source that can be trusted; None without any."""
        return None if self.reliable_height is None else self.reliable_height.series

    @property
    def height_source(self) -> HeightSource | None:
        """What measured the height above the take-off; None without any."""
        return None if self.reliable_height is None else self.reliable_height.source

    def height_at(self, time: float) -> float | None:
        """Returns the height above the take-off at a time, m, by a source that can be trusted; None without any."""
        return reliable_height_at(self.signals, self.boot, self.take_off, time)

    def height_facts(self, min_height: float, time: float) -> tuple[Fact, ...]:
        """Returns a fact of each height sensor: whether it shows the vehicle above a height at some time.

        Args:
            min_height: height above the place of take-off, m, which is compared with the sensors.
            time: s since boot.

        Returns:
            Facts for or against a flight, of the barometer and of the autopilot's estimate if they were recorded.
            Empty if the take-off was before the log, since then the height above it is not known.
        """
        if isinf(self.take_off):
            return ()
        facts = []
        estimate = series_of_boot(self.signals.height, self.boot)
        for source, series in (("barometer", self.height.barometer), ("estimate", estimate)):
            if series is None:
                continue
            rise = series.value_at(time) - series.value_at(self.take_off)
            figures = {"time": time, "source": source, "height": max(rise, 0.0)}
            if rise > min_height:
                facts.append(supporting_fact(SensorFact.ROSE, **figures))
            else:
                facts.append(contradicting_fact(SensorFact.STAYED_LEVEL, **figures))
        return tuple(facts)

    @property
    def accelerometer(self) -> AccelerometerRecord | None:
        """The accelerometer that the estimator uses; None if none was recorded."""
        return self.trust.accelerometer

    @property
    def name_of_accelerometer(self) -> str:
        """Name of its IMU where several were recorded; otherwise empty."""
        if self.accelerometer is None or len(self.trust.accelerometers) < 2:
            return ""
        return self.accelerometer.name

    def knock_fact(self, interval: TimeInterval) -> Fact | None:
        """Returns the fact of the accelerometer on whether something knocked against the vehicle in an interval.

        A knock is a specific force of at least ``AccelerometerRecord.knock_size``. Slow accelerometers miss most
        knocks, so that only a fast one shows that there was none.

        Args:
            interval: start and end, s since boot.

        Returns:
            The fact for or against an impact, with the largest specific force, m/s². None if the accelerometer has no
            samples in the interval, or measured no knock but is too slow to show one.
        """
        accelerometer = self.accelerometer
        if accelerometer is None:
            return None
        peak = accelerometer.peak(interval)
        if peak is None:
            return None
        if peak.size >= accelerometer.knock_size:
            return supporting_fact(
                SensorFact.KNOCKED,
                time=peak.time,
                acceleration=peak.size,
                name=self.name_of_accelerometer,
            )
        if not accelerometer.shows_knocks:
            return None
        start, end = interval
        return contradicting_fact(
            SensorFact.NO_KNOCK,
            time=start,
            end_time=end,
            acceleration=peak.size,
            name=self.name_of_accelerometer,
        )

    def rotation_fact(self, interval: TimeInterval) -> Fact | None:
        """Returns the fact that the vehicle tumbled in an interval: that it rotated faster than ``FAST_RATE``.

        The fact supports an event such as a crash, in which a vehicle tumbles.

        Args:
            interval: start and end, s since boot.

        Returns:
            The fact, with the largest body rate, rad/s, and its time; None if no rate was above ``FAST_RATE``.
        """
        fastest = self.fastest_rotation(self.signals.attitudes, interval)
        if fastest.body_rate <= FAST_RATE:
            return None
        return supporting_fact(SensorFact.ROTATED, **fastest._asdict())

    def fastest_rotation(self, attitudes: Iterable[Attitude], interval: TimeInterval) -> Rotation:
        """Returns the largest body rate in an interval.

        Args:
            attitudes: motion about each of the axes to compare, such as all three, or roll and pitch only.
            interval: start and end, s since boot.

        Returns:
            The largest absolute rate of any axis, rad/s, and its time; 0 at the start of the interval if no rate was
            recorded in it.
        """
        start, _ = interval
        fastest = Rotation(time=start, body_rate=0.0)
        for attitude in attitudes:
            rate = series_of_boot(attitude.rate_series, self.boot)
            if rate is None:
                continue
            rate = rate.within(interval)
            rates = abs(rate.values)
            if len(rates) and rates.max() > fastest.body_rate:
                fastest = Rotation(float(rate.time[rates.argmax()]), float(rates.max()))
        return fastest

    @cached_property
    def climb_estimate(self) -> TimeSeries | None:
        """Climb by the autopilot's estimate (N,), m/s upward; None if it was not recorded.

        It is also None if it sank while the vehicle rested before its take-off, since then its speeds are wrong.

        After an impact the estimate often diverges. A barometer shows that (:meth:`sink_rate` compares the two). Where
        none was recorded, samples are left out at which the estimated height is more than ``MAX_GROUND_HEIGHT`` below
        the take-off, at which the vehicle cannot be.
        """
        climb_rate = series_of_boot(self.signals.climb_rate, self.boot)
        if climb_rate is not None and self._sinks_at_rest(climb_rate):
            return None
        height = series_of_boot(self.signals.height, self.boot)
        has_barometer = self.height.barometer_climb is not None
        if climb_rate is None or height is None or has_barometer or isinf(self.take_off):
            return climb_rate
        heights = np.interp(climb_rate.time, height.time, height.values)
        heights -= height.value_at(self.take_off)
        return climb_rate.select(heights > -MAX_GROUND_HEIGHT)

    def _sinks_at_rest(self, climb_rate: TimeSeries) -> bool:
        """Returns whether the estimate sank in the seconds before the take-off, in which the vehicle rested.

        Args:
            climb_rate: climb by the autopilot's estimate (N,), m/s upward.
        """
        before_take_off = (self.take_off - SECONDS_BEFORE_TAKE_OFF, self.take_off)
        rates_at_rest = climb_rate.within(before_take_off).values
        return bool(len(rates_at_rest) and np.median(rates_at_rest) < -MAX_SINK_RATE_AT_REST)

    def sink_rates(self, interval: TimeInterval) -> dict[HeightSource, float]:
        """Returns the largest speed downward in an interval, by each height sensor (:meth:`_fastest_descents`).

        Args:
            interval: start and end, s since boot.

        Returns:
            Speed downward, m/s, by the sensor, barometer and estimate; negative if the vehicle climbed throughout.
        """
        descents = self._fastest_descents(interval)
        return {source: descent.speed for source, descent in descents.items()}

    def _fastest_descents(self, interval: TimeInterval) -> dict[HeightSource, Descent]:
        """Returns the fastest descent in an interval by each height sensor.

        Args:
            interval: start and end, s since boot.

        Returns:
            Descents by the source, barometer and estimate; a source without samples in the interval, or with a
            speed that is not possible (:meth:`_fall_speed_limit`), is missing. The speed is negative if the vehicle
            climbed throughout.
        """
        descents = {}
        _, end = interval
        max_possible_speed = self._fall_speed_limit(end)
        for source, recorded_climb in (
            (HeightSource.BAROMETER, self.height.barometer_climb),
            (HeightSource.ESTIMATE, self.climb_estimate),
        ):
            if recorded_climb is None:
                continue
            climb = recorded_climb.within(interval)
            if not len(climb.time):
                continue
            speeds_downward = -climb.values
            row = int(speeds_downward.argmax())
            fastest_speed = float(speeds_downward[row])
            if fastest_speed <= max_possible_speed:
                descents[source] = Descent(fastest_speed, float(climb.time[row]), source)
        return descents

    def _fall_speed_limit(self, end: float) -> float:
        """Returns the speed downward that the vehicle cannot have exceeded before a time.

        A free fall from the greatest height of the flight to the lowest one ends at √(2 g h), and no multirotor exceeds
        ``MAX_FALL_SPEED``. A faster estimate has diverged, as often happens after an impact.

        Args:
            end: the time, s since boot.

        Returns:
            The speed downward, m/s.
        """
        height = self.height_above_take_off
        if height is None or isinf(self.take_off):
            return MAX_FALL_SPEED
        heights = height.within((self.take_off, end)).values
        if not len(heights):
            return MAX_FALL_SPEED
        # Without a barometer the height is the estimate itself, which may end far below the ground.
        has_barometer = self.height.barometer is not None
        lowest = float(heights.min()) if has_barometer else 0.0
        drop = max(float(heights.max()) - lowest, 0.0) + FALL_HEIGHT_MARGIN
        return min(float(np.sqrt(2 * GRAVITY * drop)), MAX_FALL_SPEED)

    def sink_rate(self, interval: TimeInterval) -> float | None:
        """Returns the speed of the :meth:`confirmed_descent` in an interval, m/s; None without one.

        Args:
            interval: start and end, s since boot.
        """
        descent = self.confirmed_descent(interval)
        return None if descent is None else descent.speed

    def confirmed_descent(self, interval: TimeInterval) -> Descent | None:
        """Returns the fastest descent in an interval that barometer and autopilot agree on, with its source.

        The autopilot's estimate is preferred, since the slope of the barometer's averages lags behind a short fall. If
        the two contradict each other, and not only by that lag, either may be wrong: then the result is the slower
        descent, which both confirm.

        Args:
            interval: start and end, s since boot.

        Returns:
            The descent, whose speed is at least 0 m/s; None if neither sensor has a possible speed in the interval.
        """
        descents = self._fastest_descents(interval)
        if not descents:
            return None
        descent = min(descents.values(), key=lambda each: each.speed)
        if HeightSource.ESTIMATE in descents and self._confirms_estimate(interval):
            descent = descents[HeightSource.ESTIMATE]
        return descent._replace(speed=max(0.0, descent.speed))

    def _confirms_estimate(self, interval: TimeInterval) -> bool:
        """Returns whether the barometer agrees with the estimated descent in an interval, or differs by its lag alone.

        Args:
            interval: start and end, s since boot.
        """
        start, end = interval
        # Both climb rates are averages, so that a contradiction may show a little later.
        search_interval = (start, end + CONTRADICTION_MARGIN)
        is_contradicted = bool(intersection(self.height.contradictions, [search_interval]))
        return not is_contradicted or self._barometer_sank_as_far(end)

    def _barometer_sank_as_far(self, end: float) -> bool:
        """Returns whether the barometer lost as much height as the estimate in the ``SLOPE_SECONDS`` before a time.

        In a fall of a second or two the barometer's climb rate, a slope over ``SLOPE_SECONDS``, lags behind and seems
        to contradict the estimate. The lost height does not lag: the averages show it ``MEAN_SECONDS / 2`` later.

        Args:
            end: the time, s since boot.
        """
        if self.climb_estimate is None:
            return False
        climb = self.climb_estimate.within((end - SLOPE_SECONDS, end))
        # The estimate must be known for at least half of these seconds.
        if len(climb.time) < 2 or climb.time[0] > end - SLOPE_SECONDS / 2:
            return False
        start = float(climb.time[0])
        estimated_change = float(np.trapezoid(climb.values, climb.time))
        barometer_change = self.height.barometer_change(start, end + MEAN_SECONDS / 2)
        if barometer_change is None:
            return False
        return barometer_change - estimated_change <= MAX_CLIMB_DIFFERENCE * SLOPE_SECONDS

    def sink_facts(
        self, interval: TimeInterval, min_speed: float = MIN_SINK_RATE
    ) -> tuple[Fact, ...]:
        """Returns a fact of each height sensor, barometer and estimate, on whether the vehicle sank fast.

        A sensor whose descent is faster than the other one confirms, by more than ``MAX_CLIMB_DIFFERENCE``, is left
        out.

        Args:
            interval: start and end, s since boot.
            min_speed: speed downward above which the vehicle sinks fast, m/s.

        Returns:
            Facts that support or contradict a crash, with the largest speed downward, m/s.
        """
        facts = []
        start, end = interval
        highest_confirmed_speed = (self.sink_rate(interval) or 0.0) + MAX_CLIMB_DIFFERENCE
        for source, descent in self._fastest_descents(interval).items():
            if descent.speed > max(min_speed, highest_confirmed_speed):
                continue
            figures = {"source": source, "speed": descent.speed}
            if descent.speed > min_speed:
                facts.append(supporting_fact(SensorFact.SANK, time=descent.time, **figures))
            else:
                facts.append(
                    contradicting_fact(SensorFact.DID_NOT_SINK, time=start, end_time=end, **figures)
                )
        return tuple(facts)

    def throttle_closed_fact(self, interval: TimeInterval) -> Fact | None:
        """Returns the fact that the pilot moved the throttle stick from open to closed in an interval.

        Args:
            interval: start and end, s since boot. The stick must have been open in it, or in the
                ``OPEN_BEFORE_SECONDS`` before it: a stick that was closed all the time was not moved.

        Returns:
            A fact with the time of the first closed sample; None if the stick was not recorded, was not closed in the
            interval, or had been closed before.
        """
        stick = self.stick
        if stick is None:
            return None
        is_closed = stick.values <= CLOSED_STICK
        start, end = interval
        # The largest travel of the stick up to each sample, from shortly before the interval on.
        is_recent = stick.time >= start - OPEN_BEFORE_SECONDS
        largest_travel = np.maximum.accumulate(np.where(is_recent, stick.values, 0.0))
        is_inside = (stick.time >= start) & (stick.time <= end)
        was_open = largest_travel > OPEN_STICK
        times_of_closing = stick.time[is_inside & is_closed & was_open]
        if not len(times_of_closing):
            return None
        return supporting_fact(SensorFact.THROTTLE_CLOSED, time=times_of_closing[0])

    def rest_after(self, time: float, latest: float) -> Rest | None:
        """Finds when the vehicle first rested on the ground between two times, and in which pose.

        The vehicle rests if it is still for ``MIN_REST_SECONDS`` while the motors do not carry it, or while it lies on
        its side, in which no vehicle can hover. The record of rest has windows of ``REST_SECONDS``, so that a rest is a
        run of neighbouring windows.

        Args:
            time: earliest beginning of the rest, s since boot.
            latest: end of the search, s since boot; windows that start later are ignored.

        Returns:
            Beginning of the rest, s since boot; median angle from upright, rad, None if it is not known; and the source
            of that angle. None if the vehicle did not rest.
        """
        record = _rest_record(self.signals, self.boot)
        if record is None:
            return None
        is_resting = (record.start >= time) & (record.start <= latest) & record.is_rest
        needed_windows = round(MIN_REST_SECONDS / REST_SECONDS)
        if len(is_resting) < needed_windows:
            return None
        # Row i of the view has the flags of the windows i to i + needed_windows − 1: all of them must be at rest.
        begins_rest = sliding_window_view(is_resting, needed_windows).all(axis=1)
        if not begins_rest.any():
            return None
        first_window = int(np.argmax(begins_rest))
        end_window = first_window + needed_windows
        angles = record.angle[first_window:end_window]
        finite_angles = angles[np.isfinite(angles)]
        median_angle = float(np.median(finite_angles)) if len(finite_angles) else None
        # The record computes the angle from the accelerometer or, without one, from the attitude.
        source = ATTITUDE if self.accelerometer is None else ACCELEROMETER
        return Rest(float(record.start[first_window]), median_angle, source)


@dataclass(frozen=True, eq=False)
class _RestRecord:
    """Rest of the vehicle in W windows of ``REST_SECONDS`` of one boot."""

    start: Array
    """(W,) s since boot."""
    is_rest: Flags
    """(W,) whether the vehicle rested on the ground."""
    angle: Array
    """(W,) angle of the body's vertical axis from upright, rad; NaN without an accelerometer or attitude."""


@cached_per_vehicle()
def _rest_record(signals: Signals, boot: int) -> _RestRecord | None:
    """Judges in each window of a boot whether the vehicle rests on the ground, and how far it is from upright.

    A still vehicle rests if the outputs of its motors are too low to carry it. If it is tilted by more than
    ``SIDE_ANGLE`` it rests even if the motors run, since no vehicle hovers on its side.

    Args:
        signals: logged time series of the vehicle, such as attitude, setpoints and motor outputs.
        boot: number of the boot; a boot lasts from one start of the autopilot to the next.

    Returns:
        Start, rest and angle from upright of each window; None if the body rates were not recorded.
    """
    still = still_windows(signals, boot)
    if still is None:
        return None
    middle = still.start + REST_SECONDS / 2
    angle = _angle_from_upright(signals, boot, middle)
    lies_on_side = angle > SIDE_ANGLE
    # Without the motors' outputs only the pose shows the ground.
    has_power = is_powered(signals, boot, middle)
    is_grounded = lies_on_side if has_power is None else ~has_power | lies_on_side
    is_rest = still.is_still & is_grounded
    return _RestRecord(still.start, is_rest, angle)


def _angle_from_upright(signals: Signals, boot: int, time: Array) -> Array:
    """Returns the angle of the vehicle from upright at some times.

    The accelerometer is preferred, because the estimated attitude may be wrong after a crash: while the vehicle stands
    upright and still, the specific force points against body z. Without one the angle follows from roll and pitch, by
    cos(angle) = cos(roll) cos(pitch).

    Args:
        signals: logged time series of the vehicle, such as attitude, setpoints and motor outputs.
        boot: number of the boot; a boot lasts from one start of the autopilot to the next.
        time: (W,) s since boot. The angle is meaningful only while the vehicle is still.

    Returns:
        The angle (W,), rad; NaN if neither was recorded.
    """
    accelerometer = accelerometer_in_use(signals, boot)
    if accelerometer is not None:
        force_along_axes = []
        for recorded_force in accelerometer.force.T:
            force_along_axes.append(np.interp(time, accelerometer.time, recorded_force))
        force = np.column_stack(force_along_axes)
        size = np.linalg.norm(force, axis=1)
        # A force of size 0 has no direction, and gives NaN.
        with np.errstate(invalid="ignore", divide="ignore"):
            cosine = -force[:, 2] / size
            return np.arccos(np.clip(cosine, -1, 1))
    angles = []
    for tilt in signals.tilts:
        angle = series_of_boot(tilt.angle_series, boot)
        if angle is not None:
            angles.append(np.interp(time, angle.time, angle.values))
    if len(angles) < 2:
        return np.full(len(time), np.nan)
    return np.arccos(np.clip(np.cos(angles[0]) * np.cos(angles[1]), -1, 1))
