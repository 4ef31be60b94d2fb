"""The review of a log: keys, units and meanings of documents."""

from __future__ import annotations

from mavdem.assessment import Assessment
from mavdem.assessment.axis.responses import LoopResponse
from mavdem.containers import JsonValues
from mavdem.dataset.axes import AXES
from mavdem.documents.document import Document, OptionalFact, Sentence
from mavdem.documents.flight import Report, report_document
from mavdem.documents.loops import Loop
from mavdem.documents.vehicle import Condition, Identity
from mavdem.documents.wind import WindVelocity
from mavdem.facts import Fact
from mavdem.units import Hertz, Number, PowerDensityInStatedUnit, Seconds
from mavdem.vibration import spectra as measured
from mavdem.vibration.spectra import max_decimated
from mavdem.vibration.spectral_lines import SpectralLine

FREQUENCIES = 240
MOST_TIMES = 80
"""At most, of a spectrum and of a spectrogram."""


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
    """A loop's measured response, and what is said of it."""

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
    """A line of a spectrum."""

    kind: str
    """motor, frame, alias or unnamed"""
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
    """Power of a sensor, or of what was asked of the motors, by frequency."""

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
    """What is said of the spectra."""

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
    """how angle and rate follow their setpoints: RMS errors (rad, rad/s), delay (s), overshoot"""


class Review(Document):
    """`--json` of review, and report.json."""

    source: str
    """the log"""
    headline: Sentence
    """the worst that was found, or how the flight was lost"""
    next_step: Sentence
    """what to do about it"""
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
    files: dict[str, str]
    """the files written, by name"""


def review_document(assessment: Assessment) -> JsonValues:
    """Returns the values of the document of an ``assessment``, which has written no files."""
    analysis = assessment.analysis
    return {
        "source": assessment.log.source,
        **assessment.judgement_values,
        "simulated": assessment.simulated,
        "identity": analysis and analysis.identity,
        "condition": analysis and analysis.condition,
        "axes": axes_of(assessment),
        "wind": assessment.wind and assessment.wind.identified_figures,
        "model": None if assessment.model is None else report_document(assessment),
        "spectra": {
            name: _spectrum(spectrum, assessment.noise.peaks[name])
            for name, spectrum in assessment.spectra.items()
        },
        "noise": {"facts": assessment.noise.facts},
        "files": {},
    }


def axes_of(assessment: Assessment) -> JsonValues:
    """Returns what is known of each axis."""
    resonances = {margins.axis: margins.response or margins.peak for margins in assessment.margins}
    axes = {}
    nothing = LoopResponse(assessment.headline)
    for axis, loop in assessment.loops.items():
        refusal = loop.refusal
        responses = assessment.responses.get(axis, {"rate": nothing, "attitude": nothing})
        drawn = {name: _response(response) for name, response in responses.items()}
        axes[axis] = {
            "loop": None if refusal else loop,
            "refusal": refusal,
            "resonance": resonances.get(axis),
            "tracking": assessment.tracking.get(axis),
            "step_response": drawn["rate"]["measured"],
            **drawn,
        }
    return axes


def _response(response: LoopResponse) -> JsonValues:
    if isinstance(response.measured, Fact):
        return {"measured": None, "facts": response.facts}
    return {
        "measured": Response.from_results(
            response.measured, response, highest=response.measured.max_frequency
        ),
        "facts": response.facts,
    }


def _spectrum(spectrum: measured.Spectrum, lines: tuple[SpectralLine, ...]) -> Spectrum:
    """The document of a spectrum, thinned to ``FREQUENCIES`` and ``MOST_TIMES`` by the largest."""
    axes = ("forward", "right", "down") if spectrum.unit == "m/s²" else AXES
    fine, mean = max_decimated(spectrum.frequency, spectrum.mean_density, FREQUENCIES)
    coarse, over_time = max_decimated(spectrum.frequency, spectrum.total_density, FREQUENCIES // 2)
    size = -(-len(spectrum.time) // MOST_TIMES)
    levels, by_throttle = spectrum.density_by_throttle
    _, by_throttle = max_decimated(spectrum.frequency, by_throttle, FREQUENCIES // 2)
    return Spectrum.from_results(
        spectrum,
        highest=spectrum.nyquist_frequency,
        windows=len(spectrum.time),
        frequency=fine,
        density=dict(zip(axes, mean, strict=True)),
        by_time={
            "time": spectrum.time[::size],
            "throttle": spectrum.throttle[::size],
            "frequency": coarse,
            "density": over_time[::size],
        },
        by_throttle={
            "time": None,
            "throttle": levels,
            "frequency": coarse,
            "density": by_throttle,
        },
        lines=lines,
    )
