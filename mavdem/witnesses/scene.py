"""What the sensors show around one moment: knocks, rotation, sinking, rest and the stick, each as a statement."""

from dataclasses import dataclass
from functools import cached_property
from math import inf, isinf

import numpy as np

from mavdem.arrays import Array, Flags
from mavdem.confidence import Interval
from mavdem.dataset.intervals import intersection
from mavdem.dataset.phases import MAX_GROUND_HEIGHT, min_airborne_collective, series_of_boot
from mavdem.dataset.signals import Signals
from mavdem.dataset.time_series import TimeSeries
from mavdem.dataset.vehicle_cache import cached_per_vehicle
from mavdem.facts import Fact
from mavdem.facts.witnesses import Witness
from mavdem.witnesses.accelerometer import (
    REST_SECONDS,
    AccelerometerWitness,
    accelerometer_witness,
    still_windows,
)
from mavdem.witnesses.height import HeightWitnesses, height_witnesses, trusted_height
from mavdem.witnesses.sensors import throttle_stick
from mavdem.witnesses.statements import (
    ACCELEROMETER,
    ATTITUDE,
    contradicting_statement,
    supporting_statement,
)

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
"""Travel of the throttle stick from which on it was open before."""

CONTRADICTION_MARGIN = 0.5
"""Seconds after a moment within which a contradiction of barometer and estimate concerns it: both are averages."""

MIN_REST_SECONDS = 1.0
"""Seconds of rest that show that the vehicle lies on the ground."""


@dataclass(frozen=True)
class Rest:
    """How a vehicle came to rest."""

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
    def statements(self) -> tuple[Fact, ...]:
        """The rest, and the pose, as witnesses of a crash."""
        rested = supporting_statement(Witness.RESTED, time=self.time)
        if self.angle is None:
            return (rested,)
        if self.is_on_side:
            pose = supporting_statement(
                Witness.LAY_ON_ITS_SIDE, angle=self.angle, source=self.source
            )
        else:
            pose = contradicting_statement(
                Witness.STOOD_UPRIGHT, angle=self.angle, source=self.source
            )
        return (rested, pose)


@dataclass(frozen=True, eq=False)
class Scene:
    """The sensors of one boot, to be asked about moments; times and intervals are s since boot."""

    signals: Signals
    """Signals of the vehicle."""
    boot: int
    """Number of the boot."""
    take_off: float = -inf
    """Start of the flight, s since boot, above which heights count; minus infinity if it was before the log."""

    @cached_property
    def height(self) -> HeightWitnesses:
        """Barometer and estimated climb."""
        return height_witnesses(self.signals, self.boot)

    def height_at(self, time: float) -> float | None:
        """Returns the height above the take-off at a time, m, by a source that can be trusted; None without any."""
        height = trusted_height(self.signals, self.boot, self.take_off)
        return None if height is None else float(np.interp(time, height.time, height.values))

    @cached_property
    def accelerometer(self) -> AccelerometerWitness | None:
        """The accelerometer; None if it was not recorded."""
        return accelerometer_witness(self.signals, self.boot)

    def knock(self, interval: Interval) -> Fact | None:
        """Returns the largest acceleration of an interval as a statement on an impact.

        Returns:
            None if the accelerometer is too slow to show a knock, or has no samples in the interval.
        """
        accelerometer = self.accelerometer
        if accelerometer is None:
            return None
        peak = accelerometer.peak(interval)
        if peak is None:
            return None
        time, size = peak
        if size >= accelerometer.knock_size:
            return supporting_statement(Witness.KNOCKED, time=time, acceleration=size)
        if not accelerometer.shows_knocks:
            return None
        return contradicting_statement(Witness.NO_KNOCK, acceleration=size)

    def fast_rotation(self, interval: Interval) -> Fact | None:
        """Returns that the vehicle tumbled in an interval; None if its body rates stayed below ``FAST_RATE``."""
        fastest = 0.0
        for attitude in self.signals.attitudes:
            rate = series_of_boot(attitude.rate_series, self.boot)
            if rate is not None:
                is_inside = (rate.time >= interval[0]) & (rate.time <= interval[1])
                fastest = max(fastest, float(abs(rate.values[is_inside]).max(initial=0.0)))
        return (
            supporting_statement(Witness.ROTATED, body_rate=fastest)
            if fastest > FAST_RATE
            else None
        )

    @cached_property
    def climb_estimate(self) -> TimeSeries | None:
        """Estimated climb (N,), m/s upward, without what diverged: samples far below the take-off; None without any.

        After an impact the estimate often runs away. Where a barometer was recorded it shows that, else the estimated
        height does.
        """
        climb_rate = series_of_boot(self.signals.climb_rate, self.boot)
        height = series_of_boot(self.signals.height, self.boot)
        has_barometer = self.height.barometer_climb is not None
        if climb_rate is None or height is None or has_barometer or isinf(self.take_off):
            return climb_rate
        start_height = np.interp(self.take_off, height.time, height.values)
        heights = np.interp(climb_rate.time, height.time, height.values) - start_height
        return climb_rate.select(heights > -MAX_GROUND_HEIGHT)

    def sink_rates(self, interval: Interval) -> dict[str, float]:
        """Returns the largest speed downward in an interval, m/s, by "barometer" and "estimate", as far as known.

        A climb throughout is a negative speed.
        """
        rates = {}
        for source, climb in (
            ("barometer", self.height.barometer_climb),
            ("estimate", self.climb_estimate),
        ):
            if climb is None:
                continue
            is_inside = (climb.time >= interval[0]) & (climb.time <= interval[1])
            if is_inside.any():
                rates[source] = float(-climb.values[is_inside].min())
        return rates

    def sink_rate(self, interval: Interval) -> float | None:
        """Returns the largest speed downward in an interval, m/s, that the height sensors do not contradict.

        That is the estimate's, or the lesser of barometer and estimate where the two contradict each other: the slope
        of a barometer lags behind a short fall. It is 0 for a climb throughout, None if neither was recorded.
        """
        rates = self.sink_rates(interval)
        if not rates:
            return None
        around = [(interval[0], interval[1] + CONTRADICTION_MARGIN)]
        if "estimate" in rates and not intersection(self.height.contradictions, around):
            return max(0.0, rates["estimate"])
        return max(0.0, min(rates.values()))

    def sinking(self, interval: Interval, least: float = MIN_SINK_RATE) -> tuple[Fact, ...]:
        """Returns for barometer and estimate whether they sank faster than ``least``, m/s, in an interval."""
        statements = []
        for source, rate in self.sink_rates(interval).items():
            if rate > least:
                statements.append(supporting_statement(Witness.SANK, source=source, speed=rate))
            else:
                statements.append(
                    contradicting_statement(Witness.DID_NOT_SINK, source=source, speed=rate)
                )
        return tuple(statements)

    def throttle_closed(self, interval: Interval) -> Fact | None:
        """Returns when the pilot closed the throttle in an interval; None if the stick stayed open, or was closed."""
        stick = series_of_boot(throttle_stick(self.signals), self.boot)
        if stick is None:
            return None
        is_closed = stick.values <= CLOSED_STICK
        was_open = np.maximum.accumulate(
            np.where(stick.time >= interval[0] - MIN_REST_SECONDS, stick.values, 0.0)
        )
        is_inside = (stick.time >= interval[0]) & (stick.time <= interval[1])
        rows = np.flatnonzero(is_inside & is_closed & (was_open > OPEN_STICK))
        if not len(rows):
            return None
        return supporting_statement(Witness.THROTTLE_CLOSED, time=stick.time[rows[0]])

    def rest_after(self, time: float, latest: float) -> Rest | None:
        """Returns how the vehicle came to rest between two times, s; None if it did not.

        It rests where it does not rotate for ``MIN_REST_SECONDS`` and the motors do not carry it, or where it lies on
        its side, which no motor holds still in the air.
        """
        record = _rest_record(self.signals, self.boot)
        if record is None:
            return None
        needed = round(MIN_REST_SECONDS / REST_SECONDS)
        is_candidate = (record.start >= time) & (record.start <= latest) & record.is_rest
        run = 0
        for row in np.flatnonzero(is_candidate).tolist():
            is_next = run > 0 and bool(is_candidate[row - 1])
            run = run + 1 if is_next else 1
            if run == needed:
                first = row - needed + 1
                angles = record.angle[first : row + 1]
                known = angles[np.isfinite(angles)]
                angle = float(np.median(known)) if len(known) else None
                source = ATTITUDE if self.accelerometer is None else ACCELEROMETER
                return Rest(float(record.start[first]), angle, source)
        return None


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
    """Judges rest and pose of a boot, window by window; None if the body rates were not recorded.

    Args:
        signals: signals of the vehicle.
        boot: number of the boot.
    """
    still = still_windows(signals, boot)
    if still is None:
        return None
    middle = still.start + REST_SECONDS / 2
    angle = _angle_from_upright(signals, boot, middle)
    is_unpowered = _is_unpowered(signals, boot, middle)
    is_rest = still.is_still & (is_unpowered | (angle > SIDE_ANGLE))
    return _RestRecord(still.start, is_rest, angle)


def _is_unpowered(signals: Signals, boot: int, time: Array) -> Flags:
    """Returns whether the motors are known to be too slow to carry the vehicle at some times (W,), s."""
    collective = series_of_boot(signals.collective, boot)
    if collective is None:
        return np.zeros(len(time), dtype=bool)
    least = min_airborne_collective(signals.telemetry.parameters)
    return np.asarray(np.interp(time, collective.time, collective.values) <= least)


def _angle_from_upright(signals: Signals, boot: int, time: Array) -> Array:
    """Returns how far the vehicle is from upright at some times (W,), rad; NaN where nothing shows it.

    The direction of gravity in the body shows it while the vehicle is still, however wrong the attitude is after a
    crash: upright, the specific force points against body z. Without an accelerometer, roll and pitch show the angle.
    """
    accelerometer = accelerometer_witness(signals, boot)
    if accelerometer is not None:
        force = np.column_stack(
            [np.interp(time, accelerometer.time, axis) for axis in accelerometer.force.T]
        )
        length = np.linalg.norm(force, axis=1)
        with np.errstate(invalid="ignore", divide="ignore"):
            return np.arccos(np.clip(-force[:, 2] / length, -1, 1))
    angles = []
    for tilt in signals.tilts:
        angle = series_of_boot(tilt.angle_series, boot)
        if angle is not None:
            angles.append(np.interp(time, angle.time, angle.values))
    if len(angles) < 2:
        return np.full(len(time), np.nan)
    return np.arccos(np.clip(np.cos(angles[0]) * np.cos(angles[1]), -1, 1))
