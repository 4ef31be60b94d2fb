"""Wind that carries a vehicle away, as facts (coded findings): it leans as far as it may against its motion in vain.

Braking looks the same, but is over soon: at a lean of 40° a vehicle loses 8 m/s each second. Logs and live flights are
judged by the same detector, sample by sample.
"""

from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass
from math import acos, cos, hypot, inf, radians, sin
from statistics import fmean
from typing import NamedTuple

import numpy as np

from mavdem.assessment.flights import RECOVERY_SECONDS
from mavdem.assessment.lights.wind import lean_limit
from mavdem.containers import Numbers
from mavdem.dataset.axes import AXES
from mavdem.dataset.intervals import TimeInterval, in_intervals, merge_close_intervals
from mavdem.dataset.parameter_history import parameter_history
from mavdem.dataset.segments import Segment
from mavdem.dataset.time_series import series_of_boot
from mavdem.facts import Fact
from mavdem.facts.ending import MotionEvent
from mavdem.ingest.telemetry import Parameters, last_values
from mavdem.wind_velocity.ground_motion import horizontal_velocity
from mavdem.witnesses.boot_sensors import BootSensors

USUAL_LEAN_LIMIT = radians(45.0)
"""Largest lean where its parameter is not known, rad: the default of MPC_TILTMAX_AIR and ANGLE_MAX."""

LIMIT_FRACTION = 0.9
"""Fraction of the largest lean from which on a vehicle has no lean left against the wind: a choice."""

MAX_LIMIT_FRACTION = 1.2
"""Mean lean over the largest that the autopilot commands, beyond which something else than wind leans the vehicle."""

MIN_DRIFT_SPEED = 0.5
"""Least speed against the thrust that counts as motion, m/s: estimates of the velocity err by less."""

SAMPLE_PERIOD = 0.1
"""Least time between two samples that are used, s: a choice."""

MAX_SAMPLE_GAP = 0.6
"""Longest usual time between two velocities, s, since they come twice a second or faster.

The samples of ``DRIFT_SECONDS`` may span so much less than that at each end. Gaps between them are not judged.
"""

MAX_POSE_AGE = 1.0
"""Age up to which an attitude is that of a velocity, s: as long as none is missing, it is much younger. A choice."""

DRIFT_SECONDS = 5.0
"""Time over which lean and speed against the thrust are averaged until wind is said to carry the vehicle away, s.

Braking at 40° for so long would take 40 m/s away: what still moves was not braking.
"""


class DriftSample(NamedTuple):
    """Lean and motion at one time."""

    time: float
    """Time on the boot clock, s."""

    lean: float
    """Angle between the thrust and the vertical, rad."""

    opposing_speed: float
    """Horizontal speed against the thrust, m/s."""


def drift_sample(time: float, angles: Numbers, velocity: Numbers) -> DriftSample:
    """Returns the lean of a multirotor, and the horizontal speed at which it moves against its thrust.

    The thrust points along the body's upward axis. Its direction on the earth (north, east, down) is therefore minus
    the third column of the rotation matrix R from body to earth, of the angles yaw, pitch and roll. The lean is the
    angle between the thrust and the vertical.

    Args:
        time: time on the boot clock, s.
        angles: roll, pitch and yaw, rad.
        velocity: velocity to the north and east, m/s.

    Returns:
        The sample. Its speed is negative if the vehicle moves with its thrust, and 0 if the thrust is vertical.
    """
    roll, pitch, yaw = angles
    speed_north, speed_east = velocity
    # Rounding may take the cosine, element (3, 3) of R, beyond 1, for which there is no angle.
    cosine_of_lean = min(max(cos(roll) * cos(pitch), -1.0), 1.0)
    lean = acos(cosine_of_lean)
    # The horizontal part of the unit vector along the thrust: minus the elements (1, 3) and (2, 3) of R.
    thrust_north = -(cos(yaw) * sin(pitch) * cos(roll) + sin(yaw) * sin(roll))
    thrust_east = -(sin(yaw) * sin(pitch) * cos(roll) - cos(yaw) * sin(roll))
    horizontal_thrust = hypot(thrust_north, thrust_east)
    opposing_speed = 0.0
    if horizontal_thrust > 0:
        speed_along_thrust = (
            speed_north * thrust_north + speed_east * thrust_east
        ) / horizontal_thrust
        opposing_speed = -speed_along_thrust
    return DriftSample(time, lean, opposing_speed)


@dataclass
class _DriftTotals:
    """Sums over the samples of one drift."""

    start_time: float
    """Time of its first sample, s on the boot clock."""

    latest_time: float = -inf
    """Time of its latest sample, s on the boot clock."""

    sample_count: int = 0
    """Number of samples."""

    sum_of_leans: float = 0.0
    """Sum of the samples' leans, rad."""

    sum_of_opposing_speeds: float = 0.0
    """Sum of the samples' speeds against the thrust, m/s."""

    @property
    def mean_lean(self) -> float:
        """Mean lean of the samples, rad; there is at least one."""
        return self.sum_of_leans / self.sample_count

    @property
    def mean_opposing_speed(self) -> float:
        """Mean speed of the samples against the thrust, m/s; there is at least one."""
        return self.sum_of_opposing_speeds / self.sample_count

    def add(self, sample: DriftSample) -> None:
        """Adds a sample, unless it was added before."""
        if sample.time > self.latest_time:
            self.latest_time = sample.time
            self.sample_count += 1
            self.sum_of_leans += sample.lean
            self.sum_of_opposing_speeds += sample.opposing_speed


class WindDriftDetector:
    """Finds in which times of a flight wind carries the vehicle away, sample by sample."""

    def __init__(self, boot: int = 0) -> None:
        """Begins the search for drifts, without a sample.

        Args:
            boot: number of the boot, which the events state.
        """
        self._boot = boot
        # The samples of the last ``DRIFT_SECONDS``.
        self._samples: deque[DriftSample] = deque()
        # The latest drift, None before any; and when it ended, s on the boot clock, None while it lasts.
        self._drift: _DriftTotals | None = None
        self._end_time: float | None = None

    @property
    def latest(self) -> Fact | None:
        """The latest drift as an event, without an end while it lasts; None before any.

        Its figures are means over the drift: ``lean``, rad, and ``speed`` against the thrust, m/s. The ``distance``, m,
        is this speed times the duration from the first sample to the latest.
        """
        drift = self._drift
        if drift is None:
            return None
        duration = drift.latest_time - drift.start_time
        return Fact(
            MotionEvent.CARRIED_AWAY,
            time=drift.start_time,
            end_time=self._end_time,
            lean=drift.mean_lean,
            speed=drift.mean_opposing_speed,
            distance=drift.mean_opposing_speed * duration,
            boot=self._boot,
        )

    @property
    def _is_drifting(self) -> bool:
        """Whether the latest drift lasts."""
        return self._drift is not None and self._end_time is None

    def add_sample(self, sample: DriftSample, parameters: Parameters) -> None:
        """Takes the next sample of the flight, which begins, continues or ends a drift.

        A sample less than ``SAMPLE_PERIOD`` after the last one is not used.

        Args:
            sample: lean and motion in flight.
            parameters: known parameters of the vehicle; one of them limits the lean.
        """
        # The samples of the last ``DRIFT_SECONDS``.
        samples = self._samples
        if samples and sample.time < samples[-1].time + SAMPLE_PERIOD:
            return
        if samples and sample.time > samples[-1].time + DRIFT_SECONDS:
            # What the vehicle did in a long gap is not known.
            self.end(samples[-1].time)
        samples.append(sample)
        while samples[0].time < sample.time - DRIFT_SECONDS:
            samples.popleft()
        if not self._shows_drift(parameters):
            self.end(sample.time)
        elif self._is_drifting:
            assert self._drift is not None
            self._drift.add(sample)
        elif sample.opposing_speed >= MIN_DRIFT_SPEED:
            # A vehicle that has come to rest by now was braking, and did not drift.
            self._begin_drift()

    def _shows_drift(self, parameters: Parameters) -> bool:
        """Returns whether the vehicle has leaned as far as it may for ``DRIFT_SECONDS``, and moved against its thrust.

        Args:
            parameters: parameters of the vehicle that are known.
        """
        samples = self._samples
        covered_seconds = samples[-1].time - samples[0].time
        # The samples do not lie exactly at both ends of the time.
        if covered_seconds < DRIFT_SECONDS - 2 * MAX_SAMPLE_GAP:
            return False
        mean_lean = fmean(sample.lean for sample in samples)
        lean_fraction = mean_lean / _largest_lean(parameters)
        mean_speed = fmean(sample.opposing_speed for sample in samples)
        leans_to_limit = LIMIT_FRACTION <= lean_fraction <= MAX_LIMIT_FRACTION
        return leans_to_limit and mean_speed >= MIN_DRIFT_SPEED

    def _begin_drift(self) -> None:
        """Begins a drift with the samples of the last ``DRIFT_SECONDS``, which are what shows it.

        A drift that ended less than ``RECOVERY_SECONDS`` before the first of them is continued instead. It may contain
        some of them already, which its totals do not count twice.
        """
        start_time = self._samples[0].time
        is_over = self._end_time is not None and start_time - self._end_time >= RECOVERY_SECONDS
        if self._drift is None or is_over:
            self._drift = _DriftTotals(start_time)
        self._end_time = None
        for sample in self._samples:
            self._drift.add(sample)

    def end(self, time: float) -> None:
        """Ends the drift, if one lasts, at a time on the boot clock, s."""
        if self._is_drifting:
            self._end_time = time


def _largest_lean(parameters: Parameters) -> float:
    """Returns the largest lean that the autopilot commands, rad; the usual one if no known parameter limits it."""
    return lean_limit(parameters) or USUAL_LEAN_LIMIT


def wind_drifts(sensors: BootSensors, flight_interval: TimeInterval) -> Iterator[Fact]:
    """Yields an event for each time in a flight in which wind carried the vehicle away.

    Args:
        sensors: sensors of the vehicle in one boot, which lasts from one start of the autopilot to the next.
        flight_interval: start and end of the flight, s since boot.

    Yields:
        The events of a :class:`WindDriftDetector`; none of a vehicle whose velocity or yaw was not recorded.
    """
    flight = Segment(sensors.boot, *flight_interval)
    parameters = parameter_history(sensors.signals).during([flight]).any_values
    detector = WindDriftDetector(sensors.boot)
    # The latest state of each drift, by the time at which it began.
    events = {}
    latest_time = -inf
    for sample in _samples_around_large_leans(sensors, flight_interval, parameters):
        detector.add_sample(sample, parameters)
        latest_time = sample.time
        if detector.latest is not None:
            events[detector.latest.start_time] = detector.latest
    if detector.latest is not None:
        # A drift that lasts at the end of the flight ends with it.
        detector.end(latest_time)
        events[detector.latest.start_time] = detector.latest
    yield from events.values()


def _samples_around_large_leans(
    sensors: BootSensors, flight_interval: TimeInterval, parameters: Parameters
) -> Iterator[DriftSample]:
    """Yields lean and motion of the vehicle around all times of a flight at which it leans near its limit.

    Only these times can show a drift. Most flights have none, and need not be searched.

    Args:
        sensors: sensors of the vehicle in one boot, which lasts from one start of the autopilot to the next.
        flight_interval: start and end of the flight, s since boot.
        parameters: parameters of the autopilot in the flight; one of them limits the lean.

    Yields:
        Samples at the times of the velocity, with the attitude before each; none if velocity or yaw was not recorded.
    """
    signals, boot = sensors.signals, sensors.boot
    velocity = series_of_boot(horizontal_velocity(signals), boot)
    if velocity is None:
        return
    velocity = velocity.within(flight_interval)
    columns = []
    has_recent_attitude = np.ones(len(velocity.time), dtype=bool)
    for attitude in signals.attitudes:
        angle = series_of_boot(attitude.angle_series, boot)
        if angle is not None:
            # An attitude holds until the next one, but not for long, as in a live session.
            columns.append(last_values(velocity.time, angle.time, angle.values))
            attitude_time = last_values(velocity.time, angle.time, angle.time)
            has_recent_attitude &= velocity.time - attitude_time < MAX_POSE_AGE
    if len(columns) < len(AXES):
        return
    roll, pitch, _ = columns
    least_lean = LIMIT_FRACTION * _largest_lean(parameters)
    is_leaned = np.cos(roll) * np.cos(pitch) <= np.cos(least_lean)
    leaned_moments = [(time, time) for time in velocity.time[is_leaned].tolist()]
    around_leans = []
    for start, end in merge_close_intervals(leaned_moments, 2 * DRIFT_SECONDS):
        around_leans.append((start - DRIFT_SECONDS, end + DRIFT_SECONDS))
    is_searched = has_recent_attitude & in_intervals(velocity.time, around_leans)
    times = velocity.time[is_searched].tolist()
    angles = np.column_stack(columns)[is_searched].tolist()
    velocities = velocity.values[is_searched].tolist()
    yield from map(drift_sample, times, angles, velocities)
