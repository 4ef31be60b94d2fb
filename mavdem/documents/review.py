"""The review of a log: keys, units and meanings of documents."""

from __future__ import annotations

from typing import Any

from mavdem.assessment import Assessment
from mavdem.assessment.assess import NoLoop
from mavdem.assessment.margins import margins_of
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
    """largest gain from setpoint to rate or, without a setpoint, of the spectrum over what surrounds it"""
    frequency: Hertz
    """where that is"""
    coherence: Number
    """there, of the rate with its setpoint or with the motors"""


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
    simulated: OneFact
    """that the flight was simulated; null where nothing in the log shows it"""
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
        "simulated": assessment.simulated,
        "identity": analysis and analysis.identity,
        "condition": analysis and analysis.condition,
        "axes": axes_of(assessment),
        "wind": wind,
        "model": None if assessment.model is None else report_of(assessment),
        "spectra": assessment.spectra,
        "files": {},
    }


def axes_of(assessment: Assessment) -> dict[str, Any]:
    """Returns what is known of each axis."""
    margins = () if assessment.evidence is None else margins_of(assessment.evidence)
    resonances = {one.axis: one.response or one.peak for one in margins}
    axes = {}
    for axis, loop in assessment.loops.items():
        known: dict[str, Any] = {"loop": None, "refusal": None, "step_response": None}
        if isinstance(loop, NoLoop):
            known["refusal"] = loop.refusal
        else:
            known |= {"loop": loop, "step_response": loop.measured}
        axes[axis] = known | {"resonance": resonances.get(axis)}
    return axes
