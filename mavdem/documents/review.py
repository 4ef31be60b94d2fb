"""Models of the JSON document of ``mavdem review``, and how it is made from an assessment."""

from __future__ import annotations

from mavdem.assessment import Assessment
from mavdem.assessment.axis.responses import LoopResponse
from mavdem.assessment.hardware import hardware_facts
from mavdem.containers import JsonValues
from mavdem.dataset.axes import AXES
from mavdem.documents.document import Document, OptionalFact, Sentence, SentenceAndFact
from mavdem.documents.flight import Report, report_document
from mavdem.documents.loops import Loop
from mavdem.documents.vehicle import BootTrust, Condition, Identity, Instance, trust_documents
from mavdem.documents.wind import WindVelocity, reported_wind
from mavdem.facts import Fact, NamedFacts
from mavdem.units import (
    Hertz,
    Number,
    ParameterValue,
    PowerDensityInStatedUnit,
    Seconds,
)
from mavdem.vibration import spectra
from mavdem.vibration.spectral_lines import SpectralLine

ACCELERATION_AXES = ("forward", "right", "down")
"""Names of the axes of an accelerometer's spectrum; those of all other spectra are roll, pitch and yaw."""


class Response(Document):
    """Response of the rate, or the angle, to its setpoint, as measured in flight."""

    time: list[Seconds]
    """after a step of the setpoint of 1"""
    step: list[Number]
    """rate over setpoint, or angle over setpoint"""
    step_half: list[Number]
    """half widths of its 90 % band"""
    predicted_step: list[Number] | None
    """as the identified loop predicts it; null where there is none"""
    frequency: list[Hertz]
    """of the gains"""
    gain: list[Number]
    """from setpoint to rate, or angle"""
    gain_half: list[Number]
    """half widths of their 90 % band"""
    predicted_gain: list[Number] | None
    """as the identified loop predicts them; null where there is none"""
    highest: Hertz
    """frequency up to which the flight shows it"""
    windows: int
    """windows that it was estimated from"""
    is_identified: bool
    """whether the step is that of the identified loop, for a rate too fast for its messages"""
    is_doubtful: bool
    """whether the step is doubtful; the gain is not"""
    overshoot: list[Number]
    """largest step less 1, and the ends of its 90 % interval; likewise of what follows"""
    rise_time: list[Seconds]
    """from 10 to 90 %"""
    settling: list[Seconds]
    """until the step stays within 5 %"""
    delay: list[Seconds]
    """until the step is at one half"""
    peak: list[Number]
    """largest gain"""
    peak_frequency: list[Hertz]
    """of the largest gain"""
    coherence: Number
    """of setpoint and response at that frequency"""


class Responses(Document):
    """The response of one loop to its setpoint, and the facts about it."""

    measured: Response | None
    """null where it is not known"""
    facts: list[Sentence]
    """figures and whether the prediction agrees, or why the response is not known"""


class Resonance(Document):
    """The strongest resonance of the rate."""

    peak: Number
    """largest gain from setpoint to rate or, without a setpoint, of the spectrum over what surrounds it"""
    frequency: Hertz
    """where that is"""
    coherence: Number
    """there, of the rate with its setpoint or with the motors"""
    ms_frequency: Hertz | None
    """where the maximum sensitivity Ms is; null without setpoint"""


class Spectrogram(Document):
    """Power by frequency, over time or over the throttle."""

    time: list[Seconds] | None
    """middles of the windows; null over the throttle"""
    throttle: list[Number]
    """mean output of the motors, 0 to 1; null where it is not known"""
    frequency: list[Hertz]
    """up to the highest"""
    density: list[list[PowerDensityInStatedUnit]]
    """of all axes together, at each time or throttle"""


class Line(Document):
    """A line of a spectrum: a narrow peak, such as of a motor."""

    kind: str
    """motor, frame, alias, oscillation (of the control loops) or unnamed"""
    frequency: Hertz
    """at the median throttle"""
    ratio: Number
    """power over that around it"""
    density: PowerDensityInStatedUnit
    """power of all axes"""
    width: Hertz
    """at half of that"""
    exponent: Number
    """of the throttle, or of the motors' speed, that it follows; null where that is not known"""
    harmonics: list[int]
    """multiples of the frequency at which there are lines too"""
    order: Number
    """frequency over the motors' speed, where that was logged"""


class Spectrum(Document):
    """Power of a gyro, an accelerometer or a demand of the motors, by frequency."""

    unit: str
    """of what was measured"""
    source: str
    """message or topic of the log"""
    highest: Hertz
    """half of the rate of the samples: what is faster is folded below it"""
    windows: int
    """windows that it is the mean of"""
    frequency: list[Hertz]
    """from 0 to the highest"""
    density: dict[str, list[PowerDensityInStatedUnit]]
    """mean power of each axis: roll, pitch and yaw, or forward, right and down"""
    by_time: Spectrogram
    """over time"""
    by_throttle: Spectrogram
    """over the throttle"""
    lines: list[Line]
    """lines, the strongest first"""


class Noise(Document):
    """The facts about the spectra."""

    facts: list[Sentence]
    """lines of the gyro, what the filters take, and the notch filter to set"""


class Axis(Document):
    """An axis of the vehicle."""

    loop: Loop | None
    """its control loops; null where they are not known"""
    refusal: OptionalFact
    """why they are not known"""
    step_response: Response | None
    """measured response of the rate, as in `rate`; null where it is not known"""
    rate: Responses
    """response of the rate to its setpoint"""
    attitude: Responses
    """response of the angle to its setpoint"""
    resonance: Resonance | None
    """the strongest resonance of the rate"""
    tracking: OptionalFact
    """how angle and rate follow their setpoints: RMS errors (rad, rad/s), delay (s), overshoot, reached rate"""
    decision: OptionalFact
    """the fault of its loops, and as remedy what to do about it; null without a flight"""


class ChangedDefault(Document):
    """A parameter whose value is not the default, where the log has defaults."""

    name: str
    """of the parameter"""
    value: ParameterValue
    """at the end of the log"""
    default: ParameterValue
    """of the firmware for this vehicle; of PX4, that of the airframe where the log has it"""


class Review(Document):
    """`--json` of review, and report.json."""

    source: str
    """the log"""
    headline: Sentence
    """the worst that was found, or how the flight was lost"""
    next_step: Sentence
    """what to do about it"""
    flights: list[SentenceAndFact]
    """verdicts on the flights of a recording, the worst first, if the autopilot restarted on the ground between them;
    all else is of the first of these; empty where the log is judged as a whole"""
    vehicles: list[SentenceAndFact]
    """verdicts on the vehicles of a recording that holds several, the worst first; all else is of the first of these;
    empty where the recording holds one, or one was chosen"""
    simulated: OptionalFact
    """that the flight was simulated; null where nothing in the log shows it"""
    lights: dict[str, Sentence]
    """motors, vibration, tracking, margins, power, estimator, wind and log, each with its level"""
    events: list[Sentence]
    """what happened, in order"""
    identity: Identity | None
    """which vehicle it is; null where none was judged"""
    condition: Condition | None
    """figures of the vehicle that any rate shows"""
    instances: list[Instance]
    """all of them"""
    hardware: dict[str, Sentence]
    """what the log shows of each part of the hardware, with its level; a level that is unknown is not judged"""
    trust: list[BootTrust]
    """what can be trusted, by boot"""
    axes: dict[str, Axis]
    """roll, pitch and yaw"""
    wind: WindVelocity | None
    """wind in m/s"""
    model: Report | None
    """what was learned of the roll axis; null where there is no model"""
    spectra: dict[str, Spectrum]
    """gyro and accelerometer, before filters and behind them, demand and D term"""
    noise: Noise
    """what is said of the spectra"""
    changed_defaults: list[ChangedDefault]
    """parameters that are not the default, by name; empty where the log has no defaults"""
    files: dict[str, str]
    """the files written, by name"""


def review_document(assessment: Assessment) -> JsonValues:
    """Returns the values of the document ``Review``: all that ``mavdem review`` found in a log.

    Args:
        assessment: assessment of one vehicle: judgement, control loops, wind, vibration spectra, and a model if one was
            learned.

    Returns:
        Values by key. ``files`` is empty: the caller enters the files that it has written.
    """
    analysis = assessment.analysis
    spectrum_documents = {}
    for name, spectrum in assessment.spectra.items():
        spectrum_documents[name] = _spectrum_document(spectrum, assessment.noise.peaks[name])
    return {
        "source": assessment.log.source,
        **assessment.judgement_values,
        "flights": [verdict.fact for verdict in assessment.flight_verdicts],
        "vehicles": [verdict.fact for verdict in assessment.vehicle_verdicts],
        "simulated": assessment.simulated,
        "identity": None if analysis is None else analysis.identity,
        "condition": None if analysis is None else analysis.condition,
        "instances": assessment.instances,
        "hardware": _hardware_values(assessment),
        "trust": trust_documents(assessment.trust),
        "axes": _axis_values(assessment),
        "wind": reported_wind(assessment),
        "model": None if assessment.model is None else report_document(assessment),
        "spectra": spectrum_documents,
        "noise": {"facts": assessment.noise.facts},
        "changed_defaults": _changed_defaults(assessment),
        "files": {},
    }


def _hardware_values(assessment: Assessment) -> NamedFacts:
    """Returns the facts on each part of the hardware by its name; none if no vehicle was judged."""
    if assessment.evidence is None:
        return {}
    return hardware_facts(assessment.evidence, assessment.lights)


def _changed_defaults(assessment: Assessment) -> list[JsonValues]:
    """Returns the values of the documents ``ChangedDefault`` of the vehicle that was assessed, by name.

    Args:
        assessment: all results on the vehicle: events, status lights, model, loops and wind.
    """
    if assessment.evidence is None:
        return []
    telemetry = assessment.evidence.signals.telemetry
    return [
        {"name": name, "value": telemetry.parameters[name], "default": default}
        for name, default in sorted(telemetry.changed_defaults.items())
    ]


def _axis_values(assessment: Assessment) -> JsonValues:
    """Returns the values of the document ``Axis`` for roll, pitch and yaw: the findings on their control loops.

    A loop with its stability margins is identified by a model of the vehicle; otherwise there is the reason why not, as
    ``refusal``. Responses are measured directly from setpoints and motion, and need no model.

    Args:
        assessment: all results on the vehicle: events, status lights, model, loops and wind.

    Returns:
        Values by the name of the axis and by key.
    """
    resonances = {}
    for margins in assessment.margins:
        # A resonance is found in the response to the setpoint or, without setpoints, as a peak of the spectrum.
        resonances[margins.axis] = margins.response or margins.peak
    values_by_axis = {}
    for axis, loop in assessment.loops.items():
        rate_response = _values_of_response(assessment, axis, "rate")
        decision = assessment.loop_decisions.get(axis)
        values_by_axis[axis] = {
            "loop": None if loop.refusal else loop,
            "refusal": loop.refusal,
            "resonance": resonances.get(axis),
            "tracking": assessment.tracking.get(axis),
            "decision": None if decision is None else decision.fact,
            # An older key of the measured rate response, which is also in "rate".
            "step_response": rate_response["measured"],
            "rate": rate_response,
            "attitude": _values_of_response(assessment, axis, "attitude"),
        }
    return values_by_axis


def _values_of_response(assessment: Assessment, axis: str, loop_name: str) -> JsonValues:
    """Returns the values of the document ``Responses``: the measured and predicted response of a loop, and its facts.

    Args:
        assessment: assessment of the vehicle, with the responses of its loops.
        axis: "roll", "pitch" or "yaw".
        loop_name: "rate" or "attitude".

    Returns:
        Values by key. Without a measured response, "measured" is None and the facts are the reason.
    """
    responses = assessment.responses.get(axis)
    if responses is None:
        # No response of the axis was measured, for a reason that the headline states.
        response = LoopResponse(assessment.headline)
    else:
        response = responses[loop_name]
    measured_response = response.measured
    measured_document = None
    if not isinstance(measured_response, Fact):
        measured_document = Response.from_results(
            measured_response,
            response,
            highest=measured_response.max_frequency,
            is_doubtful=response.is_step_doubtful,
        )
    return {"measured": measured_document, "facts": response.facts}


def _spectrum_document(spectrum: spectra.Spectrum, lines: tuple[SpectralLine, ...]) -> Spectrum:
    """Returns the document of a spectrum, with its spectrograms over time and over the throttle.

    The document holds the coarse spectrum, with few frequencies and times, so that it stays small enough for a page.
    ``highest`` and ``windows`` describe the full spectrum.

    Args:
        spectrum: spectrum of a gyro, an accelerometer or a demand of the motors.
        lines: its spectral lines, the strongest first.
    """
    is_acceleration = spectrum.unit == "m/s²"
    axes = ACCELERATION_AXES if is_acceleration else AXES
    coarse = spectrum.coarse
    return Spectrum.from_results(
        spectrum,
        highest=spectrum.nyquist_frequency,
        windows=len(spectrum.time),
        frequency=coarse.frequency,
        density=dict(zip(axes, coarse.mean_density, strict=True)),
        by_time={
            "time": coarse.time,
            "throttle": coarse.throttle,
            "frequency": coarse.spectrogram_frequency,
            "density": coarse.density_by_time,
        },
        by_throttle={
            "time": None,
            "throttle": coarse.throttle_levels,
            "frequency": coarse.spectrogram_frequency,
            "density": coarse.density_by_throttle,
        },
        lines=[Line.from_results(line, kind=line.cause) for line in lines],
    )
