"""The status of a live session at one moment: link, alarms, model, wind, and the judgement of the flight.

All of it is stated by facts: findings with a code, a level (good, watch, bad, unknown) and figures. A judgement has a
headline, the fact that matters most; a next step, what the pilot should do; and lights, each the fact that judges one
part of the vehicle, such as its motors.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from math import hypot, nan
from typing import NamedTuple

import numpy as np

from mavdem.assessment.axis.findings import Findings
from mavdem.assessment.event_lights import lights_with_event
from mavdem.assessment.flight_verdict import FlightVerdict, worst_first
from mavdem.assessment.headline import headline_by_lights
from mavdem.assessment.judgement import Judgement, unjudged
from mavdem.assessment.lights import VEHICLE_LIGHTS
from mavdem.assessment.limits import LEVELS_BY_SEVERITY, worst_fact
from mavdem.assessment.next_step import choose_next_step
from mavdem.assessment.severity import FALLS
from mavdem.containers import Numbers
from mavdem.dataset.phases import TRANSIENT_SECONDS
from mavdem.dem import Estimate
from mavdem.facts import Code, Fact, Facts, Level, NamedFacts
from mavdem.facts.assessment import Headline as HeadlineCode
from mavdem.facts.assessment import NextStep
from mavdem.facts.ending import Ending, MotionEvent
from mavdem.facts.events import ReportedEvent
from mavdem.facts.lights import Light, Unjudged
from mavdem.facts.loops import LoopFact
from mavdem.facts.margins import MarginsLight, TrackingLight
from mavdem.facts.motors import MotorWatchFact
from mavdem.facts.power import PowerLight
from mavdem.facts.session import (
    LinkFact,
    MissingMessages,
    RecordingState,
    RowsFact,
    SessionFact,
    VehicleFact,
)
from mavdem.facts.vibration import VibrationLight
from mavdem.facts.watch import WatchedQuantity, WatchFact
from mavdem.immutable import ImmutableResult
from mavdem.live.alarm_delay import MAX_ALARM_DELAY
from mavdem.live.global_position import GlobalPosition
from mavdem.live.history import REPORTED_HORIZON
from mavdem.live.link import SILENCE_SECONDS
from mavdem.live.link_loss import LONG_LOSS_SECONDS, lights_during_silence, link_loss_fact
from mavdem.live.live_lights import (
    QUANTITIES_OF_SETTLED_FLIGHT,
    fastest_rates,
    lights_before_model,
)
from mavdem.live.takeoff_place import Displacement
from mavdem.live.unseen_end import judgement_with_unseen_end
from mavdem.live.vehicle_state import VehicleState
from mavdem.live.wind import WindEstimate
from mavdem.loops.identification import MIN_IDENTIFIED_SECONDS
from mavdem.motors.motor_changes import MotorChange, thrust_losses, torque_changes

STATUS_PERIOD = 1.0
"""Time between two reports of a status, s: a choice."""

HEADLINES_WITHOUT_ALARM = (HeadlineCode.NOTHING_WRONG, WatchFact.NO_ALARM)
"""Headlines that state that nothing is wrong."""

VERDICTS_ON_FLIGHT = (HeadlineCode.NOTHING_WRONG, SessionFact.RECORDING_JUDGED)
"""Headlines of a flight that is over that may state that nothing is wrong."""

NOT_RECEIVED_CODES = (
    LinkFact.CONNECTION_LOST,
    RowsFact.NOTHING_RECEIVED,
    VehicleFact.LISTENING,
    VehicleFact.NO_VEHICLE_YET,
    VehicleFact.CHOOSE_VEHICLE,
    VehicleFact.NO_MULTIROTOR_YET,
    VehicleFact.TWO_VEHICLES_LIVE,
)
"""Reasons for learning no model with which no vehicle is received: the link is lost or silent, or none is followed."""

SILENT_LINK = (LinkFact.CONNECTION_LOST, RowsFact.NOTHING_RECEIVED)
"""Reasons for learning no model with which the followed vehicle sends nothing."""

EMPTYING_BATTERY = (ReportedEvent.BATTERY_WARNED, PowerLight.BATTERY_LOW, PowerLight.CHARGE_LOW)
"""Lights of the power that advise a landing in flight, even if they are to be watched only."""

TOO_FEW_MESSAGES = (RowsFact.LIVE_RATES_TOO_LOW, RowsFact.NO_LIVE_ATTITUDE)
"""Reasons for learning no model that another option of mavdem removes: that needs a new start, after the landing."""

PERMANENT_FAULTS = (MarginsLight.LOOP_MARGINS,)
"""Bad findings that do not arise in flight: the vehicle has had them since its take-off, and need not land now."""

REQUESTED_MESSAGES: Mapping[Code, str] = {
    VibrationLight.VIBRATION_UNKNOWN: "VIBRATION",
    TrackingLight.TRACKING_UNKNOWN: "ATTITUDE_TARGET",
}
"""The message that an unknown light advises to request, by the code of the light."""

STATES_OF_LEARNING = (
    SessionFact.NOT_SETTLED,
    SessionFact.BEING_LEARNED,
    SessionFact.FLIGHT_OVER,
    SessionFact.NOT_FLYING,
)
"""Reasons for learning no model that say what the session does, and nothing about the vehicle."""

STEPS_TO_THE_GROUND = (
    NextStep.LAND_NOW,
    NextStep.LAND_SOON,
    NextStep.LET_LAND,
    NextStep.FLY_BY_SIGHT,
)
"""Next steps in flight that end it, or let the pilot watch the vehicle itself: none of them lets it fly on."""

AUTOMATIC_DISARM_SECONDS = 10.0
"""Time after a landing in which an autopilot disarms its vehicle, s: the default of ArduPilot's DISARM_DELAY. That of
PX4's COM_DISARM_LAND is 2 s."""

LOG_KEEPING_STEPS = (NextStep.KEEP_LOG, NextStep.KEEP_MODEL)
"""Next steps after a flight without fault that need a log of it."""


class Latency(NamedTuple):
    """Seconds from the arrival of a packet on this computer to the estimate that it completes; NaN before any."""

    median: float = nan
    """Median over the latest rows, s."""

    p99: float = nan
    """99th percentile over the latest rows, s."""

    longest: float = nan
    """Longest of the session, s."""


class PredictionBand(NamedTuple):
    """The 90 % band of the predicted angle at the horizon that is reported; NaN before any prediction."""

    seconds: float = nan
    """The horizon, s ahead of the latest sample: about ``REPORTED_HORIZON``."""

    half_width: float = nan
    """Half width of the band, rad."""


class UsefulHorizon(NamedTuple):
    """The longest horizon at which predictions are useful; NaN where none is (``Estimate.longest_useful_horizon``)."""

    seconds: float = nan
    """The horizon, s."""

    error_ratio: float = nan
    """Squared error there, over the smaller one of two baselines: the last sample held, and the mean so far."""


class NamedPlace(NamedTuple):
    """Where a vehicle is from a place with a name."""

    name: str
    """The place: "the take-off" or "home"."""

    distance: float | None
    """Horizontal distance from it, m; None if only the height is known."""

    height: float
    """Height above it, m."""


@dataclass(frozen=True)
class SessionStatus(ImmutableResult):
    """The status of a live session at one moment.

    ``LiveStream.status`` fills in what concerns the link and the vehicle, ``StatusReport.status`` adds the model, and
    ``LiveSession.status`` the ``shortfall`` and the ``verdicts``.
    """

    vehicle: str | None = None
    """The followed vehicle, "system:component"; None before one is chosen."""

    no_model_reason: Fact | None = None
    """Why there are no rows or no new model; None while all is well."""

    rates: Mapping[str, float] = field(default_factory=dict)
    """Rates of attitude and motor messages over the last 2 s, Hz, by message name."""

    is_flying: bool = False
    """Whether the vehicle is armed and airborne."""

    flight_number: int = 0
    """Number of the latest flight in the session, from 1, which all judgements are about; 0 before the first."""

    boot_clock: float = nan
    """Latest time of the vehicle's boot clock, s; NaN before any."""

    boot: int = 0
    """Number of the boot that this clock counts from, from 0 for the first one that the session received."""

    state: VehicleState | None = None
    """Its mode, arming and battery; None before a vehicle is chosen."""

    position: Numbers | None = None
    """Its position north, east and down of the autopilot's origin, m; None where none comes."""

    takeoff_position: Numbers | None = None
    """That of its latest take-off, m; None where that was not seen."""

    displacement: Displacement | None = None
    """How far it is from its latest take-off by satellites and barometer, where the autopilot has rebooted in flight:
    its origin is another one then. None elsewhere, or where they do not come."""

    displacement_from_home: Displacement | None = None
    """How far it is from its home position, as the autopilot estimates both; None where they do not come."""

    last_position: GlobalPosition | None = None
    """Its latest geographic position in this boot or flight, by which it is searched; None where none came."""

    message_age: float | None = None
    """Time since the last message of the followed vehicle, s; None before any."""

    motion_age: float | None = None
    """Time since its last attitude or motor outputs, s; None before any."""

    last_reception: float | None = None
    """UNIX time of its last message, s; None before any."""

    is_over: bool = False
    """Whether the session has ended, so that the status is about the whole flight."""

    learned_rows: int = 0
    """Number of rows that the learner used."""

    unlearned_rows: int = 0
    """Number of rows that were shown, but not used by the learner."""

    postponed_rows: int = 0
    """Number of rows of free flight that this computer had no time to learn from."""

    settled_seconds: float = 0.0
    """Duration of settled flight (without take-off and landing) in the latest flight, s, learned from or not."""

    shortfall: Fact | None = None
    """Why less was learned of the latest flight than could be; None where nothing is known to be missing."""

    latency: Latency = Latency()
    """Delay from a packet's arrival to its estimate."""

    analysis_delay: float = 0.0
    """Seconds that the oldest unanalysed packet has waited; 0 while this computer keeps up."""

    held_alarm_delay: float = 0.0
    """Longest of these delays in the last seconds, s; 0 if none was so long that alarms are called late."""

    prediction_band: PredictionBand = PredictionBand()
    """How well the angle is predicted at the reported horizon."""

    useful_horizon: UsefulHorizon = UsefulHorizon()
    """How far ahead predictions are useful."""

    lost_messages: int = 0
    """Messages of the vehicle that were not received, by its sequence numbers, which wrap after 256."""

    gap_seconds: float = 0.0
    """Duration of gaps in which the sequence numbers may have wrapped, s; their messages are not counted as lost."""

    late_samples: int = 0
    """Number of samples that came too late for their row."""

    undecoded_frames: int = 0
    """Number of frames that are damaged or of another dialect."""

    motor_alarms: tuple[MotorChange, ...] = ()
    """Latest lasting changes of the motors' balance in all flights of the session; changes without a named motor are
    no alarms."""

    motor_alarms_of_flight: tuple[MotorChange, ...] = ()
    """Such changes in the latest flight, by which its motors are judged."""

    findings: Findings | None = None
    """What the model so far is good for; None before it is judged."""

    model_judgement: Judgement | None = None
    """Headline, lights and next step by the model so far; None before it is judged."""

    margins: Fact | None = None
    """The light of the margins by the loops that were identified in this flight; None before they were."""

    provisional_margins: Fact | None = None
    """The light of the margins until they are identified by setpoints of the rate; None where none of these come."""

    flight_seconds: float | None = None
    """Time since the take-off, s; None on the ground, or where the take-off was not seen."""

    link_outage: float | None = None
    """Longest time without messages in the latest flight, s, if that was an alarm; None without one."""

    has_landed: bool = True
    """Whether the latest flight ended on the ground; false while the vehicle may be falling with its motors stopped."""

    landing_time: float | None = None
    """When the vehicle came to the ground last, s of the boot clock; None before that, and in flight."""

    is_armed_since_landing: bool = False
    """Whether the vehicle was armed all the time since it landed: then it is not armed for another flight."""

    is_recording_judged: bool = False
    """Whether ``model_judgement`` is that of the recording, which is judged by the rules for logs after a landing."""

    recording_verdict: Fact | None = None
    """The verdict of the recording on the flight that is over, or why there is none yet; None where no recording is
    to be judged apart from this session. An all-clear waits for it."""

    fault_in_library: Fact | None = None
    """Why the vehicle should not fly, by the library's judgement of its flights in former sessions: a fault that
    forbids to fly, a bad fault of the flight before, or that the end of that flight was not received; None without
    any."""

    loss: Fact | None = None
    """How the flight was lost, until the next take-off; None if it was not."""

    ground_contact: Fact | None = None
    """How the lost vehicle met the ground, which the autopilot may not have noticed; None before, or without a loss."""

    active_alarms: Facts = ()
    """What is bad now. An alarm about a weak motor stays after the landing."""

    wind: WindEstimate | None = None
    """Latest estimate of the wind, m/s; None before one."""

    no_wind_reason: Fact | None = None
    """Why there is no wind estimate although the vehicle flies."""

    mean_wind: WindEstimate | None = None
    """Mean wind of the flight, m/s; None before an estimate."""

    watch_facts: Facts = ()
    """For each thing that is watched without a model: since when, or why it is not."""

    worst_lights: NamedFacts = field(default_factory=dict)
    """The worst fact found so far without a model in the latest flight, by light."""

    verdicts: tuple[FlightVerdict, ...] = ()
    """The verdicts on all flights of the session up to now, in their order; ``verdicts_worst_first`` is up to date."""

    is_recorded: bool = True
    """Whether what is received is recorded, so that a log can be kept and judged."""

    absent_messages: frozenset[str] = frozenset()
    """Names of the messages that do not come, although the vehicle was asked for them."""

    status_before_silence: SessionStatus | None = None
    """The status when the last message came, while the vehicle is silent; None while messages and motion come."""

    @property
    def displacement_from_takeoff(self) -> Displacement | None:
        """Distance and height, m, of a flying vehicle from the place of its take-off.

        They are the difference of two estimated positions. If the autopilot has restarted in flight, the take-off has
        no position in the present coordinates: then satellites and barometer give ``displacement``. None if the vehicle
        is not in the air, or if neither is known.
        """
        if not self._is_in_air:
            return None
        if self.position is None or self.takeoff_position is None:
            return self.displacement
        north, east, down = np.subtract(self.position, self.takeoff_position).tolist()
        return Displacement(distance=hypot(north, east), height=-down)

    @property
    def place_in_flight(self) -> NamedPlace | None:
        """Where a flying vehicle is from the place of its take-off or, if that was not seen, from its home position.

        None if the vehicle is not in the air, or if neither is known.
        """
        displacement = self.displacement_from_takeoff
        if displacement is not None:
            return NamedPlace("the take-off", *displacement)
        if self._is_in_air and self.displacement_from_home is not None:
            return NamedPlace("home", *self.displacement_from_home)
        return None

    @property
    def _is_in_air(self) -> bool:
        """Whether the vehicle is in the air: it counts as flying, and no crash was found.

        The autopilot of a crashed vehicle may still report for some seconds that it flies.
        """
        return self.is_flying and self.ground_contact is None

    @cached_property
    def overall_judgement(self) -> Judgement:
        """The judgement of the latest flight: headline, next step and lights, by the model and by checks without one.

        The headline is the fact that matters most, and the next step what the pilot should do. The lights are the
        judgements of the parts of the vehicle, such as its motors: each is a fact with a level. The headline is found
        in steps, each of which may replace the headline of the step before:

        1. The headline of the model or, if that is no fault, of the worst lights.
        2. If nothing was checked so far: in flight, that there is no alarm; later, that the flight was not judged.
        3. How the flight was lost.
        4. In flight, what cannot wait until the landing. After the flight, see :meth:`_judgement_after_flight`.
        """
        judgement = self._judgement_by_model_and_checks
        is_nothing_checked = judgement.headline.code in (
            HeadlineCode.NOTHING_CHECKED,
            *STATES_OF_LEARNING,
        )
        if is_nothing_checked:
            judgement = self._judgement_without_check(judgement)
        # The judgement of the recording, where there is one, has a headline on the loss that says more than this one.
        states_loss = judgement.headline.code in Ending
        if self.loss is not None and not states_loss:
            lights = lights_with_event(judgement.lights, self.loss)
            judgement = _judgement_from_headline(self.loss, lights)
        if self.is_in_flight:
            return self._judgement_in_flight(judgement)
        return self._judgement_after_flight(judgement)

    def _judgement_after_flight(self, judgement: Judgement) -> Judgement:
        """Corrects a judgement for a vehicle that does not fly now, or whose session is over.

        The headline, the fact that matters most, is the first of these that applies:

        1. The link was lost in flight.
        2. The server ended in flight, so that nobody watches the vehicle any more.
        3. It is not certain that the flight ended well, unless something was wrong in it anyway.
        4. The autopilot restarted after the last message of the flight in the air, so that nobody saw how it ended. A
           bad fault comes first.
        5. What the recording of the flight shows, or that it is not judged yet.

        Where none of these is a fault, an outage of the link in the flight is added (:meth:`_judgement_with_outage`).
        If the session has ended in flight, the next step begins with the landing.

        Args:
            judgement: judgement of the latest flight by this session; the one before any flight, too.
        """
        link_loss = self.link_loss
        if link_loss is not None:
            # What was found before, such as a weak motor, is the figure "cause" of this fact.
            lights_to_show = self._lights_with_recording(judgement.lights)
            return _judgement_of_lost_link(link_loss, lights_to_show)
        if self._is_left_in_air:
            return self._judgement_of_vehicle_left_in_air(judgement)
        uncertainty = self._uncertainty_after_landing
        if uncertainty is not None and not judgement.headline.is_watch_or_bad:
            next_step = Fact(NextStep.DO_AS_ADVISED, reason=uncertainty)
            return replace(judgement, headline=uncertainty, next_step=next_step)
        judgement = self._judgement_with_recording(judgement)
        if self._is_end_unseen:
            judgement = judgement_with_unseen_end(judgement)
        if self.link_outage is not None:
            judgement = _judgement_with_outage(judgement, self.link_outage)
        has_ended_in_flight = self._is_in_air and self.loss is None
        if has_ended_in_flight:
            return self._judgement_until_landing(judgement)
        return judgement

    @property
    def _is_end_unseen(self) -> bool:
        """Whether the autopilot restarted after the last message of the latest flight in the air, and does not fly."""
        if self.is_flying or not self.verdicts:
            return False
        latest_verdict = self.verdicts[-1]
        return latest_verdict.number == self.flight_number and latest_verdict.is_lost_in_air

    def _judgement_until_landing(self, judgement: Judgement) -> Judgement:
        """Puts the landing before the next step of a judgement, after a session that has ended in flight.

        Args:
            judgement: judgement of the flight. Its next step, such as a repair, is for the vehicle on the ground.
        """
        step_on_ground = judgement.next_step
        if self._is_urgent(judgement.headline):
            # The end of the session has not changed how urgent the fault is.
            step = Fact(NextStep.LAND_NOW, reason=judgement.headline, next_step=step_on_ground)
        else:
            step = self._landing_step(step_on_ground)
        return replace(judgement, next_step=step)

    def _landing_step(self, step_on_ground: Fact) -> Fact:
        """Returns the next step after a session that ended in flight: to land, and what to do after the landing.

        Args:
            step_on_ground: what to do after the landing, such as a repair.
        """
        landing = NextStep.LET_LAND if self.lands_by_itself else NextStep.LAND_BY_SIGHT
        reason = step_on_ground.figures.get("reason")
        is_step_of_learning = isinstance(reason, Fact) and reason.code in STATES_OF_LEARNING
        # What would have made the model better is out of date: nothing more is learned.
        return Fact(landing, reason=None if is_step_of_learning else step_on_ground)

    @property
    def _is_left_in_air(self) -> bool:
        """Whether the session has ended with its server while the vehicle flew, so that nobody watches it any more.

        Then the recording of the flight is judged only once the server runs again, which ``recording_verdict`` states.
        """
        if not self.is_over or not self._is_in_air or self.loss is not None:
            return False
        verdict = self.recording_verdict
        if verdict is None or verdict.code is not SessionFact.RECORDING_NOT_JUDGED:
            return False
        return verdict.figures["kind"] is RecordingState.READ_AT_NEXT_START

    def _judgement_of_vehicle_left_in_air(self, judgement: Judgement) -> Judgement:
        """Returns the judgement after the server has ended in flight: how the vehicle flies is not known any more.

        So no light, which judges one part of the vehicle, stays good.

        Args:
            judgement: judgement of the flight until then. If its headline is a fault, the new headline names it as its
                cause.
        """
        cause = judgement.headline if judgement.headline.is_watch_or_bad else None
        headline = self.end_in_flight(cause)
        lights = lights_during_silence(judgement.lights, None, MissingMessages.MESSAGES)
        next_step = Fact(NextStep.DO_AS_ADVISED, reason=headline)
        return Judgement(headline, next_step, lights)

    def end_in_flight(self, cause: Fact | None) -> Fact:
        """Returns the fact that the session ended in flight, so that nobody watches the vehicle any more.

        Args:
            cause: the fault that was found before; None without one.
        """
        delay = self.analysis_delay if self.is_late else None
        return Fact(SessionFact.ENDED_IN_FLIGHT, Level.BAD, cause=cause, delay=delay)

    @property
    def _uncertainty_after_landing(self) -> Fact | None:
        """What is uncertain just after a flight, so that the flight is not called sound yet; None if nothing is.

        The motors may have stopped in the air: a fall is found a moment later. While they are still armed after the
        landing, the vehicle may topple over. A vehicle that is armed anew is about to begin another flight.
        """
        if not self.is_after_flight or self.is_over:
            return None
        if not self.has_landed:
            return Fact(WatchFact.MOTORS_JUST_STOPPED)
        is_armed = self.state is not None and self.state.is_armed
        if is_armed and self.is_armed_since_landing:
            return Fact(WatchFact.ARMED_AFTER_LANDING, awaits_disarming=self._awaits_disarming)
        return None

    @property
    def _awaits_disarming(self) -> bool:
        """Whether the vehicle has landed so lately that its autopilot may still disarm it without the pilot."""
        if self.landing_time is None:
            return False
        return self.boot_clock - self.landing_time < AUTOMATIC_DISARM_SECONDS

    @property
    def is_in_flight(self) -> bool:
        """Whether the vehicle flies now; False once the session is over, even if the vehicle flew at its end."""
        return self.is_flying and not self.is_over

    @property
    def is_after_flight(self) -> bool:
        """Whether the vehicle has flown in this session and does not fly now, since it has landed or was lost."""
        return self.flight_number > 0 and not self.is_flying

    @property
    def is_latest_flight_over(self) -> bool:
        """Whether the vehicle has flown, and the latest flight has ended, or the session has ended during it."""
        return self.flight_number > 0 and not self.is_in_flight

    def _judgement_without_check(self, judgement: Judgement) -> Judgement:
        """Replaces the headline of a judgement that no check of the vehicle supports so far.

        In flight the new headline is that there is no alarm of what is watched; after a flight, that nothing was
        checked in it. Before the first flight, and if nothing is watched yet, the judgement stays as it is.

        Args:
            judgement: the judgement so far. Its headline says that nothing was checked, or what the session does, such
                as to wait for steady flight.
        """
        if self.is_in_flight:
            if not self._watched_names:
                return judgement
            no_alarm = Fact(WatchFact.NO_ALARM, names=self._watched_names)
            return replace(judgement, headline=no_alarm)
        if self.flight_number > 0:
            return self._unchecked_flight_judgement(judgement)
        return judgement

    def _unchecked_flight_judgement(self, judgement: Judgement) -> Judgement:
        """Returns the judgement of a flight that is over, during which nothing of the vehicle could be checked.

        Its headline says so with the reason. Where the headline so far says only what the session did, such as to wait
        for steady flight, the reason is that too little was received.

        Args:
            judgement: the judgement so far. Its headline is either ``HeadlineCode.NOTHING_CHECKED`` with a reason, or
                one of ``STATES_OF_LEARNING``.
        """
        reason = judgement.headline
        if reason.code is HeadlineCode.NOTHING_CHECKED:
            reason = reason.figures["reason"]
        if reason.code in STATES_OF_LEARNING:
            reason = self._reason_for_no_model
        headline = Fact(HeadlineCode.NOTHING_CHECKED, reason=reason)
        if self.no_model_reason is not None and self.no_model_reason.code is SessionFact.NOT_FLYING:
            # The session goes on with the next flight, so its next step, such as to take off, remains right.
            return replace(judgement, headline=headline)
        # Otherwise, as at the end of the session, the next step follows from the new headline.
        return _judgement_from_headline(headline, judgement.lights)

    @property
    def verdict(self) -> FlightVerdict:
        """The judgement of the latest flight so far as if it were over: without what a pilot must do in flight."""
        # A vehicle that flies on after a restart in the air still has the verdict by which it seemed to be lost.
        verdicts = () if self.is_flying else self.verdicts
        flight_so_far = replace(self, is_flying=False, is_over=True, verdicts=verdicts)
        return FlightVerdict(
            self.flight_number, flight_so_far.overall_judgement, self.flight_seconds
        )

    @property
    def verdicts_worst_first(self) -> list[FlightVerdict]:
        """The verdicts on all flights of the session, the worst first; a verdict is the judgement of one flight.

        Each was made when its flight ended. That on the latest flight is made anew, since the recording of the flight
        may have been judged meanwhile. There is one exception: if the autopilot restarted after a loss in the air, the
        present judgement is about the time after the restart, and the verdict from before it stays until the recording
        is judged.
        """
        if not self.verdicts:
            return []
        earlier_verdicts = self.verdicts[:-1]
        latest_verdict = self.verdicts[-1]
        is_of_latest_flight = latest_verdict.number == self.flight_number
        is_from_before_restart = latest_verdict.is_lost_in_air and not self.is_recording_judged
        if is_of_latest_flight and not is_from_before_restart:
            latest_verdict = latest_verdict._replace(judgement=self.overall_judgement)
        return worst_first([*earlier_verdicts, latest_verdict])

    @property
    def worst_earlier_verdict(self) -> FlightVerdict | None:
        """The worst bad verdict on a flight of the session before the latest one; None if no such flight was bad."""
        for verdict in self.verdicts_worst_first:
            if verdict.number != self.flight_number and verdict.judgement.headline.is_bad:
                return verdict
        return None

    @property
    def session_judgement(self) -> Judgement:
        """The judgement to show: that of the latest flight, with a warning of faults that earlier flights had.

        A take-off repairs nothing. So a next step that lets the vehicle fly on gets the condition "if the fault was
        repaired", and as long as nothing else warns in flight, the fault is the headline. On the ground the headline is
        that of the worst flight: one of the session, or an earlier one in the library. While the link is lost in
        flight, what to do about that comes first. The lights, which judge the parts of the vehicle, remain those of the
        latest flight.
        """
        judgement = self._judgement_with_worst_headline
        fault = self.unrepaired_fault
        if fault is None or self.link_loss is not None:
            return judgement
        if self.is_in_flight:
            return self._judgement_with_condition(judgement, fault)
        is_landing_advised = judgement.next_step.code in STEPS_TO_THE_GROUND
        # Of two flights of this session, the worse one is the headline already.
        is_of_earlier_session = fault.figures["reason"] == self.fault_in_library
        if is_landing_advised or not (self._is_known_to_be_on_ground and is_of_earlier_session):
            return judgement
        if not _is_worse_for_take_off(fault.figures["reason"], judgement.headline):
            return judgement
        next_step = Fact(NextStep.TAKE_OFF_IF_REPAIRED, reason=fault)
        return replace(judgement, headline=fault, next_step=next_step)

    @property
    def _is_known_to_be_on_ground(self) -> bool:
        """Whether it is known where the vehicle is, and that it does not fly: it is received, or its flight is over."""
        is_vehicle_known = self.flight_number > 0 or self.is_over or self._is_vehicle_received
        return is_vehicle_known and not self._is_in_air

    def _judgement_with_condition(self, judgement: Judgement, fault: Fact) -> Judgement:
        """Adds a condition to the next step of a judgement in flight: that the fault of an earlier flight was repaired.

        Args:
            judgement: judgement of the present flight. Its headline stays if it warns.
            fault: the warning of the fault, which becomes the headline otherwise.
        """
        headline = judgement.headline if judgement.headline.is_watch_or_bad else fault
        if judgement.next_step.code in STEPS_TO_THE_GROUND:
            # No repair allows more than the landing that is advised anyway.
            return replace(judgement, headline=headline)
        step = Fact(NextStep.FLY_ON_IF_REPAIRED, reason=fault, next_step=judgement.next_step)
        return replace(judgement, headline=headline, next_step=step)

    @property
    def _judgement_with_worst_headline(self) -> Judgement:
        """The judgement of the latest flight; on the ground, a worse earlier flight gives its headline and next step.

        A vehicle that crashed in flight 1 and made a good flight 2 thus keeps the warning of flight 1 until its faults
        are known to be repaired. If the session ended in flight, the landing comes first. In flight the pilot needs the
        state of the present flight. The lights, which judge the parts of the vehicle, are always those of the latest
        flight.
        """
        latest_judgement = self.overall_judgement
        earlier_verdict = self.worst_earlier_verdict
        if earlier_verdict is None or self.is_in_flight:
            return latest_judgement
        is_earlier_flight_worst = self.verdicts_worst_first[0] == earlier_verdict
        if not is_earlier_flight_worst:
            return latest_judgement
        if self._is_in_air and self.loss is None:
            return self._judgement_with_landing_first(latest_judgement, earlier_verdict)
        next_step = earlier_verdict.judgement.next_step
        return replace(latest_judgement, headline=earlier_verdict.fact, next_step=next_step)

    def _judgement_with_landing_first(
        self, latest_judgement: Judgement, earlier_verdict: FlightVerdict
    ) -> Judgement:
        """Returns the judgement of a session that ended with the vehicle in the air, if an earlier flight had a fault.

        The vehicle in the air matters more than the fault. The headline says that the session ended in flight, and
        then names the fault; the next step is to land, and then to repair it.

        Args:
            latest_judgement: judgement of the flight in which the session ended. It is returned as it is if the link to
                the vehicle was lost, since its next step is then to search for the vehicle.
            earlier_verdict: verdict on the earlier flight, whose fault is worse than those of the latest one.
        """
        if self.link_loss is not None:
            return latest_judgement
        headline = self.end_in_flight(earlier_verdict.fact)
        next_step = self._landing_step(earlier_verdict.judgement.next_step)
        return replace(latest_judgement, headline=headline, next_step=next_step)

    @property
    def unrepaired_fault(self) -> Fact | None:
        """The warning that a fault with which the vehicle must not fly may still be there since an earlier flight.

        The earlier flight is one of this session. If none of these has such a fault, it is one of a former session,
        whose recording the library has judged, or else the latest one of this session whose end was not seen. None if
        there is no such fault, or if the headline states it already.
        """
        worst_verdict = self.worst_earlier_verdict
        if worst_verdict is None or not worst_verdict.judgement.headline.forbids_flight:
            return self._library_warning or self._warning_of_unseen_end
        headline = self._judgement_with_worst_headline.headline
        if worst_verdict.fact in (headline, headline.figures.get("cause")):
            return None
        return self._warning_of_unrepaired_fault(
            worst_verdict.fact, worst_verdict.judgement.next_step
        )

    @property
    def _warning_of_unseen_end(self) -> Fact | None:
        """The warning that the end of an earlier flight of this session was not seen, so that it may have been a crash.

        None without such a flight, and after a later flight that was judged good: then the vehicle was sound.
        """
        for verdict in reversed(self.verdicts):
            if verdict.number == self.flight_number:
                continue
            if verdict.is_lost_in_air:
                end_unknown = Fact(SessionFact.FLIGHT_END_UNKNOWN, reason=None)
                return self._warning_of_unrepaired_fault(
                    end_unknown, Fact(NextStep.DO_AS_ADVISED, reason=end_unknown)
                )
            if verdict.judgement.headline.is_good:
                return None
        return None

    @property
    def _library_warning(self) -> Fact | None:
        """The warning that a fault may still be there which an earlier recording in the library has shown.

        None if the library knows no fault of the vehicle, or if a flight of this session has shown since whether the
        fault is still there.
        """
        fault = self.fault_in_library
        if fault is None or self._was_fault_checked_again:
            return None
        return self._warning_of_unrepaired_fault(fault, Fact(NextStep.DO_AS_ADVISED, reason=fault))

    @property
    def _was_fault_checked_again(self) -> bool:
        """Whether a flight of this session has checked the fault that the library knows of an earlier flight.

        Any flight checks a fault with which the vehicle may fly, such as a small stability margin. It does not check a
        fault that forbids to fly, nor an earlier flight whose end was not received: the warning of these stays.
        """
        fault = self.fault_in_library
        if fault is None or fault.code is not SessionFact.RECORDING_JUDGED or fault.forbids_flight:
            return False
        return self.is_latest_flight_over

    def _warning_of_unrepaired_fault(self, earlier_fault: Fact, next_step: Fact) -> Fact:
        """Returns the warning that the vehicle may still have a fault of an earlier flight.

        Args:
            earlier_fault: the fault that was found in the earlier flight.
            next_step: what to do about the fault, such as to check a motor.
        """
        return Fact(
            SessionFact.UNREPAIRED_FAULT,
            reason=earlier_fault,
            next_step=next_step,
            is_in_flight=self.is_in_flight,
        )

    @property
    def link_loss(self) -> Fact | None:
        """The fact that a vehicle in flight sends nothing, with its last known state; None while its messages come.

        None also if the vehicle is known to be lost, since it has met the ground or is about to.
        """
        if self.is_over and self.is_late:
            # The vehicle may have landed in the messages that were not analysed.
            return None
        # Without messages no model can be learned, so that the silence is why there is none.
        silence = self.no_model_reason
        if silence is None or silence.code not in SILENT_LINK:
            # Messages come; another reason may prevent learning.
            return None
        if not self.is_flying or self.loss is not None:
            return None
        voltage = None
        if self.state is not None:
            voltage = self.state.voltage
        age = self._silence_seconds(silence)
        return link_loss_fact(
            silence,
            age=age,
            reception=self.last_reception,
            displacement=self.displacement_from_takeoff,
            voltage=voltage,
            last_position=self.last_position,
            cause=self._likely_cause_of_silence,
            unread_seconds=self._unread_seconds(age),
            is_over=self.is_over,
        )

    def _unread_seconds(self, silence_seconds: float | None) -> float | None:
        """Returns how many seconds of messages came before a silence and still wait for their analysis.

        For example, the oldest message that waits came 12 s ago, and the latest message 5 s ago: 7 s of messages wait.

        Args:
            silence_seconds: time since the latest message, s; None if that is not known, which counts as 0.

        Returns:
            The duration, s. None if no message from before the silence waits, or if the oldest one has waited for less
            than ``MAX_ALARM_DELAY``.
        """
        if not self.is_late:
            return None
        age_of_oldest_message = self.analysis_delay
        age_of_latest_message = silence_seconds or 0.0
        unread_seconds = age_of_oldest_message - age_of_latest_message
        return unread_seconds if unread_seconds > 0.0 else None

    @property
    def alarms(self) -> Facts:
        """What is bad now, or lasts from before: the active alarms, and a link that was lost in flight for long."""
        link_loss = self.link_loss
        if link_loss is not None and link_loss.is_bad:
            return (link_loss, *self.active_alarms)
        return self.active_alarms

    @property
    def _likely_cause_of_silence(self) -> Fact | None:
        """The fault by which the vehicle may have stopped sending, such as an empty battery; None without such a fault.

        Two kinds of faults explain a silence better than a vehicle out of radio range: first one for which a pilot must
        land at once, such as a loss of control, and then one of the power supply.
        """
        judgement = self._judgement_by_model_and_checks
        worst_fault = self._alarm_or_headline(judgement.headline)
        if self._is_urgent(worst_fault):
            return worst_fault
        power_light = judgement.lights[Light.POWER]
        if power_light.is_watch_or_bad:
            return power_light
        return None

    @property
    def further_alarms(self) -> Facts:
        """The active alarms that are about another fault than the headline, which states the most important one.

        Codes and subjects are compared: an alarm on the fault of the headline may have older figures.
        """
        headline_fault = cause_of_alarm(self.session_judgement.headline)
        further_alarms = []
        for alarm in self.active_alarms:
            fault = cause_of_alarm(alarm)
            is_same_fault = (
                fault.code == headline_fault.code and fault.subject == headline_fault.subject
            )
            if not is_same_fault:
                further_alarms.append(alarm)
        return tuple(further_alarms)

    @property
    def _judgement_by_model(self) -> Judgement:
        """The judgement of the flight by the learned model: a headline, a next step, and a light for each part.

        A light judges one part of the vehicle, such as its motors. Before a model is learned, the headline names a
        motor that lost thrust, or else says why there is no model.
        """
        if self.model_judgement is not None:
            lights = self._lights_with_reasons(self.model_judgement.lights)
            return replace(self.model_judgement, lights=lights)
        headline = self._weak_motors[0] if self._weak_motors else self._reason_without_model
        return replace(unjudged(headline), lights=self._preliminary_lights)

    def _lights_with_reasons(self, lights_by_model: NamedFacts) -> dict[str, Fact]:
        """Returns the lights of a model, of which those on tracking and estimator say why they are not judged yet.

        No model shows how well the vehicle follows its setpoints, nor how good the autopilot's estimator is. By the
        model alone, these two lights only say that they are judged after the flight.

        Args:
            lights_by_model: the judgement of each part of the vehicle by the model, by the name of the part.
        """
        lights = dict(lights_by_model)
        for part in (Light.TRACKING, Light.ESTIMATOR):
            if lights[part].code is Unjudged.JUDGED_LATER:
                reason = self._preliminary_lights[part].figures["reason"]
                lights[part] = lights[part].replace(reason=reason)
        return lights

    @property
    def _preliminary_lights(self) -> dict[str, Fact]:
        """The lights before the first model is judged, by the name of the part of the vehicle, such as "motors".

        A light is the judgement of one part, a fact with a level. If the part is watched for faults, its light says
        that no alarm was raised so far. Otherwise its level is unknown, and the light has the reason, such as that a
        message does not come.
        """
        return lights_before_model(
            no_model_reason=self._reason_without_model,
            rates=self.rates,
            watch_facts=self._watch_states_of_flight,
            no_wind_reason=self.no_wind_reason,
            provisional_margins=self.provisional_margins,
        )

    @property
    def _watch_states_of_flight(self) -> dict[str, Fact]:
        """For each watched quantity, such as vibration: since when it is watched for faults, or why it is not.

        If the vehicle has been silent since its flight, these are the states before the silence. The silence itself is
        no reason why a part of the vehicle could not be judged in the flight.
        """
        if not self._is_silent_after_flight:
            return self._watch_states
        if self.status_before_silence is None:
            return {}
        return self.status_before_silence._watch_states

    @property
    def _judgement_by_model_and_checks(self) -> Judgement:
        """The judgement of the flight by the learned model and by the checks that need no model, such as for alarms.

        Each light (the judgement of one part of the vehicle) is the worse of both. The headline, the sentence that
        matters most, is made to agree with the lights:

        - If a light is bad, the headline is a fault.
        - If there is no model yet, the headline sums up the lights.
        - If the model shows no fault, but some light is not the model's, the headline also sums up the lights.
        - Otherwise the headline of the model stays.
        """
        by_model = self._judgement_by_model
        lights = self._combined_lights(by_model.lights, self._lights_by_checks)
        lights = self._lights_after_landing(lights)
        lights = self._lights_during_oscillation(lights)
        judgement = self._without_unanswered_requests(replace(by_model, lights=lights))
        if any(light.is_bad for light in judgement.lights.values()):
            return _judgement_with_bad_lights(judgement)
        if self._is_judged_without_model:
            return self._judgement_before_model(judgement)
        # Headlines with codes of this enumeration are not about a fault, so that a worse light may contradict them.
        is_without_fault = isinstance(judgement.headline.code, HeadlineCode)
        if is_without_fault and judgement.lights != by_model.lights:
            return _judgement_with_summary_of_lights(judgement)
        return judgement

    def _judgement_before_model(self, judgement: Judgement) -> Judgement:
        """Returns the judgement before a model is learned: its headline sums up the checks that need no model.

        The next step depends on whether messages come:

        - While they do, a model can still be learned. If nothing warns, the next step stays that towards a model.
        - Without messages no model can be learned. The next step is what the headline advises.

        Args:
            judgement: the lights (judgements of motors, power and other parts of the vehicle), and a next step that
                says what has to happen before a model can be learned, such as to take off.
        """
        if self._is_vehicle_received:
            return _judgement_with_summary_of_lights(judgement)
        headline = headline_by_lights(judgement.lights)
        return _judgement_from_headline(headline, judgement.lights)

    @property
    def _is_judged_without_model(self) -> bool:
        """Whether only checks that need no learned model judge the vehicle, such as that of the battery.

        False once a model is learned, and if the checks judge no part of the vehicle. It is also false while a vehicle
        in flight sends no messages, since how it flies is not known then. After the flight or the session the checks
        still judge what was received, and no more messages are needed.
        """
        if self.model_judgement is not None:
            return False
        needs_messages = not (self.is_over or self._is_silent_after_flight)
        if needs_messages and not self._is_vehicle_received:
            return False
        return any(part in self._lights_by_checks for part in VEHICLE_LIGHTS)

    def _lights_during_oscillation(self, lights: NamedFacts) -> dict[str, Fact]:
        """Withdraws good judgements of motors and tracking while the vehicle oscillates in flight: they become unknown.

        In an oscillation the motors go from limit to limit, and the attitude swings about its setpoint. A good
        judgement is of the time before. A judgement that warns stays.

        Args:
            lights: the judgement of each part of the vehicle, by the name of the part.

        Returns:
            The lights, those of motors and tracking corrected.
        """
        present_lights = dict(lights)
        oscillation_alarms = [
            alarm for alarm in self.active_alarms if alarm.code is MarginsLight.OSCILLATES
        ]
        if not self.is_flying or not oscillation_alarms:
            return present_lights
        for name in (Light.MOTORS, Light.TRACKING):
            if not present_lights[name].is_watch_or_bad:
                present_lights[name] = Fact(Unjudged.NOT_JUDGED, reason=oscillation_alarms[0])
        return present_lights

    def _lights_after_landing(self, lights: NamedFacts) -> dict[str, Fact]:
        """Returns the lights after a landing: an unknown one says why the part could not be judged in the flight.

        A light is the judgement of one part of the vehicle, and has a reason if its level is unknown.

        Args:
            lights: the judgement of each part of the vehicle, by the name of the part.

        Returns:
            The lights by name; unchanged in flight, and before the first flight.
        """
        lights_of_flight = dict(lights)
        if not self.is_after_flight:
            return lights_of_flight
        for name, light in lights.items():
            reason = light.figures.get("reason")
            if isinstance(reason, Fact):
                lights_of_flight[name] = self._light_after_landing(name, light, reason)
        return lights_of_flight

    def _light_after_landing(self, name: str, light: Fact, reason: Fact) -> Fact:
        """Returns a light after a landing, with a reason that was true in the flight, such as that it was too short.

        That the vehicle is on the ground now, or that its flight is over, does not say why a part was not judged.

        Args:
            name: name of the part of the vehicle that the light judges.
            light: the light now.
            reason: its reason now.
        """
        if reason.code is WatchFact.ON_GROUND_NOW:
            # Margins take long to compute, so that a slow computer may be why there are none. All other parts are
            # judged even then: without a judgement too little was received.
            is_margins = name == Light.MARGINS
            return light.replace(
                reason=self._reason_for_no_model if is_margins else self._too_little_received
            )
        if reason.code is LoopFact.LOOP_TOO_SHORT:
            return light.replace(reason=self._reason_for_no_margins(reason))
        if reason.code is SessionFact.FLIGHT_OVER and light.code in Unjudged:
            return Fact(Unjudged.NOT_JUDGED, reason=None)
        return light

    @property
    def _reason_for_no_model(self) -> Fact:
        """Why a flight that is over gave neither a model nor margins, as a fact (a coded finding).

        This computer was too slow if it had no time for most samples, or if the flight was long enough for margins;
        otherwise too little was received.
        """
        has_postponed_most = are_most_rows_postponed(self.postponed_rows, self.learned_rows)
        if has_postponed_most or self.was_long_enough_for_margins:
            return self._too_slow_to_judge
        return self._too_little_received

    def _reason_for_no_margins(self, reason: Fact) -> Fact:
        """Returns why the latest review of a flight that is over found it too short for margins.

        Args:
            reason: the reason of the review. Its figure ``settled`` is how long the settled flight was until then, s;
                None if it is not known.

        Returns:
            That this computer was too slow, if the flight became long enough after that review, and no other one came.
            Otherwise the reason without the figures that matter only while the flight goes on.
        """
        reviewed_seconds = reason.figures.get("settled") or 0.0
        was_reviewed_too_early = reviewed_seconds < MIN_IDENTIFIED_SECONDS
        if was_reviewed_too_early and self.was_long_enough_for_margins:
            return self._too_slow_to_judge
        return reason.replace(clock=None, settled=None)

    @property
    def was_long_enough_for_margins(self) -> bool:
        """Whether the latest flight is, or was, settled for as long as a review of the margins needs it.

        Its end, in which the landing is not recognised yet, was counted as settled and does not count here.
        """
        return self.settled_seconds >= MIN_IDENTIFIED_SECONDS + TRANSIENT_SECONDS

    @property
    def _too_slow_to_judge(self) -> Fact:
        """The fact that this computer was too slow to judge a flight in time."""
        return Fact(SessionFact.TOO_SLOW_TO_JUDGE, is_recorded=self.is_recorded)

    @property
    def _too_little_received(self) -> Fact:
        """The fact that a flight was too short to be judged or, if it gave no samples, that too few messages came."""
        has_rows = self.learned_rows + self.unlearned_rows > 0
        return Fact(SessionFact.TOO_LITTLE_RECEIVED, has_rows=has_rows)

    def _without_unanswered_requests(self, judgement: Judgement) -> Judgement:
        """Replaces the advice to request a message that was requested already and does not come.

        For example, without the message VIBRATION the vibration is unknown, and its status light advises to request
        that message. If the autopilot does not answer the request, the light has to advise something else, and so has
        the next step where it repeats the advice of the light.

        Args:
            judgement: judgement of the flight so far: status lights (one for each part of the vehicle) and next step.

        Returns:
            The judgement with such lights and such a next step replaced; all others are as before.
        """
        lights = dict(judgement.lights)
        for part, light in lights.items():
            if self._advises_unanswered_request(light):
                # The sentence of a light with this figure is that the message was requested in vain.
                lights[part] = light.replace(is_asked=True)
        if lights == judgement.lights:
            return judgement
        next_step = judgement.next_step
        repeated_light = next_step.figures.get("reason")
        if isinstance(repeated_light, Fact) and self._advises_unanswered_request(repeated_light):
            # No step is offered that improves the model, which matters less than a part that is not judged.
            next_step = choose_next_step(judgement.headline, lights)
        return replace(judgement, next_step=next_step, lights=lights)

    def _advises_unanswered_request(self, fact: Fact) -> bool:
        """Returns whether a fact (coded finding) advises to request a message that was already requested in vain.

        For example, the fact that the vibration is unknown advises to request VIBRATION. This is no use if the session
        has requested it, and it still does not come.

        Args:
            fact: any fact, also one without such advice.
        """
        message = REQUESTED_MESSAGES.get(fact.code)
        return message in self.absent_messages

    def _combined_lights(
        self, lights_by_model: NamedFacts, lights_by_checks: NamedFacts
    ) -> dict[str, Fact]:
        """Merges two sets of lights, which are judgements of the parts of the vehicle, into one light for each part.

        In flight the worse light of a part counts. Once the recording of the flight is judged, ``lights_by_model`` are
        the lights of the recording. Then :func:`_light_after_recording` decides, mostly for the recording.

        Args:
            lights_by_model: a light for each part, by the learned model or the recording; keys are names of parts.
            lights_by_checks: the lights of some parts, by the checks in flight that need no model.
        """
        combined_lights = dict(lights_by_model)
        for part, light_by_model in lights_by_model.items():
            light_by_checks = lights_by_checks.get(part)
            if light_by_checks is None:
                continue
            if self.is_recording_judged:
                combined_light = _light_after_recording(light_by_model, light_by_checks)
            else:
                combined_light = worst_fact([light_by_checks, light_by_model])
            combined_lights[part] = combined_light
        return combined_lights

    def _judgement_in_flight(self, judgement: Judgement) -> Judgement:
        """Returns the judgement of a flight that goes on, with headline and next step for the pilot in the air.

        The headline, the sentence that matters most, is the first of these that applies:

        1. No messages come, so that nothing below is known to be true any more (:meth:`_judgement_of_silent_vehicle`).
        2. A fault for which the pilot should land now. It counts even if this computer notices it late.
        3. This computer analyses messages, or did so some seconds ago, so late that the absence of an alarm means
           nothing.
        4. The headline so far, with what is not known of the flight.

        Without messages or with late ones it is not known how the vehicle flies now. So none of the lights (judgements
        of motors, power and other parts of the vehicle) is good then.

        Args:
            judgement: judgement of the flight so far, with the next step after its landing.
        """
        if self.no_model_reason is not None and not self._is_vehicle_received:
            return self._judgement_of_silent_vehicle(judgement, self.no_model_reason)
        lights = judgement.lights
        if self.are_alarms_late:
            lights = lights_during_silence(lights, self.alarm_delay, MissingMessages.MESSAGES)
        headline = self._alarm_or_headline(judgement.headline)
        if self._is_urgent(headline):
            next_step = Fact(NextStep.LAND_NOW, reason=headline, is_landing=self._is_landing)
            return replace(judgement, headline=headline, next_step=next_step, lights=lights)
        if self.are_alarms_late:
            headline = self._warning_of_delay
        else:
            headline = self._headline_with_unknowns(headline, lights)
        judgement_in_flight = replace(judgement, headline=headline, lights=lights)
        next_step = self._next_step_in_flight(judgement_in_flight)
        return replace(judgement_in_flight, next_step=next_step)

    def _headline_with_unknowns(self, headline: Fact, lights: NamedFacts) -> Fact:
        """Adds to a headline such as "Nothing wrong" what is not known of the flight, so that it does not say too much.

        That is for how long no messages came, and which parts of the vehicle were not judged.

        Args:
            headline: the fact that matters most. One that states a fault is returned as it is.
            lights: the judgement of each part of the vehicle, by the name of the part.
        """
        if self.link_outage is not None and headline.code in HEADLINES_WITHOUT_ALARM:
            # Meanwhile the pilot flew without alarms, and what would have been one is still not known.
            headline = headline.replace(outage=self.link_outage)
        if headline.code is HeadlineCode.NOTHING_WRONG:
            # The flight is called sound only once all parts of the vehicle are judged.
            unjudged_parts = list(headline.figures["missing"])
            level = Level.UNKNOWN if unjudged_parts else headline.level
            if unjudged_parts and lights[Light.WIND].level is Level.UNKNOWN:
                # An unknown wind alone does not make the headline unknown, but is counted with the unknown parts.
                unjudged_parts.append(str(Light.WIND))
            headline = headline.replace(level, is_in_flight=True, missing=unjudged_parts)
        return headline

    def _judgement_with_recording(self, judgement: Judgement) -> Judgement:
        """Makes the verdict of the recording the headline (the fact that matters most) after a flight.

        Before the recording is judged, a bad fault that was found in flight stays the headline. Otherwise the headline
        says that the recording, which may show more, is still to be judged, and names what is to be watched so far.
        Where nothing was recorded, the next step is not to keep a log.

        Args:
            judgement: judgement of the flight by this session.
        """
        if not self.is_recorded and judgement.next_step.code in LOG_KEEPING_STEPS:
            judgement = replace(judgement, next_step=Fact(NextStep.RECORD_NEXT_FLIGHT))
        verdict = self.recording_verdict
        if verdict is None or self.flight_number == 0 or self.is_recording_judged:
            return judgement
        if verdict.code is SessionFact.RECORDING_NOT_JUDGED:
            return self._judgement_before_recording(judgement, verdict)
        lights = self._lights_with_recording(judgement.lights)
        verdict = _verdict_by_shown_lights(verdict, lights)
        verdict = verdict_after_requests(verdict, self.absent_messages)
        next_step = Fact(NextStep.DO_AS_ADVISED, reason=verdict)
        return replace(judgement, headline=verdict, next_step=next_step, lights=lights)

    def _judgement_before_recording(self, judgement: Judgement, not_judged: Fact) -> Judgement:
        """Returns what to show of a flight that has ended until its recording has been judged.

        For example, the headline "nothing wrong" becomes "not judged yet", since the recording may show faults that the
        session did not. A bad fault of the flight stays the headline. One that warns, or small margins, which the
        recording shows better, become "not judged yet; so far: …", unless no judgement will follow, since the recording
        could not be read.

        Args:
            judgement: judgement of the flight by this session.
            not_judged: the fact that the recording is not judged, with the reason as its ``kind``.
        """
        headline_so_far = judgement.headline
        will_be_judged = not_judged.figures["kind"] is not RecordingState.FAILED
        arose_in_flight = headline_so_far.is_bad and headline_so_far.code not in PERMANENT_FAULTS
        is_warning_final = headline_so_far.is_watch_or_bad and not will_be_judged
        if arose_in_flight or is_warning_final:
            return judgement
        if self._is_silent_after_flight:
            not_judged = not_judged.replace(is_switched_off=True)
        headline = not_judged
        if headline_so_far.is_watch_or_bad:
            headline = not_judged.replace(headline_so_far.level, so_far=headline_so_far)
        lights = dict(judgement.lights)
        if will_be_judged and not lights[Light.MARGINS].is_good:
            # By margins of a part of the flight nobody is to change the gains, as their light would advise.
            lights[Light.MARGINS] = Fact(Unjudged.NOT_JUDGED, reason=not_judged)
        next_step = Fact(NextStep.DO_AS_ADVISED, reason=not_judged)
        return replace(judgement, headline=headline, next_step=next_step, lights=lights)

    def _lights_with_recording(self, lights: NamedFacts) -> NamedFacts:
        """Replaces the lights of a flight that is over by those of its recording, once that is judged as a log is.

        Args:
            lights: the judgement of each part of the vehicle by this session, by the name of the part.

        Returns:
            The lights of the recording, and bad ones of the session where that leaves a part unknown; before the
            recording is judged, the lights of the session.
        """
        recording_verdict = self.recording_verdict
        if recording_verdict is None or recording_verdict.code is not SessionFact.RECORDING_JUDGED:
            return lights
        return _lights_of_recording(lights, recording_verdict)

    def _judgement_of_silent_vehicle(self, judgement: Judgement, reason: Fact) -> Judgement:
        """Returns a judgement for a vehicle in flight whose messages do not come: how it flies is not known.

        Args:
            judgement: judgement of the flight so far.
            reason: the fact that says which messages do not come.
        """
        lights = self._lights_of_silent_vehicle(judgement.lights, reason)
        most_urgent_fact = self._alarm_or_headline(judgement.headline)
        is_urgent = self._is_urgent(most_urgent_fact)
        link_loss = self.link_loss
        is_loss_certain = link_loss is not None and link_loss.figures["delay"] is None
        if is_urgent and not is_loss_certain:
            headline = most_urgent_fact
        elif link_loss is not None:
            # This fact has an urgent alarm as its cause, and advises a landing by sight if that is certain.
            headline = link_loss
        else:
            headline = reason
        step = NextStep.LAND_NOW if is_urgent else NextStep.DO_AS_ADVISED
        next_step = Fact(step, reason=headline)
        return replace(judgement, headline=headline, next_step=next_step, lights=lights)

    def _lights_of_silent_vehicle(
        self, present_lights: NamedFacts, reason: Fact
    ) -> dict[str, Fact]:
        """Returns the lights of a vehicle in flight that sends nothing: good ones become unknown, with what they were.

        Args:
            present_lights: the judgement of each part of the vehicle, by the name of the part.
            reason: the fact that says whether all messages are missing, or attitude and motor outputs only.
        """
        missing = MissingMessages.MESSAGES
        if reason.subject == MissingMessages.MOTION:
            missing = MissingMessages.MOTION
        silence_seconds = self._silence_seconds(reason)
        if silence_seconds is not None:
            # If this computer is late, what was analysed last is older than the last message.
            silence_seconds = max(silence_seconds, self.analysis_delay)
        lights_at_last_message = self._lights_at_last_message(present_lights)
        return lights_during_silence(lights_at_last_message, silence_seconds, missing)

    def _lights_at_last_message(self, present_lights: NamedFacts) -> dict[str, Fact]:
        """Returns how the parts of a vehicle that sends nothing any more were judged when its last message came.

        During the silence, the judgement of many parts only says that no messages come. If such a part was good at the
        last message, that judgement is returned instead; and so is a judgement that the message that shows the part has
        never come, since the silence is not why it is unknown. A part that is judged as bad or to be watched stays so.

        Args:
            present_lights: the judgement of each part of the vehicle during the silence, by the name of the part.
        """
        lights = dict(present_lights)
        if self.status_before_silence is None:
            return lights
        lights_before_silence = self.status_before_silence._judgement_by_model_and_checks.lights
        for part, light_before_silence in lights_before_silence.items():
            lacks_message = _is_unknown_without_message(light_before_silence)
            is_kept = light_before_silence.is_good or lacks_message
            if is_kept and not lights[part].is_watch_or_bad:
                lights[part] = light_before_silence
        return lights

    def _silence_seconds(self, reason: Fact) -> float | None:
        """Returns how long the missing messages have not come, s; None if that is not known.

        Args:
            reason: the fact that they do not come, whose subject is all messages or those of the motion.
        """
        return self.motion_age if reason.subject == MissingMessages.MOTION else self.message_age

    def _is_urgent(self, headline: Fact) -> bool:
        """Returns whether the pilot should land now, because of what a headline in flight states.

        That is the case for an active alarm, and for a bad fault that began in flight and is not over. Small stability
        margins, for example, are no reason: the vehicle had them at its take-off (``PERMANENT_FAULTS``).

        Args:
            headline: the headline, a fact about the vehicle.
        """
        if headline in self.active_alarms:
            return True
        is_permanent = headline.code in PERMANENT_FAULTS
        return headline.is_bad and not is_permanent and not self._is_past_event(headline)

    def _is_past_event(self, fact: Fact) -> bool:
        """Returns whether a fact is an event that is over: it has an end, and no alarm on it is active any more.

        Args:
            fact: any fact about the flight.
        """
        is_alarm = any(
            alarm.code is fact.code and alarm.subject == fact.subject
            for alarm in self.active_alarms
        )
        return _is_event(fact) and fact.end_time is not None and not is_alarm

    def _alarm_or_headline(self, headline: Fact) -> Fact:
        """Returns the most urgent of a headline and the active alarms; of equally urgent ones the headline.

        For example, the alarm of a loss of control comes before vibration, which may be its cause.

        Args:
            headline: headline of the judgement: its first sentence on the screen, as a fact.
        """
        return max((headline, *self.active_alarms), key=self._urgency_in_flight)

    def _urgency_in_flight(self, fact: Fact) -> tuple[int, int]:
        """Returns how urgent a fact is for a pilot in flight: the greater of two such pairs is more urgent.

        The first number is 4 for a bad event that lasts, 3 for another bad fault that lasts, 2 for a bad event that is
        over, 1 for an alarm that is only to be watched, and 0 for anything else. The second one is the rank of the
        level.

        Args:
            fact: the headline, or an active alarm.
        """
        level_rank = LEVELS_BY_SEVERITY.index(fact.level)
        if fact.is_bad:
            if self._is_past_event(fact):
                return 2, level_rank
            return (4 if _is_event(fact) else 3), level_rank
        return (1 if fact in self.active_alarms else 0), level_rank

    def _next_step_in_flight(self, judgement: Judgement) -> Fact:
        """Returns what the pilot of a vehicle in flight without an active alarm should do.

        The first of these conditions that applies decides:

        1. The battery is getting empty: to land soon.
        2. Alarms come late: to watch the vehicle itself.
        3. The headline warns: to follow its advice after the landing, and until then :meth:`_step_until_landing`.
        4. Nothing warns: :meth:`_step_without_warning`.

        Args:
            judgement: judgement of the flight so far.
        """
        is_battery_emptying = judgement.lights[Light.POWER].code in EMPTYING_BATTERY
        if is_battery_emptying:
            return Fact(NextStep.LAND_SOON)
        if self.are_alarms_late:
            return Fact(NextStep.FLY_BY_SIGHT, delay=self.alarm_delay)
        headline = judgement.headline
        if headline.is_watch_or_bad:
            advice_after_landing = choose_next_step(headline, judgement.lights)
            step = self._step_until_landing(headline)
            return Fact(step, reason=advice_after_landing, awaits_motors=self.lacks_motor_reference)
        return self._step_without_warning(judgement.next_step)

    def _step_without_warning(self, step_to_model: Fact) -> Fact:
        """Returns what the pilot of a vehicle in flight should do as long as nothing warns.

        The first of these conditions that applies decides:

        1. The vehicle lands by itself: to let it land.
        2. Whether it oscillates, or a motor loses thrust, is not watched yet: to hover until then.
        3. Nothing measures some of what is watched: to fly on only if the pilot can do without it. This comes before
           what a model needs, and stays while the model is learned.
        4. A model was judged, or there is none for a reason without a remedy: to fly on.
        5. Too few messages come: to fly on, and to start mavdem again after the landing, with a request for more.
        6. Otherwise: what has to happen before a model can be learned.

        Args:
            step_to_model: what has to happen before a model can be learned.
        """
        if self.lands_by_itself:
            return Fact(NextStep.LET_LAND, reason=None)
        if self.should_hover_first:
            return Fact(NextStep.HOVER_FIRST, reason=None, awaits_motors=self.lacks_motor_reference)
        reason = self._reason_without_model
        needs_nothing = self.model_judgement is not None or not reason.remedy
        has_too_few_messages = not needs_nothing and reason.code in TOO_FEW_MESSAGES
        step_on_ground = step_to_model if has_too_few_messages else None
        unmeasured = self._unmeasured_quantities
        if unmeasured or needs_nothing or has_too_few_messages:
            return Fact(NextStep.FLY_ON, reason=step_on_ground, unmeasured=unmeasured)
        return step_to_model

    def _step_until_landing(self, warning: Fact) -> NextStep:
        """Returns whether a pilot should land soon, hover or fly on with a fault that is repaired after the landing.

        Args:
            warning: the fault, whose level is watch or bad.
        """
        if self.lands_by_itself:
            return NextStep.LET_LAND
        has_torque_changed = warning.code is MotorWatchFact.STEADY_TORQUE_CHANGED
        # A motor that probably lost thrust may lose more of it.
        is_motor_suspected = has_torque_changed and "suspect" in warning.figures
        if warning.is_bad or is_motor_suspected:
            return NextStep.LAND_SOON
        if self.should_hover_first:
            return NextStep.HOVER_FIRST
        return NextStep.FLY_ON

    @property
    def _is_landing(self) -> bool:
        """Whether the vehicle lands by itself here and now, as the mode "land" shows; a return lands elsewhere."""
        return self.lands_by_itself and self.state is not None and self.state.mode.lower() == "land"

    @property
    def lands_by_itself(self) -> bool:
        """Whether the autopilot lands the vehicle now, as its mode shows."""
        return self.state is not None and self.state.lands_by_itself

    @property
    def should_hover_first(self) -> bool:
        """Whether the vehicle should hover now, since an oscillation or a loss of thrust would not be noticed yet."""
        return self.is_oscillation_unjudged or self.lacks_motor_reference

    @property
    def lacks_motor_reference(self) -> bool:
        """Whether the vehicle has hovered for too short a time to notice a weak motor.

        A weak motor shows by its commands, compared with those of some earlier seconds of hover. Only one
        wait is shown at a time: while ``is_oscillation_unjudged``, this is False.
        """
        watch_fact = self._watch_states.get(WatchedQuantity.MOTORS)
        if watch_fact is None or not self.is_flying or self.is_oscillation_unjudged:
            return False
        reason = watch_fact.figures.get("reason")
        return reason is not None and reason.code is WatchFact.REFERENCE_SHORT

    @property
    def is_oscillation_unjudged(self) -> bool:
        """Whether the vehicle has flown for too short a time to judge whether it oscillates."""
        watch_fact = self._watch_states.get(WatchedQuantity.OSCILLATION)
        if watch_fact is None or not self.is_flying:
            return False
        reason = watch_fact.figures.get("reason")
        # At the take-off the list of what is watched may still be that of the ground.
        return reason is not None and reason.code in (
            WatchFact.OSCILLATION_AWAITED,
            WatchFact.ON_GROUND_NOW,
        )

    @property
    def _warning_of_delay(self) -> Fact:
        """The fact by how many seconds this computer analyses messages late; bad from ``LONG_LOSS_SECONDS`` on."""
        is_very_late = self.alarm_delay >= LONG_LOSS_SECONDS
        level = Level.BAD if is_very_late else Level.WATCH
        return Fact(SessionFact.ESTIMATES_LATE, level, delay=self.alarm_delay)

    @property
    def _watch_states(self) -> dict[str, Fact]:
        """For each watched quantity of the followed vehicle: since when it is watched for faults, or why it is not.

        A key is the name of a quantity, such as "vibration". ``watch_facts`` also has facts on other vehicles of the
        link; these have the figure "vehicle", and are left out.
        """
        return {fact.subject: fact for fact in self.watch_facts if "vehicle" not in fact.figures}

    @property
    def _unmeasured_quantities(self) -> tuple[str, ...]:
        """Names of the quantities with a light that nothing measures, such as "vibration" where no VIBRATION comes."""
        names = []
        for quantity in QUANTITIES_OF_SETTLED_FLIGHT.values():
            watch_fact = self._watch_states.get(quantity)
            reason = None if watch_fact is None else watch_fact.figures.get("reason")
            if reason is None:
                continue
            is_not_judged = reason.code is WatchFact.BATTERY_NOT_JUDGED
            if is_not_judged or _states_missing_message(reason):
                names.append(str(quantity))
        return tuple(names)

    @property
    def _watched_names(self) -> tuple[str, ...]:
        """Names of the quantities of the followed vehicle, such as "vibration", that are watched for faults now."""
        facts = self._watch_states
        return tuple(name for name, fact in facts.items() if fact.code is WatchFact.WATCHED)

    @property
    def _weak_motors(self) -> list[Fact]:
        """The losses of thrust of motors in the latest flight, the worst first, as facts with their newest figures."""
        return thrust_losses(self.motor_alarms_of_flight)

    @property
    def _lights_by_checks(self) -> dict[str, Fact]:
        """The lights by the checks that need no learned model, by the part of the vehicle that each judges.

        A light is the judgement of one part: the worst fact (coded finding) about it, of equally bad ones the first. A
        part about which nothing is known has no light. The watchdog, which looks for faults twice a second, finds facts
        about all parts. There are other facts about three of them:

        - motors: losses of thrust, which come first, and lasting shifts of the trims;
        - margins: those identified in flight, until the recording is judged, which has better ones;
        - wind: the mean wind of the flight.
        """
        facts_by_part: dict[str, list[Fact]] = defaultdict(list)
        facts_by_part[Light.MOTORS] += self._weak_motors
        facts_by_part[Light.MOTORS] += torque_changes(self.motor_alarms_of_flight)
        for part, worst_fact_of_watchdog in self.worst_lights.items():
            facts_by_part[part].append(worst_fact_of_watchdog)
        if self.margins is not None and not self.is_recording_judged:
            facts_by_part[Light.MARGINS].append(self.margins)
        if self.mean_wind is not None:
            facts_by_part[Light.WIND].append(self._light_of_mean_wind(self.mean_wind))
        return {part: worst_fact(facts) for part, facts in facts_by_part.items() if facts}

    def _light_of_mean_wind(self, mean_wind: WindEstimate) -> Fact:
        """Returns the light of the wind: the fact (a coded finding) that judges the mean wind, and states one wind.

        In flight it states the present wind, as the map and the table of lights do, and later the mean.

        Args:
            mean_wind: mean wind of the flight so far, with the time of its last estimate.

        Returns:
            The fact. If the present wind is known, it has the figure ``present_wind``, the facts on that. If the wind
            cannot be estimated any more, it has the figures ``known_until``, the time of the last estimate, and
            ``obstacle``, the reason; its sentence then ends with "not known since …".
        """
        if self.present_wind is not None:
            return mean_wind.light.replace(present_wind=self.present_wind.facts)
        if self.no_wind_reason is None:
            return mean_wind.light
        return mean_wind.light.replace(known_until=mean_wind.time, obstacle=self.no_wind_reason)

    @property
    def _is_vehicle_received(self) -> bool:
        """Whether messages of the followed vehicle come now, so that the lights that need no model are up to date.

        If they do not come, that is why no model is learned. Other reasons for that, such as too low rates of messages
        or a vehicle on the ground, follow from messages that come.
        """
        reason = self.no_model_reason
        return reason is None or reason.code not in NOT_RECEIVED_CODES

    @property
    def is_switched_off(self) -> bool:
        """Whether the vehicle seems to be switched off: it has flown and landed in this session, and sends nothing."""
        reason = self.no_model_reason
        is_silent = (
            reason is not None
            and reason.code is RowsFact.NOTHING_RECEIVED
            and reason.subject == MissingMessages.MESSAGES
        )
        return is_silent and self.is_after_flight and self.has_landed

    @property
    def _is_silent_after_flight(self) -> bool:
        """Whether nothing has been received since the end of a flight, as if the vehicle was switched off."""
        is_silent = self.no_model_reason is not None and self.no_model_reason.code in SILENT_LINK
        return is_silent and not self.is_flying and bool(self.worst_lights)

    @property
    def _reason_without_model(self) -> Fact:
        """The fact that says why no model has been judged yet.

        The first of these that applies:

        1. After a flight, its rates were too low to learn from: the pilot can change them for the next flight.
        2. Nothing is received since the end of a flight: the flight is over.
        3. The reason that the session has for learning no model, such as a loss of the vehicle.
        4. In flight, a model is being learned; on the ground, the vehicle does not fly.
        """
        reason = self.no_model_reason
        is_flight_over = self._is_silent_after_flight or (
            reason is not None and reason.code is SessionFact.FLIGHT_OVER
        )
        # Why less was learned of the flight than could be; None if nothing was missing.
        shortfall = self.shortfall
        if is_flight_over and shortfall is not None:
            had_low_rates = shortfall.code is RowsFact.LIVE_RATES_TOO_LOW
            if had_low_rates:
                return shortfall
        if self._is_silent_after_flight:
            # The vehicle was switched off. The flight did not end with its loss, which would be the figure "reason".
            return Fact(SessionFact.FLIGHT_OVER, reason=None)
        if reason is not None:
            return reason
        return Fact(SessionFact.BEING_LEARNED if self.is_flying else SessionFact.NOT_FLYING)

    @property
    def is_silent(self) -> bool:
        """Whether the followed vehicle has sent nothing for ``SILENCE_SECONDS``, or nothing yet."""
        return self.message_age is None or self.message_age >= SILENCE_SECONDS

    @property
    def is_late(self) -> bool:
        """Whether what arrives is analysed so late that the state of a flying vehicle is not known."""
        return self.analysis_delay >= MAX_ALARM_DELAY

    @property
    def are_alarms_late(self) -> bool:
        """Whether a pilot must not rely on the alarms: they come late now, or came late in the last seconds of flight.

        So the advice in flight does not change each time that the analysis catches up for a moment.
        """
        return self.is_late or (self.held_alarm_delay > 0.0 and self.is_in_flight)

    @property
    def alarm_delay(self) -> float:
        """By how much alarms come late, s: the present delay of the analysis or, if longer, the one that is held."""
        return max(self.analysis_delay, self.held_alarm_delay)

    @property
    def present_wind(self) -> WindEstimate | None:
        """The wind now, m/s; None on the ground, in a silence, if this computer is late, and after the session."""
        is_received = self._is_vehicle_received and not self.is_silent
        is_known = self.is_in_flight and is_received and not self.are_alarms_late
        return self.wind if is_known else None

    @property
    def row_rate(self) -> float:
        """Rate at which samples of attitude and motor outputs can be made, Hz: the rate of the slower of the two.

        If several messages bring the attitude, or the motor outputs, the fastest one counts. If only one of the two
        comes, its rate is returned, and 0 if neither does.
        """
        received_rates = [rate for rate in fastest_rates(self.rates) if rate]
        return min(received_rates, default=0.0)

    @property
    def delay_fact(self) -> Fact | None:
        """By how much rows and alarms come late; None while a pilot may rely on them."""
        if not self.are_alarms_late:
            return None
        return Fact(SessionFact.ESTIMATES_LATE, delay=self.alarm_delay)

    def with_predictions(self, estimate: Estimate) -> SessionStatus:
        """Returns a copy of the status with ``prediction_band`` and ``useful_horizon`` filled in.

        Args:
            estimate: the learner's latest estimate. It predicts m outputs, first the angle, at K horizons, with half
                widths of their bands (K, m), and ratios of their squared errors to those of a baseline (K, m).
        """
        horizons = estimate.ahead_times - estimate.time
        # Horizons are whole steps, so that the one nearest to ``REPORTED_HORIZON`` is reported.
        reported_index = np.abs(horizons - REPORTED_HORIZON).argmin()
        # Output 0 is the angle.
        band_of_angle = estimate.ahead_band[reported_index, 0]
        prediction_band = PredictionBand(horizons[reported_index], band_of_angle)
        useful_horizon = self.useful_horizon
        useful_index = estimate.longest_useful_horizon
        if useful_index is not None:
            mean_error_ratio = estimate.ahead_ratio[useful_index].mean()
            useful_horizon = UsefulHorizon(horizons[useful_index], mean_error_ratio)
        return replace(self, prediction_band=prediction_band, useful_horizon=useful_horizon)


def _is_worse_for_take_off(earlier_fault: Fact, headline: Fact) -> bool:
    """Returns whether a fault of an earlier flight matters more before a take-off than the headline so far.

    A fault that forbids to fly comes before all others. Of two faults that are alike in this, the headline stays.

    Args:
        earlier_fault: the fault of the earlier flight.
        headline: headline of the latest flight.
    """
    if earlier_fault.forbids_flight:
        return not (headline.is_bad and headline.forbids_flight)
    return not headline.is_bad


def are_most_rows_postponed(postponed_rows: int, learned_rows: int) -> bool:
    """Returns whether this computer was too slow for a flight: it had no time to learn from most of its samples.

    Args:
        postponed_rows: number of samples of free flight, settled or climbing, for which it had no time.
        learned_rows: number of samples that it learned from.
    """
    return postponed_rows > learned_rows


def cause_of_alarm(fact: Fact) -> Fact:
    """Returns the fact that is the cause of an alarm, such as a weak motor; any other fact is returned as it is.

    Args:
        fact: an alarm, the end of one, a link that was lost after one, or another fact.
    """
    if fact.code in (SessionFact.ALARM, WatchFact.ALARM_OVER):
        reason: Fact = fact.figures["reason"]
        return reason
    if fact.code is LinkFact.LOST_IN_FLIGHT and fact.figures["cause"] is not None:
        return cause_of_alarm(fact.figures["cause"])
    return fact


def _is_unknown_without_message(light: Fact) -> bool:
    """Returns whether a part of the vehicle is not judged because the message that shows it does not come.

    Args:
        light: the judgement of the part, such as the estimator.
    """
    reason = light.figures.get("reason")
    is_not_judged = light.code is Unjudged.NOT_JUDGED
    return is_not_judged and isinstance(reason, Fact) and _states_missing_message(reason)


def _states_missing_message(reason: Fact) -> bool:
    """Returns whether a reason says that a message does not come at all, and not that its rate is too low."""
    return reason.code is WatchFact.MESSAGE_MISSING and reason.figures["rate"] is None


def _is_event(fact: Fact) -> bool:
    """Returns whether a fact is an event: a loss or fall of the vehicle, or what its motion or its autopilot shows.

    Args:
        fact: any fact. The end of an alarm counts as an event if the alarm was about one.
    """
    code = fact.code
    if code is WatchFact.ALARM_OVER:
        code = fact.figures["reason"].code
    return code in FALLS or isinstance(code, (Ending, MotionEvent, ReportedEvent))


def _judgement_with_outage(judgement: Judgement, outage: float) -> Judgement:
    """Adds to the judgement of a flight that is over that the link was lost for a while in flight.

    The light of the log warns of it. Where nothing else is wrong, the headline states it and warns, too, and the next
    step is what to do about the link. A fault of the vehicle keeps headline and next step.

    Args:
        judgement: judgement of the flight by this session, or by its recording.
        outage: longest time without messages in the flight, s.
    """
    lost_link = Fact(LinkFact.WAS_LOST_IN_FLIGHT, Level.WATCH, duration=outage)
    lights = dict(judgement.lights)
    if not lights[Light.LOG].is_watch_or_bad:
        lights[Light.LOG] = lost_link
    headline = headline_with_outage(judgement.headline, outage)
    if headline == judgement.headline:
        return replace(judgement, lights=lights)
    next_step = Fact(NextStep.DO_AS_ADVISED, reason=lost_link)
    return replace(judgement, headline=headline, next_step=next_step, lights=lights)


def headline_with_outage(headline: Fact, outage: float) -> Fact:
    """Adds to a verdict without a fault of the vehicle that the link was lost for a while in flight, and makes it warn.

    Args:
        headline: headline of a flight that is over, such as the verdict of its recording. One that states a fault, or
            no verdict, is returned as it is.
        outage: longest time without messages in the flight, s.
    """
    states_no_fault = headline.code in VERDICTS_ON_FLIGHT and not headline.is_watch_or_bad
    if not states_no_fault:
        return headline
    # A verdict that too little was checked stays unknown.
    level = Level.WATCH if headline.is_good else headline.level
    headline = headline.replace(level, outage=outage)
    if headline.code is SessionFact.RECORDING_JUDGED:
        # The library's next step, such as to keep the log, is not what matters most.
        lost_link = Fact(LinkFact.WAS_LOST_IN_FLIGHT, duration=outage)
        return headline.replace(next_step=lost_link.remedy)
    return headline


def verdict_after_requests(recording_verdict: Fact, absent_messages: frozenset[str]) -> Fact:
    """Replaces the advice of a recording's verdict to request a message that was requested and did not come.

    A recording does not show which messages were requested. The advice becomes that of the light of a session: to look
    into the autopilot's own log.

    Args:
        recording_verdict: what the recording of a flight shows; its figure ``next_step`` is the advice.
        absent_messages: names of the messages that were requested in vain, such as "VIBRATION".

    Returns:
        The verdict with the other advice; unchanged if it advises something else.
    """
    for code, message in REQUESTED_MESSAGES.items():
        # The library stores sentences, and no codes: advice to request this message is recognised by its text.
        not_received = Fact(code, recorder="", asked=False, axis="")
        if message in absent_messages and recording_verdict.remedy == not_received.remedy:
            return recording_verdict.replace(next_step=not_received.replace(is_asked=True).remedy)
    return recording_verdict


def _light_after_recording(recorded_light: Fact, light_in_flight: Fact) -> Fact:
    """Returns the final judgement of one part of the vehicle, such as the motors, after the recording was judged.

    Args:
        recorded_light: the judgement of this part by the recording, which has all that was received.
        light_in_flight: the judgement of this part by the checks in flight.

    Returns:
        The judgement by the recording. If that is unknown, a bad judgement in flight stays, so that its fault is not
        forgotten. A good one becomes ``GOOD_IN_FLIGHT_ALONE``: an unknown light that states what was good in flight,
        and what the recording lacks.
    """
    if recorded_light.level is not Level.UNKNOWN:
        return recorded_light
    if light_in_flight.is_bad:
        return light_in_flight
    if light_in_flight.is_good:
        return Fact(
            SessionFact.GOOD_IN_FLIGHT_ALONE, in_flight=light_in_flight, reason=recorded_light
        )
    return recorded_light


def _lights_of_recording(lights_in_flight: NamedFacts, recording_verdict: Fact) -> dict[str, Fact]:
    """Returns the final judgement of each part of the vehicle, after the recording of its flight was judged.

    The judgement by the recording takes the place of that in flight, even one of the same level, so that all figures on
    the page are those of the recording. For what it leaves unknown see :func:`_light_after_recording`.

    Args:
        lights_in_flight: the judgement of each part by the session, by the name of the part.
        recording_verdict: the library's judgement of the recording.
    """
    lights = {}
    for part, light_in_flight in lights_in_flight.items():
        recorded_light = _light_in_verdict(part, recording_verdict)
        if recorded_light is None:
            lights[part] = light_in_flight
            continue
        has_same_level = recorded_light.level == light_in_flight.level
        if has_same_level and not recorded_light.figures["statement"]:
            # The light in flight has figures, and so says more than the same level without a sentence.
            lights[part] = light_in_flight
        else:
            lights[part] = _light_after_recording(recorded_light, light_in_flight)
    return lights


def _light_in_verdict(part: str, recording_verdict: Fact) -> Fact | None:
    """Returns how the verdict on a recording judges one part of the vehicle, such as its motors; None if it does not.

    Args:
        part: name of the part.
        recording_verdict: the library's judgement of the recording. By the name of the part, its figures have the
            level, empty if that is not judged; a sentence; and a short figure such as "14.9 V". Libraries of earlier
            versions have neither sentence nor figure.
    """
    verdict_figures = recording_verdict.figures
    level = verdict_figures["levels"][part]
    if not level:
        return None
    return Fact(
        SessionFact.LIGHT_OF_RECORDING,
        Level(level),
        statement=verdict_figures["light_sentences"].get(part, ""),
        figure=verdict_figures.get("light_figures", {}).get(part, ""),
    )


def _verdict_by_shown_lights(recording_verdict: Fact, lights: NamedFacts) -> Fact:
    """Makes the verdict on a recording agree with the lights (judgements of motors, power, …) shown beside it.

    The recording may show no fault and leave a part unknown that was bad in flight, and whose light stays bad. A
    verdict without a fault would contradict that light.

    Args:
        recording_verdict: the library's judgement of the recording, with the level of each part as ``levels``.
        lights: the lights by the recording, or a bad one in flight where the recording leaves a part unknown.

    Returns:
        The verdict, which states the worst of these lights as its figure ``shown``, and has its level. It is unchanged
        if it states a fault, or if each light has the level that the recording gives it.
    """
    levels: Mapping[str, str] = recording_verdict.figures["levels"]
    vehicle_lights = {part: lights[part] for part in VEHICLE_LIGHTS}
    has_other_level = any(
        light.level != (levels[part] or Level.UNKNOWN) for part, light in vehicle_lights.items()
    )
    if recording_verdict.is_watch_or_bad or not has_other_level:
        return recording_verdict
    bad_lights = [light for light in vehicle_lights.values() if light.is_bad]
    headline = bad_lights[0] if bad_lights else headline_by_lights(lights)
    return recording_verdict.replace(headline.level, shown=headline)


def _judgement_with_bad_lights(judgement: Judgement) -> Judgement:
    """Returns a judgement whose headline states the most important bad fault of the vehicle.

    An event, such as a loss of control, comes before what causes it, such as vibration; then an oscillation, since it
    drives the motors to their limits. Of other faults the headline's comes first, and then that of the first bad light.

    Args:
        judgement: headline, next step, and for each part of the vehicle a light, which judges it; at least one is bad.
    """
    faults = [fact for fact in (judgement.headline, *judgement.lights.values()) if fact.is_bad]
    events = [fault for fault in faults if _is_event(fault)]
    oscillations = [fault for fault in faults if fault.code is MarginsLight.OSCILLATES]
    most_important_fault = (events or oscillations or faults)[0]
    if most_important_fault == judgement.headline:
        return judgement
    return _judgement_from_headline(most_important_fault, judgement.lights)


def _judgement_with_summary_of_lights(judgement: Judgement) -> Judgement:
    """Replaces the headline of a judgement by one that sums up its lights: the worst of them, or that all are good.

    A headline that warns brings its own next step, unlike any other: then the next step of the judgement stays, such as
    to fly until a model is learned.

    Args:
        judgement: headline, next step (what the pilot should do), and lights: the judgement of each part of the vehicle
            as a fact with a level.
    """
    headline = headline_by_lights(judgement.lights)
    if headline.is_watch_or_bad:
        return _judgement_from_headline(headline, judgement.lights)
    return replace(judgement, headline=headline)


def _judgement_from_headline(headline: Fact, lights: NamedFacts) -> Judgement:
    """Returns a judgement with a headline and the next step that follows from it.

    Args:
        headline: the fact that matters most.
        lights: the fact on each part of the vehicle, by the name of the part.
    """
    return Judgement(headline, choose_next_step(headline, lights), lights)


def _judgement_of_lost_link(link_loss: Fact, lights: NamedFacts) -> Judgement:
    """Returns the judgement after a session whose link was lost in flight.

    Its next step is to search for the vehicle, and to repair the fault that was found before the loss, if any.

    Args:
        link_loss: the fact that the link was lost, with the fault that was found before as its ``cause``; None there
            for none.
        lights: the fact on each part of the vehicle, by the name of the part.
    """
    judgement = _judgement_from_headline(link_loss, lights)
    # It is the loss of the link itself if no fault was found before.
    fault_before = cause_of_alarm(link_loss)
    search = judgement.next_step
    is_repair_advised = fault_before in search.figures["also"]
    if fault_before == link_loss or is_repair_advised:
        return judgement
    search_and_repair = search.replace(reason=link_loss.replace(repair=fault_before))
    return replace(judgement, next_step=search_and_repair)
