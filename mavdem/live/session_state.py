"""What a live session has received and found until one moment: link, alarms, model, wind and flight.

What is found is stated by facts: findings with a code, a level (good, watch, bad, unknown) and figures.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from math import hypot, nan
from typing import NamedTuple, Self

import numpy as np

from mavdem.assessment.axis.findings import Findings
from mavdem.assessment.flight_verdict import FlightVerdict
from mavdem.assessment.judgement import Judgement
from mavdem.containers import Numbers
from mavdem.dataset.phases import TRANSIENT_SECONDS
from mavdem.dem import Estimate
from mavdem.facts import Fact, Facts, Level, NamedFacts
from mavdem.facts.assessment import Headline as HeadlineCode
from mavdem.facts.session import LinkFact, MissingMessages, RowsFact, SessionFact, VehicleFact
from mavdem.facts.watch import WatchedQuantity, WatchFact
from mavdem.immutable import ImmutableResult
from mavdem.live.alarm_delay import MAX_ALARM_DELAY
from mavdem.live.global_position import GlobalPosition
from mavdem.live.history import REPORTED_HORIZON
from mavdem.live.link import SILENCE_SECONDS
from mavdem.live.link_loss import LONG_LOSS_SECONDS
from mavdem.live.live_lights import QUANTITIES_OF_SETTLED_FLIGHT, fastest_rates
from mavdem.live.takeoff_place import Displacement
from mavdem.live.vehicle_state import VehicleState
from mavdem.live.wind import WindEstimate
from mavdem.loops.identification import MIN_IDENTIFIED_SECONDS
from mavdem.motors.motor_changes import MotorChange, thrust_losses

HEADLINES_WITHOUT_ALARM = (HeadlineCode.NOTHING_WRONG, WatchFact.NO_ALARM)
"""Headlines that state that nothing is wrong."""


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


STATES_OF_LEARNING = (
    SessionFact.NOT_SETTLED,
    SessionFact.BEING_LEARNED,
    SessionFact.FLIGHT_OVER,
    SessionFact.NOT_FLYING,
)
"""Reasons for learning no model that say what the session does, and nothing about the vehicle."""


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
class SessionState(ImmutableResult):
    """What a live session has received and found until one moment.

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

    status_before_silence: SessionState | None = None
    """What it was when the last message came, while the vehicle is silent; None while messages and motion come."""

    @property
    def displacement_from_takeoff(self) -> Displacement | None:
        """Distance and height, m, of a flying vehicle from the place of its take-off.

        They are the difference of two estimated positions. If the autopilot has restarted in flight, the take-off has
        no position in the present coordinates: then satellites and barometer give ``displacement``. None if the vehicle
        is not in the air, or if neither is known.
        """
        if not self.is_in_air:
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
        if self.is_in_air and self.displacement_from_home is not None:
            return NamedPlace("home", *self.displacement_from_home)
        return None

    @property
    def is_in_air(self) -> bool:
        """Whether the vehicle is in the air: it counts as flying, and no crash was found.

        The autopilot of a crashed vehicle may still report for some seconds that it flies.
        """
        return self.is_flying and self.ground_contact is None

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

    def end_in_flight(self, cause: Fact | None) -> Fact:
        """Returns the fact that the session ended in flight, so that nobody watches the vehicle any more.

        Args:
            cause: the fault that was found before; None without one.
        """
        delay = self.analysis_delay if self.is_late else None
        return Fact(SessionFact.ENDED_IN_FLIGHT, Level.BAD, cause=cause, delay=delay)

    @property
    def was_long_enough_for_margins(self) -> bool:
        """Whether the latest flight is, or was, settled for as long as a review of the margins needs it.

        Its end, in which the landing is not recognised yet, was counted as settled and does not count here.
        """
        return self.settled_seconds >= MIN_IDENTIFIED_SECONDS + TRANSIENT_SECONDS

    def silence_seconds(self, reason: Fact) -> float | None:
        """Returns how long the missing messages have not come, s; None if that is not known.

        Args:
            reason: the fact that they do not come, whose subject is all messages or those of the motion.
        """
        return self.motion_age if reason.subject == MissingMessages.MOTION else self.message_age

    @property
    def is_landing(self) -> bool:
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
        if not self.is_flying or self.is_oscillation_unjudged:
            return False
        reason = self._reason_for_not_watching(WatchedQuantity.MOTORS)
        return reason is not None and reason.code is WatchFact.REFERENCE_SHORT

    @property
    def is_oscillation_unjudged(self) -> bool:
        """Whether the vehicle has flown for too short a time to judge whether it oscillates."""
        if not self.is_flying:
            return False
        reason = self._reason_for_not_watching(WatchedQuantity.OSCILLATION)
        # At the take-off the list of what is watched may still be that of the ground.
        return reason is not None and reason.code in (
            WatchFact.OSCILLATION_AWAITED,
            WatchFact.ON_GROUND_NOW,
        )

    @property
    def warning_of_delay(self) -> Fact:
        """The fact by how many seconds this computer analyses messages late; bad from ``LONG_LOSS_SECONDS`` on."""
        is_very_late = self.alarm_delay >= LONG_LOSS_SECONDS
        level = Level.BAD if is_very_late else Level.WATCH
        return Fact(SessionFact.ESTIMATES_LATE, level, delay=self.alarm_delay)

    @property
    def watch_states(self) -> dict[str, Fact]:
        """For each watched quantity of the followed vehicle: since when it is watched for faults, or why it is not.

        A key is the name of a quantity, such as "vibration". ``watch_facts`` also has facts on other vehicles of the
        link; these have the figure "vehicle", and are left out.
        """
        return {fact.subject: fact for fact in self.watch_facts if "vehicle" not in fact.figures}

    @property
    def unmeasured_quantities(self) -> tuple[str, ...]:
        """Names of the quantities with a status light that nothing measures on this vehicle.

        One is "vibration" if the message VIBRATION never comes. A quantity whose message comes too slowly, or that is
        not watched yet because the vehicle is on the ground, is not among them.
        """
        unmeasured_names = []
        for quantity in QUANTITIES_OF_SETTLED_FLIGHT.values():
            reason = self._reason_for_not_watching(quantity)
            if reason is None:
                continue
            # The battery's message comes, but no connected sensor measures its voltage.
            is_battery_unknown = reason.code is WatchFact.BATTERY_NOT_JUDGED
            if is_battery_unknown or states_missing_message(reason):
                unmeasured_names.append(str(quantity))
        return tuple(unmeasured_names)

    def _reason_for_not_watching(self, quantity: WatchedQuantity) -> Fact | None:
        """Returns why a quantity of the followed vehicle is not watched for faults; None if it is, or if not known."""
        watch_fact = self.watch_states.get(quantity)
        return None if watch_fact is None else watch_fact.figures.get("reason")

    @property
    def watched_names(self) -> tuple[str, ...]:
        """Names of the quantities of the followed vehicle, such as "vibration", that are watched for faults now."""
        facts = self.watch_states
        return tuple(name for name, fact in facts.items() if fact.code is WatchFact.WATCHED)

    @property
    def weak_motors(self) -> list[Fact]:
        """The losses of thrust of motors in the latest flight, the worst first, as facts with their newest figures."""
        return thrust_losses(self.motor_alarms_of_flight)

    @property
    def is_vehicle_received(self) -> bool:
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
    def is_silent_after_flight(self) -> bool:
        """Whether nothing has been received since the end of a flight, as if the vehicle was switched off."""
        is_silent = self.no_model_reason is not None and self.no_model_reason.code in SILENT_LINK
        # The lights are judged in flight and kept after it, so that there are none before the first flight.
        has_judged_flight = bool(self.worst_lights)
        return is_silent and not self.is_flying and has_judged_flight

    @property
    def reason_without_model(self) -> Fact:
        """The fact that says why no model has been judged yet.

        The first of these that applies:

        1. After a flight, that messages of the flight came too slowly to learn from them: the pilot can raise their
           rates for the next flight.
        2. If nothing has been received since the end of a flight, that the flight is over.
        3. The reason that the session has for learning no model now (``no_model_reason``), such as a lost vehicle.
        4. In flight, that a model is being learned; on the ground, that the vehicle does not fly.
        """
        if self._low_rates_of_ended_flight is not None:
            return self._low_rates_of_ended_flight
        if self.is_silent_after_flight:
            # The vehicle was probably switched off, so that the silence is no fault to be reported. The figure "reason"
            # of this fact is the loss with which a flight ended; this one ended without.
            return Fact(SessionFact.FLIGHT_OVER, reason=None)
        if self.no_model_reason is not None:
            return self.no_model_reason
        return Fact(SessionFact.BEING_LEARNED if self.is_flying else SessionFact.NOT_FLYING)

    @property
    def _low_rates_of_ended_flight(self) -> Fact | None:
        """The fact that messages of the latest flight, which is over, came too slowly to learn from; None otherwise."""
        reason = self.no_model_reason
        ends_learning = reason is not None and reason.code is SessionFact.FLIGHT_OVER
        is_flight_over = ends_learning or self.is_silent_after_flight
        if not is_flight_over or self.shortfall is None:
            return None
        return self.shortfall if self.shortfall.code is RowsFact.LIVE_RATES_TOO_LOW else None

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
        is_received = self.is_vehicle_received and not self.is_silent
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

    def with_predictions(self, estimate: Estimate) -> Self:
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


def are_most_rows_postponed(postponed_rows: int, learned_rows: int) -> bool:
    """Returns whether this computer was too slow for a flight: it had no time to learn from most of its samples.

    Args:
        postponed_rows: number of samples of free flight, settled or climbing, for which it had no time.
        learned_rows: number of samples that it learned from.
    """
    return postponed_rows > learned_rows


def states_missing_message(reason: Fact) -> bool:
    """Returns whether a reason says that a message does not come at all, and not that its rate is too low."""
    return reason.code is WatchFact.MESSAGE_MISSING and reason.figures["rate"] is None
