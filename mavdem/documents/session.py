"""Models of the JSON document of ``mavdem live``, and how it is made at the end of a session."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Self

from pydantic import Field

from mavdem.containers import JsonValues
from mavdem.documents.document import (
    AdviceAndFact,
    Document,
    ModelField,
    Sentence,
    SentenceAndFact,
    SentenceText,
)
from mavdem.documents.vehicle import Finding, MotorHealth, Override
from mavdem.facts.model import ModelName
from mavdem.facts.session import TimeUse
from mavdem.motors.motor_changes import alarm_figures
from mavdem.units import Degrees, Hertz, Number, Seconds, Speed

if TYPE_CHECKING:
    from mavdem.live import SessionStatus
    from mavdem.live.session import LiveSession


class LiveSamples(Document):
    """Numbers of rows of a session."""

    learnt: int
    """number of rows that the learner used"""
    shown: int
    """number of rows that were only shown"""


class Behind(Document):
    """How far the analysis was behind the link."""

    most: Seconds
    """longest delay"""
    datagrams_dropped: int
    """datagrams that this computer dropped"""


class Latency(Document):
    """Time from a packet's arrival to its estimate."""

    median: Seconds
    """median over the last rows"""
    p99: Seconds
    """99th percentile over the last rows"""
    max: Seconds
    """longest of all rows"""


class Ahead(Document):
    """Uncertainty of a prediction."""

    model: ModelField = ModelName.JOINT_VAR
    """model that predicts"""
    seconds: Seconds
    """how far ahead"""
    half_width_rad: Number
    """half width of the angle's 90 % band there, rad"""


class Useful(Document):
    """Longest useful horizon of predictions."""

    model: ModelField = ModelName.JOINT_VAR
    """model that predicts"""
    seconds: Seconds
    """the horizon"""
    error_ratio: Number
    """squared error over that of the better of last sample and mean"""


class LiveWind(Document):
    """Latest wind in m/s."""

    model: ModelField = ModelName.WIND
    """model that it was estimated by"""
    speed: Speed
    """speed"""
    speed_from: Speed
    """lower end of its 90 % interval"""
    speed_to: Speed
    """upper end of its 90 % interval"""
    direction: Degrees
    """where the wind comes from, clockwise from north"""
    direction_interval: Degrees
    """half width of the 90 % interval of direction"""


class Recorded(Document):
    """Telemetry log that was recorded."""

    file: str
    """name of the file"""
    frames: int
    """number of frames"""


class LiveFlight(MotorHealth):
    """Session with one vehicle."""

    link: str
    """as on the command line"""
    vehicle: str | None
    """the vehicle, system:component"""
    seconds: Seconds
    """duration of the session"""
    account: dict[str, Seconds]
    """the same by what the seconds were"""
    samples: LiveSamples
    """number of rows"""
    rates: dict[str, Hertz]
    """rates over the last 2 s, by message"""
    lost: int
    """number of lost messages, by sequence numbers"""
    missing: Seconds
    """duration of gaps whose messages are not in lost"""
    behind: Behind
    """how far the analysis was behind the link"""
    latency: Latency
    """time from a packet's arrival to its estimate"""
    ahead: Ahead
    """band of a prediction"""
    useful: Useful
    """longest useful horizon of predictions"""
    obstacle: AdviceAndFact
    """why there are no rows or no model"""
    watched: list[SentenceAndFact]
    """what is watched without a model since when, or why it is not, one sentence each"""
    gains: list[AdviceAndFact] | None
    """gains advised after a landing, one sentence each; null without --request-rate and --record"""
    wind: LiveWind | None
    """latest wind in m/s"""
    headline: SentenceText | None = None
    """the worst that is found, or why nothing is judged, one sentence; some of the next only after a first model"""
    lights: dict[str, Sentence] | None = None
    """motors, vibration, tracking, margins, power, estimator, wind and log, each with its level"""
    overrides: list[Override] | None = None
    """what makes the flight itself doubtful, the worst first"""
    findings: list[Finding] | None = Field(None, validation_alias="purposes")
    """what the model is good for"""
    warnings: list[SentenceText] | None = None
    """what must be known before the model is used"""
    next_step: SentenceText | None = None
    """what to do next, one sentence"""
    flights: list[SentenceAndFact]
    """verdict on each flight of the session, the worst first, one sentence each"""
    events: list[AdviceAndFact]
    """what was said in flight, one sentence each"""
    rrd: str | None
    """recording for Rerun"""
    record: Recorded | None
    """telemetry log that was recorded"""
    model: str | None
    """file of the model"""
    html: str | None
    """page of the session"""


class Live(LiveFlight):
    """`--json` of live: the session with the vehicle that was followed last."""

    earlier: list[LiveFlight] | None = None
    """sessions with the vehicles that were followed before, the first one first; absent if there was no other"""

    def with_frames(self, count: int) -> Self:
        """Returns the document with another number of recorded frames; the same if there is no recording."""
        if self.record is None:
            return self
        return self.model_copy(update={"record": self.record.model_copy(update={"frames": count})})


WIND_KEYS = ("speed", "speed_from", "speed_to", "direction", "direction_interval")
"""Keys of the wind, in the order in which an estimate of the wind has its figures by the compass."""

SECONDS_DECIMALS = 3
"""Decimals of durations in the document, s."""


def live_document(
    session: LiveSession, status: SessionStatus, account: Mapping[TimeUse, float], files: JsonValues
) -> Live:
    """Makes the JSON document of a live session, after it has ended.

    The keys come from four sources: the judgement of the flight, its findings, the last status, and the figures below,
    which take precedence; see :meth:`Document.from_results`. All durations are in seconds.

    Args:
        session: a session that has ended.
        status: its last status.
        account: seconds of the session, by the activity that took them.
        files: the names of the written files by their keys: ``rrd``, ``record``, ``model`` and ``html``.

    Returns:
        The document.
    """
    wind = None
    if status.wind:
        wind = dict(zip(WIND_KEYS, status.wind.compass, strict=True))
    return Live.from_results(
        # These fill the keys of what was judged, and further ones such as the vehicle and the rates.
        status.session_judgement,
        status.findings or (),
        status,
        **alarm_figures(status.motor_alarms),
        **files,
        link=session.link.name,
        seconds=round(sum(account.values()), SECONDS_DECIMALS),
        account={kind: round(seconds, SECONDS_DECIMALS) for kind, seconds in account.items()},
        samples={"learnt": status.learned_rows, "shown": status.unlearned_rows},
        lost=status.lost_messages,
        watched=status.watch_facts,
        flights=[verdict.fact for verdict in status.verdicts_worst_first],
        missing=round(status.gap_seconds, SECONDS_DECIMALS),
        behind={
            "most": round(session.backlog.longest_delay, SECONDS_DECIMALS),
            "datagrams_dropped": session.link.dropped_datagrams,
        },
        latency=dict(zip(("median", "p99", "max"), status.latency, strict=True)),
        ahead=dict(zip(("seconds", "half_width_rad"), status.prediction_band, strict=True)),
        useful=dict(zip(("seconds", "error_ratio"), status.useful_horizon, strict=True)),
        obstacle=status.no_model_reason,
        gains=None if session.gain_adviser is None else session.gain_adviser.facts,
        wind=wind,
        events=[event.fact for event in session.history.events],
    )
