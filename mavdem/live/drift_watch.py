"""Whether wind carries a live vehicle away: it leans as far as it may against its motion, and moves on all the same.

Braking looks the same, but is over soon: at a lean of 40° a vehicle loses 8 m/s each second.
"""

from collections import deque
from math import acos, cos, hypot, radians, sin
from statistics import fmean
from typing import NamedTuple

from mavdem.assessment.lights.wind import lean_limit
from mavdem.containers import Numbers
from mavdem.facts import Fact, Facts
from mavdem.facts.lights import Light
from mavdem.facts.watch import WatchFact
from mavdem.ingest.telemetry import Parameters
from mavdem.motors.motor_changes import event_or_alarm

USUAL_LEAN_LIMIT = radians(45.0)
"""Largest lean where its parameter is not known, rad: the default of MPC_TILTMAX_AIR and ANGLE_MAX."""

LIMIT_SHARE = 0.9
"""Share of the largest lean from which on a vehicle has no lean left against the wind: a choice."""

MIN_DRIFT_SPEED = 0.5
"""Least speed against the thrust that counts as motion, m/s: estimates of the velocity err by less."""

SAMPLE_PERIOD = 0.1
"""Least time between two samples that are kept, s: a choice."""

MAX_SAMPLE_GAP = 0.6
"""Longest usual time between two velocities, s, since they come twice a second or faster.

The samples of ``DRIFT_SECONDS`` may span so much less than that at each end. Gaps between them are not judged.
"""

DRIFT_SECONDS = 5.0
"""Time over which lean and speed against the thrust are averaged until wind is said to carry the vehicle away, s.

Braking at 40° for so long would take 40 m/s away: what still moves was not braking.
"""


class _DriftSample(NamedTuple):
    """Lean and motion at one time."""

    time: float
    """Time on the boot clock, s."""

    lean: float
    """Angle between the thrust and the vertical, rad."""

    opposing_speed: float
    """Horizontal speed against the thrust, m/s."""


class DriftWatch:
    """Watches the flights of one boot for a vehicle that is carried away.

    Attributes:
        latest: the latest time that it was carried away as a fact; None if it was not.
    """

    def __init__(self) -> None:
        """Begins without a sample."""
        self.latest: Fact | None = None
        # Those of the last ``DRIFT_SECONDS``.
        self._samples: deque[_DriftSample] = deque()
        self._is_active = False
        # The end of the latest alarm.
        self._over: Fact | None = None
        # Whether the flight of ``latest`` has ended.
        self._has_landed = False

    @property
    def active(self) -> Facts:
        """That the vehicle is carried away now, if it is."""
        return (self.latest,) if self._is_active and self.latest is not None else ()

    @property
    def lights(self) -> dict[str, Fact]:
        """The light of the wind, if the vehicle was carried away; without one otherwise.

        Once that is over the light says so, at the same level.
        """
        if self.latest is None:
            return {}
        if self._is_active:
            return {Light.WIND: self.latest}
        return {Light.WIND: self._over.replace(self.latest.level)} if self._over else {}

    def end_flight(self) -> None:
        """Ends an alarm after a landing; what happened stays known until the next take-off."""
        self._has_landed = True
        if self._samples:
            self._end(self._samples[-1].time)
        self._samples.clear()

    def add_sample(
        self, time: float, angles: Numbers, velocity: Numbers, parameters: Parameters
    ) -> Fact | None:
        """Takes a velocity in flight with the latest attitude.

        Args:
            time: time on the boot clock, s.
            angles: roll, pitch and yaw, rad.
            velocity: north and east, m/s.
            parameters: parameters of the vehicle that are known, of which one limits the lean.

        Returns:
            An alarm where the vehicle begins to be carried away, the end of that alarm, or None.
        """
        if self._has_landed:
            self._has_landed = False
            self.latest = None
        samples = self._samples
        if samples and time < samples[-1].time + SAMPLE_PERIOD:
            return None
        roll, pitch, yaw = angles
        lean = acos(min(max(cos(roll) * cos(pitch), -1.0), 1.0))
        # The horizontal part of the thrust, which points against the body's downward axis.
        thrust_north = -(cos(yaw) * sin(pitch) * cos(roll) + sin(yaw) * sin(roll))
        thrust_east = -(sin(yaw) * sin(pitch) * cos(roll) - cos(yaw) * sin(roll))
        thrust = hypot(thrust_north, thrust_east)
        north, east = velocity
        opposing_speed = 0.0
        if thrust > 0:
            opposing_speed = -(north * thrust_north + east * thrust_east) / thrust
        samples.append(_DriftSample(time, lean, opposing_speed))
        while samples[0].time < time - DRIFT_SECONDS:
            samples.popleft()
        if time - samples[0].time < DRIFT_SECONDS - 2 * MAX_SAMPLE_GAP:
            return self._end(time)
        mean_lean = fmean(sample.lean for sample in samples)
        mean_speed = fmean(sample.opposing_speed for sample in samples)
        is_leaned = mean_lean >= LIMIT_SHARE * (lean_limit(parameters) or USUAL_LEAN_LIMIT)
        if not is_leaned or mean_speed < MIN_DRIFT_SPEED:
            return self._end(time)
        # What has come to rest in the end was braking.
        if self._is_active or opposing_speed < MIN_DRIFT_SPEED:
            return None
        self._is_active = True
        self.latest = Fact(
            WatchFact.CARRIED_AWAY, time=samples[0].time, lean=mean_lean, speed=mean_speed
        )
        return event_or_alarm(self.latest, samples[0].time)

    def _end(self, time: float) -> Fact | None:
        """Returns that the alarm is over at a time on the boot clock, s; None where there was none."""
        if not self._is_active or self.latest is None:
            return None
        self._is_active = False
        self._over = Fact(WatchFact.ALARM_OVER, time=time, reason=self.latest)
        return self._over
