"""The verdict: can a model of one axis be learnt from this telemetry, and if not, why not and what to change."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import cumulative_trapezoid
from scipy.signal import welch

from mavdem import phases
from mavdem.align import Segment, align, mean_rate, segments
from mavdem.ingest import meaning
from mavdem.ingest.geometry import MULTIROTORS
from mavdem.ingest.meaning import Attitude, Motors
from mavdem.intervals import both
from mavdem.telemetry import Telemetry

MINIMUM_RATE = 40.0
"""Hz, of attitude and of motors.

Ten times the roughly 4 Hz at which a multirotor's roll loop crosses over, and what is left of a 50 Hz stream on a link
that loses a fifth. On recorded flights motors add nothing to a forecast at 1-10 Hz and do at 50."""

MINIMUM_DURATION = 5.0
"""Seconds: a few swings of an axis that moves at 1 Hz, and a few hundred samples for a few tens of parameters."""

REFUSED_SNR, DOUBTFUL_SNR = 1.0, 20.0
"""Variance of a signal over that of its rounding. Rounding an input can shrink the gain learnt from it to SNR/(1 + SNR)
of the truth: to half at 1, by 5 % at 20."""

REFUSED_CONSISTENCY, DOUBTFUL_CONSISTENCY = 0.5, 0.8
"""Share of the angle's changes over ``CONSISTENCY_SPAN`` that the integrated rates explain.

Both measure one motion; where they disagree, most of the rate is an alias, noise, or another unit."""

CONSISTENCY_SPAN = 0.2
"""Seconds: one period of 5 Hz, so that sensor noise averages out and roll dynamics do not."""

DOUBTFUL_UPPER_BAND = 0.5
"""Share of the rate's variance above half the Nyquist frequency.

White noise has a half, so nothing has decayed by there."""

DOUBTFUL_SATURATION = 0.05
"""Share of samples with a motor at its limit: a linear model is blind to limits."""

_FULL, _IDLE = 0.99, 0.15
"""Shares of the motors' range: at full throttle, and at the idle below which autopilots let no motor fall in flight."""


@dataclass(frozen=True)
class Figures:
    """What was measured on the longest segment; None where it could not be. In s, Hz, rad, rad/s, units of the stream.

    Attributes:
        armed, airborne: seconds over all boots.
        segments: settled stretches found.
        duration, samples, dt: of the longest, aligned.
        attitude_rate, motor_rate: mean messages a second.
        attitude_jitter, motor_jitter: standard deviation of the steps between messages.
        attitude_gap, motor_gap: the longest step.
        angle_sd, rate_sd: standard deviations of the outputs.
        input_sd: standard deviation of the motors' combination that turns the axis (of one motor against the others
            where their places are unknown).
        input_step: quantisation step of the motor outputs.
        input_snr: variance of that combination, rounding taken off, over the variance that rounding alone gives it.
        saturation: share of samples with a motor at its limit.
        upper_band: share of the rate's variance above half the Nyquist frequency.
        consistency: share of the angle's changes over 0.2 s explained by the integrated rates; can be far below 0.
    """

    armed: float = 0.0
    airborne: float = 0.0
    segments: int = 0
    duration: float | None = None
    samples: int | None = None
    dt: float | None = None
    attitude_rate: float | None = None
    motor_rate: float | None = None
    attitude_jitter: float | None = None
    motor_jitter: float | None = None
    attitude_gap: float | None = None
    motor_gap: float | None = None
    angle_sd: float | None = None
    rate_sd: float | None = None
    input_sd: float | None = None
    input_step: float | None = None
    input_snr: float | None = None
    saturation: float | None = None
    upper_band: float | None = None
    consistency: float | None = None


@dataclass(frozen=True)
class Verdict:
    """Whether a model of ``axis`` can be learnt; ``dataclasses.asdict`` makes it plain JSON values.

    Attributes:
        learnable: the answer.
        reason: one sentence with the figures that decided.
        remedy: what to change, with the command where there is one; empty when learnable.
        cautions: one sentence for each thing that makes a model worth less.
        figures: what was measured.
    """

    axis: str
    learnable: bool
    reason: str
    remedy: str
    cautions: tuple[str, ...]
    figures: Figures


def judge(telemetry: Telemetry, axis: str = "roll") -> Verdict:
    """The verdict on the longest settled segment of ``telemetry``.

    Raises:
        ValueError: an axis that is neither "roll" nor "pitch".
    """
    attitude, motors = meaning.attitude(telemetry, axis), meaning.motors(telemetry)
    figures = Figures()

    def refused(reason: str, remedy: str) -> Verdict:
        return Verdict(axis, False, reason, remedy, (), figures)

    if telemetry.vehicle not in (*MULTIROTORS, "UNKNOWN"):
        return refused(
            f"The vehicle says it is a {telemetry.vehicle}, and only a multirotor's {axis} can be learnt.",
            "Give a multirotor's log, or choose another vehicle of this one.",
        )
    if attitude is None:
        return refused("There is no ATTITUDE or ATTITUDE_QUATERNION message.", _ask_for_rate(telemetry))
    if motors is None:
        return refused("There is no message with motor outputs that move.", _ask_for_rate(telemetry))

    found = segments(telemetry, axis)
    figures = _whole_log(telemetry, attitude, motors, len(found))
    if figures.armed == 0:
        return refused("The vehicle was never armed.", _FLY)
    if figures.airborne == 0:
        return refused(f"The vehicle was armed for {figures.armed:.0f} s and never left the ground.", _FLY)
    if found:
        figures = _measure(telemetry, attitude, motors, found[0], axis, figures)
    rates = {attitude.message: figures.attitude_rate or 0.0, motors.message: figures.motor_rate or 0.0}
    slowest = min(rates, key=lambda message: rates[message])
    if rates[slowest] < MINIMUM_RATE:
        return refused(
            f"{slowest} comes at {rates[slowest]:.1f} Hz; {axis} dynamics live at several Hz and need "
            f"{MINIMUM_RATE:.0f} Hz of attitude and of motor outputs.",
            _ask_for_rate(telemetry),
        )
    if not found or found[0].duration < MINIMUM_DURATION:
        longest = found[0].duration if found else 0.0
        return refused(
            f"The longest stretch of settled flight without gaps lasts {longest:.1f} s of the {MINIMUM_DURATION:.0f} s "
            f"needed, out of {figures.airborne:.0f} s in the air.",
            "Hover for half a minute between take-off and landing, over a link that does not drop out.",
        )
    if not figures.angle_sd or not figures.rate_sd:
        return refused(
            f"The {axis} angle or rate never changes.", "Check that the stream is not a replay of one message."
        )
    if figures.consistency is not None and figures.consistency < REFUSED_CONSISTENCY:
        return refused(
            f"The {axis} rate and angle contradict each other: integrated, the rate explains "
            f"{figures.consistency:.2f} of the angle's changes over {CONSISTENCY_SPAN} s, so it is mostly an alias of "
            "something faster, or noise.",
            _ask_for_rate(telemetry, rate=200),
        )
    if figures.input_snr is not None and figures.input_snr < REFUSED_SNR:
        return refused(
            f"The standard deviation of the motors' {axis} command, {figures.input_sd:.2g} {motors.scale.unit}".rstrip()
            + f", is no more than rounding to steps of {figures.input_step:.2g} makes.",
            f"Fly in wind, or excite {axis} with the stick.",
        )
    reason = (
        f"{figures.duration:.1f} s of settled flight with attitude at {figures.attitude_rate:.1f} Hz and motor outputs "
        f"at {figures.motor_rate:.1f} Hz."
    )
    return Verdict(axis, True, reason, "", _cautions(telemetry, motors, axis, figures), figures)


_FLY = "Record a flight: half a minute in the air between take-off and landing is enough."


def _ask_for_rate(telemetry: Telemetry, rate: int = 100) -> str:
    """How to get attitude and motors at ``rate`` Hz out of this autopilot.

    PX4: https://docs.px4.io/main/en/modules/modules_communication (``mavlink``). ArduPilot:
    https://ardupilot.org/dev/docs/mavlink-requesting-data.html; its stream groups EXTRA1 and RC_CHAN send ATTITUDE and
    SERVO_OUTPUT_RAW.
    """
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


def _whole_log(telemetry: Telemetry, attitude: Attitude, motors: Motors, found: int) -> Figures:
    armed = airborne = 0.0
    for boot in np.intersect1d(attitude.boot, motors.boot):
        time = motors.time[motors.boot == boot]
        recorded = [(float(time[0]), float(time[-1]))]
        flown = both(recorded, phases.armed(telemetry, boot))
        armed += sum(end - start for start, end in flown)
        airborne += sum(end - start for start, end in both(flown, phases.airborne(telemetry, motors, boot)))
    return Figures(armed, airborne, found, attitude_rate=_usual_rate(attitude), motor_rate=_usual_rate(motors))


def _usual_rate(stream: Attitude | Motors) -> float | None:
    """Messages a second between outages: steps of more than three usual ones, and those from boot to boot, left out."""
    steps = np.diff(stream.time)[np.diff(stream.boot) == 0]
    return 1 / float(steps[steps <= 3 * np.median(steps)].mean()) if len(steps) else None


def _measure(
    telemetry: Telemetry, attitude: Attitude, motors: Motors, segment: Segment, axis: str, figures: Figures
) -> Figures:
    flight = align(telemetry, segment, axis)
    here, there = _inside(attitude, segment), _inside(motors, segment)
    attitude_steps, motor_steps = np.diff(attitude.time[here]), np.diff(motors.time[there])
    combination, rounding = _turning(motors, flight.inputs, axis)
    share = motors.scale.fraction(flight.inputs)
    angle, rate = flight.outputs.T
    return replace(
        figures,
        duration=flight.duration,
        samples=len(flight),
        dt=flight.dt,
        attitude_rate=mean_rate(attitude.time[here]),
        motor_rate=mean_rate(motors.time[there]),
        attitude_jitter=float(attitude_steps.std()),
        motor_jitter=float(motor_steps.std()),
        attitude_gap=float(attitude_steps.max()),
        motor_gap=float(motor_steps.max()),
        angle_sd=float(angle.std()),
        rate_sd=float(rate.std()),
        input_sd=float(combination.std()),
        input_step=motors.scale.step,
        input_snr=float(combination.var() / rounding**2) - 1 if rounding > 0 else None,
        saturation=float(np.mean(((share >= _FULL) | (share <= _IDLE)).any(axis=1))),
        upper_band=_upper_band(rate, flight.dt),
        consistency=_consistency(attitude.time[here], attitude.angle[here], attitude.slope[here]),
    )


def _inside(stream: Attitude | Motors, segment: Segment) -> NDArray[np.bool_]:
    return np.asarray((stream.boot == segment.boot) & (stream.time >= segment.start) & (stream.time <= segment.end))


def _turning(motors: Motors, inputs: NDArray[np.float64], axis: str) -> tuple[NDArray[np.float64], float]:
    """The motors' combination (T,) that turns the axis, and the standard deviation that rounding alone gives it."""
    weights = motors.layout.effect(axis)
    if weights is None:
        differences = inputs - inputs.mean(axis=1, keepdims=True)
        return differences[:, np.argmax(differences.std(axis=0))], motors.scale.step / 12**0.5
    return inputs @ weights, motors.scale.step * float(np.sqrt((weights**2).sum() / 12))


def _upper_band(rate: NDArray[np.float64], dt: float) -> float | None:
    frequency, power = welch(rate, 1 / dt, nperseg=min(256, len(rate)), detrend="constant")
    total = float(power.sum())
    return float(power[frequency > frequency[-1] / 2].sum()) / total if total > 0 else None


def _consistency(time: NDArray[np.float64], angle: NDArray[np.float64], slope: NDArray[np.float64]) -> float | None:
    """1 − var(Δangle − ∫slope)/var(Δangle) over spans of ``CONSISTENCY_SPAN`` from every sample."""
    turned = cumulative_trapezoid(slope, time, initial=0)
    starts = time <= time[-1] - CONSISTENCY_SPAN
    later = time[starts] + CONSISTENCY_SPAN
    change = np.interp(later, time, angle) - angle[starts]
    unexplained = change - (np.interp(later, time, turned) - turned[starts])
    variance = float(change.var()) if len(change) else 0.0
    return 1 - float(unexplained.var()) / variance if variance > 0 else None


def _cautions(telemetry: Telemetry, motors: Motors, axis: str, figures: Figures) -> tuple[str, ...]:
    layout, cautions = motors.layout, []
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
