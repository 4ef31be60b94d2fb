"""Evidence: what lights and headline of one vehicle are judged by, read from the log once."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from mavdem.alignment.learnability import Learnability
from mavdem.alignment.signals import Signals
from mavdem.condition.condition import Condition
from mavdem.condition.loop.loop import Loop
from mavdem.condition.wind_of_log import Air
from mavdem.facts import Fact
from mavdem.facts.lights import Unjudged
from mavdem.health.in_flight import MotorAlarm
from mavdem.ingest import Log


@dataclass(frozen=True, eq=False)
class Evidence:
    """What a log says of one vehicle before it is judged.

    Attributes:
        log, signals: the log, and the signals of the vehicle, about roll.
        verdict: whether a full model of roll can be learned.
        condition: balance, limits, lean, vibration and battery.
        alarms: lasting changes of the motors' balance in flight.
        air: the wind in m/s, or why it is not known.
        events: what happened, in order of boot and time.
        ending: how a flight that was lost was lost, and what failed first; None where none was.
        loops: the control loops of each axis, or why they are not known.
    """

    log: Log
    signals: Signals
    verdict: Learnability
    condition: Condition
    alarms: tuple[MotorAlarm, ...] = ()
    air: Air = (None, None, Fact(Unjudged.NOT_JUDGED, because=None))
    events: tuple[Fact, ...] = ()
    ending: Fact | None = None
    loops: Mapping[str, Loop | Fact] = field(default_factory=dict)
