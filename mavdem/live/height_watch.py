"""Wrong heights of a live vehicle: a height estimate that diverges from its barometer, or a barometer that drifts.

They are judged by the rules for logs.

The estimator follows its barometer, so that a barometer that drifts shows by the altitude of satellites in flight, and
for certain after the landing, at rest.
"""

from dataclasses import replace
from math import isfinite

from mavdem.assessment.barometer_drifts import (
    barometer_drifts,
    drift_with_onset_time,
    is_barometer_steady,
)
from mavdem.assessment.height_disagreements import (
    SECONDS_BEFORE_TAKE_OFF,
    disagreement,
    height_difference,
    initial_difference,
)
from mavdem.assessment.height_divergence import height_divergences
from mavdem.dataset.intervals import TimeInterval
from mavdem.dataset.position_fix import RECEIVER_MESSAGES
from mavdem.dataset.signals import CLIMB_RATE_FIELDS, Signals
from mavdem.dataset.time_series import TimeSeries
from mavdem.facts import Fact, Level
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

RECEIVER_MESSAGE = RECEIVER_MESSAGES[0]
"""The message of the satellite receiver that is received live."""

MEMORY_SECONDS = 15.0
"""Seconds in which a contradiction of estimate and barometer is looked for: a choice, three times what one takes."""


class HeightWatch:
    """Watches the heights of a vehicle since its autopilot started: estimated, by barometer, and by satellites."""

    def __init__(self, slow_messages: RecentMessages, control: ControlWatch) -> None:
        """Begins the watch of heights in a boot, before the vehicle was found at rest.

        Args:
            slow_messages: the slow messages of the boot, among them heights, pressures and positions.
            control: has the attitudes of the last seconds.
        """
        self._slow_messages = slow_messages
        self._control = control
        # The latest rest on the ground and that before the latest flight, s of the boot clock; None before any.
        self._latest_rest: TimeInterval | None = None
        self._rest_before_flight: TimeInterval | None = None
        # The latest divergence of the estimated height; None before any.
        self._latest_divergence: Fact | None = None
        # How much higher the barometer read than satellites at the take-off, m; None before that is known.
        self._takeoff_difference: float | None = None
        # The latest disagreement of these two in the present flight; None before any.
        self._latest_disagreement: Fact | None = None

    def divergence(self, moment: FlightMoment) -> Fact | None:
        """Returns the event that the autopilot's height estimate diverges from its barometer, if it does.

        The estimate diverges if its climb rate contradicts the climb rate by the barometer for some seconds.

        Args:
            moment: present time, with the vehicle's parameters, time of take-off, and motion of the last seconds.

        Returns:
            The latest such event of the last ``MEMORY_SECONDS``, with its times; None if there was none.
        """
        start_time = moment.time - MEMORY_SECONDS
        # This comparison of the climb rates is quick. The full judgement below takes much longer, and is needed only if
        # they contradict each other.
        columns = self._slow_messages.columns((BAROMETER_MESSAGE, *CLIMB_RATE_FIELDS), start_time)
        height_signals = Signals(replace(moment.vehicle, messages=columns))
        comparison = height_comparison(height_signals, self._slow_messages.boot)
        if not comparison.contradictions:
            return None
        # The accelerometer is left out: its offset is known only from a rest on the ground, and the seconds that are
        # kept contain none.
        signals = self._control.recent_signals(
            moment.vehicle,
            moment.motion,
            (BAROMETER_MESSAGE, "VIBRATION"),
            start_time,
            uses_accelerometer=False,
        )
        sensors = BootSensors(signals, self._slow_messages.boot, moment.takeoff_time)
        flight_interval = (max(moment.takeoff_time, start_time), moment.time)
        divergences = list(height_divergences(sensors, flight_interval))
        if not divergences:
            return None
        # If it goes on since an earlier review, it keeps its start, of which the messages may have been forgotten.
        self._latest_divergence = _with_known_start(divergences[-1], self._latest_divergence)
        return self._latest_divergence

    def disagreement(self, moment: FlightMoment) -> Fact | None:
        """Returns the event that barometer and satellite receiver disagree about the height, if they do.

        They disagree if the difference of their heights has changed since the take-off by more than their errors. That
        is judged by the last seconds, which is quick. An event that is new is judged again by the whole flight, since a
        slow drift began long before the last seconds.

        Args:
            moment: present time, with the vehicle's parameters, time of take-off, and motion of the last seconds.

        Returns:
            The event, with the largest difference, m; it has no end time while they disagree. None if they agreed in
            the last ``MEMORY_SECONDS``.
        """
        flight_interval = (moment.takeoff_time, moment.time)
        search_start = moment.time - MEMORY_SECONDS
        if self._takeoff_difference is None:
            # The last seconds may not contain the take-off, whose difference is needed first.
            search_start = moment.takeoff_time - SECONDS_BEFORE_TAKE_OFF
        difference = self._height_difference_since(search_start, moment.vehicle)
        if difference is None:
            return None
        if self._takeoff_difference is None:
            self._takeoff_difference = initial_difference(difference, moment.takeoff_time)
        if self._takeoff_difference is None:
            return None
        former_event = self._latest_disagreement
        is_ongoing = former_event is not None and former_event.end_time is None
        recent_event = disagreement(
            difference, self._takeoff_difference, flight_interval, has_begun_before=is_ongoing
        )
        if recent_event is None:
            return None
        event = _with_known_start(recent_event, former_event)
        is_new = event is recent_event
        if is_new:
            # A slow drift began long before the last seconds.
            event = self._disagreement_in_whole_flight(moment, self._takeoff_difference) or event
        self._latest_disagreement = _with_larger_difference(event, recent_event)
        return self._latest_disagreement

    def _disagreement_in_whole_flight(
        self, moment: FlightMoment, takeoff_difference: float
    ) -> Fact | None:
        """Returns the event that barometer and satellite receiver disagree, by all their heights since the take-off.

        Args:
            moment: present time, with the vehicle's parameters and the time of the take-off.
            takeoff_difference: how much higher the barometer read at the take-off, m.

        Returns:
            The event; None if the heights since the take-off show none, or are not kept.
        """
        flight_start = moment.takeoff_time - SECONDS_BEFORE_TAKE_OFF
        difference = self._height_difference_since(flight_start, moment.vehicle)
        if difference is None:
            return None
        return disagreement(difference, takeoff_difference, (moment.takeoff_time, moment.time))

    def _height_difference_since(self, start_time: float, vehicle: Telemetry) -> TimeSeries | None:
        """Returns how much higher the barometer reads than the satellites, since a given time.

        Args:
            start_time: time of the first message that is used, s of the boot clock.
            vehicle: identity and parameters of the vehicle, without messages.

        Returns:
            The difference (N,), m, up to a constant; None if one of the two does not come.
        """
        columns = self._slow_messages.columns((BAROMETER_MESSAGE, RECEIVER_MESSAGE), start_time)
        return height_difference(
            Signals(replace(vehicle, messages=columns)), self._slow_messages.boot
        )

    def update_latest_rest(self, vehicle: Telemetry, motion: RecentMotion | None) -> None:
        """Stores when the vehicle on the ground last rested, since heights are compared at rest only.

        Args:
            vehicle: identity and parameters of the vehicle, without messages.
            motion: motor outputs of the last seconds; None if they do not come.
        """
        rests = rest_intervals(
            self._control.recent_signals(vehicle, motion), self._slow_messages.boot
        )
        if rests:
            self._latest_rest = rests[-1]

    def begin_flight(self) -> None:
        """Stores when the vehicle rested before the take-off, and forgets the heights of earlier flights.

        After the landing, the heights at rest before and after the flight are compared.
        """
        self._rest_before_flight = self._latest_rest
        self._takeoff_difference = None
        self._latest_disagreement = None

    def end_flight(self, now: float) -> Fact | None:
        """Ends a disagreement of barometer and satellites that lasts until the landing.

        Args:
            now: present time on the boot clock, s.

        Returns:
            The latest disagreement in this flight, which may have ended before; None without any.
        """
        event = self._latest_disagreement
        if event is not None and event.end_time is None:
            self._latest_disagreement = event.replace(end_time=now)
        return self._latest_disagreement

    def drift_between_rests(
        self, vehicle: Telemetry, flight_interval: TimeInterval, motion: RecentMotion | None
    ) -> Fact | None:
        """Judges whether barometer or satellites drifted in a flight, by the heights at rest before and after it.

        Args:
            vehicle: identity and parameters of the vehicle, without messages.
            flight_interval: take-off and landing, s of the boot clock.
            motion: motor outputs of the last seconds; None if they do not come.

        Returns:
            The event that the barometer has drifted; or, if both disagreed in flight, that the altitude by satellites
            wandered. None if neither has, before the vehicle has rested after the landing, or if it was not seen to
            rest before the take-off.
        """
        takeoff_time, _ = flight_interval
        if self._rest_before_flight is None or not isfinite(takeoff_time):
            return None
        height_messages = (BAROMETER_MESSAGE, RECEIVER_MESSAGE)
        signals = self._control.recent_signals(vehicle, motion, height_messages)
        rests = [self._rest_before_flight]
        rests += rest_intervals(signals, self._slow_messages.boot)
        sensors = BootSensors(signals, self._slow_messages.boot, takeoff_time)
        barometer_drift = next(barometer_drifts(sensors, flight_interval, rests), None)
        disagreement_in_flight = self._latest_disagreement
        if barometer_drift is not None:
            return drift_with_onset_time(barometer_drift, disagreement_in_flight)
        if disagreement_in_flight is None:
            return None
        if not is_barometer_steady(sensors, flight_interval, rests):
            return None
        # The barometer was right, so the altitude by satellites wandered, which is no fault of the vehicle.
        return disagreement_in_flight.replace(Level.GOOD)


def _with_larger_difference(event: Fact, recent_event: Fact) -> Fact:
    """Returns the event that two heights disagree, with the larger difference of two searches, m; it may be negative.

    Args:
        event: the event by the whole flight, or by an earlier search.
        recent_event: the same event by the last seconds.
    """
    largest_difference = event.figures["height"]
    recent_difference = recent_event.figures["height"]
    if abs(recent_difference) > abs(largest_difference):
        largest_difference = recent_difference
    return event.replace(height=largest_difference)


def _with_known_start(event: Fact, earlier_event: Fact | None) -> Fact:
    """Gives an event the start at which it was found first, if it is still the same one.

    The first seconds of a long event are no longer among the messages that are kept, so that it seems to begin later
    with each review.

    Args:
        event: the event, as the messages that are still kept show it.
        earlier_event: the event of this kind that was found before; None before any.

    Returns:
        The earlier event with the new end, if ``event`` begins within it; otherwise ``event``.
    """
    if earlier_event is None:
        return event
    # The climb rates are compared on a time grid that begins with the kept messages. So a start up to a step later is
    # the same start.
    grid_step = 1.0 / GRID_RATE
    latest_same_start = earlier_event.start_time + grid_step
    begins_within_earlier_event = latest_same_start < event.start_time < earlier_event.latest_time
    if begins_within_earlier_event:
        return earlier_event.replace(end_time=event.end_time)
    return event
