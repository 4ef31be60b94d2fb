"""The verdict: can a model of one axis be learnt from this telemetry, and if not, why not and what to change."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from mavdem import figures as measured
from mavdem.align import MINIMUM_RATE, Segment, drive, segments, usual_rate
from mavdem.figures import CONSISTENCY_SPAN, Figures
from mavdem.ingest import meaning
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


def judge(telemetry: Telemetry, axis: str = "roll", inputs: str | None = None) -> Verdict:
    """The verdict on ``telemetry``: yes on the longest settled segment that can be learnt from, or no on the longest.

    Args:
        telemetry: of one vehicle.
        axis: "roll" or "pitch".
        inputs: "motors" or "demand"; None for the motors, unless they come too slowly and the demand does not.

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
        return refused("There is no ATTITUDE or ATTITUDE_QUATERNION message.", _ask_for_rate(telemetry))
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
    names = (attitude.message, motors.message)
    if not found:
        return refused(*(_too_slow(telemetry, names, axis, figures) or _too_short(figures)))
    refusals: list[Verdict] = []
    for segment in found:
        if refusals and segment.duration < MINIMUM_DURATION:
            break
        of_segment = measured.of_segment(telemetry, attitude, motors, segment, axis, figures)
        objection = _objection(telemetry, names, motors.scale.unit, axis, figures, of_segment)
        if objection is None:
            cautions = _losses(attitude, motors) + _cautions(telemetry, motors, axis, of_segment)
            return Verdict(axis, True, _praise(motors, of_segment), "", cautions, segment, of_segment)
        refusals.append(Verdict(axis, False, *objection, (), segment, of_segment))
    return refusals[0]


Objection = tuple[str, str]
"""Why not, and what to change."""


def _objection(
    telemetry: Telemetry, names: tuple[str, str], unit: str, axis: str, log: Figures, figures: Figures
) -> Objection | None:
    """What speaks against learning from the segment of ``figures``, in a log of figures ``log``."""
    short = (figures.duration or 0.0) < MINIMUM_DURATION
    # A short stretch of a slow stream may be fast; then it is still the rate of the stream that should change.
    slow = _too_slow(telemetry, names, axis, log if short else figures)
    if slow or short:
        return slow or _too_short(figures)
    held = _held(telemetry, names, axis, figures)
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
            _ask_for_rate(telemetry, rate=200),
        )
    if figures.input_snr is not None and figures.input_snr < REFUSED_SNR:
        return (
            f"The standard deviation of the motors' {axis} command, {figures.input_sd:.2g} {unit}".rstrip()
            + f", is no more than rounding to steps of {figures.input_step:.2g} makes.",
            f"Fly in wind, or excite {axis} with the stick.",
        )
    return None


def _undriven(telemetry: Telemetry, axis: str, inputs: str | None) -> Objection:
    if inputs == "demand":
        return f"The controller's {axis} demand is not in it, or never moves.", "Take the motors: `--inputs motors`."
    return "There is no message with motor outputs that move.", _ask_for_rate(telemetry)


def _too_slow(telemetry: Telemetry, names: tuple[str, str], axis: str, figures: Figures) -> Objection | None:
    """``names``: the messages of attitude and of motors."""
    rates = dict(zip(names, (figures.attitude_rate or 0.0, figures.motor_rate or 0.0), strict=True))
    reason = too_slow(rates, axis)
    return None if reason is None else (reason, _ask_for_rate(telemetry))


def too_slow(rates: Mapping[str, float], axis: str) -> str | None:
    """The sentence that says which message comes too slowly for ``axis``, of ``rates`` in Hz by name; None if none."""
    slowest, rate = min(rates.items(), key=lambda named: named[1])
    if rate >= MINIMUM_RATE:
        return None
    return (
        f"{slowest} comes at {_below(rate, MINIMUM_RATE)} Hz; {axis} dynamics live at several Hz and need "
        f"{MINIMUM_RATE:.0f} Hz of attitude and of motor outputs, better 100."
    )


def _held(telemetry: Telemetry, names: tuple[str, str], axis: str, figures: Figures) -> Objection | None:
    """Whether a stream repeats old values under new stamps. ``names``: as for ``_too_slow``."""
    rates = (figures.attitude_rate or 0.0, figures.motor_rate or 0.0)
    fresh = (figures.attitude_fresh or 0.0, figures.motor_fresh or 0.0)
    stalest, rate, new = min(zip(names, rates, fresh, strict=True), key=lambda stream: stream[2])
    if new >= MINIMUM_RATE:
        return None
    return (
        f"{stalest} changes only at {_below(new, MINIMUM_RATE)} Hz, though it is sent at {rate:.3g} Hz; {axis} "
        f"dynamics need {MINIMUM_RATE:.0f} Hz of new values.",
        f"Find what repeats old values between the autopilot and the log. {_ask_for_rate(telemetry)}",
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


def _ask_for_rate(telemetry: Telemetry, rate: int = 100) -> str:
    """How to get attitude and motors at ``rate`` Hz out of this autopilot.

    PX4: https://docs.px4.io/main/en/modules/modules_communication (``mavlink``). ArduPilot:
    https://ardupilot.org/dev/docs/mavlink-requesting-data.html; its stream groups EXTRA1 and RC_CHAN send ATTITUDE and
    SERVO_OUTPUT_RAW. ROS 2: https://docs.px4.io/main/en/middleware/uxrce_dds and MAVROS's ``plugins/sys_status.cpp``.
    """
    if telemetry.translated_from == "uXRCE-DDS":
        return (
            "In PX4's src/modules/uxrce_dds_client/dds_topics.yaml add vehicle_attitude, vehicle_angular_velocity and "
            f"actuator_motors to the publications, no rate_limit below {rate}; build and flash PX4, and record anew."
        )
    if telemetry.translated_from == "MAVROS":
        return (
            "Call `ros2 service call /mavros/set_message_interval mavros_msgs/srv/MessageInterval "
            f'"{{message_id: 31, message_rate: {rate}}}"` (attitude), then with 36 (motors), and record anew.'
        )
    if telemetry.translated_from == "DataFlash":
        return (
            "Set bit 0 of LOG_BITMASK (fast attitude), which logs attitude and the demand at the loop rate; fly anew."
        )
    if telemetry.translated_from == "ULog":
        return "Set SDLOG_PROFILE to 17 (default and high rate), which logs attitude and the demand fast; fly anew."
    if telemetry.autopilot == "PX4":
        return (
            f"In PX4's shell run `mavlink stream -d DEVICE -s ATTITUDE -r {rate}` and "
            f"`mavlink stream -d DEVICE -s SERVO_OUTPUT_RAW_0 -r {rate}`, where DEVICE is the telemetry port "
            "(`-u PORT` for UDP), and record anew."
        )
    interval = round(1e6 / rate)
    if telemetry.autopilot == "ARDUPILOTMEGA":
        return (
            f"Set the telemetry port's SRn_EXTRA1 and SRn_RC_CHAN (MAVn_EXTRA1 and MAVn_RC_CHAN from ArduPilot 4.7) to "
            f"{rate} and reboot, or in MAVProxy enter `set streamrate -1`, `long SET_MESSAGE_INTERVAL 30 {interval}` "
            f"and `long SET_MESSAGE_INTERVAL 36 {interval}`; then record anew."
        )
    return (
        f"Ask the autopilot for messages 30 (ATTITUDE) and 36 (SERVO_OUTPUT_RAW) every {interval} µs with "
        "MAV_CMD_SET_MESSAGE_INTERVAL, and record anew."
    )


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
