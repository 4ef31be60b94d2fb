"""The review of a log: keys, units and meanings of documents."""

from __future__ import annotations

from typing import Any

from mavdem.assessment import Assessment
from mavdem.assessment.assess import NoLoop
from mavdem.condition.loop.loop import Loop as LoopFigures
from mavdem.documents.document import Document, OneFact, Sentence
from mavdem.documents.flight import Report, report_of
from mavdem.documents.loops import Loop
from mavdem.documents.vehicle import Condition, Identity
from mavdem.documents.wind import WindVelocity
from mavdem.units import Hertz, Number, Seconds


class StepResponse(Document):
    """Response of the rate to a step of its setpoint, as measured in flight."""

    time: list[Seconds]
    """after the step"""
    step: list[Number]
    """rate over setpoint"""


class Resonance(Document):
    """The strongest resonance of the rate."""

    peak: Number
    """largest gain from setpoint to rate"""
    frequency: Hertz
    """where that is"""


class Axis(Document):
    """An axis of the vehicle."""

    loop: Loop | None
    """its control loops; null where they are not known"""
    refusal: OneFact
    """why they are not known"""
    step_response: StepResponse | None
    """measured response of the rate to its setpoint"""
    resonance: Resonance | None
    """the strongest resonance of the rate"""


class Review(Document):
    """`--json` of review, and report.json."""

    source: str
    """the log"""
    headline: Sentence
    """the worst that was found, or how the flight was lost"""
    next_step: Sentence
    """what to do about it"""
    lights: dict[str, Sentence]
    """motors, vibration, tracking, margins, power, estimator, wind and log, each with its level"""
    events: list[Sentence]
    """what happened, in order"""
    identity: Identity | None
    """which vehicle it is; null where none was judged"""
    condition: Condition | None
    """figures of the vehicle that any rate shows"""
    axes: dict[str, Axis]
    """roll, pitch and yaw"""
    wind: WindVelocity | None
    """wind in m/s"""
    model: Report | None
    """what was learned of the roll axis; null where there is no model"""
    spectra: dict[str, Any]
    """spectra of the rates by axis"""
    files: dict[str, str]
    """the files written, by name"""


def review_document(assessment: Assessment) -> dict[str, Any]:
    """Returns the values of the document of an ``assessment``, which has written no files."""
    analysis = assessment.analysis
    wind = assessment.wind and assessment.wind.as_dict()
    return {
        "source": assessment.log.source,
        **assessment.of_documents,
        "identity": analysis and analysis.identity,
        "condition": analysis and analysis.condition,
        "axes": {axis: _axis(loop) for axis, loop in assessment.loops.items()},
        "wind": wind,
        "model": None if assessment.model is None else report_of(assessment),
        "spectra": assessment.spectra,
        "files": {},
    }


def _axis(loop: LoopFigures | NoLoop) -> dict[str, Any]:
    if isinstance(loop, NoLoop):
        return {"loop": None, "refusal": loop.refusal, "step_response": None, "resonance": None}
    return {"loop": loop, "refusal": None, "step_response": loop.measured, "resonance": None}
