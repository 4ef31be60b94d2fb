"""The verdict: can a model of one axis be learnt from this telemetry, and if not, why not and what to change."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from mavdem import figures as measured
from mavdem.align import MINIMUM_RATE, Segment, drive, segments, usual_rate
from mavdem.faster import ask_for_rate, kept_from_asking
from mavdem.figures import CONSISTENCY_SPAN, Figures
from mavdem.ingest import Speaker, meaning
from mavdem.ingest.geometry import MULTIROTORS
from mavdem.ingest.meaning import FASTEST, Attitude, Motors
from mavdem.telemetry import Telemetry

MINIMUM_DURATION = 5.0
"""Seconds: a few swings of an axis that moves at 1 Hz, and a few hundred samples for a few tens of parameters."""

REFUSED_SNR, DOUBTFUL_SNR = 1.0, 20.0
"""Variance of a signal over that of its rounding, for the motors' command and for the outputs' changes.

Rounding what something is learnt from can shrink what is learnt to SNR/(1 + SNR) of the truth: to half at 1, by 5 % at
20."""

REFUSED_CONSISTENCY, DOUBTFUL_CONSISTENCY = 0.5, 0.8
"""Share of the angle's changes over ``CONSISTENCY_SPAN`` that the integrated rates explain.

Both measure one motion; where they disagree, most of the rate is an alias, noise, or another unit."""

DOUBTFUL_UPPER_BAND = 0.5
"""Share of the rate's variance above half the Nyquist frequency.

White noise has a half, so nothing has decayed by there."""

DOUBTFUL_LOSS = 0.05
"""Share of a stream's messages left out as damaged: the rest may be too."""

REFUSED_IMPOSSIBLE = 0.01
"""Share of messages with an angle or a rate that cannot be: too many for odd ones, so they are in another unit."""

DOUBTFUL_SATURATION = 0.05
"""Share of samples with a motor at its limit: a linear model is blind to limits."""


@dataclass(frozen=True)
class Verdict:
    """Whether a model of ``axis`` can be learnt; ``dataclasses.asdict`` makes it plain JSON values.

    Attributes:
        learnable: the answer.
        reason: one sentence with the figures that decided.
        remedy: what to change, with the command where there is one; empty when learnable.
        cautions: one sentence for each thing that makes a model worth less.
        segment: the stretch it is about: the one to learn from or, when refused, the longest; None when there is none.
        figures: what was measured on it.
    """

    axis: str
    learnable: bool
    reason: str
    remedy: str
    cautions: tuple[str, ...]
    segment: Segment | None
    figures: Figures


def judge(
    telemetry: Telemetry, axis: str = "roll", inputs: str | None = None, speakers: Sequence[Speaker] = ()
) -> Verdict:
    """The verdict on ``telemetry``: yes on the longest settled segment that can be learnt from, or no on the longest.

    Args:
        telemetry: of one vehicle.
        axis: "roll" or "pitch".
        inputs: "motors" or "demand"; None for the motors, unless they come too slowly and the demand does not.
        speakers: who was heard in the log, among them whoever asks the vehicle for other rates.

    Raises:
        ValueError: an axis or inputs that are neither.
    """
    attitude, motors = meaning.attitude(telemetry, axis), drive(telemetry, axis, inputs)
    figures = Figures()

    def refused(reason: str, remedy: str) -> Verdict:
        return Verdict(axis, False, reason, remedy, (), None, figures)

    if telemetry.vehicle not in (*MULTIROTORS, "UNKNOWN"):
        return refused(
            f"The vehicle says it is a {telemetry.vehicle}, and only a multirotor's {axis} can be learnt.",
            "Give a multirotor's log, or choose another vehicle of this one.",
        )
    if attitude is None:
        return refused("There is no ATTITUDE or ATTITUDE_QUATERNION message.", ask_for_rate(telemetry))
    if motors is None:
        return refused(*_undriven(telemetry, axis, inputs))

    if attitude.impossible > REFUSED_IMPOSSIBLE * attitude.sent:
        return refused(
            f"{attitude.impossible} of {attitude.sent} {attitude.message} messages have {_IMPOSSIBLE}: the attitude is "
            "not in radians.",
            "Check what wrote the log: MAVLink's attitude is in rad and rad/s.",
        )
    if not len(attitude.time):
        return refused(
            f"{attitude.message} holds no finite numbers from which {axis} and its rate can be told.",
            "Check the autopilot's estimator and what wrote the log.",
        )
    found = segments(telemetry, axis, inputs)
    figures = measured.of_log(telemetry, attitude, motors, len(found))
    if figures.armed == 0:
        return refused("The vehicle was never armed.", _FLY)
    if figures.airborne == 0:
        return refused(f"The vehicle was armed for {figures.armed:.0f} s and never left the ground.", _FLY)
    log = _Recorded(telemetry, attitude, motors, axis, inputs, speakers, figures)
    if not found:
        return refused(*(_too_slow(log, figures) or _slowed_down(log) or _too_short(figures)))
    refusals: list[Verdict] = []
    for segment in found:
        if refusals and segment.duration < MINIMUM_DURATION:
            break
        of_segment = measured.of_segment(telemetry, attitude, motors, segment, axis, figures)
        objection = _objection(log, of_segment)
        if objection is None:
            cautions = _losses(attitude, motors) + _cautions(telemetry, motors, axis, of_segment)
            return Verdict(axis, True, _praise(motors, of_segment), "", cautions, segment, of_segment)
        refusals.append(Verdict(axis, False, *objection, (), segment, of_segment))
    return refusals[0]


Objection = tuple[str, str]
"""Why not, and what to change."""


@dataclass(frozen=True, eq=False)
class _Recorded:
    """What is judged: as in ``judge``, and what was found in it; ``figures`` are those of the whole log."""

    telemetry: Telemetry
    attitude: Attitude
    motors: Motors
    axis: str
    inputs: str | None
    speakers: Sequence[Speaker]
    figures: Figures

    @property
    def names(self) -> tuple[str, str]:
        """The messages of attitude and of motors."""
        return self.attitude.message, self.motors.message


def _objection(log: _Recorded, figures: Figures) -> Objection | None:
    """What speaks against learning from the segment of ``figures``."""
    axis = log.axis
    short = (figures.duration or 0.0) < MINIMUM_DURATION
    # A short stretch of a slow stream may be fast; then it is still the rate of the stream that should change.
    slow = _too_slow(log, log.figures if short else figures)
    if slow or short:
        return slow or _slowed_down(log) or _too_short(figures)
    held = _held(log, figures)
    if held:
        return held
    if not figures.angle_sd or not figures.rate_sd:
        return f"The {axis} angle or rate never changes.", "Check that the stream is not a replay of one message."
    if figures.output_snr is not None and figures.output_snr < REFUSED_SNR:
        return (
            f"Over {CONSISTENCY_SPAN} s the {axis} angle or rate changes by no more than rounding to steps of "
            f"{figures.angle_step:.2g} rad and {figures.rate_step:.2g} rad/s makes.",
            f"Record the attitude as the autopilot sends it, or excite {axis} with the stick.",
        )
    if figures.consistency is not None and figures.consistency < REFUSED_CONSISTENCY:
        return (
            f"The {axis} rate and angle contradict each other: integrated, the rate explains "
            f"{figures.consistency:.3g} of the angle's changes over {CONSISTENCY_SPAN} s, so it is mostly an alias of "
            "something faster, or noise.",
            ask_for_rate(log.telemetry, rate=200),
        )
    if figures.input_snr is not None and figures.input_snr < REFUSED_SNR:
        command = f"{figures.input_sd:.2g} {log.motors.scale.unit}".rstrip()
        return (
            f"The standard deviation of the motors' {axis} command, {command}, is no more than rounding to steps of "
            f"{figures.input_step:.2g} makes.",
            f"Fly in wind, or excite {axis} with the stick.",
        )
    return None


def _undriven(telemetry: Telemetry, axis: str, inputs: str | None) -> Objection:
    if inputs == "demand":
        remedy = "Take the motors: `--inputs motors`."
        if meaning.DEMAND in telemetry.messages:
            return f"The controller's {axis} demand in {meaning.DEMAND} never moves.", remedy
        return (
            f"The controller's {axis} demand is not in it: that is in {meaning.DEMAND}, of which there is none "
            "(ATTITUDE_TARGET is the attitude that is wanted, not what turns the vehicle there).",
            remedy,
        )
    return "There is no message with motor outputs that move.", ask_for_rate(telemetry)


def _too_slow(log: _Recorded, figures: Figures) -> Objection | None:
    rates = dict(zip(log.names, (figures.attitude_rate or 0.0, figures.motor_rate or 0.0), strict=True))
    reason = too_slow(rates, log.axis)
    return None if reason is None else (reason, _for_faster(log, rates[log.attitude.message] >= MINIMUM_RATE))


def _slowed_down(log: _Recorded) -> Objection | None:
    """Whether a stream that comes fast elsewhere comes too slowly in most of the air: somebody asked for less."""
    found = {
        stream.message: slow
        for stream in (log.attitude, log.motors)
        if (slow := measured.slow_in_air(log.telemetry, stream, log.motors)) is not None
        and slow.seconds > log.figures.airborne / 2
    }
    if not found:
        return None
    slowest, slow = min(found.items(), key=lambda named: named[1].rate)
    boot = f" of boot {slow.boot + 1}" if slow.boot else " after boot"
    reason = (
        f"In the air {slowest} comes at {_below(slow.rate, MINIMUM_RATE)} Hz from {slow.start:.1f} s{boot} on, for "
        f"{slow.seconds:.0f} of {log.figures.airborne:.0f} s, though faster elsewhere; {_needed(log.axis)}."
    )
    return reason, _for_faster(log, log.attitude.message not in found)


def _for_faster(log: _Recorded, attitude_is_fast: bool) -> str:
    """What makes streams come faster that come too slowly, or do without."""
    demand = meaning.demand(log.telemetry, log.axis) if log.inputs == "motors" and attitude_is_fast else None
    if demand is not None and (rate := usual_rate(demand)) >= MINIMUM_RATE:
        return f"Leave out `--inputs motors`: the {log.axis} demand comes at {rate:.1f} Hz and is then the input."
    return f"{kept_from_asking(log.telemetry, log.speakers)} {ask_for_rate(log.telemetry)}".lstrip()


def too_slow(rates: Mapping[str, float], axis: str) -> str | None:
    """The sentence that says which message comes too slowly for ``axis``, of ``rates`` in Hz by name; None if none."""
    slowest, rate = min(rates.items(), key=lambda named: named[1])
    if rate >= MINIMUM_RATE:
        return None
    return f"{slowest} comes at {_below(rate, MINIMUM_RATE)} Hz; {_needed(axis)}."


def _needed(axis: str) -> str:
    return (
        f"{axis} dynamics live at several Hz and need {MINIMUM_RATE:.0f} Hz of attitude and of motor outputs, better "
        "100"
    )


def _held(log: _Recorded, figures: Figures) -> Objection | None:
    """Whether a stream repeats old values under new stamps."""
    rates = (figures.attitude_rate or 0.0, figures.motor_rate or 0.0)
    fresh = (figures.attitude_fresh or 0.0, figures.motor_fresh or 0.0)
    stalest, rate, new = min(zip(log.names, rates, fresh, strict=True), key=lambda stream: stream[2])
    if new >= MINIMUM_RATE:
        return None
    return (
        f"{stalest} changes only at {_below(new, MINIMUM_RATE)} Hz, though it is sent at {rate:.3g} Hz; {log.axis} "
        f"dynamics need {MINIMUM_RATE:.0f} Hz of new values.",
        f"Find what repeats old values between the autopilot and the log. {ask_for_rate(log.telemetry)}",
    )


def _below(value: float, limit: float) -> str:
    """The value with as many decimals, at least one, as show that it is below the limit."""
    return next((text for digits in range(1, 6) if float(text := f"{value:.{digits}f}") < limit), f"{value:.6g}")


def _too_short(figures: Figures) -> Objection:
    return (
        "The longest stretch of settled flight without gaps lasts "
        f"{_below(figures.duration or 0.0, MINIMUM_DURATION)} s of the {MINIMUM_DURATION:.0f} s needed, out of "
        f"{figures.airborne:.0f} s in the air.",
        "Hover for half a minute between take-off and landing, over a link that does not drop out.",
    )


def _praise(motors: Motors, figures: Figures) -> str:
    what = "motor outputs" if motors.message != meaning.DEMAND else motors.layout.names[0]
    return (
        f"{figures.duration:.1f} s of settled flight with attitude at {figures.attitude_rate:.1f} Hz and {what} "
        f"at {figures.motor_rate:.1f} Hz."
    )


_FLY = "Record a flight: half a minute in the air between take-off and landing is enough."


_IMPOSSIBLE = f"an angle beyond 2π or a rate beyond {FASTEST:.0f} rad/s"


def _losses(attitude: Attitude, motors: Motors) -> tuple[str, ...]:
    cautions = []
    if attitude.impossible:
        cautions.append(
            f"{attitude.impossible} of {attitude.sent} {attitude.message} messages were left out, for {_IMPOSSIBLE}."
        )
    for stream in (attitude, motors):
        if stream.left_out > DOUBTFUL_LOSS * stream.sent:
            cautions.append(
                f"{stream.left_out} of {stream.sent} {stream.message} messages were left out: their time stamps are "
                "far off or those of others, or their numbers make no sense."
            )
    return tuple(cautions)


def _cautions(telemetry: Telemetry, motors: Motors, axis: str, figures: Figures) -> tuple[str, ...]:
    layout, cautions = motors.layout, []
    if motors.message == meaning.DEMAND:
        driving = meaning.motors(telemetry)
        slow = driving is None or usual_rate(driving) < MINIMUM_RATE
        cautions.append(
            f"{'Motor outputs come too slowly, so the' if slow else 'The'} {axis} demand was taken for the input: what "
            "the mixer, the motors' limits and the battery make of it is not in it."
        )
    if telemetry.vehicle == "UNKNOWN":
        cautions.append("No heartbeat says what the vehicle is: a multirotor was assumed.")
    if layout.channels_assumed or layout.positions_assumed:
        cautions.append(f"Which motor is which was assumed: {layout.basis}.")
    if figures.input_snr is not None and figures.input_snr < DOUBTFUL_SNR:
        loss = min(1.0, 1 / (1 + figures.input_snr))
        cautions.append(
            f"The motors' {axis} command is near the resolution of the stream (standard deviation "
            f"{figures.input_sd:.2g}, steps of {figures.input_step:.2g}): rounding can shrink the learnt gain by "
            f"{loss:.0%}."
        )
    if figures.output_snr is not None and figures.output_snr < DOUBTFUL_SNR:
        cautions.append(
            f"The {axis} angle or rate is near the resolution of the stream (steps of {figures.angle_step:.2g} rad and "
            f"{figures.rate_step:.2g} rad/s): rounding can shrink what is learnt of the dynamics by "
            f"{min(1.0, 1 / (1 + figures.output_snr)):.0%}."
        )
    if figures.consistency is not None and figures.consistency < DOUBTFUL_CONSISTENCY:
        cautions.append(f"The rate explains only {figures.consistency:.2f} of the angle's changes: noise, or an alias.")
    if figures.upper_band is not None and figures.upper_band > DOUBTFUL_UPPER_BAND:
        cautions.append(
            f"{figures.upper_band:.0%} of the {axis} rate's variance lies in the upper half of the band: something "
            "faster is probably aliased into it."
        )
    if figures.saturation is not None and figures.saturation > DOUBTFUL_SATURATION:
        cautions.append(f"A motor is at its limit in {figures.saturation:.0%} of the samples.")
    return tuple(cautions)
