"""Models of the JSON documents of ``mavdem tune`` and ``mavdem twin``: control loops, gains, a simulated vehicle."""

from __future__ import annotations

from mavdem.assessment.axis.tuning import Tuning
from mavdem.documents.document import (
    AdviceAndFact,
    AdviceText,
    Document,
    Error,
    Judged,
    ModelField,
    OptionalFact,
    SentenceAndFact,
    SentenceText,
)
from mavdem.documents.wind import Drag
from mavdem.facts import Fact, Facts
from mavdem.loops.advice import Advice
from mavdem.loops.filters import gyro_filters
from mavdem.units import (
    AngularRate,
    Decibels,
    Degrees,
    DegreesPerSecond,
    DisturbanceRejection,
    Hertz,
    Inertia,
    Kilograms,
    Metres,
    Number,
    ParameterValue,
    Percent,
    PerSecond,
    Radians,
    Seconds,
    Speed,
)


class Margins(Document):
    """Stability margins and other figures of one loop, rate or attitude."""

    crossover: Hertz
    """highest frequency at which the gain is 1"""
    crossover_interval: list[Hertz]
    """ends of the 90 % interval; null where there is none"""
    phase_margin: Degrees
    """phase margin; negative where the loop is unstable"""
    phase_margin_interval: list[Degrees]
    """ends of the 90 % interval; null where there is none"""
    gain_margin: Decibels
    """gain margin; null where no frequency has it"""
    gain_margin_interval: list[Decibels]
    """ends of the 90 % interval; null where there is none"""
    delay_margin: Seconds
    """delay margin"""
    delay_margin_interval: list[Seconds]
    """ends of the 90 % interval; null where there is none"""
    ms: Number
    """largest sensitivity (Ms)"""
    ms_interval: list[Number]
    """ends of the 90 % interval; null where there is none"""
    bandwidth: Hertz
    """frequency up to which the closed loop is at least −3 dB"""
    bandwidth_interval: list[Hertz]
    """ends of the 90 % interval; null where there is none"""
    rejection: DisturbanceRejection
    """largest response of the rate, or the angle, to a torque"""
    rejection_interval: list[DisturbanceRejection]
    """ends of the 90 % interval; null where there is none"""


class Measured(Document):
    """Response measured in flight, beside the predicted one."""

    band: list[Hertz]
    """frequencies between which the two can be compared"""
    fit: Percent
    """fit of the predicted rate to the measured one, 100 (1 − NRMSE)"""
    agreement: Percent
    """fit of the predicted rate to what the setpoint explains of the measured one"""
    reason: SentenceAndFact
    """why they do not agree; empty where they do"""
    controller_gain: float | None = None
    """gain of the demand in flight over that of the parameters"""


class Loop(Document):
    """The rate and the attitude loop of one axis."""

    axis: str
    """roll, pitch or yaw"""
    model: ModelField
    """model that the plant was identified by"""
    rate: Margins
    """figures of the rate loop"""
    attitude: Margins
    """figures of the attitude loop"""
    lean_in_wind: Radians
    """angle by a steady torque of one standard deviation of the wind"""
    cautions: list[SentenceAndFact]
    """what limits the figures, one sentence each"""
    measured: Measured | None
    """response measured in flight, beside the predicted one"""
    agrees: bool | None
    """whether measured and predicted response agree"""


class Target(Document):
    """Stability margins that were asked for."""

    phase_margin: Degrees
    """least phase margin"""
    gain_margin: Decibels
    """least gain margin"""
    ms: float
    """largest Ms"""


class Gain(Document):
    """A gain of the autopilot."""

    now: ParameterValue
    """value in the log"""
    set: ParameterValue
    """value to set"""


class Notch(Document):
    """A notch filter."""

    frequency: Hertz
    """centre; of one that follows the throttle, that in hover"""
    bandwidth: Hertz
    """width where half of the power is lost, of a deep notch"""
    attenuation: Decibels
    """attenuation at the centre; null where it is infinite"""


class GyroFilters(Document):
    """Filters of the gyro, which the loop has and behind which rates are logged."""

    low_pass: Hertz
    """cut-off of the second-order low-pass; 0 where there is none"""
    notches: list[Notch]
    """notch filters"""
    phase_lag: Degrees
    """phase lag of all at the crossover"""


class Noise(Document):
    """Noise of the gyro in the demand."""

    lowest: Hertz
    """lowest frequency that counts as noise"""
    highest: Hertz
    """highest frequency that the log shows"""
    before: float
    """standard deviation of the demand, 1 being all that the mixer takes"""
    after: float
    """the same with the gains to set"""
    by_d: float
    """part of the D term, before"""
    heat: float
    """factor by which fast commands heat the motors more"""


class AxisAdvice(Document, is_partial=True):
    """The loops of one axis and the gains to set."""

    refusal: AdviceAndFact
    """why there are no loops; no other key but decision is there then"""
    decision: OptionalFact
    """what is wrong with the loops, and as remedy what to do about it; null without a flight"""
    loop: Loop
    """the loops with the gains of the log"""
    filters: GyroFilters
    """filters of the gyro"""
    target: Target
    """the margins asked for"""
    verdict: SentenceAndFact
    """whether the loops have these margins, one sentence"""
    sentence: AdviceText
    """what to do, one or two sentences"""
    sure: float
    """share of the models that fit the flight in which both loops have the margins"""
    gains: dict[str, Gain]
    """gains by the autopilot's name"""
    expected: Loop
    """the loops with the gains to set"""
    stage: int | None
    """1: rate P, I and D; 2: the angle's gain; null where no gain changes"""
    design: dict[str, ParameterValue]
    """gains at the end of the stage, as this flight shows them"""
    flights: int
    """steps, with a flight after each, until these are set"""
    notes: list[SentenceText]
    """unusual ratios of gains, one sentence each"""
    noise: Noise
    """noise of the gyro in the demand"""


class Tune(Judged):
    """`--json` of tune."""

    source: str
    """the log"""
    margins: str
    """the value of --margins"""
    axes: dict[str, AxisAdvice]
    """loops and gains of each axis"""
    parameters: dict[str, ParameterValue]
    """gains to set, where they change"""
    notch: OptionalFact = None
    """with --filters, the notch filter to set or why there is none"""
    flights: list[SentenceAndFact]
    """verdicts on the flights of a recording, the worst first, if the autopilot restarted on the ground between them;
    all else is of the first of these; empty where the log is judged as a whole"""
    error: Error | None = None
    """why no gains are advised"""


def tune_document(source: str, margins: str, tuning: Tuning, flights: Facts = ()) -> Tune:
    """Makes the JSON document of ``mavdem tune`` from the gains that were advised.

    The attributes of ``tuning`` (parameters to set, notch filter) and of the flight's judgement (headline, lights, next
    step) fill the fields of the same names; see :meth:`Document.from_results`.

    Args:
        source: name of the log.
        margins: name of the stability margins that were asked for, as in ``--margins``.
        tuning: advised gains by axis, or the reason why its loops are not known; and the judgement of the flight.
        flights: verdicts on the flights of a recording, if they are judged each by itself.

    Returns:
        The document. Its key ``error`` is there only if gains are neither computed, lowered nor kept.
    """
    axes = {}
    for axis, advice in tuning.axes.items():
        decision = tuning.judgement.loop_decisions.get(axis)
        axes[axis] = _axis_document(advice, None if decision is None else decision.fact)
    # Without an error its key is not passed at all: a value of None would stand in the JSON as null.
    optional_keys = {}
    refusal = tuning.failure
    if refusal is not None:
        optional_keys["error"] = {"reason": refusal, "remedy": refusal.remedy, "fact": refusal}
    return Tune.from_results(
        tuning,
        tuning.judgement,
        source=source,
        margins=margins,
        axes=axes,
        flights=flights,
        **optional_keys,
    )


def _axis_document(advice: Advice | Fact, decision: Fact | None) -> AxisAdvice:
    """Makes the record of one axis in the document of ``mavdem tune``.

    Args:
        advice: the loops of the axis with the present and with the new gains, the gains to set and the noise of the
            demand; or a fact that says why the loops are not known.
        decision: decision on the loops of the axis (what is wrong, what to do); None without a flight.

    Returns:
        The record. Without known loops it has the keys ``refusal`` and ``decision`` only. If the loops are known but no
        gains are advised, ``expected``, the loops with the new gains, is null.
    """
    if isinstance(advice, Fact):
        return AxisAdvice.from_results(refusal=advice, decision=decision)
    loop = advice.before
    # Gains, required margins and noise are filled from the attributes of the advice that have the names of the keys.
    # These keys have other names than the attributes: a published document keeps its keys.
    return AxisAdvice.from_results(
        advice,
        decision=decision,
        loop=loop,
        filters=gyro_filters(loop.controller, loop.crossover),
        verdict=advice.rating,
        sentence=advice.conclusion,
        expected=None if advice.refusals else advice.after,
    )


class TwinVehicle(Document):
    """The vehicle for simulators."""

    autopilot: str
    """px4 or ardupilot"""
    mass: Kilograms
    """mass, given or assumed"""
    inertia: list[Inertia]
    """moments of inertia about forward, right and down"""
    arm: list[Metres]
    """distance of the motors forward and to the right of the centre of mass"""
    hover: float
    """share of the motors' range in hover"""
    spin: list[float]
    """shares of that range at which thrust begins and ends"""
    expo: float
    """share of a motor's thrust that is quadratic in its command"""
    moment: Metres
    """torque of a propeller by its thrust"""
    damping: list[PerSecond]
    """damping of the rates of roll, pitch and yaw"""
    lag: Seconds
    """motor time constant"""
    delay: Seconds
    """delay from the motion to the motors' command"""
    noise: AngularRate
    """standard deviation of a measured rate"""
    drag: Drag
    """drag, by its source that of typical vehicles where the flight does not show it"""
    wind_speed: Speed
    """mean wind of the flight; null where it is not known"""
    wind_direction: Degrees | None
    """where that wind comes from, clockwise from the north of the yaw"""
    parameters: dict[str, ParameterValue]
    """parameters of the autopilot's control"""
    notes: dict[str, SentenceText]
    """how sure each value is"""


class Alike(Document):
    """Figures of the recorded flight of one axis beside the mean of flights of the twin."""

    levels: list[Decibels]
    """level of the rate's spectrum by band, the twin's over the recorded"""
    lean: list[Degrees] | None = None
    """mean angle, recorded and twin's; not of yaw"""
    sway: list[Degrees] | None = None
    """standard deviation of the angle, recorded and twin's; not of yaw"""
    rate: list[DegreesPerSecond]
    """standard deviation of the rate, recorded and twin's"""


class Twin(Document):
    """`--json` of twin."""

    vehicle: TwinVehicle
    """the vehicle for simulators"""
    missing: list[SentenceText]
    """what is not learned, one sentence each"""
    alike: dict[str, Alike]
    """by axis, figures of the recorded flight, and their mean over the twin's; none without setpoints of roll"""
