"""Models of the JSON document of ``mavdem info``: what a log holds, its vehicles, and whether models can be learned."""

from __future__ import annotations

from mavdem.assessment import Assessment
from mavdem.assessment.axis import LogAnalysis
from mavdem.containers import JsonValues
from mavdem.documents.document import Document, SentenceText
from mavdem.documents.vehicle import (
    BootTrust,
    Condition,
    Findings,
    Identity,
    Instance,
    LongSegment,
    MotorHealth,
    Tier,
    Verdict,
    trust_documents,
)
from mavdem.documents.wind import WindVelocity, reported_wind
from mavdem.motors.motor_changes import alarm_figures
from mavdem.units import Hertz, Number, Seconds, UnixSeconds


class Unread(Document):
    """Frames of one message of one component that could not be decoded."""

    message_id: int
    """MAVLink id of the message"""
    system: int
    """MAVLink id"""
    component: int
    """MAVLink id"""
    frames: int
    """number of frames that cannot be read"""
    of: int
    """number of all frames of this id"""
    cause: str
    """another dialect or damage"""


class Speaker(Document):
    """A component that sent messages."""

    system: int
    """MAVLink id"""
    component: int
    """MAVLink id"""
    kind: str
    """MAV_TYPE"""
    messages: int
    """number of messages"""
    lost: int
    """number of lost messages, by gaps in the sequence numbers"""
    lost_share: float
    """share of the sequence numbers that do not occur"""
    missing_share: Number
    """share of the messages that its streams lack, by their usual step"""


class Stream(Document):
    """Messages of one name."""

    count: int
    """number of messages"""
    rate: Hertz
    """mean rate without pauses"""


class AutopilotAlarm(Document):
    """A warning of the autopilot itself (STATUSTEXT)."""

    severity: str
    """emergency, alert, critical, error or warning"""
    text: str
    """the text as sent"""
    time: Seconds
    """time of the first, on the boot clock"""
    boot: int
    """number of the vehicle's boot, from 0"""
    count: int
    """number of times that it was sent"""


class Vehicle(Tier, MotorHealth, Findings):
    """A vehicle of the log."""

    system: int
    """MAVLink id"""
    component: int
    """MAVLink id"""
    vehicle: str
    """MAV_TYPE"""
    autopilot: str
    """MAV_AUTOPILOT"""
    translated_from: str
    """format of the log, where it is not MAVLink; else empty"""
    names: dict[str, str]
    """the log's own names of messages"""
    parameters: int
    """number of parameters"""
    messages: dict[str, Stream]
    """messages by name"""
    boots: int
    """number of boots"""
    segments: list[LongSegment]
    """segments of settled flight, the longest first"""
    repairs: list[SentenceText]
    """what was put right, one sentence each"""
    verdict: Verdict
    """whether a full model can be learned"""
    identity: Identity
    """which vehicle it is"""
    condition: Condition
    """figures of the vehicle that any rate shows"""
    autopilot_alarms: list[AutopilotAlarm]
    """what the autopilot itself warned of (STATUSTEXT), the worst first"""
    watched: bool
    """whether a motor that weakens would have been seen"""
    model: str | None
    """model that can be learned: full or slow motion"""
    wind_velocity: WindVelocity | None
    """wind in m/s"""
    instances: list[Instance]
    """all of them"""
    trust: list[BootTrust]
    """what can be trusted, by boot"""


class Inventory(Document):
    """`--json` of info."""

    source: str
    """the log"""
    frames: int
    """number of MAVLink frames or messages"""
    bytes_skipped: int
    """bytes that belong to no frame"""
    receive_time: list[UnixSeconds]
    """receive times of the first and the last message"""
    unread: list[Unread]
    """frames that could not be decoded"""
    speakers: list[Speaker]
    """all components that sent something"""
    vehicles: list[Vehicle]
    """the vehicles among them"""
    learnable: bool
    """whether any model can be learned from the log"""


def analysis_document(analysis: LogAnalysis) -> JsonValues:
    """Returns those values of a vehicle in the JSON document of ``mavdem info`` that its analysis gives.

    The other values of the record :class:`Vehicle` are the contents of the log, such as messages and their rates, from
    ``mavdem.assessment.inventory``. The caller merges both.

    Args:
        analysis: analysis of the vehicle on one axis, made without learning a model.

    Returns:
        Values by key of the record: the findings about the flight; changes of the motors ("alarms" and others); which
        model could be learned ("model", None for none); and "watched", whether the log shows enough of the motors that
        the loss of thrust of one of them would have been detected.
    """
    return {
        **analysis.findings._asdict(),
        **alarm_figures(analysis.alarms),
        "model": analysis.model,
        "watched": analysis.motors_are_watched,
    }


def vehicle_document(assessment: Assessment) -> JsonValues:
    """Returns those values of a vehicle in the JSON document of ``mavdem info`` that come from its assessment.

    The caller adds the contents of the log, such as messages and their rates.

    Args:
        assessment: assessment of the vehicle, with an analysis.

    Returns:
        Values by field of the record ``Vehicle``: the values of ``analysis_document``; the judgement of the flight with
        its status lights; the wind; the instances of batteries, sensors and outputs; and which sensors can be trusted.
    """
    assert assessment.analysis is not None
    return {
        **analysis_document(assessment.analysis),
        **assessment.judgement_values,
        "wind_velocity": reported_wind(assessment),
        "instances": assessment.instances,
        "trust": trust_documents(assessment.trust),
    }
