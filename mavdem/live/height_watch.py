"""Wrong heights of a live vehicle, judged as those of a log: an estimate that diverges, a barometer that drifts.

The estimator follows its barometer, so that a barometer that drifts shows only after the landing, at rest.
"""

from dataclasses import replace
from math import isfinite

from mavdem.assessment.barometer_drifts import barometer_drifts
from mavdem.assessment.height_divergence import height_divergences
from mavdem.dataset.intervals import TimeInterval
from mavdem.dataset.signals import CLIMB_RATE_FIELDS, Signals
from mavdem.facts import Fact
from mavdem.ingest.telemetry import Telemetry
from mavdem.live.control_watch import ControlWatch
from mavdem.live.live_signals import RecentMotion
from mavdem.live.recent_messages import RecentMessages
from mavdem.witnesses.accelerometer import rest_intervals
from mavdem.witnesses.boot_sensors import BootSensors
from mavdem.witnesses.height import GRID_RATE, height_comparison
from mavdem.witnesses.sensors import BAROMETERS

BAROMETER_MESSAGE = BAROMETERS[0]
"""The message of the barometer that is received live."""

MEMORY_SECONDS = 15.0
"""Seconds in which a contradiction of estimate and barometer is looked for: a choice, three times what one takes."""


class HeightWatch:
    """Watches one boot of a vehicle for heights that are wrong."""

    def __init__(self, recent: RecentMessages, control: ControlWatch) -> None:
        """Begins without a rest.

        Args:
            recent: the slow messages of the boot, among them heights, pressures and positions.
            control: has the attitudes of the last seconds.
        """
        self._recent = recent
        self._control = control
        # The latest rest on the ground and that before the latest flight, s of the boot clock; None before any.
        self._latest_rest: TimeInterval | None = None
        self._rest_before_flight: TimeInterval | None = None
        # The latest divergence of the estimated height; None before any.
        self._divergence: Fact | None = None

    def divergence(
        self, now: float, vehicle: Telemetry, take_off: float, motion: RecentMotion | None
    ) -> Fact | None:
        """Returns how the estimated height has diverged in the last seconds; None if it has not.

        Args:
            now: present time on the boot clock, s.
            vehicle: identity and parameters of the vehicle, without messages.
            take_off: when the vehicle left the ground, s of the boot clock; minus infinity where that was not seen.
            motion: motor outputs of the last seconds; None if they do not come.
        """
        start = now - MEMORY_SECONDS
        # Comparing the two climbs takes a small part of the full judgement, which is needed only where they differ.
        columns = self._recent.columns((BAROMETER_MESSAGE, *CLIMB_RATE_FIELDS), start)
        comparison = height_comparison(
            Signals(replace(vehicle, messages=columns)), self._recent.boot
        )
        if not comparison.contradictions:
            return None
        signals = self._control.signals(vehicle, motion, (BAROMETER_MESSAGE, "VIBRATION"), start)
        sensors = BootSensors(signals, self._recent.boot, take_off)
        divergences = list(height_divergences(sensors, (max(take_off, start), now)))
        if not divergences:
            return None
        latest = divergences[-1]
        known = self._divergence
        if known is not None:
            # While a divergence leaves the memory, its later part looks like one of its own. Both climbs are compared
            # on a grid that begins with the memory, so that the same divergence may begin a step later too.
            earliest = known.start_time + 1.0 / GRID_RATE
            if earliest < latest.start_time < known.latest_time:
                latest = known.replace(end_time=latest.end_time)
        self._divergence = latest
        return latest

    def add_rest(self, vehicle: Telemetry, motion: RecentMotion | None) -> None:
        """Notes when the vehicle on the ground last rested.

        Args:
            vehicle: identity and parameters of the vehicle, without messages.
            motion: motor outputs of the last seconds; None if they do not come.
        """
        rests = rest_intervals(self._control.signals(vehicle, motion), self._recent.boot)
        if rests:
            self._latest_rest = rests[-1]

    def begin_flight(self) -> None:
        """Keeps the rest before a take-off, with which those after the landing are compared."""
        self._rest_before_flight = self._latest_rest

    def drift_at_landing(
        self, vehicle: Telemetry, flight_interval: TimeInterval, motion: RecentMotion | None
    ) -> Fact | None:
        """Returns that the barometer reads another height than before the flight that has ended; None if it does not.

        Args:
            vehicle: identity and parameters of the vehicle, without messages.
            flight_interval: take-off and landing, s of the boot clock.
            motion: motor outputs of the last seconds; None if they do not come.

        Returns:
            The event; None also before the vehicle has rested after the landing, or if it was not seen to rest before.
        """
        take_off, _ = flight_interval
        if self._rest_before_flight is None or not isfinite(take_off):
            return None
        names = (BAROMETER_MESSAGE, "GPS_RAW_INT")
        signals = self._control.signals(vehicle, motion, names)
        rests = rest_intervals(signals, self._recent.boot)
        sensors = BootSensors(signals, self._recent.boot, take_off)
        drifts = barometer_drifts(sensors, flight_interval, [self._rest_before_flight, *rests])
        return next(drifts, None)
