"""Event: a fact of a flight, at the time when it became known."""

from math import isfinite, nan
from typing import NamedTuple

from mavdem.facts.fact import Code, Fact
from mavdem.facts.loops import GainFact, LoopAction
from mavdem.facts.margins import MarginsLight
from mavdem.facts.online import OnlineFact
from mavdem.facts.session import RateFact, RowsFact, SessionFact, VehicleFact

LEARNING_STATES: frozenset[Code] = frozenset(
    {
        SessionFact.NOT_SETTLED,
        SessionFact.BEING_LEARNED,
        OnlineFact.TOO_FEW_SAMPLES_YET,
        OnlineFact.FIRST_LEARNING,
    }
)
"""States of the learning of a live session that come and go with the flight."""

SESSION_STATES: frozenset[Code] = LEARNING_STATES | {
    GainFact.ADVICE_WAITS,
    SessionFact.COMPUTER_BEHIND,
    SessionFact.COMPUTER_KEEPS_UP,
    SessionFact.ESTIMATES_LATE,
    SessionFact.FIT_UNFINISHED,
    SessionFact.FLIGHT_OVER,
    SessionFact.FORMER_MODEL_KEPT,
    SessionFact.NOT_FLYING,
    SessionFact.NOT_LEARNED_IN_TIME,
    SessionFact.PRIOR_NOT_USED,
    SessionFact.ROW_NOT_DRAWN,
    SessionFact.SAMPLE_SKIPPED,
    SessionFact.SETTLED_TOO_SHORT,
    RowsFact.ATTITUDE_ASKED,
    RowsFact.INPUTS_CHANGED,
    RowsFact.LIVE_RATES_ENOUGH,
    RowsFact.LIVE_RATES_TOO_LOW,
    RowsFact.MESSAGE_GAP,
    RowsFact.MOTORS_NOT_KNOWN,
    RowsFact.MOTOR_ORDER_ASSUMED,
    RowsFact.MOTOR_ORDER_KNOWN,
    RowsFact.RATES_BEING_MEASURED,
    RowsFact.RATE_CHANGED,
    RowsFact.ROWS_BEGIN,
    RateFact.MESSAGE_ABSENT,
    RateFact.RATES_ASKED_AGAIN,
    RateFact.RATES_CONTESTED,
    RateFact.RATES_NOT_RESTORED,
    RateFact.RATE_BELOW_ASKED,
    RateFact.RATE_FELL,
    RateFact.RATE_REFUSED,
    RateFact.VEHICLE_CLOCK_SLOW,
    VehicleFact.CLOCK_JUMPED,
    VehicleFact.NO_VEHICLE_YET,
}
"""States of a live session itself: what it learns, how fast messages come, and whether this computer keeps up."""


FAULTS_SINCE_TAKE_OFF: frozenset[Code] = frozenset(
    {MarginsLight.LOOP_MARGINS, LoopAction.LOOPS_JUDGED}
)
"""Judgements of the control loops: small margins are there from the take-off on, and need no haste."""


RESULTS_OF_ENDED_FLIGHT: frozenset[Code] = frozenset({SessionFact.RECORDING_JUDGED})
"""Judgements of a flight that is over: what was urgent in it was an alarm then."""


class Event(NamedTuple):
    """What happened.

    Attributes:
        seconds: UNIX s of the bytes that caused it for a stream, s of the vehicle's clock in a history.
        fact: what it was; its time is on the clock of its boot.
        start_time: when what a history's fact is about began, s of the same clock as ``seconds``; otherwise NaN.
        reception: UNIX s when a live session reported it; NaN of an event in a log.
        clock: the vehicle's own boot clock then, s; NaN where that was not known, or in a log.
        boot: number of that boot, from 0.
    """

    seconds: float
    fact: Fact
    start_time: float = nan
    reception: float = nan
    clock: float = nan
    boot: int = 0

    @property
    def sentence(self) -> str:
        """What happened, and what to do about it."""
        return self.fact.sentence_and_remedy

    @property
    def has_time(self) -> bool:
        """Whether its time is known: what was so before the record has no finite one."""
        return isfinite(self.seconds)

    @property
    def is_alarm(self) -> bool:
        """Whether it is bad, arose in flight, and is reported while that goes on."""
        return self.fact.is_bad and self.fact.code not in (
            FAULTS_SINCE_TAKE_OFF | RESULTS_OF_ENDED_FLIGHT
        )

    @property
    def is_session_state(self) -> bool:
        """Whether it is a state of a live session itself, and neither about the vehicle nor a result of the flight."""
        return self.fact.code in SESSION_STATES
