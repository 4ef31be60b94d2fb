"""Phase of flight of a live vehicle: on the ground, airborne, free of the ground, or settled (no take-off or landing).

The rules for logs are applied to the last seconds.

What those seconds alone do not show is carried on from review to review: when the flight began, and since when it is
settled. A flight also goes on over a silence of the link, after which it has no other take-off.

A landing is known only once it has happened; the last seconds before it are then withdrawn. While the autopilot does
not report whether it is in the air, a vehicle that descends may be landing: nothing is settled until it has not
descended for ``TRANSIENT_SECONDS``. Without a vertical speed only the motors show a landing, once it is over. A loss of
control, too, is known only a moment after its onset. As in a log, it ends the flight like a touch-down, so that the
last seconds before it are withdrawn as well.
"""

from dataclasses import replace
from math import inf, isfinite, nan

import numpy as np

from mavdem.dataset import flight_states, phases, time_series
from mavdem.dataset.flight_states import MAX_REPORT_INTERVAL
from mavdem.dataset.intervals import Intervals, TimeInterval, intersection
from mavdem.dataset.landed_reports import (
    LandedReport,
    LandedReportCheck,
    with_undefined_ground,
)
from mavdem.dataset.phases import MAX_LEVEL_FLIGHT_SPEED, TRANSIENT_SECONDS
from mavdem.dataset.signals import CLIMB_RATE_FIELDS, Signals
from mavdem.dataset.time_series import AVERAGING_SECONDS, TimeSeries, recorded_series
from mavdem.facts import Fact
from mavdem.facts.events import ReportedEvent
from mavdem.facts.session import SessionFact
from mavdem.ingest.motors import POSSIBLE_MULTIROTORS
from mavdem.ingest.telemetry import Telemetry
from mavdem.ingest.vocabulary import IN_AIR, UNDEFINED_LANDED_STATE
from mavdem.live.live_signals import LiveSignals
from mavdem.live.recent_messages import RecentMessages

LANDED_STATE_MESSAGE = "EXTENDED_SYS_STATE"
"""The message in which an autopilot reports whether the vehicle is on the ground, takes off, flies or lands."""

PHASE_MESSAGES = ("HEARTBEAT", LANDED_STATE_MESSAGE, *CLIMB_RATE_FIELDS)
"""The messages that show the phase, besides the motor outputs."""

AVERAGING_DELAY = AVERAGING_SECONDS / 2
"""Delay after which a centred mean is known, s: half of its window."""

FREE_CLIMB_DELAY = TRANSIENT_SECONDS / 2
"""Time from the first climbing speed until the vehicle counts as free, s: half a transient of the climb-out; a choice.

A model of samples from earlier in the climb comes sooner, but its errors are up to twice as large.
"""


class FlightPhase:
    """Decides twice a second whether a live vehicle is airborne, in free flight, and in settled flight.

    In free flight nothing holds the vehicle. Settled flight is free flight without the climb-out after the take-off and
    without the landing. All times are s of the boot clock.

    Attributes:
        is_flying: whether the vehicle is airborne and, where that is reported, armed.
        is_in_air: whether it also neither takes off nor lands, where that is reported.
        motors_are_idle: whether outputs come and none has moved so far.
        is_landed_state_reported: whether a report of the autopilot decides at present if the vehicle is on the ground;
            if none does, the motors decide.
        landing_time: when the vehicle came to the ground last; None before that, and in flight.
        is_armed_since_landing: whether the vehicle has landed and was not disarmed since. An arming after that, or
            after a restart of the autopilot, is for the next flight.
        contradicted_report: the fact that the autopilot reports the ground although the vehicle flies; None while it
            does not, or nothing shows that.
    """

    def __init__(self, slow_messages: RecentMessages) -> None:
        """Begins a boot with the vehicle on the ground.

        Args:
            slow_messages: messages of the boot.
        """
        self.is_flying = False
        self.is_in_air = False
        self.motors_are_idle = False
        self.is_landed_state_reported = False
        self.landing_time: float | None = None
        self.is_armed_since_landing = False
        self.contradicted_report: Fact | None = None
        self._slow_messages = slow_messages
        self._report_check = LandedReportCheck()
        # Whether any message shows whether the vehicle flies.
        self._is_flying_known = False
        # Times of the boot clock, s; minus infinity where they are not known: when the vehicle left the ground, when it
        # was in the air after its take-off, when it was reviewed last, and until when the latest report of the landed
        # state counts.
        self._airborne_start = -inf
        self._in_air_start = -inf
        self._review_time = -inf
        self._landed_state_end = -inf
        # The time since which the flight is settled, s; None while it is not.
        self._settled_start: float | None = None
        # The time since which the vehicle flies freely on its way up, s; infinite before it climbs.
        self._free_climb_start = inf
        # The time since which the vehicle is out of control, s; infinite while it is under control.
        self._loss_onset = inf
        # The time since which samples that counted as settled are withdrawn, s; None where none are.
        self._withdrawal_time: float | None = None

    @property
    def not_flying_reason(self) -> Fact | None:
        """Why the vehicle does not count as flying: it is on the ground, or nothing shows that; None if it flies.

        If the motors idle it is on the ground, whatever other messages are missing.
        """
        if self.is_flying:
            return None
        if self.motors_are_idle or self._is_flying_known:
            return Fact(SessionFact.NOT_FLYING)
        return Fact(SessionFact.FLIGHT_UNKNOWN)

    def is_settled(self, time: float) -> bool:
        """Returns whether the flight is settled at a time: after the climb-out, before a landing, under control.

        An extreme tilt ends settled flight too, but that is judged for each row (:class:`RowBuilder`), not here.

        Args:
            time: time on the boot clock, s.
        """
        if not self.is_in_air or self._settled_start is None:
            return False
        return self._settled_start <= time < self._loss_onset

    def is_free(self, time: float) -> bool:
        """Returns whether the flight is free at a time: settled, or on its way up, so that the ground does not hold it.

        Args:
            time: time on the boot clock, s.
        """
        is_climbing = self.is_flying and self._free_climb_start <= time < self._loss_onset
        return is_climbing or self.is_settled(time)

    @property
    def takeoff_time(self) -> float:
        """When the vehicle left the ground last, s of the boot clock; minus infinity where that was not seen."""
        return self._airborne_start

    @property
    def may_fly_freely(self) -> bool:
        """Whether the next samples may be of free flight: in the air, or in a take-off that nothing holds any more."""
        return self.is_in_air or (self.is_flying and self._free_climb_start < inf)

    def settled_start(self, now: float) -> float | None:
        """Returns the time since which the flight is settled, s; None if it is not settled ``now``, s."""
        return self._settled_start if self.is_settled(now) else None

    def pop_withdrawal_time(self) -> float | None:
        """Returns from which time on the latest samples must be withdrawn from learning, once for each withdrawal.

        They were taken for settled flight, but turned out to be of a landing or of a loss of control
        (:meth:`_withdraw_since`).

        Returns:
            Time of the first of these samples, s of the boot clock; None without a withdrawal since the last call.
        """
        withdrawal_time = self._withdrawal_time
        self._withdrawal_time = None
        return withdrawal_time

    def note_loss(self, onset: float | None) -> None:
        """Stores when the vehicle went out of control: from that time on its flight is neither settled nor free.

        A new loss in flight also withdraws the last ``TRANSIENT_SECONDS`` before it from settled flight, since its
        cause may have begun in them. Logs are judged by the same rule. It applies to a touch-down too.

        Args:
            onset: beginning of the loss of control, s of the boot clock; None while the vehicle is under control.
        """
        is_new_loss = onset is not None and self._loss_onset == inf
        self._loss_onset = inf if onset is None else onset
        if is_new_loss and self.is_flying:
            self._withdraw_since(self._loss_onset - TRANSIENT_SECONDS)

    def _landed_state(
        self, now: float, telemetry: Telemetry, collective: TimeSeries | None
    ) -> TimeSeries | None:
        """Returns the landed states that the autopilot has reported in the last seconds; None if it reports none.

        It also stores until when the latest report holds, and whether it holds now.

        Args:
            now: time of the review, s.
            telemetry: messages of the last seconds.
            collective: mean of the motors in the last seconds, by which reports are checked; None if it is unknown.
        """
        reports = recorded_series(telemetry, LANDED_STATE_MESSAGE, "landed_state")
        if reports is not None and collective is not None:
            reports = self._checked_reports(reports, telemetry, collective)
        self._landed_state_end = _end_of_validity(reports, now)
        # Without motor outputs, even an old report holds.
        is_valid = self._landed_state_end >= now or collective is None
        self.is_landed_state_reported = reports is not None and is_valid
        return _repeated_until(now, reports)

    def review(self, now: float, vehicle: Telemetry, collective: TimeSeries | None) -> None:
        """Decides the phase of flight by the messages and motor outputs of the last seconds, twice a second.

        Args:
            now: time of the review, s.
            vehicle: identity and parameters of the vehicle, without messages.
            collective: mean of the motors in the last seconds, as a fraction of their range; None if it is unknown.
        """
        boot = self._slow_messages.boot
        telemetry = self._recent_telemetry(now, vehicle)
        landed_state = self._landed_state(now, telemetry, collective)
        signals = LiveSignals(telemetry, collective=collective, landed_state=landed_state)
        # If no message says whether the vehicle is armed, it counts as armed all the time.
        armed = flight_states.armed_intervals(signals, boot)
        is_armed = _interval_at(now, armed) is not None
        is_arming_reported = armed != [(-inf, inf)]
        has_outputs_or_reports = landed_state is not None or collective is not None
        self._is_flying_known = has_outputs_or_reports or is_arming_reported
        is_phase_shown = has_outputs_or_reports
        if vehicle.vehicle not in POSSIBLE_MULTIROTORS:
            # The motors of other vehicles do not show whether they fly: a plane may glide. Their arming does.
            is_phase_shown = is_arming_reported
        if is_armed and not is_phase_shown:
            # After a silence of the link, the messages that show the phase have not come yet. A missing message is
            # neither a landing nor a take-off, so that the phase stays what it was. A vehicle that is not armed does
            # not fly, whatever else is missing.
            self._review_time = now
            return
        self._update_airborne(now, flight_states.airborne_intervals(signals, boot))
        if self.is_flying or not is_armed:
            self.is_armed_since_landing = False

        climb_rate = signals.climb_rate
        if climb_rate is not None:
            climb_rate = time_series.averaged_series(climb_rate)
        # Take-off and landing are states of their own, so that these intervals are without them.
        in_air = flight_states.landed_state_intervals(signals, boot, (IN_AIR,))
        armed_in_air = intersection(armed, in_air)
        self._update_flight(now, armed_in_air, climb_rate)
        self._review_time = now

    def _checked_reports(
        self, reports: TimeSeries, telemetry: Telemetry, collective: TimeSeries
    ) -> TimeSeries:
        """Checks the reports of the landed state since the last review by height and motors, as those of a log are.

        Args:
            reports: MAV_LANDED_STATE (N,) of the last seconds.
            telemetry: messages of the last seconds, with the height, and the vehicle's parameters.
            collective: mean of the motors in the last seconds, as a fraction of their range.

        Returns:
            The reports, with "undefined" in the place of those that are wrong.
        """
        self._check_new_reports(reports, telemetry, collective)
        # When the autopilot began to report the ground, and how far the vehicle rose nevertheless, m.
        first_wrong_time = self._report_check.first_time
        rise = self._report_check.contradicted_rise
        if first_wrong_time is None or rise is None:
            self.contradicted_report = None
            return reports
        latest_time = float(reports.time[-1])
        self.contradicted_report = Fact(
            ReportedEvent.GROUND_REPORTED_IN_FLIGHT,
            time=first_wrong_time,
            end_time=None,
            largest_height=rise,
            basis=(LANDED_STATE_MESSAGE,),
        )
        return with_undefined_ground(reports, (first_wrong_time, latest_time))

    def _check_new_reports(
        self, reports: TimeSeries, telemetry: Telemetry, collective: TimeSeries
    ) -> None:
        """Adds the reports of the landed state since the last review to their check, with thrust and height then.

        Args:
            reports: MAV_LANDED_STATE (N,) of the last seconds.
            telemetry: messages of the last seconds, with the height, and the vehicle's parameters.
            collective: mean of the motors in the last seconds, as a fraction of their range.
        """
        height = Signals(telemetry).height
        min_collective = flight_states.min_airborne_collective(telemetry.parameters)
        mean_collective = time_series.averaged_series(collective)
        is_new = reports.time > self._review_time
        for time, state in zip(
            reports.time[is_new].tolist(), reports.values[is_new].tolist(), strict=True
        ):
            has_thrust = mean_collective.value_at(time) > min_collective
            height_then = nan if height is None else height.value_at(time)
            self._report_check.add(LandedReport(time, int(state), has_thrust, height_then))

    def _update_airborne(self, now: float, airborne: Intervals) -> None:
        """Updates whether the vehicle is airborne, when it took off, and after a flight when it landed.

        Args:
            now: time of the review, s of the boot clock.
            airborne: intervals of the last seconds from the begin of a take-off to the end of a landing, s.
        """
        present_flight = _interval_at(now, airborne)
        is_new_flight = not self.is_flying
        # The first review of a flight finds its beginning. It finds minus infinity if the flight began before the first
        # message, or if the motors were not known yet; in the latter case a later review finds the beginning.
        is_takeoff_unseen = self._airborne_start == -inf
        if present_flight is not None and (is_new_flight or is_takeoff_unseen):
            takeoff_time, _ = present_flight
            self._airborne_start = takeoff_time
        if present_flight is not None:
            self.landing_time = None
        elif self.is_flying:
            self.landing_time = _latest_end(airborne, now)
            # The caller corrects this if the landing was a disarming.
            self.is_armed_since_landing = True
        self.is_flying = present_flight is not None

    def _update_flight(self, now: float, flights: Intervals, climb_rate: TimeSeries | None) -> None:
        """Updates whether the vehicle is in the air and since when, and since when its flight is settled.

        The time of a take-off follows from the mean output of the motors around it. The later half of that averaging
        window must have passed before the time is certain. Until then each review corrects it.

        Args:
            now: time of the review, s of the boot clock.
            flights: intervals of the last seconds in which the vehicle was armed and reported in the air, s.
            climb_rate: averaged upward speed of the last seconds, m/s; None if none comes.
        """
        present_flight = _interval_at(now, flights)
        takeoff_time = nan
        if present_flight is not None:
            takeoff_time, _ = present_flight
        # The vehicle may have landed and taken off again since the last review.
        has_taken_off_again = takeoff_time > self._review_time
        if self.is_in_air and (present_flight is None or has_taken_off_again):
            self._end_flight(_latest_end(flights, now))
        if present_flight is not None:
            # The take-off is among the reviewed seconds only for a while. After that, the interval begins with them.
            has_just_taken_off = now < self._in_air_start + AVERAGING_SECONDS
            is_correction = isfinite(takeoff_time) and has_just_taken_off
            if not self.is_in_air or is_correction:
                self._in_air_start = takeoff_time
            self.is_in_air = True
            self._update_settled_start(now, climb_rate)
        self._update_free_climb_start(now, climb_rate)

    def _end_flight(self, touchdown_time: float) -> None:
        """Ends the flight at a touch-down, s of the boot clock, and withdraws its last seconds."""
        # The last seconds before a touch-down are of the landing, and not settled flight.
        self._withdraw_since(touchdown_time - TRANSIENT_SECONDS)
        self.is_in_air = False
        self._settled_start = None
        self._free_climb_start = inf

    def _recent_telemetry(self, now: float, vehicle: Telemetry) -> Telemetry:
        """Collects the last seconds of the messages that show the phase of flight, in the form that a log has.

        Args:
            now: present time on the boot clock, s.
            vehicle: identity and parameters of the vehicle, without messages.

        Returns:
            The vehicle with these messages alone.
        """
        # Within two of the longest intervals there is at least one report of each message that still comes.
        columns = self._slow_messages.columns(PHASE_MESSAGES, now - 2 * MAX_REPORT_INTERVAL)
        return replace(vehicle, messages=columns)

    def _update_settled_start(self, now: float, climb_rate: TimeSeries | None) -> None:
        """Updates the time since which the flight is settled: neither in the climb-out nor possibly in a landing.

        A flight becomes settled at the end of its climb-out. After that, a descent may be the beginning of a landing,
        so the flight counts as settled again only ``TRANSIENT_SECONDS`` after the vehicle last sank. As long as it
        sinks, this time lies in the future, and ``is_settled`` is false. Where the autopilot reports whether it has
        landed, descents are ignored until the end of these reports, which show a landing by themselves.

        Args:
            now: present time, s.
            climb_rate: averaged upward speed of the last seconds, m/s; None if none comes.
        """
        if self._settled_start is None:
            self._start_settled_flight_after_climb_out(now, climb_rate)
        elif climb_rate is not None:
            # A climb rate is the mean of a window around its time, so it is known ``AVERAGING_DELAY``, half the window,
            # later. Those that were known at the last review have been judged then.
            judged_end = self._review_time - AVERAGING_DELAY
            known_end = now - AVERAGING_DELAY
            unjudged_start = max(judged_end, self._landed_state_end)
            unjudged_rates = _between(climb_rate, unjudged_start, known_end)
            is_sinking = unjudged_rates.values <= -MAX_LEVEL_FLIGHT_SPEED
            sinking_times = unjudged_rates.time[is_sinking]
            if len(sinking_times):
                end_of_possible_landing = float(sinking_times[-1]) + TRANSIENT_SECONDS
                self._settled_start = max(self._settled_start, end_of_possible_landing)

    def _start_settled_flight_after_climb_out(
        self, now: float, climb_rate: TimeSeries | None
    ) -> None:
        """Sets the start of the settled flight to the end of the climb-out, once the vehicle has ended it.

        Args:
            now: present time, s of the boot clock.
            climb_rate: averaged upward speed of the last seconds, m/s; None if the vehicle does not send it.
        """
        # The climb rate is a centred average, which is known only until half of its window ago.
        known_end = now
        if climb_rate is not None:
            known_end = now - AVERAGING_DELAY
        # The end of this flight is not known yet: it counts as infinite.
        present_flight = (self._in_air_start, inf)
        settled_flight = phases.without_transients(present_flight, climb_rate)
        if settled_flight is None:
            return
        end_of_climb_out, _ = settled_flight
        if end_of_climb_out <= known_end:
            self._settled_start = end_of_climb_out

    def _update_free_climb_start(self, now: float, climb_rate: TimeSeries | None) -> None:
        """Updates the time from which on a vehicle in its climb-out is in free flight; infinite if it is not yet.

        A vehicle that climbs cannot be held by the ground. So it is free ``FREE_CLIMB_DELAY`` after it first climbed,
        and learning begins some seconds before settled flight does. A descent resets the time.

        Args:
            now: present time, s of the boot clock.
            climb_rate: averaged upward speed of the last seconds, m/s; without it nothing shows a free climb.
        """
        if not self.is_flying or climb_rate is None:
            self._free_climb_start = inf
            return
        # The climb rate is a centred average, which is known until half of its window ago (``AVERAGING_DELAY``). Only
        # values that have become known since the last review are judged, and after a long break only the latest.
        unjudged_start = max(self._review_time, now - MAX_REPORT_INTERVAL) - AVERAGING_DELAY
        unjudged_rates = _between(climb_rate, unjudged_start, now - AVERAGING_DELAY)
        is_climbing = unjudged_rates.values >= MAX_LEVEL_FLIGHT_SPEED
        climbing_times = unjudged_rates.time[is_climbing]
        has_descended = np.any(unjudged_rates.values <= -MAX_LEVEL_FLIGHT_SPEED)
        # The climb-out ends where settled flight begins.
        is_climbing_out = self._settled_start is None
        if has_descended:
            self._free_climb_start = inf
        elif len(climbing_times) and is_climbing_out:
            free_time = float(climbing_times[0]) + FREE_CLIMB_DELAY
            self._free_climb_start = min(self._free_climb_start, free_time)

    def _withdraw_since(self, start_time: float) -> None:
        """Notes that samples which counted as settled flight were of a landing or a loss of control.

        The caller gets the time by ``pop_withdrawal_time``, and withdraws what a model has learned since then. If it
        did not do so after an earlier landing or loss, the earlier time is kept, so that both are withdrawn.

        Args:
            start_time: time of the first such sample, s of the boot clock.
        """
        pending_time = self._withdrawal_time
        if pending_time is None:
            self._withdrawal_time = start_time
        else:
            self._withdrawal_time = min(start_time, pending_time)


def _interval_at(time: float, intervals: Intervals) -> TimeInterval | None:
    """Returns the first interval that contains ``time``, s, as its end but not as its start; None without one."""
    for start, end in intervals:
        if start < time <= end:
            return start, end
    return None


def _latest_end(intervals: Intervals, now: float) -> float:
    """Returns when the latest of the intervals that are over ended, s; ``now``, the time of a review, if none is over.

    If the interval in which a flight ended is not among them, the review that finds the end is the best known time.
    """
    return max([end for _, end in intervals if end < now], default=now)


def _between(series: TimeSeries, start_time: float, end_time: float) -> TimeSeries:
    """Returns the samples of a series after ``start_time`` and until ``end_time``, s."""
    return series.select((series.time > start_time) & (series.time <= end_time))


def _is_recent(landed_state: TimeSeries, now: float) -> bool:
    """Returns whether the latest report of the landed state is no older than ``MAX_REPORT_INTERVAL`` at ``now``, s."""
    return bool(now <= landed_state.time[-1] + MAX_REPORT_INTERVAL)


def _end_of_validity(landed_state: TimeSeries | None, now: float) -> float:
    """Returns the time until which the latest report of the landed state counts, s of the boot clock.

    Args:
        landed_state: the reports of the last seconds; None if none came.
        now: present time on the boot clock, s.

    Returns:
        ``MAX_REPORT_INTERVAL`` after the report; minus infinity if that has passed, or the report says "undefined".
    """
    if landed_state is None or not _is_recent(landed_state, now):
        return -inf
    if landed_state.values[-1] == UNDEFINED_LANDED_STATE:
        return -inf
    return float(landed_state.time[-1]) + MAX_REPORT_INTERVAL


def _repeated_until(now: float, landed_state: TimeSeries | None) -> TimeSeries | None:
    """Returns the landed state with its latest report repeated at the present time.

    The rules for logs know a state only between two reports. In a log the next report follows; in a live stream it has
    not come yet, and without the repetition the present state would be unknown.

    Args:
        now: present time on the boot clock, s.
        landed_state: the reports of the last seconds; None if none came.

    Returns:
        The reports as they are if the latest one is older than ``MAX_REPORT_INTERVAL``.
    """
    if landed_state is None or not _is_recent(landed_state, now):
        return landed_state
    latest_boot = landed_state.boot[-1]
    latest_value = landed_state.values[-1]
    return TimeSeries(
        np.append(landed_state.time, now),
        np.append(landed_state.boot, latest_boot),
        np.append(landed_state.values, latest_value),
    )
