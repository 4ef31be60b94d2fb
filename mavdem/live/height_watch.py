"""Wrong heights of a live vehicle, judged by the rules for logs: an estimate that diverges, a barometer that drifts.

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
from mavdem.live.live_signals import FlightMoment, RecentMotion
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

    def divergence(self, moment: FlightMoment) -> Fact | None:
        """Returns the latest event in which the estimated height diverged from the barometer's in the last seconds.

        Args:
            moment: present time in flight.

        Returns:
            The event; None if there was none in the last ``MEMORY_SECONDS``.
        """
        start = moment.time - MEMORY_SECONDS
        # Comparing the two climb rates takes a small part of the time of the full judgement, which is needed only where
        # they contradict each other.
        columns = self._recent.columns((BAROMETER_MESSAGE, *CLIMB_RATE_FIELDS), start)
        comparison = height_comparison(
            Signals(replace(moment.vehicle, messages=columns)), self._recent.boot
        )
        if not comparison.contradictions:
            return None
        signals = self._control.signals(
            moment.vehicle, moment.motion, (BAROMETER_MESSAGE, "VIBRATION"), start
        )
        sensors = BootSensors(signals, self._recent.boot, moment.takeoff_time)
        flight_interval = (max(moment.takeoff_time, start), moment.time)
        divergences = list(height_divergences(sensors, flight_interval))
        if not divergences:
            return None
        self._divergence = self._with_known_start(divergences[-1])
        return self._divergence

    def _with_known_start(self, divergence: Fact) -> Fact:
        """Gives a divergence the start at which it was found first, if it is still the same one.

        Its first seconds are forgotten after ``MEMORY_SECONDS``, so that it seems to begin later and later.

        Args:
            divergence: the divergence, as the messages that are still kept show it.

        Returns:
            The divergence that was found before, with the new end, if this one begins within it; otherwise this one.
        """
        known = self._divergence
        if known is None:
            return divergence
        # The climb rates are compared on a time grid that begins with the kept messages. So a start up to a step later
        # is the same start.
        latest_same_start = known.start_time + 1.0 / GRID_RATE
        if latest_same_start < divergence.start_time < known.latest_time:
            return known.replace(end_time=divergence.end_time)
        return divergence

    def add_rest(self, vehicle: Telemetry, motion: RecentMotion | None) -> None:
        """Notes when the vehicle on the ground last rested, since heights are compared at rest only.

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
        """Judges whether the barometer has drifted in a flight, by its heights at rest before and after it.

        Args:
            vehicle: identity and parameters of the vehicle, without messages.
            flight_interval: take-off and landing, s of the boot clock.
            motion: motor outputs of the last seconds; None if they do not come.

        Returns:
            The event that it has drifted. None if it has not, before the vehicle has rested after the landing, or if
            it was not seen to rest before the take-off.
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
